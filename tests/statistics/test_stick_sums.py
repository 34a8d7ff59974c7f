"""Sums and histograms of sticks against plain Python, by the loops as Numba compiles them and as Python runs them."""

import importlib.util
import inspect
import math
import sys

import jax
import numpy as np
import pytest
from support.statistics import made_up_sticks, sticks_from

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import NUMBERS, QUANTITIES, StickCollector, StickStream, with_columns
from stickslip_jax._numerics import numba_loops, sums
from stickslip_jax._numerics.sums import DyadicCounts, PowerSums
from stickslip_jax._statistics import quantities
from stickslip_jax._statistics.distribution import BINS

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
WAYS = pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "uncompiled"])
TYPES = pytest.mark.parametrize("dtype", [np.float64, np.float32])
T1 = 100.0


def records(rng, dtype, *, slots=72, lanes=5, blocks=3, samples=9, share=0.4):
    """Made-up records of lanes that go from sample to sample and then idle, with NaN wherever there is no stick.

    Returns the three arrays that a collector takes, and the sticks of each sample as a plain list.
    """
    stuck = rng.random((slots, lanes)) < share
    gaps = rng.exponential(1.0, (2, slots, lanes)).astype(dtype)
    sample = rng.integers(0, 2, (blocks, lanes)).cumsum(axis=0) * lanes + np.arange(lanes)
    values, ending = np.full((slots, len(NUMBERS), lanes), np.nan, dtype), np.full((slots, lanes), -1, np.int8)
    found = [[] for _ in range(samples)]
    for lane in range(lanes):
        t, before = dtype(0), None
        for slot in range(slots):
            whose = sample[slot // (slots // blocks), lane]
            t, before = (t if whose == before else dtype(0)), whose
            if not stuck[slot, lane]:
                continue
            # The first stick of every other sample begins at once.
            start = t + (gaps[0, slot, lane] if t > 0 or whose % 2 else dtype(0))
            t = start + gaps[1, slot, lane]
            values[slot, :, lane] = start, t, *rng.normal(size=len(NUMBERS) - 2)
            ending[slot, lane] = rng.integers(3)
            if whose < samples:
                found[whose].append((*values[slot, :, lane], ending[slot, lane]))
    return (values, ending, sample), found


def collected(parts, samples, finished=None):
    collector = StickCollector()
    collector.restart(samples)
    for part in parts:
        collector.add(*part)
    return collector.sticks if finished is None else collector.sticks.only(finished)


def joined(lists):
    return [entry for one in lists for entry in one]


def without_numba(monkeypatch):
    """The same loops, run by Python, as where Numba is not installed."""
    with monkeypatch.context() as blocked:
        blocked.setitem(sys.modules, "numba", None)
        about = importlib.util.spec_from_file_location("loops_without_numba", numba_loops.__file__)
        uncompiled = importlib.util.module_from_spec(about)
        about.loader.exec_module(uncompiled)
    assert inspect.isfunction(uncompiled.gather)
    monkeypatch.setattr(sums, "compiled", lambda: uncompiled)


@pytest.mark.slow
@TYPES
@pytest.mark.parametrize("seed", range(4))
@WAYS
def test_sticks_come_in_order_of_samples_and_time(seed, dtype, compiled, monkeypatch):
    if not compiled:
        without_numba(monkeypatch)
    (values, ending, sample), found = records(np.random.default_rng(seed), dtype)
    whole, pieces = [(values, ending, sample)], []
    for block in range(3):
        own = slice(24 * block, 24 * block + 24)
        pieces.append((values[own], ending[own], sample[block : block + 1]))
    finished = np.arange(9) != 3
    for parts in (whole, pieces):
        for chosen in (None, finished):
            sticks = collected(parts, 9, chosen).in_order()
            kept = [one if chosen is None or chosen[i] else [] for i, one in enumerate(found)]
            assert sticks.count.tolist() == [len(one) for one in kept]
            assert sticks.start.dtype == dtype
            columns = (*sticks.numbers, sticks.ending)
            for column, entries in zip(columns, zip(*joined(kept), strict=True), strict=True):
                np.testing.assert_array_equal(column, np.array(entries, column.dtype))


def moments_by_hand(rows):
    """Number, mean, scatter and third moments with exactly rounded sums."""
    d = len(rows[0])
    mean = [math.fsum(row[a] for row in rows) / len(rows) for a in range(d)]
    scatter = [[math.fsum((r[a] - mean[a]) * (r[b] - mean[b]) for r in rows) for b in range(d)] for a in range(d)]
    return len(rows), mean, scatter, [math.fsum((row[a] - mean[a]) ** 3 for row in rows) for a in range(d)]


def assert_sums(sums, rows):
    assert int(sums.number) == len(rows)
    if not rows:
        return
    number, mean, scatter, third = moments_by_hand(rows)
    scale = np.abs(rows).max()
    np.testing.assert_allclose(sums.mean, mean, rtol=0, atol=1e-13 * scale)
    np.testing.assert_allclose(sums.scatter, scatter, rtol=0, atol=1e-12 * number * scale**2)
    np.testing.assert_allclose(sums.third, third, rtol=0, atol=1e-11 * number * scale**3)
    np.testing.assert_array_equal(sums.smallest, np.min(rows, axis=0))
    np.testing.assert_array_equal(sums.largest, np.max(rows, axis=0))


def assert_bins(bins, rows, group=None):
    """Every number, or tuple of numbers, counted where it belongs, one after the other."""
    expected = np.zeros_like(bins.counts)
    for at, row in enumerate(rows):
        place = [math.floor(math.ldexp(x, -e)) - first for x, e, first in zip(row, bins.exponent, bins.first,
                                                                             strict=True)]  # fmt: skip
        expected[(*([] if group is None else [group[at]]), *place)] += 1
    np.testing.assert_array_equal(bins.counts, expected)
    if len(rows):
        assert (bins.low, bins.high) == (tuple(np.min(rows, axis=0)), tuple(np.max(rows, axis=0)))
        assert all(size <= bins.most for size in bins.counts.shape[-len(rows[0]) :])


def slips_by_hand(samples, dtype, any_at_zero):
    """Durations of the slips, in the arithmetic of the sticks."""
    before, after = [], []
    for sticks in samples:
        last = dtype(0)
        for start, end, *_ in sticks:
            before.append(float(dtype(start) - last))
            last = dtype(end)
        after.append(float(max(dtype(T1) - last, dtype(0))))
    return [slip for slip in before if slip > 0 or not any_at_zero] + [slip for slip in after if slip > 0]


@pytest.mark.slow
@WAYS
@TYPES
@pytest.mark.parametrize("rest", [False, True])
@pytest.mark.parametrize("orders", [1, 3, 40])
def test_sums_and_histograms_are_those_of_plain_python(compiled, dtype, rest, orders, monkeypatch):
    if not compiled:
        without_numba(monkeypatch)
    (values, ending, sample), found = records(np.random.default_rng(orders), dtype)
    stream = collected([(values, ending, sample)], 9)
    rows = [[(float(s), float(e) - float(s), float(p)) for s, e, p, *_ in one] for one in found]
    skipped = np.array([bool(one) and one[0][0] == 0 and not rest for one in found], int)
    assert np.any(skipped) != rest
    numbered = [one[skip:] for one, skip in zip(rows, skipped, strict=True)]
    every = joined(numbered)
    sums = quantities.sums_of_sticks(stream, skipped, T1)
    assert_sums(sums["sticks"], every)
    for a, bins in enumerate(sums["stick_bins"]):
        assert_bins(bins, [(row[a],) for row in every])
    for bins, (x, y) in zip(sums["pair_bins"], ((1, 2), (0, 1)), strict=True):
        assert_bins(bins, [(row[x], row[y]) for row in every])
    slips = slips_by_hand(found, dtype, any(one and one[0][0] == 0 for one in found))
    assert_sums(sums["slips"], [(slip,) for slip in slips])
    assert_bins(sums["slip_bins"], [(slip,) for slip in slips])

    sums = quantities.sums_of_orders(stream, skipped, orders)
    by_order = [[one[order] for one in numbered if len(one) > order] for order in range(orders)]
    for order, mine in enumerate(by_order):
        assert_sums(sums["by_order"].one(order), mine)
    group = [order for order, mine in enumerate(by_order) for _ in mine]
    for a, bins in enumerate(sums["order_bins"]):
        assert_bins(bins, [(row[a],) for row in joined(by_order)], group)
    first_two = [(one[0][1], one[1][1]) for one in numbered if len(one) > 1]
    assert_sums(sums["first_two"], first_two)
    assert_bins(sums["first_two_bins"], first_two)


def assert_same(one, other):
    """To the last bit but for sums, whose round-off depends on the order."""
    for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if np.asarray(mine).dtype.kind == "f":
            np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9)
        else:
            np.testing.assert_array_equal(mine, theirs)


@pytest.mark.slow
@TYPES
@pytest.mark.parametrize("samples", [0, 1, 4000])
def test_many_sticks_and_none(samples, dtype):
    """Tens of thousands of sticks: many blocks of the compiled loops, the last not full; against sums by NumPy."""
    sticks = made_up_sticks(np.random.default_rng(samples), samples)
    sticks = sticks._replace(numbers=sticks.numbers.astype(dtype))
    nothing = sticks_from([[]] * samples)
    for one in (sticks, nothing):
        stream = StickStream.of(one)
        for skipped in (np.zeros(samples, int), stream.begins_at_zero.astype(int)):
            numbered = one.without_initial_rest() if np.any(skipped) else one
            duration = numbered.end.astype(float) - numbered.start
            columns = [np.asarray(values, float) for values in (numbered.start, duration, numbered.position)]
            sums = quantities.sums_of_sticks(stream, skipped, T1)
            assert_same(sums["sticks"], PowerSums.of(*columns))
            assert_same(sums["stick_bins"], tuple(DyadicCounts.of(values, BINS) for values in columns))
            pairs = ((columns[1], columns[2]), (columns[0], columns[1]))
            expected = tuple(DyadicCounts.of_columns(pair, quantities.BINS_OF_PAIRS) for pair in pairs)
            assert_same(sums["pair_bins"], expected)
            slips = np.concatenate([np.asarray(by, float) for by in (stream.slip, stream.slip_after(T1))])
            slips = slips[slips > 0]
            assert_same(sums["slips"], PowerSums.of(slips))
            assert_same(sums["slip_bins"], DyadicCounts.of(slips, BINS))


def test_numbers_that_are_nan_are_refused():
    """They would have no bin, and the loops write where they are told."""
    sticks = made_up_sticks(np.random.default_rng(0), 3)
    stream = StickStream.of(with_columns(sticks, position=np.full_like(sticks.position, np.nan)))
    with pytest.raises(ValueError, match="must have finite starts, ends and positions"):
        quantities.sums_of_sticks(stream, np.zeros(3, int), T1)


@pytest.mark.parametrize("rest", [False, True])
def test_a_further_quantity_needs_no_loop_of_its_own(rest, monkeypatch):
    """With one more column of sticks summed, the others are as before."""
    (values, ending, sample), found = records(np.random.default_rng(1), np.float64)
    stream = collected([(values, ending, sample)], 9)
    skipped = np.array([bool(one) and one[0][0] == 0 and not rest for one in found], int)
    before = quantities.sums_of_sticks(stream, skipped, T1), quantities.sums_of_orders(stream, skipped, 3)
    at = NUMBERS.index(next(iter(QUANTITIES)))
    monkeypatch.setattr(quantities, "_OTHERS", [at])
    monkeypatch.setattr(quantities, "_SLIP", 4)
    sums, orders = quantities.sums_of_sticks(stream, skipped, T1), quantities.sums_of_orders(stream, skipped, 3)
    assert_same(sums["stick_bins"][:3], before[0]["stick_bins"])
    for name in ("slips", "slip_bins", "pair_bins"):
        assert_same(sums[name], before[0][name])
    assert_same(orders["order_bins"][:3], before[1]["order_bins"])
    numbered = [[row[at] for row in one[skip:]] for one, skip in zip(found, skipped, strict=True)]
    assert_bins(sums["stick_bins"][3], [(value,) for value in joined(numbered)])
    assert sums["sticks"].mean[3] == pytest.approx(np.mean(joined(numbered)), rel=1e-13)
    assert orders["by_order"].mean[1, 3] == pytest.approx(
        np.mean([one[1] for one in numbered if len(one) > 1]), rel=1e-13
    )


@pytest.mark.slow_but_for("statistics-2")
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("keep", ["statistics", "sticks"])
def test_ensembles_without_numba_are_the_same(keep, threads, monkeypatch):
    run = {"t1": 30.0, "samples": 900, "key": jax.random.key(3), "y0": (0.0, 1.0), "keep": keep}
    compiled = ss.simulate_ensemble(SYSTEM, POISSON, threads=threads, chunk=300, **run)
    again = ss.simulate_ensemble(SYSTEM, POISSON, threads=3 - threads, chunk=300, **run)
    for mine, theirs in zip(jax.tree.leaves(compiled.accumulator), jax.tree.leaves(again.accumulator), strict=True):
        np.testing.assert_array_equal(mine, theirs)  # whatever the threads
    without_numba(monkeypatch)
    plain = ss.simulate_ensemble(SYSTEM, POISSON, threads=threads, chunk=300, **run)
    assert_same(compiled.accumulator, plain.accumulator)
    for mine, theirs in zip(compiled.retained.sticks, plain.retained.sticks, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("keep", ["statistics", "sticks"])
def test_an_ensemble_without_sticks(keep):
    run = {"t1": 0.5, "samples": 300, "y0": (30.0, 0.0), "keep": keep}
    many = ss.simulate_ensemble(SYSTEM, ss.Constant(1.0), **run)
    assert many.statistics.duration.number == 0
    assert many.accumulator.slips.number == 300
    assert many.accumulator.endings.tolist() == [0, 0, 0]


def test_collecting_begins_anew():
    parts, found = records(np.random.default_rng(5), np.float64)
    collector = StickCollector()
    for samples in (9, 4):
        collector.restart(samples)
        collector.add(*parts)
        assert collector.sticks.count.tolist() == [len(one) for one in found[:samples]]
