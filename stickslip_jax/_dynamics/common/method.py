"""Simulation methods: `Exact` switched dynamics and `Regularized` dynamics, with their options."""

import difflib
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ... import _checks
from ... import _diffrax as diffrax
from ..._methods import Module
from ..._types import AnyArray, Scalar

SHAPES = ("tanh", "linear", "arctan", "rational")
"""The smooth switches of `Regularized`."""


def _as_max_steps(number: Any) -> int | None:
    return None if number is None else _checks.whole_number("max_steps", number)


class Exact(Module):
    """Exact switched dynamics. Without a step, closed forms over whole base intervals are used where they apply
    (constant velocities, no damping, no force, one friction coefficient), and time steps elsewhere.

    - `step`: the time step, s; events are located inside it. By default a fraction of the shortest time scale.
    - `max_steps`: the largest number of steps of one trajectory, rejected trial steps (about three per event) included.
      By default estimated, and doubled while too few. Needed under ``jit`` or ``grad`` when `t1` is traced.
    - `solver`: an explicit Runge-Kutta solver of diffrax for slips. By default slips follow closed forms where these
      exist; a `MassSpring` without them uses ``diffrax.Dopri8()``.

    Raises ValueError for a step that is not positive, a number of steps below 1, or another kind of solver.
    """

    step: Scalar | None = None
    max_steps: int | None = eqx.field(static=True, default=None, converter=_as_max_steps)
    solver: Any = None

    def __check_init__(self):
        if self.step is not None:
            _checks.positive("step", self.step, "s")
        if self.solver is not None and not isinstance(self.solver, diffrax.AbstractERK):
            raise ValueError(
                "Argument solver must be an explicit Runge-Kutta solver such as diffrax.Tsit5(), but "
                f"{_checks.show(self.solver)} was given."
            )


class Regularized(Module):
    """Regularised dynamics: the sign of the relative velocity ``v_rel`` in the friction force becomes a smooth switch.

    The mass then creeps where it would stick, and a stick is a time in which it creeps slowly. The exact method is
    faster and has no such errors: this one is for comparison with programs and papers that regularise, and for
    optimisers that need a smooth field. Errors and run times: ``docs/regularized.md``.

    - `width`: the relative velocity over which friction changes its sign, m/s, positive. For a `MotorCart`,
      ``eccentricity`` times angular velocity; for a `SwitchedSystem`, in the unit of its relative velocity. None for
      friction laws with an inner state such as `LuGre`, which are smooth by themselves: ``Regularized()``.
    - `shape`: "linear" (up to one width, then constant), "tanh", "rational" (``s/sqrt(1 + s^2)``) or "arctan"
      (``2/pi atan``), of ``s = v_rel / width``. "linear" is the most accurate and cheapest; the others are smooth.
    - `step`: a fixed step, s, linearly implicit and stable for any width: fast, for big batches. Of a `MotorCart`, a
      system of your own, and where a time scale is not known, shortened where its estimated error without friction
      exceeds 1e-4 of what the terms of the equations change in it, about what 45 steps in a period have; of all, where
      static friction above kinetic friction takes hold of the mass or lets it go. Without `step`, diffrax chooses the
      steps, at most a quarter of the shortest period of what drives the system, so that none passes over a pulse; the
      period of a signal of your own must be known then (`shortest_period`).
    - `solver`: diffrax solver for adaptive steps; by default ``Kvaerno3()``, which is implicit and works for any width.
      ``Tsit5()`` is explicit: cheaper while ``width`` is at least a hundredth of the system's velocities.
    - `rtol`, `atol`: tolerances of adaptive steps. `atol`: a number, or one for each state; by default `rtol` times
      the scale of each state. The instants of sticks are interpolated inside a step: where they matter, take an `rtol`
      far below the width over the system's velocities (for "linear", whose corners a long step misses, at most 1e-8).
    - `max_steps`: the largest number of steps of one trajectory, rejected ones included; by default 16384 adaptive
      steps, 8 and 64 times as many where these are too few (in ensembles 8 times; under ``jit``, where it is not known
      whether they are, 16384), or as many fixed steps as fit into ``t1``, twice as many where steps may be shortened.
      Needed with a fixed step under ``jit`` or ``grad`` where `t1` is traced.
    - `threshold`: a stick is a time in which ``|v_rel| <= threshold`` (m/s); by default the creep velocity at which a
      mass is released: one width where static friction exceeds kinetic friction, else that or a little more
      (`Switch.creep`). Of laws with an inner state, a thousandth of what friction changes of the velocity in the time
      of one radian; a gap in which the contact slips by less than their `elastic_slip` is no slip.
    - `minimum_duration`: shortest time below the threshold that counts as a stick, s; by default ten times the time in
      which friction stops a mass at the threshold (a mass that passes through takes less), at least two fixed steps. Of
      several contacts it may be an array (contacts,), as the threshold; all at once stick for the longest of them.
    - `adjoint`: how diffrax differentiates adaptive steps: ``RecursiveCheckpointAdjoint()`` by default, for reverse
      mode (``grad``); ``ForwardMode()`` for ``jvp`` and ``jacfwd``; ``DirectAdjoint()`` for both, slower. Fixed steps
      support both modes.

    The method of a result, ``one.method``, holds the numbers that were used. Raises ValueError for numbers that are
    not positive, an unknown shape, an unsuitable solver, and options that exclude each other.
    """

    width: Scalar | None = None
    shape: str = eqx.field(static=True, default="linear")
    step: Scalar | None = eqx.field(default=None, kw_only=True)
    solver: Any = eqx.field(static=True, default=None, kw_only=True)
    rtol: Scalar = eqx.field(default=1e-5, kw_only=True)
    atol: AnyArray | Scalar | None = eqx.field(default=None, kw_only=True)
    max_steps: int | None = eqx.field(static=True, default=None, kw_only=True, converter=_as_max_steps)
    threshold: AnyArray | Scalar | None = eqx.field(default=None, kw_only=True)
    minimum_duration: AnyArray | Scalar | None = eqx.field(default=None, kw_only=True)
    adjoint: Any = eqx.field(static=True, default=None, kw_only=True)

    def __check_init__(self):
        if self.width is not None:
            _checks.positive("width", self.width, "m/s")
        if not isinstance(self.shape, str) or self.shape not in SHAPES:
            near = difflib.get_close_matches(self.shape, SHAPES, 1, 0.4) if isinstance(self.shape, str) else []
            guess = f"; did you mean {near[0]!r}?" if near else "."
            raise ValueError(
                f"Argument shape must be one of {', '.join(map(repr, SHAPES))}, but {_checks.show(self.shape)} was "
                f"given{guess}"
            )
        if self.step is not None:
            _checks.positive("step", self.step, "s")
        for name, unit, bounds in (("threshold", "m/s", {"above": 0}), ("minimum_duration", "s", {"at_least": 0})):
            _check_of_contacts(name, getattr(self, name), unit, bounds)
        _checks.positive("rtol", self.rtol)
        if self.atol is not None:
            _checks.numeric("atol", self.atol, ndim=None)
            if not _checks.is_traced(self.atol) and np.any(np.asarray(self.atol) <= 0):
                raise ValueError(f"Argument atol must be positive, but {_checks.show(self.atol)} was given.")
        self._check_solver()

    def _check_solver(self):
        if self.step is not None and (self.solver is not None or self.adjoint is not None):
            raise ValueError(
                f"Arguments solver and adjoint must be None with a fixed step, but step = {_checks.show(self.step)} "
                "was given; leave the step out for adaptive steps."
            )
        if self.solver is not None and not isinstance(self.solver, diffrax.AbstractAdaptiveSolver):
            raise ValueError(
                "Argument solver must be a solver of diffrax with an error estimate, such as diffrax.Kvaerno3() or "
                f"diffrax.Tsit5(), but {_checks.show(self.solver)} was given."
            )
        if self.adjoint is not None and not isinstance(self.adjoint, diffrax.AbstractAdjoint):
            raise ValueError(
                "Argument adjoint must be one of diffrax's, such as diffrax.ForwardMode(), but "
                f"{_checks.show(self.adjoint)} was given."
            )


def _check_of_contacts(name: str, value: Any, unit: str, bounds: dict[str, Any]) -> None:
    """Check a number, or an array with one for each of several contacts; None is none. Raises ValueError otherwise."""
    if value is None:
        return
    is_array = isinstance(value, (np.ndarray, jax.Array)) and np.ndim(value) > 0
    _checks.bounded(name, value, unit, ndim=int(is_array), **bounds)
    if is_array and not np.size(value):
        raise _checks.refused(name, f"be a number (in {unit}), or one for each contact", value)


EXACT = Exact()
"""The exact method with all options at their defaults."""
