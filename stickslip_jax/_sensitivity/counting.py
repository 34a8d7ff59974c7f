"""Sticks counted while they are simulated, so that the derivative of the count is that of its expectation.

Each stick adds its flux through every edge of its existence (`edges.py`, `kernels.py`) to that derivative. Where gaps
are exponential, what is left of one at an arrival is exponential too, whatever came before: its density at 0 is the
rate, for every stick. No kernel is needed for that race, and no stick is unused.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from .._dynamics.interval.engine import Scales, scales_of, start_motion, status_of
from .._dynamics.interval.lanes import is_over
from .._dynamics.lanes import Engine
from .._events.sticks import start_totals
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


class _Motion(NamedTuple):
    """The motion of one lane, the flux that it has seen, and how often its base has switched."""

    lane: IntervalLane
    flux: Flux
    switches: IntArray


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

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Any, _Motion]:
        x, velocity = realised_state(self.y0, key_data, dtype)
        motion = start_motion(self.shared(dtype), (x, velocity))
        lane = IntervalLane(self.law.begin(key_data, dtype), motion, start_totals(dtype), jnp.zeros((), dtype))
        return key_data, _Motion(lane, Flux.none(len(self.bandwidths), dtype), jnp.zeros((), jnp.int32))

    def shared(self, dtype) -> Scales:
        return scales_of(self.system, self.t1, dtype)

    def draw(self, sample: Any, number: Array, dtype) -> tuple[Any, BoolArray]:
        return self.law.draw(sample, number, dtype), number == 0

    def step(self, shared: Scales, sample: Any, motion: _Motion, drawn: tuple[Any, BoolArray]) -> tuple[_Motion, None]:
        (lane, flux, switches), (drawn, is_first) = motion, drawn
        moved, stick, edges, duration = cross_with_edges(self.law, shared, lane, drawn)
        flux = self._with_flux(flux, edges, stick.start - lane.motion.t, is_first & self.fixed_start)
        return _Motion(moved, flux, switches + (lane.motion.t + duration < shared.t1)), None

    def ended(self, motion: _Motion, before: _Motion) -> BoolArray:
        return is_over(motion.lane.motion, before.lane.motion, self.t1)

    def results(self, sample: Any, motion: _Motion) -> Counted:
        totals, flux = motion.lane.totals, motion.flux
        time, births = totals.stick_time, flux.births
        if self.likelihood is not None:
            # log p = switches log(rate) - rate t1 + ..., of a Poisson process.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = weighted_flux(motion.switches / rate - self.t1, rate, jnp.ones((), bool))
            births = tuple(born + (totals.sticks - self.likelihood.sticks) * score for born in births)
            time = time + (time - self.likelihood.stick_time) * score
        status = status_of(motion.lane.motion, jnp.asarray(self.t1, time.dtype))
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
