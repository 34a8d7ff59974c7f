"""The mechanisms of the package's own systems as drawings."""

import math
from itertools import pairwise

import numpy as np

from .system import Belt, Body, Disk, Mechanism, OverTime, Part, Rod, Spring

_STOREY, _WIDTH = 3.0, 9.0  # m: buildings are drawn with these, since nothing in the equations depends on them
_WITH_COILS = 16  # springs between blocks; of more, coils could not be seen


def mass_on_belt(position: np.ndarray, base: np.ndarray, has_spring: bool) -> Mechanism:
    """A mass, the spring that holds it to a wall at the left, and the belt that it rubs on; all positions in m."""
    low, high, size = _extent(position)
    width = 0.3 * size
    wall, right = low - width / 2 - 0.45 * size, high + width / 2 + 0.25 * size
    left = wall - 0.06 * size if has_spring else low - width / 2 - 0.25 * size
    parts: list[Part] = [Belt(0.0, base, (left, right))]
    if has_spring:
        parts.append(Body(((left + wall) / 2, 0.65), wall - left, 1.3, fixed=True))
        parts.append(Spring((wall, 0.55), (position - width / 2, 0.55)))
    parts.append(Body((position, 0.5), width, 1.0, (0,)))
    return Mechanism(tuple(parts), (left, right), (-0.35, 1.75), "position $x$ (m)")


def motor_and_cart(angle: np.ndarray, eccentricity: float) -> Mechanism:
    """The disk of a motor, whose pin moves a scotch yoke and the cart on its rail; all to scale."""
    d = eccentricity
    pin, away = (d * np.cos(angle), d * np.sin(angle)), 3.9 * d
    cart, rail = pin[0] + away, -0.5 * d
    parts = (
        Disk((0.0, 0.0), 1.3 * d, angle),
        Body((pin[0], 0.0), 0.4 * d, 2.7 * d),
        Rod((pin[0] + 0.2 * d, 0.0), (cart - 0.8 * d, 0.0)),
        Body((away, rail - 0.1 * d), 4.2 * d, 0.2 * d, fixed=True),
        Body((cart, 0.0), 1.6 * d, d, (0,)),
        Disk(pin, 0.14 * d),
    )
    label = "distance from the axis of the motor (m)"
    return Mechanism(parts, (-1.5 * d, 6.2 * d), (-1.5 * d, 2.0 * d), label, equal=True)


def blocks(
    positions: tuple[np.ndarray, ...], base: np.ndarray, stiffness: np.ndarray, on: tuple[tuple[int, ...], ...]
) -> Mechanism:
    """Blocks in a row on a belt, with springs between neighbours and to a plate above.

    `on`: the contacts of each block.
    """
    # So far apart that they never meet.
    nearer = max((float(np.max(x - y)) for x, y in pairwise(positions)), default=0.0)
    size = max(nearer, *(float(np.ptp(x)) for x in positions)) or 1.0
    width = 0.5 * size
    apart = width + max(nearer, 0.0) + 0.3 * size
    rest = apart * np.arange(len(positions))
    places = [x + place for x, place in zip(positions, rest, strict=True)]
    low, high = float(np.min(places[0])) - 0.6 * size, float(np.max(places[-1])) + 0.6 * size
    low, high = min(low, -0.6 * size), max(high, float(rest[-1]) + 0.6 * size)
    to_plate = np.abs(np.sum(stiffness, axis=1)) > 1e-9 * np.abs(np.diag(stiffness))
    link = Spring if len(positions) <= _WITH_COILS else Rod
    parts: list[Part] = [Belt(0.0, base, (low, high))]
    if np.any(to_plate):
        parts.append(Body(((low + high) / 2, 2.08), high - low, 0.16, fixed=True))
    parts += [link((rest[i], 2.0), (places[i], 0.8)) for i in np.flatnonzero(to_plate)]
    for i in range(len(positions) - 1):
        if stiffness[i, i + 1] != 0:
            parts.append(link((places[i] + width / 2, 0.4), (places[i + 1] - width / 2, 0.4)))
    parts += [Body((x, 0.4), width, 0.8, at) for x, at in zip(places, on, strict=True)]
    label = f"position (m), blocks drawn {apart:.3g} m apart"
    return Mechanism(tuple(parts), (low, high), (-0.35, 2.75), label)


def storeys(positions: tuple[np.ndarray, ...], base: np.ndarray, on: tuple[tuple[int, ...], ...]) -> Mechanism:
    """A building: its mat on the ground, and its storeys above it; displacements are exaggerated."""
    largest = max(float(np.max(np.abs(x))) for x in positions)
    factor = 1.0
    if largest > 0:  # the largest of 1, 2 and 5 times a power of ten that is not above what fits
        fits = 0.25 * _WIDTH / largest
        power = 10.0 ** math.floor(math.log10(fits))
        factor = next(share * power for share in (5.0, 2.0, 1.0) if share * power <= fits * (1 + 1e-12))
    places = [factor * x for x in positions]
    half, edge = 0.5 * _WIDTH, 0.92 * _WIDTH
    parts: list[Part] = [Belt(-0.3, factor * base, (-edge, edge), marks=12)]
    for i in range(len(places) - 1):
        for side in (-0.85 * half, 0.0, 0.85 * half):
            parts.append(Rod((places[i] + side, i * _STOREY), (places[i + 1] + side, (i + 1) * _STOREY)))
    for i, x in enumerate(places):
        parts.append(Body((x, i * _STOREY), _WIDTH, 0.6 if i == 0 else 0.4, on[i]))
    top = (len(places) - 1) * _STOREY
    note = f"displacements drawn {factor:g} times as large, storeys {_STOREY:g} m high"
    return Mechanism(tuple(parts), (-edge, edge), (-0.12 * top - 0.6, 1.25 * top + 0.5), equal=True, note=note)


def disks(
    angles: tuple[np.ndarray, ...], base: OverTime, stiffness: np.ndarray, directions: np.ndarray, on_base: np.ndarray
) -> Mechanism:
    """Inertias in a row as disks, joined by shafts; a contact of one disk is in it, one of several between them.

    - `directions`: of the contacts, (contacts, disks).
    - `on_base`: how much of the base velocity each contact subtracts, (contacts,).
    """
    touched = [np.flatnonzero(row) for row in directions]
    spacing = 3.0
    parts: list[Part] = []
    for i in range(len(angles) - 1):
        if stiffness[i, i + 1] != 0:
            parts.append(Rod((spacing * i, 0.0), (spacing * (i + 1), 0.0)))
    for number, at in enumerate(touched):
        if len(at) > 1:  # a clutch
            parts.append(Body((spacing * float(np.mean(at)), 0.0), 0.35, 1.6, (number,)))
        elif on_base[number] != 0:
            parts.append(Disk((spacing * float(at[0]), 0.0), 1.25, base, is_base=True))
    for i, angle in enumerate(angles):
        own = tuple(number for number, at in enumerate(touched) if at.tolist() == [i])
        parts.append(Disk((spacing * i, 0.0), 1.0, angle, own, f"{i}"))
    right = spacing * (len(angles) - 1) + 1.5
    return Mechanism(tuple(parts), (-1.5, right), (-1.9, 2.2), equal=True)


def _extent(values: np.ndarray) -> tuple[float, float, float]:
    """The smallest and the largest value, and their distance: the size of the motion, or 1 where nothing moves."""
    low, high = float(np.min(values)), float(np.max(values))
    largest = max(abs(low), abs(high))
    # A motion of the size of the round-off is none.
    return low, high, high - low if high - low > 1e-9 * largest else largest or 1.0
