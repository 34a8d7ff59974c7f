"""Simulation methods, `Exact` and `Regularized`; the time steps that follow from a system and its excitation; and
the checks of what is simulated by them.
"""

import difflib
import math
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._compiler.programs import is_compiling
from ..._excitation.excitation import BaseMotion, Excitation, excitation_of, motion_of, realisation_of
from ..._excitation.motion import SEEN_IN_STEPS
from ..._foundation import checks
from ..._foundation import lazy_diffrax as diffrax
from ..._foundation.fields import Module
from ..._foundation.types import AnyArray, FloatArray, InitialState, Number, Scalar, Solver
from ..._numerics.derivatives import NotKnown, largest, primal_of, smallest
from ..._numerics.elementary import angle_of
from ..._systems.friction import FrictionLaw
from ..._systems.system import SHORTEST_TIME, StepCount, System, TimeScales, require_system
from ..._uncertainty.inputs import varying
from ..._uncertainty.numbers import shown
from .path import padded_length

# Simulation methods: `Exact` switched dynamics and `Regularized` dynamics, with their options.


SHAPES = ("tanh", "linear", "arctan", "rational")
"""The smooth switches of `Regularized`, in place of the sign of the relative velocity."""


SMOOTH: dict[str, Callable[[FloatArray], Array]] = {
    "tanh": jnp.tanh,
    "linear": lambda s: jnp.clip(s, -1, 1),
    "arctan": lambda s: (2 / math.pi) * jnp.where(s < 0, -1, 1) * angle_of(jnp.abs(s), jnp.ones_like(s)),
    "rational": lambda s: s / jnp.sqrt(1 + s * s),
}
"""The switch of each name in `SHAPES`."""


class Switch(eqx.Module):
    """Smooth switch ``phi(v_rel / width)`` in place of ``sgn(v_rel)``; `width` in m/s, `shape` one of `SMOOTH`."""

    width: Scalar
    shape: str = eqx.field(static=True)

    def __call__(self, ratio: FloatArray) -> FloatArray:
        """``phi(ratio)``, the smooth sign; `ratio`: relative velocity over width."""
        return SMOOTH[self.shape](ratio)

    def coefficient(self, friction: FrictionLaw, velocity: FloatArray) -> FloatArray:
        """The signed friction coefficient at the relative `velocity` (m/s), ``kinetic(|v_rel|) phi(v_rel / width)``.

        Where ``static`` exceeds ``kinetic``, friction holds up to one width: it rises from 0 to exactly ``static``
        there, the largest value, and falls off to ``kinetic`` within a few widths more. The long tails of the smooth
        shapes are left out: on them a mass would creep faster than at one width, and not stick.
        """
        static = friction.stick_limit(velocity) if friction.static_exceeds_kinetic else None
        return self.friction(velocity, friction.slip_coefficient(velocity), static)

    def friction(
        self, velocity: FloatArray, kinetic: Scalar | FloatArray, static: Scalar | FloatArray | None
    ) -> FloatArray:
        """The signed friction, a coefficient or a force, from that of a slip at this relative `velocity` (m/s).

        `static`: the largest one, where it exceeds the `kinetic` one, else None. See `coefficient`.
        """
        ratio = velocity / self.width
        if static is None:
            return kinetic * self(ratio)
        part, beyond = jnp.clip(ratio, -1, 1), jnp.maximum(jnp.abs(ratio) - 1, 0)
        # Concave on the rise, so that a step can find the balance of forces from below (`balance`).
        if self.shape == "linear":
            # A corner: from a smooth summit a mass would part as slowly as ``width^(2/3)``.
            held, left = static * part, jnp.exp(-beyond)
        else:
            held, left = static * part * (3 - part * part) / 2, jnp.exp(-beyond * beyond)
        slides = kinetic * part
        return jnp.where(jnp.abs(ratio) < 1, held, slides + (held - slides) * left)

    def creep(self, speed: Scalar | FloatArray) -> Scalar | FloatArray:
        """The approximate relative velocity (m/s) of a mass at its release from a stick.

        Before its release the mass creeps: friction balances the growing force at ``phi = force / largest``. The
        release is where the creep can no longer follow this balance: where the gap ``1 - phi`` equals the time, in
        units of ``speed / deceleration``, in which the excess force brings the mass to the speed of creep. This gives
        the powers of the width below (`speed`: the system's velocity scale, m/s; deceleration: that by friction). The
        factors are fitted: with them exits are neither early nor late on average in the Poisson-switching system of
        Lima and Sampaio, at widths of 1/50, 1/500 and 1/5000 of `speed`.
        """
        parts = jnp.maximum(speed / self.width, 1)
        widths = {
            "linear": jnp.ones_like(parts),
            "tanh": 0.45 + jnp.log(parts) / 4,
            "rational": 0.82 * parts**0.2,
            "arctan": 0.78 * parts ** (1 / 3),
        }
        return self.width * widths[self.shape]


def _as_max_steps(number: Any) -> int | None:
    return None if number is None else checks.whole_number("max_steps", number)


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
            checks.positive("step", self.step, "s")
        if self.solver is not None and not isinstance(self.solver, diffrax.AbstractERK):
            raise checks.refused("solver", "be an explicit Runge-Kutta solver such as diffrax.Tsit5()", self.solver)


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
      static friction above kinetic friction takes hold of the mass or lets it go. Without `step`, steps follow the
      tolerances, at most a quarter of the shortest period of what drives the system, so that none passes over a pulse;
      the period of a signal of your own must be known then (`shortest_period`). They are linearly implicit and of fifth
      order (Rodas5P, Steinebach 2023, BIT Numer. Math. 63, 27), and end where friction has a kink: each step is smooth.
    - `rtol`, `atol`: tolerances of adaptive steps. `atol`: a number, or one for each state; by default `rtol` times
      the scale of each state. The relative velocity of a contact is known to `rtol` of itself too, or of the threshold
      of sticks where it is slower, so that beginnings and ends of sticks are as exact as the rest.
    - `solver`: a solver of diffrax that chooses the steps of one trajectory instead, for comparison: ``Kvaerno3()``,
      say, which is implicit and works for any width, or ``Tsit5()``, which is explicit. The instants of sticks are then
      interpolated in steps that do not end at kinks: where they matter, take an `rtol` far below the width over the
      system's velocities. Not for many samples.
    - `max_steps`: the largest number of steps of one trajectory, rejected ones included; by default 16384 adaptive
      steps, 8 and 64 times as many where these are too few (in ensembles 64 times as many; under ``jit``, where it is
      not known whether they are, 16384), or as many fixed steps as fit into ``t1``, twice as many where steps may be
      shortened. Needed with a fixed step under ``jit`` or ``grad`` where `t1` is traced.
    - `threshold`: a stick is a time in which ``|v_rel| <= threshold`` (m/s); by default the creep velocity at which a
      mass is released: one width where static friction exceeds kinetic friction, else that or a little more
      (`Switch.creep`). Of laws with an inner state, a thousandth of what friction changes of the velocity in the time
      of one radian; a gap in which the contact slips by less than their `elastic_slip` is no slip.
    - `minimum_duration`: shortest time below the threshold that counts as a stick, s; by default ten times the time in
      which friction stops a mass at the threshold (a mass that passes through takes less), at least two fixed steps. Of
      several contacts it may be an array (contacts,), as the threshold; all at once stick for the longest of them.
    - `adjoint`: how diffrax differentiates the steps of its solver (``Kvaerno3()`` if none is given):
      ``RecursiveCheckpointAdjoint()`` by default, for reverse mode (``grad``); ``ForwardMode()`` for ``jvp`` and
      ``jacfwd``; ``DirectAdjoint()`` for both, slower. All other steps support both modes.

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
            checks.positive("width", self.width, "m/s")
        if not isinstance(self.shape, str) or self.shape not in SHAPES:
            near = difflib.get_close_matches(self.shape, SHAPES, 1, 0.4) if isinstance(self.shape, str) else []
            guess = f"did you mean {near[0]!r}?" if near else ""
            raise checks.refused("shape", f"be one of {', '.join(map(repr, SHAPES))}", self.shape, guess)
        if self.step is not None:
            checks.positive("step", self.step, "s")
        bounds: dict[str, Any]
        for name, unit, bounds in (("threshold", "m/s", {"above": 0}), ("minimum_duration", "s", {"at_least": 0})):
            value: Any = getattr(self, name)
            if value is None:
                continue
            # A number, or an array with one for each of several contacts.
            is_array = isinstance(value, (np.ndarray, jax.Array)) and np.ndim(value) > 0
            checks.bounded(name, value, unit, ndim=int(is_array), **bounds)
            if is_array and not np.size(value):
                raise checks.refused(name, f"be a number (in {unit}), or one for each contact", value)
        checks.positive("rtol", self.rtol)
        if self.atol is not None:
            checks.numeric("atol", self.atol, ndim=None)
            if not checks.is_traced(self.atol) and np.any(np.asarray(self.atol) <= 0):
                raise checks.refused("atol", "be positive", self.atol)
        if self.step is not None and (self.solver is not None or self.adjoint is not None):
            raise ValueError(
                f"Arguments solver and adjoint must be None with a fixed step, but step = {checks.show(self.step)} "
                "was given; leave the step out for adaptive steps."
            )
        if self.solver is not None and not isinstance(self.solver, diffrax.AbstractAdaptiveSolver):
            kind = "a solver of diffrax with an error estimate, such as diffrax.Kvaerno3() or diffrax.Tsit5()"
            raise checks.refused("solver", f"be {kind}", self.solver)
        if self.adjoint is not None and not isinstance(self.adjoint, diffrax.AbstractAdjoint):
            raise checks.refused("adjoint", "be one of diffrax's, such as diffrax.ForwardMode()", self.adjoint)


EXACT = Exact()
"""The exact method with all options at their defaults."""


# Choice and check of the time step, from the time scales of a system and of its excitation.


_USUAL = StepCount(1.0, 1.0)
_ACCURATE = 6  # times as many steps as a time scale needs at least: fixed steps are then hardly ever shortened


def time_scales_of(system: System, excitation: Excitation, solver: Solver | None = None) -> TimeScales:
    """The time scales of a system; those that follow from no traced number are plain numbers. So a function under
    ``jax.jit`` that encloses a system knows how many steps there are.
    """
    if not is_compiling():
        return system.time_scales(excitation, solver)

    def plain(time: Any) -> Any:
        return float(time) if isinstance(time, jax.Array) and not checks.is_traced(time) and not time.ndim else time

    with jax.ensure_compile_time_eval():
        return jax.tree.map(plain, system.time_scales(excitation, solver))


def step_for(system: System, excitation: Excitation, method: Exact | Regularized) -> Scalar:
    """The time step (s) of `method`, checked; by default a fraction of the shortest time scale.

    Raises ValueError for a step that is too long for a time scale, and where `method` gives none although a time scale
    is not known.
    """
    found = time_scales_of(system, excitation, method.solver)
    scales = {name: (primal_of(of.time), of.steps) for name, of in found.scales.items()}
    if isinstance(method, Regularized):  # whose fixed steps are not shortened where the motion is fast
        scales["time scale of the fastest motion"] = primal_of(found.usual_step), _USUAL
    known = {name: (time, steps) for name, (time, steps) in scales.items() if time is not None}
    unknown = [name for name in scales if name not in known]
    if method.step is None and unknown:
        raise ValueError(
            f"Argument method must give the step, Exact(step=...), but the {unknown[0]} is not known; or give what "
            f"you wrote a property {_property_of(unknown[0])} (s)."
        )
    if method.step is None:
        return _shortest([time / count.default for time, count in known.values()])
    step = primal_of(method.step)
    limits = [time / count.least for time, count in known.values() if checks.is_traced(time)]
    if limits:  # numbers that are not known before the call: steps that are too long cannot be refused, so shorten them
        step = jnp.min(jnp.stack([jnp.asarray(limit, float) for limit in (step, *limits)]))
    for name, (time, count) in known.items():
        with suppress(NotKnown):
            shortest, given = smallest(time), largest(step)
            longest, share = shortest / count.least, 1 / count.least
            if given > longest * (1 + 1e-9):
                raise ValueError(
                    f"Argument step must be at most {longest:.4g} s, {share:.2g} times the {name} of {shortest:.4g} "
                    f"s, but {given} was given; between longer steps sticks could be missed."
                )
    return step


def longest_step(system: System, excitation: Excitation) -> Scalar:
    """The longest adaptive step (s): one that no change of what drives the system can be hidden in; infinity if any.

    Steps end at the points of records and at jumps in any case. Raises ValueError where a shortest period is not known.
    """
    times = {name: primal_of(time) for name, time in time_scales_of(system, excitation).driving.items()}
    unknown = [name for name, time in times.items() if time is None]
    if unknown:
        fixed = "" if system.memory.laws else ", or choose a fixed step, Regularized(width, step=...)"
        raise ValueError(
            f"Argument method must not leave the steps to the motion while the {unknown[0]} is not known, for they "
            f"could pass over a short pulse: give what you wrote a property {_property_of(unknown[0])} (s){fixed}."
        )
    return _shortest([time / SEEN_IN_STEPS for time in times.values() if time is not None])


def _property_of(name: str) -> str:
    return "shortest_time" if name == SHORTEST_TIME else "shortest_period"


def _shortest(times: list[Any]) -> Scalar:
    if any(checks.is_traced(time) for time in times):
        return jnp.min(jnp.stack([jnp.asarray(time, float) for time in times]))
    return min(map(float, times))


def accurate_step(system: System, excitation: Excitation, step: float) -> float:
    """The fixed `step` (s), or if shorter that to which the time scales that are known let it be shortened."""
    scales = time_scales_of(system, excitation).scales.values()
    longest = _known([of.time / of.steps.least for of in scales if of.time is not None])
    return min([step, *(time / _ACCURATE for time in longest)])


def max_steps_advice(system: System, excitation: Excitation, method: Exact | Regularized, t1: Scalar) -> str:
    """A message that proposes `max_steps` where JAX traces `t1` or a time scale, from the numbers that are known."""
    horizon = min(_known([t1]), default=100.0)
    scales = time_scales_of(system, excitation, method.solver).scales.values()
    lengths = [of.time / of.steps.default for of in scales if of.time is not None]
    if method.step is not None:
        lengths = [method.step]
    found = _known(lengths)
    step = min((step for step in found if step < math.inf), default=0.01) / (1 if len(found) == len(lengths) else 4)
    steps = padded_length(math.ceil(1.5 * horizon / step) + 96)
    return f"max_steps={steps} is room for {horizon:g} s in steps of {step:.3g} s; too many cost nothing but memory"


def _known(numbers: list[Any]) -> list[float]:
    """The smallest value of each number whose value is known (not traced)."""
    found = []
    for number in numbers:
        with suppress(NotKnown):
            found.append(smallest(number))
    return found


def slowest_time(system: System, base: BaseMotion) -> float:
    """The slowest known time scale of a system, s; 1 where none is known."""
    scales = time_scales_of(system, excitation_of(base)).scales.values()
    return max((float(scale.time) for scale in scales if scale.time is not None and scale.time < math.inf), default=1.0)


# Checks of the arguments of `simulate` and `simulate_ensemble`.


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
        checks.positive("t1", t1, "s")
        start, motion = state_of(system, y0), realisation_of(base)
        arguments = cls(system, motion, method, t1)
        arguments.check_length()
        return arguments._replace(base=motion.realized_until(t1)), start

    def check_length(self) -> None:
        """Check that recorded motions and forces last until `t1`. Raises ValueError otherwise."""
        if checks.is_traced(self.t1):
            return
        motions = [("base", motion_of(self.base))]
        for load in self.system.recorded.loads:  # by the name of its field; "force" where it stands within another one
            held = (field.name for field in fields(self.system) if getattr(self.system, field.name) is load)
            motions.append((next(held, "force"), load))
        motions += [("normal_force", load) for load in self.system.recorded.normal_forces]
        for name, motion in motions:
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
        if checks.is_traced(step) or checks.is_traced(horizon):
            return excitation, jnp.minimum(step, horizon)
        return excitation, min(float(step), float(horizon))


def check_method(method: object) -> None:
    """Check that `method` is an `Exact` or a `Regularized`. Raises ValueError otherwise."""
    if not isinstance(method, (Exact, Regularized)):
        raise checks.refused("method", "be Exact(...) or Regularized(width)", method)


def entries_of(system: System, y0: InitialState | None) -> tuple[Any, ...]:
    """What the initial state `y0` of `system` holds for each coordinate, zeros if `y0` is None.

    Ages of sticks and inner states of friction laws may be left out.
    """
    meaning = tuple(coordinate.meaning for coordinate in system.coordinates)
    moving = len(meaning) - len(system.memory.start)
    given = (0.0,) * moving if y0 is None else y0
    is_listed = isinstance(given, (tuple, list)) or checks.dimensions(given) == 1
    is_short = is_listed and len(given) == moving  # pyright: ignore[reportArgumentType] - it has a length then
    return with_memory(system, checks.entries("y0", given, meaning[:moving] if is_short else meaning))


def with_memory(system: System, y0: Any) -> tuple[Number, ...]:
    """The initial state `y0`, with the ages and inner states that it leaves out."""
    memory = system.memory.start
    return (*y0, *memory) if memory and len(y0) == len(system.coordinates) - len(memory) else tuple(y0)


def state_of(system: System, y0: InitialState | None) -> tuple[Number, ...]:
    """The initial state `y0` of `system`, checked; zeros if `y0` is None, and for what it may leave out."""
    entries = entries_of(system, y0)
    check_fixed(y0=entries)
    numbers = checks.state("y0", entries, tuple(coordinate.meaning for coordinate in system.coordinates))
    system.check_code(numbers)
    return numbers


def check_fixed(**arguments: object) -> None:
    """Check that no argument holds a distribution, or an array where a number belongs. Raises ValueError otherwise."""
    for name, value in arguments.items():
        checks.tree(name, value)
        for path, source, _ in varying(value, (name,)):
            hint = "simulate_ensemble takes distributions, and arrays with one number for each sample"
            raise checks.refused(shown(path), "be one number here", source, hint)


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
