"""A reference of the tests' own for masses whose friction weakens with the slip: exact modes from event to event.

Nothing of the package is used. Each mass of a chain rubs on the base alone. With the slip distances s as numbers of the
state every mode is ``z' = A z`` with ``z = (x, v, s, 1, cos wt, sin wt)``: in a slip that weakens the friction force is
``sign normal (static - (static - dynamic) s / distance)``, linear in z, a spring of negative stiffness; in a stick
``s' = -s / healing``. Steps are matrix exponentials on a fine grid; in each, guards are polynomials whose falls are
found by bisection.
"""

import dataclasses

import numpy as np
from numpy.polynomial import polynomial
from scipy.linalg import expm
from scipy.optimize import brentq

STEP = 0.004
_TERMS, _INSIDE = 16, 9  # of a power series in one step; points at which guards are looked at
_JUST = 1e-6  # s: a guard that is zero when its mode begins is not looked at so soon


@dataclasses.dataclass
class SetUp:
    """Masses on springs and dampers, each on a base of the velocity ``base[0] + base[1] cos wt``; all (masses,)."""

    mass: np.ndarray
    stiffness: np.ndarray  # a matrix
    damping: np.ndarray  # a matrix
    normal: np.ndarray
    static: np.ndarray
    dynamic: np.ndarray
    distance: np.ndarray
    healing: np.ndarray  # infinite rate (zero time): at once
    base: tuple[float, float]
    w: float


class ByModes:
    """The motion of a `SetUp` from `y0` (x, v), which must slip everywhere."""

    def __init__(self, of, y0):
        self.of, d = of, len(of.mass)
        self.d, unit = d, np.eye(3 * d + 3)
        self.x, self.v, self.s = unit[:d], unit[d : 2 * d], unit[2 * d : 3 * d]
        self.one, self.cos, self.sin = unit[-3:]
        self.z, self.t = np.concatenate([y0, np.zeros(d), [1.0, 1.0, 0.0]]), 0.0
        self.drive = np.zeros_like(unit)
        self.drive[-2], self.drive[-1] = -of.w * self.sin, of.w * self.cos
        self.relative = self.v - (of.base[0] * self.one + of.base[1] * self.cos)
        pull = -of.stiffness @ self.x - of.damping @ self.v
        self.needed = pull - of.mass[:, None] * of.base[1] * self.drive[-2]  # of sticks
        self.pull, self.slope = pull, (of.static - of.dynamic) / of.distance
        self.strength = of.normal[:, None] * (of.static[:, None] * self.one - self.slope[:, None] * self.s)
        self.sign = np.sign(self.relative @ self.z).astype(int)
        self.weak, self.since = np.zeros(d, bool), np.zeros(d)
        self.sticks, self.began, self.cached = [], np.full(d, np.nan), {}

    def _mode(self):
        key = (*self.sign, *self.weak)
        if key not in self.cached:
            of, d, a = self.of, self.d, self.drive.copy()
            a[:d], guards = self.v, []
            for i, (sign, weak) in enumerate(zip(self.sign, self.weak, strict=True)):
                if sign == 0:
                    a[d + i] = of.base[1] * self.drive[-2]
                    a[2 * d + i] = -self.s[i] / of.healing[i] if of.healing[i] else 0
                    limit = self.strength[i]
                    guards += [(limit - self.needed[i], i, 1), (limit + self.needed[i], i, -1)]
                    continue
                force = of.normal[i] * of.dynamic[i] * self.one if weak else self.strength[i]
                a[d + i] = (self.pull[i] - sign * force) / of.mass[i]
                a[2 * d + i] = sign * self.relative[i]
                guards.append((sign * self.relative[i], i, 0))
                if not weak:
                    guards.append((of.distance[i] * self.one - self.s[i], i, 2))
            self.cached[key] = a, guards, expm(STEP * a)
        return self.cached[key]

    def run(self, t1):
        while self.t < t1:
            h, (a, guards, step) = min(STEP, t1 - self.t), self._mode()
            series = [self.z]
            for k in range(1, _TERMS):
                series.append(a @ series[-1] / k)
            series = np.array(series)
            falls = [(self._fall(series @ form, h, self.t - self.since[i]), i, to) for form, i, to in guards]
            falls = [fall for fall in falls if fall[0] is not None]
            if falls:
                tau, i, to = min(falls, key=lambda fall: fall[0])
                self.t, self.z = self.t + tau, polynomial.polyval(tau, series)
                self._become(i, to)
            else:
                self.t, self.z = self.t + h, step @ self.z if h == STEP else expm(h * a) @ self.z
        for i in np.flatnonzero(self.sign == 0):
            self.sticks.append((i, self.began[i], t1))
        self.sticks.sort(key=lambda stick: (stick[0], stick[1]))
        return self

    @staticmethod
    def _fall(terms, h, age):
        """When the guard of these `terms` falls through zero within the step; None if it does not."""
        times = np.linspace(0, h, _INSIDE)
        times[0] = min(max(_JUST - age, 0), h / 100)
        values = polynomial.polyval(times, terms)
        below = np.flatnonzero((values[1:] <= 0) & (values[:-1] > 0))
        if not len(below):
            return None
        first = below[0]
        return brentq(polynomial.polyval, times[first], times[first + 1], args=(terms,), xtol=1e-16, rtol=1e-15)

    def _become(self, i, to):
        of, place = self.of, 2 * self.d + i
        if to == 2:
            self.weak[i] = True
            return
        self.since[i] = self.t
        if self.sign[i] == 0:
            self.sticks.append((i, self.began[i], self.t))
            self.sign[i], self.weak[i] = to, False
            return
        rested = min(self.z[place], of.distance[i]) if of.healing[i] else 0.0
        needed = self.needed[i] @ self.z
        if abs(needed) > of.normal[i] * (of.static[i] - self.slope[i] * rested):
            self.sign[i] = -self.sign[i]
            return
        self.z[place], self.sign[i], self.began[i] = rested, 0, self.t
