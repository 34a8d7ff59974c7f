"""The checked arguments of an ensemble, the engine that simulates its samples, and the user's outputs of them."""

import dataclasses
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from .._dynamics.common.lanes import Engine, Job, VaryingEngine, with_leaves
from .._dynamics.common.method import Exact, Regularized, check_method, state_of, working_dtype
from .._dynamics.engine_choice import engines_of_all, lanes_for, sample_engines
from .._dynamics.regularized.engine import AdaptiveBatch
from .._dynamics.regularized.solve import FixedEngine
from .._dynamics.simulate import Output, simulate
from .._dynamics.simulation import Simulation
from .._dynamics.sticks import ALL
from .._excitation.excitation import is_random, key_data_for, law_of
from .._foundation import checks
from .._foundation.types import AnyArray, DType, Status
from .._statistics.accumulator import Numbering
from .._statistics.quantities import DISTRIBUTIONS
from .._statistics.totals import STATISTICS
from .._systems.system import require_system
from .._uncertainty.design import Design
from .._uncertainty.inputs import GaussianCopula, Inputs, StochasticModel
from .data import EnsembleData, Fields, Keep

# The checked arguments of an ensemble, and the engine that simulates its samples.


MOST_SAMPLES = 2**31  # samples are numbered in 32 bits


@dataclasses.dataclass(frozen=True, eq=False)
class EnsembleSetup:
    """The checked arguments, which all chunks share.

    - `engine`: that of every sample. `leaf_numbers`: its leaves that differ from sample to sample.
    - `inputs`: the numbers that differ, as they were given.
    """

    engine: Engine | AdaptiveBatch
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
            raise ValueError(
                f"Argument first_sample must be 0 with a design, whose rows are all samples, but {first_sample} was "
                "given."
            )
        if not (correlation is None or isinstance(correlation, GaussianCopula)):
            raise checks.refused("correlation", "be a GaussianCopula(names, correlation)", correlation)
        checks.chosen("keep", keep, get_args(Keep))
        dtype = working_dtype(stacklevel=5)
        inputs = Inputs.of(model._replace(law=law_of(model.law)), total, key, correlation)
        inputs.check(dtype)
        first = inputs.of_sample(0, dtype)
        require_system(first.system)
        first = first._replace(y0=state_of(first.system, first.y0))
        inputs = inputs.with_start(first.y0)
        random = inputs.are_random or is_random(first.law)
        if random and key is None:
            raise ValueError(
                "Argument key must be a key such as jax.random.key(0) where law, system or y0 are random, but None "
                "was given."
            )
        # The engine of all samples, and which of its leaves differ; the method with every option filled in, but those
        # that differ from sample to sample as they were given.
        law = inputs.realization_of(0, first.law, t1) if inputs.has_sampled_law else first.law
        engine, leaf_numbers = lanes_for(first.system, law, method, t1, first.y0, dtype), ()
        if inputs.entries or inputs.has_sampled_law:
            engine, leaf_numbers, *_ = engines_of_all(inputs, method, t1, dtype)
        if isinstance(engine, (FixedEngine, AdaptiveBatch)):
            differs = object()
            marked = jax.tree.leaves(with_leaves(engine, leaf_numbers, [differs] * len(leaf_numbers)).method)
            method = method if any(leaf is differs for leaf in marked) else engine.method
        if leaf_numbers and isinstance(engine, Engine):
            engine = VaryingEngine(engine, leaf_numbers)
        if keep != "totals" and isinstance(engine, Engine):
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
        tracks = self.engine.tracks if isinstance(self.engine, Engine) else None
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

    def job(self, first: int, used_rows: int, most_samples: int) -> Job:
        """The job for samples `first`, ``first + 1``, ... in `used_rows` rows of lanes, at most `most_samples`."""
        assert isinstance(self.engine, Engine)
        varying = self.varying_leaves(first, most_samples)
        realization = None
        if not self.inputs.has_own_realizations:
            realization = self.inputs.realization_numbers(first, most_samples)
        return Job(self.engine, self.key_data, np.uint32(first), np.int32(used_rows), varying, realization)


# Outputs of a user's own for the samples of an ensemble: each is simulated once more, and recorded, for its functions.
#
# Samples are taken in batches of one size whose first number is a multiple of it, whatever the chunk, the threads or
# the first sample of the ensemble: a compiled function of another size could round otherwise, so the numbers of a
# sample depend on its key and number only.


NO_OUTPUTS: Mapping[str, Output] = {}
TAKEN = {
    **{one.name: "a quantity of sticks, slips or samples" for one in DISTRIBUTIONS},
    **{one.name: "a statistic" for one in STATISTICS.values()},
    **dict.fromkeys(("samples", "status", "quantile", "order", "point"), "a part of results"),
}
"""Names that outputs cannot have, and what they are those of."""

Values = dict[str, np.ndarray]
"""Numbers of consecutive samples by the name of the output, (samples,); NaN for those that did not finish."""

_LANES, _FEWEST = 256, 8
_MEMORY = 2**27  # bytes of the recorded trajectories of a batch
_EAGER_LANES = 64


class OutputRunner:
    """Finds the `outputs` of the samples of an ensemble."""

    def __init__(self, setup: EnsembleSetup, outputs: Mapping[str, Output]):
        """Traces every function once. Raises ValueError for one that does not return a number."""
        self._setup, self._outputs = setup, dict(outputs)
        self._key = jax.random.wrap_key_data(jnp.asarray(setup.key_data, jnp.uint32))
        values, number, base = self._arguments(0, 1)
        one = jax.tree.map(lambda leaf: leaf[0], (values, number, base))
        self._begun: dict[int, list[np.ndarray]] = {}
        try:
            shapes = jax.eval_shape(lambda *one: eqx.filter(self._simulated(*one), eqx.is_array), *one)
        except ValueError:
            # How many steps or intervals there are depends on numbers that differ from sample to sample: they are known
            # where JAX makes a batch of them outside jit.
            self._lanes, self._run = _EAGER_LANES, self._at_once
            self._begun[0] = self._batch(0)
            return
        size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes))
        fits = max(_FEWEST, min(_LANES, _MEMORY // max(size, 1)))
        self._lanes, self._run = 1 << (fits.bit_length() - 1), jax.jit(self._at_once)
        jax.eval_shape(lambda *one: self._numbers(self._simulated(*one)), *one)

    def values(self, first: int, samples: int, threads: int = 1) -> Values:
        """The outputs of samples ``first .. first + samples - 1``."""
        lanes, end = self._lanes, first + samples
        begins = range(first - first % lanes, end, lanes)
        with ThreadPoolExecutor(max(1, min(threads, len(begins)))) as pool:
            batches = list(pool.map(self._batch, begins))
        own = slice(first - begins.start, end - begins.start)
        columns = zip(*batches, strict=True)
        return {name: np.concatenate(column)[own] for name, column in zip(self._outputs, columns, strict=True)}

    def _batch(self, first: int) -> list[np.ndarray]:
        if first in self._begun:
            return self._begun[first]
        arguments = self._arguments(first, self._lanes)
        found = [np.asarray(leaf) for leaf in self._run(*arguments)]
        short = found[0] == Status.OUT_OF_STEPS
        if np.any(short) and self._run is not self._at_once:
            # Outside jit a simulation that has too few steps is given more.
            again = [np.asarray(leaf) for leaf in self._at_once(*arguments)]
            found = [np.where(short, new, old) for new, old in zip(again, found, strict=True)]
        status, *numbers = found
        finished = status == Status.FINISHED
        return [np.where(finished, np.asarray(column, np.float64), np.nan) for column in numbers]

    def _arguments(self, first: int, number: int) -> tuple[tuple[AnyArray, ...], Array, PyTree]:
        """What differs among samples `first`, ``first + 1``, ...: their numbers, and their realisations."""
        setup = self._setup
        values = tuple(jnp.asarray(column) for column in setup.inputs.drawn(first, number, setup.dtype))
        numbers = jnp.asarray(setup.inputs.realization_numbers(first, number))
        return values, numbers, setup.inputs.realizations(first, number, setup.t1)

    def _at_once(self, values: tuple[AnyArray, ...], numbers: Array, bases: PyTree) -> tuple[Array, ...]:
        """The status and the outputs of a batch of samples, (samples,) each."""
        return jax.vmap(lambda *one: self._numbers(self._simulated(*one)))(values, numbers, bases)

    def _simulated(self, values: tuple[AnyArray, ...], number: Array, base: PyTree) -> Simulation:
        """One sample: ``simulate(*many.realization(number))``."""
        setup = self._setup
        system, law, y0 = setup.inputs.filled(values)
        if base is None:
            base = law.sample(jax.random.fold_in(self._key, number), setup.t1) if is_random(law) else law
        return simulate(system, base, t1=setup.t1, y0=y0, method=setup.method)

    def _numbers(self, one: Simulation) -> tuple[Array, ...]:
        dtype = self._setup.dtype
        return one.status, *(output.number(one, dtype) for output in self._outputs.values())


def only(finished: np.ndarray, values: Values) -> Values:
    """The values of the samples that `finished`, (samples,), and NaN for the others."""
    return {name: np.where(finished, column, np.nan) for name, column in values.items()}


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


def runner_for(setup: EnsembleSetup, outputs: Mapping[str, Output]) -> Callable[..., Values]:
    """A function of the first sample, their number and that of threads; without outputs it simulates nothing."""
    if not outputs:
        return lambda first, samples, threads=1: {}
    return OutputRunner(setup, outputs).values
