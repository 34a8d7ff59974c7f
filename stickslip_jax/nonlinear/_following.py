"""Cases followed from period to period, in blocks over threads, kept in a folder if one is named."""

import contextlib
import hashlib
import io
import json
import os
import types
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._dynamics.simulate import code_of
from .._dynamics.simulation import Simulation, provenance, source
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
from .._ensemble.points import label_and_unit
from .._foundation import checks
from .._foundation.extras import Entries, flags, labeled_dataset, variable
from .._foundation.fields import is_of_package, modules_in
from .._foundation.files import read_regular, remove_unfinished, unpacked_arrays, write_whole
from .._foundation.processes import cores, require_memory
from .._foundation.types import AnyArray, Ending, FloatArray, IntArray, Status
from ._cases import Cases, Cycle

if TYPE_CHECKING:
    import xarray


# Blocks of results kept in a folder, so that a call that was stopped goes on where it was.


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
        except (FileNotFoundError, ValueError, zipfile.BadZipFile):  # what is damaged is done again, and replaced
            return None
        except (ForeignFileError, OSError) as error:
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


# Cases followed from period to period, in blocks over threads.


_LANES = 512  # cases of a block: their arrays stay in the cache
_STORED_BLOCKS = 8  # at least, if there are as many cases
_INSTANTS = (0.1, 0.35, 0.6, 0.85)  # of a period, at which the size of a motion is looked at
_AT_REST = 1e-3  # of its size in the transient periods: a number that falls below is taken as zero
_PARTS = 20  # in which values are followed one after another, so that progress can be shown
_MOST_DOUBLINGS = 6  # of the number of steps in a period, before a case is given up


class SticksOfPeriod(NamedTuple):
    """Of one period, and of each contact of a list: the number of sticks that begin in it, the time in sticks (s), and
    the longest stick that ends in it or lasts beyond it, from its beginning (s).
    """

    begun: IntArray
    time: FloatArray
    longest: FloatArray


class SeenCases(NamedTuple):
    """What is seen of each case at the ends of the periods kept: states (cases, periods, coordinates), sticks (cases,
    periods) or (cases, periods, contacts), and of each case (cases,) the `Status` and how often round-off decided.

    `sizes`: the largest size of each number of the state within the periods kept, at a few instants, or a thousandth of
    that at the ends of the periods before, where that is larger, (cases, coordinates).
    """

    states: Array
    sizes: Array
    sticks: SticksOfPeriod
    status: Array
    near_grazing_count: Array


SEEN = SeenCases(0, 0, SticksOfPeriod(0, 0, 0), 0, 0)  # pyright: ignore[reportArgumentType] - only its tree counts


@runtime_checkable
class Followed(Protocol):
    """Results of cases with their `Status`."""

    @property
    def status(self) -> Array: ...


FollowedT = TypeVar("FollowedT", bound=Followed)


def start_age(cycle: Cycle, dtype) -> FloatArray:
    """How long each contact has been stuck before the first period: 0."""
    contacts = cycle.system.tracks.contacts if cycle.system.tracks.number is not None else None
    return jnp.zeros(() if contacts is None else (contacts,), dtype)


def sticks_of_period(one: Simulation, age: FloatArray) -> tuple[SticksOfPeriod, FloatArray]:
    """The sticks of one period, and how long each contact has been stuck at its end; `age`: at its beginning (s)."""
    sticks = one.sticks

    def of(held: AnyArray, age: FloatArray) -> tuple[SticksOfPeriod, FloatArray]:
        return _of_contact(sticks, held, age)

    if sticks.contact is None or not age.ndim:
        return of(sticks.mask, age)
    numbers = jnp.arange(age.shape[0])
    return jax.vmap(lambda number, age: of(sticks.mask & (sticks.contact == number), age))(numbers, age)


def _of_contact(sticks: Sticks, held: AnyArray, age: FloatArray) -> tuple[SticksOfPeriod, FloatArray]:
    goes_on = held & (sticks.start == 0) & (age > 0)
    duration = jnp.where(held, sticks.end - sticks.start, 0)
    whole = duration + jnp.where(goes_on, age, 0)
    lasts = held & (sticks.ending == int(Ending.HORIZON))
    begun = jnp.sum(held) - jnp.sum(goes_on)
    return SticksOfPeriod(begun, jnp.sum(duration), jnp.max(whole)), jnp.max(jnp.where(lasts, whole, 0))


def _followed(cycle: Cycle, starts: Array, transient: IntArray, *, kept: int) -> SeenCases:
    """Cases over `transient` periods, and then over the `kept` ones."""

    def period(carry):
        def one(cycle, y, age, status, close, size):
            after = cycle.after(y)
            sticks, age = sticks_of_period(after, age)
            status = jnp.where(status == int(Status.FINISHED), after.status, status)
            size = jnp.fmax(size, jnp.abs(y))
            y = jnp.where(status == int(Status.FINISHED), jnp.stack(after.final_state), jnp.nan)
            inside = jnp.stack(after.evaluate(jnp.asarray(_INSTANTS, y.dtype) * cycle.duration))
            carry = (y, age, status, close + after.near_grazing_count.astype(jnp.int32), size)
            return carry, (sticks, jnp.max(jnp.abs(inside), axis=1))

        return eqx.filter_vmap(one)(cycle, *carry)

    ages = start_age(cycle, starts.dtype)
    none = jnp.zeros(len(starts), jnp.int32)
    begun = (starts, jnp.zeros((len(starts), *ages.shape), starts.dtype), none, none, jnp.abs(starts))
    begun = lax.fori_loop(0, transient, lambda _, carry: period(carry)[0], begun)

    def keep(carry, _):
        carry, (sticks, sizes) = period(carry)
        return carry, (carry[0], sticks, sizes)

    (_, _, status, close, _), (states, sticks, sizes) = lax.scan(keep, begun, length=kept)
    states, sticks = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), (states, sticks))
    return SeenCases(states, jnp.fmax(jnp.max(sizes, axis=0), _AT_REST * begun[4]), sticks, status, close)


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
    order = np.arange(values)[::-1] if descending else np.arange(values)
    by_value = np.arange(cases.number).reshape(values, -1)[order]
    size = -(-values // _PARTS)
    # The last part repeats its last value, so that all are of one size, and compiled once.
    parts = by_value[np.minimum(np.arange(-(-values // size) * size), values - 1)].reshape(-1, size, by_value.shape[1])
    starts = jnp.asarray(cases.starts[by_value[0]], cases.dtype)
    begin, found = starts, []
    with progress_bar(progress, cases.number) as bar:
        for number, part in enumerate(parts):

            def run(cycle: Cycle, part: np.ndarray = part, begin: Array = begin) -> SeenCases:
                own = jax.tree.map(lambda leaf: leaf[part] if eqx.is_array(leaf) else leaf, cycle)
                return _follow_along(own, begin, starts, jnp.asarray(transient, jnp.int32), kept=kept)

            name = f"{'down' if descending else 'up'}-{number:04}"
            found.append(stored.block(name, SEEN, lambda run=run: _with_enough_steps(cases, run)))
            begin = _next_start(jnp.asarray(found[-1].states[-1, :, -1]), starts)
            bar.advance(min(part.size, cases.number - (len(found) - 1) * part.size))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:values], *found)
    back = np.argsort(order)
    return jax.tree.map(lambda leaf: leaf[back].reshape(cases.number, *leaf.shape[2:]), whole)


def follow(
    cases: Cases, transient: int, kept: int, progress: bool | None = None, stored: Kept | None = None
) -> SeenCases:
    """What is seen of the cases in the `kept` periods after the `transient` ones, as arrays of NumPy."""
    numbers = cases.starts.shape[1] + 3 * (cases.system.tracks.contacts or 1)
    require_memory("kept", 8.0 * cases.number * kept * numbers, "the states at the ends of so many periods")
    return in_blocks(cases, periods_of(transient, kept), SEEN, progress, Kept() if stored is None else stored)


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
    cases: Cases, run: Callable[[Cycle, Array], FollowedT], like: FollowedT, progress: bool | None, stored: Kept,
    size: int | None = None, name: str = "block",
) -> FollowedT:  # fmt: skip
    """`run` over all cases, in blocks over threads; its results joined, arrays of NumPy with a first axis (cases,).

    A block in which steps ran out, as the ``status`` of its results says, is followed again with twice as many. Blocks
    that are `stored` are taken from there, by `name` and number; `like`: the tree of the results. `size`: of a block.
    """
    threads = cores()
    size = block_size(cases.number, stored) if size is None else size
    blocks = -(-cases.number // size)
    # The last block repeats its last case, so that all are of one size, and compiled once.
    numbers = np.minimum(np.arange(blocks * size), cases.number - 1).reshape(blocks, size)

    def one(block: int) -> FollowedT:
        which = numbers[block]
        starts = jnp.asarray(cases.starts[which], cases.dtype)

        def run_block(cycle: Cycle) -> FollowedT:
            own = jax.tree.map(lambda leaf: leaf[which] if eqx.is_array(leaf) else leaf, cycle)
            return run(own, starts)

        return stored.block(f"{name}-{block:06}", like, lambda: _with_enough_steps(cases, run_block))

    with progress_bar(progress, cases.number) as bar, ThreadPoolExecutor(threads) as pool:
        found = []
        for part in pool.map(one, range(blocks)):
            found.append(part)
            bar.advance(min(size, cases.number - (len(found) - 1) * size))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: cases.number], *found)


def _with_enough_steps(cases: Cases, run: Callable[[Cycle], FollowedT]) -> FollowedT:
    """What `run` returns, as arrays of NumPy; run again with twice the steps while these run out, unless their number
    was given.
    """
    found = jax.tree.map(np.asarray, run(cases.cycle))
    for doublings in range(1, _MOST_DOUBLINGS + 1 if cases.may_take_more else 0):
        if not np.any(found.status == int(Status.OUT_OF_STEPS)):
            break
        found = jax.tree.map(np.asarray, run(cases.with_steps(2**doublings).cycle))
    return found


# Warnings of cases that were not followed to the end.


def warn_of_unfinished(status: object, stacklevel: int) -> None:
    """Warn (RuntimeWarning) if any `Status` code (cases,) is not FINISHED, and say why."""
    codes, counts = np.unique(np.asarray(status), return_counts=True)
    bad = [
        (Status(int(code)), int(count)) for code, count in zip(codes, counts, strict=True) if code != Status.FINISHED
    ]
    if bad:
        number = sum(count for _, count in bad)
        why = "; ".join(f"{count} because {code.meaning}" for code, count in bad)
        warnings.warn(
            f"{number} of {np.size(np.asarray(status))} cases were not followed to the end: {why}. They hold NaN from "
            "there on, and the variable status says which they are.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


def warn_of_unsettled(unsettled: np.ndarray, so_far: int, more: str, stacklevel: int, *, what: str = "periods") -> None:
    """Warn (RuntimeWarning) of the cases that are `unsettled`; `more` begins the sentence on what lets them go on."""
    if np.any(unsettled):
        warnings.warn(
            f"{np.sum(unsettled)} of {np.size(unsettled)} motions have not settled within {so_far} {what}: differences "
            f"between their returns still fall or grow, which the result says of each. {more} them go on; near a "
            "bifurcation that may take very long.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


def warn_of_missing(missing: int, cases: int, periods: int, stacklevel: int) -> None:
    """Warn (RuntimeWarning) if in some cases fewer events were found than are asked for."""
    if missing:
        warnings.warn(
            f"In {missing} of {cases} cases fewer events were found in {periods} periods than are asked for: the "
            "variable event_count says how many. Their places hold NaN; the motion may have come to rest, or never "
            "pass there.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


def warn_of_none(number: int, starts: int, most: int, stacklevel: int) -> None:
    """Warn (RuntimeWarning) of starts on no attractor."""
    if number:
        warnings.warn(
            f"{number} of {starts} starts belong to none of the {most} attractors that were looked for: basin is 0 "
            "there. Their motions may need a longer transient, or a larger tolerance or most.",
            RuntimeWarning,
            stacklevel=stacklevel,
        )


# Results over cases as labelled arrays: the grid of parameters, then the starts.


START, CYCLE = "start", "cycle"


def dimensions_of(cases: Cases) -> tuple[str, ...]:
    """Names of the dimensions of the cases."""
    own = () if cases.points is None else tuple(one.name for one in cases.points.dimensions)
    return own + ((START,) if len(cases.shape) > len(own) else ())


def names_of(cases: Cases) -> tuple[str, ...]:
    """Names of variables for the numbers of the state."""
    return tuple(coordinate.variable for coordinate in cases.system.coordinates)


def states_of(cases: Cases, states: np.ndarray, more: tuple[str, ...], where: str) -> Entries:
    """A variable for each number of the `states`, (cases, ..., coordinates), with the dimensions `more`."""
    found = {}
    for number, (name, coordinate) in enumerate(zip(names_of(cases), cases.system.coordinates, strict=True)):
        column = states[..., number]
        if coordinate.period is not None:
            column = np.mod(column, coordinate.period)
        found[name] = on_grid(cases, column, f"{coordinate.name} {where}", coordinate.unit, more)
    return found


def on_grid(
    cases: Cases, values: Any, long_name: str, unit: str = "1", more: tuple[str, ...] = (), **attributes: object
) -> tuple[Any, ...]:
    """A variable whose `values`, (cases, ...), are put on the grid of the cases."""
    values = np.asarray(values)
    grid = values.reshape((*cases.shape, *values.shape[1:]))
    return variable((*dimensions_of(cases), *more), grid, long_name, unit, **attributes)


def outcome_of(cases: Cases, status: np.ndarray, near_grazing_count: np.ndarray) -> Entries:
    """Whether each case was followed to the end, and how often round-off decided about an event."""
    return {
        "status": on_grid(cases, status.astype(np.int8), "whether the case was followed to the end", **flags(Status)),
        "near_grazing_count": on_grid(cases, near_grazing_count, "number of events decided by round-off"),
    }


def dataset_of(cases: Cases, variables: Entries, coordinates: Entries | None = None) -> "xarray.Dataset":
    """The data set of `variables` over the cases, with the values of parameters and the starts as coordinates.

    Raises:
        ImportError: Without the extra ``study``.
    """
    setting = cases.setter.setting
    found: Entries = {}
    for one in () if cases.points is None else cases.points.dimensions:
        for number, name in enumerate(one.parameters):
            label, unit = label_and_unit(setting, name)
            found[name] = variable(one.name, one.values[:, number], label, unit)
    if dimensions_of(cases)[-1:] == (START,):
        starts = cases.starts[: cases.shape[-1]]
        for number, (name, coordinate) in enumerate(zip(names_of(cases), cases.system.coordinates, strict=True)):
            found[f"initial_{name}"] = variable(START, starts[:, number], f"initial {coordinate.name}", coordinate.unit)
    about = {**source(), **provenance(cases.system, setting.law, setting.method)}
    return labeled_dataset(apart(variables, found), {**found, **(coordinates or {})}, about)


def apart(variables: Entries, parameters: Iterable[str]) -> Entries:
    """`variables`, with an underscore after the name of each that is called as a parameter is: "period_"."""
    taken = set(parameters)
    return {f"{name}_" if name in taken else name: entry for name, entry in variables.items()}
