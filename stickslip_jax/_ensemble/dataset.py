"""The sticks of an ensemble as labelled arrays (``xarray``)."""

from typing import TYPE_CHECKING, Any

from .._dynamics.method import Exact, Regularized
from .._events.sticks import FURTHER
from .._status import Ending, Status

if TYPE_CHECKING:
    import xarray


def dataset_of(ensemble: Any) -> "xarray.Dataset":
    """Sticks (CF contiguous ragged arrays along ``stick``) and totals (along ``sample``), with units and long names.

    Raises the errors of `Ensemble.to_xarray`.
    """
    try:
        import xarray as xr  # noqa: PLC0415 - an extra, loaded when asked for
    except ImportError:
        raise ImportError("Labelled results need xarray: pip install 'stickslip_jax[study]'.") from None
    sticks, totals = ensemble.require_sticks(), ensemble.totals
    assert totals is not None
    position = ensemble.system.stick_position

    def along(dimension, values, long_name, unit="1", **attributes):
        return (dimension, values, {"long_name": long_name, "units": unit, **attributes})

    further = {
        f"stick_{name}": along("stick", getattr(sticks, name), one.label, one.unit or position.unit)
        for name, one in FURTHER.items()
    }
    return xr.Dataset(
        {
            "sample": along("sample", range(len(sticks.count)), "number of the sample"),
            "stick_start": along("stick", sticks.start, "time at which the stick starts", "s"),
            "stick_end": along("stick", sticks.end, "time at which the stick ends", "s"),
            "stick_position": along("stick", sticks.position, position.name, position.unit),
            **further,
            "stick_ending": along("stick", sticks.ending, "why the stick ended", **_flags(Ending)),
            "stick_count": along("sample", sticks.count, "number of sticks", sample_dimension="stick"),
            "slip_count": along("sample", totals.slips, "number of slips"),
            "stick_time": along("sample", totals.stick_time, "total stick time", "s"),
            "near_grazing_count": along("sample", totals.near_grazing_count, "number of events decided by round-off"),
            "status": along("sample", totals.status, "whether the sample reached t1", **_flags(Status)),
        },
        attrs={"Conventions": "CF-1.11", **_method(ensemble.method)},
    )


def _method(method: Exact | Regularized) -> dict[str, Any]:
    """Attributes that state the method and its criterion of a stick, in SI units."""
    if not isinstance(method, Regularized):
        return {"method": "exact"}
    numbers = {
        "width": method.width,
        "stick_threshold": method.threshold,
        "stick_minimum_duration": method.minimum_duration,
        "time_step": method.step,
    }
    known = {name: float(number) for name, number in numbers.items() if number is not None}
    return {"method": "regularised", "shape": method.shape, **known}


def _flags(codes) -> dict[str, Any]:
    return {"flag_values": [int(code) for code in codes], "flag_meanings": " ".join(code.name for code in codes)}
