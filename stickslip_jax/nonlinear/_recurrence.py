"""After how many returns a motion repeats itself."""

import numpy as np

_ROUND_OFF = 100  # times the spacing of numbers of the size of the largest number of the state


def recurrence(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: tuple[float | None, ...]
) -> np.ndarray:
    """The smallest number of returns after which all `states` recur, (cases,); 0 where none is found.

    Of the states (cases, returns, coordinates), at least twice as many returns are needed as the number found. They
    recur if each number comes back to within `tolerance` times its largest size in the same motion, `sizes` (cases,
    coordinates), or to round-off: other cases, which may be far larger, do not matter. `periods`: of coordinates that
    turn.
    """
    turns = np.array([period is not None for period in periods])
    scale = np.where(turns, 1.0, np.fmax(sizes, np.max(np.abs(states), axis=1)))
    smallest = _ROUND_OFF * np.finfo(states.dtype).eps * np.max(scale, axis=1, keepdims=True)
    limit = np.fmax(tolerance * scale, smallest)[:, None]
    found = np.zeros(len(states), int)
    for number in range(1, states.shape[1] // 2 + 1):
        change = np.abs(states[:, number:] - states[:, :-number])
        for column, period in enumerate(periods):
            if period:
                change[..., column] = np.minimum(change[..., column] % period, -change[..., column] % period)
        recurs = np.all(change <= limit, axis=(1, 2))  # False where a state is NaN
        found = np.where((found == 0) & recurs, number, found)
    return found
