"""An ensemble as labelled arrays (``xarray``), in NetCDF files, and read from them with all that it had."""

import hashlib
import json
import sys
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._dynamics.common.lanes import SampleTotals
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.simulation import method_attributes
from .._dynamics.stick_tables import slip_variables, stick_variables
from .._dynamics.sticks import NUMBERS, QUANTITIES, FlatSticks
from .._foundation import checks
from .._foundation.extras import flags, labeled_dataset, require, variable
from .._foundation.files import file_for_user
from .._foundation.processes import require_memory
from .._foundation.types import Ending, Status
from .._numerics.sums import Moments
from .._statistics.quantities import Numbering, StickAccumulator
from .._statistics.totals import TOTALS
from .._systems.system import Coordinate, System
from .._uncertainty.families import RandomNumber
from .data import EnsembleData, Fields, Retained, Unknown, UnknownSystem
from .encoding import DamagedFileError, Decoder, Encoder
from .setup import MOST_SAMPLES

if TYPE_CHECKING:
    import xarray


# Data sets in NetCDF 4 files that show whether they are as they were written.
#
# A SHA-256 sum over all names, numbers and attributes is an attribute itself. HDF5 keeps check sums of the arrays
# besides, for other programs.


SUM = "content_sha256"
"""The attribute that holds the sum."""


def as_netcdf(
    dataset: "xarray.Dataset",
    packing: Mapping[Any, Mapping[str, object]],
    groups: "Mapping[str, xarray.Dataset] | None" = None,
) -> memoryview:
    """The bytes of a NetCDF 4 file of a data set, and of others in groups.

    They are made in memory: HDF5 ends the process where a disk is full. `packing`: how to compress variables.
    """
    buffer = BytesIO()
    with _without_cluster():
        for group, part in {None: dataset, **(groups or {})}.items():
            arrays = {name: one for name, one in part.variables.items() if one.ndim and one.size}
            options = {name: {"fletcher32": True} for name, one in arrays.items() if one.dtype.kind in "biuf"}
            if group is None:
                options = {name: {**options.get(name, {}), **packing.get(name, {})} for name in {*options, *packing}}
            part.assign_attrs({SUM: sum_of(part)}).to_netcdf(
                buffer, mode="w" if group is None else "a", group=group, engine="h5netcdf", encoding=options
            )
    return buffer.getbuffer()


def read_netcdf(path: Path) -> "xarray.Dataset":
    """The data set in a file, not `verified`.

    Raises:
        DamagedFileError: For what cannot be read.
        ValueError: For what is larger than the memory.
        ImportError: Without the extra.
    """
    import h5py  # noqa: PLC0415 - an extra, loaded when asked for
    import xarray as xr  # noqa: PLC0415

    if not path.is_file():
        raise DamagedFileError("it is no ordinary file")
    size = 0.0

    def look(_: str, part: Any) -> None:
        nonlocal size
        dict(part.attrs)
        size += float(getattr(part, "nbytes", 0))  # of an array

    try:
        with h5py.File(path) as file:  # all names and attributes: where h5netcdf fails, it prints a traceback besides
            dict(file.attrs)
            file.visititems(look)
    except Exception as error:  # of h5py, h5netcdf and xarray, which raise any kind for a damaged file
        raise _damaged(error) from error
    require_memory("path", size, f"what {str(path)!r} holds")  # packed, or never written: the file may be small
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except ImportError:
        raise
    except Exception as error:
        raise _damaged(error) from error


def _damaged(error: Exception) -> DamagedFileError:
    return DamagedFileError(" ".join(str(error).split()) or type(error).__name__)


def verified(dataset: "xarray.Dataset", *, is_file: bool = True) -> "xarray.Dataset":
    """The data set without its sum. Raises DamagedFileError where the content has another, or none in a file."""
    stated = dataset.attrs.get(SUM)
    if stated is None:
        if is_file:
            raise DamagedFileError("it lacks its check sum")
        return dataset
    rest = dataset.copy(deep=False)
    del rest.attrs[SUM]
    if sum_of(rest) != stated:
        raise DamagedFileError("its content is not what was written: the check sum is another")
    return rest


def sum_of(dataset: "xarray.Dataset") -> str:
    """The SHA-256 sum of the content of a data set, the same before it is written and after it is read."""
    found = hashlib.sha256(_text(dataset.attrs))
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        values = np.asarray(variable.values)
        numbers = values.dtype.kind in "biufc"
        about = [name, list(map(str, variable.dims)), list(values.shape), values.dtype.str if numbers else "text"]
        found.update(_text(variable.attrs) + json.dumps(about).encode())
        found.update(values.tobytes() if numbers else json.dumps(values.astype(str).tolist()).encode())
    return found.hexdigest()


def _text(attributes: Mapping[Hashable, Any]) -> bytes:
    """Attributes as text, lists of one number as the number, which they become in a file."""
    plain = {str(name): np.atleast_1d(np.asarray(value)).tolist() for name, value in attributes.items()}
    return json.dumps(plain, sort_keys=True).encode()


@contextmanager
def _without_cluster() -> Iterator[None]:
    """Where this process has a client of dask, xarray would ask the cluster for a lock to write memory (and fail)."""
    if "dask.base" not in sys.modules:
        yield
        return
    with sys.modules["dask"].config.set(scheduler="synchronous"):
        yield


# An ensemble as labelled arrays (``xarray``), with all that makes an ensemble of them again (see below).


Variables: TypeAlias = dict[str, Any]
"""Variables of a data set by name, as `variable` makes them."""

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
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    variables: Variables = {}
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
        "source": f"stickslip_jax {__version__}",
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "stickslip_jax_version": __version__,
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


def _sticks(ensemble: EnsembleData, sticks: FlatSticks, sample: str) -> Variables:
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
    _check_sums(fields)
    _check_samples(fields)


def _check_sums(fields: Mapping[str, Any]) -> None:
    """The sums over all samples."""
    samples, counts, near = fields["samples"], fields["status_counts"], fields["near_grazing_samples"]
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


def _check_samples(fields: Mapping[str, Any]) -> None:
    """What is held of each sample."""
    samples, counts = fields["samples"], fields["status_counts"]
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


def write_dataset(dataset: "xarray.Dataset", path: Path) -> Path:
    """Write the data set of an ensemble to `path`, from `file_to_write`; see `Ensemble.save`."""
    require("Files of ensembles need", "study", "xarray", "h5netcdf")
    data = as_netcdf(dataset, compression(dataset))
    with file_for_user(path) as file:
        file.write(data)
    return path


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
        retained = Retained(sticks.only(finished), np.stack(own, axis=1, dtype=np.float64)[finished])
        kept = {"sample_totals": totals, "flat_sticks": sticks, "retained": retained}
    elif keep == "statistics":
        sticks = _flat_sticks(dataset, SAMPLE[keep])
        own = (dataset[name].to_numpy() for name in ("stick_time", "stick_count", "slip_count"))
        kept["retained"] = Retained(sticks, np.stack([*own, *numbering.rest(sticks)], axis=1, dtype=np.float64))
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
