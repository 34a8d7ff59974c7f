"""A sensitivity problem: statistic, motion and parameters, its pilot simulation, and where no derivative exists."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._compiler.native import LANES
from .._compiler.programs import kept_jit
from .._dynamics.common.lanes import BLOCK, Engine, Job, lane_size, with_leaves
from .._dynamics.common.method import EXACT, Arguments, Exact, Regularized, check_method, state_of
from .._dynamics.engine_choice import engine_for, engines_of_all, sample_engines
from .._dynamics.interval.arcs import Scales
from .._dynamics.interval.engine import IntervalEngine
from .._dynamics.switched.engine import steps_for
from .._ensemble.data import Keep
from .._ensemble.ensemble import simulate_ensemble
from .._excitation.excitation import BaseMotion, excitation_of, is_random, key_data_for, law_of
from .._excitation.motion import RandomSignal
from .._excitation.piecewise_constant import PiecewiseConstantLaw, PoissonSwitching
from .._excitation.segments import SegmentLaw
from .._foundation import checks
from .._foundation.processes import is_wide, lanes_at_once, usual_threads
from .._foundation.types import AnyArray, DType, InitialState, Scalar
from .._numerics.elementary import random_words
from .._numerics.matrices import MANY, WRITTEN_OUT
from .._systems.system import System, Tracks, WithContacts, require_system
from .._uncertainty.inputs import Input, Inputs, StochasticModel
from .._uncertainty.numbers import NumberPath, Parameter, leaves_of_numbers, number_at, parameters_of
from .boundaries import FirstSegment, relative_excess
from .statistic import AnyStatistic, BufferSizes, OfOutput, OfTotals, RandomEngine, StickStatistic, statistics_of

# A sensitivity problem: statistic, motion and parameters, and the results of its pilot simulation.


ROWS = 32  # of tasks that find totals
SEQUENCE_LANES, _FEWEST = 512, 64  # of tasks that record sticks, on a CPU
_NUMBERS_OF_STEP = 40  # about so many are recorded of a step
_IN_MATRICES = ("on_base", "series_stiffness")


class Pilot(NamedTuple):
    """Results of the pilot simulation: means of total stick time (s) and number of sticks of a realisation.

    `most`: the largest number of sticks, for statistics of single sticks; else None. `fewest`: the smallest buffer of a
    realisation, so that neighbouring problems are compiled once.
    """

    stick_time: float
    sticks: float
    most: int | None
    fewest: BufferSizes = BufferSizes(0, 0, 0)


def _holds(entry: Input, path: NumberPath) -> bool:
    """Whether the number at `path` of a model is that of an input, or one of its distribution."""
    return path[: len(entry.path)] == entry.path


class RandomInputs(NamedTuple):
    """The inputs of a sensitivity problem and the engine of all samples.

    `origins`: which input each place of the engine holds; None for what follows from several, such as a time step.
    """

    inputs: Inputs
    engine: RandomEngine
    origins: tuple[int | None, ...]


class SensitivityProblem(NamedTuple):
    """The statistics of the system's motion under the law, the parameters to vary, and how to simulate.

    What it says of its statistics holds if they are of one kind (`kinds`).
    `system`, `law`, `y0`: those of the first sample. `random`: the numbers that differ from sample to sample; None if
    there are none. `model`: with all distributions and arrays, for what ensembles simulate. `lanes`, `recorded_lanes`:
    how many trajectories are followed at a time, where totals are found and where sticks are recorded.
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
    model: StochasticModel
    random: RandomInputs | None = None
    lanes: int = LANES
    recorded_lanes: int = SEQUENCE_LANES

    def only(self, statistic: StickStatistic) -> "SensitivityProblem":
        """The problem of one statistic."""
        return self._replace(statistics=(statistic,))

    def kinds(self) -> list["SensitivityProblem"]:
        """The problems of the statistics that one loop finds together."""
        found: dict[tuple[bool, ...], list[StickStatistic]] = {}
        for statistic in self.statistics:
            one = self.only(statistic)
            found.setdefault((one.is_counted, one.is_output, one.is_paired), []).append(statistic)
        return [self._replace(statistics=tuple(statistics)) for statistics in found.values()]

    @property
    def first_segment(self) -> FirstSegment:
        """What has no density while the base's first segment lasts: nothing where numbers differ from the start on."""
        if self.random is not None:
            return FirstSegment(is_fixed=False, end_is_fixed=False)
        with jax.ensure_compile_time_eval():
            return _first_segment(self.law, self.dtype)

    @property
    def by_intervals(self) -> bool:
        """Whether the closed forms over whole base intervals hold."""
        return engine_for(self.arguments).by_intervals

    @property
    def arguments(self) -> Arguments:
        """What the engine is chosen by."""
        return Arguments(self.system, self.law, self.method, self.t1)

    @property
    def steps(self) -> int:
        """How many intervals or time steps suffice for nearly every realisation."""
        if self.by_intervals:
            assert isinstance(self.law, PiecewiseConstantLaw)
            return self.law.checked_capacity(self.t1)
        excitation, step = self.arguments.checked_step("law")
        return steps_for(self.system, excitation, self.t1, step)

    def in_closed_form(self) -> "SensitivityProblem":
        """The same problem without a solver, where closed forms exist.

        They show which arcs cannot graze: those after a stick that a reversal of the base cut short.
        """
        closed = self._replace(method=EXACT)
        if not closed.by_intervals:
            return self
        return closed.with_inputs(self.random.inputs) if self.random is not None else closed

    def with_inputs(self, inputs: Inputs) -> "SensitivityProblem":
        """The same problem with numbers that differ from sample to sample, if there are any.

        Distributions with parameters to vary are the sources of its engine.
        """
        if not (inputs.entries or inputs.has_sampled_law):
            return self
        template, leaf_numbers, _, origins = engines_of_all(inputs, self.method, self.t1, self.dtype)

        def source(origin):
            entry = None if origin is None else inputs.entries[origin]
            is_varied = entry is not None and any(_holds(entry, parameter.path) for parameter in self.parameters)
            return entry.source if entry is not None and is_varied else None

        engine = RandomEngine(template, leaf_numbers, tuple(map(source, origins)))
        return self._replace(random=RandomInputs(inputs, engine, origins))

    def varying_leaves(self, first: int, number: int) -> tuple[AnyArray, ...]:
        """The varying leaves of samples `first` to ``first + number - 1``, for `Job.varying`."""
        if self.random is None:
            return ()
        inputs, engine, origins = self.random
        varying = sample_engines(inputs, self.method, self.t1, self.dtype, first, number).varying
        uniforms = inputs.uniforms(first, number, self.dtype)
        drawn = (None if source is None or origin is None else uniforms[origin]
                 for source, origin in zip(engine.sources, origins, strict=True))  # fmt: skip
        return tuple(column if uniform is None else uniform for column, uniform in zip(varying, drawn, strict=True))

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
        return self.has_sudden_switches or (self.system.traits.stops_are_unstable and not self.ignores_stick_count)

    @property
    def is_counted(self) -> bool:
        """Whether the totals of each realisation are enough, so that no stick need be recorded."""
        return self.statistics[0].is_of_totals

    @property
    def needs_ensembles(self) -> bool:
        """Whether values at other parameters are those of other ensembles, and not of an engine with other numbers."""
        return self.is_output or isinstance(self.method, Regularized) or self.system.tracks.contacts is not None

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
        if self.is_output or any(one.counts_slips for one in self.totals) or not self.are_contacts_followed:
            return False
        if self.by_intervals and self.is_counted and not self.ignores_stick_count:
            assert isinstance(self.law, PiecewiseConstantLaw)
            if any(one.path[:2] == ("law", self.law.gap_rate) and len(one.path) > 2 for one in self.parameters):
                return False  # the likelihood of the number of switches knows one rate of all samples
        if self.random is None:
            return True
        inputs, engine, _ = self.random
        only_in_start = all(entry.path[0] == "y0" for entry in inputs.entries)
        are_followed = only_in_start or self.by_intervals or self.ignores_stick_count
        in_lanes = all(source is None or source.in_lanes for source in engine.sources)
        return are_followed and in_lanes and not inputs.has_sampled_law

    @property
    def are_contacts_followed(self) -> bool:
        """Whether there is one contact, or a list of contacts whose boundaries are known."""
        system = self.system
        if system.tracks.contacts is None:
            return True
        if not isinstance(system, WithContacts) or isinstance(self.method, Regularized):
            return False
        is_large = len(system.coordinates) > MANY or system.tracks.contacts > WRITTEN_OUT
        if is_large or any(one.path[-1] in _IN_MATRICES for one in self.parameters):
            return False  # the engine holds what follows from these numbers
        model = system.switched_model(None, None)
        return not (model.varying or model.has_sliders or model.coupled)

    def job(self, engine: Engine, first: int, samples: int, used_rows: int = 1) -> Job:
        """A job of `used_rows` rows from sample `first` on; it holds the own leaves of `samples` samples."""
        varying = self.varying_leaves(first, samples)
        return Job(engine, self.key_data, np.uint32(first), np.int32(used_rows), varying)

    def engine(self) -> Engine:
        """The fastest engine that simulates the motion."""
        if self.random is not None:
            return self.random.engine
        engine = engine_for(self.arguments).lanes(self.y0, self.dtype)
        assert isinstance(engine, Engine)
        return engine

    @property
    def units(self) -> Float[np.ndarray, " parameters"]:
        """The size of each parameter, 1 where it is 0: in these units `derivatives_of` varies them."""
        return np.array([abs(parameter.value) or 1.0 for parameter in self.parameters])

    @property
    def leaves(self) -> tuple[int, ...]:
        """Which leaf of the engine each parameter is; of a distribution's own number, counted from the end.

        So they are the same leaves in an engine made of it (`wrapped`).
        """
        paths = tuple(parameter.path for parameter in self.parameters)
        if self.random is None:
            own = StochasticModel(self.system, self.law, self.y0)
            return leaves_of_numbers(lambda model: self._replace(**model._asdict()).engine(), own, paths)
        inputs, engine, origins = self.random

        def parts(model: StochasticModel) -> Any:
            of_model = dataclasses.replace(inputs, model=model)
            template = sample_engines(of_model, self.method, self.t1, self.dtype, 0, 1).template
            drawn = (at for source, at in zip(engine.sources, origins, strict=True) if source is not None)
            return template, [number_at(model, inputs.entries[at].path) for at in drawn if at is not None]

        size, of_template = (len(jax.tree.leaves(tree)) for tree in (engine, engine.template))
        found = leaves_of_numbers(parts, inputs.model, paths)
        return tuple(leaf if leaf < of_template else leaf - size for leaf in found)

    @property
    def per_task(self) -> int:
        """The largest number of samples of a task that finds totals, as in `_ensemble/setup.py`."""
        return min(-(-self._share // LANES) * LANES, self.lanes * self.rows)

    @property
    def rows(self) -> int:
        """The number of rows of a task that finds totals: always the same on a CPU, else no more than needed."""
        return min(ROWS, -(-self._share // self.lanes)) if is_wide() else ROWS

    def of_lanes(self, lanes: int) -> "SensitivityProblem":
        """The same with fewer lanes."""
        return self._replace(lanes=lanes, recorded_lanes=max(_FEWEST, self.recorded_lanes * lanes // self.lanes))

    def laid_out(self) -> "SensitivityProblem":
        """The same with as many lanes as the device takes."""
        # A tangent of everything for each parameter, and what is compared with it.
        each, numbers = 2 * (1 + len(self.parameters)), 1.0 * _NUMBERS_OF_STEP * self.dtype.itemsize

        def size() -> float:
            return 1.0 * each * lane_size(self.job(self.engine(), 0, 1), self.dtype, rows=ROWS, is_recorded=False)

        def recorded_size() -> float:
            return each * numbers * (BLOCK if isinstance(self.method, Regularized) else self.steps)

        return self._replace(
            lanes=lanes_at_once(LANES, self._share, size),
            recorded_lanes=lanes_at_once(SEQUENCE_LANES, self._share, recorded_size),
        )

    @property
    def sequence_lanes(self) -> int:
        """The number of lanes of a chunk that records sticks."""
        return min(self.recorded_lanes, max(_FEWEST, 1 << (self._share - 1).bit_length()))

    @property
    def _share(self) -> int:
        share = -(-self.samples // self.threads)
        return share if self.chunk is None else min(share, self.chunk)


def in_rows(samples: int, usual: int, most: int) -> tuple[int, int]:
    """How many rows of how many lanes `samples` fill, a multiple of the `usual` number of lanes; at most `most` lanes.

    They are filled exactly, so that as many samples are simulated whatever the device.
    """
    units = samples // usual
    together = max(d for d in range(1, max(1, min(units, most // usual)) + 1) if units % d == 0)
    return units // together, together * usual


def buffer_sizes_for(problem: SensitivityProblem, pilot: Pilot) -> BufferSizes:
    """Buffer sizes that suffice for nearly every realisation; callers enlarge them when they do not."""
    assert pilot.most is not None
    slots = 8 * -(-pilot.most // 8) + 8
    return BufferSizes(*map(max, (-(-problem.steps // BLOCK), slots, 2 * slots), pilot.fewest))


# Check of the arguments, and a pilot simulation of few samples, from which the widths of the kernels are chosen.


_PILOT = 1024  # samples
_RELATIVE_BANDWIDTH, _STICKS = 0.005, 1e6  # relative bandwidth of the widest window at so many sticks
_LARGEST_BANDWIDTH = 0.05


def problem_of(
    statistic: AnyStatistic | Sequence[AnyStatistic],
    system: System,
    law: BaseMotion,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None,
    y0: InitialState | None,
    *,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
    chunk: int | None = None,
) -> tuple[SensitivityProblem, Pilot]:
    """The checked problem, and the pilot simulation of its motion. Raises ValueError for invalid arguments."""
    checks.require_threads_of_jax()
    statistics = statistics_of(statistic)
    threads = usual_threads() if threads is None else checks.whole_number("threads", threads)
    size = None if chunk is None else checks.whole_number("chunk", chunk)
    check_method(method)
    number = checks.whole_number("samples", samples, minimum=2, maximum=2**31)
    if isinstance(system, WithContacts) and system.tracks == Tracks(contacts=1):
        system = system.of_contact(0)
    inputs = Inputs.of(StochasticModel(system, law_of(law), y0), number, key)
    dtype = jnp.result_type(float)
    inputs.check(dtype)
    first = inputs.of_sample(0, dtype)
    first = first._replace(y0=state_of(require_system(first.system), first.y0))
    inputs = inputs.with_start(first.y0)
    if not is_random(first.law) and not inputs.are_random:
        raise ValueError(
            "Argument law must be random, or system or y0 hold a distribution such as Uniform: without chance the "
            "number of sticks is a step function of the parameters, and has no derivative to correct. Differentiate "
            "simulate(...) with jax.jvp."
        )
    smoothed = isinstance(method, Regularized)
    from_totals = all(one.is_of_totals or isinstance(one, OfOutput) for one in statistics)
    keep: Keep = "totals" if from_totals and not smoothed else "sticks"
    # The pilot simulation checks the arguments too.
    few = min(number, _PILOT)
    system, its_law, start = inputs.head(few)
    many = simulate_ensemble(
        system, its_law, t1=t1, samples=few, key=key, y0=start, method=method, keep=keep, threads=threads,
        progress=False,
    )  # fmt: skip
    if many.moments.number < 2:
        raise ValueError(f"Fewer than two of {few} trajectories reached t1, so that there is no statistic: {many}")
    stick_time, sticks = (float(mean) for mean in many.moments.mean[:2])
    pilot = Pilot(stick_time, sticks, int(many.require_sticks().count.max()) if keep == "sticks" else None)
    parameters, key_data = parameters_of(inputs.model._asdict(), wrt), key_data_for(first.law, key)
    base = inputs.realization_of(0, first.law, t1) if inputs.has_sampled_law else first.law
    problem = SensitivityProblem(
        statistics, first.system, base, float(t1), first.y0, method, key_data, parameters, number, threads, size,
        dtype, inputs.model,
    )  # fmt: skip
    return (problem if smoothed else problem.with_inputs(inputs)).laid_out(), pilot


def _first_segment(base: BaseMotion, dtype: DType) -> FirstSegment:
    """What has no density while the first segment of the base lasts.

    Of a random law 1,024 first segments are drawn. Where a few per cent of them have a density, more than 8 are drawn
    once only; of a law with more than 8 rare ones it does no harm to take it for one with a density.
    """
    excitation = excitation_of(base)
    is_fixed, end_is_fixed = not isinstance(excitation.smooth, RandomSignal), False
    for law in (*excitation.base, *excitation.ground):
        if type(law) is PoissonSwitching or not law.is_random:
            continue
        drawn = np.asarray(_first_segments(law, dtype=dtype))
        course, end = (np.unique(part, axis=0, return_counts=True)[1] for part in (drawn[:, 1:], drawn[:, :1]))
        is_fixed, end_is_fixed = is_fixed and np.sum(course == 1) <= 8, end_is_fixed or np.sum(end == 1) <= 8
    return FirstSegment(bool(is_fixed), bool(end_is_fixed))


@kept_jit(static_argnames="dtype")
def _first_segments(law: SegmentLaw, *, dtype: DType) -> Float[Array, "draws 3"]:
    """Duration, value and slope of the first segment, drawn often."""

    def first(high, low):
        drawn = law.draw((high, low), jnp.zeros((), jnp.uint32), dtype)
        segment = law.next_segment(law.begin((high, low), dtype), drawn, dtype)[:3]
        return jnp.stack([jnp.asarray(number, dtype) for number in segment])

    return jax.vmap(first)(*jnp.arange(2 * _PILOT, dtype=jnp.uint32).reshape(2, -1))


def require_correctable(problem: SensitivityProblem) -> None:
    """Raise ValueError where the corrected method does not know what differs from sample to sample, and where float32
    resolves neither near misses nor the derivatives of slips that begin slowly.
    """
    if problem.dtype.itemsize < 8 and not (problem.by_intervals or problem.has_sudden_switches):
        raise ValueError(
            "Argument system (or law) must be a MassSpring without damping or force on a base of piecewise-constant "
            "velocity, in single precision: for any other motion round-off hides how close an arc came to the base "
            "velocity, and how slowly a slip began. Call jax.config.update('jax_enable_x64', True) first, or use "
            "estimator='finite-difference'."
        )
    if not problem.can_be_corrected:
        raise ValueError(
            "Argument estimator must be 'finite-difference' (the default here) where numbers of the system or law "
            "differ from sample to sample and the motion has no closed form from jump to jump of the base, where the "
            "law is an object of your own with a method sample(key, t1), where the parameter belongs to a Beta "
            "distribution or to the distribution of a switching rate, for outputs and statistics of slips, and of "
            "several contacts where there are more than 8, normal forces vary, springs are in front of them, the "
            "parameter is their on_base, or friction in one has an effect on another."
        )


def relative_bandwidth_of(problem: SensitivityProblem, pilot: Pilot) -> float:
    """Default relative bandwidth of the kernels: ``0.005 (sticks / 10^6)^(-1/5)``, at most 0.05.

    As in density estimation: with a bias of second order, the mean squared error is least for widths that shrink as the
    fifth root of the number of sticks.
    """
    return min(_RELATIVE_BANDWIDTH * (problem.samples * max(pilot.sticks, 1e-3) / _STICKS) ** -0.2, _LARGEST_BANDWIDTH)


# Warnings where no derivative exists: a first arc that grazes exactly in every trajectory; special base speeds.


_DRAWN = 64  # lanes: enough to draw every first velocity that is not rare
_EXACTLY = 1e-9  # tolerance relative to the squared velocities, and to w
_SPECIAL = (1.0, 2.0, 3.0, 8.0, 15.0)  # values of w (docs/sensitivity.md)

_Function: TypeAlias = Callable[[IntervalEngine, Scales, Float[Array, " lanes"]], Array]
"""Of an engine, its scales, and the first base velocity of each lane: numbers of each lane, (lanes, ...)."""


def warn_if_grazing(problem: SensitivityProblem) -> tuple[str, ...]:
    """Names of the parameters by which no derivative exists because the first arc grazes; warns (RuntimeWarning)."""
    if not problem.by_intervals or problem.random is not None:
        return ()
    grazes, moved = _zeros(problem, relative_excess)
    if moved:
        checks.warn(
            f"The derivative with respect to {', '.join(moved)} does not exist: {np.mean(grazes):.0%} of the "
            "trajectories begin with an arc that grazes the base velocity exactly, so that a change of one sign, "
            "however small, makes a stick there, and one of the other sign none. The derivative is given as NaN; "
            "change y0, or make it random."
        )
    return tuple(moved)


def warn_at_special_speeds(problem: SensitivityProblem, already_warned: tuple[str, ...]) -> None:
    """RuntimeWarning where the base speed over ``a omega``, w, is one of `_SPECIAL`, and a parameter changes it.

    There the circle on which the mass leaves a stick passes through special points of the phase plane, or the mass,
    where the base reverses as it is farthest out, comes back on the edge of the stick band. The mean number of sticks
    has no derivative: differences grow as steps shrink. `already_warned`: parameters with a warning.
    """
    inputs = () if problem.random is None else problem.random.inputs.entries
    speed_differs = any(entry.path[0] == "system" or entry.path == ("law", "speed") for entry in inputs)
    if not problem.by_intervals or speed_differs:
        return
    found, moved = _zeros(problem, _from_special_speeds)
    moved = [name for name in moved if name not in already_warned]
    if moved:
        special = _SPECIAL[int(np.argmax(np.any(found, axis=0)))]
        checks.warn(
            f"The dimensionless base speed w = speed / (a omega) is exactly {special:g}, where the mean number of "
            f"sticks has no derivative with respect to {', '.join(moved)}: its slope depends on the step at which it "
            "is taken. The slope over about `relative_bandwidth` is given; see docs/sensitivity.md."
        )


def _from_special_speeds(_: IntervalEngine, scales: Scales, velocities: Float[Array, " lanes"]) -> Array:
    """``w`` of the first base speed less each special one, (lanes, special speeds); 1 for a base at rest."""
    velocity = velocities[:, None]
    squared = scales.spring.squared
    omega = jnp.sqrt(jnp.where(squared > 0, squared, 1))
    w = jnp.where(squared > 0, jnp.abs(velocity) * omega / scales.deceleration, 0)
    return jnp.where(velocity == 0, 1.0, w - jnp.array([_SPECIAL], velocity.dtype))


def _zeros(problem: SensitivityProblem, function: _Function) -> tuple[Bool[np.ndarray, "..."], list[str]]:
    """Where a function of the engine is exactly 0, and the names of the parameters that change it there."""
    # Only where all samples are the same system; what differs in their starts does not matter here.
    inputs = () if problem.random is None else problem.random.inputs.entries
    shared = [one for one in problem.parameters if not any(_holds(entry, one.path) for entry in inputs)]
    problem = problem._replace(random=None, parameters=tuple(shared))
    engine, dtype = problem.engine(), problem.dtype
    if not problem.parameters:
        return np.zeros(0, bool), []
    key_data = random_words(problem.key_data, jnp.arange(_DRAWN, dtype=jnp.uint32))
    # Compiled as one: run operation by operation, it would take longer than the sensitivity itself.
    found, slopes = _with_slopes(engine, key_data, function=function, leaves=problem.leaves, dtype=dtype)
    zero, moves = np.abs(np.asarray(found)) < _EXACTLY, np.abs(np.asarray(slopes)) > _EXACTLY
    moved = [parameter.name for index, parameter in enumerate(problem.parameters) if np.any(zero & moves[..., index])]
    return zero, moved


@kept_jit(static_argnames=("function", "leaves", "dtype"))
def _with_slopes(
    engine: Engine, key_data: tuple[Array, Array], *, function: _Function, leaves: tuple[int, ...], dtype: DType
) -> tuple[Array, Array]:
    """Values of the function, and its derivatives by the parameters along a last axis."""

    def of(values: Array) -> Array:
        here = with_leaves(engine, leaves, values)

        def first_velocity(high, low):
            memory = here.law.begin((high, low), dtype)
            drawn = here.law.draw((high, low), jnp.zeros((), jnp.uint32), dtype)
            return here.law.next_interval(memory, drawn, dtype)[1]

        return function(here, here.shared(dtype), jax.vmap(first_velocity)(*key_data))

    given = jax.tree.leaves(engine)
    values = jnp.stack([jnp.asarray(given[leaf], dtype) for leaf in leaves])
    return of(values), jax.jacfwd(of)(values)
