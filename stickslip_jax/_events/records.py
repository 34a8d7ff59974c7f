"""What every engine leaves of a trajectory: a record for each interval or step, and sums over its sticks."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._types import BoolArray, FloatArray, IntArray


class StickRecord(NamedTuple):
    """The stick of one interval, if any; times in s, position in m."""

    start: FloatArray
    end: FloatArray
    position: FloatArray
    ending: IntArray  # an `Ending` code, or -1 where there is no stick


class Totals(NamedTuple):
    """Sums over the sticks of one trajectory."""

    sticks: IntArray
    censored: IntArray  # number of sticks cut by the horizon: 0 or 1
    stick_time: FloatArray


def start_totals(dtype) -> Totals:
    """Nothing counted yet."""
    none = jnp.zeros((), jnp.int32)
    return Totals(none, none, jnp.zeros((), dtype))


def count_slips(totals: Totals, at_start: BoolArray) -> IntArray:
    """Number of slips: one between any two sticks, one before and one after them where no stick reaches."""
    return totals.sticks + 1 - at_start.astype(jnp.int32) - totals.censored


def closed_up(records: StickRecord) -> StickRecord:
    """One trajectory's records (intervals,) with the sticks first; differentiable, fixed size.

    Spare slots hold NaN, and -1 as ending.
    """
    stuck = records.ending >= 0
    (order,) = jnp.nonzero(stuck, size=stuck.shape[0], fill_value=0)
    is_stick = jnp.arange(stuck.shape[0]) < stuck.sum()
    ordered = jax.tree.map(lambda column: jnp.where(is_stick, column[order], jnp.nan), records._replace(ending=None))
    return ordered._replace(ending=jnp.where(is_stick, records.ending[order], -1))


def no_stick(dtype: Any) -> StickRecord:
    """The record of a turn in which no stick ended."""
    nothing = jnp.zeros((), dtype)
    return StickRecord(nothing, nothing, nothing, jnp.asarray(-1, jnp.int8))
