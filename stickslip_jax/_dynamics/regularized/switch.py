"""The sign of the relative velocity made smooth: what regularised dynamics puts in the place of `sgn`."""

import math

import equinox as eqx
import jax.numpy as jnp

from ..._numerics.elementary import angle_of
from ..._systems.friction import FrictionLaw
from ..._types import FloatArray, Scalar

_SMOOTH = {
    "tanh": jnp.tanh,
    "linear": lambda s: jnp.clip(s, -1, 1),
    "arctan": lambda s: (2 / math.pi) * jnp.where(s < 0, -1, 1) * angle_of(jnp.abs(s), jnp.ones_like(s)),
    "rational": lambda s: s / jnp.sqrt(1 + s * s),
}
SHAPES = tuple(_SMOOTH)
_PEAK = 2.0  # widths at which a law that holds more than it rubs holds most


class Switch(eqx.Module):
    """``phi(v_rel / width)`` for ``sgn(v_rel)``; `width` in m/s, `shape` one of `SHAPES`."""

    width: Scalar
    shape: str = eqx.field(static=True)

    def __call__(self, ratio: FloatArray) -> FloatArray:
        """The smooth sign of a relative velocity given in widths."""
        return _SMOOTH[self.shape](ratio)

    def grip(self, friction: FrictionLaw, speed: FloatArray) -> FloatArray:
        """The friction coefficient at relative velocity `speed` (m/s), with its sign.

        ``kinetic(|v_rel|) phi(v_rel / width)``. A law that holds more in a stick than it rubs in a slip has a hump on
        top: a mean of the above and ``static``, whose weight rises to one at two widths, so that friction holds exactly
        as much as the law says, and falls off beyond.
        """
        ratio = speed / self.width
        rubbing = friction.kinetic(jnp.abs(speed)) * self(ratio)
        if not friction.holds_more:
            return rubbing
        part = jnp.abs(ratio) / _PEAK
        beyond = jnp.maximum(part - 1, 0)
        # Concave on the rise, so that a step can find the balance of forces from below (`implicit_step.py`).
        weight = jnp.where(part < 1, part * (2 - part), jnp.exp(-beyond * beyond))
        return rubbing * (1 - weight) + weight * jnp.sign(speed) * friction.static

    def creep(self, speed: Scalar) -> Scalar:
        """The relative velocity (m/s) that a mass has when it is released from a stick, about.

        Until then it creeps: friction balances the growing force at ``phi = force / largest``. A mass whose friction
        gives way in the time ``speed / deceleration`` is released when the creep can no longer follow the balance. That
        is where the gap ``1 - phi`` equals the time, in these units, in which the excess force brings the mass to the
        speed of creep; it leads to these powers of the width (`speed` is the system's scale of velocity, m/s). The
        factors are those at which exits are neither early nor late on average in the Poisson-switching system of Lima
        and Sampaio, at widths of 1/50, 1/500 and 1/5000 of that scale.
        """
        parts = jnp.maximum(speed / self.width, 1)
        widths = {
            "linear": jnp.ones_like(parts),
            "tanh": 0.45 + jnp.log(parts) / 4,
            "rational": 0.82 * parts**0.2,
            "arctan": 0.78 * parts ** (1 / 3),
        }
        return self.width * widths[self.shape]
