"""The manifest of a sweep's folder: everything that decides the numbers, and the sweep that it describes."""

import hashlib
import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypedDict, TypeVar, cast, get_origin

import jax
import jax.lib
import numpy as np

from .._dynamics.common.method import check_method
from .._dynamics.simulate import Output
from .._ensemble.data import Unknown
from .._ensemble.encoding import Decoder, Encoder
from .._foundation import checks
from .._foundation.files import NotAFileError, read_regular
from .._statistics.accumulator import Numbering
from .plan import (
    DamagedBatchError,
    Dimension,
    OtherProgramError,
    Plan,
    Points,
    SweepError,
    SweepSetting,
    UnreadableError,
    checked_derivatives,
    checked_errors,
    checked_keep,
    checked_statistics,
    setting_of,
)

# The header of a batch's file: the identity of the sweep, a check sum, and the name under which it was written.


ID_LENGTH = 16
"""The length of the identity of a sweep, with which the file of a batch begins."""
_SUM, _LENGTH = 32, 2  # bytes of the check sum, and of the length of the name


LONGEST_HEADER = ID_LENGTH + _SUM + _LENGTH + 255
"""How many bytes hold the header, for names as long as file systems take them."""


class ForeignBatchError(Exception):
    """A batch that is whole, and of another sweep."""


def with_header(sweep_id: bytes, name: str, data: bytes) -> bytes:
    """The bytes of a batch as they stand in the file called `name`, whose name says what they are.

    The check sum covers the name too: under another name they are no batch.
    """
    encoded = name.encode()
    rest = len(encoded).to_bytes(_LENGTH, "big") + encoded + data
    return sweep_id + _sum(sweep_id, rest) + rest


def without_header(sweep_id: bytes, name: str, whole: bytes) -> bytes:
    """The bytes that were written with this identity and name.

    Raises:
        DamagedBatchError: For bytes that are not as they were written, or were written under another name.
        ForeignBatchError: For those of another sweep.
    """
    found, stated, rest = whole[:ID_LENGTH], whole[ID_LENGTH : ID_LENGTH + _SUM], whole[ID_LENGTH + _SUM :]
    if stated != _sum(found, rest):
        raise DamagedBatchError("its check sum is wrong")
    if found != sweep_id:
        raise ForeignBatchError
    written, data = _name_and_data(rest)
    if written != name:
        raise DamagedBatchError(f"it is {written}, under another name")
    return data


def id_and_name(beginning: bytes) -> tuple[bytes, str]:
    """The identity of the sweep and the name when it was written, from the `LONGEST_HEADER` bytes at the beginning.

    They are not checked.
    """
    return beginning[:ID_LENGTH], _name_and_data(beginning[ID_LENGTH + _SUM :])[0]


def _name_and_data(rest: bytes) -> tuple[str, bytes]:
    end = _LENGTH + int.from_bytes(rest[:_LENGTH], "big")
    return rest[_LENGTH:end].decode(errors="replace"), rest[end:]


def _sum(sweep_id: bytes, rest: bytes) -> bytes:
    return hashlib.sha256(sweep_id + rest).digest()


# The manifest of a sweep's folder, and its copy there: everything that decides the numbers, and what was asked for.


MANIFEST, COPY = "manifest.json", "manifest-copy.json"
FORMAT, FORMAT_VERSION = "stickslip_jax sweep", 4
_OLDER_FORMAT = "stickslip_jax study"  # of versions 1 and 2
OBJECTS = ("system", "law", "y0", "method")
DECIDING = ("t1", "keep", "key_data", "numbering", "independent", "batch", "dtype", "output_code")
_FINGERPRINT = ("objects", "deciding", "versions", "floats", "integers")
_ARGUMENTS = {"key_data": "key", "numbering": "orders and count_initial_rest", "output_code": "outputs"}
"""What the user calls it, where that is another name."""
ASKED = ("samples", "statistics", "derivatives", "standard_errors", "realizations")
_DEEPEST = 64  # levels of parts within parts; ours have some ten


class Manifest(TypedDict):
    """What a manifest holds.

    - `objects`: system, law, start and method, of which long arrays stand in `floats` and `integers`.
    - `deciding`: the other arguments that decide the numbers. `asked`: those that may change from run to run.
    - `dimensions`: of the points: name, parameters, values.
    """

    format: str
    format_version: int
    versions: dict[str, str]
    objects: dict[str, Any]
    deciding: dict[str, Any]
    asked: dict[str, Any]
    dimensions: list[dict[str, Any]]
    floats: list[str]
    integers: list[int]


def manifest_text(plan: Plan) -> str:
    """The manifest of a sweep as JSON."""
    encoder = Encoder()
    body: Manifest = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": versions(),
        "objects": {name: encoder.encoded(getattr(plan.setting, name)) for name in OBJECTS},
        "deciding": {name: _as_json(getattr(plan, name)) for name in DECIDING},
        "asked": {name: _as_json(getattr(plan, name)) for name in ASKED},
        "dimensions": [
            {"name": one.name, "parameters": list(one.parameters), "values": one.values.tolist()}
            for one in plan.points.dimensions
        ],
        "floats": [float(value).hex() for value in encoder.floats],
        "integers": encoder.integers.tolist(),
    }
    return _text(body)


def extended(stored: Mapping[str, object], new: Mapping[str, object]) -> str:
    """The text of the `new` manifest, with what decides the numbers written as in the `stored` one.

    Numbers may be equal and written otherwise, 1 and 1.0, and the batches bear the fingerprint of what is stored.
    """
    return _text({**new, **{name: stored[name] for name in _FINGERPRINT}})


def _text(body: Mapping[str, object]) -> str:
    return json.dumps({"body": body, "sha256": sum_of(body)}, indent=1)


def body_of(text: str) -> Manifest:
    """The manifest in a text.

    Raises OtherProgramError for a text of another program, UnreadableError for a damaged one, and SweepError for
    another format.
    """
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UnreadableError(str(error)) from error
    if not isinstance(whole, dict) or not {"body", "sha256"} & whole.keys():
        raise OtherProgramError("it is of another program")
    body = whole.get("body")
    if not isinstance(body, dict) or _depth(body) > _DEEPEST or sum_of(body) != whole.get("sha256"):
        raise UnreadableError("its check sum is wrong")
    if body.get("format") not in (FORMAT, _OLDER_FORMAT):
        raise OtherProgramError("it is of another program")
    _check_format(body)
    _check_parts(body)
    return cast(Manifest, body)


def _check_format(body: Mapping[str, object]) -> None:
    """Raises SweepError for a manifest of another format than this version writes."""
    version = body.get("format_version")
    if version == FORMAT_VERSION or not isinstance(version, int):
        return
    versions_there = body.get("versions")
    writer = versions_there.get("stickslip_jax") if isinstance(versions_there, dict) else "of an unknown version"
    todo = "install that version or a newer one" if version > FORMAT_VERSION else "run the sweep into another folder"
    raise SweepError(
        f"it has format {version}, written by stickslip_jax {writer}, and this version reads {FORMAT_VERSION}; {todo}."
    )


def _check_parts(body: dict[str, Any]) -> None:
    """Raises UnreadableError for a manifest in which a part is missing, or is of another kind."""
    for name, kind in Manifest.__annotations__.items():
        if type(body.get(name)) is not (get_origin(kind) or kind):
            raise UnreadableError(f"its {name} is missing")
    wanted = {"versions": tuple(versions()), "objects": OBJECTS, "deciding": DECIDING, "asked": ASKED}
    for part, names in wanted.items():
        there = body[part]
        for name in (*(name for name in names if name not in there), *(name for name in there if name not in names)):
            raise UnreadableError(f"its {part}.{name} is {'missing' if name in names else 'not known'}")


def _depth(value: object) -> int:
    """How many levels of parts within parts there are, counted up to a little more than are allowed."""
    level, depth = [value], 0
    while level and depth <= _DEEPEST:
        depth += 1
        inner = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, (dict, list))]
        level = [one for parts in inner for one in parts if isinstance(one, (dict, list))]
    return depth


def differences(stored: Manifest, new: Manifest) -> list[str]:
    """What decides the numbers and differs between two manifests, each "name: ... there, ... here".

    Points, samples, statistics and sensitivities are not compared: other ones are added to what is stored.
    """
    parameters = [{name for one in body["dimensions"] for name in one["parameters"]} for body in (stored, new)]
    found = []
    if parameters[0] != parameters[1]:
        found.append(f"parameters: {', '.join(sorted(parameters[0]))} there, {', '.join(sorted(parameters[1]))} here")
    for part in ("objects", "deciding", "versions"):
        for path, there, here in _different(stored[part], new[part], ()):
            found.append(f"{_named(path)}: {_brief(there)} there, {_brief(here)} here")
    if not found and any(stored[part] != new[part] for part in ("floats", "integers")):
        found.append("an array of the system or law differs")
    return found


def fingerprint(body: Mapping[str, object]) -> str:
    """A sum of everything that decides the numbers at a point."""
    return sum_of({name: body[name] for name in _FINGERPRINT})


def versions() -> dict[str, str]:
    """The versions of what decides the numbers."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    jaxlib = jax.lib.__version__  # pyright: ignore[reportPrivateImportUsage] - JAX documents it
    return {"stickslip_jax": __version__, "jax": jax.__version__, "jaxlib": jaxlib}


def sum_of(body: Mapping[str, object]) -> str:
    """The check sum of a manifest, or of a part of one."""
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _as_json(value: object) -> object:
    """`value` in lists, dicts and numbers, as JSON gives it back."""
    return json.loads(json.dumps(value))


def _kind_of(part: dict[str, object]) -> tuple[set[str], object]:
    """The names in a part of a manifest, and the class of which it is."""
    return set(part), part.get("class")


def _different(old: object, new: object, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], object, object]]:
    if isinstance(old, dict) and isinstance(new, dict) and _kind_of(old) == _kind_of(new):
        for name in old:
            yield from _different(old[name], new[name], (*path, name))
    elif old != new:
        yield path, old, new


def _named(path: tuple[str, ...]) -> str:
    parts = [_ARGUMENTS.get(part, part) for part in path]
    return ".".join(part for part in parts if part not in ("fields", "class", "values", "tuple")) or "object"


def _brief(value: object) -> str:
    if isinstance(value, dict) and "class" in value:
        fields = value["fields"]
        return fields["text"] or fields["name"] if value["class"] == "Unknown" else str(value["class"])
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


# --- in the folder


def sweep_id_of(body: Manifest) -> bytes:
    """The identity of a sweep, with which the files of its batches begin."""
    return fingerprint(body)[:ID_LENGTH].encode()


def has_manifest(folder: Path) -> bool:
    """Whether there is a manifest, or a copy of one."""
    return any((folder / name).exists() for name in (MANIFEST, COPY))


def body_in(folder: Path, ids_of_batches: Callable[[], Iterable[bytes]], *, to_write: bool = False) -> Manifest:
    """The manifest of a folder, or its copy where that is damaged.

    Args:
        folder: That of the sweep.
        ids_of_batches: Gives the identities with which the batches begin that are there.
        to_write: Whether both files are about to be replaced.

    Raises:
        SweepError: If there is no manifest, where the two are of two sweeps, and for a file of another program that
            would be replaced.
    """
    found: dict[str, Manifest] = {}
    damage, foreign = "", None
    for name in (MANIFEST, COPY):
        path = folder / name
        try:
            found[name] = body_of(read_regular(path).decode())
        except (FileNotFoundError, NotADirectoryError):
            continue
        except SweepError as error:
            raise SweepError(f"{folder} cannot be read: {error}") from None
        except (UnreadableError, UnicodeDecodeError) as error:
            damage = damage or f"{path} is damaged ({error})"
            foreign = path if isinstance(error, OtherProgramError) else foreign
        except NotAFileError as error:
            raise SweepError(f"{path} cannot be read ({error.strerror}); move it elsewhere, and try again.") from None
        except OSError as error:
            raise SweepError(f"{path} cannot be read ({error.strerror}); make it readable.") from None
    if not found and damage:
        raise SweepError(f"{damage}, and there is no whole copy of it; run the sweep into another folder.")
    if not found:
        raise SweepError(
            f"{folder} holds no sweep ({FORMAT}); name the folder that Sweep.run or stickslip sweep wrote."
        )
    if len({sweep_id_of(body) for body in found.values()}) > 1:
        raise SweepError(_two_sweeps(folder, found, set(ids_of_batches())))
    if to_write and foreign is not None:
        raise SweepError(
            f"{foreign} is a file of another program beside the sweep's own; move it elsewhere, and try again."
        )
    return found.get(MANIFEST) or found[COPY]


def _two_sweeps(folder: Path, found: dict[str, Manifest], ids: set[bytes]) -> str:
    """The sentence about a manifest and a copy that are of two sweeps; `ids`: those of the batches."""
    right = [name for name, body in found.items() if sweep_id_of(body) in ids]
    if len(right) != 1:
        return (
            f"{folder / MANIFEST} and {COPY} beside it are of two sweeps; move the one elsewhere that is not of this "
            "sweep, and try again."
        )
    (wrong,) = found.keys() - right
    return (
        f"{folder / wrong} is of another sweep than {right[0]} and the batches beside it; move {wrong} elsewhere, and "
        "try again."
    )


# The sweep that a manifest describes: checked as a `Sweep` checks its arguments, for a file may have been edited.


_Known = TypeVar("_Known")
_UNFIT = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def plan_in(body: Manifest, *, to_run: bool = True, every_point: bool = False) -> Plan:
    """The sweep that a manifest describes; `every_point`: whether each is checked, as by `Sweep`, or the first.

    Raises SweepError where it holds objects of a user's own classes, which cannot be run (with `to_run` False these are
    left as they are stored), and for what does not fit together. Statistics and derivatives that this version does not
    know are left out, with a warning.
    """
    try:
        plan = _plan(body, to_run)
        if every_point:
            plan.check()
        elif to_run:
            plan.setting_at(0)
        return plan
    except SweepError:
        raise
    except _UNFIT as error:
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise SweepError(f"its manifest cannot be used ({reason}); run the sweep into another folder.") from error


def _plan(body: Manifest, to_run: bool) -> Plan:
    fields = body["deciding"] | body["asked"]
    if fields["dtype"] not in ("float64", "float32"):
        raise ValueError(f"dtype is {checks.show(fields['dtype'])}")
    keep = checked_keep(fields["keep"])
    derivatives = [(name, tuple(wrt)) for name, wrt in fields["derivatives"]]
    statistics = _known(fields["statistics"], lambda name: checked_statistics([name], keep))
    fields |= {
        "numbering": Numbering.checked(*fields["numbering"]),
        "key_data": _key_data(fields["key_data"]),
        "statistics": statistics,
        "derivatives": _known(derivatives, lambda one: checked_derivatives([one])),
        "standard_errors": checked_errors(fields["standard_errors"] or None, statistics),
    }
    fields["outputs"] = _outputs(fields.pop("output_code"), to_run)
    return Plan(_setting(body, to_run), _points(body["dimensions"]), **fields)


def _outputs(stored: list[list[str]], to_run: bool) -> dict[str, Output]:
    """The outputs, whose functions are not stored."""
    if stored and to_run:
        raise SweepError(
            f"its outputs ({', '.join(name for name, *_ in stored)}) are functions of your own, which are not stored; "
            "run your own program again with the same folder, which goes on from here."
        )
    return {name: Output(_not_stored, name, unit) for name, unit, _ in stored}


def _not_stored(one: object) -> float:
    raise SweepError("the functions of outputs are not stored")


def _setting(body: Manifest, to_run: bool) -> SweepSetting:
    floats = np.array([float.fromhex(value) for value in body["floats"]])
    decoder = Decoder(floats, np.array(body["integers"], np.int64))
    objects = {name: decoder.decoded(body["objects"][name]) for name in OBJECTS}
    for name, value in objects.items():
        for one in value if isinstance(value, tuple) else (value,):
            if to_run and isinstance(one, Unknown):
                raise SweepError(
                    f"its {name} is a {one.name} of your own, which is stored as text only; run your own program again "
                    "with the same folder, which goes on from here."
                )
    if not to_run:
        return SweepSetting(**objects)
    check_method(objects["method"])
    return setting_of(**objects)


def _points(dimensions: list[Any]) -> Points:
    found = []
    for one in dimensions:
        parameters, values = tuple(one["parameters"]), np.array(one["values"], float)
        if not parameters or values.ndim != 2 or values.shape[1] != len(parameters) or not len(values):
            raise ValueError(f"the values of {', '.join(map(str, parameters))} are no points")
        if not np.all(np.isfinite(values)):
            raise ValueError(f"a value of {', '.join(map(str, parameters))} is not finite")
        found.append(Dimension(one["name"], parameters, values))
    if not found:
        raise ValueError("it has no points")
    return Points(tuple(found))


def _key_data(words: object) -> tuple[int, ...] | None:
    if words is None:
        return None
    if not isinstance(words, list) or not all(type(word) is int and 0 <= word < 2**32 for word in words):
        raise ValueError(f"key is {checks.show(words)}")
    return tuple(words)


def _known(names: object, check: Callable[[Any], tuple[_Known, ...]]) -> tuple[_Known, ...]:
    """Those of the `names` that this version knows; a warning tells of the others."""
    if not isinstance(names, list):
        raise TypeError(f"statistics are {checks.show(names)}")
    known = []
    for name in names:
        try:
            known += check(name)
        except ValueError:
            shown = name if isinstance(name, str) else name[0]
            warnings.warn(
                f"The sweep asks for {checks.show(shown)}, which this version of stickslip_jax does not know; it is "
                "left out.",
                stacklevel=2,
            )
    return tuple(dict.fromkeys(known))
