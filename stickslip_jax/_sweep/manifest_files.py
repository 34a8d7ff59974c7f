"""The two files of a folder that hold its manifest, and which of them is right where they differ."""

from collections.abc import Callable, Iterable
from pathlib import Path

from .._files import NotAFileError, read_regular
from .errors import OtherProgramError, SweepError, UnreadableError
from .header import ID_LENGTH
from .manifest import FORMAT, Manifest, body_of, fingerprint

MANIFEST, COPY = "manifest.json", "manifest-copy.json"


def sweep_id_of(body: Manifest) -> bytes:
    """The identity of a sweep, with which the files of its batches begin."""
    return fingerprint(body)[:ID_LENGTH].encode()


def has_manifest(folder: Path) -> bool:
    """Whether there is a manifest, or a copy of one."""
    return any((folder / name).exists() for name in (MANIFEST, COPY))


def body_in(folder: Path, ids_of_batches: Callable[[], Iterable[bytes]], *, to_write: bool = False) -> Manifest:
    """The manifest of a folder, or its copy where that is damaged.

    Args:
        folder: That of the sweep.
        ids_of_batches: Gives the identities with which the batches begin that are there.
        to_write: Whether both files are about to be replaced.

    Raises:
        SweepError: If there is no manifest, where the two are of two sweeps, and for a file of another program that
            would be replaced.
    """
    found: dict[str, Manifest] = {}
    damage, foreign = "", None
    for name in (MANIFEST, COPY):
        path = folder / name
        try:
            found[name] = body_of(read_regular(path).decode())
        except (FileNotFoundError, NotADirectoryError):
            continue
        except SweepError as error:
            raise SweepError(f"{folder} cannot be read: {error}") from None
        except (UnreadableError, UnicodeDecodeError) as error:
            damage = damage or f"{path} is damaged ({error})"
            foreign = path if isinstance(error, OtherProgramError) else foreign
        except NotAFileError as error:
            raise SweepError(f"{path} cannot be read ({error.strerror}); move it elsewhere, and try again.") from None
        except OSError as error:
            raise SweepError(f"{path} cannot be read ({error.strerror}); make it readable.") from None
    if not found and damage:
        raise SweepError(f"{damage}, and there is no whole copy of it; run the sweep into another folder.")
    if not found:
        raise SweepError(
            f"{folder} holds no sweep ({FORMAT}); name the folder that Sweep.run or stickslip sweep wrote."
        )
    if len({sweep_id_of(body) for body in found.values()}) > 1:
        raise SweepError(_two_sweeps(folder, found, set(ids_of_batches())))
    if to_write and foreign is not None:
        raise SweepError(
            f"{foreign} is a file of another program beside the sweep's own; move it elsewhere, and try again."
        )
    return found.get(MANIFEST) or found[COPY]


def _two_sweeps(folder: Path, found: dict[str, Manifest], ids: set[bytes]) -> str:
    """The sentence about a manifest and a copy that are of two sweeps; `ids`: those of the batches."""
    right = [name for name, body in found.items() if sweep_id_of(body) in ids]
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
