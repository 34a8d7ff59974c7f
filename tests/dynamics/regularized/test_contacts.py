"""Regularised dynamics of several contacts: against scipy, the exact engine, one contact, and differences."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.regularized import PHI

import stickslip_jax as ss

# Three blocks on the floor, from an event-by-event integration (rtol 1e-12); see tests/reference/test_contacts.py.
CHAIN = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
CHAIN_START = (-1.0, 1, -1, -1, 1, 1)
CHAIN_STARTS = [4.63544896516, 4.96043120202, 6.78298795467, 7.34343581525, 8.37062952656]
CHAIN_RELEASES = [4.82994374361, 5.08551319834]
CHAIN_POSITIONS = [0.202558662099, 0.412765621355, 0.531438212051]

# A stack that is coupled by its contacts and by its mass matrix, on a shaken floor; the last contact opens.
WIDTH, T1 = 1e-2, 6.0
DIRECTIONS = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 1]])
MASS = np.array([[1.0, 0.2, 0], [0.2, 0.8, 0.1], [0, 0.1, 0.5]])
STIFFNESS = np.array([[2.0, -0.5, 0], [-0.5, 1.5, 0], [0, 0, 1.0]])
MU, NORMAL = np.array([0.2, 0.3, 0.25]), np.array([5.0, 2.0, 1.0])
START = (0.5, -0.2, 0.1, 0.0, 0.3, -0.4)
FLOOR = ss.Harmonic(0.8, 1.1)

ADAPTIVE = pytest.param({"rtol": 1e-8}, id="adaptive", marks=pytest.mark.slow)  # which take long to compile


def chain(mu=0.3):
    contacts = tuple(ss.Contact.of_mass(i, 3, 1.0, ss.Coulomb(mu)) for i in range(3))
    return ss.LinearStructure(np.ones(3), CHAIN, CHAIN / 10, contacts)


def stack(mu=MU, mass=MASS):
    normal = (NORMAL[0], NORMAL[1], ss.Harmonic(NORMAL[2], 1.7, 0.3, offset=0.3))
    contacts = tuple(
        ss.Contact(DIRECTIONS[i], normal[i], ss.Coulomb(mu[i]), on_base=1.0 if i == 0 else 0.0) for i in range(3)
    )
    return ss.LinearStructure(mass, STIFFNESS, 0.05 * STIFFNESS, contacts)


class Stack(ss.SwitchedSystem):
    """The same in equations of its own, with a spring that hardens and a normal force that depends on the state."""

    mu: float = 0.3
    contacts = 3

    @property
    def state_names(self):
        return tuple(f"{name} {i} in {unit}" for name, unit in (("x", "m"), ("v", "m/s")) for i in range(3))

    def rates(self, t, y, base, friction):
        x, v = jnp.stack(y[:3]), jnp.stack(y[3:])
        pull = -x - 0.2 * x**3 - 0.05 * v - DIRECTIONS.T @ (self.mu * friction)
        return *y[3:], *jnp.linalg.solve(jnp.asarray(MASS), pull)

    def relative_velocity(self, t, y, base):
        return DIRECTIONS @ jnp.stack(y[3:]) - jnp.asarray([1.0, 0, 0]) * base.velocity

    def normal_forces(self, t, y, base):
        return 5.0, 2.0, 0.3 + 2.0 * y[2]

    @property
    def shortest_time(self):
        return 3.0

    @property
    def speed_scale(self):
        return 1.0


def radau(load, normal, mu, shape):
    """The state at the end by scipy's implicit Radau method, from the equations as they are written in the docs."""
    inverse = np.linalg.inv(MASS)

    def field(t, y):
        relative = DIRECTIONS @ y[3:] - [0.8 * np.cos(1.1 * t), 0, 0]
        friction = mu * np.maximum(normal(t, y), 0) * PHI[shape](relative / WIDTH)
        return np.r_[y[3:], inverse @ (load(y) - DIRECTIONS.T @ friction)]

    return solve_ivp(field, (0, T1), START, "Radau", rtol=1e-10, atol=1e-12).y[:, -1]


def radau_of_stack(shape):
    return radau(
        lambda y: -STIFFNESS @ (y[:3] + 0.05 * y[3:]),
        lambda t, y: np.r_[NORMAL[:2], 0.3 + NORMAL[2] * np.cos(1.7 * t + 0.3)],
        MU,
        shape,
    )


def radau_of_own(shape):
    return radau(
        lambda y: -y[:3] - 0.2 * y[:3] ** 3 - 0.05 * y[3:], lambda t, y: [5.0, 2.0, 0.3 + 2.0 * y[2]], 0.3, shape
    )


def shown(one, number):
    """Starts and ends of the sticks of one contact."""
    sticks = one.of_contact(number).sticks
    mask = np.asarray(sticks.mask)
    return np.asarray(sticks.start)[mask], np.asarray(sticks.end)[mask]


@pytest.mark.slow
@pytest.mark.parametrize("how", [pytest.param({"step": 1e-3}, id="fixed"), ADAPTIVE])
def test_three_blocks_converge_to_the_exact_events(how):
    """With order 1: errors of all events and positions halve with the width, to a tenth."""

    @jax.jit
    def follow(width):
        method = ss.Regularized(width, max_steps=16384, **how)
        return ss.simulate(chain(), ss.Constant(0.0), t1=12.0, y0=CHAIN_START, method=method)

    errors, widths = [], [4e-3, 2e-3, 1e-3]
    for width in widths:
        one = follow(width)
        assert int(one.status) == ss.Status.FINISHED
        assert list(one.totals.sticks) == [2, 1, 2]
        sticks = jax.tree.map(lambda leaf: np.asarray(leaf)[:5], one.sticks)
        assert np.all(sticks.mask)
        np.testing.assert_array_equal(sticks.contact, [0, 2, 1, 0, 2])
        np.testing.assert_array_equal(sticks.ending, [ss.Ending.RELEASED] * 2 + [ss.Ending.HORIZON] * 3)
        together = one.of_all_contacts().sticks
        assert int(together.count) == 1
        assert float(together.start[0]) == float(sticks.start[-1])
        exact = [*CHAIN_STARTS, *CHAIN_RELEASES, *CHAIN_POSITIONS[1:]]
        errors.append([*sticks.start, *sticks.end[:2], *map(float, one.final_state[1:3])] - np.array(exact))
    assert np.all(np.abs(errors[-1]) < 10 * widths[-1])
    for coarse, fine in itertools.pairwise(errors):
        np.testing.assert_allclose(coarse / fine, 2.0, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["linear", pytest.param("tanh", marks=pytest.mark.slow)])
def test_fixed_steps_follow_the_equations(shape):
    """Coupled contacts, one of which opens, against scipy; a second-order method gains 4 by half the step."""
    reference = radau_of_stack(shape)

    @jax.jit
    def end(step):
        method = ss.Regularized(WIDTH, shape, step=step, max_steps=8192, threshold=WIDTH, minimum_duration=0.05)
        return jnp.stack(ss.simulate(stack(), FLOOR, t1=T1, y0=START, method=method).final_state)

    errors = [float(np.max(np.abs(end(step) - reference))) for step in (4e-3, 1e-3)]
    assert errors[0] < 2e-5
    assert errors[1] < errors[0] / 6


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["linear", "tanh"])
def test_adaptive_steps_follow_the_equations(shape):
    method = ss.Regularized(WIDTH, shape, rtol=1e-9)
    one = ss.simulate(stack(), FLOOR, t1=T1, y0=START, method=method)
    np.testing.assert_allclose(jnp.stack(one.final_state), radau_of_stack(shape), atol=2e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "error"),
    [({"step": 2e-3}, 2e-5), pytest.param({"rtol": 1e-9}, 2e-8, marks=pytest.mark.slow)],
)
def test_equations_of_ones_own(how, error):
    one = ss.simulate(Stack(), FLOOR, t1=T1, y0=START, method=ss.Regularized(WIDTH, **how))
    assert int(one.status) == ss.Status.FINISHED
    np.testing.assert_allclose(jnp.stack(one.final_state), radau_of_own("linear"), atol=error)


@pytest.mark.slow
def test_sticks_are_those_of_the_exact_engine():
    """Which contact sticks when, all at once too, where a contact opens; the times differ by the width over F."""
    exact = ss.simulate(stack(), FLOOR, t1=10.0, y0=START)
    smooth = ss.simulate(stack(), FLOOR, t1=10.0, y0=START, method=ss.Regularized(1e-4, step=1e-3))
    for of in (*(lambda one, i=i: one.of_contact(i) for i in range(3)), lambda one: one.of_all_contacts()):
        one, other = of(exact), of(smooth)
        assert int(one.sticks.count) == int(other.sticks.count) > 0
        count = int(one.sticks.count)
        for name in ("start", "end", "position", "slip_displacement"):
            np.testing.assert_allclose(
                getattr(one.sticks, name)[:count], getattr(other.sticks, name)[:count], atol=4e-3
            )
        np.testing.assert_array_equal(one.sticks.ending[:count], other.sticks.ending[:count])


@pytest.mark.slow
@pytest.mark.parametrize("how", [pytest.param({"step": 2e-3}, id="fixed"), ADAPTIVE])
def test_a_clutch_that_is_opened_and_closed(how):
    """Its stick ends where the force jumps to zero, and begins where it is closed at rest; open, nothing sticks.

    Two free inertias; the second is pushed while the clutch is open. With N = 20 N, mu = 0.5 a speed difference of
    1 rad/s stops in 1/20 s (both have 1 kg m^2), so that it sticks in [0.05, 1] and again from 2.05 s on.
    """
    force = ss.ForceSteps(times=[0.0, 1.0, 2.0], values=[20.0, 0.0, 20.0])
    load = ss.Recorded([0.0, 1.0, 1.5, 2.0, 4.0], [0.0, 0.0, 2.0, 0.0, 0.0])
    clutch = ss.Contact.between(1, 0, 2, force, ss.Coulomb(0.5))
    train = ss.LinearStructure([1.0, 1.0], [0.0, 0.0], contacts=(clutch,), force=(None, load))
    method = ss.Regularized(1e-4, **how)
    one = ss.simulate(train, ss.Constant(0.0), t1=3.0, y0=(0.0, 0.0, 1.0, 0.0), method=method)
    starts, ends = shown(one, 0)
    np.testing.assert_allclose(starts, [0.05, 2.05], atol=1e-4)
    np.testing.assert_allclose(ends, [1.0, 3.0], atol=1e-12)
    assert [int(code) for code in one.sticks.ending[:2]] == [ss.Ending.RELEASED, ss.Ending.HORIZON]
    np.testing.assert_allclose(one.final_state[2:], [1.0, 1.0], atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["linear", pytest.param("arctan", marks=pytest.mark.slow)])
def test_one_contact_of_a_list_is_the_mass_alone(shape):
    """Two programs for one motion: the scalar balance of one contact, and that of a list with one entry."""
    law = ss.PoissonSwitching(speed=1.0, rate=1.0).sample(jax.random.key(0), 20.0)
    method = ss.Regularized(1e-3, shape, step=0.01)
    alone = ss.MassSpring(1.2, 4.0, 1.5, ss.Coulomb(0.6), 0.1, ss.Harmonic(0.3, 1.1))
    contact = ss.Contact(np.ones(1), 1.5, ss.Coulomb(0.6))
    listed = ss.LinearStructure([1.2], [4.0], [0.1], (contact,), (ss.Harmonic(0.3, 1.1),))
    one = ss.simulate(alone, law, t1=20.0, y0=(0.0, 1.0), method=method)
    other = ss.simulate(listed, law, t1=20.0, y0=(0.0, 1.0), method=method).of_contact(0)
    count = int(one.sticks.count)
    assert count == int(other.sticks.count) > 1
    for name in ("start", "end", "position", "slip_displacement", "ending"):
        np.testing.assert_allclose(getattr(one.sticks, name)[:count], getattr(other.sticks, name)[:count], atol=1e-12)
    assert float(one.method.minimum_duration) == pytest.approx(float(other.method.minimum_duration[0]), rel=1e-12)
    assert float(one.method.threshold) == pytest.approx(float(other.method.threshold[0]), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow)])
def test_derivatives_are_those_of_differences(mode):
    """By a friction coefficient and an entry of the mass matrix, of the end and of a stick's start."""
    method = ss.Regularized(WIDTH, step=5e-3, max_steps=2048, threshold=WIDTH, minimum_duration=0.05)

    def results(values):
        mass = jnp.asarray(MASS).at[0, 1].set(values[1]).at[1, 0].set(values[1])
        one = ss.simulate(stack((values[0], *MU[1:]), mass), FLOOR, t1=T1, y0=START, method=method)
        found = jnp.array([one.final_state[0], one.of_contact(0).sticks.start[0]])
        return found, found

    both = jax.jit(mode(results, has_aux=True))  # compiled once: a function and its derivatives
    at, change = jnp.array([0.2, 0.2]), 1e-5
    columns = [(both(at + change * e)[1] - both(at - change * e)[1]) / (2 * change) for e in jnp.eye(2)]
    np.testing.assert_allclose(both(at)[0], jnp.stack(columns, axis=1), rtol=2e-5, atol=1e-7)


@pytest.mark.slow
def test_derivatives_of_adaptive_steps():
    def end(mu):
        method = ss.Regularized(WIDTH, rtol=1e-10)
        return ss.simulate(stack((mu, *MU[1:])), FLOOR, t1=3.0, y0=START, method=method).final_state[0]

    difference = (end(0.2 + 1e-4) - end(0.2 - 1e-4)) / 2e-4
    assert float(jax.grad(end)(0.2)) == pytest.approx(float(difference), rel=1e-4)


@pytest.mark.slow
def test_samples_are_single_runs(tmp_path):
    """Each sample of an ensemble with uncertain friction is its single run, each contact and all at once; and it comes
    back from a file.
    """
    uncertain = ss.LinearStructure(
        [1.0, 1.0], [[2.2, -1.2], [-1.2, 2.2]],
        contacts=(ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(ss.Uniform(0.2, 0.4))),
                  ss.Contact.between(1, 0, 2, 1.3, ss.Coulomb(0.3))),
    )  # fmt: skip
    law = ss.PoissonSwitching(speed=0.3, rate=1.0)
    how = {"t1": 20.0, "method": ss.Regularized(1e-3, step=0.01)}
    drawn = {"samples": 30, "key": jax.random.key(0), "keep": "sticks"}
    many = ss.simulate_contacts(uncertain, law, **drawn, **how)
    assert many.status_counts[ss.Status.FINISHED] == 30
    counted = ss.simulate_ensemble(uncertain.of_contact(1), law, **drawn, **how)
    for name in ("start", "end", "position", "ending"):
        np.testing.assert_array_equal(getattr(counted.sticks, name), getattr(many.of_contact(1).sticks, name))
    counted.save(tmp_path / "many.nc")
    loaded = ss.load(tmp_path / "many.nc")
    np.testing.assert_array_equal(loaded.sticks.start, counted.sticks.start)
    for sample in (0, 17):
        system, base, y0 = many.realization(sample)
        one = ss.simulate(system, base, y0=y0, **how)
        parts = [(one.of_contact(i), many.of_contact(i)) for i in range(2)]
        for single, ensemble in (*parts, (one.of_all_contacts(), many.of_all_contacts())):
            mask = np.asarray(ensemble.sticks.mask[sample])
            assert int(single.sticks.count) == mask.sum() > 0
            for name in ("start", "end", "position", "slip_displacement"):
                here = np.asarray(getattr(single.sticks, name))[: mask.sum()]
                np.testing.assert_allclose(np.asarray(getattr(ensemble.sticks, name)[sample])[mask], here, atol=1e-12)
            assert float(single.stick_time) == pytest.approx(float(ensemble.totals.stick_time[sample]), abs=1e-12)


@pytest.mark.slow
def test_adaptive_samples_of_one_contact_are_single_runs():
    law = ss.PoissonSwitching(speed=0.3, rate=1.0)
    how = {"t1": 3.0, "method": ss.Regularized(1e-2)}
    many = ss.simulate_ensemble(
        chain().of_all_contacts(), law, samples=3, key=jax.random.key(0), y0=CHAIN_START, keep="sticks", **how
    )
    for sample in range(3):
        system, base, y0 = many.realization(sample)
        one = ss.simulate(system, base, y0=y0, **how)
        assert float(one.stick_time) == pytest.approx(float(many.totals.stick_time[sample]), abs=1e-9)


@pytest.mark.slow
def test_static_above_kinetic_friction_in_adaptive_steps():
    """One mass of a list against the exact engine: releases at the static limit."""
    contact = ss.Contact(np.ones(1), 4.0, ss.Coulomb(0.25, 0.375))
    block = ss.LinearStructure([0.5], [1.0], contacts=(contact,))
    how = {"t1": 12.0, "y0": (0.0, 0.0)}
    exact = ss.simulate(block, ss.Constant(0.3), **how)
    smooth = ss.simulate(block, ss.Constant(0.3), method=ss.Regularized(1e-4, rtol=1e-8), **how)
    assert int(exact.sticks.count) == int(smooth.sticks.count) > 0
    for ours, theirs in zip(shown(exact, 0), shown(smooth, 0), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=8e-3)


# Static friction above kinetic friction, in fixed steps: two coupled blocks, one of which rubs on the other.

PAIR = np.array([0.3, 0.25, 1.5, 1.3, 0.8, 0.2])  # kinetic coefficients, static over kinetic, coupling, belt in m/s
PAIR_START = (-0.5, 0.7, 0.2, -0.3)


def pair(numbers):
    mu, ratio, coupling = numbers[:2], numbers[2:4], numbers[4]
    stiffness = jnp.eye(2) + coupling * jnp.array([[1.0, -1.0], [-1.0, 1.0]])
    contacts = (
        ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(mu[0], mu[0] * ratio[0])),
        ss.Contact.between(1, 0, 2, 1.3, ss.Coulomb(mu[1], mu[1] * ratio[1])),
    )
    return ss.LinearStructure([1.0, 0.7], stiffness, contacts=contacts)


def motion_of_pair(method, t1=15.0):
    @jax.jit
    def follow(numbers, y0, *width_and_step):
        own = (
            ss.Regularized(width_and_step[0], "linear", step=width_and_step[1], **method) if width_and_step else method
        )
        one = ss.simulate(pair(numbers), ss.Constant(numbers[5]), t1=t1, y0=tuple(y0), method=own)
        return one.status, one.totals.sticks, one.totals.stick_time, jnp.stack(one.final_state)

    return follow


@pytest.mark.slow
def test_static_friction_in_fixed_steps_converges_to_the_exact_motion():
    """In random set-ups the same sticks in each contact, and errors of the end that fall with the width, of order 1."""
    exact = motion_of_pair(ss.Exact(max_steps=4000, step=0.05))
    fixed = motion_of_pair({"max_steps": 40_000})
    rng, widths = np.random.default_rng(1), np.array([1e-3, 1e-4, 1e-5])
    errors, same, total = [], 0, 0
    for _ in range(30):
        numbers = jnp.asarray(
            [*rng.uniform(0.1, 0.4, 2), *rng.uniform(1.05, 2.0, 2), *rng.uniform([0.2, 0.05], [2, 0.4])]
        )
        y0 = jnp.asarray(rng.uniform(-1, 1, 4))
        status, sticks, times, end = exact(numbers, y0)
        found = [fixed(numbers, y0, width, 4e-3) for width in widths]
        assert int(status) == ss.Status.FINISHED
        assert all(int(one[0]) == ss.Status.FINISHED for one in found)
        errors.append([np.max(np.abs(one[3] - end)) for one in found])
        same, total = same + np.sum(np.asarray(found[-1][1]) == np.asarray(sticks)), total + 2
        np.testing.assert_allclose(found[-1][2], times, rtol=0, atol=0.02)
    assert same == total
    assert np.max(errors, axis=0)[-1] < 2e-3
    slopes = np.polyfit(np.log(widths), np.log(errors).T, 1)[0]
    assert np.median(slopes) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("shape", ["linear", pytest.param("tanh", marks=pytest.mark.slow)])
def test_static_friction_of_a_list_of_one_contact(shape):
    """On a belt, in fixed steps that do not resolve the width: release and arrival of the closed form."""
    contact = ss.Contact(np.ones(1), 4.0, ss.Coulomb(0.25, 0.375))
    block = ss.LinearStructure([0.5], [1.0], contacts=(contact,))
    method = ss.Regularized(1e-6, shape, step=4e-3, max_steps=8000)
    one = ss.simulate(block, ss.Constant(0.3), t1=8.0, y0=(0.0, 0.3), method=method)
    release, turn = 1.5 / 0.3, 2 * np.arctan2(0.5 * 2**0.5, 0.3)  # sticks up to 1.5 m, slips about 1 m
    starts, ends = shown(one, 0)
    np.testing.assert_allclose(starts, [0.0, release + (2 * np.pi - turn) / 2**0.5], rtol=0, atol=1e-3)
    assert ends[0] == pytest.approx(release, abs=1e-4)
    assert float(one.final_state[0]) == pytest.approx(0.5 + 0.3 * (8 - starts[1]), abs=1e-3)


def radau_of_pair(numbers, width, t1):
    mu, ratio, coupling, belt = numbers[:2], numbers[2:4], numbers[4], numbers[5]
    stiffness = np.eye(2) + coupling * np.array([[1, -1], [-1, 1]])
    directions, normal = np.array([[1.0, 0], [-1, 1]]), np.array([1.0, 1.3])

    def field(t, y):
        s = (directions @ y[2:] - [belt, 0]) / width
        beyond = np.maximum(np.abs(s) - 1, 0)
        part = np.clip(s, -1, 1)
        friction = normal * mu * part * (1 + (ratio - 1) * np.exp(-beyond))
        return np.r_[y[2:], (-stiffness @ y[:2] - directions.T @ friction) / [1.0, 0.7]]

    return solve_ivp(field, (0, t1), PAIR_START, "Radau", rtol=1e-10, atol=1e-12, max_step=0.02).y[:, -1]


@pytest.mark.slow
def test_static_friction_in_fixed_steps_that_resolve_the_width():
    """The end is that of the smooth field, by Radau; its derivatives those of differences of that, in both modes."""
    width, t1 = 5e-2, 6.0
    follow = motion_of_pair({"max_steps": 8000}, t1)

    def end(numbers):
        return follow(numbers, jnp.asarray(PAIR_START), width, 1e-3)[3]

    np.testing.assert_allclose(end(jnp.asarray(PAIR)), radau_of_pair(PAIR, width, t1), rtol=0, atol=2e-5)
    change, columns = 1e-4, []
    for e in np.eye(6):
        there, back = (radau_of_pair(PAIR + side * change * e, width, t1) for side in (1, -1))
        columns.append((there - back) / (2 * change))
    expected = np.stack(columns, axis=1)
    for mode in (jax.jacfwd, jax.jacrev):
        found = jax.jit(mode(end))(jnp.asarray(PAIR))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-2 * np.max(np.abs(expected)))


@pytest.mark.slow
def test_static_friction_of_samples_in_fixed_steps():
    """Each sample is its single run."""
    friction = ss.Coulomb(ss.Uniform(0.2, 0.3), 0.4)
    contacts = (ss.Contact.of_mass(0, 2, 1.0, friction), ss.Contact.between(1, 0, 2, 1.3, ss.Coulomb(0.3, 0.5)))
    uncertain = ss.LinearStructure([1.0, 1.0], [[2.2, -1.2], [-1.2, 2.2]], contacts=contacts)
    law, how = ss.PoissonSwitching(speed=0.3, rate=1.0), {"t1": 10.0, "method": ss.Regularized(1e-4, step=0.01)}
    many = ss.simulate_contacts(uncertain, law, samples=6, key=jax.random.key(0), keep="sticks", **how)
    assert many.status_counts[ss.Status.FINISHED] == 6
    for sample in (0, 4):
        system, base, y0 = many.realization(sample)
        one = ss.simulate(system, base, y0=y0, **how)
        assert int(one.totals.sticks.sum()) > 0
        for i in range(2):
            mask = np.asarray(many.of_contact(i).sticks.mask[sample])
            single = one.of_contact(i)
            assert int(single.sticks.count) == mask.sum()
            here = np.asarray(single.sticks.start)[: mask.sum()]
            np.testing.assert_allclose(np.asarray(many.of_contact(i).sticks.start[sample])[mask], here, atol=1e-9)


class Held(Stack):
    """A stack whose static friction exceeds the kinetic one, with a contact that opens."""

    static_ratio = 1.4


@pytest.mark.slow
def test_static_friction_in_fixed_steps_of_ones_own():
    how = {"t1": T1, "y0": START}
    exact = ss.simulate(Held(), FLOOR, **how)
    errors = []
    for width in (1e-4, 1e-5):
        one = ss.simulate(Held(), FLOOR, method=ss.Regularized(width, "linear", step=2e-3, max_steps=16384), **how)
        assert int(one.status) == ss.Status.FINISHED
        np.testing.assert_array_equal(one.totals.sticks, exact.totals.sticks)
        errors.append(np.max(np.abs(np.array(one.final_state) - np.array(exact.final_state))))
    assert errors[1] < 1e-3


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda run: run(ss.Regularized(1e-3, threshold=np.ones(2))), "or one for each of the 3 contacts"),
        (lambda run: run(ss.Regularized(1e-3, minimum_duration=np.ones((3, 1)))), "Argument minimum_duration must"),
        (lambda run: run(ss.Regularized(1e-3, threshold=-np.ones(3))), "Argument threshold must be positive"),
        (lambda run: run(ss.Regularized(1e-3, step=0.5)), "Argument step must be at most"),
    ],
)  # fmt: skip
def test_bad_input_is_told(call, message):
    def run(method, friction=None):
        friction = ss.Coulomb(0.3) if friction is None else friction
        contacts = tuple(ss.Contact.of_mass(i, 3, 1.0, friction) for i in range(3))
        return ss.simulate(ss.LinearStructure(np.ones(3), CHAIN, None, contacts), FLOOR, t1=1.0, method=method)

    with pytest.raises(ValueError, match=message):
        call(run)


def test_what_needs_a_number_is_told():
    law = ss.PoissonSwitching(speed=0.3, rate=1.0)
    with pytest.raises(ValueError, match="must be one number, but an array"):
        ss.simulate(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5)), law.sample(jax.random.key(0), 1.0), t1=1.0,
            method=ss.Regularized(1e-3, threshold=jnp.ones(1)),
        )  # fmt: skip


@pytest.mark.slow
def test_single_precision():
    exact = ss.simulate(chain(), ss.Constant(0.0), t1=12.0, y0=CHAIN_START)
    with jax.enable_x64(False):
        method = ss.Regularized(1e-3, step=0.005)
        with pytest.warns(UserWarning, match="float32"):
            one = ss.simulate(chain(), ss.Constant(0.0), t1=12.0, y0=CHAIN_START, method=method)
        assert one.final_state[0].dtype == jnp.float32
        assert list(one.totals.sticks) == list(exact.totals.sticks)
        np.testing.assert_allclose(one.sticks.start[:5], exact.sticks.start[:5], atol=2e-2)
