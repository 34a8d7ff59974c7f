"""Events of friction that coincide exactly with those of the base, in time steps, against 60 digits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf
from reference.event_by_event import trace_reference

import stickslip_jax as ss

LANES, SLOTS, TURN = 200, 10, 6


@jax.jit
@jax.vmap
def followed(mu, x, p, durations, velocities, t1):
    system, base = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu)), ss.VelocitySteps(durations, velocities)
    one = ss.simulate(system, base, t1=t1, y0=(x, p), method=ss.Exact(step=0.1, max_steps=4096))
    return one.status, one.sticks.start, one.sticks.end, one.sticks.mask, one.near_grazing_count


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_all_on_one_lattice(seed):
    """The lattice of `interval/test_lattice.py`; of the lanes in which round-off decides, nearly all are right too."""
    source = np.random.default_rng(seed)
    mu, many = source.choice([0.25, 0.5, 1.0], LANES), (LANES, SLOTS)
    x, p = source.integers(-4, 5, LANES) / 2 * mu, source.integers(-2, 3, LANES) / 2
    twelfths, velocities = source.integers(1, 13, many), source.integers(-2, 3, many) / 2
    t1, durations = twelfths.sum(1), twelfths * np.pi / TURN
    durations[:, -1] += 1.0  # the base must reach the end
    status, start, end, mask, near = map(np.asarray, followed(mu, x, p, durations, velocities, t1 * np.pi / TURN))
    assert np.all(status == ss.Status.FINISHED)
    assert np.min(end - start, where=mask, initial=1) > 1e-6
    wrong = 0
    for lane in range(LANES):
        with mp.workdps(60):
            segments = trace_reference(
                mass=1, stiffness=1, normal_force=1, mu=mpf(mu[lane]),
                durations=[int(number) * mp.pi / TURN for number in twelfths[lane]],
                velocities=[mpf(v) for v in velocities[lane]], t1=int(t1[lane]) * mp.pi / TURN,
                position0=mpf(x[lane]), velocity0=mpf(p[lane]), digits=45,
            )  # fmt: skip
            exact = [(one.start, one.end) for one in segments if one.side == 0 and one.end - one.start > 1e-30]
        found, exact = np.stack([start[lane], end[lane]], 1)[mask[lane]], np.array(exact, float).reshape(-1, 2)
        if found.shape != exact.shape or not np.allclose(found, exact, rtol=0, atol=1e-6):
            assert near[lane] > 0, lane
            wrong += 1
    assert wrong <= 2


@jax.jit
@jax.vmap
def loaded(mu, x, p, durations, velocities, loads, t1):
    times = jnp.concatenate([jnp.zeros(1), jnp.cumsum(durations)[:-1]])
    system = ss.MassSpring(1.0, 1.0, ss.ForceSteps(times, loads), ss.Coulomb(mu))
    base, method = ss.VelocitySteps(durations, velocities), ss.Exact(step=0.1, max_steps=4096)
    one = ss.simulate(system, base, t1=t1, y0=(x, p), method=method)
    return one.status, one.sticks.start, one.sticks.end, one.sticks.mask, one.near_grazing_count


def exact_under_loads(mu, x, p, twelfths, velocities, loads):
    """Start and end of each stick, (sticks, 2), s, slot by slot.

    A stick goes on over an instant at which only the normal force changes, if it holds on both sides of it.
    """
    sticks, now, last = [], mpf(0), None
    x, p = mpf(x), mpf(p)
    for number, velocity, load in zip(twelfths, velocities, loads, strict=True):
        duration = int(number) * mp.pi / TURN
        traced = trace_reference(
            mass=1, stiffness=1, normal_force=mpf(load), mu=mpf(mu), durations=[duration], velocities=[mpf(velocity)],
            t1=duration, position0=x, velocity0=p, digits=45,
        )  # fmt: skip
        for one in traced:
            if one.side or load == 0 or one.end - one.start < 1e-30:
                last = None
                continue
            if last == velocity and one.start == 0:
                sticks[-1] = sticks[-1][0], now + one.end
            else:
                sticks.append((now + one.start, now + one.end))
            last = velocity
        now, x, p = now + duration, traced[-1].end_position, traced[-1].end_velocity
    return np.array(sticks, float).reshape(-1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_steps_of_the_normal_force_on_one_lattice(lanes):
    """The contact opens, closes, presses more or less where the base jumps, where the mass arrives or is released."""
    source = np.random.default_rng(3)
    mu, many = source.choice([0.25, 0.5, 1.0], lanes), (lanes, SLOTS)
    x, p = source.integers(-4, 5, lanes) / 2 * mu, source.integers(-2, 3, lanes) / 2
    twelfths, velocities = source.integers(1, 13, many), source.integers(-2, 3, many) / 2
    velocities[:, 1::2] = velocities[:, ::2]  # at half of the instants only the normal force changes
    loads, t1, durations = source.choice([0.0, 1.0, 2.0], many), twelfths.sum(1), twelfths * np.pi / TURN
    durations[:, -1] += 1.0
    status, start, end, mask, near = map(np.asarray, loaded(mu, x, p, durations, velocities, loads, t1 * np.pi / TURN))
    assert np.all(status == ss.Status.FINISHED)
    wrong = []
    for lane in range(lanes):
        with mp.workdps(60):
            exact = exact_under_loads(mu[lane], x[lane], p[lane], twelfths[lane], velocities[lane], loads[lane])
        found = np.stack([start[lane], end[lane]], 1)[mask[lane]]
        if found.shape != exact.shape or not np.allclose(found, exact, rtol=0, atol=1e-6):
            wrong.append((lane, int(near[lane]), found.tolist(), exact.tolist()))
    assert not [one for one in wrong if one[1] == 0]
    assert len(wrong) <= lanes // 100
    assert mask.sum() > lanes


@pytest.mark.slow
def test_a_base_that_comes_to_rest_as_the_mass_does():
    """Between kinetic and static friction the mass sticks, or if the base rests an instant later slips on: it is told.

    Half a turn about 1/4 m leads from rest to rest, where the spring pulls with `load` (N).
    """

    @jax.jit
    @jax.vmap
    def near(late, load):
        base = ss.VelocitySteps(jnp.stack([np.pi / 2 + late, jnp.full_like(late, 9.0)]), jnp.asarray([1.0, 0.0]))
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0, 1.3))
        one = ss.simulate(system, base, t1=4.0, y0=(0.5 - load / 4, 0.0), method=ss.Exact(max_steps=1024))
        return one.near_grazing_count

    late = jnp.asarray([0.0, 1e-15, -1e-15, 1e-3, -1e-3, 0.0, 0.0])
    load = jnp.asarray([1.24, 1.24, 1.24, 1.24, 1.24, 1.1, 1.29])
    assert near(late, load).tolist() == [1, 1, 1, 0, 0, 1, 1]
