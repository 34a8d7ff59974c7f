"""Forecasts of the next stick from the end of the last one: its distribution, its hazard, and how good they are."""

import dataclasses
from collections.abc import Hashable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from .._foundation import checks
from .._numerics.sums import DyadicCounts, PowerSums
from .distribution import BINS, Clusters, Distribution, bin_of
from .estimate import Estimate
from .independence import HypothesisTest, Verdict, check_significance
from .transitions import Columns, TransitionKernel, words

_FEWEST = 50  # transitions that a forecast is made of
_ALIKE = 1e-9  # of the largest number: closer ones are equal
_AT_ONCE = 2**22


class Hazard(NamedTuple):
    """The rate (1/s) at which what lasts ends, given that it has not ended before; in bins of time.

    - `edges`: s, (bins + 1,). `rate` and its standard `error`, 1/s, (bins,); NaN where nothing lasts so long.
    """

    edges: Float[np.ndarray, " edges"]
    rate: Float[np.ndarray, " bins"]
    error: Float[np.ndarray, " bins"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class StickForecast:
    """What follows a state: the result of `forecast`. From the transitions that began closest to it.

    - `after`: "stick" or "slip". `elapsed`: for how long (s) the slip, or stick, after that end has lasted already.
    - `following`: the numbers of these transitions, by name, (transitions,). `owner`: their samples.
      `units`: of the numbers.
    """

    after: str
    elapsed: float
    following: Columns
    units: dict[str, str]
    owner: Int[np.ndarray, " transitions"]
    origin: Hashable

    @property
    def number(self) -> int:
        """From how many transitions the forecast is."""
        return len(self.owner)

    def distribution(self, name: str) -> Distribution:
        """The distribution of one of the numbers that follow: "slip_before" (from the end of the last stick to the
        begin of the next), "position", "duration", "end_position" or "ending"; after a slip "slip_duration" too.

        Raises:
            ValueError: For another name.
        """
        values = self.following[checks.chosen("name", name, self.following)]
        owners, owner = np.unique(self.owner, return_inverse=True)
        clusters = Clusters(values, owner, len(owners), len(owners))
        sums, bins = PowerSums.of(values), DyadicCounts.of(values, BINS)
        name, unit = f"next {words(name)}", self.units[name]
        return Distribution(name, unit, len(owners), sums, bins, clusters, origin=self.origin)

    def hazard(self, bins: int = 30) -> Hazard:
        """The rate at which the next stick begins (after a slip: ends), given that it has not by then.

        Args:
            bins: How many, of equal width, from `elapsed` on.

        Raises:
            ValueError: Unless `bins` is a whole number of at least 1.
        """
        bins = checks.whole_number("bins", bins, maximum=10_000)
        lasts = next(iter(self.following.values()))
        edges = np.linspace(self.elapsed, lasts.max(), bins + 1)
        ended = np.bincount(np.clip(bin_of(lasts, edges), 0, bins - 1), minlength=bins)
        exposed = np.clip(lasts[:, None] - edges[:-1], 0, np.diff(edges)).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return Hazard(edges, ended / exposed, np.sqrt(ended) / exposed)

    def __repr__(self) -> str:
        since = f", {self.elapsed:.6g} s after it" if self.elapsed else ""
        head = f"What follows the end of this {self.after}{since}, from {self.number:,} transitions"
        told = []
        for name in self.following:
            own = self.distribution(name)
            low, high = own.quantile(0.05).value, own.quantile(0.95).value
            told.append(f"  {words(name)}: {own.mean.without_name()}; 90 % from {low:.4g} to {high:.4g}")
        return "\n".join([head, *told])


def forecast(
    kernel: TransitionKernel, state: Mapping[str, float], *, elapsed: float = 0.0, neighbours: int | None = None
) -> StickForecast:
    """What follows, given the state at the end of a stick (or slip), and that nothing has for the time `elapsed`.

    Args:
        kernel: Of `transition_kernel`.
        state: The numbers of ``kernel.given`` by name: ``{"end_position": 0.1, "base_velocity": 1.0, "ending": 1}``.
        elapsed: s, since that end: the slip after a stick (or the stick after a slip) still lasts. Zero or positive.
        neighbours: From how many transitions; by default ``n^0.7`` of the n that there are of such states, which is a
            narrow part of them, at least 50.

    Raises:
        ValueError: For a state with other names or values, and an `elapsed` that fewer than 50 transitions reach.

    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> kernel = ss.transition_kernel(ss.papers.belt_oscillator(), law, transitions=2**14)
    >>> state = {"end_position": 0.1, "base_velocity": 1.0, "ending": ss.Ending.BASE_SWITCHED}
    >>> bool(ss.forecast(kernel, state, elapsed=1.0).distribution("slip_before").smallest > 1.0)
    True
    """
    kernel = _kernel("kernel", kernel)
    checks.bounded("elapsed", elapsed, "s", at_least=0)
    if neighbours is not None:
        neighbours = checks.whole_number("neighbours", neighbours, minimum=_FEWEST)
    lasts = next(iter(kernel.following.values()))
    near = kernel.like(state, neighbours, lasts > elapsed if elapsed else None)
    if len(near) < _FEWEST:
        raise ValueError(
            f"Argument elapsed must be shorter: of the transitions from such states only {len(near)} lasted longer "
            f"than {elapsed} s; simulate more of them, or ask earlier."
        )
    following = {name: column[near] for name, column in kernel.following.items()}
    units = {name: kernel.unit_of(name) for name in following}
    return StickForecast(kernel.after, float(elapsed), following, units, kernel.owner[near], kernel.origin)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ForecastScores:
    """How forecasts by a kernel fared where something else followed: result of `score_forecasts`.

    - `pit`: by name, which share of the forecast was below what followed (the probability integral transform): spread
      evenly over [0, 1] where forecasts are right, (forecasts,).
    - `score`: the continuous ranked probability score of each forecast, in the unit of the number, and `without`, that
      of the distribution over all states, by name, (forecasts,). Both reward honesty; smaller is better.
    - `owner`: the sample of each forecast.
    """

    pit: Columns
    score: Columns
    without: Columns
    owner: Int[np.ndarray, " forecasts"]

    def skill(self, name: str) -> Estimate:
        """By which share knowing the state lessens the mean score: 0 where it tells nothing, 1 where it tells all.

        Raises:
            ValueError: For another name.
        """
        score, without = self.score[checks.chosen("name", name, self.score)], self.without[name]
        owners, owner = np.unique(self.owner, return_inverse=True)
        value = 1 - float(score.mean() / without.mean())
        influence = (without * (1 - value) - score) / without.mean()
        error = Clusters(score, owner, len(owners), len(owners)).error(influence)
        return Estimate(f"skill of forecasts of {words(name)}", value, error, "1", len(owners))

    def calibration(self, significance: float = 0.05) -> Verdict:
        """Test whether the forecasts are right: whether every `pit` is spread evenly (Kolmogorov and Smirnov).

        Forecasts of successive sticks are independent if the state tells all (`TransitionKernel.order_test`). The
        kernel's own errors count against it: take one from ten times as many transitions as there are forecasts.

        Raises:
            ValueError: Unless ``0 < significance < 1``.
        """
        check_significance(significance)
        tests = []
        for name, values in self.pit.items():
            distance, p_value = np.asarray(stats.kstest(values, "uniform"), float).tolist()
            tests.append(HypothesisTest(words(name), distance, p_value, distance, "distance", sizes=(len(values),)))
        question = "Are the forecasts calibrated?"
        return Verdict(question, significance, tuple(tests), len(np.unique(self.owner)), len(self.owner))

    def __repr__(self) -> str:
        lines = [f"{len(self.owner):,} forecasts", *(f"  {self.skill(name)}" for name in self.score)]
        return "\n".join([*lines, repr(self.calibration())])


def score_forecasts(
    kernel: TransitionKernel, record: TransitionKernel, *, neighbours: int = 200, seed: int = 0
) -> ForecastScores:
    """Forecast every stick of a record by a kernel, each from the end of the one before, and compare.

    Args:
        kernel: Of `transition_kernel`, of simulated sticks or by quadrature.
        record: That of other sticks, measured or simulated: ``transition_kernel(ensemble, given=kernel.given)``.
        neighbours: From how many transitions each forecast is.
        seed: Of the random numbers that decide between equal values.

    Raises:
        ValueError: For kernels after different ends or with different `given`, a state of the record that the kernel
            does not know, and fewer than 50 neighbours.
    """
    kernel, record = _kernel("kernel", kernel), _kernel("record", record)
    neighbours = checks.whole_number("neighbours", neighbours, minimum=_FEWEST)
    if (kernel.after, kernel.given) != (record.after, record.given):
        raise checks.refused("record", f"be one after a {kernel.after}, given {', '.join(kernel.given)}", record)
    generator = np.random.default_rng(checks.whole_number("seed", seed, minimum=0))
    found: dict[str, list[Columns]] = {"pit": [], "score": [], "without": []}
    for first in range(0, record.number, step := _AT_ONCE // neighbours):
        part = slice(first, first + step)
        state = {name: column[part] for name, column in record.state.items()}
        near = kernel.nearest(state, neighbours, generator, is_centred=False)
        others = generator.integers(kernel.number, size=near.shape)
        pit, score, without = ({} for _ in found)
        for name, truth in record.following.items():
            # Equal up to round-off is equal: what is certain has no rank.
            like = kernel.following[name]
            grid = _ALIKE * max(float(np.max(np.abs(like))), 1e-300)
            y, x, z = (np.round(values / grid) for values in (truth[part], like[near], like[others]))
            below, equal = np.sum(x < y[:, None], axis=1), np.sum(x == y[:, None], axis=1)
            pit[name] = (below + generator.random(len(y)) * (equal + 1)) / (x.shape[1] + 1)
            score[name], without[name] = grid * _score(x, y), grid * _score(z, y)
        for own, new in zip(found.values(), (pit, score, without), strict=True):
            own.append(new)
    pit, score, without = (
        {name: np.concatenate([one[name] for one in parts]) for name in parts[0]} for parts in found.values()
    )
    return ForecastScores(pit, score, without, record.owner)


def _score(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """``E|X - y| - E|X - X'| / 2`` of the values `x`, (forecasts, values), without bias from their number."""
    k = x.shape[1]
    weights = (2 * np.arange(1, k + 1) - k - 1) / (k * (k - 1))
    return np.abs(x - y[:, None]).mean(axis=1) - np.sort(x, axis=1) @ weights


def _kernel(name: str, given: object) -> TransitionKernel:
    if not isinstance(given, TransitionKernel):
        raise checks.refused(name, "be the result of transition_kernel", given)
    return given
