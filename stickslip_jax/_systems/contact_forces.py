"""The friction forces in several contacts at once, and which of the contacts they can hold.

With the relative velocities g (contacts,), friction forces f against them and ``g' = drift - gain f``: in a slip f is
the kinetic force with the sign of g; in sticks f is what keeps ``g' = 0``. `gain` is a matrix (contacts, contacts),
for a mechanical system ``W M^-1 W^T`` with the directions W of the contacts; or, where friction in one contact has no
effect on the others, its diagonal (contacts,).

Which contacts at rest are held is a linear complementarity problem with bounds on both sides. Where static and kinetic
friction are equal and the gain is positive definite it has one solution (Stewart and Trinkle 1996; Pfeiffer and
Glocker 1996). Where static friction is larger the rule is one after the other: what stuck holds up to its static limit,
the stick that needs the largest share of its limit breaks first and falls to kinetic friction, and then the rest are
asked again. What has broken and is driven back by the others is held again by at most its kinetic friction; that is
settled among all that have broken before the rest are asked.
"""

from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
from jax import lax

from .._numerics.small_matrices import linear_solve, times
from .._types import BoolArray, BoolScalar, FloatArray, IntArray
from .switched_model import Question

_PASSES = 3  # for each contact: how often one may break, or be held again


class Uncoupled(NamedTuple):
    """The gain of contacts that have no effect on each other: its `diagonal`, and the `inverse` of that, 0 where a
    contact couples nothing, (contacts,).
    """

    diagonal: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, diagonal: FloatArray) -> "Uncoupled":
        """From the diagonal."""
        couples = diagonal > 0
        return cls(diagonal, jnp.where(couples, 1 / jnp.where(couples, diagonal, 1), 0))


Gain: TypeAlias = FloatArray | Uncoupled


def acceleration(gain: Gain, drift: FloatArray, force: FloatArray) -> FloatArray:
    """The rates of the relative velocities under these friction forces."""
    return drift - (gain.diagonal * force if isinstance(gain, Uncoupled) else times(gain, force))


def solved(gain: Gain, wanted: FloatArray, given: FloatArray, chosen: BoolArray) -> FloatArray:
    """The forces with ``gain force = wanted`` in the `chosen` contacts; `given` ones in the others.

    A gain of zero, of a contact that couples nothing, gives no force.
    """
    if isinstance(gain, Uncoupled):
        return jnp.where(chosen, wanted * gain.inverse, given)
    both = chosen[:, None] & chosen[None, :]
    matrix = jnp.where(both, gain, jnp.eye(len(chosen), dtype=gain.dtype))
    others = jnp.where(chosen, 0, given)
    target = jnp.where(chosen, wanted - times(gain, others), given)
    return linear_solve(matrix, target)


def holding(gain: Gain, sticks: BoolArray) -> FloatArray:
    """The matrix of the forces that `sticks` need for each unit of `drift`: the inverse of their gain, zero elsewhere.

    Where contacts have no effect on each other, its diagonal.
    """
    if isinstance(gain, Uncoupled):
        return jnp.where(sticks, gain.inverse, 0)
    both = sticks[:, None] & sticks[None, :]
    one = jnp.eye(len(sticks), dtype=gain.dtype)
    return jnp.where(both, linear_solve(jnp.where(both, gain, one), one), 0)


class Limits(NamedTuple):
    """The friction forces (contacts,) that are possible: in slips forward and backward, and at most in sticks that
    would break into them. All are zero or positive.
    """

    forward: FloatArray
    backward: FloatArray
    static_forward: FloatArray
    static_backward: FloatArray

    def slip(self, sign: FloatArray) -> FloatArray:
        """The force in a slip of this sign; 0 for the sign 0."""
        return jnp.where(sign > 0, self.forward, jnp.where(sign < 0, -self.backward, 0))

    @property
    def largest(self) -> FloatArray:
        """The largest friction forces in sticks; of normal forces that are negative, as if they were positive."""
        return jnp.maximum(jnp.abs(self.static_forward), jnp.abs(self.static_backward))

    def static(self, force: FloatArray) -> FloatArray:
        """The limit of a stick that needs this `force`."""
        return jnp.where(force > 0, self.static_forward, self.static_backward)

    def band(self, force: FloatArray, broken: BoolArray | bool = False) -> tuple[FloatArray, FloatArray]:
        """The `stick_band` of sticks that need this `force`.

        `broken`: what kinetic friction must hold, its stick being over.
        """
        forward = jnp.where(broken, self.forward, self.static_forward)
        backward = jnp.where(broken, self.backward, self.static_backward)
        return stick_band(forward, backward, jnp.where(force > 0, forward, backward))

    def share(self, force: FloatArray, broken: BoolArray | bool = False) -> FloatArray:
        """The `force` that a stick needs, over the largest one in its direction; infinite where none is possible.

        Both from the middle of the `band` on.
        """
        middle, limit = self.band(force, broken)
        can = limit > 0
        return jnp.where(can, (force - middle) / jnp.where(can, limit, 1), jnp.inf)


def stick_band(forward: FloatArray, backward: FloatArray, limit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The middle of the friction forces that a stick can have, and how far they reach from there.

    `forward`, `backward`: the largest in sticks that would break into such slips. Where both have friction the middle
    is 0, and the `limit` how far they reach in the direction that is asked. Where only one has, forces end at 0, and
    from there round-off would decide into which slip a stick breaks.
    """
    is_one_sided = (forward == 0) != (backward == 0)
    middle, half_width = (forward - backward) / 2, (forward + backward) / 2
    return jnp.where(is_one_sided, middle, 0), jnp.where(is_one_sided, half_width, limit)


class Settled(NamedTuple):
    """The mode `sign` (contacts,) of every contact; of those asked, the `share` of its limit that a stick needs."""

    sign: FloatArray
    share: FloatArray


def settled(gain: Gain, drift: FloatArray, limits: Limits, question: Question, slack: FloatArray) -> Settled:
    """Which contacts that are asked friction holds.

    `slack`: by how much the share of a stick that goes on may exceed 1: round-off at the limit.
    """
    asked = question.asked

    def shares(sign: FloatArray, broken: BoolArray | bool = False) -> tuple[FloatArray, FloatArray, FloatArray]:
        """All forces, into which slips they drive sticks, and their shares of what friction can hold."""
        force = solved(gain, drift, limits.slip(sign), asked & (sign == 0))
        driven = jnp.where(force > limits.band(force, broken)[0], 1, -1).astype(drift.dtype)
        return force, driven, limits.share(force, broken)

    # What has just been released slips in the direction in which it is driven.
    start = jnp.where(asked, 0, question.sign)
    _, driven, share = shares(start)
    start = jnp.where(question.released, driven, start)
    allowed = 1 + jnp.where(question.goes_on, slack, 0)
    if isinstance(gain, Uncoupled):
        breaks = asked & ~question.released & (jnp.abs(share) > allowed)
        return Settled(jnp.where(breaks, driven, start), share)

    def again(state: tuple[FloatArray, FloatArray, BoolArray, IntArray, BoolScalar]):
        sign, decisive, broken, passes, _ = state
        force, driven, share = shares(sign, broken)
        held, slips = asked & (sign == 0), asked & (sign != 0) & ~question.released
        excess = jnp.where(held, jnp.abs(share) - allowed, -jnp.inf)
        # A contact that others drive back is held again: its friction alone would reverse it.
        back = jnp.where(slips, -sign * acceleration(gain, drift, force), -jnp.inf)
        returns = (back == jnp.max(back)) & (back > 0)
        # What has broken settles at kinetic friction before anything else is asked whether it breaks too.
        excess = jnp.where(jnp.any(broken & (excess > 0)) & ~broken, -jnp.inf, excess)
        breaks = (excess == jnp.max(excess)) & (excess > 0) & ~jnp.any(returns)
        decisive = jnp.where(held, share, decisive)
        new = jnp.where(breaks, driven, jnp.where(returns, 0, sign)).astype(sign.dtype)
        return new, decisive, broken | breaks, passes + 1, jnp.any(breaks | returns)

    most = _PASSES * len(drift) + 1
    first = (start, share, jnp.zeros_like(asked), jnp.zeros((), jnp.int32), jnp.any(asked))
    sign, share, *_ = lax.while_loop(lambda s: s[4] & (s[3] < most), again, first)
    return Settled(sign, share)
