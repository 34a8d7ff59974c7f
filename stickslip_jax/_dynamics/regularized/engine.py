"""Many trajectories of regularised dynamics: lanes of fixed steps, and whole batches of adaptive ones."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._events.stick_quantities import ALL
from ..._events.sticks import StickRecord, Totals, count_slips, no_stick
from ..._excitation.excitation import Excitation
from ..._excitation.segments import first_segment
from ..._excitation.smooth import Signal
from ..._numerics.random_bits import random_words
from ..._systems.contacts_model import ContactsModel
from ..._systems.system import System
from ..._types import AnyArray, AnyInteger, Array, BoolArray, DType, IntArray, Number, Scalar
from ..common.ending import has_ended, status_of_lane
from ..common.engine import Engine, SampleTotals
from ..common.method import Regularized
from ..common.segments import SegmentLaws
from ..common.stopping_scan import stopping_scan
from ..common.tracks import of_track
from ..common.varying import with_leaves
from .contacts_field import ContactsField
from .field import Field
from .inner_field import InnerField
from .solve import CLOSING, Solver, Tables, detect_in_step, solve_adaptive, start_detection, status_of
from .stepping import FixedLane, advance_fixed, start_fixed
from .stick_detector import Criterion
from .switch import Switch


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
        return self.system.track_count

    @property
    def compiles_natively(self) -> bool:
        return self.system.compiles_natively

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Signal | None, FixedLane]:
        smooth = _realized(self.excitation, key_data, dtype)
        y0 = tuple(jnp.asarray(value, dtype) for value in self.y0)
        words, segment_laws = self.excitation.segment_key_data(key_data), SegmentLaws.of(self.system, self.excitation)
        segment_states = tuple(first_segment(law, words, dtype) for law in segment_laws.all)
        field = switched_field(self.system, smooth, self.method)
        criterion = criterion_of(self.method)
        return smooth, start_fixed(field, segment_laws, criterion, segment_states, y0, dtype, self.quantities)

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

    `method`: with every option filled in. `longest_step`: of any sample, s (`time_scales.py`). `sizes`: number
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
    t1, quantities, tracks = jnp.asarray(batch.t1, dtype), ALL if keep else (), batch.system.track_count

    def one(place, number, varying):
        words = random_words(key_data, number)
        here = with_leaves(batch, leaf_numbers, varying)
        method = here.method
        smooth = _realized(here.excitation, words, dtype)
        tables = Tables.of(here.system, here.excitation, words, sizes, dtype)
        field, criterion = field_of(here.system, smooth, method), criterion_of(method)
        y0, until = tuple(jnp.asarray(value, dtype) for value in here.y0), jnp.where(place < used, t1, 0)
        solution = solve_adaptive(field, tables, until, y0, Solver.of(method, here.longest_step), most)

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


def field_of(system: System, smooth: Signal | None, method: Regularized) -> Field | ContactsField | InnerField:
    """The regularised field of `system` under a realised smooth excitation."""
    inner = system.inner_model(smooth)
    return switched_field(system, smooth, method) if inner is None else InnerField(inner)


def switched_field(system: System, smooth: Signal | None, method: Regularized) -> Field | ContactsField:
    """The same of friction laws without inner states, which fixed steps can follow too."""
    assert method.width is not None
    model, switch = system.switched_model(smooth, None), Switch(method.width, method.shape)
    if isinstance(model, ContactsModel):
        return ContactsField(model, switch, criterion_of(method).threshold, system.static_exceeds_kinetic)
    return Field(system.one_contact_model(smooth, None), switch)


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
