"""The extras of the package: what needs one that is not installed says so in one sentence; labelled arrays."""

import sys
from collections.abc import Mapping
from enum import IntEnum
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import xarray


# The extras of the package: what needs one that is not installed says so in one sentence, before it does any work.


def require(needing: str, extra: str, *packages: str) -> None:
    """Raises ImportError where one of the `packages`, which the `extra` brings, is not installed.

    `needing`: who needs them, with the verb: "Sweeps need".
    """
    # A module that is loaded, or is None because it must not be, has no need to be found.
    loaded = {name: sys.modules[name] if name in sys.modules else find_spec(name) for name in packages}
    missing = [name for name, found in loaded.items() if found is None]
    if missing:
        raise ImportError(f"{needing} {', '.join(missing)}: pip install 'stickslip_jax[{extra}]'.")


def require_explorer() -> None:
    """Raises ImportError where what the explorer needs is not installed."""
    require("The explorer needs", "explore", "panel", "bokeh", "pydantic", "xarray")


# Labelled arrays of xarray with the attributes of the CF conventions.


Entries: TypeAlias = dict[str, Any]
"""Variables or coordinates by name, as xarray takes them."""
Dataset: TypeAlias = "xarray.Dataset"
"""For annotations, without xarray."""


def variable(
    dimensions: str | tuple[str, ...], values: object, long_name: str, unit: str = "1", **attributes: object
) -> tuple[str | tuple[str, ...], object, dict[str, object]]:
    """A variable as xarray takes it, with its name in words and its unit."""
    return dimensions, values, {"long_name": long_name, "units": unit, **attributes}


def require_labels() -> None:
    """Raises ImportError without the extra ``study``: for who computes long before the results are labelled."""
    require("Labelled results need", "study", "xarray")


def labeled_dataset(variables: Entries, coordinates: Entries, attributes: Mapping[str, object]) -> "xarray.Dataset":
    """The data set of these variables.

    Raises:
        ImportError: Without the extra ``study``.
    """
    require_labels()
    import xarray as xr  # noqa: PLC0415 - an extra, loaded when asked for

    return xr.Dataset(variables, coordinates, {"Conventions": "CF-1.11", **attributes})


def flags(codes: type[IntEnum]) -> dict[str, Any]:
    """The attributes of a variable that holds these codes."""
    return {"flag_values": [int(code) for code in codes], "flag_meanings": " ".join(code.name for code in codes)}
