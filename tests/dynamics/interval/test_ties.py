"""Events that round-off decides about are counted in closed form, against exact rational arithmetic; others are not."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

T1 = 101.3  # long enough for every crossing, and on no lattice
MANY, SLOTS = 600, 24  # of every call: compiled once for each precision
BOTH = pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])


@jax.jit
@jax.vmap
def followed(mu, x, p, durations, velocities):
    """Mass and stiffness 1: angles are times, and the stick half-width is `mu`."""
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu))
    one = ss.simulate(system, ss.VelocitySteps(durations, velocities), t1=T1, y0=(x, p))
    return one.near_grazing_count, one.sticks.count, one.status


def counts(dtype, mu, x, p, durations, velocities):
    """Near-grazing counts and numbers of sticks of trajectories that are all mirrored too, which must change nothing.

    Filled up with spare slots, and with spare trajectories.
    """
    rows, spare = len(x), SLOTS - durations.shape[1]
    durations = np.pad(durations, ((0, 0), (0, spare)))
    velocities = np.pad(velocities, ((0, 0), (0, spare)), mode="edge")
    found = []
    for way in (1, -1):
        given = (np.resize(v, (MANY, *v.shape[1:])) for v in (mu, way * x, way * p, durations, way * velocities))
        near, sticks, status = (np.asarray(out)[:rows] for out in followed(*(v.astype(dtype) for v in given)))
        assert np.all(status == ss.Status.FINISHED)
        found.append((near, sticks))
    np.testing.assert_array_equal(*found)
    return found[0]


def is_tie(a: Fraction, x: Fraction, p: Fraction, v: Fraction) -> bool:
    """Whether a long interval begins so that an event hangs on the last digit: exact, by the geometry of the arcs."""
    if v < 0:
        x, p, v = -x, -p, -v
    if v == 0 and p == 0 and abs(x) <= a:
        return abs(x) == a
    D = -x - a if p > v or (p == v and x < -a) else x - a
    excess = D * D + p * p - v * v
    if p == v and D == 0:
        return True  # it begins where the stick would end, or begin
    if excess <= 0:
        return excess == 0 and p < v  # tangent
    # Crossings bring h down by 2a each: it is 2a at last if it is a multiple of 2a now.
    square = excess / (4 * a * a)
    root = Fraction(int(np.sqrt(float(square)) + 0.5))
    return root > 0 and root * root == square


@pytest.mark.slow
@BOTH
def test_first_arcs_with_numbers_on_a_lattice(dtype):
    source = np.random.default_rng(0)
    mu = source.integers(1, 5, MANY) / 4
    x, p, v = (source.integers(-12, 13, MANY) / 4 for _ in range(3))
    p[::3] = v[::3]  # every third begins with the base's velocity
    expected = [is_tie(*map(Fraction, of_one)) for of_one in zip(mu, x, p, v, strict=True)]
    assert 50 < sum(expected) < 100
    near, _ = counts(dtype, mu, x, p, np.full((MANY, 1), 2 * T1), v[:, None])
    np.testing.assert_array_equal(near, expected)


@pytest.mark.slow
@BOTH
def test_a_switch_at_the_instant_of_a_release(dtype):
    """From a stick at the beginning; as long as it lasts, everything is rational."""
    source = np.random.default_rng(1)
    mu = source.integers(1, 5, MANY) / 4
    x = mu * source.integers(-7, 8, MANY) / 8
    v, after = 2.0 ** source.integers(-2, 2, MANY), source.integers(1, 9, MANY) / -4
    release = (mu - x) / v
    switch = release * source.choice([0.5, 1.0, 1.125], MANY)
    expected = []
    for numbers in zip(mu, x, v, after, release, switch, strict=True):
        a, start, speed, then, end, switched = map(Fraction, numbers)
        tie_after = switched <= end and is_tie(a, start + speed * switched, speed, then)
        expected.append((switched == end) + tie_after)
    near, _ = counts(dtype, mu, x, v, np.stack([switch, np.full(MANY, 2 * T1)], 1), np.stack([v, after], 1))
    held = switch <= release
    np.testing.assert_array_equal(near[held], np.asarray(expected)[held])
    assert np.sum(near[held] == 2) > 10  # the same tie twice: of the release, and of what follows from there
    # Later the motion is not rational: a tie by chance only.
    assert np.all(near[~held] == 0)


@pytest.mark.slow
@BOTH
def test_a_switch_at_the_instant_of_an_arrival(dtype):
    """On a base at rest half a turn about the centre leads from a + d to a - d, where it sticks."""
    late = np.array([0.0, 1.0, -1.0, 1e3, -1e3]) * (1e-6 if dtype == np.float64 else 1e-4)
    x, many = np.full(len(late), 0.75), len(late)
    durations = np.stack([np.pi + late, np.full(many, 2 * T1)], 1)
    velocities = np.broadcast_to([0.0, 1.7], (many, 2))
    near, _ = counts(dtype, np.full(many, 0.5), x, np.zeros(many), durations, velocities)
    assert near.tolist() == [1, 0, 0, 0, 0]


@pytest.mark.slow
def test_starts_one_ulp_off_the_edge_of_the_band():
    """One ulp from where friction gives way, on either side, is no stick; one ulp from the other edge there is one."""
    a = 0.25
    x = np.array([a, np.nextafter(a, 1), np.nextafter(a, 0), -a, np.nextafter(-a, -1), 0.1, a + 1e-9, -a - 1e-9])
    v = np.full(8, 2.0**-6)
    near, sticks = counts(np.float64, np.full(8, a), x, v, np.full((8, 1), 2 * T1), v[:, None])
    assert near.tolist() == [1, 1, 1, 1, 1, 0, 0, 0]
    assert sticks.tolist() == [0, 0, 0, 1, 1, 1, 1, 1]


@pytest.mark.slow
@BOTH
def test_tangent_returns_after_a_release_are_no_ties(dtype):
    """Released at speed w, the mass stays on the circle of radius w while the base goes faster and returns to w."""
    source = np.random.default_rng(2)
    many = 200
    w = source.uniform(0.2, 2.0, many)
    mu = source.uniform(0.2, 2.0, many)
    x = mu * source.uniform(-0.9, 0.9, many)
    durations = source.uniform(0.1, 7.0, (many, SLOTS))
    durations[:, 0] += (mu - x) / w
    durations[:, -1] = 2 * T1
    velocities = w[:, None] * np.resize([1.0, 2.0, 1.0, 1.5], SLOTS)
    near, sticks = counts(dtype, mu, x, w, durations, velocities)
    assert np.all(sticks == 1)
    assert near.sum() <= (0 if dtype == np.float64 else 8)  # by chance: 64 of 1e7 units, 4,800 intervals


@pytest.mark.slow
def test_random_and_periodic_motions_have_none():
    """From (0, 1) in the units of the papers, whose start is a stick, or not: mu 1/4 and speed 1/2 here."""
    source = np.random.default_rng(3)
    durations = source.exponential(2.0, (MANY, SLOTS))
    durations[::2] = source.uniform(0.5, 8.0, (MANY // 2, 1))  # square waves
    durations[:, -1] = 2 * T1
    velocities = 0.5 * source.choice([-1.0, 1.0], (MANY, 1)) * np.resize([1.0, -1.0], SLOTS)
    near, sticks = counts(np.float64, np.full(MANY, 0.25), np.zeros(MANY), np.full(MANY, 0.5), durations, velocities)
    assert np.all(near == 0)
    assert sticks.sum() > 5 * MANY


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "most"), [(np.float64, 0), (np.float32, 8_000)])
def test_a_whole_study_has_none(dtype, most):
    """40,000 samples, 8,000,000 intervals."""
    law, system = ss.PoissonSwitching(1.0, 1.0), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))

    @jax.jit
    @jax.vmap
    def one(key):
        base = jax.tree.map(lambda leaf: leaf.astype(dtype), law.sample(key, 200.0))
        return ss.simulate(system, base, t1=200.0, y0=(0.0, 1.0)).near_grazing_count

    assert sum(int(one(keys).sum()) for keys in jax.random.split(jax.random.key(0), (16, 2_500))) <= most


@pytest.mark.slow
def test_ensembles_look_at_the_start():
    """Of 64 samples those whose base begins with the velocity 1 start at the edge of the band."""
    law, system = ss.PoissonSwitching(1.0, 1.0), ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.0))
    key, samples, t1 = jax.random.key(0), 64, 20.0
    first = jax.jit(jax.vmap(lambda i: law.sample(jax.random.fold_in(key, i), t1).velocities[0]))(jnp.arange(samples))

    def near(x, velocity):
        return ss.simulate_ensemble(
            system, law, t1=t1, samples=samples, key=key, y0=(x, velocity), keep="totals", progress=False
        ).near_grazing_samples

    assert 0 < near(np.nextafter(1.0, 2.0), 1.0) == np.count_nonzero(first == 1.0) < samples
    assert near(-1.0, -1.0) == np.count_nonzero(first == -1.0)
    assert near(0.3, 1.0) == near(1.0, 0.3) == near(1 + 1e-9, 1.0) == 0


@pytest.mark.slow
@pytest.mark.parametrize("argument", [0, 1])
def test_the_count_does_not_disturb_derivatives(argument):
    durations, velocities = jnp.asarray([0.7, 0.9, 2.0]), jnp.asarray([1.0, -1.0, 1.0])

    def end(mu, factor):
        base = ss.VelocitySteps(factor * durations, velocities)
        one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu)), base, t1=3.5, y0=(1.0, 1.0))
        return one.final_state[0], one.near_grazing_count

    found = jax.jit(jax.value_and_grad(end, argnums=argument, has_aux=True))
    (_, near), slope = found(1.0, 1.0)
    assert near == 1  # it starts where the stick would end
    step = np.eye(2)[argument] * 1e-6
    more, less = (found(*(1.0 + way * step))[0][0] for way in (1, -1))
    assert float(slope) == pytest.approx(float(more - less) / 2e-6, rel=1e-5, abs=1e-8)


@pytest.mark.slow
def test_time_steps_agree_whether_there_is_a_tie():
    edge = 0.5
    starts = [(edge, 1.0), (np.nextafter(edge, 1), 1.0), (-edge, 1.0), (0.25, 1.0), (-0.3, 0.2), (0.25, -0.9)]
    starts += [(edge + 0.8, -0.6)]  # on the circle of radius 1 about the centre of the slip: tangent

    def ties(method):
        def one(x, p):
            system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(edge))
            # Shorter than a turn after a release, whose tangent return time steps count.
            return ss.simulate(system, ss.Constant(1.0), t1=5.9, y0=(x, p), method=method).near_grazing_count

        return np.asarray(jax.jit(jax.vmap(one))(*map(jnp.asarray, zip(*starts, strict=True)))) > 0

    in_closed_form = ties(ss.Exact())
    assert in_closed_form.tolist() == [True, True, True, False, False, False, True]
    np.testing.assert_array_equal(in_closed_form, ties(ss.Exact(step=0.1, max_steps=400)))
