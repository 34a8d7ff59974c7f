"""What the loops of `numba_loops` do, by JAX on the device that simulates: sticks are collected and counted there.

Statistics are found in double precision whatever the program computes in (`jax.enable_x64`), as by Numba: bins are then
the same to the last count, and sums agree to round-off. Numbers of sticks are added as whole numbers, so that no count
depends on the order in which a device does it.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiler.programs import kept_jit

# Sticks among records, moved together.
#
# Arrays have lengths of few sizes (`rounded`), so that programs are shared. An empty slot has a negative start.


NOWHERE = np.int32(2**31 - 1)  # a place outside of every array: nothing is put there
_FEWEST = 1024


def rounded(number: int) -> int:
    """A length for so many entries: at most a quarter more, of four lengths between powers of two."""
    step = 1 << max(number.bit_length() - 3, _FEWEST.bit_length() - 1)
    return max(-(-number // step), 1) * step


class Seen(NamedTuple):
    """What is known so far: of each column of records the sample it is in, the number of its sticks and the end of the
    last; and of each sample the number of its sticks, the end of the last, and that of one that begins at t = 0 (0:
    none).
    """

    whose: Any
    so_far: Any
    end: Any
    count: Any
    last: Any
    rest: Any


def nothing_seen(columns: int, samples: int, dtype: Any) -> Seen:
    """Before the first block, of so many samples of all tracks."""
    none, of_all = jnp.full(columns, -1, jnp.int32), jnp.zeros(samples, dtype)
    return Seen(none, none + 1, jnp.zeros(columns, dtype), of_all.astype(jnp.int32), of_all, of_all)


@kept_jit
def look(values: Any, ending: Any, sample: Any, samples: Any, goes_on: Any, seen: Seen) -> Any:
    """Find the sticks among records: of each slot (slots, columns) the order of its stick in its sample, -1 where there
    is none, and the slip before it, s; how many sticks there are, and whether samples `goes_on`, as two whole numbers;
    and what is `Seen` then.

    `values` (slots, numbers, columns), `ending` (slots, columns), `sample` (blocks, columns), `goes_on`: as `record`
    returns them. `samples`: how many there are, of all tracks.
    """
    (slots, columns), blocks = ending.shape, len(sample)
    each = jnp.repeat(sample, slots // blocks, axis=0)
    is_stick = (ending >= 0) & (each < samples)
    found = jnp.cumsum(is_stick, axis=0, dtype=jnp.int32)
    # Where a column begins a sample, its sticks are counted anew from what was found before that block. This grows from
    # block to block, so that the largest so far is the latest.
    before = jnp.concatenate([jnp.zeros((1, columns), jnp.int32), found[slots // blocks - 1 : -1 : slots // blocks]])
    begins = sample != jnp.concatenate([seen.whose[None], sample[:-1]])
    base = lax.cummax(jnp.where(begins, before, -seen.so_far[None]), axis=0)
    order = jnp.where(is_stick, found - 1 - jnp.repeat(base, slots // blocks, axis=0), -1)
    # The slot of the latest stick, moved on by one: that of the stick before.
    latest = lax.cummax(jnp.where(is_stick, jnp.arange(slots, dtype=jnp.int32)[:, None], -1), axis=0)
    earlier = jnp.concatenate([jnp.full((1, columns), -1, jnp.int32), latest[:-1]])
    start, end = values[:, 0], values[:, 1]

    def end_at(slot):
        return jnp.where(slot < 0, seen.end[None], jnp.take_along_axis(end, jnp.maximum(slot, 0), axis=0))

    slip = jnp.where(order > 0, start - end_at(earlier), start)
    so_far = found[slots // blocks - 1 :: slots // blocks] - base
    place = jnp.where(is_stick, each, NOWHERE)
    count = seen.count.at[jnp.where(sample < samples, sample, NOWHERE)].max(so_far, mode="drop")
    last = seen.last.at[place].max(end, mode="drop")
    rest = seen.rest.at[jnp.where(is_stick & (start == 0), place, NOWHERE)].set(end, mode="drop")
    now = Seen(sample[-1], so_far[-1], end_at(latest[-1:])[0], count, last, rest)
    return order, slip, jnp.stack([found[-1].sum(dtype=jnp.int32), goes_on.astype(jnp.int32)]), now


@kept_jit(static_argnames="size")
def gather(values: Any, ending: Any, order: Any, slip: Any, sample: Any, *, size: int) -> Any:
    """The sticks that `look` found, in columns of `size`: numbers, slips before, endings, owners and orders."""
    slots, columns = order.shape
    is_stick = (order >= 0).reshape(-1)
    place = jnp.where(is_stick, jnp.cumsum(is_stick, dtype=jnp.int32) - 1, NOWHERE)
    at = jnp.full(size, -1, jnp.int32).at[place].set(jnp.arange(len(place), dtype=jnp.int32), mode="drop")
    slot, column = at // np.int32(columns), at % np.int32(columns)
    numbers = jnp.where(at[None] < 0, -1, values[slot, :, column].T)
    block = slot // np.int32(slots // len(sample))
    return numbers, *(part[slot, column] for part in (slip, ending)), sample[block, column], order[slot, column]


@kept_jit(static_argnames="size")
def joined(parts: Any, *, size: int) -> Any:
    """Columns one part after the other, with empty slots up to `size`."""

    def join(*columns):
        whole = jnp.concatenate(columns, axis=-1)
        return jnp.pad(whole, [(0, 0)] * (whole.ndim - 1) + [(0, size - whole.shape[-1])], constant_values=-1)

    return jax.tree.map(join, *parts)


@kept_jit(static_argnames="size")
def put_in_order(numbers: Any, ending: Any, owner: Any, order: Any, first: Any, samples: Any, *, size: int) -> Any:
    """The numbers and endings of the sticks of the first `samples` samples, in order, in `size` slots.

    `first`: where those of each sample begin.
    """
    there = (numbers[0] >= 0) & (owner < samples)
    place = jnp.where(there, first[jnp.where(there, owner, 0)] + order, NOWHERE)
    at = jnp.zeros(size, jnp.int32).at[place].set(jnp.arange(len(place), dtype=jnp.int32), mode="drop")
    return numbers[:, at], ending[at]


@kept_jit
def chosen(numbers: Any, of_samples: Any, owner: Any) -> Any:
    """The `numbers` of sticks, with empty slots in place of those whose `owner` is not `of_samples`, (samples,)."""
    is_left = of_samples[jnp.clip(owner, 0, len(of_samples) - 1)]
    return numbers.at[0].set(jnp.where(is_left, numbers[0], -1))


@kept_jit(static_argnames="row")
def folded(numbers: Any, period: Any, *, row: int) -> Any:
    """The `numbers` of sticks, those in a `row` modulo a `period`, in ``[0, period)``."""
    inside = jnp.mod(numbers[row], jnp.asarray(period, numbers.dtype))
    return numbers.at[row].set(jnp.where(inside < period, inside, 0))


@kept_jit
def endings(start: Any, ending: Any, skip_rest: Any, codes: Any) -> Any:
    """How many sticks have each of the `codes`; `skip_rest`: without those that begin at 0."""
    counts = (start > 0) | ((start == 0) & ~skip_rest)
    return jnp.sum((ending[None] == codes[:, None]) & counts[None], axis=1, dtype=jnp.int32)


# Sums and histograms, by functions with the names and arguments of those in `numba_loops`: they write into the arrays
# of NumPy that come last.


def _rows(start: Any, end: Any, position: Any, slip: Any, others: Any, skip_rest: Any, all_slips: Any) -> Any:
    """Each quantity as a row (sticks,), and which of them count."""
    start, end, position, slip = (column.astype(float) for column in (start, end, position, slip))
    counts = (start > 0) | ((start == 0) & ~skip_rest)
    rows = [start, end - start, position, *others.astype(float), slip]
    return rows, [*[counts] * (len(rows) - 1), counts & (all_slips | (slip > 0))]


def _looked(rows: Any, counts: Any) -> Any:
    """Number, extremes and sum of each row, along its last axis."""
    each = list(zip(rows, counts, strict=True))

    def found(reduced, **options):
        return jnp.stack([reduced(row, axis=-1, where=counted, **options) for row, counted in each], axis=-1)

    number = jnp.stack([jnp.sum(counted, axis=-1) for _, counted in each], axis=-1)
    return [number, found(jnp.min, initial=jnp.inf), found(jnp.max, initial=-jnp.inf), found(jnp.sum)]


def _summed(rows: Any, counts: Any, mean: Any, paired: int) -> Any:
    """Sums of products of the deviations of the first `paired` rows, lower half, and of squares of all; and of cubes.

    `mean`: (..., rows).
    """
    each = enumerate(zip(rows, counts, strict=True))
    steps = [jnp.where(counted, row - mean[..., a, None], 0) for a, (row, counted) in each]

    def product(a, b):
        is_asked = a == b or b < a < paired
        return jnp.sum(steps[a] * steps[b], axis=-1) if is_asked else jnp.zeros(steps[a].shape[:-1])

    every = range(len(steps))
    scatter = jnp.stack([jnp.stack([product(a, b) for b in every], axis=-1) for a in every], axis=-2)
    return scatter, jnp.stack([jnp.sum(step * step * step, axis=-1) for step in steps], axis=-1)


def _in_bins(places: Any, size: int) -> Any:
    """How many of the `places` are each of the first `size`."""
    counts = jnp.zeros(size, jnp.int32)
    for place in places:
        counts = counts.at[place].add(1, mode="drop")
    return counts


@kept_jit
def _survey(*columns: Any) -> Any:
    return _looked(*_rows(*columns))


@kept_jit(static_argnames="size")
def _count(columns: Any, of_bins: Any, *, size: int) -> Any:
    mean, scale, bin_of, shift, pair_bin_of, pairs = of_bins
    rows, counts = _rows(*columns)
    places = [jnp.floor(row * scale[a]).astype(int) for a, row in enumerate(rows)]

    def where(counted, place):
        return jnp.where(counted, place, NOWHERE)

    flat = [where(counted, place + bin_of[a]) for a, (counted, place) in enumerate(zip(counts, places, strict=True))]
    wide = jnp.stack([(place >> shift[a]) - pair_bin_of[a] for a, place in enumerate(places)])
    for x, y, bins, offset in pairs:
        flat.append(where(counts[0], offset + wide[x] * bins + wide[y]))
    return _in_bins(flat, size), *_summed(rows, counts, mean, len(rows) - 1)


@kept_jit(static_argnames=("most", "samples"))
def _numbered(of_sticks: Any, skipped: Any, *, most: int, samples: int) -> Any:
    start, end, position, others, owner, order = of_sticks
    rows, _ = _rows(start, end, position, start, others, False, False)
    which = order - jnp.where(start < 0, 0, skipped[jnp.where(start < 0, 0, owner)])
    there = (start >= 0) & (which >= 0) & (which < most)
    at = jnp.where(there, which, NOWHERE), jnp.where(there, owner, NOWHERE)
    columns = jnp.stack([jnp.full((most, samples), jnp.nan).at[at].set(row, mode="drop") for row in rows[:-1]])
    return columns, jnp.sum(~jnp.isnan(columns[0]), axis=1)


@kept_jit
def _survey_orders(columns: Any) -> Any:
    return _looked(columns, ~jnp.isnan(columns))[1:]


@kept_jit(static_argnames="size")
def _count_orders(columns: Any, mean: Any, scale: Any, bin_of: Any, bins: Any, *, size: int) -> Any:
    there, which = ~jnp.isnan(columns), jnp.arange(columns.shape[1])
    place = jnp.floor(columns * scale[:, None, None]).astype(int) + bin_of[:, None, None]
    place = jnp.where(there, place + which[None, :, None] * bins[:, None, None], NOWHERE)
    return _in_bins([place.reshape(-1)], size), *_summed(columns, there, mean, len(columns))


def _into(found: Any, into: Any) -> None:
    """Copy what was `found` on the device `into` arrays of NumPy, which may be shorter."""
    for new, array in zip(found, into, strict=True):
        array[...] = np.asarray(new)[tuple(map(slice, array.shape))]


def survey(*columns_and_results: Any) -> None:
    """As `numba_loops.survey`."""
    with jax.enable_x64(True):
        _into(_survey(*columns_and_results[:7]), columns_and_results[7:])


def count(*columns: Any) -> None:
    """As `numba_loops.count`."""
    *of_bins, counts, scatter, third = columns[7:]
    with jax.enable_x64(True):
        _into(_count(columns[:7], of_bins, size=rounded(len(counts))), (counts, scatter, third))


def by_order(of_sticks: Any, skipped: Any, most: int) -> Any:
    """As `numba_loops.by_order`; the columns stay on the device, NaN where a sample has no such stick."""
    samples = rounded(len(skipped))
    skipped = np.pad(np.asarray(skipped, np.int32), (0, samples - len(skipped)))
    with jax.enable_x64(True):
        columns, found = _numbered(of_sticks, skipped, most=most, samples=samples)
        pair = np.asarray(columns[1, :2])
    return columns, np.asarray(found), pair[:, ~np.isnan(pair[1])]


def survey_orders(columns: Any, present: Any, *into: Any) -> None:
    """As `numba_loops.survey_orders`."""
    with jax.enable_x64(True):
        _into(_survey_orders(columns[:, : len(present)]), [array[: len(present)] for array in into])


def count_orders(columns: Any, present: Any, mean: Any, *rest: Any) -> None:
    """As `numba_loops.count_orders`."""
    *of_bins, counts, scatter, third = rest
    orders = len(present)
    with jax.enable_x64(True):
        found = _count_orders(columns[:, :orders], mean[:orders], *of_bins, size=rounded(len(counts)))
    _into(found, (counts, scatter[:orders], third[:orders]))
