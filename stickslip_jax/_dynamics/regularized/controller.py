"""The step-size control of adaptive steps, by diffrax."""

from functools import cache
from typing import Any

from ... import _diffrax as diffrax
from ..._types import Array, FloatArray


def step_control(rtol: Any, atol: Any, longest: FloatArray, jumps: Array | None, *, is_very_stiff: bool) -> Any:
    """Control by the tolerances, with steps of at most `longest` (s) that end at the instants `jumps` (s), if any.

    The first stage of a very stiff step, computed anew from the state, would be its round-off enlarged: without jumps
    no trajectory of a batch needs it.
    """
    control = diffrax.PIDController(rtol=rtol, atol=atol, dtmax=longest)
    return control if is_very_stiff and jumps is None else _class()(control, jump_ts=jumps)


@cache
def _class() -> Any:
    """The class of the control, made when diffrax is first needed."""
    clipped: Any = diffrax.ClipStepSizeController

    class EveryStageControl(clipped):
        """A control after whose steps the solver computes the first stage of the next one anew.

        By itself it takes that stage from the step before, unless there was a jump in between, in any trajectory of the
        batch: the two differ in the last digits of implicit solvers, and each sample would depend on its neighbours.
        """

        def adapt_step_size(self, *args: Any) -> Any:
            keeps, t0, t1, _, state, result = super().adapt_step_size(*args)
            return keeps, t0, t1, True, state, result

    return EveryStageControl
