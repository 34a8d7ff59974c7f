"""Friction laws."""

import equinox as eqx

from .. import _checks
from .._types import Scalar


class Coulomb(eqx.Module):
    """Coulomb dry friction: the force is ``mu * normal_force`` against the sliding, and at most that in a stick.

    `mu` is the friction coefficient (dimensionless, zero or positive).
    Raises ValueError if `mu` is negative or not finite. Source: Lima and Sampaio 2015, eq. 2.
    """

    mu: Scalar

    def __check_init__(self):
        _checks.non_negative("mu", self.mu)
