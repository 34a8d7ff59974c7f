"""What an ensemble holds, where its parts come from and how they are merged; stand-ins for what it does not know."""

import dataclasses
import warnings
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
from .._dynamics.sticks import NUMBERS, DeviceSticks, FlatSlips, FlatSticks, StickCollector, StickStream, slips_among
from .._excitation.excitation import law_of
from .._foundation.processes import available_memory
from .._foundation.types import DType, Number, Status
from .._numerics.sums import Moments
from .._statistics.quantities import Numbering, StickAccumulator
from .._statistics.totals import TOTALS
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

    def _phases(self) -> np.ndarray:
        """The phase (rad) that a `RandomPhase` of one frequency drew for each sample that finished, (finished,)."""
        found = []
        for part in self._parts:
            part._check_dtype()
            assert part._key is not None
            keys = jax.vmap(jax.random.fold_in, (None, 0))(
                part._key, part.inputs.realization_numbers(part.first_sample, part.samples)
            )
            found.append(jax.vmap(lambda key, law=part.law: law.sample(key).phase)(keys))
        phases = np.concatenate(found)
        return phases[np.asarray(self.totals.status) == Status.FINISHED] if self._unfinished else phases

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


# Parts of an ensemble, which threads simulate, and the accumulator that merges them.


RETAINED = 1_000_000
"""With ``keep="statistics"``, the most sticks that are retained, those of the first samples: for standard errors and
for what cannot be accumulated (ranks, tests)."""
FEWEST = 64
"""The fewest samples that are retained, however many sticks they have."""


class EnsemblePart(NamedTuple):
    """A part of the ensemble: results of consecutive samples, their sticks, and the sums over these sticks."""

    results: SampleTotals
    sticks: FlatSticks | DeviceSticks | None = None
    accumulator: StickAccumulator | None = None
    rest: tuple[np.ndarray, ...] = ()  # `Numbering.rest` of each sample; empty: not known

    @classmethod
    def of(
        cls, results: SampleTotals, sticks: StickStream | DeviceSticks | FlatSticks, t1: float, numbering: Numbering,
        keep_sticks: bool, period: float | None = None,
    ) -> "EnsemblePart":  # fmt: skip
        """The part made from the results and the sticks of consecutive samples, simulated up to `t1` (s).

        `keep_sticks`: whether the part holds the sticks too, not only their sums. `period`: of the positions, which
        become those in ``[0, period)``; None where they have none.
        """
        finished = np.equal(results.status, Status.FINISHED)
        stick_time, slips = (np.asarray(column)[finished] for column in (results.stick_time, results.slips))
        done = StickStream.of(sticks) if isinstance(sticks, FlatSticks) else sticks
        done, whole = done if period is None else done.folded(period), np.all(finished)
        done = done if whole else done.only(finished)
        counted = done if whole else done.of_samples(finished)
        accumulator = StickAccumulator.of(counted, stick_time, slips, t1, numbering)
        return cls(results, done.in_order() if keep_sticks else None, accumulator, numbering.rest(done))


def prepare(dtype: DType) -> None:
    """Compile the loops that collect and count sticks with times of `dtype`, unless they are compiled."""
    sticks = StickCollector()
    sticks.restart(1)
    sticks.add(np.zeros((1, len(NUMBERS), 1), dtype), np.zeros((1, 1), np.int8), np.zeros((1, 1), np.int64))
    one = np.zeros(1)
    EnsemblePart.of(
        SampleTotals(one, one, one, np.full(1, Status.FINISHED), one), sticks.sticks, 1.0, Numbering(1, False), True
    )


class EnsembleAccumulator:
    """Merges the parts of an ensemble, which are added in order of the samples.

    Holds the sums over all samples, and the sticks of the first samples (with ``keep="sticks"``, of all).
    """

    def __init__(self, samples: int, keep: Keep, retained: int | None = None):
        """For `samples` samples, of whose sticks at most `retained` are retained (with ``keep="sticks"`` all).

        `retained`: by default `RETAINED`.
        """
        self.samples = samples
        self.keep: Keep = keep
        self.moments = Moments.of(np.zeros((0, len(TOTALS))))
        self.counts = np.zeros(len(Status), int)
        self.near_grazing_samples = 0
        self.accumulator: StickAccumulator | None = None
        self._kept: list[EnsemblePart] = []
        self._totals: list[SampleTotals] | None = None if keep == "statistics" else []
        self._outputs: list[Mapping[str, np.ndarray]] = []
        self._space = RETAINED if retained is None else retained  # number of sticks that still fit
        self._retained_samples = 0

    @property
    def missing(self) -> int:
        """How many samples have not been added."""
        return self.samples - int(np.sum(self.counts))

    @property
    def wants_sticks(self) -> bool:
        """Whether the sticks of further parts are kept."""
        return self.keep == "sticks" or self._space > 0

    def add(self, part: EnsemblePart) -> None:
        """Add the next part."""
        self.counts += np.bincount(part.results.status, minlength=len(Status))
        self.near_grazing_samples += int(np.count_nonzero(part.results.near_grazing_count))
        self._merge(Moments.of(_totals_of(part)), part.accumulator)
        self._keep_totals(part.results)
        if part.sticks is not None:
            self._keep(part._replace(accumulator=None), part.sticks)

    def add_ensemble(self, other: EnsembleData) -> None:
        """Add all samples of an `Ensemble` that kept the same."""
        self.counts += np.array([other.status_counts[status] for status in Status])
        self.near_grazing_samples += other.near_grazing_samples
        self._merge(other.moments, other.accumulator)
        self._keep_totals(other.sample_totals)
        self.add_outputs(other.output_values)
        if self.keep == "sticks":
            sticks = other.require_sticks()
            self._keep(EnsemblePart(other.totals, rest=other.numbering.rest(sticks)), sticks)
        elif other.retained is not None and self._space > 0:
            totals = other.retained.totals
            none, (time, sticks, slips, *rest) = np.zeros(len(totals), int), totals.T
            part = EnsemblePart(SampleTotals(sticks, slips, time, none, none), rest=tuple(rest))
            # Samples that did not finish took space, too, when they were simulated. Where some that did finish are not
            # retained, there was none left.
            is_whole = len(totals) == other.finished
            self._keep(part, other.retained.sticks, unfinished=other.samples - other.finished, is_whole=is_whole)

    def add_outputs(self, values: Mapping[str, np.ndarray]) -> None:
        """Add the outputs of the next samples, by name."""
        self._outputs.append(values)

    def _merge(self, moments: Moments, accumulator: StickAccumulator | None) -> None:
        self.moments = self.moments.merge(moments)
        if accumulator is not None:
            self.accumulator = accumulator if self.accumulator is None else self.accumulator.merge(accumulator)

    def _keep_totals(self, totals: SampleTotals | None) -> None:
        """Keep the totals of the next samples; where they are not known, those of no sample are kept."""
        if totals is None:
            self._totals = None
        elif self._totals is not None:
            self._totals.append(totals)

    def _keep(
        self, part: EnsemblePart, sticks: FlatSticks | DeviceSticks, unfinished: int = 0, is_whole: bool = True
    ) -> None:
        """Keep the `sticks` of a part, or those of as many of its first samples as there is space for.

        `unfinished`: of samples that are not in it and take space. `is_whole`: whether it has all that finished.
        """
        if self.keep == "sticks":
            here = sticks if isinstance(sticks, FlatSticks) else sticks.head(len(sticks.count))
            self._kept.append(part._replace(sticks=here))
            _check_memory(self._kept, self.samples)
        elif self._space > 0:
            # A sample takes the space of its sticks and one more, so that samples without sticks are limited too.
            fits = int(np.searchsorted(np.cumsum(sticks.count + 1), self._space, side="right"))
            fits = max(fits, min(FEWEST - self._retained_samples, len(sticks.count)))
            self._retained_samples += fits + unfinished
            results = SampleTotals(*(column[:fits].copy() for column in part.results))
            rest = tuple(column[:fits].copy() for column in part.rest)
            fit_all = fits == len(sticks.count)
            self._kept.append(
                EnsemblePart(
                    results, sticks if fit_all and isinstance(sticks, FlatSticks) else sticks.head(fits), rest=rest
                )
            )
            left = self._space - int(sticks.count.sum()) - fits - unfinished if fit_all and is_whole else 0
            self._space = max(left, int(self._retained_samples < FEWEST))

    def found(self) -> Fields:
        """The fields of an `Ensemble` that come from the parts, by name."""
        is_full, kept = (
            self.keep == "sticks",
            [part.sticks for part in self._kept if isinstance(part.sticks, FlatSticks)],
        )
        sticks = FlatSticks.joined(kept) if kept else None
        totals = None
        if self._totals is not None:
            totals = SampleTotals(*map(np.concatenate, zip(*self._totals, strict=True)))
        retained = None
        if sticks is not None:  # of the kept samples that finished
            finished = np.concatenate([np.equal(part.results.status, Status.FINISHED) for part in self._kept])
            retained = Retained(sticks.only(finished), np.concatenate([_totals_of(part) for part in self._kept]))
        return {
            "moments": self.moments,
            "status_counts": {status: int(self.counts[status]) for status in Status},
            "near_grazing_samples": self.near_grazing_samples,
            "accumulator": self.accumulator,
            "retained": retained,
            "sample_totals": totals,
            "flat_sticks": sticks if is_full else None,
            "output_values": {
                name: np.concatenate([part[name] for part in self._outputs])
                for name in (self._outputs[0] if self._outputs else ())
            },
        }


def _totals_of(part: EnsemblePart) -> np.ndarray:
    """The `TOTALS` of each finished sample, (finished samples, 5)."""
    results = part.results
    finished = results.status == Status.FINISHED
    none = np.zeros(len(finished))
    columns = (results.stick_time, results.sticks, results.slips, *(part.rest or (none, none)))
    return np.stack([np.asarray(column, np.float64) for column in columns], axis=1)[finished]


_MUCH = 2e9  # bytes


def _check_memory(kept: list[EnsemblePart], samples: int) -> None:
    """Say early how much memory the sticks will take: a warning where it is much, ValueError where it is not there.

    Joining them takes twice their size.
    """
    if len(kept) % 64 != 1:
        return
    done = sum(len(part.results.status) for part in kept)
    size = sum(column.nbytes for part in kept for column in (*part.results, *(part.sticks or ())))
    expected, there = 2 * size / done * samples, available_memory() + size
    todo = f"keeping the sticks of {samples:,} samples takes about {expected / 1e9:.1f} GB"
    if expected > there:
        raise ValueError(
            f'Argument keep must be "statistics" for so many samples: {todo}, and this machine has '
            f"{there / 1e9:.1f} GB free."
        )
    if len(kept) == 1 and expected > _MUCH:
        warnings.warn(
            f'The sticks need much memory: {todo} of it; keep="statistics" takes little, whatever the number of '
            "samples.",
            RuntimeWarning,
            stacklevel=2,
        )
