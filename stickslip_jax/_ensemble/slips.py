"""The slips of an ensemble that kept its sticks: what lies between the sticks of the samples that finished."""

from typing import Any

import numpy as np

from .._events.slips import FlatSlips, slips_among
from .._events.sticks import Slips
from .._status import Status


def flat_slips(ensemble: Any) -> FlatSlips:
    """The slips of all samples that finished. Raises ValueError unless ``keep="sticks"``."""
    return slips_among(ensemble.require_sticks(), ensemble.t1, ensemble.totals.status == Status.FINISHED)


def padded_slips(ensemble: Any) -> Slips:
    """The same as `Slips` with arrays (samples, slots), where slots is the largest number of slips (at least 1)."""
    slips = flat_slips(ensemble)
    count = np.bincount(slips.sample, minlength=ensemble.samples)
    mask = np.arange(max(1, int(count.max(initial=0)))) < count[:, None]

    def fill(values: np.ndarray, padding: Any) -> np.ndarray:
        padded = np.full(mask.shape, padding, values.dtype)
        padded[mask] = values
        return padded

    return Slips(fill(slips.start, np.nan), fill(slips.end, np.nan), fill(slips.censored, False), mask)
