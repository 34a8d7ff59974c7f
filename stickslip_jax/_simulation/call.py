"""Simulate one realisation: `simulate(system, base, t1=..., y0=...)`."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.common.validation import Arguments, working_dtype
from .._dynamics.engine_choice import engine_for
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._status import Status
from .._systems.system import System
from .._types import InitialState, Scalar
from .result import Simulation


def simulate(
    system: System,
    base: BaseMotion,
    *,
    t1: Scalar,
    y0: InitialState | None = None,
    method: Exact | Regularized = EXACT,
) -> Simulation:
    """Simulate one realisation and record every stick. A pure function: works under jit, vmap, jvp, grad.

    Args:
        system: The oscillator: a `MassSpring`, a `MotorCart` or a `SwitchedSystem` of your own.
        base: Its excitation: a realisation, ``law.sample(key, t1)``; a base motion without randomness (`SquareWave`,
            `Harmonic`, `SumOfHarmonics`, `Recorded`, `WithJumps`, or an object with ``velocity(t)`` and
            ``acceleration(t)``, m/s and m/s^2); a `GroundAcceleration`; for a `MotorCart` a `SourceVoltage`.
        t1: Duration, s.
        y0: Initial state: position (m) and velocity (m/s); for a `MotorCart` angle (rad), angular velocity (rad/s) and
            current (A). Zeros by default.
        method: `Exact`, with a time step where one is needed, or `Regularized`.

    Returns:
        The trajectory; check its `status`. Its arrays have slots for all sticks that can happen.

    Raises:
        ValueError: For arguments outside these bounds, for a step too long for the shortest time scale, and for a
            function or class in the arguments that encloses a number by which JAX differentiates.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)
    ... )
    >>> one = ss.simulate(system, ss.Constant(1.0), t1=10.0, y0=(0.0, 1.0))
    >>> sticks = one.sticks
    >>> print(sticks.start[0], sticks.end[0], ss.Ending(int(sticks.ending[0])).name)
    0.0 0.25 RELEASED
    """
    require_threads_of_jax()
    arguments, start = Arguments.of_one(system, base, method, t1, y0)
    dtype = working_dtype(*(leaf for leaf in jax.tree.leaves(arguments.base) if eqx.is_inexact_array(leaf)))
    try:
        method, run = engine_for(arguments).follow(start, dtype)
    except (TypeError, jax.errors.UnexpectedTracerError) as error:
        _explain_enclosed(error)
        raise
    redundant = arguments.system.redundant
    if redundant is not None:
        run = run._replace(status=jnp.where(redundant, jnp.int8(Status.REDUNDANT_CONTACTS), run.status))
    return Simulation(system, arguments.base, t1, method, *run)


def _explain_enclosed(error: Exception) -> None:
    """Raise ValueError where `error` is JAX's for a traced number that a compiled function encloses."""
    if isinstance(error, TypeError) and not ("No constant handler" in str(error) and "Tracer" in str(error)):
        return
    raise ValueError(
        "Arguments system and base must hold every number that JAX traces as a field, but a function or class in them "
        "encloses one; make an equinox.Module of it with the number as a field, as FrictionCurve(Falling(low)) in "
        "docs/howto/own_friction.md, or a field of your SwitchedSystem."
    ) from error
