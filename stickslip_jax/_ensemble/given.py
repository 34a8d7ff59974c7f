"""Ensembles of what `simulate_ensemble` did not simulate: tables of measured sticks, and results of `simulate`
under ``vmap``.
"""

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._dynamics.common.lanes import SampleTotals
from .._dynamics.simulation import Simulation
from .._dynamics.sticks import NUMBERS, FlatSticks
from .._foundation import checks
from .._foundation.types import Ending
from .._statistics.quantities import Numbering
from .._systems.system import Coordinate
from .data import Fields, GivenMotions, Unknown, UnknownSystem, single
from .parts import EnsembleAccumulator, EnsemblePart

# Tables of measured sticks, checked and put in order.


_OPTIONAL = NUMBERS[2:]  # numbers of a stick that need not be measured
_READ = ("sample", "start", "end", "duration", *_OPTIONAL, "ending")
_ROUND_OFF = 1e-9  # of the duration of the measurement: ends within it of the next start, or of t1, are on time
_MOST_SAMPLES = 10**8
_ROUNDED = 1e-5  # of the duration of the measurement: by so much columns of few digits may contradict each other


def measured_sticks(table: object, t1: float, samples: int | None) -> tuple[FlatSticks, str | None]:
    """The sticks of a table, in order of sample and time, and the unit in the name of its column of positions.

    Arguments and errors of `Ensemble.from_sticks`.
    """
    columns, unit = _columns(table)
    number, samples = _numbers_of_samples(columns["sample"], samples)
    start = _numbers("start", columns)
    end = _numbers("end", columns) if "end" in columns else start + _numbers("duration", columns)
    order = np.lexsort((start, number))
    number, start, end = number[order], start[order], end[order]
    end = np.where(np.abs(end - t1) <= _ROUND_OFF * t1, t1, end)
    duration = _numbers("duration", columns)[order] if "duration" in columns else end - start
    # Sticks lie in [0, t1], have a duration, and do not overlap.
    same, again = number[1:] == number[:-1], np.zeros(len(start), bool)
    again[1:] = same & (start[1:] < end[:-1] - _ROUND_OFF * t1)

    def stick(at: int) -> str:
        return f"its row {order[at]} has a stick from {start[at]:g} to {end[at]:g} s"

    _refuse(start < 0, "starts of 0 s or later", stick)
    _refuse(end > t1, f"ends of at most t1 = {t1:g} s", stick)
    _refuse(~(end > start), "sticks that end after they start", stick)
    _refuse(again, "sticks of a sample that do not overlap", stick)
    _refuse(
        np.abs(start + duration - end) > _ROUNDED * t1,
        "ends that are start + duration",
        lambda at: f"{stick(at)} with a duration of {duration[at]:g} s; leave out the column that is wrong",
    )
    # An end within round-off of the next start is that start.
    late = np.flatnonzero(same & (end[:-1] > start[1:]))
    end[late] = start[late + 1]
    others = {name: _numbers(name, columns)[order] for name in _OPTIONAL if name in columns}
    ending = np.where(end == t1, Ending.HORIZON, 0)
    if "ending" in columns:  # codes or names
        known = {str(key): int(ending) for ending in Ending for key in (ending.name, int(ending))}
        given = columns["ending"]
        codes = np.array([known.get(str(entry), -1) for entry in given.tolist()], np.int8)
        allowed = f"{checks.one_of(Ending.__members__)} in the column ending"
        _refuse(codes < 0, allowed, lambda at: f"its row {at} has {checks.show(given[at])}")
        ending = codes[order]
    count = np.bincount(number, minlength=samples)
    return FlatSticks.of(count, start, end, ending.astype(np.int8), **others), unit


def _unfit(demand: str, found: str) -> ValueError:
    """The error of a table that lacks what it must have."""
    return ValueError(f"Argument table must have {demand}, but {found}.")


def _refuse(wrong: np.ndarray, demand: str, found: Callable[[int], str]) -> None:
    """Raises ValueError where an entry is `wrong`, with what is `found` at the first."""
    if np.any(wrong):
        raise _unfit(demand, found(int(np.argmax(wrong))))


def _columns(table: Any) -> tuple[dict[str, np.ndarray], str | None]:
    """The columns of the table by name, and the unit of the position if its column's name says it."""
    try:
        given = {str(name): _column(table[name]) for name in (table if isinstance(table, Mapping) else table.columns)}
    except (AttributeError, KeyError, TypeError, ValueError):
        raise checks.refused(
            "table", "be a pandas DataFrame or a dict of arrays with columns sample, start, and end or duration", table
        ) from None
    found, unit = {}, None
    for name, column in given.items():
        short = next((one for one in _READ if name == one or name.startswith(f"{one}_")), None)
        if short is None or (short in found and name != short):
            continue
        if short in ("start", "end", "duration") and name not in (short, f"{short}_s"):
            raise _unfit("times in s", f"it has a column {name!r}; convert it")
        if short == "position" and name != short:
            unit = name.removeprefix("position_")
        found[short] = column
    missing = [name for name in ("sample", "start") if name not in found]
    if missing or not {"end", "duration"} & set(found):
        names = ", ".join(map(repr, given)) or "none"
        raise _unfit("the columns sample, start (s), and end (s) or duration (s)", f"its columns are {names}")
    lengths = {name: np.shape(column) for name, column in found.items()}
    if any(len(shape) != 1 for shape in lengths.values()) or len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {shape}" for name, shape in lengths.items())
        raise _unfit("columns of the same length", f"their shapes are {shown}")
    for name in _OPTIONAL:  # all empty: not measured
        if name in found and found[name].dtype.kind == "f" and len(found[name]) and np.all(np.isnan(found[name])):
            del found[name]
    return found, unit


def _column(given: Any) -> np.ndarray:
    """A column of the table; masked entries are not numbers. Raises ValueError for rows of different lengths."""
    checks.tree("table", given)
    checks.tree("table", [given])  # as a row: of a masked number in it NumPy would make NaN
    if np.ma.is_masked(given):
        return given.astype(object).filled(None)
    if isinstance(given, range):
        return checks.numbers("table", given)
    try:
        return np.asarray(given)
    except Exception as error:  # the object is anybody's
        raise ValueError(str(error)) from error


def _numbers(name: str, columns: dict[str, np.ndarray]) -> np.ndarray:
    column = columns[name]
    if column.dtype.kind not in "iuf":
        raise _unfit(f"numbers in the column {name}", f"its type is {column.dtype}")
    todo = "leave out the row, or a column that was not measured"
    finite = f"finite numbers in the column {name}"
    _refuse(~np.isfinite(column), finite, lambda at: f"its row {at} has {column[at]}; {todo}")
    return column.astype(np.float64)


def _numbers_of_samples(labels: np.ndarray, samples: int | None) -> tuple[np.ndarray, int]:
    """The number of each stick's sample, from 0, and how many samples there are."""
    if samples is not None:
        samples = checks.whole_number("samples", samples, maximum=_MOST_SAMPLES)
    if labels.dtype.kind == "f" and np.all(np.abs(labels) < 2**53) and np.all(labels == np.round(labels)):
        labels = labels.astype(np.int64)
    if labels.dtype.kind not in "iu":
        if labels.dtype.kind not in "OUST":
            raise _unfit("whole numbers or names in the column sample", f"its type is {labels.dtype}")
        if any(label is None or (isinstance(label, float) and math.isnan(label)) for label in labels.tolist()):
            raise _unfit("a number or name in every row of the column sample", "one is empty; leave out the row")
        present, number = np.unique(labels.astype(str), return_inverse=True)
        if samples is not None and samples < len(present):
            raise checks.refused("samples", f"be at least the {len(present)} samples in the table", samples)
        return number, len(present) if samples is None else samples
    least, most = (int(labels.min()), int(labels.max())) if len(labels) else (0, -1)
    if samples is not None:
        if least < 0 or most >= samples:
            allowed = f"sample numbers from 0 to {samples - 1}, because samples = {samples}"
            raise _unfit(allowed, f"they are from {least} to {most}; renumber them from 0")
        return labels.astype(np.int64), samples
    if not len(labels):
        raise ValueError(
            "Argument samples must be given for a table without sticks: how many samples were measured; None was given."
        )
    present = np.unique(labels)
    if least not in (0, 1) or len(present) != most - least + 1:
        raise ValueError(
            "Argument samples must be given where sample numbers have gaps or begin beyond 1, because samples without "
            f"a stick count too; the table has {len(present)} samples, numbered from {least} to {most}."
        )
    return labels.astype(np.int64) - least, len(present)


# Ensembles of what `simulate_ensemble` did not simulate: results of `simulate` under ``vmap``, and measured sticks.


_UNIT = re.compile(r"[^\W\d_][^\s_,;]{0,15}|%|°|1")  # letters first, as in "m", "mm", "µm", "rad" or "m/s"


def fields_of_simulations(result: object, numbering: Numbering) -> Fields:
    """The fields of the `Ensemble` of a batch of simulations; see `Ensemble.from_simulations`."""
    if not isinstance(result, Simulation) or np.ndim(result.status) != 1:
        shown = f"one of shape {np.shape(result.status)}" if isinstance(result, Simulation) else checks.show(result)
        raise ValueError(
            "Argument result must be a batch of simulations, jax.vmap(lambda ...: simulate(...))(...) over one axis, "
            f"but {shown} was given."
        )
    if checks.holds_traced(result):
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

    def differs(leaf: Any) -> bool:
        return bool(np.ndim(leaf)) and not np.all(np.asarray(leaf) == np.asarray(leaf)[:1])

    def shared(leaf: Any) -> Any:  # what is the same in all simulations stands once; the rest stays (samples,)
        if not np.ndim(leaf) or len(leaf) != samples:
            return leaf
        return np.asarray(leaf) if differs(leaf) else single(np.asarray(leaf)[0])

    system, law, method = (jax.tree.map(shared, part) for part in (result.system, result.base, result.method))
    leaves = jax.tree.leaves(result.base)
    if any(np.ndim(leaf) and len(leaf) == samples for leaf in leaves) and any(map(differs, leaves)):
        law = GivenMotions(jax.tree.map(np.asarray, result.base))
    # The sticks without padding, and the totals of each simulation.
    mask = np.asarray(result.sticks.mask)
    columns = {name: np.asarray(getattr(result.sticks, name))[mask] for name in (*NUMBERS, "ending")}
    sticks = FlatSticks.of(mask.sum(axis=1), **columns)
    parts = (result.totals.sticks, result.totals.censored, result.totals.stick_time)
    number, censored, time = (np.asarray(part) for part in parts)
    slips = number + 1 - sticks.begins_at_zero - censored
    results = SampleTotals(number, slips, time, np.asarray(result.status), np.asarray(result.near_grazing_count))
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
    checks.positive("t1", t1, "s")
    if period is not None:
        checks.positive("period", period)
        period = float(period)
    if position_unit is not None:
        if not isinstance(position_unit, str) or not _UNIT.fullmatch(position_unit):
            raise checks.refused("position_unit", "be a unit such as 'm', 'mm' or 'rad'", position_unit)
        position_unit = str(position_unit)
    sticks, unit = measured_sticks(table, float(t1), samples)
    if position_unit is not None and unit not in (None, position_unit):
        wanted = f"be {unit!r}, because the table has the column 'position_{unit}'"
        raise checks.refused("position_unit", wanted, position_unit, "leave it out, or rename the column")
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
    part = EnsemblePart.of(results, counted, t1, numbering, True, period)
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
