"""Sticks as engines record them and as results hold them: one definition of the columns, one of the ending."""

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import NUMBERS, FlatSticks, Sticks, ending_of, with_columns


@pytest.mark.parametrize(("is_stick", "released", "cut"), list(itertools.product((False, True), repeat=3)))
def test_a_stick_is_released_or_cut_or_ended_by_a_switch(is_stick, released, cut):
    ended = ss.Ending.RELEASED if released else ss.Ending.HORIZON if cut else ss.Ending.BASE_SWITCHED
    code = ending_of(jnp.asarray(is_stick), jnp.asarray(released), jnp.asarray(cut))
    assert (int(code), code.dtype) == (ended if is_stick else -1, jnp.int8)


def flat():
    start = np.array([1.0, 3.0, 0.0], np.float32)
    return FlatSticks.of(np.array([2, 0, 1]), start, start + 1, np.array([0, 1, 2], np.int8), position=np.arange(3.0))


def test_columns_are_those_of_a_record():
    """By name, in the precision of the times; what is not given is not known."""
    assert (*NUMBERS, "ending", "mask", "contact") == tuple(field.name for field in dataclasses.fields(Sticks))
    sticks = flat()
    assert tuple(sticks.columns) == ("count", *NUMBERS, "ending")
    for name in NUMBERS:
        column = getattr(sticks, name)
        assert column.dtype == np.float32
        assert np.all(np.isnan(column)) == (name not in ("start", "end", "position"))
    for mine, its in zip(sticks, FlatSticks.of(**sticks.columns), strict=True):
        np.testing.assert_array_equal(mine, its)
    with pytest.raises(AttributeError, match="'FlatSticks' object has no attribute 'length'"):
        _ = sticks.length
    moved = with_columns(sticks, position=np.zeros(3))
    assert moved.position.tolist() == [0, 0, 0]
    assert sticks.position.tolist() == [0, 1, 2]


def test_in_slots():
    padded = flat().padded()
    np.testing.assert_array_equal(padded.mask, [[True, True], [False, False], [True, False]])
    np.testing.assert_array_equal(padded.start, [[1, 3], [np.nan, np.nan], [0, np.nan]])
    np.testing.assert_array_equal(padded.ending, [[0, 1], [-1, -1], [2, -1]])
