"""Smooth signals: base velocities, forces and voltages that are known functions of time."""

import abc
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._types import AnyArray, FloatArray, Scalar

# Gauss-Legendre nodes and weights on [-1, 1]: exact for polynomials of degree 19.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)


class Signal(eqx.Module):
    """A smooth function of time. Subclass it and write `value`; everything else follows, or may be overridden.

    `shortest_period`: the shortest time (s) in which the signal goes up and down once, infinity for one that does not;
    None where it is not known, and the step of a simulation must then be given.
    """

    @abc.abstractmethod
    def value(self, t: FloatArray) -> FloatArray:
        """The signal at time `t` (s, a scalar): m/s for a base velocity, N for a force."""

    def rate(self, t: FloatArray) -> FloatArray:
        """Its derivative with respect to time."""
        return jax.jvp(self.value, (t,), (jnp.ones_like(t),))[1]

    def curvature(self, t: FloatArray) -> FloatArray:
        """Its second derivative."""
        return jax.jvp(self.rate, (t,), (jnp.ones_like(t),))[1]

    def integral(self, t: FloatArray, h: FloatArray) -> FloatArray:
        """Its integral from `t` to ``t + h`` (by 10-point Gauss-Legendre quadrature unless overridden)."""
        nodes = t + h * jnp.asarray((_NODES + 1) / 2, jnp.result_type(t))
        return h * jnp.sum(jax.vmap(self.value)(nodes) * jnp.asarray(_WEIGHTS / 2, jnp.result_type(t)))

    @property
    def shortest_period(self) -> Any:
        return None


class Harmonic(Signal):
    """``offset + amplitude cos(angular_frequency t + phase)``.

    - `amplitude`, `offset`: m/s for a base velocity, N for a force. `angular_frequency`: rad/s, positive.
    - `phase`: rad.

    Raises ValueError for numbers that are not finite, or a frequency that is not positive.
    """

    amplitude: Scalar
    angular_frequency: Scalar
    phase: Scalar = 0.0
    offset: Scalar = 0.0

    def __check_init__(self):
        _checks.numeric("amplitude", self.amplitude)
        _checks.positive("angular_frequency", self.angular_frequency, "rad/s")
        _checks.numeric("phase", self.phase)
        _checks.numeric("offset", self.offset)

    @property
    def tones(self) -> "SumOfHarmonics":
        """The same as a sum of one."""
        amplitude, frequency, phase = (
            jnp.asarray(number)[None] for number in (self.amplitude, self.angular_frequency, self.phase)
        )
        return SumOfHarmonics(amplitude, frequency, phase, self.offset)

    def value(self, t: FloatArray) -> FloatArray:
        return self.tones.value(t)

    def rate(self, t: FloatArray) -> FloatArray:
        return self.tones.rate(t)

    def curvature(self, t: FloatArray) -> FloatArray:
        return self.tones.curvature(t)

    def integral(self, t: FloatArray, h: FloatArray) -> FloatArray:
        return self.tones.integral(t, h)

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.angular_frequency


class SumOfHarmonics(Signal):
    """``offset + sum_j amplitudes[j] cos(angular_frequencies[j] t + phases[j])``.

    - `amplitudes`, `angular_frequencies` (rad/s, positive), `phases` (rad; default zeros): arrays (harmonics,).
    - `offset`: a number.

    Raises ValueError for arrays of different lengths, numbers that are not finite, or frequencies not positive.
    """

    amplitudes: AnyArray = eqx.field(converter=lambda v: _array("amplitudes", v))
    angular_frequencies: AnyArray = eqx.field(converter=lambda v: _array("angular_frequencies", v))
    phases: Any = eqx.field(default=None, converter=lambda v: None if v is None else _array("phases", v))
    offset: Scalar = 0.0

    def __check_init__(self):
        shapes = [np.shape(self.amplitudes), np.shape(self.angular_frequencies)]
        shapes += [] if self.phases is None else [np.shape(self.phases)]
        if len(set(shapes)) > 1 or shapes[0][0] == 0:
            raise ValueError(
                "Arguments amplitudes, angular_frequencies and phases must have the same length of at least 1, but "
                f"they have shapes {', '.join(map(str, shapes))}."
            )
        _checks.numeric("offset", self.offset)
        if not _checks.is_traced(self.angular_frequencies) and np.any(np.asarray(self.angular_frequencies) <= 0):
            raise ValueError(
                "Argument angular_frequencies must be positive (in rad/s), but "
                f"{_checks.show(np.asarray(self.angular_frequencies))} was given; a constant part is the offset."
            )

    @property
    def tones(self) -> "SumOfHarmonics":
        return self

    @property
    def each(self) -> list[tuple[Any, Any, Any]]:
        """Amplitude, angular frequency and phase of each harmonic."""
        phases = jnp.zeros_like(jnp.asarray(self.amplitudes)) if self.phases is None else self.phases
        columns = (self.amplitudes, self.angular_frequencies, phases)
        return [(columns[0][j], columns[1][j], columns[2][j]) for j in range(len(self.amplitudes))]

    def value(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(self.offset + sum(A * jnp.cos(w * t + phase) for A, w, phase in self.each))

    def rate(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(sum(-A * w * jnp.sin(w * t + phase) for A, w, phase in self.each))

    def curvature(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(sum(-A * w * w * jnp.cos(w * t + phase) for A, w, phase in self.each))

    def integral(self, t: FloatArray, h: FloatArray) -> FloatArray:
        # sin(b) - sin(a) as a product: no cancellation for short steps.
        half = [A * 2 / w * jnp.sin(w * h / 2) * jnp.cos(w * (t + h / 2) + phase) for A, w, phase in self.each]
        return self.offset * h + sum(half)

    @property
    def shortest_period(self) -> Scalar:
        frequencies = self.angular_frequencies
        fastest = jnp.max(frequencies) if _checks.is_traced(frequencies) else float(np.max(np.asarray(frequencies)))
        return 2 * math.pi / fastest


class UserMotion(Signal):
    """A base motion of the user's: any object with ``velocity(t)`` and ``acceleration(t)``.

    It may have ``shortest_period`` (s) too; without it, give the step of the simulation. To differentiate with respect
    to its parameters, make it a pytree (an ``equinox.Module``, say); an object of another kind is a constant.
    """

    motion: Any = eqx.field(converter=lambda v: _Constant(v) if jax.tree.leaves(v) == [v] else v)

    def value(self, t: FloatArray) -> FloatArray:
        return self.motion.velocity(t)

    def rate(self, t: FloatArray) -> FloatArray:
        return self.motion.acceleration(t)

    @property
    def shortest_period(self) -> Any:
        return getattr(self.motion, "shortest_period", None)


class _Constant(eqx.Module):
    """An object that is no pytree, as a pytree without leaves."""

    held: Any = eqx.field(static=True)

    def velocity(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(self.held.velocity(t))

    def acceleration(self, t: FloatArray) -> FloatArray:
        return jnp.asarray(self.held.acceleration(t))

    @property
    def shortest_period(self) -> Any:
        return getattr(self.held, "shortest_period", None)


def _array(name: str, values: Any) -> AnyArray:
    _checks.numeric(name, values, ndim=1)
    return values if isinstance(values, jax.Array) else np.asarray(values, float)
