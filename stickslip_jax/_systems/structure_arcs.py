"""A linear structure whose modes are linear with constant coefficients: their motion as power series."""

from functools import reduce
from operator import add
from typing import ClassVar, NamedTuple, cast

import jax.numpy as jnp
import numpy as np

from .._excitation.smooth import Harmonic, SumOfHarmonics
from .._numerics.small_matrices import WRITTEN_OUT, dense, times
from .._types import FloatArray, FloatScalar, State
from .contact_forces import acceleration, holding, solved
from .contacts_model import InMode
from .normal_force import power_series_of, rates_at
from .structure_model import Matrices, StructureForcing, StructureModel, in_dtype

# Terms that reach round-off in the longest steps allowed, a tenth of the shortest period: a term is at most r^k / k!,
# r = 0.63 without damping, and with it 1.02 (where the decay rate is as high as the frequency).
_TERMS = {8: (16, 18), 4: (10, 11)}


class ArcsModel(StructureModel):
    """A `StructureModel` with constant friction coefficients, whose excitation is piecewise linear or harmonic.

    Each mode is linear then, with constant coefficients: a step is the power series of its solution, summed to
    round-off, for any damping and with masses that no spring holds.
    """

    has_kinks: ClassVar[bool] = False

    def flow_and_error(
        self, forcing: StructureForcing, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, None]:
        of, sticks = self._in_precision_of(y), self._own(sign) == 0
        terms = _TERMS[h.dtype.itemsize][of.damping is not None]
        held = _Held(of, holding(of.gain, sticks))
        sources = self._sources(held, forcing, y, sign, terms)
        stiffness, damping, in_terms = of.stiffness, of.damping, len(y[0]) > WRITTEN_OUT
        if not in_terms:  # few masses: to hold the matrices costs less than to hold each term of the series
            stiffness, damping = held(dense(stiffness)), None if damping is None else held(dense(damping))
        x, v, power = [y[0]], [y[1]], jnp.ones_like(h)
        for k, source in enumerate(sources):
            pull = times(stiffness, x[k])
            if damping is not None:
                pull = pull + times(damping, v[k])
            rate = -(held(pull) if in_terms else pull)
            if source is not None:
                rate = rate + power * source
            share = (1 / (k + 1)) * h
            x.append(share * v[k])
            v.append(share * rate)
            power = power * h
        reached = tuple(reduce(add, reversed(series)) for series in (x, v))
        return self._held(forcing, h, reached, sticks), None

    def _sources(
        self, held: "_Held", forcing: StructureForcing, y: State, sign: FloatArray, terms: int
    ) -> list[FloatArray | None]:
        """The coefficients in the power series of accelerations (masses,) that do not depend on the state."""
        t, of, none = forcing.t, held.of, jnp.zeros_like(forcing.t)
        # Constant friction coefficients: at any relative velocity.
        share = self._closed(self.limits_under(jnp.ones_like(of.on_base), jnp.zeros_like(of.on_base)), sign)
        slip = share.slip(self._own(sign))
        normal = power_series_of(self.structure.normal_forces, t, forcing.normal, forcing.normal_slope, terms)
        load = power_series_of(self.structure.force or (), t, forcing.load, forcing.load_slope, terms)
        base: tuple[FloatArray | None, ...] = (None,) * (terms + 1)
        if self.smooth is not None:
            base = cast(Harmonic | SumOfHarmonics, self.smooth).power_series(t, terms + 1)
        sources: list[FloatArray | None] = []
        for k, (of_normal, of_load, of_base) in enumerate(zip(normal, load, base[1:], strict=True)):
            parts = [] if of_normal is None else [-times(of.by_force, slip * of_normal)]
            if k < 2:
                parts.append(jnp.full_like(y[0], -(forcing.ground_slope if k else forcing.ground)))
            if of_load is not None:
                parts.append(times(of.inverse_mass, of_load))
            found = [held(reduce(add, parts))] if parts else []
            # The sticks follow the base.
            following = none if of_base is None else (k + 1) * of_base
            if k == 0 or of_base is not None:
                found.append(held.by(of.on_base * (following + (forcing.base_slope if k == 0 else none))))
            sources.append(reduce(add, found) if found else None)
        return sources

    def in_mode(self, forcing: StructureForcing, tau: FloatScalar, y: State, sign: FloatArray) -> tuple[InMode, InMode]:
        of, own, sticks = self._in_precision_of(y), self._own(sign), self._own(sign) == 0
        now = self.instant(forcing, tau, y)
        normal, normal_rate = self._normal_forces(forcing, tau), self._normal_rates(forcing, tau)
        limits, changing = (
            self._closed(self.limits_under(forces, now.velocity), sign) for forces in (normal, normal_rate)
        )
        force = solved(now.gain, now.drift, limits.slip(own), sticks)
        moving = now.rates[1] - times(of.by_force, force)
        pull = self._load_rate(forcing, tau) - times(of.stiffness, y[1])
        if of.damping is not None:
            pull = pull - times(of.damping, moving)
        drift = times(of.directions, pull)
        if self.smooth is not None:
            drift = drift - of.on_base * self.smooth.curvature(forcing.t + tau)
        rate = solved(now.gain, drift, changing.slip(own), sticks)
        velocity = acceleration(now.gain, now.drift, force)
        (middle, limit), (middle_rate, limit_rate) = (forces.band(force) for forces in (limits, changing))
        return (
            InMode(now.velocity, force - middle, limit, self._varying(normal)),
            InMode(velocity, rate - middle_rate, limit_rate, self._varying(normal_rate)),
        )

    def _varying(self, normal: FloatArray) -> FloatArray | None:
        return normal[np.array(self.varying)] if self.varying else None

    def _normal_rates(self, forcing: StructureForcing, tau: FloatScalar) -> FloatArray:
        return rates_at(self.structure.normal_forces, forcing.t + tau, forcing.normal_slope)

    def _load_rate(self, forcing: StructureForcing, tau: FloatScalar) -> FloatArray:
        """The rate of what ground and external forces do to each mass, m/s^3."""
        load = jnp.full((self.structure.size,), -forcing.ground_slope)
        if self.structure.force is None:
            return load
        applied = rates_at(self.structure.force, forcing.t + tau, forcing.load_slope)
        return load + times(in_dtype(self.matrices.inverse_mass, load.dtype), applied)


class _Held(NamedTuple):
    """A structure whose sticks are held by friction; `hold`: see `holding`."""

    of: Matrices
    hold: FloatArray

    def __call__(self, accelerations: FloatArray) -> FloatArray:
        """`accelerations` (masses,) or (masses, masses) without what the friction of sticks takes away."""
        return accelerations - self.by(times(self.of.directions, accelerations))

    def by(self, relative: FloatArray) -> FloatArray:
        """What the friction of sticks does, where they would have these `relative` accelerations (contacts, ...)."""
        if self.hold.ndim > 1:
            return times(self.of.by_force, times(self.hold, relative))
        return times(self.of.by_force, self.hold * relative if relative.ndim == 1 else self.hold[:, None] * relative)
