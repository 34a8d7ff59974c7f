"""What all figures share: types of arguments, colours, axes, names, legends, and the file a figure is saved in."""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, TypeAlias

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis, YAxis
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.collections import PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, ScalarFormatter

from .._dynamics.simulation import Simulation
from .._ensemble.ensemble import Ensemble
from .._excitation.motion import RandomPhase, SourceVoltage
from .._foundation import checks
from .._foundation.files import file_for_user, file_to_write
from .._foundation.types import AnyArray, Status
from .._statistics.estimate import Estimate, check_level
from .._statistics.quantities import FirstSticks

# What the figures take, as names for annotations.


if TYPE_CHECKING:
    import xarray

    LabeledData: TypeAlias = xarray.DataArray | xarray.Dataset
else:  # it is an extra
    LabeledData = Any

SimulatedSticks: TypeAlias = Ensemble | FirstSticks | Simulation
"""Results that hold sticks one by one: an ensemble, the first sticks of its samples, one simulation or a batch."""

SeveralAxes: TypeAlias = Sequence[Axes] | np.ndarray
"""As many axes as a figure has panels."""

Numbers: TypeAlias = AnyArray | Sequence[float | int]
"""One-dimensional real numbers."""

Bins: TypeAlias = int | np.integer | Numbers
"""How many bins of equal width, or their increasing edges."""

JointBins: TypeAlias = int | np.integer | tuple[Bins, Bins] | list[Bins]
"""Bins along each of two axes: one number for both, or two `Bins`."""

Window: TypeAlias = tuple[float | int, float | int]
"""First and last time to draw, s."""

Voltage: TypeAlias = SourceVoltage | RandomPhase
"""A voltage whose bound of stick durations is known in closed form."""


# What all figures share: colours, new axes, their scales.
#
# The colours are those of Okabe and Ito ("Color universal design", 2008), which colour-blind readers can distinguish.


STICK = "#D55E00"
"""The colour of sticks in every figure, and of nothing else."""
MASS = "#000000"
BASE = "#0072B2"
FORWARD = "#999999"
BACKWARD = "#000000"
AT_REST = "#56B4E9"
EITHER_WAY = "#CC79A7"
BAND = "#999999"
FED = "#009E73"
SERIES = ("#0072B2", "#009E73", "#CC79A7", "#000000", "#E69F00")

LINES = ("-", "--", "-.", ":")

SHADES = LinearSegmentedColormap.from_list("shades", mpl.colormaps["YlGnBu"](np.linspace(0.22, 1.0, 256)))
"""Colours of values in maps, the darker the larger. None is white, which stands for nothing."""

STICK_WIDTH = 3.2
SLIP_WIDTH = 1.2

MASS_LINE = {"color": MASS, "lw": SLIP_WIDTH}
BASE_LINE = {"color": BASE, "lw": SLIP_WIDTH, "ls": "--"}
STICK_LINE = {"color": STICK, "lw": STICK_WIDTH, "solid_capstyle": "butt"}
REFERENCE = {"color": MASS, "lw": SLIP_WIDTH, "ls": "--"}
"""How a value looks that curves are compared with."""


def axes_or_new(ax: Axes | None, size: tuple[float, float]) -> Axes:
    """`ax` itself, or the axes of a new figure of `size` (inches). Raises ValueError if `ax` is no matplotlib Axes."""
    if ax is None:
        _, ax = plt.subplots(figsize=size, layout="constrained")
    if not isinstance(ax, Axes):
        raise checks.refused("ax", "be a matplotlib Axes", ax)
    return ax


def next_look(ax: Axes, points: np.ndarray) -> dict[str, Any]:
    """How the next curve in `ax` looks, through these points: a colour and line style that no curve in it has yet."""
    taken = {(to_rgba(line.get_color()), line.get_linestyle()) for line in ax.lines}
    # Neighbours differ in both, for prints without colours.
    looks = [(SERIES[number % len(SERIES)], LINES[number % len(LINES)]) for number in range(len(SERIES) * len(LINES))]
    color, style = next((look for look in looks if (to_rgba(look[0]), look[1]) not in taken), looks[0])
    # So many markers would merge.
    marker = "o" if len(points) <= 60 else None
    return {"color": color, "ls": style, "lw": SLIP_WIDTH, "marker": marker, "ms": 3.5}


def shade_between(
    ax: Axes, x: np.ndarray, low: np.ndarray, high: np.ndarray, color: str, label: str | None = None,
    where: np.ndarray | None = None,
) -> None:  # fmt: skip
    """Draw the band of errors of a curve."""
    ax.fill_between(x, low, high, where=where, color=color, alpha=0.25, lw=0, label=label)


def time_axis(ax: Axes, window: Window, t1: float | None = None) -> None:
    """Limit the abscissa of `ax` to the `window` of time, and name it unless axes below have the name.

    `t1`: the end of the motion (s), where its beginning was chosen for the user; the name says so.
    """
    ax.set_xlim(window)
    if ax.xaxis.get_tick_params().get("labelbottom", True):
        part = "" if t1 is None or window[1] == t1 else f": the first {window[1]:g} s of {t1:g} s"
        ax.set_xlabel(f"time $t$ (s){part}")


def mark_unfinished(ax: Axes, one: Simulation) -> None:
    """Say in `ax` where a motion stopped that did not reach ``t1``; nothing of one that did."""
    if one.status != Status.FINISHED:
        text = f"NOT FINISHED: stopped at {float(one.time_reached):.4g} of {float(one.t1):g} s"
        box = {"boxstyle": "round", "facecolor": "white", "edgecolor": MASS, "alpha": 0.8}
        ax.text(0.98, 0.95, text, transform=ax.transAxes, ha="right", va="top", bbox=box, zorder=9, fontsize="small")


def log_axis(axis: XAxis | YAxis) -> None:
    """Make an axis logarithmic, with plain numbers at its ticks, as many as its limits leave room for."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    low, high = axis.get_view_interval()
    decades = math.log10(high / low)
    if decades > 5:
        return  # powers of ten
    if decades < 0.7:  # multiples of powers of ten would stand close at one end and leave the other empty
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    else:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 2.5 else (1,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(LogLocator(subs=tuple(range(1, 10))))
    axis.set_minor_formatter(NullFormatter())


def figure_of(ax: Axes) -> Figure:
    """The figure that holds `ax`, whatever subfigures there are between them."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    return figure


def axes_in(axes: Axes | SeveralAxes | None) -> tuple[Axes, ...]:
    """The matplotlib Axes that `axes` is or holds, none of them if anything else is among them."""
    if isinstance(axes, Axes):
        return (axes,)
    found = axes.tolist() if isinstance(axes, np.ndarray) else axes
    return tuple(found) if isinstance(found, Sequence) and all(isinstance(one, Axes) for one in found) else ()


def axes_below_or_new(axes: SeveralAxes | None, names: tuple[str, ...], size: tuple[float, float]) -> tuple[Axes, ...]:
    """The axes given, one for each of `names`; by default those of a new figure, one below the other.

    `size` of the figure in inches.

    Raises:
        ValueError: If `axes` does not hold as many matplotlib Axes.
    """
    if axes is None:
        figure, axes = plt.subplots(len(names), 1, sharex=True, squeeze=False, figsize=size, layout="constrained")
        axes = axes[:, 0]
        figure.align_ylabels(axes)
    found = () if isinstance(axes, Axes) else axes_in(axes)
    if len(found) != len(names):
        number = {1: "one", 2: "two", 3: "three"}.get(len(names), len(names))
        raise checks.refused("axes", f"hold {number} matplotlib Axes ({', '.join(names)})", axes)
    return found


def angle_axis(ax: Axes, period: float) -> str:
    """Make the abscissa one `period`, with ticks at its quarters; pi and 2 pi by name. Returns the period's name."""
    ticks = [quarter * period / 4 for quarter in range(5)]
    if np.isclose(period, 2 * np.pi, rtol=1e-6):
        names = ("0", r"$\pi/2$", r"$\pi$", r"$3\pi/2$", r"$2\pi$")
    elif np.isclose(period, np.pi, rtol=1e-6):
        names = ("0", r"$\pi/4$", r"$\pi/2$", r"$3\pi/4$", r"$\pi$")
    else:
        names = tuple(f"{tick:g}" for tick in ticks)
    ax.set_xlim(0, period)
    ax.set_xticks(ticks, names)
    return names[-1]


# What the figures of statistics share: names of axes, notes in empty axes, outlines of histograms, rectangles.


ERROR_LOOK = {"color": MASS, "elinewidth": 0.9, "capsize": 0}
"""How error bars look."""

MANY = 2000
"""More points are smaller and paler, and like more bars an image in vector formats."""

Dots: TypeAlias = tuple[float, float]
"""Area (square points) and opacity of points."""


def numbers_or_gaps(name: str, given: object, ndim: int) -> np.ndarray:
    """The argument `name` as an array of `ndim` dimensions, in which NaN is a gap. Raises ValueError for others."""
    finite = given
    with suppress(TypeError, ValueError):
        finite = np.nan_to_num(np.asarray(given, float), nan=0.0, posinf=np.inf, neginf=-np.inf)
    checks.numeric(name, finite, ndim=ndim)
    return np.asarray(given, float)


def checked_errors(errors: object, values: np.ndarray) -> np.ndarray:
    """Standard errors of the `values`, NaN where not known. Raises ValueError for others."""
    array = numbers_or_gaps("errors", errors, values.ndim)
    if array.shape != values.shape or np.any(array < 0):
        raise ValueError(
            f"Argument errors must hold numbers of zero or more in the shape {values.shape} of the values, but an "
            f"array of shape {array.shape} with smallest entry {np.nanmin(array, initial=np.inf):g} was given."
        )
    return array


def errors_in_half(level: float) -> float:
    """Half the width of a confidence interval by the normal distribution, in standard errors."""
    check_level(level)
    from scipy import special  # noqa: PLC0415 - adds a filter of warnings

    return float(special.ndtri((1 + level) / 2))


def interval_name(level: float) -> str:
    """The name of confidence intervals at `level` in legends."""
    return f"{100 * level:.4g} % confidence interval"


def wrapped(text: str, letters: int = 40) -> str:
    """`text` in lines of so many letters, by default those that fit beside axes of the usual size.

    Formulas stay whole, and so do the lines that it has.
    """
    guarded = re.sub(r"\$[^$]*\$", lambda formula: formula[0].replace(" ", "\0"), text)
    lines = [fill(line, max(letters, 10), break_long_words=False) for line in guarded.split("\n")]
    return "\n".join(lines).replace("\0", " ")


def quantity_label(name: str, unit: str) -> str:
    """The name of a quantity with its unit, if it has one."""
    return name if unit == "1" else f"{name} ({unit})"


def unit_of(values: Any) -> str:
    """The unit of a labelled array."""
    return str(values.attrs.get("units", "")) or "1"


def label_of(values: Any) -> str:
    """The name of a labelled array with its unit."""
    name = values.attrs.get("long_name", values.name)
    return quantity_label("" if name is None else str(name), unit_of(values))


def density_label(*units: str) -> str:
    """The name of the probability density over quantities of these units."""
    named = [unit for unit in units if unit != "1"]
    if not named:
        return "probability density"
    together = named[0] if len(named) == 1 else f"({' '.join(named)})"
    return f"probability density (1/{f'{named[0]}$^2$' if named[1:] == named[:1] else together})"


def with_error(estimate: Estimate) -> str:
    """Value, standard error and unit of an estimate, without its name."""
    return estimate.without_name().replace("+-", "±")


def counted(number: int, word: str) -> str:
    """A number with the word for what was counted, in the plural where it is due."""
    return f"{number:,} {word}{'' if number == 1 else 's'}"


def whole_numbers(axis: Axis) -> None:
    """Put the ticks of an axis at whole numbers only."""
    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def note(ax: Axes, text: str) -> None:
    """Write into empty axes why there is nothing to draw."""
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes)


def draw_histogram(
    ax: Axes, edges: np.ndarray, heights: np.ndarray, errors: np.ndarray, color: str, *, label: str | None = None,
    upright: bool = True,
) -> None:  # fmt: skip
    """Draw a histogram with the standard errors of its bins.

    - `edges`: (bins + 1,). `heights`, `errors`: (bins,); bars are left out where an error is NaN.
    - `upright`: whether the bars stand on the lower edge of `ax`, or on its left edge.
    """
    orientation = "vertical" if upright else "horizontal"
    ax.stairs(heights, edges, fill=True, color=color, alpha=0.35, lw=0, orientation=orientation)
    ax.stairs(heights, edges, color=color, lw=SLIP_WIDTH, orientation=orientation, label=label)
    known = np.isfinite(errors) & (heights > 0)
    if np.any(known):
        centers, tops = ((edges[1:] + edges[:-1]) / 2)[known], heights[known]
        x, y = (centers, tops) if upright else (tops, centers)
        ax.errorbar(x, y, **{"yerr" if upright else "xerr": errors[known]}, ls="none", **ERROR_LOOK)


def draw_quantiles(ax: Axes, shares: Sequence[float], value_at: Callable[[float], Any], unit: str) -> None:
    """Mark quantiles with lines behind the bars of a histogram and a band between the outer ones.

    `shares`: of the values, each between 0 and 1; `value_at` says where. Raises ValueError for other shares.
    """
    checks.bounded("quantiles", np.asarray(shares, float), above=0, below=1, ndim=1)
    look, of_unit = {"color": BASE, "zorder": 0.5}, "" if unit == "1" else unit
    values = [float(value_at(share)) for share in shares]
    for share, value in sorted(zip(shares, values, strict=True)):
        ax.axvline(value, ls=":", lw=SLIP_WIDTH, label=f"{100 * share:g} %: {value:.4g} {of_unit}".rstrip(), **look)
    if len(values) > 1:
        ax.axvspan(min(values), max(values), alpha=0.08, lw=0, **look)


def draw_cells(
    ax: Axes, edges: tuple[np.ndarray, np.ndarray], values: np.ma.MaskedArray, norm: Normalize, label: str,
    beside: Axes | list[Axes],
) -> Colorbar:  # fmt: skip
    """Draw `values` (nx, ny) as a map of colours, masked ones white, and their scale `beside` axes, which is returned.

    `edges`: of the cells, (nx + 1,) and (ny + 1,).
    """
    mesh = ax.pcolormesh(*edges, values.T, cmap=SHADES, norm=norm, rasterized=True)
    known = values.compressed()
    sides = (known.min() < norm.vmin, known.max() > norm.vmax) if len(known) else (False, False)
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get(sides, "neither")
    return figure_of(ax).colorbar(mesh, ax=beside, label=label, extend=extend)


def draw_dots(ax: Axes, x: np.ndarray, y: np.ndarray, sizes: tuple[Dots, Dots], color: str, label: str | None) -> None:
    """Draw a point for each of many pairs; `sizes`: how they look where they are few, and where many."""
    many = len(x) > MANY
    size, alpha = sizes[many]
    ax.scatter(x, y, s=size, alpha=alpha, lw=0, color=color, rasterized=many)
    if label is not None:
        ax.plot([], [], ls="none", marker="o", ms=4, mew=0, color=color, label=label)


def rectangles(left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray) -> list[np.ndarray]:
    """The corners of rectangles with these sides (rectangles,): arrays (4, 2)."""
    return list(np.stack([np.stack([left, right, right, left], -1), np.stack([bottom, bottom, top, top], -1)], -1))


def sticks_in_rows(row: np.ndarray, start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """The corners of a bar for each stick from `start` to `end` (s), in its row; (sticks,) each."""
    return rectangles(start, end, row - 0.4, row + 0.4)


def draw_polygons(ax: Axes, corners: list[np.ndarray], **look: Any) -> PolyCollection:
    """Draw areas with these corners into `ax`, whose limits they leave as they are."""
    drawn = PolyCollection(corners, lw=0, **look)
    ax.add_collection(drawn, autolim=False)
    return drawn


# The legend above the axes, fitted to the room that there is, and numbers at ticks that do not reach into it.


_ROOM = 0.92  # of the width of the figure: twice the way from the middle of the axes to the right edge
_LEAST, _MOST = 1e-3, 1e5  # numbers at ticks beyond these are written with powers of ten


def legend_above(
    ax: Axes, *others: Axes, columns: int = 3, lines_first: bool = False, room: float | None = None
) -> None:
    """Put one legend for `ax` and `others`, if anything has a label, above `ax`, where it hides no data.

    Each label is listed once. There are as many columns as have room, and long labels are wrapped.

    - `columns`: at most. `lines_first`: whether lines come before areas, so that of two columns each holds one kind.
    - `room`: for the legend, a share of the width of the figure; by default that of the axes with their labels.
    """
    handles = {}
    for one in (ax, *others):
        plain_numbers(one.yaxis)
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if not handles:
        return
    if lines_first:
        handles = dict(sorted(handles.items(), key=lambda item: not isinstance(item[1], Line2D)))
    figure = figure_of(ax)
    # Not the renderer of the figure's own backend: that of SVG measures in other units than the figure.
    measure = RendererAgg(1, 1, figure.dpi)
    if room is None and (place := ax.get_subplotspec()) is not None:
        room = _ROOM * len(place.colspan) / place.get_gridspec().ncols
    elif room is None:
        room = max(_ROOM * ax.get_position().width, 0.1)
    most = width = room * figure.bbox.width
    look = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False}
    for number in range(min(columns, len(handles)), 0, -1):
        legend = ax.legend(list(handles.values()), list(handles), ncols=number, **look)
        width = legend.get_window_extent(measure).width
        if width <= most:
            return
    letters = int(max(map(len, handles)) * most / width) - 6  # the handle is as wide
    ax.legend(list(handles.values()), [wrapped(label, letters) for label in handles], ncols=1, **look)


def plain_numbers(axis: Axis) -> None:
    """Write the numbers at linear ticks in full, instead of what is common to them at the end of the axis.

    The legend stands there.
    """
    if type(axis.get_major_formatter()) is ScalarFormatter:
        axis.set_major_formatter(_WholeNumbers())


class _WholeNumbers(ScalarFormatter):
    """Numbers without a common offset or power of ten; each has its own power where they are very small or large."""

    def __init__(self) -> None:
        super().__init__(useOffset=False)
        self.set_scientific(False)
        self._ticks = np.zeros(0)

    def set_locs(self, locs: Any) -> None:
        super().set_locs(locs)
        self._ticks = np.asarray(locs, float)  # matplotlib's own are deprecated

    def __call__(self, x: Any, pos: int | None = None) -> str:
        largest = np.max(np.abs(self._ticks), initial=0.0)
        if largest == 0 or _LEAST <= largest < _MOST:
            return super().__call__(x, pos)
        if x == 0:
            return "0"
        power = int(np.floor(np.log10(np.abs(x)) + 1e-9))
        step = np.min(np.diff(np.unique(self._ticks)), initial=np.inf)
        digits = max(0, power - int(np.floor(np.log10(step) + 1e-9))) if np.isfinite(step) else 2
        mantissa = f"{x / 10.0**power:.{digits}f}"
        if "." in mantissa:
            mantissa = mantissa.rstrip("0").rstrip(".")
        return self.fix_minus(rf"${mantissa}\times10^{{{power}}}$")


# Write a figure to a file and close it.


def save(
    axes: Axes | SeveralAxes, path: str | Path, *, title: str | None = None, dpi: float = 150, overwrite: bool = False
) -> None:
    """Save the figure that `axes` belong to, and close it.

    Args:
        axes: What a function of this module returned: one matplotlib Axes, or several of one figure.
        path: The file; its ending chooses the format.
        title: Written above the figure.
        dpi: Dots per inch.
        overwrite: Whether to replace a file of that name. Until the new one is whole, an older one stays.

    Raises:
        ValueError: If `axes` holds anything else and for what is no file name of a figure.
        FileExistsError: Where a file would be replaced.
        FileNotFoundError: For a folder that does not exist.
        OSError: Where it cannot be written.
    """
    found = axes_in(axes)
    if not found:
        raise checks.refused("axes", "be a matplotlib Axes or hold several, as the figures here return them", axes)
    figure = figure_of(found[0])
    try:
        known = tuple(f".{name}" for name in figure.canvas.get_supported_filetypes())
        path = file_to_write(path, known, overwrite=overwrite)
        if title is not None:
            figure.suptitle(title)
        with file_for_user(path) as file:
            figure.savefig(file, dpi=dpi, format=path.suffix[1:].lower())
    finally:
        plt.close(figure)
