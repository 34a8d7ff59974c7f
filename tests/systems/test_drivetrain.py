"""Drivetrains and drill strings: their frequencies, steady states and stops in closed form, published motions, and an
event-by-event integration of the equations of the papers.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import stickslip_jax as ss

STILL = ss.Constant(0.0)
DRY = ss.Coulomb(0.5, 0.55)


def sticks_of(one, contact):
    """Start and end of each stick of a contact."""
    sticks = one.of_contact(contact).sticks
    return np.asarray(sticks.start)[sticks.mask], np.asarray(sticks.end)[sticks.mask]


# --- drivetrains


@pytest.mark.slow
def test_three_coupled_clutches():
    """The Modelica library's example; an event-by-event integration with rtol 1e-12 found these numbers."""
    pressures = (
        ss.Harmonic(20.0, 0.4 * np.pi),
        ss.ForceSteps([0.0, 0.4], [0.0, 20.0]),
        ss.ForceSteps([0.0, 0.9], [0.0, 20.0]),
    )
    train = ss.drivetrain(
        [1.0, 1.0, 1.0, 1.0],
        clutches=[ss.FrictionDisk(pressure, DRY) for pressure in pressures],
        torque=(ss.Harmonic(10.0, 10 * np.pi, -np.pi / 2), None, None, None),
    )
    one = ss.simulate(train, STILL, t1=1.5, y0=(0, 0, 0, 0, 10.0, 0, 0, 0))
    expected = (
        ([0.791662359155, 0.906850192798], [0.831108506138, 1.000295859895]),
        ([0.709621474694], [1.5]),
        ([1.143967492473], [1.5]),
    )
    for contact, (start, end) in enumerate(expected):
        found = sticks_of(one, contact)
        np.testing.assert_allclose(found[0], start, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found[1], end, rtol=0, atol=1e-8)
    state = np.array(one.final_state)
    np.testing.assert_allclose(state[[0, 4]], [7.486119099, 3.247058272], rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.diff(state[:4]), [-3.37898168, -1.39667298, -1.53672056], rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.diff(state[4:]), [-0.783871106, 0, 0], rtol=0, atol=1e-8)


def test_frequencies_of_equal_inertias():
    """``J w^2 = 4 k sin^2(pi j / (2 n))``, j = 0 ... n - 1: a row with free ends."""
    disk = ss.FrictionDisk(1.0, DRY)
    train = ss.drivetrain([0.5] * 6, stiffness=[30.0] * 5, damping=[0.3] * 5, drag=[0.1] * 6, brakes=[disk] * 6)
    expected = 4 * np.sin(np.pi * np.arange(6) / 12) ** 2
    np.testing.assert_allclose(np.linalg.eigvalsh(train.stiffness) / 0.5, 60 * expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.linalg.eigvalsh(train.damping), 0.3 * expected + 0.1, rtol=1e-12)
    assert [coordinate.unit for coordinate in train.coordinates] == ["rad"] * 6 + ["rad/s"] * 6
    assert train.coordinates[7].meaning == "angular velocity 1 in rad/s"
    assert train.of_contact(2).stick_position.unit == "m"
    assert train.of_all_contacts().stick_position.unit == "rad"
    assert train.uncoupled


@pytest.mark.slow
def test_two_inertias_on_a_shaft_swing_freely_while_the_clutch_is_open():
    first, second, stiffness, t1 = 0.3, 0.7, 12.0, 5.0
    train = ss.drivetrain(
        [first, second],
        stiffness=[stiffness],
        clutches=[ss.FrictionDisk(ss.ForceSteps([0.0, 100.0], [0.0, 1.0]), DRY)],
    )
    one = ss.simulate(train, STILL, t1=t1, y0=(0.4, -0.1, 0.0, 2.0))
    frequency = math.sqrt(stiffness * (1 / first + 1 / second))
    mean, twist = (0.4 * first - 0.1 * second + 2.0 * second * t1) / (first + second), -0.5
    twist = twist * math.cos(frequency * t1) + 2.0 / frequency * math.sin(frequency * t1)
    expected = mean - second * twist / (first + second), mean + first * twist / (first + second)
    np.testing.assert_allclose(one.final_state[:2], expected, rtol=0, atol=1e-11)
    assert not np.any(one.totals.sticks)


RADIUS, PRESSURE, WEAKENING = 0.12, 800.0, 0.4
INERTIA = np.array([0.2, 0.5])


def closing(inertia, radius):
    """When a clutch, whose friction falls with the speed at its radius, takes along the second inertia; speeds then."""
    disk = ss.FrictionDisk(PRESSURE, ss.VelocityWeakening(0.3, WEAKENING), radius=radius)
    train = ss.drivetrain(inertia, clutches=(disk,))
    one = ss.simulate(train, STILL, t1=2.0, y0=(0.0, 0.0, 60.0, 0.0), method=ss.Exact(max_steps=512))
    found = jnp.array([one.sticks.start[0], one.final_state[2], one.final_state[3]])
    return found, found


def closed_form_of_closing(inertia, radius):
    """``v + weakening v^2 / 2`` falls in proportion to time, for the sliding speed v = radius times the difference."""
    sliding = radius * 60.0
    rate = radius**2 * 0.3 * PRESSURE * (1 / inertia[0] + 1 / inertia[1])
    speed = 60.0 * inertia[0] / (inertia[0] + inertia[1])
    return jnp.array([(sliding + WEAKENING * sliding**2 / 2) / rate, speed, speed])


@pytest.mark.slow
def test_friction_law_of_a_clutch_is_asked_with_the_speed_at_its_radius():
    np.testing.assert_allclose(closing(INERTIA, RADIUS)[0], closed_form_of_closing(INERTIA, RADIUS), rtol=1e-11)


def test_time_scale_of_inertias_without_springs_has_no_derivative():
    """Their eigenvalues are equal; it was not a number, and every derivative in reverse mode with it."""

    def fastest(inertia):
        return ss.drivetrain(inertia, brakes=(None, ss.FrictionDisk(1.0, DRY))).fastest

    np.testing.assert_array_equal(jax.grad(fastest)(jnp.asarray(INERTIA)), [0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_by_inertias_and_radius(mode):
    slopes, found = jax.jit(mode(closing, argnums=(0, 1), has_aux=True))(jnp.asarray(INERTIA), RADIUS)
    np.testing.assert_allclose(found, closed_form_of_closing(INERTIA, RADIUS), rtol=1e-11)
    expected = jax.jacfwd(closed_form_of_closing, argnums=(0, 1))(jnp.asarray(INERTIA), RADIUS)
    for one, other in zip(slopes, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_brake_stops_an_inertia():
    """Angular deceleration ``mu N radius / J``; the distance slid in the brake is the radius times the angle."""
    disk = ss.FrictionDisk(100.0, ss.Coulomb(0.4), radius=0.25)
    one = ss.simulate(ss.drivetrain([1.0, 2.0], brakes=(None, disk)), STILL, t1=3.0, y0=(0.0, 0.0, 1.0, 8.0))
    stick = one.sticks
    assert float(stick.start[0]) == pytest.approx(8.0 / 5.0, rel=1e-13)
    assert float(stick.position[0]) == pytest.approx(0.25 * 8.0**2 / (2 * 5.0), rel=1e-12)
    np.testing.assert_allclose(one.final_state, [3.0, 6.4, 1.0, 0.0], rtol=1e-12, atol=1e-13)


GOOD = {"inertia": [1.0, 1.0], "stiffness": [5.0], "brakes": (None, ss.FrictionDisk(1.0, DRY))}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"inertia": [1.0]}, "Argument inertia must hold two positive numbers or more"),
        ({"inertia": [1.0, 0.0]}, "Argument inertia must hold two positive numbers or more"),
        ({"inertia": [1.0, ss.Uniform(1.0, 2.0)]}, "Argument inertia must hold real numbers, no distributions"),
        ({"stiffness": [1.0, 2.0]}, "Argument stiffness must hold 1 numbers of zero or more"),
        ({"stiffness": [-1.0]}, "Argument stiffness must hold 1 numbers of zero or more"),
        ({"damping": [math.nan]}, "Argument damping must hold 1 numbers of zero or more"),
        ({"drag": [0.1]}, "Argument drag must hold 2 numbers of zero or more"),
        ({"brakes": None}, "Argument clutches must hold a FrictionDisk, or brakes one, but none was given"),
        ({"brakes": (ss.FrictionDisk(1.0, DRY),)}, "Argument brakes must be a tuple of 2, one for each inertia"),
        ({"clutches": (None, None)}, "Argument clutches must be a tuple of 1, one between each inertia and the next"),
        ({"torque": (1.0,)}, "Argument torque must be a tuple of 2 forces"),
        ({"torque": (1.0, "2")}, r"Argument torque\[1\] must be a number, a Signal, a Recorded, a ForceSteps or None"),
    ],
)
def test_what_a_drivetrain_refuses(changed, message):
    with pytest.raises(ValueError, match=message):
        ss.drivetrain(**GOOD | changed)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, DRY), "Argument normal_force must be positive .*; what opens has a function of time"),
        ((1.0, DRY, -0.1), r"Argument radius must be positive \(in m\)"),
        ((1.0, DRY, ss.Uniform(0.1, 0.2)), "Argument radius must be a single real number"),
    ],
)
def test_what_a_friction_disk_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        ss.FrictionDisk(*arguments)


# --- drill strings

BIT_RADIUS, GAMMA, KINETIC, STATIC = 0.155575, 0.9, 0.5, 0.8
ROCK = ss.Stribeck(KINETIC, STATIC, BIT_RADIUS / GAMMA)
PAIR = {"inertia": [2122.0, 471.9698], "stiffness": [861.5336], "damping": [172.3067], "drag": [425.0, 50.0]}
"""Table and bit."""
FOUR = {
    "inertia": [930.0, 2782.25, 750.0, 471.9698],
    "stiffness": [698.063, 1080.0, 907.48],
    "damping": [139.6126, 190.0, 181.49],
    "drag": [425.0, 0.0, 0.0, 50.0],
}
"""Table, pipes, collars and bit."""
WEIGHT = 97347.0


def drill(numbers, weight=WEIGHT, **changed):
    return ss.drill_string(**numbers, weight_on_bit=weight, bit_radius=BIT_RADIUS, friction=ROCK, **changed)


def rock_torque(speed, weight):
    return weight * BIT_RADIUS * (KINETIC + (STATIC - KINETIC) * math.exp(-GAMMA * speed))


def test_frequency_of_table_and_bit():
    """They swing against each other at ``sqrt(k (1 / J_table + 1 / J_bit))``."""
    string = drill(PAIR, torque=1.0)
    squared = np.linalg.eigvals(string.stiffness / np.array(PAIR["inertia"])[:, None])
    np.testing.assert_allclose(max(squared), 861.5336 * (1 / 2122.0 + 1 / 471.9698), rtol=1e-13)
    # What the free rotation does not count in.
    np.testing.assert_allclose(np.sum(string.damping), 425.0 + 50.0, rtol=1e-13)


@pytest.mark.slow
def test_steady_drilling_has_the_twist_that_carries_the_torque():
    """Below each shaft, drag and rock take what it transmits."""
    torque = 12_000.0
    speed = brentq(lambda w: 475.0 * w + rock_torque(w, WEIGHT) - torque, 5.0, 20.0, xtol=1e-14)
    carried = torque - 425.0 * speed
    twist = carried / np.array(FOUR["stiffness"])
    start = -np.cumsum([0.0, *twist])
    one = ss.simulate(drill(FOUR, torque=torque), STILL, t1=40.0, y0=(*start, *[speed] * 4))
    np.testing.assert_allclose(one.final_state[4:], [speed] * 4, rtol=1e-9)
    np.testing.assert_allclose(np.diff(np.array(one.final_state[:4])), -twist, rtol=1e-9)
    assert not np.any(one.totals.sticks)


def events(rates, demand, limit, y, t1):
    """Starts and ends of the sticks of the bit, whose speed is the last number of the state, and the end state.

    `rates(t, y, friction)`: of the state, with this torque of the rock on the bit; `demand(t, y)`: what holds it still.
    """
    t, stuck, starts, ends = 0.0, y[-1] == 0, [], []
    if stuck:
        starts.append(0.0)
    while t < t1:
        if stuck:
            field = lambda t, y: rates(t, y, -demand(t, y))  # noqa: E731
            ended = lambda t, y: limit - abs(demand(t, y))  # noqa: E731
        else:
            field = lambda t, y: rates(t, y, -rock_torque(y[-1], limit / (BIT_RADIUS * STATIC)))  # noqa: E731
            ended = lambda t, y: y[-1]  # noqa: E731
        ended.terminal, ended.direction = True, -1
        run = solve_ivp(field, (t, t1), y, "DOP853", events=ended, rtol=1e-12, atol=1e-12, max_step=0.05)
        t, y = float(run.t[-1]), run.y[:, -1]
        if run.status == 1:
            (ends if stuck else starts).append(t)
            y[-1] = 0.0
            if not stuck:
                assert abs(demand(t, y)) < limit
            stuck = not stuck
    return starts, [*ends, t1] if stuck else ends, y


def check_events(one, starts, ends):
    found = sticks_of(one, 0)
    assert len(starts) >= 5
    np.testing.assert_allclose(found[0], starts, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found[1], ends, rtol=0, atol=1e-8)
    assert int(one.near_grazing_count) == 0


@pytest.mark.slow
def test_limit_cycle_of_a_string_driven_by_a_torque():
    """Table, pipes, collars and bit, against the equations of the paper followed event by event.

    With a fifth of the paper's damping of the shafts: with all of it, this string drills steadily in the end.
    """
    torque, t1, dampings = 10_000.0, 60.0, [0.2 * damping for damping in FOUR["damping"]]
    table, pipes, collars, bit = FOUR["inertia"]

    def shafts(y):
        return [
            k * (y[i] - y[i + 1]) + c * (y[4 + i] - y[5 + i])
            for i, (k, c) in enumerate(zip(FOUR["stiffness"], dampings, strict=True))
        ]

    def demand(_, y):
        return shafts(y)[2] - 50.0 * y[7]

    def rates(_, y, friction):
        one, two, three = shafts(y)
        return [
            *y[4:],
            (torque - 425.0 * y[4] - one) / table,
            (one - two) / pipes,
            (two - three) / collars,
            (three - 50.0 * y[7] + friction) / bit,
        ]

    starts, ends, state = events(rates, demand, WEIGHT * BIT_RADIUS * STATIC, np.zeros(8), t1)
    one = ss.simulate(drill(FOUR | {"damping": dampings}, torque=torque), STILL, t1=t1)
    check_events(one, starts, ends)
    np.testing.assert_allclose(one.final_state, state, rtol=0, atol=1e-8)


SPEED, SOFT = 4.0, {**PAIR, "damping": [60.0]}


@pytest.mark.slow
def test_limit_cycle_under_a_table_of_given_speed():
    """The drive holds the table at its speed: left are the twist, and the speed of the bit."""
    t1 = 60.0

    def demand(_, y):
        return 861.5336 * y[0] + 60.0 * (SPEED - y[1]) - 50.0 * y[1]

    def rates(t, y, friction):
        return [SPEED - y[1], (demand(t, y) + friction) / 471.9698]

    starts, ends, state = events(rates, demand, WEIGHT * BIT_RADIUS * STATIC, np.zeros(2), t1)
    string, y0, method = drill(SOFT, drive_torque=60_000.0), (0.0, 0.0, SPEED, 0.0), ss.Exact(step=0.03)
    one = ss.simulate(string, ss.Constant(SPEED), t1=t1, y0=y0, method=method)
    check_events(one, starts, ends)
    expected = [SPEED * t1, SPEED * t1 - state[0], SPEED, state[1]]
    np.testing.assert_allclose(one.final_state, expected, rtol=0, atol=1e-9)
    assert float(one.of_contact(1).stick_time) == t1


@pytest.mark.slow
def test_steady_drilling_loses_its_stability_below_the_critical_table_speed():
    """``weight bit_radius (mu_static - mu) gamma exp(-gamma speed)`` exceeds the damping of the bit there."""
    damping = 60.0 + 50.0
    critical = math.log(WEIGHT * BIT_RADIUS * (STATIC - KINETIC) * GAMMA / damping) / GAMMA
    string = drill(SOFT, drive_torque=60_000.0)

    def swing(speed):
        """How much the bit's speed differs from the table's at most in the last tenth, after 100 s."""
        twist = (rock_torque(speed, WEIGHT) + 50.0 * speed) / 861.5336
        one = ss.simulate(string, ss.Constant(speed), t1=100.0, y0=(0.0, -twist, speed, speed + 1e-3))
        y = one.evaluate(np.linspace(90.0, 100.0, 400))
        return float(np.max(np.abs(np.asarray(y[3]) - speed))), int(one.of_contact(0).sticks.count)

    above, sticks_above = swing(1.15 * critical)
    below, sticks_below = swing(0.85 * critical)
    assert above < 1e-4
    assert sticks_above == 0
    assert below > 0.85 * critical
    assert sticks_below > 2


@pytest.mark.slow
def test_a_drive_that_is_too_weak_lets_the_table_slip():
    torque = 1.05 * (425.0 * SPEED + 50.0 * SPEED + rock_torque(SPEED, WEIGHT))
    y0 = (0.0, 0.0, SPEED, 0.0)
    drives = [drill(PAIR, drive_torque=limit * torque) for limit in (10, 0.8)]
    strong, weak = (ss.simulate(one, ss.Constant(SPEED), t1=20.0, y0=y0).of_contact(1) for one in drives)
    assert float(strong.stick_time) == 20.0
    assert 0.1 < float(weak.stick_time) < 19.0


@pytest.mark.slow
def test_batches_and_derivatives_of_strings():
    """Of the speed of the bit, by the weight on it, inside ``jit`` and ``vmap``."""

    def end(weight):
        string = drill(PAIR, weight, torque=9_000.0)
        return ss.simulate(string, STILL, t1=20.0, method=ss.Exact(max_steps=1024)).final_state[3]

    weights = jnp.array([60_000.0, 80_000.0])
    slopes = (jax.vmap(end)(weights + 0.5) - jax.vmap(end)(weights - 0.5)) / 1.0
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(end)))(weights), slopes, rtol=1e-6)


STRING = PAIR | {"weight_on_bit": 1e4, "bit_radius": 0.1, "friction": ROCK, "torque": 5e3}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"inertia": [1.0]}, "Argument inertia must hold two positive numbers or more"),
        ({"stiffness": [0.0]}, "Argument stiffness must hold positive numbers"),
        ({"stiffness": [1.0, 1.0]}, "Argument stiffness must hold 1 numbers"),
        ({"damping": [-1.0]}, "Argument damping must hold 1 numbers of zero or more"),
        ({"drag": [1.0]}, "Argument drag must hold 2 numbers of zero or more"),
        ({"weight_on_bit": 0.0}, r"Argument weight_on_bit must be positive \(in N\)"),
        ({"bit_radius": 0.0}, r"Argument bit_radius must be positive \(in m\)"),
        ({"torque": None}, "Argument torque or drive_torque must say what turns the table, but neither was given"),
        ({"drive_torque": 1e4}, "Argument torque or drive_torque must say what turns the table, but both were given"),
        ({"torque": None, "drive_torque": 0.0}, r"Argument drive_torque must be positive \(in N m\)"),
        ({"torque": "much"}, r"Argument torque\[0\] must be a number, a Signal, a Recorded, a ForceSteps or None"),
    ],
)
def test_what_a_drill_string_refuses(changed, message):
    with pytest.raises(ValueError, match=message):
        ss.drill_string(**STRING | changed)
