"""`calibrate`: numbers of a system and its base from a record of motion."""

import dataclasses
import warnings
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from scipy import stats

from .. import _checks
from .. import _diffrax as diffrax
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.common.stopping_scan import padded_length
from .._dynamics.common.time_scales import slowest_time
from .._dynamics.common.validation import Arguments
from .._dynamics.switched.run import steps_for
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._numerics.leaves import as_arrays
from .._systems.system import System
from .._types import InitialState
from .._uncertainty.numbers import Parameter, parameters_of, with_numbers
from .cutting import Cuts, cuts_of
from .fit import Fit, Free, Point, Problem, chi_squared
from .problem import Model, Scale, Setting, scale_of
from .record import Observer, Record
from .report import result_of
from .result import Calibration

_PERIODS = 2.0  # of the slowest known time scale, in a window
_FEWEST = 12  # measurements in a window
_MOST_WINDOWS = 128
_MOST_ROUNDS = 20  # of noise and fit
_CONTRADICTION = 1e-4  # probability that one motion is given up although it holds
_MOST_DOUBLINGS = 5  # of the number of steps


class Search(NamedTuple):
    """What is asked, and the numbers of the search that do not change between fits."""

    record: Record
    arguments: Arguments
    parameters: tuple[Parameter, ...]
    scale: Scale
    y0: np.ndarray | None

    def cuts(self, number: int) -> Cuts:
        """Where `number` windows begin, and the states there by the measurements."""
        system, base, method, _ = self.arguments
        if number > 1 or self.begins_where_measured:
            solver = method.solver if isinstance(method, Exact) else None
            return cuts_of(self.record, Setting(system, base), solver, number)
        size = len(system.coordinates)
        state = np.zeros(size) if self.y0 is None else self.y0
        return Cuts(np.zeros(1, int), state[None], None)

    @property
    def begins_where_measured(self) -> bool:
        """Whether one motion over the whole record begins at its first measurement; at t = 0 otherwise."""
        return self.y0 is None and isinstance(self.arguments.method, Exact)

    def problem(self, cuts: Cuts, numbers: np.ndarray, more: int = 1) -> Problem:
        """The problem in windows, with steps for the parameters at `numbers`, or `more` times as many."""
        system, base, method, _ = self.arguments
        is_from_zero = len(cuts.firsts) == 1 and not self.begins_where_measured
        windows = self.record.cut(cuts.firsts, 0.0 if is_from_zero else None)
        dtype = jnp.result_type(float)
        model = Model(
            as_arrays(Setting(system, base), dtype),
            jnp.asarray(cuts.states, dtype),
            None if cuts.resting is None else jnp.asarray(cuts.resting),
            method,
            jnp.asarray(self.scale.origin, dtype),
            jnp.asarray(self.scale.size, dtype),
            self.scale.is_positive,
            tuple(parameter.path for parameter in self.parameters),
            tuple(channel.observe for channel in self.record.channels),
            0 if isinstance(method, Regularized) else more * self._steps(windows.ends - windows.begins, numbers),
        )
        return Problem(model, jax.tree.map(jnp.asarray, windows))

    def _steps(self, durations: np.ndarray, numbers: np.ndarray) -> int:
        """Loop steps for the longest window, with the parameters at `numbers`."""
        setting = Setting(self.arguments.system, self.arguments.base)
        paths = tuple(parameter.path for parameter in self.parameters)
        system, base = with_numbers(setting, paths, [float(number) for number in numbers])
        arguments = self.arguments._replace(system=system, base=base)
        assert isinstance(arguments.method, Exact)
        if arguments.method.max_steps is not None:
            return arguments.method.max_steps
        excitation, step = arguments.checked_step()
        share = min(1.0, 2 * float(np.max(durations)) / float(arguments.t1))
        return padded_length(int(share * steps_for(system, excitation, arguments.t1, step)) + 32)

    def needs_more(self, problem: Problem, fit: Fit) -> bool:
        """Whether the motion where a search ended may need more steps than it had."""
        if isinstance(problem.model.method, Regularized):
            return False
        numbers = np.asarray(self.scale.number(fit.point.x))
        windows = problem.windows
        return self._steps(np.asarray(windows.ends - windows.begins), numbers) > problem.model.steps


class Found(NamedTuple):
    """A fit, its problem, what was searched, and the noise of each channel, (channels,)."""

    problem: Problem
    fit: Fit
    free: Free
    sigma: np.ndarray


def calibrate(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    *,
    wrt: str | tuple[str, ...] | list[str],
    noise: Mapping[str, float] | None = None,
    y0: InitialState | None = None,
    windows: int | None = None,
    observe: Mapping[str, Observer] | None = None,
    method: Exact | Regularized = EXACT,
) -> Calibration:
    """Estimate numbers of a system and its base from a record of motion, by maximum likelihood.

    The motion is simulated exactly, with exact derivatives; noise is independent, Gaussian, and of one standard
    deviation in each channel. Long records are cut into windows, in each of which the motion starts anew from a state
    that is estimated too (multiple shooting): one motion over the whole record would be far from it in the end, until
    the numbers are nearly right. From there one motion over the whole record is fitted, and is the result if the record
    allows it; chaotic motions, and those that something unknown disturbs, are left in windows.

    Args:
        system: With first guesses of the numbers.
        base: What drives it, as for `simulate`: a motion without randomness, measured ones as a `Recorded`.
        times: Of the measurements, s, increasing, from 0 on, (times,); they need not be equally spaced.
        measured: What was measured, (times,) each, NaN where it was not. By the names of the system's coordinates
            ("position" in m, "velocity" in m/s; "angle", "current", "position 2", ...), as "acceleration" (m/s^2;
            where a coordinate is called "velocity 2", "acceleration 2"), as "friction force" (N), or by the names in
            `observe`. Accelerations and friction forces jump where a stick begins or a slip reverses, and the search
            does not see how a jump moves past a measurement: set those next to jumps to NaN, and measure positions too.
        wrt: The names of the numbers to be estimated, as for `sensitivity`: those of fields of the system or the base,
            such as "mu" or "friction.forward.mu". Positive ones are searched by their logarithms.
        noise: The standard deviation of the noise of each channel, in its unit; of those left out it is estimated.
        y0: The state at t = 0, where it is known; it is estimated otherwise (None).
        windows: How many. By default as many as have two periods of the system's slowest known time scale, and then
            one, as said above. With several, `y0` is not used.
        observe: A function of simulation (a `Simulation`, which begins where its window does) and times (s, (times,))
            for each channel with a name of its own, in JAX.
        method: As for `simulate`. With `Regularized` there is one window, which begins at t = 0.

    Returns:
        The estimates, with their errors; print it.

    Raises:
        ValueError: For arguments outside these bounds, for names that fit no number, and for a first guess from which
            no motion reaches the end of its window.

    >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    >>> base = ss.Harmonic(0.8, 1.3)
    >>> times = [0.1 * i for i in range(100)]
    >>> seen = ss.simulate(system, base, t1=10.0, y0=(0.3, 0.0)).evaluate(times)[0]
    >>> guess = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
    >>> found = ss.calibrate(guess, base, times, {"position": seen}, wrt="mu")
    >>> print(f"mu = {found['mu'].value:.6f}")
    mu = 0.700000
    """
    require_threads_of_jax()
    search = _checked(system, base, times, measured, wrt, noise, y0, observe, method)
    if isinstance(method, Regularized) and windows not in (None, 1):
        raise _checks.refused("windows", "be 1 with the method Regularized", windows)
    number = _usual_windows(search) if windows is None else _checks.whole_number("windows", windows)
    first = np.asarray(search.scale.searched(search.scale.origin))
    found = _fitted(search, search.cuts(number), first)
    given_up = None
    if windows is None and found.problem.windows.begins.shape[0] > 1:
        whole = _as_one(search, found)
        given_up = None if isinstance(whole, Found) else whole
        found = whole if isinstance(whole, Found) else found
    done = result_of(search.record, search.arguments, search.parameters, found, search.y0 is None, given_up)
    if not done.converged:
        warnings.warn(f"The search did not converge; do not use its numbers:\n{done}", RuntimeWarning, stacklevel=2)
    return done


def _checked(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    wrt: object,
    noise: Mapping[str, float] | None,
    y0: InitialState | None,
    observe: Mapping[str, Observer] | None,
    method: Exact | Regularized,
) -> Search:
    end = _checks.numbers("times", times, ndim=1)
    if not len(end) or not end[-1] > 0:
        raise _checks.refused("times", "be at least two increasing times from 0 on (in s)", times)
    arguments, start = Arguments.of_one(system, base, method, float(end[-1]), y0)
    if isinstance(method, Regularized) and method.step is None and method.adjoint is None:
        method = dataclasses.replace(method, adjoint=diffrax.ForwardMode())
    arguments = arguments._replace(
        base=base, method=method
    )  # base, whose numbers may be estimated, not those of its realisation
    record = Record.of(system, times, measured, noise, observe)
    parameters = parameters_of(Setting(system, base)._asdict(), wrt)
    scale = scale_of(Setting(system, base), parameters)
    return Search(record, arguments, parameters, scale, None if y0 is None else np.array(start, float))


def _usual_windows(search: Search) -> int:
    """As many windows as have some periods of the slowest time scale, and enough measurements."""
    system, base, method, t1 = search.arguments
    if isinstance(method, Regularized):
        return 1
    by_time = (t1 - search.record.times[0]) / (_PERIODS * slowest_time(system, base))
    by_number = len(search.record.times) / _FEWEST
    return int(np.clip(min(by_time, by_number), 1, _MOST_WINDOWS))


def _fitted(search: Search, cuts: Cuts, x: np.ndarray, sigma: np.ndarray | None = None) -> Found:
    """The fit in windows from `x`, with the noise that is not known estimated, or with `sigma`."""
    free = Free(np.ones(len(x), bool), len(cuts.firsts) > 1 or search.y0 is None)
    more = 1
    problem = search.problem(cuts, np.asarray(search.scale.number(x)), more)
    start = Point(x, np.zeros(problem.model.state_origin.shape))
    for _ in range(_MOST_DOUBLINGS):
        if np.all(np.isfinite(problem.seen(start).residuals)):
            break
        more *= 2
        problem = search.problem(cuts, np.asarray(search.scale.number(x)), more)
    else:
        raise ValueError(
            "Arguments system and base must have a motion that reaches the end of the record with the first guesses, "
            f"{', '.join(f'{one.name} = {one.value:g}' for one in search.parameters)}, but it does not; see the status "
            "of simulate(system, base, ...)."
        )
    found = _with_noise(problem, search.record, start, free, sigma)
    while search.needs_more(problem, found.fit):
        numbers = np.asarray(search.scale.number(found.fit.point.x))
        problem = search.problem(cuts, numbers, more)
        found = _with_noise(problem, search.record, found.fit.point, free, sigma)
    return found


def _with_noise(problem: Problem, record: Record, start: Point, free: Free, sigma: np.ndarray | None) -> Found:
    """The fit with the standard deviation of the noise that is not known estimated too, in turn."""
    if sigma is not None:
        return Found(problem, problem.search(sigma, start, free), free, sigma)
    known = np.isfinite(record.noise)
    spread = np.nanstd(record.values, axis=1)
    least = 1e-10 * np.nanmax(np.abs(record.values), axis=1) + np.finfo(float).tiny
    sigma = np.where(known, record.noise, np.maximum(0.1 * spread, least))
    fit = problem.search(sigma, start, free)
    for _ in range(_MOST_ROUNDS if not np.all(known) else 0):
        spent = (np.count_nonzero(free.x) + free.s * fit.point.s.size) * record.counts / record.counts.sum()
        squares = np.sum(fit.seen.residuals**2, axis=(0, 2)) / np.maximum(record.counts - spent, 1)
        new = np.where(known, record.noise, np.maximum(np.sqrt(squares), least))
        is_settled = np.all(np.abs(new - sigma) < 1e-4 * sigma)
        sigma = new
        if is_settled or len(sigma) == 1:  # the noise of a single channel does not change its fit
            break
        fit = problem.search(sigma, fit.point, free)
    return Found(problem, fit, free, sigma)


def _as_one(search: Search, found: Found) -> Found | float:
    """One motion over the whole record, from the numbers `found` in windows; if the record contradicts it, by how much
    chi-squared grew.
    """
    cuts = search.cuts(1)
    if search.begins_where_measured:
        model = found.problem.model
        state = np.asarray(model.state_origin)[:1] + found.fit.point.s[:1]
        cuts = cuts._replace(states=state, resting=None if model.resting is None else np.asarray(model.resting)[:1])
    with_windows = chi_squared(found.fit.seen.over(found.sigma))
    try:
        whole = _fitted(search, cuts, found.fit.point.x, found.sigma)
    except ValueError:
        return np.inf
    growth = chi_squared(whole.fit.seen.over(found.sigma)) - with_windows
    fewer = found.fit.point.s.size - (search.y0 is None) * whole.fit.point.s.size
    if not whole.fit.converged or growth > stats.chi2.isf(_CONTRADICTION, fewer):
        return growth
    return _with_noise(whole.problem, search.record, whole.fit.point, whole.free, None)
