"""The motor and cart against an independent integration, closed forms, the energy balance and finite differences."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.event_driven import simulate_motor_cart
from scipy import stats

import stickslip_jax as ss

KEY = jax.random.key(20220)
VOLTAGE = ss.SourceVoltage(phase=jnp.zeros(()))  # an array, as that of a realisation: compiled once for both
# Steps for 20 s, the longest run here, by default: shorter ones with as many are the same compiled function.
ROOM = ss.Exact(max_steps=24_576)
SAMPLES = {0.2: 1000, 0.5: 64}  # at mu = 0.2 one sample in twenty sticks again after the rest at the start


@functools.cache
def ensemble(mu: float, samples: int, **changed):
    setup = ss.papers.motor_cart(mu)
    return ss.simulate_ensemble(
        setup.system, setup.law, t1=setup.t1, y0=setup.y0, samples=samples, key=KEY, keep="sticks", **changed
    )


def reference_first_sticks(many, mu, numbers):
    """The first stick of some samples by the reference: start, end and angle, NaN where there is none."""
    rows = []
    for number in numbers:
        _, voltage, (angle, *_) = many.realization(int(number))
        run = simulate_motor_cart(
            mu=mu, theta=float(voltage.phase), alpha0=angle, t1=many.t1, stop_after_first_stick=True
        )
        later = [stick for stick in run.sticks if stick.start > 0]
        # Angles in an ensemble are those in one turn.
        found = (later[0].start, later[0].end, later[0].position % (2 * math.pi)) if later else (np.nan,) * 3
        rows.append(found)
    return np.array(rows)


def assert_first_sticks_agree(mu, samples, numbers):
    """None missed, none invented; starts, ends and angles to the mark of 1e-7 s, and rad."""
    many = ensemble(mu, samples)
    found, exact = ss.first_stick(many), reference_first_sticks(many, mu, numbers)
    np.testing.assert_array_equal(found.mask[numbers], np.isfinite(exact[:, 0]))
    got = np.stack([found.start, found.start + found.duration, found.position], axis=1)[numbers]
    worst = np.nanmax(np.abs(got - exact), axis=0)
    assert np.all(worst < 1e-7), worst


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.2, pytest.param(0.5, marks=pytest.mark.slow)])
def test_first_sticks_against_the_reference(mu):
    many = ensemble(mu, SAMPLES[mu])
    numbers = np.arange(64)
    if mu == 0.2:  # those that stick again, and some that do not
        numbers = np.concatenate([np.flatnonzero(ss.first_stick(many).mask), np.arange(24)])
    assert len(numbers) >= 50
    assert_first_sticks_agree(mu, SAMPLES[mu], numbers)


@pytest.mark.slow
@pytest.mark.parametrize("mu", SAMPLES)
def test_two_thousand_first_sticks_against_the_reference(mu):
    assert_first_sticks_agree(mu, 2000, np.arange(2000))


@pytest.mark.slow
def test_all_sticks_of_a_long_run_against_the_reference():
    voltage = ss.SourceVoltage(phase=jnp.array(2.0, float))
    one = ss.simulate(ss.MotorCart(mu=0.5), voltage, t1=10.0, y0=(0.7, 0.0, 0.0), method=ROOM)
    run = simulate_motor_cart(mu=0.5, theta=2.0, alpha0=0.7, t1=10.0)
    count = int(one.sticks.count)
    assert count == len(run.sticks) > 10
    for name in ("start", "end", "position"):
        exact = [getattr(stick, name) for stick in run.sticks]
        np.testing.assert_allclose(getattr(one.sticks, name)[:count], exact, rtol=0, atol=1e-7)
    endings = [ss.Ending(int(code)).name for code in one.sticks.ending[:count]]
    assert endings == [stick.ending for stick in run.sticks]
    np.testing.assert_allclose(one.final_state, run.final_state, rtol=1e-7, atol=1e-7)
    times = np.linspace(0, 10, 201)
    # The current moves by up to nu / l = 5000 A/s: an event 1e-8 s off shows as 5e-5 A for a while.
    exact = np.array([run.state_at(t) for t in times]).T
    np.testing.assert_allclose(np.stack(one.evaluate(times)), exact, rtol=1e-6, atol=1e-5)


@pytest.mark.slow
def test_the_printed_equation_is_another_motion():
    arguments = {"t1": 1.0, "y0": (0.7, 0.0, 0.0)}
    printed = ss.simulate(ss.MotorCart(mu=0.5, equation="printed"), VOLTAGE, **arguments)
    physical = ss.simulate(ss.MotorCart(mu=0.5), VOLTAGE, **arguments)
    run = simulate_motor_cart(mu=0.5, theta=0.0, alpha0=0.7, t1=1.0, equation="printed")
    np.testing.assert_allclose(printed.final_state, run.final_state, rtol=1e-7, atol=1e-7)
    assert abs(printed.final_state[0] - physical.final_state[0]) > 1e-2


@pytest.mark.slow
def test_convergence_in_the_step():
    """Runge-Kutta of order 8: the start of the first stick converges with slope 8, by least squares."""
    steps = np.array([2.4e-3, 2.0e-3, 1.6e-3, 1.3e-3])
    exact = simulate_motor_cart(mu=0.5, theta=1.0, alpha0=2.0, t1=1.0, stop_after_first_stick=True).sticks[-1].start

    def start(step):
        method = ss.Exact(step=step, max_steps=1600)
        sticks = ss.simulate(ss.MotorCart(0.5), ss.SourceVoltage(phase=1.0), t1=1.0, y0=(2.0, 0, 0), method=method)
        return sticks.sticks.start[1]

    errors = np.abs(np.asarray(jax.jit(jax.vmap(start))(steps)) - exact)
    assert errors[-1] < 1e-9
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 7 < slope < 10.5, (slope, errors)


# --- closed forms -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mu", "seconds"),
    [(0.1, 0.0), (0.2, 0.10315), (0.3, 0.2522), (0.4, 0.3668), (0.5, 0.50828), (0.6, math.inf), (1.0, math.inf)],
)
def test_bound_at_a_right_angle(mu, seconds):
    """The values of the closed form with g = 9.81, to the digits they are known to."""
    bound = float(ss.stick_duration_bound(ss.MotorCart(mu=mu), VOLTAGE, math.pi / 2))
    assert bound == pytest.approx(seconds, abs=5e-5 if mu in (0.3, 0.4) else 5e-6)


@pytest.mark.slow
def test_bound_as_an_array_and_its_support():
    angles = np.linspace(0, 2 * np.pi, 100_001)
    bound = np.asarray(ss.stick_duration_bound(ss.MotorCart(mu=0.2), VOLTAGE, angles))
    possible = 0.2 * np.abs(np.sin(angles)) > 0.176982
    np.testing.assert_array_equal(bound[possible] > 0, True)
    inside = angles[(bound > 0) & (angles < np.pi)]
    assert (inside[0], inside[-1]) == pytest.approx((1.0863, 2.0553), abs=1e-4)
    for_ever = np.isinf(ss.stick_duration_bound(ss.MotorCart(mu=1.0), VOLTAGE, angles))
    np.testing.assert_array_equal(for_ever, np.abs(np.sin(angles)) > 0.530931)


@jax.jit
@jax.vmap
def stronger_bound(mu):
    """The bound at a right angle for another friction coefficient."""
    return ss.stick_duration_bound(ss.MotorCart(mu=mu), VOLTAGE, math.pi / 2)


def bound_with_transient(system, angles):
    """The longest possible stick, the current's transient included.

    In a stick ``c = c_s + w exp(-r t / l)``. Both c and the steady current c_s are bounded, so ``|w| <= W``, with W the
    largest c that friction holds and the largest c_s together. Once ``W exp(-r t / l) < eta``, c_s stays below what is
    held plus eta as long as the stick lasts: no longer than the bound for friction stronger by eta, for any eta > 0.
    """
    sine = np.abs(np.sin(angles))
    held = float(system.largest_friction_torque) * sine / system.motor_constant  # as a current, A
    largest = held + (VOLTAGE.mean + VOLTAGE.amplitude) / system.resistance
    longest = np.full(len(angles), np.inf)
    for eta in np.geomspace(1e-5, 1, 60):
        mu = (held + eta) * system.motor_constant / (system.cart_mass * system.eccentricity * system.gravity)
        bound = np.asarray(stronger_bound(mu))
        wait = np.log(np.maximum(largest / eta, 1)) * system.inductance / system.resistance
        longest = np.minimum(longest, wait + bound)
    return longest


@pytest.mark.slow
@pytest.mark.parametrize("mu", SAMPLES)
def test_every_stick_is_under_the_bound(mu):
    many = ensemble(mu, SAMPLES[mu])
    sticks = many.flat_sticks
    duration = sticks.end - sticks.start
    assert len(duration) > 200
    chosen = np.argsort(duration - np.asarray(ss.stick_duration_bound(many.system, VOLTAGE, sticks.position)))[-40:]
    assert np.all(duration[chosen] <= bound_with_transient(many.system, sticks.position[chosen]))
    # The rest at the start begins without current, the worst transient; all others exceed the steady bound by less
    # than the electrical time constant.
    later = sticks.start > 0
    excess = (duration - np.asarray(ss.stick_duration_bound(many.system, VOLTAGE, sticks.position)))[later]
    assert excess.max() < many.system.inductance / many.system.resistance


def test_support_of_the_sticks():
    """At mu = 0.2 nothing sticks for longer than the transient outside the support of the closed form."""
    many = ensemble(0.2, SAMPLES[0.2])
    found = ss.first_stick(many)
    folded = np.mod(found.position[found.mask], np.pi)
    long = found.duration[found.mask] > 5e-3
    assert np.all((folded[long] > 1.0863) & (folded[long] < 2.0553))


# --- energy -----------------------------------------------------------------------------------------------------------


def energy_error(step):
    """Stored energy gained, less the source's work, plus what resistance, damping and friction took; and the work, J.

    Quadrature (Gauss-Legendre, 6 points) over the time steps of the states that `evaluate` gives.
    """
    system = ss.MotorCart(mu=0.5)
    one = ss.simulate(system, VOLTAGE, t1=1.0, y0=(0.7, 0.0, 0.0), method=ss.Exact(step=step))
    knots = np.unique(np.asarray(one.step_starts))
    nodes, weights = np.polynomial.legendre.leggauss(6)
    times = knots[:-1, None] + np.diff(knots)[:, None] * (nodes + 1) / 2
    angle, speed, current = (np.asarray(values) for values in one.evaluate(times))
    source = np.asarray(jax.vmap(VOLTAGE.value)(jnp.asarray(times.ravel()))).reshape(times.shape) * current
    friction = float(system.largest_friction_torque) * np.abs(np.sin(angle) * speed)
    power = source - system.resistance * current**2 - system.motor_damping * speed**2 - friction

    def stored(state):
        a, w, c = (float(value) for value in state)
        inertia = system.motor_inertia + system.cart_mass * system.eccentricity**2 * math.sin(a) ** 2
        return 0.5 * inertia * w**2 + 0.5 * system.inductance * c**2

    def over_time(values):
        return np.sum(values * weights / 2 * np.diff(knots)[:, None])

    gained = stored(one.final_state) - stored((0.7, 0.0, 0.0))
    return abs(gained - over_time(power)), over_time(np.abs(source))


@pytest.mark.slow
def test_energy_balance():
    """It closes to the flow's order, 8: a step of half the length leaves less than 2^-7 of the error."""
    (coarse, work), (fine, _) = energy_error(1.8e-3), energy_error(0.9e-3)
    assert coarse < 3e-8 * work
    assert fine < 2**-7 * coarse + 1e-13 * work


# --- derivatives and transformations ----------------------------------------------------------------------------------


def first_stick_of(mu, angle, phase, inductance, max_steps=1200):
    """Start, end and angle of the first stick after the rest at the start."""
    system = ss.MotorCart(mu=mu, inductance=inductance)
    method = ss.Exact(step=1e-3, max_steps=max_steps)
    sticks = ss.simulate(system, ss.SourceVoltage(phase=phase), t1=0.5, y0=(angle, 0.0, 0.0), method=method).sticks
    return jnp.stack([sticks.start[1], sticks.end[1], sticks.position[1]])


first = jax.jit(first_stick_of, static_argnames="max_steps")
POINT = (0.5, 3.7193706, 3.256997, 1.88e-4)


@pytest.mark.slow
def test_derivatives_of_event_times_against_the_reference():
    forward, reverse = (
        jax.jit(jax.jacfwd(first, (0, 1, 2, 3)))(*POINT),
        jax.jit(jax.jacrev(first, (0, 1, 2, 3)))(*POINT),
    )

    def exact(mu, angle, phase, inductance):
        run = simulate_motor_cart(mu=mu, theta=phase, alpha0=angle, t1=0.5, l=inductance, stop_after_first_stick=True)
        return np.array([run.sticks[1].start, run.sticks[1].end, run.sticks[1].position])

    np.testing.assert_allclose(first(*POINT), exact(*POINT), atol=1e-9)
    for index, step in enumerate((1e-4, 1e-4, 1e-4, 1e-7)):

        def moved(times, index=index, step=step):
            return exact(*(value + (times * step if place == index else 0) for place, value in enumerate(POINT)))

        # Richardson's extrapolation of central differences: error of fourth order in the step.
        difference = (8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / (12 * step)
        scale = np.abs(difference) + 1e-3 * np.abs(difference).max()
        assert np.all(np.abs(np.asarray(forward[index]) - difference) < 1e-6 * scale + 1e-9)
        np.testing.assert_allclose(reverse[index], forward[index], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_batches_equal_single_runs():
    angles = jnp.linspace(0.1, 6.0, 7)
    batch = jax.vmap(lambda angle: first(0.5, angle, 1.0, 1.88e-4))(angles)
    # By the function that is compiled for the other tests too.
    alone = first_stick_of(0.5, float(angles[3]), jnp.ones(()), 1.88e-4, max_steps=ROOM.max_steps)
    np.testing.assert_allclose(batch[3], alone, rtol=1e-12)


@pytest.mark.slow
def test_float32():
    """Event times in float32: a step's round-off in the speed (20 rad/s times 6e-8) over 1000 steps, about 1e-5 s."""
    exact = np.asarray(first(*POINT))
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        got = np.asarray(first(*(jnp.float32(value) for value in POINT)))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, exact, atol=3e-5)


# --- ensembles --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_sample_can_be_followed_again():
    many = ensemble(0.5, SAMPLES[0.5])
    found = ss.first_stick(many)
    for number in (0, 17, 63):
        _, voltage, y0 = many.realization(number)
        one = ss.simulate(many.system, voltage, t1=many.t1, y0=y0, method=ROOM)
        assert float(one.sticks.start[1]) == pytest.approx(found.start[number], rel=1e-10)
        assert int(one.sticks.count) == many.flat_sticks.count[number]


@pytest.mark.slow
def test_phase_and_angle_are_uniform_and_independent():
    many = ensemble(0.2, SAMPLES[0.2])
    phase, angle = np.array([
        (float(voltage.phase), y0[0]) for _, voltage, y0 in (many.realization(number) for number in range(800))
    ]).T  # fmt: skip
    for values in (phase, angle):
        assert stats.kstest(values / (2 * np.pi), "uniform").pvalue > 1e-3
    assert abs(stats.pearsonr(phase, angle).statistic) < 4 / math.sqrt(800)


def test_the_rest_at_the_start_is_an_explicit_choice():
    many = ensemble(0.5, SAMPLES[0.5])
    default, with_rest = ss.first_stick(many), ss.first_stick(many, count_initial_rest=True)
    assert with_rest.mask.all()
    np.testing.assert_array_equal(with_rest.start, 0)
    assert np.all(default.start[default.mask] > 0)
    np.testing.assert_array_equal(default.position[default.mask], many.sticks.position[default.mask, 1])
    assert "64" in repr(default)


# --- special starts and bad input -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_nothing_sticks_at_dead_center():
    one = ss.simulate(ss.MotorCart(mu=0.5), VOLTAGE, t1=0.05, y0=(0.0, 0.0, 0.0), method=ROOM)
    assert int(one.sticks.count) == 0
    assert int(one.status) == ss.Status.FINISHED
    moving = ss.simulate(ss.MotorCart(mu=0.5), VOLTAGE, t1=0.05, y0=(0.0, 5.0, 1.0), method=ROOM)
    run = simulate_motor_cart(mu=0.5, theta=0.0, alpha0=0.0, omega0=5.0, current0=1.0, t1=0.05)
    np.testing.assert_allclose(moving.final_state, run.final_state, rtol=1e-7)


def test_a_stick_for_ever():
    one = ss.simulate(ss.MotorCart(mu=0.6), VOLTAGE, t1=20.0, y0=(math.pi / 2, 0.0, 0.0))
    assert int(one.sticks.count) == 1
    assert int(one.sticks.ending[0]) == ss.Ending.HORIZON
    assert float(one.stick_fraction) == pytest.approx(1)


def test_no_friction_no_stick():
    one = ss.simulate(ss.MotorCart(mu=0.0), VOLTAGE, t1=0.5, y0=(1.0, 0.0, 0.0), method=ROOM)
    assert int(one.sticks.count) == 0
    assert int(one.status) == ss.Status.FINISHED


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ss.MotorCart(mu=-0.1), r"\AArgument mu must be zero or positive, but -0.1 was given\.\Z"),
        (
            lambda: ss.MotorCart(inductance=0.0),
            r"\AArgument inductance must be positive \(in H\), but 0.0 was",
        ),
        (
            lambda: ss.MotorCart(equation="P3"),
            r"\AArgument equation must be 'physical' or 'printed', but 'P3' was",
        ),
        (lambda: ss.SourceVoltage(angular_frequency=0.0), r"\AArgument angular_frequency must be positive"),
        (lambda: ss.RandomPhase(ss.Constant(1.0)), r"\AArgument signal must be a Harmonic"),
        (lambda: ss.Uniform(1.0, 1.0), r"\AArgument high must be above low = 1.0, but 1.0 was given\.\Z"),
        (
            lambda: ss.simulate(ss.MotorCart(), VOLTAGE, t1=1.0, y0=(0.0, 0.0)),
            r"\AArgument y0 must be three numbers \(angle in rad, angular velocity in rad/s, current in A\), but",
        ),
        (lambda: ss.simulate(ss.MotorCart(), ss.Constant(1.0), t1=1.0), r"\AArgument base of a MotorCart must be"),
        (
            lambda: ss.simulate(ss.MotorCart(), VOLTAGE, t1=1.0, method=ss.Exact(step=0.01)),
            r"\AArgument step must be at most .* times the (electrical|mechanical) time constant of",
        ),
        (
            lambda: ss.simulate(ss.MotorCart(), VOLTAGE, t1=1.0, y0=(ss.Uniform(0.0, 1.0), 0.0, 0.0)),
            r"\AArgument y0\[0\] must be one number here, .*simulate_ensemble",
        ),
        (
            lambda: ss.simulate(ss.MotorCart(), ss.RandomPhase(VOLTAGE), t1=1.0),
            r"\AArgument base must be a realis",
        ),
        (
            lambda: ss.simulate_ensemble(ss.MotorCart(), VOLTAGE, t1=1.0, samples=2, y0=(ss.Uniform(0.0, 1.0), 0, 0)),
            r"\AArgument key must be a key .* where law, system or y0 are random",
        ),
        (lambda: ss.stick_duration_bound(VOLTAGE, ss.MotorCart(), 1.0), r"\AArguments system and voltage must be"),
        (lambda: ss.first_stick(VOLTAGE), r"\AArgument ensemble must be the result of simulate_ensemble"),
        (lambda: ss.first_stick(ensemble(0.5, 64), count_initial_rest=1), r"\AArgument count_initial_rest must be"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
