"""The progress bar of an ensemble or a film, on terminals and in notebooks."""

import importlib.util
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from .. import _checks

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
        _checks.truth("progress", progress)
        progress = bool(progress)
    notebook = in_notebook()
    if progress is False or (progress is None and not (notebook or sys.stderr.isatty())):
        yield _NO_BAR
        return
    try:
        bar_class = _bar_class(notebook)
    except ImportError:
        if progress is None:
            yield _NO_BAR
            return
        raise ImportError("A progress bar needs tqdm: pip install 'stickslip_jax[study]', or progress=False.") from None
    # In a notebook, what stays is saved with it.
    look = {"leave": False, "delay": _DELAY} if notebook and progress is None else {}
    with bar_class(total=samples, unit=unit, unit_scale=True, **look) as bar:
        yield Progress(bar.update, lambda text: bar.set_postfix_str(text, refresh=False))


def in_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", _nothing)()
    return getattr(shell, "kernel", None) is not None


def _bar_class(notebook: bool) -> Any:
    """A bar of the notebook where it can be shown, else one of text; ``tqdm.auto`` would warn that it cannot."""
    if notebook and importlib.util.find_spec("ipywidgets") is not None:
        from tqdm.notebook import tqdm  # noqa: PLC0415 - an extra, loaded when asked for
    else:
        from tqdm.std import tqdm  # noqa: PLC0415 - an extra, loaded when asked for
    return tqdm


def _nothing(*_: object) -> None:
    pass


_NO_BAR = Progress(_nothing, _nothing)
