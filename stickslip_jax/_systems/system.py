"""What engines, statistics, sensitivities, studies and figures ask of a system."""

import abc
from typing import Any, NamedTuple

import jax.numpy as jnp

from .. import _checks
from .._excitation.excitation import Excitation
from .._excitation.random import RandomPhase
from .._excitation.recorded import Recorded
from .._excitation.smooth import Signal
from .._excitation.voltage import SourceVoltage
from .._fields import Checked
from .._types import AnyArray, Array, Scalar
from .switched_model import SwitchedModel


class Coordinate(NamedTuple):
    """One number of a system's state: what it is, its unit, its symbol in TeX, and after what it repeats itself."""

    name: str
    unit: str
    symbol: str = ""
    period: float | None = None

    @classmethod
    def of(cls, name: str) -> "Coordinate":
        """From ``"position in m"``; without a unit, it has the unit 1."""
        known, _, unit = name.rpartition(" in ")
        return cls(known, unit) if known else cls(name, "1")

    @property
    def meaning(self) -> str:
        """What it is, with its unit: "position in m"."""
        return self.name if self.unit == "1" else f"{self.name} in {self.unit}"

    @property
    def label(self) -> str:
        """For the axis of a figure: "position $x$ (m)"."""
        return self.labelled("")

    def labelled(self, more: str) -> str:
        """The label with something `more` said: "position $x$ where the stick begins (m)"."""
        symbol, unit = f" ${self.symbol}$" if self.symbol else "", f" ({self.unit})" if self.unit != "1" else ""
        return f"{self.name}{symbol}{more}{unit}"


class StepCount(NamedTuple):
    """How many steps to take in a time scale: by default, and at least."""

    default: float
    least: float


# What is smooth has at most two extrema in a sixth of its period, but the sum of two such motions may have more: six
# steps missed a stick in 21 of 270,000 random trajectories of 60 s, eight in 4 of 279,000, ten in none of 288,000. A
# Runge-Kutta step wants more.
PERIOD, SOLVED = StepCount(16.0, 10.0), StepCount(48.0, 12.0)


OWN_TIME = "shortest time of the system"


class TimeScale(NamedTuple):
    """A time (s; None where it is not known) that the steps must be short against."""

    time: Any
    steps: StepCount


class System(Checked):
    """What moves, with one dry-friction contact. Whatever is particular about a system, it knows itself."""

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The numbers of its state. A figure of the plane of motion draws the second against the first."""

    @abc.abstractmethod
    def switched_model(self, smooth: Signal | None, solver: Any) -> SwitchedModel:
        """The system under a realised smooth drive; slips in closed form where there is one and `solver` is None."""

    @abc.abstractmethod
    def time_scales(self, excitation: Excitation, solver: Any) -> dict[str, TimeScale]:
        """Each time scale by name, of the system and of what drives it."""

    @property
    @abc.abstractmethod
    def contact_scales(self) -> tuple[Any, Any]:
        """A velocity (m/s) and a deceleration (m/s^2) typical of its sticks and slips; None where not known.

        The deceleration is that by the largest friction alone.
        """

    def state_scales(self, excitation: Excitation) -> tuple[Any, ...]:
        """The typical size of each number of the state, by which errors are judged where that is small."""
        return (1.0,) * len(self.coordinates)

    @property
    def stick_position(self) -> Coordinate:
        """What is recorded as the position of a stick: the first number of the state."""
        first = self.coordinates[0]
        return first._replace(name=f"{first.name} when the stick starts")

    @property
    def holds_more(self) -> bool:
        """Whether a stick can hold more than a slip meets: static friction above kinetic friction."""
        return False

    @property
    def recorded_loads(self) -> tuple[Recorded, ...]:
        """External forces that come in pieces."""
        return ()

    @property
    def rides_base(self) -> bool:
        """Whether in a stick the first number of its state moves with the base velocity, and the second is that."""
        return False

    @property
    def has_interval_form(self) -> bool:
        """Whether its motion has a closed form from jump to jump of a piecewise-constant base velocity."""
        return False

    @property
    def natural_frequency(self) -> Scalar | None:
        """The angular frequency of its free vibration, rad/s; None where there is none, or it is not known."""
        return None

    def check_numbers(self) -> None:
        """Check what could not be checked when it was made. Raises ValueError otherwise."""

    def check_state(self, y0: tuple[Any, ...]) -> None:
        """Check what it does in the initial state `y0`. Raises ValueError otherwise."""

    def check_excitation(self, excitation: Excitation) -> None:
        """Check that `excitation` can drive it. Raises ValueError otherwise."""
        if isinstance(voltage_of(excitation), SourceVoltage):
            raise ValueError(
                f"Argument base of a {type(self).__name__} must be a base motion, but a SourceVoltage was given."
            )

    def check_solver(self, solver: Any) -> None:
        """Check that slips can be followed by `solver`, or in closed form. Raises ValueError otherwise."""

    # What figures show.

    @property
    def body_name(self) -> str:
        """What its state is that of: "mass", "motor"."""
        return "system"

    @property
    def slip_centre(self) -> Scalar | None:
        """The distance from 0 of the two points about which it slips, on a base without acceleration; None if none."""
        return None

    @property
    def band_coordinate(self) -> int:
        """Which number of the state `stick_band` is about."""
        return 0

    @property
    def band_symbols(self) -> str:
        """The band where it does not change in time, in TeX."""
        return ""

    def stick_band(
        self, times: Array, state: tuple[Array, ...], velocity: Array, acceleration: Array, ground: Any
    ) -> tuple[Array, Array]:
        """Between which values friction can hold at `times` (s), with the velocity (m/s) of the base, its rate, and the
        ground's acceleration (m/s^2); NaN where that is not known.
        """
        return jnp.full_like(times, jnp.nan), jnp.full_like(times, jnp.nan)

    def longest_stick(self, smooth: Signal, position: AnyArray) -> Array | None:
        """The longest that it can stick in each position under this drive, s; None where no closed form is known."""
        return None


def voltage_of(excitation: Excitation) -> Any:
    """The smooth part of `excitation` without its random phase."""
    return excitation.smooth.signal if isinstance(excitation.smooth, RandomPhase) else excitation.smooth


def shortest_period(excitation: Excitation) -> Any:
    """The shortest period of the smooth part of `excitation`, s; infinity if there is none, None if it is not known."""
    smooth = voltage_of(excitation)
    return float("inf") if smooth is None else smooth.shortest_period


def require_system(system: Any) -> System:
    """`system` itself, checked. Raises ValueError otherwise."""
    if not isinstance(system, System):
        raise ValueError(
            "Argument system must be a MassSpring, a MotorCart or a SwitchedSystem of your own, but "
            f"{_checks.show(system)} was given."
        )
    system.check_numbers()
    return system
