"""Values, and pairs of values, that occur again and again: the atoms of a distribution."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# Values that repeat have more than _REPEATS others within round-off, and are either _DENSER times as dense as an
# interval around them that is _WIDER times as wide (where the density is singular like the inverse of a square root,
# the ratio is only 7), or _FAR_DENSER times as dense as values spread evenly over the range.
_REPEATS = 10
_WIDER, _DENSER = 32, 10
_FAR_DENSER = 1000
_SHARE_OF_RANGE = 1e-9
_LEAST_SHARE = 1e-3  # of all pairs: what is rarer is not told apart as an atom


class Atoms(NamedTuple):
    """Points that have a probability of their own, the most frequent first.

    - `x`, `y`: where they are, (atoms,). `share` of all pairs at each, (atoms,).
    - `of_pair`: which pairs are at one of them, (pairs,).
    """

    x: Float[np.ndarray, " atoms"]
    y: Float[np.ndarray, " atoms"]
    share: Float[np.ndarray, " atoms"]
    of_pair: Bool[np.ndarray, " pairs"]


def repeated(values: np.ndarray, round_off: float, span: float) -> np.ndarray:
    """Which of `values` have more than `_REPEATS` others within round-off, (values,); `span`: from least to largest.

    They must also be far denser than their surroundings, because in float32 millions of values are close by chance; or
    so dense that no smooth density explains it, because motion that becomes periodic leaves atoms side by side.
    """
    within, ranked = _within(round_off, span), np.sort(values)

    def number_within(distance: float) -> np.ndarray:
        below = np.searchsorted(ranked, values - distance, side="left")
        return np.searchsorted(ranked, values + distance, side="right") - below

    near = number_within(within)
    around = (number_within(_WIDER * within) - near) / (_WIDER - 1)
    usual = len(values) * 2 * within / max(span, within)  # if all were spread evenly
    return (near > _REPEATS) & ((near > _DENSER * around) | (near > _FAR_DENSER * usual))


def atoms_of(x: np.ndarray, y: np.ndarray, round_off: tuple[float, float]) -> Atoms:
    """The atoms of the pairs `x`, `y` (pairs,): points with more than 10 pairs and 0.1 % of them all.

    Both values of such a pair are `repeated`. `round_off`: of x and of y.
    """
    spans = [float(np.ptp(values)) if len(values) else 0.0 for values in (x, y)]
    axes = list(zip((x, y), round_off, spans, strict=True))
    both = np.flatnonzero(np.logical_and(*(repeated(*axis) for axis in axes)))
    place = np.stack([_groups(values[both], _within(off, span)) for values, off, span in axes])
    _, first, pair, counts = np.unique(place, axis=1, return_index=True, return_inverse=True, return_counts=True)
    atoms = np.flatnonzero(counts > max(_REPEATS, _LEAST_SHARE * len(x)))
    atoms = atoms[np.argsort(-counts[atoms], kind="stable")]
    of_pair = np.zeros(len(x), bool)
    of_pair[both[np.isin(pair.ravel(), atoms)]] = True
    here = both[first[atoms]]
    return Atoms(x[here], y[here], counts[atoms] / max(len(x), 1), of_pair)


def _within(round_off: float, span: float) -> float:
    return max(round_off, _SHARE_OF_RANGE * span, float(np.finfo(float).tiny))


def _groups(values: np.ndarray, within: float) -> np.ndarray:
    """The number of the group that each value belongs to: neighbours no farther apart than `within` share one."""
    order = np.argsort(values, kind="stable")
    group = np.empty(len(values), int)
    group[order] = np.cumsum(np.diff(values[order], prepend=values[order[:1]]) > within)
    return group
