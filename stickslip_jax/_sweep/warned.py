"""Warnings of tasks that run in several threads, collected task by task.

``warnings.catch_warnings`` is of the whole process: in threads, one task would catch the warnings of another.
"""

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_local = threading.local()


@contextmanager
def collected() -> Iterator[list[str]]:
    """The texts of the warnings of this thread while the block runs, where `collecting` is in force."""
    said: list[str] = []
    _local.said = said
    try:
        yield said
    finally:
        _local.said = None


@contextmanager
def collecting() -> Iterator[None]:
    """Gives the RuntimeWarnings of threads that are in `collected` to these, and shows all others, in this process."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # the study says so once
        show = warnings.showwarning

        def collect(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            said = getattr(_local, "said", None)
            if said is None:
                show(message, category, *where, **more)
            else:
                said.append(str(message))

        warnings.showwarning = collect
        yield
