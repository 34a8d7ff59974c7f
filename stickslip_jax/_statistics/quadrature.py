"""Transitions by quadrature: the next stick in closed form, at points of a Sobol' sequence for random numbers."""

import math
from typing import Any, Literal, TypeAlias, cast

import numpy as np
from jax import Array
from jaxtyping import Float
from scipy import stats

from .._excitation.motion import RandomPhase
from .._excitation.piecewise_constant import PoissonSwitching, RandomSteps
from .._foundation import checks
from .._foundation.types import Ending
from .._systems.system import System

Columns: TypeAlias = dict[str, Float[np.ndarray, " transitions"]]
"""Numbers of sticks by name, each (transitions,)."""

After: TypeAlias = Literal["stick", "slip"]
FOLLOWING: dict[str, tuple[str, ...]] = {
    "stick": ("slip_before", "position", "duration", "end_position", "ending"),
    "slip": ("duration", "end_position", "ending", "slip_duration", "position"),
}
"""What follows the end of a stick, or of a slip, in order of time."""

_DIMENSIONS = 24  # of the sequence: later draws, of few motions, are random
_TIED = 1e-12  # on a lattice of instants, what comes at once or to an edge does so but for so much round-off
_ALL_BY, _MOST_JUMPS = 200, 10_000  # of the base in a slip: after which none, or not every motion, has stuck again


def period_of(law: Any) -> float | None:
    """The period of a law on which what comes depends by its phase, s: one number, or None."""
    law = law.signal if isinstance(law, RandomPhase) else law
    if not _is_number(getattr(law, "angular_frequency", 0.0)):
        return None
    found = law.interval if isinstance(law, RandomSteps) else getattr(law, "repeats_after", None)
    return float(cast(Any, found)) if _is_number(found) else None


def levels_of(law: Any) -> np.ndarray | None:
    """The velocities that a base can have, m/s, of laws of few; None of others, and where the speed is uncertain."""
    if not (isinstance(law, (PoissonSwitching, RandomSteps)) and _is_number(law.speed)):
        return None
    return float(law.speed) * np.array(law.levels if isinstance(law, RandomSteps) else (-1.0, 1.0))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.generic, np.ndarray, Array)) and np.ndim(value) == 0


class _Walk:
    """Motions of a mass on a spring, with Coulomb friction and no damping, on a base of few velocities, (motions,).

    `x`, `v`: position and velocity of the mass, m and m/s. `level`: the number of the base velocity, of `levels`.
    `phase`: time since the last instant at which the base could jump, s (0 of a base without memory).
    """

    def __init__(self, system: Any, law: PoissonSwitching | RandomSteps, motions: int):
        self.omega = math.sqrt(float(system.stiffness) / float(system.mass))
        self.edge = float(system.friction.static) * float(system.normal_force) / float(system.stiffness)
        self.law, self.levels = law, cast(np.ndarray, levels_of(law))
        shares = np.array(law.level_probabilities) if isinstance(law, RandomSteps) else np.array([0.5, 0.5])
        others = np.where(np.eye(len(shares), dtype=bool), 0, shares) / (1 - shares)[:, None]
        self.shares, self.up_to = shares, np.cumsum(others, axis=1)
        by: Any = {"seed": 0}  # "rng" since SciPy 1.15, which knows both
        whole = stats.qmc.Sobol(_DIMENSIONS, **by).random_base2((motions - 1).bit_length())
        self.sequence, self.used = whole[:motions], 0
        self.rest = np.random.default_rng(0)

    def uniform(self, which: np.ndarray) -> np.ndarray:
        """The next number of each motion in (0, 1): of the sequence, and then random ones."""
        if self.used == _DIMENSIONS:
            return self.rest.random(len(which))
        self.used += 1
        return np.clip(self.sequence[which, self.used - 1], 1e-16, 1 - 1e-16)

    def until_jump(self, which: np.ndarray, level: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """The time until the base jumps, s."""
        drawn = np.log(self.uniform(which))
        if isinstance(self.law, PoissonSwitching):
            return -drawn / float(self.law.rate)
        step = float(self.law.interval)
        return step - phase + step * np.floor(drawn / np.log(self.shares[level]))

    def jumped(self, which: np.ndarray, level: np.ndarray) -> np.ndarray:
        """The number of the velocity after a jump."""
        return np.sum(self.uniform(which)[:, None] > self.up_to[level], axis=1).clip(max=len(self.levels) - 1)

    def passed(self, phase: np.ndarray, time: np.ndarray) -> np.ndarray:
        """The phase so much later, s; where the base could have jumped just then, it has not."""
        if not isinstance(self.law, RandomSteps):
            return phase
        interval = float(self.law.interval)
        later = (phase + time) % interval
        return np.where(interval - later <= self.instant(time), 0.0, later)

    def slip(self, x: np.ndarray, level: np.ndarray, released: np.ndarray, phase: np.ndarray) -> tuple:
        """From the end of a stick to the next: how long the slip takes, where it ends, level and phase of the base."""
        every = np.arange(len(x))
        v, level, time = self.levels[level], level.copy(), np.zeros(len(x))
        ended = every[~released]
        level[ended] = self.jumped(ended, level[ended])
        x, phase, slipping, jumps = x.copy(), phase.copy(), every, 0
        while len(slipping):
            if jumps == _MOST_JUMPS or (jumps == _ALL_BY and len(slipping) == len(x)):
                raise ValueError(
                    f"Argument law must let the mass stick again, but after {jumps} jumps of the base {len(slipping)} "
                    f"of {len(x)} slips go on: the base is too fast for the friction, or the friction is zero."
                )
            jumps += 1
            own = level[slipping]
            until = self.until_jump(slipping, own, phase[slipping])
            met, x[slipping], v[slipping] = self.arcs(x[slipping], v[slipping], self.levels[own], until)
            passed = np.minimum(met, until)
            time[slipping] += passed
            phase[slipping] = self.passed(phase[slipping], passed)
            slipping = slipping[met > until]
            phase[slipping] = 0.0
            level[slipping] = self.jumped(slipping, level[slipping])
        return time, x, level, phase

    def arcs(self, x: np.ndarray, v: np.ndarray, base: np.ndarray, until: np.ndarray) -> tuple:
        """When the mass sticks (s; infinity: not `until` then), and its position and velocity at the earlier of both.

        Friction pulls the mass towards the base velocity: it moves on circles in the plane of ``x`` and ``v / omega``
        about ``side * edge``, with its side positive while it is slower than the base. On the circle of radius rho that
        it enters at the angle phi the velocity is ``omega rho cos(theta + phi)``, which meets the base velocity at
        ``theta + phi = -side arccos(base / (omega rho))``. There it sticks if ``|x| <= edge``, and else goes on with
        the other side.
        """
        x, v, beta, passed = x.copy(), v / self.omega, base / self.omega, np.zeros(len(x))
        side = np.where(v == beta, np.sign(x), np.sign(beta - v))
        tied = self.edge * _TIED
        met = np.where((np.abs(v - beta) <= tied) & self.holds(x, base), 0.0, np.inf)
        moving = np.flatnonzero(met)
        while len(moving):
            s, b, left = side[moving], beta[moving], until[moving] - passed[moving]
            about = x[moving] - s * self.edge
            rho, phi = np.hypot(about, v[moving]), np.arctan2(about, v[moving])
            height = rho**2 - b**2
            meets = height > 1e-9 * rho**2  # one that was released here touches the base velocity only
            angle = (-s * np.arccos(np.clip(b / np.maximum(rho, tied), -1, 1)) - phi) % (2 * np.pi)
            turned = np.where(meets, angle / self.omega, np.inf)
            is_met = turned < left - self.instant(until[moving])  # a stick of no length is none
            theta = self.omega * np.where(is_met, turned, left) + phi
            x[moving] = s * self.edge + np.where(is_met, -s * np.sqrt(np.maximum(height, 0)), rho * np.sin(theta))
            v[moving] = np.where(is_met, b, rho * np.cos(theta))
            passed[moving] += np.where(is_met, turned, left)
            stuck = is_met & self.holds(x[moving], base[moving])
            met[moving[stuck]] = passed[moving[stuck]]
            moving = moving[is_met & ~stuck]
            side[moving] = np.sign(x[moving])  # of what the spring pulls through
        return met, x, v * self.omega

    def holds(self, x: np.ndarray, base: np.ndarray) -> np.ndarray:
        """Whether friction holds the mass on the base: not on an edge to which the base carries it."""
        tied = self.edge * _TIED
        return np.abs(x) <= np.where(base * x > 0, self.edge - tied, self.edge + tied)

    def instant(self, time: np.ndarray) -> np.ndarray:
        """What is shorter is round-off of so long a time, s."""
        return _TIED * (time + 1 / self.omega)

    def stick(self, x: np.ndarray, level: np.ndarray, phase: np.ndarray) -> tuple:
        """From the begin of a stick: how long it lasts, where it ends, if by a release, and the phase of the base."""
        speed = self.levels[level]
        with np.errstate(divide="ignore"):
            release = np.where(speed == 0, np.inf, (self.edge - np.sign(speed) * x) / np.abs(speed))
        jump = self.until_jump(np.arange(len(x)), level, phase)
        duration, released = np.minimum(release, jump), release < jump - self.instant(jump)
        end = np.where(released, np.sign(speed) * self.edge, x + speed * duration)
        return duration, end, released, np.where(released, self.passed(phase, duration), 0.0)


def by_quadrature(system: System, law: object, after: After, points: int) -> tuple[Columns, Columns, Columns]:
    """The states, what follows, and the next states: of each way in which a stick can end, or begin, so many `points`.

    Raises:
        ValueError: For systems and laws without closed forms, or with uncertain numbers.
    """
    known, drawn, is_certain = cast(Any, system), cast(Any, law), False
    if system.traits.has_interval_form and levels_of(law) is not None:
        clock = drawn.interval if isinstance(law, RandomSteps) else drawn.rate
        numbers = known.mass, known.stiffness, known.normal_force, known.friction.static, clock
        is_certain = all(map(_is_number, numbers)) and known.stiffness > 0
    if not is_certain:
        raise ValueError(
            "Arguments source and law must be a MassSpring with a spring, without damping, force and static friction, "
            "all its numbers certain, and a base "
            f"PoissonSwitching or RandomSteps, but {checks.show(system)} and {checks.show(law)} were given: kernels of "
            'others come from their sticks, transition_kernel(simulate_ensemble(..., keep="sticks")).'
        )
    law = cast("PoissonSwitching | RandomSteps", law)
    speeds = cast(np.ndarray, levels_of(law))
    ways = [(level, False) for level in range(len(speeds))]
    if after == "stick":  # a base at rest releases nothing
        ways += [(level, True) for level, speed in enumerate(speeds) if speed]
    points = 1 << (points - 1).bit_length()  # as many as Sobol' sequences are balanced with
    walk = _Walk(system, law, len(ways) * points)
    level, released = (np.repeat(column, points) for column in np.array(ways).T)
    released, every = released.astype(bool), np.arange(len(level))
    x = walk.edge * np.where(released, np.sign(walk.levels[level]), 2 * walk.uniform(every) - 1)
    has_phase = released if after == "stick" else np.ones(len(x), bool)
    phase = np.where(has_phase, walk.uniform(every) * float(getattr(law, "interval", 0.0)), 0.0)

    def state(x: np.ndarray, level: np.ndarray, released: np.ndarray, phase: np.ndarray) -> Columns:
        name = "end_position" if after == "stick" else "position"
        ending = np.where(released, float(Ending.RELEASED), float(Ending.BASE_SWITCHED))
        clock = {"phase": phase} if isinstance(law, RandomSteps) else {}
        return {name: x, "base_velocity": walk.levels[level], "ending": ending} | clock

    begin, of = state(x, level, released, phase), {}
    if after == "stick":
        of["slip_before"], of["position"], level, phase = walk.slip(x, level, released, phase)
        of["duration"], of["end_position"], released, phase = walk.stick(of["position"], level, phase)
        later = state(of["end_position"], level, released, phase)
    else:
        of["duration"], of["end_position"], released, phase = walk.stick(x, level, phase)
        of["slip_duration"], of["position"], next_level, phase = walk.slip(of["end_position"], level, released, phase)
        later = state(of["position"], next_level, released, phase)
    of["ending"] = np.where(released, float(Ending.RELEASED), float(Ending.BASE_SWITCHED))
    return begin, {name: of[name] for name in FOLLOWING[after]}, later
