"""Many trajectories of regularised dynamics: lanes of fixed steps, and whole batches of adaptive ones."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._events.records import StickRecord, count_slips, no_stick
from ..._excitation.excitation import Excitation
from ..._excitation.random import realised_state
from ..._excitation.segments import first_segment
from ..._excitation.smooth import Signal
from ..._numerics.random_bits import random_words
from ..._types import AnyInteger, Array, BoolArray, IntArray, Scalar
from ..blocks import scan_in_blocks
from ..lanes import BLOCK, Engine, LaneResults, Records
from ..method import Regularized
from ..switched.engine import SegmentLaws, has_ended, status_of_lane
from .engine import Field, FixedLane, advance_fixed, start_fixed
from .solve import Solver, Tables, detect_in_step, solve_adaptive, start_detection
from .stick_detector import Criterion, StickDetector
from .switch import Switch


class _Lanes(NamedTuple):
    """The state of every lane, and the smooth drive of its sample."""

    lane: FixedLane
    smooth: Signal | None


class FixedEngine(Engine):
    """Any system under any drive, up to `t1`, from `y0` (numbers, or `Uniform` values), in fixed steps.

    `method`: with every option filled in (`resolved`). A sample that takes more than `most_steps` is given up.
    """

    system: Any
    excitation: Excitation
    method: Regularized
    t1: Scalar
    y0: tuple[Any, ...]
    most_steps: AnyInteger

    def begin(self, key_data: tuple[Array, Array], dtype) -> _Lanes:
        smooth = _realised(self.excitation, key_data, dtype)
        y0 = realised_state(self.y0, key_data, dtype)
        segment_laws, own = SegmentLaws.of(self.system, self.excitation), self.excitation.segment_key_data(key_data)
        segment_states = tuple(first_segment(law, own, dtype) for law in segment_laws.all)
        field = field_of(self.system, smooth, self.method)
        return _Lanes(start_fixed(field, segment_laws, criterion_of(self.method), segment_states, y0, dtype), smooth)

    def advance(self, state: _Lanes, dtype, buffer: Records | None, slot: Array | int) -> tuple[_Lanes, Records | None]:
        segment_laws, criterion = SegmentLaws.of(self.system, self.excitation), criterion_of(self.method)
        t1, step = jnp.asarray(self.t1, dtype), jnp.asarray(self.method.step, dtype)
        most = jnp.asarray(self.most_steps, jnp.int32)

        def step_one(lane, smooth):
            field = field_of(self.system, smooth, self.method)
            lane, stick, _ = advance_fixed(field, segment_laws, criterion, t1, step, most, lane)
            return lane, (jnp.stack(stick[:3]), stick.ending)

        def one_step(carry, _):
            lanes, buffer, slot = carry
            lanes, sticks = jax.vmap(step_one, out_axes=(0, (1, 0)))(lanes, state.smooth)
            return (lanes, buffer if buffer is None else buffer.with_slot(slot, *sticks), slot + 1), None

        (lanes, buffer, _), _ = lax.scan(one_step, (state.lane, buffer, slot), None, length=BLOCK)
        return _Lanes(lanes, state.smooth), buffer

    def ended(self, state: _Lanes) -> BoolArray:
        most = jnp.asarray(self.most_steps, jnp.int32)
        return jax.vmap(lambda lane: has_ended(lane, jnp.asarray(self.t1, lane.t.dtype), most))(state.lane)

    def results(self, state: _Lanes) -> LaneResults:
        def status(lane):
            return status_of_lane(lane, jnp.asarray(self.t1, lane.t.dtype))

        return _results(state.lane.detector, jax.vmap(status)(state.lane))


class AdaptiveBatch(NamedTuple):
    """Samples of any system under any drive that diffrax solves together, each in its own steps.

    `method`: with every option filled in. The slowest sample of a batch sets its time.
    """

    system: Any
    excitation: Excitation
    method: Regularized
    t1: Scalar
    y0: tuple[Any, ...]


def solve_batch(
    batch: AdaptiveBatch,
    key_data: Array,
    first: AnyInteger,
    used: AnyInteger,
    *,
    samples: int,
    sizes: tuple[int, ...],
    keep: bool,
    dtype: Any,
) -> tuple[LaneResults, StickRecord | None]:
    """Samples ``first .. first + samples - 1`` of a key; with `keep`, a `StickRecord` (samples, steps) too.

    `used`: how many of them are asked for; the others end at once. `sizes`: how many segments of each part of the
    excitation to draw (`table_sizes`).
    """
    places = jnp.arange(samples, dtype=jnp.uint32)
    method, t1 = batch.method, jnp.asarray(batch.t1, dtype)
    assert method.max_steps is not None
    most = method.max_steps

    def one(place):
        own = random_words(key_data, jnp.asarray(first, jnp.uint32) + place)
        smooth = _realised(batch.excitation, own, dtype)
        tables = Tables.of(batch.system, batch.excitation, own, sizes, dtype)
        field, criterion = field_of(batch.system, smooth, method), criterion_of(method)
        y0, until = realised_state(batch.y0, own, dtype), jnp.where(place < used, t1, 0)
        solution = solve_adaptive(field, tables, until, y0, Solver.of(method), most)

        def one_step(detector, index):
            detector, record, _ = detect_in_step(field, tables, criterion, until, solution, detector, index)
            return detector, record if keep else None

        start = start_detection(field, tables, criterion, solution.y[0])
        detector, records = scan_in_blocks(
            one_step,
            start,
            most,
            lambda _, index: index >= solution.steps,
            lambda _: no_stick(dtype) if keep else None,
        )
        return detector, solution.status, records

    detectors, statuses, records = jax.vmap(one)(places)
    return _results(detectors, statuses), records


def field_of(system: Any, smooth: Signal | None, method: Regularized) -> Field:
    """The regularised field of `system` under a realised smooth drive."""
    return Field(system.switched_model(smooth, None), Switch(method.width, method.shape))


def criterion_of(method: Regularized) -> Criterion:
    """What counts as a stick; `method` with every option filled in."""
    assert method.threshold is not None
    assert method.minimum_duration is not None
    return Criterion(method.threshold, method.minimum_duration)


def _realised(excitation: Excitation, key_data: Any, dtype) -> Signal | None:
    return jax.tree.map(lambda number: jnp.asarray(number, dtype), excitation.realised(key_data, dtype))


def _results(detector: StickDetector, status: IntArray) -> LaneResults:
    return LaneResults(
        sticks=detector.totals.sticks,
        slips=count_slips(detector.totals, detector.at_start),
        stick_time=detector.totals.stick_time,
        status=status,
        near_grazing_count=jnp.zeros_like(detector.totals.sticks),
    )
