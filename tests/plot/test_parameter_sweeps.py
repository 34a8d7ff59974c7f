"""Figures of parameter sweeps: which kind is drawn, with which axes."""

import jax
import numpy as np
import pytest
import xarray as xr

import stickslip_jax as ss
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


@pytest.fixture(scope="module")
def swept():
    """A small sweep over two parameters, with histograms."""
    sweep = ss.Sweep(
        ss.papers.belt_oscillator(), ss.PoissonSwitching(1.0, 1.0), over={"mu": [0.5, 1.0, 2.0], "rate": [0.5, 1.0]},
        t1=30.0, samples=60, key=jax.random.key(0),
    )  # fmt: skip
    return sweep.run(progress=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["duration", "stick_count", "position"])
def test_histograms_along_a_parameter(swept, name):
    """The steps are the densities of the sweep, in its bins, one for each value of the parameter."""
    one = swept.sel(rate=1.0)
    ax = plot.histograms(one, name, log=True)
    outlines = [patch.get_data() for patch in ax.patches]
    assert len(outlines) == 3
    for drawn, mu in zip(outlines, one.mu.values, strict=True):
        np.testing.assert_array_equal(drawn.values, one[f"{name}_density"].sel(mu=mu).values)
        np.testing.assert_array_equal(drawn.edges[:-1], one[f"{name}_bin_low"].values)
        assert (drawn.values * np.diff(drawn.edges)).sum() == pytest.approx(1)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["mu = 0.5", "mu = 1", "mu = 2"]
    assert ax.get_yscale() == "log"
    assert len(plot.histograms(one, name, most=2).patches) == 2
    unit = {"duration": " (1/s)", "stick_count": "", "position": " (1/m)"}[name]
    assert ax.get_ylabel() == ("probability" if name == "stick_count" else f"probability density{unit}")


@pytest.mark.slow
def test_histograms_that_are_not_along_one_parameter(swept):
    for data, name, message in [
        (swept, "duration", "vary along one parameter, but it does along 2"),
        (swept.isel(mu=0, rate=0), "duration", "vary along one parameter, but it does along 0"),
        (swept.isel(mu=0), "mass", "Argument name must be one of"),
        (_results((3,)), "duration", "Argument results must be the result of Sweep.run"),
    ]:
        with pytest.raises(ValueError, match=message):
            plot.histograms(data, name)
