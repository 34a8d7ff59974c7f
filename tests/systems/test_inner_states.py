"""Systems whose friction laws have inner states: against scipy's implicit solver, and Coulomb's exact sticks."""

import dataclasses
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support import cart_memory as cart

import stickslip_jax as ss

ACCURATE = ss.Regularized(rtol=1e-9, solver=diffrax.Kvaerno5(), max_steps=40_000)
# Canudas de Wit et al. 1995, Table I: a mass of 1 kg under a normal force of 1 N, pulled by a spring.
LUGRE = ss.LuGre(1.0, 1.5, stribeck_speed=0.001, stiffness=1e5, damping=math.sqrt(1e5), viscous=0.4)


def listed(sticks):
    mask = np.asarray(sticks.mask)
    return np.asarray(sticks.start)[mask], np.asarray(sticks.end)[mask]


def bristles(v, z):
    """Friction and rate of the law above."""
    rate = v - 1e5 * abs(v) * z / (1 + 0.5 * math.exp(-((v / 0.001) ** 2)))
    return 1e5 * z + math.sqrt(1e5) * rate + 0.4 * v, rate


def below(solution, velocity, threshold, shortest, bend=2 * 1.5 / 1e5, of_law=None):
    """The times in which the relative velocity is below the threshold for long enough, by scipy's dense output.

    Joined where the contact slips by less than `bend` in between. `of_law`: the speed of its slip, if another one.
    """
    times = np.linspace(0, solution.t[-1], 2_000_001)
    states = solution.sol(times)
    speed = velocity(states)
    slow = np.concatenate([[False], np.abs(speed) <= threshold, [False]])
    edges = np.minimum(np.flatnonzero(slow[1:] != slow[:-1]), len(times) - 1)
    if not len(edges):
        return np.zeros((0, 2))
    path = np.cumsum(np.abs(speed) if of_law is None else of_law(states)) * times[1]
    if path[-1] - path[edges[-1]] < bend:
        edges[-1] = len(times) - 1
    slips = path[edges[2::2]] - path[edges[1:-1:2]] >= bend
    spans = times[np.stack([edges[::2][np.append(True, slips)], edges[1::2][np.append(slips, True)]], axis=1)]
    return spans[spans[:, 1] - spans[:, 0] >= shortest]


@pytest.mark.slow
def test_lugre_against_scipy():
    one = ss.simulate(ss.MassSpring(1.0, 2.0, 1.0, LUGRE), ss.Constant(0.1), t1=20.0, method=ACCURATE)

    def rates(t, y):
        force, rate = bristles(y[1] - 0.1, y[2])
        return [y[1], -2 * y[0] - force, rate]

    run = solve_ivp(rates, (0, 20), [0, 0, 0], method="Radau", rtol=1e-10, atol=1e-14, dense_output=True)
    np.testing.assert_allclose(one.final_state, run.y[:, -1], rtol=0, atol=1e-6)
    times = np.linspace(0.5, 19.5, 20)
    np.testing.assert_allclose(one.evaluate(times), run.sol(times), rtol=0, atol=2e-5)
    spans = below(run, lambda y: y[1] - 0.1, float(one.method.threshold), float(one.method.minimum_duration))
    starts, ends = listed(one.sticks)
    np.testing.assert_allclose(np.stack([starts, ends], axis=1), spans, rtol=0, atol=1e-4)
    # m x'' = -k x + friction: the force that is shown is that of the equation of motion.
    expected = [-bristles(*(run.sol(t)[1:] - [0.1, 0])[:2])[0] for t in times]
    np.testing.assert_allclose(one.friction_force(times), expected, rtol=0, atol=2e-2)
    assert [c.meaning for c in one.system.coordinates][-1] == "deflection in m"


@pytest.mark.slow
@pytest.mark.parametrize("law", ["LuGre", pytest.param("elasto-plastic", marks=pytest.mark.slow)])
def test_stiff_bristles_stick_as_coulomb_friction(law):
    """The starts of sticks come to the exact ones with the square root of the bristles' deflection.

    A reversal takes the time in which the mass slips as far as the bristles bend, and its impulse is lacking. Ends come
    with the fourth root: a slip begins with the square of time, and needs the root of the threshold to reach it.
    """

    def made(stiffness):
        if law == "LuGre":
            return ss.LuGre(0.9, 0.9, 1.0, stiffness, damping=2 * math.sqrt(stiffness))
        return ss.ElastoPlastic(0.9, 0.9, 1.0, stiffness, damping=2 * math.sqrt(stiffness))

    base, y0 = ss.Harmonic(1.0, 0.4), (0.3, -0.2)
    exact = listed(ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9)), base, t1=25.0, y0=y0).sticks)
    errors = []
    for stiffness in (1e4, 1e5, 1e6):
        method = ss.Regularized(rtol=1e-8, threshold=0.3 / math.sqrt(stiffness), minimum_duration=0.2, max_steps=60_000)
        one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, made(stiffness)), base, t1=25.0, y0=y0, method=method)
        found = listed(one.sticks)
        assert len(found[0]) == len(exact[0]) > 2
        errors.append([np.max(np.abs(a - b)) for a, b in zip(found, exact, strict=True)])
    orders = -np.diff(np.log10(errors), axis=0)
    np.testing.assert_allclose(orders[:, 0], 1 / 2, rtol=0, atol=0.05)
    np.testing.assert_allclose(orders[:, 1], 1 / 4, rtol=0, atol=0.1)
    assert np.all(np.array(errors[-1]) < 0.02)


@pytest.mark.slow
def test_motion_with_stiff_bristles_without_damping():
    """Dahl's law comes to Coulomb's as the square root of the deflection; its bristles ring while the mass sticks."""
    base, y0 = ss.Harmonic(1.0, 0.9), (0.5, 0.3)
    exact = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.4)), base, t1=20.0, y0=y0).final_state
    method = ss.Regularized(rtol=1e-7, max_steps=60_000)
    errors = []
    for stiffness in (1e3, 1e5):
        one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Dahl(0.4, stiffness)), base, t1=20.0, y0=y0, method=method)
        errors.append(math.hypot(*(np.array(one.final_state[:2]) - np.array(exact))))
    assert errors[0] / errors[1] == pytest.approx(10, rel=0.1)


A, B, LENGTH, SPEED, NORMAL, MASS = 0.01, 0.015, 1e-5, 1e-6, 1e6, 1e3
CRITICAL = NORMAL * (B - A) / LENGTH


def slider(share, form, t1):
    """A spring slider on a belt, a little away from steady sliding; `share`: of the critical stiffness."""
    law = ss.DieterichRuina(0.6, A, B, length=LENGTH, reference_speed=SPEED, form=form)
    method = ss.Regularized(
        rtol=1e-7, atol=np.array([1e-12, 1e-12, 1e-8]), solver=diffrax.Kvaerno5(), threshold=1e-9,
        minimum_duration=1.0, max_steps=40_000,
    )  # fmt: skip
    system = ss.MassSpring(MASS, share * CRITICAL, NORMAL, law)
    y0 = (0.6 * NORMAL / (share * CRITICAL) + 1e-8, 0.0)
    return ss.simulate(system, ss.Constant(SPEED), t1=t1, y0=y0, method=method)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["ageing", pytest.param("slip", marks=pytest.mark.slow)])
def test_steady_sliding_of_a_spring_slider_loses_stability(form):
    """At the stiffness ``normal_force (b - a) / length`` (Ruina 1983), where inertia hardly counts."""

    def growth(share):
        positions = slider(share, form, 1500.0).evaluate(np.linspace(300, 1500, 4801))[0]
        assert np.all(np.isfinite(positions))
        return np.ptp(positions[-400:]) / np.ptp(positions[:400])

    assert growth(0.99) > 1.2
    assert growth(1.01) < 0.8


def in_logarithms(stiffness, y0, t1):
    """By scipy: the position, w = asinh of the scaled slip (`slip_of`), and the inner state."""

    def rates(t, y):
        x, w, z = y
        exponent = (0.6 + B * z) / A
        v = 2 * SPEED * np.exp(-exponent) * np.sinh(w)
        z_rate = SPEED / LENGTH * np.exp(-z) - abs(v) / LENGTH
        per_velocity = np.exp(exponent - np.logaddexp(w, -w) + np.log(2)) / (2 * SPEED)
        acceleration = (-stiffness * x - NORMAL * A * w) / MASS
        return [v + SPEED, per_velocity * acceleration + np.tanh(w) * B / A * z_rate, z_rate]

    start = [y0[0], np.arcsinh(-0.5 * np.exp(0.6 / A)), 0.0]
    return solve_ivp(rates, (0, t1), start, method="Radau", rtol=1e-8, atol=[1e-12, 1e-10, 1e-10], dense_output=True)


def slip_of(w, z):
    return 2 * SPEED * np.sinh(w) * np.exp(-(0.6 + B * z) / A)


@pytest.mark.slow
def test_speeds_between_steps_of_smooth_sliding():
    """As exact as at the ends of steps: there a curve by values of the logarithm alone would be off by 1e-4."""
    stiffness, t1 = 1.2 * CRITICAL, 600.0
    y0 = (0.6 * NORMAL / stiffness + 1e-6, 0.0)
    law = ss.DieterichRuina(0.6, A, B, length=LENGTH, reference_speed=SPEED)
    method = ss.Regularized(rtol=1e-6, threshold=1e-9, minimum_duration=1.0)
    one = ss.simulate(ss.MassSpring(MASS, stiffness, NORMAL, law), ss.Constant(SPEED), t1=t1, y0=y0, method=method)
    run = in_logarithms(stiffness, y0, t1)
    times, (_, w, z) = run.t[5:], run.y[:, 5:]
    assert len(np.unique(one._path.t)) < 0.5 * len(times)
    np.testing.assert_allclose(np.asarray(one.evaluate(times)[1]) - SPEED, slip_of(w, z), rtol=3e-6)


@pytest.mark.slow
def test_extremes_of_slow_slip_as_outputs():
    """Those of the path: a mass that nearly rests on its base is never faster than that."""
    stiffness = 0.2 * CRITICAL
    law = ss.DieterichRuina(0.6, A, B, length=LENGTH, reference_speed=SPEED)
    system, method = ss.MassSpring(MASS, stiffness, NORMAL, law), ss.Regularized(threshold=1e-9, minimum_duration=1.0)
    y0 = (0.6 * NORMAL / stiffness + np.array([1e-8, 1e-7]), np.zeros(2))
    many = ss.simulate_ensemble(
        system, ss.Constant(SPEED), t1=2500.0, samples=2, y0=y0, method=method, keep="totals", progress=False,
        outputs={"fastest": lambda one: one.maximum("velocity"), "slowest": lambda one: one.minimum("velocity")},
    )  # fmt: skip
    for i, start in enumerate(y0[0]):
        one = ss.simulate(system, ss.Constant(SPEED), t1=2500.0, y0=(start, 0.0), method=method)
        assert many.output_values["fastest"][i] == pytest.approx(float(one.maximum("velocity")), rel=1e-9)
        assert many.output_values["slowest"][i] == pytest.approx(float(one.minimum("velocity")), rel=1e-3)
    assert np.all(many.output_values["fastest"] <= SPEED * (1 + 1e-12))


@pytest.mark.slow
def test_a_cycle_of_earthquakes_against_scipy():
    """The speed falls from 0.3 to 1e-14 m/s; scipy integrates its logarithm."""
    stiffness, t1 = 0.2 * CRITICAL, 2500.0
    y0 = (0.6 * NORMAL / stiffness + 1e-8, 0.0)
    law = ss.DieterichRuina(0.6, A, B, length=LENGTH, reference_speed=SPEED)
    system = ss.MassSpring(MASS, stiffness, NORMAL, law)
    method = ss.Regularized(threshold=1e-9, minimum_duration=1.0)
    one = ss.simulate(system, ss.Constant(SPEED), t1=t1, y0=y0, method=method)
    assert one.status == ss.Status.FINISHED
    assert one.method.max_steps == 16384

    run = in_logarithms(stiffness, y0, t1)
    assert one.final_state[0] == pytest.approx(run.y[0, -1], rel=3e-4)
    times = np.linspace(0.0, t1, 40_001)
    found, expected = (times[np.argmin(np.diff(x))] for x in (np.asarray(one.evaluate(times)[0]), run.sol(times)[0]))
    assert found == pytest.approx(expected, rel=1e-3)
    # Between steps too the speed has its size, over all decades: no wave of a cubic.
    fine = ss.simulate(system, ss.Constant(SPEED), t1=t1, y0=y0, method=dataclasses.replace(method, rtol=1e-7))
    (_, w, z), slip = run.sol(times), np.asarray(fine.evaluate(times)[1]) - SPEED
    speeds = slip_of(w, z)
    assert np.min(np.abs(speeds)) < 1e-12
    np.testing.assert_array_equal(np.sign(slip), np.sign(speeds))
    off = np.abs(np.log10(np.abs(slip)) - np.log10(np.abs(speeds)))
    assert np.max(off) < 0.1  # at an event, where the speed falls by four decades in a tenth of a second
    assert np.mean(off < 0.001) > 0.999
    assert float(fine.maximum("velocity")) <= SPEED


@pytest.mark.slow
def test_recurrence_of_slip_events_against_scipy():
    share, t1 = 0.9, 1200.0
    one = slider(share, "ageing", t1)

    def rates(t, y):
        v = y[1] - SPEED
        force = A * np.arcsinh(v / (2 * SPEED) * np.exp((0.6 + B * y[2]) / A))
        return [
            y[1],
            (-share * CRITICAL * y[0] - NORMAL * force) / MASS,
            SPEED / LENGTH * np.exp(-y[2]) - abs(v) / LENGTH,
        ]

    y0 = [0.6 * NORMAL / (share * CRITICAL) + 1e-8, 0.0, 0.0]
    run = solve_ivp(rates, (0, t1), y0, method="Radau", rtol=1e-6, atol=[1e-12, 1e-12, 1e-8], dense_output=True)

    def events(position):
        fine = np.linspace(600, t1, 60_001)
        x = position(fine)
        return fine[1:-1][(x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:]) & (x[1:-1] > np.mean(x))]

    found, expected = events(lambda t: np.asarray(one.evaluate(t)[0])), events(lambda t: run.sol(t)[0])
    assert len(expected) >= 5
    assert np.mean(np.diff(found)) == pytest.approx(np.mean(np.diff(expected)), rel=1e-3)


def two_blocks(law, coupling=0.0):
    contacts = tuple(ss.Contact.of_mass(i, 2, 1.0, law) for i in range(2))
    stiffness = np.array([[2.0 + coupling, -coupling], [-coupling, 2.5 + coupling]])
    return ss.LinearStructure(np.ones(2), stiffness, None, contacts)


@pytest.mark.slow
def test_two_contacts_against_scipy():
    one = ss.simulate(two_blocks(LUGRE, 0.7), ss.Constant(0.1), t1=15.0, method=ACCURATE)

    def rates(t, y):
        force, rate = zip(*(bristles(y[2 + i] - 0.1, y[4 + i]) for i in range(2)), strict=True)
        pull = -np.array([[2.7, -0.7], [-0.7, 3.2]]) @ y[:2] - np.array(force)
        return [*y[2:4], *pull, *rate]

    run = solve_ivp(rates, (0, 15), np.zeros(6), method="Radau", rtol=1e-10, atol=1e-14, dense_output=True)
    np.testing.assert_allclose(one.final_state, run.y[:, -1], rtol=0, atol=1e-6)
    for contact in range(2):
        least = [float(np.asarray(number)[contact]) for number in (one.method.threshold, one.method.minimum_duration)]
        spans = below(run, lambda y, i=contact: y[2 + i] - 0.1, *least)
        found = np.stack(listed(one.of_contact(contact).sticks), axis=1)
        np.testing.assert_allclose(found, spans, rtol=0, atol=1e-4)


@pytest.mark.slow
def test_contact_that_opens():
    """A normal force that becomes negative: without friction, and no stick, while the contact is open."""
    normal = ss.Harmonic(1.5, 2.0, offset=1.0)
    system = ss.MassSpring(1.0, 4.0, normal, LUGRE)
    one = ss.simulate(system, ss.Constant(0.1), t1=8.0, y0=(0.3, 0.0), method=ACCURATE)

    def rates(t, y):
        force, rate = bristles(y[1] - 0.1, y[2])
        return [y[1], -4 * y[0] - max(1 + 1.5 * math.cos(2 * t), 0) * force, rate]

    run = solve_ivp(rates, (0, 8), [0.3, 0, 0], method="Radau", rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(one.final_state, run.y[:, -1], rtol=0, atol=1e-6)
    starts, ends = listed(one.sticks)
    assert len(starts)
    for start, end in zip(starts, ends, strict=True):
        assert np.all(1 + 1.5 * np.cos(2 * np.linspace(start, end, 100)) > -1e-3)


CART_LAW = ss.LuGre(0.3, 0.4, 0.05, stiffness=2e4, damping=20.0, viscous=0.1)


@pytest.mark.slow
def test_a_motor_and_its_cart_against_scipy():
    """The law is that of the cart, not of the pin that moves it: past dead centre, where the cart reverses, too."""
    system, voltage = ss.MotorCart(friction=CART_LAW), ss.SourceVoltage(cart.MEAN, cart.AMPLITUDE, cart.FREQUENCY)
    one = ss.simulate(system, voltage, t1=0.6, y0=(2.0, 5.0, 0.0), method=ACCURATE)

    def rates(t, y):
        angle, speed, current, z = y
        sine, cosine = math.sin(angle), math.cos(angle)
        v = -cart.ARM * sine * speed
        bent = v - 2e4 * abs(v) * z / (0.3 + 0.1 * math.exp(-((v / 0.05) ** 2)))
        force = (2e4 * z + 20 * bent + 0.1 * v) * cart.MASS * 9.81
        torque = cart.CONSTANT * current - cart.DAMPING * speed - cart.MASS * cart.ARM**2 * sine * cosine * speed**2
        torque += force * cart.ARM * sine
        across = cart.voltage(t) - cart.RESISTANCE * current - cart.CONSTANT * speed
        return [speed, torque / (cart.INERTIA + cart.MASS * cart.ARM**2 * sine**2), across / cart.INDUCTANCE, bent]

    run = solve_ivp(rates, (0, 0.6), [2.0, 5.0, 0, 0], method="Radau", rtol=1e-10, atol=1e-13, dense_output=True)
    assert np.ptp(run.y[0]) > math.pi
    np.testing.assert_allclose(one.final_state, run.y[:, -1], rtol=0, atol=1e-5)
    least = float(one.method.threshold), float(one.method.minimum_duration)
    spans = below(
        run, lambda y: cart.ARM * y[1], *least, 2 * 0.4 / 2e4, lambda y: np.abs(cart.ARM * np.sin(y[0]) * y[1])
    )
    assert len(spans)
    np.testing.assert_allclose(np.stack(listed(one.sticks), axis=1), spans, rtol=0, atol=1e-4)
    times = np.array([0.05, 0.2, 0.3])
    # The force on the cart is that of the law, against its velocity.
    angle, speed, _, z = run.sol(times)
    v = -cart.ARM * np.sin(angle) * speed
    bent = v - 2e4 * np.abs(v) * z / (0.3 + 0.1 * np.exp(-((v / 0.05) ** 2)))
    force = -(2e4 * z + 20 * bent + 0.1 * v) * cart.MASS * 9.81
    np.testing.assert_allclose(one.friction_force(times), force, rtol=0, atol=0.05)
    with pytest.raises(ValueError, match=r"Argument method must be Regularized\(\) for friction laws with an inner"):
        ss.simulate(system, voltage, t1=0.6, y0=(2.0, 5.0, 0.0))


class Own(ss.SwitchedSystem):
    """The mass on a spring as a system of one's own."""

    law: ss.DynamicFriction
    normal: float = 1.0

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    @property
    def inner_laws(self):
        return (self.law,)

    def rates(self, t, y, base, friction):
        return y[1], -2 * y[0] - self.normal * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2 * math.pi / 2**0.5

    @property
    def speed_scale(self):
        return 1.0


class Owns(ss.SwitchedSystem):
    """Two blocks in a row, the second of which is pressed on by the spring between them."""

    laws: tuple[ss.DynamicFriction, ...]
    contacts = 2

    @property
    def state_names(self):
        return "position 1 in m", "position 2 in m", "velocity 1 in m/s", "velocity 2 in m/s"

    @property
    def inner_laws(self):
        return self.laws

    def rates(self, t, y, base, friction):
        pull = 0.7 * (y[1] - y[0])
        return y[2], y[3], pull - 2 * y[0] - friction[0], -pull - 2.5 * y[1] - friction[1]

    def relative_velocity(self, t, y, base):
        return y[2] - base.velocity, y[3] - base.velocity

    def normal_forces(self, t, y, base):
        return 1.0 + 0 * t, 1.0 + 0.3 * y[0]

    @property
    def shortest_time(self):
        return 3.0  # of the stiffer spring


@pytest.mark.slow
def test_equations_of_ones_own_against_scipy():
    one = ss.simulate(Own(LUGRE), ss.Constant(0.1), t1=20.0, method=ACCURATE)

    def rates(t, y):
        force, rate = bristles(y[1] - 0.1, y[2])
        return [y[1], -2 * y[0] - force, rate]

    run = solve_ivp(rates, (0, 20), [0, 0, 0], method="Radau", rtol=1e-10, atol=1e-14, dense_output=True)
    np.testing.assert_allclose(one.final_state, run.y[:, -1], rtol=0, atol=1e-6)
    spans = below(run, lambda y: y[1] - 0.1, float(one.method.threshold), float(one.method.minimum_duration))
    np.testing.assert_allclose(np.stack(listed(one.sticks), axis=1), spans, rtol=0, atol=1e-4)
    assert [c.meaning for c in one.system.coordinates][-1] == "deflection in m"
    with pytest.raises(ValueError, match="friction_force needs a MassSpring, a MotorCart"):
        one.friction_force(1.0)


@pytest.mark.slow
def test_several_contacts_of_ones_own_against_scipy():
    method = dataclasses.replace(ACCURATE, threshold=1e-3, minimum_duration=0.01)
    one = ss.simulate(Owns((LUGRE, LUGRE)), ss.Constant(0.1), t1=8.0, y0=(0.3, -0.2, 0.0, 0.0), method=method)

    def rates(t, y):
        force, rate = zip(*(bristles(y[2 + i] - 0.1, y[4 + i]) for i in range(2)), strict=True)
        pull = 0.7 * (y[1] - y[0])
        second = -pull - 2.5 * y[1] - (1 + 0.3 * y[0]) * force[1]
        return [*y[2:4], pull - 2 * y[0] - force[0], second, *rate]

    run = solve_ivp(rates, (0, 8), [0.3, -0.2, 0, 0, 0, 0], method="Radau", rtol=1e-10, atol=1e-14, dense_output=True)
    np.testing.assert_allclose(one.final_state, run.y[:, -1], rtol=0, atol=1e-6)
    for contact in range(2):
        spans = below(run, lambda y, i=contact: y[2 + i] - 0.1, 1e-3, 0.01)
        found = np.stack(listed(one.of_contact(contact).sticks), axis=1)
        np.testing.assert_allclose(found, spans, rtol=0, atol=1e-4)


class TooFew(Owns):
    @property
    def inner_laws(self):
        return self.laws[:1]


class WithRatio(Own):
    static_ratio = 1.5


class Unseen(Own):
    @property
    def coordinates(self):
        return tuple(map(ss.Coordinate.of, self.state_names))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "message"),
    [
        (Own(ss.Coulomb(0.3)), "Argument inner_laws of a Own must be a tuple of friction laws with an inner state"),
        (TooFew((LUGRE,)), "Argument inner_laws of a TooFew must hold a law for each of its contacts, 2, but 1 were"),
        (WithRatio(LUGRE), "Argument inner_laws of a WithRatio must come without static_ratio"),
        (Unseen(LUGRE), "Argument coordinates of a Unseen must end with the inner states of its laws"),
    ],
)
def test_laws_of_ones_own_equations_that_do_not_fit(system, message, annotations_unchecked):
    with pytest.raises(ValueError, match=message):
        ss.simulate(system, ss.Constant(0.1), t1=1.0, method=ACCURATE)


SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.LuGre(0.5, 0.7, 0.05, stiffness=1e3, damping=10.0))
LAW = ss.PoissonSwitching(0.5, rate=0.5)


@pytest.mark.slow
def test_ensembles_are_single_runs(tmp_path):
    key = jax.random.key(2)
    method = ss.Regularized(rtol=1e-6, max_steps=6000)
    many = ss.simulate_ensemble(
        SYSTEM, LAW, t1=20.0, samples=4, key=key, y0=(0.3, 0.1), method=method, keep="totals", progress=False
    )
    for sample in range(2):
        base = LAW.sample(jax.random.fold_in(key, sample), 20.0)
        one = ss.simulate(SYSTEM, base, t1=20.0, y0=(0.3, 0.1), method=method)
        # XLA rounds one lane otherwise than eight, which adaptive steps enlarge: far less than `rtol`.
        assert float(many.totals.stick_time[sample]) == pytest.approx(float(one.stick_time), rel=1e-8)
        assert int(many.totals.sticks[sample]) == int(one.sticks.count)
    many.save(tmp_path / "many.nc")
    assert str(ss.load(tmp_path / "many.nc").system) == str(SYSTEM)


@pytest.mark.slow
def test_sensitivity_by_common_random_numbers():
    """By a stiff law it is that of Coulomb friction, exactly simulated."""
    law = ss.LuGre(0.5, 0.5, 0.05, stiffness=1e4, damping=100.0)
    settings = {"t1": 10.0, "key": jax.random.key(5), "y0": (0.3, 0.1), "wrt": "normal_force"}
    method = ss.Regularized(threshold=3e-3, minimum_duration=0.1, rtol=1e-4)
    of_lugre = ss.sensitivity(
        "mean_total_stick_time", ss.MassSpring(1.0, 4.0, 1.0, law), LAW, method=method, samples=32, **settings
    )
    coulomb = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
    exact = ss.sensitivity("mean_total_stick_time", coulomb, LAW, samples=4000, **settings)
    assert of_lugre.value > 3 * of_lugre.standard_error
    error = math.hypot(of_lugre.standard_error, exact.standard_error)
    assert abs(of_lugre.value - exact.value) < 4 * error + 0.05 * exact.value


@pytest.mark.slow
def test_derivative_of_a_last_state():
    def last(mu):
        law = ss.LuGre(mu, mu + 0.2, 0.05, stiffness=1e3, damping=10.0)
        method = ss.Regularized(rtol=1e-9, solver=diffrax.Kvaerno5(), max_steps=20_000)
        one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, law), ss.Harmonic(0.4, 0.7), t1=6.0, method=method)
        return one.final_state[0]

    few = 1e-4
    difference = (last(0.5 + few) - last(0.5 - few)) / (2 * few)
    assert float(jax.grad(last)(0.5)) == pytest.approx(float(difference), rel=1e-3)


class Bent(ss.Dahl):
    @property
    def initial_state(self):
        return 1e-4


@pytest.mark.slow
def test_an_inner_state_that_is_not_zero_at_rest_is_where_motions_begin():
    """In one trajectory, and in an ensemble whose starts are random."""
    system, base, method = ss.MassSpring(1.0, 4.0, 1.0, Bent(0.4, 1e3)), ss.Constant(0.1), ss.Regularized()
    given = ss.simulate(system, base, t1=2.0, y0=(0.0, 0.0, 1e-4), method=method)
    for y0 in (None, (0.0, 0.0), np.zeros(2)):
        one = ss.simulate(system, base, t1=2.0, y0=y0, method=method)
        np.testing.assert_array_equal(one.final_state, given.final_state)
    assert float(one.evaluate(0.0)[2]) == 1e-4
    settings = {"t1": 2.0, "samples": 2, "key": jax.random.key(0), "method": method, "keep": "totals"}
    first, second = (
        ss.simulate_ensemble(system, LAW, y0=(ss.Uniform(0.1, 0.2), 0.0, *inner), progress=False, **settings)
        for inner in ((), (1e-4,))
    )
    np.testing.assert_array_equal(first.totals.stick_time, second.totals.stick_time)


@pytest.mark.slow
def test_a_motion_goes_on_from_its_last_state():
    method = ss.Regularized(rtol=1e-9, solver=diffrax.Kvaerno5(), max_steps=20_000)
    whole, first = (ss.simulate(SYSTEM, ss.Constant(0.2), t1=t1, method=method) for t1 in (12.0, 5.0))
    rest = ss.simulate(SYSTEM, ss.Constant(0.2), t1=7.0, y0=first.final_state, method=method)
    np.testing.assert_allclose(rest.final_state, whole.final_state, rtol=0, atol=1e-6)


def test_what_does_not_fit_is_told(annotations_unchecked):
    mixed = ss.LinearStructure(
        np.ones(2), np.eye(2), None,
        (ss.Contact.of_mass(0, 2, 1.0, LUGRE), ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(0.3))),
    )  # fmt: skip
    base = ss.Constant(0.1)
    for system, method, message in (
        (SYSTEM, ss.Exact(), r"Argument method must be Regularized\(\) for friction laws with an inner state"),
        (SYSTEM, ss.Regularized(1e-3), "Argument method must be Regularized.. without a width"),
        (SYSTEM, ss.Regularized(step=1e-3), "Argument method must be Regularized.. without a width"),
        (ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3)), ss.Regularized(), "Argument width must be positive"),
        (mixed, ss.Regularized(), "Argument contacts must all have friction laws with an inner state, or none"),
    ):
        with pytest.raises(ValueError, match=message):
            ss.simulate(system, base, t1=1.0, method=method)
    with pytest.raises(ValueError, match="Argument method must be Regularized"):
        ss.simulate_ensemble(SYSTEM, LAW, t1=1.0, samples=2, key=jax.random.key(0))
    assert jnp.ndim(SYSTEM.friction.kinetic(jnp.zeros(()))) == 0
