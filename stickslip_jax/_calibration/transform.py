"""Numbers with bounds as functions of coordinates without bounds, in which they are searched."""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._types import AnyArray, DType
from .._uncertainty.numbers import Parameter, quantity_at


class Transform(NamedTuple):
    """How numbers follow from coordinates that are 0 at their first guesses, and have no bounds.

    A number with one bound is the bound plus or minus an exponential function (a positive one is searched by its
    logarithm), one with two bounds a logistic function, any other one linear, in units of its first guess.

    `start`, `low`, `high`: first guesses and bounds, infinite where there are none, (parameters,).
    """

    start: AnyArray
    low: AnyArray
    high: AnyArray

    def numbers(self, x: AnyArray) -> Any:
        """The numbers at the coordinates `x`, (parameters,): NumPy's at those of NumPy, else JAX's."""
        xp = np if isinstance(x, np.ndarray) else jnp
        start, low, high, has_low, has_high = self._finite(xp)
        is_bounded = has_low | has_high
        # A `where` around each exponential too, so that what is not selected has finite derivatives.
        growth = xp.exp(xp.where(is_bounded, xp.where(has_high, -x, x), 0))
        between = low + (high - low) / (1 + (high - start) / (start - low) * growth)
        one_bound = xp.where(has_low, low + (start - low) * growth, high - (high - start) * growth)
        bounded = xp.where(has_low & has_high, between, one_bound)
        return xp.where(is_bounded, bounded, start + xp.where(start == 0, 1, xp.abs(start)) * x)

    def slopes(self, numbers: np.ndarray) -> np.ndarray:
        """The derivatives of the numbers by their coordinates, where they have these values, (parameters,)."""
        start, low, high, has_low, has_high = self._finite(np)
        both = (numbers - low) * (high - numbers) / (high - low)
        one_bound = np.where(has_low, numbers - low, high - numbers)
        bounded = np.where(has_low & has_high, both, one_bound)
        return np.where(has_low | has_high, bounded, np.where(start == 0, 1, np.abs(start)))

    def _finite(self, xp: Any) -> tuple[Any, Any, Any, Any, Any]:
        """First guesses, bounds, with others in place of those that do not exist, and which of these do."""
        start, low, high = map(xp.asarray, self)
        has_low, has_high = xp.isfinite(low), xp.isfinite(high)
        return start, xp.where(has_low, low, start - 1), xp.where(has_high, high, start + 1), has_low, has_high


def transform_of(tree: Any, parameters: tuple[Parameter, ...]) -> Transform:
    """That of the `parameters`, numbers of `tree`. Raises ValueError for a first guess at a bound."""
    bounds = []
    for parameter in parameters:
        about = quantity_at(tree, parameter.path)
        low = max((float(one) for one in (about.above, about.at_least) if one is not None), default=-math.inf)
        high = math.inf if about.below is None else float(about.below)
        if not low < parameter.value < high:
            words = [f"{word} {one:g}" for word, one in (("above", low), ("below", high)) if math.isfinite(one)]
            raise ValueError(
                f"Argument wrt must name numbers whose first guess lies inside their bounds, {' and '.join(words)}, "
                f"but {parameter.name} = {parameter.value:g} was given; a search that begins at a bound cannot leave "
                "it: begin a little inside."
            )
        bounds.append((low, high))
    low, high = np.array(bounds).reshape(-1, 2).T
    return Transform(np.array([parameter.value for parameter in parameters], float), low, high)


def identity(number: int, dtype: DType) -> Transform:
    """That of so many numbers without bounds, which are their own coordinates."""
    none = jnp.zeros(number, dtype)
    return Transform(none, none - jnp.inf, none + jnp.inf)
