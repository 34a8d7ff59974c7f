"""Power spectral densities of stationary random motions.

All are one-sided and over angular frequencies: the variance of the motion is the integral from 0 to infinity.
"""

import abc
import math
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Annotated, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from .. import _checks
from .._fields import Checked, Quantity, described, varies
from .._types import AnyArray, Float, Number, Scalar

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
        values = [(getattr(self, name), about) for name, about in described(type(self)).items()]
        return any(varies(value, about) for value, about in values)


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


class CloughPenzienSpectrum(PowerSpectrum):
    """The Kanai-Tajimi spectrum without the low frequencies, so that velocities are finite (Clough and Penzien 1975).

    The density of `KanaiTajimiSpectrum` times ``w^4 / ((w_f^2 - w^2)^2 + 4 z_f^2 w_f^2 w^2)``, with w_f the
    `filter_frequency` and z_f the `filter_damping`: the density of the acceleration of the surface. That of its
    velocity is ``VelocitySpectrum(CloughPenzienSpectrum(...))``.

    Args:
        intensity: As in `KanaiTajimiSpectrum`, m^2/s^3 for an acceleration.
        ground_frequency: As in `KanaiTajimiSpectrum`, rad/s.
        ground_damping: As in `KanaiTajimiSpectrum`.
        filter_frequency: Angular frequency below which the motion fades, rad/s; by default a tenth of 5 pi.
        filter_damping: Damping ratio of the filter.

    Raises:
        ValueError: For numbers that are not positive.
    """

    intensity: Annotated[Number, Quantity("m^2/s^3", "one-sided density of the white noise", above=0)] = 1.0
    ground_frequency: Annotated[Number, Quantity("rad/s", "of the layer", above=0)] = 5 * math.pi
    ground_damping: Annotated[Number, Quantity(meaning="its damping ratio", above=0)] = 0.6
    filter_frequency: Annotated[Number, Quantity("rad/s", "of the filter", above=0)] = 0.5 * math.pi
    filter_damping: Annotated[Number, Quantity(meaning="damping ratio of the filter", above=0)] = 0.6

    def density(self, angular_frequency: Frequencies) -> Frequencies:
        layer = KanaiTajimiSpectrum(self.intensity, self.ground_frequency, self.ground_damping)
        squared = (angular_frequency / self.filter_frequency) ** 2
        passed = squared**2 / ((1 - squared) ** 2 + 4 * self.filter_damping**2 * squared)
        return layer.density(angular_frequency) * passed


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

    @property
    def varies(self) -> bool:
        return self.acceleration.varies


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
        converter=partial(_checks.real_array, "angular_frequencies")
    )
    densities: Annotated[PerPoint, Quantity("m^2/s", "one-sided", at_least=0, ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "densities")
    )

    def check_relations(self) -> None:
        frequencies, densities = self.angular_frequencies, self.densities
        if np.shape(frequencies) != np.shape(densities) or len(frequencies) < 2:
            raise ValueError(
                "Arguments angular_frequencies and densities must have the same length of at least 2, but they have "
                f"shapes {np.shape(frequencies)} and {np.shape(densities)}."
            )
        if not _checks.is_traced(frequencies) and np.any(np.diff(np.asarray(frequencies)) <= 0):
            raise _checks.refused("angular_frequencies", "increase", np.asarray(frequencies))

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
            f"densities) or a function of angular frequency, but {_checks.show(given)} was given."
        )
    # A plain function is no pytree: JAX is to take it as a constant.
    return _UserSpectrum(Partial(given) if jax.tree.leaves(given) == [given] else given)
