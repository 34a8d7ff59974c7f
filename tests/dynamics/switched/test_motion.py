"""Energy, invariants, transformations and derivatives of the switched engine."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.event_driven import simulate_mass_spring

import stickslip_jax as ss
from stickslip_jax._dynamics.common.method import Arguments
from stickslip_jax._dynamics.engine_choice import engine_for
from stickslip_jax._systems.system import is_built_in

T1 = 30.0
STEPS = ss.Exact(step=0.3, max_steps=512)


def build(
    mu=0.4, mu_static=0.5, damping=0.3, stiffness=1.0, push=1.0, swing=1.0, frequency=1.0, phase=0.0, x=2.0, p=0.0
):
    """A forced, damped mass on a base that oscillates: system, base and start."""
    system = ss.MassSpring(
        1.0, stiffness, 1.0, ss.Coulomb(mu, mu_static), damping, ss.Harmonic(push, 0.7, 0.2, offset=0.1)
    )
    return system, ss.Harmonic(swing, frequency, phase, offset=0.7), (x, p)


SLOTS = 2


class Swing:
    """A base motion of a user's."""

    shortest_period = 9.0

    def velocity(self, t):
        return jnp.sin(0.7 * t)

    def acceleration(self, t):
        return 0.7 * jnp.cos(0.7 * t)


@jax.jit
def watched(values):
    """Starts, ends and positions of the first sticks, and the final state."""
    system, base, y0 = build(**values)
    one = ss.simulate(system, base, t1=T1, y0=y0, method=STEPS)
    sticks = one.sticks
    events = jnp.concatenate([sticks.start[:SLOTS], sticks.end[:SLOTS], sticks.position[:SLOTS]])
    return jnp.concatenate([events, jnp.stack(one.final_state)])


FORWARD, REVERSE = (jax.jit(jacobian(watched)) for jacobian in (jax.jacfwd, jax.jacrev))


def exact(values):
    """The same by the reference."""
    system, base, y0 = build(**values)
    force, friction = system.force, system.friction
    run = simulate_mass_spring(
        mass=1.0, stiffness=system.stiffness, damping=system.damping, normal_force=1.0,
        mu_static=friction.mu_static, mu_kinetic=friction.mu,
        base_velocity=lambda t, _: base.offset + base.amplitude * np.cos(base.angular_frequency * t + base.phase),
        base_acceleration=lambda t, _: (
            -base.amplitude * base.angular_frequency * np.sin(base.angular_frequency * t + base.phase)
        ),
        force=lambda t, _: force.offset + force.amplitude * np.cos(0.7 * t + 0.2),
        t1=T1, y0=y0, max_step=0.2,
    )  # fmt: skip
    rows = np.array([stick[:3] for stick in run.sticks[:SLOTS]])
    return np.concatenate([rows.T.ravel(), run.final_state])


POINT = dict.fromkeys(("stiffness", "push", "swing", "frequency"), 1.0) | {
    "mu": 0.4, "mu_static": 0.5, "damping": 0.3, "phase": 0.0, "x": 2.0, "p": 0.0,
}  # fmt: skip


def as_arrays(values):
    return {name: jnp.asarray(value) for name, value in values.items()}


@pytest.mark.slow
def test_derivatives_against_the_reference():
    """Of event times, positions and the final state by fourth-order differences (error 1e-7)."""
    point = as_arrays(POINT)
    np.testing.assert_allclose(watched(point), exact(POINT), rtol=1e-10, atol=1e-10)
    forward = FORWARD(point)
    step = 1e-4
    for name in POINT:

        def moved(times, name=name):
            return exact(POINT | {name: POINT[name] + times * step})

        difference = (8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / (12 * step)
        np.testing.assert_allclose(forward[name], difference, rtol=5e-6, atol=5e-6, err_msg=name)


@pytest.mark.slow
def test_reverse_derivatives_are_the_forward_ones():
    point = as_arrays(POINT)
    forward, reverse = FORWARD(point), REVERSE(point)
    for name in POINT:
        np.testing.assert_allclose(reverse[name], forward[name], rtol=1e-9, atol=1e-10, err_msg=name)


@pytest.mark.slow
def test_jit_vmap_and_float32():
    starts = jnp.linspace(-2, 2, 5)
    point = as_arrays(POINT)
    batch = jax.vmap(lambda x: watched(point | {"x": x}))(starts)
    np.testing.assert_allclose(batch[4], watched(as_arrays(POINT | {"x": 2.0})), rtol=1e-12)
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        single = watched({name: jnp.float32(value) for name, value in POINT.items()})
    assert single.dtype == jnp.float32
    # 100 steps, each with a few units in the last place of t = 30: 100 * 30 * 6e-8.
    np.testing.assert_allclose(single, watched(point), atol=2e-4)


@pytest.mark.slow
def test_gradients_are_finite_where_nothing_sticks():
    """Of the final velocity, by every parameter."""
    slopes = REVERSE(as_arrays(POINT | {"mu": 0.01, "mu_static": 0.01, "p": 50.0}))
    assert all(np.isfinite(slope[-1]) for slope in slopes.values())


def energy_error(system, base, y0, **method):
    """Energy gained less the work of force, damper and friction, by quadrature over the steps; and the work done."""
    one = ss.simulate(system, base, t1=T1, y0=y0, method=ss.Exact(**method))
    knots = np.unique(np.concatenate([np.asarray(one.step_starts), [T1]]))
    nodes, weights = np.polynomial.legendre.leggauss(10)
    times = knots[:-1, None] + np.diff(knots)[:, None] * (nodes + 1) / 2
    x, p = (np.asarray(values) for values in one.evaluate(times))
    v = np.asarray(one.base_velocity(times))
    a = np.asarray(jax.vmap(base.rate)(jnp.asarray(times.ravel()))).reshape(times.shape)
    push = np.asarray(jax.vmap(system.force.value)(jnp.asarray(times.ravel()))).reshape(times.shape)
    starts, ends = (np.asarray(values)[np.asarray(one.sticks.mask)] for values in (one.sticks.start, one.sticks.end))
    middle = (knots[:-1] + knots[1:]) / 2
    stuck = (np.searchsorted(starts, middle) > np.searchsorted(ends, middle))[:, None]
    slip = -np.sign(p - v) * np.asarray(system.friction.kinetic(jnp.abs(jnp.asarray(p - v))))
    rub = np.where(stuck, a + system.damping * v + system.stiffness * x - push, slip)
    power = (push - system.damping * p + rub) * p
    work, spent = (
        np.sum(values * weights / 2 * np.diff(knots)[:, None]) for values in (power, np.abs(push * p) + np.abs(rub * p))
    )

    def stored(state):
        return 0.5 * system.stiffness * float(state[0]) ** 2 + 0.5 * float(state[1]) ** 2

    return abs(stored(one.final_state) - stored(y0) - work) / spent


@pytest.mark.slow
def test_energy_closes_to_round_off():
    """Closed-form flow: what remains is round-off of 100 steps, a few hundred units in the last place."""
    system, base, y0 = build()
    assert energy_error(system, base, y0) < 1e-13


@pytest.mark.slow
def test_energy_closes_to_the_order_of_the_flow():
    system, base, y0 = build()
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(0.5, 1.0), system.damping, system.force)
    coarse, fine = (energy_error(system, base, y0, step=h, solver=diffrax.Bosh3()) for h in (0.1, 0.05))
    assert energy_error(system, base, y0) < 1e-9
    assert fine < coarse / 2**2.5


coefficients = st.floats(0.05, 2.0)


@pytest.mark.slow
@settings(max_examples=40)
@given(
    mu=coefficients, extra=st.floats(0, 1), damping=st.floats(0.01, 3), push=st.floats(0, 3), swing=st.floats(0, 3),
    frequency=st.floats(0.2, 3), phase=st.floats(0, 6), x=st.floats(-5, 5), p=st.floats(-3, 3),
)  # fmt: skip
def test_invariants(mu, extra, damping, push, swing, frequency, phase, x, p):
    """Sticks are in order and apart, on the base and within the band; slips are off the base; the end is the end."""
    values = {"mu": mu, "mu_static": mu * (1 + extra), "damping": damping, "push": push, "swing": swing}
    values |= {"frequency": frequency, "phase": phase, "x": x, "p": p, "stiffness": 1.0}
    start, end, mask, at_start, at_middle, at_end, needed, off, status, final, last = followed(values)
    mask = np.asarray(mask)
    times = np.stack([start, end], axis=1)[mask].ravel()
    assert int(status) == ss.Status.FINISHED
    assert np.all(np.diff(times) >= 0)
    assert np.all((times >= 0) & (times <= T1))
    size = 5 + abs(x) + abs(p) + 10 * (push + swing + mu)
    for relative in (at_start, at_middle, at_end):
        assert np.all(np.abs(relative[mask]) < 1e-10 * size)
    assert np.all(np.abs(needed[:, mask]) <= mu * (1 + extra) + 1e-9 * size)
    assert np.all(off > 0)
    np.testing.assert_allclose(final, last, rtol=1e-12, atol=1e-12 * size)


@jax.jit
def followed(values):
    system, base, y0 = build(**values)
    one = ss.simulate(system, base, t1=T1, y0=y0, method=ss.Exact(step=0.1, max_steps=2048))
    start, end = (jnp.where(one.sticks.mask, times, 0) for times in (one.sticks.start, one.sticks.end))

    def relative(times):
        return one.evaluate(times)[1] - one.base_velocity(times)

    def needed(times):
        x, _ = one.evaluate(times)
        v = one.base_velocity(times)
        return (
            jax.vmap(base.rate)(times) + system.damping * v + system.stiffness * x - jax.vmap(system.force.value)(times)
        )

    begun = one.step_starts
    middle = (begun + jnp.append(begun[1:], T1)) / 2
    within = (middle[:, None] >= start[None]) & (middle[:, None] <= end[None])
    inside = jnp.any(within & one.sticks.mask[None], axis=1)
    lasting = jnp.append(begun[1:], T1) - begun > 1e-6
    off = jnp.where(~inside & lasting, jnp.abs(relative(middle)), 1.0)
    spread = jnp.stack([needed(start + share * (end - start)) for share in (0.001, 0.3, 0.7, 0.999)])
    return (
        start, end, one.sticks.mask, relative(start), relative((start + end) / 2), relative(end), spread, off,
        one.status, jnp.stack(one.final_state), jnp.stack(one.evaluate(T1)),
    )  # fmt: skip


@pytest.mark.slow
def test_mirror_image():
    """x, v and F turned round: the same events."""
    system, base, y0 = build()
    mirrored = ss.MassSpring(1.0, 1.0, 1.0, system.friction, system.damping, ss.Harmonic(-1.0, 0.7, 0.2, offset=-0.1))
    one = ss.simulate(system, base, t1=T1, y0=y0, method=STEPS)
    other = ss.simulate(mirrored, ss.Harmonic(-1.0, 1.0, offset=-0.7), t1=T1, y0=(-y0[0], -y0[1]), method=STEPS)
    assert int(one.sticks.count) == 2
    np.testing.assert_allclose(other.sticks.start, one.sticks.start, rtol=1e-13)
    np.testing.assert_allclose(other.sticks.position, -one.sticks.position, rtol=1e-11)


@pytest.mark.slow
def test_ensemble_samples_are_simulations():
    """Random phases and jumps together: each sample of an ensemble is the simulation of its own realisation."""
    law = ss.WithJumps(ss.RandomPhase(ss.Harmonic(0.5, 1.3)), ss.PoissonSwitching(0.4, 0.5))
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3, 0.4), 0.1)
    many = ss.simulate_ensemble(
        system, law, t1=T1, samples=20, key=jax.random.key(4), y0=(ss.Uniform(-1.0, 1.0), 0.0), keep="sticks"
    )
    for number in (0, 7, 19):
        _, base, y0 = many.realization(number)
        one = ss.simulate(system, base, t1=T1, y0=y0)
        count = int(one.sticks.count)
        assert count == many.flat_sticks.count[number]
        assert int(one.slips.count) == many.totals.slips[number]
        np.testing.assert_allclose(many.sticks.start[number, :count], one.sticks.start[:count], rtol=1e-10)


@pytest.mark.slow
def test_streamed_accelerograms_equal_sampled_ones():
    system = ss.MassSpring(1.0, 20.0, 9.81, ss.Coulomb(0.05), 0.2)
    many = ss.simulate_ensemble(system, ss.KanaiTajimi(1.5), t1=20.0, samples=4, key=jax.random.key(5), keep="sticks")
    _, base, y0 = many.realization(2)
    one = ss.simulate(system, base, t1=20.0, y0=y0)
    count = int(one.sticks.count)
    assert count == many.flat_sticks.count[2] > 5
    np.testing.assert_allclose(many.sticks.start[2, :count], one.sticks.start[:count], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("max_steps", [None, 256])
def test_room_for_a_stick_in_every_interval(max_steps):
    """Each jump of the base ends a stick and the next begins before the next jump: none is dropped."""
    base = ss.PiecewiseConstant(0.05 * np.arange(80), np.resize([0.0, 0.01], 80))
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.0), damping=0.01)
    one = ss.simulate(system, base, t1=4.0, method=ss.Exact(max_steps=max_steps))
    assert int(one.status) == ss.Status.FINISHED
    assert int(one.totals.sticks) == int(one.sticks.count) == 80
    assert np.all(one.sticks.end[:80] == pytest.approx(0.05 * np.arange(1, 81), rel=1e-12))


def test_only_the_packages_own_functions_are_compiled_for_wide_vectors():
    """See the next test for what these do to functions of a user's."""

    def engine(friction, base):
        system = ss.MassSpring(1.0, 1.0, 1.0, friction)
        return engine_for(Arguments(system, base, ss.Exact(step=0.1), T1)).lanes((0.0, 0.0), np.dtype(float))

    law, base = ss.Coulomb(0.4), ss.Harmonic(1.0, 0.7)
    for friction in (law, ss.VelocityWeakening(0.5, 1.0), ss.Stribeck(0.3, 0.5, 0.1)):
        assert is_built_in(engine(friction, base))
    for friction, motion in ((ss.FrictionCurve(lambda speed: 0.5 + 0 * speed), base), (law, Swing())):
        assert not is_built_in(engine(friction, motion))
    for spectrum in (lambda w: jnp.exp(-w), ss.VelocitySpectrum(lambda w: w**2 * jnp.exp(-w))):
        assert not is_built_in(engine(law, ss.GaussianProcess(spectrum, cutoff=3.0, harmonics=4)))
    layer = ss.KanaiTajimiSpectrum(ground_frequency=1.0)
    assert is_built_in(engine(law, ss.GaussianProcess(layer, cutoff=3.0, harmonics=4)))


@pytest.mark.slow
def test_a_users_functions_are_compiled_as_written():
    """In 512-bit vectors jaxlib 0.10.2 computes arctan wrong, and ensembles ask for such vectors where they can."""
    friction = ss.FrictionCurve(lambda speed: 0.5 - 0.2 * jnp.arctan(2 * speed))
    system, base = ss.MassSpring(1.0, 1.0, 1.0, friction), ss.Harmonic(1.0, 0.7)
    starts = (ss.Uniform(-1.0, 1.0), 0.0)
    many = ss.simulate_ensemble(system, base, t1=T1, samples=32, key=jax.random.key(6), y0=starts, keep="sticks")
    assert many.finished == 32
    for number in range(3):
        _, base, y0 = many.realization(number)
        one = ss.simulate(system, base, t1=T1, y0=y0)
        count = int(one.sticks.count)
        assert count == many.flat_sticks.count[number] > 0
        np.testing.assert_allclose(many.sticks.end[number, :count], one.sticks.end[:count], rtol=1e-9)


@pytest.mark.slow
def test_a_users_spectrum_is_compiled_as_written():
    """The harmonics are drawn where an ensemble simulates: they were those of a wrong arctan."""
    law = ss.GaussianProcess(
        lambda w: jnp.exp(-(w**2) / 4) * (1.6 + jnp.arctan(3 * (w - 1.5))), cutoff=6.0, harmonics=16
    )
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.6))
    many = ss.simulate_ensemble(system, law, t1=10.0, samples=16, key=jax.random.key(0), keep="sticks")
    for number in range(4):
        _, base, y0 = many.realization(number)
        one = ss.simulate(system, base, t1=10.0, y0=y0)
        assert float(many.totals.stick_time[number]) == pytest.approx(float(one.stick_time), abs=1e-9)
