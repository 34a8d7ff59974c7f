"""Result of one trajectory, the same for every engine: the state along it, and the parts of a `Simulation`."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from ..._events.sticks import Sticks, Totals
from ..._excitation.segments import added
from ..._excitation.smooth import Signal
from ..._excitation.voltage import SourceVoltage
from ..._systems.switched_model import Segments, State
from ..._types import FloatArray, Scalar


class Path(eqx.Module):
    """The state and the base velocity of one trajectory as functions of time."""

    @property
    @abc.abstractmethod
    def times(self) -> Array:
        """The instants at which the steps or intervals of the path begin, s."""

    @abc.abstractmethod
    def state(self, time: FloatArray) -> State:
        """The state at one time (s)."""

    @abc.abstractmethod
    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        """The largest value of `sign` times one number of the state until the time `last` (s), where it is `final`."""

    @property
    @abc.abstractmethod
    def smooth(self) -> Signal | None:
        """The smooth part of the excitation."""

    @abc.abstractmethod
    def segments(self, time: FloatArray) -> Segments:
        """The segments of the piecewise-linear parts of the excitation at one time (s); at a jump, those after it."""

    def base_velocity(self, time: FloatArray) -> FloatArray:
        """The base velocity at one time (s), m/s; 0 where the excitation is only a voltage or a ground acceleration."""
        velocity, _ = added(time, self.segments(time).base)
        if self.smooth is None or isinstance(self.smooth, SourceVoltage):
            return velocity
        return velocity + jnp.asarray(self.smooth.value(time), time.dtype)


class Run(NamedTuple):
    """One trajectory; the fields are those of a `Simulation`."""

    sticks: Sticks
    totals: Totals
    status: Array
    time_reached: Array
    final_state: State
    near_grazing_count: Array
    path: Path
    of_all_contacts: tuple[Sticks, Totals] | None = None
