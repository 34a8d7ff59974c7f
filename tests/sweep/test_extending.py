"""More samples, points, statistics and derivatives in the folder of a sweep: what is there is used again."""

import contextlib

import numpy as np
import pytest
from support.faults import assert_same, failing, run, sweep_of

from stickslip_jax._sweep import batches

U = 2.0**-53
SAMPLES, LONGER, BATCH, T1 = 500, 900, 256, 20.0


@pytest.fixture
def simulated(monkeypatch):
    """The tasks that are done, (point, first sample, last, number of the derivative)."""
    tasks, perform = [], batches.perform

    def noted(plan, task):
        tasks.append(tuple(task))
        return perform(plan, task)

    monkeypatch.setattr(batches, "perform", noted)
    return tasks


@pytest.mark.slow
def test_more_samples(tmp_path, simulated):
    options = {"keep": "statistics", "statistics": ["stick_fraction", "duration"]}
    run(sweep_of(**options), tmp_path / "sweep")
    simulated.clear()
    extended = run(sweep_of(**options, samples=LONGER), tmp_path / "sweep")
    ends = [(500, 512), (512, 768), (768, 900)]
    assert sorted(simulated) == [(point, first, end, None) for point in range(2) for first, end in ends]
    whole = run(sweep_of(**options, samples=LONGER), tmp_path / "longer")
    inexact = [name for name in whole.variables if whole[name].values.tobytes() != extended[name].values.tobytes()]
    counted = [name for name in whole.variables if whole[name].dtype.kind == "i"]
    assert {"samples", "samples_finished", "duration_count_in_bin", "stick_fraction_count_in_bin"} <= set(counted)
    assert not set(inexact) & set(counted)
    assert not {name for name in inexact if "_bin" in name or "entropy" in name or "quantile" in name}
    # The mean of n numbers in [0, largest] is computed within n * U * largest; a merge adds at most 4 * U * largest,
    # four roundings of numbers that are at most as large. There are at most 5 batches, in each of the two sweeps.
    sticks = int(whole["duration_count_in_bin"].sum("duration_bin").max())
    for name, numbers, largest in (("stick_fraction", BATCH, 1.0), ("duration_mean", sticks, T1)):
        most = 2 * (numbers + 5 * 4) * U * largest
        assert np.all(np.abs(whole[name] - extended[name]) <= most)


def test_more_points(tmp_path, simulated):
    more = {"over": {"mu": [0.5, 0.75, 1.0]}}
    run(sweep_of(), tmp_path / "sweep")
    simulated.clear()
    dataset = run(sweep_of(**more), tmp_path / "sweep")
    assert sorted(simulated) == [(1, 0, 256, None), (1, 256, 500, None)]
    assert_same(dataset, run(sweep_of(**more), tmp_path / "longer"))


def test_points_that_come_back(tmp_path, simulated):
    """Points of which nobody asks stay in the folder."""
    before = run(sweep_of(), tmp_path / "sweep")
    fewer = run(sweep_of(over={"mu": [1.0]}), tmp_path / "sweep")
    assert fewer["stick_fraction"].item() == before["stick_fraction"].sel(mu=1.0).item()
    assert len(simulated) == 4
    assert_same(run(sweep_of(), tmp_path / "sweep"), before)
    assert len(simulated) == 4


def test_points_in_another_order(tmp_path, simulated):
    before = run(sweep_of(), tmp_path / "sweep")
    turned = run(sweep_of(over={"mu": [1.0, 0.5]}), tmp_path / "sweep")
    assert len(simulated) == 4
    assert_same(turned.sel(mu=[0.5, 1.0]), before)


def test_more_statistics(tmp_path, simulated):
    run(sweep_of(statistics=["stick_fraction"]), tmp_path / "sweep")
    dataset = run(sweep_of(), tmp_path / "sweep")
    assert len(simulated) == 4
    assert_same(dataset, run(sweep_of(), tmp_path / "other"))


@pytest.mark.slow
def test_more_derivatives(tmp_path, simulated):
    """Also by a parameter whose name has a point, which is in the name of the file."""
    first, second = ("stick_fraction", "mu"), ("stick_fraction", "friction.mu")
    run(sweep_of(), tmp_path / "sweep")
    simulated.clear()
    run(sweep_of(sensitivities=[first]), tmp_path / "sweep")
    both = sweep_of(sensitivities=[second, first])
    dataset = run(both, tmp_path / "sweep")
    assert sorted(simulated) == [(point, 0, 500, 0) for point in (0, 0, 1, 1)]
    assert_same(run(both, tmp_path / "sweep"), dataset)
    assert len(simulated) == 4
    assert_same(dataset, run(both, tmp_path / "other"))


class StoppedError(BaseException):
    """Stands for an interrupt."""


def test_wanted_standard_errors_after_an_interrupt_that_left_a_gap(tmp_path, simulated):
    """Each missing batch is simulated once, those beyond the gap never again."""
    folder, samples = tmp_path / "sweep", 6 * BATCH

    def stop(number, name, of):
        if len(list((folder / "batches").glob("*.zip"))) == 4:
            raise StoppedError

    with contextlib.suppress(StoppedError), failing(folder, stop):
        sweep_of(over={"mu": [0.5]}, samples=samples).run(folder, threads=1, progress=False)
    batches = sorted((folder / "batches").glob("*.zip"), key=lambda path: int(path.name.split("-")[1]))
    assert [path.name.split("-")[1] for path in batches] == ["0", "256", "512", "768"]
    batches[1].unlink()
    simulated.clear()
    wanted = {"standard_error": {"stick_fraction": 1e-9}}  # never reached
    dataset = sweep_of(over={"mu": [0.5]}, samples=samples, **wanted).run(folder, threads=1, progress=False)
    assert simulated == [(0, 256, 512, None), (0, 1024, 1280, None), (0, 1280, 1536, None)]
    assert_same(dataset, run(sweep_of(over={"mu": [0.5]}, samples=samples), tmp_path / "other"))
