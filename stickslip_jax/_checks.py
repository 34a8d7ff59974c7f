"""Argument checks. Each raises ValueError that names the argument, what is allowed, and the value given.

The numbers that ``jit``, ``vmap`` and ``grad`` trace are not known yet: they pass unchecked, and what unsuitable ones
cause shows in the status of each trajectory.
"""

import math
import numbers
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ._types import AnyArray

SMALLEST, LARGEST = 1e-100, 1e100
"""Between these, numbers may be multiplied and divided by one another a few times without leaving float64."""


def is_traced(value: Any) -> bool:
    """True while a JAX transformation traces ``value``, so that its number is not known yet."""
    return isinstance(value, Tracer)


def numeric(name: str, value: Any, ndim: int | None = 0) -> None:
    """Check that ``value`` is a finite real number, or array of ``ndim`` dimensions (None: any)."""
    if isinstance(value, (bool, str, bytes)) or value is None:
        raise ValueError(f"Argument {name} must be {_kind(ndim)}, but {show(value)} was given.")
    if ndim is not None and np.ndim(value) != ndim:
        raise ValueError(f"Argument {name} must be {_kind(ndim)}, but an array of shape {np.shape(value)} was given.")
    if is_traced(value):
        return
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        raise ValueError(f"Argument {name} must be {_kind(ndim)}, but a random key was given.")
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"Argument {name} must be {_kind(ndim)}, but {show(value)} was given.")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"Argument {name} must be finite, but {show(value)} was given.")


def bounded(
    name: str,
    value: Any,
    unit: str = "",
    *,
    above: int | float | None = None,
    at_least: int | float | None = None,
    below: int | float | None = None,
    ndim: int = 0,
    hint: str = "",
) -> None:
    """Check that ``value`` holds finite numbers within the bounds given.

    A single number that must not be negative must also be of a size that can be computed with. `hint`: what to do
    about a number outside the bounds.
    """
    numeric(name, value, ndim)
    if is_traced(value):
        return
    low, high = _range(value, ndim)
    if above is not None and not low > above:
        demand = "positive" if above == 0 else f"above {above:g}"
    elif at_least is not None and not low >= at_least:
        demand = "zero or positive" if at_least == 0 else f"at least {at_least:g}"
    elif below is not None and not high < below:
        demand = f"below {below:g}"
    elif ndim == 0 and 0 in (above, at_least) and low != 0 and not SMALLEST <= low <= LARGEST:
        demand, hint = f"between {SMALLEST} and {LARGEST}", "choose other units"
    else:
        return
    shown = show(np.asarray(value) if ndim else value)
    raise ValueError(
        f"Argument {name} must be {demand}{_unit(unit)}, but {shown} was given{f'; {hint}' if hint else ''}."
    )


def _range(value: Any, ndim: int) -> tuple[float, float]:
    """The smallest and the largest number; for none, what lies within any bounds."""
    if ndim == 0:
        return float(value), float(value)
    array = np.asarray(value)
    return (float(array.min()), float(array.max())) if array.size else (math.inf, -math.inf)


def positive(name: str, value: Any, unit: str = "") -> None:
    """Check that ``value`` is a number greater than zero, of a size that can be computed with."""
    bounded(name, value, unit, above=0)


def non_negative(name: str, value: Any, unit: str = "") -> None:
    """Check that ``value`` is a finite number, zero or greater."""
    bounded(name, value, unit, at_least=0)


def real_array(name: str, values: Any) -> AnyArray:
    """``values`` as a one-dimensional array of JAX or float64 of NumPy. Raises ValueError for anything else."""
    numeric(name, values, ndim=1)
    return values if isinstance(values, jax.Array) else np.asarray(values, float)


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


def truth(name: str, value: Any) -> None:
    """Check that ``value`` is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"Argument {name} must be True or False, but {show(value)} was given.")


def text(name: str, value: Any, or_none: bool = False) -> None:
    """Check that ``value`` is a string, or None where that is allowed."""
    if not (isinstance(value, str) or (or_none and value is None)):
        raise ValueError(f"Argument {name} must be a string, but {show(value)} was given.")


def whole_number(name: str, value: Any, minimum: int = 1, maximum: int | None = None) -> int:
    """Check that ``value`` is a whole number of at least ``minimum``, at most ``maximum``, and return it as an int."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, (bool, np.bool_))
    if not whole or value < minimum:
        raise ValueError(f"Argument {name} must be a whole number of at least {minimum}, but {show(value)} was given.")
    if maximum is not None and int(value) > maximum:
        raise ValueError(f"Argument {name} must be at most {maximum}, but {show(value)} was given.")
    return int(value)


def state(name: str, value: Any, meaning: tuple[str, ...]) -> tuple[Any, ...]:
    """Check that ``value`` holds finite numbers, one for each part of ``meaning``, and return them."""
    entries = list(value) if isinstance(value, (tuple, list)) or np.ndim(value) == 1 else []
    if len(entries) != len(meaning):
        count = _COUNTS.get(len(meaning), len(meaning))
        raise ValueError(
            f"Argument {name} must be {count} numbers ({', '.join(meaning)}), but {show(value)} was given."
        )
    for index, entry in enumerate(entries):
        numeric(f"{name}[{index}]", entry)
    return tuple(entries)


_COUNTS = {2: "two", 3: "three", 4: "four"}


def _kind(ndim: int | None) -> str:
    kinds = {None: "real numbers", 0: "a single real number", 1: "a one-dimensional sequence of real numbers"}
    return kinds.get(ndim, f"a {ndim}-dimensional array of real numbers")


def _unit(unit: str) -> str:
    return f" (in {unit})" if unit else ""


def one_of(names: Iterable[str]) -> str:
    """The names as words: "A, B or C"."""
    *most, last = names
    return f"{', '.join(most)} or {last}" if most else last


def show(value: Any) -> str:
    """`value` on one line, cut where it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
