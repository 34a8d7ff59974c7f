"""Values of every wrong kind, drawn at random, and which of them an argument may take all the same."""

import datetime
import decimal
import enum
import fractions
import math
import os
import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import xarray as xr

import stickslip_jax as ss
from stickslip_jax._foundation.fields import is_distribution

Draw = np.random.Generator
LARGEST = 1e100
KEY = jax.random.key(0)


class Broken:
    """An object that shows and converts itself by errors."""

    def __repr__(self):
        raise RuntimeError("cannot be shown")

    def __array__(self, *_, **__):
        raise OSError("cannot be converted")


class Convertible:
    """An object that Python makes a number of, and NumPy does not."""

    def __float__(self):
        return 0.5

    def __index__(self):
        return 2


class Word(str):
    __slots__ = ()


class Color(enum.Enum):
    RED = 1


def recursive() -> list[Any]:
    own: list[Any] = []
    own.append(own)
    return own


def deep() -> list[Any]:
    nested: list[Any] = []
    for _ in range(2000):
        nested = [nested]
    return nested


def size(draw: Draw, low: float, high: float) -> float:
    return float(10 ** draw.uniform(low, high)) * draw.choice([-1, 1])


def numbers(draw: Draw, dtype: Any = float) -> np.ndarray:
    return np.asarray(np.sort(draw.uniform(-2, 3, draw.integers(1, 5))), dtype)


VALUES: dict[str, Callable[[Draw], Any]] = {
    "number": lambda draw: size(draw, -3, 3),
    "whole number": lambda draw: int(draw.integers(-5, 6)),
    "zero": lambda draw: draw.choice([0.0, -0.0, 0]).item(),
    "tiny": lambda draw: size(draw, -320, -101),
    "huge": lambda draw: size(draw, 101, 308),
    "not finite": lambda draw: draw.choice([math.nan, math.inf, -math.inf]).item(),
    "single precision": lambda draw: np.float32(size(draw, -40, 40)),
    "half precision": lambda draw: np.float16(size(draw, -2, 2)),
    "long double": lambda draw: np.longdouble(size(draw, -3, 3)),
    "small integer of numpy": lambda draw: np.int8(draw.integers(-100, 100)),
    "large integer of numpy": lambda draw: np.uint64(2**64 - int(draw.integers(1, 100))),
    "array without dimensions": lambda draw: np.asarray(size(draw, -3, 3)),
    "array of jax without dimensions": lambda draw: jnp.asarray(size(draw, -3, 3)),
    "complex": lambda draw: complex(size(draw, -3, 3), draw.uniform()),
    "complex of numpy": lambda draw: np.complex64(size(draw, -3, 3)),
    "truth": lambda draw: bool(draw.integers(2)),
    "truth of numpy": lambda draw: np.bool_(draw.integers(2)),
    "none": lambda draw: None,
    "ellipsis": lambda draw: ...,
    "word": lambda draw: str(draw.choice(["a", "mu", "1.0", "nan", "own", "True", "sticks", "Ünïcödé", "a b"])),
    "empty word": lambda draw: "",
    "long word": lambda draw: "x" * int(draw.integers(10**4, 10**5)),
    "lines": lambda draw: "two\nlines",
    "zero byte": lambda draw: "a\0b",
    "half a sign": lambda draw: "\ud800",
    "word of a class": lambda draw: Word("a"),
    "word of numpy": lambda draw: np.str_("mu"),
    "bytes": lambda draw: draw.bytes(4),
    "many digits": lambda draw: int(draw.choice([-1, 1])) * 10 ** int(draw.integers(20, 400)),
    "very many digits": lambda draw: 10 ** int(draw.integers(4400, 9000)),
    "decimal": lambda draw: decimal.Decimal("0.5"),
    "fraction": lambda draw: fractions.Fraction(1, 2),
    "date": lambda draw: datetime.date(2020, 1, 1),
    "date of numpy": lambda draw: np.datetime64("2020-01-01"),
    "enumeration": lambda draw: Color.RED,
    "status": lambda draw: ss.Status.FINISHED,
    "convertible": lambda draw: Convertible(),
    "broken": lambda draw: Broken(),
    "object": lambda draw: object(),
    "class": lambda draw: draw.choice(np.array([float, dict, ss.Coulomb, ss.Uniform, ss.MassSpring, ss.PoissonSwitching,
                                                ss.Harmonic, ss.Exact, np.float64, Broken], object)),
    "function": lambda draw: lambda *_: 1.0,
    "builtin": lambda draw: len,
    "module": lambda draw: math,
    "generator": lambda draw: (value for value in (1.0, 2.0)),
    "iterator": lambda draw: iter([1.0]),
    "set": lambda draw: {1.0, 2.0},
    "dict": lambda draw: {"mu": size(draw, -3, 3)},
    "dict of lists": lambda draw: {"mu": [0.5, 1.0], 3: "a"},
    "empty dict": lambda draw: {},
    "empty list": lambda draw: [],
    "empty tuple": lambda draw: (),
    "empty array": lambda draw: np.zeros(0),
    "list": lambda draw: numbers(draw).tolist(),
    "tuple": lambda draw: tuple(numbers(draw)),
    "list of words": lambda draw: ["a", "b", "a"],
    "list with none": lambda draw: [1.0, None],
    "list with a truth": lambda draw: [True, 1.0],
    "list with many digits": lambda draw: [0.5, 10**400],
    "list that is uneven": lambda draw: [[0.5], [1.0, 2.0]],
    "list of digits and numbers": lambda draw: ["5", 1.0],
    "list of dates": lambda draw: [datetime.date(2020, 1, 1), np.datetime64("2020-01-01")],
    "list with a masked number": lambda draw: [np.ma.masked, 1.0],
    "list of masked arrays": lambda draw: [np.ma.array([1.0, 2.0], mask=[False, True]), [2.0, 1.0]],
    "list of complex numbers": lambda draw: [1.0 + 1e-9j, 1.0],
    "rows of digits": lambda draw: [["1.0", 0.0], [0.0, "1.0"]],
    "rows of truths": lambda draw: [[True, 0.0], [False, 1.0]],
    "rows of arrays of truths": lambda draw: [np.array([True, False]), np.array([0.0, 1.0])],
    "rows with a masked number": lambda draw: [[1.0, np.ma.masked], [0.0, 1.0]],
    "rows": lambda draw: draw.uniform(size=(2, 2)).tolist(),
    "list in itself": lambda draw: recursive(),
    "deep list": lambda draw: deep(),
    "deep dict": lambda draw: {"a": deep()},
    "list of some depth": lambda draw: [[[[[[[[[[0.5]]]]]]]]]],
    "dict without order": lambda draw: {1: 0.5, "a": 1.0},
    "bytearray": lambda draw: bytearray(b"12"),
    "list of objects": lambda draw: [object(), Broken()],
    "range": lambda draw: range(int(draw.integers(0, 5))),
    "long range": lambda draw: range(10**15),
    "array": numbers,
    "array of jax": lambda draw: jnp.asarray(numbers(draw)),
    "array of integers": lambda draw: numbers(draw, int),
    "array of single precision": lambda draw: numbers(draw, np.float32),
    "array with nan": lambda draw: np.array([0.0, math.nan, 2.0]),
    "array with infinity": lambda draw: np.array([0.0, math.inf]),
    "array of huge numbers": lambda draw: np.array([0.0, 1e308]),
    "array of complex numbers": lambda draw: numbers(draw, complex),
    "array of jax of complex numbers": lambda draw: jnp.asarray(numbers(draw, complex)),
    "array of truths": lambda draw: numbers(draw) > 0,
    "array of objects": lambda draw: numbers(draw, object),
    "array of words": lambda draw: numbers(draw, str),
    "array of dates": lambda draw: np.array(["2020-01-01"], "datetime64[D]"),
    "records": lambda draw: np.zeros(2, [("a", float), ("b", int)]),
    "masked": lambda draw: np.ma.masked,
    "masked matrix": lambda draw: np.ma.array(np.eye(2), mask=[[False, True], [True, False]]),
    "complex matrix": lambda draw: np.eye(2) * (1 + 1j),
    "complex matrix of jax": lambda draw: jnp.eye(2) * (1 + 1j),
    "matrix of objects": lambda draw: np.eye(2).astype(object),
    "masked array": lambda draw: np.ma.array([0.0, 1.0, 2.0], mask=[False, True, False]),
    "matrix": lambda draw: draw.uniform(size=(2, 3)),
    "cube": lambda draw: draw.uniform(size=(1, 1, 1)),
    "identity": lambda draw: np.eye(2),
    "series": lambda draw: pd.Series([0.5, 1.0]),
    "series of objects": lambda draw: pd.Series(["a", None]),
    "table": lambda draw: pd.DataFrame({"mu": [0.5, 1.0]}),
    "labeled array": lambda draw: xr.DataArray([0.5, 1.0], dims="x"),
    "labeled number": lambda draw: xr.DataArray(0.5),
    "data set": lambda draw: xr.Dataset({"a": ("x", [1.0])}),
    "key": lambda draw: KEY,
    "keys": lambda draw: jax.random.split(KEY, 2),
    "key of another generator": lambda draw: jax.random.key(0, impl="rbg"),
    "system": lambda draw: ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5)),
    "law": lambda draw: ss.PoissonSwitching(1.0, 1.0),
    "signal": lambda draw: ss.Harmonic(1.0, 1.0),
    "friction": lambda draw: ss.Coulomb(0.5),
    "distribution": lambda draw: ss.Uniform(0.1, 0.9),
    "values": lambda draw: ss.Discrete([1.0, 2.0]),
    "design": lambda draw: ss.design.random(4, ["mu"]),
    "method": lambda draw: ss.Regularized(0.1),
    "path": lambda draw: pathlib.Path("missing") / "file.csv",
    "file handle": lambda draw: os.devnull,
}  # fmt: skip


# --- what an argument may take: kinds of arguments, and whether a value is one of them


def is_number(value: Any, low: float = -math.inf) -> bool:
    """A single real number of a size that can be computed with, at least `low`."""
    if isinstance(value, (bool, np.bool_, np.longdouble)) or np.ma.isMaskedArray(value):
        return False
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return False
    if isinstance(value, (np.ndarray, jax.Array)):
        if jnp.issubdtype(value.dtype, jax.dtypes.prng_key) or value.dtype.kind not in "iuf" or value.ndim:
            return False
    elif not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    return abs(float(value)) <= LARGEST and float(value) >= low


def is_array(value: Any, low: float = -math.inf) -> bool:
    """Real numbers along one dimension."""
    if isinstance(value, (list, tuple)):
        return all(is_number(one, low) for one in value)
    if isinstance(value, range):
        return len(value) < 10**6
    if isinstance(value, (pd.Series, xr.DataArray)):
        value = value.to_numpy()
    if not isinstance(value, (np.ndarray, jax.Array)) or np.ma.is_masked(value) or value.ndim != 1:
        return False
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key) or value.dtype.kind not in "iuf":
        return False
    return all(is_number(one, low) for one in np.asarray(value))


def is_reals(value: Any) -> bool:
    """Real numbers along any dimensions."""
    if isinstance(value, (list, tuple)):
        return all(is_reals(one) for one in value)
    if isinstance(value, np.ndarray) and value.ndim > 1:
        return not np.ma.is_masked(value) and all(is_reals(row) for row in value)
    if isinstance(value, jax.Array) and value.ndim > 1:
        return is_reals(np.asarray(value))
    return is_number(value) or is_array(value)


def is_start(value: Any) -> bool:
    """Numbers of any size: how such a motion ends, its status tells."""
    is_large = isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.ndim == 1
    return is_array(value) or (is_large and bool(np.all(np.isfinite(value))))


def is_whole(value: Any, low: int = 1) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.bool_)) and value >= low


def is_truth(value: Any) -> bool:
    return isinstance(value, (bool, np.bool_))


def is_field(value: Any, low: float = -math.inf) -> bool:
    """A number, or in place of it one for each sample, or a distribution."""
    return is_number(value, low) or is_array(value, low) or (is_distribution(value))


def is_of_contacts(value: Any, low: float) -> bool:
    """An array with a number for each of several contacts."""
    return isinstance(value, (np.ndarray, jax.Array)) and np.size(value) > 0 and is_array(value, low)


def is_motion(value: Any) -> bool:
    return not isinstance(value, type) and any(hasattr(value, name) for name in ("sample", "velocity", "value"))


KINDS: dict[str, Callable[[Any], bool]] = {
    "number": is_number,
    "positive": lambda value: is_number(value, 1e-100),
    "not negative": lambda value: is_number(value, 0.0),
    "share": lambda value: is_number(value) and 0 < value < 1,
    "field": is_field,
    "positive field": lambda value: is_field(value, 1e-100),
    "not negative field": lambda value: is_field(value, 0.0),
    "positive per contact": lambda value: is_number(value, 1e-100) or is_of_contacts(value, 1e-100),
    "not negative per contact": lambda value: is_number(value, 0.0) or is_of_contacts(value, 0.0),
    "force": lambda value: isinstance(value, (ss.Signal, ss.Recorded, ss.ForceSteps)),
    "array": is_array,
    "reals": is_reals,
    "start": is_start,
    "number or array": lambda value: is_number(value) or is_array(value),
    "whole": is_whole,
    "whole or zero": lambda value: is_whole(value, 0),
    "truth": is_truth,
    "word": lambda value: isinstance(value, str),
    "words": lambda value: isinstance(value, (list, tuple)) and all(isinstance(one, str) for one in value),
    "key": lambda value: value is KEY,
    "system": lambda value: isinstance(value, ss.System),
    "friction": lambda value: isinstance(value, _parent(ss.Coulomb)),
    "plain friction": lambda value: takes("friction", value) and value.inner_state is None,
    "growth": lambda value: callable(value) and not isinstance(value, type),
    # A number is a constant one, of each sample its own if there are several.
    "base": lambda value: is_field(value) or is_motion(value),
    "distribution": lambda value: isinstance(value, ss.RandomNumber),
    "signal": lambda value: isinstance(value, (ss.Signal, ss.Recorded)),
    "method": lambda value: isinstance(value, (ss.Exact, ss.Regularized)),
    "nothing": lambda value: isinstance(value, dict) and not value,
    "mapping": lambda value: isinstance(value, dict),
    "table": lambda value: isinstance(value, pd.DataFrame),
    "design": lambda value: isinstance(value, ss.design.Design),
    "function": callable,
    "path": lambda value: isinstance(value, (str, os.PathLike)),
    "never": lambda value: False,
    "any": lambda value: True,
}  # fmt: skip


def _parent(kind: type) -> type:
    return next(one for one in kind.__mro__ if one.__name__ == "FrictionLaw")


def takes(kind: str, value: Any) -> bool:
    """Whether an argument of this kind may take the value; "optional ...": None too, "... or ...": one of several."""
    if kind.startswith("optional "):
        return value is None or takes(kind.removeprefix("optional "), value)
    if kind not in KINDS and " | " in kind:
        return any(takes(one, value) for one in kind.split(" | "))
    return KINDS[kind](value)


# --- calls


class Target(NamedTuple):
    """A call that is right with the arguments `usual`; `kinds`: of the arguments that may be wrong.

    `also`: other names by which a refusal may speak of the arguments.
    """

    call: Callable[..., Any]
    usual: dict[str, Any]
    kinds: dict[str, str]
    also: tuple[str, ...] = ()


def fields(call: Callable[..., Any], also: tuple[str, ...] = (), **given: tuple[Any, str]) -> Target:
    """A target with the usual value and kind of each argument."""
    return Target(
        call,
        {name: value for name, (value, _) in given.items()},
        {name: kind for name, (_, kind) in given.items()},
        also,
    )
