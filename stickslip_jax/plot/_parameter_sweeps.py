"""The statistics of a parameter sweep: curves, or maps."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._statistics.estimate import DEFAULT_LEVEL
from .._sweep.dataset import shown_statistics
from . import _parts, _style
from ._curves import curve
from ._labeled import is_labeled
from ._parameter_maps import parameter_map
from ._types import SeveralAxes

if TYPE_CHECKING:
    import xarray

_MOST_CURVES = 4  # of several values of a parameter; more make a map
_PANEL = (5.6, 4.2)  # inches


def parameter_sweep(
    results: "xarray.Dataset",
    names: Sequence[str] | None = None,
    *,
    level: float | None = DEFAULT_LEVEL,
    axes: SeveralAxes | None = None,
) -> tuple[Axes, ...]:
    """Draw statistics of a parameter sweep, each in axes of its own.

    Along one parameter a curve with error bars; along two, of which one has at most four values, curves with bands;
    else a map. Parameters that are spaced geometrically have logarithmic axes. Points that are not there yet are gaps.

    Args:
        results: As `Sweep.run` returns it, with one or two dimensions of points; ``results.isel(...)`` chooses of more.
        names: Of the variables to draw, such as ``["mean_stick_duration"]``; by default those that ``stickslip show``
            prints: the statistics of totals, and derivatives.
        level: Of the confidence intervals, as in `curve`.
        axes: Where to draw, one for each name; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For results of other dimensions, and for names that are not in them.
    """
    if not is_labeled(results) or not hasattr(results, "data_vars"):
        raise ValueError(f"Argument results must be a Dataset of a Sweep, but {_checks.show(results)} was given.")
    if names is None:
        dataset: Any = results
        names = shown_statistics(dataset) if "samples" in dataset else ()
    if not isinstance(names, (list, tuple)) or not names or not all(name in results for name in names):
        known = ", ".join(map(str, results.data_vars))
        raise ValueError(
            f"Argument names must be a list of variables of the results, some of {known}, but {_checks.show(names)} "
            "was given."
        )
    found = _new_axes(len(names)) if axes is None else _style.axes_below_or_new(axes, tuple(names), _PANEL)
    for ax, name in zip(found, names, strict=True):
        _draw(ax, results, name, level)
    return tuple(found)


def _new_axes(number: int) -> list[Axes]:
    columns = 1 if number == 1 else 2
    rows = math.ceil(number / columns)
    size = (columns * _PANEL[0], rows * _PANEL[1])
    _, axes = plt.subplots(rows, columns, squeeze=False, figsize=size, layout="constrained")
    found = list(axes.flat)
    for spare in found[number:]:
        spare.remove()
    return found[:number]


def _draw(ax: Axes, results: Any, name: str, level: float | None) -> None:
    dimensions = [str(one) for one in results[name].dims]
    if len(dimensions) not in (1, 2):
        raise ValueError(
            f"Argument results must have one or two dimensions of points, but {name} has {len(dimensions)} "
            f"({', '.join(dimensions) or 'none'}); choose of the others with results.isel(...)."
        )
    logs = {one: _is_geometric(np.asarray(results[one])) for one in dimensions}
    few = min(dimensions, key=lambda one: results.sizes[one])
    if len(dimensions) == 2 and results.sizes[few] > _MOST_CURVES:
        errors = np.asarray(results.get(f"{name}_error", np.nan))
        # A single sample of each point has no errors at all, which needs no mark.
        data, variable = (results[name], None) if np.all(np.isnan(errors)) else (results, name)
        values = results[name]
        label = _parts.quantity_label(str(values.attrs.get("long_name", name)), values.attrs.get("units") or "1")
        # Lines between cells of which many are not there yet would be scraps.
        complete = not np.any(np.isnan(np.asarray(values)))
        xlog, ylog = (logs[one] for one in dimensions)
        parameter_map(data, variable, xlog=xlog, ylog=ylog, label=label, contours=complete, ax=ax)
    else:
        along = next((one for one in dimensions if one != few), few)
        bands = "bars" if len(dimensions) == 1 else "band"
        curve(results, name, along=along, xlog=logs[along], uncertainty=bands, level=level, ax=ax)


def _is_geometric(values: np.ndarray) -> bool:
    """Whether neighbouring values have the same ratio, and not the same difference."""
    if len(values) < 3 or values.dtype.kind != "f" or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * np.abs(ratios).max() and np.ptp(steps) > 1e-6 * np.abs(steps).max())
