"""The tracks of a system with several contacts: what sticks are counted of, each contact and all at once."""

from typing import TypeVar

import jax

from ..._events.sticks import StickRecord, Sticks, Totals, sticks_in_order
from ..._systems.system import System

T = TypeVar("T")


def of_track(tree: T, system: System) -> T:
    """The arrays (..., tracks) in `tree`, or of these what the `system` counts alone, if it does."""
    return (
        tree if system.counted_track is None else jax.tree.map(lambda of_each: of_each[..., system.counted_track], tree)
    )


def sticks_and_totals(
    records: StickRecord, totals: Totals, system: System
) -> tuple[Sticks, Totals, tuple[Sticks, Totals] | None]:
    """The sticks and totals of one trajectory, and where every contact is counted those of all at once.

    `records`: (records,) or (records, tracks). `totals`: (tracks,), if there are any.
    """
    (records, totals), of_all = of_track((records, totals), system), None
    if system.track_count is not None:  # of what can stick, the last is all contacts at once
        of_all = (sticks_in_order(jax.tree.map(lambda of_each: of_each[:, -1], records)), _only(totals, -1))
        records, totals = jax.tree.map(lambda of_each: of_each[:, :-1], records), _only(totals, slice(-1))
    return sticks_in_order(records), totals, of_all


def _only(totals: Totals, part: int | slice) -> Totals:
    return jax.tree.map(lambda of_each: of_each[part], totals)
