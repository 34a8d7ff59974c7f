"""Labelled lines of equal values in a map of colours."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.path import Path
from matplotlib.patheffects import AbstractPathEffect, withStroke

from . import _style

_SHORTEST = 0.12  # of the height of the axes: shorter lines are left out
_FLAT_PART = 0.5  # of a line: where more than that is chance, all of it is left out
_LABEL = (0.028, 0.075)  # width of a letter and height of a label, in widths and heights of the axes
_PLANE = np.array([[1, x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)], float)  # over a cell and those around it
_SURE = 4  # standard errors of a slope: chance exceeds them in one of 3000 cells (Rayleigh's distribution, exp(-8))


def draw_contours(
    ax: Axes,
    centers: tuple[np.ndarray, np.ndarray],
    values: np.ndarray,
    errors: np.ndarray | None,
    levels: list[float],
    texts: list[str],
) -> None:
    """Draw lines of equal values, interpolated between the centres of the cells, and label them.

    Short lines are left out, and those that run through flat regions, where their course is chance. Labels do not lie
    on each other. The scales and limits of `ax` must be set.

    - `centers` (nx,) and (ny,). `values`: (nx, ny), NaN where unknown, and their standard `errors`, if known.
    - `levels` of the lines, with their `texts`.
    """
    halo: list[AbstractPathEffect] = [withStroke(linewidth=2, foreground="white")]
    known = np.ma.masked_invalid(values).T
    lines = ax.contour(*centers, known, levels=levels, colors=_style.MASS, linewidths=0.8)
    lines.set_path_effects(halo)
    flat = _flat(values, errors)
    kept = [[piece for piece in _pieces(path) if _is_drawn(ax, centers, piece, flat)] for path in lines.get_paths()]
    lines.set_paths([Path.make_compound_path(*pieces) if pieces else Path(np.zeros((0, 2))) for pieces in kept])
    for text in _place_labels(ax, lines, kept, texts):
        text.set_path_effects(halo)


def _flat(values: np.ndarray, errors: np.ndarray | None) -> np.ndarray:
    """Where the values around a cell hardly change, so that the course of lines would be chance, (nx, ny).

    The slope is that of a plane through the known ones of the three by three cells around, by least squares. It is
    compared with its standard error: from the `errors` of the values, or else from their scatter about the plane.
    """
    wide = np.pad(values, 1, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(wide, (3, 3)).reshape(*values.shape, 9)
    known = np.isfinite(around)
    filled = np.where(known, around, 0.0)
    inverse = np.linalg.pinv(np.einsum("ap,xya,aq->xypq", _PLANE, known, _PLANE), hermitian=True)
    plane = np.einsum("xypq,aq,xya->xyp", inverse, _PLANE, filled)
    spread = errors
    if spread is None:
        squares = np.sum(np.where(known, filled - plane @ _PLANE.T, 0.0) ** 2, axis=-1)
        spread = np.sqrt(squares / np.maximum(known.sum(axis=-1) - 3, 1))
    error = np.nan_to_num(spread, nan=np.inf) * np.sqrt(np.maximum(inverse[..., 1, 1], inverse[..., 2, 2]))
    return np.hypot(plane[..., 1], plane[..., 2]) < _SURE * error


def _pieces(path: Path) -> list[Path]:
    """The connected lines of a path."""
    return [Path(vertices) for vertices in path.to_polygons(closed_only=False)] if len(_vertices(path)) else []


def _vertices(path: Path) -> np.ndarray:
    """The points of a path, (points, 2)."""
    return np.asarray(path.vertices, float)


def _in_axes(ax: Axes, vertices: np.ndarray) -> np.ndarray:
    """Points in the coordinates of the axes, 0 to 1; these do not change with the layout of the figure."""
    return ax.transAxes.inverted().transform(ax.transData.transform(vertices))


def _is_drawn(ax: Axes, centers: tuple[np.ndarray, np.ndarray], line: Path, flat: np.ndarray) -> bool:
    """Whether a line is long enough, and mostly where values change."""
    points = _in_axes(ax, _vertices(line))
    lengths = np.hypot(*np.diff(points, axis=0).T)
    if lengths.sum() < _SHORTEST:
        return False
    middles = (_vertices(line)[1:] + _vertices(line)[:-1]) / 2
    cells = [np.interp(place, one, np.arange(len(one))) for place, one in zip(middles.T, centers, strict=True)]
    inside = flat[tuple(np.rint(cell).astype(int) for cell in cells)]
    return bool(lengths[inside].sum() <= _FLAT_PART * lengths.sum())


def _place_labels(ax: Axes, lines: ContourSet, kept: list[list[Path]], texts: list[str]) -> list:
    """Label the longest line of each level near its middle, where no other label is; none where there is no room."""
    placed: list[tuple[np.ndarray, np.ndarray]] = []
    labels = []
    for level, text, pieces in zip(lines.levels, texts, kept, strict=True):
        half = np.array([_LABEL[0] * len(text) + 0.01, _LABEL[1]]) / 2
        for line in sorted(pieces, key=lambda one: -_length(_in_axes(ax, _vertices(one)))):
            points = _in_axes(ax, _vertices(line))
            place = next((one for one in _from_middle(points) if _is_free(points[one], half, placed)), None)
            if place is not None:
                placed.append((points[place], half))
                labels.append((float(level), text, _vertices(line)[place]))
                break
    made = []
    for level, text, at in labels:
        made += lines.clabel([level], fontsize="small", fmt={level: text}, manual=[tuple(at)])
    return made


def _length(points: np.ndarray) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _from_middle(points: np.ndarray) -> np.ndarray:
    """The numbers of the points of a line, from its middle outward, without its ends."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    order = np.argsort(np.abs(along - along[-1] / 2), kind="stable")
    return order[(order > 0) & (order < len(points) - 1)]


def _is_free(point: np.ndarray, half: np.ndarray, placed: list[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether a label of that half width and height, upright or along its line, fits in the axes beside the others."""
    most = half.max()
    if np.any(point < most) or np.any(point > 1 - most):
        return False
    return all(np.any(np.abs(point - other) > half.max() + size.max()) for other, size in placed)
