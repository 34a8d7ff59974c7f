"""Counts of sticks whose derivative is that of the expected count, accumulated during the simulation.

To that derivative each stick and near miss adds its flux through zero of every margin of existence (`edges.py`,
`kernels.py`). Where the gaps between switches are exponential, the time left at an arrival is exponential too
(memorylessness): its density at 0 is the rate, for every stick. So the race between arrival and switch needs no kernel.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from .._dynamics.interval.engine import Scales, scales_of, start_motion, status_of
from .._dynamics.interval.lanes import is_over
from .._dynamics.lanes import Engine
from .._events.sticks import start_totals
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._systems.mass_spring import MassSpring
from .._types import AnyArray, Array, BoolArray, FloatArray, IntArray, Scalar
from .edges import Edges, IntervalLane, cross_with_edges
from .kernels import crossing, ending, hits, through, weighted_flux


class Likelihood(NamedTuple):
    """Data for the derivative by the rate of a Poisson base, from the likelihood of the number of switches (score)."""

    rate: Scalar  # a copy of the law's rate, 1/s: differentiated for the score part, the law's for the pathwise part
    stick_time: Scalar  # approximate means, s and 1, subtracted to reduce the variance (control variate)
    sticks: Scalar


class Counted(NamedTuple):
    """The totals of each sample.

    `births` and `near` hold one entry per window. Their values are zero; the derivative of `births` is the event part
    of that of the number of sticks, the derivative of `near` counts the margins inside the kernel's window.
    """

    status: AnyArray
    stick_time: AnyArray
    sticks: AnyArray
    births: tuple[AnyArray, ...]
    near: tuple[AnyArray, ...]


class Flux(NamedTuple):
    """The flux so far, for each window: `births` and `near` of `Counted`."""

    births: tuple[FloatArray, ...]
    near: tuple[FloatArray, ...]

    @classmethod
    def none(cls, windows: int, dtype: Any) -> "Flux":
        """No flux, at the beginning."""
        zeros = (jnp.zeros((), dtype),) * windows
        return cls(zeros, zeros)


class _Motion(NamedTuple):
    """The motion of one lane, its flux so far, and the number of switches of its base."""

    lane: IntervalLane
    flux: Flux
    switches: IntArray


class IntervalCounting(Engine):
    """Engine that counts sticks of a `MassSpring` on a base that follows `law`, up to `t1`, from `y0`.

    `bandwidths` (windows,): relative bandwidths of the kernels (see
    `kernels.crossing`). `fixed_start`: whether all samples begin in the same state: then the outcome of the first arc
    has no density.
    """

    system: MassSpring
    law: PiecewiseConstantLaw
    t1: Scalar
    y0: tuple[Any, ...]
    bandwidths: AnyArray
    likelihood: Likelihood | None
    fixed_start: bool = eqx.field(static=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Any, _Motion]:
        x, velocity = self.y0
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
            # Score of a Poisson process: d log p / d rate = switches / rate - t1.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = weighted_flux(motion.switches / rate - self.t1, rate, jnp.ones((), bool))
            births = tuple(born + (totals.sticks - self.likelihood.sticks) * score for born in births)
            time = time + (time - self.likelihood.stick_time) * score
        status = status_of(motion.lane.motion, jnp.asarray(self.t1, time.dtype))
        return Counted(status, time, totals.sticks, births, flux.near)

    def _with_flux(self, total: Flux, edges: Edges, arrival: FloatArray, is_fixed: BoolArray | bool) -> Flux:
        """`total` with the flux that one interval adds."""
        exact, races = jnp.zeros_like(arrival), ~jnp.asarray(is_fixed)
        law: Any = self.law
        if law.has_exponential_gaps:
            rate = jnp.asarray(law.rate, arrival.dtype)
            # A gap that ends at the arrival, E / rate with its random number E held fixed.
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
