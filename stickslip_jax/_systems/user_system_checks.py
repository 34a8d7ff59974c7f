"""Checks of a user's `SwitchedSystem`, as far as it can be checked before it is simulated."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._types import Array, Number
from .structure_checks import MOST_CONTACTS
from .switched_model import Base
from .system import System

_SHARES = (0.0, 1.0, -1.0, 0.5)  # of the friction force; the rates at them show whether they are affine
_ONE_CONTACT = (
    "declare the number of dry-friction contacts, contacts = 2, or smooth the force of another one, "
    "F jax.numpy.tanh(v / width) with a small width."
)
_NEARER, _JUMP = 0.1, 0.9  # a rate that changes by as much over a tenth of a small step jumps
AFFINE = 1e-3  # of the largest rate: far above round-off in float32, far below any law that is not affine


def check_fields(system: Any) -> None:
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
    if system.has_normal_forces and system.contacts is None:
        raise ValueError(
            f"Argument normal_forces of a {type(system).__name__} must come with the number of its contacts, but "
            "contacts is None, and nobody would ask for it: declare contacts = 1, or more."
        )
    names = system.state_names
    if not isinstance(names, tuple) or len(names) < 2 or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"Argument state_names of a {type(system).__name__} must be a tuple of two names or more, but "
            f"{_checks.show(names)} was given."
        )
    kind = type(system).__name__
    with _checks.traceable(f"The property static_ratio of {kind}"):
        ratio = system.static_ratio
    if system.contacts is None:
        _checks.numeric("static_ratio", ratio)
    elif np.shape(ratio) not in ((), (_checks.whole_number("contacts", system.contacts, maximum=MOST_CONTACTS),)):
        raise _checks.refused("static_ratio", f"be one number or an array ({system.contacts},)", ratio)
    if not _checks.is_traced(ratio) and np.min(np.asarray(ratio)) < 1:
        raise ValueError(
            f"Argument static_ratio must be at least 1, but {ratio} was given: a stick holds at least as "
            "well as a slip."
        )
    for name in ("shortest_time", "speed_scale"):
        with _checks.traceable(f"The property {name} of {kind}"):
            value = getattr(system, name)
        if value is not None:
            _checks.positive(name, value)


def check_motion(system: Any, y0: tuple[Number, ...]) -> None:
    """Check the methods of `system` in the state `y0` at time 0, with the base at rest. Raises ValueError for what they
    must not return.
    """
    kind, zero = type(system).__name__, jnp.zeros(())
    y, base = tuple(jnp.asarray(value, float) for value in y0), Base(zero, zero)
    traced = jax.tree.map(jnp.asarray, system)  # as engines hold it: its numbers are arrays that JAX traces
    for name in ("shortest_time", "static_ratio"):
        with _checks.traceable(f"The property {name} of {kind}"):
            jax.make_jaxpr(lambda system, name=name: getattr(system, name))(traced)
    try:
        with _checks.traceable(f"The method rates of {kind}"):
            rates = [system.rates(zero, y, base, jnp.asarray(share)) for share in _SHARES]
            jax.make_jaxpr(type(system).rates)(traced, zero, y, base, zero)
    except (IndexError, TypeError) as error:
        if not _takes_two(system, zero, y, base):
            raise
        raise ValueError(
            f"Argument rates of a {kind} must take one number as friction, but it takes several; {_ONE_CONTACT}"
        ) from error
    except ValueError as error:  # rates unpacks the state into another number of variables
        if isinstance(error.__cause__, (TypeError, jax.errors.JAXTypeError)):
            raise
        raise ValueError(
            f"Argument rates of a {kind} must accept a state of {len(y)} numbers, but: {error}."
        ) from error
    check_rates(kind, rates[0], len(y))
    with _checks.traceable(f"The method relative_velocity of {kind}"):
        velocity = system.relative_velocity(zero, y, base)
        jax.make_jaxpr(type(system).relative_velocity)(traced, zero, y, base)
    if isinstance(velocity, (tuple, list)) or np.size(velocity) > 1:
        number = len(velocity) if isinstance(velocity, (tuple, list)) else np.size(velocity)
        raise ValueError(
            f"Argument relative_velocity of a {kind} must return one number, but {number} were given; {_ONE_CONTACT}"
        )
    if not _is_scalar(velocity):
        raise ValueError(
            f"Argument relative_velocity of a {kind} must return a scalar, but {_checks.show(velocity)} was given."
        )
    gradient = jax.grad(lambda y: jnp.asarray(system.relative_velocity(zero, y, base), float))(y)
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves((rates, gradient))):
        return
    check_smooth(system, y, base, jnp.ones(()))
    _check_affine(kind, np.array([[float(rate) for rate in row] for row in rates]), np.array(gradient, float))


def check_rates(kind: str, rates: object, size: int) -> None:
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


def _takes_two(system: Any, t: Array, y: tuple[Array, ...], base: Base) -> bool:
    """Whether the rates of `system` can be asked for with two numbers as friction."""
    try:
        system.rates(t, y, base, jnp.zeros(2))
    except Exception:  # of a user's code
        return False
    return True


def check_smooth(system: Any, y: tuple[Array, ...], base: Base, friction: Array) -> None:
    """Check that the rates do not jump where a number of the state passes zero, its initial value, or another number.

    There the sign of a velocity changes that somebody writes for a second contact.
    """
    values = [float(value) for value in y]
    places = [(i, centre) for i in range(len(y)) for centre in sorted({0.0, *values})]
    step = float(np.sqrt(np.finfo(y[0].dtype).eps)) * max(1.0, *map(abs, values))
    near = np.array(values) * np.ones((len(places), 4, 1))
    for row, (i, centre) in zip(near, places, strict=True):
        row[:, i] = centre + step * np.array([-1.0, 1.0, -_NEARER, _NEARER])
    columns = tuple(jnp.asarray(near.reshape(-1, len(y)).T, y[0].dtype))
    size = len(near) * 4
    found = jax.vmap(lambda *state: tuple(map(jnp.asarray, system.rates(jnp.zeros(()), state, base, friction))))(
        *columns
    )
    rates = np.stack([np.broadcast_to(np.asarray(rate, float), size) for rate in found], -1).reshape(len(near), 4, -1)
    far, close = np.abs(rates[:, 1] - rates[:, 0]), np.abs(rates[:, 3] - rates[:, 2])
    most = np.max(np.abs(rates), axis=(0, 1), where=np.isfinite(rates), initial=0.0)
    jumps = (close > _JUMP * far) & (close > AFFINE * most)
    if not np.any(jumps):
        return
    place, number = (int(index) for index in np.argwhere(jumps)[0])
    state, centre = places[place]
    raise ValueError(
        f"Argument rates of a {type(system).__name__} must be smooth functions of the state, but rate number {number} "
        f"jumps from {rates[place, 2, number]:.6g} to {rates[place, 3, number]:.6g} where number {state} of the state "
        f"passes {centre:g}; {_ONE_CONTACT}"
    )


def _check_affine(kind: str, rates: np.ndarray, gradient: np.ndarray) -> None:
    """Check that `rates`, (4, states) at `_SHARES`, are affine in them, and that friction opposes the sliding."""
    if not np.all(np.isfinite(rates)):
        return  # the status of the simulation reports it
    bend = np.max(np.abs([rates[1] + rates[2] - 2 * rates[0], rates[0] + rates[1] - 2 * rates[3]]), axis=0)
    wrong = np.flatnonzero(bend > AFFINE * np.max(np.abs(rates - rates[0]), axis=0, initial=0))
    wrong = [number for number in wrong if bend[number] > 1e-5 * np.max(np.abs(rates[:, number]))]
    if wrong:
        values = ", ".join(f"{rate:.6g} at {share:g}" for share, rate in zip(_SHARES, rates[:, wrong[0]], strict=True))
        raise ValueError(
            f"Argument rates of a {kind} must be affine in friction, a + b friction, but rate number {wrong[0]} is "
            f"{values}; multiply the kinetic friction force by friction, and nothing else."
        )
    effects = gradient * (rates[1] - rates[2]) / 2
    if np.sum(effects) > AFFINE * np.sum(np.abs(effects)):
        raise ValueError(
            f"Argument rates of a {kind} must let positive friction act against a positive relative velocity, but "
            f"friction = 1 raises the rate of the relative velocity by {np.sum(effects):.6g} against friction = 0; "
            "turn its sign round."
        )


def _is_scalar(value: object) -> bool:
    return isinstance(value, (int, float, np.generic, np.ndarray, jax.Array)) and np.ndim(value) == 0
