"""One dry-friction contact of a structure with several."""

from typing import Annotated, Any

import equinox as eqx
import numpy as np

from .. import _checks
from .._fields import Checked, Quantity
from .._types import Number
from .friction import FrictionLaw
from .normal_force import NormalForce, NormalForceQuantity


def numbers_of(values: Any) -> Any:
    """Numbers of a sequence as an array of NumPy; arrays, traced or not, as they are, and what is to be refused."""
    try:
        return np.asarray(_checks.numbers("", values), float) if isinstance(values, (list, tuple)) else values
    except ValueError:
        return values


def entries_of(values: Any) -> Any:
    """A list as a tuple; anything else as it is."""
    return tuple(values) if isinstance(values, list) else values


class Contact(Checked):
    """A dry-friction contact of a `LinearStructure`.

    Its relative velocity is ``direction . velocities - on_base * base velocity``. The friction force acts against it on
    the masses, in proportion to `direction`.

    Args:
        direction: (d,), what each velocity of the structure contributes to the relative velocity.
        normal_force: N, positive; or a function of time: a `Signal` such as `Harmonic`, a `Recorded` or a `ForceSteps`.
            While that is zero or negative the contact is open: there is no friction, and it does not stick.
        friction: The friction law, such as `Coulomb(mu)`.
        on_base: How much of the base velocity is subtracted: 1 for a mass that rubs on the base, 0 for a contact
            between two masses, or with the ground.

    Raises:
        ValueError: If a number is out of its range or not finite, or `friction` is no friction law.
    """

    direction: Any = eqx.field(converter=numbers_of)
    normal_force: Annotated[
        NormalForce,
        NormalForceQuantity("N", above=0, hint="a contact that opens has a function of time, such as a ForceSteps"),
    ]
    friction: FrictionLaw
    on_base: Annotated[Number, Quantity("", meaning="share of the base velocity that is subtracted")] = 1.0

    def check_parts(self) -> None:
        _checks.bounded("direction", self.direction, ndim=1)
        if not isinstance(self.friction, FrictionLaw):
            raise _checks.refused("friction", "be a friction law such as Coulomb(mu=0.3)", self.friction)

    @classmethod
    def of_mass(cls, index: int, masses: int, normal_force: NormalForce, friction: FrictionLaw) -> "Contact":
        """The contact of mass number `index` (from 0) of `masses` with the base."""
        return cls(_unit(index, masses), normal_force, friction)

    @classmethod
    def between(
        cls, first: int, second: int, masses: int, normal_force: NormalForce, friction: FrictionLaw
    ) -> "Contact":
        """The contact of mass number `first` with mass number `second` (from 0) of `masses`."""
        return cls(_unit(first, masses) - _unit(second, masses), normal_force, friction, on_base=0.0)


def _unit(index: int, masses: int) -> np.ndarray:
    _checks.whole_number("index", index, minimum=0, maximum=masses - 1)
    return np.eye(masses)[index]
