"""`calibrate`: numbers of a system and its base from a record of motion, with their errors, and what to know about
them.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from scipy import linalg, optimize, stats

from .._dynamics.common.method import EXACT, Arguments, Exact, Regularized, slowest_time
from .._dynamics.simulate import simulate
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.types import InitialState
from .._statistics.distribution import wrapped
from .._statistics.estimate import Estimate, correlated_estimates
from .._statistics.independence import HypothesisTest
from .._systems.system import System, unit_at
from .._uncertainty.numbers import NumberPath, Parameter, parameters_of, with_numbers
from .parameters import Transform, covariance_of, transform_of
from .record import Observer, Record, Windows, asked, whiteness
from .search import LOOSE, EstimatedNumbers, FoundFit, Free, Residuals, Search, SearchPoint, Sensor, as_one, fitted

# What a record says about each number: covariances, and numbers that it does not tell.


_NO_INFLUENCE = 1e-9  # of all that the residuals depend on
_UNTOLD = 0.3  # standard error of what is searched: beyond it, that of a positive number says little
_ALONE = 0.05  # share of other numbers in a direction that is that of one number
_BLOCKS = 40  # parts of the record that are taken as independent


class Information(NamedTuple):
    """Covariance of the numbers searched, (numbers, numbers), for white noise and by blocks of the record.

    `untold`: which those are, (numbers,). `tied`: directions among several of them along which nothing changes,
    (directions, numbers); the other ones are untold each by itself. `lost`: how many states at starts, and directions
    among the numbers, nothing depends on.
    """

    covariance: np.ndarray
    by_blocks: np.ndarray
    untold: np.ndarray
    tied: np.ndarray
    lost: int


def information_of(seen: Residuals, number: int) -> Information:
    """What standardised residuals and their derivatives say of the first `number` numbers.

    The other ones, the states at the windows' starts, are taken out: each window's derivatives are projected on what
    its own state cannot explain. All numbers are loosely held where they are, as in the search.
    """
    matrix, lost = without_states(seen.slopes, number)
    inverse = np.linalg.inv(matrix.T @ matrix + LOOSE**2 * np.eye(number))
    variances, directions = np.linalg.eigh(inverse)
    untold, loose = np.diag(inverse) > _UNTOLD**2, directions.T[variances > _UNTOLD**2]
    tied = loose if len(loose) < np.count_nonzero(untold) else loose[:0]
    alone = np.sum(np.abs(tied) > _ALONE * np.max(np.abs(tied), axis=1, initial=0, keepdims=True), axis=1) == 1
    # The covariance of the gradient, from its parts by blocks of the record that are taken as independent.
    blocks = min(_BLOCKS, max(len(matrix) // 10, 2))
    along = matrix * seen.residuals.ravel()[:, None]
    parts = np.stack([part.sum(axis=0) for part in np.array_split(along, blocks)])
    scores = parts.T @ parts * blocks / max(blocks - 1, 1)
    return Information(inverse, inverse @ scores @ inverse, untold, tied[~alone], lost + len(loose))


def without_states(slopes: np.ndarray, number: int) -> tuple[np.ndarray, int]:
    """The part of the first `number` columns that the others, states at starts, cannot explain in their own window,
    (residuals, number), and how many of the others nothing depends on. `slopes` (windows, channels, times, columns).
    """
    columns = slopes.reshape(len(slopes), -1, slopes.shape[-1])
    of_numbers, lost = np.empty((*columns.shape[:2], number)), 0
    for window, both in enumerate(columns):
        own = orthonormal(both[:, number:])
        lost += both.shape[1] - number - own.shape[1]
        of_numbers[window] = both[:, :number] - own @ (own.T @ both[:, :number])
    return of_numbers.reshape(-1, number), lost


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what the columns span, (residuals, rank)."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > _NO_INFLUENCE] / size[size > _NO_INFLUENCE]
    return linalg.orth(columns, rcond=_NO_INFLUENCE) if columns.shape[1] else columns


# Bounds of numbers by the profile of the likelihood: of those on which the fitted motion does not depend, those near
# their own bound, and those whose standard error does not tell how far they can go.


LEVEL = 0.95
_FARTHEST_FIRST = np.log(2) / 2  # first step in the coordinate, at most
_DOUBLINGS = 6  # of the step: a factor of 4,000,000,000 of a number that is searched by its logarithm
_RESOLUTION = 1e-4  # of the first step
_NO_MOTION = 1e3  # in place of infinity


SHARE = 0.05  # of a direction, below which a number has no part in it
_NEAR = 3.0  # standard errors from a bound: farther away the estimate is normal
_NEAR_KINETIC = 10.0  # of static from kinetic friction, on whose square the motion depends there
_AS_NORMAL = 5.0  # times its largest distance that a number can go, up to which its standard error is believed
_AS_STRAIGHT = 1.1  # times the growth that the standard error promises, or one over it


class Bounds(NamedTuple):
    """The smallest and largest value that the record allows, each at 95 % confidence; None where there is none."""

    low: float | None
    high: float | None

    @property
    def in_words(self) -> str:
        """Such as "at least 1 and at most 2"; "" without any."""
        ends = zip(("at least", "at most"), self, strict=True)
        return " and ".join(f"{word} {one:.3g}" for word, one in ends if one is not None)


def all_bounds(found: FoundFit, told: Information, freedom: float) -> tuple[dict[int, Bounds], np.ndarray]:
    """The bounds by the record of the numbers, by place, that it does not tell, each by itself, of those near a bound
    that they may have, and of those around which chi-squared is no parabola; and which numbers the record tells,
    (parameters,). `freedom`: degrees of freedom of the noise, infinite where it is known: chi-squared may grow by the
    square of the 95 % quantile of Student's t with so many.

    Near its bound a number need not be known to 30 % to be told: the record only has to say how far away it can be.
    """
    at, transform, is_told = found.point, found.problem.model.transform, ~told.untold
    errors = np.sqrt(np.diag(told.covariance))
    slopes, own = np.diag(transform.slopes(transform.numbers(at.x))), transform.own(at.x)
    from_low, from_high = (
        np.where(np.isfinite(end), np.abs(own - np.asarray(bound)), np.inf)
        for end, bound in zip(transform.box, (transform.low, transform.high), strict=True)
    )
    far = np.where(np.any(np.asarray(transform.added) > 0, axis=1), _NEAR_KINETIC, _NEAR)
    is_near = np.minimum(from_low, from_high) < far * slopes * errors
    is_tied = np.any(np.abs(told.tied) > SHARE, axis=0)
    limit = float(stats.t.ppf(LEVEL, freedom))
    bounds = {}
    for i in np.flatnonzero(~is_tied):
        if not (told.untold[i] or is_near[i]):
            change = limit * told.covariance[i] / errors[i]
            if not found.converged or not _is_bent(found, int(i), slopes[i] * errors[i], change):
                continue
        bounds[int(i)] = _bounds_of(found, int(i), errors[i], limit)
        end = bounds[int(i)][int(from_low[i] <= from_high[i])]
        if is_near[i] and end is not None:
            is_told[i] = slopes[i] * errors[i] < _AS_NORMAL * abs(end - own[i])
    return bounds, is_told


def _is_bent(found: FoundFit, which: int, error: float, change: np.ndarray) -> bool:
    """Whether the root of what chi-squared grows by is another one than the standard `error` of a number promises.

    So it is where a slip or a stick appears within the error, or where this is large. Looked at on both sides of the
    number `which`, where the coordinates `change` so, to first order to keep chi-squared least; the starts too.
    """
    at, seen, transform = found.point, found.seen, found.problem.model.transform
    number = len(at.x)
    slopes = seen.slopes.reshape(len(at.s), -1, seen.slopes.shape[-1])
    starts = np.zeros_like(at.s)
    if found.free.s:
        starts = np.stack([-np.linalg.lstsq(one[:, number:], one[:, :number] @ change)[0] for one in slopes])
    for sign in (1.0, -1.0):
        beside = SearchPoint(np.clip(at.x + sign * change, *transform.box), at.s + sign * starts)
        promised = abs(transform.own(beside.x)[which] - transform.own(at.x)[which]) / error
        grown = np.sqrt(max(found.problem.seen(beside).over(found.sigma).chi_squared - seen.chi_squared, 0))
        if not promised / _AS_STRAIGHT < grown < promised * _AS_STRAIGHT:
            return True
    return False


def _bounds_of(found: FoundFit, which: int, error: float, limit: float) -> Bounds:
    """How far the number `which`, or how much it is above the one it is counted from, can go down and up until the
    record contradicts it, all others fitted again.

    One-sided: chi-squared has then grown by the square of `limit`. `error`: about the standard error of the coordinate.
    """
    problem, free, sigma, at = found.problem, found.free, found.sigma, found.point
    others = Free(free.x & (np.arange(len(free.x)) != which), free.s)
    least = problem.search(sigma, at, others).seen.chi_squared
    first = min(2 * error, _FARTHEST_FIRST)
    ends = [float(end[which]) for end in problem.model.transform.box]

    def edge(direction: float) -> float | None:
        point = at

        def beyond(to: float) -> float:
            """How far the root of what chi-squared has grown by is beyond the limit."""
            nonlocal point
            x = point.x.copy()
            x[which] = to
            try:
                fit = problem.search(sigma, SearchPoint(x, point.s), others)
            except ValueError:  # no motion there reaches the end of its window
                return _NO_MOTION
            over = np.sqrt(max(fit.seen.chi_squared - least, 0)) - limit
            point = fit.point if over <= 0 else point
            return float(over) if np.isfinite(over) else _NO_MOTION

        inside = at.x[which]
        for doubling in range(_DOUBLINGS + int(np.log2(_FARTHEST_FIRST / first))):
            to = float(np.clip(at.x[which] + direction * 2.0**doubling * first, ends[0], ends[1]))
            if to == inside:  # the number's own bound is allowed
                return None
            if beyond(to) > 0:
                break
            inside = to
        else:
            return None
        x = at.x.copy()
        x[which] = optimize.brentq(beyond, inside, to, xtol=_RESOLUTION * first)
        return float(problem.model.transform.own(x)[which])

    return Bounds(edge(-1.0), edge(1.0))


# What may be wrong where residuals are not white: a clock, a zero, a unit.


_CLEAR = 0.2  # of chi-squared: what another number must explain to be named
_OTHER_UNIT = 30.0  # times as large as the first guesses move, or as small


def explanations(record: Record, windows: Windows, seen: Residuals, sigma: np.ndarray, number: int) -> list[str]:
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
_WITHOUT_NOISE = 1e-6  # of a channel's standard deviation: smaller residuals are what the search leaves, never white
_SIGNIFICANCE = 0.001  # at which residuals are called too large, or not white


def result_of(search: Search, found: FoundFit, given_up: float | None) -> Calibration:
    """The result of a fit.

    `given_up`: by how much chi-squared grew where one motion over the whole record failed.
    """
    record, arguments, parameters = search.record, search.arguments, search.parameters
    problem, free, sigma = found.problem, found.free, found.sigma
    channels = [channel.name for channel in record.channels]
    transform, number, (windows_fitted, size) = problem.model.transform, len(parameters), found.point.s.shape
    with_start = free.s and windows_fitted == 1
    own = found.seen if free.s else found.seen._replace(slopes=found.seen.slopes[..., :number])
    told = information_of(own, number)
    joint = information_of(own, number + size) if with_start else told
    numbers = transform.numbers(found.point.x)
    slope = np.asarray(linalg.block_diag(transform.slopes(numbers), np.eye(size * with_start)))
    freedom = int(record.counts.sum()) - number - found.point.s.size * free.s + told.lost
    known = np.isfinite(record.noise)
    bounds, is_told = all_bounds(found, told, np.inf if np.all(known) else float(max(freedom, 1)))
    is_told = np.concatenate([is_told, np.diag(joint.covariance)[number:] < _VAGUE**2])
    covariance, by_blocks = (covariance_of(slope, matrix, is_told) for matrix in (joint.covariance, joint.by_blocks))
    states = np.asarray(problem.model.state_origin) + found.point.s
    coordinates = arguments.system.coordinates
    names = [parameter.name for parameter in parameters] + [one.name for one in coordinates] * with_start
    units = [
        (record.channels[int(path[1])].unit or "1")
        if path[0] == "sensors" and path[-1] == "offset"
        else unit_at(search.setting, path)
        for path in (parameter.path for parameter in parameters)
    ] + [one.unit for one in coordinates] * with_start
    values = np.concatenate([numbers, states[0] if with_start else []])
    estimates = correlated_estimates(names, values, units, covariance, max(freedom, 1) + 1)
    windows = Windows(*map(np.asarray, problem.windows))
    fitted = record.values + windows.in_order(found.raw.residuals, record)
    tests = {name: whiteness(name, row) for name, row in zip(channels, record.values - fitted, strict=True)}
    coloured = [
        name
        for (name, test), is_noisy in zip(
            tests.items(), sigma > _WITHOUT_NOISE * np.nanstd(record.values, axis=1), strict=True
        )
        if is_noisy and test.made and test.p_value < _SIGNIFICANCE
    ]
    # The bounds of a number are of it, or of how much it is above the one from which it is counted.
    of_bounds = [
        f"{name} - {names[int(np.argmax(from_))]}" if np.any(from_) else name
        for name, from_ in zip(names, np.asarray(transform.added), strict=False)
    ]
    system, base, *_ = with_numbers(search.setting, [one.path for one in parameters], numbers.tolist())

    remarks = [] if found.converged else ["The search did not converge: do not use its numbers."]
    if coloured:
        remarks.append(
            f"The residuals of {' and '.join(coloured)} are not white. First of all the model, a clock, a zero or a "
            "unit may be wrong, and then so are the numbers, by more than any of the errors: see plot.calibration, and "
            'search "clock.delay" or a channel\'s ".delay" or ".offset". Only if the model is right and the noise '
            "lasts, use covariance_by_blocks."
        )
        remarks += explanations(record, windows, own, sigma, number)
        remarks += other_units(record, arguments, np.zeros(size) if search.y0 is None else search.y0)
    differences = transform.own(found.point.x)
    for i, limits in bounds.items():
        ends = limits.in_words
        limit = f"it is {ends} (95 % confidence each)" if ends else "it gives no bound either"
        if ends and any(found.point.x[i] == end[i] for end in transform.box):
            remarks.append(
                f"{of_bounds[i]} is at its bound, {differences[i]:.4g}, where its error is to one side only: {limit}."
            )
        elif not is_told[i]:
            remarks.append(
                f"The motion hardly depends on {of_bounds[i]} near {differences[i]:.2g}, so the record does not tell "
                f"it: {limit}."
            )
    for direction in told.tied @ slope[:number, :number].T:
        change = direction / np.where(numbers == 0, 1, numbers)
        largest = np.max(np.abs(change))
        if largest > 0:
            shares = dict(zip(names, change / largest, strict=False))
            parts = [f"{name} by {100 * share:+.0f} %" for name, share in shares.items() if abs(share) > SHARE]
            remarks.append(
                f"The record does not tell these apart: changing {', '.join(parts)} (in these ratios) leaves the "
                "motion as it is; fix one of them."
            )
    if given_up is not None:
        remarks.append(
            f"One motion over the whole record would raise chi-squared by {given_up:.4g}: each of {windows_fitted} "
            "windows has a start of its own."
        )
    if np.all(known) and freedom > 0 and stats.chi2.sf(found.seen.chi_squared, freedom) < _SIGNIFICANCE:
        remarks.append(
            "Chi-squared is larger than the given noise allows: the model lacks something, or noise is larger."
        )
    return Calibration(
        estimates=dict(zip(names[:number], estimates[:number], strict=True)),
        covariance=covariance[:number, :number],
        covariance_by_blocks=by_blocks[:number, :number],
        bounds={of_bounds[i]: limits for i, limits in bounds.items()},
        system=system,
        base=base,
        start=dict(zip(names[number:], estimates[number:], strict=True)) if with_start else None,
        start_times=np.asarray(windows.begins),
        start_states=states,
        channels=tuple(channels),
        units=tuple(channel.unit for channel in record.channels),
        times=record.times,
        measured=record.values,
        fitted=fitted,
        noise=dict(zip(channels, sigma.tolist(), strict=True)),
        noise_is_known=dict(zip(channels, known.tolist(), strict=True)),
        chi_squared=found.seen.chi_squared,
        degrees_of_freedom=freedom,
        whiteness=tests,
        converged=found.converged,
        remarks=tuple(remarks),
    )


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
        base: What drives it: a motion without randomness, such as `Harmonic`, a measured one as a `Recorded`.
        times: Of the measurements, s, increasing, from 0 on, (times,); they need not be equally spaced.
        measured: What was measured, (times,) each, NaN where it was not. By the names of the system's coordinates
            ("position" in m, "velocity" in m/s; "angle", "current", "position 1", ...), as "acceleration" (m/s^2;
            where a coordinate is called "velocity 1", "acceleration 1"), as "friction force" (N), or by the names in
            `observe`. Accelerations and friction forces jump where a stick begins or a slip reverses, and the search
            does not see how a jump moves past a measurement: set those next to jumps to NaN, and measure positions too.
        wrt: The names of the numbers to be estimated: those of fields of the system or the base,
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
        method: `Exact` or `Regularized`, with which there is one window, which begins at t = 0.

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
    checks.require_threads_of_jax()
    arguments, start, record = asked(system, base, times, measured, noise, y0, observe, method)
    # Numbers of system and base, and delays and offsets of sensors.
    paths: dict[str, NumberPath] = {"clock.delay": ("clock", "delay")}
    for i, channel in enumerate(record.channels):
        paths |= {f"{channel.name}.{kind}": ("sensors", i, kind) for kind in ("delay", "offset")}
    of_sensors = {name: Parameter(name, path, 0.0) for name, path in paths.items()}
    parameters = parameters_of({"system": arguments.system, "base": arguments.base}, wrt, of_sensors)
    searches_sensors = any(parameter.name in of_sensors for parameter in parameters)
    sensors = tuple(Sensor() for _ in record.channels) if searches_sensors else ()
    setting = EstimatedNumbers(arguments.system, arguments.base, sensors=sensors)
    record, transform = _with_sensors(record, arguments, parameters, transform_of(setting, parameters))
    for channel, row, sigma in zip(record.channels, record.values, record.noise, strict=True):
        if np.isnan(sigma) and not np.nanmax(row, initial=-np.inf) > np.nanmin(row, initial=np.inf):
            raise ValueError(
                f"Argument noise must give the standard deviation of {channel.name!r}, whose measurements are all the "
                f'same, so that it cannot be estimated: noise={{"{channel.name}": ...}}.'
            )
    if isinstance(method, Regularized) and windows not in (None, 1):
        raise checks.refused("windows", "be 1 with the method Regularized", windows)
    number = 1
    if windows is not None:
        number = checks.whole_number("windows", windows, maximum=len(record.times))
    elif isinstance(method, Exact):  # some periods of the slowest time scale in each, and enough measurements
        by_time = (arguments.t1 - record.times[0]) / (_PERIODS * slowest_time(arguments.system, arguments.base))
        number = int(np.clip(min(by_time, len(record.times) / _FEWEST), 1, _MOST_WINDOWS))

    search = Search(record, arguments, parameters, transform, None if y0 is None else start, setting)
    found = fitted(search, search.cuts(number), np.zeros(len(parameters)))
    whole = as_one(search, found) if windows is None and len(found.problem.windows.begins) > 1 else found
    is_whole = isinstance(whole, FoundFit)
    done = result_of(search, whole if is_whole else found, None if is_whole else whole)
    for remark in done.remarks:
        checks.warn(remark)
    return done


def _with_sensors(
    record: Record, arguments: Arguments, parameters: tuple[Parameter, ...], transform: Transform
) -> tuple[Record, Transform]:
    """The record, less what is too near to its ends for delays to be searched, and offsets and delays in their units.

    Raises ValueError where too little is left.
    """
    low, high, closed, scale = (np.array(one) for one in transform[1:5])
    slowest = slowest_time(arguments.system, arguments.base)
    longest = min(_DELAYED * float(np.ptp(record.times)), _DELAYED_TIME * slowest)
    for i, parameter in enumerate(parameters):
        if parameter.path[-1] == "offset" and parameter.path[0] == "sensors":
            scale[i] = np.nanstd(record.values[int(parameter.path[1])]) or 1.0
        elif parameter.path[0] in ("clock", "sensors"):
            low[i], high[i], closed[i], scale[i] = -longest, longest, 1.0, 2 * longest
    delays = [parameter.path[0] for parameter in parameters if parameter.path[-1] == "delay"]
    if {"clock", "sensors"} <= set(delays) and delays.count("sensors") == len(record.channels):
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
