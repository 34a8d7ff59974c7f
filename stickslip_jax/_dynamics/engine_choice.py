"""Choice of the engine that simulates a system: for one trajectory, for ensembles and for sensitivities."""

from typing import NamedTuple, cast

import numpy as np

from .._excitation.excitation import BaseMotion, excitation_of
from .._excitation.merged import merged
from .._excitation.motion import Motion
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._numerics.known import largest
from .._systems.mass_spring import MassSpring
from .._systems.system import System
from .._types import AnyArray, DType, Number, Scalar
from .._uncertainty.inputs import Inputs
from .common.engine import Engine
from .common.method import Exact, Regularized
from .common.path import Run
from .common.time_scales import longest_step
from .common.validation import Arguments
from .common.varying import Engines, engines_of, widest
from .interval.engine import IntervalEngine
from .interval.path import follow_intervals
from .regularized.engine import AdaptiveBatch, FixedEngine
from .regularized.path import follow_regularized
from .regularized.settings import fixed_steps, resolved
from .regularized.solve import table_sizes
from .switched.engine import SwitchedEngine
from .switched.path import follow_steps
from .switched.run import steps_for

_MOST_COUNTED = 2**31 - 1
_AT_ONCE = 1 << 16  # samples whose engines are made together to find the largest sizes


class ByIntervals(NamedTuple):
    """Closed forms over whole intervals of a piecewise-constant base velocity.

    The system is a `MassSpring`, the only one with an interval form.
    """

    arguments: Arguments

    def follow(self, y0: tuple[Number, ...], dtype: DType) -> tuple[Exact | Regularized, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        system, base, method, t1 = self.arguments
        return method, follow_intervals(system, base, t1, y0, dtype)

    def lanes(self, y0: tuple[Number, ...], dtype: DType) -> IntervalEngine:
        """The engine that simulates samples of the law."""
        system, base, _, t1 = self.arguments
        (law,) = excitation_of(base).base
        return IntervalEngine(cast(MassSpring, system), cast(PiecewiseConstantLaw, law), t1, y0)


class BySteps(NamedTuple):
    """Time steps in which every event is located, for any system and excitation."""

    arguments: Arguments

    def follow(self, y0: tuple[Number, ...], dtype: DType) -> tuple[Exact, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        system, base, method, t1 = self.arguments
        assert isinstance(method, Exact)
        return method, follow_steps(system, base, method, t1, y0, dtype)

    def lanes(self, y0: tuple[Number, ...], dtype: DType) -> SwitchedEngine:
        """The engine that simulates samples of the law."""
        system, _, method, t1 = self.arguments
        excitation, step = self.arguments.checked_step("law")
        self.arguments.check_length()
        # Generous: a sample that needs more steps has failed, or its events accumulate at one instant.
        most = np.int32(min(method.max_steps or 20 * steps_for(system, excitation, t1, step), _MOST_COUNTED))
        return SwitchedEngine(system.ready(), excitation, method.solver, t1, y0, step, most)


class Smoothed(NamedTuple):
    """Regularised dynamics, in fixed or adaptive steps."""

    arguments: Arguments

    def follow(self, y0: tuple[Number, ...], dtype: DType) -> tuple[Regularized, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        system, base, method, t1 = self.arguments
        assert isinstance(method, Regularized)
        return follow_regularized(system, base, method, t1, y0, dtype)

    def lanes(self, y0: tuple[Number, ...], dtype: DType) -> FixedEngine | AdaptiveBatch:
        """The engine that simulates samples of the law."""
        system, base, method, t1 = self.arguments
        excitation = excitation_of(base, "law")
        system.check_excitation(excitation)
        self.arguments.check_length()
        assert isinstance(method, Regularized)
        method = resolved(system, excitation, method, dtype)
        if method.step is None:
            if system.track_count is not None:
                raise ValueError(
                    "Argument method must give a step, Regularized(width, step=...), for the sticks of every contact "
                    "of many samples; with adaptive steps take system.of_contact(number) or system.of_all_contacts()."
                )
            sizes = table_sizes(system, excitation, largest(t1))
            longest = longest_step(system, excitation)
            return AdaptiveBatch(system, excitation, method, t1, y0, longest, tuple(np.int32(size) for size in sizes))
        # Twice the expected number, for samples with many jumps. `fixed_steps` also rejects a step that is too long.
        expected = 2 * fixed_steps(system, excitation, method, t1)
        return FixedEngine(
            system.ready(), excitation, method, t1, y0, np.int32(min(method.max_steps or expected, _MOST_COUNTED))
        )


def engine_for(arguments: Arguments) -> ByIntervals | BySteps | Smoothed:
    """The fastest engine for these arguments, whose base is a law or a realisation.

    The choice depends on their types and options, not on their numbers.
    """
    system, base, method, t1 = arguments
    base = merged(base, t1)
    if isinstance(method, Regularized):
        return Smoothed(Arguments(system, base, method, t1))
    if system.inner_laws:
        raise ValueError(
            "Argument method must be Regularized() for friction laws with an inner state, but Exact() was given: they "
            "have no exact stick. Their sticks are the times in which the relative velocity stays below a threshold."
        )
    exact = Arguments(system, base, method, t1)
    is_steady = isinstance(base, Motion) and base.is_piecewise_constant
    if is_steady and system.has_interval_form and method.step is None and method.solver is None:
        return ByIntervals(exact)
    return BySteps(exact)


def lanes_for(
    system: System, law: BaseMotion, method: Exact | Regularized, t1: float, y0: tuple[Number, ...], dtype: DType
) -> Engine | AdaptiveBatch:
    """The engine that simulates samples of `law`, with its arguments checked."""
    if isinstance(law, PiecewiseConstantLaw):
        law.checked_capacity(t1)
    return engine_for(Arguments(system, law, method, t1)).lanes(y0, dtype)


def sample_engines(
    inputs: Inputs, method: Exact | Regularized, t1: Scalar, dtype: DType, first: int, number: int
) -> Engines:
    """The engines of samples ``first .. first + number - 1``, whose `inputs` differ."""

    def build(values: tuple[AnyArray, ...], base: BaseMotion | None) -> Engine | AdaptiveBatch:
        system, law, y0 = inputs.filled(values)
        arguments = Arguments(system, law if base is None else base, method, t1)
        return engine_for(arguments).lanes(system.with_memory(y0), dtype)

    base = inputs.realizations(first, number, float(t1))
    return engines_of(build, inputs.drawn(first, number, dtype), base)


def engines_of_all(inputs: Inputs, method: Exact | Regularized, t1: Scalar, dtype: DType) -> Engines:
    """The engines of all samples: one that stands for all, and which of its leaves are drawn for each sample.

    Of the drawn leaves, those of the first samples only are returned.
    """
    every = [
        sample_engines(inputs, method, t1, dtype, first, min(_AT_ONCE, inputs.samples - first))
        for first in range(0, inputs.samples, _AT_ONCE)
    ]
    return every[0]._replace(template=widest([some.template for some in every], every[0].leaf_numbers))
