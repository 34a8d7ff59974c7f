"""Periodic orbits, with sticks or without: Newton's method on the return map, with its exact derivative."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .. import _checks
from .._dynamics.common.method import EXACT, Exact
from .._dynamics.common.validation import Arguments, check_fixed, state_of, working_dtype
from .._excitation.excitation import BaseMotion, motion_of
from .._forks import require_threads_of_jax
from .._methods import WithMethods
from .._numerics.leaves import as_arrays
from .._simulation.call import simulate
from .._simulation.result import Simulation
from .._systems.system import System, checked_system
from .._types import Array, BoolScalar, FloatArray, FloatScalar, InitialState, Scalar
from ._cases import check_repeats
from ._cycle import Cycle, steps_in
from ._modes import Mode, modes_of
from ._newton import root_of
from ._orbit_parts import guessed_period, multipliers_of, without_trivial
from ._own_time import changes_by_itself
from ._period import check_signals, checked_period, drive_period

TOLERANCE = {8: 1e-10, 4: 1e-4}
_ITERATIONS = 30
_LEAST_SCALE = 1e-3  # of the largest number of the state: that of one which is zero
_STILL = 1e3  # tolerances: what its rates move an equilibrium in a period
_STEPS = 2  # times as many as one period of the guess needs: the period of a free orbit may become longer


class PeriodicOrbit(WithMethods):
    """A periodic orbit; a pytree, which `jax.vmap` makes many of, and JAX differentiates.

    Attributes:
        state: Where it begins, (coordinates,).
        period: s.
        monodromy: The derivative of the state after one period by that at its begin, (coordinates, coordinates); its
            eigenvalues are the `multipliers`. A stick takes one from its rank.
        converged: Whether the state comes back to within the tolerance, and moves in between: an equilibrium is no
            orbit. If not, the numbers are the last of the search.
        residuals: How far the state was from coming back, before each iteration and after the last, relative; NaN where
            there was no further iteration.
        system: The argument of `periodic_orbit`.
        base: The argument of `periodic_orbit`.
        method: The method, with the number of steps of one period.
        is_driven: Whether something that drives the system changes with time. If nothing does, the period was found
            too, and one multiplier is 1.
    """

    state: Array
    period: Array
    monodromy: Array
    converged: Array
    residuals: Array
    system: System
    base: BaseMotion
    method: Exact
    is_driven: bool = eqx.field(static=True)

    @property
    def multipliers(self) -> Array | np.ndarray:
        """The Floquet multipliers (complex, without unit), the largest first; those that sticks make 0 are exactly 0.

        Under JAX's transformations they are the eigenvalues of `monodromy` as LAPACK finds them, in its order.
        """
        if _checks.is_traced(self.monodromy) or self.monodromy.ndim > 2:
            return jnp.linalg.eigvals(self.monodromy)
        return multipliers_of(np.asarray(self.monodromy))

    @property
    def is_stable(self) -> bool:
        """Whether all multipliers are inside the unit circle; without a drive, all but the one that is 1."""
        found = np.asarray(self.multipliers)
        return bool(np.all(np.abs(found if self.is_driven else without_trivial(found)) < 1))

    @property
    def simulation(self) -> Simulation:
        """The motion over one period."""
        return simulate(self.system, self.base, t1=self.period, y0=tuple(self.state), method=self.method)

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The parts of the orbit between which a contact begins or ends to stick, or its slip changes direction."""
        return modes_of(self.system, self.base, self.method, self.period, self.state)


def periodic_orbit(
    system: System,
    base: BaseMotion,
    *,
    y0: InitialState,
    periods: int = 1,
    period: Scalar | None = None,
    tolerance: float | None = None,
    iterations: int = _ITERATIONS,
    method: Exact = EXACT,
) -> PeriodicOrbit:
    """The periodic orbit near a state, stable or not: Newton's method on the return map.

    The derivative of the map is exact, through every stick and slip, so that convergence is quadratic until a stick or
    slip appears or vanishes. What is found may repeat itself within the period. A pure function: under ``jit``,
    ``vmap`` and ``grad`` (the orbit's derivatives are those of the implicit function).

    Args:
        system: As in `simulate`, with any number of contacts.
        base: As in `simulate`; a motion that repeats itself.
        y0: A state near the orbit, at a whole number of periods of the drive, as the last of a `stroboscopic_section`.
        periods: After how many periods of the drive the orbit closes.
        period: s. Of the drive, by default that after which all motions that drive the system repeat themselves. Where
            nothing changes with time, a guess of the orbit's period, which is then found too; by default from a
            simulation that begins at `y0`.
        tolerance: Of the residual, relative; by default 1e-10 (float32: 1e-4).
        iterations: At most.
        method: `Exact`. Under ``jit`` it must give `max_steps` for one period, as for `simulate`.

    Returns:
        The orbit; see whether it has `converged`.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.

    >>> leine = ss.MassSpring(
    ...     mass=1.0, stiffness=1.0, normal_force=1.0,
    ...     friction=ss.VelocityWeakening(mu_static=1.0, weakening=3.0),
    ... )
    >>> orbit = ss.nonlinear.periodic_orbit(leine, ss.Constant(0.2), y0=(1.0, 0.2))
    >>> print(orbit.period.round(9), orbit.multipliers.round(8))
    12.001031295 [1.+0.j 0.+0.j]
    """
    require_threads_of_jax()
    periods = _checks.whole_number("periods", periods)
    iterations = _checks.whole_number("iterations", iterations)
    if not isinstance(method, Exact):
        raise ValueError(f"Argument method must be Exact(...), but {_checks.show(method)} was given.")
    system = checked_system(system)
    check_fixed(system=system, base=base)
    start = state_of(system, y0)
    check_repeats(base)
    dtype = working_dtype()
    motion = motion_of(base)
    period = checked_period(period)
    by_itself = changes_by_itself(system, base, start, period)
    duration = drive_period(system, motion, period, by_itself)
    driven = duration is not None
    if tolerance is None:
        tolerance = TOLERANCE[np.dtype(dtype).itemsize]
    _checks.positive("tolerance", tolerance)
    if duration is None:
        duration = period if period is not None else guessed_period(system, base, start, method)
    else:
        duration = periods * duration
    if driven:
        check_signals((system, motion), jnp.asarray(duration, dtype))
        Arguments(system, motion, method, duration).check_length()
    steps = steps_in(system, motion, method, duration)
    if steps is not None:
        method = Exact(method.step, (1 if driven else _STEPS) * steps, method.solver)
    guess = jnp.stack([jnp.asarray(value, dtype) for value in start])
    realized = motion.realized_until(duration) if driven else motion
    cycle = Cycle(as_arrays(system, dtype), as_arrays(realized, dtype), jnp.asarray(duration, dtype), method)
    state, duration, matrix, residuals, moves = _search(cycle, guess, jnp.asarray(tolerance, dtype), iterations, driven)
    matrix = _monodromy(cycle, state, duration, matrix)
    converged = (jnp.nanmin(residuals) <= tolerance) & moves
    return PeriodicOrbit(state, duration, matrix, converged, residuals, system, base, method, driven)


@eqx.filter_jit
def _search(
    cycle: Cycle, guess: FloatArray, tolerance: FloatScalar, iterations: int, driven: bool
) -> tuple[FloatArray, FloatScalar, FloatArray, FloatArray, BoolScalar]:
    """The state, the period and the monodromy matrix of the orbit near `guess`, the residuals, and whether it moves: an
    equilibrium comes back after any time, and everything after none.
    """
    length = len(guess)
    if driven:

        def change_of(y: FloatArray) -> FloatArray:  # `lax.custom_root` hashes its function: no method of a module
            return cycle.change(y)

        state, found = root_of(change_of, _size, guess, tolerance, iterations)
        matrix = found.matrix + jnp.eye(length, dtype=guess.dtype)
        return state, jnp.asarray(cycle.duration), matrix, found.residuals, jnp.asarray(True)
    # Nothing drives it: the period is found too, and the state on the plane through `guess` across the motion there.
    unit, reference = lax.stop_gradient((jnp.asarray(cycle.duration), guess))
    ahead = lax.stop_gradient(cycle.rates(guess))

    def change(z: FloatArray) -> FloatArray:
        y = z[:length]
        return jnp.append(cycle.lasting(z[length] * unit).change(y), jnp.sum(ahead * (y - reference)))

    def size(z: FloatArray, residual: FloatArray) -> FloatScalar:
        return _size(z[:length], residual[:length])

    z, found = root_of(change, size, jnp.append(guess, jnp.ones_like(unit)), tolerance, iterations)
    matrix = found.matrix[:length, :length] + jnp.eye(length, dtype=guess.dtype)
    moves = _size(z[:length], found.matrix[:length, length] * z[length]) > _STILL * tolerance
    return z[:length], z[length] * unit, matrix, found.residuals, moves


@eqx.filter_custom_jvp
def _monodromy(cycle: Cycle, state: FloatArray, duration: FloatScalar, known: FloatArray) -> FloatArray:
    """The derivative of the state after `duration` by `state`: the `known` one, with derivatives of its own."""
    return known


@_monodromy.def_jvp
def _monodromy_jvp(primals, tangents):
    *of, known = primals
    *by, _ = tangents

    def matrix(cycle: Cycle, state: FloatArray, duration: FloatScalar) -> FloatArray:
        return jax.jacfwd(cycle.lasting(duration).end)(state)

    return known, eqx.filter_jvp(matrix, tuple(of), tuple(by))[1]


def _size(state: FloatArray, residual: FloatArray) -> FloatScalar:
    """The size of a residual of the state, relative to its numbers."""
    sizes = jnp.maximum(jnp.abs(state), jnp.abs(state + residual))
    scale = jnp.maximum(sizes, _LEAST_SCALE * jnp.max(sizes))
    return jnp.max(jnp.abs(residual) / jnp.where(scale > 0, scale, 1))
