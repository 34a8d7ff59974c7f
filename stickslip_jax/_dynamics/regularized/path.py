"""One trajectory of regularised dynamics, in fixed or adaptive steps, and the state along it."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..._events.sticks import sticks_in_order
from ..._excitation.excitation import Drive, drive_of
from ..._excitation.segments import open_feed
from ..._excitation.voltage import SourceVoltage
from ..._numerics.known import NotKnown
from ..._systems.switched_model import State
from ..._types import Array, FloatArray, IntArray, Scalar
from ..blocks import few_sizes, scan_in_blocks
from ..method import Regularized
from ..path import Path, Run
from ..switched.engine import Streams, has_ended, status_of_lane
from ..time_scales import room_to_give, step_for
from .engine import Passage, advance_fixed, nothing_seen, start_fixed
from .lanes import criterion_of, field_of
from .settings import as_arrays, fixed_steps, settled
from .solve import Solver, Tables, solve_adaptive, start_watching, table_sizes, watch_one
from .stick_detector import Watch, hermite

_NO_WORDS = np.zeros(2, np.uint32)  # a realisation draws nothing


class CubicPath(Path):
    """The states at the ends of all steps and the rates there; a cubic for each state in between.

    `t` (s) and `y` have an entry for the beginning of each step and one for the end of the last.
    """

    drive: Drive
    tables: Tables
    t: Array
    y: State
    rates: State
    end_rates: State

    @classmethod
    def of(cls, drive: Drive, tables: Tables, passages: Passage, steps: IntArray, last: FloatArray, final: State):
        """From the first `steps` passages (the others are empty), and where the last one ended."""
        live = jnp.arange(len(passages.t)) < steps

        def closed(values, end):
            return jnp.append(jnp.where(live, values, end), end)

        y = tuple(closed(values, end) for values, end in zip(passages.y, final, strict=True))
        return cls(drive, tables, closed(passages.t, last), y, passages.rates, passages.end_rates)

    @property
    def times(self) -> Array:
        return self.t[:-1]

    def state(self, time: FloatArray) -> State:
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0, len(self.t) - 2)
        tau, h = time - self.t[index], self.t[index + 1] - self.t[index]
        return tuple(
            hermite(tau, h, y[index], rate[index], y[index + 1], end_rate[index])
            for y, rate, end_rate in zip(self.y, self.rates, self.end_rates, strict=True)
        )

    def base_velocity(self, time: FloatArray) -> FloatArray:
        velocity = jnp.zeros_like(time)
        if self.drive.signal is not None and not isinstance(self.drive.signal, SourceVoltage):
            velocity = velocity + self.drive.signal.value(time)
        for piece in self.tables.at(time).base:
            velocity = velocity + piece.value + piece.slope * (time - piece.begin)
        return velocity


class _Setting(NamedTuple):
    """What one trajectory is made from, as arrays."""

    system: Any
    drive: Drive
    method: Regularized
    t1: Array
    y0: tuple[Any, ...]


def follow_regularized(
    system: Any, base: Any, method: Regularized, t1: Scalar, y0: tuple[Any, ...], dtype
) -> tuple[Regularized, Run]:
    """One trajectory, and the method with every option filled in."""
    drive = drive_of(base)
    system.check_drive(drive)
    given, method = method, settled(system, drive, method, dtype)
    if given.step is not None:
        step_for(system, drive, given)  # refuses one that is too long
    steps = method.max_steps or _fixed_steps(system, drive, given, t1)
    sizes = table_sizes(system, drive, t1)
    system, drive, t1, y0 = as_arrays((system, drive, t1, y0), dtype)
    follow = _follow_adaptive if method.step is None else _follow_fixed
    return method, follow(_Setting(system, drive, method, jnp.asarray(t1), y0), steps, sizes)


def _fixed_steps(system: Any, drive: Drive, method: Regularized, t1: Scalar) -> int:
    """How many fixed steps the trajectory takes."""
    try:
        return few_sizes(fixed_steps(system, drive, method, t1))
    except NotKnown:
        raise ValueError(
            "Argument method must give max_steps, Regularized(..., max_steps=...), when t1 or the step is an argument "
            f"of a function under jax.jit: {room_to_give(system, drive, method, t1)}."
        ) from None


@eqx.filter_jit
def _follow_fixed(setting: _Setting, steps: int, sizes: tuple[int, ...]) -> Run:
    system, drive, method, t1, y0 = setting
    dtype = t1.dtype
    field, streams, criterion = field_of(system, drive.signal, method), Streams.of(system, drive), criterion_of(method)
    feeds = tuple(open_feed(law, _NO_WORDS, dtype) for law in streams.all)
    start = start_fixed(field, streams, criterion, feeds, y0, dtype)

    most = jnp.asarray(steps, jnp.int32)

    def turn(lane, _):
        lane, record, passage = advance_fixed(field, streams, criterion, t1, jnp.asarray(method.step), most, lane)
        return lane, (record, passage)

    lane, (records, passages) = scan_in_blocks(
        turn, start, steps, lambda lane, _: has_ended(lane, t1, most), lambda lane: nothing_seen(lane.y)
    )
    tables = Tables.of(system, drive, _NO_WORDS, sizes, dtype)
    path = CubicPath.of(drive, tables, passages, lane.turns, lane.t, lane.y)
    return _run(records, lane.watch, status_of_lane(lane, t1), lane.t, lane.y, path)


@eqx.filter_jit
def _follow_adaptive(setting: _Setting, steps: int, sizes: tuple[int, ...]) -> Run:
    system, drive, method, t1, y0 = setting
    field, criterion = field_of(system, drive.signal, method), criterion_of(method)
    dtype = t1.dtype
    tables = Tables.of(system, drive, _NO_WORDS, sizes, dtype)
    solution = solve_adaptive(field, tables, t1, y0, Solver.of(method), steps)

    def turn(watch, index):
        watch, record, passage = watch_one(field, tables, criterion, t1, solution, watch, index)
        return watch, (record, passage)

    start = start_watching(field, tables, criterion, solution.y[0])
    watch, (records, passages) = scan_in_blocks(
        turn, start, steps, lambda _, index: index >= solution.steps, lambda _: nothing_seen(tuple(solution.y[0]))
    )
    final = tuple(solution.y[solution.steps])
    path = CubicPath.of(drive, tables, passages, solution.steps, solution.time_reached, final)
    return _run(records, watch, solution.status, solution.time_reached, final, path)


def _run(records: Any, watch: Watch, status: IntArray, time_reached: FloatArray, final: State, path: Path) -> Run:
    none = jnp.zeros((), jnp.int32)
    return Run(sticks_in_order(*records), watch.totals, status, time_reached, final, none, path)
