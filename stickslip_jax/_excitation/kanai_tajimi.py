"""Artificial accelerograms: white noise filtered through a layer of ground (Kanai 1957, Tajimi 1960)."""

import math
from functools import partial
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .. import _checks
from .._fields import Quantity
from .._numerics.elementary import log, sincos
from .._numerics.known import largest, smallest
from .._numerics.random_bits import key_data_of, random_words, uniform
from .._types import AnyArray, Array, FloatArray, Number, Scalar
from .ground import GroundAcceleration, GroundMotion
from .segments import BEGINNING, LARGEST_CAPACITY, known_number

# Gauss-Legendre nodes and weights on [-1, 1]: exact to rounding for the integrands of `_step`, over one radian or less.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)

Memory = tuple[FloatArray, FloatArray, FloatArray]


class KanaiTajimi(GroundMotion):
    """Random ground acceleration: white noise from the rock through a layer of ground, under an envelope.

    The layer is a damped oscillator on rock that shakes with white noise w(t). With x the displacement of the rock
    relative to the surface, ``x'' + 2 ground_damping ground_frequency x' + ground_frequency^2 x = w``, and the surface
    accelerates by ``ground_frequency^2 x + 2 ground_damping ground_frequency x'``, positive in the direction of w.

    The envelope is ``(t / rise)^2`` up to `rise`, then 1 for `plateau`, then ``exp(-decay (t - rise - plateau))``
    (Jennings, Housner and Tsai 1968).

    The layer is already in its stationary motion at t = 0, where the envelope is 0: so the acceleration begins with 0,
    and its standard deviation is known at every time. The normal deviates behind each step end at 6.8 (5.8 in float32)
    standard deviations. The spectrum does not vanish at frequency 0, so the ground's own velocity and displacement
    drift; motion relative to the ground is not affected.

    Args:
        rms: Standard deviation of the acceleration while the envelope is 1, m/s^2. At every time t the standard
            deviation is ``rms * envelope(t)``.
        ground_frequency: Angular frequency of the layer, rad/s; the default, 5 pi, is usual for firm soil.
        ground_damping: Its damping ratio, between 0 and 1; the default, 0.6, is usual for firm soil.
        rise: Of the envelope, s.
        plateau: Of the envelope, s; may be 0.
        decay: Of the envelope, 1/s; may be 0.
        interval: Time between samples, s, at most ``1 / ground_frequency``. The samples have exactly the covariance of
            the continuous motion, times the envelope; between them the acceleration is linear in time.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    rms: Annotated[Number, Quantity("m/s^2", "standard deviation of the ground's acceleration at its height", above=0)]
    ground_frequency: Annotated[Number, Quantity("rad/s", "of the layer", above=0)] = 5 * math.pi
    ground_damping: Annotated[
        Number, Quantity(meaning="its damping ratio", above=0, below=1, hint="firm soil has about 0.6")
    ] = 0.6
    rise: Annotated[Number, Quantity("s", "of the envelope", above=0)] = 4.0
    plateau: Annotated[Number, Quantity("s", "of the envelope", at_least=0)] = 11.0
    decay: Annotated[Number, Quantity("1/s", "of the envelope", at_least=0)] = 0.1
    interval: Annotated[Number, Quantity("s", "between samples", above=0)] = 0.01
    is_random = True
    rests_on: ClassVar = {"sample": ("draw", "next_segment")}
    only_with: ClassVar = {"spectrum": ("draw", "next_segment"), "spectral_density": ("draw", "next_segment")}

    def check_relations(self) -> None:
        if _checks.is_traced(self.interval) or _checks.is_traced(self.ground_frequency):
            return
        # Longer intervals would leave out much of the motion; and the quadrature of `_step` is exact up to here.
        longest = 1 / float(self.ground_frequency)
        if float(self.interval) > longest * (1 + 1e-6):
            raise ValueError(
                f"Argument interval must be at most 1 / ground_frequency = {longest:.4g} s, so that the samples follow "
                f"the ground, but {_checks.show(self.interval)} was given."
            )

    @property
    def spectral_density(self) -> Scalar:
        """Spectral density of the white noise in the rock, two-sided, over angular frequencies, m^2/s^3.

        White noise of density S0 gives the surface the variance
        ``pi S0 ground_frequency (1 + 4 ground_damping^2) / (2 ground_damping)``, which is ``rms^2``: x and x' are
        uncorrelated, of variances ``pi S0 / (2 ground_damping ground_frequency^3)`` and
        ``pi S0 / (2 ground_damping ground_frequency)``.
        """
        zeta = self.ground_damping
        return 2 * zeta * self.rms**2 / (math.pi * self.ground_frequency * (1 + 4 * zeta**2))

    def spectrum(self, angular_frequency: AnyArray | float) -> FloatArray:
        """The Kanai-Tajimi spectrum, m^2/s^3: the two-sided density of the continuous motion at full envelope.

        `angular_frequency` in rad/s, any shape. Its integral from minus infinity to infinity is ``rms^2``.
        """
        squared = (jnp.asarray(angular_frequency) / self.ground_frequency) ** 2
        passed = 4 * self.ground_damping**2 * squared
        return self.spectral_density * (1 + passed) / ((1 - squared) ** 2 + passed)

    def envelope(self, t: AnyArray | float) -> FloatArray:
        """Envelope of the motion at times `t` (s, any shape), between 0 and 1: the factor of the stationary motion."""
        t = jnp.asarray(t)
        growth = jnp.minimum(t / self.rise, 1)
        return growth**2 * jnp.exp(-self.decay * jnp.maximum(t - self.rise - self.plateau, 0))

    def segments(self, t1) -> int:
        return math.ceil(largest(t1) / smallest(self.interval)) + 1

    def begin(self, key_data, dtype) -> Memory:
        return *_normal_pair(key_data, jnp.asarray(BEGINNING), dtype), jnp.zeros((), dtype)

    def draw(self, key_data, number, dtype):
        # Differences of the sampling times, not the interval: added up, they stay on those times even in float32.
        interval = jnp.asarray(self.interval, dtype)
        begin, end = number.astype(dtype) * interval, (number.astype(dtype) + 1) * interval
        return *_normal_pair(key_data, number, dtype), end, end - begin

    def next_segment(self, memory: Memory, drawn, dtype):
        """Memory: x and x' in units of their standard deviations, and the acceleration (m/s^2) at the beginning."""
        x, v, value = memory
        one, other, end, duration = drawn
        transition, noise = _step(self.ground_frequency, self.ground_damping, self.interval, dtype)
        x, v = (
            transition[0][0] * x + transition[0][1] * v + noise[0] * one,
            transition[1][0] * x + transition[1][1] * v + noise[1] * one + noise[2] * other,
        )
        twice = 2 * self.ground_damping
        filtered = (x + twice * v) * (self.rms / jnp.sqrt(1 + twice * twice))
        following = (filtered * self.envelope(end)).astype(dtype)
        return duration, value, (following - value) / duration, (x, v, following)

    def sample(  # pyright: ignore[reportIncompatibleMethodOverride] - points, which are one more than segments
        self, key: Array, t1: Scalar, *, points: int | None = None
    ) -> GroundAcceleration:
        """One realisation that covers ``[0, t1]``: the motion that a simulation of this law draws from the same key.

        Args:
            key: A key from ``jax.random.key(seed)``.
            t1: Duration to cover, s.
            points: Number of samples, `interval` apart from t = 0; by default as many as cover `t1`. More continue the
                same motion. They must be given under ``jit`` or ``grad`` when `t1` or the law's `interval` is traced.

        Raises:
            ValueError: For an unsuitable key, a `t1` that is not positive or is too long, fewer than 2 points.
        """
        _checks.positive("t1", t1, "s")
        if points is None:
            points = self._points(t1)
        points = _checks.whole_number("points", points, minimum=2, maximum=LARGEST_CAPACITY)
        return GroundAcceleration(*_sample(self, key_data_of(key), points, jnp.result_type(float)))

    def _points(self, t1: Scalar) -> int:
        enough = "about t1 / interval + 2 are enough"
        samples = known_number(
            lambda t1: largest(t1) / smallest(self.interval), t1, enough, "points", "law's interval is"
        )
        if samples > LARGEST_CAPACITY - 2:
            raise ValueError(
                f"Argument t1 must be shorter: {t1} s hold more than {LARGEST_CAPACITY} samples, "
                f"{self.interval} s apart."
            )
        # Both ends, and one to spare: rounded, the last sampling time may lie just short of t1.
        return math.ceil(samples) + 2


def _step(ground_frequency, damping, interval, dtype):
    """Transition of the layer over one interval, x and x' in units of their stationary standard deviations.

    Returns the transition matrix as two rows, and the lower triangle of the Cholesky factor of the noise covariance as
    ``(11, 21, 22)``. The covariance of the noise is ``I - transition transition^T``, since the stationary one is I. It
    is computed by integrals of positive functions, so that nothing cancels when the interval is short.
    """
    angle = jnp.asarray(ground_frequency * interval, dtype)
    zeta = jnp.asarray(damping, dtype)
    root = jnp.asarray(jnp.sqrt((1 - damping) * (1 + damping)), dtype)

    def response(angle):
        """Impulse response, x and x', to an impulse that sets x' to 1."""
        fade, ratio = jnp.exp(-zeta * angle), angle * jnp.sinc(root * angle / np.pi)
        return fade * ratio, fade * (jnp.cos(root * angle) - zeta * ratio)

    x, v = response(angle)
    x_before, v_before = response(angle * jnp.asarray((_NODES + 1) / 2, dtype))
    weights = 4 * zeta * angle * jnp.asarray(_WEIGHTS / 2, dtype)
    var_x, var_v = jnp.sum(weights * x_before**2), jnp.sum(weights * v_before**2)
    of_x = jnp.sqrt(var_x)
    shared = 2 * zeta * x**2 / of_x  # the covariance is 2 zeta x^2: x' is the derivative of x
    return ((v + 2 * zeta * x, x), (-x, v)), (of_x, shared, jnp.sqrt(var_v - shared**2))


def _normal_pair(key_data, number: Array, dtype) -> tuple[FloatArray, FloatArray]:
    """Two independent standard normal deviates from the random words of `number` (Box and Muller 1958)."""
    high, low = random_words(key_data, number)
    radius = jnp.sqrt(-2 * log(uniform(high, dtype)))
    sine, cosine = sincos(uniform(low, dtype) * np.asarray(2 * np.pi, dtype))
    return radius * cosine, radius * sine


@partial(jax.jit, static_argnames=("points", "dtype"))
def _sample(law: KanaiTajimi, key_data: Array, points: int, dtype) -> tuple[FloatArray, FloatArray]:
    """Times and accelerations of the first `points` samples."""
    numbers = jnp.arange(points, dtype=jnp.uint32)
    drawn = jax.vmap(lambda number: law.draw(key_data, number, dtype))(numbers)

    def step(memory, drawn_here):
        _, value, _, memory = law.next_segment(memory, drawn_here, dtype)
        return memory, value

    _, accelerations = lax.scan(step, law.begin(key_data, dtype), drawn)
    return numbers.astype(dtype) * jnp.asarray(law.interval, dtype), accelerations
