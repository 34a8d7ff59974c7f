"""The relative velocity at which the forces of a stage of an implicit step balance, with all its derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..._numerics.own_derivative import OwnDerivative
from ..._systems.friction import FrictionLaw
from ..._types import FloatArray
from .switch import Switch

_LEAST_STEEP = 1e-6  # of the balance of forces, 1 without friction; not above it at the edge of a jump


@OwnDerivative
def balance_root(
    switch: Switch, friction: FrictionLaw, size: FloatArray, stiffness: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, ...]:
    """The root `sigma` of ``sigma + stiffness mu(sigma) = size``, with its derivatives of every order."""
    return (sigma,)


@balance_root.def_jvp
def _balance_root_jvp(primals, tangents):
    *given, sigma = primals
    (sigma,) = balance_root(*given, lax.stop_gradient(sigma))

    def residual(switch, friction, size, stiffness):
        return sigma + stiffness * switch.coefficient(friction, sigma) - size

    _, change = eqx.filter_jvp(residual, tuple(given), tuple(tangents[:-1]))
    switch, friction, _, stiffness = given
    _, slope = jax.jvp(lambda value: switch.coefficient(friction, value), (sigma,), (jnp.ones_like(sigma),))
    steep = 1 + stiffness * slope
    return (sigma,), (-change / jnp.where(steep > _LEAST_STEEP, steep, 1),)
