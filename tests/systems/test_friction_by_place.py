"""Friction that jumps from place to place, against an event-driven integration of its own."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, optimize

import stickslip_jax as ss

T1 = 18.0


def region_of(law, place):
    """The number of the region, and the places where it ends."""
    borders = [float(one) for one in law.places]
    if law.period is None:
        number = int(np.searchsorted(borders, place, side="right"))
        return number, ([-math.inf, *borders][number], [*borders, math.inf][number])
    turns = math.floor((place - borders[0]) / law.period)
    inside = place - turns * law.period
    number = int(np.searchsorted(borders, inside, side="right")) - 1
    ends = [*borders, borders[0] + law.period]
    return turns * len(borders) + number, (ends[number] + turns * law.period, ends[number + 1] + turns * law.period)


class Reference:
    """Slips by an integrator of eighth order, sticks by their formula; every event by bisection of its condition."""

    def __init__(self, system, base, y0):
        self.system, self.base, self.law = system, base, system.friction
        self.m, self.k, self.n = float(system.mass), float(system.stiffness), float(system.normal_force)
        self.c = 0.0 if system.damping is None else float(system.damping)
        self.t, self.y, self.sticks = 0.0, np.array([*y0, 0.0]), []

    def coefficients(self, region):
        law = self.law.laws[region % len(self.law.laws)]
        return float(law.mu), float(law.static)

    def place(self, y):
        return y[2] if self.law.on == "base" else y[0]

    def needed(self, t, x):
        return self.m * self.base.acceleration(t) + self.c * self.base.velocity(t) + self.k * x

    def run(self, t1):
        region, ends = region_of(self.law, self.place(self.y))
        slip = self.y[1] - self.base.velocity(0.0)
        sign = self.first(region) if abs(slip) < 1e-13 else np.sign(slip)
        while self.t < t1 - 1e-12:
            start = self.t, self.y[0]
            found, event = (self.stick if sign == 0 else self.slip)(t1, sign, region, ends)
            self.t, self.y = found
            if event is None:
                break
            place_rate = self.y[1] - self.base.velocity(self.t) if self.law.on == "base" else self.y[1]
            if event == "place":
                region, ends = self.next_region(region, ends, place_rate)
                if sign == 0 and abs(self.needed(self.t, self.y[0])) > self.coefficients(region)[1] * self.n:
                    self.ended(start)
                    sign = self.first(region)
                elif sign == 0:
                    self.joined(start)
            elif sign == 0:
                self.ended(start)
                sign = self.first(region)
            elif event == "rest":
                sign = self.first(region, -sign)
        if sign == 0:
            self.ended(start)
        return self

    def next_region(self, region, ends, rate):
        region += 1 if rate > 0 else -1
        middle = ends[1] if rate > 0 else ends[0]
        _, new = region_of(self.law, middle + 1e-9 * np.sign(rate))
        return region, new

    def first(self, region, otherwise=None):
        """The mode at rest: a stick, or the slip that the force makes."""
        needed = self.needed(self.t, self.y[0])
        limit = self.coefficients(region)[1] * self.n
        if abs(needed) <= limit * (1 - 1e-12):
            return 0
        return -np.sign(needed)

    begun = None

    def joined(self, start):
        self.begun = self.begun or start

    def ended(self, start):
        start, self.begun = self.begun or start, None
        self.sticks.append((start[0], self.t, start[1]))

    def slip(self, t1, sign, region, ends):
        mu, _ = self.coefficients(region)

        def rates(t, y):
            force = -sign * mu * self.n - self.c * y[1] - self.k * y[0]
            return y[1], force / self.m, y[1] - self.base.velocity(t)

        def left(t, y):
            return sign * (y[1] - self.base.velocity(t))

        def rest(t, y):  # a slip that begins there has left it, though round-off may deny it for a moment
            return 1.0 if t - self.t < 1e-7 else left(t, y)

        def turn(t, y):  # where it slips slowest; it may have passed rest twice within the step
            return 1.0 if t - begin < 1e-7 else sign * (rates(t, y)[1] - self.base.acceleration(t))

        low, high = (lambda t, y, end=end: self.place(y) - end for end in ends)
        rest.direction, turn.direction, low.direction, high.direction = -1, 1, -1, 1
        events = [rest, turn, *(one for one, end in ((low, ends[0]), (high, ends[1])) if math.isfinite(end))]
        for one in events:
            one.terminal = True
        begin, y = self.t, self.y
        while True:
            found = integrate.solve_ivp(
                rates,
                (begin, t1),
                y,
                "DOP853",
                dense_output=True,
                events=events,
                rtol=1e-13,
                atol=1e-14,
                max_step=0.005,
            )
            which = next((at for at, times in enumerate(found.t_events) if len(times)), None)
            begin, y = found.t[-1], found.y[:, -1]
            if which == 1 and left(begin, y) < -1e-11:  # not only by round-off, as after a release on a steady belt
                begin = optimize.brentq(lambda t, at=found.sol: left(t, at(t)), found.t[-2], begin, xtol=1e-14)
                return (begin, found.sol(begin)), "rest"
            if which != 1:
                return (begin, y), None if which is None else "rest" if which == 0 else "place"

    def stick(self, t1, sign, region, ends):
        _, static = self.coefficients(region)
        x0, t0 = self.y[0], self.t

        def at(t):
            return np.array([x0 + self.base.way(t0, t), self.base.velocity(t), self.y[2]])

        def over(t):
            y = at(t)
            left = static * self.n - abs(self.needed(t, y[0]))
            if self.law.on == "base":
                return left, math.inf
            return left, min(y[0] - ends[0], ends[1] - y[0])

        times = np.linspace(t0, t1, 4000)
        for low, high in itertools.pairwise(times):
            state = over(high)
            if min(state) < 0 and high > t0 + 1e-9:
                which, within = int(np.argmin(state)), [low, high]
                for _ in range(70):
                    middle = sum(within) / 2
                    within[int(over(middle)[which] < 0)] = middle
                return (within[1], at(within[1])), ("limit", "place")[which]
        return (t1, at(t1)), None


class Steady:
    """A base of constant velocity."""

    def __init__(self, speed):
        self.speed, self.signal = speed, ss.Constant(speed)

    def velocity(self, t):
        return self.speed

    def acceleration(self, t):
        return 0.0

    def way(self, t0, t):
        return self.speed * (t - t0)


class Swinging:
    """A base that moves to and fro."""

    def __init__(self, amplitude, frequency):
        self.amplitude, self.frequency = amplitude, frequency
        self.signal = ss.Harmonic(amplitude, frequency)

    def velocity(self, t):
        return self.amplitude * math.cos(self.frequency * t)

    def acceleration(self, t):
        return -self.amplitude * self.frequency * math.sin(self.frequency * t)

    def way(self, t0, t):
        return self.amplitude / self.frequency * (math.sin(self.frequency * t) - math.sin(self.frequency * t0))


def set_up(number):
    """A system, its base and its start, at random."""
    rng = np.random.default_rng(number)
    size, on = int(rng.integers(1, 5)), ("base", "ground")[number % 2]
    periodic = bool(rng.integers(2))
    places = np.cumsum(rng.uniform(0.05, 0.4, size)) - (0.5 if on == "ground" else 0.2)
    has_static = bool(rng.integers(2))
    mu = rng.uniform(0.2, 1.2, size + (not periodic))
    laws = tuple(ss.Coulomb(one, one * rng.uniform(1.0, 1.6) if has_static else None) for one in mu.tolist())
    period = float(places[-1] - places[0] + rng.uniform(0.1, 0.5)) if periodic else None
    law = ss.FrictionByPlace(tuple(places.tolist()), laws, period, on=on)
    damping = float(rng.uniform(0.05, 0.3)) if rng.integers(2) else None
    system = ss.MassSpring(
        float(rng.uniform(0.5, 2)), float(rng.uniform(1, 8)), float(rng.uniform(0.5, 2)), law, damping
    )
    speed = float(rng.uniform(0.1, 1.0) * rng.choice([-1, 1]))
    base = Steady(speed) if number % 4 < 2 else Swinging(speed, float(rng.uniform(0.5, 4.0)))
    return system, base, (float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-1, 1)))


def compare(number):
    system, base, y0 = set_up(number)
    one = ss.simulate(system, base.signal, T1, y0)
    reference = Reference(system, base, y0).run(T1)
    return one, reference


@pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.slow), 3])
def test_against_an_integration_of_its_own(number):
    check(*compare(number))


@pytest.mark.slow
def test_two_hundred_set_ups():
    """Of each: times and positions of all sticks, and the last state, to 1e-9."""
    sticks = regions = 0
    for number in range(200):
        one, reference = compare(number)
        check(one, reference)
        sticks += len(reference.sticks)
        regions += len(reference.law.laws)
    assert sticks > 500
    assert regions > 500


def check(one, reference):
    assert one.status == ss.Status.FINISHED
    found = np.array([one.sticks.start, one.sticks.end, one.sticks.position])[:, np.asarray(one.sticks.mask)].T
    expected = np.array([stick for stick in reference.sticks if stick[1] - stick[0] > 1e-9]).reshape(-1, 3)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(one.final_state[:2], reference.y[:2], atol=1e-9)
    if reference.law.on == "base":
        np.testing.assert_allclose(one.final_state[2], reference.y[2], atol=1e-8)


BELT = ss.FrictionByPlace((0.0, 0.5), (ss.Coulomb(0.8, 0.9), ss.Coulomb(0.3, 0.4)), 1.0)
SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, BELT, 0.2)


@pytest.fixture(scope="module")
def one():
    """A motion that begins in a stick on a border."""
    return ss.simulate(SYSTEM, ss.Constant(0.3), 20.0, (0.0, 0.3))


def test_energies_and_forces(one):
    """Nothing is lost at borders, and the force is that of the region."""
    times = np.linspace(0.0, 20.0, 801)
    assert np.max(np.abs(one.energies(times).imbalance)) < 1e-12
    force, velocity = np.asarray(one.friction_force(times)), np.asarray(one.relative_velocity(times))
    place = np.asarray(one.evaluate(times)[2])
    slips = np.abs(velocity) > 1e-6
    expected = np.where(np.floor(place / 0.5) % 2 == 0, 0.8, 0.3)
    beside = np.abs(place / 0.5 - np.round(place / 0.5)) > 1e-6
    np.testing.assert_allclose((-force * np.sign(velocity))[slips & beside], expected[slips & beside], rtol=1e-12)
    assert one.near_grazing_count == 0
    assert np.all(np.diff(place)[velocity[1:] == 0][:5] == 0)


def test_equal_regions_are_one(one):
    """With the same law everywhere the motion is that of a plain belt, to the last digits."""
    alike = ss.FrictionByPlace((0.0, 0.5), (ss.Coulomb(0.8, 0.9),) * 2, 1.0)
    for number in range(3):
        start = (0.1 * number, 0.2)
        by_place = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, alike, 0.2), ss.Constant(0.3), 20.0, start)
        plain = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8, 0.9), 0.2), ss.Constant(0.3), 20.0, start)
        assert by_place.sticks.count == plain.sticks.count
        np.testing.assert_allclose(by_place.final_state[:2], plain.final_state, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("on", ["base", "ground"])
def test_derivatives_by_places_and_friction(on):
    """Forward and reverse mode, against central differences."""
    base = ss.Harmonic(0.6, 1.3)

    def motion(numbers):
        second, mu, period = numbers
        law = ss.FrictionByPlace((-0.05, second), (ss.Coulomb(mu, 0.9), ss.Coulomb(0.3, 0.4)), period, on=on)
        system = ss.MassSpring(1.0, 4.0, 1.0, law, 0.2)
        one = ss.simulate(system, base, 15.0, (0.02, 0.3), method=ss.Exact(max_steps=4096))
        return jnp.stack([one.stick_time, *one.final_state[:2]])

    at = jnp.array([0.1, 0.8, 0.4])
    by_forward, by_reverse = jax.jit(jax.jacfwd(motion))(at), jax.jit(jax.jacrev(motion))(at)
    step, run = 1e-6, jax.jit(motion)
    by_differences = [(run(at.at[i].add(step)) - run(at.at[i].add(-step))) / (2 * step) for i in range(3)]
    np.testing.assert_allclose(by_forward, by_reverse, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(by_forward, np.stack(by_differences, axis=1), rtol=1e-5, atol=1e-6)
    assert np.all(np.any(np.abs(by_forward) > 1e-3, axis=0))


@pytest.mark.slow
def test_ensembles_with_random_friction():
    """Regions whose friction differs from sample to sample; each sample is what `simulate` gives."""
    law = ss.FrictionByPlace((0.0, 0.5), (ss.Coulomb(ss.Uniform(0.5, 1.0)), ss.Coulomb(0.3)), 1.0)
    many = ss.simulate_ensemble(
        ss.MassSpring(1.0, 4.0, 1.0, law), ss.PoissonSwitching(1.0, 1.0), 30.0, samples=64, key=jax.random.key(0),
        keep="sticks",
    )  # fmt: skip
    assert many.finished == 64
    assert list(many.input_values) == ["mu"]
    for number in (0, 5):
        system, base, y0 = many.realization(number)
        assert system.friction.laws[0].mu == many.input_values["mu"][number]
        again = ss.simulate(system, base, 30.0, y0)
        np.testing.assert_allclose(
            again.sticks.start[: again.sticks.count], many.sticks.start[number, : many.sticks.count[number]], atol=1e-9
        )


def test_ensembles_with_random_places():
    """Each sample has borders of its own; such that do not increase, or leave no room in the period, are refused."""
    run = {"t1": 20.0, "samples": 32, "key": jax.random.key(0), "keep": "sticks"}
    belt, laws = ss.PoissonSwitching(1.0, 1.0), (ss.Coulomb(ss.Uniform(0.7, 0.9)), ss.Coulomb(0.3))

    def system(*places):
        return ss.MassSpring(1.0, 4.0, 1.0, ss.FrictionByPlace(places, laws, 1.0))

    random = system(ss.Uniform(-0.1, 0.1), ss.Uniform(0.3, 0.4))
    many = ss.simulate_ensemble(random, belt, **run)
    assert set(many.input_values) == {"places[0]", "places[1]", "mu"}
    for number in (0, 9, 31):
        drawn, base, y0 = many.realization(number)
        assert drawn.friction.places[0] == many.input_values["places[0]"][number]
        alone, kept = ss.simulate(drawn, base, 20.0, y0).sticks, many.sticks.mask[number]
        np.testing.assert_allclose(alone.start[alone.mask], many.sticks.start[number][kept], atol=1e-11)
    with pytest.raises(ValueError, match=r"places\[0\] must be one number here"):
        ss.simulate(random, ss.Constant(0.2), 5.0)
    with pytest.raises(ValueError, match=r"Sample \d+ does not fit: Argument places must increase"):
        ss.simulate_ensemble(system(ss.Uniform(0.2, 0.5), 0.3), belt, **run)
    with pytest.raises(ValueError, match=r"Sample \d+ does not fit: Argument period must be above"):
        ss.simulate_ensemble(system(ss.Uniform(-0.9, 0.1), 0.3), belt, **run)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
def test_single_precision(one):
    with jax.enable_x64(False):
        coarse = ss.simulate(SYSTEM, ss.Constant(0.3), 20.0, (0.0, 0.3))
        assert coarse.final_state[0].dtype == np.float32
    assert coarse.sticks.count == one.sticks.count
    np.testing.assert_allclose(coarse.final_state, one.final_state, atol=2e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"places": ()}, "Argument places must be a tuple with one entry or more"),
        ({"places": (0.5, 0.0)}, "Argument places must increase"),
        ({"places": (0.0, "a")}, "places"),
        ({"laws": (ss.Coulomb(0.3),)}, "Argument laws must hold 2 laws, one for each region"),
        ({"laws": (ss.Coulomb(0.3), ss.Coulomb(0.3, 0.4))}, "Argument laws must be of one kind"),
        ({"laws": (ss.Coulomb(0.3), ss.VelocityWeakening(0.3, 1.0))}, "Argument laws must be of one kind"),
        ({"laws": (ss.Coulomb(0.3), 0.3)}, r"Argument laws\[1\] must be a friction law"),
        ({"period": 0.4}, "Argument period must"),
        ({"period": -1.0}, "Argument period must"),
        ({"on": "belt"}, "Argument on must be one of 'base', 'ground'"),
    ],
)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_laws(change, message):
    arguments = {"places": (0.0, 0.5), "laws": (ss.Coulomb(0.8), ss.Coulomb(0.3)), "period": 1.0, "on": "base"}
    with pytest.raises(ValueError, match=message):
        ss.FrictionByPlace(**arguments | change)


@pytest.mark.parametrize(
    "call",
    [
        lambda: ss.MassSpring(1.0, 4.0, ss.ForceSteps((0.0, 5.0), (1.0, 0.5)), BELT),
        lambda: ss.Contact((1.0,), 1.0, BELT),
        lambda: ss.Directional(BELT, ss.Coulomb(0.3)),
        lambda: ss.Ageing(BELT, ss.LogarithmicGrowth(0.02, 0.1)),
        lambda: ss.FrictionByPlace((0.0,), (BELT, BELT)),
        lambda: BELT.force([0.0, 1.0], [0.1, 0.1]),
    ],
)
def test_what_knows_nothing_of_places_refuses_them(call):
    """It would take the largest coefficient of all regions."""
    with pytest.raises(ValueError, match=r"must be a friction law that is the same everywhere, but FrictionByPlace"):
        call()


@pytest.mark.parametrize("on", ["base", "ground"])
def test_the_other_half_of_the_symmetry(on):
    """All directions reversed, places mirrored: the motion is the mirrored one, to the last digits."""
    laws = ss.Coulomb(0.8, 0.9), ss.Coulomb(0.3, 0.5), ss.Coulomb(0.5, 0.6)
    ends = []
    for way in (1, -1):
        places = tuple(sorted(way * place for place in (-0.1, 0.25)))
        law = ss.FrictionByPlace(places, laws[::way], on=on)
        system = ss.MassSpring(1.0, 4.0, 1.0, law, 0.1)
        ends.append(ss.simulate(system, ss.Harmonic(way * 0.7, 1.1), 15.0, (way * 0.05, way * 0.3)))
    assert ends[0].sticks.count == ends[1].sticks.count > 0
    np.testing.assert_allclose(ends[0].final_state, -np.asarray(ends[1].final_state), atol=1e-13)


def test_smoothed_friction_is_refused():
    with pytest.raises(ValueError, match=r"must be Exact\(\.\.\.\) for friction that jumps from place to place"):
        ss.simulate(SYSTEM, ss.Constant(0.3), 20.0, method=ss.Regularized(1e-3))


class WavyBelt(ss.SwitchedSystem):
    """1 kg on a spring and on a belt, along which the friction coefficient is a wave."""

    stiffness: float
    mu: float
    share: float
    wavelength: float
    state_names = ("position in m", "velocity in m/s", "place on the belt in m")

    def limit(self, place, module=jnp):
        return 9.81 * self.mu * (1 + self.share * module.cos(2 * math.pi * place / self.wavelength))

    def rates(self, t, y, base, friction):
        return y[1], -self.stiffness * y[0] - friction * self.limit(y[2]), y[1] - base.velocity

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2 * jnp.pi / self.stiffness**0.5


@pytest.mark.slow
def test_smooth_friction_by_place_is_a_system_of_ones_own():
    """On a belt of constant speed the mass never passes it: it slips back, and a stick ends by its formula."""
    system, speed, t1 = WavyBelt(40.0, 0.3, 0.5, 0.2), 0.2, 20.0

    def rates(t, y):
        return y[1], -40 * y[0] + system.limit(y[2], np), y[1] - speed

    def caught(t, y):
        return y[1] - speed

    caught.terminal, caught.direction = True, 1
    t, y, expected = 0.0, [0.0, 0.0, 0.0], []
    while True:
        slip = integrate.solve_ivp(rates, (t, t1), y, "DOP853", events=caught, rtol=1e-12, atol=1e-13)
        t, (x, _, place) = slip.t[-1], slip.y[:, -1]
        if slip.status == 0:
            break
        assert 40 * abs(x) < system.limit(place, np)
        end = t + (system.limit(place, np) / 40 - x) / speed
        expected.append((t, min(end, t1)))
        if end >= t1:
            break
        t, y = end, [x + speed * (end - t), speed - 1e-300, place]
    one = ss.simulate(system, ss.Constant(speed), t1)
    found = np.stack([one.sticks.start, one.sticks.end], axis=1)[np.asarray(one.sticks.mask)]
    assert len(expected) == 20
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)

    def stick_time(share):
        return ss.simulate(WavyBelt(40.0, 0.3, share, 0.2), ss.Constant(speed), t1).stick_time

    slope = (stick_time(0.50001) - stick_time(0.49999)) / 2e-5
    assert float(jax.grad(stick_time)(0.5)) == pytest.approx(float(slope), abs=1e-7)


class CartReference:
    """A cart on a rail: slips by an integrator of eighth order, which stops at every event; sticks by a formula."""

    def __init__(self, cart, voltage, y0):
        self.cart, self.voltage, self.law = cart, voltage, cart.friction
        self.t, self.y, self.sticks = 0.0, np.array(y0), []
        self.one = cart.cart_mass * cart.gravity * cart.eccentricity

    def coefficients(self, way=0.0):
        """Kinetic and static, where the cart is, or just beyond in this way."""
        place = self.cart.eccentricity * math.cos(self.y[0]) + 1e-9 * way
        region, ends = region_of(self.law, place)
        law = self.law.laws[region % len(self.law.laws)]
        return law.mu, law.static, ends

    def source(self, t):
        return self.voltage.mean + self.voltage.amplitude * math.sin(self.voltage.angular_frequency * t)

    def run(self, t1):
        sign = np.sign(self.y[1])
        while self.t < t1:
            if sign == 0:
                _, static, _ = self.coefficients()
                torque = self.cart.motor_constant * self.y[2]
                if abs(torque) <= static * self.one * abs(math.sin(self.y[0])):
                    self.stick(t1, static)
                    torque = self.cart.motor_constant * self.y[2]
                sign = np.sign(torque)
            else:
                sign = self.slip(t1, sign)
        return self

    def stick(self, t1, static):
        cart, w, begin, current = self.cart, self.voltage.angular_frequency, self.t, self.y[2]
        reactance = cart.inductance * w
        gain = self.voltage.amplitude / (cart.resistance**2 + reactance**2)

        def steady(t):
            swing = cart.resistance * np.sin(w * t) - reactance * np.cos(w * t)
            return self.voltage.mean / cart.resistance + gain * swing

        def at(t):
            return steady(t) + (current - steady(begin)) * np.exp(-cart.resistance / cart.inductance * (t - begin))

        def left(t):
            return static * self.one * abs(math.sin(self.y[0])) - np.abs(cart.motor_constant * at(t))

        times = np.linspace(begin, t1, 40001)[1:]
        over = np.flatnonzero(left(times) < 0)
        self.t = t1
        if len(over):
            before = times[over[0] - 1] if over[0] else begin
            self.t = optimize.brentq(left, before, times[over[0]], xtol=1e-15) if left(before) > 0 else before
        self.y = np.array([self.y[0], 0.0, at(self.t)])
        self.sticks.append((begin, self.t, self.y[0]))

    def slip(self, t1, sign):
        """Until the next event; the sign of the slip that goes on, 0 at rest."""
        cart, heading = self.cart, np.sign(math.sin(self.y[0] + 1e-9 * sign))  # from dead centre into the next half
        mu, _, ends = self.coefficients(-heading * sign)
        inertia = cart.cart_mass * cart.eccentricity**2

        def rates(t, y):
            sine, cosine = math.sin(y[0]), math.cos(y[0])
            torque = cart.motor_constant * y[2] - cart.motor_damping * y[1] - sign * mu * self.one * heading * sine
            across = self.source(t) - cart.resistance * y[2] - cart.motor_constant * y[1]
            turn = (torque - inertia * sine * cosine * y[1] ** 2) / (cart.motor_inertia + inertia * sine**2)
            return y[1], turn, across / cart.inductance

        def rest(t, y):
            return sign * y[1]

        def dead_center(t, y):
            return heading * math.sin(y[0])

        rest.direction = dead_center.direction = -1
        events = [rest, dead_center]
        for end, way in zip(ends, (1, -1), strict=True):
            if abs(end) < cart.eccentricity:
                events.append(lambda t, y, end=end, way=way: way * (cart.eccentricity * math.cos(y[0]) - end))
                events[-1].direction = -1
        for event in events:
            event.terminal = True
        found = integrate.solve_ivp(
            rates, (self.t, t1), self.y, "DOP853", events=events, rtol=1e-12, atol=1e-13, max_step=1e-3
        )
        self.t, self.y = found.t[-1], found.y[:, -1]
        if len(found.t_events[0]):
            self.y[1] = 0.0
            return 0
        return sign


def cart_at_random(number):
    """A cart on a rail of three regions, its source voltage and its start, at random."""
    rng = np.random.default_rng(number)
    places = tuple(np.sort(rng.uniform(-0.009, 0.009, 2)).tolist())
    mu = rng.uniform(0.02, 0.5, 3).tolist()
    laws = tuple(ss.Coulomb(one, one * rng.uniform(1.0, 1.5)) for one in mu)
    cart = ss.MotorCart(friction=ss.FrictionByPlace(places, laws, on="ground"))
    voltage = ss.SourceVoltage(float(rng.uniform(0, 1.5)), float(rng.uniform(0.5, 2.0)), float(rng.uniform(5.0, 20.0)))
    return cart, voltage, (float(rng.uniform(0.1, 3.0)), float(rng.choice([-3.0, 0.0, 3.0])), 0.0)


def check_cart(number):
    """Times and angles of all sticks and the last state to 1e-9, at a step at which the cart is that exact anywhere.

    Returns the number of sticks.
    """
    cart, voltage, y0 = cart_at_random(number)
    one = ss.simulate(cart, voltage, 2.0, y0, method=ss.Exact(step=1e-4, max_steps=50_000))
    reference = CartReference(cart, voltage, y0).run(2.0)
    assert one.status == ss.Status.FINISHED
    found = np.array([one.sticks.start, one.sticks.end, one.sticks.position])[:, np.asarray(one.sticks.mask)].T
    expected = np.array([stick for stick in reference.sticks if stick[1] - stick[0] > 1e-9]).reshape(-1, 3)
    assert found.shape == expected.shape, (number, found, expected)
    np.testing.assert_allclose(found, expected, atol=1e-9, err_msg=str(number))
    np.testing.assert_allclose(one.final_state, reference.y, atol=1e-9, err_msg=str(number))
    return len(expected)


def test_cart_on_a_rail_of_regions():
    assert check_cart(4) > 0


@pytest.mark.slow
def test_a_hundred_carts():
    assert sum(map(check_cart, range(100))) > 300


RAIL = ss.FrictionByPlace(
    (-0.004, 0.003), (ss.Coulomb(0.1, 0.2), ss.Coulomb(0.3, 0.4), ss.Coulomb(0.05, 0.1)), on="ground"
)


def test_bound_of_sticks_on_a_rail():
    """At each angle that of a cart with the friction of that place."""
    voltage, angles = ss.SourceVoltage(), np.linspace(-3.0, 3.0, 25)
    found = ss.stick_duration_bound(ss.MotorCart(friction=RAIL), voltage, angles)
    region = np.searchsorted(RAIL.places, 0.01 * np.cos(angles))
    assert {*region} == {0, 1, 2}
    for number, law in enumerate(RAIL.laws):
        alone = ss.stick_duration_bound(ss.MotorCart(friction=law), voltage, angles)
        np.testing.assert_array_equal(np.asarray(found)[region == number], np.asarray(alone)[region == number])


@pytest.mark.slow
def test_derivatives_of_a_cart_by_places():
    """Forward and reverse mode, against central differences."""
    voltage = ss.SourceVoltage(0.5, 1.5, 9.0)

    def motion(numbers):
        place, mu = numbers
        law = ss.FrictionByPlace(
            (-0.004, place), (ss.Coulomb(0.1, 0.2), ss.Coulomb(mu, 0.4), ss.Coulomb(0.05, 0.1)), on="ground"
        )
        one = ss.simulate(ss.MotorCart(friction=law), voltage, 2.0, (1.0, 0.0, 0.0), method=ss.Exact(max_steps=8192))
        return jnp.stack([one.stick_time, *one.final_state])

    at = jnp.array([0.003, 0.3])
    by_forward, by_reverse = jax.jit(jax.jacfwd(motion))(at), jax.jit(jax.jacrev(motion))(at)
    steps, run = (1e-7, 1e-6), jax.jit(motion)
    by_differences = [(run(at.at[i].add(h)) - run(at.at[i].add(-h))) / (2 * h) for i, h in enumerate(steps)]
    np.testing.assert_allclose(by_forward, by_reverse, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(by_forward, np.stack(by_differences, axis=1), rtol=1e-3, atol=1e-5)
    assert np.all(np.any(np.abs(by_forward) > 1e-3, axis=0))


@pytest.mark.usefixtures("annotations_unchecked")
def test_a_cart_has_no_belt():
    with pytest.raises(ValueError, match=r'must have its places on="ground", which is the rail of a MotorCart, but'):
        ss.MotorCart(friction=BELT)
