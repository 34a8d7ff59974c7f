"""What the figures take, as names for annotations."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes

from .._ensemble.result import Ensemble
from .._excitation.random import RandomPhase
from .._excitation.voltage import SourceVoltage
from .._simulation.result import Simulation
from .._statistics.first_sticks import FirstSticks
from .._types import AnyArray

if TYPE_CHECKING:
    import xarray

    LabeledData: TypeAlias = xarray.DataArray | xarray.Dataset
else:  # it is an extra
    LabeledData = Any

SimulatedSticks: TypeAlias = Ensemble | FirstSticks | Simulation
"""Results that hold sticks one by one: an ensemble, the first sticks of its samples, one simulation or a batch."""

SeveralAxes: TypeAlias = Sequence[Axes] | np.ndarray
"""As many axes as a figure has panels."""

Numbers: TypeAlias = AnyArray | Sequence[float | int]
"""One-dimensional real numbers."""

Bins: TypeAlias = int | np.integer | Numbers
"""How many bins of equal width, or their increasing edges."""

JointBins: TypeAlias = int | np.integer | tuple[Bins, Bins] | list[Bins]
"""Bins along each of two axes: one number for both, or two `Bins`."""

Window: TypeAlias = tuple[float | int, float | int]
"""First and last time to draw, s."""

Voltage: TypeAlias = SourceVoltage | RandomPhase
"""A voltage whose bound of stick durations is known in closed form."""
