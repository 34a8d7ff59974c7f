"""What the statistics need of an ensemble, and a clear refusal of anything else."""

from typing import Any

from .. import _checks
from ..systems.motor_cart import MotorCart
from ..systems.switched_system import SwitchedSystem

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


def position_of(system: Any) -> tuple[str, str]:
    """What the position of a stick is, and its unit."""
    if isinstance(system, MotorCart):
        return "motor angle during the stick", "rad"
    if isinstance(system, SwitchedSystem):
        name, _, unit = system.state_names[0].rpartition(" in ")
        return f"{name or unit} when the stick starts", unit if name else "1"
    return "position of the mass when the stick starts", "m"
