"""What may be wrong where residuals are not white: a clock, a zero, a unit."""

import jax.numpy as jnp
import numpy as np

from .._dynamics.common.validation import Arguments
from .._simulation.call import simulate
from .fit import Seen
from .information import orthonormal, without_states
from .record import Record, Windows

_CLEAR = 0.2  # of chi-squared: what another number must explain to be named
_OTHER_UNIT = 30.0  # times as large as the first guesses move, or as small


def explanations(record: Record, windows: Windows, seen: Seen, sigma: np.ndarray, number: int) -> list[str]:
    """What another number that is not searched would do to chi-squared, to first order, the best one; if any does.

    `seen`: standardised, with derivatives by the `number` parameters and the states at starts.
    """
    kinds = ["clock.delay", *(f"{one.name}.{kind}" for one in record.channels for kind in ("delay", "offset"))]
    units = ["s", *(unit for one in record.channels for unit in ("s", one.unit))]
    columns = np.zeros((*seen.residuals.shape, len(kinds)))
    predicted = seen.residuals + windows.values / sigma[:, None]
    for window, channel in np.ndindex(*seen.residuals.shape[:2]):
        there = windows.is_measured[window, channel]
        if np.count_nonzero(there) > 2:
            rate = -np.gradient(predicted[window, channel, there], windows.times[window, there])
            columns[window, channel, there, 0] = columns[window, channel, there, 1 + 2 * channel] = rate
        columns[window, channel, there, 2 + 2 * channel] = 1 / sigma[channel]
    free, _ = without_states(np.concatenate([columns, seen.slopes], axis=-1), len(kinds) + number)
    searched = orthonormal(free[:, len(kinds) :])
    own = free[:, : len(kinds)] - searched @ (searched.T @ free[:, : len(kinds)])
    size = np.sum(own**2, axis=0)
    known = size > 1e-6 * np.sum(columns**2, axis=(0, 1, 2))
    along = own.T @ seen.residuals.ravel()
    gains = np.where(known, along**2 / np.where(known, size, 1), 0)
    best, total = int(np.argmax(gains)), float(np.sum(seen.residuals**2))
    if gains[best] < _CLEAR * total:
        return []
    return [
        f"{kinds[best]}, about {-along[best] / size[best]:.2g} {units[best]}, would lower chi-squared by about "
        f"{gains[best]:.3g}: search it too, by its name in wrt."
    ]


def other_units(record: Record, arguments: Arguments, start: np.ndarray) -> list[str]:
    """Channels whose measurements are by far larger, or smaller, than the motion with the first guesses."""
    system, base, method, t1 = arguments
    motion = simulate(system, base, t1=t1, y0=tuple(map(float, start)), method=method)
    said = []
    for channel, row in zip(record.channels, record.values, strict=True):
        shown = np.asarray(channel.observe(motion, jnp.asarray(record.times)))
        spread, moves = float(np.nanstd(row)), float(np.nanstd(shown))
        if moves > 0 and np.isfinite(moves) and not 1 / _OTHER_UNIT < spread / moves < _OTHER_UNIT:
            unit = f" {channel.unit}" if channel.unit else ""
            said.append(
                f"What was measured of {channel.name} scatters by {spread:.2g}{unit}, the motion with the first "
                f"guesses by {moves:.2g}: is its unit, and that of the base, the right one?"
            )
    return said
