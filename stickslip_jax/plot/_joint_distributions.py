"""How two quantities are distributed together, and each by itself."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from .. import _checks
from .._statistics.clusters import Clusters
from .._statistics.joint import JointDistribution, JointHistogram
from . import _parts, _style

_MEANS = 20  # bins at most of the conditional mean


def joint_histogram(
    joint: JointDistribution,
    axes: Any = None,
    *,
    bins: int = 40,
    log: bool = False,
    conditional_mean: bool = False,
) -> tuple[Axes, Axes, Axes]:
    """Draw the joint histogram of two quantities as a probability density, with the histogram of each beside it.

    Of every pair, sticks cut by the horizon included with the part seen; white where no pair fell. The histograms at
    the sides have bars of one standard error. `stick_joint_histogram` draws position and duration of the complete
    sticks of an ensemble that kept them, angles modulo a turn, under the bound of their durations.

    - `joint`: such as ``ensemble.statistics.joint("duration", "position")``.
    - `axes`: three axes, of the joint histogram, above it and to the right of it; by default those of a new figure.
    - `bins`: number of bins of equal width along each axis at most, which hold all pairs.
    - `log`: whether colours follow the logarithm of the density, to show rare pairs beside frequent ones.
    - `conditional_mean`: whether to draw the mean of the ordinate for each bin of the abscissa (20 bins at most), with
      bars of one standard error, from the pairs retained.

    Returns the three axes, with a note in the first if there are no pairs. Raises ValueError for arguments of another
    kind and for more than 128 bins.
    """
    _parts.require("joint", joint, JointDistribution, 'ensemble.statistics.joint("duration", "position"), say')
    for name, value in (("log", log), ("conditional_mean", conditional_mean)):
        if not isinstance(value, bool):
            raise ValueError(f"Argument {name} must be True or False, but {_checks.show(value)} was given.")
    drawn = joint.histogram(bins)
    main, above, right = _three_axes(axes)
    main.set_xlabel(_parts.quantity_label(joint.labels[0], joint.units[0]))
    main.set_ylabel(_parts.quantity_label(joint.labels[1], joint.units[1]))
    above.set_ylabel(_parts.density_label(joint.units[0]).replace(" density", "\ndensity"))
    right.set_xlabel(_parts.density_label(joint.units[1]).replace(" density", "\ndensity"))
    if drawn.number == 0:
        _parts.note(main, "no pairs")
        return main, above, right
    _draw_density(main, (main, above, right), drawn, log)
    color = _parts.color_of("stick")
    for side, axis, clusters in ((above, 0, joint.x), (right, 1, joint.y)):
        edges = (drawn.x_edges, drawn.y_edges)[axis]
        shares, errors = _marginal(drawn, axis, edges, clusters)
        _parts.draw_histogram(side, edges, shares, errors, color, upright=axis == 0)
    if conditional_mean:
        _draw_conditional_mean(main, joint, bins)
    for ax in (main, above):
        ax.set_xlim(drawn.x_edges[0], drawn.x_edges[-1])
    for ax in (main, right):
        ax.set_ylim(drawn.y_edges[0], drawn.y_edges[-1])
    above.set_ylim(bottom=0)
    right.set_xlim(left=0)
    _style.legend_above(above, main, columns=1)
    return main, above, right


def _three_axes(axes: Any) -> tuple[Axes, Axes, Axes]:
    """The axes given, or those of a new figure, in which neighbours share their scales."""
    if axes is None:
        figure = plt.figure(figsize=(6.4, 5.4), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(4, 1), height_ratios=(1, 4))
        main = figure.add_subplot(grid[1, 0])
        above = figure.add_subplot(grid[0, 0], sharex=main)
        right = figure.add_subplot(grid[1, 1], sharey=main)
        above.tick_params(labelbottom=False)
        right.tick_params(labelleft=False)
        return main, above, right
    given = list(axes) if isinstance(axes, (tuple, list, np.ndarray)) else []
    if len(given) != 3 or not all(isinstance(one, Axes) for one in given):
        raise ValueError(
            "Argument axes must hold three matplotlib Axes (joint histogram, above it, to the right of it), but "
            f"{_checks.show(axes)} was given."
        )
    return given[0], given[1], given[2]


def _draw_density(main: Axes, axes: tuple[Axes, ...], drawn: JointHistogram, log: bool) -> None:
    """The density of all cells that hold a pair, and the scale of its colours."""
    norm = LogNorm() if log else Normalize(vmin=0)
    density = np.ma.masked_where(drawn.counts == 0, drawn.density)
    mesh = main.pcolormesh(drawn.x_edges, drawn.y_edges, density.T, cmap="viridis_r", norm=norm, rasterized=True)
    main.plot([], [], ls="none", marker="s", color=mesh.cmap(0.5), label=_parts.counted(drawn.number, "pair"))
    figure = main.get_figure(root=True)
    assert figure is not None
    figure.colorbar(mesh, ax=list(axes), label=_parts.density_label(*drawn.units))


def _marginal(drawn: JointHistogram, axis: int, edges: np.ndarray, own: Clusters) -> tuple[np.ndarray, np.ndarray]:
    """Density of one of the two quantities in its bins, and its standard error."""
    width = np.diff(edges)
    share = drawn.counts.sum(axis=1 - axis) / drawn.number
    place = np.searchsorted(edges, own.values, side="right") - 1
    return share / width, own.errors_of_shares(place, len(width)) / width


def _draw_conditional_mean(main: Axes, joint: JointDistribution, bins: int) -> None:
    """The mean of the ordinate in each bin of the abscissa that holds a pair."""
    means = joint.conditional_mean(min(bins, _MEANS))
    known = means.counts > 0
    centres = ((means.edges[1:] + means.edges[:-1]) / 2)[known]
    label = f"mean {joint.labels[1]} given the {joint.labels[0]}"
    main.errorbar(
        centres, means.mean[known], np.nan_to_num(means.error[known]), marker="o", ms=3, lw=_style.SLIP_WIDTH,
        label=label,
        **_parts.ERROR_LOOK,
    )  # fmt: skip
