"""Contacts behind springs: against exact modes from event to event, closed forms, and the rules of Masing and Iwan."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from support.elastic_reference import ByModes, SetUp

import stickslip_jax as ss

KINDS = {
    # masses, elastic contacts, rigid ones, damped, varying normal forces, static above kinetic friction
    "one": (1, 1, 0, False, False, False),
    "mixed": (3, 4, 1, True, False, True),
    "twenty": (2, 20, 0, False, False, False),
    "opening": (2, 3, 0, True, True, False),
    "pressed": (3, 2, 1, True, True, False),  # by springs, too
}


def random_set_up(kind, seed):
    masses, elastic, rigid, damped, varying, stronger = KINDS[kind]
    rng, contacts = np.random.default_rng([sorted(KINDS).index(kind), seed]), elastic + rigid
    off = -rng.uniform(0.2, 1.0, masses - 1)
    stiffness = np.diag(rng.uniform(0.2, 1.0, masses)) + np.diag(off, 1) + np.diag(off, -1)
    stiffness += np.diag(np.append(-off, 0)) + np.diag(np.insert(-off, 0, 0))
    directions = rng.normal(size=(contacts, masses))
    if rigid:
        directions[-1] = np.eye(masses)[0]
    springs = rng.uniform(0.3, 3.0, contacts) / (1 if elastic < 9 else 5)
    springs[elastic:] = 0
    kinetic = rng.uniform(0.05, 0.5, contacts) / (1 if elastic < 9 else 5)
    static = kinetic * (rng.uniform(1.0, 1.5, contacts) if stronger else 1.0)
    normal = np.stack([rng.uniform(0.5, 1.5, contacts), np.zeros(contacts)])
    if varying:
        normal[1] = rng.uniform(0.3, 2.0, contacts)
    damping = rng.uniform(0.05, 0.3, masses) if damped else np.zeros(masses)
    base = rng.uniform(-0.3, 0.3), rng.uniform(0.2, 1.0)
    of = SetUp(
        rng.uniform(0.5, 2.0, masses), stiffness, np.diag(damping), directions, springs, normal, kinetic, static,
        base, rng.uniform(0.5, 2.5), np.zeros((contacts, masses)),
    )  # fmt: skip
    if kind == "pressed":
        of.pressing = rng.normal(size=(contacts, masses)) / 2
    return of, np.append(rng.uniform(-2, 2, masses), rng.uniform(-1, 1, masses))


def as_structure(of):
    contacts = []
    for i, direction in enumerate(of.directions):
        force = of.normal[0][i]
        if of.normal[1][i]:
            force = ss.Harmonic(of.normal[1][i], of.w, -np.pi / 2, force)
        law = ss.Coulomb(of.kinetic[i], None if np.all(of.static == of.kinetic) else of.static[i])
        contacts.append(
            ss.Contact(
                direction, force, law, 1.0, of.springs[i] or None, of.pressing[i] if np.any(of.pressing) else None
            )
        )
    damping = np.diag(of.damping) if np.any(of.damping) else None
    base = ss.Harmonic(of.base[1], of.w, 0.0, of.base[0])
    return ss.LinearStructure(of.mass, of.stiffness, damping, contacts), base


def compare(kind, seed, t1=15.0):
    of, y0 = random_set_up(kind, seed)
    structure, base = as_structure(of)
    method = ss.Exact(max_steps=4096)  # one program for all of a kind
    one = ss.simulate(structure, base, t1=t1, y0=tuple(y0), method=method)
    return compared(of, one, ByModes(of, y0).run(t1))


def compared(of, one, expected):
    """Every stick and the final state; the number of sticks."""
    assert one.status == 0
    elastic, d = of.springs > 0, len(of.mass)
    found = np.asarray(one.final_state)
    np.testing.assert_allclose(
        found, np.append(expected.z[: 2 * d], expected.z[2 * d : 2 * d + len(elastic)][elastic]), rtol=0, atol=1e-9
    )
    sticks = [(int(i), begin, end) for i, begin, end in expected.sticks if end > begin]
    for i in range(len(elastic)):
        mine = one.of_contact(i).sticks
        theirs = [(begin, end) for j, begin, end in sticks if j == i]
        mine = np.stack([mine.start, mine.end], axis=1)[np.asarray(mine.mask)]
        assert len(mine) == len(theirs), (i, mine, theirs)
        np.testing.assert_allclose(mine, np.array(theirs).reshape(-1, 2), rtol=0, atol=1e-9)
    return len(sticks)


@pytest.mark.slow_but_for("pressed")
@pytest.mark.parametrize("kind", KINDS)
def test_random_set_ups(kind):
    assert sum(compare(kind, seed) for seed in range(3)) > 10


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_two_hundred_set_ups(kind):
    assert sum(compare(kind, seed) for seed in range(3, 53)) > 300


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
def test_single_precision():
    of, y0 = random_set_up("pressed", 0)
    expected = ByModes(of, y0).run(15.0)
    with jax.enable_x64(False):
        structure, base = as_structure(of)
        one = ss.simulate(structure, base, t1=15.0, y0=tuple(y0))
    assert one.final_state[0].dtype == np.float32
    np.testing.assert_allclose(np.stack(one.final_state)[:6], expected.z[:6], rtol=0, atol=1e-5)
    for i in range(3):
        theirs = [stick[1:] for stick in expected.sticks if stick[0] == i and stick[2] > stick[1]]
        mine = one.of_contact(i).sticks
        assert int(mine.count) == len(theirs)
        found = np.stack([mine.start, mine.end], axis=1)[np.asarray(mine.mask)]
        np.testing.assert_allclose(found, np.reshape(theirs, (-1, 2)), rtol=0, atol=2e-4)


@pytest.mark.slow
def test_normal_forces_that_jump():
    """What slips stops where its limit jumps up, and what sticks slips where it falls below the spring's force."""
    of, y0 = random_set_up("opening", 7)
    of.base, of.normal[1] = (0.2, 0.0), 0.0
    times, factors = [0.0, 1.5, 2.5, 4.0, 5.5, 7.0], [1.0, 3.0, 0.2, 2.0, 0.05, 1.0]
    levels, ends, known = of.normal[0].copy(), np.append(times[1:], 9.0), np.append(y0, np.zeros(3))
    contacts = [
        ss.Contact(d, ss.ForceSteps(times, np.array(factors) * n), ss.Coulomb(mu), 1.0, k)
        for d, n, mu, k in zip(of.directions, levels, of.kinetic, of.springs, strict=True)
    ]
    structure = ss.LinearStructure(of.mass, of.stiffness, np.diag(of.damping), contacts)
    one = ss.simulate(structure, 0.2, t1=9.0, y0=tuple(y0))
    for begin, end, factor in zip(times, ends, factors, strict=True):
        of.normal[0] = factor * levels
        known = ByModes(of, known[:4], known[4:]).run(end - begin).z[:7]
        np.testing.assert_allclose(one.evaluate(end)[:4], known[:4], rtol=0, atol=1e-10)
    np.testing.assert_allclose(one.final_state, known, rtol=0, atol=1e-10)


# Closed forms.


def held_still(sliders, base, springs=1.0, t1=10.0):
    """The motion of `sliders`, strengths (N), on a mass so heavy that it rests."""
    contacts = [ss.Contact([1.0], one, ss.Coulomb(1.0), 1.0, springs) for one in sliders]
    heavy = ss.LinearStructure([1e15], [0.0], None, contacts)
    return ss.simulate(heavy, base, t1=t1)


def test_jenkins_element_under_a_sine():
    """After each turn it sticks until it has travelled twice the elongation of its limit."""
    amplitude, w, strength, spring = 0.7, 1.3, 0.4, 2.0
    one = held_still([strength], ss.Harmonic(amplitude * w, w, -np.pi / 2), spring, t1=12.0)
    stick = np.arccos(1 - 2 * strength / (spring * amplitude)) / w
    first = np.arccos(1 - strength / (spring * amplitude)) / w
    turns = np.pi / w * np.arange(1, 5)
    mine = np.stack([one.of_contact(0).sticks.start, one.of_contact(0).sticks.end])[:, :5]
    np.testing.assert_allclose(mine, [[0.0, *turns], [first, *(turns + stick)]], rtol=0, atol=1e-12)
    # The loop: what is lost in a period.
    times = np.linspace(2 * np.pi / w, 4 * np.pi / w, 4001)
    force, moved = spring * np.asarray(one.evaluate(times))[2], amplitude * (1 - np.cos(w * times))
    area = abs(np.sum((force[1:] + force[:-1]) / 2 * np.diff(moved)))
    assert area == pytest.approx(4 * strength * (2 * amplitude / 2 - strength / spring), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("sliders", [10, 100])
def test_iwan_chain_under_a_triangle(sliders):
    """Strengths spread evenly over 0 to 1: Iwan's integral; loops are the first loading twice as large (Masing)."""
    strengths = (np.arange(sliders) + 0.5) / sliders
    one = held_still(strengths / sliders, ss.SquareWave(1.0, 1.6), 1.0 / sliders, t1=3.2)
    times = np.linspace(0, 3.2, 65)
    moved = np.abs((times + 0.8) % 1.6 - 0.8)
    force = np.sum(np.asarray(one.evaluate(times))[2:], axis=0) / sliders

    def loading(u):
        return np.mean(np.minimum(u[:, None], strengths), axis=1)

    up, down, again = times <= 0.8, (times >= 0.8) & (times <= 1.6), (times >= 1.6) & (times <= 2.4)
    np.testing.assert_allclose(force[up], loading(moved[up]), rtol=0, atol=1e-13)
    assert np.max(np.abs(force[up] - (moved[up] - moved[up] ** 2 / 2))) <= 1 / (8 * sliders**2) + 1e-13
    peak, lowest = force[times == 0.8], force[times == 1.6]
    np.testing.assert_allclose(force[down], peak - 2 * loading((0.8 - moved[down]) / 2), rtol=0, atol=1e-13)
    np.testing.assert_allclose(force[again], lowest + 2 * loading(moved[again] / 2), rtol=0, atol=1e-13)


@pytest.mark.slow
def test_free_decay_on_a_jenkins_element():
    """A mass with a velocity, a spring and an element: two linear motions in turn, by hand."""
    m, k, spring, strength, v = 2.0, 1.5, 3.0, 0.6, 1.7
    system = ss.MassSpring(m, k, strength, ss.Coulomb(1.0), series_stiffness=spring)
    one = ss.simulate(system, 0.0, t1=4.0, y0=(0.0, v))
    fast, slow, reach = np.sqrt((k + spring) / m), np.sqrt(k / m), strength / spring
    first = np.arcsin(reach * fast / v) / fast
    speed = v * np.cos(fast * first)
    # It slips about -strength / k until it stops, in the direction that it began.
    off = reach + strength / k
    stop = first + np.arctan2(speed / slow, off) / slow
    top = np.hypot(off, speed / slow) - strength / k
    # Stuck about the place where both springs balance; the element's spring turns from its limit to the other.
    middle = (spring * (top - reach)) / (k + spring)
    third = stop + np.arccos((top - 2 * reach - middle) / (top - middle)) / fast
    mine = np.array([one.sticks.start, one.sticks.end])[:, :2]
    np.testing.assert_allclose(mine, [[0.0, stop], [first, third]], rtol=0, atol=1e-13)
    np.testing.assert_allclose(one.evaluate(stop)[0], top, rtol=0, atol=1e-13)
    energies = one.energies(stop)
    np.testing.assert_allclose(energies.dissipated["friction"], strength * (top - reach), rtol=0, atol=1e-13)
    np.testing.assert_allclose(energies.stored["elastic"], k * top**2 / 2 + spring * reach**2 / 2, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_stiff_springs_come_to_rigid_contacts():
    base, y0 = ss.Harmonic(0.6, 1.1), (0.5, 0.0)
    off = []
    for stiffness in (1e3, 1e4, 1e5):
        soft = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.4), damping=0.3, series_stiffness=stiffness)
        hard = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.4), damping=0.3)
        one, rigid = (ss.simulate(system, base, t1=12.0, y0=y0) for system in (soft, hard))
        off.append(np.max(np.abs(np.asarray(one.final_state)[:2] - np.asarray(rigid.final_state))))
    assert off[0] > off[1] > off[2]
    assert off[2] < 1e-3


# As everywhere: derivatives, energies, ensembles, orbits, refusals.


HELD = {"spring": 0.8, "damping": 0.05, "force": ss.Harmonic(0.5, 1.1)}


def jenkins(mu=0.3, spring=2.0, mass=1.0, normal=1.0, damping=None, force=None):
    return ss.MassSpring(mass, 1.0, normal, ss.Coulomb(mu), damping, force, series_stiffness=spring)


@pytest.mark.slow_but_for("mu")
@pytest.mark.parametrize("name", ["mu", "spring", "mass", "normal"])
def test_derivatives(name):
    def of(value):
        base, method = ss.Harmonic(0.5, 1.3), ss.Exact(max_steps=512)
        one = ss.simulate(jenkins(**{name: value}), base, t1=25.0, y0=(1.0, 0.0), method=method)
        return jnp.stack([one.stick_time, *one.final_state])

    at, h = {"mu": 0.3, "spring": 2.0, "mass": 1.0, "normal": 1.0}[name], 1e-6
    differences = (of(at + h) - of(at - h)) / (2 * h)
    np.testing.assert_allclose(jax.jacfwd(of)(at), differences, rtol=1e-6, atol=1e-6)
    if name != "mu":
        np.testing.assert_allclose(jax.jacrev(of)(at), differences, rtol=1e-6, atol=1e-6)
        second = (jax.jacfwd(of)(at + h) - jax.jacfwd(of)(at - h)) / (2 * h)
        np.testing.assert_allclose(jax.jacfwd(jax.jacfwd(of))(at), second, rtol=1e-5, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mixed", "opening", "pressed"])
def test_derivatives_of_several(kind):
    """By the stiffness of one spring, of the states after many events, breakaway and opening contacts."""
    of, y0 = random_set_up(kind, 1)

    def final(spring):
        structure, base = as_structure(of)
        first, *others = structure.contacts
        first = eqx.tree_at(lambda one: one.series_stiffness, first, spring)
        changed = ss.LinearStructure(structure.mass, structure.stiffness, structure.damping, (first, *others))
        one = ss.simulate(changed, base, t1=15.0, y0=tuple(y0), method=ss.Exact(max_steps=4096))
        return jnp.stack(one.final_state)

    at, h = of.springs[0], 1e-6
    differences = (final(at + h) - final(at - h)) / (2 * h)
    np.testing.assert_allclose(jax.jacfwd(final)(at), differences, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mixed", "opening", "pressed"])
def test_energies_and_forces(kind):
    """What is supplied is stored or lost, also where a spring lets go at once; forces are those of the springs."""
    of, y0 = random_set_up(kind, 1)
    structure, base = as_structure(of)
    one = ss.simulate(structure, base, t1=15.0, y0=tuple(y0), method=ss.Exact(max_steps=4096))
    times = np.linspace(0, 15, 16)
    energies, state = one.energies(times), np.asarray(one.evaluate(times))
    assert energies.dissipated["friction"][-1] > 0.5
    assert np.all(np.diff(energies.dissipated["friction"]) >= -1e-14)
    np.testing.assert_allclose(energies.imbalance, 0, atol=1e-13)
    elastic = np.flatnonzero(of.springs)
    elongations, springs = state[2 * len(of.mass) :], of.springs[elastic][:, None]
    kinetic = np.einsum("it,i->t", state[len(of.mass) : 2 * len(of.mass)] ** 2, of.mass) / 2
    stored = np.einsum("it,ij,jt->t", state[: len(of.mass)], of.stiffness, state[: len(of.mass)])
    np.testing.assert_allclose(energies.stored["kinetic"], kinetic, atol=1e-13)
    np.testing.assert_allclose(
        energies.stored["elastic"], (stored + np.sum(springs * elongations**2, axis=0)) / 2, atol=1e-13
    )
    forces = np.asarray(one.friction_force(times))
    assert forces.shape == (len(of.springs), 16)
    np.testing.assert_allclose(forces[elastic], -springs * elongations, atol=1e-13)
    normal = of.normal[0] + of.normal[1] * np.sin(of.w * times)[:, None] + (of.pressing @ state[: len(of.mass)]).T
    assert np.all(np.abs(forces.T) <= of.static * np.maximum(normal, 0) + 1e-12)


@pytest.mark.slow
def test_ensembles():
    many = ss.simulate_ensemble(
        jenkins(), ss.PoissonSwitching(0.4, 0.7), t1=20.0, samples=50, key=jax.random.key(1), keep="sticks"
    )
    assert np.sum(many.totals.sticks) > 300
    for sample in (0, 37):
        system, base, y0 = many.realization(sample)
        one = ss.simulate(system, base, t1=20.0, y0=y0)
        count = int(many.flat_sticks.count[sample])
        assert count == int(one.sticks.count)
        for name in ("start", "end", "position"):
            found, expected = getattr(many.sticks, name)[sample, :count], getattr(one.sticks, name)[:count]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_calibration_of_a_joint():
    times = np.linspace(0, 40, 801)
    measured = np.asarray(ss.simulate(jenkins(**HELD), 0.0, t1=40.0, y0=(0.2, 0.0)).evaluate(times)[0])
    measured = measured + 1e-3 * np.random.default_rng(1).normal(size=times.size)
    guess = jenkins(**{**HELD, "mu": 0.2, "spring": 1.0})
    found = ss.calibrate(guess, 0.0, times, {"position": measured}, wrt=["mu", "series_stiffness"], y0=(0.2, 0.0))
    for name, true, least in (("mu", 0.3, 1e-4), ("series_stiffness", 0.8, 1e-3)):
        one = found.estimates[name]
        assert abs(float(one.value) - true) < 4 * float(one.standard_error)
        assert float(one.standard_error) < least


@pytest.mark.slow
def test_griffins_blade_against_harmonic_balance():
    """A blade on a flexible damper under a harmonic force: more harmonics come to the exact orbit."""
    m, c, k, spring, strength, force, w = 1.0, 0.02, 1.0, 0.5, 0.3, 0.4, 1.1
    blade = jenkins(mu=1.0, spring=spring, normal=strength, damping=c, force=ss.Harmonic(force, w))
    start = ss.simulate(blade, 0.0, t1=60 * 2 * np.pi / w).final_state
    orbit = ss.nonlinear.periodic_orbit(blade, ss.Constant(0.0), y0=start, period=2 * np.pi / w)
    assert orbit.converged
    times = np.arange(64) / 64 * 2 * np.pi / w
    exact = np.asarray(ss.simulate(blade, 0.0, t1=2 * np.pi / w, y0=tuple(orbit.state)).evaluate(times))[0]

    def balanced(harmonics, points=4096):
        """Positions by alternating frequency and time (Cameron and Griffin 1989), root by SciPy."""
        phases = 2 * np.pi * np.arange(points) / points
        orders = np.arange(harmonics + 1)
        waves = np.concatenate([np.cos(orders[:, None] * phases), np.sin(orders[1:, None] * phases)])

        def slider(x):
            e, forces = 0.0, np.empty(points)
            for _ in range(2):
                for i in range(points):
                    e = np.clip(e + x[i] - x[i - 1], -strength / spring, strength / spring)
                    forces[i] = spring * e
            return forces

        def residual(a):
            x = a @ waves
            acting = waves @ slider(x) * 2 / points
            cosine, sine = a[: harmonics + 1], np.append(0, a[harmonics + 1 :])
            stiff, viscous = k - m * (orders * w) ** 2, c * orders * w
            left = np.concatenate([stiff * cosine + viscous * sine, (stiff * sine - viscous * cosine)[1:]])
            acting[0] /= 2
            left += acting
            left[1] -= force
            return left

        guess = np.zeros(2 * harmonics + 1)
        guess[1] = np.max(np.abs(exact))
        found = scipy.optimize.root(residual, guess, method="krylov" if harmonics > 9 else "hybr", tol=1e-10)
        x = found.x @ np.concatenate([np.cos(orders[:, None] * w * times), np.sin(orders[1:, None] * w * times)])
        return np.max(np.abs(x - exact))

    errors = [balanced(harmonics) for harmonics in (1, 3, 7)]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    assert errors[2] < 1e-3 * np.max(np.abs(exact))


# Systems of a user's own.


class Own(ss.SwitchedSystem):
    """A `SetUp` as a user would write it."""

    mass: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    directions: np.ndarray
    kinetic: np.ndarray
    static: np.ndarray
    springs: np.ndarray
    masses: int = eqx.field(static=True)
    rubbing: int = eqx.field(static=True)
    elastic: int = eqx.field(static=True)

    @classmethod
    def of(cls, of):
        given = of.mass, of.stiffness, of.damping, of.directions, of.kinetic, of.static / of.kinetic
        sizes = len(of.mass), len(of.springs), int(np.sum(of.springs > 0))
        if cls is Own:
            assert np.all(of.normal[1] == 0)
            kinetic = of.kinetic * of.normal[0]
            return cls(*given[:4], kinetic, given[5], of.springs / kinetic, *sizes)
        return cls(*given, of.springs / of.kinetic, *sizes, of.normal, of.pressing, of.w)

    @property
    def state_names(self):
        return *(f"x{i} in m" for i in range(self.masses)), *(f"v{i} in m/s" for i in range(self.masses))

    @property
    def contacts(self):
        return self.rubbing

    @property
    def series_stiffness(self):
        return *self.springs[: self.elastic], *(None,) * (self.contacts - self.elastic)

    @property
    def static_ratio(self):
        return self.static

    @property
    def shortest_time(self):
        return 1.5

    def rates(self, t, y, base, friction):
        x, v = jnp.stack(y[: self.masses]), jnp.stack(y[self.masses :])
        pull = -self.stiffness @ x - self.damping @ v - (self.kinetic * friction) @ self.directions
        return *v, *(pull / self.mass)

    def relative_velocity(self, t, y, base):
        return self.directions @ jnp.stack(y[self.masses :]) - base.velocity


class Pressed(Own):
    normal: np.ndarray
    pressing: np.ndarray
    w: float

    def normal_forces(self, t, y, base):
        return self.normal[0] + self.normal[1] * jnp.sin(self.w * t) + self.pressing @ jnp.stack(y[: self.masses])


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_own_systems(kind):
    """Every event and the state, elongations too, of systems of a user's own, against exact linear modes."""
    of, y0 = random_set_up(kind, 1)
    _, base = as_structure(of)
    system = (Pressed if KINDS[kind][4] else Own).of(of)
    one = ss.simulate(system, base, t1=15.0, y0=tuple(y0), method=ss.Exact(max_steps=8192))
    assert compared(of, one, ByModes(of, y0).run(15.0)) > 3


class Duffing(ss.SwitchedSystem):
    """A mass on a spring that stiffens, held by a Jenkins element."""

    spring: float  # over the friction force
    cubic: float = 0.5
    limit: float = 0.3  # N
    static_ratio: float = 1.0
    contacts = 1
    state_names = "position in m", "velocity in m/s"
    shortest_time = 2.0

    @property
    def series_stiffness(self):
        return self.spring

    def rates(self, t, y, base, friction):
        x, v = y
        return v, -x - self.cubic * x**3 - 0.05 * v + 0.6 * jnp.cos(1.2 * t) - self.limit * friction[0]

    def relative_velocity(self, t, y, base):
        return (y[1],)


def duffing_by_scipy(spring, cubic, ratio, t1):
    """Sticks (begin, end) of the slider, and the final state with the elongation, by SciPy from event to event."""
    limit, t, y, way, sticks = 0.3, 0.0, np.array([0.5, 0.0, 0.0]), 0, []
    begun = 0.0

    def rates(t, y):
        x, v, e = y
        force = -x - cubic * x**3 - 0.05 * v + 0.6 * np.cos(1.2 * t) - spring * e
        return [v, force, v if way == 0 else 0.0]

    while t < t1:
        if way == 0:
            events = [lambda t, y: spring * y[2] - ratio * limit, lambda t, y: -spring * y[2] - ratio * limit]
            for event in events:
                event.direction = 1
        else:
            events = [lambda t, y, way=way: way * y[1]]
            events[0].direction = -1
        for event in events:
            event.terminal = True
        run = scipy.integrate.solve_ivp(rates, (t, t1), y, "DOP853", events=events, rtol=1e-13, atol=1e-14)
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 0:
            break
        if way == 0:
            sticks.append((begun, t))
            way = 1 if len(run.t_events[0]) else -1
            y[2] = way * limit / spring
        else:
            way, begun = 0, t
    if way == 0:
        sticks.append((begun, t1))
    return np.array(sticks), y


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 1.3])
def test_duffing_on_a_jenkins_element(ratio):
    """And derivatives of state and stick times by the spring and the cubic stiffness. Breakaway where `ratio` > 1."""
    spring, t1 = 1.5, 20.0

    def of(numbers):
        system = Duffing(numbers[0] / 0.3, numbers[1], static_ratio=ratio)
        one = ss.simulate(system, 0.0, t1=t1, y0=(0.5, 0.0), method=ss.Exact(max_steps=1024))
        return jnp.stack(one.final_state), one.sticks.start[:32], one.sticks.end[:32]

    at = np.array([spring, 0.5])
    found, slopes = jax.jit(lambda at: (of(at), jax.jacfwd(of)(at)))(at)
    sticks, final = duffing_by_scipy(spring, 0.5, ratio, t1)
    number = len(sticks)
    assert 6 < number < 32
    np.testing.assert_allclose(found[0], final, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.stack(found[1:])[:, :number].T, sticks, rtol=0, atol=1e-9)
    assert np.all(np.isnan(found[1][number:]))
    for i, h in enumerate((1e-4, 1e-4)):
        ends = [duffing_by_scipy(*(at + sign * h * np.eye(2)[i]), ratio, t1) for sign in (1, -1)]
        of_sticks, of_state = ((plus - minus) / (2 * h) for plus, minus in zip(*ends, strict=True))
        np.testing.assert_allclose(slopes[0][:, i], of_state, rtol=2e-5, atol=2e-5)
        np.testing.assert_allclose(np.stack(slopes[1:])[:, :number, i].T, of_sticks, rtol=2e-5, atol=2e-5)


@pytest.mark.slow
def test_ensembles_of_own_systems():
    """Springs that differ from sample to sample."""
    run = {"t1": 20.0, "samples": 24, "key": jax.random.key(1), "y0": (0.5, 0.0)}
    system = Duffing(ss.Uniform(3.0, 6.0))
    many = ss.simulate_ensemble(system, 0.0, keep="sticks", **run)
    for sample in (0, 17):
        own, base, y0 = many.realization(sample)
        one = ss.simulate(own, base, t1=20.0, y0=y0)
        count = int(many.flat_sticks.count[sample])
        assert count == int(one.sticks.count) > 5
        for name in ("start", "end"):
            found, expected = getattr(many.sticks, name)[sample, :count], getattr(one.sticks, name)[:count]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


@pytest.mark.usefixtures("annotations_unchecked")
def test_refusals_of_own_systems():
    class Alone(Duffing):
        contacts = None

        def relative_velocity(self, t, y, base):
            return y[1]

    class Growing(Duffing):
        def static_ratio_after(self, age):
            return 1.0 + 0.1 * age

    for system in (Alone(2.0), Growing(2.0)):
        with pytest.raises(ValueError, match=r"series_stiffness of a \w+ must come with a number of contacts"):
            ss.simulate(system, 0.0, t1=1.0)

    class Two(Duffing):
        @property
        def series_stiffness(self):
            return self.spring, 1.0

    for system in (Duffing(-1.0), Duffing(0.0), Two(1.0)):
        with pytest.raises(ValueError, match="Argument series_stiffness"):
            ss.simulate(system, 0.0, t1=1.0)
    with pytest.raises(ValueError, match=r"be Exact\(...\) for contacts with a series_stiffness"):
        ss.simulate(Duffing(2.0), 0.0, t1=1.0, method=ss.Regularized(1e-3))


@pytest.mark.usefixtures("annotations_unchecked")
def test_refusals():
    for law in (ss.Stribeck(0.2, 0.3, 0.1), ss.VelocityWeakening(0.3, 0.1)):
        with pytest.raises(ValueError, match="series_stiffness must be None for"):
            ss.Contact.of_mass(0, 1, 1.0, law, 2.0)
        with pytest.raises(ValueError, match="series_stiffness must be None for"):
            ss.MassSpring(1.0, 1.0, 1.0, law, series_stiffness=2.0)
    for stiffness in (0.0, -1.0, np.nan, "stiff"):
        with pytest.raises(ValueError, match="Argument series_stiffness must be"):
            ss.Contact.of_mass(0, 1, 1.0, ss.Coulomb(0.3), stiffness)
    for strengths in ([], [1.0, -1.0], ss.Uniform(-1.0, 2.0)):
        with pytest.raises(ValueError, match="Argument strengths must hold positive numbers"):
            ss.iwan_sliders(1.0, strengths)
    with pytest.raises(ValueError, match=r"be Exact\(...\) for contacts with a series_stiffness"):
        ss.simulate(jenkins(), 0.0, t1=1.0, method=ss.Regularized(1e-3))
    with pytest.raises(ValueError, match="series_stiffness is 2"):
        print(jenkins().stick_half_width)
