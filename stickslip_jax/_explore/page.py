"""The page of the explorer: controls on the left, pictures on the right, and what connects them."""

import io
import math
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import panel as pn

from .. import _html
from .._sensitivity.estimate import Sensitivity
from ..study._config import StudyConfig
from ..study._from_objects import config_of
from .bifurcation import is_deterministic, section_of
from .catalogue import FRICTIONS, SYSTEMS, bases_for, friction_called, has_friction_to_choose, scene_of, with_friction
from .controls import NumberControl, choice, whole_number
from .figures import Figures, SectionFigure
from .pictures import Motion, Statistics, motion_of, slope_of, statistics_of
from .python_code import as_python
from .scene import MovableNumber, Scene, numbers_of
from .sheet import sheet_of
from .work import Worker

GIVEN = "as given"
MOST_SAMPLES = 20_000
_THREADS = ThreadPoolExecutor(1, "pictures"), ThreadPoolExecutor(1, "derivatives")
_SIDE = {"flex": "1 1 300px", "max-width": "430px"}
_MAIN = {"flex": "3 1 330px", "min-width": "0"}
_GRID = {"display": "grid", "grid-template-columns": "repeat(auto-fit, minmax(290px, 1fr))"}
_FIRST = "The programs for this system are compiled: the first pictures take some seconds."
_TO_BE_READ = "textarea:disabled { color: #222; opacity: 1; font-family: monospace; }"
_COPY = """
navigator.clipboard.writeText(code.value).then(() => { button.label = "Copied"; });
setTimeout(() => { button.label = "Copy as Python"; }, 2000);
"""


class Explorer(pn.viewable.Viewer):
    """A system and what it does, as a page in a browser or the output of a cell in a notebook.

    - `scene`: what is shown now.
    - `controls`: of its numbers. `statistics`, `slope`: panes with the means and the derivative. `tabs`: their names.
    """

    def __init__(self, scene: Scene, **params: Any):
        super().__init__(**params)
        self.scene, self._start, self._given = scene, scene, scene
        self._moving = numbers_of(scene)[0]
        document = pn.state.curdoc
        pictures, derivatives = _THREADS
        self._pictures, self._slopes = Worker(document, pictures), Worker(document, derivatives)
        self._sections = Worker(document, derivatives)
        self._is_switching = False
        self._numbers = pn.Column(sizing_mode="stretch_width")
        self._alert = pn.pane.HTML("", visible=False, styles={"color": "#b00020"}, css_classes=["alert-of-scene"])
        self.statistics = pn.pane.HTML(_html.escaped(_FIRST), sizing_mode="stretch_width", css_classes=["statistics"])
        self.slope = pn.pane.HTML("", sizing_mode="stretch_width", css_classes=["slope"])
        self._code = pn.widgets.TextAreaInput(
            label="Python",
            rows=12,
            disabled=True,
            sizing_mode="stretch_width",
            max_length=100_000,
            stylesheets=[_TO_BE_READ],
        )
        self._section_note = pn.pane.HTML("", css_classes=["section-note"])
        self._tabs = pn.Tabs(sizing_mode="stretch_width")
        self._tabs.param.watch(lambda _: self._draw_section(), "active")
        self._view = pn.FlexBox(
            pn.Column(*self._choices(), self._numbers, styles=_SIDE),
            pn.Column(self._alert, self._tabs, self._buttons(), self._code, styles=_MAIN),
            sizing_mode="stretch_width",
        )
        self._renew()

    def __panel__(self) -> Any:
        return self._view

    def choose(self, which: str, name: str) -> None:
        """Choose from the list of "System", "Friction" or "Base"."""
        self._lists[which].value = name

    # --- what is chosen

    def _choices(self) -> list[Any]:
        scene = self.scene
        self._lists = {
            "System": choice("System", [GIVEN, *SYSTEMS], GIVEN, self._choose_system),
            "Friction": choice("Friction", [GIVEN, *FRICTIONS], GIVEN, self._choose_friction),
            "Base": choice("Base", [GIVEN, *bases_for(scene)], GIVEN, self._choose_base),
        }
        self._lists["Friction"].visible = has_friction_to_choose(scene.system)
        size = whole_number("Realisations", scene.samples, 2, MOST_SAMPLES, partial(self._count, "samples"))
        seed = whole_number("Seed", scene.seed, 0, 2**32 - 1, partial(self._count, "seed"))
        return [*self._lists.values(), pn.Row(size, seed)]

    def _choose_system(self, name: str) -> None:
        samples, seed = self.scene.samples, self.scene.seed
        new = self._given if name == GIVEN else scene_of(StudyConfig.model_validate(dict(SYSTEMS[name])))
        self.scene = new._replace(samples=samples, seed=seed)
        self._start = self.scene
        self._is_switching = True
        try:
            self._lists["Friction"].param.update(value=GIVEN, visible=has_friction_to_choose(new.system))
            self._lists["Base"].param.update(options=[GIVEN, *bases_for(self.scene)], value=GIVEN)
        finally:
            self._is_switching = False
        self._renew()

    def _choose_friction(self, name: str) -> None:
        if self._is_switching:
            return
        now, start = self.scene.system, self._start.system
        self.scene = self.scene._replace(
            system=start if name == GIVEN else with_friction(now, friction_called(name, now))
        )
        self._renew()

    def _choose_base(self, name: str) -> None:
        if self._is_switching:
            return
        law = self._start.law if name == GIVEN else bases_for(self.scene)[name]
        self.scene = self.scene._replace(law=law)
        self._renew()

    def _count(self, which: str, number: int | None) -> None:
        if number is not None:
            self.scene = self.scene._replace(**{which: number})
            self._compute()

    def _moved(self, control: NumberControl, number: MovableNumber) -> None:
        try:
            self.scene = self.scene.with_number(number.path, number.value)
        except ValueError as error:
            control.refuse(str(error))
            return
        self._moving = number
        self._compute()

    # --- what is shown

    def _renew(self) -> None:
        """Make controls and figures for another system or base."""
        numbers = numbers_of(self.scene)
        self.controls = [NumberControl(number, self._moved) for number in numbers]
        self._numbers.objects = [one.view for one in self.controls]
        self._moving = next((one for one in numbers if one.path[-1] in ("mu", "mu_static")), numbers[0])
        self._figures = Figures(self.scene)
        panes = [pn.pane.Bokeh(one, sizing_mode="stretch_width", margin=0) for one in self._figures.all]
        motion = pn.Column(
            pn.FlexBox(self.statistics, self.slope), pn.Column(*panes, styles=_GRID, sizing_mode="stretch_width"),
            sizing_mode="stretch_width",
        )  # fmt: skip
        tabs: list[Any] = [("Motion and statistics", motion)]
        self._section = SectionFigure()
        if is_deterministic(self.scene):
            section = pn.Column(
                self._section_note, pn.pane.Bokeh(self._section.plot, sizing_mode="stretch_width"),
                sizing_mode="stretch_width",
            )  # fmt: skip
            tabs.append(("Bifurcation", section))
        self.tabs = [name for name, _ in tabs]
        self._tabs[:] = tabs
        self._compute()

    def _compute(self) -> None:
        """Simulate anew; the derivative and the diagram come after the pictures, for which they leave the processor."""
        scene, moving, figures = self.scene, self._moving, self._figures
        motion = partial(motion_of, scene), partial(self._show_motion, scene, figures)
        statistics = partial(statistics_of, scene), partial(self._show_statistics, scene, moving, figures)
        self._pictures.do([motion, statistics], self._fail)

    def _differentiate(self, scene: Scene, moving: MovableNumber) -> None:
        if moving.path == ("t1",):
            self.slope.object = ""
            return
        self.slope.object = _html.escaped(f"Computing the derivative by {moving.name} ...")
        slope = partial(_quietly, slope_of, scene, moving.name), partial(self._show_slope, scene)
        self._slopes.do([slope], partial(self._no_slope, scene, moving))

    def _show_motion(self, scene: Scene, figures: Figures, motion: Motion) -> None:
        figures.show_motion(scene, motion)
        self._alert.param.update(object=_html.escaped(motion.problem), visible=bool(motion.problem))
        try:
            self._code.value = as_python(scene)
        except ValueError as error:
            self._code.value = f"# {error}"

    def _show_statistics(self, scene: Scene, moving: MovableNumber, figures: Figures, statistics: Statistics) -> None:
        figures.show_statistics(statistics)
        rows = [
            (one.name, one.without_name().replace("+-", "±"), _range_of(*one.interval())) for one in statistics.means
        ]
        table = _html.table(rows, ("of all realisations", "mean", "95 % interval"))
        left = f"<p>{statistics.unfinished:,} of {scene.samples:,} realisations did not finish.</p>"
        self.statistics.object = table + (left if statistics.unfinished else "")
        if scene is self.scene:
            self._differentiate(scene, moving)
            self._draw_section()

    def _show_slope(self, scene: Scene, found: tuple[Sensitivity, list[str]]) -> None:
        if scene is not self.scene:  # of other numbers than are shown
            return
        slope, remarks = found
        if math.isfinite(slope.derivative):
            self.slope.object = "".join(map(_html.escaped, (_with_unit(slope), *remarks)))
        else:
            self.slope.object = _html.escaped(f"No derivative by {slope.parameter}: too few sticks.")

    def _no_slope(self, scene: Scene, number: MovableNumber, error: BaseException) -> None:
        if scene is self.scene:
            self.slope.object = _html.escaped(f"No derivative by {number.name}: {error}")

    def _fail(self, error: BaseException) -> None:
        self._alert.param.update(object=_html.escaped(f"The pictures are those of before: {error}"), visible=True)

    def _draw_section(self) -> None:
        if self._tabs.active != 1 or not is_deterministic(self.scene):
            return
        self._section_note.object = _html.escaped(f"Computing over {self._moving.label} ...")
        self._sections.do(
            [(partial(section_of, self.scene, self._moving), self._show_section)],
            lambda error: setattr(self._section_note, "object", _html.escaped(str(error))),
        )  # fmt: skip

    def _show_section(self, section: Any) -> None:
        self._section.show(section)
        self._section_note.object = _html.escaped("From one start at each value, after 100 periods.")

    # --- what is taken away

    def _buttons(self) -> Any:
        copy = pn.widgets.Button(label="Copy as Python", color="primary")
        copy.js_on_click(args={"code": self._code, "button": copy}, code=_COPY)
        toml = pn.widgets.FileDownload(
            callback=self.study_file, filename="study.toml", label="Save as TOML", color="primary"
        )
        figure = pn.widgets.FileDownload(
            callback=self.figures_file, filename="explorer.pdf", label="Save the figure", color="primary"
        )
        return pn.FlexBox(copy, toml, figure)

    def study_file(self) -> io.BytesIO:
        """What is shown as the TOML file of a study. Raises StudyError for what has no section there."""
        scene = self.scene
        config = config_of(**scene._asdict())
        return io.BytesIO(config.to_toml().encode())

    def figures_file(self) -> io.BytesIO:
        """The pictures as a PDF."""
        return io.BytesIO(sheet_of(self.scene))


def _with_unit(slope: Sensitivity) -> str:
    """The derivative, its error and their unit, and then how it was found."""
    unit = slope.unit if slope.parameter_unit == "1" else f"{slope.unit} per {slope.parameter_unit}"
    number, bracket, how = str(slope).replace("+-", "±").partition(" (central")
    return f"{number} {unit}{bracket}{how}"


def _range_of(low: float, high: float) -> str:
    return f"{low:.4g} to {high:.4g}" if math.isfinite(low + high) else ""


def _quietly(function: Any, *arguments: Any) -> tuple[Any, list[str]]:
    """What a function returns, with the sentences of its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RuntimeWarning)
        return function(*arguments), [str(one.message) for one in caught]
