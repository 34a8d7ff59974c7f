"""Vmapped trajectories in blocks of lanes: the same numbers and derivatives as one scan over all intervals."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.interval import engine as given_intervals
from stickslip_jax._dynamics.interval.arcs import scales_of, start_motion
from stickslip_jax._dynamics.interval.engine import Given, _plain, motion_over

LAW = ss.PoissonSwitching(speed=0.6, rate=1.0)
T1 = 12.0
SLOTS = 40
FUNCTIONS = {what: partial(motion_over, what) for what in ("final", "sticks", "beginnings")}
final_motion, ordered_sticks, beginnings = FUNCTIONS.values()


def given_of(numbers, base) -> Given:
    """`numbers`: mass, stiffness, friction coefficient, position and velocity at the start."""
    mass, stiffness, mu, x, velocity = numbers
    scales = scales_of(ss.MassSpring(mass, stiffness, 1.0, ss.Coulomb(mu)), T1, jnp.result_type(float))
    return Given(scales, (jnp.asarray(x), jnp.asarray(velocity)), base.durations, base.velocities)


def bases(number):
    return jax.vmap(lambda key: LAW.sample(key, T1, capacity=SLOTS))(jax.random.split(jax.random.key(3), number))


NUMBERS = jnp.asarray([1.2, 4.0, 0.8, 0.3, -0.4])


def assert_same(got, expected, tolerance=1e-12):
    """Equal to round-off; positions of spare slots and endings exactly."""
    pairs = zip(*(map(np.asarray, jax.tree.leaves(tree)) for tree in (got, expected)), strict=True)
    for a, b in pairs:
        assert a.dtype == b.dtype
        if np.issubdtype(a.dtype, np.floating):
            np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
            np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)
        else:
            np.testing.assert_array_equal(a, b)


@pytest.fixture(scope="module")
def scanned():
    """600 bases, and what one scan over all intervals makes of each."""
    base = bases(600)
    return base, jax.jit(jax.vmap(lambda base: {what: _plain(what, given_of(NUMBERS, base)) for what in FUNCTIONS}))(
        base
    )


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 5, 256, 257, 600])
def test_any_number_of_lanes(scanned, lanes):
    base, expected = jax.tree.map(lambda leaf: leaf[:lanes], scanned)
    got = jax.jit(jax.vmap(lambda base: {what: of(given_of(NUMBERS, base)) for what, of in FUNCTIONS.items()}))(base)
    for what in FUNCTIONS:
        assert_same(got[what], expected[what])
    assert np.sum(np.asarray(got["sticks"].ending) >= 0) > lanes  # else there is little to compare


def test_an_empty_batch_has_empty_results():
    none = jax.tree.map(lambda leaf: leaf[:0], bases(2))
    sticks = jax.jit(jax.vmap(lambda base: ordered_sticks(given_of(NUMBERS, base))))(none)
    assert sticks.start.shape == sticks.ending.shape == (0, SLOTS)


@pytest.mark.slow
def test_vmap_of_vmap_and_parameters_alone():
    base = bases(3)
    frictions = jnp.linspace(0.2, 1.4, 100)

    def at(mu, base):
        return ordered_sticks(given_of(NUMBERS.at[2].set(mu), base))

    grid = jax.jit(jax.vmap(jax.vmap(at, in_axes=(0, None)), in_axes=(None, 0)))(frictions, base)
    for index in range(3):
        one = jax.tree.map(lambda leaf, index=index: leaf[index], base)
        alone = [jax.jit(at)(mu, one) for mu in frictions[::33]]
        for place, expected in zip(range(0, 100, 33), alone, strict=True):
            assert_same(jax.tree.map(lambda leaf, i=index, p=place: leaf[i, p], grid), expected)


def outcome(what, follow, base, numbers):
    """All real results, spare slots as zeros."""
    leaves = jax.tree.leaves(follow(what, given_of(numbers, base)))
    return [jnp.nan_to_num(leaf) for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)]


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_are_those_of_the_scan(mode):
    base = bases(6)

    def slopes_by(follow):
        def outcomes(base, numbers):
            return {what: outcome(what, follow, base, numbers) for what in FUNCTIONS}

        return jax.jit(jax.vmap(mode(outcomes, argnums=1), in_axes=(0, None)))(base, NUMBERS)

    got, expected = slopes_by(given_intervals._fast), slopes_by(_plain)
    for what in FUNCTIONS:
        assert max(float(jnp.abs(slope).max()) for slope in got[what]) > 0.1
        assert_same(got[what], expected[what], 1e-9)


def total(follow, mu, base):
    sticks = follow("sticks", given_of(NUMBERS.at[2].set(mu), base))
    return jnp.where(sticks.ending >= 0, sticks.end - sticks.start, 0).sum()


@pytest.mark.slow
def test_gradient_of_a_mean_over_lanes_outside_of_vmap():
    base = bases(300)

    def mean(follow, mu):
        return jax.vmap(partial(total, follow, mu))(base).mean()

    fast, plain = (jax.jit(jax.value_and_grad(partial(mean, follow))) for follow in (given_intervals._fast, _plain))
    got, expected = fast(0.8), plain(0.8)
    assert_same(got, expected, 1e-12)
    forward = jax.jit(lambda mu: jax.jvp(partial(mean, given_intervals._fast), (mu,), (1.0,)))(0.8)
    assert_same(forward, got, 1e-12)
    step = 1e-6  # a central difference along the same paths
    difference = (plain(0.8 + step)[0] - plain(0.8 - step)[0]) / (2 * step)
    assert float(got[1]) == pytest.approx(float(difference), rel=1e-6)


@pytest.mark.slow
def test_derivatives_by_the_base_itself():
    base = jax.tree.map(lambda leaf: leaf[0], bases(1))

    def of(follow, factor, speed, mu):
        faster = ss.VelocitySteps(base.durations * factor, base.velocities * speed)
        return total(follow, mu, faster)

    got, expected = (
        jax.jit(jax.grad(partial(of, follow), argnums=(0, 1, 2)))(1.01, 0.97, 0.8)
        for follow in (given_intervals._fast, _plain)
    )
    assert min(abs(float(slope)) for slope in got) > 1e-3
    assert_same(got, expected, 1e-10)


@pytest.mark.slow
def test_second_derivatives_in_forward_mode():
    base = jax.tree.map(lambda leaf: leaf[0], bases(1))
    got, expected = (
        jax.jit(jax.jacfwd(jax.jacfwd(partial(total, follow))))(0.8, base) for follow in (given_intervals._fast, _plain)
    )
    assert_same(got, expected, 1e-8)
    mixed = jax.jit(jax.jacfwd(jax.grad(partial(total, given_intervals._fast))))(0.8, base)
    assert_same(mixed, expected, 1e-8)


@pytest.mark.slow
def test_a_block_ends_with_its_last_lane():
    base = bases(4)
    longer = jax.tree.map(lambda leaf: jnp.pad(leaf, ((0, 0), (0, 5000))), base)
    crossed = given_intervals._cross_all

    def crossed_of(base):
        given = jax.vmap(partial(given_of, NUMBERS))(base)
        totals = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (4,)), given_intervals.start_totals(jnp.float64))
        block = given_intervals._Block(
            jnp.zeros((), jnp.int32), jax.vmap(start_motion)(given.scales, given.y0), totals, None
        )
        return int(crossed(given.scales, given.durations, given.velocities, block).crossed)

    assert crossed_of(longer) == crossed_of(base) < SLOTS


@pytest.mark.slow
def test_bases_too_short_and_not_finite_are_seen_in_their_lane_alone():
    good = jax.tree.map(lambda leaf: leaf[0], bases(1))
    short = ss.VelocitySteps(good.durations * 1e-3, good.velocities)
    broken = jax.tree.map(lambda leaf: leaf, good)
    object.__setattr__(broken, "durations", good.durations.at[2].set(jnp.nan))  # which the class would refuse
    many = jax.tree.map(lambda *leaves: jnp.stack(leaves), good, short, broken)
    system = ss.MassSpring(1.2, 4.0, 1.0, ss.Coulomb(0.8))
    status = jax.jit(jax.vmap(lambda base: ss.simulate(system, base, t1=T1, y0=(0.3, -0.4)).status))(many)
    assert list(np.asarray(status)) == [ss.Status.FINISHED, ss.Status.BASE_TOO_SHORT, ss.Status.BASE_INVALID]
