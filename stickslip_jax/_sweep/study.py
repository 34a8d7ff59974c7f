"""`Study`: a parametric study, on a grid of parameters or a design."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._design.design import Design
from .._dynamics.method import EXACT, Exact, Regularized
from .._dynamics.validation import check_method
from .._ensemble.call import simulate_ensemble
from .._ensemble.parts import Keep
from .._ensemble.result import Ensemble
from .._ensemble.run import MOST_SAMPLES
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._statistics.accumulator import MOST_ORDERS, Numbering
from .._systems.system import System
from .._types import Array, InitialState
from .errors import StudyError
from .plan import (
    Plan,
    checked_derivatives,
    checked_errors,
    checked_keep,
    checked_samples,
    checked_statistics,
    key_data_in,
    usual_piece,
)
from .points import points_of
from .setting import setting_of

if TYPE_CHECKING:
    import xarray

_Values = Sequence[Any] | np.ndarray
Over = Mapping[str, _Values] | Mapping[tuple[str, ...], _Values] | Mapping[str | tuple[str, ...], _Values] | Design
Folder = str | os.PathLike[str]


class Study:
    """A parametric study: the same ensemble at many values of its parameters::

        study = ss.Study(
            system, law, over={"mu": np.linspace(0.5, 2, 8), "rate": np.geomspace(0.2, 5, 8)},
            t1=200.0, samples=10_000, key=jax.random.key(0),
        )
        dataset = study.run("results/mu_and_rate")

    - `system`, `law`, `t1` (s), `key`, `y0`, `method`, `orders`, `count_initial_rest`: as in `simulate_ensemble`.
      Numbers may be distributions.
    - `over`: a dict from the name of a parameter to its values: every combination is a point. A tuple of names has rows
      of values, which change together. Or a design with values (`stickslip_jax.design`), whose rows are the points.
      A name is that of a number of system, law, start or method, as in `sensitivity` ("mu", "rate", "y0[0]",
      "method.width"), of a distribution ("mu.low"), or a dimensionless group: "r", frequency of the base over the
      natural frequency; "w", base speed over ``natural angular frequency * half-width of the stick band``.
    - `samples`: of each point; with `standard_error`, at most.
    - `keep`: "statistics", or "totals" (fewer statistics, about three times as fast; a stick that begins at t = 0 then
      counts in all of them).
    - `statistics`: names of those in the result; by default all.
    - `sensitivities`: pairs of a statistic and a parameter (or several), ``[("mean_stick_duration", "mu")]``.
    - `independent`: by default sample i uses the same random numbers at all points, so that differences between points
      have small errors; True makes the points independent.
    - `standard_error`: a dict from statistics of totals to the standard error wanted, such as
      ``{"mean_stick_duration": 0.01}``: each point ends when it has all of them, piece by piece.
    - `realizations`: of how many samples the sticks are in the result, for figures.
    - `piece`: samples that are done, and stored, together; by default chosen from the size of the study.

    Nothing is simulated before `run`. Raises ValueError for arguments that do not fit, at any point.

    >>> system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> study = ss.Study(system, law, over={"mu": [0.5, 1.0]}, t1=20.0, samples=200, key=jax.random.key(0))
    >>> study.run(progress=False).stick_fraction.round(3).values
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
        statistics: Iterable[Any] | None = None,
        sensitivities: Iterable[tuple[Any, Any]] = (),
        orders: int = 10,
        count_initial_rest: bool = False,
        independent: bool = False,
        standard_error: Mapping[str, float] | None = None,
        realizations: int = 0,
        piece: int | None = None,
    ):
        check_method(method)
        _checks.truth("count_initial_rest", count_initial_rest)
        _checks.truth("independent", independent)
        _checks.positive("t1", t1, "s")
        points, samples, keep = points_of(over), checked_samples(samples), checked_keep(keep)
        chosen = checked_statistics(statistics, keep)
        numbering = Numbering(_checks.whole_number("orders", orders, maximum=MOST_ORDERS), count_initial_rest)
        _checks.whole_number("realizations", realizations, minimum=0)
        if piece is None:
            piece = usual_piece(points.number, samples)
        self._plan = Plan(
            setting=setting_of(system, law, y0, method),
            points=points,
            t1=float(t1),
            samples=samples,
            key_data=key_data_in(key),
            keep=keep,
            numbering=numbering,
            statistics=chosen,
            derivatives=checked_derivatives(sensitivities),
            independent=independent,
            standard_errors=checked_errors(standard_error, chosen),
            realizations=realizations,
            piece=_checks.whole_number("piece", piece, maximum=MOST_SAMPLES),
            dtype=str(jnp.result_type(float)),
        )
        self._plan.check()
        self._folder: Path | None = None

    @classmethod
    def load(cls, folder: Folder) -> "Study":
        """The study that is stored in `folder`, to go on with: ``Study.load(folder).run(folder)``.

        Raises StudyError for a folder that holds none, one of a newer version, and one of systems or laws of your own
        classes: those run again from the program that made them.
        """
        from .store import Store  # noqa: PLC0415

        study = object.__new__(cls)
        study._folder = _checks.path("folder", folder)
        study._plan = Store.reading(study._folder).plan(every_point=True)
        return study

    @property
    def results(self) -> "xarray.Dataset":
        """What is in the folder that the study was loaded from, ``Study.load(folder).results``, as `run` returns it.

        Also while a run works there; NaN, and 0 samples, where nothing is yet. Raises StudyError for a study that was
        not loaded from a folder.
        """
        from .looking import stored_dataset  # noqa: PLC0415 - needs an extra

        if self._folder is None:
            raise StudyError(
                "Only a study that was loaded from a folder has results; call study.run(), or "
                "ss.Study.load(folder).results."
            )
        return stored_dataset(self._folder)

    def run(
        self,
        folder: Folder | None = None,
        *,
        threads: int | None = None,
        workers: int | None = None,
        executor: Any = None,
        shared_folder: bool = False,
        progress: bool | None = None,
    ) -> "xarray.Dataset":
        """Simulate all points and return the result.

        - `folder`: where every finished piece is stored. The same call goes on after an interrupt, wherever it was
          stopped, and adds points, samples, statistics or sensitivities to what is there. Without it, nothing is kept.
        - `threads`: of this process (default: all cores). Or `workers`: processes on this machine. Or `executor`: a
          ``dask.distributed.Client`` (docs/clusters.md). The numbers are the same.
        - `shared_folder`: whether the workers of `executor` see `folder` under the same name, and write into it; else
          they send what they have done.
        - `progress`: as in `simulate_ensemble`.

        Returns an ``xarray.Dataset`` with a dimension for each parameter, or ``point``; docs/studies.md describes it.
        The first Ctrl-C stops after the pieces under way and raises KeyboardInterrupt, a second one at once.

        Raises StudyError for a folder that holds something else or cannot be written, and if points failed; ImportError
        without the extra ``study``.
        """
        from .places import Where, check_where  # noqa: PLC0415 - with what runs studies only
        from .run import run_study  # noqa: PLC0415 - needs an extra

        require_threads_of_jax()
        path = None if folder is None else _checks.path("folder", folder)
        where = Where(threads, workers, executor, shared_folder)
        check_where(where, has_folder=folder is not None)
        return run_study(self._plan, path, where, progress)

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
        """The ensemble at one point, simulated now, with every stick: ``study.ensemble_at(mu=0.5, rate=1.0)``.

        `samples`: by default those of the study. Raises ValueError for values that are no point of the study.
        """
        plan = self._plan
        samples = plan.samples if samples is None else samples
        point = self._number_of(values)
        setting, numbering = plan.setting_at(point), plan.numbering
        return simulate_ensemble(
            *setting.model[:2], t1=plan.t1, samples=samples, key=plan.key_at(point), y0=setting.y0,
            method=setting.method, keep=keep, orders=numbering.orders, count_initial_rest=numbering.count_initial_rest,
            threads=threads, progress=progress,
        )  # fmt: skip

    def _number_of(self, values: Mapping[str, float]) -> int:
        points, given = self._plan.points, _checks.show(dict(values))
        if set(values) != set(points.parameters):
            raise ValueError(f"Arguments must be the values of {', '.join(points.parameters)}, but {given} was given.")
        for name, value in values.items():
            _checks.numeric(name, value)
        number = points.number_of(values)
        if number is None:
            raise ValueError(f"Arguments must be the values at a point of the study, but {given} is none.")
        return number

    def __repr__(self) -> str:
        plan = self._plan
        axes = " x ".join(f"{len(axis.values)} {', '.join(axis.parameters)}" for axis in plan.points.axes)
        return (
            f"Study of {plan.points.number:,} points ({axes}), {plan.samples:,} samples each on [0, {plan.t1:g}] s, "
            f"keep={plan.keep!r}"
        )
