"""What samplers of other libraries take: `log_likelihood` of a record of motion, and `stick_simulator`, from
parameters to summaries of the sticks.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._dynamics.common.method import EXACT, Exact, Regularized, check_method, working_dtype
from .._ensemble.ensemble import Ensemble, simulate_ensemble
from .._ensemble.setup import MOST_SAMPLES
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.fields import Quantity
from .._foundation.types import FloatArray, InitialState, Status
from .._numerics.derivatives import as_arrays
from .._systems.system import System
from .._uncertainty.design import table
from .._uncertainty.numbers import matching, numbers_in, parameters_of, quantity_at
from .parameters import checked_model, identity
from .record import Observer, Windows, asked, checked_noise
from .search import EstimatedNumbers, FittedMotion, loop_steps, predicted, static_holds

# `log_likelihood`: how likely a record of motion is, as a function for samplers of posteriors.


_SPARE = 2  # times as many loop steps as with the first guesses: elsewhere the motion may be faster


class LogLikelihood(eqx.Module):
    """The logarithm of the probability density of a record of motion, by the numbers that are not known.

    ``likelihood({"mu": 0.6, "stiffness": 4.0})`` or ``likelihood(array)``, with the numbers in the order of `names` and
    in their own units, is a scalar in JAX: `jit`, `vmap` and `grad` take it. The noise is independent and Gaussian; all
    constants are in it. ``likelihood(values, noise={"position": 0.01})`` gives standard deviations in the units of the
    channels, in place of those given before.

    It is minus infinity, with derivative zero, for numbers outside the bounds of their fields, for static friction
    below kinetic friction, for noise that is not positive, and where the motion does not reach the end of the record.
    Otherwise its derivatives are exact; they are computed in forward mode, and reverse mode multiplies by them. They
    hold between events: where a stick appears or vanishes as the numbers change, the motion after it may have a kink,
    or a jump (where `mu_static` is above `mu`, for example). `jax.hessian` gives second derivatives.

    - `names`: of the numbers, in their order. `first_guess`: their values in the system, the base and the start, in
      their own units, (parameters,).
    - `channels`: the names of what was measured. `noise`: the standard deviation of each, in its unit, NaN where it has
      to be given in the call, (channels,).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    first_guess: Array
    noise: Array
    _model: FittedMotion
    _windows: Windows
    _start: Array
    _abouts: tuple[Quantity, ...] = eqx.field(static=True)
    _coordinates: tuple[int | None, ...] = eqx.field(static=True)
    _is_known: tuple[bool, ...] = eqx.field(static=True)
    # By identity, so that it can be given to `jax.jit` as any function: arrays have no hash.
    __hash__ = object.__hash__
    __eq__ = object.__eq__

    def __call__(
        self, values: Mapping[str, ArrayLike] | ArrayLike, noise: Mapping[str, ArrayLike] | None = None
    ) -> FloatArray:
        """The log likelihood at `values`, a dict by name or an array (parameters,), and with this `noise`.

        Raises ValueError for names or shapes that do not fit, and for noise that is not given at all.
        """
        checks.require_threads_of_jax()
        return _density(self, self._numbers(values), self._sigma(noise))

    def _density(self, numbers: FloatArray, sigma: FloatArray) -> FloatArray:
        """The log likelihood at numbers (parameters,) and with standard deviations (channels,)."""
        # All numbers within the bounds of their fields, and static friction not below kinetic friction.
        holds = [jnp.all(jnp.isfinite(numbers))]
        for number, about in zip(numbers, self._abouts, strict=True):
            limits = (jnp.greater, about.above), (jnp.greater_equal, about.at_least), (jnp.less, about.below)
            holds += [compare(number, bound) for compare, bound in limits if bound is not None]
        holds.append(static_holds(self._model.setting_at(self._parts(numbers)[0])))
        is_allowed = jnp.all(jnp.stack(holds)) & jnp.all((sigma > 0) & jnp.isfinite(sigma))
        # What is not selected is computed too, at numbers where nothing can go wrong: its derivatives are not NaN then.
        numbers = jnp.where(is_allowed, numbers, self.first_guess)
        sigma = jnp.where(is_allowed, sigma, 1.0)
        is_there = jnp.asarray(self._windows.is_measured)
        seen = predicted(self._model, self._windows, *self._parts(numbers))
        reaches_end = jnp.all(jnp.isfinite(seen) | ~is_there)
        residuals = jnp.where(is_there & reaches_end, seen - self._windows.values, 0.0)
        counts = jnp.sum(is_there, axis=(0, 2))
        chi_squared = jnp.sum((residuals / sigma[None, :, None]) ** 2)
        density = -0.5 * chi_squared - jnp.sum(counts * (jnp.log(sigma) + 0.5 * math.log(2 * math.pi)))
        return jnp.where(is_allowed & reaches_end, density, -jnp.inf)

    def _numbers(self, values: Any) -> FloatArray:
        """The numbers in their order, (parameters,)."""
        if isinstance(values, Mapping):
            if set(values) != set(self.names):
                raise checks.refused("values", f"hold a number for each of {', '.join(self.names)}", list(values))
            values = [values[name] for name in self.names]
        if isinstance(values, (list, tuple)):
            singles = [checks.jax_array("values", value) for value in values]
            if any(single.ndim for single in singles):
                raise ValueError(
                    "Argument values must hold single numbers; for many points at once call it under jax.vmap."
                )
            values = jnp.stack(singles) if singles else jnp.zeros(0)
        found = checks.jax_array("values", values).astype(self.first_guess.dtype)
        if found.shape != self.first_guess.shape:
            raise ValueError(
                f"Argument values must hold one number for each of {', '.join(self.names)}, but an array of shape "
                f"{found.shape} was given; for many points at once call it under jax.vmap."
            )
        return found

    def _sigma(self, noise: Mapping[str, ArrayLike] | None) -> FloatArray:
        """The standard deviation of each channel, (channels,)."""
        given = checked_noise(noise, self.channels)
        known = zip(self.channels, self._is_known, strict=True)
        if missing := [name for name, is_known in known if not is_known and name not in given]:
            raise ValueError(
                f"Argument noise must give the standard deviation of each channel, here or to log_likelihood, but that "
                f"of {missing[0]!r} is missing."
            )
        asked = {name: checks.jax_array(f"noise[{name!r}]", value) for name, value in given.items()}
        if several := [name for name, value in asked.items() if value.ndim]:
            raise ValueError(f"Argument noise must hold a single number for {several[0]!r}.")
        deviations = [asked.get(name, self.noise[row]) for row, name in enumerate(self.channels)]
        return jnp.stack(deviations).astype(self.noise.dtype)

    def _parts(self, numbers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What `predicted` takes: the numbers of system and base, and the state at the start, (1, coordinates)."""
        in_setting = [i for i, coordinate in enumerate(self._coordinates) if coordinate is None]
        state = self._start
        for number, coordinate in zip(numbers, self._coordinates, strict=True):
            state = state if coordinate is None else state.at[coordinate].set(number)
        return numbers[np.array(in_setting, int)], state[None]


# So that single calls are fast too, and the record is no constant of the program.
_density = kept_jit(LogLikelihood._density, filtered=True)


def log_likelihood(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    *,
    wrt: str | tuple[str, ...] | list[str],
    noise: Mapping[str, float] | None = None,
    y0: InitialState | None = None,
    observe: Mapping[str, Observer] | None = None,
    method: Exact | Regularized = EXACT,
) -> LogLikelihood:
    """The log likelihood of a record of motion, as a function of numbers of the system, its base and its start.

    For samplers of posteriors such as those of numpyro and blackjax (docs/howto/posteriors.md); add the logarithm of a
    prior. One motion from t = 0 is compared with the whole record; estimates by `calibrate` are where to begin, and
    where the motion is chaotic use its windows instead.

    Args:
        system: With first guesses of the numbers.
        base: What drives it: a motion without randomness, such as `Harmonic`, a measured one as a `Recorded`.
        times: Of the measurements, s, increasing, from 0 on, (times,).
        measured: What was measured, (times,) each, NaN where it was not, by the names of coordinates ("position",
            "velocity"), as "acceleration" or "friction force", or by the names in `observe`.
        wrt: The names of the numbers that are not known, such as "mu" or "position.offset"; initial values are "y0[0]",
            "y0[1]" and so on.
        noise: The standard deviation of the noise of each channel, in its unit; those left out are given in each call.
        y0: The state at t = 0: at rest in the origin by default. Where `wrt` names initial values,
            their first guesses.
        observe: For each channel with a name of its own a function of a `Simulation` and times (s, (times,)), in JAX.
        method: `Exact` or `Regularized`. `Exact` takes up to twice as many steps as the first guesses need, or as many
            as its `max_steps` says; numbers that need more are taken as impossible. `Regularized` needs its
            `max_steps`.

    Returns:
        A `LogLikelihood`.

    Raises:
        ValueError: For arguments outside these bounds, and for names that fit no number.

    >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    >>> base = ss.Harmonic(0.8, 1.3)
    >>> times = 0.1 * jax.numpy.arange(100)
    >>> seen = ss.simulate(system, base, t1=10.0, y0=(0.3, 0.0)).evaluate(times)[0]
    >>> likelihood = ss.log_likelihood(
    ...     system, base, times, {"position": seen},
    ...     wrt="mu", noise={"position": 0.01}, y0=(0.3, 0.0),
    ... )
    >>> print(f"{likelihood({'mu': 0.7}):.2f}, {likelihood({'mu': -0.7})}")
    368.62, -inf
    """
    checks.require_threads_of_jax()
    arguments, start, record = asked(system, base, times, measured, noise, y0, observe, method)
    setting, method = EstimatedNumbers(arguments.system, arguments.base), arguments.method
    state = tuple(start.tolist())
    parameters = parameters_of({"system": setting.system, "base": setting.base, "y0": state}, wrt)
    dtype = working_dtype()
    windows = record.cut(np.zeros(1, int), 0.0)
    of_setting = [parameter for parameter in parameters if parameter.path[0] != "y0"]
    model = FittedMotion(
        setting=as_arrays(setting, dtype), state_origin=jnp.zeros((1, len(state)), dtype), resting=None, method=method,
        transform=identity(len(of_setting), dtype), paths=tuple(parameter.path for parameter in of_setting),
        observers=tuple(channel.observe for channel in record.channels), steps=loop_steps(arguments, float(_SPARE)),
    )  # fmt: skip
    return LogLikelihood(
        names=tuple(parameter.name for parameter in parameters),
        channels=tuple(channel.name for channel in record.channels),
        first_guess=jnp.asarray([parameter.value for parameter in parameters], dtype),
        noise=jnp.asarray(record.noise, dtype),
        _model=model,
        _windows=jax.tree.map(jnp.asarray, windows),
        _start=jnp.asarray(state, dtype),
        _abouts=tuple(Quantity() if p.path[0] == "y0" else quantity_at(setting, p.path) for p in parameters),
        _coordinates=tuple(int(p.path[1]) if p.path[0] == "y0" else None for p in parameters),
        _is_known=tuple(bool(np.isfinite(sigma)) for sigma in record.noise),
    )


# `stick_simulator`: from parameters to summaries of the sticks, for inference that needs no likelihood.


Summaries = Callable[[Ensemble], npt.ArrayLike]


@dataclasses.dataclass(frozen=True, eq=False)
class StickSimulator:
    """A function of parameters and a key; see `stick_simulator`, which makes it.

    - `system`, `law`, `t1` (s), `y0`, `method`: what is simulated.
    - `wrt`: the names of the parameters, in the order of their columns.
    - `realizations`: how many each row's summaries are the mean of.
    - `summaries`: the function that makes them; None for the number of sticks and the total stick time (s).
    - `threads`: worker threads, None for all cores.
    """

    system: System
    law: BaseMotion
    wrt: tuple[str, ...]
    t1: float
    y0: InitialState | None
    method: Exact | Regularized
    realizations: int
    summaries: Summaries | None
    threads: int | None

    def __call__(self, parameters: npt.ArrayLike, key: Array | None) -> np.ndarray:
        """The summaries of each row of `parameters` (batch, parameters), simulated with `key`: (batch, summaries).

        Row i uses the realisations ``i * realizations``, ... that `key` draws (None where nothing is random): give each
        batch a key of its own. Rows of which a realisation did not reach `t1` are NaN, and a warning says how many.

        Raises:
            ValueError: For another shape, and for numbers that are not finite or outside the bounds of their fields.
        """
        rows = checks.numbers("parameters", parameters)
        if rows.ndim != 2 or rows.shape[1] != len(self.wrt) or not len(rows):
            demand = f"be an array (batch, {len(self.wrt)}) with a column for each of {', '.join(self.wrt)}"
            raise checks.refused("parameters", demand, f"an array of shape {rows.shape}")
        number = self.realizations
        many = simulate_ensemble(
            self.system, self.law, t1=self.t1, samples=table(np.repeat(rows, number, axis=0), self.wrt), key=key,
            y0=self.y0, method=self.method, keep="totals" if self.summaries is None else "sticks",
            threads=self.threads, progress=False,
        )  # fmt: skip
        if self.summaries is None:
            found = np.column_stack([many.totals.sticks, many.totals.stick_time])
        else:
            found = np.asarray(self.summaries(many), float)
            if found.ndim != 2 or len(found) != many.samples:
                raise ValueError(
                    f"Argument summaries must return an array ({many.samples}, summaries), a row for each sample of "
                    f"the ensemble, but one of shape {found.shape} was returned."
                )
        finished = np.all(np.equal(many.totals.status, Status.FINISHED).reshape(-1, number), axis=1)
        means = np.mean(found.reshape(len(rows), number, -1), axis=1)
        if not np.all(finished):
            means[~finished] = np.nan
            checks.warn(
                f"{np.count_nonzero(~finished)} of {len(rows)} rows did not reach t1 = {self.t1:g} s and are NaN; see "
                "the status of simulate with these numbers."
            )
        return means


def stick_simulator(
    system: System,
    law: BaseMotion,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    y0: InitialState | None = None,
    realizations: int = 1,
    summaries: Summaries | None = None,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
) -> StickSimulator:
    """A simulator of the sticks of many parameters at once, as tools for likelihood-free inference take it.

    ``simulator(parameters, key)`` takes an array (batch, parameters), or what NumPy makes one of, such as a tensor of
    PyTorch, and returns an array (batch, summaries). All rows are simulated side by side, each with random numbers of
    its own: approximate Bayesian computation with a million rows takes seconds (docs/howto/posteriors.md).

    Args:
        system: The system; the numbers that `wrt` names are replaced.
        law: A random excitation, any that `simulate_ensemble` takes.
        wrt: The names of the parameters, in the order of the columns: those of fields of the system or the law, such as
            "mu" or "rate", and "y0[0]", "y0[1]".
        t1: Duration, s.
        y0: Initial state, such as ``(position, velocity)``, numbers or distributions; zeros by default.
        realizations: Of each row, independent of each other; its summaries are their mean. As many as recordings were
            made.
        summaries: A function of the `Ensemble` of all samples, with all their sticks, to an array (samples, summaries);
            it must give each row by the sample's own sticks. By default the number of sticks and the total stick time
            (s) of each sample: the fastest, as no stick is kept.
        method: `Exact`, with a time step where one is needed, or `Regularized`.
        threads: Worker threads (default: all cores).

    Returns:
        A `StickSimulator`.

    Raises:
        ValueError: For arguments outside these bounds, by the first call where they are those of `simulate_ensemble`.

    >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> simulator = ss.stick_simulator(
    ...     system, law, wrt=("mu", "rate"), t1=50.0, realizations=100
    ... )
    >>> print(simulator([[0.5, 1.0], [1.5, 1.0]], jax.random.key(0)).round(2))
    [[ 6.22  0.83]
     [18.25  6.82]]
    """
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt) if isinstance(wrt, (tuple, list)) else ()
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise checks.refused("wrt", "be a parameter's name or several different ones", wrt)
    check_method(method)
    known = [path for path, _ in numbers_in(checked_model(system, law, y0)._asdict(), whole=True)]
    for name in names:
        matching("wrt", name, known)
    checks.positive("t1", t1, "s")
    number = checks.whole_number("realizations", realizations, maximum=MOST_SAMPLES)
    if threads is not None:
        checks.whole_number("threads", threads)
    if summaries is not None and not callable(summaries):
        raise checks.refused("summaries", "be a function of an Ensemble, or None", summaries)
    return StickSimulator(system, law, names, float(t1), y0, method, number, summaries, threads)
