"""Self-checks of the event-by-event reference against exact results and independent integration."""

import itertools
import random

import pytest
from mpmath import mp, mpf
from scipy.integrate import solve_ivp

from .event_by_event import (
    EventSequenceChangedError,
    event_time_derivatives,
    simulate_reference,
    trace_reference,
)

UNIT = {"mass": 1, "stiffness": 1, "normal_force": 1, "mu": 1}
PARAMETERS = {"mass": 1.3, "stiffness": 4.2, "normal_force": 2.1, "mu": 0.35}


def random_schedule(seed, count, mean=1.0, speed=0.3):
    """Exponential gaps with velocities +-speed, a few of them equal to their neighbour."""
    source = random.Random(seed)
    durations = [source.expovariate(1 / mean) for _ in range(count)]
    velocities = [speed * source.choice((-1, 1)) for _ in range(count)]
    return {"durations": durations, "velocities": velocities, "t1": 0.999 * sum(durations)}


def test_free_oscillator_on_fixed_base():
    system = {"mass": 1, "stiffness": 1, "normal_force": 1, "mu": "0.4", "velocity0": 0, "position0": 3}
    with mp.workdps(40):
        segments = trace_reference(durations=[20], velocities=[0], t1=20, **system)
        assert [item.ending for item in segments] == ["CROSSED"] * 3 + ["STUCK", "HORIZON"]
        turns = [mpf("-2.2"), mpf("1.4"), mpf("-0.6"), mpf("-0.2")]
        for number, (item, turn) in enumerate(zip(segments, turns, strict=False), start=1):
            assert abs(item.end - number * mp.pi) < mpf("1e-38")
            assert abs(item.end_position - turn) < mpf("1e-38")
        assert (segments[-1].end, segments[-1].end_velocity) == (20, 0)
        assert segments[-1].end_position == segments[-1].start_position


def test_energy_balance_along_slip_arcs():
    schedule = random_schedule(1, 60)
    segments = trace_reference(**PARAMETERS, **schedule, position0=40 * 0.175, velocity0=0.1)
    assert sum(item.ending == "CROSSED" for item in segments) >= 10
    with mp.workdps(50):
        mass, stiffness = mpf(PARAMETERS["mass"]), mpf(PARAMETERS["stiffness"])
        force = mpf(PARAMETERS["mu"]) * mpf(PARAMETERS["normal_force"])

        def energy(x, speed):
            return mass * speed**2 / 2 + stiffness * x**2 / 2

        for item in segments:
            if item.side:
                gain = energy(item.end_position, item.end_velocity)
                gain -= energy(item.start_position, item.start_velocity)
                work = item.side * force * (item.end_position - item.start_position)
                assert abs(gain - work) < mpf("1e-38") * energy(item.start_position, item.start_velocity)
        for one, two in itertools.pairwise(segments):
            assert (one.end, one.end_position, one.end_velocity) == (
                two.start,
                two.start_position,
                two.start_velocity,
            )


def test_no_arrival_is_missed_inside_an_arc():
    segments = trace_reference(**PARAMETERS, **random_schedule(2, 60), position0=2.0, velocity0=0.3)
    omega = (PARAMETERS["stiffness"] / PARAMETERS["mass"]) ** 0.5
    center = PARAMETERS["mu"] * PARAMETERS["normal_force"] / PARAMETERS["stiffness"]
    for item in segments:
        for part in range(1, 40):
            angle = omega * float(item.end - item.start) * part / 40
            a = float(item.start_position) - item.side * center
            speed = float(item.start_velocity) * mp.cos(angle) - omega * a * mp.sin(angle)
            x = float(item.start_position + item.start_velocity * (item.end - item.start) * part / 40)
            if item.side:
                assert item.side * (item.base_velocity - speed) > -1e-12
            else:
                assert abs(x) <= center * (1 + 1e-12)


@pytest.mark.parametrize(("ratio", "percent"), [(1.0, 15.83), (1.2, 36.43), (1.22, 38.67), (1.42, 0)])
def test_square_wave_stick_share_of_a_steady_period(ratio, percent):
    with mp.workdps(40):
        period = mp.pi / mpf(ratio)
        count = int(200 / period)
        run = simulate_reference(
            mass=1,
            stiffness=4,
            normal_force=1,
            mu=1,
            durations=[period / 2] * (2 * count),
            velocities=[-1, 1] * count,
            t1=count * period,
            position0=0,
            velocity0=1,
        )
        left = (count - 1) * period
        share = sum(max(item.end - max(item.start, left), 0) for item in run.sticks) / period
        assert abs(100 * share - percent) < 0.005


def integrate_events(schedule, position, velocity):
    """Sticks found by scipy: numerical integration of each slip, closed form only inside a stick."""
    mass, stiffness = PARAMETERS["mass"], PARAMETERS["stiffness"]
    load = PARAMETERS["mu"] * PARAMETERS["normal_force"]
    now, end, sticks, crossings = 0.0, 0.0, [], 0
    for duration, base in zip(schedule["durations"], schedule["velocities"], strict=True):
        end = min(end + duration, schedule["t1"])
        side, arrives = (1 if velocity < base else -1), True
        while now < end:

            def field(_, y, side=side):
                return [y[1], (side * load - stiffness * y[0]) / mass]

            def gap(_, y, base=base):
                return y[1] - base

            gap.terminal, gap.direction = arrives, side
            path = solve_ivp(
                field, (now, end), [position, velocity], method="DOP853", rtol=1e-11, atol=1e-13, events=gap
            )
            now, (position, velocity) = path.t[-1], path.y[:, -1]
            if path.status == 1 and abs(stiffness * position) <= load:
                release = now + ((load if base > 0 else -load) / stiffness - position) / base
                sticks.append((now, min(release, end), position))
                position += base * (sticks[-1][1] - now)
                now, velocity, side, arrives = sticks[-1][1], base, (1 if base > 0 else -1), False
            elif path.status == 1:
                velocity, side, crossings = base, -side, crossings + 1
    return sticks, position, velocity, crossings


def test_against_numerical_integration():
    schedule = random_schedule(5, 80)
    merged = {"durations": [], "velocities": [], "t1": schedule["t1"]}
    for duration, base in zip(schedule["durations"], schedule["velocities"], strict=True):
        if merged["velocities"] and merged["velocities"][-1] == base:
            merged["durations"][-1] += duration
        else:
            merged["durations"].append(duration)
            merged["velocities"].append(base)
    run = simulate_reference(**PARAMETERS, **schedule, position0=1.5, velocity0=0.1)
    sticks, position, velocity, crossings = integrate_events(merged, 1.5, 0.1)
    assert len(run.sticks) == len(sticks) >= 10
    assert run.crossings == crossings >= 5
    for item, expected in zip(run.sticks, sticks, strict=True):
        assert (float(item.start), float(item.end), float(item.position)) == pytest.approx(expected, abs=1e-8)
    assert (float(run.final_position), float(run.final_velocity)) == pytest.approx((position, velocity), abs=1e-8)


def test_stick_across_equal_velocities_is_one_and_endings_are_named():
    start = {"position0": -1, "velocity0": 0.5}
    whole = simulate_reference(**UNIT, durations=[10], velocities=[0.5], t1=10, **start)
    parts = simulate_reference(**UNIT, durations=[1, 2, 0, 7], velocities=[0.5, 0.5, -1, 0.5], t1=10, **start)
    assert whole == parts
    stick = whole.sticks[0]
    assert (stick.start, stick.end, stick.position, stick.ending) == (0, 4, -1, "RELEASED")
    cut = simulate_reference(**UNIT, durations=[3, 7], velocities=[0.5, -0.5], t1=10, **start)
    assert (cut.sticks[0].end, cut.sticks[0].ending) == (3, "BASE_SWITCHED")
    short = simulate_reference(**UNIT, durations=[3, 7], velocities=[0.5, -0.5], t1=3, **start)
    assert (short.sticks[0].end, short.sticks[0].ending, len(short.sticks)) == (3, "HORIZON", 1)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("position", "sticks", "crossings"), [(1, 0, 0), (1.5, 1, 0), (-1, 1, 0), (-1.5, 1, 0), (-4, 1, 1)]
)
def test_start_exactly_on_the_base_velocity(sign, position, sticks, crossings):
    run = simulate_reference(
        **UNIT, durations=[30], velocities=[sign], t1=30, position0=sign * position, velocity0=sign
    )
    assert (len(run.sticks), run.crossings) == (sticks, crossings)
    assert all(item.end > item.start for item in run.sticks)


def test_released_arc_touching_an_earlier_base_velocity_again_does_not_stick():
    """Released at 0.5, the mass stays on its arc of radius 0.5 while the base visits 1 and returns to 0.5."""
    run = simulate_reference(
        **UNIT, durations=[4.5, 1, 30], velocities=[0.5, 1, 0.5], t1=35, position0=-1, velocity0=0.5
    )
    assert [item.ending for item in run.sticks] == ["RELEASED"]
    with mp.workdps(40):
        assert abs(run.final_position - (1 + mp.sin(31) / 2)) < mpf("1e-38")


def test_rest_on_a_fixed_base_until_it_moves():
    run = simulate_reference(**UNIT, durations=[5, 5], velocities=[0, 0.5], t1=10, position0=1, velocity0=0)
    first = run.sticks[0]
    assert (first.start, first.end, first.position, first.ending) == (0, 5, 1, "BASE_SWITCHED")


def test_frictionless_run_is_harmonic_and_never_sticks():
    schedule = random_schedule(7, 50)
    run = simulate_reference(mass=2, stiffness=3, normal_force=1, mu=0, **schedule, position0=0.7, velocity0=0.3)
    assert run.sticks == []
    assert run.crossings > 10
    with mp.workdps(40):
        omega = mp.sqrt(mpf(3) / 2)
        angle = omega * mpf(schedule["t1"])
        exact = mpf(0.7) * mp.cos(angle) + mpf(0.3) / omega * mp.sin(angle)
        assert abs(run.final_position - exact) < mpf("1e-37")


def test_thousandfold_amplitude():
    run = simulate_reference(**UNIT, durations=[2000], velocities=[0.3], t1=2000, position0=1000, velocity0=0)
    assert run.crossings == 499
    assert [item.ending for item in run.sticks] == ["RELEASED"]


def test_derivatives_of_a_stick_known_in_closed_form():
    case = {
        "mass": 1,
        "stiffness": 4,
        "normal_force": 1,
        "mu": 1,
        "durations": [10],
        "velocities": ["0.1"],
        "t1": 10,
    }
    case |= {"position0": "0.9", "velocity0": 0}
    with mp.workdps(40):
        run = simulate_reference(**case)
        stick = run.sticks[0]
        for name, size in (("mu", mpf(1)), ("stiffness", mpf(4)), ("speed", mpf("0.1"))):
            slopes = event_time_derivatives(name, **case)
            base, width = mpf("0.1"), mpf(1) / 4
            by_width = {"mu": width, "stiffness": -width / size, "speed": 0}[name]
            by_speed = 1 if name == "speed" else 0
            exact = slopes.starts[0] + (by_width - slopes.positions[0]) / base
            exact -= by_speed * (width - stick.position) / base**2
            assert abs(slopes.ends[0] - exact) < mpf("1e-20")
        # At rest, x(t) = c + (x0 - c) cos(2 t) and the arrival is at z = 1 - sqrt(R^2 - w^2).
        reach = mp.sqrt((mpf("0.9") - mpf("0.25")) ** 2 - mpf("0.05") ** 2)
        first = trace_reference(**case)[0]
        assert abs(first.end_position - (mpf("0.25") - reach)) < mpf("1e-38")
        coarse = event_time_derivatives("position0", **case, relative_step="1e-9")
        fine = event_time_derivatives("position0", **case)
        assert abs(coarse.final_position - fine.final_position) < mpf("1e-14")


def test_derivatives_refuse_a_changing_event_sequence():
    with pytest.raises(EventSequenceChangedError):
        event_time_derivatives("speed", **UNIT, durations=[9], velocities=[0.5], t1=9, position0=-1, velocity0=0.5)


@pytest.mark.parametrize("change", [{"mass": 0}, {"mu": -1}, {"durations": [1]}, {"velocities": [1, 2]}, {"t1": 0}])
def test_bad_arguments_are_refused(change):
    case = dict(**UNIT, durations=[9], velocities=[0.5], t1=9, position0=0, velocity0=0)
    with pytest.raises(ValueError, match=r"must|reach"):
        simulate_reference(**case | change)
