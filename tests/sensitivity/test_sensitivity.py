"""Sensitivities against large finite differences with common random numbers, and against exact answers."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._numerics.elementary import random_words, uniform
from stickslip_jax._sensitivity.boundaries import one_sided_kernel, two_sided_kernel

STATISTICS = {
    "count": ss.mean_stick_count,
    "pooled": ss.mean_stick_duration,
    "first": ss.StickDuration(1, count_initial_rest=True),
}
POISSON = ("speed", "rate", "mu")  # in one order everywhere: compiled once
# |difference| / combined standard error: 4 is passed by chance once in 16,000 independent comparisons.
AGREE = 4.0


class SquareWithPhase(ss.PiecewiseConstantLaw):
    """A square wave that begins anywhere in its half period."""

    speed: float
    period: float
    is_random = True

    def begin(self, key_data, dtype):
        high, _ = random_words(key_data, jnp.asarray(0xFFFFFFFF, jnp.uint32))
        return jnp.ones((), dtype), uniform(high, dtype)

    def draw(self, key_data, number, dtype):
        return ()

    def next_interval(self, memory, drawn, dtype):
        sign, part = memory
        return part * self.period / 2, sign * self.speed, (-sign, jnp.ones((), dtype))

    def capacity(self, t1):
        return math.ceil(2 * float(t1) / float(self.period)) + 2


def oscillator(w: float, **more) -> ss.MassSpring:
    """Omega = 2 rad/s; at base speed 1 m/s the dimensionless speed is w."""
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(4 / (2 * w)), **more)


def anywhere(w: float):
    """Initial states on and beyond the stick band."""
    a = 1 / (2 * w)
    return (ss.Uniform(-a - 0.3, a + 0.3), ss.Uniform(-0.9, 0.9))


def poisson(w, rate, t1=50.0):
    return {"system": oscillator(w), "law": ss.PoissonSwitching(1.0, 2 * rate), "t1": t1, "y0": anywhere(w)}


def z_score(one, other) -> float:
    """Difference by its standard error. With common random numbers the errors are correlated, which makes it smaller:
    the two runs here have different keys.
    """
    return (one.derivative - other.derivative) / math.hypot(one.standard_error, other.standard_error)


def compare(statistic, wrt, samples, step, case, factor=1, **more):
    """Corrected (with `more`) and finite-difference results of one case, by different random numbers."""
    case = dict(case)
    system, law = case.pop("system"), case.pop("law")
    corrected = ss.sensitivity(
        STATISTICS[statistic], system, law, wrt=wrt, samples=samples, key=jax.random.key(11), estimator="corrected",
        **case, **more,
    )  # fmt: skip
    differences = ss.sensitivity(
        STATISTICS[statistic], system, law, wrt=wrt, samples=factor * samples, key=jax.random.key(12), step=step,
        estimator="finite-difference", **case,
    )  # fmt: skip
    return corrected, differences


@pytest.mark.parametrize(("w", "rate"), [pytest.param(0.6, 0.5, marks=pytest.mark.slow), (1.4, 1.0)])
def test_poisson_switching(w, rate):
    """Count and pooled mean duration, by mu, speed and rate; the pathwise derivative alone fails the same test."""
    for statistic in ("count", "pooled"):
        corrected, differences = compare(statistic, POISSON, 16_384, 0.005, poisson(w, rate), 4)
        for name, result in corrected.items():
            assert abs(z_score(result, differences[name])) < AGREE, (statistic, name)
            assert result.derivative == pytest.approx(result.pathwise + result.event, rel=1e-12)
        for name in ("mu", "speed"):
            error = math.hypot(corrected[name].standard_error, differences[name].standard_error)
            assert abs(corrected[name].pathwise - differences[name].derivative) > AGREE * error, (statistic, name)


@pytest.mark.slow
@pytest.mark.parametrize("statistic", [ss.mean_stick_count, ss.mean_stick_duration], ids=lambda one: one.name)
def test_rate_with_starts_that_hardly_differ(statistic):
    """Random starts change the engine, not the estimator by the rate, which rests on the likelihood of the switches."""
    case = poisson(1.4, 1.0, 20.0)
    options = {"wrt": "rate", "t1": 20.0, "samples": 4_096, "key": jax.random.key(5), "estimator": "corrected"}
    fixed = ss.sensitivity(statistic, case["system"], case["law"], y0=(0.2, 0.3), **options)
    start = (ss.Uniform(0.2, 0.2 + 1e-12), 0.3)
    spread = ss.sensitivity(statistic, case["system"], case["law"], y0=start, **options)
    assert spread.sticks_in_window == fixed.sticks_in_window > 20_000
    assert spread.derivative == pytest.approx(fixed.derivative, rel=1e-8)
    assert spread.standard_error == pytest.approx(fixed.standard_error, rel=1e-8)
    uncertain = ss.PoissonSwitching(1.0, ss.Uniform(1.0, 3.0))
    with pytest.raises(ValueError, match=r"\AArgument estimator must be 'finite-difference' \(the default here\)"):
        ss.sensitivity(statistic, case["system"], uncertain, **options | {"wrt": "rate.low"})


# w from 0.3 to 5 and rate/omega from 0.1 to 2. Not among them: w = 1 and w = 2, where the derivative of the mean count
# does not exist (see docs/sensitivity.md).
POINTS = [(0.3, 0.1), (0.3, 1.0), (0.6, 2.0), (0.8, 0.3), (1.3, 0.1), (1.3, 2.0), (1.8, 0.5), (2.3, 0.2), (3.2, 0.3),
          (3.2, 1.0), (5.0, 0.2), (5.0, 2.0)]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("w", "rate"), POINTS)
def test_poisson_switching_at_many_points(w, rate):
    for statistic in ("count", "pooled", "first"):
        samples = 4_096 if statistic == "first" else 65_536
        corrected, differences = compare(statistic, POISSON, samples, 0.004, poisson(w, rate, 60.0), 4)
        for name, result in corrected.items():
            assert abs(z_score(result, differences[name])) < AGREE, (statistic, name)


OTHER = {
    "random steps": (
        {"system": oscillator(2.2), "law": ss.RandomSteps(1.0, 1.1), "t1": 40.0, "y0": anywhere(2.2)},
        ("mu", "speed"),
    ),
    "random steps, three levels": (
        {
            "system": oscillator(2.2),
            "law": ss.RandomSteps(1.0, 1.3, levels=(-1.0, 0.5, 1.0)),
            "t1": 40.0,
            "y0": anywhere(2.2),
        },
        ("mu", "speed"),
    ),
    "square wave with phase": (
        {"system": oscillator(2.2), "law": SquareWithPhase(1.0, 2.856), "t1": 40.0, "y0": anywhere(2.2)},
        ("mu", "speed", "period"),
    ),
    "harmonic with phase": (
        {
            "system": oscillator(2.2),
            "law": ss.RandomPhase(ss.Harmonic(1.0, 1.3)),
            "t1": 20.0,
            "y0": anywhere(2.2),
        },
        ("mu", "amplitude", "angular_frequency"),
    ),
    "damped": (
        {
            "system": oscillator(2.2, damping=0.1),
            "law": ss.PoissonSwitching(1.0, 1.0),
            "t1": 20.0,
            "y0": anywhere(2.2),
        },
        ("mu", "speed", "rate", "damping"),
    ),
    "harmonic and jumps": (
        {
            "system": oscillator(2.2),
            "law": ss.WithJumps(ss.Harmonic(0.3, 1.3), ss.PoissonSwitching(1.0, 1.0)),
            "t1": 20.0,
            "y0": (0.0, 0.5),
        },
        ("mu", "speed", "amplitude"),
    ),
    "weakening": (
        {
            "system": ss.MassSpring(1.0, 4.0, 1.0, ss.VelocityWeakening(0.9, 0.5)),
            "law": ss.PoissonSwitching(1.0, 1.0),
            "t1": 10.0,
            "y0": anywhere(2.2),
        },
        ("mu_static", "weakening"),
    ),
    "motor and cart": (
        {
            "system": ss.MotorCart(mu=0.2),
            "law": ss.RandomPhase(ss.SourceVoltage()),
            "t1": 1.5,
            "y0": (ss.Uniform(0.0, 2 * math.pi), 0.0, 0.0),
        },
        ("mu", "cart_mass"),
    ),
}
# With random steps gaps are multiples of one interval, and the mean count is a rough function: its slope over some per
# cent is not that at a point (docs/sensitivity.md). So there both methods look closely, and take many samples for it.
CLOSELY = {"random steps": 1e-4, "random steps, three levels": 1e-3}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:mu and cart_mass act on this only through their product")  # as they do
@pytest.mark.parametrize("name", OTHER)
def test_other_bases(name):
    case, wrt = OTHER[name]
    counted = name.startswith(("random", "square"))
    for statistic in ("count", "pooled", "first"):
        samples, more, step = 8_192, {}, 0.004
        if counted and statistic != "first":
            samples = 32_768
            if name in CLOSELY:
                samples, more, step = 1 << 20, {"relative_bandwidth": CLOSELY[name]}, CLOSELY[name] / 3
        corrected, differences = compare(statistic, wrt, samples, step, case, 4, **more)
        for parameter, result in corrected.items():
            assert abs(z_score(result, differences[parameter])) < AGREE, (statistic, parameter)


@pytest.mark.slow
def test_static_friction():
    """Where a stick holds more than a slip meets, a graze changes all that follows; against ensembles of other random
    numbers. Even the stick fraction has an event part there.
    """
    law, options = ss.PoissonSwitching(1.0, 1.0), {"t1": 20.0, "y0": anywhere(2.2)}

    def system(mu_static):
        return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9, mu_static=mu_static))

    step = 0.03
    ends = [
        ss.simulate_ensemble(
            system(1.1 + sign * step), law, samples=131_072, key=jax.random.key(5), keep="totals", **options
        )
        for sign in (-1, 1)
    ]
    for statistic in (ss.mean_stick_count, ss.mean_stick_duration, ss.stick_fraction):
        corrected = ss.sensitivity(
            statistic, system(1.1), law, wrt=("mu", "mu_static"), samples=32_768, key=jax.random.key(6),
            estimator="corrected", **options,
        )["mu_static"]  # fmt: skip
        low, high = (statistic(end) for end in ends)
        # As if the ends were independent, which is more than the error of their difference.
        error = math.hypot(low.standard_error, high.standard_error) / (2 * step)
        assert abs(corrected.derivative - (high.value - low.value) / (2 * step)) < AGREE * (
            corrected.standard_error + error
        ), statistic
        if statistic is not ss.mean_stick_duration:
            assert abs(corrected.event) > AGREE * corrected.standard_error, statistic


@pytest.mark.slow
def test_standard_errors_are_honest():
    """z-scores of 200 independent repeats: mean 0 within 4 / sqrt(200), standard deviation 1 within 4 / sqrt(400)."""
    case = poisson(1.4, 1.0, 20.0)
    system, law = case.pop("system"), case.pop("law")
    options = {"wrt": ("mu", "rate"), "relative_bandwidth": 0.01, **case}
    for statistic in (ss.mean_stick_count, ss.mean_stick_duration):
        exact = ss.sensitivity(statistic, system, law, samples=1_000_000, key=jax.random.key(1000), **options)
        repeats = [
            ss.sensitivity(statistic, system, law, samples=2_048, key=jax.random.key(number), **options)
            for number in range(200)
        ]
        for name in exact:
            scores = np.array([z_score(one[name], exact[name]) for one in repeats])
            assert abs(scores.mean()) < 4 / math.sqrt(200), name
            assert abs(scores.std() - 1) < 4 / math.sqrt(400), name


@pytest.mark.slow
def test_user_functional_and_realization_means():
    """The number of sticks as a user's functional is the number of sticks; realisation means against differences."""
    case = poisson(1.4, 1.0, 12.0)
    system, law = case.pop("system"), case.pop("law")
    options = {"wrt": "mu", "samples": 4_096, **case}
    number = ss.StickFunctional(lambda sticks: jnp.sum(sticks.mask), "number")
    recorded = ss.sensitivity(number, system, law, key=jax.random.key(3), estimator="corrected", **options)
    counted = ss.sensitivity(ss.mean_stick_count, system, law, key=jax.random.key(4), **options)
    assert abs(z_score(recorded, counted)) < AGREE
    assert recorded.pathwise == 0
    mean = ss.RealizationMeanDuration()
    corrected = ss.sensitivity(mean, system, law, key=jax.random.key(3), estimator="corrected", **options)
    differences = ss.sensitivity(mean, system, law, key=jax.random.key(5), **options)
    assert abs(z_score(corrected, differences)) < AGREE


@pytest.mark.slow
def test_stick_time_has_no_event_part():
    """Fraction and total time are continuous; elasticities are derivatives in other units."""
    case = poisson(1.4, 1.0)
    system, law = case.pop("system"), case.pop("law")
    options = {"wrt": "mu", "samples": 16_384, "key": jax.random.key(3), **case}
    fraction = ss.sensitivity(ss.stick_fraction, system, law, **options)
    total = ss.sensitivity(ss.mean_total_stick_time, system, law, **options)
    relative = ss.sensitivity(ss.stick_fraction, system, law, elasticity=True, **options)
    assert fraction.event == 0
    assert total.derivative == pytest.approx(50 * fraction.derivative, rel=1e-12)
    mu = system.friction.mu
    assert relative.derivative == pytest.approx(fraction.derivative * mu / fraction.value, rel=1e-12)
    assert relative.is_elasticity
    assert fraction.finished_fraction == 1
    pooled = ss.sensitivity(ss.mean_stick_duration, system, law, elasticity=True, **options)
    count = ss.sensitivity(ss.mean_stick_count, system, law, elasticity=True, **options)
    # log(mean) = log(time) - log(count)
    assert pooled.derivative == pytest.approx(relative.derivative - count.derivative, rel=1e-9)


@pytest.mark.slow
def test_elasticities_are_derivatives_in_other_units():
    """``d log statistic / d log mu``, and its error, of statistics that one compiled function serves."""
    case = poisson(1.4, 1.0)
    mu = float(case["system"].friction.mu)
    options = {"wrt": "mu", "samples": 2_048, "key": jax.random.key(3), **case}
    for statistic in (ss.mean_stick_count, ss.mean_stick_duration):
        plain, relative = (ss.sensitivity(statistic, elasticity=choice, **options) for choice in (False, True))
        assert relative.is_elasticity
        assert not plain.is_elasticity
        assert relative.derivative == pytest.approx(plain.derivative * mu / plain.value, rel=1e-12)


@pytest.mark.slow
def test_independent_of_threads_chunks_and_other_parameters():
    case = poisson(1.4, 1.0)
    system, law = case.pop("system"), case.pop("law")
    options = {"wrt": "mu", "samples": 16_384, "key": jax.random.key(3), **case}
    one, two = (ss.sensitivity(ss.mean_stick_count, system, law, threads=2, **options) for _ in range(2))
    options["wrt"] = POISSON
    other = ss.sensitivity(ss.mean_stick_count, system, law, threads=1, chunk=8192, **options)["mu"]
    assert (one.value, one.derivative, one.standard_error) == (two.value, two.derivative, two.standard_error)
    assert other.derivative == pytest.approx(one.derivative, rel=1e-9)
    assert other.standard_error == pytest.approx(one.standard_error, rel=1e-9)


@pytest.mark.parametrize("kernel", [two_sided_kernel, one_sided_kernel])
def test_kernels_on_a_uniform_number(kernel):
    """``P(c theta - U > 0) = c theta`` for U uniform on [0, 1]: its derivative is c, whatever c's size."""
    numbers = (np.arange(200_000) + 0.5) / 200_000
    theta = 0.5
    for c in (0.7, -0.7):

        def count(theta, c=c):
            distance = c * (theta - 0.5) + 0.5 - numbers
            seen = jnp.ones(len(numbers), bool) if kernel is two_sided_kernel else distance > 0
            return jnp.mean(kernel(distance, jnp.asarray(0.1), seen))

        value, slope = jax.jvp(count, (theta,), (1.0,))
        assert value == 0
        assert slope == pytest.approx(c, rel=1e-3)


@pytest.mark.slow
def test_exact_grazing_is_told():
    """From rest at the spring's zero at w = 1 the first arc has R = w: mu up, a stick; mu down, none."""
    with pytest.warns(RuntimeWarning, match="with respect to mu does not exist: 100%"):
        result = ss.sensitivity(
            ss.mean_stick_count, oscillator(1.0), ss.PoissonSwitching(1.0, 1.0), wrt="mu", t1=20.0,
            samples=4_096, key=jax.random.key(0), y0=(0.0, 0.0),
        )  # fmt: skip
    assert math.isnan(result.derivative)
    assert math.isfinite(result.pathwise)


@pytest.mark.slow
def test_few_sticks_are_told():
    case = poisson(1.4, 1.0, 2.0)
    system, law = case.pop("system"), case.pop("law")
    with pytest.warns(RuntimeWarning, match="rests on [0-9]+ sticks only"):
        ss.sensitivity(ss.mean_stick_count, system, law, wrt="mu", samples=64, key=jax.random.key(0), **case)


@pytest.mark.slow
def test_differentiable_gives_the_corrected_derivative():
    """By reverse mode under jit, the same as `sensitivity` with the same windows and random numbers."""
    case = poisson(1.4, 1.0)
    system, law = case.pop("system"), case.pop("law")
    options = {"wrt": "mu", "samples": 8_192, "key": jax.random.key(3), **case}
    estimate = ss.differentiable(ss.mean_stick_duration, system, law, **options)
    value, gradient = jax.jit(jax.value_and_grad(estimate))(system.friction.mu)
    result = ss.sensitivity(ss.mean_stick_duration, system, law, **options)
    assert value == pytest.approx(result.value, rel=1e-12)
    # The call may have taken the narrower of its two windows.
    assert abs(gradient - result.derivative) < AGREE * result.standard_error
    assert abs(gradient - result.pathwise) > AGREE * result.standard_error


@pytest.mark.slow
def test_differentiable_in_several_parameters():
    """Forward mode, reverse mode and recorded sequences."""
    case = poisson(1.4, 1.0, 12.0)
    system, law = case.pop("system"), case.pop("law")
    options = {"wrt": ("mu", "rate"), "samples": 4_096, "key": jax.random.key(3), **case}
    point = jnp.array([system.friction.mu, law.rate])
    for statistic in (ss.mean_stick_duration, ss.StickDuration(1)):
        estimate = ss.differentiable(statistic, system, law, **options)
        value, gradient = jax.jit(jax.value_and_grad(estimate))(point)
        _, forward = jax.jvp(estimate, (point,), (jnp.array([1.0, 0.0]),))
        results = ss.sensitivity(statistic, system, law, estimator="corrected", **options)
        assert value == pytest.approx(results["mu"].value, rel=1e-12)
        assert float(forward) == pytest.approx(float(gradient[0]), rel=1e-9)
        for index, result in enumerate(results.values()):
            assert abs(gradient[index] - result.derivative) < AGREE * result.standard_error
