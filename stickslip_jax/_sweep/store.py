"""The folder of a sweep: its manifest, the batches that are done, the data set, a log, and a lock."""

import contextlib
import dataclasses
import hashlib
import itertools
import json
import os
import re
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .._dynamics.simulate import Output
from .._ensemble import encoding
from .._ensemble.data import Unknown
from .._ensemble.encoding import DamagedFileError, Decoder, Encoder, ForeignFileError, SweepError
from .._ensemble.points import Dimension, Points, SweepSetting, points_of, setting_of
from .._foundation import checks, files
from .._foundation.files import NotAFileError
from .._statistics.quantities import Numbering
from .batches import Plan, Task, checked_derivatives, checked_errors, checked_keep, checked_statistics

# The manifest of a sweep's folder, and its copy there: everything that decides the numbers, and what was asked for.


MANIFEST, COPY = "manifest.json", "manifest-copy.json"
FORMAT, FORMAT_VERSION = "stickslip_jax sweep", 4
_OLDER_FORMAT = "stickslip_jax study"  # of versions 1 and 2
OBJECTS = ("system", "law", "y0", "method")
DECIDING = ("t1", "keep", "key_data", "numbering", "independent", "batch", "dtype", "output_code")
_FINGERPRINT = ("objects", "deciding", "versions", "floats", "integers")
_ARGUMENTS = {"key_data": "key", "numbering": "orders and count_initial_rest", "output_code": "outputs"}
"""What the user calls it, where that is another name."""
ASKED = ("samples", "statistics", "derivatives", "standard_errors", "realizations")


Manifest: TypeAlias = dict[str, Any]
"""What a manifest holds.

- `objects`: system, law, start and method, of which long arrays stand in `floats` and `integers`.
- `deciding`: the other arguments that decide the numbers. `asked`: those that may change from run to run.
- `dimensions`: of the points: name, parameters, values.
"""
_KINDS: dict[str, type] = {"format_version": int} | dict.fromkeys(("versions", "objects", "deciding", "asked"), dict)
_KINDS |= dict.fromkeys(("dimensions", "floats", "integers"), list)


def manifest_text(plan: Plan) -> str:
    """The manifest of a sweep as JSON."""
    encoder = Encoder()
    body = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": encoding.versions(),
        "objects": {name: encoder.encoded(getattr(plan.setting, name)) for name in OBJECTS},
        "deciding": {name: getattr(plan, name) for name in DECIDING},
        "asked": {name: getattr(plan, name) for name in ASKED},
        "dimensions": [
            {"name": one.name, "parameters": list(one.parameters), "values": one.values.tolist()}
            for one in plan.points.dimensions
        ],
        "floats": [float(value).hex() for value in encoder.floats],
        "integers": encoder.integers.tolist(),
    }
    return _text(body)


def _text(body: Mapping[str, object]) -> str:
    return json.dumps({"body": body, "sha256": encoding.sum_of(body)}, indent=1)


def body_of(text: str | bytes) -> Manifest:
    """The manifest in a text.

    Raises ForeignFileError for a text of another program, DamagedFileError for a damaged one, and SweepError for
    another format.
    """
    try:
        whole = json.loads(text)
        is_ours = isinstance(whole, dict) and bool({"body", "sha256"} & whole.keys())
        body: Any = whole.get("body") if is_ours else None
        is_whole = isinstance(body, dict) and encoding.sum_of(body) == whole.get("sha256")
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(str(error)) from error
    if not is_ours:
        raise ForeignFileError("it is of another program")
    if not is_whole:
        raise DamagedFileError("its check sum is wrong")
    if body.get("format") not in (FORMAT, _OLDER_FORMAT):
        raise ForeignFileError("it is of another program")
    version, writers = body.get("format_version"), body.get("versions")
    if version != FORMAT_VERSION and isinstance(version, int):
        writer = writers.get("stickslip_jax") if isinstance(writers, dict) else "of an unknown version"
        is_newer = version > FORMAT_VERSION
        todo = "install that version or a newer one" if is_newer else "run the sweep into another folder"
        raise SweepError(
            f"it has format {version}, written by stickslip_jax {writer}, and this version reads {FORMAT_VERSION}; "
            f"{todo}."
        )
    for name, kind in _KINDS.items():
        if type(body.get(name)) is not kind:
            raise DamagedFileError(f"its {name} is missing")
    wanted = {"versions": tuple(encoding.versions()), "objects": OBJECTS, "deciding": DECIDING, "asked": ASKED}
    for part, names in wanted.items():
        there = body[part]
        for name in (*(name for name in names if name not in there), *(name for name in there if name not in names)):
            raise DamagedFileError(f"its {part}.{name} is {'missing' if name in names else 'not known'}")
    return body


def differences(stored: Manifest, new: Manifest) -> list[str]:
    """What decides the numbers and differs between two manifests, each "name: ... there, ... here".

    Points, samples, statistics and sensitivities are not compared: other ones are added to what is stored.
    """
    parameters = [{name for one in body["dimensions"] for name in one["parameters"]} for body in (stored, new)]
    found = []
    if parameters[0] != parameters[1]:
        found.append(f"parameters: {', '.join(sorted(parameters[0]))} there, {', '.join(sorted(parameters[1]))} here")
    for part in ("objects", "deciding", "versions"):
        for path, there, here in _different(stored[part], new[part], ()):
            parts = [_ARGUMENTS.get(part, part) for part in path]
            name = ".".join(part for part in parts if part not in ("fields", "class", "values", "tuple")) or "object"
            found.append(f"{name}: {_brief(there)} there, {_brief(here)} here")
    if not found and any(stored[part] != new[part] for part in ("floats", "integers")):
        found.append("an array of the system or law differs")
    return found


def _different(old: Any, new: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], object, object]]:
    are_parts = isinstance(old, dict) and isinstance(new, dict)
    if are_parts and (old.keys(), old.get("class")) == (new.keys(), new.get("class")):
        for name in old:
            yield from _different(old[name], new[name], (*path, name))
    elif old != new:
        yield path, old, new


def _brief(value: object) -> str:
    if isinstance(value, dict) and "class" in value:
        fields = value["fields"]
        return fields["text"] or fields["name"] if value["class"] == "Unknown" else str(value["class"])
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


# --- in the folder


def sweep_id_of(body: Manifest) -> bytes:
    """The identity of a sweep: of everything that decides the numbers at a point."""
    return encoding.id_of({name: body[name] for name in _FINGERPRINT})


def has_manifest(folder: Path) -> bool:
    """Whether there is a manifest, or a copy of one."""
    return any((folder / name).exists() for name in (MANIFEST, COPY))


def body_in(folder: Path, *, to_write: bool = False) -> Manifest:
    """The manifest of a folder, or its copy where that is damaged.

    Args:
        folder: That of the sweep.
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
            found[name] = body_of(files.read_regular(path))
        except (FileNotFoundError, NotADirectoryError):
            continue
        except SweepError as error:
            raise SweepError(f"{folder} cannot be read: {error}") from None
        except (DamagedFileError, ForeignFileError) as error:
            damage = damage or f"{path} is damaged ({error})"
            foreign = path if isinstance(error, ForeignFileError) else foreign
        except OSError as error:
            todo = "move it elsewhere, and try again" if isinstance(error, NotAFileError) else "make it readable"
            raise SweepError(f"{path} cannot be read ({error.strerror}); {todo}.") from None
    if not found and damage:
        raise SweepError(f"{damage}, and there is no whole copy of it; run the sweep into another folder.")
    if not found:
        raise SweepError(
            f"{folder} holds no sweep ({FORMAT}); name the folder that Sweep.run or stickslip sweep wrote."
        )
    if len({sweep_id_of(body) for body in found.values()}) > 1:
        ids = set()  # with which the batches begin that are there
        for name in filter(_NAME.fullmatch, _names_in(folder)):
            with contextlib.suppress(OSError):
                ids.add(files.read_regular(folder / BATCHES / name, encoding.ID_LENGTH))
        right = [name for name, body in found.items() if sweep_id_of(body) in ids]
        if len(right) != 1:
            raise SweepError(
                f"{folder / MANIFEST} and {COPY} beside it are of two sweeps; move the one elsewhere that is not of "
                "this sweep, and try again."
            )
        (wrong,) = found.keys() - right
        raise SweepError(
            f"{folder / wrong} is of another sweep than {right[0]} and the batches beside it; move {wrong} elsewhere, "
            "and try again."
        )
    if to_write and foreign is not None:
        raise SweepError(
            f"{foreign} is a file of another program beside the sweep's own; move it elsewhere, and try again."
        )
    return found.get(MANIFEST) or found[COPY]


# The sweep that a manifest describes: checked as a `Sweep` checks its arguments, for a file may have been edited.


_UNFIT = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def _plan(body: Manifest, to_run: bool) -> Plan:
    fields = body["deciding"] | body["asked"]
    if fields["dtype"] not in ("float64", "float32"):
        raise ValueError(f"dtype is {checks.show(fields['dtype'])}")
    keep = checked_keep(fields["keep"])
    derivatives = [(name, tuple(wrt)) for name, wrt in fields["derivatives"]]
    statistics = _known(fields["statistics"], lambda name: checked_statistics([name], keep))
    fields["numbering"] = Numbering.checked(*fields["numbering"])
    words, outputs = fields["key_data"], fields.pop("output_code")
    is_key = isinstance(words, list) and all(type(word) is int and 0 <= word < 2**32 for word in words)
    if words is not None and not is_key:
        raise ValueError(f"key is {checks.show(words)}")
    fields |= {
        "key_data": None if words is None else tuple(words),
        "statistics": statistics,
        "derivatives": _known(derivatives, lambda one: checked_derivatives([one])),
        "standard_errors": checked_errors(fields["standard_errors"] or None, statistics),
        "outputs": {name: Output(_not_stored, name, unit) for name, unit, _ in outputs},
    }
    if outputs and to_run:
        raise SweepError(
            f"its outputs ({', '.join(fields['outputs'])}) are functions of your own, which are not stored; run your "
            "own program again with the same folder, which goes on from here."
        )
    floats = np.array([float.fromhex(value) for value in body["floats"]])
    decoder = Decoder(floats, np.array(body["integers"], np.int64))
    objects = {name: decoder.decoded(body["objects"][name]) for name in OBJECTS}
    held = {name: value if isinstance(value, tuple) else (value,) for name, value in objects.items()}
    unknown = [(name, one) for name, parts in held.items() for one in parts if isinstance(one, Unknown)]
    if to_run and unknown:
        name, one = unknown[0]
        raise SweepError(
            f"its {name} is a {one.name} of your own, which is stored as text only; run your own program again with "
            "the same folder, which goes on from here."
        )
    setting = (SweepSetting if unknown else setting_of)(**objects)
    over = {tuple(one["parameters"]): np.array(one["values"], float) for one in body["dimensions"]}
    named = zip(points_of(over).dimensions, body["dimensions"], strict=True)
    points = Points(tuple(Dimension(stored["name"], one.parameters, one.values) for one, stored in named))
    return Plan(setting, points, **fields)


def _not_stored(one: object) -> float:
    raise SweepError("the functions of outputs are not stored")


def _known(names: object, check: Callable[[Any], tuple[Any, ...]]) -> tuple[Any, ...]:
    """Those of the `names` that this version knows; a warning tells of the others."""
    if not isinstance(names, list):
        raise TypeError(f"statistics are {checks.show(names)}")
    known = []
    for name in names:
        try:
            known += check(name)
        except ValueError:
            shown = name if isinstance(name, str) else name[0]
            warnings.warn(
                f"The sweep asks for {checks.show(shown)}, which this version of stickslip_jax does not know; it is "
                "left out.",
                stacklevel=2,
            )
    return tuple(dict.fromkeys(known))


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
        return cls(folder, body_in(folder))

    def plan(self, *, to_run: bool = True, every_point: bool = False) -> Plan:
        """The sweep that is stored; `every_point`: whether each is checked, as by `Sweep`, or the first.

        Raises SweepError where it holds objects of a user's own classes, which cannot be run (with `to_run` False these
        are left as they are stored), and for what does not fit together. Statistics and derivatives that this version
        does not know are left out, with a warning.
        """
        try:
            plan = _plan(self.body, to_run)
            if every_point:
                with warnings.catch_warnings():  # a run says it; who only reads need not know
                    warnings.filterwarnings("ignore", "stickslip_jax runs in float32")
                    plan.check()
            elif to_run:
                plan.setting_at(0)
            return plan
        except SweepError as error:
            raise SweepError(f"{self.folder}: {error}") from None
        except _UNFIT as error:
            reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise SweepError(
                f"{self.folder}: its manifest cannot be used ({reason}); run the sweep into another folder."
            ) from error

    @property
    def dtype(self) -> str:
        """The precision of the sweep, "float64" or "float32"."""
        return self.body["deciding"]["dtype"]

    @property
    def is_in_use(self) -> bool:
        """Whether a run holds the folder now."""
        path = self.folder / LOCK
        if not path.exists():
            return False
        from filelock import FileLock, Timeout  # noqa: PLC0415

        try:
            with FileLock(path, timeout=0):
                return False
        except Timeout:
            return True
        except OSError:  # that cannot be found out
            return False

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

    def _all(self) -> defaultdict[str, list[Batch]]:
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

        Raises DamagedFileError unless they are as they were written under this name, FileNotFoundError for a batch
        that is gone, and SweepError for one of another sweep and one that cannot be read.
        """
        try:
            return encoding.without_header(self.sweep_id, batch.path.name, files.read_regular(batch.path))
        except FileNotFoundError:
            raise
        except ForeignFileError:
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
                sweep_id, name, _ = encoding.parts_of_file(files.read_regular(batch.path, encoding.LONGEST_HEADER))
                if sweep_id != self.sweep_id:
                    self.read(batch)  # raises an error for any
                is_any_ours = True
                if name != batch.path.name:
                    self.remove(batch, f"it is {name}, under another name")
            except NotAFileError:
                self.read(batch)  # says so
            except SweepError as error:
                foreign = foreign or error
            except (DamagedFileError, OSError):
                continue
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

    def batch_of(self, task: Task, plan: Plan) -> Batch:
        """The file for the result of a task."""
        derivative = "" if task.derivative is None else derivative_name(plan, task.derivative)
        ending = f"-{derivative}.json" if derivative else ".zip"
        path = self.folder / BATCHES / f"{plan.points.identity(task.point)}-{task.first}-{task.end}{ending}"
        return Batch(path, task.first, task.end, derivative)

    def write(self, path: Path, data: bytes) -> None:
        """Write the bytes of a batch. Raises SweepError if that fails."""
        self.check_kept()
        try:
            files.write_whole(path, encoding.with_header(self.sweep_id, path.name, data))
        except FileNotFoundError as error:  # while the folder is being removed, the rest may still be there
            self.check_kept()
            raise self._taken_away(path.name) from error
        except OSError as error:
            self.check_kept()
            raise encoding.cannot_write(self.folder, error) from error

    def log(self, text: str) -> None:
        """Add a line to the log, with the time."""
        with contextlib.suppress(OSError):
            files.append_regular(self.folder / LOG, f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")


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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(path.name for path in folder.iterdir() if not _is_begun(path))
        has_sweep = has_manifest(folder)
    except FileExistsError:
        raise SweepError(f"{folder} cannot hold a sweep, because it is a file; choose another folder.") from None
    except NotADirectoryError:
        raise SweepError(f"{folder} cannot hold a sweep, because it lies below a file; choose another.") from None
    except OSError as error:
        raise encoding.cannot_write(folder, error) from error
    if others and not has_sweep:
        raise SweepError(
            f"{folder} is not empty and holds no sweep (it has {others[0]}); choose an empty or a new folder."
        )
    in_use = f"{folder} is in use by another run; wait for it to end, or choose another folder."
    with encoding.locked(folder / LOCK, in_use):
        text = manifest_text(plan)
        if has_manifest(folder):
            stored = body_in(folder, to_write=True)
            plan = dataclasses.replace(plan, batch=stored["deciding"]["batch"])
            new = body_of(manifest_text(plan))
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
            # What decides the numbers is written as in the stored one: numbers may be equal and written otherwise, 1
            # and 1.0, and the batches bear the identity of what is stored.
            text = _text({**new, **{name: stored[name] for name in _FINGERPRINT}})
        store = Store(folder, body_of(text), can_write=True)
        store.check_batches()
        try:
            files.remove_unfinished(folder)
            files.remove_unfinished(folder / BATCHES)
            (folder / BATCHES).mkdir(exist_ok=True)
            for path in (folder / MANIFEST, folder / COPY):
                if not path.exists() or files.read_regular(path) != text.encode():
                    files.write_whole(path, text.encode())
            files.sync_folder(folder.parent)
        except OSError as error:
            raise encoding.cannot_write(folder, error) from error
        yield store, plan


def _is_begun(path: Path) -> bool:
    """Whether `opened` makes such a file before the manifest is complete."""
    if path.name == BATCHES:
        return path.is_dir() and not os.listdir(path)
    return path.name == LOCK or files.finished_name(path.name) in (MANIFEST, COPY)


def _without_overlap(batches: list[Batch]) -> list[Batch]:
    """Batches of samples in order, of which none has samples of another, the longest first; then the others."""
    chosen, at = [], 0
    for batch in sorted((one for one in batches if not one.derivative), key=lambda one: (one.first, -one.end)):
        if batch.first >= at:
            chosen.append(batch)
            at = batch.end
    return chosen + [one for one in batches if one.derivative]
