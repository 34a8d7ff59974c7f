"""The joint distribution of two quantities, and of each by itself."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from .. import _checks
from .._statistics.joint import JointDistribution
from .._systems.system import System
from . import _parts, _style
from ._cells import Cells, cells_of_pairs, cells_of_sticks, number_of_bins
from ._legends import legend_above, plain_numbers
from ._stick_positions import finish, placed_sticks
from ._types import JointBins, SeveralAxes, SimulatedSticks, Voltage

_ALSO = ', or a JointDistribution such as ensemble.statistics.joint("duration", "position")'
_MEANS = 20  # bins at most of the conditional mean
_ROOM = 0.6  # of the width of the figure, for the legend above the joint histogram
_LARGEST = 1500  # square points: the area of an atom that holds all pairs


def joint_histogram(
    result: JointDistribution | SimulatedSticks,
    *,
    bins: JointBins = 40,
    log: bool = False,
    conditional_mean: bool = False,
    system: System | None = None,
    bound: Voltage | None = None,
    period: float | None = None,
    axes: Axes | SeveralAxes | None = None,
) -> tuple[Axes, ...]:
    """Draw the joint histogram of two quantities as a probability density, with the histogram of each beside it.

    Points that have a probability of their own (`JointDistribution.atoms`) are circles, whose area is in proportion to
    their share, and are left out of the density, which would depend on the bins. Cells without a pair are white.

    Args:
        result: A joint distribution, such as ``ensemble.statistics.joint("duration", "position")``: all pairs, sticks
            cut by the horizon included with the part seen; the histograms beside it have bars of one standard error.
            Or sticks as in `stick_map`, without those cut by the horizon: position at which they begin, and duration
            (of a `MotorCart`: Lima and Sampaio 2022, figures 4 and 5, right).
        bins: Of a joint distribution, the largest number of bins along each axis, at most 128. Of sticks, the number of
            equal bins each way, or two such numbers or sequences of increasing edges: of position (m, rad), then of
            duration (s). Sticks outside of edges are not drawn but count: density times area stays a share of all.
        log: Whether colours follow the logarithm of the density, to show rare pairs beside frequent ones.
        conditional_mean: Whether to draw the mean ordinate of the retained pairs of a joint distribution in each bin of
            the abscissa (20 bins at most), with bars of one standard error.
        system: With sticks only, as in `stick_map`.
        bound: Likewise.
        period: Likewise.
        axes: Three, of the joint histogram, above and right of it; or one, for it alone. By default those of a figure.

    Returns:
        The axes, with a note in the first if there is nothing to draw.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    _checks.truth("log", log)
    _checks.truth("conditional_mean", conditional_mean)
    if isinstance(result, JointDistribution):
        _refuse_options_of_sticks(system=system, bound=bound, period=period)
        number = number_of_bins(bins)
        cells, panels = cells_of_pairs(result, number), _panels(axes)
        _draw(panels, cells, log)
        _finish_pairs(panels[0], result, cells)
        _draw_atoms(panels[0], result)
        if conditional_mean and not cells.empty:
            _draw_conditional_mean(panels[0], result, min(number, _MEANS))
    else:
        sticks = placed_sticks(result, system, bound, period, also=_ALSO)
        if conditional_mean:
            raise ValueError(
                "Argument conditional_mean must be False for sticks, but True was given; it is drawn of a joint "
                'distribution: ensemble.statistics.joint("position", "duration").'
            )
        cells, panels = cells_of_sticks(sticks, bins), _panels(axes)
        _draw(panels, cells, log)
        finish(panels[0], sticks)
    return _finished(panels, cells)


def _refuse_options_of_sticks(**options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise ValueError(
                f"Argument {name} must be left out with a joint distribution, but {_checks.show(value)} was given; it "
                "goes with the sticks: joint_histogram(ensemble)."
            )


def _panels(axes: Axes | SeveralAxes | None) -> tuple[Axes, ...]:
    """The axes given, one or three, or those of a new figure, in which neighbours share their scales."""
    if axes is None:
        figure = plt.figure(figsize=(6.4, 5.4), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(4, 1), height_ratios=(1, 4))
        main = figure.add_subplot(grid[1, 0])
        above = figure.add_subplot(grid[0, 0], sharex=main)
        right = figure.add_subplot(grid[1, 1], sharey=main)
        above.tick_params(labelbottom=False)
        right.tick_params(labelleft=False)
        return main, above, right
    given = (axes,) if isinstance(axes, Axes) else _style.axes_in(axes)
    if len(given) not in (1, 3):
        raise ValueError(
            "Argument axes must hold three matplotlib Axes (joint histogram, above it, to the right of it), or be one, "
            f"but {_checks.show(axes)} was given."
        )
    return given


def _draw(panels: tuple[Axes, ...], cells: Cells, log: bool) -> None:
    """The density of all cells that hold a pair, the scale of its colours, and the histograms beside it."""
    main, *others = panels
    if not cells.empty:
        norm = LogNorm() if log else Normalize(vmin=0)
        mesh = main.pcolormesh(*cells.edges, cells.density.T, cmap=_style.SHADES, norm=norm, rasterized=True)
        main.plot([], [], ls="none", label=cells.label)
        _style.figure_of(main).colorbar(mesh, ax=list(panels), label=_parts.density_label(*cells.units))
    for axis, (ax, side) in enumerate(zip(others, cells.sides, strict=False)):
        label = _parts.density_label(cells.units[axis]).replace(" density", "\ndensity")
        ax.set(**{"ylabel" if axis == 0 else "xlabel": label})
        if not cells.empty:
            _parts.draw_histogram(ax, cells.edges[axis], *side, _style.STICK, upright=axis == 0)


def _draw_atoms(main: Axes, joint: JointDistribution) -> None:
    """The points that have a probability of their own."""
    atoms = joint.atoms
    if not len(atoms.share):
        return
    number, share = len(atoms.share), f"{100 * atoms.share.sum():.1f} % of the pairs"
    label = f"{number:,} points that {share} lie on" if number > 1 else f"a point that {share} lie on"
    look = {"facecolors": "none", "edgecolors": _style.STICK, "lw": 1.2, "clip_on": False, "zorder": 3}
    main.scatter(atoms.x, atoms.y, s=np.maximum(12, _LARGEST * atoms.share), label=label, **look)


def _finish_pairs(main: Axes, joint: JointDistribution, cells: Cells) -> None:
    """The names of the axes and their limits; with a note where there are no pairs."""
    main.set_xlabel(_parts.quantity_label(joint.labels[0], joint.units[0]))
    main.set_ylabel(_parts.quantity_label(joint.labels[1], joint.units[1]))
    if cells.empty:
        _parts.note(main, cells.label)
    else:
        main.set_xlim(cells.edges[0][0], cells.edges[0][-1])
        main.set_ylim(cells.edges[1][0], cells.edges[1][-1])


def _finished(panels: tuple[Axes, ...], cells: Cells) -> tuple[Axes, ...]:
    """The `panels` with a legend, and with the limits of the histograms beside the first."""
    main, *others = panels
    if others and not cells.empty:
        above, right = others
        above.set_xlim(main.get_xlim())
        right.set_ylim(main.get_ylim())
        above.set_ylim(bottom=0)
        right.set_xlim(left=0)
    legend_above(*others[:1], main, columns=1, room=_ROOM if others else None)
    for ax in others[1:]:
        plain_numbers(ax.xaxis)
    return panels


def _draw_conditional_mean(main: Axes, joint: JointDistribution, bins: int) -> None:
    """The mean of the ordinate in each bin of the abscissa that holds a pair."""
    means = joint.conditional_mean(bins)
    known = means.counts > 0
    centers = ((means.edges[1:] + means.edges[:-1]) / 2)[known]
    label = f"mean {joint.labels[1]} given the {joint.labels[0]}"
    main.errorbar(
        centers, means.mean[known], np.nan_to_num(means.error[known]), marker="o", ms=3, lw=_style.SLIP_WIDTH,
        label=label,
        **_parts.ERROR_LOOK,
    )  # fmt: skip
