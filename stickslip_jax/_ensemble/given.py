"""Ensembles of what `simulate_ensemble` did not simulate: results of `simulate` under ``vmap``, and measured sticks."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .. import _checks
from .._dynamics.common.engine import SampleTotals
from .._events.sticks import NUMBERS, FlatSticks
from .._simulation.result import Simulation
from .._statistics.accumulator import Numbering
from .._status import Ending
from .._systems.system import Coordinate
from .data import Fields, GivenMotions, single
from .measured import measured_sticks
from .parts import EnsembleAccumulator, Part
from .unknown import Unknown, UnknownSystem

_UNIT = re.compile(r"[^\W\d_][^\s_,;]{0,15}|%|°|1")  # letters first, as in "m", "mm", "µm", "rad" or "m/s"


def _check_unit(unit: object) -> None:
    if not isinstance(unit, str) or not _UNIT.fullmatch(unit):
        raise _checks.refused("position_unit", "be a unit such as 'm', 'mm' or 'rad'", unit)


def fields_of_simulations(result: object, numbering: Numbering) -> Fields:
    """The fields of the `Ensemble` of a batch of simulations; see `Ensemble.from_simulations`."""
    if not isinstance(result, Simulation) or np.ndim(result.status) != 1:
        shown = f"one of shape {np.shape(result.status)}" if isinstance(result, Simulation) else _checks.show(result)
        raise ValueError(
            "Argument result must be a batch of simulations, jax.vmap(lambda ...: simulate(...))(...) over one axis, "
            f"but {shown} was given."
        )
    if _checks.holds_traced(result):
        raise ValueError(
            "Argument result must hold numbers, but JAX is tracing them; make the ensemble outside jit, vmap and grad."
        )
    if result.sticks.contact is not None:
        raise ValueError(
            "Argument result must hold the sticks of one contact, but a batch with those of "
            f"{result.totals.sticks.shape[-1]} contacts was given; take result.of_contact(number) or "
            "result.of_all_contacts()."
        )
    samples = len(result.status)
    horizons = np.unique(np.asarray(result.t1, float))
    if len(horizons) != 1:
        raise ValueError(
            "Argument result must hold simulations of the same duration t1, but durations from "
            f"{horizons.min():g} to {horizons.max():g} s were given; make one ensemble of each."
        )
    start = jax.vmap(lambda path: path.state(jnp.zeros((), result.sticks.start.dtype)))(result._path)
    y0 = tuple(np.asarray(value) + 0.0 for value in start[: len(result.final_state)])  # and no -0.0
    system, law, method = (_shared(part, samples) for part in (result.system, result.base, result.method))
    if any(np.ndim(leaf) and len(leaf) == samples for leaf in jax.tree.leaves(result.base)) and _varies(result.base):
        law = GivenMotions(jax.tree.map(np.asarray, result.base))
    sticks, results = _of_batch(result)
    return {
        **_summed(results, sticks, float(horizons[0]), numbering, system.stick_position.period),
        "system": system,
        "law": law,
        "method": method,
        "y0": tuple(float(values[0]) if np.all(values == values[0]) else values for values in y0),
        "dtype": str(sticks.start.dtype),
    }


def fields_of_sticks(
    table: object, t1: float, samples: int | None, position_unit: str | None, period: float | None, numbering: Numbering
) -> Fields:
    """The fields of the `Ensemble` of measured sticks; see `Ensemble.from_sticks`."""
    _checks.positive("t1", t1, "s")
    if period is not None:
        _checks.positive("period", period)
        period = float(period)
    if position_unit is not None:
        _check_unit(position_unit)
        position_unit = str(position_unit)
    sticks, unit = measured_sticks(table, float(t1), samples)
    if position_unit is not None and unit not in (None, position_unit):
        raise ValueError(
            f"Argument position_unit must be {unit!r}, because the table has the column 'position_{unit}', but "
            f"{position_unit!r} was given; leave it out, or rename the column."
        )
    position = Coordinate("position when the stick starts", position_unit or unit or "m", period=period)
    count = sticks.count
    starts_stuck, ends_stuck = sticks.begins_at_zero, np.zeros(len(count), bool)
    ends_stuck[count > 0] = sticks.ending[(sticks.first + count - 1)[count > 0]] == Ending.HORIZON
    time = np.bincount(sticks.sample, weights=sticks.duration, minlength=len(count))
    none = np.zeros(len(count), np.int32)
    touching = np.bincount(sticks.sample[sticks.touches], minlength=len(count))
    slips = count + 1 - starts_stuck - ends_stuck - touching
    results = SampleTotals(count.astype(np.int32), slips, time, none, none)
    about = "measured sticks"
    return {
        **_summed(results, sticks, float(t1), numbering, position.period),
        "system": UnknownSystem(about, "", position),
        "law": Unknown(about),
        "method": None,
        "y0": (),
        "dtype": "float64",
    }


def _summed(results: SampleTotals, sticks: FlatSticks, t1: float, numbering: Numbering, period: float | None) -> Fields:
    """The fields of an `Ensemble` that follow from its sticks, and those that say how long it took."""
    samples = len(results.status)
    # Columns that are not known must not spoil the sums of the rest; `EnsembleStatistics` gives no number of them.
    unknown = np.all(np.isnan(sticks.numbers), axis=1)
    counted = sticks._replace(numbers=np.where(unknown[:, None], 0, sticks.numbers))
    part = Part.of(results, counted, t1, numbering, True, period)
    if part.sticks is not None:
        part.sticks.numbers[unknown] = np.nan
    accumulator = EnsembleAccumulator(samples, "sticks")
    accumulator.add(part)
    return {
        "t1": t1,
        "numbering": numbering,
        "samples": samples,
        "key_data": None,
        **accumulator.found(),
        "threads": 1,
        "compile_seconds": 0.0,
        "run_seconds": 0.0,
    }


def _of_batch(result: Simulation) -> tuple[FlatSticks, SampleTotals]:
    """The sticks of a batch without padding, and the totals of each simulation."""
    mask = np.asarray(result.sticks.mask)
    columns = {name: np.asarray(getattr(result.sticks, name))[mask] for name in (*NUMBERS, "ending")}
    sticks = FlatSticks.of(mask.sum(axis=1), **columns)
    totals = result.totals
    number, censored, time = (np.asarray(part) for part in (totals.sticks, totals.censored, totals.stick_time))
    slips = number + 1 - sticks.begins_at_zero - censored
    return sticks, SampleTotals(number, slips, time, np.asarray(result.status), np.asarray(result.near_grazing_count))


def _shared(part: PyTree, samples: int) -> PyTree:
    """`part` of a batch with each number that is the same in all simulations put once; the others stay (samples,)."""

    def once(leaf: Any) -> Any:
        if not np.ndim(leaf) or len(leaf) != samples:
            return leaf
        leaf = np.asarray(leaf)
        if np.all(leaf == leaf[:1]):
            return single(leaf[0])
        return leaf

    return jax.tree.map(once, part)


def _varies(base: PyTree) -> bool:
    """Whether a batch of base motions holds different ones."""
    return any(np.ndim(leaf) and not np.all(np.asarray(leaf) == np.asarray(leaf)[:1]) for leaf in jax.tree.leaves(base))
