"""A mass on a soft spring, or on none, with 400 digits: what cancels by a division by the stiffness keeps enough.

Event by event on a base of piecewise-constant velocity, by the closed form of a damped oscillator. Between its events
the velocity must not turn more than once: the spring is so soft that no interval is as long as half a period.
"""

from typing import NamedTuple

from mpmath import mp, mpf

DIGITS = 400


class SoftStick(NamedTuple):
    """A stick: when it starts and ends, s, and where, m."""

    start: mpf
    end: mpf
    position: mpf


class SoftRun(NamedTuple):
    """All sticks, and the state at the end."""

    sticks: list[SoftStick]
    position: mpf
    velocity: mpf


class _Block(NamedTuple):
    mass: mpf
    stiffness: mpf
    damping: mpf
    held: mpf

    def slid(self, x: mpf, v: mpf, sign: int, t: mpf) -> tuple[mpf, mpf]:
        """The state after a slip of this sign."""
        beta, squared = self.damping / (2 * self.mass), self.stiffness / self.mass
        first = (-sign * self.held - self.stiffness * x) / self.mass
        if beta == 0 and squared == 0:
            return x + v * t + first * t * t / 2, v + first * t
        root = mp.sqrt(mp.mpc(beta * beta - squared))
        rates = squared / (beta + root), beta + root
        decays = [mp.exp(-rate * t) for rate in rates]
        sums = [t if rate == 0 else (1 - decay) / rate for rate, decay in zip(rates, decays, strict=True)]
        impulse = mp.re((decays[0] - decays[1]) / (2 * root))
        rate = mp.re((rates[1] * decays[1] - rates[0] * decays[0]) / (2 * root))
        return x + v * impulse + first * mp.re((sums[0] - sums[1]) / (2 * root)), v * rate + first * impulse

    def meeting(self, x: mpf, v: mpf, sign: int, base: mpf, longest: mpf) -> mpf | None:
        """When a slip of this sign ends by the velocity of the base, if within `longest`."""
        ahead = lambda t: sign * (self.slid(x, v, sign, t)[1] - base)  # noqa: E731
        if ahead(longest) > 0:
            return None
        low, high = mpf(0), longest
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (middle, high) if ahead(middle) > 0 else (low, middle)
        t = high
        for _ in range(7):
            position, speed = self.slid(x, v, sign, t)
            force = -sign * self.held - self.damping * speed - self.stiffness * position
            t -= (speed - base) * self.mass / force
        return t


def simulate_soft(
    mass: float, stiffness: float, damping: float, held: float, durations, velocities, x: float, v: float
) -> SoftRun:
    """The motion, numbers as floats or mpf; `held`: the friction force, N."""
    with mp.workdps(DIGITS):
        block = _Block(*map(mpf, (mass, stiffness, damping, held)))
        x, v, time, sticks = mpf(x), mpf(v), mpf(0), []
        for duration, base in zip(map(mpf, durations), map(mpf, velocities), strict=True):
            left, meets = duration, v == base
            while left > 0:
                needed = block.damping * base + block.stiffness * x
                if meets and abs(needed) <= block.held:
                    rate = block.stiffness * base
                    lasts = left if rate == 0 else min(left, ((1 if rate > 0 else -1) * block.held - needed) / rate)
                    sticks.append(SoftStick(time, time + lasts, x))
                    x, v, sign = x + base * lasts, base, -1 if rate > 0 else 1
                else:
                    sign = (-1 if needed > 0 else 1) if meets else (1 if v > base else -1)
                    found = block.meeting(x, v, sign, base, left)
                    lasts, meets = (left, False) if found is None else (found, True)
                    x, v = block.slid(x, v, sign, lasts)
                    v = base if meets else v
                    time, left = time + lasts, left - lasts
                    continue
                time, left, meets = time + lasts, left - lasts, False
                if left > 0:  # released: it slips to the end of the interval
                    x, v = block.slid(x, v, sign, left)
                    time, left = time + left, mpf(0)
        return SoftRun(sticks, x, v)
