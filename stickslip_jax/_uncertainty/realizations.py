"""Checks of the realisations that a law of a user's drew while JAX traced it, when constructors check no numbers."""

import dataclasses

import jax
import numpy as np
from jaxtyping import PyTree

from .._fields import Quantity, described, modules_in
from .numbers import check_numbers


def check_realizations(found: PyTree, first: int) -> None:
    """Check stacked realisations, those of samples `first`, ``first + 1``, ... Raises ValueError for the first of them
    that its constructors would have refused.
    """
    for sample in np.flatnonzero(_suspicious(found)):
        one = jax.tree.map(lambda leaf, sample=sample: leaf[sample], found)
        try:
            check_numbers(one)
        except ValueError as error:
            raise ValueError(
                f"Argument law must give realisations that fit, but sample {first + sample}: {error}"
            ) from error


def _suspicious(found: PyTree) -> np.ndarray:
    """Which realisations the constructors may refuse, (samples,): looked at all at once."""
    suspicious = np.zeros(len(jax.tree.leaves(found)[0]), bool)
    for module in modules_in(found):
        arrays = {field.name: getattr(module, field.name) for field in dataclasses.fields(module)}
        arrays = {name: np.asarray(array) for name, array in arrays.items() if np.ndim(array) > 0}
        for name, about in described(type(module)).items():
            if name in arrays and isinstance(about, Quantity):
                suspicious |= _any(about.outside(arrays[name]))
        if "times" in arrays:
            times = arrays["times"]
            suspicious |= _any(np.diff(times, axis=-1) <= 0) | (times[..., 0] != 0)
        if "durations" in arrays:
            suspicious |= _suspicious_intervals(**arrays)
    return suspicious


def _suspicious_intervals(durations: np.ndarray, **others: np.ndarray) -> np.ndarray:
    used = durations > 0
    found = _any(~(durations >= 0)) | _any(used[..., 1:] & ~used[..., :-1])
    for name, values in others.items():
        found |= _any(used & ~np.isfinite(values))
        if name == "velocities":
            found |= _any((values[..., 1:] == values[..., :-1]) & used[..., 1:])
    return found


def _any(wrong: np.ndarray) -> np.ndarray:
    return np.any(wrong.reshape(len(wrong), -1), axis=1)
