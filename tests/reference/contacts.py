"""Reference for linear structures with several dry-friction contacts, in numpy and scipy, good to about 1e-11.

The structure is ``M x'' + C x' + K x = F(t) + W^T u`` in SI units. Contact ``i`` slides with the relative velocity
``g_i = w_i x' - b_i V(t)``, where ``w_i`` is a row of ``W``; its friction ``u_i`` acts along ``w_i``. It is one of

- open, where its normal force is not positive: ``u_i = 0``;
- slipping: ``u_i = -sign(g_i) kinetic_i(|g_i|) N_i(t)``;
- sticking: ``g_i = 0``, and ``|u_i| <= static_i N_i(t)``.

The motion is followed one *arc* at a time, on which no contact changes: the field is smooth there, even past the arc's
end. What ends an arc is the first zero of a *gap*, positive on the arc: ``|g_i|`` of a slip, the distance of ``u_i``
from its limits in a stick, ``N_i`` of a closed and ``-N_i`` of an open contact. Each step is sampled, every sign change
and every dip between samples is looked at, and the zero is bracketed on the interpolant and made exact by a step that
ends there. At an event all contacts at rest are asked together, see `_settle`.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

RELEASED, OPENED, BASE_SWITCHED, HORIZON = "RELEASED", "OPENED", "BASE_SWITCHED", "HORIZON"
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

    def close(self, kind: str, value: float) -> None:
        """Note a margin."""
        self.margins[kind] = min(self.margins[kind], float(value))


MARGINS = ("grazing", "holding", "case", "instants")


class _Arc:
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


def _cases(delassus, rates, held: list[int], fallen: list[int], kinetic, scale):
    """All ways in which the contacts `fallen` may go on while `held` do not move.

    Yields what each of `fallen` does (STUCK or a side), how far each is inside its condition, and the forces.
    """
    for sides in itertools.product((STUCK, -1, 1), repeat=len(fallen)):
        friction = np.zeros(len(rates))
        friction[fallen] = -np.array(sides, float) * kinetic[fallen]
        stuck = held + [i for i, side in zip(fallen, sides, strict=True) if side == STUCK]
        demand = (rates + delassus @ friction)[stuck]
        if stuck:
            friction[stuck] = -np.linalg.pinv(delassus[np.ix_(stuck, stuck)], rcond=1e-10, hermitian=True) @ demand
        moving = (rates + delassus @ friction) / np.diag(delassus)
        inside = np.where(np.array(sides) == STUCK, kinetic[fallen] - np.abs(friction[fallen]), sides * moving[fallen])
        yield sides, inside / scale[fallen], friction


def _solve(cases, fallen: list[int], released: dict[int, int]):
    """The case that contradicts itself least; of two on the edge, the one in which `released` contacts move."""

    def order(case):
        sides, inside, _ = case
        lowest = np.min(inside, initial=np.inf)
        as_released = all(side == released.get(i, side) for i, side in zip(fallen, sides, strict=True))
        return lowest >= -VIABLE, as_released, lowest

    best = max(cases, key=order)
    if np.min(best[1], initial=np.inf) < -VIABLE:
        raise ArithmeticError("no case is free of contradictions: the friction has no solution")
    return best


def _settle_block(run: Motion, delassus, rates, released: dict[int, int], kinetic, static):
    """What contacts at rest do next: STUCK or a side for each.

    All that are not `released` are held by whatever they need. Where one needs more than its static limit, the one that
    needs the largest multiple of it breaks, and the others are asked again. Those that broke obey the kinetic limit:
    they hold with no more, or move against a friction of just this; that problem is solved case by case. Without
    a difference between static and kinetic friction the result is the one solution for all contacts at rest.
    """
    n, fallen = len(rates), list(released)
    scale = np.maximum(static, 1e-12 * np.max(static)) + 1e-300
    while True:
        held = [i for i in range(n) if i not in fallen]
        cases = _cases(delassus, rates, held, fallen, kinetic, scale)
        sides, inside, friction = _solve(cases, fallen, released)
        needed = np.abs(friction[held]) / scale[held]
        if np.max(needed, initial=0.0) <= 1 + FLOOR:
            break
        run.close("holding", np.max(needed) - 1)
        order = np.sort(needed)
        if len(order) > 1 and order[-2] > 1 and np.any(static > kinetic):
            run.close("holding", order[-1] - order[-2])
        fallen.append(held[int(np.argmax(needed))])
    run.close("holding", np.min(1 - needed, initial=np.inf))
    run.close("case", min([margin for i, margin in zip(fallen, inside, strict=True) if i not in released] or [np.inf]))
    result = np.zeros(n, int)
    result[fallen] = sides
    run.held_again += sum(side == STUCK for side in sides)
    return result


def _settle(run: Motion, arc: _Arc, t: float, y: np.ndarray, released: dict[int, int]) -> np.ndarray:
    """The sides after an event, from an arc on which all contacts at rest are STUCK; `released` ones move that way."""
    sides, rest = arc.sides.copy(), np.flatnonzero(arc.stuck)
    normal, now = arc.normal(t), arc.structure
    friction = -arc.side * arc.kinetic(arc.side * arc.relative(t, y)) * normal
    rates = now.directions @ arc.free(t, y, friction) - now.base_gains * now.base_acceleration(t, arc.piece)
    kinetic, static = arc.kinetic(np.zeros(len(sides))) * normal, now.static * normal
    delassus = arc.delassus
    coupled = np.abs(delassus) > 1e-13 * np.sqrt(np.outer(np.diag(delassus), np.diag(delassus)))
    remaining = set(rest.tolist())
    while remaining:  # blocks of contacts at rest that feel each other
        block, new = set(), {min(remaining)}
        while new:
            block |= new
            new = {j for i in new for j in remaining if coupled[i, j]} - block
        remaining -= block
        names = sorted(block)
        square = delassus[np.ix_(names, names)]
        moved = {names.index(i): side for i, side in released.items() if i in block}
        sides[names] = _settle_block(run, square, rates[names], moved, kinetic[names], static[names])
    return sides


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


def _exact(arc: _Arc, start: float, before: np.ndarray, rtol: float) -> Callable[[float], np.ndarray]:
    """The state at one time within a step, from a shorter step instead of the interpolant."""

    def at(t: float) -> np.ndarray:
        if t <= start:
            return before.copy()
        solver = DOP853(arc.slope, start, before, t, first_step=t - start, rtol=rtol, atol=1e-3 * rtol)
        while solver.status == "running":
            solver.step()
        return solver.y

    return at


def _polish(arc: _Arc, exact, row: int, t: float, start: float, stop: float) -> tuple[float, np.ndarray, float]:
    """The instant at which a gap closes by the exact states, near `t`; also the state there and the gap's slope."""
    y, h = exact(t), 1e-6 * (stop - start)
    for _ in range(3):
        rate, value = arc.slope(t, y), arc.gaps(t, y)[row]
        slope = (arc.gaps(t + h, y + h * rate)[row] - arc.gaps(t - h, y - h * rate)[row]) / (2 * h)
        change = -value / slope if slope else 0.0
        if abs(change) > 1e-5 * (stop - start):  # a graze: the interpolant is as good
            break
        t, y = t + change, y + change * rate
    return t, y, slope


def _follow_arc(run: Motion, arc: _Arc, t: float, y: np.ndarray, end: float, rtol: float, first: float | None):
    """Follow one arc; returns time, state, the row of the gap that closed (-1: none did before `end`), a step."""
    scales = arc.scales(t, y)
    floors = FLOOR * scales
    n, start_gaps = len(arc.sides), arc.gaps(t, y)
    fresh = (np.abs(start_gaps) <= 100 * floors) & ~np.concatenate([arc.stuck, np.zeros(n, bool)])
    first = min(first, end - t) if first else None
    solver = DOP853(arc.slope, t, y, end, max_step=arc.max_step, first_step=first, rtol=rtol, atol=1e-3 * rtol)
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


class _Book:
    """Keeps the sticks that have not ended."""

    def __init__(self, run: Motion, structure: Structure):
        self.run, self.structure, self.current = run, structure, {}

    def note(self, t: float, y: np.ndarray, sides: np.ndarray, why: dict[int, str]) -> None:
        """Begin and end sticks; `why` names endings other than a release."""
        d = len(self.structure.mass)
        for i, side in enumerate(sides):
            if side == STUCK and i not in self.current:
                at = float(self.structure.directions[i] @ y[:d])
                moved = at - float(self.structure.base_gains[i] * y[-1])
                self.current[i] = Stick(i, float(t), math.nan, at, moved, HORIZON)
            elif side != STUCK and i in self.current:
                self.finish(i, t, OPENED if side == OPEN else why.get(i, RELEASED))

    def finish(self, i: int, t: float, ending: str) -> None:
        """End a stick; one without length is none."""
        stick = self.current.pop(i)._replace(end=float(t), ending=ending)
        if stick.end > stick.start:
            self.run.sticks.append(stick)


def _is_closed(arc: _Arc, t: float, end: float) -> np.ndarray:
    """Which normal forces are positive; where one is zero, a little later decides."""
    normal, later = arc.normal(t), arc.normal(t + 1e-6 * min(end - t, arc.max_step))
    return np.where(np.abs(normal) > FLOOR * arc.weight, normal, later) > 0


def follow(
    structure: Structure,
    t1: float,
    x0: Sequence[float],
    v0: Sequence[float],
    *,
    rtol: float = 1e-12,
    max_step: float | None = None,
    most_events: int = 5000,
) -> Motion:
    """Follow the structure from ``x0, v0`` at 0 to `t1`.

    `max_step` must resolve the motion and the functions of time; by default it is half of ``1 / omega``, with
    the largest of all angular frequencies and damping rates, or ``t1 / 32``.
    """
    inverse = np.linalg.inv(structure.mass)
    frequencies = np.sqrt(np.abs(np.linalg.eigvals(inverse @ structure.stiffness)))
    rates = np.abs(np.linalg.eigvals(inverse @ structure.damping))
    max_step = max_step or 0.5 / max(16 / t1, np.max(frequencies), np.max(rates), structure.fastest)
    edges = [0.0, *[float(t) for t in structure.breaks if 0 < t < t1], float(t1)]
    run = Motion()
    book, y, sides = _Book(run, structure), np.concatenate([x0, v0, [0.0]]).astype(float), None
    step, last = None, -math.inf
    for piece, (start, end) in enumerate(itertools.pairwise(edges)):
        t = start
        weight = float(np.max(np.abs(structure.normal_forces(np.linspace(t, end, 65), piece)))) or 1.0
        sides, why = _start_piece(run, structure, piece, t, y, end, sides, max_step, weight)
        book.note(t, y, sides, why)
        last = _instant(run, last, t, max_step)
        while t < end:
            arc = _Arc(structure, piece, sides, max_step, weight)
            t, y, row, step = _follow_arc(run, arc, t, y, end, rtol, step)
            if arc.stuck.any():
                arc.project(t, y, np.flatnonzero(arc.stuck))
            if row < 0:
                break
            sides = _change(run, arc, t, y, row)
            book.note(t, y, sides, {})
            last, run.events = _instant(run, last, t, max_step), run.events + 1
            if run.events > most_events:
                raise ArithmeticError(f"more than {most_events} events before t = {t}")
    for i in list(book.current):
        book.finish(i, edges[-1], HORIZON)
    run.sticks.sort(key=lambda stick: (stick.start, stick.contact))
    run.position, run.velocity = y[: arc.d], y[arc.d : 2 * arc.d]
    return run


def _instant(run: Motion, last: float, t: float, max_step: float) -> float:
    run.close("instants", (t - last) / (2 * max_step))
    return t


def _start_piece(run, structure, piece, t, y, end, before, max_step, weight):
    """The sides at 0 or after a break, from those `before` it; and why sticks ended, where it was the base."""
    n = len(structure.directions)
    arc = _Arc(structure, piece, np.zeros(n, int), max_step, weight)
    relative, closed = arc.relative(t, y), _is_closed(arc, t, end)
    rest = np.abs(relative) <= REST * arc.speed(t, y)
    sides = np.where(closed, np.where(rest, STUCK, np.sign(relative)), OPEN).astype(int)
    why = {}
    if before is not None:
        why = dict.fromkeys(np.flatnonzero((before == STUCK) & ~rest).tolist(), BASE_SWITCHED)
    return _settle(run, _Arc(structure, piece, sides, max_step, weight), t, y, {}), why


def _change(run: Motion, arc: _Arc, t: float, y: np.ndarray, row: int) -> np.ndarray:
    """The sides after the gap `row` has closed."""
    n, sides, released = len(arc.sides), arc.sides.copy(), {}
    if row < n and sides[row] == STUCK and arc.normal(t)[row] <= VIABLE * arc.weight:
        row += n  # it needs nothing, and is held until it opens
    if row >= n:
        i = row - n
        relative = arc.relative(t, y)[i]
        at_rest = abs(relative) <= REST * arc.speed(t, y)
        sides[i] = OPEN if sides[i] != OPEN else STUCK if at_rest else int(np.sign(relative))
    elif sides[row] == STUCK:
        released = {row: -int(np.sign(arc.all(t, y)[1][row]))}
    else:
        sides[row] = STUCK
    # Others that came to rest at this very instant; a slip that has just begun from rest is not among them.
    relative, slipping = np.abs(arc.relative(t, y)), np.abs(sides) == 1
    sides[slipping & (relative <= REST * arc.speed(t, y))] = STUCK
    asked = _Arc(arc.structure, arc.piece, sides, arc.max_step, arc.weight)
    if asked.stuck.any():
        asked.project(t, y, np.flatnonzero(asked.stuck))
    after = _settle(run, asked, t, y, released)
    if row < n and not released and after[row] != STUCK:
        run.crossings.append((row, float(t)))
    return after
