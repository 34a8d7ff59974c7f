"""Sticks of trajectories and the slips between them: what is recorded of each, in which order, and as tables."""

import abc
import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Bool, Float, Int, Real

from .._compiler.native import native_loop, native_loops_work
from .._compiler.programs import kept_jit
from .._foundation import checks
from .._foundation.extras import Entries, flags, variable
from .._foundation.files import Columns
from .._foundation.types import AnyArray, BoolArray, Ending, FloatArray, IntArray
from .._numerics import device_loops, sums
from .._systems.system import Coordinate

# What is recorded of each stick besides its times, its position and how it ended: a class for each such number.
#
# To add one: a class here, its line in `QUANTITIES`, and a field of `Sticks`, which users see. All engines, files and
# tables have it then. It costs time only where sticks are recorded: totals alone ask for none.


class StickSpan(NamedTuple):
    """When and where a stick lasted: `start` and `end`, s; `position` at its start; `left_at`: position at its end."""

    start: FloatArray
    end: FloatArray
    position: FloatArray
    left_at: FloatArray


class StickQuantity(abc.ABC):
    """A number of each stick. `label`: its name in tables and figures. `unit`: None for that of the position."""

    label: str
    unit: str | None

    @abc.abstractmethod
    def begin(self, position: FloatArray) -> Any:
        """What is remembered at t = 0, where the mass is at `position`: an array, or a tuple or dict of arrays."""

    @abc.abstractmethod
    def at_end(self, remembered: Any, stick: StickSpan) -> tuple[FloatArray, Any]:
        """The number of a stick that has ended, and what is remembered from there on."""


class SlipDisplacement(StickQuantity):
    """Displacement of the mass from the end of the stick before, or from its start at t = 0."""

    label = "displacement in the slip before the stick"
    unit = None

    def begin(self, position: FloatArray) -> FloatArray:
        return position

    def at_end(self, remembered: FloatArray, stick: StickSpan) -> tuple[FloatArray, FloatArray]:
        return stick.position - remembered, stick.left_at


QUANTITIES: dict[str, StickQuantity] = {"slip_displacement": SlipDisplacement()}
"""By the name of their column; a file or a table of measured sticks may lack them (NaN then)."""

ALL = tuple(QUANTITIES)
Remembered: TypeAlias = dict[str, Any]
"""What each quantity that is asked for remembers, by its name."""


def begin_quantities(position: FloatArray, asked: tuple[str, ...]) -> Remembered:
    """What the quantities that are asked for remember at t = 0."""
    return {name: QUANTITIES[name].begin(position) for name in asked}


# Sticks of trajectories and the slips between them: as engines record them, and as results return them.


class StickRecord(NamedTuple):
    """The stick of one interval or step, if any: times in s, position in m, and an `Ending` code, or -1 for no stick.

    `quantities`: those of `stick_quantities` that are asked for, by name.
    """

    start: FloatArray
    end: FloatArray
    position: FloatArray
    quantities: dict[str, FloatArray]
    ending: IntArray

    @property
    def columns(self) -> dict[str, FloatArray]:
        """All columns but the ending, by name."""
        further = {name: self.quantities[name] for name in QUANTITIES if name in self.quantities}
        return {"start": self.start, "end": self.end, "position": self.position, **further}


NUMBERS = ("start", "end", "position", *QUANTITIES)
"""Names of the columns of a stick, without the ending."""


def ending_of(is_stick: BoolArray, released: BoolArray, cut: BoolArray) -> IntArray:
    """The `Ending` code of what ended in a step: -1 where that is no stick.

    A stick that was not `released` was `cut` by the horizon, or else ended with a jump of the base.
    """
    code = {ending: np.int8(ending) for ending in Ending}
    how = jnp.where(released, code[Ending.RELEASED], jnp.where(cut, code[Ending.HORIZON], code[Ending.BASE_SWITCHED]))
    return jnp.where(is_stick, how, np.int8(-1))


class Totals(NamedTuple):
    """Sums over the sticks of one trajectory."""

    sticks: IntArray
    censored: IntArray  # number of sticks cut by the horizon: 0 or 1
    stick_time: FloatArray


def start_totals(dtype, shape: tuple[int, ...] = ()) -> Totals:
    """The totals of a trajectory at its beginning, all zero; of several contacts of this `shape`."""
    none = jnp.zeros(shape, jnp.int32)
    return Totals(none, none, jnp.zeros(shape, dtype))


def recorded(
    remembered: Remembered,
    totals: Totals,
    is_stick: BoolArray,
    span: StickSpan,
    ending: IntArray,
    censored: BoolArray,
    duration: FloatArray,
) -> tuple[StickRecord, Remembered, Totals]:
    """The record of a step in which a stick ended, if one did (`is_stick`, else `ending` is -1), and what its
    quantities remember and the totals after it.

    `remembered`, `totals`: before it. `censored`: by the horizon. `duration`: of the stick, s.
    """
    values, after = {}, {}
    for name, old in remembered.items():
        values[name], new = QUANTITIES[name].at_end(old, span)
        after[name] = jax.tree.map(lambda now, before: jnp.where(is_stick, now, before), new, old)
    totals = Totals(
        sticks=totals.sticks + is_stick,
        censored=totals.censored + (is_stick & censored),
        stick_time=totals.stick_time + jnp.where(is_stick, duration, 0),
    )
    return StickRecord(span.start, span.end, span.position, values, ending), after, totals


def count_slips(totals: Totals, at_start: BoolArray) -> IntArray:
    """Number of slips: one between two sticks, one before them unless `at_start`, one after them unless censored."""
    return totals.sticks + 1 - at_start.astype(jnp.int32) - totals.censored


def closed_up(records: StickRecord) -> tuple[StickRecord, IntArray]:
    """The records (records,) of one trajectory with the sticks moved to the front, in the order of their starts, and
    which records these are; differentiable, fixed size.

    The other slots hold NaN, and -1 as ending.
    """
    stuck = records.ending >= 0
    order = _orders(stuck[None], lax.stop_gradient(records.start)[None])[0]
    is_stick = jnp.arange(stuck.shape[0]) < stuck.sum()
    ordered = jax.tree.map(lambda column: jnp.where(is_stick, column[order], jnp.nan), records._replace(ending=None))
    return ordered._replace(ending=jnp.where(is_stick, records.ending[order], -1)), order


@custom_vmap
def _orders(stuck: BoolArray, starts: FloatArray) -> IntArray:
    """Of each row (rows, records) the indices of the sticks in the order of their starts, those of others after them.

    A record is made when a stick ends, so that nearly all are in order; and XLA sorts slowly on the CPU.
    """
    if native_loops_work() and stuck.size:
        ends = jnp.max(jnp.where(stuck, jnp.arange(1, stuck.shape[1] + 1, dtype=jnp.int32)[None], 0), axis=1, initial=0)
        return _inserted(stuck, starts, ends, jnp.zeros(stuck.shape, jnp.int32))
    return jnp.argsort(jnp.where(stuck, starts, jnp.inf), axis=1, stable=True).astype(jnp.int32)


@_orders.def_vmap
def _more_rows(size: int, mapped: list[bool], *given: AnyArray) -> tuple[IntArray, bool]:
    each = [one if m else jnp.broadcast_to(one, (size, *one.shape)) for one, m in zip(given, mapped, strict=True)]
    shape = each[0].shape
    return _orders(*(one.reshape(-1, shape[-1]) for one in each)).reshape(shape), True


@native_loop
def _inserted(stuck: BoolArray, starts: FloatArray, ends: IntArray, orders: IntArray) -> IntArray:
    """Insertion sort of each row, up to the end of its sticks."""

    def put(orders, row, place, number):
        return lax.dynamic_update_slice(orders, jnp.reshape(number, (1, 1)), (row, place))

    def insert(number, carry):
        row, count, orders = carry
        is_stick, start = stuck[row, number], starts[row, number]

        def is_later(at):
            place, orders = at
            return is_stick & (place > 0) & (starts[row, orders[row, jnp.maximum(place - 1, 0)]] > start)

        def moved_on(at):
            place, orders = at
            return place - 1, put(orders, row, place, orders[row, place - 1])

        place, orders = lax.while_loop(is_later, moved_on, (count, orders))
        return row, count + is_stick, put(orders, row, place, number)

    def order_row(row, orders):
        return lax.fori_loop(jnp.int32(0), ends[row], insert, (row, jnp.int32(0), orders))[2]

    return lax.fori_loop(jnp.int32(0), jnp.int32(stuck.shape[0]), order_row, orders)


def no_stick(dtype: Any, quantities: Iterable[str], shape: tuple[int, ...] = ()) -> StickRecord:
    """The record of a step in which no stick ended, with these `quantities`; of several contacts of this `shape`."""
    zero = jnp.zeros(shape, dtype)
    return StickRecord(zero, zero, zero, dict.fromkeys(quantities, zero), jnp.full(shape, -1, jnp.int8))


class Sticks(eqx.Module):
    """Sticks in order of time; `mask` marks the slots that hold one.

    Of a fixed size, as JAX needs it; `FlatSticks` holds the same without empty slots.

    Arrays have the shape (slots,) for one trajectory and (samples, slots) for an ensemble; sticks fill the first slots.
    Slots outside `mask` hold NaN (ending: -1) and enter no statistic.

    - `start`, `end`: s. `position`: that of the mass at the start of the stick, m (for a `MotorCart` its angle, rad).
    - `slip_displacement`: displacement of the mass in the slip before the stick, in the unit of the position: from the
      end of the previous stick (or the start of the simulation) to `position`; 0 where no slip comes before. Times the
      stiffness it is the change of the spring force in that slip, the force drop of stick-slip experiments.
    - `ending`: an `Ending` code: 0 RELEASED, 1 BASE_SWITCHED, 2 HORIZON (censored by the end of the simulation).
    - `contact`: of a system with several contacts, the number of each stick's contact, from 0 (-1 outside `mask`);
      None where there is one. Sticks of all contacts are then in the order of their starts.
    """

    start: Float[AnyArray, "*batch slots"]
    end: Float[AnyArray, "*batch slots"]
    position: Float[AnyArray, "*batch slots"]
    slip_displacement: Float[AnyArray, "*batch slots"]
    ending: Int[AnyArray, "*batch slots"]
    mask: Bool[AnyArray, "*batch slots"]
    contact: Int[AnyArray, "*batch slots"] | None = None

    @property
    def duration(self) -> Float[AnyArray, "*batch slots"]:
        """How long each stick lasts, s (NaN outside `mask`)."""
        return self.end - self.start

    @property
    def count(self) -> Int[AnyArray, "*batch"]:
        """Number of sticks."""
        return _number_in(self.mask)

    def __repr__(self) -> str:
        shown = type(self).__name__
        if isinstance(self.mask, np.ndarray) or hasattr(self.mask, "addressable_shards"):
            return f"{shown}({int(np.sum(np.asarray(self.mask)))} in slots of shape {self.mask.shape})"
        return f"{shown}(slots of shape {self.mask.shape})"


class Slips(eqx.Module):
    """Slips in order of time: the parts of [0, t1] outside the sticks. Slots outside `mask` hold NaN.

    - `start`, `end`: s. `censored`: whether the end, `t1`, cuts the slip.
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
        return _number_in(self.mask)

    __repr__ = Sticks.__repr__


def _number_in(mask: AnyArray) -> Any:
    """How many slots are used; counted by NumPy where JAX traces nothing, which compiles nothing."""
    if isinstance(mask, np.ndarray) or checks.is_traced(mask):
        return mask.sum(axis=-1)
    return jax.device_put(np.asarray(mask).sum(axis=-1))


def sticks_in_order(records: StickRecord) -> Sticks:
    """The `Sticks` in the records of one trajectory, arrays (records,) or (records, contacts); differentiable, fixed
    size.
    """
    if records.ending.ndim == 1:
        return sticks_of(closed_up(records)[0])
    ordered, order = closed_up(jax.tree.map(lambda column: column.reshape(-1), records))
    sticks, contacts = sticks_of(ordered), records.ending.shape[1]
    return dataclasses.replace(sticks, contact=jnp.where(sticks.mask, order % contacts, -1))


def of_contact(sticks: Sticks, contact: int) -> Sticks:
    """The sticks of one contact, of the same size."""
    mask, fill = _in_front(sticks.mask & (sticks.contact == contact))
    columns = {name: fill(getattr(sticks, name)) for name in NUMBERS}
    return Sticks(**columns, ending=fill(sticks.ending, -1), mask=mask)


def _in_front(chosen: AnyArray) -> tuple[BoolArray, Callable[..., Any]]:
    """Which slots are filled if those that are `chosen` move to the front, and a function that moves other columns so;
    it takes what empty slots hold, NaN by default.
    """
    order = jnp.argsort(~chosen, axis=-1, stable=True)
    mask = jnp.take_along_axis(chosen, order, axis=-1)

    def fill(values: AnyArray, padding: int | float = jnp.nan) -> Any:
        return jnp.where(mask, jnp.take_along_axis(values, order, axis=-1), padding)

    return mask, fill


def sticks_of(ordered: StickRecord) -> Sticks:
    """The `Sticks` of a trajectory from its records in order, which hold all quantities."""
    return Sticks(**ordered.columns, ending=ordered.ending, mask=ordered.ending >= 0)


@kept_jit
def slips_between(sticks: Sticks, t1: Real[AnyArray, "*batch"] | float) -> Slips:
    """The slips of one trajectory or of many: before the first stick, between sticks, after the last.

    `sticks` have arrays (..., slots); the result has one slot more. Slips of no length, before a stick from t = 0 and
    after one that lasts to the horizon, are left out.
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
    # Slips of no length are sorted to the end, so that slips fill the first slots.
    mask, fill = _in_front(exists & (jnp.where(exists, end, 0) > jnp.where(exists, start, 0)))
    return Slips(fill(start), fill(end), fill(is_last, False), mask)


def named_column(sticks: Any, name: str) -> Any:
    """The column `name` of `sticks`, which hold their `NUMBERS` in one array (columns, sticks)."""
    if name not in NUMBERS:
        raise AttributeError(f"{type(sticks).__name__!r} object has no attribute {name!r}", name=name, obj=sticks)
    return sticks.numbers[NUMBERS.index(name)]


_Held = TypeVar("_Held")


def with_columns(sticks: _Held, **columns: np.ndarray) -> _Held:
    """A copy of `sticks`, `FlatSticks` or a `StickStream`, with other columns of these names."""
    held: Any = sticks
    numbers = held.numbers.copy()
    for name, values in columns.items():
        numbers[NUMBERS.index(name)] = values
    return held._replace(numbers=numbers)


def within_period(positions: np.ndarray, period: float) -> np.ndarray:
    """The positions modulo `period`, in ``[0, period)``."""
    folded = np.mod(positions, positions.dtype.type(period))
    return np.where(folded < period, folded, 0)  # a tiny negative position is rounded up to the period


class FlatSticks(NamedTuple):
    """The sticks of many samples one after the other (the "contiguous ragged" arrays of the CF conventions).

    In order of sample, then time, as statistics of single samples, tests and files need them.

    - `count`: number of sticks of each sample, (samples,). `ending`: the `Ending` of each stick, (sticks,).
    - `numbers`: all other columns of `StickRecord`, (columns, sticks); each is also an attribute of its name:
      `start`, `end` (s), `position`, `slip_displacement` (m, for a `MotorCart` angles in rad), (sticks,).
    """

    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    numbers: Float[np.ndarray, "columns sticks"]
    ending: Int[np.ndarray, " sticks"]

    @classmethod
    def of(
        cls, count: np.ndarray, start: np.ndarray, end: np.ndarray, ending: np.ndarray, **others: np.ndarray
    ) -> "FlatSticks":
        """Sticks with these columns, by name; those of the `NUMBERS` that are not given are not known (NaN)."""
        known = {"start": start, "end": end, **others}
        unknown = np.full(len(start), np.nan)
        return cls(count, np.stack([known.get(name, unknown) for name in NUMBERS], dtype=start.dtype), ending)

    def __getattr__(self, name: str) -> np.ndarray:
        return named_column(self, name)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns by name, from which `of` makes the same sticks again."""
        return {"count": self.count, **dict(zip(NUMBERS, self.numbers, strict=True)), "ending": self.ending}

    @property
    def duration(self) -> Float[np.ndarray, " sticks"]:
        """How long each stick lasts, s."""
        return self.end - self.start

    @property
    def first(self) -> Int[np.ndarray, " samples"]:
        """Index of the first stick of each sample."""
        return np.cumsum(self.count) - self.count

    @property
    def sample(self) -> Int[np.ndarray, " sticks"]:
        """The sample of each stick."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @property
    def begins_at_zero(self) -> Bool[np.ndarray, " samples"]:
        """Whether each sample begins with a stick."""
        begins = self.count > 0
        begins[begins] = self.start[self.first[begins]] == 0
        return begins

    @property
    def touches(self) -> Bool[np.ndarray, " sticks"]:
        """Whether each stick begins at the very end of the one before it in its sample, without a slip."""
        same = np.diff(self.sample, prepend=-1) == 0
        return same & (self.start == np.roll(self.end, 1))

    def without_initial_rest(self) -> "FlatSticks":
        """A copy without the sticks that begin at t = 0."""
        begins = self.begins_at_zero
        if not np.any(begins):
            return self
        kept = np.ones(len(self.ending), bool)
        kept[self.first[begins]] = False
        return FlatSticks(self.count - begins, self.numbers[:, kept], self.ending[kept])

    def only(self, chosen: Bool[np.ndarray, " samples"]) -> "FlatSticks":
        """The sticks of the `chosen` samples."""
        if np.all(chosen):
            return self
        kept = np.repeat(chosen, self.count)
        return FlatSticks(self.count[chosen], self.numbers[:, kept], self.ending[kept])

    def rest_times(self) -> Float[np.ndarray, " samples"]:
        """How long each sample rests from t = 0 on, s."""
        time, begins = np.zeros(len(self.count)), self.begins_at_zero
        time[begins] = self.end[self.first[begins]]
        return time

    def head(self, samples: int) -> "FlatSticks":
        """The sticks of the first `samples` samples."""
        sticks = int(self.count[:samples].sum())
        return FlatSticks(self.count[:samples].copy(), self.numbers[:, :sticks].copy(), self.ending[:sticks].copy())

    @classmethod
    def joined(cls, parts: "list[FlatSticks]") -> "FlatSticks":
        """The sticks of all parts, one part after the other."""
        return cls(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))

    def padded(self) -> Sticks:
        """The same as `Sticks` with arrays (samples, slots), where slots is the largest count (at least 1)."""
        columns = {name: (column, np.nan) for name, column in zip(NUMBERS, self.numbers, strict=True)}
        mask, filled = in_slots(self.count, columns | {"ending": (self.ending, -1)})
        return Sticks(**filled, mask=mask)


def in_slots(
    count: Int[np.ndarray, " samples"], columns: Mapping[str, tuple[np.ndarray, float]]
) -> tuple[Bool[np.ndarray, "samples slots"], dict[str, np.ndarray]]:
    """Columns (all,) of what the samples have `count` of, in slots of each sample, and which slots are filled.

    `columns`: each with what stands in empty slots. There are as many slots as the largest count, at least 1.
    """
    mask = np.arange(max(1, int(count.max(initial=0)))) < count[:, None]
    filled = {}
    for name, (values, padding) in columns.items():
        filled[name] = np.full(mask.shape, padding, values.dtype)
        filled[name][mask] = values
    return mask, filled


# Sticks in the order in which the lanes record them: those of a sample in order of time, samples interleaved.


class StickStream(NamedTuple):
    """The sticks of many samples, those of each sample in order of time.

    Sorting millions of sticks by sample takes as long as simulating them, and most statistics do not need it.

    - `count`: number of sticks of each sample. `last`: end of its last stick, s (0 without any).
    - `numbers`, `ending`: as in `FlatSticks`; each column is also an attribute of its name.
    - `slip`: duration of the slip before each stick, s; 0 where a sample begins with a stick.
    - `owner`: the sample of each stick. `order`: number of sticks of the same sample before it.
    """

    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    last: Float[np.ndarray, " samples"]
    numbers: Float[np.ndarray, "columns sticks"]
    slip: Float[np.ndarray, " sticks"]
    ending: Int[np.ndarray, " sticks"]
    owner: Int[np.ndarray, " sticks"]
    order: Int[np.ndarray, " sticks"]

    def __getattr__(self, name: str) -> np.ndarray:
        return named_column(self, name)

    @classmethod
    def of(cls, sticks: FlatSticks) -> "StickStream":
        """The stream of `sticks`, which are in order of their samples."""
        first, has = sticks.first, sticks.count > 0
        slip = np.empty_like(sticks.start)
        slip[1:] = sticks.start[1:] - sticks.end[:-1]
        slip[first[has]] = sticks.start[first[has]]
        last = np.zeros(len(has), sticks.end.dtype)
        last[has] = sticks.end[(first + sticks.count - 1)[has]]
        order = np.arange(len(slip)) - np.repeat(first, sticks.count)
        whose = (sticks.sample.astype(np.int32), order.astype(np.int32))
        return cls(sticks.count, last, sticks.numbers, slip, sticks.ending, *whose)

    @property
    def begins_at_zero(self) -> Bool[np.ndarray, " samples"]:
        """Whether each sample begins with a stick."""
        return self.rest_times() > 0

    def rest_times(self) -> Float[np.ndarray, " samples"]:
        """How long each sample rests from t = 0 on, s."""
        times = np.zeros(len(self.count))
        self.loops().rest_times(self.start, self.end, self.owner, times)
        return times

    def endings(self, skip_rest: bool) -> Int[np.ndarray, " endings"]:
        """How many sticks have each `Ending`; `skip_rest`: without those that begin at t = 0."""
        number = np.zeros(len(Ending), np.int64)
        self.loops().count_endings(self.start, self.ending, skip_rest, number)
        return number

    loops = staticmethod(sums.compiled)  # what counts and sums them

    def folded(self, period: float) -> "StickStream":
        """The same with positions modulo `period`, in ``[0, period)``."""
        return with_columns(self, position=within_period(self.position, period))

    def slip_after(self, t1: float) -> Float[np.ndarray, " samples"]:
        """Duration of the slip after each sample's last stick, s; 0 where it ends with a stick."""
        return np.maximum(self.last.dtype.type(t1) - self.last, 0)

    def only(self, kept: Bool[np.ndarray, " samples"]) -> "StickStream":
        """The same without the sticks of the samples that are not `kept`."""
        inside = kept[self.owner]
        count, last = np.where(kept, self.count, 0), np.where(kept, self.last, 0)
        return StickStream(count, last, *(column[..., inside] for column in self[2:]))

    def of_samples(self, kept: Bool[np.ndarray, " samples"]) -> "StickStream":
        """The same of the samples that are `kept` alone, numbered anew; the others have no sticks."""
        number = (np.cumsum(kept) - 1).astype(np.int32)
        return self._replace(count=self.count[kept], last=self.last[kept], owner=number[self.owner])

    def of_track(self, track: int, tracks: int) -> "StickStream":
        """The sticks of one track of systems with several contacts, collected as if each track were a sample.

        The tracks of a sample stand one after the other.
        """
        of_it = self.owner % tracks == track
        count, last = self.count[track::tracks], self.last[track::tracks]
        only = StickStream(count, last, *(column[..., of_it] for column in self[2:]))
        return only._replace(owner=only.owner // tracks)

    def in_order(self) -> FlatSticks:
        """The sticks in order of their samples."""
        first = np.cumsum(self.count) - self.count
        numbers, ending = np.empty(self.numbers.shape, self.numbers.dtype), np.empty_like(self.ending)
        columns = (tuple(self.numbers), self.ending, tuple(numbers), ending)
        sums.compiled().put_in_order(first, self.owner, self.order, *columns)
        return FlatSticks(self.count, numbers, ending)


class DeviceSticks(NamedTuple):
    """The sticks of many samples, as in a `StickStream`, in arrays of JAX with empty slots, which start below 0.

    `rest`: how long each sample rests from t = 0 on, s. What has an entry for each sample is on the host.
    """

    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - as in the others
    last: Float[np.ndarray, " samples"]
    rest: Float[np.ndarray, " samples"]
    numbers: Float[jax.Array, "columns slots"]
    slip: Float[jax.Array, " slots"]
    ending: Int[jax.Array, " slots"]
    owner: Int[jax.Array, " slots"]
    order: Int[jax.Array, " slots"]

    def __getattr__(self, name: str) -> Any:
        return named_column(self, name)

    slip_after = StickStream.slip_after

    @property
    def begins_at_zero(self) -> Bool[np.ndarray, " samples"]:
        """Whether each sample begins with a stick."""
        return self.rest > 0

    def rest_times(self) -> Float[np.ndarray, " samples"]:
        """How long each sample rests from t = 0 on, s."""
        return self.rest.astype(np.float64)

    def endings(self, skip_rest: bool) -> Int[np.ndarray, " endings"]:
        """How many sticks have each `Ending`; `skip_rest`: without those that begin at t = 0."""
        codes = np.array([*Ending], np.int8)
        return np.asarray(device_loops.endings(self.start, self.ending, skip_rest, codes), np.int64)

    loops = staticmethod(lambda: device_loops)  # what counts and sums them

    def folded(self, period: float) -> "DeviceSticks":
        """The same with positions modulo `period`, in ``[0, period)``."""
        return self._replace(numbers=device_loops.folded(self.numbers, period, row=NUMBERS.index("position")))

    def only(self, kept: Bool[np.ndarray, " samples"]) -> "DeviceSticks":
        """The same without the sticks of the samples that are not `kept`."""
        count, last, rest = (np.where(kept, column, 0) for column in self[:3])
        return self._replace(count=count, last=last, rest=rest, numbers=self._of(kept))

    def of_samples(self, kept: Bool[np.ndarray, " samples"]) -> "DeviceSticks":
        """The same of the samples that are `kept` alone, numbered anew; the others have no sticks."""
        number = jnp.asarray(np.cumsum(kept) - 1, jnp.int32)
        return self._replace(**{n: getattr(self, n)[kept] for n in ("count", "last", "rest")}, owner=number[self.owner])

    def of_track(self, track: int, tracks: int) -> "DeviceSticks":
        """Those of one track, as of a `StickStream`."""
        of_it = self._of(np.arange(len(self.count)) % tracks == track)
        columns = self.count[track::tracks], self.last[track::tracks], self.rest[track::tracks]
        return DeviceSticks(*columns, of_it, self.slip, self.ending, self.owner // tracks, self.order)

    def _of(self, samples: Bool[np.ndarray, " samples"]) -> Float[jax.Array, "columns slots"]:
        """The numbers of the sticks of these `samples`, with empty slots in place of the others."""
        room = device_loops.rounded(len(samples))
        return device_loops.chosen(self.numbers, np.pad(samples, (0, room - len(samples))), self.owner)

    def in_order(self) -> "DeviceSticks":
        """Itself: `head` puts them in order."""
        return self

    def head(self, samples: int) -> FlatSticks:
        """The sticks of the first `samples` samples, in order, on the host."""
        count, number = self.count[:samples], int(self.count[:samples].sum())
        first = np.pad(np.cumsum(count) - count, (0, device_loops.rounded(samples) - samples)).astype(np.int32)
        columns, size = (self.numbers, self.ending, self.owner, self.order), device_loops.rounded(number)
        numbers, ending = device_loops.put_in_order(*columns, first, np.int32(samples), size=size)
        return FlatSticks(count.astype(np.int64), np.asarray(numbers)[:, :number], np.asarray(ending)[:number])


class StickCollector:
    """Collects the sticks of successive blocks of records in memory that it reuses.

    Allocating memory for every part would take longer than collecting its sticks.
    """

    def __init__(self) -> None:
        self._columns: tuple[np.ndarray, ...] = ()
        self.restart(0)

    def restart(self, samples: int) -> None:
        """Start over, with so many `samples`; overwrites what `sticks` returned before."""
        self._samples, self._number = samples, 0
        self._lanes: tuple[np.ndarray, ...] = ()
        self._of_samples: tuple[np.ndarray, ...] = ()

    def add(
        self,
        values: Float[np.ndarray, "slots columns lanes"],
        ending: Int[np.ndarray, "slots lanes"],
        sample: Int[np.ndarray, "blocks lanes"],
    ) -> None:
        """Add the sticks of further blocks of records, which follow those added before.

        Args:
            values: The numbers of the sticks.
            ending: Their `Ending` codes, negative where there is no stick.
            sample: The sample of each lane in each block of slots.
        """
        lanes, dtype = ending.shape[1], values.dtype
        assert values.shape == (len(ending), len(NUMBERS), lanes)  # compiled loops check no bounds
        if not self._lanes:
            # The sample of each lane, the number of its sticks so far, and the end of the last.
            self._lanes = (np.full(lanes, -1), np.zeros(lanes, np.int32), np.zeros(lanes, dtype))
            self._of_samples = (np.zeros(self._samples, np.int64), np.zeros(self._samples, dtype))
        self._enlarge(self._number + ending.size, dtype)
        records = (sums.read_only(array) for array in (values, ending, sample))
        into = (*self._lanes, *self._of_samples, *self._columns)
        self._number = int(sums.compiled().gather(*records, self._samples, self._number, *into))

    def _enlarge(self, slots: int, dtype: Any) -> None:
        """Make the columns twice as long as `slots` if they are shorter."""
        if self._columns and slots <= len(self._columns[1]):
            return
        kinds = (dtype, np.int8, np.int32, np.int32)
        larger = (np.empty((len(NUMBERS), 2 * slots), dtype), *(np.empty(2 * slots, kind) for kind in kinds))
        for new, old in zip(larger, self._columns, strict=False):
            new[..., : self._number] = old[..., : self._number]
        self._columns = larger

    @property
    def sticks(self) -> StickStream:
        """The sticks of all blocks since `restart`."""
        return StickStream(*self._of_samples, *(column[..., : self._number] for column in self._columns))


# The slips of many samples: what lies between their sticks.


class FlatSlips(NamedTuple):
    """The slips of many samples one after the other, in order of sample, then time; arrays (slips,).

    - `sample`: the sample of each slip. `start`, `end`: s. `censored`: whether the horizon cuts it.
    """

    sample: Int[np.ndarray, " slips"]
    start: Float[np.ndarray, " slips"]
    end: Float[np.ndarray, " slips"]
    censored: Bool[np.ndarray, " slips"]

    @property
    def duration(self) -> Float[np.ndarray, " slips"]:
        """How long each slip lasts, s."""
        return self.end - self.start

    @property
    def order(self) -> Int[np.ndarray, " slips"]:
        """The order of each slip within its sample, from 1."""
        first = np.flatnonzero(np.diff(self.sample, prepend=-1))
        return np.arange(len(self.sample)) - np.repeat(first, np.diff(first, append=len(self.sample))) + 1


def slips_after(sticks: FlatSticks, t1: float) -> tuple[Float[np.ndarray, " sticks"], Float[np.ndarray, " sticks"]]:
    """Start and duration (s) of the slip after each stick, the last one up to `t1`; NaN where there is none."""
    end, next_start = np.asarray(sticks.end, np.float64), np.append(sticks.start[1:], 0.0)
    last = (sticks.first + sticks.count - 1)[sticks.count > 0]
    next_start[last] = sticks.start.dtype.type(t1)
    start = np.where((sticks.ending == Ending.HORIZON) | (next_start <= end), np.nan, end)
    return start, next_start - start


def slips_among(sticks: FlatSticks, t1: float, finished: Bool[np.ndarray, " samples"] | None = None) -> FlatSlips:
    """The slips on ``[0, t1]`` (s) of all samples that have `finished`; None: of all samples.

    One before the first stick of a sample unless this begins at t = 0, one between two sticks unless they touch, one
    after the last unless the horizon cuts that. `sticks` holds none of samples that have not finished.
    """
    owner, has = sticks.sample, sticks.count > 0
    is_first, is_last = np.diff(owner, prepend=-1) != 0, np.diff(owner, append=-1) != 0
    horizon = sticks.start.dtype.type(t1)
    before = np.where(is_first, 0, np.roll(sticks.end, 1))
    leads = ~(is_first & (sticks.start == 0)) & ~sticks.touches
    trails = is_last & (sticks.ending != Ending.HORIZON)
    empty = np.flatnonzero(~has if finished is None else finished & ~has)
    none = np.zeros(len(empty))
    sample = np.concatenate([owner[leads], owner[trails], empty])
    start = np.concatenate([before[leads], sticks.end[trails], none]).astype(sticks.start.dtype)
    end = np.concatenate([sticks.start[leads], np.full(trails.sum(), horizon), none + horizon])
    censored = np.repeat([False, True, True], [leads.sum(), trails.sum(), len(empty)])
    order = np.lexsort((start, sample))
    return FlatSlips(sample[order], start[order], end.astype(sticks.start.dtype)[order], censored[order])


# Sticks as columns of a table and as labelled arrays, and tables in files: of one trajectory and of many alike.


def time_columns(start: np.ndarray, end: np.ndarray) -> Columns:
    """When sticks or slips begin and end, and how long they last."""
    return {"start_s": start, "end_s": end, "duration_s": end - start}


def stick_columns(
    sticks: FlatSticks, order: np.ndarray, position: Coordinate, further: Columns | None = None
) -> Columns:
    """The columns of `sticks`, one row each, with the `order` of each in its sample.

    `position`: what the position of a stick is. `further`: what comes before how they began and ended.
    """
    columns = {"order": order, **time_columns(sticks.start, sticks.end)}
    units = {"position": None, **{name: one.unit for name, one in QUANTITIES.items()}}
    for name, own in units.items():
        unit = own or position.unit
        columns[name if unit == "1" else f"{name}_{unit}"] = getattr(sticks, name)
    columns |= further or {}
    columns["is_initial_rest"] = sticks.start == 0
    columns["ending"] = np.array([ending.name for ending in Ending])[sticks.ending]
    return columns


def stick_variables(sticks: FlatSticks, order: np.ndarray, position: Coordinate) -> Entries:
    """The variables of `sticks` along ``stick``, with the `order` of each in its sample."""
    further = {
        f"stick_{name}": variable("stick", getattr(sticks, name), one.label, one.unit or position.unit)
        for name, one in QUANTITIES.items()
    }
    folded = {} if position.period is None else {"period": position.period}
    about = "number of the stick in its sample, from 1; 0: begins at t = 0 and is not numbered (count_initial_rest)"
    return {
        "stick_order": variable("stick", order, about),
        "stick_start": variable("stick", sticks.start, "time at which the stick starts", "s"),
        "stick_end": variable("stick", sticks.end, "time at which the stick ends", "s"),
        "stick_position": variable("stick", sticks.position, position.name, position.unit, **folded),
        **further,
        "stick_ending": variable("stick", sticks.ending, "why the stick ended", **flags(Ending)),
    }


def slip_variables(start: np.ndarray, end: np.ndarray, censored: np.ndarray) -> Entries:
    """The variables of slips along ``slip``."""
    meanings = {"flag_values": [0, 1], "flag_meanings": "COMPLETE HORIZON"}
    return {
        "slip_start": variable("slip", start, "time at which the slip starts", "s"),
        "slip_end": variable("slip", end, "time at which the slip ends", "s"),
        "slip_ending": variable("slip", censored.astype(np.int8), "whether the end, `t1`, cuts the slip", **meanings),
    }


_MOST_SHOWN = 16  # contacts


def shown_counts(counts: Sequence[int]) -> str:
    """How a printed result shows the numbers of sticks of the contacts."""
    if len(counts) <= _MOST_SHOWN:
        return ", ".join(f"{count:,}" for count in counts)
    return f"{min(counts):,} to {max(counts):,}, in all {sum(counts):,}"
