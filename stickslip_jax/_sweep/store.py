"""The folder of a sweep: its manifest, the batches that are done, the data set, a log, and a lock."""

import contextlib
import dataclasses
import hashlib
import itertools
import os
import re
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from .._foundation.files import (
    FULL,
    NotAFileError,
    append_regular,
    finished_name,
    read_regular,
    remove_unfinished,
    sync_folder,
    write_whole,
)
from .manifest import (
    COPY,
    ID_LENGTH,
    LONGEST_HEADER,
    MANIFEST,
    ForeignBatchError,
    Manifest,
    body_in,
    body_of,
    differences,
    extended,
    has_manifest,
    id_and_name,
    manifest_text,
    plan_in,
    sweep_id_of,
    with_header,
    without_header,
)
from .plan import DamagedBatchError, Plan, SweepError, Task

# Locks that let one program at a time write to the folder of a sweep.


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


# The folder of a sweep: its manifest, the batches that are done, the data set, and a log.


BATCHES, DATA, LOG, LOCK = "batches", "sweep.nc", "log.txt", ".lock"
_LONGEST_NAME = 100  # of a derivative in the name of a file
_NAME = re.compile(r"(?P<point>[0-9a-f]{16})-(?P<first>\d+)-(?P<end>\d+)(\.zip|-(?P<name>.+)\.json)")


class Batch(NamedTuple):
    """A file of samples ``first .. end - 1`` of a point, or of the derivatives with this name from samples
    ``0 .. end - 1``.
    """

    path: Path
    first: int
    end: int
    derivative: str = ""


class Store:
    """The folder of a sweep, opened for reading; `opened` is for writing.

    A batch is a file ``POINT-FIRST-END.zip`` (derivatives: ``POINT-FIRST-END-NAME.json``), where POINT depends on the
    values of the parameters only, so that a point keeps its batches when others come. Its header has the identity of
    the sweep and this name. `can_write`: whether this program holds the lock, and may change the folder.
    """

    def __init__(self, folder: Path, body: Manifest, *, can_write: bool = False):
        self.folder, self.body, self.can_write = folder, body, can_write
        self.sweep_id = sweep_id_of(body)
        self._lock = _file_number(folder / LOCK) if can_write else None

    @classmethod
    def reading(cls, folder: Path) -> "Store":
        """The store in a folder. Raises SweepError if there is none, or none that this version can read."""
        return cls(folder, body_in(folder, lambda: _ids_in(folder)))

    def plan(self, *, to_run: bool = True, every_point: bool = False) -> Plan:
        """The sweep that is stored; see `plan_in`. Raises SweepError with the name of the folder."""
        try:
            return plan_in(self.body, to_run=to_run, every_point=every_point)
        except SweepError as error:
            raise SweepError(f"{self.folder}: {error}") from error.__cause__

    @property
    def dtype(self) -> str:
        """The precision of the sweep, "float64" or "float32"."""
        return self.body["deciding"]["dtype"]

    @property
    def is_in_use(self) -> bool:
        """Whether a run holds the folder now."""
        return is_locked(self.folder / LOCK)

    def check_kept(self) -> None:
        """Raises SweepError if the folder was removed or replaced while this program holds its lock."""
        if not any(_file_number(self.folder / name) for name in (MANIFEST, COPY)):
            raise self._taken_away(MANIFEST)
        if _file_number(self.folder / LOCK) != self._lock:
            raise self._taken_away(LOCK)
        if not (self.folder / BATCHES).is_dir():
            raise self._taken_away(BATCHES)

    def _taken_away(self, name: str) -> SweepError:
        return SweepError(
            f"{self.folder} was removed, or changed, while the sweep ran in it ({name} is gone); run it again, in a "
            "folder that is left alone until it ends."
        )

    # --- batches

    def batches(self) -> dict[str, list[Batch]]:
        """All batches by the identity of their point: those of samples in order, none with samples of another."""
        return {identity: _without_overlap(batches) for identity, batches in self._all().items()}

    def _all(self) -> dict[str, list[Batch]]:
        """All batches by the identity of their point, in the order of their names.

        A listing while a run joins batches may have neither the parts nor the whole of them, but then the next one has
        the whole: a program that only reads lists twice.
        """
        names = _names_in(self.folder)
        if not self.can_write:
            names |= _names_in(self.folder)
        found: dict[str, list[Batch]] = defaultdict(list)
        for parts in filter(None, map(_NAME.fullmatch, sorted(names))):
            identity, first, end, name = parts.group("point", "first", "end", "name")
            found[identity].append(Batch(self.folder / BATCHES / parts[0], int(first), int(end), name or ""))
        return found

    def read(self, batch: Batch) -> bytes:
        """The bytes of a batch.

        Raises DamagedBatchError unless they are as they were written under this name, FileNotFoundError for a batch
        that is gone, and SweepError for one of another sweep and one that cannot be read.
        """
        try:
            return without_header(self.sweep_id, batch.path.name, read_regular(batch.path))
        except FileNotFoundError:
            raise
        except ForeignBatchError:
            raise SweepError(f"{batch.path} is a batch of another sweep; move it elsewhere, and run again.") from None
        except OSError as error:
            todo = "remove it" if isinstance(error, NotAFileError) else "make it readable, or remove it"
            raise SweepError(f"{batch.path} cannot be read ({error.strerror}); {todo}, and run again.") from error

    def check_batches(self) -> None:
        """Remove batches that have another name than when they were written, as tasks are found by the names.

        Raises SweepError for undamaged batches of another sweep, and for what is no file, which must not be replaced.
        """
        foreign, is_any_ours = None, False
        for batch in itertools.chain.from_iterable(self._all().values()):
            try:
                sweep_id, name = id_and_name(read_regular(batch.path, LONGEST_HEADER))
            except NotAFileError:
                self.read(batch)  # says so
                continue
            except OSError:
                continue
            if sweep_id != self.sweep_id:
                try:
                    self.read(batch)
                except (DamagedBatchError, FileNotFoundError):
                    continue
                except SweepError as error:
                    foreign = foreign or error
            elif name != batch.path.name:
                self.remove(batch, f"it is {name}, under another name")
            is_any_ours |= sweep_id == self.sweep_id
        if foreign is not None and not is_any_ours:
            raise SweepError(
                f"{self.folder} has batches of another sweep than its {MANIFEST}; put their manifest back, or choose "
                "another folder."
            )
        if foreign is not None:
            raise foreign

    def remove(self, batch: Batch, reason: str) -> None:
        """Remove a batch that is damaged, and log that."""
        self.log(f"damaged, to be done again: {batch.path.name} ({reason})")
        with contextlib.suppress(OSError):  # the new batch replaces it
            batch.path.unlink()

    def remove_leftovers(self, identities: Iterable[str]) -> None:
        """Remove batches of these points whose samples are in a longer one too: an interrupted join leaves them."""
        there = self._all()
        for identity in identities:
            for batch in set(there[identity]).difference(_without_overlap(there[identity])):
                with contextlib.suppress(OSError):  # they do no harm
                    batch.path.unlink()

    def batch_of(self, identity: str, task: Task, plan: Plan) -> Batch:
        """The file for the result of a task."""
        derivative = "" if task.derivative is None else derivative_name(plan, task.derivative)
        ending = f"-{derivative}.json" if derivative else ".zip"
        path = self.folder / BATCHES / f"{identity}-{task.first}-{task.end}{ending}"
        return Batch(path, task.first, task.end, derivative)

    def write(self, path: Path, data: bytes) -> None:
        """Write the bytes of a batch. Raises SweepError if that fails."""
        self.check_kept()
        try:
            write_whole(path, with_header(self.sweep_id, path.name, data))
        except FileNotFoundError as error:  # while the folder is being removed, the rest may still be there
            self.check_kept()
            raise self._taken_away(path.name) from error
        except OSError as error:
            self.check_kept()
            raise cannot_write(self.folder, error) from error

    def log(self, text: str) -> None:
        """Add a line to the log, with the time."""
        with contextlib.suppress(OSError):
            append_regular(self.folder / LOG, f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")


def _names_in(folder: Path) -> set[str]:
    """The names in the folder of the batches. Raises SweepError if they cannot be listed."""
    try:
        return set(os.listdir(folder / BATCHES))
    except FileNotFoundError:
        return set()
    except NotADirectoryError:
        raise SweepError(
            f"{folder / BATCHES} must be a folder, for the batches of the sweep, but is a file; move it elsewhere, and "
            "run again."
        ) from None
    except OSError as error:
        raise SweepError(f"{folder / BATCHES} cannot be read ({error.strerror}); make it readable.") from error


def _ids_in(folder: Path) -> set[bytes]:
    """The identities of sweeps with which the batches begin."""
    found = set()
    for name in filter(_NAME.fullmatch, _names_in(folder)):
        with contextlib.suppress(OSError):
            found.add(read_regular(folder / BATCHES / name, ID_LENGTH))
    return found


def _file_number(path: Path) -> tuple[int, int] | None:
    """The numbers by which the system tells a file from a later one of its name; None if it is not there."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def derivative_name(plan: Plan, number: int) -> str:
    """A name for files."""
    statistic, wrt = plan.derivatives[number]
    name = f"d_{statistic}_by_{'_'.join(wrt)}".replace("/", "_")
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[:_LONGEST_NAME]}_{hashlib.sha256(name.encode()).hexdigest()[:16]}"


@contextlib.contextmanager
def opened(folder: Path, plan: Plan) -> Iterator[tuple[Store, Plan]]:
    """The store for `plan` in `folder`, locked for writing, and the plan with the batches of the store.

    A folder without a sweep must be empty or missing. If the folder has a manifest with the same numbers, the new one
    replaces it. Raises SweepError for a manifest with other numbers, and for other folders.
    """
    _make_folder(folder)
    with locked(folder / LOCK, f"{folder} is in use by another run; wait for it to end, or choose another folder."):
        text = manifest_text(plan)
        if has_manifest(folder):
            stored = body_in(folder, lambda: _ids_in(folder), to_write=True)
            plan = dataclasses.replace(plan, batch=stored["deciding"]["batch"])
            new = body_of(manifest_text(plan))
            _check_extends(folder, stored, new)
            text = extended(stored, new)
        store = Store(folder, body_of(text), can_write=True)
        store.check_batches()
        try:
            remove_unfinished(folder)
            remove_unfinished(folder / BATCHES)
            (folder / BATCHES).mkdir(exist_ok=True)
            for path in (folder / MANIFEST, folder / COPY):
                if not path.exists() or read_regular(path) != text.encode():
                    write_whole(path, text.encode())
            sync_folder(folder.parent)
        except OSError as error:
            raise cannot_write(folder, error) from error
        yield store, plan


def _check_extends(folder: Path, stored: Manifest, new: Manifest) -> None:
    """Raises SweepError unless the sweep of the `new` manifest only adds to that of the `stored` one."""
    found = differences(stored, new)
    if found:
        raise SweepError(
            f"{folder} holds a sweep with other numbers ({'; '.join(found[:5])}); choose another folder, or "
            "change the sweep back."
        )
    if stored["asked"]["samples"] > new["asked"]["samples"]:
        raise SweepError(
            f"{folder} holds {stored['asked']['samples']} samples of each point; ask for at least as many, or "
            "choose another folder."
        )


def _make_folder(folder: Path) -> None:
    """Make the folder. Raises SweepError for one that holds something else, or cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(path.name for path in folder.iterdir() if not _is_begun(path))
        has_sweep = has_manifest(folder)
    except FileExistsError:
        raise SweepError(f"{folder} cannot hold a sweep, because it is a file; choose another folder.") from None
    except NotADirectoryError:
        raise SweepError(f"{folder} cannot hold a sweep, because it lies below a file; choose another.") from None
    except OSError as error:
        raise cannot_write(folder, error) from error
    if others and not has_sweep:
        raise SweepError(
            f"{folder} is not empty and holds no sweep (it has {others[0]}); choose an empty or a new folder."
        )


def _is_begun(path: Path) -> bool:
    """Whether `opened` makes such a file before the manifest is complete."""
    if path.name == BATCHES:
        return path.is_dir() and not os.listdir(path)
    return path.name == LOCK or finished_name(path.name) in (MANIFEST, COPY)


def _without_overlap(batches: list[Batch]) -> list[Batch]:
    """Batches of samples in order, of which none has samples of another, the longest first; then the others."""
    chosen, at = [], 0
    for batch in sorted((one for one in batches if not one.derivative), key=lambda one: (one.first, -one.end)):
        if batch.first >= at:
            chosen.append(batch)
            at = batch.end
    return chosen + [one for one in batches if one.derivative]
