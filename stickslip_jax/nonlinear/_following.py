"""Cases followed from period to period until they have settled, in blocks over threads, and kept in a folder."""

import contextlib
import hashlib
import io
import json
import math
import os
import types
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._dynamics.common.method import Exact
from .._dynamics.simulate import code_of
from .._dynamics.sticks import Sticks
from .._ensemble import encoding
from .._ensemble.encoding import ForeignFileError, SweepError
from .._foundation import checks
from .._foundation.extras import progress_bar
from .._foundation.fields import is_of_package, modules_in
from .._foundation.files import read_regular, remove_unfinished, unpacked_arrays, write_whole
from .._foundation.processes import as_many_as_fit, cores, is_wide, lanes_at_once, require_memory, usual_threads
from .._foundation.types import AnyArray, Ending, FloatArray, IntArray, Status
from ._cases import MOST_PERIODS, Cases, Cycle, Followed, Turns, checked_numbers
from ._orbits import periodic_orbit

# Blocks of results kept in a folder, so that a call that was stopped goes on where it was.


T = TypeVar("T")
Folder = str | os.PathLike[str]
_DESCRIPTION, _LOCK, _ENDING = "call.json", "lock", ".block"
_NUMBERS = "numbers"
_LIBRARIES = ("stickslip_jax", "equinox", "builtins", "abc", "typing")
_FEW = 32
_FORMAT = "stickslip_jax nonlinear 1"


@dataclass(frozen=True)
class Kept:
    """The blocks in a `folder` that belong to the call of this `identity`; without a folder none."""

    folder: Path | None = None
    identity: bytes = b""

    def block(self, name: str, kind: Callable[..., T], run: Callable[[], T]) -> T:
        """The results of a block, arrays of NumPy in a `kind` of tuple: those that are kept, or what `run` returns."""
        if self.folder is None:
            return run()
        path = self.folder / (name + _ENDING)
        try:
            whole = read_regular(path)
            # They are not compressed.
            arrays = unpacked_arrays(encoding.without_header(self.identity, path.name, whole), 2 * len(whole))
            return kind(*(arrays[f"arr_{number}"] for number in range(len(arrays))))
        except (FileNotFoundError, ValueError, zipfile.BadZipFile):
            pass  # what is damaged is done again, and replaced
        except (ForeignFileError, OSError) as error:
            raise SweepError(f"{path} cannot be read, or is of another call; move it elsewhere.") from error
        found, data = run(), io.BytesIO()
        results: Any = found
        np.savez(data, *results)
        try:
            write_whole(path, encoding.with_header(self.identity, path.name, data.getvalue()))
        except OSError as error:
            raise encoding.cannot_write(path.parent, error) from error
        return found


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
            stack.enter_context(encoding.locked(path / _LOCK, in_use))
            remove_unfinished(path)
            write_whole(path / _DESCRIPTION, json.dumps(body, indent=1).encode())
        except OSError as error:
            raise encoding.cannot_write(path, error) from error
        yield Kept(path, encoding.id_of(body))


def _description(cases: Cases, what: Mapping[str, int | str]) -> dict[str, Any]:
    """What decides the numbers of a call, each under the name of the argument."""
    setting, points, encoder = cases.setter.setting, cases.points, encoding.Encoder()
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
        "versions": encoding.versions(),
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


_LANES = 512  # cases of a block on a CPU: their arrays stay in the cache
_SIZE = 2**18  # bytes that a case may take on another device, most of them for what a period leaves
_STORED_BLOCKS = 8  # at least, if there are as many cases
_INSTANTS = (0.1, 0.35, 0.6, 0.85)  # of a period, at which the size of a motion is looked at
_AT_REST = 1e-3  # of its size in the transient periods: a number that falls below is taken as zero
_PARTS = 20  # in which values are followed one after another, so that progress can be shown
_MOST_DOUBLINGS = 6  # of the number of steps in a period, before a case is given up


Direction = Literal["start", "up", "down"]


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

    tracks = cycle.system.tracks
    contacts = () if tracks.number is None or tracks.contacts in (None, 1) else (tracks.contacts,)
    ages = jnp.zeros((len(starts), *contacts), starts.dtype)
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


_follow = kept_jit(_followed, filtered=True)


@kept_jit(filtered=True)
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


def _along(
    cases: Cases, transient: int, kept: int, progress: bool | None, stored: Kept, direction: Direction
) -> SeenCases:
    """As `follow`, each value of the first parameter from where the one before it ended."""
    values = cases.shape[0]
    order = np.arange(values)[:: -1 if direction == "down" else 1]
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

            name = f"{direction}-{number:04}"
            found.append(stored.block(name, SeenCases, lambda run=run: _with_enough_steps(cases, run)))
            begin = _next_start(jnp.asarray(found[-1].states[-1, :, -1]), starts)
            bar.advance(min(part.size, cases.number - (len(found) - 1) * part.size))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:values], *found)
    # The order is its own inverse.
    return jax.tree.map(lambda leaf: leaf[order].reshape(cases.number, *leaf.shape[2:]), whole)


def follow(
    cases: Cases, transient: int, kept: int, progress: bool | None = None, stored: Kept | None = None,
    direction: Direction = "start", name: str = "block",
) -> SeenCases:  # fmt: skip
    """What is seen of the cases in the `kept` periods after the `transient` ones, as arrays of NumPy.

    `direction`: whether each case begins from its start, or each value of the first parameter from where the one before
    it ended, in the order of the values ("up") or backwards ("down"). `name`: of what is stored.
    """
    numbers = cases.starts.shape[1] + 3 * (cases.system.tracks.contacts or 1)
    require_memory("kept", 8.0 * cases.number * kept * numbers, "the states at the ends of so many periods")
    if direction != "start":
        return _along(cases, transient, kept, progress, stored or Kept(), direction)
    run = partial(_follow, transient=jnp.asarray(transient, jnp.int32), kept=kept)
    return in_blocks(cases, run, SeenCases, progress, stored or Kept(), name=name)


def block_size(number: int, stored: Kept) -> int:
    """How many cases are followed side by side."""
    if stored.folder:  # the same on every machine
        return min(_LANES, -(-number // _STORED_BLOCKS))
    return min(lanes_at_once(_LANES, number, lambda: _SIZE), -(-number // (1 if is_wide() else cores())))


def in_blocks(
    cases: Cases, run: Callable[[Cycle, Array], FollowedT], kind: Callable[..., FollowedT], progress: bool | None,
    stored: Kept, size: int | None = None, name: str = "block",
) -> FollowedT:  # fmt: skip
    """`run` over all cases, in blocks over threads; its results joined, arrays of NumPy with a first axis (cases,).

    A block in which steps ran out, as the ``status`` of its results says, is followed again with twice as many. Blocks
    that are `stored` are taken from there, by `name` and number; `kind`: of tuple of the results. `size`: of a block.
    """
    size = block_size(cases.number, stored) if size is None else size
    of_size = partial(_in_blocks, cases, run, kind, progress, stored, name)
    return of_size(size) if stored.folder else as_many_as_fit(of_size, size)


def _in_blocks(
    cases: Cases, run: Callable[[Cycle, Array], FollowedT], kind: Callable[..., FollowedT], progress: bool | None,
    stored: Kept, name: str, size: int,
) -> FollowedT:  # fmt: skip
    """As `in_blocks`."""
    blocks = -(-cases.number // size)
    # The last block repeats its last case, so that all are of one size, and compiled once.
    numbers = np.minimum(np.arange(blocks * size), cases.number - 1).reshape(blocks, size)

    def one(block: int) -> FollowedT:
        which = numbers[block]
        starts = jnp.asarray(cases.starts[which], cases.dtype)

        def run_block(cycle: Cycle) -> FollowedT:
            return run(cycle.of(which), starts)

        return stored.block(f"{name}-{block:06}", kind, lambda: _with_enough_steps(cases, run_block))

    with progress_bar(progress, cases.number) as bar, ThreadPoolExecutor(usual_threads()) as pool:
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
    """Warn (RuntimeWarning) of cases that were not followed to the end, and say why."""
    bad = found.status[found.status != int(Status.FINISHED)]
    if len(bad):
        codes, counts = np.unique(bad, return_counts=True)
        why = [f"{count} because {Status(int(code)).meaning}" for code, count in zip(codes, counts, strict=True)]
        checks.warn(
            f"{len(bad)} of {len(found.status)} cases were not followed to the end: {'; '.join(why)}. They hold NaN "
            "from there on, and the variable status says which they are."
        )


def warn_of_unsettled(unsettled: np.ndarray, so_far: str, argument: str) -> None:
    """Warn (RuntimeWarning) of the cases that are `unsettled`, which a larger `argument` lets go on."""
    if np.any(unsettled):
        checks.warn(
            f"{np.sum(unsettled)} of {np.size(unsettled)} motions have not settled within {so_far}: differences "
            f"between their returns still fall or grow, which the result says of each. A larger {argument} lets them "
            "go on; near a bifurcation that may take very long."
        )


# After how many returns a motion repeats itself, and whether it has settled.


_ROUND_OFF = 100  # times the spacing of numbers of the size of the largest number of the state
_LEAST = 8  # returns by which one sees whether differences fall
_COMPARED = 16  # differences of several returns: of fewer, chance would make all smaller too often
_SYSTEMATIC = 0.9  # of the differences: smaller than those before, or larger
_FAST = 0.1  # of the largest in the first half: those of the second half
_FAR_LESS = 1e-2  # of the differences of all smaller numbers of returns, which change
_LEFT = 0.5  # tolerances: the way that is left
_RETURNS = 1, 2, 3, 4, 5, 6, 8  # of orbits near which a motion may turn
_FITS = 0.003  # of each difference: what an affine map may leave of it
_SHRINKS = 0.05  # the least change of differences over what is seen, as a logarithm
_RANK = 1e-6  # of the largest singular value: directions in which the motion does not turn
UNSETTLED = -1
RECURS = 1e-6  # relative: states this near are the same


def recurrence(states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns) -> np.ndarray:
    """The smallest number of returns after which all `states` recur, (cases,); 0 where none is found, and -1 where the
    motion has not settled.

    Of the states (cases, returns, coordinates), at least twice as many returns are needed as the number found. They
    recur if each number comes back to within `tolerance` times its largest size in the same motion, `sizes` (cases,
    coordinates), or to round-off: other cases, which may be far larger, do not matter. `periods`: of coordinates that
    turn. A motion that still comes nearer to its attractor, or leaves an orbit that is unstable, has not settled: the
    differences of the number of returns for which they are smallest still fall, or grow, return after return; if they
    are within the tolerance, by more than it until they were to have fallen to zero; or it turns about the orbit (see
    `_turning`). Of fewer than eight returns this is not seen.
    """
    found = np.zeros(len(states), int)
    recurring: list[np.ndarray] = []
    late, late_size = found.copy(), np.full(len(states), np.inf)
    least, is_changing = late_size.copy(), np.zeros(len(states), bool)
    for number, error in _differences(states, sizes, tolerance, periods):
        size, left, changes = _tendency(error, number)
        recurs = np.all(error <= 1, axis=1)  # False where a state is NaN
        recurring.append(recurs)
        if not np.all(np.isfinite(size) | np.isnan(size)):  # too few to see whether they change
            late_size = np.where((late == 0) & recurs, np.max(error, axis=1), late_size)
            late = np.where((late == 0) & recurs, number, late)
            continue
        settled = (found == 0) & recurs & (~changes | (left <= _LEFT))
        # Where it comes nearer from both sides in turn, it is twice the number that tells the way that is left.
        for divisor in [one for one in range(1, number + 1) if number % one == 0]:
            found = np.where((found == 0) & settled & recurring[divisor - 1], divisor, found)
        # A smaller number that recurs from now on: the larger one only seems to be that of the motion.
        found = np.where((found == 0) & changes & (size <= 1) & ~recurs, UNSETTLED, found)
        is_changing = np.where(size < least, changes & (size > 0), is_changing)
        least = np.fmin(size, least)
    found = np.where((found == 0) & (~is_changing | (late_size < _FAR_LESS * least)), late, found)
    found = np.where((found == 0) & is_changing, UNSETTLED, found)
    (others,) = np.nonzero(found == 0)
    for _, number in _turning(states[others], sizes[others], tolerance, periods):
        found[others[np.isfinite(number)]] = UNSETTLED
    return found


def _differences(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns
) -> Iterator[tuple[int, np.ndarray]]:
    """Each number of returns, and how far the states are from those so many returns later, in tolerances, (cases,
    returns); 0 for round-off.
    """
    smallest, limit = _limits(states, sizes, tolerance, periods)
    for number in range(1, states.shape[1] // 2 + 1):
        change = np.abs(_the_shorter_way(states[:, number:] - states[:, :-number], periods))
        yield number, np.max(np.where(change <= smallest, 0, change) / limit, axis=2)


def _limits(states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Of each case and coordinate the round-off, and the tolerance or the round-off, (cases, 1, coordinates)."""
    scale = _scales(states, sizes, periods)
    smallest = _ROUND_OFF * np.finfo(states.dtype).eps * np.max(scale, axis=1, keepdims=True)
    limit = np.fmax(tolerance * scale, smallest)[:, None]
    return smallest[:, None], np.where(limit > 0, limit, 1)  # 1: of a motion that has always been at zero


def _scales(states: np.ndarray, sizes: np.ndarray, periods: Turns) -> np.ndarray:
    """The largest size of each number of the states (cases, returns, coordinates), 1 of those that turn."""
    turns = np.array([period is not None for period in periods])
    return np.where(turns, 1.0, np.fmax(sizes, np.max(np.abs(states), axis=1)))


def _the_shorter_way(change: np.ndarray, periods: Turns) -> np.ndarray:
    """A change of the state, (..., coordinates), of coordinates that turn the shorter way."""
    turns = np.array([period or np.inf for period in periods])
    return change - np.where(np.isfinite(turns), turns, 0) * np.round(change / turns)


def _turning(
    states: np.ndarray, sizes: np.ndarray, tolerance: float, periods: Turns
) -> Iterator[tuple[int, np.ndarray]]:
    """Numbers of returns, and how far states are from the orbit of so many that they turn about, in tolerances, (cases,
    ); infinity where they do not.

    Near an orbit the return map is affine: each difference of states is a matrix times the one before. It is found by
    least squares from the second half of the states; where it leaves nearly nothing of any difference, and its largest
    multiplier says that differences fall or grow, the motion has not settled, however the multiplier turns them.
    """
    smallest, limit = _limits(states, sizes, tolerance, periods)
    for number in _RETURNS:
        some = states[:, ::-1][:, ::number][:, ::-1]
        some = some[:, some.shape[1] // 2 :]
        if not len(states) or some.shape[1] < max(_LEAST, 2 * some.shape[2] + 2):
            continue
        change = _the_shorter_way(np.diff(some, axis=1), periods)
        change = np.where(np.abs(change) <= smallest, 0, change)
        moves = np.all(np.any(change != 0, axis=2), axis=1) & np.all(np.isfinite(change), axis=(1, 2))
        change = np.where(moves[:, None, None], change / limit, 1)
        before, after = change[:, :-1], change[:, 1:]
        matrix = np.linalg.pinv(before, rcond=_RANK) @ after
        rest, size = (np.max(np.abs(values), axis=2) for values in (after - before @ matrix, before))
        largest = np.max(np.abs(np.linalg.eigvals(matrix)), axis=1)
        shrinks = np.abs(np.log(np.where(largest == 0, 1, largest))) * after.shape[1] >= _SHRINKS
        to_orbit = np.linalg.pinv(np.eye(matrix.shape[-1]) - matrix)
        left = np.max(np.abs(change[:, -1:] @ to_orbit), axis=(1, 2))
        yield number, np.where(moves & shrinks & np.all(rest <= _FITS * size, axis=1), left, np.inf)


def _tendency(error: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of differences (cases, returns): the largest of the second half, the way that is left until they have fallen to
    zero, and whether they change systematically; infinity, infinity and False of too few.
    """
    returns = error.shape[1]
    half = returns // 2
    if returns + number < _LEAST or not half or (number > 1 and returns - number < _COMPARED):
        unknown = np.full(len(error), np.inf)
        return unknown, unknown, np.zeros(len(error), bool)
    first, second = np.max(error[:, :half], axis=1), np.max(error[:, half:], axis=1)
    ratio = np.divide(second, first, out=np.where(second > 0, np.inf, 0.0), where=first > 0)
    # Each later half is smaller by the same ratio, and holds so many differences one after another.
    left = np.where(ratio < 1, second * half / number * ratio / np.where(ratio < 1, 1 - ratio, 1), np.inf)
    step = min(number, returns - half)
    falls = np.mean(error[:, step:] < error[:, :-step], axis=1)
    grows = np.mean(error[:, step:] > error[:, :-step], axis=1)
    changes = (second > 0) & ((falls >= _SYSTEMATIC) | (grows >= _SYSTEMATIC) | (ratio < _FAST))
    return second, left, changes


# Motions that go on until they have settled.


_LONGEST = 16  # times the transient periods, by default
_FEW_LANES = 64  # of blocks that are not made smaller where few cases have not settled
_MOST_ORBITS = 50  # cases that are decided by an orbit
_NEAR = 3.0  # times as far as the motion still moves: the orbit that it comes nearer to


def checked_periods(transient: object, kept: object, longest: object, tolerance: object) -> tuple[int, int, int]:
    """The numbers of periods before those that are kept, of these, and the largest of those before; checked, as is the
    tolerance.
    """
    checks.positive("tolerance", tolerance)
    before, kept = checked_numbers(transient, kept)
    most = MOST_PERIODS - kept
    if longest is None:
        return before, kept, min(_LONGEST * before, most)
    return before, kept, checks.whole_number("longest_transient", longest, minimum=before, maximum=most)


def settled(
    cases: Cases, lasted: tuple[int, int, int], tolerance: float, progress: bool | None, stored: Kept,
    direction: Direction = "start",
) -> tuple[SeenCases, np.ndarray, np.ndarray]:  # fmt: skip
    """What is seen of the cases, as by `follow`; of those that have not settled, in later periods: twice as many before
    those that are kept, again and again. Also the `recurrence` of each case, and how many periods more came before
    those, (cases,).

    `lasted`: the numbers of periods before those that are kept, of these, and the largest of those before. Where it has
    not settled then, the multipliers of the orbit that a motion comes nearer to decide. Warns (RuntimeWarning) of the
    others, unless none was to go on, and of cases that were not followed to the end.
    """
    transient, kept, longest = lasted
    seen = jax.tree.map(np.array, follow(cases, transient, kept, progress, stored, direction))
    size = block_size(cases.number, stored)
    states, sizes = np.asarray(seen.states), np.asarray(seen.sizes)  # the same memory, which later periods are put into
    more, last = np.zeros(cases.number, int), transient
    found = recurrence(states, sizes, tolerance, cases.turns)
    while last < longest and np.any(found == UNSETTLED):
        which = np.flatnonzero(found == UNSETTLED)
        gone, last = last + kept, min(2 * last, longest)
        last = max(last, gone)
        # Few block sizes, because each is compiled.
        small = size if size < _FEW_LANES else min(size, 4 ** math.ceil(math.log(len(which), 4)))
        own = cases.of(which, states[which, -1])
        name = f"more-{last}-{hashlib.sha256(which.tobytes() + own.starts.tobytes()).hexdigest()[:12]}"
        run = partial(_follow, transient=jnp.asarray(last - gone, jnp.int32), kept=kept)
        later = in_blocks(own, run, SeenCases, progress, stored, small, name)
        later = later._replace(near_grazing_count=later.near_grazing_count + seen.near_grazing_count[which])
        for whole, part in zip(seen, later, strict=True):
            whole[which] = part
        more[which] = last - transient
        found[which] = recurrence(states[which], sizes[which], tolerance, cases.turns)
    if cases.driven and longest > transient:
        for case in np.flatnonzero(found == UNSETTLED)[:_MOST_ORBITS]:
            found[case] = _by_orbits(cases, int(case), states[case], sizes[case], tolerance)
    if longest > transient:
        so_far = f"{transient + np.max(more)} periods"
        warn_of_unsettled(found == UNSETTLED, so_far, "longest_transient")
    warn_of_unfinished(seen)
    return seen, found, more


def _by_orbits(cases: Cases, case: int, states: np.ndarray, sizes: np.ndarray, tolerance: float) -> int:
    """The number of periods of the stable orbit that a motion comes nearer to; -1 where none is found near it."""
    seen = states[None], sizes[None], tolerance, cases.turns
    # The numbers of returns of the orbits to which it comes nearer, and how far it may still be from them (tolerances).
    near = []
    for number, error in _differences(*seen):
        size, _, changes = _tendency(error, number)
        if changes[0] and 0 < size[0] < np.max(error):
            near.append((number, float(size[0])))
    near += [(number, float(left[0])) for number, left in _turning(*seen) if np.isfinite(left[0])]
    one, scale = cases.cycle.of(case), _scales(states[None], sizes[None], cases.turns)[0]
    y0, steps = tuple(map(float, states[-1])), one.method.max_steps
    for number, left in near:
        method = Exact(one.method.step, None if steps is None else number * steps, one.method.solver)
        period = float(one.duration)
        orbit = periodic_orbit(one.system, one.base, y0=y0, periods=number, period=period, method=method)
        change = _the_shorter_way(np.asarray(orbit.state) - states[-1], cases.turns)
        is_near = np.max(np.abs(change) / scale) <= _NEAR * left * tolerance
        if bool(orbit.converged) and orbit.is_stable and is_near:
            return number
    return UNSETTLED
