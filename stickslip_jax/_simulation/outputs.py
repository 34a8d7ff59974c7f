"""Outputs of a user's own: functions of one `Simulation` that return a number."""

import dataclasses
import hashlib
import keyword
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from .. import _checks
from .._types import DType, FloatArray
from .result import Simulation

_NOT_TRACEABLE = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.ConcretizationTypeError,
)


@dataclasses.dataclass(frozen=True)
class Output:
    """A number of one trajectory: an output of an ensemble or a sweep, or what `sensitivity` takes the mean of.

    Args:
        function: Takes a `Simulation` and returns one number; JAX traces it, so write it in ``jax.numpy``.
        name: For tables and figures; in ensembles and sweeps it is that in the dict of outputs.
        unit: For tables and figures.

    Raises:
        ValueError: Unless `function` can be called.

    >>> peak = ss.Output(lambda one: one.peak("position"), name="peak displacement", unit="m")
    >>> system, law = ss.papers.belt_oscillator(1.0), ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> many = ss.simulate_ensemble(
    ...     system, law, t1=20.0, samples=100, key=jax.random.key(0), outputs={"peak": peak}
    ... )
    >>> many.outputs["peak"].number, many.output_values["peak"].shape
    (100, (100,))
    """

    function: Callable[[Simulation], ArrayLike]
    name: str = "output"
    unit: str = "1"

    def __post_init__(self):
        if not callable(self.function):
            raise _checks.refused("function", "be a function of a Simulation", self.function)
        _checks.text("name", self.name)
        _checks.text("unit", self.unit)

    @property
    def code_sum(self) -> str:
        """A check sum of what the function does: of its code, and of the numbers and words that it holds."""
        return hashlib.sha256("\n".join(code_of(self.function)).encode()).hexdigest()[:16]

    def number(self, one: Simulation, dtype: DType) -> FloatArray:
        """The number of one trajectory. Raises ValueError for a function that does not return one."""
        argument = f"outputs[{self.name!r}]"
        try:
            found: Any = self.function(one)
        except _NOT_TRACEABLE as error:
            raise ValueError(
                f"Argument {argument} must be a function that JAX can trace, but it makes NumPy, float(), or an if of "
                "Python, take numbers that JAX traces; write it in jax.numpy: jnp.max for np.max, jnp.where for if."
            ) from error
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise ValueError(
                f"Argument {argument} must be a function of a Simulation that returns a number, but it raised {reason}"
            ) from error
        shown = f"an array of shape {np.shape(found)}" if isinstance(found, (jax.Array, np.ndarray)) else None
        is_number = isinstance(found, (int, float, np.generic, np.ndarray, jax.Array)) and np.shape(found) == ()
        if not is_number or jnp.asarray(found).dtype.kind not in "biuf":
            raise ValueError(
                f"Argument {argument} must be a function that returns one number of a Simulation, but it returned "
                f"{shown or _checks.show(found)}; return the part that is wanted, such as its maximum or its mean."
            )
        return jnp.asarray(found, dtype)


def code_of(function: Any) -> Iterator[str]:
    """The code of a function in words, those of functions in it too; of another object its class."""
    function = getattr(function, "__wrapped__", function)
    code = function if isinstance(function, types.CodeType) else getattr(function, "__code__", None)
    if code is None:
        yield type(function).__qualname__
        return
    yield from (code.co_code.hex(), *code.co_names)
    held = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    for value in (*code.co_consts, *held, *(getattr(function, "__defaults__", None) or ())):
        if isinstance(value, types.CodeType) or hasattr(value, "__code__"):
            yield from code_of(value)
        else:
            yield repr(value) if isinstance(value, (int, float, str, tuple, type(None))) else type(value).__qualname__


Outputs = Mapping[str, Callable[[Simulation], ArrayLike] | Output]
"""Outputs by name."""


def checked_outputs(outputs: Outputs | None, taken: Mapping[str, str]) -> dict[str, Output]:
    """The outputs, each with its name; none for None.

    `taken`: what other names are those of. Raises ValueError for anything but a dict from free names to functions.
    """
    if outputs is None:
        return {}
    if not isinstance(outputs, Mapping):
        raise _checks.refused(
            "outputs", 'be a dict from names to functions, as {"peak": lambda one: one.peak()}', outputs
        )
    found = {}
    for name, given in outputs.items():
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
            raise _checks.refused("outputs", "have names that can be names in Python, such as 'peak'", name)
        if name in taken:
            raise ValueError(
                f"Argument outputs must have names of its own, but {name!r} is the name of {taken[name]}; choose "
                "another."
            )
        if not callable(given) and not isinstance(given, Output):
            raise _checks.refused(f"outputs[{name!r}]", "be a function of a Simulation, or an Output", given)
        output = given if isinstance(given, Output) else Output(given)
        found[name] = dataclasses.replace(output, name=name)
    return found
