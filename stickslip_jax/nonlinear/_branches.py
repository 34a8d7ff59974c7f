"""Branches of periodic orbits: their equations, the points on them, and how they end."""

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import newton

from .._dynamics.common.method import Exact
from .._dynamics.switched.engine import StepPath
from .._ensemble.points import Setter, SweepSetting
from .._excitation.excitation import motion_of
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._foundation.types import FloatArray, Status
from .._numerics.derivatives import as_arrays
from .._uncertainty.numbers import NumberPath, with_numbers
from ._cases import Cycle, changes_by_itself, drive_period, steps_in, without_turns
from ._orbits import (
    Mode,
    PeriodicOrbit,
    modes_between,
    multipliers_of,
    sequence,
    slip_count,
    stick_count,
    without_trivial,
)

# The equations of a periodic orbit as a function of its state, its period and a parameter, for continuation.


_MOST_STEPS = 4  # times what the first orbit needs


class Evaluated(NamedTuple):
    """The equations at one point: their `value` (size,), the `matrix` of derivatives (size, size + 1); the `duration`
    (s) and the `modes` of the orbit, and the number of `coordinates`.
    """

    value: np.ndarray
    matrix: np.ndarray
    duration: float
    modes: tuple[Mode, ...]
    coordinates: int

    @property
    def multipliers(self) -> np.ndarray:
        """The Floquet multipliers, the largest first."""
        size = self.coordinates
        return multipliers_of(self.matrix[:size, :size] + np.eye(size))


class Plane(NamedTuple):
    """Where an orbit that nothing drives begins: on the plane through `point` across `normal`."""

    point: Array
    normal: Array


class Equations:
    """Of unknowns (coordinates, then the period if nothing drives the system, then the parameter): the state comes
    back, and without a drive it begins on a `Plane`.
    """

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

    def at(self, unknowns: np.ndarray, plane: Plane | None, periods: int | None = None) -> Evaluated | None:
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
        return Evaluated(value, matrix, float(duration), modes_between(times, signs, float(duration)), size)

    def half_way(self, unknowns: np.ndarray, plane: Plane | None) -> np.ndarray | None:
        """What the state moves in half of the period, (coordinates,); None where the drive does not repeat itself in
        it, or the motion cannot be followed.
        """
        if self.driven and self.periods % 2:
            return None
        half, periods = self.halved(unknowns)
        found = self.at(half, plane, periods)
        return None if found is None else found.value[: self.coordinates]

    def halved(self, unknowns: np.ndarray) -> tuple[np.ndarray, int | None]:
        """The unknowns with half of the period, and half of the periods of the drive, None without one."""
        half = np.array(unknowns, float)
        if self.driven:
            return half, self.periods // 2
        half[self.coordinates] /= 2
        return half, None

    def plane(self, point: np.ndarray, normal: np.ndarray) -> Plane:
        """The plane through `point` across `normal`."""
        return Plane(jnp.asarray(point, self._dtype), jnp.asarray(normal, self._dtype))

    def state_after(self, unknowns: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """The state of an orbit that nothing drives at a `time` (s) after its begin, and its rates there."""
        moved, size = np.array(unknowns, float), self.coordinates
        moved[size] = time
        found = self.at(moved, self.plane(unknowns[:size], np.ones(size)))
        assert found is not None
        return unknowns[:size] + found.value[:size], found.matrix[:size, size]


@eqx.filter_jit
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


# The points of a branch of periodic orbits, and what changes between two of them.


_FAR = 0.05  # of the period, from the begin of an orbit to the next event
_SIGNS = {1: "+", -1: "-", 0: "0"}


class BranchEvent(NamedTuple):
    """What happens on a branch: its `kind`, the value of the `parameter` there, the point after which, and in words.

    Kinds: "fold", "flip", "Neimark-Sacker", "branch point", "stick appears", "stick vanishes", "slip appears", "slip
    vanishes", "grazing"; of ends also "Hopf", and "end" where none of these was found.
    """

    kind: str
    parameter: float
    point: int
    text: str


class OrbitPoint:
    """A point of the branch: the `unknowns`, the equations `found` there, the `tangent` (scaled), and the number of
    iterations that it took.
    """

    def __init__(self, unknowns: np.ndarray, found: Evaluated, tangent: np.ndarray, iterations: int):
        self.unknowns, self.found, self.tangent, self.iterations = unknowns, found, tangent, iterations

    def turned(self) -> "OrbitPoint":
        """The same, its tangent the other way."""
        return OrbitPoint(self.unknowns, self.found, -self.tangent, self.iterations)

    @cached_property
    def multipliers(self) -> np.ndarray:
        """The Floquet multipliers, the largest first."""
        return self.found.multipliers

    def is_stable(self, driven: bool) -> bool:
        """Whether all multipliers but the one that is 1 without a drive are inside the unit circle."""
        return bool(np.all(np.abs(self.own_multipliers(driven)) < 1))

    def own_multipliers(self, driven: bool) -> np.ndarray:
        """The multipliers without the one that is 1 where nothing drives the system."""
        return self.multipliers if driven else without_trivial(self.multipliers)

    @property
    def stick_fraction(self) -> float:
        """The share of the period in sticks, mean over the contacts."""
        modes = self.found.modes
        stuck = sum((mode.end - mode.start) * np.mean([sign == 0 for sign in mode.signs]) for mode in modes)
        return float(stuck / self.found.duration)

    @property
    def is_at_rest(self) -> bool:
        """Whether all contacts stick all the time."""
        return not any(any(mode.signs) for mode in self.found.modes)

    @property
    def order(self) -> tuple[object, ...]:
        """The sequence of modes, and that with which the period begins: where it changes, the branch has a corner."""
        return sequence(self.found.modes), self.found.modes[0].signs

    @property
    def sequence_text(self) -> str:
        """The sequence of modes: "-0" is a slip with negative relative velocity and a stick."""
        return " ".join(text_of(signs) for signs in sequence(self.found.modes))

    @property
    def is_far_from_events(self) -> bool:
        """Whether the orbit begins in the midst of a mode."""
        modes, duration = self.found.modes, self.found.duration
        if len(modes) == 1:
            return True
        return modes[0].end > _FAR * duration and modes[-1].end - modes[-1].start > _FAR * duration


class Change(NamedTuple):
    """What changed between two points, and whether a point in between `is_before` it."""

    kind: str
    text: str
    is_before: Callable[[OrbitPoint], bool]


def changes(last: OrbitPoint, found: OrbitPoint, driven: bool) -> Iterator[Change]:
    """What changed between two neighbouring points with the same sequence of modes."""
    turned = last.tangent[-1] * found.tangent[-1] < 0
    if turned:
        yield Change("fold", "the branch turns round", lambda point: point.tangent[-1] * last.tangent[-1] > 0)
    for kind, text, test in _TESTS:
        if kind == "branch point" and turned:
            continue

        def sign(point: OrbitPoint, test: Callable[[np.ndarray], float] = test) -> float:
            return test(point.own_multipliers(driven))

        if sign(last) * sign(found) < 0:
            yield Change(kind, text, lambda point, sign=sign: sign(point) * sign(last) > 0)


def _flip(multipliers: np.ndarray) -> float:
    """Changes its sign where a multiplier passes -1."""
    return float(np.prod(multipliers + 1).real)


def _rotation(multipliers: np.ndarray) -> float:
    """Changes its sign where a complex pair passes the unit circle; NaN where there is none."""
    pairs = multipliers[np.imag(multipliers) > 1e-9]
    return float(np.prod(np.abs(pairs) - 1)) if len(pairs) else float("nan")


_TESTS = (
    ("flip", "a multiplier passes -1: an orbit of twice the period branches off", _flip),
    ("Neimark-Sacker", "a pair of multipliers passes the unit circle: motion on a torus branches off", _rotation),
    ("branch point", "a multiplier passes 1: another branch crosses", lambda found: float(np.prod(found - 1).real)),
)


def text_of(signs: tuple[int, ...]) -> str:
    """The signs of the relative velocities of all contacts as text."""
    return "".join(_SIGNS[sign] for sign in signs)


def change_of_modes(last: OrbitPoint, found: OrbitPoint) -> Change | None:
    """The change of the sequence of modes between two neighbouring points; None where it is the same."""
    order = sequence(last.found.modes)
    if order == sequence(found.found.modes):
        return None
    text = f"the sequence of modes {last.sequence_text} becomes {found.sequence_text}"
    kind = kind_of(last.found.modes, found.found.modes)
    return Change(kind, text, lambda point: sequence(point.found.modes) == order)


def kind_of(before: tuple[Mode, ...], after: tuple[Mode, ...]) -> str:
    """What a change of the sequence of modes is called, by the numbers of sticks and slips. Where one less of both is
    left, a slip vanished in a stick or a stick in a slip: which of them is shorter.
    """
    if not any(any(mode.signs) for mode in after):
        return "slip vanishes"
    sticks, slips = stick_count(after) - stick_count(before), slip_count(after) - slip_count(before)
    if not sticks:
        return "grazing"
    shortest = min(before if sticks < 0 else after, key=lambda mode: mode.end - mode.start)
    thing = "slip" if sticks * slips > 0 and all(shortest.signs) else "stick"
    return f"{thing} {'appears' if sticks > 0 else 'vanishes'}"


def end_of(before: tuple[Mode, ...], beyond: tuple[Mode, ...]) -> tuple[str, str]:
    """What the end of a branch is called, and in words, by the modes of its last orbit, and of the motion that was
    followed from just `beyond` it: what comes first that is not as before counts, as the rest may follow from that.
    """
    shown = (" ".join(text_of(mode.signs) for mode in modes) for modes in (before, beyond))
    kind = kind_of(before, beyond)
    for number, mode in enumerate(before):
        there = beyond[min(number, len(beyond) - 1)].signs
        if there == mode.signs:
            continue
        contact = int(np.argmax(np.not_equal(mode.signs, there)))  # the first that differs
        until = before[number - 1].signs[contact] if number else 0
        if mode.signs[contact] and not there[contact]:
            kind = "slip vanishes" if until == 0 else "stick appears"
        elif there[contact] and not mode.signs[contact]:
            kind = "slip appears" if until == 0 and number else "stick vanishes"
        break
    return kind, "a motion with the modes {} becomes one with {}".format(*shown)


# Where branches of periodic orbits end: they would go back over the same orbits half a period later, or the release of
# a stick becomes tangent.


_LARGE = (30.0, 3e5)  # multipliers by which it is extrapolated where they become infinite: neither end is exact
_FITTED = 4  # points
_ITERATIONS = 20
_EXACT = 1e-13


def turning_back(
    equations: Equations, plane: Plane | None, scale: np.ndarray, last: OrbitPoint, found: OrbitPoint
) -> tuple[str, float, str] | None:
    """The kind of the end between two neighbouring points, the parameter there, and in words; None where there is none.

    A cycle shrinks into an equilibrium at a Hopf point, and an orbit of twice the period into the one that doubles.
    Beyond, the equations have the same orbits again, which begin half a period later: what the orbit moves in half of
    its period changes its sign, and of a cycle around an equilibrium the rates do too. The equations of the orbit are
    singular there; those of the equilibrium, or of the orbit of half the period, are not, and its multipliers tell
    where it is.
    """
    if last.tangent[-1] * found.tangent[-1] >= 0:
        return None
    size = equations.coordinates
    one, two = (equations.half_way(point.unknowns, plane) for point in (last, found))
    if one is None or two is None:
        return None
    axis = (one - two) / scale[:size] ** 2
    before, after = float(np.dot(one, axis)), float(np.dot(two, axis))
    if not before > 0 > after:
        return None
    share = before / (before - after)
    between = last.unknowns + share * (found.unknowns - last.unknowns)
    rates = [point.found.matrix[:size, size] / scale[:size] for point in (last, found)]
    if not equations.driven and np.dot(*rates) < 0:
        # An equilibrium comes back after any time; after a quarter of the period the critical multipliers are +-i.
        between[size] /= 4

        def growth(at: Evaluated) -> float:
            critical = np.argmin(np.abs(at.multipliers - 1j))
            return math.log(abs(at.multipliers[critical]))

        value = _root(equations, plane, between, last.unknowns[-1], size, None, growth)
        return "Hopf", value, "the cycle shrinks into an equilibrium"
    value = halved(equations, plane, between, last.unknowns[-1])
    return "flip", value, "the orbit becomes one of half its period, which doubles there"


def halved(equations: Equations, plane: Plane | None, between: np.ndarray, other: float) -> float:
    """The parameter near that of the unknowns `between` where the orbit of half the period has the multiplier -1."""
    guess, periods = equations.halved(between)

    def doubles(at: Evaluated) -> float:
        return _flip(at.multipliers if equations.driven else without_trivial(at.multipliers))

    return _root(equations, plane, guess, other, equations.size, periods, doubles)


def _root(
    equations: Equations, plane: Plane | None, guess: np.ndarray, other: float, number: int, periods: int | None,
    test: Callable[[Evaluated], float],
) -> float:  # fmt: skip
    """The parameter near that of the `guess` where a `test` of what comes back is zero; its first `number` unknowns
    follow from it. That of the guess, where it is not found.
    """
    unknowns = guess.copy()

    def at(parameter: float) -> float:
        unknowns[-1] = parameter
        found = None
        for _ in range(_ITERATIONS):
            found = equations.at(unknowns, plane, periods)
            if found is None:
                break
            # Of contacts that stick all the time the matrix is singular: they stay where they are.
            change = np.linalg.lstsq(found.matrix[:number, :number], -found.value[:number], rcond=1e-10)[0]
            unknowns[:number] += change
            if np.max(np.abs(change)) <= _EXACT * np.max(np.abs(unknowns[:number])):
                break
        return math.nan if found is None else test(found)

    result: Any
    value, result = newton(at, guess[-1], x1=other, tol=1e-12, full_output=True, disp=False)  # pyright: ignore[reportAssignmentType]
    near = abs(value - guess[-1]) <= abs(other - guess[-1]) + 1e-3 * abs(guess[-1])
    return float(value) if result.converged and near else float(guess[-1])


def tangent_release(points: list[OrbitPoint]) -> float | None:
    """The parameter where the largest multiplier of the last `points` with the same order of modes becomes infinite;
    None where it does not grow so far.

    Static friction larger than the kinetic one holds a stick for ever from where the force no longer reaches it. Before
    that the release is nearly tangent, and its time, and with it the largest multiplier, goes as one over the distance
    of the parameter; where the orbit has two such releases by symmetry, as one over its square.
    """
    same = [point for point in points if point.order == points[-1].order]
    sizes = np.array([np.max(np.abs(point.multipliers)) for point in same])
    values = np.array([point.unknowns[-1] for point in same])
    if sizes[-1] < _LARGE[1]:
        return None
    known = np.flatnonzero((sizes > _LARGE[0]) & (sizes < _LARGE[1]))[-_FITTED:]
    if len(known) < _FITTED or np.any(np.diff(sizes[known]) <= 0):
        return None
    found = []
    for power in (1, 2):
        small = sizes[known] ** (-1 / power)
        ends = [float(BarycentricInterpolator(small[skip:], values[known[skip:]])(0.0)) for skip in (0, 1)]
        found.append((abs(ends[0] - ends[1]), ends[0]))
    return min(found)[1]
