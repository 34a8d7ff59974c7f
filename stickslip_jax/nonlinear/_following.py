"""Cases followed from period to period, in blocks over threads."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._ensemble.progress import progress_bar
from .._events.sticks import Sticks
from .._processor import cores, require_memory
from .._simulation.result import Simulation
from .._status import Ending, Status
from .._types import AnyArray, Array, FloatArray, IntArray
from ._cases import Cases
from ._cycle import Cycle
from ._stored import Kept

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


class Seen(NamedTuple):
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


SEEN = Seen(0, 0, SticksOfPeriod(0, 0, 0), 0, 0)  # pyright: ignore[reportArgumentType] - only its tree counts


@runtime_checkable
class Followed(Protocol):
    """Results of cases with their `Status`."""

    @property
    def status(self) -> Array: ...


Found = TypeVar("Found", bound=Followed)


def start_age(cycle: Cycle, dtype) -> FloatArray:
    """How long each contact has been stuck before the first period: 0."""
    contacts = cycle.system.contact_count if cycle.system.track_count is not None else None
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


def _followed(cycle: Cycle, starts: Array, transient: IntArray, *, kept: int) -> Seen:
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
    return Seen(states, jnp.fmax(jnp.max(sizes, axis=0), _AT_REST * begun[4]), sticks, status, close)


_follow = eqx.filter_jit(_followed)


@eqx.filter_jit
def _follow_along(cycle: Cycle, begin: Array, starts: Array, transient: IntArray, *, kept: int) -> Seen:
    """As `_followed`, of arrays (values, cases, ...), each value of a parameter from where the one before ended; the
    first from `begin` (cases, coordinates), and what was not followed to the end from `starts`.
    """
    arrays, rest = eqx.partition(cycle, eqx.is_array)

    def one_value(y: Array, own: Cycle) -> tuple[Array, Seen]:
        seen = _followed(eqx.combine(own, rest), y, transient, kept=kept)
        return _next_start(seen.states[:, -1], starts), seen

    return lax.scan(one_value, begin, arrays)[1]


def _next_start(last: Array, starts: Array) -> Array:
    """The `last` states (cases, coordinates), and the `starts` of those that were not followed to the end."""
    return jnp.where(jnp.all(jnp.isfinite(last), axis=1, keepdims=True), last, starts)


def follow_along(
    cases: Cases, transient: int, kept: int, progress: bool | None, stored: Kept, *, descending: bool
) -> Seen:
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

            def run(cycle: Cycle, part: np.ndarray = part, begin: Array = begin) -> Seen:
                own = jax.tree.map(lambda leaf: leaf[part] if eqx.is_array(leaf) else leaf, cycle)
                return _follow_along(own, begin, starts, jnp.asarray(transient, jnp.int32), kept=kept)

            name = f"{'down' if descending else 'up'}-{number:04}"
            found.append(stored.block(name, SEEN, lambda run=run: _with_enough_steps(cases, run)))
            begin = _next_start(jnp.asarray(found[-1].states[-1, :, -1]), starts)
            bar.advance(min(part.size, cases.number - (len(found) - 1) * part.size))
    whole = jax.tree.map(lambda *leaves: np.concatenate(leaves)[:values], *found)
    back = np.argsort(order)
    return jax.tree.map(lambda leaf: leaf[back].reshape(cases.number, *leaf.shape[2:]), whole)


def follow(cases: Cases, transient: int, kept: int, progress: bool | None = None, stored: Kept | None = None) -> Seen:
    """What is seen of the cases in the `kept` periods after the `transient` ones, as arrays of NumPy."""
    numbers = cases.starts.shape[1] + 3 * (cases.system.contact_count or 1)
    require_memory("kept", 8.0 * cases.number * kept * numbers, "the states at the ends of so many periods")
    return in_blocks(cases, periods_of(transient, kept), SEEN, progress, Kept() if stored is None else stored)


def periods_of(transient: int, kept: int) -> Callable[[Cycle, Array], Seen]:
    """How the cases of a block are followed for `in_blocks`."""

    def run(cycle: Cycle, starts: Array) -> Seen:
        return _follow(cycle, starts, jnp.asarray(transient, jnp.int32), kept=kept)

    return run


def block_size(number: int, stored: Kept) -> int:
    """How many cases are followed side by side."""
    # Blocks that are stored are the same on every machine.
    return min(_LANES, -(-number // (_STORED_BLOCKS if stored.is_used else cores())))


def in_blocks(
    cases: Cases, run: Callable[[Cycle, Array], Found], like: Found, progress: bool | None, stored: Kept,
    size: int | None = None, name: str = "block",
) -> Found:  # fmt: skip
    """`run` over all cases, in blocks over threads; its results joined, arrays of NumPy with a first axis (cases,).

    A block in which steps ran out, as the ``status`` of its results says, is followed again with twice as many. Blocks
    that are `stored` are taken from there, by `name` and number; `like`: the tree of the results. `size`: of a block.
    """
    threads = cores()
    size = block_size(cases.number, stored) if size is None else size
    blocks = -(-cases.number // size)
    # The last block repeats its last case, so that all are of one size, and compiled once.
    numbers = np.minimum(np.arange(blocks * size), cases.number - 1).reshape(blocks, size)

    def one(block: int) -> Found:
        which = numbers[block]
        starts = jnp.asarray(cases.starts[which], cases.dtype)

        def run_block(cycle: Cycle) -> Found:
            own = jax.tree.map(lambda leaf: leaf[which] if eqx.is_array(leaf) else leaf, cycle)
            return run(own, starts)

        return stored.block(f"{name}-{block:06}", like, lambda: _with_enough_steps(cases, run_block))

    with progress_bar(progress, cases.number) as bar, ThreadPoolExecutor(threads) as pool:
        found = []
        for part in pool.map(one, range(blocks)):
            found.append(part)
            bar.advance(min(size, cases.number - (len(found) - 1) * size))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: cases.number], *found)


def _with_enough_steps(cases: Cases, run: Callable[[Cycle], Found]) -> Found:
    """What `run` returns, as arrays of NumPy; run again with twice the steps while these run out, unless their number
    was given.
    """
    found = jax.tree.map(np.asarray, run(cases.cycle))
    for doublings in range(1, _MOST_DOUBLINGS + 1 if cases.may_take_more else 0):
        if not np.any(found.status == int(Status.OUT_OF_STEPS)):
            break
        found = jax.tree.map(np.asarray, run(cases.with_steps(2**doublings).cycle))
    return found
