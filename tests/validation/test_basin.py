"""Which starts come to rest on a belt: labels published by pyBasin and bSTAB, and the boundary by scipy."""

import contextlib
import io
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from support.scripts import loaded

DOCS = Path(__file__).parents[2] / "docs"

# Whether the starts nearest to the boundary come to rest. pyBasin (ground_truths/main/main_friction.csv; friction
# smoothed, absolute tolerance 1e-6): by number of the start.
PYBASIN = {
    3117: True, 3229: True, 3519: True, 1817: False, 459: True, 3498: True, 2163: True, 867: False, 3281: True,
    1249: False, 2248: True, 3669: False, 402: True, 2288: True, 1666: True, 1438: True, 784: False, 1976: True,
}  # fmt: skip
# bSTAB (MATLAB, friction not smoothed), the labels in the same file of pyBasin's repository before it made its own:
# the first eight from commit d3b84eaf564c84cb20d70bce5b8a93d9539a35ed, the others from
# 0e5e44bf8fb25f3f42c1db97f3d534b3b572ab0e. Position, velocity, at rest.
BSTAB = (
    (1.67651525869302, 0.667337281331126, True),
    (-0.510703979690832, 0.55255179405445, True),
    (1.85430803427116, 0.0300371904097643, True),
    (-0.523386437514705, 0.527500125400509, True),
    (1.80518356865943, 0.36514773077158, False),
    (1.52815789854428, 0.870799917623442, True),
    (1.06622528106995, 1.18473782595563, False),
    (1.31811979936732, 1.05766280169337, False),
    (1.83008317982641, 0.257569286388907, True),
    (-0.591596375753623, 0.36456319136615, True),
    (1.77019040063947, 0.470623052954894, False),
    (1.13884704840672, 1.15595291928068, False),
    (1.82466265710331, 0.287994615137484, False),
    (1.63445256207654, 0.736989864893651, False),
    (0.494871896212847, 1.23437733773531, True),
    (1.19388567939155, 1.12706907449743, True),
)
FIRST = 200  # of pyBasin's starts, from all over the box


@pytest.fixture(scope="module")
def basin():
    """The script that prints what ``docs/validation.md`` says."""
    return loaded("docs/validation_basin.py")


def slip(t, y, speed):
    """Motion below a belt of this speed."""
    return y[1], 0.5 + 0.5 * math.exp((y[1] - speed) / 0.5) - y[0] - 0.1 * y[1]


def missed_by(speed):
    """How much faster than the belt a mass becomes that it has released, were there no belt, when it comes back."""

    def turns(t, y, speed):
        return slip(t, y, speed)[1]

    turns.direction = -1
    start = (1 - 0.1 * speed, speed)
    path = solve_ivp(slip, (0, 12), start, "DOP853", rtol=1e-12, atol=1e-13, events=turns, args=(speed,))
    return next(y[1] for t, y in zip(path.t_events[0], path.y_events[0], strict=True) if t > 1) - speed


@pytest.fixture(scope="module")
def last_speed():
    """The belt speed above which a released mass never comes back to the belt: where stick-slip ends."""
    return brentq(missed_by, 1.775, 1.85, xtol=1e-12)


@pytest.fixture(scope="module")
def run(basin, last_speed):
    """One ensemble of all starts of this file: starts, belt speeds, and which come to rest, by group."""
    offsets = np.array([-1e-2, -1e-4, -1e-6, 1e-6, 1e-4, 1e-2])
    near_last = last_speed + offsets
    groups = {
        "pybasin": basin.starts(4000)[list(PYBASIN)],
        "bstab": np.array(BSTAB)[:, :2],
        "first": basin.starts(FIRST),
        "near last": np.stack([1 - 0.1 * near_last - 0.5, near_last], axis=1),  # at rest on the belt
    }
    speeds = {name: np.full(len(y0), basin.BELT_SPEED) for name, y0 in groups.items()} | {"near last": near_last}
    at_rest = basin.come_to_rest(np.concatenate([*speeds.values()]), np.concatenate([*groups.values()]))
    ends = np.cumsum([len(y0) for y0 in groups.values()])[:-1]
    parts = np.split(at_rest, ends)
    return {name: (y0, part) for (name, y0), part in zip(groups.items(), parts, strict=True)}


@pytest.mark.slow
def test_starts_nearest_to_the_boundary_are_labelled_as_in_pybasin(basin, run):
    """All but the nearest, 9e-5 outside, which pyBasin's tolerances bring to rest (the slow test below)."""
    others = [start for start, ours in zip(PYBASIN, run["pybasin"][1], strict=True) if ours != PYBASIN[start]]
    assert tuple(others) == basin.OTHERS


@pytest.mark.slow
def test_starts_nearest_to_the_boundary_are_labelled_as_in_bstab(run):
    """The nearest lies 2e-5 inside."""
    np.testing.assert_array_equal(run["bstab"][1], [at_rest for *_, at_rest in BSTAB])


@pytest.mark.slow
@pytest.mark.parametrize("group", ["pybasin", "bstab", "first"])
def test_those_inside_the_unstable_cycle_come_to_rest(basin, run, group):
    y0, at_rest = run[group]
    assert 0 < at_rest.mean() < 1
    np.testing.assert_array_equal(at_rest, basin.boundary(basin.BELT_SPEED).inside(y0))


@pytest.mark.slow
def test_stick_slip_ends_at_the_belt_speed_at_which_a_released_mass_just_comes_back(run):
    np.testing.assert_array_equal(run["near last"][1], [False, False, False, True, True, True])


@pytest.mark.slow
def test_the_cycle_grows_from_where_the_equilibrium_becomes_stable(basin):
    """The slope of friction outweighs the damping below the belt speed ln(10)/2 (Hopf): no start comes to rest there.

    Above, the area of the cycle grows in proportion to the excess of speed.
    """
    hopf = math.log(10) / 2
    assert basin.boundary(hopf - 1e-3) is None
    small, double = (basin.boundary(hopf + excess).share for excess in (2e-3, 4e-3))
    assert double / small == pytest.approx(2, abs=0.02)


@pytest.mark.slow
def test_published_shares_are_those_of_the_area_inside(basin):
    """As often as chance has it: each share within 3 of its standard errors."""
    share = basin.boundary(basin.BELT_SPEED).share
    for published, starts in [(basin.PUBLISHED_SHARE, 4000), (0.312, 5000), (0.304, 5000)]:
        assert abs(published - share) < 3 * math.sqrt(share * (1 - share) / starts)


@pytest.mark.slow
def test_published_labels_are_known_state_by_state(basin):
    """Their digest is that of the starts inside the cycle, but for one; and of no other set."""
    inside = basin.boundary(basin.BELT_SPEED).inside(basin.starts(4000))
    assert basin.digest(basin.with_others(inside, basin.OTHERS)) == basin.PUBLISHED_LABELS
    assert basin.digest(inside) != basin.PUBLISHED_LABELS
    assert np.sum(basin.with_others(inside, basin.OTHERS)) == basin.PUBLISHED_SHARE * 4000


@pytest.mark.slow
def test_the_document_says_what_the_script_prints(basin):
    """All 44,000 labelled starts. The script compares labels by digest, and says so where one is not as it was."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        basin.main()
    assert "other than was found before" not in printed.getvalue()
    assert printed.getvalue() in (DOCS / "validation.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_starts_labelled_otherwise_in_the_sweep_are_slow(basin):
    """They still move at more than 0.2 m/s in the last 100 s, by which pyBasin labels; and one more, at 0.20008 m/s.

    By 3,000 s all have arrived as the cycle says.
    """
    (place, others), *more = basin.OTHERS_IN_SWEEP.items()
    assert not more
    speeds, y0 = np.full(2000, basin.BELT_SPEEDS[place]), basin.starts(2000)
    at_rest = basin.come_to_rest(speeds, y0)
    still = np.flatnonzero(at_rest)
    peaks = np.asarray(basin.largest_late_speeds(speeds[still], y0[still], 500))
    assert set(still[peaks > basin.REST_SPEED + 1e-4]) == set(others)
    assert still[np.abs(peaks - basin.REST_SPEED) < 1e-4].tolist() == [1117]
    inside = basin.boundary(speeds[0]).inside(y0)
    np.testing.assert_array_equal(basin.come_to_rest(speeds, y0, t1=3000.0), inside)
    assert np.flatnonzero(at_rest != inside).tolist() == [81]  # still spirals outward at 500 s
