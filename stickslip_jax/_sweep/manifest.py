"""The manifest of a sweep's folder, and its copy there: everything that decides the numbers, and what was asked for."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypedDict, cast, get_origin

import jax
import jax.lib

from .._ensemble.encoding import Encoder
from .._files import NotAFileError, read_regular
from .errors import OtherProgramError, SweepError, UnreadableError
from .header import ID_LENGTH
from .plan import Plan

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
