"""Lyapunov exponents from the exact derivatives of the motion over each period, through its events."""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._dynamics.common.method import EXACT, Exact
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.extras import Dataset, Entries, variable
from .._foundation.types import BoolScalar, FloatArray, IntArray, Scalar, Status
from .._numerics.matrices import orthogonal_factors
from .._systems.system import System
from ._cases import CYCLE, START, Cycle, Over, cases_of, checked_numbers
from ._following import RECURS, UNSETTLED, Folder, in_blocks, kept_in, recurrence, warn_of_unfinished

EXPONENT = "exponent"
_ALIGNED = 50  # periods of the transient in which the directions turn into those of the exponents
_CHECKPOINTS = 100  # of the convergence curve, at most
_ROUND_OFF = 1e3  # units in the last place: what is left of a direction that a stick takes away


class Stretched(NamedTuple):
    """Of each case: the mean logarithm of the stretch of each direction in a period up to each checkpoint, (cases,
    checkpoints, exponents), the states there, the `Status`, and how often round-off decided (cases,).
    """

    means: Array
    states: Array
    status: Array
    near_grazing_count: Array


class _Carry(NamedTuple):
    y: FloatArray
    directions: FloatArray
    sums: FloatArray
    status: IntArray
    near_grazing_count: IntArray


def lyapunov_exponents(
    system: System,
    base: BaseMotion,
    *,
    y0: Any = None,
    over: Over | None = None,
    exponents: int | None = None,
    transient: int = 200,
    kept: int = 1000,
    period: Scalar | None = None,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> Dataset:
    """The Lyapunov exponents of motions, from many starts and over parameters at once.

    The directions are carried through each period by the exact derivative of the motion, its sticks and slips included,
    and made orthogonal after it (Benettin and others 1980). A stick forgets: motions that differ only in what it makes
    equal are the same afterwards. The exponent of what it forgets is minus infinity, and the others go on without it.

    Args:
        system: A `MassSpring`, a `MotorCart`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion that repeats itself, such as `Constant`, `SquareWave` or `Harmonic`.
        y0: The initial state, such as ``(position, velocity)``, zeros by default; or many of them, an array (starts,
            coordinates).
        over: A dict from names of parameters to values, ``{"mu": [0.5, 1.0]}``; over two parameters the largest
            exponents are a map.
        exponents: How many, from the largest on; by default as many as the state has numbers. One alone is fastest.
        transient: Number of periods before the first that counts; in the last 50 the directions turn.
        kept: Number of periods that count.
        period: s; by default that after which all motions that drive the system repeat themselves together. Where
            nothing drives the system, a time after which directions are made orthogonal again.
        method: `Exact`.
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        folder: Where what is done is kept, block after block, for the same call to go on from there; without it nothing
            is kept.

    Returns:
        ``lyapunov_exponent`` (1/s) with the dimensions of the parameters, "start" if there are several, and "exponent",
        from the largest on. ``running_exponent``: the same up to the period "cycle", for a curve of convergence. With
        several starts ``mean_exponent`` and ``mean_exponent_error``, its standard error over the starts (NaN where one
        is minus infinity). Of each case ``settled``, False where its states still come nearer to an orbit or leave one
        (the exponents are then not yet those of what it settles on, and a larger `transient` lets it go on; in a map
        there are always some next to bifurcations), ``status`` and ``near_grazing_count``. Warns (RuntimeWarning) of
        cases that were not followed to the end; they hold NaN.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.
    """
    transient, kept = checked_numbers(transient, kept)
    cases = cases_of(system, base, y0, over, period, method)
    size = len(cases.system.coordinates)
    number = size if exponents is None else checks.whole_number("exponents", exponents, maximum=size)
    every = math.ceil(kept / min(kept, _CHECKPOINTS))
    checkpoints = math.ceil(kept / every)

    def run(cycle: Cycle, starts: Array) -> Stretched:
        counts = (jnp.asarray(n, jnp.int32) for n in (max(transient - _ALIGNED, 0), min(transient, _ALIGNED), every))
        return _stretch(cycle, starts, *counts, checkpoints=checkpoints, number=number)

    what = {"function": "lyapunov_exponents with states", "exponents": number, "transient": transient, "kept": kept}
    with kept_in(folder, cases, what) as stored:
        found = in_blocks(cases, run, Stretched, progress, stored)
    warn_of_unfinished(found)

    means, states = np.asarray(found.means), np.asarray(found.states)
    settled = recurrence(states, np.max(np.abs(states), axis=1), RECURS, cases.turns) != UNSETTLED
    # The stretches of the first directions are the largest only in the long run: equal ones may come in any order.
    last = -np.sort(-means[:, -1], axis=-1)
    variables: Entries = {
        "lyapunov_exponent": cases.variable(last, "Lyapunov exponent", "1/s", (EXPONENT,)),
        "running_exponent": cases.variable(means, "Lyapunov exponent up to the period", "1/s", (CYCLE, EXPONENT)),
        "settled": cases.variable(settled, "whether the motion has settled"),
        "period": cases.variable(cases.cycle.duration, "period", "s"),
        **cases.outcome(found),
    }
    if cases.dimensions[-1:] == (START,):
        grid = last.reshape((*cases.shape, -1))
        own = (*cases.dimensions[:-1], EXPONENT)
        with np.errstate(invalid="ignore"):
            mean, starts = np.mean(grid, axis=-2), grid.shape[-2]
            error = np.std(grid, axis=-2, ddof=1) / np.sqrt(starts) if starts > 1 else np.full(mean.shape, np.nan)
        variables["mean_exponent"] = variable(own, mean, "mean of the Lyapunov exponent over the starts", "1/s")
        variables["mean_exponent_error"] = variable(own, error, "standard error of mean_exponent", "1/s")
    numbers = transient + every * np.arange(1, checkpoints + 1)
    coordinates: Entries = {
        CYCLE: (CYCLE, numbers, {"long_name": "number of the period"}),
        EXPONENT: (EXPONENT, np.arange(1, number + 1), {"long_name": "number of the exponent"}),
    }
    return cases.dataset(variables, coordinates)


@kept_jit(filtered=True)
def _stretch(
    cycle: Cycle, starts: Array, before: IntArray, aligned: IntArray, every: IntArray, *, checkpoints: int, number: int
) -> Stretched:
    cases, size = starts.shape
    none = jnp.zeros(cases, jnp.int32)
    unit = jnp.broadcast_to(jnp.eye(size, number, dtype=starts.dtype), (cases, size, number))
    carry = _Carry(starts, unit, jnp.zeros((cases, number), starts.dtype), none, none)

    def over_periods(carry: _Carry, number: IntArray, *, stretched: bool) -> _Carry:
        one = eqx.filter_vmap(partial(_over_period, stretched=stretched))
        return lax.fori_loop(0, number, lambda _, carry: one(cycle, carry), carry)

    carry = over_periods(carry, before, stretched=False)
    carry = over_periods(carry, aligned, stretched=True)
    carry = carry._replace(sums=jnp.zeros_like(carry.sums))

    def until_checkpoint(carry: _Carry, _: None) -> tuple[_Carry, tuple[Array, Array]]:
        carry = over_periods(carry, every, stretched=True)
        return carry, (carry.sums, carry.y)

    carry, (sums, states) = lax.scan(until_checkpoint, carry, length=checkpoints)
    periods = every * jnp.arange(1, checkpoints + 1)
    means = jnp.moveaxis(sums / periods[:, None, None], 0, 1) / jnp.asarray(cycle.duration)[:, None, None]
    return Stretched(means, jnp.moveaxis(states, 0, 1), carry.status, carry.near_grazing_count)


def _over_period(cycle: Cycle, carry: _Carry, *, stretched: bool) -> _Carry:
    """One case over one period; `stretched`: its directions too, else these stay as they are."""

    def end(y: FloatArray):
        after = cycle.after(y)
        sticks = jnp.any(after.totals.stick_time > 0)
        return jnp.stack(after.final_state), (sticks, after.status, after.near_grazing_count)

    def along(direction: FloatArray):
        return jax.jvp(end, (carry.y,), (direction,), has_aux=True)

    directions, sums, is_finished = carry.directions, carry.sums, carry.status == int(Status.FINISHED)
    if stretched:
        y, moved, (sticks, status, close) = jax.vmap(along, in_axes=1, out_axes=(None, 1, None))(directions)
        directions, logarithms = stretches(moved, sticks)
        sums = sums + logarithms
    else:
        y, (_, status, close) = end(carry.y)
    y, status = jnp.where(is_finished, y, jnp.nan), jnp.where(is_finished, status, carry.status)
    bad = jnp.where(status == int(Status.FINISHED), 0, jnp.nan)
    return _Carry(y, directions, sums + bad, status, carry.near_grazing_count + close.astype(jnp.int32))


def stretches(moved: FloatArray, sticks: BoolScalar) -> tuple[FloatArray, FloatArray]:
    """Orthonormal directions from those that `moved` (coordinates, number), and the logarithm of the stretch of each.

    After a period with `sticks`, directions of which only round-off is left are those that a stick took away.
    """
    directions, factors = orthogonal_factors(moved)
    lengths, whole = jnp.diagonal(factors), jnp.sqrt(jnp.sum(factors * factors, axis=0))
    gone = sticks & (lengths <= _ROUND_OFF * jnp.finfo(moved.dtype).eps * whole)
    return directions, jnp.where(gone, -jnp.inf, jnp.log(lengths))
