"""Which model follows which system under which drive."""

from typing import Any

import diffrax
import jax
import numpy as np

from .. import _checks
from ..base_motion.drive import Drive
from ..base_motion.random import RandomPhase
from ..base_motion.recorded import Recorded
from ..base_motion.smooth import Harmonic, Signal, SumOfHarmonics
from ..base_motion.voltage import SourceVoltage
from ..systems.mass_spring import MassSpring
from ..systems.motor_cart import MotorCart
from ..systems.switched_system import SwitchedSystem
from .cart_model import CartModel
from .general_model import GeneralModel
from .method import Exact
from .oscillator_model import OscillatorModel, has_closed_form
from .solver_model import SolverOscillatorModel
from .switched_engine import Streams
from .switched_model import SwitchedModel

_RESONANCE = 1e-7  # relative distance of frequencies at which the steady answer to a force means nothing any more


def model_of(system: Any, smooth: Signal | None, solver: Any) -> SwitchedModel:
    """The model of `system` under a realised smooth drive."""
    if isinstance(system, MotorCart):
        assert isinstance(smooth, SourceVoltage)
        return CartModel(system, smooth)
    if isinstance(system, SwitchedSystem):
        return GeneralModel(system, smooth, diffrax.Dopri8() if solver is None else solver)
    if solver is None and has_closed_form(system):
        return OscillatorModel(system, smooth)
    return SolverOscillatorModel(system, smooth, diffrax.Dopri8() if solver is None else solver)


def streams_of(system: Any, drive: Drive) -> Streams:
    """The parts of drive and force that come in pieces."""
    force = system.force if isinstance(system, MassSpring) else None
    return Streams(drive.base, drive.ground, (force,) if isinstance(force, Recorded) else ())


def check_drive(system: Any, drive: Drive, method: Any) -> None:
    """Check that `drive` can drive `system`, by `method`. Raises ValueError otherwise."""
    voltage = drive.smooth.signal if isinstance(drive.smooth, RandomPhase) else drive.smooth
    if isinstance(system, MotorCart):
        if not isinstance(voltage, SourceVoltage) or drive.base or drive.ground:
            raise ValueError(
                "Argument base of a MotorCart must be a SourceVoltage, or RandomPhase(SourceVoltage(...)), but another "
                "motion was given."
            )
        if isinstance(method, Exact) and method.solver is not None:
            raise ValueError("Argument solver must be None for a MotorCart, which has an integrator of its own.")
        return
    if isinstance(voltage, SourceVoltage):
        raise ValueError(
            f"Argument base of a {type(system).__name__} must be a base motion, but a SourceVoltage was given."
        )
    if isinstance(system, SwitchedSystem):
        if drive.ground:
            raise ValueError(
                f"Argument base of a {type(system).__name__} must be a base velocity, but a ground acceleration was "
                "given; write what the acceleration of the ground does into rates, as a function of time."
            )
        return
    if isinstance(method, Exact) and method.solver is None:
        _check_resonance(system)


def _check_resonance(system: MassSpring) -> None:
    """Without damping, the closed form knows no steady answer to a force at the natural frequency."""
    force = system.force
    if not isinstance(force, (Harmonic, SumOfHarmonics)) or system.damping is not None:
        return
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves(system)):
        return
    omega = (float(system.stiffness) / float(system.mass)) ** 0.5
    frequencies = force.angular_frequency if isinstance(force, Harmonic) else force.angular_frequencies
    for w in np.atleast_1d(np.asarray(frequencies)):
        if abs(w - omega) < _RESONANCE * omega:
            raise ValueError(
                f"Argument force must not have the natural angular frequency of {omega:.6g} rad/s where there is no "
                f"damping, but {w:.9g} rad/s was given; use method=Exact(solver=diffrax.Dopri8()), which needs no "
                "closed form."
            )
