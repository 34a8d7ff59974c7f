"""The pictures of a scene: their numbers, how Bokeh draws them, and the sheet that is saved."""

import io
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

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
from .._ensemble.ensemble import Ensemble, simulate_ensemble
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


Data: TypeAlias = dict[str, Any]
"""What a source of Bokeh holds: arrays by the names of its columns."""


class Motion(NamedTuple):
    """What is drawn of the first realisation.

    - `curves`: of "slip" and "stick", the time "t" and two coordinates "x" and "y", NaN where a line breaks.
    - `problem`: why it is not drawn, or "".
    """

    one: Simulation
    curves: dict[str, Data]
    problem: str


class Statistics(NamedTuple):
    """What is drawn of all realisations.

    - `bars`: the histograms of sticks in those that reached the end, with their sides "left" and "right" and the height
      "top".
    - `unfinished`: how many did not.
    """

    ensemble: Ensemble
    bars: dict[str, Data]
    means: tuple[Estimate, ...]
    unfinished: int


def motion_of(scene: Scene) -> Motion:
    """Simulate the first realisation of a scene. Raises ValueError for what `simulate` refuses."""
    one = realization(scene)
    is_whole = int(one.status) == Status.FINISHED
    phases = phases_of(one, (0.0, min(scene.t1, LONGEST_HISTORY))) if is_whole else []
    columns = dict(zip("txy", ("times", *coordinates_of(scene)), strict=True))
    curves = {}
    for name in _CURVES:
        parts = [one for one in phases if one.sticks == (name == "stick")]
        curves[name] = {column: joined(parts, values) for column, values in columns.items()}
    problem = "" if is_whole else f"This realisation has no end: {Status(int(one.status)).meaning}."
    return Motion(one, curves, problem)


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
    shares = np.histogram(counts, edges)[0] / max(1, len(counts))
    bars = {
        "durations": _bars_of_times(sticks.duration),
        "starts": _bars_of_times(sticks.start, scene.t1),
        "numbers": _bars(shares, edges),
    }
    means = tuple(of(many) for of in (mean_stick_duration, mean_stick_count, stick_fraction))
    return Statistics(many, bars, means, scene.samples - int(many.status_counts.get(Status.FINISHED, 0)))


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


def _bars_of_times(values: np.ndarray, end: float | None = None) -> Data:
    """A histogram of times as a density, from 0 to their largest or to `end`."""
    if not len(values):
        return _bars(np.zeros(1), np.array([0.0, end or 1.0]))
    return _bars(*np.histogram(values, _BINS, (0.0, end or float(np.max(values)) or 1.0), density=True))


def _bars(heights: np.ndarray, edges: np.ndarray) -> Data:
    return {"left": edges[:-1], "right": edges[1:], "top": heights}


# The bifurcation diagram of a scene whose base is deterministic.


_VALUES, _TRANSIENT, _KEPT = 120, 100, 40


def is_deterministic(scene: Scene) -> bool:
    """Whether what drives the system is the same in all realisations."""
    return not is_random(scene.law)


def section_of(scene: Scene, number: MovableNumber) -> Data:
    """The first coordinate once a period, "state", over the range of the slider of `number`, "value".

    It starts as the scene does; a random start counts by its median. Raises ValueError for a base without a period, and
    for numbers that `bifurcation_diagram` refuses.
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
    return {"value": np.repeat(values, states.shape[1]), "state": states.ravel()}


# The pictures of the explorer, by Bokeh: made once, then given new numbers.


_HEIGHT = 250
_CURVES = {"slip": (_style.FORWARD, _style.SLIP_WIDTH), "stick": (_style.STICK, _style.STICK_WIDTH)}
_BARS = {
    "durations": ("Stick durations", "duration (s)", "density (1/s)"),
    "starts": ("Stick starts", "start (s)", "density (1/s)"),
    "numbers": ("Sticks in a realisation", "number of sticks", "probability"),
}


class Figures:
    """The phase portrait, the time history, and the histograms of durations, starts and numbers of sticks; `all`."""

    def __init__(self, scene: Scene):
        x, y = labels_of(scene)
        self.curves = {name: ColumnDataSource({"t": [], "x": [], "y": []}) for name in _CURVES}
        self.bars = {name: ColumnDataSource({"left": [], "right": [], "top": []}) for name in _BARS}
        self.portrait = _figure("Phase portrait", x, y, **_ranges())
        self.history = _figure("Time history", "time (s)", x, **_ranges())
        for plot, across, up in ((self.portrait, "x", "y"), (self.history, "t", "x")):
            for name, (color, width) in _CURVES.items():
                plot.line(across, up, source=self.curves[name], color=color, line_width=width, legend_label=name)
            plot.add_layout(plot.legend[0], "above")
            plot.legend[0].update(orientation="horizontal", padding=2, margin=2)
        self.histograms = {name: _figure(*labels, **_ranges()) for name, labels in _BARS.items()}
        for name, plot in self.histograms.items():
            plot.quad(
                left="left", right="right", top="top", bottom=0, source=self.bars[name], color=_style.STICK,
                line_color="white", line_width=0.5,
            )  # fmt: skip
        self.all = self.portrait, self.history, *self.histograms.values()

    def show_motion(self, scene: Scene, motion: Motion) -> None:
        """Draw another realisation."""
        self.history.x_range.end = min(scene.t1, LONGEST_HISTORY)
        for name, curve in motion.curves.items():
            self.curves[name].data = curve
        for axis, column in (
            (self.portrait.x_range, "x"), (self.portrait.y_range, "y"), (self.history.y_range, "x"),
        ):  # fmt: skip
            _fit(axis, np.concatenate([curve[column] for curve in motion.curves.values()]))

    def show_statistics(self, statistics: Statistics) -> None:
        """Draw other histograms."""
        for name, bars in statistics.bars.items():
            self.bars[name].data = bars
            plot = self.histograms[name]
            plot.x_range.update(start=bars["left"][0], end=bars["right"][-1])
            plot.y_range.end = 1.05 * np.max(bars["top"]) or 1.0


class SectionFigure:
    """States once a period over the values of one number: the bifurcation diagram."""

    def __init__(self, scene: Scene) -> None:
        self.points = ColumnDataSource({"value": [], "state": []})
        self.plot = _figure("Bifurcation diagram", "", f"{labels_of(scene)[0]}, once a period", height=420)
        self.plot.scatter("value", "state", source=self.points, size=3, color=_style.MASS, line_alpha=0)

    def show(self, number: MovableNumber, points: Data) -> None:
        """Draw the diagram over another number."""
        self.plot.xaxis.axis_label, self.points.data = number.label, points


def _ranges() -> dict[str, Any]:
    """Of both axes, set with each picture: those that the page would find itself take it longer."""
    return {name: Range1d(start=0, end=1) for name in ("x_range", "y_range")}


def _fit(of_axis: Range1d, values: np.ndarray) -> None:
    """Let a range hold these values and a margin."""
    known = values[np.isfinite(values)]
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
