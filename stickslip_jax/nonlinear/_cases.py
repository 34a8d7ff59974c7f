"""What is followed period by period: cases, each a system, what drives it, and the period after which that repeats."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._conventions import require_labels
from .._dynamics.common.method import Exact
from .._dynamics.common.time_scales import slowest_time
from .._dynamics.common.validation import Arguments, check_fixed, state_of, working_dtype
from .._excitation.excitation import BaseMotion, motion_of
from .._forks import require_threads_of_jax
from .._numerics.leaves import as_arrays
from .._sweep.checking import check_points
from .._sweep.points import Points, points_of
from .._sweep.setting import Setter, setter_of, setting_of
from .._systems.system import System
from .._types import DType, Scalar
from .._uncertainty.numbers import with_numbers
from ._cycle import Cycle, steps_in
from ._own_time import changes_by_itself
from ._period import check_signals, checked_period, drives, period_of, repetitions

Over = Mapping[str, Any]

MOST_PERIODS = 2**31 - 1
"""In all, as many as 32 bits count."""


class Cases(NamedTuple):
    """Cases to be followed: a `cycle` with a first axis (cases,) of its arrays, and where each begins, (cases,
    coordinates).

    - `shape`: of the parameters' grid, then of the starts, if there are several. `points`: values of the parameters.
    - `driven`: whether something changes with time; else the duration of a cycle is one that was asked for.
    """

    cycle: Cycle
    starts: np.ndarray
    shape: tuple[int, ...]
    points: Points | None
    setter: Setter
    driven: bool

    @property
    def system(self) -> System:
        """The system of the arguments."""
        return self.setter.setting.system

    @property
    def may_take_more(self) -> bool:
        """Whether steps are taken, and their number was not given."""
        given = self.setter.setting.method
        return self.cycle.method.max_steps is not None and given.max_steps is None

    @property
    def dtype(self) -> DType:
        """The precision of the simulations."""
        return np.asarray(self.cycle.duration).dtype

    @property
    def number(self) -> int:
        """How many cases there are."""
        return len(self.starts)

    def of(self, which: np.ndarray, starts: np.ndarray) -> "Cases":
        """Those cases alone, from other `starts` (cases, coordinates)."""
        cycle = jax.tree.map(lambda leaf: leaf[which] if eqx.is_array(leaf) else leaf, self.cycle)
        return self._replace(cycle=cycle, starts=starts, shape=(len(which),))

    def with_steps(self, factor: int) -> "Cases":
        """The same with room for so many times the steps in a period."""
        method = self.cycle.method
        if not self.may_take_more:
            return self
        assert method.max_steps is not None
        more = Exact(method.step, factor * method.max_steps, method.solver)
        return self._replace(cycle=Cycle(self.cycle.system, self.cycle.base, self.cycle.duration, more))


def checked_numbers(transient: object, kept: object, most: int = MOST_PERIODS) -> tuple[int, int]:
    """The numbers of periods, checked; at most so many in all."""
    transient = _checks.whole_number("transient", transient, minimum=0, maximum=most)
    return transient, _checks.whole_number("kept", kept, maximum=most - transient)


def cases_of(
    system: System,
    base: BaseMotion,
    y0: Any,
    over: Over | None,
    period: Scalar | None,
    method: Exact,
    *,
    for_events: bool = False,
) -> Cases:
    """The checked cases: each point of the grid `over`, from each start `y0`.

    `for_events`: to be followed in time steps, and where nothing drives the system for any time.

    Raises ValueError for what cannot be followed from period to period, and ImportError without the extra ``study``.
    """
    require_threads_of_jax()
    require_labels()
    if not isinstance(method, Exact):
        raise ValueError(f"Argument method must be Exact(...), but {_checks.show(method)} was given.")
    _check_known(system, base, y0, period)
    setting = setting_of(system, base, None, method)
    check_fixed(system=system, base=base)
    check_repeats(base)
    several = y0 is not None and _checks.dimensions(y0) == 2
    starts = _starts(system, y0) if several else np.asarray([state_of(system, y0)], float)
    setting = setting._replace(y0=tuple(map(float, starts[0])))
    points = None if over is None else points_of(over)
    setter = setter_of(setting, () if points is None else points.parameters)
    rows = np.zeros((1, 0))
    if points is not None:
        check_points(setter, points, lambda point: setter(points.values(point)))
        rows = np.array([points.values(point) for point in range(points.number)], float)
    cycle, begins, driven = _cycles(setter, np.repeat(rows, len(starts), axis=0), checked_period(period), for_events)
    if several:
        begins = np.tile(starts, (len(rows), 1))
    shape = (() if points is None else points.shape) + ((len(starts),) if several else ())
    return Cases(cycle, begins, shape, points, setter, driven)


def _check_known(*arguments: object) -> None:
    """Raise ValueError where JAX traces a number of the arguments."""
    if _checks.holds_traced(*arguments):
        raise ValueError(
            "Sections, diagrams, basins and exponents need numbers, but JAX is tracing an argument: call them outside "
            "jit, vmap and grad, with many starts in y0 and values of parameters in over. periodic_orbit can be "
            "transformed."
        )


def _starts(system: System, y0: Any) -> np.ndarray:
    """Several starts, (starts, coordinates), checked."""
    rows = _checks.numbers("y0", y0, ndim=2)
    if not len(rows) or not np.all(np.isfinite(rows)):
        raise _checks.refused("y0", "hold at least one start, and finite numbers", y0)
    left_out = np.asarray(state_of(system, tuple(rows[0]))[rows.shape[1] :], float)  # ages of sticks
    return np.concatenate([rows, np.broadcast_to(left_out, (len(rows), len(left_out)))], axis=1, dtype=float)


def check_repeats(base: BaseMotion) -> None:
    """Raise ValueError for a base that is random."""
    if motion_of(base).is_random:
        raise ValueError(
            f"Argument base must repeat itself, but the random law {type(base).__name__} was given; simulate_ensemble "
            "gives its statistics, and base.sample(key, period), a realisation, repeats itself after the period that "
            "you give."
        )


def _cycles(
    setter: Setter, rows: np.ndarray, period: Scalar | None, for_events: bool
) -> tuple[Cycle, np.ndarray, bool]:
    """The cycle of each row of values, (cases, parameters), its start, and whether anything drives the system."""
    dtype, method = working_dtype(stacklevel=6), setter.setting.method
    assert isinstance(method, Exact)
    columns, of_all = setter.columns(rows)
    paths = tuple(columns)
    numbers = np.stack([columns[path] for path in paths], axis=1) if paths else np.zeros((len(rows), 0))
    given = setter.setting
    by_itself = changes_by_itself(given.system, given.law, given.y0, period)
    found = repetitions(of_all.system, motion_of(of_all.law), by_itself)
    if for_events and period is None and not drives(found):
        period = slowest_time(given.system, given.law)
    duration, driven = period_of(found, period)
    Arguments(setter.setting.system, setter.setting.law, method, float(np.max(duration))).check_length()
    durations = jnp.broadcast_to(jnp.asarray(duration, dtype), (len(rows),))
    setting = as_arrays(setter.setting, dtype)
    most: list[int | None] = []

    # Under vmap outside jit, what sizes of arrays depend on is known (`known.values_of`).
    def one(row, duration):
        changed = with_numbers(setting, paths, row)
        base = motion_of(changed.law).realized_until(duration)
        most.append(steps_in(changed.system, base, changed.method, duration, by_steps=for_events))
        return changed.system, base, duration, jnp.stack([jnp.asarray(number, dtype) for number in changed.y0])

    every, base, durations, begins = eqx.filter_vmap(one)(jnp.asarray(numbers, dtype), durations)
    if driven:
        check_signals((every, base), durations)
    if most[-1] is not None:
        method = Exact(method.step, most[-1], method.solver)
    return Cycle(every, base, durations, method), np.asarray(begins), driven
