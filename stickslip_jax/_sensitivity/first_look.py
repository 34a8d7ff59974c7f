"""Check of the arguments, and a short pilot simulation, from which the widths of the kernels are chosen."""

from typing import Any

import jax.numpy as jnp

from .. import _checks
from .._dynamics.method import EXACT, Exact
from .._dynamics.validation import state_of
from .._ensemble.call import simulate_ensemble
from .._ensemble.parts import Keep
from .._excitation.excitation import is_random, key_data_for
from .._fast_cpu import cores
from .._fields import is_distribution
from .._inputs.numbers import parameters_of
from .._systems.system import require_system
from .problem import Pilot, Problem
from .statistic import statistic_of

COUNTED_WINDOWS, RECORDED_WINDOWS = (1.0, 0.25), (1.0, 0.5, 0.25, 0.125)  # relative widths to choose from
PAIRED_WINDOWS = (1.0, 0.25)
_PILOT = 1024  # samples
_RELATIVE_BANDWIDTH, _STICKS = 0.005, 1e6  # relative bandwidth of the widest window at so many sticks
_LARGEST_BANDWIDTH = 0.05


def problem_of(
    statistic: Any,
    system: Any,
    law: Any,
    wrt: Any,
    t1: float,
    samples: int,
    key: Any,
    y0: Any,
    *,
    method: Any = EXACT,
    threads: int | None = None,
    chunk: int | None = None,
) -> tuple[Problem, Pilot]:
    """The checked problem, and the pilot simulation of its motion. Raises ValueError for invalid arguments."""
    statistic = statistic_of(statistic)
    threads = cores() if threads is None else _checks.whole_number("threads", threads)
    size = None if chunk is None else _checks.whole_number("chunk", chunk)
    if not isinstance(method, Exact):
        raise ValueError(f"Argument method must be Exact(...), but {_checks.show(method)} was given.")
    require_system(system)
    y0 = _checked_start(system, law, y0)
    keep: Keep = "totals" if statistic.is_of_totals else "sticks"
    pilot = _pilot(system, law, t1, y0, samples, key, method, keep, threads)
    parameters = parameters_of({"system": system, "law": law, "y0": y0}, wrt)
    key_data, dtype = key_data_for(law, key), jnp.result_type(float)
    problem = Problem(
        statistic, system, law, float(t1), y0, method, key_data, parameters, samples, threads, size, dtype
    )
    return problem, pilot


def require_precision(problem: Problem) -> None:
    """Raise ValueError where float32 resolves neither near misses nor derivatives of slips that begin slowly."""
    if problem.dtype.itemsize < 8 and not (problem.by_intervals or problem.has_sudden_switches):
        raise ValueError(
            "Argument system (or law) must be a MassSpring without damping or force on a base of piecewise-constant "
            "velocity, in single precision: round-off hides how nearly an arc of any other motion missed, and how "
            "slowly a slip began. Call jax.config.update('jax_enable_x64', True) first, or use "
            "estimator='finite-difference'."
        )


def relative_bandwidth_of(problem: Problem, pilot: Pilot) -> float:
    """Default relative bandwidth of the kernels: ``0.005 (sticks / 10^6)^(-1/5)``, at most 0.05.

    As in density estimation: with a bias of second order, the mean squared error is least for widths that shrink as the
    fifth root of the number of sticks.
    """
    return min(_RELATIVE_BANDWIDTH * (problem.samples * max(pilot.sticks, 1e-3) / _STICKS) ** -0.2, _LARGEST_BANDWIDTH)


def _pilot(
    system: Any,
    law: Any,
    t1: float,
    y0: tuple[Any, ...],
    samples: int,
    key: Any,
    method: Exact,
    keep: Keep,
    threads: int,
) -> Pilot:
    """A pilot simulation, which also checks the arguments."""
    number = min(_checks.whole_number("samples", samples, minimum=2), _PILOT)
    many = simulate_ensemble(
        system, law, t1=t1, samples=number, key=key, y0=y0, method=method, keep=keep, threads=threads, progress=False
    )
    if many.moments.number < 2:
        raise ValueError(f"Fewer than two of {number} trajectories reached t1, so that there is no statistic: {many}")
    stick_time, sticks = (float(mean) for mean in many.moments.mean[:2])
    return Pilot(stick_time, sticks, int(many.require_sticks().count.max()) if keep == "sticks" else None)


def _checked_start(system: Any, law: Any, y0: Any) -> tuple[Any, ...]:
    """The initial state. Raises ValueError where nothing is random."""
    start = state_of(system, y0)
    if not is_random(law) and not any(is_distribution(value) for value in start):
        raise ValueError(
            "Argument law must be random, or y0 hold a Uniform value: without chance the number of sticks is a step "
            "function of the parameters, and has no derivative to correct. Differentiate simulate(...) with jax.jvp."
        )
    return start
