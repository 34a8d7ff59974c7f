"""What an ensemble holds, and where its parts come from; stand-ins for what it does not know."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Literal, NamedTuple, NoReturn, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float, PyTree

from .._dynamics.common.lanes import SampleTotals
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.stick_tables import FlatSlips, slips_among
from .._dynamics.sticks import FlatSticks
from .._excitation.excitation import law_of
from .._foundation.types import Number, Status
from .._numerics.sums import Moments
from .._statistics.quantities import Numbering, StickAccumulator
from .._systems.system import Coordinate, System
from .._uncertainty.design import Design
from .._uncertainty.inputs import GaussianCopula, Inputs, StochasticModel

# Stand-ins for what an ensemble does not know: the system of measured sticks, an object of a user's own class.


@dataclasses.dataclass(frozen=True)
class Unknown:
    """Stands for an object that is not there, because nobody gave it or because its class is a user's own.

    `name`: what it is, or its class. `text`: how it was printed, "" if it was not.
    """

    name: str
    text: str = ""

    def __str__(self) -> str:
        return f"{self.name}, stored as text only: {self.text}" if self.text else self.name


class UnknownSystem(System):
    """Stands for a system that is not there; knows only what the position of a stick is.

    `name`, `text`: as in `Unknown`. `position`: the name, unit and period of the position of a stick.

    Statistics and figures of the sticks work; whatever would simulate raises ValueError.
    """

    name: str = eqx.field(static=True)
    text: str = eqx.field(static=True)
    position: Coordinate = eqx.field(static=True)

    def __str__(self) -> str:
        return str(Unknown(self.name, self.text))

    @property
    def stick_position(self) -> Coordinate:
        return self.position

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        # As the abscissa of figures, the name goes without " when the stick starts".
        return (self.position._replace(name=self.position.name.removesuffix(" when the stick starts")),)

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise ValueError(
            "Argument system must be a system that can be simulated, but this one is not known "
            f"({self}); give the system itself."
        )

    switched_model = time_scales = sizes = check_excitation = _refuse


def require_known(what: str, held: object) -> None:
    """Raise ValueError if `held`, the ensemble's `what`, is a stand-in."""
    if held is None or isinstance(held, (Unknown, UnknownSystem)):
        about = "it has none" if held is None else held
        raise ValueError(
            f"This ensemble does not know its {what} ({about}), so nothing can be simulated or drawn again; call "
            "simulate_ensemble with your own objects."
        )


# What an ensemble holds, and where its parts come from.


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


class Realization(NamedTuple):
    """What `simulate` takes to repeat a sample: ``simulate(system, base, y0=y0, t1=...)``."""

    system: System
    base: Any
    y0: tuple[float, ...]


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
        return Inputs.of(StochasticModel(self.system, law, self.y0), samples, self._key, self.copula)

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

    # Where its samples come from: parts that were joined, and realisations that were given.

    @property
    def _origins(self) -> tuple[Origin, ...]:
        """The origins of all parts, one if it was not joined."""
        return self.origins or (Origin(*(getattr(self, name) for name in Origin._fields)),)

    @cached_property
    def _parts(self) -> "list[EnsembleData]":
        """Ensembles that draw again what the samples of each part were simulated from; one if it was not joined."""
        return [dataclasses.replace(self, **origin._asdict(), origins=()) for origin in self._origins]

    def _require_whole(self) -> None:
        """Raise ValueError unless the base motion and the start are known."""
        require_known("base motion", self.law)
        for value in self.y0:
            require_known("initial state", value)

    def _check_dtype(self) -> None:
        """Raise ValueError if JAX is set to another floating dtype, in which other random numbers would be drawn."""
        if str(jnp.result_type(float)) != self.dtype:
            raise ValueError(
                f"This ensemble was simulated in {self.dtype}, and JAX is set to {jnp.result_type(float)}, which draws "
                f"other numbers; call jax.config.update('jax_enable_x64', {self.dtype == 'float64'}) before anything "
                "else."
            )

    def _check_extendable(self) -> None:
        """Raise ValueError unless more samples can be simulated."""
        if self.origins:
            raise ValueError(
                f"This ensemble was joined from {len(self.origins)} parts of different origin, which cannot be "
                "extended; extend the last part, and concatenate then."
            )
        for what in ("system", "law", "method"):
            require_known(what, getattr(self, what))
        for index, value in enumerate(self.y0):
            require_known(f"y0[{index}]", value)
        if isinstance(self.law, GivenMotions):
            raise ValueError(
                "This ensemble was made of given simulations, which cannot be extended; simulate more of them, and "
                "concatenate."
            )
        if self.design is not None or not all(entry.is_random for entry in self.inputs.entries):
            raise ValueError(
                "This ensemble has a design or arrays with one number for each sample, which cannot be extended; "
                "simulate more samples with other arrays, and concatenate."
            )
        self._check_dtype()

    def _values_by_name(self) -> dict[str, np.ndarray]:
        """The values of the numbers that differ from sample to sample, the same ones in each part, by name."""
        found = [part.inputs.values(jnp.dtype(part.dtype), part.first_sample) for part in self._parts]
        return {name: np.concatenate([values[name] for values in found]) for name in found[0]}

    def _known_inputs(self) -> dict[str, tuple[np.ndarray, str]]:
        """The numbers that differ from sample to sample, (samples,), and their units, by name.

        None where it is not known what was simulated, or where different numbers differ in joined parts.
        """
        parts = self._parts
        try:
            for part in parts:
                part._require_whole()
                _ = part.inputs  # a design may name numbers of a system that is not known
        except ValueError:
            return {}
        if any(isinstance(part.law, GivenMotions) for part in parts) or len({part.inputs.names for part in parts}) > 1:
            return {}
        units = [entry.about.unit if entry.about else "" for entry in parts[0].inputs.entries]
        found = self._values_by_name()
        return {name: (values, unit) for (name, values), unit in zip(found.items(), units, strict=True)}

    def _flat_slips(self) -> FlatSlips:
        """The slips of all samples that finished: what lies between their sticks.

        Raises ValueError unless ``keep="sticks"``.
        """
        sticks, totals = self.require_sticks(), self.totals
        return slips_among(sticks, self.t1, np.asarray(totals.status) == Status.FINISHED)
