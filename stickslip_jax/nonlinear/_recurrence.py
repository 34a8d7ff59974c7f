"""After how many returns a motion repeats itself, and whether it has settled."""

from collections.abc import Iterator

import numpy as np

_ROUND_OFF = 100  # times the spacing of numbers of the size of the largest number of the state
_LEAST = 8  # returns by which one sees whether differences fall
_COMPARED = 16  # differences of several returns: of fewer, chance would make all smaller too often
_SYSTEMATIC = 0.9  # of the differences: smaller than those before, or larger
_FAST = 0.1  # of the largest in the first half: those of the second half
_FAR_LESS = 1e-2  # of the differences of all smaller numbers of returns, which change
_LEFT = 0.5  # tolerances: the way that is left
UNSETTLED = -1


def recurrence(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: tuple[float | None, ...]
) -> np.ndarray:
    """The smallest number of returns after which all `states` recur, (cases,); 0 where none is found, and -1 where the
    motion has not settled.

    Of the states (cases, returns, coordinates), at least twice as many returns are needed as the number found. They
    recur if each number comes back to within `tolerance` times its largest size in the same motion, `sizes` (cases,
    coordinates), or to round-off: other cases, which may be far larger, do not matter. `periods`: of coordinates that
    turn. A motion that still comes nearer to its attractor, or leaves an orbit that is unstable, has not settled: the
    differences of the number of returns for which they are smallest still fall, or grow, return after return; if they
    are within the tolerance, by more than it until they were to have fallen to zero. Of fewer than eight returns this
    is not seen.
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
    return np.where((found == 0) & is_changing, UNSETTLED, found)


def approached(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: tuple[float | None, ...]
) -> list[tuple[int, float]]:
    """The numbers of returns of one motion, (returns, coordinates), whose differences fall, and these (tolerances)."""
    found = []
    for number, error in _differences(states[None], sizes[None], tolerance, periods):
        size, _, changes = _tendency(error, number)
        if changes[0] and 0 < size[0] < np.max(error):
            found.append((number, float(size[0])))
    return found


def _differences(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: tuple[float | None, ...]
) -> Iterator[tuple[int, np.ndarray]]:
    """Each number of returns, and how far the states are from those so many returns later, in tolerances, (cases,
    returns); 0 for round-off.
    """
    turns = np.array([period is not None for period in periods])
    scale = np.where(turns, 1.0, np.fmax(sizes, np.max(np.abs(states), axis=1)))
    smallest = _ROUND_OFF * np.finfo(states.dtype).eps * np.max(scale, axis=1, keepdims=True)
    limit = np.fmax(tolerance * scale, smallest)[:, None]
    limit = np.where(limit > 0, limit, 1)  # of a motion that has always been at zero
    for number in range(1, states.shape[1] // 2 + 1):
        change = np.abs(states[:, number:] - states[:, :-number])
        for column, period in enumerate(periods):
            if period:
                change[..., column] = np.minimum(change[..., column] % period, -change[..., column] % period)
        yield number, np.max(np.where(change <= smallest[:, None], 0, change) / limit, axis=2)


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
