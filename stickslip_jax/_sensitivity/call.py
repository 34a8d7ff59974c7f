"""`sensitivity`: derivatives of stick statistics, corrected for sticks that appear and vanish."""

import math
import warnings
from typing import Any, get_args

import numpy as np

from .. import _checks
from .._dynamics.method import EXACT, Exact, Regularized
from .._excitation.excitation import BaseMotion
from .._systems.system import System
from .._types import Array, InitialState
from . import windows
from .estimate import Estimator, Gradient, Sensitivities, Sensitivity
from .estimators import Columns, counted, differenced, differenced_ensembles, recorded
from .exactness import warn_at_special_speeds, warn_if_grazing
from .first_look import (
    COUNTED_WINDOWS,
    PAIRED_WINDOWS,
    RECORDED_WINDOWS,
    problem_of,
    relative_bandwidth_of,
    require_correctable,
    require_precision,
)
from .problem import Pilot, Problem
from .runs import Accumulator

_ESTIMATORS = get_args(Estimator)


def sensitivity(
    statistic: Any,
    system: System,
    law: BaseMotion,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None = None,
    y0: InitialState | None = None,
    elasticity: Any = False,
    estimator: Estimator | None = None,
    step: float | None = None,
    relative_bandwidth: float | None = None,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
    chunk: int | None = None,
) -> Sensitivity | Sensitivities:
    """The derivative of a stick statistic's expectation with respect to parameters, with its standard error.

    Sticks appear and vanish as parameters change: the derivative of the simulated mean is biased, this one corrected.

    - `statistic`: `stick_fraction`, `mean_stick_count`, `mean_stick_duration`, `mean_total_stick_time`, or a
      `StickStatistic`: `RealizationMeanDuration()`, `StickStart(i)`, `StickDuration(i)`, `StickFunctional(f)`.
    - `wrt`: the name of a number in system, law or `y0`, such as "mu", "mu_static", "normal_force", "mass",
      "stiffness", "damping", "speed", "rate", "interval", "y0[0]", or several; "law.speed" where a name is ambiguous.
    - `system`, `law`, `t1` (s), `samples`, `key`, `y0`, `method`, `threads`, `chunk`: as in `simulate_ensemble`; the
      law or `y0` must be random. The result does not depend on `threads`, nor, except for the order of summation, on
      `chunk`. Of regularised dynamics there are differences only; a threshold that is not given follows the parameter.
    - `elasticity`: whether to give ``d log statistic / d log parameter``.
    - `estimator`: "corrected", or "finite-difference": central differences with common random numbers. By default the
      one with the smaller error in the same time (the result's `estimator` names it): corrected for statistics of
      totals on bases of piecewise-constant velocity, without damping and force, and for those that sticks of zero
      length do not change (`stick_fraction`); else differences. The other one is an independent check.
    - `step`: that of the differences, relative to the parameter's value; by default `relative_bandwidth`, or a quarter
      of it where the two disagree. The bias is of order ``step^2``.
    - `relative_bandwidth`: width of the corrected estimator's kernel, as a relative change of the parameter: a stick
      counts as about to appear or vanish if it moves its margin through zero. By default ``0.005 (sticks /
      10^6)^(-1/5)``, at most 0.05. The bias is of order ``relative_bandwidth^2``.

    The method: docs/sensitivity.md. With `mu_static` a stick that appears changes all later motion, and a `MotorCart`
    that nearly stops may run away: there the event part comes from pairs of trajectories with the parameter changed up
    and down by `relative_bandwidth`.

    Returns a `Sensitivity`, or for several names a mapping from name to `Sensitivity`. Warns (RuntimeWarning) if the
    event part rests on fewer than 100 sticks or differs from window to window (the standard error is NaN then), at base
    speeds w = 1, 2, 3, 8 and 15, and where all first arcs graze the base velocity exactly (no derivative exists: NaN).
    Raises ValueError for invalid arguments, in single precision also where there is no closed form.
    """
    _check_options(elasticity, estimator, step, relative_bandwidth)
    problem, pilot = problem_of(
        statistic, system, law, wrt, t1, samples, key, y0, method=method, threads=threads, chunk=chunk
    )
    asked = estimator or _asked_for(step, relative_bandwidth)
    _require_differences(asked, method)
    if (asked or _cheaper(problem)) == "finite-difference":
        results = _by_differences(problem, pilot, elasticity, step)
    else:
        results = _corrected(problem.in_closed_form(), pilot, elasticity, relative_bandwidth)
    return next(iter(results.values())) if isinstance(wrt, str) else Sensitivities(results)


def _asked_for(step: float | None, relative_bandwidth: float | None) -> str | None:
    """The estimator that the given option belongs to, if any."""
    if step is not None:
        return "finite-difference"
    return None if relative_bandwidth is None else "corrected"


def _cheaper(problem: Problem) -> str:
    """The estimator with the smaller error in the same time (measured: docs/sensitivity.md)."""
    if isinstance(problem.method, Regularized):
        return "finite-difference"
    if not problem.is_counted or problem.has_sudden_switches or not problem.can_be_corrected:
        return "finite-difference"
    by_steps = problem.is_blind_to_events and problem.dtype.itemsize == 8  # else `require_precision` refuses
    return "corrected" if problem.by_intervals or by_steps else "finite-difference"


def _require_differences(estimator: str | None, method: Exact | Regularized) -> None:
    """Raise ValueError where the corrected method is asked of regularised dynamics: it needs exact events."""
    if isinstance(method, Regularized) and estimator == "corrected":
        raise ValueError(
            "Argument estimator must be 'finite-difference' (the default here), and relative_bandwidth left out, with "
            f"regularised dynamics, but method={_checks.show(method)} was given: a stick is a time below a threshold "
            "there, and the corrected estimator knows the margins of exact events only. Take method=Exact() for it."
        )


def _corrected(
    problem: Problem, pilot: Pilot, elasticity: bool, relative_bandwidth: float | None
) -> dict[str, Sensitivity]:
    require_precision(problem)
    require_correctable(problem)
    widest = relative_bandwidth_of(problem, pilot) if relative_bandwidth is None else float(relative_bandwidth)
    if problem.is_paired:
        bandwidths = widest * np.array(PAIRED_WINDOWS)
        accumulator, columns = differenced(problem, pilot, bandwidths, with_pathwise=True)
    elif problem.is_counted:
        bandwidths = widest * np.array([1.0] if problem.is_blind_to_events else COUNTED_WINDOWS)
        accumulator, columns = counted(problem, pilot, np.zeros(0) if problem.is_blind_to_events else bandwidths)
    else:
        bandwidths = widest * np.array(RECORDED_WINDOWS)
        accumulator, columns = recorded(problem, pilot, bandwidths)
    grazing = warn_if_grazing(problem)
    results = {}
    for index, (parameter, where) in enumerate(zip(problem.parameters, columns, strict=True)):
        got, chosen = windows.estimate(
            accumulator, where, accumulator.near[index], parameter.value if elasticity else None
        )
        if parameter.name in grazing:
            got = got._replace(derivative=math.nan, standard_error=math.nan)
        near = int(accumulator.near[index, chosen])
        results[parameter.name] = _result(
            problem, parameter, got, elasticity, "corrected", accumulator, near, float(bandwidths[chosen])
        )
    if problem.is_blind_to_events and not problem.has_sudden_switches:
        return results
    warn_at_special_speeds(problem, grazing)
    _warn_of_torn(accumulator, columns, results, grazing)
    _warn_of_few(results)
    return results


def _warn_of_few(results: dict[str, Sensitivity]) -> None:
    few = min(result.sticks_in_window for result in results.values())
    if few < windows.FEW:
        warnings.warn(
            f"The event part rests on {few} sticks only, so that its standard error means little; take more samples.",
            RuntimeWarning,
            stacklevel=4,
        )


def _warn_of_torn(
    accumulator: Accumulator, columns: tuple[Columns, ...], results: dict[str, Sensitivity], warned: tuple[str, ...]
) -> None:
    """RuntimeWarning where windows disagree, except for the parameters `warned` of already."""
    torn = [
        name
        for name, where, near in zip(results, columns, accumulator.near, strict=True)
        if name not in warned and windows.is_torn(accumulator, where, near)
    ]
    if torn:
        warnings.warn(
            f"No two windows agree on the derivative with respect to {', '.join(torn)}: it depends on how far one "
            "looks for sticks about to be born or lost, or does not exist. That of the narrowest window is given, with "
            "a standard error of NaN; compare with estimator='finite-difference' at several steps.",
            RuntimeWarning,
            stacklevel=4,
        )


def _by_differences(problem: Problem, pilot: Pilot, elasticity: bool, step: float | None) -> dict[str, Sensitivity]:
    """Finite differences with the given `step`, or with the wider of two steps that agree."""
    steps = np.array([step]) if step is not None else relative_bandwidth_of(problem, pilot) * np.array(PAIRED_WINDOWS)
    if isinstance(problem.method, Regularized):
        accumulator, columns = differenced_ensembles(problem, steps)
    else:
        accumulator, columns = differenced(problem, pilot, steps, with_pathwise=False)
    results = {}
    for index, (parameter, where) in enumerate(zip(problem.parameters, columns, strict=True)):
        got, chosen = windows.estimate(
            accumulator, where, accumulator.near[index], parameter.value if elasticity else None
        )
        near, got = int(accumulator.near[index, chosen]), got._replace(pathwise=math.nan)
        results[parameter.name] = _result(
            problem, parameter, got, elasticity, "finite-difference", accumulator, near, float(steps[chosen])
        )
    _warn_of_torn(accumulator, columns, results, ())
    return results


def _result(
    problem: Problem,
    parameter: Any,
    got: Gradient,
    elasticity: bool,
    estimator: Estimator,
    accumulator: Accumulator,
    near: int,
    relative_bandwidth: float,
) -> Sensitivity:
    return Sensitivity(
        statistic=problem.statistic.name,
        parameter=parameter.name,
        parameter_value=parameter.value,
        unit=problem.statistic.unit,
        value=got.value,
        value_error=got.value_error,
        derivative=got.derivative,
        standard_error=got.standard_error,
        pathwise=got.pathwise,
        event=got.derivative - got.pathwise,
        is_elasticity=elasticity,
        estimator=estimator,
        samples=accumulator.moments.number,
        asked=problem.samples,
        sticks_in_window=near,
        relative_bandwidth=relative_bandwidth,
    )


def _check_options(elasticity: Any, estimator: Any, step: Any, relative_bandwidth: Any) -> None:
    if not isinstance(elasticity, bool):
        raise ValueError(f"Argument elasticity must be True or False, but {_checks.show(elasticity)} was given.")
    if estimator is not None:
        _checks.chosen("estimator", estimator, _ESTIMATORS)
    for name, value, of in (
        ("step", step, "finite-difference"),
        ("relative_bandwidth", relative_bandwidth, "corrected"),
    ):
        if value is not None:
            _checks.positive(name, value)
            if estimator not in (None, of):
                raise ValueError(
                    f"Argument {name} must be left out with estimator={estimator!r}, but {value} was given."
                )
    if step is not None and relative_bandwidth is not None:
        raise ValueError(
            f"Argument step must be left out with relative_bandwidth, but step={step} and relative_bandwidth="
            f"{relative_bandwidth} were given; step is for estimator='finite-difference', relative_bandwidth for "
            "estimator='corrected'."
        )
