"""Warnings of cases that were not followed to the end."""

import warnings

import numpy as np

from .._status import Status


def warn_of_unfinished(status: object, stacklevel: int) -> None:
    """Warn (RuntimeWarning) if any `Status` code (cases,) is not FINISHED, and say why."""
    codes, counts = np.unique(np.asarray(status), return_counts=True)
    bad = [
        (Status(int(code)), int(count)) for code, count in zip(codes, counts, strict=True) if code != Status.FINISHED
    ]
    if bad:
        number = sum(count for _, count in bad)
        why = "; ".join(f"{count} because {code.meaning}" for code, count in bad)
        warnings.warn(
            f"{number} of {np.size(np.asarray(status))} cases were not followed to the end: {why}. They hold NaN from "
            "there on, and the variable status says which they are.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


def warn_of_unsettled(unsettled: np.ndarray, so_far: int, more: str, stacklevel: int, *, what: str = "periods") -> None:
    """Warn (RuntimeWarning) of the cases that are `unsettled`; `more` begins the sentence on what lets them go on."""
    if np.any(unsettled):
        warnings.warn(
            f"{np.sum(unsettled)} of {np.size(unsettled)} motions have not settled within {so_far} {what}: differences "
            f"between their returns still fall or grow, which the result says of each. {more} them go on; near a "
            "bifurcation that may take very long.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


def warn_of_missing(missing: int, cases: int, periods: int, stacklevel: int) -> None:
    """Warn (RuntimeWarning) if in some cases fewer events were found than are asked for."""
    if missing:
        warnings.warn(
            f"In {missing} of {cases} cases fewer events were found in {periods} periods than are asked for: the "
            "variable event_count says how many. Their places hold NaN; the motion may have come to rest, or never "
            "pass there.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


def warn_of_none(number: int, starts: int, most: int, stacklevel: int) -> None:
    """Warn (RuntimeWarning) of starts on no attractor."""
    if number:
        warnings.warn(
            f"{number} of {starts} starts belong to none of the {most} attractors that were looked for: basin is 0 "
            "there. Their motions may need a longer transient, or a larger tolerance or most.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )
