"""`sensitivity`: derivatives of stick statistics, corrected for sticks born and lost."""

import math
import warnings
from typing import Any

import jax
import numpy as np

from .. import _checks
from .._status import Ending
from .._types import Array
from ..base_motion.drive import is_random, words_for
from ..base_motion.random import Uniform
from ..dynamics.method import EXACT, Exact
from ..ensemble import simulate_ensemble
from ..set_up import state_of
from .estimate import Gradient, Sensitivities, Sensitivity, difference_of_ratios, gradient_of_ratio
from .estimators import Columns, counted, differenced, recorded
from .exactness import warn_if_grazing
from .parameters import parameters_of
from .problem import Pilot, Problem, room_for
from .runs import Tally, cores
from .sequences import Spans
from .statistic import OfTotals, statistic_of

_METHODS = ("corrected", "finite-difference")
_PILOT = 1024  # samples
_REACH, _WINDOW, _STICKS = 0.02, 1.0, 1e6  # windows at so many sticks
_SHORT = 0.25  # the share of all sticks that sets the scale of short ones
_WINDOWS = (1.0, 0.5, 0.25, 0.125)  # of recorded durations, to choose from
_AGREE = 2.5  # standard errors
_FEW = 100  # sticks


def sensitivity(
    statistic: Any,
    system: Any,
    law: Any,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None = None,
    y0: Any = None,
    elasticity: bool = False,
    method: str = "corrected",
    step: float = 0.01,
    reach: float | None = None,
    exact: Exact = EXACT,
    threads: int | None = None,
    chunk: int | None = None,
) -> Sensitivity | Sensitivities:
    """The derivative of a stick statistic's expectation with respect to parameters, with its standard error.

    Sticks are born and lost as parameters change, so differentiating the simulated mean is wrong. Here the pathwise
    derivative is corrected by the flux of sticks through the edge of existence.

    - `statistic`: `stick_fraction`, `mean_stick_count`, `mean_stick_duration` (pooled), or a `StickStatistic`:
      `TOTAL_STICK_TIME`, `RealisationMeanDuration()`, `StickStart(i)`, `StickDuration(i)`, `StickFunctional(f)`.
    - `wrt`: the name of a number in system, law or `y0`, such as "mu", "mu_static", "normal_force", "mass",
      "stiffness", "damping", "speed", "rate", "interval", "y0[0]", or several names; "law.speed" where a name alone is
      ambiguous. All are found in one pass.
    - `system`, `law`, `t1` (s), `samples`, `key`, `y0`, `exact`, `threads`, `chunk`: as in `simulate_ensemble`, where
      `exact` is the method; something must be random. The answer does not depend on `threads`, nor, but for the order
      of summation, on `chunk`.
    - `elasticity`: whether to give ``d log statistic / d log parameter``.
    - `method`: "corrected", or "finite-difference": central differences with common random numbers, of `step` times the
      parameter's size; biased by order ``step^2``.
    - `reach`: how far the corrected method looks for sticks about to be born or lost, as a relative change of the
      parameter. By default ``0.02 (sticks / 10^6)^(-1/5)``, at most 0.1. Its bias is of order ``reach^2``.

    How the event part is found. On a base of piecewise-constant velocity, without damping and force, and for
    statistics of totals, near misses are seen too, and what Poisson switching decides is integrated out; the derivative
    by its rate comes from the likelihood. Elsewhere it comes from sticks (and slips between two) shorter than a window,
    ``(sticks / 10^6)^(-1/5)`` times the lower quartile of durations. All windows come in several widths; the widest is
    taken whose answer is within 2.5 standard errors of those of the narrower ones. The bias is of order ``window^2``.

    Returns a `Sensitivity`, for several names a mapping from them. Warns (RuntimeWarning) if the event part rests on
    fewer than 100 sticks, and where every trajectory begins with an arc that exactly grazes the base velocity: the
    derivative does not exist there, and is NaN. Raises ValueError for arguments outside these bounds.
    """
    statistic, threads = (
        statistic_of(statistic),
        cores() if threads is None else _checks.whole_number("threads", threads),
    )
    _check_options(elasticity, method, step, reach, exact)
    y0 = _checked_start(system, law, t1, y0, key)
    pilot = _pilot(system, law, t1, y0, samples, key, exact, threads)
    where = {"system": system, "law": law, "y0": y0}
    problem = Problem(
        statistic, system, law, float(t1), y0, exact, words_for(law, key), parameters_of(where, wrt), samples, threads,
        None if chunk is None else _checks.whole_number("chunk", chunk), jax.numpy.result_type(float),
    )  # fmt: skip
    results = (_by_differences if method == "finite-difference" else _corrected)(
        problem, pilot, elasticity, step, reach
    )
    return next(iter(results.values())) if isinstance(wrt, str) else Sensitivities(results)


def _corrected(
    problem: Problem, pilot: Pilot, elasticity: bool, step: float, reach: float | None
) -> dict[str, Sensitivity]:
    share = (problem.samples * max(pilot.sticks, 1e-3) / _STICKS) ** -0.2
    reach = min(_REACH * share, 0.1) if reach is None else float(reach)
    if problem.is_counted:
        windows, reaches = np.full(2, math.nan), reach * np.array([1, 1 / 4])
        tally, columns = counted(problem, pilot, reach)
    else:
        windows, reaches = (np.array(_WINDOWS) * widest for widest in (_WINDOW * share * pilot.short, reach))
        spans = Spans(windows.astype(problem.dtype), reaches.astype(problem.dtype))
        tally, columns = recorded(problem, room_for(problem, pilot), spans)
    grazing = warn_if_grazing(problem)
    results = {}
    for parameter, where in zip(problem.parameters, columns, strict=True):
        log_by = parameter.value if elasticity else None
        chosen = _widest(tally, where)
        got = gradient_of_ratio(tally.moments, where.derivative[chosen], where.pathwise, log_by)
        if parameter.name in grazing:
            got = got._replace(derivative=math.nan, standard_error=math.nan)
        near = int(tally.near[chosen])
        results[parameter.name] = _result(
            problem,
            parameter,
            got,
            elasticity,
            "corrected",
            tally,
            near,
            reaches[chosen],
            windows[chosen],
        )
    if isinstance(problem.statistic, OfTotals) and problem.statistic.is_blind_to_events:
        return results
    few = min(result.sticks_in_window for result in results.values())
    if few < _FEW:
        warnings.warn(
            f"The event part rests on {few} sticks only, so that its standard error means little; take more samples.",
            RuntimeWarning,
            stacklevel=3,
        )
    return results


def _by_differences(
    problem: Problem, pilot: Pilot, elasticity: bool, step: float, reach: float | None
) -> dict[str, Sensitivity]:
    results = {}
    for index, parameter in enumerate(problem.parameters):
        length = step * (abs(parameter.value) or 1.0)
        tally = differenced(problem, index, length, room_for(problem, pilot))
        got = difference_of_ratios(tally.moments, 2, length, parameter.value if elasticity else None)
        results[parameter.name] = _result(
            problem, parameter, got, elasticity, "finite-difference", tally, 0, step, math.nan
        )
    return results


def _result(
    problem: Problem,
    parameter: Any,
    got: Gradient,
    elasticity: bool,
    method: str,
    tally: Tally,
    near: int,
    reach: float,
    window: float,
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
        method=method,
        samples=tally.moments.number,
        asked=problem.samples,
        sticks_in_window=near,
        reach=reach,
        window=float(window),
    )


def _widest(tally: Tally, where: Columns) -> int:
    """The number of the widest window whose derivative agrees with those of all smaller ones (Lepski's rule)."""
    mean, covariance = tally.moments.mean, tally.moments.covariance_of_mean
    a, b = mean[:2]
    if not b > 0:
        return len(where.derivative) - 1

    def weights(column):
        of = np.zeros(len(mean))
        of[column : column + 2] = 1 / b, -a / b**2
        return of

    for number, column in enumerate(where.derivative):
        differences = [weights(column) - weights(smaller) for smaller in where.derivative[number + 1 :]]
        if all(abs(of @ mean) <= _AGREE * math.sqrt(max(of @ covariance @ of, 0.0)) for of in differences):
            return number
    return len(where.derivative) - 1


def _pilot(
    system: Any, law: Any, t1: float, y0: tuple[Any, ...], samples: int, key: Any, exact: Exact, threads: int
) -> Pilot:
    """A first look, which also checks the arguments."""
    number = min(_checks.whole_number("samples", samples, minimum=2), _PILOT)
    many = simulate_ensemble(
        system, law, t1=t1, samples=number, key=key, y0=y0, method=exact, keep="sticks", threads=threads, progress=False
    )
    if many.moments.number < 2:
        raise ValueError(f"Fewer than two of {number} trajectories reached t1, so that there is no statistic: {many}")
    sticks = many.require_sticks()
    whole = (sticks.start > 0) & (sticks.ending != Ending.HORIZON)
    durations = (sticks.end - sticks.start)[whole]
    return Pilot(
        stick_time=float(many.moments.mean[0]),
        sticks=float(many.moments.mean[1]),
        most=int(sticks.count.max()),
        short=float(np.quantile(durations, _SHORT)) if len(durations) else t1 / 10,
    )


def _checked_start(system: Any, law: Any, t1: float, y0: Any, key: Any) -> tuple[Any, ...]:
    """The initial state. Raises ValueError where nothing is random."""
    try:
        start = state_of(system, y0, may_be_random=True)
    except StopIteration:  # no system: the simulation says so
        return y0
    if not is_random(law) and not any(isinstance(value, Uniform) for value in start):
        raise ValueError(
            "Argument law must be random, or y0 hold a Uniform value: without chance the number of sticks is a step "
            "function of the parameters, and has no derivative to correct. Differentiate simulate(...) with jax.jvp."
        )
    return start


def _check_options(elasticity: Any, method: Any, step: Any, reach: Any, exact: Any) -> None:
    if not isinstance(elasticity, bool):
        raise ValueError(f"Argument elasticity must be True or False, but {_checks.show(elasticity)} was given.")
    if method not in _METHODS:
        raise ValueError(f"Argument method must be one of {_METHODS}, but {_checks.show(method)} was given.")
    _checks.positive("step", step)
    if reach is not None:
        _checks.positive("reach", reach)
    if not isinstance(exact, Exact):
        raise ValueError(f"Argument exact must be Exact(...), but {_checks.show(exact)} was given.")
