"""Systems of the user's: against those of the package, and against event-driven integration by scipy."""

import math
from collections.abc import Callable
from functools import partial
from typing import ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.event_driven import simulate_motor_cart
from scipy.integrate import solve_ivp

import stickslip_jax as ss

QUICK = diffrax.Tsit5()  # few stages compile fast


class Oscillator(ss.SwitchedSystem):
    """A `MassSpring`."""

    mass: float = 1.2
    stiffness: float = 0.9
    normal_force: float = 1.1
    mu: float = 0.3
    damping: float = 0.1
    static_ratio: float = 4 / 3  # a field does where a property is asked for

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        load = -self.stiffness * y[0] - self.damping * y[1]
        return y[1], (load - friction * self.mu * self.normal_force) / self.mass

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2 * math.pi * (self.mass / self.stiffness) ** 0.5


class Lawless(Oscillator):
    """A field that is no number, and not declared as such."""

    law: Callable[[float], float] = math.sin


class Carrier(ss.SwitchedSystem):
    """A sprung mass that carries another, which slides on it; the base drags the first through a damper."""

    mu: float
    weakening: float = 0.2
    mu_static: float = 0.4
    heavy: float = 1.5
    light: float = 0.5
    spring: float = 2.0
    coupling: float = 2.0
    damping: float = 1.0
    force: ss.Harmonic = ss.Harmonic(8.0, 1.1, 0.3)

    @property
    def state_names(self):
        return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

    def rates(self, t, y, base, friction):
        x1, v1, x2, v2 = y
        rub = friction * self.mu * 9.81 * self.light / (1 + self.weakening * jnp.abs(v2 - v1))
        pull = self.coupling * (x2 - x1)
        push = self.force.value(t) + self.damping * (base.velocity - v1)
        return v1, (push + pull + rub - self.spring * x1) / self.heavy, v2, (-pull - rub) / self.light

    def relative_velocity(self, t, y, base):
        return y[3] - y[1]

    @property
    def static_ratio(self):
        return self.mu_static / self.mu

    @property
    def shortest_time(self):
        return 2 * math.pi * (self.light / (self.spring + self.coupling)) ** 0.5


class Cart(ss.SwitchedSystem):
    """The motor and cart, whose relative velocity is nonlinear and which friction does not grip at dead centre."""

    model: ss.MotorCart = ss.MotorCart(mu=0.5)
    voltage: ss.SourceVoltage = ss.SourceVoltage(0.0, 2.0, 10.0)

    @property
    def state_names(self):
        return "angle in rad", "angular velocity in rad/s", "current in A"

    def rates(self, t, y, base, friction):
        m, (angle, speed, current) = self.model, y
        sine, inertia = jnp.sin(angle), m.cart_mass * m.eccentricity**2
        torque = m.motor_constant * current - m.motor_damping * speed - m.largest_friction_torque * sine * friction
        turn = (torque - inertia * sine * jnp.cos(angle) * speed**2) / (m.motor_inertia + inertia * sine**2)
        return speed, turn, (self.voltage.value(t) - m.resistance * current - m.motor_constant * speed) / m.inductance

    def relative_velocity(self, t, y, base):
        return jnp.sin(y[0]) * y[1]


@pytest.mark.slow
def test_a_mass_and_spring_written_anew():
    """Harmonic base with jumps, damping, static friction: the closed forms of MassSpring are the reference."""
    law = ss.WithJumps(ss.Harmonic(0.5, 1.3), ss.PoissonSwitching(0.4, 0.5))
    own = Oscillator()
    known = ss.MassSpring(own.mass, own.stiffness, own.normal_force, ss.Coulomb(0.3, 0.4), own.damping)
    times = jnp.linspace(0, 40, 301)
    for seed in range(4):
        base = law.sample(jax.random.key(seed), 40.0)
        one, other = (ss.simulate(system, base, t1=40.0, y0=(1.0, 0.5)) for system in (own, known))
        count = int(other.sticks.count)
        assert int(one.status) == ss.Status.FINISHED
        assert count == int(one.sticks.count) > 5
        for name in ("start", "end", "position", "ending"):
            values, exact = (np.asarray(getattr(run.sticks, name))[:count] for run in (one, other))
            np.testing.assert_allclose(values, exact, rtol=1e-12, atol=1e-11, err_msg=name)
        np.testing.assert_allclose(one.final_state, other.final_state, atol=1e-12)
        np.testing.assert_allclose(one.evaluate(times), other.evaluate(times), atol=1e-11)


T1 = 25.0
SWING = ss.Harmonic(1.5, 0.7)
START = (0.5, 0.0, 0.4, 0.8)
POINT = {"mu": 0.3, "weakening": 0.2, "stiffness": 2.0, "push": 8.0, "x": 0.5}


def carrier(values):
    force = ss.Harmonic(values["push"], 1.1, 0.3)
    system = Carrier(values["mu"], weakening=values["weakening"], spring=values["stiffness"], force=force)
    return system, (values["x"], *START[1:])


def watched(values):
    """Starts, ends and positions of the first three sticks, and the final state; twice, and the number of sticks."""
    system, y0 = carrier(values)
    one = ss.simulate(system, SWING, t1=T1, y0=y0, method=ss.Exact(step=0.05, max_steps=2048))
    events = jnp.concatenate([one.sticks.start[:3], one.sticks.end[:3], one.sticks.position[:3]])
    told = jnp.concatenate([events, jnp.stack(one.final_state)])
    return told, (told, one.sticks.count)


def exact(values):
    """The same by scipy, in other coordinates of the stick: both masses as one, held by the friction that it needs."""
    s, y0 = carrier(values)
    weight = 9.81 * float(s.light)

    def push(t, y):
        drag = s.damping * (1.5 * math.cos(0.7 * t) - y[1])
        return values["push"] * math.cos(1.1 * t + 0.3) + drag - s.spring * y[0]

    def needed(t, y):  # friction on the light mass, forwards
        return s.light * push(t, y) / (s.heavy + s.light) - s.coupling * (y[0] - y[2])

    def held(t, y):
        both = push(t, y) / (s.heavy + s.light)
        return [y[1], both, y[3], both]

    def slid(t, y, side):
        rub = side * s.mu * weight / (1 + s.weakening * side * (y[3] - y[1]))
        pull = s.coupling * (y[2] - y[0])
        return [y[1], (push(t, y) + pull + rub) / s.heavy, y[3], (-pull - rub) / s.light]

    t, y, sticks, side = 0.0, np.array(y0, float), [], int(np.sign(y0[3] - y0[1]))
    while t < T1:
        if side == 0:
            field, gap = held, lambda t, y: s.mu_static * weight - abs(needed(t, y))
        else:
            field, gap = partial(slid, side=side), lambda t, y, side=side: side * (y[3] - y[1])
        gap.terminal, gap.direction = True, -1
        arc = solve_ivp(field, (t, T1), y, "DOP853", events=gap, rtol=1e-13, atol=1e-13, max_step=0.02)
        begun, t, y = (t, y[0]), arc.t[-1], arc.y[:, -1]
        if side == 0:
            sticks.append((begun[0], t, begun[1]))
            side = -int(np.sign(needed(t, y)))
        elif t < T1:
            y[3] = y[1]
            side = 0 if abs(needed(t, y)) < s.mu_static * weight else -side
    return np.concatenate([np.array(sticks[:3]).T.ravel(), y]), len(sticks)


@pytest.mark.slow
def test_two_masses_against_scipy():
    """Four states, friction that falls with the speed, between two masses that both move; and derivatives."""
    point = {name: jnp.asarray(value) for name, value in POINT.items()}
    slopes, (found, count) = jax.jit(jax.jacrev(watched, has_aux=True))(point)
    expected, exact_count = exact(POINT)
    assert int(count) == exact_count > 5
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10)
    step = 1e-4
    for name in POINT:
        high, low = (exact(POINT | {name: POINT[name] + way * step})[0] for way in (1, -1))
        np.testing.assert_allclose(slopes[name], (high - low) / (2 * step), rtol=2e-5, atol=2e-5, err_msg=name)


@pytest.mark.slow
def test_the_cart_written_anew():
    """Three states, a nonlinear relative velocity, dead centres."""
    one = ss.simulate(Cart(), ss.Constant(0.0), t1=1.0, y0=(0.5, 0.0, 0.0), method=ss.Exact(step=2e-4))
    run = simulate_motor_cart(mu=0.5, theta=0.0, alpha0=0.5, t1=1.0, nu0=0.0, nu1=2.0, omega_v=10.0)
    sticks = np.array([stick[:3] for stick in run.sticks])
    count = int(one.sticks.count)
    assert count == len(sticks) > 3
    found = np.stack([one.sticks.start, one.sticks.end, one.sticks.position], axis=1)[:count]
    np.testing.assert_allclose(found, sticks, rtol=1e-8, atol=1e-8)


def quick(mu, x=1.0, dtype=float):
    """The last position of an `Oscillator`; and events, and how many sticks."""
    y0, method = (jnp.asarray(x, dtype), jnp.asarray(0.5, dtype)), ss.Exact(step=0.1, max_steps=512, solver=QUICK)
    one = ss.simulate(Oscillator(mu=mu), ss.Harmonic(0.5, 1.3), t1=20.0, y0=y0, method=method)
    return one.final_state[0], (jnp.stack([one.sticks.start[0], one.sticks.end[0]]), one.sticks.count)


@pytest.mark.slow
def test_vmap_grad_and_float32():
    """Of lanes, one without friction: there nothing sticks, and derivatives are numbers still."""
    many = jax.jit(jax.vmap(jax.value_and_grad(quick, has_aux=True)))
    (last, (events, counts)), slopes = many(jnp.array([0.0, 0.29999, 0.3, 0.30001]))
    assert counts[0] == 0
    assert counts[2] > 2
    assert np.all(np.isfinite(slopes))
    np.testing.assert_allclose(slopes[2], (last[3] - last[1]) / 2e-5, rtol=3e-6)
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        rough, (times, _) = jax.jit(partial(quick, dtype=jnp.float32))(jnp.float32(0.3))
    assert rough.dtype == jnp.float32
    np.testing.assert_allclose([rough, *times], [last[2], *events[2]], atol=2e-4)


@pytest.mark.slow
def test_ensemble_samples_are_simulations():
    law = ss.WithJumps(ss.RandomPhase(ss.Harmonic(0.5, 1.3)), ss.PoissonSwitching(0.4, 0.5))
    method, y0 = ss.Exact(solver=QUICK), (ss.Uniform(-1.0, 1.0), 0.0)
    many = ss.simulate_ensemble(
        Oscillator(), law, t1=20.0, samples=20, key=jax.random.key(4), y0=y0, keep="sticks", method=method
    )
    for number in (0, 19):
        _, base, start = many.realization(number)
        one = ss.simulate(Oscillator(), base, t1=20.0, y0=start, method=method)
        count = int(one.sticks.count)
        assert count == many.flat_sticks.count[number] > 0
        np.testing.assert_allclose(many.sticks.start[number, :count], one.sticks.start[:count], rtol=1e-10)


def bad(**methods):
    """An `Oscillator` with other methods or properties."""
    return type("Bad", (Oscillator,), methods)()


def bent(self, t, y, base, friction):
    return y[1], -y[0] - friction * jnp.abs(friction)


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("system", "options", "message"),
    [
        (bad(rates=bent), {"y0": (0.0, 0.0)}, r"rates of a Bad must be affine in friction, .* but rate number 1 is"),
        (
            bad(rates=lambda self, t, y, base, friction: (y[1], friction - y[0])),
            {},
            r"rates .* must let positive friction act against .*, but friction = 1 changes .* turn its sign round",
        ),
        (bad(rates=lambda *_: (0.0,)), {}, r"rates of a Bad must return a tuple of 2 numbers, .* but 1 was given"),
        (bad(rates=lambda *_: 1.0), {}, r"rates of a Bad must return a tuple of 2 numbers, .* but 1.0 was given"),
        (bad(rates=lambda *_: (0.0, jnp.ones(3))), {}, r"rates .* must return scalars, but number 1 of shape \(3,\)"),
        (bad(relative_velocity=lambda *_: jnp.ones(2)), {}, r"relative_velocity .* must return one number, but 2"),
        (bad(shortest_time=None), {"base": ss.Constant(1.0)}, r"method must give the step, .* property shortest_time"),
        (bad(shortest_time=-1.0), {}, r"shortest_time must be positive, but -1.0 was given"),
        (bad(state_names=("x",)), {}, r"state_names of a Bad must be a tuple of two names or more, but"),
        (Oscillator(), {"method": ss.Exact(step=1.0)}, r"step must be at most 0.6046 s, .* shortest time of the"),
        (Oscillator(), {"base": ss.GroundAcceleration([0.0, 50.0], [0.0, 1.0])}, r"base .* must be a base velocity"),
        (Oscillator(), {"base": ss.SourceVoltage(3.0, 8.0, 5.0)}, r"base of a Oscillator must be a base motion, but"),
        (Oscillator(), {"y0": (0.0, 0.0, 0.0)}, r"y0 must be two numbers \(position in m, velocity in m/s\), but"),
        (Oscillator(static_ratio=0.5), {}, r"static_ratio must be at least 1, but 0.5 was given"),
        (Lawless(), {}, r"law of a Lawless must be a number or an array, but .*static=True"),
        (Oscillator, {}, r"system must be a MassSpring, a MotorCart or a SwitchedSystem of your own, but"),
    ],
)  # fmt: skip
def test_bad_input(system, options, message):
    with pytest.raises(ValueError, match=message):
        ss.simulate(system, **{"base": ss.Harmonic(1.0, 0.8), "t1": 10.0} | options)


@pytest.mark.parametrize("name", ["switched_model", "tracks", "memory", "rates", "redundant", "look"])
@pytest.mark.parametrize("is_mixed_in", [False, True])
def test_field_with_a_name_of_the_package(name, is_mixed_in):
    """It would hide what the package asks of every system."""
    said = {"__annotations__": {name: float}, "__module__": __name__, name: 1.0}
    bases = (type("Mixin", (eqx.Module,), said), Oscillator) if is_mixed_in else (Oscillator,)
    mine = type("Mine", bases, {"__module__": __name__} if is_mixed_in else said)
    with pytest.raises(ValueError, match=f"Argument {name} of a Mine must have another name"):
        mine()


def test_names_that_fields_may_have():
    """Class variables are no fields, and some properties may be given by fields."""
    said = {"static_ratio": float, "own_distributions": ClassVar[tuple], "size": float}
    mine = type(
        "Mine", (Oscillator,), {"__annotations__": said, "__module__": __name__, "static_ratio": 1.5, "size": 2}
    )
    assert (mine().static_ratio, mine().size) == (1.5, 2)
