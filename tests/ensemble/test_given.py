"""Ensembles of given data: simulations under vmap against `simulate_ensemble`, measured sticks against hand counts."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._dynamics.sticks import NUMBERS

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
KEY = jax.random.key(2026)
CAPACITY = POISSON.capacity(20.0)


def run_batch(keys, capacity=CAPACITY):
    def one(key):
        return ss.simulate(SYSTEM, POISSON.sample(key, 20.0, capacity=capacity), t1=20.0, y0=(0.0, 1.0))

    return jax.jit(jax.vmap(one))(keys)


@pytest.fixture(scope="module")
def batch():
    return run_batch(jax.vmap(lambda number: jax.random.fold_in(KEY, number))(jnp.arange(64)))


@pytest.fixture(scope="module")
def given(batch):
    return ss.Ensemble.from_simulations(batch)


@pytest.mark.slow
def test_simulations_are_the_ensemble_of_the_same_samples(given):
    """Both run the same arithmetic; compiled apart, the last places differ, amplified in 20 s to below 1e-11."""
    many = ss.simulate_ensemble(SYSTEM, POISSON, t1=20.0, samples=64, key=KEY, y0=(0.0, 1.0), keep="sticks")
    np.testing.assert_array_equal(given.flat_sticks.count, many.flat_sticks.count)
    for name in NUMBERS:
        np.testing.assert_allclose(getattr(given.flat_sticks, name), getattr(many.flat_sticks, name), atol=1e-11)
    for name in ("sticks", "slips", "status", "near_grazing_count"):
        np.testing.assert_array_equal(getattr(given.totals, name), getattr(many.totals, name))
    assert repr(given.summary()) == repr(many.summary())
    assert given.system == SYSTEM
    assert given.keep == "sticks"
    for statistic in (ss.stick_fraction, ss.mean_stick_duration, ss.mean_slip_count):
        ours, theirs = statistic(given), statistic(many)
        assert ours.value == pytest.approx(theirs.value, rel=1e-11)
        assert ours.standard_error == pytest.approx(theirs.standard_error, rel=1e-9)
    assert str(ss.identically_distributed(given)) == str(ss.identically_distributed(many))


@pytest.mark.slow
def test_simulations_know_their_motion_and_start(given, tmp_path):
    base = POISSON.sample(jax.random.fold_in(KEY, 5), 20.0)
    for many in (given, ss.load(given.save(tmp_path / "given.nc"))):
        _, found, y0 = many.realization(5)
        np.testing.assert_allclose(found.durations, base.durations, rtol=1e-15)
        np.testing.assert_array_equal(found.velocities, base.velocities)
        assert y0 == pytest.approx((0.0, 1.0), abs=1e-15)
        again = ss.simulate(many.system, found, t1=20.0, y0=y0)
        assert int(again.sticks.count) == many.flat_sticks.count[5]
        with pytest.raises(ValueError, match="made of given simulations, which cannot be extended"):
            many.extended(samples=1)


@pytest.mark.slow
def test_parameters_that_differ_are_arrays(tmp_path):
    mus = np.linspace(0.5, 1.0, 8)
    law = ss.SquareWave(speed=1.0, period=2.6)

    def one(mu):
        return ss.simulate(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), law.sample(None, 20.0, capacity=20), t1=20.0, y0=(mu, 0.0)
        )

    many = ss.Ensemble.from_simulations(jax.vmap(one)(jnp.asarray(mus)), count_initial_rest=True)
    assert many.numbering.count_initial_rest
    for read in (many, ss.load(many.save(tmp_path / "mus.nc"))):
        np.testing.assert_array_equal(read.system.friction.mu, mus)
        assert read.system.mass == 1.0
        assert [read.realization(number).y0[0] for number in range(8)] == pytest.approx(list(mus), rel=1e-15)
        assert read.realization(3).base.velocities.shape == (20,)
    joined = ss.concatenate([many, many])
    assert joined.samples == 16
    assert joined.realization(11).y0 == many.realization(3).y0


@pytest.mark.slow
def test_simulations_that_stopped_early_are_counted_apart():
    """With 20 intervals of mean 1 s, about half of the samples reach 20 s."""
    batch = run_batch(jax.random.split(KEY, 64), 20)
    many = ss.Ensemble.from_simulations(batch)
    finished = np.asarray(batch.status) == ss.Status.FINISHED
    assert 10 < many.finished == finished.sum() < 54
    assert many.status_counts[ss.Status.BASE_TOO_SHORT] == 64 - many.finished
    np.testing.assert_array_equal(many.flat_sticks.count, np.where(finished, batch.sticks.count, 0))
    assert ss.stick_fraction(many).value == pytest.approx(np.mean(np.asarray(batch.stick_time)[finished]) / 20)


@pytest.mark.slow
def test_angles_of_given_simulations_stay_in_a_circle():
    voltage = ss.SourceVoltage()

    def one(angle):
        return ss.simulate(ss.MotorCart(mu=0.5), voltage, t1=1.0, y0=(angle, 0.0, 0.0), method=ss.Exact(max_steps=4000))

    batch = jax.vmap(one)(jnp.linspace(0.1, 6.2, 8))
    positions = np.asarray(batch.sticks.position)[np.asarray(batch.sticks.mask)]
    assert positions.max() > 2 * np.pi
    many = ss.Ensemble.from_simulations(batch)
    np.testing.assert_array_equal(many.flat_sticks.position, np.mod(positions, 2 * np.pi))
    assert many.law == voltage


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_what_is_no_batch_is_refused(batch):
    one = ss.simulate(SYSTEM, ss.Constant(1.0), t1=1.0)
    for given, said in ((3, "but 3 was"), (one, r"one of shape \(\)"), (batch.sticks, "Sticks")):
        with pytest.raises(ValueError, match=rf"Argument result must be a batch of simulations.*{said}"):
            ss.Ensemble.from_simulations(given)
    several = jax.vmap(lambda t1: ss.simulate(SYSTEM, ss.VelocitySteps(jnp.array([9.0]), jnp.array([1.0])), t1=t1))
    with pytest.raises(ValueError, match="must hold simulations of the same duration t1, but durations from 1 to 2 s"):
        ss.Ensemble.from_simulations(several(jnp.array([1.0, 2.0])))
    with pytest.raises(ValueError, match="Argument result must hold numbers, but JAX is tracing them"):
        jax.jit(lambda one: ss.Ensemble.from_simulations(one).samples)(batch)


# --- measured sticks. Three recordings of 10 s; the third has none.
#   0: sticks 0 to 1, 3 to 3.5, 9 to 10 (cut)     1: a stick 4 to 6
TABLE = {
    "sample": [0, 1, 0, 0],
    "start": [3.0, 4.0, 0.0, 9.0],
    "end": [3.5, 6.0, 1.0, 10.0],
    "position": [0.2, -0.1, 0.0, 0.3],
}


@pytest.fixture(scope="module")
def measured():
    return ss.Ensemble.from_sticks(TABLE, t1=10.0, samples=3, orders=2)


def test_measured_sticks_by_hand(measured):
    flat = measured.flat_sticks
    assert flat.count.tolist() == [3, 1, 0]
    assert flat.start.tolist() == [0.0, 3.0, 9.0, 4.0]
    assert [ss.Ending(code).name for code in flat.ending] == ["RELEASED", "RELEASED", "HORIZON", "RELEASED"]
    assert measured.totals.slips.tolist() == [2, 2, 1]
    assert measured.totals.stick_time.tolist() == [2.5, 2.0, 0.0]
    assert ss.stick_fraction(measured).value == pytest.approx(4.5 / 30)
    # Over samples: 0.25, 0.2, 0 of 10 s; their standard deviation over sqrt(3).
    assert ss.stick_fraction(measured).standard_error == pytest.approx(np.std([0.25, 0.2, 0], ddof=1) / np.sqrt(3))
    assert ss.mean_slip_duration(measured).value == pytest.approx(25.5 / 5)
    assert ss.mean_stick_count(measured).value == pytest.approx(4 / 3)
    # Without the stick from t = 0: 0.5, 1 and 2 s.
    assert ss.mean_stick_duration(measured).value == pytest.approx(3.5 / 3)
    statistics = measured.statistics
    assert statistics.duration.number == 3
    assert statistics.duration.mean.value == pytest.approx(3.5 / 3)
    assert statistics.own_mean_duration.mean.value == pytest.approx((0.75 + 2.0) / 2)
    assert statistics.position.mean.value == pytest.approx((0.2 + 0.3 - 0.1) / 3)
    assert statistics.position.unit == "m"
    assert statistics.order(1).share.value == pytest.approx(2 / 3)
    assert statistics.order(1).duration.mean.value == pytest.approx((0.5 + 2.0) / 2)
    assert statistics.order(2).start.mean.value == 9.0
    assert statistics.endings[ss.Ending.HORIZON].value == pytest.approx(1 / 3)
    assert sorted(measured.to_xarray().slip_start.to_numpy().tolist()) == [0.0, 0.0, 1.0, 3.5, 6.0]
    assert measured.slips.duration[1, :2].tolist() == [4.0, 4.0]
    assert measured.slips.censored[:, -1].tolist() == [False, True, False]


def test_the_stick_at_the_start_counts_on_request():
    many = ss.Ensemble.from_sticks(TABLE, t1=10.0, samples=3, orders=2, count_initial_rest=True)
    assert ss.mean_stick_duration(many).value == many.statistics.duration.mean.value == pytest.approx(4.5 / 4)
    assert many.statistics.order(1).start.mean.value == 2.0
    assert many.statistics.own_mean_duration.mean.value == pytest.approx((2.5 / 3 + 2.0) / 2)


def test_figures_and_tests_of_measured_sticks():
    """Against the same numbers drawn from `simulate_ensemble`, by way of a data frame."""
    many = ss.simulate_ensemble(SYSTEM, POISSON, t1=20.0, samples=64, key=KEY, y0=(0.0, 1.0), keep="sticks")
    flat = many.flat_sticks
    table = pd.DataFrame({"sample": flat.sample, "start": flat.start, "duration": flat.duration})
    got = ss.Ensemble.from_sticks(table.sample(frac=1, random_state=1), t1=20.0, samples=64)
    np.testing.assert_allclose(got.flat_sticks.end, flat.end, rtol=1e-14)
    np.testing.assert_array_equal(got.flat_sticks.ending == ss.Ending.HORIZON, flat.ending == ss.Ending.HORIZON)
    rows = [repr(one.summary()).splitlines() for one in (many, got)]
    ours, theirs = (
        [line.split() for line in lines if line.startswith(("stick d", "slip", "number"))] for lines in rows
    )
    assert ours == theirs
    assert len(ours) == 2 * 4 + 1  # the table in two parts, and the head of the slips by order
    assert ss.independent(got).rejected == ss.independent(many).rejected
    for draw in (plot.histogram, plot.means_by_order, plot.stick_raster):
        draw(got).figure.draw_without_rendering()
    plot.histogram(got.statistics.duration)
    assert ss.first_stick(got).count == ss.first_stick(many).count


def test_what_was_not_measured_is_refused_in_words(tmp_path):
    table = {name: TABLE[name] for name in ("sample", "start", "end")}
    many = ss.Ensemble.from_sticks(table, t1=10.0, samples=3)
    many = ss.load(many.save(tmp_path / "measured.nc"))
    asked = {
        "no position, which was not measured": [
            lambda: many.statistics.position, lambda: many.statistics.joint("duration", "position"),
            lambda: many.statistics.order(1).position, lambda: ss.histogram_convergence(many),
            lambda: plot.means_by_order(many, "position"),
        ],
        "those of these sticks were not measured": [lambda: plot.stick_map(many), lambda: plot.joint_histogram(many)],
        "finite stick positions": [lambda: ss.independent(many, "position")],
        "does not know its base motion": [lambda: many.realization(0)],
        "does not know its system": [lambda: many.extended(samples=1)],
        "Argument system must be a system that can be simulated": [
            lambda: ss.simulate(many.system, ss.Constant(1.0), t1=1.0),
            lambda: ss.simulate_ensemble(many.system, POISSON, t1=1.0, samples=2, key=KEY),
        ],
    }  # fmt: skip
    for said, asks in asked.items():
        for ask in asks:
            with pytest.raises(ValueError, match=said) as caught:
                ask()
            assert "\n" not in str(caught.value)
    assert "stick position" not in repr(many.summary())
    assert not [name for name in many.statistics.to_xarray().variables if "position" in str(name)]
    assert "measured sticks" in repr(many)


exactly = (
    {"float_precision": "round_trip"} if int(pd.__version__.partition(".")[0]) < 3 else {}
)  # from 3 on the default
read_csv = functools.partial(pd.read_csv, **exactly)


@pytest.mark.parametrize(("ending", "read"), [(".csv", read_csv), (".parquet", pd.read_parquet)])
def test_tables_that_were_written_are_read(tmp_path, ending, read):
    many = ss.simulate_ensemble(SYSTEM, POISSON, t1=20.0, samples=64, key=KEY, y0=(0.0, 1.0), keep="sticks")
    got = ss.Ensemble.from_sticks(read(many.write_sticks(tmp_path / f"sticks{ending}")), t1=20.0, samples=64)
    for name in ("count", *NUMBERS, "ending"):
        np.testing.assert_array_equal(getattr(got.flat_sticks, name), getattr(many.flat_sticks, name))
    assert repr(got.summary()) == repr(many.summary())


def test_names_units_and_angles():
    table = {
        "sample": ["b", "a", "b"],
        "start_s": [1.0, 1.0, 3.0],
        "end_s": [2.0, 2.5, 4.0],
        "position_rad": [7.0, -1.0, 1.0],
    }
    many = ss.Ensemble.from_sticks(table, t1=5.0, period=2 * np.pi)
    assert many.flat_sticks.count.tolist() == [1, 2]
    assert many.statistics.position.unit == "rad"
    assert many.flat_sticks.position.tolist() == [2 * np.pi - 1, 7 - 2 * np.pi, 1.0]
    assert ss.load  # the period goes with it
    assert ss.Ensemble.from_xarray(many.to_xarray()).system.stick_position.period == 2 * np.pi


BAD_TABLES = {
    "no table": (3, {}, "must be a pandas DataFrame or a dict"),
    "no start": ({"sample": [0], "end": [1.0]}, {}, "its columns are 'sample', 'end'"),
    "no end": ({"sample": [0], "start": [1.0]}, {}, "end .s. or duration .s."),
    "milliseconds": ({"sample": [0], "start_ms": [1.0], "end_ms": [2.0]}, {}, "times in s.*'start_ms'; convert it"),
    "lengths": ({"sample": [0], "start": [1.0, 2.0], "end": [2.0, 3.0]}, {}, r"same length.*sample \(1,\)"),
    "text": ({"sample": [0], "start": ["1"], "end": [2.0]}, {}, "numbers in the column start"),
    "nan": ({"sample": [0, 0], "start": [1.0, 3.0], "end": [2.0, np.nan]}, {}, "finite numbers.*end, but its row 1"),
    "nan position": ({**TABLE, "position": [0.0, 1.0, np.nan, 2.0]}, {"samples": 3}, "column position, but its row 2"),
    "before 0": ({"sample": [0], "start": [-0.1], "end": [2.0]}, {}, "starts of 0 s or later, but its row 0"),
    "beyond t1": ({"sample": [0], "start": [1.0], "end": [10.1]}, {}, "ends of at most t1 = 10 s"),
    "no length": ({"sample": [0], "start": [1.0], "end": [1.0]}, {}, "sticks that end after they start"),
    "overlap": ({"sample": [0, 0], "start": [3.0, 1.0], "end": [4.0, 3.5]}, {}, "do not overlap, but its row 0"),
    "gap": ({"sample": [0, 2], "start": [1.0, 1.0], "end": [2.0, 2.0]}, {}, "samples must be given where.*gaps"),
    "none": ({"sample": [], "start": [], "end": []}, {}, "samples must be given for a table without sticks"),
    "more samples": (TABLE, {"samples": 1}, "sample numbers from 0 to 0"),
    "names": ({"sample": ["a", "b"], "start": [1.0, 1.0], "end": [2.0, 2.0]}, {"samples": 1}, "at least the 2 samples"),
    "halves": ({"sample": [0.5], "start": [1.0], "end": [2.0]}, {}, "whole numbers or names in the column sample"),
    "ending": ({"sample": [0], "start": [1.0], "end": [2.0], "ending": ["LOST"]}, {}, "RELEASED, BASE_SWITCHED or"),
    "t1": (TABLE, {"t1": -1.0}, "Argument t1 must be positive"),
    "orders": (TABLE, {"orders": 0}, "Argument orders must be"),
    "period": (TABLE, {"period": 0.0}, "Argument period must be positive"),
}


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("case", BAD_TABLES)
def test_a_bad_table_is_one_sentence(case):
    table, options, said = BAD_TABLES[case]
    with pytest.raises(ValueError, match=said) as caught:
        ss.Ensemble.from_sticks(table, **{"t1": 10.0, **options})
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("Argument ")


def test_samples_without_any_stick_are_an_ensemble():
    many = ss.Ensemble.from_sticks({"sample": [], "start": [], "end": []}, t1=10.0, samples=4)
    assert ss.mean_stick_count(many).value == 0
    assert ss.mean_slip_duration(many).value == 10.0
    assert many.slips.end.tolist() == [[10.0]] * 4
    assert "There is no stick." in repr(many.summary())
