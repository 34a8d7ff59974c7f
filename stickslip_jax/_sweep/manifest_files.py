"""The two files of a folder that hold its manifest, and which of them is right where they differ."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from .._files import NotAFileError, read_regular
from .errors import OtherProgramError, SweepError, UnreadableError
from .manifest import FORMAT, body_of, fingerprint
from .sealing import MARK

MANIFEST, COPY = "manifest.json", "manifest-copy.json"


def mark_of(body: dict[str, Any]) -> bytes:
    """The mark with which the batches of a sweep begin."""
    return fingerprint(body)[:MARK].encode()


def has_manifest(folder: Path) -> bool:
    """Whether there is a manifest, or a copy of one."""
    return any((folder / name).exists() for name in (MANIFEST, COPY))


def body_in(folder: Path, marks: Callable[[], Iterable[bytes]], *, to_write: bool = False) -> dict[str, Any]:
    """The manifest of a folder, or its copy where that is damaged.

    `marks`: gives those of the batches that are there. `to_write`: whether both files are about to be replaced. Raises
    SweepError if there is none, where the two are of two sweeps, and for a foreign file that would be replaced.
    """
    found: dict[str, dict[str, Any]] = {}
    said = ""
    for name in (MANIFEST, COPY):
        path = folder / name
        try:
            found[name] = body_of(read_regular(path).decode())
        except (FileNotFoundError, NotADirectoryError):
            continue
        except SweepError as error:
            raise SweepError(f"{folder} cannot be read: {error}") from None
        except (UnreadableError, UnicodeDecodeError) as error:
            said = said or f"{path} is damaged ({error})"
        except NotAFileError as error:
            raise SweepError(f"{path} cannot be read ({error.strerror}); move it elsewhere, and try again.") from None
        except OSError as error:
            raise SweepError(f"{path} cannot be read ({error.strerror}); make it readable.") from None
    if not found and said:
        raise SweepError(f"{said}, and there is no whole copy of it; run the sweep into another folder.")
    if not found:
        raise SweepError(
            f"{folder} holds no sweep ({FORMAT}); name the folder that Sweep.run or stickslip sweep wrote."
        )
    if len({mark_of(body) for body in found.values()}) > 1:
        raise SweepError(_told_apart(folder, found, set(marks())))
    if to_write:
        _check_no_other_program(folder)
    return found.get(MANIFEST) or found[COPY]


def _told_apart(folder: Path, found: dict[str, dict[str, Any]], marks: set[bytes]) -> str:
    """The sentence about a manifest and a copy that are of two sweeps."""
    right = [name for name, body in found.items() if mark_of(body) in marks]
    if len(right) != 1:
        return (
            f"{folder / MANIFEST} and {COPY} beside it are of two sweeps; move the one elsewhere that is not of this "
            "sweep, and try again."
        )
    (wrong,) = found.keys() - right
    return (
        f"{folder / wrong} is of another sweep than {right[0]} and the batches beside it; move {wrong} elsewhere, and "
        "try again."
    )


def _check_no_other_program(folder: Path) -> None:
    """Raises SweepError if one of the two files, which a run writes anew, is of another program."""
    for name in (MANIFEST, COPY):
        try:
            body_of(read_regular(folder / name).decode())
        except OtherProgramError:
            raise SweepError(
                f"{folder / name} is a file of another program beside the sweep's own; move it elsewhere, and try "
                "again."
            ) from None
        except (OSError, ValueError):  # missing or damaged: to be written anew
            continue
