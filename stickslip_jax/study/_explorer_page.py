"""The page of the explorer: controls on the left, pictures on the right, what connects them, and its server."""

import asyncio
import io
import logging
import math
import multiprocessing
import pickle
import secrets
import signal
import socket
import time
import webbrowser
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import panel as pn
from bokeh.document import Document, without_document_lock
from tornado.routing import HostMatches, Rule
from tornado.web import OutputTransform
from tornado.websocket import WebSocketClosedError

from .._compiler import programs
from .._foundation import html
from .._sensitivity.estimate import Sensitivity
from . import _explorer_scene as scenes
from ._config import config_of
from ._explorer_scene import MovableNumber, Scene
from ._reading import MOST_SAMPLES

# The controls of the explorer: what is simulated, and a slider with a box for each of its numbers.


_BOX = 96  # px
_RED = "light-dark(#b00020, #ff8a80)"
_UNSEEN = "label { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }"
# Bokeh's own are black on dark pages too.
_OWN_ARROW = "select.bk-input:not([multiple]):not([size]) { appearance: auto; background-image: none; }"
_SPIN_ARROWS = ".bk-spin-btn { --color: CanvasText; }"


_COLLECTED = 20  # ms: of the moves of a slider in between only the last is taken (Panel collects those of 50 ms)


class _Slider(pn.widgets.FloatSlider):
    """A slider whose moves are told soon."""

    _debounce = _COLLECTED


class _Box(pn.widgets.TextInput):
    """The same for a box."""

    _debounce = _COLLECTED


class NumberControl:
    """A slider, and a box for a number that the slider does not reach. `moved` is called with it and a number.

    A box with something else in it says what is wrong, and nothing moves. `problem` is that, or "".
    """

    def __init__(self, number: MovableNumber, moved: Callable[["NumberControl", MovableNumber], None]):
        self.number, self.problem = number, ""
        self._moved, self._is_quiet = moved, False
        slider = _Slider(
            label=number.label, start=number.low, end=number.high, step=number.step, value=number.value,
            show_value=False, sizing_mode="stretch_width", margin=(0, 15, 0, 10),
        )  # fmt: skip
        # Screen readers read the label of the box; others see that of the slider, on the same line.
        box = _Box(
            label=f"{number.label}, as a number", value=f"{number.value:.6g}", width=_BOX, margin=(2, 10, 2, 0),
            align="center", stylesheets=[_UNSEEN],
        )  # fmt: skip
        self._slider, self._box = watched(slider, self._slid), watched(box, self._written)
        self._problem = pn.pane.HTML("", visible=False, styles={"color": _RED}, css_classes=["problem"])
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
    box = pn.widgets.Select(label=name, options=[GIVEN, *options], value=GIVEN, sizing_mode="stretch_width")
    box.stylesheets = [_OWN_ARROW]
    return watched(box, chosen)


# Computations beside the page, in processes of their own: nothing else ends a compilation, or a loop of XLA.


_CONTEXT: Any = multiprocessing.get_context(
    "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
)
_PROCESSES = 4  # at most: so many pages compute at a time
_REMEMBERED = 32  # results: many pages begin with the same
_FAILURES = (ValueError, OSError, RuntimeError, ImportError, MemoryError)

Task = tuple[Callable[..., Any], tuple[Any, ...]]
Then = Callable[[Any], object]
Step = tuple[Task, Then]


class _Process:
    """A process that computes one thing after the other. `end` ends it at once, whatever it does."""

    def __init__(self) -> None:
        self._connection: Any = None
        self._process: Any = None
        self._is_over = False

    def compute(self, message: bytes, told: Callable[[str], object]) -> Any:
        """What a pickled task returns; `told` hears "compiling" and "simulating".

        Raises RuntimeError where the task fails, with a sentence; EOFError or ConnectionError where the process ended.
        """
        if self._process is None:
            self._connection, other = _CONTEXT.Pipe()
            is_double = jnp.result_type(float) == jnp.float64
            process = _CONTEXT.Process(target=_serve_tasks, args=(other, is_double), daemon=True)
            process.start()
            self._process = process  # from now on `end` can end it; if it was called meanwhile, that is done below
            other.close()
        if self._is_over:
            self.end()
            raise EOFError
        self._connection.send_bytes(message)
        while isinstance(found := self._connection.recv(), str):
            told(found)
        is_done, value = found
        if is_done:
            return value
        raise RuntimeError(value)

    def end(self) -> None:
        self._is_over = True
        if self._process is not None:
            self._process.kill()


def _serve_tasks(connection: Any, is_double: bool) -> None:
    """Compute what comes, until the process is ended, or that which sent it is no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that serves the pages
    jax.config.update("jax_enable_x64", is_double)
    programs.hears_compiling = lambda compiles: connection.send("compiling" if compiles else "simulating")
    with suppress(EOFError, ConnectionError):
        while True:
            task, given = pickle.loads(connection.recv_bytes())
            connection.send("simulating")
            try:
                found = True, task(*given)
            except _FAILURES as error:
                found = False, str(error)
            except Exception as error:  # a mistake of the package: said in the page, which goes on
                found = False, f"{type(error).__name__}: {error}"
            connection.send(found)


class Processes:
    """The processes of all pages: each task gets a free one, in turn. `end` ends them all."""

    def __init__(self) -> None:
        if _CONTEXT.get_start_method() == "forkserver":  # what it has imported, all processes have
            _CONTEXT.set_forkserver_preload([scenes.__name__])
        self._threads = ThreadPoolExecutor(_PROCESSES, "explorer")
        self._free, self._idle = asyncio.Semaphore(_PROCESSES), list[_Process]()
        self._all, self._found = set[_Process](), dict[bytes, Any]()

    async def run(self, task: Task, told: Callable[[str], object] = lambda word: None) -> Any:
        """What the task returns. Who cancels this ends its process. Raises RuntimeError if that ended by itself."""
        told("waiting for other pages")
        message = pickle.dumps(task)
        async with self._free:
            if message in self._found:  # another page asked it
                return self._found[message]
            told("starting")
            process = self._idle.pop() if self._idle else _Process()
            self._all.add(process)
            loop = asyncio.get_running_loop()
            try:
                found = await loop.run_in_executor(self._threads, process.compute, message, told)
            except RuntimeError:
                self._idle.append(process)
                raise
            except BaseException as error:
                self._all.discard(process)
                process.end()
                if isinstance(error, asyncio.CancelledError):
                    raise
                raise RuntimeError("The computation ended by itself; there may not be enough memory for it.") from None
            self._idle.append(process)
            self._found[message] = found
            while len(self._found) > _REMEMBERED:
                self._found.pop(next(iter(self._found)))
            return found

    def end(self) -> None:
        """End all of them."""
        for process in tuple(self._all):
            process.end()
        self._threads.shutdown(wait=False, cancel_futures=True)


class Worker:
    """Computes for one page, always the latest wish; without `processes` (in a notebook) at once.

    While it computes, `waits` is told what it does, and for how many seconds. A newer wish overtakes: one for another
    system at once; one for other numbers after `_PATIENCE`, but not while their program is compiled: they need it too.
    """

    _LOOK, _PATIENCE = 0.25, 1.0  # s

    def __init__(self, document: Document | None, processes: Processes | None, waits: Callable[[str, float], object]):
        self._document, self._processes, self._waits = document, processes, waits
        self._wish: tuple[Sequence[Step], Then] | None = None
        self._runs, self._is_other, self._word = False, False, ""
        self._call: asyncio.Future[Any] | None = None

    def do(self, steps: Sequence[Step], failed: Then, *, is_other: bool = False) -> None:
        """Run the task of each step and call its `Then` with what it returned; end at an exception, with `failed`."""
        if self._document is None or self._processes is None:
            for (task, given), then in steps:
                try:
                    found = task(*given)
                except _FAILURES as error:
                    _show(failed, error)
                    break
                _show(then, found)
            return
        self._wish, self._is_other = (steps, failed), self._is_other or is_other
        if not self._runs:
            self._runs = True
            self._document.add_next_tick_callback(cast(Any, without_document_lock(self._run)))

    def leave(self) -> None:
        """Leave what was wished; end what simulates, and let go on what compiles."""
        self._wish = None
        if self._call is not None and self._word != "compiling":
            self._call.cancel()

    def cancel(self) -> None:
        """Leave it, and end what computes."""
        self._wish = None
        if self._call is not None:
            self._call.cancel()

    async def _run(self) -> None:
        assert self._processes is not None
        try:
            while self._wish is not None:
                (steps, failed), self._wish, self._is_other = self._wish, None, False
                begin = time.monotonic()
                for task, then in steps:
                    self._call = asyncio.ensure_future(self._processes.run(task, self._hear))
                    while not (await asyncio.wait({self._call}, timeout=self._LOOK))[0]:
                        seconds = time.monotonic() - begin
                        self._later(self._waits, self._word, seconds)
                        is_late = seconds > self._PATIENCE and self._word != "compiling"
                        if self._wish is not None and (self._is_other or is_late):
                            self._call.cancel()
                    if self._call.cancelled():
                        break
                    if (error := self._call.exception()) is not None:
                        self._later(_show, failed, error)
                        break
                    self._later(_show, then, self._call.result())
                    if self._wish is not None:
                        break
        finally:
            self._runs, self._call = False, None

    def _hear(self, word: str) -> None:
        self._word = word

    def _later(self, show: Callable[..., object], *given: Any) -> None:
        """Change the page, unless it was closed meanwhile."""
        assert self._document is not None
        if self._document.session_context is not None and not self._document.session_context.destroyed:
            self._document.add_next_tick_callback(cast(Any, partial(show, *given)))


def _show(then: Then, found: Any) -> None:
    with pn.io.hold():  # all that changes goes to the page in one message
        then(found)


# The page of the explorer: controls on the left, pictures on the right, and what connects them.


GIVEN = "as given"
_SIDE = {"flex": "1 1 320px", "min-width": "0"}
_MAIN = {"flex": "999 1 560px", "min-width": "0"}
_ROWS_OF_NUMBERS = {
    "display": "grid",
    "grid-template-columns": "repeat(auto-fit, minmax(280px, 1fr))",
    "column-gap": "20px",
}
_GRID = {"display": "grid", "grid-template-columns": "repeat(auto-fit, minmax(min(100%, max(420px, 40%)), 1fr))"}
_NEW, _OLD = {"opacity": "1", "filter": "none"}, {"opacity": "0.3", "filter": "grayscale(1)"}
_TO_BE_READ = "textarea.bk-input[disabled] { opacity: 1; font-family: monospace; }"
_TABS = ".bk-header .bk-tab, .bk-header .bk-tab.bk-active { color: inherit; background: none; }"
_COPY = """
navigator.clipboard.writeText(code.value).then(() => { button.label = "Copied"; });
setTimeout(() => { button.label = "Copy as Python"; }, 2000);
"""
_HEAD = """
<h1>Stick-slip explorer</h1>
<p>One realisation of the motion, thin and grey where the body slips, thick and orange where friction holds it; and the
sticks of all realisations: means, histograms, and the derivative of their mean duration.</p>
<details><summary>Help</summary><ul>
<li>Choose a system, a friction law and what drives it. Each number has a slider and a box; the box takes numbers that
the slider does not reach. Arrow keys move a slider by a step.</li>
<li>All that is grey and pale belongs to numbers of before: the new ones are computed. The first time a system is shown
its programs are compiled, which can take a minute. "Cancel" ends it, and so does what you choose next.</li>
<li>The derivative, and on a base without randomness the bifurcation diagram on its tab, are by the number that was
moved last.</li></ul></details>
"""
_HEAD_STYLE = "h1 { font-size: 1.4em; margin: 0 0 4px; } p { margin: 0 0 4px; max-width: 75em; } ul { margin: 4px 0; }"
_TABLE = "td, th { text-align: left; padding: 2px 12px 2px 0; } td { font-variant-numeric: tabular-nums; }"


class Explorer(pn.viewable.Viewer):
    """A system and what it does, as a page in a browser or the output of a cell in a notebook.

    - `scene`: what is shown now.
    - `controls`: of its numbers. `statistics`, `slope`: panes with the means and the derivative. `tabs`: their names.
    """

    def __init__(self, scene: Scene, processes: Processes | None = None, **params: Any):
        super().__init__(**params)
        self.scene, self._start, self._given = scene, scene, scene
        self._processes = processes
        self._moving = scenes.numbers_of(scene)[0]
        document = pn.state.curdoc
        self._pictures = Worker(document, processes, self._wait)
        self._slopes = Worker(document, processes, self._wait_for_slope)
        self._sections = Worker(document, processes, self._wait_for_section)
        if document is not None and processes is not None:
            pn.state.on_session_destroyed(lambda session_context: self._leave())
        self._is_switching = False
        self._numbers = pn.Column(sizing_mode="stretch_width", styles=_ROWS_OF_NUMBERS)
        self._status = pn.pane.HTML("", sizing_mode="stretch_width", css_classes=["status"])
        self._cancel = pn.widgets.Button(label="Cancel", disabled=True)
        self._cancel.on_click(lambda _: self._stop())
        self._alert = pn.pane.HTML("", visible=False, styles={"color": _RED}, css_classes=["alert-of-scene"])
        self.statistics = pn.pane.HTML("", css_classes=["statistics"], stylesheets=[_TABLE])
        self.slope = pn.pane.HTML("", sizing_mode="stretch_width", css_classes=["slope"])
        self._code = pn.widgets.TextAreaInput(
            label="Python", rows=12, disabled=True, sizing_mode="stretch_width", max_length=100_000,
            stylesheets=[_TO_BE_READ],
        )  # fmt: skip
        self._section_note = pn.pane.HTML("", css_classes=["section-note"])
        self._tabs = pn.Tabs(sizing_mode="stretch_width", stylesheets=[_TABS])
        self._tabs.param.watch(lambda _: self._draw_section(), "active")
        self._results = pn.Column(self.statistics, self.slope, self._tabs, css_classes=["results"], styles=_NEW)
        self._results.sizing_mode = "stretch_width"
        head = pn.pane.HTML(_HEAD, sizing_mode="stretch_width", stylesheets=[_HEAD_STYLE])
        state = pn.Row(self._cancel, self._status, sizing_mode="stretch_width")
        self._view = pn.Column(
            head,
            pn.FlexBox(
                pn.Column(*self._choices(), self._numbers, styles=_SIDE),
                pn.Column(state, self._alert, self._results, self._buttons(), self._code, styles=_MAIN),
                sizing_mode="stretch_width",
            ),
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
        look: dict[str, Any] = {"width": 130, "stylesheets": [_SPIN_ARROWS]}
        size = pn.widgets.IntInput(label="Realisations", value=scene.samples, start=2, end=MOST_SAMPLES, **look)
        seed = pn.widgets.IntInput(label="Seed", value=scene.seed, start=0, end=2**32 - 1, **look)
        self._counts = watched(size, partial(self._count, "samples")), watched(seed, partial(self._count, "seed"))
        reset = pn.widgets.Button(label="Reset", align="end")
        reset.on_click(lambda _: self._begin_with(self._given, GIVEN))
        return [*self._lists.values(), pn.FlexBox(*self._counts, reset)]

    def _choose_system(self, name: str) -> None:
        if not self._is_switching:
            new = self._given if name == GIVEN else scenes.scene_called(name)
            self._begin_with(new._replace(samples=self.scene.samples, seed=self.scene.seed), name)

    def _begin_with(self, scene: Scene, name: str) -> None:
        self.scene = self._start = scene
        self._is_switching = True
        try:
            self._lists["System"].value = name
            self._lists["Friction"].param.update(value=GIVEN, visible=scenes.has_friction_to_choose(scene.system))
            self._lists["Base"].param.update(options=[GIVEN, *scenes.bases_for(scene)], value=GIVEN)
            for box, number in zip(self._counts, (scene.samples, scene.seed), strict=True):
                box.value = number
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
        if number is not None and not self._is_switching:
            self.scene = self.scene._replace(**{which: number})
            self._compute()

    def _moved(self, control: NumberControl, number: MovableNumber) -> None:
        try:
            self.scene = self.scene.with_number(number.path, number.value)
        except ValueError as error:
            control.refuse(self._in_words(error))
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
        tabs: list[Any] = [("Motion and statistics", pn.Column(*panes, styles=_GRID, sizing_mode="stretch_width"))]
        self._section = scenes.SectionFigure(self.scene)
        if scenes.is_deterministic(self.scene):
            section = pn.Column(
                self._section_note, pn.pane.Bokeh(self._section.plot, sizing_mode="stretch_width"),
                sizing_mode="stretch_width",
            )  # fmt: skip
            tabs.append(("Bifurcation", section))
        self.tabs = [name for name, _ in tabs]
        self.statistics.object = self._section_note.object = ""
        self._tabs[:] = tabs
        self._compute(is_other=True)

    def _compute(self, *, is_other: bool = False) -> None:
        """Simulate anew; the derivative and the diagram come after the pictures, for which they leave the processor.

        Until then all that is shown is marked as old. `is_other`: another system than that which is computed now.
        """
        scene, figures = self.scene, self._figures
        self._results.styles = _OLD
        self._alert.visible, self._cancel.disabled = False, self._processes is None
        self._status.object = "Simulating ..."
        self.slope.object = ""
        try:
            self._code.value = scenes.as_python(scene)
        except ValueError as error:
            self._code.value = f"# {error}"
        for beside in (self._slopes, self._sections):
            beside.leave()
        motion: Step = (scenes.motion_of, (scene,)), partial(self._show_motion, scene, figures)
        statistics: Step = (scenes.statistics_of, (scene,)), partial(self._show_statistics, scene, figures)
        self._pictures.do([motion, statistics], self._fail, is_other=is_other)

    def _show_motion(self, scene: Scene, figures: scenes.Figures, motion: scenes.Motion) -> None:
        figures.show_motion(scene, motion)
        self._alert.param.update(object=html.escaped(motion.problem), visible=bool(motion.problem))

    def _show_statistics(self, scene: Scene, figures: scenes.Figures, statistics: scenes.Statistics) -> None:
        figures.show_statistics(statistics)
        table = html.table(statistics.rows, ("of all realisations", "mean ± standard error", "95 % interval"))
        left = f"<p>{statistics.unfinished:,} of {scene.samples:,} realisations did not finish.</p>"
        if scene is not self.scene:  # numbers have moved on: another result is under way
            return
        self.statistics.object = table + (left if statistics.unfinished else "")
        self._results.styles = _NEW
        self._status.object = ""
        self._differentiate(scene, self._moving)
        self._draw_section()

    def _differentiate(self, scene: Scene, moving: MovableNumber) -> None:
        if moving.path == ("t1",):
            self._cancel.disabled = True
            return
        self._wait_for_slope("simulating", 0.0)
        slope: Step = (scenes.slope_of, (scene, moving.name)), partial(self._show_slope, scene)
        self._slopes.do([slope], partial(self._no_slope, scene))

    def _show_slope(self, scene: Scene, found: tuple[Sensitivity, list[str]]) -> None:
        if scene is not self.scene:  # of other numbers than are shown
            return
        slope, remarks = found
        self._cancel.disabled = True
        if math.isfinite(slope.derivative):
            # The derivative, its error and their unit, and then how it was found.
            unit = slope.unit if slope.parameter_unit == "1" else f"{slope.unit} per {slope.parameter_unit}"
            number, bracket, how = str(slope).replace("+-", "±").partition(": ")[2].partition(" (central")
            said = f"Derivative of the {slope.statistic} by {slope.parameter}: {number} {unit}{bracket}{how}"
        else:
            said = f"No derivative by {slope.parameter}: too few sticks"
        self.slope.object = "".join(f"<p>{html.escaped(self._in_words(one))}</p>" for one in (said, *remarks))

    def _no_slope(self, scene: Scene, error: BaseException) -> None:
        if scene is self.scene:
            self._cancel.disabled = True
            self.slope.object = html.escaped(f"No derivative by {self._name}: {self._in_words(error)}")

    def _fail(self, error: BaseException) -> None:
        self._status.object = "Pale pictures and numbers are those of before."
        self._cancel.disabled = True
        self._alert.param.update(object=html.escaped(self._in_words(error)), visible=True)

    def _draw_section(self) -> None:
        if self._tabs.active != 1 or not scenes.is_deterministic(self.scene):
            return
        self._wait_for_section("simulating", 0.0)
        section: Step = (scenes.section_of, (self.scene, self._moving)), partial(self._show_section, self._moving)
        self._sections.do([section], self._no_section)

    def _show_section(self, over: MovableNumber, found: tuple[scenes.Data, str]) -> None:
        points, note = found
        self._section.show(over, points)
        self._section_note.object = html.escaped(note)

    def _no_section(self, error: BaseException) -> None:
        self._section_note.object = html.escaped(f"No diagram over {self._name}: {self._in_words(error)}")

    # --- what is waited for

    @property
    def _name(self) -> str:
        return scenes.without_unit(self._moving.label)

    def _in_words(self, said: object) -> str:
        return scenes.in_words(str(said), [one.number for one in self.controls])

    def _wait(self, word: str, seconds: float) -> None:
        self._status.object = html.escaped(f"{word.capitalize()}, {seconds:.0f} s")

    def _wait_for_slope(self, word: str, seconds: float) -> None:
        self.slope.object = html.escaped(f"Derivative by {self._name}: {word}, {seconds:.0f} s")

    def _wait_for_section(self, word: str, seconds: float) -> None:
        self._section_note.object = html.escaped(f"Diagram over {self._name}: {word}, {seconds:.0f} s")

    def _leave(self) -> None:
        for worker in (self._pictures, self._slopes, self._sections):
            worker.cancel()

    def _stop(self) -> None:
        """End what is computed, at the reader's wish."""
        self._leave()
        self._cancel.disabled = True
        is_old = self._results.styles == _OLD
        self._status.object = "Cancelled." + (" Pale pictures and numbers are those of before." if is_old else "")
        self.slope.object = ""

    # --- what is taken away

    def _buttons(self) -> Any:
        copy = pn.widgets.Button(label="Copy as Python", color="primary")
        copy.js_on_click(args={"code": self._code, "button": copy}, code=_COPY)
        download = partial(pn.widgets.FileDownload, color="primary")
        toml = download(callback=self.study_file, filename="study.toml", label="Save as TOML")
        drawn = self.figures_file if self._processes is None else self._figures_apart
        figure = download(callback=drawn, filename="explorer.pdf", label="Save the figure")
        return pn.FlexBox(copy, toml, figure)

    def study_file(self) -> io.BytesIO:
        """What is shown as the TOML file of a study. Raises StudyError for what has no section there."""
        return io.BytesIO(config_of(**self.scene._asdict()).to_toml().encode())

    def figures_file(self) -> io.BytesIO:
        """The pictures as a PDF."""
        return io.BytesIO(scenes.sheet_of(self.scene))

    async def _figures_apart(self) -> io.BytesIO:
        assert self._processes is not None
        return io.BytesIO(await self._processes.run((scenes.sheet_of, (self.scene,))))


# The explorer as a page that this machine serves to its own browser, and to nobody else.
#
# It listens on the loopback address. All addresses begin with a secret, so that only who was told it gets a page, and
# data comes only from pages of the same origin (Bokeh checks it): another page in the same browser, which can guess the
# port, has neither. A name of another host that leads here (DNS rebinding) is not answered. What pages send are values
# of controls; none is run.


ADDRESS = "127.0.0.1"
_HEADERS = {
    # Bokeh makes functions of the scripts that a page brings along, and Panel asks by a blob what modules can do.
    "Content-Security-Policy": "default-src 'self'; script-src 'self' blob: 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_ICON = (
    "data:image/svg+xml,<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 8 8'><path d='M0 6h3l2-4h3' fill='none' "
    "stroke='%23D55E00' stroke-width='1.5'/></svg>"
)
_TEXT, _PAPER, _SURFACE, _LINE = "#dee2e6", "#212529", "#343a40", "#495057"
_DARK = {
    "background-fill-color": _PAPER, "border-fill-color": _PAPER, "outline-line-color": _LINE, "grid-line-color": _LINE,
    "text-color": _TEXT, "axis-label-text-color": _TEXT, "major-label-text-color": _TEXT, "label-text-color": _TEXT,
    "axis-line-color": _TEXT, "major-tick-line-color": _TEXT,
}  # fmt: skip
"""Colours of Bokeh's figures where the reader's browser prefers dark pages."""


class _Headers(OutputTransform):
    """Adds `_HEADERS` to each answer."""

    def transform_first_chunk(self, status_code: int, headers: Any, chunk: bytes, finishing: bool) -> Any:
        headers.update(_HEADERS)
        return status_code, headers, chunk


def _page() -> Any:
    """The template of the page: Panel's, of the reader's width and in the reader's colours."""
    names = {"background": _PAPER, "background-text": _TEXT, "surface": _SURFACE, "surface-text": _TEXT}
    colors = {f"--design-{name}-color": color for name, color in names.items()}
    colors |= {f"--bk-{name}": color for name, color in _DARK.items()}
    dark = "".join(f"{name}: {color};" for name, color in colors.items())
    style = "html { color-scheme: light dark; background: Canvas; } body { margin: 8px; }"
    style += f"@media (prefers-color-scheme: dark) {{ html:root {{ {dark} background: {_PAPER}; color: {_TEXT}; }} }}"
    viewport = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    page = pn.Template(f"{{% extends base %}}{{% block postamble %}}{viewport}<style>{style}</style>{{% endblock %}}")
    page.add_variable("app_favicon", _ICON)
    return page


def _but_for_closed_pages(loop: asyncio.AbstractEventLoop, failure: dict[str, Any]) -> None:
    if not isinstance(failure.get("exception"), WebSocketClosedError):
        loop.default_exception_handler(failure)


def serve(scene: Scene, *, port: int, opens: bool, say: Callable[[str], None]) -> None:
    """Serve the explorer until Ctrl-C or SIGTERM, then call what handles it elsewhere. `port` 0: any free one.

    Raises OSError for a port that is taken.
    """
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
    processes = Processes()

    def page() -> Any:
        template = _page()
        template.add_panel("explorer", Explorer(scene, processes))
        return template

    server: Any = pn.serve(
        {"": page}, address=ADDRESS, port=port, prefix=secret, show=False, start=False,
        websocket_origin=[f"{ADDRESS}:{port}"], title="stickslip explorer", verbose=False, threaded=False,
    )  # fmt: skip
    server._tornado.transforms.append(_Headers)
    server._tornado.default_router.rules[:] = [Rule(HostMatches(ADDRESS), server._tornado.wildcard_router)]
    # A page that closes while it is sent something is no fault.
    logging.getLogger("bokeh.server.views.ws").setLevel(logging.ERROR)
    server.io_loop.asyncio_loop.set_exception_handler(_but_for_closed_pages)
    loop, stops = server.io_loop.asyncio_loop, list[signal.Signals]()

    def stop(number: signal.Signals) -> None:
        stops.append(number)
        loop.stop()

    # Between two callbacks: the loop reports what is raised inside one, and goes on.
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    usual = {number: handler for number, handler in usual.items() if callable(handler)}
    with suppress(NotImplementedError):  # Windows
        for number in usual:
            loop.add_signal_handler(number, stop, number)
    say(f"The explorer is at {address}\nCtrl-C ends it.")
    if opens:
        webbrowser.open(address)
    try:
        server.start()
        # The first page shows what these find; a process is ready before it is asked for.
        for task in (scenes.motion_of, scenes.statistics_of):
            server.io_loop.add_callback(processes.run, (task, (scene,)))
        server.io_loop.start()
    finally:
        processes.end()
        server.stop()
        for number, handler in usual.items():
            with suppress(NotImplementedError):
                loop.remove_signal_handler(number)
            signal.signal(number, handler)
    for number in stops:
        usual[number](number, None)
