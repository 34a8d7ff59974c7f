"""`Ensemble`, the result of many samples, and what makes one: `simulate_ensemble`, `simulate_contacts`, `concatenate`,
`load`.
"""

import dataclasses
import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.simulate import Output, Outputs, checked_outputs
from .._dynamics.simulation import Simulation
from .._dynamics.sticks import Slips, Sticks, in_slots, shown_counts, stick_columns, time_columns
from .._excitation.excitation import BaseMotion, is_random
from .._foundation import checks, html
from .._foundation.extras import require
from .._foundation.fields import in_one_line
from .._foundation.files import file_for_user, file_to_write, write_table
from .._foundation.types import InitialState, Status
from .._numerics.sums import DyadicCounts, Moments, PowerSums
from .._statistics.distribution import BINS, Clusters, Distribution
from .._statistics.ensemble_statistics import EnsembleStatistics, Summary, shown, table_of
from .._statistics.estimate import origin_of
from .._statistics.quantities import Numbering
from .._statistics.totals import STATISTICS, TOTALS
from .._systems.system import System, WithContacts
from .._uncertainty.design import Design
from .._uncertainty.inputs import GaussianCopula, StochasticModel
from . import conversions, data
from .data import EnsembleAccumulator, EnsembleData, Fields, GivenMotions, Keep, Origin, Unknown, UnknownSystem
from .encoding import as_netcdf
from .setup import MOST_SAMPLES, NO_OUTPUTS, TAKEN, EnsembleSetup, fields_of_outputs, found_by, found_here, outputs_of

if TYPE_CHECKING:
    import xarray


# `Ensemble`, the result of many samples: sums for the statistics and, if kept, every stick of every sample.


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class Ensemble(EnsembleData):
    """Many samples: the result of `simulate_ensemble`, of `load` and `concatenate`, and of the methods ``from_...``.

    - `system`, `law`, `t1` (s), `y0` (m, m/s), `samples`, `key_data`, `dtype`: the arguments and the floating dtype.
    - `design`, `copula`: the design and the correlations by which numbers were drawn, None if none were given.
      `input_values` gives the numbers that differ from sample to sample.
    - `method`: the simulation method; a `Regularized` method has its options filled in. None of measured sticks.
    - `numbering`: which stick of a sample is the 1st, 2nd, ...
    - `moments`: number of finished samples, mean and covariance of their `TOTALS` (stick time in s, number of sticks,
      number of slips).
    - `near_grazing_samples`: number of samples in which round-off decided whether there was an event (see
      `Simulation`); the statistics include them. Where the motion is known in closed form: in which a stick would have
      begun and ended at once, or the start was at an edge of the stick band; `simulate` under ``vmap`` counts the rest.
    - `status_counts`: number of samples that ended with each `Status`; only those FINISHED count in the statistics.
    - `sticks`: every stick, arrays (samples, slots), if ``keep="sticks"``.
    - `totals`: of each sample, if ``keep="totals"`` or "sticks": `stick_time` (s), `sticks`, `slips`, `status` and
      `near_grazing_count`, arrays (samples,). `sample_totals`: the same, None if they were not kept.
    - `flat_sticks`: the same sticks one after the other, without padding; None unless ``keep="sticks"``.
    - `accumulator`: sums and histograms of the sticks, which `statistics` reads. `retained`: sticks of the first
      finished samples (of all, if kept), from which standard errors are computed. Both None if ``keep="totals"``.
    - `output_values`: of the functions in ``simulate_ensemble(..., outputs=...)``, arrays (samples,) by name, NaN for
      samples that did not finish; `outputs` their distributions. `output_units`, `output_functions`: as they were given
      (functions are not stored in files).
    - `first_sample`: the number of its first sample in the sequence that the key draws. `origins`: where each part of a
      joined ensemble comes from (see `concatenate`), else empty.
    - `keep`: "totals", "statistics" or "sticks".
    - `threads`: number of worker threads used. `compile_seconds`, `run_seconds`: time spent, s.
    """

    @classmethod
    def from_simulations(cls, result: Simulation, *, orders: int = 10, count_initial_rest: bool = False) -> "Ensemble":
        """The ensemble of the trajectories that ``jax.vmap(lambda ...: simulate(...))(...)`` returned.

        It keeps every stick, so that all statistics, tests and figures work on it. Numbers of the system that differ
        among the samples are arrays (samples,). ``realization(i)`` returns the base motion that sample i was given, and
        the state at t = 0, to the last digit or two.

        Args:
            result: A `Simulation` whose arrays have one leading axis, of samples. All must have the same ``t1``.
            orders: Statistics are made of the 1st, 2nd, ... up to this stick of a sample, at most the 1000th.
            count_initial_rest: Whether a stick that begins at t = 0, from a start at rest, counts as the 1st.

        Raises:
            ValueError: For anything else.
        """
        return cls(**conversions.fields_of_simulations(result, Numbering.checked(orders, count_initial_rest)))

    @classmethod
    def from_sticks(
        cls, table: object, *, t1: float, samples: int | None = None, position_unit: str | None = None,
        period: float | None = None, orders: int = 10, count_initial_rest: bool = False,
    ) -> "Ensemble":  # fmt: skip
        """The ensemble of sticks that were measured, or simulated elsewhere: one recording of ``[0, t1]`` each sample.

        Slips are what lies between the sticks. What needs a position that was not measured, a system or a base motion
        raises ValueError and says so.

        Args:
            table: A pandas DataFrame, or a dict of arrays (sticks,), in any order, with these columns:

                - `sample`: which recording, whole numbers from 0 or 1, or names;
                - `start`, and `end` or `duration`: s, from the beginning of the recording; both must agree if both are
                  there;
                - `position` of the mass at the start of the stick, `slip_displacement` (as in `Sticks`) and `ending`
                  (an `Ending` or its name), each if known.

                Without `ending`, a stick that ends at `t1` is cut by the end of the recording (HORIZON) and all others
                count as RELEASED. Names may end in a unit as `write_sticks` writes them (start_s, position_m), whose
                files can be read back.
            t1: Duration of each recording, s.
            samples: Number of recordings; needed where some of them have no stick, which a table cannot show. Their
                numbers are then from 0 to ``samples - 1``. By default those in the table, which must be numbered
                without gap.
            position_unit: Such as "mm"; by default that in the column's name, else "m".
            period: Of positions that are angles, which become those in ``[0, period)``.
            orders: Statistics are made of the 1st, 2nd, ... up to this stick of a sample, at most the 1000th.
            count_initial_rest: Whether a stick that begins at t = 0, from a start at rest, counts as the 1st.

        Raises:
            ValueError: For a table that lacks a column or has sticks that overlap, lie outside ``[0, t1]`` or have no
                length.
        """
        numbering = Numbering.checked(orders, count_initial_rest)
        return cls(**conversions.fields_of_sticks(table, t1, samples, position_unit, period, numbering))

    @classmethod
    def from_xarray(cls, dataset: "xarray.Dataset") -> "Ensemble":
        """The ensemble that `to_xarray` made the data set of; see `load`.

        Raises:
            ValueError: For a data set that holds no ensemble, one that was changed, and one of a newer format.
        """
        return cls(**conversions.fields_of_dataset(dataset))

    def extended(
        self, *, samples: int, threads: int | None = None, chunk: int | None = None, progress: bool | None = None
    ) -> "Ensemble":
        """This ensemble and `samples` more of it, simulated now: the same samples as of one longer run.

        Sticks, totals, counts and histograms are those of one run of all samples, to the last bit. Means and higher
        moments are too if both runs divide the samples alike (a `chunk` that divides the number of the first samples is
        given to both); else they are merged in other parts, and differ by round-off: relatively by at most a few times
        2^-53 times the number of parts.

        Args:
            samples: How many more.
            threads: Worker threads (default: all cores; on another device than a CPU one).
            chunk: Samples simulated per call (default: chosen for speed).
            progress: True shows a progress bar, False none; by default on a terminal and in a notebook.

        Raises:
            ValueError: For an ensemble that was not simulated by `simulate_ensemble`, or that was joined.
        """
        checks.require_threads_of_jax()
        self._check_extendable()
        first = self.first_sample + self.samples
        samples = checks.whole_number("samples", samples, maximum=MOST_SAMPLES - first)
        model = StochasticModel(self.system, self.law, self.y0)
        assert isinstance(self.method, (Exact, Regularized))  # `_check_extendable` saw to it
        options = (self.copula, self.method, self.keep, self.numbering)
        outputs = outputs_of(self)
        setup = EnsembleSetup.checked(model, self.t1, samples, first, self._key, *options)
        accumulator = EnsembleAccumulator(self.samples + samples, self.keep)
        accumulator.add_ensemble(self)
        (found,) = found_by(setup, first, (accumulator,), threads, chunk, progress, outputs)
        for name in ("compile_seconds", "run_seconds"):
            found[name] += getattr(self, name)
        return dataclasses.replace(self, samples=self.samples + samples, **found)

    def between(self, begin: float, end: float | None = None) -> "Ensemble":
        """What happens from `begin` to `end`, as if it had been simulated alone: times count from `begin`.

        A stick that lasts beyond `end` is cut by it, and one under way at `begin` begins at t = 0, at the position it
        really began at; as a start at rest it counts in the number of sticks and the stick fraction only, unless
        ``count_initial_rest``. For the last period of a base with one: ``many.between(many.t1 - period)``.

        Args:
            begin: s, zero or positive.
            end: s, at most ``t1``, by default that.

        Raises:
            ValueError: For times outside these bounds, and unless ``keep="sticks"``.
        """
        return Ensemble(**conversions.fields_between(self, begin, self.t1 if end is None else end))

    @cached_property
    def input_values(self) -> dict[str, np.ndarray]:
        """The values of the numbers that differ from sample to sample, by name, arrays (samples,).

        Raises:
            ValueError: For an ensemble that was joined from parts with different ones, or that holds objects which were
                stored as text only.
        """
        parts = self._parts
        for part in parts:
            part._require_whole()
            data.require_known("system", part.system)
        if len({part.inputs.names for part in parts}) > 1:
            raise ValueError(
                f"This ensemble was joined from {len(parts)} parts in which different numbers differ from sample to "
                "sample; ask each part."
            )
        return self._values_by_name()

    @cached_property
    def statistics(self) -> EnsembleStatistics:
        """All statistics of the sticks and slips. Raises ValueError if ``keep="totals"``."""
        sticks = self.finished_sticks()  # refuses an ensemble that has none
        assert self.retained is not None
        assert self.accumulator is not None
        position = self.system.stick_position.unit
        return EnsembleStatistics(
            self.accumulator, sticks, self.retained.totals, self.t1, position, self.numbering, origin_of(self)
        )

    @cached_property
    def outputs(self) -> dict[str, Distribution]:
        """The distribution of each output over the finished samples, by name: mean, quantiles, histogram and so on.

        Values that are not finite are left out: ``many.outputs["peak"].number`` is that of the others.
        """
        found, finished = {}, self.finished
        for name, column in self.output_values.items():
            values = column[np.isfinite(column)]
            is_whole = len(values) > 0 and bool(np.all(values == np.round(values)) and np.all(np.abs(values) < 2**31))
            bins = DyadicCounts.of(values, BINS, finest=0) if is_whole else DyadicCounts.of(values, BINS)
            clusters = Clusters(values, np.arange(len(values)), finished, finished)
            unit = self.output_units.get(name, "1")
            found[name] = Distribution(
                name, unit, finished, PowerSums.of(values), bins, clusters, is_whole=is_whole, origin=origin_of(self)
            )
        return found

    def _warnings(self) -> list[tuple[str, str]]:
        """What a reader must know of samples that did not finish, or have no value of an output: what, and how many."""
        valued = {name: int(np.count_nonzero(np.isfinite(column))) for name, column in self.output_values.items()}
        missing = {name: self.finished - number for name, number in valued.items() if number < self.finished}
        found = [(f"NO VALUE of {name}", f"in {count:,} finished samples") for name, count in missing.items()]
        for status, count in self._unfinished.items():
            found.append(("NOT FINISHED:", f"{count:,} samples, because {status.meaning}; they are in no statistic"))
        if self.near_grazing_samples:
            count = self.near_grazing_samples
            found.append(("near-grazing:", f"{count:,} samples, in which round-off decided if there was an event"))
        return found

    def summary(self) -> Summary:
        """The statistics as a readable table, for text and notebooks. Raises ValueError if ``keep="totals"``."""
        statistics, notes = self.statistics, []
        begins_at_zero = statistics.sticks.begins_at_zero.any()
        if statistics.duration.number:
            shares = ", ".join(f"{shown(share)} {ending.name}" for ending, share in statistics.endings.items())
            notes.append(f"Share of sticks by ending: {shares}.")
        else:
            notes.append(f"There is no stick{' but those that begin at t = 0' if begins_at_zero else ''}.")
        notes.append(
            "Sticks and slips cut by the end (HORIZON) count with the part before it. Entropies are those of "
            "histograms with 50 bins, or with one bin for each whole number."
        )
        if begins_at_zero and not statistics.numbering.count_initial_rest:
            notes.append(
                "Sticks that begin at t = 0 count in the number of sticks and the stick fraction only; the 1st is the "
                "next (count_initial_rest)."
            )
        retained = len(statistics.totals)
        if retained < statistics.samples:
            notes.append(f"Standard errors were measured on the first {retained:,} samples.")
        notes += [f"{what} {text}." for what, text in self._warnings()]
        summary = statistics._summary
        outputs = [table_of("Outputs", list(self.outputs.values()))] if self.outputs else []
        return dataclasses.replace(summary, tables=(*summary.tables, *outputs), notes=tuple(notes))

    @cached_property
    def sticks(self) -> Sticks:
        """Every stick of every sample, arrays (samples, slots). Raises ValueError unless ``keep="sticks"``."""
        return self.require_sticks().padded()

    @cached_property
    def slips(self) -> Slips:
        """Every slip of every sample that finished, arrays (samples, slots).

        Raises:
            ValueError: Unless ``keep="sticks"``.
        """
        slips = self._flat_slips()
        columns = {"start": (slips.start, np.nan), "end": (slips.end, np.nan), "censored": (slips.censored, False)}
        mask, filled = in_slots(np.bincount(slips.sample, minlength=self.samples), columns)
        return Slips(**filled, mask=mask)

    def realization(self, number: int) -> data.Realization:
        """The system, the base motion and the initial state of sample `number`, with which `simulate` repeats it::

            system, base, y0 = many.realization(3)

        Raises:
            ValueError: Unless ``0 <= number < samples``, and for an ensemble that does not know its base motion.
        """
        checks.require_threads_of_jax()
        if checks.whole_number("number", number, minimum=0) >= self.samples:
            raise checks.refused("number", f"be below the {self.samples} samples", number)
        ends = np.cumsum([part.samples for part in self._parts])
        which = int(np.searchsorted(ends, number, side="right"))
        part = self._parts[which]
        number += part.first_sample + part.samples - int(ends[which])
        part._require_whole()
        if isinstance(part.law, GivenMotions):
            samples = part.samples

            def own(leaf):
                return data.single(leaf[number]) if np.ndim(leaf) == 1 and len(leaf) == samples else leaf

            y0 = tuple(float(np.asarray(value)[number] if np.ndim(value) else value) for value in part.y0)
            return data.Realization(jax.tree.map(own, part.system), part.law.base(number), y0)

        if part.key_data is not None:
            self._check_dtype()
        system, law, y0 = part.inputs.of_sample(number, jnp.dtype(self.dtype))
        base = part.inputs.realization_of(number, law, self.t1) if is_random(law) else law
        return data.Realization(system, base, y0)

    def to_xarray(self) -> "xarray.Dataset":
        """The ensemble as an ``xarray.Dataset`` with units and long names, from which `from_xarray` makes it again.

        With ``keep="sticks"``: sticks as CF contiguous ragged arrays along ``stick`` (``stick_count`` is the number of
        sticks of each sample, ``stick_sample`` the sample of each stick, ``stick_order`` its number in the sample by
        `numbering`), slips along ``slip``, and the totals of each sample. With "statistics": the sticks of the first
        samples that finished. The attributes say what was simulated and how; ``ensemble_state...`` hold the sums of all
        samples.

        Raises:
            ImportError: Without the extra ``study``.
        """
        return conversions.dataset_of(self)

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the ensemble to a NetCDF 4 file, from which `load` makes it again.

        The file is written under another name, ``path`` and ".....unfinished", and gets its own when it is whole: an
        older file stays as it was until then, and if writing fails. It holds a check sum over all that is in it.

        Args:
            path: A file name that ends in .nc.
            overwrite: Whether to replace a file of that name.

        Returns:
            The path.

        Raises:
            ValueError: For another name.
            FileExistsError: Where a file of that name would be replaced.
            FileNotFoundError: For a folder that does not exist.
            OSError: Where it cannot be written.
            ImportError: Without the extra ``study``.
        """
        path = file_to_write(path, (".nc",), overwrite=overwrite)
        dataset = self.to_xarray()
        require("Files of ensembles need", "study", "xarray", "h5netcdf")
        content = as_netcdf(dataset, conversions.compression(dataset))
        with file_for_user(path) as file:
            file.write(content)
        return path

    def write_sticks(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write all sticks as a table, one row each: sample, order, start, end, duration, position and ending.

        `order` is the number of the stick in its sample, as in ``statistics.order(i)``: 0 for a stick that begins at
        t = 0 (`is_initial_rest`) unless `numbering` counts it as the first.

        Args:
            path: A file name that ends in .csv or .parquet. The column names include the units. Of a .csv file pandas
                before 3.0 may miss the last digit, unless it reads with ``float_precision="round_trip"``.
            overwrite: Whether to replace a file of that name. Until the table is whole, an older one stays.

        Returns:
            The path.

        Raises:
            ValueError: Unless ``keep="sticks"``.
            ImportError: Without the extra ``tables``.
            FileExistsError, FileNotFoundError, OSError: As `save`.
        """
        sticks = self.require_sticks()
        inputs = {name: values[sticks.sample] for name, (values, _) in self._known_inputs().items()}
        order, position = self.numbering.order_of(sticks), self.system.stick_position
        columns = {"sample": sticks.sample, **stick_columns(sticks, order, position, inputs)}
        return write_table(columns, path, overwrite)

    def write_slips(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write all slips as a table, one row each: sample, start, end, duration, and whether the end, `t1`, cuts it.

        `path`, `overwrite`, the value returned and errors as in `write_sticks`.
        """
        slips = self._flat_slips()
        columns = {"sample": slips.sample, **time_columns(slips.start, slips.end), "is_censored": slips.censored}
        return write_table(columns, path, overwrite)

    def _repr_html_(self) -> str:
        rows = [(name, _brief(getattr(self, name))) for name in ("system", "law", "method")]
        rows += [(of.label, of(self).without_name().replace("+-", "±")) for of in STATISTICS.values()]
        rows += [(f"mean of {one.name}", one.mean.without_name().replace("+-", "±")) for one in self.outputs.values()]
        rows += self._warnings()
        rows.append(("time", f"{self.run_seconds:.3g} s to run, {self.compile_seconds:.3g} s to compile"))
        title = f"Ensemble of {self.samples:,} samples on [0, {self.t1:g}] s"
        figure = "" if self.retained is None else html.small_figure(self)
        return html.titled(title) + html.table(rows) + figure

    def __repr__(self) -> str:
        lines = [
            f"Ensemble of {self.samples} samples on [0, {self.t1:g}] s",
            f"  system    {_brief(self.system)}",
            f"  law       {_brief(self.law)}",
            f"  sticks    {_sticks(self.moments)} found" + ("" if self.flat_sticks is None else ", all kept"),
        ]
        if self.run_seconds:
            lines.append(f"  time      {self.run_seconds:.3g} s to run, {self.compile_seconds:.3g} s to compile")
        if self.output_values:
            lines.append(f"  outputs   {', '.join(self.output_values)}")
        lines += [f"  {what} {text}" for what, text in self._warnings()]
        return "\n".join(lines if self._unfinished else [*lines, "  finished  all samples"])


def _brief(module: object) -> str:
    if isinstance(module, (Unknown, UnknownSystem)):
        return str(module)
    text = in_one_line(module)
    return text if len(text) <= 110 else text[:107] + "..."


# `simulate_ensemble`: many samples of a random excitation, in chunks and threads, with streamed statistics.


def simulate_ensemble(
    system: System,
    law: BaseMotion,
    t1: float,
    y0: InitialState | None = None,
    *,
    samples: int | Design,
    key: Array | None = None,
    correlation: GaussianCopula | None = None,
    method: Exact | Regularized = EXACT,
    keep: Keep = "statistics",
    orders: int = 10,
    count_initial_rest: bool = False,
    threads: int | None = None,
    chunk: int | None = None,
    progress: bool | None = None,
    first_sample: int = 0,
    outputs: Outputs | None = None,
) -> Ensemble:
    """Simulate `samples` independent realisations of the excitation `law`.

    Sample i is ``simulate(system, law.sample(jax.random.fold_in(key, i), t1), ...)``, whatever the number of samples,
    the chunk size or the threads; ``system, base, y0 = many.realization(i)`` returns what it is simulated with. Any
    single number of `system`, `law` or `y0` may differ from sample to sample: an array (samples,), or a distribution
    (see docs/uncertain.md); ``many.input_values`` gives what was drawn.

    Args:
        system: A `MassSpring`, a `MotorCart` or a `SwitchedSystem` of your own.
        law: A random excitation, any that `simulate` takes, or an object with ``sample(key, t1)`` that returns one.
        t1: Duration, s.
        y0: Initial state, such as ``(position, velocity)`` of a `MassSpring`, or an array (samples, coordinates); zeros
            by default.
        samples: Their number, or a design (`stickslip_jax.design`) with a row for each.
        key: From ``jax.random.key(seed)``; None where nothing is random.
        correlation: Of random numbers; by default they are independent.
        method: `Exact`, with a time step where one is needed, or `Regularized`.
        keep: "totals" (fastest): ``many.totals`` of each sample, and their statistics; "statistics": all of these, in
            memory that does not grow with `samples`; "sticks" keeps every stick and the totals too.
        orders: Statistics are made of the 1st, 2nd, ... up to this stick of a sample, at most the 1000th.
        count_initial_rest: Whether a stick that begins at t = 0, from a start at rest, counts as the 1st.
        threads: Worker threads (default: all cores; on another device than a CPU one).
        chunk: Samples simulated per call (default: chosen for speed).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        first_sample: The number i of the first, where several machines share one ensemble (see `concatenate`).
        outputs: Numbers of your own: a dict from names to functions of a `Simulation` that return one number, or to
            `Output` objects, which have a unit, such as ``{"peak": lambda one: one.peak("position")}``; or to names
            that `Output` knows, or a list of such: ``["peak position", "slip path"]``. Those of ends, extremes, slip
            paths and energies are found as samples are simulated; for others every sample is simulated once more and
            recorded, batch by batch. ``many.outputs["peak"]`` is their distribution, ``many.output_values["peak"]`` the
            number of each sample; of a name in a list with ``_`` between the words, ``"peak_position"``.

    Returns:
        An `Ensemble`. Samples that did not reach ``t1`` are counted in ``many.status_counts`` and in no statistic.

    Raises:
        ValueError: For arguments outside these bounds.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.9)
    ... )
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> many = ss.simulate_ensemble(
    ...     system, law, t1=50.0, samples=1000, key=jax.random.key(0), y0=(0.0, 1.0)
    ... )
    >>> print(ss.mean_stick_duration(many))
    mean stick duration (pooled): 0.2271 +- 0.0010 s
    """
    checks.require_threads_of_jax()
    numbering, model = Numbering.checked(orders, count_initial_rest), StochasticModel(system, law, y0)
    wanted = checked_outputs(outputs, TAKEN)
    setup = EnsembleSetup.checked(model, t1, samples, first_sample, key, correlation, method, keep, numbering)
    samples, first = setup.inputs.samples - int(first_sample), int(first_sample)
    (found,) = found_by(setup, first, (EnsembleAccumulator(samples, keep),), threads, chunk, progress, wanted)
    return Ensemble(**setup.fields(), samples=samples, first_sample=first, **found, **fields_of_outputs(wanted))


def simulate_batch(
    setup: EnsembleSetup, first: int, samples: int, keep: Keep, *, retained: int,
    outputs: Mapping[str, Output] = NO_OUTPUTS,
) -> Ensemble:  # fmt: skip
    """Samples `first`, ``first + 1``, ... of a larger whole, simulated in this thread.

    `retained`: the most sticks that are retained for standard errors.
    """
    found = found_here(setup, first, EnsembleAccumulator(samples, keep, retained), outputs)
    return Ensemble(**setup.fields(), samples=samples, first_sample=first, **found, **fields_of_outputs(outputs))


# `simulate_contacts`: many samples of a system with several contacts, with the statistics of each contact.


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class ContactEnsembles:
    """The result of `simulate_contacts`: an `Ensemble` for each contact, and one for all contacts at once.

    - `system`: as it was given. `contacts`: how many it has. `samples`: their number. `t1`: s.
    - `status_counts`: how many samples ended with each `Status`. `near_grazing_samples`: in how many round-off decided
      whether there was an event.
    """

    system: System
    contacts: int
    samples: int
    t1: float
    status_counts: dict[Status, int]
    near_grazing_samples: int
    _fields: tuple[Fields, ...]
    _made: dict[int, Ensemble] = dataclasses.field(default_factory=dict)

    def of_contact(self, number: int) -> Ensemble:
        """The ensemble in which the sticks of one contact are counted, that of ``system.of_contact(number)``.

        Args:
            number: Of the contact, from 0.

        Raises:
            ValueError: For a number that is not one of its contacts.
        """
        return self._of_track(checks.whole_number("number", number, minimum=0, maximum=self.contacts - 1))

    def of_all_contacts(self) -> Ensemble:
        """The ensemble in which the times are counted when every closed contact sticks."""
        return self._of_track(self.contacts)

    def _of_track(self, track: int) -> Ensemble:
        """Made when it is asked for: a chain may have a thousand contacts."""
        if track not in self._made:
            assert isinstance(self.system, WithContacts)
            one = self.system.of_contact(track) if track < self.contacts else self.system.of_all_contacts()
            self._made[track] = Ensemble(**{"system": one, **self._fields[track]})
        return self._made[track]

    @property
    def input_values(self) -> dict[str, np.ndarray]:
        """The values of the numbers that differ from sample to sample, by name, arrays (samples,)."""
        return self._of_track(0).input_values

    def realization(self, number: int) -> data.Realization:
        """The system, the base motion and the initial state of sample `number`, with which `simulate` repeats it."""
        system, base, y0 = self._of_track(0).realization(number)
        assert isinstance(system, WithContacts)
        return data.Realization(system._counting(None), base, y0)

    def __repr__(self) -> str:
        first, *lines = repr(dataclasses.replace(self._of_track(0), system=self.system)).split("\n")
        *counts, of_all = (_sticks(fields["moments"]) for fields in self._fields)
        found = f"  sticks    {shown_counts(counts)} of the contacts, {of_all:,} of all at once"
        return "\n".join([first, *(found if line.startswith("  sticks") else line for line in lines)])


def _sticks(moments: Moments) -> int:
    return round(float(moments.mean[TOTALS.index("stick_count")] * moments.number))


def simulate_contacts(
    system: System,
    law: BaseMotion,
    *,
    t1: float,
    samples: int | Design,
    key: Array | None = None,
    correlation: GaussianCopula | None = None,
    y0: InitialState | None = None,
    method: Exact | Regularized = EXACT,
    keep: Keep = "statistics",
    orders: int = 10,
    count_initial_rest: bool = False,
    threads: int | None = None,
    chunk: int | None = None,
    progress: bool | None = None,
    first_sample: int = 0,
    outputs: Outputs | None = None,
) -> ContactEnsembles:
    """Simulate many samples of a system with a list of contacts, and count the sticks of every contact.

    The samples are simulated once. ``many.of_contact(0)`` is the same `Ensemble` to the last bit as
    ``simulate_ensemble(system.of_contact(0), ...)``: statistics, tests, figures, files and tables take it.

    Args:
        system: A `LinearStructure`, or a `SwitchedSystem` of your own with `contacts`.
        law: A random excitation, any that `simulate` takes, or an object with ``sample(key, t1)`` that returns one.
        t1: Duration of each sample, s.
        samples: Their number, or a design (`stickslip_jax.design`) with a row for each.
        key: From ``jax.random.key(seed)``; None where nothing is random.
        correlation: A `GaussianCopula` of random numbers; by default they are independent.
        y0: Initial state: positions, then velocities; or an array (samples, coordinates); zeros by default.
        method: `Exact`, with a time step where one is needed, or `Regularized`.
        keep: "totals" of each sample, "statistics" of their sticks besides, or "sticks", every one (`simulate_ensemble`
            says what each costs).
        orders: Statistics are made of the 1st, 2nd, ... up to this stick of a sample, at most the 1000th.
        count_initial_rest: Whether a stick that begins at t = 0, from a start at rest, counts as the 1st.
        threads: Worker threads (default: all cores; on another device than a CPU one).
        chunk: Samples simulated per call (default: chosen for speed).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        first_sample: The number of the first sample, where several machines share one ensemble.
        outputs: A dict from names to functions of a `Simulation` that return one number, or to `Output` objects.

    Returns:
        A `ContactEnsembles`.

    Raises:
        ValueError: For a system with one contact, and as `simulate_ensemble`.

    >>> row = ss.block_row(
    ...     2, mass=1.0, between=1.0, to_ground=0.5, normal_force=1.0, friction=ss.Coulomb(0.3)
    ... )
    >>> law = ss.PoissonSwitching(speed=0.5, rate=0.5)
    >>> many = ss.simulate_contacts(
    ...     row, law, t1=20.0, samples=200, key=jax.random.key(0), y0=(0.5, -0.5, 0.0, 0.0)
    ... )
    >>> print(ss.stick_fraction(many.of_contact(1)))
    stick fraction: 0.1151 +- 0.0048
    >>> print(ss.stick_fraction(many.of_all_contacts()))
    stick fraction: 0.0555 +- 0.0037
    """
    checks.require_threads_of_jax()
    numbering, model = Numbering.checked(orders, count_initial_rest), StochasticModel(system, law, y0)
    wanted = checked_outputs(outputs, TAKEN)
    setup = EnsembleSetup.checked(
        model, t1, samples, first_sample, key, correlation, method, keep, numbering, of_every_contact=True
    )
    if setup.tracks == (None,) or not isinstance(system, WithContacts):
        raise checks.refused("system", "have a list of contacts, of which all are counted", system)
    number, first = setup.inputs.samples - int(first_sample), int(first_sample)
    accumulators = [EnsembleAccumulator(number, keep) for _ in setup.tracks]
    found = found_by(setup, first, accumulators, threads, chunk, progress, wanted)
    shared: Fields = setup.fields() | {"samples": number, "first_sample": first} | fields_of_outputs(wanted)
    del shared["system"]
    fields = tuple(shared | of_track for of_track in found)
    noted = fields[0]["status_counts"], fields[0]["near_grazing_samples"]
    return ContactEnsembles(system, len(setup.tracks) - 1, number, setup.t1, *noted, fields)


# `concatenate` joins ensembles, `load` reads one from a file.


def load(path: str | os.PathLike[str]) -> Ensemble:
    """Read an ensemble that `Ensemble.save` or ``stickslip study`` wrote.

    Args:
        path: The file, or the folder of a study.

    Returns:
        The `Ensemble` with the statistics it had, to the last bit; figures, ``realization(i)`` and ``extended`` work as
        before. Objects of your own classes (systems, laws, distributions) come back as stand-ins that hold their name
        and how they printed: statistics and figures of the sticks still work, what needs the object raises ValueError.

    Raises:
        FileNotFoundError: For a missing file.
        ValueError: For one that is damaged or cut short, of another program, or of a newer format.
        ImportError: Without the extra ``study``.
    """
    return Ensemble(**conversions.fields_of_file(checks.path("path", path, "a file name")))


def concatenate(ensembles: Sequence[Ensemble]) -> Ensemble:
    """Join ensembles into one, whose samples are those of the first, then of the second, and so on.

    Where samples follow each other (the same system, law, method, start and key, and ``first_sample`` of one is the
    number after the last of the one before), the result is that of one run. Otherwise `origins` holds where each part
    came from, and ``realization(i)`` looks there; what differs from part to part is `Unknown` in the result, so that it
    cannot be extended. Sticks and counts are those of the parts to the last bit; means and other sums differ from those
    of one run by round-off only, since they are merged from sums.

    Args:
        ensembles: At least one, of the same duration, `keep`, `orders`, `count_initial_rest`, dtype, and kind of
            position. Their systems, laws, keys, methods and starts may differ.

    Raises:
        ValueError: For anything else, and for parts that hold the same random samples twice.
    """
    if not isinstance(ensembles, Sequence) or not ensembles or not all(isinstance(one, Ensemble) for one in ensembles):
        raise checks.refused("ensembles", "be a list of results of simulate_ensemble", ensembles)
    for what, of in _SAME.items():
        for number, one in enumerate(ensembles):
            if of(one) != of(ensembles[0]):
                raise ValueError(
                    f"Argument ensembles must have the same {what}, but the first has {checks.show(of(ensembles[0]))} "
                    f"and ensembles[{number}] has {checks.show(of(one))}."
                )
    accumulator = EnsembleAccumulator(sum(one.samples for one in ensembles), ensembles[0].keep)
    for one in ensembles:
        accumulator.add_ensemble(one)
    origins = _joined([origin for one in ensembles for origin in one._origins])
    # What its origins give; `Unknown` for what differs among them.
    given: Fields = {**origins[0]._asdict(), "origins": ()}
    if len(origins) > 1:
        given |= {"origins": origins, "key_data": None, "first_sample": 0, "design": None, "copula": None}
        for name in ("system", "law", "method", "y0"):
            if not all(data.same_object(getattr(origin, name), given[name]) for origin in origins):
                unknown = Unknown(f"differs among the {len(origins)} parts")
                position = origins[0].system.stick_position
                stands_for = {"system": UnknownSystem(unknown.name, "", position), "y0": (unknown,)}
                given[name] = stands_for.get(name, unknown)
    functions, *others = (one.output_functions for one in ensembles)
    return Ensemble(
        **{name: getattr(ensembles[0], name) for name in ("t1", "numbering", "dtype")},
        **{**given, "samples": accumulator.samples},
        **accumulator.found(),
        output_units=dict(ensembles[0].output_units),
        output_functions={
            name: function for name, function in functions.items() if all(one.get(name) is function for one in others)
        },
        threads=max(one.threads for one in ensembles),
        compile_seconds=sum(one.compile_seconds for one in ensembles),
        run_seconds=sum(one.run_seconds for one in ensembles),
    )


_SAME: dict[str, Callable[[Ensemble], object]] = {
    "duration t1": lambda one: one.t1,
    "keep": lambda one: one.keep,
    "numbering": lambda one: one.numbering,
    "dtype": lambda one: one.dtype,
    "names and units of outputs": lambda one: dict(sorted(one.output_units.items())),
    "contact whose sticks are counted": lambda one: getattr(one.system, "counted_contact", None),
    "unit and period of the position": lambda one: one.system.stick_position[1::2],
}
"""In what ensembles that are joined must be the same, in words."""


def _joined(origins: list[Origin]) -> tuple[Origin, ...]:
    """The origins, those that follow each other made one. Raises ValueError if one holds samples of another."""
    for one, other in itertools.combinations(origins, 2):
        apart = one.first_sample + one.samples <= other.first_sample
        apart = apart or other.first_sample + other.samples <= one.first_sample
        if one.key_data is not None and not apart and one.same_run(other):
            raise ValueError(
                "Argument ensembles must hold different samples, but two parts have the same key and samples "
                f"{max(one.first_sample, other.first_sample)} and on; simulate them with different keys, or with "
                "first_sample=... after one another."
            )
    joined = origins[:1]
    for origin in origins[1:]:
        last = joined[-1]
        if origin.follows(last):
            joined[-1] = last._replace(samples=last.samples + origin.samples)
        else:
            joined.append(origin)
    return tuple(joined)
