"""The state along one trajectory, whichever engine followed it: what a `Simulation` is made of."""

import abc
from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array

from .._events.sticks import Sticks, Totals
from .._systems.switched_model import State
from .._types import FloatArray


class Path(eqx.Module):
    """What is needed to tell the state at any time."""

    @property
    @abc.abstractmethod
    def times(self) -> Array:
        """When the pieces of the path begin, s."""

    @abc.abstractmethod
    def state(self, time: FloatArray) -> State:
        """The state at one time (s)."""

    @abc.abstractmethod
    def base_velocity(self, time: FloatArray) -> FloatArray:
        """The base velocity at one time (s), m/s."""


class Run(NamedTuple):
    """One trajectory, as a `Simulation` names its parts."""

    sticks: Sticks
    totals: Totals
    status: Array
    time_reached: Array
    final_state: State
    near_grazing_count: Array
    path: Path
