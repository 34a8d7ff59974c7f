"""Results over cases as labelled arrays: the grid of parameters, then the starts."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from .._conventions import Entries, flags, labeled_dataset, variable
from .._simulation.labeled import provenance, source
from .._status import Status
from .._sweep.setting import label_and_unit
from ._cases import Cases

if TYPE_CHECKING:
    import xarray

START, CYCLE = "start", "cycle"


def dimensions_of(cases: Cases) -> tuple[str, ...]:
    """Names of the dimensions of the cases."""
    own = () if cases.points is None else tuple(one.name for one in cases.points.dimensions)
    return own + ((START,) if len(cases.shape) > len(own) else ())


def names_of(cases: Cases) -> tuple[str, ...]:
    """Names of variables for the numbers of the state."""
    return tuple(coordinate.variable for coordinate in cases.system.coordinates)


def states_of(cases: Cases, states: np.ndarray, more: tuple[str, ...], where: str) -> Entries:
    """A variable for each number of the `states`, (cases, ..., coordinates), with the dimensions `more`."""
    found = {}
    for number, (name, coordinate) in enumerate(zip(names_of(cases), cases.system.coordinates, strict=True)):
        column = states[..., number]
        if coordinate.period is not None:
            column = np.mod(column, coordinate.period)
        found[name] = on_grid(cases, column, f"{coordinate.name} {where}", coordinate.unit, more)
    return found


def on_grid(
    cases: Cases, values: Any, long_name: str, unit: str = "1", more: tuple[str, ...] = (), **attributes: object
) -> tuple[Any, ...]:
    """A variable whose `values`, (cases, ...), are put on the grid of the cases."""
    values = np.asarray(values)
    grid = values.reshape((*cases.shape, *values.shape[1:]))
    return variable((*dimensions_of(cases), *more), grid, long_name, unit, **attributes)


def outcome_of(cases: Cases, status: np.ndarray, near_grazing_count: np.ndarray) -> Entries:
    """Whether each case was followed to the end, and how often round-off decided about an event."""
    return {
        "status": on_grid(cases, status.astype(np.int8), "whether the case was followed to the end", **flags(Status)),
        "near_grazing_count": on_grid(cases, near_grazing_count, "number of events decided by round-off"),
    }


def dataset_of(cases: Cases, variables: Entries, coordinates: Entries | None = None) -> "xarray.Dataset":
    """The data set of `variables` over the cases, with the values of parameters and the starts as coordinates.

    Raises:
        ImportError: Without the extra ``study``.
    """
    setting = cases.setter.setting
    found: Entries = {}
    for one in () if cases.points is None else cases.points.dimensions:
        for number, name in enumerate(one.parameters):
            label, unit = label_and_unit(setting, name)
            found[name] = variable(one.name, one.values[:, number], label, unit)
    if dimensions_of(cases)[-1:] == (START,):
        starts = cases.starts[: cases.shape[-1]]
        for number, (name, coordinate) in enumerate(zip(names_of(cases), cases.system.coordinates, strict=True)):
            found[f"initial_{name}"] = variable(START, starts[:, number], f"initial {coordinate.name}", coordinate.unit)
    about = {**source(), **provenance(cases.system, setting.law, setting.method)}
    return labeled_dataset(apart(variables, found), {**found, **(coordinates or {})}, about)


def apart(variables: Entries, parameters: Iterable[str]) -> Entries:
    """`variables`, with an underscore after the name of each that is called as a parameter is: "period_"."""
    taken = set(parameters)
    return {f"{name}_" if name in taken else name: entry for name, entry in variables.items()}
