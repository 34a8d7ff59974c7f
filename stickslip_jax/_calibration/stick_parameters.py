"""The parameters of a fit: where they stand in the models of all experiments, and how they are searched."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from .. import _checks
from .._excitation.excitation import law_of, motion_of
from .._systems.system import checked_system
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Parameter, check_numbers, parameters_of, with_numbers
from .._uncertainty.sampled_law import SampledLaw
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
        models = tuple(checked_model(one, two, y0) for one, two in zip(systems, laws, strict=True))
        parameters = tuple(parameters_of(model._asdict(), wrt) for model in models)
        transform = transform_of(models[0], parameters[0])
        # Its search has no ends: bounds are approached only.
        return cls(models, parameters, transform._replace(closed=np.zeros_like(transform.closed)))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, as given."""
        return tuple(one.name for one in self.parameters[0])

    def values(self, x: _Vector) -> _Vector:
        """The parameters at coordinates `x`."""
        return self.transform.numbers(x)

    def slopes(self, values: _Vector) -> Float[np.ndarray, "parameters coordinates"]:
        """The derivatives of the parameters by the coordinates."""
        return self.transform.slopes(values)

    def at(self, values: _Vector) -> list[Model]:
        """The models with these values. Raises ValueError for values that a constructor refuses."""
        found = []
        for model, parameters in zip(self.models, self.parameters, strict=True):
            new = with_numbers(model, tuple(one.path for one in parameters), [float(value) for value in values])
            check_numbers(new)
            found.append(new)
        return found


def checked_model(system: object, law: Any, y0: Any) -> Model:
    """What is simulated, by kind: its numbers may be random. Raises ValueError for what is no system, law or start."""
    known = law_of(law)
    if not isinstance(known, SampledLaw):
        motion_of(known, "law")
    if y0 is not None and _checks.dimensions(y0) not in (1, 2):
        raise _checks.refused("y0", "be a tuple with the initial value of each coordinate", y0)
    return Model(checked_system(system), known, y0)


def _for_each(name: str, given: object, experiments: int) -> list[Any]:
    several = list(given) if isinstance(given, (list, tuple)) else [given] * experiments
    if len(several) != experiments:
        raise ValueError(
            f"Argument {name} must be one for all, or a list with one for each of the {experiments} ensembles in "
            f"observed, but {len(several)} were given."
        )
    return several
