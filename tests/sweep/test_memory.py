"""Sweeps whose workers run out of memory: that is said, what is stored is kept, and a run with more memory goes on."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.faults import TESTS, assert_same, log_of, one_sentence, run, sweep_of

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax._sweep import batches
from stickslip_jax._sweep.batches import Failed, NoMemory, Task, outcome_of, perform_sent, sent
from stickslip_jax._sweep.dataset import status_of


def no_memory(message: str = "") -> MemoryError:
    """What NumPy raises, caught; with a message, what Python does."""
    if message:
        return MemoryError(message)
    try:
        np.ones(2**59)
    except MemoryError as error:
        return error
    raise AssertionError


EXHAUSTED = "RESOURCE_EXHAUSTED: Out of memory allocating 1099511627776 bytes."


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (MemoryError(), NoMemory("MemoryError")),
        (MemoryError("std::bad_alloc"), NoMemory("MemoryError: std::bad_alloc")),
        (RuntimeError(EXHAUSTED), NoMemory(f"RuntimeError: {EXHAUSTED}")),
        (RuntimeError("can't start new thread"), NoMemory("RuntimeError: can't start new thread")),
        (OSError(12, "Cannot allocate memory"), NoMemory("OSError: [Errno 12] Cannot allocate memory")),
        (ValueError("No such\npoint."), Failed("No such point.")),
        (ValueError(), Failed("ValueError")),
        (RuntimeError(), Failed("RuntimeError")),
        (OSError(2, "No such file"), Failed("FileNotFoundError: [Errno 2] No such file")),
    ],
)
def test_reason_of_a_failure_is_never_empty(error, outcome):
    assert outcome_of(error) == outcome


def starving(monkeypatch, may_begin):
    """Let the work of a task begin where `may_begin` says so; else its memory runs out. Returns the tasks tried."""
    perform, tried = batches.perform, []

    def hungry(plan, task):
        tried.append(task)
        if not may_begin(task, tried):
            raise no_memory()
        return perform(plan, task)

    monkeypatch.setattr(batches, "perform", hungry)
    return tried


def test_batch_without_memory_is_done_again_with_fewer_at_a_time(tmp_path, monkeypatch):
    """The numbers are the same: the size of a batch, which decides the last digits, stays as it is."""
    wanted = run(sweep_of(), tmp_path / "wanted")
    tried = starving(monkeypatch, lambda task, tried: tried.count(task) > 1 or task.first == 0)
    assert_same(run(sweep_of(), tmp_path / "sweep"), wanted)
    assert len(tried) == 6
    log = log_of(tmp_path / "sweep")
    assert log.count("no memory for mu = ") == 2
    assert "MemoryError: Unable to allocate" in log
    assert "it is done again, with at most 1 at a time" in log
    assert "FAILED" not in log


def test_no_memory_even_alone(tmp_path, monkeypatch):
    """No point has failed: the sweep is not finished, the others are done, and a run with more memory does the rest."""
    wanted, folder = run(sweep_of(), tmp_path / "wanted"), tmp_path / "sweep"
    with monkeypatch.context() as patch:
        starving(patch, lambda task, tried: task.point == 0)
        with pytest.raises(ss.SweepError) as error:
            run(sweep_of(), folder)
        one_sentence(
            error, "There was no memory for batches of 1 of 2 points, even one at a time, first mu = 1: samples 0 to",
            "MemoryError: Unable to allocate 4.00 EiB", f"what is done is kept in {folder}", "more memory",
        )  # fmt: skip
        status = status_of(folder)
        assert (status.complete, status.samples, status.is_finished) == (1, 500, False)
        assert "FAILED" not in log_of(folder)
        with pytest.raises(ss.SweepError) as error:
            sweep_of().run(threads=2, progress=False)
        one_sentence(error, "There was no memory", "give a folder")
    assert_same(run(sweep_of(), folder), wanted)


@pytest.mark.slow
def test_fewer_and_fewer_at_a_time(tmp_path, monkeypatch):
    """Eight threads, and memory for two: what goes on together decreases once for all that failed together."""
    inside, most = [], []

    def may_begin(task, tried):
        most.append(len(inside))
        return len(inside) <= 2

    perform = batches.perform

    def counted(plan, task):
        inside.append(task)
        try:
            return perform(plan, task)
        finally:
            inside.remove(task)

    monkeypatch.setattr(batches, "perform", counted)
    starving(monkeypatch, may_begin)
    sweep = sweep_of(samples=30 * 256)
    dataset = sweep.run(tmp_path / "sweep", threads=8, progress=False)
    assert (dataset["samples"] == 30 * 256).all()
    assert max(most[-30:]) <= 3


def test_worker_without_memory_sends_that_back(monkeypatch):
    def hungry(plan, task):
        raise no_memory("std::bad_alloc")

    monkeypatch.setattr(batches, "perform", hungry)
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(perform_sent, sent(sweep_of().plan), Task(0, 0, 10)).result()
    assert found == NoMemory("MemoryError: std::bad_alloc")


def test_command_without_memory(tmp_path, monkeypatch, capsys):
    def hungry(*_):
        raise MemoryError

    monkeypatch.setattr("stickslip_jax.study._commands.run", hungry)
    assert cli.main(["sweep", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert said.startswith("stickslip: There is not enough memory (MemoryError); what is done is kept, and the same")
    assert said.count("\n") == 1


PROCESSES = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
from stickslip_jax import SweepError
from stickslip_jax._sweep import batches
from sweep.test_memory import hungry_process
from support.faults import sweep_of
batches.perform_in_process = hungry_process
try:
    sweep_of().run(sys.argv[1], workers=2, progress=False)
except SweepError as error:
    print(error)
"""


def hungry_process(task):
    """In place of `perform_in_process`."""
    raise no_memory()


@pytest.mark.slow
def test_processes_without_memory(tmp_path):
    """The error comes over from processes of their own, and is not empty."""
    paths = os.pathsep.join([str(TESTS), str(TESTS.parent)])
    done = subprocess.run(
        [sys.executable, "-c", PROCESSES, str(tmp_path / "sweep")], env=os.environ | {"PYTHONPATH": paths},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "There was no memory for batches of 2 of 2 points" in done.stdout
    assert "MemoryError: Unable to allocate" in done.stdout
