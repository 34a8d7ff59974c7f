"""Heavy damping, by a damper or by viscous friction: steps as short as it asks for, and no digits lost."""

from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

WEAKENING, START = ss.VelocityWeakening(0.5, 0.25), (-1.5, -2.0)


def slid(rates, t1, y0, changes=()):
    """The state at `t1` by an implicit solver; `rates` takes time, state and the number of the segment."""
    y, times = np.array(y0), [0.0, *changes, t1]
    for segment, (begin, end) in enumerate(pairwise(times)):
        found = solve_ivp(rates, (begin, end), y, "Radau", args=(segment,), rtol=1e-12, atol=1e-14)
        y = found.y[:, -1]
    return y


def weakening(velocities, damping):
    def rates(t, y, segment):
        slip = y[1] - velocities[segment]
        return [y[1], -y[0] - damping * y[1] - np.sign(slip) * 0.5 / (1 + 0.25 * abs(slip))]

    return rates


def final(system, base, t1, y0, method=None):
    one = ss.simulate(system, base, t1=t1, y0=y0, method=method or ss.Exact())
    assert one.status == ss.Status.FINISHED
    return np.array([float(value) for value in one.final_state])


@pytest.mark.slow
@pytest.mark.parametrize(
    "ratio", [256.0, *(pytest.param(ratio, marks=pytest.mark.slow) for ratio in (2.0, 16.0, 5000.0))]
)
def test_weakening_friction_with_heavy_damping(ratio):
    """No stick: the base is faster than the mass can ever be."""
    system = ss.MassSpring(1.0, 1.0, 1.0, WEAKENING, damping=2 * ratio)
    base = ss.PiecewiseConstant(jnp.array([0.0, 1.03]), jnp.array([4.0, -4.0]))
    right = slid(weakening((4.0, -4.0), 2 * ratio), 3.0, START, (1.03,))
    np.testing.assert_allclose(final(system, base, 3.0, START), right, rtol=0, atol=2e-11)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [pytest.param(1.0, marks=pytest.mark.slow), 12.0])
def test_viscous_friction_damps_too(exponent):
    law = ss.Stribeck(0.5, 0.6, 0.7, exponent=exponent, viscous=64.0)
    speed = 80.0  # the force of the base pulls the mass through the belt's speed never

    def rates(t, y, _):
        slip = y[1] - speed
        coefficient = 0.5 + 0.1 * np.exp(-((abs(slip) / 0.7) ** exponent)) + 64.0 * abs(slip)
        return [y[1], -1000 * y[0] - np.sign(slip) * coefficient]

    right = slid(rates, 0.5, START)
    found = final(ss.MassSpring(1.0, 1000.0, 1.0, law), ss.Constant(speed), 0.5, START)
    np.testing.assert_allclose(found, right, rtol=1e-9)


@pytest.mark.slow
def test_steep_friction_passed_fast_is_followed():
    """A mass with thirty times the friction force in its spring passes the Stribeck speed in a step or two."""
    law, method = ss.Stribeck(1.0, 1.5, 0.05, exponent=2.0), ss.Exact(max_steps=2048)
    system, base, start = ss.MassSpring(1.0, 1.0, 1.0, law, damping=0.1), ss.Constant(0.3), (30.0, -10.0)

    def rates(t, y, _):
        slip = y[1] - 0.3
        return [y[1], -y[0] - 0.1 * y[1] - np.sign(slip) * (1.0 + 0.5 * np.exp(-((slip / 0.05) ** 2)))]

    def cross(t, y, _):
        return y[1] - 0.3

    y, t = np.array(start), 0.0
    cross.terminal = True
    while t < 5.0:
        # Past a crossing by a Taylor step of 1e-7 s in the new direction, so that no event is found at its beginning.
        leg = solve_ivp(rates, (t, 5.0), y, "DOP853", args=(0,), events=cross, rtol=1e-13, atol=1e-13)
        t, y = leg.t[-1], leg.y[:, -1]
        if t < 5.0:
            sign, h = np.sign(-y[0] - 0.1 * 0.3), 1e-7
            force = -y[0] - 0.1 * y[1] - sign * 1.5
            y, t = y + h * np.array([y[1] + h / 2 * force, force]), t + h
    np.testing.assert_allclose(final(system, base, 5.0, start, method), y, rtol=0, atol=2e-8)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [1e3, 1e4])
@pytest.mark.parametrize("record", [True, False])
def test_closed_form_with_heavy_damping(damping, record):
    """A slow slip on a belt, to the last digits: the rate of creep is the small difference of two large ones."""
    times, values = np.array([0.0, 10.0, 20.0]), np.array([0.0, 3.0, -1.0])
    force = ss.Recorded(times, values) if record else None
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5), damping=damping, force=force)

    def rates(t, y, _):
        return [y[1], -y[0] - damping * y[1] - 0.5 + record * np.interp(t, times, values)]

    right = slid(rates, 20.0, (0.3, 0.0), (10.0,))
    np.testing.assert_allclose(final(system, ss.Constant(-2.0), 20.0, (0.3, 0.0)), right, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_single_precision_creeps_too():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5), damping=1e4)
    y0 = (jnp.float32(0.3), jnp.float32(0.0))
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        one = ss.simulate(system, ss.Constant(-2.0), t1=20.0, y0=y0, method=ss.Exact(step=0.3))
    assert one.final_state[0].dtype == jnp.float32
    assert float(one.final_state[0]) == pytest.approx(0.29840161, abs=3e-6)


@pytest.mark.slow
def test_given_steps_are_shortened_where_the_damping_is_not_known_before_the_call():
    """Under jit a step that is too long cannot be refused."""

    @partial(jax.jit, static_argnames="step")
    def last(damping, step):
        system = ss.MassSpring(1.0, 1.0, 1.0, WEAKENING, damping=damping)
        one = ss.simulate(system, ss.Constant(4.0), t1=3.0, y0=START, method=ss.Exact(step=step, max_steps=2048))
        return one.final_state, one.status

    (x, velocity), status = last(128.0, 0.1)
    right = slid(weakening((4.0,), 128.0), 3.0, START)
    assert status == ss.Status.FINISHED
    np.testing.assert_allclose([x, velocity], right, rtol=0, atol=1e-8)
    system = ss.MassSpring(1.0, 1.0, 1.0, WEAKENING, damping=128.0)
    with pytest.raises(ValueError, match="decay time of the slip speed"):
        ss.simulate(system, ss.Constant(4.0), t1=3.0, y0=START, method=ss.Exact(step=0.1))
