"""Section ``[system]`` of structures with several contacts: by their matrices, or by a builder.

The contacts of a structure are sections ``[[system.contacts]]``, one for each. The key ``contact`` says whose sticks
are counted.
"""

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from .._systems.builders import STANDARD_GRAVITY, block_row, storeys_on_bearing
from .._systems.contact import Contact
from .._systems.friction import Coulomb
from .._systems.structure import LinearStructure
from .._systems.structure_checks import MOST_CONTACTS, check_structure
from ._forces_config import FRICTION, MU, FrictionConfig, NormalForceConfig, NumberOrForce, WithFriction, force_of
from ._sections import Section, shown_value


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
