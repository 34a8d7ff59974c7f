"""A few set-ups of the search in every run of the tests, by programs and a reference that other tests use too."""

import math

import numpy as np
import pytest
from reference import compiled
from support.search import numbers_of
from support.search_cases import drawn
from support.search_scales import Units, in_units
from support.search_ties import first_release, tie
from support.switched import coulomb, errors_against


@pytest.mark.slow
@pytest.mark.parametrize("family", ["clinging", "frictionless", "lattice", "slow"])
def test_families(family):
    case = drawn("harmonic", family, 1, first=5)[0]
    case = case._replace(t1=case.t1 / 3, damping=case.damping or 0.01)
    followed = case.follow()
    assert int(followed.simulation.near_grazing_count) == 0
    assert max(errors_against(case.reference(), case, followed)) < 1e-10


@pytest.mark.slow
def test_other_units():
    """Powers of two change no digit."""
    case = drawn("harmonic", "everyday", 1)[0]
    units = Units(2.0**-30, 2.0**20, 2.0**-7)
    one, other = case.follow().simulation, in_units(case, units).follow().simulation
    assert int(one.sticks.count) == int(other.sticks.count) > 0
    np.testing.assert_array_equal(other.sticks.start, one.sticks.start * units.time)
    np.testing.assert_array_equal(other.sticks.position, one.sticks.position * units.length)
    assert other.final_state[1] == one.final_state[1] * (units.length / units.time)


@pytest.mark.parametrize("kind", ["base", "ground", "force"])
def test_first_release(kind):
    """Exact arithmetic against the event-driven reference, where the limit is a little higher or lower than a tie."""
    for seed, factor in ((1, 0.875), (2, 1.125)):
        case = tie(kind, seed)
        line = case.base if case.force is None else case.force
        moved = case._replace(rub=coulomb(float(case.rub.law.mu) * factor), t1=line.times[4])
        exact, sticks = first_release(moved), moved.reference(max_step=line.times[1] / 4).sticks
        begins = bool(sticks) and sticks[0].start == 0
        end = sticks[0].end if begins else 0.0
        assert end == pytest.approx(moved.t1 if exact is None else exact, abs=1e-9 * moved.t1)


@pytest.mark.parametrize("kind", ["harmonic", "jumps", "ground", "weakening", "stribeck", "hump"])
@pytest.mark.slow
def test_compiled_reference(kind):
    """The compiled reference against the event-driven one, which shares nothing with it."""
    for seed in range(4):
        case = drawn(kind, "everyday", 1, first=seed)[0]
        slow, quick = case.reference(), compiled.run(numbers_of(case))
        assert [getattr(compiled, stick.ending) for stick in slow.sticks] == quick.sticks[:, 3].tolist()
        assert len(slow.crossings) == quick.crossings
        events = np.array([stick[:3] for stick in slow.sticks]).reshape(-1, 3)
        np.testing.assert_allclose(quick.sticks[:, :3], events, atol=1e-9 * case.t1)
        np.testing.assert_allclose(quick.state, slow.final_state, atol=1e-9 * max(1, math.hypot(*slow.final_state)))
