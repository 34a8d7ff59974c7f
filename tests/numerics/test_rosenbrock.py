"""A step of the Rosenbrock method against its orders, on equations with and without stiffness, few and many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stickslip_jax._numerics.steps import rosenbrock_step


def field(t, y):
    """Not linear, and time stands in it."""
    return (y[1] * jnp.cos(t) + 0.06 * y[0] ** 2, -y[0] + 0.5 * (1 - y[0] ** 2) * y[1] + jnp.sin(2 * t))


START = (1.0, 0.5)


def exact(t):
    def rates(t, y):
        return [y[1] * np.cos(t) + 0.06 * y[0] ** 2, -y[0] + 0.5 * (1 - y[0] ** 2) * y[1] + np.sin(2 * t)]

    return solve_ivp(rates, (0.0, t), START, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


@jax.jit
def stepped(y, t, h):
    return rosenbrock_step(lambda tau, y: field(t + tau, y), y, h)


def test_order_of_many_steps():
    errors = []
    for steps in (10, 20, 40):
        y, h = START, 2.0 / steps
        for number in range(steps):
            y, _, _ = stepped(y, number * h, h)
        errors.append(np.max(np.abs(np.array(y) - exact(2.0))))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 5, atol=0.2)


def test_orders_of_one_step():
    """Of the state 6 in one step; of the state in its middle and of the error 5."""
    found = []
    for h in (0.2, 0.1):
        reached, middle, error = stepped(START, 0.0, h)
        found.append([
            np.max(np.abs(np.array(reached) - exact(h))), np.max(np.abs(np.array(middle) - exact(h / 2))),
            np.max(np.abs(np.array(error))),
        ])  # fmt: skip
    orders = np.log2(np.array(found[0]) / found[1])
    assert orders[0] > 4.3  # an accident of this step: it is not yet as small as its order says
    np.testing.assert_allclose(orders[1:], 5, atol=0.1)


def test_what_decays_fast_is_gone_after_a_long_step():
    """L-stable: ``y' = -s (y - cos t) - sin t`` with s h from 1e2 to 1e12 comes to its slow solution ``cos t``,
    but for 13 / (s h): the stability function falls as 12.5 over that.
    """
    for fast in 10.0 ** np.arange(3, 13):
        (reached,), _, (error,) = rosenbrock_step(
            lambda tau, y, fast=fast: (-fast * (y[0] - jnp.cos(tau)) - jnp.sin(tau),),
            (jnp.asarray(2.0),),
            jnp.asarray(0.1),
        )
        assert abs(reached - np.cos(0.1)) < 13 / (fast * 0.1)
        assert abs(error) < 13 / (fast * 0.1)


@pytest.mark.parametrize("number", [8, 9, 20])
def test_many_numbers_as_few(number):
    """Numbers are followed one by one, or as one array: the same linear system, against the matrix's exponential."""
    random = np.random.default_rng(number)
    matrix = random.normal(size=(number, number)) / number - 3 * np.diag(random.uniform(0, 1, number))
    start = random.normal(size=number)

    def linear(tau, y):
        return tuple(jnp.asarray(matrix) @ jnp.stack(y))

    reached, middle, _ = jax.jit(lambda y, h: rosenbrock_step(linear, y, h))(tuple(start), 0.05)
    for part, h, bound in ((reached, 0.05, 1e-9), (middle, 0.025, 1e-7)):
        np.testing.assert_allclose(part, jax.scipy.linalg.expm(matrix * h) @ start, atol=bound)
