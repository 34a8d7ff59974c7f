"""What is followed period by period: cases, each a system, what drives it, and the period after which it repeats
itself.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._dynamics.common.method import Arguments, Exact, check_fixed, slowest_time, state_of, working_dtype
from .._dynamics.common.path import Run, SegmentLaws
from .._dynamics.engine_choice import Choice, engine_for
from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation, provenance, source
from .._dynamics.switched.engine import SwitchedEngine, steps_for
from .._ensemble.points import Points, Setter, check_points, label_and_unit, points_of, setter_of, setting_of
from .._excitation.excitation import BaseMotion, excitation_of, motion_of
from .._excitation.motion import Motion, Signal, UserMotion
from .._foundation import checks
from .._foundation.extras import Dataset, Entries, flags, labeled_dataset, require_labels, variable
from .._foundation.fields import is_of_package, modules_in
from .._foundation.types import DType, FloatArray, InitialState, Number, Scalar, Status
from .._numerics.derivatives import NotKnown, as_arrays, values_of
from .._systems.system import System, checked_system
from .._uncertainty.numbers import with_numbers

# The period of what drives a system: its base, and the forces in its fields.


_MOST_CYCLES = 1000  # of the slowest motion until all motions begin anew
_EQUAL = 1e-9  # relative
_INSTANTS = (1024, 65_536)  # of a period, at which a signal is compared with itself one period later
_IN_FASTEST = 16  # of them in its fastest oscillation
_MOST_INSTANTS = 4_000_000  # of all cases


def repetitions(system: object, base: object, by_itself: bool = False) -> list[tuple[str, Any]]:
    """The class name of each motion that drives the system, and its `Motion.repeats_after`, of each of its parts:
    numbers (s), or arrays (cases,) where numbers of the motion are. `by_itself`: the system changes with time in a way
    of its own.
    """
    found: list[tuple[str, Any]] = []
    for motion in [*_outermost(base), *_outermost(system)]:
        after = motion.repeats_after
        found += [(type(motion).__name__, part) for part in (after if isinstance(after, tuple) else (after,))]
    return found + ([(type(system).__name__, None)] if by_itself else [])


def _outermost(tree: object) -> list[Motion]:
    """The motions in `tree` that hold no other motion."""
    motions = [module for module in modules_in(tree) if isinstance(module, Motion)]
    return [motion for motion in motions if sum(isinstance(part, Motion) for part in modules_in(motion)) == 1]


def period_of(periods: list[tuple[str, Any]], given: Scalar | None) -> tuple[Any, bool]:
    """The period (s) of what `repetitions` found, (cases,) if its times are, or the one `given`; and whether anything
    drives the system.

    Raises ValueError where none is given or known, and where what drives the system does not repeat itself after it.
    """
    unknown = [name for name, period in periods if period is None]
    common = None if unknown else common_period(periods)
    if given is not None:
        cycles = np.ones(()) if common is None else np.asarray(given / common)
        if common is not None and not np.all(np.abs(cycles - np.round(cycles)) <= _EQUAL * cycles):
            raise ValueError(
                f"Argument period must be a whole number of periods of what drives the system, "
                f"{float(np.ravel(common)[0]):.9g} s, but {checks.show(given)} was given."
            )
        return given, common is not None or bool(unknown)
    if unknown:
        raise ValueError(
            f"Argument period must be given (s), because none is known of the {unknown[0]} that drives the system; of "
            "a record, the duration after which it begins anew."
        )
    if common is None:
        raise ValueError(
            "Argument period must be given (s), because nothing that changes with time drives the system; it is then "
            "the time after which the state is seen again and again. A section by events (event_section) needs none."
        )
    return common, True


def common_period(periods: list[tuple[str, Any]]) -> np.ndarray | None:
    """The common period; None if nothing changes with time. Raises ValueError where there is none."""
    columns = np.broadcast_arrays(*(np.asarray(period, float) for _, period in periods))
    changing = [column for column in columns if np.any(column > 0)]
    if not changing:
        return None
    every = np.stack(changing)
    slowest = np.max(every, axis=0)
    common = np.full(slowest.shape, np.nan)
    for number in range(1, _MOST_CYCLES + 1):
        cycles = number * slowest / every
        fits = np.all(np.abs(cycles - np.round(cycles)) <= _EQUAL * cycles, axis=0)
        common = np.where(np.isnan(common) & fits, number * slowest, common)
        if not np.any(np.isnan(common)):
            return common
    bad = int(np.flatnonzero(np.isnan(np.atleast_1d(common)))[0])
    shown = ", ".join(f"{np.atleast_1d(column)[bad]:.6g}" for column in every)
    raise ValueError(
        f"Argument period must be given (s), because motions with the periods {shown} s drive the system, of which no "
        f"{_MOST_CYCLES} of the slowest are a common period."
    )


def check_signals(tree: object, period: Array) -> None:
    """Raise ValueError where a signal of a user's own in `tree` is another one a `period` (s) later, at many instants
    of one period; of many cases, arrays have a first axis (cases,), and `period` is (cases,).
    """
    if any(map(checks.is_traced, jax.tree.leaves((tree, period)))):
        return
    periods = np.atleast_1d(np.asarray(period, float))
    for signal in _outermost(tree):
        held = signal.motion if isinstance(signal, UserMotion) else signal
        if not isinstance(signal, Signal) or (held is signal and is_of_package(signal)):
            continue
        fastest = np.asarray(signal.shortest_period or np.inf, float)
        number = np.clip(_IN_FASTEST * np.max(periods) / np.min(fastest), *_INSTANTS)
        shares = (np.arange(int(min(number, max(_MOST_INSTANTS / len(periods), 64)))) + 0.382) / number

        def differences(signal: Signal, period: Array, shares: np.ndarray = shares) -> tuple[Array, Array, Array]:
            times = period * jnp.asarray(shares, period.dtype)
            first, second = (jax.vmap(signal.value)(at) for at in (times, times + period))
            # Beside differences of the values themselves, what the rounding of the instants makes of the rates.
            rates, eps = jax.vmap(signal.rate)(times), jnp.finfo(period.dtype).eps
            bound = jnp.sqrt(eps) * jnp.max(jnp.abs(first)) + 4 * eps * period * jnp.abs(rates)
            worst = jnp.argmax(jnp.abs(first - second) - bound)
            differs = ~(jnp.abs(first - second) <= bound)[worst]
            return differs, times[worst], jnp.stack([first[worst], second[worst]])

        found = differences if np.ndim(period) == 0 else eqx.filter_vmap(differences)
        differs, times, values = map(np.asarray, found(signal, jnp.asarray(period)))
        if np.any(differs):
            case = int(np.argmax(differs))
            one, other = values.reshape(-1, 2)[case]
            name = type(signal).__name__ if held is signal else type(getattr(held, "held", held)).__name__
            raise ValueError(
                f"Argument period must be a time after which {name} repeats itself, but its value is {one:.6g} at "
                f"{times.ravel()[case]:.6g} s and {other:.6g} {periods[case]:.9g} s later."
            )


def drive_period(system: object, base: object, given: Scalar | None, by_itself: bool) -> Scalar | None:
    """The period (s) of what drives the system, differentiable; None if nothing changes with time.

    Raises ValueError where none is given or known, and where what drives the system does not repeat itself after it.
    """
    found = repetitions(system, base, by_itself)
    changing: list[Any] = [part for _, part in found if part is None or checks.is_traced(part) or float(part) > 0]
    if not changing:
        return None
    is_traced = any(map(checks.is_traced, [*changing, given]))
    if not is_traced or any(part is None for part in changing):
        period, _ = period_of(found, given)
        return given if period is given else float(period)
    if given is not None:
        return given
    if len(changing) == 1:
        return changing[0]
    try:
        values = [values_of(part) for part in changing]
    except NotKnown:
        raise ValueError(
            "Argument period must be given (s) under jax.jit, because several motions drive the system."
        ) from None
    common = common_period([("", value) for value in values])
    cycles = np.unique(np.round(common / values[0]))
    if len(cycles) > 1:
        raise ValueError("Argument period must be given (s): the motions that drive these systems have no common one.")
    return float(cycles[0]) * changing[0]


# Whether the equations of a user's system change with time by themselves, apart from the motions that drive them.


_PARTS = np.array([0.0, 0.013, 0.171, 0.31, 0.4737, 0.618, 0.757, 0.893])  # of a period, or many: no simple ratios
_FAR = np.array([1.0, 7.31, 93.7])


def changes_by_itself(system: System, base: BaseMotion, y0: InitialState, given: Scalar | None) -> bool:
    """Whether rates, relative velocities or normal forces of a user's system change with time otherwise than its base
    and the motions in its fields do: looked at near `y0` at a few instants.

    Raises ValueError where they do, and do not begin anew after the period (s) `given`.
    """
    numbers = jax.tree.leaves((system, base, y0, given))
    if any(map(checks.is_traced, numbers)):
        return False
    found = repetitions(system, motion_of(base))
    if any(period is None for _, period in found):
        return False  # a period is asked for because of these

    def differs_after(period: Any) -> bool:
        return system.differs_between(y0, float(period) * _PARTS, float(period) * (1 + _PARTS))

    common = common_period(found)
    if common is None:
        times = slowest_time(system, base) * np.outer(_FAR, _PARTS).ravel()
        changes = system.differs_between(y0, times, np.zeros_like(times))
    else:
        changes = differs_after(common)
    if changes and given is not None and differs_after(given):
        raise ValueError(
            f"Argument period must be a time after which the rates of {type(system).__name__} begin anew, but they "
            f"differ from those {checks.show(given)} s later."
        )
    return changes


# One period of a system and of what drives it.


class Cycle(eqx.Module):
    """A system and what drives it, for one `duration` (s), after which the drive repeats itself.

    Of many cases, arrays have a first axis (cases,).
    """

    system: System
    base: BaseMotion
    duration: Number
    method: Exact

    def after(self, y: FloatArray) -> Simulation:
        """The motion of one case over one period from the state `y`, (coordinates,)."""
        return simulate(self.system, self.base, t1=self.duration, y0=tuple(y), method=self.method)

    def end(self, y: FloatArray) -> FloatArray:
        """The state after one period, (coordinates,); NaN where that is no time or the motion does not reach it."""
        after = self.after(y)
        is_known = (after.status == int(Status.FINISHED)) & (self.duration > 0)
        return jnp.where(is_known, jnp.stack(after.final_state), jnp.nan)

    def change(self, y: FloatArray) -> FloatArray:
        """How far the state is from `y` after one period, without whole turns of angles, (coordinates,)."""
        return without_turns(self.system, self.end(y) - y)

    def by_steps(self, y: FloatArray) -> Run:
        """The same motion in time steps, also where it is known over whole intervals of the base."""
        return Choice(Arguments(self.system, self.base, self.method, self.duration)).follow(tuple(y), y.dtype)[1]

    def lasting(self, duration: Scalar) -> "Cycle":
        """The same with another duration (s)."""
        return Cycle(self.system, self.base, duration, self.method)

    def of(self, which: int | slice | np.ndarray) -> "Cycle":
        """Those of many cases alone."""
        return jax.tree.map(lambda leaf: leaf[which] if eqx.is_array(leaf) else leaf, self)

    def rates(self, y: FloatArray) -> FloatArray:
        """The rates of the state at the begin of the period, per second."""
        step = Arguments(self.system, self.base, self.method, self.duration).checked_step()[1]
        zero, excitation = jnp.zeros((), y.dtype), excitation_of(self.base)
        engine = SwitchedEngine(self.system, excitation, self.duration, tuple(y), step, 0, self.method.solver)
        lane = engine.lane(excitation.signal, np.zeros(2, np.uint32), y.dtype)
        model = self.system.switched_model(excitation.signal, self.method.solver)
        forcing = model.forcing(zero, SegmentLaws.of(self.system, excitation).segments(lane.segment_states))
        return jnp.stack(model.numbers(model.rates(forcing, zero, lane.y, lane.sign)))


def without_turns(system: System, change: FloatArray) -> FloatArray:
    """A change of the state without the whole turns of its angles, (coordinates,)."""
    periods = [coordinate.period or np.inf for coordinate in system.coordinates]
    if not np.any(np.isfinite(periods)):
        return change
    turn = jnp.asarray(np.where(np.isfinite(periods), periods, 0), change.dtype)
    return change - turn * lax.stop_gradient(jnp.round(change / jnp.where(turn > 0, turn, jnp.inf)))


def steps_in(
    system: System, base: BaseMotion, method: Exact, duration: Scalar, *, by_steps: bool = False
) -> int | None:
    """How many time steps `duration` (s) needs; None where `method` says it, no steps are taken, or it is not known.

    `by_steps`: time steps also where the motion is known over whole intervals of the base.
    """
    arguments = Arguments(system, base, method, duration)
    if method.max_steps is not None or not (by_steps or not engine_for(arguments).by_intervals):
        return None
    try:
        excitation, step = arguments.checked_step()
        return steps_for(system, excitation, duration, step, "period")
    except NotKnown:
        return None


# What is followed period by period: cases, each a system, what drives it, and the period after which that repeats.


Over = Mapping[str, Any]
Turns = tuple[float | None, ...]
"""The period of each coordinate that turns, None for the others."""

MOST_PERIODS = 2**31 - 1
"""In all, as many as 32 bits count."""
START, CYCLE = "start", "cycle"
"""Dimensions of results: of many starts, and of the periods."""


@runtime_checkable
class Followed(Protocol):
    """Results of cases, (cases,): the `Status`, and how often round-off decided."""

    @property
    def status(self) -> Array: ...

    @property
    def near_grazing_count(self) -> Array: ...


class Cases(NamedTuple):
    """Cases to be followed: a `cycle` with a first axis (cases,) of its arrays, and where each begins, (cases,
    coordinates).

    - `shape`: of the parameters' grid, then of the starts, if there are several. `points`: values of the parameters.
    - `driven`: whether something changes with time; else the duration of a cycle is one that was asked for.
    """

    cycle: Cycle
    starts: np.ndarray
    shape: tuple[int, ...]
    points: Points
    setter: Setter
    driven: bool

    @property
    def system(self) -> System:
        """The system of the arguments."""
        return self.setter.setting.system

    @property
    def turns(self) -> Turns:
        """The period of each coordinate that turns."""
        return tuple(coordinate.period for coordinate in self.system.coordinates)

    @property
    def dtype(self) -> DType:
        """The precision of the simulations."""
        return np.asarray(self.cycle.duration).dtype

    @property
    def number(self) -> int:
        """How many cases there are."""
        return len(self.starts)

    def of(self, which: np.ndarray, starts: np.ndarray) -> "Cases":
        """Those cases alone, from other `starts` (cases, coordinates)."""
        return self._replace(cycle=self.cycle.of(which), starts=starts, shape=(len(which),))

    # --- results over the cases as labelled arrays: the grid of parameters, then the starts

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names of the dimensions of the cases."""
        own = tuple(one.name for one in self.points.dimensions)
        return own + ((START,) if len(self.shape) > len(own) else ())

    def variable(
        self, values: Any, long_name: str, unit: str = "1", more: tuple[str, ...] = (), **attributes: object
    ) -> tuple[Any, ...]:
        """A variable whose `values`, (cases, ...), are put on the grid of the cases, with the dimensions `more`."""
        values = np.asarray(values)
        grid = values.reshape((*self.shape, *values.shape[1:]))
        return variable((*self.dimensions, *more), grid, long_name, unit, **attributes)

    def variables_of(self, states: np.ndarray, more: str, where: str) -> Entries:
        """A variable for each number of the `states`, (cases, ..., coordinates), with the dimension `more`."""
        found = {}
        for number, coordinate in enumerate(self.system.coordinates):
            column = within_turn(states[..., number], coordinate.period)
            label = f"{coordinate.name} {where}"
            found[coordinate.variable] = self.variable(column, label, coordinate.unit, (more,))
        return found

    def outcome(self, found: Followed) -> Entries:
        """Whether each case was followed to the end, and how often round-off decided about an event."""
        status = found.status.astype(np.int8)
        return {
            "status": self.variable(status, "whether the case was followed to the end", **flags(Status)),
            "near_grazing_count": self.variable(found.near_grazing_count, "number of events decided by round-off"),
        }

    def dataset(self, variables: Entries, coordinates: Entries) -> Dataset:
        """The data set of `variables` over the cases, with the values of parameters and the starts as coordinates."""
        setting = self.setter.setting
        found: Entries = {}
        for one in self.points.dimensions:
            for number, name in enumerate(one.parameters):
                label, unit = label_and_unit(setting, name)
                found[name] = variable(one.name, one.values[:, number], label, unit)
        if self.dimensions[-1:] == (START,):
            starts = self.starts[: self.shape[-1]]
            for column, coordinate in zip(starts.T, self.system.coordinates, strict=True):
                name = f"initial_{coordinate.variable}"
                found[name] = variable(START, column, f"initial {coordinate.name}", coordinate.unit)
        about = {**source(), **provenance(self.system, setting.law, setting.method)}
        return labeled_dataset(apart(variables, found), {**found, **coordinates}, about)


def within_turn(column: np.ndarray, period: float | None) -> np.ndarray:
    """Numbers of a coordinate, between 0 and its `period` if it turns."""
    return column if period is None else np.mod(column, period)


def apart(variables: Entries, parameters: Iterable[str]) -> Entries:
    """`variables`, with an underscore after the name of each that is called as a parameter is: "period_"."""
    taken = set(parameters)
    return {f"{name}_" if name in taken else name: entry for name, entry in variables.items()}


def checked_numbers(transient: object, kept: object, most: int = MOST_PERIODS) -> tuple[int, int]:
    """The numbers of periods, checked; at most so many in all."""
    transient = checks.whole_number("transient", transient, minimum=0, maximum=most)
    return transient, checks.whole_number("kept", kept, maximum=most - transient)


def cases_of(
    system: System,
    base: BaseMotion,
    y0: Any,
    over: Over | None,
    period: Scalar | None,
    method: Exact,
    *,
    for_events: bool = False,
) -> Cases:
    """The checked cases: each point of the grid `over`, from each start `y0`.

    `for_events`: to be followed in time steps, and where nothing drives the system for any time.

    Raises ValueError for what cannot be followed from period to period, and ImportError without the extra ``study``.
    """
    require_labels()
    check_repeats(system, base, period, method)
    if checks.holds_traced(system, base, y0, period):
        raise ValueError(
            "Sections, diagrams, basins and exponents need numbers, but JAX is tracing an argument: call them outside "
            "jit, vmap and grad, with many starts in y0 and values of parameters in over. periodic_orbit can be "
            "transformed."
        )
    setting = setting_of(system, base, None, method)
    several = y0 is not None and checks.dimensions(y0) == 2
    if several:
        starts = checks.numbers("y0", y0, ndim=2)
        if not len(starts) or not np.all(np.isfinite(starts)):
            raise checks.refused("y0", "hold at least one start, and finite numbers", y0)
        left_out = np.asarray(state_of(system, tuple(starts[0]))[starts.shape[1] :], float)  # ages of sticks
        ages = np.broadcast_to(left_out, (len(starts), len(left_out)))
        starts = np.concatenate([starts, ages], axis=1, dtype=float)
    else:
        starts = np.asarray([state_of(system, y0)], float)
    setting = setting._replace(y0=tuple(map(float, starts[0])))
    points = Points(()) if over is None else points_of(over)
    setter, rows = setter_of(setting, points.parameters), np.zeros((1, 0))
    if over is not None:
        check_points(setter, points, lambda point: setter(points.values(point)))
        rows = np.array([points.values(point) for point in range(points.number)], float)
    dtype = working_dtype(stacklevel=5)

    # The period of each case, of its parameters alone.
    setting, grid = setter.setting, np.repeat(rows, len(starts), axis=0)
    columns, of_all = setter.columns(grid)
    by_itself = changes_by_itself(setting.system, setting.law, setting.y0, period)
    found = repetitions(of_all.system, motion_of(of_all.law), by_itself)
    if for_events and period is None and not any(after is None for _, after in found) and common_period(found) is None:
        period = slowest_time(setting.system, setting.law)
    duration, driven = period_of(found, period)
    Arguments(setting.system, setting.law, method, float(np.max(duration))).check_length()

    # All cases at once, as arrays. Under vmap outside jit, what sizes of arrays depend on is known (`known.values_of`).
    paths, as_given = tuple(columns), as_arrays(setting, dtype)
    numbers = np.stack([columns[path] for path in paths], axis=1) if paths else np.zeros((len(grid), 0))
    most: list[int | None] = []

    def one(row, duration):
        changed = with_numbers(as_given, paths, row)
        base = motion_of(changed.law).realized_until(duration)
        most.append(steps_in(changed.system, base, changed.method, duration, by_steps=for_events))
        return changed.system, base, duration, jnp.stack([jnp.asarray(number, dtype) for number in changed.y0])

    durations = jnp.broadcast_to(jnp.asarray(duration, dtype), (len(grid),))
    every, bases, durations, begins = eqx.filter_vmap(one)(jnp.asarray(numbers, dtype), durations)
    if driven:
        check_signals((every, bases), durations)
    if most[-1] is not None:
        method = Exact(method.step, most[-1], method.solver)
    shape = points.shape + ((len(starts),) if several else ())
    begins = np.tile(starts, (len(rows), 1)) if several else np.asarray(begins)
    return Cases(Cycle(every, bases, durations, method), begins, shape, points, setter, driven)


def check_repeats(system: System, base: BaseMotion, period: Scalar | None, method: object) -> None:
    """Raise ValueError for what cannot be followed from period to period, as a base that is random."""
    checks.require_threads_of_jax()
    if not isinstance(method, Exact):
        raise ValueError(f"Argument method must be Exact(...), but {checks.show(method)} was given.")
    if period is not None:
        checks.positive("period", period, "s")
    checked_system(system)
    check_fixed(system=system, base=base)
    if motion_of(base).is_random:
        raise ValueError(
            f"Argument base must repeat itself, but the random law {type(base).__name__} was given; simulate_ensemble "
            "gives its statistics, and base.sample(key, period), a realisation, repeats itself after the period that "
            "you give."
        )
