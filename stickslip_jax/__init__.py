"""Stick-slip (dry-friction) oscillators under random motion: exact, vectorised, differentiable."""

from importlib import import_module
from typing import TYPE_CHECKING

from . import _starting  # before all that takes time
from ._distributions.copula import GaussianCopula
from ._distributions.random_number import RandomNumber, Truncated
from ._dynamics.method import Exact, Regularized
from ._ensemble.call import simulate_ensemble
from ._ensemble.parts import Keep
from ._ensemble.result import Ensemble
from ._events.sticks import Slips, Sticks
from ._excitation.excitation import BaseMotion, WithJumps
from ._excitation.ground import GroundAcceleration, GroundMotion
from ._excitation.piecewise_constant import PiecewiseConstantLaw, VelocitySteps
from ._excitation.piecewise_constant_laws import Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from ._excitation.random import RandomPhase
from ._excitation.recorded import Recorded
from ._excitation.segments import SegmentLaw, VelocitySegments
from ._excitation.smooth import Harmonic, Signal, SumOfHarmonics
from ._excitation.voltage import SourceVoltage
from ._fast_cpu import enable_fast_cpu
from ._fields import Quantity
from ._html import draw_with as _draw_with
from ._simulation.call import simulate
from ._simulation.energy import Energies
from ._simulation.result import Simulation
from ._statistics.distribution import Distribution, Histogram, common_bins
from ._statistics.ensemble_statistics import EnsembleStatistics, OrderStatistics
from ._statistics.estimate import Estimate
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
from ._status import Ending, Status
from ._sweep.errors import StudyError
from ._systems.friction import Coulomb, FrictionCurve, FrictionLaw, Stribeck, VelocityWeakening
from ._systems.mass_spring import MassSpring
from ._systems.system import Coordinate, System
from ._types import InitialState

__version__ = "0.1.0"

if TYPE_CHECKING:
    from . import design, papers, plot, study  # noqa: F401
    from ._distributions.families import Beta, Discrete, Exponential, LogNormal, Normal, Triangular, Uniform, Weibull
    from ._ensemble.collecting import concatenate, load
    from ._excitation.gaussian import GaussianProcess
    from ._excitation.kanai_tajimi import KanaiTajimi
    from ._excitation.reading import read_acceleration_csv, read_at2, read_recorded_csv
    from ._excitation.semi_markov import SemiMarkovSwitching
    from ._excitation.spectra import (
        CloughPenzienSpectrum,
        KanaiTajimiSpectrum,
        PowerSpectrum,
        TabulatedSpectrum,
        VelocitySpectrum,
    )
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
    from ._statistics.bootstrap import bootstrap_interval
    from ._statistics.convergence import Convergence, HistogramConvergence, convergence, histogram_convergence
    from ._statistics.first_sticks import FirstSticks, first_stick
    from ._statistics.identical import identically_distributed  # noqa: F401
    from ._statistics.independence import independent, independent_and_identical  # noqa: F401
    from ._statistics.sobol_indices import SobolIndices, sobol_indices
    from ._statistics.verdicts import HypothesisTest, Verdict  # noqa: F401
    from ._sweep.study import Study
    from ._systems.motor_cart import MotorCart, stick_duration_bound
    from ._systems.switched_system import SwitchedSystem

# Loaded when asked for: whatever a simulation of a mass on a spring does not load anyway.
_MODULES = ("design", "papers", "plot", "study")
_LATER = {
    "_distributions.families": "Beta Discrete Exponential LogNormal Normal Triangular Uniform Weibull",
    "_ensemble.collecting": "concatenate load",
    "_excitation.gaussian": "GaussianProcess",
    "_excitation.kanai_tajimi": "KanaiTajimi",
    "_excitation.reading": "read_acceleration_csv read_at2 read_recorded_csv",
    "_excitation.semi_markov": "SemiMarkovSwitching",
    "_excitation.spectra": "CloughPenzienSpectrum KanaiTajimiSpectrum PowerSpectrum TabulatedSpectrum VelocitySpectrum",
    "_sensitivity": "RealizationMeanDuration Sensitivities Sensitivity StickDuration StickFunctional StickSequence "
    "StickStart StickStatistic differentiable sensitivity",
    "_statistics.bootstrap": "bootstrap_interval",
    "_statistics.convergence": "Convergence HistogramConvergence convergence histogram_convergence",
    "_statistics.first_sticks": "FirstSticks first_stick",
    "_statistics.identical": "identically_distributed",
    "_statistics.independence": "independent independent_and_identical",
    "_statistics.sobol_indices": "SobolIndices sobol_indices",
    "_statistics.verdicts": "HypothesisTest Verdict",
    "_sweep.study": "Study",
    "_systems.motor_cart": "MotorCart stick_duration_bound",
    "_systems.switched_system": "SwitchedSystem",
}
_HOMES = {name: module for module, names in _LATER.items() for name in names.split()}


def __getattr__(name: str):
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _HOMES:
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = value  # so that it is looked for once
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


_draw_with(lambda result: import_module(f"{__name__}.plot._small").small_figure(result))
_starting.end()


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES, *_HOMES})


__all__ = [
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
    "Energies",
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
    "PiecewiseConstantLaw",
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
    "common_bins",
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
