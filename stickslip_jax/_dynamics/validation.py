"""Checks of the arguments of `simulate` and `simulate_ensemble`."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._excitation.excitation import Excitation, WithJumps, excitation_of, is_random, longest_time
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._excitation.smooth import UserMotion
from .._excitation.velocity_steps import VelocitySteps
from .._inputs.inputs import varying
from .._inputs.numbers import shown
from .._numerics.known import plain
from .._systems.system import System
from .._types import AnyArray, Scalar
from .method import Exact, Regularized
from .time_scales import step_for

_LEAST_TURN = 1e-3  # rad in the whole duration: the motion is then good to about 1e-8 in double precision


def check_method(method: Any) -> None:
    """Check that `method` is an `Exact` or a `Regularized`. Raises ValueError otherwise."""
    if not isinstance(method, (Exact, Regularized)):
        raise ValueError(
            f"Argument method must be Exact(...) or Regularized(width), but {_checks.show(method)} was given."
        )


def state_of(system: System, y0: Any) -> tuple[Any, ...]:
    """The initial state `y0` of `system`, checked; zeros if `y0` is None."""
    meaning = tuple(coordinate.meaning for coordinate in system.coordinates)
    entries = _checks.entries("y0", (0.0,) * len(meaning) if y0 is None else y0, meaning)
    check_fixed(y0=entries)
    numbers = _checks.state("y0", entries, meaning)
    system.check_state(numbers)
    return numbers


def check_fixed(**arguments: Any) -> None:
    """Check that no argument holds a distribution, or an array where a number belongs. Raises ValueError otherwise."""
    for name, value in arguments.items():
        for path, source, _ in varying(value, (name,)):
            raise ValueError(
                f"Argument {shown(path)} must be one number here, but {_checks.show(source)} was given; "
                "simulate_ensemble takes distributions, and arrays with one number for each sample."
            )


def one_realization(system: System, base: Any, t1: Scalar) -> Any:
    """`base` as a motion without randomness that covers ``[0, t1]``. Raises ValueError if it is not one."""
    if isinstance(base, VelocitySteps) and base.durations.ndim != 1:
        raise ValueError(
            f"Argument base must be one realisation, but it has durations of shape {base.durations.shape}; "
            "use jax.vmap over the realisations, or simulate_ensemble."
        )
    smooth = excitation_of(base).smooth
    if is_random(base):
        raise ValueError(
            f"Argument base must be a realisation, but the random law {type(base).__name__} was given; "
            "draw one with base.sample(key, t1)."
        )
    check_length(system, base, t1)
    if isinstance(smooth, UserMotion) and not isinstance(base, WithJumps):
        return smooth
    return base.sample(None, t1) if isinstance(base, PiecewiseConstantLaw) else base


def check_length(system: System, base: Any, t1: Scalar) -> None:
    """Check that recorded motions and forces last until `t1`. Raises ValueError otherwise."""
    if _checks.is_traced(t1):
        return
    for name, motion in (("base", base), *(("force", load) for load in system.recorded_loads)):
        longest = longest_time(motion)
        if longest < float(t1) * (1 - 1e-12):
            raise ValueError(
                f"Argument {name} must last until t1 = {float(t1):g} s, but it ends at {longest:g} s; record more of "
                "it or choose a smaller t1."
            )


def warn_of_soft_spring(system: System, solver: Any, t1: Scalar) -> None:
    """Warn where round-off of the position under a force at rest, ``force / stiffness``, hides the motion up to `t1`.

    The motion is of the size ``force t1^2 / (2 mass)``. An integration does not have this round-off.
    """
    frequency = system.natural_frequency
    if frequency is None or solver is not None or not system.has_closed_form:
        return
    if _checks.is_traced(frequency) or _checks.is_traced(t1):
        return
    lowest, duration = float(np.min(frequency)), float(np.min(t1))
    if lowest * duration < _LEAST_TURN:
        warnings.warn(
            f"The natural period, {2 * np.pi / lowest:.3g} s, is so long beside t1 = {duration:.3g} s that the closed "
            "form loses digits: its round-off is that of force / stiffness. If there is to be no spring, integrate "
            "instead: method=Exact(solver=diffrax.Dopri8()).",
            RuntimeWarning,
            stacklevel=4,
        )


def checked_step(system: System, base: Any, method: Exact, t1: Scalar, name: str = "base") -> tuple[Excitation, Scalar]:
    """The `Excitation` made from `base` (the argument called `name`), and the time step (s), at most `t1`."""
    excitation = excitation_of(base, name)
    system.check_excitation(excitation)
    system.check_solver(method.solver)
    step, horizon = step_for(system, excitation, method), plain(t1)
    if _checks.is_traced(step) or _checks.is_traced(horizon):
        return excitation, jnp.minimum(step, horizon)
    return excitation, min(float(step), float(horizon))


def working_dtype(*arrays: AnyArray, stacklevel: int = 3):
    """The floating dtype of a simulation; in float32, warns and says how to get float64."""
    dtype = jnp.result_type(float, *arrays)
    if not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "stickslip_jax runs in float32: event times are good to about 2e-6 of t1. For float64 call "
            'jax.config.update("jax_enable_x64", True) before anything else.',
            stacklevel=stacklevel,
        )
    return dtype
