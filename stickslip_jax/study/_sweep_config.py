"""A parameter sweep: the sections of its TOML file."""

import math
import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from .._checks import LARGEST, one_of
from .._sweep.points import MOST_POINTS
from ._config import (
    STRUCTURES,
    FileConfig,
    MassSpringPointConfig,
    MotorCartPointConfig,
    PointConfig,
    StructurePointConfig,
)
from ._sections import Section, shown_value
from ._systems_config import MassSpringConfig, MotorCartConfig

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
    several = "," in name
    if isinstance(given, dict) and not several:
        return _range(name, given)
    if not isinstance(given, list) or not given:
        wanted = (
            "rows such as [[0.5, 1.0], [1.0, 2.0]]" if several else "a list, { linspace = ... } or { logspace = ... }"
        )
        raise ValueError(f"{name} must be {wanted}, but {shown_value(given)} was given.")
    rows = given if several else [[one] for one in given]
    width = name.count(",") + 1
    for row in rows:
        if not (isinstance(row, list) and len(row) == width and all(map(_is_number, row))):
            wanted = f"rows of {width} numbers" if several else "numbers"
            raise ValueError(f"{name} must hold {wanted}, but {shown_value(row if several else row[0])} was given.")
    return np.array(rows if several else given, float)


def _range(name: str, given: dict[str, object]) -> np.ndarray:
    """The values of ``{ linspace = [from, to, number] }``, or logspace."""
    (kind, limits), *more = given.items() or [("", None)]
    if kind not in _RANGES or more:
        near = get_close_matches(kind, {"geomspace": "", **_RANGES}, n=1)
        hint = f"; did you mean {near[0].replace('geom', 'log')}?" if near else ""
        dotted = "" if hint or not re.fullmatch(r"\w+", kind) else f'; for a name with dots write "{name}.{kind}" = ...'
        raise ValueError(
            f"{name} must be a list, or a table with {one_of(_RANGES)}, but {shown_value(given)} was given"
            f"{hint or dotted or '.'}"
        )
    ends = limits if isinstance(limits, list) else []
    if (
        len(ends) != 3
        or not all(_is_number(end) and abs(end) <= LARGEST for end in ends)
        or not isinstance(ends[2], int)
        or ends[2] < 1
    ):
        raise ValueError(
            f"{kind} of {name} must be [from, to, number of values], such as [0.5, 2.0, 8], but {shown_value(limits)} "
            "was given."
        )
    if kind == "logspace" and min(ends[:2]) <= 0:
        raise ValueError(
            f"logspace of {name} must go from and to positive numbers, but {shown_value(limits)} was given."
        )
    _check_number(ends[2])  # before there are any values
    return _RANGES[kind](*ends)


def _is_number(value: object) -> bool:
    """Whether it is a number; whole ones of a size that can be computed with."""
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and (isinstance(value, float) or abs(value) <= LARGEST)
    )


class SweepSection(Section):
    """Section ``[sweep]``: what is estimated at each point; the points are in ``[sweep.over]``."""

    keep: Literal["statistics", "totals"] = Field(
        default="statistics", description="statistics; totals: fewer of them, about three times as fast"
    )
    statistics: list[str] | None = Field(
        default=None, min_length=1, description='names, such as ["mean_stick_duration"]; not given: all'
    )
    sensitivities: dict[str, list[str]] | None = Field(
        default=None, description='derivatives: { mean_stick_duration = ["mu", "rate"] }; not given: none'
    )
    independent: bool = Field(
        default=False, description="false: the same random numbers at all points, so that differences have small errors"
    )
    standard_error: dict[str, float] | None = Field(
        default=None, description="at which a point ends before all samples: { mean_stick_duration = 0.01 }"
    )
    realizations: int = Field(default=0, ge=0, description="number of samples whose sticks are in the result")
    batch: int | None = Field(
        default=None, ge=1, le=2**31, description="samples stored together; not given: chosen from the size"
    )
    over: OverConfig = Field(description="the parameters and their values")


class SweepConfig(FileConfig):
    """A whole parameter sweep."""

    runs: ClassVar[Mapping[type[Section], type[PointConfig]]] = {
        MassSpringConfig: MassSpringPointConfig,
        MotorCartConfig: MotorCartPointConfig,
        **dict.fromkeys(STRUCTURES, StructurePointConfig),
    }

    run: MassSpringPointConfig | MotorCartPointConfig | StructurePointConfig = Field(
        default_factory=dict, validate_default=True
    )
    sweep: SweepSection = Field(default_factory=dict, validate_default=True)
