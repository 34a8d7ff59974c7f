"""Counts of sticks as in `counting.py`, for any motion that is simulated in time steps.

In most steps no stick is about to appear or vanish. The others are collected for a block, and their margins are found
together.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._dynamics.lanes import Engine
from .._dynamics.switched.lanes import Shared, SwitchedEngine
from .._events.sticks import StickRecord
from .._status import Ending
from .._types import AnyArray, Array, BoolArray
from .counting import Counted, Flux
from .kernels import crossing, ending, hits, through
from .traces import Sample, StepMotion, Trace, TracedSteps


class _Motion(NamedTuple):
    """The motion of one lane, and its flux so far."""

    traced: StepMotion
    flux: Flux


class StepCounting(Engine):
    """Engine that counts the sticks that `steps` simulates; `bandwidths`, `fixed_start` as for `IntervalCounting`.

    Without `bandwidths` it gives only pathwise derivatives.
    """

    steps: SwitchedEngine
    bandwidths: AnyArray
    fixed_start: bool = eqx.field(static=True)
    looks_back = True

    @property
    def _traced(self) -> TracedSteps:
        return TracedSteps(self.steps, self.fixed_start, with_edges=len(self.bandwidths) > 0)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Sample, _Motion]:
        sample, traced = self._traced.begin(key_data, dtype)
        return sample, _Motion(traced, Flux.none(len(self.bandwidths), dtype))

    def shared(self, dtype) -> Shared:
        return self.steps.shared(dtype)

    def step(self, shared: Shared, sample: Sample, motion: _Motion, drawn: None) -> tuple[_Motion, Trace]:
        traced, trace = self._traced.step(shared, sample, motion.traced, drawn)
        return _Motion(traced, motion.flux), trace

    def after_block(self, samples: Sample, motions: _Motion, records: Trace) -> _Motion:
        if records.moments is None:
            return motions
        return motions._replace(flux=self._with_flux(samples, motions.flux, records))

    def ended(self, motion: _Motion, before: _Motion) -> BoolArray:
        return self._traced.ended(motion.traced, before.traced)

    def results(self, sample: Sample, motion: _Motion) -> Counted:
        totals = self.steps.results(sample.own, motion.traced.lane)
        return Counted(totals.status, totals.stick_time, totals.sticks, *motion.flux)

    def _with_flux(self, samples: Sample, flux: Flux, trace: Trace) -> Flux:
        """`flux` with that of all margins of a block added."""
        bandwidths = jnp.asarray(self.bandwidths, samples.certain.dtype)
        flux = self._from_start(samples, flux, trace.sticks, bandwidths)
        assert trace.may_be_near is not None
        steps, lanes = trace.may_be_near.shape
        found = jnp.cumsum(trace.may_be_near.reshape(-1))
        moments = jax.tree.map(lambda leaf: leaf.reshape(steps * lanes, *leaf.shape[2:]), trace.moments)

        def some_more(carry):
            done, flux = carry
            wanted = done + jnp.arange(1, lanes + 1)
            at = jnp.minimum(jnp.searchsorted(found, wanted), steps * lanes - 1)
            lane, exists = at % lanes, wanted <= found[-1]
            smooth, certain = jax.tree.map(lambda leaf: leaf[lane], samples)
            edges = self._traced.edges_of(jax.tree.map(lambda leaf: leaf[at], moments), smooth)
            edges = edges.only(exists & (edges.time >= certain), exists)

            def add(kept, both_sides, one_side):
                return tuple(_put(so_far, lane, through(edges, bandwidth, both_sides, one_side))
                             for so_far, bandwidth in zip(kept, bandwidths, strict=True))  # fmt: skip

            return done + lanes, Flux(add(flux.births, crossing, ending), add(flux.near, hits, hits))

        return lax.while_loop(lambda carry: carry[0] < found[-1], some_more, (jnp.zeros_like(found[-1]), flux))[1]

    def _from_start(self, samples: Sample, flux: Flux, sticks: StickRecord, bandwidths: Array) -> Flux:
        """`flux` with that of sticks from t = 0, which vanish as their duration falls to 0."""

        def add(flux, stick):
            is_random = (samples.certain == 0) | (stick.ending == Ending.BASE_SWITCHED)
            may_vanish = (stick.ending >= 0) & (stick.start == 0) & (stick.ending != Ending.HORIZON) & is_random
            duration = stick.end - stick.start
            births, near = (
                tuple(kernel(duration, bandwidth, may_vanish) for bandwidth in bandwidths) for kernel in (ending, hits)
            )
            return jax.tree.map(jnp.add, flux, Flux(births, near)), None

        return lax.scan(add, flux, sticks)[0]


def _put(so_far: Array, lane: Array, more: Array) -> Array:
    """`so_far` (lanes,) with each of `more` added to its lane. (XLA does not compile a scatter to a native loop.)"""

    def one(i, kept):
        new = lax.dynamic_index_in_dim(kept, lane[i], keepdims=False) + more[i]
        return lax.dynamic_update_index_in_dim(kept, new, lane[i], 0)

    return lax.fori_loop(0, len(lane), one, so_far)
