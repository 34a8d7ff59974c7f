"""Friction force and energies along one trajectory."""

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.path import Path
from .._dynamics.regularized.switch import Switch
from .._dynamics.switched.path import StepPath, follow_steps
from .._dynamics.switched.run import Beginnings, state_in_step
from .._events.sticks import Sticks
from .._status import Ending
from .._systems import energy
from .._systems.inner_states import InnerStates
from .._systems.one_contact import OneContactModel
from .._systems.switched_model import F
from .._types import Array, BoolScalar, FloatScalar, Scalar, State

if TYPE_CHECKING:
    from .result import Simulation

Times: TypeAlias = Float[Array, " times"]

_MOST_HALVES = 40  # of a step: it then resolves what dies out in 1e-12 of its length


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


class _Rule(NamedTuple):
    """Nodes and weights of Gauss's rule on [0, 1], the unit of which is a time step."""

    nodes: Float[np.ndarray, " nodes"]
    weights: Float[np.ndarray, " nodes"]

    @classmethod
    def of(cls, decay: Scalar, longest: Scalar) -> "_Rule":
        """The rule for steps of at most `longest` (s), at whose beginning a motion may die out at the rate `decay`.

        No step is longer than a tenth of the shortest period, so that powers are smooth in it, unless damping is so
        strong that a motion dies out within the step. Then the step is cut into parts, each half as long as the next.
        """
        if not _checks.is_traced(decay) and decay == 0:
            halves = 0
        elif _checks.is_traced(decay) or _checks.is_traced(longest):
            halves = _MOST_HALVES
        else:
            halves = min(math.ceil(math.log2(max(float(decay) * float(longest), 1))), _MOST_HALVES)
        nodes, weights = np.polynomial.legendre.leggauss(8 if halves == 0 else 16)
        bounds = np.concatenate([[0.0], 0.5 ** np.arange(halves, -1, -1)])
        parts = np.diff(bounds)[:, None]
        return cls((bounds[:-1, None] + parts * (nodes + 1) / 2).reshape(-1), (parts * weights / 2).reshape(-1))


def _sum(terms: energy.Terms) -> FloatScalar:
    return jnp.stack(list(terms.values())).sum(axis=0)


def friction_force_of(one: "Simulation", times: Float[Array, "*times"]) -> Float[Array, "*times"]:
    """The friction force of a `Simulation` at `times`; see there."""
    inner = one.system.inner_model(one._path.smooth)
    if inner is not None and isinstance(inner.inner, OneContactModel):
        energy.require_known(one.system, inner.inner, "friction_force")
        found = _inner_forces(inner, one._path, one.time_reached, times.reshape(-1))
        return found.reshape(times.shape)
    model = one.system.one_contact_model(one._path.smooth, None)
    energy.require_known(one.system, model, "friction_force")
    found = _forces(model, one._path, one.method, one.sticks, one.time_reached, times.reshape(-1))
    return found.reshape(times.shape)


@jax.jit
def _inner_forces(model: InnerStates, path: Path, last: FloatScalar, times: Times) -> Times:
    def at(time: FloatScalar) -> FloatScalar:
        y, forcing = path.state(time), model.forcing(time, path.segments(time))
        coefficient = model.coefficients(forcing, jnp.zeros_like(time), y)
        force = energy.friction_force(model.inner, y[:-1], coefficient)
        return jnp.where((time >= 0) & (time <= last), force, jnp.nan)

    return jax.vmap(at)(times)


@jax.jit
def _forces(
    model: OneContactModel, path: Path, method: Exact | Regularized, sticks: Sticks, last: FloatScalar, times: Times
) -> Times:
    def at(time: FloatScalar) -> FloatScalar:
        y, forcing = path.state(time), model.forcing(time, path.segments(time))
        if isinstance(method, Regularized):
            assert method.width is not None
            speed = model.relative_velocity(forcing, jnp.zeros_like(time), y)
            coefficient = Switch(method.width, method.shape).coefficient(model.friction_at(y), speed)
        else:
            lasts = (time < sticks.end) | ((sticks.ending == Ending.HORIZON) & (time <= sticks.end))
            # At isolated instants of no relative velocity the friction of the slip that follows.
            sign = jnp.where(model.at_rest(forcing, y), model.release_sign(forcing, y), model.slip_sign(forcing, y))
            now = jnp.any(sticks.mask & (sticks.start <= time) & lasts)
            coefficient = _coefficient(model, forcing, y, sign, now)
        inside = (time >= 0) & (time <= last)
        return jnp.where(inside, energy.friction_force(model, y, coefficient), jnp.nan)

    return jax.vmap(at)(times)


def _coefficient(model: OneContactModel[F], forcing: F, y: State, sign: FloatScalar, sticks: BoolScalar) -> FloatScalar:
    """The signed friction coefficient in a stick, or in a slip of this sign."""
    none = jnp.zeros_like(y[0])
    velocity = model.relative_velocity(forcing, none, y)
    slip = model.slip_direction(y, sign) * model.friction_at(y).slip_coefficient(velocity)
    return jnp.where(sticks, model.holding_coefficient(forcing, none, y), slip)


def energies_of(one: "Simulation", times: Float[Array, "*times"]) -> Energies:
    """The energies of a `Simulation` at `times`; see there."""
    if not isinstance(one.method, Exact):
        raise ValueError(
            f"energies needs a simulation with method=Exact(), but one with {_checks.show(one.method)} was given."
        )
    path = one._path
    if not isinstance(path, StepPath):
        # Its steps end at each change of sign of the relative velocity, which intervals do not record.
        y0 = tuple(path.state(jnp.zeros_like(one.time_reached)))
        path = follow_steps(one.system, one.base, Exact(), one.t1, y0, one.time_reached.dtype).path
        assert isinstance(path, StepPath)
    model = one.system.one_contact_model(path.smooth, path.solver)
    energy.require_known(one.system, model, "energies")
    energy.require_energy(one.system)
    lengths = jnp.append(path.beginnings.t[1:], one.time_reached) - path.beginnings.t
    rule = _Rule.of(energy.fastest_decay(model), jnp.max(lengths))
    found = _energies(model, path.beginnings, one.time_reached, times.reshape(-1), rule)
    return jax.tree.map(lambda values: values.reshape(times.shape), found)


@jax.jit
def _energies(model: OneContactModel, beginnings: Beginnings, last: FloatScalar, times: Times, rule: _Rule) -> Energies:
    def worked(begun: Beginnings, h: FloatScalar) -> energy.Powers:
        """What is supplied and dissipated in the first `h` (s) of a step, J."""

        def power(node: FloatScalar) -> energy.Powers:
            now = begun.t + node * h
            y, forcing = state_in_step(model, begun, node * h), model.forcing(now, begun.segments)
            coefficient = _coefficient(model, forcing, y, begun.sign, begun.sign == 0)
            return energy.powers(model, forcing, y, energy.friction_force(model, y, coefficient))

        rates = jax.vmap(power)(jnp.asarray(rule.nodes, h.dtype))
        return jax.tree.map(lambda values: h * jnp.dot(jnp.asarray(rule.weights, h.dtype), values), rates)

    ends = jnp.append(beginnings.t[1:], last)
    steps = jax.vmap(worked)(beginnings, ends - beginnings.t)
    before = jax.tree.map(lambda values: jnp.cumsum(values) - values, steps)

    def at(time: FloatScalar) -> Energies:
        index = jnp.clip(jnp.searchsorted(beginnings.t, time, side="right") - 1, 0)
        begun, sums = jax.tree.map(lambda values: values[index], (beginnings, before))
        h = time - begun.t
        done = jax.tree.map(jnp.add, sums, worked(begun, h))
        stored = energy.stored_energies(model, state_in_step(model, begun, h))
        start = energy.stored_energies(model, tuple(values[0] for values in beginnings.y))
        left = _sum(start) + _sum(done.supplied) - _sum(stored) - _sum(done.dissipated)
        found = Energies(stored, done.supplied, done.dissipated, left)
        inside = (time >= 0) & (time <= last)
        return jax.tree.map(lambda value: jnp.where(inside, value, jnp.nan), found)

    return jax.vmap(at)(times)
