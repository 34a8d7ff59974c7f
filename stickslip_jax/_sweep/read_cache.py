"""Batches that have been read while a run works on their sweep, kept so that a second reading gives the same."""

import pickle
import weakref
from tempfile import SpooledTemporaryFile, gettempdir

from .errors import SweepError
from .store import Batch

_IN_MEMORY = 2**26  # bytes; what is more goes to a temporary file


class ReadCache:
    """The batches of points, with their bytes, as they were when they were read first."""

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, self._file.close)
        self._starts: dict[int, int] = {}

    def put(self, point: int, batches: list[tuple[Batch, bytes]]) -> None:
        """Keep what was read of a point. Raises SweepError where there is no room for it."""
        try:
            start = self._file.seek(0, 2)
            pickle.dump(batches, self._file)
        except OSError as error:
            raise SweepError(
                f"{gettempdir()} cannot be written ({error.strerror}), where the batches of a large sweep are kept "
                "while it is read; make room there, or name another folder in the environment variable TMPDIR."
            ) from error
        self._starts[point] = start

    def get(self, point: int) -> list[tuple[Batch, bytes]] | None:
        """What was read of a point; None if nothing was."""
        if point not in self._starts:
            return None
        self._file.seek(self._starts[point])
        return pickle.load(self._file)
