"""The result of a study as text: a table for people, JSON for programs."""

import json
import math

from .._statistics.estimate import Estimate, format_with_error
from .._status import Status
from ._run import StoredStudy


def table(study: StoredStudy) -> str:
    """A table of the statistics with units and standard errors, then samples finished, time taken, and files."""
    run, ensemble = study.config.run, study.ensemble
    rows = [("statistic", "value", "standard error", "unit"), *(_row(each) for each in study.statistics.values())]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = [
        f"{run.samples} samples of {study.config.system.title}, {study.config.base.title}, on [0, {run.t1:g}] s "
        f"({run.dtype}, seed {run.seed})",
        "",
        *(f"{a:<{widths[0]}}  {b:>{widths[1]}}  {c:>{widths[2]}}  {d}" for a, b, c, d in rows),
        "",
        *_endings(study),
        *_first_sticks(study),
        *(["In float32 event times are accurate to about 2e-6 of t1."] if run.dtype == "float32" else []),
        f"Time: {ensemble.compile_seconds:.3g} s to compile, {ensemble.run_seconds:.3g} s to run "
        f"on {ensemble.threads} thread{'s' if ensemble.threads > 1 else ''}.",
        f"Files in {study.directory}: {', '.join(study.files)}",
    ]
    return "\n".join(lines)


def as_json(study: StoredStudy) -> str:
    """One JSON object: statistics by name, samples not finished, times, files. Undefined numbers are null."""
    ensemble = study.ensemble
    content: dict[str, object] = {
        name: {
            "value": _number(estimate.value),
            "standard_error": _number(estimate.standard_error),
            "unit": estimate.unit,
            "samples": estimate.samples,
        }
        for name, estimate in study.statistics.items()
    }
    content["samples"] = ensemble.samples
    content["not_finished"] = {status.name: count for status, count in _not_finished(study).items()}
    content["near_grazing_samples"] = ensemble.near_grazing_samples
    if study.first_sticks is not None:
        content["first_sticks"] = study.first_sticks.count
    content["seconds"] = {"compile": ensemble.compile_seconds, "run": ensemble.run_seconds}
    content["files"] = [str(study.directory / name) for name in study.files]
    return json.dumps(content, indent=2, allow_nan=False)


def _row(estimate: Estimate) -> tuple[str, str, str, str]:
    if math.isnan(estimate.value):
        return estimate.name, "not defined", "", estimate.unit
    value, error = format_with_error(estimate.value, estimate.standard_error).split(" +- ")
    return estimate.name, value, error, estimate.unit


def _endings(study: StoredStudy) -> list[str]:
    samples, near_grazing_samples = study.ensemble.samples, study.ensemble.near_grazing_samples
    lines = [
        f"NOT FINISHED: {count} of {samples} samples, because {status.meaning}; they enter no statistic."
        for status, count in _not_finished(study).items()
    ] or [f"All {samples} samples reached t1."]
    if study.ensemble.keep == "totals" and not study.config.run.count_initial_rest:
        lines.append('With keep = "totals" sticks that begin at t = 0 count in all numbers.')
    if study.ensemble.key_data is None and samples > 1:
        lines.append(f"Nothing is random here: all {samples} samples are the same.")
    if near_grazing_samples:
        lines.append(
            f"Near-grazing: {near_grazing_samples} of {samples} samples, in which round-off decides about an event."
        )
    return lines


def _first_sticks(study: StoredStudy) -> list[str]:
    if study.first_sticks is None:
        return []
    run = study.config.run
    rest = "" if run.count_initial_rest else ", rest at t = 0 not counted"
    return [f"A first stick was found in {study.first_sticks.count} of {study.ensemble.samples} samples{rest}."]


def _not_finished(study: StoredStudy) -> dict[Status, int]:
    counts = study.ensemble.status_counts
    return {status: count for status, count in counts.items() if status is not Status.FINISHED and count}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
