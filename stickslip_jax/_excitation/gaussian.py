"""Random motions by their spectrum: stationary Gaussian ones, and artificial accelerograms."""

import abc
import math
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Annotated, ClassVar, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._foundation import checks
from .._foundation.fields import Checked, Quantity, varies_within
from .._foundation.types import AnyArray, FloatArray, KeyData, Number, Scalar
from .._numerics.derivatives import largest, smallest
from .._numerics.elementary import fine_uniform, key_data_of, log, random_words, sincos, uniform
from .motion import RandomSignal, SumOfHarmonics
from .recorded import GroundAcceleration, GroundMotion
from .segments import BEGINNING, LARGEST_CAPACITY, drawn_segments, known_number

# Power spectral densities of stationary random motions.
#
# All are one-sided and over angular frequencies: the variance of the motion is the integral from 0 to infinity.


PerPoint: TypeAlias = Float[AnyArray, " points"]

Frequencies: TypeAlias = Float[AnyArray, "..."] | float
"""Angular frequencies, rad/s, or densities at these, of NumPy or JAX."""


class PowerSpectrum(Checked):
    """Base class of one-sided power spectral densities over angular frequency. Subclass it to add one.

    The unit is the squared unit of the motion times s: m^2/s for a velocity, m^2/s^3 for an acceleration.
    """

    @abc.abstractmethod
    def density(self, angular_frequency: Frequencies) -> Frequencies:
        """The density at each of these angular frequencies, rad/s, positive, any shape; zero or positive."""

    def edges(self, cutoff: Scalar, parts: int, numpy: ModuleType) -> Float[AnyArray, " edges"]:
        """Edges of about so many parts of ``[0, cutoff]`` in which the density is smooth, rad/s, (edges,).

        `numpy`: NumPy or ``jax.numpy``, whose functions to use.
        """
        return numpy.asarray(cutoff * (np.arange(parts + 1) / parts), float)

    @property
    def varies(self) -> bool:
        """Whether one of its numbers differs from sample to sample of an ensemble."""
        return varies_within(self)


class KanaiTajimiSpectrum(PowerSpectrum):
    """White noise of the rock, filtered through a layer of ground (Kanai 1957, Tajimi 1960).

    ``intensity (w_g^4 + 4 z_g^2 w_g^2 w^2) / ((w_g^2 - w^2)^2 + 4 z_g^2 w_g^2 w^2)``, with w_g the `ground_frequency`
    and z_g the `ground_damping`: the density of the acceleration of the surface.

    Args:
        intensity: One-sided density of the white noise, m^2/s^3 for an acceleration.
        ground_frequency: Angular frequency of the layer, rad/s; the default, 5 pi, is usual for firm soil.
        ground_damping: Its damping ratio; the default, 0.6, is usual for firm soil.

    Raises:
        ValueError: For numbers that are not positive.
    """

    intensity: Annotated[Number, Quantity("m^2/s^3", "one-sided density of the white noise", above=0)] = 1.0
    ground_frequency: Annotated[Number, Quantity("rad/s", "of the layer", above=0)] = 5 * math.pi
    ground_damping: Annotated[Number, Quantity(meaning="its damping ratio", above=0)] = 0.6

    def density(self, angular_frequency: Frequencies) -> Frequencies:
        squared = (angular_frequency / self.ground_frequency) ** 2
        passed = 4 * self.ground_damping**2 * squared
        return self.intensity * (1 + passed) / ((1 - squared) ** 2 + passed)


class CloughPenzienSpectrum(KanaiTajimiSpectrum):
    """The Kanai-Tajimi spectrum without the low frequencies, so that velocities are finite (Clough and Penzien 1975).

    The density of `KanaiTajimiSpectrum` times ``w^4 / ((w_f^2 - w^2)^2 + 4 z_f^2 w_f^2 w^2)``, with w_f the
    `filter_frequency` and z_f the `filter_damping`: the density of the acceleration of the surface. That of its
    velocity is ``VelocitySpectrum(CloughPenzienSpectrum(...))``.

    Args:
        intensity: One-sided density of the white noise, m^2/s^3 for an acceleration.
        ground_frequency: Angular frequency of the layer of ground, rad/s.
        ground_damping: Damping ratio of the layer of ground.
        filter_frequency: Angular frequency below which the motion fades, rad/s; by default a tenth of 5 pi.
        filter_damping: Damping ratio of the filter.

    Raises:
        ValueError: For numbers that are not positive.
    """

    filter_frequency: Annotated[Number, Quantity("rad/s", "of the filter", above=0)] = 0.5 * math.pi
    filter_damping: Annotated[Number, Quantity(meaning="damping ratio of the filter", above=0)] = 0.6

    def density(self, angular_frequency: Frequencies) -> Frequencies:
        squared = (angular_frequency / self.filter_frequency) ** 2
        passed = squared**2 / ((1 - squared) ** 2 + 4 * self.filter_damping**2 * squared)
        return super().density(angular_frequency) * passed


class VelocitySpectrum(PowerSpectrum):
    """The density of the velocity of a motion whose acceleration has the density `acceleration`: that over ``w^2``.

    Args:
        acceleration: A `PowerSpectrum` that fades towards frequency 0, such as `CloughPenzienSpectrum`, or a function
            of angular frequency.

    Raises:
        ValueError: For anything else.
    """

    acceleration: PowerSpectrum = eqx.field(converter=lambda v: spectrum_of("acceleration", v))

    def density(self, angular_frequency: Frequencies) -> Frequencies:
        return self.acceleration.density(angular_frequency) / angular_frequency**2

    def edges(self, cutoff: Scalar, parts: int, numpy: ModuleType) -> Float[AnyArray, " edges"]:
        return self.acceleration.edges(cutoff, parts, numpy)


class TabulatedSpectrum(PowerSpectrum):
    """A density that is given at some frequencies, linear between them and zero outside.

    Densities over frequencies in Hz are to be divided by 2 pi, and two-sided ones multiplied by 2.

    Args:
        angular_frequencies: rad/s, increasing, the first one zero or positive, (points,), at least 2.
        densities: As many, zero or positive; m^2/s for a velocity.

    Raises:
        ValueError: For frequencies that do not increase, different lengths, or densities that are negative.
    """

    angular_frequencies: Annotated[PerPoint, Quantity("rad/s", "increasing", at_least=0, ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "angular_frequencies")
    )
    densities: Annotated[PerPoint, Quantity("m^2/s", "one-sided", at_least=0, ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "densities")
    )

    def check_relations(self) -> None:
        frequencies, densities = self.angular_frequencies, self.densities
        checks.same_length(2, angular_frequencies=frequencies, densities=densities)
        if not checks.is_traced(frequencies) and np.any(np.diff(np.asarray(frequencies)) <= 0):
            raise checks.refused("angular_frequencies", "increase", np.asarray(frequencies))

    def density(self, angular_frequency: Frequencies) -> Frequencies:
        frequencies, densities = self.angular_frequencies, self.densities
        known = all(isinstance(values, np.ndarray) for values in (angular_frequency, frequencies, densities))
        return (np if known else jnp).interp(angular_frequency, frequencies, densities, left=0, right=0)

    def edges(self, cutoff: Scalar, parts: int, numpy: ModuleType) -> Float[AnyArray, " edges"]:
        frequencies = numpy.asarray(self.angular_frequencies, float)
        each = -(-parts // (len(frequencies) - 1))
        inside = (frequencies[1:] - frequencies[:-1])[:, None] * (np.arange(each) / each)[None]
        every = numpy.concatenate([(frequencies[:-1, None] + inside).reshape(-1), frequencies[-1:]])
        return numpy.clip(every, 0, cutoff)


class _UserSpectrum(PowerSpectrum):
    """A function of angular frequency as a spectrum."""

    function: Callable[[Scalar], Number]
    holds_users_code = True

    def density(self, angular_frequency: Frequencies) -> Frequencies:
        values = jnp.asarray(angular_frequency, float)
        return jnp.asarray(jax.vmap(self.function)(values.reshape(-1)), values.dtype).reshape(values.shape)


def spectrum_of(name: str, given: object) -> PowerSpectrum:
    """The argument called `name` as a spectrum. Raises ValueError for what is no spectrum and no function."""
    if isinstance(given, PowerSpectrum):
        return given
    if not callable(given) or isinstance(given, type):
        raise ValueError(
            f"Argument {name} must be a spectrum such as CloughPenzienSpectrum(), a TabulatedSpectrum(frequencies, "
            f"densities) or a function of angular frequency, but {checks.show(given)} was given."
        )
    # A plain function is no pytree: JAX is to take it as a constant.
    return _UserSpectrum(Partial(given) if jax.tree.leaves(given) == [given] else given)


# Stationary Gaussian motions with a given power spectrum, as sums of harmonics.


_PARTS = 1024  # of the band: each has its exact share of the variance, and inside it the spectrum is taken as constant
# Gauss-Legendre nodes and weights on [0, 1]: exact for polynomials of degree 7; and twice as many, to check them.
_RULES = [((nodes + 1) / 2, weights / 2) for nodes, weights in map(np.polynomial.legendre.leggauss, (4, 8))]
_LARGEST_ERROR = 1e-3  # of the variance, by the spectrum's variation inside the parts of the band
_STREAM = np.uint32(0xFFFFFF00)  # number of the random words that the key data of the harmonics are


class _Band(NamedTuple):
    """The parts of the band: their edges, rad/s, (parts + 1,), and the variance of each, (parts,)."""

    edges: Float[AnyArray, " edges"]
    variances: Float[AnyArray, " parts"]


class GaussianSample(SumOfHarmonics):
    """A realisation of a `GaussianProcess`, whose `cutoff` (rad/s) is above all frequencies that were drawn.

    The time step follows the cutoff, so that it is the same for all samples.
    """

    cutoff: Number = None

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.cutoff


class GaussianProcess(RandomSignal):
    """A stationary Gaussian base velocity (or motion in general) with a given power spectrum.

    A sample is ``mean + sum_j a_j cos(w_j t + phase_j)`` with random phases, amplitudes of Rayleigh's distribution, and
    frequencies of which one is drawn, by the density, from each of as many strata of equal variance. So whatever their
    number, the value at any time is exactly Gaussian, variance and correlation are those of the spectrum (except that
    it is constant inside each of 1024 parts of the band), and no sample repeats itself. (With evenly spaced frequencies
    it would, after ``2 pi harmonics / cutoff``: Shinozuka and Deodatis 1991.)

    The number of harmonics bounds how far values at different times are from being jointly Gaussian: the correlation at
    a lag differs from sample to sample by a standard deviation of at most ``1 / sqrt(harmonics)``, and fourth moments
    are wrong by at most ``3 variance^2 / harmonics``. Averages over a long sample vary too much from sample to sample
    with fewer than ``enough_harmonics(t1)``. The time of a simulation grows nearly in proportion to the number.

    Derivatives of stick counts and durations by what moves the frequencies (`cutoff`, parameters of `spectrum`): take
    ``sensitivity(..., estimator="finite-difference")``, the default, because phases grow with time and the corrected
    estimator would need narrow windows.

    Args:
        spectrum: The one-sided power spectral density over angular frequency, m^2/s for a base velocity: a
            `CloughPenzienSpectrum`, `VelocitySpectrum`, `KanaiTajimiSpectrum`, `TabulatedSpectrum`, or a function of
            angular frequency (rad/s) that JAX can trace, such as ``lambda w: 0.1 * jnp.exp(-(w**2))``.
        cutoff: The highest angular frequency, rad/s; the spectrum is cut off there. The time step of a simulation is a
            fraction of its period, ``2 pi / cutoff``, so let the spectrum have faded there, but no lower.
        rms: Standard deviation, m/s for a base velocity. None (the default) leaves the spectrum as it is, and the
            variance is its integral up to `cutoff`; a number scales it.
        mean: The mean, m/s.
        harmonics: The number of harmonics of a sample, 128 by default.

    Raises:
        ValueError: For numbers outside these bounds, a spectrum that is negative, zero or infinite, or one that varies
            so quickly that 1024 parts of the band do not resolve it.
    """

    spectrum: PowerSpectrum = eqx.field(converter=lambda v: spectrum_of("spectrum", v))
    cutoff: Annotated[Number, Quantity("rad/s", "the highest angular frequency", above=0)]
    rms: Annotated[Number | None, Quantity("m/s", "standard deviation; not given: that of the spectrum", above=0)] = (
        None
    )
    mean: Annotated[Number, Quantity("m/s", "the mean")] = 0.0
    harmonics: int = eqx.field(
        static=True, default=128, converter=lambda v: checks.whole_number("harmonics", v, maximum=2**20)
    )
    only_with: ClassVar = {"variance": ("realized",), "spectral_density": ("realized",), "covariance": ("realized",)}

    def check_relations(self) -> None:
        if self.spectrum.varies or any(map(checks.is_traced, jax.tree.leaves((self.spectrum, self.cutoff)))):
            return
        with jax.ensure_compile_time_eval(), np.errstate(all="ignore"):  # what is not finite is refused below
            coarse, fine = (np.asarray(self._band(np, rule).variances, float) for rule in _RULES)
        if not (np.all(np.isfinite(fine)) and np.all(fine >= 0) and fine.sum() > 0):
            demand = "be finite and zero or positive up to the cutoff, and not zero everywhere"
            raise checks.refused("spectrum", demand, self.spectrum)
        if np.abs(fine - coarse).sum() > _LARGEST_ERROR * fine.sum():
            raise ValueError(
                f"Argument spectrum must vary little within a {_PARTS}th of the cutoff, "
                f"{float(self.cutoff) / _PARTS:.3g} rad/s, and fade towards 0 if it is a VelocitySpectrum, but "
                f"{checks.show(self.spectrum)} was given; lower the cutoff, or give a TabulatedSpectrum."
            )

    @property
    def variance(self) -> Scalar:
        """The variance: the integral of the spectrum up to the cutoff, or ``rms^2``."""
        return self._of_spectrum if self.rms is None else self.rms**2

    shortest_period = GaussianSample.shortest_period  # pyright: ignore[reportIncompatibleMethodOverride] - of another class

    def spectral_density(self, angular_frequency: AnyArray | float) -> FloatArray:
        """The one-sided density at these angular frequencies (rad/s, any shape); zero from the cutoff on."""
        frequency = jnp.asarray(angular_frequency, float)
        inside = (frequency >= 0) & (frequency < self.cutoff)
        density = self.spectrum.density(jnp.where(inside, frequency, 0.5 * jnp.asarray(self.cutoff, float)))
        return jnp.where(inside, density * (self.variance / self._of_spectrum), 0)

    def covariance(self, lag: AnyArray | float) -> FloatArray:
        """The covariance of values `lag` (s, any shape) apart: the integral of the density times ``cos(w lag)``."""
        edges, variances = self._band(jnp)
        half, middle = (edges[1:] - edges[:-1]) / 2, (edges[1:] + edges[:-1]) / 2
        lag = jnp.asarray(lag, float)[..., None]
        shape = (1,) * (lag.ndim - 1) + (-1,)
        half, middle, variances = (values.reshape(shape) for values in (half, middle, variances))
        # The mean of cos(w lag) over a part of the band.
        parts = variances * jnp.cos(middle * lag) * jnp.sinc(half * lag / np.pi)
        return jnp.sum(parts, axis=-1) * (self.variance / self._of_spectrum)

    def enough_harmonics(self, t1: Scalar) -> int:
        """The number of harmonics with which averages over ``[0, t1]`` (s) vary from sample to sample as they should.

        The width of the band, ``variance^2 / integral of density^2``, holds ``width t1 / (2 pi)`` frequencies that can
        be told apart in the time t1. Twice as many harmonics lie closer together than that: the mean square of a
        sample then has a variance that is about a tenth too large; with a quarter of them it would be doubled.
        """
        checks.positive("t1", t1, "s")
        edges, variances = self._band(jnp)
        widths = edges[1:] - edges[:-1]
        squared = jnp.sum(jnp.where(widths > 0, variances**2 / jnp.where(widths > 0, widths, 1), 0))
        return math.ceil(float(jnp.sum(variances) ** 2 / squared) * float(t1) / math.pi)

    def realized(self, key_data: KeyData, dtype) -> GaussianSample:
        words, number = random_words(key_data, jnp.asarray(_STREAM)), self.harmonics
        strata = jnp.arange(number, dtype=jnp.uint32)
        for_amplitude = fine_uniform(*random_words(words, 2 * strata), dtype)
        for_phase, inside = (uniform(bits, dtype) for bits in random_words(words, 2 * strata + np.uint32(1)))
        edges, variances = self._band(jnp)
        below = jnp.concatenate([jnp.zeros(1, variances.dtype), jnp.cumsum(variances)])
        share = (strata.astype(dtype) + inside) / number
        frequencies = jnp.interp(share * below[-1].astype(dtype), below.astype(dtype), edges.astype(dtype))
        variance = below[-1] if self.rms is None else self.rms**2
        # Each has an equal share of the variance, the mean of amplitude^2 / 2.
        amplitudes = jnp.sqrt(-2 * jnp.asarray(variance / number, dtype) * jnp.log(for_amplitude))
        phases, cutoff = 2 * np.pi * for_phase, jnp.asarray(self.cutoff, dtype)
        return GaussianSample(amplitudes, frequencies, phases, jnp.asarray(self.mean, dtype), cutoff)

    @property
    def _of_spectrum(self) -> Array:
        """The integral of the spectrum up to the cutoff."""
        return jnp.sum(self._band(jnp).variances)

    def _band(self, numpy: ModuleType, rule: tuple[np.ndarray, np.ndarray] = _RULES[0]) -> _Band:
        """The parts of the band, integrated by the `rule` on [0, 1] with the functions of `numpy`, NumPy or JAX."""
        edges = self.spectrum.edges(self.cutoff, _PARTS, numpy)
        begins, widths = edges[:-1], edges[1:] - edges[:-1]
        # No array of all nodes: its sums along one axis would not compile into a native loop.
        rates = [w * self.spectrum.density(begins + widths * node) for node, w in zip(*rule, strict=True)]
        return _Band(edges, widths * sum(rates))


# Artificial accelerograms: white noise filtered through a layer of ground (Kanai 1957, Tajimi 1960).


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
        if checks.is_traced(self.interval) or checks.is_traced(self.ground_frequency):
            return
        # Longer intervals would leave out much of the motion; and the quadrature of `_step` is exact up to here.
        longest = 1 / float(self.ground_frequency)
        if float(self.interval) > longest * (1 + 1e-6):
            raise ValueError(
                f"Argument interval must be at most 1 / ground_frequency = {longest:.4g} s, so that the samples follow "
                f"the ground, but {checks.show(self.interval)} was given."
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
        checks.positive("t1", t1, "s")
        if points is None:
            enough = "about t1 / interval + 2 are enough"
            # Both ends, and one to spare: rounded, the last sampling time may lie just short of t1.
            points = known_number(self.segments, t1, enough, "points", "law's interval is") + 1
            if points > LARGEST_CAPACITY:
                raise ValueError(
                    f"Argument t1 must be shorter: {t1} s hold more than {LARGEST_CAPACITY} samples, "
                    f"{self.interval} s apart."
                )
        points = checks.whole_number("points", points, minimum=2, maximum=LARGEST_CAPACITY)
        dtype = jnp.result_type(float)
        _, accelerations, _ = drawn_segments(self, key_data_of(key), points, dtype)
        return GroundAcceleration(jnp.arange(points).astype(dtype) * jnp.asarray(self.interval, dtype), accelerations)


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
