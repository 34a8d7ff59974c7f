"""A study: the sections of its TOML file as pydantic models."""

import math
from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from .. import _diffrax as diffrax
from .._dynamics.method import Exact, Regularized
from .._statistics.accumulator import MOST_ORDERS
from ._bases_config import BaseConfig, SourceVoltageConfig
from ._sections import Section, Start, UniformConfig, kinds_in, start_value, tag_of, toml_blocks, toml_value
from ._systems_config import MassSpringConfig, MotorCartConfig, SystemConfig

_OR_RANDOM = "or { low = ..., high = ... } for one drawn in every sample"


class RunConfig(Section):
    """Section ``[run]``: how much is simulated, and how. Each system adds its initial state.

    `maps_first_sticks`: whether a figure shows the duration of the first sticks against their position.
    """

    maps_first_sticks: ClassVar[bool] = False

    t1: float = Field(default=200.0, gt=0, description="duration of each sample, s")
    samples: int = Field(default=10_000, ge=1, le=2**31, description="number of samples")
    seed: int = Field(default=0, ge=0, lt=2**32, description="of the random numbers")
    keep: Literal["sticks", "statistics", "totals"] = Field(
        default="sticks",
        description="sticks: store every stick; statistics: sums (for very many samples); totals: the fewest sums",
    )
    orders: int = Field(
        default=10, ge=1, le=MOST_ORDERS, description="statistics of the 1st, 2nd, ... up to this stick"
    )
    count_initial_rest: bool = Field(
        default=False, description="whether a stick that begins at t = 0 counts as the first"
    )
    dtype: Literal["float64", "float32"] = Field(default="float64", description="float64 or float32")
    threads: int | None = Field(default=None, ge=1, description="worker threads; not given: all cores")
    chunk: int | None = Field(
        default=None, ge=1, le=2**31, description="samples simulated per call; not given: chosen for speed"
    )
    step: float | None = Field(default=None, gt=0, description="time step, s; not given: as the time scales demand")
    max_steps: int | None = Field(
        default=None, ge=1, description="time steps allowed to one sample; not given: more than enough"
    )
    width: float | None = Field(
        default=None, gt=0, description="of regularised friction, m/s (with step: in fixed steps); not given: exact"
    )
    shape: Literal["linear", "tanh", "rational", "arctan"] = Field(
        default="linear", description="of regularised friction: linear, tanh, rational or arctan"
    )

    def method(self, solver: Any = None) -> Exact | Regularized:
        """The method as the simulation takes it; `solver`: for slips, or of regularised dynamics."""
        if self.width is None:
            return Exact(self.step, self.max_steps, solver)
        return Regularized(self.width, self.shape, step=self.step, solver=solver, max_steps=self.max_steps)

    def y0(self) -> tuple[Any, ...]:
        """The initial state as the simulation takes it."""
        raise NotImplementedError  # not abstract: the keys that all systems share can be read and written without one


class MassSpringRunConfig(RunConfig):
    """Section ``[run]`` of a `MassSpring`."""

    initial_position: Start = Field(default=0.0, description=f"m, {_OR_RANDOM}")
    initial_velocity: Start = Field(default=1.0, description="m/s, likewise")
    solver: Literal["Tsit5", "Dopri5", "Dopri8"] | None = Field(
        default=None,
        description="Tsit5, Dopri5 or Dopri8, for slips; not given: closed forms, with a width Kvaerno3",
    )

    def method(self, solver: Any = None) -> Exact | Regularized:
        """The method as the simulation takes it."""
        return super().method(solver if self.solver is None else getattr(diffrax, self.solver)())

    def y0(self) -> tuple[Any, ...]:
        """The initial state as the simulation takes it."""
        return start_value(self.initial_position), start_value(self.initial_velocity)


class MotorCartRunConfig(RunConfig):
    """Section ``[run]`` of a `MotorCart`; the defaults are the paper's."""

    maps_first_sticks: ClassVar[bool] = True
    t1: float = Field(default=2.0, gt=0, description="duration of each sample, s")
    initial_angle: Start = Field(default=UniformConfig(low=0.0, high=2 * math.pi), description=f"rad, {_OR_RANDOM}")
    initial_angular_velocity: Start = Field(default=0.0, description="rad/s, likewise")
    initial_current: Start = Field(default=0.0, description="A, likewise")

    def y0(self) -> tuple[Any, ...]:
        """The initial state as the simulation takes it."""
        return tuple(map(start_value, (self.initial_angle, self.initial_angular_velocity, self.initial_current)))


RUNS: dict[type[Section], type[RunConfig]] = {
    MassSpringConfig: MassSpringRunConfig,
    MotorCartConfig: MotorCartRunConfig,
}
"""The section ``[run]`` of each system."""


class OutputConfig(Section):
    """Section ``[output]``: where the result goes."""

    directory: str = Field(default="results/study", min_length=1, description="folder, made if missing")
    figures: bool = Field(default=True, description="whether to draw figures")


class StudyConfig(Section):
    """A whole study. The default is the oscillator of Lima and Sampaio's conference paper under Poisson switching.

    The defaults depend on the system: a `MotorCart` is driven by a `SourceVoltage`, for 2 s.
    """

    system: SystemConfig = MassSpringConfig()
    base: BaseConfig = Field(default_factory=dict, validate_default=True)
    run: MassSpringRunConfig | MotorCartRunConfig = Field(default_factory=dict, validate_default=True)
    output: OutputConfig = OutputConfig()

    @field_validator("base", mode="before")
    @classmethod
    def _usual_base(cls, table: Any, info: Any) -> Any:
        if not isinstance(table, dict) or "law" in table:
            return table
        by_voltage = getattr(info.data.get("system"), "driven_by_voltage", False)
        return {"law": "SourceVoltage" if by_voltage else "PoissonSwitching", **table}

    @field_validator("run", mode="before")
    @classmethod
    def _run_of_the_system(cls, table: Any, info: Any) -> RunConfig:
        if "system" not in info.data:  # the mistake in [system] is reported
            return MassSpringRunConfig()
        kind = RUNS[type(info.data["system"])]
        if type(table) is RunConfig:
            table = table.model_dump(exclude_unset=True)
        return kind.model_validate(table, context=info.context)

    @model_validator(mode="after")
    def _base_drives_the_system(self) -> "StudyConfig":
        law, model = toml_value(tag_of(type(self.base))), tag_of(type(self.system))
        voltage = isinstance(self.base, SourceVoltageConfig)
        if self.system.driven_by_voltage and not voltage:
            raise ValueError(
                f'law in [base] must be "SourceVoltage", because model in [system] is {model}, but {law} was given.'
            )
        if voltage and not self.system.driven_by_voltage:
            raise ValueError(
                f"law in [base] must be a motion of the base, because model in [system] is {model}, but {law} was "
                "given, which drives a MotorCart."
            )
        return self

    def to_toml(self) -> str:
        """The complete study as a TOML file, with units as comments; reading it gives the same study."""
        by_voltage = self.system.driven_by_voltage
        laws = [law for law, kind in kinds_in(BaseConfig).items() if (kind is SourceVoltageConfig) == by_voltage]
        kinds = {"system": kinds_in(SystemConfig), "base": laws}
        blocks = [toml_blocks(getattr(self, name), name, kinds.get(name, ())) for name in type(self).model_fields]
        return "\n\n".join(block for part in blocks for block in part) + "\n"
