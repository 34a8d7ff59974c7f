"""Lyapunov exponents: closed forms, two trajectories by scipy, and the change of areas."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from reference import event_driven
from scipy.integrate import solve_ivp

import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax.nonlinear._stability import stretches

CHAOTIC = {
    "system": ss.MassSpring(
        1.0, 1.0, 1.0, ss.VelocityWeakening(1.0, 3.0), damping=1e-3, force=ss.Harmonic(0.6, 1.91)
    ),
    "base": ss.Constant(0.3),
}  # fmt: skip


@pytest.mark.slow
def test_damped_spring_without_friction():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0), damping=3.0)
    found = nonlinear.lyapunov_exponents(system, ss.Harmonic(1.0, 1.3), transient=100, kept=50, progress=False)
    exponents = [(-3 + math.sqrt(5)) / 2, (-3 - math.sqrt(5)) / 2]
    np.testing.assert_allclose(found.lyapunov_exponent, exponents, rtol=0, atol=1e-10)
    # A complex pair: equal exponents, to the last digits where whole turns are seen. 7 periods are 3 turns.
    damping = 0.1
    period = 3 / 7 * 2 * math.pi / math.sqrt(1 - damping**2 / 4)
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0), damping=damping)
    base = ss.Harmonic(1.0, 2 * math.pi / period)
    found = nonlinear.lyapunov_exponents(system, base, transient=100, kept=70, progress=False)
    np.testing.assert_allclose(found.lyapunov_exponent, [-damping / 2] * 2, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_stick_forgets():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.4, mu_static=0.6, stribeck_speed=0.5), damping=0.05)
    starts = np.array([[0.3, 0.1], [-0.2, 0.4]])
    found = nonlinear.lyapunov_exponents(
        system, ss.Harmonic(0.8, 0.6), y0=starts, transient=60, kept=100, progress=False
    )
    section = nonlinear.stroboscopic_section(
        system, ss.Harmonic(0.8, 0.6), y0=starts[0], transient=60, kept=2, progress=False
    )
    orbit = nonlinear.periodic_orbit(
        system, ss.Harmonic(0.8, 0.6), y0=(section.position[-1], section.velocity[-1])
    )  # fmt: skip
    largest = math.log(abs(orbit.multipliers[0])) / float(orbit.period)
    np.testing.assert_allclose(found.lyapunov_exponent[:, 0], largest, rtol=1e-9)
    np.testing.assert_array_equal(found.lyapunov_exponent[:, 1], -np.inf)
    np.testing.assert_allclose(found.mean_exponent[0], largest, rtol=1e-9)
    assert float(found.mean_exponent_error[0]) < 1e-9
    assert np.isnan(found.mean_exponent_error[1])
    assert found.running_exponent.dims == ("start", "cycle", "exponent")


@pytest.mark.slow
def test_exponents_of_what_has_not_settled_are_told():
    """A spring whose motion falls by exp(-0.048) in a period of the force: to 1e-6 of it in 290 of them."""
    slow = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0), 0.02, force=ss.Harmonic(1.0, 1.3))
    assert not nonlinear.lyapunov_exponents(slow, ss.Constant(0.0), transient=30, kept=30, progress=False).settled
    assert nonlinear.lyapunov_exponents(slow, ss.Constant(0.0), transient=500, kept=30, progress=False).settled


@pytest.mark.slow
def test_directions_that_a_stick_takes_away():
    moved = jnp.array([[1.0, 2.0], [1e-20, 1e-20]])
    directions, logarithms = stretches(moved, jnp.asarray(True))
    np.testing.assert_allclose(directions.T @ directions, np.eye(2), atol=1e-14)
    np.testing.assert_array_equal(logarithms, [0.0, -np.inf])
    _, kept = stretches(jnp.array([[1.0, 2.0], [0.0, 1e-20]]), jnp.asarray(False))
    assert float(kept[1]) == pytest.approx(math.log(1e-20))


@pytest.mark.slow
def test_sum_is_the_change_of_areas():
    # A base so fast that the mass never reaches its velocity: no stick, and friction 0.4 / (1 + 4 - velocity).
    system = ss.MassSpring(
        1.0, 1.0, 1.0, ss.VelocityWeakening(0.4, 1.0), damping=0.3, force=ss.Harmonic(0.5, 0.8)
    )  # fmt: skip
    found = nonlinear.lyapunov_exponents(system, ss.Constant(4.0), transient=30, kept=20, progress=False)

    def rates(t, y):
        friction = 0.4 / (5 - y[1])
        return y[1], friction + 0.5 * math.cos(0.8 * t) - y[0] - 0.3 * y[1], 0.4 / (5 - y[1]) ** 2 - 0.3

    period = 2 * math.pi / 0.8
    ends = 30 * period, 50 * period
    done = solve_ivp(rates, (0, ends[1]), (0, 0, 0), "DOP853", t_eval=ends, rtol=1e-11, atol=1e-12)
    divergence = (done.y[2, 1] - done.y[2, 0]) / (ends[1] - ends[0])
    assert float(found.lyapunov_exponent.sum()) == pytest.approx(divergence, abs=1e-9)


@pytest.mark.slow
def test_chaos_against_two_trajectories_by_scipy():
    starts = np.random.default_rng(5).uniform(-1, 0.3, (16, 2))
    found = nonlinear.lyapunov_exponents(**CHAOTIC, y0=starts, transient=200, kept=2000, progress=False)
    mean, error = float(found.mean_exponent[0]), float(found.mean_exponent_error[0])
    assert mean > 20 * error > 0
    period, size = 2 * math.pi / 1.91, 1e-7

    def after(state):
        run = event_driven.simulate_mass_spring(
            mass=1.0, stiffness=1.0, damping=1e-3, normal_force=1.0, mu_static=1.0,
            mu_kinetic=lambda speed: 1 / (1 + 3 * speed), base_velocity=lambda t, _: 0.3,
            base_acceleration=lambda t, _: 0.0, force=lambda t, _: 0.6 * math.cos(1.91 * t), t1=period, y0=state,
        )  # fmt: skip
        return np.asarray(run.final_state)

    gains, y = [], np.array([0.1, 0.2])
    other = y + size * np.array([1.0, 0.0])
    for number in range(700):
        y, other = after(y), after(other)
        distance = np.linalg.norm(other - y)
        assert distance > 0
        if number >= 100:
            gains.append(math.log(distance / size) / period)
        other = y + (other - y) * size / distance
    blocks = np.array(gains).reshape(20, 30).mean(axis=1)
    own_error = np.std(blocks, ddof=1) / math.sqrt(20)
    assert abs(np.mean(blocks) - mean) < 4 * math.hypot(error, own_error)
