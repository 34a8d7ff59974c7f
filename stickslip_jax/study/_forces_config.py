"""Sections of forces in a study's file: friction laws, external forces and normal forces.

One class for each law, chosen by the key ``law``. To offer another, add its class here and to the union.
"""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import Discriminator, Field, Tag, model_validator

from .._excitation.force_steps import ForceSteps
from .._excitation.smooth import Harmonic, SumOfHarmonics
from .._systems.friction import Coulomb, FrictionLaw, Stribeck, VelocityWeakening
from ._records_config import RecordedConfig
from ._sections import NUMBER, DescribedSection, Section, default_tag, key_of, section_of, tag_of


class CoulombConfig(section_of(Coulomb, "law")):
    """Section of the friction law `Coulomb`."""


class VelocityWeakeningConfig(section_of(VelocityWeakening, "law")):
    """Section of the friction law `VelocityWeakening`."""


class StribeckConfig(section_of(Stribeck, "law")):
    """Section of the friction law `Stribeck`."""


FrictionConfig = Annotated[
    CoulombConfig | VelocityWeakeningConfig | StribeckConfig, Field(discriminator="law"), default_tag("law", "Coulomb")
]


_, MU = key_of(Coulomb, "mu", default=None, description="friction coefficient (Coulomb), or a section friction")
FRICTION = Field(default=None, description="friction law in place of mu")


class WithFriction(Section):
    """A section with keys ``mu`` and ``friction``, a section called `friction_section`, of which one is given."""

    friction_section: ClassVar[str] = "[system.friction]"
    if TYPE_CHECKING:  # each kind of section has these keys at another place
        mu: float | None
        friction: FrictionConfig | None

    @model_validator(mode="before")
    @classmethod
    def _friction_once(cls, table: object) -> object:
        if not isinstance(table, dict) or table.get("friction") is None:
            return table
        if table.get("mu") is not None:
            raise ValueError(f"mu and {cls.friction_section} both give the friction; keep one of them.")
        return {**table, "mu": None}

    @model_validator(mode="after")
    def _friction_there(self) -> "WithFriction":
        if self.mu is None and self.friction is None:
            raise ValueError(f"mu or {self.friction_section} must give the friction.")
        return self

    @property
    def law_of_friction(self) -> FrictionLaw:
        """The friction law as the simulation takes it."""
        return Coulomb(self.mu or 0.0) if self.friction is None else self.friction.build()


class HarmonicForceConfig(section_of(Harmonic, "law", signal_unit="N")):
    """Section of a force with the law `Harmonic`."""


class SumOfHarmonicsForceConfig(section_of(SumOfHarmonics, "law", signal_unit="N")):
    """Section of a force with the law `SumOfHarmonics`."""


class ForceStepsConfig(section_of(ForceSteps, "law")):
    """Section of a normal force with the law `ForceSteps`."""


ForceConfig = Annotated[HarmonicForceConfig | SumOfHarmonicsForceConfig | RecordedConfig, Field(discriminator="law")]


def _number_or_law(value: object) -> str | None:
    """What tells a number from the laws."""
    if isinstance(value, dict):
        return value.get("law")
    return tag_of(type(value)) if isinstance(value, Section) else NUMBER


_Harmonic = Annotated[HarmonicForceConfig, Tag("Harmonic")]
_SumOfHarmonics = Annotated[SumOfHarmonicsForceConfig, Tag("SumOfHarmonics")]
_Recorded = Annotated[RecordedConfig, Tag("Recorded")]
_ForceSteps = Annotated[ForceStepsConfig, Tag("ForceSteps")]
NumberOrForce = Annotated[
    Annotated[float, Tag(NUMBER)] | _Harmonic | _SumOfHarmonics | _Recorded, Discriminator(_number_or_law)
]
"""An external force, N: a number, or a function of time."""
NormalForceConfig = Annotated[
    Annotated[float, Field(gt=0), Tag(NUMBER)] | _Harmonic | _SumOfHarmonics | _Recorded | _ForceSteps,
    Discriminator(_number_or_law),
]
"""A normal force, N: a number, or a function of time."""


def force_of(config: Any) -> Any:
    """A force as the simulation takes it.

    Raises ValueError for an unsuitable record, OSError for a file that cannot be read.
    """
    return config.build() if isinstance(config, (DescribedSection, RecordedConfig)) else config
