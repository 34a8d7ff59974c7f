"""Where windows of a record begin: in slips, where there are any, so that it is clear how the motion goes on.

A motion that starts in a stick starts with no relative velocity exactly; with any other it would slip, and where static
friction is above kinetic friction it would not be held again.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .problem import Setting, slip_speeds
from .record import Record, start_guess

_CANDIDATES = 9  # for the begin of a window
_REACH = 0.4  # of a window, to both sides
_SLOW = 0.1  # of the usual slip speed, below which a contact is taken to stick
_SPAN = 0.05  # of a window, in which the state at its start is guessed from the measurements


class Cuts(NamedTuple):
    """Where windows begin: places among the times (windows,), states there (windows, coordinates), and which contacts
    stick there (windows, modes); None if none does.
    """

    firsts: np.ndarray
    states: np.ndarray
    resting: np.ndarray | None


def cuts_of(record: Record, setting: Setting, solver: Any, number: int) -> Cuts:
    """About `number` windows of equal duration; each but the first begins where the slowest contact is fastest, of some
    measurements nearby.
    """
    times, width = record.times, np.ptp(record.times) / number
    edges = times[0] + width * np.arange(1, number)
    shifts = _REACH * width * np.linspace(-1, 1, _CANDIDATES)
    places = np.clip(np.searchsorted(times, edges[:, None] + shifts), 1, len(times) - 1)
    # What begins in a gap begins at the first measurement after it.
    candidates = np.vstack([np.zeros((1, _CANDIDATES), int), places])
    flat = candidates.ravel()
    begins = record.begin(flat)
    states = np.stack([start_guess(record, setting.system, float(at), _SPAN * width) for at in begins])
    speeds = np.asarray(slip_speeds(setting, solver, jnp.asarray(begins), jnp.asarray(states)))
    contacts = speeds.reshape(len(flat), -1)
    usual = np.sqrt(np.mean(np.where(np.isfinite(contacts), contacts, 1.0) ** 2, axis=0)) + np.finfo(float).tiny
    relative = contacts / usual
    slowest = np.min(relative, axis=1).reshape(candidates.shape)
    chosen = candidates[np.arange(number), np.argmax(slowest, axis=1)]
    at = np.arange(number) * _CANDIDATES + np.argmax(slowest, axis=1)
    firsts, unique = np.unique(chosen, return_index=True)
    resting = (relative[at[unique]] < _SLOW).reshape((len(firsts), *speeds.shape[1:]))
    return Cuts(firsts, states[at[unique]], resting if np.any(resting) else None)
