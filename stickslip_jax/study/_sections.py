"""What the sections of a study's file have in common: how they are checked, told apart, and written as TOML.

Types are strict: neither the string "1" nor true is a number; nan and infinity are refused.
"""

import json
from collections.abc import Iterable, Iterator
from textwrap import wrap
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from .._excitation.random import Uniform


class Section(BaseModel):
    """A section of the file. Raises pydantic's ValidationError for unknown keys, wrong types and wrong values."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    @property
    def title(self) -> str:
        """What reports call it."""
        return tag_of(type(self))


class UniformConfig(Section):
    """An initial value drawn anew for every sample: ``{ low = 0.0, high = 1.0 }``."""

    low: float = Field(description="the lowest value")
    high: float = Field(description="the highest value")

    @model_validator(mode="after")
    def _low_below_high(self) -> "UniformConfig":
        self.build()
        return self

    def build(self) -> Uniform:
        """The value as the simulation takes it. Raises ValueError unless low is below high."""
        return Uniform(self.low, self.high)


_KEY_WIDTH, _COMMENT_WIDTH = 32, 84
NUMBER = "number"
Start = Annotated[
    Annotated[float, Tag(NUMBER)] | Annotated[UniformConfig, Tag("Uniform")],
    Discriminator(lambda value: "Uniform" if isinstance(value, (dict, UniformConfig)) else NUMBER),
]
"""An initial value: a number, or a `UniformConfig`."""


def start_value(start: Start) -> float | Uniform:
    """An initial value as the simulation takes it."""
    return start.build() if isinstance(start, UniformConfig) else start


def default_tag(key: str, name: str) -> BeforeValidator:
    """Let a table without the tag `key` mean the kind called `name`."""
    return BeforeValidator(lambda table: {key: name, **table} if isinstance(table, dict) else table)


# --- told apart


def tag_key(kind: type[Section]) -> str | None:
    """The key whose value tells sections of this `kind` from others: "law", "model", or none."""
    for key in ("law", "model"):
        if key in kind.model_fields and get_origin(kind.model_fields[key].annotation) is Literal:
            return key
    return None


def tag_of(kind: type[Section]) -> str:
    """The name by which the file calls this `kind`."""
    key = tag_key(kind)
    return kind.__name__.removesuffix("Config") if key is None else get_args(kind.model_fields[key].annotation)[0]


def kinds_in(annotation: Any) -> dict[str, type[Section]]:
    """The kinds of section that a key annotated like this may hold, by name."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return {tag_of(annotation): annotation}
    return {name: kind for part in get_args(annotation) for name, kind in kinds_in(part).items()}


def tables_of(kind: type[Section]) -> dict[str, dict[str, type[Section]]]:
    """The keys of `kind` that hold tables of their own, and the kinds of each. What is written inline is no table."""
    found = {key: kinds_in(info.annotation) for key, info in kind.model_fields.items()}
    return {key: kinds for key, kinds in found.items() if kinds and UniformConfig not in kinds.values()}


# --- written


def toml_value(value: Any) -> str:
    """A number, string, truth value, list or table of them as TOML writes it; anything else as Python does."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(toml_value(entry) for entry in value)}]"
    if isinstance(value, Section):
        return toml_value(value.model_dump())
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml_value(entry)}' for key, entry in value.items())} }}"
    return repr(value)


def toml_blocks(section: Section, name: str, choices: Iterable[str] = ()) -> Iterator[str]:
    """The table called `name` and the tables in it, with units as comments; what is not given is a comment.

    `choices`: the kinds of section that may stand here, told by the comment of its tag.
    """
    kind = type(section)
    tables, tag = tables_of(kind), tag_key(kind)
    comments = {key: str(info.description) for key, info in kind.model_fields.items() if key not in tables}
    lines = [] if tag is None else [_line(tag, tag_of(kind), one_of(choices))]
    lines += [_line(key, getattr(section, key), comment) for key, comment in comments.items() if key != tag]
    for key, kinds in tables.items():
        if getattr(section, key) is None:
            tags = f"{tag_key(next(iter(kinds.values())))}: {one_of(kinds)}"
            comment = f"{kind.model_fields[key].description}; {tags}"
            lines.append(_commented(f"# [{name}.{key}]", comment))
    yield "\n".join([f"[{name}]", *lines])
    for key, kinds in tables.items():
        if getattr(section, key) is not None:
            yield from toml_blocks(getattr(section, key), f"{name}.{key}", kinds)


def _line(key: str, value: Any, comment: str) -> str:
    written = f"# {key} =" if value is None else f"{key} = {toml_value(value)}"
    return _commented(written, comment)


def _commented(written: str, comment: str) -> str:
    first, *more = wrap(comment, _COMMENT_WIDTH)
    return "\n".join([f"{written:<{_KEY_WIDTH}}  # {first}", *(f"{'':<{_KEY_WIDTH}}  # {line}" for line in more)])


def one_of(names: Iterable[str]) -> str:
    """The names as words: "A, B or C"."""
    *most, last = names
    return f"{', '.join(most)} or {last}" if most else last
