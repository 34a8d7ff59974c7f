"""A sensitivity problem: statistic, motion and parameters, and the results of its pilot simulation."""

from typing import NamedTuple

import numpy as np

from .._dynamics.common.engine import Engine
from .._dynamics.common.lanes import BLOCK, Job
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.common.validation import Arguments
from .._dynamics.engine_choice import ByIntervals, engine_for
from .._dynamics.switched.run import steps_for
from .._excitation.excitation import BaseMotion, path_in_excitation
from .._excitation.merged import merged, path_in_merged
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._systems.system import System
from .._types import AnyArray, Array, DType, Scalar
from .._uncertainty.inputs import Inputs, Model
from .._uncertainty.numbers import Parameter, Path
from .random_inputs import RandomInputs
from .sequences import BufferSizes
from .statistic import OfOutput, OfTotals, StickStatistic


class Pilot(NamedTuple):
    """Results of the pilot simulation: means of total stick time (s) and number of sticks of a realisation.

    `most`: the largest number of sticks, for statistics of single sticks; else None. `fewest`: the smallest buffer of a
    realisation, so that neighbouring problems are compiled once.
    """

    stick_time: float
    sticks: float
    most: int | None
    fewest: BufferSizes = BufferSizes(0, 0, 0)


class Problem(NamedTuple):
    """The statistics of the system's motion under the law, the parameters to vary, and how to simulate.

    What it says of its statistics holds if they are of one kind (`kinds`).
    `system`, `law`, `y0`: those of the first sample. `random`: the numbers that differ from sample to sample; None if
    there are none. `model`: with all distributions and arrays, for what ensembles simulate.
    """

    statistics: tuple[StickStatistic, ...]
    system: System
    law: BaseMotion
    t1: float
    y0: tuple[Scalar, ...]
    method: Exact | Regularized
    key_data: Array
    parameters: tuple[Parameter, ...]
    samples: int
    threads: int
    chunk: int | None
    dtype: DType
    random: RandomInputs | None = None
    model: Model | None = None

    @property
    def statistic(self) -> StickStatistic:
        """The statistic, where there is one."""
        (statistic,) = self.statistics
        return statistic

    def only(self, statistic: StickStatistic) -> "Problem":
        """The problem of one statistic."""
        return self._replace(statistics=(statistic,))

    def kinds(self) -> list["Problem"]:
        """The problems of the statistics that one loop finds together."""
        found: dict[tuple[bool, ...], list[StickStatistic]] = {}
        for statistic in self.statistics:
            one = self.only(statistic)
            found.setdefault((one.is_counted, one.is_output, one.is_paired), []).append(statistic)
        return [self._replace(statistics=tuple(statistics)) for statistics in found.values()]

    @property
    def fixed_start(self) -> bool:
        """Whether all samples are the same system, begin in the same state, and first differ where the base does."""
        return self.random is None

    @property
    def by_intervals(self) -> bool:
        """Whether the closed forms over whole base intervals hold."""
        return isinstance(engine_for(Arguments(self.system, self.law, self.method, self.t1)), ByIntervals)

    def in_closed_form(self) -> "Problem":
        """The same problem without a solver, where closed forms exist.

        They show which arcs cannot graze: those after a stick that a reversal of the base cut short.
        """
        closed = self._replace(method=EXACT)
        if not closed.by_intervals:
            return self
        return closed._with_random(self.random.inputs) if self.random is not None else closed

    def _with_random(self, inputs: Inputs) -> "Problem":
        paths = tuple(parameter.path for parameter in self.parameters)
        return self._replace(random=RandomInputs.of(inputs, self.method, self.t1, self.dtype, paths))

    def with_inputs(self, inputs: Inputs) -> "Problem":
        """The same problem with numbers that differ from sample to sample, if there are any."""
        return self._with_random(inputs) if inputs.entries or inputs.has_sampled_law else self

    def varying_leaves(self, first: int, number: int) -> tuple[AnyArray, ...]:
        """The varying leaves of samples, for `Job.varying`."""
        return () if self.random is None else self.random.varying_leaves(first, number)

    @property
    def has_sudden_switches(self) -> bool:
        """Whether static friction can exceed kinetic friction.

        A mass that just touches the base velocity then sticks for a finite time or not at all: all later motion
        differs, and there are no sticks of zero length.
        """
        return self.system.static_exceeds_kinetic

    @property
    def is_paired(self) -> bool:
        """Whether the event part is a difference between pairs of trajectories, because kernels cannot estimate it."""
        by_kernels = self.ignores_stick_count or not self.system.stops_are_unstable
        return self.has_sudden_switches or not by_kernels

    @property
    def is_counted(self) -> bool:
        """Whether the totals of each realisation are enough, so that no stick need be recorded."""
        return self.statistics[0].is_of_totals

    @property
    def needs_ensembles(self) -> bool:
        """Whether values at other parameters are those of other ensembles, and not of an engine with other numbers."""
        return self.is_output or isinstance(self.method, Regularized) or self.system.contact_count is not None

    @property
    def is_output(self) -> bool:
        """Whether whole simulations are needed."""
        return isinstance(self.statistics[0], OfOutput)

    @property
    def totals(self) -> tuple[OfTotals, ...]:
        """The statistics, which are of totals."""
        return tuple(one for one in self.statistics if isinstance(one, OfTotals))

    @property
    def ignores_stick_count(self) -> bool:
        """Whether sticks of zero length do not change it: no event part then, unless there are sudden switches."""
        return self.is_counted and all(one.ignores_stick_count for one in self.totals)

    @property
    def can_be_corrected(self) -> bool:
        """Whether the corrected method knows what differs from sample to sample."""
        random = self.random
        if self.system.contact_count is not None or self.is_output or any(one.counts_slips for one in self.totals):
            return False
        if random is not None and random.inputs.has_sampled_law:
            return False
        if self.by_intervals and self.is_counted and not self.ignores_stick_count:
            assert isinstance(self.law, PiecewiseConstantLaw)
            if any(one.path[:2] == ("law", self.law.gap_rate) and len(one.path) > 2 for one in self.parameters):
                return False  # the likelihood of the number of switches knows one rate of all samples
        if random is None or random.only_in_start:
            return random is None or random.in_lanes
        return random.in_lanes and (self.by_intervals or (self.is_counted and self.ignores_stick_count))

    def job(self, engine: Engine, first: int, samples: int, used_rows: int = 1) -> Job:
        """A job of `used_rows` rows from sample `first` on; it holds the own leaves of `samples` samples."""
        varying = self.varying_leaves(first, samples)
        return Job(engine, self.key_data, np.uint32(first), np.int32(used_rows), varying)

    def engine(self) -> Engine:
        """The fastest engine that simulates the motion."""
        if self.random is not None:
            return self.random.engine
        engine = engine_for(Arguments(self.system, self.law, self.method, self.t1)).lanes(self.y0, self.dtype)
        assert isinstance(engine, Engine)
        return engine

    def paths(self) -> tuple[Path, ...]:
        """Paths of the parameters in the engine."""
        random, paths = self.random, tuple(parameter.path for parameter in self.parameters)
        if random is None:
            return tuple(map(self._path, paths))
        return tuple(random.path(path, self._path(path)) for path in paths)

    def _path(self, path: Path) -> Path:
        if path[0] != "law":
            return path
        inner = path_in_merged(self.law, path[1:])
        if self.by_intervals:
            return ("law", *inner)
        return ("excitation", *path_in_excitation(merged(self.law, self.t1), inner))


def buffer_sizes_for(problem: Problem, pilot: Pilot) -> BufferSizes:
    """Buffer sizes that suffice for nearly every realisation; callers enlarge them when they do not."""
    assert pilot.most is not None
    if problem.by_intervals:
        assert isinstance(problem.law, PiecewiseConstantLaw)
        intervals = problem.law.checked_capacity(problem.t1)
    else:
        assert isinstance(problem.method, Exact)
        excitation, step = Arguments(problem.system, problem.law, problem.method, problem.t1).checked_step("law")
        intervals = steps_for(problem.system, excitation, problem.t1, step)
    slots = 8 * -(-pilot.most // 8) + 8
    return BufferSizes(*map(max, (-(-intervals // BLOCK), slots, 2 * slots), pilot.fewest))


def lanes_and_rows(problem: Problem) -> tuple[int, int, int]:
    """Lanes, rows and largest number of samples of a task that finds totals, as in `_ensemble/call.py`."""
    lanes, rows = 256, 32
    fair = -(-_share(problem) // lanes) * lanes
    return lanes, rows, min(fair, lanes * rows)


def sequence_lanes(problem: Problem) -> int:
    """The number of lanes of a chunk that records sticks."""
    return min(512, max(64, 1 << (_share(problem) - 1).bit_length()))


def _share(problem: Problem) -> int:
    share = -(-problem.samples // problem.threads)
    return share if problem.chunk is None else min(share, problem.chunk)
