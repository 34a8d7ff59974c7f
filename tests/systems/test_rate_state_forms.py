"""Rate-and-state friction under steps of the speed and of the normal force: closed forms, and scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

A, B, L, V0, MU = 0.012, 0.017, 1e-5, 1e-6, 0.6
FORMS = "ageing", "slip", "perrin"


def law_of(form, alpha=None, normal=None):
    return ss.DieterichRuina(MU, A, B, L, V0, form, alpha, normal)


def theta_after(form, theta, v, t):
    """The state variable after a slip of the speed `v` for `t` (s)."""
    if form == "ageing":
        return L / v + (theta - L / v) * np.exp(-v * t / L)
    if form == "slip":
        return L / v * np.exp(np.log(v * theta / L) * np.exp(-v * t / L))
    share, decay = v * theta / (2 * L), np.exp(-v * t / L)  # a hyperbolic tangent, or cotangent, of half the slip
    left = (1 - share) / (1 + share) * decay
    return 2 * L / v * (1 - left) / (1 + left)


def coefficient(form, theta, v):
    z = np.log(V0 * theta / L / (2 if form == "perrin" else 1))
    return A * np.arcsinh(v / (2 * V0) * np.exp((MU + B * z) / A))


def theta_rate(form, theta, v):
    if form == "ageing":
        return 1 - v * theta / L
    return 1 - (v * theta / (2 * L)) ** 2 if form == "perrin" else -v * theta / L * np.log(v * theta / L)


@pytest.mark.parametrize("form", FORMS)
def test_steps_of_the_speed(form):
    """The force right after each step, and between, is that of the closed form; at first the slip is steady."""
    law, times = law_of(form), np.array([0.0, 5.0, 10.0, 11.0, 14.0, 20.0, 21.0, 40.0])
    steps = ss.PiecewiseConstant([0.0, 10.0, 14.0, 20.0], [1e-6, 1e-5, 1e-4, 2e-6])
    theta, expected = L / V0 * (2 if form == "perrin" else 1), []
    for i, t in enumerate(times):
        now = [1e-6, 1e-5, 1e-4, 2e-6][np.searchsorted([10.0, 14.0, 20.0], t, side="right")]
        expected.append(coefficient(form, theta, now))
        if i + 1 < len(times):
            theta = theta_after(form, theta, now, times[i + 1] - t)
    np.testing.assert_allclose(law.force(times, steps, 2.0), 2 * np.array(expected), rtol=1e-7)
    assert expected[0] == pytest.approx(MU, rel=1e-9)
    z = np.log(V0 * theta / L / (2 if form == "perrin" else 1))
    assert float(law.theta(jnp.asarray(z))) == pytest.approx(theta, rel=1e-14)


@pytest.mark.slow
def test_steps_of_the_speed_of_other_laws():
    steps, times = ss.PiecewiseConstant([0.0, 1.0, 2.0], [0.1, -0.3, 0.2]), [0.0, 0.5, 1.0, 1.5, 2.0, 3.0]
    np.testing.assert_array_equal(ss.Coulomb(0.3).force(times, steps), 0.3 * np.array([1, 1, -1, -1, 1, 1]))
    elastic = ss.Coulomb(0.3).force(times, steps, series_stiffness=2.0)
    np.testing.assert_allclose(elastic, [0.0, 0.1, 0.2, -0.1, -0.3, 0.1], rtol=0, atol=1e-15)
    dahl = ss.Dahl(0.3, 2.0).force(times, steps, rtol=1e-11)
    wanted, z = [0.0], 0.0
    for v, h in ((0.1, 0.5), (0.1, 0.5), (-0.3, 0.5), (-0.3, 0.5), (0.2, 1.0)):
        limit = 0.15 * np.sign(v)
        z = limit + (z - limit) * np.exp(-2 * abs(v) * h / 0.3)
        wanted.append(2 * z)
    np.testing.assert_allclose(dahl, wanted, rtol=0, atol=1e-8)
    with pytest.raises(ValueError, match="Argument times must be zero or positive"):
        ss.Dahl(0.3, 2.0).force([-1.0, 1.0], steps)


@pytest.mark.parametrize("form", [FORMS[0], *(pytest.param(form, marks=pytest.mark.slow) for form in FORMS[1:])])
def test_steps_of_the_normal_force(form):
    """A step multiplies theta by ``(N_1 / N)^(-alpha / b)``."""
    alpha, v, times = 0.3, 3e-6, np.array([0.0, 4.0, 5.0, 7.0, 9.0, 20.0])
    force = ss.ForceSteps([0.0, 5.0, 9.0], [1e6, 1.4e6, 0.8e6])
    theta, expected = L / V0 * (2 if form == "perrin" else 1), []
    for i, t in enumerate(times):
        normal = [1e6, 1.4e6, 0.8e6][np.searchsorted([5.0, 9.0], t, side="right")]
        if t in (5.0, 9.0):
            theta *= (normal / (1e6 if t == 5.0 else 1.4e6)) ** (-alpha / B)
        expected.append(normal * coefficient(form, theta, v))
        if i + 1 < len(times):
            theta = theta_after(form, theta, v, times[i + 1] - t)
    found = law_of(form, alpha, 1e6).force(times, ss.PiecewiseConstant([0.0], [v]), force)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.slow
def test_a_normal_force_that_swings_against_scipy():
    alpha, v, w, times = 0.2, 3e-6, 2.0, np.linspace(0, 15, 31)
    normal = ss.Harmonic(3e5, w, -np.pi / 2, 1e6)

    def level(t):
        return 1e6 + 3e5 * np.sin(w * t)

    def rate(t, theta):
        return theta_rate("ageing", theta, v) - alpha / B * theta * 3e5 * w * np.cos(w * t) / level(t)

    theta = solve_ivp(rate, (0, 15), [L / V0], "LSODA", times, rtol=1e-11, atol=1e-12).y[0]
    motion = ss.PiecewiseConstant([0.0], [v])
    found = law_of("ageing", alpha, 1e6).force(times, motion, normal)
    np.testing.assert_allclose(found, level(times) * coefficient("ageing", theta, v), rtol=1e-6)

    def last(alpha):
        return law_of("ageing", alpha, 1e6).force(times, motion, normal)[-1]

    differences = (last(alpha + 1e-5) - last(alpha - 1e-5)) / 2e-5
    assert float(jax.grad(last)(alpha)) == pytest.approx(float(differences), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("form", "kind"), [("ageing", "block"), ("perrin", "block"), ("ageing", "two")])
def test_a_block_under_a_normal_force_that_swings(form, kind):
    """Against scipy, with theta as its own state; the inner states are numbers of ``evaluate``."""
    a, b, length, v0, mu, alpha = 0.05, 0.03, 0.05, 0.1, 0.5, 0.02
    law, w, base = ss.DieterichRuina(mu, a, b, length, v0, form, alpha, 1.0), 1.3, 0.12
    normal, two = ss.Harmonic(0.3, w, -np.pi / 2, 1.0), 2 if form == "perrin" else 1
    times = np.linspace(0, 12, 13)

    def rates(t, y):
        x, v, theta = y
        n, slip = 1 + 0.3 * np.sin(w * t), v - base
        z = np.log(v0 * theta / length / two)
        share = np.abs(slip) * theta / (two * length)
        mine = 1 - share**2 if form == "perrin" else 1 - share
        step = alpha / b * theta * 0.3 * w * np.cos(w * t) / n
        return [v, -x - n * a * np.arcsinh(slip / (2 * v0) * np.exp((mu + b * z) / a)), mine - step]

    expected = solve_ivp(rates, (0, 12), [0.4, 0.0, two * length / v0], "Radau", times, rtol=1e-10, atol=1e-12).y
    method = ss.Regularized(rtol=1e-9)
    if kind == "block":
        system, place = ss.MassSpring(1.0, 1.0, normal, law), 2
        one = ss.simulate(system, base, t1=12.0, y0=(0.4, 0.0), method=method)
    else:  # twice the same, without a spring between them
        contacts = [ss.Contact.of_mass(i, 2, normal, law) for i in range(2)]
        system, place = ss.LinearStructure([1.0, 1.0], [1.0, 1.0], None, contacts), 5
        one = ss.simulate(system, base, t1=12.0, y0=(0.4, 0.4, 0.0, 0.0), method=method)
    state = np.asarray(one.evaluate(times))
    np.testing.assert_allclose(state[0], expected[0], rtol=0, atol=1e-6)
    at_reference = law.theta(jnp.asarray(state[place]))
    found = at_reference * (1 + 0.3 * np.sin(w * times)) ** (-alpha / b)
    np.testing.assert_allclose(found, expected[2], rtol=1e-5)


def test_what_does_not_fit_is_told():
    law = law_of("ageing", 0.2, 1e6)
    for make, message in (
        (lambda: law_of("ageing", 0.2), "Argument reference_normal_force must be given if normal_stress is"),
        (lambda: law_of("ageing", None, 1.0), "Argument reference_normal_force must be given if normal_stress is"),
        (lambda: ss.DieterichRuina(MU, A, 0.0, L, V0, "slip", 0.1, 1.0), "Argument evolution must be positive"),
        (lambda: law.force([0.0, 1.0], [V0, V0], [1e6, 2e6]), "Argument normal_force must be one number or a function"),
        (lambda: law.force([0.0, 1.0], [V0, V0], 1e6, series_stiffness=1e9), "Argument series_stiffness must be None"),
        (
            lambda: ss.simulate(ss.MotorCart(friction=law), ss.SourceVoltage(1.0, 1.0), 1.0, method=ss.Regularized()),
            "Argument normal_stress must be None in this system",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            make()
