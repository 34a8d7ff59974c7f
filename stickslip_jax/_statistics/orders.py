"""Statistics of the i-th stick, or of the i-th slip, of each sample."""

import abc
import dataclasses
import math
from collections.abc import Hashable, Mapping

from .distribution import Distribution
from .estimate import Estimate, Share
from .quantities import SLIP_START, STICK_QUANTITIES, ordinal
from .summary import Summary, summary_of_distributions

NAMES = tuple(quantity.name for quantity in STICK_QUANTITIES)  # in the order of the accumulator's columns


class ByQuantity(abc.ABC):
    """Gives the distribution of each quantity of sticks, or of slips, as an attribute of its name without "slip_"."""

    distributions: Mapping[str, Distribution]

    @property
    @abc.abstractmethod
    def _summary(self) -> Summary:
        """The tables that show it."""

    def __repr__(self) -> str:
        return repr(self._summary)

    def _repr_html_(self) -> str:
        return self._summary._repr_html_()

    def __getattr__(self, name: str) -> Distribution:
        if name in NAMES:
            for key in (name, f"slip_{name}"):
                if key in self.distributions:
                    return self.distributions[key]
            if SLIP_START.name not in self.distributions:
                raise ValueError(f"The sticks of this ensemble have no {name}, which was not measured.")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(name.removeprefix("slip_") for name in self.distributions)})


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class OrderStatistics(ByQuantity):
    """Statistics of the `number`-th stick, or slip, over the samples that have it.

    - `share`: the share of samples that have it.
    - `start`, `duration` (s), and of sticks `position` (m; of a motor rad): each a `Distribution`; `distributions`:
      these by the names of their quantities, for slips `slip_start` and so on.
    """

    number: int
    share: Estimate
    distributions: Mapping[str, Distribution]

    @classmethod
    def of(
        cls, number: int, body: str, having: int, samples: int, distributions: Mapping[str, Distribution],
        origin: Hashable,
    ) -> "OrderStatistics":  # fmt: skip
        """Those of the `number`-th `body`, "stick" or "slip", which so many of the samples have."""
        share = having / samples if samples else math.nan
        error = math.sqrt(share * (1 - share) / (samples - 1)) if samples > 1 else math.nan
        label = f"share of samples that have a {ordinal(number)} {body}"
        return cls(number, Estimate(label, share, error, "1", samples, origin, Share()), distributions)

    @property
    def _summary(self) -> Summary:
        return summary_of_distributions(str(self.share), list(self.distributions.values()))
