"""Sliding bearings and friction pendulums: against event-driven SciPy, textbook loops and other forms of the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.bearing_reference import Bearing
from support.series_reference import InSeries

import stickslip_jax as ss

GRAVITY, MASS = 9.81, 2.0
LAW = ss.VelocityDependent(0.04, 0.09, 30.0, mu_static=0.05)
METHOD = ss.Exact(max_steps=4096)


def accelerograms(seed, points=600, step=0.01):
    """Times (s), and accelerations along and upward (m/s^2); the latter exceeds gravity."""
    rng, times = np.random.default_rng(seed), step * np.arange(points)

    def one(size, slowest, quickest):
        waves = 2 * np.pi * rng.uniform(slowest, quickest, 12)[:, None] * times + rng.uniform(0, 2 * np.pi, (12, 1))
        return size * times / 2 * np.exp(1 - times / 2) * np.sum(np.sin(waves), axis=0) / 3

    return times, one(3.0, 0.4, 5.0), one(5.5, 3.0, 12.0)


def ground_of(times, accelerations):
    return ss.GroundAcceleration(times, accelerations)


def simulated(structure, times, along):
    return ss.simulate(structure, ground_of(times, along), t1=float(times[-1]), method=METHOD)


def compare(seed, moves_up, radius=1.5, with_energies=True):
    times, along, upward = accelerograms(seed)
    vertical = ground_of(times, upward) if moves_up else None
    bearing = ss.friction_pendulum(MASS, radius, LAW, vertical=vertical, gravity=GRAVITY)
    one = simulated(bearing, times, along)
    assert one.status == 0

    def friction(speed):
        return 0.09 - 0.05 * np.exp(-30 * speed)

    curvature = 0.0 if radius is None else 1 / radius
    known = Bearing(times, along, upward if moves_up else 0 * upward, curvature, friction, 0.05, GRAVITY).run()
    assert float(one.final_state[0]) == pytest.approx(known.x, abs=1e-9)
    assert float(one.peak("position 0")) == pytest.approx(known.peak, abs=1e-9)
    assert float(one.peak("velocity 0")) == pytest.approx(known.fastest, abs=1e-9)
    sticks = np.array([(begin, end) for begin, end in known.sticks if end > begin])
    found = np.stack([one.sticks.start, one.sticks.end], axis=1)[np.asarray(one.sticks.mask)]
    assert found.shape == sticks.shape
    np.testing.assert_allclose(found, sticks, rtol=0, atol=1e-9)
    if with_energies:
        energies = one.energies(np.linspace(1.0, times[-1], 4))
        assert np.max(np.abs(energies.imbalance)) < 1e-11 * np.max(energies.supplied["load"])
    return len(sticks), np.min(upward) < -GRAVITY and moves_up


@pytest.mark.slow
def test_a_pendulum_under_a_record():
    """Residual and largest displacement, largest speed, and every stick, while the bearing opens and closes."""
    found = [compare(seed, moves_up=True, with_energies=False) for seed in range(2)]
    assert sum(number for number, _ in found) > 6
    assert all(opens for _, opens in found)


@pytest.mark.slow
@pytest.mark.parametrize("moves_up", [False, True], ids=["level", "opens"])
@pytest.mark.parametrize("radius", [1.5, None], ids=["pendulum", "flat"])
def test_pendulums_under_many_records(moves_up, radius):
    """Energies balance to round-off, too."""
    assert sum(compare(seed, moves_up, radius)[0] for seed in range(2, 12)) > 40


@pytest.mark.slow
def test_derivatives_of_a_pendulum():
    """Of the residual displacement by radius and friction, of a bearing that opens, against central differences."""
    times, along, upward = accelerograms(1, points=300)

    def end(numbers):
        law = ss.VelocityDependent(0.04, numbers[1], numbers[2])
        bearing = ss.friction_pendulum(MASS, numbers[0], law, vertical=ground_of(times, upward), gravity=GRAVITY)
        method = ss.Exact(max_steps=1024)
        return ss.simulate(bearing, ground_of(times, along), t1=2.99, method=method).final_state[0]

    given = jnp.array([1.5, 0.09, 30.0])
    steps = 1e-5 * jnp.diag(given)
    at = jax.jit(jax.vmap(end))(jnp.concatenate([given[None, :] + steps, given[None, :] - steps]))
    differences = (at[:3] - at[3:]) / (2 * jnp.diag(steps))
    np.testing.assert_allclose(jax.jit(jax.jacfwd(end))(given), differences, rtol=2e-6)


@pytest.mark.slow
def test_an_ensemble_of_pendulums():
    """Samples are the same as single runs: sticks, and peaks found in the pass."""
    times, along, upward = accelerograms(3, points=300)
    law = ss.VelocityDependent(0.04, ss.Uniform(0.07, 0.12), 30.0)
    bearing = ss.friction_pendulum(MASS, ss.Uniform(1.0, 2.0), law, vertical=ground_of(times, upward))
    outputs = {
        "peak": lambda one: one.peak("position 0"),
        "left": lambda one: one.final_state[0],
        "fastest": lambda one: one.peak("velocity 0"),
    }
    many = ss.simulate_ensemble(
        bearing.of_contact(0), ground_of(times, along), t1=2.99, samples=5, key=jax.random.key(1), keep="sticks",
        outputs=outputs,
    )  # fmt: skip
    assert many.finished == 5
    for i in (0, 2, 4):
        system, base, y0 = many.realization(i)
        one = ss.simulate(system, base, t1=2.99, y0=y0, method=many.method)
        for name, function in outputs.items():
            assert many.output_values[name][i] == pytest.approx(float(function(one)), rel=1e-9, abs=1e-12)
        radius, mu = (float(many.input_values[name][i]) for name in ("radius", "mu_fast"))
        again = ss.friction_pendulum(
            MASS, radius, ss.VelocityDependent(0.04, mu, 30.0), vertical=ground_of(times, upward)
        )
        assert float(simulated(again, times, along).final_state[0]) == pytest.approx(
            many.output_values["left"][i], abs=1e-9
        )


@pytest.mark.slow
def test_a_huge_radius_is_a_flat_slider():
    times, along, upward = accelerograms(4)
    for vertical in (None, ground_of(times, upward)):
        flat, inf, huge = (
            simulated(ss.friction_pendulum(MASS, radius, LAW, vertical=vertical), times, along)
            for radius in (None, np.inf, 1e12)
        )
        np.testing.assert_array_equal(flat.final_state, inf.final_state)
        np.testing.assert_allclose(huge.final_state, flat.final_state, rtol=0, atol=1e-10)
        assert int(huge.sticks.count) == int(flat.sticks.count) > 0


# Normal forces that jump, or vary with the positions.


def sliding(y0, pieces, mu, curvature, spring, pressing):
    """Position and velocity of 1 kg after `pieces` (end, normal force, N), which `pressing` (N/m) adds to; it never
    sticks. `spring`: N/m. By SciPy.
    """
    t, y, events = 0.0, np.array(y0, float), 0
    for end, normal in pieces:
        while t < end:
            pressed = normal + pressing * y[0]
            if abs(pressed) < 1e-12:
                pressed = pressing * y[1]
            is_open, sign = pressed <= 0, np.sign(y[1])

            def rates(s, z, is_open=is_open, sign=sign, normal=normal):
                held = 0.0 if is_open else (normal + pressing * z[0]) * (mu * sign + curvature * z[0])
                return [z[1], -spring * z[0] - held]

            def turns(s, z):
                return z[1]

            def opens(s, z, normal=normal):
                return normal + pressing * z[0]

            turns.terminal, turns.direction = True, -sign
            opens.terminal, opens.direction = True, 1 if is_open else -1
            found = solve_ivp(
                rates,
                (t, end),
                y,
                events=[turns, opens][: 2 if pressing else 1],
                method="DOP853",
                rtol=1e-12,
                atol=1e-15,
            )
            t, y, events = found.t[-1], found.y[:, -1], events + (found.status == 1)
            if len(found.t_events[0]):
                y[1] = 0.0
                rate = -spring * y[0] - (normal + pressing * y[0]) * curvature * y[0]
                assert is_open or abs(rate) > mu * (normal + pressing * y[0])
                y[1] = 1e-300 * np.sign(rate)
            if pressing and len(found.t_events[1]):
                y[0] = -normal / pressing
    return y, events


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["jumps", "pressed"])
def test_stiffness_that_varies(kind):
    """A pendulum pressed by steps of force, and one that its own position presses and lifts, beside a spring."""
    if kind == "jumps":
        force = ss.ForceSteps([0.0, 1.0, 1.6, 2.5], [3.0, -1.0, 0.0, 5.0])
        pieces, pressing = [(1.0, 3.0), (1.6, -1.0), (2.5, 0.0), (4.0, 5.0)], 0.0
    else:
        force, pieces, pressing = 0.8, [(4.0, 0.8)], 1.5
    contact = ss.Contact([1.0], force, ss.Coulomb(0.02), radius=0.4, normal_stiffness=[pressing] if pressing else None)
    one = ss.simulate(ss.LinearStructure([1.0], [6.0], None, (contact,)), 0.0, t1=4.0, y0=(0.9, 0.5), method=METHOD)
    known, events = sliding((0.9, 0.5), pieces, 0.02, 2.5, 6.0, pressing)
    np.testing.assert_allclose(one.final_state, known, rtol=0, atol=1e-9)
    assert events >= 2
    energies = one.energies(np.linspace(0.5, 4.0, 5))
    assert np.max(np.abs(energies.imbalance)) < 1e-11
    assert np.max(np.abs(energies.supplied["load"])) > 0.1


def test_a_pendulum_stands_on_the_ground():
    bearing = ss.friction_pendulum(MASS, 1.0, LAW)
    for base in (0.1, ss.Harmonic(0.1, 1.0), ss.PoissonSwitching(1.0, 1.0).sample(jax.random.key(0), 1.0)):
        with pytest.raises(ValueError, match="base must be at rest under a contact with a radius"):
            ss.simulate(bearing, base, t1=1.0)


@pytest.mark.slow
def test_a_pendulum_at_rest_and_one_beside_a_belt():
    bearing = ss.friction_pendulum(MASS, 1.0, LAW)
    assert int(ss.simulate(bearing, ss.Constant(0.0), t1=1.0, method=METHOD).sticks.count) == 1
    hanging = ss.LinearStructure([1.0], [0.0], None, (ss.Contact([1.0], 1.0, ss.Coulomb(0.1), 0.0, radius=1.0),))
    assert ss.simulate(hanging, 0.1, t1=1.0, y0=(0.5, 0.0), method=METHOD).status == 0


# Surfaces in series.


SERIES = {
    "double": ([1.5, 2.5], [0.03, 0.08]),
    "sorted": ([2.5, 0.7], [0.09, 0.02]),
    "triple": ([0.4, 0.9, 1.3], [0.02, 0.06, 0.11]),
    "alike": ([0.5, 1.0, 1.5], [0.08, 0.04, 0.08]),
}


def loop(radii, coefficients, turns):
    """The textbook's loop of a double pendulum (Fenz and Constantinou 2006) under a weight of 1 N: by the displacement,
    the force of first loading and of what follows after each of the `turns` (m).

    A branch is rigid by 2 mu_1, then of the stiffness 1 / R_1 until the force has changed by 2 mu_2, then of
    1 / (R_1 + R_2); half of these at first.
    """
    (small, large), (first, second) = coefficients, radii
    both, way_of_first = first + second, (large - small) * first

    def branch(way, times):
        """The change of the force after a `way` (m) in the direction of sliding."""
        stiff = np.minimum(way, times * way_of_first)
        return times * small + stiff / first + (way - stiff) / both

    forces = [lambda u: branch(u, 1)]
    for turn in turns:
        begin, direction = forces[-1](turn), -1 if len(forces) % 2 else 1
        forces.append(lambda u, a=begin, d=direction, x=turn: a + d * branch(d * (u - x), 2))
    return forces


@pytest.mark.slow
@pytest.mark.parametrize("case", ["double", "sorted"])
def test_a_double_pendulum_has_the_loops_of_the_textbook(case):
    """A mass so heavy that nothing stops it is driven there and back twice, by a ground acceleration in steps."""
    radii, coefficients = SERIES[case]
    order = np.argsort(coefficients)
    times, heavy, ground, v0 = np.array([0.0, 1.0, 1.5, 2.5]), 1e16, np.array([2.0, 2.0, -2.0, -2.0]), 1.0
    structure = ss.LinearStructure([heavy], [0.0], None, ss.pendulum_in_series(1.0, radii, coefficients))
    one = ss.simulate(structure, ss.GroundAcceleration(times, ground), t1=2.5, y0=(0.0, v0), method=METHOD)
    # From 0 up to 0.25 m at 0.5 s; at 1 s back at 0 with -1 m/s, which the ramp leaves; at rest at 2 s.
    ramp = -0.5 - 2 * (0.5**2 / 2 - 0.5**2 / 3)
    assert float(one.evaluate(1.5)[0]) == pytest.approx(ramp, abs=1e-12)
    turns = 0.25, ramp - 0.25
    assert float(one.evaluate(2.0)[0]) == pytest.approx(turns[1], abs=1e-12)
    forces = loop(np.array(radii)[order], np.array(coefficients)[order], turns)
    for force, begin, end in zip(forces, (0, 0.5, 2.0), (0.5, 2.0, 2.5), strict=True):
        at = np.linspace(begin, end, 52)[1:-1]
        place = np.asarray(one.evaluate(at)[0])
        found = -np.sum(one.friction_force(at), axis=0) + place / np.sum(radii)
        np.testing.assert_allclose(found, force(place), rtol=0, atol=1e-12)


def compare_series(case, seed):
    radii, coefficients = SERIES[case]
    times, along, _ = accelerograms(seed, points=400)
    bearing = ss.friction_pendulum(MASS, radii, [ss.Coulomb(mu) for mu in coefficients], gravity=GRAVITY)
    one = simulated(bearing, times, along)
    known = InSeries(MASS, MASS * GRAVITY, radii, coefficients).run(times, along)
    assert float(one.final_state[0]) == pytest.approx(known.x, abs=1e-9)
    sticks = np.array([(begin, end) for begin, end in known.sticks if end > begin])
    found = one.of_contact(0).sticks
    found = np.stack([found.start, found.end], axis=1)[np.asarray(found.mask)]
    assert found.shape == sticks.shape
    np.testing.assert_allclose(found, sticks, rtol=0, atol=1e-8)
    if len(radii) == 2:  # how far each surface has moved
        second = np.argmax(coefficients)
        share = radii[second] / sum(radii)
        assert share * float(one.final_state[0] - one.final_state[2]) == pytest.approx(known.own[second], abs=1e-9)
    assert np.max(np.abs(one.energies(3.0).imbalance)) < 1e-11
    return len(sticks)


@pytest.mark.slow
@pytest.mark.parametrize("case", SERIES)
def test_pendulums_in_series_under_records(case):
    """Against surfaces that each move by themselves under the same force."""
    assert sum(compare_series(case, seed) for seed in range(3)) >= 4


@pytest.mark.slow
def test_derivatives_of_a_double_pendulum():
    times, along, _ = accelerograms(0, points=400)

    def end(numbers):
        laws = [ss.Coulomb(numbers[2]), ss.Coulomb(numbers[3])]
        bearing = ss.friction_pendulum(MASS, [numbers[0], numbers[1]], laws, gravity=GRAVITY)
        return ss.simulate(bearing, ground_of(times, along), t1=3.99, method=METHOD).final_state[0]

    given = jnp.array([1.5, 2.5, 0.03, 0.08])
    steps = 1e-5 * jnp.diag(given)
    at = jax.jit(jax.vmap(end))(jnp.concatenate([given[None, :] + steps, given[None, :] - steps]))
    differences = (at[:4] - at[4:]) / (2 * jnp.diag(steps))
    np.testing.assert_allclose(jax.jit(jax.jacfwd(end))(given), differences, rtol=2e-6)


@pytest.mark.slow
def test_a_building_on_pendulums():
    """A nearly rigid one is a mass; that of bearings in series, and under vertical motion, too."""
    times, along, upward = accelerograms(2, points=300)
    method = ss.Exact(max_steps=2**17)
    for radius, law, vertical in (
        (1.5, LAW, ground_of(times, upward)),
        ([1.5, 2.5], [ss.Coulomb(0.03), ss.Coulomb(0.08)], None),
    ):
        of = {"gravity": GRAVITY, "vertical": vertical}
        building = ss.storeys_on_bearing([1.0, 1.0], [2e4], damping=[100.0], friction=law, radius=radius, **of)
        mass = ss.friction_pendulum(2.0, radius, law, **of)
        building, mass = (ss.simulate(one, ground_of(times, along), t1=2.99, method=method) for one in (building, mass))
        assert building.status == mass.status == 0
        assert float(building.final_state[0]) == pytest.approx(float(mass.final_state[0]), abs=2e-3)
        assert float(mass.peak("position 0")) > 0.05


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ss.friction_pendulum(1.0, [1.0, 2.0], LAW), "friction must hold a law Coulomb"),
        (lambda: ss.friction_pendulum(1.0, [1.0, 2.0], [LAW, LAW]), "friction must hold laws Coulomb"),
        (lambda: ss.friction_pendulum(1.0, 1.0, [ss.Coulomb(0.1)]), "radius must hold one number"),
        (lambda: ss.friction_pendulum(-1.0, 1.0, LAW), "mass must be positive"),
        (lambda: ss.friction_pendulum(1.0, 0.0, LAW), "radius must be positive"),
        (lambda: ss.pendulum_in_series(1.0, [1.0, 2.0], [0.1]), "coefficients must hold 2"),
        (lambda: ss.pendulum_in_series(1.0, [1.0, -2.0], [0.1, 0.2]), "radii must be positive"),
        (lambda: ss.VelocityDependent(0.1, 0.2, 0.0), "rate must be positive"),
        (lambda: ss.VelocityDependent(0.1, 0.2, 1.0, 0.05), "mu_static must be at least mu_slow"),
        (
            lambda: ss.friction_pendulum(
                1.0, [1.0, 2.0], [ss.Coulomb(0.1), ss.Coulomb(0.2)], vertical=ground_of([0.0, 1.0], [0.0, 1.0])
            ),
            "vertical must be None for surfaces in series",
        ),
    ],
)
def test_what_bearings_refuse(make, message):
    with pytest.raises(ValueError, match=message):
        make()
