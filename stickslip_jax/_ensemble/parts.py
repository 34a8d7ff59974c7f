"""Parts of an ensemble, which threads simulate, the accumulator that merges them, and the progress bar beside."""

import importlib.util
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from .._dynamics.common.lanes import SampleTotals
from .._dynamics.sticks import NUMBERS, FlatSticks, StickCollector, StickStream, with_columns
from .._foundation import checks
from .._foundation.processes import available_memory
from .._foundation.types import DType, Status
from .._numerics.sums import Moments
from .._statistics.quantities import Numbering, StickAccumulator
from .._statistics.totals import TOTALS
from .data import EnsembleData, Fields, Keep, Retained

# The progress bar of an ensemble or a film, on terminals and in notebooks.


_DELAY = 1.0  # s: what takes less shows no bar unless one is asked for


class Progress(NamedTuple):
    """Functions that update the progress bar, if one is shown.

    `advance`: to call with the number of newly finished samples. `note`: with a text to show beside the bar.
    """

    advance: Callable[[int], object]
    note: Callable[[str], object]


@contextmanager
def progress_bar(progress: bool | None, samples: int, unit: str = "sample") -> Iterator[Progress]:
    """Shows a progress bar while the block runs.

    Args:
        progress: True shows one, False none; None shows one on a terminal and, while it runs for more than a second, in
            a notebook.
        samples: Their number.
        unit: What they are.

    Raises:
        ValueError: For another `progress`.
        ImportError: For True without the extra ``study``.
    """
    if progress is not None:
        checks.truth("progress", progress)
        progress = bool(progress)
    notebook = in_notebook()
    if progress is False or (progress is None and not (notebook or sys.stderr.isatty())):
        yield _NO_BAR
        return
    try:
        # A bar of the notebook where it can be shown, else one of text; ``tqdm.auto`` would warn that it cannot.
        if notebook and importlib.util.find_spec("ipywidgets") is not None:
            from tqdm.notebook import tqdm  # noqa: PLC0415 - an extra, loaded when asked for
        else:
            from tqdm.std import tqdm  # noqa: PLC0415 - an extra, loaded when asked for
    except ImportError:
        if progress is None:
            yield _NO_BAR
            return
        raise ImportError("A progress bar needs tqdm: pip install 'stickslip_jax[study]', or progress=False.") from None
    # In a notebook, what stays is saved with it.
    look = {"leave": False, "delay": _DELAY} if notebook and progress is None else {}
    with tqdm(total=samples, unit=unit, unit_scale=True, **look) as bar:
        yield Progress(bar.update, lambda text: bar.set_postfix_str(text, refresh=False))


def in_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", _nothing)()
    return getattr(shell, "kernel", None) is not None


def _nothing(*_: object) -> None:
    pass


_NO_BAR = Progress(_nothing, _nothing)


# Parts of an ensemble, which threads simulate, and the accumulator that merges them.


RETAINED = 1_000_000
"""With ``keep="statistics"``, the most sticks that are retained, those of the first samples: for standard errors and
for what cannot be accumulated (ranks, tests)."""
FEWEST = 64
"""The fewest samples that are retained, however many sticks they have."""


class EnsemblePart(NamedTuple):
    """A part of the ensemble: results of consecutive samples, their sticks, and the sums over these sticks."""

    results: SampleTotals
    sticks: FlatSticks | None = None
    accumulator: StickAccumulator | None = None
    rest: tuple[np.ndarray, ...] = ()  # `Numbering.rest` of each sample; empty: not known

    @classmethod
    def of(
        cls, results: SampleTotals, sticks: StickStream | FlatSticks, t1: float, numbering: Numbering,
        keep_sticks: bool, period: float | None = None,
    ) -> "EnsemblePart":  # fmt: skip
        """The part made from the results and the sticks of consecutive samples, simulated up to `t1` (s).

        `keep_sticks`: whether the part holds the sticks too, not only their sums. `period`: of the positions, which
        become those in ``[0, period)``; None where they have none.
        """
        finished = np.equal(results.status, Status.FINISHED)
        stick_time, slips = (np.asarray(column)[finished] for column in (results.stick_time, results.slips))
        done, found = StickStream.of(sticks) if isinstance(sticks, FlatSticks) else sticks, None
        if period is not None:
            done = with_columns(done, position=within_period(done.position, period))
        if not np.all(finished):
            found = done.only(finished).in_order()
            done = StickStream.of(found.only(finished))
        accumulator = StickAccumulator.of(done, stick_time, slips, t1, numbering)
        rest = numbering.rest(done)
        if not np.all(finished):  # as columns of all samples, with 0 for the others
            whole = [np.zeros(len(finished), column.dtype) for column in rest]
            for to, column in zip(whole, rest, strict=True):
                to[finished] = column
            rest = tuple(whole)
        return cls(results, found or done.in_order() if keep_sticks else None, accumulator, rest)


def within_period(positions: np.ndarray, period: float) -> np.ndarray:
    """The positions modulo `period`, in ``[0, period)``."""
    folded = np.mod(positions, positions.dtype.type(period))
    return np.where(folded < period, folded, 0)  # a tiny negative position is rounded up to the period


def prepare(dtype: DType) -> None:
    """Compile the loops that collect and count sticks with times of `dtype`, unless they are compiled."""
    sticks = StickCollector()
    sticks.restart(1)
    sticks.add(np.zeros((1, len(NUMBERS), 1), dtype), np.zeros((1, 1), np.int8), np.zeros((1, 1), np.int64))
    one = np.zeros(1)
    EnsemblePart.of(
        SampleTotals(one, one, one, np.full(1, Status.FINISHED), one), sticks.sticks, 1.0, Numbering(1, False), True
    )


class EnsembleAccumulator:
    """Merges the parts of an ensemble, which are added in order of the samples.

    Holds the sums over all samples, and the sticks of the first samples (with ``keep="sticks"``, of all).
    """

    def __init__(self, samples: int, keep: Keep, retained: int | None = None):
        """For `samples` samples, of whose sticks at most `retained` are retained (with ``keep="sticks"`` all).

        `retained`: by default `RETAINED`.
        """
        self.samples = samples
        self.keep: Keep = keep
        self.moments = Moments.of(np.zeros((0, len(TOTALS))))
        self.counts = np.zeros(len(Status), int)
        self.near_grazing_samples = 0
        self.accumulator: StickAccumulator | None = None
        self._kept: list[EnsemblePart] = []
        self._totals: list[SampleTotals] | None = None if keep == "statistics" else []
        self._outputs: list[Mapping[str, np.ndarray]] = []
        self._space = RETAINED if retained is None else retained  # number of sticks that still fit
        self._retained_samples = 0

    @property
    def missing(self) -> int:
        """How many samples have not been added."""
        return self.samples - int(np.sum(self.counts))

    @property
    def wants_sticks(self) -> bool:
        """Whether the sticks of further parts are kept."""
        return self.keep == "sticks" or self._space > 0

    def add(self, part: EnsemblePart) -> None:
        """Add the next part."""
        self.counts += np.bincount(part.results.status, minlength=len(Status))
        self.near_grazing_samples += int(np.count_nonzero(part.results.near_grazing_count))
        self._merge(Moments.of(_totals_of(part)), part.accumulator)
        self._keep_totals(part.results)
        if part.sticks is not None:
            self._keep(part._replace(accumulator=None), part.sticks)

    def add_ensemble(self, other: EnsembleData) -> None:
        """Add all samples of an `Ensemble` that kept the same."""
        self.counts += np.array([other.status_counts[status] for status in Status])
        self.near_grazing_samples += other.near_grazing_samples
        self._merge(other.moments, other.accumulator)
        self._keep_totals(other.sample_totals)
        self.add_outputs(other.output_values)
        if self.keep == "sticks":
            sticks = other.require_sticks()
            self._keep(EnsemblePart(other.totals, rest=other.numbering.rest(sticks)), sticks)
        elif other.retained is not None and self._space > 0:
            totals = other.retained.totals
            none, (time, sticks, slips, *rest) = np.zeros(len(totals), int), totals.T
            part = EnsemblePart(SampleTotals(sticks, slips, time, none, none), rest=tuple(rest))
            # Samples that did not finish took space, too, when they were simulated. Where some that did finish are not
            # retained, there was none left.
            is_whole = len(totals) == other.finished
            self._keep(part, other.retained.sticks, unfinished=other.samples - other.finished, is_whole=is_whole)

    def add_outputs(self, values: Mapping[str, np.ndarray]) -> None:
        """Add the outputs of the next samples, by name."""
        self._outputs.append(values)

    def _merge(self, moments: Moments, accumulator: StickAccumulator | None) -> None:
        self.moments = self.moments.merge(moments)
        if accumulator is not None:
            self.accumulator = accumulator if self.accumulator is None else self.accumulator.merge(accumulator)

    def _keep_totals(self, totals: SampleTotals | None) -> None:
        """Keep the totals of the next samples; where they are not known, those of no sample are kept."""
        if totals is None:
            self._totals = None
        elif self._totals is not None:
            self._totals.append(totals)

    def _keep(self, part: EnsemblePart, sticks: FlatSticks, unfinished: int = 0, is_whole: bool = True) -> None:
        """Keep the `sticks` of a part, or those of as many of its first samples as there is space for.

        `unfinished`: of samples that are not in it and take space. `is_whole`: whether it has all that finished.
        """
        if self.keep == "sticks":
            self._kept.append(part._replace(sticks=sticks))
            _check_memory(self._kept, self.samples)
        elif self._space > 0:
            # A sample takes the space of its sticks and one more, so that samples without sticks are limited too.
            fits = int(np.searchsorted(np.cumsum(sticks.count + 1), self._space, side="right"))
            fits = max(fits, min(FEWEST - self._retained_samples, len(sticks.count)))
            self._retained_samples += fits + unfinished
            results = SampleTotals(*(column[:fits].copy() for column in part.results))
            rest = tuple(column[:fits].copy() for column in part.rest)
            fit_all = fits == len(sticks.count)
            self._kept.append(EnsemblePart(results, sticks if fit_all else sticks.head(fits), rest=rest))
            left = self._space - len(sticks.start) - fits - unfinished if fit_all and is_whole else 0
            self._space = max(left, int(self._retained_samples < FEWEST))

    def found(self) -> Fields:
        """The fields of an `Ensemble` that come from the parts, by name."""
        is_full, kept = self.keep == "sticks", [part.sticks for part in self._kept if part.sticks is not None]
        sticks = FlatSticks.joined(kept) if kept else None
        totals = None
        if self._totals is not None:
            totals = SampleTotals(*map(np.concatenate, zip(*self._totals, strict=True)))
        retained = None
        if sticks is not None:  # of the kept samples that finished
            finished = np.concatenate([np.equal(part.results.status, Status.FINISHED) for part in self._kept])
            retained = Retained(sticks.only(finished), np.concatenate([_totals_of(part) for part in self._kept]))
        return {
            "moments": self.moments,
            "status_counts": {status: int(self.counts[status]) for status in Status},
            "near_grazing_samples": self.near_grazing_samples,
            "accumulator": self.accumulator,
            "retained": retained,
            "sample_totals": totals,
            "flat_sticks": sticks if is_full else None,
            "output_values": {
                name: np.concatenate([part[name] for part in self._outputs])
                for name in (self._outputs[0] if self._outputs else ())
            },
        }


def _totals_of(part: EnsemblePart) -> np.ndarray:
    """The `TOTALS` of each finished sample, (finished samples, 5)."""
    results = part.results
    finished = results.status == Status.FINISHED
    none = np.zeros(len(finished))
    columns = (results.stick_time, results.sticks, results.slips, *(part.rest or (none, none)))
    return np.stack([np.asarray(column, np.float64) for column in columns], axis=1)[finished]


_MUCH = 2e9  # bytes


def _check_memory(kept: list[EnsemblePart], samples: int) -> None:
    """Say early how much memory the sticks will take: a warning where it is much, ValueError where it is not there.

    Joining them takes twice their size.
    """
    if len(kept) % 64 != 1:
        return
    done = sum(len(part.results.status) for part in kept)
    size = sum(column.nbytes for part in kept for column in (*part.results, *(part.sticks or ())))
    expected, there = 2 * size / done * samples, available_memory() + size
    todo = f"keeping the sticks of {samples:,} samples takes about {expected / 1e9:.1f} GB"
    if expected > there:
        raise ValueError(
            f'Argument keep must be "statistics" for so many samples: {todo}, and this machine has '
            f"{there / 1e9:.1f} GB free."
        )
    if len(kept) == 1 and expected > _MUCH:
        warnings.warn(
            f'The sticks need much memory: {todo} of it; keep="statistics" takes little, whatever the number of '
            "samples.",
            RuntimeWarning,
            stacklevel=2,
        )
