"""One step of a Runge-Kutta method, and where a function first falls through zero in a step."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._foundation import lazy_diffrax as diffrax
from .._foundation.types import BoolArray, ExplicitSolver, FloatArray, State

# Estimates of where a smooth function first falls through zero in a step, from its values and slopes at both ends.
#
# The estimate is a root of the cubic Hermite interpolant. The caller evaluates the function there and estimates again,
# so that the result depends on the function only. No derivative passes through an estimate: by the implicit function
# theorem it comes from the last Newton step.


_NEWTON_STEPS = 4  # to the root of the cubic; the next estimate starts from a shorter step anyway
_NEAR_START = 0.02  # fraction of the step; a minimum before it has been evaluated already
_UNSURE = 0.1  # of the fall to the minimum


class Outlook(NamedTuple):
    """Behaviour of the cubic in the step.

    - `falls`: it falls below zero. `turns`: it has a minimum near zero, not below it.
    - `where`: the root or the minimum, a fraction of the step. `lowest`: the value at the minimum inside the step
      (infinity where there is none). `early`: the minimum below zero lies well before the end of the step.
    """

    falls: BoolArray
    turns: BoolArray
    where: FloatArray
    lowest: FloatArray
    early: BoolArray


def look_ahead(s0: FloatArray, d0: FloatArray, s1: FloatArray, d1: FloatArray, noise: FloatArray) -> Outlook:
    """The `Outlook` for a function with values `s0`, `s1` and slopes `d0`, `d1` at 0 and 1, the ends of the step.

    The function starts at or above zero, but for `noise`, the round-off in its values.
    """
    s0, d0, s1, d1, noise = lax.stop_gradient((jnp.maximum(s0, 0), d0, s1, d1, noise))
    c = 3 * (s1 - s0) - 2 * d0 - d1
    e = 2 * (s0 - s1) + d0 + d1

    def p(u):
        return s0 + u * (d0 + u * (c + u * e))

    # Stationary points of p: minimum (-c + root) / (3 e) = -d0 / (c + root), maximum with the other sign of the root;
    # each in the form that does not cancel.
    squared = c * c - 3 * d0 * e
    root = jnp.sqrt(jnp.maximum(squared, 0))
    small, large = _divide(-d0, c + jnp.where(c < 0, -root, root)), -(c + jnp.where(c < 0, -root, root))
    large = _divide(large, 3 * e)
    least, most = jnp.where(c < 0, large, small), jnp.where(c < 0, small, large)
    turning = (squared > 0) & (least > 0) & (least < 1)
    lowest = jnp.where(turning, p(jnp.where(turning, least, 0)), jnp.inf)
    dips = lowest < -noise
    falls = dips | (s1 < -noise)
    # Near the start the error of the cubic is a small part of its fall: enough, unless zero is as close.
    uncertain = lowest < _UNSURE * (s0 - lowest)
    turns = ~falls & turning & ((least > _NEAR_START) | uncertain) & (lowest < 0.5 * jnp.minimum(s0, s1))
    turns = turns & (s0 - lowest > noise)

    right = jnp.where(dips, least, 1)
    rises_first = (s0 <= noise) & (squared > 0) & (most > 0) & (most < right)
    left = jnp.where(rises_first, most, 0)
    u = _first_root(p, lambda u: d0 + u * (2 * c + u * 3 * e), left, right)
    return Outlook(falls, turns, jnp.where(turns, least, u), lowest, dips & (least < 0.98))


def steepest_fall(s0: FloatArray, d0: FloatArray, s1: FloatArray, d1: FloatArray) -> FloatArray:
    """A point on [0, 1) at which the cubic with these values and slopes falls: 0, or its inflection point; 1 if it
    falls at neither.
    """
    s0, d0, s1, d1 = lax.stop_gradient((s0, d0, s1, d1))
    c, e = 3 * (s1 - s0) - 2 * d0 - d1, 2 * (s0 - s1) + d0 + d1
    bend = _divide(-c, 3 * e)
    falls_later = (e > 0) & (bend > 0) & (bend < 1) & (d0 + c * bend < 0)
    return jnp.where(d0 < 0, 0, jnp.where(falls_later, bend, 1))


def _first_root(p, slope, left, right):
    """The root of the cubic `p` between `left`, where it is positive, and `right`: Newton steps within the bracket."""
    above, below = p(left), p(right)
    u = left + (right - left) * jnp.clip(_divide(above, above - below), 0, 1)
    for _ in range(_NEWTON_STEPS):
        value = p(u)
        left, right = jnp.where(value > 0, u, left), jnp.where(value > 0, right, u)
        newton = u - _divide(value, slope(u))
        u = jnp.where((newton >= left) & (newton <= right), newton, (left + right) / 2)
    return u


def _divide(above, below):
    """The quotient, 0 where the divisor is 0."""
    return jnp.where(below == 0, 0, above / jnp.where(below == 0, 1, below))


# One step of an explicit Runge-Kutta method with the coefficients of diffrax.
#
# The stages are unrolled and the states are tuples of scalars, so that zero coefficients cost nothing and many lanes
# advance as vectors; in derivatives too, where a loop over the stages would take seven times as long.


@eqx.filter_custom_jvp
def runge_kutta_step(
    field: Callable[[FloatArray, State], State], y: State, h: FloatArray, *, solver: ExplicitSolver
) -> tuple[State, State]:
    """The state after the time `h` under ``y' = field(tau, y)``, starting at tau = 0, and the step's error.

    The error is the solver's own estimate; no derivative passes through it. 0 for a solver without an estimate.

    `field` must be a pytree that holds everything it depends on, an ``equinox.Module`` say.
    """
    return _stepped(solver, field, y, h)


@runge_kutta_step.def_jvp
def _runge_kutta_step_jvp(primals, tangents, *, solver):
    return eqx.filter_jvp(partial(_stepped, solver), primals, tangents)


def _stepped(
    solver: ExplicitSolver, field: Callable[[FloatArray, State], State], y: State, h: FloatArray
) -> tuple[State, State]:
    tableau = solver.tableau
    assert isinstance(tableau, diffrax.ButcherTableau)
    slopes = [field(0 * h, y)]
    for c, row in zip(np.asarray(tableau.c), tableau.a_lower, strict=True):
        slopes.append(field(float(c) * h, _moved(y, h, np.asarray(row), slopes)))
    reached = _moved(y, h, np.asarray(tableau.b_sol), slopes)
    h, slopes = lax.stop_gradient((h, slopes))
    zero = tuple(jnp.zeros_like(value) for value in slopes[0])
    return reached, _moved(zero, h, np.asarray(tableau.b_error), slopes)


def _moved(y: State, h: FloatArray, weights: np.ndarray, slopes: list[State]) -> State:
    used = [(float(weight), slope) for weight, slope in zip(weights, slopes, strict=True) if weight != 0]
    return tuple(value + h * sum(weight * slope[i] for weight, slope in used) for i, value in enumerate(y))


def relative_error(error: State, y: State, reached: State, gross: State) -> FloatArray:
    """Largest relative error of a component of the state, for a step from `y` to `reached` with this `error`.

    `gross`: the gross change of each component (`gross_changes`), the sum of those by each term of its rate alone.
    Where these terms cancel, the change is round-off, whose relative error no shorter step would reduce.
    """
    worst = jnp.zeros_like(error[0])
    for wrong, begin, end, alone in zip(error, y, reached, gross, strict=True):
        size = jnp.maximum(jnp.abs(begin), jnp.abs(end)) + jnp.abs(end - begin) + jnp.abs(alone)
        worst = jnp.maximum(worst, jnp.abs(wrong) / jnp.where(size > 0, size, 1))
    return worst


def gross_changes(h: FloatArray, y: State, idle: State, by_state: tuple[State, ...], by_friction: State) -> State:
    """The gross change of each component in the time `h`, for `relative_error`.

    `idle`: the rates without friction; `by_state`: their derivatives with respect to the state (rows: rates);
    `by_friction`: what one unit of friction adds. Components are coupled, so the round-off of one moves the others;
    hence one pass for each component.
    """
    moved, gross = tuple(map(jnp.abs, y)), y
    for _ in y:
        terms = [
            [rate, effect, *(slope * size for slope, size in zip(row, moved, strict=True))]
            for rate, effect, row in zip(idle, by_friction, by_state, strict=True)
        ]
        gross = tuple(h * sum(map(jnp.abs, of_one)) for of_one in terms)
        moved = tuple(jnp.maximum(size, more) for size, more in zip(moved, gross, strict=True))
    return gross
