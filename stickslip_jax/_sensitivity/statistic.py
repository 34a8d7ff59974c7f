"""The statistics that `sensitivity` differentiates, the numbers that samples draw, and statistics of recorded
sequences.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._dynamics.common.lanes import Engine, Job, VaryingEngine, follow_block, lanes_at_start
from .._dynamics.simulate import Output
from .._foundation import checks
from .._foundation.types import AnyArray, BoolArray, DType, FloatArray, IntArray, Scalar
from .._statistics.totals import DIFFERENTIABLE, Linear, StatisticOfTotals
from .._uncertainty.families import RandomNumber
from .boundaries import BoundaryDistances, BoundarySums

# The statistics that `sensitivity` differentiates: ratios of two means over realisations.


class StickSequence(NamedTuple):
    """The sticks of one realisation in order of time.

    Attributes:
        start: When each stick begins, s; 0 in empty slots.
        duration: How long it lasts, s; 0 in empty slots.
        mask: Marks the filled slots; the empty ones come last.
    """

    start: Float[Array, " slots"]
    duration: Float[Array, " slots"]
    mask: Bool[Array, " slots"]


class StickStatistic(abc.ABC):
    """A statistic of the stick sequence: the mean over realisations of one number, divided by the mean of another.

    Attributes:
        name: For tables and figures.
        unit: For tables and figures.
        is_of_totals: Whether it depends only on the number of sticks and the total stick time of each realisation.
    """

    name: str
    unit: str
    is_of_totals = False

    @abc.abstractmethod
    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        """The two numbers for one realisation on [0, t1] (s); smooth in starts and durations."""


@dataclasses.dataclass(frozen=True)
class OfTotals(StickStatistic):
    """A statistic of the total stick time and the number of sticks, as `_statistics/totals.py` defines it."""

    name: str
    unit: str
    definition: StatisticOfTotals
    is_of_totals = True

    @property
    def ignores_stick_count(self) -> bool:
        """Whether sticks of zero length do not change it: then its derivative has no event part."""
        return self.definition.numerator.stick_count == self.definition.denominator.stick_count == 0

    @property
    def counts_slips(self) -> bool:
        """Whether it depends on the number of slips, which the lanes that follow derivatives do not count."""
        return not self.definition.is_of_sticks

    def weights(self, t1: float) -> Float[np.ndarray, "2 3"]:
        """Coefficients of total stick time, number of sticks and 1 in numerator and denominator, for `t1` (s)."""
        return self.definition.weights(t1)[:, [0, 1, -1]]

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        totals = jnp.stack([jnp.sum(sticks.duration), jnp.sum(sticks.mask), jnp.ones_like(sticks.start[0])])

        def value_of(one: Linear) -> Array:
            value = jnp.asarray((one.stick_time, one.stick_count, one.constant), totals.dtype) @ totals
            return value + one.t1 * t1 if one.t1 else value

        above, below = value_of(self.definition.numerator), value_of(self.definition.denominator)
        return (above / below, jnp.ones_like(above)) if self.definition.denominator.is_constant else (above, below)


@dataclasses.dataclass(frozen=True)
class RealizationMeanDuration(StickStatistic):
    """The mean over realisations of the mean stick duration of each, s; realisations without a stick do not count."""

    name = "mean stick duration (of realisation means)"
    unit = "s"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        count = jnp.sum(sticks.mask)
        some = count > 0
        mean = jnp.sum(sticks.duration) / jnp.where(some, count, 1)
        return jnp.where(some, mean, 0), some.astype(mean.dtype)


@dataclasses.dataclass(frozen=True)
class _OfNumber(StickStatistic):
    """A mean over the i-th sticks of all realisations that have one.

    Args:
        number: i = 1, 2, ...
        count_initial_rest: Whether a stick that begins at t = 0, because the mass starts at rest, counts. By default
            it does not, and the next one is the first.

    Raises:
        ValueError: Unless `number` is a whole number of at least 1.
    """

    number: int
    count_initial_rest: bool = False
    unit = "s"
    quantity: ClassVar[str]

    def __post_init__(self):
        checks.whole_number("number", self.number)

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return f"mean {self.quantity} of stick {self.number}"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        counted = sticks.mask if self.count_initial_rest else sticks.mask & (sticks.start > 0)
        chosen = counted & (jnp.cumsum(counted) == self.number)
        value = jnp.sum(jnp.where(chosen, getattr(sticks, self.quantity), 0))
        return value, jnp.any(chosen).astype(value.dtype)


@dataclasses.dataclass(frozen=True)
class StickStart(_OfNumber):
    __doc__ = f"The mean start of the i-th stick, s.\n{(_OfNumber.__doc__ or '').partition(chr(10))[2]}"
    quantity = "start"


@dataclasses.dataclass(frozen=True)
class StickDuration(_OfNumber):
    __doc__ = f"The mean duration of the i-th stick, s.\n{(_OfNumber.__doc__ or '').partition(chr(10))[2]}"
    quantity = "duration"


@dataclasses.dataclass(frozen=True)
class SumOfSquaredDurations(StickStatistic):
    """The mean over realisations of the sum of squared stick durations, s^2.

    Unlike the number of sticks, it hardly changes where short sticks escape notice.
    """

    name = "mean sum of squared stick durations"
    unit = "s^2"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        value = jnp.sum(sticks.duration**2)
        return value, jnp.ones_like(value)


@dataclasses.dataclass(frozen=True)
class TimeToFirstStick(StickStatistic):
    """The mean over realisations of the time until a stick begins after t = 0, or until ``t1`` where none does, s."""

    name = "mean time to the first stick"
    unit = "s"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        begins = sticks.mask & (sticks.start > 0)
        value = jnp.min(jnp.where(begins, sticks.start, jnp.asarray(t1, sticks.start.dtype)))
        return value, jnp.ones_like(value)


@dataclasses.dataclass(frozen=True)
class StickFunctional(StickStatistic):
    """The mean over realisations of a user-supplied function of the stick sequence.

    Args:
        function: Takes a `StickSequence` and returns one number, traceable by JAX. It must be smooth in starts and
            durations as long as the number of sticks does not change, and must not depend on empty slots (where starts
            and durations are 0).
        name: For tables and figures.
        unit: For tables and figures.

    Raises:
        ValueError: Unless `function` can be called.
    """

    function: Callable[[StickSequence], ArrayLike]
    name: str = "user's functional"
    unit: str = "1"

    def __post_init__(self):
        if not callable(self.function):
            raise checks.refused("function", "be a function of a StickSequence", self.function)

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        value = jnp.asarray(self.function(sticks), sticks.start.dtype)
        return value, jnp.ones_like(value)


@dataclasses.dataclass(frozen=True)
class OfOutput(StickStatistic):
    """The mean of an output of a user's own."""

    name: str
    unit: str
    output: Output

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        raise NotImplementedError("an output is that of a whole simulation, not of its sticks")


AnyStatistic: TypeAlias = StickStatistic | StatisticOfTotals | Output | str
"""What `sensitivity` takes: a string is the name of a statistic of totals."""


def statistics_of(statistic: AnyStatistic | Sequence[AnyStatistic]) -> tuple[StickStatistic, ...]:
    """`statistic`, one or several, as `StickStatistic` objects. Raises ValueError for anything else."""
    several = list(statistic) if isinstance(statistic, (list, tuple)) else [statistic]
    found = tuple(map(statistic_of, several)) or (statistic_of(statistic),)
    if len({one.name for one in found}) < len(found):
        names = [one.name for one in found]
        raise checks.refused("statistic", "hold different statistics, with different names", names)
    return found


def statistic_of(statistic: object) -> StickStatistic:
    """`statistic` as a `StickStatistic`. Raises ValueError for anything else."""
    if isinstance(statistic, Output):
        return OfOutput(f"mean {statistic.name}", statistic.unit, statistic)
    if isinstance(statistic, str):
        statistic = next((one for one in DIFFERENTIABLE if one.name == statistic), statistic)
    if isinstance(statistic, StickStatistic):
        if statistic.is_of_totals and not isinstance(statistic, OfTotals):
            hint = "only the package's own statistics are found from totals"
            raise checks.refused("statistic", "have is_of_totals = False", statistic, hint)
        return statistic
    if isinstance(statistic, StatisticOfTotals) and any(statistic is one for one in DIFFERENTIABLE):
        return OfTotals(statistic.label, statistic.unit, statistic)
    known = ", ".join(map(repr, DIFFERENTIABLE))
    demand = f"be {known}, or a StickStatistic such as StickDuration(1), an Output, or a list of them"
    raise checks.refused("statistic", demand, statistic)


# Engines whose samples differ in numbers drawn from distributions, with derivatives by the distributions' parameters.
#
# A number is drawn by inversion, ``icdf(u)`` of a uniform ``u`` that belongs to the sample. So a parameter of the
# distribution moves it smoothly, and derivatives of an expectation are those of the simulation, summed over the samples
# (reparameterisation).


_Made = TypeVar("_Made", bound=Engine)


class RandomEngine(VaryingEngine):
    """An engine with numbers of its own for every sample, some of them drawn anew from `sources`.

    `sources`: for each varying leaf a distribution, to be differentiated by its parameters; None where it is given.
    """

    sources: tuple[RandomNumber | None, ...]

    def columns(self, varying: tuple[AnyArray, ...]) -> tuple[AnyArray, ...]:
        """The varying leaves (samples,); where there is a source, `varying` holds uniform numbers."""
        return tuple(
            column if source is None else jnp.asarray(source.icdf(jnp.asarray(column)), column.dtype)
            for source, column in zip(self.sources, varying, strict=True)
        )

    def after_block(self, samples: PyTree, motions: PyTree, records: PyTree) -> PyTree:
        return self.template.after_block(self.constants(samples), motions, records)


def wrapped(engine: Engine, make: Callable[[Any], _Made]) -> _Made | RandomEngine:
    """What `make` makes of an engine; of a `RandomEngine`, one with the same varying leaves whose template `make` made.

    `make` must keep the engine's leaves as the first ones of its result.
    """
    if not isinstance(engine, RandomEngine):
        return make(engine)
    template = make(engine.template)
    kept = jax.tree.leaves(engine.template)
    assert all(one is other for one, other in zip(kept, jax.tree.leaves(template), strict=False))
    return dataclasses.replace(engine, template=template)


def single_engine(engine: Engine) -> Any:
    """The engine of a single sample, for what all samples share."""
    return engine.template if isinstance(engine, RandomEngine) else engine


# Statistics of recorded stick sequences whose derivatives are those of their expectations.
#
# The derivative of a realisation's functional with the number of sticks held fixed is the pathwise part. The event part
# comes from the signed distances to the boundaries (`boundaries.py`), weighted by kernels: the
# functional's jump at each is its change when a stick of zero length is inserted there, or when a slip of zero length
# splits a stick in two. The duration of a stick from t = 0 is a further distance.


_Tree = TypeVar("_Tree")
_SAME = 64  # units in the last place by which two computed values of the same instant may differ


class BufferSizes(NamedTuple):
    """Buffer sizes of a realisation: blocks of intervals or steps; slots for sticks; slots for candidates (0: none)."""

    blocks: int
    slots: int
    candidates: int


class RecordedCounts(NamedTuple):
    """Of every lane's sample: status, and how many slots its sticks and its candidates would need."""

    status: Int[AnyArray, " lanes"]
    sticks: Int[AnyArray, " lanes"]
    candidates: Int[AnyArray, " lanes"]


class LaneSticks(NamedTuple):
    """The sticks of each lane's sample in order of time, and what decides about them."""

    sticks: StickSequence  # (lanes, slots)
    first_ending: Int[Array, " lanes"]  # of the first stick, -1 where there is none
    t1: FloatArray  # s
    deterministic_until: Float[Array, " lanes"]  # when the first random thing happens, s
    counts: RecordedCounts
    distances: BoundaryDistances | None  # (candidates, lanes); none is active in spare slots


class Features(NamedTuple):
    """Numerator and denominator of each sample, and zeros that carry the event parts in their derivatives.

    `parts`: with pathwise derivatives; `event_parts`: zeros whose derivatives are the event parts; `in_window`: zeros
    whose derivatives count the distances inside each window.
    """

    parts: Float[Array, "lanes 2"]
    event_parts: Float[Array, "lanes windows 2"]
    in_window: Float[Array, "lanes windows"]


def record_sequences(job: Job, *, lanes: int, buffer: BufferSizes, dtype: DType) -> LaneSticks:
    """Simulate the first row of a job's samples for up to `buffer.blocks` blocks; keep sticks and candidates.

    The engine is one that `recording` made, or `wrapped` by it.
    """
    engine = wrapped(job.engine, lambda engine: dataclasses.replace(engine, with_distances=buffer.candidates > 0))
    start = lanes_at_start(job._replace(engine=engine).with_columns(), lanes, dtype)

    def advance(carry):
        # A lane that has ended idles: nothing happens after the horizon.
        now, ended = carry
        after, trace = follow_block(engine, now, dtype, stacked=True)
        following = jax.tree.map(lambda new, old: jax.vmap(jnp.where)(~ended, new, old), after, now)
        return (following, ended | jax.vmap(engine.ended)(after.motion, now.motion)), trace

    begun = start, jnp.zeros(lanes, bool)
    shapes = jax.eval_shape(advance, begun)[1]

    def idle(carry):
        none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return carry, none._replace(sticks=none.sticks._replace(ending=none.sticks.ending - 1))

    def block(carry, _):
        return lax.cond(jnp.all(carry[1]), idle, advance, carry)

    (now, _), trace = lax.scan(block, begun, None, length=buffer.blocks)
    single = single_engine(engine)
    samples = engine.constants(now.sample) if isinstance(engine, RandomEngine) else now.sample
    sticks, candidates, is_candidate = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), trace)
    kept, is_stick, sticks_found = _gathered(sticks.ending >= 0, sticks, buffer.slots)
    distances, candidates_found = None, jnp.zeros_like(sticks_found)
    if buffer.candidates > 0:
        candidates, is_filled, candidates_found = _gathered(is_candidate, candidates, buffer.candidates)
        distances = single.distances(samples, candidates)
        distances = distances.after(samples.deterministic_until[None, :, None], is_filled[..., None])
        distances = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 2, 1).reshape(-1, lanes), distances)
    start, duration = (jnp.where(is_stick, column, 0).T for column in (kept.start, kept.end - kept.start))
    first_ending = jnp.where(is_stick[0], kept.ending[0], -1).astype(jnp.int32)
    status = jnp.asarray(jax.vmap(engine.results)(now.sample, now.motion).status, jnp.int32)
    counts = RecordedCounts(status, sticks_found, candidates_found)
    sequences, t1 = StickSequence(start, duration, is_stick.T), jnp.asarray(single.engine.t1, dtype)
    return LaneSticks(sequences, first_ending, t1, samples.deterministic_until, counts, distances)


def _gathered(exists: BoolArray, columns: _Tree, slots: int) -> tuple[_Tree, BoolArray, IntArray]:
    """The first `slots` existing rows of each lane: columns, which slots are filled, how many rows exist."""
    found = jnp.cumsum(exists, axis=0)
    # The slot of row k is the first at which k + 1 have been found. (A scatter would run serially.)
    wanted = jnp.arange(1, slots + 1)
    at = jax.vmap(lambda found: jnp.searchsorted(found, wanted), in_axes=1, out_axes=1)(found)
    filled = wanted[:, None] <= found[-1][None]
    at = jnp.where(filled, at, 0)

    def taken(column):
        return jnp.take_along_axis(column, at.reshape(*at.shape, *(1,) * (column.ndim - 2)), axis=0)

    kept = jax.tree.map(taken, columns)
    return kept, filled, found[-1].astype(jnp.int32)


def features_of(statistic: StickStatistic, recorded: LaneSticks, bandwidths: AnyArray) -> Features:
    """The features of all samples; differentiate them to get pathwise and event parts (these from distances only).

    `bandwidths` (windows,): relative bandwidths of the kernels.
    """
    dtype = recorded.sticks.start.dtype
    bandwidths = jnp.asarray(bandwidths, dtype)

    def parts(sticks):
        return jnp.stack([jnp.asarray(part, dtype) for part in statistic.parts(sticks, recorded.t1)])

    if recorded.distances is None:
        shape = (len(recorded.first_ending), len(bandwidths))
        return Features(jax.vmap(parts)(recorded.sticks), jnp.zeros((*shape, 2), dtype), jnp.zeros(shape, dtype))

    def of(sticks, first_ending, deterministic_until, distances):
        fixed = lax.stop_gradient(sticks)

        def jump_at(time, exists, is_slip):
            of_slip = _jump_of_slip(parts, fixed, time, exists)
            return jnp.where(is_slip, of_slip, _jump_of_stick(parts, fixed, time, exists))

        time = lax.stop_gradient(distances.time)
        at_boundaries = jax.vmap(jump_at)(time, distances.exists, distances.is_slip)
        at_start = _jump_of_stick(parts, fixed, fixed.start[0], True)
        sums = BoundarySums.over(distances, bandwidths)
        # Only the first stick can begin at t = 0.
        of_first = sticks.start[0], sticks.duration[0], first_ending
        first = BoundarySums.over_vanishing(*of_first, deterministic_until, bandwidths)
        event_parts = [jnp.sum(weights[:, None] * at_boundaries, axis=0) + weight * at_start
                       for weights, weight in zip(sums.event_parts, first.event_parts, strict=True)]  # fmt: skip
        in_window = [jnp.sum(number) + one for number, one in zip(sums.in_window, first.in_window, strict=True)]
        return Features(parts(sticks), jnp.stack(event_parts), jnp.stack(in_window))

    distances = jax.tree.map(jnp.transpose, recorded.distances)
    return jax.vmap(of)(recorded.sticks, recorded.first_ending, recorded.deterministic_until, distances)


_Parts: TypeAlias = Callable[[StickSequence], FloatArray]
"""A statistic's numerator and denominator, of one sequence."""


def _jump_of_stick(parts: _Parts, sticks: StickSequence, time: FloatArray, exists: BoolArray | bool) -> FloatArray:
    """Change of the parts by a stick of zero length at `time`; a stick that `exists` there is removed first."""
    index = jnp.argmin(jnp.where(sticks.mask, jnp.abs(sticks.start - time), jnp.inf))
    found = exists & sticks.mask[index] & _same(sticks.start[index], time)
    without = jax.tree.map(lambda a, b: jnp.where(found, a, b), _without(sticks, index), sticks)
    return parts(_with(without, time)) - parts(without)


def _jump_of_slip(parts: _Parts, sticks: StickSequence, time: FloatArray, exists: BoolArray) -> FloatArray:
    """Change of the parts by a slip of zero length at `time` that splits a stick in two; zero outside sticks.

    If the slip `exists`, from `time` on, the two sticks around it are joined first.
    """
    numbers = jnp.arange(len(sticks.mask))
    end = sticks.start + sticks.duration
    ends_here = jnp.argmin(jnp.where(sticks.mask, jnp.abs(end - time), jnp.inf))
    around = jnp.argmax(sticks.mask & (sticks.start < time) & (time < end))
    index = jnp.where(exists, ends_here, around)
    following = jnp.minimum(index + 1, len(numbers) - 1)
    is_parted = exists & _same(end[index], time) & sticks.mask[following] & (following > index)
    is_whole = ~exists & sticks.mask[index] & (sticks.start[index] < time) & (time < end[index])
    last = jnp.where(is_parted, end[following], end[index])
    one = jax.tree.map(lambda a, b: jnp.where(is_parted, a, b), _without(sticks, following), sticks)
    whole = one._replace(duration=jnp.where(numbers == index, last - sticks.start[index], one.duration))
    first = whole._replace(duration=jnp.where(numbers == index, time - sticks.start[index], whole.duration))
    return jnp.where(is_parted | is_whole, parts(_with(first, time, last - time)) - parts(whole), 0)


def _same(one: FloatArray, other: FloatArray) -> BoolArray:
    return jnp.abs(one - other) <= _SAME * jnp.finfo(one.dtype).eps * (1 + jnp.abs(other))


def _without(sticks: StickSequence, i: IntArray) -> StickSequence:
    """The sequence without stick `i`."""
    numbers = jnp.arange(len(sticks.mask))
    start, duration, mask = (jnp.where(numbers < i, column, jnp.roll(column, -1)) for column in sticks)
    mask = mask & (numbers < jnp.sum(sticks.mask) - 1)
    return StickSequence(jnp.where(mask, start, 0), jnp.where(mask, duration, 0), mask)


def _with(sticks: StickSequence, time: FloatArray, duration: FloatArray | int = 0) -> StickSequence:
    """The sequence with a stick inserted at `time`."""
    numbers = jnp.arange(len(sticks.mask))
    place = jnp.sum(sticks.mask & (sticks.start < time))

    def put(column, value):
        return jnp.where(numbers < place, column, jnp.where(numbers == place, value, jnp.roll(column, 1)))

    return StickSequence(put(sticks.start, time), put(sticks.duration, duration), put(sticks.mask, True))
