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
