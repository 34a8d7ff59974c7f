"""Engines that count sticks with the derivative of the expected count, or record all that decides about sticks."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree

from .._dynamics.common.lanes import Engine, Motion, Shared
from .._dynamics.common.path import SegmentLaws, StepsShared, of_track
from .._dynamics.interval.arcs import Scales, start_motion, status_of
from .._dynamics.interval.engine import IntervalEngine, is_over
from .._dynamics.sticks import StickRecord, start_totals
from .._dynamics.switched.engine import Lane, SwitchedEngine, advance
from .._excitation.motion import Signal
from .._foundation.types import AnyArray, BoolArray, FloatArray, IntArray, Scalar
from .._systems.contacts_model import ContactsModel
from .._systems.system import one_contact_model
from .boundaries import (
    AtContact,
    BoundaryDistances,
    BoundarySums,
    EngineStep,
    FirstSegment,
    IntervalLane,
    SignedDistance,
    cross_with_distances,
    crossed_after,
    distances_of_step,
    is_candidate,
    since_after,
    stacked,
    stop_of,
    zero_with_derivative,
)

# Engines that count sticks with the derivative of the expected count, or record what decides about them.
#
# To that derivative each stick and near miss adds an event part for every boundary that it is close to
# (`boundaries.py`). Counts are accumulated during the simulation. Beside the sticks, candidates are recorded: intervals
# or steps that may be close to a boundary.


class Trace(NamedTuple):
    """The record of one interval or step, with at most one stick.

    `candidates`: data from which the engine finds signed distances; `is_candidate`: whether the interval or step may be
    close to a boundary. Both None without distances.
    """

    sticks: StickRecord
    candidates: BoundaryDistances | EngineStep | None
    is_candidate: BoolArray | None


class Counted(NamedTuple):
    """The totals of each sample.

    `sums`: their values are zero; the derivative of `event_parts` is the event part of that of the number of sticks,
    the derivative of `in_window` counts the distances inside the kernel's window.
    """

    status: AnyArray
    stick_time: AnyArray
    sticks: AnyArray
    sums: BoundarySums


def recording(engine: IntervalEngine | SwitchedEngine, first: FirstSegment) -> "IntervalCounting | StepCounting":
    """`engine` with its candidates recorded."""
    if isinstance(engine, IntervalEngine):
        return IntervalCounting(engine, np.zeros(0), first, with_distances=True)
    return StepCounting(engine, np.zeros(0), first, with_distances=True)


class CountedSample(NamedTuple):
    """Constants of a sample: what its excitation follows from (the key data, or its smooth part), and when the first
    random thing happens in it, s.
    """

    own: Any
    deterministic_until: FloatArray


class CountingEngine(Engine[Shared, CountedSample, Motion, Trace, Counted]):
    """Engine that counts the sticks that another `engine` simulates, and records candidates, if `with_distances`.

    `bandwidths` (windows,): relative bandwidths of the kernels (see `two_sided_kernel`).
    """

    engine: Any
    bandwidths: AnyArray
    first: FirstSegment = eqx.field(static=True)
    with_distances: bool = eqx.field(static=True, default=False)

    def shared(self, dtype) -> Shared:
        return self.engine.shared(dtype)


# Over whole intervals of the base. Where the gaps between switches are exponential, the time left at an arrival is
# exponential too (memorylessness): its density at 0 is the rate, for every stick. So the distance to the switch needs
# no kernel.


class Likelihood(NamedTuple):
    """Data for the derivative by the rate of a Poisson base, from the likelihood of the number of switches (score)."""

    rate: Scalar  # a copy of the law's rate, 1/s: differentiated for the score part, the law's for the pathwise part
    stick_time: Scalar  # approximate means, s and 1, subtracted to reduce the variance (control variate)
    sticks: Scalar


class _IntervalMotion(NamedTuple):
    """The motion of one lane, its sums so far, and the number of switches of its base."""

    lane: IntervalLane
    sums: BoundarySums
    switches: IntArray


class IntervalCounting(CountingEngine[Scales, _IntervalMotion]):
    """The counting engine of an `IntervalEngine`."""

    engine: IntervalEngine
    likelihood: Likelihood | None = None

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[CountedSample, _IntervalMotion]:
        law, (x, velocity), zero = self.engine.law, self.engine.y0, jnp.zeros((), dtype)
        motion = start_motion(self.shared(dtype), (x, velocity))
        memory = law.begin(key_data, dtype)
        end, _, _ = law.next_interval(memory, law.draw(key_data, jnp.zeros((), jnp.uint32), dtype), dtype)
        lane = IntervalLane(memory, motion, start_totals(dtype), zero)
        begun = _IntervalMotion(lane, BoundarySums.none(len(self.bandwidths), dtype), jnp.zeros((), jnp.int32))
        return CountedSample(key_data, self.first.deterministic_until(end)), begun

    def draw(self, sample: CountedSample, number: Array, dtype) -> PyTree:
        return self.engine.law.draw(sample.own, number, dtype)

    def step(
        self, shared: Scales, sample: CountedSample, motion: _IntervalMotion, drawn: PyTree
    ) -> tuple[_IntervalMotion, Trace]:
        (lane, sums, switches), law = motion, self.engine.law
        moved, stick, distances, duration = cross_with_distances(law, shared, lane, drawn)
        arrival = stick.start - lane.motion.t
        exact, weighed = jnp.zeros_like(arrival), distances.after(sample.deterministic_until, jnp.ones((), bool))
        if law.gap_rate is not None:
            rate = jnp.asarray(getattr(law, law.gap_rate), arrival.dtype)
            # A gap that ends at the arrival, E / rate with its random number E held fixed.
            gap = lax.stop_gradient(arrival) * lax.stop_gradient(rate) / rate
            exact = zero_with_derivative(rate, gap - arrival, distances.exists)
            inactive = jnp.zeros((), bool)
            weighed = weighed._replace(switch=weighed.switch._replace(is_active=inactive))
        sums = sums._replace(event_parts=tuple(part + exact for part in sums.event_parts))
        bandwidths = jnp.asarray(self.bandwidths, arrival.dtype)
        more = BoundarySums.over(weighed, bandwidths)
        sums = jax.tree.map(jnp.add, sums, more)
        following = _IntervalMotion(moved, sums, switches + (lane.motion.t + duration < shared.t1))
        if not self.with_distances:
            return following, Trace(stick, None, None)
        return following, Trace(stick, distances, distances.any_active & (distances.time <= shared.t1))

    def distances(self, samples: CountedSample, candidates: BoundaryDistances) -> BoundaryDistances:
        """The signed distances (slots, lanes, 1) of candidates (slots, lanes)."""
        return jax.tree.map(lambda leaf: leaf[..., None], candidates)

    def ended(self, motion: _IntervalMotion, before: _IntervalMotion) -> BoolArray:
        return is_over(motion.lane.motion, before.lane.motion, self.engine.t1)

    def results(self, sample: CountedSample, motion: _IntervalMotion) -> Counted:
        totals, sums = motion.lane.totals, motion.sums
        time = totals.stick_time
        if self.likelihood is not None:
            # Score of a Poisson process: d log p / d rate = switches / rate - t1.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = zero_with_derivative(motion.switches / rate - self.engine.t1, rate, jnp.ones((), bool))
            more = (totals.sticks - self.likelihood.sticks) * score
            sums = sums._replace(event_parts=tuple(part + more for part in sums.event_parts))
            time = time + (time - self.likelihood.stick_time) * score
        status = status_of(motion.lane.motion, jnp.asarray(self.engine.t1, time.dtype))
        return Counted(status, time, totals.sticks, sums)


# With several contacts, whose sticks are counted of one of them, or of all at once.
#
# The other contacts are a part of the motion. Their events leave the state continuous. Where friction in one has no
# effect on the relative velocity of another (`SwitchedModel.coupled`), the guard of each, and its rate, are continuous
# in the events of the others too: an arc that is followed beyond such an event with the other modes as they were
# differs from the true one by a higher order only. So the boundaries of a contact are those of a system with one.
#
# Where friction is coupled, an event of another contact makes the rate of a slip's guard jump, and the guard of a
# stick: such systems have further boundaries, and are refused.
#
# All contacts stick at once from the last arrival to the first release. Such a time has no length where a contact
# arrives as another is released (`_distance_of_race`); else it appears and vanishes with a stick or slip of one
# contact, while all others stick.


def distances_of_contacts(
    model: ContactsModel, shared: StepsShared, step: EngineStep, counted: int
) -> BoundaryDistances:
    """The signed distances (kinds,) of a step for which `may_be_close` is true, to the boundaries of what is `counted`:
    the sticks of a contact, or the times (-1) in which all stick.
    """
    numbers = jnp.arange(len(step.sign))
    if counted >= 0:
        return stacked(distances_of_step(*_at_contact(model, shared, step, numbers == counted)))

    def of(contact: IntArray) -> BoundaryDistances:
        own = numbers == contact
        found = distances_of_step(*_at_contact(model, shared, step, own))
        return found.after(0 * step.t, jnp.all((step.sign == 0) | own))

    return _joined(jax.vmap(of)(numbers), stacked(_distance_of_race(shared, step)))


def may_be_close(model: ContactsModel, shared: StepsShared, step: EngineStep, counted: int) -> BoolArray:
    """Whether the step may be close to a boundary of what is `counted`; no other step is."""
    numbers = jnp.arange(len(step.sign))
    contacts = numbers if counted < 0 else numbers[counted : counted + 1]
    each = jax.vmap(lambda contact: is_candidate(*_at_contact(model, shared, step, numbers == contact)))(contacts)
    return jnp.any(each) | ((counted < 0) & jnp.any(step.sign_end != step.sign))


def _at_contact(
    model: ContactsModel, shared: StepsShared, step: EngineStep, own: BoolArray
) -> tuple[AtContact, StepsShared, EngineStep, AtContact]:
    return AtContact(model, own, step.sign), shared, step.of_contact(own), AtContact(model, own, step.sign_end)


def _distance_of_race(shared: StepsShared, step: EngineStep) -> BoundaryDistances:
    """How long before the first release the last contact has arrived; negative where it arrives after it.

    One that was released keeps that time in `EngineStep.since`, one that crossed the base velocity since then does not.
    """
    assert step.since is not None
    sticks, stuck, since = step.sign == 0, step.sign_end == 0, step.since
    arrived = jnp.max(jnp.where(stuck, since, -1))  # a contact that goes on sticking
    ends = jnp.all(sticks) & ~jnp.all(stuck) & (arrived > jnp.max(jnp.where(stuck, -1, since)))
    released = jnp.max(jnp.where(~sticks & ~stuck & (step.crossed < 0), since, -1))
    begins = jnp.any(stuck & ~sticks) & (jnp.sum(~stuck) == 1) & (released > 0)
    is_active = (step.end < stop_of(shared.t1, step)) & ((ends & (arrived > 0)) | begins)
    distance = SignedDistance(jnp.where(ends, step.end - arrived, released - step.end), is_active)
    return BoundaryDistances.only(jnp.where(ends, arrived, step.end), ends, is_slip=False, switch=distance)


def _joined(one: BoundaryDistances, other: BoundaryDistances) -> BoundaryDistances:
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), one, other)


# For any motion that is simulated in time steps. Most steps are close to no boundary. The others are collected for a
# block, and their signed distances are found together.


class _StepMotion(NamedTuple):
    """A lane of the switched engine, its `EngineStep.crossed` and `EngineStep.since`, and its sums so far."""

    lane: Lane
    crossed: FloatArray
    since: FloatArray | None
    sums: BoundarySums


class StepCounting(CountingEngine[StepsShared, _StepMotion]):
    """The counting engine of a `SwitchedEngine`. Without distances it gives only pathwise derivatives."""

    engine: SwitchedEngine
    looks_back = True

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[CountedSample, _StepMotion]:
        smooth, lane = self.engine.begin(key_data, dtype)
        laws = SegmentLaws.of(self.engine.system, self.engine.excitation).all
        ends = [state.segment.end for law, state in zip(laws, lane.segment_states, strict=True) if law.is_random]
        until = self.first.deterministic_until(jnp.min(jnp.stack(ends))) if ends else jnp.zeros((), dtype)
        never = -jnp.ones_like(lane.sign)
        since = None if self._counted is None else never
        begun = _StepMotion(lane, never, since, BoundarySums.none(len(self.bandwidths), dtype))
        return CountedSample(smooth, until), begun

    def step(
        self, shared: StepsShared, sample: CountedSample, motion: _StepMotion, drawn: None
    ) -> tuple[_StepMotion, Trace]:
        model, counted = self._model(sample.own), self._counted
        moved, stick, _ = advance(model, *shared, motion.lane)
        stick = of_track(stick, self.engine.system)
        if not self.with_distances:
            return motion._replace(lane=moved), Trace(stick, None, None)
        before = motion.lane
        beginning, end = (before.t, before.y, before.sign, before.segment_states), (moved.t, moved.y, moved.sign)
        taken = EngineStep(*beginning, *end, motion.crossed, motion.since)
        following = motion._replace(lane=moved, crossed=crossed_after(shared, taken))
        if counted is None:
            return following, Trace(stick, taken, is_candidate(model, shared, taken, model))
        is_close = may_be_close(model, shared, taken, counted)
        return following._replace(since=since_after(shared, taken)), Trace(stick, taken, is_close)

    def after_block(self, samples: CountedSample, motions: _StepMotion, records: Trace) -> _StepMotion:
        if records.is_candidate is None or len(self.bandwidths) == 0:
            return motions
        bandwidths = jnp.asarray(self.bandwidths, samples.deterministic_until.dtype)

        def with_vanishing(sums, stick):
            of_stick = stick.start, stick.end - stick.start, stick.ending
            more = BoundarySums.over_vanishing(*of_stick, samples.deterministic_until, bandwidths)
            return jax.tree.map(jnp.add, sums, more), None

        sums, _ = lax.scan(with_vanishing, motions.sums, records.sticks)
        steps, lanes = records.is_candidate.shape
        found = jnp.cumsum(records.is_candidate.reshape(-1))
        taken = jax.tree.map(lambda leaf: leaf.reshape(steps * lanes, *leaf.shape[2:]), records.candidates)

        def with_some_more(carry):
            # As many candidates at once as there are lanes: the k-th is where k have been found.
            done, sums = carry
            wanted = done + jnp.arange(1, lanes + 1)
            at = jnp.minimum(jnp.searchsorted(found, wanted), steps * lanes - 1)
            lane, exists = at % lanes, wanted <= found[-1]
            smooth, deterministic_until = jax.tree.map(lambda leaf: leaf[lane], samples)
            distances = self._distances_of(jax.tree.map(lambda leaf: leaf[at], taken), smooth)
            more = BoundarySums.over(distances.after(deterministic_until[:, None], exists[:, None]), bandwidths)
            more = jax.tree.map(lambda kinds: jnp.sum(kinds, axis=-1), more)
            return done + lanes, jax.tree.map(lambda so_far, new: _put(so_far, lane, new), sums, more)

        begun = jnp.zeros_like(found[-1]), sums
        _, sums = lax.while_loop(lambda carry: carry[0] < found[-1], with_some_more, begun)
        return motions._replace(sums=sums)

    def distances(self, samples: CountedSample, candidates: EngineStep) -> BoundaryDistances:
        """The signed distances (slots, lanes, kinds) of candidates (slots, lanes)."""
        return jax.vmap(self._distances_of, in_axes=(0, None))(candidates, samples.own)

    def _distances_of(self, candidates: EngineStep, smooth: Signal | None) -> BoundaryDistances:
        """The signed distances (candidates, kinds) of candidates, each under its own smooth excitation."""
        shared, counted = self.shared(candidates.t.dtype), self._counted

        def of(candidate, smooth):
            model = self._model(smooth)
            if counted is not None:
                return distances_of_contacts(model, shared, candidate, counted)
            return stacked(distances_of_step(model, shared, candidate, model))

        return jax.vmap(of)(candidates, smooth)

    @property
    def _counted(self) -> int | None:
        """Of several contacts the track whose sticks are counted."""
        return self.engine.system.tracks.counted

    def _model(self, smooth: Signal | None) -> Any:
        system, solver = self.engine.system, self.engine.solver
        if self._counted is not None:
            return system.switched_model(smooth, solver)
        return one_contact_model(system, smooth, solver)

    def ended(self, motion: _StepMotion, before: _StepMotion) -> BoolArray:
        return self.engine.ended(motion.lane, before.lane)

    def results(self, sample: CountedSample, motion: _StepMotion) -> Counted:
        totals = self.engine.results(sample.own, motion.lane)
        return Counted(totals.status, totals.stick_time, totals.sticks, motion.sums)


def _put(so_far: FloatArray, lane: IntArray, more: FloatArray) -> FloatArray:
    """`so_far` (lanes,) with each of `more` added to its lane. (XLA does not compile a scatter to a native loop.)"""

    def one(i, kept):
        new = lax.dynamic_index_in_dim(kept, lane[i], keepdims=False) + more[i]
        return lax.dynamic_update_index_in_dim(kept, new, lane[i], 0)

    return lax.fori_loop(0, len(lane), one, so_far)
