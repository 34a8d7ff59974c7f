"""Counts of sticks as in `counting.py`, for any motion that is simulated in time steps.

Most steps are close to no boundary. The others are collected for a block, and their signed distances are found
together.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._dynamics.common.engine import Engine
from .._dynamics.switched.engine import SwitchedEngine, SwitchedShared
from .._events.sticks import StickRecord
from .._types import AnyArray, Array, BoolArray, FloatArray, IntArray
from .boundaries import SignedDistance, vanishes_from_start
from .counting import Counted
from .kernels import BoundarySums
from .recording import StepMotion, StepRecording, StepSample, Trace


class _Motion(NamedTuple):
    """The motion of one lane, and its sums so far."""

    recorded: StepMotion
    sums: BoundarySums


class StepCounting(Engine[SwitchedShared, StepSample, _Motion, Trace, Counted]):
    """Engine that counts the sticks that `engine` simulates; `bandwidths`, `fixed_start` as for `IntervalCounting`.

    Without `bandwidths` it gives only pathwise derivatives.
    """

    engine: SwitchedEngine
    bandwidths: AnyArray
    fixed_start: bool = eqx.field(static=True)
    looks_back = True

    @property
    def _recording(self) -> StepRecording:
        return StepRecording(self.engine, self.fixed_start, with_distances=len(self.bandwidths) > 0)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[StepSample, _Motion]:
        sample, motion = self._recording.begin(key_data, dtype)
        return sample, _Motion(motion, BoundarySums.none(len(self.bandwidths), dtype))

    def shared(self, dtype) -> SwitchedShared:
        return self.engine.shared(dtype)

    def step(self, shared: SwitchedShared, sample: StepSample, motion: _Motion, drawn: None) -> tuple[_Motion, Trace]:
        moved, trace = self._recording.step(shared, sample, motion.recorded, drawn)
        return _Motion(moved, motion.sums), trace

    def after_block(self, samples: StepSample, motions: _Motion, records: Trace) -> _Motion:
        if records.candidates is None:
            return motions
        return motions._replace(sums=self._with_block(samples, motions.sums, records))

    def ended(self, motion: _Motion, before: _Motion) -> BoolArray:
        return self._recording.ended(motion.recorded, before.recorded)

    def results(self, sample: StepSample, motion: _Motion) -> Counted:
        totals = self.engine.results(sample.smooth, motion.recorded.lane)
        return Counted(totals.status, totals.stick_time, totals.sticks, *motion.sums)

    def _with_block(self, samples: StepSample, sums: BoundarySums, trace: Trace) -> BoundarySums:
        """`sums` with those over all candidates of a block added."""
        bandwidths = jnp.asarray(self.bandwidths, samples.deterministic_until.dtype)
        sums = _with_first_sticks(samples, sums, trace.sticks, bandwidths)
        assert trace.is_candidate is not None
        steps, lanes = trace.is_candidate.shape
        found = jnp.cumsum(trace.is_candidate.reshape(-1))
        taken = jax.tree.map(lambda leaf: leaf.reshape(steps * lanes, *leaf.shape[2:]), trace.candidates)

        def some_more(carry):
            # As many candidates at once as there are lanes: the k-th is where k have been found.
            done, sums = carry
            wanted = done + jnp.arange(1, lanes + 1)
            at = jnp.minimum(jnp.searchsorted(found, wanted), steps * lanes - 1)
            lane, exists = at % lanes, wanted <= found[-1]
            smooth, deterministic_until = jax.tree.map(lambda leaf: leaf[lane], samples)
            distances = self._recording.distances_of(jax.tree.map(lambda leaf: leaf[at], taken), smooth)
            # Before anything random happens no distance has a density, except that to the base's first change.
            distances = distances.only(exists & (distances.time >= deterministic_until), exists)
            more = BoundarySums.over(distances.two_sided, distances.one_sided, bandwidths)
            return done + lanes, jax.tree.map(lambda so_far, new: _put(so_far, lane, new), sums, more)

        return lax.while_loop(lambda carry: carry[0] < found[-1], some_more, (jnp.zeros_like(found[-1]), sums))[1]


def _with_first_sticks(
    samples: StepSample, sums: BoundarySums, sticks: StickRecord, bandwidths: FloatArray
) -> BoundarySums:
    """`sums` with those over sticks from t = 0, which vanish as their duration falls to 0."""

    def add(sums, stick):
        may_vanish = vanishes_from_start(stick.start, stick.ending, samples.deterministic_until)
        duration = SignedDistance(stick.end - stick.start, may_vanish)
        return jax.tree.map(jnp.add, sums, BoundarySums.over((), (duration,), bandwidths)), None

    return lax.scan(add, sums, sticks)[0]


def _put(so_far: FloatArray, lane: IntArray, more: FloatArray) -> FloatArray:
    """`so_far` (lanes,) with each of `more` added to its lane. (XLA does not compile a scatter to a native loop.)"""

    def one(i, kept):
        new = lax.dynamic_index_in_dim(kept, lane[i], keepdims=False) + more[i]
        return lax.dynamic_update_index_in_dim(kept, new, lane[i], 0)

    return lax.fori_loop(0, len(lane), one, so_far)
