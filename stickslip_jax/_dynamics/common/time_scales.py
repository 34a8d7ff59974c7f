"""Choice and check of the time step, from the time scales of a system and of its excitation."""

import math
from contextlib import suppress
from typing import Any

import jax.numpy as jnp

from ... import _checks
from ..._excitation.excitation import BaseMotion, Excitation, excitation_of
from ..._excitation.smooth import SEEN_IN_STEPS
from ..._numerics.known import NotKnown, largest, primal_of, smallest
from ..._systems.system import SHORTEST_TIME, StepCount, System
from ..._types import Scalar
from .method import Exact, Regularized
from .stopping_scan import padded_length

_USUAL = StepCount(1.0, 1.0)
_ACCURATE = 6  # times as many steps as a time scale needs at least: fixed steps are then hardly ever shortened


def step_for(system: System, excitation: Excitation, method: Exact | Regularized) -> Scalar:
    """The time step (s) of `method`, checked; by default a fraction of the shortest time scale.

    Raises ValueError for a step that is too long for a time scale, and where `method` gives none although a time scale
    is not known.
    """
    scales = {
        name: (primal_of(of.time), of.steps) for name, of in system.time_scales(excitation, method.solver).items()
    }
    if isinstance(method, Regularized):  # whose fixed steps are not shortened where the motion is fast
        scales["time scale of the fastest motion"] = primal_of(system.usual_step(excitation)), _USUAL
    known = {name: (time, steps) for name, (time, steps) in scales.items() if time is not None}
    unknown = [name for name in scales if name not in known]
    if method.step is None and unknown:
        raise ValueError(
            f"Argument method must give the step, Exact(step=...), but the {unknown[0]} is not known; or give what "
            f"you wrote a property {_property_of(unknown[0])} (s)."
        )
    if method.step is None:
        return _shortest([time / count.default for time, count in known.values()])
    step = primal_of(method.step)
    limits = [time / count.least for time, count in known.values() if _checks.is_traced(time)]
    if limits:  # numbers that are not known before the call: steps that are too long cannot be refused, so shorten them
        step = jnp.min(jnp.stack([jnp.asarray(limit, float) for limit in (step, *limits)]))
    for name, (time, count) in known.items():
        with suppress(NotKnown):
            shortest, given = smallest(time), largest(step)
            longest, share = shortest / count.least, 1 / count.least
            if given > longest * (1 + 1e-9):
                raise ValueError(
                    f"Argument step must be at most {longest:.4g} s, {share:.2g} times the {name} of {shortest:.4g} "
                    f"s, but {given} was given; between longer steps sticks could be missed."
                )
    return step


def longest_step(system: System, excitation: Excitation) -> Scalar:
    """The longest adaptive step (s): one that no change of what drives the system can be hidden in; infinity if any.

    Steps end at the points of records and at jumps in any case. Raises ValueError where a shortest period is not known.
    """
    times = {name: primal_of(time) for name, time in system.driving_times(excitation).items()}
    unknown = [name for name, time in times.items() if time is None]
    if unknown:
        fixed = "" if system.inner_laws else ", or choose a fixed step, Regularized(width, step=...)"
        raise ValueError(
            f"Argument method must not leave the steps to the motion while the {unknown[0]} is not known, for they "
            f"could pass over a short pulse: give what you wrote a property {_property_of(unknown[0])} (s){fixed}."
        )
    return _shortest([time / SEEN_IN_STEPS for time in times.values() if time is not None])


def _property_of(name: str) -> str:
    return "shortest_time" if name == SHORTEST_TIME else "shortest_period"


def _shortest(times: list[Any]) -> Scalar:
    if any(_checks.is_traced(time) for time in times):
        return jnp.min(jnp.stack([jnp.asarray(time, float) for time in times]))
    return min(map(float, times))


def accurate_step(system: System, excitation: Excitation, step: float) -> float:
    """The fixed `step` (s), or if shorter that to which the time scales that are known let it be shortened."""
    scales = system.time_scales(excitation, None).values()
    longest = _known([of.time / of.steps.least for of in scales if of.time is not None])
    return min([step, *(time / _ACCURATE for time in longest)])


def max_steps_advice(system: System, excitation: Excitation, method: Exact | Regularized, t1: Scalar) -> str:
    """A message that proposes `max_steps` where JAX traces `t1` or a time scale, from the numbers that are known."""
    horizon = min(_known([t1]), default=100.0)
    scales = system.time_scales(excitation, method.solver).values()
    lengths = [of.time / of.steps.default for of in scales if of.time is not None]
    if method.step is not None:
        lengths = [method.step]
    found = _known(lengths)
    step = min((step for step in found if step < math.inf), default=0.01) / (1 if len(found) == len(lengths) else 4)
    steps = padded_length(math.ceil(1.5 * horizon / step) + 96)
    return f"max_steps={steps} is room for {horizon:g} s in steps of {step:.3g} s; too many cost nothing but memory"


def _known(numbers: list[Any]) -> list[float]:
    """The smallest value of each number whose value is known (not traced)."""
    found = []
    for number in numbers:
        with suppress(NotKnown):
            found.append(smallest(number))
    return found


def slowest_time(system: System, base: BaseMotion) -> float:
    """The slowest known time scale of a system, s; 1 where none is known."""
    scales = system.time_scales(excitation_of(base), None).values()
    return max((float(scale.time) for scale in scales if scale.time is not None and scale.time < math.inf), default=1.0)
