"""The result of `calibrate_sticks`."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .. import _html
from .._statistics.estimate import Estimate
from .._systems.system import System


class MomentFit(NamedTuple):
    """A moment of one experiment, as observed and as the fitted model has it.

    Attributes:
        experiment: Its number in `observed`, from 0.
        observed: The mean over recordings, with its standard error.
        fitted: The mean over simulated realisations, with its standard error.
        error: The standard error of their difference.
    """

    experiment: int
    observed: Estimate
    fitted: Estimate
    error: float

    @property
    def residual(self) -> float:
        """The difference in standard errors."""
        return (self.observed.value - self.fitted.value) / self.error

    def __str__(self) -> str:
        return (
            f"{self.observed.name}: {self.observed.without_name()}, fitted {self.fitted.without_name()}, "
            f"z = {self.residual:+.1f}"
        )


class Overidentification(NamedTuple):
    """Hansen's test (1982) of whether the model can have all observed moments at once.

    Attributes:
        statistic: The smallest weighted sum of squares of the misfits.
        degrees_of_freedom: Those of its chi-squared distribution, moments less parameters; 0: nothing to test.
        p_value: The probability of a larger statistic if the model is right; NaN without degrees of freedom.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class StickCalibration(Mapping[str, Estimate]):
    """Parameters that fit observed sticks, with their errors: a mapping from name to `Estimate`.

    The estimates can be computed with; how they are correlated is known to them.

    - `covariance`: of the estimates, in their units and order, (parameters, parameters). `correlation` follows.
    - `objective`: "moments" or "likelihood".
    - `moments`: each moment as observed and as fitted, `MomentFit`.
    - `overidentification`: Hansen's test; None for the likelihood.
    - `curvature_errors`: standard errors by the curvature of the likelihood alone, by name: right if the numbers of a
      recording are jointly normal and simulations have no errors; None for moments.
    - `systems`, `laws`: of each experiment, with the estimates in place of the guesses; `system` and `law` the first.
    - `recordings`: of all experiments. `samples`: of each simulation. `unfinished`: how many of the simulated
      trajectories did not finish, in the last simulations.
    - `converged`: whether the minimum was found. `evaluations`: how often all experiments were simulated.
    - `remarks`: sentences about what the result does not tell, such as parameters that cannot be told apart.
    """

    estimates: Mapping[str, Estimate]
    covariance: Float[np.ndarray, "parameters parameters"]
    objective: str
    moments: tuple[MomentFit, ...]
    overidentification: Overidentification | None
    curvature_errors: Mapping[str, float] | None
    systems: tuple[System, ...]
    laws: tuple[Any, ...]
    recordings: int
    samples: int
    unfinished: int
    converged: bool
    evaluations: int
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Estimate:
        return self.estimates[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.estimates)

    def __len__(self) -> int:
        return len(self.estimates)

    @property
    def correlation(self) -> Float[np.ndarray, "parameters parameters"]:
        """Of the estimates; NaN where one is not determined."""
        spread = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(spread, spread)

    @property
    def system(self) -> System:
        """The system of the first experiment with the estimates in place of the guesses."""
        return self.systems[0]

    @property
    def law(self) -> Any:
        """The law of the first experiment with the estimates in place of the guesses."""
        return self.laws[0]

    def __repr__(self) -> str:
        test = self.overidentification
        lines = [str(one) for one in self.estimates.values()]
        if test is not None and test.degrees_of_freedom:
            lines.append(
                f"Hansen's test: {test.statistic:.3g} with {test.degrees_of_freedom} degrees of freedom, "
                f"p = {test.p_value:.3g}"
            )
        several = len(self.systems) > 1
        lines += [f"  {f'experiment {one.experiment}, ' if several else ''}{one}" for one in self.moments]
        return "\n".join([*lines, *self.remarks])

    def _repr_html_(self) -> str:
        rows = [(name, one.without_name().replace("+-", "±")) for name, one in self.estimates.items()]
        several = len(self.systems) > 1
        for one in self.moments:
            where = f"experiment {one.experiment}, " if several else ""
            rows.append((f"{where}{one.observed.name}", f"misfit of {one.residual:+.1f} standard errors"))
        test = self.overidentification
        if test is not None and test.degrees_of_freedom:
            rows.append(("Hansen's test", f"p = {test.p_value:.3g}"))
        rows += [("remark", remark) for remark in self.remarks]
        return _html.titled(f"Calibration to {self.recordings:,} recordings of sticks") + _html.table(rows)
