"""Checks of the arguments of `simulate` and `simulate_ensemble`."""

import warnings
from dataclasses import fields
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ... import _checks
from ..._excitation.excitation import BaseMotion, Excitation, excitation_of, motion_of
from ..._excitation.segments import SegmentLaw
from ..._numerics.known import primal_of
from ..._systems.system import System, require_system
from ..._types import AnyArray, InitialState, Number, Scalar
from ..._uncertainty.inputs import varying
from ..._uncertainty.numbers import shown
from .method import Exact, Regularized
from .time_scales import step_for


class Arguments(NamedTuple):
    """What is simulated: a system on a base motion (a law or a realisation), by a method, up to `t1` (s)."""

    system: System
    base: BaseMotion
    method: Exact | Regularized
    t1: Scalar

    @classmethod
    def of_one(
        cls, system: System, base: BaseMotion, method: Exact | Regularized, t1: Scalar, y0: InitialState | None
    ) -> tuple["Arguments", tuple[Number, ...]]:
        """The checked arguments of `simulate`, the base as a motion without randomness, and the initial state.

        Raises:
            ValueError: For what `simulate` does not take.
        """
        check_fixed(system=system, base=base)
        require_system(system)
        check_method(method)
        _checks.positive("t1", t1, "s")
        start, motion = state_of(system, y0), motion_of(base)
        if motion.is_random:
            raise ValueError(
                f"Argument base must be a realisation, but the random law {type(base).__name__} was given; "
                "draw one with base.sample(key, t1)."
            )
        arguments = cls(system, motion, method, t1)
        arguments.check_length()
        return arguments._replace(base=motion.realized_until(t1)), start

    def check_length(self) -> None:
        """Check that recorded motions and forces last until `t1`. Raises ValueError otherwise."""
        if _checks.is_traced(self.t1):
            return
        loads = [(_field_of(self.system, load, "force"), load) for load in self.system.recorded_loads]
        loads += [("normal_force", load) for load in self.system.recorded_normal_forces]
        for name, motion in (("base", motion_of(self.base)), *loads):
            if motion.covered_time < float(self.t1) * (1 - 1e-12):
                raise ValueError(
                    f"Argument {name} must last until t1 = {float(self.t1):g} s, but it ends at "
                    f"{motion.covered_time:g} s; record more of it or choose a smaller t1."
                )

    def checked_step(self, name: str = "base") -> tuple[Excitation, Scalar]:
        """The `Excitation` made from `base` (the argument called `name`), and the time step (s), at most `t1`.

        Raises:
            ValueError: For a base, solver or step that does not suit the system.
        """
        excitation = excitation_of(self.base, name)
        self.system.check_excitation(excitation)
        self.system.check_solver(self.method.solver)
        step, horizon = step_for(self.system, excitation, self.method), primal_of(self.t1)
        if _checks.is_traced(step) or _checks.is_traced(horizon):
            return excitation, jnp.minimum(step, horizon)
        return excitation, min(float(step), float(horizon))


def _field_of(system: System, load: SegmentLaw, other: str) -> str:
    """The name of the field of `system` that holds this `load`; `other` where it stands within another field."""
    return next((field.name for field in fields(system) if getattr(system, field.name) is load), other)


def check_method(method: object) -> None:
    """Check that `method` is an `Exact` or a `Regularized`. Raises ValueError otherwise."""
    if not isinstance(method, (Exact, Regularized)):
        raise ValueError(
            f"Argument method must be Exact(...) or Regularized(width), but {_checks.show(method)} was given."
        )


def entries_of(system: System, y0: InitialState | None) -> tuple[Any, ...]:
    """What the initial state `y0` of `system` holds for each coordinate, zeros if `y0` is None.

    Ages of sticks and inner states of friction laws may be left out.
    """
    meaning = tuple(coordinate.meaning for coordinate in system.coordinates)
    moving = len(meaning) - len(system.start_of_memory)
    given = (0.0,) * moving if y0 is None else y0
    is_listed = isinstance(given, (tuple, list)) or _checks.dimensions(given) == 1
    is_short = is_listed and len(given) == moving  # pyright: ignore[reportArgumentType] - it has a length then
    return system.with_memory(_checks.entries("y0", given, meaning[:moving] if is_short else meaning))


def state_of(system: System, y0: InitialState | None) -> tuple[Number, ...]:
    """The initial state `y0` of `system`, checked; zeros if `y0` is None, and for what it may leave out."""
    entries = entries_of(system, y0)
    check_fixed(y0=entries)
    numbers = _checks.state("y0", entries, tuple(coordinate.meaning for coordinate in system.coordinates))
    system.check_state(numbers)
    return numbers


def check_fixed(**arguments: object) -> None:
    """Check that no argument holds a distribution, or an array where a number belongs. Raises ValueError otherwise."""
    for name, value in arguments.items():
        _checks.tree(name, value)
        for path, source, _ in varying(value, (name,)):
            raise ValueError(
                f"Argument {shown(path)} must be one number here, but {_checks.show(source)} was given; "
                "simulate_ensemble takes distributions, and arrays with one number for each sample."
            )


def working_dtype(*arrays: AnyArray, stacklevel: int = 3) -> np.dtype:
    """The floating dtype of a simulation; in float32, warns and says how to get float64."""
    dtype = jnp.result_type(float, *arrays)
    if not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "stickslip_jax runs in float32: event times are good to about 2e-6 of t1. For float64 call "
            'jax.config.update("jax_enable_x64", True) before anything else.',
            stacklevel=stacklevel,
        )
    return dtype
