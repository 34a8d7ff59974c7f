"""Derivatives of stick statistics with respect to parameters, corrected for sticks that appear and vanish."""

from .call import sensitivity
from .differentiable import differentiable
from .estimate import Sensitivities, Sensitivity
from .statistic import (
    RealizationMeanDuration,
    StickDuration,
    StickFunctional,
    StickSequence,
    StickStart,
    StickStatistic,
    SumOfSquaredDurations,
    TimeToFirstStick,
)

__all__ = [
    "RealizationMeanDuration",
    "Sensitivities",
    "Sensitivity",
    "StickDuration",
    "StickFunctional",
    "StickSequence",
    "StickStart",
    "StickStatistic",
    "SumOfSquaredDurations",
    "TimeToFirstStick",
    "differentiable",
    "sensitivity",
]
