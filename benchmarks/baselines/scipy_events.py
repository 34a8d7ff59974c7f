"""General-purpose yardstick: scipy's `solve_ivp` with event functions, restarted after every event."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from ._common import Trajectory
from .event_driver import BELT, END, TOP, Arc, ArcEnd, follow


def _events(arc: Arc):
    """Event functions of the arc. At a start on `u = v` the first gives the side to which the arc goes, not zero."""

    # SciPy reads `terminal` and `direction` as attributes of the event functions.
    def belt(t, y):
        if t == 0.0 and arc.on_belt:
            return -arc.side
        return y[1] - arc.v

    def top(t, y):
        return arc.side * y[0] - 1.0

    vars(belt).update(terminal=True, direction=arc.way * arc.side)
    vars(top).update(terminal=True, direction=1.0)
    wanted = [(belt, BELT, arc.seek_belt), (top, TOP, arc.seek_top)]
    return [(event, code) for event, code, on in wanted if on]


def _solve_arc(arc: Arc, tolerance: float) -> ArcEnd:
    events = _events(arc)
    solution = solve_ivp(
        lambda t, y: (arc.way * y[1], arc.way * (arc.side - y[0])),
        (0.0, arc.duration),
        (arc.z, arc.u),
        rtol=tolerance,
        atol=tolerance,
        events=[event for event, _ in events] or None,
    )
    if not solution.success:
        raise RuntimeError(solution.message)
    outcome = END
    if solution.status == 1:
        happened = [len(times) > 0 for times in solution.t_events]
        outcome = events[happened.index(True)][1]
    z, u = solution.y[:, -1]
    return ArcEnd(float(solution.t[-1]), float(z), float(u), outcome)


def simulate(*, gaps, velocities, t1, y0=(0.0, 0.0), tolerance=1e-8) -> Trajectory:
    """One trajectory on a base of piecewise constant velocity.

    Args:
        gaps: stretches between the changes of the base velocity, in units of `1 / omega`.
        velocities: one value more than `gaps`, in units of `a omega`, none of them zero; the last holds
        until `t1`. t1, y0: horizon and `(z0, u0)`, fixed frame. tolerance: relative and absolute tolerance
        of the integration (method RK45).
    """
    return follow(lambda arc: _solve_arc(arc, tolerance), gaps, np.asarray(velocities), t1, y0)
