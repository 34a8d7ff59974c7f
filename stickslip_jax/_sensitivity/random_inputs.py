"""Engines whose samples differ in numbers drawn from distributions, with derivatives by the distributions' parameters.

A number is drawn by inversion, ``icdf(u)`` of a uniform ``u`` that belongs to the sample. So a parameter of the
distribution moves it smoothly, and derivatives of an expectation are those of the simulation, summed over the samples
(reparameterisation).
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .._dynamics.common.engine import Engine
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.varying import VaryingEngine
from .._dynamics.engine_choice import engines_of_all, sample_engines
from .._types import AnyArray, DType
from .._uncertainty.inputs import Inputs
from .._uncertainty.numbers import Path
from .._uncertainty.random_number import RandomNumber
from .boundaries import BoundaryDistances

_Made = TypeVar("_Made", bound=Engine)


class RandomEngine(VaryingEngine):
    """An engine with numbers of its own for every sample, some of them drawn anew from `sources`.

    `sources`: for each varying leaf a distribution, to be differentiated by its parameters; None where it is given.
    """

    sources: tuple[RandomNumber | None, ...]

    def columns(self, varying: tuple[AnyArray, ...]) -> tuple[AnyArray, ...]:
        """The varying leaves (samples,); where there is a source, `varying` holds uniform numbers."""
        return tuple(
            column if source is None else jnp.asarray(source.icdf(jnp.asarray(column)), column.dtype)
            for source, column in zip(self.sources, varying, strict=True)
        )

    def drawn(self, varying: tuple[AnyArray, ...]) -> tuple["RandomEngine", tuple[AnyArray, ...]]:
        """The engine without sources, and its varying leaves."""
        return dataclasses.replace(self, sources=(None,) * len(self.sources)), self.columns(varying)

    def after_block(self, samples: PyTree, motions: PyTree, records: PyTree) -> PyTree:
        return self.template.after_block(self.constants(samples), motions, records)

    def distances(self, samples: PyTree, candidates: PyTree) -> BoundaryDistances:
        """As `StepRecording.distances`."""
        return self.template.distances(self.constants(samples), candidates)


class RandomInputs(NamedTuple):
    """The inputs of a sensitivity problem and the engine of all samples.

    `origins`: which input each place of the engine holds; None for what follows from several, such as a time step.
    """

    inputs: Inputs
    engine: RandomEngine
    origins: tuple[int | None, ...]
    method: Exact | Regularized
    t1: float
    dtype: DType

    @classmethod
    def of(
        cls, inputs: Inputs, method: Exact | Regularized, t1: float, dtype: DType, paths: tuple[Path, ...]
    ) -> "RandomInputs":
        """The engine of all samples of `inputs`; distributions with parameters at `paths` are its sources."""
        template, leaf_numbers, _, origins = engines_of_all(inputs, method, t1, dtype)

        def source(origin):
            entry = None if origin is None else inputs.entries[origin]
            varied = entry is not None and any(path[: len(entry.path)] == entry.path for path in paths)
            return entry.source if varied and entry is not None else None

        engine = RandomEngine(template, leaf_numbers, tuple(map(source, origins)))
        return cls(inputs, engine, origins, method, t1, dtype)

    def varying_leaves(self, first: int, number: int) -> tuple[AnyArray, ...]:
        """What the engine needs of samples `first` to ``first + number - 1``, one array for each place."""
        varying = sample_engines(self.inputs, self.method, self.t1, self.dtype, first, number).varying
        uniforms = self.inputs.uniforms(first, number, self.dtype)
        drawn = (None if source is None or origin is None else uniforms[origin]
                 for source, origin in zip(self.engine.sources, self.origins, strict=True))  # fmt: skip
        return tuple(column if uniform is None else uniform for column, uniform in zip(varying, drawn, strict=True))

    def path(self, path: Path, in_engine: Path) -> Path:
        """The path in `engine` of the number at `path` of the model, which a `single_engine` has at `in_engine`."""
        for place, origin in enumerate(self.origins):
            entry = None if origin is None else self.inputs.entries[origin]
            if entry is not None and path[: len(entry.path)] == entry.path:
                return ("sources", place, *path[len(entry.path) :])
        return ("template", *in_engine)

    @property
    def only_in_start(self) -> bool:
        """Whether nothing but the initial state differs from sample to sample."""
        return all(entry.path[0] == "y0" for entry in self.inputs.entries)

    @property
    def in_lanes(self) -> bool:
        """Whether all sources can be drawn from in a compiled function."""
        return all(source is None or source.in_lanes for source in self.engine.sources)


def wrapped(engine: Engine, make: Callable[[Any], _Made]) -> _Made | RandomEngine:
    """What `make` makes of an engine; of a `RandomEngine`, one with the same varying leaves whose template `make` made.

    `make` must keep the engine's leaves as the first ones of its result.
    """
    if not isinstance(engine, RandomEngine):
        return make(engine)
    template = make(engine.template)
    kept = jax.tree.leaves(engine.template)
    assert all(one is other for one, other in zip(kept, jax.tree.leaves(template), strict=False))
    return dataclasses.replace(engine, template=template)


def single_engine(engine: Engine) -> Any:
    """The engine of a single sample, for what all samples share."""
    return engine.template if isinstance(engine, RandomEngine) else engine


def constants_of(engine: Engine, sample: PyTree) -> PyTree:
    """The constants of samples as the `single_engine` knows them."""
    return engine.constants(sample) if isinstance(engine, RandomEngine) else sample


def wrapped_path(path: Path) -> Path:
    """The path of a number whose engine has become the field `engine` of another, by `wrapped`."""
    if path[0] == "sources":
        return path
    return ("template", "engine", *path[1:]) if path[0] == "template" else ("engine", *path)
