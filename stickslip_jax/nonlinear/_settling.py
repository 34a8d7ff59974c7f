"""Motions that go on until they have settled."""

import hashlib
import math

import equinox as eqx
import jax
import numpy as np

from .. import _checks
from .._dynamics.common.method import Exact
from ._cases import MOST_PERIODS, Cases, checked_numbers
from ._following import SEEN, Seen, block_size, in_blocks, periods_of
from ._orbits import periodic_orbit
from ._recurrence import UNSETTLED, approached, recurrence
from ._stored import Kept
from ._warnings import warn_of_unsettled

_LONGEST = 16  # times the transient periods, by default
_FEW_LANES = 64  # of blocks that are not made smaller where few cases have not settled
_MOST_ORBITS = 50  # cases that are decided by an orbit
_NEAR = 3.0  # times as far as the motion still moves: the orbit that it comes nearer to


def checked_periods(transient: object, kept: object, longest: object) -> tuple[int, int, int]:
    """The numbers of periods before those that are kept, of these, and the largest of those before; checked."""
    before, kept = checked_numbers(transient, kept)
    most = MOST_PERIODS - kept
    if longest is None:
        return before, kept, min(_LONGEST * before, most)
    return before, kept, _checks.whole_number("longest_transient", longest, minimum=before, maximum=most)


def settled(
    cases: Cases, seen: Seen, lasted: tuple[int, int, int], tolerance: float, progress: bool | None,
    stored: Kept, *, stacklevel: int,
) -> tuple[Seen, np.ndarray, np.ndarray]:  # fmt: skip
    """What was `seen`; of cases that have not settled, in later periods: twice as many before those that are kept,
    again and again. Also the `recurrence` of each case, and how many periods more came before those, (cases,).

    `lasted`: the numbers of periods before those that are kept, of these, and the largest of those before. Where it has
    not settled then, the multipliers of the orbit that a motion comes nearer to decide. Warns (RuntimeWarning) of the
    others, unless none was to go on.
    """
    transient, kept, longest = lasted
    seen, size = jax.tree.map(np.array, seen), block_size(cases.number, stored)
    states, sizes = np.asarray(seen.states), np.asarray(seen.sizes)  # the same memory, which later periods are put into
    turns = tuple(coordinate.period for coordinate in cases.system.coordinates)
    more, last = np.zeros(cases.number, int), transient
    found = recurrence(states, sizes, tolerance, turns)
    while last < longest and np.any(found == UNSETTLED):
        which = np.flatnonzero(found == UNSETTLED)
        gone, last = last + kept, min(2 * last, longest)
        last = max(last, gone)
        # Few block sizes, because each is compiled.
        small = size if size < _FEW_LANES else min(size, 4 ** math.ceil(math.log(len(which), 4)))
        name = f"more-{last}-{hashlib.sha256(which.tobytes()).hexdigest()[:12]}"
        own = cases.of(which, states[which, -1])
        later = in_blocks(own, periods_of(last - gone, kept), SEEN, progress, stored, small, name)
        later = later._replace(near_grazing_count=later.near_grazing_count + seen.near_grazing_count[which])
        for whole, part in zip(jax.tree.leaves(seen), jax.tree.leaves(later), strict=True):
            whole[which] = part
        more[which] = last - transient
        found[which] = recurrence(states[which], sizes[which], tolerance, turns)
    if cases.driven and longest > transient:
        for case in np.flatnonzero(found == UNSETTLED)[:_MOST_ORBITS]:
            found[case] = _by_orbits(cases, int(case), states[case], sizes[case], tolerance)
    if longest > transient:
        so_far = int(transient + np.max(more))
        warn_of_unsettled(found == UNSETTLED, so_far, "A larger longest_transient lets", stacklevel + 1)
    return seen, found, more


def _by_orbits(cases: Cases, case: int, states: np.ndarray, sizes: np.ndarray, tolerance: float) -> int:
    """The number of periods of the stable orbit that a motion comes nearer to; -1 where none is found near it."""
    own = cases.of(np.array([case]), states[None, -1]).cycle
    one = jax.tree.map(lambda leaf: leaf[0] if eqx.is_array(leaf) else leaf, own)
    turns = np.array([coordinate.period or np.inf for coordinate in cases.system.coordinates])
    scale = np.where(np.isfinite(turns), 1.0, np.fmax(sizes, np.max(np.abs(states), axis=0)))
    near = approached(states, sizes, tolerance, tuple(None if np.isinf(turn) else turn for turn in turns))
    for number, left in near:
        steps = one.method.max_steps
        method = Exact(one.method.step, None if steps is None else number * steps, one.method.solver)
        orbit = periodic_orbit(
            one.system, one.base, y0=tuple(map(float, states[-1])), periods=number, period=float(one.duration),
            method=method,
        )  # fmt: skip
        change = np.asarray(orbit.state) - states[-1]
        change -= np.where(np.isfinite(turns), turns, 0) * np.round(change / turns)
        is_near = np.max(np.abs(change) / scale) <= _NEAR * left * tolerance
        if bool(orbit.converged) and orbit.is_stable and is_near:
            return number
    return UNSETTLED
