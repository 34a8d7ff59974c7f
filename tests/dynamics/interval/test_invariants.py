"""What holds for every trajectory: property tests over random systems, base motions and starts."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.interval import GRID, SetUp, evaluate_compiled, filled

import stickslip_jax as ss

SLOTS = 32
TIMES = 256
EPS = np.finfo(float).eps
LEVELS = (1.0, -1.0, 0.0, 0.5, -0.5, 0.3, -1.7)

times_on_grid = st.integers(1, 5 * 2**24).map(lambda steps: steps * GRID)
thousandths = st.integers(-1000, 1000).map(lambda number: number / 1000)
magnitudes = st.floats(0.1, 10.0)


@st.composite
def set_ups(draw, longest=14, levels=LEVELS):
    """Systems and starts of moderate size; durations on a grid, so that they add up without round-off."""
    mass, stiffness, normal_force, mu = (draw(magnitudes) for _ in range(4))
    omega, a = (stiffness / mass) ** 0.5, mu * normal_force / stiffness
    w = draw(st.floats(0.02, 20.0))
    speed = w * omega * a
    count = draw(st.integers(1, longest))
    durations = tuple(draw(times_on_grid) for _ in range(count))
    velocities = tuple(speed * draw(st.sampled_from(levels)) for _ in range(count))
    position = a * draw(thousandths) * 8
    velocity = draw(st.one_of(st.just(velocities[0]), thousandths.map(lambda part: 3 * part * speed)))
    t1 = sum(durations) - draw(st.sampled_from([0.0, 0.25, 0.5])) * durations[-1]
    return SetUp(mass, stiffness, normal_force, mu, durations, velocities, t1, position, velocity)


def run(setup: SetUp) -> ss.Simulation:
    simulation = setup.simulate(SLOTS)
    assert int(simulation.status) == ss.Status.FINISHED
    return simulation


def amplitude(setup: SetUp) -> float:
    """A bound on the length scale of the motion, m: start, stick band and the base velocities seen so far."""
    fastest = max(abs(value) for value in setup.velocities) / setup.omega
    return np.hypot(setup.position0, setup.velocity0 / setup.omega) + setup.half_width + fastest


def state_at(simulation: ss.Simulation, times) -> tuple[np.ndarray, np.ndarray]:
    """`Simulation.evaluate` at up to `TIMES` instants, with one compilation."""
    times = np.asarray(times, float)
    assert times.size <= TIMES
    x, speed = evaluate_compiled(simulation, np.concatenate([times, np.zeros(TIMES - times.size)]))
    return np.asarray(x)[: times.size], np.asarray(speed)[: times.size]


def base_at(setup: SetUp, times) -> tuple[np.ndarray, np.ndarray]:
    """Number of the merged base interval and base velocity at the given times, straight from the set-up."""
    starts = np.concatenate([[0.0], np.cumsum(setup.durations)])[:-1]
    interval = np.searchsorted(starts, np.asarray(times, float), side="right") - 1
    velocities = np.asarray(setup.velocities)
    merged = np.concatenate([[0], np.cumsum(velocities[1:] != velocities[:-1])])
    return merged[interval], velocities[interval]


@pytest.mark.slow
@given(set_ups())
def test_sticks_are_ordered_disjoint_and_inside_the_horizon(setup):
    sticks = filled(run(setup))
    assert np.all(sticks.duration > 0)
    assert np.all(sticks.start >= 0)
    assert np.all(sticks.end <= setup.t1)
    assert np.all(sticks.start[1:] >= sticks.end[:-1])


@pytest.mark.slow
@given(set_ups())
def test_spare_slots_are_marked(setup):
    sticks = run(setup).sticks
    spare = ~np.asarray(sticks.mask)
    assert np.all(np.diff(np.asarray(sticks.mask).astype(int)) <= 0)
    for values in (sticks.start, sticks.end, sticks.position, sticks.duration):
        assert np.array_equal(np.isnan(values), spare)
    assert np.array_equal(np.asarray(sticks.ending) == -1, spare)


@pytest.mark.slow
@given(set_ups())
def test_spring_stays_within_the_friction_limit_during_a_stick(setup):
    """At both ends of a stick |k x| <= mu n, with equality where the mass is released, on the side it is moved to."""
    sticks = filled(run(setup))
    a = setup.half_width
    _, velocity = base_at(setup, (sticks.start + sticks.end) / 2)
    last = sticks.position + velocity * sticks.duration
    # Instants up to t1 carry a few ulps of t1, which move the end of a stick by the base's way in that time.
    slack = 8 * EPS * (a + amplitude(setup) + np.abs(velocity) * setup.t1)
    assert np.all(np.abs(sticks.position) <= a * (1 + 8 * EPS))
    assert np.all(np.abs(last) <= a + slack)
    released = sticks.ending == ss.Ending.RELEASED
    assert np.all(np.abs(last - np.sign(velocity) * a)[released] <= slack[released])
    assert np.all(velocity[released] != 0)


@pytest.mark.slow
@given(set_ups())
def test_one_stick_in_each_base_interval_at_most(setup):
    sticks = filled(run(setup))
    interval, _ = base_at(setup, (sticks.start + sticks.end) / 2)
    assert np.all(np.diff(interval) > 0)


@given(set_ups())
def test_endings_say_what_they_mean(setup):
    sticks = filled(run(setup))
    jumps = np.cumsum(setup.durations)
    at_horizon = sticks.ending == ss.Ending.HORIZON
    assert np.all(sticks.end[at_horizon] == setup.t1)
    assert at_horizon.sum() <= 1
    switched = sticks.ending == ss.Ending.BASE_SWITCHED
    # Sums of durations on the grid are exact, so the instants are, too.
    assert np.all(np.isin(sticks.end[switched], jumps))


@pytest.mark.slow
@given(set_ups())
def test_sticks_and_slips_tile_the_time(setup):
    simulation = run(setup)
    sticks, slips = filled(simulation), simulation.slips
    mask = np.asarray(slips.mask)
    starts = np.concatenate([sticks.start, np.asarray(slips.start)[mask]])
    ends = np.concatenate([sticks.end, np.asarray(slips.end)[mask]])
    order = np.argsort(starts)
    assert starts[order][0] == 0
    assert ends[order][-1] == setup.t1
    assert np.array_equal(ends[order][:-1], starts[order][1:])
    assert int(slips.count) == mask.sum()
    assert np.asarray(slips.censored)[mask].sum() == (ends[order][-1] not in sticks.end)
    total = 4 * len(ends) * EPS * setup.t1
    assert abs(float(simulation.slip_time) - np.asarray(slips.duration)[mask].sum()) <= total


@given(set_ups())
def test_stick_time_is_the_sum_of_the_durations(setup):
    simulation = run(setup)
    sticks = filled(simulation)
    tolerance = 4 * (1 + len(sticks.start)) * EPS * setup.t1
    assert abs(float(simulation.stick_time) - sticks.duration.sum()) <= tolerance
    assert abs(float(simulation.stick_fraction) * setup.t1 - sticks.duration.sum()) <= tolerance
    assert int(simulation.sticks.count) == len(sticks.start)


@pytest.mark.slow
@given(set_ups())
def test_mass_moves_with_the_base_during_a_stick(setup):
    simulation = run(setup)
    sticks = filled(simulation)
    for part in (0.1, 0.5, 0.9):
        times = sticks.start + part * sticks.duration
        x, speed = state_at(simulation, times)
        _, velocity = base_at(setup, times)
        scale = amplitude(setup)
        slack = 16 * EPS * (scale + np.abs(velocity) * setup.t1)
        assert np.all(np.abs(speed - velocity) <= 16 * EPS * setup.omega * scale)
        assert np.all(np.abs(x - sticks.position - velocity * part * sticks.duration) <= slack)


@pytest.mark.slow
@given(set_ups(longest=6))
def test_radius_is_conserved_along_slip_arcs(setup):
    """`evaluate` between the reference's events: each arc is a circle about +a (below the base velocity) or -a."""
    simulation = run(setup)
    parts = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
    arcs = [item for item in setup.segments() if item.side and item.end - item.start > 1e-6][: TIMES // parts.size]
    times = [np.clip(float(arc.start) + parts * float(arc.end - arc.start), 0, setup.t1) for arc in arcs]
    x, speed = state_at(simulation, np.ravel(times))
    side = np.array([arc.side for arc in arcs]).reshape(-1, 1)
    radius = np.hypot(x.reshape(-1, parts.size) - side * setup.half_width, speed.reshape(-1, parts.size) / setup.omega)
    # Round-off in the arcs' first instants, times the mass's speed there.
    assert np.all(np.ptp(radius, axis=1) <= 1e-10 * amplitude(setup) if arcs else True)


@pytest.mark.slow
@given(set_ups())
def test_derivative_of_the_position_is_the_velocity(setup):
    """Exact differentiation of `evaluate` with respect to time, at instants inside the intervals."""
    simulation = run(setup)
    times = setup.t1 * (np.arange(TIMES) + np.sqrt(0.5)) / TIMES
    (_, speed), (rate, _) = differentiate_in_time(simulation, times)
    assert np.all(np.abs(rate - speed) <= 1e-10 * setup.omega * amplitude(setup))


@jax.jit
def differentiate_in_time(simulation, times):
    return jax.jvp(simulation.evaluate, (times,), (jax.numpy.ones_like(times),))


@pytest.mark.slow
@given(set_ups())
def test_evaluate_at_both_ends(setup):
    simulation = run(setup)
    x, speed = state_at(simulation, [0.0, setup.t1, -1.0, setup.t1 + 1.0])
    tolerance = 4 * EPS * amplitude(setup)
    assert abs(x[0] - setup.position0) <= tolerance
    assert abs(speed[0] - setup.velocity0) <= tolerance * setup.omega
    final = [float(value) for value in simulation.final_state]
    assert abs(x[1] - final[0]) <= tolerance
    assert abs(speed[1] - final[1]) <= tolerance * setup.omega
    assert np.all(np.isnan(x[2:]))
    assert np.all(np.isnan(speed[2:]))


def assert_same(one: ss.Simulation, other: ss.Simulation, time=1.0, length=1.0):
    """Equal to the last bit, the second one measured in units of `time` and `length`."""
    first, second = filled(one), filled(other)
    assert first.ending.tolist() == second.ending.tolist()
    assert first.start.tolist() == (second.start / time).tolist()
    assert first.end.tolist() == (second.end / time).tolist()
    assert first.position.tolist() == (second.position / length).tolist()
    (x, speed), (x_other, speed_other) = one.final_state, other.final_state
    assert (float(x), float(speed)) == (float(x_other) / length, float(speed_other) * time / length)
    assert float(one.stick_time) == float(other.stick_time) / time


@pytest.mark.slow
@given(set_ups(levels=[level for level in LEVELS if level != 0]))
def test_mirror_symmetry(setup):
    """To the last bit; on a base at rest both directions are computed alike, but rounded apart."""
    mirrored = setup._replace(
        velocities=tuple(-value for value in setup.velocities),
        position0=-setup.position0,
        velocity0=-setup.velocity0,
    )
    assert_same(run(setup), run(mirrored), length=-1.0)


@given(set_ups(), st.integers(-6, 6), st.integers(-6, 6), st.integers(-6, 6))
def test_scaling_law(setup, kilograms, metres, seconds):
    """Equal dimensionless groups give equal dimensionless events; with powers of two, equal to the last bit."""
    mass, length, time = 2.0**kilograms, 2.0**metres, 2.0**seconds
    speed, force = length / time, mass * length / time**2
    scaled = SetUp(
        setup.mass * mass,
        setup.stiffness * mass / time**2,
        setup.normal_force * force,
        setup.mu,
        tuple(value * time for value in setup.durations),
        tuple(value * speed for value in setup.velocities),
        setup.t1 * time,
        setup.position0 * length,
        setup.velocity0 * speed,
    )
    assert_same(run(setup), run(scaled), time, length)


@pytest.mark.slow
@given(set_ups(), st.data())
def test_splitting_an_interval_changes_nothing(setup, data):
    """A boundary between equal velocities is no boundary: a stick that runs across it is one stick."""
    index = data.draw(st.integers(0, len(setup.durations) - 1))
    steps = round(setup.durations[index] / GRID)
    first = data.draw(st.integers(0, steps)) * GRID
    pieces = [piece for piece in (first, setup.durations[index] - first) if piece > 0]
    again = [setup.velocities[index]] * len(pieces)
    cut = setup._replace(
        durations=(*setup.durations[:index], *pieces, *setup.durations[index + 1 :]),
        velocities=(*setup.velocities[:index], *again, *setup.velocities[index + 1 :]),
    )
    assert_same(run(setup), run(cut))


@pytest.mark.slow
@given(set_ups(), st.integers(0, 10))
def test_what_the_base_does_after_the_horizon_does_not_matter(setup, more):
    longer = setup._replace(
        durations=(*setup.durations, *[1.0] * more), velocities=(*setup.velocities, *[2 * setup.velocities[0]] * more)
    )
    assert_same(run(setup), run(longer))
