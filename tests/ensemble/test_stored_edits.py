"""Edited data sets and bad files of ensembles: each is one sentence, none gives other numbers."""

import json
import math
import os

import jax
import numpy as np
import pytest
import xarray as xr

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import FlatSticks
from stickslip_jax._ensemble import conversions
from stickslip_jax._ensemble.encoding import CONTENT_SUM


@pytest.fixture(scope="module")
def kept():
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    run = {"t1": 40.0, "y0": (0.0, 1.0), "key": jax.random.key(2026), "chunk": 64, "orders": 3}
    return ss.simulate_ensemble(system, law, samples=90, keep="sticks", **run)


@pytest.fixture
def stored(tmp_path, kept):
    return kept.save(tmp_path / "many.nc")


def _newer(data):
    return data.assign_attrs(format_version=7, stickslip_jax_version="9.1")


def _foreign(_):
    return xr.Dataset({"t": ("x", [1.0])}, attrs={"source": "CESM 2"})


def _without(*names):
    return lambda data: data.drop_vars(names)


def _with_attribute(**given):
    return lambda data: data.assign_attrs(given)


def _with_column(name, change):
    def changed(data):
        values = data[name].to_numpy().copy()
        change(values)
        return data.assign({name: (data[name].dims, values, data[name].attrs)})

    return changed


def _set(at, value):
    def change(values):
        values[at] = value

    return change


def _with_state(*path, value):
    """Another entry in the JSON of what the ensemble was made of."""

    def changed(data):
        whole = json.loads(data.ensemble_state.item())
        at = whole
        for name in path[:-1]:
            at = at[name]
        at[path[-1]] = value
        return data.assign(ensemble_state=((), json.dumps(whole)))

    return changed


NESTED = json.loads("[" * 400 + "]" * 400)
EDITED = {
    "newer": (_newer, ["must be of format 2", "it has format 7", "stickslip_jax 9.1"]),
    "older": (_with_attribute(format_version=1), ["must be of format 2", "it has format 1", "simulate it again"]),
    "of another program": (_foreign, ["one written by 'CESM 2'", "does not say that it is an ensemble"]),
    "without a column": (_without("stick_position"), ["stick_position"]),
    "without its sums": (_without("ensemble_state"), ["ensemble_state"]),
    "without some sticks": (lambda data: data.isel(stick=slice(10)), ["10 of"]),
    "without some samples": (
        lambda data: data.isel(sample=slice(10), stick=slice(int(data.stick_count[:10].sum()))),
        ["10 of 90 samples"],
    ),
    "t1": (_with_attribute(t1=-1.0), ["t1 must be positive"]),
    "t1 NaN": (_with_attribute(t1=math.nan), ["t1 must be"]),
    "shorter t1": (_with_attribute(t1=20.0), ["which cannot be with t1 = 20 s"]),
    "dtype": (_with_attribute(dtype="junk"), ["junk"]),
    "keep": (_with_attribute(keep="junk"), ["junk"]),
    "other keep": (_with_attribute(keep="totals"), ["totals"]),
    "samples": (_with_attribute(samples=91), ["90 of 91 samples"]),
    "no samples": (_with_attribute(samples=0, samples_finished=0), ["samples must be"]),
    "first sample": (_with_attribute(first_sample=-5), ["first_sample must be"]),
    "endings of samples": (_with_attribute(samples_finished=-1), ["of 90 samples"]),
    "orders": (_with_attribute(orders=0), ["orders must be"]),
    "threads": (_with_attribute(threads_used=0), ["threads_used must be"]),
    "time": (_with_attribute(run_seconds=-3.0), ["run_seconds must be"]),
    "near grazing": (_with_attribute(samples_near_grazing=91), ["91 samples near grazing"]),
    "key": (_with_attribute(key_data=np.array([1, 2, 3], np.uint32)), ["its key is"]),
    "start NaN": (_with_column("stick_start", _set(4, math.nan)), ["a stick from nan"]),
    "start 1e9": (_with_column("stick_start", _set(4, 1e9)), ["a stick from 1e+09"]),
    "end before its start": (_with_column("stick_end", _set(4, 0.0)), ["which cannot be"]),
    "overlap": (_with_column("stick_end", _set(0, 39.0)), ["which cannot be"]),
    "position": (_with_column("stick_position", _set(4, math.inf)), ["infinite positions"]),
    "ending": (_with_column("stick_ending", _set(4, 99)), ["the ending 99"]),
    "status": (_with_column("status", _set(4, 99)), ["the status 99"]),
    "other status": (_with_column("status", _set(4, 1)), ["not those that it counts"]),
    "slips": (_with_column("slip_count", _set(4, -1)), ["negative numbers of slips"]),
    "stick time": (_with_column("stick_time", _set(4, 1e6)), ["do not last for its stick times"]),
    "count": (_with_column("stick_count", _set(0, -1)), ["was changed or damaged"]),
    "law": (_with_state("law", "fields", "rate", value=-1.0), ["rate must be positive"]),
    "law without a class": (_with_state("law", value=5), ["its law is 5"]),
    "unknown class": (_with_state("law", "class", value="Junk"), ["Junk"]),
    "unknown number": (_with_state("law", "fields", "junk", value=1.0), ["junk"]),
    "system": (_with_state("system", value={"class": "Coulomb", "fields": {"mu": 1.0}}), ["its system is"]),
    "friction": (_with_state("system", "fields", "friction", "fields", "mu", value=-1.0), ["mu must be"]),
    "method": (_with_state("method", value={"class": "Coulomb", "fields": {"mu": 1.0}}), ["its method is"]),
    "code": (_with_state("method", value={"diffrax": "diffeqsolve"}), ["'diffeqsolve', which this version"]),
    "start of the motion": (_with_state("y0", value={"tuple": [0.0, {"float": "nan"}]}), ["trajectories start at"]),
    "number of a sum": (_with_state("moments", "fields", "number", value=12), ["sums are of 12 samples"]),
    "sums": (_with_state("moments", value=None), ["lacks the sums"]),
    "histograms": (_with_state("accumulator", value=7), ["histograms are 7"]),
    "depth": (_with_state("law", value={"list": NESTED}), ["was changed or damaged"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", EDITED)
def test_an_edited_data_set_is_one_sentence(kept, case):
    edit, expected = EDITED[case]
    with pytest.raises(ValueError, match=r"\AArgument dataset must") as caught:
        ss.Ensemble.from_xarray(edit(kept.to_xarray()))
    message = str(caught.value)
    assert all(part in message for part in expected), message
    assert "\n" not in message
    assert message.endswith(".")


@pytest.mark.slow_but_for("law", "of another program")
@pytest.mark.parametrize("case", ["shorter t1", "start NaN", "law", "newer", "of another program"])
def test_an_edited_file_is_one_sentence(stored, case):
    """The check sum tells, if nothing else does."""
    edit, expected = EDITED[case]
    edit(xr.load_dataset(stored)).to_netcdf(stored, engine="h5netcdf")
    with pytest.raises(ValueError, match=r"\AArgument path must") as caught:
        ss.load(stored)
    assert all(part in str(caught.value) for part in (expected if "format" in expected[0] else [])), caught.value


def test_a_file_without_its_sum(stored):
    data = xr.load_dataset(stored)
    assert np.array_equal(ss.Ensemble.from_xarray(data).flat_sticks.end, ss.load(stored).flat_sticks.end)
    del data.attrs[CONTENT_SUM]
    data.to_netcdf(stored, engine="h5netcdf")
    with pytest.raises(ValueError, match="it lacks its check sum"):
        ss.load(stored)


def _fifo(path):
    path.unlink()
    os.mkfifo(path)


BAD_FILES = {
    "cut short": (lambda path: path.write_bytes(path.read_bytes()[:9000]), ["cannot be read as such", "cut short"]),
    "text": (lambda path: path.write_text("sample,start\n0,1\n"), ["cannot be read as such", "of another kind"]),
    "empty": (lambda path: path.write_bytes(b""), ["cannot be read as such"]),
    "a FIFO": (_fifo, ["it is no ordinary file"]),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_one_sentence(stored, case):
    damage, expected = BAD_FILES[case]
    damage(stored)
    with pytest.raises(ValueError, match=r"\AArgument path must") as caught:
        ss.load(stored)
    message = str(caught.value)
    assert all(part in message for part in expected), message
    assert "\n" not in message
    assert message.endswith(".")


def test_many_sticks_of_single_precision_sum_to_their_stick_time():
    """Their round-off grows with the root of their number, and is no damage; that of a few is."""
    number, t1 = 10**6, 1e6
    numbers = np.random.default_rng(1)
    start = np.arange(number, dtype=np.float32)
    end = (start + numbers.uniform(0.2, 0.8, number)).astype(np.float32)
    sticks = FlatSticks.of(np.array([number]), start, end, np.zeros(number, np.int8))
    time = np.sum(end.astype(float) - start)
    finished = np.array([True])
    conversions.check_sticks(sticks, np.array([time + 1e-4 * t1]), finished, t1)
    with pytest.raises(ValueError, match="do not last for its stick times"):
        conversions.check_sticks(sticks, np.array([time + 2e-3 * t1]), finished, t1)
    few = FlatSticks(np.array([10]), sticks.numbers[:, :10], sticks.ending[:10])
    with pytest.raises(ValueError, match="do not last for its stick times"):
        conversions.check_sticks(few, np.array([np.sum(end[:10] - start[:10]) + 1e-4 * t1]), finished, t1)
