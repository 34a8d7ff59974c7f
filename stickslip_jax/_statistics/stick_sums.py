"""Sums and histograms of sticks by NumPy: what `compiled_stick_sums.py` does in fewer passes, where Numba is there."""

from typing import NamedTuple

import numpy as np

from .._events.stick_stream import StickStream
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums

BINS = 8192  # at most, of each quantity: fine enough to read quantiles off
BINS_BY_ORDER = 1024
BINS_OF_PAIRS = 128  # at most, along each axis

QUANTITIES = ("start", "duration", "position")
"""What is told of each stick."""
PAIRS = (("duration", "position"), ("start", "duration"))
"""Whose joint histograms are streamed; and that of the durations of the first two sticks."""


class StickSums(NamedTuple):
    """Of all sticks, by `QUANTITIES`, and by `PAIRS`; and of the durations of all slips, s."""

    sticks: PowerSums
    stick_bins: tuple[DyadicCounts, ...]
    slips: PowerSums
    slip_bins: DyadicCounts
    pair_bins: tuple[DyadicCounts, ...]


class OrderSums(NamedTuple):
    """Of the 1st, 2nd, ... stick of each sample that has it, one entry an order; and of the durations of the first and
    the second stick.
    """

    by_order: PowerSums
    order_bins: tuple[DyadicCounts, ...]
    first_two: PowerSums
    first_two_bins: DyadicCounts


def sums_of_sticks(sticks: StickStream, t1: float) -> StickSums:
    """Of the sticks of finished samples, simulated up to `t1`, s."""
    columns = _columns(sticks)
    stick_bins, pair_bins = _stick_bins(columns)
    slip = _slip_durations(sticks, t1)
    return StickSums(PowerSums.of(*columns), stick_bins, PowerSums.of(slip), DyadicCounts.of(slip, BINS), pair_bins)


def sums_of_orders(sticks: StickStream, skipped: np.ndarray, orders: int) -> OrderSums:
    """Of the first `orders` numbered sticks; `skipped`: how many of each sample are not, (samples,)."""
    columns = _columns(sticks)
    which = sticks.order - skipped[sticks.owner]
    at = [np.flatnonzero(which == order) for order in range(max(orders, 2))]
    first = np.empty(len(sticks.count))
    first[sticks.owner[at[0]]] = columns[1][at[0]]
    first_two = first[sticks.owner[at[1]]], columns[1][at[1]]
    return OrderSums(*_of_orders(columns, at[:orders]), *sums_of_first_two(*first_two))


def sums_of_first_two(first: np.ndarray, second: np.ndarray) -> tuple[PowerSums, DyadicCounts]:
    """Of the durations of the first and the second stick of each sample that has both."""
    return PowerSums.of(first, second), DyadicCounts.of_columns((first, second), BINS_OF_PAIRS)


def _slip_durations(sticks: StickStream, t1: float) -> np.ndarray:
    """How long each slip lasts, s, in any order."""
    before, after = (np.asarray(durations, np.float64) for durations in (sticks.slip, sticks.slip_after(t1)))
    if np.any(sticks.begins_at_zero):
        before = before[before > 0]
    return np.concatenate([before, after[after > 0]])


def _columns(sticks: StickStream) -> tuple[np.ndarray, ...]:
    """Start, duration and position of every stick, as `QUANTITIES`."""
    start, end = (np.asarray(column, np.float64) for column in (sticks.start, sticks.end))
    return start, end - start, np.asarray(sticks.position, np.float64)


def _stick_bins(columns: tuple[np.ndarray, ...]) -> tuple[tuple[DyadicCounts, ...], tuple[DyadicCounts, ...]]:
    """The histograms of each quantity and of the pairs."""
    if len(columns[0]) == 0:
        one, two = DyadicCounts.none(1, BINS), DyadicCounts.none(2, BINS_OF_PAIRS)
        return (one,) * len(columns), (two,) * len(PAIRS)
    return DyadicCounts.of_pairs(dict(zip(QUANTITIES, columns, strict=True)), PAIRS, BINS, BINS_OF_PAIRS)


def _of_orders(columns: tuple[np.ndarray, ...], at: list[np.ndarray]) -> tuple[PowerSums, tuple[DyadicCounts, ...]]:
    """Sums and histograms of the 1st, 2nd, ... stick of each sample; `at`: where those of each order stand."""
    orders = len(at)
    sums = PowerSums.stacked([PowerSums.of(*(column[found] for column in columns)) for found in at])
    group, every = np.repeat(np.arange(orders), [len(found) for found in at]), np.concatenate(at)
    bins = tuple(DyadicCounts.of_groups(column[every], group, orders, BINS_BY_ORDER) for column in columns)
    return sums, bins
