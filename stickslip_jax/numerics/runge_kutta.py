"""One step of an explicit Runge-Kutta method, unrolled: the coefficients are diffrax's, the loop over stages is not.

The states are tuples of scalars and zero coefficients cost nothing, so that many lanes advance as vectors.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import numpy as np

from .._types import FloatArray

State = tuple[FloatArray, ...]


def runge_kutta_step(
    solver: diffrax.AbstractERK, field: Callable[[Any, State], State], y: State, h: FloatArray
) -> State:
    """The state after the time `h` under ``y' = field(tau, y)``, starting at tau = 0."""
    tableau = solver.tableau
    assert isinstance(tableau, diffrax.ButcherTableau)
    slopes = [field(0 * h, y)]
    for c, row in zip(np.asarray(tableau.c), tableau.a_lower, strict=True):
        slopes.append(field(float(c) * h, _moved(y, h, np.asarray(row), slopes)))
    return _moved(y, h, np.asarray(tableau.b_sol), slopes)


def _moved(y: State, h: FloatArray, weights: np.ndarray, slopes: list[State]) -> State:
    used = [(float(weight), slope) for weight, slope in zip(weights, slopes, strict=True) if weight != 0]
    return tuple(value + h * sum(weight * slope[i] for weight, slope in used) for i, value in enumerate(y))
