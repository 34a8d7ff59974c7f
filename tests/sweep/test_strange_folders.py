"""Folders in which something is that no sweep writes, or from which something is taken while one runs."""

import os
import shutil
import threading
from pathlib import Path

import pytest
from support.faults import assert_same, one_sentence, run, sweep_of

import stickslip_jax as ss
from stickslip_jax import _cli as cli
from stickslip_jax._sweep import batches
from stickslip_jax._sweep import run as run_module
from stickslip_jax._sweep import store as store_module
from stickslip_jax._sweep.dataset import status_of, stored_dataset

MANIFESTS = ("manifest.json", "manifest-copy.json")


def in_time(call):
    """What a call returns or raises, which must not wait for ever."""
    found = []

    def catching():
        try:
            found.append(call())
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=catching, daemon=True)
    thread.start()
    thread.join(60)
    assert found, "it waits for ever"
    if isinstance(found[0], BaseException):
        raise found[0]
    return found[0]


# --- taken away while it runs


def taking(monkeypatch, take) -> None:
    """Call `take` while the third batch is simulated."""
    perform, begun = batches.perform, []

    def taken(plan, task):
        begun.append(task)
        if len(begun) == 3:
            take()
        return perform(plan, task)

    monkeypatch.setattr(batches, "perform", taken)


def emptied(folder: Path) -> None:
    """As ``rm -r`` leaves it where a new batch comes while it works."""
    for path in folder.rglob("*"):
        if path.is_file():
            path.unlink(missing_ok=True)


TAKEN = {
    "all of it": lambda folder: shutil.rmtree(folder, ignore_errors=True),
    "all files": emptied,
    "both manifests": lambda folder: [(folder / name).unlink() for name in MANIFESTS],
    "the lock": lambda folder: (folder / ".lock").unlink(),
    "moved elsewhere": lambda folder: folder.rename(folder.with_name("elsewhere")),
}


@pytest.mark.parametrize("what", TAKEN)
def test_folder_that_is_taken_away_while_it_runs(tmp_path, monkeypatch, what):
    folder = tmp_path / "sweep"
    taking(monkeypatch, lambda: TAKEN[what](folder))
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), folder)
    said = one_sentence(
        error, f"{folder} was removed, or changed, while the sweep ran in it (", "is gone", "run it again"
    )
    if what in ("the lock", "both manifests"):
        assert f"({'.lock' if what == 'the lock' else 'manifest.json'} is gone)" in said
    assert not (folder / "sweep.nc").exists()


def test_command_in_a_folder_that_is_taken_away_fails(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("stickslip_jax.study._commands.prepare_jax", lambda dtype: None)
    folder, config = tmp_path / "sweep", tmp_path / "sweep.toml"
    config.write_text(
        '[run]\nt1 = 20.0\nsamples = 500\n[sweep]\nkeep = "totals"\nbatch = 256\n[sweep.over]\nmu = [0.5, 1.0]'
    )
    taking(monkeypatch, lambda: shutil.rmtree(folder, ignore_errors=True))
    assert cli.main(["sweep", str(config), "--out", str(folder), "--threads", "2"]) == 2
    assert "was removed, or changed, while the sweep ran" in capsys.readouterr().err


def test_batches_taken_away_while_one_is_written(tmp_path, monkeypatch):
    """What removes a folder may have come no further than to the batch that is being written."""
    folder = tmp_path / "sweep"

    def taken(path, data):
        raise FileNotFoundError(2, "No such file or directory", str(path))

    write = store_module.files.write_whole
    monkeypatch.setattr(
        store_module.files,
        "write_whole",
        lambda path, data: (taken if path.parent.name == "batches" else write)(path, data),
    )
    with pytest.raises(ss.SweepError, match=r"was removed, or changed, while the sweep ran in it \(.*\.zip is gone\)"):
        run(sweep_of(), folder)


def test_folder_taken_away_at_the_end(tmp_path, monkeypatch):
    """After the last batch, while the data set is made."""
    folder = tmp_path / "sweep"
    dataset = run_module.Results.dataset

    def taken(*arguments):
        found = dataset(*arguments)
        for name in (".lock", *MANIFESTS):
            (folder / name).unlink()
        return found

    monkeypatch.setattr(run_module.Results, "dataset", taken)
    with pytest.raises(ss.SweepError, match="was removed, or changed, while the sweep ran"):
        run(sweep_of(), folder)


# --- what is no file, and files in the place of folders


def put_pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def put_folder(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.mkdir()


@pytest.mark.slow
@pytest.mark.parametrize(("put", "kind"), [(put_pipe, "a named pipe"), (put_folder, "a folder")])
@pytest.mark.parametrize("call", [lambda folder: run(sweep_of(), folder), lambda folder: ss.Sweep.load(folder).results])
def test_batch_that_is_no_file(copied, put, kind, call):
    folder, dataset = copied
    (folder / "sweep.nc").unlink()
    path = min((folder / "batches").iterdir())
    put(path)
    with pytest.raises(ss.SweepError) as error:
        in_time(lambda: call(folder))
    one_sentence(error, f"{path} cannot be read (it is {kind}, not a file)", "remove it, and run again")
    path.unlink() if kind == "a named pipe" else path.rmdir()
    assert_same(run(sweep_of(), folder), dataset)


@pytest.mark.parametrize("name", MANIFESTS)
@pytest.mark.parametrize(("put", "kind"), [(put_pipe, "a named pipe"), (put_folder, "a folder")])
def test_manifest_that_is_no_file(copied, name, put, kind):
    folder, _ = copied
    put(folder / name)
    for call in (lambda: run(sweep_of(), folder), lambda: ss.Sweep.load(folder), lambda: status_of(folder)):
        with pytest.raises(ss.SweepError) as error:
            in_time(call)
        one_sentence(error, f"{folder / name} cannot be read (it is {kind}, not a file)", "move it elsewhere")


@pytest.mark.parametrize("put", [put_pipe, put_folder])
def test_log_and_data_set_that_are_no_files(copied, put):
    """The log is left out; reading does without the data set."""
    folder, dataset = copied
    put(folder / "log.txt")
    put(folder / "sweep.nc")
    assert_same(in_time(lambda: stored_dataset(folder)), dataset)
    if put is put_pipe:
        assert_same(in_time(lambda: run(sweep_of(), folder)), dataset)
        assert (folder / "sweep.nc").is_file()
        return
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), folder)
    one_sentence(error, str(folder), "cannot be written (Is a directory)")


@pytest.mark.parametrize("put", [put_pipe, lambda path: path.write_text("mine")])
def test_batches_that_is_no_folder(copied, put):
    folder, _ = copied
    shutil.rmtree(folder / "batches")
    put(folder / "batches")
    (folder / "sweep.nc").unlink()
    for call in (lambda: run(sweep_of(), folder), lambda: ss.Sweep.load(folder).results, lambda: status_of(folder)):
        with pytest.raises(ss.SweepError) as error:
            in_time(call)
        one_sentence(error, f"{folder / 'batches'} must be a folder", "but is a file", "move it elsewhere")
    assert not (folder / "batches").is_dir()
