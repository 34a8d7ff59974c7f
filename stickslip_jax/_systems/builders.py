"""Structures that everyone draws: blocks in a row, sliding bearings and storeys over them, drivetrains."""

import math
import warnings
from collections.abc import Sequence
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np

from .._excitation.recorded import GroundAcceleration, Recorded
from .._foundation import checks
from .._foundation.fields import Checked, Quantity
from .._foundation.types import AnyArray, Number
from .._uncertainty.families import RandomNumber
from .contacts import Contact, ForceQuantity, NormalForce, entries_of
from .friction import Coulomb, FrictionLaw, require_law
from .structure import BLOCKS, MOST_CONTACTS, STOREYS, LinearStructure, check_forces, numbers_in

# Structures that everyone draws: blocks in a row, sliding bearings, storeys over them.


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
    friction: FrictionLaw | Sequence[FrictionLaw],
    damping: Sequence[Number] | None = None,
    bearing_stiffness: Number = 0.0,
    gravity: Number = STANDARD_GRAVITY,
    radius: Number | Sequence[Number] | None = None,
    vertical: GroundAcceleration | None = None,
) -> LinearStructure:
    """A shear building on a sliding bearing, or on a pendulum bearing: the base mat slides on the ground.

    The positions are those of the base mat and of the storeys, from below, relative to the ground: the base to simulate
    it with is a `GroundAcceleration`. The normal force is the weight of all, ``(1 + vertical / gravity)`` times where
    the ground moves up and down: the building does so with it.

    Args:
        mass: Of the base mat, then of the storeys, kg, (storeys + 1,), positive.
        stiffness: From the base mat to the first storey, and between storeys, N/m, (storeys,), positive.
        friction: Of the bearing; of surfaces in series as in `friction_pendulum`.
        damping: Between the same, N s/m, (storeys,), zero or positive; None is zero.
        bearing_stiffness: N/m, of springs or rubber beside the bearing; zero for none.
        gravity: m/s^2, positive.
        radius: Of a pendulum bearing, m, as in `friction_pendulum`; None for a flat one.
        vertical: Acceleration of the ground, positive upward.

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
    contacts = _bearing(np.eye(len(masses))[0], weight, radius, friction, vertical, float(gravity))
    return LinearStructure(masses, matrix, dampers, contacts, drawn_as=STOREYS)


def friction_pendulum(
    mass: Number,
    radius: Number | Sequence[Number] | None,
    friction: FrictionLaw | Sequence[FrictionLaw],
    *,
    vertical: GroundAcceleration | None = None,
    gravity: Number = STANDARD_GRAVITY,
) -> LinearStructure:
    """One mass on a friction pendulum, or on a flat slider: an isolated structure as a rigid block.

    The weight presses, ``(1 + vertical / gravity)`` times where the ground moves up and down, and this normal force
    over the radius is the stiffness. While that is not positive the mass is off the ground, and nothing acts on it; how
    far it lifts off, and the impact when it is back, are not followed. Displacements are small beside the radius. The
    position is relative to the ground: the base to simulate it with is a `GroundAcceleration`.

    Args:
        mass: kg, positive.
        radius: Effective radius of curvature, m, positive; None or infinity for a flat slider. Of double and triple
            pendulums, surfaces in series, one for each: see `pendulum_in_series`.
        friction: Such as `VelocityDependent`; of surfaces in series a `Coulomb` law for each.
        vertical: Acceleration of the ground, positive upward; with one surface.
        gravity: m/s^2, positive.

    Returns:
        A structure with one mass and one contact; of surfaces in series the contacts of `pendulum_in_series`.

    Raises:
        ValueError: For a number out of its range, and for surfaces in series with vertical motion or other friction.

    >>> isolated = ss.friction_pendulum(1e5, 2.0, ss.VelocityDependent(0.03, 0.06, 40.0))
    >>> times = jax.numpy.arange(0.0, 8.0, 0.02)
    >>> shaking = ss.GroundAcceleration(times, 3.0 * jax.numpy.sin(6.0 * times))
    >>> print(f"{ss.simulate(isolated, shaking, t1=7.9).peak('position 0'):.4f} m")
    0.2377 m
    """
    checks.positive("mass", mass, "kg")
    checks.positive("gravity", gravity, "m/s^2")
    contacts = _bearing((1.0,), mass * gravity, radius, friction, vertical, gravity)
    return LinearStructure(_row_of([mass]), [0.0], None, contacts, uncoupled=True)


def _bearing(
    direction: Any, weight: Number, radius: Any, friction: Any, vertical: Any, gravity: Number
) -> tuple[Contact, ...]:
    radius = _row_of(radius)
    if isinstance(friction, (list, tuple)):
        if not all(isinstance(law, Coulomb) and law.mu_static is None for law in friction):
            hint = "surfaces in series have one constant coefficient each"
            raise checks.refused("friction", "hold laws Coulomb(mu), one for each surface in series", friction, hint)
        if vertical is not None:
            hint = "they have no equivalent in parallel under a weight that varies"
            raise checks.refused("vertical", "be None for surfaces in series", vertical, hint)
        if np.ndim(radius) != 1:
            raise checks.refused("radius", "hold one number for each law of surfaces in series", radius)
        return pendulum_in_series(weight, radius, [law.mu for law in friction], direction=direction)
    if np.ndim(radius):
        raise checks.refused("friction", "hold a law Coulomb(mu) for each radius of surfaces in series", friction)
    if radius is not None and not checks.is_traced(radius) and radius == math.inf:
        radius = None
    if vertical is None:
        return (Contact(direction, weight, friction, radius=radius),)
    if not isinstance(vertical, GroundAcceleration):
        hint = "a Contact takes any function of time as its normal force"
        raise checks.refused("vertical", "be a GroundAcceleration", vertical, hint)
    with warnings.catch_warnings():  # what would be noise of a base velocity may well be a ground acceleration
        warnings.filterwarnings("ignore", "The record of")
        pressing = Recorded(vertical.times, weight * (1 + vertical.accelerations / gravity))
    return (Contact(direction, pressing, friction, radius=radius),)


# Surfaces in series without masses between them: each is a spring k_i = W / R_i beside a rigid slider of the strength
# mu_i W, and the force F in all is the same. With mu_1 < ... < mu_n, a force that grows from zero moves the surfaces
# 1 ... j while it is between mu_j W and mu_(j+1) W: then F has the slope K_j = W / (R_1 + ... + R_j) by the
# displacement u, which at F = mu_(j+1) W is d_j = sum over i <= j of (mu_(j+1) - mu_i) R_i. Below mu_1 W nothing moves.
#
# The displacement of a surface is the play of F with the threshold mu_i W, over k_i. So u is a sum of plays of F, an
# operator of Prandtl and Ishlinskii. Its inverse is one too (Krejci 1996, Hysteresis, Convexity and Dissipation in
# Hyperbolic Equations), and these are determined by the curve of first loading. So in every motion that begins in the
# virgin state, with no force in any spring, F is that of elements in parallel with the same curve: a rigid slider
# of the strength mu_1 W, a spring K_n, and for j = 1 ... n - 1 a spring K_j - K_(j+1) behind which a slider has the
# strength (K_j - K_(j+1)) d_j. Surfaces with the same coefficient are one, with the sum of the radii.


def pendulum_in_series(
    weight: Number,
    radii: Sequence[Number] | AnyArray,
    coefficients: Sequence[Number] | AnyArray,
    *,
    direction: Sequence[float] | AnyArray = (1.0,),
) -> tuple[Contact, ...]:
    """The contacts of a double or triple friction pendulum: surfaces in series, under a constant weight.

    Each surface is a pendulum with Coulomb friction, and has no mass. The same in parallel is exact for every motion
    that begins with all surfaces at their centres: a contact with friction and curvature, and sliders behind springs
    whose elongations are further numbers of the state. Without the stops at the rims of the surfaces.

    Of a double pendulum give the effective radii and coefficients of its two surfaces (Fenz and Constantinou 2006,
    Earthquake Eng. Struct. Dyn. 35, 785). Of a triple pendulum, whose outer surfaces 1 and 4 stop the inner ones 2 and
    3, give those of its series model (Fenz and Constantinou 2008, same journal 37, 163): radii
    ``R_2 + R_3, R_1 - R_2, R_4 - R_3``, coefficients ``mu_2 = mu_3, mu_1, mu_4``. Under `storeys_on_bearing` and
    `friction_pendulum` say ``radius=[R_1, R_2], friction=[Coulomb(mu_1), Coulomb(mu_2)]``.

    Args:
        weight: N, positive.
        radii: Effective radii, m, positive, (surfaces,).
        coefficients: Friction coefficients, zero or positive, in any order, (surfaces,). Where JAX traces them they
            must differ.
        direction: (d,), what each velocity of the structure contributes to that of the bearing.

    Returns:
        The contacts of a `LinearStructure`, one for each coefficient.

    Raises:
        ValueError: For numbers out of their ranges, and lists of different lengths.

    >>> contacts = ss.pendulum_in_series(100.0, radii=[1.0, 3.0], coefficients=[0.02, 0.06])
    >>> print([round(float(one.friction.static * one.normal_force), 6) for one in contacts])
    [2.0, 3.0]
    """
    checks.positive("weight", weight, "N")
    radii, coefficients = _row_of(radii), _row_of(coefficients)
    checks.bounded("radii", radii, "m", above=0, ndim=1)
    checks.bounded("coefficients", coefficients, at_least=0, ndim=1)
    curves, given = numbers_in("radii", radii), numbers_in("coefficients", coefficients)
    if np.shape(curves) != np.shape(given) or not np.size(given):
        raise checks.refused("coefficients", f"hold {np.size(curves)}, one for each of radii", coefficients)
    xp: Any = jnp if checks.holds_traced([curves, given]) else np
    order = xp.argsort(given)
    given, reach = given[order], xp.cumsum(curves[order])
    if xp is np:
        last = np.append(np.diff(given) > 0, True)
        given, reach = given[last], reach[last]
    # (K_j - K_(j+1)) d_j of each, and d_j, which grows from surface to surface by (mu_(j+1) - mu_j) (R_1 + ... + R_j).
    springs, ways = weight / reach[:-1] - weight / reach[1:], xp.cumsum(xp.diff(given) * reach[:-1])
    sliders = (
        Contact(direction, weight, Coulomb(spring * way / weight), series_stiffness=spring)
        for spring, way in zip(springs, ways, strict=True)
    )
    return Contact(direction, weight, Coulomb(given[0]), radius=reach[-1]), *sliders


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


def _row_of(values: Any) -> Any:
    """Numbers in a list, of which JAX traces some, as an array; anything else as it is."""
    is_list = isinstance(values, (list, tuple)) and any(map(checks.is_traced, values))
    return jnp.stack([jnp.asarray(value, float) for value in values]) if is_list else values


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
