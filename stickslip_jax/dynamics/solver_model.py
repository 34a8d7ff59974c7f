"""The mass and spring where slips have no closed form: each step is one step of a solver."""

import diffrax

from .._types import FloatArray
from ..numerics.runge_kutta import runge_kutta_step
from .oscillator_model import OscillatorInputs, OscillatorModel
from .switched_engine import State


class SolverOscillatorModel(OscillatorModel):
    """An `OscillatorModel` whose slips are integrated by `solver`: any friction law, any smooth force."""

    solver: diffrax.AbstractERK

    def slip(self, inputs: OscillatorInputs, y: State, h: FloatArray, sign: FloatArray) -> State:
        return runge_kutta_step(self.solver, lambda tau, state: self.rates(inputs, tau, state, sign), y, h)
