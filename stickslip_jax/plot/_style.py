"""What all figures share: colours, new axes, the place of the legend.

The colours are those of Okabe and Ito, told apart by colour-blind readers and in gray print.
"""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

STICK = "#D55E00"
"""Sticks have this colour in every figure, and nothing else has."""
MASS = "#000000"
BASE = "#0072B2"
FORWARD = "#999999"
BACKWARD = "#000000"
AT_REST = "#56B4E9"
BAND = "#F0E442"
SERIES = ("#0072B2", "#009E73", "#CC79A7", "#000000", "#E69F00")

STICK_WIDTH = 3.2
SLIP_WIDTH = 1.2


def axes_or_new(ax: Any, size: tuple[float, float]) -> Axes:
    """`ax` itself, or the axes of a new figure of `size` (inches). Raises ValueError if `ax` is no matplotlib Axes."""
    if ax is None:
        _, ax = plt.subplots(figsize=size, layout="constrained")
    if not isinstance(ax, Axes):
        raise ValueError(f"Argument ax must be a matplotlib Axes, but {ax!r} was given.")
    return ax


def two_axes_or_new(ax: Any, size: tuple[float, float]) -> tuple[Axes, Axes]:
    """The two axes in `ax`, or those of a new figure, one below the other with a common time axis.

    `size` in inches. Raises ValueError if `ax` does not hold two matplotlib Axes.
    """
    if ax is None:
        _, ax = plt.subplots(2, 1, sharex=True, figsize=size, layout="constrained")
    axes = list(ax) if isinstance(ax, Sequence) or hasattr(ax, "__array__") else []
    if len(axes) != 2 or not all(isinstance(one, Axes) for one in axes):
        raise ValueError(f"Argument ax must hold two matplotlib Axes (position, velocity), but {ax!r} was given.")
    return axes[0], axes[1]


def legend_above(ax: Axes, *others: Axes, columns: int = 3) -> None:
    """Put one legend for `ax` and `others` above `ax`, where it hides no data; each label is listed once."""
    handles = {}
    for one in (ax, *others):
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    ax.legend(
        handles.values(), handles.keys(), loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False
    )
