"""The source voltage of a motor."""

import math
from typing import Annotated

import jax.numpy as jnp

from .._fields import Quantity
from .._types import FloatArray, Number, Scalar
from .smooth import Signal


class SourceVoltage(Signal):
    """The source voltage of a motor, ``mean + amplitude sin(angular_frequency t + phase)``.

    Source: Lima and Sampaio 2022, section 2; the defaults are its Table 1.

    Args:
        mean: V.
        amplitude: V.
        angular_frequency: rad/s, positive.
        phase: rad.

    Raises:
        ValueError: For numbers that are not finite, or a frequency that is not positive.
    """

    takes_jumps = False
    mean: Annotated[Number, Quantity("V")] = 1.0
    amplitude: Annotated[Number, Quantity("V")] = 0.5
    angular_frequency: Annotated[Number, Quantity("rad/s", above=0)] = 10.0
    phase: Annotated[Number, Quantity("rad")] = 0.0

    def value(self, t: FloatArray) -> FloatArray:
        return self.mean + self.amplitude * jnp.sin(self.angular_frequency * t + self.phase)

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.angular_frequency

    @property
    def repeats_after(self) -> Number:
        return 2 * math.pi / self.angular_frequency
