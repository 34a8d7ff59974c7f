"""The force of a friction law by itself under a motion that is prescribed, also behind a spring with free play."""

import math
from collections.abc import Callable
from functools import reduce
from importlib import import_module
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import lax
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._excitation.motion import SEEN_IN_STEPS, Signal
from .._excitation.piecewise_constant import PiecewiseConstant
from .._excitation.recorded import ForceSteps, Recorded
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.fields import require_single
from .._foundation.types import DType, FloatArray, FloatScalar, Number, Scalar
from .._numerics.derivatives import NotKnown, largest, primal_of, smallest, without_derivatives

# Friction with an inner state behind a spring with free play, as one law of the motion of the spring's end.
#
# Bristles: those of a law that is the same at every speed are a spring themselves, `share` times as stiff as at rest.
# So the motion v of the spring's end is shared out: they bend by ``share v / (1 + softness share)``. The state p is the
# displacement that the end would have if nothing yielded: ``p' = v (1 + softness) share / (1 + softness share)``. Where
# there is no force the share is 1, and ``p' = v``: p passes the free play as the end does, its rate does not jump
# there.
#
# Rate and state: the force of the spring and the inner state give the velocity of the slip, since friction at any one
# state grows with it. By what the motion of the spring's end exceeds this slip, the spring bends or the play is passed.


class BehindSpring(eqx.Module):
    """The `law` behind a spring.

    - `softness`: of the spring, over that of the bristles at rest.
    - `play`: the free play either way, m.
    """

    law: Any
    softness: FloatScalar
    play: FloatScalar

    def start(self, z: Number, velocity: FloatScalar) -> FloatArray:
        """The state in which the bristles are bent by `z` (m); in the middle of the free play if they are not."""
        return (1 + self.softness) * jnp.asarray(z) + self.play * jnp.sign(z)

    def deflection(self, p: FloatScalar) -> FloatArray:
        """Of the bristles, m."""
        return (p - jnp.clip(p, -self.play, self.play)) / (1 + self.softness)

    def rate(self, p: FloatScalar, velocity: FloatScalar) -> FloatArray:
        """The time derivative of the state at the `velocity` (m/s) of the spring's end."""
        way = jnp.where(velocity < 0, -1.0, 1.0)
        share = self.law.rate(self.deflection(p), way) * way
        return velocity * (1 + self.softness) * share / (1 + self.softness * share)

    def coefficient(self, p: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        """The friction coefficient, with its sign."""
        return self.law.coefficient(self.deflection(p), velocity)

    @property
    def state_scale(self) -> Scalar:
        """A typical size of the state: that of its errors where it is small."""
        return (1 + self.softness) * self.law.state_scale


class SpeedBehindSpring(eqx.Module):
    """The `law`, whose speed follows from coefficient and inner state, behind a spring. The state is p, and all of z.

    - `softness`: deflection of the spring (m) per friction coefficient.
    - `play`: the free play either way, m.
    """

    law: Any
    softness: FloatScalar
    play: FloatScalar
    why_endless: ClassVar[str] = (
        " Behind a soft spring a slip may accelerate without bound (after small disturbances if it is softer than "
        "normal_force (evolution - direct) / length, with one state): then give the slider a mass (MassSpring)."
    )

    def start(self, z: Number, velocity: FloatScalar) -> FloatArray:
        """The state in which a contact of the inner state `z` slips as fast as the spring's end moves."""
        coefficient = self.law.coefficient(jnp.asarray(z, velocity.dtype), velocity)
        return jnp.hstack([self.softness * coefficient + self.play * jnp.sign(coefficient), z])

    def rate(self, state: FloatArray, velocity: FloatScalar) -> FloatArray:
        """The time derivative of the state at the `velocity` (m/s) of the spring's end."""
        z = state[1] if len(state) == 2 else state[1:]
        slip = self.law.slip_velocity(z, self.coefficient(state, velocity))
        return jnp.hstack([velocity - slip, self.law.rate(z, slip)])

    def coefficient(self, state: FloatArray, velocity: FloatScalar) -> FloatArray:
        """The friction coefficient, with its sign: that of the spring's force."""
        return (state[0] - jnp.clip(state[0], -self.play, self.play)) / self.softness

    @property
    def state_scale(self) -> FloatArray:
        """Typical sizes of the state: those of its errors where it is small."""
        return jnp.hstack([self.softness * self.law.mu, jnp.ones(len(self.law.inner_states), self.softness.dtype)])

    @property
    def least_tolerance(self) -> FloatArray:
        """Relative, of steps: the speed is known no better than the coefficient's round-off over `direct`."""
        return jnp.asarray(8 * jnp.finfo(self.softness.dtype).eps * self.law.mu / self.law.direct, self.softness.dtype)


# The force of a friction law by itself, under a motion that is prescribed.


_FEW, _EACH = 2**20, 64  # steps that are allowed, and those for each time and point of a record
_LEAST = 1e-18  # of the time: steps so short lead nowhere
_PIECES, _FEWEST = 16, 10  # of a period, in which its velocity has one extreme at most; and where their number is given
_MOST_PIECES = 2**22
_MOST = 2**31 - 1  # steps that 32 bits count
_HALVES = 40  # of the time between two instants, until the turn between them is known


def force_of_dynamic(
    law: Any,
    times: npt.ArrayLike,
    velocity: npt.ArrayLike | Recorded | Signal | PiecewiseConstant,
    normal_force: Any,
    start: Number,
    rtol: float,
    max_steps: int | None,
    adjoint: Any,
) -> FloatArray:
    """See `DynamicFriction.force`."""
    require_single(law=law)
    times, motion = _checked(times, velocity)
    normal = _normal(normal_force, times)
    steps = getattr(law, "normal_stress", None) is not None
    if steps and jnp.ndim(normal) and not isinstance(normal_force, Signal | Recorded | ForceSteps):
        wanted = "be one number or a function of time, with which theta steps"
        raise checks.refused("normal_force", wanted, normal_force)
    checks.positive("rtol", rtol)
    # Steps end at every time, for states between steps are less accurate, and where the velocity has a kink.
    knots = _knots(motion, times.dtype), _knots(normal_force, times.dtype)
    ends = jnp.concatenate([times[1:], *(knots if steps else knots[:1])])
    signals = [one for one in (motion, normal_force if steps else None) if isinstance(one, Signal)]
    longest = reduce(jnp.minimum, (primal_of(_shortest_period(one)) / SEEN_IN_STEPS for one in signals), math.inf)
    most = _FEW + _EACH * len(ends) if max_steps is None else checks.whole_number("max_steps", max_steps, maximum=_MOST)
    if adjoint is not None and not isinstance(adjoint, diffrax.AbstractAdjoint):
        raise checks.refused("adjoint", "be one of diffrax's, such as diffrax.ForwardMode()", adjoint)
    adjoint = diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint
    state, velocities = jnp.asarray(start, times.dtype), _velocities(motion, times)
    if isinstance(law, BehindSpring | SpeedBehindSpring):
        state = law.start(state, velocities[0])
    longest = jnp.asarray(longest, times.dtype)
    given = (motion, normal_force) if steps else (motion, None)
    states, done = _states(law, times, given, state, (ends, longest), jnp.asarray(rtol), most, adjoint)
    if not checks.is_traced(done) and not bool(done):
        raise ValueError(
            f"Argument max_steps must be larger, or rtol: {most} steps do not follow the motion to its end at "
            f"rtol = {rtol:g}.{law.why_endless if isinstance(law, SpeedBehindSpring) else ''}"
        )
    if steps:
        states = jax.vmap(cast(Any, law).at_normal_force)(states, jnp.broadcast_to(normal, times.shape))
    return normal * jax.vmap(law.coefficient)(states, velocities)


@kept_jit
def _velocities(motion: Any, times: Array) -> FloatArray:
    return jax.vmap(lambda t: jnp.asarray(_velocity_at(motion, t), times.dtype))(times)


def _velocity_at(motion: Any, t: FloatArray) -> FloatArray:
    """The prescribed velocity at one time; right after it where it jumps there."""
    if isinstance(motion, PiecewiseConstant):
        return jnp.asarray(motion.velocities)[jnp.searchsorted(jnp.asarray(motion.times), t, side="right") - 1]
    return jnp.interp(t, *motion) if isinstance(motion, tuple) else motion.value(t)


@kept_jit(static_argnames=("most", "adjoint"))
def _states(
    law: Any,
    times: Array,
    given: tuple[Any, Any],
    start: FloatArray,
    steps: tuple[Array, FloatArray],
    rtol: FloatArray,
    most: int,
    adjoint: Any,
) -> tuple[FloatArray, Array]:
    """The inner states at `times`, and whether the integration reached the last of them; NaN beyond.

    `steps`: the times at which steps end in any case, and the longest one (s).
    """
    (ends, longest), (motion, normal) = steps, given

    def rates(t, z, _):
        if normal is not None:
            z = law.at_normal_force(z, _value_at(normal, t))
        return law.rate(z, jnp.asarray(_velocity_at(motion, t), times.dtype))

    tolerance, scale = rtol.astype(times.dtype), jnp.asarray(law.state_scale, times.dtype)
    if isinstance(law, SpeedBehindSpring):
        tolerance = jnp.maximum(tolerance, law.least_tolerance)
    control = diffrax.PIDController(
        rtol=tolerance, atol=tolerance * scale, dtmin=_LEAST * (times[-1] - times[0]), force_dtmin=False,
        dtmax=longest,
    )  # fmt: skip
    solver = diffrax.Kvaerno5()
    if normal is not None or isinstance(motion, PiecewiseConstant):
        # After a jump the chords of diffrax' own root finder may not converge in any step, however short.
        newton = import_module("optimistix").Newton  # which diffrax cannot do without
        solver = diffrax.Kvaerno5(root_finder=newton(rtol=tolerance / 100, atol=tolerance / 100 * scale))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates), solver, times[0], times[-1], None, start,
        saveat=diffrax.SaveAt(ts=times), max_steps=most, adjoint=adjoint, throw=False,
        stepsize_controller=diffrax.ClipStepSizeController(control, jump_ts=ends),
    )  # fmt: skip
    done = solution.result == diffrax.RESULTS.successful
    states = jnp.asarray(solution.ys)
    return jnp.where(jnp.isfinite(states), states, jnp.nan), done


def force_of_law(
    law: Any,
    times: npt.ArrayLike,
    velocity: npt.ArrayLike | Recorded | Signal | PiecewiseConstant,
    normal_force: Any,
    series_stiffness: Number | None,
    backlash: Number,
) -> FloatArray:
    """See `FrictionLaw.force`."""
    require_single(law=law)
    times, motion = _checked(times, velocity)
    if series_stiffness is None:
        checks.bounded("backlash", backlash, "m", at_least=0, below=1e-300, hint="give the series_stiffness too")
        velocities = _velocities(motion, times)
        coefficients = jax.vmap(law.slip_coefficient)(velocities)
        return _normal(normal_force, times) * jnp.where(velocities == 0, jnp.nan, jnp.sign(velocities) * coefficients)
    checks.positive("series_stiffness", series_stiffness, "N/m")
    checks.bounded("backlash", backlash, "m", at_least=0)
    checks.positive("normal_force", normal_force, "N")
    if not law.constant or law.static_exceeds_kinetic:
        raise ValueError(
            "Argument series_stiffness must be None for a friction coefficient that depends on the speed, or that is "
            f"larger in a stick, but {checks.show(series_stiffness)} was given: such a slider jumps. Give it a mass: "
            "write mass, spring and backlash as a SwitchedSystem."
        )
    most, least = (jnp.asarray(law.slip_coefficient(jnp.full((), sign))) * normal_force for sign in (1.0, -1.0))
    within = _pieces(motion, times) if isinstance(motion, Signal) else _knots(motion, times.dtype)
    points = jnp.sort(jnp.append(times, jnp.clip(within, times[0], times[-1])))
    moves = _moves_of_signal(motion, points) if isinstance(motion, Signal) else _moves(motion, points)
    forces = _behind_a_spring(moves, most, least, jnp.asarray(series_stiffness), jnp.asarray(backlash) / 2)
    found = forces[jnp.searchsorted(points, times, side="right") - 1]
    return jnp.where(jnp.isnan(points[-1]), jnp.nan, found)


def _knots(motion: Any, dtype: DType) -> Array:
    """The times between which the velocity is a straight line, s, besides those at which it is given."""
    return jnp.asarray(motion.times if isinstance(motion, Recorded | PiecewiseConstant | ForceSteps) else [], dtype)


def _shortest_period(motion: Signal) -> Scalar:
    """That of the signal. Raises ValueError where it is not known."""
    if motion.shortest_period is None:
        raise ValueError(
            f"Argument velocity must have a property shortest_period (s), but a {type(motion).__name__} without one "
            "was given: between the times it could move to and fro unseen."
        )
    return motion.shortest_period


def _pieces(motion: Signal, times: Array) -> Array:
    """Times so dense that the velocity has one extreme at most between two; NaN where too few may be, under jit."""
    period, first, last = primal_of(_shortest_period(motion)), times[0], times[-1]
    try:
        pieces = _PIECES * (largest(last) - smallest(first)) / smallest(period)
        if pieces > _MOST_PIECES:
            raise ValueError(
                f"Argument times must span at most {_MOST_PIECES // _PIECES} shortest periods of the velocity, but "
                f"{pieces / _PIECES:.4g} were given: take a part of them, or a longer shortest_period."
            )
        number = 1 << math.ceil(math.log2(max(pieces, 1)))  # few lengths, each of which is compiled
    except NotKnown:  # taken to be one period from time to time
        number = _PIECES * len(times)
    within = first + (last - first) * jnp.linspace(0, 1, number + 1, dtype=times.dtype)
    return jnp.where(_FEWEST * (last - first) <= number * period, within, jnp.nan)


@kept_jit
def _moves(motion: Any, points: Array) -> Array:
    """The displacements between two points before and after the instant where a velocity passes zero,
    (points - 1, 2).
    """
    velocities = _velocities(motion, points)
    first, last, h = velocities[:-1], velocities[1:], jnp.diff(points)
    if isinstance(motion, PiecewiseConstant):
        last = first
    turns = first * last < 0
    share = jnp.where(turns, first / jnp.where(turns, first - last, 1), 1)
    before = jnp.where(turns, first / 2, (first + last) / 2) * share * h
    return jnp.stack([before, jnp.where(turns, last / 2 * (1 - share) * h, 0)], axis=1)


@kept_jit
def _moves_of_signal(motion: Signal, points: Array) -> Array:
    """The same of a signal, (points - 1, 4): before and after its velocity is extreme, it passes zero once at most."""
    still = without_derivatives(motion)

    def until_change(function: Callable[[FloatArray], Any], t: FloatArray, h: FloatArray) -> FloatArray:
        """How long after `t` the function has another sign; `h` if it has none until then."""
        first = jnp.asarray(function(t))

        def halved(ends: tuple[FloatArray, FloatArray], _: None) -> tuple[tuple[FloatArray, FloatArray], None]:
            low, high = ends
            middle = (low + high) / 2
            before = jnp.asarray(function(t + middle)) * first > 0
            return (jnp.where(before, middle, low), jnp.where(before, high, middle)), None

        # Where it has none, this ends at h. Near a turn the displacement is flat: its instant need not be exact.
        return lax.scan(halved, (jnp.zeros_like(h), h), None, length=_HALVES)[0][0]

    def of_one(t: FloatArray, h: FloatArray) -> FloatArray:
        start, length = lax.stop_gradient((t, h))
        extreme = until_change(still.rate, start, length)
        turn = until_change(still.value, start, extreme)
        other = extreme + until_change(still.value, start + extreme, length - extreme)
        begins, ends = jnp.stack([jnp.zeros_like(h), turn, extreme, other]), jnp.stack([turn, extreme, other, h])
        return jax.vmap(lambda begin, end: jnp.asarray(motion.integral(t + begin, end - begin)))(begins, ends)

    return jax.vmap(of_one)(points[:-1], jnp.diff(points))


@kept_jit
def _behind_a_spring(
    moves: Array, most: FloatArray, least: FloatArray, stiffness: FloatArray, play: FloatArray
) -> FloatArray:
    """The force of an elastic slider with a free play of `play` (m) either way: its deflection stops at the limits."""

    def moved(deflection: FloatArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
        for part in step:
            deflection = jnp.clip(deflection + part, -least / stiffness - play, most / stiffness + play)
        return deflection, deflection

    start = jnp.zeros((), moves.dtype)
    _, deflections = lax.scan(moved, start, moves)
    deflections = jnp.append(start, deflections)
    return stiffness * (deflections - jnp.clip(deflections, -play, play))


def _checked(times: npt.ArrayLike, velocity: Any) -> tuple[Array, Any]:
    """The times, and the motion: a `Recorded`, a `Signal`, steps, or times and velocities at them."""
    checks.bounded("times", times, "s", ndim=1)
    array = jnp.asarray(times, float)
    if not checks.is_traced(array) and (len(array) < 2 or np.any(np.diff(array) <= 0)):
        raise checks.refused("times", "increase, and be at least 2 (in s)", times)
    if isinstance(velocity, Signal):
        return array, velocity
    if isinstance(velocity, PiecewiseConstant):
        if not checks.is_traced(array) and array[0] < 0:
            raise checks.refused("times", "be zero or positive, as those of the velocity are", times)
        return array, velocity
    if isinstance(velocity, Recorded):
        if not checks.is_traced(array) and not (array[0] >= 0 and float(array[-1]) <= velocity.covered_time):
            raise checks.refused("times", f"be within the record of {velocity.covered_time:g} s", times)
        return array, velocity
    checks.bounded("velocity", velocity, "m/s", ndim=1)
    values = jnp.asarray(velocity, float)
    if values.shape != array.shape:
        raise ValueError(
            f"Argument velocity must have one number for each of the {len(array)} times, but an array of shape "
            f"{values.shape} was given."
        )
    return array, (array, values)


def _value_at(force: Any, t: FloatArray) -> Any:
    """A force at one time, N; none where it would pull."""
    return jnp.maximum(force.value(t) if isinstance(force, Signal | Recorded | ForceSteps) else force, 0)


def _normal(value: Any, times: Array) -> FloatArray:
    """The normal force, one number or one for each of the times."""
    if isinstance(value, Signal | Recorded | ForceSteps):
        return jax.vmap(lambda t: jnp.asarray(_value_at(value, t), times.dtype))(times)
    checks.bounded("normal_force", value, "N", at_least=0, ndim=1 if checks.dimensions(value) else 0)
    array = jnp.asarray(value, times.dtype)
    if array.shape not in ((), times.shape):
        raise checks.refused("normal_force", "be zero or positive (in N), one number or one for each time", value)
    return array
