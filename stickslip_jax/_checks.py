"""Argument checks. Each raises ValueError naming the argument, its value and what is allowed.

Values that are being traced by ``jit``, ``vmap`` or ``grad`` cannot be looked at; they pass unchecked,
and what they cause shows in the per-lane status.
"""

import numbers
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

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


def positive(name: str, value: Any, unit: str = "") -> None:
    """Check that ``value`` is a number greater than zero, of a size that can be computed with."""
    numeric(name, value)
    if not is_traced(value) and not value > 0:
        raise ValueError(f"Argument {name} must be positive{_unit(unit)}, but {show(value)} was given.")
    _sized(name, value, unit)


def non_negative(name: str, value: Any, unit: str = "") -> None:
    """Check that ``value`` is a finite number, zero or greater."""
    numeric(name, value)
    if not is_traced(value) and not value >= 0:
        raise ValueError(f"Argument {name} must be zero or positive{_unit(unit)}, but {show(value)} was given.")
    _sized(name, value, unit)


def _sized(name: str, value: Any, unit: str) -> None:
    if not is_traced(value) and value != 0 and not SMALLEST <= float(value) <= LARGEST:
        raise ValueError(
            f"Argument {name} must be between {SMALLEST} and {LARGEST}{_unit(unit)}, but {show(value)} was given; "
            "choose other units."
        )


def truth(name: str, value: Any) -> None:
    """Check that ``value`` is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"Argument {name} must be True or False, but {show(value)} was given.")


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


def show(value: Any) -> str:
    """`value` on one line, cut where it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
