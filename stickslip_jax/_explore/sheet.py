"""The pictures of a scene as a file."""

import io
from collections.abc import Iterator

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from ..plot import histogram, phase_portrait, time_history
from .pictures import LONGEST_HISTORY, motion_of, statistics_of
from .scene import Scene


def sheet_of(scene: Scene) -> bytes:
    """A PDF: phase portrait and time history of a realisation, histograms of the sticks of all, a page for each."""
    stored = io.BytesIO()
    with PdfPages(stored) as pages:
        for page in _pages(scene):
            pages.savefig(page)
            plt.close(page)
    return stored.getvalue()


def _pages(scene: Scene) -> Iterator[Figure]:
    motion, many = motion_of(scene), statistics_of(scene).ensemble
    if not motion.problem:
        window = (0.0, min(scene.t1, LONGEST_HISTORY))
        if motion.one.sticks.contact is None:
            yield _figure_of(phase_portrait(motion.one, window=window))
        yield _figure_of(time_history(motion.one, window=window)[0])
    of_all = many.statistics
    has_sticks = len(many.finished_sticks().duration) > 0
    for one in (of_all.stick_count, *((of_all.duration, of_all.start) if has_sticks else ())):
        yield _figure_of(histogram(one))


def _figure_of(axes: Axes) -> Figure:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return figure
