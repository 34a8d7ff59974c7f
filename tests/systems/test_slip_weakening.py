"""Friction that weakens with the slip: against exact modes from event to event, closed forms and differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.weakening_reference import ByModes, SetUp

import stickslip_jax as ss

KINDS = {
    # masses, healing, damped
    "one": (1, False, False),
    "healing": (1, True, True),
    "three": (3, False, True),
    "mixed": (3, True, False),
}


def random_set_up(kind, seed):
    masses, heals, damped = KINDS[kind]
    rng = np.random.default_rng([sorted(KINDS).index(kind), seed])
    off = -rng.uniform(0.2, 1.0, masses - 1)
    stiffness = np.diag(rng.uniform(0.2, 1.0, masses)) + np.diag(off, 1) + np.diag(off, -1)
    stiffness += np.diag(np.append(-off, 0)) + np.diag(np.insert(-off, 0, 0))
    static = rng.uniform(0.3, 0.8, masses)
    # Weakening from slower to much faster than the springs: also a limit that falls faster than their forces.
    distance = rng.uniform(0.02, 0.6, masses)
    healing = rng.uniform(0.1, 2.0, masses) if heals else np.zeros(masses)
    if heals and masses > 1:
        healing[0] = 0  # at once
    damping = np.diag(rng.uniform(0.05, 0.2, masses) if damped else np.zeros(masses))
    of = SetUp(
        rng.uniform(0.5, 2.0, masses), stiffness, damping, rng.uniform(0.5, 1.5, masses), static,
        static * rng.uniform(0.2, 0.9, masses), distance, healing,
        (rng.uniform(-0.1, 0.1), rng.uniform(0.1, 0.5)), rng.uniform(0.5, 2.5),
    )  # fmt: skip
    return of, np.append(rng.uniform(-1, 1, masses), rng.uniform(-1, 1, masses))


def law_of(of, i):
    return ss.SlipWeakening(of.static[i], of.dynamic[i], of.distance[i], of.healing[i] if of.healing[i] else None)


def as_system(of):
    base = ss.Harmonic(of.base[1], of.w, 0.0, of.base[0])
    if len(of.mass) == 1:
        damping = float(of.damping[0, 0]) or None
        return ss.MassSpring(of.mass[0], of.stiffness[0, 0], of.normal[0], law_of(of, 0), damping), base
    contacts = [ss.Contact.of_mass(i, len(of.mass), n, law_of(of, i)) for i, n in enumerate(of.normal)]
    return ss.LinearStructure(of.mass, of.stiffness, of.damping if np.any(of.damping) else None, contacts), base


def listed(one):
    sticks, mask = one.sticks, np.asarray(one.sticks.mask)
    return np.stack([np.asarray(sticks.start)[mask], np.asarray(sticks.end)[mask]], axis=1)


def compare(kind, seed, t1=20.0):
    of, y0 = random_set_up(kind, seed)
    system, base = as_system(of)
    one = ss.simulate(system, base, t1=t1, y0=tuple(y0), method=ss.Exact(max_steps=4096))
    expected = ByModes(of, y0).run(t1)
    assert one.status == 0
    np.testing.assert_allclose(one.final_state, expected.z[:-3], rtol=0, atol=1e-9)
    for i in range(len(of.mass)):
        mine = listed(one if len(of.mass) == 1 else one.of_contact(i))
        theirs = [(begin, end) for j, begin, end in expected.sticks if j == i and end > begin]
        assert len(mine) == len(theirs), (kind, seed, i, mine, theirs)
        np.testing.assert_allclose(mine, np.array(theirs).reshape(-1, 2), rtol=0, atol=1e-9)
    return len(expected.sticks)


@pytest.mark.slow_but_for("healing")
@pytest.mark.parametrize("kind", KINDS)
def test_random_set_ups(kind):
    assert sum(compare(kind, seed) for seed in range(4)) > 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_two_hundred_set_ups(kind):
    assert sum(compare(kind, seed) for seed in range(4, 54)) > 80


# Normal forces that vary and open the contact, by scipy.


def by_scipy(law, normal, mean, w, base, y0, t1):
    """Sticks and last state of a mass on a unit spring under ``mean + normal sin wt``; an open contact begins anew."""
    slope, t, y, sticks = (law.static - law.dynamic) / law.distance, 0.0, np.append(y0, 0.0), []
    level, strength = lambda t: mean + normal * np.sin(w * t), lambda s: law.static - slope * s
    mode = int(np.sign(y[1] - base))  # 0 stick, 2 open, 3 and -3 weak
    while t < t1 - 1e-13:
        sign = np.sign(mode) if abs(mode) != 2 else 0

        def rates(t, y, mode=mode, sign=sign):
            if mode == 0:
                return [base, 0, 0]
            coefficient = {1: strength(y[2]), 2: 0, 3: law.dynamic}[abs(mode)]
            return [y[1], -y[0] - sign * coefficient * level(t), sign * (y[1] - base)]

        events = {
            0: [lambda t, y: law.static * level(t) - abs(y[0]), lambda t, y: level(t)],
            2: [lambda t, y: -level(t)],
        }.get(mode, [lambda t, y, sign=sign: sign * (y[1] - base), lambda t, y: level(t)])
        if abs(mode) == 1:
            events.append(lambda t, y: law.distance - y[2])
        for event in events:
            event.terminal, event.direction = True, -1
        found = solve_ivp(rates, (t, t1), y, "DOP853", rtol=3e-14, atol=1e-15, events=events, max_step=0.05)
        begun, t, y = t, found.t[-1], found.y[:, -1]
        if mode == 0:
            sticks.append((begun, t))
        if found.status == 0:
            break
        which = next(i for i, times in enumerate(found.t_events) if len(times))
        if mode == 0:
            mode = (-int(np.sign(y[0])), 2)[which]
        elif mode == 2:
            mode = int(np.sign(y[1] - base))
        elif which == 0:
            mode = 0 if abs(y[0]) <= law.static * level(t) else -mode
            y[1] = base
        else:
            mode = 2 if which == 1 else 3 * mode
        if mode in (0, 2):
            y[2] = 0
    return np.array(sticks), y


@pytest.mark.slow
@pytest.mark.parametrize("mean", [1.2, 0.5])
def test_normal_forces_that_vary(mean):
    law, base = ss.SlipWeakening(0.7, 0.3, 0.15), 0.3
    system = ss.MassSpring(1.0, 1.0, ss.Harmonic(0.8, 1.7, -np.pi / 2, mean), law)
    one = ss.simulate(system, base, t1=30.0, y0=(0.9, 0.0))
    sticks, y = by_scipy(law, 0.8, mean, 1.7, base, (0.9, 0.0), 30.0)
    assert len(sticks) > 2
    np.testing.assert_allclose(listed(one), sticks, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.final_state, y, rtol=0, atol=1e-9)


# Closed forms of ruptures: a block that is pulled slowly.


@pytest.mark.slow_for("1e-05")
@pytest.mark.parametrize("distance", [1e-5, 0.02, 0.045])
def test_a_rupture_by_its_energy(distance):
    """The spring gives up what friction takes: ``k S^2 / 2 - drop S + drop distance / 2 = 0`` for the slip S, with the
    drop ``(static - dynamic) normal_force``; for a distance of zero ``S = 2 drop / k``, the stress falls by twice it.
    """
    k, drop = 4.0, 0.2
    block = ss.MassSpring(1.0, k, 1.0, ss.SlipWeakening(0.6, 0.4, distance))
    one = ss.simulate(block, 1e-8, t1=80.0, y0=(0.6 / k - 1e-8, 1e-8), method=ss.Exact(max_steps=4096))
    start, end = listed(one)[:2, 0], listed(one)[:2, 1]
    slip = float(one.evaluate(end[0])[0] - one.evaluate(start[1])[0])
    expected = drop / k * (1 + np.sqrt(1 - k * distance / drop))
    assert slip == pytest.approx(expected, abs=1e-6)
    assert end[0] == pytest.approx(1.0, abs=1e-6)
    stress = -one.friction_force(np.array([end[0] - 1e-9, start[1] + 1e-9]))
    np.testing.assert_allclose(stress, [-0.6, -0.6 + k * expected], rtol=0, atol=1e-5)


@pytest.mark.parametrize(("share", "is_sudden"), [(0.9, True), (1.5, False)])
def test_a_stiff_spring_does_not_let_a_rupture_begin(share, is_sudden):
    """Sudden if ``k < drop / distance``. With the displacement r on the base, which moves with V, the equation is
    ``r'' = -(k - drop / distance) r - k V t``: else the block swings about a slip in proportion to the pull.
    """
    k, drop, pulled = 4.0, 0.2, 1e-3
    block = ss.MassSpring(1.0, k, 1.0, ss.SlipWeakening(0.6, 0.4, share * drop / k))
    one = ss.simulate(block, pulled, t1=15.0, y0=(0.6 / k, pulled), method=ss.Exact(max_steps=4096))
    times, left = np.linspace(0, 3, 31), k * (1 - 1 / share)
    swing = np.cos(np.emath.sqrt(left) * times).real
    found = np.asarray(one.evaluate(times))[1] - pulled
    np.testing.assert_allclose(found, -k * pulled / left * (1 - swing), rtol=0, atol=1e-12)
    fastest = np.max(np.abs(np.asarray(one.evaluate(np.linspace(0, 15, 3001)))[1] - pulled))
    assert fastest > 20 * pulled if is_sudden else fastest < (2 * k / left + 1e-9) * pulled


# As everywhere: derivatives, energies, ensembles, motions that go on, refusals.


AT = {"static": 0.6, "dynamic": 0.3, "distance": 0.2, "healing": 0.7}


def system_with(masses=1, **numbers):
    law = ss.SlipWeakening(**{**AT, **numbers})
    if masses == 1:
        return ss.MassSpring(1.0, 1.0, 1.0, law)
    row = ss.block_row(2, mass=1.0, between=1.0, to_ground=0.5, normal_force=1.0, friction=law)
    between = ss.Contact.between(0, 1, 2, 0.5, ss.SlipWeakening(0.5, 0.3, 0.1))
    return ss.LinearStructure(row.mass, row.stiffness, None, (*row.contacts[:1], between))


@pytest.mark.slow
@pytest.mark.parametrize("name", AT)
def test_derivatives(name):
    def of(value):
        start = jnp.zeros(2).at[0].set(1.0)
        system, method = system_with(**{"healing": None, name: value}), ss.Exact(max_steps=1024)
        one = ss.simulate(system, ss.Harmonic(0.35, 0.7), t1=11.5, y0=start, method=method)
        return jnp.stack([one.stick_time, *one.final_state])

    at, h = AT[name], 1e-6
    differences = (of(at + h) - of(at - h)) / (2 * h)
    assert np.all(np.abs(differences[:3]) > 1e-3)
    np.testing.assert_allclose(jax.jacfwd(of)(at), differences, rtol=1e-6, atol=1e-6)
    if name != "distance":
        np.testing.assert_allclose(jax.jacrev(of)(at), differences, rtol=1e-6, atol=1e-6)
        second = (jax.jacfwd(of)(at + h) - jax.jacfwd(of)(at - h)) / (2 * h)
        np.testing.assert_allclose(jax.jacfwd(jax.jacfwd(of))(at), second, rtol=1e-5, atol=1e-4)


@pytest.mark.slow
def test_derivatives_of_coupled_contacts():
    def of(value):
        one = ss.simulate(
            system_with(2, dynamic=value), ss.Harmonic(0.5, 1.1), t1=20.0, y0=(1.0, -0.5, 0.2, 0.0),
            method=ss.Exact(max_steps=2048),
        )  # fmt: skip
        return jnp.stack(one.final_state)

    differences = (of(0.3 + 1e-6) - of(0.3 - 1e-6)) / 2e-6
    np.testing.assert_allclose(jax.jacfwd(of)(0.3), differences, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_a_short_distance_comes_to_static_above_kinetic_friction():
    """Of contacts that act on each other. A slip takes a time to begin that falls as the root of the distance."""
    base, off = ss.Harmonic(0.5, 1.1), []
    for law in (ss.Coulomb(0.3, 0.5), *(ss.SlipWeakening(0.5, 0.3, distance) for distance in (1e-3, 1e-5, 1e-7))):
        contacts = ss.Contact.of_mass(0, 2, 1.0, law), ss.Contact.between(0, 1, 2, 0.5, law)
        system = ss.LinearStructure([1.0, 0.7], [[1.5, -0.5], [-0.5, 1.0]], None, contacts)
        one = ss.simulate(system, base, t1=20.0, y0=(1.0, -0.5, 0.2, 0.0))
        off.append(np.append(one.final_state[:4], one.of_contact(1).stick_time))
    errors = [np.max(np.abs(found - off[0])) for found in off[1:]]
    assert errors[0] > 4 * errors[1] > 16 * errors[2]
    assert errors[2] < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("masses", [1, 2])
def test_energies_and_forces(masses):
    system, base = system_with(masses, healing=None), ss.Harmonic(0.4, 1.3)
    one = ss.simulate(system, base, t1=25.0, y0=(1.0, 0.0, 0.2, -0.1)[: 2 * masses])
    times = np.linspace(0, 25, 26)
    energies = one.energies(times)
    assert energies.dissipated["friction"][-1] > 0.3
    np.testing.assert_allclose(energies.imbalance, 0, atol=1e-10)
    slip, force = np.asarray(one.evaluate(times))[2 * masses], np.abs(one.friction_force(times))
    force, slides = (
        (force, one.relative_velocity(times)) if masses == 1 else (force[0], one.relative_velocity(times)[0])
    )
    expected = 0.6 - 0.3 * np.minimum(slip / 0.2, 1)
    np.testing.assert_allclose(force[slides != 0], expected[slides != 0], rtol=0, atol=1e-12)
    assert np.all(force <= 0.6 + 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("healing", [0.7, None])
def test_motions_go_on_from_any_state(healing):
    system, base, method = system_with(healing=healing), ss.Constant(0.3), ss.Exact(max_steps=1024)
    whole = ss.simulate(system, base, t1=20.0, y0=(0.9, 0.0), method=method)
    for time in (0.7, *np.mean(listed(whole)[:2], axis=1)):
        first = ss.simulate(system, base, t1=time, y0=(0.9, 0.0), method=method)
        rest = ss.simulate(system, base, t1=20.0 - time, y0=tuple(first.final_state), method=method)
        np.testing.assert_allclose(rest.final_state, whole.final_state, rtol=0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("masses", [1, 2])
def test_ensembles_are_single_runs(masses):
    law, key = ss.PoissonSwitching(0.4, rate=0.7), jax.random.key(3)
    distances, y0 = np.linspace(0.05, 0.4, 6), (0.5, 1.2, 0.3, 0.1)[: 2 * masses]
    system = system_with(masses, distance=distances)
    system = system if masses == 1 else system.of_contact(0)
    many = ss.simulate_ensemble(system, law, t1=30.0, samples=6, key=key, y0=y0, keep="totals", progress=False)

    @jax.jit
    @jax.vmap
    def single(sample, distance):
        base = law.sample(jax.random.fold_in(key, sample), 30.0)
        own = system_with(masses, distance=distance)
        own = own if masses == 1 else own.of_contact(0)
        return ss.simulate(own, base, t1=30.0, y0=y0, method=ss.Exact(max_steps=4000)).totals.stick_time

    np.testing.assert_allclose(many.totals.stick_time, single(np.arange(6), distances), rtol=0, atol=1e-9)
    assert np.ptp(many.totals.stick_time) > 0.1


def test_what_does_not_fit_is_told():
    law = ss.SlipWeakening(0.6, 0.4, 0.02)
    ageing = ss.Ageing(ss.Coulomb(0.3), ss.ExponentialGrowth(0.1, 1.0))
    block, base = ss.MassSpring(1.0, 4.0, 1.0, law), ss.Constant(0.1)
    contacts = [ss.Contact.of_mass(i, 2, 1.0, one) for i, one in enumerate((law, ageing))]
    for make, message in (
        (lambda: ss.SlipWeakening(0.3, 0.4, 0.02), "Argument static must be at least dynamic = 0.4"),
        (lambda: ss.SlipWeakening(0.6, 0.4, 0.0), "Argument distance must be positive"),
        (lambda: ss.SlipWeakening(0.6, 0.4, 0.1, healing=0.0), "Argument healing must be positive"),
        (lambda: ss.simulate(block, base, t1=1.0, method=ss.Regularized(1e-3)), "that weakens with the slip distance"),
        (lambda: ss.MotorCart(friction=law), "Argument friction must be no SlipWeakening"),
        (lambda: ss.Directional(law, law), "Argument forward must be a friction law without an inner state"),
        (lambda: ss.MassSpring(1.0, 4.0, 1.0, law, series_stiffness=1.0), "Argument series_stiffness must be None"),
        (lambda: law.force([0.0, 1.0], [0.1, 0.1]), "Argument law must be a friction law without an inner state"),
        (lambda: ss.LinearStructure([1.0, 1.0], [1.0, 1.0], None, contacts).memory, "both SlipWeakening and Ageing"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
