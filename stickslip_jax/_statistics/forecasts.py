"""Forecasts of the next stick from the end of the last one: its distribution, its hazard, and how good they are; and
catalogues of events, in which many contacts slip together.
"""

import dataclasses
from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse, stats
from scipy.sparse import csgraph

from .._dynamics.simulation import Simulation
from .._dynamics.sticks import FlatSticks
from .._excitation.excitation import way_of_base
from .._foundation import checks
from .._foundation.types import Status
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


# Catalogues: an event is a connected slip, as an earthquake is.
#
# Slips of contacts that are neighbours belong to one event if they overlap in time, and so do those that belong to the
# event of a third: events are the connected components of that graph. Slips far apart at the same time are two events.


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Catalogue:
    """The events of a system with several contacts: the result of `catalogue`. In order of sample and begin.

    - `sample`: in which each happened, from 0. `begin`, `duration`: s. `size`: how many contacts slipped. `moment`: the
      sum of what they slipped, and `largest`, the most that one of them did, m: of a structure relative to the base, or
      to the other mass; of a system of your own by the position of sticks. All (events,). Seismic moments, in N m, are
      in proportion to it, which only shifts magnitudes.
    - `t1`: s. `samples`: how many motions. `contacts`: how many each has. `left_out`: how many events were left out
      because the begin or the end of a motion cuts a slip in them.
    """

    sample: Int[np.ndarray, " events"]
    begin: Float[np.ndarray, " events"]
    duration: Float[np.ndarray, " events"]
    size: Int[np.ndarray, " events"]
    moment: Float[np.ndarray, " events"]
    largest: Float[np.ndarray, " events"]
    t1: float
    samples: int
    contacts: int
    left_out: int

    @property
    def magnitude(self) -> Float[np.ndarray, " events"]:
        """The decimal logarithm of each moment in m."""
        return np.log10(self.moment)

    def slope(self, least: float) -> Estimate:
        """The Gutenberg-Richter slope b: the number of moments above M is proportional to ``M^-b``.

        By maximum likelihood from the moments of at least `least`, as if events were independent: ``b = log10(e) /
        (mean magnitude - that of least)``, with the standard error ``b / sqrt(events)`` (Aki 1965, Bull. Earthq. Res.
        Inst. 43, 237; Utsu 1965). The slope for the magnitudes of Hanks and Kanamori, 2/3 of the logarithm, is 1.5
        times as large. Large events of another law shift it little where they are few.

        Args:
            least: The moment (m) from which on the catalogue is complete and follows the law, positive.

        Raises:
            ValueError: For another number.
        """
        checks.positive("least", least, "m")
        excess = np.log(self.moment[self.moment >= least] / least)
        name, number, mean = "Gutenberg-Richter slope b", len(excess), float(np.sum(excess)) / max(len(excess), 1)
        b = 1 / mean if mean > 0 else np.nan
        return Estimate(name, b, b / max(number, 1) ** 0.5, "1", number)

    def frequencies(self, bins: int = 10) -> dict[str, np.ndarray]:
        """How many events there are by magnitude, in bins of equal width: columns of a table.

        Args:
            bins: Their number.

        Returns:
            By name, (bins,): `magnitude`, where each bin begins; `events` in it; and `at_least`, those from there on.
        """
        counts, edges = np.histogram(self.magnitude, checks.whole_number("bins", bins, maximum=10**6))
        return {"magnitude": edges[:-1], "events": counts, "at_least": np.cumsum(counts[::-1])[::-1]}

    def __repr__(self) -> str:
        cut = f"{self.left_out} cut by begin or end left out"
        return f"{len(self.begin)} events of {self.contacts} contacts in {self.samples} x {self.t1:g} s, {cut}"


def catalogue(source: Any) -> Catalogue:
    """The catalogue of events: times in which neighbouring contacts slip together, as the blocks of a train do.

    Slips belong to one event if they overlap in time, of the same or of neighbouring contacts: of a `LinearStructure`,
    of the same masses or of masses that a spring joins (``structure.neighbours``); of a system of your own, of any.

    Args:
        source: A `Simulation` with a list of contacts, or the result of `simulate_contacts` with ``keep="sticks"``, of
            which the samples that finished count.

    Returns:
        A `Catalogue`.

    Raises:
        ValueError: For anything else.

    >>> law = ss.Coulomb(0.4, mu_static=0.5)
    >>> row = ss.block_row(
    ...     5, mass=1.0, between=9.0, to_ground=1.0, normal_force=1.0, friction=law
    ... )
    >>> y0 = (0.0, 0.1, 0.3, 0.2, 0.1) + (0.02,) * 5
    >>> one = ss.simulate(row, ss.Constant(0.02), t1=60.0, y0=y0)
    >>> print(ss.catalogue(one))
    6 events of 5 contacts in 1 x 60 s, 2 cut by begin or end left out
    """
    if getattr(getattr(source, "sticks", None), "contact", None) is not None:  # of a Simulation of several
        source._require_numbers("catalogue")
        sticks, t1, realizations = source.sticks, float(source.time_reached), [(source.system, source.base)]
        mask = np.asarray(sticks.mask)
        contact, start, end, moved = (
            np.asarray(column)[mask] for column in (sticks.contact, sticks.start, sticks.end, sticks.slip_displacement)
        )
        sample = np.zeros_like(contact)
    elif hasattr(source, "of_all_contacts") and not isinstance(source, Simulation):
        flat, t1 = [source.of_contact(number).flat_sticks for number in range(source.contacts)], source.t1
        if flat[0] is None or source.status_counts[Status.FINISHED] < source.samples:
            wanted = 'be from simulate_contacts(..., keep="sticks"), and all its samples finish'
            raise checks.refused("source", wanted, source)
        contact = np.repeat(np.arange(len(flat)), [len(of.start) for of in flat])
        sample, sticks = np.concatenate([of.sample for of in flat]), FlatSticks.joined(flat)
        start, end, moved = sticks.start, sticks.end, sticks.slip_displacement
        realizations = [source.realization(number)[:2] for number in range(source.samples)]
    else:
        raise checks.refused("source", "be a Simulation of several contacts, or from simulate_contacts", source)
    neighbours, samples = source.system.neighbours, len(realizations)
    contacts = len(neighbours)

    # Slips lie between two sticks of one contact in one sample, or between a stick and the begin or end of the motion.
    tracks = np.arange(samples * contacts)
    ends, cut = np.repeat([0.0, t1], len(tracks)), np.repeat([False, True], [len(start), 2 * len(tracks)])
    track = np.concatenate([sample * contacts + contact, tracks, tracks])
    start, end, moved = (np.concatenate(both) for both in ((start, ends), (end, ends), (moved, 0 * ends)))
    order = np.lexsort((end, start, track))
    track, start, end, moved, cut = (column[order] for column in (track, start, end, moved, cut))
    slips = (track[1:] == track[:-1]) & (start[1:] > end[:-1])
    track, begin, end, moved, cut = (
        column[slips] for column in (track[1:], end[:-1], start[1:], moved[1:], cut[1:] | cut[:-1])
    )
    places = np.searchsorted(track, np.append(tracks, len(tracks)))
    for number, (system, base) in enumerate(realizations):
        own = slice(places[number * contacts], places[(number + 1) * contacts])
        moved[own] -= system.shares_of_base[track[own] % contacts] * way_of_base(base, begin[own], end[own])
    event, number = _connected(begin, end, places, neighbours)

    # What each contact slips in an event, in which it may stop and go on.
    pair, place = np.unique(event * contacts + track % contacts, return_inverse=True)
    of_pair, slipped = pair // contacts, np.bincount(place, np.abs(moved))
    first, last, largest = np.full(number, np.inf), np.zeros(number), np.zeros(number)
    np.minimum.at(first, event, begin)
    np.maximum.at(last, event, end)
    np.maximum.at(largest, of_pair, slipped)
    own, whole = track[np.unique(event, return_index=True)[1]] // contacts, np.bincount(event, cut, number) == 0
    size, moment = np.bincount(of_pair, minlength=number), np.bincount(of_pair, slipped, number)
    chosen = [number for number in np.lexsort((first, own)) if whole[number]]
    columns = [column[chosen] for column in (own, first, last - first, size, moment, largest)]
    return Catalogue(*columns, t1=t1, samples=samples, contacts=contacts, left_out=int(np.sum(~whole)))


def _connected(
    begin: np.ndarray, end: np.ndarray, places: np.ndarray, neighbours: np.ndarray
) -> tuple[np.ndarray, int]:
    """To which event each slip belongs, and how many there are.

    `places`: where the slips of each contact in each sample begin, those of a contact in order of time.
    """
    edges, contacts = [np.zeros((2, 0), int)], len(neighbours)
    pairs = np.argwhere(np.triu(neighbours, 1))
    for of_sample in range(0, len(places) - 1, contacts):
        for one, other in pairs + of_sample:
            own, others = (slice(places[number], places[number + 1]) for number in (one, other))
            # The other's slips that overlap with each of these are all from the first to the last such one.
            first = np.searchsorted(end[others], begin[own], "left")
            count = np.maximum(np.searchsorted(begin[others], end[own], "right") - first, 0)
            within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
            rows = np.repeat(np.arange(len(begin))[own], count)
            edges.append(np.stack([rows, others.start + np.repeat(first, count) + within]))
    rows, columns = np.concatenate(edges, axis=1)
    graph = sparse.coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(len(begin),) * 2)
    number, event = csgraph.connected_components(graph, directed=False)
    return event.astype(int), number
