"""Self-checks of the event-driven reference against exact results, published numbers and independent integration."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from .event_by_event import simulate_reference
from .event_driven import Run, Stick, den_hartog_amplitude, simulate_mass_spring, simulate_motor_cart


def zero(t, piece):
    return 0.0


PLAIN = {"mass": 1.0, "stiffness": 1.0, "damping": 0.0, "normal_force": 1.0, "mu_static": 1.0, "mu_kinetic": 1.0}
PLAIN |= {"base_velocity": zero, "base_acceleration": zero, "force": zero}
TABLE_1 = SimpleNamespace(
    l=1.88e-4, r=0.307, k_e=0.0533, j_m=1.21e-4, b_m=1.545e-4, m=5.0, d=0.01, nu0=1.0, nu1=0.5, omega_v=10.0, g=9.81
)


def endings(run: Run) -> list[str]:
    return [stick.ending for stick in run.sticks]


def largest_difference(one: Run, two: Run) -> float:
    """Of all numbers of two runs with the same events."""
    assert endings(one) == endings(two)
    pair = [np.concatenate([run.crossings, *[s[:3] for s in run.sticks], run.final_state]) for run in (one, two)]
    return float(np.max(np.abs(pair[0] - pair[1])))


def disode45(**options) -> Run:
    moving = {"base_velocity": lambda t, _: math.cos(t) + 0.7, "base_acceleration": lambda t, _: -math.sin(t)}
    forced = {"force": lambda t, _: math.cos(0.7 * t), "damping": 0.4, "mu_static": 0.4, "mu_kinetic": 0.4}
    return simulate_mass_spring(**PLAIN | moving | forced, t1=30.0, y0=(3.0, 0.0), **options)


def leine(t1: float, y0: tuple[float, float]) -> Run:
    law = {"mu_kinetic": lambda slip: 1 / (1 + 3 * slip), "base_velocity": lambda t, _: 0.2}
    return simulate_mass_spring(**PLAIN | law, t1=t1, y0=y0)


def test_periodic_orbit_of_leine():
    run = leine(42.0, (1.0, 0.2))  # on the edge of the band, which a stick would leave: the orbit's release
    assert endings(run) == ["RELEASED", "RELEASED", "RELEASED", "HORIZON"]
    assert run.crossings == []
    for n, stick in enumerate(run.sticks):
        assert stick.start == pytest.approx(4.2959995255 + n * 12.0010312948, abs=3e-10)
        assert stick.position == pytest.approx(-0.541006353870, abs=3e-12)
    for stick in run.sticks[:-1]:
        assert stick.end - stick.start == pytest.approx(7.7050317694, abs=1e-10)
        assert run.state_at(stick.end) == pytest.approx((1.0, 0.2), abs=1e-12)
    turn = brentq(lambda t: run.state_at(t)[1], 0.5, 1.5)
    assert run.state_at(turn)[0] == pytest.approx(1.133944669704, abs=5e-8)
    from_there = leine(20.0, (1.133944669704, 0.0))
    assert from_there.sticks[0].position == pytest.approx(-0.541006353870, abs=5e-8)
    assert from_there.sticks[1].start - from_there.sticks[0].start == pytest.approx(12.0010312948, abs=1e-7)


def test_moving_base_with_forcing():
    run = disode45()
    assert run.crossings == pytest.approx([7.60556996, 14.80510569, 17.45893964], abs=1e-8)
    assert endings(run) == ["RELEASED", "RELEASED"]
    instants = [instant for stick in run.sticks for instant in stick[:2]]
    assert instants == pytest.approx([9.48337858, 9.76525875, 26.13168182, 27.29115689], abs=1e-8)
    assert run.final_state == pytest.approx([0.1905966316, -1.135390731], abs=1e-9)
    best = disode45(rtol=5e-14, max_step=0.03)
    assert largest_difference(run, best) < 1e-12
    assert largest_difference(disode45(rtol=1e-9), best) < 1e-10


def test_free_oscillator_on_fixed_base():
    run = simulate_mass_spring(**PLAIN | {"mu_static": 0.4, "mu_kinetic": 0.4}, t1=20.0, y0=(3.0, 0.0))
    assert run.crossings == pytest.approx(np.pi * np.arange(1, 4), abs=1e-12)
    turns = [run.state_at(t)[0] for t in run.crossings]
    assert turns == pytest.approx([-2.2, 1.4, -0.6], abs=1e-12)
    assert endings(run) == ["HORIZON"]
    assert run.sticks[0][:3] == pytest.approx((4 * math.pi, 20.0, -0.2), abs=1e-12)
    assert run.final_state == pytest.approx([-0.2, 0.0], abs=1e-12)


HARTOG = [(0.8, 0.2, 2.71142), (0.8, 0.5, 2.33223), (1.5, 0.3, 0.72111), (2.0, 0.2, 0.31798)]


@pytest.mark.parametrize(("b", "ratio", "amplitude"), HARTOG)
def test_steady_forced_motion_of_den_hartog(b, ratio, amplitude):
    x0 = den_hartog_amplitude(b, ratio)
    assert x0 == pytest.approx(amplitude, abs=6e-6)
    v, u = 1 / (1 - b * b), math.sin(math.pi / b) / (b * (1 + math.cos(math.pi / b)))
    phase = math.atan2(-u * ratio / v, x0 / v)
    forced = {"force": lambda t, _: math.cos(b * t + phase), "mu_static": ratio, "mu_kinetic": ratio}
    run = simulate_mass_spring(**PLAIN | forced, t1=10.5 * math.pi / b, y0=(x0, 0.0))
    assert run.sticks == []
    assert run.crossings == pytest.approx(math.pi / b * np.arange(1, 11), abs=1e-9)
    turns = [run.state_at(t)[0] for t in run.crossings]
    assert turns == pytest.approx(x0 * np.resize([-1.0, 1.0], 10), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_switching_base_against_event_by_event(seed):
    source = np.random.default_rng(seed)
    mass, stiffness, normal_force, mu = np.exp(source.uniform(-1.5, 1.5, 4))
    omega, a = math.sqrt(stiffness / mass), mu * normal_force / stiffness
    speed = a * omega * [0.05, 0.3, 1.0, 3.0, 20.0][seed % 5]
    durations = source.exponential(1 / omega, 12) / [0.1, 0.3, 1.0][seed % 3]
    velocities = speed * source.choice([-1.0, 1.0] if seed % 2 else [-1.0, 0.0, 0.5, 2.0], 12)
    t1, x0 = 0.999 * sum(durations), a * (1 + speed / (a * omega)) * source.uniform(-1, 1)
    y0 = (float(x0), float(speed * source.uniform(-1, 1)))
    system = {"mass": mass, "stiffness": stiffness, "normal_force": normal_force}
    schedule = {"durations": list(durations), "velocities": list(velocities), "t1": t1}
    exact = simulate_reference(**system, mu=mu, **schedule, position0=y0[0], velocity0=y0[1])
    base = {"base_velocity": lambda _, piece: velocities[piece], "mu_static": mu, "mu_kinetic": mu}
    run = simulate_mass_spring(**PLAIN | system | base, breaks=np.cumsum(durations)[:-1], t1=t1, y0=y0)
    assert endings(run) == [stick.ending for stick in exact.sticks]
    assert len(run.crossings) == exact.crossings
    for got, stick in zip(run.sticks, exact.sticks, strict=True):
        assert got[:2] == pytest.approx((float(stick.start), float(stick.end)), abs=1e-11 / omega)
        assert got.position == pytest.approx(float(stick.position), abs=1e-11 * a)
    size = max(a, abs(x0), speed / omega)
    assert run.final_state[0] == pytest.approx(float(exact.final_position), abs=1e-11 * size)
    assert run.final_state[1] == pytest.approx(float(exact.final_velocity), abs=1e-11 * size * omega)


@pytest.mark.slow
@pytest.mark.parametrize("v", np.linspace(0.1, 3.0, 8))
def test_released_mass_does_not_stick_where_it_touches(v):
    run = simulate_mass_spring(**PLAIN | {"base_velocity": lambda t, _: v}, t1=100.0, y0=(0.3, v))
    assert endings(run) == ["RELEASED"]
    assert run.sticks[0][:3] == pytest.approx((0.0, 0.7 / v, 0.3), abs=1e-12)
    assert run.crossings == []
    angle = 100.0 - 0.7 / v
    assert run.final_state == pytest.approx([1 + v * math.sin(angle), v * math.cos(angle)], abs=1e-10)


def test_stick_soon_after_a_release():
    # No spring. x' = 2 - t from the edge of the band on, and x' - v = k t^2 (d - t) until they meet at d.
    k, d = 1e5, 1e-5
    base = {"base_velocity": lambda t, _: 2 - t - k * t * t * (d - t), "stiffness": 0.0}
    base |= {"base_acceleration": lambda t, _: -1 - k * (2 * d * t - 3 * t * t)}
    run = simulate_mass_spring(**PLAIN | base, t1=0.01, y0=(0.0, 2.0), max_step=0.1)
    assert run.sticks[0][:2] == pytest.approx((d, (k * d + math.sqrt((k * d) ** 2 + 6 * k)) / (3 * k)), abs=1e-10)


def test_static_friction_above_kinetic():
    mu, static, v = 0.5, 0.8, 0.3  # m = k = n = 1: everything is known
    law = {"mu_static": static, "mu_kinetic": mu, "base_velocity": lambda t, _: v}
    run = simulate_mass_spring(**PLAIN | law, t1=40.0, y0=(0.2, v))
    slip = 2 * (math.pi - math.atan((static - mu) / v))
    stick = 2 * (static - mu) / v
    ends = 2.0 + (slip + stick) * np.arange(4)
    assert [item.end for item in run.sticks[:4]] == pytest.approx(ends, abs=1e-11)
    assert [item.start for item in run.sticks[1:4]] == pytest.approx(ends[1:] - stick, abs=1e-11)
    assert [item.position for item in run.sticks[1:4]] == pytest.approx([2 * mu - static] * 3, abs=1e-11)
    assert endings(run)[:4] == ["RELEASED"] * 4


def test_velocity_jump_ends_a_stick():
    base = {"base_velocity": lambda _, piece: (0.1, 0.1, -0.1)[piece]}
    run = simulate_mass_spring(**PLAIN | base, breaks=(1.0, 2.0), t1=2.1, y0=(0.0, 0.1))
    assert run.sticks == [Stick(0.0, 2.0, 0.0, "BASE_SWITCHED")]  # and a break without a jump does not
    angle = 0.1  # on the circle about -1 that follows
    turned = [-1 + 1.2 * math.cos(angle) + 0.1 * math.sin(angle), 0.1 * math.cos(angle) - 1.2 * math.sin(angle)]
    assert run.final_state == pytest.approx(turned, abs=1e-12)


def test_kink_of_the_base_ends_a_stick():
    def base(ramp):  # at rest to t = 1, then faster and faster to t = 2, then steady
        velocity = {"base_velocity": lambda t, piece: (0.0, ramp * (t - 1), ramp)[piece]}
        return {"stiffness": 0.0, "base_acceleration": lambda _, piece: (0.0, ramp, 0.0)[piece]} | velocity

    fast = simulate_mass_spring(**PLAIN | base(3.0), breaks=(1.0, 2.0), t1=5.0, y0=(0.0, 0.0))
    assert fast.sticks[0] == Stick(0.0, 1.0, 0.0, "RELEASED")
    assert fast.sticks[1][:3] == pytest.approx((4.0, 5.0, 4.5), abs=1e-12)
    assert endings(fast)[1:] == ["HORIZON"]
    assert fast.final_state == pytest.approx([7.5, 3.0], abs=1e-12)
    slow = simulate_mass_spring(**PLAIN | base(0.5), breaks=(1.0, 2.0), t1=5.0, y0=(0.0, 0.0))
    assert slow.sticks == [Stick(0.0, 5.0, 0.0, "HORIZON")]
    assert slow.final_state == pytest.approx([1.75, 0.5], abs=1e-12)


def test_force_jump_ends_a_stick_and_a_later_one_restores_it():
    push = {"force": lambda _, piece: (0.9, 2.0, 0.0)[piece], "stiffness": 0.0}
    run = simulate_mass_spring(**PLAIN | push, breaks=(1.0, 2.0), t1=5.0, y0=(0.0, 0.0))
    assert run.sticks[0] == Stick(0.0, 1.0, 0.0, "RELEASED")
    assert run.sticks[1][:3] == pytest.approx((3.0, 5.0, 1.0), abs=1e-12)


@pytest.mark.parametrize("depth", [1e-2, 1e-5, 1e-8])
def test_short_stick_in_a_dip_between_samples(depth):
    # No spring. The mass slows down as 2 - t, and x' - v = (t - 1)^2 - depth until they meet. In the stick the needed
    # force is -1 - 2 (t - 1) and leaves its band at t = 1.
    def base(depth):
        velocity = {"base_velocity": lambda t, _: 2 - t - (t - 1) ** 2 + depth}
        return {"stiffness": 0.0, "base_acceleration": lambda t, _: -1 - 2 * (t - 1)} | velocity

    run = simulate_mass_spring(**PLAIN | base(depth), t1=1.7, y0=(0.0, 2.0))
    assert endings(run) == ["RELEASED"]
    assert run.sticks[0].start == pytest.approx(1 - math.sqrt(depth), abs=1e-14 / math.sqrt(depth))
    assert run.sticks[0].end == pytest.approx(1.0, abs=1e-14)
    assert run.crossings == []
    assert run.final_state[1] == pytest.approx(2 - 1.7 + depth, abs=1e-12)
    missed = simulate_mass_spring(**PLAIN | base(-depth), t1=1.7, y0=(0.0, 2.0))
    assert (missed.sticks, missed.crossings) == ([], [])


def test_motion_is_continuous_through_events():
    run = disode45()
    for t in [*run.crossings, *[instant for stick in run.sticks for instant in stick[:2]]]:
        assert run.state_at(t - 1e-11) == pytest.approx(run.state_at(t + 1e-11), abs=1e-10)
    for stick in run.sticks:
        middle = (stick.start + stick.end) / 2
        assert run.state_at(middle)[1] == pytest.approx(math.cos(middle) + 0.7, abs=1e-13)


def test_bad_arguments():
    with pytest.raises(ValueError, match="mu_kinetic"):
        simulate_mass_spring(**PLAIN | {"mu_static": 0.9}, t1=1.0, y0=(0.0, 0.0))
    with pytest.raises(ValueError, match="breaks"):
        simulate_mass_spring(**PLAIN, breaks=(0.5, 0.5), t1=1.0, y0=(0.0, 0.0))


def upper_bound(mu: float, angle: float) -> float:
    """Of the duration of a stick at `angle`, from the steady current (eqs 7-10 of the paper, with omega_v restored)."""
    p = TABLE_1
    amplitude = p.nu1 / math.hypot(p.r, p.l * p.omega_v)
    band = mu * p.m * p.g * p.d * abs(math.sin(angle))
    s = (band / p.k_e - p.nu0 / p.r) / amplitude
    return (math.pi + 2 * math.asin(max(s, -1.0))) / p.omega_v if s < 1 else math.inf


def random_starts(count: int, seed: int) -> list[dict[str, float]]:
    source = np.random.default_rng(seed)
    return [dict(zip(("theta", "alpha0"), source.uniform(0, 2 * math.pi, 2), strict=True)) for _ in range(count)]


def later_sticks(run: Run) -> list[Stick]:
    return [stick for stick in run.sticks if stick.start > 0]


def first_stick_by_library(mu: float, theta: float, alpha0: float, power: int) -> Stick | None:
    """First rest, slip and stick by scipy's own integrators and event finder, for a motor that turns forwards."""
    p = TABLE_1
    inertia, torque = p.m * p.d**2, mu * p.m * p.g * p.d

    def voltage(t):
        return p.nu0 + p.nu1 * math.sin(p.omega_v * t + theta)

    def slip(t, y):
        angle, speed, current = y
        sine, cosine = math.sin(angle), math.cos(angle)
        push = p.k_e * current - p.b_m * speed - inertia * sine * cosine * speed**power - torque * abs(sine)
        rate = (voltage(t) - p.r * current - p.k_e * speed) / p.l
        return [speed, push / (p.j_m + inertia * sine**2), rate]

    def release(t0, angle, current):
        def over(t, y):
            return p.k_e * y[0] - torque * abs(math.sin(angle))

        over.terminal, over.direction = True, 1
        stuck = (lambda t, y: [(voltage(t) - p.r * y[0]) / p.l], (t0, t0 + 1.0), [current])
        run = solve_ivp(*stuck, method="LSODA", events=over, rtol=1e-13, atol=1e-13)
        return run.t_events[0][0], run.y_events[0][0][0]

    def stops(t, y):
        return y[1]

    stops.terminal, stops.direction = True, -1
    t, current = release(0.0, alpha0, 0.0)
    run = solve_ivp(slip, (t, 0.6), [alpha0, 0.0, current], method="DOP853", events=stops, rtol=1e-12, atol=1e-13)
    if not len(run.t_events[0]):
        return None
    start, (angle, _, current) = run.t_events[0][0], run.y_events[0][0]
    return Stick(start, release(start, angle, current)[0], angle, "RELEASED")


@pytest.mark.slow_but_for("0.4-0.3668", "0.5-0.50828")
@pytest.mark.parametrize(("mu", "highest"), [(0.2, 0.10315), (0.3, 0.2522), (0.4, 0.3668), (0.5, 0.50828)])
def test_sticks_of_the_motor_keep_their_bound(mu, highest):
    assert upper_bound(mu, math.pi / 2) == pytest.approx(highest, abs=5e-5)
    sticks = []
    for start in [*random_starts(15, seed=3), {"theta": 1.0, "alpha0": 1.0}, {"theta": 0.5, "alpha0": 1.2}]:
        run = simulate_motor_cart(mu=mu, **start, t1=1.5)
        assert run.sticks[0].start == 0.0
        assert np.all(np.diff([instant for stick in run.sticks for instant in stick[:2]]) > 0)
        sticks += later_sticks(run)
    assert len(sticks) >= (1 if mu == 0.2 else 15)
    for stick in sticks:
        assert stick.end - stick.start < upper_bound(mu, stick.position)
        assert mu * abs(math.sin(stick.position)) > 0.176982


@pytest.mark.slow
@pytest.mark.parametrize(("mu", "equation"), [(0.3, "printed"), (0.5, "physical")])
def test_motor_against_library_integrators(mu, equation):
    compared = 0
    for start in random_starts(10, seed=11):
        arguments = {"mu": mu, **start, "t1": 3.0, "equation": equation, "stop_after_first_stick": True}
        expected = first_stick_by_library(mu, *start.values(), power={"physical": 2, "printed": 1}[equation])
        if expected is not None:
            stick = later_sticks(simulate_motor_cart(**arguments))[0]
            assert stick[:3] == pytest.approx(expected[:3], abs=1e-9)
            compared += 1
    assert compared >= 5


@pytest.mark.slow_but_for("printed")
@pytest.mark.parametrize("equation", ["physical", "printed"])
def test_motor_is_converged(equation):
    for number, start in enumerate(random_starts(8, seed=5)):
        arguments = {"mu": 0.2 + 0.1 * (number % 4), **start, "t1": 2.0, "equation": equation}
        run, coarse = simulate_motor_cart(**arguments), simulate_motor_cart(**arguments, rtol=1e-9)
        finer = simulate_motor_cart(**arguments, rtol=1.5e-13)
        assert largest_difference(run, finer) < 1e-10
        assert largest_difference(run, coarse) < 1e-8
        for one, two in zip(run.sticks, finer.sticks, strict=True):
            assert one[:2] == pytest.approx(two[:2], abs=1e-12)


def test_motion_of_the_motor_satisfies_its_equations():
    p = TABLE_1
    theta, mu = 0.4, 0.4
    run = simulate_motor_cart(mu=mu, theta=theta, alpha0=1.1, t1=2.0)
    points, weights = np.polynomial.legendre.leggauss(10)
    inertia, torque = p.m * p.d**2, mu * p.m * p.g * p.d
    for before, after in itertools.pairwise(run.sticks):
        # Equal parts of the slip, short beside l / r; the momentum j alpha' and the flux l c gain what acts on them.
        edges = np.linspace(before.end, after.start, int((after.start - before.end) / 5e-4) + 2)
        for left, right in itertools.pairwise(edges):
            t = (left + right) / 2 + (right - left) / 2 * points
            angle, speed, current = np.array([run.state_at(one) for one in t]).T
            sine, cosine = np.sin(angle), np.cos(angle)
            if np.ptp(np.sign(sine)):
                continue  # the rule is not meant for the kink
            push = p.k_e * current - p.b_m * speed + inertia * sine * cosine * speed**2 - torque * abs(sine)
            drop = p.nu0 + p.nu1 * np.sin(p.omega_v * t + theta) - p.r * current - p.k_e * speed
            gains = (right - left) / 2 * weights @ np.array([speed, push, drop]).T
            one, two = run.state_at(left), run.state_at(right)
            momenta = [(p.j_m + inertia * math.sin(y[0]) ** 2) * y[1] for y in (one, two)]
            assert two[0] - one[0] == pytest.approx(gains[0], abs=1e-12)
            assert momenta[1] - momenta[0] == pytest.approx(gains[1], abs=1e-14)
            assert p.l * (two[2] - one[2]) == pytest.approx(gains[2], abs=1e-14)


def test_rest_at_the_start_is_a_stick():
    p, mu, angle = TABLE_1, 0.4, 0.9
    run = simulate_motor_cart(mu=mu, theta=0.3, alpha0=angle, t1=1.0)
    rest = run.sticks[0]
    assert (rest.start, rest.position, rest.ending) == (0.0, angle, "RELEASED")
    assert run.state_at(0.0) == pytest.approx([angle, 0.0, 0.0], abs=1e-15)
    current = mu * p.m * p.g * p.d * math.sin(angle) / p.k_e
    assert run.state_at(rest.end) == pytest.approx([angle, 0.0, current], abs=1e-13)
    voltage = (lambda t, y: [(1.0 + 0.5 * math.sin(10 * t + 0.3) - p.r * y[0]) / p.l], (0.0, rest.end), [0.0])
    by_library = solve_ivp(*voltage, method="DOP853", rtol=1e-12, atol=1e-14)
    assert by_library.y[0, -1] == pytest.approx(current, abs=1e-10)


def test_motor_that_sticks_for_ever():
    run = simulate_motor_cart(mu=0.6, theta=1.0, alpha0=math.pi / 2, t1=30.0)
    assert run.sticks == [Stick(0.0, 30.0, math.pi / 2, "HORIZON")]


@pytest.mark.parametrize("alpha0", [0.0, math.pi, 2 * math.pi, -math.pi])
def test_no_stick_where_the_band_is_empty(alpha0):
    run = simulate_motor_cart(mu=0.5, theta=2.0, alpha0=alpha0, t1=1.0, stop_after_first_stick=True)
    assert run.sticks[0].start > 0.05
    still = simulate_motor_cart(mu=0.5, theta=2.0, alpha0=alpha0 + 1e-3, t1=1.0)
    assert still.sticks[0].start == 0.0
    backwards = simulate_motor_cart(mu=0.5, theta=2.0, alpha0=alpha0, t1=0.02, current0=-2.0)
    assert backwards.sticks == []
    assert backwards.state_at(1e-4)[0] < alpha0
    assert len(backwards.crossings) == 1  # it turns round where its push exceeds the friction


def test_stop_after_first_stick():
    arguments = {"mu": 0.5, "theta": 2.5, "alpha0": 4.0}
    whole = simulate_motor_cart(**arguments, t1=3.0)
    first = simulate_motor_cart(**arguments, t1=3.0, stop_after_first_stick=True)
    assert len(whole.sticks) > 3
    assert first.sticks == whole.sticks[:2]
    assert first.final_state == pytest.approx(whole.state_at(first.sticks[-1].end), abs=1e-12)


def test_printed_equation_differs():
    arguments = {"mu": 0.5, "theta": 2.5, "alpha0": 2.9, "t1": 2.0, "stop_after_first_stick": True}
    physical, printed = simulate_motor_cart(**arguments), simulate_motor_cart(**arguments, equation="printed")
    assert physical.sticks[0] == printed.sticks[0]
    assert printed.sticks[1].position - physical.sticks[1].position == pytest.approx(0.09535, abs=1e-5)


def test_motor_turned_the_other_way():
    arguments = {"mu": 0.4, "theta": 0.8, "t1": 2.0}
    run = simulate_motor_cart(**arguments, alpha0=1.0)
    mirrored = simulate_motor_cart(**arguments, alpha0=-1.0, nu0=-1.0, nu1=-0.5)
    assert len(run.sticks) > 2
    for one, two in zip(run.sticks, mirrored.sticks, strict=True):
        assert two[:3] == pytest.approx((one.start, one.end, -one.position), abs=1e-12)
    assert mirrored.final_state == pytest.approx(-run.final_state, abs=1e-11)
