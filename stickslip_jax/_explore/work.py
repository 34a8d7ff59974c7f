"""Computations beside the page: always of the latest wish, older ones are left out."""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, cast

import panel as pn
from bokeh.document import Document, without_document_lock

Task = Callable[[], Any]
Then = Callable[[Any], None]
Step = tuple[Task, Then]
_FAILURES = (ValueError, OSError, RuntimeError, ImportError)


class Worker:
    """One computation at a time, of the latest wish. Without a `document` (a notebook) it is done at once.

    While it runs the page stays alive, and numbers that move meanwhile replace the wish.
    """

    def __init__(self, document: Document | None, threads: ThreadPoolExecutor):
        self._document, self._threads = document, threads
        self._wish: tuple[Sequence[Step], Then] | None = None
        self._runs = False

    def do(self, steps: Sequence[Step], failed: Then) -> None:
        """Run the task of each step and call its `Then` with what it returned; end at an exception, with `failed`."""
        self._wish = steps, failed
        if self._document is None:
            for task, then in steps:
                if not _finish(*_outcome(task), then, failed):
                    break
            self._wish = None
        elif not self._runs:
            self._runs = True
            self._document.add_next_tick_callback(cast(Any, without_document_lock(self._run)))

    async def _run(self) -> None:
        assert self._document is not None
        try:
            while self._wish is not None:
                (steps, failed), self._wish = self._wish, None
                for task, then in steps:
                    found, error = await asyncio.get_running_loop().run_in_executor(self._threads, _outcome, task)
                    self._document.add_next_tick_callback(cast(Any, partial(_finish, found, error, then, failed)))
                    if error is not None:
                        break
        finally:
            self._runs = False


def _outcome(task: Task) -> tuple[Any, BaseException | None]:
    try:
        return task(), None
    except _FAILURES as error:
        return None, error


def _finish(found: Any, error: BaseException | None, then: Then, failed: Then) -> bool:
    """Show what was found, and whether there was no error. All that changes goes to the page in one message."""
    with pn.io.hold():
        if error is None:
            then(found)
        else:
            failed(error)
    return error is None
