"""A reference of the tests' own for masses with elastic sliders: exact linear modes from event to event.

Nothing of the package is used: every mode is ``z' = A z`` with ``z = (x, v, e, 1, cos wt, sin wt)``, followed by matrix
exponentials on a fine grid, in which each guard is a linear form of z and its falls are found by bisection.
"""

import dataclasses
from functools import partial

import numpy as np
from numpy.polynomial import polynomial
from scipy.linalg import expm
from scipy.optimize import brentq

STEP = 0.005
_TERMS = 14  # of a power series in one step
STICK, FORWARD, BACKWARD, OPEN = 0, 1, -1, 2


@dataclasses.dataclass
class SetUp:
    """Masses on springs and dampers; contacts with the base (velocity ``base[0] + base[1] cos wt``), of which those
    with a spring (`springs` > 0) are elastic, at most one is rigid; normal forces
    ``normal[0] + normal[1] sin wt + pressing . x``.
    """

    mass: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    directions: np.ndarray
    springs: np.ndarray
    normal: np.ndarray  # (2, contacts)
    kinetic: np.ndarray
    static: np.ndarray
    base: tuple[float, float]
    w: float
    pressing: np.ndarray


class ByModes:
    """The motion of a `SetUp` from `y0` (x, v, e)."""

    def __init__(self, of: SetUp, y0, e0=None):
        self.of, d, n = of, len(of.mass), len(of.springs)
        self.d, self.n, self.size = d, n, 2 * d + n + 3
        self.z = np.concatenate([y0, np.zeros(n) if e0 is None else e0, [1.0, 1.0, 0.0]])
        self.t, self.cached = 0.0, {}
        unit = np.eye(self.size)
        self.x, self.v, self.e = unit[:d], unit[d : 2 * d], unit[2 * d : 2 * d + n]
        self.one, self.cos, self.sin = unit[-3:]
        self.drive = np.zeros((self.size, self.size))
        self.drive[-2], self.drive[-1] = -of.w * self.sin, of.w * self.cos
        base = of.base[0] * self.one + of.base[1] * self.cos
        self.relative = of.directions @ self.v - base  # forms (contacts, size)
        self.forces = of.normal[0][:, None] * self.one + of.normal[1][:, None] * self.sin + of.pressing @ self.x
        self.growths = of.normal[1][:, None] * self.drive[-1] + of.pressing @ self.v  # rates of the normal forces
        self.sticks = []  # (contact, begin, end, duration known)
        self.began = np.full(n, np.nan)
        self.mode = np.array([self._first(i) for i in range(n)])
        self._settle(np.zeros(n, bool))
        self.began[self.mode == STICK] = 0.0

    def _first(self, i):
        if self.forces[i] @ self.z <= 0:
            return OPEN
        if self.of.springs[i] > 0:
            return STICK
        speed = self.relative[i] @ self.z
        return STICK if speed == 0 else int(np.sign(speed))

    def _rates(self, mode):
        """The matrix of ``z' = A z``, and the friction force of a rigid contact as a form."""
        of, a = self.of, self.drive.copy()
        pull = -of.stiffness @ self.x - of.damping @ self.v
        rigid = None
        for i in range(self.n):
            if of.springs[i] > 0:
                pull = pull - np.outer(of.directions[i], of.springs[i] * self.e[i])
            elif mode[i] in (FORWARD, BACKWARD):
                pull = pull - mode[i] * of.kinetic[i] * np.outer(of.directions[i], self.forces[i])
            else:
                rigid = i
        acceleration, held = pull / of.mass[:, None], None
        if rigid is not None:
            w = of.directions[rigid]
            wanted = of.base[1] * self.drive[-2]
            held = (w @ acceleration - wanted) / np.sum(w * w / of.mass)
            if mode[rigid] == STICK:
                acceleration = acceleration - np.outer(w / of.mass, held)
        a[: self.d], a[self.d : 2 * self.d] = self.v, acceleration
        for i in range(self.n):
            if of.springs[i] > 0:
                a[2 * self.d + i] = self._stretching(i, mode[i])
        return a, held

    def _stretching(self, i, mode):
        if mode == STICK:
            return self.relative[i]
        if mode == OPEN:
            return np.zeros(self.size)
        return mode * self.of.kinetic[i] / self.of.springs[i] * self.growths[i]

    def _guards(self, mode, held):
        """Forms that are positive while the mode lasts: (form, contact, what it becomes)."""
        of, guards = self.of, []
        for i in range(self.n):
            if of.normal[1][i] != 0 or np.any(of.pressing[i]):
                guards.append((self.forces[i] * (-1 if mode[i] == OPEN else 1), i, "touch"))
            if mode[i] == OPEN:
                continue
            if mode[i] == STICK:
                force = of.springs[i] * self.e[i] if of.springs[i] > 0 else held
                limit = of.static[i] * self.forces[i]
                guards += [(limit - force, i, FORWARD), (limit + force, i, BACKWARD)]
            else:
                guards.append((mode[i] * (self.relative[i] - self._slipping(i, mode[i])), i, STICK))
        return guards

    def _slipping(self, i, mode):
        return self._stretching(i, mode) if self.of.springs[i] > 0 else 0.0

    def _flow(self, h):
        """Exact step, of the usual length from the cache."""
        key = tuple(self.mode)
        if key not in self.cached:
            a, held = self._rates(self.mode)
            self.cached[key] = a, self._guards(self.mode, held), expm(STEP * a)
        a, guards, full = self.cached[key]
        return a, guards, full if h == STEP else expm(h * a)

    def run(self, t1):
        while self.t < t1:
            h = min(STEP, t1 - self.t)
            a, guards, step = self._flow(h)
            z, series = step @ self.z, [self.z]
            for k in range(1, _TERMS):
                series.append(a @ series[-1] / k)
            series = np.array(series)
            falls = [(self._fall(series, form, z, h), i, to) for form, i, to in guards]
            falls = [fall for fall in falls if fall[0] is not None]
            if not falls:
                self.t, self.z = self.t + h, z
                continue
            tau, i, to = min(falls, key=lambda fall: fall[0])
            self.t, self.z = self.t + tau, polynomial.polyval(tau, series)
            self._become(i, to)
        for i in np.flatnonzero(self.mode == STICK):
            self.sticks.append((i, self.began[i], t1))
        self.sticks.sort(key=lambda stick: (stick[0], stick[1]))
        return self

    def _fall(self, series, form, z, h):
        """When `form` falls through zero within the step; None if it does not."""
        of = series @ form
        at, slope = (partial(polynomial.polyval, c=c) for c in (of, polynomial.polyder(of)))
        size = np.abs(form) @ (np.abs(self.z) + np.abs(z)) * 1e-13
        s0, s1, d0, d1 = of[0], form @ z, of[1], slope(h)
        if abs(s0) <= size:  # it begins at zero
            if d0 <= 0:
                return 0.0 if d0 < 0 and s1 < -size else None
            top = 0.02 * h
        elif s0 < 0:
            return 0.0
        else:
            top = 0.0
        end = brentq(slope, top, h, xtol=1e-15) if s1 >= 0 and d0 < 0 < d1 else h
        return brentq(at, top, end, xtol=1e-16, rtol=1e-15) if at(end) < 0 < at(top) else None

    def _become(self, i, to):
        of, before = self.of, self.mode.copy()
        elastic = of.springs[i] > 0
        if to == "touch":
            closes = self.mode[i] == OPEN
            self.mode[i] = OPEN if not closes else self._closing(i)
            if elastic:
                self.z[2 * self.d + i] = 0.0
        elif to == STICK:
            self.mode[i] = STICK
            if not elastic:
                _, held = self._rates(self.mode)
                if abs(held @ self.z) > of.static[i] * (self.forces[i] @ self.z):
                    self.mode[i] = -before[i]
        else:
            self.mode[i] = to
            if elastic:
                self.z[2 * self.d + i] = to * of.kinetic[i] * (self.forces[i] @ self.z) / of.springs[i]
        self._settle(before == STICK)

    def _closing(self, i):
        """How a contact closes: a slider sticks unless its spring would outrun the limit."""
        speed, growth = self.relative[i] @ self.z, self.of.kinetic[i] * (self.growths[i] @ self.z)
        if self.of.springs[i] > 0 and abs(speed) * self.of.springs[i] <= growth:
            return STICK
        return int(np.sign(speed))

    def _settle(self, stuck):
        """What sticks is held exactly; sticks are written down."""
        of = self.of
        for i in range(self.n):
            if self.mode[i] == STICK and of.springs[i] == 0:
                _, held = self._rates(self.mode)
                if abs(held @ self.z) > of.static[i] * (self.forces[i] @ self.z):
                    self.mode[i] = int(np.sign(held @ self.z))
        for i in range(self.n):
            if self.mode[i] == STICK and not stuck[i]:
                self.began[i] = self.t
            elif self.mode[i] != STICK and stuck[i]:
                self.sticks.append((i, self.began[i], self.t))
