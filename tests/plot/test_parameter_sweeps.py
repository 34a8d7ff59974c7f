"""Figures of parameter sweeps: which kind is drawn, with which axes."""

import numpy as np
import pytest
import xarray as xr

from stickslip_jax import plot


def _results(shape, *, errors=0.1, spaced=np.geomspace):
    sizes = dict(zip(("mu", "rate"), shape, strict=False))
    coordinates = {name: (name, spaced(0.5, 2.0, size), {"units": "1"}) for name, size in sizes.items()}
    values = np.arange(np.prod(shape), dtype=float).reshape(shape)
    return xr.Dataset(
        {
            "share": (tuple(sizes), values, {"long_name": "stick share", "units": "1"}),
            "share_error": (tuple(sizes), np.full(shape, errors)),
            "time": (tuple(sizes), values, {"long_name": "time", "units": "s"}),
        },
        coordinates,
    )


def test_one_parameter_is_a_curve_with_bars():
    share, time = plot.parameter_sweep(_results((5,)), ["share", "time"])
    assert (share.get_xscale(), share.get_xlabel(), share.get_ylabel()) == ("log", "mu", "stick share")
    assert share.lines[0].get_ydata() == pytest.approx(np.arange(5))
    assert len(share.containers) == 1  # the bars
    assert (time.get_ylabel(), len(time.containers)) == ("time (s)", 0)
    assert share.figure is time.figure


def test_few_values_of_a_parameter_are_curves_with_bands():
    (ax,) = plot.parameter_sweep(_results((3, 6), spaced=np.linspace), ["share"])
    assert (ax.get_xscale(), ax.get_xlabel()) == ("linear", "rate")
    curves = [line for line in ax.lines if len(line.get_xdata())]
    assert [tuple(line.get_ydata()) for line in curves] == [tuple(np.arange(6.0) + start) for start in (0, 6, 12)]
    assert len(ax.collections) == 3


def test_two_parameters_are_a_map():
    """Uncertain cells are marked; where no sample has an error, none is."""
    for errors, marks in ((0.1, 1), (np.nan, 0)):
        (ax,) = plot.parameter_sweep(_results((5, 6), errors=errors), ["share"])
        assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_xscale()) == ("mu", "rate", "log")
        labels = ax.get_legend_handles_labels()[1]
        assert len([label for label in labels if label.startswith("standard error above")]) == marks


def test_without_names_those_that_the_command_shows():
    results = _results((5,)).rename(share="stick_fraction", share_error="stick_fraction_error")
    results["samples"] = (("mu",), np.full(5, 10))
    (ax,) = plot.parameter_sweep(results)
    assert ax.get_ylabel() == "stick share"
    with pytest.raises(ValueError, match="Argument names must be a list of variables of the results, some of share,"):
        plot.parameter_sweep(_results((5,)))


def test_bad_arguments(annotations_unchecked):
    wrong = [
        (({"share": 1}, ["share"]), "results must be a Dataset of a Sweep"),
        ((_results((5,)), ["shares"]), "names must be a list of variables of the results, some of share,"),
        ((_results((5,)), []), "names must be a list"),
        ((_results((5, 6)).expand_dims("y0"), ["share"]), r"results must have one or two .* has 3 \(y0, mu, rate\)"),
    ]
    for arguments, message in wrong:
        with pytest.raises(ValueError, match=f"Argument {message}"):
            plot.parameter_sweep(*arguments)
