"""General-purpose yardstick: diffrax with `Event` and a root finder, restarted in Python after every event.

The solve of one arc is compiled once: everything that changes from arc to arc is an argument. For a
tolerance of 1e-8 the caller must have enabled float64 (`jax.config.update("jax_enable_x64", True)`).
"""

from __future__ import annotations

from typing import cast

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ._common import Trajectory
from .event_driver import BELT, END, TOP, Arc, ArcEnd, follow


def _field(t, y, arc):
    return arc.way * jnp.stack([y[1], arc.side - y[0]])


def _belt(t, y, args, *, t0, **kwargs):
    """Zero at `u = v`; at a start on it, the sign that it has just after; never zero if not looked for."""
    at_start = (t == t0) & args.on_belt
    return jnp.where(args.seek_belt & ~at_start, args.side * (y[1] - args.v), -1.0)


def _top(t, y, args, **kwargs):
    """Rises through zero at the extreme of `u`; never if not looked for."""
    return jnp.where(args.seek_top, args.side * y[0] - 1.0, -1.0)


@jax.jit
def _solve(arc: Arc, tolerance):
    # When both happen in one step diffrax reports the one named first, and an arrival comes before the
    # extreme.
    event = diffrax.Event(
        (_belt, _top),
        root_finder=optx.Newton(rtol=1e-10, atol=1e-12),
        direction=(None, True),
    )
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_field),
        diffrax.Tsit5(),
        t0=0.0,
        t1=arc.duration,
        dt0=None,
        y0=jnp.stack([arc.z, arc.u]),
        args=arc,
        event=event,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        throw=False,
    )
    belt, top = cast(tuple[jax.Array, jax.Array], solution.event_mask)
    times, (z, u) = cast(jax.Array, solution.ts), cast(jax.Array, solution.ys)[-1]
    # One array, so that one transfer brings everything to Python.
    outcome = jnp.where(belt, BELT, jnp.where(top, TOP, END))
    failed = (solution.result == diffrax.RESULTS.max_steps_reached) | ~jnp.isfinite(times[-1])
    return jnp.stack([times[-1], z, u, outcome.astype(float), failed.astype(float)])


def _solve_arc(arc: Arc, tolerance: float) -> ArcEnd:
    arc = jax.tree.map(lambda value: np.float64(value) if isinstance(value, float) else value, arc)
    elapsed, z, u, outcome, failed = np.asarray(_solve(arc, tolerance)).tolist()
    if failed:
        raise RuntimeError(f"diffrax could not solve {arc}")
    return ArcEnd(elapsed, z, u, int(outcome))


def simulate(*, gaps, velocities, t1, y0=(0.0, 0.0), tolerance=1e-8) -> Trajectory:
    """One trajectory on a base of piecewise constant velocity; as `scipy_events.simulate`, with Tsit5."""
    return follow(lambda arc: _solve_arc(arc, tolerance), gaps, np.asarray(velocities), t1, y0)
