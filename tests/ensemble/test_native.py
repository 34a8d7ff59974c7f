"""Ensembles of every kind of system are compiled into native loops: XLA's refusal is a warning, which fails a test."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss

COULOMB, STATIC = ss.Coulomb(0.3), ss.Coulomb(0.3, 0.4)
PULSING = ss.Harmonic(0.2, 2.0, offset=0.15)  # lifts off
RECORD = ss.Recorded([0.0, 1.0, 3.0], [1.0, -0.2, 0.5])
RAIL = ss.FrictionByPlace((-0.004, 0.003), (STATIC, ss.Coulomb(0.1, 0.2), STATIC), on="ground")
BELT = ss.FrictionByPlace((0.0, 0.3), (STATIC, ss.Coulomb(0.1, 0.2)), 1.0)
VOLTAGE = ss.RandomPhase(ss.SourceVoltage(0.5, 1.5, 9.0))
SWINGING = ss.RandomPhase(ss.Harmonic(0.3, 1.1))


def mass(friction=COULOMB, **options):
    return ss.MassSpring(1.0, 4.0, **{"normal_force": 1.0, "friction": friction} | options)


def row(number, friction=COULOMB, normal_force=1.0, **options):
    """Masses in a row, each with a contact."""
    couplings = np.diag(np.ones(number - 1), 1)
    stiffness = 2.4 * np.eye(number) - couplings - couplings.T
    contacts = tuple(ss.Contact.of_mass(i, number, normal_force, friction) for i in range(number))
    return ss.LinearStructure(np.ones(number), stiffness, **{"damping": None} | options, contacts=contacts)


def has_many(system):
    """Whether it has several contacts."""
    return not isinstance(system, ss.MassSpring) and bool(system.tracks.contacts)


class Pendulums(ss.SwitchedSystem):
    """Two pendulums on a belt, coupled by a spring."""

    mu: float
    state_names = ("angle 1", "angle 2", "rate 1", "rate 2")
    contacts = 2
    shortest_time = 2.0

    def rates(self, t, y, base, friction):
        pull = 2.0 * (y[1] - y[0])
        first = -4.0 * jax.numpy.sin(y[0]) + pull - self.mu * friction[0]
        return y[2], y[3], first, -3.0 * jax.numpy.sin(y[1]) - pull - self.mu * friction[1]

    def relative_velocity(self, t, y, base):
        return y[2] - base.velocity, y[3] - base.velocity


SYSTEMS = {
    "plain": mass(),
    "static": mass(STATIC),
    "damped": mass(damping=0.1),
    "Stribeck": mass(ss.Stribeck(0.3, 0.4, 0.1)),
    "weakening": mass(ss.VelocityWeakening(0.4, 2.0)),
    "own curve": mass(ss.FrictionCurve(lambda speed: 0.3 + 0.1 * jax.numpy.exp(-speed))),
    "table": mass(ss.FrictionCurve.from_table([0.0, 0.1, 0.5], [0.4, 0.3, 0.35])),
    "directional": mass(ss.Directional(COULOMB, ss.VelocityWeakening(0.4, 2.0))),
    "ageing": mass(ss.Ageing(STATIC, ss.LogarithmicGrowth(0.02, 0.1))),
    "belt of regions": mass(BELT),
    "harmonic force": mass(force=ss.Harmonic(0.5, 1.7)),
    "recorded force": mass(force=RECORD),
    "force that jumps": mass(force=ss.ForceSteps([0.0, 1.0], [0.5, -0.5])),
    "pulsing normal force": mass(normal_force=PULSING),
    "recorded normal force": mass(normal_force=RECORD),
    "two": row(2),
    "two, static": row(2, STATIC),
    "three, damped": row(3, damping=0.1 * np.eye(3)),
    "two, Stribeck": row(2, ss.Stribeck(0.3, 0.4, 0.1)),
    "two, directional": row(2, ss.Directional(COULOMB, STATIC)),
    "two, ageing": row(2, ss.Ageing(STATIC, ss.LogarithmicGrowth(0.02, 0.1))),
    "two, pulsing": row(2, normal_force=PULSING),
    "three, pulsing": row(3, STATIC, PULSING),
    "two, recorded normal forces": row(2, normal_force=RECORD),
    "two, forces": row(2, force=(ss.Harmonic(0.5, 1.7), RECORD)),
    "seven": row(7),
    "eight": row(8),
    "eight, on a belt": ss.block_row(8, mass=1.0, between=1.0, to_ground=0.2, normal_force=1.0, friction=COULOMB),
    "nine": row(9),
    "pendulums": Pendulums(0.5),
    "cart": ss.MotorCart(),
    "cart, Stribeck": ss.MotorCart(friction=ss.Stribeck(0.3, 0.4, 0.1)),
    "cart, ageing": ss.MotorCart(friction=ss.Ageing(STATIC, ss.LogarithmicGrowth(0.02, 0.1))),
    "cart, directional": ss.MotorCart(friction=ss.Directional(COULOMB, STATIC)),
    "cart, rail of regions": ss.MotorCart(friction=RAIL),
}
QUICK = ("static",)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SYSTEMS]
)
def test_exact(name):
    system = SYSTEMS[name]
    base = VOLTAGE if isinstance(system, ss.MotorCart) else SWINGING
    y0 = None
    if name.endswith("on a belt"):
        base, y0 = ss.Constant(0.2), (ss.Uniform(-0.1, 0.1), *[0.0] * 15)
    call = ss.simulate_contacts if has_many(system) else ss.simulate_ensemble
    for keep in ("totals", "sticks") if name not in QUICK else ("sticks",):
        many = call(
            system, base, t1=2.0, samples=16, key=jax.random.key(0), y0=y0, keep=keep, threads=1, progress=False
        )
        assert (many.of_contact(0) if has_many(system) else many).finished == 16


@pytest.mark.slow
@pytest.mark.parametrize("base", ["poisson", "steps", "record", "ground", "earthquake", "tones", "jumps"])
@pytest.mark.parametrize("name", ["static", "two, pulsing"])
def test_bases(name, base):
    law = {
        "poisson": ss.PoissonSwitching(0.3, 1.0),
        "steps": ss.RandomSteps(0.5, 0.3),
        "record": RECORD,
        "ground": ss.GroundAcceleration([0.0, 1.0, 3.0], [1.0, -1.0, 0.5]),
        "earthquake": ss.KanaiTajimi(2.0, rise=1.0),
        "tones": ss.RandomPhase(ss.SumOfHarmonics([0.5, 0.2], [1.5, 4.0])),
        "jumps": ss.WithJumps(SWINGING, ss.PoissonSwitching(0.5, 1.0)),
    }[base]
    system = SYSTEMS[name]
    call = ss.simulate_contacts if has_many(system) else ss.simulate_ensemble
    y0 = {"y0": (ss.Uniform(-0.1, 0.1), *[0.0] * (len(system.coordinates) - 1))}
    many = call(system, law, t1=2.0, samples=16, key=jax.random.key(0), keep="sticks", threads=1, progress=False, **y0)
    assert (many.of_contact(0) if has_many(system) else many).finished == 16


@pytest.mark.slow
@pytest.mark.parametrize("name", ["static", "Stribeck", "two", "two, pulsing", "cart"])
def test_regularized(name):
    system = SYSTEMS[name]
    base = VOLTAGE if isinstance(system, ss.MotorCart) else SWINGING
    call = ss.simulate_contacts if has_many(system) else ss.simulate_ensemble
    many = call(
        system, base, t1=0.5, samples=16, key=jax.random.key(0), keep="sticks", threads=1, progress=False,
        method=ss.Regularized(1e-2, step=1e-3),
    )  # fmt: skip
    assert (many.of_contact(0) if has_many(system) else many).finished == 16


LUGRE = ss.LuGre(0.3, 0.4, stribeck_speed=0.05, stiffness=1e3, damping=30.0)
SMOOTH = {
    "LuGre": mass(LUGRE),
    "elastoplastic": mass(ss.ElastoPlastic(0.3, 0.4, stribeck_speed=0.05, stiffness=1e3, damping=30.0)),
    "Dahl": mass(ss.Dahl(0.3, 1e3)),
    "Bouc and Wen": mass(ss.BoucWen(0.3, 1e3)),
    "rate and state": mass(ss.DieterichRuina(0.6, 0.01, 0.015, length=1e-3, reference_speed=1e-3)),
    "LuGre, pulsing normal force": mass(LUGRE, normal_force=ss.Harmonic(0.1, 2.0, offset=0.3)),
    "two, LuGre": row(2, LUGRE),
    "three, LuGre": row(3, LUGRE, damping=0.1 * np.eye(3)),
    "five, LuGre": row(5, LUGRE),
    "cart, LuGre": ss.MotorCart(friction=LUGRE),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [*SMOOTH, "static", "Stribeck", "own curve", "two", "two, static", "three, pulsing", "pendulums", "cart"]
)
def test_adaptive(name):
    system = SMOOTH.get(name) or SYSTEMS[name]
    base = VOLTAGE if isinstance(system, ss.MotorCart) else SWINGING
    call = ss.simulate_contacts if has_many(system) else ss.simulate_ensemble
    method = ss.Regularized(*(() if name in SMOOTH else (1e-2,)), threshold=1e-3, minimum_duration=1e-3)
    for keep in ("totals", "sticks"):
        many = call(
            system, base, t1=0.5, samples=16, key=jax.random.key(0), keep=keep, threads=1, progress=False, method=method
        )
        assert (many.of_contact(0) if has_many(system) else many).finished == 16
