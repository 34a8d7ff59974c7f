"""Outputs of a user's own for the samples of an ensemble: each is simulated once more, and recorded, for its functions.

Samples are taken in batches of one size whose first number is a multiple of it, whatever the chunk, the threads or the
first sample of the ensemble: a compiled function of another size could round otherwise, so the numbers of a sample
depend on its key and number only.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .._excitation.excitation import is_random
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums
from .._simulation.call import simulate
from .._simulation.outputs import Output
from .._simulation.result import Simulation
from .._statistics.clusters import Clusters
from .._statistics.distribution import BINS, Distribution
from .._statistics.quantities import DISTRIBUTIONS
from .._statistics.source import origin_of
from .._statistics.totals import STATISTICS
from .._status import Status
from .._types import AnyArray, Array
from .data import EnsembleData, Fields
from .setup import EnsembleSetup

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


def distributions_of(ensemble: EnsembleData) -> dict[str, Distribution]:
    """The distribution over the finished samples of each output; see `Ensemble.outputs`."""
    return {name: _distribution(ensemble, name, column) for name, column in ensemble.output_values.items()}


def without_value(ensemble: EnsembleData) -> dict[str, int]:
    """For each output how many of the finished samples have no finite value, where there are any."""
    counts = {
        name: ensemble.finished - int(np.count_nonzero(np.isfinite(column)))
        for name, column in ensemble.output_values.items()
    }
    return {name: count for name, count in counts.items() if count}


def _distribution(ensemble: EnsembleData, name: str, column: np.ndarray) -> Distribution:
    values = column[np.isfinite(column)]
    is_whole = len(values) > 0 and bool(np.all(values == np.round(values)) and np.all(np.abs(values) < 2**31))
    bins = DyadicCounts.of(values, BINS, finest=0) if is_whole else DyadicCounts.of(values, BINS)
    clusters = Clusters(values, np.arange(len(values)), ensemble.finished, ensemble.finished)
    return Distribution(
        name, ensemble.output_units.get(name, "1"), ensemble.finished, PowerSums.of(values), bins, clusters,
        is_whole=is_whole, origin=origin_of(ensemble),
    )  # fmt: skip


def runner_for(setup: EnsembleSetup, outputs: Mapping[str, Output]) -> Callable[..., Values]:
    """A function of the first sample, their number and that of threads; without outputs it simulates nothing."""
    if not outputs:
        return lambda first, samples, threads=1: {}
    return OutputRunner(setup, outputs).values
