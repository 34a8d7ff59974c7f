"""What the package shows: every public name once, and the module that defines it.

Type checkers read this file; `__init__.py` reads it too, and loads a name when it is asked for.
"""

from . import design as design, nonlinear as nonlinear, papers as papers, plot as plot, study as study
from ._foundation.types import InitialState as InitialState
from ._uncertainty.inputs import GaussianCopula as GaussianCopula
from ._uncertainty.families import (
    Beta as Beta,
    Discrete as Discrete,
    Exponential as Exponential,
    LogNormal as LogNormal,
    Normal as Normal,
    Triangular as Triangular,
    Uniform as Uniform,
    Weibull as Weibull,
)
from ._uncertainty.families import RandomNumber as RandomNumber, Truncated as Truncated
from ._calibration.call import calibrate as calibrate
from ._calibration.samplers import LogLikelihood as LogLikelihood, log_likelihood as log_likelihood
from ._calibration.call import Calibration as Calibration
from ._calibration.sticks import (
    MomentFit as MomentFit,
    Overidentification as Overidentification,
    StickCalibration as StickCalibration,
)
from ._calibration.sticks import calibrate_sticks as calibrate_sticks
from ._calibration.record import RecordedSticks as RecordedSticks, sticks_of_record as sticks_of_record
from ._calibration.samplers import StickSimulator as StickSimulator, stick_simulator as stick_simulator
from ._dynamics.common.method import Exact as Exact, Regularized as Regularized
from ._ensemble.ensemble import simulate_ensemble as simulate_ensemble
from ._ensemble.ensemble import ContactEnsembles as ContactEnsembles, simulate_contacts as simulate_contacts
from ._ensemble.ensemble import concatenate as concatenate, load as load
from ._ensemble.data import Keep as Keep
from ._ensemble.earthquakes import Fragility as Fragility, fragility as fragility
from ._ensemble.earthquakes import incremental_dynamic_analysis as incremental_dynamic_analysis
from ._ensemble.earthquakes import response_spectrum as response_spectrum, sliding_spectrum as sliding_spectrum
from ._ensemble.ensemble import Ensemble as Ensemble
from ._ensemble.sliding_blocks import (
    NewmarkDisplacements as NewmarkDisplacements,
    newmark_displacements as newmark_displacements,
)
from ._dynamics.sticks import Slips as Slips, Sticks as Sticks
from ._excitation.excitation import BaseMotion as BaseMotion, WithJumps as WithJumps
from ._excitation.recorded import ForceSteps as ForceSteps
from ._excitation.gaussian import GaussianProcess as GaussianProcess
from ._excitation.recorded import GroundAcceleration as GroundAcceleration, GroundMotion as GroundMotion
from ._excitation.gaussian import KanaiTajimi as KanaiTajimi
from ._excitation.piecewise_constant import PiecewiseConstantLaw as PiecewiseConstantLaw, VelocitySteps as VelocitySteps
from ._excitation.piecewise_constant import (
    Constant as Constant,
    PiecewiseConstant as PiecewiseConstant,
    PoissonSwitching as PoissonSwitching,
    RandomSteps as RandomSteps,
    SquareWave as SquareWave,
)
from ._excitation.motion import RandomPhase as RandomPhase
from ._excitation.reading import (
    read_acceleration_csv as read_acceleration_csv,
    read_at2 as read_at2,
    read_recorded_csv as read_recorded_csv,
)
from ._excitation.recorded import Recorded as Recorded
from ._excitation.suites import RecordSuite as RecordSuite
from ._excitation.segments import SegmentLaw as SegmentLaw, VelocitySegments as VelocitySegments
from ._excitation.piecewise_constant import SemiMarkovSwitching as SemiMarkovSwitching
from ._excitation.motion import Harmonic as Harmonic, Signal as Signal, SumOfHarmonics as SumOfHarmonics
from ._excitation.gaussian import (
    CloughPenzienSpectrum as CloughPenzienSpectrum,
    KanaiTajimiSpectrum as KanaiTajimiSpectrum,
    PowerSpectrum as PowerSpectrum,
    TabulatedSpectrum as TabulatedSpectrum,
    VelocitySpectrum as VelocitySpectrum,
)
from ._excitation.excitation import base_velocity as base_velocity
from ._excitation.motion import SourceVoltage as SourceVoltage
from ._explore import explore as explore
from ._foundation.fields import Quantity as Quantity
from ._sensitivity.call import differentiable as differentiable, sensitivity as sensitivity
from ._sensitivity.estimate import Sensitivities as Sensitivities, Sensitivity as Sensitivity
from ._sensitivity.statistic import (
    RealizationMeanDuration as RealizationMeanDuration,
    StickDuration as StickDuration,
    StickFunctional as StickFunctional,
    StickSequence as StickSequence,
    StickStart as StickStart,
    StickStatistic as StickStatistic,
    SumOfSquaredDurations as SumOfSquaredDurations,
    TimeToFirstStick as TimeToFirstStick,
)
from ._dynamics.simulate import simulate as simulate
from ._dynamics.simulate import Output as Output
from ._dynamics.simulation import Energies as Energies
from ._dynamics.simulation import Simulation as Simulation
from ._statistics.estimate import bootstrap_interval as bootstrap_interval
from ._statistics.totals import (
    Convergence as Convergence,
    HistogramConvergence as HistogramConvergence,
    convergence as convergence,
    histogram_convergence as histogram_convergence,
)
from ._statistics.distribution import Distribution as Distribution, Histogram as Histogram, common_bins as common_bins
from ._statistics.ensemble_statistics import (
    EnsembleStatistics as EnsembleStatistics,
    OrderStatistics as OrderStatistics,
)
from ._statistics.estimate import Estimate as Estimate
from ._statistics.quantities import FirstSticks as FirstSticks, first_stick as first_stick
from ._statistics.forecasts import Catalogue as Catalogue, catalogue as catalogue
from ._statistics.forecasts import ForecastScores as ForecastScores
from ._statistics.forecasts import Hazard as Hazard
from ._statistics.forecasts import StickForecast as StickForecast
from ._statistics.forecasts import forecast as forecast
from ._statistics.forecasts import score_forecasts as score_forecasts
from ._statistics.independence import identically_distributed as identically_distributed
from ._statistics.independence import independent as independent, independent_and_identical as independent_and_identical
from ._statistics.distribution import (
    ConditionalMeans as ConditionalMeans,
    JointDistribution as JointDistribution,
    JointHistogram as JointHistogram,
)
from ._statistics.quantities import (
    StickQuantity as StickQuantity,
    StickValue as StickValue,
    TestedQuantity as TestedQuantity,
)
from ._statistics.sobol_indices import SobolIndices as SobolIndices, sobol_indices as sobol_indices
from ._statistics.totals import (
    mean_slip_count as mean_slip_count,
    mean_slip_duration as mean_slip_duration,
    mean_stick_count as mean_stick_count,
    mean_stick_duration as mean_stick_duration,
    mean_total_stick_time as mean_total_stick_time,
    stick_fraction as stick_fraction,
)
from ._statistics.independence import HypothesisTest as HypothesisTest, Verdict as Verdict
from ._foundation.types import Ending as Ending, Status as Status
from ._ensemble.encoding import SweepError as SweepError
from ._statistics.transitions import SequenceDistribution as SequenceDistribution
from ._statistics.transitions import TransitionKernel as TransitionKernel
from ._statistics.transitions import transition_kernel as transition_kernel
from ._sweep.sweep import Sweep as Sweep
from ._systems.dynamic_friction import (
    BoucWen as BoucWen,
    Dahl as Dahl,
    DieterichRuina as DieterichRuina,
    DynamicFriction as DynamicFriction,
    ElastoPlastic as ElastoPlastic,
    LuGre as LuGre,
)
from ._systems.friction import (
    Ageing as Ageing,
    Coulomb as Coulomb,
    ExponentialGrowth as ExponentialGrowth,
    FrictionCurve as FrictionCurve,
    FrictionLaw as FrictionLaw,
    LogarithmicGrowth as LogarithmicGrowth,
    Stribeck as Stribeck,
    VelocityDependent as VelocityDependent,
    VelocityWeakening as VelocityWeakening,
)
from ._systems.mass_spring import MassSpring as MassSpring
from ._systems.memory_models import SlipWeakening as SlipWeakening
from ._systems.places import Directional as Directional, FrictionByPlace as FrictionByPlace, OneWay as OneWay
from ._systems.motor_cart import MotorCart as MotorCart, stick_duration_bound as stick_duration_bound
from ._systems.contacts import Contact as Contact
from ._systems.builders import (
    block_row as block_row,
    iwan_sliders as iwan_sliders,
    friction_pendulum as friction_pendulum,
    pendulum_in_series as pendulum_in_series,
    storeys_on_bearing as storeys_on_bearing,
)
from ._systems.builders import FrictionDisk as FrictionDisk, drill_string as drill_string, drivetrain as drivetrain
from ._systems.slopes import coupled_block as coupled_block, rigid_block as rigid_block
from ._systems.slopes import equivalent_acceleration as equivalent_acceleration
from ._systems.structure import LinearStructure as LinearStructure
from ._systems.switched_system import SwitchedSystem as SwitchedSystem
from ._systems.system import Coordinate as Coordinate, System as System

__version__: str
