"""Files: written as a whole or not at all, and read only where they are regular files."""

import contextlib
import errno
import io
import os
import re
import stat
import uuid
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from . import checks
from .extras import require
from .processes import available_memory

if TYPE_CHECKING:
    import pandas

_UNFINISHED = ".unfinished"
_NO_WAIT = getattr(os, "O_NONBLOCK", 0)  # opening a named pipe does not wait for its other end
_BINARY = getattr(os, "O_BINARY", 0)  # on Windows
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
"""Numbers of errors that mean that there is no room."""
_SIGNATURES = {b"\x89HDF\r\n\x1a\n": "a NetCDF or HDF5 file", b"PAR1": "a parquet table", b"\x89PNG": "a figure"}


def file_to_write(path: object, endings: tuple[str, ...] = (), *, overwrite: bool = False) -> Path:
    """`path` as the name of a file that can be written now.

    - `endings`: what the name may end in, in lower case; any if empty. `overwrite`: whether it may replace a file.

    Raises ValueError for what is no file name or ends otherwise, FileNotFoundError for a folder that does not exist,
    and FileExistsError for a file that may not be replaced.
    """
    path = checks.path("path", path, "a file name")
    checks.truth("overwrite", overwrite)
    shown = repr(str(path))
    if endings and path.suffix.lower() not in endings:
        raise ValueError(
            f"Argument path must be a file name that ends in {' or '.join(endings)}, but {shown} was given."
        )
    try:
        found = path.stat().st_mode
    except FileNotFoundError:
        found = None
    except OSError as error:
        reason = error.strerror or error
        raise ValueError(
            f"Argument path must be a file name, but {checks.show(path.name)} cannot be one ({reason})."
        ) from None
    if found is None and not path.parent.is_dir():
        raise FileNotFoundError(
            f"Argument path must lie in a folder that exists, but there is no folder {str(path.parent)!r}; make it "
            f"first (the working folder is {str(Path.cwd())!r})."
        )
    if found is not None and not stat.S_ISREG(found):
        kind = _kind_of_mode(found)
        raise ValueError(f"Argument path must be a file name, but {shown} is {kind}; choose another name.")
    if found is not None and not overwrite:
        raise FileExistsError(
            f"Argument path must be a new file, but {shown} is there already ({_kind_of(path)}); choose another name, "
            "or replace it with overwrite=True."
        )
    return path


def _kind_of(path: Path) -> str:
    """What a file is, in a few words."""
    try:
        with path.open("rb") as file:
            start = file.read(8)
        size = path.stat().st_size
    except OSError as error:
        return f"it cannot be read: {error.strerror}"
    found = next((kind for signature, kind in _SIGNATURES.items() if start.startswith(signature)), "a file")
    return f"{found} of {size:,} bytes{_program_of(path) if 'HDF5' in found else ''}"


def _program_of(path: Path) -> str:
    """By which program a NetCDF file says that it was written."""
    with contextlib.suppress(Exception):  # an extra that may be missing, and whatever it raises for a damaged file
        import h5py  # noqa: PLC0415

        with h5py.File(path) as file:
            return f", written by {file.attrs['source']}"
    return ", which does not say by which program it was written"


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A file to write into, under a temporary name; at the end it is put on the disk and gets its name.

    The name is new or replaces an older file at once. If that or the block fails, nothing is left behind and an older
    file is as it was. Raises OSError that says so.
    """
    path = path.resolve() if path.is_symlink() else path  # what a link points to is replaced, not the link
    # Of its own for each writer: on another machine one may have the same process number.
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex[:12]}{_UNFINISHED}")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        with contextlib.suppress(OSError):
            temporary.chmod(stat.S_IMODE(path.stat().st_mode))
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_whole(path: Path, data: bytes | memoryview) -> None:
    """Write the bytes of a file by `whole_file`."""
    with whole_file(path) as file:
        file.write(data)


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Make an OSError of the block a sentence about the file or folder that is written."""
    try:
        yield
    except OSError as error:
        todo = "make room" if error.errno in FULL else "choose another folder, or make it writable"
        reason = os.strerror(error.errno) if error.errno else error  # libraries write their own sentences around it
        said = OSError(f"{str(path)!r} cannot be written ({reason}); {todo}: nothing was changed.")
        said.errno = error.errno
        raise said from error


@contextlib.contextmanager
def file_for_user(path: Path) -> Iterator[IO[bytes]]:
    """`whole_file`, whose OSError is a sentence."""
    with writing(path), whole_file(path) as file:
        yield file


class NotAFileError(OSError):
    """Something else than a regular file; ``strerror`` says what."""


def read_regular(path: Path, most: int = -1) -> bytes:
    """The bytes of a file, or the first `most`. Only regular files are read: a named pipe would wait for ever.

    Raises OSError for a file that is not there, and NotAFileError, also for one that is larger than the memory.
    """
    with _opened_regular(path, os.O_RDONLY | _BINARY) as handle, open(handle, "rb", closefd=False) as file:
        size = os.fstat(handle).st_size
        if most < 0 and size > available_memory():
            raise NotAFileError(errno.EFBIG, f"it is larger than the memory: {size / 1e9:.3g} GB", str(path))
        return file.read(most)


def unpacked_arrays(data: bytes, most: int) -> dict[str, np.ndarray]:
    """The arrays of an archive of ``.npy`` files, by name. Raises ValueError where they take more than `most` bytes."""
    found = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        check_size(archive, most)
        for entry in archive.namelist():
            name, ending = entry.rsplit(".", 1)
            if ending != "npy":
                continue
            with archive.open(entry) as file:  # its sum is checked at the end
                if np.lib.format.read_magic(file) != (1, 0):
                    raise ValueError(f"{entry} is of another format")
                shape, by_columns, dtype = np.lib.format.read_array_header_1_0(file)
                # Not more than is there, whatever the header says.
                values = np.frombuffer(bytearray(file.read()), dtype)
            found[name] = values.reshape(shape, order="F" if by_columns else "C")
    return found


def check_size(archive: zipfile.ZipFile, most: int) -> None:
    """Raises ValueError for an archive whose entries take more than `most` bytes; none gives more than it says."""
    size = sum(entry.file_size for entry in archive.infolist())
    if size > most:
        raise ValueError(f"it would unpack to {size / 1e9:.3g} GB")


def append_regular(path: Path, text: str) -> None:
    """Add text to a file, which is made if it is not there. Raises OSError as `read_regular`."""
    with _opened_regular(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT) as handle:
        os.write(handle, text.encode())


@contextlib.contextmanager
def _opened_regular(path: Path, flags: int) -> Iterator[int]:
    handle = os.open(path, flags | _NO_WAIT, 0o666)
    try:
        mode = os.fstat(handle).st_mode
        if not stat.S_ISREG(mode):
            raise NotAFileError(errno.EINVAL, f"it is {_kind_of_mode(mode)}, not a file", str(path))
        yield handle
    finally:
        os.close(handle)


def _kind_of_mode(mode: int) -> str:
    """What something is that is no regular file."""
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a named pipe"), (stat.S_ISCHR, "a device"))
    return next((name for test, name in kinds if test(mode)), "no ordinary file")


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


# Tables of pandas, and in files.


Columns = dict[str, np.ndarray]
"""Columns of a table by name; the names include the units."""


def table_of(columns: Columns) -> "pandas.DataFrame":
    """The columns as a table of pandas. Raises ImportError without the extra ``tables``."""
    require("Tables need", "tables", "pandas")
    import pandas as pd  # noqa: PLC0415 - an extra, loaded when asked for

    return pd.DataFrame(columns)


def write_table(columns: Columns, path: str | os.PathLike[str], overwrite: bool) -> Path:
    """Write the columns to `path`, in the format of its ending. Raises the errors of `Ensemble.write_sticks`."""
    path = file_to_write(path, (".csv", ".parquet"), overwrite=overwrite)
    is_csv = path.suffix.lower() == ".csv"
    if not is_csv:
        require("Parquet files need", "tables", "pandas", "pyarrow")
    table = table_of(columns)
    with file_for_user(path) as file:
        if is_csv:
            table.to_csv(file, index=False, mode="wb")
        else:
            table.to_parquet(file, engine="pyarrow", index=False, write_page_checksum=True)
    return path
