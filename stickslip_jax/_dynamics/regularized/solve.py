"""Regularised motion of one trajectory in adaptive steps, by diffrax."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ... import _diffrax as diffrax
from ..._events.sticks import StickRecord
from ..._excitation.excitation import Excitation
from ..._excitation.segment_table import SegmentTable
from ..._numerics.over_contacts import any_of
from ..._status import Status
from ..._systems.switched_model import Segments
from ..._systems.system import System
from ..._types import Array, BoolArray, FloatArray, IntArray, Number, Scalar
from ..common.method import Regularized
from ..common.segments import SegmentLaws
from .contacts_field import ContactsField
from .controller import step_control
from .field import Field
from .inner_field import InnerField
from .joined_sticks import JoiningDetector, detect_joined, start_joining
from .stepping import Passage
from .stick_detector import Criterion

CLOSING = 2
"""Steps of no length after the last, at most: see `detect_joined`."""


class Tables(eqx.Module):
    """All segments of one realisation, in the order of `SegmentLaws`."""

    base: tuple[SegmentTable, ...]
    ground: tuple[SegmentTable, ...]
    force: tuple[SegmentTable, ...]
    normal: tuple[SegmentTable, ...]

    @classmethod
    def of(cls, system: System, excitation: Excitation, key_data: Any, sizes: tuple[int, ...], dtype) -> "Tables":
        """The segments that `key_data` choose; `sizes`: how many of each part (`table_sizes`)."""
        segment_laws, own = SegmentLaws.of(system, excitation), excitation.segment_key_data(key_data)
        tables = [SegmentTable.of(law, own, size, dtype) for law, size in zip(segment_laws.all, sizes, strict=True)]
        ends = np.cumsum([len(segment_laws.base), len(segment_laws.ground), len(segment_laws.force)])
        return cls(*(tuple(tables[begin:end]) for begin, end in zip([0, *ends], [*ends, None], strict=True)))

    @property
    def all(self) -> tuple[SegmentTable, ...]:
        """The tables in order."""
        return sum(self._parts, ())

    def at(self, t: FloatArray) -> Segments:
        """The current segments at time `t`."""
        return Segments(*(tuple(table.at(t) for table in part) for part in self._parts))

    @property
    def base_jumps(self) -> bool:
        """Whether the velocity of the base may jump."""
        return any(table.jumps and len(table.segments.begin) > 1 for table in self.base)

    @property
    def _parts(self) -> tuple[tuple[SegmentTable, ...], ...]:
        return self.base, self.ground, self.force, self.normal

    @property
    def end(self) -> FloatArray | float:
        """Earliest end of a part, s."""
        earliest = jnp.inf
        for table in self.all:
            earliest = jnp.minimum(earliest, table.end)
        return earliest

    @property
    def are_invalid(self) -> BoolArray:
        """Whether the part that ends first ends with a segment that cannot be."""
        found = jnp.zeros((), bool)
        for table in self.all:
            found = found | (table.is_invalid & (table.end <= self.end))
        return found

    @property
    def times(self) -> Array | None:
        """The instants at which one segment follows another, s; None without any."""
        times = [table.segments.begin[1:] for table in self.all]
        return jnp.concatenate(times) if sum(map(len, times)) else None


def table_sizes(system: System, excitation: Excitation, t1: Any) -> tuple[int, ...]:
    """Number of segments of each part that suffices for nearly every realisation until `t1` (not traced)."""
    return tuple(law.segments(t1) for law in SegmentLaws.of(system, excitation).all)


class Solver(NamedTuple):
    """Options of diffrax: solver, adjoint, tolerances (absolute: one for each state), and the longest step (s)."""

    solver: Any
    adjoint: Any
    rtol: Any
    atol: Any
    longest_step: Any

    @classmethod
    def of(cls, method: Regularized, longest_step: Scalar) -> "Solver":
        """The options of `method`, which has every option filled in."""
        return cls(method.solver, method.adjoint, method.rtol, method.atol, longest_step)


class Solution(NamedTuple):
    """The accepted steps of a solution: the state at the beginning of each, and at the end of the last.

    `t`: (steps + 1,), infinity in spare slots. `y`: (steps + 1, states). `steps`: number of accepted steps.
    """

    t: Array
    y: Array
    steps: IntArray
    status: IntArray

    @property
    def time_reached(self) -> FloatArray:
        """Where the last step ended, s."""
        return self.t[self.steps]

    @property
    def seen_steps(self) -> IntArray:
        """How many steps `detect_in_step` has to see: one of no length follows the last."""
        return jnp.maximum(self.steps, 1) + 1


def solve_adaptive(
    field: Field | ContactsField | InnerField,
    tables: Tables,
    t1: FloatArray,
    y0: tuple[Number, ...],
    how: Solver,
    max_steps: int,
) -> Solution:
    """Solve one trajectory up to `t1` or the end of the base motion, in at most `max_steps` steps, accepted or not."""
    dtype = t1.dtype
    zero = jnp.zeros((), dtype)

    atol = jnp.broadcast_to(jnp.asarray(how.atol, dtype), (len(y0),))
    start = jnp.stack([jnp.asarray(v, dtype) for v in y0])
    in_logarithms = None
    if isinstance(field, InnerField) and field.model.spans_decades and not tables.base_jumps:
        in_logarithms = field.model
        start = jnp.stack(in_logarithms.with_logarithm(in_logarithms.forcing(zero, tables.at(zero)), tuple(start)))
        atol = atol.at[in_logarithms.speed].set(how.rtol)

    def rates(t, y, _):
        forcing = field.model.forcing(t, tables.at(t))
        if in_logarithms is not None:
            return jnp.stack(in_logarithms.rates_with_logarithm(forcing, tuple(y)))
        return jnp.stack(field.model.numbers(field.rates(forcing, zero, field.model.start(tuple(y), dtype))))

    longest = jnp.asarray(how.longest_step, dtype)
    control = step_control(how.rtol, atol, longest, tables.times, is_very_stiff=in_logarithms is not None)
    end = jnp.minimum(t1, tables.end)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates), how.solver, zero, end, None, start,
        saveat=diffrax.SaveAt(t0=True, steps=True), stepsize_controller=control, max_steps=max_steps,
        adjoint=how.adjoint, throw=False,
    )  # fmt: skip
    t, y = jnp.asarray(solution.ts), jnp.asarray(solution.ys)
    if in_logarithms is not None:

        def plain(t: FloatArray, y: Array) -> Array:
            here = jnp.where(jnp.isfinite(t), t, 0)
            return jnp.stack(in_logarithms.without_logarithm(in_logarithms.forcing(here, tables.at(here)), tuple(y)))

        y = jax.vmap(plain)(t, y)
    steps = jnp.sum(jnp.isfinite(t)).astype(jnp.int32) - 1
    full = solution.result == diffrax.RESULTS.max_steps_reached
    code = jnp.where(solution.result == diffrax.RESULTS.successful, Status.FINISHED, Status.SOLVER_FAILED)
    code = jnp.where(full, Status.OUT_OF_STEPS, code)
    ended = jnp.where(tables.are_invalid, Status.BASE_INVALID, Status.BASE_TOO_SHORT)
    code = jnp.where((code == Status.FINISHED) & (end < t1), ended, code)
    finite = jnp.all(jnp.isfinite(y[steps])) & jnp.isfinite(t1)
    return Solution(t, y, steps, jnp.where(finite, code, Status.NOT_FINITE).astype(jnp.int8))


def start_detection(
    field: Field | ContactsField | InnerField,
    tables: Tables,
    criterion: Criterion,
    y: Array,
    quantities: tuple[str, ...],
) -> JoiningDetector:
    """The stick detector at the beginning of a trajectory; `quantities` of each stick: those that are asked for."""
    zero = jnp.zeros((), y.dtype)
    forcing = field.model.forcing(zero, tables.at(zero))
    state = field.model.start(tuple(y), y.dtype)
    tracks = field.model.stick_position(state)
    return start_joining(criterion, field.at_contact(forcing, zero, state), tracks, quantities)


def detect_in_step(
    field: Field | ContactsField | InnerField,
    tables: Tables,
    criterion: Criterion,
    t1: FloatArray,
    solution: Solution,
    detector: JoiningDetector,
    index: IntArray,
) -> tuple[JoiningDetector, StickRecord, Passage]:
    """Run the stick detector over step number `index` of a solution; beyond its `seen_steps` nothing changes."""
    live = index < solution.seen_steps
    index = jnp.minimum(index, solution.steps)
    model, dtype = field.model, solution.y.dtype
    t, y = solution.t[index], model.start(tuple(solution.y[index]), dtype)
    # A solution without steps is read as steps of no length.
    following = jnp.minimum(index + 1, solution.steps)
    now, reached = solution.t[following], model.start(tuple(solution.y[following]), dtype)
    h = now - t
    segments, next_segments = tables.at(t + h / 2), tables.at(now)
    seen, rates, end_rates = field.seen(model.forcing(t, segments), t, h, y, reached)
    jumped = jnp.zeros((), bool)
    for table, old, new in zip(tables.base, segments.base, next_segments.base, strict=True):
        jumped = jumped | ((old.begin != new.begin) & table.jumps)
    after = field.at_contact(model.forcing(now, next_segments), now, reached)
    moved, record = detect_joined(criterion, detector, seen, jumped=jumped & (now < t1), after=after, last=now >= t1)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, detector)
    # An acceleration that is NaN or infinite hides sticks, although the motion may not need it: `status_of`.
    # (What ends where it begins has none, and no motion.)
    hidden = live & (tables.end > 0) & any_of(~(jnp.isfinite(seen.slope0) & jnp.isfinite(seen.slope1)))
    stick_time = jnp.where(hidden, jnp.nan, moved.totals.stick_time)
    moved = moved._replace(totals=moved.totals._replace(stick_time=stick_time))
    record = record._replace(ending=jnp.where(live, record.ending, jnp.int8(-1)))
    return moved, record, Passage(t, *map(model.numbers, (y, rates, end_rates)))


def status_of(solution: Solution, detector: JoiningDetector) -> IntArray:
    """How a solution ended whose steps the `detector` has seen."""
    return jnp.where(any_of(jnp.isnan(detector.totals.stick_time)), jnp.int8(Status.NOT_FINITE), solution.status)
