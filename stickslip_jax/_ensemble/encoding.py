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
from collections.abc import Hashable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.lib
import numpy as np

from .._excitation.suites import StoredRecords
from .._foundation import lazy_diffrax as diffrax
from .._foundation.extras import require
from .._foundation.files import FULL
from .._foundation.processes import require_memory
from .._numerics.sums import DyadicCounts, Moments, PowerSums
from .._statistics.quantities import StickAccumulator
from .._systems.friction import TabulatedCurve
from .._uncertainty.design import Design
from .data import GivenMotions, Origin, Unknown, UnknownSystem

if TYPE_CHECKING:
    import xarray

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


# Data sets in NetCDF 4 files that show whether they are as they were written.
#
# A SHA-256 sum over all names, numbers and attributes is an attribute itself. HDF5 keeps check sums of the arrays
# besides, for other programs.


CONTENT_SUM = "content_sha256"
"""The attribute that holds the sum."""


def as_netcdf(
    dataset: "xarray.Dataset",
    packing: Mapping[Any, Mapping[str, object]],
    groups: "Mapping[str, xarray.Dataset] | None" = None,
) -> memoryview:
    """The bytes of a NetCDF 4 file of a data set, and of others in groups.

    They are made in memory: HDF5 ends the process where a disk is full. `packing`: how to compress variables.
    """
    buffer, waiting = BytesIO(), contextlib.nullcontext()
    if "dask.base" in sys.modules:  # with a client of it, xarray would ask the cluster for a lock, and fail
        waiting = sys.modules["dask"].config.set(scheduler="synchronous")
    with waiting:
        for group, part in {None: dataset, **(groups or {})}.items():
            arrays = {name: one for name, one in part.variables.items() if one.ndim and one.size}
            options = {name: {"fletcher32": True} for name, one in arrays.items() if one.dtype.kind in "biuf"}
            if group is None:
                options = {name: {**options.get(name, {}), **packing.get(name, {})} for name in {*options, *packing}}
            part.assign_attrs({CONTENT_SUM: sum_of_content(part)}).to_netcdf(
                buffer, mode="w" if group is None else "a", group=group, engine="h5netcdf", encoding=options
            )
    return buffer.getbuffer()


def read_netcdf(path: Path) -> "xarray.Dataset":
    """The data set in a file, not `verified`.

    Raises:
        DamagedFileError: For what cannot be read.
        ValueError: For what is larger than the memory.
        ImportError: Without the extra.
    """
    import h5py  # noqa: PLC0415 - an extra, loaded when asked for
    import xarray as xr  # noqa: PLC0415

    if not path.is_file():
        raise DamagedFileError("it is no ordinary file")
    size = 0.0

    def look(_: str, part: Any) -> None:
        nonlocal size
        dict(part.attrs)
        size += float(getattr(part, "nbytes", 0))  # of an array

    try:
        with h5py.File(path) as file:  # all names and attributes: where h5netcdf fails, it prints a traceback besides
            dict(file.attrs)
            file.visititems(look)
    except Exception as error:  # of h5py, h5netcdf and xarray, which raise any kind for a damaged file
        raise _damaged(error) from error
    require_memory("path", size, f"what {str(path)!r} holds")  # packed, or never written: the file may be small
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except ImportError:
        raise
    except Exception as error:
        raise _damaged(error) from error


def _damaged(error: Exception) -> DamagedFileError:
    return DamagedFileError(" ".join(str(error).split()) or type(error).__name__)


def verified(dataset: "xarray.Dataset", *, is_file: bool = True) -> "xarray.Dataset":
    """The data set without its sum. Raises DamagedFileError where the content has another, or none in a file."""
    stated = dataset.attrs.get(CONTENT_SUM)
    if stated is None:
        if is_file:
            raise DamagedFileError("it lacks its check sum")
        return dataset
    rest = dataset.copy(deep=False)
    del rest.attrs[CONTENT_SUM]
    if sum_of_content(rest) != stated:
        raise DamagedFileError("its content is not what was written: the check sum is another")
    return rest


def sum_of_content(dataset: "xarray.Dataset") -> str:
    """The SHA-256 sum of the content of a data set, the same before it is written and after it is read."""
    found = hashlib.sha256(_text(dataset.attrs))
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        values = np.asarray(variable.values)
        numbers = values.dtype.kind in "biufc"
        about = [name, list(map(str, variable.dims)), list(values.shape), values.dtype.str if numbers else "text"]
        found.update(_text(variable.attrs) + json.dumps(about).encode())
        found.update(values.tobytes() if numbers else json.dumps(values.astype(str).tolist()).encode())
    return found.hexdigest()


def _text(attributes: Mapping[Hashable, Any]) -> bytes:
    """Attributes as text, lists of one number as the number, which they become in a file."""
    plain = {str(name): np.atleast_1d(np.asarray(value)).tolist() for name, value in attributes.items()}
    return json.dumps(plain, sort_keys=True).encode()


# Objects of this package as JSON, with long arrays beside it, and back.


_SHORT = 32  # entries: longer arrays stand beside the JSON
_INTERNAL: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Design, DyadicCounts, GivenMotions, Moments, Origin, PowerSums, StickAccumulator, StoredRecords, TabulatedCurve,
        Unknown, UnknownSystem,
    )
}  # fmt: skip
_MOST_POINTS = 2**20  # of records in a suite: a larger one is known by its check sum, as it prints, and not stored
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
        if (
            type(value).__name__ == StoredRecords.__name__
            and np.size(getattr(value, "accelerations", ())) > _MOST_POINTS
        ):
            raise NotOursError
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
