"""Contacts behind springs: against exact modes from event to event, closed forms, and the rules of Masing and Iwan."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from tests.support.elastic_reference import ByModes, SetUp

KINDS = {
    # masses, elastic contacts, rigid ones, damped, varying normal forces, static above kinetic friction
    "one": (1, 1, 0, False, False, False),
    "mixed": (3, 4, 1, True, False, True),
    "twenty": (2, 20, 0, False, False, False),
    "opening": (2, 3, 0, True, True, False),
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
        base, rng.uniform(0.5, 2.5),
    )  # fmt: skip
    return of, np.append(rng.uniform(-2, 2, masses), rng.uniform(-1, 1, masses))


def as_structure(of):
    contacts = []
    for i, direction in enumerate(of.directions):
        force = of.normal[0][i]
        if of.normal[1][i]:
            force = ss.Harmonic(of.normal[1][i], of.w, -np.pi / 2, force)
        law = ss.Coulomb(of.kinetic[i], None if np.all(of.static == of.kinetic) else of.static[i])
        contacts.append(ss.Contact(direction, force, law, 1.0, of.springs[i] if of.springs[i] else None))
    damping = np.diag(of.damping) if np.any(of.damping) else None
    base = ss.Harmonic(of.base[1], of.w, 0.0, of.base[0])
    return ss.LinearStructure(of.mass, of.stiffness, damping, contacts), base


def compare(kind, seed, t1=15.0):
    of, y0 = random_set_up(kind, seed)
    structure, base = as_structure(of)
    one, expected = ss.simulate(structure, base, t1=t1, y0=tuple(y0)), ByModes(of, y0).run(t1)
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
        assert len(mine) == len(theirs), (kind, seed, i, mine, theirs)
        np.testing.assert_allclose(mine, np.array(theirs).reshape(-1, 2), rtol=0, atol=1e-9)
    return len(sticks)


@pytest.mark.parametrize("kind", KINDS)
def test_random_set_ups(kind):
    assert sum(compare(kind, seed) for seed in range(3)) > 10
