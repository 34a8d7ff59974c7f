"""Ensembles and what they are made of and become: labelled arrays (``xarray``) and NetCDF files, tables of measured
sticks, results of `simulate` under ``vmap``.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from .._dynamics.common.lanes import SampleTotals
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.simulation import Simulation, method_attributes, source
from .._dynamics.sticks import (
    NUMBERS,
    QUANTITIES,
    FlatSticks,
    slip_variables,
    slips_among,
    stick_variables,
    with_columns,
)
from .._foundation import checks
from .._foundation.extras import Entries, flags, labeled_dataset, require, variable
from .._foundation.types import Ending, Status
from .._numerics.sums import Moments
from .._statistics.quantities import Numbering, StickAccumulator
from .._statistics.totals import TOTALS
from .._systems.system import Coordinate, System
from .._uncertainty.families import RandomNumber
from . import data
from .data import EnsembleAccumulator, EnsembleData, EnsemblePart, Fields, GivenMotions, Unknown, UnknownSystem
from .encoding import DamagedFileError, Decoder, Encoder, read_netcdf, verified
from .setup import MOST_SAMPLES

if TYPE_CHECKING:
    import xarray


# An ensemble as labelled arrays (``xarray``), with all that makes an ensemble of them again (see below).


FORMAT, FORMAT_VERSION = "stickslip_jax ensemble", 2
STATE, FLOATS, INTEGERS = "ensemble_state", "ensemble_state_floats", "ensemble_state_integers"
SAMPLE = {"sticks": "sample", "statistics": "finished_sample"}
"""The dimension of samples by what was kept: with "statistics" only sticks of the first samples that finished are."""


_ATTRIBUTES = {
    "t1": ("t1", float),
    "samples": ("samples", int),
    "first_sample": ("first_sample", int),
    "dtype": ("dtype", str),
    "near_grazing_samples": ("samples_near_grazing", int),
    "threads": ("threads_used", int),
    "compile_seconds": ("compile_seconds", float),
    "run_seconds": ("run_seconds", float),
}
"""Fields of an ensemble that are attributes: what they are called there, and their kind."""


def dataset_of(ensemble: EnsembleData) -> "xarray.Dataset":
    """Sticks (CF contiguous ragged arrays along ``stick``) and totals (along ``sample``), with units and long names.

    Raises:
        ImportError: As `Ensemble.to_xarray`.
    """
    variables: Entries = {}
    totals, retained, first = ensemble.sample_totals, ensemble.retained, ensemble.first_sample
    samples = variable("sample", first + np.arange(ensemble.samples), "number of the sample")
    if ensemble.flat_sticks is not None:
        slips = ensemble._flat_slips()
        variables |= _sticks(ensemble, ensemble.flat_sticks, SAMPLE["sticks"])
        variables["slip_sample"] = variable("slip", first + slips.sample, "sample of the slip")
        variables |= slip_variables(slips.start, slips.end, slips.censored)
    elif retained is not None:
        sample, (time, _, number, *_) = SAMPLE["statistics"], retained.totals.T
        variables |= _sticks(ensemble, retained.sticks, sample)
        variables["slip_count"] = variable(sample, number.astype(np.int64), "number of slips")
        variables["stick_time"] = variable(sample, time, "total stick time", "s")
    elif totals is not None:
        variables = {"sample": samples, "stick_count": variable("sample", totals.sticks, "number of sticks")}
    if totals is not None:
        near = "number of events decided by round-off"
        variables["slip_count"] = variable("sample", totals.slips, "number of slips")
        variables["stick_time"] = variable("sample", totals.stick_time, "total stick time", "s")
        variables["near_grazing_count"] = variable("sample", totals.near_grazing_count, near)
        variables["status"] = variable("sample", totals.status, "whether the sample reached t1", **flags(Status))
        for name, (column, unit) in ensemble._known_inputs().items():
            variables[f"input_{name}"] = variable("sample", column, name, unit or "1")
    units = {name: ensemble.output_units.get(name, "1") for name in ensemble.output_values}
    if units:
        variables["sample"] = samples
    for name, column in ensemble.output_values.items():
        variables[f"output_{name}"] = variable("sample", column, name, units[name])

    # What else an ensemble is made of: sums of all samples, and numbers of sticks of samples that did not finish.
    encoder = Encoder()
    named = ("system", "law", "method", "y0", "design", "copula", "moments", "accumulator")
    state = {name: getattr(ensemble, name) for name in named}
    state |= {
        "sticks": None if ensemble.flat_sticks is None else ensemble.totals.sticks,
        "origins": ensemble.origins,
        "outputs": tuple(units.items()),
        "position": tuple(ensemble.system.stick_position),
        "totals": TOTALS,
    }
    texts = {name: encoder.encoded(value) for name, value in state.items()}
    about = "for stickslip_jax.load: sums of all samples"
    variables[STATE] = variable((), json.dumps(texts), f"{about}, as JSON")
    variables[FLOATS] = variable("state_float", encoder.floats, f"{about}, long arrays of the JSON")
    variables[INTEGERS] = variable("state_integer", encoder.integers, f"{about}, long arrays of the JSON")

    # What was simulated, how, and how it ended. Numbers are in SI units; of long arrays the size is told.
    shown = Encoder()
    attributes: dict[str, object] = {
        **source(),
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "keep": ensemble.keep,
        "system": json.dumps(shown.encoded(ensemble.system)),
        "law": json.dumps(shown.encoded(ensemble.law)),
        "y0": json.dumps([shown.encoded(value) for value in ensemble.y0]),
        **{name: kind(getattr(ensemble, field)) for field, (name, kind) in _ATTRIBUTES.items()},
        "orders": ensemble.numbering.orders,
        "count_initial_rest": int(ensemble.numbering.count_initial_rest),
        **{f"samples_{status.name.lower()}": ensemble.status_counts[status] for status in Status},
        **method_attributes(ensemble.method),
    }
    if ensemble.key_data is not None:
        attributes["key_data"] = np.array(ensemble.key_data, np.uint32)
    return labeled_dataset(variables, {}, attributes)


def compression(dataset: "xarray.Dataset") -> dict[str, dict[str, object]]:
    """The encoding that ``to_netcdf`` takes, which makes small what is mostly zeros or repeats itself."""
    names = (FLOATS, INTEGERS, "stick_sample", "stick_order", "slip_sample")
    return {name: {"zlib": True, "complevel": 1} for name in names if name in dataset and dataset[name].size}


def _sticks(ensemble: EnsembleData, sticks: FlatSticks, sample: str) -> Entries:
    first = ensemble.first_sample if sample == "sample" else 0
    return {
        sample: variable(sample, first + np.arange(len(sticks.count)), f"number of the {sample.replace('_', ' ')}"),
        "stick_sample": variable("stick", first + sticks.sample, f"{sample.replace('_', ' ')} of the stick"),
        **stick_variables(sticks, ensemble.numbering.order_of(sticks), ensemble.system.stick_position),
        "stick_count": variable(sample, sticks.count, "number of sticks", sample_dimension="stick"),
    }


# Checks of an ensemble that was read: it must be one that a simulation could have given.


_METHODS = (Exact, Regularized, Unknown, type(None))
_SLACK = 1e-5  # of t1: sticks of single precision may end so much later, and a few sum to so much more


def _demand(fits: object, otherwise: str) -> None:
    """Raise ValueError, with a few words as its message, unless what an ensemble holds `fits` together."""
    if not fits:
        raise ValueError(otherwise)


def check_fields(fields: Mapping[str, Any]) -> None:
    """Raise ValueError, with a few words as its message, for fields that no ensemble has."""
    samples, y0, words = (fields[name] for name in ("samples", "y0", "key_data"))
    checks.positive("t1", fields["t1"], "s")
    checks.whole_number("samples", samples, maximum=MOST_SAMPLES)
    checks.whole_number("first_sample", fields["first_sample"], minimum=0, maximum=MOST_SAMPLES - samples)
    checks.whole_number("threads_used", fields["threads"])
    for name in ("compile_seconds", "run_seconds"):
        checks.non_negative(name, fields[name])
    _demand(fields["dtype"] in ("float32", "float64"), f"its numbers have the type {checks.show(fields['dtype'])}")
    is_key = words is None or (len(words) == 2 and all(0 <= word < 2**32 for word in words))
    _demand(is_key, f"its key is {checks.show(words)}")
    is_system, is_method = isinstance(fields["system"], System), isinstance(fields["method"], _METHODS)
    is_law = not isinstance(fields["law"], (str, bytes, int, float, dict, list, np.ndarray))
    for name, fits in (("system", is_system), ("method", is_method), ("law", is_law)):
        if not fits:  # shown only then, for it may be large
            raise ValueError(f"its {name} is {checks.show(fields[name])}")
    for value in y0 if isinstance(y0, tuple) else (None,):
        if not isinstance(value, (RandomNumber, Unknown)) and not np.all(np.isfinite(np.asarray(value, float))):
            raise ValueError(f"its trajectories start at {checks.show(y0)}")
    # The sums over all samples.
    counts, near = fields["status_counts"], fields["near_grazing_samples"]
    total = sum(counts.values())
    _demand(min(counts.values()) >= 0 and total == samples, f"it tells the endings of {total} of {samples} samples")
    _demand(0 <= near <= samples, f"it has {near} samples near grazing")
    moments, accumulator, finished, d = fields["moments"], fields["accumulator"], counts[Status.FINISHED], len(TOTALS)
    are_sums = isinstance(moments, Moments) and np.shape(moments.mean) == (d,) and np.shape(moments.scatter) == (d, d)
    _demand(are_sums, "it lacks the sums of its samples")
    are_finite = np.all(np.isfinite(moments.mean)) and np.all(np.isfinite(moments.scatter))
    of_samples = f"of {moments.number} samples, of which {finished} finished, or are not finite"
    _demand(moments.number == finished and are_finite, f"its sums are {of_samples}")
    if not isinstance(accumulator, (StickAccumulator, type(None))):
        raise ValueError(f"its histograms are {checks.show(accumulator)}")
    if accumulator is not None:
        number = int(accumulator.samples.number)
        fits = np.all(np.asarray(accumulator.endings) >= 0) and number == finished
        _demand(fits, f"its histograms are of {number} samples, of which {finished} finished")
    # What is held of each sample.
    retained, flat, totals = fields["retained"], fields["flat_sticks"], fields["sample_totals"]
    if retained is not None:
        check_sticks(retained.sticks, retained.totals[:, 0], np.ones(len(retained.totals), bool), fields["t1"])
    if totals is not None:
        are_whole = {len(column) for column in totals} == {samples}
        _demand(are_whole, f"it has totals of {len(totals.sticks)} of {samples} samples")
        present = np.bincount(_codes(totals.status, Status, "status"), minlength=len(counts))
        are_counted = all(present[status] == counts[status] for status in Status)
        _demand(are_counted, "the endings of its samples are not those that it counts")
        are_numbers = np.all(totals.slips >= 0) and np.all(totals.near_grazing_count >= 0)
        _demand(are_numbers, "it has negative numbers of slips, or of instants decided by round-off")
    for name, values in fields["output_values"].items():
        are_outputs = values.shape == (samples,) and values.dtype.kind == "f"
        _demand(are_outputs, f"it has outputs {checks.show(name)} of {len(values)} of {samples} samples")
    if flat is not None and totals is not None:
        check_sticks(flat, totals.stick_time, totals.status == Status.FINISHED, fields["t1"])


def check_sticks(sticks: FlatSticks, stick_time: np.ndarray, finished: np.ndarray, t1: float) -> None:
    """Sticks of samples that finished lie in [0, t1], one after the other, and sum to the stick time."""
    _codes(sticks.ending, Ending, "ending")
    live = finished[sticks.sample]
    start, end = (np.asarray(values, np.float64) for values in (sticks.start, sticks.end))
    late = t1 * (1 + _SLACK)
    again = np.zeros(len(start), bool)
    again[1:] = (sticks.sample[1:] == sticks.sample[:-1]) & (start[1:] < end[:-1] - _SLACK * t1)
    # NaN fails the comparisons, as it should.
    wrong = live & (~((start >= 0) & (end >= start) & (end <= late)) | again)
    if np.any(wrong):
        at = int(np.argmax(wrong))
        raise ValueError(f"it has a stick from {start[at]:g} to {end[at]:g} s, which cannot be with t1 = {t1:g} s")
    are_infinite = any(np.any(np.isinf(getattr(sticks, name)[live])) for name in NUMBERS)
    _demand(not are_infinite, "it has sticks at infinite positions")
    sums = np.zeros(len(sticks.count))
    np.add.at(sums, sticks.sample, end - start)
    # In single precision each of many sticks adds round-off of t1, of either sign.
    single = 8 * np.finfo(np.float32).eps if sticks.start.dtype == np.float32 else 0.0
    slack = (_SLACK + single * np.sqrt(sticks.count)) * t1
    _demand(np.all((np.abs(sums - stick_time) <= slack)[finished]), "its sticks do not last for its stick times")


def _codes(values: np.ndarray, kind: type[IntEnum], name: str) -> np.ndarray:
    """`values`, which must be codes of this `kind`."""
    unknown = ~np.isin(values, [int(code) for code in kind])
    if np.any(unknown):
        raise ValueError(f"it has the {name} {values[unknown][0]}, which this version does not know")
    return np.asarray(values, np.int64)


# Ensembles read from files and data sets, with all that they had when they were stored.


_STUDY = "study.nc"  # the file of a study's data in its folder


def fields_of_file(path: Path) -> Fields:
    """The fields of the `Ensemble` in a file. Raises the errors of `load`."""
    path = path / _STUDY if path.is_dir() else path
    if not path.exists():
        raise FileNotFoundError(
            "Argument path must name a file that Ensemble.save or stickslip study wrote, but there is no "
            f"{str(path)!r}; the working folder is {str(Path.cwd())!r}."
        )
    require("Files of ensembles need", "study", "xarray", "h5netcdf", "h5py")
    try:
        dataset = read_netcdf(path)
    except DamagedFileError as error:
        raise ValueError(
            f"Argument path must name a file that Ensemble.save or stickslip study wrote, but {str(path)!r} cannot be "
            f"read as such ({checks.show(str(error))}): it is cut short, damaged, or of another kind."
        ) from None
    return fields_of_dataset(dataset, is_file=True)


def fields_of_dataset(dataset: Any, *, is_file: bool = False) -> Fields:
    """The fields of the `Ensemble` that a data set holds. `is_file`: whether it was read from one, and has a sum.

    Raises:
        ValueError: As `Ensemble.from_xarray`.
    """
    name = "path" if is_file else "dataset"
    attributes = getattr(dataset, "attrs", None)
    if attributes is None or attributes.get("format") != FORMAT:
        made_by = (attributes or {}).get("source", "")
        shown = f"one written by {made_by!r}" if made_by else checks.show(type(dataset).__name__)
        raise ValueError(
            f"Argument {name} must be what Ensemble.to_xarray, Ensemble.save or stickslip study of this version wrote, "
            f"but {shown} was given, which does not say that it is an ensemble."
        )
    try:
        version = int(attributes["format_version"])
    except (KeyError, TypeError, ValueError):
        version = 0
    if version != FORMAT_VERSION:
        todo = "of a version before 0.1.0; simulate it again"
        if version > FORMAT_VERSION:
            writer = attributes.get("stickslip_jax_version")
            todo = f"written by stickslip_jax {writer}; install that version or a newer one"
        raise ValueError(f"Argument {name} must be of format {FORMAT_VERSION}, but it has format {version}, {todo}.")
    try:
        fields = _fields(verified(dataset, is_file=is_file))
        check_fields(fields)
        return fields
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, RecursionError, OverflowError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise ValueError(
            f"Argument {name} must be a whole ensemble as it was stored, but this one was changed or damaged "
            f"({checks.show(reason)}); load the original file."
        ) from None


def _fields(dataset: "xarray.Dataset") -> Fields:
    attributes = dataset.attrs
    decoder = Decoder(dataset[FLOATS].to_numpy(), dataset[INTEGERS].to_numpy())
    state = {name: decoder.decoded(value) for name, value in json.loads(str(dataset[STATE].item())).items()}
    _demand(state["totals"] == TOTALS, f"it sums {state['totals']}")
    position = Coordinate(*state["position"])
    numbering = Numbering.checked(int(attributes["orders"]), bool(attributes["count_initial_rest"]))
    key_data = attributes.get("key_data")
    counts = {one: int(attributes.get(f"samples_{one.name.lower()}", 0)) for one in Status}
    keep = str(attributes["keep"])
    fits = keep in ("totals", "statistics", "sticks") and (keep == "totals") == (state["accumulator"] is None)
    _demand(fits, f"it kept {checks.show(keep)}")
    kept: Fields = {"retained": None, "sample_totals": None, "flat_sticks": None}
    if keep == "sticks":
        sticks, found = _flat_sticks(dataset, SAMPLE[keep]), state["sticks"]
        _demand(len(found) == len(sticks.count), f"it has {len(sticks.count)} of {len(found)} samples")
        totals = _stored_totals(dataset, found)
        own = (totals.stick_time, totals.sticks, totals.slips, *numbering.rest(sticks))
        finished = np.asarray(totals.status) == Status.FINISHED
        retained = data.Retained(sticks.only(finished), np.stack(own, axis=1, dtype=np.float64)[finished])
        kept = {"sample_totals": totals, "flat_sticks": sticks, "retained": retained}
    elif keep == "statistics":
        sticks = _flat_sticks(dataset, SAMPLE[keep])
        own = (dataset[name].to_numpy() for name in ("stick_time", "stick_count", "slip_count"))
        kept["retained"] = data.Retained(sticks, np.stack([*own, *numbering.rest(sticks)], axis=1, dtype=np.float64))
    elif "stick_count" in dataset:
        kept["sample_totals"] = _stored_totals(dataset, dataset["stick_count"].to_numpy())
    return {
        "system": _system(state["system"], position),
        **{name: state[name] for name in ("law", "method", "y0", "moments", "accumulator", "design", "copula")},
        "origins": tuple(one._replace(system=_system(one.system, position)) for one in state["origins"]),
        **{field: kind(attributes[name]) for field, (name, kind) in _ATTRIBUTES.items()},
        "numbering": numbering,
        "key_data": None if key_data is None else tuple(int(word) for word in np.asarray(key_data)),
        "status_counts": counts,
        **kept,
        "output_units": dict(state.get("outputs", ())),
        "output_values": {name: dataset[f"output_{name}"].to_numpy() for name, _ in state.get("outputs", ())},
    }


def _system(system: object, position: Coordinate) -> object:
    """`system`, or what stands for it where it is a user's own."""
    return UnknownSystem(system.name, system.text, position) if isinstance(system, Unknown) else system


def _flat_sticks(dataset: "xarray.Dataset", sample: str) -> FlatSticks:
    # A file of a version that had fewer columns is as good as any: the others are not known.
    names = [name for name in (*NUMBERS, "ending") if name not in QUANTITIES or f"stick_{name}" in dataset]
    columns = {name: dataset[f"stick_{name}"].to_numpy() for name in names}
    sticks = FlatSticks.of(dataset["stick_count"].to_numpy(), **columns)
    owner, first = dataset["stick_sample"].to_numpy(), dataset[sample].to_numpy()
    number = int(sticks.count.sum())
    fits = number == len(sticks.start) and np.array_equal(first[sticks.sample], owner)
    _demand(fits, f"it has {len(sticks.start)} of {number} sticks")
    return sticks


def _stored_totals(dataset: "xarray.Dataset", sticks: np.ndarray) -> SampleTotals:
    """The totals of each sample; `sticks`: their numbers."""
    names = ("slip_count", "stick_time", "status", "near_grazing_count")
    return SampleTotals(sticks, *(dataset[name].to_numpy() for name in names))


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
    return FlatSticks.of(np.bincount(number, minlength=samples), start, end, ending.astype(np.int8), **others), unit


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
        return np.asarray(leaf) if differs(leaf) else data.single(np.asarray(leaf)[0])

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
    time = np.bincount(sticks.sample, weights=sticks.duration, minlength=len(count))
    none = np.zeros(len(count), np.int32)
    slips = np.bincount(slips_among(sticks, float(t1)).sample, minlength=len(count))
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


def fields_between(ensemble: EnsembleData, begin: float, end: float) -> Fields:
    """The fields of the `Ensemble` of what happens from `begin` to `end`, s; see `Ensemble.between`."""
    checks.bounded("begin", begin, "s", at_least=0, below=ensemble.t1)
    checks.bounded("end", end, "s", above=begin)
    if end > ensemble.t1:
        raise checks.refused("end", f"be at most t1 = {ensemble.t1:g} s", end)
    sticks, totals = ensemble.require_sticks(), ensemble.totals
    inside = (sticks.end > begin) & (sticks.start < end)
    cut = np.where(sticks.end[inside] > end, np.int8(Ending.HORIZON), sticks.ending[inside])
    count = np.bincount(sticks.sample[inside], minlength=len(sticks.count))
    flat = FlatSticks(count, sticks.numbers[:, inside], cut.astype(sticks.ending.dtype))
    flat = with_columns(flat, start=np.maximum(flat.start - begin, 0), end=np.minimum(flat.end, end) - begin)
    time = np.bincount(flat.sample, weights=flat.duration, minlength=len(count))
    slips = slips_among(flat, end - begin, np.asarray(totals.status) == Status.FINISHED)
    numbers = count.astype(np.int32), np.bincount(slips.sample, minlength=len(count)), time
    results = SampleTotals(*numbers, totals.status, totals.near_grazing_count)
    about = Unknown(f"{begin:g} to {end:g} s of another ensemble")
    kept = {name: getattr(ensemble, name) for name in ("system", "method", "dtype")}
    period = ensemble.system.stick_position.period
    return _summed(results, flat, end - begin, ensemble.numbering, period) | kept | {"law": about, "y0": ()}


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
