"""The manifest of a study's folder: everything that decides its numbers, and what was asked for."""

import dataclasses
import hashlib
import json
from collections.abc import Iterator
from typing import Any

import jax
import jax.lib
import numpy as np

from .._ensemble.encoding import Decoder, Encoder
from .._ensemble.unknown import Unknown
from .._statistics.accumulator import Numbering
from .errors import StudyError
from .plan import Plan
from .points import Axis, Points
from .setting import Setting

FORMAT, FORMAT_VERSION = "stickslip_jax study", 1
_OBJECTS = ("system", "law", "y0", "method")
_DECIDING = ("t1", "keep", "key_data", "numbering", "independent", "piece", "dtype")
_FINGERPRINT = ("objects", "deciding", "versions", "floats", "integers")
_ARGUMENTS = {"key_data": "key", "numbering": "orders and count_initial_rest"}
"""What the user calls it, where that is another name."""
_ASKED = ("samples", "statistics", "derivatives", "standard_errors", "realizations")


class UnreadableError(ValueError):
    """A text that is no manifest, or a damaged one."""


def manifest_text(plan: Plan) -> str:
    """The manifest of a study as JSON."""
    encoder = Encoder()
    body = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": versions(),
        "objects": {name: encoder.encoded(getattr(plan.setting, name)) for name in _OBJECTS},
        "deciding": {name: _plain(getattr(plan, name)) for name in _DECIDING},
        "asked": {name: _plain(getattr(plan, name)) for name in _ASKED},
        "axes": [
            {"name": axis.name, "parameters": list(axis.parameters), "values": axis.values.tolist()}
            for axis in plan.points.axes
        ],
        "floats": [float(value).hex() for value in encoder.floats],
        "integers": encoder.integers.tolist(),
    }
    return _text(body)


def extended(there: dict[str, Any], here: dict[str, Any]) -> str:
    """The manifest of a study that adds to another: what decides the numbers as it is written there.

    Numbers may be equal and written otherwise, 1 and 1.0, and the pieces bear the fingerprint of what is there.
    """
    return _text({**here, **{name: there[name] for name in _FINGERPRINT}})


def _text(body: dict[str, Any]) -> str:
    return json.dumps({"body": body, "sha256": sum_of(body)}, indent=1)


def body_of(text: str) -> dict[str, Any]:
    """The manifest in a text. Raises UnreadableError for another or a damaged one, StudyError for a newer format."""
    try:
        whole = json.loads(text)
        body, stated = whole["body"], whole["sha256"]
        if body["format"] != FORMAT:
            raise UnreadableError("it is of another program")
        if body["format_version"] > FORMAT_VERSION:
            raise StudyError(
                f"it has format {body['format_version']}, written by stickslip_jax "
                f"{body['versions']['stickslip_jax']}, and this version reads {FORMAT_VERSION}; install that version "
                "or a newer one."
            )
        if sum_of(body) != stated:
            raise UnreadableError("its check sum is wrong")
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise UnreadableError(str(error)) from error
    return body


def plan_in(body: dict[str, Any], *, to_run: bool = True) -> Plan:
    """The study that a manifest describes. Raises StudyError where it holds objects of a user's own classes, which
    cannot be run; with `to_run` False these are left as they are stored.
    """
    floats = np.array([float.fromhex(value) for value in body["floats"]])
    decoder = Decoder(floats, np.array(body["integers"], np.int64))
    objects = {name: decoder.decoded(value) for name, value in body["objects"].items()}
    for name, value in objects.items():
        for one in value if isinstance(value, tuple) else (value,):
            if to_run and isinstance(one, Unknown):
                raise StudyError(
                    f"its {name} is a {one.name} of your own, which is stored as text only; run your own program again "
                    "with the same folder, which goes on from here."
                )
    deciding, asked = dict(body["deciding"]), dict(body["asked"])
    deciding["numbering"] = Numbering(*deciding["numbering"])
    deciding["key_data"] = None if deciding["key_data"] is None else tuple(deciding["key_data"])
    asked["statistics"] = tuple(asked["statistics"])
    asked["derivatives"] = tuple((name, tuple(wrt)) for name, wrt in asked["derivatives"])
    axes = (Axis(one["name"], tuple(one["parameters"]), np.array(one["values"], float)) for one in body["axes"])
    return Plan(Setting(**objects), Points(tuple(axes)), **deciding, **asked)


def differences(there: dict[str, Any], here: dict[str, Any]) -> list[str]:
    """What decides the numbers and differs between two manifests, each "name: ... there, ... here".

    Points, samples, statistics and sensitivities may differ: they add to what is there.
    """
    parameters = [{name for axis in body["axes"] for name in axis["parameters"]} for body in (there, here)]
    found = []
    if parameters[0] != parameters[1]:
        found.append(f"parameters: {', '.join(sorted(parameters[0]))} there, {', '.join(sorted(parameters[1]))} here")
    for part in ("objects", "deciding", "versions"):
        for path, old, new in _different(there[part], here[part], ()):
            found.append(f"{_named(path)}: {_brief(old)} there, {_brief(new)} here")
    if not found and (there["floats"], there["integers"]) != (here["floats"], here["integers"]):
        found.append("an array of the system or law differs")
    return found


def fingerprint(body: dict[str, Any]) -> str:
    """A sum of everything that decides the numbers at a point."""
    return sum_of({name: body[name] for name in _FINGERPRINT})


def versions() -> dict[str, str]:
    """The versions of what decides the numbers."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    jaxlib = jax.lib.__version__  # pyright: ignore[reportPrivateImportUsage] - JAX documents it
    return {"stickslip_jax": __version__, "jax": jax.__version__, "jaxlib": jaxlib}


def sum_of(body: dict[str, Any]) -> str:
    """The check sum of a manifest, or of a part of one."""
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """`value` in lists, dicts and numbers, as JSON gives it back."""
    return json.loads(json.dumps(value))


def _different(old: Any, new: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    both = isinstance(old, dict) and isinstance(new, dict) and old.keys() == new.keys()
    if both and old.get("class") == new.get("class"):
        for name in old:
            yield from _different(old[name], new[name], (*path, name))
    elif old != new:
        yield path, old, new


def _named(path: tuple[str, ...]) -> str:
    parts = [_ARGUMENTS.get(part, part) for part in path]
    return ".".join(part for part in parts if part not in ("fields", "class", "values", "tuple")) or "object"


def _brief(value: Any) -> str:
    if isinstance(value, dict) and "class" in value:
        fields = value["fields"]
        return fields["text"] or fields["name"] if value["class"] == "Unknown" else str(value["class"])
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def with_piece(plan: Plan, body: dict[str, Any]) -> Plan:
    """`plan` cut into pieces as the study of a manifest."""
    return dataclasses.replace(plan, piece=body["deciding"]["piece"])
