"""`sensitivity` and `differentiable`: derivatives of stick statistics, corrected for sticks that appear and vanish."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations
from typing import Any, TypeAlias, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from .._compiler.native import LANES
from .._dynamics.common.lanes import Job, summarize, with_leaves
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.simulate import simulate
from .._ensemble.setup import EnsembleSetup
from .._excitation.excitation import BaseMotion, is_random
from .._excitation.segments import SegmentLaw
from .._foundation import checks
from .._foundation.processes import as_many_as_fit, is_wide
from .._foundation.types import FloatArray, InitialState, Status
from .._statistics.quantities import Numbering
from .._systems.system import System
from .._uncertainty.families import RandomNumber
from .._uncertainty.numbers import number_at, shown, with_numbers
from . import estimate
from .counting import recording
from .estimate import Estimator, Sensitivities, Sensitivity, results_of
from .estimators import Accumulator, Source, counted, counting_engine, differenced, recorded, run_chunks, score_leaves
from .problem import (
    Pilot,
    SensitivityProblem,
    buffer_sizes_for,
    in_rows,
    problem_of,
    relative_bandwidth_of,
    require_correctable,
    warn_at_special_speeds,
    warn_if_grazing,
)
from .statistic import AnyStatistic, BufferSizes, OfOutput, features_of, record_sequences, statistic_of, wrapped

# A warning where parameters act only together, as a friction coefficient and a normal force do through their product.
#
# Then the derivatives by their logarithms are proportional in every sample, up to round-off, and so are those of every
# statistic: none can tell the parameters apart. Equality in the inequality of Cauchy and Schwarz is the test.


_PROPORTIONAL = 1e-9  # of the squares: what is not proportional, relative to the whole


def products_among(problem: SensitivityProblem, accumulated: Accumulator) -> list[str]:
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


def _columns(accumulated: Accumulator, parameter: int, squares: np.ndarray) -> np.ndarray:
    """The columns of the derivatives of all statistics by a parameter: pathwise ones, unless these are 0 or not known.

    Kernels, and differences, estimate event parts to first order only: they are less exactly proportional.
    """
    each = [accumulated.columns(number, parameter)[2:] for number in range(len(accumulated.in_window))]
    pathwise = np.concatenate([columns[-2:] for columns in each])
    whole = np.concatenate([columns[:-2] for columns in each])
    return pathwise if np.any(squares[pathwise, pathwise] > 0) else whole


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
        system: A `MassSpring`, a `MotorCart`, a `SwitchedSystem` of your own; or one with several contacts that says
            which is counted, ``system.of_contact(0)``, or all at once, ``system.of_all_contacts()``. Its numbers may
            be distributions.
        law: The excitation, any that `simulate_ensemble` takes; it or `y0` must be random.
        wrt: The name of a number in system, law or `y0`, such as "mu", "mu_static", "normal_force", "mass",
            "stiffness", "damping", "speed", "rate", "interval", "y0[0]", or several; "law.speed" where a name is
            ambiguous.
        t1: Duration of each sample, s.
        samples: Their number, at least 2.
        key: From ``jax.random.key(seed)``; None where nothing is random.
        y0: Initial state, such as ``(position, velocity)``, numbers or distributions; zeros by default.
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
        method: `Exact` or `Regularized`. Of regularised dynamics there are differences only; a threshold that is not
            given follows the parameter.
        threads: Worker threads (default: all cores); the result does not depend on it.
        chunk: Samples simulated per call (default: chosen for speed); the result depends on it only by the order of
            summation.

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
    # The given step, or the wider of two that agree.
    choices = [estimate.OUTPUT if kind.is_output else estimate.PAIRED for kind in kinds]
    steps = [widest * np.array(choice) if step is None else np.array([step]) for choice in choices]
    if chosen == "corrected":
        kinds = [kind.in_closed_form() for kind in kinds]
        for kind in kinds:
            require_correctable(kind)

    def of_lanes(lanes: int) -> tuple[list[Source], Accumulator]:
        each = [kind.of_lanes(lanes) for kind in kinds]
        if chosen == "corrected":
            sources = [source_of(kind, pilot, widest) for kind in each]
        else:
            sources = [differenced(kind, pilot, of, with_pathwise=False) for kind, of in zip(each, steps, strict=True)]
        return sources, run_chunks(sources, problem.samples, problem.threads)

    sources, accumulated = as_many_as_fit(of_lanes, problem.lanes)
    grazing = warn_if_grazing(kinds[0]) if chosen == "corrected" else ()
    widths = [source.widths for source, kind in zip(sources, kinds, strict=True) for _ in kind.statistics]
    found = results_of(problem, accumulated, widths, elasticity, chosen, grazing)
    for sentence in products_among(problem, accumulated):
        checks.warn(f"{sentence}; vary one of them only.")
    checked = range(len(found))  # the statistics whose windows are compared
    if chosen == "corrected":
        each = enumerate(map(problem.only, problem.statistics))
        checked = [at for at, one in each if one.has_sudden_switches or not one.ignores_stick_count]
        if checked:
            warn_at_special_speeds(kinds[0], grazing)
    disagreeing = [
        parameter.name
        for number in checked
        for place, parameter in enumerate(problem.parameters)
        if parameter.name not in grazing and estimate.windows_disagree(accumulated.single(number, place))
    ]
    if disagreeing:
        checks.warn(
            f"No two windows agree on the derivative with respect to {', '.join(dict.fromkeys(disagreeing))}: it "
            "depends on how far one looks for sticks about to appear or vanish, or does not exist. That of the "
            "narrowest window is given, with a standard error of NaN; compare with estimator='finite-difference' at "
            "several steps."
        )
    few = min((one.sticks_in_window for at in checked for one in found[at].values()), default=estimate.FEW)
    if chosen == "corrected" and few < estimate.FEW:
        checks.warn(
            f"The event part rests on {few} sticks only, so that its standard error means little; take more samples."
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
    checks.truth("elasticity", elasticity)
    check_estimator(estimator)
    options: tuple[tuple[str, float | None, Estimator], ...] = (
        ("step", step, "finite-difference"), ("relative_bandwidth", relative_bandwidth, "corrected")
    )  # fmt: skip
    for name, value, of in options:
        if value is not None:
            checks.positive(name, value)
            if estimator not in (None, of):
                raise checks.refused(name, f"be left out with estimator={estimator!r}", value)
    if step is not None and relative_bandwidth is not None:
        raise ValueError(
            f"Argument step must be left out with relative_bandwidth, but step={step} and relative_bandwidth="
            f"{relative_bandwidth} were given; step is for estimator='finite-difference', relative_bandwidth for "
            "estimator='corrected'."
        )
    return estimator or next((of for _, value, of in options if value is not None), None)


def cheaper(problem: SensitivityProblem) -> Estimator:
    """The estimator with the smaller error in the same time (measured: docs/sensitivity.md)."""
    is_exact = not isinstance(problem.method, Regularized)
    can_be = problem.is_counted and problem.can_be_corrected and not problem.has_sudden_switches
    by_steps = problem.ignores_stick_count and problem.dtype.itemsize == 8  # else `require_correctable` refuses
    return "corrected" if is_exact and can_be and (problem.by_intervals or by_steps) else "finite-difference"


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


# The mean of an output as a function of parameters, for `differentiable`: compiled, with differences as derivative.


_OUTPUT_LANES = 64
_SPARE = 2  # times as many steps and intervals as at the parameters given


def output_means(problem: SensitivityProblem, samples: int) -> Callable[[Array], Float[Array, "2"]]:
    """A function of the parameters' values: the sums of the output, and of 1, over the samples that finish.

    NaN where a sample needs more steps, or intervals of the base, than twice as many as at the parameters given.
    """
    (statistic,), model, method = problem.statistics, problem.model, problem.method
    assert isinstance(statistic, OfOutput)
    for parameter in problem.parameters:
        if any(isinstance(number_at(model, parameter.path[:end]), RandomNumber) for end in range(len(parameter.path))):
            raise ValueError(
                f"Argument wrt must name plain numbers for outputs, but {shown(parameter.path)} is that of a "
                "distribution; use sensitivity."
            )
    key = jax.random.wrap_key_data(problem.key_data)
    options = (problem.samples, 0, key, None, method, "totals", Numbering(1, True))
    inputs = EnsembleSetup.checked(model, problem.t1, *options).inputs
    rows, lanes = in_rows(samples, _OUTPUT_LANES, problem.recorded_lanes if is_wide() else _OUTPUT_LANES)
    columns = tuple(jnp.asarray(column) for column in inputs.drawn(0, samples, problem.dtype))
    numbers = jnp.asarray(inputs.realization_numbers(0, samples))
    bases = inputs.realizations(0, samples, problem.t1)
    paths = tuple(parameter.path for parameter in problem.parameters)
    if isinstance(method, Exact) and not problem.by_intervals:
        method = Exact(max_steps=_SPARE * problem.steps)  # a number that does not depend on the parameters
    room = {"capacity": _SPARE * problem.law.segments(problem.t1)} if isinstance(problem.law, SegmentLaw) else {}

    def sample(values: Array, column: tuple[Array, ...], number: Array, base: Any) -> Float[Array, "2"]:
        system, law, y0 = with_numbers(inputs.filled(column), paths, values)
        if base is None:
            # The numbers of the law may be traced.
            base = law.sample(jax.random.fold_in(key, number), problem.t1, **room) if is_random(law) else law
        one = simulate(system, base, t1=problem.t1, y0=y0, method=method)
        finished = one.status == Status.FINISHED
        short = (one.status == Status.OUT_OF_STEPS) | (one.status == Status.BASE_TOO_SHORT)
        value = jnp.where(finished, statistic.output.number(one, problem.dtype), jnp.where(short, jnp.nan, 0))
        return jnp.stack([value, finished.astype(value.dtype)])

    def means(values: Array) -> Float[Array, "2"]:
        batches = jax.tree.map(lambda leaf: leaf.reshape(rows, lanes, *leaf.shape[1:]), (columns, numbers, bases))
        each = lax.map(lambda batch: jax.vmap(partial(sample, values))(*batch), batches)
        return jnp.sum(each, axis=(0, 1))

    return means


# A statistic as a function of parameters, for the user's own objectives, with the corrected derivative.


def differentiable(
    statistic: AnyStatistic,
    system: System,
    law: BaseMotion,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None = None,
    y0: InitialState | None = None,
) -> Callable[[ArrayLike], Array]:
    """A function of the values of the parameters `wrt` that estimates `statistic`, to use under ``jax.jit``.

    Call it with one number (`wrt` a name) or an array (as many as names). Differentiating it, in forward or reverse
    mode, gives the derivative of the expectation, corrected for sticks that appear and vanish as in `sensitivity`;
    the slope of the simulated mean, which is only piecewise smooth, is a different number. Every call uses the same
    random numbers, so there is no noise from call to call, but the function has small jumps. It has no second
    derivatives.

    The windows of the kernels are chosen once, from the parameters of `system` and `law` given here.

    Args:
        statistic: One that `sensitivity` takes, such as `mean_stick_duration` or ``StickDuration(1)``. The derivative
            of an `Output` is that of central differences with the same random numbers, whose step is the default of
            `sensitivity`.
        system: A `MassSpring`, a `MotorCart` or a `SwitchedSystem` of your own; its numbers may be distributions.
        law: The excitation, any that `simulate_ensemble` takes; it or `y0` must be random.
        wrt: The name of a number in system, law or `y0`, such as "mu", "rate" or "y0[0]", or several.
        t1: Duration of each sample, s.
        samples: Number of samples, rounded up to a multiple of 256.
        key: From ``jax.random.key(seed)``; None where nothing is random.
        y0: Initial state, such as ``(position, velocity)``, numbers or distributions; zeros by default.

    Returns:
        The function. Its result is NaN where the statistic is defined for no sample, or where a sample has far more
        sticks than at the parameters given here.

    Raises:
        ValueError: For what `sensitivity` with ``estimator="corrected"`` refuses.
    """
    if isinstance(statistic, (list, tuple)):
        raise checks.refused("statistic", "be one statistic (sensitivity takes several)", statistic)
    problem, pilot = problem_of(statistic, system, law, wrt, t1, samples, key, y0)
    number, bandwidth = -(-problem.samples // LANES) * LANES, relative_bandwidth_of(problem, pilot)
    if problem.is_output:
        means = output_means(problem, number)
    else:
        require_correctable(problem)
        means = (_counted if problem.is_counted else _recorded)(problem, pilot, bandwidth, number)
    ratio = _ratio(means, bandwidth if problem.is_paired or problem.is_output else None)
    number = len(problem.parameters)

    def of(values: ArrayLike) -> Array:
        values = jnp.asarray(values, problem.dtype)
        if values.shape != (() if isinstance(wrt, str) else (number,)):
            raise ValueError(
                f"Argument values must hold {'one number' if isinstance(wrt, str) else f'{number} numbers'}, one for "
                f"each of {wrt}, but an array of shape {values.shape} was given."
            )
        return ratio(values.reshape(number))

    return of


_Means: TypeAlias = Callable[..., Float[Array, "2"]]
"""Means of numerator and denominator at parameter values, (values,).

To differentiate, pass the same values again as the second argument and differentiate by that.
"""


def _ratio(means: _Means, step: float | None) -> Callable[[Float[Array, " values"]], FloatArray]:
    """The ratio of both means, with its derivative by the quotient rule, all in one pass.

    With a `step` (relative to each value), the derivatives of the means are central differences.
    """

    def slopes(values: Array, units: Array) -> Float[Array, "values 2"]:
        """Derivatives of both means by every value, measured in `units`."""

        def along(direction):
            if step is not None:
                return (means(values + step * direction) - means(values - step * direction)) / (2 * step)
            return jax.jvp(lambda varied: means(values, varied), (values,), (direction,))[1]

        return jax.vmap(along)(jnp.diag(units))

    @jax.custom_jvp
    def ratio(values):
        above, below = means(values)
        return above / below

    @ratio.defjvp
    def _(primals, tangents):
        (values,), (moves,) = primals, tangents
        above, below = means(values)
        units = jnp.where(values == 0, 1, jnp.abs(values))
        by_unit = slopes(values, units)
        slope = (by_unit[:, 0] - above / below * by_unit[:, 1]) / below / units
        return above / below, jnp.sum(slope * moves)

    return ratio


def _counted(problem: SensitivityProblem, pilot: Pilot, bandwidth: float, samples: int) -> _Means:
    """Means by the engines that count sticks."""
    # One window, the widest: comparing several is not possible inside a compiled function.
    engine = counting_engine(problem, pilot, np.array([] if problem.is_paired else [bandwidth]))
    weights = jnp.asarray(problem.totals[0].weights(problem.t1), problem.dtype)
    leaves, by = problem.leaves, score_leaves(problem, engine)
    varying, (rows, lanes) = problem.varying_leaves(0, samples), in_rows(samples, LANES, problem.lanes)

    def means(values: Array, varied: Array | None = None) -> Array:
        # The likelihood knows a rate beside the law's, and the derivative is by that one.
        here = with_leaves(with_leaves(engine, leaves, values), by, values if varied is None else varied)
        job = Job(here, problem.key_data, np.uint32(0), np.int32(rows), varying)
        counted = summarize(job, lanes=lanes, rows=rows, dtype=problem.dtype)
        done = counted.status == Status.FINISHED
        sticks = sum(counted.sums.event_parts, jnp.asarray(counted.sticks, problem.dtype))
        totals = [jnp.where(done, jnp.asarray(leaf), 0) for leaf in (counted.stick_time, sticks, done)]
        return weights @ jnp.stack([jnp.sum(leaf, dtype=problem.dtype) for leaf in totals])

    return means


def _recorded(problem: SensitivityProblem, pilot: Pilot, bandwidth: float, samples: int) -> _Means:
    """Means by recorded stick sequences."""
    engine, leaves, buffer = problem.engine(), problem.leaves, buffer_sizes_for(problem, pilot)
    buffer = BufferSizes(2 * buffer.blocks, 2 * buffer.slots, 0 if problem.is_paired else 2 * buffer.candidates)
    bandwidths = np.array([bandwidth])
    varying = tuple(jnp.asarray(column) for column in problem.varying_leaves(0, samples))
    rows, lanes = in_rows(samples, LANES, problem.recorded_lanes if is_wide() else LANES)

    def means(values: Array, varied: Array | None = None) -> Array:
        here = with_leaves(engine, leaves, values if varied is None else varied)
        here = wrapped(here, partial(recording, first=problem.first_segment))

        def chunk(first):
            mine = jax.tree.map(lambda column: lax.dynamic_slice_in_dim(column, first, lanes), varying)
            job = Job(here, problem.key_data, first, np.int32(1), mine)
            recorded = record_sequences(job, lanes=lanes, buffer=buffer, dtype=problem.dtype)
            features = features_of(problem.statistics[0], recorded, bandwidths)
            status, sticks, candidates = recorded.counts
            done = (status == Status.FINISHED)[:, None]
            lost = jnp.any((sticks >= buffer.slots) | (candidates > buffer.candidates))
            parts = jnp.where(done, features.parts + features.event_parts[:, 0], 0)
            return jnp.where(lost, jnp.nan, jnp.sum(parts, axis=0))

        firsts = jnp.arange(rows, dtype=jnp.uint32) * np.uint32(lanes)
        return jnp.sum(lax.map(chunk, firsts), axis=0)

    return means
