"""Small figures of results, for notebooks: made without pyplot, so that they are neither shown twice nor kept open."""

import base64
import io
from collections.abc import Callable

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from .._dynamics.simulation import Simulation
from .._ensemble.ensemble import Ensemble
from .._statistics.distribution import Distribution
from ._ensembles import histogram, stick_raster
from ._trajectory import time_history

_ROWS = 30  # samples of an ensemble
_MANY = 4000  # points of a line: longer ones are stored as an image


def small_figure(result: Simulation | Ensemble | Distribution) -> str:
    """The time history of a simulation, the sticks of the first samples of an ensemble, or a histogram.

    Returns the HTML of an image in SVG.
    """
    if isinstance(result, Simulation):
        number = len(result.system.coordinates)
        return _image((5.6, 1.5 * number + 0.6), number, lambda axes: time_history(result, axes=axes))
    if isinstance(result, Ensemble):
        return _image((5.6, 2.8), 1, lambda axes: stick_raster(result, samples=_ROWS, ax=axes[0]))
    return _image((4.6, 2.8), 1, lambda axes: histogram(result, ax=axes[0]))


def _image(size: tuple[float, float], panels: int, draw: Callable[[list[Axes]], object]) -> str:
    """The HTML of what `draw` draws into so many axes, one below the other; `size` in inches."""
    with mpl.rc_context({"font.size": 8.0, "axes.labelsize": 8.0, "legend.fontsize": 8.0}):
        figure = Figure(figsize=size, layout="constrained")
        axes = list(figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0])
        draw(axes)
        for ax in axes:
            for line in ax.lines:
                line.set_rasterized(np.size(line.get_xdata(orig=False)) > _MANY)
        figure.align_ylabels(axes)
        written = io.StringIO()
        FigureCanvasSVG(figure).print_svg(written, metadata={"Date": None})
    # As an image, because styles and names inside an SVG that stands in a page hold for all of the page.
    data = base64.b64encode(written.getvalue().encode()).decode()
    return f'<img alt="figure of the result" src="data:image/svg+xml;base64,{data}">'
