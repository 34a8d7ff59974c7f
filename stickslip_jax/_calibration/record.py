"""A measured motion: its channels, their noise and its cut into windows; the arguments about it, checked; and
whether what is left of it is white noise.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
import numpy.typing as npt
from scipy import stats

from .._dynamics.common.method import Arguments, Exact, Regularized
from .._dynamics.common.path import padded_length
from .._dynamics.simulation import Simulation
from .._dynamics.switched.engine import StepPath
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.types import AnyArray, FloatArray, InitialState
from .._statistics.independence import HypothesisTest
from .._systems.system import System

# A measured motion: its channels, their noise, and its cut into windows.


Observer: TypeAlias = Callable[[Simulation, FloatArray], FloatArray]
"""What a channel measures: a function of a simulation and of times (s, (times,)), with one number for each time."""
_NEAR = 6  # points at least for the state at the start of a window


class Channel(NamedTuple):
    """One measured quantity: its name, its unit ("" where it is not known), and what it is of a simulation."""

    name: str
    unit: str
    observe: Observer


class Record(NamedTuple):
    """Measurements: `times` (s, (times,)), `channels`, and `values` (channels, times), NaN where nothing was measured.

    `noise`: the standard deviation of each channel's noise, (channels,), NaN where it is not known. `reach`: how far
    (s) what is measured may be from where the motion is that it shows, with delays that are searched; so much of the
    record is left out at both of its ends.
    """

    times: np.ndarray
    channels: tuple[Channel, ...]
    values: np.ndarray
    noise: np.ndarray
    reach: float = 0.0

    @property
    def is_used(self) -> np.ndarray:
        """Which measurements there are that are compared, (channels, times)."""
        at, reach = self.times, self.reach
        return np.isfinite(self.values) & (at >= at[0] + reach) & (at <= at[-1] - reach)

    @property
    def counts(self) -> np.ndarray:
        """The number of measurements of each channel, (channels,)."""
        return np.count_nonzero(self.is_used, axis=1)

    def begin(self, place: AnyArray) -> AnyArray:
        """Where the motion begins whose first measurement is at this place among the times, s."""
        return np.maximum(self.times[place] - self.reach, self.times[0])

    def cut(self, firsts: np.ndarray, begin: float | None) -> "Windows":
        """The record in windows, each from one of `firsts` on, places among its times, the first of which is 0.

        `begin`: where the first begins (s); at its first measurement by default, as all others.
        """
        parts = np.split(np.arange(len(self.times)), firsts[1:])
        longest = padded_length(max(len(part) for part in parts))  # so that similar records share a compilation
        starts = self.begin(firsts)
        if begin is not None:
            starts[0] = begin
        index = np.stack([np.pad(part, (0, longest - len(part)), mode="edge") for part in parts])
        is_own = np.arange(longest) < np.array([len(part) for part in parts])[:, None]
        values = np.moveaxis(self.values[:, index], 0, 1)
        is_there = is_own[:, None, :] & np.moveaxis(self.is_used[:, index], 0, 1)
        # A window of one point at its own start has no duration: it ends a little later.
        lasts = np.minimum(self.times[index[:, -1]] + self.reach, self.times[-1])
        ends = np.maximum(lasts, np.nextafter(starts, np.inf) + 1e-9 * (self.times[-1] - starts))
        return Windows(starts, ends, self.times[index], np.where(is_there, values, 0), is_there)


def checked_noise(noise: Mapping[str, Any] | None, channels: Collection[str]) -> Mapping[str, Any]:
    """The standard deviations that are given, by channel. Raises ValueError for no dict, and for other names."""
    given = {} if noise is None else noise
    if not isinstance(given, Mapping):
        raise checks.refused("noise", "be a dict with a standard deviation for each channel", noise)
    if unknown := [name for name in given if name not in channels]:
        raise ValueError(f"Argument noise must name channels of measured, but {unknown[0]!r} is none of them.")
    return given


class Windows(NamedTuple):
    """A record in windows: begins and ends (s, (windows,)), times (windows, times), values (windows, channels, times),
    and which of these were measured; the others are fillings.
    """

    begins: AnyArray
    ends: AnyArray
    times: AnyArray
    values: AnyArray
    is_measured: AnyArray

    def in_order(self, values: np.ndarray, record: Record) -> np.ndarray:
        """Numbers (windows, channels, times) along the record, (channels, times); NaN where nothing was measured."""
        flat = np.full(record.values.shape, np.nan)
        window, channel, time = np.nonzero(self.is_measured)
        flat[channel, np.searchsorted(record.times, self.times)[window, time]] = values[window, channel, time]
        return flat


def known_channels(system: System) -> dict[str, Channel]:
    """The channels that can be measured of every motion of a system, by name."""
    coordinates, rates = {}, {}
    for number, (name, unit, *_) in enumerate(system.coordinates):
        coordinates[name] = Channel(name, unit, MeasuredCoordinate(number))
        if "velocity" in name:
            rate = name.replace("velocity", "acceleration")
            rates[rate] = Channel(rate, f"{unit}^2", Rate(number))
    force = {"friction force": Channel("friction force", "N", Simulation.friction_force)}
    return coordinates | rates | force | coordinates  # last those that come before what is called like one of them


class MeasuredCoordinate(NamedTuple):
    """Measures one coordinate of the state."""

    number: int

    def __call__(self, one: Simulation, times: FloatArray) -> FloatArray:
        return one.evaluate(times)[self.number]


class Rate(NamedTuple):
    """Measures the rate of one coordinate."""

    number: int

    def __call__(self, one: Simulation, times: FloatArray) -> FloatArray:
        path = one._path
        if not isinstance(path, StepPath):
            raise ValueError(
                "Argument measured can hold accelerations with the method Exact only; measure positions or velocities, "
                "or give a function of your own in observe."
            )
        return jax.vmap(lambda time: path.rates(time)[self.number])(times)


def start_guess(record: Record, system: System, at: float, span: float) -> np.ndarray:
    """The state at the time `at` (s) by the measurements near it, (coordinates,); 0 where they do not tell.

    By a parabola through the points that are less than `span` (s) away, at least some: a velocity that is not measured
    is the slope of its position.
    """
    rows = {c.observe.number: i for i, c in enumerate(record.channels) if isinstance(c.observe, MeasuredCoordinate)}
    names = [coordinate.name for coordinate in system.coordinates]
    guess = np.zeros(len(names))
    for number, name in enumerate(names):
        integral = name.replace("angular velocity", "angle").replace("velocity", "position")
        is_own = number in rows
        if not is_own and (integral == name or integral not in names or names.index(integral) not in rows):
            continue
        values = record.values[rows[number if is_own else names.index(integral)]]
        there = np.flatnonzero(np.isfinite(values))
        far = np.abs(record.times[there] - at)
        near = there[np.argsort(far, kind="stable")[: max(_NEAR, np.count_nonzero(far < span))]]
        if len(near) < 2:
            continue
        *_, slope, level = np.polyfit(record.times[near] - at, values[near], min(2, len(near) - 1))
        guess[number] = level if is_own else slope
    return guess


# The arguments that `calibrate` and `log_likelihood` share, checked.


def asked(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    noise: Mapping[str, float] | None,
    y0: InitialState | None,
    observe: Mapping[str, Observer] | None,
    method: Exact | Regularized,
) -> tuple[Arguments, np.ndarray, Record]:
    """What is simulated, with a method that has derivatives; the state at t = 0; and what was measured.

    Raises ValueError for arguments that do not fit.
    """
    checks.bounded("times", times, "s", at_least=0, ndim=1)
    at = np.asarray(times, float)
    if len(at) < 2 or not np.all(np.diff(at) > 0):
        raise checks.refused("times", "be at least two increasing times from 0 on (in s)", times)
    arguments, start = Arguments.of_one(system, base, method, float(at[-1]), y0)
    if isinstance(method, Exact):  # smoothed friction follows a realisation, which has no numbers to estimate
        arguments = arguments._replace(base=base)
    elif method.step is None and method.adjoint is None:
        arguments = arguments._replace(method=dataclasses.replace(method, adjoint=diffrax.ForwardMode()))

    # The measurements; times at which nothing was measured are left out.
    if not isinstance(measured, Mapping) or not measured:
        hint = 'such as {"position": x}'
        raise checks.refused("measured", "be a dict with an array for each channel", measured, hint)
    own = {} if observe is None else observe
    if not isinstance(own, Mapping) or not all(callable(function) for function in own.values()):
        raise checks.refused("observe", "be a dict with a function of simulation and times for each name", observe)
    known = known_channels(system) | {name: Channel(name, "", function) for name, function in own.items()}
    if unknown := [name for name in measured if name not in known]:
        raise ValueError(
            f"Argument measured must have channels called {checks.one_of(map(repr, known_channels(system)))}, or "
            f"names of functions in observe, but {unknown[0]!r} was given."
        )
    values = np.empty((len(measured), len(at)))
    for row, (name, column) in enumerate(measured.items()):
        array = checks.numbers(f"measured[{name!r}]", column)
        if array.shape != at.shape or np.any(np.isinf(array)):
            demand = f"hold one number for each of the {len(at)} times, NaN where nothing was measured"
            raise checks.refused(f"measured[{name!r}]", demand, column)
        values[row] = array
    if unused := [name for name in own if name not in measured]:
        raise ValueError(f"Argument observe must name channels of measured, but {unused[0]!r} is none of them.")
    given = checked_noise(noise, measured)
    for name in given:
        checks.positive(f"noise[{name!r}]", given[name])
    kept = np.any(np.isfinite(values), axis=0)
    if np.count_nonzero(np.isfinite(values)) < 3:
        raise ValueError("Argument measured must hold at least three numbers, but all others are NaN.")
    deviations = np.array([float(given.get(name, np.nan)) for name in measured])
    record = Record(at[kept], tuple(known[name] for name in measured), values[:, kept], deviations)
    return arguments, np.array(start, float), record


# Whether residuals are white noise.


_MOST_LAGS = 20
_FEWEST = 20  # residuals


def whiteness(name: str, residuals: np.ndarray) -> HypothesisTest:
    """Test of Ljung and Box (1978, Biometrika 65, 297): whether residuals in the order of time are uncorrelated.

    Args:
        name: Of the channel.
        residuals: (times,); NaN, where nothing was measured, is left out.

    Returns:
        The test; its effect is the largest autocorrelation.
    """
    there = residuals[np.isfinite(residuals)]
    number = len(there)
    if number < _FEWEST or not np.any(there):
        return HypothesisTest(f"Ljung-Box, {name}", sizes=(number,), reason=f"fewer than {_FEWEST} residuals")
    lags = min(_MOST_LAGS, number // 5)
    centred = there - there.mean()
    power = centred @ centred
    correlation = np.array([centred[lag:] @ centred[:-lag] for lag in range(1, lags + 1)]) / power
    statistic = number * (number + 2) * np.sum(correlation**2 / (number - np.arange(1, lags + 1)))
    largest = correlation[np.argmax(np.abs(correlation))]
    p_value = float(stats.chi2.sf(statistic, lags))
    title = f"Ljung-Box over {lags} lags, {name}"
    return HypothesisTest(title, float(statistic), p_value, float(largest), "largest autocorrelation", sizes=(number,))
