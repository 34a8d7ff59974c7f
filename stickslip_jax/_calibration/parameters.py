"""The parameters of a fit: numbers with bounds as functions of the coordinates in which they are searched, and
where they stand in the models of all experiments.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._excitation.excitation import law_of, motion_of
from .._foundation import checks
from .._foundation.types import AnyArray, DType
from .._systems.friction import FrictionCurve
from .._systems.system import checked_system
from .._uncertainty.inputs import SampledLaw, StochasticModel
from .._uncertainty.numbers import Parameter, check_numbers, number_at, parameters_of, quantity_at, with_numbers

# Numbers with bounds as functions of the coordinates in which they are searched.


_TURN = math.log(10)  # a number with a bound that it may have is searched linearly below a tenth of its first guess


class Transform(NamedTuple):
    """How numbers follow from coordinates that are 0 at their first guesses.

    A number with one bound is the bound plus or minus an exponential function (a positive one is searched by its
    logarithm), one with two bounds a logistic function, any other one linear, in units of `scale`. A bound that the
    number may have is `closed`, and reached: from a tenth of the first guess on the way there is linear, and the
    coordinate ends there (`box`); between two bounds it is linear everywhere.

    `start`, `low`, `high`: first guesses and bounds, infinite where there are none; `closed`: 1 where these may be
    reached; `scale`: of what has no bounds; each (parameters,). `added`: which numbers are counted from which other
    ones (static from kinetic friction), 0 and 1, (parameters, parameters); `start` and bounds are of the difference.
    """

    start: AnyArray
    low: AnyArray
    high: AnyArray
    closed: AnyArray
    scale: AnyArray
    added: AnyArray

    def numbers(self, x: AnyArray) -> Any:
        """The numbers at the coordinates `x`, (parameters,): NumPy's at those of NumPy, else JAX's."""
        own = self.own(x)
        return own + (np if isinstance(own, np.ndarray) else jnp).asarray(self.added) @ own

    def own(self, x: AnyArray) -> Any:
        """The numbers, or how far they are above those that they are counted from, as `numbers`."""
        xp = np if isinstance(x, np.ndarray) else jnp
        start, low, high, has_low, has_high, closed, scale = self._finite(xp)
        is_bounded, turns = has_low | has_high, closed & has_low & ~has_high & (x < -_TURN)
        # A `where` around each exponential too, so that what is not selected has finite derivatives.
        growth = xp.exp(xp.where(is_bounded & ~turns, xp.where(has_high, -x, x), 0))
        growth = xp.where(turns, (1 + _TURN + x) / 10, growth)
        between = low + (high - low) / (1 + (high - start) / (start - low) * growth)
        one_bound = xp.where(has_low, low + (start - low) * growth, high - (high - start) * growth)
        bounded = xp.where(has_low & has_high, between, one_bound)
        return xp.where(is_bounded & ~(closed & has_low & has_high), bounded, start + scale * x)

    def slopes(self, numbers: np.ndarray) -> np.ndarray:
        """The derivatives of the numbers by the coordinates, where they have these values, (parameters, parameters)."""
        start, low, high, has_low, has_high, closed, scale = self._finite(np)
        added = np.asarray(self.added)
        own = numbers - added @ numbers  # none is counted from one that is itself counted from another
        both = (own - low) * (high - own) / (high - low)
        one_bound = np.where(has_low, np.maximum(own - low, closed * (start - low) / 10), high - own)
        bounded = np.where(has_low & has_high, np.where(closed, scale, both), one_bound)
        return (np.eye(len(own)) + added) * np.where(has_low | has_high, bounded, scale)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the coordinates end, (parameters,) each; infinite for bounds that are only approached."""
        start, low, high, has_low, has_high, closed, scale = self._finite(np)
        at_low = np.where(has_high, (low - start) / scale, -_TURN - 1)
        return (
            np.where(closed & has_low, at_low, -np.inf),
            np.where(closed & has_high, (high - start) / scale, np.inf),
        )

    def _finite(self, xp: Any) -> tuple[Any, ...]:
        """First guesses, bounds, with others in place of those that do not exist, which of these do, which are closed,
        and scales.
        """
        start, low, high, closed, scale = map(xp.asarray, self[:5])
        has_low, has_high = xp.isfinite(low), xp.isfinite(high)
        finite_low, finite_high = xp.where(has_low, low, start - 1), xp.where(has_high, high, start + 1)
        return start, finite_low, finite_high, has_low, has_high, closed > 0, scale


def covariance_of(slopes: np.ndarray, covariance: np.ndarray, is_told: np.ndarray) -> np.ndarray:
    """The covariance of numbers from that of what is searched, with their derivatives by it, `slopes`; the variance of
    numbers that depend on what is not told is infinite.
    """
    found = slopes @ np.where(is_told[:, None] & is_told, covariance, 0) @ slopes.T
    lost = np.any((slopes != 0) & ~is_told, axis=1)
    found[lost] = found[:, lost] = np.nan
    found[lost, lost] = np.inf
    return found


def transform_of(tree: Any, parameters: tuple[Parameter, ...]) -> Transform:
    """That of the `parameters`, numbers of `tree`. Raises ValueError for a first guess at a bound."""
    places = {parameter.path: i for i, parameter in enumerate(parameters)}
    start = np.array([parameter.value for parameter in parameters], float)
    bounds, added = np.empty((len(start), 2)), np.zeros((len(start), len(start)))
    closed = np.zeros(len(start))
    for i, parameter in enumerate(parameters):
        about, (*place, field) = quantity_at(tree, parameter.path), parameter.path
        low = max((float(one) for one in (about.above, about.at_least) if one is not None), default=-math.inf)
        high = math.inf if about.below is None else float(about.below)
        counted_from = 0.0
        if field == "mu_static":
            law = number_at(tree, tuple(place))
            # Static friction is never below kinetic friction, where that is a number of its own.
            if hasattr(law, "mu") or isinstance(law, FrictionCurve):
                kinetic = float(law.curve(jnp.zeros(())) if isinstance(law, FrictionCurve) else law.mu)
                low = max(low, kinetic)
                if (*place, "mu") in places:
                    added[i, places[*place, "mu"]] = 1
                    counted_from = kinetic
        elif field == "mu" and (*place, "mu_static") not in places:
            static = getattr(number_at(tree, tuple(place)), "mu_static", None)
            high = high if static is None else min(high, float(static))
        if not low < parameter.value < high:
            words = [f"{word} {one:g}" for word, one in (("above", low), ("below", high)) if math.isfinite(one)]
            raise ValueError(
                f"Argument wrt must name numbers whose first guess lies inside their bounds, {' and '.join(words)}, "
                f"but {parameter.name} = {parameter.value:g} was given; a search that begins at a bound cannot leave "
                "it: begin a little inside."
            )
        start[i] -= counted_from
        bounds[i] = low - counted_from, high - counted_from
        closed[i] = about.above is None and about.below is None
    low, high = bounds.T
    has_both = np.isfinite(low) & np.isfinite(high)
    scale = np.where(has_both, high - low, np.where(start == 0, 1, np.abs(start)))
    return Transform(start, low, high, closed, scale, added)


def identity(number: int, dtype: DType) -> Transform:
    """That of so many numbers without bounds, which are their own coordinates."""
    none, one = jnp.zeros(number, dtype), jnp.ones(number, dtype)
    return Transform(none, none - jnp.inf, none + jnp.inf, none, one, jnp.zeros((number, number), dtype))


# The parameters of a fit: where they stand in the models of all experiments, and how they are searched.


@dataclasses.dataclass(frozen=True, eq=False)
class Models:
    """The models of all experiments, with the same parameters in each.

    `parameters`: (experiments, parameters); their paths and their values as given. `transform`: their coordinates.
    """

    models: tuple[StochasticModel, ...]
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

    def at(self, values: Float[np.ndarray, " parameters"]) -> list[StochasticModel]:
        """The models with these values. Raises ValueError for values that a constructor refuses."""
        found = []
        for model, parameters in zip(self.models, self.parameters, strict=True):
            new = with_numbers(model, tuple(one.path for one in parameters), [float(value) for value in values])
            check_numbers(new)
            found.append(new)
        return found


def checked_model(system: object, law: Any, y0: Any) -> StochasticModel:
    """What is simulated, by kind: its numbers may be random. Raises ValueError for what is no system, law or start."""
    known = law_of(law)
    if not isinstance(known, SampledLaw):
        motion_of(known, "law")
    if y0 is not None and checks.dimensions(y0) not in (1, 2):
        raise checks.refused("y0", "be a tuple with the initial value of each coordinate", y0)
    return StochasticModel(checked_system(system), known, y0)


def _for_each(name: str, given: object, experiments: int) -> list[Any]:
    several = list(given) if isinstance(given, (list, tuple)) else [given] * experiments
    if len(several) != experiments:
        raise ValueError(
            f"Argument {name} must be one for all, or a list with one for each of the {experiments} ensembles in "
            f"observed, but {len(several)} were given."
        )
    return several
