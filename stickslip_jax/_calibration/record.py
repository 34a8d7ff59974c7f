"""A measured motion: its channels, their noise and its cut into windows; the arguments about it, checked; whether what
is left of it is white noise; and the sticks in a measured speed.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, TypeAlias

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


# Sticks in a measured speed: the speed stays below a threshold for long enough.
#
# Between its samples the speed is linear, so that it is slow from where the straight line enters the band between
# -threshold and threshold until it leaves it. A stick from a to b is then found to begin after
# ``a - (time in which the speed last fell from the threshold to zero) - (one step)``, since a sample lies within a step
# before the speed was at the threshold, and before ``a + (one step)``, since all samples in the stick are zero; its end
# likewise. What only passes through zero is slow for ``2 threshold / acceleration``, which no threshold can tell from a
# stick: the least duration does.


_FEWEST_STEPS = 2  # that a stick lasts at least by default
_GAP = 3  # median steps: what is longer is a gap
_AROUND = 2.0 ** (np.arange(-6, 7) / 2)  # thresholds that are compared, over the one that is chosen
_ALIKE = 0.1  # relative differences of numbers of sticks and of mean durations on a plateau, at most


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class RecordedSticks:
    """The sticks that `sticks_of_record` found: a table for ``Ensemble.from_sticks``, and how it depends on the choice.

    ``ss.Ensemble.from_sticks(found, t1=found.t1, samples=found.samples)`` is the ensemble of them.

    - `sample`, `start`, `end`: of each stick, the number of its record, from 0, and its instants from the beginning of
      that, s, (sticks,). ``found["start"]`` is the same; `columns` are their names.
    - `t1`: the duration of each record, s, the shortest one. `samples`: how many records.
    - `threshold` (m/s), `minimum_duration` (s): those used.
    - `thresholds` (m/s), `counts`, `mean_durations` (s): how many sticks other thresholds would find, from an eighth to
      eight times that used, and how long they last on average (NaN if there are none), (13,).
    """

    sample: np.ndarray
    start: np.ndarray
    end: np.ndarray
    t1: float
    samples: int
    threshold: float
    minimum_duration: float
    thresholds: np.ndarray
    counts: np.ndarray
    mean_durations: np.ndarray
    columns: ClassVar = ("sample", "start", "end")

    def __getitem__(self, column: str) -> np.ndarray:
        return {name: getattr(self, name) for name in self.columns}[column]

    @property
    def plateau(self) -> tuple[float, float]:
        """The thresholds (m/s) around that used, the least and the largest of `thresholds` up to which numbers of
        sticks and mean durations are within 10 % of those found.
        """
        table, own = np.stack([self.counts, self.mean_durations]), len(_AROUND) // 2
        differ = np.any(~(np.abs(table - table[:, own, None]) <= _ALIKE * table[:, own, None]), axis=0)
        differ[own] = False
        ends = np.array([-1, *np.flatnonzero(differ), len(_AROUND)])
        after = np.searchsorted(ends, own)
        return float(self.thresholds[ends[after - 1] + 1]), float(self.thresholds[ends[after] - 1])

    def __repr__(self) -> str:
        used = f"|speed| <= {self.threshold:g} m/s for at least {self.minimum_duration:g} s"
        table = zip(self.thresholds[::2], self.counts[::2], self.mean_durations[::2], strict=True)
        least, most = self.plateau
        is_plateau = least <= self.threshold / 2 and most >= self.threshold * 2
        found = "A plateau:" if is_plateau else "No plateau, the sticks depend on the threshold: only"
        return "\n".join(
            [
                f"{len(self.start)} sticks in {self.samples} x {self.t1:g} s: {used}",
                "threshold (m/s)  sticks  mean duration (s)",
                *("{:15.4g}  {:6d}  {:17.4g}".format(*row) for row in table),
                f"{found} from {least:.3g} to {most:.3g} m/s both change by at most {_ALIKE:.0%}.",
            ]
        )


def sticks_of_record(
    times: npt.ArrayLike | Sequence[npt.ArrayLike],
    speed: npt.ArrayLike | Sequence[npt.ArrayLike],
    threshold: float,
    minimum_duration: float | None = None,
) -> RecordedSticks:
    """The sticks in measured speeds: times in which the speed stays at or below a threshold, for long enough.

    Between its samples the speed is linear. A stick is then found to begin at most one step before the speed fell below
    the threshold, and at most one step after it began; and to end likewise. Choose a threshold above the noise, on a
    plateau: printed, the result says how many sticks other thresholds find, and whether there is one. A speed that only
    passes through zero is below the threshold for ``2 threshold / acceleration``: a `minimum_duration` above that
    leaves it out. The words are those of `Regularized`.

    Args:
        times: s, increasing, (times,), at least 2: the same for all records, or (records, times), or a list.
        speed: The relative velocity, m/s, of either sign, (times,); of several records (records, times), or a list of
            arrays. All must last equally long, but for a step.
        threshold: The largest speed in a stick, m/s, positive.
        minimum_duration: The shortest time below it that counts as a stick, s, zero or positive; by default two steps
            (the median of all).

    Returns:
        A `RecordedSticks`, which `Ensemble.from_sticks` takes. What the end of the record cuts ends there.

    Raises:
        ValueError: For numbers out of range; for a speed that is NaN or infinite somewhere; for a gap, a step of more
            than three times the median; and for records of different durations.

    >>> times, speed = range(8), [0.3, 0.1, 0.0, 0.0, 0.0, 0.0, -0.1, -0.3]
    >>> found = ss.sticks_of_record(times, speed, threshold=0.01)
    >>> print(found.start, found.end)
    [1.9] [5.1]
    """
    checks.positive("threshold", threshold, "m/s")
    if minimum_duration is not None:
        checks.non_negative("minimum_duration", minimum_duration, "s")
    records = _records_of(times, speed)
    steps = np.concatenate([np.diff(at) for at, _ in records])
    least = _FEWEST_STEPS * float(np.median(steps)) if minimum_duration is None else float(minimum_duration)
    durations = [float(at[-1]) for at, _ in records]
    t1, longest = min(durations), max(durations)
    if longest - t1 > np.max(steps):
        raise checks.refused("times", f"last equally long, not {t1:g} to {longest:g} s", times, "cut the longer")

    def found(threshold: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slow = [_slow_times(at, values, threshold) for at, values in records]
        sample = np.repeat(np.arange(len(slow)), [len(start) for start, _ in slow])
        start, end = (np.concatenate(column) for column in zip(*slow, strict=True))
        end = np.minimum(end, t1)
        kept = (end - start >= least) & (end > start)
        return sample[kept], start[kept], end[kept]

    thresholds = float(threshold) * _AROUND
    sticks = [found(value) for value in thresholds]
    counts = np.array([len(start) for _, start, _ in sticks])
    means = np.array([np.mean(end - start) if len(start) else np.nan for _, start, end in sticks])
    own = sticks[len(_AROUND) // 2]
    return RecordedSticks(*own, t1, len(records), float(threshold), least, thresholds, counts, means)


def _records_of(times: Any, speed: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """The times, from 0 on, and the speeds of each record. Raises ValueError for what is none."""
    listed = []
    for name, given in (("times", times), ("speed", speed)):
        checks.tree(name, given)
        dimensions = checks.dimensions(given)
        if dimensions != 1 and not (isinstance(given, (list, tuple)) or dimensions == 2):
            raise checks.refused(name, "be an array of numbers, or one of each record", given)
        listed.append([(name, given)] if dimensions == 1 else [(f"{name}[{i}]", one) for i, one in enumerate(given)])
    if len(listed[0]) == 1:
        listed[0] *= len(listed[1])
    if not listed[1] or len(listed[0]) != len(listed[1]):
        raise checks.refused("times", f"be given once, or for each of {len(listed[1])} records of speed", times)
    records = []
    for (name, at), (of_speed, values) in zip(*listed, strict=True):
        checks.bounded(name, at, "s", ndim=1)
        seconds, own = np.asarray(at, float), checks.numbers(of_speed, values, 1).astype(float)
        if len(seconds) < 2 or own.shape != seconds.shape:
            raise checks.refused(of_speed, f"hold one number for each of at least two {name}", values)
        steps, wrong = np.diff(seconds), ~(np.abs(own) <= checks.LARGEST)
        if not np.all(steps > 0):
            raise checks.refused(name, "increase", at, "leave out what was recorded twice")
        longest, usual, todo = int(np.argmax(steps)), float(np.median(steps)), "make a record of either side, or"
        if steps[longest] > _GAP * usual:
            found = f"{steps[longest]:g} s follow {seconds[longest]:g} s, and a step is {usual:g} s"
            raise ValueError(f"Argument {name} must have no gap, but {found}; {todo} interpolate it to equal steps.")
        if np.any(wrong):
            found = f"at {seconds[np.argmax(wrong)]:g} s it is {own[np.argmax(wrong)]}"
            raise ValueError(f"Argument {of_speed} must be finite, but {found}; {todo} interpolate what is short.")
        records.append((seconds - seconds[0], own))
    return records


def _slow_times(at: np.ndarray, speed: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """When the speed, linear between its samples, is at or below the threshold: starts and ends."""
    inside, change = np.abs(speed) <= threshold, np.diff(speed)
    slow = inside[:-1] | inside[1:] | (np.sign(speed[:-1]) * np.sign(speed[1:]) < 0)
    # Where the line through both ends of a step is at the edge that it enters by, and at that it leaves by.
    slope, edge = np.where(change != 0, change, 1), np.where(change < 0, -threshold, threshold)
    entry, exit_ = (np.clip((level - speed[:-1]) / slope, 0, 1) * np.diff(at) + at[:-1] for level in (-edge, edge))
    start = np.concatenate([at[:1][inside[:1]], entry[slow & ~inside[:-1]]])
    return start, np.concatenate([exit_[slow & ~inside[1:]], at[-1:][inside[-1:]]])
