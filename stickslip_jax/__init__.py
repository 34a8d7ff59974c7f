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
from .statistics.bootstrap import bootstrap_interval
from .statistics.convergence import Convergence, HistogramConvergence, convergence, histogram_convergence
from .statistics.distribution import Distribution, Histogram
from .statistics.ensemble_statistics import EnsembleStatistics, OrderStatistics
from .statistics.estimate import Estimate
from .statistics.estimates import (
    mean_slip_count,
    mean_slip_duration,
    mean_stick_count,
    mean_stick_duration,
    stick_fraction,
)
from .statistics.first_sticks import FirstSticks, first_stick
from .statistics.joint import ConditionalMeans, JointDistribution, JointHistogram
from .systems.friction import Coulomb, FrictionCurve, FrictionLaw, Stribeck, VelocityWeakening
from .systems.mass_spring import MassSpring
from .systems.motor_cart import MotorCart, stick_duration_bound
from .systems.switched_system import SwitchedSystem
from .systems.system import Coordinate, System

__version__ = "0.1.0"


# Loaded when asked for: matplotlib takes longer to import than all the rest, and so does scipy.stats.
_MODULES = ("papers", "plot")
_TESTS = {
    "HypothesisTest": "verdicts",
    "Verdict": "verdicts",
    "identically_distributed": "identical",
    "independent": "independence",
    "independent_and_identical": "independence",
}


def __getattr__(name: str):
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _TESTS:
        return getattr(import_module(f"{__name__}.statistics.{_TESTS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES, *_TESTS})


__all__ = [
    "TOTAL_STICK_TIME",
    "BangBangLaw",
    "ConditionalMeans",
    "Constant",
    "Convergence",
    "Coordinate",
    "Coulomb",
    "Distribution",
    "Ending",
    "Ensemble",
    "EnsembleStatistics",
    "Estimate",
    "Exact",
    "FirstSticks",
    "FrictionCurve",
    "FrictionLaw",
    "GroundAcceleration",
    "Harmonic",
    "Histogram",
    "HistogramConvergence",
    "JointDistribution",
    "JointHistogram",
    "KanaiTajimi",
    "MassSpring",
    "MotorCart",
    "OrderStatistics",
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
    "System",
    "Uniform",
    "VelocitySteps",
    "VelocityWeakening",
    "WithJumps",
    "bootstrap_interval",
    "convergence",
    "differentiable",
    "enable_fast_cpu",
    "first_stick",
    "histogram_convergence",
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
