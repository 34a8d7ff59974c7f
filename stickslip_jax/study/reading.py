"""From a TOML file and the command's options to a `StudyConfig`; every mistake becomes one sentence."""

import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from .config import BaseConfig, StudyConfig, toml_value
from .errors import StudyError

OPTIONS = {
    "samples": ("run", "samples"),
    "seed": ("run", "seed"),
    "t1": ("run", "t1"),
    "threads": ("run", "threads"),
    "chunk": ("run", "chunk"),
    "out": ("output", "directory"),
    "figures": ("output", "figures"),
}
"""The section and key that each option of the command replaces."""

_LAWS = {law.model_fields["law"].annotation.__args__[0]: law for law in get_args(get_args(BaseConfig)[0])}


def read_config(path: Path | None = None, options: Mapping[str, Any] | None = None) -> StudyConfig:
    """The study in the TOML file `path` (None: the default study), with `options` (keys of `OPTIONS`) put in.

    Raises StudyError for a file that is missing, is no TOML, or holds unknown keys or unsuitable values, and for
    unsuitable options.
    """
    table = {} if path is None else _parse(path)
    config = _validated(table, f"{path}: ", {})
    given = {option: value for option, value in (options or {}).items() if value is not None}
    for option, value in given.items():
        section, key = OPTIONS[option]
        table = {**table, section: {**table.get(section, {}), key: value}}
    return _validated(table, "", {OPTIONS[option]: option for option in given}) if given else config


def _parse(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StudyError(f"{path}: no such file; `stickslip study --print-config` prints one to start from.") from None
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}).") from None
    except UnicodeDecodeError:
        raise StudyError(f"{path}: is not a text file in UTF-8.") from None
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{path}: is not valid TOML ({error}).") from None


def _validated(table: dict[str, Any], source: str, options: Mapping[tuple[str, str], str]) -> StudyConfig:
    try:
        return StudyConfig.model_validate(table)
    except ValidationError as error:
        # A misspelt key shows as unknown and, often, also as missing: the first says more.
        first = min(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
        raise StudyError(source + _sentence(first, options)) from None


def _sentence(problem: Any, options: Mapping[tuple[str, str], str]) -> str:
    """One sentence for the first problem that pydantic found."""
    section, *keys = problem["loc"]
    law = keys.pop(0) if section == "base" and keys else None
    if problem["type"] == "extra_forbidden":
        return _unknown_key(keys[-1], section, law) if keys else _unknown_section(section, problem["input"])
    if problem["type"] in ("model_type", "model_attributes_type") and not keys:
        return f"{section} must be a section [{section}] of keys, but {_show(problem['input'])} was given."
    if problem["type"] == "union_tag_invalid":
        return _unknown_law(problem["input"]["law"])
    if problem["type"] == "missing":
        law = _LAWS[problem["loc"][1]]
        return (
            f"[{section}] lacks {keys[0]} ({law.model_fields[keys[0]].description}), which {problem['loc'][1]} needs."
        )
    if problem["type"] == "value_error":
        said = str(problem["ctx"]["error"]).removeprefix("Argument ").removeprefix("Arguments ")
        return f"in [{section}], {said}"
    key = "".join(f"[{part}]" if isinstance(part, int) else part for part in keys)
    option = options.get((section, key))
    subject = f"{key} in [{section}]" if option is None else f"option --{option}"
    return f"{subject} {_demand(problem)}, but {_show(problem['input'])} was given."


def _demand(problem: Any) -> str:
    plain = {
        "float_type": "must be a number",
        "int_type": "must be a whole number",
        "bool_type": "must be true or false",
        "string_type": "must be a text in quotation marks",
        "list_type": "must be a list in brackets",
        "string_too_short": "must not be empty",
        "too_short": "must not be empty",
    }
    return plain.get(problem["type"]) or problem["msg"].replace("Input should be", "must be")


def _unknown_key(key: str, section: str, law: str | None) -> str:
    kind = type(getattr(StudyConfig(), section)) if law is None else _LAWS[law]
    owner = f"[{section}]" if law is None else f"[{section}] of the law {law}"
    hint = _nearest(key, kind.model_fields) or _owner_of(key) or f"its keys are {', '.join(kind.model_fields)}."
    return f"unknown key {key} in {owner}; {hint}"


def _unknown_section(name: str, value: Any) -> str:
    sections = ", ".join(StudyConfig.model_fields)
    if isinstance(value, dict):
        hint = _nearest(name, StudyConfig.model_fields) or f"the sections are {sections}."
        return f"unknown section [{name}]; {hint}"
    hint = _owner_of(name) or f"keys belong in the sections {sections}."
    return f"unknown key {name} outside every section; {hint}"


def _unknown_law(name: Any) -> str:
    return (
        f"law in [base] must be one of {', '.join(_LAWS)}, but {_show(name)} was given"
        f"{_nearest(str(name), _LAWS, before='; ') or '.'}"
    )


def _owner_of(key: str) -> str:
    """A hint for a key that exists elsewhere, or ""."""
    for section in StudyConfig.model_fields:
        if section != "base" and key in type(getattr(StudyConfig(), section)).model_fields:
            return f"{key} belongs in [{section}]."
    for name, law in _LAWS.items():
        if key in law.model_fields:
            return f"{key} belongs in [base] of the law {name}."
    return ""


def _nearest(name: str, known: Iterable[str], before: str = "") -> str:
    by_lower_case = {candidate.lower(): candidate for candidate in known}
    found = get_close_matches(name.lower(), by_lower_case, n=1)
    return f"{before}did you mean {by_lower_case[found[0]]}?" if found else ""


def _show(value: Any) -> str:
    text = toml_value(value)
    return text if len(text) <= 60 else text[:57] + "..."
