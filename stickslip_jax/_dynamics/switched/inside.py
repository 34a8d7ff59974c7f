"""The motion inside the time steps of the switched engine: states, what is observed beside them, and what adds up."""

import math
from functools import reduce
from operator import add
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
_NEWTON_STEPS = 5
_MOST_HALVES = 40  # it then resolves what dies out in 1e-12 of its length


def halves_for(decay: Scalar, longest: Scalar) -> int:
    """How often a step of at most `longest` (s) is halved where a motion may die out at the rate `decay`."""
    if not checks.is_traced(decay) and decay == 0:
        return 0
    if checks.is_traced(decay) or checks.is_traced(longest):
        return _MOST_HALVES
    return min(math.ceil(math.log2(max(float(decay) * float(longest), 1))), _MOST_HALVES)


def seen_in_step(
    model: Any, begun: StepBeginnings, length: FloatScalar, end: State, asked: Asked
) -> tuple[FloatArray, Work | None]:
    """The largest of each form of what is observed in a step of this `length` (s), and minus the smallest, (2, forms);
    minus infinity in one of no length; and what adds up in it.

    `end`: the state after the step, in the mode that holds there.
    """
    forcing = model.forcing(begun.t, begun.segments)
    # As long as was tried: that motion has been computed, wherever an event has ended it.
    dense = model.dense(forcing, begun.y, length if begun.tried is None else begun.tried, begun.sign)
    known, _ = model.without_memory(begun.y, begun.sign)
    way = jnp.where(length > 0, known.slips(model.modes_without_memory(begun.sign)), 0)
    bounds = np.concatenate([[0.0], 0.5 ** np.arange(asked.halves, -1, -1)])
    nodes = bounds[:-1, None] + np.diff(bounds)[:, None] * (_X + 1) / 2  # (parts, points), shares of the step

    def at(sums: tuple[FloatArray, FloatArray], node: tuple[FloatScalar, FloatScalar]) -> tuple[Any, FloatArray]:
        """At a share of the step, with its weight: the forms. Adds up, where that is asked for, the speeds in the
        contacts, and what is supplied, and dissipated by friction and by damping.
        """
        (share, weight), (path, work) = node, sums
        tau = share * length
        reached = dense(tau)
        now, (known, own) = model.forcing(begun.t + tau, begun.segments), model.without_memory(reached, begun.sign)
        mode = model.modes_without_memory(begun.sign)
        if asked.sums:
            path = path + weight * jnp.abs(known.friction_forces(now, own, mode)[1] * way)
            supplied, dissipated = known.powers_in(now, own, mode)
            terms = sum(supplied.values()), dissipated["friction"], dissipated["damping"]
            work = work + weight * jnp.stack([jnp.asarray(term, length.dtype) for term in terms])
        if not asked.observed:
            return (path, work), jnp.zeros((0,), length.dtype)
        numbers = (*model.numbers(reached), *known.observed(now, own, mode))
        return (path, work), jnp.stack([of_form(form, numbers) for form in asked.observed])

    weights = (np.diff(bounds)[:, None] * _WEIGHTS / 2).reshape(-1)
    scanned = jnp.asarray(nodes.reshape(-1), length.dtype), jnp.asarray(weights, length.dtype)
    none = jnp.zeros_like(way), jnp.zeros(3, length.dtype)
    (path, work), forms = lax.scan(at, none, scanned)
    extremes = jnp.full((len(SIGNS), 0), -jnp.inf, length.dtype)
    if asked.observed:
        of_parts = forms.reshape(*nodes.shape, -1)
        largest = _largest_through([of_parts[:, j] for j in range(_POINTS)])
        extremes = jnp.stack([reduce(jnp.maximum, [one[i] for i in range(len(nodes))]) for one in largest])
        extremes = jnp.where(length > 0, extremes, -jnp.inf)
    if not asked.sums:
        return extremes, None
    path, (supplied, friction, damping) = length * path, length * work
    if model.has_sliders:
        # A slider whose limit falls at once, as at a release, loses energy of its spring.
        def elastic(y: State) -> FloatScalar:
            known, y = model.without_memory(y)
            return known.stored_energies(y)["elastic"]

        friction = friction + elastic(dense(length)) - elastic(end)
    return extremes, Work(path, way, supplied, friction, damping)


def _largest_through(values: list[FloatArray]) -> list[FloatArray]:
    """The largest of the polynomials through these `values` at the nodes, and minus the smallest; each of any shape.

    Written out in small pieces, and Newton's method in a loop: XLA puts no products of matrices into a native loop, no
    sums over many terms, and nothing that it takes for so much that it needs several threads.
    """
    powers = [
        reduce(add, [float(weight) * value for weight, value in zip(row, values, strict=True)]) for row in _TO_POWERS
    ]
    slopes = [k * power for k, power in enumerate(lax.stop_gradient(powers))][1:]
    bends = [k * slope for k, slope in enumerate(slopes)][1:]
    found = []
    for sign in SIGNS:
        # From the node with the largest value, between its neighbours.
        most, (low, at, high) = sign * values[0], (jnp.full_like(values[0], _X[i]) for i in (0, 0, 1))
        for j, value in enumerate(values[1:], 1):
            is_larger = sign * value > most
            ends = _X[j - 1], _X[j], _X[min(j + 1, _POINTS - 1)]
            low, at, high = (jnp.where(is_larger, *pair) for pair in zip(ends, (low, at, high), strict=True))
            most = jnp.maximum(most, sign * value)

        def newton(_: Array, at: FloatArray, way: int = sign, ends: tuple[Array, Array] = (low, high)) -> FloatArray:
            slope, bend = _polynomial(slopes, at), _polynomial(bends, at)
            return jnp.clip(at - slope / jnp.where(way * bend < 0, bend, jnp.inf), *ends)

        at = lax.fori_loop(0, _NEWTON_STEPS, newton, at)
        found.append(jnp.maximum(sign * _polynomial(powers, at), most))
    return found


def _polynomial(terms: list[FloatArray], at: FloatArray) -> FloatArray:
    return reduce(lambda value, term: value * at + term, reversed(terms))
