"""Pairs of values that occur again and again: the atoms of a joint distribution."""

from typing import NamedTuple

import numpy as np

_LEAST_PAIRS, _LEAST_SHARE = 10, 1e-3
_SHARE_OF_RANGE = 1e-9


class Atoms(NamedTuple):
    """Points that have a probability of their own, the most frequent first.

    - `x`, `y`: where they are, (atoms,). `share` of all pairs at each, (atoms,).
    - `of_pair`: which pairs are at one of them, (pairs,).
    """

    x: np.ndarray
    y: np.ndarray
    share: np.ndarray
    of_pair: np.ndarray


def atoms_of(x: np.ndarray, y: np.ndarray, round_off: tuple[float, float]) -> Atoms:
    """The atoms of the pairs `x`, `y` (pairs,): points at which more than 10 pairs and 0.1 % of them all lie.

    `round_off`: values of x, and of y, that differ by no more than this may be equal.
    """
    place = np.stack([_groups(values, off) for values, off in zip((x, y), round_off, strict=True)])
    _, first, pair, counts = np.unique(place, axis=1, return_index=True, return_inverse=True, return_counts=True)
    atoms = np.flatnonzero(counts > max(_LEAST_PAIRS, _LEAST_SHARE * len(x)))
    atoms = atoms[np.argsort(-counts[atoms], kind="stable")]
    return Atoms(x[first[atoms]], y[first[atoms]], counts[atoms] / max(len(x), 1), np.isin(pair.ravel(), atoms))


def _groups(values: np.ndarray, round_off: float) -> np.ndarray:
    """The number of the group that each value belongs to: neighbours that differ by round-off are in one group."""
    if len(values) == 0:
        return np.zeros(0, int)
    order = np.argsort(values, kind="stable")
    ranked = values[order]
    within = max(round_off, _SHARE_OF_RANGE * float(ranked[-1] - ranked[0]))
    group = np.empty(len(values), int)
    group[order] = np.concatenate([[0], np.cumsum(np.diff(ranked) > within)])
    return group
