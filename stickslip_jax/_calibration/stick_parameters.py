"""The parameters of a fit: where they stand in the models of all experiments, and coordinates without bounds."""

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .. import _checks
from .._excitation.excitation import law_of
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Parameter, check_numbers, parameters_of, quantity_at, with_numbers

_Vector = Float[np.ndarray, " parameters"]


class Coordinate(NamedTuple):
    """A parameter as a function of a number without bounds that is 0 at its starting guess.

    Bounded on one side, it is the bound plus or minus an exponential; on both, a logistic function; else linear.
    """

    name: str
    start: float
    low: float
    high: float

    def value(self, x: float) -> float:
        """The parameter."""
        if math.isinf(self.low) and math.isinf(self.high):
            return self.start + self._unit * x
        if math.isinf(self.high):
            return self.low + (self.start - self.low) * math.exp(x)
        if math.isinf(self.low):
            return self.high - (self.high - self.start) * math.exp(-x)
        odds = (self.start - self.low) / (self.high - self.start) * math.exp(x)
        return self.low + (self.high - self.low) * odds / (1 + odds)

    def slope(self, value: float) -> float:
        """The derivative of the parameter, where it has this value."""
        if math.isinf(self.low) and math.isinf(self.high):
            return self._unit
        if math.isinf(self.high):
            return value - self.low
        if math.isinf(self.low):
            return self.high - value
        return (value - self.low) * (self.high - value) / (self.high - self.low)

    @property
    def _unit(self) -> float:
        return abs(self.start) or 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Models:
    """The models of all experiments, with the same parameters in each.

    `parameters`: (experiments, parameters); their paths and their values as given. `coordinates`: of each parameter.
    """

    models: tuple[Model, ...]
    parameters: tuple[tuple[Parameter, ...], ...]
    coordinates: tuple[Coordinate, ...]

    @classmethod
    def of(cls, system: object, law: object, y0: Any, wrt: object, experiments: int) -> "Models":
        """The models, from one system and law, or one for each experiment. Raises ValueError where they do not fit."""
        systems, laws = _for_each("system", system, experiments), _for_each("law", law, experiments)
        models = tuple(Model(one, law_of(two), y0) for one, two in zip(systems, laws, strict=True))
        parameters = tuple(parameters_of(model._asdict(), wrt) for model in models)
        first = [_coordinate(models[0], parameter) for parameter in parameters[0]]
        return cls(models, parameters, tuple(first))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, as given."""
        return tuple(one.name for one in self.coordinates)

    def values(self, x: _Vector) -> _Vector:
        """The parameters at coordinates `x`."""
        return np.array([one.value(float(at)) for one, at in zip(self.coordinates, x, strict=True)])

    def slopes(self, values: _Vector) -> _Vector:
        """The derivatives of the parameters by their coordinates."""
        return np.array([one.slope(float(at)) for one, at in zip(self.coordinates, values, strict=True)])

    def at(self, values: _Vector) -> list[Model]:
        """The models with these values. Raises ValueError for values that a constructor refuses."""
        found = []
        for model, parameters in zip(self.models, self.parameters, strict=True):
            new = with_numbers(model, tuple(one.path for one in parameters), [float(value) for value in values])
            check_numbers(new)
            found.append(new)
        return found


def _for_each(name: str, given: object, experiments: int) -> list[Any]:
    several = list(given) if isinstance(given, (list, tuple)) else [given] * experiments
    if len(several) != experiments:
        raise ValueError(
            f"Argument {name} must be one for all, or a list with one for each of the {experiments} ensembles in "
            f"observed, but {len(several)} were given."
        )
    return several


def _coordinate(model: Model, parameter: Parameter) -> Coordinate:
    about = quantity_at(model, parameter.path)
    lows = [float(one) for one in (about.above, about.at_least) if one is not None]
    low, high = max(lows, default=-math.inf), math.inf if about.below is None else float(about.below)
    if not low < parameter.value < high:
        raise _checks.refused(
            "wrt", f"name numbers whose starting guess lies inside their bounds, above {low:g}"
            + ("" if math.isinf(high) else f" and below {high:g}"), f"{parameter.name} = {parameter.value:g}",
        )  # fmt: skip
    return Coordinate(parameter.name, parameter.value, low, high)
