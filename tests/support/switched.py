"""What the tests of the switched engine share: set-ups for the package and for the reference, and their comparison."""

import math
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from reference.event_driven import Run, simulate_mass_spring

import stickslip_jax as ss
from support.interval import filled, padded

# Turns of the loop, intervals of every base that jumps, points of every record: the same everywhere, to compile once.
STEPS, SLOTS, POINTS = 2048, 24, 24


class Tones(NamedTuple):
    """``offset + sum_j amplitudes[j] cos(frequencies[j] t + phases[j])``."""

    amplitudes: tuple[float, ...]
    frequencies: tuple[float, ...]
    phases: tuple[float, ...]
    offset: float = 0.0
    breaks = ()

    @property
    def each(self):
        return zip(self.amplitudes, self.frequencies, self.phases, strict=True)

    def value(self, t: float, _=None) -> float:
        return self.offset + sum(a * math.cos(w * t + phase) for a, w, phase in self.each)

    def rate(self, t: float, _=None) -> float:
        return -sum(a * w * math.sin(w * t + phase) for a, w, phase in self.each)

    @property
    def package(self) -> ss.Signal:
        if len(self.amplitudes) > 1:
            return ss.SumOfHarmonics(*map(jnp.asarray, self[:3]), self.offset)
        return ss.Harmonic(self.amplitudes[0], self.frequencies[0], self.phases[0], self.offset)


class Line(NamedTuple):
    """`values` at `times`, joined by straight lines; `middle` is a time inside the segment that is meant."""

    times: tuple[float, ...]
    values: tuple[float, ...]
    frequencies = ()

    @property
    def breaks(self) -> tuple[float, ...]:
        return self.times[1:-1]

    def rate(self, _, middle: float) -> float:
        i = int(np.searchsorted(self.times, middle)) - 1
        return (self.values[i + 1] - self.values[i]) / (self.times[i + 1] - self.times[i])

    def value(self, t: float, middle: float) -> float:
        i = int(np.searchsorted(self.times, middle)) - 1
        return self.values[i] + self.rate(t, middle) * (t - self.times[i])

    @property
    def package(self) -> ss.Recorded:
        return ss.Recorded(jnp.asarray(self.times), jnp.asarray(self.values))


class Shaking(Line):
    """A `Line` that is the acceleration of the ground, on which the base rests."""

    def value(self, *_) -> float:
        return 0.0

    def rate(self, *_) -> float:
        return 0.0

    def acceleration(self, t: float, middle: float) -> float:
        return Line(*self).value(t, middle)

    @property
    def package(self) -> ss.GroundAcceleration:
        return ss.GroundAcceleration(jnp.asarray(self.times), jnp.asarray(self.values))


class Steps(NamedTuple):
    """``velocities[i]`` for ``durations[i]``, at most `SLOTS` of them."""

    durations: tuple[float, ...]
    velocities: tuple[float, ...]
    frequencies = ()

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(np.cumsum(self.durations)[:-1].tolist())

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.breaks

    def value(self, _, middle: float) -> float:
        return self.velocities[int(np.searchsorted(self.breaks, middle))]

    def rate(self, *_) -> float:
        return 0.0

    @property
    def package(self) -> ss.VelocitySteps:
        return padded(self.durations, self.velocities, SLOTS)


class Jumping(NamedTuple):
    """A continuous motion and jumps, added."""

    motion: Any
    steps: Steps

    @property
    def frequencies(self) -> tuple[float, ...]:
        return self.motion.frequencies

    @property
    def breaks(self) -> tuple[float, ...]:
        return (*self.motion.breaks, *self.steps.breaks)

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.steps.breaks

    def value(self, t: float, middle: float) -> float:
        return self.motion.value(t, middle) + self.steps.value(t, middle)

    def rate(self, t: float, middle: float) -> float:
        return self.motion.rate(t, middle)

    @property
    def package(self) -> ss.WithJumps:
        return ss.WithJumps(self.motion.package, self.steps.package)


class Rub(NamedTuple):
    """A friction law: the package's, and ``mu(|v_rel|)`` in plain numbers."""

    law: ss.FrictionLaw
    kinetic: Any


class Hump(eqx.Module):
    """A friction curve that first falls and then rises: ``low + fall exp(-s / scale) + rise s``."""

    low: Any
    fall: Any
    scale: Any
    rise: Any

    def __call__(self, speed):
        return self.low + self.fall * jnp.exp(-speed / self.scale) + self.rise * speed


def coulomb(mu: float, mu_static: float | None = None) -> Rub:
    return Rub(ss.Coulomb(mu, mu_static), lambda _: mu)


def weakening(mu_static: float, factor: float) -> Rub:
    return Rub(ss.VelocityWeakening(mu_static, factor), lambda s: mu_static / (1 + factor * s))


def stribeck(mu: float, mu_static: float, speed: float, viscous: float) -> Rub:
    law = ss.Stribeck(mu, mu_static, speed, exponent=2.0, viscous=viscous)
    return Rub(law, lambda s: mu + (mu_static - mu) * math.exp(-((s / speed) ** 2)) + viscous * s)


def hump(low: float, fall: float, scale: float, rise: float, mu_static: float) -> Rub:
    law = ss.FrictionCurve(Hump(low, fall, scale, rise), mu_static)
    return Rub(law, lambda s: low + fall * math.exp(-s / scale) + rise * s)


class Case(NamedTuple):
    """A system, its excitation and its initial state, for the package and for the reference."""

    mass: float
    stiffness: float
    normal_force: float
    rub: Rub
    base: Any
    t1: float
    y0: tuple[float, float]
    damping: float | None = None
    force: Any = None

    @property
    def omega(self) -> float:
        return math.sqrt(self.stiffness / self.mass)

    @property
    def half_width(self) -> float:
        return float(self.rub.law.static) * self.normal_force / self.stiffness

    @property
    def system(self) -> ss.MassSpring:
        force = None if self.force is None else self.force.package
        return ss.MassSpring(self.mass, self.stiffness, self.normal_force, self.rub.law, self.damping, force)

    @property
    def breaks(self) -> list[float]:
        parts = [part.breaks for part in (self.base, self.force) if part is not None]
        return sorted({t for breaks in parts for t in breaks if 0 < t < self.t1})

    def push(self, t: float, middle: float) -> float:
        """The force on the mass; that of a shaking ground is ``-mass * acceleration``."""
        load = 0.0 if self.force is None else self.force.value(t, middle)
        return load - self.mass * self.base.acceleration(t, middle) if isinstance(self.base, Shaking) else load

    def follow(self, **method) -> "Followed":
        """Simulate by the package, in time steps: by default those that the package itself takes for closed forms."""
        method = {"step": self.shortest_time / 16} | method
        return follow(self.system, self.base.package, self.t1, self.y0, **method)

    def reference(self, **options) -> Run:
        """Simulate by the reference, whose steps resolve every harmonic."""
        middles = [(a + b) / 2 for a, b in pairwise([0.0, *self.breaks, self.t1])]
        fastest = max(2 * math.pi / self.shortest_time, (self.damping or 0) / self.mass)
        functions = {"base_velocity": self.base.value, "base_acceleration": self.base.rate, "force": self.push}
        numbers = {name: getattr(self, name) for name in ("mass", "stiffness", "normal_force", "t1", "y0", "breaks")}
        numbers |= {"damping": self.damping or 0.0, "mu_static": float(self.rub.law.static)}
        of_time = {name: lambda t, i, f=function: f(t, middles[i]) for name, function in functions.items()}
        options = {"max_step": 0.25 / fastest} | options
        return simulate_mass_spring(**numbers, **of_time, mu_kinetic=self.rub.kinetic, **options)

    @property
    def shortest_time(self) -> float:
        """The shortest of all periods, s."""
        frequencies = self.base.frequencies + (() if self.force is None else self.force.frequencies)
        return 2 * math.pi / max(self.omega, *frequencies, 0.0)


class Followed(NamedTuple):
    """A simulation, and states along it: (position, velocity, velocity relative to the base).

    States are those at the start of each time step (`begun`), half-way to the next, and at both ends of every stick.
    """

    simulation: ss.Simulation
    begun: Any
    begin: tuple[Any, Any, Any]
    middle: tuple[Any, Any, Any]
    start: tuple[Any, Any, Any]
    end: tuple[Any, Any, Any]


@partial(jax.jit, static_argnames="steps")
def follow(system, base, t1, y0, *, step, solver=None, steps=STEPS) -> Followed:
    """Simulate in time steps; compiled once for every kind of set-up."""
    method = ss.Exact(step=step, max_steps=steps, solver=solver)
    one = ss.simulate(system, base, t1=t1, y0=y0, method=method)
    begun = one.step_starts
    middles = (begun + jnp.append(begun[1:], t1)) / 2
    times = (begun, middles, one.sticks.start, one.sticks.end)
    states = states_at(one, jnp.concatenate(times))
    ends = np.cumsum([t.shape[0] for t in times])[:-1]
    return Followed(one, begun, *zip(*(jnp.split(values, ends) for values in states), strict=True))


def states_at(one: ss.Simulation, times) -> tuple[Any, Any, Any]:
    """Position, velocity, and velocity relative to the base."""
    x, velocity = one.evaluate(times)
    return x, velocity, velocity - one.base_velocity(times)


def crossings_of(case: Case, followed: Followed) -> tuple[np.ndarray, np.ndarray]:
    """When the relative velocity passes through zero without a stick, and the positions there.

    Within a time step its sign is constant; where it changes from one step to the next without a stick, without a jump
    of the base velocity, there is a crossing.
    """
    begun, t1 = np.asarray(followed.begun), float(followed.simulation.time_reached)
    lasting = np.diff(np.append(begun, t1)) > 1e-14 * t1
    times, signs = begun[lasting], np.sign(np.asarray(followed.middle[2]))[lasting]
    changes = np.flatnonzero(signs[1:] * signs[:-1] < 0) + 1
    at, sticks = times[changes, None], filled(followed.simulation)
    jumps = np.asarray(case.base.jumps if hasattr(case.base, "jumps") else [])
    inside = np.any((sticks.start <= at) & (at <= sticks.end), axis=1)
    changes = changes[~inside & ~np.any(np.abs(at - jumps) <= 1e-12 * t1, axis=1)]
    return times[changes], np.asarray(followed.begin[0])[lasting][changes]


class Errors(NamedTuple):
    """Worst relative deviations from the reference; for their scales see `errors_against`."""

    event_time: float
    event_state: float
    end_state: float


def errors_against(run: Run, case: Case, followed: Followed) -> Errors:
    """Assert that both have the same sticks, endings and crossings, and measure how far apart they are.

    Times are measured against ``max(t, 1 / omega)``; states against the size of the motion: the largest of half-width
    and of all positions and (velocities / omega) that are compared.
    """
    one = followed.simulation
    assert int(one.status) == ss.Status.FINISHED
    mask, found = np.asarray(one.sticks.mask), filled(one)
    assert [ss.Ending(code).name for code in found.ending] == [stick.ending for stick in run.sticks]
    crossed, where = crossings_of(case, followed)
    assert len(crossed) == len(run.crossings), (crossed, run.crossings)

    sticks = np.array([stick[:3] for stick in run.sticks]).reshape(-1, 3)
    times = np.concatenate([found.start, found.end, crossed])
    exact_times = np.concatenate([sticks[:, 0], sticks[:, 1], run.crossings])
    later = [run.state_at(t)[0] for t in [*sticks[:, 1], *run.crossings]]
    places = [np.asarray(states[0])[mask] for states in (followed.start, followed.end)]
    positions = np.concatenate([found.position, *places, where])
    exact_positions = np.concatenate([sticks[:, 2], sticks[:, 2], later])
    final = np.array([float(value) for value in one.final_state]) * [1, 1 / case.omega]
    exact_final = run.final_state * [1, 1 / case.omega]
    size = max(case.half_width, np.max(np.abs(exact_positions), initial=0), np.max(np.abs(exact_final)))
    clock = np.maximum(exact_times, 1 / case.omega)
    pairs = ((times, exact_times, clock), (positions, exact_positions, size), (final, exact_final, size))
    return Errors(*(float(np.max(np.abs(got - exact) / scale, initial=0)) for got, exact, scale in pairs))


KINDS = {  # of random set-ups: friction law, base motion, force, and whether there is damping
    "harmonic": ("static", "tone", "tone", True),
    "undamped": ("plain", "tone", "tone", False),
    "sums": ("static", "tones", "tones", True),
    "record": ("static", "line", "line", False),
    "jumps": ("plain", "tone and steps", "", True),
    "ground": ("plain", "shaking", "", True),
    "weakening": ("weakening", "tone", "tone", True),
    "stribeck": ("stribeck", "line", "", False),
    "hump": ("hump", "tone and steps", "line", True),
    "steps": ("static", "steps", "tone", False),
    "record and jumps": ("plain", "line and steps", "line", True),
}
SOLVED = ("weakening", "stribeck", "hump")  # whose slips have no closed form


def random_case(kind: str, seed: int) -> Case:
    source = np.random.default_rng([seed, *kind.encode()])  # base speeds of 0.2 to 4, forces up to 2 of own scales
    mass, stiffness, normal_force, mu = np.exp(source.uniform(-1, 1, 4)).tolist()
    omega, a = math.sqrt(stiffness / mass), mu * normal_force / stiffness
    speed, push = a * omega * math.exp(source.uniform(-1.6, 1.4)), mu * normal_force * source.uniform(0.1, 2)
    t1 = 2 * math.pi / omega * source.uniform(6, 9)
    draw, (law, base, force, damped) = _Draw(source, omega, t1), KINDS[kind]
    start = (float(a * source.uniform(-3, 3)), float(speed * source.uniform(-1.5, 1.5)))
    damping = 2 * math.sqrt(mass * stiffness) * source.uniform(0.01, 0.3) if damped else None
    rub, motion = draw.rub(law, mu, speed), draw.part(base, 4 * push / mass if base == "shaking" else speed)
    return Case(mass, stiffness, normal_force, rub, motion, t1, start, damping, draw.part(force, push, of_force=True))


class _Draw(NamedTuple):
    """Random friction laws and motions on ``[0, t1]`` for a system of the angular frequency `omega`."""

    source: np.random.Generator
    omega: float
    t1: float

    def rub(self, law: str, mu: float, speed: float) -> Rub:
        mu_static, share = mu * self.source.uniform(1.01, 1.6), self.source.uniform(0.3, 1)
        make = {
            "plain": lambda: coulomb(mu),
            "static": lambda: coulomb(mu, mu_static),
            "weakening": lambda: weakening(mu, 2 * share / speed),
            "stribeck": lambda: stribeck(mu, mu_static, share * speed, 0.2 * mu / speed),
            "hump": lambda: hump(0.6 * mu, 0.4 * mu, share * speed, 0.2 * mu / speed, mu_static),
        }
        return make[law]()

    def part(self, name: str, size: float, of_force: bool = False) -> Any:
        make = {
            "": lambda: None,
            "tone": lambda: self.tones(size, 1),
            "tones": lambda: self.tones(size, 2 if of_force else 3),
            "line": lambda: Line(*self.line(2 * size)),
            "shaking": lambda: Shaking(*self.line(size)),
            "steps": lambda: self.steps(size),
            "tone and steps": lambda: Jumping(self.tones(size / 2, 1), self.steps(size)),
            "line and steps": lambda: Jumping(Line(*self.line(size)), self.steps(size)),
        }
        return make[name]()

    def tones(self, size: float, count: int) -> Tones:
        share, phases = self.source.dirichlet(np.ones(count)), self.source.uniform(0, 2 * math.pi, count)
        frequencies = self.omega * np.exp(self.source.uniform(-1.5, 0.9, count))
        columns = (tuple(values.tolist()) for values in (size * share, frequencies, phases))
        return Tones(*columns, offset=float(size * self.source.uniform(-0.8, 0.8)))

    def line(self, size: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        gaps = self.source.uniform(0.2, 1, POINTS - 1)
        times = np.concatenate([[0], np.cumsum(gaps)]) * (1.05 * self.t1 / gaps.sum())
        return tuple(times.tolist()), tuple((size * self.source.uniform(-1, 1, POINTS)).tolist())

    def steps(self, size: float) -> Steps:
        gaps = self.source.exponential(1, SLOTS) + 0.02
        signs = np.resize([1, -1], SLOTS) * self.source.uniform(0.3, 1, SLOTS)
        return Steps(tuple((gaps * (1.05 * self.t1 / gaps.sum())).tolist()), tuple((size * signs).tolist()))
