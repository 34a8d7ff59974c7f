"""One period of a system and of what drives it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._dynamics.common.method import Exact
from .._dynamics.common.path import Run
from .._dynamics.common.segments import SegmentLaws
from .._dynamics.common.validation import Arguments
from .._dynamics.engine_choice import BySteps, engine_for
from .._dynamics.switched.run import lane_at_start, steps_for
from .._excitation.excitation import BaseMotion, excitation_of
from .._numerics.known import NotKnown
from .._simulation.call import simulate
from .._simulation.result import Simulation
from .._status import Status
from .._systems.system import System
from .._types import FloatArray, Number, Scalar


class Cycle(eqx.Module):
    """A system and what drives it, for one `duration` (s), after which the drive repeats itself.

    Of many cases, arrays have a first axis (cases,).
    """

    system: System
    base: BaseMotion
    duration: Number
    method: Exact

    def after(self, y: FloatArray) -> Simulation:
        """The motion of one case over one period from the state `y`, (coordinates,)."""
        return simulate(self.system, self.base, t1=self.duration, y0=tuple(y), method=self.method)

    def end(self, y: FloatArray) -> FloatArray:
        """The state after one period, (coordinates,); NaN where that is no time or the motion does not reach it."""
        after = self.after(y)
        is_known = (after.status == int(Status.FINISHED)) & (self.duration > 0)
        return jnp.where(is_known, jnp.stack(after.final_state), jnp.nan)

    def change(self, y: FloatArray) -> FloatArray:
        """How far the state is from `y` after one period, without whole turns of angles, (coordinates,)."""
        return without_turns(self.system, self.end(y) - y)

    def by_steps(self, y: FloatArray) -> Run:
        """The same motion in time steps, also where it is known over whole intervals of the base."""
        return BySteps(Arguments(self.system, self.base, self.method, self.duration)).follow(tuple(y), y.dtype)[1]

    def lasting(self, duration: Scalar) -> "Cycle":
        """The same with another duration (s)."""
        return Cycle(self.system, self.base, duration, self.method)

    def rates(self, y: FloatArray) -> FloatArray:
        """The rates of the state at the begin of the period, per second."""
        step = Arguments(self.system, self.base, self.method, self.duration).checked_step()[1]
        zero, excitation = jnp.zeros((), y.dtype), excitation_of(self.base)
        lane = lane_at_start(
            self.system, excitation, jnp.zeros(2, jnp.uint32), tuple(y), step + zero, self.method.solver, ()
        )
        model = self.system.switched_model(excitation.signal, self.method.solver)
        forcing = model.forcing(zero, SegmentLaws.of(self.system, excitation).segments(lane.segment_states))
        return jnp.stack(model.numbers(model.rates(forcing, zero, lane.y, lane.sign)))


def without_turns(system: System, change: FloatArray) -> FloatArray:
    """A change of the state without the whole turns of its angles, (coordinates,)."""
    periods = [coordinate.period or np.inf for coordinate in system.coordinates]
    if not np.any(np.isfinite(periods)):
        return change
    turn = jnp.asarray(np.where(np.isfinite(periods), periods, 0), change.dtype)
    return change - turn * lax.stop_gradient(jnp.round(change / jnp.where(turn > 0, turn, jnp.inf)))


def steps_in(
    system: System, base: BaseMotion, method: Exact, duration: Scalar, *, by_steps: bool = False
) -> int | None:
    """How many time steps `duration` (s) needs; None where `method` says it, no steps are taken, or it is not known.

    `by_steps`: time steps also where the motion is known over whole intervals of the base.
    """
    arguments = Arguments(system, base, method, duration)
    if method.max_steps is not None or not (by_steps or isinstance(engine_for(arguments), BySteps)):
        return None
    try:
        excitation, step = arguments.checked_step()
        return steps_for(system, excitation, duration, step, "period")
    except NotKnown:
        return None
