"""Stationary Gaussian motions with a given power spectrum, as sums of harmonics."""

import math
from types import ModuleType
from typing import Annotated, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._fields import Quantity
from .._numerics.random_bits import fine_uniform, random_words, uniform
from .._types import AnyArray, Array, Float, FloatArray, KeyData, Number, Scalar
from .random import RandomSignal
from .smooth import SumOfHarmonics
from .spectra import PowerSpectrum, spectrum_of

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
        static=True, default=128, converter=lambda v: _checks.whole_number("harmonics", v, maximum=2**20)
    )
    only_with: ClassVar = {"variance": ("realized",), "spectral_density": ("realized",), "covariance": ("realized",)}

    def check_relations(self) -> None:
        if self.spectrum.varies or any(map(_checks.is_traced, jax.tree.leaves((self.spectrum, self.cutoff)))):
            return
        with jax.ensure_compile_time_eval(), np.errstate(all="ignore"):  # what is not finite is refused below
            coarse, fine = (np.asarray(self._band(np, rule).variances, float) for rule in _RULES)
        if not (np.all(np.isfinite(fine)) and np.all(fine >= 0) and fine.sum() > 0):
            raise _checks.refused(
                "spectrum", "be finite and zero or positive up to the cutoff, and not zero everywhere", self.spectrum
            )
        if np.abs(fine - coarse).sum() > _LARGEST_ERROR * fine.sum():
            raise ValueError(
                f"Argument spectrum must vary little within a {_PARTS}th of the cutoff, "
                f"{float(self.cutoff) / _PARTS:.3g} rad/s, and fade towards 0 if it is a VelocitySpectrum, but "
                f"{_checks.show(self.spectrum)} was given; lower the cutoff, or give a TabulatedSpectrum."
            )

    @property
    def variance(self) -> Scalar:
        """The variance: the integral of the spectrum up to the cutoff, or ``rms^2``."""
        return self._of_spectrum if self.rms is None else self.rms**2

    @property
    def shortest_period(self) -> Scalar:
        return 2 * math.pi / self.cutoff

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
        _checks.positive("t1", t1, "s")
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
