"""How to simulate: the exact method and its options."""

from typing import Any

import diffrax
import equinox as eqx

from .. import _checks
from .._types import Scalar


class Exact(eqx.Module):
    """Exact switched dynamics. Without a step, closed forms over whole base intervals are used where they apply
    (constant velocities, no damping, no force, one friction coefficient), and time steps elsewhere.

    - `step`: the time step, s; switches are located inside it. By default a fraction of the shortest time scale.
    - `max_steps`: how many steps (and tries of steps, about three for every event) one trajectory may take. By default
      enough, and more when they do not suffice. Needed under ``jit`` or ``grad`` when `t1` is traced.
    - `solver`: an explicit Runge-Kutta solver of diffrax for slips; by default closed forms where there are any, and
      ``diffrax.Dopri8()`` for a mass and spring without.

    Raises ValueError for a step that is not positive, a number of steps below 1, or another kind of solver.
    """

    step: Scalar | None = None
    max_steps: int | None = eqx.field(static=True, default=None)
    solver: Any = None

    def __check_init__(self):
        if self.step is not None:
            _checks.positive("step", self.step, "s")
        if self.max_steps is not None:
            _checks.whole_number("max_steps", self.max_steps)
        if self.solver is not None and not isinstance(self.solver, diffrax.AbstractERK):
            raise ValueError(
                "Argument solver must be an explicit Runge-Kutta solver such as diffrax.Tsit5(), but "
                f"{_checks.show(self.solver)} was given."
            )


EXACT = Exact()
"""The exact method with nothing chosen by hand."""
