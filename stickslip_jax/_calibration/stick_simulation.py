"""Simulated moments of stick sequences and their derivatives by parameters, with the errors of both."""

import math
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .._dynamics.common.method import Exact, Regularized
from .._sensitivity import windows
from .._sensitivity.call import cheaper, source_of
from .._sensitivity.chunks import Accumulator, DerivativeColumns, JointAccumulator, Source, run_chunks
from .._sensitivity.differences import differenced
from .._sensitivity.estimate import Estimator
from .._sensitivity.pilot import problem_of, relative_bandwidth_of, require_correctable, require_precision
from .._sensitivity.problem import Pilot, Problem, buffer_sizes_for
from .._sensitivity.products import products_among
from .._sensitivity.sequences import BufferSizes
from .._sensitivity.statistic import StickStatistic
from .._systems.units import unit_at
from .._types import Array, InitialState
from .._uncertainty.inputs import Model

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

    def covariance_of_one(self, moments: int) -> Float[np.ndarray, "moments moments"]:
        """That of one realisation's numbers, of the first `moments`."""
        return self.covariance[:moments, :moments] * self.samples

    @property
    def is_known(self) -> bool:
        """Whether all moments and derivatives are numbers."""
        return bool(np.all(np.isfinite(self.mean)) and np.all(np.isfinite(self.slope)))

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


class Simulator:
    """Simulates the moments of one experiment, at any parameters with the same random numbers.

    - `statistics`, `t1` (s), `samples`, `key`, `wrt`: as for `sensitivity`.
    - `units`: of the parameters, and `products`: sentences about those that act together only, both once it was called.
    - `estimator`: that of the derivatives; by default for each kind of statistic the cheaper one.
    """

    def __init__(
        self, statistics: tuple[StickStatistic, ...], t1: float, samples: int, key: Array | None,
        wrt: tuple[str, ...], method: Exact | Regularized, threads: int | None, estimator: Estimator | None,
    ):  # fmt: skip
        self.statistics, self.t1, self.samples, self.key, self.wrt = statistics, t1, samples, key, wrt
        self.options: dict[str, Any] = {"method": method, "threads": threads}
        self.estimator: Estimator | None = estimator
        self.fewest = BufferSizes(0, 0, 0)
        self.units: tuple[str, ...] = ()
        self.products: set[str] = set()

    def __call__(self, model: Model) -> Simulated:
        """The moments of `model`. Raises ValueError for what `sensitivity` refuses."""
        y0: InitialState | None = model.y0
        problem, pilot = problem_of(
            self.statistics, model.system, model.law, self.wrt, self.t1, self.samples, self.key, y0, **self.options
        )
        pilot = self._with_room(problem, pilot)
        kinds = problem.kinds()
        self.units = tuple(unit_at(problem.model, parameter.path) for parameter in problem.parameters)
        sources = [self._source(kind, pilot, relative_bandwidth_of(problem, pilot)) for kind in kinds]
        accumulated = run_chunks(sources, problem.samples, problem.threads)
        self.products = set(products_among(problem, accumulated))
        order = [one for kind in kinds for one in kind.statistics]
        return _simulated(accumulated, [order.index(one) for one in self.statistics], len(self.wrt), self.samples)

    def _source(self, kind: Problem, pilot: Pilot, widest: float) -> Source:
        """How the moments of one kind, and their derivatives, are found."""
        if (self.estimator or cheaper(kind)) == "finite-difference":
            return differenced(kind, pilot, np.array([max(widest, _STEP)]), with_pathwise=False)
        kind = kind.in_closed_form()
        require_precision(kind)
        require_correctable(kind)
        return source_of(kind, pilot, widest)

    def _with_room(self, problem: Problem, pilot: Pilot) -> Pilot:
        """The pilot, with buffers of a size that suffices nearby too: each size is compiled anew."""
        if pilot.most is None or problem.needs_ensembles:
            return pilot
        needed = buffer_sizes_for(problem, pilot)
        if any(size > room for size, room in zip(needed, self.fewest, strict=True)):
            self.fewest = BufferSizes(*(2 ** math.ceil(math.log2(1.2 * size + 1)) for size in needed))
        return pilot._replace(fewest=self.fewest)


def key_of(key: Array | None, experiment: int) -> Array | None:
    """The key of an experiment: its simulations are independent of those of the others."""
    return key if key is None or experiment == 0 else jax.random.fold_in(key, experiment)


def _simulated(accumulated: JointAccumulator, order: list[int], parameters: int, asked: int) -> Simulated:
    """The moments in this order, their derivatives, and the covariance of all (delta method)."""
    means, slopes, of_means, of_slopes = [], [], [], []
    for number in order:
        one, own = accumulated.single(number), accumulated.slice_of(number)

        def placed(weights: tuple[np.ndarray, np.ndarray], own: slice = own) -> list[np.ndarray]:
            whole = [np.zeros(len(half.mean)) for half in accumulated.halves]
            for all_columns, mine in zip(whole, weights, strict=True):
                all_columns[own] = mine
            return whole

        moments = one.moments
        above, below = moments.mean[:2]
        mean, weight = math.nan, np.zeros(len(moments.mean))
        if moments.number and below > 0:
            mean = above / below
            weight[:2] = 1 / below, -mean / below
        share = one.halves[0].number / max(moments.number, 1)
        means.append(mean)
        of_means.append(placed((share * weight, (1 - share) * weight)))
        for columns, in_window in zip(one.columns, one.in_window, strict=True):
            found, influence = _derivative(one, columns, in_window)
            slopes.append(found)
            of_slopes.append(placed(influence))
    size, error = len(of_means) + len(of_slopes), 0.0
    for half, sums in enumerate(accumulated.halves):
        of = np.array([weights[half] for weights in (*of_means, *of_slopes)])
        error = error + of @ sums.covariance_of_mean @ of.T
    finished = sum(half.number for half in accumulated.halves)
    slope = np.reshape(slopes, (len(order), parameters))
    return Simulated(np.array(means), slope, np.reshape(error, (size, size)), finished, asked - finished)


def _derivative(
    one: Accumulator, columns: DerivativeColumns, in_window: np.ndarray
) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
    """A derivative and its own derivatives by the means of the columns in both halves (0 where not known)."""
    found, _ = windows.estimate(one, columns, in_window, None)
    first, second = windows.influence(one, columns, in_window, None)
    return found.derivative, (np.nan_to_num(first), np.nan_to_num(second))
