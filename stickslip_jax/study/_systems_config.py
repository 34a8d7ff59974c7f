"""Sections ``[system]``, ``[base]`` and those of forces in a study's file."""

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from .._excitation.excitation import WithJumps
from .._excitation.gaussian import (
    CloughPenzienSpectrum,
    GaussianProcess,
    KanaiTajimi,
    KanaiTajimiSpectrum,
    TabulatedSpectrum,
    VelocitySpectrum,
)
from .._excitation.motion import Harmonic, RandomPhase, Signal, SourceVoltage, SumOfHarmonics
from .._excitation.piecewise_constant import (
    Constant,
    PiecewiseConstant,
    PiecewiseConstantLaw,
    PoissonSwitching,
    RandomSteps,
    SemiMarkovSwitching,
    SquareWave,
)
from .._excitation.recorded import ForceSteps
from .._foundation.fields import described
from .._systems.builders import STANDARD_GRAVITY, block_row, storeys_on_bearing
from .._systems.composed_friction import Ageing, Directional, ExponentialGrowth, LogarithmicGrowth
from .._systems.contacts import Contact
from .._systems.dynamic_friction import BoucWen, Dahl, DieterichRuina, ElastoPlastic, LuGre
from .._systems.friction import Coulomb, FrictionLaw, Stribeck, VelocityWeakening
from .._systems.mass_spring import MassSpring
from .._systems.motor_cart import USUAL_MU, MotorCart
from .._systems.structure import MOST_CONTACTS, LinearStructure, check_structure
from .._uncertainty.families import Discrete, Exponential, LogNormal, Normal, Triangular, Uniform, Weibull
from ._sections import (
    NUMBER,
    DescribedSection,
    GroundAccelerationConfig,
    RecordedConfig,
    Section,
    default_tag,
    key_of,
    section_of,
    shown_value,
    tag_of,
)

# Section ``[base]`` of a study's file: the excitation.
#
# One class for each law, chosen by the key ``law``. The keys are the fields of the law, with their bounds, units and
# defaults. To offer another law, add its class here and to one of the unions. A distribution or a spectrum is a section
# of its own, ``[base.gap]`` or ``[base.spectrum]``, chosen by its key ``law``.


class PoissonSwitchingConfig(section_of(PoissonSwitching, "law", {"speed": 1.0, "rate": 1.0})):
    """Section ``[base]`` with the law `PoissonSwitching`."""


class SquareWaveConfig(section_of(SquareWave, "law")):
    """Section ``[base]`` with the law `SquareWave`."""


class RandomStepsConfig(section_of(RandomSteps, "law")):
    """Section ``[base]`` with the law `RandomSteps`."""


class ConstantConfig(section_of(Constant, "law")):
    """Section ``[base]`` with the law `Constant`."""


class PiecewiseConstantConfig(section_of(PiecewiseConstant, "law", base=Section)):
    """Section ``[base]`` with the law `PiecewiseConstant`."""

    @model_validator(mode="after")
    def _times_fit(self) -> "PiecewiseConstantConfig":
        # Lists, which the law keeps as NumPy arrays: arrays of JAX would start it before its settings are known.
        PiecewiseConstant(self.times, self.velocities)
        return self

    def build(self) -> PiecewiseConstantLaw:
        """The law as the simulation takes it (starts JAX). Raises ValueError for times that are equal in float32."""
        return PiecewiseConstant(jnp.asarray(self.times), jnp.asarray(self.velocities))


_RANDOM_PHASE = "whether each sample draws its phase; not given: true, unless a phase is given"


class _Phased(DescribedSection):
    """A law whose phase may be random."""

    random_phase: bool = Field(default=True, description=_RANDOM_PHASE)

    @model_validator(mode="before")
    @classmethod
    def _given_phase_is_not_random(cls, table: object) -> object:
        if not isinstance(table, dict) or all(table.get(key) is None for key in ("phase", "phases")):
            return table
        return {"random_phase": False, **table}

    @model_validator(mode="after")
    def _one_phase(self) -> "_Phased":
        for key in ("phase", "phases"):
            if self.random_phase and getattr(self, key, None) is not None:
                raise ValueError(f"{key} must be left out where random_phase is true, because it is drawn.")
        return self

    @property
    def title(self) -> str:
        """Its name in reports."""
        return f"{super().title} of random phase" if self.random_phase else super().title

    def build(self) -> Signal | RandomPhase:
        """The signal as the simulation takes it. Raises ValueError for lists that do not fit."""
        given = {name: value for name, value in self.numbers.items() if value is not None}
        signal = self.described_class(**given)
        return RandomPhase(signal) if self.random_phase else signal


_PHASE = Field(default=None, description="rad; not given: 0, or drawn")


class HarmonicConfig(section_of(Harmonic, "law", signal_unit="m/s", base=_Phased)):
    """Section ``[base]`` with the law `Harmonic`."""

    phase: float | None = _PHASE


class SumOfHarmonicsConfig(section_of(SumOfHarmonics, "law", signal_unit="m/s", base=_Phased)):
    """Section ``[base]`` with the law `SumOfHarmonics`."""

    phases: list[float] | None = _PHASE


class SourceVoltageConfig(section_of(SourceVoltage, "law", base=_Phased)):
    """Section ``[base]`` with the law `SourceVoltage`, which drives a `MotorCart`."""

    phase: float | None = _PHASE


class KanaiTajimiConfig(section_of(KanaiTajimi, "law")):
    """Section ``[base]`` with the law `KanaiTajimi`."""


# --- laws of distributions and spectra


class ExponentialConfig(section_of(Exponential, "law")):
    """Section of the distribution `Exponential`."""


class WeibullConfig(section_of(Weibull, "law")):
    """Section of the distribution `Weibull`."""


class LogNormalConfig(section_of(LogNormal, "law")):
    """Section of the distribution `LogNormal`."""


class UniformDistributionConfig(section_of(Uniform, "law")):
    """Section of the distribution `Uniform`."""


class TriangularConfig(section_of(Triangular, "law")):
    """Section of the distribution `Triangular`."""


class NormalConfig(section_of(Normal, "law")):
    """Section of the distribution `Normal`."""


class DiscreteConfig(section_of(Discrete, "law")):
    """Section of the distribution `Discrete`."""


_Positive = (
    ExponentialConfig | WeibullConfig | LogNormalConfig | UniformDistributionConfig | TriangularConfig | DiscreteConfig
)
_GapConfig = Annotated[_Positive, Field(discriminator="law")]
_SpeedsConfig = Annotated[_Positive | NormalConfig, Field(discriminator="law")]


class SemiMarkovSwitchingConfig(Section):
    """Section ``[base]`` with the law `SemiMarkovSwitching`, and its sections ``[base.gap]`` and ``[base.speeds]``."""

    law: Literal["SemiMarkovSwitching"]
    speed: float | None = Field(default=None, description="m/s; not given: the section speeds", gt=0)
    alternating: bool = Field(default=True, description="whether the sign alternates, or is that of each speed")
    first_sign: Literal["random", "positive", "negative"] = Field(
        default="random", description="of the velocity, where signs alternate: random, positive or negative"
    )
    gap: _GapConfig = Field(description="distribution of the time between switches, s")
    speeds: _SpeedsConfig | None = Field(default=None, description="distribution of the speeds, m/s, in place of speed")

    @model_validator(mode="after")
    def _accepted(self) -> "SemiMarkovSwitchingConfig":
        if (self.speed is None) == (self.speeds is None):
            raise ValueError("speed must be given, or a section speeds, and not both.")
        self.build()
        return self

    def build(self) -> SemiMarkovSwitching:
        """The law as the simulation takes it. Raises ValueError for distributions of numbers that do not fit."""
        speed = (self.speed or 0.0) if self.speeds is None else self.speeds.build()
        return SemiMarkovSwitching(self.gap.build(), speed, self.alternating, self.first_sign)


class KanaiTajimiSpectrumConfig(section_of(KanaiTajimiSpectrum, "law")):
    """Section of the spectrum `KanaiTajimiSpectrum`."""


class CloughPenzienSpectrumConfig(section_of(CloughPenzienSpectrum, "law")):
    """Section of the spectrum `CloughPenzienSpectrum`."""


class TabulatedSpectrumConfig(section_of(TabulatedSpectrum, "law")):
    """Section of the spectrum `TabulatedSpectrum`."""


_Spectrum = KanaiTajimiSpectrumConfig | CloughPenzienSpectrumConfig | TabulatedSpectrumConfig


class VelocitySpectrumConfig(Section):
    """Section of the spectrum `VelocitySpectrum`, and its section ``acceleration``."""

    law: Literal["VelocitySpectrum"]
    acceleration: Annotated[_Spectrum, Field(discriminator="law")] = Field(description="spectrum of the acceleration")

    def build(self) -> VelocitySpectrum:
        """The spectrum as the simulation takes it."""
        return VelocitySpectrum(self.acceleration.build())


class _WithSpectrum(DescribedSection):
    """A law with a spectrum."""

    harmonics: int = Field(default=128, description="number of harmonics of a sample", ge=1)
    spectrum: Annotated[_Spectrum | VelocitySpectrumConfig, Field(discriminator="law")] = Field(
        description="one-sided power spectral density over angular frequency"
    )

    def build(self) -> GaussianProcess:
        """The law as the simulation takes it. Raises ValueError for a spectrum that does not fit."""
        return GaussianProcess(self.spectrum.build(), **self.numbers, harmonics=self.harmonics)


class GaussianProcessConfig(section_of(GaussianProcess, "law", base=_WithSpectrum)):
    """Section ``[base]`` with the law `GaussianProcess`, and its section ``[base.spectrum]``."""


# --- any law

_Jumps = (
    PoissonSwitchingConfig
    | SemiMarkovSwitchingConfig
    | SquareWaveConfig
    | RandomStepsConfig
    | ConstantConfig
    | PiecewiseConstantConfig
)
_Motions = HarmonicConfig | SumOfHarmonicsConfig | GaussianProcessConfig | RecordedConfig
_JumpsConfig = Annotated[_Jumps, Field(discriminator="law"), default_tag("law", "PoissonSwitching")]
_MotionConfig = Annotated[_Motions, Field(discriminator="law")]


class WithJumpsConfig(Section):
    """Section ``[base]`` with the law `WithJumps`, and its sections ``[base.motion]`` and ``[base.jumps]``."""

    law: Literal["WithJumps"]
    motion: _MotionConfig = Field(description="the continuous part")
    jumps: _JumpsConfig = Field(description="the part that jumps")

    @property
    def title(self) -> str:
        """Its name in reports."""
        return f"{self.motion.title} with jumps by {self.jumps.title}"

    def build(self) -> WithJumps:
        """The law as the simulation takes it. Raises ValueError for an unsuitable record, OSError for a file that
        cannot be read.
        """
        return WithJumps(self.motion.build(), self.jumps.build())


BaseConfig = Annotated[
    _Jumps | _Motions | WithJumpsConfig | GroundAccelerationConfig | KanaiTajimiConfig | SourceVoltageConfig,
    Field(discriminator="law"),
]


# Sections of forces in a study's file: friction laws, external forces and normal forces.
#
# One class for each law, chosen by the key ``law``. To offer another, add its class here and to the union.


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


# Section ``[system]`` of structures with several contacts: by their matrices, or by a builder.
#
# The contacts of a structure are sections ``[[system.contacts]]``, one for each. The key ``contact`` says whose sticks
# are counted.


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _matrix(value: Any, info: Any) -> list[float] | list[list[float]]:
    has_rows = isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)
    rows = value if has_rows else [value]
    good = all(isinstance(row, list) and row and all(map(_is_number, row)) for row in rows)
    if not good or len({len(row) for row in rows}) > 1:
        raise ValueError(
            f"{info.field_name} must be a list of numbers, the diagonal, or a list of rows of as many numbers, but "
            f"{shown_value(value)} was given."
        )
    floats = [[float(number) for number in row] for row in rows]
    return floats if has_rows else floats[0]


def _counted(value: Any) -> int | str:
    if value == "all" or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    raise ValueError(f'contact must be the number of a contact, from 0, or "all", but {shown_value(value)} was given.')


def _two(masses: list[int]) -> list[int]:
    if len(masses) != 2:
        raise ValueError(f"between must hold the numbers of two masses, but {shown_value(masses)} was given.")
    return masses


_Matrix = Annotated[Any, AfterValidator(_matrix)]
_Counted = Annotated[Any, AfterValidator(_counted)]
_COUNTED = 'whose sticks are counted: the number of a contact, from 0, or "all" for times when all closed ones stick'
_NORMAL_FORCE = "N, or a section: a function of time, that opens the contact where it is not positive"


class ContactConfig(WithFriction):
    """A section ``[[system.contacts]]``: one contact of a structure."""

    friction_section: ClassVar[str] = "[system.contacts.friction]"

    mass: int | None = Field(default=None, ge=0, description="number of the mass, from 0, that rubs on the base")
    between: Annotated[list[int], AfterValidator(_two)] | None = Field(
        default=None, description="or numbers of two masses that rub on each other"
    )
    direction: list[float] | None = Field(default=None, description="or what each velocity adds to the relative one")
    normal_force: NormalForceConfig = Field(description=_NORMAL_FORCE)
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    on_base: float | None = Field(
        default=None, description="share of the base velocity that is subtracted; not given: 1, between masses 0"
    )

    @model_validator(mode="after")
    def _one_place(self) -> "ContactConfig":
        given = [key for key in ("mass", "between", "direction") if getattr(self, key) is not None]
        if len(given) != 1:
            what = " and ".join(given) + (" were" if given else "none was")
            raise ValueError(f"mass, between or direction must say what rubs, one of them, but {what} given.")
        return self

    def direction_in(self, size: int) -> np.ndarray:
        """Its direction in a structure of `size` masses. Raises ValueError for a mass that is none of them."""
        if self.direction is not None:
            return np.array(self.direction)
        for number in (self.mass,) if self.between is None else self.between:
            if number is None or not 0 <= number < size:
                key = "mass" if self.between is None else "between"
                masses = f"a mass from 0 to {size - 1}" if size > 1 else "mass 0, the only one"
                raise ValueError(f"{key} must name {masses}, but {number} was given.")
        first, *second = (self.mass,) if self.between is None else self.between
        units = np.eye(size)
        return units[first] - units[second[0]] if second else units[first]

    @property
    def base_share(self) -> float:
        """How much of the base velocity is subtracted."""
        if self.on_base is None:
            return 1.0 if self.between is None else 0.0
        return self.on_base

    def build(self, size: int) -> Contact:
        """The contact as the simulation takes it, in a structure of `size` masses."""
        return Contact(self.direction_in(size), force_of(self.normal_force), self.law_of_friction, self.base_share)


class StructureSection(Section):
    """A structure, one of whose contacts is counted, or all at once."""

    driven_by_voltage: ClassVar[bool] = False

    @property
    def size(self) -> int:
        """The number of its masses."""
        raise NotImplementedError("each kind has its own")


def _check_counted(contact: object, contacts: int) -> None:
    if isinstance(contact, int) and contact >= contacts:
        which = f"a contact from 0 to {contacts - 1}" if contacts > 1 else "contact 0, the only one"
        raise ValueError(f'contact must name {which}, or be "all", but {contact} was given.')


def _counting(structure: LinearStructure, contact: object) -> LinearStructure:
    return structure.of_contact(contact) if isinstance(contact, int) else structure.of_all_contacts()


class LinearStructureConfig(StructureSection):
    """Section ``[system]`` with the model `LinearStructure`, and its sections ``[[system.contacts]]``."""

    model: Literal["LinearStructure"]
    mass: _Matrix = Field(description="kg (or kg m^2): the diagonal, or rows")
    stiffness: _Matrix = Field(description="N/m (or N m/rad), likewise")
    damping: _Matrix | None = Field(default=None, description="N s/m (or N m s/rad), likewise; not given: none")
    rotates: bool = Field(default=False, description="whether positions are angles, and masses inertias")
    contact: _Counted = Field(description=_COUNTED)
    force: list[NumberOrForce] | None = Field(
        default=None, description='external force on each mass, N: a number or { law = "Harmonic", ... }'
    )
    contacts: list[ContactConfig] = Field(min_length=1, description="the contacts, a section for each")

    @property
    def size(self) -> int:
        return len(self.mass)

    @property
    def has_inner_states(self) -> bool:
        """Whether a friction law has one."""
        return any(contact.has_inner_states for contact in self.contacts)

    @model_validator(mode="after")
    def _accepted(self) -> "LinearStructureConfig":
        directions = []
        for number, contact in enumerate(self.contacts):
            try:
                directions.append(contact.direction_in(self.size))
            except ValueError as error:
                raise ValueError(f"of contacts[{number}], {error}") from None
        # Records are read when the study is run.
        contacts = tuple(Contact(direction, 1.0, Coulomb(0.0)) for direction in directions)
        force = None if self.force is None else (None,) * len(self.force)
        check_structure(self.mass, self.stiffness, self.damping, contacts, force)
        _check_counted(self.contact, len(self.contacts))
        return self

    def build(self) -> LinearStructure:
        """The system as the simulation takes it. Raises ValueError for an unsuitable record, OSError for a file that
        cannot be read.
        """
        contacts = tuple(contact.build(self.size) for contact in self.contacts)
        force = None if self.force is None else tuple(map(force_of, self.force))
        structure = LinearStructure(self.mass, self.stiffness, self.damping, contacts, force, rotates=self.rotates)
        return _counting(structure, self.contact)


class BlockRowConfig(StructureSection, WithFriction):
    """Section ``[system]`` with the model `block_row`: equal blocks in a row on the base."""

    model: Literal["block_row"]
    blocks: int = Field(ge=1, le=MOST_CONTACTS, description="number of blocks, each with a contact")
    mass: float = Field(gt=0, description="of each, kg")
    between: float = Field(ge=0, description="stiffness between neighbours, N/m")
    to_ground: float = Field(ge=0, description="stiffness from each to the ground, N/m")
    damping: float = Field(default=0.0, ge=0, description="from each to the ground, N s/m")
    normal_force: NormalForceConfig = Field(description=_NORMAL_FORCE)
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    contact: _Counted = Field(description=_COUNTED)

    @property
    def size(self) -> int:
        return self.blocks

    @model_validator(mode="after")
    def _counts_a_block(self) -> "BlockRowConfig":
        _check_counted(self.contact, self.blocks)
        return self

    def build(self) -> LinearStructure:
        """The system as the simulation takes it. Raises ValueError for an unsuitable record, OSError for a file that
        cannot be read.
        """
        row = block_row(
            self.blocks,
            mass=self.mass,
            between=self.between,
            to_ground=self.to_ground,
            normal_force=force_of(self.normal_force),
            friction=self.law_of_friction,
            damping=self.damping,
        )
        return _counting(row, self.contact)


class StoreysOnBearingConfig(StructureSection, WithFriction):
    """Section ``[system]`` with the model `storeys_on_bearing`: a building whose base mat slides on the ground."""

    model: Literal["storeys_on_bearing"]
    mass: list[float] = Field(description="of the base mat, then of the storeys, kg")
    stiffness: list[float] = Field(description="below each storey, N/m")
    damping: list[float] | None = Field(default=None, description="likewise, N s/m; not given: none")
    bearing_stiffness: float = Field(default=0.0, ge=0, description="N/m; of a pendulum bearing: weight over radius")
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    gravity: float = Field(default=STANDARD_GRAVITY, gt=0, description="m/s^2")

    @property
    def size(self) -> int:
        return len(self.mass)

    @model_validator(mode="after")
    def _accepted(self) -> "StoreysOnBearingConfig":
        self.build()
        return self

    def build(self) -> LinearStructure:
        """The system as the simulation takes it, with the bearing's sticks counted."""
        return storeys_on_bearing(
            self.mass,
            self.stiffness,
            friction=self.law_of_friction,
            damping=self.damping,
            bearing_stiffness=self.bearing_stiffness,
            gravity=self.gravity,
        ).of_contact(0)


# Section ``[system]`` of a study's file: the system, its friction law, and the force on it.
#
# One class for each system, chosen by the key ``model``. The keys are the fields of the system, with their bounds,
# units and defaults. To offer another, add its class here and to the union.


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
