"""The source voltage that drives a motor."""

import math

import jax.numpy as jnp

from .. import _checks
from .._types import FloatArray, Scalar
from .smooth import Signal


class SourceVoltage(Signal):
    """``mean + amplitude sin(angular_frequency t + phase)``, V (Lima and Sampaio 2022, section 2; defaults: Table 1).

    `mean` and `amplitude` in V, `angular_frequency` in rad/s, positive, `phase` in rad.
    Raises ValueError for numbers that are not finite, or a frequency that is not positive.
    """

    mean: Scalar = 1.0
    amplitude: Scalar = 0.5
    angular_frequency: Scalar = 10.0
    phase: Scalar = 0.0

    def __check_init__(self):
        _checks.numeric("mean", self.mean)
        _checks.numeric("amplitude", self.amplitude)
        _checks.positive("angular_frequency", self.angular_frequency, "rad/s")
        _checks.numeric("phase", self.phase)

    def value(self, t: FloatArray) -> FloatArray:
        return self.mean + self.amplitude * jnp.sin(self.angular_frequency * t + self.phase)

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.angular_frequency
