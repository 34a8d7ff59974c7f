"""A mass on pendulum surfaces in series under a recorded ground motion, from event to event with SciPy.

The surfaces are kept as they are: each has a displacement of its own, and the force in all of them is the same. Without
the package, and without the equivalent in parallel.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


class InSeries:
    """`radii` (m) and friction `coefficients` of the surfaces, `weight` N, `mass` kg; `own`: their displacements, m."""

    def __init__(self, mass, weight, radii, coefficients):
        self.mass, self.springs = mass, weight / np.asarray(radii)
        self.strengths = weight * np.asarray(coefficients)
        self.x = self.v = 0.0
        self.own, self.moving, self.way = np.zeros(len(radii)), np.zeros(len(radii), bool), 0
        self.sticks = [[0.0, np.nan]]

    def force(self, x):
        """In the surfaces while some are `moving`, N, by the displacement x of the mass."""
        on = self.moving
        held = np.sum(self.own[~on])
        given = np.sum(self.way * self.strengths[on] / self.springs[on])
        return (x - held + given) / np.sum(1 / self.springs[on])

    def run(self, times, ground):
        for i in range(len(times) - 1):
            slope = (ground[i + 1] - ground[i]) / (times[i + 1] - times[i])
            self._piece(times[i], times[i + 1], lambda t, i=i, slope=slope: ground[i] + slope * (t - times[i]))
        if self.way == 0:
            self.sticks[-1][1] = times[-1]
        return self

    def _piece(self, t, end, ground):
        while t < end:
            t = self._held(t, end, ground) if self.way == 0 else self._slides(t, end, ground)

    def _held(self, t, end, ground):
        first = (end, None, 0)
        for i, (spring, strength) in enumerate(zip(self.springs, self.strengths, strict=True)):
            for way in (1, -1):

                def beyond(s, spring=spring, strength=strength, way=way, i=i):
                    return way * (-self.mass * ground(s) - spring * self.own[i]) - strength

                if beyond(t) > 0:
                    first = min(first, (t, i, way), key=lambda one: one[0])
                elif beyond(end) > 0:
                    first = min(first, (brentq(beyond, t, end, xtol=1e-15), i, way), key=lambda one: one[0])
        at, surface, self.way = first
        if surface is not None:
            self.sticks[-1][1] = at
            self.moving = np.arange(len(self.own)) == surface
        return at

    def _slides(self, t, end, ground):
        def rates(s, y):
            return [y[1], -ground(s) - self.force(y[0]) / self.mass]

        def stops(s, y):
            return y[1] * self.way

        stops.terminal, stops.direction = True, -1
        events = [stops]
        others = np.flatnonzero(~self.moving)
        for i in others:

            def joins(s, y, i=i):
                return self.way * (self.force(y[0]) - self.springs[i] * self.own[i]) - self.strengths[i]

            joins.terminal, joins.direction = True, 1
            events.append(joins)
        found = solve_ivp(rates, (t, end), [self.x, self.v], events=events, method="DOP853", rtol=1e-12, atol=1e-15)
        self.x, self.v = found.y[:, -1]
        on, force = self.moving, self.force(self.x)
        self.own[on] = (force - self.way * self.strengths[on]) / self.springs[on]
        if found.status == 1:
            if len(found.t_events[0]):
                self._stop(found.t[-1], ground)
            else:
                excess = self.way * (force - self.springs * self.own) - self.strengths
                joined = [i for i in others if excess[i] > -1e-9 * self.strengths[i]]  # some at once
                self.moving = on | np.isin(np.arange(len(on)), joined)
        return found.t[-1]

    def _stop(self, t, ground):
        """At rest: what no surface can hold moves on the other way at once, the weakest surface first."""
        self.v, self.way = 0.0, 0
        needed = -self.mass * ground(t)
        for way in (1, -1):
            limits = way * self.springs * self.own + self.strengths
            if way * needed > np.min(limits):
                self.way, self.moving = way, limits == np.min(limits)
        if self.way == 0:
            self.sticks.append([t, np.nan])
