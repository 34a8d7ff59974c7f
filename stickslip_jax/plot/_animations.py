"""A moving picture of one trajectory: its mechanism, and below it the history that grows."""

import base64
import io
import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias, cast

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from .._dynamics.simulation import Simulation
from .._excitation.recorded import GroundMotion
from .._foundation import checks
from .._foundation.extras import progress_bar
from .._foundation.files import file_for_user, file_to_write
from .._systems.system import Belt, Body, Disk, Mechanism, OverTime, Part, Rod, Spring, System, bars
from . import _style
from ._style import Window, legend_above
from ._trajectory import Stuck, check_simulation, check_window, lasts_at, line_times, phases_in, sticks_in

# Films of frames that a function draws into a figure: as GIF by Pillow, as MP4 by ffmpeg.


_COLORS = 64  # of a frame of a GIF: a drawing of few colours, and their edges


def gif(figure: Figure, draw: Callable[[int], object], frames: int, fps: float, dpi: float) -> bytes:
    """The frames that `draw` draws into `figure`, as a GIF that begins anew at its end.

    A GIF counts hundredths of a second: frames last one more or less, so that the film keeps its speed. Axes and
    legends, which take most of the time, are drawn once and what is in the axes over them.
    """
    usual, canvas, images = figure.dpi, FigureCanvasAgg(figure), []
    moving = [one for ax in figure.axes for one in (*ax.patches, *ax.lines, *ax.collections, *ax.texts)]
    moving.sort(key=lambda one: one.get_zorder())
    figure.dpi = dpi
    try:
        for one in moving:
            one.set_animated(True)
        canvas.draw()
        still = canvas.copy_from_bbox(figure.bbox)
        for number in range(frames):
            draw(number)
            canvas.restore_region(still)
            for one in moving:
                assert one.axes is not None
                one.axes.draw_artist(one)
            image = Image.fromarray(np.array(canvas.buffer_rgba())).convert("RGB")
            images.append(image.quantize(_COLORS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))
    finally:
        for one in moving:
            one.set_animated(False)
        figure.dpi = usual
    ends = np.round(100 * np.arange(frames + 1) / fps).astype(int)
    written = io.BytesIO()
    lasting = (10 * np.diff(ends)).tolist()  # ms
    images[0].save(written, "GIF", save_all=True, append_images=images[1:], duration=lasting, loop=0)
    return written.getvalue()


def mp4(figure: Figure, draw: Callable[[int], object], frames: int, fps: float, dpi: float) -> bytes:
    """The frames that `draw` draws into `figure`, as an MP4.

    Raises:
        ImportError: Without ffmpeg.
        OSError: For what ffmpeg cannot do.
    """
    if not FFMpegWriter.isAvailable():
        raise ImportError(
            f"A film in MP4 needs the program ffmpeg, but no {mpl.rcParams['animation.ffmpeg_path']!r} was found; "
            "install it (apt install ffmpeg, conda install ffmpeg, brew install ffmpeg), or save a .gif, which needs "
            "no other program."
        )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        writer = FFMpegWriter(fps=cast(int, fps))  # any number
        try:
            with writer.saving(figure, str(path), dpi):
                for number in range(frames):
                    draw(number)
                    writer.grab_frame()
            return path.read_bytes()
        except (subprocess.CalledProcessError, OSError) as error:
            said = getattr(error, "stderr", None) or getattr(error, "output", None) or error
            raise OSError(f"ffmpeg could not make the film: {str(said).strip()}") from error


# What a film shows in each frame: the state, how far the base has run, and which contacts stick.


_MOST_FRAMES = 3000
_USUAL_LENGTH = 10.0  # s, of a film whose speed is not given
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def sticks_of(one: Simulation) -> dict[int, Stuck]:
    """The sticks of each contact of which they are known, by its number.

    Raises:
        ValueError: Where it is not known which contact they are of.
    """
    contacts, counted = one.system.tracks.contacts or 1, one.system.tracks.counted
    if contacts == 1:
        return {0: sticks_in(one)}
    if one.sticks.contact is not None:
        return {number: sticks_in(one.of_contact(number)) for number in range(contacts)}
    if counted is None:
        raise ValueError(
            "Argument result must hold the sticks of all contacts, but one of of_contact or of_all_contacts was given; "
            "animate the simulation that it was taken from."
        )
    return dict.fromkeys(range(contacts) if counted < 0 else [counted], sticks_in(one))


def frame_times(window: Window, speed: float | None, fps: float, dtype: np.dtype) -> tuple[np.ndarray, float]:
    """The times of the frames (s), from the window's begin in equal steps as far as it reaches; and the speed.

    Raises:
        ValueError: For fewer than two frames, and for more than 3,000.
    """
    length = window[1] - window[0]
    speed = length / _USUAL_LENGTH if speed is None else speed
    # The last frame is at the window's end where that is a whole number of steps away, up to round-off.
    frames = math.floor(length / speed * fps * (1 + 1e-9)) + 1
    if not 2 <= frames <= _MOST_FRAMES:
        raise ValueError(
            f"Arguments window, speed and fps must make 2 to {_MOST_FRAMES:,} frames, but {length:g} s at "
            f"{speed:g} s of motion per second of film with {fps:g} frames per second are {frames:,}; choose "
            f"{'a lower' if frames < 2 else 'a higher'} speed{' or a shorter window' if frames > 2 else ''}."
        )
    times = window[0] + speed / fps * np.arange(frames)
    return np.minimum(times, window[1]).astype(dtype), speed


def base_displacement(one: Simulation, times: np.ndarray) -> np.ndarray:
    """How far the base has run since the first of `times` (s), at each of them: the integral of its velocity.

    By Gauss's rule between all beginnings of time steps, at which the velocity may jump: exact where it is a polynomial
    of degree 7 between them.
    """
    steps = np.asarray(one.step_starts)
    knots = np.unique(np.concatenate([times, steps[(steps > times[0]) & (steps < times[-1])]])).astype(float)
    half, middle = np.diff(knots) / 2, (knots[1:] + knots[:-1]) / 2
    nodes = middle[:, None] + half[:, None] * _NODES
    velocities = np.asarray(one.base_velocity(nodes), float)
    run = np.concatenate([[0.0], np.cumsum(half * (velocities @ _WEIGHTS))])
    return run[np.searchsorted(knots, times.astype(float))]


def state_at(one: Simulation, times: np.ndarray) -> tuple[np.ndarray, ...]:
    """The state at `times` (s), (times,) each, in double precision whatever that of the simulation."""
    return tuple(np.asarray(values, float) for values in one.evaluate(times))


# The parts of a mechanism as artists of matplotlib that move from frame to frame.


Move: TypeAlias = Callable[[int], None]
"""Puts what was drawn where it is in the frame with this number."""

_FILL, _FIXED = "#E6E6E6", "#BBBBBB"
_COIL_WIDTH, _COIL_LENGTH, _MOST_COILS = 0.16, 0.2, 7  # inches, from side to side and along the spring
_LEADS = 0.12  # of the length of a spring, straight at each end
_BASE_MARKS = 6


def mechanism_of(system: System, state: tuple[np.ndarray, ...], base: np.ndarray) -> Mechanism:
    """How a system looks in these states, arrays (frames,), its base displaced so far. Raises ValueError for a user's
    look that returns no mechanism.
    """
    if system.look.mechanism is not None:
        mechanism = system.look.mechanism(state, base)
    else:  # which coordinates belong to one of several contacts is not known
        on = (0,) if system.tracks.contacts is None else ()
        mechanism = bars(system.coordinates, state, (on,) * len(state))
    check_mechanism(mechanism, type(system).__name__, len(base), system.tracks.contacts or 1)
    return mechanism


def check_mechanism(mechanism: object, whose: str, frames: int, contacts: int) -> None:
    """Raise ValueError for what the mechanism of a user's `Look` must not return; `whose`: the class of the system."""
    must = f"The mechanism in the look of {whose} must return"
    if not isinstance(mechanism, Mechanism) or not all(isinstance(part, Part) for part in mechanism.parts):
        shown = checks.show(mechanism)
        raise ValueError(f"{must} a plot.Mechanism of Body, Spring, Rod, Disk and Belt, but {shown} was returned.")
    for part in mechanism.parts:
        kind = type(part).__name__
        for value in numbers_of(part):
            array = checks.numbers("mechanism", value)
            if array.shape not in ((), (frames,)) or not np.all(np.isfinite(array)):
                what = f"finite numbers or arrays of {frames} of them, one for each frame"
                raise ValueError(f"{must} {what}, but a {kind} has {checks.show(value)}.")
        touched = () if isinstance(part, (Belt, Spring)) else part.contacts
        if not set(touched) <= set(range(contacts)):
            what = f"numbers of contacts from 0 to {contacts - 1}"
            raise ValueError(f"{must} {what}, but a {kind} has the contacts {touched}.")


def numbers_of(part: Part) -> tuple[OverTime, ...]:
    """All numbers of a part: its places, then its lengths."""
    if isinstance(part, Body):
        return *part.center, part.width, part.height
    if isinstance(part, Disk):
        return *part.center, part.radius, *(() if part.angle is None else (part.angle,))
    if isinstance(part, Belt):
        return part.y, part.displacement, *part.ends
    return *part.start, *part.end


# Each part by its numbers and whether it sticks in each frame, (frames, numbers) and (frames,).


def _body(ax: Axes, body: Body, places: np.ndarray, stuck: np.ndarray, order: float) -> Move:
    look = {"hatch": "////", "edgecolor": "0.5", "facecolor": _FIXED, "lw": 0} if body.fixed else {
        "edgecolor": _style.MASS, "facecolor": _FILL, "lw": _style.SLIP_WIDTH
    }  # fmt: skip
    patch = Rectangle((0, 0), 0, 0, zorder=order, **look)
    ax.add_patch(patch)
    text = ax.text(0, 0, body.label, ha="center", va="center", zorder=order, clip_on=True, fontsize="small")

    def move(frame: int) -> None:
        x, y, width, height = places[frame]
        patch.set_bounds(x - width / 2, y - height / 2, width, height)
        text.set_position((x, y))
        if not body.fixed:
            patch.set_facecolor(_style.STICK if stuck[frame] else _FILL)

    return move


def _disk(ax: Axes, disk: Disk, places: np.ndarray, stuck: np.ndarray, order: float) -> Move:
    color = _style.BASE if disk.is_base else _style.MASS
    look = {"fill": not disk.is_base, "facecolor": _FILL, "edgecolor": color, "lw": 1.4, "zorder": order}
    circle = Circle((0, 0), disk.radius, **look)
    ax.add_patch(circle)
    marks = LineCollection([], colors=color, lw=1.8, zorder=order)
    ax.add_collection(marks, autolim=False)
    text = ax.text(0, 0, disk.label, ha="center", va="top", fontsize="small", zorder=order)
    # A ring has short marks all around it, the first a long one.
    turns = 2 * np.pi * np.arange(_BASE_MARKS) / _BASE_MARKS if disk.is_base else np.zeros(1)
    inner = np.where(turns == 0, 0.82, 0.92) if disk.is_base else np.zeros(1)

    def move(frame: int) -> None:
        center, (radius, *angle) = places[frame, :2], places[frame, 2:]
        circle.set_center((center[0], center[1]))
        text.set_position((center[0], center[1] - 1.35 * radius))
        if not disk.is_base:
            circle.set_facecolor(_style.STICK if stuck[frame] else _FILL)
        if angle:
            ways = radius * np.stack([np.cos(angle[0] + turns), np.sin(angle[0] + turns)], -1)
            marks.set_segments(list(np.stack([center + inner[:, None] * ways, center + ways], 1)))

    return move


def _belt(ax: Axes, belt: Belt, order: float) -> Move:
    ax.plot(belt.ends, [belt.y] * 2, color=_style.BASE, lw=2, zorder=order, solid_capstyle="butt")
    marks = LineCollection([], colors=_style.BASE, lw=1.6, zorder=order)
    ax.add_collection(marks, autolim=False)
    places = belt.mark_places
    lengths = np.where(np.arange(belt.marks) == 0, 0.11, 0.05) * abs(np.diff(ax.get_ylim())[0])
    below = np.column_stack([np.full(belt.marks, belt.y), belt.y - lengths])

    def move(frame: int) -> None:
        x = places[frame] if places.ndim == 2 else places
        marks.set_segments(list(np.stack([np.stack([x, x], -1), below], -1)))

    return move


def _link(ax: Axes, link: Spring | Rod, places: np.ndarray, stuck: np.ndarray, order: float) -> Move:
    figure = _style.figure_of(ax)
    # Coils have the same width in every direction and on every scale, so they are drawn in inches.
    is_spring = isinstance(link, Spring)
    line = Line2D([], [], color=_style.MASS, lw=_style.SLIP_WIDTH if is_spring else 1.6, zorder=order)
    if is_spring:
        line.set_transform(figure.dpi_scale_trans)
    ax.add_artist(line)
    line.set_clip_path(ax.patch)
    usual = np.array([np.mean(value) for value in numbers_of(link)]).reshape(2, 2)

    def move(frame: int) -> None:
        ends = places[frame].reshape(2, 2)
        if is_spring:
            first, last = ax.transData.transform(usual) / figure.dpi
            coils = int(np.clip(np.hypot(*(last - first)) / _COIL_LENGTH, 2, _MOST_COILS))
            start, end = ax.transData.transform(ends) / figure.dpi
            ends = zigzag(start, end, coils)
        line.set_data(*ends.T)
        line.set_color(_style.STICK if stuck[frame] else _style.MASS)

    return move


def zigzag(start: np.ndarray, end: np.ndarray, coils: int) -> np.ndarray:
    """The corners of a spring from `start` to `end` (2,), (corners, 2); all in inches."""
    way = end - start
    length = np.hypot(*way)
    across = np.array([-way[1], way[0]]) / length if length > 0 else np.zeros(2)
    along = np.concatenate([[0.0], np.linspace(_LEADS, 1 - _LEADS, 2 * coils + 1), [1.0]])
    side = np.zeros(len(along))
    side[2:-2] = np.where(np.arange(2 * coils - 1) % 2, -0.5, 0.5)
    return start + along[:, None] * way + _COIL_WIDTH * side[:, None] * across


# A moving picture of one trajectory: its mechanism, and below it the history that grows.


_WRITERS = {".gif": gif, ".mp4": mp4}
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
        number = checks.whole_number("number", number, minimum=-frames, maximum=frames - 1)
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
        checks.positive("dpi", dpi, "dots per inch")
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
    `System.look`. States are as exact as the simulation; nothing is drawn between frames.

    Args:
        result: A result of `simulate`, one trajectory.
        window: First and last time to show, s; by default as in `time_history`.
        speed: Seconds of motion in one second of film; 1 is real time. By default the film lasts 10 s.
        fps: Frames per second, at most 50.
        coordinate: The name of the coordinate whose history is drawn, such as "velocity"; by default the first.
        figsize: Width and height of the picture, inches.

    Returns:
        An `Animation`: ``animate(one).save("motion.gif")``.

    Raises:
        ValueError: For arguments of another kind, for one that `Simulation.of_contact` returned, and for
            fewer than 2 or more than 3,000 frames.
    """
    check_simulation(result, of_one_contact=False)
    names = [one.name for one in result.system.coordinates]
    shown = 0 if coordinate is None else names.index(checks.chosen("coordinate", coordinate, names))
    if speed is not None:
        checks.positive("speed", speed, "s of motion per s of film")
    checks.positive("fps", fps, "frames per second")
    if fps > 50:
        raise checks.refused("fps", "be at most 50 (frames per second), the most that players of GIFs show", fps)
    size = checks.state("figsize", figsize, ("width", "height"))
    for name, length in zip(("figsize[0]", "figsize[1]"), size, strict=True):
        checks.bounded(name, length, "inches", at_least=2)
    sticks = sticks_of(result)
    # Sticks of several contacts have a row each.
    rows = result.sticks.contact is not None and result.system.tracks.contacts != 1
    window = check_window(window, float(result.time_reached)) if rows else phases_in(result, window)[1]
    times, speed = frame_times(window, None if speed is None else float(speed), float(fps), result.sticks.start.dtype)
    system, state, contacts = result.system, state_at(result, times), result.system.tracks.contacts or 1
    mechanism = mechanism_of(system, state, base_displacement(result, times))
    sticking = np.zeros((len(times), contacts), bool)
    for number, stuck in sticks.items():
        sticking[:, number] = lasts_at(stuck, times)

    figure = Figure(figsize=(float(size[0]), float(size[1])), layout="constrained")
    FigureCanvasAgg(figure)
    ratios = (2.2, 1.0, 0.3 + 0.08 * min(len(sticks), _MOST_NAMES)) if rows else (1.9, 1.0)
    above, below, *others = figure.subplots(len(ratios), 1, height_ratios=ratios)
    moves = [
        *draw_mechanism(above, mechanism, sticking, "ground" if isinstance(result.base, GroundMotion) else "base"),
        _draw_clock(above, times, speed),
        _draw_history(below, result, shown, window, times, None if rows else next(iter(sticks.values()))),
    ]
    if rows:
        below.sharex(others[0])
        below.tick_params(labelbottom=False)
        moves.append(_draw_rows(others[0], sticks, window, times))
    _style.time_axis(below, window)
    _style.mark_unfinished(below, result)
    legend_above(above, below, *others, columns=5)

    def move(frame: int) -> None:
        for one in moves:
            one(frame)

    # Frames must not differ in the layout. The second time that it is found, springs know where the axes are.
    for _ in range(2):
        move(0)
        figure.draw_without_rendering()
        if mechanism.equal:
            make_equal(above, mechanism)
    figure.set_layout_engine("none")
    return Animation(figure, move, times, speed, float(fps))


def make_equal(ax: Axes, mechanism: Mechanism) -> None:
    """Widen one of the ranges about its middle until lengths are drawn alike in both directions."""
    box = ax.get_window_extent()
    middles, sizes = np.mean([mechanism.x_range, mechanism.y_range], axis=1), np.array([box.width, box.height])
    half = max(np.ptp(mechanism.x_range) / box.width, np.ptp(mechanism.y_range) / box.height) * sizes / 2
    ax.set(xlim=(middles[0] - half[0], middles[0] + half[0]), ylim=(middles[1] - half[1], middles[1] + half[1]))


def draw_mechanism(ax: Axes, mechanism: Mechanism, sticking: np.ndarray, moved: str) -> list[Move]:
    """Draw a mechanism into `ax`; returns what moves its parts.

    `sticking`: whether each contact sticks in each frame, (frames, contacts). `moved`: what moves, "base" or "ground".
    """
    ax.set(xlim=mechanism.x_range, ylim=mechanism.y_range)
    moves = []
    for number, part in enumerate(mechanism.parts):
        order = 2 + 0.01 * number  # each part is above those before it
        if isinstance(part, Belt):
            moves.append(_belt(ax, part, order))
            continue
        places = np.array([np.broadcast_to(np.asarray(value, float), len(sticking)) for value in numbers_of(part)])
        stuck = np.any(sticking[:, [] if isinstance(part, Spring) else list(part.contacts)], axis=1)
        draw = _body if isinstance(part, Body) else _disk if isinstance(part, Disk) else _link
        moves.append(draw(ax, cast(Any, part), places.T, stuck, order))
    for side in ("left", "right", "top", *(() if mechanism.x_label else ("bottom",))):
        ax.spines[side].set_visible(False)
    ax.set_yticks([])
    whose = " relative to ground (m)" if moved == "ground" else " (m)"
    ax.set_xlabel(mechanism.x_label.replace(" (m)", whose) or mechanism.note)
    if mechanism.x_names:
        named = mechanism.x_names[:: -(-len(mechanism.x_names) // _MOST_NAMES)]
        turned = 90 if len(named) > _NAMES_IN_A_ROW else 0
        ax.set_xticks(*zip(*named, strict=True), fontsize="small", rotation=turned)
        ax.tick_params(bottom=False)
    elif not mechanism.x_label:
        ax.set_xticks([])
    if any(isinstance(part, Belt) or (isinstance(part, Disk) and part.is_base) for part in mechanism.parts):
        ax.plot([], [], color=_style.BASE, lw=2, label=moved)
    return moves


def _draw_clock(ax: Axes, times: np.ndarray, speed: float) -> Move:
    """The time of the frame, and the speed of the film."""
    step = times[1] - times[0]
    digits = max(0, 1 - int(np.floor(np.log10(step))))
    text = ax.text(0.01, 0.98, "", transform=ax.transAxes, va="top", zorder=5)
    told = "real time" if f"{speed:.3g}" == "1" else f"{speed:.3g} \u00d7 real time"
    ax.text(0.99, 0.98, told, transform=ax.transAxes, va="top", ha="right", zorder=5)
    return lambda frame: text.set_text(f"t = {times[frame]:.{digits}f} s")


def _draw_history(
    ax: Axes, one: Simulation, number: int, window: Window, frames: np.ndarray, stuck: Stuck | None
) -> Move:
    """One coordinate until the time of the frame; `stuck`: when it is thick and coloured."""
    events = np.zeros(0, frames.dtype) if stuck is None else np.concatenate(stuck)
    events = events[(events > window[0]) & (events < window[1])]
    times = np.union1d(line_times(one, window), np.concatenate([frames, events]))
    values = state_at(one, times)[number]
    look = one.system.look
    lines = [(ax.plot([], [], label=None if stuck is None else look.body_name, **_style.MASS_LINE)[0], values)]
    if look.second_is_base_velocity and number == 1:
        lines.append((ax.plot([], [], **_style.BASE_LINE)[0], np.asarray(one.base_velocity(times), float)))
    if stuck is not None:
        # Both ends belong to the line.
        lasts = lasts_at(stuck, times) | np.isin(times, stuck[1])
        (thick,) = ax.plot([], [], label=f"{look.body_name}, stick", **_style.STICK_LINE)
        lines.append((thick, np.where(lasts, values, np.nan)))
    (now,) = ax.plot([], [], "o", color=_style.MASS, ms=4)
    drawn = np.concatenate([line_values[np.isfinite(line_values)] for _, line_values in lines])
    ax.update_datalim(np.column_stack([np.full(len(drawn), window[0]), drawn]))
    ax.autoscale_view(scalex=False)
    ax.set_ylabel(_style.wrapped(one.system.coordinates[number].label, 14 if stuck is None else 22))
    counts = np.searchsorted(times, frames, side="right")

    def move(frame: int) -> None:
        until = counts[frame]
        for line, line_values in lines:
            line.set_data(times[:until], line_values[:until])
        now.set_data([times[until - 1]], [values[until - 1]])

    return move


def _draw_rows(ax: Axes, sticks: dict[int, Stuck], window: Window, frames: np.ndarray) -> Move:
    """A row for each contact with its sticks until the time of the frame."""
    start, end = map(np.concatenate, zip(*sticks.values(), strict=True))
    row = np.repeat(np.array(list(sticks), float), [len(one) for one, _ in sticks.values()])
    rows = _style.draw_polygons(ax, [], facecolor=_style.STICK, label="stick")
    ax.set_ylim(max(sticks) + 0.5, -0.5)
    ax.set_yticks(range(0, max(sticks) + 1, -(-len(sticks) // 6)))
    ax.set_ylabel("contact")
    _style.time_axis(ax, window)

    def move(frame: int) -> None:
        begun = (start < frames[frame]) & (end > window[0])
        until = np.minimum(end[begun], frames[frame])
        rows.set_verts(_style.sticks_in_rows(row[begun], start[begun], until))

    return move
