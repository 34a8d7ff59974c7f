"""The folder of a result: no file is overwritten without --force, and no result is left incomplete."""

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ._errors import StudyError

DATA = "study.nc"
CONFIG = "study.toml"
SUMMARY = "summary.txt"
TIME_HISTORY = "time_history.png"
PHASE_PORTRAIT = "phase_portrait.png"
STICK_DURATIONS = "stick_durations.png"
DURATION_AND_POSITION = "duration_and_position.png"
RESULT_FILES = (CONFIG, SUMMARY, TIME_HISTORY, PHASE_PORTRAIT, STICK_DURATIONS, DURATION_AND_POSITION, DATA)
"""The files of a result, in the order in which they are put in place; the data come last and mark it complete."""


@contextmanager
def result_folder(directory: Path, *, force: bool = False) -> Iterator[Path]:
    """A temporary folder to write `RESULT_FILES` into, which become the result in `directory` if the block succeeds.

    The files are moved to `directory` together at the end. With `force` they replace an older result, at the end and
    not before. Other files in `directory` stay. If the block fails or is interrupted, everything is as it was before.

    Raises StudyError, before the block runs, if `directory` holds a result and `force` is False, or cannot be written.
    """
    _refuse_to_overwrite(directory, force)
    made: list[Path] = []
    try:
        staging = _staging_in(directory, made)
        try:
            yield staging
            with _uninterrupted():
                _refuse_to_overwrite(directory, force)  # another run may have finished meanwhile
                _publish(staging, directory)
        finally:
            with _uninterrupted():
                shutil.rmtree(staging, ignore_errors=True)
    except BaseException:
        for folder in reversed(made):
            with suppress(OSError):  # others may have put something there
                folder.rmdir()
        raise


def _refuse_to_overwrite(directory: Path, force: bool) -> None:
    found = [name for name in RESULT_FILES if os.path.lexists(directory / name)]
    if found and not force:
        raise StudyError(
            f"{directory} holds a result already ({found[-1]}); choose another folder with --out, or replace it with "
            "--force."
        )


def _staging_in(directory: Path, made: list[Path]) -> Path:
    """Make `directory` and a temporary folder in it, which is returned; append to `made` what did not exist before."""
    try:
        for folder in reversed([directory, *directory.parents]):
            if not folder.exists():
                folder.mkdir()
                made.append(folder)
        return Path(tempfile.mkdtemp(prefix=".unfinished-", dir=directory))
    except NotADirectoryError:
        raise StudyError(f"{directory} cannot hold a result, because it is, or lies below, a file.") from None
    except (OSError, ValueError) as error:  # ValueError: not even a path, because it holds a null character
        reason = getattr(error, "strerror", None) or error
        raise StudyError(f"{directory} cannot be written ({reason}); choose another folder.") from None


def _publish(staging: Path, directory: Path) -> None:
    """Move the old files aside and the new ones into place; if that fails, move all of them back."""
    aside = staging / "replaced"
    aside.mkdir()
    old = [(directory / name, aside / name) for name in reversed(RESULT_FILES)]
    new = [(staging / name, directory / name) for name in RESULT_FILES]
    moved: list[tuple[Path, Path]] = []
    try:
        for source, target in (*old, *new):
            if os.path.lexists(source):
                source.replace(target)
                moved.append((source, target))
    except BaseException:
        for source, target in reversed(moved):
            target.replace(source)
        raise


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C for the few milliseconds that moving or removing files takes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if usual is None else usual)
