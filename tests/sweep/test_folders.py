"""Folders in which a sweep cannot run, or not yet: one sentence says what to do; nothing is lost or written over."""

import contextlib
import errno
import importlib
import json
import os
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import jax
import pytest
from support.faults import assert_same, failing, files_in, one_sentence, run, started, sweep_of

import stickslip_jax as ss
from stickslip_jax._sweep import dataset as sweep_dataset
from stickslip_jax._sweep import store as store_module


def refused(sweep: ss.Sweep, folder: Path, *parts: str) -> str:
    """What is said about a folder in which `sweep` cannot run, and which is as before."""
    before = files_in(folder.parent)
    with pytest.raises(ss.SweepError) as error:
        run(sweep, folder)
    assert files_in(folder.parent) == before
    return one_sentence(error, str(folder), *parts)


# --- foreign folders


@pytest.mark.parametrize("name", ["thesis.tex", "log.txt", "sweep.nc", "batches/mine.txt", "data/manifest.json"])
def test_foreign_folder(tmp_path, name):
    """Also one with files that have the names of ours."""
    path = tmp_path / "sweep" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    refused(sweep_of(), tmp_path / "sweep", "holds no sweep", "choose an empty or a new folder")


def test_manifest_of_another_program(tmp_path):
    folder = tmp_path / "sweep"
    folder.mkdir()
    (folder / "manifest.json").write_text('{"name": "app", "icons": []}')
    before = files_in(folder)
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), folder)
    one_sentence(error, str(folder), "another folder")
    assert {name: data for name, data in files_in(folder).items() if name != ".lock"} == before


def test_file_for_a_folder(tmp_path):
    (tmp_path / "sweep").write_text("mine")
    refused(sweep_of(), tmp_path / "sweep", "it is a file", "choose another folder")
    refused(sweep_of(), tmp_path / "sweep" / "below", "below a file", "choose another")
    with pytest.raises(ss.SweepError, match=r"holds no sweep .*; name the folder"):
        ss.Sweep.load(tmp_path / "sweep")
    with pytest.raises(ss.SweepError, match=r"holds no sweep .*; name the folder"):
        ss.Sweep.load(tmp_path / "missing")


# --- folders that cannot be written


@contextlib.contextmanager
def without_rights():
    """As a user who may write nothing of root's, where the tests run as root."""
    if os.geteuid():
        yield
        return
    importlib.import_module("email.policy")  # is loaded late, which fails where Python is root's too
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def public_folder():
    """One whose parents every user may enter."""
    folder = Path(tempfile.mkdtemp(prefix="stickslip-test-"))
    folder.chmod(0o755)
    yield folder
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o755)
    shutil.rmtree(folder)


def test_no_permission(whole, public_folder):
    """For a new folder, for one with a sweep, and for one that cannot even be read."""
    sweep, there = sweep_of(), Path(shutil.copytree(whole[0], public_folder / "sweep"))
    (there / ".lock").unlink()
    before = files_in(public_folder)
    for path in (public_folder, there, there / "batches"):
        path.chmod(0o555)
    with without_rights():
        for folder in (there, public_folder / "new"):
            with pytest.raises(ss.SweepError) as error:
                run(sweep, folder)
            one_sentence(error, str(folder), "Permission denied", "choose another folder, or make it writable")
        assert ss.Sweep.load(there).points == 2
    there.chmod(0o000)
    with without_rights():
        with pytest.raises(ss.SweepError) as error:
            run(sweep, there)
        one_sentence(error, str(there), "Permission denied")
        with pytest.raises(ss.SweepError, match=r"cannot be read \(Permission denied\); make it readable\."):
            ss.Sweep.load(there)
    there.chmod(0o755)
    assert files_in(public_folder) == before


def test_batch_that_cannot_be_read(whole, public_folder):
    folder = Path(shutil.copytree(whole[0], public_folder / "sweep"))
    path = min((folder / "batches").iterdir())
    for entry in (folder, folder / "batches", *folder.iterdir()):
        entry.chmod(0o777)
    path.chmod(0o000)
    with without_rights():
        with pytest.raises(ss.SweepError) as error:
            run(sweep_of(), folder)
        one_sentence(error, str(path), "Permission denied", "make it readable")
    path.chmod(0o644)
    assert_same(run(sweep_of(), folder), whole[1])


# --- full disks


@contextlib.contextmanager
def small_disk(folder: Path):
    """A disk of 40 kB at `folder`, and the function that makes room; else, files of at most 1 kB."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=40k", "tmpfs", folder]
    mounted = subprocess.run(mount, capture_output=True, check=False)
    if mounted.returncode == 0:
        try:
            yield lambda: subprocess.run(["mount", "-o", "remount,size=8m", folder], check=True)
        finally:
            subprocess.run(["umount", "-l", folder], check=True)
        return
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield lambda: resource.setrlimit(resource.RLIMIT_FSIZE, before)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk(tmp_path, whole):
    with small_disk(tmp_path / "disk") as make_room:
        folder = tmp_path / "disk" / "sweep"
        for _ in range(2):  # still full the second time
            with pytest.raises(ss.SweepError) as error:
                run(sweep_of(), folder)
            one_sentence(error, str(folder), "cannot be written", "make room", "what is done is kept")
            assert not list(folder.rglob("*.unfinished"))
        make_room()
        assert_same(run(sweep_of(), folder), whole[1])
        assert set(files_in(folder)) == set(files_in(whole[0]))


@pytest.mark.slow
@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_disk_that_is_full_at_any_operation(tmp_path, whole, monkeypatch, every):
    """Whatever is being written: nothing is half-written, and the same call ends as if nothing had been."""
    monkeypatch.setattr(sweep_dataset, "as_netcdf", lambda dataset, packing: bytes(10_000))  # takes most time
    said, operations, at = [], 1, 1 - every
    while at + every <= operations:
        at, operations, folder = at + every, 0, tmp_path / str(at)

        def fail(number, name, of, last=at):
            nonlocal operations
            operations = max(operations, last, number)
            if number == last:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with failing(folder, fail):
            try:
                run(sweep_of(), folder)
            except ss.SweepError as error:
                said.append(str(error))
                operations = at + every
                assert not list(folder.rglob("*.unfinished"))
        assert_same(run(sweep_of(), folder), whole[1])
        assert set(files_in(folder)) == set(files_in(whole[0]))
    assert at + every > 9 + 4 + 19
    assert len(said) >= (9 + 9) // every
    assert all("make room, and run again" in message for message in said)


@pytest.mark.parametrize("code", [errno.EDQUOT, errno.EFBIG])
def test_other_errors_of_full_disks(tmp_path, code):
    def fail(number, name, of):
        if name == "fsync":
            raise OSError(code, os.strerror(code))

    with failing(tmp_path / "sweep", fail), pytest.raises(ss.SweepError) as error:
        run(sweep_of(), tmp_path / "sweep")
    one_sentence(error, os.strerror(code), "make room, and run again")


# --- other sweeps, versions and runs


OTHER = {
    "t1": ({"t1": 21.0}, "t1: 20.0 there, 21.0 here"),
    "key": ({"key": jax.random.key(1)}, "key: [0, 0] there, [0, 1] here"),
    "keep": ({"keep": "statistics"}, 'keep: "totals" there, "statistics" here'),
    "orders": ({"orders": 5}, "orders and count_initial_rest: [10, false] there, [5, false] here"),
    "mass": ({"system": ss.MassSpring(2.0, 4.0, 1.0, ss.Coulomb(1.0))}, "system.mass: 1.0 there, 2.0 here"),
    "friction": ({"system": ss.MassSpring(1.0, 4.0, 1.0, ss.Stribeck(1.0, 1.5, 0.1))}, "friction: Coulomb there"),
    "law": ({"law": ss.SquareWave(1.0, 2.0), "key": None}, "law: PoissonSwitching there, SquareWave here"),
    "rate": ({"law": ss.PoissonSwitching(1.0, 2.0)}, "law.rate: 1.0 there, 2.0 here"),
    "y0": ({"y0": (0.0, 2.0)}, "y0: [0.0, 1.0] there, [0.0, 2.0] here"),
    "method": ({"method": ss.Regularized(1e-3)}, "method: Exact there, Regularized here"),
    "option of the method": ({"method": ss.Exact(max_steps=500)}, "method.max_steps: null there, 500 here"),
    "random numbers": ({"independent": True}, "independent: false there, true here"),
    "parameters": ({"over": {"rate": [0.5, 1.0]}}, "parameters: mu there, rate here"),
    "fewer samples": ({"samples": 300}, "500 samples of each point; ask for at least as many"),
}


@pytest.mark.parametrize("case", OTHER)
def test_other_sweep(whole, case):
    changes, said = OTHER[case]
    refused(sweep_of(**changes), whole[0], said, "choose another folder")


def test_other_precision(whole):
    try:
        jax.config.update("jax_enable_x64", False)
        with pytest.warns(UserWarning, match="float32"):
            sweep = sweep_of()
        with pytest.warns(UserWarning, match="float32"):
            refused(sweep, whole[0], 'dtype: "float64" there, "float32" here', "choose another folder")
    finally:
        jax.config.update("jax_enable_x64", True)
    with pytest.raises(ss.SweepError, match="in float32, and JAX is set to float64; call"):
        run(sweep, whole[0])


@pytest.mark.parametrize("program", ["stickslip_jax", "jax", "jaxlib"])
def test_other_version_of_a_program(whole, program, monkeypatch):
    versions = store_module.encoding.versions()
    changed = versions | {program: "99.0"}
    monkeypatch.setattr(store_module.encoding, "versions", lambda: changed)
    refused(sweep_of(), whole[0], f'{program}: "{versions[program]}" there, "99.0" here', "choose another folder")


def test_store_of_a_newer_version(whole, tmp_path):
    folder = Path(shutil.copytree(whole[0], tmp_path / "sweep"))
    newer = json.loads((folder / "manifest.json").read_text())["body"]
    newer |= {"format_version": 99, "versions": newer["versions"] | {"stickslip_jax": "7.1"}}
    for name in ("manifest.json", "manifest-copy.json"):
        (folder / name).write_text(store_module._text(newer))
    refused(sweep_of(), folder, "format 99, written by stickslip_jax 7.1", "install that version or a newer one")
    with pytest.raises(ss.SweepError, match=r"install that version or a newer one\."):
        ss.Sweep.load(folder)


def test_numbers_written_otherwise_are_the_same_sweep(whole, tmp_path):
    """1 and 1.0: nothing is simulated again, and no batch is taken for one of another sweep."""
    folder = Path(shutil.copytree(whole[0], tmp_path / "sweep"))
    before = files_in(folder)
    sweep = sweep_of(ss.MassSpring(1, 4, 1, ss.Coulomb(1.0)), y0=(0, 1))
    dataset = run(sweep, folder)
    assert all((dataset[name].values == whole[1][name].values).all() for name in ("stick_fraction", "samples"))
    after = files_in(folder)
    assert {name for name in before if before[name] != after[name]} <= {"log.txt", "sweep.nc"}


@pytest.mark.slow
def test_two_runs_at_once(tmp_path):
    """Of two processes: the second one says so, and the first goes on."""
    folder = tmp_path / "sweep"
    process = started("long", folder)
    try:
        while not (folder / "log.txt").exists():
            assert process.poll() is None, process.communicate()
            time.sleep(0.002)
        process.send_signal(signal.SIGSTOP)  # stopped, so that it cannot be done before the second one asks
        before = files_in(folder)
        with pytest.raises(ss.SweepError) as error:
            run(sweep_of(), folder)
        one_sentence(error, str(folder), "in use by another run", "wait for it to end, or choose another folder")
        assert files_in(folder) == before
        process.send_signal(signal.SIGCONT)
        while not len((folder / "log.txt").read_bytes()) > len(before["log.txt"]):
            assert process.poll() is None, process.communicate()
            time.sleep(0.002)
    finally:
        process.kill()
        process.communicate()
