"""Sweeps on clusters of dask.distributed: the same numbers, whatever becomes of workers, scheduler and client."""

import itertools
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import dask
import numpy as np
import pytest
from distributed import Client, LocalCluster
from support.faults import log_of, wait_for
from support.sweep import assert_same, small_sweep

import stickslip_jax as ss
from stickslip_jax._sweep import run as running
from stickslip_jax._sweep.batches import perform

DOCUMENT = Path(__file__).parents[2] / "docs" / "clusters.md"


@pytest.fixture(scope="module")
def undisturbed():
    return small_sweep().run(threads=2)


@contextmanager
def one_process():
    """A client of a cluster of one worker process with one thread, and a thread to run a sweep in."""
    with (
        local_cluster(threads_per_worker=1, processes=True) as cluster,
        Client(cluster) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        yield client, pool


@pytest.fixture(scope="module")
def client():
    """A cluster of one worker with two threads, in this process."""
    with local_cluster(processes=False) as cluster, Client(cluster) as connected:
        yield connected


def local_cluster(**options) -> LocalCluster:
    options = {"n_workers": 1, "threads_per_worker": 2, "dashboard_address": ":0", **options}
    return LocalCluster(**options)


def tasks_of(client) -> dict:
    """The tasks that the scheduler knows."""
    return client.run_on_scheduler(
        lambda dask_scheduler: {str(key): task.state for key, task in dask_scheduler.tasks.items()}
    )


# --- the same numbers


@pytest.mark.slow
@pytest.mark.parametrize("shared", [False, True])
def test_cluster_gives_the_same_bits_and_keeps_nothing(client, undisturbed, tmp_path, shared):
    found = small_sweep().run(tmp_path, executor=client, shared_folder=shared)
    assert_same(found, undisturbed)
    assert log_of(tmp_path).count("done ") == 12
    wait_for(lambda: not tasks_of(client))  # results and plan are released


@pytest.mark.slow
@pytest.mark.parametrize("shared", [False, True])
def test_few_bytes_come_back_and_few_tasks_are_under_way(client, monkeypatch, tmp_path, shared):
    """At most two for each thread; a batch, or one number where the worker has written it."""
    most, sizes, result = [], [], running.DaskCluster.result

    def noted(self, task, future):
        most.append(len(self.tasks) + 1)  # with that which is done
        found = result(self, task, future)
        sizes.append(len(found) if isinstance(found, bytes) else len(str(found)))
        return found

    monkeypatch.setattr(running.DaskCluster, "result", noted)
    small_sweep().run(tmp_path, executor=client, shared_folder=shared)
    assert len(sizes) == 12
    assert max(most) == 4
    assert max(sizes) < (100 if shared else 500_000)


@pytest.mark.slow
def test_large_plan_is_sent_once_in_small_parts(client, monkeypatch):
    """A recorded motion of a million instants, 16 MB: dask warns, which is an error here, about tasks of 10 MB."""
    sent_at, send = [], running.DaskCluster._send
    monkeypatch.setattr(running.DaskCluster, "_send", lambda self: sent_at.append(1) or send(self))
    monkeypatch.setattr("stickslip_jax._sweep.batches.perform", _perform_little)
    times = np.linspace(0.0, 20.0, 1_000_001)
    motion = ss.Recorded(times, np.sin(times))
    sweep = ss.Sweep(
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), motion, over={"mu": [0.5, 1.0, 1.5]}, t1=1.0, samples=1,
        keep="totals",
    )  # fmt: skip
    with pytest.raises(ss.SweepError, match=r"3 of 3 points failed, first mu = 0\.5: 1000001 instants"):
        sweep.run(executor=client)
    assert sent_at == [1]


def _perform_little(plan, task):
    raise ValueError(f"{len(plan.setting.law.times)} instants came.")


@pytest.mark.slow
def test_two_sweeps_at_once_on_one_worker_do_not_mix(client, undisturbed):
    other = small_sweep(over={"mu": [0.6, 0.9], "rate": [0.4, 0.8]})
    wanted = other.run(threads=1)
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(sweep.run, executor=client) for sweep in (small_sweep(), other)]
        assert_same(both[0].result(), undisturbed)
        assert_same(both[1].result(), wanted)


# --- what goes wrong


@pytest.mark.slow
def test_point_that_cannot_be_simulated_is_a_failed_point(client, monkeypatch, tmp_path):
    def failing(plan, task):
        if task.point == 1:
            raise ValueError("Nothing moves here.")
        return perform(plan, task)

    monkeypatch.setattr("stickslip_jax._sweep.batches.perform", failing)
    with pytest.raises(ss.SweepError, match=r"1 of 4 points failed, first mu = 0\.5, rate = 1: Nothing moves here;"):
        small_sweep().run(tmp_path, executor=client)
    assert log_of(tmp_path).count("FAILED") == 3  # once each, without retries
    assert log_of(tmp_path).count("done ") == 9


@pytest.mark.slow
def test_errors_that_may_pass_are_tried_again(client, undisturbed, monkeypatch):
    tried = []

    def failing_first(plan, task):
        tried.append(task)
        if tried.count(task) <= 3:
            raise RuntimeError("Out of memory for a moment.")
        return perform(plan, task)

    monkeypatch.setattr("stickslip_jax._sweep.batches.perform", failing_first)
    assert_same(small_sweep().run(executor=client), undisturbed)
    assert len(tried) == 4 * 12


def test_folder_that_workers_do_not_share_is_refused(client, monkeypatch, tmp_path):
    def not_there(folder):
        raise ss.SweepError(f"{folder} holds no sweep")

    monkeypatch.setattr("stickslip_jax._sweep.store.Store.reading", not_there)
    with pytest.raises(
        ss.SweepError, match=r"holds no sweep\) there; leave shared_folder out unless the folder is the same"
    ):
        small_sweep().run(tmp_path, executor=client, shared_folder=True)


def test_file_of_a_worker_that_is_not_seen_here_is_told(client, monkeypatch, tmp_path):
    monkeypatch.setattr(running, "_VISIBLE", 0.0)
    monkeypatch.setattr(running, "write_whole", lambda path, data: None)
    with pytest.raises(ss.SweepError, match=r"which a worker has written, is not in .* leave shared_folder out"):
        small_sweep().run(tmp_path, executor=client, shared_folder=True)


def test_client_of_coroutines_is_refused(annotations_unchecked):
    class Asynchronous:
        asynchronous = True
        submit = nthreads = print

    with pytest.raises(ValueError, match="asynchronous=True was given; make it without"):
        small_sweep().run(executor=Asynchronous())


@pytest.mark.slow
def test_client_closed_in_the_middle_is_told_and_another_goes_on(undisturbed, tmp_path):
    with local_cluster(processes=False) as cluster:
        first = Client(cluster)
        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(small_sweep().run, tmp_path, executor=first)
            wait_for(lambda: "done " in log_of(tmp_path))
            first.close()
            said = f"The connection to the cluster was lost; .* kept in {re.escape(str(tmp_path))}. Connect a new"
            with pytest.raises(ss.SweepError, match=said):
                running.result()
        before = log_of(tmp_path).count("done ")
        with Client(cluster) as second:
            assert_same(small_sweep().run(tmp_path, executor=second), undisturbed)
    assert log_of(tmp_path).count("done ") == 12
    assert 0 < before < 12


def test_client_closed_between_the_check_and_a_task_is_told(tmp_path, monkeypatch):
    with local_cluster(processes=False) as cluster:
        client = Client(cluster)
        submit, calls = client.submit, itertools.count()

        def closed_in_the_middle(*task, **options):
            if next(calls) == 4:
                client.close()
            return submit(*task, **options)

        monkeypatch.setattr(client, "submit", closed_in_the_middle)
        with pytest.raises(ss.SweepError, match=r"The connection to the cluster was lost; .* Connect a new"):
            small_sweep().run(tmp_path, executor=client)


def pids_of_workers(client) -> list[int]:
    return list(client.run(os.getpid).values())


@pytest.mark.slow
@pytest.mark.parametrize("shared", [False, True])
def test_killed_worker_of_a_cluster_changes_nothing(tmp_path, shared):
    """Its nanny starts another; the only worker here, so that the plan is lost with it and made again."""
    sweep = small_sweep(samples=40_000)
    with one_process() as (client, pool):
        running = pool.submit(sweep.run, tmp_path, executor=client, shared_folder=shared)
        for batches in (3, 20):
            wait_for(lambda batches=batches: log_of(tmp_path).count("done ") >= batches)
            (pid,) = pids_of_workers(client)
            os.kill(pid, signal.SIGKILL)
        found = running.result()
    assert_same(found, sweep.run(threads=2))


@pytest.mark.slow
def test_restart_of_the_cluster_changes_nothing(tmp_path, undisturbed):
    with one_process() as (client, pool):
        running = pool.submit(small_sweep().run, tmp_path, executor=client)
        wait_for(lambda: "done " in log_of(tmp_path))
        client.restart()
        found = running.result()
    assert "cancelled" in log_of(tmp_path)
    assert_same(found, undisturbed)


@pytest.mark.slow
def test_batch_that_kills_its_workers_is_told(tmp_path):
    """The scheduler gives up after some deaths; here after the first."""
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), one_process() as (client, pool):
        running = pool.submit(small_sweep(samples=40_000).run, tmp_path, executor=client)
        wait_for(lambda: "done " in log_of(tmp_path))
        (pid,) = pids_of_workers(client)
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(ss.SweepError, match="Workers of the cluster died 1 times with the same batch, the last"):
            running.result()
    assert "done " in log_of(tmp_path)


SCHEDULER = """
import time
from distributed import LocalCluster
if __name__ == "__main__":
    options = {"processes": False, "protocol": "tcp://", "dashboard_address": ":0"}
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, **options)
    print(cluster.scheduler_address, flush=True)
    time.sleep(600)
"""


@contextmanager
def _killed(process):
    """Kills a process at the end at the latest, so that nothing waits for it in vain."""
    try:
        yield
    finally:
        process.kill()


@pytest.mark.slow
def test_killed_scheduler_is_told_and_what_came_is_kept(tmp_path):
    scheduler = subprocess.Popen([sys.executable, "-c", SCHEDULER], stdout=subprocess.PIPE, text=True)
    with (
        scheduler,
        _killed(scheduler),
        Client(scheduler.stdout.readline().strip()) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        running = pool.submit(small_sweep(samples=40_000).run, tmp_path, executor=client)
        wait_for(lambda: "done " in log_of(tmp_path))
        scheduler.kill()
        with pytest.raises(ss.SweepError, match=r"The connection to the cluster was lost; .* goes on from there"):
            running.result()
    assert_same(small_sweep(samples=40_000).run(tmp_path, threads=2), small_sweep(samples=40_000).run(threads=2))


# --- the document


def test_example_for_slurm_runs_on_another_cluster(tmp_path):
    """The script of docs/clusters.md, with a cluster on this machine in place of that of SLURM."""
    (code,) = re.findall(r"```python\n(# sweep_on_slurm\.py\n.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    names: dict = {"__name__": "sweep_on_slurm"}
    exec(code, names)
    with local_cluster(processes=False) as cluster:
        dataset = names["run_on"](cluster, tmp_path, shared_folder=True, samples=500)
    assert_same(dataset, names["sweep"](500).run(threads=2))
