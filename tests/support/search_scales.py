"""The same motion in other units: mass, length and time 2^-30 to 2^20 times as large.

Powers of two change no digit of any number: the result must be the same, bit for bit, whatever the units.
"""

from typing import Any, NamedTuple

import numpy as np

import stickslip_jax as ss
from support.search import Batch
from support.switched import Case, Jumping, Rub, Steps, Tones, coulomb, hump, stribeck, weakening


class Units(NamedTuple):
    """Factors by which masses, lengths and times grow."""

    mass: float
    length: float
    time: float


def random_units(source: np.random.Generator, dtype=np.float64) -> Units:
    """Powers of two from 2^-30 to 2^20; where numbers have 8 bits for the exponent, products must stay within 2^126."""
    while True:
        mass, length, time = source.integers(-30, 21, 3).tolist()
        if (
            dtype == np.float64
            or max(abs(mass + n * length + q * time) for n in (0, 1, 2) for q in (0, -1, -2, -4)) < 50
        ):
            return Units(2.0**mass, 2.0**length, 2.0**time)


def _moved(part: Any, size: float, time: float) -> Any:
    def grown(values):
        return tuple(size * value for value in values)

    if part is None:
        return None
    if isinstance(part, Tones):
        return Tones(grown(part.amplitudes), tuple(w / time for w in part.frequencies), part.phases, size * part.offset)
    if isinstance(part, Steps):
        return Steps(tuple(d * time for d in part.durations), grown(part.velocities))
    if isinstance(part, Jumping):
        return Jumping(_moved(part.motion, size, time), _moved(part.steps, size, time))
    return part._replace(times=tuple(t * time for t in part.times), values=grown(part.values))


def _rub(law: ss.FrictionLaw, speed: float) -> Rub:
    if isinstance(law, ss.Coulomb):
        return coulomb(law.mu, law.mu_static)
    if isinstance(law, ss.VelocityWeakening):
        return weakening(law.mu_static, law.weakening / speed)
    if isinstance(law, ss.Stribeck):
        return stribeck(law.mu, law.mu_static, law.stribeck_speed * speed, law.viscous / speed)
    curve: Any = law.curve
    return hump(curve.low, curve.fall, curve.scale * speed, curve.rise / speed, law.static)


def in_units(case: Case, units: Units) -> Case:
    """The set-up with every number in other units."""
    mass, length, time = units
    speed, force = length / time, mass * length / time**2
    base = speed / time if type(case.base).__name__ == "Shaking" else speed
    return Case(
        case.mass * mass, case.stiffness * mass / time**2, case.normal_force * force, _rub(case.rub.law, speed),
        _moved(case.base, base, time), case.t1 * time, (case.y0[0] * length, case.y0[1] * speed),
        None if case.damping is None else case.damping * mass / time, _moved(case.force, force, time),
    )  # fmt: skip


def same_in_units(one: Batch, other: Batch, i: int, units: Units) -> bool:
    """Whether set-up `i` came out the same in both, `other` in the `units`: every digit."""
    scale, state = [units.time, units.time, units.length, 1], [units.length, units.length / units.time]
    same = int(one.near[i]) == int(other.near[i]) and int(one.status[i]) == int(other.status[i])
    sticks = np.array_equal(one.sticks(i) * scale, other.sticks(i))
    return same and sticks and np.array_equal(one.state[i] * state, other.state[i])
