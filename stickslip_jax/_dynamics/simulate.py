"""Simulate one realisation: `simulate(system, base, t1=..., y0=...)`; the user's outputs of it."""

import dataclasses
import hashlib
import keyword
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.fields import with_fields
from .._foundation.types import DType, FloatArray, InitialState, Scalar, Status
from .._systems.system import System
from .common.method import EXACT, Arguments, Exact, Regularized, working_dtype
from .engine_choice import engine_for
from .simulation import Simulation

# Outputs of a user's own: functions of one `Simulation` that return a number.


_NOT_TRACEABLE = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.ConcretizationTypeError,
)


_SUMS = {
    "slip path": ("slip_path", "m"),
    "slip reversals": ("slip_reversals", "1"),
    "input energy": ("input_energy", "J"),
    "friction energy": ("friction_energy", "J"),
    "damping energy": ("damping_energy", "J"),
}
_KINDS = ("peak", "maximum", "minimum", "residual")
_UNITS = {
    **dict.fromkeys(("position", "elongation", "slip distance"), "m"),
    **dict.fromkeys(("velocity", "relative velocity"), "m/s"),
    **dict.fromkeys(("acceleration", "total acceleration"), "m/s^2"),
    **dict.fromkeys(("friction force", "base shear"), "N"),
    "angle": "rad",
    "angular velocity": "rad/s",
    "base torque": "N m",
    "current": "A",
    **dict.fromkeys(("angular acceleration", "total angular acceleration"), "rad/s^2"),
}


@dataclasses.dataclass(frozen=True)
class _Named:
    """An output that is known by its name, such as "peak total acceleration 2" or "slip path 0"."""

    name: str

    @property
    def _parts(self) -> tuple[str, str, int | None]:
        """What is asked; of which quantity; and of a sum of one of several contacts, the number of the contact."""
        words, _, number = self.name.rpartition(" ")
        for what in (self.name, words):
            if what in _SUMS and (what == self.name or number.isdecimal()):
                return what, "", None if what == self.name else int(number)
        what, _, quantity = self.name.partition(" ")
        if what in _KINDS and quantity:
            return what, quantity, None
        demand = f"begin with {', '.join(_KINDS)} and name a coordinate or what Simulation.response knows"
        raise checks.refused("function", f"{demand}, or be one of {', '.join(_SUMS)}", self.name)

    @property
    def unit(self) -> str:
        """Its unit; "1" where it is not known. Raises ValueError for a name that is none."""
        what, quantity, _ = self._parts
        return _SUMS[what][1] if what in _SUMS else _UNITS.get(quantity.split(" - ")[0].rstrip(" 0123456789"), "1")

    def __call__(self, one: Simulation) -> FloatArray:
        what, quantity, number = self._parts
        if what == "residual":
            return one.residual(quantity)
        if what not in _SUMS:
            return getattr(one, what)(quantity)
        value = jnp.asarray(getattr(one, _SUMS[what][0]), one.time_reached.dtype)
        if number is None:
            return value
        each = jnp.atleast_1d(value)
        return each[checks.whole_number("number", number, minimum=0, maximum=len(each) - 1)]


@dataclasses.dataclass(frozen=True)
class Output:
    """A number of one trajectory: an output of an ensemble or a sweep, or what `sensitivity` takes the mean of.

    Args:
        function: Takes a `Simulation` and returns one number; JAX traces it, so write it in ``jax.numpy``. Or a name:
            "peak", "maximum", "minimum" or "residual" (the value at the end) and what is meant, a coordinate or what
            `Simulation.response` knows, such as "peak total acceleration 2" or "residual position"; or "slip path",
            "slip reversals" (with the number of the contact where there are several), "input energy", "friction energy"
            or "damping energy".
        name: For tables and figures; in ensembles and sweeps it is that in the dict of outputs. Not given: the name
            above, or "output".
        unit: For tables and figures. Not given: that of what is named, else "1".

    Raises:
        ValueError: Unless `function` can be called or is such a name.

    >>> peak = ss.Output(lambda one: one.peak("position"), name="peak displacement", unit="m")
    >>> system, law = ss.papers.belt_oscillator(1.0), ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> many = ss.simulate_ensemble(
    ...     system, law, t1=20.0, samples=100, key=jax.random.key(0), outputs={"peak": peak}
    ... )
    >>> many.outputs["peak"].number, many.output_values["peak"].shape
    (100, (100,))
    """

    function: Callable[[Simulation], ArrayLike]
    name: str = ""
    unit: str = ""

    def __init__(
        self, function: Callable[[Simulation], ArrayLike] | str, name: str | None = None, unit: str | None = None
    ):
        named = _Named(function) if isinstance(function, str) else None
        object.__setattr__(self, "function", function if named is None else named)
        if not callable(self.function):
            raise checks.refused("function", "be a function of a Simulation", self.function)
        usual = ("output", "1") if named is None else (named.name, named.unit)
        for field, given, other in (("name", name, usual[0]), ("unit", unit, usual[1])):
            object.__setattr__(self, field, other if given is None else given)
        checks.text("name", self.name)
        checks.text("unit", self.unit)

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
                f"{shown or checks.show(found)}; return the part that is wanted, such as its maximum or its mean."
            )
        return jnp.asarray(found, dtype)


def code_of(function: Any) -> Iterator[str]:
    """The code of a function in words, those of functions in it too; of another object its class."""
    if isinstance(function, _Named):
        yield function.name
        return
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


Outputs = Mapping[str, Callable[[Simulation], ArrayLike] | Output | str] | Sequence[str]
"""Outputs by name, or names of them."""


def checked_outputs(outputs: Outputs | None, taken: Mapping[str, str]) -> dict[str, Output]:
    """The outputs, each with its name; none for None.

    `taken`: what other names are those of. Raises ValueError for anything but a dict from free names to functions.
    """
    if outputs is None:
        return {}
    if isinstance(outputs, (list, tuple)) and all(isinstance(name, str) for name in outputs):
        # "peak position 1 - position 0" is called peak_position_1_minus_position_0.
        outputs = {name.replace(" - ", " minus ").replace(" ", "_"): name for name in outputs}
    if not isinstance(outputs, Mapping):
        demand = 'be a dict from names to functions, as {"peak": lambda one: one.peak()}'
        raise checks.refused("outputs", f'{demand}, or a list of names such as "peak position"', outputs)
    found = {}
    for name, given in outputs.items():
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
            raise checks.refused("outputs", "have names that can be names in Python, such as 'peak'", name)
        if name in taken:
            raise ValueError(
                f"Argument outputs must have names of its own, but {name!r} is the name of {taken[name]}; choose "
                "another."
            )
        if not callable(given) and not isinstance(given, (Output, str)):
            raise checks.refused(f"outputs[{name!r}]", "be a function of a Simulation, its name, or an Output", given)
        output = given if isinstance(given, Output) else Output(given)
        found[name] = dataclasses.replace(output, name=name)
    return found


# Simulate one realisation: `simulate(system, base, t1=..., y0=...)`.


def simulate(
    system: System,
    base: BaseMotion,
    t1: Scalar,
    y0: InitialState | None = None,
    *,
    method: Exact | Regularized = EXACT,
) -> Simulation:
    """Simulate one realisation and record every stick. A pure function: works under jit, vmap, jvp, grad.

    Args:
        system: The oscillator: a `MassSpring`, a `MotorCart` or a `SwitchedSystem` of your own.
        base: Its excitation: a realisation, ``law.sample(key, t1)``; a base motion without randomness (`SquareWave`,
            `Harmonic`, `SumOfHarmonics`, `Recorded`, `WithJumps`, or an object with ``velocity(t)`` and
            ``acceleration(t)``, m/s and m/s^2); a `GroundAcceleration`; for a `MotorCart` a `SourceVoltage`.
        t1: Duration, s.
        y0: Initial state: position (m) and velocity (m/s); for a `MotorCart` angle (rad), angular velocity (rad/s) and
            current (A). Zeros by default.
        method: `Exact`, with a time step where one is needed, or `Regularized`.

    Returns:
        The trajectory; check its `status`. Its arrays have slots for all sticks that can happen.

    Raises:
        ValueError: For arguments outside these bounds, for a step too long for the shortest time scale, and for a
            function or class in the arguments that encloses a number by which JAX differentiates.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)
    ... )
    >>> one = ss.simulate(system, ss.Constant(1.0), t1=10.0, y0=(0.0, 1.0))
    >>> sticks = one.sticks
    >>> print(sticks.start[0], sticks.end[0], ss.Ending(int(sticks.ending[0])).name)
    0.0 0.25 RELEASED
    """
    checks.require_threads_of_jax()
    arguments, start = Arguments.of_one(system, base, method, t1, y0)
    dtype = working_dtype(*(leaf for leaf in jax.tree.leaves(arguments.base) if eqx.is_inexact_array(leaf)))
    try:
        method, run = engine_for(arguments).follow(start, dtype)
    except (TypeError, jax.errors.UnexpectedTracerError) as error:
        if isinstance(error, TypeError) and not ("No constant handler" in str(error) and "Tracer" in str(error)):
            raise
        # A traced number that a compiled function encloses.
        raise ValueError(
            "Arguments system and base must hold every number that JAX traces as a field, but a function or class in "
            "them encloses one; make an equinox.Module of it with the number as a field, as "
            "FrictionCurve(Falling(low)) in docs/howto/own_friction.md, or a field of your SwitchedSystem."
        ) from error
    redundant = arguments.system.redundant
    if redundant is not None:
        run = run._replace(status=jnp.where(redundant, jnp.int8(Status.REDUNDANT_CONTACTS), run.status))
    one = Simulation(system, arguments.base, t1, method, *run)
    if one.sticks.contact is not None and system.tracks.contacts == 1:
        # The only contact of a list needs no choice: sticks and totals are as those of a system without a list.
        one = with_fields(one.of_contact(0), Simulation, system=system, _of_all_contacts=one._of_all_contacts)
    return one
