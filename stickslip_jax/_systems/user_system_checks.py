"""Checks of a user's system, as far as it can be checked before it is simulated."""

import dataclasses
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._types import Number
from .switched_model import Base
from .system import System

if TYPE_CHECKING:
    from .switched_system import SwitchedSystem

_SHARES = (0.0, 1.0, -1.0, 0.5)  # of the friction force; the rates at them show whether they are affine
_AFFINE = 1e-3  # of the largest rate: far above round-off in float32, far below any law that is not affine


def check_fields(system: "SwitchedSystem") -> None:
    """Check the fields and properties of `system`. Raises ValueError for what does not fit."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(system):
        if not isinstance(leaf, (int, float, np.ndarray, np.generic, jax.Array)):
            field = jax.tree_util.keystr(path).lstrip(".")
            raise ValueError(
                f"Argument {field} of a {type(system).__name__} must be a number or an array, but {_checks.show(leaf)} "
                f"was given; declare a field of another kind as {field}: ... = equinox.field(static=True)."
            )
    for field in dataclasses.fields(system):
        if callable(getattr(System, field.name, None)):
            raise ValueError(
                f"Argument {field.name} of a {type(system).__name__} must have another name, because {field.name} is "
                "what the package asks of every system; rename the field."
            )
    names = system.state_names
    if not isinstance(names, tuple) or len(names) < 2 or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"Argument state_names of a {type(system).__name__} must be a tuple of two names or more, but "
            f"{_checks.show(names)} was given."
        )
    _checks.numeric("static_ratio", system.static_ratio)
    if not _checks.is_traced(system.static_ratio) and system.static_ratio < 1:
        raise ValueError(
            f"Argument static_ratio must be at least 1, but {system.static_ratio} was given: a stick holds at least as "
            "well as a slip."
        )
    for name in ("shortest_time", "speed_scale"):
        if getattr(system, name) is not None:
            _checks.positive(name, getattr(system, name))


def check_motion(system: "SwitchedSystem", y0: tuple[Number, ...]) -> None:
    """Check the methods of `system` in the state `y0` at time 0, with the base at rest. Raises ValueError for what they
    must not return.
    """
    kind, zero = type(system).__name__, jnp.zeros(())
    y, base = tuple(jnp.asarray(value, float) for value in y0), Base(zero, zero)
    try:
        rates = [system.rates(zero, y, base, jnp.asarray(share)) for share in _SHARES]
    except ValueError as error:  # rates unpacks the state into another number of variables
        raise ValueError(
            f"Argument rates of a {kind} must accept a state of {len(y)} numbers, but: {error}."
        ) from error
    _check_rates(kind, rates[0], len(y))
    velocity = system.relative_velocity(zero, y, base)
    if not _is_scalar(velocity):
        raise ValueError(
            f"Argument relative_velocity of a {kind} must return a scalar, but {_checks.show(velocity)} was given."
        )
    gradient = jax.grad(lambda y: jnp.asarray(system.relative_velocity(zero, y, base), float))(y)
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves((rates, gradient))):
        return
    _check_affine(kind, np.array([[float(rate) for rate in row] for row in rates]), np.array(gradient, float))


def _check_rates(kind: str, rates: object, size: int) -> None:
    if not isinstance(rates, (tuple, list)) or len(rates) != size:
        shown = f"{len(rates)}" if isinstance(rates, (tuple, list)) else _checks.show(rates)
        raise ValueError(
            f"Argument rates of a {kind} must return a tuple of {size} numbers, one for each of state_names, but "
            f"{shown} was given."
        )
    for number, rate in enumerate(rates):
        if not _is_scalar(rate):
            raise ValueError(
                f"Argument rates of a {kind} must return scalars, but number {number} of shape {np.shape(rate)} was "
                "given."
            )


def _check_affine(kind: str, rates: np.ndarray, gradient: np.ndarray) -> None:
    """Check that `rates`, (4, states) at `_SHARES`, are affine in them, and that friction opposes the sliding."""
    if not np.all(np.isfinite(rates)):
        return  # the status of the simulation reports it
    bend = np.max(np.abs([rates[1] + rates[2] - 2 * rates[0], rates[0] + rates[1] - 2 * rates[3]]), axis=0)
    wrong = np.flatnonzero(bend > _AFFINE * np.max(np.abs(rates - rates[0]), axis=0, initial=0))
    wrong = [number for number in wrong if bend[number] > 1e-5 * np.max(np.abs(rates[:, number]))]
    if wrong:
        values = ", ".join(f"{rate:.6g} at {share:g}" for share, rate in zip(_SHARES, rates[:, wrong[0]], strict=True))
        raise ValueError(
            f"Argument rates of a {kind} must be affine in friction, a + b friction, but rate number {wrong[0]} is "
            f"{values}; multiply the kinetic friction force by friction, and nothing else."
        )
    effects = gradient * (rates[1] - rates[2]) / 2
    if np.sum(effects) > _AFFINE * np.sum(np.abs(effects)):
        raise ValueError(
            f"Argument rates of a {kind} must let positive friction act against a positive relative velocity, but "
            f"friction = 1 raises the rate of the relative velocity by {np.sum(effects):.6g} against friction = 0; "
            "turn its sign round."
        )


def _is_scalar(value: object) -> bool:
    return isinstance(value, (int, float, np.generic, np.ndarray, jax.Array)) and np.ndim(value) == 0
