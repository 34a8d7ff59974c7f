"""Files that are either whole or not there, whenever the program or the machine stops."""

import contextlib
import os
import re
import uuid
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from .errors import StudyError

_UNFINISHED = ".unfinished"


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name, make sure that it is on the disk, and give it its name.

    The name is new or replaces an older file at once. Raises OSError if that fails, with nothing left behind.
    """
    # Of its own for each writer: on another machine one may have the same process number.
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex[:12]}{_UNFINISHED}")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make sure that the names in a folder are on the disk, where the system can do that."""
    with contextlib.suppress(OSError):  # Windows cannot open folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def remove_unfinished(folder: Path) -> None:
    """Remove what killed programs left of files that they were writing. Only for who holds the lock of the folder."""
    for path in folder.glob(f"*{_UNFINISHED}"):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def locked(path: Path, said: str) -> Iterator[None]:
    """Hold the lock `path`, which the system takes back when this program ends, however it ends.

    Raises StudyError with `said` if another program holds it.
    """
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise StudyError(said) from None
    except OSError as error:
        raise cannot_write(path.parent, error) from error
    try:
        yield
    finally:
        lock.release()


def cannot_write(folder: Path, error: OSError) -> StudyError:
    """The error about a folder that cannot be written."""
    reason = re.sub(r"\A\[Errno \d+\] ", "", str(error.strerror or error))
    return StudyError(f"{folder} cannot be written ({reason}); choose another folder, or make it writable.")
