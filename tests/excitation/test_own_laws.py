"""Laws of a user's own: equal neighbours are one interval, and what cannot be is reported, in ensembles as alone."""

import math
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.event_by_event import simulate_reference

import stickslip_jax as ss

KEY = jax.random.key(0)
SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(0.5))
T1, SAMPLES = 20.0, 64
OSCILLATOR = {"mass": 1, "stiffness": 4, "normal_force": 1, "mu": 0.5, "t1": T1, "position0": 0, "velocity0": 0}
CLOSED, STEPS, FIXED = ss.Exact(), ss.Exact(step=0.05), ss.Regularized(1e-2, step=2e-2)
METHODS = {"closed": CLOSED, "steps": STEPS, "fixed": FIXED, "adaptive": ss.Regularized(0.1)}
FAULTS = {
    "negative gap": (lambda gap: -gap, lambda v: v, ss.Status.BASE_INVALID),
    "gap of NaN": (lambda gap: math.nan * gap, lambda v: v, ss.Status.BASE_INVALID),
    "gap of 0": (lambda gap: 0 * gap, lambda v: v, ss.Status.BASE_TOO_SHORT),
    "velocity of NaN": (lambda gap: gap, lambda v: math.nan * v, ss.Status.BASE_INVALID),
    "infinite velocity": (lambda gap: gap, lambda v: math.inf * v, ss.Status.BASE_INVALID),
}


class Coins(ss.PiecewiseConstantLaw):
    """Velocities of either sign by the toss of a coin, after gaps of any length; one in twelve gaps may be at fault."""

    rate: float
    fault: str = eqx.field(static=True, default="")
    is_random = True

    def begin(self, key_data, dtype):
        return ()

    def draw(self, key_data, number, dtype):
        return self.uniforms(key_data, number, dtype)

    def next_interval(self, memory, drawn, dtype):
        for_gap, for_velocity = drawn
        gap, velocity = -jnp.log(for_gap) / self.rate, jnp.where(for_velocity < 0.5, -0.5, 0.5)
        if self.fault:
            wrong = for_velocity < 1 / 12
            of_gap, of_velocity, _ = FAULTS[self.fault]
            gap, velocity = jnp.where(wrong, of_gap(gap), gap), jnp.where(wrong, of_velocity(velocity), velocity)
        return gap, velocity, ()

    def capacity(self, t1):
        mean = float(self.rate) * float(t1)
        return math.ceil(mean + 6 * math.sqrt(mean) + 12)


class CoinSegments(ss.SegmentLaw):
    """The same motion, given as segments whose values may jump."""

    coins: Coins
    is_random = True
    jumps = True

    def segments(self, t1):
        return self.coins.capacity(t1)

    def begin(self, key_data, dtype):
        return ()

    def draw(self, key_data, number, dtype):
        return self.coins.draw(key_data, number, dtype)

    def next_segment(self, memory, drawn, dtype):
        return self.coins.next_segment(memory, drawn, dtype)


@cache
def intervals(law: Coins, number: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """Gaps and velocities (samples, intervals) as the law gives them, before anything is joined."""

    def interval(key, i):
        words = jax.random.key_data(key)
        return law.next_interval((), law.draw((words[0], words[1]), i, float), float)[:2]

    keys = jax.vmap(lambda i: jax.random.fold_in(KEY, i))(jnp.arange(SAMPLES))
    every = jax.jit(jax.vmap(jax.vmap(interval, (None, 0)), (0, None)))
    return tuple(np.asarray(column) for column in every(keys, jnp.arange(number, dtype=jnp.uint32)))


@cache
def ensemble(law, method=CLOSED):
    return ss.simulate_ensemble(SYSTEM, law, t1=T1, samples=SAMPLES, key=KEY, method=method, keep="sticks")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "method"),
    [
        pytest.param(Coins(1.0), CLOSED, id="closed"),
        pytest.param(Coins(1.0), STEPS, id="steps", marks=pytest.mark.slow),
        pytest.param(CoinSegments(Coins(1.0)), STEPS, id="segments", marks=pytest.mark.slow),
    ],
)
def test_neighbours_of_equal_velocity_are_one_interval(law, method):
    many = ensemble(law, method)
    joined = 0
    for sample in range(12):
        gaps, velocities = (column[sample] for column in intervals(Coins(1.0)))
        joined += int(np.sum(velocities[1:] == velocities[:-1]))
        expected = simulate_reference(**OSCILLATOR, durations=gaps, velocities=velocities).sticks
        mask = np.asarray(many.sticks.mask[sample])
        for name in ("start", "end", "position"):
            found = np.asarray(getattr(many.sticks, name)[sample])[mask]
            np.testing.assert_allclose(found, [float(getattr(stick, name)) for stick in expected], atol=1e-9)
        endings = [ss.Ending(int(code)).name for code in np.asarray(many.sticks.ending[sample])[mask]]
        assert endings == [stick.ending for stick in expected]
    assert joined > 100


@pytest.mark.slow
def test_a_sample_is_the_simulation_of_its_realization():
    law = Coins(1.0)
    many = ensemble(law)
    base = jax.vmap(lambda i: law.sample(jax.random.fold_in(KEY, i), T1))(jnp.arange(SAMPLES))
    alone = jax.vmap(lambda base: ss.simulate(SYSTEM, base, t1=T1))(base)
    np.testing.assert_array_equal(alone.sticks.count, many.flat_sticks.count)
    np.testing.assert_allclose(alone.stick_time, many.totals.stick_time, atol=1e-12)
    velocities = np.asarray(base.velocities)
    lasting = np.asarray(base.durations) > 0
    assert np.all((velocities[:, 1:] != velocities[:, :-1]) | ~lasting[:, 1:])
    assert int(np.max(np.sum(lasting, axis=1))) < law.capacity(T1)


CASES = [(fault, method) for fault in FAULTS for method in ("closed", "steps")]
CASES += [("negative gap", "fixed"), ("gap of 0", "adaptive"), ("velocity of NaN", "adaptive")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "method"),
    [pytest.param(*case, marks=() if case == ("negative gap", "closed") else pytest.mark.slow) for case in CASES],
)
def test_what_cannot_be_is_reported_sample_by_sample(fault, method):
    law, status = Coins(1.0, fault), FAULTS[fault][-1]
    many = ensemble(law, METHODS[method])
    gaps, velocities = intervals(law)
    sound = np.cumprod((gaps > 0) & np.isfinite(velocities), axis=1).astype(bool)
    wrong = int(np.sum(np.sum(gaps, axis=1, where=sound) < T1))
    assert SAMPLES / 4 < wrong < SAMPLES
    assert many.status_counts[status] == wrong
    assert many.finished == SAMPLES - wrong
    assert "duration" in status.meaning


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", ["next_interval", "next_segment"])
def test_realizations_that_cannot_be_are_refused(fault, kind):
    law = Coins(1.0, fault)
    law = law if kind == "next_interval" else CoinSegments(law)
    if fault == "gap of 0":
        durations = np.asarray(law.sample(KEY, 50.0).durations)
        ends = int(np.argmin(durations > 0))
        assert 0 < ends < len(durations)
        assert not np.any(durations[ends:])
        return
    with pytest.raises(
        ValueError, match=rf"Method {kind} of {type(law).__name__} must give durations above 0 .* number"
    ):
        law.sample(KEY, 50.0)


@pytest.mark.slow
@pytest.mark.parametrize("law", [Coins(1.0, "negative gap"), CoinSegments(Coins(1.0, "negative gap"))])
def test_realizations_drawn_under_jax_show_in_the_status(law):
    reported = jax.vmap(lambda key: ss.simulate(SYSTEM, law.sample(key, 50.0), t1=50.0).status)(KEY[None])
    assert ss.Status(int(reported[0])) is ss.Status.BASE_INVALID


@pytest.mark.slow
def test_derivatives_by_numbers_of_the_law():
    """By differences, with the same random numbers."""
    for method in (CLOSED, STEPS):
        found = ss.sensitivity(
            ss.stick_fraction, SYSTEM, Coins(1.0), wrt="rate", t1=T1, samples=SAMPLES, key=KEY, method=method
        )
        step = 1e-5
        ends = [
            ss.simulate_ensemble(SYSTEM, Coins(1.0 + sign * step), t1=T1, samples=SAMPLES, key=KEY, method=method)
            for sign in (-1, 1)
        ]
        low, high = (ss.stick_fraction(end).value for end in ends)
        assert found.derivative == pytest.approx((high - low) / (2 * step), rel=1e-4)


TIMES = jnp.arange(0.0, 30.0, 0.5)
SWINGS = jnp.cos(7 * TIMES)
MOTIONS = {
    "PiecewiseConstant": lambda bad: ss.PiecewiseConstant(jnp.where(bad, TIMES.at[5].set(1.0), TIMES), SWINGS),
    "PiecewiseConstant from 0.1 s": lambda bad: ss.PiecewiseConstant(TIMES + 0.1 * bad, SWINGS),
    "PiecewiseConstant of NaN": lambda bad: ss.PiecewiseConstant(TIMES, jnp.where(bad, jnp.nan, SWINGS)),
    "Recorded": lambda bad: ss.Recorded(jnp.where(bad, TIMES.at[5].set(1.0), TIMES), SWINGS),
    "Recorded of NaN": lambda bad: ss.Recorded(TIMES, jnp.where(bad, jnp.nan, SWINGS)),
    "VelocitySteps": lambda bad: ss.VelocitySteps(jnp.where(bad, TIMES - 3, 1.0), SWINGS),
    "VelocitySegments": lambda bad: ss.VelocitySegments(jnp.where(bad, TIMES - 3, 1.0), SWINGS, 0 * SWINGS),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_given_motions_under_jax(name):
    """Constructors check no numbers that JAX traces: the status of a simulation, and ensembles, tell."""
    make, bad = MOTIONS[name], np.array([False, True])
    with pytest.raises(ValueError, match=r"Argument (times|velocities|values|durations) must"):
        make(True)
    status = jax.vmap(lambda bad: ss.simulate(SYSTEM, make(bad), t1=T1).status)(bad)
    assert [ss.Status(int(code)).name for code in status] == ["FINISHED", "BASE_INVALID"]

    class Law:
        def sample(self, key, t1):
            return make(jax.random.uniform(key) < 0.2)

    first = next(i for i in range(64) if float(jax.random.uniform(jax.random.fold_in(KEY, i))) < 0.2)
    with pytest.raises(ValueError, match=f"Argument law must give realisations that fit, but sample {first}: Arg"):
        ss.simulate_ensemble(SYSTEM, Law(), t1=T1, samples=64, key=KEY)


class Runaway:
    """A base whose velocity has no value after 5 s."""

    def velocity(self, t):
        return jnp.sqrt(5 - t)

    def acceleration(self, t):
        return -0.5 / jnp.sqrt(5 - t)


class Hidden(Runaway):
    """A base whose acceleration has no value after 5 s."""

    shortest_period = 2 * np.pi

    def velocity(self, t):
        return jnp.sin(t)

    def acceleration(self, t):
        return jnp.where(t > 5, jnp.nan, jnp.cos(t))


@pytest.mark.slow
@pytest.mark.parametrize("base", [Runaway(), Hidden()], ids=lambda base: type(base).__name__)
@pytest.mark.parametrize("method", [STEPS, FIXED], ids=["steps", "fixed"])
def test_a_base_without_a_value_is_reported(base, method):
    one = ss.simulate(SYSTEM, base, t1=10.0, method=method)
    assert ss.Status(int(one.status)) is ss.Status.NOT_FINITE
    assert 5 <= float(one.time_reached) < 5.06  # the end of the step in which it happens


@pytest.mark.slow
def test_a_base_without_an_acceleration_in_adaptive_steps():
    """Which solve the motion without it, but find no stick where it is missing."""
    method = ss.Regularized(1e-2)
    one = ss.simulate(SYSTEM, Hidden(), t1=10.0, method=method)
    assert ss.Status(int(one.status)) is ss.Status.NOT_FINITE
    many = ss.simulate_ensemble(
        SYSTEM, Hidden(), t1=10.0, samples=3, key=KEY, y0=(ss.Uniform(0.0, 1.0), 0.0), method=method
    )
    assert many.status_counts[ss.Status.NOT_FINITE] == 3


class Nowhere(Runaway):
    """A base whose velocity never has a value."""

    shortest_period = 1.0

    def velocity(self, t):
        return jnp.nan * t

    def acceleration(self, t):
        return jnp.nan * t


@pytest.mark.slow
def test_adaptive_steps_tell_a_base_without_a_value_from_one_without_a_length():
    one = ss.simulate(SYSTEM, Nowhere(), t1=1.0, method=ss.Regularized(1e-2))
    assert ss.Status(int(one.status)) is ss.Status.NOT_FINITE
    none = ss.VelocitySteps(np.zeros(1), np.ones(1))
    assert int(ss.simulate(SYSTEM, none, t1=1.0, method=ss.Regularized(1e-2)).status) == ss.Status.BASE_TOO_SHORT


class Atoms(ss.RandomNumber):
    """One of two numbers, as likely as each other."""

    low: float
    high: float
    support = (0.1, 1.0)

    def icdf(self, u):
        return jnp.where(u < 0.5, self.low, self.high)

    def cdf(self, x):
        return jnp.where(x < self.low, 0.0, jnp.where(x < self.high, 0.5, 1.0)) * (x > 0)


@pytest.mark.slow
def test_distributions_of_ones_own_in_semi_markov_switching():
    speeds = ss.SemiMarkovSwitching(gap=ss.Exponential(1.0), speed=Atoms(-0.5, 0.5), alternating=False)
    base = speeds.sample(KEY, T1)
    lasting = np.asarray(base.velocities)[np.asarray(base.durations) > 0]
    assert np.all(lasting[1:] == -lasting[:-1])
    assert len(lasting) < 0.7 * speeds.capacity(T1)
    closed, steps = ensemble(speeds), ensemble(speeds, STEPS)
    np.testing.assert_array_equal(closed.totals.sticks, steps.totals.sticks)
    np.testing.assert_allclose(closed.totals.stick_time, steps.totals.stick_time, atol=1e-8)
    for law in (
        ss.SemiMarkovSwitching(gap=Atoms(-1.0, 1.0), speed=0.5),
        ss.SemiMarkovSwitching(gap=ss.Exponential(1.0), speed=Atoms(-0.5, 0.5)),
    ):
        assert ensemble(law).status_counts[ss.Status.BASE_INVALID] == SAMPLES - ensemble(law).finished
        assert ensemble(law).finished < SAMPLES / 4
