"""What an ensemble holds, and where its parts come from."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Float, PyTree

from .._dynamics.common.engine import SampleTotals
from .._dynamics.common.method import Exact, Regularized
from .._events.sticks import FlatSticks
from .._excitation.excitation import law_of
from .._numerics.moments import Moments
from .._statistics.accumulator import Numbering, StickAccumulator
from .._status import Status
from .._systems.system import System
from .._types import Array, Number
from .._uncertainty.copula import GaussianCopula
from .._uncertainty.design import Design
from .._uncertainty.inputs import Inputs, Model
from .unknown import Unknown

Keep: TypeAlias = Literal["totals", "statistics", "sticks"]
"""What an ensemble keeps: totals of stick time, sticks and slips only; all statistics; or also every stick."""

Fields: TypeAlias = dict[str, Any]
"""Fields of an `Ensemble` by name."""


class Retained(NamedTuple):
    """The sticks of the first samples that finished, and the `TOTALS` of each."""

    sticks: FlatSticks
    totals: Float[np.ndarray, "samples totals"]


class Origin(NamedTuple):
    """What one part of a joined ensemble was simulated from; fields as those of `Ensemble`, which they replace."""

    system: System
    law: Any
    method: Exact | Regularized | Unknown | None
    y0: tuple[Number, ...]
    key_data: tuple[int, ...] | None
    first_sample: int
    samples: int
    design: Design | None = None
    copula: GaussianCopula | None = None

    def follows(self, before: "Origin") -> bool:
        """Whether these are the samples after those of `before`, of the same system, law, method, start and key."""
        if self.first_sample != before.first_sample + before.samples:
            return False
        return self.key_data is not None and self.same_run(before)

    def same_run(self, other: "Origin") -> bool:
        """Whether the samples were drawn by the same key from the same system, law and start, by the same method."""
        drawn = zip(self[:4], other[:4], strict=True)
        alike = self.design is other.design and same_object(self.copula, other.copula)
        return alike and self.key_data == other.key_data and all(same_object(*pair) for pair in drawn)


def same_object(one: object, other: object) -> bool:
    """Whether two systems, laws, methods or states have the same class and the same numbers."""
    try:
        return type(one) is type(other) and bool(eqx.tree_equal(one, other))
    except (TypeError, ValueError):  # a user's object that cannot be compared
        return one is other


class GivenMotions(eqx.Module):
    """The base motions of all samples, which were given and not drawn: `bases` has a leading axis of samples."""

    bases: PyTree

    def base(self, number: int) -> PyTree:
        """The base motion of sample `number`."""
        return jax.tree.map(lambda leaf: single(leaf[number]) if np.ndim(leaf) else leaf, self.bases)


def single(entry: npt.ArrayLike) -> Array | int | float | bool:
    """One entry of a batch: a plain number, or an array of JAX."""
    return jnp.asarray(entry) if np.ndim(entry) else np.asarray(entry).item()


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class EnsembleData:
    """The fields of an `Ensemble`, which says what they are, and what follows from them alone."""

    system: System
    law: Any
    t1: float
    method: Exact | Regularized | Unknown | None
    numbering: Numbering
    y0: tuple[Number, ...]
    samples: int
    key_data: tuple[int, ...] | None
    dtype: str
    moments: Moments
    status_counts: dict[Status, int]
    near_grazing_samples: int
    accumulator: StickAccumulator | None
    retained: Retained | None
    sample_totals: SampleTotals | None
    flat_sticks: FlatSticks | None
    threads: int
    compile_seconds: float
    run_seconds: float
    first_sample: int = 0
    origins: tuple[Origin, ...] = ()
    design: Design | None = None
    copula: GaussianCopula | None = None
    output_values: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    output_units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    output_functions: Mapping[str, Callable[..., Any]] = dataclasses.field(default_factory=dict)

    @property
    def keep(self) -> Keep:
        """What was kept, as in `simulate_ensemble`."""
        if self.flat_sticks is not None:
            return "sticks"
        return "totals" if self.accumulator is None else "statistics"

    @cached_property
    def inputs(self) -> Inputs:
        """The numbers of system, law and start that differ from sample to sample, and how they are drawn."""
        samples = self.first_sample + self.samples if self.design is None else self.design
        law = self.law if isinstance(self.law, GivenMotions) else law_of(self.law)
        return Inputs.of(Model(self.system, law, self.y0), samples, self._key, self.copula)

    @property
    def _key(self) -> Array | None:
        """The key from which all was drawn, None if there was none."""
        return None if self.key_data is None else jax.random.wrap_key_data(jnp.array(self.key_data, jnp.uint32))

    @property
    def totals(self) -> SampleTotals:
        """The totals of each sample, finished or not (look at ``totals.status``), with ``keep="totals"`` or "sticks".

        Raises:
            ValueError: With ``keep="statistics"``, and for an ensemble of a sweep.
        """
        if self.sample_totals is None:
            raise ValueError(
                'This ensemble did not keep the totals of each sample; call simulate_ensemble(..., keep="totals") or '
                'keep="sticks" (many.moments holds their means and covariances).'
            )
        return self.sample_totals

    def finished_sticks(self) -> FlatSticks:
        """The sticks of the samples that reached ``t1``: of all these, or with ``keep="statistics"`` of the first.

        Raises:
            ValueError: If ``keep="totals"``.
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

    @property
    def _unfinished(self) -> dict[Status, int]:
        """Number of the others by `Status`, where there are any."""
        return {status: count for status, count in self.status_counts.items() if status and count}
