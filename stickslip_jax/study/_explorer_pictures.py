"""The pictures of a scene: their numbers, how Bokeh draws them, and the sheet that is saved."""

import io
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from bokeh.models import BasicTickFormatter, ColumnDataSource, Range1d
from bokeh.plotting import figure
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages

from .._dynamics.common.method import slowest_time
from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation
from .._ensemble.call import simulate_ensemble
from .._ensemble.result import Ensemble
from .._excitation.excitation import is_random, law_of
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._foundation.types import Status
from .._sensitivity.call import sensitivity
from .._sensitivity.estimate import Sensitivity
from .._statistics.estimate import Estimate
from .._statistics.totals import mean_stick_count, mean_stick_duration, stick_fraction
from .._uncertainty.families import RandomNumber
from .._uncertainty.inputs import Inputs, StochasticModel
from ..nonlinear import bifurcation_diagram
from ..plot import _style, histogram, phase_portrait, time_history
from ..plot._trajectory import joined, phases_of
from ._explorer_scene import MovableNumber, Scene

# The numbers of all pictures of a scene: one realisation, and the sticks of thousands.


LONGEST_HISTORY = 60.0  # s, that is drawn
_BINS = 40
_LEAST_CAPACITY = 1024  # intervals of the base: programs are compiled for few of them


class Curve(NamedTuple):
    """A realisation between its events: values of two coordinates over time, NaN where a line breaks, (points,)."""

    times: np.ndarray
    x: np.ndarray
    y: np.ndarray


class Bars(NamedTuple):
    """A histogram: `heights` (bars,) between `edges` (bars + 1,)."""

    edges: np.ndarray
    heights: np.ndarray


class Motion(NamedTuple):
    """What is drawn of the first realisation.

    - `slip`, `stick`: its parts.
    - `problem`: why it is not drawn, or "".
    """

    one: Simulation
    slip: Curve
    stick: Curve
    problem: str


class Statistics(NamedTuple):
    """What is drawn of all realisations.

    - `durations`, `starts`, `numbers`: of the sticks in those that reached the end.
    - `unfinished`: how many did not.
    """

    ensemble: Ensemble
    durations: Bars
    starts: Bars
    numbers: Bars
    means: tuple[Estimate, ...]
    unfinished: int


def motion_of(scene: Scene) -> Motion:
    """Simulate the first realisation of a scene. Raises ValueError for what `simulate` refuses."""
    one = realization(scene)
    is_whole = int(one.status) == Status.FINISHED
    phases = phases_of(one, (0.0, min(scene.t1, LONGEST_HISTORY))) if is_whole else []
    x, y = coordinates_of(scene)
    slip, stick = (
        Curve(*(joined([one for one in phases if one.sticks == sticks], name) for name in ("times", x, y)))
        for sticks in (False, True)
    )
    problem = "" if is_whole else f"This realisation has no end: {Status(int(one.status)).meaning}."
    return Motion(one, slip, stick, problem)


def statistics_of(scene: Scene) -> Statistics:
    """Simulate all realisations of a scene. Raises ValueError for what `simulate_ensemble` refuses."""
    many = simulate_ensemble(
        scene.system, scene.law, t1=scene.t1, samples=scene.samples, key=jax.random.key(scene.seed), y0=scene.y0,
        method=scene.method, keep="sticks", progress=False,
    )  # fmt: skip
    sticks = many.finished_sticks()
    # The share of realisations with each number of sticks; of neighbouring numbers together where they are many.
    counts = sticks.count
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    width = max(1, -(-(high - low + 1) // (2 * _BINS)))
    edges = np.arange(low, high + width + 1, width) - 0.5
    heights, _ = np.histogram(counts, edges)
    return Statistics(
        ensemble=many,
        durations=_bars(sticks.duration),
        starts=_bars(sticks.start, scene.t1),
        numbers=Bars(edges, heights / max(1, len(counts))),
        means=tuple(of(many) for of in (mean_stick_duration, mean_stick_count, stick_fraction)),
        unfinished=scene.samples - int(many.status_counts.get(Status.FINISHED, 0)),
    )


def slope_of(scene: Scene, name: str) -> tuple[Sensitivity, list[str]]:
    """The derivative of the mean stick duration by a number, and the sentences of its warnings.

    Raises ValueError for what `sensitivity` refuses.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RuntimeWarning)
        found = sensitivity(
            mean_stick_duration, scene.system, scene.law, wrt=name, t1=scene.t1, samples=scene.samples,
            key=jax.random.key(scene.seed), y0=scene.y0, method=scene.method,
        )  # fmt: skip
    assert isinstance(found, Sensitivity)
    return found, [str(one.message) for one in caught]


def realization(scene: Scene) -> Simulation:
    """The first realisation of the ensemble of a scene, with the sticks that are counted there."""
    model = StochasticModel(scene.system, law_of(scene.law), scene.y0)
    inputs = Inputs.of(model, scene.samples, jax.random.key(scene.seed))
    system, law, y0 = inputs.of_sample(0, jnp.dtype(jnp.result_type(float)))
    base: Any = law
    if isinstance(law, PiecewiseConstantLaw) and law.is_random:
        # A larger capacity only continues the motion, and one program serves for many rates.
        capacity = _LEAST_CAPACITY
        while capacity < law.capacity(scene.t1):
            capacity *= 4
        base = law.sample(jax.random.fold_in(jax.random.key(scene.seed), 0), scene.t1, capacity=capacity)
    elif is_random(law):
        base = inputs.realization_of(0, law, scene.t1)
    one = simulate(system, base, t1=scene.t1, y0=y0, method=scene.method)
    if one.sticks.contact is None:
        return one
    counted = scene.system.tracks.counted
    return one.of_contact(counted) if counted is not None and counted >= 0 else one.of_all_contacts()


def coordinates_of(scene: Scene) -> tuple[int, int]:
    """The numbers of the coordinates in a phase portrait: the first, and its rate."""
    known = scene.system.coordinates
    rates = [at for at, one in enumerate(known) if one.unit == f"{known[0].unit}/s"]
    return 0, (rates or [min(1, len(known) - 1)])[0]


def labels_of(scene: Scene) -> tuple[str, str]:
    """The coordinates of a phase portrait with their units."""
    known = scene.system.coordinates
    chosen = [known[at] for at in coordinates_of(scene)]
    x, y = (one.name if one.unit == "1" else f"{one.name} ({one.unit})" for one in chosen)
    return x, y


def _bars(values: np.ndarray, end: float | None = None) -> Bars:
    """A histogram of times as a density, from 0 to their largest or to `end`."""
    if not len(values):
        return Bars(np.array([0.0, end or 1.0]), np.zeros(1))
    heights, edges = np.histogram(values, _BINS, (0.0, end or float(np.max(values)) or 1.0), density=True)
    return Bars(edges, heights)


# The bifurcation diagram of a scene whose base is deterministic.


_VALUES, _TRANSIENT, _KEPT = 120, 100, 40


class Section(NamedTuple):
    """The first coordinate once a period, over the values of one number: points (points,)."""

    label: str
    state_label: str
    values: np.ndarray
    states: np.ndarray


def is_deterministic(scene: Scene) -> bool:
    """Whether what drives the system is the same in all realisations."""
    return not is_random(scene.law)


def section_of(scene: Scene, number: MovableNumber) -> Section:
    """The diagram over the range of the slider of `number`, from the start of the scene.

    A random start counts by its median. Raises ValueError for a base without a period, and for numbers that
    `bifurcation_diagram` refuses.
    """
    values = np.linspace(number.low, number.high, _VALUES)
    start = [float(one.icdf(jnp.asarray(0.5))) if isinstance(one, RandomNumber) else float(one) for one in scene.y0]
    period = slowest_time(scene.system, scene.law) if getattr(scene.law, "repeats_after", None) in (0, 0.0) else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of motions that do not reach the end, or have not settled
        found = bifurcation_diagram(
            scene.system, scene.law, {number.name: values}, y0=start, transient=_TRANSIENT, kept=_KEPT, period=period,
            longest_transient=_TRANSIENT, progress=False,
        )  # fmt: skip
    states = np.asarray(found[scene.system.coordinates[0].variable]).reshape(_VALUES, -1)
    label, _ = labels_of(scene)
    return Section(number.label, f"{label}, once a period", np.repeat(values, states.shape[1]), states.ravel())


# The pictures of the explorer, by Bokeh: made once, then given new numbers.


_HEIGHT = 250
_CURVES = {"slip": (_style.FORWARD, _style.SLIP_WIDTH), "stick": (_style.STICK, _style.STICK_WIDTH)}
_BARS = {
    "durations": ("Stick durations", "duration (s)", "density (1/s)"),
    "starts": ("Stick starts", "start (s)", "density (1/s)"),
    "numbers": ("Sticks in a realisation", "number of sticks", "probability"),
}


class Figures:
    """Phase portrait, time history, and the histograms of durations, starts and numbers of sticks."""

    def __init__(self, scene: Scene):
        x, y = labels_of(scene)
        self._curves = {name: ColumnDataSource({"t": [], "x": [], "y": []}) for name in _CURVES}
        self._bars = {name: ColumnDataSource({"left": [], "right": [], "top": []}) for name in _BARS}
        self.portrait = self._lines("Phase portrait", "x", "y", x, y)
        self.history = self._lines("Time history", "t", "x", "time (s)", x)
        self.durations, self.starts, self.numbers = map(self._histogram, _BARS)

    @property
    def all(self) -> tuple[Any, ...]:
        """The figures in their order."""
        return self.portrait, self.history, self.durations, self.starts, self.numbers

    def show_motion(self, scene: Scene, motion: Motion) -> None:
        """Draw another realisation."""
        self.history.x_range.end = min(scene.t1, LONGEST_HISTORY)
        for name in _CURVES:
            curve: Curve = getattr(motion, name)
            self._curves[name].data = {"t": curve.times, "x": curve.x, "y": curve.y}
        both = motion.slip, motion.stick
        _fit(self.portrait.x_range, *(one.x for one in both))
        _fit(self.portrait.y_range, *(one.y for one in both))
        _fit(self.history.y_range, *(one.x for one in both))

    def show_statistics(self, statistics: Statistics) -> None:
        """Draw other histograms."""
        for name in _BARS:
            bars: Bars = getattr(statistics, name)
            self._bars[name].data = {"left": bars.edges[:-1], "right": bars.edges[1:], "top": bars.heights}
            plot = getattr(self, name)
            plot.x_range.update(start=bars.edges[0], end=bars.edges[-1])
            plot.y_range.end = 1.05 * np.max(bars.heights) or 1.0

    def _lines(self, title: str, x: str, y: str, x_label: str, y_label: str) -> Any:
        plot = _figure(title, x_label, y_label, **_ranges())
        for name, (color, width) in _CURVES.items():
            plot.line(x, y, source=self._curves[name], color=color, line_width=width, legend_label=name)
        plot.add_layout(plot.legend[0], "above")
        plot.legend[0].orientation = "horizontal"
        plot.legend[0].padding = plot.legend[0].margin = 2
        return plot

    def _histogram(self, name: str) -> Any:
        plot = _figure(*_BARS[name], **_ranges())
        plot.quad(
            left="left", right="right", top="top", bottom=0, source=self._bars[name], color=_style.STICK,
            line_color="white", line_width=0.5,
        )  # fmt: skip
        return plot


class SectionFigure:
    """States once a period over the values of one number: the bifurcation diagram."""

    def __init__(self) -> None:
        self._points = ColumnDataSource({"value": [], "state": []})
        self.plot = _figure("Bifurcation diagram", "", "", height=420)
        self.plot.scatter("value", "state", source=self._points, size=3, color=_style.MASS, line_alpha=0)

    def show(self, section: Section) -> None:
        """Draw another section."""
        self.plot.xaxis.axis_label, self.plot.yaxis.axis_label = section.label, section.state_label
        self._points.data = {"value": section.values, "state": section.states}


def _ranges() -> dict[str, Any]:
    """Of both axes, set with each picture: those that the page would find itself take it longer."""
    return {name: Range1d(start=0, end=1) for name in ("x_range", "y_range")}


def _fit(of_axis: Range1d, *values: np.ndarray) -> None:
    """Let a range hold these values and a margin."""
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    if len(known):
        low, high = float(known.min()), float(known.max())
        margin = 0.05 * (high - low) or 0.5
        of_axis.update(start=low - margin, end=high + margin)


def _figure(title: str, x_label: str, y_label: str, height: int = _HEIGHT, **options: Any) -> Any:
    plot = figure(
        title=title, x_axis_label=x_label, y_axis_label=y_label, height=height, sizing_mode="stretch_width",
        toolbar_location=None, tools="", output_backend="canvas", **options,
    )  # fmt: skip
    plot.axis.axis_label_text_font_style = "normal"
    plot.yaxis.formatter = BasicTickFormatter(power_limit_low=-4)
    plot.grid.grid_line_alpha = 0.4
    return plot


# The pictures of a scene as a file.


def sheet_of(scene: Scene) -> bytes:
    """A PDF: phase portrait and time history of a realisation, histograms of the sticks of all, a page for each."""
    stored = io.BytesIO()
    with PdfPages(stored) as pages:
        for axes in _pages(scene):
            page = axes.get_figure(root=True)
            pages.savefig(page)
            plt.close(page)
    return stored.getvalue()


def _pages(scene: Scene) -> Iterator[Axes]:
    motion, many = motion_of(scene), statistics_of(scene).ensemble
    if not motion.problem:
        window = (0.0, min(scene.t1, LONGEST_HISTORY))
        if motion.one.sticks.contact is None:
            yield phase_portrait(motion.one, window=window)
        yield time_history(motion.one, window=window)[0]
    of_all = many.statistics
    has_sticks = len(many.finished_sticks().duration) > 0
    for one in (of_all.stick_count, *((of_all.duration, of_all.start) if has_sticks else ())):
        yield histogram(one)
