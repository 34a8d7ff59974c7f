"""The page of the explorer: controls on the left, pictures on the right, what connects them, and its server."""

import asyncio
import dataclasses
import io
import math
import secrets
import socket
import sys
import webbrowser
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import panel as pn
from bokeh.document import Document, without_document_lock

from .._foundation import html
from .._sensitivity.estimate import Sensitivity
from . import _explorer_scene as scenes
from ._config import StudyConfig, config_of
from ._explorer_scene import MovableNumber, Scene

# The controls of the explorer: what is simulated, and a slider with a box for each of its numbers.


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
        slider = _Slider(
            label=number.label, start=number.low, end=number.high, step=number.step, value=number.value,
            show_value=False, sizing_mode="stretch_width", margin=(0, 10, 0, 5),
        )  # fmt: skip
        box = _Box(label="value", value=f"{number.value:.6g}", width=_BOX, margin=(0, 0, 0, 5))
        self._slider, self._box = watched(slider, self._slid), watched(box, self._written)
        self._problem = pn.pane.HTML("", visible=False, styles={"color": "#b00020"}, css_classes=["problem"])
        self.view = pn.Column(
            pn.Row(self._slider, self._box, sizing_mode="stretch_width", margin=0),
            self._problem, sizing_mode="stretch_width", margin=0,
        )  # fmt: skip

    def refuse(self, why: str) -> None:
        """Say why the number is not taken."""
        self.problem = why
        # What was written is in it: as text, whatever it is.
        self._problem.param.update(object=html.escaped(why), visible=bool(why))

    def _slid(self, value: float) -> None:
        if not self._is_quiet:
            # The ends of the range and the step are not round in binary.
            self._show(float(f"{value:.6g}"), slider=False)

    def _written(self, text: str) -> None:
        if self._is_quiet:
            return
        try:
            value = scenes.read_number(text)
        except ValueError as error:
            self.refuse(str(error))
        else:
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


def watched(widget: Any, chosen: Callable[[Any], None]) -> Any:
    """The widget; `chosen` is called with each new value of it."""
    widget.param.watch(lambda event: chosen(event.new), "value")
    return widget


def choice(name: str, options: Iterable[str], chosen: Callable[[str], None]) -> pn.widgets.Select:
    """A list to choose from, beside what was given."""
    options = [GIVEN, *options]
    return watched(pn.widgets.Select(label=name, options=options, value=GIVEN, sizing_mode="stretch_width"), chosen)


# Computations beside the page: always of the latest wish, older ones are left out.


Task = Callable[[], Any]
Then = Callable[[Any], object]
Step = tuple[Task, Then]
_FAILURES = (ValueError, OSError, RuntimeError, ImportError)


class Worker:
    """One computation at a time, of the latest wish. Without a `document` (a notebook) it is done at once.

    While it runs the page stays alive, and numbers that move meanwhile replace the wish.
    """

    def __init__(self, document: Document | None, threads: ThreadPoolExecutor):
        self._document, self._threads = document, threads
        self._wish: tuple[Sequence[Step], Then] | None = None
        self._runs = False

    def do(self, steps: Sequence[Step], failed: Then) -> None:
        """Run the task of each step and call its `Then` with what it returned; end at an exception, with `failed`."""
        self._wish = steps, failed
        if self._document is None:
            for task, then in steps:
                show, is_done = _outcome(task, then, failed)
                show()
                if not is_done:
                    break
            self._wish = None
        elif not self._runs:
            self._runs = True
            self._document.add_next_tick_callback(cast(Any, without_document_lock(self._run)))

    async def _run(self) -> None:
        assert self._document is not None
        try:
            while self._wish is not None:
                (steps, failed), self._wish = self._wish, None
                for task, then in steps:
                    loop = asyncio.get_running_loop()
                    show, is_done = await loop.run_in_executor(self._threads, _outcome, task, then, failed)
                    self._document.add_next_tick_callback(cast(Any, show))
                    if not is_done:
                        break
        finally:
            self._runs = False


def _outcome(task: Task, then: Then, failed: Then) -> tuple[Callable[[], None], bool]:
    """What shows the result of a task, or why there is none, and whether there is one."""
    try:
        return partial(_show, then, task()), True
    except _FAILURES as error:
        return partial(_show, failed, error), False


def _show(then: Then, found: Any) -> None:
    with pn.io.hold():  # all that changes goes to the page in one message
        then(found)


# What the explorer shows as a Python program that runs as it is.


_PACKAGE = __name__.partition(".")[0]
_WIDTH = 88


class NotWritable(ValueError):
    """Raised for what has no expression in Python that a program could hold."""


def as_python(scene: Scene) -> str:
    """A program that simulates the same ensemble, prints its statistics and draws its first realisation.

    Raises NotWritable for a system or base made of something else than numbers and objects with fields.
    """
    imports: set[tuple[str, str]] = set()
    is_usual = scene.method == Scene._field_defaults["method"]
    names = ("system", "law", "y0", *(() if is_usual else ("method",)))
    parts = "".join(f"{name} = {_expression(getattr(scene, name), imports)}\n" for name in names)
    option = "" if is_usual else ", method=method"
    own = "".join(f"from {module} import {name}\n" for module, name in sorted(imports) if module != "__main__")
    x64 = "True" if jnp.result_type(float) == jnp.float64 else "False"
    return f"""\
import jax

jax.config.update("jax_enable_x64", {x64})

import stickslip_jax as ss
{own}
{parts}
many = ss.simulate_ensemble(
    system, law, t1={scene.t1!r}, samples={scene.samples},
    key=jax.random.key({scene.seed}), y0=y0{option},
)
print(ss.mean_stick_duration(many))
print(ss.mean_stick_count(many))
print(ss.stick_fraction(many))

first_system, base, start = many.realization(0)
one = ss.simulate(first_system, base, t1={scene.t1!r}, y0=start{option})
ss.plot.save(ss.plot.phase_portrait(one), "phase_portrait.png", overwrite=True)
"""


def _expression(value: Any, imports: set[tuple[str, str]], indent: int = 0) -> str:
    """The Python expression of a value; classes of others are added to `imports`."""
    if isinstance(value, (bool, int, float, str)) or value is None:
        return repr(value)
    if isinstance(value, (np.number, np.ndarray, jax.Array)):
        return repr(np.asarray(value).tolist())
    if isinstance(value, tuple):
        return _call("", [_expression(one, imports, indent + 4) for one in value], indent, comma=len(value) == 1)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        given = [
            f"{field.name}={_expression(getattr(value, field.name), imports, indent + 4)}"
            for field in dataclasses.fields(value)
            if field.init
            and (field.default is dataclasses.MISSING or not eqx.tree_equal(field.default, getattr(value, field.name)))
        ]
        kind = type(value)
        if kind.__module__.partition(".")[0] != _PACKAGE:
            if "." in kind.__qualname__:
                raise NotWritable(f"{kind.__qualname__} is defined in a function, where no program can import it.")
            imports.add((kind.__module__, kind.__qualname__))
            return _call(kind.__name__, given, indent)
        if getattr(sys.modules[_PACKAGE], kind.__name__, None) is not kind:
            raise NotWritable(f"{kind.__name__} has no public name; keep the program that made it.")
        return _call(f"ss.{kind.__name__}", given, indent)
    raise NotWritable(f"{type(value).__name__} cannot be written as Python; keep the program that made it.")


def _call(name: str, arguments: list[str], indent: int, comma: bool = False) -> str:
    line = f"{name}({', '.join(arguments)}{',' if comma else ''})"
    if "\n" not in line and len(line) + indent <= _WIDTH - 12:
        return line
    inside = "".join(f"{' ' * (indent + 4)}{one},\n" for one in arguments)
    return f"{name}(\n{inside}{' ' * indent})"


# The page of the explorer: controls on the left, pictures on the right, and what connects them.


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
        self._moving = scenes.numbers_of(scene)[0]
        document = pn.state.curdoc
        drawing, derivatives = _THREADS
        self._pictures, self._slopes = Worker(document, drawing), Worker(document, derivatives)
        self._sections = Worker(document, derivatives)
        self._is_switching = False
        self._numbers = pn.Column(sizing_mode="stretch_width")
        self._alert = pn.pane.HTML("", visible=False, styles={"color": "#b00020"}, css_classes=["alert-of-scene"])
        self.statistics = pn.pane.HTML(html.escaped(_FIRST), sizing_mode="stretch_width", css_classes=["statistics"])
        self.slope = pn.pane.HTML("", sizing_mode="stretch_width", css_classes=["slope"])
        self._code = pn.widgets.TextAreaInput(
            label="Python", rows=12, disabled=True, sizing_mode="stretch_width", max_length=100_000,
            stylesheets=[_TO_BE_READ],
        )  # fmt: skip
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

    # --- what is chosen

    def _choices(self) -> list[Any]:
        scene = self.scene
        self._lists = {
            "System": choice("System", scenes.SYSTEMS, self._choose_system),
            "Friction": choice("Friction", scenes.FRICTIONS, self._choose_friction),
            "Base": choice("Base", scenes.bases_for(scene), self._choose_base),
        }
        self._lists["Friction"].visible = scenes.has_friction_to_choose(scene.system)
        size = pn.widgets.IntInput(label="Realisations", value=scene.samples, start=2, end=MOST_SAMPLES, width=130)
        seed = pn.widgets.IntInput(label="Seed", value=scene.seed, start=0, end=2**32 - 1, width=130)
        counts = watched(size, partial(self._count, "samples")), watched(seed, partial(self._count, "seed"))
        return [*self._lists.values(), pn.Row(*counts)]

    def _choose_system(self, name: str) -> None:
        new = self._given if name == GIVEN else scenes.scene_of(StudyConfig.model_validate(dict(scenes.SYSTEMS[name])))
        self.scene = self._start = new._replace(samples=self.scene.samples, seed=self.scene.seed)
        self._is_switching = True
        try:
            self._lists["Friction"].param.update(value=GIVEN, visible=scenes.has_friction_to_choose(new.system))
            self._lists["Base"].param.update(options=[GIVEN, *scenes.bases_for(self.scene)], value=GIVEN)
        finally:
            self._is_switching = False
        self._renew()

    def _choose_friction(self, name: str) -> None:
        if self._is_switching:
            return
        now = self.scene.system
        new = self._start.system if name == GIVEN else scenes.with_friction(now, scenes.friction_called(name, now))
        self.scene = self.scene._replace(system=new)
        self._renew()

    def _choose_base(self, name: str) -> None:
        if self._is_switching:
            return
        law = self._start.law if name == GIVEN else scenes.bases_for(self.scene)[name]
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
        numbers = scenes.numbers_of(self.scene)
        self.controls = [NumberControl(number, self._moved) for number in numbers]
        self._numbers.objects = [one.view for one in self.controls]
        self._moving = next((one for one in numbers if one.path[-1] in ("mu", "mu_static")), numbers[0])
        self._figures = scenes.Figures(self.scene)
        panes = [pn.pane.Bokeh(one, sizing_mode="stretch_width", margin=0) for one in self._figures.all]
        motion = pn.Column(
            pn.FlexBox(self.statistics, self.slope), pn.Column(*panes, styles=_GRID, sizing_mode="stretch_width"),
            sizing_mode="stretch_width",
        )  # fmt: skip
        tabs: list[Any] = [("Motion and statistics", motion)]
        self._section = scenes.SectionFigure(self.scene)
        if scenes.is_deterministic(self.scene):
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
        motion = partial(scenes.motion_of, scene), partial(self._show_motion, scene, figures)
        statistics = partial(scenes.statistics_of, scene), partial(self._show_statistics, scene, moving, figures)
        self._pictures.do([motion, statistics], self._fail)

    def _differentiate(self, scene: Scene, moving: MovableNumber) -> None:
        if moving.path == ("t1",):
            self.slope.object = ""
            return
        self.slope.object = html.escaped(f"Computing the derivative by {moving.name} ...")
        slope = partial(scenes.slope_of, scene, moving.name), partial(self._show_slope, scene)
        self._slopes.do([slope], partial(self._no_slope, scene, moving))

    def _show_motion(self, scene: Scene, figures: scenes.Figures, motion: scenes.Motion) -> None:
        figures.show_motion(scene, motion)
        self._alert.param.update(object=html.escaped(motion.problem), visible=bool(motion.problem))
        try:
            self._code.value = as_python(scene)
        except ValueError as error:
            self._code.value = f"# {error}"

    def _show_statistics(
        self, scene: Scene, moving: MovableNumber, figures: scenes.Figures, statistics: scenes.Statistics
    ) -> None:
        figures.show_statistics(statistics)
        rows = []
        for one in statistics.means:
            low, high = one.interval()
            between = f"{low:.4g} to {high:.4g}" if math.isfinite(low + high) else ""
            rows.append((one.name, one.without_name().replace("+-", "±"), between))
        table = html.table(rows, ("of all realisations", "mean", "95 % interval"))
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
            # The derivative, its error and their unit, and then how it was found.
            unit = slope.unit if slope.parameter_unit == "1" else f"{slope.unit} per {slope.parameter_unit}"
            number, bracket, how = str(slope).replace("+-", "±").partition(" (central")
            self.slope.object = "".join(map(html.escaped, (f"{number} {unit}{bracket}{how}", *remarks)))
        else:
            self.slope.object = html.escaped(f"No derivative by {slope.parameter}: too few sticks.")

    def _no_slope(self, scene: Scene, number: MovableNumber, error: BaseException) -> None:
        if scene is self.scene:
            self.slope.object = html.escaped(f"No derivative by {number.name}: {error}")

    def _fail(self, error: BaseException) -> None:
        self._alert.param.update(object=html.escaped(f"The pictures are those of before: {error}"), visible=True)

    def _draw_section(self) -> None:
        if self._tabs.active != 1 or not scenes.is_deterministic(self.scene):
            return
        self._section_note.object = html.escaped(f"Computing over {self._moving.label} ...")
        section = partial(scenes.section_of, self.scene, self._moving), partial(self._show_section, self._moving)
        self._sections.do([section], lambda error: self._section_note.param.update(object=html.escaped(str(error))))

    def _show_section(self, over: MovableNumber, points: scenes.Data) -> None:
        self._section.show(over, points)
        self._section_note.object = html.escaped("From one start at each value, after 100 periods.")

    # --- what is taken away

    def _buttons(self) -> Any:
        copy = pn.widgets.Button(label="Copy as Python", color="primary")
        copy.js_on_click(args={"code": self._code, "button": copy}, code=_COPY)
        download = partial(pn.widgets.FileDownload, color="primary")
        toml = download(callback=self.study_file, filename="study.toml", label="Save as TOML")
        figure = download(callback=self.figures_file, filename="explorer.pdf", label="Save the figure")
        return pn.FlexBox(copy, toml, figure)

    def study_file(self) -> io.BytesIO:
        """What is shown as the TOML file of a study. Raises StudyError for what has no section there."""
        return io.BytesIO(config_of(**self.scene._asdict()).to_toml().encode())

    def figures_file(self) -> io.BytesIO:
        """The pictures as a PDF."""
        return io.BytesIO(scenes.sheet_of(self.scene))


# The explorer as a page that this machine serves to its own browser, and to nobody else.
#
# It listens on the loopback address. All addresses begin with a secret, so that only who was told it gets a page, and
# data comes only from pages of the same origin (Bokeh checks it): another page in the same browser, which can guess the
# port, has neither. What pages send are values of controls; none is run.


ADDRESS = "127.0.0.1"


def serve(scene: Scene, *, port: int, opens: bool, say: Callable[[str], None]) -> None:
    """Serve the explorer until Ctrl-C. `port` 0: any free one. Raises OSError for one that is taken."""
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((ADDRESS, port))
        except OSError as error:
            raise OSError(
                f"Port {port} cannot be used ({error.strerror}); choose another, or 0 for any free one."
            ) from None
        port = tried.getsockname()[1]
    secret = secrets.token_urlsafe(24)
    address = f"http://{ADDRESS}:{port}/{secret}/"
    server: Any = pn.serve(
        {"": lambda: Explorer(scene)}, address=ADDRESS, port=port, prefix=secret, show=False, start=False,
        websocket_origin=[f"{ADDRESS}:{port}"], title="stickslip explorer", verbose=False, threaded=False,
    )  # fmt: skip
    say(f"The explorer is at {address}\nCtrl-C ends it.")
    if opens:
        webbrowser.open(address)
    try:
        server.start()
        server.io_loop.start()
    finally:
        server.stop()
