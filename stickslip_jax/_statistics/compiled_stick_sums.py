"""Sums and histograms of sticks by compiled loops; the counts equal those of `stick_sums.py` to the last bit."""

import math
from collections.abc import Sequence

import numpy as np

from .._events.stick_stream import StickStream
from .._numerics import numba_loops
from .._numerics.dyadic import Axis, DyadicCounts
from .._numerics.power_sums import PowerSums
from . import stick_sums
from .distribution import BINS
from .registry import STREAMED_PAIRS
from .stick_sums import BINS_BY_ORDER, BINS_OF_PAIRS, OrderSums, StickSums

QUANTITIES = ("start", "duration", "position")
"""The quantities of a stick that the loops sum, in the order of their columns."""
_SLIP = len(QUANTITIES)  # the column of slips, after those of the sticks
_X, _Y = ([QUANTITIES.index(pair[axis]) for pair in STREAMED_PAIRS] for axis in (0, 1))


def sums_of_sticks(sticks: StickStream, skipped: np.ndarray, t1: float) -> StickSums:
    """Sums and histograms of the numbered sticks of finished samples, simulated up to `t1`, s.

    `skipped`: whether a sample begins with a stick that is not numbered, 0 or 1, (samples,).
    """
    d = _SLIP + 1
    skip_rest = bool(np.any(skipped))
    # A sample that begins with a stick has no slip there.
    all_slips = skip_rest or not np.any(sticks.begins_at_zero)
    columns = (sticks.start, sticks.end, sticks.position, sticks.slip, skip_rest, all_slips)
    number, low, high, total = np.zeros(d, np.int64), np.full(d, np.inf), np.full(d, -np.inf), np.zeros(d)
    numba_loops.survey(*columns, number, low, high, total)
    if number[0] == 0 or not np.all(np.isfinite(total)):
        return stick_sums.sums_of_sticks(sticks, skipped, t1)
    fine = [_axis(*ends, BINS) for ends in zip(low, high, strict=True)]
    coarse = [_axis(*ends, BINS_OF_PAIRS) for ends in zip(low[:_SLIP], high[:_SLIP], strict=True)]
    shapes = [(axis.size,) for axis in fine] + [(coarse[x].size, coarse[y].size) for x, y in zip(_X, _Y, strict=True)]
    counts, begin = _buffer(shapes)
    mean, scatter, third = total / np.maximum(number, 1), np.zeros((d, d)), np.zeros(d)
    numba_loops.count(
        *columns,
        mean,
        _scales(fine),
        begin[:d] - [axis.first for axis in fine],
        np.array([wide.exponent - axis.exponent for wide, axis in zip(coarse, fine, strict=False)] + [0]),
        np.array([axis.first for axis in coarse] + [0]),
        np.array([_X, _Y, [coarse[y].size for y in _Y], begin[d:-1]]).T,
        counts,
        scatter,
        third,
    )
    found = [part.reshape(shape) for part, shape in zip(np.split(counts, begin[1:-1]), shapes, strict=True)]
    scatter += np.tril(scatter, -1).T
    of_sticks, of_slips = (
        PowerSums(np.array(number[at][0]), mean[at], scatter[at, at], third[at], low[at], high[at])
        for at in (slice(_SLIP), slice(_SLIP, d))
    )
    slip_bins = DyadicCounts.with_counts((fine[_SLIP],), found[_SLIP], BINS) if number[_SLIP] else _NO_SLIPS
    after = sticks.slip_after(t1).astype(np.float64)
    after = after[after > 0]
    return StickSums(
        of_sticks,
        tuple(DyadicCounts.with_counts((axis,), one, BINS) for axis, one in zip(fine[:_SLIP], found, strict=False)),
        of_slips.merge(PowerSums.of(after)),
        slip_bins.merge(DyadicCounts.of(after, BINS)),
        tuple(
            DyadicCounts.with_counts((coarse[x], coarse[y]), one, BINS_OF_PAIRS)
            for x, y, one in zip(_X, _Y, found[d:], strict=True)
        ),
    )


def sums_of_orders(sticks: StickStream, skipped: np.ndarray, orders: int) -> OrderSums:
    """Sums and histograms of the 1st to the `orders`-th numbered stick.

    `skipped`: how many sticks of each sample come before its first numbered one, (samples,).
    """
    # No more orders than there are sticks, but the first two in any case.
    most = max(2, min(orders, int(sticks.count.max(initial=0))))
    columns, number = np.empty((len(QUANTITIES), most, len(sticks.count))), np.zeros(most, np.int64)
    earlier, first_two = np.empty(len(sticks.count)), np.empty((2, len(sticks.count)))
    of_sticks = (sticks.start, sticks.end, sticks.position, sticks.owner, sticks.order)
    numba_loops.numbered(*of_sticks, skipped, columns, number, earlier, first_two)
    return OrderSums(*_by_order(columns, number, orders), *stick_sums.sums_of_first_two(*first_two[:, : number[1]]))


def _by_order(columns: np.ndarray, found: np.ndarray, orders: int) -> tuple[PowerSums, tuple[DyadicCounts, ...]]:
    """Sums and histograms of each order.

    `columns` (quantities, orders, sticks) and how many sticks of each order were `found`, (orders,), as
    `numba_loops.numbered` gives them.
    """
    d, present = len(columns), found[:orders]
    if not np.any(present):
        no_bins = DyadicCounts.none(1, BINS_BY_ORDER, groups=orders)
        return PowerSums.stacked([PowerSums.none(d)] * orders), (no_bins,) * d
    number = np.zeros(orders, np.int64)
    number[: len(present)] = present
    low, high, total = (np.full((orders, d), value) for value in (np.inf, -np.inf, 0.0))
    numba_loops.survey_orders(columns, present, low, high, total)
    axes = [_axis(*ends, BINS_BY_ORDER) for ends in zip(low.min(axis=0), high.max(axis=0), strict=True)]
    shapes = [(orders, axis.size) for axis in axes]
    counts, begin = _buffer(shapes)
    mean, scatter, third = total / np.maximum(number, 1)[:, None], np.zeros((orders, d, d)), np.zeros((orders, d))
    bin_of, bins = begin[:-1] - [axis.first for axis in axes], np.array([axis.size for axis in axes])
    numba_loops.count_orders(columns, present, mean, _scales(axes), bin_of, bins, counts, scatter, third)
    scatter += np.tril(scatter, -1).swapaxes(1, 2)
    parts = zip(axes, np.split(counts, begin[1:-1]), shapes, strict=True)
    return PowerSums(number, mean, scatter, third, low, high), tuple(
        DyadicCounts.with_counts((axis,), one.reshape(shape), BINS_BY_ORDER) for axis, one, shape in parts
    )


_NO_SLIPS = DyadicCounts.none(1, BINS)
_NOTHING = np.zeros(0)


def _axis(low: float, high: float, bins: int) -> Axis:
    """The axis for numbers from `low` to `high`; any axis if there are none (then ``low > high``)."""
    ends = (float(low), float(high)) if low <= high else (0.0, 0.0)
    return Axis.within(_NOTHING, *ends, bins)


def _scales(axes: Sequence[Axis]) -> np.ndarray:
    """Bins per unit of each quantity, (axes,)."""
    return np.array([math.ldexp(1.0, -axis.exponent) for axis in axes])


def _buffer(shapes: Sequence[tuple[int, ...]]) -> tuple[np.ndarray, np.ndarray]:
    """One array of zeros for the counts of several histograms, and where each of them begins and the last one ends."""
    begin = np.cumsum([0, *(math.prod(shape) for shape in shapes)])
    return np.zeros(begin[-1], np.int64), begin
