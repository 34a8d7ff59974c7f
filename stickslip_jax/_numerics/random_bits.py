"""Counter-based random bits: word ``i`` of the stream of a key is computed from the key and ``i`` alone.

So a stream can be cut into blocks anywhere and continued without end, and a longer sample of the same key begins
with the shorter one. The generator is JAX's own threefry-2x32; ``random_words`` returns the bits that
``jax.random.bits(key, (n,), "uint64")`` holds at those positions. It is written out here because JAX's CPU version
runs its 20 rounds as a rolled loop, four times slower (Salmon et al. 2011, "Parallel random
numbers: as easy as 1, 2, 3").
"""

import jax
import jax.numpy as jnp
import numpy as np

from .._checks import show
from .._compiler import computed_once
from .._types import Array, FloatArray, KeyData
from .elementary import log

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def key_data_of(key: Array) -> Array:
    """The two 32-bit words of a threefry key (new style ``jax.random.key`` or old style ``PRNGKey``).

    Raises ValueError for anything else; other generators are refused because under ``vmap`` some of them
    give every element of the batch the same stream.
    """
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        if "fry" in str(jax.random.key_impl(key)) and key.shape == ():
            return jax.random.key_data(key)
    elif isinstance(key, (jax.Array, np.ndarray)) and key.dtype == np.uint32 and key.shape == (2,):
        return jnp.asarray(key)
    raise ValueError(f"Argument key must be a threefry key made by jax.random.key(seed), but {show(key)} was given.")


def random_words(words: KeyData, counter: Array) -> tuple[Array, Array]:
    """High and low 32 random bits for each 32-bit ``counter`` (any shape)."""
    schedule = (words[0], words[1], words[0] ^ words[1] ^ np.uint32(0x1BD11BDA))
    x = jnp.zeros_like(counter) + schedule[0]
    y = counter + schedule[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = x + y
            y = x ^ ((y << np.uint32(rotation)) | (y >> np.uint32(32 - rotation)))
        x = x + schedule[(group + 1) % 3]
        y = y + schedule[(group + 2) % 3] + np.uint32(group + 1)
    return x, y


def stored_words(words: KeyData, counter: Array) -> tuple[Array, Array]:
    """`random_words`, computed only once for both words and all their uses."""
    if not jax.config.read("jax_enable_x64"):
        return computed_once(random_words)(words, counter)
    both = computed_once(_joined_words)(words, counter)
    return (both >> np.uint64(32)).astype(np.uint32), both.astype(np.uint32)


def _joined_words(words: KeyData, counter: Array) -> Array:
    """Both words in one number; XLA would compute each of two results from the beginning."""
    high, low = random_words(words, counter)
    return (high.astype(np.uint64) << np.uint64(32)) | low.astype(np.uint64)


def exponential(high: Array, low: Array, dtype) -> FloatArray:
    """Exponential deviates of mean 1 from random words: ``-log(u)``, u from `fine_uniform`."""
    return -log(fine_uniform(high, low, dtype))


def fine_uniform(high: Array, low: Array, dtype) -> FloatArray:
    """Uniform deviates from both random words: ``(j + 1/2) / 2^52`` (2^23 in float32)."""
    if jnp.dtype(dtype) == jnp.float64:
        mantissa = ((high.astype(jnp.uint64) << np.uint64(32)) | low.astype(jnp.uint64)) >> np.uint64(12)
        one_to_two = jax.lax.bitcast_convert_type(mantissa | np.uint64(0x3FF0000000000000), jnp.float64)
        return one_to_two - (1 - 2.0**-53)
    one_to_two = jax.lax.bitcast_convert_type((high >> np.uint32(9)) | np.uint32(0x3F800000), jnp.float32)
    return one_to_two - np.float32(1 - 2.0**-24)


def uniform(words: Array, dtype) -> FloatArray:
    """Uniform deviates from 32 random bits (23 in float32): the midpoints of equal cells of (0, 1)."""
    bits = 32 if jnp.dtype(dtype) == jnp.float64 else 23
    return ((words >> np.uint32(32 - bits)).astype(dtype) + 0.5) * np.asarray(2.0**-bits, dtype)
