"""Cases followed from period to period, in blocks over threads, kept in a folder if one is named."""

import contextlib
import hashlib
import io
import json
import os
import types
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._dynamics.simulate import code_of
from .._dynamics.sticks import Sticks
from .._ensemble.encoding import (
    Encoder,
    ForeignFileError,
    SweepError,
    id_of,
    locked,
    versions,
    with_header,
    without_header,
)
from .._ensemble.parts import progress_bar
from .._foundation import checks
from .._foundation.fields import is_of_package, modules_in
from .._foundation.files import read_regular, remove_unfinished, unpacked_arrays, write_whole
from .._foundation.processes import cores, require_memory
from .._foundation.types import AnyArray, Ending, FloatArray, IntArray, Status
from ._cases import Cases, Cycle, Followed

# Blocks of results kept in a folder, so that a call that was stopped goes on where it was.


T = TypeVar("T")
Folder = str | os.PathLike[str]
_DESCRIPTION, _LOCK, _ENDING = "call.json", "lock", ".block"
_NUMBERS = "numbers"
_LIBRARIES = ("stickslip_jax", "equinox", "builtins", "abc", "typing")
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

    def block(self, name: str, kind: Callable[..., T], run: Callable[[], T]) -> T:
        """The results of a block, arrays of NumPy in a `kind` of tuple: those that are kept, or what `run` returns."""
        if self._folder is None:
            return run()
        path = self._folder / (name + _ENDING)
        try:
            whole = read_regular(path)
            # They are not compressed.
            arrays = unpacked_arrays(without_header(self._identity, path.name, whole), 2 * len(whole))
        except (FileNotFoundError, ValueError, zipfile.BadZipFile):
            arrays = None  # what is damaged is done again, and replaced
        except (ForeignFileError, OSError) as error:
            raise SweepError(f"{path} cannot be read, or is of another call; move it elsewhere.") from error
        if arrays is not None:
            return kind(*(arrays[f"arr_{number}"] for number in range(len(arrays))))
        found = run()
        self._write(path, found)
        return found

    def _write(self, path: Path, results: Any) -> None:
        data = io.BytesIO()
        np.savez(data, *results)
        try:
            write_whole(path, with_header(self._identity, path.name, data.getvalue()))
        except OSError as error:
            raise _cannot_write(path.parent, error) from error


@contextlib.contextmanager
def kept_in(folder: Folder | None, cases: Cases, what: Mapping[str, int | str]) -> Iterator[Kept]:
    """The blocks in `folder` of a call that is followed for `cases`; `what` else decides its numbers.

    Raises SweepError for a folder that holds something else, is in use, or cannot be written.
    """
    if folder is None:
        yield Kept()
        return
    path = checks.path("folder", folder)
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
        yield Kept(path, id_of(body))


def _cannot_write(folder: Path, error: OSError) -> SweepError:
    return SweepError(
        f"{folder} cannot be written ({error.strerror or error}); choose another folder, or make it writable and run "
        "again: what is done is kept."
    )


def _description(cases: Cases, what: Mapping[str, int | str]) -> dict[str, Any]:
    """What decides the numbers of a call, each under the name of the argument."""
    setting, points, encoder = cases.setter.setting, cases.points, Encoder()
    named = {"system": setting.system, "base": setting.law, "method": setting.method}
    encoded = {name: encoder.encoded(value) for name, value in named.items()}
    leaves = [leaf for leaf in jax.tree.leaves(cases.cycle) if hasattr(leaf, "shape")]

    # The code of all classes that are not the package's own.
    kinds = {type(module) for module in modules_in(tuple(named.values())) if not is_of_package(module)}
    own = {one for kind in kinds for one in kind.__mro__ if one.__module__.split(".")[0] not in _LIBRARIES}
    members = [getattr(kind, name, None) for kind in sorted(own, key=repr) for name in vars(kind)]
    functions = [one.fget if isinstance(one, property) else one for one in members]
    lines = [line for one in functions if isinstance(one, types.FunctionType) for line in code_of(one)]

    return {
        "format": _FORMAT,
        **what,
        **encoded,
        "over": {one.name: _values(one.values) for one in points.dimensions},
        "y0": _values(cases.starts[: cases.number // points.number]),
        "period": _values(np.unique(np.asarray(cases.cycle.duration))),
        _NUMBERS: _sum(encoder.floats, encoder.integers, *leaves),
        "code of your classes": hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16] if lines else "",
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
        shown = [f"{name}: {_brief(there.get(name))} there, {_brief(here.get(name))} here" for name in different]
        raise SweepError(
            f"{folder} holds results of another call ({'; '.join(shown)}); choose another folder, or change the call "
            "back."
        )


def _brief(value: object) -> str:
    if isinstance(value, dict) and "class" in value:
        value = value["fields"].get("text") or f"{value['class']} {json.dumps(value['fields'])}"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."


# Cases followed from period to period, in blocks over threads.


_LANES = 512  # cases of a block: their arrays stay in the cache
_STORED_BLOCKS = 8  # at least, if there are as many cases
_INSTANTS = (0.1, 0.35, 0.6, 0.85)  # of a period, at which the size of a motion is looked at
_AT_REST = 1e-3  # of its size in the transient periods: a number that falls below is taken as zero
_PARTS = 20  # in which values are followed one after another, so that progress can be shown
_MOST_DOUBLINGS = 6  # of the number of steps in a period, before a case is given up


class SeenCases(NamedTuple):
    """What is seen of each case at the ends of the periods kept: states (cases, periods, coordinates), sticks (cases,
    periods) or (cases, periods, contacts), and of each case (cases,) the `Status` and how often round-off decided.

    - `sizes`: the largest size of each number of the state within the periods kept, at a few instants, or a thousandth
      of that at the ends of the periods before, where that is larger, (cases, coordinates).
    - `stick_count`, `stick_time`, `longest_stick`: the number of sticks that begin in the period, the time in sticks
      (s), and the longest stick that ends in it or lasts beyond it, from its beginning (s).
    """

    states: Array
    sizes: Array
    stick_count: Array
    stick_time: Array
    longest_stick: Array
    status: Array
    near_grazing_count: Array


FollowedT = TypeVar("FollowedT", bound=Followed)


def sticks_of_period(sticks: Sticks, age: FloatArray) -> tuple[FloatArray, tuple[IntArray, FloatArray, FloatArray]]:
    """How long each contact has been stuck at the end of a period (s); `age`: at its beginning. And the number of
    sticks, their time, and the longest one, as in `SeenCases`.
    """

    def of(held: AnyArray, age: FloatArray):
        goes_on = held & (sticks.start == 0) & (age > 0)
        duration = jnp.where(held, sticks.end - sticks.start, 0)
        whole = duration + jnp.where(goes_on, age, 0)
        lasts = held & (sticks.ending == int(Ending.HORIZON))
        begun = jnp.sum(held) - jnp.sum(goes_on)
        return jnp.max(jnp.where(lasts, whole, 0)), (begun, jnp.sum(duration), jnp.max(whole))

    if sticks.contact is None or not age.ndim:
        return of(sticks.mask, age)
    numbers = jnp.arange(age.shape[0])
    return jax.vmap(lambda number, age: of(sticks.mask & (sticks.contact == number), age))(numbers, age)


def _followed(cycle: Cycle, starts: Array, transient: IntArray, *, kept: int) -> SeenCases:
    """Cases over `transient` periods, and then over the `kept` ones."""

    def period(carry):
        def one(cycle, y, age, status, close, size):
            after = cycle.after(y)
            age, sticks = sticks_of_period(after.sticks, age)
            status = jnp.where(status == int(Status.FINISHED), after.status, status)
            size = jnp.fmax(size, jnp.abs(y))
            y = jnp.where(status == int(Status.FINISHED), jnp.stack(after.final_state), jnp.nan)
            inside = jnp.stack(after.evaluate(jnp.asarray(_INSTANTS, y.dtype) * cycle.duration))
            carry = (y, age, status, close + after.near_grazing_count.astype(jnp.int32), size)
            return carry, (sticks, jnp.max(jnp.abs(inside), axis=1))

        return eqx.filter_vmap(one)(cycle, *carry)

    contacts = cycle.system.tracks.contacts if cycle.system.tracks.number is not None else None
    ages = jnp.zeros((len(starts),) if contacts is None else (len(starts), contacts), starts.dtype)
    none = jnp.zeros(len(starts), jnp.int32)
    begun = (starts, ages, none, none, jnp.abs(starts))
    begun = lax.fori_loop(0, transient, lambda _, carry: period(carry)[0], begun)

    def keep(carry, _):
        carry, (sticks, sizes) = period(carry)
        return carry, (carry[0], sticks, sizes)

    (_, _, status, close, _), (states, sticks, sizes) = lax.scan(keep, begun, length=kept)
    states, number, time, longest = (jnp.moveaxis(leaf, 0, 1) for leaf in (states, *sticks))
    largest = jnp.fmax(jnp.max(sizes, axis=0), _AT_REST * begun[4])
    return SeenCases(states, largest, number, time, longest, status, close)


_follow = eqx.filter_jit(_followed)


@eqx.filter_jit
def _follow_along(cycle: Cycle, begin: Array, starts: Array, transient: IntArray, *, kept: int) -> SeenCases:
    """As `_followed`, of arrays (values, cases, ...), each value of a parameter from where the one before ended; the
    first from `begin` (cases, coordinates), and what was not followed to the end from `starts`.
    """
    arrays, rest = eqx.partition(cycle, eqx.is_array)

    def one_value(y: Array, own: Cycle) -> tuple[Array, SeenCases]:
        seen = _followed(eqx.combine(own, rest), y, transient, kept=kept)
        return _next_start(seen.states[:, -1], starts), seen

    return lax.scan(one_value, begin, arrays)[1]


def _next_start(last: Array, starts: Array) -> Array:
    """The `last` states (cases, coordinates), and the `starts` of those that were not followed to the end."""
    return jnp.where(jnp.all(jnp.isfinite(last), axis=1, keepdims=True), last, starts)


def follow_along(
    cases: Cases, transient: int, kept: int, progress: bool | None, stored: Kept, *, descending: bool
) -> SeenCases:
    """As `follow`, each value of the first parameter from where the one before it ended, in the order of its values.

    `descending`: from the last value to the first.
    """
    values = cases.shape[0]
    order = np.arange(values)[:: -1 if descending else 1]
    by_value = np.arange(cases.number).reshape(values, -1)[order]
    size = -(-values // _PARTS)
    # The last part repeats its last value, so that all are of one size, and compiled once.
    parts = by_value[np.minimum(np.arange(-(-values // size) * size), values - 1)].reshape(-1, size, by_value.shape[1])
    starts = jnp.asarray(cases.starts[by_value[0]], cases.dtype)
    begin, found = starts, []
    with progress_bar(progress, cases.number) as bar:
        for number, part in enumerate(parts):

            def run(cycle: Cycle, part: np.ndarray = part, begin: Array = begin) -> SeenCases:
                return _follow_along(cycle.of(part), begin, starts, jnp.asarray(transient, jnp.int32), kept=kept)

            name = f"{'down' if descending else 'up'}-{number:04}"
            found.append(stored.block(name, SeenCases, lambda run=run: _with_enough_steps(cases, run)))
            begin = _next_start(jnp.asarray(found[-1].states[-1, :, -1]), starts)
            bar.advance(min(part.size, cases.number - (len(found) - 1) * part.size))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:values], *found)
    # The order is its own inverse.
    return jax.tree.map(lambda leaf: leaf[order].reshape(cases.number, *leaf.shape[2:]), whole)


def follow(
    cases: Cases, transient: int, kept: int, progress: bool | None = None, stored: Kept | None = None
) -> SeenCases:
    """What is seen of the cases in the `kept` periods after the `transient` ones, as arrays of NumPy."""
    numbers = cases.starts.shape[1] + 3 * (cases.system.tracks.contacts or 1)
    require_memory("kept", 8.0 * cases.number * kept * numbers, "the states at the ends of so many periods")
    return in_blocks(cases, periods_of(transient, kept), SeenCases, progress, stored or Kept())


def periods_of(transient: int, kept: int) -> Callable[[Cycle, Array], SeenCases]:
    """How the cases of a block are followed for `in_blocks`."""

    def run(cycle: Cycle, starts: Array) -> SeenCases:
        return _follow(cycle, starts, jnp.asarray(transient, jnp.int32), kept=kept)

    return run


def block_size(number: int, stored: Kept) -> int:
    """How many cases are followed side by side."""
    # Blocks that are stored are the same on every machine.
    return min(_LANES, -(-number // (_STORED_BLOCKS if stored.is_used else cores())))


def in_blocks(
    cases: Cases, run: Callable[[Cycle, Array], FollowedT], kind: Callable[..., FollowedT], progress: bool | None,
    stored: Kept, size: int | None = None, name: str = "block",
) -> FollowedT:  # fmt: skip
    """`run` over all cases, in blocks over threads; its results joined, arrays of NumPy with a first axis (cases,).

    A block in which steps ran out, as the ``status`` of its results says, is followed again with twice as many. Blocks
    that are `stored` are taken from there, by `name` and number; `kind`: of tuple of the results. `size`: of a block.
    """
    size = block_size(cases.number, stored) if size is None else size
    blocks = -(-cases.number // size)
    # The last block repeats its last case, so that all are of one size, and compiled once.
    numbers = np.minimum(np.arange(blocks * size), cases.number - 1).reshape(blocks, size)

    def one(block: int) -> FollowedT:
        which = numbers[block]
        starts = jnp.asarray(cases.starts[which], cases.dtype)

        def run_block(cycle: Cycle) -> FollowedT:
            return run(cycle.of(which), starts)

        return stored.block(f"{name}-{block:06}", kind, lambda: _with_enough_steps(cases, run_block))

    with progress_bar(progress, cases.number) as bar, ThreadPoolExecutor(cores()) as pool:
        found = []
        for part in pool.map(one, range(blocks)):
            found.append(part)
            bar.advance(min(size, cases.number - (len(found) - 1) * size))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: cases.number], *found)


def _with_enough_steps(cases: Cases, run: Callable[[Cycle], FollowedT]) -> FollowedT:
    """What `run` returns, as arrays of NumPy; run again with twice the steps while these run out, unless their number
    was given.
    """
    cycle, is_given = cases.cycle, cases.setter.setting.method.max_steps is not None
    found = jax.tree.map(np.asarray, run(cycle))
    for _ in range(_MOST_DOUBLINGS):
        steps = cycle.method.max_steps
        if is_given or steps is None or not np.any(found.status == int(Status.OUT_OF_STEPS)):
            break
        cycle = replace(cycle, method=replace(cycle.method, max_steps=2 * steps))
        found = jax.tree.map(np.asarray, run(cycle))
    return found


# Warnings of cases that were not followed to the end.


def warn_of_unfinished(found: Followed) -> None:
    """Warn (RuntimeWarning) the caller's caller of cases that were not followed to the end, and say why."""
    bad = found.status[found.status != int(Status.FINISHED)]
    if len(bad):
        codes, counts = np.unique(bad, return_counts=True)
        why = [f"{count} because {Status(int(code)).meaning}" for code, count in zip(codes, counts, strict=True)]
        warnings.warn(
            f"{len(bad)} of {len(found.status)} cases were not followed to the end: {'; '.join(why)}. They hold NaN "
            "from there on, and the variable status says which they are.",
            RuntimeWarning,
            stacklevel=3,
        )


def warn_of_unsettled(unsettled: np.ndarray, so_far: str, argument: str, stacklevel: int) -> None:
    """Warn (RuntimeWarning) of the cases that are `unsettled`, which a larger `argument` lets go on."""
    if np.any(unsettled):
        warnings.warn(
            f"{np.sum(unsettled)} of {np.size(unsettled)} motions have not settled within {so_far}: differences "
            f"between their returns still fall or grow, which the result says of each. A larger {argument} lets them "
            "go on; near a bifurcation that may take very long.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )
