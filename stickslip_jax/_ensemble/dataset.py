"""An ensemble as labelled arrays (``xarray``), with all that makes an ensemble of them again (`stored.py`)."""

import json
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._conventions import flags, labeled_dataset, variable
from .._dynamics.common.engine import SampleTotals
from .._events.sticks import FlatSticks
from .._events.tables import slip_variables, stick_variables
from .._simulation.labeled import method_attributes
from .._statistics.totals import TOTALS
from .._status import Status
from .data import EnsembleData, Retained
from .encoding import Encoder
from .origins import known_inputs
from .slips import flat_slips

if TYPE_CHECKING:
    import xarray

Variables: TypeAlias = dict[str, Any]
"""Variables of a data set by name, as `variable` makes them."""

FORMAT, FORMAT_VERSION = "stickslip_jax ensemble", 2
STATE, FLOATS, INTEGERS = "ensemble_state", "ensemble_state_floats", "ensemble_state_integers"
SAMPLE = {"sticks": "sample", "statistics": "finished_sample"}
"""The dimension of samples by what was kept: with "statistics" only sticks of the first samples that finished are."""


def dataset_of(ensemble: EnsembleData) -> "xarray.Dataset":
    """Sticks (CF contiguous ragged arrays along ``stick``) and totals (along ``sample``), with units and long names.

    Raises:
        ImportError: As `Ensemble.to_xarray`.
    """
    variables: Variables = {}
    if ensemble.flat_sticks is not None and ensemble.sample_totals is not None:
        variables |= _sticks(ensemble, ensemble.flat_sticks, SAMPLE["sticks"])
        variables |= _slips(ensemble) | _totals(ensemble.sample_totals) | _inputs(ensemble)
    elif ensemble.retained is not None:
        variables |= _sticks(ensemble, ensemble.retained.sticks, SAMPLE["statistics"])
        variables |= _retained_totals(ensemble.retained)
    elif ensemble.sample_totals is not None:
        variables |= _counts(ensemble, ensemble.sample_totals) | _totals(ensemble.sample_totals) | _inputs(ensemble)
    variables |= _outputs(ensemble)
    return labeled_dataset({**variables, **_state(ensemble)}, {}, _provenance(ensemble))


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


def _slips(ensemble: EnsembleData) -> Variables:
    slips = flat_slips(ensemble)
    return {
        "slip_sample": variable("slip", ensemble.first_sample + slips.sample, "sample of the slip"),
        **slip_variables(slips.start, slips.end, slips.censored),
    }


def _totals(totals: SampleTotals) -> Variables:
    return {
        "slip_count": variable("sample", totals.slips, "number of slips"),
        "stick_time": variable("sample", totals.stick_time, "total stick time", "s"),
        "near_grazing_count": variable("sample", totals.near_grazing_count, "number of events decided by round-off"),
        "status": variable("sample", totals.status, "whether the sample reached t1", **flags(Status)),
    }


def _counts(ensemble: EnsembleData, totals: SampleTotals) -> Variables:
    """The samples and their numbers of sticks, where the sticks themselves were not kept."""
    sample = ensemble.first_sample + np.arange(ensemble.samples)
    return {
        "sample": variable("sample", sample, "number of the sample"),
        "stick_count": variable("sample", totals.sticks, "number of sticks"),
    }


def _inputs(ensemble: EnsembleData) -> Variables:
    """The numbers that differ from sample to sample."""
    known = known_inputs(ensemble).items()
    return {f"input_{name}": variable("sample", column, name, unit or "1") for name, (column, unit) in known}


def _outputs(ensemble: EnsembleData) -> Variables:
    """The outputs of each sample."""
    if not ensemble.output_values:
        return {}
    sample = ensemble.first_sample + np.arange(ensemble.samples)
    columns = {
        f"output_{name}": variable("sample", column, name, ensemble.output_units.get(name, "1"))
        for name, column in ensemble.output_values.items()
    }
    return {"sample": variable("sample", sample, "number of the sample"), **columns}


def _retained_totals(retained: Retained) -> Variables:
    time, _, slips, *_ = retained.totals.T
    sample = SAMPLE["statistics"]
    return {
        "slip_count": variable(sample, slips.astype(np.int64), "number of slips"),
        "stick_time": variable(sample, time, "total stick time", "s"),
    }


def _state(ensemble: EnsembleData) -> Variables:
    """What else an ensemble is made of: sums of all samples, and numbers of sticks of samples that did not finish."""
    encoder = Encoder()
    state = {
        "system": ensemble.system,
        "law": ensemble.law,
        "method": ensemble.method,
        "y0": ensemble.y0,
        "design": ensemble.design,
        "copula": ensemble.copula,
        "moments": ensemble.moments,
        "accumulator": ensemble.accumulator,
        "sticks": None if ensemble.flat_sticks is None else ensemble.totals.sticks,
        "origins": ensemble.origins,
        "outputs": tuple((name, ensemble.output_units.get(name, "1")) for name in ensemble.output_values),
        "position": tuple(ensemble.system.stick_position),
        "totals": TOTALS,
    }
    texts = {name: encoder.encoded(value) for name, value in state.items()}
    about = "for stickslip_jax.load: sums of all samples"
    return {
        STATE: variable((), json.dumps(texts), f"{about}, as JSON"),
        FLOATS: variable("state_float", encoder.floats, f"{about}, long arrays of the JSON"),
        INTEGERS: variable("state_integer", encoder.integers, f"{about}, long arrays of the JSON"),
    }


def _provenance(ensemble: EnsembleData) -> dict[str, object]:
    """Attributes that say what was simulated, how, and how it ended. Numbers are in SI units."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    encoder = Encoder()
    attributes: dict[str, object] = {
        "source": f"stickslip_jax {__version__}",
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "stickslip_jax_version": __version__,
        "keep": ensemble.keep,
        "system": _readable(encoder, ensemble.system),
        "law": _readable(encoder, ensemble.law),
        "y0": _readable(encoder, list(ensemble.y0)),
        "t1": float(ensemble.t1),
        "samples": ensemble.samples,
        "first_sample": ensemble.first_sample,
        "orders": ensemble.numbering.orders,
        "count_initial_rest": int(ensemble.numbering.count_initial_rest),
        "dtype": ensemble.dtype,
        "samples_finished": ensemble.finished,
        "samples_near_grazing": ensemble.near_grazing_samples,
        "compile_seconds": ensemble.compile_seconds,
        "run_seconds": ensemble.run_seconds,
        "threads_used": ensemble.threads,
        **method_attributes(ensemble.method),
    }
    for status in Status:
        if status is not Status.FINISHED:
            attributes[f"samples_{status.name.lower()}"] = ensemble.status_counts[status]
    if ensemble.key_data is not None:
        attributes["key_data"] = np.array(ensemble.key_data, np.uint32)
    return attributes


def _readable(encoder: Encoder, value: object) -> str:
    """An object as JSON that tells its class and numbers; long arrays are only described."""
    parts = [encoder.encoded(part) for part in value] if type(value) is list else encoder.encoded(value)
    return json.dumps(parts)
