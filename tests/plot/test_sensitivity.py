"""Figures of sensitivities: what is drawn is what was computed."""

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt

import stickslip_jax as ss
from stickslip_jax import plot


def result(parameter="mu", value=1.0, derivative=0.3, error=0.01, pathwise=0.5, **more) -> ss.Sensitivity:
    given = {
        "statistic": "mean stick duration (pooled)", "parameter": parameter, "parameter_value": value, "unit": "s",
        "value": 0.26, "value_error": 1e-4, "derivative": derivative, "standard_error": error, "pathwise": pathwise,
        "event": derivative - pathwise, "is_elasticity": False, "estimator": "corrected", "samples": 100, "asked": 100,
        "sticks_in_window": 500, "relative_bandwidth": 0.02,
    }  # fmt: skip
    return ss.Sensitivity(**(given | more))


def test_curve_is_in_order_with_bands():
    points = [result(value=1.2, derivative=0.2), result(value=0.8, derivative=0.4, pathwise=0.7), result()]
    ax = plot.sensitivity_curve(points)
    corrected, pathwise = (
        next(line for line in ax.lines if line.get_label() == label) for label in ("corrected", "pathwise part alone")
    )
    assert corrected.get_xdata().tolist() == [0.8, 1.0, 1.2]
    assert corrected.get_ydata().tolist() == [0.4, 0.3, 0.2]
    assert pathwise.get_ydata().tolist() == [0.7, 0.5, 0.5]
    (band,) = ax.collections
    edges = band.get_paths()[0].vertices
    assert edges[:, 1].max() == pytest.approx(0.4 + 1.96 * 0.01)
    assert ax.get_xlabel() == "mu"


def test_curve_without_the_pathwise_part():
    ax = plot.sensitivity_curve([result(), result(value=2.0)], pathwise=False)
    assert "pathwise part alone" not in [line.get_label() for line in ax.lines]


def test_tornado_has_the_largest_on_top():
    results = ss.Sensitivities({
        "mu": result(derivative=0.9, is_elasticity=True),
        "speed": result("speed", derivative=-1.4, is_elasticity=True),
        "rate": result("rate", derivative=0.1, is_elasticity=True),
    })  # fmt: skip
    ax = plot.tornado(results)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["rate", "mu", "speed"]
    assert [bar.get_width() for bar in ax.patches] == [0.1, 0.9, -1.4]
    assert "elasticity" in ax.get_xlabel()
    assert np.all(np.diff(ax.get_yticks()) > 0)
    said = {text.get_text() for text in ax.get_legend().get_texts()}
    assert said == {"grows with the parameter", "shrinks with it", "bars: 95 % confidence interval"}
    colours = {bar.get_facecolor() for bar in ax.patches if bar.get_width() > 0}
    assert len(colours) == 1
    assert colours.isdisjoint({bar.get_facecolor() for bar in ax.patches if bar.get_width() < 0})


def test_sobol_indices_with_their_intervals_and_the_largest_on_top():
    """Of ``x1 + 2 x2 + x2 x3`` over unit cubes, whose total indices are those of no other order."""
    design = ss.design.saltelli(32, ["x1", "x2", "x3"])
    x1, x2, x3 = design.u.T
    found = ss.sobol_indices({"sum": x1 + 2 * x2 + x2 * x3, "one": x1}, design, level=0.9)
    ax = plot.sobol_indices(found)
    names = [tick.get_text() for tick in ax.get_yticklabels()]
    assert names == ["x3", "x1", "x2"]
    order = [found.factors.index(name) for name in names]
    for kind, bars in zip(("total", "first"), ax.containers[1::2], strict=True):
        np.testing.assert_allclose([bar.get_width() for bar in bars], getattr(found, kind)[order, 0])
        ends = np.array([path.vertices[:, 0] for path in bars.errorbar.lines[2][0].get_paths()])
        np.testing.assert_allclose(ends.T, getattr(found, f"{kind}_interval")[:, order, 0], atol=1e-12)
    shown = [text.get_text() for text in ax.get_legend().get_texts()]
    assert shown == ["90 % interval", "total", "first order"]
    assert ax.get_xlabel() == "Sobol' index of sum"
    assert plot.sobol_indices(found, output="one").get_xlabel() == "Sobol' index of one"
    with pytest.raises(ValueError, match="Argument output must be one of 'sum', 'one', but 'two'"):
        plot.sobol_indices(found, output="two")


def test_given_axes_are_used():
    _, ax = plt.subplots()
    assert plot.tornado([result()], ax=ax) is ax
    assert plot.sensitivity_curve([result()], ax=ax) is ax
    assert len(plt.get_fignums()) == 1


@pytest.mark.parametrize(
    ("draw", "results", "message"),
    [
        (plot.tornado, [], "one or more Sensitivity results"),
        (plot.sobol_indices, [1.0], "Argument result must be a result of sobol_indices"),
        (plot.tornado, [1.0], "one or more Sensitivity results"),
        (plot.tornado, [result(), result(statistic="stick fraction")], "of one statistic"),
        (plot.sensitivity_curve, [result(), result("speed")], "those of mu, speed were given"),
    ],
    ids=["none", "no indices", "a number", "two statistics", "two parameters"],
)
def test_bad_input(draw, results, message, annotations_unchecked):
    with pytest.raises(ValueError, match=message):
        draw(results)
