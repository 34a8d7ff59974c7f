"""Bristles behind a spring with free play, as one law of the motion of the spring's end.

The bristles of a law that is the same at every speed are a spring themselves, `share` times as stiff as at rest. So the
motion v of the spring's end is shared out: they bend by ``share v / (1 + softness share)``. The state p is the
displacement that the end would have if nothing yielded: ``p' = v (1 + softness) share / (1 + softness share)``. Where
there is no force the share is 1, and ``p' = v``: p passes the free play as the end does, its rate does not jump there.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._types import FloatArray, FloatScalar, Number, Scalar


class BehindSpring(eqx.Module):
    """The `law` behind a spring.

    - `softness`: of the spring, over that of the bristles at rest.
    - `play`: the free play either way, m.
    """

    law: Any
    softness: FloatScalar
    play: FloatScalar

    def start(self, z: Number) -> FloatArray:
        """The state in which the bristles are bent by `z` (m); in the middle of the free play if they are not."""
        return (1 + self.softness) * jnp.asarray(z) + self.play * jnp.sign(z)

    def deflection(self, p: FloatScalar) -> FloatArray:
        """Of the bristles, m."""
        return (p - jnp.clip(p, -self.play, self.play)) / (1 + self.softness)

    def rate(self, p: FloatScalar, velocity: FloatScalar) -> FloatArray:
        """The time derivative of the state at the `velocity` (m/s) of the spring's end."""
        way = jnp.where(velocity < 0, -1.0, 1.0)
        share = self.law.rate(self.deflection(p), way) * way
        return velocity * (1 + self.softness) * share / (1 + self.softness * share)

    def coefficient(self, p: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        """The friction coefficient, with its sign."""
        return self.law.coefficient(self.deflection(p), velocity)

    @property
    def state_scale(self) -> Scalar:
        """A typical size of the state: that of its errors where it is small."""
        return (1 + self.softness) * self.law.state_scale
