"""The controls of the explorer: what is simulated, and a slider with a box for each of its numbers."""

from collections.abc import Callable
from typing import Any

import panel as pn

from .. import _html
from .scene import MovableNumber, read_number

_BOX = 96  # px


class _Slider(pn.widgets.FloatSlider):
    """A slider whose moves are told at once, not after the 50 ms in which Panel collects further ones."""

    _debounce = 0


class _Box(pn.widgets.TextInput):
    """The same for a box."""

    _debounce = 0


class NumberControl:
    """A slider, and a box for a number that the slider does not reach. `moved` is called with it and a number.

    A box with something else in it says what is wrong, and nothing moves. `problem` is that, or "".
    """

    def __init__(self, number: MovableNumber, moved: Callable[["NumberControl", MovableNumber], None]):
        self.number, self.problem = number, ""
        self._moved, self._is_quiet = moved, False
        self._slider = _Slider(
            label=number.label, start=number.low, end=number.high, step=number.step, value=number.value,
            show_value=False, sizing_mode="stretch_width", margin=(0, 10, 0, 5),
        )  # fmt: skip
        self._box = _Box(label="value", value=f"{number.value:.6g}", width=_BOX, margin=(0, 0, 0, 5))
        self._problem = pn.pane.HTML("", visible=False, styles={"color": "#b00020"}, css_classes=["problem"])
        self._slider.param.watch(self._slid, "value")
        self._box.param.watch(self._written, "value")
        self.view = pn.Column(
            pn.Row(self._slider, self._box, sizing_mode="stretch_width", margin=0),
            self._problem, sizing_mode="stretch_width", margin=0,
        )  # fmt: skip

    def slide(self, value: float) -> None:
        """Move the slider, as its handle does."""
        self._slider.value = value

    def write(self, text: str) -> None:
        """Write into the box, as the keyboard does."""
        self._box.value = text

    def refuse(self, why: str) -> None:
        """Say why the number is not taken."""
        self.problem = why
        # What was written is in it: as text, whatever it is.
        self._problem.param.update(object=_html.escaped(why), visible=bool(why))

    def _slid(self, event: Any) -> None:
        if self._is_quiet:
            return
        # The ends of the range and the step are not round in binary.
        value = float(f"{event.new:.6g}")
        self._show(value, slider=False)

    def _written(self, event: Any) -> None:
        if self._is_quiet:
            return
        try:
            value = read_number(event.new)
        except ValueError as error:
            self.refuse(str(error))
            return
        self._show(value, slider=True)

    def _show(self, value: float, *, slider: bool) -> None:
        self.refuse("")
        self.number = self.number.at(value)
        self._is_quiet = True
        try:
            if slider:
                self._slider.param.update(start=self.number.low, end=self.number.high, value=value)
            else:
                self._box.value = f"{value:.6g}"
        finally:
            self._is_quiet = False
        self._moved(self, self.number)


def choice(name: str, options: list[str], value: str, chosen: Callable[[str], None]) -> pn.widgets.Select:
    """A list to choose from."""
    widget = pn.widgets.Select(label=name, options=options, value=value, sizing_mode="stretch_width")
    widget.param.watch(lambda event: chosen(event.new), "value")
    return widget


def whole_number(
    name: str, value: int, low: int, high: int, chosen: Callable[[int], None]
) -> pn.widgets.IntInput:  # fmt: skip
    """A box for a whole number."""
    widget = pn.widgets.IntInput(label=name, value=value, start=low, end=high, width=130)
    widget.param.watch(lambda event: chosen(event.new), "value")
    return widget
