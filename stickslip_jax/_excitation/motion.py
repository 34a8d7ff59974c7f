"""What drives a system: the base class of laws, signals and realisations, and signals that are known or random
functions of time.
"""

import abc
import math
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._compiler.programs import kept_jit
from .._foundation import checks
from .._foundation.fields import Checked, Module, Quantity, is_of_package
from .._foundation.types import AnyArray, FloatArray, KeyData, Number, Scalar
from .._numerics.elementary import key_data_of, random_words, sincos, uniform

# The base class of all that drives a system: laws, signals and realisations.


class Motion(Module):
    """Base class of base motions, ground motions and voltages.

    Attributes:
        part_of_excitation: Smooth, or in segments a base velocity or an acceleration of the ground; "none" for a force.
        is_random: Whether realisations differ, so that one must be drawn before `simulate`.
        takes_jumps: Whether it is a continuous base velocity, to which `WithJumps` can add jumps.
    """

    part_of_excitation: ClassVar[Literal["smooth", "base", "ground", "none"]] = "smooth"
    is_random: ClassVar[bool] = False
    takes_jumps: ClassVar[bool] = True

    @property
    def covered_time(self) -> float:
        """Duration of a recorded motion, s; infinity for one that is not recorded, or whose times are traced."""
        return math.inf

    @property
    def repeats_after(self) -> Number | tuple[Number, ...] | None:
        """After what time (s) it repeats itself, or each of its parts: 0 for what never changes, None for not known."""
        return None

    def realized_until(self, t1: Scalar) -> "Motion":
        """This motion, which is not random, as `simulate` follows it up to `t1` (s)."""
        return self


# Smooth signals: base velocities, forces and voltages that are known functions of time.


# Gauss-Legendre nodes and weights on [-1, 1]: exact for polynomials of degree 19.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)

Tones: TypeAlias = tuple[Scalar | AnyArray, Scalar | AnyArray, Scalar | AnyArray]
"""Amplitudes, angular frequencies (rad/s) and phases (rad): numbers, or arrays (harmonics,)."""

PerHarmonic: TypeAlias = Float[AnyArray, " harmonics"]

SEEN_IN_STEPS = 4
"""Adaptive steps in the shortest period of what drives a system, at least: the stages of a step see every change."""

SIGNAL_UNIT = "m/s for a base velocity, N for a force"


class Signal(Checked, Motion):
    """A smooth function of time. Subclass it and write `value`; everything else follows, or may be overridden.

    A subclass of a signal that has another `value` has the rates, integrals and shortest period of that value, not
    those of its parent.

    Attributes:
        shortest_period: The period (s) of its fastest oscillation, of a pulse about twice its duration, infinity if it
            does not oscillate; None where it is not known: the step of a simulation must then be given, and adaptive
            steps are refused.
    """

    is_harmonic: ClassVar[bool] = False  # a sum of `tones` and a `mean`, as `_Tones` has them
    rests_on: ClassVar = {
        "rate": ("value",),
        "curvature": ("value", "rate"),
        "integral": ("value",),
        "shortest_period": ("value", "tones"),
        "repeats_after": ("value", "tones"),
        "is_harmonic": ("value", "rate", "curvature", "integral"),
    }

    @staticmethod
    def of(function: Callable[[FloatArray], Any], *, shortest_period: Scalar | None = None) -> "Signal":
        """The signal that a function of time is: ``ss.Signal.of(lambda t: 2 * jnp.sin(t) ** 3, shortest_period=6.28)``.

        Args:
            function: Takes the time t (s, a scalar) and returns the signal, m/s for a base velocity, N for a force.
                JAX traces it: write it in ``jax.numpy``, and numbers to differentiate by as fields of a subclass.
            shortest_period: As the attribute. Without it, give the step: ``method=ss.Exact(step=...)``.

        Raises:
            ValueError: For what is no function that JAX can trace, and a period that is not positive.
        """
        return _OfFunction(function, shortest_period)

    def check_relations(self) -> None:
        if not is_of_package(self):
            with checks.traceable(f"The method value of {type(self).__name__}"):
                jax.make_jaxpr(self.value)(jnp.zeros(()))

    @abc.abstractmethod
    def value(self, t: FloatArray) -> FloatArray:
        """The signal at time `t` (s, a scalar): m/s for a base velocity, N for a force."""

    def rate(self, t: FloatArray) -> FloatArray:
        """Its first time derivative."""
        return jax.jvp(self.value, (t,), (jnp.ones_like(t),))[1]

    def curvature(self, t: FloatArray) -> FloatArray:
        """Its second time derivative."""
        return jax.jvp(self.rate, (t,), (jnp.ones_like(t),))[1]

    def integral(self, t: FloatArray, h: FloatArray) -> FloatArray:
        """Its integral from `t` to ``t + h`` (by 10-point Gauss-Legendre quadrature unless overridden)."""
        nodes = t + h * jnp.asarray((_NODES + 1) / 2, jnp.result_type(t))
        return h * jnp.sum(jax.vmap(self.value)(nodes) * jnp.asarray(_WEIGHTS / 2, jnp.result_type(t)))

    @property
    def shortest_period(self) -> Scalar | None:
        return None


class _OfFunction(Signal):
    """A function of a user's as a signal."""

    function: Callable[[FloatArray], Any] = eqx.field(static=True)
    period: Annotated[Number | None, Quantity("s", above=0)] = None
    holds_users_code = True

    def check_relations(self) -> None:
        if not callable(self.function):
            raise checks.refused("function", "be a function of the time t (s)", self.function)
        with checks.traceable("Argument function of Signal.of"):
            jax.make_jaxpr(self.value)(jnp.zeros(()))

    def value(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(self.function(t))

    @property
    def shortest_period(self) -> Scalar | None:
        return self.period


class _Tones(Signal):
    """Base class of a harmonic and a sum of harmonics."""

    is_harmonic = True

    @property
    @abc.abstractmethod
    def tones(self) -> Tones:
        """Amplitude, angular frequency and phase: numbers, or arrays (harmonics,)."""

    @property
    def mean(self) -> Scalar:
        """Mean of the signal."""
        return self.offset  # pyright: ignore[reportAttributeAccessIssue] - a field of both

    def value(self, t: FloatArray) -> FloatArray:
        return self.mean + _motion(self.tones, t)[0]

    def rate(self, t: FloatArray) -> FloatArray:
        return _motion(self.tones, t)[1]

    def curvature(self, t: FloatArray) -> FloatArray:
        return _motion(self.tones, t)[2]

    def power_series(self, t: FloatArray, terms: int) -> tuple[FloatArray, ...]:
        """The coefficients of its power series in the time since `t`."""

        def one(amplitude, w, phase):
            sine, cosine = sincos(angle(w, t, phase))
            coefficients = [amplitude * cosine, -amplitude * w * sine]
            for k in range(2, terms):
                coefficients.append(coefficients[k - 2] * (-w * w / (k * (k - 1))))
            return tuple(coefficients[:terms])

        first, *others = added_up(one, self.tones)
        return self.mean + first, *others

    def integral(self, t: FloatArray, h: FloatArray) -> FloatArray:
        def one(amplitude, w, phase):
            # sin(b) - sin(a) as a product: no cancellation for short steps.
            return (amplitude * 2 / w * sincos(angle(w, h / 2, 0))[0] * sincos(angle(w, t + h / 2, phase))[1],)

        return self.mean * h + added_up(one, self.tones)[0]


@kept_jit
def _motion(tones: Tones, t: FloatArray) -> tuple[FloatArray, ...]:
    """Value, rate and curvature of the sum of `tones`."""

    def one(amplitude, w, phase):
        sine, cosine = sincos(angle(w, t, phase))
        return amplitude * cosine, -amplitude * w * sine, -amplitude * w * w * cosine

    return added_up(one, tones)


def angle(w: Scalar | AnyArray, t: AnyArray | float, phase: Scalar | AnyArray | int) -> FloatArray:
    """``w t + phase``, rad."""
    return jnp.asarray(w * t + phase, jnp.result_type(float, t))


def added_up(one: Callable[..., tuple[FloatArray, ...]], tones: Tones) -> tuple[FloatArray, ...]:
    """The sums over all `tones` of the numbers ``one(amplitude, angular_frequency, phase)``.

    A loop, so that the compiled code does not grow with the number of tones.
    """
    if jnp.ndim(tones[1]) == 0:
        return one(*tones)
    shapes = jax.eval_shape(one, *(jnp.asarray(tone)[0] for tone in tones))
    start = tuple(jnp.zeros(shape.shape, shape.dtype) for shape in shapes)

    def add(sums, tone):
        return tuple(a + b for a, b in zip(sums, one(*tone), strict=True)), None

    return lax.scan(add, start, tones)[0]


class Harmonic(_Tones):
    """A harmonic base velocity or force, ``offset + amplitude cos(angular_frequency t + phase)``.

    Args:
        amplitude: m/s for a base velocity, N for a force.
        angular_frequency: rad/s, positive.
        phase: rad.
        offset: The mean; m/s for a base velocity, N for a force.

    Raises:
        ValueError: For numbers that are not finite, or a frequency that is not positive.
    """

    amplitude: Annotated[Number, Quantity(SIGNAL_UNIT)]
    angular_frequency: Annotated[Number, Quantity("rad/s", above=0)]
    phase: Annotated[Number, Quantity("rad")] = 0.0
    offset: Annotated[Number, Quantity(SIGNAL_UNIT)] = 0.0

    @property
    def tones(self) -> Tones:
        return self.amplitude, self.angular_frequency, self.phase

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.angular_frequency

    @property
    def repeats_after(self) -> Number:
        return 2 * math.pi / self.angular_frequency


class SumOfHarmonics(_Tones):
    """A sum of harmonics, ``offset + sum_j amplitudes[j] cos(angular_frequencies[j] t + phases[j])``.

    Args:
        amplitudes: m/s for a base velocity, N for a force, (harmonics,).
        angular_frequencies: rad/s, positive, (harmonics,).
        phases: rad, (harmonics,); by default 0.
        offset: The mean; m/s for a base velocity, N for a force.

    Raises:
        ValueError: For arrays of different lengths, numbers that are not finite, or frequencies not positive.
    """

    amplitudes: Annotated[PerHarmonic, Quantity(SIGNAL_UNIT, ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "amplitudes")
    )
    angular_frequencies: Annotated[
        PerHarmonic, Quantity("rad/s", above=0, ndim=1, hint="a constant part is the offset")
    ] = eqx.field(converter=partial(checks.real_array, "angular_frequencies"))
    phases: Annotated[PerHarmonic | None, Quantity("rad", "of each harmonic; not given: 0", ndim=1)] = eqx.field(
        default=None, converter=lambda v: None if v is None else checks.real_array("phases", v)
    )
    offset: Annotated[Number, Quantity(SIGNAL_UNIT)] = 0.0

    def check_relations(self) -> None:
        phases = {} if self.phases is None else {"phases": self.phases}
        checks.same_length(1, amplitudes=self.amplitudes, angular_frequencies=self.angular_frequencies, **phases)

    @property
    def tones(self) -> Tones:
        amplitudes, phases = jnp.asarray(self.amplitudes), self.phases
        phases = jnp.zeros_like(amplitudes) if phases is None else jnp.asarray(phases)
        return amplitudes, jnp.asarray(self.angular_frequencies), phases

    @property
    def shortest_period(self) -> Scalar:
        frequencies = self.angular_frequencies
        fastest = jnp.max(frequencies) if checks.is_traced(frequencies) else float(np.max(np.asarray(frequencies)))
        return 2 * math.pi / fastest

    @property
    def repeats_after(self) -> tuple[Number, ...]:
        return tuple(2 * math.pi / self.angular_frequencies[i] for i in range(len(self.angular_frequencies)))


class UserMotion(Signal):
    """A user-defined base motion: any object with ``velocity(t)`` (m/s) and ``acceleration(t)`` (m/s^2).

    It may have ``shortest_period`` (s) too, as a `Signal`; without it, the step must be given. To differentiate with
    respect to its parameters, make it a pytree (an ``equinox.Module``, say); any other object is a constant.
    """

    motion: Any = eqx.field(converter=lambda v: _Constant(v) if jax.tree.leaves(v) == [v] else v)
    holds_users_code = True

    @property
    def users(self) -> Any:
        """The user's object."""
        return self.motion.held if isinstance(self.motion, _Constant) else self.motion

    def check_relations(self) -> None:
        for name in ("velocity", "acceleration"):
            with checks.traceable(f"The method {name} of {type(self.users).__name__}"):
                jax.make_jaxpr(getattr(self.users, name))(jnp.zeros(()))

    def value(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(self.users.velocity(t))

    def rate(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(self.users.acceleration(t))

    @property
    def shortest_period(self) -> Scalar | None:
        return getattr(self.users, "shortest_period", None)

    @property
    def repeats_after(self) -> Number | None:
        return getattr(self.users, "period", None)


class _Constant(eqx.Module):
    """An object that is no pytree, as a pytree without leaves."""

    held: Any = eqx.field(static=True)


# The source voltage of a motor.


class SourceVoltage(Signal):
    """The source voltage of a motor, ``mean + amplitude sin(angular_frequency t + phase)``.

    Source: Lima and Sampaio 2022, section 2; the defaults are its Table 1.

    Args:
        mean: V.
        amplitude: V.
        angular_frequency: rad/s, positive.
        phase: rad.

    Raises:
        ValueError: For numbers that are not finite, or a frequency that is not positive.
    """

    takes_jumps = False
    mean: Annotated[Number, Quantity("V")] = 1.0
    amplitude: Annotated[Number, Quantity("V")] = 0.5
    angular_frequency: Annotated[Number, Quantity("rad/s", above=0)] = 10.0
    phase: Annotated[Number, Quantity("rad")] = 0.0

    def value(self, t: FloatArray) -> FloatArray:
        return self.mean + self.amplitude * jnp.sin(self.angular_frequency * t + self.phase)

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.angular_frequency

    @property
    def repeats_after(self) -> Number:
        return 2 * math.pi / self.angular_frequency


# Random signals, among them random phases.


_FIRST_PHASE = 0xFFFFFF00  # number of the random word that the first phase is drawn from


class RandomSignal(Checked, Motion):
    """Base class of smooth random functions of time: each realisation is a `Signal`."""

    is_random = True
    rests_on: ClassVar = {"shortest_period": ("realized",)}

    @abc.abstractmethod
    def realized(self, key_data: KeyData, dtype) -> Signal:
        """The realisation drawn by `key_data`."""

    @property
    def shortest_period(self) -> Scalar | None:
        """The period (s) of the fastest oscillation of any realisation, as that of a `Signal`."""
        return None

    def sample(self, key: Array, t1: Scalar | None = None) -> Signal:
        """The realisation drawn by `key`, from ``jax.random.key(seed)``; it has no end, and `t1` is not used."""
        return self.realized(key_data_of(key), jnp.result_type(float))


class RandomPhase(RandomSignal):
    """A signal whose phase is uniform on ``[0, 2 pi]``; each harmonic of a sum has its own, independent of the others.

    Args:
        signal: A `Harmonic`, a `SumOfHarmonics` or a `SourceVoltage` (Lima and Sampaio 2022, section 6); its phases are
            not used.

    Raises:
        ValueError: For anything else.
    """

    signal: Signal

    def check_relations(self) -> None:
        if not isinstance(self.signal, (Harmonic, SumOfHarmonics, SourceVoltage)):
            raise checks.refused("signal", "be a Harmonic, a SumOfHarmonics or a SourceVoltage", self.signal)

    @property
    def shortest_period(self) -> Scalar | None:
        return self.signal.shortest_period

    def realized(self, key_data: KeyData, dtype) -> Signal:
        """The signal with phases drawn by `key_data`."""
        if isinstance(self.signal, SumOfHarmonics):
            first = jnp.asarray(_FIRST_PHASE, jnp.uint32)
            numbers = first + jnp.arange(len(self.signal.amplitudes), dtype=jnp.uint32)
            phases = _angle(random_words(key_data, numbers)[0], dtype)
            return eqx.tree_at(lambda signal: signal.phases, self.signal, phases, is_leaf=lambda leaf: leaf is None)
        phase = _angle(random_words(key_data, jnp.asarray(_FIRST_PHASE, jnp.uint32))[0], dtype)
        return eqx.tree_at(lambda signal: signal.phase, self.signal, phase)


def _angle(key_data: Array, dtype) -> Array:
    return 2 * np.pi * uniform(key_data, dtype)
