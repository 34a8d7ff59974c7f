"""Streaming: parts merge to what the whole gives, and nothing is read that was not recorded."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.statistics import T1, made_up_sticks, statistics_of

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import NUMBERS as COLUMNS
from stickslip_jax._dynamics.sticks import StickCollector
from stickslip_jax._ensemble import data as ensemble_data
from stickslip_jax._numerics.sums import DyadicCounts, PowerSums

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
RUN = {"t1": 40.0, "y0": (0.0, 1.0), "key": jax.random.key(2026), "orders": 4}

NUMBERS = st.floats(-1e6, 1e6).map(lambda value: round(value, 3)) | st.floats(-1.0, 1.0, allow_subnormal=False)
PARTS = st.lists(st.lists(NUMBERS, max_size=8), min_size=1, max_size=5)


def joined(parts):
    return [entry for part in parts for entry in part]


def merged(parts, empty):
    for part in parts:
        empty = empty.merge(part)
    return empty


@pytest.mark.slow
@given(parts=PARTS, most=st.integers(2, 40))
def test_histograms_of_parts_merge_to_that_of_the_whole(parts, most):
    whole = DyadicCounts.of(np.array(joined(parts), float), most)
    found = merged([DyadicCounts.of(np.array(part, float), most) for part in parts], DyadicCounts.none(1, most))
    assert found[:4] == whole[:4]
    np.testing.assert_array_equal(found.counts, whole.counts)
    assert len(whole.counts) <= most
    if len(whole.counts):
        edges = whole.edges()
        inside = [sum(low <= value < high for part in parts for value in part)
                  for low, high in itertools.pairwise(edges)]  # fmt: skip
        assert inside == list(whole.counts)


@pytest.mark.slow
@given(parts=st.lists(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=6), min_size=1, max_size=4))
def test_joint_histograms_of_parts_merge_to_that_of_the_whole(parts):
    def counts(pairs):
        columns = np.array(pairs, float).reshape(-1, 2).T
        return DyadicCounts.of_columns((columns[0], columns[1]), 6)

    whole, found = counts(joined(parts)), merged(map(counts, parts), DyadicCounts.none(2, 6))
    assert found[:4] == whole[:4]
    np.testing.assert_array_equal(found.counts, whole.counts)


def test_bins_are_as_narrow_as_their_number_allows():
    rng = np.random.default_rng(0)
    for scale in (1e-9, 1.0, 3e5):
        bins = DyadicCounts.of(scale * rng.random(1000), 64)
        assert 32 <= len(bins.counts) <= 64
    assert DyadicCounts.of(np.array([3, 5, 5]), 64, finest=0).counts.tolist() == [1, 0, 2]
    assert DyadicCounts.of(np.full(5, 0.1), 64).counts.tolist() == [5]
    assert DyadicCounts.of(np.zeros(5), 64).counts.tolist() == [5]


@pytest.mark.slow
@given(parts=st.lists(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=6), min_size=1, max_size=4))
def test_sums_of_parts_merge_to_those_of_the_whole(parts):
    def sums(pairs):
        return PowerSums.of(*np.array(pairs, float).reshape(-1, 2).T)

    whole, found = sums(joined(parts)), merged(map(sums, parts), PowerSums.none(2))
    number = len(joined(parts))
    assert found.number == whole.number == number
    if number == 0:
        return
    values = np.array(joined(parts), float)
    scale = np.abs(values).max() + 1e-300  # sums of so many numbers of this size: their round-off
    centered = values - values.mean(axis=0)
    for one in (whole, found):
        np.testing.assert_allclose(one.mean, values.mean(axis=0), rtol=0, atol=1e-13 * scale)
        np.testing.assert_allclose(one.scatter, centered.T @ centered, rtol=0, atol=1e-12 * number * scale**2)
        np.testing.assert_allclose(one.third, (centered**3).sum(axis=0), rtol=0, atol=1e-11 * number * scale**3)
        np.testing.assert_array_equal(one.smallest, values.min(axis=0))
        np.testing.assert_array_equal(one.largest, values.max(axis=0))


def assert_same_accumulator(one, other):
    for name, mine, theirs in zip(one._fields, one, other, strict=True):
        for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
            # Sums of tens of thousands of numbers of order 100: third moments of 1e10, their round-off times the count.
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.fixture(scope="module")
def kept():
    return ss.simulate_ensemble(SYSTEM, POISSON, samples=300, keep="sticks", chunk=64, **RUN)


@pytest.mark.parametrize("changed", [{"chunk": 64}, {"chunk": 37, "threads": 1}])
def test_streaming_gives_what_keeping_gives(kept, changed):
    streamed = ss.simulate_ensemble(SYSTEM, POISSON, samples=300, keep="statistics", **changed, **RUN)
    assert streamed.flat_sticks is None
    assert_same_accumulator(streamed.accumulator, kept.accumulator)
    for mine, theirs in zip(jax.tree.leaves(streamed.retained), jax.tree.leaves(kept.retained), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert "nan" not in repr(streamed.summary())
    assert repr(streamed.summary()) == repr(kept.summary())


def test_the_accumulator_is_that_of_the_kept_sticks(kept):
    statistics = statistics_of(kept.flat_sticks, t1=40.0, orders=4, rest=False)
    assert_same_accumulator(kept.accumulator, statistics.accumulator)
    assert kept.statistics.duration.mean.value == pytest.approx(ss.mean_stick_duration(kept).value, rel=1e-12)
    assert kept.statistics.duration.mean.standard_error == pytest.approx(
        ss.mean_stick_duration(kept).standard_error, rel=1e-9
    )
    assert kept.statistics.slip_duration.mean.value == pytest.approx(ss.mean_slip_duration(kept).value, rel=1e-12)


@pytest.mark.parametrize("rest", [False, True])
def test_sticks_from_the_start_are_numbered_on_request(rest):
    many = ss.simulate_ensemble(SYSTEM, POISSON, samples=100, keep="sticks", chunk=64, count_initial_rest=rest, **RUN)
    first, order = ss.first_stick(many, count_initial_rest=rest), many.statistics.order(1)
    assert (first.start[first.mask] == 0).any() == rest
    for name in ("start", "duration", "position"):
        assert getattr(order, name).mean.value == pytest.approx(getattr(first, name)[first.mask].mean(), rel=1e-12)
        assert getattr(order, name).number == first.count
    assert order.duration.mean.standard_error == pytest.approx(
        first.duration[first.mask].std(ddof=1) / np.sqrt(first.count), rel=1e-6
    )
    second = many.numbered_sticks()
    pair = [second.duration[second.first[second.count > 1] + later] for later in (0, 1)]
    joint = many.statistics.joint(("duration", 1), ("duration", 2))
    assert joint.number == len(pair[0])
    assert joint.correlation.value == pytest.approx(np.corrcoef(*pair)[0, 1], rel=1e-9)
    assert ("Sticks that begin at t = 0 count in" in repr(many.summary())) == (not rest)


def test_only_the_first_samples_are_retained_and_errors_are_scaled(kept, monkeypatch):
    monkeypatch.setattr(ensemble_data, "RETAINED", 1500)
    streamed = ss.simulate_ensemble(SYSTEM, POISSON, samples=300, keep="statistics", chunk=64, **RUN)
    sticks = streamed.finished_sticks()
    assert len(sticks.start) + len(sticks.count) <= 1500 < len(sticks.start) + len(sticks.count) + 40
    np.testing.assert_array_equal(sticks.start, kept.flat_sticks.start[: len(sticks.start)])
    assert_same_accumulator(streamed.accumulator, kept.accumulator)
    exact, scaled = kept.statistics.duration.mean, streamed.statistics.duration.mean
    assert scaled.value == pytest.approx(exact.value)
    # Measured on some 110 of 300 samples: a standard deviation from so many is uncertain by 1 / sqrt(220) = 7 %.
    assert scaled.standard_error == pytest.approx(exact.standard_error, rel=0.3)
    assert streamed.statistics.joint("start", "position").number == len(streamed.numbered_sticks().start)
    assert streamed.statistics.joint("duration", "position").number == len(kept.numbered_sticks().start)
    assert "errors were measured on the first" in repr(streamed.summary())


def test_some_samples_are_retained_however_many_sticks_they_have(monkeypatch):
    monkeypatch.setattr(ensemble_data, "RETAINED", 10)
    streamed = ss.simulate_ensemble(SYSTEM, POISSON, samples=300, keep="statistics", chunk=37, **RUN)
    assert len(streamed.retained.totals) == len(streamed.finished_sticks().count) == ensemble_data.FEWEST
    assert streamed.statistics.duration.mean.standard_error > 0


def test_what_is_not_recorded_is_never_read():
    """Records of three lanes with NaN wherever there is no stick, and a sample that did not finish."""
    rng = np.random.default_rng(8)
    slots, lanes, blocks = 48, 3, 2
    stuck = rng.random((slots, lanes)) < 0.3
    start = np.sort(rng.random((slots, lanes)), axis=0) * 50
    values = np.stack([start, start + 0.1, *rng.normal(size=(len(COLUMNS) - 2, slots, lanes))], axis=1)
    values[~np.broadcast_to(stuck[:, None, :], values.shape)] = np.nan
    sample = np.array([[0, 1, 2], [3, 1, 2]])  # lane 0 has gone on to sample 3; sample 2 will not finish
    values[:, :, 2] = np.nan
    ending = np.where(stuck, 1, -1).astype(np.int8)
    finished = np.array([True, True, False, True])
    halves, whole = StickCollector(), StickCollector()
    whole.restart(3)
    whole.add(values, ending, np.array([[0, 1, 2], [0, 1, 2]]))  # of another job, which it must forget
    halves.restart(4)
    whole.restart(4)
    whole.add(values, ending, sample)
    for at in (0, 24):  # in two calls of a block each, as records come in
        halves.add(values[at : at + 24], ending[at : at + 24], sample[at // 24 : at // 24 + 1])
    for collector in (halves, whole):
        found = collector.sticks.only(finished).in_order()
        owner = np.repeat(sample, slots // blocks, axis=0)
        for number in range(4):
            mine = stuck & (owner == number)
            assert found.count[number] == (mine.sum() if finished[number] else 0)
        expected = np.concatenate([start[stuck & (owner == number)] for number in (0, 1, 3)])
        np.testing.assert_array_equal(found.start, expected)
        statistics = statistics_of(found.only(finished), t1=60.0)
        sums = jax.tree.leaves(statistics.accumulator.sticks)
        assert all(np.all(np.isfinite(np.asarray(leaf, float))) for leaf in sums)
        assert statistics.duration.number == len(expected)


class _EndsEarly(ss.PoissonSwitching):
    """A law that runs out after three intervals: short samples do not finish."""

    def draw(self, key_data, number, dtype):
        return jnp.where(number < 3, super().draw(key_data, number, dtype), 0)


@pytest.mark.slow
def test_unfinished_samples_enter_no_statistic():
    law = _EndsEarly(speed=1.0, rate=1.0)
    kept = ss.simulate_ensemble(SYSTEM, law, t1=3.0, samples=200, key=jax.random.key(1), y0=(0.0, 1.0), keep="sticks")
    assert 0 < kept.finished < 200
    done = kept.totals.status == ss.Status.FINISHED
    statistics = kept.statistics
    assert statistics.samples == statistics.stick_count.number == kept.finished == len(kept.finished_sticks().count)
    assert statistics.stick_count.mean.value == pytest.approx(kept.totals.sticks[done].mean())
    assert statistics.stick_fraction.mean.value == pytest.approx(kept.totals.stick_time[done].mean() / 3)
    assert "NOT FINISHED" in repr(kept.summary())


@pytest.mark.slow
def test_statistics_in_float32_are_those_of_float64():
    sticks = made_up_sticks(np.random.default_rng(2), 50)
    single = sticks._replace(numbers=sticks.numbers.astype(np.float32))
    one, other = statistics_of(sticks), statistics_of(single)
    for name in ("start", "duration", "position", "slip_duration"):
        mine, theirs = getattr(one, name), getattr(other, name)
        # Times up to 100 s are rounded to 4e-6 s.
        assert mine.mean.value == pytest.approx(theirs.mean.value, abs=1e-5)
        assert mine.median.value == pytest.approx(theirs.median.value, abs=1e-2)
        assert theirs.repeated_share.value == 0
    assert one.slip_duration.largest <= T1


def test_totals_alone_have_no_statistics(kept):
    totals = ss.simulate_ensemble(SYSTEM, POISSON, samples=300, keep="totals", chunk=64, **RUN)
    assert ss.stick_fraction(totals).value == pytest.approx(ss.stick_fraction(kept).value, rel=1e-12)
    assert totals.accumulator is totals.retained is totals.flat_sticks is None
    for ask in (lambda: totals.statistics, totals.summary, lambda: ss.convergence(ss.stick_fraction, totals)):
        with pytest.raises(ValueError, match="kept only totals; call simulate_ensemble"):
            ask()
