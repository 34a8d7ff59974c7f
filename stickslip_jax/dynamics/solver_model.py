"""The mass and spring where slips have no closed form: each step is one step of a solver."""

from typing import ClassVar

import diffrax
import equinox as eqx

from .._types import FloatArray
from ..numerics.runge_kutta import runge_kutta_step
from .oscillator_model import OscillatorInputs, OscillatorModel
from .own import is_own
from .switched_model import State


class SolverOscillatorModel(OscillatorModel):
    """An `OscillatorModel` whose slips are integrated by `solver`: any friction law, any smooth force."""

    solver: diffrax.AbstractERK
    steps_may_be_long: ClassVar[bool] = False

    def slip(self, inputs: OscillatorInputs, y: State, h: FloatArray, sign: FloatArray) -> State:
        return self.slip_and_error(inputs, y, h, sign)[0]

    def slip_and_error(
        self, inputs: OscillatorInputs, y: State, h: FloatArray, sign: FloatArray
    ) -> tuple[State, FloatArray | None]:
        y1, error = runge_kutta_step(_Slip(self, inputs, sign), y, h, solver=self.solver)
        # Of the package's own functions all is known that the step depends on (`time_scales.py`).
        return y1, None if is_own(self) else error


class _Slip(eqx.Module):
    """The rates of a slip, a function of the time since the step began and of the state."""

    model: OscillatorModel
    inputs: OscillatorInputs
    sign: FloatArray

    def __call__(self, tau: FloatArray, state: State) -> State:
        return self.model.rates(self.inputs, tau, state, self.sign)
