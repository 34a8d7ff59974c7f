"""Figures of sections, bifurcation diagrams, basins and branches show what the data sets hold."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

from stickslip_jax import plot
from stickslip_jax.nonlinear import BranchEvent, OrbitBranch


@pytest.fixture(autouse=True)
def _no_figures_stay():
    yield
    plt.close("all")


def states(dims, shape, seed=0):
    rng = np.random.default_rng(seed)
    where = "at the event" if "event" in dims else "at the end of the period"
    names = {"position": "m", "velocity": "m/s"}
    return {
        name: (dims, rng.normal(size=shape), {"long_name": f"{name} {where}", "units": unit})
        for name, unit in names.items()
    }


def offsets(ax):
    return np.concatenate([np.asarray(one.get_offsets()) for one in ax.collections])


def test_section_has_a_point_for_each_return():
    data = xr.Dataset(states(("start", "cycle"), (2, 30)))
    ax = plot.section(data)
    np.testing.assert_allclose(offsets(ax), np.stack([data.position.values.ravel(), data.velocity.values.ravel()], 1))
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        "position at the end of the period (m)", "velocity at the end of the period (m/s)",
    )  # fmt: skip
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["start 1", "start 2"]
    ax = plot.section(xr.Dataset(states(("event",), (7,))), x="velocity", y="position")
    assert len(offsets(ax)) == 7


def test_diagram_has_all_points_over_the_parameter():
    mu = ("mu", [0.1, 0.2, 0.3], {"long_name": "friction coefficient", "units": "1"})
    data = xr.Dataset(states(("mu", "start", "cycle"), (3, 2, 1000)), {"mu": mu})
    data["position"][0, 0, 0] = np.nan
    ax = plot.bifurcation_diagram(data)
    points = offsets(ax)
    assert len(points) == 3 * 2 * 1000 - 1
    for value in (0.1, 0.2, 0.3):
        own = np.sort(points[points[:, 0] == value, 1])
        expected = np.sort(data.position.sel(mu=value).values.ravel())
        np.testing.assert_allclose(own, expected[np.isfinite(expected)])
    assert ax.get_xlabel() == "friction coefficient"
    followed = xr.concat([data, data], xr.DataArray(["up", "down"], dims="direction", name="direction"))
    ax = plot.bifurcation_diagram(followed, "velocity")
    assert len(ax.collections) == 2
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["followed up", "followed down"]


def basins_of(dims, labels, coordinates):
    return xr.Dataset(
        {
            "basin": (dims, labels),
            "share": ("attractor", [0.75, 0.25]),
            "is_stuck": ("attractor", [False, False]),
            "attractor_position": (("attractor", "point"), [[0.0, 1.0], [0.5, np.nan]]),
            "attractor_velocity": (("attractor", "point"), [[0.0, 1.0], [0.5, np.nan]]),
        },
        {**coordinates, "attractor": [1, 2]},
    )


def test_basins_have_colours_and_shares():
    grid = {"position": ("position", [0.0, 1.0]), "velocity": ("velocity", [0.0, 1.0])}
    ax = plot.basins(basins_of(("position", "velocity"), [[1, 1], [1, 2]], grid))
    (mesh,) = [one for one in ax.collections if one.get_array() is not None]
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(2, 2), [[1, 1], [1, 2]])
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["attractor 1: 75.0%", "attractor 2: 25.0%", "points of attractors"]
    starts = {"initial_position": ("start", [0.0, 1.0, 2.0]), "initial_velocity": ("start", [0.0, 0.0, 1.0])}
    ax = plot.basins(basins_of(("start",), [1, 2, 0], starts))
    np.testing.assert_allclose(offsets(ax)[:3], [[0, 0], [1, 0], [2, 1]])


def test_branch_is_dashed_where_unstable():
    speed = ("point", [1.0, 2.0, 3.0, 2.5], {"long_name": "speed", "units": "m/s"})
    variables = {
        "period": ("point", [6.0, 6.1, 6.2, 6.3], {"long_name": "period of the orbit", "units": "s"}),
        "is_stable": ("point", [True, True, False, False]),
        "modes": ("point", ["- 0", "- 0", "-", "-"]),
    }
    branch = OrbitBranch(xr.Dataset(variables, {"speed": speed}), (BranchEvent("stick vanishes", 3.0, 1, ""),), "")
    ax = plot.orbit_branch(branch)
    assert [line.get_linestyle() for line in ax.lines[:2]] == ["-", "--"]
    np.testing.assert_allclose(ax.lines[1].get_xdata(), [3.0, 2.5])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["stable", "unstable", "stick vanishes"]
    assert ax.get_ylabel() == "period of the orbit (s)"


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        (lambda: plot.section(3), "Argument results must be a Dataset of a section"),
        (lambda: plot.section(xr.Dataset({"a": ("x", [1.0])})), "Argument results must be a Dataset of a section"),
        (lambda: plot.section(xr.Dataset(states(("mu", "cycle"), (2, 3)))), "Argument results must be at one point"),
        (lambda: plot.section(xr.Dataset(states(("cycle",), (3,))), x="speed"), "Argument name must be one of"),
        (
            lambda: plot.bifurcation_diagram(xr.Dataset(states(("cycle",), (3,)))),
            "Argument results must have one parameter, but none was given",
        ),
        (
            lambda: plot.bifurcation_diagram(xr.Dataset(states(("mu", "speed", "cycle"), (2, 2, 3)))),
            "Argument results must have one parameter, but mu, speed was given",
        ),
        (lambda: plot.basins(xr.Dataset()), "Argument results must be a Dataset of basins"),
        (lambda: plot.orbit_branch(3), "Argument result must be that of continue_orbit"),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input_is_told_in_a_sentence(draw, said):
    with pytest.raises(ValueError, match=said):
        draw()
