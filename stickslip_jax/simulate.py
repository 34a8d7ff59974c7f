"""Simulate one realisation: `simulate(system, base, t1=..., y0=...)`."""

import warnings
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from . import _checks
from ._status import Status
from ._types import AnyArray, FloatArray, Scalar
from .base_motion.laws import BangBangLaw
from .base_motion.piecewise import VelocitySteps
from .dynamics.interval_engine import (
    Motion,
    Totals,
    cross_interval,
    run_intervals,
    scales_of,
    start_motion,
    status_of,
)
from .events import Slips, Sticks, slips_between, sticks_in_order
from .systems.mass_spring import MassSpring


class Simulation(eqx.Module):
    """One simulated trajectory on ``[0, t1]``.

    - `sticks`: every stick (`Sticks`), `slips`: every slip (`Slips`).
    - `stick_time`, `slip_time`: total, s. `stick_fraction`: share of ``[0, t1]``.
    - `final_state`: (position m, velocity m/s) at `time_reached`, which is ``t1`` if the trajectory is FINISHED.
    - `status`: a `Status` code; 0 is FINISHED. Anything else: do not use the numbers.
    - `evaluate(times)`: the state at any instants. `switching_times`: when the base's intervals begin, s.
    - `system`, `base`, `t1`: what was simulated.
    """

    system: MassSpring
    base: VelocitySteps
    t1: Scalar
    sticks: Sticks
    totals: Totals
    status: Int[Array, "*batch"]
    time_reached: Float[Array, "*batch"]
    final_state: tuple[Float[Array, "*batch"], Float[Array, "*batch"]]
    _beginnings: Motion

    @property
    def slips(self) -> Slips:
        return slips_between(self.sticks, self.time_reached)

    @property
    def stick_time(self) -> Float[Array, "*batch"]:
        return self.totals.stick_time

    @property
    def slip_time(self) -> Float[Array, "*batch"]:
        return self.time_reached - self.totals.stick_time

    @property
    def stick_fraction(self) -> Float[Array, "*batch"]:
        return self.totals.stick_time / self.t1

    @property
    def switching_times(self) -> Float[Array, "*batch intervals"]:
        """The instants at which the base's intervals begin, s, as the simulation added them up; spare slots hold t1."""
        return self._beginnings.t

    def evaluate(self, times: AnyArray | float) -> tuple[FloatArray, FloatArray]:
        """Position (m) and velocity (m/s) of the mass at `times` (s, any shape), exact.

        NaN outside ``[0, time_reached]``. Under ``jax.jit`` write ``jax.jit(lambda t: one.evaluate(t))``.
        """
        _checks.numeric("times", times, ndim=None)
        if np.ndim(self.status) > 0:
            raise ValueError(
                f"This is a batch of {np.shape(self.status)} simulations; evaluate one, or jax.vmap over them."
            )
        dtype = self._beginnings.x.dtype
        return _states(self, jnp.asarray(times, dtype), dtype)

    def __repr__(self) -> str:
        if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves(self)) or np.ndim(self.status) > 0:
            return f"Simulation(status={self.status}, sticks={self.sticks!r})"
        status = Status(int(self.status))
        if status != Status.FINISHED:
            stopped = f"stopped at {float(self.time_reached):g} of {float(self.t1):g} s"
            return f"Simulation of {type(self.system).__name__}, NOT FINISHED: {stopped}, because {status.meaning}"
        fraction = 100 * float(self.stick_fraction)
        return (
            f"Simulation of {type(self.system).__name__} on [0, {float(self.t1):g}] s: "
            f"{int(self.sticks.count)} sticks, {int(self.slips.count)} slips, stick fraction {fraction:.4g} %, "
            f"{status.meaning}"
        )


def simulate(
    system: MassSpring,
    base: VelocitySteps | BangBangLaw,
    *,
    t1: Scalar,
    y0: tuple[Scalar, Scalar] = (0.0, 0.0),
) -> Simulation:
    """Simulate one realisation exactly, every stick recorded. Pure: works under jit, vmap, jvp, grad.

    - `system`: what moves, a `MassSpring`.
    - `base`: a realisation, ``law.sample(key, t1)``; a law without randomness may be given itself.
    - `t1`: duration, s. `y0`: initial position (m) and velocity (m/s).

    Returns a `Simulation`; look at its `status`. There is one slot for sticks per base interval, because at most one
    stick happens in each. Raises ValueError for arguments outside these bounds.
    """
    if not isinstance(system, MassSpring):
        raise ValueError(f"Argument system must be a MassSpring, but {system!r} was given.")
    _checks.positive("t1", t1, "s")
    y0 = _checks.pair("y0", y0)
    base = _realised(base, t1)
    return Simulation(system, base, t1, *_run(system, base, t1, y0, working_dtype(base.durations, base.velocities)))


@partial(jax.jit, static_argnames="dtype")
def _run(system: MassSpring, base: VelocitySteps, t1: Scalar, y0: tuple[Scalar, Scalar], dtype):
    """All that a `Simulation` holds beside its arguments."""
    scales = scales_of(system, t1, dtype)
    # Nothing later than t1 matters; cutting here keeps infinite durations out of all arithmetic.
    durations = jnp.where(base.durations >= t1, t1, base.durations).astype(dtype)
    motion = start_motion(scales, y0)
    final, totals, records, beginnings = run_intervals(scales, motion, durations, base.velocities.astype(dtype))
    final_state = (final.x, final.p * scales.omega)
    return sticks_in_order(*records), totals, status_of(final, scales.t1), final.t, final_state, beginnings


@partial(jax.jit, static_argnames="dtype")
def _states(one: "Simulation", times: FloatArray, dtype) -> tuple[FloatArray, FloatArray]:
    """Position and velocity at `times` (any shape), each from the beginning of the interval that holds it."""
    scales = scales_of(one.system, one.t1, dtype)
    # Among intervals that begin together (spare slots of no length), the last: it is the one that lasts.
    index = jnp.clip(jnp.searchsorted(one.switching_times, times, side="right") - 1, 0)

    def at(time, i):
        began = jax.tree.map(lambda values: values[i], one._beginnings)
        motion, _, _ = cross_interval(scales, began, one.totals, time - began.t, one.base.velocities[i])
        inside = (time >= 0) & (time <= one.time_reached)
        return jnp.where(inside, motion.x, jnp.nan), jnp.where(inside, motion.p * scales.omega, jnp.nan)

    x, velocity = jax.vmap(at)(times.reshape(-1), index.reshape(-1))
    return x.reshape(times.shape), velocity.reshape(times.shape)


def working_dtype(*arrays: Array, stacklevel: int = 3):
    """The floating dtype of a simulation; says once how to get float64 when JAX runs in float32."""
    dtype = jnp.result_type(float, *arrays)
    if not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "stickslip_jax runs in float32: event times are good to about 2e-6 of t1. For float64 call "
            'jax.config.update("jax_enable_x64", True) before anything else.',
            stacklevel=stacklevel,
        )
    return dtype


def _realised(base: VelocitySteps | BangBangLaw, t1: Scalar) -> VelocitySteps:
    if isinstance(base, VelocitySteps):
        if base.durations.ndim != 1:
            raise ValueError(
                f"Argument base must be one realisation, but it has durations of shape {base.durations.shape}; "
                "use jax.vmap over the realisations, or simulate_ensemble."
            )
        return base
    if isinstance(base, BangBangLaw):
        if base.is_random:
            raise ValueError(
                f"Argument base must be a realisation, but the random law {type(base).__name__} was given; "
                "draw one with base.sample(key, t1)."
            )
        return base.sample(None, t1)
    raise ValueError(f"Argument base must be a base motion such as law.sample(key, t1), but {base!r} was given.")
