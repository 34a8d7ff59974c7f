"""Friction laws: the friction coefficient of a stick, and that of a slip by its relative speed, also through
measured points; and laws made of others.
"""

import abc
import math
from collections.abc import Callable
from functools import partial, reduce
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float, PyTree

from .._compiler.programs import kept_jit
from .._foundation import checks
from .._foundation.fields import Checked, Quantity, varies_within
from .._foundation.types import AnyArray, FloatArray, Number, Scalar
from .prescribed import force_of_law

if TYPE_CHECKING:
    from .._excitation.motion import Signal
    from .._excitation.piecewise_constant import PiecewiseConstant
    from .._excitation.recorded import Recorded


# A friction curve through measured points: monotone between them, with a continuous slope.
#
# Between two points it is a cubic whose slopes at the points are those of F. N. Fritsch and J. Butland, "A method for
# constructing local monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5 (1984), as in scipy's
# `PchipInterpolator`; only the slope at the last point is zero here, because the coefficient is constant beyond.
# The curvature jumps at the points. Steps of an eighth-order method that pass a point are shortened by their error
# estimate: times of events stay within 1e-7 s of an event-driven integration with a relative tolerance of 1e-12
# (tests/systems/test_friction_table.py).


PerPoint: TypeAlias = Float[AnyArray, " points"]

_FEW = 64  # points: up to these, comparing with all is faster than bisection


class TabulatedCurve(Checked):
    """The friction coefficient at the relative speed (m/s) by a table; see `FrictionCurve.from_table`."""

    speeds: Annotated[PerPoint, Quantity("m/s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "speeds")
    )
    coefficients: Annotated[PerPoint, Quantity(at_least=0, ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "coefficients")
    )
    scale: Annotated[Number, Quantity(meaning="what the coefficients are multiplied by", at_least=0)] = 1.0

    def check_parts(self) -> None:
        checks.same_length(2, speeds=self.speeds, coefficients=self.coefficients)
        checks.increasing_from_zero(
            "speeds", self.speeds, "put the coefficient at vanishing speed first, curve(0), say that of the first point"
        )
        if checks.is_traced(self.speeds):
            return
        speeds = np.asarray(self.speeds).astype(jnp.result_type(float))
        if np.any(np.diff(speeds) <= 0):
            at = int(np.argmax(np.diff(speeds) <= 0)) + 1
            raise ValueError(
                f"Argument speeds must increase in {speeds.dtype} too, but speeds[{at}] = {self.speeds[at]} equals the "
                "one before it there; leave one of them out, or set jax_enable_x64."
            )

    def __call__(self, speed: FloatArray) -> FloatArray:
        speed = jnp.asarray(speed, jnp.result_type(float, speed))
        x, y = jnp.asarray(self.speeds, speed.dtype), jnp.asarray(self.coefficients, speed.dtype)
        method = "compare_all" if len(x) <= _FEW else "scan_unrolled"
        here = jnp.clip(jnp.searchsorted(x, speed, side="right", method=method) - 1, 0, len(x) - 2)
        begin, first, second, third = _cubics(x, y)[:, here]
        along = jnp.minimum(speed, x[-1]) - x[here]
        return self.scale * (begin + along * (first + along * (second + along * third)))


@kept_jit
def _cubics(x: PerPoint, y: PerPoint) -> Float[Array, "4 intervals"]:
    """Value and derivatives at the beginning of each interval, divided by factorials: coefficients of its cubic."""
    length = jnp.diff(x)
    secant = jnp.diff(y) / length
    slope = jnp.zeros_like(y).at[0].set(secant[0])  # and 0 at the last point
    if len(x) > 2:
        # First that of the parabola through three points, where it keeps the curve monotone.
        (h, after), (one, two) = length[:2], secant[:2]
        parabola = ((2 * h + after) * one - h * two) / (h + after)
        steep = (one * two < 0) & (jnp.abs(parabola) > 3 * jnp.abs(one))
        slope = slope.at[0].set(jnp.where(parabola * one > 0, jnp.where(steep, 3 * one, parabola), 0))
        # Then the weighted harmonic mean of two secants; 0 where the curve turns.
        before, later, secants, following = length[:-1], length[1:], secant[:-1], secant[1:]
        same = secants * following > 0
        first, second = 2 * later + before, later + 2 * before
        inverse = first / jnp.where(same, secants, 1) + second / jnp.where(same, following, 1)
        slope = slope.at[1:-1].set(jnp.where(same, (first + second) / jnp.where(same, inverse, 1), 0))
    bend = (slope[:-1] + slope[1:] - 2 * secant) / length
    return jnp.stack([y[:-1], slope[:-1], (secant - slope[:-1]) / length - bend, bend / length])


_STATIC = "friction coefficient of a stick"
# Sphinx cannot read formatted strings in annotations, and would show no sources of this file.
_STATIC_ABOVE_MU = _STATIC + ", at least mu"
_STATIC_OR_MU = _STATIC + ", at least mu; not given: mu"
_STATIC_OR_SLOW = _STATIC + ", at least mu_slow; not given: mu_slow"
_STATIC_OR_CURVE = _STATIC + "; not given: curve(0)"
_ROUND_OFF = 1e-6  # of numbers in single precision


class FrictionLaw(Checked):
    """Base class of friction laws.

    The friction force is at most ``static * normal_force`` in a stick, and ``kinetic(|v_rel|) * normal_force`` in a
    slip at relative speed ``|v_rel|`` (m/s). For a law of your own take `FrictionCurve`, or subclass this.

    Systems and engines ask a law by the direction of slip: `slip_coefficient`, `continued_coefficient`, `stick_limit`
    and `in_direction`. For a law that differs between the two directions, `static` is the larger limit.

    Attributes:
        constant: Whether `kinetic` does not depend on the speed; slips then have closed forms. Where a subclass of a
            law has another `kinetic` or `static` than that law, `constant`, `static_exceeds_kinetic` and `speed_scale`
            must be stated anew: by default the coefficient depends on the speed, in a way that is not known.
    """

    constant: ClassVar[bool] = False
    differs_by_place: ClassVar[bool] = False
    rests_on: ClassVar = {
        "constant": ("kinetic", "in_direction"),
        "speed_scale": ("kinetic", "in_direction"),
        "static_exceeds_kinetic": ("static", "static_after", "kinetic", "in_direction"),
    }

    @property
    def static_exceeds_kinetic(self) -> bool:
        """Whether static friction may exceed kinetic friction at vanishing speed, ``static > kinetic(0)``."""
        return True

    @property
    def speed_scale(self) -> Scalar | None:
        """Relative speed over which the coefficient changes, m/s; infinity if it does not change, None if not known."""
        return math.inf if self.constant else None

    @property
    def viscous_slope(self) -> Scalar:
        """The slope of the coefficient at high speed, s/m: with a normal force n, a damper of ``n viscous_slope``."""
        return 0.0

    @property
    @abc.abstractmethod
    def static(self) -> Scalar:
        """Static friction coefficient."""

    @abc.abstractmethod
    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        """Kinetic friction coefficient at the relative speed `speed` (m/s, zero or positive)."""

    def static_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        """Static friction coefficient of a stick that has lasted `age` (s); here `static`, whatever the age.

        Where a law has another, it must not fall with the age, and be `static` at the age zero.
        """
        return self.static

    @property
    def grows(self) -> bool:
        """Whether static friction may grow while a stick lasts."""
        return type(self).static_after is not FrictionLaw.static_after

    @property
    def inner_state(self) -> str | None:
        """Name and unit of the inner state, of laws that have one ("deflection in m"); None for all others."""
        return None

    @property
    def growth_time(self) -> Scalar | None:
        """The shortest age (s) at which static friction has grown noticeably; None if it is not known."""
        return None

    def in_direction(self, velocity: FloatArray) -> "FrictionLaw":
        """The law for slips in one direction, and for sticks that would break into them.

        Args:
            velocity: The relative velocity, or any number of its sign.

        Returns:
            A law that is the same in both directions; here this one.
        """
        return self

    @property
    def depends_on_direction(self) -> bool:
        """Whether it may differ between the two directions of slip."""
        return type(self).in_direction is not FrictionLaw.in_direction

    def slip_coefficient(self, velocity: FloatArray) -> Scalar | FloatArray:
        """The kinetic friction coefficient at this relative velocity (m/s, of either sign)."""
        return self.in_direction(velocity).kinetic(jnp.abs(velocity))

    def continued_coefficient(self, speed: FloatArray, sign: FloatArray) -> Scalar | FloatArray:
        """The kinetic friction coefficient of a slip, continued with the same slope to beyond its end.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end; a kink there would cost its order.

        Args:
            speed: `sign` times the relative velocity, m/s; negative beyond the end of the slip.
            sign: The sign of the relative velocity in the slip.
        """
        law = self.in_direction(sign)
        coefficient = law.kinetic(jnp.abs(speed))
        if law.constant:
            return coefficient
        return jnp.where(speed < 0, 2 * law.kinetic(jnp.zeros_like(speed)) - coefficient, coefficient)

    def stick_limit(self, velocity: FloatArray) -> Scalar:
        """The largest friction coefficient of a stick that would break into a slip with the sign of `velocity`."""
        return self.in_direction(velocity).static

    def force(
        self,
        times: npt.ArrayLike,
        velocity: "npt.ArrayLike | Recorded | Signal | PiecewiseConstant",
        normal_force: Any = 1.0,
        *,
        series_stiffness: Number | None = None,
        backlash: Number = 0.0,
    ) -> FloatArray:
        """The friction force under a prescribed motion, as a test rig measures it.

        Args:
            times: s, increasing, (times,), at least 2.
            velocity: At these times, m/s, (times,), joined by straight lines; or a `Recorded` or `Signal` such as
                `Harmonic`, whose points and turns between the times count too, or steps, a `PiecewiseConstant`. The
                relative velocity; with a spring, that of its end.
            normal_force: N, zero or positive; one number, or without a spring one for each time.
            series_stiffness: N/m, of a spring in front of the contact, for laws with one constant coefficient in either
                direction. Its deflection is zero at the first time.
            backlash: The free play in front of the spring, m: there is no force while the deflection is within half of
                it either way.

        Returns:
            The force at these times, N, (times,), positive against a positive velocity. Without a spring that of a
            slip; NaN where the velocity is zero, since a stick has any force up to its limit. With a spring and a
            signal under ``jit``, NaN where the times are fewer than its shortest periods.

        Raises:
            ValueError: For times that do not increase, velocities of another length, numbers out of range, a spring in
                front of a law whose coefficient depends on the speed or on the stick, and a spring under a signal whose
                shortest period is not known.

        >>> times, velocity = [0.0, 1.0, 2.0, 3.0], [0.1, 0.1, -0.1, -0.1]
        >>> print(ss.Coulomb(0.3).force(times, velocity, 10.0, series_stiffness=40.0))
        [ 0.  3.  2. -2.]
        """
        require_law("law", self, may_remember=False)
        return force_of_law(self, times, velocity, normal_force, series_stiffness, backlash)

    def check_relations(self) -> None:
        owners = [next(kind for kind in type(self).__mro__ if name in vars(kind)) for name in ("static", "kinetic")]
        if any(kind.__module__ != __name__ for kind in owners):  # the laws of this module check what they are made of
            _check_traceable(self.kinetic, f"The method kinetic of {type(self).__name__}")
            _check_at_rest(type(self).__name__, self, "")

    def check_directions(self) -> None:
        """Check the law of either direction. Raises ValueError for one that lets a stick hold less than a slip."""
        if not self.depends_on_direction or not all(np.ndim(leaf) == 0 for leaf in jax.tree.leaves(self)):
            return
        for sign, way in ((1.0, "forward"), (-1.0, "backward")):
            law, kind = self.in_direction(jnp.full((), sign)), type(self).__name__
            _check_at_rest(kind, law, f" of {way} slips")
            static_at_least(
                law.static, self.static, f"The property static of {kind}", f"that of {way} slips", _ROUND_OFF
            )


class Coulomb(FrictionLaw):
    """Coulomb dry friction: the force in a slip is ``mu * normal_force``, against the relative velocity.

    Source: Lima and Sampaio 2015, equation 2.

    Args:
        mu: The kinetic friction coefficient (dimensionless, zero or positive).
        mu_static: The static one, at least `mu`; by default equal to it.

    Raises:
        ValueError: If a number is negative or not finite, or `mu_static` below `mu`.
    """

    mu: Annotated[Number, Quantity(meaning="friction coefficient", at_least=0)]
    mu_static: Annotated[Number | None, Quantity(meaning=_STATIC_OR_MU, at_least=0)] = None
    constant = True

    def check_relations(self) -> None:
        static_at_least(self.mu, self.mu_static)
        FrictionLaw.check_relations(self)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.mu_static is not None

    @property
    def static(self) -> Scalar:
        return self.mu if self.mu_static is None else self.mu_static

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.mu


class VelocityWeakening(FrictionLaw):
    """Friction that falls with the relative speed: ``mu_static / (1 + weakening |v_rel|)``.

    Source: Leine et al. 1998, equation 3.

    Args:
        mu_static: The static friction coefficient (dimensionless, zero or positive).
        weakening: How fast the coefficient falls with the speed, s/m, zero or positive.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    mu_static: Annotated[Number, Quantity(meaning=_STATIC, at_least=0)]
    weakening: Annotated[Number, Quantity("s/m", "a slip has mu_static / (1 + weakening |v|)", at_least=0)]

    @property
    def static_exceeds_kinetic(self) -> bool:
        return False

    @property
    def static(self) -> Scalar:
        return self.mu_static

    @property
    def speed_scale(self) -> Scalar | None:
        if not checks.is_traced(self.weakening) and self.weakening == 0:
            return math.inf
        return 1 / self.weakening

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.mu_static / (1 + self.weakening * speed)


class Stribeck(FrictionLaw):
    """Stribeck friction: ``mu + (mu_static - mu) exp(-(|v_rel| / stribeck_speed)^exponent) + viscous |v_rel|``.

    Args:
        mu: The kinetic friction coefficient far above the Stribeck speed (dimensionless).
        mu_static: The static one, at least `mu`.
        stribeck_speed: The speed over which the coefficient falls, m/s, positive.
        exponent: Of the speed in the exponential, at least 1.
        viscous: What is added per speed, s/m, zero or positive.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    mu: Annotated[Number, Quantity(meaning="friction coefficient of a fast slip", at_least=0)]
    mu_static: Annotated[Number, Quantity(meaning=_STATIC_ABOVE_MU, at_least=0)]
    stribeck_speed: Annotated[Number, Quantity("m/s", above=0)]
    exponent: Annotated[float, Quantity(meaning="of the speed in the exponential", at_least=1)] = eqx.field(
        static=True, default=1.0
    )
    viscous: Annotated[Number, Quantity("s/m", "times the speed", at_least=0)] = 0.0

    def check_relations(self) -> None:
        static_at_least(self.mu, self.mu_static)
        FrictionLaw.check_relations(self)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return False

    @property
    def static(self) -> Scalar:
        return self.mu_static

    @property
    def speed_scale(self) -> Scalar | None:
        # The steepest slope of exp(-s^p), at s^p = (p - 1) / p, over that of exp(-s): above 1 for p > 2.3.
        p = self.exponent
        steepest = p * ((p - 1) / p) ** ((p - 1) / p) * math.exp(-(p - 1) / p)
        return self.stribeck_speed / max(1.0, steepest)

    @property
    def viscous_slope(self) -> Scalar:
        return self.viscous

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        ratio = speed / self.stribeck_speed
        power = ratio if self.exponent == 1 else ratio**self.exponent
        return self.mu + (self.mu_static - self.mu) * jnp.exp(-power) + self.viscous * speed


class VelocityDependent(FrictionLaw):
    """Friction of sliding bearings: ``mu_fast - (mu_fast - mu_slow) exp(-rate |v_rel|)``.

    The friction of PTFE on steel rises with the speed, that of other pairs may fall. Source: Constantinou, Mokha and
    Reinhorn 1990, Teflon bearings in base isolation II: modeling, J. Struct. Eng. 116, 455; as ``VelDependent`` of
    OpenSees, whose `transRate` is `rate`.

    Args:
        mu_slow: The kinetic friction coefficient at vanishing speed (dimensionless).
        mu_fast: That of a fast slip, larger or smaller.
        rate: How fast the one goes over into the other, s/m, positive.
        mu_static: The static one, of breakaway, at least `mu_slow`; by default equal to it.

    Raises:
        ValueError: For numbers outside these bounds.

    >>> law = ss.VelocityDependent(mu_slow=0.05, mu_fast=0.1, rate=40.0)
    >>> print(law.force([0.0, 1.0], [0.01, 0.5], normal_force=100.0).round(2))
    [ 6.65 10.  ]
    """

    mu_slow: Annotated[Number, Quantity(meaning="friction coefficient at vanishing speed", at_least=0)]
    mu_fast: Annotated[Number, Quantity(meaning="friction coefficient of a fast slip", at_least=0)]
    rate: Annotated[Number, Quantity("s/m", "of the speed in the exponential", above=0)]
    mu_static: Annotated[Number | None, Quantity(meaning=_STATIC_OR_SLOW, at_least=0)] = None

    def check_relations(self) -> None:
        static_at_least(self.mu_slow, self.mu_static, of="mu_slow")
        FrictionLaw.check_relations(self)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.mu_static is not None

    @property
    def static(self) -> Scalar:
        return self.mu_slow if self.mu_static is None else self.mu_static

    @property
    def speed_scale(self) -> Scalar | None:
        # Steps are short beside the time in which static friction changes the speed by this; where the coefficient
        # changes by more than that, its slope at rest asks for less.
        change = abs(self.mu_fast - self.mu_slow)
        held = most(self.static, 1e-3 * change + 1e-9)
        return held / (self.rate * most(held, change))

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.mu_fast + (self.mu_slow - self.mu_fast) * jnp.exp(-self.rate * speed)


def traceable(curve: PyTree) -> PyTree:
    """A plain function as a pytree without leaves, so that it can be part of a system that JAX transforms."""
    is_plain = callable(curve) and not isinstance(curve, type) and jax.tree.leaves(curve) == [curve]
    return jax.tree_util.Partial(curve) if is_plain else curve


class FrictionCurve(FrictionLaw):
    """A friction law of your own: the kinetic friction coefficient is ``curve(|v_rel|)``.

    Args:
        curve: A smooth function of the relative speed (m/s, a scalar) that JAX can trace, or an ``equinox.Module``
            with parameters. Write it with ``jax.numpy``; for measured points take `from_table`.
        mu_static: The static friction coefficient, at least ``curve(0)``; by default equal to it.

    Raises:
        ValueError: For a curve that cannot be called, or coefficients that are negative or do not fit.
    """

    curve: Callable[[FloatArray], FloatArray] = eqx.field(converter=traceable)
    holds_users_code = True
    mu_static: Annotated[Number | None, Quantity(meaning=_STATIC_OR_CURVE, at_least=0)] = None

    @classmethod
    def from_table(
        cls,
        speeds: npt.ArrayLike,
        coefficients: npt.ArrayLike,
        *,
        mu_static: Number | None = None,
        scale: Number = 1.0,
    ) -> "FrictionCurve":
        """The friction law through measured points.

        Between the points it is a cubic that rises or falls only where they do, with a continuous slope (Fritsch and
        Butland 1984, as scipy's ``PchipInterpolator``). Beyond the last point the coefficient stays that of the last
        point, and its slope there is zero: measure up to the fastest slip. Both may be traced by ``jit``, ``vmap``
        (tables of the same number of points) and ``grad``.

        Args:
            speeds: Relative speeds, m/s, increasing, the first one 0, (points,), at least 2.
            coefficients: Kinetic friction coefficients at them, zero or positive, (points,).
            mu_static: The static friction coefficient, at least the first of the kinetic ones; by default equal to it.
            scale: What the coefficients (not `mu_static`) are multiplied by; it may be uncertain, as any number may.

        Returns:
            The law, which ensembles store and load with all its points.

        Raises:
            ValueError: For speeds that do not increase from 0, different lengths, and coefficients that are negative or
                not finite.
        """
        return cls(TabulatedCurve(speeds, coefficients, scale), mu_static)

    def check_parts(self) -> None:
        if not callable(self.curve) or isinstance(self.curve, type):
            raise checks.refused("curve", "be a function of the relative speed", self.curve)

    def has_varying_parts(self) -> bool:
        return varies_within(self.curve)

    def check_relations(self) -> None:
        _check_traceable(self.curve, "Argument curve of FrictionCurve")
        at_rest = self.curve(jnp.zeros(()))
        checks.non_negative("curve(0)", at_rest)
        static_at_least(at_rest, self.mu_static, of="curve(0)")
        FrictionLaw.check_relations(self)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.mu_static is not None

    @property
    def static(self) -> Scalar:
        return self.curve(jnp.zeros(())) if self.mu_static is None else self.mu_static

    @property
    def speed_scale(self) -> Scalar | None:
        """Speed at which the tangent to the curve at rest reaches zero or twice the value at rest, m/s, or infinity."""
        at_rest, slope = jax.jvp(lambda speed: jnp.asarray(self.curve(speed)), (jnp.zeros(()),), (jnp.ones(()),))
        falls = slope != 0
        return jnp.where(falls, at_rest / jnp.abs(jnp.where(falls, slope, 1)), jnp.inf)

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.curve(speed)


def times_of_slips(
    friction: FrictionLaw, mass: Number, normal_force: Number, damping: Number | None
) -> tuple[Scalar, Scalar]:
    """Two times, s, that steps of a slip must be short against; infinity where there is none.

    The first: that in which the largest friction force changes the speed by the speed scale of the law. The second: the
    time constant of the speed under damping and viscous friction alone.
    """
    scale, held = friction.speed_scale, friction.static * normal_force
    drag = friction.viscous_slope * normal_force + (0.0 if damping is None else damping)
    passes = not (scale is None or _is(scale, math.inf) or _is(held, 0.0))
    return scale * mass / held if passes else math.inf, math.inf if _is(drag, 0.0) else mass / drag


def _check_traceable(function: Callable[[FloatArray], object], what: str) -> None:
    """Check that JAX can trace a user's function of the speed. Raises ValueError that says what to write instead."""
    with checks.traceable(what):
        jax.make_jaxpr(function)(jnp.zeros(()))


def _is(number: Scalar, value: float) -> bool:
    return not checks.is_traced(number) and bool(number == value)


def _check_at_rest(kind: str, law: FrictionLaw, slips: str) -> None:
    """Check the coefficients of a user's `law` at vanishing speed; `slips`: for which ones it holds."""
    kinetic, static = law.kinetic(jnp.zeros(())), law.static
    for name, value in (("kinetic(0)", kinetic), ("static", static)):
        if not checks.is_traced(value) and not np.all(np.isfinite(value) & (np.asarray(value) >= 0)):
            raise ValueError(
                f"The friction coefficient {name}{slips} of {kind} must be finite, zero or positive, but {value} was "
                "given: friction acts against the slip; turn its sign round, or look for a division by zero."
            )
    # Both may be the same number, rounded twice.
    static_at_least(kinetic, static, f"The static friction coefficient{slips} of {kind}", "kinetic(0)", _ROUND_OFF)


def static_at_least(
    kinetic: Number, static: Number | None, name: str = "Argument mu_static", of: str = "mu", slack: float = 0.0
) -> None:
    """Check that the `static` coefficient, if given, is at least the `kinetic` one, called `of`, but for `slack`."""
    if static is None or checks.is_traced(kinetic) or checks.is_traced(static):
        return
    if np.any(static < kinetic * (1 - slack)):  # of many points of a sweep at once, too
        raise ValueError(
            f"{name} must be at least {of} = {kinetic}, but {static} was given: a stick holds at least as well as a "
            "slip."
        )


# Friction laws made of others: a static friction that grows while the stick lasts.

_AGES = np.array([1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6])  # s, at which a user's growth is looked at


class MadeOfLaws(FrictionLaw):
    """Base class of laws made of others, which have checked themselves."""

    def check_relations(self) -> None:
        pass


class Growth(Checked):
    """Base class of what is added to the static friction coefficient while a stick lasts.

    Args:
        amount: The size of what is added.
        time: Over which it is added, s.
    """

    amount: Annotated[Number, Quantity(meaning="what is added to the static friction coefficient", at_least=0)]
    time: Annotated[Number, Quantity("s", "over which it is added", above=0)]

    @abc.abstractmethod
    def __call__(self, age: FloatArray | float) -> FloatArray:
        """What a stick has gained that has lasted `age` (s)."""


class ExponentialGrowth(Growth):
    """Growth towards a limit: ``amount (1 - exp(-age / time))``.

    Args:
        amount: What is added in the end, zero or positive.
        time: The time constant, s, positive.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    def __call__(self, age: FloatArray | float) -> FloatArray:
        return -self.amount * jnp.expm1(-age / self.time)


class LogarithmicGrowth(Growth):
    """Growth without a limit, ``amount log(1 + age / time)``, as measured on rock, paper and metals.

    Source: Dieterich 1972, Time-dependent friction in rocks, J. Geophys. Res. 77, 3690 (there with the logarithm to the
    base 10: its coefficient is 2.303 times `amount`).

    Args:
        amount: What is added each time the age becomes 2.718 times as large, zero or positive.
        time: The age, s, positive, up to which there is hardly any growth.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    def __call__(self, age: FloatArray | float) -> FloatArray:
        return self.amount * jnp.log1p(age / self.time)


class Ageing(FrictionLaw):
    """Static friction that grows while a stick lasts; slips are those of another law.

    A stick of the age tau (the time since it began, s) holds up to ``(static + growth(tau)) * normal_force``, where
    `static` is that of `law`. The ages of sticks are part of the state: they follow its other numbers, and are zero in
    an initial state without them.

    Args:
        law: The friction law of slips, and of sticks that have just begun.
        growth: What is added to its static coefficient: an `ExponentialGrowth`, a `LogarithmicGrowth`, or a smooth
            function of the age (s, a scalar) that JAX can trace, zero at the age zero and nowhere negative.

    Raises:
        ValueError: For what is no friction law, or for a growth that cannot be called or does not fit.

    >>> law = ss.Ageing(ss.Coulomb(0.3), ss.LogarithmicGrowth(0.02, time=0.1))
    >>> print(f"{law.static_after(10.0):.4f}")
    0.3923
    """

    law: FrictionLaw
    growth: Callable[[FloatArray], FloatArray] = eqx.field(converter=traceable)
    holds_users_code = True

    def check_parts(self) -> None:
        require_law("law", self.law, may_remember=False)
        if not callable(self.growth) or isinstance(self.growth, type):
            raise checks.refused("growth", "be a LogarithmicGrowth, or a function of the stick's age", self.growth)

    def has_varying_parts(self) -> bool:
        return varies_within((self.law, self.growth))

    def check_relations(self) -> None:
        if type(self.growth) in (ExponentialGrowth, LogarithmicGrowth):
            return
        _check_traceable(self.growth, "Argument growth of Ageing")
        checks.bounded("growth(0)", self.growth(jnp.zeros(())), at_least=0, below=1e-9)
        for age in _AGES:
            checks.non_negative(f"growth({age:g})", self.growth(jnp.asarray(age)))

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.law.constant

    @property
    def speed_scale(self) -> Scalar | None:
        return self.law.speed_scale

    @property
    def viscous_slope(self) -> Scalar:
        return self.law.viscous_slope

    @property
    def static(self) -> Scalar:
        return self.law.static

    def static_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        return self.law.static_after(age) + self.growth(jnp.asarray(age))

    @property
    def growth_time(self) -> Scalar | None:
        own = self.growth.time if isinstance(self.growth, Growth) else None
        return least(own, self.law.growth_time) if self.law.grows else own

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.law.kinetic(speed)

    @property
    def depends_on_direction(self) -> bool:
        return self.law.depends_on_direction

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        return Ageing(self.law.in_direction(velocity), self.growth) if self.depends_on_direction else self


class AtAge(MadeOfLaws):
    """A law whose sticks have all lasted `age` (s)."""

    law: FrictionLaw
    age: FloatArray

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.law.constant

    @property
    def static(self) -> Scalar:
        return self.law.static_after(self.age)

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.law.kinetic(speed)

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        return AtAge(self.law.in_direction(velocity), self.age)


def require_law(name: str, value: object, may_remember: bool = True, may_differ_by_place: bool = False) -> None:
    """Raises ValueError for what is no friction law; unless it `may_remember`, for one with an inner state; and unless
    it `may_differ_by_place`, for one that does: what knows nothing of places would take the largest of all regions.
    """
    if not isinstance(value, FrictionLaw):
        raise checks.refused(name, "be a friction law such as Coulomb(mu=0.3)", value)
    if not may_remember and value.inner_state is not None:
        raise checks.refused(name, "be a friction law without an inner state, such as Coulomb(mu=0.3)", value)
    if not may_differ_by_place and value.differs_by_place:
        hint = "a MassSpring with a constant normal force and a MotorCart take friction that differs by place"
        raise checks.refused(name, "be a friction law that is the same everywhere", value, hint)


def least(*values: Scalar | None) -> Scalar | None:
    """The least of the values; None where one is not known, or there are none."""
    known = [value for value in values if value is not None]
    if len(known) < len(values) or not known:
        return None
    if all(isinstance(value, (int, float)) for value in known):
        return min(known)
    return reduce(jnp.minimum, known)  # as a stack, numbers without a type of their own would get one


def most(one: Scalar, other: Scalar) -> Scalar:
    """The larger one of two numbers."""
    are_numbers = isinstance(one, (int, float)) and isinstance(other, (int, float))
    return max(one, other) if are_numbers else jnp.maximum(one, other)
