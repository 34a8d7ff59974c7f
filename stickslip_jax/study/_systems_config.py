"""Section ``[system]`` of a study's file: the system, its friction law, and the force on it.

One class for each, chosen by the key ``model`` or ``law``. The keys are the fields of the system or law, with their
bounds, units and defaults. To offer another, add its class here and to the union.
"""

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from .._excitation.smooth import Harmonic, SumOfHarmonics
from .._fields import described
from .._systems.friction import Coulomb, Stribeck, VelocityWeakening
from .._systems.mass_spring import MassSpring
from .._systems.motor_cart import MotorCart
from ._records_config import RecordedConfig
from ._sections import Section, default_tag, key_of, section_of


class CoulombConfig(section_of(Coulomb, "law")):
    """Section ``[system.friction]`` with the law `Coulomb`."""


class VelocityWeakeningConfig(section_of(VelocityWeakening, "law")):
    """Section ``[system.friction]`` with the law `VelocityWeakening`."""


class StribeckConfig(section_of(Stribeck, "law")):
    """Section ``[system.friction]`` with the law `Stribeck`."""


class HarmonicForceConfig(section_of(Harmonic, "law", signal_unit="N")):
    """Section ``[system.force]`` with the law `Harmonic`."""


class SumOfHarmonicsForceConfig(section_of(SumOfHarmonics, "law", signal_unit="N")):
    """Section ``[system.force]`` with the law `SumOfHarmonics`."""


FrictionConfig = Annotated[
    CoulombConfig | VelocityWeakeningConfig | StribeckConfig, Field(discriminator="law"), default_tag("law", "Coulomb")
]
ForceConfig = Annotated[HarmonicForceConfig | SumOfHarmonicsForceConfig | RecordedConfig, Field(discriminator="law")]


_USUAL = {"mass": 1.0, "stiffness": 4.0, "normal_force": 1.0, "damping": 0.0}
_, _MU = key_of(Coulomb, "mu", default=1.0, description="friction coefficient (Coulomb), or [system.friction]")


class MassSpringConfig(section_of(MassSpring, "model", _USUAL, base=Section)):
    """Section ``[system]`` with the model `MassSpring`: a mass on a spring."""

    driven_by_voltage: ClassVar[bool] = False
    mu: float | None = _MU
    friction: FrictionConfig | None = Field(default=None, description="friction law in place of mu")
    force: ForceConfig | None = Field(default=None, description="external force on the mass")

    @model_validator(mode="before")
    @classmethod
    def _friction_once(cls, table: object) -> object:
        if not isinstance(table, dict) or table.get("friction") is None:
            return table
        if table.get("mu") is not None:
            raise ValueError("mu and [system.friction] both give the friction; keep one of them.")
        return {**table, "mu": None}

    @model_validator(mode="after")
    def _friction_there(self) -> "MassSpringConfig":
        if self.mu is None and self.friction is None:
            raise ValueError("mu or [system.friction] must give the friction.")
        return self

    def build(self) -> MassSpring:
        """The system as the simulation takes it. Raises ValueError for an unsuitable record of the force, OSError for
        a file that cannot be read.
        """
        numbers = {name: getattr(self, name) for name in described(MassSpring)}
        friction = Coulomb(self.mu or 0.0) if self.friction is None else self.friction.build()
        return MassSpring(friction=friction, force=None if self.force is None else self.force.build(), **numbers)


class MotorCartConfig(section_of(MotorCart, "model")):
    """Section ``[system]`` with the model `MotorCart`: a cart driven by a motor; the defaults are the paper's."""

    driven_by_voltage: ClassVar[bool] = True


SystemConfig = Annotated[
    MassSpringConfig | MotorCartConfig, Field(discriminator="model"), default_tag("model", "MassSpring")
]
