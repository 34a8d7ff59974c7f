"""The statistics of an ensemble as tables to read, in text and in HTML."""

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .. import _html
from .distribution import Distribution
from .estimate import Estimate, format_with_error
from .quantities import DISTRIBUTIONS, STICK_QUANTITIES
from .source import require_ensemble

if TYPE_CHECKING:
    from .ensemble_statistics import EnsembleStatistics

_Table = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]]
_HEAD = ("", "mean", "std. dev.", "5 %", "median", "95 %", "skewness", "entropy (nat)", "values")


@dataclasses.dataclass(frozen=True, repr=False)
class Summary:
    """The statistics of an ensemble in tables: print it, or show it in a notebook.

    `tables`: each a caption, the heads of the columns, and rows of text. `notes`: sentences below the tables.
    """

    title: str
    tables: tuple[_Table, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        parts = [self.title]
        for caption, head, rows in self.tables:
            widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]
            lines = ["  ".join(_aligned(row, widths)).rstrip() for row in (head, *rows)]
            parts.append("\n".join([caption, "-" * max(map(len, lines)), *lines]))
        return "\n\n".join([*parts, "\n".join(self.notes)] if self.notes else parts)

    def _repr_html_(self) -> str:
        parts = [_html.table(rows, head, caption) for caption, head, rows in self.tables]
        return "".join([_html.titled(self.title), *parts, *map(_html.escaped, self.notes)])


def summary_of(ensemble: Any) -> Summary:
    """The summary of an ensemble simulated with ``keep="statistics"`` or ``"sticks"``. Raises ValueError for others."""
    ensemble = require_ensemble(ensemble)
    statistics: "EnsembleStatistics" = ensemble.statistics
    return dataclasses.replace(summary_of_statistics(statistics), notes=tuple(_notes(ensemble, statistics)))


def summary_of_statistics(statistics: "EnsembleStatistics") -> Summary:
    """The tables alone, without what only the ensemble knows: which samples did not finish."""
    distributions = [getattr(statistics, quantity.name) for quantity in statistics.known(DISTRIBUTIONS)]
    tables: list[_Table] = [("All sticks and slips (mean +- standard error)", _HEAD, tuple(map(_row, distributions)))]
    sticks = [f"{one.short_label} ({statistics.unit_of(one)})" for one in statistics.known(STICK_QUANTITIES)]
    for body, of, quantities in (
        ("stick", statistics, sticks),
        ("slip", statistics.slips, ["start (s)", "duration (s)"]),
    ):
        orders = [of.order(number) for number in range(1, statistics.orders + 1)]
        rows = tuple(
            (str(one.number), _shown(one.share), *(_shown(values.mean) for values in one.distributions.values()))
            for one in orders
            if one.duration.number > 0
        )
        if rows:
            caption = f"{body.capitalize()}s by order (mean +- standard error)"
            tables.append((caption, (body, "samples that have it", *quantities), rows))
    return Summary(f"{statistics.samples:,} samples on [0, {statistics.t1:g}] s", tuple(tables), ())


def summary_of_distributions(title: str, distributions: Sequence[Distribution]) -> Summary:
    """One table, a row for each of some distributions."""
    return Summary(title, (("Mean +- standard error", _HEAD, tuple(map(_row, distributions))),), ())


def _notes(ensemble: Any, statistics: "EnsembleStatistics") -> list[str]:
    notes = []
    if statistics.duration.number:
        shares = ", ".join(f"{_shown(share)} {ending.name}" for ending, share in statistics.endings.items())
        notes.append(f"Share of sticks by ending: {shares}.")
    else:
        rest = " but those that begin at t = 0" if statistics.sticks.begins_at_zero.any() else ""
        notes.append(f"There is no stick{rest}.")
    notes.append(
        "Sticks and slips cut by the horizon count with the part before it. Entropies: in 50 bins; of "
        "numbers, in one for each."
    )
    if not statistics.numbering.count_initial_rest and statistics.sticks.begins_at_zero.any():
        notes.append(
            "Sticks that begin at t = 0 count in the number of sticks and the stick fraction only; the 1st is the next "
            "(count_initial_rest)."
        )
    retained = len(statistics.totals)
    if retained < statistics.samples:
        notes.append(f"Standard errors were measured on the first {retained:,} samples.")
    for status, count in ensemble.status_counts.items():
        if status and count:
            notes.append(f"NOT FINISHED, in no number above: {count:,} samples, because {status.meaning}.")
    if ensemble.near_grazing_samples:
        notes.append(f"Decided by round-off (near-grazing), counted above: {ensemble.near_grazing_samples:,} samples.")
    return notes


def _row(of: Distribution) -> tuple[str, ...]:
    unit = "" if of.unit == "1" else f" ({of.unit})"
    numbers = (
        of.mean,
        of.standard_deviation,
        of.quantile(0.05),
        of.median,
        of.quantile(0.95),
        of.skewness,
        of.entropy(),
    )
    return (f"{of.name}{unit}", _shown(numbers[0]), *(_plain(one) for one in numbers[1:]), f"{of.number:,}")


def _shown(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    if math.isnan(estimate.standard_error):
        return f"{estimate.value:.6g}"
    return format_with_error(estimate.value, estimate.standard_error)


def _plain(estimate: Estimate) -> str:
    return "-" if math.isnan(estimate.value) else f"{estimate.value:.4g}"


def _aligned(row: Sequence[str], widths: Sequence[int]) -> list[str]:
    return [row[0].ljust(widths[0]), *(text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True))]
