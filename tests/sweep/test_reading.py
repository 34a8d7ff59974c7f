"""Reading a sweep while a run works on it: each reading is of one set of batches, and none fails."""

import gc
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np
import pytest
from support.batches import join, unjoined
from support.faults import TESTS, log_of, run, sweep_of

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax._sweep import dataset, store
from stickslip_jax._sweep.dataset import Spool, status_of, stored_dataset


@pytest.fixture
def begun(tmp_path):
    """The folder of a sweep that has the first of two batches at each point, and the function that adds the others.

    These are joined at once, as by a run.
    """
    sweep, folder = sweep_of(keep="statistics"), tmp_path / "sweep"
    unjoined(sweep, folder)
    for path in (folder / "batches").glob("*-256-500.zip"):
        path.unlink()
    return folder, lambda: join(folder)


def read_samples(folder) -> list[int]:
    """The samples of each point, as each of the ways to read them tells."""
    found = stored_dataset(folder)["samples"].values
    assert np.array_equal(ss.Sweep.load(folder).results["samples"].values, found)
    assert status_of(folder).samples == found.sum()
    return found.tolist()


@pytest.mark.slow
def test_all_ways_to_read_see_the_same(begun):
    folder, add_and_join = begun
    assert read_samples(folder) == [256, 256]
    add_and_join()
    assert read_samples(folder) == [500, 500]


@pytest.mark.slow
def test_batches_that_join_before_the_histograms(begun, monkeypatch):
    """The histograms are in bins for what was read first: values that came later need not fit into them."""
    folder, add_and_join = begun
    before, of, once = stored_dataset(folder), dataset.CommonBins.of, [add_and_join]

    def joined_before(*arguments):
        for join_them in once:
            join_them()
        once.clear()
        return of(*arguments)

    monkeypatch.setattr(dataset.CommonBins, "of", joined_before)
    assert stored_dataset(folder).identical(before)
    assert np.array_equal(before["duration_count_in_bin"].sum("duration_bin") > 0, [True, True])
    assert read_samples(folder) == [500, 500]


@pytest.mark.slow
@pytest.mark.parametrize("read_it", [status_of, stored_dataset], ids=["status", "show"])
def test_batches_that_join_after_they_were_listed(begun, monkeypatch, read_it):
    folder, add_and_join = begun
    read, calls = store.Store.read, []

    def joined_before(self, batch):
        calls.append(batch)
        if len(calls) == 1:
            add_and_join()
        return read(self, batch)

    monkeypatch.setattr(store.Store, "read", joined_before)
    found = read_it(folder)
    assert (found.samples if read_it is status_of else int(found["samples"].sum())) == 1000
    assert len(calls) > 2


@pytest.mark.slow
def test_listing_that_misses_the_parts_and_the_whole(begun, monkeypatch):
    """As a folder gives it where the whole comes, and the parts go, while it is listed."""
    folder, add_and_join = begun
    names_in, calls = store._names_in, []

    def halfway(of):
        calls.append(of)
        if len(calls) == 1:
            add_and_join()
            return set()
        return names_in(of)

    monkeypatch.setattr(store, "_names_in", halfway)
    assert stored_dataset(folder)["samples"].values.tolist() == [500, 500]


@pytest.mark.slow
def test_what_was_read_goes_to_the_disk_where_it_is_much(monkeypatch):
    monkeypatch.setattr("stickslip_jax._sweep.dataset._IN_MEMORY", 10)
    cache = Spool()
    batches = [(store.Batch(Path("a"), 0, 5), b"12345"), (store.Batch(Path("b"), 5, 9), b"6789" * 10)]
    cache.put(3, batches)
    cache.put(1, [])
    assert (cache.get(3), cache.get(1), cache.get(0)) == (batches, [], None)
    del cache  # closes its file: pytest makes errors of those that are left open
    gc.collect()


@pytest.mark.slow
def test_no_room_for_what_was_read(monkeypatch, begun):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("stickslip_jax._sweep.dataset.SpooledTemporaryFile.write", full)
    with pytest.raises(ss.SweepError, match=r"cannot be written \(No space left on device\).*TMPDIR\."):
        stored_dataset(begun[0])


def test_only_a_loaded_sweep_has_results():
    with pytest.raises(ss.SweepError, match=r"loaded from a folder has results; call sweep\.run\(\)"):
        _ = sweep_of().results


def test_finished_sweep_is_told_so_also_where_its_numbers_are_written_otherwise(tmp_path):
    """1 and 1.0: the result bears the sum of the manifest that is there."""
    run(sweep_of(), tmp_path / "sweep")
    run(sweep_of(ss.MassSpring(1, 4, 1, ss.Coulomb(1.0)), y0=(0, 1)), tmp_path / "sweep")
    assert status_of(tmp_path / "sweep").is_finished


# --- beside a run in a process of its own

POINTS, SAMPLES = 12, 20 * 256
RUN = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
from sweep.test_reading import busy_sweep
busy_sweep().run(sys.argv[1], threads=2, progress=False)
"""


def busy_sweep() -> ss.Sweep:
    """One whose points are done, and joined, in quick succession."""
    return sweep_of(over={"mu": np.linspace(0.5, 1.2, POINTS)}, samples=SAMPLES, keep="statistics")


@contextmanager
def running(folder):
    """A run of it, killed at the end, with a batch that is done."""
    paths = os.pathsep.join([str(TESTS), str(TESTS.parent)])
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, str(folder)], env=os.environ | {"PYTHONPATH": paths}, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    try:
        while "done" not in log_of(folder):
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        yield process
    finally:
        process.kill()
        process.communicate()


def assert_consistent(found) -> None:
    """Every value of a point is in the bins that all share, and every sample has one status."""
    assert found["samples"].max() <= SAMPLES
    if found["samples"].any():
        assert (found["stick_count_count_in_bin"].sum("stick_count_bin") == found["samples_finished"]).all()


@pytest.mark.slow
def test_two_hundred_readings_while_a_sweep_runs(tmp_path, capsys, monkeypatch):
    """As many as run beside it; a run that ends is followed by another one in another folder."""
    monkeypatch.setattr("stickslip_jax.study._commands.prepare_jax", lambda dtype: None)
    readings = beside = 0
    partial = set()
    jax.config.update("jax_enable_x64", True)
    for number in range(100):
        folder = tmp_path / str(number)
        with running(folder) as process:
            while process.poll() is None and beside < 200:
                way = readings % 4
                if way == 0:
                    found = stored_dataset(folder)
                    assert_consistent(found)
                    partial.add(int(found["samples"].sum()))
                elif way == 1:
                    assert status_of(folder).points == POINTS
                elif way == 2:
                    assert_consistent(ss.Sweep.load(folder).results)
                else:
                    assert cli.main(["show", str(folder)]) == 0, capsys.readouterr()
                readings += 1
                beside += process.poll() is None
            assert process.poll() in (None, 0), process.communicate()
        if beside >= 200:
            break
    assert beside >= 200
    assert len(partial) > 10
