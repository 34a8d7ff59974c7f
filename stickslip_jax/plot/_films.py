"""Films of frames that a function draws into a figure: as GIF by Pillow, as MP4 by ffmpeg."""

import io
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

_COLORS = 64  # of a frame of a GIF: a drawing of few colours, and their edges


def gif(figure: Figure, draw: Callable[[int], object], frames: int, fps: float, dpi: float) -> bytes:
    """The frames that `draw` draws into `figure`, as a GIF that begins anew at its end.

    A GIF counts hundredths of a second: frames last one more or less, so that the film keeps its speed.
    """
    images = [_with_few_colors(image) for image in _images(figure, draw, frames, dpi)]
    ends = np.round(100 * np.arange(frames + 1) / fps).astype(int)
    written = io.BytesIO()
    lasting = (10 * np.diff(ends)).tolist()  # ms
    images[0].save(written, "GIF", save_all=True, append_images=images[1:], duration=lasting, loop=0)
    return written.getvalue()


def _with_few_colors(image: Image.Image) -> Image.Image:
    return image.quantize(_COLORS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def _images(figure: Figure, draw: Callable[[int], object], frames: int, dpi: float) -> Iterator[Image.Image]:
    """The frames; axes and legends, which take most of the time, are drawn once and what is in the axes over them."""
    usual, canvas = figure.dpi, FigureCanvasAgg(figure)
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
            yield Image.fromarray(np.array(canvas.buffer_rgba())).convert("RGB")
    finally:
        for one in moving:
            one.set_animated(False)
        figure.dpi = usual


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
