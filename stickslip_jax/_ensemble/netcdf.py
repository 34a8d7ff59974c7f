"""Data sets in NetCDF 4 files that show whether they are as they were written.

A SHA-256 sum over all names, numbers and attributes is an attribute itself. HDF5 keeps check sums of the arrays
besides, for other programs.
"""

import hashlib
import json
import sys
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._processor import require_memory

if TYPE_CHECKING:
    import xarray

SUM = "content_sha256"
"""The attribute that holds the sum."""


class DamagedFileError(ValueError):
    """A file that cannot be read, or is not as it was written; its message says why, in a few words."""


def as_netcdf(
    dataset: "xarray.Dataset",
    packing: Mapping[Any, Mapping[str, object]],
    groups: "Mapping[str, xarray.Dataset] | None" = None,
) -> memoryview:
    """The bytes of a NetCDF 4 file of a data set, and of others in groups.

    They are made in memory: HDF5 ends the process where a disk is full. `packing`: how to compress variables.
    """
    buffer = BytesIO()
    with _without_cluster():
        for group, part in {None: dataset, **(groups or {})}.items():
            options = {name: {"fletcher32": True} for name, variable in part.variables.items() if _has_sums(variable)}
            if group is None:
                options = {name: {**options.get(name, {}), **packing.get(name, {})} for name in {*options, *packing}}
            part.assign_attrs({SUM: sum_of(part)}).to_netcdf(
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
    stated = dataset.attrs.get(SUM)
    if stated is None:
        if is_file:
            raise DamagedFileError("it lacks its check sum")
        return dataset
    rest = dataset.copy(deep=False)
    del rest.attrs[SUM]
    if sum_of(rest) != stated:
        raise DamagedFileError("its content is not what was written: the check sum is another")
    return rest


def sum_of(dataset: "xarray.Dataset") -> str:
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


def _has_sums(variable: "xarray.Variable") -> bool:
    return variable.ndim > 0 and variable.size > 0 and variable.dtype.kind in "biuf"


@contextmanager
def _without_cluster() -> Iterator[None]:
    """Where this process has a client of dask, xarray would ask the cluster for a lock to write memory (and fail)."""
    if "dask.base" not in sys.modules:
        yield
        return
    with sys.modules["dask"].config.set(scheduler="synchronous"):
        yield
