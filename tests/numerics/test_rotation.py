"""The free motion of an oscillator against forty digits, from no damping to ratios of 10,000."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from stickslip_jax._numerics.rotation import free_motion


def exact(beta: float, h: float) -> tuple[float, ...]:
    """Kept, carried, slowed and settled for ``omega = 1``."""
    with mpmath.workdps(40):
        b, h = mpmath.mpf(beta), mpmath.mpf(h)
        w = mpmath.sqrt(mpmath.mpc(b * b - 1))
        even = mpmath.re(mpmath.exp(-b * h) * mpmath.cosh(w * h))
        odd = mpmath.exp(-b * h) * h if w == 0 else mpmath.re(mpmath.exp(-b * h) * mpmath.sinh(w * h) / w)
        return tuple(map(float, (even + b * odd, odd, even - b * odd, 1 - even - b * odd)))


def numbers(dtype) -> tuple[np.ndarray, np.ndarray]:
    source = np.random.default_rng(5)
    ratios = 10 ** source.uniform(-2, 4, 300)
    ratios[::10] = 1 + 10 ** source.uniform(-12, -2, 30) * source.choice([-1, 1], 30)
    return ratios.astype(dtype), (10 ** source.uniform(-6, 1, 300)).astype(dtype)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_free_motion_keeps_its_digits(dtype):
    ratios, times = numbers(dtype)
    assert np.max(ratios) > 5000
    assert np.min(ratios) < 0.05
    found = np.stack(jax.vmap(free_motion, in_axes=(0, None, 0))(ratios, jnp.ones((), dtype), times), axis=-1)
    right = np.array([exact(float(ratio), float(h)) for ratio, h in zip(ratios, times, strict=True)])
    # Under heavy damping what is carried is of the size 1 / (2 beta), and velocities of 1 / (4 beta^2) are left; what
    # has settled counts times the lag of a response, 2 beta, but for steps so short that series are summed.
    fast = np.maximum(1.0, 2.0 * ratios.astype(float))
    lag = np.where(fast * times > 0.7, fast, 1.0)
    scales = np.stack([np.ones(300), 1 / fast, np.maximum(np.abs(right[:, 2]), 1 / fast**2), 1 / lag], axis=-1)
    assert np.max(np.abs(found - right) / scales) < 64 * np.finfo(dtype).eps


def test_free_motion_without_damping_is_a_rotation():
    found = free_motion(0, jnp.array(4.0), jnp.array(0.3))
    np.testing.assert_allclose(found, [np.cos(0.6), np.sin(0.6) / 2, np.cos(0.6), 1 - np.cos(0.6)], rtol=1e-15)
