"""Write a figure to a file and close it."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from .. import _checks
from .._files import file_for_user, file_to_write
from . import _style
from ._types import SeveralAxes


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
    found = (axes,) if isinstance(axes, Axes) else _style.axes_in(axes)
    if not found:
        raise ValueError(
            "Argument axes must be a matplotlib Axes or hold several, as the figures here return them, but "
            f"{_checks.show(axes)} was given."
        )
    figure = _style.figure_of(found[0])
    try:
        known = tuple(f".{name}" for name in figure.canvas.get_supported_filetypes())
        path = file_to_write(path, known, overwrite=overwrite)
        if title is not None:
            figure.suptitle(title)
        with file_for_user(path) as file:
            figure.savefig(file, dpi=dpi, format=path.suffix[1:].lower())
    finally:
        plt.close(figure)
