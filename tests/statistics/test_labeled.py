"""What leaves the package: labelled arrays, tables of sticks, the summary."""

import functools
import re

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import NUMBERS, QUANTITIES

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))


@pytest.fixture(scope="module")
def many():
    run = {"t1": 40.0, "y0": (0.0, 1.0), "key": jax.random.key(4), "orders": 4, "chunk": 64}
    return ss.simulate_ensemble(SYSTEM, ss.PoissonSwitching(1.0, 1.0), samples=200, keep="sticks", **run)


@pytest.mark.slow
def test_statistics_as_labeled_arrays(many, tmp_path):
    statistics, file = many.statistics, tmp_path / "statistics.nc"
    statistics.to_xarray(bins=20).to_netcdf(file, engine="h5netcdf")
    with xr.open_dataset(file, engine="h5netcdf") as data:
        for name, variable in data.variables.items():
            assert name in ("ending",) or name.endswith("_bounds") or {"units", "long_name"} <= variable.attrs.keys()
        assert float(data.duration_mean) == statistics.duration.mean.value
        assert data.duration_mean.attrs["standard_error"] == statistics.duration.mean.standard_error
        assert float(data.slip_duration_quantile.sel(quantile=0.5)) == statistics.slip_duration.median.value
        histogram = statistics.position.histogram(20)
        np.testing.assert_array_equal(data.position_density, histogram.density)
        np.testing.assert_array_equal(data[data.position_bin.attrs["bounds"]][:, 0], histogram.edges[:-1])
        assert data.position_bin.attrs["units"] == "m"
        assert data.duration_density.attrs["units"] == "s-1"
        joint = statistics.joint("start", "duration").histogram(20)
        np.testing.assert_array_equal(data.start_and_duration_count_in_bin, joint.counts)
        assert data.duration_by_order.dims == ("order",)
        assert float(data.duration_by_order.sel(order=3)) == statistics.order(3).duration.mean.value
        assert float(data.ending_share.sel(ending="RELEASED")) == statistics.endings[ss.Ending.RELEASED].value


exactly = (
    {"float_precision": "round_trip"} if int(pd.__version__.partition(".")[0]) < 3 else {}
)  # from 3 on the default
read_csv = functools.partial(pd.read_csv, **exactly)


@pytest.mark.parametrize(("ending", "read"), [(".csv", read_csv), (".parquet", pd.read_parquet)])
def test_tables_hold_every_stick(many, tmp_path, ending, read):
    path = many.write_sticks(tmp_path / f"sticks{ending}")
    table, sticks = read(path), many.flat_sticks
    measured = [f"{name}_{QUANTITIES[name].unit or 'm'}" if name in QUANTITIES else f"{name}_m" for name in NUMBERS[2:]]
    assert list(table) == ["sample", "order", "start_s", "end_s", "duration_s", *measured, "is_initial_rest", "ending"]
    for name in ("start", "end", "duration"):
        np.testing.assert_array_equal(table[f"{name}_s"], getattr(sticks, name))
    np.testing.assert_array_equal(table["sample"], np.repeat(np.arange(200), sticks.count))
    rest = sticks.begins_at_zero
    assert 0 < rest.sum() < len(rest)
    np.testing.assert_array_equal(table.groupby("sample")["order"].max(), (sticks.count - rest)[sticks.count > 0])
    np.testing.assert_array_equal(table["order"] == 0, table["is_initial_rest"])
    np.testing.assert_array_equal(table["start_s"] == 0, table["is_initial_rest"])
    for number in (1, 3):  # the numbers are those of the statistics
        durations = table["duration_s"][table["order"] == number]
        assert durations.mean() == pytest.approx(many.statistics.order(number).duration.mean.value, rel=1e-12)
    assert [ss.Ending[name] for name in table["ending"]] == list(sticks.ending)


@pytest.mark.parametrize(("ending", "read"), [(".csv", read_csv), (".parquet", pd.read_parquet)])
def test_tables_hold_every_slip(many, tmp_path, ending, read):
    table, slips = read(many.write_slips(tmp_path / f"slips{ending}")), many.slips
    assert list(table) == ["sample", "start_s", "end_s", "duration_s", "is_censored"]
    np.testing.assert_array_equal(table["sample"], np.repeat(np.arange(200), many.totals.slips))
    for name, column in {"start": "start_s", "duration": "duration_s", "censored": "is_censored"}.items():
        np.testing.assert_array_equal(table[column], getattr(slips, name)[slips.mask])
    # What does not slip sticks.
    slipped = table.groupby("sample")["duration_s"].sum()
    np.testing.assert_allclose(40 - slipped, many.totals.stick_time, atol=1e-12)


def test_tables_of_other_formats_are_refused(many, tmp_path, annotations_unchecked):
    with pytest.raises(
        ValueError, match=r"Argument path must be a file name that ends in \.csv or \.parquet, but .*sticks\.xlsx"
    ):
        many.write_sticks(tmp_path / "sticks.xlsx")
    assert list(tmp_path.iterdir()) == []


def test_summary_says_what_the_statistics_say(many):
    text, statistics = repr(many.summary()), many.statistics
    rows: dict = {}  # of the tables in two parts: both, one after the other
    for line in text.splitlines():
        if "  " in line:
            rows[line.split("  ")[0]] = rows.get(line.split("  ")[0], "") + line
    for name, of in (("stick duration (s)", statistics.duration), ("number of slips", statistics.slip_count)):
        mean, error = re.search(r"(\d+\.\d+) \+- (\d+\.\d+)", rows[name]).groups()
        assert float(mean) == pytest.approx(of.mean.value, abs=0.6 * 10 ** -len(mean.partition(".")[2]))
        assert float(error) == pytest.approx(of.mean.standard_error, rel=0.05)
        assert rows[name].endswith(f"{of.number:,}")
        assert f"{of.median.value:.4g}" in rows[name]
    assert "200 samples on [0, 40] s" in text
    _, _, of_sticks, of_slips, *_ = text.split("\n\n")
    for number in (1, 2, 3, 4):
        for table, of in ((of_sticks, statistics), (of_slips, statistics.slips)):
            (row,) = (line for line in table.splitlines() if line.split()[0] == str(number))
            assert f"{of.order(number).start.mean.value:.2f}"[:3] in row
    lines = text.split("\n\n")[1].splitlines()[1:]
    for part in (lines[: len(lines) // 2 + 1], lines[len(lines) // 2 + 1 :]):
        assert len({len(line) for line in part}) == 1, "columns are aligned"
    assert max(map(len, text.splitlines())) <= 100
    markup = many.summary()._repr_html_()
    assert markup.count("<tr>") == markup.count("</tr>") == 3 + 8 + 4 + 4
    assert "<td>stick duration (s)</td>" in markup
