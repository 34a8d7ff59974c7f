"""Where the samples of an ensemble come from: parts that were joined, and realisations that were given."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._systems.system import System
from .data import EnsembleData, GivenMotions, Origin, single
from .unknown import require_known

Data = TypeVar("Data", bound=EnsembleData)


class Realization(NamedTuple):
    """What `simulate` takes to repeat a sample: ``simulate(system, base, y0=y0, t1=...)``."""

    system: System
    base: Any
    y0: tuple[float, ...]


def origins_of(ensemble: EnsembleData) -> tuple[Origin, ...]:
    """The origins of all parts of an ensemble, one if it was not joined."""
    return ensemble.origins or (Origin(*(getattr(ensemble, name) for name in Origin._fields)),)


def check_dtype(dtype: str) -> None:
    """Raise ValueError if JAX is set to another floating dtype, in which other random numbers would be drawn."""
    if str(jnp.result_type(float)) != dtype:
        raise ValueError(
            f"This ensemble was simulated in {dtype}, and JAX is set to {jnp.result_type(float)}, which draws other "
            f"numbers; call jax.config.update('jax_enable_x64', {dtype == 'float64'}) before anything else."
        )


def parts_of(ensemble: Data) -> list[Data]:
    """Ensembles that draw again what the samples of each part were simulated from; one if it was not joined."""
    return [dataclasses.replace(ensemble, **origin._asdict(), origins=()) for origin in origins_of(ensemble)]


def part_with(ensemble: Data, number: int) -> tuple[Data, int]:
    """The one of `parts_of` with sample `number`, and the number that it has there."""
    for part in parts_of(ensemble):
        if number < part.samples:
            return part, number + part.first_sample
        number -= part.samples
    raise IndexError(number)


def check_extendable(ensemble: EnsembleData) -> None:
    """Raise ValueError unless more samples of `ensemble` can be simulated."""
    if ensemble.origins:
        raise ValueError(
            f"This ensemble was joined from {len(ensemble.origins)} parts of different origin, which cannot be "
            "extended; extend the last part, and concatenate then."
        )
    for what in ("system", "law", "method", *(f"y0[{index}]" for index in range(len(ensemble.y0)))):
        require_known(what, ensemble.y0[int(what[3:-1])] if what.startswith("y0") else getattr(ensemble, what))
    if isinstance(ensemble.law, GivenMotions):
        raise ValueError(
            "This ensemble was made of given simulations, which cannot be extended; simulate more of them, and "
            "concatenate."
        )
    if ensemble.design is not None or not all(entry.is_random for entry in ensemble.inputs.entries):
        raise ValueError(
            "This ensemble has a design or arrays with one number for each sample, which cannot be extended; simulate "
            "more samples with other arrays, and concatenate."
        )
    check_dtype(ensemble.dtype)


def known_inputs(ensemble: EnsembleData) -> dict[str, tuple[np.ndarray, str]]:
    """The numbers that differ from sample to sample, (samples,), and their units, by name.

    None where it is not known what was simulated, or where different numbers differ in joined parts.
    """
    parts = parts_of(ensemble)
    try:
        for part in parts:
            require_whole(part)
            _ = part.inputs  # a design may name numbers of a system that is not known
    except ValueError:
        return {}
    if any(isinstance(part.law, GivenMotions) for part in parts) or len({part.inputs.names for part in parts}) > 1:
        return {}
    units = [entry.about.unit if entry.about else "" for entry in parts[0].inputs.entries]
    return {name: (values, unit) for (name, values), unit in zip(values_of(parts).items(), units, strict=True)}


def values_of(parts: Sequence[EnsembleData]) -> dict[str, np.ndarray]:
    """The values of the numbers that differ from sample to sample in `parts`, the same ones in each, by name."""
    found = [part.inputs.values(jnp.dtype(part.dtype), part.first_sample) for part in parts]
    return {name: np.concatenate([values[name] for values in found]) for name in found[0]}


def require_whole(ensemble: EnsembleData) -> None:
    """Raise ValueError unless the base motion and the start of `ensemble` are known."""
    require_known("base motion", ensemble.law)
    for value in ensemble.y0:
        require_known("initial state", value)


def given_realization(ensemble: EnsembleData, number: int) -> Realization | None:
    """The system, the base motion and the initial state of sample `number` where the base motions were given.

    None where they were not; raises ValueError where they are not known.
    """
    require_whole(ensemble)
    if not isinstance(ensemble.law, GivenMotions):
        return None

    def own(leaf):
        return single(leaf[number]) if np.ndim(leaf) == 1 and len(leaf) == ensemble.samples else leaf

    y0 = tuple(float(np.asarray(value)[number] if np.ndim(value) else value) for value in ensemble.y0)
    return Realization(jax.tree.map(own, ensemble.system), ensemble.law.base(number), y0)
