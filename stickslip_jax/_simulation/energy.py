"""Friction force and energies along one trajectory."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks
from .._dynamics.method import Exact, Regularized
from .._dynamics.path import Path
from .._dynamics.regularized.switch import Switch
from .._dynamics.switched.path import StepPath, follow_steps
from .._dynamics.switched.run import Beginnings, state_in_step
from .._events.sticks import Sticks
from .._status import Ending
from .._systems import energy
from .._types import AnyArray, Array, FloatArray

_MOST_HALVES = 40  # of a step: it then resolves what dies out in 1e-12 of its length


class Energies(NamedTuple):
    """Energies along a trajectory, J: dicts of arrays with the shape of the times, by name.

    - `stored`: kinetic, elastic (of a `MotorCart` kinetic and magnetic), at each time.
    - `supplied`: from the start to each time, by the base (the friction force times the base velocity; negative where
      the mass drives the base) and by the load (external force and ground acceleration), of a `MotorCart` by the
      voltage.
    - `dissipated`: from the start to each time, by friction (only in slips), by damping, of a `MotorCart` also in the
      resistance.
    - `imbalance`: what was stored at the start and supplied, less what is stored and was dissipated: round-off, and of
      a trajectory without a closed form the error of its steps.
    """

    stored: dict[str, Array]
    supplied: dict[str, Array]
    dissipated: dict[str, Array]
    imbalance: Array


class _Rule(NamedTuple):
    """Nodes and weights of Gauss's rule on [0, 1], the unit of which is a time step."""

    nodes: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, decay: Any, longest: Any) -> "_Rule":
        """The rule for steps of at most `longest` (s), at whose beginning a motion may die out at the rate `decay`.

        No step is longer than a tenth of the shortest period, so that powers are smooth there, but for such a motion of
        strong damping: its parts are then the second half of the step, the second half of the first, and so on.
        """
        if not _checks.is_traced(decay) and decay == 0:
            halves = 0
        elif _checks.is_traced(decay) or _checks.is_traced(longest):
            halves = _MOST_HALVES
        else:
            halves = min(math.ceil(math.log2(max(float(decay) * float(longest), 1))), _MOST_HALVES)
        nodes, weights = np.polynomial.legendre.leggauss(8 if halves == 0 else 16)
        edges = np.concatenate([[0.0], 0.5 ** np.arange(halves, -1, -1)])
        parts = np.diff(edges)[:, None]
        return cls((edges[:-1, None] + parts * (nodes + 1) / 2).reshape(-1), (parts * weights / 2).reshape(-1))


def _sum(terms: energy.Terms) -> Array:
    return jnp.stack(list(terms.values())).sum(axis=0)


def friction_force_of(one: Any, times: Float[Array, "*times"]) -> Float[Array, "*times"]:
    """The friction force of a `Simulation` at `times`; see there."""
    model = one.system.switched_model(one._path.smooth, None)
    energy.require_known(one.system, model, "friction_force")
    found = _forces(model, one._path, one.method, one.sticks, one.time_reached, times.reshape(-1))
    return found.reshape(times.shape)


@jax.jit
def _forces(model: Any, path: Path, method: Any, sticks: Sticks, last: FloatArray, times: FloatArray) -> FloatArray:
    def at(time):
        y, inputs = path.state(time), model.inputs(time, path.segments(time))
        if isinstance(method, Regularized):
            speed = model.relative_velocity(inputs, jnp.zeros_like(time), y)
            grip = Switch(method.width, method.shape).grip(model.friction, speed)
        else:
            lasts = (time < sticks.end) | ((sticks.ending == Ending.HORIZON) & (time <= sticks.end))
            grip = _grip(model, inputs, y, jnp.any(sticks.mask & (sticks.start <= time) & lasts))
        inside = (time >= 0) & (time <= last)
        return jnp.where(inside, energy.friction_force(model, y, grip), jnp.nan)

    return jax.vmap(at)(times)


def _grip(model: Any, inputs: Any, y: Any, sticks: AnyArray) -> FloatArray:
    """The signed friction coefficient in a stick or slip."""
    none = jnp.zeros_like(y[0])
    speed = model.relative_velocity(inputs, none, y)
    # At isolated instants of no relative velocity the friction of the slip that follows.
    sign = jnp.where(model.at_rest(inputs, y), model.release_sign(inputs, y), model.slip_sign(inputs, y))
    slip = model.grip_of(y, sign) * model.friction.kinetic(jnp.abs(speed))
    return jnp.where(sticks, model.holding(inputs, none, y), slip)


def energies_of(one: Any, times: Float[Array, "*times"]) -> Energies:
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
    model = one.system.switched_model(path.smooth, path.solver)
    energy.require_known(one.system, model, "energies")
    energy.require_energy(one.system)
    lengths = jnp.append(path.beginnings.t[1:], one.time_reached) - path.beginnings.t
    rule = _Rule.of(energy.fastest_decay(model), jnp.max(lengths))
    found = _energies(model, path.beginnings, one.time_reached, times.reshape(-1), rule)
    return jax.tree.map(lambda values: values.reshape(times.shape), found)


@jax.jit
def _energies(model: Any, beginnings: Beginnings, last: FloatArray, times: FloatArray, rule: _Rule) -> Energies:
    def worked(begun: Beginnings, h: FloatArray) -> energy.Powers:
        """What is supplied and dissipated in the first `h` (s) of a step, J."""

        def power(node):
            now = begun.t + node * h
            y, inputs = state_in_step(model, begun, node * h), model.inputs(now, begun.segments)
            none = jnp.zeros_like(now)
            coefficient = model.friction.kinetic(jnp.abs(model.relative_velocity(inputs, none, y)))
            slip = model.grip_of(y, begun.sign) * coefficient
            grip = jnp.where(begun.sign == 0, model.holding(inputs, none, y), slip)
            return energy.powers(model, inputs, y, energy.friction_force(model, y, grip))

        rates = jax.vmap(power)(jnp.asarray(rule.nodes, h.dtype))
        return jax.tree.map(lambda values: h * jnp.dot(jnp.asarray(rule.weights, h.dtype), values), rates)

    ends = jnp.append(beginnings.t[1:], last)
    steps = jax.vmap(worked)(beginnings, ends - beginnings.t)
    before = jax.tree.map(lambda values: jnp.cumsum(values) - values, steps)

    def at(time):
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
