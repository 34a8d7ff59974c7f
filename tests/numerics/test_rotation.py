"""The responses of a damped oscillator against 400 digits, from no spring and no damping to damping of any size."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

from stickslip_jax._numerics.elementary import responses


def exact(beta, squared, h) -> list[mpf]:
    """Impulse, rate, step and ramp, by the two rates of decay."""
    beta, squared, h = mpf(beta), mpf(squared), mpf(h)
    if beta == 0 and squared == 0:
        return [h, mpf(1), h * h / 2, h**3 / 6]
    root = mp.sqrt(mp.mpc(beta * beta - squared))
    if root == 0:  # critical
        root = mp.mpf(10) ** -150
        squared = beta * beta - root * root
    rates = squared / (beta + root), beta + root
    decays = [mp.exp(-rate * h) for rate in rates]
    once = [h if rate == 0 else (1 - decay) / rate for rate, decay in zip(rates, decays, strict=True)]
    twice = [h * h / 2 if rate == 0 else (h - sum_) / rate for rate, sum_ in zip(rates, once, strict=True)]
    pairs = [decays, [-rate * decay for rate, decay in zip(rates, decays, strict=True)], once, twice]
    return [mp.re((slow - fast) / (2 * root)) for slow, fast in pairs]


def numbers(dtype) -> tuple[np.ndarray, ...]:
    """Damping from none to strong, springs from none to stiff, nearly critical ones, and around the ends of series."""
    source, n = np.random.default_rng(5), 400
    softest = -60 if dtype == "float64" else -8
    beta, squared, h = (10 ** source.uniform(*ends, n) for ends in ((-4, 4), (softest, 1), (-4, 0.5)))
    squared[:50], beta[25:100] = 0, 0
    squared[100:150] = beta[100:150] ** 2 * (1 + source.choice([-1, 1], 50) * 10 ** source.uniform(-12, -1, 50))
    squared[150:160] = beta[150:160] ** 2
    beta[200:300] = source.uniform(0, 1, 100) / h[200:300]
    squared[200:300] = (source.uniform(0, 3, 100) / h[200:300]) ** 2
    return tuple(values.astype(dtype) for values in (beta, squared, h))


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_responses_keep_their_digits(dtype):
    beta, squared, h = numbers(dtype)
    found = np.stack(jax.vmap(responses)(beta, squared, h), axis=-1).astype(float)
    undamped = np.stack(jax.vmap(lambda w2, h: responses(0, w2, h))(squared, h), axis=-1).astype(float)
    with mp.workdps(400):
        args = list(zip(beta.tolist(), squared.tolist(), h.tolist(), strict=True))
        right = np.array([[float(v) for v in exact(*one)] for one in args])
        right_undamped = np.array([[float(v) for v in exact(0.0, *one[1:])] for one in args])
    for got, expected, b in ((found, right, beta), (undamped, right_undamped, 0 * beta)):
        turns = np.sqrt(squared.astype(float)) * h
        # Where it has turned back, and in decays of a rotation, the response passes zero: what counts is its size. An
        # angle, and the logarithm of a decay, has the round-off of its own size.
        size = np.where(turns < 1.5, np.abs(expected[:, 0]), 1 / np.maximum(np.sqrt(squared.astype(float)), 1e-30))
        size = np.where(b > 0, np.minimum(size, h), size)
        scales = np.stack([size, np.ones_like(size), np.abs(expected[:, 2]), np.abs(expected[:, 3])], axis=-1)
        ulps = 128 * np.finfo(dtype).eps * np.maximum(1, turns + np.minimum(b * h, 30))
        assert np.max(np.abs(got - expected) / scales / ulps[:, None]) < 1


@pytest.mark.slow
def test_slopes_of_responses_by_damping_spring_and_time():
    """At no spring too, in both modes."""
    values = [
        (b, w2, h) for b in (0, 1e-3, 0.4, 0.6, 3.0, 1e4) for w2 in (0, 1e-60, 0.01, 1.0) for h in (1e-3, 1.0, 5.0)
    ]
    points = np.array(values)
    flat = lambda p: jnp.stack(responses(p[0], p[1], p[2]))  # noqa: E731
    found, back = (np.asarray(jax.jit(jax.vmap(mode(flat)))(points)) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(back, found, rtol=1e-9, atol=1e-25)
    with mp.workdps(400):
        for point, slopes in zip(values, found, strict=True):
            here = exact(*point)
            for k in range(3):
                step = mpf("1e-90") * (point[k] or 1)
                there = exact(*(mpf(value) + (step if i == k else 0) for i, value in enumerate(point)))
                expected = [float((b - a) / step) for a, b in zip(here, there, strict=True)]
                np.testing.assert_allclose(slopes[:, k], expected, rtol=1e-9, atol=1e-25)
