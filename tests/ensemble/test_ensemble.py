"""Ensembles: what a sample depends on, what is counted, what is kept, and that nothing is lost on the way."""

import math
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.common import lanes
from stickslip_jax._dynamics.interval.engine import IntervalEngine
from stickslip_jax._dynamics.sticks import NUMBERS, slips_between
from stickslip_jax._ensemble import data
from stickslip_jax._numerics.sums import Moments
from stickslip_jax._statistics.totals import TOTALS

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
KEY = jax.random.key(2026)
ROOT = Path(__file__).parents[2]
RUN = {"t1": 40.0, "y0": (0.0, 1.0), "key": KEY, "chunk": 64}
LAWS = [
    POISSON,
    ss.SquareWave(speed=1.0, period=2.6),
    ss.RandomSteps(speed=1.0, interval=0.7),
    ss.RandomSteps(speed=1.0, interval=0.7, levels=(-1.0, 0.0, 0.5, 2.0), probabilities=(0.4, 0.2, 0.3, 0.1)),
    ss.Constant(speed=0.7),
    ss.PiecewiseConstant(times=np.array([0.0, 3.0, 5.0, 9.0]), velocities=np.array([1.0, 1.0, -0.5, 0.0])),
]


@pytest.fixture(scope="module")
def kept():
    return ss.simulate_ensemble(SYSTEM, POISSON, samples=150, keep="sticks", **RUN)


def test_much_memory_is_told_before_it_is_taken(monkeypatch):
    """From the first part on: twice what its sticks take, for all samples."""
    wanted = {"samples": 150, "keep": "sticks", **RUN}
    monkeypatch.setattr(data, "_MUCH", 1000.0)
    with pytest.warns(RuntimeWarning, match=r'sticks of 150 samples takes about 0.0 GB of it; keep="statistics"'):
        ss.simulate_ensemble(SYSTEM, POISSON, **wanted)
    monkeypatch.setattr(data, "available_memory", lambda: 1000.0)
    with pytest.raises(ValueError, match=r'Argument keep must be "statistics" .* of 150 samples takes'):
        ss.simulate_ensemble(SYSTEM, POISSON, **wanted)
    assert ss.simulate_ensemble(SYSTEM, POISSON, **wanted | {"keep": "statistics"}).samples == 150


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_each_sample_is_the_simulation_of_its_own_key(law):
    many = ss.simulate_ensemble(SYSTEM, law, samples=5, keep="sticks", **RUN)
    assert many.finished == 5
    for i in (0, 3, 4):
        one = ss.simulate(SYSTEM, law.sample(jax.random.fold_in(KEY, i), 40.0), t1=40.0, y0=(0.0, 1.0))
        count = int(one.sticks.count)
        assert many.sticks.count[i] == count
        assert many.totals.slips[i] == int(one.slips.count)
        # Both run the same arithmetic; compiled apart, a fused multiply-add may differ in the last places, and what
        # a switch at rate 1/s amplifies in 40 s stays far below 1e-10.
        for name in ("start", "end", "position"):
            np.testing.assert_allclose(
                getattr(many.sticks, name)[i, :count], np.asarray(getattr(one.sticks, name))[:count], rtol=0, atol=1e-10
            )
        np.testing.assert_array_equal(many.sticks.ending[i, :count], np.asarray(one.sticks.ending)[:count])
        assert many.totals.stick_time[i] == pytest.approx(float(one.stick_time), abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("changed", [{"chunk": 37}, {"chunk": 128}, {"threads": 1}, {"threads": 3}, {"samples": 70}])
def test_a_sample_depends_on_its_key_and_number_only(kept, changed):
    other = ss.simulate_ensemble(SYSTEM, POISSON, **{"samples": 150, "keep": "sticks", **RUN, **changed})
    n = other.samples
    np.testing.assert_array_equal(other.totals.stick_time, kept.totals.stick_time[:n])
    np.testing.assert_array_equal(other.totals.sticks, kept.totals.sticks[:n])
    total = int(kept.flat_sticks.count[:n].sum())
    for name in ("start", "end", "position", "ending"):
        np.testing.assert_array_equal(getattr(other.flat_sticks, name), getattr(kept.flat_sticks, name)[:total])


@pytest.mark.slow
def test_totals_of_each_sample(kept):
    totals = ss.simulate_ensemble(SYSTEM, POISSON, samples=150, keep="totals", **RUN)
    for name in totals.totals._fields:
        np.testing.assert_array_equal(getattr(totals.totals, name), getattr(kept.totals, name), strict=name != "sticks")
    back = ss.Ensemble.from_xarray(totals.to_xarray())
    np.testing.assert_array_equal(back.totals.stick_time, kept.totals.stick_time)
    np.testing.assert_array_equal(back.extended(samples=10).totals.sticks[:150], kept.totals.sticks)
    streamed = ss.simulate_ensemble(SYSTEM, POISSON, samples=150, **RUN)
    with pytest.raises(ValueError, match=r'did not keep the totals of each sample; call .*keep="totals"'):
        _ = streamed.totals


def test_streamed_and_kept_ensembles_agree(kept):
    streamed = ss.simulate_ensemble(SYSTEM, POISSON, samples=150, keep="statistics", **RUN)
    assert streamed.moments.number == kept.moments.number == 150
    np.testing.assert_allclose(streamed.moments.mean, kept.moments.mean, rtol=1e-13)
    np.testing.assert_allclose(streamed.moments.scatter, kept.moments.scatter, rtol=1e-11)
    with pytest.raises(ValueError, match='keep="sticks"'):
        _ = streamed.sticks
    with pytest.raises(ValueError, match='keep="sticks"'):
        _ = streamed.slips


@pytest.mark.slow
def test_a_long_trajectory_outgrows_any_block():
    """Far more intervals than one call records: the stream goes on where it stopped, nothing is cut."""
    law = ss.PoissonSwitching(speed=1.0, rate=200.0)
    many = ss.simulate_ensemble(SYSTEM, law, t1=60.0, samples=3, key=KEY, keep="sticks", chunk=2)
    assert law.capacity(60.0) > 8192
    one = ss.simulate(SYSTEM, law.sample(jax.random.fold_in(KEY, 2), 60.0), t1=60.0)
    assert many.finished == 3
    assert many.sticks.count[2] == int(one.sticks.count)
    assert many.totals.stick_time[2] == pytest.approx(float(one.stick_time), rel=1e-9)


class _EndsEarly(ss.PoissonSwitching):
    """A law that has no more intervals after the third."""

    def draw(self, key_data, number, dtype):
        return jnp.where(number < 3, super().draw(key_data, number, dtype), 0)


@pytest.mark.slow
@pytest.mark.parametrize("keep", ["statistics", "sticks"])
def test_samples_that_end_early_are_counted_apart_and_enter_nothing(keep):
    law = _EndsEarly(speed=1.0, rate=1.0)
    many = ss.simulate_ensemble(SYSTEM, law, t1=3.0, samples=400, key=KEY, y0=(0.0, 1.0), keep=keep)
    short = many.status_counts[ss.Status.BASE_TOO_SHORT]
    # A Poisson process of rate 1 has at most 2 points in 3 s with probability 8.5 exp(-3) = 0.423.
    finished_expected, spread = 400 * 8.5 * math.exp(-3), math.sqrt(400 * 0.423 * 0.577)
    assert abs(many.finished - finished_expected) < 4 * spread
    assert many.finished + short == 400
    assert many.moments.number == many.finished
    assert "NOT FINISHED" in repr(many)
    if keep == "sticks":
        unfinished = many.totals.status != ss.Status.FINISHED
        assert unfinished.sum() == short
        assert np.all(many.flat_sticks.count[unfinished] == 0)
        rows = many.totals.stick_time[~unfinished]
        assert many.moments.mean[TOTALS.index("stick_time")] == pytest.approx(rows.mean(), rel=1e-12)


@pytest.mark.slow
def test_a_state_that_overflows_is_reported_not_counted():
    many = ss.simulate_ensemble(SYSTEM, POISSON, t1=1.0, samples=3, key=KEY, y0=(1e200, 0.0))
    assert many.status_counts[ss.Status.NOT_FINITE] == 3
    assert math.isnan(ss.stick_fraction(many).value)


def test_one_compilation_serves_other_parameters_keys_and_sample_counts():
    def run(mu, rate, seed, samples, t1):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        law = ss.PoissonSwitching(1.0, rate)
        ss.simulate_ensemble(system, law, t1=t1, samples=samples, key=jax.random.key(seed), chunk=64)

    from stickslip_jax._dynamics.engine_choice import compiled_for  # noqa: PLC0415 - the cache under test

    summarize, begin, record = compiled_for(IntervalEngine(SYSTEM, POISSON, 1.0, (0.0, 1.0)))
    chunks = (summarize.native, begin, record.native)
    run(1.0, 1.0, 0, 10, 5.0)
    before = [len(compiled.programs) for compiled in chunks]
    run(0.3, 2.5, 1, 200, 9.0)
    run(0.0, 0.1, 2, 1, 0.5)
    assert before[2] > 0
    assert [len(compiled.programs) for compiled in chunks] == before


def test_first_statistics_against_brute_force(kept):
    """From the sticks themselves: values, and standard errors by the textbook formulas written out."""
    time, count, slips = (np.asarray(x, float) for x in (kept.totals.stick_time, kept.totals.sticks, kept.totals.slips))
    n = len(time)
    durations = [row[mask].sum() for row, mask in zip(kept.sticks.duration, kept.sticks.mask, strict=True)]
    np.testing.assert_allclose(time, durations, rtol=1e-9)

    fraction = ss.stick_fraction(kept)
    assert fraction.value == pytest.approx(time.mean() / 40, rel=1e-12)
    assert fraction.standard_error == pytest.approx(time.std(ddof=1) / 40 / math.sqrt(n), rel=1e-12)
    number = ss.mean_stick_count(kept)
    assert number.value == pytest.approx(count.mean(), rel=1e-12)
    assert number.standard_error == pytest.approx(count.std(ddof=1) / math.sqrt(n), rel=1e-12)
    pooled = ss.mean_stick_duration(kept)
    rest = kept.sticks.start[:, 0] == 0  # sticks that begin at t = 0 are left out
    assert 0 < rest.sum() < n
    time_later, later = time - np.where(rest, kept.sticks.duration[:, 0], 0), count - rest
    ratio = time_later.sum() / later.sum()
    assert pooled.value == pytest.approx(ratio, rel=1e-12)
    assert pooled.standard_error == pytest.approx(
        np.std(time_later - ratio * later, ddof=1) / later.mean() / math.sqrt(n), rel=1e-10
    )
    counted = ss.simulate_ensemble(SYSTEM, POISSON, samples=150, keep="sticks", count_initial_rest=True, **RUN)
    assert ss.mean_stick_duration(counted).value == pytest.approx(time.sum() / count.sum(), rel=1e-12)
    slip = ss.mean_slip_duration(kept)
    ratio = (40 - time).sum() / slips.sum()
    assert slip.value == pytest.approx(ratio, rel=1e-12)
    assert slip.standard_error == pytest.approx(
        np.std((40 - time) - ratio * slips, ddof=1) / slips.mean() / math.sqrt(n), rel=1e-10
    )
    assert ss.mean_slip_count(kept).value == pytest.approx(slips.mean(), rel=1e-12)


@pytest.mark.slow
def test_standard_errors_are_honest():
    """Over 200 independent ensembles the error in units of its standard error has mean 0 and variance 1."""
    law = ss.PoissonSwitching(1.0, 1.0)
    truth = ss.simulate_ensemble(SYSTEM, law, t1=20.0, samples=400_000, key=jax.random.key(99))
    runs = [
        ss.simulate_ensemble(SYSTEM, law, t1=20.0, samples=200, key=jax.random.key(seed), chunk=256)
        for seed in range(200)
    ]
    for statistic in (ss.stick_fraction, ss.mean_stick_count, ss.mean_stick_duration, ss.mean_slip_duration):
        exact = statistic(truth).value
        z = np.array([(s.value - exact) / s.standard_error for s in map(statistic, runs)])
        # Mean of 200 standard normals: sd 1/sqrt(200); their variance: sd sqrt(2/199); 4.5 sd each (8 checks,
        # chance of a false alarm 5e-5), plus the ratio estimators' bias of order 1/200 of a standard error.
        assert abs(z.mean()) < 4.5 / math.sqrt(200) + 0.02, statistic.__name__
        assert abs(z.var(ddof=1) - 1) < 4.5 * math.sqrt(2 / 199), statistic.__name__


@pytest.mark.slow
def test_no_stick_at_all_is_a_defined_result():
    many = ss.simulate_ensemble(
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.0)), POISSON, t1=5.0, samples=8, key=KEY, keep="sticks"
    )
    assert ss.stick_fraction(many).value == 0
    assert ss.mean_stick_count(many).value == 0
    assert math.isnan(ss.mean_stick_duration(many).value)
    assert "not defined" in str(ss.mean_stick_duration(many))
    assert many.sticks.mask.shape == (8, 1)
    assert not many.sticks.mask.any()
    assert ss.mean_slip_duration(many).value == pytest.approx(5.0)


@pytest.mark.usefixtures("annotations_unchecked")
def test_statistics_of_something_else_are_refused():
    one = ss.simulate(SYSTEM, ss.Constant(1.0), t1=1.0)
    with pytest.raises(ValueError, match=r"Argument ensemble must be the result of simulate_ensemble, but Simulation"):
        ss.stick_fraction(one)


def test_more_room_than_samples_costs_nothing(kept):
    many = ss.simulate_ensemble(SYSTEM, POISSON, samples=3, **{**RUN, "chunk": 10**9, "threads": 10**6}, keep="sticks")
    assert many.threads == 1
    np.testing.assert_array_equal(many.totals.stick_time, kept.totals.stick_time[:3])


@pytest.mark.slow
def test_one_million_samples_within_one_gigabyte():
    """In a process of its own, which prints the most memory that it held."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.million"], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert "finished  all samples" in done.stdout
    assert float(re.search(r"largest memory: ([\d.]+) GB", done.stdout)[1]) < 1


def test_one_sample_has_a_value_and_no_error_bar():
    many = ss.simulate_ensemble(SYSTEM, POISSON, samples=1, **RUN)
    assert ss.stick_fraction(many).value > 0
    assert math.isnan(ss.stick_fraction(many).standard_error)


def test_masked_slots_are_never_read(kept):
    """Garbage in the padding changes nothing that is computed from the sticks."""
    sticks = kept.sticks
    assert np.all(np.isnan(sticks.start[~sticks.mask]))
    assert np.all(sticks.ending[~sticks.mask] == -1)
    poisoned = ss.Sticks(
        *(np.where(sticks.mask, getattr(sticks, name), -7) for name in NUMBERS),
        np.where(sticks.mask, sticks.ending, 2).astype(np.int8),
        sticks.mask,
    )
    np.testing.assert_array_equal(poisoned.count, sticks.count)
    clean, dirty = slips_between(sticks, 40.0), slips_between(poisoned, 40.0)
    np.testing.assert_array_equal(clean.mask, dirty.mask)
    np.testing.assert_array_equal(clean.count, kept.totals.slips)
    for name in ("start", "end", "censored"):
        np.testing.assert_array_equal(getattr(clean, name), getattr(dirty, name))


def test_merged_moments_are_those_of_all_rows():
    rows = np.random.default_rng(0).normal(1e6, 1.0, (1000, 3))
    merged = Moments.of(rows[:1])
    for part in np.array_split(rows[1:], 7):
        merged = merged.merge(Moments.of(part))
    merged = merged.merge(Moments.of(rows[:0]))
    np.testing.assert_allclose(merged.mean, rows.mean(axis=0), rtol=1e-14)
    # The rows' own rounding, 1e6 * 2^-53, is what limits a variance of 1.
    np.testing.assert_allclose(merged.scatter / 999, np.cov(rows.T), atol=1e-8)


@pytest.mark.slow
def test_derivative_of_the_streamed_totals():
    """Forward derivative through the lanes against central differences with the same random numbers."""

    def stick_time(mu):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        key_data = jax.random.key_data(KEY)
        engine = IntervalEngine(system, POISSON, 20.0, (0.0, 1.0))
        job = lanes.Job(engine, key_data, np.uint32(0), np.int32(2))
        return lanes.summarize(job, lanes=32, rows=2, dtype=jnp.result_type(float)).stick_time

    _, tangent = jax.jit(lambda mu: jax.jvp(stick_time, (mu,), (1.0,)))(1.0)
    step = 1e-6
    both = jax.jit(stick_time)
    difference = (both(1.0 + step) - both(1.0 - step)) / (2 * step)
    # A stick that appears between the two points bends the total by its own length at most (about 1e-6 of it): its
    # difference is left out, all others agree to the step's round-off and curvature.
    agree = np.abs(tangent - difference) < 1e-4 * np.maximum(1, np.abs(difference))
    assert np.all(np.isfinite(tangent))
    assert agree.mean() > 0.9


def test_sticks_that_would_outgrow_the_memory_are_refused_early():
    # 2^31 samples of some 2.5 kB each: no machine of this decade holds 10 TB in memory.
    with pytest.raises(ValueError, match=r'Argument keep must be "statistics" .* GB, and this machine has'):
        ss.simulate_ensemble(SYSTEM, POISSON, samples=2**31, keep="sticks", threads=1, t1=200.0, key=KEY)


@pytest.mark.parametrize(
    ("argument", "value"),
    [("samples", 0), ("samples", -3), ("samples", 2.5), ("samples", True), ("samples", "10"), ("samples", 2**40),
     ("t1", 0.0), ("t1", -1.0), ("t1", float("nan")), ("t1", float("inf")), ("t1", 1e12), ("keep", "all"),
     ("threads", 0), ("threads", 1.5), ("chunk", 0), ("y0", (0.0,)), ("y0", (0.0, float("nan"))), ("y0", 1.0),
     ("key", None), ("key", 3)],
)  # fmt: skip
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_arguments_are_named(argument, value):
    arguments = {"t1": 5.0, "samples": 4, "key": KEY, argument: value}
    with pytest.raises(ValueError, match=rf"Argument {argument}") as caught:
        ss.simulate_ensemble(SYSTEM, POISSON, **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("annotations_unchecked")
def test_a_law_or_system_of_another_kind_is_refused():
    with pytest.raises(ValueError, match="Argument system must be a MassSpring"):
        ss.simulate_ensemble(POISSON, POISSON, t1=1.0, samples=1, key=KEY)
    with pytest.raises(ValueError, match="Argument law must be a base motion"):
        ss.simulate_ensemble(SYSTEM, SYSTEM, t1=1.0, samples=1, key=KEY)


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("transform", [jax.jit, jax.grad, jax.vmap])
def test_tracing_an_ensemble_is_refused_in_words(transform):
    def fraction(mu):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return ss.stick_fraction(ss.simulate_ensemble(system, POISSON, samples=4, **RUN)).value

    with pytest.raises(ValueError, match="simulate_ensemble must be numbers, but JAX is tracing them"):
        transform(fraction)(jnp.ones(2) if transform is jax.vmap else 1.0)


def test_labeled_arrays_hold_every_stick(kept):
    data = kept.to_xarray()
    assert data.stick_count.sum() == data.sizes["stick"] == len(kept.flat_sticks.start)
    assert all("units" in variable.attrs and "long_name" in variable.attrs for variable in data.data_vars.values())
    assert data.stick_start.attrs["units"] == "s"
    np.testing.assert_array_equal(data.stick_count, kept.sticks.count)


def test_progress_is_shown_when_asked_for_and_never_in_a_pipe(capfd):
    ss.simulate_ensemble(SYSTEM, POISSON, samples=4, **RUN)
    assert capfd.readouterr() == ("", "")
    ss.simulate_ensemble(SYSTEM, POISSON, samples=4, progress=True, **RUN)
    assert "4.00/4.00" in capfd.readouterr().err
