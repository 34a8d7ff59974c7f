"""What is stored of calculations: objects as JSON and back, and files that show whether they are as they were written.

A class is written by its public name and its fields. An object of a user's own class, or one that holds such an object,
is written by the name of its class and as it prints, and comes back as `Unknown`.
"""

import contextlib
import dataclasses
import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.lib
import numpy as np

from .._foundation import lazy_diffrax as diffrax
from .._foundation.extras import require
from .._foundation.files import FULL
from .._numerics.sums import DyadicCounts, Moments, PowerSums
from .._statistics.quantities import StickAccumulator
from .._systems.friction import TabulatedCurve
from .._uncertainty.design import Design
from .data import GivenMotions, Origin, Unknown, UnknownSystem

# Locks that let one program at a time write to a folder.


class SweepError(ValueError):
    """A sweep that cannot run, or not to its end: a folder that cannot be used, points that failed, no memory.

    The message is one sentence, which says what to do.
    """


_LOCK_SECONDS = 0.3  # to wait for a lock: `Store.is_in_use` holds it for a moment


@contextlib.contextmanager
def locked(path: Path, said: str) -> Iterator[None]:
    """Hold the lock `path`, which the system takes back when this program ends, however it ends.

    Raises SweepError with `said` if another program holds it.
    """
    require("Results that are kept in a folder need", "study", "filelock")
    from filelock import FileLock, Timeout  # noqa: PLC0415 - an extra

    lock = FileLock(path, timeout=_LOCK_SECONDS)
    try:
        lock.acquire()
    except Timeout:
        raise SweepError(said) from None
    except OSError as error:
        raise cannot_write(path.parent, error) from error
    except NotImplementedError:  # two runs could not notice each other
        raise SweepError(f"{path.parent} is on a disk whose files cannot be locked; choose another folder.") from None
    try:
        yield
    finally:
        lock.release()


def cannot_write(folder: Path, error: OSError) -> SweepError:
    """The error about a folder that cannot be written."""
    todo = "choose another folder, or make it writable"
    if error.errno in FULL:
        todo = "make room, and run again: what is done is kept"
    return SweepError(f"{folder} cannot be written ({error.strerror or error}); {todo}.")


# Files of results: what decides their numbers has a sum, and each file shows whether it is as it was written.


ID_LENGTH = 16
"""The length of the identity of a calculation, with which the files of its results begin."""
_SUM, _LENGTH = 32, 2  # bytes of the check sum, and of the length of the name


LONGEST_HEADER = ID_LENGTH + _SUM + _LENGTH + 255
"""How many bytes hold the header, for names as long as file systems take them."""


class DamagedFileError(ValueError):
    """A file that cannot be read, or is not as it was written; its message says why, in a few words."""


class ForeignFileError(Exception):
    """A file that is whole, and of another calculation or program."""


def versions() -> dict[str, str]:
    """The versions of what decides the numbers."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    jaxlib = jax.lib.__version__  # pyright: ignore[reportPrivateImportUsage] - JAX documents it
    return {"stickslip_jax": __version__, "jax": jax.__version__, "jaxlib": jaxlib}


def sum_of(body: Mapping[str, object]) -> str:
    """The check sum of a description in words and numbers, or of a part of one."""
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def id_of(body: Mapping[str, object]) -> bytes:
    """The identity of a calculation, with which the files of its results begin; `body`: what decides its numbers."""
    return sum_of(body)[:ID_LENGTH].encode()


def with_header(identity: bytes, name: str, data: bytes) -> bytes:
    """The bytes of a result as they stand in the file called `name`, whose name says what they are.

    The check sum covers the name too: under another name they are no result.
    """
    encoded = name.encode()
    rest = len(encoded).to_bytes(_LENGTH, "big") + encoded + data
    return identity + hashlib.sha256(identity + rest).digest() + rest


def without_header(identity: bytes, name: str, whole: bytes) -> bytes:
    """The bytes that were written with this identity and name.

    Raises:
        DamagedFileError: For bytes that are not as they were written, or were written under another name.
        ForeignFileError: For those of another calculation.
    """
    found, stated, rest = whole[:ID_LENGTH], whole[ID_LENGTH : ID_LENGTH + _SUM], whole[ID_LENGTH + _SUM :]
    if stated != hashlib.sha256(found + rest).digest():
        raise DamagedFileError("its check sum is wrong")
    if found != identity:
        raise ForeignFileError
    _, written, data = parts_of_file(whole)
    if written != name:
        raise DamagedFileError(f"it is {written}, under another name")
    return data


def parts_of_file(whole: bytes) -> tuple[bytes, str, bytes]:
    """The identity, the name when it was written, and the bytes of a result. They are not checked.

    Of its `LONGEST_HEADER` first bytes alone identity and name are whole.
    """
    rest = whole[ID_LENGTH + _SUM :]
    end = _LENGTH + int.from_bytes(rest[:_LENGTH], "big")
    return whole[:ID_LENGTH], rest[_LENGTH:end].decode(errors="replace"), rest[end:]


# Objects of this package as JSON, with long arrays beside it, and back.


_SHORT = 32  # entries: longer arrays stand beside the JSON
_INTERNAL: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Design, DyadicCounts, GivenMotions, Moments, Origin, PowerSums, StickAccumulator, TabulatedCurve,
        Unknown, UnknownSystem,
    )
}  # fmt: skip
_LONGEST_TEXT = 1000  # of an object that prints itself
_DIFFRAX = (
    "Bosh3", "Dopri5", "Dopri8", "Euler", "Heun", "ImplicitEuler", "KenCarp3", "KenCarp4", "KenCarp5", "Kvaerno3",
    "Kvaerno4", "Kvaerno5", "Midpoint", "Ralston", "Tsit5",
    "BacksolveAdjoint", "DirectAdjoint", "ForwardMode", "ImplicitAdjoint", "RecursiveCheckpointAdjoint",
)  # fmt: skip
"""Solvers and adjoints that a method may hold; others are written as text."""


class NotOursError(TypeError):
    """An object that cannot be written by the names of this package."""


class Encoder:
    """Writes objects as JSON and collects long arrays in `floats` and `integers`, one after the other."""

    def __init__(self) -> None:
        self._parts: dict[str, list[np.ndarray]] = {"floats": [], "integers": []}

    @property
    def floats(self) -> np.ndarray:
        """All long arrays of floating numbers, (numbers,), float64."""
        return np.concatenate([np.zeros(0), *self._parts["floats"]])

    @property
    def integers(self) -> np.ndarray:
        """All long arrays of whole numbers and truths, (numbers,), int64."""
        return np.concatenate([np.zeros(0, np.int64), *self._parts["integers"]])

    def encoded(self, value: object) -> object:
        """`value` as JSON takes it; objects of a user's own classes as the name of the class and as they print."""
        if type(value) is tuple:
            return {"tuple": [self.encoded(part) for part in value]}
        try:
            return self._encoded(value)
        except NotOursError:
            printed = " ".join(repr(value).split())[:_LONGEST_TEXT]
            return {"class": "Unknown", "fields": {"name": type(value).__name__, "text": printed}}

    def _encoded(self, value: object) -> object:
        if value is None or isinstance(value, (bool, str)) or type(value) is int:
            return value
        if isinstance(value, float) and not isinstance(value, np.generic):
            return value if math.isfinite(value) else {"float": str(value)}
        if isinstance(value, (np.ndarray, np.generic, jax.Array)):
            return self._array(value)
        if type(value) is tuple or type(value) is list:
            return {type(value).__name__: [self._encoded(part) for part in value]}
        if _class_named(type(value).__name__) is type(value):
            return {"class": type(value).__name__, "fields": self._fields(value)}
        name = type(value).__name__
        if name in _DIFFRAX and type(value) is getattr(diffrax, name) and repr(value) == repr(type(value)()):
            return {"diffrax": name}
        raise NotOursError

    def _fields(self, value: Any) -> dict[str, object]:
        names = getattr(value, "_fields", None) or [one.name for one in dataclasses.fields(value) if one.init]
        # Of these the parts may be a user's own, each by itself.
        encoded = self.encoded if isinstance(value, Origin) else self._encoded
        return {name: encoded(getattr(value, name)) for name in names}

    def _array(self, value: np.ndarray | np.generic | jax.Array) -> dict[str, object]:
        if isinstance(value, jax.Array) and jax.numpy.issubdtype(value.dtype, jax.dtypes.prng_key):
            raise NotOursError
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or array.dtype == np.uint64:
            raise NotOursError
        about: dict[str, object] = {"of": "jax" if isinstance(value, jax.Array) else "numpy", "dtype": str(array.dtype)}
        about |= {"shape": list(array.shape)}
        if array.size <= _SHORT:
            return about | {"values": [self._encoded(entry) for entry in array.reshape(-1).tolist()]}
        store = "floats" if array.dtype.kind == "f" else "integers"
        at = sum(part.size for part in self._parts[store])
        self._parts[store].append(array.reshape(-1).astype(np.float64 if store == "floats" else np.int64))
        return about | {store: at}


@dataclasses.dataclass(frozen=True)
class Decoder:
    """Reads what an `Encoder` wrote; `floats`, `integers`: its long arrays."""

    floats: np.ndarray
    integers: np.ndarray

    def decoded(self, value: object, checked: bool = True) -> Any:
        """The object that an `Encoder` made `value` of; `checked`: whether constructors check its numbers.

        They cannot for a whole batch. Raises ValueError, KeyError or TypeError for what no `Encoder` made.
        """
        if not isinstance(value, dict):
            return value
        if "class" in value:
            return self._object(value["class"], value["fields"], checked)
        if "shape" in value:
            return self._array(value)
        if "float" in value:
            return float(value["float"])
        if "diffrax" in value:
            if value["diffrax"] not in _DIFFRAX:
                raise ValueError(f"it holds a solver {value['diffrax']!r}, which this version does not know")
            return getattr(diffrax, value["diffrax"])()
        ((kind, parts),) = value.items()
        return {"tuple": tuple, "list": list}[kind](self.decoded(part, checked) for part in parts)

    def _object(self, name: str, fields: dict[str, object], checked: bool) -> Any:
        kind = _class_named(name)
        if kind is None:
            raise ValueError(f"it holds a {name}, which this version of stickslip_jax does not know")
        given = {key: self.decoded(part, checked and kind is not GivenMotions) for key, part in fields.items()}
        if checked:
            known = getattr(kind, "__dataclass_fields__", {})

            def is_default(key: str) -> bool:  # it then prints as if it had not been given
                default, part = getattr(known.get(key), "default", dataclasses.MISSING), given[key]
                return type(part) is type(default) and isinstance(part, (str, int, float)) and part == default

            return kind(**{key: part for key, part in given.items() if not is_default(key)})
        made = object.__new__(kind)
        for key, part in given.items():
            object.__setattr__(made, key, part)
        return made

    def _array(self, about: dict[str, Any]) -> np.ndarray | np.generic | jax.Array:
        shape, dtype = tuple(about["shape"]), np.dtype(about["dtype"])
        size = math.prod(shape)
        if dtype.kind not in "fiub" or min(shape, default=0) < 0:
            raise ValueError(f"it holds an array of type {dtype} and shape {shape}")
        if "values" in about:
            flat = [self.decoded(entry) for entry in about["values"]]
        elif "floats" in about:
            flat = self.floats[about["floats"] : about["floats"] + size]
        else:
            flat = self.integers[about["integers"] : about["integers"] + size]
        array = np.asarray(flat).astype(dtype).reshape(shape)
        if about["of"] == "jax":
            return jax.numpy.asarray(array)
        return array if shape else array[()]


def _class_named(name: str) -> type | None:
    """The class that is written by this name: a public one, or one of what an ensemble sums."""
    if name in _INTERNAL:
        return _INTERNAL[name]
    # Looked up when needed, for the package's own names are complete only once all of it is imported; and one by one,
    # because some are loaded when asked for.
    package = sys.modules[__name__.partition(".")[0]]
    found = getattr(package, name) if name in package.__all__ else None
    return found if isinstance(found, type) and hasattr(found, "__annotations__") else None
