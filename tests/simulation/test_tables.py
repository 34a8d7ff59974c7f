"""The sticks of one trajectory as a table, as labelled arrays and in files."""

import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import stickslip_jax as ss

MASS = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
WAVE = ss.SquareWave(0.5, 3.0)
T1, START = 20.0, (0.3, 0.1)
TIMES = ["order", "start_s", "end_s", "duration_s"]
READERS = {".csv": pd.read_csv, ".parquet": pd.read_parquet}


class Wheel(ss.SwitchedSystem):
    """A wheel on a torsion spring, which a shaft drives; its angle is counted in turns."""

    @property
    def state_names(self):
        return "angle in rad", "angular velocity in rad/s"

    def rates(self, t, y, base, friction):
        return y[1], -4.0 * y[0] - friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return math.pi


class Unnamed(Wheel):
    """A state without a unit."""

    @property
    def state_names(self):
        return "angle", "rate"


SIMULATIONS = {
    "closed form": (lambda: ss.simulate(MASS, WAVE, t1=T1, y0=START), "_m"),
    "time steps": (lambda: ss.simulate(MASS, ss.Harmonic(0.5, 2.1), t1=T1, y0=START), "_m"),
    "regularised": (
        lambda: ss.simulate(MASS, ss.Harmonic(0.5, 2.1), t1=T1, y0=START, method=ss.Regularized(width=1e-2)),
        "_m",
    ),
    "motor": (lambda: ss.simulate(ss.MotorCart(mu=0.5), ss.SourceVoltage(), t1=1.0), "_rad"),
    "own system": (lambda: ss.simulate(Wheel(), ss.Harmonic(0.5, 2.1), t1=T1, y0=START), "_rad"),
    "no unit": (lambda: ss.simulate(Unnamed(), ss.Harmonic(0.5, 2.1), t1=T1, y0=START), ""),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name in ("no unit", "motor") else name for name in SIMULATIONS],
)
def test_a_table_holds_every_stick(name, tmp_path):
    simulate, unit = SIMULATIONS[name]
    one = simulate()
    table, mask = one.to_pandas(), np.asarray(one.sticks.mask)
    assert list(table) == [*TIMES, f"position{unit}", f"slip_displacement{unit}", "is_initial_rest", "ending"]
    assert len(table) == mask.sum() > 0
    for column in ("start", "end", "duration", "position", "slip_displacement"):
        held = next(label for label in table if label in (column, f"{column}_s", f"{column}{unit}"))
        np.testing.assert_array_equal(table[held], np.asarray(getattr(one.sticks, column))[mask])
    assert [ss.Ending[name] for name in table["ending"]] == list(np.asarray(one.sticks.ending)[mask])
    np.testing.assert_array_equal(table["is_initial_rest"], table["start_s"] == 0)
    first = 0 if table["start_s"][0] == 0 else 1
    np.testing.assert_array_equal(table["order"], np.arange(len(table)) + first)
    for ending, read in READERS.items():
        path = one.write_sticks(tmp_path / f"sticks{ending}")
        pd.testing.assert_frame_equal(read(path), table, check_exact=True)


@pytest.mark.slow
def test_the_columns_are_those_of_an_ensemble(tmp_path):
    """So that both kinds of files can be read by one program."""
    many = ss.simulate_ensemble(MASS, WAVE, samples=3, t1=T1, y0=START, keep="sticks")
    whole = pd.read_parquet(many.write_sticks(tmp_path / "sticks.parquet"))
    table = ss.simulate(MASS, WAVE, t1=T1, y0=START).to_pandas()
    mine = whole[whole["sample"] == 2].drop(columns="sample").reset_index(drop=True)
    pd.testing.assert_frame_equal(table, mine, rtol=0, atol=64 * np.finfo(float).eps * T1, check_exact=False)
    back = ss.Ensemble.from_sticks(table.assign(sample=0), t1=T1)
    assert ss.stick_fraction(back).value == pytest.approx(table["duration_s"].sum() / T1, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["closed form", pytest.param("motor", marks=pytest.mark.slow), "own system"])
def test_labeled_arrays(name, tmp_path):
    one, unit = SIMULATIONS[name][0](), SIMULATIONS[name][1].removeprefix("_")
    file = tmp_path / "one.nc"
    one.to_xarray().to_netcdf(file, engine="h5netcdf")
    sticks, slips = np.asarray(one.sticks.mask), np.asarray(one.slips.mask)
    with xr.open_dataset(file, engine="h5netcdf") as data:
        assert all({"units", "long_name"} <= variable.attrs.keys() for variable in data.variables.values())
        assert data.stick_start.dims == ("stick",)
        assert data.slip_start.dims == ("slip",)
        assert data.stick_position.attrs["units"] == unit
        assert data.stick_start.attrs["units"] == "s"
        for column in ("start", "end", "position", "ending"):
            np.testing.assert_array_equal(data[f"stick_{column}"], np.asarray(getattr(one.sticks, column))[sticks])
        for column in ("start", "end"):
            np.testing.assert_array_equal(data[f"slip_{column}"], np.asarray(getattr(one.slips, column))[slips])
        assert int(data.stick_count) == sticks.sum()
        assert int(data.slip_count) == slips.sum()
        assert float(data.stick_time) == float(one.stick_time)
        assert int(data.status) == ss.Status.FINISHED
        assert data.attrs["t1"] == float(one.t1)
        assert data.attrs["system"].startswith(type(one.system).__name__)
        assert data.attrs["source"] == f"stickslip_jax {ss.__version__}"


@pytest.mark.slow
def test_names_are_those_of_an_ensemble():
    many = ss.simulate_ensemble(MASS, WAVE, samples=3, t1=T1, y0=START, keep="sticks").to_xarray()
    one = ss.simulate(MASS, WAVE, t1=T1, y0=START).to_xarray()
    assert set(one.variables) <= {*many.variables, "time_reached"}
    for name in set(one.variables) - {"time_reached", "status"}:
        assert one[name].attrs.items() <= many[name].attrs.items()


@pytest.mark.slow
def test_what_comes_out_of_jit(tmp_path):
    start = jnp.asarray(START)
    alone = ss.simulate(MASS, WAVE, t1=T1, y0=START)
    one = jax.jit(lambda y0: ss.simulate(MASS, WAVE, t1=T1, y0=(y0[0], y0[1])))(start)
    pd.testing.assert_frame_equal(one.to_pandas(), alone.to_pandas(), rtol=0, atol=64 * np.finfo(float).eps * T1)
    assert int(one.to_xarray().stick_count) == len(alone.to_pandas())
    assert len(pd.read_csv(one.write_sticks(tmp_path / "sticks.csv"))) == len(alone.to_pandas())


CALLS = {
    "to_pandas": lambda one, path: one.to_pandas(),
    "to_xarray": lambda one, path: one.to_xarray(),
    "write_sticks": lambda one, path: one.write_sticks(path),
}


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS)
def test_batches_and_traced_simulations(call, tmp_path):
    def followed(y0):
        return ss.simulate(MASS, WAVE, t1=T1, y0=(y0, 0.1))

    starts, path = jnp.asarray([0.3, 0.4]), tmp_path / "sticks.csv"
    batch = jax.vmap(followed)(starts)
    with pytest.raises(
        ValueError, match=rf"{call} is for one .* batch of \(2,\) simulations; make an ensemble"
    ) as told:
        CALLS[call](batch, path)
    assert "\n" not in str(told.value)
    # What the sentence advises to do, does.
    taken = jax.tree.map(lambda leaf: leaf[0], batch)
    pd.testing.assert_frame_equal(taken.to_pandas(), followed(0.3).to_pandas(), rtol=0, atol=1e-12)
    assert ss.Ensemble.from_simulations(batch).samples == 2
    for transform in (jax.jit, lambda f: jax.jit(jax.vmap(f)), jax.vmap, jax.grad):
        argument = starts if transform is not jax.jit and transform is not jax.grad else starts[0]
        with pytest.raises(ValueError, match=f"{call} needs numbers, but JAX is tracing .* on what comes back"):
            transform(lambda y0: (CALLS[call](followed(y0), path), y0)[1])(argument)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS)
def test_what_did_not_finish_is_told(call, tmp_path):
    one = ss.simulate(MASS, ss.Harmonic(0.5, 2.1), t1=T1, y0=START, method=ss.Exact(max_steps=20))
    assert int(one.status) == ss.Status.OUT_OF_STEPS
    stopped = re.escape(f"stopped at {float(one.time_reached):g} of 20 s")
    with pytest.warns(RuntimeWarning, match=rf"did not finish: it {stopped}, because .*; {call} gives .* until there"):
        CALLS[call](one, tmp_path / "sticks.csv")


@pytest.mark.slow
def test_no_sticks_at_all(tmp_path):
    one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.0)), WAVE, t1=T1, y0=START)
    assert len(one.to_pandas()) == 0
    assert list(one.to_pandas()) == list(ss.simulate(MASS, WAVE, t1=T1, y0=START).to_pandas())
    assert dict(one.to_xarray().sizes) == {"stick": 0, "slip": 1}
    for ending, read in READERS.items():
        assert len(read(one.write_sticks(tmp_path / f"sticks{ending}"))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("ending", READERS)
def test_files_are_replaced_only_when_asked(ending, tmp_path):
    one, path = ss.simulate(MASS, WAVE, t1=T1, y0=START), tmp_path / f"sticks{ending}"
    assert one.write_sticks(path) == path
    with pytest.raises(FileExistsError, match=r"is there already .*overwrite=True"):
        one.write_sticks(path)
    path.write_bytes(b"old")
    one.write_sticks(str(path), overwrite=True)
    assert len(READERS[ending](path)) == int(one.sticks.count)
    with pytest.raises(ValueError, match=r"Argument path must be a file name that ends in \.csv or \.parquet"):
        one.write_sticks(tmp_path / "sticks.xlsx")
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
