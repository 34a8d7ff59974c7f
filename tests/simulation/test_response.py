"""What engineers report of a motion: accelerations, forces, slip paths, reversals, energies."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

G = 9.81
SHORT = ss.Exact(max_steps=768)


def quiet(times, values, last):
    """A ground acceleration with these lines, and none after them until `last`."""
    return ss.GroundAcceleration([*times, last], [*values, 0.0])


# Newmark's block on level ground, without a spring: parabolas in every step of the record.


def test_block_under_a_pulse_in_closed_form():
    """A pulse of constant acceleration a > mu g for the time T: the block slides with a - mu g, then is slowed down.

    It comes to rest at T a / (mu g), has slid T^2 (a - mu g) a / (2 mu g) backwards, and friction has dissipated
    mu m g times that, all that the ground supplied.
    """
    mass, mu, a, last = 3.0, 0.2, 5.0, 1.0
    ramp = 1e-9  # between the values of a record are lines
    block = ss.MassSpring(mass, 0.0, mass * G, ss.Coulomb(mu))
    ground = quiet([0.0, last, last + ramp], [a, a, 0.0], 8.0)
    one = ss.simulate(block, ground, t1=8.0, method=SHORT)
    path = last**2 * (a - mu * G) * a / (2 * mu * G)
    assert float(one.residual("position")) == pytest.approx(-path, rel=1e-8)
    assert float(one.slip_path) == pytest.approx(path, rel=1e-8)
    assert float(one.slip_path) == pytest.approx(-float(one.residual()), rel=1e-13)
    assert float(one.peak("relative velocity")) == pytest.approx((a - mu * G) * last, rel=1e-8)
    assert float(one.peak("total acceleration")) == pytest.approx(mu * G, rel=1e-13)
    assert float(one.minimum("acceleration")) == pytest.approx(mu * G - a, rel=1e-13)
    assert float(one.maximum("acceleration")) == pytest.approx(mu * G, rel=1e-13)
    assert float(one.peak("base shear")) == pytest.approx(mu * mass * G, rel=1e-13)
    assert float(one.friction_energy) == pytest.approx(mu * mass * G * path, rel=1e-8)
    assert float(one.input_energy) == pytest.approx(float(one.friction_energy), rel=1e-12)
    assert int(one.slip_reversals) == 0
    assert float(one.damping_energy) == 0


def test_steady_sliding_in_closed_form():
    """Level ground that shakes by A cos(w t) so strongly that the block never sticks, in its steady motion.

    The velocity v against the ground has v' = -A cos(w t) - mu g sign(v) and is odd after half a period: it is zero
    where ``sin(w t0) = -mu g pi / (2 A)`` (a mean force of mu g is that of half a period of the ground). The path in a
    period is twice that between two zeros, and friction dissipates mu m g times it.
    """
    amplitude, frequency, mu, periods = 10.0, 2.0, 0.3, 6
    period = 2 * math.pi / frequency
    share = mu * G * math.pi / (2 * amplitude)
    begin = -math.asin(share) / frequency  # here the velocity turns to negative values
    block = ss.MassSpring(
        1.0, 0.0, G, ss.Coulomb(mu), force=ss.Harmonic(amplitude, frequency, phase=frequency * begin + math.pi)
    )
    # Of a force, in place of the ground's acceleration: the motion against the ground is the same.
    one = ss.simulate(block, ss.Constant(0.0), t1=periods * period, method=SHORT)
    half = period / 2

    def velocity(t):
        """From the zero at 0 on, in the first half of a period, in which the block slides backwards."""
        sines = math.sin(frequency * (t + begin)) - math.sin(frequency * begin)
        return -amplitude / frequency * sines + mu * G * t

    def position(t):
        cosines = math.cos(frequency * (t + begin)) - math.cos(frequency * begin)
        turned = amplitude / frequency**2 * cosines + amplitude / frequency * math.sin(frequency * begin) * t
        return turned + mu * G * t**2 / 2

    assert velocity(half) == pytest.approx(0, abs=1e-12)
    path = 2 * periods * abs(position(half))
    turns = (math.acos(mu * G / amplitude)) / frequency - begin  # where the velocity has its extreme
    assert int(one.sticks.count) == 0
    assert int(one.slip_reversals) == 2 * periods - 1
    assert float(one.slip_path) == pytest.approx(path, rel=1e-10)
    assert float(one.friction_energy) == pytest.approx(mu * G * path, rel=1e-10)
    assert float(one.peak("relative velocity")) == pytest.approx(abs(velocity(turns)), rel=1e-10)
    last = mu * G + amplitude * math.cos(frequency * begin)  # as a slip ends
    assert float(one.peak("total acceleration")) == pytest.approx(last, rel=1e-10)


# A damped oscillator under a record, against event by event integration with scipy.

MASS, STIFFNESS, DAMPING, MU = 2.0, 30.0, 0.8, 0.06
TIMES = np.linspace(0.0, 6.0, 121)
SHAKING = 3.0 * np.sin(5.0 * TIMES) * np.exp(-(((TIMES - 2.5) / 1.5) ** 2))
BEARING = ss.MassSpring(MASS, STIFFNESS, MASS * G, ss.Coulomb(MU), damping=DAMPING)
GROUND = ss.GroundAcceleration(TIMES, SHAKING)
RECORDED = ss.Exact(max_steps=1536)


def event_by_event():
    """All numbers of `BEARING` under `GROUND`: the arcs between events, every line of the record for itself."""
    limit = MU * MASS * G
    found = {name: [] for name in ("velocity", "total", "shear", "position")}
    t, y, sign, last_way, reversals = 0.0, np.zeros(5), 0.0, 0.0, 0
    for begin, end, low, high in zip(TIMES[:-1], TIMES[1:], SHAKING[:-1], SHAKING[1:], strict=True):
        slope = (high - low) / (end - begin)

        def ground(t, begin=begin, low=low, slope=slope):
            return low + slope * (t - begin)

        t = begin
        while t < end:
            if sign == 0:  # sticks until the needed force is beyond the limit
                needed = [MASS * ground(t) + STIFFNESS * y[0], MASS * ground(end) + STIFFNESS * y[0]]
                found["total"] += [ground(t), ground(end)]
                if max(map(abs, needed)) <= limit:
                    break
                if abs(needed[0]) < limit * (1 - 1e-14):
                    bound = math.copysign(limit, needed[1])
                    t += (bound - needed[0]) / (MASS * slope)
                    found["total"].append(ground(t))
                sign = -math.copysign(1.0, MASS * ground(t) + STIFFNESS * y[0])
                reversals += last_way * sign < 0
                last_way = sign
            way = sign

            def acceleration(t, y, way=way, ground=ground):
                return (-STIFFNESS * y[0] - DAMPING * y[1] - way * limit) / MASS - ground(t)

            def rates(t, y, way=way, ground=ground, of=acceleration):
                v = y[1]
                return [v, of(t, y, way, ground), abs(v), -MASS * ground(t) * v, DAMPING * v * v]

            def stops(t, y):
                return y[1]

            def turns(t, y, of=acceleration):
                return of(t, y)

            def swings(t, y, of=acceleration):
                return STIFFNESS * y[1] + DAMPING * of(t, y)

            stops.terminal, stops.direction = True, -way
            run = solve_ivp(
                rates, (t, end), y, method="DOP853", rtol=1e-13, atol=1e-15, events=(stops, turns, swings),
                first_step=min(1e-3, 0.5 * (end - t)), max_step=0.02,
            )  # fmt: skip
            ends = [(t, y), (run.t[-1], run.y[:, -1])]
            inner = [(when, state) for times, states in zip(run.t_events, run.y_events, strict=True)
                     for when, state in zip(times, states, strict=True)]  # fmt: skip
            for when, state in ends + inner:
                total = acceleration(when, state) + ground(when)
                found["velocity"].append(state[1])
                found["position"].append(state[0])
                found["total"].append(total)
                found["shear"].append(MASS * total)
            t, y = run.t[-1], run.y[:, -1].copy()
            if len(run.t_events[0]):
                y[1] = 0.0
                needed = MASS * ground(t) + STIFFNESS * y[0]
                sign = 0.0 if abs(needed) <= limit else -math.copysign(1.0, needed)
                reversals += last_way * sign < 0
                last_way = sign or last_way
    return found, y, reversals


def test_against_event_by_event_integration():
    found, y, reversals = event_by_event()
    one = ss.simulate(BEARING, GROUND, t1=6.0, method=RECORDED)
    for name, key in (("relative velocity", "velocity"), ("total acceleration", "total"), ("position", "position")):
        assert float(one.maximum(name)) == pytest.approx(max(found[key]), rel=1e-9), name
        assert float(one.minimum(name)) == pytest.approx(min(found[key]), rel=1e-9), name
    assert float(one.peak("base shear")) == pytest.approx(MASS * max(map(abs, found["total"])), rel=1e-9)
    assert float(one.residual()) == pytest.approx(y[0], rel=1e-9)
    assert float(one.slip_path) == pytest.approx(y[2], rel=1e-9)
    assert float(one.input_energy) == pytest.approx(y[3], rel=1e-9)
    assert float(one.damping_energy) == pytest.approx(y[4], rel=1e-9)
    assert float(one.friction_energy) == pytest.approx(MU * MASS * G * y[2], rel=1e-9)
    assert int(one.slip_reversals) == reversals > 4


NAMES = (
    "peak total acceleration", "peak acceleration", "minimum relative velocity", "residual position", "slip path",
    "slip reversals", "input energy", "friction energy", "damping energy", "peak base shear", "maximum friction force",
)  # fmt: skip


def test_an_ensemble_finds_the_same():
    """Whether samples differ in their system or not, and with numbers in single precision."""
    scaled = ss.MassSpring(MASS, STIFFNESS, MASS * G, ss.Coulomb(ss.Uniform(0.04, 0.08)), damping=DAMPING)
    many = ss.simulate_ensemble(
        scaled, GROUND, t1=6.0, samples=6, key=jax.random.key(0), keep="totals", outputs=NAMES, method=RECORDED
    )
    assert list(many.output_values) == [name.replace(" ", "_") for name in NAMES]
    units = ["m/s^2", "m/s^2", "m/s", "m", "m", "1", "J", "J", "J", "N", "N"]
    assert [many.output_units[name.replace(" ", "_")] for name in NAMES] == units
    for i in (0, 3):
        system, base, y0 = many.realization(i)
        one = ss.simulate(system, base, t1=6.0, y0=y0, method=RECORDED)
        for name in NAMES:
            value = many.output_values[name.replace(" ", "_")][i]
            assert value == pytest.approx(float(ss.Output(name).function(one)), rel=1e-11), name


@pytest.mark.parametrize(
    "name",
    ["peak total acceleration"]
    + [pytest.param(name, marks=pytest.mark.slow) for name in ("slip path", "friction energy", "peak base shear")],
)
def test_derivatives(name):
    """Of events too: the largest acceleration is where a slip ends."""

    def value(mu, stiffness=STIFFNESS):
        system = ss.MassSpring(MASS, stiffness, MASS * G, ss.Coulomb(mu), damping=DAMPING)
        return ss.Output(name).function(ss.simulate(system, GROUND, t1=6.0, method=RECORDED))

    step = 1e-6
    by_mu = jax.jit(jax.grad(value))(MU)
    assert float(by_mu) == pytest.approx(float(value(MU + step) - value(MU - step)) / (2 * step), rel=1e-6)


# Structures.

STOREYS = ss.storeys_on_bearing(
    [2.0, 1.0, 1.0], [400.0, 300.0], friction=ss.Coulomb(0.08), damping=[1.0, 1.0], bearing_stiffness=20.0
)


ON_BEARING = ss.Exact(max_steps=3072)


@pytest.mark.slow
def test_a_building_and_its_bearing():
    """The force in the bearing is that of its friction and its spring; energies, found another way."""
    one, times = ss.simulate(STOREYS, GROUND, t1=6.0, method=ON_BEARING), np.linspace(0.0, 6.0, 60_001)
    shear, spring = np.asarray(one.response("base shear", times)), 20.0 * np.asarray(one.evaluate(times)[0])
    np.testing.assert_allclose(shear, np.asarray(one.friction_force(times)) - spring, rtol=0, atol=1e-11)
    energies = one.energies(6.0)
    assert float(one.input_energy) == pytest.approx(float(sum(energies.supplied.values())), rel=1e-12)
    assert float(one.friction_energy) == pytest.approx(float(energies.dissipated["friction"]), rel=1e-12)
    assert float(one.damping_energy) == pytest.approx(float(energies.dissipated["damping"]), rel=1e-12)


@pytest.mark.slow
def test_a_building_against_its_own_history():
    """Names, shear as the sum of masses times total accelerations, and the integrals of what `response` shows."""
    one = ss.simulate(STOREYS, GROUND, t1=6.0, method=ON_BEARING)
    times = np.linspace(0.0, 6.0, 60_001)
    total = np.stack([one.response(f"total acceleration {i}", times) for i in range(3)])
    shear = np.asarray(one.response("base shear", times))
    np.testing.assert_allclose(shear, np.array([2.0, 1.0, 1.0]) @ total, rtol=0, atol=1e-11)
    spring = 20.0 * np.asarray(one.response("position 0", times))
    np.testing.assert_allclose(shear, np.asarray(one.response("friction force 0", times)) - spring, rtol=0, atol=1e-11)
    drift = np.asarray(one.response("total acceleration 2 - total acceleration 0", times))
    np.testing.assert_allclose(drift, total[2] - total[0], rtol=0, atol=1e-11)
    for name, values in (("total acceleration 2", total[2]), ("base shear", shear)):
        jumps = 1e-3 * np.max(np.abs(values))  # the grid misses the instants at which these jump
        assert np.max(np.abs(values)) - 1e-12 <= float(one.peak(name)) <= np.max(np.abs(values)) + jumps, name
    speeds = np.abs(np.asarray(one.response("relative velocity 0", times)))
    assert float(one.slip_path) == pytest.approx(np.trapezoid(speeds, times), rel=1e-6)


PAIR = ss.LinearStructure([1.0, 2.0], [[6.0, -2.0], [-2.0, 5.0]], contacts=(
    ss.Contact.of_mass(0, 2, 3.0, ss.Coulomb(0.1, mu_static=0.15)),
    ss.Contact.of_mass(1, 2, 5.0, ss.Coulomb(0.1), series_stiffness=20.0),
))  # fmt: skip
BELT = ss.Harmonic(0.6, 1.7)
GROWING = ss.Ageing(ss.Coulomb(0.2), ss.LogarithmicGrowth(0.05, 1.0))
PLACES = ss.FrictionByPlace((0.1,), (ss.Coulomb(0.1), ss.Coulomb(0.3)))
KINDS = {
    "two contacts, one behind a spring": (PAIR, BELT),
    "static friction that grows": (ss.MassSpring(1.0, 4.0, 2.0, GROWING), BELT),
    "weakening with the speed": (ss.MassSpring(1.0, 4.0, 2.0, ss.Stribeck(0.2, 0.3, 0.1), damping=0.1), BELT),
    "friction by place": (ss.MassSpring(1.0, 4.0, 2.0, PLACES), BELT),
    "strong damping": (ss.MassSpring(1.0, 4.0, 2.0, ss.Coulomb(0.2), damping=200.0), BELT),
    "in closed form": (ss.MassSpring(1.0, 4.0, 2.0, ss.Coulomb(0.2)), ss.SquareWave(0.8, 3.0)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_every_kind_of_contact(name):
    """Against the energies, found another way, and histories."""
    system, base = KINDS[name]
    one = ss.simulate(system, base, t1=12.0)
    energies, times = one.energies(12.0), np.linspace(0.0, 12.0, 120_001)
    scale = float(sum(energies.dissipated.values()))
    assert float(one.input_energy) == pytest.approx(float(sum(energies.supplied.values())), abs=1e-9 * scale)
    assert float(one.friction_energy) == pytest.approx(float(energies.dissipated["friction"]), abs=1e-9 * scale)
    assert float(one.damping_energy) == pytest.approx(float(energies.dissipated["damping"]), abs=1e-9 * scale)
    paths = np.atleast_1d(one.slip_path)
    for i, path in enumerate(paths):
        number = f" {i}" if len(paths) > 1 else ""
        speeds = np.abs(np.asarray(one.response(f"relative velocity{number}", times)))
        jumps = 8 * 1.6 if isinstance(base, ss.SquareWave) else 0.0  # in m/s, which a grid meets too late or too early
        assert path == pytest.approx(np.trapezoid(speeds, times), rel=2e-5, abs=1e-4 * jumps)
        inside = times[:-1]  # the base jumps at the end
        force = np.asarray(one.response(f"friction force{number}", inside))
        expected = np.asarray(one.friction_force(inside))
        np.testing.assert_allclose(force, expected[i] if len(paths) > 1 else expected, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_two_contacts_have_sums_each():
    one = ss.simulate(PAIR, BELT, t1=12.0, method=ss.Exact(max_steps=768))
    assert one.slip_path.shape == one.slip_reversals.shape == (2,)
    assert float(one.of_contact(1).slip_path) == float(one.slip_path[1])
    assert float(ss.Output("slip path 1").function(one)) == float(one.slip_path[1])
    with pytest.raises(ValueError, match="number must be"):
        ss.Output("slip path 2").function(one)
    assert int(one.slip_reversals[0]) > 2


# What is refused, and in what words.


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"Argument function must begin with peak, maximum, minimum, residual"):
        ss.Output("largest position")
    one = ss.simulate(BEARING, GROUND, t1=6.0, method=RECORDED)
    with pytest.raises(
        ValueError, match=r"coordinate must be one of 'position', 'velocity', 'acceleration', 'total acc"
    ):
        one.peak("jerk")
    with pytest.raises(ValueError, match=r"coordinate must be a coordinate for a residual"):
        one.residual("acceleration")
    smooth = ss.simulate(BEARING, GROUND, t1=0.5, method=ss.Regularized(1e-3))
    with pytest.raises(ValueError, match=r"response needs a simulation with method=Exact\(\)"):
        smooth.response("acceleration", 0.1)
    with pytest.raises(ValueError, match=r"slip_path needs a simulation with method=Exact\(\)"):
        _ = smooth.slip_path
    assert float(smooth.response("position", 0.1)) == float(smooth.evaluate(0.1)[0])


@pytest.mark.slow
def test_under_jit_and_vmap():
    def numbers(mu):
        system = ss.MassSpring(MASS, STIFFNESS, MASS * G, ss.Coulomb(mu), damping=DAMPING)
        one = ss.simulate(system, GROUND, t1=6.0, method=RECORDED)
        return one.peak("total acceleration"), one.slip_path, one.slip_reversals

    several = jax.jit(jax.vmap(numbers))(jnp.array([0.05, MU]))
    for found, expected in zip(several, numbers(MU), strict=True):
        assert float(found[1]) == pytest.approx(float(expected), rel=1e-12)
