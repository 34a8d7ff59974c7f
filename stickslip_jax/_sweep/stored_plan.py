"""The sweep that a manifest describes: checked as a `Sweep` checks its arguments, for a file may have been edited."""

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from .. import _checks
from .._dynamics.common.validation import check_method
from .._ensemble.encoding import Decoder
from .._ensemble.unknown import Unknown
from .._simulation.outputs import Output
from .._statistics.accumulator import Numbering
from .errors import SweepError
from .manifest import OBJECTS, Manifest
from .plan import Plan, checked_derivatives, checked_errors, checked_keep, checked_statistics
from .points import Dimension, Points
from .setting import Setting, setting_of

_Known = TypeVar("_Known")
_UNFIT = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def plan_in(body: Manifest, *, to_run: bool = True, every_point: bool = False) -> Plan:
    """The sweep that a manifest describes; `every_point`: whether each is checked, as by `Sweep`, or the first.

    Raises SweepError where it holds objects of a user's own classes, which cannot be run (with `to_run` False these are
    left as they are stored), and for what does not fit together. Statistics and derivatives that this version does not
    know are left out, with a warning.
    """
    try:
        plan = _plan(body, to_run)
        if every_point:
            plan.check()
        elif to_run:
            plan.setting_at(0)
        return plan
    except SweepError:
        raise
    except _UNFIT as error:
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise SweepError(f"its manifest cannot be used ({reason}); run the sweep into another folder.") from error


def _plan(body: Manifest, to_run: bool) -> Plan:
    fields = body["deciding"] | body["asked"]
    if fields["dtype"] not in ("float64", "float32"):
        raise ValueError(f"dtype is {_checks.show(fields['dtype'])}")
    keep = checked_keep(fields["keep"])
    derivatives = [(name, tuple(wrt)) for name, wrt in fields["derivatives"]]
    statistics = _known(fields["statistics"], lambda name: checked_statistics([name], keep))
    fields |= {
        "numbering": Numbering.checked(*fields["numbering"]),
        "key_data": _key_data(fields["key_data"]),
        "statistics": statistics,
        "derivatives": _known(derivatives, lambda one: checked_derivatives([one])),
        "standard_errors": checked_errors(fields["standard_errors"] or None, statistics),
    }
    fields["outputs"] = _outputs(fields.pop("output_code"), to_run)
    return Plan(_setting(body, to_run), _points(body["dimensions"]), **fields)


def _outputs(stored: list[list[str]], to_run: bool) -> dict[str, Output]:
    """The outputs, whose functions are not stored."""
    if stored and to_run:
        raise SweepError(
            f"its outputs ({', '.join(name for name, *_ in stored)}) are functions of your own, which are not stored; "
            "run your own program again with the same folder, which goes on from here."
        )
    return {name: Output(_not_stored, name, unit) for name, unit, _ in stored}


def _not_stored(one: object) -> float:
    raise SweepError("the functions of outputs are not stored")


def _setting(body: Manifest, to_run: bool) -> Setting:
    floats = np.array([float.fromhex(value) for value in body["floats"]])
    decoder = Decoder(floats, np.array(body["integers"], np.int64))
    objects = {name: decoder.decoded(body["objects"][name]) for name in OBJECTS}
    for name, value in objects.items():
        for one in value if isinstance(value, tuple) else (value,):
            if to_run and isinstance(one, Unknown):
                raise SweepError(
                    f"its {name} is a {one.name} of your own, which is stored as text only; run your own program again "
                    "with the same folder, which goes on from here."
                )
    if not to_run:
        return Setting(**objects)
    check_method(objects["method"])
    return setting_of(**objects)


def _points(dimensions: list[Any]) -> Points:
    found = []
    for one in dimensions:
        parameters, values = tuple(one["parameters"]), np.array(one["values"], float)
        if not parameters or values.ndim != 2 or values.shape[1] != len(parameters) or not len(values):
            raise ValueError(f"the values of {', '.join(map(str, parameters))} are no points")
        if not np.all(np.isfinite(values)):
            raise ValueError(f"a value of {', '.join(map(str, parameters))} is not finite")
        found.append(Dimension(one["name"], parameters, values))
    if not found:
        raise ValueError("it has no points")
    return Points(tuple(found))


def _key_data(words: object) -> tuple[int, ...] | None:
    if words is None:
        return None
    if not isinstance(words, list) or not all(type(word) is int and 0 <= word < 2**32 for word in words):
        raise ValueError(f"key is {_checks.show(words)}")
    return tuple(words)


def _known(names: object, check: Callable[[Any], tuple[_Known, ...]]) -> tuple[_Known, ...]:
    """Those of the `names` that this version knows; a warning tells of the others."""
    if not isinstance(names, list):
        raise TypeError(f"statistics are {_checks.show(names)}")
    known = []
    for name in names:
        try:
            known += check(name)
        except ValueError:
            shown = name if isinstance(name, str) else name[0]
            warnings.warn(
                f"The sweep asks for {_checks.show(shown)}, which this version of stickslip_jax does not know; it is "
                "left out.",
                stacklevel=2,
            )
    return tuple(dict.fromkeys(known))
