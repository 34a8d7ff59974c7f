"""One step of a Runge-Kutta or a Rosenbrock method, and where a function first falls through zero in a step."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._foundation import lazy_diffrax as diffrax
from .._foundation.types import BoolArray, ExplicitSolver, FloatArray, State
from .matrices import WRITTEN_OUT, eliminated, linear_solve, times

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
    """Largest relative error of a number of the state, for a step from `y` to `reached` with this `error`.

    `gross`: the gross change of each component (`gross_changes`), the sum of those by each term of its rate alone.
    Where these terms cancel, the change is round-off, whose relative error no shorter step would reduce.
    """
    worst = jnp.zeros((), error[0].dtype)
    for wrong, begin, end, alone in zip(error, y, reached, gross, strict=True):
        size = jnp.maximum(jnp.abs(begin), jnp.abs(end)) + jnp.abs(end - begin) + jnp.abs(alone)
        worst = jnp.maximum(worst, jnp.max(jnp.abs(wrong) / jnp.where(size > 0, size, 1)))
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


# One step of a Rosenbrock method, for equations that may be stiff.
#
# Each stage solves a linear system with the same matrix, ``1 / (gamma h) - J``, J the Jacobian at the beginning of the
# step: exact, by forward mode. The method is Rodas5P (Steinebach 2023, Construction of Rosenbrock-Wanner method Rodas5P
# and numerical benchmarks within the Julia Differential Equations package, BIT Numer. Math. 63, 27): of order 5, with
# an error of order 4 and values inside the step of order 4; L-stable and stiffly accurate, so that its last stage is
# the error. In the form of Hairer and Wanner (Solving Ordinary Differential Equations II, section IV.7) without
# products of J: with ``Gamma`` the method's gamma_ij and k its increments, stages are ``u = Gamma k``, of which
# ``_AHEAD = alpha Gamma^-1`` makes the states and ``_MIXED = 1 / gamma - Gamma^-1`` the right-hand sides.


_GAMMA = 0.21193756319429014
_AHEAD = np.zeros((8, 8))
_AHEAD[1, :1] = 3.0
_AHEAD[2, :2] = 2.849394379747939, 0.45842242204463923
_AHEAD[3, :3] = -6.954028509809101, 2.489845061869568, -10.358996098473584
_AHEAD[4, :4] = 2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641
_AHEAD[5, :5] = -7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946
_AHEAD[6], _AHEAD[7] = _AHEAD[5] + np.eye(8)[5], _AHEAD[5] + np.eye(8)[5] + np.eye(8)[6]
_MIXED = np.zeros((8, 8))
_MIXED[1, :1] = -14.155112264123755
_MIXED[2, :2] = -17.97296035885952, -2.859693295451294
_MIXED[3, :3] = 147.12150275711716, -1.41221402718213, 71.68940251302358
_MIXED[4, :4] = 165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306
_MIXED[5, :5] = 24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471
_MIXED[6, :6] = (
    30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783, -19.097331116725623,
    -28.087943162872662,
)  # fmt: skip
_MIXED[7, :7] = (
    37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047, -40.06618937091002,
    -54.66780262877968, -9.48861652309627,
)  # fmt: skip
_OF_TIME = np.linalg.inv(np.eye(8) / _GAMMA - _MIXED)  # gamma_ij, which the explicit dependence on time asks for
_INSTANTS, _DRIFTS = np.sum(_AHEAD @ _OF_TIME, axis=1), np.where(np.arange(8) < 5, np.sum(_OF_TIME, axis=1), 0)
# The value at a part theta of the step is ``(1 - theta) y0 + theta (y1 + (1 - theta) (p + theta (q + theta r)))`` with
# sums p, q, r of the stages; this is what they come to at its middle, beside the mean of both ends.
_MIDDLE = np.array([0.25, 0.125, 0.0625]) @ np.array([
    [25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204, 0.524948541321073,
     1.1241088310450404, 0.4272876194431874, -0.17202221070155493],
    [-9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796, 20.176138334709044,
     15.98066361424651, -6.789040303419874, -6.710236069923372],
    [11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834632643, -52.072871366152654,
     -59.78993625266729, -0.15582684282751913, 4.883087185713722],
])  # fmt: skip


def rosenbrock_step(field: Callable[[FloatArray, State], State], y: State, h: FloatArray) -> tuple[State, State, State]:
    """The state after the time `h` (positive) under ``y' = field(tau, y)``, starting at tau = 0, that after half of it,
    and the error of the first.
    """
    if len(y) > WRITTEN_OUT:
        of_many = _rosenbrock_stepped(lambda tau, y: (jnp.stack(field(tau, tuple(y[0]))),), (jnp.stack(y),), h)
        reached, middle, error = (tuple(part[0]) for part in of_many)
        return reached, middle, error
    return _rosenbrock_stepped(field, y, h)


def _rosenbrock_stepped(
    field: Callable[[FloatArray, State], State], y: State, h: FloatArray
) -> tuple[State, State, State]:
    """`y`: numbers, or one array."""
    rates, pushed = jax.linearize(field, jnp.zeros_like(h), y)
    drift = pushed(jnp.ones_like(h), tuple(map(jnp.zeros_like, y)))
    solved = _stage_solver(partial(pushed, jnp.zeros_like(h)), y, 1 / (_GAMMA * h))
    stages: list[State] = []
    for ahead, mixed, instant, share in zip(_AHEAD, _MIXED, _INSTANTS, _DRIFTS, strict=True):
        slopes = field(float(instant) * h, _with_stages(y, ahead, stages)) if stages else rates
        side = _with_stages(tuple(map(jnp.zeros_like, y)), mixed, stages)
        sides = zip(slopes, side, drift, strict=True)
        stages.append(solved([slope + per / h + float(share) * h * of_time for slope, per, of_time in sides]))
    reached = _with_stages(y, _AHEAD[7] + np.eye(8)[7], stages)
    mean = tuple((begin + end) / 2 for begin, end in zip(y, reached, strict=True))
    return reached, _with_stages(mean, _MIDDLE, stages), stages[-1]


def _with_stages(y: State, weights: np.ndarray, stages: Sequence[State]) -> State:
    # One after the other: what two stages begin with alike, XLA computes once.
    for weight, stage in zip(weights, stages, strict=False):
        if weight:
            y = tuple(value + float(weight) * part for value, part in zip(y, stage, strict=True))
    return y


def _stage_solver(
    pushed: Callable[[State], State], y: State, diagonal: FloatArray
) -> Callable[[Sequence[FloatArray]], State]:
    """What solves ``(diagonal - J) u = side``, J by the products `pushed`.

    By the inverse, for there are eight sides. Without pivots: the matrix is near a multiple of the identity, or has a
    large positive diagonal where a state decays fast; where this is wrong, so is the step, and a shorter one is tried.
    """
    if y[0].ndim:
        unit = jnp.eye(len(y[0]), dtype=y[0].dtype)
        matrix = diagonal * unit - jax.vmap(lambda column: pushed((column,))[0], out_axes=1)(unit)
        whole = linear_solve(matrix, unit)
        return lambda side: (times(whole, side[0]),)
    places = range(len(y))
    units = [tuple(jnp.full_like(value, float(i == j)) for j, value in enumerate(y)) for i in places]
    columns = [pushed(unit) for unit in units]
    matrix = [[(diagonal if i == j else 0) - columns[j][i] for j in places] for i in places]
    inverse = eliminated(matrix, [list(unit) for unit in units])
    return lambda side: tuple(
        sum((inverse[j][i] * side[j] for j in places[1:]), inverse[0][i] * side[0]) for i in places
    )
