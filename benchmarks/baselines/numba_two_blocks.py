"""Scalar yardstick for two blocks on a belt: closed forms of each stick pattern, compiled by numba.

    x1'' + 2.2 x1 - 1.2 x2 = -sgn(x1' - BELT) F1,    x2'' + 2.2 x2 - 1.2 x1 = -sgn(x2' - BELT) F2

with kinetic limits F = 0.8 and 1 N and static limits 1 and 1.3 N. With both blocks slipping the motion is the sum of
two oscillations; with one sticking the other swings about a centre that moves steadily; with both sticking the
forces that they need grow steadily, and the release is known at once. Elsewhere what ends a pattern is looked for in
steps of a 16th of the shortest period, each one rotation of sines and cosines, as sign changes and as minima below zero
of cubics through the ends, and then found by Newton's method.

- `given(x1, x2, *, t1, threads=1) -> Sticks`: blocks that begin at these positions (samples,) without velocity.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit

OWN, OTHER = 2.2, 1.2  # the stiffness matrix
KINETIC, STATIC = (0.8, 1.0), (1.0, 1.3)
BELT = 0.2
SLOW, FAST, ALONE = math.sqrt(OWN - OTHER), math.sqrt(OWN + OTHER), math.sqrt(OWN)
STEP = 2 * math.pi / FAST / 16
ROUNDS = 60
FINE = 1e-14
FLAGS = {"cache": False, "fastmath": {"contract"}, "nogil": True}


class Sticks(NamedTuple):
    """Of each sample and block: number of sticks and total stick time, (samples, 2)."""

    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride] - of sticks
    time: np.ndarray


@njit(**FLAGS)
def _lowest(h, start, end, fall, rise):
    """Where the cubic with these values and slopes (`fall < 0 < rise`) at 0 and `h` is lowest."""
    m0, m1, gain = h * fall, h * rise, end - start
    square, cube = 3.0 * gain - 2.0 * m0 - m1, m0 + m1 - 2.0 * gain
    return -h * m0 / (square + math.sqrt(max(square * square - 3.0 * cube * m0, 0.0)))


@njit(**FLAGS)
def _suspect(h, before, fall, after, rise):
    """A time in the step by which a guard that was positive has fallen to zero; infinite if it has not."""
    if after <= 0.0:
        return h
    if fall < 0.0 < rise:
        at = _lowest(h, before, after, fall, rise)
        # The cubic's value there, by Hermite's form.
        s = at / h
        value = before * (1 + 2 * s) * (1 - s) ** 2 + fall * h * s * (1 - s) ** 2
        value += after * s * s * (3 - 2 * s) + rise * h * s * s * (s - 1)
        if value <= 0.0:
            return at
    return math.inf


@njit(**FLAGS)
def _narrowed(low, high, tau, value, slope):
    """The bracket of a fall through zero with the `value` at `tau`, and the next try: Newton's, within the bracket."""
    if value > 0.0:
        low = tau
    else:
        high = tau
    trial = tau - value / slope if slope < 0.0 else math.inf
    return low, high, trial if low <= trial <= high else 0.5 * (low + high)


@njit(**FLAGS)
def _both_slip(x1, x2, v1, v2, s1, s2, left):
    """Both slip: the time until one is as fast as the belt, and the state there."""
    f1, f2 = -s1 * KINETIC[0], -s2 * KINETIC[1]
    cp, cm = 0.5 * (f1 + f2) / SLOW**2, 0.5 * (f1 - f2) / FAST**2  # centres of half the sum and half the difference
    p, m, pv, mv = 0.5 * (x1 + x2) - cp, 0.5 * (x1 - x2) - cm, 0.5 * (v1 + v2), 0.5 * (v1 - v2)
    a0, b0, a1, b1 = pv, -SLOW * p, mv, -FAST * m  # velocities: a cos + b sin
    cs, ss, cf, sf = math.cos(SLOW * STEP), math.sin(SLOW * STEP), math.cos(FAST * STEP), math.sin(FAST * STEP)
    now = 0.0
    while True:
        h = min(STEP, left - now)
        if h < STEP:
            cs, ss, cf, sf = math.cos(SLOW * h), math.sin(SLOW * h), math.cos(FAST * h), math.sin(FAST * h)
        na0, nb0, na1, nb1 = a0 * cs + b0 * ss, b0 * cs - a0 * ss, a1 * cf + b1 * sf, b1 * cf - a1 * sf
        d0, d1, nd0, nd1 = SLOW * b0, FAST * b1, SLOW * nb0, FAST * nb1
        first = math.inf
        which = 0
        for block in range(2):
            sign, of = (s1, 1.0) if block == 0 else (s2, -1.0)
            g, dg = sign * (a0 + of * a1 - BELT), sign * (d0 + of * d1)
            ng, ndg = sign * (na0 + of * na1 - BELT), sign * (nd0 + of * nd1)
            if now == 0.0 and g <= 1e-13 and (dg > 0.0 or ng > 0.0) and ng > 0.0:
                continue
            at = _suspect(h, g, dg, ng, ndg)
            if at < math.inf:
                low, high, tau = 0.0, at, at
                for _ in range(ROUNDS):
                    c, s, c1, s1_ = (
                        math.cos(SLOW * tau),
                        math.sin(SLOW * tau),
                        math.cos(FAST * tau),
                        math.sin(FAST * tau),
                    )
                    value = sign * (a0 * c + b0 * s + of * (a1 * c1 + b1 * s1_) - BELT)
                    slope = sign * (SLOW * (b0 * c - a0 * s) + of * FAST * (b1 * c1 - a1 * s1_))
                    low, high, trial = _narrowed(low, high, tau, value, slope)
                    if abs(trial - tau) <= FINE:
                        break
                    tau = trial
                if tau < first:
                    first, which = tau, block + 1
        if first < math.inf:
            c, s, c1, s1_ = (
                math.cos(SLOW * first),
                math.sin(SLOW * first),
                math.cos(FAST * first),
                math.sin(FAST * first),
            )
            a0, b0, a1, b1 = a0 * c + b0 * s, b0 * c - a0 * s, a1 * c1 + b1 * s1_, b1 * c1 - a1 * s1_
            now += first
        else:
            a0, b0, a1, b1 = na0, nb0, na1, nb1
            now += h
        if which > 0 or now >= left:
            p, m = cp - b0 / SLOW, cm - b1 / FAST
            return now, p + m, p - m, a0 + a1, a0 - a1, which


@njit(**FLAGS)
def _one_slips(x, v, sign, kinetic, held, static, left):  # noqa: PLR0912
    """One slips beside the other, which is `held` at its position: the time until the first is as fast as the belt (1)
    or the other is pulled off (2).
    """
    # Centre of the swing: (OTHER * held - sign * kinetic) / OWN, which moves steadily.
    drift = OTHER * BELT / OWN
    centre = (OTHER * held - sign * kinetic) / OWN
    a, b = v - drift, -ALONE * (x - centre)
    c, s = math.cos(ALONE * STEP), math.sin(ALONE * STEP)
    now = 0.0
    grows = OWN * BELT - OTHER * drift  # of the force that the held one needs, besides the swing
    while True:
        h = min(STEP, left - now)
        if h < STEP:
            c, s = math.cos(ALONE * h), math.sin(ALONE * h)
        na, nb = a * c + b * s, b * c - a * s
        # The force that the held block needs: OWN * held - OTHER * x.
        base = OWN * (held + BELT * now) - OTHER * (centre + drift * now)
        n0, n1 = base + OTHER * b / ALONE, base + grows * h + OTHER * nb / ALONE
        r0, r1 = grows - OTHER * a, grows - OTHER * na
        first, which, side = math.inf, 0, 0.0
        for kind in range(3):
            if kind == 0:
                g, dg, ng, ndg = (
                    sign * (a + drift - BELT),
                    sign * ALONE * b,
                    sign * (na + drift - BELT),
                    sign * ALONE * nb,
                )
                if now == 0.0 and g <= 1e-13 and ng > 0.0:
                    continue
            else:
                side = 1.0 if kind == 1 else -1.0
                g, dg, ng, ndg = static - side * n0, -side * r0, static - side * n1, -side * r1
            at = _suspect(h, g, dg, ng, ndg)
            if at < math.inf:
                low, high, tau = 0.0, at, at
                for _ in range(ROUNDS):
                    cc, ss = math.cos(ALONE * tau), math.sin(ALONE * tau)
                    ta, tb = a * cc + b * ss, b * cc - a * ss
                    if kind == 0:
                        value, slope = sign * (ta + drift - BELT), sign * ALONE * tb
                    else:
                        value = static - side * (base + grows * tau + OTHER * tb / ALONE)
                        slope = -side * (grows - OTHER * ta)
                    low, high, trial = _narrowed(low, high, tau, value, slope)
                    if abs(trial - tau) <= FINE:
                        break
                    tau = trial
                if tau < first:
                    first, which = tau, 1 if kind == 0 else 2
        if first < math.inf:
            cc, ss = math.cos(ALONE * first), math.sin(ALONE * first)
            a, b = a * cc + b * ss, b * cc - a * ss
            now += first
        else:
            a, b = na, nb
            now += h
        if which > 0 or now >= left:
            return now, centre + drift * now - b / ALONE, a + drift, which


@njit(**FLAGS)
def _trajectory(x1, x2, t1, count, time):  # noqa: PLR0912
    v1 = v2 = now = 0.0
    s1 = s2 = -1.0  # the blocks begin slower than the belt
    while now < t1:
        left, which = t1 - now, 0
        if s1 != 0.0 and s2 != 0.0:
            took, x1, x2, v1, v2, which = _both_slip(x1, x2, v1, v2, s1, s2, left)
        elif s1 != 0.0:
            took, x1, v1, which = _one_slips(x1, v1, s1, KINETIC[0], x2, STATIC[1], left)
            x2 += BELT * took
        elif s2 != 0.0:
            took, x2, v2, which = _one_slips(x2, v2, s2, KINETIC[1], x1, STATIC[0], left)
            x1 += BELT * took
            which = 3 - which if which > 0 else 0
        else:
            # The force that each needs grows by (OWN - OTHER) * BELT in a second.
            rate = (OWN - OTHER) * BELT
            until1 = (STATIC[0] - (OWN * x1 - OTHER * x2)) / rate
            until2 = (STATIC[1] - (OWN * x2 - OTHER * x1)) / rate
            took = min(left, max(min(until1, until2), 0.0))
            which = 0 if took == left else 1 if until1 <= until2 else 2
            x1 += BELT * took
            x2 += BELT * took
        now += took
        if s1 == 0.0:
            time[0] += took
        if s2 == 0.0:
            time[1] += took
        if which == 1:
            need = OWN * x1 - OTHER * x2
            if s1 == 0.0:
                s1 = -1.0 if need > 0.0 else 1.0
            else:
                s1 = 0.0 if abs(need) <= STATIC[0] else (-1.0 if need > 0.0 else 1.0)
                count[0] += s1 == 0.0
            v1 = BELT
        elif which == 2:
            need = OWN * x2 - OTHER * x1
            if s2 == 0.0:
                s2 = -1.0 if need > 0.0 else 1.0
            else:
                s2 = 0.0 if abs(need) <= STATIC[1] else (-1.0 if need > 0.0 else 1.0)
                count[1] += s2 == 0.0
            v2 = BELT
        if s1 == 0.0:
            v1 = BELT
        if s2 == 0.0:
            v2 = BELT


@njit(**FLAGS)
def _ensemble(x1, x2, t1, count, time):
    for i in range(x1.size):
        _trajectory(x1[i], x2[i], t1, count[i], time[i])


def given(x1: np.ndarray, x2: np.ndarray, *, t1: float, threads: int = 1) -> Sticks:
    """The sticks of blocks that begin at these positions (m) without velocity."""
    count, time = np.zeros((x1.size, 2), np.int64), np.zeros((x1.size, 2))
    bounds = np.linspace(0, x1.size, threads + 1).astype(int)

    def run(begin, end):
        part = slice(begin, end)
        _ensemble(x1[part], x2[part], float(t1), count[part], time[part])

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, bounds[:-1], bounds[1:]))
    return Sticks(count, time)
