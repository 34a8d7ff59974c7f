"""Files that are either whole or not there, whenever the program or the machine stops."""

import contextlib
import errno
import os
import re
import uuid
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from .errors import StudyError

_UNFINISHED = ".unfinished"
_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
_LOCK_SECONDS = 0.3  # to wait for a lock: `is_locked` holds it for a moment


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


def finished_name(name: str) -> str | None:
    """The name that a file would have got, if a program was stopped while it wrote it; None for other files."""
    found = re.fullmatch(rf"(.+)\.[0-9a-f]+{re.escape(_UNFINISHED)}", name)
    return found and found[1]


def remove_unfinished(folder: Path) -> None:
    """Remove what killed programs left of files that they were writing. Only for who holds the lock of the folder."""
    for path in folder.glob(f"*{_UNFINISHED}"):
        if finished_name(path.name):
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def locked(path: Path, said: str) -> Iterator[None]:
    """Hold the lock `path`, which the system takes back when this program ends, however it ends.

    Raises StudyError with `said` if another program holds it.
    """
    lock = FileLock(path, timeout=_LOCK_SECONDS)
    try:
        lock.acquire()
    except Timeout:
        raise StudyError(said) from None
    except OSError as error:
        raise cannot_write(path.parent, error) from error
    except NotImplementedError:  # two runs could not notice each other
        raise StudyError(f"{path.parent} is on a disk whose files cannot be locked; choose another folder.") from None
    try:
        yield
    finally:
        lock.release()


def is_locked(path: Path) -> bool:
    """Whether a program holds the lock `path`; False where that cannot be found out."""
    if not path.exists():
        return False
    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False


def cannot_write(folder: Path, error: OSError) -> StudyError:
    """The error about a folder that cannot be written."""
    todo = "choose another folder, or make it writable"
    if error.errno in _FULL:
        todo = "make room, and run again: what is done is kept"
    return StudyError(f"{folder} cannot be written ({error.strerror or error}); {todo}.")
