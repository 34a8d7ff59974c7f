"""The pictures of a scene as a file."""

import io
from collections.abc import Iterator

from matplotlib import pyplot as plt
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from ..plot import histogram, phase_portrait, time_history
from .pictures import LONGEST_HISTORY, Pictures, pictures_of
from .scene import Scene


def sheet_of(scene: Scene) -> bytes:
    """A PDF: phase portrait and time history of a realisation, histograms of the sticks of all, a page for each."""
    stored = io.BytesIO()
    with PdfPages(stored) as pages:
        for page in _pages(scene, pictures_of(scene)):
            pages.savefig(page)
            plt.close(page)
    return stored.getvalue()


def _pages(scene: Scene, pictures: Pictures) -> Iterator[Figure]:
    if not pictures.problem:
        window = (0.0, min(scene.t1, LONGEST_HISTORY))
        if pictures.one.sticks.contact is None:
            yield phase_portrait(pictures.one, window=window).get_figure(root=True)
        yield time_history(pictures.one, window=window)[0].get_figure(root=True)
    of_all = pictures.ensemble.statistics
    quantities = [of_all.stick_count]
    if of_all.duration.count:
        quantities += [of_all.duration, of_all.start]
    for one in quantities:
        yield histogram(one).get_figure(root=True)
