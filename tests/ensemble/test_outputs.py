"""Outputs of a user's own: the numbers of `simulate` for each sample, whatever the chunk, the threads or the parts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.switched import engine
from stickslip_jax._ensemble import setup

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
KEY = jax.random.key(2026)
RUN = {"t1": 20.0, "y0": (0.0, 0.0), "key": KEY, "chunk": 64}
OUTPUTS = {
    "peak": ss.Output(lambda one: one.peak("position"), unit="m"),
    "longest": lambda one: jnp.max(jnp.where(one.sticks.mask, one.sticks.end - one.sticks.start, 0)),
    "number": lambda one: one.sticks.count,
}


@pytest.fixture(scope="module")
def many():
    return ss.simulate_ensemble(SYSTEM, POISSON, samples=150, keep="sticks", outputs=OUTPUTS, **RUN)


def one_of(ensemble, i):
    """Sample i alone."""
    system, base, y0 = ensemble.realization(i)
    return ss.simulate(system, base, t1=20.0, y0=y0, method=ensemble.method)


@pytest.mark.slow
def test_outputs_are_those_of_each_sample(many):
    for i in (0, 77, 149):
        one = one_of(many, i)
        assert many.output_values["peak"][i] == pytest.approx(float(one.peak()), rel=1e-9)
    np.testing.assert_array_equal(many.output_values["number"], many.sticks.count)
    longest = np.where(many.sticks.mask, many.sticks.end - many.sticks.start, 0).max(axis=1)
    np.testing.assert_allclose(many.output_values["longest"], longest, rtol=1e-9)


@pytest.mark.slow
def test_distributions(many):
    peaks, found = many.output_values["peak"], many.outputs["peak"]
    assert found.mean.value == pytest.approx(peaks.mean(), rel=1e-13)
    assert found.mean.standard_error == pytest.approx(peaks.std(ddof=1) / np.sqrt(150), rel=1e-12)
    assert found.quantile(0.9).value == pytest.approx(np.quantile(peaks, 0.9), abs=2e-2)
    assert (found.number, found.unit, found.largest) == (150, "m", peaks.max())
    assert many.outputs["number"].is_whole
    assert many.outputs["number"].mean.value == pytest.approx(ss.mean_stick_count(many).value, rel=1e-13)
    assert "\nOutputs\n" in repr(many.summary())
    assert "peak (m)" in repr(many.summary())
    assert "outputs   peak, longest, number" in repr(many)
    assert "mean of peak" in many._repr_html_()


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed", [{"chunk": 37}, {"threads": 3}, {"samples": 70}, {"keep": "totals"}, {"keep": "statistics"}]
)
def test_the_same_bits_whatever_the_chunk_or_threads(many, changed):
    other = ss.simulate_ensemble(SYSTEM, POISSON, **{"samples": 150, "outputs": OUTPUTS, **RUN, **changed})
    for name, values in other.output_values.items():
        np.testing.assert_array_equal(values, many.output_values[name][: other.samples])


@pytest.mark.slow
def test_joined_and_extended(many):
    first = ss.simulate_ensemble(SYSTEM, POISSON, samples=100, keep="sticks", outputs=OUTPUTS, **RUN)
    last = ss.simulate_ensemble(SYSTEM, POISSON, samples=50, first_sample=100, keep="sticks", outputs=OUTPUTS, **RUN)
    for whole in (first.extended(samples=50), ss.concatenate([first, last])):
        for name, values in many.output_values.items():
            np.testing.assert_array_equal(whole.output_values[name], values)
        assert whole.output_functions == {name: getattr(one, "function", one) for name, one in OUTPUTS.items()}
    with pytest.raises(ValueError, match="must have the same names and units of outputs"):
        ss.concatenate(
            [first, ss.simulate_ensemble(SYSTEM, POISSON, samples=8, first_sample=100, keep="sticks", **RUN)]
        )


@pytest.mark.slow
@pytest.mark.parametrize("keep", ["sticks", "statistics", "totals"])
def test_stored(keep, tmp_path):
    stored = ss.simulate_ensemble(SYSTEM, POISSON, samples=20, keep=keep, outputs=OUTPUTS, **RUN)
    back = ss.load(stored.save(tmp_path / "some.nc"))
    for name, values in stored.output_values.items():
        np.testing.assert_array_equal(back.output_values[name], values)
    assert back.outputs["peak"].unit == "m"
    assert repr(back.outputs["longest"]) == repr(stored.outputs["longest"])
    variable = stored.to_xarray()["output_peak"]
    assert (variable.dims, variable.attrs["units"]) == (("sample",), "m")
    with pytest.raises(ValueError, match=r"functions of its outputs \(peak, longest, number\) are not known"):
        back.extended(samples=5)


class _EndsEarly(ss.PoissonSwitching):
    """A law of a user's own, in which some samples have too few intervals."""

    def draw(self, key_data, number, dtype):
        return jnp.where(number < 3, super().draw(key_data, number, dtype), 0)


@pytest.mark.slow
def test_samples_that_do_not_finish_have_no_value():
    short = ss.simulate_ensemble(
        SYSTEM, _EndsEarly(1.0, 1.0), samples=90, keep="totals", outputs={"peak": lambda one: one.peak()},
        **{**RUN, "t1": 3.0},
    )  # fmt: skip
    unfinished = short.totals.status != ss.Status.FINISHED
    assert 0 < unfinished.sum() < 90
    np.testing.assert_array_equal(np.isnan(short.output_values["peak"]), unfinished)
    assert short.outputs["peak"].number == short.finished


@pytest.mark.slow
def test_values_that_are_not_defined_are_told():
    first = {"first": lambda one: jnp.where(one.sticks.count > 0, one.sticks.start[0], jnp.nan)}
    some = ss.simulate_ensemble(SYSTEM, POISSON, samples=64, outputs=first, **{**RUN, "t1": 2.0})
    without = int(np.sum(some.statistics.totals[:, 1] == 0))
    assert 0 < without < 64
    assert some.outputs["first"].number == 64 - without
    assert f"NO VALUE of first in {without} finished samples" in repr(some)
    assert f"NO VALUE of first in {without} finished samples" in repr(some.summary())


UNCERTAIN = {
    "start": (SYSTEM, POISSON, (ss.Uniform(0.0, 0.5), 1.0)),
    "system": (ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(ss.Uniform(0.5, 1.0))), POISSON, (0.0, 1.0)),
    "rate": (SYSTEM, ss.PoissonSwitching(1.0, ss.Uniform(0.5, 2.0)), (0.0, 1.0)),
    "steps": (
        ss.MassSpring(1.0, ss.Uniform(3.0, 5.0), 1.0, ss.Coulomb(0.8), damping=0.1),
        ss.RandomPhase(ss.Harmonic(1.0, 1.3)), (0.0, 1.0)
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in ("rate", "steps") else name for name in UNCERTAIN]
)
def test_uncertain_models(name):
    system, law, y0 = UNCERTAIN[name]
    some = ss.simulate_ensemble(
        system, law, samples=70, outputs={"peak": lambda one: one.peak("velocity")}, **{**RUN, "y0": y0}
    )
    for i in (0, 69):
        assert some.output_values["peak"][i] == pytest.approx(float(one_of(some, i).peak("velocity")), rel=1e-8)


@pytest.mark.slow
def test_samples_that_need_more_steps_get_them(monkeypatch):
    """Under jit the number of steps is fixed; those for whom it is too small are simulated again."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8), damping=0.1)
    grid = jnp.linspace(0.0, 20.0, 101)
    run = {**RUN, "samples": 12, "outputs": {"peak": lambda one: jnp.max(one.evaluate(grid)[1])}}
    enough = ss.simulate_ensemble(system, ss.RandomPhase(ss.Harmonic(1.0, 1.3)), **run)
    monkeypatch.setattr(engine, "steps_for", lambda *_: 64)
    again = ss.simulate_ensemble(system, ss.RandomPhase(ss.Harmonic(1.0, 1.3)), **run)
    np.testing.assert_allclose(again.output_values["peak"], enough.output_values["peak"], rtol=1e-12)


@pytest.mark.slow
def test_sobol_indices_of_an_output():
    """Of a free vibration the first maximum is ``-a + hypot(a, v / omega)``: by v alone where mu has no spread."""
    design = ss.design.saltelli(64, ["mu", "y0[1]"])
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(ss.Uniform(0.999, 1.0)))
    some = ss.simulate_ensemble(
        system, ss.Constant(0.0), t1=3.0, samples=design, y0=(0.0, ss.Uniform(1.0, 2.0)), key=KEY,
        outputs={"peak": lambda one: one.maximum()},
    )  # fmt: skip
    mu, v = some.input_values["mu"], some.input_values["y0[1]"]
    expected = -mu / 4 + np.hypot(mu / 4, v / 2)
    np.testing.assert_allclose(some.output_values["peak"], expected, rtol=1e-12)
    indices = ss.sobol_indices(some.output_values, design, resamples=100)
    assert indices.outputs == ("peak",)
    assert indices.total[1, 0] == pytest.approx(1.0, abs=1e-3)
    assert indices.total[0, 0] == pytest.approx(0.0, abs=1e-3)


# What asks for nothing but ends and extremes is found as samples are simulated.


def storeys(mu=0.06, number=3):
    """A building on a sliding bearing, of friction coefficient `mu`."""
    return ss.storeys_on_bearing(
        [2e5] * number, stiffness=[8e7] * (number - 1), damping=[4e5] * (number - 1), friction=ss.Coulomb(mu)
    )


TIMES = np.arange(0, 3.001, 0.02)
QUAKE = ss.GroundAcceleration(TIMES, 3.0 * np.sin(9 * TIMES) * np.exp(-((TIMES - 1) ** 2)))
DAMPED = ss.MassSpring(1.0, ss.Uniform(3.0, 5.0), 1.0, ss.Coulomb(0.8), damping=0.1)
SWINGING = ss.RandomPhase(ss.Harmonic(1.0, 1.3))
MASS = {
    "highest": lambda one: one.maximum(),
    "lowest": lambda one: one.minimum("velocity"),
    "end": lambda one: one.final_state[1] * one.system.stiffness,
    "share": lambda one: one.stick_fraction,
    "number": lambda one: one.totals.sticks - one.totals.censored,
}
BUILDING = {
    "peak": lambda one: one.peak("position 0"),
    "drift": lambda one: one.peak("position 1 - position 0"),
    "closing": lambda one: one.minimum("position 2 - position 1"),
    "left": lambda one: one.final_state[0],
    "share": lambda one: one.stick_fraction,
}
ROW = ss.block_row(2, mass=1.0, between=1.2, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.4, 0.5))
ROW_START = (ss.Uniform(0.0, 0.3), 0.1, 0.0, 0.0)
ROW_OUTPUTS = {"drift": BUILDING["drift"], "share": BUILDING["share"]}
BRISTLES = ss.LuGre(0.5, 0.6, stribeck_speed=0.1, stiffness=1e3, damping=10.0)
CART = ss.papers.motor_cart(0.2)
CART_OUTPUTS = {"angle": lambda one: one.maximum(), "current": lambda one: one.peak("current")}
IN_PASS = {
    "building": (storeys(ss.Uniform(0.03, 0.08)), QUAKE, {}, BUILDING),
    "intervals": (SYSTEM, POISSON, {}, MASS),
    "steps": (DAMPED, SWINGING, {}, MASS),
    "Runge-Kutta": (ss.MassSpring(1.0, 4.0, 1.0, ss.Stribeck(0.5, 0.7, 0.3)), SWINGING, {}, MASS),
    "fixed": (SYSTEM, SWINGING, {"method": ss.Regularized(1e-2, step=1e-2)}, MASS),
    "adaptive": (SYSTEM, SWINGING, {"method": ss.Regularized(1e-2)}, MASS),
    "bristles": (ss.MassSpring(1.0, 4.0, 1.0, BRISTLES), SWINGING, {"method": ss.Regularized()}, MASS),
    "all contacts": (ROW.of_all_contacts(), ss.PoissonSwitching(0.3, 0.5), {"y0": ROW_START}, ROW_OUTPUTS),
    "cart": (CART.system, CART.law, {"y0": CART.y0}, CART_OUTPUTS),
}  # fmt: skip
QUICK = ("intervals",)


@pytest.mark.parametrize("keep", ["totals", pytest.param("sticks", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in IN_PASS]
)
def test_found_in_the_pass(name, keep, monkeypatch):
    system, law, options, outputs = IN_PASS[name]
    monkeypatch.setattr(setup, "OutputRunner", None)  # what would simulate once more
    some = ss.simulate_ensemble(
        system, law, samples=20, keep=keep, outputs=outputs, threads=1,
        **{"t1": 3.0, "key": KEY, "method": ss.Exact()} | options,
    )  # fmt: skip
    assert some.finished == 20
    for i in (0, 13, 19):
        system, base, y0 = some.realization(i)
        one = ss.simulate(system, base, t1=3.0, y0=y0, method=some.method)
        for output, function in outputs.items():
            # Adaptive steps, chosen by errors, differ by what round-off does to these: in between there are quartics.
            rel = 1e-7 if name in ("adaptive", "bristles") else 1e-9
            assert some.output_values[output][i] == pytest.approx(float(function(one)), rel=rel, abs=1e-12), output


@pytest.mark.slow
def test_found_in_the_pass_with_the_same_bits():
    """Whatever the chunk, the threads, the number of samples, and beside what asks for a path."""
    run = {"t1": 3.0, "key": KEY, "samples": 150, "keep": "totals", "outputs": BUILDING, "chunk": 64}
    system = IN_PASS["building"][0]
    whole = ss.simulate_ensemble(system, QUAKE, **run)
    path = {"middle": lambda one: one.evaluate(1.5)[0]}
    for changed in ({"chunk": 37}, {"threads": 3}, {"samples": 70}, {"outputs": path | BUILDING}):
        other = ss.simulate_ensemble(system, QUAKE, **run | changed)
        assert list(other.output_values) == list((run | changed)["outputs"])
        for name in BUILDING:
            np.testing.assert_array_equal(other.output_values[name], whole.output_values[name][: other.samples])
    assert np.all(np.abs(other.output_values["middle"]) <= whole.output_values["peak"])


@pytest.mark.slow
def test_of_a_damped_building_natively():
    """XLA would refuse its native loop, with a warning, of as many lanes as other systems have."""
    some = ss.simulate_ensemble(
        storeys(number=7), QUAKE, t1=3.0, samples=8, key=KEY, keep="totals", outputs=BUILDING, threads=1
    )
    one = ss.simulate(storeys(number=7), QUAKE, t1=3.0)
    assert some.output_values["drift"] == pytest.approx(float(BUILDING["drift"](one)), rel=1e-10)


def test_differences_of_coordinates():
    """They are of a unit; in a grid of times nothing exceeds them, and they come near."""
    one, times = ss.simulate(ROW, ss.Constant(0.3), t1=3.0, y0=(0.2, 0.1, 0.0, 0.0)), np.linspace(0, 3, 3001)
    y = one.evaluate(times)
    stretch = np.asarray(y[1] - y[0])
    for found, largest in ((one.maximum, stretch.max()), (lambda name: -one.minimum(name), (-stretch).max())):
        exact = float(found("position 1 - position 0"))
        assert largest <= exact + 1e-12 < largest + 1e-5
    for wrong in ("position 1 - velocity 0", "position 1 - position 9", "position 1 + position 0"):
        with pytest.raises(ValueError, match="Argument coordinate must be one of"):
            one.peak(wrong)


BAD = {
    "no dict": ([len], "Argument outputs must be a dict from names to functions"),
    "no name": ({"a b": len}, "must have names that can be names in Python"),
    "taken": ({"stick_fraction": len}, "'stick_fraction' is the name of a statistic"),
    "no function": ({"peak": 3.0}, r"Argument outputs\['peak'\] must be a function of a Simulation"),
    "an array": ({"all": lambda one: one.sticks.start}, r"one number .* it returned an array of shape"),
    "nothing": ({"none": lambda one: None}, "it returned None"),
    "a word": ({"word": lambda one: "peak"}, "it returned 'peak'"),
    "it raises": ({"fails": lambda one: one.peak("speed")}, "it raised ValueError: Argument coordinate must be one of"),
    "numpy": ({"peak": lambda one: np.max(np.asarray(one.evaluate(jnp.arange(3.0))[0]))}, "that JAX can trace"),
    "an if": ({"some": lambda one: 1.0 if one.stick_time > 0 else 0.0}, "that JAX can trace"),
    "float": ({"time": lambda one: float(one.stick_time)}, "that JAX can trace"),
}


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("name", BAD)
def test_bad_outputs(name):
    outputs, message = BAD[name]
    with pytest.raises(ValueError, match=message) as caught:
        ss.simulate_ensemble(SYSTEM, POISSON, samples=4, outputs=outputs, **RUN)
    assert "\n" not in str(caught.value)
