"""What has been read of a sweep while a run works on it, kept for a second reading."""

import weakref
from tempfile import SpooledTemporaryFile, gettempdir
from typing import NamedTuple

from .errors import SweepError
from .store import Batch

_IN_MEMORY = 2**26  # bytes; what is more goes to a temporary file


class _Part(NamedTuple):
    batch: Batch
    at: int
    size: int


class Spool:
    """Batches of points as they were when they were read first."""

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, self._file.close)
        self._parts: dict[int, list[_Part]] = {}

    def keep(self, point: int, batches: list[tuple[Batch, bytes]]) -> None:
        """Keep what was read of a point. Raises SweepError where there is no room for it."""
        parts = []
        try:
            at = self._file.seek(0, 2)
            for batch, data in batches:
                parts.append(_Part(batch, at, self._file.write(data)))
                at += len(data)
        except OSError as error:
            raise SweepError(
                f"{gettempdir()} cannot be written ({error.strerror}), where a look at a large sweep keeps what it has "
                "read; make room there, or name another folder in the environment variable TMPDIR."
            ) from error
        self._parts[point] = parts

    def kept(self, point: int) -> list[tuple[Batch, bytes]] | None:
        """What was read of a point; None if nothing was."""
        if point not in self._parts:
            return None
        found = []
        for batch, at, size in self._parts[point]:
            self._file.seek(at)
            found.append((batch, self._file.read(size)))
        return found
