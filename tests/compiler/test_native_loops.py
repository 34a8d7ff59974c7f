"""The wrappers that ask XLA for native loops: right under every transformation, in effect, and never in the way."""

import re
import subprocess
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from stickslip_jax._compiler import native
from stickslip_jax._compiler.native import CompiledNatively, compilable, computed_once, native_loop, native_loops_work

X = np.linspace(0.1, 0.9, 8)
LARGE = 1 << 12  # loops over less become native without being asked to


def doubling(x):
    return lax.fori_loop(0, 5, lambda _, y: y * y + 0.1, x)


def shared(x):
    """Two results of one long product."""
    product = x
    for factor in range(2, 12):
        product = product * (x + factor)
    return jnp.sin(product), product - x


def along(f):
    return lambda x: jax.jvp(f, (x,), (jnp.ones_like(x),))


FORWARD = {
    "plain": lambda f: f,
    "jit": jax.jit,
    "vmap": jax.vmap,
    "jvp": along,
    "jit of jvp": lambda f: jax.jit(along(f)),
    "jit of jvp of jvp": lambda f: jax.jit(along(along(f))),
    "second derivative alone": lambda f: jax.jit(lambda x: along(along(f))(x)[1][1]),
    "jit of vmap of jvp of vmap": lambda f: jax.jit(jax.vmap(along(jax.vmap(f)), in_axes=1, out_axes=1)),
}
REVERSE = {
    "grad": lambda f: jax.grad(lambda x: jax.tree.leaves(f(x))[0].sum()),
    "vmap of grad": lambda f: jax.vmap(jax.grad(lambda x: jax.tree.leaves(f(x))[0].sum())),
    "grad of jit of vmap": lambda f: jax.grad(lambda x: jax.tree.leaves(jax.jit(jax.vmap(f))(x))[0].sum()),
}


def assert_the_same(wrap, function, transform, x):
    got, expected = (jax.tree.leaves(transform(f)(jnp.asarray(x))) for f in (wrap(function), function))
    for a, b in zip(got, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize("transform", FORWARD.values(), ids=FORWARD)
def test_a_native_loop_gives_the_same(transform):
    assert_the_same(native_loop, doubling, transform, X.reshape(2, 4))


@pytest.mark.slow
@pytest.mark.parametrize("transform", [*FORWARD.values(), *REVERSE.values()], ids=[*FORWARD, *REVERSE])
def test_what_is_computed_once_is_the_same(transform):
    assert_the_same(computed_once, shared, transform, X if transform in REVERSE.values() else X.reshape(2, 4))


def test_called_outside_of_jit_a_native_loop_is_compiled_once():
    loop = native_loop(doubling)
    caches = (native._compiled, native._with_tangents, native._batched)
    for transform in (lambda f: f, jax.vmap, along, lambda f: jax.vmap(along(f))):
        misses = []
        for _ in range(3):
            jax.block_until_ready(transform(loop)(jnp.asarray(X)))
            misses.append([cache.cache_info().misses for cache in caches])
        assert misses[1] == misses[2]


def compiled_text(function, *args) -> str:
    return jax.jit(function).lower(*args).compile().as_text()


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the attributes are those of the CPU back end")
def test_the_tag_is_on_the_call_alone():
    # On what is inside, it would keep XLA from fusing anything: the loop would be slower than without.
    assert native_loops_work()
    text = compiled_text(lambda x: native_loop(doubling)(x) + 1, np.ones(LARGE))
    tagged = [line for line in text.splitlines() if "xla_cpu_small_call" in line]
    assert tagged
    assert all(re.search(r"\bcall\(|get-tuple-element\(", line) for line in tagged)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the attributes are those of the CPU back end")
def test_shared_values_are_computed_once():
    def products(wrap):
        def twice(x):
            first, second = jax.vmap(wrap(lambda x: shared(x)[1]))(x), jnp.zeros(())
            return jnp.exp2(first), first * 3 + second

        return compiled_text(twice, X).count(" multiply(")

    assert products(computed_once) < products(lambda f: f)


def test_what_xla_refuses_is_compiled_plainly_with_one_warning():
    matrix = np.eye(64)

    def with_product(x):  # a matrix product inside of a loop: no native code for it
        return lax.fori_loop(0, 3, lambda _, y: jnp.tanh(matrix @ y), x)

    compiled = CompiledNatively(with_product)
    start = np.linspace(0, 1, 64)
    expected = np.tanh(np.tanh(np.tanh(start)))
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        for _ in range(2):
            np.testing.assert_allclose(compiled(start), expected, rtol=1e-12)
    assert len(seen) <= 1  # newer versions of XLA may know how
    assert all("native loop" in str(one.message) for one in seen)


def test_errors_of_the_function_itself_are_not_hidden():
    def wrong(x):
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        CompiledNatively(wrong)(1.0)


def test_without_native_loops_everything_still_works(monkeypatch):
    monkeypatch.setattr(native, "native_loops_work", lambda: False)
    np.testing.assert_allclose(native_loop(doubling)(X), doubling(X), rtol=1e-15)
    text = compiled_text(native_loop(doubling), np.ones(LARGE))
    assert "xla_cpu_small_call" not in text


# XLA ends the process where a native function does not read an argument: hence a process of its own.
DROPPING = """
import jax, jax.numpy as jnp
from jax import lax
from stickslip_jax._compiler.native import native_loop

def loop(x, unread, kept, first):
    def step(carry):
        number, x, kept = carry
        return number + 1, 1.01 * x, lax.dynamic_update_index_in_dim(kept, x, number, 1)
    return lax.while_loop(lambda carry: (carry[0] < 40) & (carry[1][0] < 100), step, (first, x, kept))

x, kept = jnp.ones(300), jnp.zeros((300, 40))
for used in ((0,), (1,), (2,), (0, 1), (1, 2)):
    def some(x, kept):
        results = native_loop(loop)(x, kept[0], kept, jnp.int32(0))
        return [results[place] for place in used]
    jax.block_until_ready(jax.jit(some)(x, kept))
    jax.block_until_ready(jax.jit(jax.vmap(some))(x[None], kept[None]))
    real = lambda x: some(x, kept)[-1].astype(float)
    jax.block_until_ready(jax.jvp(real, (x,), (x,)))
    slope = lambda f: lambda x: jax.jvp(f, (x,), (x,))[1]
    jax.block_until_ready(jax.jit(slope(real))(x))
    jax.block_until_ready(jax.jit(slope(slope(real)))(x))
    jax.block_until_ready(jax.jit(jax.vmap(slope(slope(slope(real)))))(x[None]))
print("done")
"""


@pytest.mark.slow
def test_results_and_arguments_that_nobody_reads_do_no_harm():
    done = subprocess.run([sys.executable, "-c", DROPPING], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


@pytest.mark.slow
def test_of_functions_that_hold_a_users_only_what_is_known_is_native():
    """XLA cannot sort in a native loop, nor add up thousands of numbers; their derivatives have other operations."""

    def loop(inside):
        return native_loop(lambda x: lax.scan(lambda y, _: (inside(y), y), x, None, length=4), known_only=True)

    cases = {
        "arithmetic": (jnp.cos, X, True),
        "sorted": (lambda y: jnp.sort(y) * 0.5, X, False),
        "solved": (lambda y: jnp.linalg.solve(jnp.eye(8) + 0.1, y), X, False),
        "branches": (lambda y: lax.cond(y[0] > 0, jnp.sin, jnp.sort, y), X, False),
        "large": (lambda y: y / jnp.sum(y), np.linspace(0.1, 0.9, LARGE), False),
    }
    for name, (inside, x, is_native) in cases.items():
        assert compilable(jax.make_jaxpr(inside)(x).jaxpr) == is_native, name
        right = lax.scan(lambda y, _, inside=inside: (inside(y), y), jnp.asarray(x), None, length=4)
        for found, expected in zip(loop(inside)(jnp.asarray(x)), right, strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_what_a_native_loop_encloses_may_be_traced():
    def total(factor):
        return native_loop(lambda x: lax.fori_loop(0, 3, lambda _, y: factor * y, x), known_only=True)(1.5)

    np.testing.assert_allclose(jax.vmap(total)(jnp.array([2.0, 3.0])), [12.0, 40.5])


def test_trajectories_advance_in_blocks_of_lanes():
    """Of at most four here: a power in three steps, the way to it, and a number that no lane changes."""

    def motion(factor, start):
        def step(y, _):
            return factor * y, factor * y

        return *lax.scan(step, start, None, length=3), 2 * factor

    call, factor, powers = native_loop(motion, known_only=True, most=4), jnp.asarray(1.5), 1.5 ** np.arange(1, 4)
    for size in (0, 1, 4, 5, 11):
        starts = np.arange(float(size))
        for transform in (jax.vmap, lambda f, *axes: jax.jit(jax.vmap(f, *axes))):
            ends, ways, twice = transform(call, (None, 0), (0, 1, None))(factor, jnp.asarray(starts))
            np.testing.assert_allclose(ends, powers[-1] * starts, rtol=1e-15)
            np.testing.assert_allclose(ways, powers[:, None] * starts[None], rtol=1e-15)
            assert float(twice) == 3.0
        alone = jax.jit(lambda starts: jax.vmap(call, (None, 0))(factor, starts)[0])(jnp.asarray(starts))
        np.testing.assert_allclose(alone, powers[-1] * starts, rtol=1e-15)  # the way is not computed
    table = np.arange(33.0).reshape(3, 11)
    ends = jax.vmap(jax.vmap(lambda x: call(factor, x)[0]), 1)(jnp.asarray(table))
    np.testing.assert_allclose(ends, powers[-1] * table.T, rtol=1e-15)
    slopes = jax.jvp(lambda f: jax.vmap(lambda x: call(f, x)[0])(jnp.asarray(table[1])), (factor,), (1.0,))[1]
    np.testing.assert_allclose(slopes, 3 * 1.5**2 * table[1], rtol=1e-15)
    slopes = jax.vmap(lambda f: jax.vmap(jax.jacfwd(lambda x: call(f, x)[0]))(jnp.asarray(table[1])))(jnp.ones(6))
    np.testing.assert_allclose(slopes, 1.0, rtol=1e-15)


def test_in_lanes_too_only_what_is_known_is_native():
    def loop(x):
        return lax.fori_loop(0, 4, lambda _, y: jnp.sort(y) * 0.5, x)

    table = np.random.default_rng(0).normal(size=(9, 8))
    found = jax.jit(jax.vmap(native_loop(loop, known_only=True, most=4)))(jnp.asarray(table))
    np.testing.assert_allclose(found, np.sort(table) / 16, rtol=1e-15)
