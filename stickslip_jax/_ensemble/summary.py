"""The summary of an ensemble: the tables of its statistics, and what must be known to read them."""

import dataclasses
from collections.abc import Mapping, Sequence

from .._statistics.distribution import Distribution
from .._statistics.ensemble_statistics import EnsembleStatistics
from .._statistics.summary import Summary, shown, table_of
from .._status import Status


def summary_of(
    statistics: EnsembleStatistics, status_counts: Mapping[Status, int], near_grazing_samples: int
) -> Summary:
    """The summary of the ensemble with these statistics; see `Ensemble.summary`."""
    notes = []
    if statistics.duration.number:
        shares = ", ".join(f"{shown(share)} {ending.name}" for ending, share in statistics.endings.items())
        notes.append(f"Share of sticks by ending: {shares}.")
    else:
        rest = " but those that begin at t = 0" if statistics.sticks.begins_at_zero.any() else ""
        notes.append(f"There is no stick{rest}.")
    notes.append(
        "Sticks and slips cut by the horizon count with the part before it. Entropies are those of histograms with 50 "
        "bins, or with one bin for each whole number."
    )
    if not statistics.numbering.count_initial_rest and statistics.sticks.begins_at_zero.any():
        notes.append(
            "Sticks that begin at t = 0 count in the number of sticks and the stick fraction only; the 1st is the next "
            "(count_initial_rest)."
        )
    retained = len(statistics.totals)
    if retained < statistics.samples:
        notes.append(f"Standard errors were measured on the first {retained:,} samples.")
    for status, count in status_counts.items():
        if status and count:
            notes.append(f"NOT FINISHED, in no number above: {count:,} samples, because {status.meaning}.")
    if near_grazing_samples:
        notes.append(f"Decided by round-off (near-grazing), counted above: {near_grazing_samples:,} samples.")
    return dataclasses.replace(statistics._summary, notes=tuple(notes))


def with_outputs(summary: Summary, outputs: Sequence[Distribution], without_value: Mapping[str, int]) -> Summary:
    """The summary with a table of the outputs, and notes on finished samples without a value of them."""
    if not outputs:
        return summary
    tables = (*summary.tables, table_of("Outputs", outputs))
    notes = [f"NO VALUE of {name} in {count:,} finished samples." for name, count in without_value.items()]
    return dataclasses.replace(summary, tables=tables, notes=(*summary.notes, *notes))
