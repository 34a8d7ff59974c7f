"""Locks that let one program at a time write to the folder of a sweep."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from .._files import FULL
from .errors import SweepError

_LOCK_SECONDS = 0.3  # to wait for a lock: `is_locked` holds it for a moment


@contextlib.contextmanager
def locked(path: Path, said: str) -> Iterator[None]:
    """Hold the lock `path`, which the system takes back when this program ends, however it ends.

    Raises SweepError with `said` if another program holds it.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415 - an extra: `require_packages`

    lock = FileLock(path, timeout=_LOCK_SECONDS)
    try:
        lock.acquire()
    except Timeout:
        raise SweepError(said) from None
    except OSError as error:
        raise cannot_write(path.parent, error) from error
    except NotImplementedError:  # two runs could not notice each other
        raise SweepError(f"{path.parent} is on a disk whose files cannot be locked; choose another folder.") from None
    try:
        yield
    finally:
        lock.release()


def is_locked(path: Path) -> bool:
    """Whether a program holds the lock `path`; False where that cannot be found out."""
    if not path.exists():
        return False
    from filelock import FileLock, Timeout  # noqa: PLC0415

    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False


def cannot_write(folder: Path, error: OSError) -> SweepError:
    """The error about a folder that cannot be written."""
    todo = "choose another folder, or make it writable"
    if error.errno in FULL:
        todo = "make room, and run again: what is done is kept"
    return SweepError(f"{folder} cannot be written ({error.strerror or error}); {todo}.")
