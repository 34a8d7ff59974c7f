"""The arguments that `calibrate` and `log_likelihood` share, checked."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .. import _checks
from .. import _diffrax as diffrax
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.validation import Arguments
from .._excitation.excitation import BaseMotion
from .._systems.system import System
from .._types import InitialState
from .record import Observer, Record


class Asked(NamedTuple):
    """What is simulated, with a method that has derivatives; the state at t = 0; and what was measured."""

    arguments: Arguments
    start: np.ndarray
    record: Record


def asked(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    noise: Mapping[str, float] | None,
    y0: InitialState | None,
    observe: Mapping[str, Observer] | None,
    method: Exact | Regularized,
) -> Asked:
    """The checked arguments. Raises ValueError for those that do not fit."""
    _checks.bounded("times", times, "s", at_least=0, ndim=1)
    ends = np.asarray(times, float)
    if not len(ends) or not ends[-1] > 0:
        raise _checks.refused("times", "be at least two increasing times from 0 on (in s)", times)
    arguments, start = Arguments.of_one(system, base, method, float(ends[-1]), y0)
    if isinstance(method, Exact):  # smoothed friction follows a realisation, which has no numbers to estimate
        arguments = arguments._replace(base=base)
    elif method.step is None and method.adjoint is None:
        arguments = arguments._replace(method=dataclasses.replace(method, adjoint=diffrax.ForwardMode()))
    return Asked(arguments, np.array(start, float), Record.of(system, times, measured, noise, observe))
