"""The simulator for likelihood-free inference, against `simulate_ensemble` with the same numbers."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import stickslip_jax as ss

SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
LAW = ss.PoissonSwitching(1.0, 1.0)
KEY = jax.random.key(3)
ROWS = np.random.default_rng(0).uniform([0.3, 0.5], [1.5, 2.0], size=(40, 2))


def simulator(**options):
    given = {"system": SYSTEM, "law": LAW, "wrt": ("mu", "rate"), "t1": 20.0} | options
    return ss.stick_simulator(**given)


def directly(rows, y0=None, **options):
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(rows[:, 0].copy()))
    law = ss.PoissonSwitching(1.0, rows[:, 1].copy())
    return ss.simulate_ensemble(system, law, t1=20.0, samples=len(rows), key=KEY, y0=y0, keep="sticks", **options)


@pytest.mark.slow
def test_rows_are_samples_with_these_numbers():
    totals = directly(ROWS).totals
    found = simulator()(ROWS, KEY)
    assert_array_equal(found, np.column_stack([totals.sticks, totals.stick_time]))
    assert len(np.unique(found[:, 0])) > 5


@pytest.mark.slow
def test_means_over_realizations():
    totals = directly(np.repeat(ROWS, 3, axis=0)).totals
    both = np.column_stack([totals.sticks, totals.stick_time]).reshape(len(ROWS), 3, 2)
    assert_array_equal(simulator(realizations=3)(ROWS, KEY), both.mean(axis=1))


def longest_stick(many):
    return np.max(np.where(many.sticks.duration > 0, many.sticks.duration, 0), axis=1)[:, None]


@pytest.mark.slow
def test_summaries_of_ones_own():
    assert_array_equal(simulator(summaries=longest_stick)(ROWS, KEY), longest_stick(directly(ROWS)))


@pytest.mark.slow
def test_starts_and_single_names():
    starts = np.linspace(-0.5, 0.5, len(ROWS))
    found = simulator(wrt="y0[0]", y0=(0.0, 0.3))(starts[:, None], KEY)
    rows = np.tile([[0.7, 1.0]], (len(starts), 1))
    totals = directly(rows, y0=np.column_stack([starts, np.full(len(starts), 0.3)])).totals
    assert_array_equal(found, np.column_stack([totals.sticks, totals.stick_time]))


@pytest.mark.slow
def test_what_numpy_makes_an_array_of():
    class Tensor:  # as one of PyTorch
        def __array__(self, dtype=None, copy=None):
            return ROWS.astype(np.float32)

    assert_array_equal(simulator()(Tensor(), KEY), simulator()(ROWS.astype(np.float32), KEY))


@pytest.mark.slow
def test_rows_that_do_not_finish_are_told():
    hard = np.array([[1.0, 0.7], [4e6, 0.7], [2.0, 0.7]])
    base = ss.Harmonic(1.0, 1.0)
    run = simulator(law=base, wrt=("stiffness", "mu"), t1=5.0, method=ss.Exact(max_steps=400), realizations=2)
    with pytest.warns(RuntimeWarning, match=r"1 of 3 rows did not reach t1 = 5 s and are NaN"):
        found = run(hard, None)
    assert_array_equal(np.isnan(found), [[False] * 2, [True] * 2, [False] * 2])


BAD = [
    ({"wrt": "nu"}, "Argument wrt must name one of"),
    ({"wrt": ("mu", "mu")}, "Argument wrt must be a parameter's name or several different ones"),
    ({"wrt": ()}, "Argument wrt must be a parameter's name or several different ones"),
    ({"t1": -1.0}, "Argument t1 must be positive"),
    ({"method": "exact"}, "Argument method must be"),
    ({"threads": 0}, "Argument threads must be"),
    ({"law": "3.0"}, "Argument law must be a base motion"),
    ({"realizations": 0}, "Argument realizations must be a whole number of at least 1"),
    ({"summaries": "sticks"}, "Argument summaries must be a function"),
]


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_arguments(change, message):
    with pytest.raises(ValueError, match=message):
        simulator(**change)


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (ROWS[:, :1], r"Argument parameters must be an array \(batch, 2\) with a column for each of mu, rate"),
        (ROWS[0], r"Argument parameters must be an array \(batch, 2\)"),
        (ROWS[:0], r"Argument parameters must be an array \(batch, 2\)"),
        ("mu", "Argument parameters must be"),
        ([[0.5, -1.0]], "rate"),
        ([[0.5, np.nan]], "finite"),
    ],
)
def test_bad_rows(rows, message):
    with pytest.raises(ValueError, match=message):
        simulator()(rows, KEY)


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_summaries_of_another_shape():
    with pytest.raises(ValueError, match=r"Argument summaries must return an array \(40, summaries\)"):
        simulator(summaries=lambda many: many.totals.sticks)(ROWS, KEY)
