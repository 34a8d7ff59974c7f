"""The bifurcation diagram of a scene whose base is deterministic."""

import warnings
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._dynamics.common.time_scales import slowest_time
from .._excitation.excitation import is_random
from .._uncertainty.random_number import RandomNumber
from ..nonlinear import bifurcation_diagram
from .pictures import labels_of
from .scene import MovableNumber, Scene

_VALUES, _TRANSIENT, _KEPT = 120, 100, 40


class Section(NamedTuple):
    """The first coordinate once a period, over the values of one number: points (points,)."""

    label: str
    state_label: str
    values: np.ndarray
    states: np.ndarray


def is_deterministic(scene: Scene) -> bool:
    """Whether what drives the system is the same in all realisations."""
    return not is_random(scene.law)


def section_of(scene: Scene, number: MovableNumber) -> Section:
    """The diagram over the range of the slider of `number`, from the start of the scene.

    A random start counts by its median. Raises ValueError for a base without a period, and for numbers that
    `bifurcation_diagram` refuses.
    """
    values = np.linspace(number.low, number.high, _VALUES)
    start = [float(one.icdf(jnp.asarray(0.5))) if isinstance(one, RandomNumber) else float(one) for one in scene.y0]
    period = slowest_time(scene.system, scene.law) if getattr(scene.law, "repeats_after", None) in (0, 0.0) else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of motions that do not reach the end, or have not settled
        found = bifurcation_diagram(
            scene.system, scene.law, {number.name: values}, y0=start, transient=_TRANSIENT, kept=_KEPT, period=period,
            longest_transient=_TRANSIENT, progress=False,
        )  # fmt: skip
    states = np.asarray(found[scene.system.coordinates[0].variable]).reshape(_VALUES, -1)
    label, _ = labels_of(scene)
    return Section(number.label, f"{label}, once a period", np.repeat(values, states.shape[1]), states.ravel())
