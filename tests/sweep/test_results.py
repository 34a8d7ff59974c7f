"""The numbers of a sweep: those of ensembles at its points, in bins that all points share."""

import math

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._sweep.dataset import Results

KEY = jax.random.key(7)
MU, RATE = [0.5, 1.2], [0.5, 1.0, 2.5]
SAMPLES, T1 = 1500, 30.0


def oscillator(mu=1.0):
    return ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))


def sweep(**changed):
    arguments = {"over": {"mu": MU, "rate": RATE}, "t1": T1, "samples": SAMPLES, "key": KEY} | changed
    return ss.Sweep(
        arguments.pop("system", oscillator()), arguments.pop("law", ss.PoissonSwitching(1.0, 1.0)), **arguments
    )


def ensemble(mu, rate, **changed):
    arguments = {"t1": T1, "samples": SAMPLES, "key": KEY, "keep": "sticks"} | changed
    return ss.simulate_ensemble(oscillator(mu), ss.PoissonSwitching(1.0, rate), **arguments)


@pytest.fixture(scope="module")
def dataset():
    return sweep(realizations=3).run()


@pytest.fixture(scope="module")
def many():
    return ensemble(1.2, 2.5)


@pytest.mark.slow
def test_points_are_ensembles(dataset, many):
    at = dataset.sel(mu=1.2, rate=2.5)
    assert at.samples == at.samples_finished == SAMPLES
    assert at.samples_near_grazing == many.near_grazing_samples
    for statistic in (ss.stick_fraction, ss.mean_stick_count, ss.mean_slip_count, ss.mean_stick_duration):
        there = statistic(many)
        # Merged from parts: sums of SAMPLES numbers, in another order.
        assert float(at[statistic.name]) == pytest.approx(there.value, rel=SAMPLES * 2**-53)
        assert float(at[f"{statistic.name}_error"]) == pytest.approx(there.standard_error, rel=1e-9)
    duration = many.statistics.duration
    assert float(at.duration_mean) == pytest.approx(duration.mean.value, rel=SAMPLES * 2**-52)
    assert float(at.duration_quantile.sel(quantile=0.5)) == duration.median.value
    second = many.statistics.order(2)
    assert float(at.duration_of_order.sel(order=2)) == pytest.approx(second.duration.mean.value, rel=1e-12)
    assert float(at.share_with_order.sel(order=2)) == second.share.value


@pytest.mark.slow
def test_histograms_in_common_bins(dataset):
    """Counted from the sticks themselves; the entropy from these counts."""
    for mu, rate in ((0.5, 0.5), (1.2, 2.5)):
        sticks = ensemble(mu, rate).numbered_sticks()
        at = dataset.sel(mu=mu, rate=rate)
        edges = np.append(at.duration_bin_low.values, at.duration_bin_high.values[-1])
        counts, _ = np.histogram(sticks.duration, edges)
        np.testing.assert_array_equal(at.duration_count_in_bin, counts)
        assert counts.sum() == len(sticks.duration)
        share = counts[counts > 0] / counts.sum()
        bias = -(len(share) - 1) / (2 * counts.sum())
        assert float(at.duration_entropy) == pytest.approx(-np.sum(share * np.log(share)) - bias, rel=1e-12)
        np.testing.assert_allclose(at.duration_density, counts / counts.sum() / np.diff(edges), rtol=1e-12)


@pytest.mark.slow
def test_bins_hold_all_points_and_no_more(dataset):
    """At most 50 of equal width; the first and the last are used by some point."""
    for name in ("duration", "start", "position", "stick_count", "slip_duration"):
        counts = dataset[f"{name}_count_in_bin"].sum(("mu", "rate")).values
        assert 25 <= len(counts) <= 50 or name == "stick_count"
        assert counts[0] > 0
        assert counts[-1] > 0
        widths = (dataset[f"{name}_bin_high"] - dataset[f"{name}_bin_low"]).values
        assert math.frexp(widths[0])[0] == 0.5  # a power of two
        np.testing.assert_array_equal(widths, widths[0])
    units = {name: dataset[f"{name}_bin"].attrs["units"] for name in ("duration", "position", "stick_count")}
    assert units == {"duration": "s", "position": "m", "stick_count": "1"}


@pytest.mark.slow
def test_sticks_of_the_first_realizations(dataset, many):
    at = dataset.sel(mu=1.2, rate=2.5)
    for sample in range(3):
        starts = at.stick_start.values[sample]
        mask = np.asarray(many.sticks.mask[sample])
        np.testing.assert_array_equal(starts[np.isfinite(starts)], np.asarray(many.sticks.start[sample])[mask])


@pytest.mark.slow
def test_random_numbers_are_common_unless_asked(many):
    """With common ones the difference of two near points is far less noisy than that of independent ones."""
    near = {"over": {"mu": [1.0, 1.01], "rate": [2.5]}, "keep": "totals", "samples": 1000}
    first = ensemble(1.01, 2.5, samples=1000, keep="totals")
    common = sweep(**near).run()
    exactly = {"rel": 1000 * 2**-53}  # but for the order of summing
    assert float(common.stick_fraction.sel(mu=1.01)[0]) == pytest.approx(ss.stick_fraction(first).value, **exactly)
    apart = sweep(**near, independent=True)
    found = float(apart.run().stick_fraction.sel(mu=1.01)[0])
    assert found != pytest.approx(ss.stick_fraction(first).value, rel=1e-6)
    there = apart.ensemble_at(mu=1.01, rate=2.5, keep="totals")
    assert found == pytest.approx(ss.stick_fraction(there).value, **exactly)
    differences = []
    for independent in (False, True):
        found = [sweep(**near, independent=independent, key=jax.random.key(seed)).run() for seed in range(8)]
        differences.append(np.std([float(one.stick_fraction.diff("mu").item()) for one in found]))
    assert differences[0] < 0.5 * differences[1]


@pytest.mark.slow
def test_wanted_standard_errors():
    """Each point ends with the first batch after which its error is small enough, or with all samples."""
    wanted = {"mean_stick_duration": 0.0022}
    found = sweep(samples=1000, batch=128, keep="totals", standard_error=wanted).run()
    for mu in MU:
        for rate in RATE:
            at = found.sel(mu=mu, rate=rate)
            samples = int(at.samples)
            assert samples % 128 == 0 or samples == 1000
            whole = ensemble(mu, rate, samples=samples, keep="totals")
            assert ss.mean_stick_duration(whole).standard_error == pytest.approx(
                float(at.mean_stick_duration_error), rel=1e-9
            )
            assert float(at.mean_stick_duration_error) <= 0.0022 or samples == 1000
            if samples > 128:
                before = ensemble(mu, rate, samples=(samples - 1) // 128 * 128, keep="totals")
                assert ss.mean_stick_duration(before).standard_error > 0.0022
    assert len(np.unique(found.samples)) > 2


@pytest.mark.slow
def test_sensitivities():
    over = {"mu": [0.6], "rate": [0.8, 1.5]}
    found = sweep(over=over, keep="totals", sensitivities=[("mean_stick_duration", ("mu", "rate"))]).run()
    law = ss.PoissonSwitching(1.0, 1.5)
    alone = ss.sensitivity(
        ss.mean_stick_duration, oscillator(0.6), law, wrt=("mu", "rate"), t1=T1, samples=SAMPLES, key=KEY
    )
    at = found.sel(mu=0.6, rate=1.5)
    for name, one in alone.items():
        assert float(at[f"d_mean_stick_duration_by_{name}"]) == pytest.approx(one.derivative, rel=1e-9)
        assert float(at[f"d_mean_stick_duration_by_{name}_error"]) == pytest.approx(one.standard_error, rel=1e-9)
        assert bool(at[f"d_mean_stick_duration_by_{name}_is_corrected"])
    assert found.d_mean_stick_duration_by_mu.attrs["units"] == "s"
    assert found.d_mean_stick_duration_by_rate_error.attrs["units"] == "s (1/s)-1"


def test_statistics_may_be_chosen():
    few = sweep(over={"mu": MU}, statistics=["mean_stick_duration", "position"]).run()
    assert {"mean_stick_duration", "position_entropy"} < set(few)
    assert not {"stick_fraction", "duration_mean"} & set(few)


def test_points_are_put_together_while_others_are_simulated(monkeypatch, tmp_path):
    """Only histograms are left for the end; of an earlier run, each point is read then."""
    steps, dataset = [], Results.dataset
    monkeypatch.setattr(Results, "dataset", lambda self, *bar: (steps.append(self.steps), dataset(self, *bar))[1])
    arguments = {"over": {"mu": MU}, "samples": 300, "statistics": ["mean_stick_duration", "duration"]}
    first = sweep(**arguments).run(tmp_path / "sweep", progress=False)
    again = sweep(**arguments).run(tmp_path / "sweep", progress=False)
    assert steps == [len(MU), 2 * len(MU)]
    assert again.identical(first)


@pytest.mark.parametrize("room", ["little", "none"])
def test_a_run_without_room_for_distributions_reads_them_again(monkeypatch, room):
    def full(*_):
        raise OSError(28, "No space left on device")

    arguments = {"over": {"mu": MU}, "samples": 300, "statistics": ["mean_stick_duration", "duration"]}
    usual = sweep(**arguments).run(progress=False)
    if room == "little":
        monkeypatch.setattr("stickslip_jax._sweep.dataset._ON_DISK", -1)
    else:
        monkeypatch.setattr("stickslip_jax._sweep.dataset.SpooledTemporaryFile.write", full)
    found = sweep(**arguments).run(progress=False)
    assert found.drop_vars("run_seconds").identical(usual.drop_vars("run_seconds"))


@pytest.mark.slow
def test_one_compilation_serves_all_points(caplog):
    arguments = {"over": {"mu": MU, "rate": RATE, "stiffness": [3.0, 4.0]}, "samples": 700}

    def compiled(over):
        caplog.clear()
        with jax.log_compiles(), caplog.at_level("WARNING"):
            sweep(**arguments | over).run(threads=2)
        return [record.message for record in caplog.records if "Finished XLA compilation" in record.message]

    jax.clear_caches()  # of what earlier tests compiled
    assert compiled({"over": {"mu": [1.0]}})  # so that the log is known to show it
    assert not compiled({})


@pytest.mark.slow
def test_parameter_of_the_distribution_of_a_start():
    """It has a label, in words, as that of any other distribution, and the unit of the start."""
    starts = (ss.Uniform(0.0, 1.0), 0.0)
    found = sweep(over={"y0[0].low": [0.0, 0.1]}, y0=starts, samples=20, keep="totals").run(progress=False)
    assert found["y0[0].low"].attrs == {"long_name": "low of initial position", "units": "m"}
