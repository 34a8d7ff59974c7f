"""Stick-slip (dry-friction) oscillators under random motion: exact, vectorised, differentiable."""

from importlib import import_module

from ._fast_cpu import enable_fast_cpu
from ._status import Ending, Status
from .base_motion.laws import BangBangLaw, Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from .base_motion.piecewise import VelocitySteps
from .ensemble import simulate_ensemble
from .ensemble_result import Ensemble
from .events import Slips, Sticks
from .simulate import Simulation, simulate
from .statistics.estimates import (
    Estimate,
    mean_slip_count,
    mean_slip_duration,
    mean_stick_count,
    mean_stick_duration,
    stick_fraction,
)
from .systems.friction import Coulomb
from .systems.mass_spring import MassSpring

__version__ = "0.1.0"


def __getattr__(name: str):
    # Loaded when asked for: matplotlib takes longer to import than all the rest.
    if name in ("papers", "plot"):
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), "papers", "plot"})


__all__ = [
    "BangBangLaw",
    "Constant",
    "Coulomb",
    "Ending",
    "Ensemble",
    "Estimate",
    "MassSpring",
    "PiecewiseConstant",
    "PoissonSwitching",
    "RandomSteps",
    "Simulation",
    "Slips",
    "SquareWave",
    "Status",
    "Sticks",
    "VelocitySteps",
    "enable_fast_cpu",
    "mean_slip_count",
    "mean_slip_duration",
    "mean_stick_count",
    "mean_stick_duration",
    "simulate",
    "simulate_ensemble",
    "stick_fraction",
]
