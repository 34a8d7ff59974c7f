"""The balance of forces in several contacts: the equation it solves, from any guess, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stickslip_jax._dynamics.common.method import SHAPES, Switch
from stickslip_jax._dynamics.regularized.field import ForceLaw, balanced_forces

SETUPS = 400


class Law(ForceLaw):
    """Kinetic forces that may fall a little with the speed; some contacts are open."""

    switch: Switch
    largest: jax.Array
    fall: jax.Array

    def __call__(self, velocity):
        return self.switch.friction(velocity, self.largest / (1 + self.fall * jnp.abs(velocity)), None)

    @property
    def width(self):
        return jnp.asarray(self.switch.width)

    @property
    def is_straight(self):
        return self.switch.shape == "linear"


def random_setups(contacts: int) -> tuple[jax.Array, ...]:
    """Speeds, stiffnesses (some nearly singular), largest forces, falls, widths and guesses of many set-ups."""
    rng = np.random.default_rng(contacts)
    roots = rng.normal(size=(SETUPS, contacts, contacts + rng.integers(0, 3)))
    stiffness = roots @ roots.transpose(0, 2, 1) + 1e-6 * np.eye(contacts)
    largest = rng.uniform(0.2, 2.0, (SETUPS, contacts)) * (rng.random((SETUPS, contacts)) < 0.85)
    # Speeds that friction can often, but not always, take away.
    speed = np.einsum("sij,sj->si", stiffness, largest * rng.uniform(-1.5, 1.5, (SETUPS, contacts)))
    fall = 0.02 * rng.random((SETUPS, contacts)) / np.trace(stiffness, axis1=1, axis2=2)[:, None]
    width = 10.0 ** rng.uniform(-9, 0, SETUPS)
    guess = largest * rng.uniform(-1, 1, (SETUPS, contacts))
    return tuple(map(jnp.asarray, (speed, stiffness, largest, fall, width, guess)))


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("contacts", [1, 2, 5, 10])
def test_the_forces_balance_from_any_guess(shape, contacts):
    """``force = law(sigma)`` with ``sigma = speed - stiffness force``, but for its round-off; widths down to 1e-9."""
    setups = random_setups(contacts)

    @jax.jit
    @jax.vmap
    def solve(speed, stiffness, largest, fall, width, guess):
        law = Law(Switch(width, shape), largest, fall)
        force = balanced_forces(law, speed, stiffness, guess)
        sigma = speed - stiffness @ force
        noise = jnp.abs(speed) + jnp.abs(stiffness) @ jnp.abs(force)
        value, slope = jax.jvp(law, (sigma,), (jnp.ones_like(sigma),))
        # Round-off of sigma moves the law by its slope times as much.
        return force, jnp.abs(value - force) / (1e-12 * (largest + jnp.abs(slope) * noise) + 1e-15)

    force, share = solve(*setups)
    assert np.all(np.isfinite(force))
    assert np.max(share) < 1
    assert np.all(np.abs(force) <= setups[2] + 1e-15)
    assert np.any(np.abs(force) < 0.99 * setups[2])


@pytest.mark.slow
def test_derivatives_are_those_of_differences():
    speed, stiffness, largest, fall, _, guess = (values[:20] for values in random_setups(3))
    width = jnp.full(20, 0.3)

    def total(speed, stiffness, largest, width, fall, guess):
        return jnp.sum(jnp.sin(balanced_forces(Law(Switch(width, "tanh"), largest, fall), speed, stiffness, guess)))

    values_and_gradients = jax.jit(jax.vmap(jax.value_and_grad(total, (0, 1, 2, 3))))
    given = [speed, stiffness, largest, width, fall, guess]
    _, gradients = values_and_gradients(*given)
    for i, values in enumerate((speed, stiffness, largest, width)):
        direction = jnp.asarray(np.random.default_rng(i).normal(size=values.shape))
        by_mode = jnp.sum((gradients[i] * direction).reshape(20, -1), axis=1)
        change = 1e-5
        ends = [
            values_and_gradients(*given[:i], values + side * change * direction, *given[i + 1 :])[0] for side in (1, -1)
        ]
        differences = (ends[0] - ends[1]) / (2 * change)
        np.testing.assert_allclose(by_mode, differences, rtol=1e-6, atol=1e-7)


def test_what_has_no_balance_is_not_a_number():
    """NaN, and no endless loop."""
    law = Law(Switch(1e-3, "linear"), jnp.ones(1), jnp.zeros(1))
    assert np.all(np.isnan(balanced_forces(law, jnp.array([jnp.nan]), jnp.ones((1, 1)), jnp.zeros(1))))
