"""The parameters of a fit: where they stand in the models of all experiments, and how they are searched."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from .._excitation.excitation import law_of
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Parameter, check_numbers, parameters_of, with_numbers
from .transform import Transform, transform_of

_Vector = Float[np.ndarray, " parameters"]


@dataclasses.dataclass(frozen=True, eq=False)
class Models:
    """The models of all experiments, with the same parameters in each.

    `parameters`: (experiments, parameters); their paths and their values as given. `transform`: their coordinates.
    """

    models: tuple[Model, ...]
    parameters: tuple[tuple[Parameter, ...], ...]
    transform: Transform

    @classmethod
    def of(cls, system: object, law: object, y0: Any, wrt: object, experiments: int) -> "Models":
        """The models, from one system and law, or one for each experiment. Raises ValueError where they do not fit."""
        systems, laws = _for_each("system", system, experiments), _for_each("law", law, experiments)
        models = tuple(Model(one, law_of(two), y0) for one, two in zip(systems, laws, strict=True))
        parameters = tuple(parameters_of(model._asdict(), wrt) for model in models)
        return cls(models, parameters, transform_of(models[0], parameters[0]))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, as given."""
        return tuple(one.name for one in self.parameters[0])

    def values(self, x: _Vector) -> _Vector:
        """The parameters at coordinates `x`."""
        return self.transform.numbers(x)

    def slopes(self, values: _Vector) -> _Vector:
        """The derivatives of the parameters by their coordinates."""
        return self.transform.slopes(values)

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
