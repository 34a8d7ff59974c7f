"""Made-up sticks with known statistics, and brute-force errors, for the tests of the statistics."""

from collections.abc import Callable

import numpy as np

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import FlatSticks, StickStream
from stickslip_jax._statistics.ensemble_statistics import EnsembleStatistics
from stickslip_jax._statistics.quantities import Numbering, StickAccumulator
from stickslip_jax._statistics.transitions import Cells

T1 = 100.0


def sticks_from(samples: list[list[tuple[float, float, float, int]]]) -> FlatSticks:
    """Sticks from the (start, end, position, ending) of each stick of each sample."""
    rows = np.array([stick for sample in samples for stick in sample], float).reshape(-1, 4)
    count = np.array([len(sample) for sample in samples], np.int64)
    return FlatSticks.of(count, rows[:, 0], rows[:, 1], rows[:, 3].astype(np.int8), position=rows[:, 2])


def statistics_of(
    sticks: FlatSticks, t1: float = T1, orders: int = 3, parts: int = 1, rest: bool = True
) -> EnsembleStatistics:
    """The statistics of all sticks, accumulated in so many parts."""
    owner = sticks.sample
    time = np.bincount(owner, weights=sticks.duration, minlength=len(sticks.count))
    slips = np.array([_slips_of_one(sticks, number, t1) for number in range(len(sticks.count))], np.int64)
    accumulator, numbering = None, Numbering(orders, rest)
    for piece in np.array_split(np.arange(len(sticks.count)), parts):
        chosen = np.isin(np.arange(len(sticks.count)), piece)
        one = StickAccumulator.of(StickStream.of(sticks.only(chosen)), time[chosen], slips[chosen], t1, numbering)
        accumulator = one if accumulator is None else accumulator.merge(one)
    assert accumulator is not None
    totals = np.stack([time, sticks.count, slips, *numbering.rest(sticks)], axis=1).astype(float)
    return EnsembleStatistics(accumulator, sticks, totals, t1, "m", numbering)


def slips_by_hand(sticks: FlatSticks, t1: float) -> list[list[float]]:
    """Durations of the slips of each sample, one after the other."""
    found, at = [], 0
    for count in sticks.count:
        edges = [0.0]
        for stick in range(at, at + count):
            edges += [float(sticks.start[stick]), float(sticks.end[stick])]
        edges.append(t1)
        found.append([end - start for start, end in zip(edges[::2], edges[1::2], strict=True) if end > start])
        at += count
    return found


def _slips_of_one(sticks: FlatSticks, number: int, t1: float) -> int:
    first, count = sticks.first[number], sticks.count[number]
    own = slice(first, first + count)
    one = FlatSticks(sticks.count[number : number + 1], sticks.numbers[:, own], sticks.ending[own])
    return len(slips_by_hand(one, t1)[0])


def made_up_sticks(rng: np.random.Generator, samples: int, mean_count: float = 6.0, shared: float = 0.5) -> FlatSticks:
    """Random sticks: those of one sample share a factor (lognormal of so much spread), so that they are dependent."""
    made = []
    for _ in range(samples):
        factor, t, sample = np.exp(shared * rng.normal()), 0.0, []
        for _ in range(rng.poisson(mean_count)):
            start = t + rng.exponential(2.0)
            end = start + factor * rng.exponential(0.5)
            if end > T1:
                break
            sample.append((start, end, rng.normal() + 0.3 * (end - start), int(rng.integers(2))))
            t = end
        made.append(sample)
    return sticks_from(made)


def jackknife_error(sticks: FlatSticks, statistic: Callable[[FlatSticks], np.ndarray]) -> np.ndarray:
    """Standard error of a statistic by leaving out one sample after the other."""
    number = len(sticks.count)
    others = np.array([statistic(sticks.only(np.arange(number) != left_out)) for left_out in range(number)])
    return np.sqrt((number - 1) / number * ((others - others.mean(axis=0)) ** 2).sum(axis=0))


def chain(x):
    """The transition kernel of sequences x of numbers, (samples, steps)."""
    state, later = {"end_position": x[:, :-1].ravel()}, {"end_position": x[:, 1:].ravel()}
    owner = np.repeat(np.arange(len(x)), x.shape[1] - 1)
    cells = Cells.of(state, 32)
    return ss.TransitionKernel("stick", ("end_position",), state, dict(later), later, owner, len(x), 0, cells, "m")
