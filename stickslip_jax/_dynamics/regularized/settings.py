"""Defaults of a regularised simulation: thresholds and tolerances from the scales of the system."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ... import _checks
from ... import _diffrax as diffrax
from ..._excitation.excitation import Excitation
from ..._numerics.known import NotKnown, largest, smallest
from ..._systems.system import System
from ..._types import Array, Scalar
from ..common.method import Regularized
from ..common.time_scales import accurate_step, step_for
from .solve import table_sizes
from .switch import Switch

ADAPTIVE_STEPS, MORE = 2**14, 8
"""Adaptive steps of a trajectory, and how many times as many where they are too few; twice."""
_TRIES, _FEW = 2, 256  # of shortened steps
_SLOW = 1e-3  # of the velocity that friction changes: the threshold of laws with an inner state


def resolved(system: System, excitation: Excitation, method: Regularized, dtype) -> Regularized:
    """`method` with every option filled in, its numbers as arrays of `dtype`.

    Raises ValueError where an option is needed because the system's scales are not known.
    """
    if system.ages:
        raise ValueError(
            "Argument method must be Exact(...) for friction that grows while a stick lasts, but "
            f"{_checks.show(method)} was given: smoothed friction has no stick whose age is known."
        )
    inner = bool(system.inner_laws)
    _check_width(method, inner)
    check_contacts(system, method)
    width = None if method.width is None else jnp.asarray(method.width, dtype)
    speed, deceleration = system.contact_scales
    # Static friction above kinetic friction holds a mass up to one width.
    known = width if system.static_exceeds_kinetic and not inner else speed
    scales = {"threshold": known, "minimum_duration": deceleration}
    for name, known in scales.items():
        if getattr(method, name) is None and known is None:
            own = "; or give it the properties speed_scale and shortest_time" if hasattr(system, "speed_scale") else ""
            raise ValueError(
                f"Argument method must give the {name}, Regularized(..., {name}=...), because the velocities of a "
                f"{type(system).__name__} are not known{own}."
            )
    threshold = method.threshold
    if threshold is None:
        if width is None:
            threshold = _SLOW * jnp.asarray(speed)
        else:
            held = system.static_exceeds_kinetic
            threshold = width if held else Switch(width, method.shape).creep(jnp.asarray(speed))
    duration = method.minimum_duration
    if duration is None:
        assert deceleration is not None
        # Without friction nothing sticks, however slowly the mass passes through.
        slows = jnp.asarray(deceleration) > 0
        never = min(_checks.LARGEST, float(jnp.finfo(dtype).max))
        duration = jnp.where(slows, 10 * threshold / jnp.where(slows, deceleration, 1), never)
        duration = duration if method.step is None else jnp.maximum(duration, 2 * method.step)
    adaptive = method.step is None
    scales = _state_scales(system, excitation, dtype)
    atol = method.rtol * scales if method.atol is None else method.atol
    if np.shape(atol) not in ((), scales.shape):
        raise ValueError(
            f"Argument atol must be one number, or one for each of the {len(scales)} states, but an array of shape "
            f"{np.shape(atol)} was given."
        )
    return Regularized(
        width,
        method.shape,
        step=None if adaptive else jnp.asarray(method.step, dtype),
        solver=diffrax.Kvaerno3() if adaptive and method.solver is None else method.solver,
        rtol=jnp.asarray(method.rtol, dtype),
        atol=jnp.asarray(atol, dtype),
        max_steps=method.max_steps,
        threshold=jnp.asarray(threshold, dtype),
        minimum_duration=jnp.asarray(duration, dtype),
        adjoint=diffrax.RecursiveCheckpointAdjoint() if adaptive and method.adjoint is None else method.adjoint,
    )


def _check_width(method: Regularized, inner: bool) -> None:
    """Check the width, and the step of laws with an inner state. Raises ValueError for what does not fit."""
    if inner and (method.width is not None or method.step is not None):
        raise ValueError(
            "Argument method must be Regularized() without a width and a step for friction laws with an inner state, "
            f"which are smooth by themselves and stiff, but {_checks.show(method)} was given."
        )
    if not inner and method.width is None:
        raise ValueError(
            "Argument width must be positive (in m/s), but None was given; only friction laws with an inner state, "
            "such as LuGre, need none."
        )


def check_contacts(system: System, method: Regularized) -> None:
    """Check what several contacts cannot have. Raises ValueError for it."""
    contacts = system.contact_count
    for name in ("threshold", "minimum_duration"):
        shape = np.shape(getattr(method, name)) if getattr(method, name) is not None else ()
        if shape not in ((),) + (() if contacts is None else ((contacts,),)):
            each = "" if contacts is None else f", or one for each of the {contacts} contacts"
            raise ValueError(f"Argument {name} must be one number{each}, but an array of shape {shape} was given.")
    if contacts is not None and method.step is not None and system.static_exceeds_kinetic:
        raise ValueError(
            "Argument method must be Exact(), or Regularized(width) without a step, where static friction exceeds "
            "kinetic friction in a list of contacts or under a normal force that varies, but a fixed step was given; "
            "or make static friction equal to kinetic friction."
        )


def fixed_steps(system: System, excitation: Excitation, method: Regularized, t1: Scalar) -> int:
    """The largest number of fixed steps that a trajectory takes: ``t1 / step``, and one for the end of each segment,
    twice that where steps must be shorter.

    Where JAX traces a time scale, the given step counts: a trajectory whose steps must be shorter may run out of them.
    Raises NotKnown where `t1` or the given step is traced, ValueError for a step that is too long for the shortest
    time scale.
    """
    horizon, step = largest(t1), step_for(system, excitation, method)
    try:
        shortest = smallest(step)
    except NotKnown:
        shortest = smallest(method.step)
    known = all(of.time is not None for of in system.time_scales(excitation, None).values())
    if known and system.has_fixed_time_scales:
        steps = math.ceil(horizon / shortest) + sum(table_sizes(system, excitation, horizon)) + 1
        return _TRIES * steps + _FEW if system.static_exceeds_kinetic else steps
    shortest = accurate_step(system, excitation, shortest)
    steps = math.ceil(horizon / shortest) + sum(table_sizes(system, excitation, horizon)) + 1
    return _TRIES * steps + _FEW


def _state_scales(system: System, excitation: Excitation, dtype) -> Array:
    """The typical size of each state, the scale of its absolute tolerance."""
    values = jnp.stack([jnp.asarray(scale, dtype) for scale in system.state_scales(excitation)])
    return jnp.where(values > 0, values, 1)


def numbers_as_arrays(tree: Any, dtype) -> Any:
    """Plain numbers in `tree`, whole ones too, as arrays, so that other numbers need no recompilation."""

    def convert(leaf):
        return jnp.asarray(leaf, dtype) if isinstance(leaf, (int, float)) and not isinstance(leaf, bool) else leaf

    return jax.tree.map(convert, tree)
