"""A moving picture of one trajectory: its mechanism, and below it the history that grows."""

import base64
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from .. import _checks
from .._ensemble.progress import progress_bar
from .._excitation.ground import GroundMotion
from .._files import file_for_user, file_to_write
from .._simulation.result import Simulation
from .._systems.mechanism import Belt, Disk, Mechanism
from . import _films, _parts, _style
from ._contacts import line_times
from ._frames import Stuck, base_displacement, checked_speed, frame_times, state_at, sticks_of, velocity_at
from ._legends import legend_above
from ._moving_parts import Move, check_mechanism, draw_parts
from ._trajectory import check_simulation, check_window
from ._types import Window
from ._windows import phases_in

_WRITERS = {".gif": _films.gif, ".mp4": _films.mp4}
_NOTEBOOK_DPI = 80.0
_NAMES_IN_A_ROW, _MOST_NAMES = 6, 18  # under bars: more are turned, and of more not all are written


class Animation:
    """A moving picture: what `animate` returns. A notebook plays it.

    Attributes:
        figure: The figure that shows one frame at a time.
        times: What time of the motion each frame shows, s, (frames,).
        speed: Seconds of motion in one second of film.
        fps: Frames per second.
    """

    def __init__(self, figure: Figure, move: Move, times: np.ndarray, speed: float, fps: float):
        self.figure, self.times, self.speed, self.fps = figure, times, speed, fps
        self._move = move
        self._html: str | None = None

    def frame(self, number: int) -> Figure:
        """The figure with one frame: ``animation.frame(0).savefig("first.pdf")``.

        Args:
            number: Of the frame, from 0; negative ones count from the last.

        Raises:
            ValueError: For a number that no frame has.
        """
        frames = len(self.times)
        number = _checks.whole_number("number", number, minimum=-frames, maximum=frames - 1)
        self._move(number % frames)
        return self.figure

    def save(
        self, path: str | Path, *, dpi: float | int = 100, progress: bool | None = None, overwrite: bool = False
    ) -> None:
        """Write the film to a file.

        Args:
            path: A file name that ends in .gif, or in .mp4, which the program ffmpeg makes.
            dpi: Dots per inch.
            progress: Whether to show a progress bar; by default on a terminal and, after a second, in a notebook.
            overwrite: Whether to replace a file of that name. Until the new one is whole, an older one stays.

        Raises:
            ValueError: For another file name, and for arguments of another kind.
            ImportError: For an MP4 without ffmpeg, and for a progress bar without the extra ``study``.
            FileExistsError: Where a file would be replaced.
            FileNotFoundError: For a folder that does not exist.
            OSError: Where it cannot be written.
        """
        path = file_to_write(path, tuple(_WRITERS), overwrite=overwrite)
        _checks.positive("dpi", dpi, "dots per inch")
        made = self._film(path.suffix.lower(), float(dpi), progress)
        with file_for_user(path) as file:
            file.write(made)

    def _film(self, kind: str, dpi: float, progress: bool | None) -> bytes:
        with progress_bar(progress, len(self.times), "frame") as bar:

            def draw(number: int) -> None:
                self._move(number)
                bar.advance(1)

            return _WRITERS[kind](self.figure, draw, len(self.times), self.fps, dpi)

    def _repr_html_(self) -> str:
        # Not by matplotlib's page with buttons: its images would make the notebook ten times as large, and it loads
        # its symbols from the net.
        if self._html is None:
            data = base64.b64encode(self._film(".gif", _NOTEBOOK_DPI, None)).decode()
            self._html = f'<img alt="{self!r}" src="data:image/gif;base64,{data}">'
        return self._html

    def __repr__(self) -> str:
        frames = len(self.times)
        return (
            f"Animation of {self.times[0]:g} to {self.times[-1]:g} s: {frames} frames, {frames / self.fps:.3g} s, "
            f"{self.speed:.3g} s of motion in each second"
        )


def animate(
    result: Simulation,
    *,
    window: Window | None = None,
    speed: float | int | None = None,
    fps: float | int = 25,
    coordinate: str | None = None,
    figsize: tuple[float | int, float | int] = (6.4, 5.0),
) -> Animation:
    """A moving picture of one trajectory: the mechanism, and below it the time history as far as it has come.

    What sticks has the colour of sticks. A `MassSpring` is drawn with its spring and its belt, whose marks run with the
    base; a `MotorCart` as disk, scotch yoke and cart; a `block_row` as blocks on their belt; `storeys_on_bearing` as
    floors, whose displacements are enlarged by a factor that the picture states; a `drivetrain` and a `drill_string` as
    disks; other systems as a bar for each coordinate. A system of your own says how it is drawn by overriding
    `System.mechanism`. States are as exact as the simulation; nothing is drawn between frames.

    Args:
        result: A result of `simulate`, one trajectory that reached ``t1``.
        window: First and last time to show, s; by default as in `time_history`.
        speed: Seconds of motion in one second of film; 1 is real time. By default the film lasts 10 s.
        fps: Frames per second, at most 50.
        coordinate: The name of the coordinate whose history is drawn, such as "velocity"; by default the first.
        figsize: Width and height of the picture, inches.

    Returns:
        An `Animation`: ``animate(one).save("motion.gif")``.

    Raises:
        ValueError: For arguments of another kind, for a simulation that did not reach ``t1``, for one that
            `Simulation.of_contact` returned, and for fewer than 2 or more than 3,000 frames.
    """
    check_simulation(result, of_one_contact=False)
    names = [one.name for one in result.system.coordinates]
    shown = 0 if coordinate is None else names.index(_checks.chosen("coordinate", coordinate, names))
    checked_speed(speed, fps)
    size = _checks.state("figsize", figsize, ("width", "height"))
    for name, length in zip(("figsize[0]", "figsize[1]"), size, strict=True):
        _checks.bounded(name, length, "inches", at_least=2)
    sticks = sticks_of(result)
    window = check_window(window, float(result.t1)) if _has_rows(result) else phases_in(result, window)[1]
    times, speed = frame_times(window, None if speed is None else float(speed), float(fps), result.sticks.start.dtype)
    mechanism = result.system.mechanism(state_at(result, times), base_displacement(result, times))
    contacts = result.system.contact_count or 1
    check_mechanism(mechanism, type(result.system).__name__, len(times), contacts)
    sticking = np.zeros((len(times), contacts), bool)
    for number, stuck in sticks.items():
        sticking[:, number] = stuck.lasts_at(times)

    figure = Figure(figsize=(float(size[0]), float(size[1])), layout="constrained")
    FigureCanvasAgg(figure)
    move = _draw(figure, result, mechanism, sticking, sticks, shown, window, times, speed)
    return Animation(figure, move, times, speed, float(fps))


def _draw(
    figure: Figure, result: Simulation, mechanism: Mechanism, sticking: np.ndarray, sticks: dict[int, Stuck],
    shown: int, window: Window, times: np.ndarray, speed: float,
) -> Move:  # fmt: skip
    """Draw all of a film into its figure; `shown`: the number of the coordinate in the history."""
    rows = _has_rows(result)
    ratios = (2.2, 1.0, 0.3 + 0.08 * min(len(sticks), _MOST_NAMES)) if rows else (1.9, 1.0)
    above, below, *others = figure.subplots(len(ratios), 1, height_ratios=ratios)
    moves = [
        _draw_mechanism(above, mechanism, result, sticking),
        _draw_clock(above, times, speed),
        _draw_history(below, result, shown, window, times, None if rows else next(iter(sticks.values()))),
    ]
    if rows:
        below.sharex(others[0])
        below.tick_params(labelbottom=False)
        moves.append(_draw_rows(others[0], sticks, window, times))
    _style.time_axis(below, window)
    legend_above(above, below, *others, columns=5)

    def move(frame: int) -> None:
        for one in moves:
            one(frame)

    _fix_layout(figure, move, mechanism if mechanism.equal else None)
    return move


def _has_rows(one: Simulation) -> bool:
    """Whether there are sticks of several contacts, each with a row of its own."""
    return one.sticks.contact is not None and one.system.contact_count != 1


def _fix_layout(figure: Figure, move: Move, equal: Mechanism | None) -> None:
    """Find the layout once: frames must not differ in it. The second time, springs know where the axes are.

    `equal`: the mechanism in the first axes if lengths there are to be alike in both directions.
    """
    for _ in range(2):
        move(0)
        figure.draw_without_rendering()
        if equal is not None:
            _make_equal(figure.axes[0], equal)
    figure.set_layout_engine("none")


def _make_equal(ax: Axes, mechanism: Mechanism) -> None:
    """Widen one of the ranges about its middle until lengths are drawn alike in both directions."""
    box = ax.get_window_extent()
    wide, high = np.ptp(mechanism.x_range), np.ptp(mechanism.y_range)
    scale = max(wide / box.width, high / box.height)
    for limits, size, setter in (
        (mechanism.x_range, box.width, ax.set_xlim),
        (mechanism.y_range, box.height, ax.set_ylim),
    ):
        middle = sum(limits) / 2
        setter(middle - scale * size / 2, middle + scale * size / 2)


def _draw_mechanism(ax: Axes, mechanism: Mechanism, one: Simulation, sticking: np.ndarray) -> Move:
    move = draw_parts(ax, mechanism, sticking)
    for side in ("left", "right", "top", *(() if mechanism.x_label else ("bottom",))):
        ax.spines[side].set_visible(False)
    ax.set_yticks([])
    whose = " relative to ground (m)" if isinstance(one.base, GroundMotion) else " (m)"
    ax.set_xlabel(mechanism.x_label.replace(" (m)", whose) or mechanism.note)
    if mechanism.x_names:
        named = mechanism.x_names[:: -(-len(mechanism.x_names) // _MOST_NAMES)]
        turned = 90 if len(named) > _NAMES_IN_A_ROW else 0
        ax.set_xticks(*zip(*named, strict=True), fontsize="small", rotation=turned)
        ax.tick_params(bottom=False)
    elif not mechanism.x_label:
        ax.set_xticks([])
    if any(isinstance(part, Belt) or (isinstance(part, Disk) and part.is_base) for part in mechanism.parts):
        ax.plot([], [], color=_style.BASE, lw=2, label="ground" if isinstance(one.base, GroundMotion) else "base")
    return move


def _draw_clock(ax: Axes, times: np.ndarray, speed: float) -> Move:
    """The time of the frame, and the speed of the film."""
    step = times[1] - times[0]
    digits = max(0, 1 - int(np.floor(np.log10(step))))
    text = ax.text(0.01, 0.98, "", transform=ax.transAxes, va="top", zorder=5)
    told = "real time" if f"{speed:.3g}" == "1" else f"{speed:.3g} \u00d7 real time"
    ax.text(0.99, 0.98, told, transform=ax.transAxes, va="top", ha="right", zorder=5)

    def move(frame: int) -> None:
        text.set_text(f"t = {times[frame]:.{digits}f} s")

    return move


def _draw_history(
    ax: Axes, one: Simulation, number: int, window: Window, frames: np.ndarray, stuck: Stuck | None
) -> Move:
    """One coordinate until the time of the frame; `stuck`: when it is thick and coloured."""
    events = np.zeros(0, frames.dtype) if stuck is None else np.concatenate([stuck.start, stuck.end])
    events = events[(events > window[0]) & (events < window[1])]
    times = np.union1d(line_times(one, window), np.concatenate([frames, events]))
    values = state_at(one, times)[number]
    name = one.system.body_name
    label = None if stuck is None else name
    lines = [(ax.plot([], [], color=_style.MASS, lw=_style.SLIP_WIDTH, label=label)[0], values)]
    if one.system.sticks_at_base_velocity and number == 1:
        base = velocity_at(one, times)
        lines.append((ax.plot([], [], color=_style.BASE, lw=_style.SLIP_WIDTH, ls="--")[0], base))
    if stuck is not None:
        # Both ends belong to the line.
        lasts = stuck.lasts_at(times) | np.isin(times, stuck.end)
        look = {"color": _style.STICK, "lw": _style.STICK_WIDTH, "solid_capstyle": "butt", "label": f"{name}, stick"}
        lines.append((ax.plot([], [], **look)[0], np.where(lasts, values, np.nan)))
    (now,) = ax.plot([], [], "o", color=_style.MASS, ms=4)
    drawn = np.concatenate([line_values[np.isfinite(line_values)] for _, line_values in lines])
    ax.update_datalim(np.column_stack([np.full(len(drawn), window[0]), drawn]))
    ax.autoscale_view(scalex=False)
    ax.set_ylabel(_parts.wrapped(one.system.coordinates[number].label, 14 if stuck is None else 22))
    counts = np.searchsorted(times, frames, side="right")

    def move(frame: int) -> None:
        until = counts[frame]
        for line, line_values in lines:
            line.set_data(times[:until], line_values[:until])
        now.set_data([times[until - 1]], [values[until - 1]])

    return move


def _draw_rows(ax: Axes, sticks: dict[int, Stuck], window: Window, frames: np.ndarray) -> Move:
    """A row for each contact with its sticks until the time of the frame."""
    start, end = (np.concatenate([getattr(one, name) for one in sticks.values()]) for name in ("start", "end"))
    row = np.repeat(np.array(list(sticks), float), [len(one.start) for one in sticks.values()])
    bars = PolyCollection([], facecolor=_style.STICK, lw=0, label="stick")
    ax.add_collection(bars, autolim=False)
    ax.set_ylim(max(sticks) + 0.5, -0.5)
    ax.set_yticks(range(0, max(sticks) + 1, -(-len(sticks) // 6)))
    ax.set_ylabel("contact")
    _style.time_axis(ax, window)

    def move(frame: int) -> None:
        begun = (start < frames[frame]) & (end > window[0])
        until = np.minimum(end[begun], frames[frame])
        bars.set_verts(_parts.rectangles(start[begun], until, row[begun] - 0.4, row[begun] + 0.4))

    return move
