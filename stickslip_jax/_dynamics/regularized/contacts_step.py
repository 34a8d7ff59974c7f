"""One step of fixed length of regularised dynamics with several contacts, stable for any width.

The method and its estimated error are those of `implicit_step.py`. In each stage everything but the friction is
linearised at a predicted state; one equation for each contact remains, and all are solved together
(`contacts_balance.py`).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from ..._numerics.primal import without_derivatives
from ..._numerics.small_matrices import times
from ..._systems.contacts_model import ContactsModel
from ..._systems.switched_model import State
from ..._types import FloatArray, FloatScalar
from .contacts_balance import ForceLaw, balanced_forces
from .implicit_step import ERROR, GAMMA, KINK, ROUND_OFF, WEIGHTS, moved
from .switch import Switch


class FrictionAt(ForceLaw):
    """The regularised friction forces at one instant and state."""

    model: ContactsModel
    switch: Switch
    static_exceeds_kinetic: bool = eqx.field(static=True)
    forcing: object
    tau: FloatScalar
    y: State

    def __call__(self, velocity: FloatArray) -> FloatArray:
        limits = self.model.limits(self.forcing, self.tau, self.y, velocity)
        # A contact without a positive normal force is open.
        kinetic = jnp.maximum(jnp.where(velocity < 0, limits.backward, limits.forward), 0)
        static = jnp.maximum(limits.static(velocity), 0) if self.static_exceeds_kinetic else None
        return self.switch.friction(velocity, kinetic, static)

    @property
    def width(self) -> FloatArray:
        return jnp.asarray(self.switch.width, self.tau.dtype)

    @property
    def is_straight(self) -> bool:
        return self.switch.shape == "linear"


def contacts_step(
    model: ContactsModel, switch: Switch, forcing: object, y: State, h: FloatArray
) -> tuple[State, FloatArray | None]:
    """The state after one step of length `h` (s) from the state `y`, and its estimated error over the allowed one; None
    where the time scales, which the given step suits, are known.
    """
    start = FrictionAt(model, switch, False, forcing, jnp.zeros_like(h), y)
    now = model.instant(forcing, start.tau, y)
    force = start(now.velocity)
    rates = moved(now.rates, 1.0, model.effect(forcing, start.tau, y, force))
    middle = _stage(model, switch, forcing, GAMMA * h, y, moved(y, GAMMA * h, rates), GAMMA * h, force)
    base, expected = moved(y, (1 - GAMMA) * h, middle.rates), moved(y, h, middle.rates)
    end = _stage(model, switch, forcing, h, base, expected, GAMMA * h, middle.force)
    if model.time_scales_are_known:
        return end.state, None
    return end.state, _error(*without_derivatives((model, forcing, y, h, middle, end)))


class _Stage(NamedTuple):
    """A stage of a step: its state, rates and friction forces, its rates without friction, and what these follow from.

    `expected`: the state at which it is linear. `columns`: what a unit of friction in each contact adds to the rates.
    """

    state: State
    rates: State
    force: FloatArray
    free: State
    expected: State
    columns: State
    tau: FloatArray
    weight: FloatArray


def _stage(
    model: ContactsModel,
    switch: Switch,
    forcing: object,
    tau: FloatArray,
    base: State,
    expected: State,
    weight: FloatArray,
    guess: FloatArray,
) -> _Stage:
    """Solve the stage ``Y = base + weight f(tau, Y)``, linear at `expected` but for friction.

    `guess`: of the friction forces.
    """

    def free(state):
        return model.instant(forcing, tau, state).rates

    def velocity(state):
        return model.relative_velocity(forcing, tau, state)

    rates = free(expected)
    unit = jnp.eye(len(guess), dtype=tau.dtype)
    columns = jax.vmap(lambda force: model.effect(forcing, tau, expected, force), out_axes=-1)(unit)
    missing = (b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True))
    sides = tuple(
        jnp.concatenate([m[..., None], weight * each], axis=-1) for m, each in zip(missing, columns, strict=True)
    )
    changes = model.implicit_changes(forcing, tau, expected, weight, sides)
    without, per_unit = tuple(part[..., 0] for part in changes), tuple(part[..., 1:] for part in changes)

    reached = moved(expected, 1.0, without)
    speed, along = jax.linearize(velocity, reached)
    stiffness = -jax.vmap(along, in_axes=-1, out_axes=-1)(per_unit)
    law = FrictionAt(model, switch, False, forcing, tau, expected)
    force = balanced_forces(law, speed, stiffness, guess)
    change = moved(without, 1.0, tuple(_of_all(part, force) for part in per_unit))
    _, turned = jax.jvp(free, (expected,), (change,))
    alone = moved(rates, 1.0, turned)
    end_rates = moved(alone, 1.0, tuple(_of_all(part, force) for part in columns))
    return _Stage(moved(expected, 1.0, change), end_rates, force, alone, expected, columns, tau, weight)


def _of_all(columns: FloatArray, force: FloatArray) -> FloatArray:
    """What the forces of all contacts do together, by the last axis of `columns`."""
    return jnp.sum(columns * jnp.expand_dims(force, range(columns.ndim - 1)), axis=-1)


def _error(model: ContactsModel, forcing: object, y: State, h: FloatArray, middle: _Stage, end: _Stage) -> FloatArray:
    """The estimated error of a step from `y` by its two stages, over the allowed one; at most 1 is accurate enough."""
    first = model.instant(forcing, jnp.zeros_like(h), y).rates
    last = model.instant(forcing, h, end.state).rates
    flat, first, between, third, last = (ravel_pytree(part)[0] for part in (y, first, middle.free, end.free, last))
    gross, kink = _sizes(model, forcing, end)
    stages = zip(WEIGHTS, (first, between, third), strict=True)
    error = h * (jnp.abs(sum(weight * rate for weight, rate in stages)) + GAMMA * jnp.abs(last - third))
    error = error - ROUND_OFF * jnp.finfo(h.dtype).eps * (jnp.abs(flat) + h * gross) - KINK * h * h * kink
    allowed = ERROR * h * gross
    share = error / jnp.where(allowed > 0, allowed, 1)
    return jnp.max(jnp.where((error > 0) & (allowed > 0), share, 0))


def _sizes(model: ContactsModel, forcing: object, stage: _Stage) -> tuple[FloatArray, FloatArray]:
    """Of each rate without friction the sum of its terms, each alone, and what friction could change in it, per s."""
    tau, expected = stage.tau, stage.expected
    now = model.instant(forcing, tau, expected)
    y, rates = (ravel_pytree(part)[0] for part in (expected, now.rates))
    jacobian = model.jacobian(forcing, tau, expected)
    terms = jacobian * y[None, :]
    gross = jnp.abs(rates - jnp.sum(terms, axis=1)) + jnp.sum(jnp.abs(terms), axis=1)
    # Where a rate passes through zero: as large as those that it is coupled with make it in one radian of the motion.
    fastest = jnp.sqrt(jnp.sum(jnp.abs(jacobian * jacobian.T)) + jnp.finfo(tau.dtype).tiny)
    coupled = times(jnp.abs(jacobian), gross)
    gross = gross + jnp.where(fastest * stage.weight > 1e-9, coupled / fastest, 0)
    held = model.limits(forcing, tau, expected, now.velocity).largest
    by_friction = jnp.concatenate([part.reshape(-1, len(held)) for part in stage.columns])
    return gross, times(jnp.abs(jacobian) @ jnp.abs(by_friction), held)
