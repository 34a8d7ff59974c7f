"""The extras of the package: what needs one that is not installed says so in one sentence; labelled arrays; progress
bars.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from . import checks

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


# The progress bar of an ensemble or a film, on terminals and in notebooks.


_DELAY = 1.0  # s: what takes less shows no bar unless one is asked for


class Progress(NamedTuple):
    """Functions that update the progress bar, if one is shown.

    `advance`: to call with the number of newly finished samples. `note`: with a text to show beside the bar.
    """

    advance: Callable[[int], object]
    note: Callable[[str], object]


@contextmanager
def progress_bar(progress: bool | None, samples: int, unit: str = "sample") -> Iterator[Progress]:
    """Shows a progress bar while the block runs.

    Args:
        progress: True shows one, False none; None shows one on a terminal and, while it runs for more than a second, in
            a notebook.
        samples: Their number.
        unit: What they are.

    Raises:
        ValueError: For another `progress`.
        ImportError: For True without the extra ``study``.
    """
    if progress is not None:
        checks.truth("progress", progress)
        progress = bool(progress)
    notebook = in_notebook()
    if progress is False or (progress is None and not (notebook or sys.stderr.isatty())):
        yield NO_BAR
        return
    try:
        # A bar of the notebook where it can be shown, else one of text; ``tqdm.auto`` would warn that it cannot.
        if notebook and find_spec("ipywidgets") is not None:
            from tqdm.notebook import tqdm  # noqa: PLC0415 - an extra, loaded when asked for
        else:
            from tqdm.std import tqdm  # noqa: PLC0415 - an extra, loaded when asked for
    except ImportError:
        if progress is None:
            yield NO_BAR
            return
        raise ImportError("A progress bar needs tqdm: pip install 'stickslip_jax[study]', or progress=False.") from None
    # In a notebook, what stays is saved with it.
    look = {"leave": False, "delay": _DELAY} if notebook and progress is None else {}
    with tqdm(total=samples, unit=unit, unit_scale=True, **look) as bar:
        yield Progress(bar.update, lambda text: bar.set_postfix_str(text, refresh=False))


def in_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", _nothing)()
    return getattr(shell, "kernel", None) is not None


def _nothing(*_: object) -> None:
    pass


NO_BAR = Progress(_nothing, _nothing)
