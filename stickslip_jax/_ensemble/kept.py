"""What an ensemble keeps of its samples besides sums: totals of each, and sticks of the first ones."""

from typing import NamedTuple

import numpy as np

from .._events.sticks import FlatSticks


class SampleTotals(NamedTuple):
    """Totals of each sample, arrays (samples,): numbers of sticks and slips, total stick time (s), `Status` code, and
    number of near-grazing instants (see `Simulation`).
    """

    sticks: np.ndarray
    slips: np.ndarray
    stick_time: np.ndarray
    status: np.ndarray
    near_grazing_count: np.ndarray


class Retained(NamedTuple):
    """The sticks of the first samples that finished, and the `TOTALS` of each, (samples, 5)."""

    sticks: FlatSticks
    totals: np.ndarray
