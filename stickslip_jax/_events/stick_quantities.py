"""What is recorded of each stick besides its times, its position and how it ended: a class for each such number.

To add one: a class here, its line in `QUANTITIES`, and a field of `Sticks`, which users see. All engines, files and
tables have it then. It costs time only where sticks are recorded: totals alone ask for none.
"""

import abc
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from .._types import BoolArray, FloatArray


class StickSpan(NamedTuple):
    """When and where a stick lasted: `start` and `end`, s; `position` at its start; `left_at`: position at its end."""

    start: FloatArray
    end: FloatArray
    position: FloatArray
    left_at: FloatArray


class StickQuantity(abc.ABC):
    """A number of each stick. `label`: its name in tables and figures. `unit`: None for that of the position."""

    label: str
    unit: str | None

    @abc.abstractmethod
    def begin(self, position: FloatArray) -> Any:
        """What is remembered at t = 0, where the mass is at `position`: an array, or a tuple or dict of arrays."""

    @abc.abstractmethod
    def at_end(self, remembered: Any, stick: StickSpan) -> tuple[FloatArray, Any]:
        """The number of a stick that has ended, and what is remembered from there on."""


class SlipDisplacement(StickQuantity):
    """Displacement of the mass from the end of the stick before, or from its start at t = 0."""

    label = "displacement in the slip before the stick"
    unit = None

    def begin(self, position: FloatArray) -> FloatArray:
        return position

    def at_end(self, remembered: FloatArray, stick: StickSpan) -> tuple[FloatArray, FloatArray]:
        return stick.position - remembered, stick.left_at


QUANTITIES: dict[str, StickQuantity] = {"slip_displacement": SlipDisplacement()}
"""By the name of their column; a file or a table of measured sticks may lack them (NaN then)."""

ALL = tuple(QUANTITIES)
Remembered: TypeAlias = dict[str, Any]
"""What each quantity that is asked for remembers, by its name."""


def begin_quantities(position: FloatArray, asked: tuple[str, ...]) -> Remembered:
    """What the quantities that are asked for remember at t = 0."""
    return {name: QUANTITIES[name].begin(position) for name in asked}


def measured(remembered: Remembered, is_stick: BoolArray, stick: StickSpan) -> tuple[dict[str, FloatArray], Remembered]:
    """The quantities of a stick by name, and what they remember after a step, which ended in a stick or not."""
    values, after = {}, {}
    for name, old in remembered.items():
        values[name], new = QUANTITIES[name].at_end(old, stick)
        after[name] = jax.tree.map(lambda now, before: jnp.where(is_stick, now, before), new, old)
    return values, after
