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
STIFFNESS, DAMPING = 0.3, 0.1  # of bristles, times what is called width


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


def friction(shape, mu, width):
    """The coefficient and the rate of the inner state, of velocity and inner state; of LuGre's law bristles bend."""
    if shape != "LuGre":
        return lambda v, z: mu * float(PHI[shape](v / width)), lambda v, z: 0.0

    def rate(v, z):
        return v - STIFFNESS / width * abs(v) * z / (mu * (1 + 0.3 * math.exp(-((v / (10 * width)) ** 2))))

    return lambda v, z: STIFFNESS / width * z + DAMPING / width * rate(v, z), rate


def by_radau(numbers, shape, rtol=1e-9):
    m, k, n, mu, c, width, speed, tone, offset, x, v = numbers
    coefficient, inner_rate = friction(shape, mu, width)
    numbers = 3 if shape == "LuGre" else 2

    def rates(t, y):
        slip, inner = y[1] - speed * math.cos(tone * t) - offset, y[-1]
        all_of_them = [y[1], (-k * y[0] - c * y[1] - n * coefficient(slip, inner)) / m, inner_rate(slip, inner)]
        return all_of_them[:numbers]

    scale = mu * n / math.sqrt(k * m) + abs(v)
    tolerance = np.array([*[scale * min(1.0, math.sqrt(m / k))] * 2, mu * width / STIFFNESS]) * rtol / 10
    start = np.array([x, v, 0.0])
    solved = solve_ivp(rates, (0.0, T1), start[:numbers], "Radau", rtol=rtol, atol=tolerance[:numbers], max_step=0.05)
    return solved.y[:2, -1], np.max(np.abs(solved.y[:2]), axis=1)


@partial(jax.jit, static_argnames=("shape", "kind"))
def follow(numbers, shape, kind, rtol=1e-8):
    def one(row, rtol):
        m, k, n, mu, c, width, speed, tone, offset, x, v = row
        step = {"step": 0.005 * jnp.sqrt(m / k)} if kind == "fixed" else {"rtol": rtol}
        law = ss.LuGre(mu, 1.3 * mu, 10 * width, STIFFNESS / width, DAMPING / width)
        system = ss.MassSpring(m, k, n, law if shape == "LuGre" else ss.Coulomb(mu), c)
        options = () if shape == "LuGre" else (width, shape)
        method = ss.Regularized(*options, max_steps=2**15 if shape == "LuGre" else 2**13, **step)
        found = ss.simulate(system, ss.Harmonic(speed, tone, offset=offset), t1=T1, y0=(x, v), method=method)
        return jnp.stack(found.final_state[:2]), found.status

    return jax.vmap(one)(numbers, jnp.broadcast_to(rtol, len(numbers)))


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "number"),
    [("tanh", 5), *(pytest.param(shape, 400, marks=pytest.mark.slow) for shape in (*PHI, "LuGre"))],
)
def test_errors_are_of_the_order_of_the_tolerance(shape, number):
    """Below 30 times the tolerance that is asked, from 1e-4 to 1e-8, against Radau at 1e-10.

    What is asked of a state is ``rtol |state| + atol``, and atol is `rtol` times the state's scale: ``N mu / k`` and
    ``N mu / sqrt(k m)`` here. A motion much smaller than these (a mass that the belt drags on one side) is not asked to
    be known to `rtol` of itself.
    """
    first = 1000
    cases = np.stack([drawn(first + seed, shape) for seed in range(number)])
    rtol = 10 ** np.random.default_rng(number).uniform(-8, -4, number)
    state, status = map(np.asarray, follow(cases, shape, "adaptive", rtol))
    wrong = {}
    for i in np.flatnonzero(status == ss.Status.FINISHED):
        exact, largest = by_radau(cases[i], shape, 1e-10)
        mass, stiffness, load, mu = cases[i, :4]
        scale = load * mu / np.array([stiffness, math.sqrt(stiffness * mass)])
        error = np.max(np.abs(state[i] - exact) / (largest + scale)) / rtol[i]
        if error > 30:
            wrong[first + int(i)] = error
    assert np.mean(status == ss.Status.FINISHED) > 0.9
    assert not wrong
