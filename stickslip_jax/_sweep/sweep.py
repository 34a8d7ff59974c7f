"""`Sweep`: a parameter sweep, on a grid of parameters or a design."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.simulate import Outputs, checked_outputs
from .._ensemble.data import Keep
from .._ensemble.encoding import SweepError
from .._ensemble.ensemble import Ensemble, simulate_ensemble
from .._ensemble.points import points_of, setting_of
from .._ensemble.setup import MOST_SAMPLES, TAKEN
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.types import InitialState
from .._statistics.quantities import Numbering, SampledQuantity
from .._statistics.totals import StatisticOfTotals
from .._systems.system import System
from .._uncertainty.design import Design
from . import batches
from .batches import Plan

if TYPE_CHECKING:
    import distributed
    import xarray


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
        system: Any that `simulate_ensemble` takes; its numbers may be distributions.
        law: The excitation, any that `simulate_ensemble` takes.
        over: A dict from the name of a parameter to its values: every combination is a point. A tuple of names has rows
            of values, which change together. Or a design with values (`stickslip_jax.design`), whose rows are the
            points. A name is that of a number of system, law, start or method ("mu", "rate", "y0[0]", "method.width"),
            of a distribution ("mu.low"), or a dimensionless group: "r", frequency of the base over the natural
            frequency; "w", base speed over ``natural angular frequency * half-width of the stick band``.
        t1: The duration, s.
        samples: Of each point; with `standard_error`, at most.
        key: Of the random numbers, from ``jax.random.key(seed)``; None where nothing is random.
        y0: The initial state; by default zero.
        method: `Exact`, with a time step where one is needed, or `Regularized`.
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
        outputs: As in `simulate_ensemble`: a dict from names to functions of a `Simulation` that return one number, to
            `Output` objects or what these know, or a list of names. Of "peak" the result has ``peak_mean``,
            ``peak_standard_deviation`` (each with ``..._error``), ``peak_quantile`` and ``peak_values``, the number of
            samples with a value. Functions are not stored: to go on, run the same program again.

    Raises:
        ValueError: For arguments that do not fit, at any point.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.9)
    ... )
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> settings = {"t1": 20.0, "samples": 200, "key": jax.random.key(0)}
    >>> sweep = ss.Sweep(system, law, over={"mu": [0.5, 0.9]}, **settings)
    >>> sweep.run(progress=False).stick_fraction.round(3).values
    array([0.013, 0.055])
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
        keep = batches.checked_keep(keep)
        taken = (*points.parameters, *(one.name for one in points.dimensions))
        names = batches.checked_statistics(statistics, keep)
        self._plan = Plan(
            setting_of(system, law, y0, method),
            points,
            t1=t1,
            samples=samples,
            key_data=batches.key_data_in(key),
            keep=keep,
            numbering=Numbering.checked(orders, count_initial_rest),
            statistics=names,
            derivatives=batches.checked_derivatives(sensitivities),
            independent=independent,
            standard_errors=batches.checked_errors(standard_error, names),
            realizations=realizations,
            batch=batches.usual_batch(points.number, samples) if batch is None else batch,
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
            progress: True shows a progress bar, False none; by default on a terminal and in a notebook.

        Returns:
            An ``xarray.Dataset`` with a dimension for each parameter, or ``point``; docs/sweeps.md describes it.

        Raises:
            SweepError: For a folder that holds something else or cannot be written, and if points failed.
            ImportError: Without the extra ``study``.
        """
        from .run import run_sweep  # noqa: PLC0415 - needs an extra

        checks.require_threads_of_jax()
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
            keep: "totals", "statistics", or "sticks", every one.
            threads: Number of threads (default: all cores).
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
