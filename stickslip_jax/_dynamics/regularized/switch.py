"""Smooth switches that replace the sign of the relative velocity in regularised dynamics."""

import math
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from ..._numerics.elementary import angle_of
from ..._systems.friction import FrictionLaw
from ..._types import Array, FloatArray, Scalar

SMOOTH: dict[str, Callable[[FloatArray], Array]] = {
    "tanh": jnp.tanh,
    "linear": lambda s: jnp.clip(s, -1, 1),
    "arctan": lambda s: (2 / math.pi) * jnp.where(s < 0, -1, 1) * angle_of(jnp.abs(s), jnp.ones_like(s)),
    "rational": lambda s: s / jnp.sqrt(1 + s * s),
}
"""The switch of each name in `SHAPES`."""


class Switch(eqx.Module):
    """Smooth switch ``phi(v_rel / width)`` in place of ``sgn(v_rel)``; `width` in m/s, `shape` one of `SMOOTH`."""

    width: Scalar
    shape: str = eqx.field(static=True)

    def __call__(self, ratio: FloatArray) -> FloatArray:
        """``phi(ratio)``, the smooth sign; `ratio`: relative velocity over width."""
        return SMOOTH[self.shape](ratio)

    def coefficient(self, friction: FrictionLaw, velocity: FloatArray) -> FloatArray:
        """The signed friction coefficient at the relative `velocity` (m/s), ``kinetic(|v_rel|) phi(v_rel / width)``.

        Where ``static`` exceeds ``kinetic``, friction holds up to one width: it rises from 0 to exactly ``static``
        there, the largest value, and falls off to ``kinetic`` within a few widths more. The long tails of the smooth
        shapes are left out: on them a mass would creep faster than at one width, and not stick.
        """
        static = friction.stick_limit(velocity) if friction.static_exceeds_kinetic else None
        return self.friction(velocity, friction.slip_coefficient(velocity), static)

    def friction(
        self, velocity: FloatArray, kinetic: Scalar | FloatArray, static: Scalar | FloatArray | None
    ) -> FloatArray:
        """The signed friction, a coefficient or a force, from that of a slip at this relative `velocity` (m/s).

        `static`: the largest one, where it exceeds the `kinetic` one, else None. See `coefficient`.
        """
        ratio = velocity / self.width
        if static is None:
            return kinetic * self(ratio)
        part, beyond = jnp.clip(ratio, -1, 1), jnp.maximum(jnp.abs(ratio) - 1, 0)
        # Concave on the rise, so that a step can find the balance of forces from below (`implicit_step.py`).
        if self.shape == "linear":
            # A corner: from a smooth summit a mass would part as slowly as ``width^(2/3)``.
            held, left = static * part, jnp.exp(-beyond)
        else:
            held, left = static * part * (3 - part * part) / 2, jnp.exp(-beyond * beyond)
        slides = kinetic * part
        return jnp.where(jnp.abs(ratio) < 1, held, slides + (held - slides) * left)

    def creep(self, speed: Scalar | FloatArray) -> Scalar | FloatArray:
        """The approximate relative velocity (m/s) of a mass at its release from a stick.

        Before its release the mass creeps: friction balances the growing force at ``phi = force / largest``. The
        release is where the creep can no longer follow this balance: where the gap ``1 - phi`` equals the time, in
        units of ``speed / deceleration``, in which the excess force brings the mass to the speed of creep. This gives
        the powers of the width below (`speed`: the system's velocity scale, m/s; deceleration: that by friction). The
        factors are fitted: with them exits are neither early nor late on average in the Poisson-switching system of
        Lima and Sampaio, at widths of 1/50, 1/500 and 1/5000 of `speed`.
        """
        parts = jnp.maximum(speed / self.width, 1)
        widths = {
            "linear": jnp.ones_like(parts),
            "tanh": 0.45 + jnp.log(parts) / 4,
            "rational": 0.82 * parts**0.2,
            "arctan": 0.78 * parts ** (1 / 3),
        }
        return self.width * widths[self.shape]
