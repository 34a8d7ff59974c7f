"""The search for the numbers that explain a record best, in windows and as one motion: what is fitted, and how."""

from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import optimize, sparse, stats

from .._compiler.programs import kept_jit
from .._dynamics.common.method import Arguments, Exact, Regularized
from .._dynamics.common.path import SegmentLaws, padded_length
from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation
from .._dynamics.sticks import ALL
from .._dynamics.switched.engine import SwitchedEngine, steps_for
from .._excitation.excitation import BaseMotion, excitation_of, merged
from .._excitation.segments import first_segment, segment_at
from .._foundation.fields import Quantity, modules_in
from .._foundation.types import BoolArray, FloatArray, Scalar
from .._numerics.derivatives import as_arrays
from .._systems.friction import FrictionLaw
from .._systems.system import System
from .._uncertainty.numbers import NumberPath, Parameter, with_numbers
from .parameters import Transform
from .record import Observer, Record, Windows, start_guess

# What is fitted: numbers of a system and its base, and the states in which windows of the record begin.


_ROUND_OFF = 1e-12  # relative, of static friction below kinetic


class Sensor(eqx.Module):
    """What a channel shows: what it measures, a time `delay` ago, and a constant `offset` more."""

    delay: Annotated[Scalar, Quantity("s")] = 0.0
    offset: Annotated[Scalar, Quantity()] = 0.0


class EstimatedNumbers(NamedTuple):
    """Where the numbers to be estimated stand. `clock`: a delay of the whole record; `sensors`: of the channels, or
    none if all are as they should be.
    """

    system: System
    base: BaseMotion
    clock: Sensor = Sensor()
    sensors: tuple[Sensor, ...] = ()


def static_holds(setting: EstimatedNumbers) -> BoolArray:
    """Whether in no friction law static friction is below kinetic friction."""
    holds = jnp.ones((), bool)
    for law in modules_in(setting):
        if isinstance(law, FrictionLaw) and law.inner_state is None and not law.depends_on_direction:
            kinetic = jnp.asarray(law.kinetic(jnp.zeros(())))
            holds = holds & (jnp.asarray(law.static) >= kinetic * (1 - _ROUND_OFF))
    return holds


class FittedMotion(eqx.Module):
    """The motion as a function of the numbers to be estimated (`paths`, by their `transform`) and of states at starts.

    States are searched as differences from `state_origin` (windows, coordinates); contacts that are `resting` at a
    start (windows, modes) have no relative velocity there, whatever the state.
    """

    setting: EstimatedNumbers
    state_origin: Array
    resting: Array | None
    method: Exact | Regularized
    transform: Transform
    paths: tuple[NumberPath, ...] = eqx.field(static=True)
    observers: tuple[Observer, ...] = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def setting_at(self, numbers: FloatArray) -> EstimatedNumbers:
        """System, base and sensors with other numbers, (parameters,)."""
        return with_numbers(self.setting, self.paths, numbers)

    def observed(
        self, x: FloatArray, s: FloatArray, origin: FloatArray, resting: BoolArray | None, window: Windows
    ) -> FloatArray:
        """What is seen of one window's motion, (channels, times); NaN if it does not reach the window's end, and for
        static friction below kinetic friction.
        """
        setting, y = self.setting_at(self.transform.numbers(x)), origin + s
        system, base, clock, sensors = setting
        begin, end, times = map(jnp.asarray, (window.begins, window.ends, window.times))
        if isinstance(self.method, Regularized):
            one = simulate(system, base, t1=end, y0=tuple(y), method=self.method)
        else:
            excitation, step = Arguments(system, merged(base, end), self.method, end).checked_step()
            given = end, tuple(y), step, self.steps, self.method.solver
            engine = SwitchedEngine(system, excitation, *given, quantities=ALL)
            run = engine.run(*engine.follow(y.dtype, t0=begin, resting=resting))
            one = Simulation(system, base, end, self.method, *run)
        if sensors:
            shown, late = zip(self.observers, sensors, strict=True), times - clock.delay
            seen = jnp.stack([observe(one, late - sensor.delay) + sensor.offset for observe, sensor in shown])
        else:
            seen = jnp.stack([observe(one, times) for observe in self.observers])
        return jnp.where(static_holds(setting), seen, jnp.nan)


def loop_steps(arguments: Arguments, share: float, spare: int = 0) -> int:
    """Loop steps for this share of the time until the end, and `spare` ones; as many as the method says, if it does."""
    system, _, method, t1 = arguments
    if isinstance(method, Regularized):  # knows them itself
        return 0
    if method.max_steps is not None:
        return method.max_steps
    excitation, step = arguments.checked_step()
    return padded_length(int(share * steps_for(system, excitation, t1, step)) + spare)


def with_slopes(model: FittedMotion, windows: Windows, x: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is seen of the motions in all windows, (windows, channels, times), and its derivatives by `x` and the own
    state of each window, (windows, channels, times, parameters + coordinates).

    `x` (parameters,), `s` (windows, coordinates). In forward mode: each window depends on few numbers.
    """
    number = x.shape[0]

    def both(
        joined: FloatArray, origin: FloatArray, resting: BoolArray | None, window: Windows
    ) -> tuple[FloatArray, FloatArray]:
        seen = model.observed(joined[:number], joined[number:], origin, resting, window)
        return seen, seen

    joined = jnp.concatenate([jnp.broadcast_to(x, (s.shape[0], number)), s], axis=1)
    slopes, seen = jax.vmap(jax.jacfwd(both, has_aux=True))(joined, model.state_origin, model.resting, windows)
    return seen, slopes


@eqx.filter_custom_jvp
def predicted(model: FittedMotion, windows: Windows, x: FloatArray, s: FloatArray) -> FloatArray:
    """What is seen of the motions in all windows, (windows, channels, times), with derivatives of first order by x, s.

    They are all computed at once, by `with_slopes`; reverse mode multiplies by them. Where a motion does not reach its
    end they are zero, so that a `where` can leave it out.
    """
    return jax.vmap(model.observed, in_axes=(None, 0, 0, 0, 0))(x, s, model.state_origin, model.resting, windows)


@predicted.def_jvp
def _(primals: Any, tangents: Any) -> tuple[FloatArray, FloatArray]:
    (model, windows, x, s), (of_model, of_windows, dx, ds) = primals, tangents
    assert not jax.tree.leaves((of_model, of_windows)), "only x and s have derivatives"
    dx, ds = jnp.zeros_like(x) if dx is None else dx, jnp.zeros_like(s) if ds is None else ds
    seen, slopes = with_slopes(model, windows, x, s)
    slopes = jnp.where(jnp.isfinite(seen)[..., None], slopes, 0)
    changes = jnp.concatenate([jnp.broadcast_to(dx, (s.shape[0], x.shape[0])), ds], axis=1)
    return seen, jnp.einsum("wctp,wp->wct", slopes, changes)


@kept_jit(filtered=True)
def slip_speeds(setting: EstimatedNumbers, solver: Any, times: FloatArray, states: FloatArray) -> FloatArray:
    """The sizes of the relative velocities of contacts in `states` (times, coordinates) at `times` (s), (times, modes)
    or (times,); infinite for modes that are no contacts.
    """
    system, base, *_ = setting
    excitation, dtype = excitation_of(merged(base, times[-1])), states.dtype
    laws = SegmentLaws.of(system, excitation)
    model = system.switched_model(excitation.signal, solver)
    firsts = tuple(first_segment(law, jnp.zeros(2, jnp.uint32), dtype) for law in laws.all)

    def at(t: FloatArray, y: FloatArray) -> FloatArray:
        segments = tuple(segment_at(law, first, t) for law, first in zip(laws.all, firsts, strict=True))
        forcing, state = model.forcing(t, laws.segments(segments)), model.start(tuple(y), dtype)
        speeds = jnp.abs(model.relative_velocity(forcing, jnp.zeros((), dtype), state))
        modes = model.at_rest(forcing, state).shape
        return jnp.full(modes, jnp.inf).at[: len(speeds)].set(speeds) if modes else speeds

    return jax.vmap(at)(times, states)


# The search for the numbers that explain a record best: nonlinear least squares, by scipy.
#
# Every evaluation gives the residuals with all their derivatives, by one compiled program. So each problem is compiled
# once, whatever is searched: all numbers, or some while others stay (`Free`).


_MOST_EVALUATIONS = 300
_TOLERANCE = 1e-9  # relative, of chi-squared and of the numbers
_LARGEST_DENSE = 1 << 22  # entries of the matrix of derivatives
_NEAR_BOUND = 0.3  # in coordinates: whether the record rather has the number at the bound itself is tried
LOOSE = 0.1
"""Weight of the distance from the first guess among the standardised residuals: a number that the record does not tell
stays there. One with a standard error of 1 % moves by less than a thousandth of that for it."""


class SearchPoint(NamedTuple):
    """Where a search stands: `x` (parameters,) and `s` (windows, coordinates), as the model takes them."""

    x: np.ndarray
    s: np.ndarray


class Free(NamedTuple):
    """Which numbers are searched: of the parameters, (parameters,), and whether the states at starts are."""

    x: np.ndarray
    s: bool


class Residuals(NamedTuple):
    """Predictions less measurements (windows, channels, times), 0 where nothing was measured, and their derivatives
    (windows, channels, times, parameters + coordinates).
    """

    residuals: np.ndarray
    slopes: np.ndarray

    def over(self, sigma: np.ndarray) -> "Residuals":
        """The same in units of the noise of each channel, (channels,)."""
        return Residuals(self.residuals / sigma[:, None], self.slopes / sigma[:, None, None])

    @property
    def chi_squared(self) -> float:
        """The sum of squares, of standardised residuals."""
        return float(np.sum(np.square(self.residuals)))


class FitProblem(NamedTuple):
    """A model, and a record and its windows."""

    model: FittedMotion
    windows: Windows
    record: Record

    def seen(self, point: SearchPoint) -> Residuals:
        """Residuals and derivatives at a point; NaN where a motion does not reach its window's end."""
        try:
            seen, slopes = map(
                np.asarray, _with_slopes(self.model, self.windows, jnp.asarray(point.x), jnp.asarray(point.s))
            )
        except eqx.EquinoxRuntimeError:  # an implicit step found no solution
            shape = self.windows.is_measured.shape
            seen, slopes = np.full(shape, np.nan), np.full((*shape, len(point.x) + point.s.shape[1]), np.nan)
        there = self.windows.is_measured
        return Residuals(np.where(there, seen - self.windows.values, 0), np.where(there[..., None], slopes, 0))

    def search(self, sigma: np.ndarray, start: SearchPoint, free: Free) -> "FoundFit":
        """The least-squares fit from `start`, with the noise `sigma` (channels,)."""
        number = int(np.count_nonzero(free.x))
        latest: list[tuple[np.ndarray, Residuals]] = []

        def point(vector: np.ndarray) -> SearchPoint:
            x = start.x.copy()
            x[free.x] = vector[:number] - 1
            return SearchPoint(x, vector[number:].reshape(start.s.shape) if free.s else start.s)

        def at(vector: np.ndarray) -> Residuals:
            if not latest or not np.array_equal(latest[0][0], vector):
                latest[:] = [(vector.copy(), self.seen(point(vector)))]
            return latest[0][1].over(sigma)

        # SciPy's first step is up to as long as the vector where it begins: of length one in each number from its guess
        # on.
        begin = np.concatenate([1 + start.x[free.x], start.s.ravel() if free.s else []])
        rope = LOOSE * np.eye(number, len(begin))

        def residuals(vector: np.ndarray) -> np.ndarray:
            return np.concatenate([at(vector).residuals.ravel(), LOOSE * (vector[:number] - 1)])

        def jacobian(vector: np.ndarray):
            matrix = matrix_of(at(vector), free)
            return (
                np.vstack([matrix, rope]) if isinstance(matrix, np.ndarray) else sparse.vstack([matrix, rope]).tocsr()
            )

        if not len(begin):
            return FoundFit(self, free, sigma, start, self.seen(start), True)
        box = self.model.transform.box
        low, high = (
            np.pad(1 + end[free.x], (0, len(begin) - number), constant_values=beyond)
            for end, beyond in zip(box, (-np.inf, np.inf), strict=True)
        )
        options: dict[str, Any] = {"jac": jacobian, "x_scale": "jac", "max_nfev": _MOST_EVALUATIONS}
        tolerances: dict[str, Any] = {"ftol": _TOLERANCE, "xtol": _TOLERANCE, "gtol": None}
        found = optimize.least_squares(residuals, begin, bounds=(low, high), **options, **tolerances)
        at_end = point(found.x)
        fit = FoundFit(self, free, sigma, at_end, self.seen(at_end), found.status > 0)
        # SciPy comes as near to a bound as its tolerance asks, and never there; to some only slowly, as to static
        # friction as large as kinetic one, where nothing depends on the difference to first order.
        x = fit.point.x
        nearest = np.where(x - box[0] < box[1] - x, *box)
        ends = np.where(free.x & (np.abs(x - nearest) < _NEAR_BOUND), nearest, x)
        if np.array_equal(ends, x):
            return fit
        at_bound = fit.point._replace(x=ends)
        there = fit._replace(point=at_bound, raw=self.seen(at_bound))
        return there if there.seen.chi_squared <= fit.seen.chi_squared * (1 + _TOLERANCE) else fit


class FoundFit(NamedTuple):
    """The end of a search: its problem, what was searched, the noise `sigma` of each channel, (channels,), where it
    ended, what is seen there (`raw`: not standardised), and whether it converged.
    """

    problem: FitProblem
    free: Free
    sigma: np.ndarray
    point: SearchPoint
    raw: Residuals
    converged: bool

    @property
    def seen(self) -> Residuals:
        """The residuals, standardised."""
        return self.raw.over(self.sigma)


def matrix_of(seen: Residuals, free: Free) -> np.ndarray | sparse.coo_matrix:
    """The derivatives of all residuals by all that is free, parameters first, (residuals, numbers)."""
    number, windows = len(free.x), len(seen.slopes)
    of_x = seen.slopes[..., :number][..., free.x].reshape(seen.residuals.size, np.count_nonzero(free.x))
    if not free.s:
        return of_x
    own = seen.slopes[..., number:].reshape(windows, -1, seen.slopes.shape[-1] - number)
    if of_x.shape[0] * (of_x.shape[1] + windows * own.shape[-1]) <= _LARGEST_DENSE:
        whole = np.zeros((windows, own.shape[1], windows, own.shape[2]))
        whole[np.arange(windows), :, np.arange(windows)] = own
        return np.hstack([of_x, whole.reshape(of_x.shape[0], -1)])
    return sparse.hstack([sparse.coo_matrix(of_x), sparse.block_diag(list(own))])  # pyright: ignore[reportReturnType]


_with_slopes = kept_jit(with_slopes, filtered=True)


# Where windows of a record begin: in slips, where there are any, so that it is clear how the motion goes on.
#
# A motion that starts in a stick starts with no relative velocity exactly; with any other it would slip, and where
# static friction is above kinetic friction it would not be held again.


_CANDIDATES = 9  # for the begin of a window
_REACH = 0.4  # of a window, to both sides
_SLOW = 0.1  # of the usual slip speed, below which a contact is taken to stick
_SPAN = 0.05  # of a window, in which the state at its start is guessed from the measurements


class Cuts(NamedTuple):
    """Where windows begin: places among the times (windows,), states there (windows, coordinates), and which contacts
    stick there (windows, modes); None if none does.
    """

    firsts: np.ndarray
    states: np.ndarray
    resting: np.ndarray | None


# The fit of a record in windows, and as one motion.


_MOST_ROUNDS = 20  # of noise and fit
_CONTRADICTION = 1e-4  # probability that one motion is given up although it holds
_MOST_DOUBLINGS = 5  # of the number of steps
_SPARE = 32  # steps


class Search(NamedTuple):
    """What is asked, and the numbers of the search that do not change between fits."""

    record: Record
    arguments: Arguments
    parameters: tuple[Parameter, ...]
    transform: Transform
    y0: np.ndarray | None
    setting: EstimatedNumbers

    def cuts(self, number: int) -> Cuts:
        """Where windows begin, about `number` of equal duration, and the states there by the measurements.

        Each but the first begins where the slowest contact is fastest, of some measurements nearby.
        """
        record, system, method = self.record, self.arguments.system, self.arguments.method
        if number == 1 and not self.begins_where_measured:
            state = np.zeros(len(system.coordinates)) if self.y0 is None else self.y0
            return Cuts(np.zeros(1, int), state[None], None)
        times, width = record.times, np.ptp(record.times) / number
        edges = times[0] + width * np.arange(1, number)
        shifts = _REACH * width * np.linspace(-1, 1, _CANDIDATES)
        places = np.clip(np.searchsorted(times, edges[:, None] + shifts), 1, len(times) - 1)
        # What begins in a gap begins at the first measurement after it.
        candidates = np.vstack([np.zeros((1, _CANDIDATES), int), places])
        begins = record.begin(candidates.ravel())
        states = np.stack([start_guess(record, system, float(at), _SPAN * width) for at in begins])
        solver = method.solver if isinstance(method, Exact) else None
        speeds = np.asarray(slip_speeds(self.setting, solver, jnp.asarray(begins), jnp.asarray(states)))
        contacts = speeds.reshape(len(begins), -1)
        usual = np.sqrt(np.mean(np.where(np.isfinite(contacts), contacts, 1.0) ** 2, axis=0)) + np.finfo(float).tiny
        relative = contacts / usual
        best = np.argmax(np.min(relative, axis=1).reshape(candidates.shape), axis=1)
        firsts, unique = np.unique(candidates[np.arange(number), best], return_index=True)
        at = (np.arange(number) * _CANDIDATES + best)[unique]
        resting = (relative[at] < _SLOW).reshape((len(firsts), *speeds.shape[1:]))
        return Cuts(firsts, states[at], resting if np.any(resting) else None)

    @property
    def begins_where_measured(self) -> bool:
        """Whether one motion over the whole record begins at its first measurement; at t = 0 otherwise."""
        return self.y0 is None and isinstance(self.arguments.method, Exact)

    def problem(self, cuts: Cuts, numbers: np.ndarray, more: int = 1) -> FitProblem:
        """The problem in windows, with steps for the parameters at `numbers`, or `more` times as many."""
        is_from_zero = len(cuts.firsts) == 1 and not self.begins_where_measured
        windows = self.record.cut(cuts.firsts, 0.0 if is_from_zero else None)
        dtype = jnp.result_type(float)
        model = FittedMotion(
            as_arrays(self.setting, dtype),
            jnp.asarray(cuts.states, dtype),
            None if cuts.resting is None else jnp.asarray(cuts.resting),
            self.arguments.method,
            Transform(*(jnp.asarray(one, dtype) for one in self.transform)),
            tuple(parameter.path for parameter in self.parameters),
            tuple(channel.observe for channel in self.record.channels),
            more * self.steps(windows, numbers),
        )
        return FitProblem(model, jax.tree.map(jnp.asarray, windows), self.record)

    def steps(self, windows: Windows, numbers: np.ndarray) -> int:
        """Loop steps for the longest of the windows, with the parameters at `numbers`."""
        paths = tuple(parameter.path for parameter in self.parameters)
        system, base, *_ = with_numbers(self.setting, paths, [float(number) for number in numbers])
        share = min(1.0, 2 * float(np.max(np.asarray(windows.ends - windows.begins))) / float(self.arguments.t1))
        return loop_steps(self.arguments._replace(system=system, base=base), share, _SPARE)


def fitted(search: Search, cuts: Cuts, x: np.ndarray, sigma: np.ndarray | None = None) -> FoundFit:
    """The fit in windows from `x`, with the noise that is not known estimated, or with `sigma`."""
    free = Free(np.ones(len(x), bool), len(cuts.firsts) > 1 or search.y0 is None)
    more = 1
    problem = search.problem(cuts, search.transform.numbers(x), more)
    start = SearchPoint(x, np.zeros(problem.model.state_origin.shape))
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
    found = _with_noise(problem, start, free, sigma)
    # The motion where the search ended may need more steps than it had.
    while search.steps(problem.windows, numbers := search.transform.numbers(found.point.x)) > problem.model.steps:
        problem = search.problem(cuts, numbers, more)
        found = _with_noise(problem, found.point, free, sigma)
    return found


def _with_noise(
    problem: FitProblem, start: SearchPoint, free: Free, sigma: np.ndarray | None, about: np.ndarray | None = None
) -> FoundFit:
    """The fit with the noise `sigma`, or with the standard deviation of what is not known of it estimated too, in turn.

    `about`: where to begin with that.
    """
    if sigma is not None:
        return problem.search(sigma, start, free)
    record = problem.record
    known = np.isfinite(record.noise)
    spread = np.nanstd(record.values, axis=1)
    least = 1e-10 * np.nanmax(np.abs(record.values), axis=1) + np.finfo(float).tiny
    sigma = np.where(known, record.noise, np.maximum(0.1 * spread, least)) if about is None else about
    fit = problem.search(sigma, start, free)
    for _ in range(_MOST_ROUNDS if not np.all(known) else 0):
        spent = (np.count_nonzero(free.x) + free.s * fit.point.s.size) * record.counts / record.counts.sum()
        squares = np.sum(fit.raw.residuals**2, axis=(0, 2)) / np.maximum(record.counts - spent, 1)
        new = np.where(known, record.noise, np.maximum(np.sqrt(squares), least))
        is_settled = np.all(np.abs(new - sigma) < 1e-4 * sigma)
        sigma = new
        if is_settled:
            return fit._replace(sigma=sigma)
        # Of a single channel too: what holds numbers near their first guesses weighs more the larger the noise.
        fit = problem.search(sigma, fit.point, free)
    return fit


def as_one(search: Search, found: FoundFit) -> FoundFit | float:
    """One motion over the whole record, from the numbers `found` in windows; if the record contradicts it, by how much
    chi-squared grew.
    """
    cuts = search.cuts(1)
    if search.begins_where_measured:
        model = found.problem.model
        state = np.asarray(model.state_origin)[:1] + found.point.s[:1]
        cuts = cuts._replace(states=state, resting=None if model.resting is None else np.asarray(model.resting)[:1])
    try:
        whole = fitted(search, cuts, found.point.x, found.sigma)
    except ValueError:
        return np.inf
    growth = whole.seen.chi_squared - found.seen.chi_squared
    fewer = found.point.s.size - (search.y0 is None) * whole.point.s.size
    if not whole.converged or growth > stats.chi2.isf(_CONTRADICTION, fewer):
        return growth
    return _with_noise(whole.problem, whole.point, whole.free, None, found.sigma)
