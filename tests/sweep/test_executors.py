"""The same numbers wherever a sweep runs on this machine, and what happens when its processes die."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import psutil
import pytest
from support.faults import log_of, wait_for
from support.sweep import POINTS, assert_same, small_sweep

import stickslip_jax as ss
from stickslip_jax._ensemble.encoding import versions
from stickslip_jax._sweep.batches import Failed, Task, perform_sent, sent, warnings_by_thread

SUPPORT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def undisturbed():
    return small_sweep().run(threads=1)


def script(text: str) -> str:
    return "import jax\njax.config.update('jax_enable_x64', True)\n" + textwrap.dedent(text)


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(SUPPORT.parent), str(SUPPORT)])}


# --- the same numbers


@pytest.mark.slow
def test_two_threads_give_the_same_bits(undisturbed):
    assert_same(small_sweep().run(threads=2), undisturbed)


@pytest.mark.slow
def test_order_of_the_points_changes_nothing(undisturbed):
    over = {name: values[::-1] for name, values in POINTS.items()}
    found = small_sweep(over=over).run(threads=2)
    assert_same(found.sortby(["mu", "rate"]), undisturbed)


@pytest.mark.slow
def test_size_of_the_batches_changes_means_by_round_off_and_counts_not_at_all(undisturbed):
    """Two orders of adding n numbers x differ by at most 2 n u sum|x| (Higham, Accuracy and Stability, eq. 4.4), where
    sum|x| is at most n times the root of their mean square.
    """
    found = small_sweep(batch=700).run(threads=2)
    whole = [name for name in undisturbed.data_vars if undisturbed[name].dtype.kind in "iu"]
    histograms = [name for name in undisturbed.data_vars if name.endswith(("_density", "_entropy", "_quantile"))]
    assert "duration_count_in_bin" in whole
    for name in (*whole, *histograms, *undisturbed.coords):
        np.testing.assert_array_equal(found[name], undisturbed[name], err_msg=name, strict=True)
    means = [name for name in undisturbed.data_vars if name.endswith("_mean")]
    assert len(means) == 8
    unit = np.finfo(float).eps / 2
    for name in means:
        quantity = name.removesuffix("_mean")
        counts = undisturbed[f"{quantity}_count_in_bin"].sum(f"{quantity}_bin")
        size = np.hypot(undisturbed[name], undisturbed[f"{quantity}_standard_deviation"])
        assert np.all(np.abs(found[name] - undisturbed[name]) <= 2 * counts * unit * size), name


@pytest.mark.slow
def test_two_processes_give_the_same_bits(undisturbed, tmp_path):
    """Started by a program from standard input, without ``if __name__ == "__main__"``, which they do not run again."""
    program = script(f"""
        print("begun")
        from support.sweep import small_sweep
        small_sweep().run({str(tmp_path)!r}, workers=2)
        """)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-"], input=program, env=environment(), capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "begun\n", "")
    found = ss.Sweep.load(tmp_path).run(tmp_path, threads=1)
    assert log_of(tmp_path).count("done ") == 12
    assert_same(found, undisturbed)


TWO_DEVICES = """
    import json, sys
    import numpy as np
    from support.sweep import small_sweep
    from stickslip_jax._sweep import batches
    used, perform = [], batches.perform

    def noted(plan, task):
        (device,) = jax.numpy.zeros(()).devices()
        used.append(device.id)
        return perform(plan, task)

    batches.perform = noted
    small_sweep(sensitivities=[("mean_stick_duration", "mu")] if SENSITIVITIES else ()).run(sys.argv[1], threads=2)
    print(sorted(used))
    """


@pytest.mark.slow
@pytest.mark.parametrize("sensitivities", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_two_devices_share_the_batches_and_give_the_same_bits(undisturbed, tmp_path, sensitivities):
    done = subprocess.run(
        [sys.executable, "-c", script(TWO_DEVICES).replace("SENSITIVITIES", str(sensitivities)), str(tmp_path)],
        env={**environment(), "XLA_FLAGS": "--xla_force_host_platform_device_count=2"},
        capture_output=True, text=True, timeout=400, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    each = 8 if sensitivities else 6
    assert done.stdout == f"{[0] * each + [1] * each}\n"
    found = ss.Sweep.load(tmp_path).run(tmp_path, threads=1)
    wanted = undisturbed
    if sensitivities:
        wanted = small_sweep(sensitivities=[("mean_stick_duration", "mu")]).run(threads=1)
    assert_same(found, wanted)


# --- bad arguments, bad points, bad workers


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"threads": 1, "workers": 2}, "Arguments threads and workers must not both be given"),
        ({"workers": 0}, "Argument workers must be a whole number of at least 1, but 0"),
        ({"threads": 0}, "Argument threads must be a whole number of at least 1, but 0"),
        ({"executor": 3}, "Argument executor must be a dask.distributed.Client, but 3 was given"),
        ({"shared_folder": True}, "Argument shared_folder must be True only with folder and executor, but executor"),
        ({"executor": 3, "shared_folder": True}, "only with folder and executor, but a folder was not given"),
        ({"shared_folder": 1}, "Argument shared_folder must be True or False, but 1"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(annotations_unchecked, arguments, said):
    with pytest.raises(ValueError, match=said):
        small_sweep().run(**arguments)


def test_worker_with_other_versions_is_refused():
    """Another version of JAX may give other numbers."""
    sweep = sent(small_sweep().plan)
    assert dict(sweep.versions) == versions()
    other = sweep._replace(versions=tuple({**dict(sweep.versions), "jax": "0.0.1"}.items()))
    with pytest.raises(ss.SweepError, match=r"has jax .* instead of 0\.0\.1.*install the same versions"):
        perform_sent(other, Task(0, 0, 10))


def test_worker_without_the_users_module_is_refused():
    sweep = sent(small_sweep().plan)
    unknown = sweep._replace(plan=b"cnobody_has_this_module\nLaw\n.")
    with pytest.raises(ss.SweepError, match=r"cannot read the sweep .*must be installed"):
        perform_sent(unknown, Task(0, 0, 10))


def test_points_that_fail_come_back_as_their_reason(monkeypatch):
    def failing(plan, task):
        raise ValueError("No such point.")

    monkeypatch.setattr("stickslip_jax._sweep.batches.perform", failing)
    assert perform_sent(sent(small_sweep().plan), Task(0, 0, 10)) == Failed("No such point.")


def test_two_precisions_in_one_process_do_not_mix(monkeypatch):
    """As of two sweeps on one worker of a cluster: precision is of the whole process, and its threads are several."""

    def precision(plan, task):
        before = jnp.result_type(float)
        time.sleep(0.01)
        return f"{before} {jnp.result_type(float)}".encode()

    monkeypatch.setattr("stickslip_jax._sweep.batches.perform", precision)
    sweep = sent(small_sweep().plan)
    try:
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(lambda n: perform_sent(sweep._replace(double=n % 3 > 0), Task(n, 0, 10)), range(30)))
    finally:
        jax.config.update("jax_enable_x64", True)
    assert found == [b"float64 float64" if n % 3 else b"float32 float32" for n in range(30)]


def test_threads_that_collect_warnings_give_back_the_filters():
    """The first to come need not be the last to go; filters of warnings are of the whole process."""
    filters, show = list(warnings.filters), warnings.showwarning
    inside, go = threading.Event(), threading.Event()

    def other():
        with warnings_by_thread():
            inside.set()
            go.wait()

    thread = threading.Thread(target=other)
    with warnings_by_thread():
        thread.start()
        inside.wait()
    assert warnings.showwarning is not show
    go.set()
    thread.join()
    assert (list(warnings.filters), warnings.showwarning) == (filters, show)


# --- processes that die

RUN = """
    import sys
    from support.sweep import small_sweep
    try:
        small_sweep(samples=40_000).run(sys.argv[1], workers=2)
    except KeyboardInterrupt as stopped:
        print(str(stopped) or "at once")
    """


def start(folder) -> subprocess.Popen:
    """A longer sweep on two processes, as a program with a terminal of its own."""
    return subprocess.Popen(
        [sys.executable, "-c", script(RUN), str(folder)], env=environment(), stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def workers_of(program: subprocess.Popen) -> list[psutil.Process]:
    """The worker processes of a program that runs."""
    children = psutil.Process(program.pid).children(recursive=True)
    return [child for child in children if "resource_tracker" not in " ".join(child.cmdline())]


def begun(folder, batches: int):
    return lambda: log_of(folder).count("done ") >= batches


@pytest.mark.slow
def test_killed_worker_of_a_pool_changes_nothing(tmp_path):
    program = start(tmp_path)
    wait_for(begun(tmp_path, 3))
    workers_of(program)[0].kill()
    out, err = program.communicate(timeout=500)
    assert (program.returncode, out) == (0, ""), err
    assert "a worker died" in log_of(tmp_path)
    found = ss.Sweep.load(tmp_path).run(tmp_path, threads=1)
    assert_same(found, small_sweep(samples=40_000).run(threads=2))


@pytest.mark.slow
@pytest.mark.parametrize("signals", [1, 2])
def test_ctrl_c_ends_program_and_workers(tmp_path, signals):
    """A terminal sends the signal to all processes of the program."""
    program = start(tmp_path)
    wait_for(begun(tmp_path, 1))
    workers = workers_of(program)
    assert len(workers) == 2
    for _ in range(signals):
        os.killpg(program.pid, signal.SIGINT)
        time.sleep(0.5)
    out, err = program.communicate(timeout=300)
    assert program.returncode == 0, err
    assert err.count("Stopping after the batches under way") == 1
    assert "Traceback" not in err
    if signals == 1:
        assert "goes on from here" in out
    else:
        assert out == "at once\n"
    assert psutil.wait_procs(workers, timeout=60)[1] == []


@pytest.mark.slow
def test_workers_end_when_their_program_is_killed(tmp_path):
    program = start(tmp_path)
    wait_for(begun(tmp_path, 1))
    workers = workers_of(program)
    program.kill()
    program.communicate()
    assert psutil.wait_procs(workers, timeout=60)[1] == []
