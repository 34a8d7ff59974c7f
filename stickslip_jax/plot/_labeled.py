"""What figures read from labelled arrays of xarray: values, their standard errors, coordinates, names and units."""

import sys
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

import numpy as np

from .. import _checks
from . import _parts
from ._types import LabeledData

if TYPE_CHECKING:
    import xarray


class Labeled(NamedTuple):
    """A labelled array, ready to draw, with coordinates that increase.

    - `values`, `errors` (standard errors, or None), both with a dimension for each of `coordinates`.
    - `axis_labels`: of the coordinates, with units. `label`: of the values. `units`: of the coordinates.
    """

    values: np.ndarray
    errors: np.ndarray | None
    coordinates: tuple[np.ndarray, ...]
    axis_labels: tuple[str, ...]
    label: str
    units: tuple[str, ...]


def is_labeled(value: object) -> TypeGuard[LabeledData]:
    """Whether `value` is a DataArray or Dataset of xarray, which need not be installed."""
    xarray = sys.modules.get("xarray")
    return xarray is not None and isinstance(value, (xarray.DataArray, xarray.Dataset))


def labeled(
    data: LabeledData, name: object, errors: object, dimensions: tuple[int, ...], along: str | None = None
) -> Labeled:
    """Read a DataArray, or the variable `name` of a Dataset.

    - `errors`: its standard errors, an array of its shape; of a Dataset the name of a variable, by default that named
      by the attribute ``ancillary_variables`` of the values, or by their name and ``_error`` or ``_standard_error``.
    - `dimensions`: how many it may have. `along`: which is to be the first.

    Raises ValueError for anything else.
    """
    values, errors = _variables(data, name, errors)
    if values.ndim not in dimensions:
        allowed = " or ".join(map(str, dimensions))
        raise ValueError(
            f"Argument x must have {allowed} dimensions, but an array with {values.ndim} was given "
            f"({', '.join(map(str, values.dims)) or 'none'}); choose values of the others with .sel(...)."
        )
    if along is not None:
        if along not in values.dims:
            raise ValueError(
                f"Argument along must be one of the dimensions {', '.join(map(str, values.dims))}, but "
                f"{_checks.show(along)} was given."
            )
        values = values.transpose(along, ...)
    coordinates = [values[dimension] for dimension in values.dims]
    for one in coordinates:
        if one.dtype.kind not in "iuf":
            raise ValueError(f"Argument x must have numbers as coordinates, but {one.name} holds {_checks.show(one)}.")
    if errors is not None:
        errors = np.asarray(errors.transpose(*values.dims) if is_labeled(errors) else errors, float)
    order = [np.argsort(np.asarray(one), kind="stable") for one in coordinates]
    array = np.asarray(values, float)
    return Labeled(
        array[np.ix_(*order)],
        errors[np.ix_(*order)] if errors is not None and errors.shape == array.shape else errors,
        tuple(np.asarray(one, float)[place] for one, place in zip(coordinates, order, strict=True)),
        tuple(map(_label, coordinates)),
        _label(values),
        tuple(map(_unit, coordinates)),
    )


def _variables(data: Any, name: object, errors: object) -> "tuple[xarray.DataArray, object]":
    """The array of values, and that of errors or None."""
    if not hasattr(data, "data_vars"):
        if name is not None:
            raise ValueError(
                f"Argument y must be left out with a DataArray, but {_checks.show(name)} was given; of a Dataset it is "
                "the name of a variable."
            )
        return data, errors
    if not (isinstance(name, str) and name in data.data_vars):
        raise ValueError(
            f"Argument y must be the name of a variable of the Dataset, one of {', '.join(map(str, data.data_vars))}, "
            f"but {_checks.show(name)} was given."
        )
    if errors is None:
        named = str(data[name].attrs.get("ancillary_variables", "")).split()
        errors = next((one for one in (*named, f"{name}_error", f"{name}_standard_error") if one in data), None)
    elif isinstance(errors, str) and errors not in data:
        raise ValueError(f"Argument errors must be the name of a variable of the Dataset, but {errors!r} was given.")
    return data[name], data[errors] if isinstance(errors, str) else errors


def _unit(one: "xarray.DataArray") -> str:
    return str(one.attrs.get("units", "")) or "1"


def _label(one: "xarray.DataArray") -> str:
    name = one.attrs.get("long_name", one.name)
    return _parts.quantity_label("" if name is None else str(name), _unit(one))
