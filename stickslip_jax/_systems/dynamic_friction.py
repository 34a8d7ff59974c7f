"""Friction laws with an inner state: bristles that bend, asperities that age. They are smooth, and have no exact stick.

The friction coefficient follows from the relative velocity v and the inner state z, whose rate follows from both.
"""

import abc
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._excitation.motion import Signal
from .._excitation.piecewise_constant import PiecewiseConstant
from .._excitation.recorded import Recorded
from .._foundation import checks
from .._foundation.fields import Choice, Quantity
from .._foundation.types import AnyArray, FloatArray, FloatScalar, Number, Scalar
from .._numerics.matrices import stacked
from .friction import FrictionLaw, static_at_least
from .prescribed import BehindSpring, SpeedBehindSpring, force_of_dynamic

_MU = "friction coefficient of a fast slip"
_STATIC = "largest friction coefficient of a slow slip, at least mu"
_LEAST_SPEED = 1e-10  # of the reference speed
_BRISTLES = "of the bristles: friction coefficient per deflection"


class DynamicFriction(FrictionLaw):
    """Base class of friction laws with an inner state. Subclass it for one of your own.

    The inner state is zero at rest, unless `initial_state` says otherwise. It is one number, or as many as
    `inner_states` names.
    """

    @abc.abstractmethod
    def rate(self, z: FloatArray, velocity: FloatScalar) -> FloatArray:
        """The time derivative of the inner state `z` at the relative `velocity` (m/s): a number, or as an array `z` of
        those that `inner_states` names.
        """

    @abc.abstractmethod
    def coefficient(self, z: FloatArray, velocity: FloatScalar) -> FloatScalar:
        """The friction coefficient, with the sign of a force against a positive relative velocity."""

    @abc.abstractmethod
    def steady(self, velocity: FloatArray) -> FloatArray:
        """The friction coefficient of a slip that has long had this relative velocity (m/s, not zero)."""

    def at_normal_force(self, z: FloatArray, normal_force: FloatScalar) -> FloatArray:
        """The state that counts under this normal force (N), of laws whose state steps with it; here `z`."""
        return z

    @property
    def initial_state(self) -> Scalar | tuple[Scalar, ...]:
        """The inner state of a contact at rest; of several numbers one for each, or one for all."""
        return 0.0

    @property
    def inner_state(self) -> str:
        return "inner state"

    @property
    def inner_states(self) -> tuple[str, ...]:
        """Name and unit of each number of the inner state. Where they are several, `z` is an array of them."""
        return (self.inner_state,)

    @property
    def elastic_slip(self) -> Scalar:
        """How far bristles bend from one limit to the other, m: between two times of rest, a contact that slips by less
        has been stuck. Zero for laws that tell no deflection.
        """
        return 0.0

    def check_relations(self) -> None:
        """Nothing, unless a law has something to check."""

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        """The coefficient of a steady slip at this speed; at the speed zero, the static one."""
        moves = speed > 0
        return jnp.where(moves, self.steady(jnp.where(moves, speed, 1)), self.static)

    def force(  # pyright: ignore[reportIncompatibleMethodOverride] - other options than laws of the speed have
        self,
        times: npt.ArrayLike,
        velocity: npt.ArrayLike | Recorded | Signal | PiecewiseConstant,
        normal_force: Any = 1.0,
        *,
        series_stiffness: Number | None = None,
        backlash: Number = 0.0,
        initial_state: Number | AnyArray | None = None,
        rtol: float = 1e-8,
        max_steps: int | None = None,
        adjoint: object = None,
    ) -> FloatArray:
        """The friction force under a prescribed motion, as a test rig measures it.

        Args:
            times: s, increasing, (times,), at least 2.
            velocity: The relative velocity at these times, m/s, (times,), joined by straight lines; or a `Recorded` or
                `Signal` such as `Harmonic`, whose points and turns between the times count too; or steps, a
                `PiecewiseConstant`, at whose jumps the force is that after them. With a spring, that of its end.
            normal_force: N, zero or positive; one number, or without a spring one for each time, or a function of time:
                a `Signal`, a `Recorded` or a `ForceSteps`.
            series_stiffness: N/m, of a spring in front of the contact, for `Dahl`, `BoucWen` and `DieterichRuina`.
                With this last one the contact begins to slip as fast as the spring's end moves: by default steadily
                at the reference speed.
            backlash: The free play in front of the spring, m. It begins in the middle, if there is no force.
            initial_state: The inner state at the first time, an array if it has several numbers; by default that at
                rest.
            rtol: Relative tolerance of the integration, by diffrax' ``Kvaerno5``, implicit and of fifth order. The
                absolute one is as small a part of the inner state at which the law slips steadily. `DieterichRuina`
                behind a spring takes no less than 8 units of round-off times ``mu / direct``.
            max_steps: The largest number of steps; by default 1048576 and 64 for each time and point of a record.
            adjoint: How diffrax differentiates: by default ``RecursiveCheckpointAdjoint()``, for ``grad``;
                ``ForwardMode()`` for ``jvp`` and ``jacfwd``.

        Returns:
            The force at these times, N, (times,), positive against a positive relative velocity; NaN after the time at
            which the steps were used up.

        Raises:
            ValueError: For times that do not increase, velocities of another length, and numbers out of range; for a
                spring in front of a law whose speed may jump there, and a signal whose shortest period is not known;
                and where the steps were used up, unless JAX traces the numbers.
        """
        start: Any = self.initial_state if initial_state is None else initial_state
        number = len(self.inner_states)
        checks.bounded("initial_state", start, ndim=min(number - 1, checks.dimensions(start)))
        start = jnp.asarray(start, float)
        if start.shape not in ((), (number,)):
            raise checks.refused("initial_state", f"be one number, or {number} of them", start)
        start = jnp.broadcast_to(start, (number,) if number > 1 else ())
        if series_stiffness is None:
            checks.bounded("backlash", backlash, "m", at_least=0, below=1e-300, hint="give the series_stiffness too")
            return force_of_dynamic(self, times, velocity, normal_force, start, rtol, max_steps, adjoint)
        law = self.behind_spring(series_stiffness, backlash, normal_force)
        return force_of_dynamic(law, times, velocity, normal_force, start, rtol, max_steps, adjoint)

    def behind_spring(
        self, series_stiffness: Number, backlash: Number, normal_force: Number
    ) -> BehindSpring | SpeedBehindSpring:
        """The law behind a spring (N/m) with a free play (m). Raises ValueError where such a slider may jump."""
        raise _jumps(self, series_stiffness)

    @property
    def state_scale(self) -> Scalar | tuple[Scalar, ...]:
        """A typical size of the inner state: that of its errors where it is small; as of `initial_state`."""
        return 1.0


def _jumps(law: DynamicFriction, series_stiffness: Number) -> ValueError:
    return ValueError(
        f"Argument series_stiffness must be None for {type(law).__name__}, but {checks.show(series_stiffness)} was "
        "given: such a slider may jump from one speed to another; with Dahl, BoucWen and DieterichRuina it does not. "
        "Give it a mass: write mass, spring and backlash as a SwitchedSystem."
    )


def _spring(
    law: DynamicFriction, series_stiffness: Number, backlash: Number, normal_force: Number
) -> tuple[FloatArray, FloatArray]:
    """The deflection of the spring per friction coefficient, and its free play either way; both in m."""
    owners = [next(kind for kind in type(law).__mro__ if name in vars(kind)) for name in ("rate", "coefficient")]
    if any(kind.__module__ != __name__ for kind in owners):  # a subclass may jump
        raise _jumps(law, series_stiffness)
    if isinstance(law, DieterichRuina) and law.normal_stress is not None:
        raise checks.refused("series_stiffness", "be None for a law with normal_stress", series_stiffness)
    checks.positive("series_stiffness", series_stiffness, "N/m")
    checks.bounded("backlash", backlash, "m", at_least=0)
    checks.positive("normal_force", normal_force, "N")
    return jnp.asarray(normal_force / series_stiffness, float), jnp.asarray(backlash, float) / 2


class _Bristles(DynamicFriction):
    """Bristles whose deflection z (m) follows the motion, up to that of a steady slip of any speed."""

    mu: eqx.AbstractVar[Number]
    stiffness: eqx.AbstractVar[Number]

    @property
    def inner_state(self) -> str:
        return "deflection in m"

    def behind_spring(self, series_stiffness: Number, backlash: Number, normal_force: Number) -> BehindSpring:
        softness, play = _spring(self, series_stiffness, backlash, normal_force)
        return BehindSpring(self, softness * self.stiffness, play)

    @property
    def static(self) -> Scalar:
        return self.mu

    @property
    def elastic_slip(self) -> Scalar:
        return 2 * self.mu / self.stiffness

    @property
    def state_scale(self) -> Scalar:
        return self.mu / self.stiffness

    def coefficient(self, z: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        return self.stiffness * z

    def steady(self, velocity: FloatArray) -> FloatArray:
        return self.mu * jnp.sign(velocity)


class Dahl(_Bristles):
    """Dahl's friction: a spring that yields gradually. ``z' = v |1 - s|^exponent sign(1 - s)``, ``s = stiffness z
    sign(v) / mu``; friction coefficient ``stiffness z``.

    Source: Dahl 1968, A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1.

    Args:
        mu: The friction coefficient of a steady slip, positive.
        stiffness: Friction coefficient per deflection, 1/m, positive.
        exponent: How sharply it yields, positive; 1 in most uses.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    mu: Annotated[Number, Quantity(meaning="friction coefficient of a steady slip", above=0)]
    stiffness: Annotated[Number, Quantity("1/m", "friction coefficient per deflection", above=0)]
    exponent: Annotated[Number, Quantity(meaning="how sharply the spring yields", above=0)] = 1.0

    def rate(self, z: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        left = 1 - self.stiffness * z * jnp.sign(velocity) / self.mu
        if not checks.is_traced(self.exponent) and self.exponent == 1:
            return velocity * left
        # Below exponent 1 the spring yields wholly at a finite deflection, with an infinite slope: round-off limits it.
        least = jnp.sqrt(jnp.finfo(jnp.result_type(left)).eps)
        return velocity * left * jnp.maximum(jnp.abs(left), least) ** (self.exponent - 1)


class BoucWen(_Bristles):
    """The hysteresis of Bouc and Wen: ``z' = v (1 - |z / z_0|^exponent (1 - sharing + sharing sign(v z)))``.

    With ``z_0 = mu / stiffness``; friction coefficient ``stiffness z``. The larger the exponent, the more suddenly it
    yields: the limit is the elastic slider of `Coulomb` friction behind a spring.

    Source: Wen 1976, Method for random vibration of hysteretic systems, J. Eng. Mech. Div. ASCE 102, 249.

    Args:
        mu: The friction coefficient of a steady slip, positive.
        stiffness: Friction coefficient per deflection, 1/m, positive.
        exponent: How suddenly it yields, at least 1.
        sharing: Wen's ``beta / (beta + gamma)``, from 0 to 1: with 0.5 unloading has the stiffness of the beginning.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    mu: Annotated[Number, Quantity(meaning="friction coefficient of a steady slip", above=0)]
    stiffness: Annotated[Number, Quantity("1/m", "friction coefficient per deflection", above=0)]
    exponent: Annotated[Number, Quantity(meaning="how suddenly it yields", at_least=1)] = 2.0
    sharing: Annotated[Number, Quantity(meaning="0.5: unloading is as stiff as the beginning", at_least=0)] = 0.5

    def check_relations(self) -> None:
        checks.bounded("sharing", self.sharing, at_least=0, below=1 + 1e-12)

    def rate(self, z: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        share = jnp.abs(z) * self.stiffness / self.mu
        power = jnp.where(share > 0, jnp.where(share > 0, share, 1) ** self.exponent, 0)
        return velocity * (1 - power * (1 - self.sharing + self.sharing * jnp.sign(velocity * z)))


class LuGre(DynamicFriction):
    """The LuGre model: bristles with a damping, whose steady friction falls with the speed (Stribeck).

    ``z' = v - stiffness |v| z / g(v)``, ``g(v) = mu + (mu_static - mu) exp(-(v / stribeck_speed)^2)``; friction
    coefficient ``stiffness z + damping z' + viscous v``.

    Source: Canudas de Wit, Olsson, Astrom and Lischinsky 1995, A new model for control of systems with friction, IEEE
    Trans. Autom. Control 40, 419, equations 1 to 4. Their forces in N are these numbers times the normal force.

    Args:
        mu: The friction coefficient of the bristles in a fast slip, positive.
        mu_static: That in a very slow one, at least `mu`.
        stribeck_speed: The speed over which it falls, m/s, positive.
        stiffness: Of the bristles: friction coefficient per deflection, 1/m, positive.
        damping: Of the bristles: friction coefficient per rate of deflection, s/m, zero or positive.
        viscous: Friction coefficient per speed, s/m, zero or positive.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    mu: Annotated[Number, Quantity(meaning=_MU, above=0)]
    mu_static: Annotated[Number, Quantity(meaning=_STATIC, above=0)]
    stribeck_speed: Annotated[Number, Quantity("m/s", above=0)]
    stiffness: Annotated[Number, Quantity("1/m", _BRISTLES, above=0)]
    damping: Annotated[Number, Quantity("s/m", "of the bristles", at_least=0)] = 0.0
    viscous: Annotated[Number, Quantity("s/m", "times the speed", at_least=0)] = 0.0

    def check_relations(self) -> None:
        static_at_least(self.mu, self.mu_static)

    def limit(self, speed: FloatScalar) -> FloatScalar | Scalar:
        """The friction coefficient of the bristles in a steady slip at this speed."""
        return self.mu + (self.mu_static - self.mu) * jnp.exp(-((speed / self.stribeck_speed) ** 2))

    @property
    def inner_state(self) -> str:
        return "deflection in m"

    @property
    def state_scale(self) -> Scalar:
        return self.mu / self.stiffness

    @property
    def static(self) -> Scalar:
        return self.mu_static

    @property
    def elastic_slip(self) -> Scalar:
        return 2 * self.mu_static / self.stiffness

    def rate(self, z: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        return velocity - self.stiffness * jnp.abs(velocity) * z / self.limit(velocity)

    def coefficient(self, z: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        return self.stiffness * z + self.damping * self.rate(z, velocity) + self.viscous * velocity

    def steady(self, velocity: FloatArray) -> FloatArray:
        return self.limit(velocity) * jnp.sign(velocity) + self.viscous * velocity


class ElastoPlastic(LuGre):
    """The elasto-plastic model: as `LuGre`, but bristles bent by less than a breakaway deflection do not creep.

    ``z' = v (1 - alpha(z, v) z sign(v) / z_s)`` with ``z_s = g(v) / stiffness``; alpha is 0 while ``|z|`` is below
    ``breakaway z_s`` or the bristles unbend, 1 beyond z_s, and joins these smoothly by half a wave of a sine.

    Source: Dupont, Hayward, Armstrong and Altpeter 2002, Single state elastoplastic friction models, IEEE Trans.
    Autom. Control 47, 787, equations 5, 6 and 14.

    Args:
        mu: The friction coefficient of the bristles in a fast slip, positive.
        mu_static: That in a very slow one, at least `mu`.
        stribeck_speed: The speed over which it falls, m/s, positive.
        stiffness: Of the bristles: friction coefficient per deflection, 1/m, positive.
        damping: Of the bristles: friction coefficient per rate of deflection, s/m, zero or positive.
        viscous: Friction coefficient per speed, s/m, zero or positive.
        breakaway: The deflection at which the bristles begin to yield, as a share of that of a steady slip, from 0 to
            below 1.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    breakaway: Annotated[Number, Quantity(meaning="deflection that yields, over that of a slip", at_least=0)] = 0.7

    def check_relations(self) -> None:
        LuGre.check_relations(self)
        checks.bounded("breakaway", self.breakaway, at_least=0, below=1)

    def rate(self, z: FloatScalar, velocity: FloatScalar) -> FloatScalar:
        share = z * jnp.sign(velocity) * self.stiffness / self.limit(velocity)
        middle, width = (1 + self.breakaway) / 2, 1 - self.breakaway
        wave = jnp.clip((share - middle) / width, -0.5, 0.5)
        alpha = 0.5 * (1 + jnp.sin(jnp.pi * wave))
        return velocity * (1 - alpha * share)


class DieterichRuina(DynamicFriction):
    """Rate-and-state friction of Dieterich and Ruina: it grows with the logarithm of speed and of contact time.

    With the state variable theta (s) and the inner state ``z = log(reference_speed theta / length)``,
    ``coefficient = direct asinh(v / (2 reference_speed) exp((mu + evolution z) / direct))``, which for speeds that are
    not tiny is ``mu + direct log(v / reference_speed) + evolution z``; ageing form: ``theta' = 1 - |v| theta /
    length``; slip form: ``theta' = -(|v| theta / length) log(|v| theta / length)``; form of Perrin, Rice and Zheng:
    ``theta' = 1 - (v theta / (2 length))^2``, whose steady theta is ``2 length / |v|``, and ``z = log(reference_speed
    theta / (2 length))``, so that `mu` is the steady coefficient at the reference speed in all forms.

    With Linker and Dieterich's alpha, `normal_stress`, a step of the normal force from N to N_1 multiplies theta by
    ``(N_1 / N)^(-alpha / evolution)``: ``theta' = ... - alpha theta N' / (evolution N)``. The inner state is then what
    does not step, ``z + alpha / evolution log(N / reference_normal_force)``: that at the reference.

    With `second_evolution` b_2 and `second_length` L_2 there are two state variables, each of which follows the same
    form over its own length: ``coefficient = ... + evolution z_1 + second_evolution z_2``. In the slip form the inner
    states are Ruina's Theta_1 and Theta_2, ``Theta_i' = -(|v| / L_i) (Theta_i + log(|v| / reference_speed))``.

    Source: Linker and Dieterich 1992, Effects of variable normal stress on rock friction, J. Geophys. Res. 97, 4923;
    Ruina 1983, Slip instability and state variable friction laws, J. Geophys. Res. 88, 10359; two state variables:
    Gu, Rice, Ruina and Tse 1984, Slip motion and stability of a single degree of freedom elastic system with rate and
    state dependent friction, J. Mech. Phys. Solids 32, 167; the inverse
    hyperbolic sine: Rice and Ben-Zion 1996, Proc. Natl. Acad. Sci. 93, 3811; the third form: Perrin, Rice and Zheng
    1995, Self-healing slip pulse on a frictional surface, J. Mech. Phys. Solids 43, 1461.

    Args:
        mu: The friction coefficient of a steady slip at the reference speed, positive.
        direct: Ruina's a: the growth with the logarithm of the speed, positive.
        evolution: Ruina's b: with that of the state, zero or positive.
        length: D_c: the slip in which the state changes, m, positive.
        reference_speed: m/s, positive.
        form: "ageing", "slip" or "perrin".
        normal_stress: Linker and Dieterich's alpha, zero or positive, for a `MassSpring`, a `LinearStructure` and a
            `SwitchedSystem` with `normal_forces`; None: theta does not step.
        reference_normal_force: N, positive, given with `normal_stress`.
        second_evolution: The growth with the logarithm of a second state, of any sign; None: there is none. Not with
            `normal_stress`.
        second_length: The slip in which it changes, m, positive, given with `second_evolution`.

    Raises:
        ValueError: For numbers outside these bounds and another `form`.
    """

    mu: Annotated[Number, Quantity(meaning="friction coefficient at the reference speed", above=0)]
    direct: Annotated[Number, Quantity(meaning="a: growth with the logarithm of the speed", above=0)]
    evolution: Annotated[Number, Quantity(meaning="b: growth with the logarithm of the state", at_least=0)]
    length: Annotated[Number, Quantity("m", "slip in which the state changes", above=0)]
    reference_speed: Annotated[Number, Quantity("m/s", above=0)]
    form: Annotated[str, Choice(("ageing", "slip", "perrin"), "how the state follows the motion")] = eqx.field(
        static=True, default="ageing"
    )
    normal_stress: Annotated[Number | None, Quantity(meaning="Linker and Dieterich's alpha", at_least=0)] = None
    reference_normal_force: Annotated[Number | None, Quantity("N", "given with normal_stress", above=0)] = None
    second_evolution: Annotated[Number | None, Quantity(meaning="growth with the logarithm of a second state")] = None
    second_length: Annotated[
        Number | None, Quantity("m", "slip in which it changes, given with second_evolution", above=0)
    ] = None

    def check_relations(self) -> None:
        if (self.second_evolution is None) != (self.second_length is None):
            wanted = "be given if second_evolution is, and only then"
            raise checks.refused("second_length", wanted, self.second_length)
        if self.second_evolution is not None and self.normal_stress is not None:
            hint = "which state steps with the normal force is known of one state only"
            raise checks.refused("normal_stress", "be None with second_evolution", self.normal_stress, hint)
        if (self.normal_stress is None) != (self.reference_normal_force is None):
            wanted = "be given if normal_stress is, and only then"
            raise checks.refused("reference_normal_force", wanted, self.reference_normal_force)
        if self.normal_stress is not None:
            checks.positive("evolution", self.evolution)

    @property
    def inner_states(self) -> tuple[str, ...]:
        first = self.inner_state
        return (first,) if self.second_evolution is None else (first, f"second {first}")

    def _of_states(self, z: FloatArray) -> FloatArray:
        """What a state `z`, or its rate, adds to the coefficient, or its rate."""
        if self.second_evolution is None:
            return jnp.asarray(self.evolution * z)
        return self.evolution * z[0] + self.second_evolution * z[1]

    def at_normal_force(self, z: FloatArray, normal_force: FloatScalar) -> FloatArray:
        if self.normal_stress is None or self.reference_normal_force is None:
            return z
        # Of an open contact, which has no friction, the state of the reference.
        share = jnp.where(normal_force > 0, normal_force, self.reference_normal_force) / self.reference_normal_force
        return z - self.normal_stress / self.evolution * jnp.log(share)

    @property
    def static(self) -> Scalar:
        """The coefficient at the reference speed: this law has none of a stick."""
        return self.mu

    def theta(self, z: FloatArray, *, second: bool = False) -> FloatArray:
        """The state variable (s), or the `second` one, at its inner state `z`, any shape, such as that number of
        ``evaluate(times)``.
        """
        length = self.second_length if second else self.length
        if length is None:
            raise checks.refused("second", "be False for a law with one state", second)
        return (2 if self.form == "perrin" else 1) * length / self.reference_speed * jnp.exp(z)

    def rate(self, z: FloatArray, velocity: FloatScalar) -> FloatArray:
        length = self.length if self.second_length is None else stacked((self.length, self.second_length), z.dtype)
        speed, per = jnp.abs(velocity), self.reference_speed / length
        if self.form == "ageing":
            return per * jnp.exp(-z) - speed / length
        if self.form == "perrin":
            return per / 2 * (jnp.exp(-z) - (speed / self.reference_speed * jnp.exp(z / 2)) ** 2)
        is_slip = speed > 0
        log = jnp.log(jnp.where(is_slip, speed, 1) / self.reference_speed) + z
        return jnp.where(is_slip, -speed / length * log, 0)

    def coefficient(self, z: FloatArray, velocity: FloatScalar) -> FloatScalar:
        share = velocity / (2 * self.reference_speed)
        exponent = (self.mu + self._of_states(z)) / self.direct
        most = 0.9 * jnp.log(jnp.finfo(exponent.dtype).max)
        small = jnp.arcsinh(share * jnp.exp(jnp.minimum(exponent, most)))
        # Beyond, the exponential would overflow: asinh x is log 2 x there.
        size = jnp.where(share != 0, jnp.abs(share), 1)
        large = jnp.where(share != 0, jnp.sign(share) * (jnp.log(2 * size) + exponent), 0)
        return self.direct * jnp.where(exponent < most, small, large)

    def slip_velocity(self, z: FloatArray, coefficient: FloatScalar) -> FloatArray:
        """The relative velocity (m/s) at which the law has this `coefficient`, with its sign."""
        sign = jnp.where(coefficient < 0, -1.0, 1.0)
        share = sign * coefficient / self.direct
        exponent = share - (self.mu + self._of_states(z)) / self.direct
        return sign * self.reference_speed * jnp.exp(exponent) * -jnp.expm1(-2 * share)

    def logarithm(self, z: FloatArray, velocity: FloatScalar) -> FloatArray:
        """``coefficient / direct``: with its sign, and a constant, the logarithm of a speed that is not tiny."""
        return jnp.asarray(self.coefficient(z, velocity) / self.direct)

    def logarithm_rate(
        self, z: FloatArray, logarithm: FloatScalar, acceleration: FloatScalar, z_rate: FloatArray
    ) -> FloatArray:
        """The time derivative of the `logarithm` under a relative acceleration (m/s^2).

        Below a speed that hardly matters, the logarithm follows a force as if that speed remained: so a passage through
        rest is no faster than any step can follow.
        """
        size = jnp.abs(logarithm)
        cosh = size + jnp.log1p(jnp.exp(-2 * size)) - jnp.log(2)
        slow = (self.mu + self._of_states(z)) / self.direct - cosh - jnp.log(2 * self.reference_speed)
        per_velocity = jnp.exp(jnp.minimum(slow, -jnp.log(_LEAST_SPEED * self.reference_speed)))
        return per_velocity * acceleration + jnp.tanh(logarithm) * self._of_states(z_rate) / self.direct

    def behind_spring(self, series_stiffness: Number, backlash: Number, normal_force: Number) -> SpeedBehindSpring:
        return SpeedBehindSpring(self, *_spring(self, series_stiffness, backlash, normal_force))

    def steady(self, velocity: FloatArray) -> FloatArray:
        """With the state of a steady slip, ``z = -log(|v| / reference_speed)``."""

        def of_one(velocity: FloatScalar) -> FloatScalar:
            z = -jnp.log(jnp.abs(velocity) / self.reference_speed)
            return self.coefficient(z if self.second_evolution is None else jnp.stack([z, z]), velocity)

        return jax.vmap(of_one)(velocity) if jnp.ndim(velocity) else of_one(velocity)

    @property
    def initial_state(self) -> Scalar:
        """That of a steady slip at the reference speed, of each state."""
        return 0.0
