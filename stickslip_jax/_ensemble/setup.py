"""The checked arguments of an ensemble; its samples simulated in chunks and threads; the user's outputs of them."""

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from .._compiler.native import LANES, Layout
from .._compiler.programs import kept_jit
from .._dynamics.common.lanes import (
    BLOCK,
    SIGNS,
    Asked,
    End,
    Engine,
    Job,
    SampleTotals,
    Sums,
    VaryingEngine,
    WatchedEngine,
    WatchedTotals,
    lane_size,
    with_leaves,
)
from .._dynamics.common.method import Exact, Regularized, check_method, state_of, working_dtype
from .._dynamics.common.path import MotionPath, apart
from .._dynamics.engine_choice import compiled_for, engines_of_all, lanes_for, sample_engines
from .._dynamics.regularized.lanes import RegularizedEngine
from .._dynamics.simulate import Output, simulate
from .._dynamics.simulation import Simulation
from .._dynamics.sticks import ALL, DeviceSticks, StickCollector, Sticks, StickStream, start_totals
from .._dynamics.switched.inside import halves_for
from .._excitation.excitation import is_random, key_data_for, law_of
from .._excitation.motion import Signal
from .._foundation import checks
from .._foundation.extras import progress_bar
from .._foundation.processes import (
    as_many_as_fit,
    blocks_at_once,
    fewer_lanes,
    is_wide,
    lanes_at_once,
    usual_threads,
)
from .._foundation.types import AnyArray, DType, FloatArray, Number, Scalar, Status
from .._numerics import device_loops
from .._statistics.quantities import DISTRIBUTIONS, Numbering
from .._statistics.totals import STATISTICS
from .._systems.switched_model import Form, Segments, State, is_observed
from .._systems.system import System, Tracks, WithContacts, is_built_in, require_system
from .._uncertainty.design import Design
from .._uncertainty.inputs import GaussianCopula, Inputs, StochasticModel
from .._uncertainty.numbers import with_numbers
from .data import EnsembleAccumulator, EnsembleData, EnsemblePart, Fields, Keep, prepare

# The checked arguments of an ensemble, and the engine that simulates its samples.


MOST_SAMPLES = 2**31  # samples are numbered in 32 bits


@dataclasses.dataclass(frozen=True, eq=False)
class EnsembleSetup:
    """The checked arguments, which all chunks share.

    - `engine`: that of every sample. `leaf_numbers`: its leaves that differ from sample to sample.
    - `inputs`: the numbers that differ, as they were given.
    """

    engine: Engine
    leaf_numbers: tuple[int, ...]
    inputs: Inputs
    method: Exact | Regularized
    key_data: Array
    is_random: bool
    dtype: DType
    t1: float
    numbering: Numbering
    period: float | None  # of the position of sticks

    @classmethod
    def checked(
        cls,
        model: StochasticModel,
        t1: float,
        samples: int | Design,
        first_sample: int,
        key: Array | None,
        correlation: GaussianCopula | None,
        method: Exact | Regularized,
        keep: Keep,
        numbering: Numbering,
        *,
        of_every_contact: bool = False,
    ) -> "EnsembleSetup":
        """The arguments of `simulate_ensemble`. Raises its ValueErrors.

        `of_every_contact`: whether sticks are counted of every contact of a list.
        """
        if checks.holds_traced(*model, t1, key, method):
            raise ValueError(
                "Arguments of simulate_ensemble must be numbers, but JAX is tracing them; inside jit, vmap or grad use "
                "jax.vmap over simulate(system, law.sample(key, t1, capacity=...), ...)."
            )
        check_method(method)
        checks.positive("t1", t1, "s")
        number = len(samples) if isinstance(samples, Design) else samples
        number = checks.whole_number("samples", number, maximum=MOST_SAMPLES)
        first_sample = checks.whole_number("first_sample", first_sample, minimum=0, maximum=MOST_SAMPLES - number)
        total = samples if isinstance(samples, Design) else first_sample + number
        if isinstance(samples, Design) and first_sample:
            raise checks.refused("first_sample", "be 0 with a design, whose rows are all samples", first_sample)
        if not (correlation is None or isinstance(correlation, GaussianCopula)):
            raise checks.refused("correlation", "be a GaussianCopula(names, correlation)", correlation)
        checks.chosen("keep", keep, get_args(Keep))
        dtype = working_dtype(stacklevel=5)
        system = model.system
        if isinstance(system, WithContacts) and system.tracks == Tracks(contacts=1) and not of_every_contact:
            model = model._replace(system=system.of_contact(0))
        inputs = Inputs.of(model._replace(law=law_of(model.law)), total, key, correlation)
        inputs.check(dtype)
        first = inputs.of_sample(0, dtype)
        require_system(first.system)
        first = first._replace(y0=state_of(first.system, first.y0))
        inputs = inputs.with_start(first.y0)
        random = inputs.are_random or is_random(first.law)
        if random and key is None:
            wanted = "be a key such as jax.random.key(0) where law, system or y0 are random"
            raise checks.refused("key", wanted, key)
        # The engine of all samples, and which of its leaves differ; the method with every option filled in, but those
        # that differ from sample to sample as they were given.
        law = inputs.realization_of(0, first.law, t1) if inputs.has_sampled_law else first.law
        engine, leaf_numbers = lanes_for(first.system, law, method, t1, first.y0, dtype), ()
        if inputs.entries or inputs.has_sampled_law:
            engine, leaf_numbers, *_ = engines_of_all(inputs, method, t1, dtype)
        if isinstance(engine, RegularizedEngine):
            differs = object()
            marked = jax.tree.leaves(with_leaves(engine, leaf_numbers, [differs] * len(leaf_numbers)).method)
            method = method if any(leaf is differs for leaf in marked) else engine.method
        if leaf_numbers:
            engine = VaryingEngine(engine, leaf_numbers)
        if keep != "totals":
            engine = engine.asked(ALL)
        key_data, period = key_data_for(first.law, key), first.system.stick_position.period
        setup = cls(engine, leaf_numbers, inputs, method, key_data, random, dtype, float(t1), numbering, period)
        if setup.tracks != (None,) and not of_every_contact:
            raise ValueError(
                "Argument system must say whose sticks are counted, but a system with "
                f"{len(setup.tracks) - 1} contacts was given: take system.of_contact(number) or "
                "system.of_all_contacts(), or call simulate_contacts, which counts those of every contact."
            )
        return setup

    @property
    def tracks(self) -> tuple[int | None, ...]:
        """What sticks are counted of: every contact, and last all at once; (None,) where it is one thing."""
        tracks = self.engine.tracks
        return (None,) if tracks is None else tuple(range(tracks))

    def fields(self) -> Fields:
        """The fields of an `Ensemble` that its arguments are."""
        return {
            **self.inputs.model._asdict(),
            "t1": self.t1,
            "method": self.method,
            "numbering": self.numbering,
            "design": self.inputs.design,
            "copula": self.inputs.copula,
            "key_data": tuple(int(word) for word in np.asarray(self.key_data)) if self.is_random else None,
            "dtype": str(np.dtype(self.dtype)),
        }

    def varying_leaves(self, first: int, number: int) -> tuple[AnyArray, ...]:
        """The leaves of the engine that differ, for samples `first` to ``first + number - 1``, (number, ...)."""
        if not self.leaf_numbers:
            return ()
        return sample_engines(self.inputs, self.method, self.t1, self.dtype, first, number).varying

    def arguments(self, first: int, number: int) -> tuple[Array, tuple[Array, ...], Array, PyTree]:
        """The key, and what differs among samples `first`, ``first + 1``, ...: their numbers and realisations."""
        values = tuple(jnp.asarray(column) for column in self.inputs.drawn(first, number, self.dtype))
        numbers = jnp.asarray(self.inputs.realization_numbers(first, number))
        key_data = jnp.asarray(self.key_data, jnp.uint32)
        return key_data, values, numbers, self.inputs.realizations(first, number, self.t1)

    def job(self, first: int, used_rows: int, most_samples: int) -> Job:
        """The job for samples `first`, ``first + 1``, ... in `used_rows` rows of lanes, at most `most_samples`."""
        varying = self.varying_leaves(first, most_samples)
        realization = None
        if not self.inputs.has_own_realizations:
            realization = self.inputs.realization_numbers(first, most_samples)
        return Job(self.engine, self.key_data, np.uint32(first), np.int32(used_rows), varying, realization)


# Outputs of a user's own for the samples of an ensemble.
#
# What they ask of the end of a sample and of its extremes is found as it is simulated (`AtEnd`). For what they ask of
# its path or its sticks it is simulated once more, and recorded (`OutputRunner`).


NO_OUTPUTS: Mapping[str, Output] = {}
TAKEN = {
    **{one.name: "a quantity of sticks, slips or samples" for one in DISTRIBUTIONS},
    **{one.name: "a statistic" for one in STATISTICS.values()},
    **dict.fromkeys(("samples", "status", "quantile", "order", "point"), "a part of results"),
}
"""Names that outputs cannot have, and what they are those of."""

Values = dict[str, np.ndarray]
"""Numbers of consecutive samples by the name of the output, (samples,); NaN for those that did not finish."""


_AT_ONCE = 1024  # samples on a CPU
_SIZE = 2**14  # bytes that a sample's functions may take
_FEW_SAMPLES = 64


class _Noted:
    """Forms whose extremes are asked for: of the state, and with what is observed beside it; and whether sums are."""

    def __init__(self, size: int, knows_observed: bool):
        self.size, self.knows_observed = size, knows_observed
        self.forms: list[Form] = []
        self.sums = False

    @property
    def asked(self) -> Asked:
        forms = dict.fromkeys(self.forms)
        observed = [form for form in forms if is_observed(form, self.size)]
        return Asked(tuple(form for form in forms if form not in observed), tuple(observed), self.sums)


_NO_PATH = "the path of a sample is not kept"


class _EndPath(MotionPath):
    """Path of which what is `asked` for is known, as in `WatchedTotals`; or nothing yet: it is noted."""

    smooth: Signal | None
    asked: Asked | _Noted = eqx.field(static=True)
    extremes: FloatArray
    sums: Sums | None

    def largest(self, form: Form, sign: Scalar, last: FloatArray, final: State) -> FloatArray:
        if isinstance(self.asked, _Noted):
            self.asked.forms.append(form)
            return last
        largest, minus_smallest = self.extremes[:, self.asked.every.index(form)]
        return jnp.where(jnp.asarray(sign) > 0, largest, minus_smallest)

    def along_steps(self, last: FloatArray, asked: Asked) -> tuple[FloatArray, Sums | None]:
        if not isinstance(self.asked, _Noted):
            return self.extremes[:, [self.asked.every.index(form) for form in asked.observed]], self.sums
        if not self.asked.knows_observed:
            raise LookupError(_NO_PATH)
        self.asked.forms.extend(asked.observed)
        self.asked.sums |= asked.sums
        return jnp.broadcast_to(last, (len(SIGNS), len(asked.observed))), self.sums

    @property
    def times(self) -> Array:
        raise LookupError(_NO_PATH)

    def state(self, time: FloatArray) -> State:
        raise LookupError(_NO_PATH)

    def segments(self, time: FloatArray) -> Segments:
        raise LookupError(_NO_PATH)


class AtEnd:
    """Finds the outputs of samples as these are simulated, where they ask for nothing but their ends and extremes.

    `setup`: with the engine that knows these. `others`: what finds the other outputs; None if there are none.
    """

    def __init__(self, setup: EnsembleSetup, outputs: Mapping[str, Output]):
        """Traces every function once. Raises ValueError for one that does not return a number."""
        self.setup, self.outputs, self.others = setup, dict[str, Output](), None
        engine = setup.engine.template if isinstance(setup.engine, VaryingEngine) else setup.engine
        if not outputs:
            return
        zero, tracks = jnp.zeros((), setup.dtype), engine.tracks
        numbers = (zero,) * len(setup.inputs.model.system.coordinates)
        noted = _Noted(len(numbers), engine.knows_observed)
        sums = engine.no_sums(zero.dtype) if engine.knows_observed else None
        end = End(start_totals(zero.dtype, () if tracks is None else (tracks,)), zero, numbers)
        key_data, *of_sample = setup.arguments(0, 1)
        one = key_data, *jax.tree.map(lambda leaf: leaf[0], of_sample), np.zeros(2, np.int32), end, zero, sums
        for name, output in outputs.items():
            before, summed = len(noted.forms), noted.sums
            try:
                jax.eval_shape(self._function({name: output}, noted if engine.knows_extremes else Asked()), *one)
                self.outputs[name] = output
            except Exception:  # of what is not known here; a mistake is found once more by the others
                del noted.forms[before:]
                noted.sums = summed
        others = {name: output for name, output in outputs.items() if name not in self.outputs}
        self.others = OutputRunner(setup, others) if others else None
        if self.outputs:
            asked = noted.asked
            if asked.sums or asked.observed:
                asked = dataclasses.replace(asked, halves=halves_for(self._decay_in_step(engine), 1.0))
            engine = WatchedEngine(engine, asked)
            if setup.leaf_numbers:
                engine = VaryingEngine(engine, setup.leaf_numbers)
            self.setup = dataclasses.replace(setup, engine=engine)
            at_once = jax.vmap(self._function(self.outputs, asked), in_axes=(None, *[0] * 7))
            self._run = kept_jit(at_once)

    def _decay_in_step(self, engine: Any) -> float:
        """The largest `decay_in_step` of some samples, with something to spare where samples differ."""
        leaves = self.setup.varying_leaves(0, _FEW_SAMPLES)
        if not leaves:
            return float(engine.decay_in_step)

        def of_one(*values: AnyArray) -> Array:
            return jnp.asarray(with_leaves(engine, self.setup.leaf_numbers, values).decay_in_step)

        return 2 * float(jnp.max(jax.vmap(of_one)(*leaves)))

    def values(self, first: int, samples: int, results: WatchedTotals) -> Values:
        """The outputs of so many samples `first`, ``first + 1``, ..., of which `results` are the first ones."""
        (*_, status, near_grazing_count), end, extremes, sums = results
        known, found = (np.stack([status, near_grazing_count], axis=-1), end, extremes, sums), []
        at_once = lanes_at_once(_AT_ONCE, samples, lambda: _SIZE)
        for begin in range(0, max(samples, 1), at_once):
            number = max(min(at_once, samples - begin), 1)
            key_data, *of_samples = self.setup.arguments(first + begin, number)
            # Always as many at once: functions that are compiled for other sizes may round otherwise.
            here = np.minimum(np.arange(at_once), number - 1)
            given = jax.tree.map(lambda column, here=here: column[here], of_samples)
            ends = jax.tree.map(lambda column, here=begin + here: column[here], known)
            found.append(self._run(key_data, *given, *ends))
        columns = (np.concatenate(parts).astype(np.float64)[:samples] for parts in zip(*found, strict=True))
        return dict(zip(self.outputs, columns, strict=True))

    def _function(self, outputs: Mapping[str, Output], asked: Asked | _Noted) -> Callable[..., tuple[Array, ...]]:
        """A function of what differs among samples, the status and near-grazing count, and the end and way."""
        realized, setup = _realized(self.setup.inputs, self.setup.t1), self.setup
        t1, method, dtype = setup.t1, setup.method, setup.dtype

        def numbers(
            key_data: Array,
            values: tuple[Array, ...],
            number: Array,
            base: PyTree,
            counts: Array,
            end: End,
            extremes: Array,
            sums: Sums | None,
        ) -> tuple[Array, ...]:
            system, base, _ = realized(key_data, values, number, base)
            totals, of_all = apart(end.totals, system)
            if of_all is not None and system.tracks.contacts == 1:  # as `simulate` gives them
                totals = jax.tree.map(lambda of_each: of_each[0], totals)
            sticks, path = object.__new__(Sticks), _EndPath(None, asked, extremes, sums)  # without any number of sticks
            others = counts[0], end.time, end.state, counts[1], path, None if of_all is None else (sticks, of_all)
            one = Simulation(system, base, t1, method, sticks, totals, *others)
            return tuple(output.number(one, dtype) for output in outputs.values())

        return numbers


# Where samples are simulated once more, they are taken in batches of one size whose first number is a multiple of it,
# whatever the chunk, the threads or the first sample of the ensemble: a compiled function of another size could round
# otherwise, so the numbers of a sample depend on its key and number only.


_FEWEST = 8
_MEMORY = 2**27  # bytes of the recorded trajectories of a batch on a CPU
_EAGER_LANES = 64


class OutputRunner:
    """Finds the `outputs` of the samples of an ensemble."""

    def __init__(self, setup: EnsembleSetup, outputs: Mapping[str, Output]):
        """Traces every function once. Raises ValueError for one that does not return a number."""
        self._setup, self._outputs = setup, tuple(outputs)
        simulated, numbers = _sample_functions(setup.inputs, setup.t1, setup.method, setup.dtype, dict(outputs))
        self._at_once = jax.vmap(numbers, in_axes=(None, 0, 0, 0))
        key_data, *of_sample = setup.arguments(0, 1)
        one = key_data, *jax.tree.map(lambda leaf: leaf[0], of_sample)
        self._begun: dict[int, list[np.ndarray]] = {}
        try:
            shapes = jax.eval_shape(lambda *one: eqx.filter(simulated(*one), eqx.is_array), *one)
        except ValueError:
            # How many steps or intervals there are depends on numbers that differ from sample to sample: they are known
            # where JAX makes a batch of them outside jit.
            self._lanes, self._run = _EAGER_LANES, self._at_once
            self._begun[0] = self._batch(0)
            return
        size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
        fits = min(LANES, _MEMORY // max(size, 1))
        fits = max(_FEWEST, lanes_at_once(fits, max(setup.inputs.samples, 1), lambda: 2.0 * max(size, 1)))
        self._lanes, self._run = 1 << (fits.bit_length() - 1), kept_jit(self._at_once)
        jax.eval_shape(numbers, *one)

    def values(
        self, first: int, samples: int, threads: int = 1, advance: Callable[[int], object] = lambda number: None
    ) -> Values:
        """The outputs of samples ``first .. first + samples - 1``; of so many more it tells that they are done."""
        return as_many_as_fit(partial(self._values, first, samples, threads, advance), self._lanes)

    def _values(self, first: int, samples: int, threads: int, advance: Callable[[int], object], lanes: int) -> Values:
        self._lanes, end = lanes, first + samples
        begins = range(first - first % lanes, end, lanes)
        with ThreadPoolExecutor(max(1, min(threads, len(begins)))) as pool:
            batches, done = [], 0
            for batch in pool.map(self._batch, begins):
                batches.append(batch)
                now = min(samples, begins.start + lanes * len(batches) - first)
                advance(now - done)
                done = now
        own = slice(first - begins.start, end - begins.start)
        columns = zip(*batches, strict=True)
        return {name: np.concatenate(column)[own] for name, column in zip(self._outputs, columns, strict=True)}

    def _batch(self, first: int) -> list[np.ndarray]:
        if first in self._begun:
            return self._begun[first]
        arguments = self._setup.arguments(first, self._lanes)
        found = [np.asarray(leaf) for leaf in self._run(*arguments)]
        short = found[0] == Status.OUT_OF_STEPS
        if np.any(short) and self._run is not self._at_once:
            # Outside jit a simulation that has too few steps is given more.
            again = [np.asarray(leaf) for leaf in self._at_once(*arguments)]
            found = [np.where(short, new, old) for new, old in zip(again, found, strict=True)]
        status, *numbers = found
        finished = status == Status.FINISHED
        return [np.where(finished, np.asarray(column, np.float64), np.nan) for column in numbers]


def _sample_functions(
    inputs: Inputs, t1: float, method: Exact | Regularized, dtype: DType, outputs: dict[str, Output]
) -> tuple[Callable[..., Simulation], Callable[..., tuple[Array, ...]]]:
    """Functions of the key, and of the numbers and the realisation of one sample, which hold nothing else of its study.

    The first is ``simulate(*many.realization(number))``; the other its status and its outputs.
    """
    realized = _realized(inputs, t1)

    def simulated(*of_sample: Any) -> Simulation:
        system, base, y0 = realized(*of_sample)
        return simulate(system, base, t1=t1, y0=y0, method=method)

    def numbers(*of_sample: Any) -> tuple[Array, ...]:
        one = simulated(*of_sample)
        return one.status, *(output.number(one, dtype) for output in outputs.values())

    return simulated, numbers


def _realized(inputs: Inputs, t1: float) -> Callable[..., tuple[System, Any, tuple[Number, ...]]]:
    """A function of the key, and of the numbers and the realisation of one sample: its system, base and start."""
    model, paths = inputs.model, tuple(entry.path for entry in inputs.entries)

    def realized(key_data: Array, values: tuple[Array, ...], number: Array, base: PyTree) -> Any:
        system, law, y0 = with_numbers(model, paths, values)
        if base is None:
            key = jax.random.fold_in(jax.random.wrap_key_data(key_data), number)
            base = law.sample(key, t1) if is_random(law) else law
        return system, base, y0

    return realized


def fields_of_outputs(outputs: Mapping[str, Output]) -> Fields:
    """The fields of an `Ensemble` that say what its outputs are."""
    return {
        "output_units": {name: output.unit for name, output in outputs.items()},
        "output_functions": {name: output.function for name, output in outputs.items()},
    }


def outputs_of(ensemble: EnsembleData) -> dict[str, Output]:
    """The outputs of an ensemble, for more samples of it. Raises ValueError where their functions are not known."""
    lost = [name for name in ensemble.output_values if name not in ensemble.output_functions]
    if lost:
        raise ValueError(
            f"This ensemble cannot be extended: the functions of its outputs ({', '.join(lost)}) are not known, since "
            "files do not hold them; simulate more samples with simulate_ensemble(..., first_sample=..., outputs=...), "
            "and concatenate."
        )
    return {
        name: Output(ensemble.output_functions[name], name, ensemble.output_units[name])
        for name in ensemble.output_values
    }


# The samples cut into tasks, which are simulated a few at a time, in threads or in this one.


_Parts = tuple[tuple[EnsemblePart, ...], Values]
"""Of the same samples: the part of each track, and outputs."""
_Simulate = Callable[[int, int], _Parts]
"""Of samples ``first .. first + number - 1``: their parts."""
_Run = Callable[[int, int], tuple[SampleTotals | WatchedTotals, StickStream | DeviceSticks | None]]
"""Of the same samples: their results, and, unless only these are kept, their sticks, each track as a sample."""
_ONE_SIZE = 8192  # samples of a task where tasks of any size share a compilation
_MANY_NUMBERS = 100  # of a state
_LAUNCHED = 1024  # lanes of a loop that is not native, at most
_ROWS, _WIDE_ROWS = 64, 2  # of a task; where its sticks stay on the device


def found_by(
    setup: EnsembleSetup, first: int, accumulators: Sequence[EnsembleAccumulator], threads: int | None,
    chunk: int | None, progress: bool | None, outputs: Mapping[str, Output],
) -> list[Fields]:  # fmt: skip
    """The fields of an `Ensemble` that simulating samples `first`, ``first + 1``, ... and adding them gives.

    `accumulators`: of each track, one where there is one contact. They are given as many samples as they lack.
    """
    samples = accumulators[0].missing
    threads = checks.whole_number("threads", threads) if threads is not None else usual_threads()
    is_recorded = accumulators[0].keep != "totals"
    tasks, started = _Tasks.of(setup, samples, threads, chunk, is_recorded), time.perf_counter()
    at_end = AtEnd(setup, outputs)
    if is_wide():
        parts = _one_by_one(at_end, tasks, accumulators, first, samples)
    else:
        simulate = _simulator(at_end, tasks, accumulators)
        # Compiled before the threads start, so that not each of them compiles the same code.
        with ThreadPoolExecutor(1) as pool:  # Numba compiles while XLA does
            prepared = pool.submit(prepare, setup.dtype) if is_recorded else None
            simulate(0, 0)
            if prepared is not None:
                prepared.result()
        parts = _in_order(simulate, tasks, first, samples)
    compiled = time.perf_counter()
    with progress_bar(progress, samples) as bar:
        found = _add_all(accumulators, parts, bar.advance)
    with progress_bar(progress if at_end.others else False, samples, "sample recorded") as bar:
        _add_outputs(accumulators, first, tuple(outputs), found, at_end.others, threads, bar.advance)
    shared = {
        "threads": min(tasks.threads, -(-samples // tasks.samples_per_task)),
        "compile_seconds": compiled - started,
        "run_seconds": time.perf_counter() - compiled,
    }
    return [accumulator.found() | shared for accumulator in accumulators]


def found_here(
    setup: EnsembleSetup, first: int, accumulator: EnsembleAccumulator, outputs: Mapping[str, Output]
) -> Fields:
    """As `found_by`, simulated in this thread."""
    started, samples = time.perf_counter(), accumulator.missing
    size = _ONE_SIZE if not is_wide() else max(_ONE_SIZE, 1 << (samples - 1).bit_length())
    tasks = _Tasks.of(setup, size, 1, size, accumulator.keep != "totals")
    at_end = AtEnd(setup, outputs)
    found = _add_all((accumulator,), _one_by_one(at_end, tasks, (accumulator,), first, samples))
    _add_outputs((accumulator,), first, tuple(outputs), found, at_end.others)
    spent = time.perf_counter() - started
    return accumulator.found() | {"threads": 1, "compile_seconds": 0.0, "run_seconds": spent}


def _add_all(
    accumulators: Sequence[EnsembleAccumulator],
    done: Iterable[_Parts],
    advance: Callable[[int], object] = lambda number: None,
) -> tuple[np.ndarray, Values]:
    """Add the parts that are `done`, of consecutive samples; returns which have finished, and outputs of all."""
    finished, found = [], []
    for parts, values in done:
        for accumulator, part in zip(accumulators, parts, strict=True):
            accumulator.add(part)
        finished.append(np.equal(parts[0].results.status, Status.FINISHED))
        found.append(values)
        advance(len(finished[-1]))
    return np.concatenate(finished), {name: np.concatenate([values[name] for values in found]) for name in found[0]}


def _add_outputs(
    accumulators: Sequence[EnsembleAccumulator], first: int, names: Sequence[str], found: tuple[np.ndarray, Values],
    others: OutputRunner | None, threads: int = 1, advance: Callable[[int], object] = lambda number: None,
) -> None:  # fmt: skip
    """Add the outputs of samples `first`, ``first + 1``, ..., of which some are `found`, and what `others` finds."""
    finished, values = found
    if others is not None:
        values = values | others.values(first, len(finished), threads, advance)
    for accumulator in accumulators:
        accumulator.add_outputs({name: np.where(finished, values[name], np.nan) for name in names})


class _Tasks(NamedTuple):
    """Division of the samples into tasks of `samples_per_task`, simulated in `rows` of `lanes`."""

    lanes: int
    rows: int
    samples_per_task: int
    threads: int

    @classmethod
    def of(cls, setup: EnsembleSetup, samples: int, threads: int, chunk: int | None, is_recorded: bool) -> "_Tasks":
        if chunk is not None:
            chunk = checks.whole_number("chunk", chunk, maximum=MOST_SAMPLES)
        rows, useful = _ROWS, samples if chunk is None else min(samples, chunk)
        size, usual = partial(lane_size, dtype=setup.dtype, rows=rows, is_recorded=is_recorded), setup.engine.lanes
        if usual == LANES and not is_built_in(setup.engine):
            # Operations of a user's are launched one by one: more lanes hide that, where there are samples for them.
            usual = max(usual, min(_LAUNCHED, 1 << (-(-useful // threads) - 1).bit_length()))
        lanes = lanes_at_once(usual, useful, lambda: size(setup.job(0, 1, 1)))
        if is_wide():
            # Without rows that are not needed; sticks stay on the device until the task is done.
            threads, rows = 1, min(_WIDE_ROWS if is_recorded else _ROWS, -(-useful // lanes))
        if chunk is not None:
            # Lanes beyond the samples are wasted, but up to 4096 let different numbers of samples share a compilation.
            chunk = min(chunk, max(samples, 4096))
            # And of fewer than are computed with at once the numbers are rounded otherwise.
            lanes = min(lanes, max(_FEWEST, 1 << (chunk - 1).bit_length()))
            return cls(lanes, -(-chunk // lanes), chunk, threads)
        if len(setup.inputs.model.y0) > _MANY_NUMBERS and not is_wide():
            # A lane is long enough to keep the processor busy: none is wasted.
            lanes = min(lanes, max(_FEWEST, 1 << (-(-samples // threads) - 1).bit_length()))
        # Small runs are divided into smaller tasks, so that every thread has work.
        fair = lanes * rows if is_wide() else -(-samples // (4 * threads * lanes)) * lanes
        return cls(lanes, rows, min(fair, lanes * rows), threads)

    def of_lanes(self, lanes: int) -> "_Tasks":
        """Smaller tasks, of fewer lanes."""
        return self._replace(lanes=lanes, samples_per_task=min(self.samples_per_task, lanes * self.rows))

    def of_samples(self, first: int, samples: int) -> list[tuple[int, int]]:
        """The first sample of each task and their number, for samples `first`, ``first + 1``, ..."""
        size, end = self.samples_per_task, first + samples
        return [(begin, min(size, end - begin)) for begin in range(first, end, size)]


def _simulator(at_end: AtEnd, tasks: _Tasks, accumulators: Sequence[EnsembleAccumulator]) -> _Simulate:
    """A function that simulates samples ``first .. first + number - 1`` and records what the `accumulators` keep."""
    setup, keeps_sticks = at_end.setup, accumulators[0].keep != "totals"
    recorder = _device_recorder if is_wide() else _recorder
    run = recorder(setup, tasks) if keeps_sticks else _summarizer(setup, tasks)

    def simulate(first: int, number: int) -> _Parts:
        results, sticks = run(first, number)
        totals, values = results, Values()
        if isinstance(results, WatchedTotals):
            totals, values = results.totals, at_end.values(first, number, results)
        totals = jax.tree.map(lambda column: column[:number], totals)

        def part(track: int | None, to: EnsembleAccumulator) -> EnsemblePart:
            results = totals.of_track(track)
            if sticks is None:
                return EnsemblePart(results)
            own = sticks if track is None else sticks.of_track(track, len(setup.tracks))
            return EnsemblePart.of(results, own, setup.t1, setup.numbering, to.wants_sticks, setup.period)

        return tuple(map(part, setup.tracks, accumulators)), values

    return simulate


def _summarizer(setup: EnsembleSetup, tasks: _Tasks) -> _Run:
    """Simulates samples, of which only the totals are kept."""
    summarize = compiled_for(setup.engine, with_records=setup.inputs.has_sampled_law).summarize

    def run(first: int, number: int) -> tuple[SampleTotals | WatchedTotals, None]:
        job = setup.job(first, -(-number // tasks.lanes), tasks.lanes * tasks.rows)
        results = summarize(job, lanes=tasks.lanes, rows=tasks.rows, dtype=setup.dtype)
        return _in_a_row(results), None

    return run


def _in_a_row(results: Any) -> Any:
    """Results (rows, lanes) as those of samples, (samples,)."""
    return jax.tree.map(lambda leaf: np.asarray(leaf).reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:]), results)


def _record_options(tasks: _Tasks, dtype: DType, job: Job) -> dict[str, Any]:
    """What is static in calls of `record`, the same for all jobs."""
    layout, blocks = Layout.of(jax.eval_shape(lambda job: job, job)), blocks_at_once(tasks.lanes, BLOCK)
    return {"layout": layout, "lanes": tasks.lanes, "blocks": blocks, "dtype": dtype}


def _recorder(setup: EnsembleSetup, tasks: _Tasks) -> _Run:
    """Simulates samples, with every stick recorded."""
    _, begin, record = compiled_for(setup.engine, with_records=setup.inputs.has_sampled_law)
    of_thread = threading.local()  # memory of each thread, reused because allocating it for every task is slow
    options: dict[str, Any] = {}

    def run(first: int, number: int) -> tuple[SampleTotals | WatchedTotals, StickStream]:
        if not hasattr(of_thread, "sticks"):
            of_thread.sticks = StickCollector()
        # While a thread is in the loops below, XLA's and Numba's, others can hold Python's lock.
        job = setup.job(first, -(-number // tasks.lanes), tasks.lanes * tasks.rows)
        options.update({} if options else _record_options(tasks, setup.dtype, job))
        task, now, results = begin(job, lanes=tasks.lanes, rows=tasks.rows, dtype=setup.dtype)
        of_thread.sticks.restart(number * len(setup.tracks))
        found = record(task, now, results, **options)
        follow = record.bound((task, now, results), options)
        while True:
            of_thread.sticks.add(*map(np.asarray, (*found.records, found.whose)))
            if not found.goes_on:
                return _in_a_row(found.results), of_thread.sticks.sticks
            found = follow(task, found.now, found.results)

    return run


def _device_recorder(setup: EnsembleSetup, tasks: _Tasks) -> _Run:
    """As `_recorder`, but sticks are collected on the device, and stay there."""
    _, begin, record = compiled_for(setup.engine, with_records=setup.inputs.has_sampled_law)
    lanes, dtype, tracks = tasks.lanes, setup.dtype, len(setup.tracks)
    options: dict[str, Any] = {}

    def run(first: int, number: int) -> tuple[SampleTotals | WatchedTotals, DeviceSticks]:
        job = setup.job(first, -(-number // lanes), lanes * tasks.rows)
        options.update({} if options else _record_options(tasks, dtype, job))
        task, now, results = begin(job, lanes=lanes, rows=tasks.rows, dtype=dtype)
        seen = device_loops.nothing_seen(lanes * tracks, lanes * tasks.rows * tracks, dtype)
        parts, goes_on = list[Any](), True
        while goes_on:
            now, results, (values, ending), whose, unfinished = record(task, now, results, **options)
            *found, told, seen = device_loops.look(values, ending, whose, np.int32(number * tracks), unfinished, seen)
            sticks, goes_on = map(int, np.asarray(told))
            parts.append(device_loops.gather(values, ending, *found, whose, size=device_loops.rounded(sticks)))
        columns = parts[0]
        if len(parts) > 1:
            columns = device_loops.joined(parts, size=device_loops.rounded(sum(len(part[1]) for part in parts)))
        count, last, rest = (np.asarray(column)[: number * tracks] for column in (seen.count, seen.last, seen.rest))
        return _in_a_row(results), DeviceSticks(count, last, rest, *columns)

    return run


def _one_by_one(
    at_end: AtEnd, tasks: _Tasks, accumulators: Sequence[EnsembleAccumulator], first: int, samples: int
) -> Iterator[_Parts]:
    """Simulate all tasks in this thread, smaller ones where memory does not suffice, and yield their parts."""
    simulate, end = _simulator(at_end, tasks, accumulators), first + samples
    while first < end:
        number = min(tasks.samples_per_task, end - first)
        try:
            parts = simulate(first, number)
        except jax.errors.JaxRuntimeError as error:
            tasks = tasks.of_lanes(fewer_lanes(error, tasks.lanes))
            simulate = _simulator(at_end, tasks, accumulators)
            continue
        yield parts
        first += number


def _in_order(simulate: _Simulate, tasks: _Tasks, first: int, samples: int) -> Iterator[_Parts]:
    """Simulate all tasks in threads, a few at a time, and yield the parts in order of the samples."""
    left = tasks.of_samples(first, samples)
    waiting: deque[Future[_Parts]] = deque()
    with ThreadPoolExecutor(min(tasks.threads, len(left))) as pool:
        try:
            for begin, number in left:
                waiting.append(pool.submit(simulate, begin, number))
                if len(waiting) == 2 * tasks.threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
