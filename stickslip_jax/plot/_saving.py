"""Write a figure to a file and close it."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from .. import _checks
from . import _style
from ._types import SeveralAxes


def save(axes: Axes | SeveralAxes, path: str | Path, *, title: str | None = None, dpi: float = 150) -> None:
    """Save the figure that `axes` belong to, and close it.

    - `axes`: what a function of this module returned: one matplotlib Axes, or several of one figure.
    - `path`: the file; its ending chooses the format. `title`: written above the figure. `dpi`: dots per inch.

    Raises ValueError if `axes` holds anything else, and OSError if the file cannot be written.
    """
    found = (axes,) if isinstance(axes, Axes) else _style.axes_in(axes)
    if not found:
        raise ValueError(
            "Argument axes must be a matplotlib Axes or hold several, as the figures here return them, but "
            f"{_checks.show(axes)} was given."
        )
    figure = found[0].get_figure(root=True)
    assert figure is not None
    if title is not None:
        figure.suptitle(title)
    try:
        figure.savefig(path, dpi=dpi)
    finally:
        plt.close(figure)
