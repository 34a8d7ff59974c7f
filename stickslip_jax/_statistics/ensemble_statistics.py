"""The statistics of the sticks and slips of an ensemble, by quantity and by order."""

import abc
import dataclasses
import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .._dynamics.sticks import FlatSlips, FlatSticks, StickStream, slips_after, slips_among
from .._foundation import checks, html
from .._foundation.extras import Entries, labeled_dataset, variable
from .._foundation.types import Ending
from .._numerics.sums import DyadicCounts, PowerSums
from . import quantities
from .distribution import BINS, BINS_OF_PAIRS, DEFAULT_BINS, LEVELS, Clusters, Distribution, JointDistribution, wrapped
from .estimate import Estimate, Share, format_with_error
from .quantities import Numbering, SampledQuantity, StickAccumulator, StickValue, ordinal
from .totals import TOTALS

if TYPE_CHECKING:
    import xarray


# Statistics as tables to read, in text and in HTML.


Table = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]]
_FIRST = 6  # columns of the first part in text: up to the quantiles
_HEAD = ("", "mean", "std. dev.", "5 %", "median", "95 %", "skewness", "entropy (nat)", "values")


@dataclasses.dataclass(frozen=True, repr=False)
class Summary:
    """The statistics of an ensemble in tables: print it, or show it in a notebook.

    `tables`: each a caption, the heads of the columns, and rows of text. `notes`: sentences below the tables.
    """

    title: str
    tables: tuple[Table, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        parts = [self.title]
        for caption, head, rows in self.tables:
            columns = range(len(head))
            widths = [max(len(row[column]) for row in (head, *rows)) for column in columns]
            # One that has too many columns for a line in two parts, with the names of its rows again.
            groups = [columns] if tuple(head) != _HEAD else [columns[:_FIRST], (0, *columns[_FIRST:])]
            lines = [
                "  ".join(f"{row[column]:{'>' if column else '<'}{widths[column]}}" for column in group).rstrip()
                for group in groups
                for row in (head, *rows)
            ]
            parts.append("\n".join([caption, "-" * max(map(len, lines)), *lines]))
        notes = [wrapped(note) for note in self.notes]
        return "\n\n".join([*parts, "\n".join(notes)] if notes else parts)

    def _repr_html_(self) -> str:
        parts = [html.table(rows, head, caption) for caption, head, rows in self.tables]
        return "".join([html.titled(self.title), *parts, *map(html.escaped, self.notes)])


def table_of(caption: str, distributions: Sequence[Distribution]) -> Table:
    """A table with a row for each of some distributions."""
    rows = []
    for of in distributions:
        unit = "" if of.unit == "1" else f" ({of.unit})"
        others = (of.standard_deviation, of.quantile(0.05), of.median, of.quantile(0.95), of.skewness, of.entropy())
        cells = ("-" if math.isnan(one.value) else f"{one.value:.4g}" for one in others)
        rows.append((f"{of.name}{unit}", shown(of.mean), *cells, f"{of.number:,}"))
    return caption, _HEAD, tuple(rows)


def summary_of_distributions(title: str, distributions: Sequence[Distribution]) -> Summary:
    """One table, a row for each of some distributions."""
    return Summary(title, (table_of("Mean +- standard error", distributions),), ())


def shown(estimate: Estimate) -> str:
    """Value and standard error of an estimate, as far as they are known."""
    if math.isnan(estimate.value):
        return "-"
    if math.isnan(estimate.standard_error):
        return f"{estimate.value:.6g}"
    return format_with_error(estimate.value, estimate.standard_error)


def shown_share(share: Estimate) -> str:
    """A share of the samples in percent with its standard error; or in a word, where all of them are meant."""
    if share.value == 1:
        return "all"
    percent = dataclasses.replace(share, value=100 * share.value, standard_error=100 * share.standard_error)
    return f"{shown(percent)} %"


# Statistics of the i-th stick, or of the i-th slip, of each sample.


NAMES = tuple(quantity.name for quantity in quantities.STICK_QUANTITIES)  # in the order of the accumulator's columns


class ByQuantity(abc.ABC):
    """Gives the distribution of each quantity of sticks, or of slips, as an attribute of its name without "slip_"."""

    distributions: Mapping[str, Distribution]

    @property
    @abc.abstractmethod
    def _summary(self) -> Summary:
        """The tables that show it."""

    def __repr__(self) -> str:
        return repr(self._summary)

    def _repr_html_(self) -> str:
        return self._summary._repr_html_()

    def __getattr__(self, name: str) -> Distribution:
        if name in NAMES:
            for key in (name, f"slip_{name}"):
                if key in self.distributions:
                    return self.distributions[key]
            if quantities.SLIP_START.name not in self.distributions:
                raise ValueError(f"The sticks of this ensemble have no {name}, which was not measured.")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(name.removeprefix("slip_") for name in self.distributions)})


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class OrderStatistics(ByQuantity):
    """Statistics of the `number`-th stick, or slip, over the samples that have it.

    - `share`: the share of samples that have it.
    - `start`, `duration` (s), and of sticks `position` (m; of a motor rad): each a `Distribution`; `distributions`:
      these by the names of their quantities, for slips `slip_start` and so on.
    """

    number: int
    share: Estimate
    distributions: Mapping[str, Distribution]

    @classmethod
    def of(
        cls, number: int, body: str, having: int, samples: int, distributions: Mapping[str, Distribution],
        origin: Hashable,
    ) -> "OrderStatistics":  # fmt: skip
        """Those of the `number`-th `body`, "stick" or "slip", which so many of the samples have."""
        share = having / samples if samples else math.nan
        error = math.sqrt(share * (1 - share) / (samples - 1)) if samples > 1 else math.nan
        label = f"share of samples that have a {ordinal(number)} {body}"
        return cls(number, Estimate(label, share, error, "1", samples, origin, Share()), distributions)

    @property
    def _summary(self) -> Summary:
        return summary_of_distributions(str(self.share), list(self.distributions.values()))


# The statistics of the slips of an ensemble: when they begin and how long they last, of all and by order.


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SlipStatistics(ByQuantity):
    """Statistics of the slips of the retained samples, those cut by the end with the part before it.

    `start`, `duration`: each the `Distribution` over all slips, s. `order(i)`: of the i-th slip of each sample. The
    first slip is that before the first stick, or after it where a sample begins with a stick. The duration of the
    slips of all samples, retained or not, is ``statistics.slip_duration``.

    - `sticks`: those of the retained samples. `t1`: s. `origin`: of the random numbers; see `Estimate`.
    """

    sticks: FlatSticks
    t1: float
    origin: Hashable

    @cached_property
    def distributions(self) -> dict[str, Distribution]:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        """The distribution over all slips of each of the `SLIP_QUANTITIES`, by name."""
        every = np.ones(len(self._slips.start), bool)
        return {one.name: self._distribution(one, every) for one in quantities.SLIP_QUANTITIES}

    def order(self, number: int) -> OrderStatistics:
        """Statistics of the `number`-th slip of each sample that has so many. Raises ValueError below 1."""
        chosen = self._slips.order == checks.whole_number("number", number)
        found = {one.name: self._distribution(one, chosen, number) for one in quantities.SLIP_QUANTITIES}
        return OrderStatistics.of(number, "slip", int(chosen.sum()), len(self.sticks.count), found, self.origin)

    @cached_property
    def _slips(self) -> FlatSlips:
        return slips_among(self.sticks, self.t1)

    def _distribution(self, quantity: SampledQuantity, chosen: np.ndarray, number: int | None = None) -> Distribution:
        """The distribution of a quantity of the `chosen` slips: all, or the `number`-th ones."""
        column = getattr(self._slips, quantity.name.removeprefix("slip_"))
        values, samples = np.asarray(column, np.float64)[chosen], len(self.sticks.count)
        label, unit = quantity.label_of_order(number), quantity.unit
        assert unit is not None
        return Distribution(
            label, unit, samples, PowerSums.of(values), DyadicCounts.of(values, BINS),
            Clusters(values, self._slips.sample[chosen], samples, samples),
            4 * float(np.finfo(column.dtype).eps) * self.t1, quantity.is_whole, self.origin,
        )  # fmt: skip

    @property
    def _summary(self) -> Summary:
        title = f"Slips of {len(self.sticks.count):,} samples on [0, {self.t1:g}] s"
        return summary_of_distributions(title, list(self.distributions.values()))


# The statistics of the sticks and slips of an ensemble, by quantity and by order.


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class EnsembleStatistics(ByQuantity):
    """Statistics of the sticks and slips of the samples that finished.

    Sticks cut by the end, `t1`, count with the part before it (`endings` gives their share), and so do slips. A sample
    without sticks counts in the distributions over samples, and in no distribution over sticks. A stick that begins at
    t = 0 counts in `stick_count` and `stick_fraction` only, unless `numbering` counts it as the first.

    - `start`, `duration` (s), `position` (of the mass when the stick starts, m; of a motor its angle, rad): each the
      `Distribution` over all sticks.
    - `accumulator`: sums and histograms of all finished samples. `numbering`: which stick is the 1st, 2nd, ...
    - `sticks`: those of the retained samples; `totals`: the `TOTALS` of each retained sample, (samples, 5). Standard
      errors, ranks and all joint distributions that were not summed rest on these.
    - `t1`: s. `position_unit`: the unit of `position`. `origin`: of the random numbers; see `Estimate`.
    """

    accumulator: StickAccumulator
    sticks: FlatSticks
    totals: Float[np.ndarray, "samples totals"]
    t1: float
    position_unit: str
    numbering: Numbering
    origin: Hashable = dataclasses.field(default_factory=object)

    @property
    def samples(self) -> int:
        """Number of samples that finished."""
        return int(self.accumulator.samples.number)

    @property
    def orders(self) -> int:
        """The largest number that `order` takes."""
        return self.numbering.orders

    @cached_property
    def missing(self) -> frozenset[str]:
        """The names of quantities that the sticks do not have: not measured, or not summed by an older version."""
        summed = len(self.accumulator.stick_bins)
        return frozenset(name for at, name in enumerate(NAMES) if at >= summed or np.any(np.isnan(self._column(name))))

    def known(self, asked: Iterable[SampledQuantity]) -> tuple[SampledQuantity, ...]:
        """Those of the quantities `asked` for that the sticks have."""
        return tuple(one for one in asked if one.name not in self.missing)

    def unit_of(self, quantity: SampledQuantity) -> str:
        """The unit of a quantity for this system."""
        return self.position_unit if quantity.unit is None else quantity.unit

    @cached_property
    def distributions(self) -> dict[str, Distribution]:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        """The distribution over all sticks of each of the `STICK_QUANTITIES`, by name."""
        sums, bins = self.accumulator.sticks, self.accumulator.stick_bins
        return self._of_sticks(sums, bins, self._pooled, self.sticks.sample[self._pooled])

    @cached_property
    def _pooled(self) -> np.ndarray:
        """Which of the retained sticks are numbered, (sticks,)."""
        return self.numbering.order_of(self.sticks) > 0

    @cached_property
    def slips(self) -> SlipStatistics:
        """Statistics of the slips of the retained samples: when they begin, how long they last, of all and by order."""
        return SlipStatistics(self.sticks, self.t1, self.origin)

    @cached_property
    def slip_duration(self) -> Distribution:
        """Durations of all slips, s."""
        sticks = StickStream.of(self.sticks)
        before, after = sticks.slip, sticks.slip_after(self.t1)
        owner = np.concatenate([self.sticks.sample, np.arange(len(after))])
        values = np.concatenate([before, after])
        slips = values > 0
        sums, clusters = self.accumulator.slips, self._clusters(values[slips], owner[slips])
        return self._distribution(quantities.SLIP_DURATION, sums, self.accumulator.slip_bins, clusters)

    @cached_property
    def stick_count(self) -> Distribution:
        """Number of sticks of each sample."""
        return self._of_samples(quantities.STICK_COUNT, self._total("stick_count"))

    @cached_property
    def slip_count(self) -> Distribution:
        """Number of slips of each sample."""
        return self._of_samples(quantities.SLIP_COUNT, self._total("slip_count"))

    @cached_property
    def stick_fraction(self) -> Distribution:
        """Share of ``[0, t1]`` that each sample spends sticking."""
        return self._of_samples(quantities.STICK_FRACTION, self._total("stick_time") / self.t1)

    @cached_property
    def own_mean_duration(self) -> Distribution:
        """The mean stick duration of each sample that has sticks, s. Its mean is the mean of realisation means."""
        time = self._total("stick_time") - self._total("rest_time")
        count = self._total("stick_count") - self._total("rest_count")
        has = count > 0
        clusters = self._clusters(time[has] / count[has], np.flatnonzero(has))
        sums, bins = self.accumulator.own_mean, self.accumulator.own_mean_bins
        return self._distribution(quantities.OWN_MEAN_DURATION, sums, bins, clusters)

    @property
    def endings(self) -> dict[Ending, Estimate]:
        """Share of all sticks that ended in each way."""
        counts, total = self.accumulator.endings, self.accumulator.endings.sum()
        retained = self.sticks.ending[self._pooled].astype(np.int64)
        errors = self._clusters(retained, self.sticks.sample[self._pooled]).errors_of_shares(retained, len(counts))
        shares = {ending: float(counts[ending] / total) if total else np.nan for ending in Ending}
        return {
            ending: Estimate(
                f"share of sticks {ending.name}", share, float(errors[ending]), "1", self.samples, self.origin
            )
            for ending, share in shares.items()
        }

    def order(self, number: int) -> OrderStatistics:
        """Statistics of the `number`-th stick of each sample that has so many.

        Raises:
            ValueError: Unless ``1 <= number <= orders``.
        """
        if checks.whole_number("number", number) > self.orders:
            hint = f"call simulate_ensemble(..., orders={checks.show(number)})"
            raise checks.refused("number", f"be at most {self.orders}", number, hint)
        number = int(number)
        owner, before = self._that_have(number)
        sums = self.accumulator.by_order.one(number - 1)
        bins = [one._replace(counts=one.counts[number - 1]) for one in self.accumulator.order_bins]
        distributions = self._of_sticks(sums, bins, before + number, owner, number)
        return OrderStatistics.of(number, "stick", int(sums.number), self.samples, distributions, self.origin)

    def joint(self, x: StickValue, y: StickValue) -> JointDistribution:
        """The joint distribution of two quantities of a stick, or of two sticks of one sample.

        A stick that the end cuts has no slip after it, and its pairs with one are left out. The two durations,
        ("duration", "position") and ("start", "duration") were summed over all samples; any other pair rests on the
        retained samples.

        Args:
            x: "start", "duration", "position", "slip_before" (duration of the slip before the stick), "slip_start" or
                "slip_duration" (of the slip after the stick, s), of the same stick as `y`; or with the number of the
                stick: ``joint(("duration", 1), ("duration", 2))`` is the joint distribution of the durations of the
                first and the second stick, ``joint(("slip_duration", 1), ("duration", 2))`` that of the slip between
                the two and the second stick.
            y: Another quantity; with the number of a stick if `x` has one.

        Raises:
            ValueError: For other arguments.
        """
        (of_x, number_x), (of_y, number_y) = _stick_value("x", x), _stick_value("y", y)
        for of in (of_x, of_y):
            if of.name in self.missing:
                raise ValueError(f"The sticks of this ensemble have no {of.name}, which was not measured.")
        if (number_x is None) != (number_y is None):
            raise ValueError(
                "Arguments x and y must both have the number of a stick, such as ('duration', 1), or neither, but "
                f"{x!r} and {y!r} were given."
            )
        if number_x is None or number_y is None:
            values = tuple(self._column(of.name)[self._pooled] for of in (of_x, of_y))
            owner = self.sticks.sample[self._pooled]
        else:
            owner, before = self._that_have(max(number_x, number_y))
            values = (self._column(of_x.name)[before + number_x], self._column(of_y.name)[before + number_y])
        exists = np.isfinite(values[0]) & np.isfinite(values[1])
        values, owner = tuple(column[exists] for column in values), owner[exists]
        bins, correlation, sums = None, None, self.accumulator
        if (x, y) == quantities.FIRST_TWO:
            bins, correlation = sums.first_two_bins, float(sums.first_two.correlation[0, 1])
        elif (x, y) in quantities.STREAMED_PAIRS:
            bins = sums.pair_bins[quantities.STREAMED_PAIRS.index((x, y))]
            correlation = float(sums.sticks.correlation[NAMES.index(x), NAMES.index(y)])
        clusters = [self._clusters(column, owner, of_all=bins is not None) for column in values]
        labels = (of_x.axis_label(number_x), of_y.axis_label(number_y))
        return JointDistribution(
            names=(of_x.short_label, of_y.short_label) if number_x is None else labels,
            labels=labels,
            units=(self.unit_of(of_x), self.unit_of(of_y)),
            x=clusters[0],
            y=clusters[1],
            bins=bins,
            streamed_correlation=correlation,
            round_off=(self._round_off(values[0]), self._round_off(values[1])),
            origin=self.origin,
        )

    def to_xarray(self, bins: int | None = None) -> "xarray.Dataset":
        """Moments, quantiles, histograms, joint histograms and means by order as an ``xarray.Dataset`` with units.

        Needs the extra ``study`` (else ImportError).

        Args:
            bins: At most, of each histogram; by default 50, of whole numbers one for each number.
        """
        variables: Entries = {}
        coordinates: Entries = {"quantile": variable("quantile", list(LEVELS), "share of values", "1")}

        def add_estimates(name: str, dimension: str, estimates: Sequence[Estimate], long_name: str, unit: str) -> None:
            values, errors = ([getattr(one, what) for one in estimates] for what in ("value", "standard_error"))
            variables[name] = variable(dimension, values, long_name, unit)
            variables[f"{name}_error"] = variable(dimension, errors, "standard error", unit)

        def add_bins(name: str, edges: np.ndarray, long_name: str, unit: str) -> None:
            """Centres of bins, and their bounds as CF conventions have them."""
            centers, bounds = (edges[1:] + edges[:-1]) / 2, f"{name}_bounds"
            coordinates[name] = variable(name, centers, long_name, unit, bounds=bounds)
            variables[bounds] = ((name, "bounds"), np.stack([edges[:-1], edges[1:]], axis=1))

        for quantity in self.known(quantities.DISTRIBUTIONS):
            name = quantity.name
            of: Distribution = getattr(self, name)
            for moment in ("mean", "standard_deviation", "skewness"):
                one, label = getattr(of, moment), f"{name}_{moment}"
                variables[label] = variable((), one.value, one.name, one.unit, standard_error=one.standard_error)
            quantiles = [of.quantile(share) for share in LEVELS]
            add_estimates(f"{name}_quantile", "quantile", quantiles, f"quantile of {of.name}", of.unit)
            histogram, bin_name = of.histogram(bins), f"{name}_bin"
            per = "1" if of.unit == "1" else f"{of.unit}-1"
            add_bins(bin_name, histogram.edges, of.name, of.unit)
            counted = f"number of values of {of.name}"
            variables[f"{name}_count_in_bin"] = variable(bin_name, histogram.counts, counted, "1")
            variables[f"{name}_density"] = variable(bin_name, histogram.density, f"density of {of.name}", per)
            variables[f"{name}_density_error"] = variable(bin_name, histogram.error, "standard error", per)

        for pair in (*quantities.STREAMED_PAIRS, quantities.FIRST_TWO):
            if set(pair) & self.missing:
                continue
            joint = self.joint(*pair)
            # In names of variables ``duration``, or ``duration_1`` for that of the first stick.
            name = "_and_".join(one if isinstance(one, str) else f"{one[0]}_{one[1]}" for one in pair)
            histogram = joint.histogram(DEFAULT_BINS if bins is None else min(bins, BINS_OF_PAIRS))
            dimensions = (f"{name}_x_bin", f"{name}_y_bin")
            edges = (histogram.x_edges, histogram.y_edges)
            for dimension, edge, quantity, unit in zip(dimensions, edges, joint.names, joint.units, strict=True):
                add_bins(dimension, edge, quantity, unit)
            counted = f"number of pairs of {joint.names[0]} and {joint.names[1]}"
            variables[f"{name}_count_in_bin"] = variable(dimensions, histogram.counts, counted, "1")

        # The share of samples and the means of the 1st, 2nd, ... stick, and slip.
        numbers = list(range(1, self.orders + 1))
        coordinates["order"] = variable("order", numbers, "number of the stick or slip", "1")
        sticks, slips = ([of.order(number) for number in numbers] for of in (self, self.slips))
        shares = [one.share for one in sticks]
        add_estimates("share_by_order", "order", shares, "share of samples that have the stick", "1")
        by_order = [(sticks, one, f"{one.short_label} of the stick") for one in self.known(quantities.STICK_QUANTITIES)]
        by_order += [(slips, one, one.label) for one in quantities.SLIP_QUANTITIES]
        for orders, quantity, label in by_order:
            means, unit = [one.distributions[quantity.name].mean for one in orders], self.unit_of(quantity)
            add_estimates(f"{quantity.name}_by_order", "order", means, f"mean {label}", unit)

        endings = self.endings
        add_estimates("ending_share", "ending", list(endings.values()), "share of sticks by ending", "1")
        coordinates["ending"] = ("ending", [one.name for one in endings], {"long_name": "how the stick ended"})
        return labeled_dataset(variables, coordinates, {"samples": self.samples, "duration_s": float(self.t1)})

    @property
    def _summary(self) -> Summary:
        """The tables of `Ensemble.summary`, without what only the ensemble knows: which samples did not finish."""
        every = [getattr(self, quantity.name) for quantity in self.known(quantities.DISTRIBUTIONS)]
        tables = [table_of("All sticks and slips (mean +- standard error)", every)]
        for body, of, shared in (
            ("stick", self, self.known(quantities.STICK_QUANTITIES)),
            ("slip", self.slips, quantities.SLIP_QUANTITIES),
        ):
            orders = [of.order(number) for number in range(1, self.orders + 1)]
            rows = tuple(
                (str(one.number), shown_share(one.share), *map(shown, (of.mean for of in one.distributions.values())))
                for one in orders
                if one.duration.number > 0
            )
            if rows:
                heads = [f"{one.short_label.removeprefix('slip ')} ({self.unit_of(one)})" for one in shared]
                caption = f"{body.capitalize()}s by order (mean +- standard error)"
                tables.append((caption, (body, f"samples with this {body}", *heads), rows))
        return Summary(f"{self.samples:,} samples on [0, {self.t1:g}] s", tuple(tables), ())

    def _that_have(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """The retained samples with a `number`-th stick, and in the sticks the place before the first one of each."""
        _, skipped = self.numbering.rest(self.sticks)
        has = np.flatnonzero(self.sticks.count - skipped >= number)
        return has, (self.sticks.first + skipped)[has] - 1

    def _total(self, name: str) -> np.ndarray:
        """One of the `TOTALS` of each retained sample."""
        return self.totals[:, TOTALS.index(name)]

    def _of_sticks(
        self, sums: PowerSums, bins: Sequence[DyadicCounts], at: np.ndarray, owner: np.ndarray,
        number: int | None = None,
    ) -> dict[str, Distribution]:  # fmt: skip
        """The distribution of each of the `STICK_QUANTITIES`, by name, over sticks: all, or the `number`-th ones.

        `at`: which of the retained sticks these are; `owner`: the samples of those.
        """
        return {
            one.name: self._distribution(
                one, sums, bins[index], self._clusters(self._column(one.name)[at], owner), index, number
            )
            for index, one in enumerate(quantities.STICK_QUANTITIES)
            if one.name not in self.missing
        }

    def _of_samples(self, quantity: SampledQuantity, values: np.ndarray) -> Distribution:
        """The distribution of one of the `SAMPLE_QUANTITIES`, which has these `values` in the retained samples."""
        index, clusters = quantities.SAMPLE_QUANTITIES.index(quantity), self._clusters(values, np.arange(len(values)))
        bins = self.accumulator.sample_bins[index]
        return self._distribution(quantity, self.accumulator.samples, bins, clusters, index)

    def _distribution(
        self, quantity: SampledQuantity, sums: PowerSums, bins: DyadicCounts, clusters: Clusters, index: int = 0,
        number: int | None = None,
    ) -> Distribution:  # fmt: skip
        """The distribution of a quantity of all, or the `number`-th, sticks; its sums are those of column `index`."""
        one = slice(index, index + 1)
        own = PowerSums(
            sums.number, sums.mean[one], sums.scatter[one, one], sums.third[one], sums.smallest[one], sums.largest[one]
        )
        label, unit = quantity.label_of_order(number), self.unit_of(quantity)
        round_off = self._round_off(np.concatenate([own.smallest, own.largest]) if sums.number else np.zeros(0))
        return Distribution(label, unit, self.samples, own, bins, clusters, round_off, quantity.is_whole, self.origin)

    def _round_off(self, values: np.ndarray) -> float:
        """Differences up to this may be round-off: times are differences of instants up to ``t1``."""
        largest = max(self.t1, float(np.abs(values).max(initial=0)))
        return 4 * float(np.finfo(self.sticks.start.dtype).eps) * largest

    def _clusters(self, values: np.ndarray, owner: np.ndarray, of_all: bool = True) -> Clusters:
        retained = len(self.totals)
        return Clusters(values, owner, retained, self.samples if of_all else retained)

    def _column(self, name: str) -> np.ndarray:
        """A quantity of each retained stick; NaN where there is none."""
        if name == "slip_before":
            return np.asarray(StickStream.of(self.sticks).slip, np.float64)
        if name in ("slip_start", "slip_duration"):
            start, duration = slips_after(self.sticks, self.t1)
            return start if name == "slip_start" else duration
        return np.asarray(getattr(self.sticks, name), np.float64)


def _stick_value(argument: str, value: object) -> tuple[SampledQuantity, int | None]:
    """A quantity of a stick, and the number of the stick if there is one."""
    name, number = value if isinstance(value, tuple) and len(value) == 2 else (value, None)
    if not (isinstance(name, str) and name in quantities.BY_NAME):
        names = ", ".join(map(repr, quantities.BY_NAME))
        options = f"{names}, or such a name with the number of the stick, as in ('duration', 1)"
        raise checks.refused(argument, f"be one of {options}", value)
    if isinstance(value, tuple):
        number = checks.whole_number(f"{argument}[1]", number)
    return quantities.BY_NAME[name], number
