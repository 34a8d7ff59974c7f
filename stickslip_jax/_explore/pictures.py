"""The numbers of all pictures of a scene: one realisation, and the sticks of thousands."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._ensemble.call import simulate_ensemble
from .._ensemble.result import Ensemble
from .._excitation.excitation import is_random, law_of
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._sensitivity.call import sensitivity
from .._sensitivity.estimate import Sensitivity
from .._simulation.call import simulate
from .._simulation.result import Simulation
from .._statistics.estimate import Estimate
from .._statistics.totals import mean_stick_count, mean_stick_duration, stick_fraction
from .._status import Status
from .._uncertainty.inputs import Inputs, Model
from ..plot._trajectory import joined, phases_of
from .scene import Scene

LONGEST_HISTORY = 60.0  # s, that is drawn
_BINS = 40
_LEAST_CAPACITY = 1024  # intervals of the base: programs are compiled for few of them


class Curve(NamedTuple):
    """A realisation between its events: values of two coordinates over time, NaN where a line breaks, (points,)."""

    times: np.ndarray
    x: np.ndarray
    y: np.ndarray


class Bars(NamedTuple):
    """A histogram: `heights` (bars,) between `edges` (bars + 1,)."""

    edges: np.ndarray
    heights: np.ndarray


class Motion(NamedTuple):
    """What is drawn of the first realisation.

    - `slip`, `stick`: its parts.
    - `problem`: why it is not drawn, or "".
    """

    one: Simulation
    slip: Curve
    stick: Curve
    problem: str


class Statistics(NamedTuple):
    """What is drawn of all realisations.

    - `durations`, `starts`, `numbers`: of the sticks in those that reached the end.
    - `unfinished`: how many did not.
    """

    ensemble: Ensemble
    durations: Bars
    starts: Bars
    numbers: Bars
    means: tuple[Estimate, ...]
    unfinished: int


def motion_of(scene: Scene) -> Motion:
    """Simulate the first realisation of a scene. Raises ValueError for what `simulate` refuses."""
    one = realization(scene)
    is_whole = int(one.status) == Status.FINISHED
    phases = phases_of(one, (0.0, min(scene.t1, LONGEST_HISTORY))) if is_whole else []
    x, y = coordinates_of(scene)
    slip, stick = (
        Curve(*(joined([one for one in phases if one.sticks == sticks], name) for name in ("times", x, y)))
        for sticks in (False, True)
    )
    problem = "" if is_whole else f"This realisation has no end: {Status(int(one.status)).meaning}."
    return Motion(one, slip, stick, problem)


def statistics_of(scene: Scene) -> Statistics:
    """Simulate all realisations of a scene. Raises ValueError for what `simulate_ensemble` refuses."""
    many = simulate_ensemble(
        scene.system, scene.law, t1=scene.t1, samples=scene.samples, key=jax.random.key(scene.seed), y0=scene.y0,
        method=scene.method, keep="sticks", progress=False,
    )  # fmt: skip
    sticks = many.finished_sticks()
    return Statistics(
        ensemble=many,
        durations=_bars(sticks.duration),
        starts=_bars(sticks.start, scene.t1),
        numbers=_bars_of_counts(sticks.count),
        means=tuple(of(many) for of in (mean_stick_duration, mean_stick_count, stick_fraction)),
        unfinished=scene.samples - int(many.status_counts.get(Status.FINISHED, 0)),
    )


def slope_of(scene: Scene, name: str) -> Sensitivity:
    """The derivative of the mean stick duration by a number. Raises ValueError for what `sensitivity` refuses."""
    found = sensitivity(
        mean_stick_duration, scene.system, scene.law, wrt=name, t1=scene.t1, samples=scene.samples,
        key=jax.random.key(scene.seed), y0=scene.y0, method=scene.method,
    )  # fmt: skip
    assert isinstance(found, Sensitivity)
    return found


def realization(scene: Scene) -> Simulation:
    """The first realisation of the ensemble of a scene, with the sticks that are counted there."""
    model = Model(scene.system, law_of(scene.law), scene.y0)
    inputs = Inputs.of(model, scene.samples, jax.random.key(scene.seed))
    system, law, y0 = inputs.of_sample(0, jnp.dtype(jnp.result_type(float)))
    base: Any = law
    if isinstance(law, PiecewiseConstantLaw) and law.is_random:
        # A larger capacity only continues the motion, and one program serves for many rates.
        capacity = _LEAST_CAPACITY
        while capacity < law.capacity(scene.t1):
            capacity *= 4
        base = law.sample(jax.random.fold_in(jax.random.key(scene.seed), 0), scene.t1, capacity=capacity)
    elif is_random(law):
        base = inputs.realization_of(0, law, scene.t1)
    one = simulate(system, base, t1=scene.t1, y0=y0, method=scene.method)
    if one.sticks.contact is None:
        return one
    counted = scene.system.counted_track
    return one.of_contact(counted) if counted is not None and counted >= 0 else one.of_all_contacts()


def coordinates_of(scene: Scene) -> tuple[int, int]:
    """The numbers of the coordinates in a phase portrait: the first, and its rate."""
    known = scene.system.coordinates
    rates = [at for at, one in enumerate(known) if one.unit == f"{known[0].unit}/s"]
    return 0, (rates or [min(1, len(known) - 1)])[0]


def labels_of(scene: Scene) -> tuple[str, str]:
    """The coordinates of a phase portrait with their units."""
    known = scene.system.coordinates
    chosen = [known[at] for at in coordinates_of(scene)]
    x, y = (one.name if one.unit == "1" else f"{one.name} ({one.unit})" for one in chosen)
    return x, y


def _bars(values: np.ndarray, end: float | None = None) -> Bars:
    """A histogram of times as a density, from 0 to their largest or to `end`."""
    if not len(values):
        return Bars(np.array([0.0, end or 1.0]), np.zeros(1))
    heights, edges = np.histogram(values, _BINS, (0.0, end or float(np.max(values)) or 1.0), density=True)
    return Bars(edges, heights)


def _bars_of_counts(counts: np.ndarray) -> Bars:
    """The share of realisations with each number of sticks; of neighbouring numbers together where they are many."""
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    width = max(1, -(-(high - low + 1) // (2 * _BINS)))
    edges = np.arange(low, high + width + 1, width) - 0.5
    heights, _ = np.histogram(counts, edges)
    return Bars(edges, heights / max(1, len(counts)))
