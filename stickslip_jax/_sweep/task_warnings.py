"""Warnings of tasks that run in several threads, collected task by task.

``warnings.catch_warnings`` is of the whole process: in threads, one task would catch the warnings of another.
"""

import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TextIO

_local = threading.local()
_lock, _filters = threading.Lock(), ExitStack()
_users: list[None] = []
"""An entry for each `warnings_by_thread` that is in force."""


@contextmanager
def warnings_of_task() -> Iterator[list[str]]:
    """The texts of the RuntimeWarnings of this thread while the block runs, inside of `warnings_by_thread`."""
    _local.texts = texts = []
    try:
        yield texts
    finally:
        _local.texts = None


@contextmanager
def warnings_by_thread() -> Iterator[None]:
    """Gives the RuntimeWarnings of a thread to its `warnings_of_task`, and shows those of other threads.

    Several threads may use it at once: the filters of warnings, which all threads share, come back when the last one
    leaves.
    """
    with _lock:
        if not _users:
            _filters.enter_context(_shown_by_thread())
        _users.append(None)
    try:
        yield
    finally:
        with _lock:
            _users.pop()
            if not _users:
                _filters.close()


@contextmanager
def _shown_by_thread() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # the sweep says so once
        show = warnings.showwarning

        def show_or_collect(
            message: Warning | str, category: type[Warning], filename: str, lineno: int,
            file: TextIO | None = None, line: str | None = None,
        ) -> None:  # fmt: skip
            texts = getattr(_local, "texts", None)
            if texts is None:
                show(message, category, filename, lineno, file, line)
            else:
                texts.append(str(message))

        warnings.showwarning = show_or_collect
        yield
