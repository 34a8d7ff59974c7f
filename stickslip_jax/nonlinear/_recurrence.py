"""After how many returns a motion repeats itself."""

import numpy as np


def recurrence(states: np.ndarray, tolerance: float, periods: tuple[float | None, ...]) -> np.ndarray:
    """The smallest number of returns after which all `states` recur, (cases,); 0 where none is found.

    Of the states (cases, returns, coordinates), at least twice as many returns are needed as the number found. They
    recur if each number comes back to within `tolerance` times the largest range that it has among the returns of any
    case, or its largest size where that is larger. `periods`: of coordinates that turn.
    """
    known = np.nan_to_num(states)
    scale = np.max(np.abs(known), axis=(0, 1)) if known.size else np.ones(states.shape[-1])
    scale = np.array([1.0 if period else size for period, size in zip(periods, scale, strict=True)])
    limit = tolerance * np.where(scale > 0, scale, 1.0)
    found = np.zeros(len(states), int)
    for number in range(1, states.shape[1] // 2 + 1):
        change = np.abs(states[:, number:] - states[:, :-number])
        for column, period in enumerate(periods):
            if period:
                change[..., column] = np.minimum(change[..., column] % period, -change[..., column] % period)
        recurs = np.all(change <= limit, axis=(1, 2))  # False where a state is NaN
        found = np.where((found == 0) & recurs, number, found)
    return found
