"""Blocks of results kept in a folder, so that a call that was stopped goes on where it was."""

import contextlib
import hashlib
import io
import json
import os
import types
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

from .. import _checks
from .._ensemble.encoding import Encoder
from .._fields import is_of_package, modules_in
from .._files import read_regular, remove_unfinished, unpacked_arrays, write_whole
from .._simulation.outputs import code_of
from .._sweep.errors import DamagedBatchError, SweepError
from .._sweep.header import ID_LENGTH, ForeignBatchError, with_header, without_header
from .._sweep.manifest import sum_of, versions
from ._cases import Cases

T = TypeVar("T")
Folder = str | os.PathLike[str]
_DESCRIPTION, _LOCK, _ENDING = "call.json", "lock", ".block"
_NUMBERS = "numbers"
_FEW = 32
_FORMAT = "stickslip_jax nonlinear 1"


class Kept:
    """The blocks in a `folder` that belong to the call of this `identity`; without a folder none."""

    def __init__(self, folder: Path | None = None, identity: bytes = b""):
        self._folder, self._identity = folder, identity

    @property
    def is_used(self) -> bool:
        """Whether blocks are kept."""
        return self._folder is not None

    def block(self, name: str, like: T, run: Callable[[], T]) -> T:
        """The results of a block, arrays of NumPy in a tree like `like`: those that are kept, or what `run` returns."""
        if self._folder is None:
            return run()
        found = self._read(self._folder, name + _ENDING, like)
        if found is None:
            found = run()
            self._write(self._folder, name + _ENDING, found)
        return found

    def _read(self, folder: Path, name: str, like: T) -> T | None:
        """The results that are kept under a name; None where they are not there or damaged."""
        try:
            whole = read_regular(folder / name)
            # They are not compressed.
            arrays = unpacked_arrays(without_header(self._identity, name, whole), 2 * len(whole))
        except (
            FileNotFoundError,
            DamagedBatchError,
            ValueError,
            zipfile.BadZipFile,
        ):  # what is damaged is done again, and replaced
            return None
        except (ForeignBatchError, OSError) as error:
            raise SweepError(f"{folder / name} cannot be read, or is of another call; move it elsewhere.") from error
        structure = jax.tree.structure(like)
        return jax.tree.unflatten(structure, [arrays[f"arr_{number}"] for number in range(structure.num_leaves)])

    def _write(self, folder: Path, name: str, results: Any) -> None:
        data = io.BytesIO()
        np.savez(data, *jax.tree.leaves(results))
        try:
            write_whole(folder / name, with_header(self._identity, name, data.getvalue()))
        except OSError as error:
            raise _cannot_write(folder, error) from error


@contextlib.contextmanager
def kept_in(folder: Folder | None, cases: Cases, what: Mapping[str, int | str]) -> Iterator[Kept]:
    """The blocks in `folder` of a call that is followed for `cases`; `what` else decides its numbers.

    Raises SweepError for a folder that holds something else, is in use, or cannot be written.
    """
    if folder is None:
        yield Kept()
        return
    from .._sweep.locking import locked  # noqa: PLC0415 - needs an extra

    path = _checks.path("folder", folder)
    body = _description(cases, what)
    in_use = f"{path} is in use by another call; wait for it to end, or choose another folder."
    with contextlib.ExitStack() as stack:
        try:
            path.mkdir(parents=True, exist_ok=True)
            _check_holds(path, body)
            stack.enter_context(locked(path / _LOCK, in_use))
            remove_unfinished(path)
            write_whole(path / _DESCRIPTION, json.dumps(body, indent=1).encode())
        except OSError as error:
            raise _cannot_write(path, error) from error
        yield Kept(path, sum_of(body)[:ID_LENGTH].encode())


def _cannot_write(folder: Path, error: OSError) -> SweepError:
    return SweepError(
        f"{folder} cannot be written ({error.strerror or error}); choose another folder, or make it writable and run "
        "again: what is done is kept."
    )


def _description(cases: Cases, what: Mapping[str, int | str]) -> dict[str, Any]:
    """What decides the numbers of a call, each under the name of the argument."""
    setting, encoder = cases.setter.setting, Encoder()
    named = {"system": setting.system, "base": setting.law, "method": setting.method}
    encoded = {name: encoder.encoded(value) for name, value in named.items()}
    arrays = [
        encoder.floats,
        encoder.integers,
        *(leaf for leaf in jax.tree.leaves(cases.cycle) if hasattr(leaf, "shape")),
    ]
    return {
        "format": _FORMAT,
        **what,
        **encoded,
        "over": {} if cases.points is None else {one.name: _values(one.values) for one in cases.points.dimensions},
        "y0": _values(cases.starts[: cases.number // (1 if cases.points is None else cases.points.number)]),
        "period": _values(np.unique(np.asarray(cases.cycle.duration))),
        _NUMBERS: _sum(*arrays),
        "code of your classes": _code(*named.values()),
        "precision": str(np.dtype(cases.dtype)),
        "versions": versions(),
    }


def _values(array: np.ndarray) -> list[Any] | str:
    """Its values, if there are few, or a check sum."""
    return array.tolist() if array.size <= _FEW else f"{array.size} numbers, check sum {_sum(array)}"


def _sum(*arrays: Any) -> str:
    found = hashlib.sha256()
    for array in map(np.ascontiguousarray, arrays):
        found.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return found.hexdigest()[:16]


def _code(*parts: object) -> str:
    """A check sum of the code of all classes in `parts` that are not the package's own; "" if there is none."""
    kinds = {type(module) for module in modules_in(parts) if not is_of_package(module)}
    own = sorted(
        {one for kind in kinds for one in kind.__mro__ if one.__module__.split(".")[0] not in _LIBRARIES}, key=repr
    )
    lines = [line for kind in own for name in vars(kind) for line in _lines(getattr(kind, name, None))]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16] if lines else ""


_LIBRARIES = ("stickslip_jax", "equinox", "builtins", "abc", "typing")


def _lines(value: object) -> Iterator[str]:
    function = value.fget if isinstance(value, property) else value
    if isinstance(function, types.FunctionType):
        yield from code_of(function)


def _check_holds(folder: Path, body: Mapping[str, Any]) -> None:
    """Raises SweepError unless `folder` is empty or holds blocks of the same call."""
    others = sorted(entry.name for entry in folder.iterdir() if entry.name != _LOCK)
    if _DESCRIPTION not in others:
        if others:
            raise SweepError(
                f"{folder} is not empty and holds no results of such a call (it has {others[0]}); choose an empty or a "
                "new folder."
            )
        return
    try:
        there = json.loads(read_regular(folder / _DESCRIPTION))
        assert isinstance(there, dict)
    except (ValueError, AssertionError):
        raise SweepError(f"{folder / _DESCRIPTION} is damaged; choose another folder.") from None
    here = json.loads(json.dumps(body))
    different = [name for name in {**there, **here} if there.get(name) != here.get(name)]
    if different:
        different = [name for name in different if name != _NUMBERS] or different
        shown = "; ".join(
            f"{name}: {_brief(there.get(name))} there, {_brief(here.get(name))} here" for name in different
        )
        raise SweepError(
            f"{folder} holds results of another call ({shown}); choose another folder, or change the call back."
        )


def _brief(value: object) -> str:
    if isinstance(value, dict) and "class" in value:
        value = value["fields"].get("text") or f"{value['class']} {json.dumps(value['fields'])}"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."
