"""The engine of regularised dynamics: many trajectories, or one with its states."""

import dataclasses
import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._excitation.excitation import Excitation, excitation_of
from ..._excitation.motion import Signal
from ..._foundation import checks
from ..._foundation.types import AnyArray, AnyInteger, DType, FloatArray, IntArray, Number, Scalar
from ..._numerics.derivatives import NotKnown, with_slopes
from ..._numerics.elementary import random_words
from ..._systems.switched_model import Segments, State
from ..._systems.system import System
from ..common.lanes import SampleTotals, with_leaves
from ..common.method import Regularized, longest_step, max_steps_advice, step_for
from ..common.path import (
    MotionPath,
    Run,
    is_short,
    largest_in_steps,
    of_track,
    padded_length,
    sample_totals,
    status_of_lane,
)
from ..sticks import ALL, StickRecord
from .balances import with_slope
from .field import field_of
from .solve import (
    ADAPTIVE_STEPS,
    MORE,
    FixedEngine,
    PathStep,
    Tables,
    fixed_steps,
    follow_adaptive,
    numbers_as_arrays,
    resolved,
    status_of,
    table_sizes,
)
from .sticks import Cubic, hermite

# Many trajectories of regularised dynamics in adaptive steps: whole batches.


class AdaptiveBatch(NamedTuple):
    """Samples of any system under any excitation that diffrax solves together, each in its own steps.

    `method`: with every option filled in. `longest_step`: of any sample, s (`method.py`). `sizes`: number
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
    t1 = jnp.asarray(batch.t1, dtype)

    def one(place, number, varying):
        words = random_words(key_data, number)
        here = with_leaves(batch, leaf_numbers, varying)
        smooth = jax.tree.map(partial(jnp.asarray, dtype=dtype), here.excitation.realized(words, dtype))
        tables = Tables.of(here.system, here.excitation, words, sizes, dtype)
        y0, until = tuple(jnp.asarray(value, dtype) for value in here.y0), jnp.where(place < used, t1, 0)
        given = field_of(here.system, smooth, here.method), tables, until, y0, here.method, here.longest_step
        solution, detector, records = follow_adaptive(
            *given, most, ALL if keep else (), lambda record, _: of_track(record, here.system) if keep else None
        )
        return detector.found, status_of(solution, detector), records

    found, statuses, records = jax.vmap(one)(
        jnp.arange(samples, dtype=jnp.uint32), jnp.asarray(realization, jnp.uint32), varying
    )
    near = jnp.zeros(statuses.shape, jnp.int32)
    return sample_totals(batch.system, found.totals, found.at_start, statuses, near), records


# One trajectory of regularised dynamics, in fixed or adaptive steps, and the state along it.


_MOST_SLOPES = 8  # by more numbers, going back over the steps takes less time
_NO_KEY_DATA = np.zeros(2, np.uint32)  # a realisation draws nothing


class CubicPath(MotionPath):
    """Path given by the states and rates at the ends of all steps, with a cubic for each state in between.

    `t` (s) and `y` have an entry for the beginning of each step and one for the end of the last.
    """

    smooth: Signal | None
    tables: Tables
    t: Array
    y: State
    rates: State
    end_rates: State

    @classmethod
    def of(
        cls, smooth: Signal | None, tables: Tables, passages: PathStep, steps: IntArray, last: FloatArray, final: State
    ):
        """The path of the first `steps` passages (the others are empty), which ends at time `last` in `final`."""
        live = jnp.arange(len(passages.t)) < steps

        def closed(values, end):
            return jnp.append(jnp.where(live, values, end), end)

        y = tuple(closed(values, end) for values, end in zip(passages.y, final, strict=True))
        return cls(smooth, tables, closed(passages.t, last), y, passages.rates, passages.end_rates)

    @property
    def times(self) -> Array:
        return self.t[:-1]

    def state(self, time: FloatArray) -> State:
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0, len(self.t) - 2)
        tau, h = time - self.t[index], self.t[index + 1] - self.t[index]
        return tuple(
            hermite(tau, h, Cubic(y[index], rate[index], y[index + 1], end_rate[index]))
            for y, rate, end_rate in zip(self.y, self.rates, self.end_rates, strict=True)
        )

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        y, lengths = self.y[number], jnp.diff(self.t)
        cubics = Cubic(y[:-1], self.rates[number], y[1:], self.end_rates[number])

        def inside(step: tuple[Cubic, FloatArray], tau: FloatArray) -> tuple[FloatArray, FloatArray]:
            return with_slope(lambda tau: sign * hermite(tau, step[1], step[0]), tau)

        return largest_in_steps(inside, (cubics, lengths), sign * cubics.begin, lengths, sign * final)

    def segments(self, time: FloatArray) -> Segments:
        return self.tables.at(time)


def follow_regularized(
    system: System, base: Any, method: Regularized, t1: Scalar, y0: tuple[Number, ...], dtype
) -> tuple[Regularized, Run]:
    """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
    excitation = excitation_of(base)
    system.check_excitation(excitation)
    given, method = method, resolved(system, excitation, method, dtype)
    if given.step is not None:
        step = step_for(system, excitation, given)  # raises for a step that is too long; shortens it where traced
        if checks.is_traced(step):
            method = dataclasses.replace(method, step=lax.stop_gradient(jnp.asarray(step, dtype)))
    adaptive = method.step is None
    steps = method.max_steps or ADAPTIVE_STEPS
    if not adaptive and method.max_steps is None:
        try:
            steps = padded_length(fixed_steps(system, excitation, given, t1))
        except NotKnown:
            raise ValueError(
                "Argument method must give max_steps, Regularized(..., max_steps=...), when t1 or the step is an "
                f"argument of a function under jax.jit: {max_steps_advice(system, excitation, given, t1)}."
            ) from None
    sizes = table_sizes(system, excitation, t1)
    longest = longest_step(system, excitation) if adaptive else math.inf
    system, excitation, t1, y0, longest = numbers_as_arrays((system, excitation, t1, y0, longest), dtype)
    setting = system, excitation, method, jnp.asarray(t1), y0, longest
    run: Run = _follow(*setting, steps, sizes)
    if not adaptive:
        return method, run
    while given.max_steps is None and steps < ADAPTIVE_STEPS * MORE**2 and is_short(run.status):
        steps *= MORE
        run = _follow(*setting, steps, sizes)
    return dataclasses.replace(method, max_steps=steps), run


@eqx.filter_jit
def _follow(
    system: System,
    excitation: Excitation,
    method: Regularized,
    t1: Array,
    y0: tuple[Number, ...],
    longest: Scalar,  # of adaptive steps, s
    steps: int,
    sizes: tuple[int, ...],
) -> Run:
    tables = Tables.of(system, excitation, _NO_KEY_DATA, sizes, t1.dtype)
    if method.step is None:
        field = field_of(system, excitation.signal, method)
        solution, detector, kept = follow_adaptive(
            field, tables, t1, y0, method, longest, steps, ALL, lambda *found: found
        )
        end = solution.steps, solution.t[solution.steps], tuple(solution.y[solution.steps])
        status = status_of(solution, detector)
    else:
        # Tolerances are for adaptive steps, and the shortest duration only decides: neither has a derivative.
        shortest = lax.stop_gradient(method.minimum_duration)
        fixed = dataclasses.replace(method, step=None, atol=None, minimum_duration=shortest)
        engine = FixedEngine(system, excitation, t1, y0, method.step, steps, fixed, quantities=ALL)
        lane, kept = with_slopes(lambda engine: engine.follow(t1.dtype), engine, most=_MOST_SLOPES)
        final = system.switched_model(excitation.signal, None).numbers(lane.y)
        detector, end, status = lane.detector, (lane.steps, lane.t, final), status_of_lane(lane, t1)
    records, passages = kept
    path = CubicPath.of(excitation.signal, tables, passages, *end)
    return Run.of(system, records, detector.found.totals, status, *end[1:], jnp.zeros((), jnp.int32), path)
