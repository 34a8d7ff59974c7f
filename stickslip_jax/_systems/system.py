"""The interface of a system, which engines, statistics, sensitivities, sweeps and figures use; how it is drawn in
motion.
"""

import abc
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, TypeVar, cast

import equinox as eqx
import numpy as np
from jaxtyping import Array, PyTree

from .._excitation.excitation import Excitation
from .._excitation.motion import SIGNAL_UNIT, RandomPhase, RandomSignal, Signal, SourceVoltage
from .._excitation.segments import SegmentLaw
from .._foundation import checks
from .._foundation.fields import PACKAGE, Checked, Option, keeps, modules_in, with_fields
from .._foundation.types import AnyArray, BoolScalar, ExplicitSolver, FloatArray, InitialState, Number, Scalar, Solver
from .._uncertainty.families import RandomNumber
from .._uncertainty.numbers import NumberPath, number_at, quantity_at
from .dynamic_friction import DynamicFriction
from .memory_models import InnerStates
from .switched_model import OneContactModel, SwitchedModel

# Whether a pytree holds only the package's own modules, or user-defined functions too.


def is_built_in(tree: PyTree) -> bool:
    """Whether every module in `tree` is the package's own, or a solver of diffrax."""
    return all(
        type(module).__module__.startswith((f"{PACKAGE}.", "diffrax."))
        and not getattr(module, "holds_users_code", False)
        for module in modules_in(tree)
    )


# The units of numbers by their paths.


def unit_at(setting: Any, path: NumberPath) -> str:
    """The unit of the number at `path` in a `setting`, which has a system; "1" where it has none, or none is known.

    The numbers of a distribution have the unit of what is random, but for those that only give its shape.
    """
    *above, last = path
    if above == ["y0"]:
        return setting.system.coordinates[int(last)].unit
    holder = number_at(setting, tuple(above))
    if isinstance(holder, RandomNumber):
        return "1" if last in holder.shape_numbers else unit_at(setting, tuple(above))
    unit = quantity_at(setting, path).unit
    if unit == SIGNAL_UNIT:  # the base's own, or a force of the system
        return "N" if path[0] == "system" else "m/s"
    return unit or "1"


# How a system is drawn in motion: bodies, springs, rods, disks and belts whose places follow from its states.
#
# Plain data, which ``plot.animate`` draws. Lengths are those of the horizontal axis of the drawing, usually m. A number
# that changes from frame to frame is an array (frames,), one that does not may be a float.


OverTime: TypeAlias = np.ndarray | float
Point: TypeAlias = tuple[OverTime, OverTime]
"""Its horizontal and its vertical place."""


class Body(NamedTuple):
    """A rectangle, coloured as a stick while any of its contacts sticks.

    Args:
        center: Of the rectangle.
        width: Horizontal.
        height: Vertical.
        contacts: Numbers of its contacts, from 0; of a system with one contact ``(0,)``.
        label: Written on it.
        fixed: Whether it is part of the surroundings, such as a wall.
    """

    center: Point
    width: OverTime
    height: OverTime
    contacts: tuple[int, ...] = ()
    label: str = ""
    fixed: bool = False


class Spring(NamedTuple):
    """A zig-zag line that stretches.

    Args:
        start: One end.
        end: The other.
    """

    start: Point
    end: Point


class Rod(NamedTuple):
    """A straight line.

    Args:
        start: One end.
        end: The other.
        contacts: As those of a `Body`.
    """

    start: Point
    end: Point
    contacts: tuple[int, ...] = ()


class Disk(NamedTuple):
    """A disk that turns, with a mark from its centre to its rim.

    Args:
        center: Of the disk.
        radius: Of the disk.
        angle: From the horizontal axis to the mark, counterclockwise, rad; None without a mark.
        contacts: As those of a `Body`.
        label: Written under it.
        is_base: Whether it is the base: a ring with marks, in the colour of bases.
    """

    center: Point
    radius: float
    angle: OverTime | None = None
    contacts: tuple[int, ...] = ()
    label: str = ""
    is_base: bool = False


class Belt(NamedTuple):
    """The base: a horizontal line with marks that move with it, one of them longer than the others.

    Args:
        y: Its height in the drawing.
        displacement: How far it has run; the marks stand at this place, and at multiples of `spacing` from it.
        ends: Between which it is drawn: a mark that leaves at one end comes in again at the other.
        marks: How many there are between the ends.
    """

    y: float
    displacement: OverTime
    ends: tuple[float, float]
    marks: int = 8

    @property
    def spacing(self) -> float:
        """From one mark to the next."""
        return (self.ends[1] - self.ends[0]) / self.marks

    @property
    def mark_places(self) -> np.ndarray:
        """Where the marks stand, (frames, marks); the first is the long one."""
        low, high = self.ends
        run = np.asarray(self.displacement, float)[..., None] + self.spacing * np.arange(self.marks)
        return low + np.mod(run - low, high - low)


Part: TypeAlias = Body | Spring | Rod | Disk | Belt


class Mechanism(NamedTuple):
    """How a system is drawn at the times of all frames: what the `mechanism` of a `Look` returns.

    Args:
        parts: In the order in which they are drawn, the last above the others.
        x_range: The part of the horizontal axis that is shown.
        y_range: That of the vertical one.
        x_label: Of the horizontal axis; without one its numbers are not shown.
        x_names: Places on the horizontal axis and what to write there, in place of numbers.
        equal: Whether lengths are drawn alike in both directions, so that circles are round.
        note: What must be known to read the drawing.
    """

    parts: tuple[Part, ...]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_label: str = ""
    x_names: tuple[tuple[float, str], ...] = ()
    equal: bool = False
    note: str = ""


def bars(
    coordinates: "tuple[Coordinate, ...]", state: tuple[np.ndarray, ...], on: tuple[tuple[int, ...], ...]
) -> Mechanism:
    """The numbers of a state as bars, each over its largest size; `on`: of each, the contacts that colour its bar."""
    parts, names = [], []
    for number, (coordinate, values, contacts) in enumerate(zip(coordinates, state, on, strict=True)):
        largest = float(np.max(np.abs(values)))
        shares = values / largest if largest > 0 else values
        parts.append(Body((float(number), shares / 2), 0.6, np.abs(shares), contacts))
        in_unit = "" if coordinate.unit == "1" else f" {coordinate.unit}"
        names.append((float(number), f"{coordinate.name}\n±{largest:.3g}{in_unit}"))
    last = len(coordinates) - 0.5
    parts.append(Rod((-0.5, 0.0), (last, 0.0)))
    return Mechanism(tuple(parts), (-0.5, last), (-1.1, 1.5), x_names=tuple(names))


@dataclasses.dataclass(frozen=True)
class Look:
    """What figures show of a system: what `System.look` returns.

    Args:
        body_name: The body whose state it is, for legends: "mass", "motor".
        mechanism: How it moves in films: a function that takes the state at the times of all frames, arrays (frames,),
            and how far the base has moved since the first, (frames,), m or rad, and returns a `Mechanism`. None: each
            coordinate is a bar over its largest size.
        stick_band: Between which values friction can hold a stick: a function of ``(times, state, velocity,
            acceleration, ground)``, arrays (points,): times (s), the state at these times, velocity (m/s) and
            acceleration (m/s^2) of the base, and the acceleration of the ground (m/s^2). It returns the lower and the
            upper limit, (points,), NaN where they are not known. None: nowhere.
        band_coordinate: Index of the number of the state that `stick_band` limits.
        band_symbols: The stick band in TeX, where it does not change in time.
        slip_center: Distance from 0 of the two points about which slips oscillate on a base without acceleration.
        longest_stick: An upper bound of the duration of sticks (s) under a signal, by their positions: a function of
            ``(signal, positions)`` that returns an array, or None where it knows none.
        second_is_base_velocity: Whether in a stick the second number of the state is the base velocity, and the rate of
            the first.
    """

    body_name: str = "system"
    mechanism: Callable[[tuple[np.ndarray, ...], np.ndarray], Mechanism] | None = None
    stick_band: Callable[..., tuple[Array, Array]] | None = None
    band_coordinate: int = 0
    band_symbols: str = ""
    slip_center: Scalar | None = None
    longest_stick: Callable[[Signal, AnyArray], Array | None] | None = None
    second_is_base_velocity: bool = False


# The interface of a system, which engines, statistics, sensitivities, sweeps and figures use.


class Coordinate(NamedTuple):
    """One number of a system's state.

    Args:
        name: Such as "position".
        unit: Such as "m"; "1" for none.
        symbol: In TeX.
        period: None if it has none.
    """

    name: str
    unit: str
    symbol: str = ""
    period: float | None = None

    @classmethod
    def of(cls, name: str) -> "Coordinate":
        """The coordinate that ``"position in m"`` names; without a unit, its unit is 1."""
        known, _, unit = name.rpartition(" in ")
        return cls(known, unit) if known else cls(name, "1")

    @property
    def meaning(self) -> str:
        """Name and unit: "position in m"."""
        return self.name if self.unit == "1" else f"{self.name} in {self.unit}"

    @property
    def variable(self) -> str:
        """Its name as that of a variable in a data set: "angular_velocity"."""
        return self.name.replace(" ", "_")

    @property
    def label(self) -> str:
        """Label of an axis: "position $x$ (m)"."""
        return self.labeled("")

    def labeled(self, more: str) -> str:
        """Label of an axis with `more` words: "position $x$ where the stick begins (m)"."""
        symbol, unit = f" ${self.symbol}$" if self.symbol else "", f" ({self.unit})" if self.unit != "1" else ""
        return f"{self.name}{symbol}{more}{unit}"


AGE = Coordinate("age of the stick", "s", r"\tau")


def ages_of(contacts: int) -> tuple[Coordinate, ...]:
    """The ages of the sticks of each contact of a list."""
    return tuple(Coordinate(f"age of stick {i}", "s", rf"\tau_{{{i}}}") for i in range(contacts))


class StepCount(NamedTuple):
    """Number of time steps in one time scale: by default, and at least."""

    default: float
    least: float


# A harmonic motion has at most one extremum in a sixth of its period, but the sum of two may have more: six steps in
# the shortest period missed a stick in 21 of 270,000 random trajectories of 60 s, eight in 4 of 279,000, ten in none of
# 288,000. A Runge-Kutta method needs more.
PERIOD, SOLVED = StepCount(16.0, 10.0), StepCount(48.0, 12.0)

# Of the times in a slip with friction that depends on the speed; its error is controlled.
PASSED, DECAYED = StepCount(6.0, 1.0), StepCount(2.0, 1.0)

SOFT = 0.01  # rad/s, of a spring that does not set the time in which a motion changes


SHORTEST_TIME = "shortest time of the system"


class TimeScale(NamedTuple):
    """A time (s; None where it is not known) that time steps must be short against, and how short."""

    time: Scalar | None
    steps: StepCount


class TimeScales(NamedTuple):
    """What time steps of a system under its excitation must be short against.

    - `scales`: by name, of the system and of what drives it.
    - `driving`: the shortest times (s) in which what drives it may change, by name; None where one is not known. A step
      that adapts to the motion sees no change of it before it sees that of these: it may pass over a pulse.
    - `are_all`: whether the motion has no others, whatever the state.
    - `usual_step`: an upper bound (s) of most steps where a fast motion needs shorter ones than are allowed.
    """

    scales: dict[str, TimeScale]
    driving: dict[str, Scalar | None]
    are_all: bool = False
    usual_step: Scalar = math.inf


class Sizes(NamedTuple):
    """How large what changes in a motion is.

    - `speed`: a typical relative velocity, m/s; `deceleration`: that by the largest friction force alone, m/s^2. Of
      several contacts they may be arrays (contacts,). Each is None where it is not known.
    - `state`: of each number of the state, the scale of its errors where the number itself is small.
    """

    speed: Scalar | FloatArray | None
    deceleration: Scalar | FloatArray | None
    state: tuple[Scalar, ...]


class Memory(NamedTuple):
    """What friction remembers, the last numbers of a state: the `elongations` of springs in front of contacts, of each
    contact the `ages` of sticks and the `places` on the base, where friction depends on them, and the inner states of
    those `laws` that have one; and of each contact the `slips`, slip distances, where friction weakens with them.
    """

    ages: tuple[Coordinate, ...] = ()
    laws: tuple[DynamicFriction, ...] = ()
    places: tuple[Coordinate, ...] = ()
    elongations: tuple[Coordinate, ...] = ()
    slips: tuple[Coordinate, ...] = ()

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The elongations, the ages, the places, the slip distances and the inner states."""
        names = [[Coordinate.of(name) for name in law.inner_states] for law in self.laws]
        if len(names) > 1:
            names = [[name._replace(name=f"{name.name} {i}") for name in law] for i, law in enumerate(names, start=1)]
        return *self.elongations, *self.ages, *self.places, *self.slips, *itertools.chain(*names)

    @property
    def start(self) -> tuple[Number, ...]:
        """What they begin with where an initial state leaves them out."""
        zeros = (0.0 for _ in (*self.elongations, *self.ages, *self.places, *self.slips))
        return (*zeros, *self._of_states("initial_state"))

    @property
    def state_scales(self) -> tuple[Scalar, ...]:
        """The sizes of inner states: those of their errors where they are small."""
        return self._of_states("state_scale")

    def _of_states(self, name: str) -> tuple[Scalar, ...]:
        """A property of the laws, for each inner state of each."""
        of_laws = ((getattr(law, name), len(law.inner_states)) for law in self.laws)
        return tuple(itertools.chain(*(of if isinstance(of, tuple) else (of,) * number for of, number in of_laws)))


class Tracks(NamedTuple):
    """What the sticks of a system are counted of.

    - `contacts`: the length of its list of contacts, each with sticks of its own; None for a system with one contact.
    - `counted`: of such a list the one whose sticks alone are counted, -1 for all at once; None: of every one.
    """

    contacts: int | None = None
    counted: int | None = None

    @property
    def number(self) -> int | None:
        """Of how many things sticks are counted: every contact and all at once; None where it is one."""
        return None if self.contacts is None or self.counted is not None else self.contacts + 1


class RecordedForces(NamedTuple):
    """The `loads` and `normal_forces` of a system that are piecewise linear in time."""

    loads: tuple[SegmentLaw, ...] = ()
    normal_forces: tuple[SegmentLaw, ...] = ()


class Traits(NamedTuple):
    """What engines and estimators need to know of a system.

    - `compiles_natively`: whether its motion can be compiled into native loops: without calls of libraries.
    - `lanes`: how many move in lock step on a CPU: the arrays of so many stay in the cache (benchmarks/README.md).
    - `has_interval_form`: whether its motion has a closed form from jump to jump of a piecewise-constant base velocity.
    - `stops_are_unstable`: whether friction depends on where the motion stops: two motions that nearly stop there may
      part quickly. First-order estimates of how nearly a motion stopped are then too inaccurate (docs/sensitivity.md).
    - `jumps_at_places`: whether friction jumps from place to place.
    - `begins_anew`: whether its state jumps where sticks and slips begin.
    """

    compiles_natively: bool = True
    lanes: int = 256
    has_interval_form: bool = False
    stops_are_unstable: bool = False
    jumps_at_places: bool = False
    begins_anew: bool = False


class System(Checked):
    """A mechanical system with dry-friction contacts: all that is particular to it.

    `MassSpring` and `MotorCart` are systems; for one of your own subclass `SwitchedSystem`.
    """

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The numbers of its state. Phase portraits show the second against the first."""

    @property
    def observed(self) -> tuple[Coordinate, ...]:
        """What can be asked of a motion beside its `coordinates`, in the order of `HasEnergies.observed`."""
        return ()

    @abc.abstractmethod
    def switched_model(self, smooth: Signal | None, solver: ExplicitSolver | None) -> SwitchedModel:
        """The system under one realisation of the smooth excitation.

        Args:
            smooth: The smooth part of the excitation, None if there is none.
            solver: What integrates slips; None for the closed form where there is one.
        """

    @property
    def memory(self) -> Memory:
        """What friction remembers: the last of its `coordinates`."""
        return Memory()

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        """The system under one realisation of the smooth excitation with the inner states of its friction laws; None if
        they have none.
        """
        return None

    def ready(self) -> "System":
        """The same system, with what its `switched_model` needs of linear algebra done: for loops that make it in each
        step.
        """
        return self

    @property
    def traits(self) -> Traits:
        """What engines and estimators need to know."""
        return Traits()

    @abc.abstractmethod
    def time_scales(self, excitation: Excitation, solver: Solver | None) -> TimeScales:
        """The time scales of the system and of its excitation; `solver`: that of `switched_model`."""

    @abc.abstractmethod
    def sizes(self, excitation: Excitation) -> Sizes:
        """How large what changes in a motion under this excitation is."""

    @property
    def tracks(self) -> Tracks:
        """What its sticks are counted of."""
        return Tracks()

    @property
    def stick_position(self) -> Coordinate:
        """The coordinate recorded as the position of a stick: the first number of the state."""
        first = self.coordinates[0]
        return first._replace(name=f"{first.name} when the stick starts")

    @property
    def redundant(self) -> BoolScalar | None:
        """Whether contacts imply each other, where this was not known when the system was made; else None."""
        return None

    @property
    def static_exceeds_kinetic(self) -> bool:
        """Whether static friction exceeds kinetic friction."""
        return False

    @property
    def recorded(self) -> RecordedForces:
        """Its forces that are piecewise linear in time."""
        return RecordedForces()

    @property
    def natural_frequency(self) -> Scalar | None:
        """The angular frequency of its free vibration, rad/s; None where there is none, or it is not known."""
        return None

    def check_code(self, y0: tuple[Number, ...] | None = None) -> None:
        """Check what the constructor does not check: a user's equations, in the initial state `y0` where one is given.

        Raises ValueError for what does not fit.
        """

    def differs_between(self, y0: InitialState, times: np.ndarray, others: np.ndarray) -> bool:
        """Whether its equations change with time by themselves: they are others at `times` than at `others` (s)."""
        return False

    def check_excitation(self, excitation: Excitation) -> None:
        """Check that `excitation` suits the system. Raises ValueError otherwise."""
        if isinstance(voltage_of(excitation), SourceVoltage):
            raise ValueError(
                f"Argument base of a {type(self).__name__} must be a base motion, but a SourceVoltage was given."
            )

    def check_solver(self, solver: Solver | None) -> None:
        """Check that `solver` can integrate slips, or if None that the closed form holds; else raise ValueError."""

    @property
    def look(self) -> Look:
        """What figures show of it."""
        return Look()


def observed_of(
    masses: Iterable[int | str], contacts: Iterable[int | str], *, rotates: bool = False
) -> tuple[Coordinate, ...]:
    """`System.observed` of `masses` and `contacts` with these numbers; where there is one it has none."""
    rate, unit = ("angular acceleration", "rad/s^2") if rotates else ("acceleration", "m/s^2")

    def named(name: str, number: int | str) -> str:
        return f"{name} {number}".rstrip()

    masses, contacts = tuple(masses), tuple(contacts)
    return (
        *(Coordinate(named(rate, i), unit) for i in masses),
        *(Coordinate(named(f"total {rate}", i), unit) for i in masses),
        *(Coordinate(named("relative velocity", i), "m/s") for i in contacts),
        *(Coordinate(named("friction force", i), "N") for i in contacts),
        Coordinate("base torque", "N m") if rotates else Coordinate("base shear", "N"),
    )


def one_contact_model(system: System, smooth: Signal | None, solver: ExplicitSolver | None) -> Any:
    """The `switched_model` of a system with one contact. Raises ValueError for a system with several."""
    model = system.switched_model(smooth, solver)
    if not (isinstance(model, OneContactModel) or system.traits.jumps_at_places):
        raise ValueError(
            "Argument system must have one contact, with a constant normal force, for energies and friction forces, "
            f"but a {type(system).__name__} with a list of contacts or a normal force that varies was given."
        )
    return model


S = TypeVar("S")


def voltage_of(excitation: Excitation) -> Signal | RandomSignal | None:
    """The smooth part of `excitation` without its random phase."""
    return unphased(excitation.smooth)


def unphased(signal: S) -> S | Signal:
    """`signal` without its random phase, if it is a `RandomPhase` and nothing else of it is random."""
    return cast(RandomPhase, signal).signal if keeps(signal, RandomPhase, "realized") else signal


def shortest_period(excitation: Excitation) -> Scalar | None:
    """The shortest period of the smooth part of `excitation`, s; infinity if there is none, None if it is not known."""
    return float("inf") if excitation.smooth is None else excitation.smooth.shortest_period


def checked_system(system: object) -> System:
    """`system` itself. Raises ValueError for what is no system."""
    if not isinstance(system, System):
        raise checks.refused("system", "be a MassSpring, a MotorCart or a SwitchedSystem of your own", system)
    return system


def require_system(system: object) -> System:
    """`system` itself, checked. Raises ValueError for what is no system, or one with unsuitable numbers."""
    known = checked_system(system)
    known.check_code()
    return known


# Systems with a list of contacts: which of their sticks are counted.


Counted: TypeAlias = int | Literal["all"] | None
"""A contact, by its number from 0; "all": the times in which all contacts that are closed stick; None: every one."""


class _OfCounted(Option):
    def check(self, name: str, value: object) -> None:
        if not (isinstance(value, str) and value == "all"):
            checks.whole_number(name, value, minimum=0)


C = TypeVar("C", bound="WithContacts")


class WithContacts(System):
    """A system that may have a list of contacts, of any number."""

    counted_contact: Annotated[Counted, _OfCounted()] = eqx.field(static=True, default=None, kw_only=True)

    def of_contact(self: C, number: int) -> C:
        """The same system, of which the sticks of one contact are counted, as if it had no others.

        What takes systems with one contact takes it: ensembles, studies, sensitivities, statistics, figures.

        Args:
            number: Of the contact, from 0.

        Raises:
            ValueError: For a system with one contact, and for a number that is not one of its contacts.
        """
        return self._counting(checks.whole_number("number", number, minimum=0, maximum=self._require_contacts() - 1))

    def of_all_contacts(self: C) -> C:
        """The same system, of which the times are counted in which every closed contact sticks.

        The position of such a stick is that of the first coordinate. A time in which no contact is closed is no stick.

        Raises:
            ValueError: For a system with one contact.
        """
        self._require_contacts()
        return self._counting("all")

    @property
    def neighbours(self) -> np.ndarray:
        """Whose slips belong to one event if they overlap in time, (contacts, contacts), true or false: here all."""
        return np.ones((self._require_contacts(),) * 2, bool)

    @property
    def shares_of_base(self) -> np.ndarray:
        """How much of the base's way is in the relative displacement of each contact, (contacts,); not known: zero."""
        return np.zeros(self._require_contacts())

    def _require_contacts(self) -> int:
        if self.tracks.contacts is None:
            raise ValueError(
                f"Argument system must have a list of contacts, but a {type(self).__name__} with one contact was "
                "given: its sticks are counted already."
            )
        return self.tracks.contacts

    def _counting(self: C, counted: Counted) -> C:
        return with_fields(self, type(self), counted_contact=counted)

    @property
    def _counted(self) -> int | None:
        """The number of the track that is counted, see `Tracks`."""
        return -1 if self.counted_contact == "all" else self.counted_contact
