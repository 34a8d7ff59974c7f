"""The random search over regularised motion in adaptive and in fixed steps, and shapes, against scipy's Radau."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.regularized import PHI

import stickslip_jax as ss

NUMBER, T1 = 100, 6.0
BOUND = {"adaptive": 1e-4, "fixed": 1e-2}


def drawn(seed: int, shape: str) -> np.ndarray:
    """Mass, stiffness, normal force, friction, damping, width, speed and tone of the base, offset, start."""
    source = np.random.default_rng([seed, *shape.encode()])
    mass, omega, load = 10 ** source.uniform(-1, 1), 10 ** source.uniform(-0.5, 0.7), 10 ** source.uniform(-0.5, 0.5)
    scale = load / (mass * omega)
    damping = mass * omega * source.choice([0.0, 1.0]) * source.uniform(0, 2)
    width, speed = scale * 10 ** source.uniform(-3, -1), scale * source.uniform(0.1, 3)
    tone = omega * source.uniform(0.2, 3)
    offset, x, v = scale * source.normal(size=3) * np.array([1, 1 / omega, 1])
    return np.array([mass, mass * omega**2, load, source.uniform(0.1, 1.5), damping, width, speed, tone, offset, x, v])


def by_radau(numbers, shape):
    m, k, n, mu, c, width, speed, tone, offset, x, v = numbers

    def rates(t, y):
        base = speed * math.cos(tone * t) + offset
        return [y[1], (-k * y[0] - c * y[1] - n * mu * float(PHI[shape]((y[1] - base) / width))) / m]

    scale = mu * n / math.sqrt(k * m) + abs(v)
    tolerance = scale * min(1.0, math.sqrt(m / k)) * 1e-10
    solved = solve_ivp(rates, (0.0, T1), (x, v), "Radau", rtol=1e-9, atol=tolerance, max_step=0.05)
    return solved.y[:, -1], np.max(np.abs(solved.y), axis=1)


@partial(jax.jit, static_argnames=("shape", "kind"))
def follow(numbers, shape, kind):
    def one(row):
        m, k, n, mu, c, width, speed, tone, offset, x, v = row
        step = {"step": 0.005 * jnp.sqrt(m / k)} if kind == "fixed" else {"rtol": 1e-8}
        system = ss.MassSpring(m, k, n, ss.Coulomb(mu), c)
        method = ss.Regularized(width, shape, max_steps=2**13, **step)
        found = ss.simulate(system, ss.Harmonic(speed, tone, offset=offset), t1=T1, y0=(x, v), method=method)
        return jnp.stack(found.final_state), found.status

    return jax.vmap(one)(numbers)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["adaptive", "fixed"])
@pytest.mark.parametrize("shape", ["linear", "tanh"])
def test_states(shape, kind):
    cases = np.stack([drawn(seed, shape) for seed in range(NUMBER)])
    state, status = map(np.asarray, follow(cases, shape, kind))
    wrong, finished = {}, status == ss.Status.FINISHED
    assert np.mean(finished) > 0.8
    for i in np.flatnonzero(finished):
        exact, largest = by_radau(cases[i], shape)
        error = np.max(np.abs(state[i] - exact) / largest)
        if error > BOUND[kind]:
            wrong[int(i)] = error
    assert not wrong
