"""`sensitivity`: derivatives of stick statistics, corrected for sticks that appear and vanish."""

import math
import warnings
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import get_args

import numpy as np
from jaxtyping import Array

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.types import InitialState
from .._systems.system import System
from . import estimate
from .estimate import Estimator, Sensitivities, Sensitivity, results_of
from .estimators import JointAccumulator, Source, counted, differenced, recorded, run_chunks
from .problem import (
    Pilot,
    SensitivityProblem,
    problem_of,
    relative_bandwidth_of,
    require_correctable,
    require_precision,
    warn_at_special_speeds,
    warn_if_grazing,
)
from .statistic import AnyStatistic, statistic_of

# A warning where parameters act only together, as a friction coefficient and a normal force do through their product.
#
# Then the derivatives by their logarithms are proportional in every sample, up to round-off, and so are those of every
# statistic: none can tell the parameters apart. Equality in the inequality of Cauchy and Schwarz is the test.


_PROPORTIONAL = 1e-9  # of the squares: what is not proportional, relative to the whole


def products_among(problem: SensitivityProblem, accumulated: JointAccumulator) -> list[str]:
    """A sentence for each pair of parameters whose derivatives are proportional in every sample."""
    first, second = accumulated.halves
    moments, found = first.merge(second), []
    if moments.number < 2:
        return found
    squares = moments.scatter / moments.number + np.outer(moments.mean, moments.mean)  # means of products of columns
    places = [_columns(accumulated, index, squares) for index in range(len(problem.parameters))]
    for (one, at_one), (other, at_other) in combinations(zip(problem.parameters, places, strict=True), 2):
        if len(at_one) != len(at_other):
            continue
        of_one, of_other, product = squares[at_one, at_one], squares[at_other, at_other], squares[at_one, at_other]
        if not (np.any(of_one > 0) and np.any(of_other > 0)):
            continue
        scale = of_one / of_one.sum() + of_other / of_other.sum()  # columns have different units
        weight = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1), 0)
        a, b, ab = (float(weight @ values) for values in (of_one, of_other, product))
        if not a * b - ab * ab <= _PROPORTIONAL * a * b:
            continue
        # The columns of the other are ab / a times those of the one. In the combination on which all depends, this is
        # the exponent of the other if that of the one is 1.
        exponent = ab / a * other.value / one.value if one.value else math.nan
        together = f"one combination of them, {one.name} * {other.name}^{exponent:.3g} near their values"
        if math.isclose(exponent, 1, rel_tol=1e-3):
            together = f"their product {one.name} * {other.name}"
        elif math.isclose(exponent, -1, rel_tol=1e-3):
            together = f"their ratio {one.name} / {other.name}"
        found.append(
            f"{one.name} and {other.name} act on this only through {together}: their derivatives are proportional in "
            "every sample, so that nothing found here can tell them apart (a fit to both has rank 1)"
        )
    return found


def _columns(accumulated: JointAccumulator, parameter: int, squares: np.ndarray) -> np.ndarray:
    """The columns of the derivatives of all statistics by a parameter: pathwise ones, unless these are 0 or not known.

    Kernels, and differences, estimate event parts to first order only: they are less exactly proportional.
    """
    each = [(accumulated.slice_of(number).start, accumulated.single(number).columns[parameter])
            for number in range(len(accumulated.sizes))]  # fmt: skip
    pathwise = np.array([first + one.pathwise + part for first, one in each for part in (0, 1)])
    whole = [first + column + part for first, one in each for column in one.derivative for part in (0, 1)]
    return pathwise if np.any(squares[pathwise, pathwise] > 0) else np.array(whole)


# `sensitivity`: derivatives of stick statistics, corrected for sticks that appear and vanish.


def sensitivity(
    statistic: AnyStatistic | Sequence[AnyStatistic],
    system: System,
    law: BaseMotion,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None = None,
    y0: InitialState | None = None,
    elasticity: bool = False,
    estimator: Estimator | None = None,
    step: float | None = None,
    relative_bandwidth: float | None = None,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
    chunk: int | None = None,
) -> Sensitivity | Sensitivities:
    """The derivative of a stick statistic's expectation with respect to parameters, with its standard error.

    Sticks appear and vanish as parameters change: the derivative of the simulated mean is biased, this one corrected.

    The method: docs/sensitivity.md. With `mu_static` a stick that appears changes all later motion, and a `MotorCart`
    that nearly stops may run away: no kernel can estimate the event part there. With ``estimator="corrected"`` it then
    comes from pairs of trajectories with the parameter changed up and down by `relative_bandwidth`, so that the
    derivative is that of central differences, taken apart into its two parts.

    Args:
        statistic: `stick_fraction`, `mean_stick_count`, `mean_stick_duration`, `mean_total_stick_time`,
            `mean_slip_count`, `mean_slip_duration` (or their names); a `StickStatistic`: `RealizationMeanDuration()`,
            `StickStart(i)`, `StickDuration(i)`, `StickFunctional(f)`; or an `Output` of your own, for its mean. Or a
            list of them, all from the same samples, those of one kind from one loop.
        system: As in `simulate_ensemble`.
        law: As in `simulate_ensemble`; it or `y0` must be random.
        wrt: The name of a number in system, law or `y0`, such as "mu", "mu_static", "normal_force", "mass",
            "stiffness", "damping", "speed", "rate", "interval", "y0[0]", or several; "law.speed" where a name is
            ambiguous.
        t1: As in `simulate_ensemble`, s.
        samples: As in `simulate_ensemble`.
        key: As in `simulate_ensemble`.
        y0: As in `simulate_ensemble`.
        elasticity: Whether to give ``d log statistic / d log parameter``.
        estimator: "corrected": the pathwise derivative and the event part, which kernels estimate, or where they cannot
            (see above) pairs of trajectories. Or "finite-difference": central differences with common random numbers.
            By default the one with the smaller error in the same time (the result's `estimator` names it): corrected
            for statistics of totals on bases of piecewise-constant velocity, without damping and force, and for those
            that sticks of zero length do not change (`stick_fraction`); else differences. The other one is an
            independent check. Outputs and statistics of slips have differences only. Several statistics are all found
            in the same way.
        step: That of the differences, relative to the parameter's value; by default `relative_bandwidth`, or a quarter
            of it where the two disagree. The bias is of order ``step^2``.
        relative_bandwidth: Width of the corrected estimator's kernel, as a relative change of the parameter: a stick
            counts as about to appear or vanish if this change, to first order, would make it do so. By default ``0.005
            (sticks / 10^6)^(-1/5)``, at most 0.05. The bias is of order ``relative_bandwidth^2``.
        method: As in `simulate_ensemble`. Of regularised dynamics there are differences only; a threshold that is not
            given follows the parameter.
        threads: As in `simulate_ensemble`; the result does not depend on it.
        chunk: As in `simulate_ensemble`; the result depends on it only by the order of summation.

    Returns:
        A `Sensitivity`, or for several names a mapping from name to `Sensitivity`; for a list of statistics a mapping
        from each of them to that. They can be computed with (see `Sensitivity`). Warns (RuntimeWarning) if the event
        part rests on fewer than 100 sticks or differs from window to window (the standard error is NaN then), at base
        speeds w = 1, 2, 3, 8 and 15, and where all first arcs graze the base velocity exactly (no derivative exists:
        NaN).

    Raises:
        ValueError: For invalid arguments, in single precision also where there is no closed form.
    """
    chosen = _asked_for(elasticity, estimator, step, relative_bandwidth)
    problem, pilot = problem_of(
        statistic, system, law, wrt, t1, samples, key, y0, method=method, threads=threads, chunk=chunk
    )
    kinds = problem.kinds()
    problem = problem._replace(statistics=tuple(one for kind in kinds for one in kind.statistics))
    require_differences(chosen, method)
    if chosen is None:
        chosen = "corrected" if all(cheaper(kind) == "corrected" for kind in kinds) else "finite-difference"
    widest = relative_bandwidth_of(problem, pilot) if relative_bandwidth is None else float(relative_bandwidth)
    if chosen == "corrected":
        kinds = [kind.in_closed_form() for kind in kinds]
        for kind in kinds:
            require_precision(kind)
            require_correctable(kind)
        sources = [source_of(kind, pilot, widest) for kind in kinds]
    else:
        # The given step, or the wider of two that agree.
        choices = [estimate.OUTPUT if kind.is_output else estimate.PAIRED for kind in kinds]
        steps = [widest * np.array(choice) if step is None else np.array([step]) for choice in choices]
        sources = [differenced(kind, pilot, of, with_pathwise=False) for kind, of in zip(kinds, steps, strict=True)]
    accumulated = run_chunks(sources, problem.samples, problem.threads)
    grazing = warn_if_grazing(kinds[0]) if chosen == "corrected" else ()
    widths = [source.widths for source, kind in zip(sources, kinds, strict=True) for _ in kind.statistics]
    found = results_of(problem, accumulated, widths, elasticity, chosen, grazing)
    for sentence in products_among(problem, accumulated):
        warnings.warn(f"{sentence}; vary one of them only.", RuntimeWarning, 2)
    checked = range(len(found))  # the statistics whose windows are compared
    if chosen == "corrected":
        sudden = problem.has_sudden_switches
        checked = [
            at for at, one in enumerate(problem.statistics) if sudden or not problem.only(one).ignores_stick_count
        ]
        if checked:
            warn_at_special_speeds(kinds[0], grazing)
    _warn_of_disagreement(problem, accumulated, checked, grazing)
    few = min((one.sticks_in_window for at in checked for one in found[at].values()), default=estimate.FEW)
    if chosen == "corrected" and few < estimate.FEW:
        warnings.warn(
            f"The event part rests on {few} sticks only, so that its standard error means little; take more samples.",
            RuntimeWarning,
            stacklevel=2,
        )
    single = [next(iter(one.values())) if isinstance(wrt, str) else Sensitivities(one) for one in found]
    if not isinstance(statistic, (list, tuple)):
        return single[0]
    by_statistic = dict(zip(problem.statistics, single, strict=True))
    return Sensitivities({given: by_statistic[statistic_of(given)] for given in statistic})


def _asked_for(
    elasticity: bool, estimator: Estimator | None, step: float | None, relative_bandwidth: float | None
) -> Estimator | None:
    """The estimator that the options ask for, if any. Raises ValueError for what they must not be."""
    if not isinstance(elasticity, bool):
        raise ValueError(f"Argument elasticity must be True or False, but {checks.show(elasticity)} was given.")
    check_estimator(estimator)
    options: tuple[tuple[str, float | None, Estimator], ...] = (
        ("step", step, "finite-difference"), ("relative_bandwidth", relative_bandwidth, "corrected")
    )  # fmt: skip
    for name, value, of in options:
        if value is not None:
            checks.positive(name, value)
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
    return estimator or next((of for _, value, of in options if value is not None), None)


def cheaper(problem: SensitivityProblem) -> Estimator:
    """The estimator with the smaller error in the same time (measured: docs/sensitivity.md)."""
    if isinstance(problem.method, Regularized):
        return "finite-difference"
    if not problem.is_counted or problem.has_sudden_switches or not problem.can_be_corrected:
        return "finite-difference"
    by_steps = problem.ignores_stick_count and problem.dtype.itemsize == 8  # else `require_precision` refuses
    return "corrected" if problem.by_intervals or by_steps else "finite-difference"


def check_estimator(estimator: Estimator | None) -> None:
    """Raise ValueError for what is no estimator."""
    if estimator is not None:
        checks.chosen("estimator", estimator, get_args(Estimator))


def require_differences(estimator: Estimator | None, method: Exact | Regularized) -> None:
    """Raise ValueError where the corrected method is asked of regularised dynamics: it needs exact events."""
    if isinstance(method, Regularized) and estimator == "corrected":
        raise ValueError(
            "Argument estimator must be 'finite-difference' (the default here), and relative_bandwidth left out, with "
            f"regularised dynamics, but method={checks.show(method)} was given: a stick is a time below a threshold "
            "there, and the corrected estimator needs exact events. Take method=Exact() for it."
        )


def source_of(problem: SensitivityProblem, pilot: Pilot, widest: float) -> Source:
    """How the corrected derivatives of statistics of one kind are found."""
    if problem.is_paired:
        return differenced(problem, pilot, widest * np.array(estimate.PAIRED), with_pathwise=True)
    if problem.is_counted and problem.ignores_stick_count:
        return counted(problem, pilot, np.zeros(0))._replace(widths=np.array([widest]))
    if problem.is_counted:
        return counted(problem, pilot, widest * np.array(estimate.COUNTED))
    return recorded(problem, pilot, widest * np.array(estimate.RECORDED))


def _warn_of_disagreement(
    problem: SensitivityProblem, accumulated: JointAccumulator, numbers: Iterable[int], already_warned: tuple[str, ...]
) -> None:
    """RuntimeWarning where windows disagree, of the statistics `numbers`; not again for those `already_warned` of."""
    found = []
    for number in numbers:
        one = accumulated.single(number)
        by_parameter = zip(problem.parameters, one.columns, one.in_window, strict=True)
        found += [
            parameter.name
            for parameter, where, in_window in by_parameter
            if parameter.name not in already_warned and estimate.windows_disagree(one, where, in_window)
        ]
    if found:
        warnings.warn(
            f"No two windows agree on the derivative with respect to {', '.join(dict.fromkeys(found))}: it depends on "
            "how far one looks for sticks about to appear or vanish, or does not exist. That of the narrowest window "
            "is given, with a standard error of NaN; compare with estimator='finite-difference' at several steps.",
            RuntimeWarning,
            stacklevel=3,
        )
