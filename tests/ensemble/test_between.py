"""What happens in a part of the time: of an ensemble, and the stick time of one motion."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stickslip_jax as ss
from stickslip_jax import papers

T1 = 40.0


@pytest.fixture(scope="module")
def many():
    return ss.simulate_ensemble(
        papers.belt_oscillator(), ss.PoissonSwitching(1.0, 1.0), T1, samples=300, key=jax.random.key(2), keep="sticks"
    )


@settings(max_examples=30)
@given(st.integers(0, 390), st.floats(0.01, 1.0))
def test_sticks_are_cut_at_both_ends(many, tenths, share):
    begin = tenths / 10
    end = begin + share * (T1 - begin)
    part, whole = many.between(begin, end), many.flat_sticks
    found = part.flat_sticks
    cut = [
        (max(start - begin, 0.0), min(stop, end) - begin, where)
        for start, stop, where in zip(whole.start, whole.end, whole.position, strict=True)
        if stop > begin and start < end
    ]
    np.testing.assert_allclose(np.array(cut).reshape(-1, 3).T, [found.start, found.end, found.position], atol=1e-12)
    inside = (whole.end > begin) & (whole.start < end)
    np.testing.assert_array_equal(found.count, np.bincount(whole.sample[inside], minlength=300))
    ended = np.where(whole.end[inside] > end, ss.Ending.HORIZON, whole.ending[inside])
    np.testing.assert_array_equal(found.ending, ended)
    assert part.t1 == pytest.approx(end - begin)
    time = np.bincount(found.sample, found.duration, minlength=300)
    np.testing.assert_allclose(part.totals.stick_time, time, atol=1e-12)
    np.testing.assert_array_equal(part.slips.count, part.totals.slips)


def test_parts_add_up_to_the_whole(many):
    parts = [many.between(at, at + 10.0) for at in (0.0, 10.0, 20.0, 30.0)]
    together = np.sum([part.totals.stick_time for part in parts], axis=0)
    np.testing.assert_allclose(together, many.totals.stick_time, rtol=1e-12)
    assert parts[0].statistics.duration.number + parts[0].statistics.sticks.begins_at_zero.sum() == sum(
        parts[0].totals.sticks
    )
    assert ss.stick_fraction(parts[2]).value == pytest.approx(np.mean(parts[2].totals.stick_time) / 10.0)
    whole = many.between(0.0)
    assert whole.statistics.duration.mean.value == pytest.approx(many.statistics.duration.mean.value, rel=1e-12)


def test_what_a_part_does_not_know(many, tmp_path):
    part = many.between(10.0, 20.0)
    with pytest.raises(ValueError, match="does not know its base motion \\(10 to 20 s of another ensemble\\)"):
        part.realization(0)
    again = ss.load(part.save(tmp_path / "part.nc"))
    np.testing.assert_array_equal(again.flat_sticks.start, part.flat_sticks.start)
    assert "10 to 20 s of another ensemble" in repr(again)


@pytest.mark.slow
def test_stick_time_of_one_motion_and_its_derivative(many):
    """Against the ensemble of the same samples; the derivative by the friction coefficient against differences."""
    system, base, y0 = many.realization(7)
    times = jnp.array([0.0, 3.0, 11.5, 30.0, T1])

    def between(mu):
        one = ss.simulate(papers.belt_oscillator(mu), base, T1, y0)
        return jax.vmap(one.stick_time_between)(times[:-1], times[1:])

    expected = [many.between(float(a), float(b)).totals.stick_time[7] for a, b in itertools.pairwise(times)]
    np.testing.assert_allclose(between(1.0), expected, atol=1e-12)
    assert system.friction.mu == 1.0
    slope = jax.jacfwd(between)(1.0)
    np.testing.assert_allclose(slope, (between(1 + 1e-6) - between(1 - 1e-6)) / 2e-6, rtol=1e-5, atol=1e-7)


def test_times_of_a_batch(many):
    bases = [many.realization(number)[1:] for number in range(3)]
    ones = [ss.simulate(many.system, base, T1, y0) for base, y0 in bases]
    joined = ss.simulate_ensemble(many.system, many.law, T1, samples=3, key=jax.random.key(2), keep="sticks")
    for one, time in zip(ones, joined.between(5.0, 25.0).totals.stick_time, strict=True):
        assert float(one.stick_time_between(5.0, 25.0)) == pytest.approx(time, abs=1e-12)
        assert float(one.stick_time_between(0.0)) == pytest.approx(float(one.stick_time), rel=1e-12)


def test_set_ups_of_papers_are_arguments():
    setup = papers.square_wave_belt(1.2)
    one = ss.simulate(*setup)
    period = math.pi / 1.2
    steady = float(one.stick_time_between(one.t1 - period)) / period
    assert steady == pytest.approx(0.3643264528, abs=2e-3)  # after 76 periods
    many = ss.simulate_ensemble(*papers.random_belt(1.2), samples=4, key=jax.random.key(0))
    assert many.t1 == 200.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda many: many.between(-1.0), "Argument begin must"),
        (lambda many: many.between(T1), "Argument begin must"),
        (lambda many: many.between(5.0, 5.0), "Argument end must"),
        (lambda many: many.between(5.0, 41.0), "Argument end must be at most t1 = 40 s"),
        (lambda many: many.between(float("nan")), "Argument begin must"),
    ],
)
def test_bad_times(many, call, message):
    with pytest.raises(ValueError, match=message):
        call(many)


@pytest.mark.slow
def test_stick_time_of_several_contacts_is_asked_of_one():
    contacts = tuple(ss.Contact(row, 1.0, ss.Coulomb(0.5)) for row in ((1.0, 0.0), (0.0, 1.0)))
    row = ss.LinearStructure(np.eye(2), np.array([[2.0, -1.0], [-1.0, 2.0]]), None, contacts)
    one = ss.simulate(row, ss.Constant(0.3), 10.0, (0.1, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="needs the sticks of one contact"):
        one.stick_time_between(0.0)
    for number in (0, 1):
        found = one.of_contact(number).stick_time_between(0.0)
        assert float(found) == pytest.approx(float(one.stick_time[number]), rel=1e-12)


def test_sticks_that_were_not_kept():
    many = ss.simulate_ensemble(
        papers.belt_oscillator(), ss.PoissonSwitching(1.0, 1.0), T1, samples=3, key=jax.random.key(2)
    )
    with pytest.raises(ValueError, match="did not keep its sticks"):
        many.between(1.0)
