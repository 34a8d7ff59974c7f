"""Friction in one direction only: motions against SciPy's solver with events, and derivatives against differences."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import stickslip_jax as ss

MASS, STIFFNESS, MU, T1, START = 1.0, 4.0, 0.5, 20.0, (0.2, 0.1)
AMPLITUDE, OMEGA, SPEED = 0.3, 1.7, 0.15


def law(forward, backward, ratio=1.0):
    def coulomb(mu):
        return ss.Coulomb(mu, None if ratio == 1.0 else ratio * mu)

    return ss.Directional(coulomb(forward), coulomb(backward))


def belt(direction):
    return ss.Harmonic(AMPLITUDE, OMEGA, offset=direction * SPEED)


@cache
def by_scipy(forward, backward, direction, ratio=1.0):
    """Times at which sticks begin and end, and the state at T1, from one event to the next."""

    def base(t):
        return direction * SPEED + AMPLITUDE * np.cos(OMEGA * t), -AMPLITUDE * OMEGA * np.sin(OMEGA * t)

    def needed(t, y):
        return MASS * base(t)[1] + STIFFNESS * y[0]

    t, y, begins, ends = 0.0, np.array(START), [], []
    sign = np.sign(y[1] - base(0.0)[0])
    while t < T1:
        if sign == 0:
            # Needed forces are positive against slips backward.
            limits = (lambda t, y: needed(t, y) - ratio * backward), (lambda t, y: needed(t, y) + ratio * forward)
            limits[0].direction, limits[1].direction = 1, -1
        else:
            limits = ((lambda t, y: y[1] - base(t)[0]),)
            limits[0].direction = -sign
        for limit in limits:
            limit.terminal = True

        def rates(t, y, sign=sign):
            if sign == 0:
                return base(t)
            friction = forward if sign > 0 else -backward
            return y[1], (-STIFFNESS * y[0] - friction) / MASS

        found = integrate.solve_ivp(rates, (t, T1), y, "DOP853", events=limits, rtol=1e-12, atol=1e-13)
        t, y = found.t[-1], found.y[:, -1]
        if found.status == 0:
            break
        if sign == 0:
            ends.append(t)
            sign = -1 if len(found.t_events[0]) else 1
        else:
            y[1] = base(t)[0]
            force = needed(t, y)
            sign = -1 if force > ratio * backward else 1 if force < -ratio * forward else 0
            if sign == 0:
                begins.append(t)
    return np.array(begins), np.array(ends), y


def structure(friction):
    """The same mass, in a structure, beside one that it does not feel."""
    contacts = [ss.Contact([1.0, 0.0], 1.0, friction), ss.Contact([0.0, 1.0], 1.0, ss.Coulomb(0.3))]
    return ss.LinearStructure(mass=[MASS, 1.0], stiffness=[STIFFNESS, 1.0], contacts=contacts)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("forward", "backward"), [(MU, 0.0), (0.0, MU)])
@pytest.mark.parametrize("ratio", [1.0, 1.4])
def test_events_and_end(forward, backward, direction, ratio):
    begins, ends, state = by_scipy(forward, backward, direction, ratio)
    assert len(ends) > 1
    friction = law(forward, backward, ratio)
    one = ss.simulate(ss.MassSpring(MASS, STIFFNESS, 1.0, friction), belt(direction), t1=T1, y0=START)
    assert int(one.status) == ss.Status.FINISHED
    single = jnp.result_type(float) == jnp.float32
    tolerance = {"rtol": 1e-4, "atol": 2e-4} if single else {"rtol": 1e-9, "atol": 1e-9}
    ended = one.sticks.mask & (one.sticks.end < T1 * (1 - 1e-6))
    np.testing.assert_allclose(one.sticks.start[one.sticks.mask], begins, **tolerance)
    np.testing.assert_allclose(one.sticks.end[ended], ends, **tolerance)
    np.testing.assert_allclose([float(value) for value in one.evaluate(T1)], state, **tolerance)


@pytest.mark.slow
def test_in_a_structure_as_alone():
    """Beside another contact, which it does not feel."""
    friction, times = law(0.0, MU), jnp.linspace(0.0, T1, 41)
    both = ss.simulate(structure(friction), belt(1), t1=T1, y0=(START[0], 0.0, START[1], 0.0))
    assert int(both.status) == ss.Status.FINISHED
    alone = ss.simulate(ss.MassSpring(MASS, STIFFNESS, 1.0, friction), belt(1), t1=T1, y0=START)
    tolerance = 1e-3 if jnp.result_type(float) == jnp.float32 else 1e-9
    np.testing.assert_allclose(both.evaluate(times)[0], alone.evaluate(times)[0], atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1, -1])
def test_derivative_by_the_friction_of_the_other_direction(direction):
    def end(mu, simulated=True):
        if not simulated:
            return by_scipy(0.0, mu, direction)[2][0]
        system = ss.MassSpring(MASS, STIFFNESS, 1.0, law(0.0, mu))
        return ss.simulate(system, belt(direction), t1=T1, y0=START).evaluate(T1)[0]

    step = 1e-5
    slope = (end(MU + step, simulated=False) - end(MU - step, simulated=False)) / (2 * step)
    single = jnp.result_type(float) == jnp.float32
    np.testing.assert_allclose(jax.jacfwd(end)(MU), slope, rtol=1e-2 if single else 1e-5, atol=1e-5)
