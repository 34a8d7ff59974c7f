"""What a study is made of: sections of a TOML file, as pydantic models.

One class for each law and system, told apart by its tag (``law``, ``model``): to offer another, add its class here and
to the union. Types are strict: neither the string "1" nor true is a number; nan and infinity are refused.
"""

import json
from typing import Annotated, Any, Literal

import jax.numpy as jnp
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ..base_motion.laws import BangBangLaw, Constant, PiecewiseConstant, PoissonSwitching, RandomSteps, SquareWave
from ..systems.friction import Coulomb
from ..systems.mass_spring import MassSpring


class Section(BaseModel):
    """A section of the file. Raises pydantic's ValidationError for unknown keys, wrong types and wrong values."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _default_tag(key: str, name: str) -> BeforeValidator:
    """Let a table without the tag `key` mean the kind called `name`."""
    return BeforeValidator(lambda table: {key: name, **table} if isinstance(table, dict) else table)


class MassSpringConfig(Section):
    """Section ``[system]``: a mass on a spring."""

    model: Literal["MassSpring"] = Field(default="MassSpring", description="the kind of system")
    mass: float = Field(default=1.0, gt=0, description="kg")
    stiffness: float = Field(default=4.0, gt=0, description="N/m")
    normal_force: float = Field(default=1.0, gt=0, description="N")
    mu: float = Field(default=1.0, ge=0, description="friction coefficient")

    def build(self) -> MassSpring:
        """The system as the simulation takes it."""
        return MassSpring(self.mass, self.stiffness, self.normal_force, Coulomb(self.mu))


_LAW = "PoissonSwitching, SquareWave, RandomSteps, Constant or PiecewiseConstant"
_SPEED = "m/s"


class PoissonSwitchingConfig(Section):
    """Section ``[base]`` with the law `PoissonSwitching`."""

    law: Literal["PoissonSwitching"] = Field(default="PoissonSwitching", description=_LAW)
    speed: float = Field(default=1.0, gt=0, description=_SPEED)
    rate: float = Field(default=1.0, gt=0, description="mean number of switches per second, 1/s")
    first_sign: Literal["random", "positive", "negative"] = Field(
        default="random", description="of the velocity: random, positive or negative"
    )

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it."""
        return PoissonSwitching(self.speed, self.rate, self.first_sign)


class SquareWaveConfig(Section):
    """Section ``[base]`` with the law `SquareWave`."""

    law: Literal["SquareWave"] = Field(description=_LAW)
    speed: float = Field(gt=0, description=_SPEED)
    period: float = Field(gt=0, description="s")

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it."""
        return SquareWave(self.speed, self.period)


class RandomStepsConfig(Section):
    """Section ``[base]`` with the law `RandomSteps`."""

    law: Literal["RandomSteps"] = Field(description=_LAW)
    speed: float = Field(gt=0, description=_SPEED)
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

    law: Literal["Constant"] = Field(description=_LAW)
    speed: float = Field(description="signed, m/s")

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it."""
        return Constant(self.speed)


class PiecewiseConstantConfig(Section):
    """Section ``[base]`` with the law `PiecewiseConstant`."""

    law: Literal["PiecewiseConstant"] = Field(description=_LAW)
    times: list[float] = Field(min_length=1, description="start of each interval, s; the first is 0")
    velocities: list[float] = Field(min_length=1, description="during each interval, m/s")

    @model_validator(mode="after")
    def _times_fit(self) -> "PiecewiseConstantConfig":
        # Repeats the law's own checks: its arrays would start JAX before its settings are known.
        if len(self.times) != len(self.velocities):
            raise ValueError(
                f"times and velocities must have the same length, but have {len(self.times)} and "
                f"{len(self.velocities)} entries."
            )
        if self.times[0] != 0:
            raise ValueError(f"times must begin with 0, but {self.times[0]} was given first.")
        for before, after in zip(self.times, self.times[1:], strict=False):
            if after <= before:
                raise ValueError(f"times must increase, but {after} follows {before}.")
        return self

    def build(self) -> BangBangLaw:
        """The law as the simulation takes it (starts JAX). Raises ValueError if float32 cannot tell times apart."""
        return PiecewiseConstant(jnp.asarray(self.times), jnp.asarray(self.velocities))


SystemConfig = Annotated[MassSpringConfig, _default_tag("model", "MassSpring")]
BaseConfig = Annotated[
    PoissonSwitchingConfig | SquareWaveConfig | RandomStepsConfig | ConstantConfig | PiecewiseConstantConfig,
    Field(discriminator="law"),
    _default_tag("law", "PoissonSwitching"),
]


class RunConfig(Section):
    """Section ``[run]``: how much is simulated, from where, and how."""

    t1: float = Field(default=200.0, gt=0, description="duration of each sample, s")
    samples: int = Field(default=10_000, ge=1, le=2**31, description="number of samples")
    seed: int = Field(default=0, ge=0, lt=2**32, description="of the random numbers")
    initial_position: float = Field(default=0.0, description="m")
    initial_velocity: float = Field(default=1.0, description="m/s")
    keep: Literal["sticks", "statistics"] = Field(
        default="sticks", description="sticks: store every stick; statistics: only sums (for very many samples)"
    )
    dtype: Literal["float64", "float32"] = Field(default="float64", description="float64 or float32")
    threads: int | None = Field(default=None, ge=1, description="worker threads; not given: all cores")
    chunk: int | None = Field(default=None, ge=1, description="samples simulated per call; not given: chosen for speed")


class OutputConfig(Section):
    """Section ``[output]``: where the result goes."""

    directory: str = Field(default="results/study", min_length=1, description="folder, made if missing")
    figures: bool = Field(default=True, description="whether to draw figures")


class StudyConfig(Section):
    """A whole study. The default is the oscillator of Lima and Sampaio's conference paper under Poisson switching."""

    system: SystemConfig = MassSpringConfig()
    base: BaseConfig = PoissonSwitchingConfig()
    run: RunConfig = RunConfig()
    output: OutputConfig = OutputConfig()

    def to_toml(self) -> str:
        """The complete study as a TOML file, with units as comments; reading it gives the same study."""
        blocks = []
        for name in type(self).model_fields:
            section = getattr(self, name)
            lines = [_toml_line(key, getattr(section, key), info) for key, info in type(section).model_fields.items()]
            blocks.append("\n".join([f"[{name}]", *lines]))
        return "\n\n".join(blocks) + "\n"


def toml_value(value: Any) -> str:
    """A number, string, truth value or list of them as TOML writes it; anything else as Python does."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(toml_value(entry) for entry in value)}]"
    return repr(value)


def _toml_line(key: str, value: Any, info: Any) -> str:
    written = f"# {key} =" if value is None else f"{key} = {toml_value(value)}"
    return f"{written:<32}  # {info.description}"
