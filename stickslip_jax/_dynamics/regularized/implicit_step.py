"""One step of fixed length of regularised dynamics, stable for any width.

The method is the singly diagonally implicit Runge-Kutta method of order 2 with ``gamma = 1 - 1/sqrt(2)`` (Alexander
1977; L-stable). In each stage everything but the friction is linearised at a predicted state. One equation for the
relative velocity remains, ``sigma + K mu(sigma) = sigma*`` with the signed friction coefficient mu (`_balance`). A step
may be far longer than the time in which friction changes the relative velocity by one width: it then ends in the stick,
as it should, where a step with linearised friction would overshoot it to and fro.

The error of everything but the friction is estimated: the stages against the quadrature of order 3 at the same
instants, and what is not linear in the last of them. What friction may change in a step does not count: it is no smooth
function of time where a stick begins or ends, and no shorter step would do.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..._numerics.primal import without_derivatives
from ..._systems.friction import FrictionLaw
from ..._systems.one_contact import OneContactModel
from ..._systems.switched_model import State
from ..._types import FloatArray
from .balance_root import balance_root
from .static_balance import balance_with_static
from .switch import Switch

GAMMA = 1 - 1 / math.sqrt(2)
# The weights of the quadrature of order 3 at the instants 0, gamma and 1 of a step, less those of the method.
_SECOND, _LAST = 1 / (6 * GAMMA * (1 - GAMMA)), (2 - 3 * GAMMA) / (6 * (1 - GAMMA))
WEIGHTS = 1 - _SECOND - _LAST, _SECOND - (1 - GAMMA), _LAST - GAMMA
KINK = GAMMA * abs(WEIGHTS[1]) + abs(WEIGHTS[2])  # the most that friction adds to the estimate
# Allowed in a step, of what the terms of the equations of motion change in it, each alone: that of a harmonic motion in
# some 45 steps in a period, whose error is below a thousandth of the amplitude per radian.
ERROR = 1e-4
ROUND_OFF = 64  # units in the last place
_NEWTON = {"linear": 3, "tanh": 7, "rational": 7, "arctan": 7}


def implicit_step(
    model: OneContactModel, switch: Switch, forcing: object, y: State, h: FloatArray, band: FloatArray | None = None
) -> tuple[State, FloatArray | None]:
    """The state after one step of length `h` (s) from the state `y`, and its estimated error over the allowed one; None
    where the time scales, which the given step suits, are known.

    `band`: where static friction exceeds kinetic friction, the relative speed above which the mass slides (m/s).
    """
    speed = model.relative_velocity(forcing, jnp.zeros_like(h), y)
    slides = None if band is None else jnp.where(jnp.abs(speed) > band, jnp.sign(speed), 0)
    start = model.rates_under(forcing, jnp.zeros_like(h), y, switch.coefficient(model.friction_at(y), speed))
    expected = moved(y, GAMMA * h, start)
    middle = _stage(model, switch, forcing, GAMMA * h, y, expected, GAMMA * h, slides)
    base, expected = moved(y, (1 - GAMMA) * h, middle.rates), moved(y, h, middle.rates)
    end = _stage(model, switch, forcing, h, base, expected, GAMMA * h, middle.slides)
    if model.time_scales_are_known:
        return end.state, None
    return end.state, _error(*without_derivatives((model, forcing, y, h, middle, end)))


class _Stage(NamedTuple):
    """A stage of a step: its state and rates, its rates without friction, and what these follow from.

    `slides`: None, or the sign of the relative velocity after it, 0 in a stick. `gross`: for each rate without friction
    the sum of its terms, each alone. `kink`: what friction could change in it, per s.
    """

    state: State
    rates: State
    slides: FloatArray | None
    free: State
    gross: State
    kink: State


def _error(model: OneContactModel, forcing: object, y: State, h: FloatArray, middle: _Stage, end: _Stage) -> FloatArray:
    """The estimated error of a step from `y` by its two stages, over the allowed one; at most 1 is accurate enough."""
    first = model.rates_under(forcing, jnp.zeros_like(h), y, jnp.zeros_like(h))
    last = model.rates_under(forcing, h, end.state, jnp.zeros_like(h))
    largest, eps = jnp.zeros_like(h), jnp.finfo(h.dtype).eps
    for i, value in enumerate(y):
        stages = zip(WEIGHTS, (first[i], middle.free[i], end.free[i]), strict=True)
        error = h * (jnp.abs(sum(weight * rate for weight, rate in stages)) + GAMMA * jnp.abs(last[i] - end.free[i]))
        error = error - ROUND_OFF * eps * (jnp.abs(value) + h * end.gross[i]) - KINK * h * h * end.kink[i]
        allowed = ERROR * h * end.gross[i]
        share = error / jnp.where(allowed > 0, allowed, 1)
        largest = jnp.maximum(largest, jnp.where((error > 0) & (allowed > 0), share, 0))
    return largest


def _stage(
    model: OneContactModel,
    switch: Switch,
    forcing: object,
    tau: FloatArray,
    base: State,
    expected: State,
    weight: FloatArray,
    slides: FloatArray | None,
) -> _Stage:
    """Solve the stage ``Y = base + weight f(tau, Y)``, linear at `expected` but for friction.

    `slides`: None, or the sign of the relative velocity before the stage, 0 in a stick.
    """

    def free(state):
        return model.rates_under(forcing, tau, state, jnp.zeros_like(tau))

    rates = free(expected)
    by_friction = tuple(
        a - b for a, b in zip(model.rates_under(forcing, tau, expected, jnp.ones_like(tau)), rates, strict=True)
    )
    jacobian = jax.jacfwd(free)(expected)
    size = len(base)
    matrix = [[(i == j) - weight * jacobian[i][j] for j in range(size)] for i in range(size)]
    missing = tuple(b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True))
    without, per_unit = _solve(matrix, [list(missing), [weight * value for value in by_friction]])

    speed, gain = jax.jvp(
        lambda state: model.relative_velocity(forcing, tau, state), (moved(expected, 1.0, without),), (per_unit,)
    )
    if slides is None:
        coefficient = _balance(switch, model.friction_at(expected), speed, -gain)
    else:
        coefficient, slides = balance_with_static(switch, model.friction_at(expected), speed, -gain, slides)
    change = tuple(a + coefficient * b for a, b in zip(without, per_unit, strict=True))
    _, turned = jax.jvp(free, (expected,), (change,))
    alone = tuple(r + t for r, t in zip(rates, turned, strict=True))
    end_rates = tuple(rate + coefficient * f for rate, f in zip(alone, by_friction, strict=True))
    terms = [[part * value for part, value in zip(row, expected, strict=True)] for row in jacobian]
    gross = tuple(jnp.abs(r - sum(row)) + sum(map(jnp.abs, row)) for r, row in zip(rates, terms, strict=True))
    # Where a rate passes through zero: as large as those that it is coupled with make it in one radian of the motion.
    pairs = [jacobian[i][j] * jacobian[j][i] for i in range(size) for j in range(size)]
    fastest = jnp.sqrt(sum(map(jnp.abs, pairs)) + jnp.finfo(tau.dtype).tiny)
    coupled = [sum(jnp.abs(j) * g for j, g in zip(row, gross, strict=True)) for row in jacobian]
    gross = tuple(
        own + jnp.where(fastest * weight > 1e-9, of / fastest, 0) for own, of in zip(gross, coupled, strict=True)
    )
    held = jnp.abs(model.friction.static)
    kink = tuple(held * sum(jnp.abs(j * f) for j, f in zip(row, by_friction, strict=True)) for row in jacobian)
    return _Stage(moved(expected, 1.0, change), end_rates, slides, alone, gross, kink)


def _balance(switch: Switch, friction: FrictionLaw, speed: FloatArray, stiffness: FloatArray) -> FloatArray:
    """The signed friction coefficient ``mu(sigma)`` at the root of ``sigma + stiffness mu(sigma) = speed``.

    Newton's method from below, on the magnitude: mu is concave up to its largest value, so that no iterate
    overshoots. With ``mu_static > mu``: `static_balance.py`. The derivatives are those of the implicit function
    (`balance_root`).
    """
    sign = jnp.where(speed < 0, -1.0, 1.0)
    given = switch, friction.in_direction(sign), jnp.abs(speed), stiffness
    switch, friction, size, stiffness = without_derivatives(given)

    def coefficient(sigma):
        return jax.jvp(lambda value: switch.coefficient(friction, value), (sigma,), (jnp.ones_like(sigma),))

    _, steepest = coefficient(jnp.full_like(size, 1e-9) * switch.width)
    sigma = jnp.maximum(size - stiffness * friction.static, size / (1 + stiffness * steepest))
    for _ in range(_NEWTON[switch.shape]):
        value, slope = coefficient(sigma)
        sigma = jnp.maximum(sigma - (sigma + stiffness * value - size) / jnp.maximum(1 + stiffness * slope, 1), 0)
    value, slope = coefficient(sigma)
    residual = sigma + stiffness * value - size
    last = slope * residual / jnp.maximum(1 + stiffness * slope, 1)  # one more Newton step
    (sigma,) = balance_root(*given, sigma)
    switch, friction, *_ = given
    return sign * (switch.coefficient(friction, sigma) - last)


def _solve(matrix: list[list[FloatArray]], sides: list[list[FloatArray]]) -> list[State]:
    """Solve small linear systems by elimination.

    Without pivoting, which steps shorter than the time scales do not need: the matrix is near the identity, or has a
    large positive diagonal where a state decays fast.
    """
    rows = [[*line, *(side[i] for side in sides)] for i, line in enumerate(matrix)]
    size = len(rows)
    for i in range(size):
        per = 1 / rows[i][i]
        rows[i] = [value * per for value in rows[i]]
        for j in range(size):
            if j != i:
                factor = rows[j][i]
                rows[j] = [a - factor * b for a, b in zip(rows[j], rows[i], strict=True)]
    return [tuple(rows[i][size + k] for i in range(size)) for k in range(len(sides))]


def moved(y: State, h: FloatArray | float, rates: State) -> State:
    """``y + h rates``."""
    return tuple(value + h * rate for value, rate in zip(y, rates, strict=True))
