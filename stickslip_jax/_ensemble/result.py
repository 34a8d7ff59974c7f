"""`Ensemble`, the result of many samples: sums for the statistics and, if kept, every stick of every sample."""

import dataclasses
import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks, _html
from .._dynamics.method import Exact, Regularized
from .._events.sticks import FlatSticks, Sticks
from .._excitation.excitation import is_random
from .._excitation.random import realized_state
from .._numerics.moments import Moments
from .._statistics.accumulator import Numbering, StickAccumulator
from .._statistics.ensemble_statistics import EnsembleStatistics, statistics_of_ensemble
from .._statistics.registry import STATISTICS, TOTALS
from .._statistics.summary import Summary, summary_of
from .._status import Status
from .._systems.system import System

if TYPE_CHECKING:
    import xarray


class SampleTotals(NamedTuple):
    """Totals of each sample, arrays (samples,): numbers of sticks and slips, total stick time (s), `Status` code, and
    number of near-grazing instants (see `Simulation`).
    """

    sticks: np.ndarray
    slips: np.ndarray
    stick_time: np.ndarray
    status: np.ndarray
    near_grazing_count: np.ndarray


class Retained(NamedTuple):
    """The sticks of the first samples that finished, and the `TOTALS` of each, (samples, 3)."""

    sticks: FlatSticks
    totals: np.ndarray


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class Ensemble:
    """The result of `simulate_ensemble`: many simulated samples.

    - `system`, `law`, `t1` (s), `y0` (m, m/s), `samples`, `key_data`, `dtype`: the arguments and the floating dtype.
    - `method`: the simulation method; a `Regularized` method has its options filled in.
    - `numbering`: which stick of a sample is the 1st, 2nd, ...
    - `moments`: number of finished samples, mean and covariance of their `TOTALS` (stick time in s, number of sticks,
      number of slips).
    - `near_grazing_samples`: number of samples in which round-off decided whether there was an event (see
      `Simulation`); the statistics include them.
    - `status_counts`: number of samples that ended with each `Status`; only those FINISHED count in the statistics.
    - `sticks`: every stick, arrays (samples, slots), and `totals` of each sample, if ``keep="sticks"``.
    - `flat_sticks`: the same sticks one after the other, without padding; None unless ``keep="sticks"``.
    - `accumulator`: sums and histograms of the sticks, which `statistics` reads. `retained`: sticks of the first
      finished samples (of all, if kept), from which standard errors are computed. Both None if ``keep="totals"``.
    - `threads`: number of worker threads used. `compile_seconds`, `run_seconds`: time spent, s.
    """

    system: System
    law: Any
    t1: float
    method: Exact | Regularized
    numbering: Numbering
    y0: tuple[Any, ...]
    samples: int
    key_data: tuple[int, ...] | None
    dtype: str
    moments: Moments
    status_counts: dict[Status, int]
    near_grazing_samples: int
    accumulator: StickAccumulator | None
    retained: Retained | None
    totals: SampleTotals | None
    flat_sticks: FlatSticks | None
    threads: int
    compile_seconds: float
    run_seconds: float

    @cached_property
    def statistics(self) -> EnsembleStatistics:
        """All statistics of the sticks and slips. Raises ValueError if ``keep="totals"``."""
        return statistics_of_ensemble(self)

    def summary(self) -> Summary:
        """The statistics as a readable table, for text and notebooks. Raises ValueError if ``keep="totals"``."""
        return summary_of(self)

    @cached_property
    def sticks(self) -> Sticks:
        """Every stick of every sample, arrays (samples, slots). Raises ValueError unless ``keep="sticks"``."""
        return self.require_sticks().padded()

    def finished_sticks(self) -> FlatSticks:
        """The sticks of the samples that reached ``t1``: of all these, or with ``keep="statistics"`` of the first.

        Raises ValueError if ``keep="totals"``.
        """
        if self.retained is None:
            raise ValueError(
                'This ensemble kept only totals; call simulate_ensemble(..., keep="statistics") or keep="sticks".'
            )
        return self.retained.sticks

    def numbered_sticks(self) -> FlatSticks:
        """`finished_sticks`, without those that begin at t = 0 unless `numbering` counts these as the first."""
        sticks = self.finished_sticks()
        return sticks if self.numbering.count_initial_rest else sticks.without_initial_rest()

    def require_sticks(self) -> FlatSticks:
        """`flat_sticks`. Raises ValueError unless ``keep="sticks"``."""
        if self.flat_sticks is None:
            raise ValueError('This ensemble did not keep its sticks; call simulate_ensemble(..., keep="sticks").')
        return self.flat_sticks

    @property
    def finished(self) -> int:
        """Number of samples that reached ``t1``."""
        return self.status_counts[Status.FINISHED]

    def realization(self, number: int) -> tuple[Any, tuple[float, ...]]:
        """The base motion and the initial state of sample `number`; `simulate` repeats the sample with them.

        Raises ValueError unless ``0 <= number < samples``.
        """
        if _checks.whole_number("number", number, minimum=0) >= self.samples:
            raise ValueError(f"Argument number must be below the {self.samples} samples, but {number} was given.")
        if self.key_data is None:
            return self.law, self.y0
        key = jax.random.fold_in(jax.random.wrap_key_data(jnp.array(self.key_data, jnp.uint32)), number)
        base = self.law.sample(key, self.t1) if is_random(self.law) else self.law
        y0 = realized_state(self.y0, jax.random.key_data(key), jnp.dtype(self.dtype))
        return base, tuple(float(value) for value in y0)

    def to_xarray(self) -> "xarray.Dataset":
        """The sticks and each sample's totals as an ``xarray.Dataset`` with units and long names.

        Sticks are CF contiguous ragged arrays along ``stick``; ``stick_count`` is the number of sticks of each
        sample. Raises ValueError unless ``keep="sticks"``, ImportError without the extra ``study``.
        """
        from .dataset import dataset_of  # noqa: PLC0415 - needs an extra

        return dataset_of(self)

    def write_sticks(self, path: str | os.PathLike[str]) -> Path:
        """Write all sticks as a table, one row each: sample, order, start, end, duration, position and ending.

        - `path`: a file name that ends in .csv or .parquet. The column names include the units.

        Returns the path. Raises ValueError unless ``keep="sticks"`` and for other paths, ImportError without the extra
        ``tables``.
        """
        from .tables import write_sticks  # noqa: PLC0415 - needs an extra

        return write_sticks(self, path)

    def _repr_html_(self) -> str:
        rows = [(name, _brief(getattr(self, name))) for name in ("system", "law", "method")]
        rows += [(of.label, of(self).without_name().replace("+-", "±")) for of in STATISTICS.values()]
        for status, count in self.status_counts.items():
            if status and count:
                rows.append(("NOT FINISHED, in no number above", f"{count:,} samples, because {status.meaning}"))
        if self.near_grazing_samples:
            rows.append(("decided by round-off (near-grazing)", f"{self.near_grazing_samples:,} samples"))
        rows.append(("time", f"{self.run_seconds:.3g} s to run, {self.compile_seconds:.3g} s to compile"))
        title = f"Ensemble of {self.samples:,} samples on [0, {self.t1:g}] s"
        figure = "" if self.retained is None else _html.small_figure(self)
        return _html.titled(title) + _html.table(rows) + figure

    def __repr__(self) -> str:
        sticks = self.moments.mean[TOTALS.index("stick_count")] * self.moments.number
        lines = [
            f"Ensemble of {self.samples} samples on [0, {self.t1:g}] s",
            f"  system    {_brief(self.system)}",
            f"  law       {_brief(self.law)}",
            f"  sticks    {round(sticks)} found" + ("" if self.flat_sticks is None else ", all kept"),
            f"  time      {self.run_seconds:.3g} s to run, {self.compile_seconds:.3g} s to compile",
        ]
        failed = {status: count for status, count in self.status_counts.items() if status and count}
        lines += [f"  NOT FINISHED: {count} samples, because {status.meaning}" for status, count in failed.items()]
        lines += (
            [f"  near-grazing: {self.near_grazing_samples} samples, in which round-off decided if there was an event"]
            if self.near_grazing_samples
            else []
        )
        return "\n".join(lines if failed else [*lines, "  finished  all samples"])


def _brief(module: Any) -> str:
    text = " ".join(eqx.tree_pformat(module, short_arrays=False).split())
    return text if len(text) <= 110 else text[:107] + "..."
