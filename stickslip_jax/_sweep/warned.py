"""Warnings of tasks that run in several threads, collected task by task.

``warnings.catch_warnings`` is of the whole process: in threads, one task would catch the warnings of another.
"""

import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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
    """Gives the RuntimeWarnings of threads that are in `collected` to these, and shows all others, in this process.

    Several threads may be in it: the filters of warnings, which all share, come back when the last leaves.
    """
    _collecting.enter()
    try:
        yield
    finally:
        _collecting.leave()


class _Collecting:
    def __init__(self) -> None:
        self._lock, self._inside, self._stack = threading.Lock(), 0, ExitStack()

    def enter(self) -> None:
        with self._lock:
            if not self._inside:
                self._stack.enter_context(_shown_by_thread())
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._stack.close()


_collecting = _Collecting()


@contextmanager
def _shown_by_thread() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # the sweep says so once
        show = warnings.showwarning

        def collect(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            said = getattr(_local, "said", None)
            if said is None:
                show(message, category, *where, **more)
            else:
                said.append(str(message))

        warnings.showwarning = collect
        yield
