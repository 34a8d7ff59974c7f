"""Sections ``[base]`` of a study's file for laws made of distributions and spectra.

A distribution or a spectrum is a section of its own, ``[base.gap]`` or ``[base.spectrum]``, chosen by its key ``law``.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .._excitation.gaussian import GaussianProcess
from .._excitation.semi_markov import SemiMarkovSwitching
from .._excitation.spectra import CloughPenzienSpectrum, KanaiTajimiSpectrum, TabulatedSpectrum, VelocitySpectrum
from .._uncertainty.families import Discrete, Exponential, LogNormal, Normal, Triangular, Uniform, Weibull
from ._sections import DescribedSection, Section, section_of


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
        speed: Any = self.speed if self.speeds is None else self.speeds.build()
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
