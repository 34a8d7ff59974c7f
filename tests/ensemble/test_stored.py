"""Ensembles in files and data sets: nothing changes on the way."""

import dataclasses
import json

import diffrax
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._dynamics.sticks import NUMBERS, QUANTITIES, slips_between
from stickslip_jax._statistics.quantities import STICK_QUANTITIES

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
KEY = jax.random.key(2026)
RUN = {"t1": 40.0, "y0": (0.0, 1.0), "key": KEY, "chunk": 64, "orders": 3}


class _EndsEarly(ss.PoissonSwitching):
    """A law of a user's own, in which some samples have too few intervals."""

    def draw(self, key_data, number, dtype):
        return jnp.where(number < 3, super().draw(key_data, number, dtype), 0)


@pytest.fixture(scope="module")
def kept():
    return ss.simulate_ensemble(SYSTEM, POISSON, samples=90, keep="sticks", **RUN)


@pytest.fixture(scope="module")
def short():
    """A user's law; two thirds of its samples do not finish."""
    run = {**RUN, "t1": 3.0}
    return ss.simulate_ensemble(SYSTEM, _EndsEarly(1.0, 1.0), samples=90, keep="sticks", **run)


def assert_same_arrays(one, other):
    """The same arrays with the same types, to the last bit."""
    ours, theirs = jax.tree.leaves(one), jax.tree.leaves(other)
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for mine, its in zip(ours, theirs, strict=True):
        assert np.asarray(mine).dtype == np.asarray(its).dtype
        np.testing.assert_array_equal(mine, its)


def assert_same(one, other):
    """The same ensemble: every field but those objects that are a user's own."""
    for field in dataclasses.fields(one):
        mine, its = getattr(one, field.name), getattr(other, field.name)
        if field.name in ("system", "law", "method", "origins"):
            assert repr(mine) == repr(its)
        elif field.name == "status_counts":
            assert mine == its
        else:
            assert_same_arrays(mine, its)


@pytest.mark.slow_but_for("fixed-statistics", "fixed-totals")
@pytest.mark.parametrize("keep", ["sticks", "statistics", "totals"])
@pytest.mark.parametrize("y0", [(0.0, 1.0), (0.0, ss.Uniform(-1.0, 1.0))], ids=["fixed", "drawn"])
def test_what_is_stored_comes_back_to_the_last_bit(tmp_path, keep, y0):
    many = ss.simulate_ensemble(SYSTEM, POISSON, samples=90, keep=keep, **{**RUN, "y0": y0})
    back = ss.load(many.save(tmp_path / "many.nc"))
    assert_same(back, many)
    assert back.keep == keep
    for number in (0, 89):
        assert_same_arrays(back.realization(number), many.realization(number))
    if keep != "totals":
        assert repr(back.summary()) == repr(many.summary())
        assert back.statistics.to_xarray().identical(many.statistics.to_xarray())
    assert_same(ss.Ensemble.from_xarray(many.to_xarray()), many)


def test_what_came_back_goes_on(tmp_path, kept):
    back = ss.load(kept.save(tmp_path / "many.nc"))
    assert ss.first_stick(back).start.tolist() == ss.first_stick(kept).start.tolist()
    assert repr(ss.independent(back)) == repr(ss.independent(kept))
    one, other = (plot.stick_map(many).collections[0].get_offsets() for many in (back, kept))
    assert np.array_equal(one, other)
    longer = back.extended(samples=38, chunk=64)
    assert_same_arrays(longer.flat_sticks.start[: len(kept.flat_sticks.start)], kept.flat_sticks.start)
    _, base, y0 = back.realization(7)
    again = ss.simulate(back.system, base, t1=40.0, y0=y0)
    count = kept.flat_sticks.count[7]
    # As in `test_each_sample_is_the_simulation_of_its_own_key`: compiled apart, amplified in 40 s.
    np.testing.assert_allclose(again.sticks.start[:count], kept.sticks.start[7, :count], rtol=0, atol=1e-10)


@pytest.mark.parametrize("extra", [{"file": False}, {"file": True}])
def test_attributes_say_what_was_simulated(tmp_path, kept, extra):
    data = xr.load_dataset(kept.save(tmp_path / "many.nc")) if extra["file"] else kept.to_xarray()
    attributes = data.attrs
    assert json.loads(attributes["system"])["fields"]["friction"]["fields"]["mu"] == 1.0
    assert json.loads(attributes["law"]) == {
        "class": "PoissonSwitching", "fields": {"speed": 1.0, "rate": 1.0, "first_sign": "random"},
    }  # fmt: skip
    assert json.loads(attributes["y0"]) == [0.0, 1.0]
    np.testing.assert_array_equal(attributes["key_data"], jax.random.key_data(KEY))
    expected = {
        "t1": 40.0, "samples": 90, "first_sample": 0, "orders": 3, "count_initial_rest": 0, "dtype": "float64",
        "method": "exact", "keep": "sticks", "stickslip_jax_version": ss.__version__, "format_version": 2,
        "samples_finished": 90, "samples_base_too_short": 0, "samples_near_grazing": 0,
    }  # fmt: skip
    assert {name: attributes[name] for name in expected} == expected


def test_ragged_arrays_have_the_sample_of_each_stick_and_slip(kept):
    data = kept.to_xarray()
    slips = slips_between(kept.sticks, 40.0)
    mask = np.asarray(slips.mask)
    owner = np.nonzero(mask)[0]
    np.testing.assert_array_equal(data.slip_sample, owner)
    for name in ("start", "end"):
        np.testing.assert_array_equal(data[f"slip_{name}"], np.asarray(getattr(slips, name))[mask])
        np.testing.assert_array_equal(getattr(kept.slips, name)[kept.slips.mask], data[f"slip_{name}"])
    np.testing.assert_array_equal(data.slip_ending, np.asarray(slips.censored)[mask])
    np.testing.assert_array_equal(data.slip_count, kept.slips.count)
    rows = np.nonzero(kept.sticks.mask)
    np.testing.assert_array_equal(data.stick_sample, rows[0])
    rest = kept.sticks.start[rows[0], 0] == 0
    np.testing.assert_array_equal(data.stick_order, rows[1] + 1 - rest)
    by_order = data.stick_end.where(data.stick_order == 2, drop=True) - data.stick_start.where(
        data.stick_order == 2, drop=True
    )
    assert float(by_order.mean()) == pytest.approx(kept.statistics.order(2).duration.mean.value, rel=1e-12)
    # Groups of the sample index are the samples.
    sums = (data.stick_end - data.stick_start).groupby(data.stick_sample).sum()
    np.testing.assert_allclose(sums, kept.totals.stick_time[sums.stick_sample.to_numpy()], rtol=1e-12)


@pytest.mark.parametrize("keep", ["sticks", "statistics"])
def test_what_a_version_with_fewer_columns_stored_loads(keep):
    """A column that a file lacks is not known: NaN, and all else as it was."""
    whole = ss.simulate_ensemble(SYSTEM, POISSON, samples=90, keep=keep, **RUN)
    data = whole.to_xarray()
    back = ss.Ensemble.from_xarray(data.drop_vars([f"stick_{name}" for name in QUANTITIES]))
    for name in NUMBERS:
        column = getattr(back.finished_sticks(), name)
        if name in QUANTITIES:
            assert np.all(np.isnan(column))
        else:
            np.testing.assert_array_equal(column, getattr(whole.finished_sticks(), name))
    assert repr(back.summary()) == repr(whole.summary())
    again = ss.Ensemble.from_xarray(back.to_xarray())
    assert_same(back, again)
    with pytest.raises(ValueError, match=r"it lacks .*stick_position"):
        ss.Ensemble.from_xarray(data.drop_vars("stick_position"))


@pytest.mark.parametrize("missing", ["base_invalid", "solver_failed"])
def test_statuses_that_a_version_did_not_know_did_not_happen(kept, missing):
    data = kept.to_xarray()
    del data.attrs[f"samples_{missing}"]
    assert ss.Ensemble.from_xarray(data).status_counts == kept.status_counts


def test_statuses_that_happened_cannot_be_missing(kept):
    data = kept.to_xarray()
    data.attrs |= {"samples_finished": kept.samples - 1}
    message = r"\AArgument dataset must be a whole ensemble as it was stored, but .*; load the original file\.\Z"
    with pytest.raises(ValueError, match=message):
        ss.Ensemble.from_xarray(data)


def test_sums_that_a_version_did_not_make_are_missing(kept):
    """As of a quantity that was summed by later versions only; here all but the last of today's."""
    sums = kept.accumulator
    fewer = sums._replace(stick_bins=sums.stick_bins[:-1], order_bins=sums.order_bins[:-1])
    old = dataclasses.replace(kept, accumulator=fewer)
    last = STICK_QUANTITIES[-1].name
    assert old.statistics.missing == {last}
    assert last not in repr(old.summary())
    for of in (old.statistics, old.statistics.order(1)):
        with pytest.raises(ValueError, match=f"have no {last}"):
            getattr(of, last)
    with pytest.raises(ValueError, match=r"must have sums of the same quantities, but .* simulate the older"):
        ss.concatenate([old, dataclasses.replace(kept, key_data=(1, 2))])


@pytest.mark.slow
def test_a_class_of_ones_own_comes_back_as_a_stand_in(tmp_path, short):
    back = ss.load(short.save(tmp_path / "short.nc"))
    assert 0 < back.finished < 90
    assert back.status_counts == short.status_counts
    assert repr(back.summary()) == repr(short.summary())
    for name in NUMBERS:
        assert_same_arrays(getattr(back.flat_sticks, name), getattr(short.flat_sticks, name))
    assert_same_arrays(back.totals, short.totals)
    assert np.all(back.slips.count[back.totals.status != ss.Status.FINISHED] == 0)
    assert "_EndsEarly" in str(back.law)
    assert "rate=1.0" in str(back.law)
    for ask in (lambda: back.realization(0), lambda: back.extended(samples=1)):
        with pytest.raises(ValueError, match=r"This ensemble does not know its .*_EndsEarly") as caught:
            ask()
        assert "\n" not in str(caught.value)
    twice = ss.load(back.save(tmp_path / "again.nc"))
    assert str(twice.law) == str(back.law)


class _Own(ss.SwitchedSystem):
    """A pendulum of a user's own, whose first number is an angle."""

    stiffness: float = 4.0

    @property
    def shortest_time(self):
        return 3.0

    @property
    def state_names(self):
        return "angle in rad", "angular velocity in rad/s"

    def rates(self, t, y, base, friction):
        return y[1], -self.stiffness * y[0] - friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@pytest.mark.slow
def test_a_system_of_ones_own_leaves_its_sticks(tmp_path):
    law = ss.Harmonic(amplitude=1.0, angular_frequency=1.3)
    spread = ss.Uniform(3.9, 4.1)
    many = ss.simulate_ensemble(_Own(spread), ss.RandomPhase(law), t1=6.0, samples=8, key=KEY, keep="sticks")
    back = ss.load(many.save(tmp_path / "own.nc"))
    assert list(many.input_values) == ["stiffness"]
    with pytest.raises(ValueError, match=r"does not know its system .*_Own"):  # and not the inputs without it
        _ = back.input_values
    assert back.statistics.position.unit == "rad"
    assert back.statistics.position.mean == many.statistics.position.mean
    assert back.law == many.law
    assert plot.stick_map(back).get_xlabel() == "angle where the stick begins (rad)"
    assert_same_arrays(back.realization(3)[1:], many.realization(3)[1:])
    with pytest.raises(ValueError, match=r"Argument system must be a system that can be simulated.*_Own"):
        ss.simulate(back.system, law, t1=1.0)


METHODS = [
    ss.Exact(step=0.05), ss.Exact(solver=diffrax.Dopri8()), ss.Regularized(0.01, "tanh", step=0.002),
    ss.Regularized(0.01, rtol=1e-6, solver=diffrax.Tsit5()),
]  # fmt: skip
LAWS = [
    ss.SumOfHarmonics(np.arange(1, 41.0), np.linspace(0.1, 3, 40)),
    ss.PiecewiseConstant(jnp.array([0.0, 3.0]), jnp.array([1.0, -1.0])),
    ss.RandomSteps(speed=1.0, interval=0.7, levels=(-1.0, 0.5), probabilities=(0.25, 0.75)),
    ss.WithJumps(ss.RandomPhase(ss.Harmonic(1.0, 2.0)), POISSON), ss.KanaiTajimi(rms=1.0),
]  # fmt: skip


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_every_method_comes_back(kept, method):
    back = ss.Ensemble.from_xarray(dataclasses.replace(kept, method=method).to_xarray())
    assert repr(back.method) == repr(method)
    assert type(back.method) is type(method)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_every_law_comes_back(tmp_path, kept, law):
    back = ss.load(dataclasses.replace(kept, law=law).save(tmp_path / "many.nc"))
    assert type(back.law) is type(law)
    assert_same_arrays(back.law, law)
    assert [type(leaf) for leaf in jax.tree.leaves(back.law)] == [type(leaf) for leaf in jax.tree.leaves(law)]


@pytest.mark.usefixtures("annotations_unchecked")
def test_a_file_that_is_not_there_and_what_is_no_file(tmp_path, kept):
    with pytest.raises(FileNotFoundError, match=r"\AArgument path must name a file.*none\.nc'; the working folder is"):
        ss.load(tmp_path / "none.nc")
    with pytest.raises(ValueError, match="Argument path must be a file name, but 3 was given"):
        ss.load(3)
    with pytest.raises(ValueError, match=r"Argument path must be a file name that ends in \.nc, but '/"):
        kept.save(tmp_path / "many.csv")
    with pytest.raises(ValueError, match=r"Argument dataset must be what Ensemble\.to_xarray"):
        ss.Ensemble.from_xarray({"stick_start": [1.0]})


def test_a_file_whose_arrays_are_larger_than_the_memory(tmp_path):
    """A few kB that claim 8 TB, of which nothing was ever written."""
    path = tmp_path / "claims.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("stick_start", (10**12,), "f8", chunks=(10**6,), compression="gzip")
    assert path.stat().st_size < 1e5
    with pytest.raises(
        ValueError, match=r"\AArgument path must be smaller: what .*claims\.nc' holds would take about 8e\+03"
    ):
        ss.load(path)


def test_another_precision_draws_nothing_again(kept):
    single = dataclasses.replace(kept, dtype="float32")
    for ask in (lambda: single.realization(0), lambda: single.extended(samples=1)):
        with pytest.raises(ValueError, match="simulated in float32, and JAX is set to float64"):
            ask()
