"""Section ``[system]`` of a study's file: what moves, its friction, and the force on it.

One class for each, told apart by its tag (``model``, ``law``): to offer another, add its class here and to the union.
"""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from .._excitation.smooth import Harmonic, SumOfHarmonics
from .._systems.friction import Coulomb, FrictionLaw, Stribeck, VelocityWeakening
from .._systems.mass_spring import MassSpring
from .._systems.motor_cart import MotorCart
from ._records_config import RecordedConfig
from ._sections import Section, default_tag

_STATIC = "friction coefficient of a stick"


class CoulombConfig(Section):
    """Section ``[system.friction]`` with the law `Coulomb`."""

    law: Literal["Coulomb"] = "Coulomb"
    mu: float = Field(ge=0, description="friction coefficient")
    mu_static: float | None = Field(default=None, ge=0, description=f"{_STATIC}, at least mu; not given: mu")

    @model_validator(mode="after")
    def _coefficients_fit(self) -> "CoulombConfig":
        self.build()
        return self

    def build(self) -> FrictionLaw:
        """The law as the simulation takes it. Raises ValueError for coefficients that do not fit."""
        return Coulomb(self.mu, self.mu_static)


class VelocityWeakeningConfig(Section):
    """Section ``[system.friction]`` with the law `VelocityWeakening`."""

    law: Literal["VelocityWeakening"]
    mu_static: float = Field(ge=0, description=_STATIC)
    weakening: float = Field(ge=0, description="s/m; a slip has mu_static / (1 + weakening |v|)")

    def build(self) -> FrictionLaw:
        """The law as the simulation takes it."""
        return VelocityWeakening(self.mu_static, self.weakening)


class StribeckConfig(Section):
    """Section ``[system.friction]`` with the law `Stribeck`."""

    law: Literal["Stribeck"]
    mu: float = Field(ge=0, description="friction coefficient of a fast slip")
    mu_static: float = Field(ge=0, description=f"{_STATIC}, at least mu")
    stribeck_speed: float = Field(gt=0, description="m/s")
    exponent: float = Field(default=1.0, ge=1, description="of the speed in the exponential")
    viscous: float = Field(default=0.0, ge=0, description="s/m, times the speed")

    @model_validator(mode="after")
    def _coefficients_fit(self) -> "StribeckConfig":
        self.build()
        return self

    def build(self) -> FrictionLaw:
        """The law as the simulation takes it. Raises ValueError for coefficients that do not fit."""
        return Stribeck(self.mu, self.mu_static, self.stribeck_speed, self.exponent, self.viscous)


class HarmonicForceConfig(Section):
    """Section ``[system.force]`` with the law `Harmonic`."""

    law: Literal["Harmonic"]
    amplitude: float = Field(description="N")
    angular_frequency: float = Field(gt=0, description="rad/s")
    phase: float = Field(default=0.0, description="rad")
    offset: float = Field(default=0.0, description="N")

    def build(self) -> Harmonic:
        """The force as the simulation takes it."""
        return Harmonic(self.amplitude, self.angular_frequency, self.phase, self.offset)


class SumOfHarmonicsForceConfig(Section):
    """Section ``[system.force]`` with the law `SumOfHarmonics`."""

    law: Literal["SumOfHarmonics"]
    amplitudes: list[float] = Field(min_length=1, description="N")
    angular_frequencies: list[float] = Field(min_length=1, description="rad/s")
    phases: list[float] | None = Field(default=None, description="rad; not given: 0")
    offset: float = Field(default=0.0, description="N")

    @model_validator(mode="after")
    def _lengths_fit(self) -> "SumOfHarmonicsForceConfig":
        self.build()
        return self

    def build(self) -> SumOfHarmonics:
        """The force as the simulation takes it. Raises ValueError for lists that do not fit."""
        return SumOfHarmonics(self.amplitudes, self.angular_frequencies, self.phases, self.offset)


FrictionConfig = Annotated[
    CoulombConfig | VelocityWeakeningConfig | StribeckConfig, Field(discriminator="law"), default_tag("law", "Coulomb")
]
ForceConfig = Annotated[HarmonicForceConfig | SumOfHarmonicsForceConfig | RecordedConfig, Field(discriminator="law")]


class MassSpringConfig(Section):
    """Section ``[system]`` with the model `MassSpring`: a mass on a spring."""

    driven_by_voltage: ClassVar[bool] = False
    model: Literal["MassSpring"] = "MassSpring"
    mass: float = Field(default=1.0, gt=0, description="kg")
    stiffness: float = Field(default=4.0, gt=0, description="N/m")
    normal_force: float = Field(default=1.0, gt=0, description="N")
    damping: float = Field(default=0.0, ge=0, description="N s/m")
    mu: float | None = Field(default=1.0, ge=0, description="friction coefficient (Coulomb), or [system.friction]")
    friction: FrictionConfig | None = Field(default=None, description="friction law in place of mu")
    force: ForceConfig | None = Field(default=None, description="external force on the mass")

    @model_validator(mode="before")
    @classmethod
    def _friction_once(cls, table: Any) -> Any:
        if not isinstance(table, dict) or table.get("friction") is None:
            return table
        if table.get("mu") is not None:
            raise ValueError("mu and [system.friction] both tell the friction; keep one of them.")
        return {**table, "mu": None}

    @model_validator(mode="after")
    def _friction_there(self) -> "MassSpringConfig":
        if self.mu is None and self.friction is None:
            raise ValueError("mu or [system.friction] must tell the friction.")
        return self

    def build(self) -> MassSpring:
        """The system as the simulation takes it. Raises ValueError for an unsuitable record of the force, OSError for
        a file that cannot be read.
        """
        friction = CoulombConfig(mu=self.mu or 0.0) if self.friction is None else self.friction
        force = None if self.force is None else self.force.build()
        return MassSpring(self.mass, self.stiffness, self.normal_force, friction.build(), self.damping, force)


_TABLE_1: Any = MotorCart()


class MotorCartConfig(Section):
    """Section ``[system]`` with the model `MotorCart`: a cart driven by a motor; the defaults are the paper's."""

    driven_by_voltage: ClassVar[bool] = True
    model: Literal["MotorCart"]
    mu: float = Field(default=_TABLE_1.mu, ge=0, description="friction coefficient of cart and rail")
    cart_mass: float = Field(default=_TABLE_1.cart_mass, gt=0, description="kg")
    eccentricity: float = Field(default=_TABLE_1.eccentricity, gt=0, description="of the pin on the disk, m")
    gravity: float = Field(default=_TABLE_1.gravity, gt=0, description="m/s^2")
    motor_inertia: float = Field(default=_TABLE_1.motor_inertia, gt=0, description="kg m^2")
    motor_damping: float = Field(default=_TABLE_1.motor_damping, ge=0, description="N m s/rad")
    motor_constant: float = Field(default=_TABLE_1.motor_constant, gt=0, description="V s/rad, also N m/A")
    resistance: float = Field(default=_TABLE_1.resistance, gt=0, description="ohm")
    inductance: float = Field(default=_TABLE_1.inductance, gt=0, description="H")
    equation: Literal["physical", "printed"] = Field(
        default="physical", description="physical, or as printed in the paper (its units do not match)"
    )

    def build(self) -> MotorCart:
        """The system as the simulation takes it."""
        return MotorCart(**self.model_dump(exclude={"model"}))


SystemConfig = Annotated[
    MassSpringConfig | MotorCartConfig, Field(discriminator="model"), default_tag("model", "MassSpring")
]
