"""Reads studies and sweeps from TOML files and the command's options; every mistake becomes one sentence."""

import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ._config import FileConfig, StudyConfig
from ._errors import StudyError
from ._examples import EXAMPLES, PAPERS
from ._mistakes import Options, sentence_for
from ._sweep_config import SweepConfig

_File = TypeVar("_File", bound=FileConfig)

OPTIONS = {
    "samples": ("run", "samples"),
    "seed": ("run", "seed"),
    "t1": ("run", "t1"),
    "threads": ("run", "threads"),
    "chunk": ("run", "chunk"),
    "out": ("output", "directory"),
    "figures": ("output", "figures"),
}
"""The section and key whose value each option of the command replaces."""


def read_config(
    path: Path | None = None, options: Mapping[str, object] | None = None, *, example: str | None = None
) -> StudyConfig:
    """Read the study described by a TOML file.

    Args:
        path: The file; files that it names are relative to its folder. By default the default study.
        options: Values that replace those of the file, by the names of the options of ``stickslip study``; None leaves
            the file's.
        example: Without `path`, the name of an example to read instead: "harmonic-base", "base-isolation" or
            "motor-cart".

    Returns:
        The description of the study.

    Raises:
        StudyError: For a file that is missing, is not valid TOML, or holds unknown keys or unsuitable values, and for
            unsuitable options.
    """
    return _read(StudyConfig, "study", path, EXAMPLES.get(example or "", {}), options)


def read_sweep_config(
    path: Path | None = None, options: Mapping[str, object] | None = None, *, paper: str | None = None
) -> SweepConfig:
    """Read the parameter sweep described by a TOML file; the rest is as in `read_config`.

    `paper`: without `path`, the name of one of `PAPERS` to read instead; by default the parametric analysis.
    """
    return _read(SweepConfig, "sweep", path, PAPERS[paper or "parametric-analysis"], options)


def _read(
    kind: type[_File], command: str, path: Path | None, usual: Mapping[str, Any], options: Mapping[str, object] | None
) -> _File:
    table = dict(usual) if path is None else _parse(path, command)
    config = _validated(kind, table, path, f"{path}: ", {})
    given = {option: value for option, value in (options or {}).items() if value is not None}
    for option, value in given.items():
        section, key = OPTIONS[option]
        table = {**table, section: {**table.get(section, {}), key: value}}
    named = {OPTIONS[option]: option for option in given}
    return _validated(kind, table, path, "", named) if given else config


def _parse(path: Path, command: str) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StudyError(
            f"{path}: no such file; `stickslip {command} --print-config` prints one to start from."
        ) from None
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}).") from None
    except UnicodeDecodeError:
        raise StudyError(f"{path}: is not a text file in UTF-8.") from None
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{path}: is not valid TOML ({error}).") from None
    except ValueError:  # of Python's, about whole numbers
        raise StudyError(
            f"{path}: has a whole number of more than {sys.get_int_max_str_digits()} digits; correct it."
        ) from None
    except RecursionError:
        raise StudyError(f"{path}: has lists or tables within too many others; correct it.") from None


def _validated(kind: type[_File], table: dict[str, Any], path: Path | None, source: str, options: Options) -> _File:
    try:
        return kind.model_validate(table, context={"folder": Path() if path is None else path.parent})
    except ValidationError as error:
        raise StudyError(source + sentence_for(error, table, options, kind)) from None
