"""The tasks of a sweep that are left and the batches that are there, put together as one labelled data set."""

import contextlib
import json
import pickle
import weakref
from collections.abc import Hashable, Iterator
from pathlib import Path
from tempfile import SpooledTemporaryFile, gettempdir
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from .._ensemble.dataset import DamagedFileError, as_netcdf, read_netcdf, verified
from .._ensemble.result import Ensemble
from .._foundation.extras import require
from .._foundation.files import write_whole
from .._foundation.types import Status
from .._numerics.sums import CommonBins
from .._statistics.distribution import DEFAULT_BINS, Distribution, default_bins
from .._statistics.estimate import Estimate
from .._statistics.quantities import BY_NAME as STICK_BY_NAME
from .._statistics.quantities import DISTRIBUTIONS, SampledQuantity
from .._statistics.totals import DIFFERENTIABLE, STATISTICS
from .._systems.system import require_system
from .batches import Derivatives, Head, derivatives_of, head_of, joined, packed, unfinished_in, unpacked
from .manifest import Manifest, sum_of
from .plan import POINT, DamagedBatchError, Plan, SweepError, Task, label_and_unit
from .store import DATA, Batch, Store, cannot_write, derivative_name

if TYPE_CHECKING:
    import xarray


# The tasks of a sweep that are left, and the batches that are there.


_IN_MEMORY = 2**26  # bytes of what has been read; what is more goes to a temporary file
_LISTINGS = 5  # of the folder at most, where a run that is under way has joined batches since the last


class Work:
    """The tasks of a sweep that are left, in order of the points.

    `done`: the samples of each point that are there. `failed`: what went wrong, by point. `without_memory`: tasks for
    which there was no memory, and the error; a later run does them. `complete`: points with nothing left to do.
    `damaged`: batches that could not be read, and were removed.
    """

    def __init__(self, plan: Plan, store: Store):
        self.plan, self.store = plan, store
        self.done = [0] * plan.points.number
        self.failed: dict[int, str] = {}
        self.without_memory: dict[Task, str] = {}
        self.complete = self.damaged = 0
        self._identities = [plan.points.identity(point) for point in range(plan.points.number)]
        self._batches = store.batches()
        self._left: dict[int, int] = {}  # tasks of a point that are not done
        # A run may join batches while they are read here: what was read once is kept, so that it stays the same.
        self._cache = None if self.store.can_write else ReadCache()

    def _batches_at(self, point: int) -> list[Batch]:
        """The batches of a point that are there."""
        return self._batches.get(self._identities[point], [])

    def _of_samples(self, point: int) -> list[Batch]:
        """The batches of samples of a point, without those of derivatives."""
        return [batch for batch in self._batches_at(point) if not batch.derivative]

    def _batch_of(self, task: Task) -> Batch:
        """The file for the result of a task."""
        return self.store.batch_of(self._identities[task.point], task, self.plan)

    def tasks(self) -> Iterator[Task]:
        """What is left to do. With wanted standard errors, the next batch of each point that misses them."""
        for point in range(self.plan.points.number):
            tasks = self._tasks_at(point)
            self._left[point] = len(tasks)
            if not tasks:
                self.complete += 1
                self._join(point)  # an earlier run may have been stopped before
            yield from tasks

    def _tasks_at(self, point: int) -> list[Task]:
        self.done[point] = sum(batch.end - batch.first for batch in self._of_samples(point))
        tasks = self._missing(point)
        there = {(batch.derivative, batch.end) for batch in self._batches_at(point)}
        for number in range(len(self.plan.derivatives)):
            if (derivative_name(self.plan, number), self.plan.samples) not in there:
                tasks.append(Task(point, 0, self.plan.samples, number))
        return tasks

    def _missing(self, point: int) -> list[Task]:
        """The tasks for samples of a point that are not there; with wanted standard errors, the first of them."""
        gaps, at = [], 0
        for batch in self._of_samples(point):
            gaps += self._tasks_between(point, at, batch.first)
            at = batch.end
        gaps += self._tasks_between(point, at, self.plan.samples)
        if self.plan.is_adaptive and gaps:
            return [] if self._is_precise(point) else gaps[:1]
        return gaps

    def _tasks_between(self, point: int, first: int, end: int) -> list[Task]:
        """The tasks of samples ``first .. end - 1``, which end at multiples of the size of a batch."""
        size = self.plan.batch
        ends = range((first // size + 1) * size, end + size, size) if first < end else ()
        return [Task(point, max(first, after - size), min(after, end)) for after in ends]

    def finish(self, task: Task, data: bytes | None) -> list[Task]:
        """Store the result of a task (None: the worker has stored it); returns the tasks that follow from it."""
        batch = self._batch_of(task)
        if data is not None:
            self.store.write(batch.path, data)
        batches = self._batches.setdefault(self._identities[task.point], [])
        batches.append(batch)
        batches.sort(key=lambda batch: (batch.derivative, batch.first))
        try:
            self._check(task, self.store.read(batch) if data is None else data)
        except DamagedBatchError as error:
            self._remove(task.point, batch, str(error))
            return []
        self._left[task.point] -= 1
        more = []
        if task.derivative is None:
            self.done[task.point] += task.samples
            more = self._missing(task.point) if self.plan.is_adaptive else []
            self._left[task.point] += len(more)
        if not self._left[task.point]:
            self.complete += 1
            self._join(task.point)
        return more

    def _check(self, task: Task, data: bytes) -> None:
        """Log the samples of a result that did not finish. Raises DamagedBatchError for the result of another task."""
        if task.derivative is not None:
            derivatives_of(data, task.end)
            return
        head = head_of(data, task.first, task.end)
        unfinished = ", ".join(f"{count} {status.name}" for status, count in unfinished_in(head).items())
        if unfinished:
            samples = f"samples {task.first} to {task.end - 1}"
            self.store.log(f"not to the end {self.plan.points.described(task.point)}: {samples}: {unfinished}")

    def _is_precise(self, point: int) -> bool:
        """Whether the standard errors of a point are as small as wanted."""
        ensemble = self.ensemble(point)
        if ensemble is None:
            return False
        wanted = self.plan.standard_errors.items()
        return all(STATISTICS[name](ensemble).standard_error <= most for name, most in wanted)  # NaN: not yet

    def ensemble(self, point: int) -> Ensemble | None:
        """The samples of a point from the first on that are there without a gap; None if there is none.

        Samples after a damaged batch are left out; the batch is removed, unless the store is only read. A program that
        only reads gets the same samples every time, also while a run adds batches.
        """
        found, fields = [], self.plan.fields_at(point)
        for batch, data in self._without_gap(point):
            try:
                found.append(unpacked(data, fields, batch.first, batch.end))
            except DamagedBatchError as error:
                self._remove(point, batch, str(error))
                break
        return joined(found) if len(found) > 1 else found[0] if found else None

    def _without_gap(self, point: int) -> list[tuple[Batch, bytes]]:
        """The batches of samples of a point from the first on that are there without a gap."""
        found = None if self._cache is None else self._cache.get(point)
        if found is None:
            found = self._read(point, is_gap_allowed=False)
            if self._cache is not None:
                self._cache.put(point, found)
        return found

    def heads(self, point: int) -> list[Head]:
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

    def derivatives(self, point: int) -> dict[str, Derivatives]:
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
        joint = self._batch_of(Task(point, 0, whole.samples))
        self.store.write(joint.path, packed(whole))
        others = [batch for batch in self._batches_at(point) if batch.derivative]
        self._batches[self._identities[point]] = [joint, *others]
        for batch in batches:
            with contextlib.suppress(OSError):  # what is left is not used, and removed at the end
                batch.path.unlink()

    def remove_leftovers(self) -> None:
        """Remove batches whose samples are in a longer one too. For when all of those have been read."""
        self.store.remove_leftovers(self._identities)

    @contextlib.contextmanager
    def _damage_removed(self, point: int, batch: Batch) -> Iterator[None]:
        """Remove a batch in which the block finds damage."""
        try:
            yield
        except DamagedBatchError as error:
            self._remove(point, batch, str(error))

    def _remove(self, point: int, batch: Batch, reason: str) -> None:
        with contextlib.suppress(ValueError):  # the folder was listed again since it was read
            self._batches_at(point).remove(batch)
        self.damaged += 1
        if self.store.can_write:
            self.store.remove(batch, reason)


class ReadCache:
    """The batches of points, with their bytes, as they were when they were read first."""

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, self._file.close)
        self._starts: dict[int, int] = {}

    def put(self, point: int, batches: list[tuple[Batch, bytes]]) -> None:
        """Keep what was read of a point. Raises SweepError where there is no room for it."""
        try:
            start = self._file.seek(0, 2)
            pickle.dump(batches, self._file)
        except OSError as error:
            raise SweepError(
                f"{gettempdir()} cannot be written ({error.strerror}), where the batches of a large sweep are kept "
                "while it is read; make room there, or name another folder in the environment variable TMPDIR."
            ) from error
        self._starts[point] = start

    def get(self, point: int) -> list[tuple[Batch, bytes]] | None:
        """What was read of a point; None if nothing was."""
        if point not in self._starts:
            return None
        self._file.seek(self._starts[point])
        return pickle.load(self._file)


# The result of a sweep as one labelled data set.


LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)  # of quantiles
_Variable: TypeAlias = tuple[str | tuple[str, ...], np.ndarray | list[float], dict[str, str]]
"""Dimensions, values and attributes, as xarray takes them."""
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

    def entries(self) -> Iterator[tuple[str, _Variable]]:
        """Names and entries, as xarray takes them."""
        own = tuple(one.name for one in self._points.dimensions)
        for name, (dimensions, array, attributes) in self._found.items():
            values = array.reshape(*self._points.shape, *array.shape[1:])
            yield name, ((*own, *dimensions), values, attributes)


def require_packages() -> None:
    """Raises ImportError where what a sweep is stored with is not installed."""
    require("Sweeps need", "study", "xarray", "h5netcdf", "h5py", "filelock")


def dataset_of(work: Work) -> "xarray.Dataset":
    """All stored results. Points are read twice, one at a time: first for the bins, which all points share."""
    import xarray as xr  # noqa: PLC0415 - an extra, loaded when asked for

    plan, variables = work.plan, Variables(work.plan)
    bins = _common_bins(work)
    for point in range(plan.points.number):
        ensemble = work.ensemble(point)
        _put_counts(variables, point, ensemble)
        if ensemble is not None:
            _put_statistics(variables, point, ensemble, plan, bins)
        _put_derivatives(variables, point, work)
    coordinates = {**_point_coordinates(plan), **_bin_coordinates(plan, bins)}
    return xr.Dataset(dict(variables.entries()), coordinates, _attributes(plan, work.store.body))


def _common_bins(work: Work) -> dict[str, CommonBins]:
    """The bins that the histograms of each quantity share over all points."""
    plan, held = work.plan, {}
    names = [name for name in plan.statistics if name in _BY_NAME]
    for point in range(plan.points.number) if names and plan.keep != "totals" else ():
        ensemble = work.ensemble(point)
        if ensemble is None:
            continue
        for name in names:
            counts = getattr(ensemble.statistics, name).bins
            ends = counts._replace(counts=counts.counts[..., :0])  # the ends of the histogram without its numbers
            held.setdefault(name, []).append(ends)
    found = {name: CommonBins.of(ends, default_bins(_BY_NAME[name].is_whole)) for name, ends in held.items()}
    return {name: bins for name, bins in found.items() if bins is not None}


def _put_counts(variables: Variables, point: int, ensemble: Ensemble | None) -> None:
    variables.put(point, "samples", 0 if ensemble is None else ensemble.samples, "number of samples")
    for status in Status:
        count = 0 if ensemble is None else ensemble.status_counts[status]
        variables.put(point, f"samples_{status.name.lower()}", count, f"number of samples with status {status.name}")
    near = 0 if ensemble is None else ensemble.near_grazing_samples
    variables.put(point, "samples_near_grazing", near, "number of samples with an event decided by round-off")
    spent = np.nan if ensemble is None else ensemble.run_seconds
    variables.put(point, "run_seconds", spent, "time spent simulating, summed over threads", "s")


def _put_statistics(
    variables: Variables, point: int, ensemble: Ensemble, plan: Plan, bins: dict[str, CommonBins]
) -> None:  # fmt: skip
    for name in plan.statistics:
        if name in STATISTICS:
            variables.estimate(point, name, STATISTICS[name](ensemble))
        if name in bins:
            _put_distribution(variables, point, name, ensemble, bins[name])
    for name, of in ensemble.outputs.items():
        _put_output(variables, point, name, of)
    if plan.keep != "totals":
        _put_orders(variables, point, ensemble)
        if plan.realizations:
            _put_realizations(variables, point, ensemble, plan.realizations)


def _put_distribution(variables: Variables, point: int, name: str, ensemble: Ensemble, bins: CommonBins) -> None:
    of = getattr(ensemble.statistics, name)
    label, unit, dimension = of.name, of.unit, f"{name}_bin"
    variables.estimate(point, f"{name}_mean", of.mean, f"mean of {label}")
    variables.estimate(point, f"{name}_standard_deviation", of.standard_deviation)
    variables.estimate(point, f"{name}_skewness", of.skewness)
    quantiles = [float(of.quantile(level).value) for level in LEVELS]
    variables.put(point, f"{name}_quantile", quantiles, f"quantile of {label}", unit, dimensions=("quantile",))
    entropy, histogram = of.entropy(bins), of.histogram(bins)
    variables.estimate(point, f"{name}_entropy", entropy, f"entropy of the histogram of {label} in common bins")
    per = "1" if unit == "1" else f"{unit}-1"
    variables.put(
        point, f"{name}_count_in_bin", histogram.counts, f"number of values of {label}", dimensions=(dimension,)
    )
    variables.put(point, f"{name}_density", histogram.density, f"density of {label}", per, dimensions=(dimension,))


def _put_output(variables: Variables, point: int, name: str, of: Distribution) -> None:
    """Mean, spread and quantiles of an output of a user's own, and of how many samples."""
    variables.estimate(point, f"{name}_mean", of.mean, f"mean of {name}")
    variables.estimate(point, f"{name}_standard_deviation", of.standard_deviation)
    quantiles = [float(of.quantile(level).value) for level in LEVELS]
    variables.put(point, f"{name}_quantile", quantiles, f"quantile of {name}", of.unit, dimensions=("quantile",))
    variables.put(point, f"{name}_values", of.number, f"number of samples with a value of {name}")


def _put_orders(variables: Variables, point: int, ensemble: Ensemble) -> None:
    orders = [ensemble.statistics.order(number) for number in range(1, ensemble.numbering.orders + 1)]
    shares = [float(one.share.value) for one in orders]
    variables.put(point, "share_with_order", shares, "share of samples that have the stick", dimensions=("order",))
    for name in orders[0].distributions:
        means = [one.distributions[name].mean for one in orders]
        label = f"mean {STICK_BY_NAME[name].label} by order"
        values, errors = ([float(getattr(mean, part)) for mean in means] for part in ("value", "standard_error"))
        unit = means[0].unit
        for put, entry, text in ((values, "", label), (errors, "_error", f"standard error of {label}")):
            variables.put(point, f"{name}_of_order{entry}", put, text, unit, dimensions=("order",))


def _put_realizations(variables: Variables, point: int, ensemble: Ensemble, number: int) -> None:
    """Times of the sticks of the first samples that finished, for figures; NaN beyond the last that is held."""
    sticks, held = ensemble.finished_sticks(), 256
    for name in ("start", "end"):
        times = np.full((number, held), np.nan)
        for sample in range(min(number, len(sticks.count))):
            own = getattr(sticks, name)[sticks.first[sample] :][: sticks.count[sample]][:held]
            times[sample, : len(own)] = own
        label = f"{name} of the first {held} sticks of some samples"
        variables.put(point, f"stick_{name}", times, label, "s", dimensions=("realization", "stick"))


def _put_derivatives(variables: Variables, point: int, work: Work) -> None:
    plan, found = work.plan, work.derivatives(point)
    for number, (statistic, _) in enumerate(plan.derivatives):
        result = found.get(derivative_name(plan, number))
        for wrt, numbers in (result["by"] if result else {}).items():
            name, unit = f"d_{statistic}_by_{wrt}", _unit_of_derivative(plan, statistic, wrt)
            variables.put(point, name, numbers["derivative"], f"derivative of {statistic} by {wrt}", unit)
            variables.put(point, f"{name}_error", numbers["standard_error"], f"standard error of {name}", unit)
            corrected = int(numbers["estimator"] == "corrected")
            variables.put(point, f"{name}_is_corrected", corrected, "corrected estimator (1), or differences (0)")


def _unit_of_derivative(plan: Plan, statistic: str, wrt: str) -> str:
    """Such as "s (1/s)-1", of a duration by a rate."""
    of = next(one.unit for one in DIFFERENTIABLE if one.name == statistic)
    _, by = label_and_unit(plan.setting, wrt)
    return of if by == "1" else f"{of} ({by})-1"


def _point_coordinates(plan: Plan) -> dict[str, _Variable]:
    """The coordinates of the points."""
    found: dict[str, _Variable] = {}
    for one in plan.points.dimensions:
        for name, values in zip(one.parameters, one.values.T, strict=True):
            label, unit = label_and_unit(plan.setting, name)
            found[name] = (one.name, values, {"long_name": label, "units": unit})
        if one.name not in found:
            entry = "point" if one.name == POINT else f"entry of {', '.join(one.parameters)}"
            found[one.name] = (one.name, np.arange(len(one)), {"long_name": f"number of the {entry}"})
    return found


def _bin_coordinates(plan: Plan, bins: dict[str, CommonBins]) -> dict[str, _Variable]:
    found: dict[str, _Variable] = {}
    position = require_system(plan.setting.system).stick_position.unit
    if bins or plan.outputs:
        found["quantile"] = ("quantile", list(LEVELS), {"long_name": "share of values", "units": "1"})
    for name, common in bins.items():
        edges = common.edges
        about = {"long_name": _BY_NAME[name].label, "units": _BY_NAME[name].unit or position}
        found[f"{name}_bin"] = (f"{name}_bin", (edges[1:] + edges[:-1]) / 2, {**about, "comment": "middle of the bin"})
        found[f"{name}_bin_low"] = (f"{name}_bin", edges[:-1], {**about, "comment": "lower edge of the bin"})
        found[f"{name}_bin_high"] = (f"{name}_bin", edges[1:], {**about, "comment": "upper edge of the bin"})
    if plan.keep != "totals":
        found["order"] = ("order", np.arange(1, plan.numbering.orders + 1), {"long_name": "number of the stick"})
    return found


def _attributes(plan: Plan, body: Manifest) -> dict[str, object]:
    """Attributes of the data set; `body`: the manifest in the folder, in which 1 may stand for the 1.0 of the plan."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    return {
        "Conventions": "CF-1.11",
        "source": f"stickslip_jax {__version__}",
        "format": body["format"],
        "format_version": body["format_version"],
        "manifest_sha256": sum_of(body),
        **{name: json.dumps(value) for name, value in body["objects"].items()},
        "t1": plan.t1,
        "keep": plan.keep,
        "dtype": plan.dtype,
        "batch": plan.batch,
        "common_random_numbers": int(not plan.independent),
        "histograms": f"at most {DEFAULT_BINS} bins, of whole numbers one for each number, the same for all points; "
        "entropies are of these histograms",
    }


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
    return SweepStatus(
        points, points if is_finished else work.complete, sum(work.done), points * plan.samples, plan.is_adaptive,
        endings, seconds, is_running, is_finished,
    )  # fmt: skip


def stored_dataset(folder: Path) -> "xarray.Dataset":
    """The result of the sweep in `folder`, as far as it is stored.

    Raises SweepError if there is none, or one of classes of your own that is not finished.
    """
    require_packages()
    store = Store.reading(folder)
    finished = _finished(store)
    return dataset_of(Work(store.plan(), store)) if finished is None else finished


def _finished(store: Store) -> "xarray.Dataset | None":
    """The stored data set, if it is the result of what the manifest asks for."""
    try:
        found = read_dataset(store.folder)
    except (SweepError, OSError, ValueError):  # none, or a damaged one, which the batches replace
        return None
    return found if found.attrs.get("manifest_sha256") == sum_of(store.body) else None
