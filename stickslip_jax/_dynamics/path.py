"""Result of one trajectory, the same for every engine: the state along it, and the parts of a `Simulation`."""

import abc
from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array

from .._events.sticks import Sticks, Totals
from .._systems.switched_model import State
from .._types import FloatArray


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
    def base_velocity(self, time: FloatArray) -> FloatArray:
        """The base velocity at one time (s), m/s."""


class Run(NamedTuple):
    """One trajectory; the fields are those of a `Simulation`."""

    sticks: Sticks
    totals: Totals
    status: Array
    time_reached: Array
    final_state: State
    near_grazing_count: Array
    path: Path
