"""Friction laws through measured points: the curve against scipy, the motion against an event-driven integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.event_driven import simulate_mass_spring
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

import stickslip_jax as ss

SPEEDS = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.8, 1.5])
COEFFICIENTS = np.array([0.6, 0.55, 0.47, 0.4, 0.33, 0.33, 0.31, 0.34, 0.38])
STATIC, T1, START = 0.65, 20.0, (0.1, 0.0)
BASE, STEP = ss.Harmonic(0.4, 0.9), ss.Exact(step=0.05, max_steps=4096)
NOTHING = {"force": lambda t, _: 0.0, "t1": T1, "y0": START, "mass": 1.0, "stiffness": 4.0, "damping": 0.0}


def by_scipy(speeds=SPEEDS, coefficients=COEFFICIENTS):
    """The curve of the documentation: the slopes of `PchipInterpolator`, zero at the last point, constant beyond."""
    slopes = PchipInterpolator(speeds, coefficients).derivative()(speeds)
    slopes[-1] = 0.0
    spline = CubicHermiteSpline(speeds, coefficients, slopes)
    return lambda speed: spline(np.minimum(speed, speeds[-1]))


def reference(coefficients=COEFFICIENTS):
    curve = by_scipy(SPEEDS, coefficients)
    return simulate_mass_spring(
        **NOTHING,
        normal_force=1.0,
        mu_static=STATIC,
        mu_kinetic=lambda s: float(curve(s) if s >= 0 else 2 * curve(0.0) - curve(-s)),
        base_velocity=lambda t, _: 0.4 * np.cos(0.9 * t),
        base_acceleration=lambda t, _: -0.36 * np.sin(0.9 * t),
    )


@jax.jit
def followed(coefficients):
    law = ss.FrictionCurve.from_table(SPEEDS, coefficients, mu_static=STATIC)
    one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, law), BASE, t1=T1, y0=START, method=STEP)
    return one.sticks, one.status, one.stick_time


@pytest.mark.slow
@pytest.mark.parametrize("size", [*(pytest.param(size, marks=pytest.mark.slow) for size in (2, 3, 100)), 9])
def test_the_curve(size):
    draw = np.random.default_rng(size)
    speeds = np.concatenate([[0.0], np.cumsum(draw.uniform(0.01, 1.0, size - 1))])
    levels = np.round(draw.uniform(0.0, 1.0, size), 1)  # some neighbours are equal
    law, expected = ss.FrictionCurve.from_table(speeds, levels), by_scipy(speeds, levels)
    at = jnp.asarray(np.concatenate([speeds, np.linspace(0, 1.2 * speeds[-1], 997)]))
    found = jax.vmap(law.kinetic)(at)
    np.testing.assert_allclose(found, expected(np.asarray(at)), atol=1e-13)
    np.testing.assert_allclose(found[:size], levels, atol=1e-15)
    assert float(law.static) == levels[0]
    assert np.all(found >= levels.min() - 1e-15)
    assert np.all(found <= levels.max() + 1e-15)  # monotone between the points
    slope = jax.vmap(jax.grad(law.kinetic))
    np.testing.assert_allclose(
        slope(jnp.asarray(speeds[1:-1]) - 1e-9), slope(jnp.asarray(speeds[1:-1]) + 1e-9), atol=1e-5
    )
    np.testing.assert_array_equal(slope(jnp.asarray([1.01, 2.0, 1e6]) * speeds[-1]), 0.0)


@pytest.mark.slow
def test_motions_against_the_reference():
    """Times of events within the accuracy of the other laws, although the curvature jumps at each point."""
    run, (sticks, status, _) = reference(), followed(jnp.asarray(COEFFICIENTS))
    assert int(status) == ss.Status.FINISHED
    mask = np.asarray(sticks.mask)
    assert mask.sum() == len(run.sticks) > 1
    for name in ("start", "end", "position"):
        np.testing.assert_allclose(
            np.asarray(getattr(sticks, name))[mask], [getattr(s, name) for s in run.sticks], atol=1e-7
        )


@pytest.mark.slow
def test_derivatives_by_the_coefficients_against_the_reference():
    slopes = jax.grad(lambda c: followed(c)[2])(jnp.asarray(COEFFICIENTS))
    for point in (1, 3):
        change = np.where(np.arange(len(SPEEDS)) == point, 1e-5, 0.0)
        ends = [sum(s.end - s.start for s in reference(COEFFICIENTS + sign * change).sticks) for sign in (1, -1)]
        assert float(slopes[point]) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-4)


@pytest.mark.slow
def test_several_tables_side_by_side():
    tables = jnp.asarray(np.stack([COEFFICIENTS, 0.9 * COEFFICIENTS]))
    both = jax.vmap(followed)(tables)
    for index in (0, 1):
        np.testing.assert_allclose(both[2][index], followed(tables[index])[2], atol=1e-9)


@pytest.mark.slow
def test_derivatives_by_the_speeds():
    """At a speed between points, against differences of scipy's curve."""
    found = jax.grad(lambda x: ss.FrictionCurve.from_table(x, COEFFICIENTS).kinetic(jnp.asarray(0.07)))(
        jnp.asarray(SPEEDS)
    )
    for point in (2, 3):
        change = np.where(np.arange(len(SPEEDS)) == point, 1e-6, 0.0)
        ends = [by_scipy(SPEEDS + sign * change)(0.07) for sign in (1, -1)]
        assert float(found[point]) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-6)


@pytest.mark.slow
def test_uncertain_and_stored(tmp_path):
    """A scale that differs from sample to sample, drawn and given; the file holds every point."""
    law = ss.FrictionCurve.from_table(SPEEDS, COEFFICIENTS, mu_static=STATIC, scale=ss.Uniform(0.8, 1.0))
    system = ss.MassSpring(1.0, 4.0, 1.0, law)
    run = {"t1": 5.0, "y0": START, "method": STEP, "samples": 8, "keep": "sticks"}
    many = ss.simulate_ensemble(system, BASE, key=jax.random.key(1), **run)
    drawn = many.input_values["scale"]
    assert np.all((drawn > 0.8) & (drawn < 1.0))
    assert len(np.unique(drawn)) == 8
    other = many.realization(3).system
    assert float(other.friction.curve.scale) == drawn[3]
    many.save(tmp_path / "many.nc")
    back = ss.load(tmp_path / "many.nc").system.friction.curve
    np.testing.assert_array_equal(back.speeds, SPEEDS)
    np.testing.assert_array_equal(back.coefficients, COEFFICIENTS)
    assert back.scale == ss.Uniform(0.8, 1.0)


def test_uncertain_numbers_of_a_users_curve():
    """They are checked when they are drawn, and not before."""
    for scale in (ss.Uniform(0.8, 1.0), np.linspace(0.8, 1.0, 8)):
        assert ss.FrictionCurve.from_table(SPEEDS, COEFFICIENTS, scale=scale).curve.scale is not None
    law = ss.FrictionCurve.from_table(SPEEDS, COEFFICIENTS, mu_static=0.6, scale=np.array([0.9, 1.1]))
    with pytest.raises(ValueError, match=r"Sample 1 does not fit: Argument mu_static must be at least curve\(0\)"):
        ss.simulate_ensemble(ss.MassSpring(1.0, 4.0, 1.0, law), BASE, samples=2, t1=5.0, method=STEP)


@pytest.mark.slow
def test_single_precision():
    with jax.enable_x64(False):
        law = ss.FrictionCurve.from_table(SPEEDS, COEFFICIENTS)
        at = jnp.asarray(np.linspace(0, 2, 101), jnp.float32)
        found = jax.vmap(law.kinetic)(at)
        assert found.dtype == jnp.float32
        np.testing.assert_allclose(found, by_scipy()(np.asarray(at, float)), atol=1e-6)
        with pytest.raises(ValueError, match=r"speeds must increase in float32 too, but speeds\[2\] = 1\.000000001"):
            ss.FrictionCurve.from_table([0.0, 1.0, 1.000000001], [0.5, 0.4, 0.3])


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("table", "message"),
    [
        (([0.1, 0.2], [0.5, 0.4]), "Argument speeds must begin with 0, .*put the coefficient at vanishing speed first"),
        (([0.0, 0.2, 0.2], [0.5, 0.4, 0.3]), r"Argument speeds must increase, but speeds\[2\] = 0.2 follows 0.2"),
        (([0.0, 0.2], [0.5, -0.1]), "Argument coefficients must be zero or positive"),
        (([0.0, 0.2], [0.5, np.nan]), "Argument coefficients must be finite"),
        (([0.0, np.inf], [0.5, 0.4]), "Argument speeds must be finite"),
        (([0.0, 0.2, 0.3], [0.5, 0.4]), r"same length of at least 2, but they have shapes \(3,\) and \(2,\)"),
        (([0.0], [0.5]), "same length of at least 2"),
        (("a", [0.5]), "Argument speeds must be a one-dimensional sequence"),
    ],
)
def test_bad_input(table, message):
    with pytest.raises(ValueError, match=message):
        ss.FrictionCurve.from_table(*table)


def test_static_friction_is_checked():
    with pytest.raises(ValueError, match=r"mu_static must be at least curve\(0\) = 0.6, but 0.5 was given"):
        ss.FrictionCurve.from_table(SPEEDS, COEFFICIENTS, mu_static=0.5)
