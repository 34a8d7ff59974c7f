"""The folder of a study: its manifest, the pieces that are done, the data set, and a log."""

import contextlib
import hashlib
import os
import re
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from .errors import DamagedPieceError, StudyError
from .files import cannot_write, finished_name, is_locked, locked, remove_unfinished, sync_folder, write_whole
from .manifest import FORMAT, UnreadableError, body_of, differences, extended, fingerprint, manifest_text, with_piece
from .plan import Plan, Task

MANIFEST, COPY, PIECES, DATA, LOG, LOCK = (
    "manifest.json",
    "manifest-copy.json",
    "pieces",
    "study.nc",
    "log.txt",
    ".lock",
)
_MARK, _SUM = 16, 32  # bytes with which a piece begins: of its study, and of its check sum
_LONGEST_NAME = 100  # of a derivative in the name of a file


_NAME = re.compile(r"(?P<point>[0-9a-f]{16})-(?P<first>\d+)-(?P<end>\d+)(\.zip|-(?P<name>.+)\.json)")


class Piece(NamedTuple):
    """A file of samples ``first .. end - 1`` of a point, or of the derivatives with this name from samples
    ``0 .. end - 1``.
    """

    path: Path
    first: int
    end: int
    derivative: str = ""


class Store:
    """The folder of a study, opened for reading; `opened` is for writing.

    A piece is a file ``POINT-FIRST-END.zip`` (derivatives: ``POINT-FIRST-END-NAME.json``), where POINT depends on the
    values of the parameters only, so that a point keeps its pieces when others come. It begins with a mark of its study
    and a check sum. `held`: whether this program holds the lock, and may change the folder.
    """

    def __init__(self, folder: Path, body: dict[str, Any], *, held: bool = False):
        self.folder, self.body, self.held = folder, body, held
        self.mark = fingerprint(body)[:_MARK].encode()

    @classmethod
    def reading(cls, folder: Path) -> "Store":
        """The store in a folder. Raises StudyError if there is none, or none that this version can read."""
        return cls(folder, _body_in(folder))

    @property
    def is_in_use(self) -> bool:
        """Whether a run holds the folder now."""
        return is_locked(self.folder / LOCK)

    # --- pieces

    def pieces(self) -> dict[str, list[Piece]]:
        """All pieces by the identity of their point: those of samples in order, none with samples of another."""
        return {identity: _without_overlap(pieces) for identity, pieces in self._all().items()}

    def _all(self) -> dict[str, list[Piece]]:
        found: dict[str, list[Piece]] = defaultdict(list)
        with contextlib.suppress(FileNotFoundError):
            for entry in os.scandir(self.folder / PIECES):
                parts = _NAME.fullmatch(entry.name)
                if parts is not None:
                    identity, first, end, name = parts.group("point", "first", "end", "name")
                    found[identity].append(Piece(Path(entry.path), int(first), int(end), name or ""))
        return found

    def read(self, piece: Piece) -> bytes:
        """The bytes of a piece.

        Raises DamagedPieceError unless they are as they were written, FileNotFoundError for a piece that is gone, and
        StudyError for one of another study and one that cannot be read.
        """
        try:
            whole = piece.path.read_bytes()
        except FileNotFoundError:
            raise
        except OSError as error:
            raise StudyError(
                f"{piece.path} cannot be read ({error.strerror}); make it readable, or remove it, and run again."
            ) from error
        mark, stated, data = whole[:_MARK], whole[_MARK : _MARK + _SUM], whole[_MARK + _SUM :]
        if stated != hashlib.sha256(mark + data).digest():
            raise DamagedPieceError("its check sum is wrong")
        if mark != self.mark:
            raise StudyError(f"{piece.path} is a piece of another study; move it elsewhere, and run again.")
        return data

    def check_marks(self) -> None:
        """Raises StudyError for a whole piece of another study, which nobody may write over."""
        for pieces in self._all().values():
            for piece in pieces:
                with contextlib.suppress(OSError, DamagedPieceError):
                    with piece.path.open("rb") as file:
                        mark = file.read(_MARK)
                    if mark != self.mark:
                        self.read(piece)

    def remove_leftovers(self, identities: Iterable[str]) -> None:
        """Remove pieces of these points whose samples are in a longer one too: what an interrupted join leaves."""
        there = self._all()
        for identity in identities:
            for piece in set(there[identity]).difference(_without_overlap(there[identity])):
                with contextlib.suppress(OSError):  # they do no harm
                    piece.path.unlink()

    def path_of(self, identity: str, task: Task, plan: Plan) -> Path:
        """The file of the result of a task."""
        name = f"{identity}-{task.first}-{task.end}"
        if task.derivative is None:
            return self.folder / PIECES / f"{name}.zip"
        return self.folder / PIECES / f"{name}-{derivative_name(plan, task.derivative)}.json"

    def write(self, path: Path, data: bytes) -> None:
        """Write the bytes of a piece. Raises StudyError if that fails."""
        try:
            write_whole(path, sealed(self.mark, data))
        except OSError as error:
            raise cannot_write(self.folder, error) from error

    def log(self, text: str) -> None:
        """Add a line to the log, with the time."""
        with contextlib.suppress(OSError), (self.folder / LOG).open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")


def sealed(mark: bytes, data: bytes) -> bytes:
    """The bytes of a piece as they stand in its file: after the mark of the study and a check sum."""
    return mark + hashlib.sha256(mark + data).digest() + data


def derivative_name(plan: Plan, number: int) -> str:
    """A name for files."""
    statistic, wrt = plan.derivatives[number]
    name = f"d_{statistic}_by_{'_'.join(wrt)}".replace("/", "_")
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[:_LONGEST_NAME]}_{hashlib.sha256(name.encode()).hexdigest()[:16]}"


@contextlib.contextmanager
def opened(folder: Path, plan: Plan) -> Iterator[tuple[Store, Plan]]:
    """The store for `plan` in `folder`, held for writing, and the plan cut into pieces as the store is.

    A folder without a study must be empty or missing. A manifest that differs in what decides the numbers is refused;
    what may differ replaces it. Raises StudyError otherwise.
    """
    _make(folder)
    with locked(folder / LOCK, f"{folder} is in use by another run; wait for it to end, or choose another folder."):
        text = manifest_text(plan)
        if (folder / MANIFEST).exists() or (folder / COPY).exists():
            there = _body_in(folder)
            plan = with_piece(plan, there)
            here = body_of(manifest_text(plan))
            _check_extends(folder, there, here)
            text = extended(there, here)
        store = Store(folder, body_of(text), held=True)
        store.check_marks()
        try:
            remove_unfinished(folder)
            remove_unfinished(folder / PIECES)
            (folder / PIECES).mkdir(exist_ok=True)
            for name in (MANIFEST, COPY):
                if not _holds(folder / name, text):
                    write_whole(folder / name, text.encode())
            sync_folder(folder.parent)
        except OSError as error:
            raise cannot_write(folder, error) from error
        yield store, plan


def _check_extends(folder: Path, there: dict[str, Any], here: dict[str, Any]) -> None:
    """Raises StudyError unless the study of the manifest `here` adds to that `there`, which the folder holds."""
    found = differences(there, here)
    if found:
        raise StudyError(
            f"{folder} holds a study with other numbers ({'; '.join(found[:5])}); choose another folder, or "
            "change the study back."
        )
    if there["asked"]["samples"] > here["asked"]["samples"]:
        raise StudyError(
            f"{folder} holds {there['asked']['samples']} samples of each point; ask for at least as many, or "
            "choose another folder."
        )


def _holds(path: Path, text: str) -> bool:
    with contextlib.suppress(FileNotFoundError):
        return path.read_bytes() == text.encode()
    return False


def _make(folder: Path) -> None:
    """Make the folder. Raises StudyError for one that holds something else, or cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(entry.name for entry in os.scandir(folder) if not _is_begun(Path(entry.path)))
        has_study = (folder / MANIFEST).exists() or (folder / COPY).exists()
    except FileExistsError:
        raise StudyError(f"{folder} cannot hold a study, because it is a file; choose another folder.") from None
    except NotADirectoryError:
        raise StudyError(f"{folder} cannot hold a study, because it lies below a file; choose another.") from None
    except OSError as error:
        raise cannot_write(folder, error) from error
    if others and not has_study:
        raise StudyError(
            f"{folder} is not empty and holds no study (it has {others[0]}); choose an empty or a new folder."
        )


def _is_begun(path: Path) -> bool:
    """Whether a file is what `opened` makes before the manifest is whole."""
    if path.name == PIECES:
        return path.is_dir() and not os.listdir(path)
    return path.name == LOCK or finished_name(path.name) in (MANIFEST, COPY)


def _body_in(folder: Path) -> dict[str, Any]:
    """The manifest of a folder, or its copy where that is damaged. Raises StudyError if there is none."""
    said = ""
    for name in (MANIFEST, COPY):
        try:
            return body_of((folder / name).read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            continue
        except (UnreadableError, UnicodeDecodeError) as error:
            said = f"{folder / name} is damaged ({error})"
        except StudyError as error:
            raise StudyError(f"{folder} cannot be read: {error}") from None
        except OSError as error:
            raise StudyError(f"{folder / name} cannot be read ({error.strerror}); make it readable.") from None
    if said:
        raise StudyError(f"{said}, and there is no whole copy of it; run the study into another folder.")
    raise StudyError(f"{folder} holds no study ({FORMAT}); name the folder that Study.run or stickslip sweep wrote.")


def _without_overlap(pieces: list[Piece]) -> list[Piece]:
    """Pieces of samples in order, of which none has samples of another, the longest first; then the others."""
    chosen, at = [], 0
    for piece in sorted((one for one in pieces if not one.derivative), key=lambda one: (one.first, -one.end)):
        if piece.first >= at:
            chosen.append(piece)
            at = piece.end
    return chosen + [one for one in pieces if one.derivative]
