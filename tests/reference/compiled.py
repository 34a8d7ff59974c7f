"""Event-driven reference for a mass and spring, one scalar loop compiled by Numba: a set-up takes a millisecond.

``m x'' + c x' + k x = F(t) - side n mu(|v_rel|)`` with any damping. Base velocity and force are sums of tones and of
parts that are linear between breaks. Slips under constant friction are written by the two roots of the characteristic
polynomial, and the response to a tone by its complex stiffness; under other laws each step is one of Radau IIA with
five stages (order 9, stiffly accurate), shortened until two half steps agree with the whole to 1e-13. Events: a step's
ends are no more than a 40th of the shortest period apart and crowd towards the beginning of each arc; between them
lies an event where the gap changes its sign, or where its slope does and the minimum found by bisection is negative.

`event_driven.py` is slower and shares nothing with this file; `tests/search/test_quick.py` compares them.
"""

import math
from typing import NamedTuple

import numpy as np

from reference.compiling import compiled

RELEASED, BASE_SWITCHED, HORIZON = 0, 1, 2  # as the codes of `ss.Ending`
CONSTANT, WEAKENING, STRIBECK, HUMP = range(4)
STAGES, PER_PERIOD, GROWTH, FIRST = 5, 40, 1.3, 1e-7
FLOOR = 1e-12  # of the scale of a gap: what lies closer to zero is zero
GOOD = 1e-13

# Radau IIA: the right-hand Radau points, and the integrals of their Lagrange polynomials.
_RIGHT = np.polynomial.Legendre([0.0] * (STAGES - 1) + [1.0, -1.0])
NODES = np.sort((_RIGHT.roots().real + 1) / 2)
NODES[-1] = 1.0
_POWERS = np.arange(1, STAGES + 1)
_FIT = np.linalg.inv(NODES[:, None] ** (_POWERS - 1))
ONCE = (NODES[:, None] ** _POWERS / _POWERS) @ _FIT
TWICE = ONCE @ ONCE


class Numbers(NamedTuple):
    """A set-up as plain numbers; `static` and `coefficients` are friction coefficients, speeds in m/s.

    `coefficients` of the `law`: (mu,); (mu_static, weakening); (mu, mu_static, speed, viscous); (low, fall, scale,
    rise). `base` and `force`: rows (amplitude, angular frequency, phase). `pieces`: rows (start, base velocity, its
    slope, force, its slope).
    """

    mass: float
    stiffness: float
    damping: float
    normal_force: float
    static: float
    law: int
    coefficients: np.ndarray
    base: np.ndarray
    force: np.ndarray
    pieces: np.ndarray
    t1: float
    x: float
    v: float


class Found(NamedTuple):
    """Rows (start, end, position, ending) of the sticks; the state at t1; the least distance from another outcome.

    `close` is relative: of an arrival's force from the limit, of a grazing minimum from zero.
    """

    sticks: np.ndarray
    state: np.ndarray
    close: float
    crossings: int


@compiled
def friction(law, q, s):
    """The kinetic friction coefficient at the sliding speed `s` and its slope; below zero a straight line."""
    if law == CONSTANT:
        return q[0], 0.0
    at = max(s, 0.0)
    if law == WEAKENING:
        mu, slope = q[0] / (1 + q[1] * at), -q[0] * q[1] / (1 + q[1] * at) ** 2
    elif law == STRIBECK:
        bump = (q[1] - q[0]) * math.exp(-((at / q[2]) ** 2))
        mu, slope = q[0] + bump + q[3] * at, q[3] - 2 * at / q[2] ** 2 * bump
    else:
        fall = q[1] * math.exp(-at / q[2])
        mu, slope = q[0] + fall + q[3] * at, q[3] - fall / q[2]
    return mu + slope * (s - at), slope


@compiled
def driven(of, piece, t):
    """Velocity and acceleration of the base and its jerk; the force and its rate."""
    since = t - piece[0]
    v, a, j, f, r = piece[1] + piece[2] * since, piece[2], 0.0, piece[3] + piece[4] * since, piece[4]
    for i in range(of.base.shape[0]):
        size, w, angle = of.base[i, 0], of.base[i, 1], of.base[i, 1] * t + of.base[i, 2]
        v += size * math.cos(angle)
        a -= size * w * math.sin(angle)
        j -= size * w * w * math.cos(angle)
    for i in range(of.force.shape[0]):
        size, w, angle = of.force[i, 0], of.force[i, 1], of.force[i, 1] * t + of.force[i, 2]
        f += size * math.cos(angle)
        r -= size * w * math.sin(angle)
    return v, a, j, f, r


@compiled
def travel(of, piece, t, h):
    """The way of the base from `t` to ``t + h``."""
    way = h * (piece[1] + piece[2] * (t - piece[0] + h / 2))
    for i in range(of.base.shape[0]):
        size, w, phase = of.base[i]
        way += 2 * size / w * math.sin(w * h / 2) * math.cos(w * (t + h / 2) + phase)
    return way


@compiled
def answer(of, t):
    """The steady response to the tones of the force: position and velocity."""
    x, v = 0.0, 0.0
    for i in range(of.force.shape[0]):
        size, w, phase = of.force[i]
        turned = size / complex(of.stiffness - of.mass * w * w, of.damping * w)
        turned *= complex(math.cos(w * t + phase), math.sin(w * t + phase))
        x += turned.real
        v -= w * turned.imag
    return x, v


@compiled
def rotation(of, h):
    """Of a free vibration ``x = cosine x0 + sine v0`` that is damped: cosine, sine, ``1 - cosine``, and ``sine'``."""
    beta, square = of.damping / (2 * of.mass), of.stiffness / of.mass
    inside = (beta - math.sqrt(square)) * (beta + math.sqrt(square))
    if inside > 0:
        s = math.sqrt(inside)
        slow = -square / (beta + s)
        fade = math.exp(slow * h)
        sine = -fade * math.expm1(-2 * s * h) / (2 * s)
        return fade - slow * sine, sine, slow * sine - math.expm1(slow * h), fade - (beta + s) * sine
    s = math.sqrt(-inside)
    fade = math.exp(-beta * h)
    sine = fade * (math.sin(s * h) / s if s * h > 1e-4 else h * (1 - (s * h) ** 2 / 6))
    cosine = fade * math.cos(s * h)
    return cosine + beta * sine, sine, 1 - cosine - beta * sine, cosine - beta * sine


@compiled
def collocate(of, piece, t, x, v, side, h):  # noqa: PLR0912 - elimination written out
    """One step of Radau IIA under any friction law; a velocity that is not finite where Newton's iteration fails."""
    m, k, c, n = of.mass, of.stiffness, of.damping, of.normal_force
    rates, matrix, rest = np.zeros(STAGES), np.empty((STAGES, STAGES)), np.empty(STAGES)
    for turn in range(12):
        size = 0.0
        for i in range(STAGES):
            base, _, _, force, _ = driven(of, piece, t + NODES[i] * h)
            p, y = v, x + h * NODES[i] * v
            for j in range(STAGES):
                p += h * ONCE[i, j] * rates[j]
                y += h * h * TWICE[i, j] * rates[j]
            mu, slope = friction(of.law, of.coefficients, side * (p - base))
            rest[i] = force - c * p - k * y - side * n * mu - m * rates[i]
            size = max(size, (abs(force) + c * abs(p) + k * abs(y) + n * mu) / m)
            for j in range(STAGES):
                matrix[i, j] = h * (c + n * slope) * ONCE[i, j] + h * h * k * TWICE[i, j] + (m if i == j else 0.0)
        for i in range(STAGES):  # elimination with pivots
            best = i
            for j in range(i + 1, STAGES):
                if abs(matrix[j, i]) > abs(matrix[best, i]):
                    best = j
            for j in range(STAGES):
                matrix[i, j], matrix[best, j] = matrix[best, j], matrix[i, j]
            rest[i], rest[best] = rest[best], rest[i]
            for j in range(i + 1, STAGES):
                share = matrix[j, i] / matrix[i, i]
                rest[j] -= share * rest[i]
                for column in range(i, STAGES):
                    matrix[j, column] -= share * matrix[i, column]
        change = 0.0
        for i in range(STAGES - 1, -1, -1):
            for j in range(i + 1, STAGES):
                rest[i] -= matrix[i, j] * rest[j]
            rest[i] /= matrix[i, i]
            rates[i] += rest[i]
            change = max(change, abs(rest[i]))
        if change <= 1e-15 * size or (turn > 2 and change <= 1e-14 * size):
            y, p = x + h * v, v
            for j in range(STAGES):
                p += h * ONCE[STAGES - 1, j] * rates[j]
                y += h * h * TWICE[STAGES - 1, j] * rates[j]
            return y, p
    return math.nan, math.nan


@compiled
def slid(of, piece, t, x, v, side, h):
    """The state after a slip of the length `h`."""
    if h == 0:
        return x, v
    if of.law != CONSTANT:
        return collocate(of, piece, t, x, v, side, h)
    # About the state of rest under the load at the beginning; a load that grows has its own response, zero at first:
    # the steady one, with its ``damping / stiffness``, would lose digits where the damping is heavy.
    k = of.stiffness
    rest = (piece[3] + piece[4] * (t - piece[0]) - side * of.coefficients[0] * of.normal_force) / k
    slope = piece[4] / k
    before, speed_before = answer(of, t)
    after, speed_after = answer(of, t + h)
    u, w = x - rest - before, v - speed_before
    cosine, sine, less, rate = rotation(of, h)
    y = rest + cosine * u + sine * w + after + slope * (h - of.damping / k * less - sine)
    return y, rate * w - k / of.mass * sine * u + speed_after + slope * less


@compiled
def gap(of, piece, t, x, v, side):
    """What is positive while the mode lasts, its slope, and its scale."""
    base, a, j, force, rate = driven(of, piece, t)
    if side == 0:
        band = of.static * of.normal_force
        needed = of.mass * a + of.damping * base + of.stiffness * x - force
        slope = of.mass * j + of.damping * a + of.stiffness * base - rate
        return band - abs(needed), -slope if needed > 0 else slope, band
    mu, _ = friction(of.law, of.coefficients, side * (v - base))
    acceleration = (force - of.damping * v - of.stiffness * x - side * mu * of.normal_force) / of.mass
    # Of what may cancel: velocities, and those that position and friction make.
    omega = math.sqrt(of.stiffness / of.mass)
    scale = abs(v) + abs(base) + abs(x) * omega + of.static * of.normal_force / max(of.mass * omega, of.damping)
    return side * (v - base), side * (acceleration - a), scale


@compiled
def moved(of, piece, t, x, v, side, h):
    if side != 0:
        return slid(of, piece, t, x, v, side, h)
    return x + travel(of, piece, t, h), driven(of, piece, t + h)[0]


@compiled
def minimum(of, piece, t, x, v, side, h):
    """The time within `h` at which the slope of the gap turns from negative to positive."""
    left, right = 0.0, h
    for _ in range(60):
        middle = (left + right) / 2
        if middle in (left, right):
            break
        y, p = moved(of, piece, t, x, v, side, middle)
        if gap(of, piece, t + middle, y, p, side)[1] < 0:
            left = middle
        else:
            right = middle
    return right


@compiled
def zero(of, piece, t, x, v, side, right):
    """The time within `right`, where the gap is negative, at which it becomes so: Newton's iteration in a bracket."""
    left, now = 0.0, right
    for _ in range(200):
        y, p = moved(of, piece, t, x, v, side, now)
        value, slope, _ = gap(of, piece, t + now, y, p, side)
        if value > 0:
            left = now
        else:
            right = now
        guess = now - value / slope if slope < 0 else left
        if not left < guess < right:
            guess = (left + right) / 2
        if abs(guess - now) <= 1e-16 * (t + now) or guess in (left, right):
            return guess
        now = guess
    return now


@compiled
def follow(of, piece, t, end, x, v, side, longest):
    """Follow one mode up to its event or to `end`: time, state, whether there was an event, least distance from one."""
    h, close = FIRST * longest, math.inf
    # All rates together: what fades is resolved by steps of this length.
    slope = abs(friction(of.law, of.coefficients, 0.0)[1])
    least = 0.02 / (1 / longest + (of.damping + of.normal_force * slope) / of.mass)
    g0, d0, scale = gap(of, piece, t, x, v, side)
    while t < end:
        h = min(h, longest, end - t)
        y, p = moved(of, piece, t, x, v, side, h)
        if side != 0 and of.law != CONSTANT:
            y2, p2 = slid(of, piece, t, x, v, side, h / 2)
            y2, p2 = slid(of, piece, t + h / 2, y2, p2, side, h / 2)
            omega = math.sqrt(of.stiffness / of.mass)
            size = abs(v) + abs(p2) + omega * (abs(x) + abs(y2)) + 1e-3 * scale
            error = (abs(p2 - p) + omega * abs(y2 - y)) / size
            if not error <= GOOD and h > least:
                h *= max(0.2, 0.8 * (GOOD / error) ** 0.1) if error < 1 else 0.2
                continue
            y, p = y2, p2
            growth = min(GROWTH, 0.8 * (GOOD / max(error, 1e-30)) ** 0.1)
        else:
            growth = GROWTH
        g1, d1, scale = gap(of, piece, t + h, y, p, side)
        floor, cut = FLOOR * scale, -1.0
        if g1 < -floor:
            cut = h
        elif d0 < 0 < d1:
            lowest = minimum(of, piece, t, x, v, side, h)
            y2, p2 = moved(of, piece, t, x, v, side, lowest)
            least = gap(of, piece, t + lowest, y2, p2, side)[0]
            if g0 > floor:
                close = min(close, abs(least) / scale)
            if least < -floor:
                cut = lowest
        if cut >= 0:
            at = 0.0 if g0 <= 0 else zero(of, piece, t, x, v, side, cut)
            y, p = moved(of, piece, t, x, v, side, at)
            return t + at, y, p, True, close
        t, x, v, g0, d0 = (end if h == end - t else t + h), y, p, g1, d1
        h *= max(growth, 0.2)
    return end, x, v, False, close


@compiled
def side_of(of, piece, t, x, v, end, longest):
    """The sign of ``x' - v`` in what follows, 0 for a stick; and how far the force is from its limit, relatively."""
    base = driven(of, piece, t)[0]
    relative, _, scale = gap(of, piece, t, x, v, 1)
    if abs(relative) > FLOOR * scale:
        return (1 if v > base else -1), math.inf
    margin, _, band = gap(of, piece, t, x, base, 0)
    apart = abs(margin) / band if band > 0 else math.inf
    if abs(margin) <= FLOOR * band:  # on the edge, a little later decides
        h = min(end - t, 1e-6 * longest)
        margin = gap(of, piece, t + h, x + travel(of, piece, t, h), 0.0, 0)[0]
    _, a, _, force, _ = driven(of, piece, t)
    needed = of.mass * a + of.damping * base + of.stiffness * x - force
    return (0 if margin >= -FLOOR * band else (-1 if needed > 0 else 1)), apart


@compiled
def noted(sticks, number, start, end, position, ending):
    sticks[number, 0], sticks[number, 1], sticks[number, 2], sticks[number, 3] = start, end, position, ending
    return number + 1


@compiled
def simulate(of, room):  # noqa: PLR0912 - one loop over the events
    """All sticks, and the state at t1. `room`: the largest number of sticks, and of events."""
    sticks, number, crossings, close = np.empty((room, 4)), 0, 0, math.inf
    fastest = math.sqrt(of.stiffness / of.mass)
    for i in range(of.base.shape[0]):
        fastest = max(fastest, of.base[i, 1])
    for i in range(of.force.shape[0]):
        fastest = max(fastest, of.force[i, 1])
    longest, x, v, stuck = 2 * math.pi / fastest / PER_PERIOD, of.x, of.v, False
    begun, place = 0.0, 0.0
    frictionless = of.static == 0 and of.law == CONSTANT
    for i in range(of.pieces.shape[0]):
        piece, t = of.pieces[i], of.pieces[i, 0]
        end = of.t1 if i + 1 == of.pieces.shape[0] else min(of.t1, of.pieces[i + 1, 0])
        if not t < end:
            continue
        if frictionless:
            x, v = slid(of, piece, t, x, v, 1, end - t)
            continue
        if stuck:
            relative, _, scale = gap(of, piece, t, x, v, 1)
            if abs(relative) > FLOOR * scale:
                number, stuck = noted(sticks, number, begun, t, place, BASE_SWITCHED), False
        side, apart = side_of(of, piece, t, x, v, end, longest)
        close = min(close, apart)
        while t < end:
            if side == 0 and not stuck:
                stuck, begun, place = True, t, x
            if side != 0 and stuck:
                number, stuck = noted(sticks, number, begun, t, place, RELEASED), False
            t, x, v, event, near = follow(of, piece, t, end, x, v, side, longest)
            close = min(close, near)
            if not event:
                break
            base, a, _, force, _ = driven(of, piece, t)
            v = base
            if side == 0:
                side = -1 if of.mass * a + of.damping * base + of.stiffness * x - force > 0 else 1
            else:
                side, apart = side_of(of, piece, t, x, v, end, longest)
                close = min(close, apart)
                crossings += side != 0
            if crossings + number >= room - 2:
                return sticks[:number], np.array([math.nan, math.nan]), 0.0, crossings
    if stuck:
        number = noted(sticks, number, begun, of.t1, place, HORIZON)
    return sticks[:number], np.array([x, v]), close, crossings


def run(numbers: Numbers, room: int = 512) -> Found:
    """The motion of one set-up; a state that is not finite where there are more events than `room`."""
    return Found(*simulate(numbers, room))
