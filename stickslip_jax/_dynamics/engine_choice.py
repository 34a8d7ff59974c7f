"""Choice of the engine that simulates a system: for one trajectory, for ensembles and for sensitivities."""

from typing import Any, NamedTuple

import numpy as np

from .._excitation.excitation import GivenSteps, excitation_of
from .._excitation.merged import merged
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._excitation.velocity_steps import VelocitySteps
from .._inputs.inputs import Inputs
from .._numerics.known import largest
from .._systems.system import System
from .._types import Scalar
from .interval.lanes import IntervalEngine
from .interval.path import follow_intervals
from .lanes import Engine
from .method import Exact, Regularized
from .path import Run
from .regularized.lanes import AdaptiveBatch, FixedEngine
from .regularized.path import follow_regularized
from .regularized.settings import fixed_steps, resolved
from .regularized.solve import table_sizes
from .switched.lanes import SwitchedEngine
from .switched.path import follow_steps
from .switched.run import steps_for
from .validation import check_length, checked_step, warn_of_soft_spring
from .varying import Engines, engines_of, widest

_MOST_COUNTED = 2**31 - 1
_AT_ONCE = 1 << 16  # samples whose engines are made together to find the largest sizes


class ByIntervals(NamedTuple):
    """Closed forms over whole intervals of a piecewise-constant base velocity.

    `system` is a `MassSpring`, the only system with an interval form.
    """

    system: Any
    base: Any
    method: Exact
    t1: Scalar

    def follow(self, y0: tuple[Any, ...], dtype) -> tuple[Exact, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        return self.method, follow_intervals(self.system, self.base, self.t1, y0, dtype)

    def lanes(self, y0: tuple[Any, ...], dtype) -> IntervalEngine:
        """The engine that simulates samples of the law."""
        law = GivenSteps(self.base) if isinstance(self.base, VelocitySteps) else self.base
        return IntervalEngine(self.system, law, self.t1, y0)


class BySteps(NamedTuple):
    """Time steps in which every event is located, for any system and excitation."""

    system: System
    base: Any
    method: Exact
    t1: Scalar

    def follow(self, y0: tuple[Any, ...], dtype) -> tuple[Exact, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        return self.method, follow_steps(self.system, self.base, self.method, self.t1, y0, dtype)

    def lanes(self, y0: tuple[Any, ...], dtype) -> SwitchedEngine:
        """The engine that simulates samples of the law."""
        system, method, t1 = self.system, self.method, self.t1
        excitation, step = checked_step(system, self.base, method, t1, "law")
        check_length(system, self.base, t1)
        # Generous: a sample that needs more steps has failed, or its events accumulate at one instant.
        most = np.int32(min(method.max_steps or 20 * steps_for(system, excitation, t1, step), _MOST_COUNTED))
        return SwitchedEngine(system, excitation, method.solver, t1, y0, step, most)


class Smoothed(NamedTuple):
    """Regularised dynamics, in fixed or adaptive steps."""

    system: System
    base: Any
    method: Regularized
    t1: Scalar

    def follow(self, y0: tuple[Any, ...], dtype) -> tuple[Regularized, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        return follow_regularized(self.system, self.base, self.method, self.t1, y0, dtype)

    def lanes(self, y0: tuple[Any, ...], dtype) -> FixedEngine | AdaptiveBatch:
        """The engine that simulates samples of the law."""
        system, t1 = self.system, self.t1
        excitation = excitation_of(self.base, "law")
        system.check_excitation(excitation)
        check_length(system, self.base, t1)
        method = resolved(system, excitation, self.method, dtype)
        if method.step is None:
            sizes = table_sizes(system, excitation, largest(t1))
            return AdaptiveBatch(system, excitation, method, t1, y0, tuple(np.int32(size) for size in sizes))
        # Twice the expected number, for samples with many jumps. `fixed_steps` also rejects a step that is too long.
        expected = 2 * fixed_steps(system, excitation, method, t1)
        return FixedEngine(
            system, excitation, method, t1, y0, np.int32(min(method.max_steps or expected, _MOST_COUNTED))
        )


def engine_for(system: System, base: Any, method: Exact | Regularized, t1: Scalar) -> ByIntervals | BySteps | Smoothed:
    """The fastest engine that can simulate `system` on `base` (a law or a realisation) up to `t1` (s) by `method`.

    The choice depends on the types and options of the arguments, not on their numbers.
    """
    base = merged(base, t1)
    if isinstance(method, Regularized):
        return Smoothed(system, base, method, t1)
    warn_of_soft_spring(system, method.solver, t1)
    steady = isinstance(base, (VelocitySteps, PiecewiseConstantLaw)) and system.has_interval_form
    if steady and method.step is None and method.solver is None:
        return ByIntervals(system, base, method, t1)
    return BySteps(system, base, method, t1)


def lanes_for(
    system: System, law: Any, method: Exact | Regularized, t1: float, y0: tuple[Any, ...], dtype
) -> Engine | AdaptiveBatch:
    """The engine that simulates samples of `law`, with its arguments checked."""
    if isinstance(law, PiecewiseConstantLaw):
        law.checked_capacity(t1)
    return engine_for(system, law, method, t1).lanes(y0, dtype)


def sample_engines(inputs: Inputs, method: Exact | Regularized, t1: Scalar, dtype, first: int, number: int) -> Engines:
    """The engines of samples ``first .. first + number - 1``, whose `inputs` differ."""

    def build(values, base):
        system, law, y0 = inputs.filled(values)
        return engine_for(system, law if base is None else base, method, t1).lanes(y0, dtype)

    base = inputs.realizations(first, number, float(t1))
    return engines_of(build, inputs.drawn(first, number, dtype), base)


def engines_of_all(inputs: Inputs, method: Exact | Regularized, t1: Scalar, dtype) -> Engines:
    """The engines of all samples: `template`, `places` and `origins`; the own leaves of the first samples only."""
    every = [
        sample_engines(inputs, method, t1, dtype, first, min(_AT_ONCE, inputs.samples - first))
        for first in range(0, inputs.samples, _AT_ONCE)
    ]
    return every[0]._replace(template=widest([some.template for some in every], every[0].places))
