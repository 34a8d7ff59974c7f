"""Elementary functions against 40 digits, and random bits against the published generator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

from stickslip_jax._numerics.elementary import angle_of, exponential, key_data_of, log, random_words, sincos, uniform

COUNT = 3000
TYPES = [np.float64, np.float32]


def ulps(got, exact, least=0.0) -> float:
    """Worst error in units in the last place of the exact value, of `least` at least."""
    worst = 0.0
    with mp.workdps(40):
        for a, b in zip(np.ravel(got), exact, strict=True):
            unit = np.spacing(np.asarray(max(abs(float(b)), least)).astype(got.dtype))
            worst = max(worst, float(abs(mpf(float(a)) - b)) / float(unit))
    return worst


def exact(function, *arguments):
    with mp.workdps(40):
        return [function(*(mpf(float(value)) for value in row)) for row in zip(*arguments, strict=True)]


def angles(dtype, largest):
    source = np.random.default_rng(0)
    wide = source.uniform(-largest, largest, COUNT)
    small = np.exp(source.uniform(np.log(1e-9), 0, COUNT)) * source.choice([-1, 1], COUNT)
    corners = np.arange(-64, 65) * np.pi / 4
    return np.concatenate([wide, small, corners, [0.0]]).astype(dtype)


@pytest.mark.slow_but_for("5000.0-float64")
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("largest", [10.0, 5000.0])
def test_sincos(dtype, largest):
    """Two units in the last place, taken of 1/16 near the zeros, where only the absolute error is small.

    In float32 pi/2 is known to 2^-48 by its three parts, which leaves an error of 5000 * 2^-48 at 5000.
    """
    values = angles(dtype, largest)
    sine, cosine = (np.asarray(part) for part in jax.jit(sincos)(jnp.asarray(values)))
    assert sine.dtype == cosine.dtype == dtype
    assert ulps(sine, exact(mp.sin, values), least=1 / 16) < 2
    assert ulps(cosine, exact(mp.cos, values), least=1 / 16) < 2
    # Small angles keep their relative accuracy: the sine of a small arc must not drown in an absolute error.
    small = values[np.abs(values) < 0.5]
    assert ulps(np.asarray(sincos(jnp.asarray(small))[0]), exact(mp.sin, small)) < 1.5


def test_sincos_at_the_ends():
    sine, cosine = sincos(jnp.asarray([0.0, jnp.inf, jnp.nan]))
    assert (float(sine[0]), float(cosine[0])) == (0, 1)
    assert np.all(np.isnan(sine[1:]))
    assert np.all(np.isnan(cosine[1:]))


@pytest.mark.parametrize("dtype", TYPES)
def test_angle_of(dtype):
    source = np.random.default_rng(1)
    size = np.exp(source.uniform(-12, 12, 2 * COUNT))
    turn = np.concatenate([source.uniform(0, np.pi, COUNT), np.exp(source.uniform(-20, 0, COUNT))])
    y, x = (size * np.sin(turn)).astype(dtype), (size * np.cos(turn)).astype(dtype)
    y, x = np.append(y, [0, 0, 1, 1, 1]).astype(dtype), np.append(x, [1, -1, 0, 1, -1]).astype(dtype)
    got = np.asarray(jax.jit(angle_of)(jnp.asarray(y), jnp.asarray(x)))
    assert got.dtype == dtype
    assert ulps(got, exact(mp.atan2, y, x)) < 2.5
    assert np.all((got >= 0) & (got <= dtype(np.pi)))


def test_angle_of_the_origin_is_zero_and_its_derivative_finite():
    assert float(angle_of(jnp.asarray(0.0), jnp.asarray(0.0))) == 0
    slopes = jax.grad(angle_of, argnums=(0, 1))(jnp.asarray(0.0), jnp.asarray(0.0))
    assert [float(value) for value in slopes] == [0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", TYPES)
def test_log(dtype):
    """The uses are logs of (0, 1); next to 1, where the log vanishes, as well."""
    source = np.random.default_rng(2)
    info = np.finfo(dtype)
    values = np.concatenate(
        [
            source.uniform(0, 1, COUNT),
            np.exp(source.uniform(-30, 30, COUNT)),
            1 + source.uniform(-1, 1, COUNT) * 2.0 ** source.integers(-20, -1, COUNT),
            [1.0, info.tiny, info.max, 1 - info.epsneg, 1 + info.eps, 0.5, 2.0, np.sqrt(0.5), np.sqrt(2)],
        ]
    ).astype(dtype)
    values = values[values >= info.tiny]
    got = np.asarray(jax.jit(log)(jnp.asarray(values)))
    assert got.dtype == dtype
    assert ulps(got, exact(mp.log, values)) < 2
    assert float(log(jnp.asarray(1.0))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi / 2, 2.0, -7.5, 1000.0])
def test_sincos_derivatives_are_exact(angle):
    """First and second, in both modes, are the functions themselves and not derivatives of the polynomials."""
    sine, cosine = (float(part) for part in sincos(jnp.asarray(angle)))
    for mode in (jax.jacfwd, jax.jacrev):
        first = mode(sincos)(jnp.asarray(angle))
        assert [float(part) for part in first] == [cosine, -sine]
        second = mode(mode(sincos))(jnp.asarray(angle))
        assert [float(part) for part in second] == [-sine, -cosine]


@pytest.mark.parametrize(("y", "x"), [(0.3, 0.4), (2.0, -1.0), (1e-8, 1.0), (0.0, -3.0), (1.0, 0.0), (5.0, 5.0)])
def test_angle_of_derivatives_are_exact(y, x):
    squared = x * x + y * y
    for mode in (jax.jacfwd, jax.jacrev):
        by_y, by_x = mode(angle_of, argnums=(0, 1))(jnp.asarray(y), jnp.asarray(x))
        assert (float(by_y), float(by_x)) == pytest.approx((x / squared, -y / squared), rel=4e-16)


def test_log_derivative_is_exact():
    assert float(jax.grad(log)(jnp.asarray(0.3))) == 1 / 0.3
    assert float(jax.grad(jax.grad(log))(jnp.asarray(0.3))) == pytest.approx(-1 / 0.09, rel=4e-16)


def threefry(key, counter):
    """Threefry-2x32 with 20 rounds (Salmon et al. 2011), written down plainly with Python's integers."""
    mask = 0xFFFFFFFF
    schedule = [*key, key[0] ^ key[1] ^ 0x1BD11BDA]
    x, y = (counter[0] + schedule[0]) & mask, (counter[1] + schedule[1]) & mask
    for group in range(5):
        for rotation in ((13, 15, 26, 6), (17, 29, 16, 24))[group % 2]:
            x = (x + y) & mask
            y = ((y << rotation) | (y >> (32 - rotation))) & mask ^ x
        x = (x + schedule[(group + 1) % 3]) & mask
        y = (y + schedule[(group + 2) % 3] + group + 1) & mask
    return x, y


# Known answers of the Random123 library (kat_vectors, threefry 2x32 20).
KNOWN = [
    ((0x00000000, 0x00000000), (0x00000000, 0x00000000), (0x6B200159, 0x99BA4EFE)),
    ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
    ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
]


@pytest.mark.parametrize(("key", "counter", "answer"), KNOWN)
def test_plain_threefry_gives_the_known_answers(key, counter, answer):
    assert threefry(key, counter) == answer


def test_random_words_known_answer():
    high, low = random_words(jnp.zeros(2, jnp.uint32), jnp.zeros(1, jnp.uint32))
    assert (int(high[0]), int(low[0])) == KNOWN[0][2]


@pytest.mark.parametrize("key", [(0, 0), (0xFFFFFFFF, 0xFFFFFFFF), (0x13198A2E, 0x03707344), (7, 2**31)])
def test_random_words_are_threefry(key):
    counters = np.array([0, 1, 2, 1000, 2**31 - 1, 2**31, 2**32 - 1], np.uint32)
    high, low = jax.jit(random_words)(jnp.asarray(key, jnp.uint32), jnp.asarray(counters))
    expected = [threefry(key, (0, int(counter))) for counter in counters]
    assert list(zip(high.tolist(), low.tolist(), strict=True)) == expected


@pytest.mark.parametrize("seed", [0, 1, 12345])
def test_random_words_are_the_bits_of_jax(seed):
    key = jax.random.key(seed)
    with jax.threefry_partitionable(True):
        expected = np.asarray(jax.random.bits(key, (257,), "uint64"))
    high, low = random_words(key_data_of(key), jnp.arange(257, dtype=jnp.uint32))
    assert np.array_equal((np.asarray(high, np.uint64) << np.uint64(32)) | np.asarray(low, np.uint64), expected)


@pytest.mark.slow
def test_uniform_and_exponential_at_the_ends():
    """Never 0, 1 or infinite, whatever the bits: half a cell away from the ends."""
    ends = jnp.asarray([0, 2**32 - 1], jnp.uint32)
    for dtype, bits in ((jnp.float64, 52), (jnp.float32, 23)):
        draws = np.asarray(uniform(ends, dtype))
        assert draws.dtype == dtype
        assert 0 < draws[0] < draws[1] < 1
        longest, shortest = np.asarray(exponential(ends, ends, dtype))
        assert longest == pytest.approx((bits + 1) * np.log(2), rel=1e-6)
        assert 0 < shortest == pytest.approx(2.0 ** -(bits + 1), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", TYPES)
def test_exponential_is_minus_log_of_the_midpoint(dtype):
    words = jax.random.bits(jax.random.key(5), (2, 500), "uint32")
    bits = 52 if dtype == np.float64 else 23
    got = np.asarray(exponential(words[0], words[1], dtype))
    joined = [(int(high) << 32 | int(low)) >> (64 - bits) for high, low in zip(*words.tolist(), strict=True)]
    with mp.workdps(40):
        expected = [-mp.log((mpf(cell) + mpf("0.5")) / mpf(2) ** bits) for cell in joined]
    assert got.dtype == dtype
    assert ulps(got, expected) < 2
