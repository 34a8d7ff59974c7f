"""Section ``[base]`` of a study's file: what drives the system.

One class for each law, told apart by its tag ``law``: to offer another, add its class here and to the union.
"""

import abc
from typing import Annotated, Any, Literal

import jax.numpy as jnp
from pydantic import Field, model_validator

from .._excitation.excitation import WithJumps
from .._excitation.kanai_tajimi import KanaiTajimi
from .._excitation.laws import BangBangLaw, Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from .._excitation.random import RandomPhase
from .._excitation.smooth import Harmonic, Signal, SumOfHarmonics
from .._excitation.voltage import SourceVoltage
from ._records_config import GroundAccelerationConfig, RecordedConfig
from ._sections import Section, default_tag

_VELOCITY = "m/s"


class PoissonSwitchingConfig(Section):
    """Section ``[base]`` with the law `PoissonSwitching`."""

    law: Literal["PoissonSwitching"] = "PoissonSwitching"
    speed: float = Field(default=1.0, gt=0, description=_VELOCITY)
    rate: float = Field(default=1.0, gt=0, description="mean number of switches per second, 1/s")
    first_sign: Literal["random", "positive", "negative"] = Field(
        default="random", description="of the velocity: random, positive or negative"
    )

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it."""
        return PoissonSwitching(self.speed, self.rate, self.first_sign)


class SquareWaveConfig(Section):
    """Section ``[base]`` with the law `SquareWave`."""

    law: Literal["SquareWave"]
    speed: float = Field(gt=0, description=_VELOCITY)
    period: float = Field(gt=0, description="s")

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it."""
        return SquareWave(self.speed, self.period)


class RandomStepsConfig(Section):
    """Section ``[base]`` with the law `RandomSteps`."""

    law: Literal["RandomSteps"]
    speed: float = Field(gt=0, description=_VELOCITY)
    interval: float = Field(gt=0, description="time between draws of the velocity, s")
    levels: list[float] = Field(default=[-1.0, 1.0], description="the velocities are speed times these")
    probabilities: list[float] | None = Field(default=None, description="of the levels; not given: equal odds")

    @model_validator(mode="after")
    def _levels_fit(self) -> "RandomStepsConfig":
        self.build()
        return self

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it. Raises ValueError for levels and probabilities that do not fit."""
        odds = None if self.probabilities is None else tuple(self.probabilities)
        return RandomSteps(self.speed, self.interval, tuple(self.levels), odds)


class ConstantConfig(Section):
    """Section ``[base]`` with the law `Constant`."""

    law: Literal["Constant"]
    speed: float = Field(description="signed, m/s")

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it."""
        return Constant(self.speed)


class PiecewiseConstantConfig(Section):
    """Section ``[base]`` with the law `PiecewiseConstant`."""

    law: Literal["PiecewiseConstant"]
    times: list[float] = Field(min_length=1, description="start of each interval, s; the first is 0")
    velocities: list[float] = Field(min_length=1, description="during each interval, m/s")

    @model_validator(mode="after")
    def _times_fit(self) -> "PiecewiseConstantConfig":
        # Lists, which the law keeps as NumPy arrays: arrays of JAX would start it before its settings are known.
        PiecewiseConstant(self.times, self.velocities)
        return self

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it (starts JAX). Raises ValueError if float32 cannot tell times apart."""
        return PiecewiseConstant(jnp.asarray(self.times), jnp.asarray(self.velocities))


_RANDOM_PHASE = "whether each sample draws its phase; not given: true, unless a phase is given"


class _Phased(Section):
    """A law whose phase may be random."""

    random_phase: bool = Field(default=True, description=_RANDOM_PHASE)

    @model_validator(mode="before")
    @classmethod
    def _given_phase_is_not_random(cls, table: Any) -> Any:
        if not isinstance(table, dict) or all(table.get(key) is None for key in ("phase", "phases")):
            return table
        return {"random_phase": False, **table}

    @model_validator(mode="after")
    def _one_phase(self) -> "_Phased":
        for key in ("phase", "phases"):
            if self.random_phase and getattr(self, key, None) is not None:
                raise ValueError(f"{key} must be left out where random_phase is true, because it is drawn.")
        self.build()
        return self

    @property
    def title(self) -> str:
        """What reports call it."""
        return f"{super().title} of random phase" if self.random_phase else super().title

    @abc.abstractmethod
    def signal(self) -> Signal:
        """The signal with the phases given."""

    def build(self) -> Signal | RandomPhase:
        """The signal as the simulation takes it. Raises ValueError for lists that do not fit."""
        return RandomPhase(self.signal()) if self.random_phase else self.signal()


class HarmonicConfig(_Phased):
    """Section ``[base]`` with the law `Harmonic`."""

    law: Literal["Harmonic"]
    amplitude: float = Field(description=_VELOCITY)
    angular_frequency: float = Field(gt=0, description="rad/s")
    phase: float | None = Field(default=None, description="rad; not given: 0, or drawn")
    offset: float = Field(default=0.0, description=_VELOCITY)

    def signal(self) -> Signal:
        """The signal with the phase given."""
        return Harmonic(self.amplitude, self.angular_frequency, self.phase or 0.0, self.offset)


class SumOfHarmonicsConfig(_Phased):
    """Section ``[base]`` with the law `SumOfHarmonics`."""

    law: Literal["SumOfHarmonics"]
    amplitudes: list[float] = Field(min_length=1, description=_VELOCITY)
    angular_frequencies: list[float] = Field(min_length=1, description="rad/s")
    phases: list[float] | None = Field(default=None, description="rad; not given: 0, or drawn")
    offset: float = Field(default=0.0, description=_VELOCITY)

    def signal(self) -> Signal:
        """The signal with the phases given."""
        return SumOfHarmonics(self.amplitudes, self.angular_frequencies, self.phases, self.offset)


class SourceVoltageConfig(_Phased):
    """Section ``[base]`` with the law `SourceVoltage`, which drives a `MotorCart`."""

    law: Literal["SourceVoltage"] = "SourceVoltage"
    mean: float = Field(default=1.0, description="V")
    amplitude: float = Field(default=0.5, description="V")
    angular_frequency: float = Field(default=10.0, gt=0, description="rad/s")
    phase: float | None = Field(default=None, description="rad; not given: 0, or drawn")

    def signal(self) -> Signal:
        """The signal with the phase given."""
        return SourceVoltage(self.mean, self.amplitude, self.angular_frequency, self.phase or 0.0)


_KANAI_TAJIMI: Any = KanaiTajimi(1.0)


class KanaiTajimiConfig(Section):
    """Section ``[base]`` with the law `KanaiTajimi`."""

    law: Literal["KanaiTajimi"]
    rms: float = Field(gt=0, description="standard deviation of the ground's acceleration at its height, m/s^2")
    ground_frequency: float = Field(default=_KANAI_TAJIMI.ground_frequency, gt=0, description="of the layer, rad/s")
    ground_damping: float = Field(default=_KANAI_TAJIMI.ground_damping, gt=0, lt=1, description="its damping ratio")
    rise: float = Field(default=_KANAI_TAJIMI.rise, gt=0, description="of the envelope, s")
    plateau: float = Field(default=_KANAI_TAJIMI.plateau, ge=0, description="of the envelope, s")
    decay: float = Field(default=_KANAI_TAJIMI.decay, ge=0, description="of the envelope, 1/s")
    interval: float = Field(default=_KANAI_TAJIMI.interval, gt=0, description="between samples, s")

    @model_validator(mode="after")
    def _interval_fits(self) -> "KanaiTajimiConfig":
        self.build()
        return self

    def build(self) -> KanaiTajimi:
        """The law as the simulation takes it. Raises ValueError for an interval too long for the ground's frequency."""
        return KanaiTajimi(**self.model_dump(exclude={"law"}))


_JumpsConfig = Annotated[
    PoissonSwitchingConfig | SquareWaveConfig | RandomStepsConfig | ConstantConfig | PiecewiseConstantConfig,
    Field(discriminator="law"),
    default_tag("law", "PoissonSwitching"),
]
_MotionConfig = Annotated[HarmonicConfig | SumOfHarmonicsConfig | RecordedConfig, Field(discriminator="law")]


class WithJumpsConfig(Section):
    """Section ``[base]`` with the law `WithJumps`, and its sections ``[base.motion]`` and ``[base.jumps]``."""

    law: Literal["WithJumps"]
    motion: _MotionConfig = Field(description="the continuous part")
    jumps: _JumpsConfig = Field(description="the part that jumps")

    @property
    def title(self) -> str:
        """What reports call it."""
        return f"{self.motion.title} with jumps by {self.jumps.title}"

    def build(self) -> WithJumps:
        """The law as the simulation takes it. Raises ValueError for an unsuitable record, OSError for a file that
        cannot be read.
        """
        return WithJumps(self.motion.build(), self.jumps.build())


BaseConfig = Annotated[
    PoissonSwitchingConfig
    | SquareWaveConfig
    | RandomStepsConfig
    | ConstantConfig
    | PiecewiseConstantConfig
    | HarmonicConfig
    | SumOfHarmonicsConfig
    | RecordedConfig
    | WithJumpsConfig
    | GroundAccelerationConfig
    | KanaiTajimiConfig
    | SourceVoltageConfig,
    Field(discriminator="law"),
]
