"""One trajectory as a table of its sticks and as labelled arrays."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np

from .._conventions import Entries, labeled_dataset
from .._dynamics.common.method import Exact, Regularized
from .._events.sticks import NUMBERS, FlatSticks, Slips, Sticks, of_contact
from .._events.tables import Columns, slip_variables, stick_columns, stick_variables
from .._systems.system import Coordinate

if TYPE_CHECKING:
    import xarray


def columns_of(sticks: Sticks, position: Coordinate) -> Columns:
    """The columns of the table of the sticks of one trajectory. `position`: what the position of a stick is.

    Of several contacts, those of one after those of another, with the number of the contact.
    """
    if sticks.contact is None:
        return stick_columns(*_in_order(sticks), position)
    last = int(np.max(np.asarray(sticks.contact), initial=-1))
    parts = [columns_of(of_contact(sticks, number), position) for number in range(last + 1)]
    numbers = np.repeat(np.arange(last + 1), [len(part["order"]) for part in parts])
    empty = columns_of(of_contact(sticks, -2), position)
    columns = {name: np.concatenate([empty[name], *(part[name] for part in parts)]) for name in empty}
    return {"contact": numbers} | columns


def dataset_of(
    sticks: Sticks, slips: Slips, position: Coordinate, totals: Entries, attributes: Mapping[str, object]
) -> "xarray.Dataset":
    """The sticks and slips of one trajectory with units and long names, with `totals`; see `Simulation.to_xarray`."""
    mask = np.asarray(slips.mask)
    columns = (np.asarray(column)[mask] for column in (slips.start, slips.end, slips.censored))
    variables = {**stick_variables(*_in_order(sticks), position), **slip_variables(*columns), **totals}
    return labeled_dataset(variables, {}, {**source(), **attributes})


def source() -> dict[str, object]:
    """Attributes that say which program made a data set."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    return {"source": f"stickslip_jax {__version__}", "stickslip_jax_version": __version__}


def provenance(system: object, base: object, method: object, t1: float | None = None) -> dict[str, object]:
    """Attributes that say what was simulated and how, and for how long. Numbers are in SI units."""
    horizon = {} if t1 is None else {"t1": t1}
    return {"system": _brief(system), "base": _brief(base), **horizon, **method_attributes(method)}


def method_attributes(method: object) -> dict[str, object]:
    """Attributes that state the method and its criterion of a stick, in SI units: numbers, or arrays (contacts,)."""
    if isinstance(method, Exact):
        return {"method": "exact"} if method.step is None else {"method": "exact", "time_step": float(method.step)}
    if not isinstance(method, Regularized):
        return {"method": "none" if method is None else str(method)}
    numbers = {
        "width": method.width,
        "stick_threshold": method.threshold,
        "stick_minimum_duration": method.minimum_duration,
        "time_step": method.step,
    }
    known = {name: np.asarray(number, float) for name, number in numbers.items() if number is not None}
    known = {name: number if number.ndim else float(number) for name, number in known.items()}
    return {"method": "regularised", "shape": method.shape, **known}


def _in_order(sticks: Sticks) -> tuple[FlatSticks, np.ndarray]:
    """The sticks without empty slots, and the number of each from 1; 0 for one that begins at t = 0.

    So ensembles count by default.
    """
    mask = np.asarray(sticks.mask)
    columns = {name: np.asarray(getattr(sticks, name))[mask] for name in (*NUMBERS, "ending")}
    flat = FlatSticks.of(np.array([mask.sum()]), **columns)
    return flat, np.arange(len(flat.start)) + (0 if flat.begins_at_zero[0] else 1)


def _brief(module: object) -> str:
    return " ".join(eqx.tree_pformat(module, short_arrays=True).split())
