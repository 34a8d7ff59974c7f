"""The step-size control of adaptive steps, by diffrax."""

from functools import cache
from typing import Any

from ... import _diffrax as diffrax
from ..._types import Array


def step_control(rtol: Any, atol: Any, jumps: Array | None) -> Any:
    """Control by the tolerances, with steps that end at the instants `jumps` (s), if any."""
    controller: Any = diffrax.PIDController(rtol=rtol, atol=atol)
    if jumps is not None:
        controller = diffrax.ClipStepSizeController(controller, jump_ts=jumps)
    return _class()(controller)


@cache
def _class() -> Any:
    """The class of the control, made when diffrax is first needed."""

    class EveryStageControl(diffrax.AbstractAdaptiveStepSizeController):
        """A control after whose steps the solver computes the first stage of the next one anew.

        By itself it takes that stage from the step before, unless there was a jump in between, in any trajectory of the
        batch: the two differ in the last digits of implicit solvers, and each sample would depend on its neighbours.
        """

        controller: Any

        @property
        def rtol(self):
            return self.controller.rtol

        @property
        def atol(self):
            return self.controller.atol

        @property
        def norm(self):
            return self.controller.norm

        def wrap(self, direction):
            return type(self)(self.controller.wrap(direction))

        def init(self, *args):
            return self.controller.init(*args)

        def adapt_step_size(self, *args):
            keeps, t0, t1, _, state, result = self.controller.adapt_step_size(*args)
            return keeps, t0, t1, True, state, result

    return EveryStageControl
