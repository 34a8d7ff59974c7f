"""Sticks come into the order of their starts, whatever the order in which they end, one trajectory or many."""

import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import StickRecord, sticks_in_order

RNG = np.random.default_rng(0)
SHAPE = (3, 5, 40, 2)  # samples, samples, steps, contacts


def records(ending, starts):
    numbers = jnp.asarray(starts)
    return StickRecord(
        numbers, numbers + 0.5, -numbers, {"slip_displacement": 2 * numbers}, jnp.asarray(ending, jnp.int8)
    )


def checked(found, ending, starts):
    """One trajectory against a sort of NumPy's."""
    flat_ending, flat_starts = ending.reshape(-1), starts.reshape(-1)
    (which,) = np.nonzero(flat_ending >= 0)
    order = which[np.argsort(flat_starts[which], kind="stable")]
    number = len(order)
    assert found.mask.sum() == number
    assert found.mask[:number].all()
    np.testing.assert_array_equal(found.start[:number], flat_starts[order])
    np.testing.assert_array_equal(found.end[:number], flat_starts[order] + 0.5)
    np.testing.assert_array_equal(found.position[:number], -flat_starts[order])
    np.testing.assert_array_equal(found.slip_displacement[:number], 2 * flat_starts[order])
    np.testing.assert_array_equal(found.ending[:number], flat_ending[order])
    assert (found.ending[number:] == -1).all()
    assert np.isnan(found.start[number:]).all()
    if ending.ndim == 2:
        np.testing.assert_array_equal(found.contact[:number], order % ending.shape[1])
        assert (found.contact[number:] == -1).all()


def test_sticks_are_in_the_order_of_their_starts():
    # Many starts are equal, and their order is random, worse than that of any motion.
    starts = RNG.integers(0, 30, SHAPE).astype(float)
    ending = np.where(RNG.random(SHAPE) < RNG.random((*SHAPE[:2], 1, 1)), RNG.integers(0, 3, SHAPE), -1)
    ending[0, 0], ending[0, 1] = -1, 0
    many = jax.jit(jax.vmap(jax.vmap(sticks_in_order)))(records(ending, starts))
    once = jax.vmap(sticks_in_order)(records(ending[:, 0, :, 0], starts[:, 0, :, 0]))
    for i in range(SHAPE[0]):
        for j in range(SHAPE[1]):
            checked(jax.tree.map(lambda leaf, at=(i, j): np.asarray(leaf[at]), many), ending[i, j], starts[i, j])
        checked(jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), once), ending[i, 0, :, 0], starts[i, 0, :, 0])
    alone = sticks_in_order(records(ending[1, 2], starts[1, 2]))
    checked(jax.tree.map(np.asarray, alone), ending[1, 2], starts[1, 2])


def test_derivatives_follow_the_order():
    starts, ending = np.array([3.0, 1.0, 2.0]), np.array([0, -1, 1])

    def second(factor):
        return jax.vmap(lambda shift: sticks_in_order(records(ending, factor * starts + shift)).start[1])(
            jnp.arange(4.0)
        )

    for slopes in (jax.jacfwd(second)(jnp.asarray(2.0)), jax.jacrev(second)(jnp.asarray(2.0))):
        np.testing.assert_array_equal(slopes, np.full(4, 3.0))


def test_no_trajectory_depends_on_those_beside_it():
    """More than fit into a block of lanes, the last with fewer."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))

    def sticks(phase):
        base = ss.Harmonic(amplitude=1.0, angular_frequency=1.0, phase=phase)
        one = ss.simulate(system, base, t1=10.0, y0=(0.0, 1.0), method=ss.Exact(max_steps=128))
        return one.sticks, one.totals, one.final_state, one.status

    phases = np.linspace(0, 6, 300)
    many, alone = jax.vmap(sticks)(jnp.asarray(phases)), jax.jit(sticks)
    assert (many[3] == 0).all()
    for i in (0, 149, 255, 256, 299):
        for found, expected in zip(
            jax.tree.leaves(jax.tree.map(lambda leaf, i=i: leaf[i], many)),
            jax.tree.leaves(alone(jnp.asarray(phases[i]))),
            strict=True,
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_no_trajectories_have_no_sticks():
    """Also where each operation runs by itself."""
    none = np.zeros((0, *SHAPE[2:]))
    found = jax.vmap(sticks_in_order)(records(none, none))
    assert found.start.shape == (0, SHAPE[2] * SHAPE[3])
    phases = jnp.zeros(0)
    system, method = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.6)), ss.Exact(max_steps=64)

    def starts(phase):
        return ss.simulate(system, ss.Harmonic(1.0, 1.3, phase), t1=1.0, method=method).sticks.start

    assert jax.vmap(starts)(phases).shape == jax.jit(jax.vmap(starts))(phases).shape == (0, 64)
