"""Steps that end where static friction takes hold of the mass or lets it go.

Where static friction exceeds kinetic friction, a step that passes such an instant goes wrong by more than its length: a
mass that jumps over the narrow band of relative velocities in which static friction holds it slides on for good. So the
step is tried again, shortened to end at that instant. The instants carry derivatives: those of the motion after a
release depend on when it was.
"""

import jax.numpy as jnp

from ..._types import BoolArray, FloatArray
from .stick_detector import Step, hermite

_SAME = 1e-6  # of the change of the needed friction in a step: so near to the limit counts as there
_ULPS = 16
_NEAR = 0.98  # of a step: a passage that soon is at its end


def shortened(step: Step, band: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether the step must be tried again, and its new length, s.

    `band`: the relative speed below which static friction can hold the mass, m/s.
    """
    before, after = _side(step.r0, band), _side(step.r1, band)
    # Bounded measures of the needed friction, 1/2 at its limit.
    holds, held = 1 / (1 + step.need0) - 0.5, 1 / (1 + step.need1) - 0.5
    least = _SAME * jnp.abs(holds - held) + _ULPS * jnp.finfo(step.h.dtype).eps
    released = (before == 0) & (holds > least) & (held < -least)
    # While less than static friction is needed, no mass leaves the band.
    strays = (before == 0) & (after != 0) & (held > -least) & (holds > least)

    # Where it slid slowest; if it slid the other way, it was in the band.
    falls, rises = -before * step.slope0, before * step.slope1
    turns = (before != 0) & (before == after) & (falls > 0) & (rises > 0)
    lowest_at = jnp.where(turns, step.h * falls / jnp.where(turns, falls + rises, 1), step.h)
    lowest = jnp.where(turns, hermite(lowest_at, step.h, step.r0, step.slope0, step.r1, step.slope1), step.r1)
    crosses = (before != 0) & ((before == -after) | turns) & (before * lowest < 0)

    # Where more than static friction is needed, it only passes the band.
    soon = jnp.abs(step.r0) / jnp.where(falls > 0, falls, 1)
    passes = (before != 0) & (after == 0) & (held < -least) & (falls > 0) & (soon < _NEAR * step.h)

    until_release = step.h * _share(released, holds, -held)
    until_zero = lowest_at * _share(crosses, jnp.abs(step.r0), jnp.abs(lowest))
    length = jnp.where(passes, soon, jnp.where(crosses, until_zero, step.h / 2))
    return released | strays | crosses | passes, jnp.where(released, until_release, length)


def _side(speed: FloatArray, band: FloatArray) -> FloatArray:
    return jnp.where(jnp.abs(speed) > band, jnp.sign(speed), 0)


def _share(chosen: BoolArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """``one / (one + other)``."""
    return jnp.where(chosen, one, 0) / jnp.where(chosen, one + other, 1)
