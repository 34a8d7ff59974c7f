"""Checks of the arguments of a `LinearStructure`."""

from typing import Any

import numpy as np

from .. import _checks
from .._excitation.recorded import Recorded
from .._excitation.smooth import Signal
from .contact import Contact

MOST_CONTACTS = 64
_ROUND_OFF = 1e-10  # of the largest entry of a matrix
_LEAST = 1e-12  # the smallest eigenvalue over the largest: a smaller one is round-off


def check_structure(mass: Any, stiffness: Any, damping: Any, contacts: Any, force: Any) -> None:
    """Raises ValueError for matrices and contacts that do not fit each other, or have no unique motion."""
    size = _check_matrix("mass", mass, None)
    _check_matrix("stiffness", stiffness, size)
    if damping is not None:
        _check_matrix("damping", damping, size)
    _check_mass(mass)
    _check_contacts(mass, contacts, size)
    check_forces("force", force, size)


def check_forces(name: str, forces: Any, size: int) -> None:
    """Raises ValueError unless `forces` is None, or a tuple with one for each of `size` masses."""
    if forces is None:
        return
    if not isinstance(forces, tuple) or len(forces) != size:
        raise _checks.refused(name, f"be a tuple of {size} forces, one for each mass (None for no force)", forces)
    for number, part in enumerate(forces):
        if part is not None and not isinstance(part, (Signal, Recorded)):
            try:
                _checks.bounded(f"{name}[{number}]", part)
            except ValueError:
                raise _checks.refused(f"{name}[{number}]", "be a number, a Signal, a Recorded or None", part) from None


def is_uncoupled(mass: Any, contacts: tuple[Contact, ...]) -> bool:
    """Whether no two contacts have an effect on each other; False where it is not known."""
    if not _is_known(mass, contacts):
        return False
    gain = _gain(mass, contacts)
    return bool(np.all(gain == np.diag(np.diag(gain))))


def is_singular(eigenvalues: np.ndarray) -> bool:
    """Whether the smallest of these, in order, is not positive, but for round-off."""
    return bool(eigenvalues[0] <= _LEAST * eigenvalues[-1])


def _is_known(mass: Any, contacts: tuple[Contact, ...]) -> bool:
    return not any(_checks.is_traced(value) for value in (mass, *(contact.direction for contact in contacts)))


def _gain(mass: Any, contacts: tuple[Contact, ...]) -> np.ndarray:
    directions = np.stack([np.asarray(contact.direction, float) for contact in contacts])
    mass = np.asarray(mass, float)
    by_force = directions.T / mass[:, None] if mass.ndim == 1 else np.linalg.solve(mass, directions.T)
    return directions @ by_force


def numbers_in(name: str, value: Any) -> Any:
    """`value` as an array of numbers; a traced one as it is. Raises ValueError for anything else."""
    if _checks.is_traced(value):
        return value
    try:
        return np.asarray(_checks.numbers(name, value), float)
    except ValueError:
        demand = "hold real numbers, no distributions and nothing masked; make an array of traced ones by jnp.array"
        raise _checks.refused(name, demand, value) from None


def _check_matrix(name: str, value: Any, size: int | None) -> int:
    shape = np.shape(numbers_in(name, value))
    square = len(shape) == 1 or (len(shape) == 2 and shape[0] == shape[1])
    if not square or shape[0] == 0 or (size is not None and shape[0] != size):
        many = "d" if size is None else str(size)
        raise ValueError(
            f"Argument {name} must be a symmetric matrix ({many}, {many}) or its diagonal ({many},), but an array of "
            f"shape {shape} was given."
        )
    if _checks.is_traced(value):
        return shape[0]
    matrix = np.asarray(value, float)
    if not np.all(np.abs(matrix) <= _checks.LARGEST):
        raise _checks.refused(name, f"hold finite numbers of a size up to {_checks.LARGEST}", value)
    if matrix.ndim == 2 and np.max(np.abs(matrix - matrix.T)) > _ROUND_OFF * np.max(np.abs(matrix)):
        i, j = np.unravel_index(np.argmax(np.abs(matrix - matrix.T)), matrix.shape)
        raise ValueError(
            f"Argument {name} must be symmetric, but its entries [{i}, {j}] and [{j}, {i}] are {matrix[i, j]:g} and "
            f"{matrix[j, i]:g}."
        )
    return shape[0]


def _check_mass(value: Any) -> None:
    if _checks.is_traced(value):
        return
    mass = np.asarray(value, float)
    eigenvalues = np.sort(mass) if mass.ndim == 1 else np.linalg.eigvalsh(mass)
    if is_singular(eigenvalues):
        raise ValueError(
            f"Argument mass must be positive definite, but its smallest eigenvalue is {eigenvalues[0]:.4g} beside the "
            f"largest, {eigenvalues[-1]:.4g}; leave out coordinates without mass."
        )


def _check_contacts(mass: Any, contacts: Any, size: int) -> None:
    if not isinstance(contacts, tuple) or not contacts or not all(isinstance(c, Contact) for c in contacts):
        raise _checks.refused("contacts", "be a tuple of one Contact or more", contacts)
    if len(contacts) > MOST_CONTACTS:
        raise ValueError(f"Argument contacts must hold at most {MOST_CONTACTS}, but {len(contacts)} were given.")
    for number, contact in enumerate(contacts):
        if np.shape(contact.direction) != (size,):
            raise ValueError(
                f"Argument direction of contact {number} must hold {size} numbers, one for each mass, but "
                f"{np.shape(contact.direction)[0]} were given."
            )
        if not _checks.is_traced(contact.direction) and not np.any(np.asarray(contact.direction)):
            raise ValueError(
                f"Argument direction of contact {number} must not be zero: such a contact moves with no mass."
            )
    if any(_checks.is_traced(contact.direction) for contact in contacts):
        return  # `LinearStructure.redundant` tells the status
    # Contacts are independent if their directions are, whatever the masses.
    eigenvalues = np.linalg.eigvalsh(_gain(np.ones(size) if _checks.is_traced(mass) else mass, contacts))
    if is_singular(eigenvalues):
        raise ValueError(
            "Argument contacts must be independent of each other, but the relative velocity of one is implied by "
            "others (their directions are linearly dependent); join contacts with the same direction in one."
        )
