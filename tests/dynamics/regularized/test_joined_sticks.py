"""Sticks of friction with inner states: what bristles do while they bend is no slip."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss
from stickslip_jax._dynamics.regularized.sticks import (
    AtContact,
    Criterion,
    Cubic,
    SeenStep,
    detect_joined,
    start_joining,
)
from stickslip_jax._dynamics.sticks import ALL

THRESHOLD, BEND, SHORTEST, T1, STEPS = 0.01, 0.004, 0.1, 60.0, 6000


def motion(t, source):
    """Relative velocities of two contacts, slips with a ringing between them, and normal forces; all with slopes."""
    phase, ringing, fast = source.uniform(0, 2 * np.pi, 2), source.uniform(0, 2 * np.pi, 2), source.uniform(20, 30, 2)
    pace, opens = source.uniform(0.6, 1.2, 2), source.uniform(0.5, 1.2, 2)
    slow = np.full(2, 0.3)
    parts = [np.multiply.outer(t, rate) + shift for rate, shift in ((pace, phase), (fast, ringing), (slow, phase))]
    (slip, dslip), (ring, dring), (load, dload) = ((np.sin(part), np.cos(part)) for part in parts)
    velocity = slip**3 + 0.03 * ring * load**2
    slope = 3 * slip**2 * dslip * pace + 0.03 * (dring * fast * load**2 + 2 * ring * load * dload * 0.3)
    return velocity, slope, 1 + opens * load, opens * dload * 0.3


def spans_of(held, t):
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int))).reshape(-1, 2)
    return [(t[a], t[b - 1]) for a, b in edges]


def expected(source):
    """The sticks of both contacts and of all at once, on a fine grid."""
    t = np.linspace(0, T1, 600_001)
    velocity, _, normal, _ = motion(t, source)
    closed, path = normal > 0, np.cumsum(np.abs(velocity), axis=0) * t[1]
    held = (np.abs(velocity) <= THRESHOLD) & closed
    for i in range(2):
        spans = np.flatnonzero(np.diff(np.concatenate([[False], held[:, i], [False]]).astype(int))).reshape(-1, 2)
        for end, start in zip(spans[:-1, 1], spans[1:, 0], strict=True):
            if path[start, i] - path[end, i] < BEND and np.all(closed[end:start, i]):
                held[end:start, i] = True
        if len(spans) and path[-1, i] - path[spans[-1, 1] - 1, i] < BEND and np.all(closed[spans[-1, 1] - 1 :, i]):
            held[spans[-1, 1] - 1 :, i] = True
    of_all = np.all(held | ~closed, axis=1) & np.any(held, axis=1)
    found = [spans_of(of_track, t) for of_track in (held[:, 0], held[:, 1], of_all)]
    return [np.array([span for span in spans if span[1] - span[0] >= SHORTEST]) for spans in found]


@jax.jit
def detected(t, velocity, slope, normal, normal_slope):
    criterion, none = Criterion(THRESHOLD, SHORTEST), jnp.zeros(3)

    def seen(i):
        return AtContact(velocity[i], normal[i] > 0, jnp.full(2, BEND))

    def one(detector, i):
        j = jnp.minimum(i + 1, STEPS)
        forces = Cubic(normal[i], normal_slope[i], normal[j], normal_slope[j])
        relative = Cubic(velocity[i], slope[i], velocity[j], slope[j])
        step = SeenStep(t[i], t[j] - t[i], relative, Cubic(none, none, none, none), forces)
        last = j == STEPS
        return detect_joined(criterion, detector, step, jumped=jnp.zeros((), bool), after=seen(j), last=last)

    return jax.lax.scan(one, start_joining(criterion, seen(0), none, ALL), jnp.arange(STEPS + 1))[1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_contacts_and_all_at_once(seed):
    """Against the same rule on a fine grid."""
    t = np.linspace(0, T1, STEPS + 1)
    records = detected(t, *motion(t, np.random.default_rng(seed)))
    for track, spans in enumerate(expected(np.random.default_rng(seed))):
        is_stick = np.asarray(records.ending)[:, track] >= 0
        found = np.stack([np.asarray(records.start)[is_stick, track], np.asarray(records.end)[is_stick, track]], axis=1)
        assert len(spans) > 3
        np.testing.assert_allclose(found, spans, rtol=0, atol=2e-3)


def counted(stiffness, law, base, t1, **how):
    one = ss.simulate(ss.MassSpring(1.0, stiffness, 1.0, law), base, t1=t1, **how)
    assert one.status == ss.Status.FINISHED
    return int(one.sticks.count), float(one.stick_time)


@pytest.mark.slow
def test_ring_down_is_no_stick_of_its_own():
    """On a belt, as many sticks as with Coulomb friction, however little the bristles are damped."""
    belt = ss.Constant(0.1)
    assert counted(8.0, ss.Coulomb(0.3, 0.4), belt, 56.0)[0] == 25
    for damping in (100.0, 20.0, 5.0):
        law = ss.LuGre(0.3, 0.4, 0.01, stiffness=1e4, damping=damping)
        assert counted(8.0, law, belt, 56.0, method=ss.Regularized())[0] == 25


def by_radau(name, stiffness, damping, method):
    """The sticks of a mass on a spring on ``cos(0.4 t)``, by scipy and the rule, on a grid of 5e-5 s."""
    mu, t = 0.9, np.linspace(0, 25, 500_001)

    def rates(t, y):
        slip = y[1] - np.cos(0.4 * t)
        share = stiffness * y[2] * np.sign(slip) / mu
        if name == "BoucWen":
            bends = share**2 * (0.5 + 0.5 * np.sign(share))
        elif name == "ElastoPlastic":
            bends = share * 0.5 * (1 + np.sin(np.pi * np.clip((share - 0.85) / 0.3, -0.5, 0.5)))
        else:
            bends = share
        bent = slip * (1 - bends)
        return [y[1], -4 * y[0] - stiffness * y[2] - damping * bent, bent]

    run = solve_ivp(rates, (0, 25), (0.3, -0.2, 0.0), "Radau", rtol=1e-7, atol=[1e-9, 1e-9, 1e-12], t_eval=t)
    slip = np.abs(run.y[1] - np.cos(0.4 * t))
    held, path = slip <= float(method.threshold), np.cumsum(slip) * t[1]
    (ends,), (starts,) = np.nonzero(held[:-1] & ~held[1:]), np.nonzero(~held[:-1] & held[1:])
    for end in ends:
        later = starts[starts > end]
        if len(later) and path[later[0]] - path[end] < 2 * mu / stiffness:
            held[end : later[0] + 1] = True
    return np.array([span for span in spans_of(held, t) if span[1] - span[0] >= float(method.minimum_duration)])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LuGre", "ElastoPlastic", "Dahl", "BoucWen"])
def test_bristles_that_bend_over_cut_no_stick(name):
    """The spring pulls from one side to the other while the mass sticks; undamped bristles ring all the time.

    As many sticks as with Coulomb friction. They end while it still holds: a contact creeps before it breaks away.
    """
    system, base = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9)), ss.Harmonic(1.0, 0.4)
    number = int(ss.simulate(system, base, t1=25.0, y0=(0.3, -0.2)).sticks.count)
    for stiffness in (1e4, 1e5):
        for ratio in (0.1, 1.0) if name in ("LuGre", "ElastoPlastic") else (0.0,):
            damping, kind = 2 * ratio * stiffness**0.5, getattr(ss, name)
            law = kind(0.9, 0.9, 1.0, stiffness, damping) if ratio else kind(0.9, stiffness)
            one = ss.simulate(
                eqx.tree_at(lambda system: system.friction, system, law), base, t1=25.0, y0=(0.3, -0.2),
                method=ss.Regularized(),
            )  # fmt: skip
            found = np.stack([one.sticks.start, one.sticks.end], 1)[np.asarray(one.sticks.mask)]
            assert len(found) == number == 3
            np.testing.assert_allclose(found, by_radau(name, stiffness, damping, one.method), rtol=0, atol=1e-3)


@pytest.mark.slow
def test_contacts_of_structures_and_ensembles():
    """Two blocks that do not touch each other have the sticks of each alone; an ensemble those of single runs."""
    law, belt, how = ss.LuGre(0.3, 0.4, 0.01, 1e4, 20.0), ss.Constant(0.1), {"t1": 30.0, "method": ss.Regularized()}
    contacts = tuple(ss.Contact.of_mass(i, 2, 1.0, law) for i in range(2))
    both = ss.simulate(ss.LinearStructure(np.ones(2), np.diag([4.0, 8.0]), None, contacts), belt, **how)
    alone = [ss.simulate(ss.MassSpring(1.0, k, 1.0, law), belt, **how) for k in (4.0, 8.0)]
    for i, one in enumerate(alone):
        exact = ss.simulate(ss.MassSpring(1.0, (4.0, 8.0)[i], 1.0, ss.Coulomb(0.3, 0.4)), belt, t1=30.0)
        assert int(one.sticks.count) == int(both.of_contact(i).sticks.count) == int(exact.sticks.count)
    stiffness = jnp.array([4.0, 8.0])
    settings = {"samples": 2, "key": jax.random.key(0), "keep": "totals", "progress": False}
    many = ss.simulate_ensemble(ss.MassSpring(1.0, stiffness, 1.0, law), belt, **how, **settings)
    assert many.totals.sticks.tolist() == [int(one.sticks.count) for one in alone]
