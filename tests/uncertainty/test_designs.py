"""Designs against those of scipy, SALib and itertools; how even they are; which realisation each sample uses."""

import itertools

import jax
import numpy as np
import pandas as pd
import pytest
from SALib.sample import sobol as salib_sample
from scipy import stats
from scipy.stats import qmc

import stickslip_jax as ss

NAMES = ["mu", "stiffness", "y0[0]"]
MADE = {
    "random": lambda **options: ss.design.random(8, NAMES, **options),
    "latin_hypercube": lambda **options: ss.design.latin_hypercube(8, NAMES, **options),
    "sobol": lambda **options: ss.design.sobol(8, NAMES, **options),
    "saltelli": lambda **options: ss.design.saltelli(4, NAMES, **options),
    "grid": lambda **options: ss.design.grid({"mu": [0.2, 0.5], "stiffness": [1, 2, 4]}, **options),
    "table": lambda **options: ss.design.table({"mu": [0.2, 0.5, 0.1]}, **options),
}
EACH = pytest.mark.parametrize("kind", MADE)
DRAWN = pytest.mark.parametrize("kind", ["random", "latin_hypercube", "sobol", "saltelli"])


@EACH
def test_names_kind_and_sizes(kind):
    made = MADE[kind]()
    numbers = made.u if made.is_uniform else made.values
    assert made.kind == kind
    assert numbers.shape == (len(made), made.dimensions) == (made.samples, len(made.names))
    assert numbers.dtype == np.float64
    assert made.is_uniform == (kind not in ("grid", "table")) == (made.values is None)
    assert kind in repr(made)
    assert f"{len(made)} samples" in repr(made)
    assert ", ".join(made.names) in repr(made)
    for array in (numbers, made.realization):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@EACH
def test_realizations(kind):
    own, common = MADE[kind](realization="own"), MADE[kind](realization="common")
    np.testing.assert_array_equal(own.realization, np.arange(len(own)))
    np.testing.assert_array_equal(common.realization, np.zeros(len(own)))
    blocks = np.arange(len(own)) // 2
    np.testing.assert_array_equal(MADE[kind](realization=blocks).realization, blocks)
    assert "each with its own realisation" in repr(own)
    assert "all with the same realisation" in repr(common)
    assert own.realization.dtype == np.int64


@DRAWN
def test_seeds(kind):
    """The same seed, whole number or key, gives the same numbers; another one others."""
    for seed, other in ((3, 4), (jax.random.key(3), jax.random.key(4)), (jax.random.PRNGKey(3), jax.random.key(4))):
        one, again, differs = (MADE[kind](seed=s).u for s in (seed, seed, other))
        np.testing.assert_array_equal(one, again)
        assert not np.any(one == differs)


@EACH
def test_rows_in_blocks(kind):
    """Blocks, put together, are the whole design; float32 numbers stay below 1."""
    made = MADE[kind]()
    parts = [made.block(first, 3) for first in range(0, len(made), 3)]
    for index, whole in enumerate((made.u if made.is_uniform else made.values, made.realization)):
        np.testing.assert_array_equal(np.concatenate([part[index] for part in parts]), whole)
        assert np.shares_memory(parts[0][index], whole)
    numbers, _ = made.block(1, 2, np.float32)
    assert numbers.dtype == np.float32
    np.testing.assert_allclose(numbers, parts[0][0][1:3], rtol=1e-7)


def test_float32_uniform_numbers_stay_below_one():
    made = ss.design.table({"mu": [1 - 2.0**-30, 2.0**-40, 0.5]}, uniform=True)
    assert np.float32(made.u[0, 0]) == 1
    np.testing.assert_array_equal(made.block(0, 3, np.float32)[0][:, 0], np.float32([1 - 2.0**-24, 2.0**-40, 0.5]))


def test_columns_by_number():
    """Without names, they are the random numbers of the model in their order."""
    made = ss.design.random(5, dimensions=2)
    assert made.names is None
    assert made.dimensions == 2
    assert made.column_names == ("u[0]", "u[1]")
    np.testing.assert_array_equal(made.u, ss.design.random(5, ["a", "b"], dimensions=2).u)


def test_random_numbers_are_uniform_and_independent():
    u = ss.design.random(20_000, dimensions=3, seed=1).u
    assert np.all((u > 0) & (u < 1))
    assert all(stats.kstest(column, "uniform").pvalue > 1e-3 for column in u.T)
    z = np.corrcoef(u.T)[np.triu_indices(3, 1)] * np.sqrt(len(u))
    assert np.all(np.abs(z) < 4)


def test_latin_hypercube_has_a_point_in_every_part():
    """And is scipy's."""
    u = ss.design.latin_hypercube(100, dimensions=4, seed=5).u
    np.testing.assert_array_equal(np.sort(np.floor(u * 100), axis=0), np.arange(100.0)[:, None].repeat(4, axis=1))
    np.testing.assert_array_equal(u, qmc.LatinHypercube(4, rng=np.random.default_rng(5)).random(100))


@pytest.mark.parametrize("scramble", [True, False])
def test_sobol_points_are_those_of_scipy_in_the_middle_of_their_cells(scramble):
    u = ss.design.sobol(256, dimensions=5, scramble=scramble, seed=9).u
    expected = qmc.Sobol(5, scramble=scramble, rng=np.random.default_rng(9)).random(256)
    np.testing.assert_array_equal(u - 2.0**-31, expected)
    assert u.min() > 0
    # A net: every one of 256 equal parts of each number holds one point, and so do the 16 x 16 cells of the first two.
    np.testing.assert_array_equal(np.sort(np.floor(u * 256), axis=0), np.arange(256.0)[:, None].repeat(5, axis=1))
    assert len(np.unique(np.floor(u[:, :2] * 16) @ [16, 1])) == 256


@pytest.mark.parametrize("second_order", [True, False])
@pytest.mark.parametrize("number", [1, 2, 4])
def test_saltelli_rows_are_those_of_salib(number, second_order):
    """In its order."""
    names = [f"x{index}" for index in range(number)]
    made = ss.design.saltelli(32, names, second_order=second_order, seed=7)
    problem = {"num_vars": number, "names": names, "bounds": [[0, 1]] * number}
    rows = salib_sample.sample(problem, 32, calc_second_order=second_order, seed=np.random.default_rng(7))
    np.testing.assert_array_equal(made.u - 2.0**-31, rows)
    assert len(made) == 32 * (2 * number + 2 if second_order else number + 2)
    assert made.base_samples == 32
    assert made.factors == tuple(names)


@pytest.mark.parametrize("second_order", [True, False])
def test_saltelli_realizations(second_order):
    """By the tables: rows that are mostly A's take the realisation of their base row, the others another one."""
    shared = ss.design.saltelli(8, NAMES, second_order=second_order)
    factor = ss.design.saltelli(8, NAMES, second_order=second_order, realization="factor")
    assert shared.factors == tuple(NAMES)
    assert factor.factors == (*NAMES, "realization")
    near_b = 4 if second_order else 1
    pattern = np.array([0] * 4 + [1] * near_b)
    np.testing.assert_array_equal(shared.realization.reshape(8, -1), np.arange(8)[:, None] + 8 * pattern[None])
    assert "16 realisations" in repr(shared)
    # The realisation is one more column: A's is i, B's is i + 8, and the rows are SALib's for one factor more.
    problem = {"num_vars": 4, "names": [*NAMES, "realization"], "bounds": [[0, 1]] * 4}
    rows = salib_sample.sample(problem, 8, calc_second_order=second_order, seed=0).reshape(8, -1, 4)
    which = np.where(rows[..., 3] == rows[:, :1, 3], 0, 8)
    np.testing.assert_array_equal(factor.realization.reshape(8, -1), np.arange(8)[:, None] + which)
    for column in range(3):
        numbers = factor.u.reshape(8, -1, 3)[..., column]
        is_a = rows[..., column] == rows[:, :1, column]
        np.testing.assert_array_equal(numbers == numbers[:, :1], is_a)
        np.testing.assert_array_equal(numbers == numbers[:, -1:], ~is_a)


def test_grid_holds_all_combinations_in_order():
    values = {"mu": [0.2, 0.5], "stiffness": np.array([1, 2, 4]), "y0[0]": (0.0,)}
    made = ss.design.grid(values)
    assert made.names == ("mu", "stiffness", "y0[0]")
    np.testing.assert_array_equal(made.values, list(itertools.product(*values.values())))


def test_tables_of_all_kinds():
    columns = {"mu": [0.2, 0.5, 0.1], "stiffness": [1, 2, 3]}
    matrix = np.array([*columns.values()]).T
    frame = pd.DataFrame(columns)
    for made in (
        ss.design.table(columns),
        ss.design.table(frame),
        ss.design.table(matrix, ["mu", "stiffness"]),
        ss.design.table(matrix.tolist(), ("mu", "stiffness")),
    ):
        assert made.names == ("mu", "stiffness")
        np.testing.assert_array_equal(made.values, matrix)
        assert made.factors == ()
    matrix[0] = 9.0
    assert made.values[0, 0] == 0.2
    uniform = ss.design.table(np.array([[0.25], [0.5]]), uniform=True)
    assert uniform.names is None
    np.testing.assert_array_equal(uniform.u, [[0.25], [0.5]])
