"""`VelocitySteps` of numbers that JAX traces: equal neighbours are one interval, as elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
DURATIONS, VELOCITIES = jnp.array([0.1, 0.2, 0.1, 9.0]), jnp.array([0.3, 0.3, 0.3, -0.3])
ONE = ss.PiecewiseConstant([0.0, 0.4], [0.3, -0.3])
METHODS = {"intervals": ss.Exact(), "steps": ss.Exact(step=0.1), "fixed": ss.Regularized(1e-4, step=0.01)}


def outcome(base, method):
    one = ss.simulate(SYSTEM, base, t1=6.0, y0=(0.0, 0.3), method=method)
    return jnp.stack([one.sticks.count, one.stick_time, *one.final_state, one.status])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_equal_neighbours(method):
    def of(durations, velocities):
        return outcome(ss.VelocitySteps(durations, velocities), METHODS[method])

    expected = outcome(ONE, METHODS[method])
    assert expected[0] == 2  # the first ends with the base's jump, and another follows
    for found in (
        jax.jit(of)(DURATIONS, VELOCITIES),
        jax.vmap(of)(DURATIONS[None], VELOCITIES[None])[0],
        jax.vmap(lambda base: outcome(base, METHODS[method]))(ss.VelocitySteps(DURATIONS[None], VELOCITIES[None]))[0],
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_ride_in_three_intervals_by_hand():
    """The mass rides the belt from x = 0 until it has gone 0.12 m: one stick of 0.4 s, whatever cuts the time."""
    one = jax.jit(lambda v: ss.simulate(SYSTEM, ss.VelocitySteps(DURATIONS, v), t1=0.5, y0=(0.0, 0.3)).sticks)(
        VELOCITIES
    )
    assert one.count == 1
    assert one.duration[0] == pytest.approx(0.4, rel=1e-12)
    assert one.ending[0] == ss.Ending.BASE_SWITCHED


@pytest.mark.slow
def test_derivatives():
    """By the lengths: the stick lasts as long as the three intervals together, 1 each."""

    def first(durations):
        base = ss.VelocitySteps(durations, VELOCITIES)
        return ss.simulate(SYSTEM, base, t1=0.5, y0=(0.0, 0.3)).sticks.duration[0]

    for derivative in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(derivative(first)(DURATIONS), [1.0, 1.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("durations", "velocities"),
    [([1.0, -1.0, 9.0], [0.3, 0.2, 0.3]), ([1.0, 1.0, 9.0], [0.3, np.nan, 0.3]), ([1.0, np.nan, 9.0], [0.3, 0.2, 0.1])],
)
def test_impossible_intervals(durations, velocities):
    def status(durations, velocities):
        return ss.simulate(SYSTEM, ss.VelocitySteps(durations, velocities), t1=6.0, y0=(0.0, 0.3)).status

    assert jax.jit(status)(jnp.array(durations), jnp.array(velocities)) == ss.Status.BASE_INVALID


def test_samples_of_laws_are_taken_as_they_are():
    law = ss.PoissonSwitching(1.0, 1.0)
    alone = law.sample(jax.random.key(1), 6.0, capacity=64)
    many = jax.vmap(lambda key: law.sample(key, 6.0, capacity=64))(jax.random.key(1)[None])
    np.testing.assert_array_equal(many.durations[0], alone.durations)
    again = jax.jit(lambda base: ss.VelocitySteps(base.durations, base.velocities))(alone)
    np.testing.assert_array_equal(again.durations, alone.durations)
    np.testing.assert_array_equal(again.velocities, alone.velocities)
