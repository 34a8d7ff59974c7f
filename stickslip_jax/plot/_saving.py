"""Write a figure to a file and let it go."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes


def save(axes: Axes | tuple[Axes, ...], path: str | Path, *, title: str | None = None, dpi: float = 150) -> None:
    """Save the figure that `axes` belong to, and close it.

    - `path`: the file; its ending tells the format. `title`: written above the figure.

    Raises OSError if the file cannot be written.
    """
    figure = (axes[0] if isinstance(axes, tuple) else axes).get_figure(root=True)
    assert figure is not None
    if title is not None:
        figure.suptitle(title)
    try:
        figure.savefig(path, dpi=dpi)
    finally:
        plt.close(figure)
