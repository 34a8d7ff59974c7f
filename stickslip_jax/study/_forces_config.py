"""Sections of forces in a study's file: friction laws, external forces and normal forces.

One class for each law, chosen by the key ``law``. To offer another, add its class here and to the union.
"""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from .._excitation.force_steps import ForceSteps
from .._excitation.smooth import Harmonic, SumOfHarmonics
from .._systems.composed_friction import Ageing, Directional, ExponentialGrowth, LogarithmicGrowth
from .._systems.dynamic_friction import BoucWen, Dahl, DieterichRuina, ElastoPlastic, LuGre
from .._systems.friction import Coulomb, FrictionLaw, Stribeck, VelocityWeakening
from ._records_config import RecordedConfig
from ._sections import NUMBER, DescribedSection, Section, default_tag, key_of, section_of, tag_of


class CoulombConfig(section_of(Coulomb, "law")):
    """Section of the friction law `Coulomb`."""


class VelocityWeakeningConfig(section_of(VelocityWeakening, "law")):
    """Section of the friction law `VelocityWeakening`."""


class StribeckConfig(section_of(Stribeck, "law")):
    """Section of the friction law `Stribeck`."""


class LuGreConfig(section_of(LuGre, "law")):
    """Section of the friction law `LuGre`."""


class ElastoPlasticConfig(section_of(ElastoPlastic, "law")):
    """Section of the friction law `ElastoPlastic`."""


class DahlConfig(section_of(Dahl, "law")):
    """Section of the friction law `Dahl`."""


class BoucWenConfig(section_of(BoucWen, "law")):
    """Section of the friction law `BoucWen`."""


class DieterichRuinaConfig(section_of(DieterichRuina, "law")):
    """Section of the friction law `DieterichRuina`."""


class ExponentialGrowthConfig(section_of(ExponentialGrowth, "law")):
    """Section of the growth `ExponentialGrowth`."""


class LogarithmicGrowthConfig(section_of(LogarithmicGrowth, "law")):
    """Section of the growth `LogarithmicGrowth`."""


_USUAL_LAW = default_tag("law", "Coulomb")
_OfSpeed = CoulombConfig | VelocityWeakeningConfig | StribeckConfig


class AgeingConfig(Section):
    """Section of the friction law `Ageing`, and its sections ``slip`` and ``growth``."""

    law: Literal["Ageing"]
    slip: Annotated[_OfSpeed, Field(discriminator="law"), _USUAL_LAW] = Field(
        description="friction law of slips, and of sticks that have just begun"
    )
    growth: Annotated[ExponentialGrowthConfig | LogarithmicGrowthConfig, Field(discriminator="law")] = Field(
        description="what is added to static friction while a stick lasts"
    )

    def build(self) -> Ageing:
        """The law as the simulation takes it."""
        return Ageing(self.slip.build(), self.growth.build())


_OneWay = Annotated[_OfSpeed | AgeingConfig, Field(discriminator="law"), _USUAL_LAW]


class DirectionalConfig(Section):
    """Section of the friction law `Directional`, and its sections ``forward`` and ``backward``."""

    law: Literal["Directional"]
    forward: _OneWay = Field(description="friction law of slips with a positive relative velocity")
    backward: _OneWay = Field(description="that of negative ones")

    def build(self) -> Directional:
        """The law as the simulation takes it."""
        return Directional(self.forward.build(), self.backward.build())


_Composed = DirectionalConfig | AgeingConfig
_WithInnerState = LuGreConfig | ElastoPlasticConfig | DahlConfig | BoucWenConfig | DieterichRuinaConfig
FrictionConfig = Annotated[_OfSpeed | _Composed | _WithInnerState, Field(discriminator="law"), _USUAL_LAW]


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

    @property
    def has_inner_states(self) -> bool:
        """Whether the friction law has one."""
        return isinstance(self.friction, _WithInnerState)


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
