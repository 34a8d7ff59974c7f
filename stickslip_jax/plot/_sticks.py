"""The complete sticks of a result, one by one: their durations and the positions at which they begin."""

from typing import NamedTuple

import numpy as np

from .. import _checks
from .._ensemble.result import Ensemble
from .._simulation.result import Simulation
from .._statistics.first_sticks import FirstSticks
from .._status import Ending, Status
from ._trajectory import require_one_contact
from ._types import Bins, SimulatedSticks


class CompleteSticks(NamedTuple):
    """Sticks whose end was seen, in samples that reached ``t1``; arrays (sticks,).

    - `duration`: s. `position`: where they begin, m (of a motor its angle, rad).
    - `cut`: how many more the horizon cut short.
    - `part`: for legends, of which samples the sticks are, where not of all.
    """

    duration: np.ndarray
    position: np.ndarray
    cut: int
    part: str = ""

    @property
    def label(self) -> str:
        """How many there are, for legends."""
        more = f" ({self.cut:,} more, cut by the horizon, left out)" if self.cut else ""
        return (f"{len(self.duration):,} sticks" if len(self.duration) else "no sticks") + self.part + more


def require_ensemble(result: Ensemble | Simulation) -> None:
    """Raise ValueError unless `result` is an ensemble."""
    if not isinstance(result, Ensemble):
        raise ValueError(
            f"Argument result must be an Ensemble, but {_checks.show(result)} was given; give the result of "
            "simulate_ensemble."
        )


def complete_sticks(result: SimulatedSticks, *, also: str = "") -> CompleteSticks:
    """The complete sticks of a `Simulation`, one or a batch, of an `Ensemble`, those that it kept, or of `FirstSticks`.

    `also`: what else the figure takes, for the message.

    Raises:
        ValueError: For anything else, and for an ensemble with ``keep="totals"``.
    """
    part = ""
    if isinstance(result, Ensemble):
        sticks = result.numbered_sticks()
        used, duration = np.ones(len(sticks.start), bool), sticks.duration
        part = f" of the first {len(sticks.count):,} samples" if len(sticks.count) < result.finished else ""
    elif isinstance(result, FirstSticks):
        sticks, used, duration = result, result.mask, result.duration
    elif isinstance(result, Simulation):
        require_one_contact(result)
        sticks = result.sticks
        if any(_checks.is_traced(leaf) for leaf in (sticks.mask, result.status)):
            raise ValueError(
                "Argument result must hold numbers, but one traced by a JAX transformation was given; draw the figure "
                "outside jit, vmap and grad."
            )
        used = np.asarray(sticks.mask) & (np.asarray(result.status) == Status.FINISHED)[..., None]
        duration = np.asarray(sticks.duration)
    else:
        raise ValueError(
            f"Argument result must be a result of simulate_ensemble or of simulate, or of first_stick{also}, but "
            f"{_checks.show(result)} was given."
        )
    cut = np.asarray(sticks.ending) == Ending.HORIZON
    kept = used & ~cut
    duration, position = (np.asarray(values, float)[kept] for values in (duration, sticks.position))
    return CompleteSticks(duration, position, int(np.sum(used & cut)), part)


def edges_of_bins(name: str, bins: Bins, span: tuple[float, float], unit: str) -> np.ndarray:
    """The edges of `bins`, (bins + 1,): so many of equal width over `span`, or the increasing edges given.

    `name` of the argument and `unit` are for the message.

    Raises:
        ValueError: For anything else.
    """
    if np.ndim(bins) == 0:
        return np.linspace(*span, _checks.whole_number(name, bins) + 1)
    _checks.numeric(name, bins, ndim=1)
    edges = np.asarray(bins, float)
    if len(edges) < 2 or np.any(np.diff(edges) <= 0):
        raise ValueError(
            f"Argument {name} must be a whole number or increasing edges (in {unit}), but {_checks.show(bins)} was "
            "given."
        )
    return edges


def outside(label: str, number: int) -> str:
    """`label` with a line on how many sticks lie outside the bins, if any do."""
    return f"{label}\n{number:,} of them outside the bins" if number else label
