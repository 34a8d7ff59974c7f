"""`Sweep`: a parameter sweep, on a grid of parameters or a design; what it simulates, checked, and cut into tasks."""

import dataclasses
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.simulate import Output, Outputs, checked_outputs
from .._ensemble.call import simulate_ensemble
from .._ensemble.data import Keep
from .._ensemble.encoding import SweepError
from .._ensemble.points import Points, Setter, SweepSetting, check_points, points_of, setter_of, setting_of
from .._ensemble.result import Ensemble
from .._ensemble.setup import MOST_SAMPLES, TAKEN, EnsembleSetup, fields_of_outputs, runner_for
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.processes import require_memory, require_threads_of_jax
from .._foundation.types import InitialState
from .._numerics.elementary import key_data_of
from .._statistics.quantities import DISTRIBUTIONS, Numbering, SampledQuantity
from .._statistics.totals import DIFFERENTIABLE, STATISTICS, StatisticOfTotals
from .._systems.system import System
from .._uncertainty.design import Design
from .._uncertainty.numbers import parameters_of

if TYPE_CHECKING:
    import distributed
    import xarray


# What a sweep simulates, checked: its setting, points and options, and the tasks into which its work is divided.


Derivative = tuple[str, tuple[str, ...]]
"""A statistic, and the parameters by which it is differentiated."""

_SMALLEST_BATCH, _LARGEST_BATCH, _BATCHES = 1024, 16_384, 64
_MOST_BATCHES = 10_000_000
RETAINED = 20_000
"""The most sticks of a point that are kept for standard errors."""


class Task(NamedTuple):
    """A part of the work, done by one thread: samples ``first .. end - 1`` of a point; or, where `derivative` is not
    None, the derivatives of that number at the point, from all its samples.
    """

    point: int
    first: int
    end: int
    derivative: int | None = None

    @property
    def samples(self) -> int:
        """How many samples it simulates."""
        return self.end - self.first


@dataclasses.dataclass(eq=False)
class Plan:
    """The arguments of a `Sweep`, which every worker needs. Raises ValueError, with their names, for unsuitable ones.

    What may be given in several ways was checked before: `checked_keep`, `checked_statistics` and the like.
    """

    setting: SweepSetting
    points: Points
    t1: float
    samples: int
    key_data: tuple[int, ...] | None
    keep: Keep
    numbering: Numbering
    statistics: tuple[str, ...]
    derivatives: tuple[Derivative, ...]
    independent: bool
    standard_errors: dict[str, float]
    realizations: int
    batch: int
    dtype: str
    outputs: dict[str, Output] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        checks.truth("independent", self.independent)
        checks.positive("t1", self.t1, "s")
        self.t1, self.independent = float(self.t1), bool(self.independent)
        self.samples = checks.whole_number("samples", self.samples, maximum=MOST_SAMPLES)
        self.realizations = checks.whole_number("realizations", self.realizations, minimum=0)
        require_memory("realizations", 4096.0 * self.realizations * self.points.number, "the times of their sticks")
        self.batch = checks.whole_number("batch", self.batch, maximum=MOST_SAMPLES)
        if self.points.number * -(-self.samples // self.batch) > _MOST_BATCHES:
            raise checks.refused("batch", f"be larger, for at most {_MOST_BATCHES:,} batches in all", self.batch)

    @property
    def output_code(self) -> list[list[str]]:
        """Name, unit and a check sum of the code of each output: functions themselves are not stored."""
        return [[name, output.unit, output.code_sum] for name, output in sorted(self.outputs.items())]

    @cached_property
    def _with_values(self) -> Setter:
        return setter_of(self.setting, self.points.parameters)

    def setting_at(self, point: int) -> SweepSetting:
        """What is simulated at a point."""
        return self._with_values(self.points.values(point))

    def key_at(self, point: int) -> Array | None:
        """The key of a point: the sweep's, or one that depends on the values of the parameters there too."""
        if self.key_data is None:
            return None
        key = jax.random.wrap_key_data(jnp.array(self.key_data, jnp.uint32))
        if self.independent:
            identity = self.points.identity(point)
            for word in (identity[:8], identity[8:]):
                key = jax.random.fold_in(key, int(word, 16))
        return key

    def run_at(self, point: int) -> EnsembleSetup:
        """The checked ensemble of a point."""
        setting = self.setting_at(point)
        return EnsembleSetup.checked(
            setting.model, self.t1, self.samples, 0, self.key_at(point), None,
            setting.method, self.keep, self.numbering,
        )  # fmt: skip

    def fields_at(self, point: int) -> dict[str, Any]:
        """The fields of the `Ensemble` of a point that its arguments are, without what only simulating it needs."""
        fields = {name: getattr(self, name) for name in ("t1", "numbering", "dtype")}
        fields |= fields_of_outputs(self.outputs)
        return {**self.setting_at(point)._asdict(), **fields, "key_data": key_data_in(self.key_at(point))}

    def check(self) -> None:
        """Check every point as far as that is possible without simulating. Raises ValueError for what does not fit."""
        check_points(self._with_values, self.points, self.setting_at)
        for _, wrt in self.derivatives:
            parameters_of(self.setting_at(0).model._asdict(), wrt)
        try:
            runner_for(self.run_at(0), self.outputs)
        except ValueError as error:
            raise ValueError(f"The point {self.points.described(0)} cannot be simulated: {error}") from error


def usual_batch(points: int, samples: int) -> int:
    """How many samples make a batch: few batches are too coarse for several threads, many cost time for each."""
    fair = -(-points * samples // (_BATCHES * 256)) * 256
    return min(max(fair, _SMALLEST_BATCH), _LARGEST_BATCH)


def checked_statistics(statistics: object, keep: Keep) -> tuple[str, ...]:
    """The names of what is estimated; None for all that `keep` allows. Raises ValueError for other names."""
    more = [] if keep == "totals" else [quantity.name for quantity in DISTRIBUTIONS]
    known = list(dict.fromkeys([*STATISTICS, *more]))  # the stick fraction has a distribution too
    if statistics is None:
        return tuple(known)
    names = [statistics] if isinstance(statistics, str) else statistics
    names = [getattr(name, "name", name) for name in names] if isinstance(names, (list, tuple)) else [names]
    for name in names:
        if not isinstance(name, str) or name not in known:
            hint = 'keep="statistics" offers more' if keep == "totals" else ""
            raise checks.refused("statistics", f"be names out of {', '.join(map(repr, known))}", name, hint)
    return tuple(dict.fromkeys(names))


def checked_derivatives(sensitivities: object) -> tuple[Derivative, ...]:
    """The derivatives as pairs of names. Raises ValueError for anything else."""
    known = [statistic.name for statistic in DIFFERENTIABLE]
    found = []
    entries = sensitivities if isinstance(sensitivities, Iterable) else [sensitivities]  # which is no pair
    if isinstance(sensitivities, (str, bytes, Mapping)) or hasattr(sensitivities, "__array__"):
        entries = [sensitivities]
    for entry in entries:
        pair = tuple(entry) if isinstance(entry, (list, tuple)) and len(entry) == 2 else (entry, None)
        statistic, wrt = getattr(pair[0], "name", pair[0]), pair[1]
        wrt = (wrt,) if isinstance(wrt, str) else tuple(wrt) if isinstance(wrt, (list, tuple)) else ()
        named = isinstance(statistic, str) and all(isinstance(name, str) for name in wrt)
        if not named or statistic not in known or not wrt:
            wanted = (
                "hold pairs of a statistic and the parameter, or parameters, by which it is differentiated, such as "
                f"('mean_stick_duration', 'mu'), with a statistic out of {', '.join(map(repr, known))}"
            )
            raise checks.refused("sensitivities", wanted, entry)
        found.append((statistic, wrt))
    return tuple(dict.fromkeys(found))


def checked_errors(standard_error: object, statistics: tuple[str, ...]) -> dict[str, float]:
    """The wanted standard errors by statistic. Raises ValueError for anything else."""
    if standard_error is None:
        return {}
    if not isinstance(standard_error, dict) or not standard_error:
        wanted = "be a dict from names of statistics to standard errors, such as {'mean_stick_duration': 0.01}"
        raise checks.refused("standard_error", wanted, standard_error)
    for name, value in standard_error.items():
        if name not in STATISTICS or name not in statistics:
            allowed = ", ".join(repr(one) for one in statistics if one in STATISTICS)
            raise checks.refused("standard_error", f"name statistics out of {allowed}", name)
        checks.positive(f"standard_error[{name!r}]", value)
    return {name: float(value) for name, value in standard_error.items()}


def checked_keep(keep: object) -> Keep:
    """`keep`, "statistics" or "totals". Raises ValueError for anything else."""
    allowed = [name for name in get_args(Keep) if name != "sticks"]
    if not isinstance(keep, str) or keep not in allowed:
        hint = "every stick of a point comes from sweep.ensemble_at(mu=...)"
        raise checks.refused("keep", f"be one of {', '.join(map(repr, allowed))}", keep, hint)
    return cast(Keep, keep)


def key_data_in(key: Array | None) -> tuple[int, ...] | None:
    """The numbers of `key`; None where there is none."""
    return None if key is None else tuple(int(word) for word in np.asarray(key_data_of(key)))


# The sweep as a user has it.


_Values = Sequence[object] | np.ndarray
Over = Mapping[str, _Values] | Mapping[tuple[str, ...], _Values] | Mapping[str | tuple[str, ...], _Values] | Design
Folder = str | os.PathLike[str]


class Sweep:
    """A parameter sweep: the same ensemble at many values of its parameters::

        sweep = ss.Sweep(
            system, law, over={"mu": np.linspace(0.5, 2, 8), "rate": np.geomspace(0.2, 5, 8)},
            t1=200.0, samples=10_000, key=jax.random.key(0),
        )
        dataset = sweep.run("results/mu_and_rate")

    Nothing is simulated before `run`.

    Args:
        system: As in `simulate_ensemble`, and so are `law`, `t1` (s), `key`, `y0`, `method`, `orders` and
            `count_initial_rest`. Numbers may be distributions.
        law: The excitation.
        over: A dict from the name of a parameter to its values: every combination is a point. A tuple of names has
            rows of values, which change together. Or a design with values (`stickslip_jax.design`), whose rows are the
            points. A name is that of a number of system, law, start or method, as in `sensitivity` ("mu", "rate",
            "y0[0]", "method.width"), of a distribution ("mu.low"), or a dimensionless group: "r", frequency of the
            base over the natural frequency; "w", base speed over
            ``natural angular frequency * half-width of the stick band``.
        t1: The duration, s.
        samples: Of each point; with `standard_error`, at most.
        key: Of the random numbers.
        y0: The initial state; by default zero.
        method: Of the simulation.
        keep: "statistics", or "totals" (fewer statistics, about three times as fast; a stick that begins at t = 0
            then counts in all of them).
        statistics: Names of those in the result; by default all.
        sensitivities: Pairs of a statistic and a parameter (or several), ``[("mean_stick_duration", "mu")]``.
        orders: There are statistics of the 1st to this stick.
        count_initial_rest: Whether a stick that begins at t = 0 counts as the first.
        independent: By default sample i uses the same random numbers at all points, so that differences between points
            have small errors; True makes the points independent.
        standard_error: A dict from statistics of totals to the standard error wanted, such as
            ``{"mean_stick_duration": 0.01}``: batches are added to each point until it has all of them.
        realizations: Of how many samples the sticks are in the result, for figures.
        batch: Number of samples that are simulated, and stored, together; by default chosen from the size of the
            sweep. It decides the last digits of means.
        outputs: As in `simulate_ensemble`. Of an output "peak" the result has ``peak_mean``,
            ``peak_standard_deviation`` (each with ``..._error``), ``peak_quantile`` and ``peak_values``, the number of
            samples with a value. Functions are not stored: to go on, run the same program again.

    Raises:
        ValueError: For arguments that do not fit, at any point.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)
    ... )
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> settings = {"t1": 20.0, "samples": 200, "key": jax.random.key(0)}
    >>> sweep = ss.Sweep(system, law, over={"mu": [0.5, 1.0]}, **settings)
    >>> sweep.run(progress=False).stick_fraction.round(3).values
    array([0.013, 0.069])
    """

    def __init__(
        self,
        system: System,
        law: BaseMotion,
        *,
        over: Over,
        t1: float,
        samples: int,
        key: Array | None = None,
        y0: InitialState | None = None,
        method: Exact | Regularized = EXACT,
        keep: Keep = "statistics",
        statistics: Iterable[str | StatisticOfTotals | SampledQuantity] | None = None,
        sensitivities: Iterable[tuple[str | StatisticOfTotals, str | Sequence[str]]] = (),
        orders: int = 10,
        count_initial_rest: bool = False,
        independent: bool = False,
        standard_error: Mapping[str, float] | None = None,
        realizations: int = 0,
        batch: int | None = None,
        outputs: Outputs | None = None,
    ):
        points, samples = points_of(over), checks.whole_number("samples", samples, maximum=MOST_SAMPLES)
        keep = checked_keep(keep)
        taken = (*points.parameters, *(one.name for one in points.dimensions))
        names = checked_statistics(statistics, keep)
        self._plan = Plan(
            setting_of(system, law, y0, method),
            points,
            t1=t1,
            samples=samples,
            key_data=key_data_in(key),
            keep=keep,
            numbering=Numbering.checked(orders, count_initial_rest),
            statistics=names,
            derivatives=checked_derivatives(sensitivities),
            independent=independent,
            standard_errors=checked_errors(standard_error, names),
            realizations=realizations,
            batch=usual_batch(points.number, samples) if batch is None else batch,
            dtype=str(jnp.result_type(float)),
            outputs=checked_outputs(outputs, TAKEN | dict.fromkeys(taken, "a parameter")),
        )
        self._plan.check()
        self._folder: Path | None = None

    @classmethod
    def load(cls, folder: Folder) -> "Sweep":
        """The sweep that is stored in a folder, to go on with: ``Sweep.load(folder).run(folder)``.

        Args:
            folder: Where `run` stored it.

        Returns:
            The sweep.

        Raises:
            SweepError: For a folder that holds none, one of a newer version, and one of systems or laws of your own
                classes: those run again from the program that made them.
        """
        from .store import Store  # noqa: PLC0415

        sweep = object.__new__(cls)
        sweep._folder = checks.path("folder", folder)
        sweep._plan = Store.reading(sweep._folder).plan(every_point=True)
        return sweep

    @property
    def results(self) -> "xarray.Dataset":
        """What is stored in the folder that the sweep was loaded from, ``Sweep.load(folder).results``.

        It is as `run` returns it, also while a run works there; NaN, and 0 samples, where nothing is yet.

        Raises:
            SweepError: For a sweep that was not loaded from a folder.
        """
        from .dataset import stored_dataset  # noqa: PLC0415 - needs an extra

        if self._folder is None:
            raise SweepError(
                "Only a sweep that was loaded from a folder has results; call sweep.run(), or "
                "ss.Sweep.load(folder).results."
            )
        return stored_dataset(self._folder)

    def run(
        self,
        folder: Folder | None = None,
        *,
        threads: int | None = None,
        workers: int | None = None,
        executor: "distributed.Client | None" = None,
        shared_folder: bool = False,
        progress: bool | None = None,
    ) -> "xarray.Dataset":
        """Simulate all points.

        The same call goes on after an interrupt, wherever it was stopped, and adds points, samples, statistics or
        sensitivities to what is stored. The numbers are the same wherever it runs. The first Ctrl-C stops after the
        batches under way and raises KeyboardInterrupt, a second one at once.

        Args:
            folder: Where every finished batch is stored. Without it, nothing is kept.
            threads: Number of threads of this process (default: all cores).
            workers: Number of processes on this machine, in place of threads.
            executor: A ``dask.distributed.Client`` (docs/clusters.md), in place of threads.
            shared_folder: Whether the workers of `executor` see `folder` under the same name, and write into it; else
                they send what they have done.
            progress: As in `simulate_ensemble`.

        Returns:
            An ``xarray.Dataset`` with a dimension for each parameter, or ``point``; docs/sweeps.md describes it.

        Raises:
            SweepError: For a folder that holds something else or cannot be written, and if points failed.
            ImportError: Without the extra ``study``.
        """
        from .run import run_sweep  # noqa: PLC0415 - needs an extra

        require_threads_of_jax()
        path = None if folder is None else checks.path("folder", folder)
        return run_sweep(
            self._plan, path, threads=threads, workers=workers, executor=executor, shared_folder=shared_folder,
            progress=progress,
        )  # fmt: skip

    @property
    def points(self) -> int:
        """The number of points."""
        return self._plan.points.number

    @property
    def plan(self) -> Plan:
        """The checked arguments."""
        return self._plan

    def ensemble_at(
        self, *, samples: int | None = None, keep: Keep = "sticks", threads: int | None = None,
        progress: bool | None = None, **values: float,
    ) -> Ensemble:  # fmt: skip
        """The ensemble at one point, simulated now, with every stick: ``sweep.ensemble_at(mu=0.5, rate=1.0)``.

        Args:
            samples: By default those of the sweep.
            keep: As in `simulate_ensemble`, and so are `threads` and `progress`.
            threads: Number of threads.
            progress: Whether to show a progress bar.
            **values: Those of all parameters at the point.

        Returns:
            The ensemble.

        Raises:
            ValueError: For values that are no point of the sweep.
        """
        plan = self._plan
        samples = plan.samples if samples is None else samples
        points, given = plan.points, checks.show(dict(values))
        if set(values) != set(points.parameters):
            raise ValueError(f"Arguments must be the values of {', '.join(points.parameters)}, but {given} was given.")
        for name, value in values.items():
            checks.numeric(name, value)
        point = points.number_of(values)
        if point is None:
            raise ValueError(f"Arguments must be the values at a point of the sweep, but {given} is none.")
        setting, numbering = plan.setting_at(point), plan.numbering
        return simulate_ensemble(
            *setting.model[:2], t1=plan.t1, samples=samples, key=plan.key_at(point), y0=setting.y0,
            method=setting.method, keep=keep, orders=numbering.orders, count_initial_rest=numbering.count_initial_rest,
            threads=threads, progress=progress, outputs=plan.outputs,
        )  # fmt: skip

    def __repr__(self) -> str:
        plan = self._plan
        sizes = " x ".join(f"{len(one)} {', '.join(one.parameters)}" for one in plan.points.dimensions)
        return (
            f"Sweep of {plan.points.number:,} points ({sizes}), {plan.samples:,} samples each on [0, {plan.t1:g}] s, "
            f"keep={plan.keep!r}"
        )
