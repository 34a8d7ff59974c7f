"""The base velocity of any motion at any times."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.errors import ConcretizationTypeError

from .. import _checks
from .._forks import require_threads_of_jax
from .._numerics.known import NotKnown
from .._types import AnyArray, FloatArray, FloatScalar
from .excitation import BaseMotion, excitation_of, motion_of
from .segment_table import SegmentTable
from .segments import SegmentLaw
from .voltage import SourceVoltage


def base_velocity(base: BaseMotion, times: AnyArray | Sequence[float] | float | int) -> FloatArray:
    """The velocity of a base motion at any times, as `simulate` follows it.

    Args:
        base: A base motion without randomness: a signal such as `Harmonic`, a `Recorded`, a law such as `SquareWave`, a
            realisation ``law.sample(key, t1)``, a `WithJumps` of such, or an object of your own with ``velocity(t)``
            and ``acceleration(t)``.
        times: s, any shape.

    Returns:
        The velocity (m/s) with the shape of `times`; at a jump, the one after it. NaN before t = 0 and after its end
        for a motion in segments, such as a record.

    Raises:
        ValueError: For a random law, a ground acceleration and a voltage; and for a law such as `SquareWave` where
            `times` are traced by a JAX transformation.

    >>> print(ss.base_velocity(ss.Recorded([0.0, 2.0], [0.0, 1.0]), [0.0, 0.5, 2.0]))
    [0.   0.25 1.  ]
    """
    require_threads_of_jax()
    motion = motion_of(base)
    _checks.numeric("times", times, ndim=None)
    if motion.is_random:
        raise ValueError(
            f"Argument base must be a realisation, but the random law {type(base).__name__} was given; draw one with "
            "base.sample(key, t1)."
        )
    excitation = excitation_of(motion)
    if excitation.ground or isinstance(excitation.smooth, SourceVoltage):
        what = "a ground acceleration" if excitation.ground else "a voltage"
        raise ValueError(
            f"Argument base must be a base velocity, but {what} was given, under which the base is at rest."
        )
    times = jnp.asarray(times, jnp.result_type(float))
    flat = times.reshape(-1)
    tables = [_table(law, flat) for law in excitation.base]

    def at(time: FloatScalar) -> FloatScalar:
        smooth = excitation.signal
        velocity = jnp.zeros_like(time) if smooth is None else jnp.asarray(smooth.value(time), time.dtype)
        for table in tables:
            segment = table.at(time)
            here = segment.value + segment.slope * (time - segment.begin)
            velocity = velocity + jnp.where((time >= 0) & (time <= table.end), here, jnp.nan)
        return velocity

    return jax.vmap(at)(flat).reshape(times.shape)


def _table(law: SegmentLaw, times: FloatArray) -> SegmentTable:
    """The segments of a law without randomness until the last of `times`, and one more: it may begin there."""
    latest = jnp.max(times) if _checks.is_traced(times) else float(np.max(np.asarray(times), initial=0.0))
    try:
        number = law.segments(latest)
    except (ConcretizationTypeError, NotKnown):
        raise ValueError(
            "Argument base must be a realisation where times or its numbers are traced by a JAX transformation (it "
            f"is not known then how many segments it has), but the law {type(law).__name__} was given; take "
            "base.sample(None, t1)."
        ) from None
    none = jnp.zeros((), jnp.uint32)
    return SegmentTable.of(law, (none, none), number + 1, times.dtype)
