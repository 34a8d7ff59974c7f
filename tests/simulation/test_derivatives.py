"""Pathwise derivatives of event times, event states and end state, against differences of the 40-digit reference."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf
from reference.event_by_event import event_time_derivatives, trace_reference
from support.interval import SetUp, filled, random_set_up

import stickslip_jax as ss

SLOTS = 48
PARAMETERS = ("mu", "speed", "stiffness", "mass", "position0")
# Differences of the reference are exact to about 1e-20. The derivative of an instant is a quotient of numbers good to
# 1e-16 by the steepness of an arrival; demanded are eight digits, against the larger of the derivative and its scale.
TOLERANCE = 1e-8


def outcome(parameters, signs, durations, normal_force, t1, velocity0):
    """All events and the end state, from the parameters as an array in the order of `PARAMETERS`."""
    mu, speed, stiffness, mass, position0 = parameters
    system = ss.MassSpring(mass, stiffness, normal_force, ss.Coulomb(mu))
    simulation = ss.simulate(system, ss.VelocitySteps(durations, speed * signs), t1=t1, y0=(position0, velocity0))
    return gathered(simulation)


def gathered(simulation):
    sticks = simulation.sticks
    # Spare slots hold NaN, whose derivative is of no interest.
    start, end, position = (jnp.where(sticks.mask, v, 0.0) for v in (sticks.start, sticks.end, sticks.position))
    return {"start": start, "end": end, "position": position, "final": jnp.stack(simulation.final_state)}


forward = jax.jit(jax.jacfwd(outcome))
backward = jax.jit(jax.jacrev(outcome))


def jacobians(setup: SetUp):
    """Forward-mode and reverse-mode derivatives; the base's speed scales all its velocities."""
    speed = max(abs(value) for value in setup.velocities)
    spare = SLOTS - len(setup.durations)
    signs = jnp.asarray([*(value / speed for value in setup.velocities), *[setup.velocities[-1] / speed] * spare])
    durations = jnp.asarray([*setup.durations, *[0.0] * spare])
    parameters = jnp.asarray([setup.mu, speed, setup.stiffness, setup.mass, setup.position0])
    fixed = (signs, durations, setup.normal_force, setup.t1, setup.velocity0)
    return forward(parameters, *fixed), backward(parameters, *fixed)


def off(got, exact, scale) -> float:
    """Worst deviation, relative to the exact value or to `scale`, whichever is larger."""
    errors = (abs(float(a) - float(b)) / max(abs(float(b)), scale) for a, b in zip(got, exact, strict=True))
    return max(errors, default=0.0)


def assert_derivatives_agree(setup: SetUp):
    """Every derivative against the reference, and both modes of differentiation against each other."""
    ahead, back = jax.tree.map(np.asarray, jacobians(setup))
    for name, values in ahead.items():
        size = np.max(np.abs(values), initial=0)
        assert np.all(np.abs(values - back[name]) <= 1e-11 * (1 + size)), name
    case = setup._asdict()
    length, clock = setup.half_width, 1 / setup.omega
    for column, parameter in enumerate(PARAMETERS):
        exact = event_time_derivatives(parameter, **case)
        value = float(jnp.asarray({"speed": max(map(abs, setup.velocities))}.get(parameter, case.get(parameter, 0.0))))
        unit = abs(value) or length
        count = len(exact.starts)
        assert np.all(ahead["start"][count:, column] == 0)
        errors = {
            "start": off(ahead["start"][:count, column], exact.starts, clock / unit),
            "end": off(ahead["end"][:count, column], exact.ends, clock / unit),
            "position": off(ahead["position"][:count, column], exact.positions, length / unit),
            "final position": off(ahead["final"][:1, column], [exact.final_position], length / unit),
            "final velocity": off(ahead["final"][1:, column], [exact.final_velocity], length / clock / unit),
        }
        assert max(errors.values()) < TOLERANCE, (parameter, errors)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("w", [0.05, 0.3, 1.0, 3.0])
def test_random_bases(w, seed):
    levels = ((1.0, -1.0), (1.0, -1.0, 0.5, -0.3), (0.5, 1.0, 0.0, -1.0))[seed]
    setup = random_set_up(w, (0.3, 1.0, 0.5)[seed], levels, 40, seed=[int(100 * w), seed, 5], amplitude=2).merged()
    assert assert_derivatives_agree(setup) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("w", [0.2, 2.0])
def test_large_amplitude_with_crossings(w):
    """A hundred pass-throughs: derivatives of the sum over all arcs."""
    setup = random_set_up(w, 0.05, (1.0, -1.0), 20, seed=[3, int(10 * w)]).merged()
    setup = setup._replace(position0=200 * setup.half_width)
    assert setup.reference().crossings > 50
    assert_derivatives_agree(setup)


def test_one_long_interval_with_crossings():
    setup = SetUp(1.3, 4.2, 2.1, 0.35, (400.0,), (0.1,), 400.0, 175.1 * 0.175, 0.05)
    assert setup.reference().crossings > 80
    assert assert_derivatives_agree(setup) == 1


def test_poisson_switching_at_fixed_gaps():
    law = ss.PoissonSwitching(speed=0.3, rate=0.7)
    base = law.sample(jax.random.key(5), 30.0, capacity=SLOTS)
    durations, velocities = (tuple(values.tolist()) for values in (base.durations, base.velocities))
    setup = SetUp(1.3, 4.2, 2.1, 0.35, durations, velocities, 30.0, 0.9, 0.1)
    assert assert_derivatives_agree(setup) >= 5


@jax.jit
@jax.jacfwd
def by_rate(rate):
    """Events and end state for the key 5, as functions of the switching rate."""
    system = ss.MassSpring(1.3, 4.2, 2.1, ss.Coulomb(0.35))
    base = ss.PoissonSwitching(speed=0.3, rate=rate).sample(jax.random.key(5), 30.0, capacity=SLOTS)
    return gathered(ss.simulate(system, base, t1=30.0, y0=(0.9, 0.1)))


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.4, 0.7, 1.1])
def test_switching_rate(rate):
    """Gaps scale as 1 / rate, so the reference is differenced with scaled durations."""
    base = ss.PoissonSwitching(speed=0.3, rate=rate).sample(jax.random.key(5), 30.0, capacity=SLOTS)
    got = jax.tree.map(np.asarray, by_rate(rate))
    with mp.workdps(50):
        step = mpf("1e-12")

        def run(factor):
            segments = trace_reference(
                mass=1.3,
                stiffness=4.2,
                normal_force=2.1,
                mu=0.35,
                durations=[mpf(value) / factor for value in base.durations.tolist()],
                velocities=base.velocities.tolist(),
                t1=30.0,
                position0=0.9,
                velocity0=0.1,
            )
            sticks = [item for item in segments if item.side == 0]
            last = segments[-1]
            return [
                [item.start for item in sticks],
                [item.end for item in sticks],
                [item.start_position for item in sticks],
                [last.end_position, last.end_velocity],
            ]

        exact = [
            [(high - low) / (2 * step * mpf(rate)) for low, high in zip(*pair, strict=True)]
            for pair in zip(run(1 - step), run(1 + step), strict=True)
        ]
    count = len(exact[0])
    assert count >= 3
    for name, values in zip(("start", "end", "position", "final"), exact, strict=True):
        assert off(got[name][: len(values)], values, 1.0) < TOLERANCE, name


GRAZING = {f"R = w (1 + {excess:g})": 1 + 0.5 * (1 + excess) for excess in (0, 1e-15, 1e-14, 1e-12, 1e-10, 1e-8)}
EDGES = {
    "on the release edge, z = +1": (1.0, 0.5),
    "on the other edge, z = -1": (-1.0, 0.5),
    "just inside the release edge": (1.0 - 1e-15, 0.5),
    "just beyond the release edge": (1.0 + 1e-15, 0.5),
    "at rest at the centre of the circle below": (1.0, 0.0),
    "at rest at the centre of the circle above": (-1.0, 0.0),
    "crossing exactly at the edge, h = 2 a": (1.0 + math.sqrt(4.25), 0.0),
}
STARTS = {name: (position, 0.0) for name, position in GRAZING.items()} | EDGES


@pytest.mark.parametrize("velocities", [(0.5,), (0.5, -0.5, 0.5), (0.5, 1.0, 0.5), (0.0, 0.5), (-0.5,)])
@pytest.mark.parametrize("start", STARTS)
def test_finite_where_the_motion_is_degenerate(start, velocities):
    """No NaN and no infinity from either mode, at grazing and at the edges of the stick band."""
    position, velocity = STARTS[start]
    durations = (5.0,) * len(velocities)
    setup = SetUp(1.0, 1.0, 1.0, 1.0, durations, velocities, 5.0 * len(velocities), position, velocity)
    for jacobian in jacobians(setup):
        for name, values in jacobian.items():
            assert np.all(np.isfinite(values)), name


def test_grazing_derivative_has_the_right_size():
    """Just above R = w the arrival moves as 1 / sqrt(R^2 - w^2): the derivative must not be cut off or smoothed."""
    excess = 1e-8
    setup = SetUp(1.0, 1.0, 1.0, 1.0, (7.0,), (0.5,), 7.0, 1 + 0.5 * (1 + excess), 0.0)
    exact = event_time_derivatives("position0", **setup._asdict(), relative_step="1e-16")
    ahead, back = jacobians(setup)
    # The distance h = sqrt(R^2 - w^2), 7e-5, is known to 1e-16 / h, and the derivative goes as 1 / h.
    for jacobian in (ahead, back):
        assert float(jacobian["start"][0, 4]) == pytest.approx(float(exact.starts[0]), rel=1e-7)


@jax.jit
def constant_base(values):
    """Total stick time and end state on a `Constant` base, whose only interval lasts for ever."""
    mu, speed, t1 = values
    system = ss.MassSpring(1.3, 4.2, 2.1, ss.Coulomb(mu))
    base = ss.Constant(speed).sample(None, t1, capacity=1)
    simulation = ss.simulate(system, base, t1=t1, y0=(1.0, 0.0))
    return jnp.stack([simulation.stick_time, simulation.stick_fraction, *simulation.final_state])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("speed", [0.05, 0.0, -0.05])
def test_infinite_durations_give_finite_derivatives(mode, speed):
    values = jnp.asarray([0.35, speed, 20.0])
    derivatives = jax.jit(mode(constant_base))(values)
    assert np.all(np.isfinite(derivatives))
    if speed:
        # d x(t1) / d t1 is the velocity at t1.
        assert float(derivatives[2, 2]) == pytest.approx(float(constant_base(values)[3]), 1e-9)


@pytest.mark.slow
def test_stick_time_gradient_is_that_of_the_events():
    """Gradient of one number, the way users take it, equals the sum of the events' derivatives."""
    setup = random_set_up(0.3, 0.5, (1.0, -1.0), 40, seed=21).merged()

    def stick_time(mu):
        system = ss.MassSpring(setup.mass, setup.stiffness, setup.normal_force, ss.Coulomb(mu))
        base = ss.VelocitySteps(jnp.asarray(setup.durations), jnp.asarray(setup.velocities))
        start = (setup.position0, setup.velocity0)
        return ss.simulate(system, base, t1=setup.t1, y0=start).stick_time

    exact = event_time_derivatives("mu", **setup._asdict())
    expected = float(sum(exact.ends) - sum(exact.starts))
    assert len(filled(setup.simulate(SLOTS)).start) >= 5
    assert float(jax.grad(stick_time)(setup.mu)) == pytest.approx(expected, rel=1e-9)
