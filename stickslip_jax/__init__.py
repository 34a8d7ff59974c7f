"""Stick-slip (dry-friction) oscillators under random motion: exact, vectorised, differentiable."""

from importlib import import_module

from ._fast_cpu import enable_fast_cpu
from ._status import Ending, Status
from .base_motion.drive import WithJumps
from .base_motion.ground import GroundAcceleration
from .base_motion.kanai_tajimi import KanaiTajimi
from .base_motion.laws import BangBangLaw, Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from .base_motion.piecewise import VelocitySteps
from .base_motion.random import RandomPhase, Uniform
from .base_motion.reading import read_acceleration_csv, read_at2, read_recorded_csv
from .base_motion.recorded import Recorded
from .base_motion.smooth import Harmonic, Signal, SumOfHarmonics
from .base_motion.voltage import SourceVoltage
from .dynamics.method import Exact, Regularized
from .ensemble import simulate_ensemble
from .ensemble_result import Ensemble
from .events import Slips, Sticks
from .sensitivity import (
    TOTAL_STICK_TIME,
    RealisationMeanDuration,
    Sensitivities,
    Sensitivity,
    StickDuration,
    StickFunctional,
    StickSequence,
    StickStart,
    StickStatistic,
    differentiable,
    sensitivity,
)
from .simulate import Simulation, simulate
from .statistics.estimates import (
    Estimate,
    mean_slip_count,
    mean_slip_duration,
    mean_stick_count,
    mean_stick_duration,
    stick_fraction,
)
from .statistics.first_sticks import FirstSticks, first_stick
from .systems.friction import Coulomb, FrictionCurve, FrictionLaw, Stribeck, VelocityWeakening
from .systems.mass_spring import MassSpring
from .systems.motor_cart import MotorCart, stick_duration_bound
from .systems.switched_system import SwitchedSystem

__version__ = "0.1.0"


def __getattr__(name: str):
    # Loaded when asked for: matplotlib takes longer to import than all the rest.
    if name in ("papers", "plot"):
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), "papers", "plot"})


__all__ = [
    "TOTAL_STICK_TIME",
    "BangBangLaw",
    "Constant",
    "Coulomb",
    "Ending",
    "Ensemble",
    "Estimate",
    "Exact",
    "FirstSticks",
    "FrictionCurve",
    "FrictionLaw",
    "GroundAcceleration",
    "Harmonic",
    "KanaiTajimi",
    "MassSpring",
    "MotorCart",
    "PiecewiseConstant",
    "PoissonSwitching",
    "RandomPhase",
    "RandomSteps",
    "RealisationMeanDuration",
    "Recorded",
    "Regularized",
    "Sensitivities",
    "Sensitivity",
    "Signal",
    "Simulation",
    "Slips",
    "SourceVoltage",
    "SquareWave",
    "Status",
    "StickDuration",
    "StickFunctional",
    "StickSequence",
    "StickStart",
    "StickStatistic",
    "Sticks",
    "Stribeck",
    "SumOfHarmonics",
    "SwitchedSystem",
    "Uniform",
    "VelocitySteps",
    "VelocityWeakening",
    "WithJumps",
    "differentiable",
    "enable_fast_cpu",
    "first_stick",
    "mean_slip_count",
    "mean_slip_duration",
    "mean_stick_count",
    "mean_stick_duration",
    "read_acceleration_csv",
    "read_at2",
    "read_recorded_csv",
    "sensitivity",
    "simulate",
    "simulate_ensemble",
    "stick_duration_bound",
    "stick_fraction",
]
