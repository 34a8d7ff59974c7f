"""What all figures share: colours, new axes, their scales.

The colours are those of Okabe and Ito ("Color universal design", 2008), which colour-blind readers can distinguish.
"""

import math
from collections.abc import Iterable, Sequence

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from matplotlib.typing import ColorType

from .. import _checks
from ._types import SeveralAxes, Window

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


def axes_or_new(ax: Axes | None, size: tuple[float, float]) -> Axes:
    """`ax` itself, or the axes of a new figure of `size` (inches). Raises ValueError if `ax` is no matplotlib Axes."""
    if ax is None:
        _, ax = plt.subplots(figsize=size, layout="constrained")
    if not isinstance(ax, Axes):
        raise ValueError(f"Argument ax must be a matplotlib Axes, but {_checks.show(ax)} was given.")
    return ax


def free_color(preferred: str, used: Iterable[ColorType]) -> str:
    """`preferred`, or where that is `used` the first of `SERIES` that is not; the first of all where all are used."""
    taken = {to_rgba(color, 1.0) for color in used}
    return next((color for color in (preferred, *SERIES) if to_rgba(color) not in taken), preferred)


def free_look(ax: Axes) -> tuple[str, str]:
    """Colour and line style of the next curve in `ax`: those that no curve in it has yet."""
    taken = {(to_rgba(line.get_color()), line.get_linestyle()) for line in ax.lines}
    # Neighbours differ in both, for prints without colours.
    looks = [(SERIES[number % len(SERIES)], LINES[number % len(LINES)]) for number in range(len(SERIES) * len(LINES))]
    return next((look for look in looks if (to_rgba(look[0]), look[1]) not in taken), looks[0])


def marker_of(points: np.ndarray) -> str | None:
    """The marker of a curve through these points; none for so many that markers would merge."""
    return "o" if len(points) <= 60 else None


def time_axis(ax: Axes, window: Window, t1: float | None = None) -> None:
    """Limit the abscissa of `ax` to the `window` of time, and name it unless axes below have the name.

    `t1`: the end of the motion (s), where its beginning was chosen for the user; the name says so.
    """
    ax.set_xlim(window)
    if ax.xaxis.get_tick_params().get("labelbottom", True):
        part = "" if t1 is None or window[1] == t1 else f": the first {window[1]:g} s of {t1:g} s"
        ax.set_xlabel(f"time $t$ (s){part}")


def log_axis(axis: Axis) -> None:
    """Make an axis logarithmic, with plain numbers at its ticks, as many as its limits leave room for."""
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


def axes_in(axes: SeveralAxes | None) -> tuple[Axes, ...]:
    """The matplotlib Axes that `axes` holds, none of them if anything else is among them."""
    if isinstance(axes, np.ndarray) and axes.ndim != 1:
        return ()
    found = tuple(axes) if isinstance(axes, (Sequence, np.ndarray)) else ()
    return found if all(isinstance(one, Axes) for one in found) else ()


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
    found = axes_in(axes)
    if len(found) != len(names):
        number = {1: "one", 2: "two", 3: "three"}.get(len(names), len(names))
        raise ValueError(
            f"Argument axes must hold {number} matplotlib Axes ({', '.join(names)}), but {_checks.show(axes)} was "
            "given."
        )
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
