"""The figures of a study, drawn by `stickslip_jax.plot`."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from .._ensemble.result import Ensemble
from .._excitation.random import RandomPhase
from .._excitation.voltage import SourceVoltage
from .._simulation.call import simulate
from .._simulation.result import Simulation
from .._statistics.first_sticks import FirstSticks
from .._status import Status
from .._systems.system import System
from ._config import StudyConfig
from ._folder import DURATION_AND_POSITION, PHASE_PORTRAIT, STICK_DURATIONS, TIME_HISTORY

_PERIODS_SHOWN = 16  # of the free oscillation: more could not be distinguished
_VOLTAGE_PERIODS_SHOWN = 6


def draw_figures(config: StudyConfig, ensemble: Ensemble, first_sticks: FirstSticks | None, folder: Path) -> None:
    """Draw the beginning of sample 0 and, unless only totals were kept, the sticks of all samples, as PNG files.

    - `first_sticks`: of every sample of a `MotorCart`; else None.
    - `folder`: where to write the files, which are called as in `RESULT_FILES`.
    """
    from .. import plot  # noqa: PLC0415 - slow to load, and not wanted with --no-figures

    one = beginning_of_sample_0(config, ensemble)
    if int(one.status) == Status.FINISHED:
        part = f", first {float(one.t1):.3g} s of {config.run.t1:g} s" if float(one.t1) < config.run.t1 else ""
        title = f"Sample 0{part}"
        plot.save(plot.time_history(one), folder / TIME_HISTORY, title=title)
        plot.save(plot.phase_portrait(one), folder / PHASE_PORTRAIT, title=title)
    if ensemble.accumulator is None:
        return
    plot.save(
        plot.histogram(ensemble), folder / STICK_DURATIONS, title=f"Stick durations in {ensemble.samples} samples"
    )
    if first_sticks is None:
        whose, axes = "sticks", plot.joint_histogram(ensemble.statistics.joint("duration", "position"))
    else:
        bound = _voltage(ensemble)
        whose, axes = "first sticks", plot.stick_map(first_sticks, system=ensemble.system, bound=bound)
    title = f"Duration and position of {whose} in {ensemble.samples} samples"
    plot.save(axes, folder / DURATION_AND_POSITION, title=title)


def _voltage(ensemble: Ensemble) -> SourceVoltage | RandomPhase | None:
    """The voltage if the bound of its stick durations is known in closed form; else None."""
    law = ensemble.law
    known = isinstance(law, SourceVoltage) or (isinstance(law, RandomPhase) and isinstance(law.signal, SourceVoltage))
    return law if known else None


def beginning_of_sample_0(config: StudyConfig, ensemble: Ensemble) -> Simulation:
    """Sample 0 of the ensemble with all its events, from 0 to a time short enough for a figure."""
    t1 = min(ensemble.t1, _time_shown(ensemble.system, ensemble.law))
    method = dataclasses.replace(config.run.method(config.system.has_inner_states), max_steps=None)
    for covered in (t1, 2 * t1, 4 * t1):
        # A base motion drawn for a shorter time begins in the same way: the beginning is enough, if it covers t1.
        system, base, y0 = dataclasses.replace(ensemble, t1=covered).realization(0)
        one = simulate(system, base, t1=t1, y0=y0, method=method)
        if int(one.status) != Status.BASE_TOO_SHORT:
            break
    return one


def _time_shown(system: System, law: object) -> float:
    """The longest time whose oscillations can be distinguished in a figure, s."""
    frequency = system.natural_frequency
    if frequency is None or not np.all(np.asarray(frequency) > 0):
        signal: Any = law.signal if isinstance(law, RandomPhase) else law
        return _VOLTAGE_PERIODS_SHOWN * float(getattr(signal, "shortest_period", math.inf))
    return _PERIODS_SHOWN * 2 * math.pi / float(frequency)
