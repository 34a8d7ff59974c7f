"""Computations beside the page: always of the latest wish, older ones are left out."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, cast

from bokeh.document import Document, without_document_lock

Task = Callable[[], Any]
Then = Callable[[Any], None]
_FAILURES = (ValueError, OSError, RuntimeError, ImportError)


class Worker:
    """One computation at a time, of the latest wish. Without a `document` (a notebook) it is done at once.

    While it runs the page stays alive, and numbers that move meanwhile replace the wish.
    """

    def __init__(self, document: Document | None, threads: ThreadPoolExecutor):
        self._document, self._threads = document, threads
        self._wish: tuple[Task, Then, Then] | None = None
        self._runs = False

    def do(self, task: Task, then: Then, failed: Then) -> None:
        """Run `task`, then call `then` with what it returns, or `failed` with its exception."""
        self._wish = task, then, failed
        if self._document is None:
            _finish(*_outcome(task), then, failed)
            self._wish = None
        elif not self._runs:
            self._runs = True
            self._document.add_next_tick_callback(cast(Any, without_document_lock(self._run)))

    async def _run(self) -> None:
        assert self._document is not None
        try:
            while self._wish is not None:
                (task, then, failed), self._wish = self._wish, None
                outcome = await asyncio.get_running_loop().run_in_executor(self._threads, _outcome, task)
                self._document.add_next_tick_callback(partial(_finish, *outcome, then, failed))
        finally:
            self._runs = False


def _outcome(task: Task) -> tuple[Any, BaseException | None]:
    try:
        return task(), None
    except _FAILURES as error:
        return None, error


def _finish(found: Any, error: BaseException | None, then: Then, failed: Then) -> None:
    if error is None:
        then(found)
    else:
        failed(error)
