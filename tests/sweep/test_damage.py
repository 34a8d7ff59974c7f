"""Folders of sweeps with damage: it is found, and mended or said in one sentence; nothing is lost."""

import io
import shutil
import zipfile
from pathlib import Path

import jax
import numpy as np
import pytest
from support.faults import assert_same, failing, files_in, log_of, one_sentence, run, sweep_of

import stickslip_jax as ss
from stickslip_jax._ensemble.encoding import DamagedFileError, parts_of_file, with_header, without_header
from stickslip_jax._foundation.files import unpacked_arrays
from stickslip_jax._sweep.dataset import Work, read_dataset
from stickslip_jax._sweep.store import Batch, Store

SENSITIVITIES = [("stick_fraction", "mu")]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with a finished sweep, which has derivatives, and its data set."""
    folder = tmp_path_factory.mktemp("whole") / "sweep"
    return folder, run(sweep_of(sensitivities=SENSITIVITIES), folder)


def batch_in(folder, kind) -> Path:
    return min((folder / "batches").glob(f"*{kind}"))


def spoilt_half(data: bytes) -> bytes:
    return data[: len(data) // 2]


def spoilt_digit(data: bytes) -> bytes:
    """JSON as before, with another digit in a number."""
    at = data.rfind(b"1")
    return data[:at] + b"2" + data[at + 1 :]


def spoilt_bit_at(share: float):
    def spoilt(data: bytes) -> bytes:
        at = int(share * (len(data) - 1))
        return data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]

    return spoilt


SPOILT = {
    "empty": lambda data: b"",
    "half": spoilt_half,
    "longer": lambda data: data + b"0",
    "another digit": spoilt_digit,
    **{f"bit at {share}": spoilt_bit_at(share) for share in (0.0, 0.01, 0.3, 0.7, 1.0)},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", [".zip", ".json"])
@pytest.mark.parametrize("how", SPOILT)
def test_damaged_batch_is_found_and_done_again(copied, how, kind):
    folder, dataset = copied
    path = batch_in(folder, kind)
    path.write_bytes(SPOILT[how](path.read_bytes()))
    assert_same(run(sweep_of(sensitivities=SENSITIVITIES), folder), dataset)
    assert f"damaged, to be done again: {path.name}" in log_of(folder)


@pytest.mark.slow
def test_batch_that_is_gone_is_done_again(copied):
    folder, dataset = copied
    for kind in (".zip", ".json"):
        batch_in(folder, kind).unlink()
    assert_same(run(sweep_of(sensitivities=SENSITIVITIES), folder), dataset)


@pytest.mark.slow
def test_reading_changes_nothing(copied):
    """Also where a batch is damaged: only the run that holds the lock may remove it."""
    folder, _ = copied
    for kind in (".zip", ".json"):
        path = batch_in(folder, kind)
        path.write_bytes(spoilt_half(path.read_bytes()))
    before = files_in(folder)
    plan = sweep_of(sensitivities=SENSITIVITIES).plan
    work = Work(plan, Store.reading(folder))
    list(work.tasks())
    found = [work.ensemble(point) for point in range(2)]
    assert sorted(0 if one is None else one.samples for one in found) == [0, 500]
    assert sorted(len(work.derivatives(point)) for point in range(2)) == [0, 1]
    assert files_in(folder) == before


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", ["manifest.json", "manifest-copy.json"])
@pytest.mark.parametrize("how", ["half", "another digit", "gone"])
def test_one_manifest_is_enough(copied, spoilt, how):
    folder, dataset = copied
    before = files_in(folder)
    if how == "gone":
        (folder / spoilt).unlink()
    else:
        (folder / spoilt).write_bytes(SPOILT[how](before[spoilt]))
    assert_same(run(ss.Sweep.load(folder), folder), dataset)
    after = files_in(folder)
    assert {name: data for name, data in after.items() if name in before and before[name] != data}.keys() <= {
        "log.txt", "sweep.nc",
    }  # fmt: skip


def test_both_manifests_damaged(copied):
    folder, _ = copied
    for name in ("manifest.json", "manifest-copy.json"):
        (folder / name).write_bytes(spoilt_half((folder / name).read_bytes()))
    before = files_in(folder)
    for call in (lambda: run(sweep_of(), folder), lambda: ss.Sweep.load(folder)):
        with pytest.raises(ss.SweepError) as error:
            call()
        one_sentence(error, str(folder), "is damaged", "into another folder")
    assert files_in(folder) == before


@pytest.mark.slow_but_for(".zip")
@pytest.mark.parametrize("kind", [".zip", ".json"])
def test_batch_of_another_sweep(copied, tmp_path, kind):
    """It is whole: nobody removes it or writes over it."""
    folder, dataset = copied
    other = tmp_path / "other"
    run(sweep_of(key=jax.random.key(1), sensitivities=SENSITIVITIES), other)
    path = batch_in(folder, kind)
    shutil.copy(other / "batches" / path.name, path)
    before = files_in(folder)
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(sensitivities=SENSITIVITIES), folder)
    one_sentence(error, str(path), "another sweep", "move it")
    assert files_in(folder) == before
    path.unlink()
    assert_same(run(sweep_of(sensitivities=SENSITIVITIES), folder), dataset)


@pytest.mark.slow
def test_a_batch_that_unpacks_without_end_is_damaged(copied, monkeypatch):
    """A few hundred kB of zeros that unpack to more than any batch takes: it is not unpacked, and done again."""
    folder, dataset = copied
    path, packed = batch_in(folder, ".zip"), io.BytesIO()
    identity, name, _ = parts_of_file(path.read_bytes())
    with zipfile.ZipFile(io.BytesIO(without_header(identity, name, path.read_bytes()))) as whole:
        head = whole.read("head.json")
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("head.json", head)
        with bomb.open("floats.npy", "w") as entry:
            np.lib.format.write_array_header_1_0(entry, {"descr": "<f8", "fortran_order": False, "shape": (2**26,)})
            for _ in range(32):
                entry.write(bytes(2**24))
    assert len(packed.getvalue()) < 2**20
    path.write_bytes(with_header(identity, name, packed.getvalue()))
    monkeypatch.setattr(np, "frombuffer", refuse_to_unpack(np.frombuffer))
    assert_same(run(sweep_of(sensitivities=SENSITIVITIES), folder), dataset)
    assert "it would unpack to 0.537 GB" in log_of(folder)


def refuse_to_unpack(usual):
    def frombuffer(data, *more, **options):
        assert len(data) < 2**24
        return usual(data, *more, **options)

    return frombuffer


def test_arrays_are_not_longer_than_what_is_there():
    """Whatever the header of an array says; and other arrays come back as they were."""
    packed, lying = io.BytesIO(), io.BytesIO()
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.zeros((0, 2)),
        "c": np.asfortranarray(np.eye(3, dtype=np.int8)),
    }
    np.savez_compressed(packed, **arrays)
    found = unpacked_arrays(packed.getvalue(), 10_000)
    assert all(
        np.array_equal(found[name], array) and found[name].dtype == array.dtype for name, array in arrays.items()
    )
    with zipfile.ZipFile(lying, "w") as archive, archive.open("a.npy", "w") as entry:
        np.lib.format.write_array_header_1_0(entry, {"descr": "<f8", "fortran_order": False, "shape": (2**50,)})
        entry.write(bytes(80))
    with pytest.raises(ValueError, match="reshape"):
        unpacked_arrays(lying.getvalue(), 10_000)


def test_leftovers_are_passed_over(copied, tmp_path):
    """Temporary files of a killed run are removed, and batches that a join left; what is not ours stays."""
    folder, dataset = copied
    names = set(files_in(folder))
    joined = batch_in(folder, ".zip")
    identity = joined.name.partition("-")[0]
    (folder / "batches" / f"{identity}-0-256.zip").write_bytes(b"part of a join that was interrupted")
    for name in ("manifest.json.123.unfinished", f"batches/{joined.name}.123.unfinished"):
        (folder / name).write_bytes(b"half")
    for name in ("notes.txt", "batches/notes.txt", "batches/a-b-c.zip", "my.unfinished"):
        (folder / name).write_bytes(b"mine")
    assert_same(run(sweep_of(sensitivities=SENSITIVITIES), folder), dataset)
    assert set(files_in(folder)) == names | {"notes.txt", "batches/notes.txt", "batches/a-b-c.zip", "my.unfinished"}


def test_damaged_join_is_made_of_its_batches(tmp_path):
    """Where the join was interrupted, so that both are there."""
    folder, kept = tmp_path / "sweep", {}

    def keep(number, name, path):
        if name == "unlink" and path.suffix == ".zip":
            kept[path] = path.read_bytes()

    with failing(folder, keep):
        dataset = run(sweep_of(), folder)
    assert len(kept) == 4
    for path, data in kept.items():
        path.write_bytes(data)
    joined = sorted((folder / "batches").glob("*-0-500.zip"))
    for path in joined:
        path.write_bytes(spoilt_half(path.read_bytes()))
    begun = log_of(folder).count(" done mu")
    assert_same(run(sweep_of(), folder), dataset)
    assert log_of(folder).count(" done mu") == begun  # no batch is simulated
    assert sorted((folder / "batches").iterdir()) == joined


def test_disk_that_gives_back_other_bytes(tmp_path, monkeypatch):
    def damaged(store: Store, batch: Batch) -> bytes:
        raise DamagedFileError

    monkeypatch.setattr(Store, "read", damaged)
    with pytest.raises(ss.SweepError) as error:
        run(sweep_of(), tmp_path / "sweep")
    one_sentence(error, str(tmp_path / "sweep"), "check the disk")


def test_damaged_data_set(copied):
    folder, dataset = copied
    (folder / "sweep.nc").write_bytes(spoilt_half((folder / "sweep.nc").read_bytes()))
    with pytest.raises(ss.SweepError) as error:
        read_dataset(folder)
    one_sentence(error, str(folder), "run the sweep again")
    run(sweep_of(sensitivities=SENSITIVITIES), folder)
    assert_same(read_dataset(folder), dataset)
