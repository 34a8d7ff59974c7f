"""The sections of a study's file in general: how they are checked, distinguished, and written; records in them."""

import dataclasses
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo

from .._excitation.motion import SIGNAL_UNIT
from .._excitation.reading import STANDARD_GRAVITY, read_at2, read_csv
from .._excitation.recorded import GroundAcceleration, Recorded
from .._foundation.checks import LARGEST, one_of
from .._foundation.fields import Choice, Quantity, described
from .._uncertainty.families import Uniform

# The sections of a study's file in general: how they are checked, distinguished, and written as TOML.
#
# Types are strict: neither the string "1" nor true is a number; nan and infinity are refused.


class Section(BaseModel):
    """A section of the file. Raises pydantic's ValidationError for unknown keys, wrong types and wrong values."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    @property
    def title(self) -> str:
        """Its name in reports."""
        return tag_of(type(self))

    def arguments(self, *left_out: str) -> dict[str, Any]:
        """What its keys hold, as the simulation takes it, by the names of fields; without the tag, the keys that are
        `left_out`, and those without a value.
        """
        keys = [key for key in type(self).model_fields if key not in (tag_key(type(self)), *left_out)]
        given = {key: getattr(self, key) for key in keys}
        return {FIELDS.get(key, key): value_of(value) for key, value in given.items() if value is not None}


def about(meaning: str, default: Any = ..., **bounds: Any) -> Any:
    """A key of a section, with its `meaning` for comments; without a `default` it must be given."""
    return Field(default, description=meaning, **bounds)


FIELDS = {"slip": "law"}
"""The fields that are called otherwise than their keys, by key."""


class BuiltSection(Section):
    """A section whose keys are the fields of the class `described_class` (`section_of`)."""

    described_class: ClassVar[Any]

    def build(self) -> Any:
        """The system or law as the simulation takes it.

        Raises ValueError for values that do not fit together and unsuitable records, OSError for a file that cannot
        be read.
        """
        return self.described_class(**self.arguments())


class DescribedSection(BuiltSection):
    """The same, whose values are checked by the class."""

    @model_validator(mode="after")
    def _accepted(self) -> "DescribedSection":
        self.build()
        return self


def value_of(value: Any) -> Any:
    """The value of a key as the simulation takes it: of a section what it describes, else itself.

    Raises ValueError for an unsuitable record, OSError for a file that cannot be read.
    """
    return value.build() if hasattr(value, "build") else value


def section_of(
    described_class: type,
    tag: str = "",
    defaults: Mapping[str, object] | None = None,
    *,
    signal_unit: str = "",
    base: type[Section] = DescribedSection,
    **keys: tuple[Any, Any],
) -> Any:
    """A section with one key for each field of `described_class` that has a `Quantity` or a `Choice`.

    Bounds, unit, meaning and default of each key are the field's.

    - `tag`: the key that holds the name of the class, "law" or "model"; "" for none.
    - `defaults`: those that a study has in place of the fields' own.
    - `signal_unit`: the unit of what is a base velocity or a force, known by the place of the section.
    - `base`: the class of the section.
    - `keys`: type and meaning (or pydantic field) of further keys, which stand before the fields', or in place of one.
    """
    known, name = described(described_class), described_class.__name__
    changed = {key: {"default": value} for key, value in (defaults or {}).items()}
    usual = {key: key_of(described_class, key, signal_unit=signal_unit, **changed.get(key, {})) for key in known}
    own = {name: (kind, about(of) if isinstance(of, str) else of) for name, (kind, of) in keys.items()}
    further: dict[str, Any] = {tag: (Literal[name], name)} if tag else {}
    further |= {key: value for key, value in own.items() if key not in known}
    all_keys: dict[str, Any] = {**further, **usual, **own}
    section: Any = create_model(f"{name}Config", __base__=base, **all_keys)
    section.described_class = described_class
    # Pickle finds a class by its name in its module; two may have one name, such as forces and velocities by a signal.
    section.__qualname__ = f"{name}Config"
    while section.__qualname__ in globals():
        section.__qualname__ += "_"
    globals()[section.__qualname__] = section
    return section


def key_of(described_class: type, name: str, *, signal_unit: str = "", **changed: Any) -> tuple[Any, Any]:
    """Type and pydantic field of the key for the field `name` of `described_class`.

    `changed`: arguments of pydantic's Field, such as ``default``, in place of what follows from the field.
    """
    about = described(described_class)[name]
    if isinstance(about, Quantity) and about.unit == SIGNAL_UNIT and signal_unit:
        about = dataclasses.replace(about, unit=signal_unit)
    default = {field.name: field.default for field in dataclasses.fields(described_class)}[name]
    options = {} if default is dataclasses.MISSING else {"default": default}
    options |= {"description": about.description, **changed}
    if isinstance(options.get("default"), tuple):
        options["default"] = list(options["default"])
    kind: Any = float
    if isinstance(about, Choice):
        kind = Literal[about.options]
    elif about.ndim:
        kind = list[float]
        options |= {} if "default" in options else {"min_length": 1}
    else:
        options |= {"gt": about.above, "ge": about.at_least, "lt": about.below}
    optional = "default" in options and options["default"] is None
    return (kind | None if optional else kind), Field(**options)


class UniformConfig(section_of(Uniform)):
    """A random initial value, drawn for every sample: ``{ low = 0.0, high = 1.0 }``."""


_KEY_WIDTH, _COMMENT_WIDTH = 32, 84
NUMBER = "number"
Start = Annotated[
    Annotated[float, Tag(NUMBER)] | Annotated[UniformConfig, Tag("Uniform")],
    Discriminator(lambda value: "Uniform" if isinstance(value, (dict, UniformConfig)) else NUMBER),
]
"""An initial value: a number, or a `UniformConfig`."""


def default_tag(key: str, name: str) -> BeforeValidator:
    """Reads a table without the tag `key` as the kind called `name`."""
    return BeforeValidator(lambda table: {key: name, **table} if isinstance(table, dict) else table)


def is_number(value: object) -> bool:
    """Whether it is a number of a size that can be computed with."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST


def nearest(name: str, known: Iterable[str], *, before: str = "; ", cutoff: float = 0.6) -> str:
    """A question for the one of the names `known` that was probably meant by `name`, or ""."""
    by_lower_case = {candidate.lower(): candidate for candidate in known}
    found = get_close_matches(name.lower(), by_lower_case, n=1, cutoff=cutoff)
    return f"{before}did you mean {by_lower_case[found[0]]}?" if found else ""


# --- kinds


def tag_key(kind: type[Section]) -> str | None:
    """The key whose value names the `kind` of section, "law" or "model"; None if there is only one kind."""
    for key in ("law", "model"):
        if key in kind.model_fields and get_origin(kind.model_fields[key].annotation) is Literal:
            return key
    return None


def tag_of(kind: type[Section]) -> str:
    """The name of this `kind` in the file."""
    key = tag_key(kind)
    return kind.__name__.removesuffix("Config") if key is None else get_args(kind.model_fields[key].annotation)[0]


def kinds_in(annotation: object) -> dict[str, type[Section]]:
    """The kinds of section that a key with this annotation may hold, by name."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return {tag_of(annotation): annotation}
    return {name: kind for part in get_args(annotation) for name, kind in kinds_in(part).items()}


def tables_of(kind: type[Section]) -> dict[str, dict[str, type[Section]]]:
    """The keys of `kind` that are sections of their own, and the kinds of each; inline tables are none."""
    found = {key: kinds_in(info.annotation) for key, info in kind.model_fields.items()}
    return {key: kinds for key, kinds in found.items() if kinds and UniformConfig not in kinds.values()}


# --- written


def toml_value(value: object) -> str:
    """A number, string, truth value, list or table of them in TOML; anything else as Python shows it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(toml_value(entry) for entry in value)}]"
    if isinstance(value, Section):
        return toml_value(value.model_dump(exclude_none=True))
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{_toml_key(key)} = {toml_value(entry)}' for key, entry in value.items())} }}"
    return repr(value)


def refused(name: str, demand: str, value: object, end: str = ".") -> ValueError:
    """The exception for the `value` of the key `name`, which is to "be positive", say; a long value is cut."""
    text = toml_value(value)
    shown = text if len(text) <= 60 else text[:57] + "..."
    return ValueError(f"{name} must {demand}, but {shown} was given{end}")


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_value(key)


def toml_blocks(
    section: Section, name: str, choices: Iterable[str] = (), *, one_of_many: bool = False
) -> Iterator[str]:
    """The section called `name` and the sections in it, with units as comments; keys without a value are comments.

    - `choices`: the kinds of section that may stand here, listed in the comment of the tag.
    - `one_of_many`: whether it is one of several of this name.
    """
    kind = type(section)
    tables, tag = tables_of(kind), tag_key(kind)
    inner = {key: _sections_in(getattr(section, key)) for key in tables}
    lines = [] if tag is None else [_line(tag, tag_of(kind), one_of(choices))]
    for key, info in kind.model_fields.items():
        value = getattr(section, key)
        if key not in tables or (value is not None and not inner[key]) or (value is None and _holds_list(info)):
            lines += [_line(key, value, str(info.description))] if key != tag else []
    lines += [f"{_toml_key(key)} = {toml_value(value)}" for key, value in (section.model_extra or {}).items()]
    for key, kinds in tables.items():
        if getattr(section, key) is None and not _holds_list(kind.model_fields[key]):
            tags = f"{tag_key(next(iter(kinds.values())))}: {one_of(kinds)}"
            comment = f"{kind.model_fields[key].description}; {tags}"
            lines.append(_commented(f"# [{name}.{key}]", comment))
    yield "\n".join([f"[[{name}]]" if one_of_many else f"[{name}]", *lines])
    for key, kinds in tables.items():
        for each in inner[key]:
            many = isinstance(getattr(section, key), list)
            yield from toml_blocks(each, f"{name}.{key}", kinds, one_of_many=many)


def _sections_in(value: object) -> list[Section]:
    """The sections that a key holds, one or a list of nothing else; none where it has another value."""
    values = value if isinstance(value, list) else [value]
    sections = [one for one in values if isinstance(one, Section)]
    return sections if len(sections) == len(values) else []


def _holds_list(info: FieldInfo) -> bool:
    return any(get_origin(part) is list for part in (info.annotation, *get_args(info.annotation)))


def _line(key: str, value: object, comment: str) -> str:
    written = f"# {key} =" if value is None else f"{key} = {toml_value(value)}"
    return _commented(written, comment)


def _commented(written: str, comment: str) -> str:
    first, *more = wrap(comment, _COMMENT_WIDTH)
    return "\n".join([f"{written:<{_KEY_WIDTH}}  # {first}", *(f"{'':<{_KEY_WIDTH}}  # {line}" for line in more)])


# Records in a study: signals at given times, given in the configuration or read from a file.


_WHITE_SPACE = "whitespace"


def _existing(file: str, info: Any) -> str:
    """The absolute path of `file`, which is relative to the folder of the configuration."""
    folder = Path((info.context or {}).get("folder", "."))
    try:
        path = folder.joinpath(Path(file).expanduser()).absolute()
    except RuntimeError:  # ~ of a user who has no home
        path = folder.joinpath(file).absolute()
    if not path.is_file():
        raise ValueError(
            f"file must be the name of a file that exists, but {toml_value(file)} was given; the folder looked in is "
            f"{path.parent}."
        )
    return str(path)


def _column(value: object, info: Any) -> int | str:
    if isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    demand = "be the number of a column, counted from 0, or its name in quotation marks"
    raise refused(info.field_name, demand, value)


def _delimiter(value: str) -> str:
    if value != _WHITE_SPACE and (len(value) != 1 or value in '"\r\n'):
        raise refused("delimiter", f'be a single character or "{_WHITE_SPACE}"', value)
    return value


_File = Annotated[str, AfterValidator(_existing)]
_Column = Annotated[object, AfterValidator(_column)]
_TABLE_ONLY = ("time_column", "value_column", "delimiter", "shift")
"""Keys that only tables have."""


class _FromFile(Section):
    """Keys that say how to read a file; None leaves the choice to the reader."""

    time_column: _Column | None = about("the times' column: its number, counted from 0, or name; not given: 0", None)
    value_column: _Column | None = about("the values' column, likewise; not given: 1", None)
    delimiter: Annotated[str, AfterValidator(_delimiter)] | None = about(
        f'character between columns, or "{_WHITE_SPACE}"; not given: a comma', None
    )
    shift: bool | None = about("whether to subtract the first time from all; not given: false", None)
    scale: float | None = about("what the values in the file are multiplied by; not given: 1", None)

    def _refuse(self, keys: Iterable[str], reason: str) -> None:
        for key in keys:
            if getattr(self, key) is not None:
                raise refused(key, "be left out", getattr(self, key), f": {reason}.")

    def _read(self, file: str) -> tuple[np.ndarray, np.ndarray]:
        """Times (s) and values of the table. Raises ValueError if they are unsuitable, OSError if it cannot be read."""
        chosen = {key: getattr(self, key) for key in (*_TABLE_ONLY, "scale") if getattr(self, key) is not None}
        if self.delimiter == _WHITE_SPACE:
            chosen["delimiter"] = None
        return read_csv(file, **chosen)


class RecordedConfig(_FromFile):
    """A recorded signal: ``file``, or ``times`` and ``values``."""

    law: Literal["Recorded"]
    file: _File | None = about("table (CSV) with a row for each time; or times and values", None)
    times: list[float] | None = about("s, increasing; the first is 0", None)
    values: list[float] | None = about("m/s for a base velocity, N for a force", None)

    @model_validator(mode="after")
    def _one_source(self) -> "RecordedConfig":
        inline = self.times is not None and self.values is not None
        if (self.file is None) != inline or (self.times is None) != (self.values is None):
            raise ValueError("a Recorded needs either file, or times and values.")
        if inline:
            self._refuse((*_TABLE_ONLY, "scale"), "it says how to read a file, and none is given")
            self.build()
        return self

    def build(self) -> Recorded:
        """The signal for the simulation.

        Raises ValueError for an unsuitable record, OSError for a file that cannot be read.
        """
        return Recorded(self.times, self.values) if self.file is None else Recorded(*self._read(self.file))


class GroundAccelerationConfig(_FromFile):
    """Section ``[base]`` with a recorded ground acceleration: an AT2 file, or a table (CSV)."""

    law: Literal["GroundAcceleration"]
    file: _File = about("AT2 file of the PEER NGA database, or table (CSV) of times in s and m/s^2")
    scale: float | None = about(
        f"factor of the accelerations ({STANDARD_GRAVITY} for a table in g); not given: 1", None
    )

    @model_validator(mode="after")
    def _keys_fit(self) -> "GroundAccelerationConfig":
        if self._is_at2:
            self._refuse(_TABLE_ONLY, "it says how to read a table, and the file is an AT2 file")
        return self

    @property
    def _is_at2(self) -> bool:
        return Path(self.file).suffix.lower() == ".at2"

    def build(self) -> GroundAcceleration:
        """The ground motion for the simulation.

        Raises ValueError for an unsuitable record, OSError for a file that cannot be read.
        """
        if not self._is_at2:
            return GroundAcceleration(*self._read(self.file))
        record = read_at2(self.file)
        return record if self.scale is None else GroundAcceleration(record.times, self.scale * record.accelerations)
