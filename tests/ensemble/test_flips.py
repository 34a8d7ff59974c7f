"""Single bits that are flipped in stored files: each is told in one sentence, or changes nothing that is read."""

import random

import pytest
from ensemble.test_stored import POISSON, RUN, SYSTEM, assert_same
from pyarrow import parquet
from support.faults import assert_same as assert_same_data
from support.faults import run, sweep_of

import stickslip_jax as ss
from stickslip_jax._sweep.dataset import stored_dataset

FLIPS = 100


def flipped(whole, path, seed):
    """Write `FLIPS` copies of a file to `path`, one after the other, each with another bit flipped."""
    numbers = random.Random(seed)
    for _ in range(FLIPS):
        data = bytearray(whole)
        data[numbers.randrange(len(data))] ^= 1 << numbers.randrange(8)
        path.write_bytes(data)
        yield


@pytest.mark.slow
@pytest.mark.parametrize("keep", ["sticks", "statistics", "totals"])
def test_ensembles(tmp_path, keep):
    many = ss.simulate_ensemble(SYSTEM, POISSON, samples=90, keep=keep, **RUN)
    path, told = many.save(tmp_path / "many.nc"), []
    for _ in flipped(path.read_bytes(), path, keep):
        try:
            back = ss.load(path)
        except ValueError as error:
            told.append(str(error))
        else:
            assert_same(back, many)
    assert all(said.startswith("Argument path must") and "\n" not in said for said in told)
    assert len(told) > FLIPS / 2  # of the others, some lie between the parts of the file


@pytest.mark.slow
def test_data_of_a_sweep(tmp_path):
    """A damaged data set is made anew from the batches."""
    expected = run(sweep_of(), tmp_path / "sweep")
    path = tmp_path / "sweep" / "sweep.nc"
    for number, _ in enumerate(flipped(path.read_bytes(), path, "sweep")):
        if number % 4 == 0:
            assert_same_data(stored_dataset(tmp_path / "sweep"), expected)


@pytest.mark.slow
def test_tables(tmp_path):
    """Of numbers; names of columns and what describes the file have no check sums in Parquet."""
    many = ss.simulate_ensemble(SYSTEM, POISSON, samples=90, keep="sticks", **RUN)
    path, told, elsewhere = many.write_sticks(tmp_path / "sticks.parquet"), 0, 0
    whole = path.read_bytes()
    expected = parquet.read_table(path)
    footer = int.from_bytes(whole[-8:-4], "little") + 8
    for _ in flipped(whole, path, "table"):
        data = path.read_bytes()
        try:
            read = parquet.read_table(path, page_checksum_verification=True)
        except (OSError, ValueError):
            told += 1
        else:
            if data[:-footer] == whole[:-footer]:
                elsewhere += 1
            else:
                assert read.equals(expected)
    assert told > FLIPS / 2
    assert elsewhere < FLIPS / 4
