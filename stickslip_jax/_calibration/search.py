"""The fit of a record in windows, and as one motion."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.stopping_scan import padded_length
from .._dynamics.common.validation import Arguments
from .._dynamics.switched.run import steps_for
from .._numerics.leaves import as_arrays
from .._uncertainty.numbers import Parameter, with_numbers
from .cutting import Cuts, cuts_of
from .fit import Fit, Free, Point, Problem, chi_squared
from .problem import Model, Setting
from .record import Record
from .transform import Transform

_MOST_ROUNDS = 20  # of noise and fit
_CONTRADICTION = 1e-4  # probability that one motion is given up although it holds
_MOST_DOUBLINGS = 5  # of the number of steps


class Search(NamedTuple):
    """What is asked, and the numbers of the search that do not change between fits."""

    record: Record
    arguments: Arguments
    parameters: tuple[Parameter, ...]
    transform: Transform
    y0: np.ndarray | None
    setting: Setting

    def cuts(self, number: int) -> Cuts:
        """Where `number` windows begin, and the states there by the measurements."""
        system, _, method, _ = self.arguments
        if number > 1 or self.begins_where_measured:
            solver = method.solver if isinstance(method, Exact) else None
            return cuts_of(self.record, self.setting, solver, number)
        size = len(system.coordinates)
        state = np.zeros(size) if self.y0 is None else self.y0
        return Cuts(np.zeros(1, int), state[None], None)

    @property
    def begins_where_measured(self) -> bool:
        """Whether one motion over the whole record begins at its first measurement; at t = 0 otherwise."""
        return self.y0 is None and isinstance(self.arguments.method, Exact)

    def problem(self, cuts: Cuts, numbers: np.ndarray, more: int = 1) -> Problem:
        """The problem in windows, with steps for the parameters at `numbers`, or `more` times as many."""
        method = self.arguments.method
        is_from_zero = len(cuts.firsts) == 1 and not self.begins_where_measured
        windows = self.record.cut(cuts.firsts, 0.0 if is_from_zero else None)
        dtype = jnp.result_type(float)
        model = Model(
            as_arrays(self.setting, dtype),
            jnp.asarray(cuts.states, dtype),
            None if cuts.resting is None else jnp.asarray(cuts.resting),
            method,
            Transform(*(jnp.asarray(one, dtype) for one in self.transform)),
            tuple(parameter.path for parameter in self.parameters),
            tuple(channel.observe for channel in self.record.channels),
            0
            if isinstance(method, Regularized)
            else more * self._steps(np.asarray(windows.ends - windows.begins), numbers),
        )
        return Problem(model, jax.tree.map(jnp.asarray, windows))

    def _steps(self, durations: np.ndarray, numbers: np.ndarray) -> int:
        """Loop steps for the longest window, with the parameters at `numbers`."""
        paths = tuple(parameter.path for parameter in self.parameters)
        system, base, *_ = with_numbers(self.setting, paths, [float(number) for number in numbers])
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
        numbers = self.transform.numbers(fit.point.x)
        windows = problem.windows
        return self._steps(np.asarray(windows.ends - windows.begins), numbers) > problem.model.steps


class Found(NamedTuple):
    """A fit, its problem, what was searched, and the noise of each channel, (channels,)."""

    problem: Problem
    fit: Fit
    free: Free
    sigma: np.ndarray


def fitted(search: Search, cuts: Cuts, x: np.ndarray, sigma: np.ndarray | None = None) -> Found:
    """The fit in windows from `x`, with the noise that is not known estimated, or with `sigma`."""
    free = Free(np.ones(len(x), bool), len(cuts.firsts) > 1 or search.y0 is None)
    more = 1
    problem = search.problem(cuts, search.transform.numbers(x), more)
    start = Point(x, np.zeros(problem.model.state_origin.shape))
    for _ in range(_MOST_DOUBLINGS):
        if np.all(np.isfinite(problem.seen(start).residuals)):
            break
        more *= 2
        problem = search.problem(cuts, search.transform.numbers(x), more)
    else:
        raise ValueError(
            "Arguments system and base must have a motion that reaches the end of the record with the first guesses, "
            f"{', '.join(f'{one.name} = {one.value:g}' for one in search.parameters)}, but it does not; see the status "
            "of simulate(system, base, ...)."
        )
    found = _with_noise(problem, search.record, start, free, sigma)
    while search.needs_more(problem, found.fit):
        numbers = search.transform.numbers(found.fit.point.x)
        problem = search.problem(cuts, numbers, more)
        found = _with_noise(problem, search.record, found.fit.point, free, sigma)
    return found


def _with_noise(
    problem: Problem,
    record: Record,
    start: Point,
    free: Free,
    sigma: np.ndarray | None,
    about: np.ndarray | None = None,
) -> Found:
    """The fit with the noise `sigma`, or with the standard deviation of what is not known of it estimated too, in turn.

    `about`: where to begin with that.
    """
    if sigma is not None:
        return Found(problem, problem.search(sigma, start, free), free, sigma)
    known = np.isfinite(record.noise)
    spread = np.nanstd(record.values, axis=1)
    least = 1e-10 * np.nanmax(np.abs(record.values), axis=1) + np.finfo(float).tiny
    sigma = np.where(known, record.noise, np.maximum(0.1 * spread, least)) if about is None else about
    fit = problem.search(sigma, start, free)
    for _ in range(_MOST_ROUNDS if not np.all(known) else 0):
        spent = (np.count_nonzero(free.x) + free.s * fit.point.s.size) * record.counts / record.counts.sum()
        squares = np.sum(fit.seen.residuals**2, axis=(0, 2)) / np.maximum(record.counts - spent, 1)
        new = np.where(known, record.noise, np.maximum(np.sqrt(squares), least))
        is_settled = np.all(np.abs(new - sigma) < 1e-4 * sigma)
        sigma = new
        if is_settled:
            break
        # Of a single channel too: what holds numbers near their first guesses weighs more the larger the noise.
        fit = problem.search(sigma, fit.point, free)
    return Found(problem, fit, free, sigma)


def as_one(search: Search, found: Found) -> Found | float:
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
        whole = fitted(search, cuts, found.fit.point.x, found.sigma)
    except ValueError:
        return np.inf
    growth = chi_squared(whole.fit.seen.over(found.sigma)) - with_windows
    fewer = found.fit.point.s.size - (search.y0 is None) * whole.fit.point.s.size
    if not whole.fit.converged or growth > stats.chi2.isf(_CONTRADICTION, fewer):
        return growth
    return _with_noise(whole.problem, search.record, whole.fit.point, whole.free, None, found.sigma)
