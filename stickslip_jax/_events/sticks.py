"""What is recorded of a trajectory: its sticks, and the slips between them."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Real

from .._types import AnyArray
from .records import StickRecord, closed_up


class Sticks(eqx.Module):
    """Sticks in order of time, in slots of which `mask` marks the filled ones.

    Arrays have the shape (slots,) for one trajectory and (samples, slots) for an ensemble; sticks fill the first slots.
    Slots outside `mask` hold NaN (ending: -1), are for display only, and enter no statistic.

    - `start`, `end`: s. `position`: of the mass when the stick starts, m (of a motor: its angle, rad).
    - `ending`: an `Ending` code: 0 RELEASED, 1 BASE_SWITCHED, 2 HORIZON (censored by the end of the simulation).
    """

    start: Float[AnyArray, "*batch slots"]
    end: Float[AnyArray, "*batch slots"]
    position: Float[AnyArray, "*batch slots"]
    ending: Int[AnyArray, "*batch slots"]
    mask: Bool[AnyArray, "*batch slots"]

    @property
    def duration(self) -> Float[AnyArray, "*batch slots"]:
        """How long each stick lasts, s (NaN outside `mask`)."""
        return self.end - self.start

    @property
    def count(self) -> Int[AnyArray, "*batch"]:
        """Number of sticks."""
        return self.mask.sum(axis=-1)

    def __repr__(self) -> str:
        shown = type(self).__name__
        if isinstance(self.mask, np.ndarray) or hasattr(self.mask, "addressable_shards"):
            return f"{shown}({int(np.sum(np.asarray(self.mask)))} in slots of shape {self.mask.shape})"
        return f"{shown}(slots of shape {self.mask.shape})"


class Slips(eqx.Module):
    """Slips in order of time: what is left of [0, t1] outside the sticks. Slots outside `mask` hold NaN.

    - `start`, `end`: s. `censored`: cut by the horizon.
    """

    start: Float[AnyArray, "*batch slots"]
    end: Float[AnyArray, "*batch slots"]
    censored: Bool[AnyArray, "*batch slots"]
    mask: Bool[AnyArray, "*batch slots"]

    @property
    def duration(self) -> Float[AnyArray, "*batch slots"]:
        """How long each slip lasts, s (NaN outside `mask`)."""
        return self.end - self.start

    @property
    def count(self) -> Int[AnyArray, "*batch"]:
        """Number of slips."""
        return self.mask.sum(axis=-1)


def sticks_in_order(start, end, position, ending) -> Sticks:
    """Gather one trajectory's records so that the sticks come first; differentiable, fixed size.

    Arrays of shape (records,); `ending` is negative where there is no stick.
    """
    ordered = closed_up(StickRecord(start, end, position, ending))
    return Sticks(*ordered, ordered.ending >= 0)


def slips_between(sticks: Sticks, t1: Real[AnyArray, "*batch"] | float) -> Slips:
    """The slips of one trajectory or of many: before the first stick, between sticks, after the last.

    `sticks` hold (..., slots), the result one slot more. A slip of no length (a stick from t = 0, or to the horizon)
    is no slip.
    """
    batch = sticks.mask.shape[:-1]
    dtype = sticks.start.dtype
    edge = jnp.ones((*batch, 1), bool)
    # Slip i runs from the end of stick i - 1 to the start of stick i; the last one to the horizon.
    start = jnp.concatenate([jnp.zeros((*batch, 1), dtype), sticks.end], axis=-1)
    end = jnp.concatenate([sticks.start, jnp.full((*batch, 1), jnp.nan, dtype)], axis=-1)
    exists = jnp.concatenate([edge, sticks.mask], axis=-1)
    is_last = exists & ~jnp.concatenate([sticks.mask, ~edge], axis=-1)
    end = jnp.where(is_last, jnp.asarray(t1, dtype)[..., None], end)
    mask = exists & (jnp.where(exists, end, 0) > jnp.where(exists, start, 0))
    # Slots of no length are closed up, so that slips fill the first slots.
    order = jnp.argsort(~mask, axis=-1, stable=True)
    mask = jnp.take_along_axis(mask, order, axis=-1)

    def fill(values):
        return jnp.where(mask, jnp.take_along_axis(values, order, axis=-1), jnp.nan)

    censored = jnp.take_along_axis(is_last, order, axis=-1) & mask
    return Slips(fill(start), fill(end), censored, mask)


class FlatSticks(NamedTuple):
    """The sticks of many samples one after the other (the "contiguous ragged" form of CF conventions).

    In order of sample, then time. Times in s; the position in m, of a motor its angle in rad.
    """

    count: np.ndarray  # (samples,)
    start: np.ndarray  # (all sticks,), as the following
    end: np.ndarray
    position: np.ndarray
    ending: np.ndarray

    @property
    def duration(self) -> np.ndarray:
        """How long each stick lasts, s."""
        return self.end - self.start

    @property
    def first(self) -> np.ndarray:
        """Where the sticks of each sample begin, (samples,)."""
        return np.cumsum(self.count) - self.count

    @property
    def sample(self) -> np.ndarray:
        """The sample that each stick belongs to."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @property
    def begins_at_zero(self) -> np.ndarray:
        """Whether each sample begins with a stick, (samples,)."""
        begins = self.count > 0
        begins[begins] = self.start[self.first[begins]] == 0
        return begins

    def without_initial_rest(self) -> "FlatSticks":
        """The same without the sticks that begin at t = 0."""
        begins = self.begins_at_zero
        if not np.any(begins):
            return self
        kept = np.ones(len(self.start), bool)
        kept[self.first[begins]] = False
        return FlatSticks(self.count - begins, *(column[kept] for column in self[1:]))

    def only(self, chosen: np.ndarray) -> "FlatSticks":
        """The sticks of the `chosen` samples, a mask (samples,)."""
        if np.all(chosen):
            return self
        kept = np.repeat(chosen, self.count)
        return FlatSticks(self.count[chosen], *(column[kept] for column in self[1:]))

    def head(self, samples: int) -> "FlatSticks":
        """The sticks of so many samples, the first."""
        sticks = int(self.count[:samples].sum())
        return FlatSticks(self.count[:samples].copy(), *(column[:sticks].copy() for column in self[1:]))

    @classmethod
    def joined(cls, parts: "list[FlatSticks]") -> "FlatSticks":
        """The sticks of all parts, one part after the other."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def padded(self) -> Sticks:
        """As `Sticks` with arrays (samples, slots), slots being the largest count (at least 1)."""
        slots = max(1, int(self.count.max(initial=0)))
        mask = np.arange(slots) < self.count[:, None]

        def fill(values, padding):
            padded = np.full(mask.shape, padding, values.dtype)
            padded[mask] = values
            return padded

        return Sticks(fill(self.start, np.nan), fill(self.end, np.nan), fill(self.position, np.nan),
                      fill(self.ending, -1), mask)  # fmt: skip
