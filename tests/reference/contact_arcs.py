"""The motion of a structure while none of its contacts changes, for the reference for several contacts."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

HORIZON = "HORIZON"
STUCK, OPEN = 0, 2  # beside -1 and 1, the directions of a slip
UNIFORM = np.linspace(0.0, 1.0, 9)
FROM_ZERO = np.concatenate([[0.0], 2.0 ** np.arange(-20.0, -3.0), UNIFORM[1:]])
FLOOR, REST, VIABLE = 1e-12, 1e-11, 1e-9  # of a gap's scale: no zero, no speed; of a case's scale: no contradiction


def _times(factors: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Each row times its factor, at one time or at many."""
    return (factors * rows.T).T


@dataclass(frozen=True)
class Structure:
    """The structure; ``d`` coordinates, ``n`` contacts.

    Functions of time are called as ``f(t, piece)`` with one time or an array of times; `piece` counts the stretches
    between `breaks`, at which they may jump. `kinetic` is a friction coefficient per contact, or a function of the
    sliding speeds ``(n, ...)`` that goes on smoothly a little below zero.
    """

    mass: np.ndarray  # (d, d)
    damping: np.ndarray  # (d, d)
    stiffness: np.ndarray  # (d, d)
    directions: np.ndarray  # (n, d)
    base_gains: np.ndarray  # (n,)
    kinetic: np.ndarray | Callable[[np.ndarray], np.ndarray]
    static: np.ndarray  # (n,), not below kinetic(0)
    normal_forces: Callable[[float | np.ndarray, int], np.ndarray]  # (n, ...) in N
    base_velocity: Callable[[float | np.ndarray, int], float | np.ndarray] = lambda t, _: 0.0 * t
    base_acceleration: Callable[[float | np.ndarray, int], float | np.ndarray] = lambda t, _: 0.0 * t
    force: Callable[[float | np.ndarray, int], np.ndarray] | None = None  # (d, ...) in N
    breaks: Sequence[float] = ()
    fastest: float = 0.0  # the largest angular frequency of the functions of time, in rad/s


class Stick(NamedTuple):
    """One stick: ``w_i x`` at its start, this less ``b_i`` times the base's displacement since 0, what ended it."""

    contact: int
    start: float
    end: float
    position: float
    displacement: float
    ending: str


@dataclass
class Motion:
    """What came out.

    `margins` says how close a decision was to going otherwise, in parts of the quantity that decided:
    ``grazing`` (gaps that almost closed, or almost did not), ``holding`` (a contact at rest that held or broke),
    ``case`` (the conditions of those that broke) and ``instants`` (between two events, in parts of ``1 / omega``).
    """

    sticks: list[Stick] = field(default_factory=list)  # by their starts
    crossings: list[tuple[int, float]] = field(default_factory=list)  # contacts that came to rest and did not stick
    margins: dict[str, float] = field(default_factory=lambda: dict.fromkeys(MARGINS, math.inf))
    position: np.ndarray | None = None
    velocity: np.ndarray | None = None
    events: int = 0
    held_again: int = 0  # contacts that broke, and held again when others broke at the same instant
    stretches: list[tuple] = field(default_factory=list)  # start, stop, the state at many times, at one, the arc

    @property
    def margin(self) -> float:
        """The smallest of all."""
        return min(self.margins.values())

    def state_at(self, t: float) -> np.ndarray:
        """The state ``(x, x', displacement of the base)`` at one instant."""
        return self.stretches[max(bisect_right(self.stretches, t, key=itemgetter(0)) - 1, 0)][3](t)

    def close(self, kind: str, value: float | np.ndarray) -> None:
        """Note a margin."""
        self.margins[kind] = min(self.margins[kind], float(value))


MARGINS = ("grazing", "holding", "case", "instants")


class Arc:
    """The equations while no contact changes; `sides` holds -1, 1, STUCK or OPEN for each."""

    def __init__(self, structure: Structure, piece: int, sides: np.ndarray, max_step: float, weight: float):
        self.structure, self.piece, self.sides, self.max_step = structure, piece, sides, max_step
        self.weight = weight  # the largest normal force in this piece, in N
        self.d, self.stuck, self.slipping = len(structure.mass), sides == STUCK, np.abs(sides) == 1
        inverse = np.linalg.inv(structure.mass)
        self.inverse, self.across = inverse, inverse @ structure.directions.T
        self.delassus = structure.directions @ self.across
        self.pull = inverse @ np.hstack([structure.stiffness, structure.damping])
        self.reaction = np.linalg.pinv(self.delassus[np.ix_(self.stuck, self.stuck)], rcond=1e-10, hermitian=True)
        self.side = np.where(self.slipping, sides, 0)

    def relative(self, t, y: np.ndarray) -> np.ndarray:
        """Relative velocities ``(n, ...)``."""
        now = self.structure
        base = now.base_velocity(t, self.piece)
        return now.directions @ y[self.d : 2 * self.d] - np.multiply.outer(now.base_gains, base)

    def kinetic(self, speeds: np.ndarray) -> np.ndarray:
        """Kinetic friction coefficients ``(n, ...)``."""
        law = self.structure.kinetic
        return law(speeds) if callable(law) else _times(law, np.ones_like(speeds))

    def normal(self, t) -> np.ndarray:
        """Normal forces ``(n, ...)``."""
        return self.structure.normal_forces(t, self.piece)

    def free(self, t, y: np.ndarray, friction: np.ndarray) -> np.ndarray:
        """Accelerations under this friction."""
        rates = self.across @ friction - self.pull @ y[: 2 * self.d]
        return rates if self.structure.force is None else rates + self.inverse @ self.structure.force(t, self.piece)

    def all(self, t, y: np.ndarray):
        """Relative velocities, friction, normal forces and accelerations."""
        relative, normal = self.relative(t, y), self.normal(t)
        friction = _times(-self.side, self.kinetic(_times(self.side, relative)) * normal)
        rates = self.free(t, y, friction)
        if self.stuck.any():
            now = self.structure
            base = np.multiply.outer(now.base_gains[self.stuck], now.base_acceleration(t, self.piece))
            friction[self.stuck] = -self.reaction @ (now.directions[self.stuck] @ rates - base)
            rates = rates + self.across[:, self.stuck] @ friction[self.stuck]
        return relative, friction, normal, rates

    def slope(self, t: float, y: np.ndarray) -> np.ndarray:
        """Rates of ``(x, x', displacement of the base)``."""
        base = self.structure.base_velocity(t, self.piece)
        return np.concatenate([y[self.d : 2 * self.d], self.all(t, y)[3], [base]])

    def gaps(self, t, y: np.ndarray) -> np.ndarray:
        """Of each contact, then of each normal force, ``(2 n, ...)``."""
        relative, friction, normal, _ = self.all(t, y)
        gaps = _times(self.side, relative)
        gaps[self.stuck] = (_times(self.structure.static, normal) - np.abs(friction))[self.stuck]
        gaps[self.sides == OPEN] = np.inf
        return np.concatenate([gaps, _times(np.where(self.sides == OPEN, -1, 1), normal)])

    def speed(self, t: float, y: np.ndarray) -> float:
        """The largest speed around."""
        now = self.structure
        pushes = np.diag(self.delassus) * now.static * self.weight
        speeds = np.abs(now.directions) @ np.abs(y[self.d : 2 * self.d])
        return (
            np.max(speeds)
            + np.max(np.abs(now.base_gains * now.base_velocity(t, self.piece)))
            + (self.max_step * np.max(pushes))
        )

    def scales(self, t: float, y: np.ndarray) -> np.ndarray:
        """What each gap is measured against, ``(2 n,)``."""
        limits = self.structure.static * np.maximum(np.abs(self.normal(t)), 1e-3 * self.weight)
        forces = np.full(len(self.sides), self.weight)
        return np.concatenate([np.where(self.stuck, limits, self.speed(t, y)), forces]) + 1e-300

    def project(self, t: float, y: np.ndarray, rest: np.ndarray) -> None:
        """Remove what round-off left of the relative velocities at `rest`."""
        block = np.linalg.pinv(self.delassus[np.ix_(rest, rest)], rcond=1e-10, hermitian=True)
        y[self.d : 2 * self.d] -= self.across[:, rest] @ (block @ self.relative(t, y)[rest])


class _Event(NamedTuple):
    """A gap closed: of a contact (`row` below n) or of a normal force."""

    t: float
    row: int


def _zero(values, times, floor: float, fresh: bool, at, note) -> tuple[float | None, bool]:
    """Where a gap first closes, and whether it is still `fresh`: it began at zero and has yet to open."""
    if fresh:
        if np.min(values) < -100 * floor and not np.any(values[: np.argmin(values)] > 10 * floor):
            raise ArithmeticError(f"an arc that starts near t = {times[0]} leaves zero on the wrong side")
        if not np.any(open_ := values > 10 * floor):
            return None, True
        values, times = values[np.argmax(open_) :], times[np.argmax(open_) :]
        if len(values) < 2:
            return None, False
    slopes = np.diff(values)
    falls_before = np.concatenate([[not fresh], slopes[:-1] <= 0])
    rises_after = np.concatenate([slopes[1:] >= 0, [True]])
    steep = np.abs(np.concatenate([slopes[:1], slopes, slopes[-1:]]))
    low = np.minimum(values[:-1], values[1:]) <= 2 * np.max([steep[:-2], steep[1:-1], steep[2:]], axis=0)
    closed = values[1:] < -floor
    if values[0] < -floor:
        return times[0], False
    for i in np.flatnonzero(closed | (falls_before & rises_after)):
        left, right = times[i], times[i + 1]
        if not closed[i]:
            dip = min(values[i], values[i + 1])
            if low[i]:
                options = {"bounds": (left, right), "method": "bounded", "options": {"xatol": 1e-8 * (right - left)}}
                lowest = minimize_scalar(at, **options)
                dip, right = min(dip, lowest.fun), lowest.x
            if dip >= -floor:
                inner = i > 0 or values[1] > values[0]
                note(dip if inner and (i + 2 < len(values) or values[i + 1] > dip) else np.inf)
                continue
        if values[i] <= 0:
            return left, False
        return brentq(at, left, right, xtol=1e-14 * (right - left) + 1e-300, rtol=4 * np.finfo(float).eps), False
    return None, False


def _ignore(_: float) -> None:
    """Note nothing."""


def _exact(arc: Arc, start: float, before: np.ndarray, rtol: float) -> Callable[[float], np.ndarray]:
    """The state at one time within a step, from a shorter step instead of the interpolant."""

    def at(t: float) -> np.ndarray:
        if t <= start:
            return before.copy()
        solver = DOP853(arc.slope, start, before, t, first_step=t - start, rtol=rtol, atol=1e-3 * rtol)
        while solver.status == "running":
            solver.step()
        return solver.y

    return at


def _polish(arc: Arc, exact, row: int, t: float, start: float, stop: float) -> tuple[float, np.ndarray, float]:
    """The instant at which a gap closes by the exact states, near `t`; also the state there and the gap's slope."""
    y, h, slope = exact(t), 1e-6 * (stop - start), 0.0
    for _ in range(3):
        rate, value = arc.slope(t, y), arc.gaps(t, y)[row]
        slope = (arc.gaps(t + h, y + h * rate)[row] - arc.gaps(t - h, y - h * rate)[row]) / (2 * h)
        change = -value / slope if slope else 0.0
        if abs(change) > 1e-5 * (stop - start):  # a graze: the interpolant is as good
            break
        t, y = t + change, y + change * rate
    return t, y, slope


def follow_arc(run: Motion, arc: Arc, t: float, y: np.ndarray, end: float, rtol: float, first: float | None):
    """Follow one arc; returns time, state, the row of the gap that closed (-1: none did before `end`), a step."""
    scales = arc.scales(t, y)
    floors = FLOOR * scales
    n, start_gaps = len(arc.sides), arc.gaps(t, y)
    fresh = (np.abs(start_gaps) <= 100 * floors) & ~np.concatenate([arc.stuck, np.zeros(n, bool)])
    first = min(first, end - t) if first else None
    solver = DOP853(arc.slope, t, y, end, max_step=arc.max_step, first_step=first, rtol=rtol, atol=1e-3 * rtol)
    start = stop = t
    while solver.status == "running":
        start, before = solver.t, solver.y.copy()
        solver.step()
        if solver.status == "failed":
            break
        stop, dense, exact = solver.t, solver.dense_output(), _exact(arc, start, before, rtol)
        run.stretches.append((start, stop, dense, exact, arc))
        times = start + (stop - start) * (FROM_ZERO if np.any(fresh) else UNIFORM)
        times[-1] = stop
        gaps = arc.gaps(times, dense(times))
        zeros = []
        for row in np.flatnonzero(np.isfinite(gaps[:, 0])):
            values = gaps[row]
            if not fresh[row] and values[0] > 0 and np.all(np.diff(values) < 0) and values[-1] > 0:
                continue
            at = lambda s, row=row, dense=dense: arc.gaps(s, dense(s))[row]  # noqa: E731
            note = lambda dip, scale=scales[row]: run.close("grazing", max(dip / scale, 0.0))  # noqa: E731
            without = row >= n and np.max(np.abs(values)) <= floors[row]  # never any normal force
            zero, fresh[row] = _zero(values, times, floors[row], fresh[row], at, _ignore if without else note)
            zeros += [] if zero is None else [_Event(zero, int(row))]
        if zeros:
            rough, row = min(zeros)
            t, y, slope = _polish(arc, exact, row, rough, start, stop)
            run.close("grazing", (slope * 2 * arc.max_step / scales[row]) ** 2 / 2)
            run.stretches[-1] = (start, t, dense, exact, arc)
            return t, y, row, stop - start
    if solver.status == "failed":
        raise ArithmeticError(f"the integration stopped before t = {end}")
    return end, solver.y, -1, stop - start
