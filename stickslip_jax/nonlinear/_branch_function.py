"""The equations of a periodic orbit as a function of its state, its period and a parameter, for continuation."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._dynamics.common.method import Exact
from .._dynamics.switched.path import StepPath
from .._excitation.excitation import motion_of
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._numerics.leaves import as_arrays
from .._status import Status
from .._sweep.setting import Setting
from .._types import AnyArray, Array, FloatArray
from .._uncertainty.numbers import Path, with_numbers
from ._cycle import Cycle, steps_in, without_turns
from ._modes import Mode, modes_between
from ._own_time import changes_by_itself
from ._period import drive_period, has_known_period

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


class Plane(NamedTuple):
    """Where an orbit that nothing drives begins: on the plane through `point` across `normal`."""

    point: Array
    normal: Array


class Equations:
    """Of unknowns (coordinates, then the period if nothing drives the system, then the parameter): the state comes
    back, and without a drive it begins on a `Plane`.
    """

    def __init__(
        self,
        setting: Setting,
        path: Path,
        driven: bool,
        duration: float,
        dtype: Any,
        is_allowed: Callable[[float], bool],
    ):
        """`duration`: of the orbit where the branch begins, s: so many periods of the drive, or one that was given.
        `is_allowed`: whether the parameter may have a value.
        """
        assert isinstance(setting.method, Exact)
        self._is_allowed, self._first = is_allowed, duration
        self._path, self.driven, self._dtype, self.itemsize = path, driven, dtype, np.dtype(dtype).itemsize
        self._setting = as_arrays(setting, dtype)
        self.names = tuple(coordinate.name for coordinate in setting.system.coordinates)
        motion = motion_of(setting.law)
        self._by_itself = driven and changes_by_itself(setting.system, setting.law, setting.y0, duration)
        known = has_known_period(setting.system, motion, self._by_itself)
        self._drive = None if known or not driven else duration
        drive = drive_period(setting.system, motion, self._drive, self._by_itself)
        self.periods = 1 if drive is None or not driven else round(duration / float(drive))
        realized = motion.realized_until(duration)
        self.steps = steps_in(setting.system, realized, setting.method, duration, by_steps=True)
        if self.steps is None:
            self.steps = setting.method.max_steps
        self._most_each = _MOST_STEPS * (self.steps or 0)
        self._capacity = None
        if driven and isinstance(motion, PiecewiseConstantLaw):
            self._capacity = motion.checked_capacity(duration) + 1

    @property
    def size(self) -> int:
        """The number of equations."""
        return len(self.names) + (not self.driven)

    def at(self, unknowns: np.ndarray, plane: Plane | None, periods: int | None = None) -> Evaluated | None:
        """The equations at a point; None where the motion cannot be followed there, or the parameter may not be.

        `periods`: of the drive; by default those of the orbit.
        """
        found = self._evaluated(unknowns, plane, self.periods if periods is None else periods)
        if found is None or int(found.status) != int(Status.FINISHED):
            return None
        value, matrix = np.asarray(found.value), np.asarray(found.matrix)
        if not (np.all(np.isfinite(value)) and np.all(np.isfinite(matrix))):
            return None
        duration = float(found.duration)
        modes = modes_between(np.asarray(found.times), np.asarray(found.signs), duration)
        return Evaluated(value, matrix, duration, modes, len(self.names))

    def _evaluated(self, unknowns: np.ndarray, plane: Plane | None, periods: int) -> "_Raw | None":
        size = len(self.names)
        if not self._is_allowed(float(unknowns[-1])) or not (self.driven or unknowns[size] > 0):
            return None
        while True:
            found = _evaluate(
                self._setting, jnp.asarray(unknowns, self._dtype), plane, path=self._path,
                driven=self.driven, by_itself=self._by_itself, periods=periods, drive=self._drive, steps=self.steps,
                capacity=self._capacity,
            )  # fmt: skip
            found = jax.tree.map(np.asarray, found)
            most = self._most_each * max(float(found.duration) / self._first, 1)
            if int(found.status) != int(Status.OUT_OF_STEPS) or not self.steps or self.steps >= most:
                return found
            self.steps *= 2

    def half_way(self, unknowns: np.ndarray, plane: Plane | None) -> np.ndarray | None:
        """What the state moves in half of the period, (coordinates,); None where the drive does not repeat itself in
        it, or the motion cannot be followed.
        """
        size = len(self.names)
        if self.driven and self.periods % 2:
            return None
        moved = np.array(unknowns, float)
        if not self.driven:
            moved[size] /= 2
        found = self.at(moved, plane, self.periods // 2 if self.driven else None)
        return None if found is None else found.value[:size]

    def plane(self, point: np.ndarray, normal: np.ndarray) -> Plane:
        """The plane through `point` across `normal`."""
        return Plane(jnp.asarray(point, self._dtype), jnp.asarray(normal, self._dtype))

    def state_after(self, unknowns: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """The state of an orbit that nothing drives at a `time` (s) after its begin, and its rates there."""
        moved, size = np.array(unknowns, float), len(self.names)
        moved[size] = time
        found = self.at(moved, self.plane(unknowns[:size], np.ones(size)))
        assert found is not None
        return unknowns[:size] + found.value[:size], found.matrix[:size, size]


class _Raw(NamedTuple):
    """The equations as they are computed, with the time and the signs at the begin of each loop step."""

    value: AnyArray
    matrix: AnyArray
    times: AnyArray
    signs: AnyArray
    status: AnyArray
    duration: AnyArray


@eqx.filter_jit
def _evaluate(
    setting: Setting, unknowns: FloatArray, plane: Plane | None, *, path: Path, driven: bool, by_itself: bool,
    periods: int, drive: float | None, steps: int | None, capacity: int | None,
) -> _Raw:  # fmt: skip
    coordinates = len(setting.system.coordinates)
    dtype = unknowns.dtype

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
        cycle = Cycle(changed.system, base, duration, method)
        run = cycle.by_steps(y)
        assert isinstance(run.path, StepPath)
        value = without_turns(setting.system, jnp.stack(run.final_state) - y)
        if plane is not None:
            value = jnp.append(value, jnp.sum(plane.normal * (y - plane.point)))
        return value, (run.path.beginnings.t, run.path.beginnings.sign, run.status, duration)

    def along(direction: FloatArray):
        return jax.jvp(function, (unknowns,), (direction,), has_aux=True)

    unit = jnp.eye(len(unknowns), dtype=dtype)
    value, matrix, (times, signs, status, duration) = jax.vmap(along, out_axes=(None, 1, None))(unit)
    return _Raw(value, matrix, times, signs, status, duration)
