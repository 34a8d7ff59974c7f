"""Steady sliding and its stability: flutter by mode coupling, Hopf points of weakening friction, closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

BELT = ss.Constant(1.0)


def stiffness():
    """Hoffmann and others 2002, "A minimal model for studying properties of the mode-coupling type instability in
    friction induced oscillations": springs of 11 and 20 at 150 and 30 degrees, one of 11 in the contact.
    """
    along = np.array([[np.cos(a), np.sin(a)] for a in np.radians([150, 30])])
    return along.T @ (np.array([11.0, 20.0])[:, None] * along) + np.diag([0.0, 11.0])


def brake(mu, damping=None, preload=1.0):
    contact = ss.Contact([1.0, 0.0], preload, ss.Coulomb(mu), normal_stiffness=[0.0, 11.0])
    return ss.LinearStructure([1.0, 1.0], stiffness(), damping, (contact,))


def by_hand(mu):
    """Of the mass that lags behind the belt: ``x'' = -K x + mu (N + 11 y)``."""
    matrix = stiffness()
    matrix[0, 1] -= 11 * mu
    return matrix, np.linalg.solve(matrix, [mu, 0.0])


def test_flutter_of_two_modes():
    k = stiffness()
    expected = ((k[0, 0] - k[1, 1]) ** 2 + 4 * k[0, 1] ** 2) / (4 * k[0, 1] * 11)
    assert expected == pytest.approx(0.4724, abs=1e-4)  # as published
    found = ss.nonlinear.stability_map(brake(0.3), BELT, {"mu": np.linspace(0, 1, 6)})
    np.testing.assert_allclose(found.critical, [expected], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.critical_frequency, [np.sqrt((k[0, 0] + k[1, 1]) / 2)], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(found.is_stable, [True, True, True, False, False, False])
    for mu, rate, x, y in zip(found.mu, found.growth_rate, found.position_0, found.position_1, strict=True):
        matrix, state = by_hand(float(mu))
        np.testing.assert_allclose([x, y], state, rtol=0, atol=1e-14)
        np.testing.assert_allclose(rate, np.max(np.abs(np.imag(np.sqrt(np.linalg.eigvals(matrix) + 0j)))), atol=1e-7)
    assert np.all(found.exists)


def test_the_motion_grows_as_its_equilibrium_says():
    one = ss.nonlinear.equilibrium(brake(0.6, preload=1e6), ss.Constant(1e6))
    assert not one.is_stable
    away = np.asarray(one.state) + np.eye(4)[0]
    run = ss.simulate(brake(0.6, preload=1e6), ss.Constant(1e6), t1=40.0, y0=tuple(away))
    # What a left eigenvector sees of the disturbance is one exponential.
    rates, left = np.linalg.eig(np.asarray(one.jacobian).T)
    number = int(np.argmax(rates.real + 1e-9 * rates.imag))
    begin, end = (left[:, number] @ (np.stack(run.evaluate(t)) - np.asarray(one.state)) for t in (0.0, 40.0))
    np.testing.assert_allclose(end / begin, np.exp(40 * rates[number]), rtol=1e-8)
    np.testing.assert_allclose(rates[number], complex(one.eigenvalues[np.argmax(np.asarray(one.eigenvalues).imag[:2])]))
    assert float(one.growth_rate) == pytest.approx(rates[number].real)


def weakening(slope=0.3, damping=0.1):
    return ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(0.5, slope), damping=damping)


def test_hopf_point_of_weakening_friction():
    """Damping equal to the slope of the friction curve: ``c = mu w / (1 + w v)^2``, at the natural frequency."""
    found = ss.nonlinear.stability_map(weakening(), BELT, {"weakening": [0.2, 0.5, 3.0, 20.0], "damping": [0.05, 0.1]})
    for damping, critical, frequency in zip(
        found.damping.values, found.critical.values, found.critical_frequency.values, strict=True
    ):
        roots = np.sort(np.roots([damping, 2 * damping - 0.5, damping]))
        expected = [root for root in roots if 0.2 < root < 20]
        shown = critical[~np.isnan(critical)]
        np.testing.assert_allclose(shown, expected, rtol=1e-9)
        np.testing.assert_allclose(frequency[: len(shown)], 1, atol=1e-5)
    assert found.sizes["change"] == 2


def test_derivatives_and_transformations():
    def state(mu):
        return ss.nonlinear.equilibrium(brake(mu), BELT).state[:2]

    def closed(mu):
        matrix = jnp.asarray(stiffness()).at[0, 1].add(-11 * mu)
        return jnp.linalg.solve(matrix, jnp.array([mu, 0.0]))

    for derivative in (jax.jacfwd, jax.jacrev, lambda of: jax.jacfwd(jax.jacfwd(of))):
        np.testing.assert_allclose(derivative(state)(0.4), derivative(closed)(0.4), rtol=0, atol=1e-12)

    def rate(damping):
        return ss.nonlinear.equilibrium(weakening(damping=damping), BELT).growth_rate

    expected = [(0.5 * 0.3 / 1.3**2 - damping) / 2 for damping in (0.1, 0.2)]
    np.testing.assert_allclose(jax.vmap(jax.jit(rate))(jnp.array([0.1, 0.2])), expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(jax.grad(rate)(0.1), -0.5, rtol=0, atol=1e-12)


def test_what_does_not_exist():
    still = ss.nonlinear.equilibrium(brake(0.3), ss.Constant(0.0))
    assert not still.exists
    assert "DOES NOT EXIST" in repr(still)
    lifted = ss.nonlinear.equilibrium(
        ss.LinearStructure(
            [1.0, 1.0], stiffness(), None,
            (ss.Contact([1.0, 0.0], 1.0, ss.Coulomb(0.3), normal_stiffness=[0.0, 11.0]),), (None, -20.0),
        ),
        BELT,
    )  # fmt: skip
    assert not lifted.exists
    assert not lifted.is_stable
    # At rest on a belt at rest nothing slides: that it comes to exist between two speeds is no change of stability.
    map_of_speeds = ss.nonlinear.stability_map(brake(0.3), ss.Constant(0.0), {"speed": [0.0, 1.0, 2.0]})
    np.testing.assert_array_equal(map_of_speeds.exists, [False, True, True])
    np.testing.assert_array_equal(map_of_speeds.is_stable, [False, True, True])
    assert np.all(np.isnan(map_of_speeds.critical))
    with pytest.raises(ValueError, match="constant velocity, without other drives"):
        ss.nonlinear.equilibrium(brake(0.3), ss.Harmonic(1.0, 2.0))
    with pytest.raises(ValueError, match="constant velocity, without other drives"):
        ss.nonlinear.stability_map(brake(0.3), ss.Harmonic(1.0, 2.0), {"mu": [0.1, 0.2]})
