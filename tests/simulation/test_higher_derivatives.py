"""Second and third derivatives through events, in every mode, against differences of the derivatives one order lower.

First derivatives are compared with other references in `test_derivatives.py` and `test_motion.py`. The end of the
motion on a harmonic base is compared with an integration by SciPy too.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import stickslip_jax as ss

STEPS = ss.Exact(max_steps=384)


class Case(NamedTuple):
    """A simulation as a function of some numbers, and the scale of each."""

    simulate: Callable[..., ss.Simulation]
    at: tuple[float, ...]
    scales: tuple[float, ...]


class Pendulum(ss.SwitchedSystem):
    """A nonlinear spring, damping, and a friction force that falls with the relative speed."""

    mu: Any

    @property
    def state_names(self):
        return "angle in rad", "angular velocity in rad/s"

    def rates(self, t, y, base, friction):
        kinetic = self.mu * (0.6 + 0.4 / (1 + jnp.abs(y[1] - base.velocity)))
        return y[1], -4 * jnp.sin(y[0]) - 0.1 * y[1] - friction * kinetic

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def static_ratio(self):
        return 1.1

    @property
    def shortest_time(self):
        return 3.1


def spring(friction, t1, **options):
    def run(x0, mu, tone):
        system = ss.MassSpring(1.0, 4.0, 1.0, friction(mu), **options)
        return ss.simulate(system, ss.Harmonic(1.0, tone, 0.4), t1=t1, y0=(x0, 0.2), method=STEPS)

    return run


def on_steps(durations, speed, mu):
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu, 1.3 * mu), damping=0.1)
    base = ss.VelocitySteps(durations * jnp.asarray([1.0, 1.4, 0.8, 2.0]), speed * jnp.asarray([1.0, -1.0, 0.5, -0.7]))
    return ss.simulate(system, base, t1=5.0 * durations, y0=(0.3, 0.2), method=STEPS)


def cart(angle, mu, current):
    return ss.simulate(ss.MotorCart(mu=mu), ss.SourceVoltage(), t1=0.8, y0=(angle, 0.0, current), method=STEPS)


def pendulum(x0, mu, tone):
    return ss.simulate(Pendulum(mu), ss.Harmonic(1.0, tone, 0.4), t1=6.0, y0=(x0, 0.2), method=STEPS)


def intervals(x0, mu, speed):
    base = ss.VelocitySteps(jnp.asarray([1.7, 0.9, 2.0, 2.5]), speed * jnp.asarray([1.0, -1.0, 0.5, -0.7]))
    return ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), base, t1=6.5, y0=(x0, 0.2))


HARMONIC = Case(spring(ss.Coulomb, 6.0), (0.3, 0.5, 1.3), (1.0, 1.0, 1.0))
CASES = {
    "harmonic base": HARMONIC,
    "damped, static friction": Case(spring(lambda mu: ss.Coulomb(mu, 1.2 * mu), 6.0, damping=0.2), *HARMONIC[1:]),
    "constant velocities": Case(on_steps, (1.2, 0.5, 0.4), (1.0, 1.0, 1.0)),
    "Stribeck": Case(spring(lambda mu: ss.Stribeck(mu, 1.3 * mu, 0.5), 6.0), *HARMONIC[1:]),
    "cart": Case(cart, (0.7, 0.3, 0.05), (1.0, 1.0, 0.1)),
    "own system": Case(pendulum, (0.3, 0.5, 1.3), (1.0, 1.0, 1.0)),
    "closed form of intervals": Case(intervals, (3.3, 0.5, 0.5), (1.0, 1.0, 1.0)),
}


def outcome(case: Case):
    """Events, positions of sticks and the end state, by the numbers over their scales."""

    def of(point):
        done = case.simulate(*(point * jnp.asarray(case.scales)))
        sticks = [jnp.where(done.sticks.mask, v, 0.0)[:6] for v in done.sticks.__dict__.values() if v.dtype == float]
        return jnp.concatenate([*sticks, jnp.stack(done.final_state)])

    return of


def start_of(case: Case):
    return jnp.asarray(case.at) / jnp.asarray(case.scales)


def differences(function, at, direction, step=2e-4):
    """The derivative along `direction`, by differences of fourth order."""
    values = [np.asarray(function(at + k * step * direction)) for k in (-2, -1, 1, 2)]
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step)


def assert_close(got, expected):
    size = np.max(np.abs(expected))
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * (1 + size))


def by_scipy(x0: float) -> float:
    """The position at 6 s of the first case, integrated by SciPy from event to event."""

    def velocity(t):
        return np.cos(1.3 * t + 0.4)

    def needed(t, x):  # to stick, over the largest friction force
        return (-1.3 * np.sin(1.3 * t + 0.4) + 4 * x) / 0.5

    def travel(begin, t):
        return (np.sin(1.3 * t + 0.4) - np.sin(1.3 * begin + 0.4)) / 1.3

    t, y, sign = 0.0, np.array([x0, 0.2]), np.sign(0.2 - velocity(0.0))
    while t < 6:
        if sign == 0:
            grid = np.linspace(t, 6, 4001)[1:]
            free = np.abs(needed(grid, y[0] + travel(t, grid))) > 1
            if not free.any():
                return float(y[0] + travel(t, 6.0))
            first = grid[np.argmax(free)]
            end = brentq(
                lambda s: abs(needed(s, y[0] + travel(t, s))) - 1, max(t, first - 1e-3 * 6), first, xtol=1e-15, rtol=1e-15
            ) if abs(needed(max(t, first - 6e-3), y[0] + travel(t, max(t, first - 6e-3)))) < 1 else first
            x = y[0] + travel(t, end)
            t, y, sign = end, np.array([x, velocity(end)]), -np.sign(needed(end, x))
            continue

        def meets(s, y, sign=sign):
            return sign * (y[1] - velocity(s))

        meets.terminal, meets.direction = True, -1
        done = solve_ivp(
            lambda s, y, sign=sign: (y[1], -4 * y[0] - 0.5 * sign), (t, 6), y, "DOP853", rtol=1e-13, atol=1e-15,
            events=meets,
        )  # fmt: skip
        t, y = float(done.t[-1]), done.y[:, -1]
        if t < 6:
            sign = 0.0 if abs(needed(t, y[0])) <= 1 else -sign
    return float(y[0])


def test_hessian_on_a_harmonic_base():
    case = HARMONIC
    end = jax.jit(lambda point: case.simulate(*point).final_state[0])
    hessian = jax.jit(jax.hessian(end))(jnp.asarray(case.at))
    assert float(end(jnp.asarray(case.at))) == pytest.approx(by_scipy(0.3), abs=1e-10)
    bend = [by_scipy(0.3 + k * 2e-3) for k in (-2, -1, 0, 1, 2)] @ np.array([-1, 16, -30, 16, -1]) / (12 * 2e-3**2)
    assert float(hessian[0, 0]) == pytest.approx(0.39587, abs=1e-5) == pytest.approx(bend, abs=1e-5)
    slope = jax.jit(jax.grad(end))
    for column, direction in enumerate(jnp.eye(3)):
        assert_close(hessian[:, column], differences(slope, jnp.asarray(case.at), direction))


MODES = {
    "forward over forward": lambda f: jax.jacfwd(jax.jacfwd(f)),
    "forward over reverse": lambda f: jax.jacfwd(jax.jacrev(f)),
    "reverse over forward": lambda f: jax.jacrev(jax.jacfwd(f)),
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(f)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_second_and_third_derivatives(name):
    """Of all events, along one direction; the third in forward mode, and in reverse mode over it."""
    case = CASES[name]
    of, at = outcome(case), start_of(case)
    direction = jnp.asarray([0.7, 0.3, -0.2])

    def along(f):
        return lambda point: jax.jvp(f, (point,), (direction,))[1]

    first, second, third = along(of), along(along(of)), along(along(along(of)))
    first, second, third = map(jax.jit, (first, second, third))
    assert int(case.simulate(*case.at).sticks.count) >= 2
    assert_close(second(at), differences(first, at, direction))
    assert_close(third(at), differences(second, at, direction))


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", CASES)
def test_every_mode(name, mode):
    case = CASES[name]
    weights = jnp.asarray(np.random.default_rng(3).normal(size=len(outcome(case)(start_of(case)))))
    at, of = start_of(case), outcome(case)
    hessian = jax.jit(MODES[mode](lambda point: weights @ of(point)))(at)
    slope = jax.jit(jax.jacfwd(lambda point: weights @ of(point)))
    for column, direction in enumerate(jnp.eye(3)):
        assert_close(hessian[:, column], differences(slope, at, direction))
