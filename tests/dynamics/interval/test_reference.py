"""The package against the independent 40-digit reference: event times, event states and end state, apart."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import SetUp, errors_against, filled, random_set_up, simulate_compiled

import stickslip_jax as ss

# What is demanded. Round-off of 1e-16 grows by the steepness of an arrival, 1 / sin of the angle at which an arc meets
# the base velocity; the worst of the runs below, a stick entered almost tangentially, loses four digits.
TOLERANCE = 1e-9
COUNT, SLOTS = 240, 400
SPEEDS = (0.05, 0.3, 1.0, 2.0, 5.0, 20.0)
RATES = (0.2, 1.0, 5.0)
LEVELS = {
    "both signs": (1.0, -1.0),
    # None is 1: released at w = 2 exactly, the mass would come to rest on a base at rest exactly on the far edge of
    # the band, h = 2 a, where round-off decides between a stick and a detour of half a period.
    "with rest": (0.0, 0.97, -1.03, 0.5, -0.3),
    # A mass released at one of these comes back to the same velocity on the same arc: R = w up to round-off.
    "tangent returns": (0.5, 1.0, 0.5, 0.7, 1.3),
}


def assert_agrees(setup, simulation, tolerance=TOLERANCE):
    run = setup.reference()
    errors = errors_against(run, simulation, setup)
    assert max(errors) < tolerance, errors
    return run


@pytest.mark.slow
@pytest.mark.parametrize("levels", LEVELS)
@pytest.mark.parametrize("w", SPEEDS)
def test_random_levels(w, levels):
    sticks = crossings = 0
    for number, rate in enumerate(RATES):
        setup = random_set_up(w, rate, LEVELS[levels], COUNT, seed=[number, int(100 * w), len(levels)], amplitude=3)
        run = assert_agrees(setup, setup.simulate(SLOTS))
        sticks, crossings = sticks + len(run.sticks), crossings + run.crossings
    # The comparison must not be empty: fast bases hardly let the mass stick, but even there it does.
    assert sticks >= 2
    assert crossings >= 3


@pytest.mark.slow
@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("w", SPEEDS)
def test_poisson_switching(w, rate):
    mass, stiffness, normal_force, mu = 1.3, 4.2, 2.1, 0.35
    omega, a = math.sqrt(stiffness / mass), mu * normal_force / stiffness
    t1 = COUNT / (rate * omega)
    law = ss.PoissonSwitching(speed=w * a * omega, rate=rate * omega)
    base = law.sample(jax.random.key(int(100 * w + rate)), t1, capacity=SLOTS)
    durations, velocities = (tuple(values.tolist()) for values in (base.durations, base.velocities))
    setup = SetUp(mass, stiffness, normal_force, mu, durations, velocities, t1, 2 * a * (1 + w), 0.1 * w * a * omega)
    simulation = simulate_compiled(setup.system, base, t1, (setup.position0, setup.velocity0))
    assert_agrees(setup, simulation)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_long_visits_to_a_release_velocity_invent_no_stick(seed):
    """Slow one-signed levels: the mass is released and stays on an arc that its base grazes again and again."""
    w = (0.02, 0.03, 0.05, 0.08, 0.12, 0.2)[seed % 6]
    setup = random_set_up(w, 0.5 + seed % 4, LEVELS["tangent returns"], 390, seed=[seed, 99])
    assert_agrees(setup, setup.simulate(SLOTS))


@pytest.mark.slow
@pytest.mark.parametrize("w", [0.05, 0.5, 5.0])
def test_release_arc_stays_free_through_thousands_of_intervals(w):
    """Round-off of R^2 - w^2 grows as the square root of their number, to a hundred ulps here; it is no arrival."""
    count = 20_000
    durations = np.random.default_rng(0).exponential(1.0, count)
    durations[0] = 2 / w + 0.1
    base = ss.VelocitySteps(jnp.asarray(durations), jnp.asarray(np.resize([w, 2 * w], count)))
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.0))
    simulation = simulate_compiled(system, base, float(durations.sum()), (-1.0, w))
    assert filled(simulation).ending.tolist() == [ss.Ending.RELEASED]
    x, speed = (float(value) for value in simulation.final_state)
    assert math.hypot(x - 1, speed) == pytest.approx(w, rel=1e-12 * (1 + 1 / w))


@pytest.mark.slow
@pytest.mark.parametrize("before", [3.9, 4.1, 4.5, 6.0, 10.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_tangent_return(before, sign):
    velocities = (0.5 * sign, sign, 0.5 * sign)
    setup = SetUp(1.0, 1.0, 1.0, 1.0, (before, 1.25, 40.0), velocities, before + 31.25, -sign, 0.5 * sign)
    run = assert_agrees(setup, setup.simulate(SLOTS))
    assert run.sticks[0].start == 0


def set_up_from_the_lower_edge(w, durations, velocities):
    """A stick from ``z = -1/2`` that is released after ``1.5 / w``; durations in 1 / omega, from the release on."""
    mass, stiffness, normal_force, mu = 1.3, 4.2, 2.1, 0.35
    omega, a = math.sqrt(stiffness / mass), mu * normal_force / stiffness
    lengths = tuple(value / omega for value in (durations[0] + 1.5 / abs(w), *durations[1:]))
    speeds = tuple(value * w * a * omega for value in velocities)
    t1 = sum(lengths)
    return SetUp(mass, stiffness, normal_force, mu, lengths, speeds, t1, -0.5 * math.copysign(a, w), speeds[0])


@pytest.mark.parametrize("moment", [1.7, 1.9, 2.3, 2.9, 3.7, 4.3, 4.5])
@pytest.mark.parametrize("w", [0.1, 0.3, 0.9, -0.3])
def test_tangent_return_after_a_rest(w, moment):
    """Caught by a base at rest and set off again at its release velocity, the mass is back on an arc of radius w."""
    setup = set_up_from_the_lower_edge(w, (moment, 7.0, 16.0, 1.3, 16.0), (1, 0, 1, 2, 1))
    run = assert_agrees(setup, setup.simulate(SLOTS))
    assert [stick.ending for stick in run.sticks] == ["RELEASED", "BASE_SWITCHED"]


@pytest.mark.parametrize("moment", [1.7, 1.9, 2.3, 2.9, 3.7, 4.3, 4.5])
@pytest.mark.parametrize("w", [1.05, 1.3, 1.7, -1.3])
def test_tangent_return_after_a_detour(w, moment):
    """The same, with an arc about the other centre between two rests at the same place, z = 1 - w."""
    setup = set_up_from_the_lower_edge(w, (moment, 7.0, 4.4, 7.0, 16.0, 1.3, 16.0), (1, 0, -1, 0, 1, 2, 1))
    run = assert_agrees(setup, setup.simulate(SLOTS))
    assert [stick.ending for stick in run.sticks] == ["RELEASED", "BASE_SWITCHED", "BASE_SWITCHED"]


@pytest.mark.parametrize("w", [0.1, 1.0, 7.0])
def test_thousandfold_amplitude_in_one_interval(w):
    omega, a = math.sqrt(4.2 / 1.3), 0.35 * 2.1 / 4.2
    duration = 2000.0 / omega
    setup = SetUp(1.3, 4.2, 2.1, 0.35, (duration,), (w * a * omega,), duration, 1000 * a, 0.0)
    run = assert_agrees(setup, setup.simulate(SLOTS))
    assert run.crossings > 450


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("w", [0.3, 5.0])
def test_thousandfold_amplitude_in_random_gaps(w, rate):
    setup = random_set_up(w, rate, (1.0, -1.0, 0.0), 390, seed=[7, int(10 * w), int(100 * rate)])
    setup = setup._replace(position0=1000 * setup.half_width)
    run = assert_agrees(setup, setup.simulate(SLOTS))
    assert run.crossings > 100


# Numbers that are exact in binary: "exactly on the edge" is then exact on both sides. omega = 4, a = 0.5.
EXACT = {"mass": 0.25, "stiffness": 4.0, "normal_force": 2.0, "mu": 1.0}


@pytest.mark.parametrize("position", [-2.5, -1.5, -0.75, -0.5, -0.15, 0.0, 0.15, 0.5, 0.75, 1.5, 2.5])
@pytest.mark.parametrize("speed", [0.0, 1.0, -1.0, 4.0, -4.0])
def test_start_exactly_on_the_base_velocity(speed, position):
    """Inside the stick band, on its edges and outside; `speed` 0 is a mass at rest on a base at rest."""
    setup = SetUp(**EXACT, durations=(8.0,), velocities=(speed,), t1=8.0, position0=position, velocity0=speed)
    assert_agrees(setup, setup.simulate(SLOTS), tolerance=1e-13)


@pytest.mark.parametrize("position", [-0.75, -0.5, 0.0, 0.5, 0.75])
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_rest_until_the_base_moves(speed, position):
    setup = SetUp(**EXACT, durations=(3.0, 9.0), velocities=(0.0, speed), t1=10.0, position0=position, velocity0=0.0)
    assert_agrees(setup, setup.simulate(SLOTS), tolerance=1e-13)


@pytest.mark.parametrize("w", [0.5, 2.0])
@pytest.mark.parametrize("rate", RATES)
def test_without_friction(rate, w):
    """With mu = 0 nothing sticks, and every crossing of the base velocity goes unnoticed: a free oscillation."""
    setup = random_set_up(w, rate, (1.0, -1.0, 0.5, 0.0), COUNT, seed=[11, int(10 * rate)])._replace(mu=0.0)
    run = assert_agrees(setup, setup.simulate(SLOTS))
    assert run.sticks == []
    assert run.crossings > 0


def test_without_friction_at_rest_on_the_base():
    """On the base velocity without friction: a moving base takes nobody along."""
    setup = SetUp(
        **(EXACT | {"mu": 0.0}), durations=(3.0, 9.0), velocities=(1.0, -1.0), t1=10.0, position0=0.0, velocity0=1.0
    )
    assert_agrees(setup, setup.simulate(SLOTS), tolerance=1e-13)
    still = setup._replace(velocities=(0.0, -1.0), velocity0=0.0)
    simulation = still.simulate(SLOTS)
    assert (still.reference().sticks, int(simulation.sticks.count)) == ([], 0)
    assert [float(value) for value in simulation.final_state] == [0.0, 0.0]


@pytest.mark.parametrize("horizon", [4.0, 6.0])
def test_release_at_the_very_instant_of_a_jump_or_of_the_horizon(horizon):
    """In such a tie either name of the ending is right; instants and states are not in doubt."""
    unit = {"mass": 1.0, "stiffness": 1.0, "normal_force": 1.0, "mu": 1.0, "position0": -1.0, "velocity0": 0.5}
    setup = SetUp(**unit, durations=(4.0, 4.0), velocities=(0.5, -0.5), t1=horizon)
    run, simulation = setup.reference(), setup.simulate(SLOTS)
    sticks = filled(simulation)
    assert sticks.start == pytest.approx([float(stick.start) for stick in run.sticks], abs=1e-14)
    assert sticks.end == pytest.approx([float(stick.end) for stick in run.sticks], abs=1e-14)
    final = [float(value) for value in simulation.final_state]
    assert final == pytest.approx([float(run.final_position), float(run.final_velocity)], abs=1e-14)


@pytest.mark.slow
def test_many_random_set_ups():
    """Speeds, rates, amplitudes and levels at random, a hundred thousand intervals in all."""
    sticks = 0
    for seed in range(400):
        source = np.random.default_rng(seed)
        w, rate, amplitude = np.exp(source.uniform(np.log([0.02, 0.1, 0.1]), np.log([30.0, 10.0, 300.0])))
        levels = list(LEVELS.values())[seed % len(LEVELS)]
        setup = random_set_up(w, rate, levels, 390, seed=[seed, 1], amplitude=amplitude)
        sticks += len(assert_agrees(setup, setup.simulate(SLOTS)).sticks)
    assert sticks > 10_000
