"""Motions that go on until they have settled, and after how many returns they repeat themselves."""

import hashlib
import math
from collections.abc import Iterator

import jax
import numpy as np

from .._dynamics.common.method import Exact
from .._foundation import checks
from ._cases import MOST_PERIODS, Cases, Turns, checked_numbers
from ._following import Kept, SeenCases, block_size, in_blocks, periods_of, warn_of_unsettled
from ._orbits import periodic_orbit

# After how many returns a motion repeats itself, and whether it has settled.


_ROUND_OFF = 100  # times the spacing of numbers of the size of the largest number of the state
_LEAST = 8  # returns by which one sees whether differences fall
_COMPARED = 16  # differences of several returns: of fewer, chance would make all smaller too often
_SYSTEMATIC = 0.9  # of the differences: smaller than those before, or larger
_FAST = 0.1  # of the largest in the first half: those of the second half
_FAR_LESS = 1e-2  # of the differences of all smaller numbers of returns, which change
_LEFT = 0.5  # tolerances: the way that is left
_RETURNS = 1, 2, 3, 4, 5, 6, 8  # of orbits near which a motion may turn
_FITS = 0.003  # of each difference: what an affine map may leave of it
_SHRINKS = 0.05  # the least change of differences over what is seen, as a logarithm
_RANK = 1e-6  # of the largest singular value: directions in which the motion does not turn
UNSETTLED = -1
RECURS = 1e-6  # relative: states this near are the same


def recurrence(states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns) -> np.ndarray:
    """The smallest number of returns after which all `states` recur, (cases,); 0 where none is found, and -1 where the
    motion has not settled.

    Of the states (cases, returns, coordinates), at least twice as many returns are needed as the number found. They
    recur if each number comes back to within `tolerance` times its largest size in the same motion, `sizes` (cases,
    coordinates), or to round-off: other cases, which may be far larger, do not matter. `periods`: of coordinates that
    turn. A motion that still comes nearer to its attractor, or leaves an orbit that is unstable, has not settled: the
    differences of the number of returns for which they are smallest still fall, or grow, return after return; if they
    are within the tolerance, by more than it until they were to have fallen to zero; or it turns about the orbit (see
    `_turning`). Of fewer than eight returns this is not seen.
    """
    found = np.zeros(len(states), int)
    recurring: list[np.ndarray] = []
    late, late_size = found.copy(), np.full(len(states), np.inf)
    least, is_changing = late_size.copy(), np.zeros(len(states), bool)
    for number, error in _differences(states, sizes, tolerance, periods):
        size, left, changes = _tendency(error, number)
        recurs = np.all(error <= 1, axis=1)  # False where a state is NaN
        recurring.append(recurs)
        if not np.all(np.isfinite(size) | np.isnan(size)):  # too few to see whether they change
            late_size = np.where((late == 0) & recurs, np.max(error, axis=1), late_size)
            late = np.where((late == 0) & recurs, number, late)
            continue
        settled = (found == 0) & recurs & (~changes | (left <= _LEFT))
        # Where it comes nearer from both sides in turn, it is twice the number that tells the way that is left.
        for divisor in [one for one in range(1, number + 1) if number % one == 0]:
            found = np.where((found == 0) & settled & recurring[divisor - 1], divisor, found)
        # A smaller number that recurs from now on: the larger one only seems to be that of the motion.
        found = np.where((found == 0) & changes & (size <= 1) & ~recurs, UNSETTLED, found)
        is_changing = np.where(size < least, changes & (size > 0), is_changing)
        least = np.fmin(size, least)
    found = np.where((found == 0) & (~is_changing | (late_size < _FAR_LESS * least)), late, found)
    found = np.where((found == 0) & is_changing, UNSETTLED, found)
    (others,) = np.nonzero(found == 0)
    for _, number in _turning(states[others], sizes[others], tolerance, periods):
        found[others[np.isfinite(number)]] = UNSETTLED
    return found


def _differences(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns
) -> Iterator[tuple[int, np.ndarray]]:
    """Each number of returns, and how far the states are from those so many returns later, in tolerances, (cases,
    returns); 0 for round-off.
    """
    smallest, limit = _limits(states, sizes, tolerance, periods)
    for number in range(1, states.shape[1] // 2 + 1):
        change = np.abs(_the_shorter_way(states[:, number:] - states[:, :-number], periods))
        yield number, np.max(np.where(change <= smallest, 0, change) / limit, axis=2)


def _limits(states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Of each case and coordinate the round-off, and the tolerance or the round-off, (cases, 1, coordinates)."""
    scale = _scales(states, sizes, periods)
    smallest = _ROUND_OFF * np.finfo(states.dtype).eps * np.max(scale, axis=1, keepdims=True)
    limit = np.fmax(tolerance * scale, smallest)[:, None]
    return smallest[:, None], np.where(limit > 0, limit, 1)  # 1: of a motion that has always been at zero


def _scales(states: np.ndarray, sizes: np.ndarray, periods: Turns) -> np.ndarray:
    """The largest size of each number of the states (cases, returns, coordinates), 1 of those that turn."""
    turns = np.array([period is not None for period in periods])
    return np.where(turns, 1.0, np.fmax(sizes, np.max(np.abs(states), axis=1)))


def _the_shorter_way(change: np.ndarray, periods: Turns) -> np.ndarray:
    """A change of the state, (..., coordinates), of coordinates that turn the shorter way."""
    turns = np.array([period or np.inf for period in periods])
    return change - np.where(np.isfinite(turns), turns, 0) * np.round(change / turns)


def _turning(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns
) -> Iterator[tuple[int, np.ndarray]]:
    """Numbers of returns, and how far states are from the orbit of so many that they turn about, in tolerances, (cases,
    ); infinity where they do not.

    Near an orbit the return map is affine: each difference of states is a matrix times the one before. It is found by
    least squares from the second half of the states; where it leaves nearly nothing of any difference, and its largest
    multiplier says that differences fall or grow, the motion has not settled, however the multiplier turns them.
    """
    smallest, limit = _limits(states, sizes, tolerance, periods)
    for number in _RETURNS:
        some = states[:, ::-1][:, ::number][:, ::-1]
        some = some[:, some.shape[1] // 2 :]
        if not len(states) or some.shape[1] < max(_LEAST, 2 * some.shape[2] + 2):
            continue
        change = _the_shorter_way(np.diff(some, axis=1), periods)
        change = np.where(np.abs(change) <= smallest, 0, change)
        moves = np.all(np.any(change != 0, axis=2), axis=1) & np.all(np.isfinite(change), axis=(1, 2))
        change = np.where(moves[:, None, None], change / limit, 1)
        before, after = change[:, :-1], change[:, 1:]
        matrix = np.linalg.pinv(before, rcond=_RANK) @ after
        rest, size = (np.max(np.abs(values), axis=2) for values in (after - before @ matrix, before))
        largest = np.max(np.abs(np.linalg.eigvals(matrix)), axis=1)
        shrinks = np.abs(np.log(np.where(largest == 0, 1, largest))) * after.shape[1] >= _SHRINKS
        to_orbit = np.linalg.pinv(np.eye(matrix.shape[-1]) - matrix)
        left = np.max(np.abs(change[:, -1:] @ to_orbit), axis=(1, 2))
        yield number, np.where(moves & shrinks & np.all(rest <= _FITS * size, axis=1), left, np.inf)


def _tendency(error: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of differences (cases, returns): the largest of the second half, the way that is left until they have fallen to
    zero, and whether they change systematically; infinity, infinity and False of too few.
    """
    returns = error.shape[1]
    half = returns // 2
    if returns + number < _LEAST or not half or (number > 1 and returns - number < _COMPARED):
        unknown = np.full(len(error), np.inf)
        return unknown, unknown, np.zeros(len(error), bool)
    first, second = np.max(error[:, :half], axis=1), np.max(error[:, half:], axis=1)
    ratio = np.divide(second, first, out=np.where(second > 0, np.inf, 0.0), where=first > 0)
    # Each later half is smaller by the same ratio, and holds so many differences one after another.
    left = np.where(ratio < 1, second * half / number * ratio / np.where(ratio < 1, 1 - ratio, 1), np.inf)
    step = min(number, returns - half)
    falls = np.mean(error[:, step:] < error[:, :-step], axis=1)
    grows = np.mean(error[:, step:] > error[:, :-step], axis=1)
    changes = (second > 0) & ((falls >= _SYSTEMATIC) | (grows >= _SYSTEMATIC) | (ratio < _FAST))
    return second, left, changes


# Motions that go on until they have settled.


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
    return before, kept, checks.whole_number("longest_transient", longest, minimum=before, maximum=most)


def settled(
    cases: Cases, seen: SeenCases, lasted: tuple[int, int, int], tolerance: float, progress: bool | None, stored: Kept
) -> tuple[SeenCases, np.ndarray, np.ndarray]:
    """What was `seen`; of cases that have not settled, in later periods: twice as many before those that are kept,
    again and again. Also the `recurrence` of each case, and how many periods more came before those, (cases,).

    `lasted`: the numbers of periods before those that are kept, of these, and the largest of those before. Where it has
    not settled then, the multipliers of the orbit that a motion comes nearer to decide. Warns (RuntimeWarning) of the
    others, unless none was to go on.
    """
    transient, kept, longest = lasted
    seen, size = jax.tree.map(np.array, seen), block_size(cases.number, stored)
    states, sizes = np.asarray(seen.states), np.asarray(seen.sizes)  # the same memory, which later periods are put into
    more, last = np.zeros(cases.number, int), transient
    found = recurrence(states, sizes, tolerance, cases.turns)
    while last < longest and np.any(found == UNSETTLED):
        which = np.flatnonzero(found == UNSETTLED)
        gone, last = last + kept, min(2 * last, longest)
        last = max(last, gone)
        # Few block sizes, because each is compiled.
        small = size if size < _FEW_LANES else min(size, 4 ** math.ceil(math.log(len(which), 4)))
        name = f"more-{last}-{hashlib.sha256(which.tobytes()).hexdigest()[:12]}"
        own = cases.of(which, states[which, -1])
        later = in_blocks(own, periods_of(last - gone, kept), SeenCases, progress, stored, small, name)
        later = later._replace(near_grazing_count=later.near_grazing_count + seen.near_grazing_count[which])
        for whole, part in zip(seen, later, strict=True):
            whole[which] = part
        more[which] = last - transient
        found[which] = recurrence(states[which], sizes[which], tolerance, cases.turns)
    if cases.driven and longest > transient:
        for case in np.flatnonzero(found == UNSETTLED)[:_MOST_ORBITS]:
            found[case] = _by_orbits(cases, int(case), states[case], sizes[case], tolerance)
    if longest > transient:
        so_far = f"{transient + np.max(more)} periods"
        warn_of_unsettled(found == UNSETTLED, so_far, "longest_transient", stacklevel=4)
    return seen, found, more


def _by_orbits(cases: Cases, case: int, states: np.ndarray, sizes: np.ndarray, tolerance: float) -> int:
    """The number of periods of the stable orbit that a motion comes nearer to; -1 where none is found near it."""
    seen = states[None], sizes[None], tolerance, cases.turns
    # The numbers of returns of the orbits to which it comes nearer, and how far it may still be from them (tolerances).
    near = []
    for number, error in _differences(*seen):
        size, _, changes = _tendency(error, number)
        if changes[0] and 0 < size[0] < np.max(error):
            near.append((number, float(size[0])))
    near += [(number, float(left[0])) for number, left in _turning(*seen) if np.isfinite(left[0])]
    one, scale = cases.cycle.of(case), _scales(states[None], sizes[None], cases.turns)[0]
    y0, steps = tuple(map(float, states[-1])), one.method.max_steps
    for number, left in near:
        method = Exact(one.method.step, None if steps is None else number * steps, one.method.solver)
        period = float(one.duration)
        orbit = periodic_orbit(one.system, one.base, y0=y0, periods=number, period=period, method=method)
        change = _the_shorter_way(np.asarray(orbit.state) - states[-1], cases.turns)
        is_near = np.max(np.abs(change) / scale) <= _NEAR * left * tolerance
        if bool(orbit.converged) and orbit.is_stable and is_near:
            return number
    return UNSETTLED
