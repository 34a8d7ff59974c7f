"""Ensembles read from files and data sets, with all that they had when they were stored."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _checks
from .._dynamics.common.engine import SampleTotals
from .._events.stick_quantities import QUANTITIES
from .._events.sticks import NUMBERS, FlatSticks
from .._extras import require
from .._files import file_for_user
from .._statistics.accumulator import Numbering
from .._statistics.totals import TOTALS
from .._status import Status
from .._systems.system import Coordinate
from .data import Fields, Retained
from .dataset import FLOATS, FORMAT, FORMAT_VERSION, INTEGERS, SAMPLE, STATE, compression
from .encoding import Decoder
from .netcdf import DamagedFileError, as_netcdf, read_netcdf, verified
from .stored_checks import check_fields
from .unknown import Unknown, UnknownSystem

if TYPE_CHECKING:
    import xarray

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
            f"read as such ({_checks.show(str(error))}): it is cut short, damaged, or of another kind."
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
        shown = f"one written by {made_by!r}" if made_by else _checks.show(type(dataset).__name__)
        raise ValueError(
            f"Argument {name} must be what Ensemble.to_xarray, Ensemble.save or stickslip study of this version wrote, "
            f"but {shown} was given, which does not say that it is an ensemble."
        )
    try:
        version = int(attributes["format_version"])
    except (KeyError, TypeError, ValueError):
        version = 0
    if version < FORMAT_VERSION:
        raise ValueError(
            f"Argument {name} must be of format {FORMAT_VERSION}, but it has format {version}, of a version before "
            "0.1.0; simulate it again."
        )
    if version > FORMAT_VERSION:
        raise ValueError(
            f"Argument {name} must be of format {FORMAT_VERSION}, but it has format {version}, written by "
            f"stickslip_jax {attributes.get('stickslip_jax_version')}; install that version or a newer one."
        )
    try:
        fields = _fields(verified(dataset, is_file=is_file))
        check_fields(fields)
        return fields
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, RecursionError, OverflowError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise ValueError(
            f"Argument {name} must be a whole ensemble as it was stored, but this one was changed or damaged "
            f"({_checks.show(reason)}); load the original file."
        ) from None


def _fields(dataset: "xarray.Dataset") -> Fields:
    attributes = dataset.attrs
    decoder = Decoder(dataset[FLOATS].to_numpy(), dataset[INTEGERS].to_numpy())
    state = {name: decoder.decoded(value) for name, value in json.loads(str(dataset[STATE].item())).items()}
    if state["totals"] != TOTALS:
        raise ValueError(f"it sums {state['totals']}")
    position = Coordinate(*state["position"])
    numbering = Numbering.checked(int(attributes["orders"]), bool(attributes["count_initial_rest"]))
    key_data = attributes.get("key_data")
    counts = {one: int(attributes.get(f"samples_{one.name.lower()}", 0)) for one in Status}
    keep = str(attributes["keep"])
    if keep not in ("totals", "statistics", "sticks") or (keep == "totals") != (state["accumulator"] is None):
        raise ValueError(f"it kept {_checks.show(keep)}")
    kept: Fields = {"retained": None, "sample_totals": None, "flat_sticks": None}
    if keep == "sticks":
        kept = _every_stick(dataset, state["sticks"], numbering)
    elif keep == "statistics":
        sticks = _flat_sticks(dataset, SAMPLE[keep])
        own = (dataset[name].to_numpy() for name in ("stick_time", "stick_count", "slip_count"))
        kept["retained"] = Retained(sticks, np.stack([*own, *numbering.rest(sticks)], axis=1, dtype=np.float64))
    elif "stick_count" in dataset:
        kept["sample_totals"] = _totals(dataset, dataset["stick_count"].to_numpy())
    if sum(counts.values()) != int(attributes["samples"]):
        raise ValueError(f"it has {sum(counts.values())} of {attributes['samples']} samples")
    return {
        "system": _system(state["system"], position),
        **{name: state[name] for name in ("law", "method", "y0", "moments", "accumulator", "design", "copula")},
        "origins": tuple(one._replace(system=_system(one.system, position)) for one in state["origins"]),
        "t1": float(attributes["t1"]),
        "numbering": numbering,
        "samples": int(attributes["samples"]),
        "first_sample": int(attributes["first_sample"]),
        "key_data": None if key_data is None else tuple(int(word) for word in np.asarray(key_data)),
        "dtype": str(attributes["dtype"]),
        "status_counts": counts,
        "near_grazing_samples": int(attributes["samples_near_grazing"]),
        **kept,
        "output_units": dict(state.get("outputs", ())),
        "output_values": {name: dataset[f"output_{name}"].to_numpy() for name, _ in state.get("outputs", ())},
        "threads": int(attributes["threads_used"]),
        "compile_seconds": float(attributes["compile_seconds"]),
        "run_seconds": float(attributes["run_seconds"]),
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
    if int(sticks.count.sum()) != len(sticks.start) or not np.array_equal(first[sticks.sample], owner):
        raise ValueError(f"it has {len(sticks.start)} of {int(sticks.count.sum())} sticks")
    return sticks


def _every_stick(dataset: "xarray.Dataset", found: np.ndarray, numbering: Numbering) -> Fields:
    sticks = _flat_sticks(dataset, "sample")
    if len(found) != len(sticks.count):
        raise ValueError(f"it has {len(sticks.count)} of {len(found)} samples")
    totals = _totals(dataset, found)
    finished = np.asarray(totals.status) == Status.FINISHED
    own = np.stack([totals.stick_time, totals.sticks, totals.slips, *numbering.rest(sticks)], axis=1, dtype=np.float64)
    return {"sample_totals": totals, "flat_sticks": sticks, "retained": Retained(sticks.only(finished), own[finished])}


def _totals(dataset: "xarray.Dataset", sticks: np.ndarray) -> SampleTotals:
    """The totals of each sample; `sticks`: their numbers."""
    names = ("slip_count", "stick_time", "status", "near_grazing_count")
    return SampleTotals(sticks, *(dataset[name].to_numpy() for name in names))
