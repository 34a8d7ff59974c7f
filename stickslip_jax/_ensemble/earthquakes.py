"""What earthquake engineers ask of a suite of records: incremental dynamic analysis, spectra, fragility."""

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from jaxtyping import Array

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.simulate import Outputs
from .._excitation.reading import STANDARD_GRAVITY
from .._excitation.recorded import GroundAcceleration
from .._excitation.suites import RecordSuite
from .._foundation import checks
from .._foundation.extras import labeled_dataset, require, require_labels, variable
from .._foundation.types import InitialState
from .._statistics.estimate import DEFAULT_LEVEL
from .._systems.friction import Coulomb
from .._systems.mass_spring import MassSpring
from .._systems.system import System
from .ensemble import simulate_ensemble

if TYPE_CHECKING:
    import pandas
    import xarray

Records = RecordSuite | GroundAcceleration | list[GroundAcceleration] | str
"""A suite, or what makes one."""

Numbers = np.ndarray | np.floating
"""Of the shape that was asked for."""

FRACTIONS = np.array([0.16, 0.5, 0.84])
"""Of the records, below whose values the lines of incremental dynamic analysis lie: the median, and about one standard
deviation of a normal distribution to either side."""


def _suite_of(records: Any) -> RecordSuite:
    return records if isinstance(records, RecordSuite) else RecordSuite(records)


def _names(suite: RecordSuite) -> tuple[Any, Any, dict[str, object]]:
    """The names of the entries' records, as a coordinate."""
    return variable("record", [suite.names[one] for one in np.asarray(suite.entries[0])], "record")


def incremental_dynamic_analysis(
    system: System, records: Records, *, scales: npt.ArrayLike, outputs: Outputs, t1: float | None = None,
    y0: InitialState | None = None, key: Array | None = None, method: Exact | Regularized = EXACT,
    period: float | None = None, damping: float = 0.05, threads: int | None = None, progress: bool | None = None,
) -> "xarray.Dataset":  # fmt: skip
    """Every record at every scale: incremental dynamic analysis (Vamvatsikos and Cornell 2002), in one ensemble.

    Args:
        system: Any that `simulate_ensemble` takes under a ground acceleration.
        records: A `RecordSuite`, a list of `GroundAcceleration`, or the name of a folder of AT2 and CSV files.
        scales: By which the scale of each record is multiplied, (scales,).
        outputs: As `simulate_ensemble` takes them: ``{"peak": lambda one: one.peak("position")}``.
        t1: Duration, s; by default that of the longest record. After its end a record is quiet.
        y0: Initial state.
        key: Where system or start are random; a sample draws the same at any scale only from arrays.
        method: `Exact`, with a time step where one is needed, or `Regularized`.
        period: Of an oscillator, s, whose spectral acceleration is then in the table too, as a measure of intensity.
        damping: Its damping, as a share of the critical one.
        threads: Worker threads (default: all cores).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.

    Returns:
        An ``xarray.Dataset`` with the dimensions `scale` and `record`: each output (NaN where a sample did not finish),
        as ``peak``, and as ``peak_quantile`` what 16 %, 50 % and 84 % of the records stay below at each scale; `pga`,
        the largest ground acceleration, m/s^2; and `spectral_acceleration`, m/s^2. ``table.to_dataframe()`` makes a
        table of pandas of it, ``table.peak.plot.line(x="scale")`` a figure.

    Raises:
        ValueError: For arguments outside these bounds.
        ImportError: Without the extra ``study``.
    """
    require_labels()
    suite, scales = _suite_of(records), np.atleast_1d(checks.numbers("scales", scales, ndim=1)).astype(float)
    every = suite.at_scales(scales)
    many = simulate_ensemble(
        system, every, suite.duration if t1 is None else t1, y0, samples=len(every), key=key, method=method,
        keep="totals", threads=threads, progress=progress, outputs=outputs,
    )  # fmt: skip
    both, (which, factors) = ("scale", "record"), map(np.asarray, suite.entries)
    pga = np.abs(scales[:, None] * factors) * suite.records.peaks[which]
    found = {"pga": variable(both, pga, "largest ground acceleration", "m/s^2")}
    if period is not None:
        of_one = response_spectrum(suite, [period], damping, threads=threads, progress=progress)
        values = np.abs(scales)[:, None] * of_one.pseudo_acceleration.values[:, 0]
        found["spectral_acceleration"] = variable(both, values, f"spectral acceleration at {period:g} s", "m/s^2")
    for name, column in many.output_values.items():
        found[name] = variable(both, column.reshape(len(scales), -1), name, many.output_units[name])
    coordinates = {"scale": variable("scale", scales, "scale of the records"), "record": _names(suite)}
    table = labeled_dataset(found, coordinates, {"system": repr(system)})
    return table.assign({f"{name}_quantile": table[name].quantile(FRACTIONS, "record") for name in many.output_values})


# Spectra: oscillators and sliders of many periods under every record, in one ensemble.


_SHORTEST = 1e-6  # s, of a period


def response_spectrum(
    records: Records, periods: npt.ArrayLike, damping: float = 0.05, *, threads: int | None = None,
    progress: bool | None = None,
) -> "xarray.Dataset":  # fmt: skip
    """The response spectra of records: the largest displacement of linear oscillators relative to the ground.

    Exact for a ground acceleration that is linear between the points of a record; the largest values are located
    between them too, and after the end of the record.

    Args:
        records: A `RecordSuite`, a list of `GroundAcceleration` or one, or the name of a folder.
        periods: Of the oscillators without damping, s, (periods,).
        damping: As a share of the critical one, below 1.
        threads: Worker threads (default: all cores).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.

    Returns:
        An ``xarray.Dataset`` with the dimensions `record` and `period`: `displacement`, m; `pseudo_velocity`, m/s; and
        `pseudo_acceleration`, m/s^2, which is what is called spectral acceleration.

    Raises:
        ValueError: For arguments outside these bounds.
        ImportError: Without the extra ``study``.
    """
    if np.any(np.isinf(checks.numbers("periods", periods, ndim=1))):
        raise checks.refused("periods", "be finite", periods, "sliding_spectrum takes flat sliders")
    found = sliding_spectrum(records, periods, [0.0], damping=damping, threads=threads, progress=progress)
    largest, period = np.asarray(found.largest_displacement)[..., 0], np.asarray(found.period)
    omega = 2 * math.pi / period
    units = {"displacement": "m", "pseudo_velocity": "m/s", "pseudo_acceleration": "m/s^2"}
    quantities = {
        name: variable(("record", "period"), omega**power * largest, name.replace("_", "-"), unit)
        for power, (name, unit) in enumerate(units.items())
    }
    return labeled_dataset(quantities, {"record": found.record, "period": found.period}, {"damping": float(damping)})


def sliding_spectrum(
    records: Records, periods: npt.ArrayLike, mu: npt.ArrayLike, *, damping: float = 0.0,
    gravity: float = STANDARD_GRAVITY, t1: float | None = None, threads: int | None = None,
    progress: bool | None = None,
) -> "xarray.Dataset":  # fmt: skip
    """The sliding spectra of records: displacements of a mass on a friction bearing with a spring.

    The mass lies on the ground with constant Coulomb friction and is held by a spring. Both are as exact as
    `simulate`.

    Args:
        records: A `RecordSuite`, a list of `GroundAcceleration` or one, or the name of a folder.
        periods: Of the mass on its spring without friction, s, (periods,); infinity for a flat slider.
        mu: Friction coefficients, (coefficients,), which are also the yield accelerations of a flat slider, in units of
            gravity.
        damping: Of the spring, as a share of the critical damping, below 1.
        gravity: m/s^2.
        t1: Duration, s; by default that of the longest record and the longest finite period.
        threads: Worker threads (default: all cores).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.

    Returns:
        An ``xarray.Dataset`` with the dimensions `record`, `period` and `mu`: `largest_displacement`, and
        `residual_displacement`, that at t1 with its sign, m.

    Raises:
        ValueError: For arguments outside these bounds.
        ImportError: Without the extra ``study``.
    """
    require_labels()
    suite = _suite_of(records)
    checks.bounded("damping", damping, at_least=0, below=1)
    checks.positive("gravity", gravity, "m/s^2")
    axes = {name: checks.numbers(name, one, ndim=1).astype(float) for name, one in (("periods", periods), ("mu", mu))}
    for name, values in axes.items():
        if not len(values):
            raise checks.refused(name, "hold at least one number", values)
    usable = (axes["periods"] >= _SHORTEST) & ((axes["periods"] <= 1 / _SHORTEST) | (axes["periods"] == math.inf))
    if not np.all(usable):
        wanted = f"be between {_SHORTEST:g} and {1 / _SHORTEST:g} s, or infinite for a flat slider"
        raise checks.refused("periods", wanted, float(axes["periods"][~usable][0]))
    shape = (len(suite), *map(len, axes.values()))
    entry, omega, each = (
        np.broadcast_to(values, shape).reshape(-1)
        for values in (np.arange(shape[0])[:, None, None], 2 * math.pi / axes["periods"][:, None], axes["mu"])
    )
    slider = MassSpring(
        mass=1.0, stiffness=omega**2, normal_force=float(gravity), friction=Coulomb(each),
        damping=2 * damping * omega if damping > 0 else None,
    )  # fmt: skip
    record, own = (np.asarray(values)[entry.astype(int)] for values in suite.entries)
    slowest = np.max(axes["periods"], initial=0.0, where=np.isfinite(axes["periods"]))
    many = simulate_ensemble(
        slider, RecordSuite(suite.records, own, record.astype(float)), suite.duration + slowest if t1 is None else t1,
        samples=len(entry), keep="totals", threads=threads, progress=progress,
        outputs={"largest": lambda one: one.peak("position"), "residual": lambda one: one.final_state[0]},
    )  # fmt: skip
    found = {
        f"{name}_displacement": variable(("record", "period", "mu"), values.reshape(shape), f"{name} displacement", "m")
        for name, values in many.output_values.items()
    }
    coordinates = {
        "record": _names(suite),
        "period": variable("period", axes["periods"], "period", "s"),
        "mu": variable("mu", axes["mu"], "friction coefficient"),
    }
    return labeled_dataset(found, coordinates, {"damping": float(damping), "gravity": float(gravity)})


# Fragility: the probability of an exceedance as a function of intensity.


@dataclasses.dataclass(frozen=True)
class Fragility:
    """A lognormal fragility function that `fragility` fitted: ``P(x) = Phi(ln(x / median) / dispersion)``.

    - `median`: the intensity at which the probability is one half, often called theta. `dispersion`: the standard
      deviation of the logarithm of the intensity, beta.
    - `covariance`: of the errors of ``ln(median)`` and of `dispersion`, (2, 2).
    - `trials`, `exceedances`: how many were observed. `records`: how many groups of them are independent.
    - `lowest`, `highest`: the intensities between which they lie.
    """

    median: float
    dispersion: float
    covariance: np.ndarray
    trials: int
    exceedances: int
    records: int
    lowest: float
    highest: float

    @property
    def median_error(self) -> float:
        """The standard error of `median`."""
        return self.median * math.sqrt(self.covariance[0, 0])

    @property
    def dispersion_error(self) -> float:
        """The standard error of `dispersion`."""
        return math.sqrt(self.covariance[1, 1])

    def probability(self, intensity: float | npt.ArrayLike) -> Numbers:
        """The probability of an exceedance at these intensities (any shape)."""
        from scipy.special import ndtr  # noqa: PLC0415 - takes long to load

        return ndtr(self._score(intensity))

    def interval(self, intensity: float | npt.ArrayLike, level: float = DEFAULT_LEVEL) -> tuple[Numbers, Numbers]:
        """The limits of a confidence interval of the probability at each of these intensities.

        Args:
            intensity: In the unit of the fit, any shape.
            level: With which probability the interval holds the true one.

        Raises:
            ValueError: For a level that is not between 0 and 1.
        """
        from scipy.special import ndtr, ndtri  # noqa: PLC0415 - takes long to load

        checks.bounded("level", level, above=0, below=1)
        score = self._score(intensity)
        # The derivatives of the score by ln(median) and by the dispersion are -1 / dispersion and -score / dispersion.
        (variance, joint), (_, other) = self.covariance
        error = np.sqrt(np.maximum(variance + 2 * joint * score + other * score**2, 0)) / self.dispersion
        away = ndtri((1 + level) / 2) * error
        return ndtr(score - away), ndtr(score + away)

    def quantile(self, probability: float | npt.ArrayLike) -> Numbers:
        """The intensities at which an exceedance has these probabilities."""
        from scipy.special import ndtri  # noqa: PLC0415 - takes long to load

        return self.median * np.exp(self.dispersion * ndtri(np.asarray(probability, float)))

    def to_pandas(self, intensity: npt.ArrayLike | None = None, level: float = DEFAULT_LEVEL) -> "pandas.DataFrame":
        """A table of the curve: `intensity` (by default 50 between the observed ones), `probability`, and its limits
        `low` and `high`.
        """
        require("Tables need", "tables", "pandas")
        import pandas as pd  # noqa: PLC0415 - an extra, loaded when asked for

        at = np.geomspace(self.lowest, self.highest, 50) if intensity is None else np.ravel(intensity)
        low, high = self.interval(at, level)
        return pd.DataFrame({"intensity": at, "probability": self.probability(at), "low": low, "high": high})

    def _score(self, intensity: float | npt.ArrayLike) -> Numbers:
        with np.errstate(divide="ignore"):
            return np.log(np.asarray(intensity, float) / self.median) / self.dispersion

    def __repr__(self) -> str:
        return (
            f"fragility of {self.exceedances:,} exceedances in {self.trials:,}: median {self.median:.4g} +- "
            f"{self.median_error:.2g}, dispersion {self.dispersion:.3g} +- {self.dispersion_error:.2g}"
        )


_MOST_STEPS, _CLOSE = 100, 1e-12


def fragility(
    intensity: npt.ArrayLike, exceeds: npt.ArrayLike, *, trials: int | npt.ArrayLike | None = None,
    records: npt.ArrayLike | None = None,
) -> Fragility:  # fmt: skip
    """Fit a lognormal fragility function by maximum likelihood.

    Of stripes, ``fragility(levels, counts, trials=40)``, as Baker (2015, "Efficient analytical fragility function
    fitting using dynamic structural analysis", Earthquake Spectra 31) does; of a cloud of single analyses,
    ``fragility(intensities, drift > limit)``, by the same likelihood (probit regression on the logarithm).

    Args:
        intensity: Such as a spectral acceleration, in any unit, positive; of a shape that fits `exceeds`.
        exceeds: Whether each analysis exceeds the limit, any shape; with `trials`, how many of them do.
        trials: How many analyses there are at each intensity.
        records: Which record each analysis is of (numbers or names), of a shape that fits `exceeds`. Analyses of the
            same record at several scales depend on each other; standard errors are then those of whole records (the
            "sandwich" estimator). By default all analyses are independent.

    Raises:
        ValueError: For arguments that do not fit; for observations without a single best curve: all or none exceed, or
            a level of intensity parts those that do from those that do not; and for a probability that does not grow.
    """
    given = {"exceeds": exceeds, "intensity": intensity, "trials": 1 if trials is None else trials}
    arrays = {name: values if np.ma.isMaskedArray(values) else np.asarray(values) for name, values in given.items()}
    arrays = {name: array.astype(float) if array.dtype == bool else array for name, array in arrays.items()}
    columns = [checks.numbers(name, array).astype(float) for name, array in arrays.items()]
    groups = np.asarray(0 if records is None else records)
    shape = columns[0].shape
    try:
        k, x, n, which = (np.broadcast_to(values, shape).reshape(-1) for values in (*columns, groups))
    except ValueError:
        shapes = ", ".join(str(values.shape) for values in (*columns[1:], groups))
        raise ValueError(
            f"Arguments intensity, trials and records must have shapes that fit that of exceeds, {shape}, but {shapes} "
            "were given."
        ) from None
    if not (np.all(x > 0) and np.all(np.isfinite(x))):
        raise checks.refused("intensity", "hold finite positive numbers", intensity)
    if not (np.all(n >= 1) and np.all(n == np.round(n))):
        raise checks.refused("trials", "hold whole numbers of at least 1", trials)
    if not (np.all(k >= 0) and np.all(k <= n) and np.all(k == np.round(k))):
        wanted = "hold truth values" if trials is None else "hold whole numbers from 0 to the trials"
        raise checks.refused("exceeds", wanted, exceeds)
    _check_overlap(x, n, k)
    # The logarithm is centred and scaled, so that the numbers of the fit are of the order of one.
    logarithm = np.log(x)
    middle, width = float(np.average(logarithm, weights=n)), float(np.std(logarithm))
    design = np.stack([np.ones_like(x), (logarithm - middle) / width], axis=1)
    at, first, second = _fitted(design, n, k)
    if not at[1] > 0:
        raise ValueError(
            f"Argument exceeds must become more probable as the intensity grows, but the fitted slope is {at[1]:.3g}; "
            "another measure of intensity, or more records, may tell more."
        )
    covariance = np.linalg.inv((design * second[:, None]).T @ design)
    number = int(np.sum(n))
    if records is not None:
        which = np.unique(which, return_inverse=True)[1]
        number = int(which.max()) + 1
        if number < 3:
            raise checks.refused("records", "name at least 3 records, for an error between them", records)
        sums = np.stack([np.bincount(which, weights=first * column) for column in design.T], axis=1)
        covariance = covariance @ (sums.T @ sums) @ covariance * number / (number - 1)
    # ln(median) = middle - width a / b and dispersion = width / b.
    a, b = at
    jacobian = width * np.array([[-1 / b, a / b**2], [0, -1 / b**2]])
    return Fragility(
        math.exp(middle - width * a / b), width / b, jacobian @ covariance @ jacobian.T, int(np.sum(n)), int(np.sum(k)),
        number, float(x.min()), float(x.max()),
    )  # fmt: skip


def _fitted(design: np.ndarray, n: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The numbers b of ``Phi(design @ b)`` that make the k of n exceedances most probable; and there, of the likelihood
    of each observation, the derivative by its score, and minus the second one.

    The likelihood is concave: Newton's method, with steps that are halved where they go too far.
    """
    from scipy.special import log_ndtr  # noqa: PLC0415 - takes long to load

    def likelihood(at: np.ndarray) -> float:
        return float(np.sum(k * log_ndtr(design @ at) + (n - k) * log_ndtr(-design @ at)))

    def slopes(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        score = design @ at
        density = -(score**2) / 2 - math.log(2 * math.pi) / 2
        above, below = np.exp(density - log_ndtr(score)), np.exp(density - log_ndtr(-score))
        return k * above - (n - k) * below, k * above * (score + above) + (n - k) * below * (below - score)

    at = np.array([0.0, 1.0])
    for _ in range(_MOST_STEPS):
        first, second = slopes(at)
        step = np.linalg.solve((design * second[:, None]).T @ design, design.T @ first)
        while likelihood(at + step) < likelihood(at) and np.max(np.abs(step)) > _CLOSE:
            step = step / 2
        at = at + step
        if np.max(np.abs(step)) <= _CLOSE * np.max(np.abs(at)):
            break
    return at, *slopes(at)


def _check_overlap(x: np.ndarray, n: np.ndarray, k: np.ndarray) -> None:
    """Raises ValueError where the likelihood has no maximum: the steeper the curve the likelier."""
    if not 0 < np.sum(k) < np.sum(n):
        which = "all" if np.sum(k) else "none"
        raise ValueError(
            f"Argument exceeds must hold analyses that exceed the limit and others that do not, but {which} of "
            f"{int(np.sum(n))} do; take other scales of the records, or another limit."
        )
    stays, exceed = x[k < n], x[k > 0]
    for low, high, said in ((stays, exceed, "stay within the limit"), (exceed, stays, "exceed it")):
        if low.max() <= high.min():
            raise ValueError(
                f"Argument exceeds must overlap, but all analyses below {high.min():.4g} {said} and none above does, "
                "so that no dispersion can be fitted; take more scales near it, or more records."
            )
