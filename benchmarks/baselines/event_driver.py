"""What the general-purpose solvers share: one trajectory, arc by arc, a solve restarted after every event.

A solver contributes one function, `solve_arc(arc) -> ArcEnd`, that integrates `z' = u, u' = -z + side` (the
friction force is constant while the mass slips) up to the first of: `u = v` (BELT), the extreme of `u`
towards the belt (TOP), the end of the arc (END). TOP is there for correctness: a step of the solver can
jump over both crossings of a shallow arrival, and only the extreme between them shows it. Then the arrival is
found by going back from the extreme, `way = -1`.

Everything is in the fixed frame; the circles and angles of the closed forms are not used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ._common import Trajectory

END, BELT, TOP = 0, 1, 2


class Arc(NamedTuple):
    """A slip arc to integrate, in its own time from 0."""

    duration: float
    z: float
    u: float
    side: float  # +1: slower than the base, friction pulls forward; -1: faster
    v: float  # base velocity
    on_belt: bool = False  # starts exactly on u = v and leaves it
    seek_belt: bool = True  # whether u = v ends the arc
    seek_top: bool = True  # whether the extreme ends the arc
    way: float = 1.0  # -1: backwards in time


class ArcEnd(NamedTuple):
    """Time spent, state, and what ended the arc (END, BELT, TOP)."""

    elapsed: float
    z: float
    u: float
    outcome: int


SolveArc = Callable[[Arc], ArcEnd]


def _slip(solve_arc: SolveArc, arc: Arc) -> ArcEnd:
    """Goes on to the true arrival at `u = v`, or to the end of the arc."""
    spent = 0.0
    while True:
        end = solve_arc(arc)
        lost = end.outcome == BELT and abs(end.u - arc.v) > 1e-6 * (1.0 + abs(arc.v))
        if lost:  # the solver's root finder has failed: find the extreme first, then come back from there
            end = solve_arc(arc._replace(seek_belt=False))
        spent += end.elapsed
        if end.outcome == TOP and arc.side * (end.u - arc.v) > 0.0:
            back = Arc(math.pi, end.z, end.u, arc.side, arc.v, seek_top=False, way=-1.0)
            there = solve_arc(back)
            if there.outcome != BELT:
                raise RuntimeError(f"no arrival found before the extreme of {arc}")
            return ArcEnd(spent - there.elapsed, there.z, there.u, BELT)
        if end.outcome != TOP:
            return end._replace(elapsed=spent)
        # The extreme falls short of u = v. Every later turn of the undamped arc is the same: look for
        # nothing more, which also keeps a mass at rest (on z = side) from being at its extreme again and
        # again.
        rest = arc.duration - end.elapsed
        arc = arc._replace(duration=rest, z=end.z, u=end.u, on_belt=False, seek_belt=False, seek_top=False)


def _interval(solve_arc: SolveArc, start: float, stop: float, z: float, u: float, v: float):
    """One base interval. Returns the state at its end and its stick `(start, end)`, or None.

    After a release the friction force stays at its limit and the mass falls behind the base: its path only
    touches `u = v` until the base changes its velocity, so no arrival is looked for. (Looking for one finds
    a stick of length zero, or not, by round-off.)
    """
    now, stick, released, ahead = start, None, False, math.copysign(1.0, v)
    while now < stop:
        if u == v and not released and abs(z) <= 1.0:
            stay = (1.0 - ahead * z) / abs(v)
            released = stay < stop - now
            end = now + stay if released else stop
            if end > now:
                stick = (now, end)
            z = ahead if released else z + v * (stop - now)
            now = end
            continue
        side = math.copysign(1.0, z if u == v else v - u)
        arc = Arc(stop - now, z, u, side, v, on_belt=u == v, seek_belt=not released, seek_top=not released)
        landed = _slip(solve_arc, arc)
        z, u = landed.z, landed.u
        if landed.outcome == END:
            break
        u, now = v, now + landed.elapsed
    return z, u, stick


def base_intervals(gaps, velocities, t1):
    """`(start, stop, velocity)` of the base intervals on `[0, t1]`; equal neighbours are one interval.

    `gaps` are the stretches between possible changes, `velocities` has one value more than `gaps`: the base
    keeps the last one until `t1`.
    """
    gaps, velocities = np.asarray(gaps, dtype=float), np.asarray(velocities, dtype=float)
    if velocities.shape != (gaps.size + 1,):
        raise ValueError(f"need one velocity more than gaps, got {velocities.shape} and {gaps.shape}")
    if not (velocities != 0.0).all() or not (gaps > 0.0).all():
        raise ValueError("gaps must be positive and velocities not zero")
    edges = [0.0, *(edge for edge in np.cumsum(gaps) if edge < t1), float(t1)]
    merged = []
    for start, stop, v in zip(edges[:-1], edges[1:], velocities, strict=False):
        runs_on = bool(merged) and merged[-1][2] == v
        since = merged.pop()[0] if runs_on else float(start)
        merged.append((since, float(stop), float(v)))
    return merged


def follow(solve_arc: SolveArc, gaps, velocities, t1, y0) -> Trajectory:
    """One trajectory on a base of piecewise constant velocity, with the given solver."""
    z, u = (float(value) for value in y0)
    sticks = []
    intervals = base_intervals(gaps, velocities, t1)
    for start, stop, v in intervals:
        z, u, stick = _interval(solve_arc, start, stop, z, u, v)
        if stick is not None:
            sticks.append(stick)
    start, end = np.array(sticks, dtype=float).reshape(-1, 2).T
    return Trajectory(start, end, len(intervals), z, u)


def switching_velocities(w, gaps, initial_sign=1):
    """Velocities of a base that switches sign after every gap."""
    return initial_sign * w * (-1.0) ** np.arange(len(gaps) + 1)
