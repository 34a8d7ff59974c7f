"""The mass and spring as a switched model: every slip of constant friction in closed form.

``m x'' + c x' + k x = F(t) - sign mu n``: a damped rotation about the response to the force, which is known for
constant, linear and harmonic forces (any book on vibration). Other forces and friction laws: `solver_model.py`.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp

from .._types import BoolArray, FloatArray
from ..base_motion.pieces import added
from ..base_motion.smooth import Harmonic, Signal, SumOfHarmonics, added_up, angle
from ..numerics.sharing import sincos
from ..systems.mass_spring import MassSpring
from .switched_model import NOISE_ULPS, Pieces, State, SwitchedModel

_SERIES = 0.1  # below this |(beta^2 - omega^2) h^2|, damped rotations are summed as series


class OscillatorInputs(NamedTuple):
    """From time `t` on: what comes in pieces, linear in time. Base velocity in m/s, load in N."""

    t: FloatArray
    base: FloatArray
    base_slope: FloatArray
    load: FloatArray
    load_slope: FloatArray


class OscillatorModel(SwitchedModel):
    """A `MassSpring` on a base that moves with ``smooth(t)`` plus what comes in pieces. State: x (m), x' (m/s)."""

    system: MassSpring
    smooth: Signal | None
    steps_may_be_long: ClassVar[bool] = True

    def inputs(self, t: FloatArray, pieces: Pieces) -> OscillatorInputs:
        base, base_slope = added(t, pieces.base)
        ground, ground_slope = added(t, pieces.ground)
        force, force_slope = added(t, pieces.force)
        mass = self.system.mass
        return OscillatorInputs(t, base, base_slope, force - mass * ground, force_slope - mass * ground_slope)

    def slip(self, inputs: OscillatorInputs, y: State, h: FloatArray, sign: FloatArray) -> State:
        m, k, c = self._constants()
        rub = sign * self.system.friction.kinetic(jnp.zeros_like(h)) * self.system.normal_force
        beta = 0 if c is None else c / (2 * m)
        omega_squared = k / m
        before, after = (self._response(inputs, tau, rub) for tau in (jnp.zeros_like(h), h))
        u, w = y[0] - before[0], y[1] - before[1]
        cosine, sine = _rotation(beta, omega_squared, h)
        x = after[0] + cosine * u + sine * (w + beta * u)
        p = after[1] + cosine * w - sine * (omega_squared * u + beta * w)
        return x, p

    def stick(self, inputs: OscillatorInputs, y: State, h: FloatArray) -> State:
        travel = h * (inputs.base + 0.5 * h * inputs.base_slope)
        if self.smooth is not None:
            travel = travel + self.smooth.integral(inputs.t, h)
        return y[0] + travel, self.base_motion(inputs, h)[0]

    def rates(self, inputs: OscillatorInputs, tau: FloatArray, y: State, sign: FloatArray) -> State:
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(inputs, tau)
        rub = sign * self._coefficient(sign * (y[1] - velocity)) * self.system.normal_force
        slip = (self.load_at(inputs, tau) - _times(c, y[1]) - k * y[0] - rub) / m
        return y[1], jnp.where(sign == 0, acceleration, slip)

    def at_rest(self, inputs: OscillatorInputs, y: State) -> BoolArray:
        r = y[1] - self.base_motion(inputs, jnp.zeros_like(y[0]))[0]
        noise = NOISE_ULPS * jnp.finfo(y[0].dtype).eps * self.guard_scale(inputs, y, jnp.ones_like(y[0]))
        return jnp.abs(r) <= noise

    def slip_sign(self, inputs: OscillatorInputs, y: State) -> FloatArray:
        return jnp.sign(y[1] - self.base_motion(inputs, jnp.zeros_like(y[0]))[0])

    def guard(
        self, inputs: OscillatorInputs, tau: FloatArray, y: State, sign: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(inputs, tau)
        holds = self._holds()
        per_held = jnp.where(holds > 0, 1 / jnp.where(holds > 0, holds, 1), 0)
        share = self._needed(inputs, tau, y) * per_held
        t = inputs.t + tau
        jerk = 0 if self.smooth is None else self.smooth.curvature(t)
        share_rate = (m * jerk + _times(c, acceleration) + k * velocity - self._force_rate(inputs, tau)) * per_held
        slip_rate = self.rates(inputs, tau, y, sign)[1] - acceleration
        sticking = sign == 0
        guard = jnp.where(sticking, 1 - share * share, sign * (y[1] - velocity))
        return guard, jnp.where(sticking, -2 * share * share_rate, sign * slip_rate)

    def guard_scale(self, inputs: OscillatorInputs, y: State, sign: FloatArray) -> FloatArray:
        m, k, _ = self._constants()
        velocity = self.base_motion(inputs, jnp.zeros_like(y[0]))[0]
        omega = jnp.sqrt(k / m)
        slip = jnp.abs(y[1]) + jnp.abs(velocity) + omega * (jnp.abs(y[0]) + self._holds() / k)
        return jnp.where(sign == 0, 2.0, slip)

    def on_base(self, inputs: OscillatorInputs, y: State) -> State:
        return y[0], self.base_motion(inputs, jnp.zeros_like(y[0]))[0]

    def can_stick(self, inputs: OscillatorInputs, y: State) -> BoolArray:
        return jnp.abs(self._needed(inputs, jnp.zeros_like(y[0]), y)) <= self._holds()

    def release_sign(self, inputs: OscillatorInputs, y: State) -> FloatArray:
        # The base pulls harder than friction can hold: the mass falls behind.
        return jnp.where(self._needed(inputs, jnp.zeros_like(y[0]), y) > 0, -1, 1).astype(y[0].dtype)

    def _constants(self):
        return self.system.mass, self.system.stiffness, self.system.damping

    def _coefficient(self, speed: FloatArray) -> Any:
        """The friction coefficient of a slip, continued with the same slope to where the slip is over.

        The stages of a Runge-Kutta step that ends an arc may lie slightly beyond; a kink there would cost its order.
        """
        friction = self.system.friction
        coefficient = friction.kinetic(jnp.abs(speed))
        if friction.constant:
            return coefficient
        return jnp.where(speed < 0, 2 * friction.kinetic(jnp.zeros_like(speed)) - coefficient, coefficient)

    def _holds(self) -> FloatArray:
        return jnp.asarray(self.system.friction.static * self.system.normal_force)

    def base_motion(self, inputs: OscillatorInputs, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity and acceleration of the base."""
        velocity, acceleration = inputs.base + tau * inputs.base_slope, inputs.base_slope
        if self.smooth is None:
            return velocity, acceleration
        t = inputs.t + tau
        return velocity + self.smooth.value(t), acceleration + self.smooth.rate(t)

    def load_at(self, inputs: OscillatorInputs, tau: FloatArray) -> FloatArray:
        load = inputs.load + tau * inputs.load_slope
        return load + self.system.force.value(inputs.t + tau) if isinstance(self.system.force, Signal) else load

    def _force_rate(self, inputs: OscillatorInputs, tau: FloatArray) -> FloatArray:
        force = self.system.force
        return inputs.load_slope + (force.rate(inputs.t + tau) if isinstance(force, Signal) else 0)

    def _needed(self, inputs: OscillatorInputs, tau: FloatArray, y: State) -> FloatArray:
        """The friction force that a stick needs, ``m v' + c v + k x - F``, N (Lima and Sampaio 2017, eq. 3)."""
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(inputs, tau)
        return m * acceleration + _times(c, velocity) + k * y[0] - self.load_at(inputs, tau)

    def _response(self, inputs: OscillatorInputs, tau: FloatArray, rub: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The particular solution, position and velocity, for the load and the rubbing force."""
        m, k, c = self._constants()
        c = 0 if c is None else c
        x = (inputs.load + tau * inputs.load_slope - rub - c / k * inputs.load_slope) / k
        p = inputs.load_slope / k
        force = self.system.force
        if isinstance(force, (Harmonic, SumOfHarmonics)):

            def answer(amplitude, w, phase):
                elastic, viscous = k - m * w * w, c * w
                gain = amplitude / (elastic * elastic + viscous * viscous)
                sine, cosine = sincos(angle(w, inputs.t + tau, phase))
                return gain * (elastic * cosine + viscous * sine), gain * w * (viscous * cosine - elastic * sine)

            position, velocity = added_up(answer, force.tones)
            x, p = x + force.offset / k + position, p + velocity
        return x, p


def has_closed_form(system: MassSpring) -> bool:
    """Whether the slips of `system` have a closed form."""
    harmonic = isinstance(system.force, (Harmonic, SumOfHarmonics)) or not isinstance(system.force, Signal)
    return system.friction.constant and harmonic


def _rotation(beta: Any, omega_squared: Any, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``exp(-beta h)`` times ``cos(w h)`` and ``sin(w h) / w``, where ``w^2 = omega^2 - beta^2`` may have any sign."""
    if isinstance(beta, int):
        w = jnp.sqrt(omega_squared)
        sine, cosine = sincos(w * h)
        return cosine, sine / w
    squared = omega_squared - beta * beta
    z = squared * h * h
    small, under = jnp.abs(z) < _SERIES, squared > 0
    w = jnp.sqrt(jnp.where(small, 1, jnp.abs(squared)))
    sine, cosine = sincos(jnp.where(under, w * h, 0))
    fast, slow = jnp.exp(-(beta + w) * h), jnp.exp(-jnp.where(under | small, beta, beta - w) * h)
    decay = slow
    series = (1 - z / 2 * (1 - z / 12 * (1 - z / 30 * (1 - z / 56 * (1 - z / 90)))),
              h * (1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72 * (1 - z / 110))))))  # fmt: skip
    cosine = jnp.where(under, decay * cosine, (slow + fast) / 2)
    sine = jnp.where(under, decay * sine, (slow - fast) / 2) / w
    return jnp.where(small, decay * series[0], cosine), jnp.where(small, decay * series[1], sine)


def _times(c: Any, value: Any) -> Any:
    return 0 if c is None else c * value
