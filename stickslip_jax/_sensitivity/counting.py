"""Sticks counted while they are simulated, so that the derivative of the count is that of its expectation.

Each stick adds its flux through every edge of its existence (`edges.py`, `kernels.py`) to that derivative. Where gaps
are exponential, what is left of one at an arrival is exponential too, whatever came before: its density at 0 is the
rate, for every stick. No kernel is needed for that race, and no stick is unused.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._dynamics.interval.engine import Scales, scales_of, start_motion, status_of
from .._dynamics.interval.lanes import draw_block
from .._dynamics.lanes import Engine
from .._events.records import start_totals
from .._excitation.laws import BangBangLaw, PoissonSwitching
from .._excitation.random import realised_state
from .._systems.mass_spring import MassSpring
from .._types import AnyArray, Array, BoolArray, FloatArray, IntArray, Scalar
from .edges import Edges, IntervalLane, cross_with_edges
from .kernels import crossing, ending, hits, through, weighted_flux


class Likelihood(NamedTuple):
    """What the derivative by the rate of a Poisson base takes from the likelihood of the number of switches."""

    rate: Scalar  # the rate again, 1/s: derivatives by this one come from the likelihood, those by the law's pathwise
    stick_time: Scalar  # about the means, s and 1: subtracted, so that less is left to average out
    sticks: Scalar


class Counted(NamedTuple):
    """The totals of each sample. Of the last two there is one for each window, both zero.

    The derivative of `births` is what sticks born and lost add to that of the number of sticks; the derivative of
    `near` counts the edges that a kernel reached.
    """

    status: AnyArray
    stick_time: AnyArray
    sticks: AnyArray
    births: tuple[AnyArray, ...]
    near: tuple[AnyArray, ...]


class Flux(NamedTuple):
    """What has come through the edges so far, for each window: `births` and `near` of `Counted`."""

    births: tuple[FloatArray, ...]
    near: tuple[FloatArray, ...]

    @classmethod
    def none(cls, windows: int, dtype: Any) -> "Flux":
        """At the beginning."""
        zeros = (jnp.zeros((), dtype),) * windows
        return cls(zeros, zeros)


class _Lanes(NamedTuple):
    """The state of every lane."""

    key_data: tuple[Array, Array]  # the key words of the lane's sample
    first: Array  # number of its next interval
    lane: IntervalLane
    flux: Flux
    switches: IntArray
    stalled: BoolArray


class IntervalCounting(Engine):
    """A `MassSpring` on a base that follows `law`, up to `t1`, from `y0` (numbers, or `Uniform` values).

    `bandwidths` (windows,): how far the kernels look, as shares of the parameter (see `kernels.crossing`).
    `fixed_start`: whether all samples begin in the same state. The outcome of the first arc then has no density.
    """

    system: MassSpring
    law: BangBangLaw
    t1: Scalar
    y0: tuple[Any, ...]
    bandwidths: AnyArray
    likelihood: Likelihood | None
    fixed_start: bool = eqx.field(static=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> _Lanes:
        x, velocity = realised_state(self.y0, key_data, dtype)
        motion = start_motion(self._scales(dtype), (x, velocity))
        none, zero = jnp.zeros((), jnp.int32), jnp.zeros((), dtype)
        lane = IntervalLane(self.law.begin(key_data, dtype), motion, start_totals(dtype), zero)
        flux = Flux.none(len(self.bandwidths), dtype)
        return _Lanes(key_data, none.astype(jnp.uint32), lane, flux, none, jnp.zeros((), bool))

    def advance(self, state: _Lanes, dtype, buffer: Any, slot: Array | int) -> tuple[_Lanes, Any]:
        scales = self._scales(dtype)
        drawn, numbers = draw_block(self.law, state.key_data, state.first, dtype)

        def step_one(lane, flux, switches, drawn, is_first):
            moved, stick, edges, duration = cross_with_edges(self.law, scales, lane, drawn)
            arrival = stick.start - lane.motion.t
            flux = self._with_flux(flux, edges, arrival, is_first & self.fixed_start)
            return moved, flux, switches + (lane.motion.t + duration < scales.t1)

        def step(lanes, inputs):
            return jax.vmap(step_one)(*lanes, *inputs), None

        begun = (state.lane, state.flux, state.switches)
        (lane, flux, switches), _ = lax.scan(step, begun, (drawn, numbers == 0))
        stalled = lane.motion.t <= state.lane.motion.t
        return _Lanes(state.key_data, state.first + np.uint32(len(numbers)), lane, flux, switches, stalled), buffer

    def ended(self, state: _Lanes) -> BoolArray:
        # Written so that a NaN time counts as ended.
        t = state.lane.motion.t
        return ~(t < jnp.asarray(self.t1, t.dtype)) | state.stalled

    def results(self, state: _Lanes) -> Counted:
        motion, totals, flux = state.lane.motion, state.lane.totals, state.flux
        time, births = totals.stick_time, flux.births
        if self.likelihood is not None:
            # log p = switches log(rate) - rate t1 + ..., of a Poisson process.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = weighted_flux(state.switches / rate - self.t1, rate, jnp.ones((), bool))
            births = tuple(born + (totals.sticks - self.likelihood.sticks) * score for born in births)
            time = time + (time - self.likelihood.stick_time) * score
        status = status_of(motion, jnp.asarray(self.t1, time.dtype))
        return Counted(status, time, totals.sticks, births, flux.near)

    def _with_flux(self, total: Flux, edges: Edges, arrival: FloatArray, is_fixed: BoolArray | bool) -> Flux:
        """`total` with what one interval adds: its flux through every edge of existence."""
        exact, races = jnp.zeros_like(arrival), ~jnp.asarray(is_fixed)
        if isinstance(self.law, PoissonSwitching):
            rate = jnp.asarray(self.law.rate, arrival.dtype)
            # The gap that ends at the arrival, with the random number that made it held fixed.
            gap = lax.stop_gradient(arrival) * lax.stop_gradient(rate) / rate
            exact, races = weighted_flux(rate, gap - arrival, edges.exists), jnp.zeros((), bool)
        edges = edges.only(~jnp.asarray(is_fixed), races)
        bandwidths = jnp.asarray(self.bandwidths, arrival.dtype)
        return Flux(
            tuple(born + exact + through(edges, bandwidth, crossing, ending)
                  for born, bandwidth in zip(total.births, bandwidths, strict=True)),
            tuple(near + through(edges, bandwidth, hits, hits)
                  for near, bandwidth in zip(total.near, bandwidths, strict=True)),
        )  # fmt: skip

    def _scales(self, dtype) -> Scales:
        return scales_of(self.system, self.t1, dtype)
