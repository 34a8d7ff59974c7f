"""Sections of motions: states once a period, bifurcation diagrams that show them, and states at events."""

from typing import Annotated, Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._dynamics.common.method import EXACT, Exact
from .._dynamics.common.path import Run
from .._dynamics.switched.engine import StepBeginnings, StepPath, state_in_step
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.extras import Dataset, Entries
from .._foundation.fields import Checked, Quantity
from .._foundation.processes import require_memory
from .._foundation.types import BoolArray, FloatArray, IntArray, Scalar, Status
from .._systems.switched_model import SwitchedModel
from .._systems.system import System
from ._cases import CYCLE, Cases, Cycle, Over, cases_of, checked_numbers
from ._following import (
    RECURS,
    UNSETTLED,
    Direction,
    Folder,
    SeenCases,
    checked_periods,
    in_blocks,
    kept_in,
    recurrence,
    settled,
    warn_of_unfinished,
    warn_of_unsettled,
)

# States once a period of the drive: stroboscopic sections, and the bifurcation diagrams that they make.


CONTACT = "contact"


def stroboscopic_section(
    system: System,
    base: BaseMotion,
    *,
    y0: Any = None,
    over: Over | None = None,
    transient: int = 200,
    kept: int = 100,
    longest_transient: int | None = None,
    period: Scalar | None = None,
    tolerance: float = RECURS,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> Dataset:
    """States once a period of what drives the system, after a transient: for many starts and parameters at once.

    Args:
        system: A `MassSpring`, a `MotorCart`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion that repeats itself, such as `Constant`, `SquareWave` or `Harmonic`.
        y0: The initial state, such as ``(position, velocity)``, zeros by default; or many of them, an array (starts,
            coordinates).
        over: A dict from names of parameters to values, ``{"mu": [0.5, 1.0]}``: every combination is followed from
            every start.
        transient: Number of periods before the first that is kept, at least; 0 for motions as they begin.
        kept: Number of periods kept.
        longest_transient: Number of periods before the first that is kept, at most; by default 16 times `transient`.
            Motions that have not settled go on, twice as long each time.
        period: s; by default that after which all motions that drive the system repeat themselves together. A multiple
            of it may be given, and must be where none is known (a record, which then begins anew after it; a system of
            your own whose rates depend on time). Where nothing changes with time, any time after which to look.
        tolerance: Relative, within which a state counts as the same for the variable ``recurrence``.
        method: `Exact`.
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        folder: Where what is done is kept, block after block; the same call goes on from there after an interrupt, or
            takes all from there, quickly. Without it nothing is kept.

    Returns:
        The numbers of the state at the end of each period kept, with dimensions of the parameters, "start" if there are
        several, and "cycle", the number of the period; likewise ``stick_time`` (s) in each period, ``stick_count``, the
        sticks that began in it, and ``longest_stick``, that ended in it or goes on (s, from its beginning), of each
        contact of a list. Of each case ``recurrence``, the number of periods after which the motion repeats itself, at
        most half of those kept (0: none is found; -1: the motion has not settled, its differences still fall or grow,
        and no stable orbit is near), ``more_periods``, for which it went on beyond `transient` until it had settled
        (add them to "cycle"), ``status`` and ``near_grazing_count``. Angles are between 0 and
        their period. A variable that is called as a parameter is has an underscore after its name. Warns
        (RuntimeWarning) of cases that were not followed to the end, and hold NaN from there on, and of those that have
        not settled. Fewer than eight periods kept are compared, but whether they settle is not seen.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=0.3)
    ... )
    >>> base = ss.Harmonic(amplitude=1.0, angular_frequency=0.4)
    >>> section = ss.nonlinear.stroboscopic_section(system, base, over={"mu": [0.1, 0.6]})
    >>> section.recurrence.values
    array([1, 1])
    """
    lasted = transient, kept, _ = checked_periods(transient, kept, longest_transient, tolerance)
    cases = cases_of(system, base, y0, over, period, method)
    what = {"function": "stroboscopic_section", "transient": transient, "kept": kept}
    with kept_in(folder, cases, what) as stored:
        return section_of(cases, *settled(cases, lasted, float(tolerance), progress, stored), transient)


def section_of(cases: Cases, seen: SeenCases, found: np.ndarray, more: np.ndarray, transient: int) -> Dataset:
    """The data set of what was seen, of the recurrences `found` and the periods `more` of each case, (cases,)."""
    each = (CYCLE,) if np.ndim(seen.stick_time) == 2 else (CYCLE, CONTACT)
    variables: Entries = {
        **cases.variables_of(np.asarray(seen.states), CYCLE, "at the end of the period"),
        "stick_time": cases.variable(seen.stick_time, "time in sticks in the period", "s", each),
        "stick_count": cases.variable(seen.stick_count, "number of sticks that begin in the period", "1", each),
        "longest_stick": cases.variable(seen.longest_stick, "longest stick of the period", "s", each),
        "recurrence": cases.variable(found, "number of periods after which the motion repeats itself"),
        "more_periods": cases.variable(more, "number of periods for which it went on until it had settled"),
        "period": cases.variable(cases.cycle.duration, "period", "s"),
        **cases.outcome(seen),
    }
    numbers = np.arange(transient + 1, transient + np.shape(seen.states)[1] + 1)
    return cases.dataset(variables, {CYCLE: (CYCLE, numbers, {"long_name": "number of the period"})})


# Bifurcation diagrams: what motions settle on, over the values of parameters.


Follow = Literal["start", "up", "down", "both"]
DIRECTION = "direction"


def bifurcation_diagram(
    system: System,
    base: BaseMotion,
    over: Over,
    *,
    follow_attractor: Follow = "start",
    y0: Any = None,
    transient: int = 200,
    kept: int = 100,
    longest_transient: int | None = None,
    period: Scalar | None = None,
    tolerance: float = RECURS,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> Dataset:
    """States once a period over the values of parameters, from the same starts or following the attractor.

    Args:
        system: A `MassSpring`, a `MotorCart`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion that repeats itself, such as `Constant`, `SquareWave` or `Harmonic`.
        over: A dict from names of parameters to values, ``{"mu": np.linspace(0.2, 1.0, 81)}``; the first is drawn along
            the abscissa.
        follow_attractor: "start": each value from `y0`. "up" or "down": each value of the first parameter, in the order
            in which they are given or backwards, from where the motion of the one before ended; "both", with a further
            dimension "direction": where two attractors are, a hysteresis shows.
        y0: The initial state, such as ``(position, velocity)``, zeros by default; or many of them, an array (starts,
            coordinates).
        transient: Number of periods before the first that is kept, at least; 0 for motions as they begin.
        kept: Number of periods kept.
        longest_transient: Number of periods before the first that is kept, at most; by default 16 times `transient`.
            Motions that have not settled go on up to it; where an attractor is followed, the next value begins from
            where a motion was before it went on.
        period: s; by default that after which all motions that drive the system repeat themselves together; needed
            where none is known.
        tolerance: Relative, within which a state counts as the same for the variable ``recurrence``.
        method: `Exact`.
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        folder: Where what is done is kept, block after block, for the same call to go on from there; without it nothing
            is kept.

    Returns:
        As `stroboscopic_section`. Warns likewise; where an attractor is followed, a motion that was not followed to the
        end is begun anew from `y0` at the next value.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.
    """
    lasted = transient, kept, _ = checked_periods(transient, kept, longest_transient, tolerance)
    checks.chosen("follow_attractor", follow_attractor, get_args(Follow))
    cases = cases_of(system, base, y0, over, period, method)
    what = {"function": "bifurcation_diagram", "transient": transient, "kept": kept}
    each: tuple[Direction, ...] = ("up", "down") if follow_attractor == "both" else (follow_attractor,)
    found: list[Dataset] = []
    with kept_in(folder, cases, what) as stored:
        for one in each:
            done = settled(cases, lasted, float(tolerance), progress, stored, one)
            found.append(section_of(cases, *done, transient))
    if len(found) == 1:
        return found[0]
    import xarray as xr  # noqa: PLC0415 - an extra, which was there to make the parts

    directions = xr.DataArray(list(each), dims=DIRECTION, name=DIRECTION, attrs={"long_name": "direction"})
    return xr.concat(found, directions, combine_attrs="override")


# States at events: where a stick or a slip begins, or a coordinate passes a value.


EVENT = "event"
ModeEvent = Literal["stick_start", "stick_end", "slip_forward", "slip_backward"]
_BEGINS = {"stick_start": 0, "slip_forward": 1, "slip_backward": -1}  # the sign from there on
_SLOTS = 16  # for passages of a coordinate in one period; more are made where there are more
_NEWTON = 24
_NEAR = 1e-4  # of a step: Newton's steps then square it
_MOST_PERIODS = 20  # for each event asked for


class Crossing(Checked):
    """A coordinate that passes a value.

    Args:
        coordinate: Its name, such as "position".
        value: In its unit; of an angle, in any turn.
        direction: 1 where it becomes larger, -1 where it becomes smaller, 0 for both.

    Raises:
        ValueError: For a value that is not finite, and for another direction.
    """

    coordinate: str = eqx.field(static=True)
    value: Annotated[Scalar, Quantity("", "in the unit of the coordinate")] = 0.0
    direction: int = eqx.field(static=True, default=1)

    def check_relations(self) -> None:
        checks.text("coordinate", self.coordinate)
        if self.direction not in (-1, 0, 1):
            raise checks.refused("direction", "be 1, -1 or 0", self.direction)


class _Found(NamedTuple):
    """Events of one case: the `number` of all, and the times and states (events, ...) of those kept."""

    number: Array
    times: Array
    states: Array
    status: Array
    near_grazing_count: Array
    most_passages: Array  # in one period, of a coordinate through the value


_Carry = tuple[FloatArray, FloatArray, _Found]
"""The state, the sign at the end of the last period (NaN before the first), and what was found."""


def event_section(
    system: System,
    base: BaseMotion,
    of: ModeEvent | Crossing,
    *,
    contact: int = 0,
    y0: Any = None,
    over: Over | None = None,
    transient: int = 200,
    kept: int = 100,
    period: Scalar | None = None,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> Dataset:
    """States at events of one kind, after a transient: for many starts and parameters at once.

    Args:
        system: A `MassSpring`, a `MotorCart`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion that repeats itself, such as `Constant`, `SquareWave` or `Harmonic`.
        of: "stick_start" or "stick_end"; "slip_forward" or "slip_backward", where a slip with positive or negative
            relative velocity begins, out of a stick or of a slip the other way; or a `Crossing` of a coordinate.
        contact: Whose sticks and slips, from 0, for a system with several.
        y0: The initial state, such as ``(position, velocity)``, zeros by default; or many of them, an array (starts,
            coordinates).
        over: A dict from names of parameters to values, ``{"mu": [0.5, 1.0]}``: every combination is followed from
            every start.
        transient: Number of events before the first that is kept.
        kept: Number of events kept.
        period: s; by default that after which all motions that drive the system repeat themselves together; needed
            where none is known; where nothing drives the system, it is not.
        method: `Exact`.
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        folder: Where what is done is kept, block after block, for the same call to go on from there; without it nothing
            is kept.

    Returns:
        ``time`` (s) and the numbers of the state at each event, with dimensions of the parameters, "start" if there are
        several, and "event", its number; NaN for events that were not found within twenty periods for each that is
        asked for. Of each case ``recurrence``, the number of events after which state and phase of the period recur
        (0: none is found; -1: they still come nearer to those of an orbit, or leave it: the motion has not settled),
        ``event_count``, how many of these and of those before were found, ``status`` and ``near_grazing_count``. Warns
        (RuntimeWarning) of cases that have not settled, of those with too few events, and of those not followed to the
        end. A coordinate that passes the value and comes back within one time step is missed.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.
    """
    transient, kept = checked_numbers(transient, kept, (2**31 - 1) // _MOST_PERIODS)
    cases = cases_of(system, base, y0, over, period, method, for_events=True)
    numbers = cases.starts.shape[1] + 1
    require_memory("kept", 8.0 * cases.number * kept * numbers, "the times and states of so many events")
    options = get_args(ModeEvent)
    if isinstance(of, Crossing):
        checks.chosen("of.coordinate", of.coordinate, [coordinate.name for coordinate in cases.system.coordinates])
    elif isinstance(of, str) and of in options:
        contact = checks.whole_number("contact", contact, minimum=0, maximum=(cases.system.tracks.contacts or 1) - 1)
    else:
        raise ValueError(
            f"Argument of must be {checks.one_of(map(repr, options))}, or a Crossing(coordinate, value), but "
            f"{checks.show(of)} was given."
        )
    most = _MOST_PERIODS * (transient + kept)

    def run(cycle: Cycle, starts: Array) -> _Found:
        counts, slots = [jnp.asarray(number, jnp.int32) for number in (transient, most)], _SLOTS
        while True:
            found = _find(cycle, starts, *counts, kept=kept, of=of, contact=contact, slots=slots)
            if (needed := int(jnp.max(found.most_passages))) <= slots:
                return found
            slots = 2 * needed

    what = {"function": "event_section", "of": str(of), "contact": contact, "transient": transient, "kept": kept}
    with kept_in(folder, cases, what) as stored:
        found = in_blocks(cases, run, _Found, progress, stored)
    warn_of_unfinished(found)
    missing = np.sum((found.number < transient + kept) & (found.status == int(Status.FINISHED)))
    if missing:
        checks.warn(
            f"In {missing} of {cases.number} cases fewer events were found in {most} periods than are asked for: the "
            "variable event_count says how many. Their places hold NaN; the motion may have come to rest, or never "
            "pass there."
        )

    # After how many events the state recurs, and where motions drive the system its phase.
    times, states, turns = np.asarray(found.times), np.asarray(found.states), cases.turns
    numbered = states
    if cases.driven:
        phase = times / np.reshape(np.asarray(cases.cycle.duration), (-1, 1))
        numbered, turns = np.concatenate([states, phase[..., None]], axis=-1), (*turns, 1.0)
    recurs = recurrence(numbered, np.max(np.abs(numbered), axis=1), RECURS, turns)
    if transient:
        warn_of_unsettled(recurs == UNSETTLED, f"{transient + kept} events", "transient")

    # A case goes on while others of its block do: what it then finds does not count.
    number = np.minimum(found.number, transient + kept)
    variables: Entries = {
        "time": cases.variable(times, "time of the event", "s", (EVENT,)),
        **cases.variables_of(states, EVENT, "at the event"),
        "recurrence": cases.variable(recurs, "number of events after which the motion repeats itself"),
        "event_count": cases.variable(number, "number of events found"),
        **cases.outcome(found),
    }
    numbers = np.arange(transient + 1, transient + kept + 1)
    return cases.dataset(variables, {EVENT: (EVENT, numbers, {"long_name": "number of the event"})})


@kept_jit(filtered=True)
def _find(
    cycle: Cycle, starts: Array, transient: IntArray, most: IntArray, *, kept: int, of: ModeEvent | Crossing,
    contact: int, slots: int,
) -> _Found:  # fmt: skip
    cases, size = starts.shape
    none = jnp.zeros(cases, jnp.int32)

    def unknown(*shape: int) -> Array:
        return jnp.full(shape, jnp.nan, starts.dtype)

    nothing = _Found(none, unknown(cases, kept), unknown(cases, kept, size), none, none, none)
    first = starts, unknown(cases), nothing

    def over_period(own: Cycle, carry: _Carry, number: IntArray) -> _Carry:
        y, last, found = carry
        run = own.by_steps(y)
        path = run.path
        assert isinstance(path, StepPath)
        model, begun = path.model, path.beginnings
        sign = begun.sign if begun.sign.ndim == 1 else begun.sign[:, contact]
        passages = jnp.zeros((), jnp.int32)
        if isinstance(of, Crossing):
            happens, times, states, passages = _passages(own.system, model, begun, run, of, slots)
        else:
            # At the begin of which steps the event is, by the sign of the relative velocity before and from there on.
            before = jnp.append(jnp.where(jnp.isnan(last), sign[0], last), sign[:-1])
            begins = _BEGINS.get(of)
            happens = (before == 0) & (sign != 0) if begins is None else (before != begins) & (sign == begins)
            times, states = begun.t, jnp.stack(jax.vmap(lambda y: jnp.stack(model.numbers(y)))(begun.y))
        started = number * own.duration
        rank = found.number + jnp.cumsum(happens, dtype=jnp.int32) - 1 - transient
        place = jnp.where(happens & (rank >= 0), rank, found.times.shape[0])
        finished = found.status == int(Status.FINISHED)
        y = jnp.where(finished, jnp.stack(run.final_state), jnp.nan)
        found = _Found(
            found.number + jnp.where(finished, jnp.sum(happens, dtype=jnp.int32), 0),
            found.times.at[place].set(started + times, mode="drop"),
            found.states.at[place].set(states, mode="drop"),
            jnp.where(finished, run.status, found.status),
            found.near_grazing_count + run.near_grazing_count.astype(jnp.int32),
            jnp.maximum(found.most_passages, passages),
        )
        return y, sign[-1], found

    def goes_on(state: tuple[IntArray, _Carry]) -> BoolArray:
        number, (_, _, found) = state
        enough = (found.number >= transient + kept) | (found.status != int(Status.FINISHED))
        return (number < most) & ~jnp.all(enough)

    def one_period(state: tuple[IntArray, _Carry]) -> tuple[IntArray, _Carry]:
        number, carry = state
        of_all = eqx.filter_vmap(over_period, in_axes=(eqx.if_array(0), eqx.if_array(0), None))
        return number + 1, of_all(cycle, carry, number)

    return lax.while_loop(goes_on, one_period, (jnp.zeros((), jnp.int32), first))[1][2]


def _passages(
    system: System, model: SwitchedModel, begun: StepBeginnings, run: Run, crossing: Crossing, slots: int
) -> tuple[BoolArray, FloatArray, FloatArray, IntArray]:
    """Whether, when and in what state a coordinate passes the value, in slots, and how often it does."""
    place = [coordinate.name for coordinate in system.coordinates].index(crossing.coordinate)
    turn = system.coordinates[place].period

    def beyond(numbers: FloatArray) -> FloatArray:
        """How far the coordinate is beyond the value; an angle by at most half a turn."""
        past = numbers - crossing.value
        return past if turn is None else past - turn * jnp.round(past / turn)

    values = beyond(jax.vmap(lambda y: model.numbers(y)[place])(begun.y))
    after = jnp.append(values[1:], beyond(run.final_state[place]))
    up, down = (values < 0) & (after >= 0), (values > 0) & (after <= 0)
    if turn is not None:  # half a turn away from the value it changes its sign too
        near = jnp.abs(after - values) < turn / 2
        up, down = up & near, down & near
    passes = up if crossing.direction > 0 else down if crossing.direction < 0 else up | down
    (steps,) = jnp.nonzero(passes, size=slots, fill_value=-1)
    lengths = jnp.append(begun.t[1:], run.time_reached) - begun.t

    def locate(step: IntArray) -> tuple[FloatArray, FloatArray]:
        here: StepBeginnings = jax.tree.map(lambda column: column[step], begun)
        rises = after[step] > values[step]

        def closer(_: IntArray, state: tuple[FloatArray, FloatArray, FloatArray]):
            low, high, h = state
            y = state_in_step(model, here, h)
            rates = model.rates(model.forcing(here.t, here.segments), h, y, here.sign)
            value, rate = beyond(model.numbers(y)[place]), model.numbers(rates)[place]
            is_before = (value < 0) == rises
            low, high = jnp.where(is_before, h, low), jnp.where(is_before, high, h)
            newton = h - value / jnp.where(rate == 0, 1, rate)
            # Beyond what is known by a hair: it has converged, but for round-off.
            inside = (newton >= low - near) & (newton <= high + near) & (rate != 0)
            return low, high, jnp.where(inside, jnp.clip(newton, low, high), (low + high) / 2)

        zero, near = jnp.zeros_like(lengths[step]), _NEAR * lengths[step]
        _, _, h = lax.fori_loop(0, _NEWTON, closer, (zero, lengths[step], lengths[step] / 2))
        return here.t + h, jnp.stack(model.numbers(state_in_step(model, here, h)))

    times, states = jax.vmap(locate)(steps)
    return steps >= 0, times, states, jnp.sum(passes, dtype=jnp.int32)
