"""Batches that were swapped, copied, renamed or shifted, and files with a bit turned: found, and simulated again."""

import random
import shutil
from pathlib import Path

import pytest
from support.batches import assert_same_or_missing, unjoined
from support.faults import assert_same, log_of, run, sweep_of

import stickslip_jax as ss
from stickslip_jax._ensemble.encoding import (
    ID_LENGTH,
    DamagedFileError,
    ForeignFileError,
    with_header,
    without_header,
)
from stickslip_jax._sweep.batches import derivatives_of, head_of, unpacked
from stickslip_jax._sweep.dataset import Work, status_of, stored_dataset
from stickslip_jax._sweep.store import Store, manifest_text

SENSITIVITIES = [("stick_fraction", "mu"), ("mean_stick_count", "mu")]
SWEEP_ID, DATA = b"0123456789abcdef", b"the bytes of a batch"


def test_header_is_of_sweep_name_and_bytes():
    whole = with_header(SWEEP_ID, "a-0-256.zip", DATA)
    assert without_header(SWEEP_ID, "a-0-256.zip", whole) == DATA
    for at in range(len(whole)):
        for bit in range(8):
            turned = whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :]
            with pytest.raises(DamagedFileError, match="check sum"):
                without_header(SWEEP_ID, "a-0-256.zip", turned)
    for size in range(len(whole)):
        with pytest.raises(DamagedFileError, match="check sum"):
            without_header(SWEEP_ID, "a-0-256.zip", whole[:size])
    with pytest.raises(DamagedFileError, match=r"it is a-0-256\.zip, under another name"):
        without_header(SWEEP_ID, "a-256-512.zip", whole)
    with pytest.raises(ForeignFileError):
        without_header(SWEEP_ID[::-1], "a-0-256.zip", whole)
    assert whole[:ID_LENGTH] == SWEEP_ID


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with all batches of a sweep, not joined, with two derivatives at both points; and its data set."""
    folder = tmp_path_factory.mktemp("parts") / "sweep"
    return folder, unjoined(sweep_of(sensitivities=SENSITIVITIES), folder)


def swap(one: Path, other: Path) -> None:
    aside = one.with_name("aside")
    one.rename(aside)
    other.rename(one)
    aside.rename(other)


def batches(folder: Path, pattern: str) -> list[Path]:
    found = sorted((folder / "batches").glob(pattern))
    assert found
    return found


def named(path: Path, first: int, end: int) -> Path:
    """The file of other samples, or derivatives from other samples, of the same point."""
    identity, _, _, *rest = path.stem.split("-", 3)
    return path.with_name("-".join([identity, str(first), str(end), *rest]) + path.suffix)


MOVES = {
    "two points swapped": lambda folder: swap(*batches(folder, "*-0-256.zip")),
    "two batches of a point swapped": lambda folder: swap(*batches(folder, f"{_identity(folder)}-*.zip")),
    "copied over another point": lambda folder: shutil.copy(*batches(folder, "*-256-500.zip")),
    "copied over other samples": lambda folder: shutil.copy(*batches(folder, f"{_identity(folder)}-*.zip")),
    "renamed to more samples": lambda folder: _renamed(folder, 0, 500),
    "shifted by one sample": lambda folder: _renamed(folder, 1, 257),
    "renamed to fewer samples": lambda folder: _renamed(folder, 0, 255),
    "derivatives of two points swapped": lambda folder: swap(*batches(folder, "*stick_fraction*.json")),
    "two derivatives of a point swapped": lambda folder: swap(*batches(folder, f"{_identity(folder)}-*.json")),
}


def _identity(folder: Path) -> str:
    return batches(folder, "*.zip")[0].name.partition("-")[0]


def _renamed(folder: Path, first: int, end: int) -> None:
    path = batches(folder, "*-0-256.zip")[0]
    path.rename(named(path, first, end))


@pytest.mark.slow
@pytest.mark.parametrize("move", MOVES)
def test_batch_under_another_name_is_found_and_done_again(copied, move):
    folder, wanted = copied
    MOVES[move](folder)
    assert_same_or_missing(stored_dataset(folder), wanted)
    assert_same(run(sweep_of(sensitivities=SENSITIVITIES), folder), wanted)
    assert "under another name" in log_of(folder)


def test_status_does_not_count_what_is_under_another_name(copied):
    folder, _ = copied
    assert (status_of(folder).samples, sum(status_of(folder).endings.values())) == (1000, 1000)
    MOVES["two points swapped"](folder)
    assert (status_of(folder).samples, status_of(folder).complete) == (488, 0)


def test_batch_whose_head_differs_from_its_name(copied):
    """As of a worker that gives back the result of another task: the header is right, and what is in it is not."""
    folder, wanted = copied
    sweep = sweep_of(sensitivities=SENSITIVITIES)
    store = Store.reading(folder)
    first, second = batches(folder, f"{_identity(folder)}-*.zip")
    data = without_header(store.sweep_id, second.name, second.read_bytes())
    fields = sweep.plan.fields_at(0)
    assert unpacked(data, fields, 256, 500).samples == head_of(data, 256, 500)["samples"] == 244
    for of in ((0, 256), (0, 244), (256, 512), (255, 500)):
        for read in (lambda of: unpacked(data, fields, *of), lambda of: head_of(data, *of)):
            with pytest.raises(DamagedFileError, match="it holds 244 samples from 256 on"):
                read(of)
    first.write_bytes(with_header(store.sweep_id, first.name, data))
    assert_same_or_missing(stored_dataset(folder), wanted)
    assert_same(run(sweep, folder), wanted)
    assert "it holds 244 samples from 256 on" in log_of(folder)


def test_derivatives_from_other_samples(copied):
    folder, _ = copied
    path = batches(folder, "*.json")[0]
    data = without_header(Store.reading(folder).sweep_id, path.name, path.read_bytes())
    assert derivatives_of(data, 500)["end"] == 500
    for wrong, end in ((data, 501), (b"{}", 500), (b"[" * 100_000, 500), (b"5", 500)):
        with pytest.raises(DamagedFileError):
            derivatives_of(wrong, end)


def test_worker_that_gives_back_another_task(tmp_path, monkeypatch, whole):
    """Noticed when it comes, and done again."""
    perform, wrong = ss._sweep.batches.perform, []

    def mixed_up(plan, task):
        if task.derivative is None and task.first == 0 and not wrong:
            wrong.append(task)
            return perform(plan, task._replace(first=256, end=500))
        return perform(plan, task)

    monkeypatch.setattr("stickslip_jax._sweep.batches.perform", mixed_up)
    sweep = sweep_of(sensitivities=SENSITIVITIES)
    assert_same(run(sweep, tmp_path / "sweep"), whole[1])
    assert len(wrong) == 1
    assert "it holds 244 samples from 256 on" in log_of(tmp_path / "sweep")


# --- many of them, at random


def move_at_random(folder: Path, chance: random.Random) -> None:
    """Swap two batches, copy one over another, or give one another name."""
    one, other = chance.sample(batches(folder, f"*.{chance.choice(['zip', 'zip', 'json'])}"), 2)
    how = chance.choice(["swap", "copy", "rename", "shift"])
    if how == "swap":
        swap(one, other)
    elif how == "copy":
        shutil.copy(one, other)
    elif how == "rename":
        one.replace(other)
    else:
        _, first, end, *_ = one.stem.split("-", 3)
        other = named(one, max(0, int(first) + chance.randint(-300, 300)), int(end) + chance.randint(-200, 300))
        one.replace(other)


def moves_told(whole, tmp_path, number: int) -> None:
    folder, wanted = whole
    chance = random.Random(5)
    for at in range(number):
        spoilt = Path(shutil.copytree(folder, tmp_path / str(at)))
        move_at_random(spoilt, chance)
        assert_same_or_missing(stored_dataset(spoilt), wanted)
        assert_same(run(sweep_of(sensitivities=SENSITIVITIES), spoilt), wanted)
        shutil.rmtree(spoilt)


@pytest.mark.slow
def test_four_batches_moved_at_random(whole, tmp_path):
    moves_told(whole, tmp_path, 4)


@pytest.mark.slow
def test_two_hundred_batches_moved_at_random(whole, tmp_path):
    moves_told(whole, tmp_path, 200)


def flips_told(copied, number: int) -> None:
    """Turn single bits in batches, manifest and its copy: numbers are as before, or missing, never others."""
    folder, wanted = copied
    text = manifest_text(ss.Sweep.load(folder).plan)
    files = [folder / "manifest.json", folder / "manifest-copy.json", *batches(folder, "*")]
    plan, chance = sweep_of(sensitivities=SENSITIVITIES).plan, random.Random(7)
    for at in range(number):
        path = files[at % len(files)]
        whole = path.read_bytes()
        place = chance.randrange(len(whole))
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << chance.randrange(8)]) + whole[place + 1 :])
        assert manifest_text(ss.Sweep.load(folder).plan) == text
        assert_same_or_missing(stored_dataset(folder), wanted)
        if path.parent.name == "batches":
            work = Work(plan, Store.reading(folder))
            there = [work.ensemble(point) for point in range(2)], [work.derivatives(point) for point in range(2)]
            samples = sum(0 if one is None else one.samples for one in there[0])
            assert samples < 1000 or sum(map(len, there[1])) < 4
        path.write_bytes(whole)


@pytest.mark.slow
def test_sixteen_turned_bits(copied):
    flips_told(copied, 16)


@pytest.mark.slow
def test_three_hundred_turned_bits(copied):
    flips_told(copied, 300)
