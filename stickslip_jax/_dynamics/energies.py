"""Friction forces and energies along one trajectory."""

from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compiler.native import sharing
from .._compiler.programs import kept_jit
from .._foundation.types import AnyArray, Ending, FloatArray, FloatScalar, Scalar, State
from .._systems.memory_models import InnerStates
from .._systems.switched_model import Powers, Terms
from .common.method import Exact, Regularized, Switch
from .common.path import MotionPath
from .sticks import Sticks
from .switched.engine import StepPath
from .switched.inside import StepBeginnings, halves_for, state_in_step

# Friction force and energies along one trajectory.


Times: TypeAlias = Float[Array, " times"]


class Energies(NamedTuple):
    """Energies along a trajectory, J: dicts of arrays with the shape of the times, by name.

    Attributes:
        stored: Kinetic and elastic energy (of a `MotorCart` kinetic and magnetic), at each time.
        supplied: From the start to each time, by the base (the friction force times the base velocity; negative where
            the mass drives the base) and by the load (external force and ground acceleration), of a `MotorCart` by the
            voltage.
        dissipated: From the start to each time, by friction (only in slips) and by damping, of a `MotorCart` also in
            the resistance.
        imbalance: What was stored at the start and supplied, less what is stored and was dissipated: round-off, and
            for a trajectory without a closed form the error of its steps.
    """

    stored: dict[str, Float[Array, "*times"]]
    supplied: dict[str, Float[Array, "*times"]]
    dissipated: dict[str, Float[Array, "*times"]]
    imbalance: Float[Array, "*times"]


_Rule: TypeAlias = tuple[Float[AnyArray, " nodes"], Float[AnyArray, " nodes"]]
"""Nodes and weights of Gauss's rule on [0, 1], the unit of which is a time step."""


def rule_for(decay: Scalar, longest: Scalar) -> _Rule:
    """The rule for steps of at most `longest` (s), at whose beginning a motion may die out at the rate `decay`.

    No step is longer than a tenth of the shortest period, so that powers are smooth in it, unless damping is so strong
    that a motion dies out within the step. Then the step is cut into parts, each half as long as the next.
    """
    halves = halves_for(decay, longest)
    nodes, weights = np.polynomial.legendre.leggauss(8 if halves == 0 else 16)
    bounds = np.concatenate([[0.0], 0.5 ** np.arange(halves, -1, -1)])
    parts = np.diff(bounds)[:, None]
    return (bounds[:-1, None] + parts * (nodes + 1) / 2).reshape(-1), (parts * weights / 2).reshape(-1)


def _sum(terms: Terms) -> FloatScalar:
    return jnp.stack(list(terms.values())).sum(axis=0)


@kept_jit
def forces(
    model: Any,  # a OneContactModel, one of several places, or one with inner states
    path: MotionPath,
    method: Exact | Regularized,
    sticks: Sticks,
    last: FloatScalar,
    times: Times,
) -> tuple[Times, Times]:
    """The friction force, and the relative velocity that it opposes."""

    def at(time: FloatScalar) -> tuple[FloatScalar, FloatScalar]:
        y, forcing = path.state(time), model.forcing(time, path.segments(time))
        now, known = jnp.zeros((), bool), cast(Any, model)
        if isinstance(model, InnerStates):
            y = model.start(y, time.dtype)
            coefficient = model.coefficients(forcing, jnp.zeros_like(time), y)
            known, y = model.inner, y[:-1]
        else:
            known, y = model.without_memory(y)
            if isinstance(method, Regularized):
                assert method.width is not None
                speed = known.relative_velocity(forcing, jnp.zeros_like(time), y)
                coefficient = Switch(method.width, method.shape).coefficient(known.friction_at(y), speed)
            else:
                lasts = (time < sticks.end) | ((sticks.ending == Ending.HORIZON) & (time <= sticks.end))
                # At isolated instants of no relative velocity the friction of the slip that follows.
                sign = jnp.where(known.at_rest(forcing, y), known.release_sign(forcing, y), known.slip_sign(forcing, y))
                now = jnp.any(sticks.mask & (sticks.start <= time) & lasts)
                coefficient = known.coefficient_in(forcing, y, sign, now)
        # The power of friction is linear in the force, and minus the velocity its slope.
        velocity = jnp.where(now, 0, -known.powers(forcing, y, jnp.ones_like(time)).dissipated["friction"])
        inside = (time >= 0) & (time <= last)
        force = known.friction_force(y, coefficient)
        return jnp.where(inside, force, jnp.nan), jnp.where(inside, velocity, jnp.nan)

    return jax.vmap(at)(times)


@kept_jit
def forces_of_contacts(model: Any, path: StepPath, last: FloatScalar, times: Times) -> tuple[FloatArray, FloatArray]:
    """As `forces`, of a `StructureModel`; (times, contacts)."""

    def at(time: FloatScalar) -> tuple[FloatArray, FloatArray]:
        begun = path.beginnings.at(time)
        known, y = model.without_memory(state_in_step(model, begun, time - begun.t))
        force, velocity = known.friction_forces(
            known.forcing(time, begun.segments), y, model.modes_without_memory(begun.sign)
        )
        inside = (time >= 0) & (time <= last)
        return jnp.where(inside, -force, jnp.nan), jnp.where(inside, velocity, jnp.nan)

    return jax.vmap(at)(times)


@kept_jit
def energies(model: Any, beginnings: StepBeginnings, last: FloatScalar, rule: _Rule, times: Times) -> Energies:
    # Terms of a power series are not computed anew for each that follows.
    state_at = sharing(state_in_step) if model.has_short_steps else state_in_step

    def worked(begun: StepBeginnings, h: FloatScalar) -> Powers:
        """What is supplied and dissipated in the first `h` (s) of a step, J."""

        def power(node: FloatScalar) -> Powers:
            now = begun.t + node * h
            known, y = model.without_memory(state_at(model, begun, node * h), begun.sign)
            return known.powers_in(model.forcing(now, begun.segments), y, model.modes_without_memory(begun.sign))

        nodes, weights = (jnp.asarray(numbers, h.dtype) for numbers in rule)
        return jax.tree.map(lambda values: h * jnp.dot(weights, values), jax.vmap(power)(nodes))

    ends = jnp.append(beginnings.t[1:], last)
    steps = jax.vmap(worked)(beginnings, ends - beginnings.t)
    if model.has_sliders:
        # A slider whose limit falls at once, as at a release, loses energy of its spring.
        def elastic(y: State) -> FloatScalar:
            known, y = model.without_memory(y)
            return known.stored_energies(y)["elastic"]

        at_ends = jax.vmap(lambda begun, h: elastic(state_at(model, begun, h)))(beginnings, ends - beginnings.t)
        steps.dissipated["friction"] += jnp.append((at_ends - jnp.roll(jax.vmap(elastic)(beginnings.y), -1))[:-1], 0)
    before = jax.tree.map(lambda values: jnp.cumsum(values) - values, steps)

    def at(time: FloatScalar) -> Energies:
        index = jnp.clip(jnp.searchsorted(beginnings.t, time, side="right") - 1, 0)
        begun, sums = jax.tree.map(lambda values: values[index], (beginnings, before))
        h = time - begun.t
        done = jax.tree.map(jnp.add, sums, worked(begun, h))
        known, y = model.without_memory(state_at(model, begun, h))
        _, first = model.without_memory(tuple(values[0] for values in beginnings.y))
        stored, start = known.stored_energies(y), known.stored_energies(first)
        left = _sum(start) + _sum(done.supplied) - _sum(stored) - _sum(done.dissipated)
        found = Energies(stored, done.supplied, done.dissipated, left)
        inside = (time >= 0) & (time <= last)
        return jax.tree.map(lambda value: jnp.where(inside, value, jnp.nan), found)

    return jax.vmap(at)(times)
