"""The motion inside the time steps of the switched engine: states, what is observed beside them, and what adds up."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._foundation import checks
from ..._foundation.types import FloatArray, FloatScalar, Scalar
from ..._numerics.derivatives import without_derivatives
from ..._systems.switched_model import Along, Form, Segments, State, SwitchedModel, of_form
from ..common.lanes import SIGNS, Asked, Work

# The state at any time, and along a step.


class StepBeginnings(NamedTuple):
    """The beginning of each loop step, arrays (steps,): time (s), state, sign of the mode, and the current segments.

    `tried`: the length that was tried, s, while lanes move.
    """

    t: Array
    y: tuple[Array, ...]
    sign: Array
    segments: Segments
    tried: Array | None = None

    def at(self, time: FloatArray) -> "StepBeginnings":
        """The beginning of the step that contains `time` (s)."""
        # Of loop steps with the same beginning (tries of one time step), the last is the one that was accepted.
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self)


def state_in_step(model: SwitchedModel, begun: StepBeginnings, h: FloatArray) -> State:
    """The state at `h` (s) after the beginning of one step."""
    _, y, sign, segments, _ = begun
    return model.flow(model.forcing(begun.t, segments), y, h, sign)


def along_step(
    model: SwitchedModel, forms: tuple[Form, ...], step: tuple[StepBeginnings, FloatArray], is_fixed: bool
) -> Along:
    """The `forms` of the state in a step that has begun so and is so long, s; `is_fixed`: without derivatives."""
    (t, y, sign, segments, _), h = step
    given = model, model.forcing(t, segments), y, h, sign
    model, forcing, y, h, sign = without_derivatives(given) if is_fixed else given
    return model.along(forcing, y, h, sign, forms)


# What is observed beside the state (accelerations, forces, relative velocities), and what adds up in a step (slip paths
# and energies).
#
# Both follow from the motion at the nodes of Gauss and Lobatto's rule with nine points, which sums polynomials of
# degree 15 exactly. Steps are at most a tenth of the shortest period, r = 0.63 rad of the fastest motion: powers, whose
# frequencies are twice as high, are then summed to 1e-16 of their size, and the polynomial of degree eight through the
# nodes is off by at most r^9 / 9! times the largest product of the distances from the nodes, 1e-5: 4e-13. So the
# largest values of all that is observed cost nine states in a step, however many are asked for. Where a motion may die
# out within a step, that is cut into parts, each half as long as the next.


_POINTS = 9
_LEGENDRE = np.polynomial.legendre.Legendre.basis(_POINTS - 1)
_X = np.concatenate([[-1.0], _LEGENDRE.deriv().roots(), [1.0]])  # the nodes, on [-1, 1]
_WEIGHTS = 2 / (_POINTS * (_POINTS - 1) * _LEGENDRE(_X) ** 2)
_TO_POWERS = np.linalg.inv(np.vander(_X, increasing=True))  # from values at the nodes to those of a polynomial
_LAGRANGE = 1 / np.prod(_X[:, None] - _X[None, :] + np.eye(_POINTS), axis=1)
_NEWTON_STEPS = 5
FEW_HALVES = 6
_MOST_HALVES = 40  # it then resolves what dies out in 1e-12 of its length


def halves_for(decay: Scalar, longest: Scalar, *, most: int = _MOST_HALVES) -> int:
    """How often a step of at most `longest` (s) is halved where a motion may die out at the rate `decay`; `most`: for
    numbers that JAX traces.
    """
    if not checks.is_traced(decay) and decay == 0:
        return 0
    if checks.is_traced(decay) or checks.is_traced(longest):
        return most
    return min(math.ceil(math.log2(max(float(decay) * float(longest), 1))), _MOST_HALVES)


def seen_in_step(
    model: Any, begun: StepBeginnings, length: FloatScalar, end: State, asked: Asked, halves: int
) -> tuple[FloatArray, Work | None]:
    """The largest of each form of what is observed in a step of this `length` (s), and minus the smallest, (2, forms);
    minus infinity in one of no length; and what adds up in it.

    `end`: the state after the step, in the mode that holds there.
    """
    forcing = model.forcing(begun.t, begun.segments)
    # As long as was tried: that motion has been computed, wherever an event has ended it.
    dense = model.dense(forcing, begun.y, length if begun.tried is None else begun.tried, begun.sign)
    known, _ = model.without_memory(begun.y)
    way = jnp.where(length > 0, known.slips(model.modes_without_memory(begun.sign)), 0)
    bounds = np.concatenate([[0.0], 0.5 ** np.arange(halves, -1, -1)])
    nodes = bounds[:-1, None] + np.diff(bounds)[:, None] * (_X + 1) / 2  # (parts, points), shares of the step

    def at(share: FloatScalar) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The forms; the speeds in the contacts; what is supplied, and dissipated by friction and by damping, W."""
        tau = share * length
        reached = dense(tau)
        now, (known, own) = model.forcing(begun.t + tau, begun.segments), model.without_memory(reached)
        mode, none = model.modes_without_memory(begun.sign), jnp.zeros((0,), length.dtype)
        forms, speeds, powers = none, none, none
        if asked.observed:
            numbers = (*model.numbers(reached), *known.observed(now, own, mode))
            forms = jnp.stack([of_form(form, numbers) for form in asked.observed])
        if asked.sums:
            speeds = jnp.abs(known.friction_forces(now, own, mode)[1] * way)
            supplied, dissipated = known.powers_in(now, own, mode)
            terms = sum(supplied.values()), dissipated["friction"], dissipated["damping"]
            powers = jnp.stack([jnp.asarray(term, length.dtype) for term in terms])
        return forms, speeds, powers

    forms, speeds, powers = lax.map(at, jnp.asarray(nodes.reshape(-1), length.dtype))
    extremes = jnp.full((len(SIGNS), 0), -jnp.inf, length.dtype)
    if asked.observed:
        of_parts = forms.reshape(*nodes.shape, -1)
        largest = [jnp.max(jax.vmap(_largest_through)(sign * of_parts), axis=0) for sign in SIGNS]
        extremes = jnp.where(length > 0, jnp.stack(largest), -jnp.inf)
    if not asked.sums:
        return extremes, None
    weights = jnp.asarray((np.diff(bounds)[:, None] * _WEIGHTS / 2).reshape(-1), length.dtype) * length
    path = jnp.tensordot(weights, speeds, 1)
    supplied, friction, damping = jnp.tensordot(weights, powers, 1)
    if model.has_sliders:
        # A slider whose limit falls at once, as at a release, loses energy of its spring.
        def elastic(y: State) -> FloatScalar:
            known, y = model.without_memory(y)
            return known.stored_energies(y)["elastic"]

        friction = friction + elastic(dense(length)) - elastic(end)
    return extremes, Work(path, way, supplied, friction, damping)


def _largest_through(values: FloatArray) -> FloatArray:
    """The largest values (forms,) of the polynomials through these `values` at the nodes, (points, forms)."""
    fixed, x = lax.stop_gradient(values), jnp.asarray(_X, values.dtype)
    powers = jnp.tensordot(jnp.asarray(_TO_POWERS, values.dtype), fixed, 1)
    best = jnp.argmax(fixed, axis=0)
    low, at, high = (x[jnp.clip(best + i, 0, _POINTS - 1)] for i in (-1, 0, 1))
    for _ in range(_NEWTON_STEPS):
        slope, bend = jnp.zeros_like(at), jnp.zeros_like(at)
        for power in reversed(range(1, _POINTS)):
            bend = bend * at + slope
            slope = slope * at + power * powers[power]
        at = jnp.clip(at - slope / jnp.where(bend < 0, bend, -jnp.inf), low, high)
    # By Lagrange's form, which is as exact as the values.
    away = [at - node for node in _X]
    inside = jnp.zeros_like(at)
    for i, weight in enumerate(_LAGRANGE):
        share = math.prod([away[j] for j in range(_POINTS) if j != i], start=weight)
        inside = inside + share * values[i]
    return jnp.maximum(inside, jnp.max(values, axis=0))
