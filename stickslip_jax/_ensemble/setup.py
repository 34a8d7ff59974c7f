"""The checked arguments of an ensemble, and the engine that simulates its samples."""

import dataclasses
from typing import Any, get_args

import jax
import numpy as np

from .. import _checks
from .._dynamics.common.engine import Engine
from .._dynamics.common.lanes import Job
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.validation import check_method, state_of, working_dtype
from .._dynamics.common.varying import VaryingEngine, with_leaves
from .._dynamics.engine_choice import engines_of_all, lanes_for, sample_engines
from .._dynamics.regularized.engine import AdaptiveBatch, FixedEngine
from .._events.stick_quantities import ALL
from .._excitation.excitation import is_random, key_data_for, law_of
from .._statistics.accumulator import Numbering
from .._systems.system import require_system
from .._types import AnyArray, Array, DType
from .._uncertainty.copula import GaussianCopula
from .._uncertainty.design import Design
from .._uncertainty.inputs import Inputs, Model
from .data import Fields, Keep

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
        model: Model,
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
        if _checks.holds_traced(*model, t1, key, method):
            raise ValueError(
                "Arguments of simulate_ensemble must be numbers, but JAX is tracing them; inside jit, vmap or grad use "
                "jax.vmap over simulate(system, law.sample(key, t1, capacity=...), ...)."
            )
        check_method(method)
        _checks.positive("t1", t1, "s")
        number = len(samples) if isinstance(samples, Design) else samples
        number = _checks.whole_number("samples", number, maximum=MOST_SAMPLES)
        first_sample = _checks.whole_number("first_sample", first_sample, minimum=0, maximum=MOST_SAMPLES - number)
        total = samples if isinstance(samples, Design) else first_sample + number
        if isinstance(samples, Design) and first_sample:
            raise ValueError(
                f"Argument first_sample must be 0 with a design, whose rows are all samples, but {first_sample} was "
                "given."
            )
        if not (correlation is None or isinstance(correlation, GaussianCopula)):
            raise _checks.refused("correlation", "be a GaussianCopula(names, correlation)", correlation)
        _checks.chosen("keep", keep, get_args(Keep))
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
        engine, leaf_numbers, method = _engine_of(inputs, first, method, t1, dtype)
        if keep != "totals" and isinstance(engine, Engine):
            engine = engine.asked(ALL)
        key_data, period = key_data_for(first.law, key), first.system.stick_position.period
        setup = cls(engine, leaf_numbers, inputs, method, key_data, random, dtype, float(t1), numbering, period)
        if not of_every_contact:
            setup._require_one_track()
        return setup

    @property
    def tracks(self) -> tuple[int | None, ...]:
        """What sticks are counted of: every contact, and last all at once; (None,) where it is one thing."""
        tracks = self.engine.tracks if isinstance(self.engine, Engine) else None
        return (None,) if tracks is None else tuple(range(tracks))

    def _require_one_track(self) -> None:
        """Raise ValueError for a system with a list of contacts that does not say whose sticks are counted."""
        if self.tracks != (None,):
            raise ValueError(
                f"Argument system must say whose sticks are counted, but a system with {len(self.tracks) - 1} contacts "
                "was given: take system.of_contact(number) or system.of_all_contacts(), or call simulate_contacts, "
                "which counts those of every contact."
            )

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


def _engine_of(
    inputs: Inputs, first: Model, method: Exact | Regularized, t1: float, dtype: DType
) -> tuple[Any, tuple[int, ...], Exact | Regularized]:
    """The engine of all samples, which of its leaves differ, and the method with every option filled in.

    Options that differ from sample to sample stay as they were given. `first`: the model of the first sample.
    """
    law = inputs.realization_of(0, first.law, t1) if inputs.has_sampled_law else first.law
    template, leaf_numbers = lanes_for(first.system, law, method, t1, first.y0, dtype), ()
    if inputs.entries or inputs.has_sampled_law:
        template, leaf_numbers, *_ = engines_of_all(inputs, method, t1, dtype)
    if isinstance(template, (FixedEngine, AdaptiveBatch)):
        differs = object()
        marked = jax.tree.leaves(with_leaves(template, leaf_numbers, [differs] * len(leaf_numbers)).method)
        method = method if any(leaf is differs for leaf in marked) else template.method
    if leaf_numbers and isinstance(template, Engine):
        return VaryingEngine(template, leaf_numbers), leaf_numbers, method
    return template, leaf_numbers, method
