"""The engine of regularised dynamics: many trajectories, or one with its states."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._excitation.excitation import Excitation, excitation_of
from ..._excitation.motion import Signal
from ..._foundation import checks
from ..._foundation.types import AnyArray, AnyInteger, BoolArray, DType, FloatArray, IntArray, Number, Scalar
from ..._numerics.derivatives import NotKnown, with_slopes
from ..._numerics.elementary import random_words
from ..._systems.contacts import ContactsModel
from ..._systems.switched_model import Segments, State
from ..._systems.system import System, one_contact_model
from ..common.lanes import Engine, SampleTotals, with_leaves
from ..common.method import Regularized, longest_step, max_steps_advice, step_for
from ..common.path import (
    MotionPath,
    Run,
    SegmentLaws,
    has_ended,
    is_short,
    largest_in_steps,
    of_track,
    padded_length,
    status_of_lane,
    stopping_scan,
)
from ..sticks import ALL, StickRecord, Totals, count_slips, no_stick
from .field import AnyField, ContactsField, Field, InnerField
from .implicit_step import Switch
from .solve import (
    ADAPTIVE_STEPS,
    CLOSING,
    MORE,
    FixedLane,
    PathStep,
    Tables,
    advance_fixed,
    detect_in_step,
    fixed_steps,
    nothing_seen,
    numbers_as_arrays,
    resolved,
    solve_adaptive,
    start_detection,
    start_fixed,
    status_of,
    table_sizes,
)
from .sticks import Criterion, hermite

# Many trajectories of regularised dynamics: lanes of fixed steps, and whole batches of adaptive ones.


class FixedShared(NamedTuple):
    """Quantities that all steps share: the segment laws, the criterion of a stick, the horizon and the step (s)."""

    segment_laws: SegmentLaws
    criterion: Criterion
    t1: Array
    step: Array
    most_steps: Array


class FixedEngine(Engine[FixedShared, Signal | None, FixedLane, StickRecord, SampleTotals]):
    """Any system under any excitation, up to `t1`, from `y0`, in fixed steps.

    `method`: with every option filled in (`resolved`). A sample that needs more than `most_steps` is given up.
    `quantities` of each stick: those asked for. The constant of a sample is the smooth part of its excitation.
    """

    system: System
    excitation: Excitation
    method: Regularized
    t1: Scalar
    y0: tuple[Number, ...]
    most_steps: AnyInteger
    quantities: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def tracks(self) -> int | None:
        return self.system.tracks.number

    @property
    def compiles_natively(self) -> bool:
        return self.system.traits.compiles_natively

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Signal | None, FixedLane]:
        smooth = _realized(self.excitation, key_data, dtype)
        y0 = tuple(jnp.asarray(value, dtype) for value in self.y0)
        words, segment_laws = self.excitation.segment_key_data(key_data), SegmentLaws.of(self.system, self.excitation)
        field, criterion = switched_field(self.system, smooth, self.method), criterion_of(self.method)
        return smooth, start_fixed(field, segment_laws, criterion, words, y0, dtype, self.quantities)

    def shared(self, dtype) -> FixedShared:
        laws, most = SegmentLaws.of(self.system, self.excitation), jnp.asarray(self.most_steps, jnp.int32)
        t1, step = jnp.asarray(self.t1, dtype), jnp.asarray(self.method.step, dtype)
        return FixedShared(laws, criterion_of(self.method), t1, step, most)

    def step(
        self, shared: FixedShared, sample: Signal | None, motion: FixedLane, drawn: None
    ) -> tuple[FixedLane, StickRecord]:
        lane, stick, _ = advance_fixed(switched_field(self.system, sample, self.method), *shared, motion)
        return lane, of_track(stick, self.system)

    def ended(self, motion: FixedLane, before: FixedLane) -> BoolArray:
        return has_ended(motion, jnp.asarray(self.t1, motion.t.dtype), jnp.asarray(self.most_steps, jnp.int32))

    def results(self, sample: Signal | None, motion: FixedLane) -> SampleTotals:
        status = status_of_lane(motion, jnp.asarray(self.t1, motion.t.dtype))
        return _results(motion.detector.totals, motion.detector.at_start, self.system, status)


class AdaptiveBatch(NamedTuple):
    """Samples of any system under any excitation that diffrax solves together, each in its own steps.

    `method`: with every option filled in. `longest_step`: of any sample, s (`method.py`). `sizes`: number
    of segments to draw for each part of the excitation (`table_sizes`). The slowest sample determines the time of the
    batch.
    """

    system: System
    excitation: Excitation
    method: Regularized
    t1: Scalar
    y0: tuple[Number, ...]
    longest_step: Scalar
    sizes: tuple[AnyInteger, ...]


def solve_batch(
    batch: AdaptiveBatch,
    varying: tuple[AnyArray, ...],
    key_data: Array,
    realization: AnyArray,
    used: AnyInteger,
    *,
    samples: int,
    leaf_numbers: tuple[int, ...],
    sizes: tuple[int, ...],
    most: int,
    keep: bool,
    dtype: DType,
) -> tuple[SampleTotals, StickRecord | None]:
    """Solve samples of a key; with `keep`, also a `StickRecord` (samples, steps).

    `realization` (samples,): the number that each draws its excitation by. `used`: number of samples that are needed;
    the others end at once. `most`: the largest number of steps of each. `varying`, `leaf_numbers`: the leaves of the
    batch that differ from sample to sample, arrays (samples, ...), and which these are. `sizes`: those of the batch.
    """
    t1, quantities, tracks = jnp.asarray(batch.t1, dtype), ALL if keep else (), batch.system.tracks.number

    def one(place, number, varying):
        words = random_words(key_data, number)
        here = with_leaves(batch, leaf_numbers, varying)
        method = here.method
        smooth = _realized(here.excitation, words, dtype)
        tables = Tables.of(here.system, here.excitation, words, sizes, dtype)
        field, criterion = field_of(here.system, smooth, method), criterion_of(method)
        y0, until = tuple(jnp.asarray(value, dtype) for value in here.y0), jnp.where(place < used, t1, 0)
        solution = solve_adaptive(field, tables, until, y0, method, here.longest_step, most)

        def one_step(detector, index):
            detector, record, _ = detect_in_step(field, tables, criterion, until, solution, detector, index)
            return detector, of_track(record, here.system) if keep else None

        start = start_detection(field, tables, criterion, solution.y[0], quantities)
        detector, records = stopping_scan(
            one_step,
            start,
            most + CLOSING,
            lambda _, index: index >= solution.seen_steps,
            lambda _: no_stick(dtype, quantities, () if tracks is None else (tracks,)) if keep else None,
        )
        return detector, status_of(solution, detector), records

    detectors, statuses, records = jax.vmap(one)(
        jnp.arange(samples, dtype=jnp.uint32), jnp.asarray(realization, jnp.uint32), varying
    )
    return _results(detectors.totals, detectors.at_start, batch.system, statuses), records


def field_of(system: System, smooth: Signal | None, method: Regularized) -> AnyField:
    """The regularised field of `system` under a realised smooth excitation."""
    inner = system.inner_model(smooth)
    return switched_field(system, smooth, method) if inner is None else InnerField(inner)


def switched_field(system: System, smooth: Signal | None, method: Regularized) -> Field | ContactsField:
    """The same of friction laws without inner states, which fixed steps can follow too."""
    assert method.width is not None
    model, switch = system.switched_model(smooth, None), Switch(method.width, method.shape)
    if isinstance(model, ContactsModel):
        return ContactsField(model, switch, criterion_of(method).threshold, system.static_exceeds_kinetic)
    return Field(one_contact_model(system, smooth, None), switch)


def criterion_of(method: Regularized) -> Criterion:
    """The criterion of a stick in `method`, which has every option filled in."""
    assert method.threshold is not None
    assert method.minimum_duration is not None
    return Criterion(method.threshold, method.minimum_duration)


def _realized(excitation: Excitation, key_data: Any, dtype) -> Signal | None:
    return jax.tree.map(lambda number: jnp.asarray(number, dtype), excitation.realized(key_data, dtype))


def _results(totals: Totals, at_start: BoolArray, system: System, status: IntArray) -> SampleTotals:
    totals, at_start = of_track((totals, at_start), system)
    return SampleTotals(
        sticks=totals.sticks,
        slips=count_slips(totals, at_start),
        stick_time=totals.stick_time,
        status=status,
        near_grazing_count=jnp.zeros(status.shape, totals.sticks.dtype),
    )


# One trajectory of regularised dynamics, in fixed or adaptive steps, and the state along it.


_MOST_SLOPES = 8  # by more numbers, going back over the steps takes less time
_NO_KEY_DATA = np.zeros(2, np.uint32)  # a realisation draws nothing


class CubicPath(MotionPath):
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
        cls, excitation: Excitation, tables: Tables, passages: PathStep, steps: IntArray, last: FloatArray, final: State
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


class _Arguments(NamedTuple):
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
        if checks.is_traced(step):
            method = dataclasses.replace(method, step=lax.stop_gradient(jnp.asarray(step, dtype)))
    adaptive = method.step is None
    steps = method.max_steps or ADAPTIVE_STEPS
    if not adaptive and method.max_steps is None:
        try:
            steps = padded_length(fixed_steps(system, excitation, given, t1))
        except NotKnown:
            raise ValueError(
                "Argument method must give max_steps, Regularized(..., max_steps=...), when t1 or the step is an "
                f"argument of a function under jax.jit: {max_steps_advice(system, excitation, given, t1)}."
            ) from None
    sizes = table_sizes(system, excitation, t1)
    longest = longest_step(system, excitation) if adaptive else math.inf
    system, excitation, t1, y0, longest = numbers_as_arrays((system, excitation, t1, y0, longest), dtype)
    setting = _Arguments(system, excitation, method, jnp.asarray(t1), y0, longest)
    if not adaptive:
        return method, _follow_fixed(setting, steps, sizes)
    run: Run = _follow_adaptive(setting, steps, sizes)
    while given.max_steps is None and steps < ADAPTIVE_STEPS * MORE**2 and is_short(run.status):
        steps *= MORE
        run = _follow_adaptive(setting, steps, sizes)
    return dataclasses.replace(method, max_steps=steps), run


@eqx.filter_jit
def _follow_fixed(setting: _Arguments, steps: int, sizes: tuple[int, ...]) -> Run:
    system, excitation, method, t1, *_ = setting
    # Tolerances are for adaptive steps, and the shortest duration only decides: neither has a derivative.
    method = dataclasses.replace(method, atol=None, minimum_duration=lax.stop_gradient(method.minimum_duration))

    def loop(setting: _Arguments) -> tuple[FixedLane, tuple[StickRecord, PathStep]]:
        system, excitation, method, t1, y0, _ = setting
        field, segment_laws = switched_field(system, excitation.signal, method), SegmentLaws.of(system, excitation)
        criterion, most = criterion_of(method), jnp.asarray(steps, jnp.int32)
        step = jnp.asarray(method.step)

        def one_step(lane, _):
            lane, record, passage = advance_fixed(field, segment_laws, criterion, t1, step, most, lane)
            return lane, (record, passage)

        return stopping_scan(
            one_step,
            start_fixed(field, segment_laws, criterion, _NO_KEY_DATA, y0, t1.dtype, ALL),
            steps,
            lambda lane, _: has_ended(lane, t1, most),
            lambda lane: nothing_seen(field.model.numbers(lane.y), field.model.contacts),
        )

    lane, (records, passages) = with_slopes(loop, setting._replace(method=method), most=_MOST_SLOPES)
    tables = Tables.of(system, excitation, _NO_KEY_DATA, sizes, t1.dtype)
    final = system.switched_model(excitation.signal, None).numbers(lane.y)
    path = CubicPath.of(excitation, tables, passages, lane.steps, lane.t, final)
    none, status = jnp.zeros((), jnp.int32), status_of_lane(lane, t1)
    return Run.of(system, records, lane.detector.totals, status, lane.t, final, none, path)


@eqx.filter_jit
def _follow_adaptive(setting: _Arguments, steps: int, sizes: tuple[int, ...]) -> Run:
    system, excitation, method, t1, y0, longest = setting
    field, criterion = field_of(system, excitation.signal, method), criterion_of(method)
    dtype = t1.dtype
    tables = Tables.of(system, excitation, _NO_KEY_DATA, sizes, dtype)
    solution = solve_adaptive(field, tables, t1, y0, method, longest, steps)

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
    none, status = jnp.zeros((), jnp.int32), status_of(solution, detector)
    return Run.of(system, records, detector.totals, status, solution.time_reached, final, none, path)
