"""Ctrl-C during a sweep: the first one stops it after the batches under way, the second one at once."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Stopping:
    """Whether the sweep is to stop. `requested`: after the batches under way."""

    def __init__(self) -> None:
        self.requested = False

    def request(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: the first time ask to stop, the second time raise KeyboardInterrupt."""
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        # In one write: a second Ctrl-C comes between the parts that print would write.
        sys.stderr.write(
            "\nStopping after the batches under way; what is done is kept. Press Ctrl-C again to stop at once.\n"
        )


@contextmanager
def stoppable() -> Iterator[Stopping]:
    """Handles SIGINT while the block runs, where signals can be handled: in the main thread, unless it is ignored."""
    stopping = Stopping()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before in (signal.SIG_IGN, None):
        yield stopping
        return
    signal.signal(signal.SIGINT, stopping.request)
    try:
        yield stopping
    finally:
        signal.signal(signal.SIGINT, before)
