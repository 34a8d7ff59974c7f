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
from collections.abc import Sequence

import numpy as np

from .contact_arcs import FLOOR, HORIZON, OPEN, REST, STUCK, VIABLE, Arc, Motion, Stick, Structure, follow_arc

RELEASED, OPENED, BASE_SWITCHED = "RELEASED", "OPENED", "BASE_SWITCHED"


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


def _settle(run: Motion, arc: Arc, t: float, y: np.ndarray, released: dict[int, int]) -> np.ndarray:
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


def _is_closed(arc: Arc, t: float, end: float) -> np.ndarray:
    """Which normal forces are positive; where one is zero, a little later decides."""
    normal, later = arc.normal(t), arc.normal(t + 1e-6 * min(end - t, arc.max_step))
    return np.where(np.abs(normal) > FLOOR * arc.weight, normal, later) > 0


def follow(
    structure: Structure,
    t1: float,
    x0: Sequence[float] | np.ndarray,
    v0: Sequence[float] | np.ndarray,
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
            arc = Arc(structure, piece, sides, max_step, weight)
            t, y, row, step = follow_arc(run, arc, t, y, end, rtol, step)
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
    run.position, run.velocity = np.split(y[:-1], 2)
    return run


def _instant(run: Motion, last: float, t: float, max_step: float) -> float:
    run.close("instants", (t - last) / (2 * max_step))
    return t


def _start_piece(run, structure, piece, t, y, end, before, max_step, weight):
    """The sides at 0 or after a break, from those `before` it; and why sticks ended, where it was the base."""
    n = len(structure.directions)
    arc = Arc(structure, piece, np.zeros(n, int), max_step, weight)
    relative, closed = arc.relative(t, y), _is_closed(arc, t, end)
    rest = np.abs(relative) <= REST * arc.speed(t, y)
    sides = np.where(closed, np.where(rest, STUCK, np.sign(relative)), OPEN).astype(int)
    why = {}
    if before is not None:
        why = dict.fromkeys(np.flatnonzero((before == STUCK) & ~rest).tolist(), BASE_SWITCHED)
    return _settle(run, Arc(structure, piece, sides, max_step, weight), t, y, {}), why


def _change(run: Motion, arc: Arc, t: float, y: np.ndarray, row: int) -> np.ndarray:
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
    asked = Arc(arc.structure, arc.piece, sides, arc.max_step, arc.weight)
    if asked.stuck.any():
        asked.project(t, y, np.flatnonzero(asked.stuck))
    after = _settle(run, asked, t, y, released)
    if row < n and not released and after[row] != STUCK:
        run.crossings.append((row, float(t)))
    return after
