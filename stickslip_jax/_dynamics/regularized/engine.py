"""The engine of regularised dynamics: its settings, adaptive steps by diffrax, and one trajectory with its states."""

import dataclasses
import math
from functools import cache, partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._compiler.programs import kept_jit, plain_numpy
from ..._excitation.excitation import Excitation, excitation_of
from ..._excitation.motion import Signal
from ..._excitation.segments import SegmentTable
from ..._foundation import checks
from ..._foundation import lazy_diffrax as diffrax
from ..._foundation.fields import with_fields
from ..._foundation.types import BoolArray, FloatArray, IntArray, Number, Scalar, Status
from ..._numerics.derivatives import NotKnown, largest, smallest, with_slope, without_derivatives
from ..._numerics.matrices import any_of
from ..._systems.switched_model import Along, Form, Segments, State, chosen_state, of_form
from ..._systems.system import System
from ..common.method import Regularized, Switch, accurate_step, longest_step, max_steps_advice, step_for, time_scales_of
from ..common.path import (
    MotionPath,
    Parts,
    Run,
    SegmentLaws,
    is_short,
    largest_in_steps,
    padded_length,
    stopping_scan,
)
from ..sticks import ALL, StickRecord
from .field import AnyField, InnerField, field_of
from .lanes import AdaptiveEngine, FixedEngine, PathStep, along_step, nothing_seen, tolerances
from .sticks import Cubic, JoiningDetector, detect_joined, hermite, start_joining

# Regularised motion of one trajectory in adaptive steps, by diffrax.


_CLOSING = 2  # steps of no length after the last, at most: see `detect_joined`


class Tables(Parts[SegmentTable]):
    """All segments of one realisation, in the order of `SegmentLaws`."""

    @classmethod
    def of(cls, system: System, excitation: Excitation, key_data: Any, sizes: tuple[int, ...], dtype) -> "Tables":
        """The segments that `key_data` choose; `sizes`: how many of each part (`table_sizes`)."""
        segment_laws, own = SegmentLaws.of(system, excitation), excitation.segment_key_data(key_data)
        tables = (SegmentTable.of(law, own, size, dtype) for law, size in zip(segment_laws.all, sizes, strict=True))
        return cls(*segment_laws.parted(tables))

    def at(self, t: FloatArray) -> Segments:
        """The current segments at time `t`."""
        return Segments(*self.parted(table.at(t) for table in self.all))

    @property
    def end(self) -> FloatArray | float:
        """Earliest end of a part, s."""
        return reduce(jnp.minimum, (table.end for table in self.all), jnp.inf)

    @property
    def are_invalid(self) -> BoolArray:
        """Whether the part that ends first ends with a segment that cannot be."""
        found = jnp.zeros((), bool)
        for table in self.all:
            found = found | (table.is_invalid & (table.end <= self.end))
        return found

    @property
    def times(self) -> Array | None:
        """The instants at which one segment follows another, s; None without any."""
        times = [table.segments.begin[1:] for table in self.all]
        return jnp.concatenate(times) if sum(map(len, times)) else None


def table_sizes(system: System, excitation: Excitation, t1: Any) -> tuple[int, ...]:
    """Number of segments of each part that suffices for nearly every realisation until `t1` (not traced)."""
    return tuple(law.segments(t1) for law in SegmentLaws.of(system, excitation).all)


def base_jumps(system: System, excitation: Excitation, sizes: tuple[int, ...]) -> bool:
    """Whether the velocity of the base may jump, in so many segments of each part (`table_sizes`)."""
    return any(
        law.jumps and size > 1 for law, size in zip(SegmentLaws.of(system, excitation).base, sizes, strict=False)
    )


class Solution(NamedTuple):
    """The accepted steps of a solution: the state at the beginning of each, and at the end of the last.

    `t`: (steps + 1,), infinity in spare slots. `y`: (steps + 1, states). `steps`: number of accepted steps.
    """

    t: Array
    y: Array
    steps: IntArray
    status: IntArray

    @property
    def seen_steps(self) -> IntArray:
        """How many steps `_detect_in_step` has to see: one of no length follows the last."""
        return jnp.maximum(self.steps, 1) + 1


@cache
def _every_stage_control() -> Any:
    """The class of the control of steps, made when diffrax is first needed."""
    clipped: Any = diffrax.ClipStepSizeController

    class EveryStageControl(clipped):
        """A control after whose steps the solver computes the first stage of the next one anew.

        By itself it takes that stage from the step before, unless there was a jump in between, in any trajectory of the
        batch: the two differ in the last digits of implicit solvers, and each sample would depend on its neighbours.
        """

        def adapt_step_size(self, *args: Any) -> Any:
            keeps, t0, t1, _, state, result = super().adapt_step_size(*args)
            return keeps, t0, t1, True, state, result

    return EveryStageControl


def solve_adaptive(
    field: AnyField,
    tables: Tables,
    t1: FloatArray,
    y0: tuple[Number, ...],
    method: Regularized,
    longest_step: Scalar,
    max_steps: int,
) -> Solution:
    """Solve one trajectory up to `t1` or the end of the base motion, in at most `max_steps` steps, accepted or not.

    `method`: with every option filled in. `longest_step`: s.
    """
    dtype = t1.dtype
    zero = jnp.zeros((), dtype)

    model = field.model
    start = field.model.start(tuple(jnp.asarray(v, dtype) for v in y0), dtype)
    start = jnp.stack(field.solved(model.forcing(zero, tables.at(zero)), start))
    _, atol = tolerances(field, method, len(y0), dtype)

    def rates(t, y, _):
        return jnp.stack(field.solved_rates(model.forcing(t, tables.at(t)), zero, tuple(y)))

    jumps = tables.times
    control = diffrax.PIDController(rtol=method.rtol, atol=atol, dtmax=jnp.asarray(longest_step, dtype))
    # The first stage of a very stiff step, computed anew from the state, would be its round-off enlarged: without jumps
    # no trajectory of a batch needs it.
    in_logarithms = isinstance(field, InnerField) and field.in_logarithms
    if not in_logarithms or jumps is not None:
        control = _every_stage_control()(control, jump_ts=jumps)
    end = jnp.minimum(t1, tables.end)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates), method.solver, zero, end, None, start,
        saveat=diffrax.SaveAt(t0=True, steps=True), stepsize_controller=control, max_steps=max_steps,
        adjoint=method.adjoint, throw=False,
    )  # fmt: skip
    t, y = jnp.asarray(solution.ts), jnp.asarray(solution.ys)
    if in_logarithms:

        def plain(t: FloatArray, y: Array) -> Array:
            here = jnp.where(jnp.isfinite(t), t, 0)
            return jnp.stack(model.numbers(field.plain(model.forcing(here, tables.at(here)), zero, tuple(y))))

        y = jax.vmap(plain)(t, y)
    steps = jnp.sum(jnp.isfinite(t)).astype(jnp.int32) - 1
    full = solution.result == diffrax.RESULTS.max_steps_reached
    code = jnp.where(solution.result == diffrax.RESULTS.successful, Status.FINISHED, Status.SOLVER_FAILED)
    code = jnp.where(full, Status.OUT_OF_STEPS, code)
    ended = jnp.where(tables.are_invalid, Status.BASE_INVALID, Status.BASE_TOO_SHORT)
    code = jnp.where((code == Status.FINISHED) & (end < t1), ended, code)
    finite = jnp.all(jnp.isfinite(y[steps])) & jnp.isfinite(t1)
    return Solution(t, y, steps, jnp.where(finite, code, Status.NOT_FINITE).astype(jnp.int8))


def follow_adaptive(
    field: AnyField,
    tables: Tables,
    t1: FloatArray,
    y0: tuple[Number, ...],
    method: Regularized,
    longest_step: Scalar,
    max_steps: int,
) -> tuple[Solution, JoiningDetector, tuple[StickRecord, PathStep]]:
    """Solve one trajectory (`solve_adaptive`) and find its sticks; also what is kept of each step."""
    solution = solve_adaptive(field, tables, t1, y0, method, longest_step, max_steps)
    model, zero = field.model, jnp.zeros((), t1.dtype)
    start = model.start(tuple(solution.y[0]), t1.dtype)
    seen, tracks = field.at_contact(model.forcing(zero, tables.at(zero)), zero, start), model.stick_position(start)

    def one_step(detector: JoiningDetector, index: IntArray) -> tuple[JoiningDetector, tuple[StickRecord, PathStep]]:
        detector, record, passage = _detect_in_step(field, tables, t1, solution, detector, index)
        return detector, (record, passage)

    detector, found = stopping_scan(
        one_step,
        start_joining(field.criterion, seen, tracks, ALL),
        max_steps + _CLOSING,
        lambda _, index: index >= solution.seen_steps,
        lambda _: nothing_seen(tuple(solution.y[0]), model.contacts, ALL),
    )
    return solution, detector, found


def _detect_in_step(
    field: AnyField,
    tables: Tables,
    t1: FloatArray,
    solution: Solution,
    detector: JoiningDetector,
    index: IntArray,
) -> tuple[JoiningDetector, StickRecord, PathStep]:
    """Run the stick detector over step number `index` of a solution; beyond its `seen_steps` nothing changes."""
    live = index < solution.seen_steps
    index = jnp.minimum(index, solution.steps)
    model, dtype = field.model, solution.y.dtype
    t, y = solution.t[index], model.start(tuple(solution.y[index]), dtype)
    # A solution without steps is read as steps of no length.
    following = jnp.minimum(index + 1, solution.steps)
    now, reached = solution.t[following], model.start(tuple(solution.y[following]), dtype)
    h = now - t
    segments, next_segments = tables.at(t + h / 2), tables.at(now)
    seen, rates, end_rates = field.seen(model.forcing(t, segments), t, h, y, reached)
    jumped = jnp.zeros((), bool)
    for table, old, new in zip(tables.base, segments.base, next_segments.base, strict=True):
        jumped = jumped | ((old.begin != new.begin) & table.jumps)
    after = field.at_contact(model.forcing(now, next_segments), now, reached)
    jumped, last = jumped & (now < t1), now >= t1
    moved, record = detect_joined(field.criterion, detector, seen, jumped=jumped, after=after, last=last)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, detector)
    hidden = live & (tables.end > 0) & seen.hides_sticks  # what ends where it begins has no motion
    totals = moved.found.totals
    totals = totals._replace(stick_time=jnp.where(hidden, jnp.nan, totals.stick_time))
    moved = moved._replace(found=moved.found._replace(totals=totals))
    record = record._replace(ending=jnp.where(live, record.ending, jnp.int8(-1)))
    return moved, record, PathStep(t, *map(model.numbers, (y, rates, end_rates)))


def status_of(solution: Solution, detector: JoiningDetector) -> IntArray:
    """How a solution ended whose steps the `detector` has seen."""
    return jnp.where(any_of(jnp.isnan(detector.found.totals.stick_time)), jnp.int8(Status.NOT_FINITE), solution.status)


# Defaults of a regularised simulation: thresholds and tolerances from the scales of the system.


ADAPTIVE_STEPS, MORE = 2**14, 8
"""Adaptive steps of a trajectory, and how many times as many where they are too few; twice."""
_TRIES, _FEW = 2, 256  # of shortened steps
_SLOW = 1e-3  # of the velocity that friction changes: the threshold of laws with an inner state


def resolved(system: System, excitation: Excitation, method: Regularized, dtype) -> Regularized:
    """`method` with every option filled in, its numbers as arrays of `dtype`.

    Raises ValueError where an option is needed because the system's scales are not known.
    """
    if system.memory.ages:
        raise ValueError(
            "Argument method must be Exact(...) for friction that grows while a stick lasts, but "
            f"{checks.show(method)} was given: smoothed friction has no stick whose age is known."
        )
    if system.traits.jumps_at_places:
        raise checks.refused("method", "be Exact(...) for friction that jumps from place to place", method)
    inner = bool(system.memory.laws)
    if inner and (method.width is not None or method.step is not None):
        laws = "for friction laws with an inner state, which are smooth by themselves and stiff"
        raise checks.refused("method", f"be Regularized() without a width and a step {laws}", method)
    if not inner and method.width is None:
        hint = "only friction laws with an inner state, such as LuGre, need none"
        raise checks.refused("width", "be positive (in m/s)", None, hint)
    _check_contacts(system, method)
    xp = plain_numpy()
    width = None if method.width is None else jnp.asarray(method.width, dtype)
    speed, deceleration, state_sizes = system.sizes(excitation)
    # Static friction above kinetic friction holds a mass up to one width.
    slow = width if system.static_exceeds_kinetic and not inner else speed
    for name, scale in (("threshold", slow), ("minimum_duration", deceleration)):
        if getattr(method, name) is None and scale is None:
            own = "; or give it the properties speed_scale and shortest_time" if hasattr(system, "speed_scale") else ""
            raise ValueError(
                f"Argument method must give the {name}, Regularized(..., {name}=...), because the velocities of a "
                f"{type(system).__name__} are not known{own}."
            )
    threshold = method.threshold
    if threshold is None:
        if width is None:
            threshold = _SLOW * xp.asarray(speed)
        else:
            held = system.static_exceeds_kinetic
            threshold = width if held else Switch(width, method.shape).creep(jnp.asarray(speed))
    duration = method.minimum_duration
    if duration is None:
        assert deceleration is not None
        # Without friction nothing sticks, however slowly the mass passes through.
        slows = xp.asarray(deceleration) > 0
        never = min(checks.LARGEST, float(jnp.finfo(dtype).max))
        duration = xp.where(slows, 10 * threshold / xp.where(slows, deceleration, 1), never)
        duration = duration if method.step is None else xp.maximum(duration, 2 * method.step)
    adaptive = method.step is None
    solver, adjoint = method.solver, method.adjoint
    if solver is not None or adjoint is not None:  # else the steps are those of `AdaptiveEngine`
        solver, adjoint = solver or diffrax.Kvaerno3(), adjoint or diffrax.RecursiveCheckpointAdjoint()
    scales = xp.stack([xp.asarray(size, dtype) for size in state_sizes])
    scales = xp.where(scales > 0, scales, 1)
    atol = method.rtol * scales if method.atol is None else method.atol
    if np.shape(atol) not in ((), scales.shape):
        raise ValueError(
            f"Argument atol must be one number, or one for each of the {len(scales)} states, but an array of shape "
            f"{np.shape(atol)} was given."
        )
    return dataclasses.replace(
        method,
        width=width,
        step=None if adaptive else jnp.asarray(method.step, dtype),
        solver=solver,
        rtol=jnp.asarray(method.rtol, dtype),
        atol=jnp.asarray(atol, dtype),
        threshold=jnp.asarray(threshold, dtype),
        minimum_duration=jnp.asarray(duration, dtype),
        adjoint=adjoint,
    )


def _check_contacts(system: System, method: Regularized) -> None:
    """Check what several contacts cannot have. Raises ValueError for it."""
    if system.traits.begins_anew:
        raise checks.refused("method", "be Exact(...) for a system with at_stick or at_slip", method)
    if system.memory.slips:
        raise checks.refused("method", "be Exact(...) for friction that weakens with the slip distance", method)
    if system.memory.elongations:
        raise checks.refused("method", "be Exact(...) for contacts with a series_stiffness", method)
    contacts = system.tracks.contacts
    for name in ("threshold", "minimum_duration"):
        shape = np.shape(getattr(method, name)) if getattr(method, name) is not None else ()
        if shape not in ((),) + (() if contacts is None else ((contacts,),)):
            each = "" if contacts is None else f", or one for each of the {contacts} contacts"
            raise ValueError(f"Argument {name} must be one number{each}, but an array of shape {shape} was given.")


def fixed_steps(system: System, excitation: Excitation, method: Regularized, t1: Scalar) -> int:
    """The largest number of fixed steps that a trajectory takes: ``t1 / step``, and one for the end of each segment,
    twice that where steps must be shorter.

    Where JAX traces a time scale, the given step counts: a trajectory whose steps must be shorter may run out of them.
    Raises NotKnown where `t1` or the given step is traced, ValueError for a step that is too long for the shortest
    time scale.
    """
    horizon, step = largest(t1), step_for(system, excitation, method)
    try:
        shortest = smallest(step)
    except NotKnown:
        shortest = smallest(method.step)
    found = time_scales_of(system, excitation)
    suits = found.are_all and all(of.time is not None for of in found.scales.values())
    if not suits:
        shortest = accurate_step(system, excitation, shortest)
    steps = math.ceil(horizon / shortest) + sum(table_sizes(system, excitation, horizon)) + 1
    return steps if suits and not system.static_exceeds_kinetic else _TRIES * steps + _FEW


def numbers_as_arrays(tree: Any, dtype) -> Any:
    """Plain numbers in `tree`, whole ones too, as arrays, so that other numbers need no recompilation."""

    def convert(leaf):
        return jnp.asarray(leaf, dtype) if isinstance(leaf, (int, float)) and not isinstance(leaf, bool) else leaf

    return jax.tree.map(convert, tree)


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
    middles: State | None

    @classmethod
    def of(
        cls, smooth: Signal | None, tables: Tables, passages: PathStep, steps: IntArray, last: FloatArray, final: State
    ):
        """The path of the first `steps` passages (the others are empty), which ends at time `last` in `final`."""
        live = jnp.arange(len(passages.t)) < steps

        def closed(values, end):
            return jnp.append(jnp.where(live, values, end), end)

        y = tuple(closed(values, end) for values, end in zip(passages.y, final, strict=True))
        return cls(smooth, tables, closed(passages.t, last), y, *passages[2:])

    @property
    def times(self) -> Array:
        return self.t[:-1]

    def state(self, time: FloatArray) -> State:
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0, len(self.t) - 2)
        return self._in_step(index, time - self.t[index])

    def _in_step(self, index: Any, tau: FloatArray) -> State:
        """The state `tau` (s) after the beginning of a step."""
        h = self.t[index + 1] - self.t[index]
        return tuple(hermite(tau, h, self._cubic(number, index, index + 1, h)) for number in range(len(self.y)))

    def _cubic(self, number: int, begin: Any, end: Any, h: FloatArray) -> Cubic:
        """One number of the state in the steps of length `h` from places `begin` to places `end`."""
        y = self.y[number]
        cubic = Cubic(y[begin], self.rates[number][begin], y[end], self.end_rates[number][begin])
        return cubic if self.middles is None else cubic.through(h, self.middles[number][begin])

    def largest(self, form: Form, sign: Scalar, last: FloatArray, final: State) -> FloatArray:
        lengths, begun, ends = jnp.diff(self.t), tuple(of[:-1] for of in self.y), tuple(of[1:] for of in self.y)
        steps = PathStep(self.t[:-1], begun, self.rates, self.end_rates, self.middles), ends, lengths
        inside = partial(along_step, (form,))
        return largest_in_steps(
            inside, steps, of_form(form, begun), lengths, sign, of_form(form, final), are_short=True
        )

    def segments(self, time: FloatArray) -> Segments:
        return self.tables.at(time)


_SWINGS = 1e-3, 0.03  # of the slip's speed, from a curve by three values, and by two


class LogarithmicPath(CubicPath):
    """The same where steps followed the logarithm of the relative velocity (`InnerStates.with_logarithm`).

    Where the mass nearly rests, rates are round-off, which a long step enlarges: a cubic of the velocity would swing by
    decades more than it is. There it is found by values of the logarithm alone.
    """

    field: InnerField

    def _in_step(self, index: Any, tau: FloatArray) -> State:
        model, t, end = self.field.model, self.t[index], self.t[index + 1]
        speed, segments = model.speed or 0, self.tables.at((t + end) / 2)
        forcing, h = model.forcing(t, segments), end - t

        def logarithm(at: FloatArray, numbers: State, place: Any) -> FloatArray:
            y = model.start(tuple(of[place] for of in numbers), h.dtype)
            return self.field.solved(model.forcing(at, segments), y)[speed]

        begins, ends = logarithm(t, self.y, index), logarithm(end, self.y, index + 1)
        bulge, most = jnp.zeros_like(h), _SWINGS[1]
        if self.middles is not None:
            bulge, most = logarithm((t + end) / 2, self.middles, index) - (begins + ends) / 2, _SWINGS[0]

        def both(tau: FloatArray) -> tuple[State, State]:
            cubic, share = CubicPath._in_step(self, index, tau), tau / jnp.where(h > 0, h, 1)
            number = begins + share * (ends - begins) + 4 * share * (1 - share) * bulge
            numbers = tuple(number if i == speed else of for i, of in enumerate(cubic))
            return cubic, model.numbers(self.field.plain(forcing, tau, numbers))

        def swings(tau: FloatArray) -> BoolArray:
            states = (model.start(numbers, h.dtype) for numbers in both(tau))
            cubic, by_values = (model.relative_velocity(forcing, tau, y) for y in states)
            return jnp.abs(cubic - by_values) > most * jnp.abs(by_values)

        cubic, by_values = both(tau)
        return chosen_state(swings(h / 4) | swings(3 * h / 4), by_values, cubic)

    def largest(self, form: Form, sign: Scalar, last: FloatArray, final: State) -> FloatArray:
        def inside(index: IntArray, is_fixed: bool) -> Along:
            path = without_derivatives(self) if is_fixed else self
            return partial(with_slope, jax.vmap(lambda tau: of_form(form, path._in_step(index, tau))))

        lengths, starts = jnp.diff(self.t), of_form(form, tuple(of[:-1] for of in self.y))
        ends = sign, of_form(form, final)
        return largest_in_steps(inside, jnp.arange(len(lengths)), starts, lengths, *ends, are_short=False)


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


@kept_jit(filtered=True)
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
    field = field_of(system, excitation.signal, method, base_jumps=base_jumps(system, excitation, sizes))
    if method.solver is not None:
        solution, detector, kept = follow_adaptive(field, tables, t1, y0, method, longest, steps)
        end = solution.steps, solution.t[solution.steps], tuple(solution.y[solution.steps])
        status = status_of(solution, detector)
    else:
        # Tolerances are for adaptive steps, and the shortest duration only decides: neither has a derivative.
        shortest = lax.stop_gradient(method.minimum_duration)
        plain = dataclasses.replace(method, step=None, minimum_duration=shortest)
        if method.step is None:
            plain = dataclasses.replace(plain, rtol=lax.stop_gradient(plain.rtol), atol=lax.stop_gradient(plain.atol))
            given = system, excitation, t1, y0, lax.stop_gradient(longest), steps, plain
            engine = AdaptiveEngine(*given, quantities=ALL, base_jumps=base_jumps(system, excitation, sizes))
        else:
            plain = dataclasses.replace(plain, atol=None)
            engine = FixedEngine(system, excitation, t1, y0, method.step, steps, plain, quantities=ALL)
        lane, kept = engine.followed(t1.dtype, _MOST_SLOPES)
        detector, status = lane.detector, engine.status(lane)
        end = lane.steps, lane.t, engine.numbers(excitation.signal, lane)
    records, passages = kept
    path = CubicPath.of(excitation.signal, tables, passages, *end)
    if method.step is None and isinstance(field, InnerField) and field.in_logarithms:
        path = with_fields(path, LogarithmicPath, field=field)
    return Run.of(system, records, detector.found.totals, status, *end[1:], jnp.zeros((), jnp.int32), path)
