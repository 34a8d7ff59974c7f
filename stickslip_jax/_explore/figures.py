"""The pictures of the explorer, by Bokeh: made once, then given new numbers."""

from typing import Any

import numpy as np
from bokeh.models import BasicTickFormatter, ColumnDataSource, Range1d
from bokeh.plotting import figure

from ..plot import _style
from .bifurcation import Section
from .pictures import LONGEST_HISTORY, Bars, Curve, Motion, Statistics, labels_of
from .scene import Scene

_HEIGHT = 250
_CURVES = ("slip", "stick")
_BARS = ("durations", "starts", "numbers")
_COLORS = {"slip": _style.FORWARD, "stick": _style.STICK}
_WIDTHS = {"slip": _style.SLIP_WIDTH, "stick": _style.STICK_WIDTH}


class Figures:
    """Phase portrait, time history, and the histograms of durations, starts and numbers of sticks."""

    def __init__(self, scene: Scene):
        x, y = labels_of(scene)
        self._curves = {name: ColumnDataSource({"t": [], "x": [], "y": []}) for name in _CURVES}
        self._bars = {name: ColumnDataSource({"left": [], "right": [], "top": []}) for name in _BARS}
        self.portrait = self._lines("Phase portrait", "x", "y", x, y)
        self.history = self._lines("Time history", "t", "x", "time (s)", x)
        self.durations = self._histogram("durations", "Stick durations", "duration (s)", "density (1/s)")
        self.starts = self._histogram("starts", "Stick starts", "start (s)", "density (1/s)")
        self.numbers = self._histogram("numbers", "Sticks in a realisation", "number of sticks", "probability")

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
        for name in _CURVES:
            plot.line(x, y, source=self._curves[name], color=_COLORS[name], line_width=_WIDTHS[name], legend_label=name)
        plot.add_layout(plot.legend[0], "above")
        plot.legend[0].orientation = "horizontal"
        plot.legend[0].padding = plot.legend[0].margin = 2
        return plot

    def _histogram(self, name: str, title: str, x_label: str, y_label: str) -> Any:
        plot = _figure(title, x_label, y_label, **_ranges())
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
