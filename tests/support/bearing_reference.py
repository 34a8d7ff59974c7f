"""A mass on one pendulum bearing under a recorded ground motion, from event to event with SciPy, without the package.

Modes are slips of either sign, sticks, and flights in which the normal force is not positive. Each piece of a record is
integrated by itself (DOP853, rtol 1e-12), so that every right-hand side is smooth.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

TOLERANCES = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15}


@dataclass
class Bearing:
    """`ground`, `vertical`: accelerations at `times`, m/s^2, linear between; `curvature`: of the bearing, 1/m.

    `friction`: the coefficient by the speed; `breakaway`: the static one; `gravity`: m/s^2. Of the motion: its
    `sticks` [start, end], `peak` of the displacement, and of the speed (`fastest`).
    """

    times: np.ndarray
    ground: np.ndarray
    vertical: np.ndarray
    curvature: float
    friction: object
    breakaway: float
    gravity: float = 9.81
    x: float = 0.0
    v: float = 0.0
    sticks: list = field(default_factory=list)  # [start, end]
    peak: float = 0.0
    fastest: float = 0.0

    def run(self):
        self.mode = None  # +1, -1 slip; 0 stick; "open"
        for i in range(len(self.times) - 1):
            self._piece(i)
        if self.mode == 0:
            self.sticks[-1][1] = self.times[-1]
        return self

    def _piece(self, i):
        t0, t1 = self.times[i], self.times[i + 1]

        def ground(t):
            return self.ground[i] + (self.ground[i + 1] - self.ground[i]) * (t - t0) / (t1 - t0)

        def pressed(t):  # N / m
            return self.gravity + self.vertical[i] + (self.vertical[i + 1] - self.vertical[i]) * (t - t0) / (t1 - t0)

        def excess(t):  # of what a stick needs over what it can hold
            return abs(ground(t) + pressed(t) * self.curvature * self.x) - self.breakaway * pressed(t)

        # Within a piece the normal force is linear: it changes its sign once at most.
        edges = [t0, t1]
        if pressed(t0) * pressed(t1) < 0:
            edges.insert(1, t0 + (t1 - t0) * pressed(t0) / (pressed(t0) - pressed(t1)))
        for begin, end in pairwise(edges):
            is_open = pressed((begin + end) / 2) < 0
            if is_open != (self.mode == "open") or self.mode is None:
                if self.mode == 0:
                    self.sticks[-1][1] = begin
                self.mode = "open" if is_open else self._settle(begin, ground, pressed, excess)
            t = begin
            while t < end:
                t = self._advance(t, end, ground, pressed, excess)

    def _settle(self, t, ground, pressed, excess):
        """The mode of a closed contact from here on."""
        if self.v != 0:
            return np.sign(self.v)
        if excess(t + 1e-12) <= 0:
            self.sticks.append([t, np.nan])
            return 0
        return -np.sign(ground(t) + pressed(t) * self.curvature * self.x)

    def _advance(self, t, end, ground, pressed, excess):
        if self.mode == 0:
            # What it needs less what it can hold, either way: lines within a piece.
            roots = []
            for way in (1, -1):

                def line(s, way=way):
                    return way * (ground(s) + pressed(s) * self.curvature * self.x) - self.breakaway * pressed(s)

                if line(t) <= 1e-13 and line(end) > 1e-13:
                    roots.append((t if line(t) > 0 else brentq(line, t, end, xtol=1e-15), way))
            if not roots:
                return end
            at, way = min(roots)
            self.sticks[-1][1] = at
            self.mode = -way
            return at
        sign = 0 if self.mode == "open" else self.mode

        def rates(s, y):
            friction = sign * self.friction(sign * y[1]) if sign else 0.0
            pull = pressed(s) * (friction + self.curvature * y[0]) if sign else 0.0
            return [y[1], -ground(s) - pull]

        def stops(s, y):
            return y[1]

        stops.terminal, stops.direction = True, -sign
        found = solve_ivp(
            rates, (t, end), [self.x, self.v], events=[stops] if sign else None, dense_output=True, **TOLERANCES
        )
        self._extremes(found)
        self.x, self.v = found.y[:, -1]
        if not (sign and found.status == 1):
            return end
        self.v, at = 0.0, found.t[-1]
        need = ground(at) + pressed(at) * self.curvature * self.x
        if abs(need) <= self.breakaway * pressed(at):
            self.sticks.append([at, np.nan])
            self.mode = 0
        else:
            self.mode = -np.sign(need)
        return at

    def _extremes(self, found):
        """The largest speed and displacement of a smooth piece."""
        at = np.linspace(found.t[0], found.t[-1], 21)
        for row, name in ((0, "peak"), (1, "fastest")):
            sizes = np.abs(found.sol(at)[row])
            k = int(np.argmax(sizes))
            if sizes[k] > 0.98 * getattr(self, name):
                bounds = at[max(k - 1, 0)], at[min(k + 1, 20)]
                best = minimize_scalar(
                    lambda t, row=row: -abs(found.sol(t)[row]), bounds=bounds, method="bounded", options={"xatol": 1e-9}
                )
                sizes[k] = max(sizes[k], -best.fun)
            setattr(self, name, max(getattr(self, name), sizes[k]))
