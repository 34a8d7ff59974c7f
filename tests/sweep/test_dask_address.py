"""``--dask ADDRESS``: a whole run by the command, and every address at which no scheduler answers."""

import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster
from support.faults import log_of, wait_for
from support.study import config_file
from support.sweep import assert_same, small_sweep

from stickslip_jax import SweepError
from stickslip_jax import _cli as cli
from stickslip_jax._sweep.dataset import read_dataset
from stickslip_jax.study import _run

SWEEP = """
[run]
t1 = 20.0
samples = 3000
seed = 1

[sweep]
keep = "totals"
batch = 1024

[sweep.over]
mu = [0.5, 1.0]
"""


pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


def refused(capsys, address: str) -> str:
    """What the command says about an address; nothing is begun."""
    path = config_file(Path(), SWEEP)
    assert cli.main(["sweep", str(path), "--out", "sweep", "--dask", address]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("stickslip: Option --dask must be the address of a dask scheduler, such as tcp://127.0.0.1:")
    assert err.count("\n") == 1
    assert not Path("sweep").exists()
    return err


@contextmanager
def listening(answer: bytes | None):
    """The address of something that accepts connections, and says nothing, or this."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        open_ones = []

        def serve():
            while True:
                try:
                    one, _ = server.accept()
                except OSError:
                    return
                open_ones.append(one)
                if answer is not None:
                    one.sendall(answer)
                    one.close()

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        for one in open_ones:
            one.close()


@pytest.mark.parametrize("answer", [None, b"HTTP/1.1 400 Bad Request\r\n\r\n", b""], ids=["mute", "web", "closes"])
def test_port_at_which_something_else_listens(capsys, monkeypatch, answer):
    monkeypatch.setattr(_run, "_SECONDS_TO_CONNECT", 1)
    with listening(answer) as address:
        said = refused(capsys, address)
    assert f"but {address} gave no answer (" in said
    assert "start one with `dask scheduler`" in said
    if answer is None:
        assert "(none within 1 s)" in said


def test_port_at_which_nothing_listens(capsys, monkeypatch):
    monkeypatch.setattr(_run, "_SECONDS_TO_CONNECT", 1)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    assert f"tcp://127.0.0.1:{port} gave no answer (" in refused(capsys, f"tcp://127.0.0.1:{port}")


@pytest.mark.parametrize("address", ["tls://127.0.0.1:8786", "ucx://127.0.0.1:8786", "inproc://1/2", "junk://a"])
def test_address_that_needs_a_client_of_its_own(capsys, address):
    kind = address.partition("://")[0]
    assert f"but {address} was given; {kind}:// needs a client with settings of its own" in refused(capsys, address)


@pytest.mark.parametrize("address", ["", "tcp://", "tcp://127.0.0.1:junk", "tcp://127.0.0.1:99999", "a b c"])
def test_address_that_is_none(capsys, monkeypatch, address):
    monkeypatch.setattr(_run, "_SECONDS_TO_CONNECT", 1)
    refused(capsys, address)


def test_address_of_a_worker(capsys):
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=":0"
    ) as one:
        address = one.workers[0].address
        assert f"{address} gave no answer (a Worker is there)" in refused(capsys, address)


@pytest.mark.slow
def test_whole_run_at_an_address(capsys):
    """The numbers are those of threads; sweep, more samples, and resume."""
    path = config_file(Path(), SWEEP)
    assert cli.main(["sweep", str(path), "--out", "threads", "--samples", "4000", "--threads", "2", "--quiet"]) == 0
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:
        at = ["--dask", cluster.scheduler_address]
        assert cli.main(["sweep", str(path), "--out", "sweep", *at]) == 0
        out, err = capsys.readouterr()
        assert out.count("+-") == 10
        assert err == ""
        assert cli.main(["sweep", str(path), "--out", "sweep", "--samples", "4000", "--quiet", *at]) == 0
        Path("sweep/sweep.nc").unlink()
        assert cli.main(["resume", "sweep", "--quiet", *at]) == 0
    assert capsys.readouterr() == ("", "")
    found, wanted = read_dataset(Path("sweep")), read_dataset(Path("threads"))
    assert set(found.variables) == set(wanted.variables)
    for name in set(wanted.data_vars) - {"run_seconds"}:
        if found[name].dtype.kind in "iu":  # 3000 samples end within a batch, so that sums differ by round-off
            np.testing.assert_array_equal(found[name], wanted[name], err_msg=name, strict=True)
        else:
            np.testing.assert_allclose(found[name], wanted[name], rtol=1e-12, err_msg=name)


@pytest.mark.slow
def test_whole_run_at_an_address_gives_the_same_bits(capsys):
    path = config_file(Path(), SWEEP)
    assert cli.main(["sweep", str(path), "--out", "threads", "--threads", "2", "--quiet"]) == 0
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:
        assert cli.main(["sweep", str(path), "--out", "sweep", "--quiet", "--dask", cluster.scheduler_address]) == 0
    assert_same(read_dataset(Path("sweep")), read_dataset(Path("threads")))
    assert log_of("sweep").count("done ") == 6
    assert capsys.readouterr() == ("", "")


@pytest.mark.slow
def test_scheduler_without_workers_is_told_also_when_quiet(capsys):
    """And the sweep goes on when one comes."""
    path = config_file(Path(), SWEEP)
    with LocalCluster(n_workers=0, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster:

        def add_worker():
            wait_for(lambda: "waiting" in log_of("sweep") or "waits" in log_of("sweep"), 60)
            cluster.scale(1)

        adding = threading.Thread(target=add_worker)
        adding.start()
        assert cli.main(["sweep", str(path), "--out", "sweep", "--quiet", "--dask", cluster.scheduler_address]) == 0
        adding.join()
        address = cluster.scheduler_address
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        "The cluster has no workers, and the sweep waits for them; start one with "
        f"`dask worker {address}`, or stop with Ctrl-C.\n"
    )


# --- workers whose memory is limited

HUNGRY = """
import time
import numpy as np
from stickslip_jax._sweep import batches

if not hasattr(batches, "usual"):  # dask loads this file more than once
    batches.usual = batches.perform
held = []

def hungry(plan, task):
    if task.point == 1:
        for _ in range(400):
            held.append(np.ones(2**20))
            time.sleep(0.01)
    return batches.usual(plan, task)

batches.perform = hungry
"""


@pytest.mark.slow
def test_worker_that_is_killed_by_its_memory_limit_is_told(tmp_path):
    """Its nanny kills it again and again: the batch is named, and what the others did is kept."""
    (tmp_path / "hungry.py").write_text(HUNGRY)
    sweep = small_sweep(keep="totals")
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit="1.5GB",
            preload=[str(tmp_path / "hungry.py")],
        ) as cluster,
        Client(cluster) as client,
        pytest.raises(SweepError, match=r"Workers of the cluster died \d+ times with the same batch.*Perhaps memory"),
    ):  # fmt: skip
        sweep.run(tmp_path / "sweep", executor=client)
    before = log_of(tmp_path / "sweep").count("done ")
    assert 0 < before < 12
    assert_same(sweep.run(tmp_path / "sweep", threads=2), sweep.run(threads=2))


@pytest.mark.slow
def test_workers_that_are_paused_are_told(tmp_path, capsys):
    """Python and JAX alone take more than dask lets a worker hold: it never takes a task."""
    program = subprocess.Popen(
        [sys.executable, "-c", PAUSED, str(tmp_path / "sweep")],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        wait_for(lambda: "paused" in log_of(tmp_path / "sweep"), 120)
    finally:
        program.terminate()
        time.sleep(0.1)
        program.kill()
        out, err = program.communicate()
    assert "The workers of the cluster are paused, because their memory is nearly full" in err, out


PAUSED = """
import sys
import dask
import jax
jax.config.update("jax_enable_x64", True)
from distributed import Client, LocalCluster
from stickslip_jax._sweep import run as running
import stickslip_jax as ss

if __name__ == "__main__":
    running._LONG = 1.0
    limits = {f"distributed.worker.memory.{name}": value for name, value in
              {"pause": 0.01, "terminate": False, "target": False, "spill": False}.items()}
    options = {"processes": True, "dashboard_address": ":0", "memory_limit": "4GB"}
    with (
        dask.config.set(limits),
        LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster,
        Client(cluster) as client,
    ):
        sweep = ss.Sweep(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), ss.PoissonSwitching(1.0, 1.0), over={"mu": [0.5, 1.0]},
            t1=20.0, samples=500, key=jax.random.key(0), keep="totals",
        )
        sweep.run(sys.argv[1], executor=client)
"""
