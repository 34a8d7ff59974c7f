"""The quantities whose distributions are estimated: numbers of each stick, of each slip or of each sample.

Each is defined here, once, and every other module reads it from here.
"""

import dataclasses
from typing import Literal, TypeAlias


@dataclasses.dataclass(frozen=True)
class SampledQuantity:
    """A number that each stick, each slip or each sample has.

    - `name`: in code and in files. `label`: in tables and figures, in the singular; that of a stick's quantity says
      "stick" once.
    - `unit`: "1" for a number without one; None for a position, whose unit the system gives (m, of a motor rad).
    - `is_whole`: whether the values are whole numbers.
    """

    name: str
    label: str
    unit: str | None
    is_whole: bool = False

    @property
    def short_label(self) -> str:
        """The name as words: "duration"."""
        return self.name.replace("_", " ")

    def label_of_order(self, number: int) -> str:
        """The label where it is the `number`-th stick's: "1st stick duration"; or slip's: "1st slip duration"."""
        word = "stick" if "stick" in self.label else "slip"
        return self.label.replace(word, f"{ordinal(number)} {word}")

    def axis_label(self, number: int | None) -> str:
        """The label on an axis: "stick duration"; with the `number` of the stick: "duration of stick 1"."""
        if number is None:
            return self.label
        if self.label.endswith(" the stick"):
            return self.label.replace("the stick", f"stick {number}")
        return f"{self.label.removeprefix('stick ')} of stick {number}"


def ordinal(number: int) -> str:
    """1st, 2nd, 3rd, 4th, ..."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


START = SampledQuantity("start", "stick start", "s")
DURATION = SampledQuantity("duration", "stick duration", "s")
POSITION = SampledQuantity("position", "stick position", None)
SLIP_BEFORE = SampledQuantity("slip_before", "slip before the stick", "s")
SLIP_AFTER = SampledQuantity("slip_duration", "slip after the stick", "s")
SLIP_AFTER_START = SampledQuantity("slip_start", "start of the slip after the stick", "s")
SLIP_START = SampledQuantity("slip_start", "slip start", "s")
SLIP_DURATION = SampledQuantity("slip_duration", "slip duration", "s")
STICK_COUNT = SampledQuantity("stick_count", "number of sticks", "1", is_whole=True)
SLIP_COUNT = SampledQuantity("slip_count", "number of slips", "1", is_whole=True)
STICK_FRACTION = SampledQuantity("stick_fraction", "stick fraction", "1")
OWN_MEAN_DURATION = SampledQuantity("own_mean_duration", "mean stick duration of a sample", "s")

STICK_QUANTITIES = (START, DURATION, POSITION)
"""Quantities of each stick that are summed over all sticks, and by order, while the sticks stream by.

A new one goes to the end, and has the name of one of the `QUANTITIES` of a stick (`_events/stick_quantities.py`).
"""

StickQuantity: TypeAlias = Literal["start", "duration", "position", "slip_before", "slip_start", "slip_duration"]
"""The names of a stick's quantities: the `STICK_QUANTITIES`, the duration of the slip before the stick, and when the
slip after it begins and how long it lasts."""

StickValue: TypeAlias = StickQuantity | tuple[StickQuantity, int]
"""A quantity of any stick, "duration", or of the i-th stick of each sample, ("duration", 1)."""

BY_NAME = {quantity.name: quantity for quantity in (*STICK_QUANTITIES, SLIP_BEFORE, SLIP_AFTER_START, SLIP_AFTER)}
"""The quantities of a stick by their names, as in `StickQuantity`."""

SAMPLE_QUANTITIES = (STICK_COUNT, SLIP_COUNT, STICK_FRACTION)
"""Quantities of each sample, with the columns that `StickAccumulator.samples` has."""

DISTRIBUTIONS = (
    *SAMPLE_QUANTITIES, DURATION, OWN_MEAN_DURATION, SLIP_DURATION, START, POSITION, *STICK_QUANTITIES[3:],
)  # fmt: skip
"""All quantities whose distributions are estimated from all samples, in the order of tables."""

SLIP_QUANTITIES = (SLIP_START, SLIP_DURATION)
"""Quantities of each slip, of the retained samples. Without "slip_", they are the fields of `FlatSlips`."""

TestedQuantity: TypeAlias = Literal["start", "duration", "position", "slip_start", "slip_duration"]
"""The names of the quantities that tests of independence and of identical distribution take."""

TESTED = {quantity.name: quantity for quantity in (*STICK_QUANTITIES, *SLIP_QUANTITIES)}
"""The same quantities by their names."""

IN_A_CYCLE: tuple[TestedQuantity, ...] = ("start", "position", "duration", "slip_start", "slip_duration")
"""In which order the quantities of a stick and the slip after it come to be known."""

STREAMED_PAIRS: tuple[tuple[StickQuantity, StickQuantity], ...] = (("duration", "position"), ("start", "duration"))
"""Pairs of quantities of the same stick whose joint histograms are summed over all sticks."""

FIRST_TWO: tuple[StickValue, StickValue] = (("duration", 1), ("duration", 2))
"""The pair of two sticks of a sample whose joint histogram is summed over all samples."""
