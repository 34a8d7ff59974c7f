"""Argument checks. Each raises ValueError that names the argument, what is allowed, and the value given.

The numbers that ``jit``, ``vmap`` and ``grad`` trace are not known yet: they pass unchecked, and what unsuitable
ones cause shows in the status of each trajectory. What is allowed but may not be meant, `warn` says.
"""

import contextlib
import math
import numbers as kinds_of_numbers
import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.core import Tracer
from jax.errors import ConcretizationTypeError, TracerArrayConversionError, TracerIntegerConversionError

from .types import AnyArray

SMALLEST, LARGEST = 1e-100, 1e100
"""Between these, numbers may be multiplied and divided by one another a few times without leaving float64."""
Bound: TypeAlias = int | float | None
"""A bound of a number, None for none."""


_INNER = (__name__.partition(".")[0], "equinox", "jaxtyping", "beartype", "importlib")  # whose lines no user wrote


def warn(text: str) -> None:
    """Warn (RuntimeWarning) at the line that a user wrote: the first outside the package."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _INNER:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, RuntimeWarning, stacklevel=level)


def is_traced(value: object) -> bool:
    """True while a JAX transformation traces ``value``, so that its number is not known yet."""
    return isinstance(value, Tracer)


NOT_TRACEABLE = ConcretizationTypeError, TracerArrayConversionError, TracerIntegerConversionError
"""What JAX raises where code asks for a number that it traces."""


@contextlib.contextmanager
def traceable(what: str) -> Iterator[None]:
    """Say in one sentence that a user's code, `what`, asks for numbers that JAX traces, as NumPy and `if` do."""
    try:
        yield
    except NOT_TRACEABLE as error:
        raise ValueError(
            f"{what} must be written so that JAX can trace it, but it asks for the value of a number that is not known "
            "yet, as functions of numpy and math, float(...) and if do; write jax.numpy.sqrt(x) or x ** 0.5 for "
            "math.sqrt(x), jax.numpy.interp for numpy.interp, and jax.numpy.where(condition, a, b) for if."
        ) from error


def numbers(name: str, value: object, ndim: int | None = None) -> np.ndarray:
    """`value` as an array of real numbers, of ``ndim`` dimensions (None: any). Raises ValueError for anything else.

    Truth values, complex numbers, words, and numbers that only objects can hold are no real numbers here, and neither
    are arrays with masked entries: NumPy and JAX would make numbers of some of them, and let others fail later.
    """
    array = _array_of(value)
    if array is None or (ndim == 0 and not isinstance(value, _SINGLE)):
        random_key = isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        shown = "a random key" if random_key else show(value)
        raise ValueError(f"Argument {name} must be {_kind(ndim)}, but {shown} was given{_hint(value)}")
    _check_dimensions(name, array, ndim)
    return array


def _check_dimensions(name: str, array: npt.ArrayLike, ndim: int | None) -> None:
    if ndim is not None and np.ndim(array) != ndim:
        shape = np.shape(array)
        raise ValueError(f"Argument {name} must be {_kind(ndim)}, but an array of shape {shape} was given.")


def refused(name: str, demand: str, value: object, hint: str = "") -> ValueError:
    """The error that says what the argument `name` must do, as "be positive", and that `value` was given.

    `hint`: what to do.
    """
    return ValueError(f"Argument {name} must {demand}, but {show(value)} was given{f'; {hint}' if hint else ''}.")


def numeric(name: str, value: Any, ndim: int | None = 0) -> None:
    """Check that ``value`` is a finite real number, or array of ``ndim`` dimensions (None: any)."""
    if is_traced(value):
        _check_dimensions(name, value, ndim)
    elif not np.all(np.isfinite(numbers(name, value, ndim))):
        raise refused(name, "be finite", value)


_MOST = 2**28  # numbers in an array made of a range
_MOST_LISTS = 8  # within each other
_MOST_LEVELS = 64  # of trees
_NO_NUMBERS = (bool, str, bytes, bytearray)
_SINGLE = (int, float, np.generic, np.ndarray, jax.Array, list, tuple)
"""What may be a number for JAX too, and lists, which are none because of their shape."""


def _array_of(value: object) -> np.ndarray | None:
    """`value` as an array of whole or floating-point numbers of at most 64 bits; None for anything else."""
    if value is None or isinstance(value, (*_NO_NUMBERS, type)) or np.ma.is_masked(value):
        return None
    if isinstance(value, range) and value[_MOST:]:
        return None
    if isinstance(value, (list, tuple)) and not _holds_numbers(value):
        return None
    try:
        array = np.asarray(value)
    except Exception:  # rows of different lengths, keys, lists within too many others; the object is anybody's
        return None
    is_number = array.dtype.kind in "iuf" and array.dtype.itemsize <= 8
    too_large = isinstance(value, int) and not -(2**63) <= value < 2**63
    return array if is_number and not too_large else None


def _entries(listed: list[Any] | tuple[Any, ...], level: int = 1) -> Iterator[object]:
    """What is in these lists in lists; those that are within too many others as they are."""
    for one in listed:
        if isinstance(one, (list, tuple)) and level < _MOST_LISTS:
            yield from _entries(one, level + 1)
        else:
            yield one


def _holds_numbers(listed: list[Any] | tuple[Any, ...]) -> bool:
    """Whether NumPy makes an array of these lists in lists without making numbers of what is none, as of truth values
    and masked entries.
    """
    for one in _entries(listed):
        is_masked = isinstance(one, np.ma.MaskedArray) and np.ma.is_masked(one)
        if is_masked or isinstance(one, (*_NO_NUMBERS, list, tuple)):
            return False
        if getattr(getattr(one, "dtype", None), "kind", "f") not in "iuf":
            return False
    return True


def _holds_masked(listed: list[Any] | tuple[Any, ...]) -> bool:
    """Whether a masked number is in these lists in lists."""
    return any(one is np.ma.masked for one in _entries(listed))


def is_tree(value: object) -> bool:
    """Whether JAX can go through `value`: not where lists are within hundreds of others, or in themselves, nor a dict
    whose keys have no order.
    """
    layer = [value]
    for _ in range(_MOST_LEVELS):
        inside: dict[int, object] = {}
        for one in layer:
            if isinstance(one, dict):
                try:
                    sorted(one)
                except TypeError:
                    return False
            parts = one.values() if isinstance(one, dict) else one if isinstance(one, (list, tuple)) else ()
            inside |= {id(part): part for part in parts if isinstance(part, (list, tuple, dict))}
        if not inside:
            return True
        layer = list(inside.values())
    return False


def tree(name: str, value: object) -> None:
    """Check that JAX can go through ``value``, whatever is in it."""
    if isinstance(value, Iterator):
        raise refused(name, "be no iterator, which can be read only once", value)
    rows = [one for one in value if isinstance(one, (list, tuple))] if isinstance(value, (list, tuple)) else []
    if any(map(_holds_masked, rows)):  # of which NumPy would make NaN
        raise refused(name, "hold no masked entries", value, "leave them out, or fill them")
    if not is_tree(value):
        raise refused(name, f"be no list within {_MOST_LEVELS} others, and no dict whose keys have no order", value)


def holds_traced(*values: object) -> bool:
    """Whether JAX traces a number in `values`; not in what is no tree, which other checks refuse by its name."""
    trees = [value for value in values if is_tree(value) and not isinstance(value, Iterator)]
    return any(is_traced(leaf) for leaf in jax.tree.leaves(trees))


def _hint(value: object) -> str:
    """The end of the sentence that refuses `value`: what to do, where that is known."""
    if isinstance(value, type):
        return f"; make an object of it: {value.__name__}(...)."
    if np.ma.is_masked(value):
        return "; leave the masked entries out, or fill them."
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**100:
        return f"; write it as {float(value)!r}."
    return "."


def dimensions(value: Any) -> int:
    """The number of dimensions of an array, or of lists in lists; 0 for what is no array, also for uneven lists."""
    if isinstance(value, (list, tuple)) and _holds_masked(value):
        return 1  # of which NumPy would warn
    if isinstance(value, range):
        return 1
    try:
        return np.ndim(value)
    except Exception:  # uneven lists; the object is anybody's
        return 0


def bounded(
    name: str,
    value: Any,
    unit: str = "",
    *,
    above: Bound = None,
    at_least: Bound = None,
    below: Bound = None,
    ndim: int = 0,
    hint: str = "",
) -> None:
    """Check that ``value`` holds finite numbers within the bounds given.

    All must be of a size that can be computed with. `hint`: what to do about a number outside the bounds.
    """
    numeric(name, value, ndim)
    if is_traced(value):
        return
    values = np.asarray(value, float) if ndim else np.float64(value)
    for wrong, demand, advice in out_of_bounds(values, above, at_least, below, sized=not ndim):
        if np.any(wrong):
            in_unit = f" (in {unit})" if unit else ""
            raise refused(name, f"be {demand}{in_unit}", np.asarray(value) if ndim else value, advice or hint)


def out_of_bounds(
    values: np.ndarray | np.floating, above: Bound, at_least: Bound, below: Bound, *, sized: bool
) -> Iterator[tuple[np.ndarray | np.bool_, str, str]]:
    """Of each demand on the numbers `values`: which do not meet it, what they must be, and what to do.

    `sized`: whether positive ones must be of a size that can be multiplied and divided.
    """
    if above is not None:
        yield ~(values > above), "positive" if above == 0 else f"above {above:g}", ""
    if at_least is not None:
        yield ~(values >= at_least), "zero or positive" if at_least == 0 else f"at least {at_least:g}", ""
    if below is not None:
        yield ~(values < below), f"below {below:g}", ""
    size = np.abs(values)
    if sized and 0 in (above, at_least):
        wrong = (values != 0) & ~((size >= SMALLEST) & (size <= LARGEST))
        yield wrong, f"between {SMALLEST} and {LARGEST}", "choose other units"
    yield ~(size <= LARGEST), f"between -{LARGEST} and {LARGEST}", "choose other units"


def positive(name: str, value: Any, unit: str = "") -> None:
    """Check that ``value`` is a number greater than zero, of a size that can be computed with."""
    bounded(name, value, unit, above=0)


def non_negative(name: str, value: Any, unit: str = "") -> None:
    """Check that ``value`` is a finite number, zero or greater."""
    bounded(name, value, unit, at_least=0)


def jax_array(name: str, values: object) -> Any:
    """``values`` as an array of JAX, of any dimensions. Raises ValueError for what holds no real numbers."""
    if is_traced(values):
        return values
    require_threads_of_jax()
    return jnp.asarray(numbers(name, values))


def real_array(name: str, values: object) -> AnyArray:
    """``values`` as a one-dimensional array of JAX or float64 of NumPy. Raises ValueError for anything else."""
    numeric(name, values, ndim=1)
    return values if isinstance(values, jax.Array) else np.asarray(values, float)


def same_length(least: int, **arrays: AnyArray) -> None:
    """Check that the arguments by name are arrays of the same length of at least ``least``, given as sequences."""
    shapes = [np.shape(array) for array in arrays.values()]
    if len(set(shapes)) > 1 or shapes[0][0] < least:
        raise ValueError(
            f"Arguments {one_of(arrays, 'and')} must have the same length of at least {least}, but they have shapes "
            f"{one_of(map(str, shapes), 'and')}."
        )


def increasing_from_zero(name: str, times: AnyArray, hint: str = "") -> None:
    """Check that ``times`` begin with 0 and increase. `hint`: what to do where they begin with another number."""
    if is_traced(times):
        return
    times = np.asarray(times)
    if times[0] != 0:
        raise ValueError(
            f"Argument {name} must begin with 0, but its first entry is {times[0]}{f'; {hint}' if hint else ''}."
        )
    if np.any(np.diff(times) <= 0):
        at = int(np.argmax(np.diff(times) <= 0)) + 1
        raise ValueError(f"Argument {name} must increase, but {name}[{at}] = {times[at]} follows {times[at - 1]}.")


def truth(name: str, value: object) -> None:
    """Check that ``value`` is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise refused(name, "be True or False", value)


def text(name: str, value: object, or_none: bool = False) -> None:
    """Check that ``value`` is a string, or None where that is allowed."""
    if not (isinstance(value, str) or (or_none and value is None)):
        raise refused(name, "be a string", value)


def whole_number(name: str, value: Any, minimum: int = 1, maximum: int = 2**63 - 1) -> int:
    """Check that ``value`` is a whole number of at least ``minimum``, at most ``maximum``, and return it as an int."""
    whole = isinstance(value, kinds_of_numbers.Integral) and not isinstance(value, (bool, np.bool_))
    if not whole or value < minimum:
        raise refused(name, f"be a whole number of at least {minimum}", value)
    if int(value) > maximum:
        raise refused(name, f"be at most {maximum}", value)
    return int(value)


def entries(name: str, value: Any, meaning: tuple[str, ...]) -> tuple[Any, ...]:
    """The parts of ``value``, one for each part of ``meaning``. Raises ValueError for anything else."""
    listed = isinstance(value, (tuple, list))
    is_array = not listed and dimensions(value) == 1 and (is_traced(value) or _array_of(value) is not None)
    # Entries of a data set, such as the last of a section, are arrays of xarray without dimensions.
    found = [one.to_numpy() if hasattr(one, "to_numpy") else one for one in value] if listed or is_array else []
    if len(found) != len(meaning):
        count = _COUNTS.get(len(meaning), len(meaning))
        raise refused(name, f"be {count} numbers ({', '.join(meaning)})", value)
    return tuple(found)


def state(name: str, value: object, meaning: tuple[str, ...]) -> tuple[Any, ...]:
    """Check that ``value`` holds finite numbers, one for each part of ``meaning``, and return them."""
    found = entries(name, value, meaning)
    for index, entry in enumerate(found):
        numeric(f"{name}[{index}]", entry)
    return found


_COUNTS = {2: "two", 3: "three", 4: "four"}


def _kind(ndim: int | None) -> str:
    kinds = {None: "real numbers", 0: "a single real number", 1: "a one-dimensional sequence of real numbers"}
    return kinds.get(ndim, f"a {ndim}-dimensional array of real numbers")


def one_of(names: Iterable[str], word: str = "or") -> str:
    """The names as words: "A, B or C", or with another `word`."""
    *most, last = names
    return f"{', '.join(most)} {word} {last}" if most else last


def chosen(name: str, value: object, options: Iterable[str]) -> str:
    """Check that ``value`` is one of the words ``options``, and return it."""
    known = tuple(options)
    if not isinstance(value, str) or value not in known:
        raise refused(name, f"be one of {', '.join(map(repr, known))}", value)
    return value


def path(name: str, value: object, what: str = "the name of a file or folder") -> Path:
    """Check that ``value`` can be the name of a file or folder, and return it as a path. `what`: what it must be."""
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) and not isinstance(value, type) else None
    with contextlib.suppress(UnicodeEncodeError):
        if isinstance(text, str) and len(text) <= _LONGEST_NAME and "\0" not in text and os.fsencode(text):
            return Path(text)
    raise refused(name, f"be {what}", value)


_LONGEST_NAME = 4096  # characters


_SHOWN = 80  # characters


def show(value: object) -> str:
    """`value` on one line, cut where it is long."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**_SHOWN:
        return f"a whole number of about {int(value.bit_length() * math.log10(2)) + 1} digits"
    cut = False
    if isinstance(value, (list, tuple, str, bytes)):
        cut = len(value) > _SHOWN
        value = value[:_SHOWN]  # what follows is not shown, and may be very much
    try:
        text = " ".join(repr(value).split())
    except Exception:  # the object is anybody's
        return f"an object of the class {type(value).__name__}"
    return f"{text[: _SHOWN - 3]}..." if cut or len(text) > _SHOWN else text


# Forks of a process in which JAX has started: its threads are not in the fork, and what needs them waits for ever.


_PROBED = "jax_num_cpu_devices"  # which JAX refuses to change once it has started


class _State:
    """`started`: whether JAX had started when this process was forked last. `lost`: whether this is such a fork."""

    started = False
    lost = False


def require_threads_of_jax() -> None:
    """Raises RuntimeError in a fork of a process in which JAX had started."""
    if _State.lost:
        raise RuntimeError(
            "JAX cannot run in a fork of a process in which it had started, and would wait for threads that are not "
            'there; start processes by multiprocessing.get_context("spawn"), or let Sweep.run(workers=...) do it.'
        )


def _before() -> None:
    _State.started = _State.lost or _has_started()


def _in_fork() -> None:
    _State.lost = _State.started


def _has_started() -> bool:
    """Whether JAX has started. No function of JAX tells it, but it refuses another number of devices from then on."""
    now = getattr(jax.config, _PROBED)
    try:
        # Any negative number is the number that the flags of XLA say.
        jax.config.update(_PROBED, -2 if now < 0 else now + 1)
    except RuntimeError:
        return True
    jax.config.update(_PROBED, now)
    return False


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_child=_in_fork)
