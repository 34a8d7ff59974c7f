"""Whether disturbances grow: the Lyapunov exponents of motions, and equilibria of steady sliding over parameters."""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Complex

from .._compiler.programs import kept_jit
from .._dynamics.common.method import EXACT, Arguments, Exact, entries_of
from .._dynamics.common.path import SegmentLaws
from .._dynamics.switched.engine import SwitchedEngine
from .._excitation.excitation import BaseMotion, excitation_of, motion_of
from .._foundation import checks
from .._foundation.extras import Dataset, Entries, variable
from .._foundation.fields import WithMethods, in_one_line
from .._foundation.types import BoolScalar, FloatArray, InitialState, IntArray, Scalar, Status
from .._numerics.derivatives import as_arrays
from .._numerics.matrices import orthogonal_factors
from .._systems.system import System
from .._uncertainty.numbers import with_numbers
from ._cases import (
    CYCLE,
    START,
    Cases,
    Cycle,
    Over,
    cases_of,
    check_repeats,
    checked_numbers,
    common_period,
    repetitions,
)
from ._following import RECURS, UNSETTLED, Folder, in_blocks, kept_in, recurrence, warn_of_unfinished

# Lyapunov exponents from the exact derivatives of the motion over each period, through its events.


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


# Equilibria of steady sliding, and where over parameters they lose their stability.


_NEWTON, _HALVES = 12, 48  # steps to the equilibrium; halves of an interval of a parameter
_UNCERTAIN = 1e-6  # of the fastest eigenvalue: a growth rate that is round-off, where two eigenvalues meet
_ANY = 1.0  # s: nothing that drives an equilibrium changes with time


class Equilibrium(WithMethods):
    """A state of steady sliding, which stays as it is, and how small disturbances of it grow.

    Attributes:
        state: (coordinates,).
        jacobian: Of the rates by the numbers of the motion, without what friction remembers, (numbers, numbers).
        exists: Whether the state is at rest, and all contacts slide there in the directions in which they slide at `y0`
            with positive normal forces.
        system: The argument of `equilibrium`.
    """

    state: Array
    jacobian: Array
    exists: Bool[Array, ""]
    system: System

    @property
    def eigenvalues(self) -> Complex[Array, "*batch numbers"]:
        """Of small disturbances, 1/s, complex, the fastest growing first."""
        found = jnp.linalg.eigvals(self.jacobian)
        return jnp.take_along_axis(found, jnp.argsort(-jnp.real(found), axis=-1), axis=-1)

    @property
    def growth_rate(self) -> Array:
        """Of the fastest growing disturbance, 1/s; negative where all decay."""
        return jnp.real(self.eigenvalues[..., 0])

    @property
    def angular_frequency(self) -> Array:
        """Of the fastest growing disturbance, rad/s; 0 where it does not swing."""
        return jnp.abs(jnp.imag(self.eigenvalues[..., 0]))

    @property
    def is_stable(self) -> Bool[Array, "*batch"]:
        """Whether it exists, and no disturbance grows, but for round-off."""
        return self.exists & (self.growth_rate <= _UNCERTAIN * jnp.max(jnp.abs(self.eigenvalues), axis=-1))

    def __repr__(self) -> str:
        name = f"Equilibrium of a {type(self.system).__name__}"
        if self.state.ndim > 1 or checks.holds_traced(self):
            return f"{name}, {self.state.shape[:-1]} states"
        if not self.exists:
            return f"{name}, DOES NOT EXIST: near y0 no state is at rest in which every contact slides"
        how = "stable" if self.is_stable else "unstable"
        swings = f"growth rate {float(self.growth_rate):.4g} 1/s at {float(self.angular_frequency):.4g} rad/s"
        return f"{name}: {in_one_line(np.asarray(self.state))}, {how}, {swings}"


def equilibrium(system: System, base: BaseMotion, *, y0: InitialState | None = None) -> Equilibrium:
    """The state of steady sliding near `y0`, and the eigenvalues of the motion about it.

    Newton's method on the rates of the slips in which the contacts are at `y0`. What turns as a whole is at rest only
    seen from a part that turns evenly, such as the table of a drill string (docs/howto/drilling.md). A pure function:
    under ``jit``, ``vmap`` and ``grad`` (the derivatives are those of the implicit function).

    Args:
        system: A `MassSpring`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion of constant velocity, such as `Constant`.
        y0: A state near the equilibrium, zeros by default; every contact must slide in it.

    Raises:
        ValueError: For arguments that do not fit, and for a drive that changes with time.

    >>> pad = ss.Contact([1.0, 0.0], 1.0, ss.Coulomb(0.6), normal_stiffness=[0.0, -2.0])
    >>> brake = ss.LinearStructure(
    ...     [1.0, 1.0], [[2.0, -0.8], [-0.8, 2.4]], contacts=[pad]
    ... )
    >>> found = ss.nonlinear.equilibrium(brake, ss.Constant(1.0))
    >>> print(found.is_stable, found.growth_rate.round(4), found.angular_frequency.round(4))
    False 0.1771 1.4938
    """
    _check_steady(system, base)
    dtype = jnp.result_type(float)
    start = jnp.stack([jnp.asarray(value, dtype) for value in entries_of(system, y0)])
    return _found(Cycle(system, motion_of(base), _ANY, EXACT), start)


def _check_steady(system: System, base: BaseMotion) -> None:
    check_repeats(system, base, None, EXACT)
    period = common_period([one for one in repetitions(system, motion_of(base)) if one[1] is not None])
    if period is not None:
        raise ValueError(
            "Argument base must be a motion of constant velocity, without other drives, for an equilibrium, but one "
            f"that changes with a period of {float(np.ravel(period)[0]):.6g} s was given; see periodic_orbit."
        )


@kept_jit(filtered=True)
def _found(cycle: Cycle, start: FloatArray) -> Equilibrium:
    system, excitation, zero = cycle.system, excitation_of(cycle.base), jnp.zeros((), start.dtype)
    step = Arguments(system, cycle.base, cycle.method, _ANY).checked_step()[1]
    engine = SwitchedEngine(system, excitation, _ANY, tuple(start), step, 0, None)
    lane = engine.lane(excitation.signal, np.zeros(2, np.uint32), start.dtype)
    model = system.switched_model(excitation.signal, None)
    forcing = model.forcing(zero, SegmentLaws.of(system, excitation).segments(lane.segment_states))
    sign = lax.stop_gradient(model.slip_sign(forcing, model.start(tuple(start), start.dtype)))
    moving = len(start) - len(system.memory.start)

    def state_of(motion: FloatArray) -> Any:
        return model.entered(forcing, model.start((*motion, *start[moving:]), start.dtype), sign, sign)

    def rates(motion: FloatArray) -> FloatArray:
        return jnp.stack(model.numbers(model.rates(forcing, zero, state_of(motion), sign))[:moving])

    def nearer(_: IntArray, motion: FloatArray) -> FloatArray:
        # Each step is exact to twice the order of derivatives of the one before, so that all of low order are.
        return motion - jnp.linalg.solve(jax.jacfwd(rates)(motion), rates(motion))

    motion = lax.fori_loop(0, _NEWTON, nearer, start[:moving])
    jacobian, y = jax.jacfwd(rates)(motion), state_of(motion)
    left = jnp.max(jnp.abs(rates(motion))) <= _UNCERTAIN * jnp.max(jnp.abs(jacobian)) * (1 + jnp.max(jnp.abs(motion)))
    slides = jnp.all(model.slip_sign(forcing, y) == sign) & jnp.all(sign != 0)
    return Equilibrium(jnp.stack(model.numbers(y)), jacobian, left & slides, system)


def stability_map(system: System, base: BaseMotion, over: Over, *, y0: InitialState | None = None) -> Dataset:
    """The equilibrium of steady sliding and its stability over the values of parameters, and where it loses it.

    Args:
        system: A `MassSpring`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion of constant velocity, such as `Constant`.
        over: A dict from names of parameters to values, ``{"mu": np.linspace(0, 1, 51)}``.
        y0: A state near the equilibria, zeros by default; every contact must slide in it.

    Returns:
        ``growth_rate`` (1/s) and ``angular_frequency`` (rad/s) of the fastest growing disturbance, ``is_stable``,
        ``exists``, and the numbers of the state, over the parameters. Along the first parameter, between values at
        which it exists and of which one is stable and the next is not, ``critical`` is where that changes, to
        round-off, with the dimension "change" (NaN beyond the last), and ``critical_frequency`` the angular frequency
        there: of flutter or a Hopf point, or 0 where it is lost without swinging.

    Raises:
        ValueError: For arguments that do not fit, and for a drive that changes with time.
        ImportError: Without the extra ``study``.
    """
    _check_steady(system, base)
    cases = cases_of(system, base, y0, over, _ANY, EXACT)
    found = eqx.filter_vmap(_found)(cases.cycle, jnp.asarray(cases.starts, cases.dtype))
    first, *others = cases.points.dimensions
    stable = np.asarray(found.is_stable).reshape(cases.shape)
    exists = np.asarray(found.exists).reshape(cases.shape)
    changes = np.argwhere((stable[:-1] != stable[1:]) & exists[:-1] & exists[1:])
    where, frequencies = _critical(cases, changes, stable)
    rows = [tuple(one[1:]) for one in changes.tolist()]
    numbers = [rows[:place].count(row) for place, row in enumerate(rows)]
    shape = (*cases.shape[1:], 1 + max(numbers, default=0))
    values = {name: np.full(shape, np.nan) for name in ("critical", "critical_frequency")}
    for place, (row, number) in enumerate(zip(rows, numbers, strict=True)):
        values["critical"][*row, number], values["critical_frequency"][*row, number] = where[place], frequencies[place]
    own = (*(one.name for one in others), "change")
    variables: Entries = {
        "growth_rate": cases.variable(found.growth_rate, "growth rate of disturbances", "1/s"),
        "angular_frequency": cases.variable(found.angular_frequency, "angular frequency of disturbances", "rad/s"),
        "is_stable": cases.variable(stable.ravel(), "whether it exists and no disturbance grows"),
        "exists": cases.variable(found.exists, "whether there is such an equilibrium"),
        "critical": variable(own, values["critical"], f"{first.name} at which stability changes"),
        "critical_frequency": variable(own, values["critical_frequency"], "angular frequency there", "rad/s"),
    }
    for number, coordinate in enumerate(cases.system.coordinates):
        label = f"{coordinate.name} at equilibrium"
        variables[coordinate.variable] = cases.variable(found.state[:, number], label, coordinate.unit)
    return cases.dataset(variables, {})


def _critical(cases: Cases, changes: np.ndarray, stable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The values of the first parameter at which stability changes, by halves, and the angular frequencies there."""
    points = [int(np.ravel_multi_index(tuple(one), cases.shape)) for one in changes]
    if not points:
        return np.zeros(0), np.zeros(0)
    beside = int(np.prod(cases.shape[1:]))
    each = [np.array([cases.points.values(point) for point in at]) for at in (points, [p + beside for p in points])]
    begins_stable = stable[tuple(changes.T)]
    low, high, others = each[0][:, 0], each[1][:, 0], each[0][:, 1:]
    as_given, start = as_arrays(cases.setter.setting, cases.dtype), jnp.asarray(cases.starts[points], cases.dtype)
    paths = tuple(cases.setter.columns(each[0])[0])

    @eqx.filter_vmap
    def found_at(numbers: Array, start: Array) -> Equilibrium:
        changed = with_numbers(as_given, paths, numbers)
        return _found(Cycle(changed.system, motion_of(changed.law), _ANY, EXACT), start)

    def numbers_at(values: np.ndarray) -> Array:
        columns, _ = cases.setter.columns(np.column_stack([values, others]))
        return jnp.asarray(np.stack(list(columns.values()), axis=1), cases.dtype)

    for _ in range(_HALVES):
        middle = (low + high) / 2
        same = np.asarray(found_at(numbers_at(middle), start).is_stable) == begins_stable
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    # What counts as stable grows by round-off, at most: by Newton's method to where the growth rate is zero. (Near
    # flutter it is a root, of which a second step, no shorter than the first, would be round-off.)
    unstable, width = np.where(begins_stable, high, low), np.abs(each[1][:, 0] - each[0][:, 0])
    frequencies, apart = np.asarray(found_at(numbers_at(unstable), start).angular_frequency), _UNCERTAIN * width
    longest = width
    for _ in range(2):
        numbers, ahead, behind = (numbers_at(unstable + k * apart) for k in (0, 1, -1))
        slope = (ahead - behind) / (2 * apart)[:, None]
        rates, slopes = map(np.asarray, jax.jvp(lambda at: found_at(at, start).growth_rate, (numbers,), (slope,)))
        more = np.divide(rates, slopes, out=np.zeros(len(low)), where=np.abs(slopes) > 0)
        unstable = unstable - np.where(np.abs(more) < longest, more, 0)
        longest = np.abs(more) / 10
    return unstable, frequencies
