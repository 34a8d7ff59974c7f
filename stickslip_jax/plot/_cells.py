"""A joint histogram of two quantities, ready to draw: from the pairs of an ensemble, or from sticks one by one."""

from typing import NamedTuple

import numpy as np

from .. import _checks
from .._statistics.distribution import bin_of
from .._statistics.joint import JointDistribution
from . import _parts
from ._stick_positions import PlacedSticks
from ._sticks import edges_of_bins, outside
from ._types import JointBins


class Side(NamedTuple):
    """The histogram of one of the two quantities: `density` and its standard `error`, NaN if not known, (bins,)."""

    density: np.ndarray
    error: np.ndarray


class Cells(NamedTuple):
    """A joint histogram.

    - `edges`: of the bins along x (m + 1,) and y (n + 1,). `density`: masked where no pair fell, (m, n).
      Of pairs, atoms are not in it.
    - `sides`: the histograms of x and of y.
    - `units`: of x and y. `label`: how many pairs there are, or a note that there are none. `empty`: whether there are
      none.
    """

    edges: tuple[np.ndarray, np.ndarray]
    density: np.ma.MaskedArray
    sides: tuple[Side, Side]
    units: tuple[str, str]
    label: str
    empty: bool


def number_of_bins(bins: JointBins) -> int:
    """`bins` of a joint distribution along each axis. Raises ValueError unless it is a whole number of at least 1."""
    if isinstance(bins, (tuple, list, np.ndarray)):
        raise ValueError(
            "Argument bins must be a whole number for a joint distribution, whose bins were fixed while it was summed, "
            f"but {_checks.show(bins)} was given; bins of your own go with the sticks: "
            "joint_histogram(ensemble, bins=(edges, edges))."
        )
    return _checks.whole_number("bins", bins)


def cells_of_pairs(joint: JointDistribution, bins: int) -> Cells:
    """The joint histogram of all pairs, with the standard errors of its sides.

    Raises:
        ValueError: For more than 128 bins.
    """
    drawn = joint.histogram(bins)
    edges = (drawn.x_edges, drawn.y_edges)
    sides = []
    for axis, own in ((0, joint.x), (1, joint.y)):
        width = np.diff(edges[axis])
        share = drawn.counts.sum(axis=1 - axis) / max(drawn.number, 1)
        errors = own.errors_of_shares(bin_of(own.values, edges[axis]), len(width))
        sides.append(Side(share / width, errors / width))
    atoms = joint.share_of_atoms(bins)
    density = np.ma.masked_where((drawn.counts == 0) | (atoms == 1), drawn.density * (1 - atoms))
    label = _parts.counted(drawn.number, "pair") if drawn.number else "no pairs"
    return Cells(edges, density, (sides[0], sides[1]), joint.units, label, drawn.number == 0)


def cells_of_sticks(sticks: PlacedSticks, bins: JointBins) -> Cells:
    """The joint histogram of position and duration of complete sticks.

    `bins`: as in `joint_histogram`.

    Raises:
        ValueError: For anything else.
    """
    edges, number = _edges(bins, sticks), len(sticks.duration)
    counts, *_ = np.histogram2d(sticks.position, sticks.duration, edges)
    widths = (np.diff(edges[0]), np.diff(edges[1]))
    density = np.ma.masked_equal(counts, 0) / (max(number, 1) * np.outer(*widths))
    sides = [
        Side(counts.sum(axis=1 - axis) / max(number, 1) / widths[axis], np.full(len(widths[axis]), np.nan))
        for axis in (0, 1)
    ]
    label = outside(sticks.label, number - int(counts.sum()))
    units = (sticks.system.coordinates[0].unit, "s")
    return Cells(edges, density, (sides[0], sides[1]), units, label, number == 0)


def _edges(bins: JointBins, sticks: PlacedSticks) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the bins of position (m or rad) and of duration (s)."""
    pair = (bins, bins) if isinstance(bins, (int, np.integer)) else bins
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise ValueError(
            "Argument bins must be a whole number, or two of them or of edges (of position, then of duration), but "
            f"{_checks.show(bins)} was given."
        )
    if sticks.period is not None:
        span = (0.0, sticks.period)
    else:
        low, high = (sticks.position.min(), sticks.position.max()) if len(sticks.position) else (0.0, 0.0)
        span = (low, high) if low < high else (low - 0.5, low + 0.5)
    longest = sticks.duration.max(initial=0) or 1.0
    return (
        edges_of_bins("bins[0]", pair[0], span, sticks.system.coordinates[0].unit),
        edges_of_bins("bins[1]", pair[1], (0.0, longest), "s"),
    )
