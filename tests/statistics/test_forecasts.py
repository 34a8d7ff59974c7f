"""Forecasts of the next stick: right where the answer is known, calibrated on simulated sticks."""

import math

import jax
import numpy as np
import pytest
from scipy import stats
from support.statistics import chain

import stickslip_jax as ss

SYSTEM, LAW = ss.papers.belt_oscillator(), ss.PoissonSwitching(speed=1.0, rate=1.0)
STATE = {"end_position": 0.1, "base_velocity": 1.0, "ending": float(ss.Ending.BASE_SWITCHED)}
FACTOR = 0.7


def normal_chain(seed, samples, steps=40):
    """A stationary sequence of normal numbers, each `FACTOR` times the one before and a new one."""
    rng = np.random.default_rng(seed)
    x = [rng.normal(size=samples) / math.sqrt(1 - FACTOR**2)]
    for _ in range(steps - 1):
        x.append(FACTOR * x[-1] + rng.normal(size=samples))
    return chain(np.stack(x, axis=1))


@pytest.fixture(scope="module")
def kernel():
    return ss.transition_kernel(SYSTEM, LAW, transitions=2**15)


@pytest.mark.parametrize("place", [-1.0, 0.0, 1.5])
def test_the_next_of_a_normal_sequence(place):
    found = ss.forecast(normal_chain(0, 5000), {"end_position": place}).distribution("end_position")
    # The states are within 0.02 of the place.
    assert abs(found.mean.value - FACTOR * place) < 4 * found.mean.standard_error + 0.01
    assert abs(found.standard_deviation.value - 1) < 4 * found.standard_deviation.standard_error
    for share in (0.1, 0.5, 0.9):
        quantile = found.quantile(share)
        assert abs(quantile.value - FACTOR * place - stats.norm.ppf(share)) < 4 * quantile.standard_error + 0.01


def test_scores_of_a_normal_sequence():
    """The mean score of a right normal forecast is its deviation over sqrt(pi)."""
    scores = ss.score_forecasts(normal_chain(0, 10_000), normal_chain(1, 200), neighbours=200)
    assert not scores.calibration(0.001).rejected
    mean, error = scores.score["end_position"].mean(), scores.score["end_position"].std() / math.sqrt(200 * 39)
    assert abs(mean - 1 / math.sqrt(math.pi)) < 5 * error + 0.01
    skill = scores.skill("end_position")
    assert abs(skill.value - (1 - math.sqrt(1 - FACTOR**2))) < 5 * skill.standard_error + 0.01
    assert "1 forecasts" not in repr(scores)
    assert "skill of forecasts of end position" in repr(scores)


def test_wrong_forecasts_are_told():
    """A kernel of a sequence with another memory is not calibrated for this one."""
    rng = np.random.default_rng(2)
    other = chain(rng.normal(size=(5000, 40)) * 1.4)
    assert ss.score_forecasts(other, normal_chain(1, 100)).calibration().rejected


def test_scores_are_those_of_the_formula():
    rng = np.random.default_rng(0)
    library, record = chain(rng.normal(size=(30, 3))), chain(rng.normal(size=(4, 2)))
    scores = ss.score_forecasts(library, record, neighbours=60)  # all there are
    values = library.following["end_position"]
    for y, score, pit in zip(record.following["end_position"], scores.score["end_position"],
                             scores.pit["end_position"], strict=True):  # fmt: skip
        apart = np.abs(values[:, None] - values).sum() / (60 * 59)
        assert score == pytest.approx(np.abs(values - y).mean() - apart / 2, abs=1e-8)
        assert np.sum(values < y) / 61 <= pit <= (np.sum(values < y) + 1) / 61


def test_slips_that_last(kernel):
    """After a release the mass slips at least until the base jumps, whose hazard is the rate, whatever has elapsed."""
    state = {"end_position": 0.25, "base_velocity": 1.0, "ending": float(ss.Ending.RELEASED)}
    for elapsed in (0.0, 0.7, 2.0):
        found = ss.forecast(kernel, state, elapsed=elapsed)
        slip = found.following["slip_before"]
        assert np.all(slip > elapsed)
        hazard = found.hazard(bins=5)
        assert hazard.edges[0] == elapsed
        # What is left of all slips at each edge, by the hazards and counted.
        left = np.exp(-np.cumsum(hazard.rate * np.diff(hazard.edges)))
        counted = np.array([np.mean(slip > edge) for edge in hazard.edges[1:]])
        assert np.max(np.abs(left - counted)) < 0.15
    assert "90 % from" in repr(found)
    assert "2 s after it" in repr(found)


def test_hazard_of_exponential_times():
    rng = np.random.default_rng(0)
    waits = chain(rng.exponential(0.5, size=(4000, 5)))
    hazard = ss.forecast(waits, {"end_position": 0.3}, neighbours=8000).hazard(bins=8)
    known = hazard.error < 0.3
    assert known.sum() >= 3
    assert np.max(np.abs((hazard.rate - 2.0) / hazard.error)[known]) < 4


def test_forecasts_of_simulated_sticks_are_calibrated(kernel):
    many = ss.simulate_ensemble(SYSTEM, LAW, t1=100.0, samples=300, key=jax.random.key(5), keep="sticks")
    record = ss.transition_kernel(many)
    scores = ss.score_forecasts(kernel, record)
    assert not scores.calibration(0.001).rejected
    assert scores.skill("end_position") > 0.1
    assert scores.skill("position") > 0.05


@pytest.mark.slow
def test_forecasts_are_calibrated_at_two_hundred_set_ups():
    """Set-ups at random, where sticks are not rare: p-values of all tests are spread evenly, and few tests reject."""
    rng, p_values = np.random.default_rng(7), []
    for number in range(200):
        mass, stiffness, normal_force, mu = rng.uniform((0.5, 1.0, 0.5, 0.2), (2.0, 9.0, 2.0, 1.5)).tolist()
        system = ss.MassSpring(mass, stiffness, normal_force, ss.Coulomb(mu))
        speed = mu * normal_force / (stiffness * mass) ** 0.5 / rng.uniform(0.15, 1.5)
        law = ss.PoissonSwitching(speed, rate=rng.uniform(0.3, 3.0))
        if number % 2:
            law = ss.RandomSteps(speed, interval=rng.uniform(0.3, 2.0))
        many = ss.simulate_ensemble(system, law, t1=200.0, samples=100, key=jax.random.key(number), keep="sticks")
        kernel = ss.transition_kernel(system, law, transitions=2**17)
        scores = ss.score_forecasts(kernel, ss.transition_kernel(many), neighbours=100, seed=number)
        p_values.append([test.p_value for test in scores.calibration().tests])
    for column in np.array(p_values).T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4
        assert np.sum(column < 0.01) <= stats.binom.ppf(0.9999, 200, 0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda k: ss.forecast(3, STATE), "Argument kernel must be the result of transition_kernel"),
        (lambda k: ss.forecast(k, {"end_position": 0.1}), "Argument state must hold a number for each of end_position"),
        (lambda k: ss.forecast(k, STATE, elapsed=-1.0), "Argument elapsed must"),
        (lambda k: ss.forecast(k, STATE, elapsed=1e3), "Argument elapsed must be shorter"),
        (lambda k: ss.forecast(k, STATE, neighbours=3), "Argument neighbours must be"),
        (lambda k: ss.forecast(k, STATE).distribution("mass"), "Argument name must be one of 'slip_before'"),
        (lambda k: ss.forecast(k, STATE).hazard(0), "Argument bins must be"),
        (lambda k: ss.score_forecasts(k, 3), "Argument record must be the result of transition_kernel"),
        (lambda k: ss.score_forecasts(k, chain(np.ones((30, 3)))), "Argument record must be one after a stick, given"),
        (
            lambda k: ss.score_forecasts(small := ss.transition_kernel(SYSTEM, LAW, transitions=64), small).skill(
                "mass"
            ),
            "Argument name must be one of",
        ),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_arguments(kernel, call, message):
    with pytest.raises(ValueError, match=message):
        call(kernel)
