"""Choice of the engine that simulates a system: for one trajectory, for ensembles and for sensitivities; and the
compiled functions that simulate a chunk of an ensemble.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np

from .._compiler.native import COMPILED_QUICKLY, WIDE_VECTORS, CompiledNatively
from .._compiler.programs import kept_jit
from .._excitation.excitation import BaseMotion, excitation_of, merged
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._foundation import checks
from .._foundation.processes import is_wide
from .._foundation.types import AnyArray, DType, Number, Scalar
from .._numerics.derivatives import largest
from .._numerics.matrices import MANY, stacked
from .._systems.mass_spring import MassSpring
from .._systems.system import System, is_built_in
from .._uncertainty.inputs import Inputs
from .common import lanes
from .common.lanes import Engine, Engines, engines_of, widest
from .common.method import Arguments, Exact, Regularized, longest_step, with_memory
from .common.path import Run
from .interval.engine import IntervalEngine, follow_intervals
from .regularized.engine import (
    ADAPTIVE_STEPS,
    MORE,
    base_jumps,
    fixed_steps,
    follow_regularized,
    resolved,
    table_sizes,
)
from .regularized.lanes import AdaptiveEngine, FixedEngine
from .switched.engine import SwitchedEngine, follow_steps, steps_for

# Compiled functions that simulate a chunk of an ensemble: what a worker thread calls.
#
# XLA (jaxlib 0.10.2) cannot compile every operation into a native loop (some end the process), and computes one wrong
# in wide vectors (`_compiler`). The package's own laws and systems avoid these operations; where a user's functions are
# compiled too, neither wide vectors nor native loops are used.


class CompiledLanes(NamedTuple):
    """`lanes.summarize`, `lanes.open_lanes` and `lanes.record`, compiled."""

    summarize: Callable[..., Any]
    open: Callable[..., lanes.Opened]
    record: Any


def compiled_for(engine: Engine, *, with_records: bool = False) -> CompiledLanes:
    """The compiled functions for jobs of `engine`; `with_records`: whether every sample has a base motion of its own as
    arrays, which are too large for native loops. So are those of many lanes, whose device knows no options of a CPU.
    """
    return _COMPILED[is_built_in(engine) and engine.compiles_natively and not with_records and not is_wide()]


def _compiled(is_built_in: bool) -> CompiledLanes:
    options = {**WIDE_VECTORS, **COMPILED_QUICKLY} if is_built_in else {}
    compiled = partial(CompiledNatively, compiler_options=options) if is_built_in else kept_jit
    return CompiledLanes(
        compiled(lanes.summarize, static_argnames=("lanes", "rows", "dtype")),
        kept_jit(lanes.open_lanes, static_argnames=("lanes", "rows", "dtype"), compiler_options=options),
        compiled(lanes.record, static_argnames=("layout", "lanes", "blocks", "dtype")),
    )


_COMPILED = {is_built_in: _compiled(is_built_in) for is_built_in in (True, False)}


# Choice of the engine that simulates a system: for one trajectory, for ensembles and for sensitivities.


_MOST_COUNTED = 2**31 - 1
_AT_ONCE = 1 << 16  # samples whose engines are made together to find the largest sizes


class Choice(NamedTuple):
    """What is simulated, and how: `by_intervals`, in closed forms over whole intervals of a piecewise-constant base
    velocity; else in time steps in which every event is located, or by regularised dynamics in fixed or adaptive steps.
    """

    arguments: Arguments
    by_intervals: bool = False

    def follow(self, y0: tuple[Number, ...], dtype: DType) -> tuple[Exact | Regularized, Run]:
        """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
        system, base, method, t1 = self.arguments
        if isinstance(method, Regularized):
            return follow_regularized(system, base, method, t1, y0, dtype)
        if self.by_intervals:
            return method, follow_intervals(system, base, t1, y0, dtype)
        return method, follow_steps(system, base, method, t1, y0, dtype)

    def lanes(self, y0: tuple[Number, ...], dtype: DType) -> Engine:
        """The engine that simulates samples of the law."""
        system, base, method, t1 = self.arguments
        if self.by_intervals:
            (law,) = excitation_of(base).base
            # A `MassSpring` is the only system with an interval form.
            return IntervalEngine(cast(MassSpring, system), cast(PiecewiseConstantLaw, law), t1, y0)
        if isinstance(method, Exact):
            excitation, step = self.arguments.checked_step("law")
            self.arguments.check_length()
            # Generous: a sample that needs more steps has failed, or its events accumulate at one instant.
            most = np.int32(min(method.max_steps or 20 * steps_for(system, excitation, t1, step), _MOST_COUNTED))
            start = stacked(y0, jnp.result_type(float)) if len(y0) > MANY else y0
            return SwitchedEngine(system.ready(), excitation, t1, start, step, most, method.solver)
        excitation = excitation_of(base, "law")
        system.check_excitation(excitation)
        self.arguments.check_length()
        method = resolved(system, excitation, method, dtype)
        if method.step is None:
            if method.solver is not None:
                wanted = "leave the steps of many samples to the package, without a solver and an adjoint"
                raise checks.refused("method", wanted, type(method.solver), "simulate follows one sample by a solver")
            jumps = base_jumps(system, excitation, table_sizes(system, excitation, largest(t1)))
            longest, most = longest_step(system, excitation), np.int32(method.max_steps or MORE**2 * ADAPTIVE_STEPS)
            given = system.ready(), excitation, t1, y0, longest, most, method
            return AdaptiveEngine(*given, base_jumps=jumps)
        # Twice the expected number, for samples with many jumps. `fixed_steps` also rejects a step that is too long.
        expected = 2 * fixed_steps(system, excitation, method, t1)
        most = np.int32(min(method.max_steps or expected, _MOST_COUNTED))
        return FixedEngine(system.ready(), excitation, t1, y0, method.step, most, method)


def engine_for(arguments: Arguments) -> Choice:
    """The fastest engine for these arguments, whose base is a law or a realisation.

    The choice depends on their types and options, not on their numbers.
    """
    arguments = arguments._replace(base=merged(arguments.base, arguments.t1))
    system, base, method, _ = arguments
    if isinstance(method, Regularized):
        return Choice(arguments)
    if system.memory.laws:
        raise ValueError(
            "Argument method must be Regularized() for friction laws with an inner state, but Exact() was given: they "
            "have no exact stick. Their sticks are the times in which the relative velocity stays below a threshold."
        )
    is_steady = isinstance(base, PiecewiseConstantLaw)
    needs_steps = method.step is not None or method.solver is not None
    return Choice(arguments, by_intervals=is_steady and system.traits.has_interval_form and not needs_steps)


def lanes_for(
    system: System, law: BaseMotion, method: Exact | Regularized, t1: float, y0: tuple[Number, ...], dtype: DType
) -> Engine:
    """The engine that simulates samples of `law`, with its arguments checked."""
    if isinstance(law, PiecewiseConstantLaw):
        law.checked_capacity(t1)
    return engine_for(Arguments(system, law, method, t1)).lanes(y0, dtype)


def sample_engines(
    inputs: Inputs, method: Exact | Regularized, t1: Scalar, dtype: DType, first: int, number: int
) -> Engines:
    """The engines of samples ``first .. first + number - 1``, whose `inputs` differ."""

    def build(values: tuple[AnyArray, ...], base: BaseMotion | None) -> Engine:
        system, law, y0 = inputs.filled(values)
        arguments = Arguments(system, law if base is None else base, method, t1)
        return engine_for(arguments).lanes(with_memory(system, y0), dtype)

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
