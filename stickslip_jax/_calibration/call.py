"""`calibrate`: numbers of a system and its base from a record of motion, with their errors, and what to know about
them.
"""

import dataclasses
import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import linalg, stats

from .._dynamics.common.method import EXACT, Arguments, Exact, Regularized, slowest_time
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.processes import require_threads_of_jax
from .._foundation.types import InitialState
from .._statistics.distribution import wrapped
from .._statistics.estimate import Estimate, correlated_estimates
from .._statistics.independence import HypothesisTest
from .._systems.system import System, unit_at
from .._uncertainty.numbers import NumberPath, Parameter, parameters_of, with_numbers
from .information import SHARE, Bounds, all_bounds, explanations, information_of, other_units
from .parameters import Transform, covariance_of, transform_of
from .problem import EstimatedNumbers, Sensor
from .record import Observer, Record, Windows, asked, whiteness
from .search import FoundFit, Search, as_one, chi_squared, fitted

# The result of a calibration.


@dataclasses.dataclass(frozen=True, repr=False)
class Calibration:
    """Numbers estimated from a record of motion by `calibrate`, with their errors.

    ``found["mu"]`` is the `Estimate` of a number, which can be computed with: estimates of one calibration know how
    they are correlated.

    - `estimates`: by name. The standard errors hold for white noise. That of a number that
      the record does not tell is infinite, and it is printed as not determined.
    - `covariance`: of the estimates in their order, (numbers, numbers), for white noise.
    - `covariance_by_blocks`: the same from the scatter of 40 parts of the record, which are taken as independent: for
      residuals that are not white.
    - `bounds`: the smallest and the largest value that the record allows, each with 95 % confidence by the profile of
      the likelihood, None where there is none, of each number on which the motion does not depend at its first guess,
      such as the friction coefficient of a mass that never slips, of each that is less than three standard errors
      away from a bound of its own, such as a damping near zero: its error is to one side there; and of each whose
      standard error does not tell how far it can go, because a slip appears within it, or because it is large. Static
      friction that is fitted together with kinetic friction has bounds of the difference, "mu_static - mu", up to ten
      standard errors away.
    - `system`, `base`: with the estimates in place; of a number that the record does not tell, its first guess.
    - `start`: the estimated state at the first measurement, by the names of the coordinates; None where `y0` was given,
      or where several windows were fitted.
    - `start_times` (s, (windows,)) and `start_states` (windows, coordinates): where the fitted motions begin.
    - `channels`: the names of what was measured. `times`: of the measurements, s, (times,).
    - `measured`, `fitted`, `residuals` (measured less fitted): (channels, times), in the channels' units, NaN where
      nothing was measured.
    - `units`: of the channels, "" where not known.
    - `noise`: standard deviation of each channel, by name; given, or estimated from the residuals.
    - `chi_squared`, `degrees_of_freedom`: the sum of squares of the standardised residuals, and what it should be near.
    - `whiteness`: a test of each channel's residuals, by name (Ljung and Box).
    - `converged`: whether the search did. `remarks`: what to know about the result, sentences.
    """

    estimates: dict[str, Estimate]
    covariance: np.ndarray
    covariance_by_blocks: np.ndarray
    bounds: dict[str, Bounds]
    system: System
    base: BaseMotion
    start: dict[str, Estimate] | None
    start_times: np.ndarray
    start_states: np.ndarray
    channels: tuple[str, ...]
    units: tuple[str, ...]
    times: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    noise: dict[str, float]
    noise_is_known: dict[str, bool]
    chi_squared: float
    degrees_of_freedom: int
    whiteness: dict[str, HypothesisTest]
    converged: bool
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of one number."""
        return self.estimates[name]

    @property
    def residuals(self) -> np.ndarray:
        return self.measured - self.fitted

    @property
    def windows(self) -> int:
        """How many motions were fitted, each with a start of its own."""
        return len(self.start_times)

    def __repr__(self) -> str:
        number = np.count_nonzero(np.isfinite(self.measured))
        lines = [
            f"Calibration from {number:,} measurements over {np.ptp(self.times):g} s"
            + ("" if self.windows == 1 else f", in {self.windows} windows")
            + ("" if self.converged else ", NOT CONVERGED")
        ]
        for name, one in self.estimates.items():
            limits = self.bounds[name].in_words if name in self.bounds and math.isfinite(one.standard_error) else ""
            said = f" ({limits}, 95 % confidence each)" if limits else ""
            lines.append(f"  {name} = {one.without_name()}{said}")
        for name, bounds in self.bounds.items():
            if name not in self.estimates:  # a difference
                lines.append(f"  {name}: {bounds.in_words or 'no bounds'}, 95 % confidence each")
        for name in self.channels:
            kind = "given" if self.noise_is_known[name] else "estimated"
            test = self.whiteness[name]
            white = f"residuals white: p = {test.p_value:.2g}" if test.made else f"no test of residuals: {test.reason}"
            lines.append(f"  noise of {name}: {self.noise[name]:.3g} ({kind}), {white}")
        lines.append(f"  chi-squared {self.chi_squared:.1f} for {self.degrees_of_freedom} degrees of freedom")
        return "\n".join([*lines, *(wrapped(remark, "  ", "  ") for remark in self.remarks)])


# From a fit to its result: estimates with their errors, and what to know about them.


_VAGUE = 3.0  # standard error of an initial state, in its unit, beyond which the record does not tell it
_WITHOUT_NOISE = (
    1e-6  # of a channel's standard deviation: smaller residuals are what the search leaves, and never white
)
_SIGNIFICANCE = 0.001  # at which residuals are called too large, or not white


def result_of(
    record: Record,
    arguments: Arguments,
    parameters: tuple[Parameter, ...],
    found: FoundFit,
    start: np.ndarray | None,
    given_up: float | None,
) -> Calibration:
    """The result of a fit.

    `start`: the state at t = 0 if it is known. `given_up`: by how much chi-squared grew where one motion over the whole
    record failed.
    """
    problem, fit, _, sigma = found
    transform, seen = problem.model.transform, fit.seen.over(sigma)
    number, size = len(parameters), fit.point.s.shape[1]
    is_one = len(fit.point.s) == 1
    with_start = is_one and start is None
    own = _without_states(seen, number) if is_one and not with_start else seen
    told = information_of(own, number)
    joint = information_of(own, number + size) if with_start else told
    numbers = transform.numbers(fit.point.x)
    slope = np.asarray(linalg.block_diag(transform.slopes(numbers), np.eye(size * with_start)))
    states_searched = 0 if is_one and not with_start else fit.point.s.size
    freedom = int(record.counts.sum()) - number - states_searched + told.lost
    known = {channel.name: bool(np.isfinite(one)) for channel, one in zip(record.channels, record.noise, strict=True)}
    found_bounds, is_told = all_bounds(
        problem, sigma, fit, found.free, told, np.inf if all(known.values()) else float(max(freedom, 1))
    )
    is_told = np.concatenate([is_told, np.diag(joint.covariance)[number:] < _VAGUE**2])
    covariance, by_blocks = (covariance_of(slope, matrix, is_told) for matrix in (joint.covariance, joint.by_blocks))
    setting = EstimatedNumbers(arguments.system, arguments.base, sensors=problem.model.setting.sensors)
    states = np.asarray(problem.model.state_origin) + fit.point.s
    coordinates = arguments.system.coordinates
    names = [parameter.name for parameter in parameters] + [one.name for one in coordinates] * with_start
    units = [_unit(setting, record, one) for one in parameters] + [one.unit for one in coordinates] * with_start
    values = np.concatenate([numbers, states[0] * with_start if with_start else []])
    estimates = correlated_estimates(names, values, units, covariance, max(freedom, 1) + 1)
    windows = Windows(*map(np.asarray, problem.windows))
    fitted = record.values + windows.in_order(fit.seen.residuals, record)
    tests = {
        channel.name: whiteness(channel.name, row)
        for channel, row in zip(record.channels, record.values - fitted, strict=True)
    }
    has_noise = sigma > _WITHOUT_NOISE * np.nanstd(record.values, axis=1)
    noisy = {
        channel.name: tests[channel.name] for channel, is_so in zip(record.channels, has_noise, strict=True) if is_so
    }
    of_bounds = _names_of_bounds(names[:number], transform)
    bounds = {of_bounds[i]: one for i, one in found_bounds.items()}
    total = chi_squared(seen)
    system, base, *_ = with_numbers(setting, [one.path for one in parameters], [float(value) for value in numbers])
    coloured = [name for name, test in noisy.items() if test.made and test.p_value < _SIGNIFICANCE]
    wrong = []
    if coloured:
        wrong = explanations(record, windows, own, sigma, number)
        wrong += other_units(record, arguments, start if start is not None else np.zeros(size))
    return Calibration(
        estimates=dict(zip(names[:number], estimates[:number], strict=True)),
        covariance=covariance[:number, :number],
        covariance_by_blocks=by_blocks[:number, :number],
        bounds=bounds,
        system=system,
        base=base,
        start=dict(zip(names[number:], estimates[number:], strict=True)) if with_start else None,
        start_times=np.asarray(windows.begins),
        start_states=states,
        channels=tuple(channel.name for channel in record.channels),
        units=tuple(channel.unit for channel in record.channels),
        times=record.times,
        measured=record.values,
        fitted=fitted,
        noise={channel.name: float(one) for channel, one in zip(record.channels, sigma, strict=True)},
        noise_is_known=known,
        chi_squared=total,
        degrees_of_freedom=freedom,
        whiteness=tests,
        converged=fit.converged,
        remarks=(
            *(() if fit.converged else ("The search did not converge: do not use its numbers.",)),
            *_about_colour(coloured, wrong),
            *_about_bounds(of_bounds, transform, fit.point.x, found_bounds, is_told),
            *_about_ties(names[:number], numbers, told.tied @ slope[:number, :number].T),
            *_about_fit(total, freedom, all(known.values()), given_up, len(fit.point.s)),
        ),
    )


def _without_states(seen: Any, number: int) -> Any:
    return seen._replace(slopes=seen.slopes[..., :number])


def _names_of_bounds(names: list[str], transform: Transform) -> list[str]:
    """What the bounds of each number are of: it, or how much it is above the one from which it is counted."""
    return [
        name if not np.any(from_) else f"{name} - {names[int(np.argmax(from_))]}"
        for name, from_ in zip(names, np.asarray(transform.added), strict=True)
    ]


def _about_bounds(
    names: list[str], transform: Transform, x: np.ndarray, bounds: dict[int, Bounds], is_told: np.ndarray
) -> list[str]:
    """Sentences on numbers that the record does not tell, and on those at their bounds."""
    said, own = [], transform.own(x)
    for i, of in bounds.items():
        ends = of.in_words
        limit = f"it is {ends} (95 % confidence each)" if ends else "it gives no bound either"
        if ends and any(x[i] == end[i] for end in transform.box):
            said.append(f"{names[i]} is at its bound, {own[i]:.4g}, where its error is to one side only: {limit}.")
        elif not is_told[i]:
            said.append(
                f"The motion hardly depends on {names[i]} near {own[i]:.2g}, so the record does not tell it: {limit}."
            )
    return said


def _about_ties(names: list[str], numbers: np.ndarray, directions: np.ndarray) -> list[str]:
    """Sentences on numbers that the record tells together only; directions (directions, parameters) of them."""
    said = []
    for direction in directions:
        change = direction / np.where(numbers == 0, 1, numbers)
        if not np.any(np.abs(change) > 0):
            continue
        change = change / np.max(np.abs(change))
        parts = [f"{name} by {100 * share:+.0f} %" for name, share in zip(names, change, strict=True)
                 if abs(share) > SHARE]  # fmt: skip
        said.append(
            f"The record does not tell these apart: changing {', '.join(parts)} (in these ratios) leaves the motion "
            "as it is; fix one of them."
        )
    return said


def _about_fit(total: float, freedom: int, is_known: bool, given_up: float | None, windows: int) -> list[str]:
    """Sentences on the residuals, and on windows."""
    said = []
    if given_up is not None:
        said.append(
            f"One motion over the whole record would raise chi-squared by {given_up:.4g}: each of {windows} windows "
            "has a start of its own."
        )
    if is_known and freedom > 0 and stats.chi2.sf(total, freedom) < _SIGNIFICANCE:
        said.append("Chi-squared is larger than the given noise allows: the model lacks something, or noise is larger.")
    return said


def _about_colour(channels: list[str], wrong: list[str]) -> list[str]:
    """Sentences on residuals of `channels` that are not white; `wrong`: what may be the cause."""
    if not channels:
        return []
    return [
        f"The residuals of {' and '.join(channels)} are not white. First of all the model, a clock, a zero or a unit "
        "may be wrong, and then so are the numbers, by more than any of the errors: see plot.calibration, and search "
        '"clock.delay" or a channel\'s ".delay" or ".offset". Only if the model is right and the noise lasts, use '
        "covariance_by_blocks.",
        *wrong,
    ]


def _unit(setting: EstimatedNumbers, record: Record, parameter: Parameter) -> str:
    """The unit of a number of the system, the base, or a channel's sensor."""
    kind, *_, last = parameter.path
    if kind == "sensors" and last == "offset":
        return record.channels[int(parameter.path[1])].unit or "1"
    return unit_at(setting, parameter.path)


# `calibrate`: numbers of a system and its base from a record of motion.


_PERIODS = 2.0  # of the slowest known time scale, in a window
_FEWEST = 12  # measurements in a window
_MOST_WINDOWS = 128
_DELAYED, _DELAYED_TIME = 0.05, 0.25  # of the record, and of the slowest known time scale: the longest delay searched


def calibrate(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    *,
    wrt: str | tuple[str, ...] | list[str],
    noise: Mapping[str, float] | None = None,
    y0: InitialState | None = None,
    windows: int | None = None,
    observe: Mapping[str, Observer] | None = None,
    method: Exact | Regularized = EXACT,
) -> Calibration:
    """Estimate numbers of a system and its base from a record of motion, by maximum likelihood.

    The motion is simulated exactly, with exact derivatives; noise is independent, Gaussian, and of one standard
    deviation in each channel. Long records are cut into windows, in each of which the motion starts anew from a state
    that is estimated too (multiple shooting): one motion over the whole record would be far from it in the end, until
    the numbers are nearly right. From there one motion over the whole record is fitted, and is the result if the record
    allows it; chaotic motions, and those that something unknown disturbs, are left in windows.

    Args:
        system: With first guesses of the numbers.
        base: What drives it, as for `simulate`: a motion without randomness, measured ones as a `Recorded`.
        times: Of the measurements, s, increasing, from 0 on, (times,); they need not be equally spaced.
        measured: What was measured, (times,) each, NaN where it was not. By the names of the system's coordinates
            ("position" in m, "velocity" in m/s; "angle", "current", "position 2", ...), as "acceleration" (m/s^2;
            where a coordinate is called "velocity 2", "acceleration 2"), as "friction force" (N), or by the names in
            `observe`. Accelerations and friction forces jump where a stick begins or a slip reverses, and the search
            does not see how a jump moves past a measurement: set those next to jumps to NaN, and measure positions too.
        wrt: The names of the numbers to be estimated, as for `sensitivity`: those of fields of the system or the base,
            such as "mu" or "friction.forward.mu". They stay inside the bounds of these fields: positive ones are
            searched by their logarithms, those that may be zero are found there, and `mu_static` is never below `mu`.
            Of the sensors too: "clock.delay" (s) of the whole record, "position.delay" (s) and "position.offset" of a
            channel, which shows what it measures so much later, and so much more. Of the record so much is left out
            at both ends as a delay may be long: 5 % of it, or a quarter of the slowest known time scale.
        noise: The standard deviation of the noise of each channel, in its unit; of those left out it is estimated.
        y0: The state at t = 0, where it is known; it is estimated otherwise (None).
        windows: How many. By default as many as have two periods of the system's slowest known time scale, and then
            one, as said above. With several, `y0` is not used.
        observe: A function of simulation (a `Simulation`, which begins where its window does) and times (s, (times,))
            for each channel with a name of its own, in JAX.
        method: As for `simulate`. With `Regularized` there is one window, which begins at t = 0.

    Returns:
        The estimates, with their errors; print it. Warns (RuntimeWarning) with each of its remarks: of numbers that the
        record does not tell (their error is infinite), of numbers at their bounds, of residuals that are not white,
        with what may be wrong, and of a search that did not converge.

    Raises:
        ValueError: For arguments outside these bounds, for names that fit no number, for measurements that are all the
            same without their noise, and for a first guess from which
            no motion reaches the end of its window.

    >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    >>> base = ss.Harmonic(0.8, 1.3)
    >>> times = jax.numpy.linspace(0.0, 9.9, 100)
    >>> seen = ss.simulate(system, base, t1=10.0, y0=(0.3, 0.0)).evaluate(times)[0]
    >>> guess = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
    >>> found = ss.calibrate(guess, base, times, {"position": seen}, wrt="mu")
    >>> print(f"mu = {found['mu'].value:.6f}")
    mu = 0.700000
    """
    require_threads_of_jax()
    search = _checked(system, base, times, measured, wrt, noise, y0, observe, method)
    if isinstance(method, Regularized) and windows not in (None, 1):
        raise checks.refused("windows", "be 1 with the method Regularized", windows)
    number = (
        _usual_windows(search)
        if windows is None
        else checks.whole_number("windows", windows, maximum=len(search.record.times))
    )
    found = fitted(search, search.cuts(number), np.zeros(len(search.parameters)))
    given_up = None
    if windows is None and found.problem.windows.begins.shape[0] > 1:
        whole = as_one(search, found)
        given_up = None if isinstance(whole, FoundFit) else whole
        found = whole if isinstance(whole, FoundFit) else found
    done = result_of(search.record, search.arguments, search.parameters, found, search.y0, given_up)
    for remark in done.remarks:
        warnings.warn(remark, RuntimeWarning, stacklevel=2)
    return done


def _checked(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    wrt: object,
    noise: Mapping[str, float] | None,
    y0: InitialState | None,
    observe: Mapping[str, Observer] | None,
    method: Exact | Regularized,
) -> Search:
    arguments, start, record = asked(system, base, times, measured, noise, y0, observe, method)
    setting, parameters = _setting_and_parameters(arguments, record, wrt)
    transform = transform_of(setting, parameters)
    if setting.sensors:
        record, transform = _with_sensors(record, arguments, parameters, transform)
    for channel, row, sigma in zip(record.channels, record.values, record.noise, strict=True):
        if np.isnan(sigma) and not np.nanmax(row, initial=-np.inf) > np.nanmin(row, initial=np.inf):
            raise ValueError(
                f"Argument noise must give the standard deviation of {channel.name!r}, whose measurements are all the "
                f'same, so that it cannot be estimated: noise={{"{channel.name}": ...}}.'
            )
    return Search(record, arguments, parameters, transform, None if y0 is None else start, setting)


def _setting_and_parameters(
    arguments: Arguments, record: Record, wrt: object
) -> tuple[EstimatedNumbers, tuple[Parameter, ...]]:
    """Where the numbers stand, and those named by `wrt`: of system and base, and offsets and delays."""
    own: dict[str, NumberPath] = {"clock.delay": ("clock", "delay")}
    for i, channel in enumerate(record.channels):
        own |= {f"{channel.name}.{kind}": ("sensors", i, kind) for kind in ("delay", "offset")}
    where = {"system": arguments.system, "base": arguments.base}
    names = (wrt,) if isinstance(wrt, str) else wrt
    if not isinstance(names, (tuple, list)) or not any(name in own for name in names if isinstance(name, str)):
        return EstimatedNumbers(arguments.system, arguments.base), parameters_of(where, wrt)
    others = tuple(name for name in names if name not in own)
    if len(set(names)) < len(names):
        raise checks.refused("wrt", "be a parameter's name or several different ones", wrt)
    known = {one.name: one for one in parameters_of(where, others)} if others else {}
    parameters = tuple(known.get(name) or Parameter(name, own[name], 0.0) for name in names)
    sensors = tuple(Sensor() for _ in record.channels)
    return EstimatedNumbers(arguments.system, arguments.base, sensors=sensors), parameters


def _with_sensors(
    record: Record, arguments: Arguments, parameters: tuple[Parameter, ...], transform: Transform
) -> tuple[Record, Transform]:
    """The record, less what is too near to its ends for delays to be searched, and offsets and delays in their units.

    Raises ValueError where too little is left.
    """
    spread = np.nanstd(record.values, axis=1)
    low, high, closed, scale = (np.array(one) for one in transform[1:5])
    slowest = slowest_time(arguments.system, arguments.base)
    longest = min(_DELAYED * float(np.ptp(record.times)), _DELAYED_TIME * slowest)
    for i, parameter in enumerate(parameters):
        if parameter.path[-1] == "offset" and parameter.path[0] == "sensors":
            scale[i] = spread[parameter.path[1]] or 1.0  # pyright: ignore[reportArgumentType, reportCallIssue]
        elif parameter.path[0] in ("clock", "sensors"):
            low[i], high[i], closed[i], scale[i] = -longest, longest, 1.0, 2 * longest
    delays = [parameter.path[0] for parameter in parameters if parameter.path[-1] == "delay"]
    if delays and {"clock", "sensors"} <= set(delays) and delays.count("sensors") == len(record.channels):
        raise ValueError(
            'Argument wrt must leave one channel without a delay of its own if "clock.delay" is searched, which delays '
            "all of them."
        )
    kinds = sum(kind in delays for kind in ("clock", "sensors"))
    record = record._replace(reach=kinds * longest * (1 + 1e-9))
    if kinds and record.counts.sum() < 3:
        raise ValueError(
            f"Argument times must hold measurements more than {record.reach:.3g} s away from the ends of the record if "
            "delays are searched, which need the motion before and after a measurement, but it holds fewer than three."
        )
    return record, transform._replace(low=low, high=high, closed=closed, scale=scale)


def _usual_windows(search: Search) -> int:
    """As many windows as have some periods of the slowest time scale, and enough measurements."""
    system, base, method, t1 = search.arguments
    if isinstance(method, Regularized):
        return 1
    by_time = (t1 - search.record.times[0]) / (_PERIODS * slowest_time(system, base))
    by_number = len(search.record.times) / _FEWEST
    return int(np.clip(min(by_time, by_number), 1, _MOST_WINDOWS))
