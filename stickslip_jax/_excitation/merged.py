"""A user's law of piecewise-constant base velocity as the engines need it: neighbouring velocities differ."""

from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import PyTree

from .._fields import is_of_package
from .._types import FloatScalar, KeyData, Scalar, Word
from .excitation import BaseMotion, WithJumps
from .interval_checks import marked
from .motion import Path
from .piecewise_constant import Interval, PiecewiseConstantLaw

_Present: TypeAlias = tuple[PyTree, Word, FloatScalar, FloatScalar]
"""The memory of a law after an interval, the number of the next one, and the duration and velocity of the interval."""


class Merged(PiecewiseConstantLaw):
    """The same realisations as those of `law`, until `t1` (s); neighbours of equal velocity are one interval.

    An impossible interval has the duration NaN; after it, and after one of duration 0, there are no more. Only laws of
    users need it: those of the package never repeat a velocity.
    """

    law: PiecewiseConstantLaw
    t1: Scalar

    @property
    def is_random(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of its law
        """Whether realisations differ."""
        return self.law.is_random

    def capacity(self, t1: Scalar) -> int:
        return self.law.capacity(t1)

    def begin(self, key_data, dtype):
        """Memory: the law's, the number of its next interval, and the length and velocity of the present one, which is
        drawn one step ahead; and when that begins.
        """
        nothing = jnp.full((), jnp.inf, dtype), jnp.zeros((), dtype)
        first = self._following(key_data, (self.law.begin(key_data, dtype), jnp.zeros((), jnp.uint32), *nothing), dtype)
        return first, jnp.zeros((), dtype)

    def draw(self, key_data, number, dtype):
        # Which of the law's intervals come next is in the memory, for some may have been joined.
        return jnp.asarray(key_data[0]), jnp.asarray(key_data[1])

    def next_interval(self, memory, drawn, dtype) -> Interval:
        present, began = memory
        _, _, duration, velocity = present

        def repeats(state):
            (_, _, more, after), total = state
            return (more > 0) & (after == velocity) & (began + total < self.t1)

        def join(state):
            following, total = state
            return self._following(drawn, following, dtype), total + following[2]

        following, total = lax.while_loop(repeats, join, (self._following(drawn, present, dtype), duration))
        # Intervals after the horizon are not checked: they may be impossible.
        counts = began < self.t1
        return jnp.where(counts, total, jnp.inf), jnp.where(counts, velocity, 0), (following, began + total)

    def _following(self, key_data: KeyData, present: _Present, dtype: DTypeLike) -> _Present:
        """The law's memory, number, duration and velocity after the interval with the `present` ones."""
        memory, number, duration, _ = present
        more, velocity, memory = self.law.next_interval(memory, self.law.draw(key_data, number, dtype), dtype)
        more, velocity = jnp.asarray(more, dtype), jnp.asarray(velocity, dtype)
        return memory, number + np.uint32(1), jnp.where(duration > 0, marked(more, velocity), 0), velocity


def merged(base: BaseMotion, t1: Scalar) -> BaseMotion:
    """`base`, in which a law of the user's that jumps is `Merged`."""
    if isinstance(base, WithJumps):
        jumps = merged(base.jumps, t1)
        return base if jumps is base.jumps else eqx.tree_at(lambda whole: whole.jumps, base, jumps)
    return Merged(base, t1) if isinstance(base, PiecewiseConstantLaw) and not is_of_package(base) else base


def path_in_merged(base: BaseMotion, path: Path) -> Path:
    """The path in ``merged(base, t1)`` of the number that has the `path` in `base`."""
    if isinstance(base, WithJumps) and path[:1] == ("jumps",):
        return "jumps", *path_in_merged(base.jumps, path[1:])
    return ("law", *path) if merged(base, 0.0) is not base else path
