"""Section ``[base]`` of a study's file: the excitation.

One class for each law, chosen by the key ``law``. The keys are the fields of the law, with their bounds, units and
defaults. To offer another law, add its class here and to one of the unions. A distribution or a spectrum is a section
of its own, ``[base.gap]`` or ``[base.spectrum]``, chosen by its key ``law``.
"""

from typing import Annotated, Literal

import jax.numpy as jnp
from pydantic import Field, model_validator

from .._excitation.excitation import WithJumps
from .._excitation.gaussian import GaussianProcess
from .._excitation.kanai_tajimi import KanaiTajimi
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._excitation.piecewise_constant_laws import Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from .._excitation.random import RandomPhase
from .._excitation.semi_markov import SemiMarkovSwitching
from .._excitation.smooth import Harmonic, Signal, SumOfHarmonics
from .._excitation.spectra import CloughPenzienSpectrum, KanaiTajimiSpectrum, TabulatedSpectrum, VelocitySpectrum
from .._excitation.voltage import SourceVoltage
from .._uncertainty.families import Discrete, Exponential, LogNormal, Normal, Triangular, Uniform, Weibull
from ._records_config import GroundAccelerationConfig, RecordedConfig
from ._sections import DescribedSection, Section, default_tag, section_of


class PoissonSwitchingConfig(section_of(PoissonSwitching, "law", {"speed": 1.0, "rate": 1.0})):
    """Section ``[base]`` with the law `PoissonSwitching`."""


class SquareWaveConfig(section_of(SquareWave, "law")):
    """Section ``[base]`` with the law `SquareWave`."""


class RandomStepsConfig(section_of(RandomSteps, "law")):
    """Section ``[base]`` with the law `RandomSteps`."""


class ConstantConfig(section_of(Constant, "law")):
    """Section ``[base]`` with the law `Constant`."""


class PiecewiseConstantConfig(section_of(PiecewiseConstant, "law", base=Section)):
    """Section ``[base]`` with the law `PiecewiseConstant`."""

    @model_validator(mode="after")
    def _times_fit(self) -> "PiecewiseConstantConfig":
        # Lists, which the law keeps as NumPy arrays: arrays of JAX would start it before its settings are known.
        PiecewiseConstant(self.times, self.velocities)
        return self

    def build(self) -> PiecewiseConstantLaw:
        """The law as the simulation takes it (starts JAX). Raises ValueError for times that are equal in float32."""
        return PiecewiseConstant(jnp.asarray(self.times), jnp.asarray(self.velocities))


_RANDOM_PHASE = "whether each sample draws its phase; not given: true, unless a phase is given"


class _Phased(DescribedSection):
    """A law whose phase may be random."""

    random_phase: bool = Field(default=True, description=_RANDOM_PHASE)

    @model_validator(mode="before")
    @classmethod
    def _given_phase_is_not_random(cls, table: object) -> object:
        if not isinstance(table, dict) or all(table.get(key) is None for key in ("phase", "phases")):
            return table
        return {"random_phase": False, **table}

    @model_validator(mode="after")
    def _one_phase(self) -> "_Phased":
        for key in ("phase", "phases"):
            if self.random_phase and getattr(self, key, None) is not None:
                raise ValueError(f"{key} must be left out where random_phase is true, because it is drawn.")
        return self

    @property
    def title(self) -> str:
        """Its name in reports."""
        return f"{super().title} of random phase" if self.random_phase else super().title

    def build(self) -> Signal | RandomPhase:
        """The signal as the simulation takes it. Raises ValueError for lists that do not fit."""
        given = {name: value for name, value in self.numbers.items() if value is not None}
        signal = self.described_class(**given)
        return RandomPhase(signal) if self.random_phase else signal


_PHASE = Field(default=None, description="rad; not given: 0, or drawn")


class HarmonicConfig(section_of(Harmonic, "law", signal_unit="m/s", base=_Phased)):
    """Section ``[base]`` with the law `Harmonic`."""

    phase: float | None = _PHASE


class SumOfHarmonicsConfig(section_of(SumOfHarmonics, "law", signal_unit="m/s", base=_Phased)):
    """Section ``[base]`` with the law `SumOfHarmonics`."""

    phases: list[float] | None = _PHASE


class SourceVoltageConfig(section_of(SourceVoltage, "law", base=_Phased)):
    """Section ``[base]`` with the law `SourceVoltage`, which drives a `MotorCart`."""

    phase: float | None = _PHASE


class KanaiTajimiConfig(section_of(KanaiTajimi, "law")):
    """Section ``[base]`` with the law `KanaiTajimi`."""


# --- laws of distributions and spectra


class ExponentialConfig(section_of(Exponential, "law")):
    """Section of the distribution `Exponential`."""


class WeibullConfig(section_of(Weibull, "law")):
    """Section of the distribution `Weibull`."""


class LogNormalConfig(section_of(LogNormal, "law")):
    """Section of the distribution `LogNormal`."""


class UniformDistributionConfig(section_of(Uniform, "law")):
    """Section of the distribution `Uniform`."""


class TriangularConfig(section_of(Triangular, "law")):
    """Section of the distribution `Triangular`."""


class NormalConfig(section_of(Normal, "law")):
    """Section of the distribution `Normal`."""


class DiscreteConfig(section_of(Discrete, "law")):
    """Section of the distribution `Discrete`."""


_Positive = (
    ExponentialConfig | WeibullConfig | LogNormalConfig | UniformDistributionConfig | TriangularConfig | DiscreteConfig
)
_GapConfig = Annotated[_Positive, Field(discriminator="law")]
_SpeedsConfig = Annotated[_Positive | NormalConfig, Field(discriminator="law")]


class SemiMarkovSwitchingConfig(Section):
    """Section ``[base]`` with the law `SemiMarkovSwitching`, and its sections ``[base.gap]`` and ``[base.speeds]``."""

    law: Literal["SemiMarkovSwitching"]
    speed: float | None = Field(default=None, description="m/s; not given: the section speeds", gt=0)
    alternating: bool = Field(default=True, description="whether the sign alternates, or is that of each speed")
    first_sign: Literal["random", "positive", "negative"] = Field(
        default="random", description="of the velocity, where signs alternate: random, positive or negative"
    )
    gap: _GapConfig = Field(description="distribution of the time between switches, s")
    speeds: _SpeedsConfig | None = Field(default=None, description="distribution of the speeds, m/s, in place of speed")

    @model_validator(mode="after")
    def _accepted(self) -> "SemiMarkovSwitchingConfig":
        if (self.speed is None) == (self.speeds is None):
            raise ValueError("speed must be given, or a section speeds, and not both.")
        self.build()
        return self

    def build(self) -> SemiMarkovSwitching:
        """The law as the simulation takes it. Raises ValueError for distributions of numbers that do not fit."""
        speed = (self.speed or 0.0) if self.speeds is None else self.speeds.build()
        return SemiMarkovSwitching(self.gap.build(), speed, self.alternating, self.first_sign)


class KanaiTajimiSpectrumConfig(section_of(KanaiTajimiSpectrum, "law")):
    """Section of the spectrum `KanaiTajimiSpectrum`."""


class CloughPenzienSpectrumConfig(section_of(CloughPenzienSpectrum, "law")):
    """Section of the spectrum `CloughPenzienSpectrum`."""


class TabulatedSpectrumConfig(section_of(TabulatedSpectrum, "law")):
    """Section of the spectrum `TabulatedSpectrum`."""


_Spectrum = KanaiTajimiSpectrumConfig | CloughPenzienSpectrumConfig | TabulatedSpectrumConfig


class VelocitySpectrumConfig(Section):
    """Section of the spectrum `VelocitySpectrum`, and its section ``acceleration``."""

    law: Literal["VelocitySpectrum"]
    acceleration: Annotated[_Spectrum, Field(discriminator="law")] = Field(description="spectrum of the acceleration")

    def build(self) -> VelocitySpectrum:
        """The spectrum as the simulation takes it."""
        return VelocitySpectrum(self.acceleration.build())


class _WithSpectrum(DescribedSection):
    """A law with a spectrum."""

    harmonics: int = Field(default=128, description="number of harmonics of a sample", ge=1)
    spectrum: Annotated[_Spectrum | VelocitySpectrumConfig, Field(discriminator="law")] = Field(
        description="one-sided power spectral density over angular frequency"
    )

    def build(self) -> GaussianProcess:
        """The law as the simulation takes it. Raises ValueError for a spectrum that does not fit."""
        return GaussianProcess(self.spectrum.build(), **self.numbers, harmonics=self.harmonics)


class GaussianProcessConfig(section_of(GaussianProcess, "law", base=_WithSpectrum)):
    """Section ``[base]`` with the law `GaussianProcess`, and its section ``[base.spectrum]``."""


# --- any law

_Jumps = (
    PoissonSwitchingConfig
    | SemiMarkovSwitchingConfig
    | SquareWaveConfig
    | RandomStepsConfig
    | ConstantConfig
    | PiecewiseConstantConfig
)
_Motions = HarmonicConfig | SumOfHarmonicsConfig | GaussianProcessConfig | RecordedConfig
_JumpsConfig = Annotated[_Jumps, Field(discriminator="law"), default_tag("law", "PoissonSwitching")]
_MotionConfig = Annotated[_Motions, Field(discriminator="law")]


class WithJumpsConfig(Section):
    """Section ``[base]`` with the law `WithJumps`, and its sections ``[base.motion]`` and ``[base.jumps]``."""

    law: Literal["WithJumps"]
    motion: _MotionConfig = Field(description="the continuous part")
    jumps: _JumpsConfig = Field(description="the part that jumps")

    @property
    def title(self) -> str:
        """Its name in reports."""
        return f"{self.motion.title} with jumps by {self.jumps.title}"

    def build(self) -> WithJumps:
        """The law as the simulation takes it. Raises ValueError for an unsuitable record, OSError for a file that
        cannot be read.
        """
        return WithJumps(self.motion.build(), self.jumps.build())


BaseConfig = Annotated[
    _Jumps | _Motions | WithJumpsConfig | GroundAccelerationConfig | KanaiTajimiConfig | SourceVoltageConfig,
    Field(discriminator="law"),
]
