"""Trajectories that begin at another time than zero, and contacts that begin at rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import ALL
from stickslip_jax._dynamics.switched.engine import SwitchedEngine
from stickslip_jax._excitation.excitation import excitation_of

T0 = 7.3
TIMES = np.linspace(T0, 20.0, 57)
BASES = {
    "harmonic": ss.Harmonic(0.8, 1.3),
    "square wave": ss.SquareWave(1.0, 1.0),
    "recorded": ss.Recorded(np.linspace(0, 20, 41), np.sin(np.linspace(0, 20, 41))),
    "jumps on a motion": ss.WithJumps(ss.Harmonic(0.3, 2.0), ss.SquareWave(0.5, 6.0)),
}


def continued(mu, base, y, t0=T0, resting=None, steps=512):
    """The states (times, 2) of a motion that begins in `y` at `t0`, and the motion."""
    system, excitation = ss.MassSpring(1.0, 4.0, 1.0, mu), excitation_of(base)
    dtype = jnp.result_type(float)
    engine = SwitchedEngine(system, excitation, 20.0, y, 0.3, steps, None, quantities=ALL)
    run = engine.run(*engine.follow(dtype, t0=jnp.asarray(t0, dtype), resting=resting))
    at = jax.vmap(lambda t: jnp.stack(run.path.state(t)))
    return at(jnp.asarray(TIMES, dtype)), run


@pytest.mark.slow
@pytest.mark.parametrize("name", BASES)
def test_a_motion_goes_on_from_any_time(name):
    base = BASES[name]
    whole = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7)), base, t1=20.0, y0=(0.3, 0.1))
    start = tuple(whole.evaluate(T0))
    states, done = jax.jit(lambda y: continued(ss.Coulomb(0.7), base, y))(start)
    np.testing.assert_allclose(states, np.stack(whole.evaluate(TIMES), axis=1), atol=1e-12)
    assert int(done.status) == ss.Status.FINISHED
    assert float(done.time_reached) == 20.0


@pytest.mark.slow
def test_contacts_begin_at_rest_where_they_are_told_to():
    """Static friction above kinetic holds a mass on the base; with a small relative velocity it would slip."""
    near = jnp.asarray(0.3), jnp.asarray(0.3 - 1e-3)
    run = jax.jit(lambda mu, speed, y, resting: continued(  # traced, as where numbers are searched
        ss.Coulomb(mu, mu_static=1.7), ss.Constant(speed), y, resting=resting))  # fmt: skip
    held, done = run(0.4, 0.3, near, jnp.asarray(True))
    slides, _ = run(0.4, 0.3, near, jnp.asarray(False))
    release = T0 + (1.7 / 4.0 - 0.3) / 0.3
    before = release > TIMES
    np.testing.assert_allclose(held[before, 0], 0.3 + 0.3 * (TIMES[before] - T0), atol=1e-12)
    np.testing.assert_allclose(float(done.sticks.end[0]), release, atol=1e-12)
    assert float(jnp.max(jnp.abs(held - slides))) > 0.1
    slope = jax.jacfwd(lambda v: run(0.4, 0.3, (near[0], v), jnp.asarray(True))[0])(near[1])
    assert not np.any(slope)
