"""Basins of attraction."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap

from .. import _checks
from . import _parts, _style
from ._labeled import is_labeled
from ._legends import legend_above

if TYPE_CHECKING:
    import xarray

_COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
_NONE = "#FFFFFF"


def basins(results: "xarray.Dataset", *, ax: Axes | None = None) -> Axes:
    """Draw which starts end on which attractor, and the attractors.

    Args:
        results: Of `nonlinear.basins`: on a grid of two coordinates, or starts of a system with two.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes. Basins beyond the eighth share a colour; starts on no attractor are white.

    Raises:
        ValueError: For results of another kind.
    """
    if not is_labeled(results) or "basin" not in getattr(results, "data_vars", {}):
        raise ValueError(f"Argument results must be a Dataset of basins, but {_checks.show(results)} was given.")
    basin = results["basin"]
    ax = _style.axes_or_new(ax, (5.6, 4.6))
    number = results.sizes["attractor"]
    shown = min(number, len(_COLORS))
    colors = ListedColormap([_NONE, *_COLORS[:shown]])
    norm = BoundaryNorm(np.arange(-0.5, shown + 1), shown + 1)
    labels = np.minimum(np.asarray(basin), shown)
    x, y = _axes_of(results, basin)
    if basin.ndim == 2:
        ax.pcolormesh(np.asarray(results[x]), np.asarray(results[y]), labels.T, cmap=colors, norm=norm, rasterized=True)
        names = x, y
    else:
        ax.scatter(results[x], results[y], c=labels, cmap=colors, norm=norm, s=6, lw=0, rasterized=True)
        names = x.removeprefix("initial_"), y.removeprefix("initial_")
    for row in range(shown):
        points = [np.asarray(results[f"attractor_{name}"])[row] for name in names if f"attractor_{name}" in results]
        if len(points) == 2 and not bool(results["is_stuck"][row]):
            ax.plot(*points, ls="none", marker=".", ms=2.5, color="black", zorder=3)
    ax.set_xlabel(_parts.label_of(results[x]))
    ax.set_ylabel(_parts.label_of(results[y]))
    shares = np.asarray(results["share"])
    for row in range(shown):
        ax.fill([], [], color=_COLORS[row], label=f"attractor {row + 1}: {shares[row]:.1%}")
    ax.plot([], [], ls="none", marker=".", color="black", label="points of attractors")
    legend_above(ax)
    return ax


def _axes_of(results: Any, basin: Any) -> tuple[str, str]:
    names = [str(one) for one in basin.dims]
    if basin.ndim == 1:
        names = [str(one) for one in results.coords if str(one).startswith("initial_")]
    if len(names) != 2:
        raise ValueError(
            "Argument results must have starts in two coordinates, but those given differ in "
            f"{', '.join(names) or 'none'}; choose of the others with results.isel(...)."
        )
    return names[0], names[1]
