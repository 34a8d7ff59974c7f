"""`calibrate_sticks`: parameters from recordings of sticks."""

import math
import warnings
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float

from .. import _checks
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._ensemble.result import Ensemble
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._sensitivity.call import check_estimator, require_differences
from .._sensitivity.estimate import Estimator
from .._sensitivity.statistic import AnyStatistic
from .._statistics.estimate import Estimate, correlated_estimates
from .._systems.system import System
from .._types import Array, InitialState
from .stick_moments import (
    Observed,
    Recorded,
    check_covariance,
    moments_of,
    observed_ensembles,
    observed_moments,
    without_scatter,
)
from .stick_parameters import Models
from .stick_remarks import remarks_of
from .stick_result import MomentFit, Overidentification, StickCalibration
from .stick_search import Found, Precision, minimised, precision
from .stick_simulation import Simulated, Simulator, key_of
from .stick_weights import Part, by_likelihood, by_moments, covariance_of_misfit, with_products
from .transform import covariance_of

Objective: TypeAlias = Literal["moments", "likelihood"]
_MOST = 60  # iterations


def calibrate_sticks(
    system: System | Sequence[System],
    law: BaseMotion | Sequence[BaseMotion],
    observed: Ensemble | Sequence[Ensemble],
    *,
    wrt: str | tuple[str, ...] | list[str],
    samples: int,
    key: Array | None = None,
    y0: InitialState | None = None,
    moments: AnyStatistic | Sequence[AnyStatistic] | None = None,
    objective: Objective = "moments",
    estimator: Estimator | None = None,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
) -> StickCalibration:
    """The parameters with which simulated sticks are like observed ones, with standard errors.

    By the simulated method of moments (McFadden 1989; Duffie and Singleton 1993): means over simulated realisations
    are brought as close to the means over recordings as their covariance allows. Recordings are independent of each
    other, the sticks of one are not; so all errors come from whole recordings, and those of the simulations are
    included. All simulations use the same random numbers.

    With ``objective="likelihood"`` by the synthetic likelihood (Wood 2010): the moments of each recording are taken to
    be jointly normal with the mean and the covariance of simulated ones. So their scatter counts too, which tells of
    parameters that leave the means alone, and few recordings, even one, suffice. Standard errors do not rest on the
    normal distribution (sandwich).

    Args:
        system: With the starting guesses of the parameters; of several experiments one for all, or a list.
        law: The same of the base.
        observed: Recordings of sticks, an `Ensemble` as `Ensemble.from_sticks` makes it, or a simulated one; or a list,
            one for each experiment, which share the parameters.
        wrt: The names of the parameters, as for `sensitivity`. They stay inside the bounds of
            their fields, positive ones since they are fitted by their logarithms.
        samples: Of each simulation. Take several thousand: with too few, derivatives are noise (a remark says so).
        key: As for `sensitivity`.
        y0: Initial state of all experiments, as for `sensitivity`.
        moments: What is compared: statistics of sticks as `sensitivity` takes them, a list. By default the mean total
            stick time, the mean number of sticks, the mean sum of squared durations, and the mean time to the first
            stick, but for those that are the same in all recordings. The likelihood takes means over all realisations,
            no ratios such as `mean_stick_duration`.
        objective: "moments" or "likelihood".
        estimator: Of the derivatives: "corrected" for sticks that appear and vanish, or "finite-difference" with common
            random numbers over 10 % of each parameter. By default the one with the smaller error in the same time:
            corrected for the total stick time and the number of sticks where closed forms exist.
        method: As in `simulate_ensemble`. `Regularized` takes minutes to hours: a fit simulates dozens of ensembles.
        threads: As in `simulate_ensemble`; the result does not depend on it.

    Returns:
        A `StickCalibration`. Warns (RuntimeWarning) with each of its remarks: of parameters that cannot be told apart
        or have no influence (their error is infinite), of trajectories that did not finish, of derivatives too noisy
        for the samples, and of observations that the model cannot have.

    Raises:
        ValueError: For invalid arguments: recordings without sticks, with realisations that did not finish, or too few
            for the covariance of the moments; fewer moments than parameters; moments that are the same in all
            recordings; first guesses at a bound; and for what `sensitivity` refuses.
    """
    require_threads_of_jax()
    _checks.chosen("objective", objective, get_args(Objective))
    check_estimator(estimator)
    require_differences(estimator, method)
    ensembles = observed_ensembles(observed)
    models = Models.of(system, law, y0, wrt, len(ensembles))
    fit = _Fit(
        models, _observations(ensembles, moments, objective), objective, samples, key, method, threads, estimator
    )
    found = fit.found()
    certain = precision(found.part, found.stands)
    result = fit.result(found, certain)
    for remark in result.remarks:
        warnings.warn(remark, RuntimeWarning, stacklevel=2)
    return result


def _observations(ensembles: list[Ensemble], moments: object, objective: Objective) -> list[Observed]:
    """The moments of each experiment. Raises ValueError for those that cannot be fitted."""
    statistics, found = moments_of(moments), []
    if objective == "likelihood":
        statistics = tuple(map(Recorded, statistics))
    for number, one in enumerate(ensembles):
        seen = observed_moments(statistics, one)
        drops = moments is None and objective == "moments" and seen.recordings > len(statistics)
        fixed = without_scatter(seen) if drops else []
        seen = seen.only([at for at in range(len(statistics)) if at not in fixed])
        name = "observed" if len(ensembles) == 1 else f"observed[{number}]"
        if objective == "moments":
            check_covariance(seen, name)
        elif seen.has_ratios:
            raise ValueError(
                'Argument moments must hold means over all realisations with objective="likelihood", but '
                f"{', '.join(repr(one.name) for one in seen.statistics)} were given, one of which is a ratio of two "
                "means; take both means, such as mean_total_stick_time and mean_stick_count."
            )
        found.append(seen)
    return found


class _Fit:
    """A fit: models, what was observed, and simulations at the parameters that were looked at."""

    def __init__(
        self, models: Models, observations: list[Observed], objective: Objective, samples: int, key: Array | None,
        method: Exact | Regularized, threads: int | None, estimator: Estimator | None,
    ):  # fmt: skip
        self.models, self.observations, self.objective = models, observations, objective
        number, parameters = sum(len(one.mean) for one in observations), len(models.names)
        if objective == "moments" and number < parameters:
            raise ValueError(
                f"Argument moments must hold at least as many moments as there are parameters, {parameters}, but there "
                f"are {number}; take more moments or experiments, or fit fewer parameters."
            )
        products = with_products if objective == "likelihood" else tuple
        self.simulators = [
            Simulator(
                products(one.statistics), one.t1, samples, key_of(key, at), models.names, method, threads, estimator
            )
            for at, one in enumerate(observations)
        ]
        self.simulated: dict[bytes, list[Simulated] | None] = {}
        self.samples = _checks.whole_number("samples", samples, minimum=2, maximum=2**31)

    def at(self, x: Float[np.ndarray, " parameters"]) -> list[Simulated] | None:
        """The simulations at coordinates `x`; None where there are none. Raises ValueError at the first."""
        if x.tobytes() not in self.simulated:
            try:
                self.simulated[x.tobytes()] = self._simulate(x)
            except ValueError:
                if not self.simulated:
                    raise
                self.simulated[x.tobytes()] = None
        return self.simulated[x.tobytes()]

    def _simulate(self, x: Float[np.ndarray, " parameters"]) -> list[Simulated]:
        values = self.models.values(x)
        slopes = self.models.slopes(values)
        found = [one(model).scaled(slopes) for one, model in zip(self.simulators, self.models.at(values), strict=True)]
        everywhere = set.intersection(*(one.products for one in self.simulators))
        if everywhere:
            raise ValueError(
                f"Argument wrt must name parameters that can be told apart, but {min(everywhere)}; fit one."
            )
        for one, seen in zip(found, self.observations, strict=True):
            if not one.is_known:
                raise ValueError(
                    f"The moments or their derivatives do not exist at {self._shown(values)}: there are no sticks, or "
                    "every motion grazes the base velocity; start from other values."
                )
            size = len(seen.mean)
            if self.objective == "likelihood" and np.any(
                np.diag(one.covariance)[:size] <= 1e-24 * one.mean[:size] ** 2
            ):
                raise ValueError(
                    "Argument moments must differ between realisations, but one is the same in all that were simulated "
                    f"at {self._shown(values)}; leave it out."
                )
        return found

    def _shown(self, values: Float[np.ndarray, " parameters"]) -> str:
        return ", ".join(f"{name} = {value:.4g}" for name, value in zip(self.models.names, values, strict=True))

    def part(
        self, x: Float[np.ndarray, " parameters"], covariances: list[Float[np.ndarray, "moments moments"]] | None
    ) -> Part | None:
        """What all experiments add up to at `x`; `covariances` of the misfits, by default from the recordings."""
        simulated = self.at(x)
        if simulated is None:
            return None
        pairs = list(zip(self.observations, simulated, strict=True))
        if self.objective == "likelihood":
            return Part.total([by_likelihood(*pair) for pair in pairs])
        known = covariances or [covariance_of_misfit(*pair) for pair in pairs]
        return Part.total([by_moments(*pair, weight) for pair, weight in zip(pairs, known, strict=True)])

    def covariances(self, x: Float[np.ndarray, " parameters"]) -> list[Float[np.ndarray, "moments moments"]]:
        """Of the misfits, with those of the simulations at `x`."""
        pairs = zip(self.observations, self.at(x) or [], strict=True)
        return [covariance_of_misfit(seen, one, one.covariance_of_one(len(seen.mean))) for seen, one in pairs]

    def found(self) -> Found:
        """The estimate. Of moments, a second search has the weights that the first one's end suggests."""
        start = np.zeros(len(self.models.names))
        first = minimised(lambda x: self.part(x, None), start, _MOST)
        if self.objective == "likelihood":
            return first
        known = self.covariances(first.x)
        return minimised(lambda x: self.part(x, known), first.x, _MOST)

    def result(self, found: Found, certain: Precision) -> StickCalibration:
        """What the user gets."""
        values = self.models.values(found.x)
        slopes = self.models.slopes(values)
        covariance = covariance_of(slopes, certain.covariance, np.isfinite(np.diag(certain.covariance)))
        simulated, models = self.at(found.x) or [], self.models.at(values)
        fits = tuple(
            fit for at, pair in enumerate(zip(self.observations, simulated, strict=True)) for fit in _fits(at, *pair)
        )
        recordings = sum(one.recordings for one in self.observations)
        test, curvature = self._test(found, len(fits)), None
        if self.objective == "likelihood":
            errors = np.sqrt(np.diag(slopes @ np.linalg.pinv(found.part.hessian) @ slopes.T))
            curvature = dict(zip(self.models.names, map(float, errors), strict=True))
        unfinished = sum(one.unfinished for one in simulated)
        return StickCalibration(
            estimates=self._estimates(values, covariance, recordings),
            covariance=covariance,
            objective=self.objective,
            moments=fits,
            overidentification=test,
            curvature_errors=curvature,
            systems=tuple(model.system for model in models),
            laws=tuple(model.law for model in models),
            recordings=recordings,
            samples=self.samples,
            unfinished=unfinished,
            converged=certain.converged,
            evaluations=len(self.simulated),
            remarks=remarks_of(self.models.names, certain, test, unfinished, self.samples * len(simulated)),
        )

    def _test(self, found: Found, moments: int) -> Overidentification | None:
        if self.objective == "likelihood":
            return None
        from scipy import stats  # noqa: PLC0415 - takes long to load

        freedom, statistic = moments - len(self.models.names), 2 * found.part.value
        return Overidentification(
            statistic, freedom, float(stats.chi2.sf(statistic, freedom)) if freedom else math.nan
        )  # fmt: skip

    def _estimates(
        self, values: Float[np.ndarray, " parameters"], covariance: np.ndarray, recordings: int
    ) -> dict[str, Estimate]:
        """The estimates, which know how they are correlated. The likelihood's errors rest on simulations alone."""
        samples = recordings if self.objective == "moments" else self.samples
        found = correlated_estimates(self.models.names, values, self.simulators[0].units, covariance, samples)
        return {one.name: one for one in found}


def _fits(experiment: int, observed: Observed, simulated: Simulated) -> list[MomentFit]:
    """The moments of one experiment, observed and fitted."""
    found: list[MomentFit] = []
    origins: Any = object(), object()
    errors = np.sqrt(np.diag(observed.covariance) / observed.recordings)
    for at, one in enumerate(observed.statistics):
        pair = [(observed.mean[at], errors[at], observed.recordings)]
        pair += [(simulated.mean[at], math.sqrt(simulated.covariance[at, at]), simulated.samples)]
        seen, fitted = (
            Estimate(one.name, float(mean), float(error), one.unit, number, origin)
            for (mean, error, number), origin in zip(pair, origins, strict=True)
        )
        # One recording alone has no scatter: the model's stands for it.
        error = fitted.standard_error * math.sqrt(1 + simulated.samples / observed.recordings)
        if observed.recordings > 1:
            error = math.hypot(seen.standard_error, fitted.standard_error)
        found.append(MomentFit(experiment, seen, fitted, error))
    return found
