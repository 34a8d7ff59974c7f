"""One trajectory of regularised dynamics, in fixed or adaptive steps, and the state along it."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ... import _checks
from ..._events.stick_quantities import ALL
from ..._events.sticks import StickRecord, Totals
from ..._excitation.excitation import Excitation, excitation_of
from ..._excitation.segments import first_segment
from ..._excitation.smooth import Signal
from ..._numerics.known import NotKnown
from ..._numerics.slopes import with_slopes
from ..._systems.switched_model import Segments, State
from ..._systems.system import System
from ..._types import Array, FloatArray, IntArray, Number, Scalar
from ..common.ending import has_ended, is_short, status_of_lane
from ..common.extremes import largest_in_steps
from ..common.method import Regularized
from ..common.path import Path, Run
from ..common.segments import SegmentLaws
from ..common.stopping_scan import padded_length, stopping_scan
from ..common.time_scales import longest_step, max_steps_advice, step_for
from ..common.tracks import sticks_and_totals
from .engine import criterion_of, field_of, switched_field
from .settings import ADAPTIVE_STEPS, MORE, fixed_steps, numbers_as_arrays, resolved
from .solve import CLOSING, Solver, Tables, detect_in_step, solve_adaptive, start_detection, status_of, table_sizes
from .stepping import FixedLane, Passage, advance_fixed, nothing_seen, start_fixed
from .stick_detector import hermite

_MOST_SLOPES = 8  # by more numbers, going back over the steps takes less time
_NO_KEY_DATA = np.zeros(2, np.uint32)  # a realisation draws nothing


class CubicPath(Path):
    """Path given by the states and rates at the ends of all steps, with a cubic for each state in between.

    `t` (s) and `y` have an entry for the beginning of each step and one for the end of the last.
    """

    excitation: Excitation
    tables: Tables
    t: Array
    y: State
    rates: State
    end_rates: State

    @classmethod
    def of(
        cls, excitation: Excitation, tables: Tables, passages: Passage, steps: IntArray, last: FloatArray, final: State
    ):
        """The path of the first `steps` passages (the others are empty), which ends at time `last` in `final`."""
        live = jnp.arange(len(passages.t)) < steps

        def closed(values, end):
            return jnp.append(jnp.where(live, values, end), end)

        y = tuple(closed(values, end) for values, end in zip(passages.y, final, strict=True))
        return cls(excitation, tables, closed(passages.t, last), y, passages.rates, passages.end_rates)

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

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        columns = (self.y[number][:-1], self.rates[number], self.y[number][1:], self.end_rates[number])
        lengths = jnp.diff(self.t)

        def inside(step: tuple[State, FloatArray], tau: FloatArray) -> tuple[FloatArray, FloatArray]:
            return jax.jvp(lambda tau: sign * hermite(tau, step[1], *step[0]), (tau,), (jnp.ones_like(tau),))

        return largest_in_steps(inside, (columns, lengths), sign * columns[0], lengths, sign * final)

    @property
    def smooth(self) -> Signal | None:
        return self.excitation.signal

    def segments(self, time: FloatArray) -> Segments:
        return self.tables.at(time)


class _Setting(NamedTuple):
    """Arguments of one simulation, with numbers as arrays."""

    system: System
    excitation: Excitation
    method: Regularized
    t1: Array
    y0: tuple[Number, ...]
    longest_step: Scalar  # of adaptive steps, s


def follow_regularized(
    system: System, base: Any, method: Regularized, t1: Scalar, y0: tuple[Number, ...], dtype
) -> tuple[Regularized, Run]:
    """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
    excitation = excitation_of(base)
    system.check_excitation(excitation)
    given, method = method, resolved(system, excitation, method, dtype)
    if given.step is not None:
        step = step_for(system, excitation, given)  # raises for a step that is too long; shortens it where traced
        if _checks.is_traced(step):
            method = dataclasses.replace(method, step=lax.stop_gradient(jnp.asarray(step, dtype)))
    adaptive = method.step is None
    steps = method.max_steps or (ADAPTIVE_STEPS if adaptive else _fixed_steps(system, excitation, given, t1))
    sizes = table_sizes(system, excitation, t1)
    longest = longest_step(system, excitation) if adaptive else math.inf
    system, excitation, t1, y0, longest = numbers_as_arrays((system, excitation, t1, y0, longest), dtype)
    setting = _Setting(system, excitation, method, jnp.asarray(t1), y0, longest)
    if not adaptive:
        return method, _follow_fixed(setting, steps, sizes)
    run: Run = _follow_adaptive(setting, steps, sizes)
    while given.max_steps is None and steps < ADAPTIVE_STEPS * MORE**2 and is_short(run.status):
        steps *= MORE
        run = _follow_adaptive(setting, steps, sizes)
    return dataclasses.replace(method, max_steps=steps), run


def _fixed_steps(system: System, excitation: Excitation, method: Regularized, t1: Scalar) -> int:
    """Upper bound of the number of fixed steps of the trajectory."""
    try:
        return padded_length(fixed_steps(system, excitation, method, t1))
    except NotKnown:
        raise ValueError(
            "Argument method must give max_steps, Regularized(..., max_steps=...), when t1 or the step is an argument "
            f"of a function under jax.jit: {max_steps_advice(system, excitation, method, t1)}."
        ) from None


def _fixed_loop(setting: _Setting, steps: int) -> tuple[FixedLane, tuple[StickRecord, Passage]]:
    system, excitation, method, t1, y0, _ = setting
    dtype = t1.dtype
    field, segment_laws, criterion = (
        switched_field(system, excitation.signal, method),
        SegmentLaws.of(system, excitation),
        criterion_of(method),
    )
    segment_states = tuple(first_segment(law, _NO_KEY_DATA, dtype) for law in segment_laws.all)
    start = start_fixed(field, segment_laws, criterion, segment_states, y0, dtype, ALL)

    most = jnp.asarray(steps, jnp.int32)

    def one_step(lane, _):
        lane, record, passage = advance_fixed(field, segment_laws, criterion, t1, jnp.asarray(method.step), most, lane)
        return lane, (record, passage)

    return stopping_scan(
        one_step,
        start,
        steps,
        lambda lane, _: has_ended(lane, t1, most),
        lambda lane: nothing_seen(field.model.numbers(lane.y), field.model.contacts),
    )


@eqx.filter_jit
def _follow_fixed(setting: _Setting, steps: int, sizes: tuple[int, ...]) -> Run:
    system, excitation, method, t1, *_ = setting
    # Tolerances are for adaptive steps, and the shortest duration only decides: neither has a derivative.
    method = dataclasses.replace(method, atol=None, minimum_duration=lax.stop_gradient(method.minimum_duration))
    setting = setting._replace(method=method)
    lane, (records, passages) = with_slopes(lambda setting: _fixed_loop(setting, steps), setting, most=_MOST_SLOPES)
    tables = Tables.of(system, excitation, _NO_KEY_DATA, sizes, t1.dtype)
    final = system.switched_model(excitation.signal, None).numbers(lane.y)
    path = CubicPath.of(excitation, tables, passages, lane.steps, lane.t, final)
    return _run(records, lane.detector.totals, system, status_of_lane(lane, t1), lane.t, final, path)


@eqx.filter_jit
def _follow_adaptive(setting: _Setting, steps: int, sizes: tuple[int, ...]) -> Run:
    system, excitation, method, t1, y0, longest = setting
    field, criterion = field_of(system, excitation.signal, method), criterion_of(method)
    dtype = t1.dtype
    tables = Tables.of(system, excitation, _NO_KEY_DATA, sizes, dtype)
    solution = solve_adaptive(field, tables, t1, y0, Solver.of(method, longest), steps)

    def one_step(detector, index):
        detector, record, passage = detect_in_step(field, tables, criterion, t1, solution, detector, index)
        return detector, (record, passage)

    start = start_detection(field, tables, criterion, solution.y[0], ALL)
    detector, (records, passages) = stopping_scan(
        one_step,
        start,
        steps + CLOSING,
        lambda _, index: index >= solution.seen_steps,
        lambda _: nothing_seen(tuple(solution.y[0]), field.model.contacts),
    )
    final = tuple(solution.y[solution.steps])
    path = CubicPath.of(excitation, tables, passages, solution.steps, solution.time_reached, final)
    return _run(records, detector.totals, system, status_of(solution, detector), solution.time_reached, final, path)


def _run(
    records: Any,
    totals: Totals,
    system: System,
    status: IntArray,
    time_reached: FloatArray,
    final: State,
    path: Path,
) -> Run:
    none = jnp.zeros((), jnp.int32)
    sticks, totals, of_all = sticks_and_totals(records, totals, system)
    return Run(sticks, totals, status, time_reached, final, none, path, of_all)
