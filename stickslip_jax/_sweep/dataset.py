"""The tasks of a sweep that are left and the batches that are there, put together as one labelled data set."""

import contextlib
import json
import math
import pickle
import re
import weakref
from collections.abc import Hashable, Iterator
from datetime import datetime
from pathlib import Path
from tempfile import SpooledTemporaryFile, gettempdir
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from .._dynamics.simulation import source
from .._ensemble.encoding import DamagedFileError, SweepError, as_netcdf, cannot_write, read_netcdf, sum_of, verified
from .._ensemble.ensemble import Ensemble
from .._ensemble.points import POINT, label_and_unit
from .._foundation.extras import NO_BAR, Entries, Progress, labeled_dataset, require, variable
from .._foundation.files import write_whole
from .._foundation.types import Status
from .._numerics.sums import CommonBins, DyadicCounts
from .._statistics.distribution import DEFAULT_BINS, LEVELS, Distribution, default_bins
from .._statistics.estimate import Estimate
from .._statistics.quantities import BY_NAME as STICK_BY_NAME
from .._statistics.quantities import DISTRIBUTIONS, SampledQuantity
from .._statistics.totals import DIFFERENTIABLE, STATISTICS
from .._systems.system import require_system
from .batches import Plan, Task, derivatives_of, head_of, joined, packed, unpacked
from .store import DATA, LOG, Batch, Store, derivative_name

if TYPE_CHECKING:
    import xarray


# The tasks of a sweep that are left, and the batches that are there.


_IN_MEMORY = 2**26  # bytes of distributions; what is more goes to a temporary file
_ON_DISK = 2**30  # bytes of distributions that a run keeps; of the others it reads the batches again
_Value = TypeVar("_Value")
_LISTINGS = 5  # of the folder at most, where a run that is under way has joined batches since the last


class Work:
    """The tasks of a sweep that are left, in order of the points.

    `identities`: of the points. `done`: the samples of each that are there. `failed`: what went wrong, by point.
    `without_memory`: tasks for which there was no memory, and the error; a later run does them. `complete`: points with
    nothing left to do. `damaged`: batches that could not be read, and were removed.
    """

    def __init__(self, plan: Plan, store: Store):
        self.plan, self.store = plan, store
        self.done = [0] * plan.points.number
        self.failed: dict[int, str] = {}
        self.without_memory: dict[Task, str] = {}
        self.complete = self.damaged = 0
        self.identities = [plan.points.identity(point) for point in range(plan.points.number)]
        self._batches = store.batches()
        self._left: dict[int, int] = {}  # tasks of a point that are not done

    def _batches_at(self, point: int) -> list[Batch]:
        """The batches of a point that are there."""
        return self._batches.get(self.identities[point], [])

    def _of_samples(self, point: int) -> list[Batch]:
        """The batches of samples of a point, without those of derivatives."""
        return [batch for batch in self._batches_at(point) if not batch.derivative]

    def tasks(self) -> Iterator[Task]:
        """What is left to do. With wanted standard errors, the next batch of each point that misses them."""
        for point in range(self.plan.points.number):
            self.done[point] = sum(batch.end - batch.first for batch in self._of_samples(point))
            tasks = self._missing(point)
            there = {(batch.derivative, batch.end) for batch in self._batches_at(point)}
            for number in range(len(self.plan.derivatives)):
                if (derivative_name(self.plan, number), self.plan.samples) not in there:
                    tasks.append(Task(point, 0, self.plan.samples, number))
            self._left[point] = len(tasks)
            if not tasks:
                self.complete += 1
                self._join(point)  # an earlier run may have been stopped before
            yield from tasks

    def is_complete(self, point: int) -> bool:
        """Whether nothing is left to do at a point."""
        return self._left[point] == 0

    def _missing(self, point: int) -> list[Task]:
        """The tasks for samples of a point that are not there, which end at multiples of the size of a batch; with
        wanted standard errors, the first of them.
        """
        size, missing, at = self.plan.batch, [], 0
        there = [(batch.first, batch.end) for batch in self._of_samples(point)]
        for first, end in (*there, (self.plan.samples, self.plan.samples)):
            while at < first:
                after = min((at // size + 1) * size, first)
                missing.append(Task(point, at, after))
                at = after
            at = end
        if not (self.plan.standard_errors and missing):
            return missing
        ensemble, errors = self.ensemble(point), self.plan.standard_errors
        is_precise = ensemble is not None and all(
            STATISTICS[name](ensemble).standard_error <= most for name, most in errors.items()
        )
        return [] if is_precise else missing[:1]  # an error that is NaN is not yet small

    def finish(self, task: Task, data: bytes | None) -> list[Task]:
        """Store the result of a task (None: the worker has stored it); returns the tasks that follow from it."""
        batch = self.store.batch_of(task, self.plan)
        if data is not None:
            self.store.write(batch.path, data)
        batches = self._batches.setdefault(self.identities[task.point], [])
        batches.append(batch)
        batches.sort(key=lambda batch: (batch.derivative, batch.first))
        try:
            data = self.store.read(batch) if data is None else data
            counts = []
            if task.derivative is None:
                counts = zip(Status, head_of(data, task.first, task.end)["status_counts"], strict=True)
            else:
                derivatives_of(data, task.end)
        except DamagedFileError as error:
            self._remove(task.point, batch, str(error))
            return []
        unfinished = [f"{count} {status.name}" for status, count in counts if count and status != Status.FINISHED]
        if unfinished:
            where = f"{self.plan.points.described(task.point)}: samples {task.first} to {task.end - 1}"
            self.store.log(f"not to the end {where}: {', '.join(unfinished)}")
        self._left[task.point] -= 1
        more = []
        if task.derivative is None:
            self.done[task.point] += task.samples
            more = self._missing(task.point) if self.plan.standard_errors else []
            self._left[task.point] += len(more)
        if self.is_complete(task.point):
            self.complete += 1
            self._join(task.point)
        return more

    def ensemble(self, point: int) -> Ensemble | None:
        """The samples of a point from the first on that are there without a gap; None if there is none.

        Samples after a damaged batch are left out; the batch is removed, unless the store is only read.
        """
        found, fields = [], self.plan.fields_at(point)
        for batch, data in self._read(point, is_gap_allowed=False):
            with self._damage_removed(point, batch):
                found.append(unpacked(data, fields, batch.first, batch.end))
                continue
            break
        return joined(found) if len(found) > 1 else found[0] if found else None

    def heads(self, point: int) -> list[dict[str, Any]]:
        """The heads of the batches of samples of a point."""
        found = []
        for batch, data in self._read(point, is_gap_allowed=True):
            with self._damage_removed(point, batch):
                found.append(head_of(data, batch.first, batch.end))
        return found

    def _read(self, point: int, *, is_gap_allowed: bool) -> list[tuple[Batch, bytes]]:
        """The batches of samples of a point that are there, with their bytes."""
        for _ in range(_LISTINGS):
            found, at = [], 0
            try:
                for batch in self._of_samples(point):
                    if batch.first == at or is_gap_allowed:
                        with self._damage_removed(point, batch):
                            found.append((batch, self.store.read(batch)))
                            at = batch.end  # where it is damaged, all that follow come after a gap
                return found
            except FileNotFoundError:
                self._list_again()
        return []

    def _list_again(self) -> None:
        """List the batches again because one is gone. If this program only reads, a run has joined it with others."""
        self._batches = self.store.batches()
        self.damaged += 1

    def derivatives(self, point: int) -> dict[str, dict[str, Any]]:
        """The results of the derivatives of a point that are there, by name."""
        found, names = {}, {derivative_name(self.plan, number) for number in range(len(self.plan.derivatives))}
        for batch in list(self._batches_at(point)):
            if batch.derivative in names and batch.end == self.plan.samples:
                try:
                    with self._damage_removed(point, batch):
                        found[batch.derivative] = derivatives_of(self.store.read(batch), batch.end)
                except FileNotFoundError:
                    self._list_again()
        return found

    def _join(self, point: int) -> None:
        """Join the files of a point, if there are several: each holds histograms, so that one takes less space."""
        batches = self._of_samples(point)
        if len(batches) < 2 or not self.store.can_write:
            return
        whole = self.ensemble(point)
        if whole is None or whole.samples != batches[-1].end:  # a damaged batch, which is done again
            return
        joint = self.store.batch_of(Task(point, 0, whole.samples), self.plan)
        self.store.write(joint.path, packed(whole))
        there = self._batches_at(point)
        there[:] = [joint, *(batch for batch in there if batch.derivative)]
        for batch in batches:
            with contextlib.suppress(OSError):  # what is left is not used, and removed at the end
                batch.path.unlink()

    @contextlib.contextmanager
    def _damage_removed(self, point: int, batch: Batch) -> Iterator[None]:
        """Remove a batch in which the block finds damage."""
        try:
            yield
        except DamagedFileError as error:
            self._remove(point, batch, str(error))

    def _remove(self, point: int, batch: Batch, reason: str) -> None:
        with contextlib.suppress(ValueError):  # the folder was listed again since it was read
            self._batches_at(point).remove(batch)
        self.damaged += 1
        if self.store.can_write:
            self.store.remove(batch, reason)


class Spool(Generic[_Value]):
    """One object for each point, in memory or, where they are many, in a temporary file.

    `most`: bytes beyond which, and without room for them, objects are not kept; None: all are.
    """

    def __init__(self, most: int | None = None) -> None:
        self._most = most
        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, self._file.close)
        self._starts: dict[int, int] = {}

    def put(self, point: int, value: _Value) -> None:
        """Keep the object of a point. Raises SweepError where there is no room for one that is to be kept."""
        try:
            start = self._file.seek(0, 2)
            if self._most is not None and start > self._most:
                return
            pickle.dump(value, self._file)
        except OSError as error:
            if self._most is not None:
                return
            raise SweepError(
                f"{gettempdir()} cannot be written ({error.strerror}), where the distributions of a large sweep are "
                "kept until its histograms are made; make room there, or name another folder in the environment "
                "variable TMPDIR."
            ) from error
        self._starts[point] = start

    def get(self, point: int) -> _Value | None:
        """That of a point; None if it is not kept."""
        if point not in self._starts:
            return None
        self._file.seek(self._starts[point])
        return pickle.load(self._file)


# The result of a sweep as one labelled data set.


_BY_NAME: dict[str, SampledQuantity] = {quantity.name: quantity for quantity in DISTRIBUTIONS}


class Variables:
    """The variables of the data set, filled in point by point; NaN, or 0 for counts, where nothing is yet."""

    def __init__(self, plan: Plan):
        self._points = plan.points
        self._found: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}

    def put(
        self, point: int, name: str, value: object, long_name: str, unit: str = "1", *, dimensions: tuple[str, ...] = ()
    ) -> None:
        """Put the `value` of a variable at a point; `dimensions`: those that it has besides those of the points."""
        value = np.asarray(value)
        if name not in self._found:
            empty = np.nan if value.dtype.kind == "f" else 0
            array = np.full((self._points.number, *value.shape), empty, value.dtype)
            self._found[name] = (dimensions, array, {"long_name": long_name, "units": unit})
        self._found[name][1][point] = value

    def estimate(self, point: int, name: str, estimate: Estimate, long_name: str = "") -> None:
        """Put the value and the standard error of an estimate."""
        unit = estimate.unit or "1"
        self.put(point, name, float(estimate.value), long_name or estimate.name, unit)
        self.put(point, f"{name}_error", float(estimate.standard_error), f"standard error of {name}", unit)

    def distribution(self, point: int, name: str, of: Distribution, *, has_skewness: bool) -> None:
        """Put mean, spread and quantiles of a distribution."""
        self.estimate(point, f"{name}_mean", of.mean, f"mean of {of.name}")
        self.estimate(point, f"{name}_standard_deviation", of.standard_deviation)
        if has_skewness:
            self.estimate(point, f"{name}_skewness", of.skewness)
        # Without the errors that quantile() finds too, which take longer than all else here.
        quantiles = [float(of._value_at(level)) if of.number else math.nan for level in LEVELS]
        self.put(point, f"{name}_quantile", quantiles, f"quantile of {of.name}", of.unit, dimensions=("quantile",))

    def entries(self) -> Entries:
        """All of them, by name, as xarray takes them."""
        own = tuple(one.name for one in self._points.dimensions)
        return {
            name: ((*own, *dimensions), array.reshape(*self._points.shape, *array.shape[1:]), attributes)
            for name, (dimensions, array, attributes) in self._found.items()
        }


def require_packages() -> None:
    """Raises ImportError where what a sweep is stored with is not installed."""
    require("Sweeps need", "study", "xarray", "h5netcdf", "h5py", "filelock")


class Results:
    """The data set of a sweep, put together point by point, each read once: as soon as it is done, where a run does it.

    Histograms come last: their bins hold the values of all points.
    """

    def __init__(self, work: Work):
        self._work, self._variables, self._there = work, Variables(work.plan), set[int]()
        # A run that finds no room for them reads its own batches again; while another one writes, they may change.
        self._distributions = Spool[dict[str, Distribution]](_ON_DISK if work.store.can_write else None)
        self._ends: dict[str, list[DyadicCounts]] = {}

    @property
    def steps(self) -> int:
        """How often `dataset` advances its bar: once for each point that is not put yet, and once for all of them."""
        return 2 * self._work.plan.points.number - len(self._there)

    def put_if_complete(self, point: int) -> None:
        """Put a point if nothing is left to do there."""
        if self._work.is_complete(point):
            self.put(point)

    def put(self, point: int) -> None:
        """Put all of a point but histograms and derivatives. Raises SweepError where there is no room for it."""
        plan, variables, ensemble = self._work.plan, self._variables, self._work.ensemble(point)
        self._there.add(point)
        distributions = self._distributions_in(ensemble)
        self._distributions.put(point, distributions)
        samples, near, spent, counts = 0, 0, np.nan, dict.fromkeys(Status, 0)
        if ensemble is not None:
            samples, near, spent = ensemble.samples, ensemble.near_grazing_samples, ensemble.run_seconds
            counts = ensemble.status_counts
        variables.put(point, "samples", samples, "number of samples")
        for one in Status:
            label = f"number of samples with status {one.name}"
            variables.put(point, f"samples_{one.name.lower()}", counts[one], label)
        variables.put(point, "samples_near_grazing", near, "number of samples with an event decided by round-off")
        variables.put(point, "run_seconds", spent, "time spent simulating, summed over threads", "s")
        if ensemble is None:
            return
        for name in plan.statistics:
            if name in STATISTICS:
                variables.estimate(point, name, STATISTICS[name](ensemble))
        for name, of in ensemble.outputs.items():
            variables.distribution(point, name, of, has_skewness=False)
            variables.put(point, f"{name}_values", of.number, f"number of samples with a value of {name}")
        if plan.keep == "totals":
            return
        for name, of in distributions.items():
            variables.distribution(point, name, of, has_skewness=True)
            ends = of.bins._replace(counts=of.bins.counts[..., :0])  # the ends of the histogram without its numbers
            self._ends.setdefault(name, []).append(ends)
        by_order = [ensemble.statistics.order(number) for number in range(1, ensemble.numbering.orders + 1)]
        shares = [float(one.share.value) for one in by_order]
        variables.put(point, "share_with_order", shares, "share of samples that have the stick", dimensions=("order",))
        for name in by_order[0].distributions:
            means = [one.distributions[name].mean for one in by_order]
            label, unit = f"mean {STICK_BY_NAME[name].label} by order", means[0].unit
            for part, ending, text in (
                ("value", "", label),
                ("standard_error", "_error", f"standard error of {label}"),
            ):
                values = [float(getattr(mean, part)) for mean in means]
                variables.put(point, f"{name}_of_order{ending}", values, text, unit, dimensions=("order",))
        # Times of the sticks of the first samples that finished, for figures; NaN beyond the last that is held.
        for name in ("start", "end") if plan.realizations else ():
            held = 256
            times = np.full((plan.realizations, held), np.nan)
            own = getattr(ensemble.finished_sticks().head(plan.realizations).padded(), name)[:, :held]
            times[: len(own), : own.shape[1]] = own
            label = f"{name} of the first {held} sticks of some samples"
            variables.put(point, f"stick_{name}", times, label, "s", dimensions=("realization", "stick"))

    def _distributions_in(self, ensemble: Ensemble | None) -> dict[str, Distribution]:
        plan = self._work.plan
        names = [name for name in plan.statistics if name in _BY_NAME] if plan.keep != "totals" else []
        return {name: getattr(ensemble.statistics, name) for name in names} if ensemble is not None else {}

    def dataset(self, bar: Progress = NO_BAR) -> "xarray.Dataset":
        """All of it; what is not put yet is put."""
        plan, variables = self._work.plan, self._variables
        for point in sorted(set(range(plan.points.number)) - self._there):
            self.put(point)
            bar.advance(1)
        found = {name: CommonBins.of(ends, default_bins(_BY_NAME[name].is_whole)) for name, ends in self._ends.items()}
        bins = {name: common for name, common in found.items() if common is not None}
        for point in range(plan.points.number):
            distributions = self._distributions.get(point)
            if distributions is None:
                distributions = self._distributions_in(self._work.ensemble(point))
            for name in (name for name in distributions if name in bins):
                _put_histogram(variables, point, name, distributions[name], bins[name])
            self._put_derivatives(point)
            bar.advance(1)
        return labeled_dataset(variables.entries(), self._coordinates(bins), self._about())

    def _put_derivatives(self, point: int) -> None:
        plan, variables, derivatives = self._work.plan, self._variables, self._work.derivatives(point)
        for number, (statistic, _) in enumerate(plan.derivatives):
            result = derivatives.get(derivative_name(plan, number))
            of = next(one.unit for one in DIFFERENTIABLE if one.name == statistic)
            for wrt, numbers in (result["by"] if result else {}).items():
                name, (_, by) = f"d_{statistic}_by_{wrt}", label_and_unit(plan.setting, wrt)
                unit = of if by == "1" else f"{of} ({by})-1"  # such as "s (1/s)-1", of a duration by a rate
                variables.put(point, name, numbers["derivative"], f"derivative of {statistic} by {wrt}", unit)
                variables.put(point, f"{name}_error", numbers["standard_error"], f"standard error of {name}", unit)
                corrected = int(numbers["estimator"] == "corrected")
                variables.put(point, f"{name}_is_corrected", corrected, "corrected estimator (1), or differences (0)")

    def _coordinates(self, bins: dict[str, CommonBins]) -> Entries:
        plan = self._work.plan
        coordinates: Entries = {}
        for one in plan.points.dimensions:
            for name, values in zip(one.parameters, one.values.T, strict=True):
                coordinates[name] = variable(one.name, values, *label_and_unit(plan.setting, name))
            if one.name not in coordinates:
                entry = "point" if one.name == POINT else f"entry of {', '.join(one.parameters)}"
                coordinates[one.name] = (one.name, np.arange(len(one)), {"long_name": f"number of the {entry}"})
        position = require_system(plan.setting.system).stick_position.unit
        if self._ends or plan.outputs:
            coordinates["quantile"] = variable("quantile", list(LEVELS), "share of values")
        for name, common in bins.items():
            low, high, bin_of = common.edges[:-1], common.edges[1:], f"{name}_bin"
            about = (_BY_NAME[name].label, _BY_NAME[name].unit or position)
            coordinates[bin_of] = variable(bin_of, (high + low) / 2, *about, comment="middle of the bin")
            coordinates[f"{bin_of}_low"] = variable(bin_of, low, *about, comment="lower edge of the bin")
            coordinates[f"{bin_of}_high"] = variable(bin_of, high, *about, comment="upper edge of the bin")
        if plan.keep != "totals":
            orders = np.arange(1, plan.numbering.orders + 1)
            coordinates["order"] = ("order", orders, {"long_name": "number of the stick"})
        return coordinates

    def _about(self) -> dict[str, Any]:
        plan = self._work.plan
        body = self._work.store.body  # the manifest in the folder, in which 1 may stand for the 1.0 of the plan
        return {
            "source": source()["source"],
            "format": body["format"],
            "format_version": body["format_version"],
            "manifest_sha256": sum_of(body),
            **{name: json.dumps(value) for name, value in body["objects"].items()},
            "t1": plan.t1,
            "keep": plan.keep,
            "dtype": plan.dtype,
            "batch": plan.batch,
            "common_random_numbers": int(not plan.independent),
            "histograms": f"at most {DEFAULT_BINS} bins, of whole numbers one for each number, the same for all "
            "points; entropies are of these histograms",
        }


def _put_histogram(variables: Variables, point: int, name: str, of: Distribution, common: CommonBins) -> None:
    own, unit = (f"{name}_bin",), "1" if of.unit == "1" else f"{of.unit}-1"
    entropy, counts = of.entropy(common), of.bins.in_bins(common)
    variables.estimate(point, f"{name}_entropy", entropy, f"entropy of the histogram of {of.name} in common bins")
    variables.put(point, f"{name}_count_in_bin", counts, f"number of values of {of.name}", dimensions=own)
    density = counts / max(of.number, 1) / np.diff(common.edges)
    variables.put(point, f"{name}_density", density, f"density of {of.name}", unit, dimensions=own)


def point_dimensions(dataset: "xarray.Dataset") -> tuple[Hashable, ...]:
    """The dimensions of the points of a sweep."""
    return dataset["samples"].dims


def statistics_of_points(dataset: "xarray.Dataset") -> list[str]:
    """The names of the variables with one value and one error at each point."""
    dimensions = point_dimensions(dataset)
    named = ((str(name), variable) for name, variable in dataset.data_vars.items())
    return [name for name, one in named if f"{name}_error" in dataset and one.dims == dimensions]


def shown_statistics(dataset: "xarray.Dataset") -> list[str]:
    """Of these the statistics of totals and derivatives, which are shown unless others are asked for; or all."""
    known = statistics_of_points(dataset)
    return [name for name in known if name in STATISTICS or name.startswith("d_")] or known


def write_dataset(store: Store, dataset: "xarray.Dataset") -> Path:
    """Write the data set to the folder of the sweep, as a whole. Raises SweepError if that fails."""
    path = store.folder / DATA
    try:
        packing = {name: {"zlib": True, "complevel": 1} for name in dataset.variables if dataset[name].size > 1024}
        write_whole(path, as_netcdf(dataset, packing))
    except OSError as error:
        raise cannot_write(store.folder, error) from error
    return path


def read_dataset(folder: Path) -> "xarray.Dataset":
    """The data set of a finished sweep. Raises SweepError if there is none, or a damaged one."""
    path = folder / DATA
    if not path.is_file():  # a named pipe would wait for ever
        raise SweepError(f"{folder} holds no finished sweep; run it, or resume it, first.")
    try:
        return verified(read_netcdf(path))
    except DamagedFileError as error:
        raise SweepError(f"{path} cannot be read ({error}); run the sweep again, which writes it anew.") from error


# --- reading a sweep without changing its folder, also while a run writes to it


class SweepStatus(NamedTuple):
    """How far a sweep has come.

    - `points`: their number. `complete`: the number of those that are done.
    - `samples`: how many have been simulated. `most_samples`: how many are wanted; where points end at a standard error
      (`is_adaptive`), the largest number.
    - `endings`: how many samples have each status. `seconds`: time spent simulating, summed over threads.
    - `is_running`: whether a run works on it now. `is_finished`: whether its data set is complete.
    - `seconds_left`: how long the run under way still needs at its present pace; None where that is not known.
    """

    points: int
    complete: int
    samples: int
    most_samples: int
    is_adaptive: bool
    endings: dict[Status, int]
    seconds: float
    is_running: bool
    is_finished: bool
    seconds_left: float | None


def status_of(folder: Path) -> SweepStatus:
    """The status of the sweep in `folder`. Raises SweepError if there is none."""
    store = Store.reading(folder)
    is_running, is_finished = store.is_in_use, _finished(store) is not None
    # Whether a point has the standard error that was asked for, only a plan that can be run can tell.
    plan = store.plan(to_run=bool(store.body["asked"]["standard_errors"]))
    endings, seconds = dict.fromkeys(Status, 0), 0.0
    work = Work(plan, store)
    for point in range(plan.points.number):
        for head in work.heads(point):
            seconds += head["run_seconds"]
            for status, count in zip(Status, head["status_counts"], strict=True):
                endings[status] += count
    for _ in work.tasks():  # counts what is done, after damaged batches were left out above
        pass
    points = plan.points.number
    complete, most = points if is_finished else work.complete, points * plan.samples
    how_far = (points, complete, sum(work.done), most, bool(plan.standard_errors))
    left = _seconds_left(folder, most - sum(work.done)) if is_running and not plan.standard_errors else None
    return SweepStatus(*how_far, endings, seconds, is_running, is_finished, left)


def _seconds_left(folder: Path, samples: int) -> float | None:
    """How long so many samples take at the pace since the last begin in the log; None before the first are done."""
    with contextlib.suppress(OSError, ValueError):
        lines = (folder / LOG).read_text(encoding="utf-8", errors="replace").splitlines()
        begun = max(at for at, line in enumerate(lines) if " begun: " in line)
        found = (re.search(r": samples (\d+) to (\d+) in ", line) for line in lines[begun:])
        done = sum(int(one[2]) - int(one[1]) + 1 for one in found if one)
        spent = datetime.now() - datetime.fromisoformat(lines[begun][:19])  # both without a zone
        return samples * spent.total_seconds() / done if done else None
    return None


def stored_dataset(folder: Path) -> "xarray.Dataset":
    """The result of the sweep in `folder`, as far as it is stored.

    Raises SweepError if there is none, or one of classes of your own that is not finished.
    """
    require_packages()
    store = Store.reading(folder)
    finished = _finished(store)
    return Results(Work(store.plan(), store)).dataset() if finished is None else finished


def _finished(store: Store) -> "xarray.Dataset | None":
    """The stored data set, if it is the result of what the manifest asks for."""
    try:
        found = read_dataset(store.folder)
    except (SweepError, OSError, ValueError):  # none, or a damaged one, which the batches replace
        return None
    return found if found.attrs.get("manifest_sha256") == sum_of(store.body) else None
