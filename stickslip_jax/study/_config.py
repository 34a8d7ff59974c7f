"""A study or a sweep: the sections of its TOML file as pydantic models, and the way back from objects to a file."""

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._ensemble.points import MOST_POINTS
from .._excitation.motion import RandomPhase
from .._foundation import lazy_diffrax as diffrax
from .._foundation.checks import one_of
from .._foundation.fields import described
from .._statistics.quantities import MOST_ORDERS
from .._systems.structure import LinearStructure
from .._systems.system import System
from .._uncertainty.families import Uniform
from . import StudyError
from ._sections import (
    FIELDS,
    Section,
    Start,
    UniformConfig,
    about,
    is_number,
    kinds_in,
    nearest,
    refused,
    tag_key,
    tag_of,
    toml_blocks,
    toml_value,
    value_of,
)
from ._systems_config import BaseConfig, MassSpringConfig, SourceVoltageConfig, StructureSection, SystemConfig

# A study: the sections of its TOML file as pydantic models.


_OR_RANDOM = "or { low = ..., high = ... } for one drawn in every sample"


class PointConfig(Section):
    """The part of the section ``[run]`` that is the same for one ensemble and for each of a parameter sweep.

    Each system adds its initial state.

    `initial`: the keys of the initial state, in its order.
    """

    initial: ClassVar[tuple[str, ...]] = ()

    t1: float = about("duration of each sample, s", 200.0, gt=0)
    samples: int = about("number of samples", 10_000, ge=1, le=2**31)
    seed: int = about("of the random numbers", 0, ge=0, lt=2**32)
    orders: int = about("statistics of the 1st, 2nd, ... up to this stick", 10, ge=1, le=MOST_ORDERS)
    count_initial_rest: bool = about("whether a stick that begins at t = 0 counts as the first", False)
    dtype: Literal["float64", "float32"] = about("float64 or float32", "float64")
    step: float | None = about("time step, s; not given: as the time scales demand", None, gt=0)
    max_steps: int | None = about("time steps allowed to one sample; not given: more than enough", None, ge=1)
    width: float | None = about(
        "of regularised friction, m/s (with step: in fixed steps); not given: exact", None, gt=0
    )
    shape: Literal["linear", "tanh", "rational", "arctan"] = about(
        "of regularised friction: linear, tanh, rational or arctan", "linear"
    )

    outputs: list[str] | None = about(
        'numbers of each sample, such as ["peak position", "slip path"]; not given: none', None
    )

    def method(self, has_inner_states: bool = False) -> Exact | Regularized:
        """The method as the simulation takes it, for friction laws that have inner states or not."""
        if has_inner_states:
            return Regularized(max_steps=self.max_steps)
        if self.width is not None:
            return Regularized(self.width, self.shape, step=self.step, max_steps=self.max_steps)
        name = getattr(self, "solver", None)
        return Exact(self.step, self.max_steps, None if name is None else getattr(diffrax, name)())

    def y0(self) -> tuple[float | Uniform, ...] | None:
        """The initial state as the simulation takes it; None for zeros."""
        return tuple(value_of(getattr(self, name)) for name in self.initial)


class RunConfig(PointConfig):
    """Section ``[run]`` of one ensemble: how much is simulated, and how."""

    keep: Literal["sticks", "statistics", "totals"] = about(
        "sticks: store every stick; statistics: sums (for very many samples); totals: the fewest sums", "sticks"
    )
    threads: int | None = about("worker threads; not given: all cores", None, ge=1)
    chunk: int | None = about("samples simulated per call; not given: chosen for speed", None, ge=1, le=2**31)


_Solver = Literal["Tsit5", "Dopri5", "Dopri8"]


class MassSpringPointConfig(PointConfig):
    """The same with the initial state of a `MassSpring`."""

    initial: ClassVar[tuple[str, ...]] = ("initial_position", "initial_velocity")

    initial_position: Start = about(f"m, {_OR_RANDOM}", 0.0)
    initial_velocity: Start = about("m/s, likewise", 1.0)
    solver: _Solver | None = about("Tsit5, Dopri5 or Dopri8, for slips of exact motion; not given: closed forms", None)


class MotorCartPointConfig(PointConfig):
    """The same with the initial state of a `MotorCart`; the defaults are the paper's."""

    initial: ClassVar[tuple[str, ...]] = ("initial_angle", "initial_angular_velocity", "initial_current")

    t1: float = about("duration of each sample, s", 2.0, gt=0)
    initial_angle: Start = about(f"rad, {_OR_RANDOM}", UniformConfig(low=0.0, high=2 * math.pi))
    initial_angular_velocity: Start = about("rad/s, likewise", 0.0)
    initial_current: Start = about("A, likewise", 0.0)


class StructurePointConfig(PointConfig):
    """The same with the initial state of a structure."""

    initial_state: list[Start] | None = about(
        f"positions (m), then velocities (m/s), each a number {_OR_RANDOM}; not given: zeros", None
    )
    solver: _Solver | None = about("Tsit5, Dopri5 or Dopri8; not given: power series, or Dopri8", None)

    def y0(self) -> tuple[float | Uniform, ...] | None:
        return None if self.initial_state is None else tuple(map(value_of, self.initial_state))


class MassSpringRunConfig(MassSpringPointConfig, RunConfig):
    """Section ``[run]`` of an ensemble of a `MassSpring`."""


class MotorCartRunConfig(MotorCartPointConfig, RunConfig):
    """Section ``[run]`` of an ensemble of a `MotorCart`."""


class StructureRunConfig(StructurePointConfig, RunConfig):
    """Section ``[run]`` of an ensemble of a structure."""


_Runs = Mapping[str, type[PointConfig]]
"""The section ``[run]`` of each model of a system."""


def _runs(mass_spring: type[PointConfig], motor_cart: type[PointConfig], structure: type[PointConfig]) -> _Runs:
    """Those of the two systems with one contact, and that of all models that are structures."""
    structures = [model for model, kind in kinds_in(SystemConfig).items() if issubclass(kind, StructureSection)]
    return {"MassSpring": mass_spring, "MotorCart": motor_cart, **dict.fromkeys(structures, structure)}


class OutputConfig(Section):
    """Section ``[output]``: where the result goes."""

    directory: str = about("folder, made if missing", "results/study", min_length=1)
    figures: bool = about("whether to draw figures", True)


_USUAL: Any = Field(default_factory=dict, validate_default=True)
"""A section that may be left out: its keys then have their defaults, which depend on the system."""


class FileConfig(Section):
    """What the files of a study and of a sweep share: the system, what drives it, and how it is run.

    The defaults depend on the system: a `MotorCart` is driven by a `SourceVoltage`, for 2 s.
    """

    runs: ClassVar[_Runs]

    system: SystemConfig = MassSpringConfig()
    base: BaseConfig = _USUAL

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
            return cls.runs["MassSpring"]()
        kind = cls.runs[tag_of(type(info.data["system"]))]
        if isinstance(table, RunConfig) and type(table) is RunConfig:
            table = table.model_dump(exclude_unset=True)
        return kind.model_validate(table, context=info.context)

    @model_validator(mode="after")
    def _sections_fit(self) -> "FileConfig":
        law, model = toml_value(tag_of(type(self.base))), tag_of(type(self.system))
        voltage, by_voltage = isinstance(self.base, SourceVoltageConfig), self.system.driven_by_voltage
        if voltage != by_voltage:
            needed = '"SourceVoltage"' if by_voltage else "a motion of the base"
            given = f"{law} was given" + ("" if by_voltage else ", which drives a MotorCart")
            raise ValueError(f"law in [base] must be {needed}, because model in [system] is {model}, but {given}.")
        run: Any = getattr(self, "run", None)
        for key in ("width", "step"):
            value = getattr(run, key, None)
            if self.system.has_inner_states and value is not None:
                raise ValueError(
                    f"{key} in [run] must be left out for friction laws with an inner state, which are smooth by "
                    f"themselves and need adaptive steps, but {value:g} was given."
                )
        solver = getattr(run, "solver", None)
        if solver is not None and (self.system.has_inner_states or run.width is not None):
            raise ValueError(
                "solver in [run] must be left out with a width and for friction laws with an inner state, whose steps "
                f"the package chooses, but {solver} was given."
            )
        if isinstance(self.system, StructureSection) and run is not None:
            size, state = self.system.size, run.initial_state
            if state is not None and len(state) != 2 * size:
                raise ValueError(
                    f"initial_state in [run] must hold {2 * size} numbers, the positions and then the velocities of "
                    f"{size} masses, but {len(state)} were given."
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
    """A whole study of one ensemble. The default is the oscillator of Lima and Sampaio's conference paper, but with
    mu = 0.8 in place of 1, under Poisson switching.
    """

    runs: ClassVar[_Runs] = _runs(MassSpringRunConfig, MotorCartRunConfig, StructureRunConfig)

    run: MassSpringRunConfig | MotorCartRunConfig | StructureRunConfig = _USUAL
    output: OutputConfig = OutputConfig()


# A parameter sweep: the sections of its TOML file.


_RANGES = {"linspace": np.linspace, "logspace": np.geomspace}


class OverConfig(Section):
    """Section ``[sweep.over]``: the swept parameters by name, with their values.

    A name is one as in `stickslip_jax.Sweep`, or that of an initial value in ``[run]``; several with commas between
    them change together.
    """

    model_config = ConfigDict(extra="allow")

    @model_validator(mode="after")
    def _all_have_values(self) -> "OverConfig":
        self.parameter_values()
        return self

    def parameter_values(self) -> dict[tuple[str, ...], np.ndarray]:
        """The values by the names that change together: (points,) of one name, (points, names) of several.

        Raises ValueError for anything else.
        """
        given = self.model_extra or {}
        if not given:
            raise ValueError("a parameter must be given with its values, such as mu = [0.5, 1.0].")
        found = {tuple(part.strip() for part in name.split(",")): _values(name, value) for name, value in given.items()}
        _check_number(math.prod(map(len, found.values())))
        return found


def _check_number(points: int) -> None:
    if points > MOST_POINTS:
        raise ValueError(
            f"its parameters must have at most {MOST_POINTS} combinations, but have "
            f"{points if points < 10**20 else f'about 1e{len(str(points)) - 1}'}; give fewer values."
        )


def _values(name: str, given: object) -> np.ndarray:
    several, width = "," in name, name.count(",") + 1
    if isinstance(given, dict) and not several:
        return _range(name, given)
    if not isinstance(given, list) or not given:
        wanted = "a list, { linspace = ... } or { logspace = ... }"
        wanted = "rows such as [[0.5, 1.0], [1.0, 2.0]]" if several else wanted
        raise refused(name, f"be {wanted}", given)
    for one in given:
        row = one if several else [one]
        if not (isinstance(row, list) and len(row) == width and all(map(is_number, row))):
            wanted = f"rows of {width} finite numbers" if several else "finite numbers"
            raise refused(name, f"hold {wanted}", one)
    return np.array(given, float)


def _range(name: str, given: dict[str, object]) -> np.ndarray:
    """The values of ``{ linspace = [from, to, number] }``, or logspace."""
    (kind, limits), *more = given.items() or [("", None)]
    if kind not in _RANGES or more:
        hint = nearest(kind, ("geomspace", *_RANGES)).replace("geom", "log")
        dotted = "" if hint or not re.fullmatch(r"\w+", kind) else f'; for a name with dots write "{name}.{kind}" = ...'
        raise refused(name, f"be a list, or a table with {one_of(_RANGES)}", given, hint or dotted or ".")
    ends: list[Any] = limits if isinstance(limits, list) and len(limits) == 3 else [None]
    if not all(map(is_number, ends)) or not isinstance(ends[2], int) or ends[2] < 1:
        raise refused(f"{kind} of {name}", "be [from, to, number of values], such as [0.5, 2.0, 8]", limits)
    if kind == "logspace" and min(ends[:2]) <= 0:
        raise refused(f"logspace of {name}", "go from and to positive numbers", limits)
    _check_number(ends[2])  # before there are any values
    return _RANGES[kind](*ends)


class SweepSection(Section):
    """Section ``[sweep]``: what is estimated at each point; the points are in ``[sweep.over]``."""

    keep: Literal["statistics", "totals"] = about(
        "statistics; totals: fewer of them, about three times as fast", "statistics"
    )
    statistics: list[str] | None = about('names, such as ["mean_stick_duration"]; not given: all', None, min_length=1)
    sensitivities: dict[str, list[str]] | None = about(
        'derivatives: { mean_stick_duration = ["mu", "rate"] }; not given: none', None
    )
    independent: bool = about(
        "false: the same random numbers at all points, so that differences have small errors", False
    )
    standard_error: dict[str, float] | None = about(
        "at which a point ends before all samples: { mean_stick_duration = 0.01 }", None
    )
    realizations: int = about("number of samples whose sticks are in the result", 0, ge=0)
    batch: int | None = about("samples stored together; not given: chosen from the size", None, ge=1, le=2**31)
    over: OverConfig = about("the parameters and their values")


class SweepConfig(FileConfig):
    """A whole parameter sweep."""

    runs: ClassVar[_Runs] = _runs(MassSpringPointConfig, MotorCartPointConfig, StructurePointConfig)

    run: MassSpringPointConfig | MotorCartPointConfig | StructurePointConfig = _USUAL
    sweep: SweepSection = _USUAL


# A study's file from the objects that a simulation takes: the way back of `build`.


def config_of(
    system: System,
    law: Any,
    *,
    y0: tuple[Any, ...] | None,
    t1: float,
    samples: int,
    seed: int,
    method: Exact | Regularized = EXACT,
) -> StudyConfig:
    """The description of a study of these objects.

    Raises:
        StudyError: For objects that no section of a study's file describes, such as classes of a user's own; so what
            is described is what was given.
    """
    table = _table(system, kinds_in(SystemConfig))
    run: dict[str, Any] = {"t1": float(t1), "samples": samples, "seed": seed, "dtype": str(jnp.result_type(float))}
    found = {key: _plain(getattr(method, key, None)) for key in ("step", "max_steps", "width", "shape")}
    found["solver"] = None if method.solver is None else type(method.solver).__name__
    run |= {key: value for key, value in found.items() if value is not None}
    if y0 is not None:
        starts = [{"low": float(v.low), "high": float(v.high)} if isinstance(v, Uniform) else _plain(v) for v in y0]
        kind = StudyConfig.runs[table["model"]]
        run |= dict(zip(kind.initial, starts, strict=True)) if kind.initial else {"initial_state": starts}
    base = _table(law, kinds_in(BaseConfig))
    try:
        config = StudyConfig.model_validate({"system": table, "base": base, "run": run})
    except ValidationError as error:
        said = error.errors()[0]
        raise StudyError(f"No study's file can hold this: {said['msg']} ({'.'.join(map(str, said['loc']))}).") from None
    again = config.system.build(), config.base.build(), config.run.method(config.system.has_inner_states)
    for name, one, other in zip(("system", "base", "method"), (system, law, method), again, strict=True):
        if not eqx.tree_equal(jax.tree.map(_plain, one), jax.tree.map(_plain, other)):
            raise StudyError(f"No study's file can hold this {name}, but one that differs; copy it as Python instead.")
    return config


def _table(value: Any, kinds: Mapping[str, type[Section]]) -> Any:
    """The section, number or list that describes `value`. `kinds`: the sections that may stand here, by name."""
    if isinstance(value, RandomPhase):
        table = _table(value.signal, kinds)
        return {key: entry for key, entry in table.items() if key not in ("phase", "phases")} | {"random_phase": True}
    if isinstance(value, (tuple, list)) and kinds:
        return [0.0 if one is None else _table(one, kinds) for one in value]
    if not isinstance(value, eqx.Module):
        return _plain(value)
    name = type(value).__name__
    kind = kinds.get(name)
    own = getattr(kind, "described_class", type(value))
    if kind is None or (own is not type(value) and described(own)):  # others are compared when all is described
        raise StudyError(f"{name} has no section in a study's file; copy it as Python instead.")
    tag = tag_key(kind)
    table: dict[str, Any] = {} if tag is None else {tag: name}
    fields = {field.name for field in dataclasses.fields(value)}
    for key, info in kind.model_fields.items():
        name = FIELDS.get(key, key)
        entry = getattr(value, name) if name in fields else None
        if entry is not None and key != tag:
            table[key] = _table(entry, kinds_in(info.annotation))
    if "random_phase" in kind.model_fields:
        table["random_phase"] = False
    if isinstance(value, LinearStructure):
        table["contact"] = "all" if value.tracks.counted in (None, -1) else value.tracks.counted
    return table


def _plain(value: Any) -> Any:
    """Numbers and lists of them, as TOML holds them."""
    if isinstance(value, (bool, str, int, float)) or value is None:
        return value
    if isinstance(value, (tuple, list)) or np.ndim(value) > 0:
        return [_plain(one) for one in np.asarray(value).tolist()]
    try:
        return float(value)
    except (TypeError, ValueError):
        raise StudyError(f"{type(value).__name__} has no key in a study's file; copy it as Python instead.") from None
