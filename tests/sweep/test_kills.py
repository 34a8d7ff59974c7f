"""Sweeps that are killed, at random moments and at every operation on the disk, and go on as if nothing had been."""

import contextlib
import random
import signal
import time

import pytest
import xarray as xr
from support.faults import assert_same, failing, files_in, halve_file, long_sweep, run, started, sweep_of


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The small sweep: its data set, and the names of its files."""
    folder = tmp_path_factory.mktemp("small") / "undisturbed"
    names = []
    with failing(folder, lambda number, name, of: names.append(name)):
        dataset = run(sweep_of(), folder)
    # 2 manifests, 4 batches, 2 joins of 2 batches each, the data set; and once the folder above.
    assert (names.count("replace"), names.count("unlink"), names.count("fsync")) == (9, 4, 19)
    return dataset, set(files_in(folder))


@pytest.fixture(scope="module")
def undisturbed_long(tmp_path_factory):
    return run(long_sweep(), tmp_path_factory.mktemp("long") / "undisturbed")


class DeadError(BaseException):
    """Stands for the end of a process: nothing is written any more."""


@pytest.mark.slow
@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_dead_at_an_operation_on_the_disk(tmp_path, undisturbed, monkeypatch, every):
    """As if killed there: the operation, and all later ones, are not done, and what is being written is cut."""
    dataset, names = undisturbed
    # Takes most of the time, and what the bytes of the data set mean is all the same here.
    monkeypatch.setattr(xr.Dataset, "to_netcdf", lambda dataset, *path, **options: bytes(10_000))
    number, finished = 1 - every, False
    while not finished:
        number += every
        folder = tmp_path / str(number)

        def fail(at, name, of, last=number):
            if at == last:
                halve_file(name, of)
            if at >= last:
                raise DeadError

        with contextlib.suppress(DeadError), failing(folder, fail):
            run(sweep_of(), folder)
            finished = True
        assert_same(run(sweep_of(), folder), dataset)
        assert set(files_in(folder)) == names
    assert number > 9 + 4 + 19


@pytest.mark.slow
def test_killed_at_every_operation_on_the_disk(tmp_path, undisturbed):
    """By a real SIGKILL in a process of its own."""
    dataset, names = undisturbed
    number, ended = 0, -signal.SIGKILL
    while ended == -signal.SIGKILL:
        number += 1
        folder = tmp_path / str(number)
        process = started(str(number), folder)
        said = process.communicate(timeout=300)[1]
        ended = process.returncode
        assert ended in (-signal.SIGKILL, 0), said
        assert_same(run(sweep_of(), folder), dataset)
        assert set(files_in(folder)) == names
    assert number > 9 + 4 + 19


def batches_done(folder) -> int:
    log = folder / "log.txt"
    return log.read_text().count(" done mu") if log.exists() else 0


def kill_while_starting(folder, moments) -> None:
    """At most when the first batch is done: on a fast machine all would be, before the next kill."""
    done, process = batches_done(folder), started("long", folder)
    last = time.monotonic() + moments.uniform(0.0, 2.0)
    while time.monotonic() < last and batches_done(folder) == done:
        time.sleep(0.002)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL


def kill_while_simulating(folder, moments) -> None:
    """Some batches, and a moment, after the first: while others are simulated, written and joined."""
    wanted = batches_done(folder) + moments.randint(1, 5)
    process = started("long", folder)
    while batches_done(folder) < wanted:
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    time.sleep(moments.uniform(0.0, 0.05))
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_two_kills_at_random_moments(tmp_path, undisturbed_long):
    folder, moments = tmp_path / "sweep", random.Random(2)
    kill_while_starting(folder, moments)
    kill_while_simulating(folder, moments)
    assert 0 < batches_done(folder) < 4 * 30
    assert_same(run(long_sweep(), folder), undisturbed_long)


@pytest.mark.slow
def test_ten_kills_in_a_row_at_random_moments(tmp_path, undisturbed_long):
    folder, moments = tmp_path / "sweep", random.Random(10)
    for number in range(10):
        (kill_while_starting if number in (0, 6) else kill_while_simulating)(folder, moments)
    assert 0 < batches_done(folder) < 4 * 30
    assert_same(run(long_sweep(), folder), undisturbed_long)
