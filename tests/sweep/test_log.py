"""What a sweep says about batches, unfinished samples and failed points: in its log, its result and errors."""

import re

import numpy as np
import pytest
import xarray as xr
from support.faults import assert_same, one_sentence, run, sweep_of

import stickslip_jax as ss
from stickslip_jax._sweep import batches

TIME = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d"


def test_log_of_a_whole_sweep(tmp_path):
    run(sweep_of(), tmp_path / "sweep")
    begun, *batches, finished = (tmp_path / "sweep" / "log.txt").read_text().splitlines()
    assert re.fullmatch(f"{TIME} begun: 2 points, 500 samples each", begun)
    assert re.fullmatch(f"{TIME} finished", finished)
    done = [re.fullmatch(rf"{TIME} done (mu = \S+: samples \d+ to \d+) in \d+\.\d\d s", line)[1] for line in batches]
    assert sorted(done) == [f"mu = {mu}: samples {part}" for mu in ("0.5", "1") for part in ("0 to 255", "256 to 499")]


@pytest.mark.slow
def test_samples_that_did_not_finish_are_counted(tmp_path):
    """As the ensemble counts them; the log names them batch by batch."""
    sweep = sweep_of(method=ss.Exact(step=0.05, max_steps=420))
    dataset = run(sweep, tmp_path / "sweep")
    log = (tmp_path / "sweep" / "log.txt").read_text()
    for mu in (0.5, 1.0):
        counts = sweep.ensemble_at(mu=mu, keep="totals", progress=False).status_counts
        assert 0 < counts[ss.Status.OUT_OF_STEPS] < 500
        for status, count in counts.items():
            assert dataset[f"samples_{status.name.lower()}"].sel(mu=mu).item() == count
        said = re.findall(rf"{TIME} not to the end mu = {mu:g}: samples \d+ to \d+: (\d+) OUT_OF_STEPS\n", log)
        assert sum(map(int, said)) == counts[ss.Status.OUT_OF_STEPS]


@pytest.fixture
def failing_point(monkeypatch):
    """The second point cannot be simulated; calling it mends that."""
    perform = batches.perform

    def refuse(plan, task):
        if task.point == 1:
            raise ValueError("The mass went on strike.")
        return perform(plan, task)

    monkeypatch.setattr(batches, "perform", refuse)
    return lambda: monkeypatch.setattr(batches, "perform", perform)


def test_results_of_the_others_are_there_when_a_point_failed(tmp_path, failing_point):
    folder, dataset = tmp_path / "sweep", run(sweep_of(over={"mu": [0.5]}), tmp_path / "one")
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), folder)
    one_sentence(error, "1 of 2 points failed, first mu = 1: The mass went on strike; ", str(folder / "log.txt"))
    assert f"{folder / 'sweep.nc'} has the results of the others" in str(error.value)
    log = (folder / "log.txt").read_text()
    assert log.count("FAILED mu = 1: samples") == 2
    assert log.endswith("finished, but 1 of 2 points failed\n")
    found = xr.load_dataset(folder / "sweep.nc")
    assert found["samples"].values.tolist() == [500, 0]
    assert np.isnan(found["stick_fraction"].sel(mu=1.0))
    assert found["stick_fraction"].sel(mu=0.5).item() == dataset["stick_fraction"].item()
    failing_point()
    assert_same(run(sweep_of(), folder), run(sweep_of(), tmp_path / "undisturbed"))


def test_failed_point_without_a_folder(failing_point):
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), None)
    one_sentence(error, "1 of 2 points failed", "give a folder, which keeps the results of the others")
