"""What the figures of statistics share: names of axes, notes in empty axes, outlines of histograms, rectangles."""

import re
from contextlib import suppress
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import MaxNLocator

from .. import _checks
from .._statistics.estimate import Estimate
from . import _style

ERROR_LOOK = {"color": _style.MASS, "elinewidth": 0.9, "capsize": 0}
"""How error bars look."""


def numbers_or_gaps(name: str, given: object, ndim: int) -> np.ndarray:
    """The argument `name` as an array of `ndim` dimensions, in which NaN is a gap. Raises ValueError for others."""
    finite = given
    with suppress(TypeError, ValueError):
        finite = np.nan_to_num(np.asarray(given, float), nan=0.0, posinf=np.inf, neginf=-np.inf)
    _checks.numeric(name, finite, ndim=ndim)
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


def label_of(values: Any) -> str:
    """The name of a labelled array with its unit."""
    return quantity_label(str(values.attrs.get("long_name", values.name)), str(values.attrs.get("units", "1")))


def unit_after(unit: str) -> str:
    """A unit to stand after a number."""
    return "" if unit == "1" else f" {unit}"


def density_label(*units: str) -> str:
    """The name of the probability density over quantities of these units."""
    named = [unit for unit in units if unit != "1"]
    if not named:
        return "probability density"
    if len(named) == 1:
        return f"probability density (1/{named[0]})"
    together = f"{named[0]}$^2$" if named[0] == named[1] else f"({' '.join(named)})"
    return f"probability density (1/{together})"


def color_of(name: str) -> str:
    """The colour of the quantity `name`: sticks have one of their own."""
    return _style.STICK if "stick" in name else _style.SERIES[0]


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
    ax.stairs(heights, edges, color=color, lw=_style.SLIP_WIDTH, orientation=orientation, label=label)
    known = np.isfinite(errors) & (heights > 0)
    if np.any(known):
        centers = ((edges[1:] + edges[:-1]) / 2)[known]
        if upright:
            ax.errorbar(centers, heights[known], yerr=errors[known], ls="none", **ERROR_LOOK)
        else:
            ax.errorbar(heights[known], centers, xerr=errors[known], ls="none", **ERROR_LOOK)


def rectangles(left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray) -> list[np.ndarray]:
    """The corners of rectangles with these sides (rectangles,): arrays (4, 2)."""
    return list(np.stack([np.stack([left, right, right, left], -1), np.stack([bottom, bottom, top, top], -1)], -1))
