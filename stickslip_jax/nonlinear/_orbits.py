"""Periodic orbits, with sticks or without: Newton's method on the return map, with its exact derivatives; and their
equations along a parameter.
"""

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._dynamics.common.method import EXACT, Arguments, Exact, slowest_time, state_of, working_dtype
from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation
from .._dynamics.switched.engine import StepPath, follow_steps
from .._ensemble.points import Setter, SweepSetting
from .._excitation.excitation import BaseMotion, motion_of
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._foundation import checks
from .._foundation.fields import WithMethods, in_one_line
from .._foundation.types import AnyArray, BoolScalar, FloatArray, FloatScalar, InitialState, IntArray, Scalar, Status
from .._numerics.derivatives import as_arrays
from .._numerics.matrices import solution
from .._systems.system import System
from .._uncertainty.numbers import NumberPath, with_numbers
from ._cases import Cycle, changes_by_itself, check_repeats, check_signals, drive_period, steps_in, without_turns

# The sequence of modes of a trajectory: which contacts stick, and which slip in which direction.


class Mode(NamedTuple):
    """A part of an orbit in which no contact changes between slip and stick.

    `signs`: of the relative velocity of each contact, 0 in a stick. `start`, `end`: s, from the beginning of the orbit.
    """

    signs: tuple[int, ...]
    start: float
    end: float


def modes_between(times: np.ndarray, signs: np.ndarray, t1: float) -> tuple[Mode, ...]:
    """The modes up to `t1` (s), by the signs that hold from the beginnings of loop steps on, (steps,) or (steps,
    contacts).
    """
    signs = signs.reshape(len(times), -1).astype(int)
    # Of loop steps that begin at one instant the last holds; the idle ones after the end begin where it is.
    last = np.append(times[1:] > times[:-1], False) & (times < t1)
    times, signs = times[last], signs[last]
    new = np.append(True, np.any(signs[1:] != signs[:-1], axis=1))
    starts, ends = times[new], np.append(times[new][1:], t1)
    return tuple(
        Mode(tuple(map(int, sign)), float(start), float(end))
        for sign, start, end in zip(signs[new], starts, ends, strict=True)
    )


def sequence(modes: tuple[Mode, ...]) -> tuple[tuple[int, ...], ...]:
    """The order of modes on a closed orbit, wherever it begins."""
    signs = [mode.signs for mode in modes]
    if len(signs) > 1 and signs[0] == signs[-1]:
        signs = signs[:-1]
    turns = [tuple(signs[number:] + signs[:number]) for number in range(len(signs))]
    return min(turns)


def count(modes: tuple[Mode, ...], sign: int) -> int:
    """The number of sticks (`sign` 0), or of slips in one direction, of all contacts on a closed orbit; one that lasts
    for all of it counts.
    """
    found = np.array(sequence(modes)) == sign
    begun = found & ~np.roll(found, 1, axis=0)
    return int(np.sum(begun) + np.sum(np.all(found, axis=0)))


# Newton's method for return maps, whose roots have the derivatives of what they are roots of.


_HALVINGS = 8
_LEAST = 0.5  # a smaller gain near the end is round-off


class Root(NamedTuple):
    """Of a root: the derivative of the function there (size, size), and the residuals: of the guess, and after each
    iteration that made it smaller (NaN after the last).
    """

    matrix: FloatArray
    residuals: FloatArray


class _State(NamedTuple):
    """The best point `z` so far, its `residual`, and the `matrix` there; and the point to `try` next, ``z + step`` of a
    Newton step that was halved so many times.
    """

    z: FloatArray
    residual: FloatScalar
    matrix: FloatArray
    step: FloatArray
    halvings: IntArray
    residuals: FloatArray
    number: IntArray
    goes_on: BoolScalar


def root_of(
    function: Callable[[FloatArray], FloatArray],
    size_of: Callable[[FloatArray, FloatArray], FloatScalar],
    guess: FloatArray,
    tolerance: FloatScalar,
    iterations: int,
) -> tuple[FloatArray, Root]:
    """A root of `function` (size,) near `guess`, and how it was found.

    `size_of` a residual at a point: relative, without unit. A step that makes it larger is halved. The derivatives of
    the root are those of the implicit function, of every order, as `lax.custom_root` has them.
    """

    def solve(function, guess):
        unit = jnp.eye(len(guess), dtype=guess.dtype)

        # The function stands here once: it is a whole simulation, which takes seconds to compile.
        def one(state: _State) -> _State:
            z = state.z + state.step
            push = jax.vmap(lambda direction: jax.jvp(function, (z,), (direction,)), out_axes=(None, 1))
            value, matrix = push(unit)
            residual = size_of(z, value)
            better = residual < state.residual
            number = state.number + better
            chosen = jnp.where(better, residual, state.residual)
            goes_on = better & (residual > 0) & ((residual > tolerance) | (residual < _LEAST * state.residual))
            return _State(
                jnp.where(better, z, state.z),
                chosen,
                jnp.where(better, matrix, state.matrix),
                jnp.where(better, solution(matrix, -value), state.step / 2),
                jnp.where(better, 0, state.halvings + 1),
                state.residuals.at[number].set(chosen),
                number,
                goes_on | (~better & (state.residual > tolerance) & (state.halvings < _HALVINGS)),
            )

        none, most = jnp.zeros((), jnp.int32), jnp.full((), jnp.inf, guess.dtype)
        residuals = jnp.full(iterations + 1, jnp.nan, guess.dtype)
        begun = _State(guess, most, jnp.zeros_like(unit), jnp.zeros_like(guess), none, residuals, none - 1, most > 0)
        done = lax.while_loop(lambda state: state.goes_on & (state.number < iterations), one, begun)
        return done.z, Root(done.matrix, done.residuals)

    def tangent(linear, target):
        return solution(jax.vmap(linear, out_axes=1)(jnp.eye(len(target), dtype=target.dtype)), target)

    return lax.custom_root(function, guess, solve, tangent, has_aux=True)


# What the search for a periodic orbit begins with, and what is read from what it found.


_SPAN = 50  # time scales, in which a motion is looked at; again from its end, so many times
_MOST_SPANS = 20
_SEEN = 8001


def multipliers_of(matrix: np.ndarray) -> np.ndarray:
    """The eigenvalues of a real matrix, the largest first, exact zeros for what it lacks in rank.

    The eigenvalues of ``q r`` that are not zero are those of ``r q``, which is smaller.
    """
    size = len(matrix)
    while len(matrix):
        left, sizes, right = np.linalg.svd(matrix)
        rank = int(np.sum(sizes > 1e3 * np.finfo(matrix.dtype).eps * max(sizes[0], np.finfo(matrix.dtype).tiny)))
        if rank == len(matrix):
            break
        matrix = (sizes[:rank, None] * right[:rank]) @ left[:, :rank]
    found = np.zeros(size, complex)
    found[: len(matrix)] = np.linalg.eigvals(matrix) if len(matrix) else []
    return found[np.argsort(-np.abs(found), kind="stable")]


def own_multipliers(multipliers: np.ndarray, driven: bool) -> np.ndarray:
    """Where nothing drives the system, without the multiplier that is nearest to 1: that along the motion."""
    return multipliers if driven else np.delete(multipliers, np.argmin(np.abs(multipliers - 1)))


def guessed_period(system: System, base: BaseMotion, start: Any, method: Exact) -> float:
    """The time in which a motion that begins at `start` last came back to where it then was."""
    if checks.holds_traced(system, base, start):
        raise ValueError(
            "Argument period must be given under jax.jit, vmap and grad, where nothing changes with time: a guess of "
            "the orbit's period, s."
        )
    span, y0 = _SPAN * slowest_time(system, base), tuple(map(float, start))
    times = np.linspace(0, span, _SEEN)
    for _ in range(_MOST_SPANS):
        one = simulate(system, base, t1=span, y0=y0, method=method)
        states = np.stack([np.asarray(column) for column in one.evaluate(times)], axis=1)
        found = _last_return(times, states)
        if found is not None:
            return found
        y0 = tuple(map(float, one.final_state))
    raise ValueError(
        "Argument period must be given: a guess of the orbit's period (s), because no motion from y0 was found that "
        f"comes back to where it was {_MOST_SPANS * span:.4g} s later; does it come to rest?"
    )


def _last_return(times: np.ndarray, states: np.ndarray) -> float | None:
    """The time between the end and when the motion last passed there, None if it never came near."""
    scale = np.ptp(states, axis=0)
    if not np.all(np.isfinite(states)) or np.max(scale) <= 1e-9 * max(np.max(np.abs(states)), 1e-300):
        return None
    scaled = states / np.where(scale > 0, scale, 1)
    distance = np.linalg.norm(scaled - scaled[-1], axis=1)
    away = np.flatnonzero(distance > 0.2)
    if not len(away):
        return None
    before = distance[: away[-1]]
    near = np.flatnonzero((before[1:-1] <= before[:-2]) & (before[1:-1] <= before[2:]) & (before[1:-1] < 0.05)) + 1
    return float(times[-1] - times[near[-1]]) if len(near) else None


# Periodic orbits, with sticks or without: Newton's method on the return map, with its exact derivative.


TOLERANCE = {8: 1e-10, 4: 1e-4}
_ITERATIONS = 30
_LEAST_SCALE = 1e-3  # of the largest number of the state: that of one which is zero
_STILL = 1e3  # tolerances: what its rates move an equilibrium in a period
_STEPS = 2  # times as many as one period of the guess needs: the period of a free orbit may become longer


class PeriodicOrbit(WithMethods):
    """A periodic orbit; a pytree, which `jax.vmap` makes many of, and JAX differentiates.

    Attributes:
        state: Where it begins, (coordinates,).
        period: s.
        monodromy: The derivative of the state after one period by that at its begin, (coordinates, coordinates); its
            eigenvalues are the `multipliers`. A stick takes one from its rank.
        converged: Whether the state comes back to within the tolerance, and moves in between: an equilibrium is no
            orbit. If not, the numbers are the last of the search.
        residuals: How far the state was from coming back, before each iteration and after the last, relative; NaN where
            there was no further iteration.
        system: The argument of `periodic_orbit`.
        base: The argument of `periodic_orbit`.
        method: The method, with the number of steps of one period.
        is_driven: Whether something that drives the system changes with time. If nothing does, the period was found
            too, and one multiplier is 1.
    """

    state: Array
    period: Array
    monodromy: Array
    converged: Array
    residuals: Array
    system: System
    base: BaseMotion
    method: Exact
    is_driven: bool = eqx.field(static=True)

    @property
    def multipliers(self) -> Array | np.ndarray:
        """The Floquet multipliers (complex, without unit), the largest first; those that sticks make 0 are exactly 0.

        Under JAX's transformations they are the eigenvalues of `monodromy` as LAPACK finds them, in its order.
        """
        if checks.is_traced(self.monodromy) or self.monodromy.ndim > 2:
            return jnp.linalg.eigvals(self.monodromy)
        return multipliers_of(np.asarray(self.monodromy))

    def __repr__(self) -> str:
        if self.monodromy.ndim > 2 or checks.holds_traced(self):
            return f"PeriodicOrbit({self.state.shape[:-1]} orbits of a {type(self.system).__name__})"
        name = f"PeriodicOrbit of a {type(self.system).__name__}"
        if not self.converged:
            return f"{name}, NOT CONVERGED: {np.nanmin(np.asarray(self.residuals)):.2g} from coming back at the nearest"
        largest = np.max(np.abs(own_multipliers(np.asarray(self.multipliers), self.is_driven)), initial=0.0)
        how = "stable" if self.is_stable else "unstable"
        begin = in_one_line(np.asarray(self.state))
        return f"{name}: period {float(self.period):.6g} s from {begin}, {how}, largest multiplier {largest:.4g}"

    @property
    def is_stable(self) -> bool:
        """Whether all multipliers are inside the unit circle; without a drive, all but the one that is 1."""
        return bool(np.all(np.abs(own_multipliers(np.asarray(self.multipliers), self.is_driven)) < 1))

    @property
    def simulation(self) -> Simulation:
        """The motion over one period."""
        return simulate(self.system, self.base, t1=self.period, y0=tuple(self.state), method=self.method)

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The parts of the orbit between which a contact begins or ends to stick, or its slip changes direction."""
        y0, t1 = tuple(float(value) for value in np.asarray(self.state)), float(self.period)
        motion = motion_of(self.base).realized_until(t1)
        run = follow_steps(self.system, motion, self.method, t1, y0, working_dtype(stacklevel=4))
        assert isinstance(run.path, StepPath)
        begun = run.path.beginnings
        return modes_between(np.asarray(begun.t), np.asarray(begun.sign), t1)


def periodic_orbit(
    system: System,
    base: BaseMotion,
    *,
    y0: InitialState,
    periods: int = 1,
    period: Scalar | None = None,
    tolerance: float | None = None,
    iterations: int = _ITERATIONS,
    method: Exact = EXACT,
) -> PeriodicOrbit:
    """The periodic orbit near a state, stable or not: Newton's method on the return map.

    The derivative of the map is exact, through every stick and slip, so that convergence is quadratic until a stick or
    slip appears or vanishes. What is found may repeat itself within the period. A pure function: under ``jit``,
    ``vmap`` and ``grad`` (the orbit's derivatives are those of the implicit function).

    Args:
        system: A `MassSpring`, a `MotorCart`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion that repeats itself, such as `Constant`, `SquareWave` or `Harmonic`.
        y0: A state near the orbit, at a whole number of periods of the drive, as the last of a `stroboscopic_section`.
        periods: After how many periods of the drive the orbit closes.
        period: s. Of the drive, by default that after which all motions that drive the system repeat themselves. Where
            nothing changes with time, a guess of the orbit's period, which is then found too; by default from a
            simulation that begins at `y0`.
        tolerance: Of the residual, relative; by default 1e-10 (float32: 1e-4).
        iterations: At most.
        method: `Exact`. Under ``jit`` it must give `max_steps` for one period.

    Returns:
        The orbit; see whether it has `converged`.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.

    >>> leine = ss.MassSpring(
    ...     mass=1.0, stiffness=1.0, normal_force=1.0,
    ...     friction=ss.VelocityWeakening(mu_static=1.0, weakening=3.0),
    ... )
    >>> orbit = ss.nonlinear.periodic_orbit(leine, ss.Constant(0.2), y0=(1.0, 0.2))
    >>> print(orbit.period.round(9), orbit.multipliers.round(8))
    12.001031295 [1.+0.j 0.+0.j]
    """
    check_repeats(system, base, period, method)
    periods = checks.whole_number("periods", periods)
    iterations = checks.whole_number("iterations", iterations)
    start = state_of(system, y0)
    dtype = working_dtype()
    motion = motion_of(base)
    by_itself = changes_by_itself(system, base, start, period)
    duration = drive_period(system, motion, period, by_itself)
    driven = duration is not None
    if tolerance is None:
        tolerance = TOLERANCE[np.dtype(dtype).itemsize]
    checks.positive("tolerance", tolerance)
    if duration is None:
        duration = period if period is not None else guessed_period(system, base, start, method)
    else:
        duration = periods * duration
        check_signals((system, motion), jnp.asarray(duration, dtype))
        Arguments(system, motion, method, duration).check_length()
    steps = steps_in(system, motion, method, duration)
    if steps is not None:
        method = Exact(method.step, (1 if driven else _STEPS) * steps, method.solver)
    guess = jnp.stack([jnp.asarray(value, dtype) for value in start])
    realized = motion.realized_until(duration) if driven else motion
    cycle = Cycle(as_arrays(system, dtype), as_arrays(realized, dtype), jnp.asarray(duration, dtype), method)
    state, duration, matrix, residuals, moves = _search(cycle, guess, jnp.asarray(tolerance, dtype), iterations, driven)
    matrix = _monodromy(cycle, state, duration, matrix)
    converged = (jnp.nanmin(residuals) <= tolerance) & moves
    return PeriodicOrbit(state, duration, matrix, converged, residuals, system, base, method, driven)


@kept_jit(filtered=True)
def _search(
    cycle: Cycle, guess: FloatArray, tolerance: FloatScalar, iterations: int, driven: bool
) -> tuple[FloatArray, FloatScalar, FloatArray, FloatArray, BoolScalar]:
    """The state, the period and the monodromy matrix of the orbit near `guess`, the residuals, and whether it moves: an
    equilibrium comes back after any time, and everything after none.
    """
    length = len(guess)
    if driven:

        def change_of(y: FloatArray) -> FloatArray:  # `lax.custom_root` hashes its function: no method of a module
            return cycle.change(y)

        state, found = root_of(change_of, _size, guess, tolerance, iterations)
        matrix = found.matrix + jnp.eye(length, dtype=guess.dtype)
        return state, jnp.asarray(cycle.duration), matrix, found.residuals, jnp.asarray(True)
    # Nothing drives it: the period is found too, and the state on the plane through `guess` across the motion there.
    unit, reference = lax.stop_gradient((jnp.asarray(cycle.duration), guess))
    ahead = lax.stop_gradient(cycle.rates(guess))

    def change(z: FloatArray) -> FloatArray:
        y = z[:length]
        return jnp.append(cycle.lasting(z[length] * unit).change(y), jnp.sum(ahead * (y - reference)))

    def size(z: FloatArray, residual: FloatArray) -> FloatScalar:
        return _size(z[:length], residual[:length])

    z, found = root_of(change, size, jnp.append(guess, jnp.ones_like(unit)), tolerance, iterations)
    matrix = found.matrix[:length, :length] + jnp.eye(length, dtype=guess.dtype)
    moves = _size(z[:length], found.matrix[:length, length] * z[length]) > _STILL * tolerance
    return z[:length], z[length] * unit, matrix, found.residuals, moves


@eqx.filter_custom_jvp
def _monodromy(cycle: Cycle, state: FloatArray, duration: FloatScalar, known: FloatArray) -> FloatArray:
    """The derivative of the state after `duration` by `state`: the `known` one, with derivatives of its own."""
    return known


@_monodromy.def_jvp
def _monodromy_jvp(primals, tangents):
    *of, known = primals
    *by, _ = tangents

    def matrix(cycle: Cycle, state: FloatArray, duration: FloatScalar) -> FloatArray:
        return jax.jacfwd(cycle.lasting(duration).end)(state)

    return known, eqx.filter_jvp(matrix, tuple(of), tuple(by))[1]


def _size(state: FloatArray, residual: FloatArray) -> FloatScalar:
    """The size of a residual of the state, relative to its numbers."""
    sizes = jnp.maximum(jnp.abs(state), jnp.abs(state + residual))
    scale = jnp.maximum(sizes, _LEAST_SCALE * jnp.max(sizes))
    return jnp.max(jnp.abs(residual) / jnp.where(scale > 0, scale, 1))


# The equations of a periodic orbit as a function of its state, its period and a parameter, for continuation.


_MOST_STEPS = 4  # times what the first orbit needs
_FAR = 0.05  # of the period, from the begin of an orbit to the next event


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """The equations at one point: their `value` (size,), the `matrix` of derivatives (size, size + 1); the `duration`
    (s) and the `modes` of the orbit, and whether something drives it (`driven`).
    """

    value: np.ndarray
    matrix: np.ndarray
    duration: float
    modes: tuple[Mode, ...]
    driven: bool

    @cached_property
    def multipliers(self) -> np.ndarray:
        """The Floquet multipliers, the largest first."""
        size = len(self.value) - (not self.driven)
        return multipliers_of(self.matrix[:size, :size] + np.eye(size))

    @property
    def own_multipliers(self) -> np.ndarray:
        """The multipliers without the one that is 1 where nothing drives the system."""
        return own_multipliers(self.multipliers, self.driven)

    @property
    def is_stable(self) -> bool:
        """Whether they are inside the unit circle."""
        return bool(np.all(np.abs(self.own_multipliers) < 1))

    @property
    def stick_fraction(self) -> float:
        """The share of the period in sticks, mean over the contacts."""
        stuck = sum((mode.end - mode.start) * np.mean([sign == 0 for sign in mode.signs]) for mode in self.modes)
        return float(stuck / self.duration)

    @property
    def is_at_rest(self) -> bool:
        """Whether all contacts stick all the time."""
        return not any(any(mode.signs) for mode in self.modes)

    @property
    def order(self) -> tuple[object, ...]:
        """The sequence of modes, and that with which the period begins: where it changes, the branch has a corner."""
        return sequence(self.modes), self.modes[0].signs

    @property
    def is_far_from_events(self) -> bool:
        """Whether the orbit begins in the midst of a mode."""
        first, last, least = self.modes[0], self.modes[-1], _FAR * self.duration
        return len(self.modes) == 1 or (first.end > least and last.end - last.start > least)


class Plane(NamedTuple):
    """Where an orbit that nothing drives begins: on the plane through `point` across `normal`."""

    point: AnyArray
    normal: AnyArray


class Equations:
    """Of unknowns (coordinates, then the period if nothing drives the system, then the parameter): the state comes
    back, and without a drive it begins on the `plane`, which is given then.
    """

    plane: Plane | None = None

    def __init__(self, orbit: PeriodicOrbit, setter: Setter, parameter: str, dtype: np.dtype):
        """`orbit`: where the branch begins; its period is so many periods of the drive, or one that was given.
        `setter`: of the `parameter`.
        """
        setting, driven, duration = setter.setting, orbit.is_driven, float(orbit.period)
        self._setter, self._first, self._path = setter, duration, setter.paths[parameter]
        self.driven, self._dtype, self.itemsize = driven, dtype, dtype.itemsize
        self._setting = as_arrays(setting, dtype)
        self.coordinates = len(setting.system.coordinates)
        motion = motion_of(setting.law)
        self._by_itself = driven and changes_by_itself(setting.system, setting.law, setting.y0, duration)
        self._drive = None
        try:
            drive = drive_period(setting.system, motion, None, self._by_itself)
        except ValueError:  # it is not known without being given
            self._drive = duration
            drive = drive_period(setting.system, motion, duration, self._by_itself)
        self.periods = 1 if drive is None else round(duration / float(drive))
        realized = motion.realized_until(duration)
        self.steps = steps_in(setting.system, realized, orbit.method, duration, by_steps=True)
        if self.steps is None:
            self.steps = orbit.method.max_steps
        self._most_each = _MOST_STEPS * (self.steps or 0)
        self._capacity = None
        if driven and isinstance(motion, PiecewiseConstantLaw):
            self._capacity = motion.checked_capacity(duration) + 1

    @property
    def size(self) -> int:
        """The number of equations."""
        return self.coordinates + (not self.driven)

    def at(self, unknowns: np.ndarray, periods: int | None = None) -> Evaluated | None:
        """The equations at a point; None where the motion cannot be followed there, or the parameter may not be.

        `periods`: of the drive; by default those of the orbit.
        """
        size, periods = self.coordinates, self.periods if periods is None else periods
        if not self.driven and not unknowns[size] > 0:
            return None
        try:
            self._setter((float(unknowns[-1]),))
        except ValueError:  # the parameter may not have this value
            return None
        plane = None if self.plane is None else Plane(*(jnp.asarray(one, self._dtype) for one in self.plane))
        while True:
            found = _evaluate(
                self._setting, jnp.asarray(unknowns, self._dtype), plane, path=self._path,
                driven=self.driven, by_itself=self._by_itself, periods=periods, drive=self._drive, steps=self.steps,
                capacity=self._capacity,
            )  # fmt: skip
            value, matrix, times, signs, status, duration = map(np.asarray, found)
            most = self._most_each * max(float(duration) / self._first, 1)
            if int(status) != int(Status.OUT_OF_STEPS) or not self.steps or self.steps >= most:
                break
            self.steps *= 2
        if int(status) != int(Status.FINISHED) or not (np.all(np.isfinite(value)) and np.all(np.isfinite(matrix))):
            return None
        return Evaluated(value, matrix, float(duration), modes_between(times, signs, float(duration)), self.driven)

    def half_way(self, unknowns: np.ndarray) -> np.ndarray | None:
        """What the state moves in half of the period, (coordinates,); None where the drive does not repeat itself in
        it, or the motion cannot be followed.
        """
        if self.driven and self.periods % 2:
            return None
        found = self.at(*self.halved(unknowns))
        return None if found is None else found.value[: self.coordinates]

    def halved(self, unknowns: np.ndarray) -> tuple[np.ndarray, int | None]:
        """The unknowns with half of the period, and half of the periods of the drive, None without one."""
        half = np.array(unknowns, float)
        if self.driven:
            return half, self.periods // 2
        half[self.coordinates] /= 2
        return half, None


@kept_jit(filtered=True)
def _evaluate(
    setting: SweepSetting, unknowns: FloatArray, plane: Plane | None, *, path: NumberPath, driven: bool,
    by_itself: bool, periods: int, drive: float | None, steps: int | None, capacity: int | None,
) -> tuple[Array, ...]:  # fmt: skip
    """The equations, their derivatives, the time and the signs at the begin of each loop step, the `Status`, and the
    duration (s).
    """
    coordinates, dtype = len(setting.system.coordinates), unknowns.dtype

    def function(unknowns: FloatArray):
        y, parameter = unknowns[:coordinates], unknowns[-1]
        changed = with_numbers(setting, (path,), [parameter])
        motion = motion_of(changed.law)
        if driven:
            period = drive_period(changed.system, motion, drive, by_itself)
            assert period is not None
            duration = periods * jnp.asarray(period, dtype)
        else:
            duration = unknowns[coordinates]
        if capacity is not None and isinstance(motion, PiecewiseConstantLaw):
            base = motion.sample(None, duration, capacity=capacity)
        else:
            base = motion.realized_until(duration)
        method = Exact(setting.method.step, steps, setting.method.solver)
        run = Cycle(changed.system, base, duration, method).by_steps(y)
        assert isinstance(run.path, StepPath)
        value = without_turns(setting.system, jnp.stack(run.final_state) - y)
        if plane is not None:
            value = jnp.append(value, jnp.sum(plane.normal * (y - plane.point)))
        return value, (run.path.beginnings.t, run.path.beginnings.sign, run.status, duration)

    def along(direction: FloatArray):
        return jax.jvp(function, (unknowns,), (direction,), has_aux=True)

    unit = jnp.eye(len(unknowns), dtype=dtype)
    value, matrix, more = jax.vmap(along, out_axes=(None, 1, None))(unit)
    return value, matrix, *more
