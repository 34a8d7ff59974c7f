"""What the statistics need of an ensemble, and a clear refusal of anything else."""

from typing import Any

from .. import _checks

FEATURES = ("stick_time", "stick_count", "slip_count")
"""What an ensemble's `moments` hold of each finished sample."""


def require_ensemble(ensemble: Any) -> Any:
    """`ensemble` itself. Raises ValueError if it is no result of `simulate_ensemble`."""
    if not hasattr(ensemble, "status_counts") or not hasattr(ensemble, "moments"):
        raise ValueError(
            f"Argument ensemble must be the result of simulate_ensemble, but {_checks.show(ensemble)} was given; "
            "a single simulation has .stick_fraction, .sticks and .slips itself."
        )
    return ensemble


def require_statistic(statistic: Any) -> None:
    """Raise ValueError if `statistic` cannot be called."""
    if not callable(statistic):
        raise ValueError(
            "Argument statistic must be a function such as stick_fraction or mean_stick_duration, but "
            f"{_checks.show(statistic)} was given."
        )
