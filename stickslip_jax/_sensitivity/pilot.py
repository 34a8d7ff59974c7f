"""Check of the arguments, and a pilot simulation of few samples, from which the widths of the kernels are chosen."""

from collections.abc import Sequence

import jax.numpy as jnp

from .. import _checks
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.common.validation import check_method, state_of
from .._ensemble.call import simulate_ensemble
from .._ensemble.data import Keep
from .._excitation.excitation import BaseMotion, is_random, key_data_for, law_of
from .._excitation.piecewise_constant import GivenSteps, VelocitySteps
from .._forks import require_threads_of_jax
from .._processor import cores
from .._systems.system import System, require_system
from .._types import Array, InitialState
from .._uncertainty.inputs import Inputs, Model
from .._uncertainty.numbers import parameters_of
from .problem import Pilot, Problem
from .statistic import AnyStatistic, OfOutput, statistics_of

_PILOT = 1024  # samples
_RELATIVE_BANDWIDTH, _STICKS = 0.005, 1e6  # relative bandwidth of the widest window at so many sticks
_LARGEST_BANDWIDTH = 0.05


def problem_of(
    statistic: AnyStatistic | Sequence[AnyStatistic],
    system: System,
    law: BaseMotion,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None,
    y0: InitialState | None,
    *,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
    chunk: int | None = None,
) -> tuple[Problem, Pilot]:
    """The checked problem, and the pilot simulation of its motion. Raises ValueError for invalid arguments."""
    require_threads_of_jax()
    statistics = statistics_of(statistic)
    threads = cores() if threads is None else _checks.whole_number("threads", threads)
    size = None if chunk is None else _checks.whole_number("chunk", chunk)
    check_method(method)
    number = _checks.whole_number("samples", samples, minimum=2, maximum=2**31)
    inputs = Inputs.of(Model(system, law_of(law), y0), number, key)
    dtype = jnp.result_type(float)
    inputs.check(dtype)
    first = inputs.of_sample(0, dtype)
    first = first._replace(y0=state_of(require_system(first.system), first.y0))
    inputs = inputs.with_start(first.y0)
    _require_chance(first.law, inputs)
    smoothed = isinstance(method, Regularized)
    from_totals = all(one.is_of_totals or isinstance(one, OfOutput) for one in statistics)
    keep: Keep = "totals" if from_totals and not smoothed else "sticks"
    pilot = _pilot(inputs, t1, key, method, keep, threads)
    parameters, key_data = parameters_of(inputs.model._asdict(), wrt), key_data_for(first.law, key)
    base = inputs.realization_of(0, first.law, t1) if inputs.has_sampled_law else first.law
    base = GivenSteps(base) if isinstance(base, VelocitySteps) else base
    problem = Problem(
        statistics, first.system, base, float(t1), first.y0, method, key_data, parameters, number, threads, size,
        dtype,
    )  # fmt: skip
    problem = problem._replace(model=inputs.model)
    return problem if smoothed else problem.with_inputs(inputs), pilot


def require_precision(problem: Problem) -> None:
    """Raise ValueError where float32 resolves neither near misses nor the derivatives of slips that begin slowly."""
    if problem.dtype.itemsize < 8 and not (problem.by_intervals or problem.has_sudden_switches):
        raise ValueError(
            "Argument system (or law) must be a MassSpring without damping or force on a base of piecewise-constant "
            "velocity, in single precision: for any other motion round-off hides how close an arc came to the base "
            "velocity, and how slowly a slip began. Call jax.config.update('jax_enable_x64', True) first, or use "
            "estimator='finite-difference'."
        )


def require_correctable(problem: Problem) -> None:
    """Raise ValueError where the corrected method does not know what differs from sample to sample."""
    if not problem.can_be_corrected:
        raise ValueError(
            "Argument estimator must be 'finite-difference' (the default here) where numbers of the system or law "
            "differ from sample to sample and the motion has no closed form from jump to jump of the base, where the "
            "law is an object of your own with a method sample(key, t1), where the parameter belongs to a Beta "
            "distribution or to the distribution of a switching rate, for systems with a list of contacts, and for "
            "outputs and statistics of slips."
        )


def relative_bandwidth_of(problem: Problem, pilot: Pilot) -> float:
    """Default relative bandwidth of the kernels: ``0.005 (sticks / 10^6)^(-1/5)``, at most 0.05.

    As in density estimation: with a bias of second order, the mean squared error is least for widths that shrink as the
    fifth root of the number of sticks.
    """
    return min(_RELATIVE_BANDWIDTH * (problem.samples * max(pilot.sticks, 1e-3) / _STICKS) ** -0.2, _LARGEST_BANDWIDTH)


def _pilot(
    inputs: Inputs, t1: float, key: Array | None, method: Exact | Regularized, keep: Keep, threads: int
) -> Pilot:
    """A pilot simulation, which also checks the arguments."""
    number = min(inputs.samples, _PILOT)
    system, law, y0 = inputs.head(number)
    many = simulate_ensemble(
        system, law, t1=t1, samples=number, key=key, y0=y0, method=method, keep=keep, threads=threads, progress=False
    )
    if many.moments.number < 2:
        raise ValueError(f"Fewer than two of {number} trajectories reached t1, so that there is no statistic: {many}")
    stick_time, sticks = (float(mean) for mean in many.moments.mean[:2])
    return Pilot(stick_time, sticks, int(many.require_sticks().count.max()) if keep == "sticks" else None)


def _require_chance(law: BaseMotion, inputs: Inputs) -> None:
    """Raise ValueError where nothing is random."""
    if not is_random(law) and not inputs.are_random:
        raise ValueError(
            "Argument law must be random, or system or y0 hold a distribution such as Uniform: without chance the "
            "number of sticks is a step function of the parameters, and has no derivative to correct. Differentiate "
            "simulate(...) with jax.jvp."
        )
