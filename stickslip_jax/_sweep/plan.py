"""What a sweep simulates, checked: its setting, points and options, and the tasks into which it is cut."""

import dataclasses
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any, NamedTuple, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._dynamics.simulate import Output
from .._ensemble.data import Keep
from .._ensemble.points import Points, Setter, SweepSetting, check_points, setter_of
from .._ensemble.setup import MOST_SAMPLES, EnsembleSetup, fields_of_outputs, runner_for
from .._foundation import checks
from .._foundation.processes import require_memory
from .._numerics.elementary import key_data_of
from .._statistics.quantities import DISTRIBUTIONS, Numbering
from .._statistics.totals import DIFFERENTIABLE, STATISTICS
from .._uncertainty.numbers import parameters_of

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
