"""The statistics of the slips of an ensemble: when they begin and how long they last, of all and by order."""

import dataclasses
from collections.abc import Hashable
from functools import cached_property

import numpy as np

from .. import _checks
from .._events.slips import FlatSlips, slips_among
from .._events.sticks import FlatSticks
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums
from .clusters import Clusters
from .distribution import BINS, Distribution
from .orders import ByQuantity, OrderStatistics
from .quantities import SLIP_QUANTITIES, SampledQuantity
from .summary import Summary, summary_of_distributions


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SlipStatistics(ByQuantity):
    """Statistics of the slips of the retained samples, those cut by the horizon with the part before it.

    `start`, `duration`: each the `Distribution` over all slips, s. `order(i)`: of the i-th slip of each sample. The
    first slip is that before the first stick, or after it where a sample begins with a stick. The duration of the
    slips of all samples, retained or not, is ``statistics.slip_duration``.

    - `sticks`: those of the retained samples. `t1`: s. `origin`: of the random numbers; see `Estimate`.
    """

    sticks: FlatSticks
    t1: float
    origin: Hashable

    @cached_property
    def distributions(self) -> dict[str, Distribution]:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        """The distribution over all slips of each of the `SLIP_QUANTITIES`, by name."""
        every = np.ones(len(self._slips.start), bool)
        return {one.name: self._distribution(one, one.label, every) for one in SLIP_QUANTITIES}

    def order(self, number: int) -> OrderStatistics:
        """Statistics of the `number`-th slip of each sample that has so many. Raises ValueError below 1."""
        chosen = self._slips.order == _checks.whole_number("number", number)
        found = {one.name: self._distribution(one, one.label_of_order(number), chosen) for one in SLIP_QUANTITIES}
        return OrderStatistics.of(number, "slip", int(chosen.sum()), len(self.sticks.count), found, self.origin)

    @cached_property
    def _slips(self) -> FlatSlips:
        return slips_among(self.sticks, self.t1)

    def _distribution(self, quantity: SampledQuantity, label: str, chosen: np.ndarray) -> Distribution:
        """The distribution of a quantity of the `chosen` slips."""
        column = getattr(self._slips, quantity.name.removeprefix("slip_"))
        values, samples = np.asarray(column, np.float64)[chosen], len(self.sticks.count)
        assert quantity.unit is not None
        return Distribution(
            label, quantity.unit, samples, PowerSums.of(values), DyadicCounts.of(values, BINS),
            Clusters(values, self._slips.sample[chosen], samples, samples),
            4 * float(np.finfo(column.dtype).eps) * self.t1, quantity.is_whole, self.origin,
        )  # fmt: skip

    @property
    def _summary(self) -> Summary:
        title = f"Slips of {len(self.sticks.count):,} samples on [0, {self.t1:g}] s"
        return summary_of_distributions(title, list(self.distributions.values()))
