"""Checks of a user's system with several contacts, as far as it can be checked before it is simulated."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._types import Array, Number
from .structure_checks import is_singular
from .switched_model import Segments
from .user_system_checks import AFFINE, Near, check_belt, check_rates, check_traceable, rates_near
from .users_forcing import UsersBase

_BY_DIRECTION = (
    "where friction differs with the direction of sliding, leave the normal force as it is and give the contact a "
    "Directional friction law, or smooth the step, jax.numpy.tanh(v / width)."
)
_NOTHING = Segments((), (), ())


def check_contacts(system: Any, y0: tuple[Number, ...]) -> None:
    """Check the methods of `system`, a `SwitchedSystem`, in the state `y0` at time 0, with the base at rest.

    Raises ValueError for what they must not return, and for contacts whose motion is not unique.
    """
    kind, zero = type(system).__name__, jnp.zeros(())
    assert system.contacts is not None
    contacts = system.contacts
    y, base = tuple(jnp.asarray(value, float) for value in y0), UsersBase(zero, zero, zero)
    with _checks.traceable(f"The method relative_velocity of {kind}"):
        velocities = system.relative_velocity(zero, y, base)
    _check_number(kind, "relative_velocity", velocities, contacts)
    check_traceable(system, ("relative_velocity",), zero, y, base)
    check_belt(system, y, base)
    normal_forces: Any = ()
    if system.has_normal_forces:
        with _checks.traceable(f"The method normal_forces of {kind}"):
            normal_forces = system.normal_forces(zero, y, base)
        _check_number(kind, "normal_forces", normal_forces, contacts)
        check_traceable(system, ("normal_forces",), zero, y, base)
    check_traceable(system, ("shortest_time", "static_ratio", "speed_scale"))

    def rates(friction: np.ndarray) -> tuple:
        return system.rates(zero, y, base, jnp.asarray(friction))

    units = np.eye(contacts)
    with _checks.traceable(f"The method rates of {kind}"):
        found = [rates(friction) for friction in (0 * units[0], np.ones(contacts), *units, *-units)]
    check_rates(kind, found[0], len(y))
    check_traceable(system, ("rates",), zero, y, base, jnp.zeros(contacts))
    model: Any = system.model_without_ages(None, None)
    gain = model.instant(model.forcing(zero, _NOTHING), zero, y).gain
    # Also numbers that a class encloses, which only what the methods return can show.
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves((system, y, normal_forces, found, gain))):
        return
    near = Near.of(y, *_velocities(system, y, base))
    near.check(kind, np.asarray(rates_near(system, near.columns, base, jnp.ones(contacts))))
    if system.has_normal_forces:
        forces = jax.vmap(lambda *state: jnp.stack([*map(jnp.asarray, system.normal_forces(zero, state, base))]))
        near.check(kind, np.asarray(forces(*near.columns)), "normal_forces", _BY_DIRECTION)
    _check_affine(kind, np.array([[float(rate) for rate in row] for row in found]), contacts)
    _check_unique(kind, np.asarray(gain))


def _velocities(system: Any, y: tuple[Array, ...], base: UsersBase) -> tuple[Array, Array]:
    """The relative velocities of the contacts (contacts,), and their derivatives by the state (contacts, states)."""

    def of(state: Array) -> Array:
        velocities = system.relative_velocity(jnp.zeros(()), tuple(state), base)
        return jnp.stack([jnp.asarray(velocity, float) for velocity in velocities])

    state = jnp.stack(y)
    return of(state), jax.jacfwd(of)(state)


def _check_number(kind: str, name: str, values: Any, contacts: int) -> None:
    shapes = [np.shape(value) for value in values] if isinstance(values, (tuple, list)) else [()] * np.size(values)
    if len(shapes) != contacts or any(shapes):
        raise ValueError(
            f"Argument {name} of a {kind} must return {contacts} numbers, one for each of its contacts, but "
            f"{_checks.show(values)} was given."
        )


def _check_affine(kind: str, rates: np.ndarray, contacts: int) -> None:
    """`rates`: without friction, with friction 1 in all contacts, in each alone, and with friction -1 in each alone."""
    if not np.all(np.isfinite(rates)):
        return  # the status of the simulation reports it
    idle, together, effects = rates[0], rates[1] - rates[0], rates[2 : 2 + contacts] - rates[0]
    backward = idle - rates[2 + contacts :]
    size = np.sum(np.abs(effects), axis=0)
    wrong = np.maximum(np.abs(together - np.sum(effects, axis=0)), np.max(np.abs(effects - backward), axis=0))
    wrong = np.flatnonzero(wrong > AFFINE * size + 1e-5 * np.max(np.abs(rates), axis=0) * (size == 0))
    if len(wrong):
        raise ValueError(
            f"Argument rates of a {kind} must be affine in friction, a + b_0 friction[0] + b_1 friction[1] + ..., but "
            f"rate number {wrong[0]} is not; multiply each kinetic friction force by its friction, and nothing else."
        )


def _check_unique(kind: str, gain: np.ndarray) -> None:
    if not np.all(np.isfinite(gain)):
        return
    for number, own in enumerate(np.diag(gain)):
        if own <= 0:
            raise ValueError(
                f"Argument rates of a {kind} must let positive friction act against a positive relative velocity, but "
                f"friction[{number}] = 1 changes the rate of relative velocity number {number} by {-own:.6g}; turn its "
                "sign round, or leave out a contact that moves nothing."
            )
    eigenvalues = np.linalg.eigvalsh((gain + gain.T) / 2)
    if is_singular(eigenvalues):
        raise ValueError(
            f"Argument rates of a {kind} must have one motion only, but the effects of the friction forces on the "
            "relative velocities are no positive definite matrix (smallest eigenvalue "
            f"{eigenvalues[0]:.4g}): a contact is implied by others, or friction changes its own normal force too "
            "much; join or leave out such contacts."
        )
