"""A study: the sections of its TOML file as pydantic models."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from .. import _diffrax as diffrax
from .._dynamics.common.method import Exact, Regularized
from .._statistics.accumulator import MOST_ORDERS
from .._uncertainty.families import Uniform
from ._bases_config import BaseConfig, SourceVoltageConfig
from ._sections import Section, Start, UniformConfig, kinds_in, start_value, tag_of, toml_blocks, toml_value
from ._structures_config import BlockRowConfig, LinearStructureConfig, StoreysOnBearingConfig, StructureSection
from ._systems_config import MassSpringConfig, MotorCartConfig, SystemConfig

_OR_RANDOM = "or { low = ..., high = ... } for one drawn in every sample"


class PointConfig(Section):
    """The part of the section ``[run]`` that is the same for one ensemble and for each of a parameter sweep.

    Each system adds its initial state.

    - `maps_first_sticks`: whether a figure shows the duration of the first sticks against their position.
    - `initial`: the keys of the initial state, in its order.
    """

    maps_first_sticks: ClassVar[bool] = False
    initial: ClassVar[tuple[str, ...]] = ()

    t1: float = Field(default=200.0, gt=0, description="duration of each sample, s")
    samples: int = Field(default=10_000, ge=1, le=2**31, description="number of samples")
    seed: int = Field(default=0, ge=0, lt=2**32, description="of the random numbers")
    orders: int = Field(
        default=10, ge=1, le=MOST_ORDERS, description="statistics of the 1st, 2nd, ... up to this stick"
    )
    count_initial_rest: bool = Field(
        default=False, description="whether a stick that begins at t = 0 counts as the first"
    )
    dtype: Literal["float64", "float32"] = Field(default="float64", description="float64 or float32")
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

    def method(self, has_inner_states: bool = False) -> Exact | Regularized:
        """The method as the simulation takes it, for friction laws that have inner states or not."""
        name = getattr(self, "solver", None)
        solver = None if name is None else getattr(diffrax, name)()
        if has_inner_states:
            return Regularized(solver=solver, max_steps=self.max_steps)
        if self.width is None:
            return Exact(self.step, self.max_steps, solver)
        return Regularized(self.width, self.shape, step=self.step, solver=solver, max_steps=self.max_steps)

    def y0(self) -> tuple[float | Uniform, ...] | None:
        """The initial state as the simulation takes it; None for zeros."""
        return tuple(start_value(getattr(self, name)) for name in self.initial)


class RunConfig(PointConfig):
    """Section ``[run]`` of one ensemble: how much is simulated, and how."""

    keep: Literal["sticks", "statistics", "totals"] = Field(
        default="sticks",
        description="sticks: store every stick; statistics: sums (for very many samples); totals: the fewest sums",
    )
    threads: int | None = Field(default=None, ge=1, description="worker threads; not given: all cores")
    chunk: int | None = Field(
        default=None, ge=1, le=2**31, description="samples simulated per call; not given: chosen for speed"
    )


_Solver = Literal["Tsit5", "Dopri5", "Dopri8"]


class MassSpringPointConfig(PointConfig):
    """The same with the initial state of a `MassSpring`."""

    initial: ClassVar[tuple[str, ...]] = ("initial_position", "initial_velocity")

    initial_position: Start = Field(default=0.0, description=f"m, {_OR_RANDOM}")
    initial_velocity: Start = Field(default=1.0, description="m/s, likewise")
    solver: _Solver | None = Field(
        default=None,
        description="Tsit5, Dopri5 or Dopri8, for slips; not given: closed forms, with a width Kvaerno3",
    )


class MotorCartPointConfig(PointConfig):
    """The same with the initial state of a `MotorCart`; the defaults are the paper's."""

    maps_first_sticks: ClassVar[bool] = True
    initial: ClassVar[tuple[str, ...]] = ("initial_angle", "initial_angular_velocity", "initial_current")

    t1: float = Field(default=2.0, gt=0, description="duration of each sample, s")
    initial_angle: Start = Field(default=UniformConfig(low=0.0, high=2 * math.pi), description=f"rad, {_OR_RANDOM}")
    initial_angular_velocity: Start = Field(default=0.0, description="rad/s, likewise")
    initial_current: Start = Field(default=0.0, description="A, likewise")


class StructurePointConfig(PointConfig):
    """The same with the initial state of a structure."""

    initial_state: list[Start] | None = Field(
        default=None, description=f"positions (m), then velocities (m/s), each a number {_OR_RANDOM}; not given: zeros"
    )
    solver: _Solver | None = Field(
        default=None, description="Tsit5, Dopri5 or Dopri8; not given: power series, or Dopri8"
    )

    def y0(self) -> tuple[float | Uniform, ...] | None:
        return None if self.initial_state is None else tuple(map(start_value, self.initial_state))


class MassSpringRunConfig(MassSpringPointConfig, RunConfig):
    """Section ``[run]`` of an ensemble of a `MassSpring`."""


class MotorCartRunConfig(MotorCartPointConfig, RunConfig):
    """Section ``[run]`` of an ensemble of a `MotorCart`."""


class StructureRunConfig(StructurePointConfig, RunConfig):
    """Section ``[run]`` of an ensemble of a structure."""


STRUCTURES = LinearStructureConfig, BlockRowConfig, StoreysOnBearingConfig
"""The kinds of section ``[system]`` that are structures."""


class OutputConfig(Section):
    """Section ``[output]``: where the result goes."""

    directory: str = Field(default="results/study", min_length=1, description="folder, made if missing")
    figures: bool = Field(default=True, description="whether to draw figures")


class FileConfig(Section):
    """What the files of a study and of a sweep share: the system, what drives it, and how it is run.

    The defaults depend on the system: a `MotorCart` is driven by a `SourceVoltage`, for 2 s. `runs`: the section
    ``[run]`` of each system.
    """

    runs: ClassVar[Mapping[type[Section], type[PointConfig]]]

    system: SystemConfig = MassSpringConfig()
    base: BaseConfig = Field(default_factory=dict, validate_default=True)

    @field_validator("base", mode="before")
    @classmethod
    def _usual_base(cls, table: object, info: Any) -> object:
        if not isinstance(table, dict) or "law" in table:
            return table
        by_voltage = getattr(info.data.get("system"), "driven_by_voltage", False)
        return {"law": "SourceVoltage" if by_voltage else "PoissonSwitching", **table}

    @field_validator("run", mode="before", check_fields=False)
    @classmethod
    def _run_of_the_system(cls, table: object, info: Any) -> PointConfig:
        if "system" not in info.data:  # the mistake in [system] is reported
            return cls.runs[MassSpringConfig]()
        kind = cls.runs[type(info.data["system"])]
        if isinstance(table, RunConfig) and type(table) is RunConfig:
            table = table.model_dump(exclude_unset=True)
        return kind.model_validate(table, context=info.context)

    @model_validator(mode="after")
    def _base_drives_the_system(self) -> "FileConfig":
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

    @model_validator(mode="after")
    def _run_fits_the_friction(self) -> "FileConfig":
        run: Any = getattr(self, "run", None)
        for key in ("width", "step"):
            value = getattr(run, key, None)
            if self.system.has_inner_states and value is not None:
                raise ValueError(
                    f"{key} in [run] must be left out for friction laws with an inner state, which are smooth by "
                    f"themselves and need adaptive steps, but {value:g} was given."
                )
        return self

    @model_validator(mode="after")
    def _run_fits_a_structure(self) -> "FileConfig":
        run: Any = getattr(self, "run", None)
        if not isinstance(self.system, StructureSection) or run is None:
            return self
        size, state = self.system.size, run.initial_state
        if state is not None and len(state) != 2 * size:
            raise ValueError(
                f"initial_state in [run] must hold {2 * size} numbers, the positions and then the velocities of {size} "
                f"masses, but {len(state)} were given."
            )
        return self

    def to_toml(self) -> str:
        """The complete file in TOML, with units as comments; reading it gives the same description."""
        by_voltage = self.system.driven_by_voltage
        laws = [law for law, kind in kinds_in(BaseConfig).items() if (kind is SourceVoltageConfig) == by_voltage]
        kinds = {"system": kinds_in(SystemConfig), "base": laws}
        blocks = [toml_blocks(getattr(self, name), name, kinds.get(name, ())) for name in type(self).model_fields]
        return "\n\n".join(block for part in blocks for block in part) + "\n"


class StudyConfig(FileConfig):
    """A whole study of one ensemble. The default is the oscillator of Lima and Sampaio's conference paper under Poisson
    switching.
    """

    runs: ClassVar[Mapping[type[Section], type[PointConfig]]] = {
        MassSpringConfig: MassSpringRunConfig,
        MotorCartConfig: MotorCartRunConfig,
        **dict.fromkeys(STRUCTURES, StructureRunConfig),
    }

    run: MassSpringRunConfig | MotorCartRunConfig | StructureRunConfig = Field(
        default_factory=dict, validate_default=True
    )
    output: OutputConfig = OutputConfig()
