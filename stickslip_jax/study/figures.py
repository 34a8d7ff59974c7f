"""The figures of a study, drawn by `stickslip_jax.plot`."""

import math
from functools import partial
from pathlib import Path

import jax

from .._status import Status
from ..ensemble_result import Ensemble
from ..simulate import Simulation, simulate
from .config import StudyConfig
from .folder import PHASE_PORTRAIT, STICK_DURATIONS, TIME_HISTORY

_PERIODS_SHOWN = 16  # of the free oscillation: more would run into each other
_LARGEST_CAPACITY = 2**22


def draw_figures(config: StudyConfig, ensemble: Ensemble, folder: Path) -> None:
    """Draw the beginning of sample 0, and the durations of all sticks if they were kept, as PNG files in `folder`."""
    from .. import plot  # noqa: PLC0415 - slow to load, and not wanted with --no-figures

    one = beginning_of_sample_0(config)
    if int(one.status) == Status.FINISHED:
        title = f"Sample 0, first {float(one.t1):.3g} s of {config.run.t1:g} s"
        plot.save(plot.time_history(one), folder / TIME_HISTORY, title=title)
        plot.save(plot.phase_portrait(one), folder / PHASE_PORTRAIT, title=title)
    if ensemble.flat_sticks is not None:
        title = f"Stick durations in {ensemble.samples} samples"
        plot.save(plot.stick_durations(ensemble), folder / STICK_DURATIONS, title=title)


def beginning_of_sample_0(config: StudyConfig) -> Simulation:
    """Sample 0 of the ensemble with all its events, up to an instant that a figure can show."""
    run, system, law = config.run, config.system.build(), config.base.build()
    t1 = min(run.t1, _PERIODS_SHOWN * 2 * math.pi / float(system.angular_frequency))
    y0 = (run.initial_position, run.initial_velocity)
    key = jax.random.fold_in(jax.random.key(run.seed), 0)
    capacity = law.capacity(t1)

    @partial(jax.jit, static_argnames="capacity")
    def sample_0(capacity: int) -> Simulation:
        return simulate(system, law.sample(key, t1, capacity=capacity), t1=t1, y0=y0)

    while True:
        one = sample_0(capacity=capacity)
        if int(one.status) != Status.BASE_TOO_SHORT or capacity > _LARGEST_CAPACITY:
            return one
        capacity *= 2
