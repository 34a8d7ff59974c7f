"""From a fit to its result: estimates with their errors, and what to know about them."""

from typing import Any

import numpy as np
from scipy import linalg, stats

from .._dynamics.common.validation import Arguments
from .._statistics.estimate import correlated_estimates
from .._systems.units import unit_at
from .._uncertainty.numbers import Parameter, with_numbers
from .bounds import SHARE, Bounds, all_bounds
from .fit import chi_squared
from .information import information_of
from .misfit import explanations, other_units
from .problem import Setting
from .record import Record, Windows
from .result import Calibration
from .search import Found
from .transform import Transform, covariance_of
from .whiteness import whiteness

_VAGUE = 3.0  # standard error of an initial state, in its unit, beyond which the record does not tell it
_WITHOUT_NOISE = (
    1e-6  # of a channel's standard deviation: smaller residuals are what the search leaves, and never white
)
_SIGNIFICANCE = 0.001  # at which residuals are called too large, or not white


def result_of(
    record: Record,
    arguments: Arguments,
    parameters: tuple[Parameter, ...],
    found: Found,
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
    setting = Setting(arguments.system, arguments.base, sensors=problem.model.setting.sensors)
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


def _unit(setting: Setting, record: Record, parameter: Parameter) -> str:
    """The unit of a number of the system, the base, or a channel's sensor."""
    kind, *_, last = parameter.path
    if kind == "sensors" and last == "offset":
        return record.channels[int(parameter.path[1])].unit or "1"
    return unit_at(setting, parameter.path)
