"""Second and third derivatives through events, in every mode, against differences of the derivatives one order lower.

First derivatives are compared with other references in `test_derivatives.py` and `test_motion.py`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

STEPS = ss.Exact(max_steps=384)


class Case(NamedTuple):
    """A simulation as a function of some numbers, and where it is differentiated."""

    simulate: Callable[..., ss.Simulation]
    at: tuple[float, ...]
    step: float = 2e-4  # of the differences


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
        return ss.simulate(system, ss.Harmonic(0.5, tone, 0.4), t1=t1, y0=(x0, 0.2), method=STEPS)

    return run


def on_steps(durations, speed, mu):
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu, 1.3 * mu), damping=0.1)
    base = ss.VelocitySteps(durations * jnp.asarray([1.0, 1.4, 0.8, 2.0]), speed * jnp.asarray([1.0, -1.0, 0.5, -0.7]))
    return ss.simulate(system, base, t1=5.0 * durations, y0=(0.3, 0.2), method=STEPS)


def cart(angle, mu, current):  # in units of 0.1 A
    return ss.simulate(ss.MotorCart(mu=mu), ss.SourceVoltage(), t1=0.8, y0=(angle, 0.0, 0.1 * current), method=STEPS)


def pendulum(x0, mu, tone):
    return ss.simulate(Pendulum(mu), ss.Harmonic(0.5, tone, 0.4), t1=6.0, y0=(x0, 0.2), method=STEPS)


def intervals(x0, mu, speed):
    base = ss.VelocitySteps(jnp.asarray([1.7, 0.9, 2.0, 2.5]), speed * jnp.asarray([1.0, -1.0, 0.5, -0.7]))
    return ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), base, t1=6.5, y0=(x0, 0.2))


def smoothed(x0, mu, tone):
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
    method = ss.Regularized(0.01, step=0.005)
    return ss.simulate(system, ss.Harmonic(0.5, tone, 0.4), t1=6.0, y0=(x0, 0.2), method=method)


POINT = (0.3, 0.8, 1.3)
CASES = {
    "harmonic base": Case(spring(ss.Coulomb, 6.0), POINT),
    "damped, static friction": Case(spring(lambda mu: ss.Coulomb(mu, 1.2 * mu), 6.0, damping=0.2), POINT),
    "constant velocities": Case(on_steps, (1.2, 0.5, 0.4)),
    "Stribeck": Case(spring(lambda mu: ss.Stribeck(mu, 1.3 * mu, 0.5), 6.0), POINT),
    "cart": Case(cart, (0.7, 0.3, 0.5)),
    "own system": Case(pendulum, POINT),
    "closed form of intervals": Case(intervals, (0.3, 1.0, 0.5)),
    "regularised": Case(smoothed, POINT, step=1e-5),  # an event that moves to another step changes its formula
}


def outcome(case: Case):
    """Events, positions of sticks and the end state, as a function of the array of numbers."""

    def of(point):
        done = case.simulate(*point)
        sticks = [jnp.where(done.sticks.mask, v, 0.0)[:6] for v in jax.tree.leaves(done.sticks) if v.dtype == float]
        return jnp.concatenate([*sticks, jnp.stack(done.final_state)])

    return of


def differences(function, at, direction, step):
    """The derivative along `direction`, by differences of fourth order."""
    values = [np.asarray(function(at + k * step * direction)) for k in (-2, -1, 1, 2)]
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step)


def assert_close(got, expected):
    size = np.max(np.abs(expected))
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * (1 + size))


def by_scipy(x0: float, mu: float) -> float:
    """The position at 6 s on the harmonic base, from crossing to crossing; the mass never sticks."""

    def relative(t, y):
        return y[1] - np.cos(1.3 * t + 0.4)

    t, y, sign = 0.0, (x0, 0.2), -1
    while t < 6:
        relative.terminal, relative.direction = True, -sign
        field = lambda _, y, sign=sign: (y[1], -4 * y[0] - mu * sign)  # noqa: E731
        done = solve_ivp(field, (t, 6), y, "DOP853", rtol=1e-13, atol=1e-15, events=relative)
        t, y, sign = done.t[-1], done.y[:, -1], -sign
        assert t == 6 or abs(4 * y[0] - 1.3 * np.sin(1.3 * t + 0.4)) > mu
    return float(y[0])


@pytest.mark.slow
def test_second_derivatives_on_a_harmonic_base():
    """Forward over reverse, through crossings, against integrations by SciPy."""

    def end(x0, mu):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return ss.simulate(system, ss.Harmonic(1.0, 1.3, 0.4), t1=6.0, y0=(x0, 0.2), method=STEPS).final_state[0]

    value, (straight, mixed) = jax.jit(lambda x: (end(x, 0.5), jax.jacfwd(jax.grad(end, argnums=(0, 1)))(x, 0.5)))(0.3)
    assert float(value) == pytest.approx(by_scipy(0.3, 0.5), abs=1e-11)
    step = 2e-3
    values = {(i, j): by_scipy(0.3 + i * step, 0.5 + j * step) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or not j}
    bend = (values[1, 0] - 2 * values[0, 0] + values[-1, 0]) / step**2
    twist = (values[1, 1] - values[1, -1] - values[-1, 1] + values[-1, -1]) / (4 * step**2)
    assert float(straight) == pytest.approx(bend, abs=2e-4)
    assert float(mixed) == pytest.approx(twist, abs=2e-4)


MODES = {
    "forward over forward": lambda f: jax.jacfwd(jax.jacfwd(f)),
    "forward over reverse": lambda f: jax.jacfwd(jax.jacrev(f)),
    "reverse over forward": lambda f: jax.jacrev(jax.jacfwd(f)),
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(f)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_second_and_third_derivatives(name):
    """Of all events, along one direction."""
    case = CASES[name]
    of, at = outcome(case), jnp.asarray(case.at)
    direction = jnp.asarray([0.7, 0.3, -0.2])

    def along(f):
        return lambda point: jax.jvp(f, (point,), (direction,))[1]

    first, second, third = along(of), along(along(of)), along(along(along(of)))
    first, second, third = map(jax.jit, (first, second, third))
    assert int(case.simulate(*case.at).sticks.count) >= 2
    assert_close(second(at), differences(first, at, direction, case.step))
    assert_close(third(at), differences(second, at, direction, case.step))


@pytest.mark.slow
def test_a_last_step_that_ends_on_a_kink_has_the_slopes_of_this_side():
    """Friction of `Pendulum` has a kink at rest, and every fifth last step ends exactly there.

    There the first derivative was wrong by 1e-8, and the second by 1e-3 (`test_second_and_third_derivatives`).
    """

    def start(shift):
        x0, mu, tone = (value + shift * part for value, part in zip(POINT, (0.7, 0.3, -0.2), strict=True))
        base = ss.Harmonic(0.5, tone, 0.4)
        method = ss.Exact(max_steps=32)
        return ss.simulate(Pendulum(mu), base, t1=1.4, y0=(x0, 0.2), method=method).sticks.start[0]

    shifts = np.linspace(0, 1e-3, 41)
    found = jax.jit(jax.vmap(jax.jacfwd(start)))(shifts)
    smooth = np.polynomial.Polynomial.fit(shifts, found, 4)
    np.testing.assert_allclose(found, smooth(shifts), rtol=1e-11)


class Duffing(ss.SwitchedSystem):
    """A spring that is so stiff at large elongations that steps as long as allowed overflow."""

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -y[0] - y[0] ** 3 - 0.3 * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2 * np.pi


@pytest.mark.slow
def test_steps_that_overflow_and_are_tried_again_leave_no_trace():
    """The integral ``v^2 / 2 + x^2 / 2 + x^4 / 4 - 0.3 x`` is constant, the base is always faster."""

    def energy_at_end(x0):
        method = ss.Exact(max_steps=1024)
        one = ss.simulate(Duffing(), ss.Constant(1e6), t1=0.2, y0=(x0, 0.0), method=method)
        x, v = one.final_state
        return v * v / 2 + x * x / 2 + x**4 / 4 - 0.3 * x, one.status

    starts = jnp.asarray([60.0, 130.0, 150.0])
    (energy, status), (slope, _) = jax.jit(jax.vmap(lambda x: jax.jvp(energy_at_end, (x,), (jnp.ones_like(x),))))(
        starts
    )
    assert np.all(status == ss.Status.FINISHED)
    np.testing.assert_allclose(energy, starts**2 / 2 + starts**4 / 4 - 0.3 * starts, rtol=1e-8)
    np.testing.assert_allclose(slope, starts + starts**3 - 0.3, rtol=1e-7)


WHICH = [(name, mode) for name in ("harmonic base", "regularised") for mode in MODES]
WHICH += [("constant velocities", "reverse over reverse")]
# Reverse over reverse of the cart takes more than five minutes and up to 20 GB to compile (docs/limits.md).
WHICH += [("cart", "forward over reverse")]
WHICH += [("closed form of intervals", mode) for mode in ("forward over forward", "forward over reverse")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mode"), WHICH)
def test_every_mode(name, mode):
    case = CASES[name]
    weights = jnp.asarray(np.random.default_rng(3).normal(size=len(outcome(case)(jnp.asarray(case.at)))))
    at, of = jnp.asarray(case.at), outcome(case)
    hessian = jax.jit(MODES[mode](lambda point: weights @ of(point)))(at)
    slope = jax.jit(jax.jacfwd(lambda point: weights @ of(point)))
    for column, direction in enumerate(jnp.eye(3)):
        assert_close(hessian[:, column], differences(slope, at, direction, case.step))


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["reverse over forward", "reverse over reverse"])
def test_modes_that_the_closed_form_does_not_have_say_so(mode):
    of = outcome(CASES["closed form of intervals"])
    with pytest.raises(Exception, match=r"(?i)reverse-mode|transpos|differentiat"):
        MODES[mode](lambda point: jnp.sum(of(point)))(jnp.asarray(CASES["closed form of intervals"].at))
