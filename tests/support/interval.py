"""What several test files share: set-ups that both the package and the reference can run, and their comparison."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from mpmath import mp, mpf
from reference.event_by_event import ReferenceRun, ReferenceSegment, simulate_reference, trace_reference

import stickslip_jax as ss

GRID = 2.0**-24
"""Durations that are multiples of this add up without round-off, so both sides get exactly the same base motion."""

# r = f_b / (omega / 2 pi), and the percentage of one steady period that the mass sticks: m = 1, k = 4, n = 1, mu = 1,
# v0 = 1, start (0, 1). Computed arc by arc; 38.67 at 1.22 is the maximum (the paper: "almost 40% around 1.2").
SQUARE_WAVE_SHARES = {
    0.4: 0.0,
    0.8: 9.71,
    0.9: 8.27,
    1.0: 15.83,
    1.1: 25.85,
    1.2: 36.43,
    1.22: 38.67,
    1.3: 27.37,
    1.4: 5.97,
    1.41: 2.94,
    1.42: 0.0,
    2.0: 0.0,
    2.5: 0.0,
}


class SetUp(NamedTuple):
    """A system, a base motion and a start, as plain numbers."""

    mass: float
    stiffness: float
    normal_force: float
    mu: float
    durations: tuple[float, ...]
    velocities: tuple[float, ...]
    t1: float
    position0: float
    velocity0: float

    @property
    def omega(self) -> float:
        return math.sqrt(self.stiffness / self.mass)

    @property
    def half_width(self) -> float:
        return self.mu * self.normal_force / self.stiffness

    @property
    def system(self) -> ss.MassSpring:
        return ss.MassSpring(self.mass, self.stiffness, self.normal_force, ss.Coulomb(self.mu))

    def merged(self) -> "SetUp":
        """The same base motion with neighbours of equal velocity joined."""
        durations, velocities = [], []
        for duration, velocity in zip(self.durations, self.velocities, strict=True):
            if velocities and velocities[-1] == velocity:
                durations[-1] += duration
            else:
                durations.append(duration)
                velocities.append(velocity)
        return self._replace(durations=tuple(durations), velocities=tuple(velocities))

    def simulate(self, slots: int) -> ss.Simulation:
        """Run the package by way of `PiecewiseConstant`; compiled once for each number of slots."""
        times = np.concatenate([[0.0], np.cumsum(self.durations)])
        spare = slots - len(self.durations)
        assert spare >= 0, "more intervals than slots"
        times = np.concatenate([times[:-1], times[-1] + 1.0 + np.arange(spare)])
        velocities = np.concatenate([self.velocities, np.full(spare, self.velocities[-1])])
        start = (self.position0, self.velocity0)
        return simulate_piecewise(self.system, jnp.asarray(times), jnp.asarray(velocities), self.t1, start)

    def reference(self) -> ReferenceRun:
        return simulate_reference(**self._asdict())

    def segments(self) -> list[ReferenceSegment]:
        return trace_reference(**self._asdict())


class FilledSticks(NamedTuple):
    """A simulation's sticks without the spare slots, as numpy arrays."""

    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    ending: np.ndarray
    duration: np.ndarray


class Errors(NamedTuple):
    """Worst relative deviations from the reference; for their scales see `errors_against`."""

    event_time: float
    duration: float
    event_state: float
    end_state: float


@jax.jit
def simulate_compiled(system, base, t1, y0):
    """`simulate`, compiled once for each number of slots in `base`."""
    return ss.simulate(system, base, t1=t1, y0=y0)


@jax.jit
def simulate_piecewise(system, times, velocities, t1, y0):
    """`simulate` on a `PiecewiseConstant` base, compiled once for each number of times."""
    base = ss.PiecewiseConstant(times, velocities).sample(None, t1, capacity=times.shape[0])
    return ss.simulate(system, base, t1=t1, y0=y0)


@jax.jit
def evaluate_compiled(simulation, times):
    """`Simulation.evaluate`, compiled once for each pair of sizes."""
    return simulation.evaluate(times)


def padded(durations, velocities, slots: int) -> ss.VelocitySteps:
    """A realisation with spare slots of zero length at its end."""
    spare = slots - len(durations)
    assert spare >= 0, "more intervals than slots"
    return ss.VelocitySteps(
        jnp.asarray([*durations, *[0.0] * spare]), jnp.asarray([*velocities, *[velocities[-1]] * spare])
    )


def on_grid(durations) -> tuple[float, ...]:
    """Round durations to multiples of `GRID`, none of them to zero."""
    return tuple(float(value) for value in np.maximum(np.round(np.asarray(durations) / GRID), 1) * GRID)


def random_set_up(w: float, rate: float, levels, count: int, seed, amplitude: float = 1.0) -> SetUp:
    """A random system with `count` exponential gaps, velocities drawn from ``w * levels`` (dimensionless).

    `rate` is in units of omega. The start is uniform in position up to ``amplitude * (1 + w)`` half-widths and in
    velocity up to the base's.
    """
    source = np.random.default_rng(seed)
    mass, stiffness, normal_force, mu = (float(value) for value in np.exp(source.uniform(-1.5, 1.5, 4)))
    omega, a = math.sqrt(stiffness / mass), mu * normal_force / stiffness
    durations = on_grid(source.exponential(1 / (rate * omega), count))
    velocities = tuple(float(value) for value in w * a * omega * source.choice(levels, count))
    return SetUp(
        mass,
        stiffness,
        normal_force,
        mu,
        durations,
        velocities,
        0.999 * sum(durations),
        float(source.uniform(-1, 1) * amplitude * (1 + w) * a),
        float(source.uniform(-1, 1) * w * a * omega),
    )


def filled(simulation: ss.Simulation) -> FilledSticks:
    """The sticks of a simulation of one trajectory."""
    mask = np.asarray(simulation.sticks.mask)
    return FilledSticks(*(np.asarray(getattr(simulation.sticks, name))[mask] for name in FilledSticks._fields))


def errors_against(run: ReferenceRun, simulation: ss.Simulation, setup: SetUp) -> Errors:
    """Assert that both runs have the same sticks with the same endings, and measure how far apart they are.

    Times are measured against ``max(t, 1 / omega)``; durations too, for their error comes from that of the instants;
    stick positions against the half-width; the end state against half-width or amplitude, whichever is larger.
    """
    assert int(simulation.status) == ss.Status.FINISHED
    sticks = filled(simulation)
    assert [ss.Ending(code).name for code in sticks.ending] == [stick.ending for stick in run.sticks]
    omega, a = setup.omega, setup.half_width
    times, lengths, places = [], [], []
    with mp.workdps(40):
        for index, exact in enumerate(run.sticks):
            clock = max(float(exact.end), 1 / omega)
            times.append(_off(sticks.start[index], exact.start, max(float(exact.start), 1 / omega)))
            times.append(_off(sticks.end[index], exact.end, clock))
            lengths.append(_off(sticks.duration[index], exact.end - exact.start, clock))
            places.append(_off(sticks.position[index], exact.position, a))
        x, speed = simulation.final_state
        size = max(a, math.hypot(float(run.final_position), float(run.final_velocity) / omega))
        end = [_off(x, run.final_position, size), _off(speed, run.final_velocity, size * omega)]
    return Errors(*(max(group, default=0.0) for group in (times, lengths, places, end)))


def _off(got, exact: mpf, scale: float) -> float:
    return float(abs(mpf(float(got)) - exact)) / scale
