"""Forces under a prescribed motion between the times at which they are asked: closed forms, and scipy's Radau."""

import itertools
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import stickslip_jax as ss

TONES = ss.SumOfHarmonics([0.1, 0.07], [2 * math.pi, 7.3], [0.3, 1.0])
PULSED = ss.Recorded([0.0, 50.0, 50.01, 50.02, 100.0], [0.0, 0.0, 1.0, 0.0, 0.0])
TO_AND_FRO = ss.Recorded([0, 0.2, 0.4, 0.6, 0.8, 1, 4], [0, 1, 0, -1, 0, 0, 0])


class Pulse(ss.Signal):
    """A short move of `size` times 0.02 sqrt(pi), m."""

    size: float = 0.5

    def value(self, t):
        return self.size * jnp.exp(-(((t - 37.3) / 0.02) ** 2))

    @property
    def shortest_period(self):
        return 0.05


def turns(velocity, first, last, longest):
    """The times at which a velocity changes its sign, found on a grid that is far denser than its period."""
    grid = np.linspace(first, last, math.ceil((last - first) / longest) + 1)
    values = velocity(grid)
    places = np.flatnonzero(values[:-1] * values[1:] < 0)
    return [brentq(velocity, grid[i], grid[i + 1], xtol=1e-14) for i in places]


def along(positions, times, turning, force):
    """The forces at `times` of what follows one-way moves: ``force(before, move)``."""
    marks, values, now = np.union1d(times, turning), {}, 0.0
    for begin, end in itertools.pairwise(marks):
        now = force(now, positions(end) - positions(begin))
        values[end] = now
    return np.array([values.get(t, 0.0) for t in times])


def tones(t):
    return 0.1 * np.cos(2 * math.pi * t + 0.3) + 0.07 * np.cos(7.3 * t + 1.0)


def moved(t):
    return 0.1 / (2 * math.pi) * np.sin(2 * math.pi * t + 0.3) + 0.07 / 7.3 * np.sin(7.3 * t + 1.0)


def sliding(most, least, stiffness, play):
    """An elastic slider with a free play: deflection of spring and play by its moves."""

    def after(deflection, move):
        return min(max(deflection + move, -least / stiffness - play), most / stiffness + play)

    return after


@pytest.mark.slow
def test_a_record_between_the_times():
    force = ss.Coulomb(0.3).force([0.0, 1, 2, 3, 4], TO_AND_FRO, 10.0, series_stiffness=40.0)
    np.testing.assert_allclose(force, [0, -3, -3, -3, -3], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("law", [ss.Coulomb(0.3), ss.Directional(ss.Coulomb(0.3), ss.Coulomb(0.5))])
@pytest.mark.parametrize("backlash", [0.0, 4e-3])
@pytest.mark.parametrize("seed", range(3))
def test_a_signal_that_turns_between_the_times(law, backlash, seed):
    """The play operator along the turning points of the motion, in closed form."""
    times = np.sort(np.random.default_rng(seed).uniform(0, 30, 8))
    turning = turns(tones, times[0], times[-1], 1e-3)
    assert len(turning) > 20
    least = 3.0 if isinstance(law, ss.Coulomb) else 5.0
    bent = along(moved, times, turning, sliding(3.0, least, 400.0, backlash / 2))
    expected = 400 * (bent - np.clip(bent, -backlash / 2, backlash / 2))
    found = law.force(times, TONES, 10.0, series_stiffness=400.0, backlash=backlash)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_turns_that_nearly_coincide():
    """A velocity that dips below zero for a hundredth of its period, between two pieces of it that are looked at."""
    w, dip = 2.0, math.cos(0.01 * math.pi)
    motion = ss.Harmonic(0.1, w, offset=0.1 * dip)
    times = np.array([0.0, 1.5925, 9.0])

    def velocity(t):
        return 0.1 * (np.cos(w * t) + dip)

    def position(t):
        return 0.1 * (np.sin(w * t) / w + dip * t)

    turning = turns(velocity, 0.0, 9.0, 1e-3)
    assert len(turning) == 6
    bent = along(position, times, turning, sliding(3.0, 3.0, 2.3e7, 0.0))
    found = ss.Coulomb(0.3).force(times, motion, 10.0, series_stiffness=2.3e7)
    np.testing.assert_allclose(found, 2.3e7 * bent, rtol=0, atol=1e-6)
    assert -2 < float(found[1]) < 2  # -3 N a moment ago, 3 N before that


@pytest.mark.slow
def test_derivatives_behind_a_spring():
    times = np.array([0.0, 3.3, 9.1, 20.0])

    def total(numbers, jitted=False):
        motion = ss.SumOfHarmonics(numbers[:2], jnp.stack([numbers[2], jnp.asarray(7.3)]), [0.3, 1.0])
        law, asked = ss.Coulomb(numbers[3]), np.linspace(0.0, 20.0, 41) if jitted else times
        force = law.force(asked, motion, 10.0, series_stiffness=numbers[4], backlash=1e-3)
        return jnp.sum(force * jnp.arange(1.0, 1 + len(asked)))

    numbers = jnp.array([0.1, 0.07, 2 * math.pi, 0.3, 400.0])
    backward, forward = jax.grad(total)(numbers), jax.jacfwd(total)(numbers)
    np.testing.assert_allclose(backward, forward, rtol=1e-10)
    few = 1e-6 * numbers
    differences = [(total(numbers + row) - total(numbers - row)) / (2 * row.sum()) for row in np.diag(few)]
    np.testing.assert_allclose(backward, differences, rtol=1e-5, atol=1e-5)
    # Under jit the period is not known: the times must be as dense as it, or the force is NaN.
    assert float(jax.jit(total, static_argnums=1)(numbers, True)) == pytest.approx(
        float(total(numbers, True)), rel=1e-9
    )
    assert np.isnan(jax.jit(total)(numbers))


def dahl(mu, stiffness, normal):
    def after(force, move):
        most = normal * mu * np.sign(move)
        return most + (force - most) * math.exp(-stiffness * abs(move) / mu)

    return after


@pytest.mark.slow
def test_short_moves_of_bristles():
    """One move of a record, and one of a signal: closed forms."""
    times, moves = np.linspace(0.0, 100.0, 11), {"record": 0.01, "signal": 0.01 * math.sqrt(math.pi)}
    law = ss.Dahl(0.3, 20.0)
    for name, motion in (("record", PULSED), ("signal", Pulse())):
        expected = np.where(times > (50 if name == "record" else 37), dahl(0.3, 20.0, 10.0)(0.0, moves[name]), 0.0)
        np.testing.assert_allclose(law.force(times, motion, 10.0), expected, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_short_moves_of_other_laws():
    times, slip = np.linspace(0.0, 100.0, 11), 20 * 0.01 / 0.3
    closed = {"BoucWen": 3 * math.tanh(slip), "ElastoPlastic": 2.0}  # the last one does not yield yet
    laws = {"BoucWen": ss.BoucWen(0.3, 20.0), "ElastoPlastic": ss.ElastoPlastic(0.3, 0.4, 0.1, 20.0)}
    for name, law in laws.items():
        np.testing.assert_allclose(law.force(times, PULSED, 10.0)[6:], closed[name], rtol=0, atol=1e-6)

    def speed(t):
        return max(1 - abs(t - 50.01) / 0.01, 0.0)

    def lugre(t, z):
        v = speed(t)
        return [v - 20 * v * z[0] / (0.3 + 0.1 * math.exp(-((v / 0.1) ** 2)))]

    def ageing(t, z):
        return [1e-3 * math.exp(-z[0]) - speed(t) / 1e-3]

    for rate, start, length, law in (
        (lugre, 0.0, 0.0, ss.LuGre(0.3, 0.4, 0.1, 20.0, 1.0)),
        (ageing, 0.0, 50.0, ss.DieterichRuina(0.6, 0.012, 0.017, length=1e-3, reference_speed=1e-6)),
    ):
        z = [start]
        for begin, end in itertools.pairwise((50.0 - length, 50.0, 50.01, 50.02, 60.0)):
            if begin < end:
                z = solve_ivp(rate, (begin, end), z, "Radau", rtol=1e-10, atol=1e-14).y[:, -1]
        inner = law.force(np.array([0.0, 60.0]), PULSED, 10.0)
        if rate is lugre:
            assert float(inner[1]) == pytest.approx(200 * z[0], abs=1e-6)
        # The force at rest of the other one is zero; a moment later, in slow motion, it shows the inner state.
    slow = ss.Recorded([0.0, 50.0, 50.01, 50.02, 60.0, 60.0 + 1e-9], [0.0, 0.0, 1.0, 0.0, 0.0, 1e-6])
    force = law.force(np.array([0.0, 60.0 + 1e-9]), slow, 10.0)[1]
    expected = 0.12 * math.asinh(0.5 * math.exp((0.6 + 0.017 * z[0]) / 0.012))
    assert float(force) == pytest.approx(expected, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "play"),
    [
        *itertools.product((ss.Dahl(0.3, 200.0), ss.BoucWen(0.3, 200.0)), (None, 0.0, 1e-3)),
        (ss.DieterichRuina(0.6, 0.012, 0.004, 1e-3, 1e-2), None),
    ],
)
def test_points_of_a_record_are_followed(law, play):
    """Whether or not the force is asked for there."""
    spring = {} if play is None else {"series_stiffness": 4e3, "backlash": play}
    source = np.random.default_rng(3)
    knots = np.append(0.0, np.cumsum(source.exponential(0.1, 40)))
    speeds = source.normal(size=41)
    motion = ss.Recorded(knots, 0.01 * np.exp(speeds) if isinstance(law, ss.DieterichRuina) else 0.05 * speeds)
    few, many = np.array([0.0, knots[13], knots[29], knots[-1]]), knots
    found = law.force(few, motion, 10.0, rtol=1e-9, **spring)
    every = law.force(many, np.asarray(motion.values), 10.0, rtol=1e-9, **spring)
    np.testing.assert_allclose(found, np.asarray(every)[[0, 13, 29, 40]], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_signal_that_turns_between_the_times_bends_bristles():
    times = np.array([0.0, 3.3, 9.1, 20.0])
    turning = turns(tones, 0.0, 20.0, 1e-3)
    expected = along(moved, times, turning, dahl(0.3, 20.0, 10.0))
    found = ss.Dahl(0.3, 20.0).force(times, TONES, 10.0, adjoint=diffrax.DirectAdjoint())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


class Unknown(ss.Signal):
    """A signal that does not tell its shortest period."""

    def value(self, t):
        return jnp.cos(t)


def test_what_is_refused():
    message = r"\AArgument velocity must have a property shortest_period \(s\), but a Unknown without one was given"
    for law, spring in ((ss.Coulomb(0.3), {"series_stiffness": 1.0}), (ss.Dahl(0.3, 20.0), {})):
        with pytest.raises(ValueError, match=message):
            law.force([0.0, 1.0], Unknown(), **spring)
    assert float(ss.Coulomb(0.3).force([0.0, 1.0], Unknown())[1]) == 0.3  # it has no memory
    with pytest.raises(
        ValueError, match=r"\AArgument times must span at most 262144 shortest periods .* but 1e\+06 were"
    ):
        ss.Coulomb(0.3).force([0.0, 2e6 * math.pi], ss.Harmonic(0.1, 1.0), series_stiffness=1.0)
