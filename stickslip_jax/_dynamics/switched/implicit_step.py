"""One step of fixed length of regularised dynamics, stable for any width.

The method is the singly diagonally implicit Runge-Kutta method of order 2 with ``gamma = 1 - 1/sqrt(2)`` (Alexander
1977; L-stable). In each stage everything but the friction is linearised at a predicted state. One equation for the
relative velocity remains, ``sigma + K grip(sigma) = sigma*`` (`_balance`). A step may be far longer than the time in
which friction changes the relative velocity by one width: it then ends in the stick, as it should, where a step with
linearised friction would overshoot it to and fro.
"""

import math

import jax
import jax.numpy as jnp

from ..._numerics.primal import without_derivatives
from ..._systems.friction import FrictionLaw
from ..._systems.switched_model import State, SwitchedModel
from ..._types import FloatArray
from ..regularized.switch import Switch
from .balance_root import balance_root
from .static_balance import balance_with_static

_GAMMA = 1 - 1 / math.sqrt(2)
_NEWTON = {"linear": 3, "tanh": 7, "rational": 7, "arctan": 7}


def implicit_step(
    model: SwitchedModel, switch: Switch, inputs: object, y: State, h: FloatArray, band: FloatArray | None = None
) -> State:
    """The state after one step of length `h` (s) from the state `y`.

    `band`: where static friction exceeds kinetic friction, the relative speed above which the mass slides (m/s).
    """
    speed = model.relative_velocity(inputs, jnp.zeros_like(h), y)
    slides = None if band is None else jnp.where(jnp.abs(speed) > band, jnp.sign(speed), 0)
    start = model.rates_under(inputs, jnp.zeros_like(h), y, switch.grip(model.friction, speed))
    expected = _moved(y, _GAMMA * h, start)
    _, first, slides = _stage(model, switch, inputs, _GAMMA * h, y, expected, _GAMMA * h, slides)
    base, expected = _moved(y, (1 - _GAMMA) * h, first), _moved(y, h, first)
    end, _, _ = _stage(model, switch, inputs, h, base, expected, _GAMMA * h, slides)
    return end


def _stage(
    model: SwitchedModel,
    switch: Switch,
    inputs: object,
    tau: FloatArray,
    base: State,
    expected: State,
    weight: FloatArray,
    slides: FloatArray | None,
) -> tuple[State, State, FloatArray | None]:
    """Solve the stage ``Y = base + weight f(tau, Y)``, linear at `expected` but for friction; returns Y, f(tau, Y).

    `slides`: None, or the sign of the relative velocity before the stage, 0 in a stick; and the same after it.
    """

    def free(state):
        return model.rates_under(inputs, tau, state, jnp.zeros_like(tau))

    rates = free(expected)
    push = tuple(
        a - b for a, b in zip(model.rates_under(inputs, tau, expected, jnp.ones_like(tau)), rates, strict=True)
    )
    jacobian = jax.jacfwd(free)(expected)
    size = len(base)
    matrix = [[(i == j) - weight * jacobian[i][j] for j in range(size)] for i in range(size)]
    missing = tuple(b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True))
    without, by_grip = _solve(matrix, [list(missing), [weight * value for value in push]])

    speed, per_grip = jax.jvp(
        lambda state: model.relative_velocity(inputs, tau, state), (_moved(expected, 1.0, without),), (by_grip,)
    )
    if slides is None:
        grip = _balance(switch, model.friction, speed, -per_grip)
    else:
        grip, slides = balance_with_static(switch, model.friction, speed, -per_grip, slides)
    change = tuple(a + grip * b for a, b in zip(without, by_grip, strict=True))
    _, turned = jax.jvp(free, (expected,), (change,))
    end_rates = tuple(r + t + grip * p for r, t, p in zip(rates, turned, push, strict=True))
    return _moved(expected, 1.0, change), end_rates, slides


def _balance(switch: Switch, friction: FrictionLaw, speed: FloatArray, stiffness: FloatArray) -> FloatArray:
    """The signed friction coefficient ``grip(sigma)`` at the root of ``sigma + stiffness grip(sigma) = speed``.

    Newton's method from below, on the magnitude: `grip` is concave up to its largest value, so that no iterate
    overshoots. With ``mu_static > mu``: `static_balance.py`. The derivatives are those of the implicit function
    (`balance_root`).
    """
    given, sign = (switch, friction, jnp.abs(speed), stiffness), jnp.where(speed < 0, -1.0, 1.0)
    switch, friction, size, stiffness = without_derivatives(given)

    def grip(sigma):
        return jax.jvp(lambda value: switch.grip(friction, value), (sigma,), (jnp.ones_like(sigma),))

    _, steepest = grip(jnp.full_like(size, 1e-9) * switch.width)
    sigma = jnp.maximum(size - stiffness * friction.static, size / (1 + stiffness * steepest))
    for _ in range(_NEWTON[switch.shape]):
        value, slope = grip(sigma)
        sigma = jnp.maximum(sigma - (sigma + stiffness * value - size) / jnp.maximum(1 + stiffness * slope, 1), 0)
    value, slope = grip(sigma)
    residual = sigma + stiffness * value - size
    last = slope * residual / jnp.maximum(1 + stiffness * slope, 1)  # one more Newton step
    (sigma,) = balance_root(*given, sigma)
    switch, friction, *_ = given
    return sign * (switch.grip(friction, sigma) - last)


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


def _moved(y: State, h: FloatArray | float, rates: State) -> State:
    return tuple(value + h * rate for value, rate in zip(y, rates, strict=True))
