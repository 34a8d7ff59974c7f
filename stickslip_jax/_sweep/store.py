"""The folder of a study: its manifest, the pieces that are done, the data set, and a log."""

import contextlib
import os
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from .errors import StudyError
from .files import cannot_write, is_locked, locked, remove_unfinished, write_whole
from .manifest import FORMAT, UnreadableError, body_of, differences, fingerprint, manifest_text, with_piece
from .plan import Plan, Task

MANIFEST, COPY, PIECES, DATA, LOG, LOCK = (
    "manifest.json",
    "manifest-copy.json",
    "pieces",
    "study.nc",
    "log.txt",
    ".lock",
)


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
    values of the parameters only, so that a point keeps its pieces when others come.
    """

    def __init__(self, folder: Path, body: dict[str, Any], *, writable: bool = False):
        self.folder, self.writable = folder, writable
        self.body = body
        self.mark = fingerprint(body)[:16].encode()

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
        found: dict[str, list[Piece]] = defaultdict(list)
        with contextlib.suppress(FileNotFoundError):
            for entry in os.scandir(self.folder / PIECES):
                name, _, kind = entry.name.partition(".")
                parts = name.split("-", 3)
                if kind in ("zip", "json") and len(parts) >= 3:
                    piece = Piece(Path(entry.path), int(parts[1]), int(parts[2]), "".join(parts[3:]))
                    found[parts[0]].append(piece)
        return {identity: _without_overlap(pieces) for identity, pieces in found.items()}

    def read(self, piece: Piece) -> bytes:
        """The bytes of a piece. Raises StudyError for one of another study."""
        data = piece.path.read_bytes()
        if not data.startswith(self.mark):
            raise StudyError(f"{piece.path} is a piece of another study; remove it, and run again.")
        return data[len(self.mark) :]

    def path_of(self, identity: str, task: Task, plan: Plan) -> Path:
        """The file of the result of a task."""
        name = f"{identity}-{task.first}-{task.end}"
        if task.derivative is None:
            return self.folder / PIECES / f"{name}.zip"
        return self.folder / PIECES / f"{name}-{derivative_name(plan, task.derivative)}.json"

    def write(self, path: Path, data: bytes) -> None:
        """Write the bytes of a piece. Raises StudyError if that fails."""
        try:
            write_whole(path, self.mark + data)
        except OSError as error:
            raise cannot_write(self.folder, error) from error

    def log(self, text: str) -> None:
        """Add a line to the log, with the time."""
        with contextlib.suppress(OSError), (self.folder / LOG).open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")


def derivative_name(plan: Plan, number: int) -> str:
    """A name for files."""
    statistic, wrt = plan.derivatives[number]
    return f"d_{statistic}_by_{'_'.join(wrt)}".replace("/", "_")


@contextlib.contextmanager
def opened(folder: Path, plan: Plan) -> Iterator[tuple[Store, Plan]]:
    """The store for `plan` in `folder`, held for writing, and the plan cut into pieces as the store is.

    A folder without a study must be empty or missing. A manifest that differs in what decides the numbers is refused;
    what may differ replaces it. Raises StudyError otherwise.
    """
    _make(folder)
    with locked(folder / LOCK, f"{folder} is in use by another run; wait for it to end, or choose another folder."):
        remove_unfinished(folder)
        remove_unfinished(folder / PIECES)
        if (folder / MANIFEST).exists() or (folder / COPY).exists():
            there = _body_in(folder)
            plan = with_piece(plan, there)
            text = manifest_text(plan)
            here = body_of(text)
            found = differences(there, here)
            if found:
                raise StudyError(
                    f"{folder} holds a study with other numbers ({'; '.join(found[:5])}); choose another folder, or "
                    "change the study back."
                )
            if there["asked"]["samples"] > plan.samples:
                raise StudyError(
                    f"{folder} holds {there['asked']['samples']} samples of each point; ask for at least as many, or "
                    "choose another folder."
                )
        else:
            text = manifest_text(plan)
            here = body_of(text)
        store = Store(folder, here, writable=True)
        try:
            (folder / PIECES).mkdir(exist_ok=True)
            for name in (MANIFEST, COPY):
                write_whole(folder / name, text.encode())
        except OSError as error:
            raise cannot_write(folder, error) from error
        yield store, plan


def _make(folder: Path) -> None:
    """Make the folder. Raises StudyError for one that holds something else, or cannot be made."""
    ours = {MANIFEST, COPY, PIECES, DATA, LOG, LOCK}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(entry.name for entry in os.scandir(folder) if entry.name not in ours)
    except FileExistsError:
        raise StudyError(f"{folder} cannot hold a study, because it is a file; choose another folder.") from None
    except NotADirectoryError:
        raise StudyError(f"{folder} cannot hold a study, because it lies below a file; choose another.") from None
    except OSError as error:
        raise cannot_write(folder, error) from error
    has_study = (folder / MANIFEST).exists() or (folder / COPY).exists()
    if not has_study and [name for name in others if not name.endswith(".unfinished")]:
        raise StudyError(
            f"{folder} is not empty and holds no study (it has {others[0]}); choose an empty or a new folder."
        )


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
            raise StudyError(f"{folder / name} cannot be read ({error.strerror}).") from None
    if said:
        raise StudyError(f"{said}, and so is its copy; run the study into another folder.")
    raise StudyError(f"{folder} holds no study ({FORMAT}); name the folder that Study.run or stickslip sweep wrote.")


def _without_overlap(pieces: list[Piece]) -> list[Piece]:
    """Pieces of samples in order, of which none has samples of another, the longest first; then the others."""
    chosen, at = [], 0
    for piece in sorted((one for one in pieces if not one.derivative), key=lambda one: (one.first, -one.end)):
        if piece.first >= at:
            chosen.append(piece)
            at = piece.end
    return chosen + [one for one in pieces if one.derivative]
