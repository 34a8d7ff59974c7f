"""The slips of an ensemble that kept its sticks: what lies between the sticks of the samples that finished."""

import numpy as np

from .._events.slips import FlatSlips, slips_among
from .._events.sticks import Slips, in_slots
from .._status import Status
from .data import EnsembleData


def flat_slips(ensemble: EnsembleData) -> FlatSlips:
    """The slips of all samples that finished. Raises ValueError unless ``keep="sticks"``."""
    sticks, totals = ensemble.require_sticks(), ensemble.totals
    return slips_among(sticks, ensemble.t1, np.asarray(totals.status) == Status.FINISHED)


def padded_slips(ensemble: EnsembleData) -> Slips:
    """The same as `Slips` with arrays (samples, slots), where slots is the largest number of slips (at least 1)."""
    slips = flat_slips(ensemble)
    columns = {"start": (slips.start, np.nan), "end": (slips.end, np.nan), "censored": (slips.censored, False)}
    mask, filled = in_slots(np.bincount(slips.sample, minlength=ensemble.samples), columns)
    return Slips(**filled, mask=mask)
