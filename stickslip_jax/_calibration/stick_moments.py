"""Moments of stick sequences: which, what was observed of them, how a model has them, and how both are weighed."""

import dataclasses
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from .._dynamics.common.method import Exact, Regularized
from .._ensemble.ensemble import Ensemble
from .._foundation import checks
from .._foundation.processes import as_many_as_fit
from .._foundation.types import InitialState, Scalar, Status
from .._sensitivity import estimate
from .._sensitivity.call import cheaper, products_among, source_of
from .._sensitivity.estimate import Estimator
from .._sensitivity.estimators import Accumulator, differenced, parts_of_sequences, run_chunks
from .._sensitivity.problem import buffer_sizes_for, problem_of, relative_bandwidth_of, require_correctable
from .._sensitivity.statistic import (
    BufferSizes,
    OfOutput,
    OfTotals,
    StickSequence,
    StickStatistic,
    SumOfSquaredDurations,
    TimeToFirstStick,
    statistics_of,
)
from .._statistics.totals import mean_stick_count, mean_total_stick_time
from .._uncertainty.inputs import StochasticModel
from .parameters import Models

# Moments of stick sequences: which, what was observed of them, and how the observed ones scatter.


_ROUND_OFF = 1e-12
_DEPENDENT = 1e-9  # smallest eigenvalue of the correlations of moments that do not determine each other


@dataclasses.dataclass(frozen=True)
class Product(StickStatistic):
    """The mean over realisations of the product of two numbers whose means are statistics."""

    name: str
    unit: str
    one: StickStatistic
    other: StickStatistic

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        (a, _), (b, one) = self.one.parts(sticks, t1), self.other.parts(sticks, t1)
        return a * b, one


@dataclasses.dataclass(frozen=True)
class FromRecordedSticks(StickStatistic):
    """A statistic found from recorded sticks, where it could be found from totals too: in the same way as others."""

    name: str
    unit: str
    of: StickStatistic

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        return self.of.parts(sticks, t1)


DEFAULT = (mean_total_stick_time, mean_stick_count, SumOfSquaredDurations(), TimeToFirstStick())


class Observed(NamedTuple):
    """The moments of one experiment: means over its recordings, and the covariance of one recording's numbers.

    - `mean`: (moments,). `covariance`: (moments, moments), between recordings; NaN for one recording.
    - `values`: (recordings, moments), each recording's numbers: of a ratio of means, to first order (delta method).
    - `t1`: s. `has_ratios`: whether one is a ratio of two means.
    """

    statistics: tuple[StickStatistic, ...]
    mean: Float[np.ndarray, " moments"]
    covariance: Float[np.ndarray, "moments moments"]
    values: Float[np.ndarray, "recordings moments"]
    t1: float
    has_ratios: bool

    @property
    def recordings(self) -> int:
        """Their number."""
        return len(self.values)


def moments_of(moments: object) -> tuple[StickStatistic, ...]:
    """`moments` as statistics. Raises ValueError for what is no list of statistics of sticks."""
    several: Any = DEFAULT if moments is None else moments
    if not isinstance(several, (list, tuple)):
        several = [several]
    try:
        found = statistics_of(tuple(several))
    except ValueError as error:
        raise ValueError(str(error).replace("Argument statistic", "Argument moments", 1)) from error
    for one in found:
        if isinstance(one, OfOutput) or (isinstance(one, OfTotals) and one.counts_slips):
            demand = "hold statistics of sticks, of which recordings of sticks tell"
            hint = "of slips take a StickFunctional of what lies between the sticks"
            raise checks.refused("moments", demand, one.name, hint)
    return found


def observations_of(observed: object, moments: object, is_likelihood: bool) -> list[Observed]:
    """What the ensemble of each experiment says of the moments. Raises ValueError for anything else, and where nothing
    can be learned.
    """
    statistics, found = moments_of(moments), []
    if is_likelihood:
        statistics = tuple(FromRecordedSticks(one.name, one.unit, one) for one in statistics)
    several = list(observed) if isinstance(observed, (list, tuple)) else [observed]
    if not several:
        raise checks.refused("observed", "be an Ensemble or a list of them, at least one", observed)
    for number, one in enumerate(several):
        name = "observed" if len(several) == 1 else f"observed[{number}]"
        recordings = checked_recordings(name, one)
        seen = observed_moments(statistics, recordings)
        if is_likelihood and seen.has_ratios:
            raise ValueError(
                'Argument moments must hold means over all realisations with objective="likelihood", but '
                f"{', '.join(repr(one.name) for one in seen.statistics)} were given, one of which is a ratio of two "
                "means; take both means, such as mean_total_stick_time and mean_stick_count."
            )
        if not is_likelihood:
            fixed = without_scatter(seen)
            if moments is None and fixed and seen.recordings > len(statistics):
                seen = observed_moments(tuple(one for one in statistics if one not in fixed), recordings)
            check_covariance(seen, name)
        found.append(seen)
    return found


def checked_recordings(name: str, one: object) -> Ensemble:
    """The ensemble of an experiment, the argument `name`. Raises ValueError for anything else, and for one without
    sticks of all its recordings.
    """
    if not isinstance(one, Ensemble):
        raise checks.refused(name, "be an Ensemble, as Ensemble.from_sticks makes one of measured sticks", one)
    if unfinished := sum(count for status, count in one.status_counts.items() if status != Status.FINISHED):
        raise ValueError(
            f"Argument {name} must hold realisations that reached t1, but {unfinished} of {one.samples} did not; "
            "leave these out."
        )
    if one.flat_sticks is None:
        raise ValueError(
            f"Argument {name} must hold every stick, but this ensemble did not keep them; simulate it with "
            'keep="sticks".'
        )
    if not len(one.flat_sticks.start):
        raise ValueError(
            f"Argument {name} must hold sticks, but its {one.samples} recordings have none: nothing of sticks can "
            "be fitted to them."
        )
    return one


def observed_moments(statistics: tuple[StickStatistic, ...], ensemble: Ensemble) -> Observed:
    """What `ensemble` says of the moments. Raises ValueError where a moment is defined for no recording."""
    sticks, t1 = ensemble.require_sticks(), float(ensemble.t1)
    means, values, has_ratios = [], [], False
    for one in statistics:
        above, below = parts_of_sequences(one, sticks, t1, np.float64).T
        if not below.mean() > 0:
            raise ValueError(
                f"Argument moments must be defined for some of the recordings, but {one.name!r} is for none of these "
                f"{ensemble.samples}."
            )
        has_ratios |= bool(np.any(below != 1))
        means.append(above.mean() / below.mean())
        values.append(means[-1] + (above - means[-1] * below) / below.mean())
    table, number = np.stack(values, axis=-1), len(values[0])
    covariance = np.atleast_2d(np.cov(table.T)) if number > 1 else np.full((len(statistics),) * 2, np.nan)
    return Observed(statistics, np.array(means), covariance, table, t1, has_ratios)


def without_scatter(observed: Observed) -> list[StickStatistic]:
    """The moments that have the same value in all recordings."""
    is_fixed = np.ptp(observed.values, axis=0) <= _ROUND_OFF * np.abs(observed.mean)
    return [one for one, fixed in zip(observed.statistics, is_fixed, strict=True) if fixed]


def check_covariance(observed: Observed, name: str) -> None:
    """Raise ValueError unless the recordings determine a covariance of the moments that can be inverted."""
    moments = len(observed.statistics)
    if observed.recordings < moments + 2:
        raise ValueError(
            f"Argument {name} must hold at least {moments + 2} recordings for the covariance of {moments} moments, but "
            f"it holds {observed.recordings}; take fewer moments, or objective='likelihood', which has the model's."
        )
    if fixed := without_scatter(observed):
        raise ValueError(
            f"Argument moments must differ between recordings, but {fixed[0].name!r} is the same "
            f"in all of {name}; leave it out."
        )
    spread = np.sqrt(np.diag(observed.covariance))
    if np.linalg.eigvalsh(observed.covariance / np.outer(spread, spread))[0] < _DEPENDENT:
        names = ", ".join(repr(one.name) for one in observed.statistics)
        raise ValueError(
            f"Argument moments must not determine each other, but in {name} one of {names} follows from the others; "
            "leave it out."
        )


# Simulated moments of stick sequences and their derivatives by parameters, with the errors of both.


_STEP = 0.1
"""Half the width of central differences, relative to the parameter. A fit needs derivatives with little noise: what is
noise in them passes for information. Their bias, of the order of the squared step, only shifts weights."""


class Simulated(NamedTuple):
    """Moments from simulated realisations at some parameters.

    - `mean`: (moments,). `slope`: their derivatives, (moments, parameters).
    - `error`: the covariance of `mean` and, behind it, of `slope` row by row.
    - `samples`: how many realisations finished. `unfinished`: how many did not.
    """

    mean: Float[np.ndarray, " moments"]
    slope: Float[np.ndarray, "moments parameters"]
    error: Float[np.ndarray, "columns columns"]
    samples: int
    unfinished: int

    @property
    def covariance(self) -> Float[np.ndarray, "moments moments"]:
        """That of the mean."""
        return self.error[: len(self.mean), : len(self.mean)]

    def scaled(self, by: Float[np.ndarray, "parameters coordinates"]) -> "Simulated":
        """With derivatives by coordinates; `by`: those of the parameters by the coordinates."""
        moments = len(self.mean)
        factor = np.zeros_like(self.error)
        factor[:moments, :moments] = np.eye(moments)
        factor[moments:, moments:] = np.kron(np.eye(moments), by.T)
        return self._replace(slope=self.slope @ by, error=factor @ self.error @ factor.T)

    def noise(self, weight: Float[np.ndarray, "moments moments"]) -> Float[np.ndarray, "parameters parameters"]:
        """What the errors of the derivatives alone add to ``slope' weight slope``, on average."""
        moments, parameters = self.slope.shape
        of_slopes = self.error[moments:, moments:].reshape(moments, parameters, moments, parameters)
        return np.einsum("ij,iajb->ab", weight, np.nan_to_num(of_slopes))


@dataclasses.dataclass(eq=False)
class Simulator:
    """Simulates the moments of one experiment, at any parameters with the same random numbers.

    - `statistics`, `t1` (s), `samples`, `key`, `wrt`, `method`, `threads`: as for `sensitivity`.
    - `estimator`: that of the derivatives; None: for each kind of statistic the cheaper one.
    - `products`: sentences about parameters that act together only, once it was called.
    - `fewest`: what buffers hold at least, so that their size suffices nearby too: each size is compiled anew.
    """

    statistics: tuple[StickStatistic, ...]
    t1: float
    samples: int
    key: Array | None
    wrt: tuple[str, ...]
    method: Exact | Regularized
    threads: int | None
    estimator: Estimator | None
    products: frozenset[str] = frozenset()
    fewest: tuple[int, ...] = (0, 0, 0)

    def __call__(self, model: StochasticModel) -> Simulated:
        """The moments of `model`. Raises ValueError for what `sensitivity` refuses."""
        y0: InitialState | None = model.y0
        problem, pilot = problem_of(
            self.statistics, model.system, model.law, self.wrt, self.t1, self.samples, self.key, y0,
            method=self.method, threads=self.threads,
        )  # fmt: skip
        if not (pilot.most is None or problem.needs_ensembles):
            needed = buffer_sizes_for(problem, pilot)
            if any(size > room for size, room in zip(needed, self.fewest, strict=True)):
                self.fewest = tuple(2 ** math.ceil(math.log2(1.2 * size + 1)) for size in needed)
            pilot = pilot._replace(fewest=BufferSizes(*self.fewest))
        kinds, widest = problem.kinds(), relative_bandwidth_of(problem, pilot)

        def of_lanes(lanes: int) -> Accumulator:
            sources = []
            for kind in (one.of_lanes(lanes) for one in kinds):
                if (self.estimator or cheaper(kind)) == "finite-difference":
                    sources.append(differenced(kind, pilot, np.array([max(widest, _STEP)]), with_pathwise=False))
                else:
                    closed = kind.in_closed_form()
                    require_correctable(closed)
                    sources.append(source_of(closed, pilot, widest))
            return run_chunks(sources, problem.samples, problem.threads)

        accumulated = as_many_as_fit(of_lanes, problem.lanes)
        self.products = frozenset(products_among(problem, accumulated))

        # The moments, their derivatives, and the covariance of all (delta method): `influence` holds, for each half of
        # the samples, the derivatives of means and then of slopes by the means of all columns.
        order = [one for kind in kinds for one in kind.statistics]
        moments, parameters = len(order), len(self.wrt)
        mean, slope = np.full(moments, math.nan), np.empty((moments, parameters))
        influence = [np.zeros((moments * (1 + parameters), len(half.mean))) for half in accumulated.halves]
        for row, statistic in enumerate(self.statistics):
            place = order.index(statistic)
            whole = accumulated.single(place, 0).moments
            above, below = whole.mean[:2]
            if whole.number and below > 0:
                mean[row] = above / below
                share = accumulated.halves[0].number / max(whole.number, 1)
                for half, part in zip(influence, (share, 1 - share), strict=True):
                    half[row, accumulated.columns(place, 0)[:2]] = part / below, -part * mean[row] / below
            for at in range(parameters):
                found, _, influences = estimate.estimate_by_windows(accumulated.single(place, at), None)
                own = accumulated.columns(place, at)
                slope[row, at] = found.derivative
                for half, by_half in zip(influence, influences, strict=True):
                    half[moments + row * parameters + at, own] = np.nan_to_num(by_half)
        errors = [of @ half.covariance_of_mean @ of.T for of, half in zip(influence, accumulated.halves, strict=True)]
        finished = sum(half.number for half in accumulated.halves)
        return Simulated(mean, slope, errors[0] + errors[1], finished, self.samples - finished)


# Weights of the misfits of moments: from the recordings' covariance, or from the model (synthetic likelihood).
#
# Both methods compare means over recordings with simulated means. Near the estimate either is a sum of squares of the
# misfits: of moments weighted by the inverse of their covariance (Hansen 1982), or of means and mean products weighted
# by their Fisher information, if a recording's numbers were jointly normal.


_Vector = Float[np.ndarray, " parameters"]
_Square = Float[np.ndarray, "parameters parameters"]


class FitPart(NamedTuple):
    """What one experiment, or several, add to a fit.

    - `value`: half of the weighted sum of squares, or the negative logarithm of the likelihood but for a constant.
    - `gradient`, `hessian`: its derivatives by the parameters; the second by Gauss and Newton.
    - `noise`: what errors of the simulated derivatives add to `hessian`, on average.
    - `scores`: the covariance of `gradient`, from recordings and simulations.
    """

    value: float
    gradient: _Vector
    hessian: _Square
    noise: _Square
    scores: _Square

    @classmethod
    def nothing(cls, parameters: int) -> "FitPart":
        """Where there is no model: no minimum is there, and a search goes back."""
        none = np.zeros((parameters, parameters))
        return cls(np.inf, none[0], np.eye(parameters), none, none)

    @classmethod
    def total(cls, parts: "list[FitPart]") -> "FitPart":
        """The sum of independent parts."""
        return cls(*(sum(each) for each in zip(*parts, strict=True)))  # pyright: ignore[reportArgumentType]


def covariance_of_misfit(
    observed: Observed, simulated: Simulated, of_simulation: Float[np.ndarray, "moments moments"] | None = None
) -> Float[np.ndarray, "moments moments"]:
    """The covariance of the difference of observed and simulated means.

    `of_simulation`: that of one realisation's numbers; by default those of the recordings.
    """
    per_sample = observed.covariance if of_simulation is None else of_simulation
    return observed.covariance / observed.recordings + per_sample / simulated.samples


def by_moments(observed: Observed, simulated: Simulated, covariance: Float[np.ndarray, "moments moments"]) -> FitPart:
    """The weighted sum of squares of an experiment; `covariance` is that of the misfit."""
    weight = np.linalg.inv(covariance)
    misfit = observed.mean - simulated.mean
    weighted = simulated.slope.T @ weight
    hessian = weighted @ simulated.slope
    return FitPart(
        0.5 * float(misfit @ weight @ misfit), -weighted @ misfit, hessian, simulated.noise(weight), hessian
    )  # fmt: skip


def with_products(statistics: tuple[StickStatistic, ...]) -> tuple[StickStatistic, ...]:
    """The statistics and behind them their products with themselves and each other, as the normal likelihood needs."""
    pairs = itertools.combinations_with_replacement(statistics, 2)
    products = [Product(f"{one.name} * {other.name}", f"{one.unit} * {other.unit}", one, other) for one, other in pairs]
    return (*statistics, *products)


def by_likelihood(observed: Observed, simulated: Simulated) -> FitPart:
    """The synthetic likelihood (Wood 2010) of an experiment: a recording's numbers are taken to be jointly normal.

    `simulated` holds means of the numbers and of their products. With their deviations from the simulated means, in
    units of the simulated standard deviations, the normal distribution has means and covariances as independent
    parameters, whose Fisher information is in closed form. The covariance of the score is that of the simulated numbers
    themselves, so that errors are right for others than normal numbers too.
    """
    number, recordings = observed.values.shape[1], observed.recordings
    one, other = np.triu_indices(number)
    mean = simulated.mean[:number]
    covariance = np.zeros((number, number))
    covariance[one, other] = covariance[other, one] = simulated.mean[number:] - mean[one] * mean[other]
    spread = np.sqrt(np.diag(covariance))
    # Makes deviations of means and mean products those of standardised numbers, to first order.
    units, rows, corner = np.eye(number), spread[one] * spread[other], np.zeros((number, len(one)))
    by_means = -(units[one] * mean[other, None] + units[other] * mean[one, None]) / rows[:, None]
    to_standard = np.block([[np.diag(1 / spread), corner], [by_means, np.diag(1 / rows)]])
    deviations = (observed.values - mean) / spread
    correlation = covariance / np.outer(spread, spread)
    seen = deviations.T @ deviations / recordings
    inverse = np.linalg.inv(correlation)
    # The Fisher information of a standardised normal distribution about its means and its covariances.
    products = correlation[np.ix_(one, one)] * correlation[np.ix_(other, other)]
    products += correlation[np.ix_(one, other)] * correlation[np.ix_(other, one)]
    information = np.block([[inverse, corner], [corner.T, np.linalg.inv(products)]])
    misfit = np.concatenate([deviations.mean(axis=0), (seen - correlation)[one, other]])
    slope = to_standard @ simulated.slope
    weighted = recordings * slope.T @ information
    hessian = weighted @ slope
    of_means = to_standard @ simulated.covariance @ to_standard.T * (1 + simulated.samples / recordings)
    value = np.linalg.slogdet(correlation)[1] + 2 * math.fsum(np.log(spread)) + float(np.sum(inverse * seen))
    noise = simulated.noise(recordings * to_standard.T @ information @ to_standard)
    return FitPart(0.5 * recordings * value, -weighted @ misfit, hessian, noise, weighted @ of_means @ weighted.T)


# All experiments of a fit together.


@dataclasses.dataclass(eq=False)
class Experiments:
    """A fit: models, what was observed, and simulations at the parameters that were looked at."""

    models: Models
    observations: list[Observed]
    simulators: list[Simulator]
    is_likelihood: bool
    simulated: dict[bytes, list[Simulated] | None] = dataclasses.field(default_factory=dict)

    def at(self, x: _Vector) -> list[Simulated] | None:
        """The simulations at coordinates `x`; None where there are none. Raises ValueError at the first."""
        if x.tobytes() not in self.simulated:
            try:
                self.simulated[x.tobytes()] = self._simulate(x)
            except ValueError:
                if not self.simulated:
                    raise
                self.simulated[x.tobytes()] = None
        return self.simulated[x.tobytes()]

    def _simulate(self, x: _Vector) -> list[Simulated]:
        values = self.models.transform.numbers(x)
        slopes = self.models.transform.slopes(values)
        found = [one(model).scaled(slopes) for one, model in zip(self.simulators, self.models.at(values), strict=True)]
        if everywhere := frozenset.intersection(*(one.products for one in self.simulators)):
            raise ValueError(
                f"Argument wrt must name parameters that can be told apart, but {min(everywhere)}; fit one."
            )
        shown = ", ".join(f"{name} = {value:.4g}" for name, value in zip(self.models.names, values, strict=True))
        for one, seen in zip(found, self.observations, strict=True):
            if not (np.all(np.isfinite(one.mean)) and np.all(np.isfinite(one.slope))):
                raise ValueError(
                    f"The moments or their derivatives do not exist at {shown}: there are no sticks, or every motion "
                    "grazes the base velocity; start from other values."
                )
            size = len(seen.mean)
            if self.is_likelihood and np.any(np.diag(one.covariance)[:size] <= 1e-24 * one.mean[:size] ** 2):
                raise ValueError(
                    "Argument moments must differ between realisations, but one is the same in all that were simulated "
                    f"at {shown}; leave it out."
                )
        return found

    def pairs(self, x: _Vector) -> list[tuple[Observed, Simulated]]:
        """What was observed and simulated in each experiment, at coordinates `x` that have been simulated."""
        return list(zip(self.observations, self.at(x) or [], strict=True))

    def part(self, x: _Vector, covariances: list[Float[np.ndarray, "moments moments"]] | None = None) -> FitPart:
        """What all experiments add up to at `x`; `covariances` of the misfits, by default from the recordings."""
        if self.at(x) is None:
            return FitPart.nothing(len(x))
        if self.is_likelihood:
            return FitPart.total([by_likelihood(*pair) for pair in self.pairs(x)])
        known = covariances or [covariance_of_misfit(*pair) for pair in self.pairs(x)]
        return FitPart.total([by_moments(*pair, weight) for pair, weight in zip(self.pairs(x), known, strict=True)])
