"""Section ``[system]`` of a study's file: the system, its friction law, and the force on it.

One class for each system, chosen by the key ``model``. The keys are the fields of the system, with their bounds, units
and defaults. To offer another, add its class here and to the union.
"""

from typing import Annotated, ClassVar

from pydantic import Field

from .._fields import described
from .._systems.friction import Coulomb
from .._systems.mass_spring import MassSpring
from .._systems.motor_cart import USUAL_MU, MotorCart
from ._forces_config import FRICTION, ForceConfig, FrictionConfig, WithFriction
from ._sections import default_tag, key_of, section_of
from ._structures_config import BlockRowConfig, LinearStructureConfig, StoreysOnBearingConfig

_USUAL = {"mass": 1.0, "stiffness": 4.0, "normal_force": 1.0, "damping": 0.0}
_, _MU = key_of(Coulomb, "mu", default=1.0, description="friction coefficient (Coulomb), or [system.friction]")


class MassSpringConfig(section_of(MassSpring, "model", _USUAL, base=WithFriction)):
    """Section ``[system]`` with the model `MassSpring`: a mass on a spring."""

    driven_by_voltage: ClassVar[bool] = False
    mu: float | None = _MU
    friction: FrictionConfig | None = FRICTION
    force: ForceConfig | None = Field(default=None, description="external force on the mass")

    def build(self) -> MassSpring:
        """The system as the simulation takes it. Raises ValueError for an unsuitable record of the force, OSError for
        a file that cannot be read.
        """
        numbers = {name: getattr(self, name) for name in described(MassSpring)}
        force = None if self.force is None else self.force.build()
        return MassSpring(friction=self.law_of_friction, force=force, **numbers)


_, _CART_MU = key_of(MotorCart, "mu", default=USUAL_MU)


class MotorCartConfig(section_of(MotorCart, "model", base=WithFriction)):
    """Section ``[system]`` with the model `MotorCart`: a cart driven by a motor; the defaults are the paper's."""

    driven_by_voltage: ClassVar[bool] = True
    mu: float | None = _CART_MU
    friction: FrictionConfig | None = FRICTION

    def build(self) -> MotorCart:
        """The system as the simulation takes it. Raises ValueError for values that do not fit together."""
        numbers = {name: getattr(self, name) for name in described(MotorCart)}
        return MotorCart(friction=None if self.friction is None else self.friction.build(), **numbers)


SystemConfig = Annotated[
    MassSpringConfig | MotorCartConfig | LinearStructureConfig | BlockRowConfig | StoreysOnBearingConfig,
    Field(discriminator="model"),
    default_tag("model", "MassSpring"),
]
