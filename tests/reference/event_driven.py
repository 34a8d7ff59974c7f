"""Event-driven reference for stick-slip systems without a closed form, in numpy and scipy, good to about 1e-11.

A mass and spring on a base that moves in any way, and a motor that drives a cart; SI units. Both are followed one
smooth arc at a time: on a slip the sign of the relative velocity is held, so the field is smooth even past the arc's
end. What ends an arc is the first zero of a *gap*, a function of time and state that is positive on the arc: the
relative velocity on a slip, the distance of the needed force from the edges of its band on a stick. Each step is
sampled, every sign change and every dip between samples is looked at, and the zero is found by bracketing.

After an event the gap starts from zero (a released mass even leaves tangentially), so the samples of an arc's first
step crowd towards its start. A gap counts as closed only where it is below minus its *floor*, about 1e-12 of its scale:
a mass released on a steady base comes back a period later to touch the base velocity exactly, and does not stick.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre
from scipy.integrate import DOP853, solve_ivp
from scipy.optimize import brentq, minimize_scalar

RELEASED, BASE_SWITCHED, HORIZON = "RELEASED", "BASE_SWITCHED", "HORIZON"
UNIFORM = np.linspace(0.0, 1.0, 17)
FROM_ZERO = np.concatenate([[0.0], 2.0 ** np.arange(-20.0, -4.0), UNIFORM[1:]])
NODES, LONGEST, SLOWEST = 24, 0.04, 1e-11  # of the motor: a step's nodes, the longest step in s, no speed in rad/s


class Stick(NamedTuple):
    """One stick: its two instants, the position (the angle of the motor) at its start, and what ended it."""

    start: float
    end: float
    position: float
    ending: str


@dataclass
class Run:
    """The sticks in order, the instants at which the relative velocity passed through zero, and the motion."""

    sticks: list[Stick] = field(default_factory=list)
    crossings: list[float] = field(default_factory=list)
    final_state: np.ndarray | None = None
    stretches: list[tuple[float, Callable[[float], np.ndarray]]] = field(default_factory=list)

    def state_at(self, t: float) -> np.ndarray:
        """The state at one instant: ``(x, x')``, or the motor's ``(alpha, alpha', current)``."""
        return self.stretches[max(bisect_right(self.stretches, t, key=itemgetter(0)) - 1, 0)][1](t)


def den_hartog_amplitude(b: float, ratio: float) -> float:
    """Amplitude ``x0 k / P`` of the steady motion without stops under the force ``P cos(b omega t)``.

    `ratio` is the Coulomb friction force divided by ``P``. J. P. Den Hartog, Trans. ASME 53 (1931).
    """
    v = 1 / (1 - b * b)
    u = math.sin(math.pi / b) / (b * (1 + math.cos(math.pi / b)))
    return math.sqrt(v * v - (u * ratio) ** 2)


def _first_zero(gap, dense, exact, times: np.ndarray, floor: float) -> float | None:
    """The first zero of ``gap(times, states)`` among and between the samples `times` of the motion `dense`, `exact`."""
    values = gap(times, dense(times)) + floor
    at = lambda t: gap(np.array([t]), exact(t)[:, None])[0]  # noqa: E731
    slopes = np.diff(values)
    steep = np.abs(np.concatenate([slopes[:1], slopes, slopes[-1:]]))
    if np.min(values) > 2 * np.max(steep):
        return None
    falls_before = np.concatenate([[True], slopes[:-1] <= 0])
    rises_after = np.concatenate([slopes[1:] >= 0, [True]])
    low = np.minimum(values[:-1], values[1:]) <= 2 * np.max([steep[:-2], steep[1:-1], steep[2:]], axis=0)
    closed = values[1:] < 0
    for i in np.flatnonzero(closed | (falls_before & rises_after & low)):
        left, right = times[i], times[i + 1]
        if not closed[i]:
            options = {"bounds": (left, right), "method": "bounded", "options": {"xatol": 1e-8 * (right - left)}}
            lowest = minimize_scalar(lambda t: gap(np.array([t]), dense(np.array([t])))[0], **options)
            if lowest.fun >= -floor:
                continue
            right = lowest.x
        if at(left) <= 0:
            return left
        if at(right) < 0:
            return brentq(at, left, right, xtol=1e-16, rtol=4 * np.finfo(float).eps)
    return None


def _follow(run: Run, steps: Iterator, gaps: Sequence, end: float, from_zero: bool):
    """Follow an arc to `end` or to the first zero of one of its `gaps`, and store its motion in `run`.

    `steps` yields start, end, the states at many times (shape (n,) to (d, n), to find events by), the state at one time
    (exact). A gap is a function of many times and states and comes with its floor. With `from_zero` the first one is
    zero at the arc's start and must open. Returns time, state, and which gap closed (-1: none).
    """
    for start, stop, dense, exact in steps:
        last = min(stop, end)
        run.stretches.append((start, exact))
        times = start + (last - start) * (FROM_ZERO if from_zero else UNIFORM)
        zeros = [_first_zero(gap, dense, exact, times, floor) for gap, floor in gaps]
        t, which = min([(t, which) for which, t in enumerate(zeros) if t is not None], default=(last, -1))
        (gap, floor), before = gaps[0], times[times <= t]
        from_zero = from_zero and np.max(gap(before, dense(before))) <= floor
        if from_zero and which == 0:
            raise ArithmeticError(f"the arc that starts near t = {start} leaves zero on the wrong side")
        if which >= 0 or last >= end:
            return t, exact(t), which
    raise ArithmeticError(f"the integration stopped before t = {end}")


def _runge_kutta(slope, t: float, state: np.ndarray, end: float, rtol: float, max_step: float) -> Iterator:
    """Steps of DOP853 from `t` to `end`; the states within a step come from a shorter one, not from the interpolant."""
    tolerances = {"rtol": rtol, "atol": 1e-3 * rtol}

    def restarted(t, start, before):
        if t <= start:
            return before.copy()
        return solve_ivp(slope, (start, t), before, method="DOP853", first_step=t - start, **tolerances).y[:, -1]

    solver = DOP853(slope, t, state, end, max_step=max_step, **tolerances)
    while solver.status == "running":
        start, before = solver.t, solver.y.copy()
        solver.step()
        if solver.status != "failed":
            yield start, solver.t, solver.dense_output(), partial(restarted, start=start, before=before)


@dataclass(frozen=True)
class _Oscillator:
    """The mass and spring between two breaks."""

    mass: float
    stiffness: float
    damping: float
    band: float  # the largest friction force in a stick
    friction: Callable[[float], float]  # the friction force at a sliding speed
    velocity: Callable[[float], float]
    acceleration: Callable[[float], float]
    force: Callable[[float], float]
    max_step: float

    def needed(self, t: float, x: float) -> float:
        """The friction force that keeps the mass on the base."""
        acceleration, v = self.acceleration(t), self.velocity(t)
        return self.mass * acceleration + self.damping * v + self.stiffness * x - self.force(t)

    def ride(self, t: float, _) -> np.ndarray:
        """Slope of ``(x, x')`` in a stick."""
        return np.array([self.velocity(t), self.acceleration(t)])

    def slide(self, t: float, state: np.ndarray, side: int) -> np.ndarray:
        """Slope of ``(x, x')`` on a slip with the sign `side` of ``x' - v``."""
        push = self.force(t) - side * self.friction(side * (state[1] - self.velocity(t)))
        return np.array([state[1], (push - self.damping * state[1] - self.stiffness * state[0]) / self.mass])

    def ahead(self, times: np.ndarray, states: np.ndarray, side: int) -> np.ndarray:
        """The gap of a slip."""
        return side * (states[1] - np.array([self.velocity(t) for t in times]))

    def margin(self, times: np.ndarray, states: np.ndarray) -> np.ndarray:
        """The gap of a stick."""
        return self.band - np.abs([self.needed(t, x) for t, x in zip(times, states[0], strict=True)])

    def floor(self, t: float, state: np.ndarray) -> float:
        """Speeds closer than this are equal: 1e-12 of the largest speed around."""
        others = abs(state[0]) * math.sqrt(self.stiffness / self.mass) + self.max_step * self.band / self.mass
        return 1e-12 * (abs(state[1]) + abs(self.velocity(t)) + others)

    def side(self, t: float, state: np.ndarray, end: float) -> int:
        """The sign of ``x' - v`` in what follows, 0 for a stick; on the edge of the band, a little later decides."""
        if abs(relative := state[1] - self.velocity(t)) > self.floor(t, state):
            return int(np.sign(relative))
        needed = self.needed(t, state[0])
        margin = self.band - abs(needed)
        if abs(margin) <= 1e-12 * self.band:
            later = min(end, t + 1e-6 * self.max_step)
            margin = self.band - abs(self.needed(later, state[0] + (later - t) * self.velocity(t)))
        return 0 if margin > 0 else -int(np.sign(needed))


def simulate_mass_spring(
    *,
    mass: float,
    stiffness: float,
    damping: float,
    normal_force: float,
    mu_static: float,
    mu_kinetic: float | Callable[[float], float],
    base_velocity: Callable[[float, int], float],
    base_acceleration: Callable[[float, int], float],
    force: Callable[[float, int], float],
    t1: float,
    y0: Sequence[float],
    breaks: Sequence[float] = (),
    rtol: float = 1e-12,
    max_step: float | None = None,
) -> Run:
    """Simulate ``m x'' + c x' + k x = F(t) - mu_kinetic(|v_rel|) n sgn(v_rel)``, ``v_rel = x' - v(t)``, on ``[0, t1]``.

    The functions of time are called as ``f(t, segment)``; `segment` counts the stretches between `breaks`, at which the
    base velocity may jump and the others jump or kink. `mu_kinetic` is called slightly below zero in the last step of
    a slip and should go on smoothly there. A stick ends when the needed force leaves ``[-mu_static n, mu_static n]``
    (RELEASED), at a jump of the base velocity (BASE_SWITCHED) or at `t1` (HORIZON). `max_step` must resolve the base
    motion and the force; by default it is an eighth of the shortest of ``sqrt(m/k)``, ``m/c`` and ``t1 / 8``.
    """
    edges = [0.0, *map(float, breaks), float(t1)]
    law = mu_kinetic if callable(mu_kinetic) else lambda _: mu_kinetic
    if law(0.0) > mu_static or min(np.diff(edges)) <= 0:
        raise ValueError("mu_kinetic(0) must not exceed mu_static, and breaks must increase within (0, t1)")
    max_step = max_step or 1 / (8 * max(8 / t1, math.sqrt(stiffness / mass), damping / mass))
    system = partial(_Oscillator, mass, stiffness, damping, mu_static * normal_force, lambda s: law(s) * normal_force)
    run, state, stuck = Run(), np.array(y0, float), None
    for piece, (t, end) in enumerate(itertools.pairwise(edges)):
        functions = [lambda t, f=f, p=piece: float(f(t, p)) for f in (base_velocity, base_acceleration, force)]
        now = system(*functions, max_step)
        if stuck and abs(state[1] - now.velocity(t)) > now.floor(t, state):
            run.sticks.append(stuck._replace(end=t, ending=BASE_SWITCHED))
            stuck = None
        state, stuck = _run_piece(run, now, t, end, state, stuck, rtol)
    run.sticks += [stuck._replace(end=edges[-1])] if stuck else []
    run.final_state = state
    return run


def _run_piece(run: Run, system: _Oscillator, t: float, end: float, state: np.ndarray, stuck: Stick | None, rtol):
    """All arcs from `t` to `end`; `stuck` is the stick that has not ended when they begin, and when they do."""
    side = system.side(t, state, end)
    while t < end:
        floor = system.floor(t, state)
        from_zero = abs(state[1] - system.velocity(t)) <= floor
        if side == 0:
            stuck = stuck or Stick(t, math.nan, float(state[0]), HORIZON)
            slope, gap = system.ride, (system.margin, 1e-12 * system.band)
        else:
            run.sticks, stuck = run.sticks + ([stuck._replace(end=t, ending=RELEASED)] if stuck else []), None
            slope, gap = partial(system.slide, side=side), (partial(system.ahead, side=side), floor)
        steps = _runge_kutta(slope, t, state, end, rtol, system.max_step)
        t, state, closed = _follow(run, steps, [gap], end, from_zero)
        if side == 0:
            state[1], side = system.velocity(t), -int(np.sign(system.needed(t, state[0])))
        elif closed == 0:
            state[1] = system.velocity(t)
            side = system.side(t, state, end)
            run.crossings += [t] if side else []
    return state, stuck


@lru_cache(maxsize=64)
def _collocation(inductance: float, resistance: float, k_e: float, length: float):
    """Of a step: nodes, integrals of a rate once and twice, rates of the current, its part in the Jacobian, series."""
    points, weights = legendre.leggauss(NODES)
    analyze = (np.arange(NODES)[:, None] + 0.5) * legendre.legvander(points, NODES - 1).T * weights
    primitive = length / 2 * legendre.legint(np.eye(NODES), lbnd=-1, axis=0) @ analyze
    integral = legendre.legvander(points, NODES) @ primitive
    places = chebyshev.chebpts1(NODES + 1)
    series = chebyshev.chebfit(places, legendre.legvander(places, NODES), NODES) @ primitive
    rate = np.linalg.inv(inductance * np.eye(NODES) + resistance * integral)
    return length / 2 * (points + 1), integral, integral @ integral, rate, k_e**2 * integral @ rate @ integral, series


class _MotorCart(NamedTuple):
    """The motor and cart, by default with the parameters of Table 1."""

    mu: float
    theta: float
    power: int  # of alpha' in the term with sin cos
    l: float = 1.880e-4  # noqa: E741
    r: float = 0.307
    k_e: float = 5.330e-2
    j_m: float = 1.210e-4
    b_m: float = 1.545e-4
    m: float = 5.0
    d: float = 0.010
    nu0: float = 1.0
    nu1: float = 0.5
    omega_v: float = 10.0
    g: float = 9.81
    rtol: float = 1e-12

    def voltage(self, t):
        return self.nu0 + self.nu1 * np.sin(self.omega_v * t + self.theta)

    def band(self, angle: float) -> float:
        """The largest friction torque."""
        return self.mu * self.m * self.g * self.d * abs(math.sin(angle))

    def side_at_rest(self, t: float, state: np.ndarray) -> int:
        """What follows ``alpha' = 0``: 0 for a stick, else the direction of the slip; no stick at ``sin alpha = 0``."""
        push, nowhere = self.k_e * state[2], abs(math.sin(state[0])) <= 1e-14 * (1 + abs(state[0]))
        return 0 if abs(push) <= self.band(state[0]) and not nowhere else int(np.sign(push or self.voltage(t)))

    def held(self, t, since: float, state: np.ndarray):
        """The current at `t` in a stick that began at `since`."""
        impedance = complex(self.r, self.l * self.omega_v)

        then, now = (np.exp(1j * (self.omega_v * x + self.theta)) * self.nu1 / impedance for x in (since, t))
        decay = np.exp((since - t) * self.r / self.l)
        return self.nu0 / self.r * (1 - decay) + now.imag + (state[2] - then.imag) * decay

    def release(self, t: float, state: np.ndarray, t1: float) -> float | None:
        """When a stick ends; none when it lasts to `t1`. The current is periodic once its transient has died out."""
        transient, period = 40 * self.l / self.r, 2 * math.pi / self.omega_v
        times = t + np.append(np.linspace(0, transient, 161), transient + np.linspace(0, period, 401)[1:])
        times = np.unique(np.minimum(times, t1))
        gap = lambda times, _: self.band(state[0]) - np.abs(self.k_e * self.held(times, t, state))  # noqa: E731
        return _first_zero(gap, np.atleast_1d, np.atleast_1d, times, 0.0)

    def collocate(self, t: float, state: np.ndarray, length: float, load: float) -> np.ndarray | None:
        """Chebyshev coefficients of the motion over one step; none when Newton's iteration fails.

        The unknowns are the angular accelerations; the rest follows linearly. `load` is the torque ``/ sin alpha``.
        """
        nodes, integral, twice, current_rate, coupling, series = _collocation(self.l, self.r, self.k_e, length)
        driving = self.voltage(t + nodes) - self.r * state[2]
        inertia, acceleration, settled = self.m * self.d**2, np.zeros(NODES), False
        for _ in range(10):
            speed = state[1] + integral @ acceleration
            rate = current_rate @ (driving - self.k_e * speed)
            if settled:
                return series @ np.stack([speed, acceleration, rate], axis=1)
            angle = state[0] + integral @ speed
            sine, cosine = np.sin(angle), np.cos(angle)
            swing, mixed, power = self.j_m + inertia * sine**2, inertia * sine * cosine, speed ** (self.power - 1)
            push = self.k_e * (state[2] + integral @ rate)
            residual = swing * acceleration + (self.b_m + mixed * power) * speed + load * sine - push
            by_speed = self.b_m + self.power * mixed * power
            by_angle = 2 * mixed * acceleration + load * cosine + inertia * (cosine**2 - sine**2) * power * speed
            slope = np.diag(swing) + by_speed[:, None] * integral + by_angle[:, None] * twice + coupling
            change = np.linalg.solve(slope, residual)
            acceleration -= change
            settled = np.max(np.abs(change)) <= 1e-9 * np.max(np.abs(acceleration))  # the next change is its square
        return None

    def slide(self, t: float, state: np.ndarray, load: float) -> Iterator:
        """Steps of a slip, without end: halved until the last coefficients are negligible, doubled where it is easy."""

        def dense(times, start, state, length, series):
            angles = np.arccos(np.clip(2 * (times - start) / length - 1, -1, 1))
            return state[:, None] + series.T @ np.cos(np.arange(NODES + 1)[:, None] * angles)

        length = LONGEST / 4
        while length > 1e-9:
            series = self.collocate(t, state, length, load)
            size = 0.0 if series is None else np.abs(state) + np.max(np.abs(series), axis=0)
            if series is None or np.any(np.abs(series[-2:]) > self.rtol / 10 * size):
                length /= 2
                continue
            motion = partial(dense, start=t, state=state, length=length, series=series)
            yield t, t + length, motion, lambda t, motion=motion: motion(np.array([t]))[:, 0]
            t, state = t + length, motion(np.array([t + length]))[:, 0]
            if np.all(np.abs(series[NODES // 2 : NODES // 2 + 2]) <= 1e-11 * size):
                length = min(2 * length, LONGEST)


def simulate_motor_cart(
    *, mu, theta, alpha0, t1, omega0=0.0, current0=0.0, equation="physical", stop_after_first_stick=False, **table
) -> Run:
    """Simulate the motor and cart of Lima and Sampaio (2022) on ``[0, t1]``; the state is ``(alpha, alpha', c)``.

    ``alpha'' (j_m + m d^2 sin^2) + b_m alpha' + m d^2 sin cos alpha'^2 - k_e c = -mu m g d |sin| sgn(alpha')`` and
    ``l c' + r c + k_e alpha' = nu0 + nu1 sin(omega_v t + theta)``; with ``equation="printed"`` the second power of
    ``alpha'`` is the first. `table`: `rtol` and any parameter of Table 1. `stop_after_first_stick` ends the run with
    the first stick that does not begin at 0.
    """
    cart = _MotorCart(mu, theta, {"physical": 2, "printed": 1}[equation], **table)
    run, t, state = Run(), 0.0, np.array([alpha0, omega0, current0], float)
    side = int(np.sign(omega0)) or cart.side_at_rest(t, state)
    # The angle lies in [turn, turn + 1] half-turns, in which sin(alpha) has the sign of (-1)^turn.
    turn = math.floor(alpha0 / math.pi)
    if abs(math.sin(alpha0)) <= 1e-14 * (1 + abs(alpha0)):
        turn = round(alpha0 / math.pi) - (side < 0)
    while t < t1:
        if side == 0:
            released = cart.release(t, state, t1)
            end, ending = (t1, HORIZON) if released is None else (released, RELEASED)
            run.sticks.append(Stick(t, end, float(state[0]), ending))
            motion = lambda t, since=t, held=state: np.array([held[0], 0.0, cart.held(t, since, held)])  # noqa: E731
            run.stretches.append((t, motion))
            t1 = end if stop_after_first_stick and t > 0 else t1
            t, state, side = end, motion(end), int(np.sign(motion(end)[2]))
            continue
        kink = math.pi * (turn + (side > 0))
        steps = cart.slide(t, state, cart.band(math.pi / 2) * side * (-1) ** (turn % 2))
        speed, room = lambda _, y, s=side: s * y[1], lambda _, y, s=side, kink=kink: s * (kink - y[0])
        t, state, closed = _follow(run, steps, [(speed, SLOWEST), (room, 0.0)], t1, state[1] == 0)
        if closed == 0:
            state[1] = 0.0
            side = cart.side_at_rest(t, state)
            run.crossings += [t] if side else []
        elif closed == 1:
            state[0], turn = kink, turn + side
    run.final_state = state
    return run
