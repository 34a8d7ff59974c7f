"""`simulate` under jit, vmap, jvp, grad and in float32; and that a lane which went wrong always says so."""

import faulthandler
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import filled, padded, random_set_up, simulate_compiled

import stickslip_jax as ss

SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
LAW = ss.PoissonSwitching(speed=0.3, rate=1.0)
T1, SLOTS, LANES = 20.0, 64, 4
START = (0.3, 0.1)


def one(key, mu=1.0, slots=SLOTS):
    """One realisation from its key."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
    return ss.simulate(system, LAW.sample(key, T1, capacity=slots), t1=T1, y0=START)


@pytest.fixture(scope="module")
def keys():
    return jax.random.split(jax.random.key(2), LANES)


@pytest.fixture(scope="module")
def lanes(keys):
    """Each key simulated by itself."""
    compiled = jax.jit(one)
    return [compiled(key) for key in keys]


def numbers(simulation):
    """Everything recorded, as numpy arrays."""
    return jax.tree.map(np.asarray, (simulation.sticks, simulation.totals, simulation.final_state, simulation.status))


def assert_close(got, expected, ulps=64):
    """Compilation may reorder sums and fuse products: equal to a few units in the last place of t1."""
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
        if np.issubdtype(np.asarray(b).dtype, np.floating):
            np.testing.assert_allclose(a, b, rtol=0, atol=ulps * np.finfo(float).eps * T1)
        else:
            np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_jit_changes_nothing(keys, lanes):
    assert_close(numbers(one(keys[0])), numbers(lanes[0]))


@pytest.mark.slow
def test_vmap_over_keys(keys, lanes):
    pick = jax.vmap(lambda key: numbers_in_jit(one(key)))(keys)
    for index, lane in enumerate(lanes):
        assert_close(jax.tree.map(lambda leaf, i=index: np.asarray(leaf)[i], pick), numbers(lane))


@pytest.mark.slow
def test_jit_of_vmap_over_keys(keys, lanes):
    many = jax.jit(jax.vmap(lambda key: numbers_in_jit(one(key))))(keys)
    for index, lane in enumerate(lanes):
        assert_close(jax.tree.map(lambda leaf, i=index: np.asarray(leaf)[i], many), numbers(lane))


def numbers_in_jit(simulation):
    return simulation.sticks, simulation.totals, simulation.final_state, simulation.status


@pytest.mark.slow
def test_vmap_over_a_parameter(keys):
    friction = jnp.asarray([0.0, 0.2, 1.0, 3.0])
    many = jax.jit(jax.vmap(lambda mu: numbers_in_jit(one(keys[0], mu))))(friction)
    alone = jax.jit(lambda mu: numbers_in_jit(one(keys[0], mu)))
    for index, mu in enumerate(friction):
        assert_close(jax.tree.map(lambda leaf, i=index: np.asarray(leaf)[i], many), alone(mu))


@pytest.mark.slow
def test_results_of_vmap_offer_their_properties(keys, lanes):
    """What can be asked of one simulation can be asked of a batch of them."""
    many = jax.vmap(one)(keys)
    for name in ("stick_time", "slip_time", "stick_fraction"):
        expected = [float(getattr(lane, name)) for lane in lanes]
        assert np.asarray(getattr(many, name)).tolist() == pytest.approx(expected, abs=1e-12)
    expected = np.transpose([[float(value) for value in lane.final_state] for lane in lanes])
    assert np.asarray(many.final_state) == pytest.approx(expected, abs=1e-12)
    assert np.asarray(many.sticks.count).tolist() == [int(lane.sticks.count) for lane in lanes]
    assert np.asarray(many.slips.count).tolist() == [int(lane.slips.count) for lane in lanes]
    assert "Simulation" in repr(many)


@pytest.mark.slow
def test_forward_and_reverse_derivatives_under_jit_and_vmap(keys):
    def stick_time(mu, key):
        return one(key, mu).stick_time

    slopes = jax.jit(jax.vmap(jax.grad(stick_time), in_axes=(None, 0)))(1.0, keys)
    _, tangents = jax.jit(jax.vmap(lambda key: jax.jvp(lambda mu: stick_time(mu, key), (1.0,), (1.0,))))(keys)
    np.testing.assert_allclose(slopes, tangents, rtol=1e-11, atol=1e-11)
    value, slope = jax.value_and_grad(stick_time)(1.0, keys[0])
    assert float(slope) == pytest.approx(float(slopes[0]), abs=1e-11)
    nearby = jax.jit(stick_time)(1.0 + 1e-6, keys[0])
    assert float(nearby - value) / 1e-6 == pytest.approx(float(slope), abs=1e-3)


@pytest.mark.slow
def test_spare_capacity_changes_nothing(keys):
    compiled = jax.jit(one, static_argnames="slots")
    for key in keys:
        little, much = compiled(key, slots=48), compiled(key, slots=80)
        small, large = filled(little), filled(much)
        for name in small._fields:
            assert getattr(small, name).tolist() == getattr(large, name).tolist()
        assert numbers(little)[1:] == numbers(much)[1:]


@pytest.mark.slow
@pytest.mark.parametrize("law", [ss.Constant(0.3), ss.PiecewiseConstant(jnp.array([0.0, 3.0]), jnp.array([0.3, -0.3]))])
def test_laws_without_randomness_are_simulated_as_they_are(law):
    plain = numbers(ss.simulate(SYSTEM, law, t1=T1, y0=START))
    sampled = numbers(ss.simulate(SYSTEM, law.sample(None, T1), t1=T1, y0=START))
    assert_close(plain, sampled)


@pytest.mark.slow_but_for("Constant-values0")
@pytest.mark.parametrize(
    ("make", "values"),
    [
        (ss.Constant, (0.3,)),
        (ss.PiecewiseConstant, (jnp.array([0.0, 3.0]), jnp.array([0.3, -0.3]))),
    ],
)
def test_laws_of_known_length_need_no_capacity_under_jit(make, values):
    """The number of their intervals does not hang on traced values."""

    @jax.jit
    def compiled(values, t1):
        return numbers_in_jit(ss.simulate(SYSTEM, make(*values), t1=t1, y0=START))

    assert_close(compiled(values, T1), numbers(ss.simulate(SYSTEM, make(*values), t1=T1, y0=START)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_float32_agrees_with_float64(seed):
    """One ulp of t1 for each of the twenty intervals bounds the clock's error; sticks wipe out the state's."""
    setup = random_set_up(0.6, 1.0, (1.0, -1.0), 20, seed=seed).merged()
    exact = filled(setup.simulate(32))
    with jax.enable_x64(False):
        base = padded(setup.durations, setup.velocities, 32)
        assert base.durations.dtype == jnp.float32
        with pytest.warns(UserWarning, match="float32"):
            simulation = ss.simulate(setup.system, base, t1=setup.t1, y0=(setup.position0, setup.velocity0))
        assert simulation.sticks.start.dtype == jnp.float32
        assert simulation.stick_time.dtype == jnp.float32
        rough = filled(simulation)
    assert rough.ending.tolist() == exact.ending.tolist()
    assert len(exact.start) >= 3
    tolerance = 20 * np.finfo(np.float32).eps * setup.t1
    np.testing.assert_allclose(rough.start, exact.start, rtol=0, atol=tolerance)
    np.testing.assert_allclose(rough.end, exact.end, rtol=0, atol=tolerance)
    np.testing.assert_allclose(rough.position, exact.position, rtol=0, atol=tolerance * setup.omega * setup.half_width)


@pytest.mark.slow
def test_float32_laws_draw_in_float32(keys):
    with jax.enable_x64(False):
        base = LAW.sample(keys[0], T1)
        steps = ss.RandomSteps(speed=1.0, interval=0.5).sample(keys[0], T1)
        wave = ss.SquareWave(speed=1.0, period=0.5).sample(None, T1)
        for sample in (base, steps, wave):
            assert sample.durations.dtype == sample.velocities.dtype == jnp.float32
            assert float(sample.durations.sum()) >= T1


@pytest.mark.slow
def test_base_too_short_is_reported(keys):
    assert int(one(keys[0], slots=4).status) == ss.Status.BASE_TOO_SHORT
    short = simulate_compiled(SYSTEM, padded((1.0, 2.0), (0.3, -0.3), 8), T1, START)
    assert int(short.status) == ss.Status.BASE_TOO_SHORT
    exactly = simulate_compiled(SYSTEM, padded((1.0, 2.0), (0.3, -0.3), 8), 3.0, START)
    assert int(exactly.status) == ss.Status.FINISHED


@pytest.mark.slow
def test_no_lane_is_silently_truncated(keys):
    """A capacity near the mean number of switches cuts some lanes and not others; each says which."""
    many = jax.random.split(jax.random.key(3), 200)
    capacity = 20
    bases = jax.vmap(lambda key: LAW.sample(key, T1, capacity=capacity))(many)
    reached = np.asarray(bases.durations.sum(axis=1)) >= T1
    small = jax.jit(jax.vmap(lambda key: numbers_in_jit(one(key, slots=capacity))))
    _, totals, _, statuses = small(many)
    assert 20 < reached.sum() < 180
    assert (np.asarray(statuses) == ss.Status.FINISHED).tolist() == reached.tolist()
    assert set(np.asarray(statuses)[~reached].tolist()) == {ss.Status.BASE_TOO_SHORT}
    assert np.all(np.isfinite(totals.stick_time))


NAN_CASES = ("mass", "stiffness", "normal_force", "mu", "speed", "rate", "t1", "position", "velocity")


@jax.jit
def from_numbers(mass, stiffness, normal_force, mu, speed, rate, t1, position, velocity):
    system = ss.MassSpring(mass, stiffness, normal_force, ss.Coulomb(mu))
    base = ss.PoissonSwitching(speed, rate).sample(jax.random.key(1), t1, capacity=SLOTS)
    return ss.simulate(system, base, t1=t1, y0=(position, velocity)).status


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name in NAN_CASES for value in (np.nan, np.inf) if (name, value) != ("stiffness", np.inf)],
)
def test_traced_value_that_is_not_finite_shows_in_the_status(name, value):
    """Under jit an argument cannot be looked at; the lane must not look finished."""
    values = dict(zip(NAN_CASES, (1.0, 4.0, 1.0, 1.0, 0.3, 1.0, T1, *START), strict=True))
    assert int(from_numbers(**values)) == ss.Status.FINISHED
    assert int(from_numbers(**(values | {name: value}))) != ss.Status.FINISHED


def test_infinite_stiffness_shows_in_the_status():
    """An endless loop inside compiled code cannot be interrupted: this process would then end and say where it was."""
    values = dict(zip(NAN_CASES, (1.0, np.inf, 1.0, 1.0, 0.3, 1.0, T1, *START), strict=True))
    faulthandler.dump_traceback_later(120, exit=True)
    try:
        assert int(from_numbers(**values)) == ss.Status.NOT_FINITE
    finally:
        faulthandler.cancel_dump_traceback_later()


@pytest.mark.slow
def test_infinite_stiffness_does_not_run_for_ever():
    """In its own process: an endless loop inside compiled code cannot be interrupted from within."""
    code = (
        "import jax, stickslip_jax as ss; jax.config.update('jax_enable_x64', True)\n"
        "run = jax.jit(lambda k: ss.simulate(ss.MassSpring(1.0, k, 1.0, ss.Coulomb(1.0)), "
        "ss.VelocitySteps(jax.numpy.array([9.0]), jax.numpy.array([0.3])), t1=5.0, y0=(0.3, 0.1)).status)\n"
        "print(int(run(float('inf'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=True)
    assert int(done.stdout) == ss.Status.NOT_FINITE


@jax.jit
def from_steps(durations, velocities):
    return ss.simulate(SYSTEM, ss.VelocitySteps(durations, velocities), t1=T1, y0=START).status


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("which", ["durations", "velocities"])
def test_nan_in_a_base_shows_in_the_status(which, index):
    base = {"durations": np.array([5.0, 6.0, 30.0]), "velocities": np.array([0.3, -0.3, 0.3])}
    assert int(from_steps(**base)) == ss.Status.FINISHED
    base[which][index] = np.nan
    assert int(from_steps(**base)) == ss.Status.BASE_INVALID


@pytest.mark.slow
def test_one_bad_lane_leaves_the_others_alone(keys):
    friction = jnp.asarray([1.0, np.nan, 1.0])
    _, totals, _, status = jax.jit(jax.vmap(lambda mu: numbers_in_jit(one(keys[0], mu))))(friction)
    assert np.asarray(status).tolist() == [ss.Status.FINISHED, ss.Status.NOT_FINITE, ss.Status.FINISHED]
    time = totals.stick_time
    assert float(time[0]) == float(time[2]) == pytest.approx(float(one(keys[0]).stick_time), abs=1e-12)


def test_states_at_times_of_any_shape():
    base = ss.SquareWave(speed=1.0, period=2.0).sample(None, 5.0)
    simulation = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), base, t1=5.0)
    times = np.array([[0.3, 1.0], [2.5, 4.9]])
    x, velocity = simulation.evaluate(times)
    assert x.shape == velocity.shape == times.shape
    for index in np.ndindex(times.shape):
        alone = simulation.evaluate(float(times[index]))
        assert alone[0].shape == ()
        assert float(alone[0]) == pytest.approx(float(x[index]), abs=1e-15)
        assert float(alone[1]) == pytest.approx(float(velocity[index]), abs=1e-15)


@pytest.mark.slow
def test_nothing_is_told_of_the_time_after_the_base_ran_out(keys):
    short, whole = one(keys[0], slots=4), one(keys[0])
    assert int(short.status) == ss.Status.BASE_TOO_SHORT
    assert "NOT FINISHED: stopped at" in repr(short)
    assert "fraction" not in repr(short)
    reached = float(short.time_reached)
    assert 0 < reached < 20
    times = np.array([0.5 * reached, 0.99 * reached, 1.01 * reached, 20.0])
    x, _ = short.evaluate(times)
    assert np.isnan(np.asarray(x)).tolist() == [False, False, True, True]
    np.testing.assert_allclose(x[:2], whole.evaluate(times[:2])[0], atol=1e-14)
    assert float(short.slip_time + short.stick_time) == pytest.approx(reached, abs=1e-14)
    assert float(np.nanmax(np.asarray(short.slips.end))) <= reached


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 7, pytest.param(256, marks=pytest.mark.slow), 300])
def test_base_motions_may_be_constants_of_a_compiled_function(number):
    """Arrays that a function closes over are constants in it; XLA aborted where a native loop read constants alone."""
    law = ss.PoissonSwitching(1.0, 1.0)
    capacity = law.capacity(10.0)
    keys = jax.random.split(jax.random.key(1), number)
    bases = jax.vmap(lambda key: law.sample(key, 10.0, capacity=capacity))(keys)

    def mean_time(mu, bases):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return jnp.mean(jax.vmap(lambda base: ss.simulate(system, base, t1=10.0, y0=(0.0, 1.0)).stick_time)(bases))

    constant = jax.jit(jax.value_and_grad(lambda mu: mean_time(mu, bases)))(0.9)
    np.testing.assert_allclose(constant, jax.jit(jax.value_and_grad(mean_time))(0.9, bases), rtol=1e-12)
    whole = jax.jit(lambda: mean_time(0.9, bases))()
    np.testing.assert_allclose(whole, constant[0], rtol=1e-12)
