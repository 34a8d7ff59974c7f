"""Derivatives by the parameters of distributions, against differences of large ensembles with other random numbers."""

import dataclasses

import jax
import numpy as np
import pytest

import stickslip_jax as ss

LAW = ss.PoissonSwitching(1.3, 2.0)
T1, SAMPLES = 10.0, 8_000


def oscillator(mu=0.5, stiffness=100.0, damping=None):
    return ss.MassSpring(mass=1.0, stiffness=stiffness, normal_force=20.0, friction=ss.Coulomb(mu), damping=damping)


def difference(statistic, make, value, step, seed, *, t1=T1, samples=40_000, **options):
    """The derivative of the statistic's mean and its standard error; make(value) gives system, law and y0."""
    ends = []
    for number, moved in enumerate((value - step, value + step)):
        system, law, y0 = make(moved)
        key = jax.random.key(1000 + 2 * seed + number)
        many = ss.simulate_ensemble(
            system, law, t1=t1, samples=samples, key=key, y0=y0, keep="totals", progress=False, **options
        )
        ends.append(statistic(many))
    low, high = ends
    error = np.hypot(low.standard_error, high.standard_error)
    return (high.value - low.value) / (2 * step), error / (2 * step)


def agree(found, expected):
    derivative, error = expected
    assert abs(found.derivative - derivative) < 4 * np.hypot(found.standard_error, error)


@pytest.mark.slow
def test_corrected_derivatives_of_counts():
    def mean(value):
        return oscillator(ss.Truncated(ss.Normal(value, 0.1), low=0.05)), LAW, None

    def std(value):
        return oscillator(ss.Truncated(ss.Normal(0.5, value), low=0.05)), LAW, None

    system, law, _ = mean(0.5)
    wrt = ("mu.distribution.mean", "mu.distribution.std")
    found = ss.sensitivity(
        ss.mean_stick_count, system, law, wrt=wrt, t1=T1, samples=SAMPLES, key=jax.random.key(0), estimator="corrected"
    )
    # Half as wide a step moves the difference by less than its error.
    agree(found["mu.distribution.mean"], difference(ss.mean_stick_count, mean, 0.5, 0.04, 1))
    agree(found["mu.distribution.std"], difference(ss.mean_stick_count, std, 0.1, 0.03, 2))


@pytest.mark.slow
def test_an_estimate_of_fixed_distributions_is_that_of_the_ensemble():
    """The value is the ensemble's, sample by sample; and differences are the default where nothing else is known."""
    system = oscillator(ss.Uniform(0.3, 0.7), damping=0.5)
    options = {"t1": 4.0, "samples": 256, "key": jax.random.key(0)}
    found = ss.sensitivity(ss.mean_stick_count, system, LAW, wrt="mu.high", **options)
    many = ss.simulate_ensemble(system, LAW, **options, keep="totals")
    assert found.estimator == "finite-difference"
    assert found.value == pytest.approx(ss.mean_stick_count(many).value, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("statistic", [ss.mean_stick_duration, ss.stick_fraction, ss.mean_total_stick_time])
def test_corrected_derivatives_of_durations_and_times(statistic):
    def median(value):
        return oscillator(0.5, ss.LogNormal(value, 0.3)), LAW, (ss.Uniform(-0.1, 0.1), 0.0)

    system, law, y0 = median(100.0)
    found = ss.sensitivity(
        statistic, system, law, wrt="median", t1=T1, samples=100_000, key=jax.random.key(0), y0=y0,
        estimator="corrected",
    )  # fmt: skip
    agree(found, difference(statistic, median, 100.0, 8.0, 4, samples=400_000))


@pytest.mark.slow
def test_rates_and_starts():
    def rate(value):
        return oscillator(), ss.PoissonSwitching(1.3, ss.Uniform(1.0, value)), (ss.Normal(0.0, 0.1), 0.0)

    system, law, y0 = rate(3.0)
    options = {"t1": 2.0, "samples": 100_000, "key": jax.random.key(0), "y0": y0}
    by_rate = ss.sensitivity(ss.mean_stick_count, system, law, wrt="rate.high", **options)
    by_start = ss.sensitivity(ss.mean_stick_count, system, law, wrt="y0[0].std", estimator="corrected", **options)
    start = lambda value: (system, law, (ss.Normal(0.0, value), 0.0))  # noqa: E731
    agree(by_rate, difference(ss.mean_stick_count, rate, 3.0, 0.2, 5, t1=2.0, samples=400_000))
    agree(by_start, difference(ss.mean_stick_count, start, 0.1, 0.01, 6, t1=2.0, samples=400_000))
    assert by_rate.estimator == "finite-difference"
    # How often it switches is in no path.
    with pytest.raises(ValueError, match="or to the distribution of a switching rate"):
        ss.sensitivity(ss.mean_stick_count, system, law, wrt="rate.high", estimator="corrected", **options)


@pytest.mark.slow
def test_time_steps_and_beta():
    def shape(value):
        return oscillator(ss.Beta(value, 3.0, 0.2, 0.9), damping=0.5), LAW, None

    system, law, _ = shape(2.0)
    found = ss.sensitivity(ss.stick_fraction, system, law, wrt="mu.a", t1=5.0, samples=20_000, key=jax.random.key(0))
    agree(found, difference(ss.stick_fraction, shape, 2.0, 0.3, 7, t1=5.0, samples=40_000))


@pytest.mark.slow
def test_recorded_sequences():
    system = oscillator(ss.Uniform(0.3, 0.7))
    options = {"wrt": "mu.high", "t1": T1, "samples": 20_000, "key": jax.random.key(0)}
    corrected, differences = (
        ss.sensitivity(ss.StickDuration(2), system, LAW, estimator=name, **options)
        for name in ("corrected", "finite-difference")
    )
    assert abs(corrected.derivative - differences.derivative) < 4 * np.hypot(
        corrected.standard_error, differences.standard_error
    )


@pytest.mark.slow
def test_a_differentiable_function_of_distributions():
    system = oscillator(ss.Uniform(0.3, 0.7))
    options = {"wrt": "mu.high", "t1": T1, "samples": 20_480, "key": jax.random.key(0)}
    mean_count = ss.differentiable(ss.mean_stick_count, system, LAW, **options)
    value, slope = jax.jit(jax.value_and_grad(mean_count))(0.7)
    found = ss.sensitivity(ss.mean_stick_count, system, LAW, estimator="corrected", **options)
    assert value == pytest.approx(found.value, rel=1e-12)
    assert abs(slope - found.derivative) < 4 * found.standard_error


@pytest.mark.slow
def test_what_is_not_known_is_refused():
    options = {"t1": 4.0, "samples": 256, "key": jax.random.key(0)}
    for system in (oscillator(ss.Uniform(0.3, 0.7), damping=0.5), oscillator(ss.Beta(2.0, 3.0))):
        wrt = "mu.high" if dataclasses.fields(system.friction.mu)[0].name == "low" else "mu.a"
        with pytest.raises(ValueError, match=r"\AArgument estimator must be 'finite-difference'"):
            ss.sensitivity(ss.mean_stick_count, system, LAW, wrt=wrt, estimator="corrected", **options)
    with pytest.raises(ValueError, match=r"'mu' was given; did you mean 'mu.low' or 'mu.high'\?"):
        ss.sensitivity(ss.mean_stick_count, oscillator(ss.Uniform(0.3, 0.7)), LAW, wrt="mu", **options)
