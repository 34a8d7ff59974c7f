"""Stick-slip (dry-friction) oscillators under random motion: exact, vectorised, differentiable."""

from importlib import import_module

from ._distributions.copula import GaussianCopula
from ._distributions.families import Beta, Discrete, Exponential, LogNormal, Normal, Triangular, Uniform, Weibull
from ._distributions.random_number import RandomNumber, Truncated
from ._dynamics.method import Exact, Regularized
from ._ensemble.call import simulate_ensemble
from ._ensemble.collecting import concatenate, load
from ._ensemble.parts import Keep
from ._ensemble.result import Ensemble
from ._events.sticks import Slips, Sticks
from ._excitation.excitation import BaseMotion, WithJumps
from ._excitation.gaussian import GaussianProcess
from ._excitation.ground import GroundAcceleration, GroundMotion
from ._excitation.kanai_tajimi import KanaiTajimi
from ._excitation.laws import BangBangLaw, Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from ._excitation.piecewise import VelocitySteps
from ._excitation.random import InitialState, RandomPhase
from ._excitation.reading import read_acceleration_csv, read_at2, read_recorded_csv
from ._excitation.recorded import Recorded
from ._excitation.segments import SegmentLaw, VelocitySegments
from ._excitation.semi_markov import SemiMarkovSwitching
from ._excitation.smooth import Harmonic, Signal, SumOfHarmonics
from ._excitation.spectra import (
    CloughPenzienSpectrum,
    KanaiTajimiSpectrum,
    PowerSpectrum,
    TabulatedSpectrum,
    VelocitySpectrum,
)
from ._excitation.voltage import SourceVoltage
from ._fast_cpu import enable_fast_cpu
from ._fields import Quantity
from ._html import draw_with as _draw_with
from ._sensitivity import (
    RealizationMeanDuration,
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
from ._simulation.call import simulate
from ._simulation.result import Simulation
from ._statistics.bootstrap import bootstrap_interval
from ._statistics.convergence import Convergence, HistogramConvergence, convergence, histogram_convergence
from ._statistics.distribution import Distribution, Histogram
from ._statistics.ensemble_statistics import EnsembleStatistics, OrderStatistics
from ._statistics.estimate import Estimate
from ._statistics.first_sticks import FirstSticks, first_stick
from ._statistics.joint import ConditionalMeans, JointDistribution, JointHistogram
from ._statistics.registry import (
    StickQuantity,
    StickValue,
    TestedQuantity,
    mean_slip_count,
    mean_slip_duration,
    mean_stick_count,
    mean_stick_duration,
    mean_total_stick_time,
    stick_fraction,
)
from ._statistics.sobol_indices import SobolIndices, sobol_indices
from ._status import Ending, Status
from ._sweep.errors import StudyError
from ._sweep.study import Study
from ._systems.friction import Coulomb, FrictionCurve, FrictionLaw, Stribeck, VelocityWeakening
from ._systems.mass_spring import MassSpring
from ._systems.motor_cart import MotorCart, stick_duration_bound
from ._systems.switched_system import SwitchedSystem
from ._systems.system import Coordinate, System

__version__ = "0.1.0"


# Loaded when asked for: matplotlib takes longer to import than all the rest, and so does scipy.stats.
_MODULES = ("design", "papers", "plot", "study")
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
        return getattr(import_module(f"{__name__}._statistics.{_TESTS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


_draw_with(lambda result: import_module(f"{__name__}.plot._small").small_figure(result))


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES, *_TESTS})


__all__ = [
    "BangBangLaw",
    "BaseMotion",
    "Beta",
    "CloughPenzienSpectrum",
    "ConditionalMeans",
    "Constant",
    "Convergence",
    "Coordinate",
    "Coulomb",
    "Discrete",
    "Distribution",
    "Ending",
    "Ensemble",
    "EnsembleStatistics",
    "Estimate",
    "Exact",
    "Exponential",
    "FirstSticks",
    "FrictionCurve",
    "FrictionLaw",
    "GaussianCopula",
    "GaussianProcess",
    "GroundAcceleration",
    "GroundMotion",
    "Harmonic",
    "Histogram",
    "HistogramConvergence",
    "InitialState",
    "JointDistribution",
    "JointHistogram",
    "KanaiTajimi",
    "KanaiTajimiSpectrum",
    "Keep",
    "LogNormal",
    "MassSpring",
    "MotorCart",
    "Normal",
    "OrderStatistics",
    "PiecewiseConstant",
    "PoissonSwitching",
    "PowerSpectrum",
    "Quantity",
    "RandomNumber",
    "RandomPhase",
    "RandomSteps",
    "RealizationMeanDuration",
    "Recorded",
    "Regularized",
    "SegmentLaw",
    "SemiMarkovSwitching",
    "Sensitivities",
    "Sensitivity",
    "Signal",
    "Simulation",
    "Slips",
    "SobolIndices",
    "SourceVoltage",
    "SquareWave",
    "Status",
    "StickDuration",
    "StickFunctional",
    "StickQuantity",
    "StickSequence",
    "StickStart",
    "StickStatistic",
    "StickValue",
    "Sticks",
    "Stribeck",
    "Study",
    "StudyError",
    "SumOfHarmonics",
    "SwitchedSystem",
    "System",
    "TabulatedSpectrum",
    "TestedQuantity",
    "Triangular",
    "Truncated",
    "Uniform",
    "VelocitySegments",
    "VelocitySpectrum",
    "VelocitySteps",
    "VelocityWeakening",
    "Weibull",
    "WithJumps",
    "bootstrap_interval",
    "concatenate",
    "convergence",
    "differentiable",
    "enable_fast_cpu",
    "first_stick",
    "histogram_convergence",
    "load",
    "mean_slip_count",
    "mean_slip_duration",
    "mean_stick_count",
    "mean_stick_duration",
    "mean_total_stick_time",
    "read_acceleration_csv",
    "read_at2",
    "read_recorded_csv",
    "sensitivity",
    "simulate",
    "simulate_ensemble",
    "sobol_indices",
    "stick_duration_bound",
    "stick_fraction",
]
