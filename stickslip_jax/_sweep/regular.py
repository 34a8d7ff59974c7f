"""Only regular files are read and written: a named pipe that lies where a file should be would wait for ever."""

import errno
import os
import stat
from pathlib import Path

_AT_ONCE = getattr(os, "O_NONBLOCK", 0)  # opening a pipe does not wait for its other end
_BINARY = getattr(os, "O_BINARY", 0)  # on Windows


class NotAFileError(OSError):
    """Something else than a regular file; ``strerror`` says what."""


def read_regular(path: Path, most: int = -1) -> bytes:
    """The bytes of a file, or the first `most`. Raises OSError for one that is not there, and NotAFileError."""
    handle = os.open(path, os.O_RDONLY | _AT_ONCE | _BINARY)
    try:
        _check(handle, path)
        with open(handle, "rb", closefd=False) as file:
            return file.read(most)
    finally:
        os.close(handle)


def append_regular(path: Path, text: str) -> None:
    """Add text to a file, which is made if it is not there. Raises OSError as `read_regular`."""
    handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | _AT_ONCE, 0o666)
    try:
        _check(handle, path)
        os.write(handle, text.encode())
    finally:
        os.close(handle)


def _check(handle: int, path: Path) -> None:
    mode = os.fstat(handle).st_mode
    if not stat.S_ISREG(mode):
        kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a named pipe"), (stat.S_ISCHR, "a device"))
        kind = next((name for test, name in kinds if test(mode)), "something else")
        raise NotAFileError(errno.EINVAL, f"it is {kind}, not a file", str(path))
