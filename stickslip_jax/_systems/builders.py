"""Structures that everyone draws: blocks in a row, storeys over a sliding bearing."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import _checks
from .._types import Number
from .contact import Contact
from .friction import FrictionLaw
from .normal_force import NormalForce
from .structure import BLOCKS, STOREYS, LinearStructure
from .structure_checks import numbers_in

STANDARD_GRAVITY = 9.80665  # m/s^2


def block_row(
    blocks: int,
    *,
    mass: Number,
    between: Number,
    to_ground: Number,
    normal_force: NormalForce,
    friction: FrictionLaw,
    damping: Number = 0.0,
) -> LinearStructure:
    """Equal blocks in a row on the base, with springs from each to the next, and from each to the ground.

    The train of Burridge and Knopoff ("Model and theoretical seismicity", 1967) in the frame of the plate that pulls
    it; the base is the floor.

    Args:
        blocks: Their number, at most 64.
        mass: Of each, kg, positive.
        between: Stiffness of the springs between neighbours, N/m, zero or positive.
        to_ground: Stiffness of the spring from each to the ground, N/m, zero or positive.
        normal_force: In each contact with the base, as in `Contact`.
        friction: Of each contact.
        damping: Of a viscous damper from each to the ground, N s/m, zero or positive.

    Raises:
        ValueError: For a number out of its range.

    >>> row = ss.block_row(
    ...     3, mass=1.0, between=1.0, to_ground=0.1, normal_force=1.0, friction=ss.Coulomb(0.3)
    ... )
    >>> print(row.stiffness)
    [[ 1.1 -1.   0. ]
     [-1.   2.1 -1. ]
     [ 0.  -1.   1.1]]
    """
    number = _checks.whole_number("blocks", blocks, maximum=64)
    _checks.positive("mass", mass, "kg")
    for name, value in (("between", between), ("to_ground", to_ground), ("damping", damping)):
        _checks.non_negative(name, value)
    stiffness = to_ground * np.eye(number) + between * row_of_springs(np.ones(number - 1))
    contacts = tuple(Contact.of_mass(i, number, normal_force, friction) for i in range(number))
    is_damped = _checks.is_traced(damping) or damping != 0
    ones = np.ones(number)
    # Each block has a contact of its own: known to be uncoupled, even if the mass is traced.
    return LinearStructure(
        mass * ones, stiffness, damping * ones if is_damped else None, contacts, uncoupled=True, drawn_as=BLOCKS
    )


def storeys_on_bearing(
    mass: Sequence[Number],
    stiffness: Sequence[Number],
    *,
    friction: FrictionLaw,
    damping: Sequence[Number] | None = None,
    bearing_stiffness: Number = 0.0,
    gravity: Number = STANDARD_GRAVITY,
) -> LinearStructure:
    """A shear building on a sliding bearing, or on a pendulum bearing: the base mat slides on the ground.

    The positions are those of the base mat and of the storeys, from below, relative to the ground: the base to simulate
    it with is a `GroundAcceleration`. The normal force is the weight of all.

    Args:
        mass: Of the base mat, then of the storeys, kg, (storeys + 1,), positive.
        stiffness: From the base mat to the first storey, and between storeys, N/m, (storeys,), positive.
        friction: Of the bearing.
        damping: Between the same, N s/m, (storeys,), zero or positive; None is zero.
        bearing_stiffness: N/m; of a pendulum bearing, its weight over the radius. Zero for a flat one.
        gravity: m/s^2, positive.

    Raises:
        ValueError: For a number out of its range, or sequences of lengths that do not fit.
    """
    masses = np.asarray(numbers_in("mass", mass))
    if masses.ndim != 1 or len(masses) < 2 or not np.all(masses > 0):
        raise _checks.refused("mass", "hold two positive numbers or more, the base mat's and the storeys'", mass)
    springs = _of_storeys("stiffness", stiffness, len(masses))
    if not np.all(springs > 0):
        raise _checks.refused("stiffness", "hold positive numbers", stiffness)
    _checks.non_negative("bearing_stiffness", bearing_stiffness, "N/m")
    _checks.positive("gravity", gravity, "m/s^2")
    matrix = row_of_springs(springs)
    matrix[0, 0] += float(bearing_stiffness)
    dampers = None
    if damping is not None:
        values = _of_storeys("damping", damping, len(masses))
        if not np.all(values >= 0):
            raise _checks.refused("damping", "hold numbers of zero or more", damping)
        dampers = row_of_springs(values)
    weight = float(gravity) * float(np.sum(masses))
    return LinearStructure(
        masses, matrix, dampers, (Contact.of_mass(0, len(masses), weight, friction),), drawn_as=STOREYS
    )


def row_of_springs(stiffness: Any) -> Any:
    """The stiffness matrix of springs between neighbours in a row, from an array (springs,)."""
    differences = differences_in_row(stiffness.shape[0] + 1)
    return differences.T @ (stiffness[:, None] * differences)


def differences_in_row(size: int) -> np.ndarray:
    """Of each number and the next one, as a matrix (size - 1, size)."""
    return np.diff(np.eye(size), axis=0)


def _of_storeys(name: str, values: Any, masses: int) -> np.ndarray:
    array = np.asarray(numbers_in(name, values))
    if array.shape != (masses - 1,) or not np.all(np.isfinite(array)):
        raise _checks.refused(name, f"hold {masses - 1} finite numbers, one for each storey", values)
    return array
