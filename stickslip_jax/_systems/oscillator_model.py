"""A mass on a spring under its excitation: how it slips and sticks, in closed form or by a Runge-Kutta step.

``m x'' + c x' + k x = F(t) - sign mu n`` in a slip: the response to a step and a ramp of the force, besides that to
harmonic forces (any book on vibration). Nothing is divided by the stiffness, which may be zero. Under other forces and
friction laws each step is one Runge-Kutta step.
"""

from typing import Any, ClassVar, NamedTuple, cast

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jax.tree_util import Partial

from .._excitation.segments import added
from .._excitation.smooth import Harmonic, Signal, SumOfHarmonics
from .._numerics.rotation import responses
from .._numerics.runge_kutta import gross_changes, relative_error, runge_kutta_step
from .._types import BoolScalar, ExplicitSolver, FloatArray, FloatScalar, Scalar, State
from .composed_friction import AtAge
from .contact_forces import stick_band
from .friction import FrictionLaw
from .one_contact import OneContactModel
from .steady_response import steady_response
from .switched_model import Base, FloatPair, Segments, base_motion, with_change


class OscillatorForcing(NamedTuple):
    """The piecewise-linear parts of base velocity (m/s) and load (N) from time `t` on: values and slopes."""

    t: FloatScalar
    base: FloatScalar
    base_slope: FloatScalar
    load: FloatScalar
    load_slope: FloatScalar


class OscillatorModel(OneContactModel[OscillatorForcing]):
    """A `MassSpring` on a base with the velocity ``smooth(t)`` plus piecewise-linear parts. State: x (m), x' (m/s)."""

    system: Any  # a MassSpring, which makes this model
    smooth: Signal | None
    steps_may_be_long: ClassVar[bool] = True
    has_kinks: ClassVar[bool] = False

    def forcing(self, t: FloatScalar, segments: Segments) -> OscillatorForcing:
        base, base_slope = added(t, segments.base)
        ground, ground_slope = added(t, segments.ground)
        force, force_slope = added(t, segments.force)
        mass = self.system.mass
        return OscillatorForcing(t, base, base_slope, force - mass * ground, force_slope - mass * ground_slope)

    def slip(self, forcing: OscillatorForcing, y: State, h: FloatScalar, sign: FloatScalar) -> State:
        m, k, c = self._constants()
        coefficient = sign * self.friction.continued_coefficient(jnp.zeros_like(h), sign)
        # Beside the steady response to harmonic forces: a motion under a force that grows steadily.
        (x0, p0), (x1, p1) = (self._steady(forcing, tau) for tau in (jnp.zeros_like(h), h))
        force = cast(Harmonic | SumOfHarmonics | None, self.system.force if self._is_harmonic else None)
        load = forcing.load + (0 if force is None else force.mean)
        first = (load - coefficient * self.system.normal_force - k * (y[0] - x0)) / m
        slope, speed = forcing.load_slope / m, y[1] - p0
        by = responses(0 if c is None else c / (2 * m), jnp.asarray(k / m, h.dtype), h)
        x = y[0] + (x1 - x0) + speed * by.impulse + first * by.step + slope * by.ramp
        return x, p1 + speed * by.rate + first * by.impulse + slope * by.step

    def at_age(self, age: FloatArray) -> "OscillatorModel":
        return eqx.tree_at(lambda model: model.system.friction, self, AtAge(self.friction, age))

    def stick(self, forcing: OscillatorForcing, y: State, h: FloatScalar) -> State:
        travel = h * (forcing.base + 0.5 * h * forcing.base_slope)
        if self.smooth is not None:
            travel = travel + self.smooth.integral(forcing.t, h)
        return y[0] + travel, self.base_motion(forcing, h)[0]

    def rates(self, forcing: OscillatorForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        velocity, acceleration = self.base_motion(forcing, tau)
        coefficient = sign * self.friction.continued_coefficient(sign * (y[1] - velocity), sign)
        speed, slip = self.rates_under(forcing, tau, y, coefficient)
        return speed, jnp.where(sign == 0, acceleration, slip)

    def guard(self, forcing: OscillatorForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(forcing, tau)
        beyond, holds = self._beyond_and_limit(forcing, tau, y)
        per_held = jnp.where(holds > 0, 1 / jnp.where(holds > 0, holds, 1), 0)
        share = beyond * per_held
        t = forcing.t + tau
        jerk = 0 if self.smooth is None else self.smooth.curvature(t)
        share_rate = (m * jerk + _times(c, acceleration) + k * velocity - self._force_rate(forcing, tau)) * per_held
        slip_rate = self.rates(forcing, tau, y, sign)[1] - acceleration
        sticking = sign == 0
        held = jnp.where(holds > 0, 1 - share * share, -1)
        guard = jnp.where(sticking, held, sign * (y[1] - velocity))
        return guard, jnp.where(sticking, -2 * share * share_rate, sign * slip_rate)

    def guard_scale(self, forcing: OscillatorForcing, y: State, sign: FloatScalar) -> FloatScalar:
        m, k, _ = self._constants()
        velocity = self.base_motion(forcing, jnp.zeros_like(y[0]))[0]
        omega, deceleration = lax.stop_gradient((jnp.sqrt(k / m), self.friction.static * self.system.normal_force / m))
        slip = jnp.abs(y[1]) + jnp.abs(velocity) + omega * jnp.abs(y[0])
        return jnp.where(sign == 0, 2.0, with_change(slip, deceleration, omega, forcing.t))

    def on_base(self, forcing: OscillatorForcing, y: State) -> State:
        return y[0], self.base_motion(forcing, jnp.zeros_like(y[0]))[0]

    def can_stick(self, forcing: OscillatorForcing, y: State) -> BoolScalar:
        beyond, holds = self._beyond_and_limit(forcing, jnp.zeros_like(y[0]), y)
        # Without friction nothing sticks, not even where no force is needed.
        return (jnp.abs(beyond) <= holds) & (holds > 0)

    def release_sign(self, forcing: OscillatorForcing, y: State) -> FloatScalar:
        # The base pulls harder than friction can hold: the mass lags behind.
        return jnp.where(self._beyond_and_limit(forcing, jnp.zeros_like(y[0]), y)[0] > 0, -1, 1).astype(y[0].dtype)

    @property
    def time_scales_are_known(self) -> bool:
        signals = [signal for signal in (self.smooth, self.system.force) if isinstance(signal, Signal)]
        return self.friction.speed_scale is not None and all(signal.shortest_period is not None for signal in signals)

    @property
    def friction(self) -> FrictionLaw:
        return self.system.friction

    def rates_under(self, forcing: OscillatorForcing, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        m, k, c = self._constants()
        friction = coefficient * self.system.normal_force
        return y[1], (self.load_at(forcing, tau) - _times(c, y[1]) - k * y[0] - friction) / m

    def relative_velocity(self, forcing: OscillatorForcing, tau: FloatScalar, y: State) -> FloatScalar:
        return y[1] - self.base_motion(forcing, tau)[0]

    def relative_acceleration(
        self, forcing: OscillatorForcing, tau: FloatScalar, y: State, rates: State
    ) -> FloatScalar:
        return rates[1] - self.base_motion(forcing, tau)[1]

    def _constants(self):
        return self.system.mass, self.system.stiffness, self.system.damping

    def base_motion(self, forcing: OscillatorForcing, tau: FloatScalar) -> Base:
        """Velocity and acceleration of the base, `tau` (s) later."""
        return base_motion(self.smooth, forcing.t, forcing.base, forcing.base_slope, tau)

    def load_at(self, forcing: OscillatorForcing, tau: FloatScalar) -> FloatScalar:
        load = forcing.load + tau * forcing.load_slope
        return load + self.system.force.value(forcing.t + tau) if isinstance(self.system.force, Signal) else load

    def _force_rate(self, forcing: OscillatorForcing, tau: FloatScalar) -> FloatScalar:
        force = self.system.force
        return forcing.load_slope + (force.rate(forcing.t + tau) if isinstance(force, Signal) else 0)

    def _beyond_and_limit(self, forcing: OscillatorForcing, tau: FloatScalar, y: State) -> FloatPair:
        """The friction force that a stick needs, ``m v' + c v + k x - F`` (Lima and Sampaio 2017, eq. 3), from the
        middle of the `stick_band` on, and the largest one in that direction, N.
        """
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(forcing, tau)
        needed = m * acceleration + _times(c, velocity) + k * y[0] - self.load_at(forcing, tau)
        # A mass that needs a positive force lags behind the base once it is released.
        limit = jnp.asarray(self.friction.stick_limit(-needed) * self.system.normal_force)
        if not self.friction.depends_on_direction:
            return needed, limit
        ways = (jnp.full_like(needed, way) for way in (-1.0, 1.0))
        backward, forward = (self.friction.stick_limit(way) * self.system.normal_force for way in ways)
        middle, limit = stick_band(backward, forward, limit)
        return needed - middle, limit

    @property
    def _is_harmonic(self) -> bool:
        """Whether there is a harmonic force; under other signals slips have no closed form."""
        return isinstance(self.system.force, Signal)

    def _steady(self, forcing: OscillatorForcing, tau: FloatScalar) -> FloatPair:
        """Position and velocity of the steady response to a harmonic force, without its mean."""
        m, k, c = self._constants()
        if not self._is_harmonic:
            return jnp.zeros_like(tau), jnp.zeros_like(tau)
        force = cast(Harmonic | SumOfHarmonics, self.system.force)
        position, velocity = steady_response(force.tones, m, k, 0 if c is None else c, forcing.t + tau)
        return position, velocity


class SolverOscillatorModel(OscillatorModel):
    """An `OscillatorModel` whose slips are integrated by `solver`: any friction law, any smooth force."""

    solver: ExplicitSolver
    controlled: bool = eqx.field(static=True)
    steps_may_be_long: ClassVar[bool] = False
    has_kinks: ClassVar[bool] = True

    def slip(self, forcing: OscillatorForcing, y: State, h: FloatScalar, sign: FloatScalar) -> State:
        return self.slip_and_error(forcing, y, h, sign)[0]

    def slip_and_error(
        self, forcing: OscillatorForcing, y: State, h: FloatScalar, sign: FloatScalar
    ) -> tuple[State, FloatScalar | None]:
        rates = Partial(type(self).rates, self, forcing, sign=sign)
        y1, error = runge_kutta_step(rates, y, h, solver=self.solver)
        if not self.controlled:
            return y1, None
        m, k, c = self._constants()
        none = jnp.zeros_like(h)
        coefficient = self.friction.continued_coefficient(sign * self.relative_velocity(forcing, none, y), sign)
        friction = coefficient * self.system.normal_force
        by_state = ((none, none + 1), (none + k / m, none + (0 if c is None else c / m)))
        gross = gross_changes(h, y, (none, self.load_at(forcing, none) / m), by_state, (none, friction / m))
        return y1, relative_error(error, y, y1, gross)


def _times(c: Scalar | None, value: FloatScalar) -> FloatScalar | int:
    return 0 if c is None else c * value
