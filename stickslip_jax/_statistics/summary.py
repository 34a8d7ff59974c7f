"""Statistics as tables to read, in text and in HTML."""

import dataclasses
import math
import textwrap
from collections.abc import Sequence

from .. import _html
from .distribution import Distribution
from .estimate import Estimate, format_with_error

Table = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]]
_FIRST = 6  # columns of the first part in text: up to the quantiles
WIDEST = 100
"""Characters of a line of text: what the pages of the documentation hold, and most windows."""
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
            lines = _lines(head, rows)
            parts.append("\n".join([caption, "-" * max(map(len, lines)), *lines]))
        notes = [wrapped(note) for note in self.notes]
        return "\n\n".join([*parts, "\n".join(notes)] if notes else parts)

    def _repr_html_(self) -> str:
        parts = [_html.table(rows, head, caption) for caption, head, rows in self.tables]
        return "".join([_html.titled(self.title), *parts, *map(_html.escaped, self.notes)])


def table_of(caption: str, distributions: Sequence[Distribution]) -> Table:
    """A table with a row for each of some distributions."""
    return caption, _HEAD, tuple(map(_row, distributions))


def summary_of_distributions(title: str, distributions: Sequence[Distribution]) -> Summary:
    """One table, a row for each of some distributions."""
    return Summary(title, (table_of("Mean +- standard error", distributions),), ())


def _row(of: Distribution) -> tuple[str, ...]:
    unit = "" if of.unit == "1" else f" ({of.unit})"
    others = (of.standard_deviation, of.quantile(0.05), of.median, of.quantile(0.95), of.skewness, of.entropy())
    return (f"{of.name}{unit}", shown(of.mean), *map(_value, others), f"{of.number:,}")


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


def _value(estimate: Estimate) -> str:
    return "-" if math.isnan(estimate.value) else f"{estimate.value:.4g}"


def wrapped(text: str, indent: str = "", after: str = "") -> str:
    """A sentence in lines of at most `WIDEST` characters, indented; numbers stay beside their names and errors."""
    for sign in ("+-", "=", "<", "%"):
        text = text.replace(f" {sign}", f"\u00a0{sign}")
        text = text if sign == "%" else text.replace(f"{sign} ", f"{sign}\u00a0")
    lines = textwrap.wrap(text, WIDEST, initial_indent=indent, subsequent_indent=after, break_long_words=False)
    return "\n".join(lines).replace("\u00a0", " ")


def _lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in text; one that has too many columns for a line in two parts, with the names of its rows again."""
    columns = range(len(head))
    widths = [max(len(row[column]) for row in (head, *rows)) for column in columns]
    groups = [columns] if tuple(head) != _HEAD else [columns[:_FIRST], (0, *columns[_FIRST:])]
    return [
        "  ".join(_aligned([row[column] for column in group], [widths[column] for column in group])).rstrip()
        for group in groups
        for row in (head, *rows)
    ]


def _aligned(row: Sequence[str], widths: Sequence[int]) -> list[str]:
    return [row[0].ljust(widths[0]), *(text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True))]
