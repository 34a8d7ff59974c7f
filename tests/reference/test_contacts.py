"""Self-checks of the reference for several contacts: known cases, balances, conditions, and other ways there."""

import math

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.optimize import lsq_linear
from support.structures import random_structure, reference_motion

from .contact_arcs import HORIZON, OPEN, STUCK, Motion, Structure
from .contacts import OPENED, RELEASED, _settle_block, follow
from .event_driven import simulate_mass_spring


def steady(values):
    """Normal forces that do not vary."""
    return lambda t, _: np.multiply.outer(np.asarray(values, float), 1.0 + 0.0 * t)


def numbers(run: Motion) -> np.ndarray:
    assert run.position is not None
    assert run.velocity is not None
    return np.concatenate([*[stick[1:5] for stick in run.sticks], run.position, run.velocity])


def names(run: Motion):
    return [(stick.contact, stick.ending) for stick in run.sticks]


def test_three_coupled_clutches():
    """The example of Modelica's Rotational library."""

    def normal(t, piece):
        return np.array([20 * np.cos(0.4 * np.pi * t), 20.0 * (piece >= 1) + 0 * t, 20.0 * (piece >= 2) + 0 * t])

    between = np.array([[1.0, -1, 0, 0], [0, 1, -1, 0], [0, 0, 1, -1]])
    torque = lambda t, _: np.array([10 * np.sin(10 * np.pi * t), 0 * t, 0 * t, 0 * t])  # noqa: E731
    zero, limits = np.zeros((4, 4)), (np.full(3, 0.5), np.full(3, 0.55))
    clutches = Structure(
        np.eye(4),
        zero,
        zero,
        between,
        np.zeros(3),
        *limits,
        normal,
        force=torque,
        breaks=(0.4, 0.9),
        fastest=10 * np.pi,
    )
    run = follow(clutches, 1.5, np.zeros(4), [10.0, 0.0, 0.0, 0.0])
    assert names(run) == [(1, HORIZON), (0, RELEASED), (0, RELEASED), (2, HORIZON)]
    instants = [(0.709621474694, 1.5), (0.791662359155, 0.831108506138), (0.906850192798, 1.000295859895)]
    instants.append((1.143967492473, 1.5))
    assert np.array([stick[1:3] for stick in run.sticks]) == pytest.approx(np.array(instants), abs=1e-12)
    assert run.position is not None
    assert run.velocity is not None
    assert run.position[0] == pytest.approx(7.486119099, abs=5e-10)
    assert run.velocity[0] == pytest.approx(3.247058272, abs=6e-10)
    assert -between @ run.position == pytest.approx([-3.37898168, -1.39667298, -1.53672056], abs=6e-9)
    assert -between @ run.velocity == pytest.approx([-0.783871106, 0, 0], abs=5e-10)
    assert run.margin > 1e-5


BLOCKS = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])


def test_three_blocks_on_the_floor():
    floor, mu = np.eye(3), np.full(3, 0.3)
    blocks = Structure(np.eye(3), BLOCKS / 10, BLOCKS, floor, np.zeros(3), mu, mu, steady([1, 1, 1]))
    run = follow(blocks, 12.0, [-1, 1, -1], [-1, 1, 1])
    assert names(run) == [(0, RELEASED), (2, RELEASED), (1, HORIZON), (0, HORIZON), (2, HORIZON)]
    instants = [(4.63544896516, 4.82994374361), (4.96043120202, 5.08551319834), (6.78298795467, 12)]
    instants += [(7.34343581525, 12), (8.37062952656, 12)]
    assert np.array([stick[1:3] for stick in run.sticks]) == pytest.approx(np.array(instants), abs=6e-12)
    assert run.position == pytest.approx([0.202558662099, 0.412765621355, 0.531438212051], abs=1.2e-12)
    assert run.velocity == pytest.approx(0.0, abs=1e-14)


def test_one_contact_against_the_reference_for_one():
    """Two masses without a spring between them: each is an oscillator of its own, on a moving base, with forces."""
    common = {"mass": 1.0, "stiffness": 1.0, "normal_force": 1.0, "t1": 30.0}
    moving = {"base_velocity": lambda t, _: math.cos(t) + 0.7, "base_acceleration": lambda t, _: -math.sin(t)}
    forces = [lambda t, _: math.cos(0.7 * t), lambda t, _: 0.6 * math.sin(1.3 * t)]
    ones = [
        {"force": forces[0], "damping": 0.4, "mu_static": 0.4, "mu_kinetic": 0.4, "y0": (3.0, 0.0)},
        {
            "force": forces[1],
            "damping": 0.1,
            "mu_static": 0.6,
            "mu_kinetic": lambda s: 0.5 / (1 + s),
            "y0": (-1.0, 1.7),
        },
    ]
    structure = Structure(
        np.eye(2),
        np.diag([0.4, 0.1]),
        np.eye(2),
        np.eye(2),
        np.ones(2),
        lambda speed: np.stack([0.4 + 0 * speed[0], 0.5 / (1 + speed[1])]),
        np.array([0.4, 0.6]),
        steady([1, 1]),
        lambda t, _: np.cos(t) + 0.7,
        lambda t, _: -np.sin(t),
        lambda t, _: np.array([np.cos(0.7 * t), 0.6 * np.sin(1.3 * t)]),
        fastest=1.3,
    )
    run = follow(structure, 30.0, [3.0, -1.0], [0.0, 1.7])
    assert run.position is not None
    assert run.velocity is not None
    for i, one in enumerate(ones):
        alone = simulate_mass_spring(**common, **moving, **one)
        mine = [stick for stick in run.sticks if stick.contact == i]
        assert len(mine) >= 2
        assert [stick.ending for stick in mine] == [stick.ending for stick in alone.sticks]
        assert np.array([stick[1:4] for stick in mine]) == pytest.approx(
            np.array([stick[:3] for stick in alone.sticks]), abs=1e-10
        )
        assert [t for j, t in run.crossings if j == i] == pytest.approx(alone.crossings, abs=1e-10)
        assert [run.position[i], run.velocity[i]] == pytest.approx(alone.final_state, abs=1e-10)


def seeded(seed: int):
    return random_structure(np.random.default_rng(seed), 2 + seed % 9, coupled=seed % 2 == 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 112))
def test_energy_and_conditions(seed):
    """What comes in and what is lost make up the change of energy; friction obeys its law all the time."""
    setup = seeded(seed)
    run, nodes, weights = reference_motion(setup), *leggauss(12)
    d, work = len(setup["mass"]), 0.0
    for start, stop, dense, _, arc in run.stretches:
        times = (start + stop) / 2 + (stop - start) / 2 * nodes
        states = dense(times)
        relative, friction, normal, rates = arc.all(times, states)
        v = states[d : 2 * d]
        power = np.sum(friction * (setup["directions"] @ v), axis=0) - np.sum(v * (setup["damping"] @ v), axis=0)
        if arc.structure.force is not None:
            power += np.sum(v * arc.structure.force(times, arc.piece), axis=0)
        work += (stop - start) / 2 * weights @ power
        stuck, is_open = arc.sides == STUCK, arc.sides == OPEN
        kinetic, static = (setup[name][:, None] * normal for name in ("kinetic", "static"))
        assert np.all(np.abs(relative[stuck]) < 1e-10)
        assert np.all(np.abs(friction[stuck]) <= static[stuck] + 1e-10)
        assert np.all((arc.side[:, None] * relative)[arc.slipping] >= -1e-10)
        assert friction[arc.slipping] == pytest.approx((-arc.side[:, None] * kinetic)[arc.slipping], abs=1e-12)
        assert not np.any(friction[is_open])
        assert np.all(normal[is_open] <= 1e-10)
        assert np.all(normal[~is_open] >= -1e-10)
        balance = setup["mass"] @ rates + setup["damping"] @ v + setup["stiffness"] @ states[:d]
        balance -= setup["directions"].T @ friction
        balance -= 0.0 if arc.structure.force is None else arc.structure.force(times, arc.piece)
        assert balance == pytest.approx(0.0, abs=1e-10)
    assert run.position is not None
    assert run.velocity is not None
    energies = [
        v @ setup["mass"] @ v / 2 + x @ setup["stiffness"] @ x / 2
        for x, v in ((setup["x0"], setup["v0"]), (run.position, run.velocity))
    ]
    assert energies[1] - energies[0] == pytest.approx(work, abs=1e-8)
    assert run.events > 0


@pytest.mark.slow_but_for("103")
@pytest.mark.parametrize("seed", [103, 104])
def test_other_steps_and_tolerances_change_nothing(seed):
    setup = seeded(seed)
    run, other = reference_motion(setup), reference_motion(setup, rtol=2e-13, max_step=0.061)
    assert names(run) == names(other)
    assert len(run.sticks) >= 2
    assert numbers(run) == pytest.approx(numbers(other), abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_contacts_at_rest_are_the_one_solution_of_the_bounded_problem(seed):
    """Without a difference between static and kinetic friction: minimize ``u G u / 2 + rates u`` within the limits."""
    rng = np.random.default_rng(seed)
    n = 2 + seed % 4
    root = rng.normal(size=(n, n))
    delassus, rates = root @ root.T + 0.1 * np.eye(n), 3 * rng.normal(size=n)
    limits = rng.uniform(0.2, 2, n)
    upper = np.linalg.cholesky(delassus).T
    best = lsq_linear(upper, -np.linalg.solve(upper.T, rates), (-limits, limits), tol=1e-14).x
    run = Motion()
    sides = _settle_block(run, delassus, rates, {}, limits, limits)
    assert min(run.margins["holding"], run.margins["case"]) > 1e-6
    expected = np.where(limits - np.abs(best) > 1e-6, STUCK, -np.sign(best))
    assert sides.tolist() == expected.tolist()


def test_of_two_that_need_too_much_the_one_in_greater_need_breaks_first():
    """A block on a block on the floor, pushed: the lower contact breaks, and slides so slowly that the upper holds."""
    across = np.array([[1.0, 0.0], [-1.0, 1.0]])  # of the lower block on the floor, of the upper one on it
    delassus, rates = across @ across.T, across @ np.array([1.0, 2.0])
    static = np.array([2.0, 1.9])  # they need 3 and 2
    lower = 1.0  # then both blocks go on at 1 together: the upper one needs 1
    assert _settle_block(Motion(), delassus, rates, {}, np.array([lower, 0.9]), static).tolist() == [1, STUCK]
    # With little static friction above, that contact breaks first, and the lower one holds against 1 + 0.5.
    assert _settle_block(Motion(), delassus, rates, {}, np.array([1, 0.5]), np.array([2.0, 0.6])).tolist() == [STUCK, 1]


def test_normal_force_that_comes_and_goes():
    """A free mass on a belt at speed 1: ``N = sin t``, so it speeds up by ``mu (1 - cos t)`` while `N` is positive."""
    one, zero = np.eye(1), np.zeros((1, 1))
    belt = Structure(
        one, zero, zero, one, np.ones(1), np.array([0.3]), np.array([0.4]), lambda t, _: np.array([np.sin(t)])
    )
    belt = Structure(**{**vars(belt), "base_velocity": lambda t, _: 1.0 + 0.0 * t, "fastest": 1.0})
    run = follow(belt, 8.5, [0.0], [0.0])
    start = 2 * math.pi + math.acos(1 - 0.4 / 0.3)
    assert names(run) == [(0, HORIZON)]
    assert run.sticks[0].start == pytest.approx(start, abs=1e-12)
    path = 0.3 * math.pi + 0.6 * math.pi + 0.9 * (start - 2 * math.pi) - 0.3 * math.sin(start)
    assert run.sticks[0].position == pytest.approx(path, abs=1e-11)
    assert run.sticks[0].displacement == pytest.approx(path - start, abs=1e-11)
    # At rest on it from the start, the mass stays, and each opening ends a stick: `N` and the need are zero together.
    run = follow(belt, 8.5, [0.0], [1.0])
    assert names(run) == [(0, OPENED), (0, HORIZON)]
    assert [stick.start for stick in run.sticks] == pytest.approx([0, 2 * math.pi], abs=1e-11)
    assert run.sticks[0].end == pytest.approx(math.pi, abs=1e-11)


def test_set_ups_are_reproducible():
    one, other = (random_structure(np.random.default_rng(5), 4) for _ in range(2))
    assert str(one) == str(other)
    for contacts in range(2, 11):
        for coupled in (False, True):
            setup = random_structure(np.random.default_rng(contacts), contacts, coupled=coupled)
            across = setup["directions"]
            delassus = across @ np.linalg.solve(setup["mass"], across.T)
            assert np.allclose(delassus, np.diag(np.diag(delassus))) is not coupled
            assert np.linalg.eigvalsh(delassus)[0] > 1e-3
            assert np.all(setup["static"] >= setup["kinetic"])
