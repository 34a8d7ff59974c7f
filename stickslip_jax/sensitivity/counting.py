"""Sticks counted while they are simulated, so that the derivative of the count is that of its expectation.

On a base of piecewise-constant velocity a stick begins when the mass arrives at the base velocity inside the band, at
most one in each interval. It is born or lost where one of these numbers passes zero, each with its own flux
(`kernels.py`):

- what is left of the interval at the arrival, ``gap - arrival``. Where gaps are exponential it is exponential too,
  whatever came before: its density at 0 is the rate, for every stick. No kernel is needed and no stick is unused.
  Elsewhere arrivals soon after the switch count as much as those soon before.
- ``R^2 - q^2`` of the interval's first arc, where it comes from below: negative where the arc stays below the base
  velocity q. It is smooth, so near misses count as much as short sticks.
- the time from the arrival to the release edge, for arcs from above, which at the edge turn into crossings.
- the time from the arrival to the horizon.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._status import Ending
from .._types import AnyArray, Array, BoolArray, FloatArray, IntArray, Scalar
from ..base_motion.laws import BangBangLaw, PoissonSwitching
from ..base_motion.random import realised_state
from ..dynamics.interval_engine import (
    Motion,
    Scales,
    StickRecord,
    Totals,
    cross_interval,
    scales_of,
    start_motion,
    start_totals,
    status_of,
)
from ..dynamics.lanes import BLOCK, Engine, LaneResults
from ..numerics.elementary import angle_of
from ..systems.mass_spring import MassSpring
from .kernels import crossing, ending, flux, hits

_TOUCH_ULPS = {8: 4096, 4: 64}  # within so many units in the last place, R and q are equal


class Likelihood(NamedTuple):
    """What the derivative by the rate of a Poisson base takes from the likelihood of the number of switches."""

    rate: Scalar  # the rate again, 1/s: derivatives by this one come from the likelihood, those by the law's pathwise
    stick_time: Scalar  # about the means, s and 1: subtracted, so that less is left to average out
    sticks: Scalar


class _Past(NamedTuple):
    """What the flux in the next interval needs to know of those before."""

    births: FloatArray  # zero; its derivative is what sticks born and lost add to that of the number of sticks
    narrow: FloatArray  # the same by narrower windows
    near: FloatArray  # zero; its derivative counts the arcs that a kernel reached
    switches: IntArray
    cut_velocity: FloatArray  # m/s of the base while a stick lasted to the last switch; 0 where none did


class _Lanes(NamedTuple):
    """The state of every lane."""

    words: tuple[Array, Array]  # the key words of the lane's sample
    first: Array  # number of its next interval
    memory: Any  # what the law remembers
    motion: Motion
    totals: Totals
    past: _Past
    stalled: BoolArray


class CountingEngine(Engine):
    """A `MassSpring` on a base that follows `law`, up to `t1`, from `y0` (numbers, or `Uniform` values).

    The results' `sticks` are real numbers with the derivative of the expectation, `slips` are zeros with the same one
    found by windows a quarter as wide, and the derivative of `doubts` counts the arcs near the edge of a stick's
    existence: those within a window. `fixed_start` tells that all samples begin in the same
    state: what comes of the first arc is then no random number with a density.
    """

    system: MassSpring
    law: BangBangLaw
    t1: Scalar
    y0: tuple[Any, ...]
    reach: AnyArray  # how far the widest kernels look, as a share of the parameter (see `kernels.crossing`)
    likelihood: Likelihood | None
    fixed_start: bool = eqx.field(static=True)

    def begin(self, words: tuple[Array, Array], dtype) -> _Lanes:
        x, velocity = realised_state(self.y0, words, dtype)
        motion = start_motion(self._scales(dtype), (x, velocity))
        none, zero = jnp.zeros((), jnp.int32), jnp.zeros((), dtype)
        memory = self.law.begin(words, dtype)
        past = _Past(zero, zero, zero, none, zero)
        return _Lanes(words, none.astype(jnp.uint32), memory, motion, start_totals(dtype), past, jnp.zeros((), bool))

    def advance(self, state: _Lanes, dtype, room: Any, slot: Array | int) -> tuple[_Lanes, Any]:
        law, scales = self.law, self._scales(dtype)
        draw = jax.vmap(lambda words, number: law.draw(words, number, dtype))
        numbers = state.first + jnp.arange(BLOCK, dtype=jnp.uint32)[:, None]
        drawn = jax.vmap(draw, in_axes=(None, 0))(state.words, numbers)

        def step_one(lane, drawn, is_first):
            memory, motion, totals, past = lane
            duration, velocity, memory = law.next_interval(memory, drawn, dtype)
            duration = jnp.where(duration >= scales.t1, scales.t1, duration)
            moved, totals, stick = cross_interval(scales, motion, totals, duration, velocity)
            past = self._with_flux(past, scales, motion, stick, duration, velocity, is_first & self.fixed_start)
            return memory, moved, totals, past

        def step(lanes, inputs):
            return jax.vmap(step_one)(lanes, *inputs), None

        lanes = (state.memory, state.motion, state.totals, state.past)
        (memory, motion, totals, past), _ = lax.scan(step, lanes, (drawn, numbers == 0), length=BLOCK)
        stalled = motion.t <= state.motion.t
        return _Lanes(state.words, state.first + np.uint32(BLOCK), memory, motion, totals, past, stalled), room

    def ended(self, state: _Lanes) -> BoolArray:
        # Written so that a NaN time counts as ended.
        return ~(state.motion.t < jnp.asarray(self.t1, state.motion.t.dtype)) | state.stalled

    def results(self, state: _Lanes) -> LaneResults:
        time, past = state.totals.stick_time, state.past
        sticks, narrow = state.totals.sticks + past.births, past.narrow
        if self.likelihood is not None:
            # log p = switches log(rate) - rate t1 + ..., of a Poisson process.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = flux(past.switches / rate - self.t1, rate, jnp.ones((), bool))
            by_score = (sticks - self.likelihood.sticks) * score
            sticks, narrow = sticks + by_score, narrow + by_score
            time = time + (time - self.likelihood.stick_time) * score
        return LaneResults(
            sticks=sticks,
            slips=narrow,
            stick_time=time,
            status=status_of(state.motion, jnp.asarray(self.t1, time.dtype)),
            doubts=past.near,
        )

    def _with_flux(
        self,
        past: _Past,
        scales: Scales,
        motion: Motion,
        stick: StickRecord,
        duration: Array,
        velocity: Array,
        is_fixed: BoolArray | bool,
    ) -> _Past:
        """`past` with what one interval adds: its flux through every edge of existence."""
        stuck, moving = stick.ending >= 0, velocity != 0
        random = stuck & ~is_fixed
        arrival, left = stick.start - motion.t, scales.t1 - stick.start
        reach = jnp.asarray(self.reach, arrival.dtype)
        arc = _first_arc(past, scales, motion, duration, velocity)
        meets = arc.meets & ~is_fixed
        speed = jnp.abs(jnp.where(moving, velocity, 1))
        to_edge = (scales.half_width - jnp.sign(velocity) * stick.position) / speed
        from_above = random & moving & ~(arc.is_below & arc.would_stick)
        spare = duration - arrival
        at_switch = None
        exact = jnp.zeros_like(left)
        if isinstance(self.law, PoissonSwitching):
            rate = jnp.asarray(self.law.rate, arrival.dtype)
            # The gap that ends at the arrival, with the random number that made it held fixed.
            gap = lax.stop_gradient(arrival) * lax.stop_gradient(rate) / rate
            exact = flux(rate, gap - arrival, stuck)
        else:
            at_switch = random | (arc.would_stick & ~stuck & (spare <= 0) & (left > 0) & ~is_fixed)

        def through_edges(count, reach):
            """By arcs that graze, come from above, arrive at the horizon or, where that is not exact, at a switch."""
            total = count[0](arc.excess, reach, meets) + count[1](to_edge, reach, from_above)
            total = total + count[1](left, reach, random)
            return total if at_switch is None else total + count[0](spare, reach, at_switch)

        cut = stick.ending == Ending.BASE_SWITCHED
        return _Past(
            births=past.births + exact + through_edges((crossing, ending), reach),
            narrow=past.narrow + exact + through_edges((crossing, ending), reach / 4),
            near=past.near + through_edges((hits, hits), reach),
            switches=past.switches + (motion.t + duration < scales.t1),
            cut_velocity=jnp.where(cut, velocity, 0),
        )

    def _scales(self, dtype) -> Scales:
        return scales_of(self.system, self.t1, dtype)


class _Arc(NamedTuple):
    """The first arc of an interval on a moving base."""

    excess: Array  # R^2 - q^2 in (m/s)^2; the arc reaches the base velocity q where it is positive
    is_below: BoolArray
    meets: BoolArray  # whether its top is reached within the interval, so that a change of sign makes or ends a stick
    would_stick: BoolArray  # whether it meets the base velocity inside the band, given the time


def _first_arc(past: _Past, scales: Scales, motion: Motion, duration: Array, velocity: Array) -> _Arc:
    forward = jnp.where(velocity < 0, -1, 1)
    p, q = forward * motion.p * scales.omega, jnp.abs(velocity)
    D = (forward * motion.x - scales.half_width) * scales.omega
    is_below = p < q
    centre = jnp.where(is_below, 0, 2 * scales.half_width * scales.omega)  # from +a to the arc's
    offset = D + centre
    excess = offset * offset + (p - q) * (p + q)
    # Clockwise from (D, p) to the top, (0, R).
    back, up = lax.stop_gradient(D), lax.stop_gradient(p)
    angle = angle_of(jnp.abs(back), up)
    top = jnp.where(back <= 0, angle, 2 * np.pi - angle) * scales.per_omega
    # A stick that the base's reversal cut short leaves the mass with R >= q, however near: nothing is born there.
    is_reversed = past.cut_velocity == -velocity
    # Where the mass is back on the circle on which it left a stick, R = q whatever the parameters: see `dynamics.arcs`.
    roundoff = _TOUCH_ULPS[p.dtype.itemsize] * jnp.finfo(p.dtype).eps * (D * D + q * q)
    meets = (q > 0) & is_below & ~is_reversed & (jnp.abs(excess) > roundoff)
    meets = meets & (top < duration) & (motion.t + top < scales.t1)
    inside = (excess > 0) & (excess <= (2 * scales.half_width * scales.omega) ** 2)
    return _Arc(excess, is_below, meets, inside)


def relative_excess(scales: Scales, motion: Motion, velocity: Array) -> Array:
    """``R^2 - q^2`` of the first arc on a base of this velocity, by the size of its terms; 1 for one from above."""
    nothing = jnp.zeros_like(motion.x)
    past = _Past(nothing, nothing, nothing, nothing.astype(jnp.int32), nothing)
    arc = _first_arc(past, scales, motion, jnp.full_like(nothing, jnp.inf), velocity)
    size = velocity * velocity + (scales.half_width * scales.omega) ** 2
    return jnp.where(arc.is_below & (velocity != 0), arc.excess / lax.stop_gradient(size), 1)
