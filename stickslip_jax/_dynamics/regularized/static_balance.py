"""The balance of forces in a stage of an implicit step where static friction exceeds kinetic friction.

Friction then falls off where a stick ends, and a step that does not resolve this fall has two balances: the mass
sticks, or it slides. Which one holds follows from what the mass did before: a sliding mass slides as long as it can,
and one that sticks does so as long as it can.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ..._numerics.primal import without_derivatives
from ..._systems.friction import FrictionLaw
from ..._types import BoolArray, FloatArray, Scalar
from .balance_root import balance_root
from .switch import Switch

_RISE, _FALL = 7, 10  # iterations
_BALANCED = 1e-6  # of the largest friction: as good as equal

# Of a relative velocity: the friction coefficient, its slope, what is missing from a balance, and the slope of that.
_Missing = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray, FloatArray]]


def balance_with_static(
    switch: Switch, friction: FrictionLaw, speed: FloatArray, stiffness: FloatArray, slides: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The signed friction coefficient at a root of ``sigma + stiffness mu(sigma) = speed``, and whether it slides.

    `slides`, and what is returned: the sign of the relative velocity of a mass that slides, 0 for one that sticks.
    """
    sign = jnp.where(speed < 0, -1.0, 1.0)
    given = switch, friction.in_direction(sign), jnp.abs(speed), stiffness
    switch, friction, size, stiffness = without_derivatives(given)
    most = switch.width + stiffness * friction.static  # what a stick can take up

    def missing(sigma):
        value, slope = jax.jvp(lambda at: switch.coefficient(friction, at), (sigma,), (jnp.ones_like(sigma),))
        return value, slope, sigma + stiffness * value - size, 1 + stiffness * slope

    least = _BALANCED * stiffness * friction.static
    sliding, balanced = _sliding(missing, switch.width, size, least)
    breaks = size > most + least
    chosen = breaks | ((slides == sign) & balanced)
    sigma = jnp.where(chosen, sliding, _sticking(missing, switch, size))
    _, slope, rest, gain = missing(sigma)
    last = slope * rest / jnp.where(gain > 0, gain, 1)  # one more Newton step
    (sigma,) = balance_root(*given, sigma)
    switch, friction, *_ = given
    return sign * (switch.coefficient(friction, sigma) - last), jnp.where(chosen, sign, 0)


def _sticking(missing: _Missing, switch: Switch, size: FloatArray) -> FloatArray:
    """The balance in a stick, by Newton's method from below: the rise to static friction is concave."""
    inside = switch.width * (1 - 1e-7)
    _, _, _, steepest = missing(jnp.full_like(size, 1e-9) * switch.width)
    sigma = jnp.minimum(size / steepest, inside)
    for _ in range(_RISE):
        _, _, rest, gain = missing(sigma)
        sigma = jnp.clip(sigma - rest / jnp.maximum(gain, 1), 0, inside)
    return sigma


def _sliding(missing: _Missing, width: Scalar, size: FloatArray, tolerance: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The fastest balance beyond the `width`, by Newton's method from above, and whether there is one."""
    low, high = jnp.minimum(jnp.full_like(size, width), size), size
    sigma = size
    for _ in range(_FALL):
        _, _, rest, gain = missing(sigma)
        low, high = jnp.where(rest > 0, low, sigma), jnp.where(rest > 0, sigma, high)
        following = sigma - rest / jnp.where(gain > 0, gain, 1)
        sigma = jnp.where((gain > 0) & (following >= low) & (following <= high), following, (low + high) / 2)
    _, _, rest, gain = missing(sigma)
    return sigma, (jnp.abs(rest) <= tolerance) & (gain > 0) & (sigma > width)
