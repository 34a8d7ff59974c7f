"""Small matrices in lanes: solutions, eigenvalues, and no program that could wait for itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh

import stickslip_jax as ss
from stickslip_jax._numerics.matrices import (
    WRITTEN_OUT,
    Banded,
    by_bands,
    dense,
    is_positive_definite,
    largest_eigenvalue,
    linear_solve,
    magnitudes,
    times,
)

SIZES = (1, WRITTEN_OUT, WRITTEN_OUT + 1, 20)


def positive_definite(size: int, *, symmetric: bool) -> np.ndarray:
    rng = np.random.default_rng(size)
    root, skew = rng.normal(size=(2, size, size))
    return root @ root.T + np.eye(size) + (0 if symmetric else skew - skew.T)


@pytest.mark.slow
@pytest.mark.parametrize("sides", [(), (3,)], ids=str)
@pytest.mark.parametrize("size", SIZES)
def test_solutions(size, sides):
    matrices = np.stack([positive_definite(size, symmetric=False) * scale for scale in (1e-8, 1.0, 1e8)])
    targets = np.random.default_rng(1).normal(size=(3, size, *sides))
    found = jax.jit(jax.vmap(linear_solve))(matrices, targets)
    expected = np.linalg.solve(matrices, targets if sides else targets[..., None]).reshape(targets.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, WRITTEN_OUT + 1])
def test_derivatives_of_solutions(size):
    """Of both arguments, in both modes and of second order: d(A^-1 b) = A^-1 (db - dA A^-1 b)."""
    matrix, rng = jnp.asarray(positive_definite(size, symmetric=False)), np.random.default_rng(2)
    target, change, weight = jnp.asarray(rng.normal(size=(3, size)))
    turn = rng.normal(size=(size, size))
    inverse = np.linalg.inv(matrix)
    solution = inverse @ target
    first = inverse @ (change - turn @ solution)
    second = -2 * inverse @ turn @ first

    def along(e):
        return linear_solve(matrix + e * turn, target + e * change)

    np.testing.assert_allclose(jax.jacfwd(along)(0.0), first, rtol=1e-9)
    np.testing.assert_allclose(jax.jacrev(along)(0.0), first, rtol=1e-9)
    np.testing.assert_allclose(jax.jacfwd(jax.jacrev(along))(0.0), second, rtol=1e-9)
    by_target = jax.grad(lambda b: weight @ linear_solve(matrix, b))(target)
    np.testing.assert_allclose(by_target, inverse.T @ weight, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 1e12])
@pytest.mark.parametrize("size", SIZES)
def test_largest_eigenvalue(size, ratio):
    """Of a stiffness that is not definite, with masses that differ by a factor of `ratio`."""
    rng = np.random.default_rng(3)
    mass, stiffness = ratio ** rng.uniform(size=size), rng.normal(size=(size, size))
    stiffness = stiffness + stiffness.T
    expected = np.max(np.abs(eigh(stiffness, np.diag(mass), eigvals_only=True)))
    np.testing.assert_allclose(largest_eigenvalue(jnp.asarray(stiffness / mass[:, None])), expected, rtol=1e-10)


def test_no_eigenvalue():
    assert largest_eigenvalue(jnp.zeros((3, 3))) == 0


@pytest.mark.slow_but_for("20", "1")
@pytest.mark.parametrize("size", SIZES)
def test_positive_definite(size):
    matrix = positive_definite(size, symmetric=True)
    smallest = np.linalg.eigvalsh(matrix)[0]
    for shift, expected in ((0.99 * smallest, True), (1.01 * smallest, False)):
        assert is_positive_definite(jnp.asarray(matrix - shift * np.eye(size))) == expected
    assert not is_positive_definite(jnp.full((size, size), jnp.nan))


OFFSETS = ((0,), (-1, 0, 1), (1,), (-2, 0))


@pytest.mark.slow_but_for("(1,)-(12, 12)", "(1,)-(9, 12)")
@pytest.mark.parametrize("shape", [(12, 12), (11, 12), (9, 12)], ids=str)
@pytest.mark.parametrize("offsets", OFFSETS, ids=str)
def test_products_by_bands(shape, offsets):
    rng = np.random.default_rng(4)
    matrix = sum(np.eye(*shape, offset) for offset in offsets) * rng.normal(size=shape)
    values = jnp.asarray(rng.normal(size=shape[1]))
    banded = by_bands(jnp.asarray(matrix))
    assert isinstance(banded, Banded)
    np.testing.assert_array_equal(dense(banded), matrix)
    np.testing.assert_array_equal(dense(magnitudes(banded)), np.abs(matrix))
    np.testing.assert_allclose(times(banded, values), matrix @ values, rtol=1e-14, atol=1e-14)


def test_what_is_not_stored_by_bands():
    small, full, none = np.eye(WRITTEN_OUT), np.ones((12, 12)), np.zeros((12, 12))
    for matrix in (small, full, none):
        assert not isinstance(by_bands(jnp.asarray(matrix)), Banded)
    kinds = []
    jax.jit(lambda matrix: kinds.append(type(by_bands(matrix))))(jnp.eye(12))  # its zeros are not known
    assert len(kinds) == 1
    assert kinds[0] is not Banded


class Blocks(ss.SwitchedSystem):
    """So many blocks in a row on the base."""

    stiffness: float = 1.0
    contacts = WRITTEN_OUT + 1

    @property
    def state_names(self):
        return tuple(f"{what} {i}" for what in ("position in m", "velocity in m/s") for i in range(self.contacts))

    def rates(self, t, y, base, friction):
        x, v = jnp.stack(y[: self.contacts]), y[self.contacts :]
        return (*v, *(self.stiffness * (jnp.roll(x, 1) - 2 * x + jnp.roll(x, -1)) - 0.3 * friction))

    def relative_velocity(self, t, y, base):
        return tuple(v - base.velocity for v in y[self.contacts :])

    @property
    def shortest_time(self):
        return 3.0


def row(stiffness):
    """So many masses with a mass matrix that couples them."""
    size = WRITTEN_OUT + 1
    mass = np.eye(size) + 0.1
    contacts = tuple(ss.Contact(direction, 1.0, ss.Coulomb(0.3)) for direction in np.eye(size))
    return ss.LinearStructure(mass, stiffness * np.eye(size), 0.1 * mass, contacts)


def calls_a_library(function, argument) -> bool:
    program = jax.jit(function).lower(argument).as_text()
    return any(name in program for name in ("lapack", "stablehlo.cholesky", "stablehlo.triangular_solve"))


@pytest.mark.parametrize(
    "function", [jnp.linalg.solve, jax.scipy.linalg.solve_triangular, lambda a, _: jnp.linalg.eigh(a)]
)
def test_a_library_would_be_seen(function):
    assert calls_a_library(lambda a: jax.vmap(function)(a, a), jnp.eye(9)[None])


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [ss.Exact(max_steps=64), ss.Regularized(step=0.1, width=1e-3, threshold=1e-3, minimum_duration=0.01)],
    ids=["exact", "regularized"],
)
@pytest.mark.parametrize("build", [row, pytest.param(Blocks, marks=pytest.mark.slow)], ids=["structure", "own system"])
def test_no_library_of_linear_algebra(build, method):
    """See `small_matrices`. Adaptive steps call one, the solver of diffrax, and never several at once."""

    def final(stiffness):
        return ss.simulate(build(stiffness), ss.Constant(0.1), t1=1.0, method=method).final_state[0]

    assert not calls_a_library(final, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("size", [pytest.param(2, marks=pytest.mark.slow), WRITTEN_OUT + 1])
def test_what_has_a_loop_is_compiled_once(size, caplog):
    """Outside a program too, where an ensemble begins: a loop that is compiled anew took seconds of each call."""
    matrix = jnp.eye(size) * 2

    def compiled(shift):
        caplog.clear()
        with jax.log_compiles(), caplog.at_level("WARNING"):
            linear_solve(matrix + shift, jnp.ones(size))
            largest_eigenvalue(matrix + shift)
            is_positive_definite(matrix + shift)
        return [record.message for record in caplog.records if "Finished XLA compilation" in record.message]

    jax.clear_caches()
    assert compiled(0.0)
    assert compiled(0.5) == []
