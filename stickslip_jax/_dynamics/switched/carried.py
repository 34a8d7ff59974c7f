"""Derivatives of a time step, of every order.

A step ends at an event, at the end of a segment, or after a length that was chosen for it. Where it ends is found by
trial; its derivative comes from what defines it. The event time `tau` solves ``guard(tau, flow(tau)) = 0``, so that

    d tau = -(d guard at fixed tau) / (rate of the guard)
    d y   =  (d flow at fixed tau) + (rates at tau) d tau

(the implicit function theorem). Both hold for all parameters, with `tau` and `y` functions of them: differentiated
again, by the same rule for `tau` and `y`, they give the second derivatives, and so on.

All are evaluated a little before the event (`Before`), where round-off cannot have ended the mode, if friction may have
a kink there: where the relative velocity is exactly zero, a force written with its absolute value may have the slope
of the other side. In the last step, however short it is, that is an error in second derivatives of `tau`.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from ..._numerics.over_contacts import any_of, sum_of
from ..._numerics.own_derivative import OwnDerivative
from ..._systems.switched_model import State, SwitchedModel, chosen_state
from ..._types import BoolArray, FloatArray


class HowItEnds(NamedTuple):
    """Whether a step moves at all; if so, of which contact's mode the end ends it (`at_event`; of one at most), or
    whether the end of a segment or the horizon does.
    """

    moves: BoolArray
    at_event: BoolArray
    at_stop: BoolArray


class Before(NamedTuple):
    """The `time` (s) before an event by which round-off cannot have ended the mode, and the `change` of state in it."""

    time: FloatArray
    change: State


@OwnDerivative
def carried(
    model: SwitchedModel,
    forcing: object,
    y: State,
    left: FloatArray,
    sign: FloatArray,
    ends: HowItEnds,
    before: Before | None,
    tau: FloatArray,
    reached: State,
) -> tuple[FloatArray, ...]:
    """The length `tau` (s) of a step from `y` and the state `reached` in it, with their derivatives of every order.

    `left`: time from the beginning of the step to the end of the segment or the horizon, s. `before`: None for friction
    without kinks. `tau` and `reached` are
    taken as they are; their derivatives are those of what they were found to be.
    """
    return tau, *reached


@carried.def_jvp
def _carried_jvp(primals, tangents):
    model, forcing, y, left, sign, ends, before, tau, reached = primals
    tau, *reached = carried(model, forcing, y, left, sign, ends, before, *lax.stop_gradient((tau, reached)))
    by = (tangents[0], tangents[1], tangents[2])
    inside, there = tau, tuple(reached)
    if before is not None:
        inside = tau - before.time
        there = tuple(value - change for value, change in zip(reached, before.change, strict=True))

    def flow(model, forcing, y):
        moved = chosen_state(ends.moves, model.flow(forcing, y, inside, sign), y)
        return moved, model.guard(forcing, inside, moved, sign)[0]

    _, (d_reached, d_guard) = eqx.filter_jvp(flow, (model, forcing, y), by)
    _, rate = model.guard(forcing, inside, there, sign)
    d_left = jnp.zeros_like(tau) if tangents[3] is None else tangents[3]
    d_event = -_or_zero(d_guard, rate) / jnp.where(ends.at_event, rate, -1)
    at_stop = jnp.where(ends.at_stop, d_left, 0)
    if rate.ndim:
        d_tau = jnp.where(any_of(ends.at_event), sum_of(jnp.where(ends.at_event, d_event, 0)), at_stop)
    else:
        d_tau = jnp.where(ends.at_event, d_event, at_stop)
    rates = model.rates(forcing, inside, there, sign)
    d_reached = tuple(_or_zero(d, v) + r * d_tau for d, v, r in zip(d_reached, reached, rates, strict=True))
    return (tau, *reached), (d_tau, *d_reached)


def _or_zero(tangent: Any, like: Any) -> Any:
    return jnp.zeros_like(like) if tangent is None else tangent
