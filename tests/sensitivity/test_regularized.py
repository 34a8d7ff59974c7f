"""Sensitivities of regularised dynamics: against differences of whole ensembles, and against exact dynamics."""

from typing import Any

import jax
import numpy as np
import pytest

import stickslip_jax as ss

LAW = ss.PoissonSwitching(1.0, 1.0)
FIXED = ss.Regularized(1e-2, step=0.02)
STUDY: dict[str, Any] = {"t1": 10.0, "samples": 300, "key": jax.random.key(4), "y0": (0.0, 0.5)}


def oscillator(mu=1.1):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))


def differences(statistic, make, step, method):
    """Of two ensembles, without the package's derivatives."""
    low, high = (
        ss.simulate_ensemble(*make(sign * step), **STUDY, method=method, keep="sticks", count_initial_rest=True)
        for sign in (-1, 1)
    )
    return (statistic(high) - statistic(low)) / (2 * step)


def pooled(many):
    return np.sum(many.flat_sticks.duration) / len(many.flat_sticks.start)


def first(many):
    sticks = many.flat_sticks
    numbers = [np.flatnonzero((sticks.sample == i) & (sticks.start > 0))[:1] for i in range(STUDY["samples"])]
    return np.mean(sticks.duration[np.concatenate(numbers)])


CASES: dict[str, Any] = {
    "pooled": (ss.mean_stick_duration, pooled, "mu", lambda by: (oscillator(1.1 + by), LAW), FIXED),
    "first": (ss.StickDuration(1), first, "mu", lambda by: (oscillator(1.1 + by), LAW), FIXED),
    "rate": (
        ss.mean_stick_duration, pooled, "rate",
        lambda by: (oscillator(), ss.PoissonSwitching(1.0, 1.0 + by)), FIXED,
    ),
    "of a distribution": (
        ss.mean_stick_duration, pooled, "low",
        lambda by: (oscillator(ss.Uniform(0.9 + by, 1.3)), LAW), FIXED,
    ),
    "adaptive": (
        ss.mean_stick_duration, pooled, "mu", lambda by: (oscillator(1.1 + by), LAW),
        ss.Regularized(1e-2, "tanh", max_steps=4096),
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pooled", *(pytest.param(name, marks=pytest.mark.slow) for name in list(CASES)[1:])])
def test_differences_of_ensembles(name):
    """The same random numbers at both ends; the default threshold, which follows from mu, follows it."""
    statistic, value, wrt, make, method = CASES[name]
    found = ss.sensitivity(statistic, *make(0.0), wrt=wrt, **STUDY, method=method, step=0.02)
    assert found.estimator == "finite-difference"
    assert found.samples == STUDY["samples"]
    assert np.isnan(found.pathwise)
    length = 0.02 * found.parameter_value
    # A ratio of means is differentiated by the quotient rule: equal to the difference of ratios to second order.
    expected = differences(value, make, length, method)
    assert found.derivative == pytest.approx(expected, rel=2e-2, abs=0.1 * found.standard_error)
    many = ss.simulate_ensemble(*make(0.0), **STUDY, method=method, keep="sticks", count_initial_rest=True)
    assert found.value == pytest.approx(value(many), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("wrt", ["mu", "rate"])
def test_against_exact_dynamics(wrt):
    """A narrow switch: the same derivative as the corrected one of exact motion."""
    study = STUDY | {"t1": 50.0, "samples": 4000}
    exact = ss.sensitivity(ss.mean_stick_duration, oscillator(), LAW, wrt=wrt, **study)
    smooth = ss.sensitivity(
        ss.mean_stick_duration, oscillator(), LAW, wrt=wrt, **study, method=ss.Regularized(1e-4, step=5e-3)
    )
    assert smooth.value == pytest.approx(exact.value, rel=0.02)
    assert smooth.derivative == pytest.approx(
        exact.derivative, abs=4 * np.hypot(exact.standard_error, smooth.standard_error)
    )


@pytest.mark.slow
@pytest.mark.parametrize("asked", [{"estimator": "corrected"}, {"relative_bandwidth": 0.01}])
def test_no_corrected_estimator(asked):
    with pytest.raises(ValueError, match=r"Argument estimator must be 'finite-difference' .* method=Regularized"):
        ss.sensitivity(ss.mean_stick_count, oscillator(), LAW, wrt="mu", **STUDY, method=FIXED, **asked)


@pytest.mark.slow
def test_in_a_sweep():
    """The derivative at each point is that of a call of `sensitivity`."""
    sweep = ss.Sweep(
        oscillator(), LAW, t1=10.0, samples=300, key=STUDY["key"], y0=(0.0, 0.5), method=FIXED,
        over={"mu": [1.1, 1.3]}, keep="totals", sensitivities=[("mean_stick_duration", "mu")],
    )  # fmt: skip
    found = sweep.run()
    for mu, slope in zip((1.1, 1.3), found["d_mean_stick_duration_by_mu"].values, strict=True):
        alone = ss.sensitivity(ss.mean_stick_duration, oscillator(mu), LAW, wrt="mu", **STUDY, method=FIXED)
        assert slope == pytest.approx(alone.derivative, rel=1e-9)
