"""Corners of the engine of time steps: short slips after a release, edges that the last digits decide, steep rates."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import filled

import stickslip_jax as ss

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))

# Amplitude, angular frequency, phase, start, friction coefficient, end; and when the mass is released and caught again:
# bisection of the closed forms with 40 digits. The slips are 0.04 and 0.005 s long, at 2e-6 and 1e-8 m/s at most.
SHORT_SLIPS = {
    "0.04 s": (0.4544288068416024, 1.2777351273010398, 1.1590253814915463, -0.08322902543448689, 1.3453100571736638,
               1.661702934210451, 1.348435558500911, 1.387976786280524),
    "0.005 s": (0.4737603789937599, 2.6646999997857264, 5.88245166455496, -0.2833753756039578, 1.6542240791930698,
                1.309328087767774, 1.007529424938301, 1.012920571724408),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", SHORT_SLIPS.values(), ids=SHORT_SLIPS)
def test_a_short_slip_after_a_release_ends(case):
    """It begins with no relative velocity and no relative acceleration: at first its guard is below round-off."""
    amplitude, frequency, phase, x, mu, t1, released, caught = case
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu), damping=2.0)
    start = (x, amplitude * math.cos(phase))
    found = filled(ss.simulate(system, ss.Harmonic(amplitude, frequency, phase), t1=t1, y0=start))
    np.testing.assert_allclose(found.end, [released, t1], rtol=0, atol=1e-12)
    # The arrival is flat: the relative velocity's round-off over its slope there.
    np.testing.assert_allclose(found.start, [0, caught], rtol=0, atol=2e-10)


@pytest.mark.slow
def test_none_of_many_random_trajectories_stops_at_a_release():
    law = ss.RandomPhase(ss.Harmonic(0.23080255268519517, 0.7114265000773841))
    for damping, mu in ((2.0, 0.46328551824702774), (2.0, 1.3), (0.3, 0.3)):
        system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu), damping=damping)
        start = (ss.Uniform(-1.0, 1.0), ss.Uniform(-1.0, 1.0))
        run = {"t1": 60.0, "samples": 4000, "key": jax.random.key(1), "y0": start, "keep": "totals"}
        many = ss.simulate_ensemble(system, law, **run)
        assert many.finished == 4000
        longest = ss.simulate_ensemble(system, law, method=ss.Exact(step=0.1 * 2 * math.pi * 0.999999), **run)
        assert longest.finished == 4000


@pytest.mark.slow
@pytest.mark.parametrize("parts", [10.000001, 12, 16, 23])
def test_accepted_steps_give_the_same_sticks(parts):
    """With ten steps in a period each release is followed by a slip of 0.02 s that one step looks over."""
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.0))
    base, start = ss.Harmonic(1.0, 1.3, 3.4661262956957772), (0.22310950583778322, -0.8944186235312372)
    # As much space for steps in each case: compiled once.
    method = ss.Exact(step=2 * math.pi / 1.3 / parts, max_steps=1024)
    one = ss.simulate(system, base, t1=100.0, y0=start, method=method)
    assert one.status == ss.Status.FINISHED
    assert int(one.sticks.count) == 22


def test_longer_steps_are_refused():
    system, step = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.0)), ss.Exact(step=2 * math.pi / 1.3 / 8)
    with pytest.raises(ValueError, match=r"step must be at most 0\.4833 s, 0\.1 times the shortest period of the base"):
        ss.simulate(system, ss.Harmonic(1.0, 1.3), t1=1.0, method=step)


LANES = 2001


@jax.jit
@jax.vmap
def followed(amplitude, t1):
    method = ss.Exact(max_steps=1024)
    one = ss.simulate(SYSTEM, ss.Harmonic(amplitude, 1.3), t1=t1, y0=(0.0, 1.0), method=method)
    return one.sticks.count, one.near_grazing_count, one.sticks.start[1], one.sticks.end[0]


def seen(amplitudes, t1=20.0):
    """Sticks, doubts, start of the second stick and end of the first; all lanes of one compiled function are filled."""
    shape = np.broadcast_shapes(np.shape(amplitudes), np.shape(t1))
    filled_up = [np.resize(np.broadcast_to(values, shape), LANES) for values in (amplitudes, t1)]
    return [np.asarray(found)[: shape[0]] for found in followed(*filled_up)]


@pytest.mark.slow
def test_doubts_see_every_edge():
    """The amplitudes at which the number of sticks changes, bisected to neighbouring numbers: both sides are told."""
    grid = np.linspace(0.2, 3.0, LANES)
    number, near_grazing_count, *_ = seen(grid)
    changes = np.flatnonzero(np.diff(number))
    below, above, fewer = grid[changes], grid[changes + 1], number[changes]
    assert len(changes) >= 10
    assert np.count_nonzero(near_grazing_count) <= 2  # elsewhere there is none
    for _ in range(60):
        middle = below + (above - below) / 2
        same = seen(middle)[0] == fewer
        below, above = np.where(same, middle, below), np.where(same, above, middle)
    assert np.all(np.nextafter(below, 9.0) >= above)
    for side in (below, above):
        assert np.all(seen(side)[1] > 0)


@pytest.mark.slow
def test_doubts_see_races_with_the_horizon():
    """A stick (a slip) that ends within 1e-12 s of the horizon; and one that does not."""
    number, _, start, end = seen([1.0])
    assert number == 2
    for event in (*start, *end):
        late = np.array([1e-12, -1e-12, 1e-3])
        assert np.array_equal(seen(1.0, event + late)[1] > 0, [True, True, False])


@pytest.mark.slow
def test_doubts_see_races_with_jumps_and_the_horizon():
    """A stick (a slip) that ends within 1e-12 s of a jump of the base, of the horizon; and one that does not."""
    base = ss.Harmonic(1.0, 1.3)
    one = filled(ss.simulate(SYSTEM, base, t1=20.0, y0=(0.0, 1.0)))
    assert len(one.end) == 2
    for event in (float(one.start[1]), float(one.end[0])):
        for late in (1e-12, -1e-12):
            assert ss.simulate(SYSTEM, base, t1=event + late, y0=(0.0, 1.0)).near_grazing_count > 0
            jumping = ss.WithJumps(base, ss.PiecewiseConstant(jnp.array([0.0, event + late]), jnp.array([0.0, 0.5])))
            assert ss.simulate(SYSTEM, jumping, t1=event + 1.0, y0=(0.0, 1.0)).near_grazing_count > 0
        assert ss.simulate(SYSTEM, base, t1=event + 1e-3, y0=(0.0, 1.0)).near_grazing_count == 0


class Fall(eqx.Module):
    """A friction curve from 0.5 at rest to 0.3, with the speed as a number of its own: compiled once for all speeds."""

    speed: Any

    def __call__(self, v):
        return 0.3 + 0.2 * jnp.exp(-((v / self.speed) ** 2))


CURVES = {0.1: (2e-9, 4e-9), 0.03: (2e-9, 4e-9), 0.01: (2e-9, 4e-9), 0.003: (2e-9, 4e-9)}


@pytest.mark.slow
@pytest.mark.parametrize("speed", [pytest.param(0.1, marks=pytest.mark.slow), 0.03, 0.01, 0.003])
def test_a_users_friction_curve_decides_about_the_step(speed):
    """Flat at rest, steep at `speed`: nothing of that is known beforehand. `Stribeck` knows it, and steps finely."""
    base, start, t1 = ss.Harmonic(0.6, 1.3), (0.0, 1.0), 20.0

    def sticks_of(friction, **method):
        system = ss.MassSpring(1.0, 4.0, 1.0, friction)
        one = ss.simulate(system, base, t1=t1, y0=start, method=ss.Exact(**method))
        assert one.status == ss.Status.FINISHED
        return filled(one), np.array([float(value) for value in one.final_state])

    known, final = sticks_of(ss.Stribeck(0.3, 0.5, speed, exponent=2.0), step=min(0.02, speed / 4), max_steps=1 << 15)
    found, reached = sticks_of(ss.FrictionCurve(Fall(speed)))
    assert len(known.start) == len(found.start) > 0
    start_error, end_error = CURVES[speed]
    np.testing.assert_allclose(found.start, known.start, rtol=0, atol=start_error)
    np.testing.assert_allclose(found.end, known.end, rtol=0, atol=end_error)
    np.testing.assert_allclose(reached, final, rtol=0, atol=1e-8)


class SecondContact(ss.SwitchedSystem):
    """A mass and spring with a second, regularised contact with the ground."""

    width: float

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    @property
    def shortest_time(self):
        return math.pi

    def rates(self, t, y, base, friction):
        return y[1], -4 * y[0] - 0.3 * friction - 0.2 * jnp.tanh(y[1] / self.width)

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@pytest.mark.slow
def test_steep_rates_of_a_users_system_are_followed_or_told():
    def follow(width, **method):
        run = {"t1": 10.0, "y0": (0.0, 1.0), "method": ss.Exact(max_steps=1 << 16, **method)}
        return ss.simulate(SecondContact(width), ss.Harmonic(0.6, 1.3), **run)

    for width in (1e-1, 1e-3):
        one, fine = follow(width), follow(width, step=2e-4)
        assert one.status == fine.status == ss.Status.FINISHED
        pairs = zip(one.final_state, fine.final_state, strict=True)
        assert max(abs(float(a) - float(b)) for a, b in pairs) < 1e-8
    assert follow(1e-8).status == ss.Status.OUT_OF_STEPS
    with pytest.raises(ValueError, match="must be smooth functions of the state, but rate number 1 jumps"):
        follow(1e-12)


class Hung(ss.SwitchedSystem):
    """A mass that hangs at rest on a spring; another one, loosely coupled to it, rubs on a base."""

    coupling: float = 1e-3

    @property
    def state_names(self):
        return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

    def rates(self, t, y, base, friction):
        x1, v1, x2, v2 = y
        pull = self.coupling * (x2 - x1)
        return v1, 9.81 - 9.0 * x1 + pull, v2, -x2 - pull - 0.3 * friction

    def relative_velocity(self, t, y, base):
        return y[3] - base.velocity

    @property
    def shortest_time(self):
        return 2 * math.pi / 3


@pytest.mark.slow
def test_round_off_does_not_shorten_steps():
    """What is zero but for round-off has no relative error: a mass at rest under forces in balance, beside one that
    sticks for ever; a damped slip that has come to rest on a fast belt, friction in balance with the spring.
    """
    k = np.array([[9.0 + 1e-3, -1e-3], [-1e-3, 1.0 + 1e-3]])
    start = 9.81 / k[0, 0]  # in balance while the other one stays at 0
    one = ss.simulate(Hung(), ss.Constant(0.0), t1=100.0, y0=(start, 0.0, 0.0, 0.0))
    assert (one.status, one.sticks.count, one.stick_fraction) == (ss.Status.FINISHED, 1, 1)
    assert float(one.final_state[0]) == pytest.approx(start, abs=1e-12)

    friction = ss.FrictionCurve(Fall(0.3))
    system = ss.MassSpring(1.0, 1.0, 1.0, friction, damping=1.0)
    one = ss.simulate(system, ss.Constant(5.0), t1=200.0, y0=(1.0, 0.0))
    assert (one.status, one.sticks.count) == (ss.Status.FINISHED, 0)
    np.testing.assert_allclose(one.final_state, [0.3, 0.0], atol=1e-12)


@pytest.mark.slow_for("0.001")
@pytest.mark.parametrize("mass", [0.01, 1e-3])
def test_an_overdamped_valve_is_not_near_grazing(mass):
    """It slides at (F - mu N) / c as the force F lets it, slowly, and so comes to rest with a small deceleration.

    The velocity falls through zero all the same: nothing is uncertain. Once the fast decay is over, c x' = 50 cos t - 2
    sgn x' - k x with c = 1e6 N s/m and k x below 1e-4 N; so it rests while |50 cos t| < 2 N, from acos(2 / 50) on.
    """
    valve = ss.MassSpring(mass, 1.0, 10.0, ss.Coulomb(0.2), damping=1e6, force=ss.Harmonic(50.0, 1.0))
    one = ss.simulate(valve, ss.Constant(0.0), t1=8.0)
    starts = math.acos(2 / 50) + math.pi * np.arange(3)
    assert one.sticks.start[one.sticks.mask] == pytest.approx(starts, abs=1e-5)
    assert one.sticks.duration[one.sticks.mask][:2] == pytest.approx(2 * math.asin(2 / 50), abs=1e-5)
    assert int(one.near_grazing_count) == 0
