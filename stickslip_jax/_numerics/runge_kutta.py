"""One step of an explicit Runge-Kutta method with the coefficients of diffrax.

The stages are unrolled and the states are tuples of scalars, so that zero coefficients cost nothing and many lanes
advance as vectors; in derivatives too, where a loop over the stages would take seven times as long.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax

from .. import _diffrax as diffrax
from .._types import ExplicitSolver, FloatArray, State


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
    tableau = _tableau(solver)
    slopes = [field(0 * h, y)]
    for c, row in zip(np.asarray(tableau.c), tableau.a_lower, strict=True):
        slopes.append(field(float(c) * h, _moved(y, h, np.asarray(row), slopes)))
    reached = _moved(y, h, np.asarray(tableau.b_sol), slopes)
    h, rows = lax.stop_gradient((h, slopes))
    return reached, _error(h, np.asarray(tableau.b_error), rows)


def _tableau(solver: ExplicitSolver) -> "diffrax.ButcherTableau":
    assert isinstance(solver.tableau, diffrax.ButcherTableau)
    return solver.tableau


def _moved(y: State, h: FloatArray, weights: np.ndarray, slopes: list[State]) -> State:
    used = [(float(weight), slope) for weight, slope in zip(weights, slopes, strict=True) if weight != 0]
    return tuple(value + h * sum(weight * slope[i] for weight, slope in used) for i, value in enumerate(y))


def _error(h: FloatArray, weights: np.ndarray, slopes: list[State]) -> State:
    return _moved(tuple(jnp.zeros_like(value) for value in slopes[0]), h, weights, slopes)


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
