"""What drives a user's `SwitchedSystem` from one instant on: its base, the ground, and the records in its fields."""

from collections.abc import Iterable
from typing import Any, NamedTuple, TypeVar

import jax

from .._excitation.force_steps import ForceSteps
from .._excitation.recorded import Recorded
from .._excitation.segments import added
from .._excitation.smooth import Signal
from .._types import FloatScalar
from .switched_model import Segments, base_motion

S = TypeVar("S")


class UsersBase(NamedTuple):
    """The base at one instant, as a user's methods are given it; zeros for a base and a ground at rest.

    - `velocity`, `acceleration`: of the base, m/s and m/s^2 (or rad/s and rad/s^2).
    - `ground`: the acceleration of the ground, m/s^2.
    """

    velocity: FloatScalar
    acceleration: FloatScalar
    ground: FloatScalar


class GeneralForcing(NamedTuple):
    """The piecewise-linear parts of base velocity (m/s) and ground acceleration (m/s^2) from time `t` on, and the
    values of the records in the fields of the system: each with its slope.
    """

    t: FloatScalar
    base: FloatScalar
    base_slope: FloatScalar
    ground: FloatScalar
    ground_slope: FloatScalar
    records: tuple[tuple[FloatScalar, FloatScalar], ...]

    @classmethod
    def of(cls, t: FloatScalar, segments: Segments) -> "GeneralForcing":
        """The forcing from `t` on, until one of the present segments ends."""
        records = tuple(added(t, (segment,)) for segment in segments.force)
        return cls(t, *added(t, segments.base), *added(t, segments.ground), records)

    def base_at(self, smooth: Signal | None, tau: FloatScalar) -> UsersBase:
        """The base `tau` (s) later, of velocity ``smooth`` plus the linear part."""
        base = base_motion(smooth, self.t, self.base, self.base_slope, tau)
        return UsersBase(base.velocity, base.acceleration, self.ground + tau * self.ground_slope)

    def seen_at(self, system: S, t: FloatScalar) -> S:
        """The `system` whose records have their value at `t` on their present segments, without a search in them."""
        if not self.records:
            return system
        return with_records_at(system, t, [value + (t - self.t) * slope for value, slope in self.records])


def with_records_at(system: S, t: FloatScalar, values: Iterable[FloatScalar]) -> S:
    """The `system` whose records have these `values` at `t`."""
    now, (leaves, tree) = iter(values), jax.tree.flatten(system, is_leaf=is_record)
    return jax.tree.unflatten(tree, [_SeenAt(leaf, t, next(now)) if is_record(leaf) else leaf for leaf in leaves])


def is_record(value: object) -> bool:
    """Whether `value` is piecewise linear in time, at given times."""
    return isinstance(value, (Recorded, ForceSteps))


def records_in(system: Any) -> tuple[Recorded | ForceSteps, ...]:
    """The records in the fields of `system`."""
    return tuple(leaf for leaf in jax.tree.leaves(system, is_leaf=is_record) if is_record(leaf))


class _SeenAt:
    """A record at the time `t` that a user's method is given: its value there is that of the present segment.

    At its ends a step sees the same segment as inside. At other times the record is asked.
    """

    def __init__(self, record: Recorded | ForceSteps, t: FloatScalar, now: FloatScalar):
        self._record, self._t, self._now = record, t, now

    # It is one of these to isinstance, as methods that take numbers too ask.
    @property
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return type(self._record)

    def value(self, t: Any) -> Any:
        return self._now if t is self._t else self._record.value(t)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._record, name)
