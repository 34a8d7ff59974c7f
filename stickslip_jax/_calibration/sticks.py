"""`calibrate_sticks`: parameters from recordings of sticks."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._ensemble.ensemble import Ensemble
from .._excitation.excitation import BaseMotion
from .._foundation import checks, html
from .._foundation.types import InitialState
from .._sensitivity.call import check_estimator, require_differences
from .._sensitivity.estimate import Estimator
from .._sensitivity.statistic import AnyStatistic
from .._statistics.estimate import Estimate, correlated_estimates
from .._systems.system import System, unit_at
from .parameters import Models, covariance_of
from .stick_moments import Experiments, FitPart, Simulator, covariance_of_misfit, observations_of, with_products

# The search for the parameters of a fit, by SciPy's trust region, and how well they are determined.


_Vector = Float[np.ndarray, " parameters"]
_Square = Float[np.ndarray, "parameters parameters"]

_ENOUGH = 1e-3  # what the best step would still gain, in squared standard errors: it is a thirtieth of one
_CONVERGED = 0.1  # the same; where no step gains anything 1, as errors of derivatives make it look
_STANDS, _GAINED = 5, 0.005
"""A search ends after so many iterations in a row without gain: simulated means have small jumps."""
_INFLUENCE = 4.0  # times what noise alone would be
_EXACT = 1e-10  # relative, as round-off leaves it where derivatives are proportional
_INVOLVED = 0.1


class SearchEnd(NamedTuple):
    """Where a search ended: coordinates, what was found there, and whether it ended because no step gains anything."""

    x: _Vector
    part: FitPart
    stands: bool


def minimised(at: Callable[[_Vector], FitPart], x: _Vector, most: int) -> SearchEnd:
    """The minimum near `x` of what `at` returns, which finds what it returned before again.

    `most`: iterations. The trust region is in coordinates, that of logarithms for most parameters.
    """
    from scipy import optimize  # noqa: PLC0415 - takes long to load

    stands, last = 0, np.inf

    def stop(intermediate_result: Any) -> None:
        nonlocal stands, last
        now = at(np.asarray(intermediate_result.x))
        stands = 0 if now.value < last - _GAINED else stands + 1
        last = min(last, now.value)
        if stands >= _STANDS or gain(now) < _ENOUGH:
            raise StopIteration

    if gain(at(x)) >= _ENOUGH:
        found = optimize.minimize(
            lambda x: at(x).value, x, jac=lambda x: at(x).gradient, hess=lambda x: at(x).hessian,
            method="trust-exact", callback=stop,
            options={"initial_trust_radius": 0.5, "max_trust_radius": 2.0, "maxiter": most, "gtol": 0.0},
        )  # fmt: skip
        x = np.asarray(found.x)
    return SearchEnd(x, at(x), stands >= _STANDS)


def gain(part: FitPart) -> float:
    """What the step of Gauss and Newton would gain, in squared standard errors."""
    step = np.linalg.lstsq(part.hessian, part.gradient, rcond=_EXACT)[0]
    return float(step @ part.gradient)


class Precision(NamedTuple):
    """How well a fit determines coordinates.

    - `covariance`: infinite for those that are not determined.
    - `lost`: for each combination of coordinates that is not determined, which of them it holds.
    - `converged`: whether the best step would gain nothing in the directions that are determined.
    - `noise_share`: how much of the information is noise of the derivatives, in the worst determined direction.
    """

    covariance: _Square
    lost: tuple[Bool[np.ndarray, " parameters"], ...]
    converged: bool
    noise_share: float


def precision(part: FitPart, stands: bool = False) -> Precision:
    """The covariance of the minimum, by the sandwich: the errors of derivatives add no information.

    `stands`: as in `SearchEnd`.
    """
    from scipy import linalg  # noqa: PLC0415 - takes long to load

    size = np.sqrt(np.maximum(np.diag(part.hessian), np.finfo(float).tiny))
    scale = np.outer(size, size)
    whole, noise, scores = part.hessian / scale, part.noise / scale, part.scores / scale
    floor = noise + _EXACT * np.eye(len(size))
    ratios, directions = linalg.eigh(whole, floor)
    directions = directions / np.linalg.norm(directions, axis=0)
    kept = directions[:, ratios > _INFLUENCE]
    lost = tuple(np.abs(one) > _INVOLVED for one in directions[:, ratios <= _INFLUENCE].T)
    inner = np.linalg.inv(kept.T @ (whole - noise) @ kept) if kept.size else np.zeros((0, 0))
    bread = kept @ inner @ kept.T
    left = kept.T @ (part.gradient / size)
    still = float(np.sum(left**2 / np.sum(kept * (whole @ kept), axis=0)))
    is_told = ~np.any(np.reshape(lost, (len(lost), len(size))), axis=0)
    covariance = covariance_of(np.eye(len(size)), bread @ scores @ bread / scale, is_told)
    return Precision(covariance, lost, still < (1 if stands else _CONVERGED), float(1 / max(ratios[0], 1.0)))


# The result of `calibrate_sticks`.


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
        lines += [f"  {self._where(one)}{one}" for one in self.moments]
        return "\n".join([*lines, *self.remarks])

    def _where(self, one: MomentFit) -> str:
        return f"experiment {one.experiment}, " if len(self.systems) > 1 else ""

    def _repr_html_(self) -> str:
        rows = [(name, one.without_name().replace("+-", "±")) for name, one in self.estimates.items()]
        for one in self.moments:
            rows.append((f"{self._where(one)}{one.observed.name}", f"misfit of {one.residual:+.1f} standard errors"))
        test = self.overidentification
        if test is not None and test.degrees_of_freedom:
            rows.append(("Hansen's test", f"p = {test.p_value:.3g}"))
        rows += [("remark", remark) for remark in self.remarks]
        return html.titled(f"Calibration to {self.recordings:,} recordings of sticks") + html.table(rows)


# Sentences about what a calibration does not tell.


_NOISY = 0.2  # share of the information
_WRONG = 1e-3  # p-value


def remarks_of(
    names: tuple[str, ...], certain: Precision, test: Overidentification | None,
    unfinished: int, simulated: int,
) -> tuple[str, ...]:  # fmt: skip
    """The remarks, those that matter most first."""
    said = []
    if not certain.converged:
        said.append(
            "The search has not found the minimum: the estimates are where it ended; start from other values, or with "
            "more samples."
        )
    for involved in certain.lost:
        lost = [name for name, is_in in zip(names, involved, strict=True) if is_in]
        if len(lost) == 1:
            said.append(
                f"{lost[0]} has no influence on these moments that these simulations could show, so that its error is "
                "infinite: take more samples, or give it a known value, or other moments or experiments that depend on "
                "it."
            )
        else:
            said.append(
                f"{' and '.join(lost)} cannot be told apart by these moments, as far as these simulations could show: "
                "other values of all of them fit as well, so that their errors are infinite; take more samples, or one "
                "of them must be known, or further moments or experiments tell."
            )
    if not certain.lost and certain.noise_share > _NOISY:
        more = math.ceil(certain.noise_share / (0.1 * (1 - certain.noise_share)))
        said.append(
            f"{certain.noise_share:.0%} of what the derivatives seem to tell is their own error, which makes the "
            f"estimates less certain; take {more} times as many samples."
        )
    if test is not None and test.p_value < _WRONG:
        said.append(
            f"The model cannot have all moments at once (Hansen's test: p = {test.p_value:.2g}): something "
            "in it is not as in the recordings, and standard errors are those of a right model."
        )
    if unfinished:
        said.append(
            f"{unfinished} of {simulated} simulated trajectories did not finish, and are left out of all means."
        )
    return tuple(said)


# `calibrate_sticks`: parameters from recordings of sticks.


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
        law: The random excitation, with starting guesses too; one for all experiments, or a list.
        observed: Recordings of sticks, an `Ensemble` as `Ensemble.from_sticks` makes it, or a simulated one; or a list,
            one for each experiment, which share the parameters.
        wrt: The names of the parameters, numbers of system, law or `y0` such as "mu", "rate" or "y0[0]". They stay
            inside the bounds of their fields, positive ones since they are fitted by their logarithms.
        samples: Of each simulation. Take several thousand: with too few, derivatives are noise (a remark says so).
        key: Of the simulations, from ``jax.random.key(seed)``.
        y0: Initial state of all experiments, numbers or distributions; zeros by default.
        moments: What is compared: a list of statistics of sticks that `sensitivity` takes. By default the mean total
            stick time, the mean number of sticks, the mean sum of squared durations, and the mean time to the first
            stick, but for those that are the same in all recordings. The likelihood takes means over all realisations,
            no ratios such as `mean_stick_duration`.
        objective: "moments" or "likelihood".
        estimator: Of the derivatives: "corrected" for sticks that appear and vanish, or "finite-difference" with common
            random numbers over 10 % of each parameter. By default the one with the smaller error in the same time:
            corrected for the total stick time and the number of sticks where closed forms exist.
        method: `Exact` or `Regularized`, which takes minutes to hours: a fit simulates dozens of ensembles.
        threads: Worker threads (default: all cores); the result does not depend on it.

    Returns:
        A `StickCalibration`. Warns (RuntimeWarning) with each of its remarks: of parameters that cannot be told apart
        or have no influence (their error is infinite), of trajectories that did not finish, of derivatives too noisy
        for the samples, and of observations that the model cannot have.

    Raises:
        ValueError: For invalid arguments: recordings without sticks, with realisations that did not finish, or too few
            for the covariance of the moments; fewer moments than parameters; moments that are the same in all
            recordings; first guesses at a bound; and for what `sensitivity` refuses.
    """
    checks.require_threads_of_jax()
    checks.chosen("objective", objective, get_args(Objective))
    check_estimator(estimator)
    require_differences(estimator, method)
    is_likelihood = objective == "likelihood"
    observations = observations_of(observed, moments, is_likelihood)
    models = Models.of(system, law, y0, wrt, len(observations))
    number, parameters = sum(len(one.mean) for one in observations), len(models.names)
    if not is_likelihood and number < parameters:
        raise ValueError(
            f"Argument moments must hold at least as many moments as there are parameters, {parameters}, but there "
            f"are {number}; take more moments or experiments, or fit fewer parameters."
        )
    samples, simulators = checks.whole_number("samples", samples, minimum=2, maximum=2**31), []
    for at, one in enumerate(observations):
        own = with_products(one.statistics) if is_likelihood else one.statistics
        # Simulations of an experiment are independent of those of the others.
        of_experiment = key if key is None or at == 0 else jax.random.fold_in(key, at)
        simulators.append(Simulator(own, one.t1, samples, of_experiment, models.names, method, threads, estimator))
    result = result_of(Experiments(models, observations, simulators, is_likelihood))
    for remark in result.remarks:
        checks.warn(remark)
    return result


def result_of(fit: Experiments) -> StickCalibration:
    """The estimate. Of moments, a second search has the weights that the first one's end suggests."""
    models, transform, recordings = fit.models, fit.models.transform, sum(o.recordings for o in fit.observations)
    found = minimised(fit.part, np.zeros(len(models.names)), _MOST)
    if not fit.is_likelihood:
        # Of the misfits, with those of the simulations where the first search ended.
        known = [covariance_of_misfit(seen, one, one.covariance * one.samples) for seen, one in fit.pairs(found.x)]
        found = minimised(lambda x: fit.part(x, known), found.x, _MOST)
    certain = precision(found.part, found.stands)
    values = transform.numbers(found.x)
    slopes = transform.slopes(values)
    covariance = covariance_of(slopes, certain.covariance, np.isfinite(np.diag(certain.covariance)))
    fits = []
    for experiment, (observed, simulated) in enumerate(fit.pairs(found.x)):
        names, units = zip(*((one.name, one.unit) for one in observed.statistics), strict=True)
        number, recorded = len(names), observed.covariance / observed.recordings
        seen = correlated_estimates(names, observed.mean, units, recorded, observed.recordings)
        within = simulated.covariance[:number, :number]
        fitted = correlated_estimates(names, simulated.mean[:number], units, within, simulated.samples)
        for one, other in zip(seen, fitted, strict=True):
            # One recording alone has no scatter: the model's stands for it.
            error = other.standard_error * math.sqrt(1 + simulated.samples / observed.recordings)
            if observed.recordings > 1:
                error = math.hypot(one.standard_error, other.standard_error)
            fits.append(MomentFit(experiment, one, other, error))
    test = curvature = None
    if fit.is_likelihood:
        errors = np.sqrt(np.diag(slopes @ np.linalg.pinv(found.part.hessian) @ slopes.T))
        curvature = dict(zip(models.names, errors.tolist(), strict=True))
    else:
        from scipy import stats  # noqa: PLC0415 - takes long to load

        freedom, statistic = len(fits) - len(models.names), 2 * found.part.value
        p_value = float(stats.chi2.sf(statistic, freedom)) if freedom else math.nan
        test = Overidentification(statistic, freedom, p_value)
    # The errors of the likelihood rest on simulations alone.
    samples = fit.simulators[0].samples
    units = [unit_at(models.models[0], parameter.path) for parameter in models.parameters[0]]
    size = samples if fit.is_likelihood else recordings
    estimates = correlated_estimates(models.names, values, units, covariance, size)
    unfinished, ends = sum(simulated.unfinished for _, simulated in fit.pairs(found.x)), models.at(values)
    return StickCalibration(
        estimates={one.name: one for one in estimates},
        covariance=covariance,
        objective="likelihood" if fit.is_likelihood else "moments",
        moments=tuple(fits),
        overidentification=test,
        curvature_errors=curvature,
        systems=tuple(model.system for model in ends),
        laws=tuple(model.law for model in ends),
        recordings=recordings,
        samples=samples,
        unfinished=unfinished,
        converged=certain.converged,
        evaluations=len(fit.simulated),
        remarks=remarks_of(models.names, certain, test, unfinished, samples * len(fit.simulators)),
    )
