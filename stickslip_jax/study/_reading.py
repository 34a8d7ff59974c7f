"""Reads studies and sweeps from TOML files and the command's options; every mistake becomes a sentence."""

import os
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args

from cyclopts import Parameter, Token
from pydantic import ValidationError

from .._foundation.checks import one_of
from . import StudyError
from ._config import FileConfig, StudyConfig, SweepConfig
from ._sections import NUMBER, Section, UniformConfig, kinds_in, nearest, refused, tables_of, tag_key, tag_of

# Studies and sweeps to start from, by name: what differs from the defaults.


Example = Literal["harmonic-base", "base-isolation", "motor-cart", "two-blocks"]
Paper = Literal[
    "parametric-analysis", "stick-share-constant", "stick-share-square", "stick-share-harmonic", "stick-share-random"
]


def _files(folder: str, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The files of TOML that come with the package, by name."""
    texts = {name: (Path(__file__).parent / folder / f"{name}.toml").read_text(encoding="utf-8") for name in names}
    return {name: tomllib.loads(text) for name, text in texts.items()}


EXAMPLES, PAPERS = _files("examples", get_args(Example)), _files("papers", get_args(Paper))


# The options of the ``stickslip`` command.


def _whole_number(kind: type, tokens: Sequence[Token]) -> int:
    """Read a whole number; cyclopts alone would round 2.7 to 3."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f'"{tokens[0].value}" is not a whole number.') from None


_Whole = Annotated[int | None, Parameter(converter=_whole_number)]
FIGURES = (".png", ".pdf", ".svg")
MOST_SAMPLES = 20_000  # of the explorer, which simulates them at each move
Switch = Annotated[bool, Parameter(negative="", show_default=False)]


@Parameter(name="*")
@dataclass(frozen=True)
class StudyOptions:
    """The options of ``stickslip study``; None leaves the choice to the configuration.

    Parameters
    ----------
    samples
        Number of samples.
    seed
        Seed of the random numbers.
    t1
        Duration of each sample, s.
    threads
        Worker threads (default: all cores).
    chunk
        Samples simulated per call (default: chosen for speed). Does not change the results.
    out
        Folder for the result (default: results/study).
    force
        Replace a result in that folder, once the new one is complete.
    figures
        Draw figures, or not.
    json
        Print the statistics as one JSON object on standard output, all else on standard error.
    quiet
        Print no table and no progress.
    progress
        Show a progress bar, or not (default: only on a terminal).
    print_config
        Print the complete configuration, a file to start from, and run nothing.
    print_example
        Print the configuration of an example, likewise: a mass on a base that oscillates (harmonic-base), a building on
        sliding isolators in an earthquake (base-isolation), a cart driven by a motor (motor-cart), or a structure with
        several contacts (two-blocks).
    """

    samples: _Whole = None
    seed: _Whole = None
    t1: float | None = None
    threads: _Whole = None
    chunk: _Whole = None
    out: str | None = None
    force: Switch = False
    figures: bool | None = None
    json: Switch = False
    quiet: Switch = False
    progress: bool | None = None
    print_config: Switch = False
    print_example: Example | None = None


@Parameter(name="*")
@dataclass(frozen=True)
class ExecutorOptions:
    """Where a sweep is simulated; the numbers are the same everywhere.

    Parameters
    ----------
    threads
        Threads of one process (default: all cores).
    workers
        Processes on this machine, in place of threads.
    dask
        Address of a dask scheduler whose workers simulate, such as tcp://127.0.0.1:8786.
    quiet
        Print no table and no progress.
    progress
        Show a progress bar, or not (default: only on a terminal).
    """

    threads: _Whole = None
    workers: _Whole = None
    dask: str | None = None
    quiet: Switch = False
    progress: bool | None = None

    def __post_init__(self):
        given = [f"--{name}" for name in ("threads", "workers", "dask") if getattr(self, name) is not None]
        if len(given) > 1:
            raise StudyError(f"Options {given[0]} and {given[1]} were both given; each says where to simulate.")
        for name in ("threads", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise StudyError(f"option --{name} must be at least 1, but {value} was given.")


@Parameter(name="*")
@dataclass(frozen=True)
class SweepOptions:
    """The options of ``stickslip sweep``.

    Parameters
    ----------
    out
        Folder of the sweep; needed to run it.
    samples
        Number of samples at each point.
    paper
        A sweep of a paper in place of a file: statistics over friction and switching rate (parametric-analysis), or the
        share of time spent sticking over friction and frequency of the belt (stick-share-...).
    print_config
        Print the complete configuration, a file to start from, and run nothing.
    """

    out: Path | None = None
    samples: _Whole = None
    paper: Paper | None = None
    print_config: Switch = False


# Reads studies and sweeps from TOML files and the command's options; every mistake becomes one sentence.


_File = TypeVar("_File", bound=FileConfig)
_Options = Mapping[tuple[str, str], str]
"""The option of the command by which a value was given, by section and key."""
_A_SECTION, _SECTIONS = "a section [{}] of keys", "sections [[{}]] of keys, one or more"
_NOT_A_SECTION = {
    **dict.fromkeys(("model_type", "model_attributes_type"), _A_SECTION),
    **dict.fromkeys(("list_type", "too_short"), _SECTIONS),
}
"""What must be where something else stands, by what pydantic says of it."""
_NOT_A_VALUE = {
    "float_type": "be a number",
    "int_type": "be a whole number",
    "bool_type": "be true or false",
    "string_type": "be a text in quotation marks",
    "list_type": "be a list in brackets",
    **dict.fromkeys(("string_too_short", "too_short"), "not be empty"),
}
"""Likewise of the values of keys."""
_LONGEST = 16 * 10**6  # bytes of a file
_CHOSEN = None  # the name under which the chosen kind of a section stands

OPTIONS = {name: ("run", name) for name in ("samples", "seed", "t1", "threads", "chunk")}
OPTIONS |= {"out": ("output", "directory"), "figures": ("output", "figures")}
"""The section and key whose value each option of the command replaces."""


def read_config(
    path: str | os.PathLike[str] | None = None,
    options: Mapping[str, object] | None = None,
    *,
    example: str | None = None,
) -> StudyConfig:
    """Read the study described by a TOML file.

    Args:
        path: The file; files that it names are relative to its folder. By default the default study.
        options: Values that replace those of the file, by the names of the options of ``stickslip study``; None leaves
            the file's.
        example: Without `path`, the name of an example to read instead: "harmonic-base", "base-isolation",
            "motor-cart" or "two-blocks".

    Returns:
        The description of the study.

    Raises:
        StudyError: For a file that is missing, is not valid TOML, or holds unknown keys or unsuitable values, and for
            unsuitable options.
    """
    path = None if path is None else Path(path)
    return _read(StudyConfig, "study", path, EXAMPLES.get(example or "", {}), options)


def read_sweep_config(
    path: Path | None = None, options: Mapping[str, object] | None = None, *, paper: str | None = None
) -> SweepConfig:
    """Read the parameter sweep described by a TOML file; the rest is as in `read_config`.

    `paper`: without `path`, the name of one of `PAPERS` to read instead; by default the parametric analysis.
    """
    return _read(SweepConfig, "sweep", path, PAPERS[paper or "parametric-analysis"], options)


def _read(
    kind: type[_File],
    command: str,
    path: Path | None,
    usual: Mapping[str, object],
    options: Mapping[str, object] | None,
) -> _File:
    table: dict[str, Any] = dict(usual) if path is None else _parse(path, command)
    config = _validated(kind, table, path, f"{path}: ", {})
    given = {option: value for option, value in (options or {}).items() if value is not None}
    for option, value in given.items():
        section, key = OPTIONS[option]
        table = {**table, section: {**table.get(section, {}), key: value}}
    named = {OPTIONS[option]: option for option in given}
    return _validated(kind, table, path, "", named) if given else config


def _parse(path: Path, command: str) -> dict[str, Any]:
    try:
        with path.open("rb") as file:  # a pipe too, but no more than a description can be
            data = file.read(_LONGEST + 1)
        if len(data) <= _LONGEST:
            return tomllib.loads(data.decode("utf-8"))
        problem = f"is longer than {_LONGEST // 10**6} MB, and no description of a {command}"
    except FileNotFoundError:
        problem = f"no such file; `stickslip {command} --print-config` prints one to start from"
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    except UnicodeDecodeError:
        problem = "is not a text file in UTF-8"
    except tomllib.TOMLDecodeError as error:
        problem = f"is not valid TOML ({error})"
    except ValueError:  # of Python's, about whole numbers
        problem = f"has a whole number of more than {sys.get_int_max_str_digits()} digits; correct it"
    except RecursionError:
        problem = "has lists or tables within too many others; correct it"
    raise StudyError(f"{path}: {problem}.")


def _validated(kind: type[_File], table: dict[str, Any], path: Path | None, source: str, options: _Options) -> _File:
    try:
        return kind.model_validate(table, context={"folder": Path() if path is None else path.parent})
    except ValidationError as error:
        # A misspelt key shows as unknown and, often, also as missing: the first says more.
        problem = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
        system = table.get("system")
        model = system.get("model") if isinstance(system, dict) else None
        run = kind.runs.get(str(model), kind.runs["MassSpring"])
        raise StudyError(source + _sentence_for(problem, options, kind, run)) from None


def _sentence_for(problem: Any, options: _Options, file: type[FileConfig], run: type[Section]) -> str:
    """What pydantic found in this kind of `file`, with this kind of section ``[run]``."""
    place, kind, given = _place_of(problem["loc"], file, run), problem["type"], problem.get("input")
    if kind == "extra_forbidden":
        return _unknown_key(place, file) if place.section else _unknown_section(place.key, given, file)
    if kind in _NOT_A_SECTION and not place.key:
        return str(refused(place.name, f"be {_NOT_A_SECTION[kind].format(place.section)}", given))
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _wrong_tag(place, given)
    if kind == "missing":
        owner = _place_of(problem["loc"][:-1], file, run)
        about = owner.kind.model_fields[place.key or place.name]
        name = place.key or (place.name if _takes_a_number(about.annotation) else f"[{place.section}]")
        return f"[{owner.section}] lacks {name} ({about.description}), which {tag_of(owner.kind)} needs."
    if kind == "value_error":
        said = str(problem.get("ctx", {})["error"]).removeprefix("Argument ").removeprefix("Arguments ")
        return f"in [{place.section}], {said}" if place.section else said
    option = options.get((place.section, place.key))
    subject = f"{place.key} in [{place.section}]" if option is None else f"option --{option}"
    demand = _NOT_A_VALUE.get(kind) or problem["msg"].replace("Input should be", "be")
    if problem["loc"][-1] == NUMBER:  # what else may stand there
        kinds = kinds_in(place.kind.model_fields[_without_numbers(place.key)].annotation)
        is_start = UniformConfig in kinds.values()
        demand += " or { low = ..., high = ... }" if is_start else f" or a section of the law {one_of(kinds)}"
    return str(refused(subject, demand, given))


# --- where it is


class _Place(NamedTuple):
    """The section ("base.jumps", or "" outside all), its possible kinds by name, and the key ("" for the section)."""

    section: str
    kinds: Mapping[str | None, type[Section]]
    key: str = ""

    @property
    def name(self) -> str:
        """The last part of the section's name."""
        return self.section.rpartition(".")[2]

    @property
    def kind(self) -> type[Section]:
        """The kind of the section."""
        return self.kinds[_CHOSEN]


def _place_of(location: Iterable[str | int], file: type[FileConfig], run: type[Section]) -> _Place:
    """The place that pydantic locates by keys, indices of lists, and the names of the chosen kinds."""
    place = outside = _Place("", {_CHOSEN: file})
    for part in location:
        if isinstance(part, int):
            place = place._replace(**{"key" if place.key else "section": f"{place.key or place.section}[{part}]"})
        elif part == NUMBER:  # a number where a table is possible too
            place = outside._replace(key=place.name)
        elif part in place.kinds:
            place = place._replace(kinds={_CHOSEN: place.kinds[part]})
        else:
            fields = place.kind.model_fields
            kinds = kinds_in(fields[part].annotation) if part in fields else {}
            if not kinds:
                place = place._replace(key=str(part))
                continue
            inside = f"{place.section}.{part}".removeprefix(".")
            kind, *others = (run,) if inside == "run" else kinds.values()
            known: dict[Any, type[Section]] = {**kinds} if others or kind is UniformConfig else {_CHOSEN: kind}
            outside, place = place, _Place(inside, known)
    return place


def _all_sections(
    file: type[FileConfig], kind: type[Section] | None = None, within: str = ""
) -> Iterator[tuple[str, Mapping[str, type[Section]]]]:
    """The name of every section, and its possible kinds."""
    for key, kinds in tables_of(kind or file).items():
        name = f"{within}.{key}".removeprefix(".")
        yield name, file.runs if name == "run" else kinds
        for each in kinds.values():
            yield from _all_sections(file, each, name)


# --- what is wrong


def _without_numbers(name: str) -> str:
    """The name of a key or section without the number in a list."""
    return re.sub(r"\[\d+\]", "", name)


def _takes_a_number(annotation: object) -> bool:
    return annotation is float or any(map(_takes_a_number, get_args(annotation)))


def _wrong_tag(place: _Place, table: Mapping[str, object]) -> str:
    kinds = {str(name): kind for name, kind in place.kinds.items()}
    key = tag_key(next(iter(kinds.values()))) or ""
    if key not in table:
        return f"[{place.section}] lacks {key}, which must be {one_of(kinds)}."
    end = nearest(str(table[key]), kinds) or "."
    return str(refused(f"{key} in [{place.section}]", f"be one of {', '.join(kinds)}", table[key], end))


def _unknown_key(place: _Place, file: type[FileConfig]) -> str:
    key, models = place.key, [model for model, run in file.runs.items() if run is place.kind]
    tag, name = ("model", one_of(models)) if models else (tag_key(place.kind), tag_of(place.kind))
    owner = f"[{place.section}]" if tag is None else f"[{place.section}] of the {tag} {name}"
    hint = _owner_of(key, file, _without_numbers(place.section)) or nearest(key, place.kind.model_fields, before="")
    return f"unknown key {key} in {owner}; " + (hint or f"its keys are {', '.join(place.kind.model_fields)}.")


def _unknown_section(name: str, value: object, file: type[FileConfig]) -> str:
    sections = ", ".join(file.model_fields)
    if not isinstance(value, dict):
        return f"unknown key {name} outside every section; {_owner_of(name, file) or f'keys belong in {sections}.'}"
    inner = [section for section, _ in _all_sections(file) if section.endswith(f".{name}")]
    if inner:
        return f"unknown section [{name}]; did you mean [{min(inner, key=len)}]?"
    return f"unknown section [{name}]; {nearest(name, file.model_fields, before='') or f'the sections are {sections}.'}"


def _owner_of(key: str, file: type[FileConfig], section: str = "") -> str:
    """A hint for a `key` that exists elsewhere, the `section` itself (of another kind) first, or ""."""
    for name, kinds in sorted(_all_sections(file), key=lambda each: each[0] != section):
        owners = [tag for tag, kind in kinds.items() if key in kind.model_fields]
        if owners and len(owners) == len(kinds):
            return f"{key} belongs in [{name}]."
        if owners:
            tag = "model" if name in ("system", "run") else "law"
            return f"{key} belongs in [{name}] of the {tag} {one_of(owners)}."
    return ""
