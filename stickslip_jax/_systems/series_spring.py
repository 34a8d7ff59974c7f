"""Friction with an inner state behind a spring with free play, as one law of the motion of the spring's end.

Bristles: those of a law that is the same at every speed are a spring themselves, `share` times as stiff as at rest. So
the motion v of the spring's end is shared out: they bend by ``share v / (1 + softness share)``. The state p is the
displacement that the end would have if nothing yielded: ``p' = v (1 + softness) share / (1 + softness share)``. Where
there is no force the share is 1, and ``p' = v``: p passes the free play as the end does, its rate does not jump there.

Rate and state: the force of the spring and the inner state give the velocity of the slip, since friction at any one
state grows with it. By what the motion of the spring's end exceeds this slip, the spring bends or the play is passed.
"""

from typing import Any, ClassVar

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

    def start(self, z: Number, velocity: FloatScalar) -> FloatArray:
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


class SpeedBehindSpring(eqx.Module):
    """The `law`, whose speed follows from coefficient and inner state, behind a spring. The state is (p, z), (2,).

    - `softness`: deflection of the spring (m) per friction coefficient.
    - `play`: the free play either way, m.
    """

    law: Any
    softness: FloatScalar
    play: FloatScalar
    why_endless: ClassVar[str] = (
        " Behind a soft spring a slip may accelerate without bound (after small disturbances if it is softer than "
        "normal_force (evolution - direct) / length): then give the slider a mass (MassSpring)."
    )

    def start(self, z: Number, velocity: FloatScalar) -> FloatArray:
        """The state in which a contact of the inner state `z` slips as fast as the spring's end moves."""
        coefficient = self.law.coefficient(jnp.asarray(z, velocity.dtype), velocity)
        return jnp.stack([self.softness * coefficient + self.play * jnp.sign(coefficient), z])

    def rate(self, state: FloatArray, velocity: FloatScalar) -> FloatArray:
        """The time derivative of the state at the `velocity` (m/s) of the spring's end."""
        slip = self.law.slip_velocity(state[1], self.coefficient(state, velocity))
        return jnp.stack([velocity - slip, self.law.rate(state[1], slip)])

    def coefficient(self, state: FloatArray, velocity: FloatScalar) -> FloatArray:
        """The friction coefficient, with its sign: that of the spring's force."""
        return (state[0] - jnp.clip(state[0], -self.play, self.play)) / self.softness

    @property
    def state_scale(self) -> FloatArray:
        """Typical sizes of the state: those of its errors where it is small."""
        return jnp.stack([self.softness * self.law.mu, jnp.ones_like(self.softness)])

    @property
    def least_tolerance(self) -> FloatArray:
        """Relative, of steps: the speed is known no better than the coefficient's round-off over `direct`."""
        return jnp.asarray(8 * jnp.finfo(self.softness.dtype).eps * self.law.mu / self.law.direct, self.softness.dtype)
