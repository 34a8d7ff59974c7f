"""Sections ``[system]``, ``[base]`` and those of forces in a study's file."""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union

import jax.numpy as jnp
import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from .._excitation import gaussian, piecewise_constant
from .._excitation.excitation import WithJumps
from .._excitation.motion import Harmonic, RandomPhase, Signal, SourceVoltage, SumOfHarmonics
from .._excitation.recorded import ForceSteps
from .._systems.builders import STANDARD_GRAVITY, block_row, friction_pendulum, storeys_on_bearing
from .._systems.contacts import Contact
from .._systems.dynamic_friction import BoucWen, Dahl, DieterichRuina, ElastoPlastic, LuGre
from .._systems.friction import (
    Ageing,
    Coulomb,
    ExponentialGrowth,
    LogarithmicGrowth,
    Stribeck,
    VelocityDependent,
    VelocityWeakening,
)
from .._systems.mass_spring import MassSpring
from .._systems.memory_models import SlipWeakening
from .._systems.motor_cart import USUAL_MU, MotorCart
from .._systems.places import Directional, FrictionByPlace, OneWay
from .._systems.structure import MOST_CONTACTS, LinearStructure, check_structure
from .._uncertainty import families
from ._sections import (
    NUMBER,
    BuiltSection,
    DescribedSection,
    GroundAccelerationConfig,
    RecordedConfig,
    Section,
    about,
    default_tag,
    is_number,
    key_of,
    refused,
    section_of,
    tag_of,
    value_of,
)

# A law is chosen by the key ``law`` of its section. The keys are the fields of the law, with their bounds, units and
# defaults. To offer another law, add its class to one of the lists that `_laws` takes; only one whose keys are not its
# fields needs more. A distribution, a spectrum or a law within a law is a section of its own, ``[base.gap]``.


def _laws(*classes: type, **options: Any) -> tuple[Any, ...]:
    """The sections of these classes, which are told apart by the key ``law``."""
    return tuple(section_of(each, "law", **options) for each in classes)


def _any_of(kinds: tuple[Any, ...], *, tag: str = "law", usual: str = "") -> Any:
    """The type of a key that holds one of these kinds of section; one without the key `tag` is the `usual` kind."""
    kind = Annotated[Union[kinds], Field(discriminator=tag)]  # noqa: UP007 - of a tuple
    return Annotated[kind, default_tag(tag, usual)] if usual else kind


# --- distributions and spectra

_POSITIVE = _laws(
    families.Exponential, families.Weibull, families.LogNormal, families.Uniform, families.Triangular, families.Discrete
)
_SPECTRA = _laws(gaussian.KanaiTajimiSpectrum, gaussian.CloughPenzienSpectrum, gaussian.TabulatedSpectrum)
_VELOCITY_SPECTRUM = section_of(
    gaussian.VelocitySpectrum,
    "law",
    base=BuiltSection,
    acceleration=(_any_of(_SPECTRA), "spectrum of the acceleration"),
)
if TYPE_CHECKING:
    _GapConfig = Any
    _SpeedsConfig = Any
    _SpectrumConfig = Any
else:
    _GapConfig, _SpeedsConfig = _any_of(_POSITIVE), _any_of((*_POSITIVE, *_laws(families.Normal)))
    _SpectrumConfig = _any_of((*_SPECTRA, _VELOCITY_SPECTRUM))

# --- Section ``[base]`` of a study's file: the excitation.


class PiecewiseConstantConfig(section_of(piecewise_constant.PiecewiseConstant, "law", base=BuiltSection)):
    """Section ``[base]`` with the law `PiecewiseConstant`."""

    @model_validator(mode="after")
    def _times_fit(self) -> "PiecewiseConstantConfig":
        # Lists, which the law keeps as NumPy arrays: arrays of JAX would start it before its settings are known.
        piecewise_constant.PiecewiseConstant(self.times, self.velocities)
        return self

    def build(self) -> piecewise_constant.PiecewiseConstantLaw:
        """The law as the simulation takes it (starts JAX). Raises ValueError for times that are equal in float32."""
        return piecewise_constant.PiecewiseConstant(jnp.asarray(self.times), jnp.asarray(self.velocities))


class _Phased(DescribedSection):
    """A law whose phase may be random."""

    random_phase: bool = about("whether each sample draws its phase; not given: true, unless a phase is given", True)

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
        signal = self.described_class(**self.arguments("random_phase"))
        return RandomPhase(signal) if self.random_phase else signal


_ABOUT_PHASE = about("rad; not given: 0, or drawn", None)
_PHASED: dict[str, Any] = {"base": _Phased, "phase": (float | None, _ABOUT_PHASE)}
SourceVoltageConfig = section_of(SourceVoltage, "law", **_PHASED)
"""Section ``[base]`` with the law `SourceVoltage`, which drives a `MotorCart`."""


class SemiMarkovSwitchingConfig(DescribedSection):
    """Section ``[base]`` with the law `SemiMarkovSwitching`, and its sections ``[base.gap]`` and ``[base.speeds]``."""

    law: Literal["SemiMarkovSwitching"]
    speed: float | None = about("m/s; not given: the section speeds", None, gt=0)
    alternating: bool = about("whether the sign alternates, or is that of each speed", True)
    first_sign: Literal["random", "positive", "negative"] = about(
        "of the velocity, where signs alternate: random, positive or negative", "random"
    )
    gap: _GapConfig = about("distribution of the time between switches, s")
    speeds: _SpeedsConfig | None = about("distribution of the speeds, m/s, in place of speed", None)

    def build(self) -> piecewise_constant.SemiMarkovSwitching:
        """The law as the simulation takes it. Raises ValueError for distributions of numbers that do not fit."""
        if (self.speed is None) == (self.speeds is None):
            raise ValueError("speed must be given, or a section speeds, and not both.")
        speed = value_of(self.speed if self.speeds is None else self.speeds)
        return piecewise_constant.SemiMarkovSwitching(speed=speed, **self.arguments("speed", "speeds"))


class _WithSpectrum(DescribedSection):
    """A law with a spectrum."""

    harmonics: int = about("number of harmonics of a sample", 128, ge=1)
    spectrum: _SpectrumConfig = about("one-sided power spectral density over angular frequency")


_JUMPS = (
    section_of(piecewise_constant.PoissonSwitching, "law", {"speed": 1.0, "rate": 1.0}),
    SemiMarkovSwitchingConfig,
    *_laws(piecewise_constant.SquareWave, piecewise_constant.RandomSteps, piecewise_constant.Constant),
    PiecewiseConstantConfig,
)
_MOTIONS = (
    section_of(Harmonic, "law", signal_unit="m/s", **_PHASED),
    section_of(SumOfHarmonics, "law", signal_unit="m/s", base=_Phased, phases=(list[float] | None, _ABOUT_PHASE)),
    section_of(gaussian.GaussianProcess, "law", base=_WithSpectrum),
    RecordedConfig,
)


class _WithJumps(BuiltSection):
    """A motion and jumps."""

    if TYPE_CHECKING:
        motion: Section
        jumps: Section

    @property
    def title(self) -> str:
        """Its name in reports."""
        return f"{self.motion.title} with jumps by {self.jumps.title}"


_WITH_JUMPS = section_of(
    WithJumps,
    "law",
    base=_WithJumps,
    motion=(_any_of(_MOTIONS), "the continuous part"),
    jumps=(_any_of(_JUMPS, usual="PoissonSwitching"), "the part that jumps"),
)
_BASES = (*_JUMPS, *_MOTIONS, _WITH_JUMPS, GroundAccelerationConfig, *_laws(gaussian.KanaiTajimi), SourceVoltageConfig)


# --- sections of forces: friction laws, external forces and normal forces

_OF_SPEED = _laws(Coulomb, VelocityWeakening, VelocityDependent, Stribeck)
_GROWTHS = _laws(ExponentialGrowth, LogarithmicGrowth)
_WEAKENING = _laws(SlipWeakening)
_WITH_INNER_STATE = _laws(LuGre, ElastoPlastic, Dahl, BoucWen, DieterichRuina)
_AGEING = section_of(
    Ageing,
    "law",
    base=BuiltSection,
    slip=(_any_of(_OF_SPEED, usual="Coulomb"), "friction law of slips, and of sticks that have just begun"),
    growth=(_any_of(_GROWTHS), "what is added to static friction while a stick lasts"),
)
_ONE_WAY = _any_of((*_OF_SPEED, _AGEING), usual="Coulomb")
_DIRECTIONAL = section_of(
    Directional,
    "law",
    base=BuiltSection,
    forward=(_ONE_WAY, "friction law of slips with a positive relative velocity"),
    backward=(_ONE_WAY, "that of negative ones"),
)
_HELD = section_of(OneWay, "law", base=BuiltSection, forward=(_ONE_WAY, "friction law of slips, all of them forward"))


class FrictionByPlaceConfig(
    section_of(
        FrictionByPlace,
        "law",
        places=(list[float], "where the friction jumps, m, increasing"),
        laws=(list[_any_of(_OF_SPEED, usual="Coulomb")], "friction laws of the regions between, a section each"),
        on=(Literal["base", "ground"], Field(default="base", description="what the places are marked on")),
    )
):
    """Piecewise uniform friction: each region is a section ``[[system.friction.laws]]``."""

    def arguments(self, *left_out: str) -> dict[str, Any]:
        given = super().arguments("laws", *left_out)
        return given | {"places": tuple(given["places"]), "laws": tuple(map(value_of, self.laws))}


_FORCES = (*_laws(Harmonic, SumOfHarmonics, signal_unit="N"), RecordedConfig, *_laws(ForceSteps))


def _number_or(number: Any, kinds: tuple[Any, ...]) -> Any:
    """The type of a key that holds a `number`, or one of these kinds of section."""

    def which(value: object) -> str | None:
        if isinstance(value, dict):
            return value.get("law")
        return tag_of(type(value)) if isinstance(value, Section) else NUMBER

    tagged = (Annotated[number, Tag(NUMBER)], *(Annotated[kind, Tag(tag_of(kind))] for kind in kinds))
    return Annotated[Union[tagged], Discriminator(which)]  # noqa: UP007 - of a tuple


if TYPE_CHECKING:
    BaseConfig = Any
    FrictionConfig = Any
    ForceConfig = Any
    NormalForceConfig = Any
else:
    BaseConfig = _any_of(_BASES)
    FrictionConfig = _any_of(
        (*_OF_SPEED, _DIRECTIONAL, _HELD, _AGEING, FrictionByPlaceConfig, *_WEAKENING, *_WITH_INNER_STATE),
        usual="Coulomb",
    )
    ForceConfig = _number_or(float, _FORCES)
    """An external force, N: a number, or a function of time."""
    NormalForceConfig = _number_or(Annotated[float, Field(gt=0)], _FORCES)
    """A normal force, N: a number, or a function of time."""

_, MU = key_of(Coulomb, "mu", default=None, description="friction coefficient (Coulomb), or a section friction")
FRICTION = about("friction law in place of mu", None)


class WithFriction(BuiltSection):
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
    def has_inner_states(self) -> bool:
        """Whether the friction law has one."""
        return isinstance(self.friction, _WITH_INNER_STATE)

    def arguments(self, *left_out: str) -> dict[str, Any]:
        given = super().arguments("mu", *left_out)
        return given if self.mu is None else {**given, "friction": Coulomb(self.mu)}


# --- section ``[system]`` of structures with several contacts: by their matrices, or by a builder
#
# The contacts of a structure are sections ``[[system.contacts]]``, one for each. The key ``contact`` says whose sticks
# are counted.


def _matrix(value: Any, info: Any) -> list[float] | list[list[float]]:
    has_rows = isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)
    rows = value if has_rows else [value]
    good = all(isinstance(row, list) and row and all(map(is_number, row)) for row in rows)
    if not good or len({len(row) for row in rows}) > 1:
        demand = "be a list of numbers, the diagonal, or a list of rows of as many numbers"
        raise refused(info.field_name, demand, value)
    floats = [[float(number) for number in row] for row in rows]
    return floats if has_rows else floats[0]


def _counted(value: Any) -> int | str:
    if value == "all" or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    raise refused("contact", 'be the number of a contact, from 0, or "all"', value)


def _two(masses: list[int]) -> list[int]:
    if len(masses) != 2:
        raise refused("between", "hold the numbers of two masses", masses)
    return masses


_Matrix = Annotated[Any, AfterValidator(_matrix)]
_Counted = Annotated[Any, AfterValidator(_counted)]
_COUNTED = 'whose sticks are counted: the number of a contact, from 0, or "all" for times when all closed ones stick'
_NORMAL_FORCE = "N, or a section: a function of time, that opens the contact where it is not positive"


class ContactConfig(WithFriction):
    """A section ``[[system.contacts]]``: one contact of a structure."""

    friction_section: ClassVar[str] = "[system.contacts.friction]"

    mass: int | None = about("number of the mass, from 0, that rubs on the base", None, ge=0)
    between: Annotated[list[int], AfterValidator(_two)] | None = about(
        "or numbers of two masses that rub on each other", None
    )
    direction: list[float] | None = about("or what each velocity adds to the relative one", None)
    normal_force: NormalForceConfig = about(_NORMAL_FORCE)
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    on_base: float | None = about("share of the base velocity that is subtracted; not given: 1, between masses 0", None)
    series_stiffness: float | None = about("N/m, of a spring in front of the contact; not given: none", None, gt=0)
    normal_stiffness: list[float] | None = about("N/m, growth of the normal force with each position", None)
    radius: float | None = about("m, of a pendulum bearing; not given: a flat contact", None, gt=0)

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
        masses: Any
        key, masses = ("mass", (self.mass,)) if self.between is None else ("between", self.between)
        for number in masses:
            if number is None or not 0 <= number < size:
                allowed = f"a mass from 0 to {size - 1}" if size > 1 else "mass 0, the only one"
                raise ValueError(f"{key} must name {allowed}, but {number} was given.")
        first, *second = np.eye(size)[list(masses)]
        return first - second[0] if second else first

    def contact_in(self, size: int) -> Contact:
        """The contact as the simulation takes it, in a structure of `size` masses."""
        usual: dict[str, Any] = {"on_base": 1.0 if self.between is None else 0.0}
        return Contact(self.direction_in(size), **usual | self.arguments("mass", "between", "direction"))


class StructureSection(Section):
    """A structure, one of whose contacts is counted, or all at once. `maker`: the class or function that makes it."""

    maker: ClassVar[Any]
    driven_by_voltage: ClassVar[bool] = False

    if TYPE_CHECKING:  # a number for each of the masses
        mass: Any

    @property
    def size(self) -> int:
        """The number of its masses."""
        return len(self.mass)

    def build(self) -> LinearStructure:
        structure = self.maker(**self.arguments("contact"))
        contact = getattr(self, "contact", 0)  # of storeys the bearing
        return structure.of_contact(contact) if isinstance(contact, int) else structure.of_all_contacts()


def _check_counted(contact: object, contacts: int) -> None:
    if isinstance(contact, int) and contact >= contacts:
        which = f"a contact from 0 to {contacts - 1}" if contacts > 1 else "contact 0, the only one"
        raise ValueError(f'contact must name {which}, or be "all", but {contact} was given.')


class LinearStructureConfig(StructureSection):
    """Section ``[system]`` with the model `LinearStructure`, and its sections ``[[system.contacts]]``."""

    maker: ClassVar[Any] = LinearStructure

    model: Literal["LinearStructure"]
    mass: _Matrix = about("kg (or kg m^2): the diagonal, or rows")
    stiffness: _Matrix = about("N/m (or N m/rad), likewise")
    damping: _Matrix | None = about("N s/m (or N m s/rad), likewise; not given: none", None)
    rotates: bool = about("whether positions are angles, and masses inertias", False)
    contact: _Counted = about(_COUNTED)
    force: list[ForceConfig] | None = about(
        'external force on each mass, N: a number or { law = "Harmonic", ... }', None
    )
    contacts: list[ContactConfig] = about("the contacts, a section for each", min_length=1)

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

    def arguments(self, *left_out: str) -> dict[str, Any]:
        given = super().arguments("contacts", "force", *left_out)
        if self.force is not None:
            given["force"] = tuple(map(value_of, self.force))
        return {**given, "contacts": tuple(contact.contact_in(self.size) for contact in self.contacts)}


class BlockRowConfig(StructureSection, WithFriction):
    """Section ``[system]`` with the model `block_row`: equal blocks in a row on the base."""

    maker: ClassVar[Any] = staticmethod(block_row)

    model: Literal["block_row"]
    blocks: int = about("number of blocks, each with a contact", ge=1, le=MOST_CONTACTS)
    mass: float = about("of each, kg", gt=0)
    between: float = about("stiffness between neighbours, N/m", ge=0)
    to_ground: float = about("stiffness from each to the ground, N/m", ge=0)
    damping: float = about("from each to the ground, N s/m", 0.0, ge=0)
    normal_force: NormalForceConfig = about(_NORMAL_FORCE)
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    contact: _Counted = about(_COUNTED)

    @property
    def size(self) -> int:
        return self.blocks

    @model_validator(mode="after")
    def _counts_a_block(self) -> "BlockRowConfig":
        _check_counted(self.contact, self.blocks)
        return self


_RADIUS = about("m, of a pendulum bearing; not given: a flat one", None, gt=0)
_VERTICAL = about("acceleration of the ground upward, m/s^2, a section like [base]", None)


class StoreysOnBearingConfig(StructureSection, DescribedSection, WithFriction):
    """Section ``[system]`` with the model `storeys_on_bearing`: a building whose base mat slides on the ground."""

    maker: ClassVar[Any] = staticmethod(storeys_on_bearing)

    model: Literal["storeys_on_bearing"]
    mass: list[float] = about("of the base mat, then of the storeys, kg")
    stiffness: list[float] = about("below each storey, N/m")
    damping: list[float] | None = about("likewise, N s/m; not given: none", None)
    bearing_stiffness: float = about("N/m; of a pendulum bearing: weight over radius", 0.0, ge=0)
    radius: float | None = _RADIUS
    vertical: GroundAccelerationConfig | None = _VERTICAL
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    gravity: float = about("m/s^2", STANDARD_GRAVITY, gt=0)


class FrictionPendulumConfig(StructureSection, DescribedSection, WithFriction):
    """Section ``[system]`` with the model `friction_pendulum`: a mass on a pendulum bearing, or on a flat slider."""

    maker: ClassVar[Any] = staticmethod(friction_pendulum)

    model: Literal["friction_pendulum"]
    mass: float = about("kg", gt=0)
    radius: float | None = _RADIUS
    vertical: GroundAccelerationConfig | None = _VERTICAL
    mu: float | None = MU
    friction: FrictionConfig | None = FRICTION
    gravity: float = about("m/s^2", STANDARD_GRAVITY, gt=0)

    @property
    def size(self) -> int:
        return 1

    def arguments(self, *left_out: str) -> dict[str, Any]:
        return {"radius": None, **super().arguments(*left_out)}


# --- section ``[system]`` of a study's file: the system, its friction law, and the force on it
#
# One class for each system, chosen by the key ``model``. The keys are the fields of the system, with their bounds,
# units and defaults. To offer another, add its class here and to the union.


_USUAL = {"mass": 1.0, "stiffness": 4.0, "normal_force": 1.0, "damping": 0.0}
# At 1 the mean number of sticks has no derivative by these numbers (docs/sensitivity.md).
_, _MU = key_of(Coulomb, "mu", default=0.8, description="friction coefficient (Coulomb), or [system.friction]")


class MassSpringConfig(section_of(MassSpring, "model", _USUAL, base=WithFriction)):
    """Section ``[system]`` with the model `MassSpring`: a mass on a spring."""

    driven_by_voltage: ClassVar[bool] = False
    mu: float | None = _MU
    friction: FrictionConfig | None = FRICTION
    force: ForceConfig | None = about("external force on the mass, N", None)


_, _CART_MU = key_of(MotorCart, "mu", default=USUAL_MU)


class MotorCartConfig(section_of(MotorCart, "model", base=WithFriction)):
    """Section ``[system]`` with the model `MotorCart`: a cart driven by a motor; the defaults are the paper's."""

    driven_by_voltage: ClassVar[bool] = True
    mu: float | None = _CART_MU
    friction: FrictionConfig | None = FRICTION

    def arguments(self, *left_out: str) -> dict[str, Any]:
        return Section.arguments(self, *left_out)  # mu is one of the cart itself


if TYPE_CHECKING:
    SystemConfig = Any
else:
    SystemConfig = _any_of(
        (
            MassSpringConfig,
            MotorCartConfig,
            LinearStructureConfig,
            BlockRowConfig,
            StoreysOnBearingConfig,
            FrictionPendulumConfig,
        ),
        tag="model",
        usual="MassSpring",
    )
