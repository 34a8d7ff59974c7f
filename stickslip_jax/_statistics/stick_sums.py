"""Sums and histograms of sticks by NumPy, where there is no Numba for `compiled_stick_sums.py`."""

from typing import NamedTuple

import numpy as np

from .._events.stick_stream import StickStream
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums
from .distribution import BINS
from .registry import STICK_QUANTITIES, STREAMED_PAIRS

BINS_BY_ORDER = 1024
BINS_OF_PAIRS = 128  # at most, along each axis

_NAMES = tuple(quantity.name for quantity in STICK_QUANTITIES)


class StickSums(NamedTuple):
    """Sums and histograms of all sticks, and of the durations of all slips, s.

    `sticks`, `stick_bins`: by `STICK_QUANTITIES`. `pair_bins`: by `STREAMED_PAIRS`.
    """

    sticks: PowerSums
    stick_bins: tuple[DyadicCounts, ...]
    slips: PowerSums
    slip_bins: DyadicCounts
    pair_bins: tuple[DyadicCounts, ...]


class OrderSums(NamedTuple):
    """Sums and histograms of the 1st, 2nd, ... stick of each sample that has it, with one entry for each order.

    `first_two`, `first_two_bins`: of the durations of the first and of the second stick, s.
    """

    by_order: PowerSums
    order_bins: tuple[DyadicCounts, ...]
    first_two: PowerSums
    first_two_bins: DyadicCounts


def sums_of_sticks(sticks: StickStream, skipped: np.ndarray, t1: float) -> StickSums:
    """Sums and histograms of the numbered sticks of finished samples, simulated up to `t1`, s.

    `skipped`: how many sticks of each sample come before its first numbered one, 0 or 1, (samples,).
    """
    sticks = sticks.later_than(skipped)
    columns = _columns(sticks)
    stick_bins, pair_bins = _stick_bins(columns)
    slip = _slip_durations(sticks, t1)
    return StickSums(PowerSums.of(*columns), stick_bins, PowerSums.of(slip), DyadicCounts.of(slip, BINS), pair_bins)


def sums_of_orders(sticks: StickStream, skipped: np.ndarray, orders: int) -> OrderSums:
    """Sums and histograms of the 1st to the `orders`-th numbered stick.

    `skipped`: how many sticks of each sample come before its first numbered one, (samples,).
    """
    columns = _columns(sticks)
    which = sticks.order - skipped[sticks.owner]
    at = [np.flatnonzero(which == order) for order in range(max(orders, 2))]
    first = np.empty(len(sticks.count))
    first[sticks.owner[at[0]]] = columns[1][at[0]]
    first_two = first[sticks.owner[at[1]]], columns[1][at[1]]
    return OrderSums(*_of_orders(columns, at[:orders]), *sums_of_first_two(*first_two))


def sums_of_first_two(first: np.ndarray, second: np.ndarray) -> tuple[PowerSums, DyadicCounts]:
    """Sums and joint histogram of the durations (s) of the first and the second stick of each sample that has both."""
    return PowerSums.of(first, second), DyadicCounts.of_columns((first, second), BINS_OF_PAIRS)


def _slip_durations(sticks: StickStream, t1: float) -> np.ndarray:
    """Duration of each slip, s, in any order."""
    before, after = (np.asarray(durations, np.float64) for durations in (sticks.slip, sticks.slip_after(t1)))
    if np.any(sticks.begins_at_zero):
        before = before[before > 0]
    return np.concatenate([before, after[after > 0]])


def _columns(sticks: StickStream) -> tuple[np.ndarray, ...]:
    """The `STICK_QUANTITIES` of every stick."""
    duration = np.asarray(sticks.end, np.float64) - np.asarray(sticks.start, np.float64)
    return tuple(duration if name == "duration" else np.asarray(getattr(sticks, name), np.float64) for name in _NAMES)


def _stick_bins(columns: tuple[np.ndarray, ...]) -> tuple[tuple[DyadicCounts, ...], tuple[DyadicCounts, ...]]:
    """The histograms of each quantity and of the pairs."""
    if len(columns[0]) == 0:
        one, two = DyadicCounts.none(1, BINS), DyadicCounts.none(2, BINS_OF_PAIRS)
        return (one,) * len(columns), (two,) * len(STREAMED_PAIRS)
    return DyadicCounts.of_pairs(dict(zip(_NAMES, columns, strict=True)), STREAMED_PAIRS, BINS, BINS_OF_PAIRS)


def _of_orders(columns: tuple[np.ndarray, ...], at: list[np.ndarray]) -> tuple[PowerSums, tuple[DyadicCounts, ...]]:
    """Sums and histograms of the 1st, 2nd, ... stick of each sample; `at`: the indices of the sticks of each order."""
    orders = len(at)
    sums = PowerSums.stacked([PowerSums.of(*(column[found] for column in columns)) for found in at])
    group, every = np.repeat(np.arange(orders), [len(found) for found in at]), np.concatenate(at)
    bins = tuple(DyadicCounts.of_groups(column[every], group, orders, BINS_BY_ORDER) for column in columns)
    return sums, bins
