"""Structures that everyone draws: blocks in a row, storeys over a sliding bearing, sliding slopes, drivetrains."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiler.programs import kept_jit
from .._excitation.recorded import GroundAcceleration
from .._foundation import checks
from .._foundation.fields import Checked, Quantity
from .._foundation.types import AnyArray, Number
from .._numerics.elementary import responses
from .._uncertainty.families import RandomNumber
from .contacts import Contact, ForceQuantity, NormalForce, entries_of
from .friction import Coulomb, FrictionLaw, require_law
from .mass_spring import MassSpring
from .places import Directional, OneWay
from .structure import BLOCKS, MOST_CONTACTS, STOREYS, LinearStructure, check_forces, numbers_in

# Structures that everyone draws: blocks in a row, storeys over a sliding bearing.


STANDARD_GRAVITY = 9.80665  # m/s^2


def block_row(
    blocks: int,
    *,
    mass: Number,
    between: Number,
    to_ground: Number,
    normal_force: NormalForce,
    friction: FrictionLaw,
    damping: Number = 0.0,
) -> LinearStructure:
    """Equal blocks in a row on the base, with springs from each to the next, and from each to the ground.

    The train of Burridge and Knopoff ("Model and theoretical seismicity", 1967) in the frame of the plate that pulls
    it; the base is the floor.

    Args:
        blocks: Their number, at most 1000.
        mass: Of each, kg, positive.
        between: Stiffness of the springs between neighbours, N/m, zero or positive.
        to_ground: Stiffness of the spring from each to the ground, N/m, zero or positive.
        normal_force: In each contact with the base, as in `Contact`.
        friction: Of each contact.
        damping: Of a viscous damper from each to the ground, N s/m, zero or positive.

    Raises:
        ValueError: For a number out of its range.

    >>> row = ss.block_row(
    ...     3, mass=1.0, between=1.0, to_ground=0.1, normal_force=1.0, friction=ss.Coulomb(0.3)
    ... )
    >>> print(row.stiffness)
    [[ 1.1 -1.   0. ]
     [-1.   2.1 -1. ]
     [ 0.  -1.   1.1]]
    """
    number = checks.whole_number("blocks", blocks, maximum=MOST_CONTACTS)
    checks.positive("mass", mass, "kg")
    for name, value in (("between", between), ("to_ground", to_ground), ("damping", damping)):
        checks.non_negative(name, value)
    stiffness = to_ground * np.eye(number) + between * row_of_springs(np.ones(number - 1))
    contacts = tuple(Contact.of_mass(i, number, normal_force, friction) for i in range(number))
    is_damped = checks.is_traced(damping) or damping != 0
    ones = np.ones(number)
    # Each block has a contact of its own: known to be uncoupled, even if the mass is traced.
    return LinearStructure(
        mass * ones, stiffness, damping * ones if is_damped else None, contacts, uncoupled=True, drawn_as=BLOCKS
    )


def storeys_on_bearing(
    mass: Sequence[Number],
    stiffness: Sequence[Number],
    *,
    friction: FrictionLaw,
    damping: Sequence[Number] | None = None,
    bearing_stiffness: Number = 0.0,
    gravity: Number = STANDARD_GRAVITY,
) -> LinearStructure:
    """A shear building on a sliding bearing, or on a pendulum bearing: the base mat slides on the ground.

    The positions are those of the base mat and of the storeys, from below, relative to the ground: the base to simulate
    it with is a `GroundAcceleration`. The normal force is the weight of all.

    Args:
        mass: Of the base mat, then of the storeys, kg, (storeys + 1,), positive.
        stiffness: From the base mat to the first storey, and between storeys, N/m, (storeys,), positive.
        friction: Of the bearing.
        damping: Between the same, N s/m, (storeys,), zero or positive; None is zero.
        bearing_stiffness: N/m; of a pendulum bearing, its weight over the radius. Zero for a flat one.
        gravity: m/s^2, positive.

    Raises:
        ValueError: For a number out of its range, or sequences of lengths that do not fit.
    """
    masses = np.asarray(numbers_in("mass", mass))
    if masses.ndim != 1 or len(masses) < 2 or not np.all(masses > 0):
        raise checks.refused("mass", "hold two positive numbers or more, the base mat's and the storeys'", mass)
    springs = _of_storeys("stiffness", stiffness, len(masses))
    if not np.all(springs > 0):
        raise checks.refused("stiffness", "hold positive numbers", stiffness)
    checks.non_negative("bearing_stiffness", bearing_stiffness, "N/m")
    checks.positive("gravity", gravity, "m/s^2")
    matrix = row_of_springs(springs)
    matrix[0, 0] += float(bearing_stiffness)
    dampers = None
    if damping is not None:
        values = _of_storeys("damping", damping, len(masses))
        if not np.all(values >= 0):
            raise checks.refused("damping", "hold numbers of zero or more", damping)
        dampers = row_of_springs(values)
    weight = float(gravity) * float(np.sum(masses))
    return LinearStructure(
        masses, matrix, dampers, (Contact.of_mass(0, len(masses), weight, friction),), drawn_as=STOREYS
    )


# Slopes, dams and landfills that slide under earthquakes: Newmark's rigid block, and blocks of flexible soil.


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
        yield_coefficient: As in `rigid_block`, as are `uphill`, `friction`, `slope`, `mass` and `gravity`.
        period: The fundamental one of the column on a base that does not slide, s, positive: ``4 H / V_s``, with the
            velocity V_s of shear waves.
        damping_ratio: Of critical damping, the same in each mode, zero or positive.
        modes: How many are taken, 1 to 20; Rathje and Bray, SLAMMER and pySLAMMER take 1.
        uphill: See above.
        friction: See above.
        slope: See above.
        mass: See above.
        gravity: See above.

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
        period: As in `coupled_block`, as are `damping_ratio` and `modes`.
        damping_ratio: See above.
        modes: See above.
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


def iwan_sliders(
    stiffness: Number,
    strengths: Any,
    *,
    sliders: int = 100,
    direction: Sequence[float] = (1.0,),
    on_base: Number = 1.0,
) -> tuple[Contact, ...]:
    """Sliders in parallel, each behind a spring: the contacts of a joint that begins to slip little by little.

    The parallel-series model of Iwan ("On a class of models for the yielding behavior of continuous and composite
    systems", 1967): n elements of Jenkins, of which each has the n-th part of the stiffness, and of its strength.

    Args:
        stiffness: Of all while none slips, N/m, positive.
        strengths: The force at which the joint would slip if all sliders were like this one, N: one for each slider,
            positive, or their distribution, such as ``Uniform(0.0, 2.0)``, of which each slider stands for an equal
            share. The joint slips as a whole at their mean.
        sliders: How many a distribution is divided into.
        direction: (d,), what each velocity of the structure contributes to the relative velocity of the joint.
        on_base: How much of the base velocity is subtracted: 1 for a mass on the base, 0 between masses.

    Returns:
        The contacts of a `LinearStructure`.

    Raises:
        ValueError: For a number out of its range.

    >>> joint = ss.iwan_sliders(100.0, ss.Uniform(0.0, 2.0), sliders=20)
    >>> oscillator = ss.LinearStructure([1.0], [50.0], contacts=joint)
    >>> print(len(oscillator.contacts), oscillator.coordinates[2].meaning)
    20 elongation 0 in m
    """
    checks.positive("stiffness", stiffness, "N/m")
    if isinstance(strengths, RandomNumber):
        number = checks.whole_number("sliders", sliders, maximum=MOST_CONTACTS)
        strengths = strengths.icdf((jnp.arange(number) + 0.5) / number)
    each = numbers_in("strengths", strengths)
    if (
        np.ndim(each) != 1
        or not np.size(each)
        or not (checks.is_traced(each) or np.all((each > 0) & np.isfinite(each)))
    ):
        raise checks.refused("strengths", "hold positive numbers (in N), or be a distribution of such", strengths)
    number = np.shape(each)[0]
    return tuple(Contact(direction, each[i] / number, Coulomb(1.0), on_base, stiffness / number) for i in range(number))


def row_of_springs(stiffness: Any) -> Any:
    """The stiffness matrix of springs between neighbours in a row, from an array (springs,)."""
    differences = differences_in_row(stiffness.shape[0] + 1)
    return differences.T @ (stiffness[:, None] * differences)


def differences_in_row(size: int) -> np.ndarray:
    """Of each number and the next one, as a matrix (size - 1, size)."""
    return np.diff(np.eye(size), axis=0)


def _of_storeys(name: str, values: Any, masses: int) -> np.ndarray:
    array = np.asarray(numbers_in(name, values))
    if array.shape != (masses - 1,) or not np.all(np.isfinite(array)):
        raise checks.refused(name, f"hold {masses - 1} finite numbers, one for each storey", values)
    return array


# Inertias in a row: drivetrains with clutches and brakes, drill strings.


_OPENS = "what opens has a function of time, such as a ForceSteps"


class FrictionDisk(Checked):
    """Two surfaces of a clutch or a brake that are pressed together, at a radius.

    They slide at ``radius`` times the difference of the angular velocities (m/s), which the friction law is asked with,
    and exert the torque ``radius * normal_force * coefficient``.

    Args:
        normal_force: N, positive; or a function of time, as in `Contact`: the clutch is open where that is zero or
            negative. Of several faces, the sum.
        friction: The friction law, such as `Coulomb(mu)`.
        radius: Effective radius, m, positive.

    Raises:
        ValueError: If a number is out of its range or not finite, or `friction` is no friction law.
    """

    normal_force: Annotated[NormalForce, ForceQuantity("N", above=0, hint=_OPENS)]
    friction: FrictionLaw
    radius: Annotated[Number, Quantity("m", above=0)] = 1.0

    def check_parts(self) -> None:
        checks.numeric("radius", self.radius)
        require_law("friction", self.friction)

    def contact(self, turns: np.ndarray) -> Contact:
        """The contact whose relative angular velocity is ``turns . angular velocities``."""
        return Contact(self.radius * turns, self.normal_force, self.friction, on_base=0.0)


def drivetrain(
    inertia: Sequence[Number] | AnyArray,
    *,
    stiffness: Sequence[Number] | AnyArray | None = None,
    damping: Sequence[Number] | AnyArray | None = None,
    drag: Sequence[Number] | AnyArray | None = None,
    clutches: Sequence[FrictionDisk | None] | None = None,
    brakes: Sequence[FrictionDisk | None] | None = None,
    torque: Sequence[NormalForce | None] | None = None,
) -> LinearStructure:
    """Inertias in a row, joined by shafts or clutches or both, and slowed down by brakes.

    The state is the angles, then the angular velocities. The contacts are the clutches from first to last, then the
    brakes. A clutch slides forward where the second of its inertias is the faster one; the position of its sticks is
    the distance slid. The housing does not move, and neither does a base: simulate it with ``Constant(0.0)``.

    Args:
        inertia: kg m^2, (inertias,), positive, at least 2.
        stiffness: Of the shaft from each to the next, N m/rad, (inertias - 1,), zero where there is none; None for no
            shafts at all.
        damping: Of these shafts, N m s/rad, likewise.
        drag: Viscous damping between each inertia and the housing, N m s/rad, (inertias,), zero or positive.
        clutches: Between each and the next, (inertias - 1,), None where there is none.
        brakes: Between each and the housing, (inertias,), None where there is none.
        torque: On each, N m, (inertias,): None, a number, a `Signal`, a `Recorded` or a `ForceSteps`.

    Raises:
        ValueError: For a number out of its range, sequences of lengths that do not fit, or no clutch and no brake.

    >>> train = ss.drivetrain(
    ...     [0.2, 0.5, 1.0],
    ...     stiffness=[0.0, 400.0],
    ...     clutches=(ss.FrictionDisk(900.0, ss.Coulomb(0.3), radius=0.1), None),
    ...     brakes=(None, None, ss.FrictionDisk(50.0, ss.Coulomb(0.4), radius=0.2)),
    ... )
    >>> print([contact.direction.tolist() for contact in train.contacts])
    [[-0.1, 0.1, 0.0], [0.0, 0.0, 0.2]]
    """
    row = _inertias(inertia)
    size = row.shape[0]
    disks = [
        *_disks("clutches", clutches, differences_in_row(size), "one between each inertia and the next"),
        *_disks("brakes", brakes, np.eye(size), "one for each inertia"),
    ]
    if not disks:
        raise ValueError("Argument clutches must hold a FrictionDisk, or brakes one, but none was given.")
    contacts = tuple(disk.contact(turns) for disk, turns in disks)
    return _row(row, stiffness, damping, drag, contacts, torque)


def drill_string(
    inertia: Sequence[Number] | AnyArray,
    stiffness: Sequence[Number] | AnyArray,
    *,
    weight_on_bit: NormalForce,
    bit_radius: Number,
    friction: FrictionLaw,
    damping: Sequence[Number] | AnyArray | None = None,
    drag: Sequence[Number] | AnyArray | None = None,
    torque: NormalForce | None = None,
    drive_torque: Number | None = None,
) -> LinearStructure:
    """A drill string: inertias in a row from the rotary table down to the bit, which rubs on the rock.

    With two inertias, the table and the bit, it is the model of Navarro-Lopez and Suarez ("Practical approach to
    modelling and controlling stick-slip oscillations in oilwell drillstrings", IEEE CCA 2004); with four, table, pipes,
    collars and bit, that of Navarro-Lopez and Cortes ("Avoiding harmful oscillations in a drillstring through dynamical
    analysis", J. Sound and Vibration 307, 2007). The torque on the bit is ``weight_on_bit * bit_radius`` times the
    friction coefficient. Their coefficient ``mu + (mu_static - mu) exp(-gamma |angular velocity|)`` is a
    ``Stribeck(mu, mu_static, bit_radius / gamma)``: friction laws ask for the speed of the bit's rim, m/s.

    One of two drives turns the table. A given `torque` acts on it; simulate the string with ``Constant(0.0)``. Or a
    drive controls its speed: simulate it on the base ``Constant(angular velocity)``, or any other base law, with the
    table starting at this speed. The drive exerts what it takes, up to `drive_torque`; beyond that the table slips.

    The state is the angles, then the angular velocities. Contact 0 is that of the bit, 1 that of the drive.

    Args:
        inertia: kg m^2, (inertias,), positive, at least 2.
        stiffness: From each to the next, N m/rad, (inertias - 1,), positive.
        weight_on_bit: N, positive, or a function of time, as the normal force in `Contact`: the bit is off the rock
            where it is zero or negative.
        bit_radius: m, positive.
        friction: Of the bit on the rock.
        damping: From each inertia to the next, N m s/rad, (inertias - 1,), zero or positive; None is zero.
        drag: Viscous damping of each, by the mud and in the drive, N m s/rad, (inertias,), likewise.
        torque: On the table, N m.
        drive_torque: The largest torque of a drive that controls the speed of the table, N m, positive.

    Raises:
        ValueError: For a number out of its range, sequences of lengths that do not fit, or not one drive.
    """
    if (torque is None) == (drive_torque is None):
        given = "neither was" if torque is None else "both were"
        raise ValueError(f"Argument torque or drive_torque must say what turns the table, but {given} given.")
    row = _inertias(inertia)
    size = row.shape[0]
    checks.positive("bit_radius", bit_radius, "m")
    springs = _numbers("stiffness", stiffness, size - 1)
    if not checks.is_traced(springs) and not np.all(springs > 0):
        raise checks.refused("stiffness", "hold positive numbers", stiffness)
    ForceQuantity("N", above=0, hint=_OPENS).check("weight_on_bit", weight_on_bit)
    contacts = (FrictionDisk(weight_on_bit, friction, bit_radius).contact(np.eye(size)[-1]),)
    if drive_torque is not None:
        Quantity("N m", above=0).check("drive_torque", drive_torque)
        contacts = (*contacts, Contact.of_mass(0, size, drive_torque, Coulomb(1.0)))
    on_table = None if torque is None else (torque, *(None,) * (size - 1))
    # Each contact has an inertia of its own: known to be uncoupled, even if they are traced.
    return _row(row, springs, damping, drag, contacts, on_table, uncoupled=True)


def _row(
    inertia: Any,
    stiffness: Sequence[Number] | AnyArray | None,
    damping: Sequence[Number] | AnyArray | None,
    drag: Sequence[Number] | AnyArray | None,
    contacts: tuple[Contact, ...],
    torque: Any,
    uncoupled: bool | None = None,
) -> LinearStructure:
    """Inertias with shafts between neighbours and viscous damping of each."""
    size = inertia.shape[0]
    torque = entries_of(torque)
    check_forces("torque", torque, size)
    springs, dampers = (
        None if values is None else row_of_springs(_numbers(name, values, size - 1))
        for name, values in (("stiffness", stiffness), ("damping", damping))
    )
    if drag is not None:
        drags = _numbers("drag", drag, size)
        dampers = drags if dampers is None else dampers + drags[:, None] * np.eye(size)
    springs = np.zeros(size) if springs is None else springs
    return LinearStructure(inertia, springs, dampers, contacts, torque, uncoupled=uncoupled, rotates=True)


def _inertias(values: Any) -> Any:
    array = numbers_in("inertia", values)
    is_row = np.ndim(array) == 1 and np.shape(array)[0] >= 2
    if not is_row or not (checks.is_traced(array) or np.all((array > 0) & np.isfinite(array))):
        raise checks.refused("inertia", "hold two positive numbers or more", values)
    return array


def _numbers(name: str, values: Any, count: int) -> Any:
    """`values` as an array of `count` numbers of zero or more."""
    array = numbers_in(name, values)
    fits = np.shape(array) == (count,)
    if not fits or not (checks.is_traced(array) or np.all((array >= 0) & np.isfinite(array))):
        raise checks.refused(name, f"hold {count} numbers of zero or more", values)
    return array


def _disks(name: str, disks: Any, turns: np.ndarray, meaning: str) -> list[tuple[FrictionDisk, np.ndarray]]:
    """The disks that are there, with what each angular velocity contributes to that of the disk."""
    if disks is None:
        return []
    fits = isinstance(disks, (tuple, list)) and len(disks) == len(turns)
    if not fits or not all(one is None or isinstance(one, FrictionDisk) for one in disks):
        raise checks.refused(name, f"be a tuple of {len(turns)}, {meaning}: a FrictionDisk, or None", disks)
    return [(one, row) for one, row in zip(disks, turns, strict=True) if one is not None]
