"""Scalar yardstick for the motor-driven cart: Runge-Kutta of order four at a fixed step, compiled by numba.

The motor and cart of Lima and Sampaio 2022 with the values of their Table 1, in SI units:

    angle'' (J_M + M D^2 sin^2) + B_M angle' + M D^2 sin cos angle'^2 - K_E current = -mu M G D |sin| sgn(angle')
    L current' + R current + K_E angle' = NU_0 + NU_1 sin(OMEGA t + theta)

from `angle' = current = 0`. As in the paper time goes by equal steps, over the whole of `[0, t1]`, and each step
decides between slip and stick. So that event times are as good as the method at that step, a step is cut
where the motor comes to rest, where a stick ends and where `sin` changes sign (a kink of `|sin|`), and the next
steps count from there. In a stick the current is known in closed form.

A stick is a rest of non-zero duration; one cut by `t1` counts, with the duration it has. The rest from `t = 0`, with
which every trajectory begins, is not counted.

- `simulate(*, mu, t1, samples, seed=0, step=1e-4, threads=1) -> Sticks`: `theta` and the first angle are uniform on
  `[0, 2 pi]`; sample `i` is the same for any number of threads.
- `given(*, mu, t1, theta, alpha0, step=1e-4, threads=1) -> Sticks`: one trajectory for each pair.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit

L, R, K_E = 1.880e-4, 0.307, 5.330e-2
J_M, B_M, M, D, G = 1.210e-4, 1.545e-4, 5.0, 0.010, 9.81
NU_0, NU_1, OMEGA = 1.0, 0.5, 10.0

MDD = M * D * D
DECAY = R / L
# With the motor at rest the current settles on NU_0 / R + SWING * sin(OMEGA t + theta + LAG).
SWING = NU_1 / math.hypot(R, L * OMEGA)
LAG = -math.atan2(L * OMEGA, R)

LONGEST_STEP = 1e-3  # `_turned` is good to the last digits up to an angle of 0.06
FINE = 1e-14  # seconds: an event time is found once it moves by less
ROUNDS = 60  # if it never does, which takes a grazing contact

# Fused multiply-add and no more: the other fast-math flags bring nothing here and forbid NaN.
FLAGS = {"cache": False, "fastmath": {"contract"}, "nogil": True}


class Sticks(NamedTuple):
    """Per sample: start, duration and angle of the first stick (NaN if there is none), number of sticks.

    `steps` is the number of time steps of all samples together, cut ones included.
    """

    first_start: np.ndarray
    first_duration: np.ndarray
    first_angle: np.ndarray
    stick_count: np.ndarray
    steps: int


class _State(NamedTuple):
    """Where a slip stands, with the slopes of the speed and of the current."""

    angle: float
    sine: float
    cosine: float
    speed: float
    current: float
    acceleration: float
    rate: float


@njit(**FLAGS)
def _turned(sine, cosine, angle):
    """Sine and cosine after a rotation by a small angle. Calls of the library's `sin` would take most of the time."""
    q = angle * angle
    s = angle * (1.0 - q * (1 / 6 - q * (1 / 120 - q * (1 / 5040))))
    c = 1.0 - q * (1 / 2 - q * (1 / 24 - q * (1 / 720)))
    return sine * c + cosine * s, cosine * c - sine * s


@njit(**FLAGS)
def _slopes(sine, cosine, speed, current, voltage, drag):
    """Slopes of speed and current; `drag` is `mu M G D` with the sign of `speed * sin`."""
    torque = K_E * current - drag * sine - speed * (B_M + MDD * sine * cosine * speed)
    return torque * (1.0 / (J_M + MDD * sine * sine)), (voltage - R * current - K_E * speed) * (1.0 / L)


@njit(**FLAGS)
def _step(h, y, voltage_mid, voltage_end, drag):
    """One Runge-Kutta step. The slopes at its end are those that the next step begins with."""
    half, sixth = 0.5 * h, h * (1 / 6)
    w2, i2 = y.speed + half * y.acceleration, y.current + half * y.rate
    s, c = _turned(y.sine, y.cosine, half * y.speed)
    a2, r2 = _slopes(s, c, w2, i2, voltage_mid, drag)
    w3, i3 = y.speed + half * a2, y.current + half * r2
    s, c = _turned(y.sine, y.cosine, half * w2)
    a3, r3 = _slopes(s, c, w3, i3, voltage_mid, drag)
    w4, i4 = y.speed + h * a3, y.current + h * r3
    s, c = _turned(y.sine, y.cosine, h * w3)
    a4, r4 = _slopes(s, c, w4, i4, voltage_end, drag)
    turn = sixth * (y.speed + 2.0 * (w2 + w3) + w4)
    speed = y.speed + sixth * (y.acceleration + 2.0 * (a2 + a3) + a4)
    current = y.current + sixth * (y.rate + 2.0 * (r2 + r3) + r4)
    s, c = _turned(y.sine, y.cosine, turn)
    acceleration, rate = _slopes(s, c, speed, current, voltage_end, drag)
    return _State(y.angle + turn, s, c, speed, current, acceleration, rate)


@njit(**FLAGS)
def _short_step(h, y, phase, drag):
    """A step of any length; `phase` is that of the voltage at its start."""
    mid = NU_0 + NU_1 * math.sin(phase + 0.5 * h * OMEGA)
    return _step(h, y, mid, NU_0 + NU_1 * math.sin(phase + h * OMEGA), drag)


@njit(**FLAGS)
def _closer(tau, value, slope, low, high):
    """A Newton step, or a bisection, towards where `value` falls through 0. Returns `tau, low, high`."""
    if value > 0.0:
        low = tau
    else:
        high = tau
    trial = tau - value / slope if slope < 0.0 else math.inf
    return (trial if low <= trial <= high else 0.5 * (low + high)), low, high


@njit(**FLAGS)
def _cut(stops, longest, y, sense, edge, phase, drag):
    """Length and end of the step that stops the motor (`stops`) or else brings it to the angle `edge`."""
    low, high, tau = 0.0, longest, longest
    end = y
    for _ in range(ROUNDS):
        end = _short_step(tau, y, phase, drag)
        if stops:
            trial, low, high = _closer(tau, sense * end.speed, sense * end.acceleration, low, high)
        else:
            trial, low, high = _closer(tau, sense * (edge - end.angle), -sense * end.speed, low, high)
        if abs(trial - tau) <= FINE:
            break
        tau = trial
    return tau, end


@njit(**FLAGS)
def _lowest(h, start, end, fall, rise):
    """Where the cubic with these values and slopes (`fall < 0 < rise`) at 0 and `h` is lowest."""
    m0, m1, gain = h * fall, h * rise, end - start
    square, cube = 3.0 * gain - 2.0 * m0 - m1, m0 + m1 - 2.0 * gain
    return -h * m0 / (square + math.sqrt(max(square * square - 3.0 * cube * m0, 0.0)))


@njit(**FLAGS)
def _stopping(h, y, end, sense, phase, drag):
    """A time within the step by which the motor has stopped, infinite if it does not."""
    if sense * end.speed < 0.0:
        return h
    if y.speed != 0.0 and sense * y.acceleration < 0.0 and sense * end.acceleration > 0.0:  # stopped and gone on?
        tau = _lowest(h, sense * y.speed, sense * end.speed, sense * y.acceleration, sense * end.acceleration)
        if sense * _short_step(tau, y, phase, drag).speed < 0.0:
            return tau
    return math.inf


@njit(**FLAGS)
def _slip(now, angle, current, sense, theta, friction, step, t1):
    """From rest, in the direction `sense`, to the next rest or `t1`. Returns time, angle, current and steps."""
    turn_s, turn_c = math.sin(0.5 * OMEGA * step), math.cos(0.5 * OMEGA * step)
    # `sin` keeps its sign up to `half_turns * pi`.
    half_turns = math.floor(angle / math.pi) + 1.0 if sense > 0.0 else math.ceil(angle / math.pi) - 1.0
    drag = friction if half_turns % 2.0 == (1.0 if sense > 0.0 else 0.0) else -friction
    drag *= sense
    speed, steps = 0.0, 0
    while True:
        start, number, edge = now, 0, half_turns * math.pi
        v_s, v_c = math.sin(OMEGA * start + theta), math.cos(OMEGA * start + theta)
        sine, cosine = math.sin(angle), math.cos(angle)
        y = _State(angle, sine, cosine, speed, current, *_slopes(sine, cosine, speed, current, NU_0 + NU_1 * v_s, drag))
        while True:
            now = start + number * step
            last = now + step >= t1
            h = t1 - now if last else step
            mid_s, mid_c = v_s * turn_c + v_c * turn_s, v_c * turn_c - v_s * turn_s
            v_s, v_c = mid_s * turn_c + mid_c * turn_s, mid_c * turn_c - mid_s * turn_s
            if last:
                mid_s, v_s = math.sin(OMEGA * (now + 0.5 * h) + theta), math.sin(OMEGA * (now + h) + theta)
            end = _step(h, y, NU_0 + NU_1 * mid_s, NU_0 + NU_1 * v_s, drag)
            steps += 1
            angle = end.angle
            longest = _stopping(h, y, end, sense, OMEGA * now + theta, drag)
            if longest < math.inf:
                h, stop = _cut(True, longest, y, sense, edge, OMEGA * now + theta, drag)
                angle = stop.angle
                if sense * (edge - angle) > 0.0:
                    return now + h, angle, stop.current, steps
            if sense * (edge - angle) <= 0.0:
                h, stop = _cut(False, h, y, sense, edge, OMEGA * now + theta, drag)
                now, angle, speed, current = now + h, edge, stop.speed, stop.current
                half_turns += sense
                drag = -drag
                break
            if last:
                return t1, angle, end.current, steps
            y = end
            number += 1


@njit(**FLAGS)
def _held(tau, phase, excess):
    """Current and its slope in a stick; `excess` over the steady current and its `phase` are those at `tau = 0`."""
    settled, left = phase + OMEGA * tau, excess * math.exp(-DECAY * tau)
    return NU_0 / R + SWING * math.sin(settled) + left, SWING * OMEGA * math.cos(settled) - DECAY * left


@njit(**FLAGS)
def _stick(now, current, limit, theta, step, t1):
    """From rest to where the current leaves `[-limit, limit]`, or `t1`. Returns time, current, its side, steps."""
    turn_s, turn_c, decay = math.sin(OMEGA * step), math.cos(OMEGA * step), math.exp(-DECAY * step)
    theta += LAG
    start, number = now, 0
    v_s, v_c = math.sin(OMEGA * start + theta), math.cos(OMEGA * start + theta)
    excess = current - (NU_0 / R + SWING * v_s)
    rate = SWING * OMEGA * v_c - DECAY * excess
    while True:
        now = start + number * step
        number += 1
        last = now + step >= t1
        before, h = excess, step
        if last:
            h = t1 - now
            next_current, next_rate = _held(h, OMEGA * now + theta, before)
        else:
            v_s, v_c, excess = v_s * turn_c + v_c * turn_s, v_c * turn_c - v_s * turn_s, excess * decay
            next_current, next_rate = NU_0 / R + SWING * v_s + excess, SWING * OMEGA * v_c - DECAY * excess
        side, leaves, longest = math.copysign(1.0, next_current), abs(next_current) > limit, h
        if not leaves and rate * next_rate < 0.0:  # left and come back?
            side = math.copysign(1.0, rate)
            longest = _lowest(h, -side * current, -side * next_current, -side * rate, -side * next_rate)
            leaves = side * _held(longest, OMEGA * now + theta, before)[0] > limit
        if leaves:
            low, high, tau = 0.0, longest, longest
            for _ in range(ROUNDS):
                current, rate = _held(tau, OMEGA * now + theta, before)
                trial, low, high = _closer(tau, limit - side * current, -side * rate, low, high)
                if abs(trial - tau) <= FINE:
                    break
                tau = trial
            return now + tau, current, side, number
        if last:
            return t1, next_current, side, number
        current, rate = next_current, next_rate


@njit(**FLAGS)
def _trajectory(mu, t1, theta, angle, step):
    """One sample. Returns start, duration and angle of its first stick, the number of sticks, and of steps."""
    friction = mu * M * G * D
    now, current, sticks, steps = 0.0, 0.0, 0, 0
    first = (math.nan, math.nan, math.nan)
    while now < t1:
        limit, side = friction * abs(math.sin(angle)) / K_E, math.copysign(1.0, current)
        if abs(current) <= limit:
            start = now
            now, current, side, done = _stick(now, current, limit, theta, step, t1)
            steps += done
            if 0.0 < start < now:
                sticks += 1
                if sticks == 1:
                    first = (start, now - start, angle)
        if now < t1:
            now, angle, current, done = _slip(now, angle, current, side, theta, friction, step, t1)
            steps += done
    return first, sticks, steps


@njit(**FLAGS)
def _ensemble(mu, t1, theta, alpha0, step, first, sticks):
    steps = 0
    for i in range(theta.size):
        (first[0, i], first[1, i], first[2, i]), sticks[i], done = _trajectory(mu, t1, theta[i], alpha0[i], step)
        steps += done
    return steps


def given(*, mu, t1, theta, alpha0, step=1e-4, threads=1) -> Sticks:
    """The sticks of one trajectory for each pair of `theta` and `alpha0`, which are broadcast together."""
    if not (mu >= 0.0 and t1 > 0.0):
        raise ValueError(f"mu must not be negative and t1 must be positive, got {mu} and {t1}")
    if not 0.0 < step <= LONGEST_STEP:
        raise ValueError(f"step must be positive and at most {LONGEST_STEP}, got {step}")
    theta, alpha0 = np.broadcast_arrays(*(np.atleast_1d(np.asarray(value, dtype=float)) for value in (theta, alpha0)))
    theta, alpha0 = np.array(theta), np.array(alpha0)
    if theta.ndim != 1 or not (np.isfinite(theta).all() and np.isfinite(alpha0).all()):
        raise ValueError("theta and alpha0 must be finite, of shape () or (samples,)")
    first, sticks = np.empty((3, theta.size)), np.empty(theta.size, dtype=np.int64)

    def run(begin, end):
        part = slice(begin, end)
        return _ensemble(float(mu), float(t1), theta[part], alpha0[part], float(step), first[:, part], sticks[part])

    bounds = np.linspace(0, theta.size, threads + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        steps = sum(pool.map(run, bounds[:-1], bounds[1:]))
    return Sticks(first[0], first[1], first[2], sticks, steps)


def simulate(*, mu, t1, samples, seed=0, step=1e-4, threads=1) -> Sticks:
    """The sticks of `samples` trajectories, `theta` and the first angle drawn uniformly from `[0, 2 pi]`."""
    theta, alpha0 = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, (2, samples))
    return given(mu=mu, t1=t1, theta=theta, alpha0=alpha0, step=step, threads=threads)
