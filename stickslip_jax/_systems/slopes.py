"""Slopes, dams and landfills that slide under earthquakes: Newmark's rigid block, and blocks of flexible soil."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiler.programs import kept_jit
from .._excitation.recorded import GroundAcceleration
from .._foundation import checks
from .._foundation.fields import Quantity
from .._foundation.types import Number
from .._numerics.elementary import responses
from .builders import STANDARD_GRAVITY
from .contacts import Contact
from .friction import Coulomb, FrictionLaw, require_law
from .mass_spring import MassSpring
from .places import Directional, OneWay
from .structure import STOREYS, LinearStructure

_HELD = 100.0  # accelerations of gravity: a block that never slides uphill is held against so much
_MOST_MODES = 20


def rigid_block(
    yield_coefficient: Any = None,
    *,
    uphill: Any = None,
    friction: FrictionLaw | None = None,
    slope: Number = 0.0,
    mass: Number = 1.0,
    gravity: Number = STANDARD_GRAVITY,
) -> MassSpring:
    """Newmark's rigid block on a slope, which slides while the ground accelerates by more than it can hold.

    N. M. Newmark, "Effects of earthquakes on dams and embankments", Geotechnique 15 (1965). Its position is relative to
    the ground, and counted down the slope, as is the `GroundAcceleration` to simulate it with: the block slides down
    while the ground accelerates up the slope, so that a record of accelerations up the slope, as SLAMMER's, is to be
    given with the other sign (`newmark_displacements` takes it as it is).

    Args:
        yield_coefficient: The ground acceleration, over that of gravity, above which the block slides down: a positive
            number, a distribution, or an array with one for each sample of an ensemble.
        uphill: Above which it slides up, likewise; None: it never does.
        friction: In place of both, the friction law of the block on its slope, such as ``Coulomb(0.6)``. With the
            coefficient mu the block then slides down above ``mu cos(slope) - sin(slope)``, and up above
            ``mu cos(slope) + sin(slope)``.
        slope: The angle of the slope, rad, zero or positive and below a right angle; for `friction`.
        mass: kg, positive; displacements do not depend on it.
        gravity: m/s^2, positive.

    Raises:
        ValueError: For a number out of its range, neither or both of `yield_coefficient` and `friction`, an `uphill`
            beside `friction`, and a `slope` without it.

    >>> shaking = ss.GroundAcceleration([0.0, 1.0, 1.001, 5.0], [-3.0, -3.0, 0.0, 0.0])
    >>> one = ss.simulate(ss.rigid_block(0.1), shaking, t1=5.0)
    >>> print(f"{float(one.final_state[0]):.3f} m down the slope")
    3.092 m down the slope
    """
    law, normal, pull = _sliding(yield_coefficient, uphill, friction, slope, mass, gravity)
    return MassSpring(mass, 0.0, normal, law, force=pull)


def coupled_block(
    yield_coefficient: Any = None,
    *,
    period: Number,
    damping_ratio: Number,
    modes: int = 1,
    uphill: Any = None,
    friction: FrictionLaw | None = None,
    slope: Number = 0.0,
    mass: Number = 1.0,
    gravity: Number = STANDARD_GRAVITY,
) -> LinearStructure:
    """A flexible column of soil that slides on its base, which its own vibration loads: the coupled analysis.

    A. K. Chopra and L. Zhang, "Earthquake-induced base sliding of concrete gravity dams", J. Structural Engineering 117
    (1991); E. M. Rathje and J. D. Bray, "An examination of simplified earthquake-induced displacement procedures for
    earth structures", Canadian Geotechnical J. 36 (1999), and "Nonlinear coupled seismic sliding analysis of earth
    structures", J. Geotechnical and Geoenvironmental Engineering 126 (2000), with linear soil. The state is the
    positions, then the velocities; contact 0 is that on the sliding surface, and position 0 the displacement along it.
    All is counted down the slope, as for `rigid_block`.

    Mode i of a uniform column of height H and mass M that shears, ``sin((2 i - 1) pi z / (2 H))``, has the generalised
    mass ``M_i = M / 2`` and the participation ``L_i = 2 M / ((2 i - 1) pi)``. With the displacement s of the base and
    ``u_i`` of the mode at the top, its equation is ``M_i u_i'' + C_i u_i' + K_i u_i = -L_i (s'' + a)``, and that of the
    whole ``M (s'' + a) + sum of L_i u_i'' = -friction``. With ``x_i = s + (M_i / L_i) u_i`` these are the equations of
    masses ``L_i^2 / M_i`` (a share of ``8 / ((2 i - 1) pi)^2`` of M) on springs and dampers on a mat that slides and
    has the rest of the mass: a diagonal mass matrix. So position i is ``x_i``, and the top moves by the sum of
    ``(-1)^(i - 1) (L_i / M_i) (position i - position 0)`` relative to the base, a factor of ``4 / pi`` in the first
    mode. Positions are counted from the rest of the column under its weight.

    Args:
        yield_coefficient: The ground acceleration, over that of gravity, above which a rigid block would slide down: a
            positive number, a distribution, or an array with one for each sample of an ensemble.
        period: The fundamental one of the column on a base that does not slide, s, positive: ``4 H / V_s``, with the
            velocity V_s of shear waves.
        damping_ratio: Of critical damping, the same in each mode, zero or positive.
        modes: How many are taken, 1 to 20; Rathje and Bray, SLAMMER and pySLAMMER take 1.
        uphill: Above which it would slide up, likewise; None: it never does.
        friction: In place of both, the friction law of the sliding surface, with the `slope`; see `rigid_block`.
        slope: The angle of the slope, rad, zero or positive and below a right angle; for `friction`.
        mass: Of the column, kg, positive.
        gravity: m/s^2, positive.

    Raises:
        ValueError: As `rigid_block`, and for numbers of the column out of their range.

    >>> shaking = ss.GroundAcceleration([0.0, 1.0, 1.001, 9.0], [-3.0, -3.0, 0.0, 0.0])
    >>> dam = ss.coupled_block(0.1, period=0.4, damping_ratio=0.05)
    >>> one = ss.simulate(dam, shaking, t1=9.0)
    >>> print(f"{float(one.final_state[0]):.3f} m down the slope")
    3.113 m down the slope
    """
    law, normal, pull = _sliding(yield_coefficient, uphill, friction, slope, mass, gravity)
    shares, frequencies = _modes(period, damping_ratio, modes)
    masses = mass * np.append(1 - np.sum(shares), shares)
    on_mat = np.hstack([-np.ones((modes, 1)), np.eye(modes)])  # position i less position 0

    def between(values: Any) -> Any:
        return on_mat.T @ (values[:, None] * on_mat)

    dampers = between(2 * damping_ratio * frequencies * masses[1:])
    contact = Contact.of_mass(0, modes + 1, normal, law)
    forces = None if pull is None else (pull, *(None,) * modes)
    return LinearStructure(
        masses, between(frequencies**2 * masses[1:]), dampers, (contact,), forces, uncoupled=True, drawn_as=STOREYS
    )


def equivalent_acceleration(
    record: GroundAcceleration, *, period: Number, damping_ratio: Number, modes: int = 1, parts: int = 1
) -> GroundAcceleration:
    """What a column of soil makes of a record: its base shear over its mass, for the decoupled analysis.

    The column of `coupled_block` does not slide here. Then the equivalent acceleration drives a `rigid_block` (F. I.
    Makdisi and H. B. Seed, "Simplified procedure for estimating dam and embankment earthquake-induced deformations",
    J. Geotechnical Engineering Division 104, 1978); its peak over that of gravity is known as k_max.

    The column is at rest at first. Its response to the record, which is linear between its points, is exact at those of
    the result; between them the equivalent acceleration is not linear, so take more `parts` for a column whose period
    is a few steps of the record.

    Args:
        record: Of the ground.
        period: The fundamental one of the column, s, positive, see `coupled_block`.
        damping_ratio: Of critical damping, the same in each mode, zero or positive.
        modes: How many are taken, 1 to 20.
        parts: Into which each step of the record is cut, 1 to 1000.

    Returns:
        The record of the equivalent acceleration.

    Raises:
        ValueError: For another `record`, and numbers out of their range.
    """
    if not isinstance(record, GroundAcceleration):
        raise checks.refused("record", "be a GroundAcceleration", record)
    shares, frequencies = _modes(period, damping_ratio, modes)
    cut = checks.whole_number("parts", parts, maximum=1000)
    corners = jnp.arange(len(record.times), dtype=float)
    at = jnp.arange((len(record.times) - 1) * cut + 1) / cut
    times = jnp.interp(at, corners, jnp.asarray(record.times, float))
    ground = jnp.interp(at, corners, jnp.asarray(record.accelerations, float))
    of_modes = _accelerations_of_masses(times, ground, damping_ratio * frequencies, frequencies**2)
    return GroundAcceleration(times, (1 - np.sum(shares)) * ground + of_modes @ shares)


@kept_jit
def _accelerations_of_masses(times: Any, ground: Any, decay: Any, stiffness: Any) -> Any:
    """Of masses on springs and dampers under a record, in the frame at rest, m/s^2, (points, masses)."""

    def step(state: Any, here: Any) -> Any:
        (x, v), (h, before, after) = state, here
        by, first = responses(decay, stiffness, h), -before - stiffness * x
        slope = (before - after) / h
        x1 = x + v * by.impulse + first * by.step + slope * by.ramp
        v1 = v * by.rate + first * by.impulse + slope * by.step
        return (x1, v1), -2 * decay * v1 - stiffness * x1

    rest = jnp.zeros_like(stiffness)
    _, found = lax.scan(step, (rest, rest), (jnp.diff(times), ground[:-1], ground[1:]))
    return jnp.concatenate([rest[None], found])


def _modes(period: Number, damping_ratio: Number, modes: int) -> tuple[np.ndarray, Any]:
    """Of a column that shears, the shares of the mass in the modes, and their angular frequencies, rad/s."""
    checks.positive("period", period, "s")
    checks.non_negative("damping_ratio", damping_ratio)
    odd = 2.0 * np.arange(checks.whole_number("modes", modes, maximum=_MOST_MODES)) + 1
    return 8 / (math.pi * odd) ** 2, 2 * math.pi * odd / period


def _sliding(
    yield_coefficient: Any, uphill: Any, friction: FrictionLaw | None, slope: Number, mass: Number, gravity: Number
) -> tuple[FrictionLaw, Any, Any]:
    """The friction law of a sliding surface, the normal force, and the pull of gravity down the slope (N)."""
    checks.positive("mass", mass, "kg")
    checks.positive("gravity", gravity, "m/s^2")
    checks.bounded("slope", slope, "rad", at_least=0, below=math.pi / 2)
    is_level = not checks.is_traced(slope) and slope == 0
    if (yield_coefficient is None) == (friction is None):
        given = "neither was" if friction is None else "both were"
        raise ValueError(f"Argument yield_coefficient or friction must say what the block holds, but {given} given.")
    if friction is None:
        if not is_level:
            raise checks.refused("slope", "be 0 beside a yield_coefficient, which holds it already", slope)
        for name, value in (("yield_coefficient", yield_coefficient), ("uphill", uphill)):
            if value is not None:
                Quantity(above=0).check(name, value)
        down = Coulomb(yield_coefficient)
        law = OneWay(down, _HELD) if uphill is None else Directional(down, Coulomb(uphill))
        return law, mass * gravity, None
    if uphill is not None:
        raise checks.refused("uphill", "be None beside friction, which says it already", uphill)
    require_law("friction", friction)
    weight, xp = mass * gravity, jnp if checks.is_traced(slope) else np
    return friction, weight * xp.cos(slope), None if is_level else weight * xp.sin(slope)
