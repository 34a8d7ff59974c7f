"""Regularised static friction: against closed forms, the exact engine, and Radau on the same smooth field."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.regularized import PHI

import stickslip_jax as ss

# A belt of constant speed v: the mass sticks until k x = mu_s n, slips, and sticks again at 2 mu n / k - mu_s n / k.
MASS, STIFFNESS, NORMAL, MU, MU_STATIC, SPEED, T1 = 0.5, 1.0, 4.0, 0.25, 0.375, 0.3, 13.0
SYSTEM = ss.MassSpring(MASS, STIFFNESS, NORMAL, ss.Coulomb(MU, MU_STATIC))
BELT, START = ss.Constant(SPEED), (0.0, SPEED)
OMEGA = np.sqrt(STIFFNESS / MASS)


def instants(mu=MU, mu_static=MU_STATIC):
    """First release, next arrival, second release (s), and x at `T1`, in closed form."""
    held, rubbing = mu_static * NORMAL / STIFFNESS, mu * NORMAL / STIFFNESS
    first = held / SPEED
    turn = 2 * np.arctan2((held - rubbing) * OMEGA, SPEED)
    arrival = first + (2 * np.pi - turn) / OMEGA
    second = arrival + 2 * (held - rubbing) / SPEED
    angle = OMEGA * (T1 - second)
    x = rubbing + (held - rubbing) * np.cos(angle) + SPEED / OMEGA * np.sin(angle)
    return np.array([first, arrival, second, x])


def told(one):
    """What `instants` gives, of a simulation."""
    return jnp.stack([one.sticks.end[0], one.sticks.start[1], one.sticks.end[1], one.final_state[0]])


@cache
def program(shape):
    def run(width, mu, mu_static):
        system = ss.MassSpring(MASS, STIFFNESS, NORMAL, ss.Coulomb(mu, mu_static))
        method = ss.Regularized(width, shape, step=2e-3, max_steps=8000)
        one = ss.simulate(system, BELT, t1=T1, y0=START, method=method)
        return told(one), one.sticks.count, one.status

    return jax.jit(jax.vmap(run, in_axes=(0, None, None)))


def orders(widths, errors):
    return np.polyfit(np.log(widths), np.log(np.abs(errors)), 1)[0]


QUICK = [shape if shape == "linear" else pytest.param(shape, marks=pytest.mark.slow) for shape in PHI]


@pytest.mark.slow
@pytest.mark.parametrize("shape", QUICK)
def test_instants_converge_in_fixed_steps(shape):
    """For narrow widths, which the steps do not resolve, the errors are of first order, for all shapes."""
    widths = np.array([3e-3, 1e-3, 3e-4, 1e-4, 1e-9])
    found, count, status = program(shape)(jnp.asarray(widths), MU, MU_STATIC)
    np.testing.assert_array_equal(status, ss.Status.FINISHED)
    np.testing.assert_array_equal(count, 2)
    errors = np.asarray(found) - instants()
    assert np.max(np.abs(errors[1])) < 0.08
    assert np.max(np.abs(errors[3])) < 0.008
    assert np.max(np.abs(errors[4])) < 2e-4
    for column in (0, 2):
        assert 0.8 < orders(widths[:4], errors[:4, column]) < 1.6


def field(shape, width, mu, mu_static):
    def coefficient(r):
        s, beyond = np.clip(r / width, -1, 1), max(abs(r / width) - 1, 0)
        held = mu_static * (s if shape == "linear" else s * (3 - s * s) / 2)
        left = np.exp(-beyond) if shape == "linear" else np.exp(-(beyond**2))
        return held if beyond == 0 else left * held + (1 - left) * mu * np.sign(r)

    return lambda t, y: [y[1], (-STIFFNESS * y[0] - NORMAL * coefficient(y[1] - SPEED)) / MASS]


def by_radau(shape, width, mu=MU, mu_static=MU_STATIC):
    """The same numbers as `told`, of the same smooth field."""
    events = [lambda t, y: abs(y[1] - SPEED) - width * (1 + 1e-12)]
    arc = solve_ivp(
        field(shape, width, mu, mu_static), (0, T1), START, "Radau", rtol=1e-9, atol=1e-11, max_step=0.02, events=events
    )
    return np.array([*arc.t_events[0][:3], arc.y[0, -1]])


@pytest.mark.slow
def test_the_field_is_that_of_the_documentation():
    """Steps that resolve a wide switch agree with Radau on the documented field."""
    found, _, _ = program("linear")(jnp.array([0.03, 0.03, 0.03, 0.03, 0.03]), MU, MU_STATIC)
    np.testing.assert_allclose(found[0], by_radau("linear", 0.03), atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("shape", PHI)
def test_instants_converge_in_adaptive_steps(shape):
    """Of order 1 for the linear shape, 2/3 for the smooth ones; and as Radau finds them."""
    widths, found = np.array([1e-2, 1e-3, 1e-4]), []
    for width in widths:
        method = ss.Regularized(width, shape, rtol=1e-9)
        one = ss.simulate(SYSTEM, BELT, t1=T1, y0=START, method=method)
        assert one.status == ss.Status.FINISHED
        found.append(np.asarray(told(one)))
    np.testing.assert_allclose(found[0], by_radau(shape, 1e-2), atol=2e-4)
    errors = np.array(found) - instants()
    for column in (0, 2):
        low, high = (0.85, 1.1) if shape == "linear" else (0.6, 1.0)
        assert low < orders(widths, errors[:, column]) < high, column


def strong(width, step, ratio=8.0):
    """A mass that arrives fast where static friction holds, and kinetic friction would not."""
    system = ss.MassSpring(MASS, STIFFNESS, NORMAL, ss.Coulomb(2.0 / ratio, 2.0))
    base = ss.Harmonic(2.0, 2.0, 1.0)
    method = ss.Exact() if width is None else ss.Regularized(width, step=step, max_steps=49152)
    return ss.simulate(system, base, t1=8.0, y0=(-7.0, 0.0), method=method)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [8.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def test_no_step_jumps_over_a_stick(ratio):
    exact = strong(None, None, ratio)
    assert exact.sticks.count == 1
    for width, step in ((1e-3, 1e-3), (1e-5, 1e-3), (1e-9, 1e-3), (1e-3, 2e-4)):
        one = strong(width, step, ratio)
        assert one.status == ss.Status.FINISHED
        assert one.sticks.count == 1
        np.testing.assert_allclose(one.sticks.start[0], exact.sticks.start[0], atol=2e-3)
        np.testing.assert_allclose(one.final_state, exact.final_state, atol=8 * width + 0.2 * step)


@pytest.mark.slow
def test_derivatives_through_releases():
    """Of all instants and the end by both coefficients; forward, and reverse along one direction."""
    width = jnp.array([1e-6] * 5)
    step = 1e-6

    def run(mu, mu_static):
        return program("linear")(width, mu, mu_static)[0][0]

    slopes = jax.jacfwd(run, argnums=(0, 1))(MU, MU_STATIC)
    expected = [
        (instants(MU + step) - instants(MU - step)) / (2 * step),
        (instants(MU, MU_STATIC + step) - instants(MU, MU_STATIC - step)) / (2 * step),
    ]
    np.testing.assert_allclose(slopes, expected, atol=0.03, rtol=5e-3)


class Belted(ss.SwitchedSystem):
    """The same system written by hand."""

    state_names = ("position in m", "velocity in m/s")

    def rates(self, t, y, base, friction):
        return y[1], (-STIFFNESS * y[0] - NORMAL * MU * friction) / MASS

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def static_ratio(self):
        return MU_STATIC / MU

    @property
    def shortest_time(self):
        return 2 * np.pi / OMEGA

    @property
    def speed_scale(self):
        return 1.0


def curve(speed):
    return MU * jnp.ones_like(speed)


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [True, False])
def test_other_ways_to_write_the_same_system(fixed):
    """A curve with static friction, and a system of one's own: as the built-in law, and as the exact motion."""
    # The error of a width of 1e-4 is 3.1e-3 s by itself; in steps of 2 ms it is half of that, by chance.
    options = {"width": 1e-4, "step": 2e-3, "max_steps": 8000} if fixed else {"width": 5e-5, "rtol": 1e-8}
    method = ss.Regularized(minimum_duration=1e-2, **options)
    systems = (Belted(), ss.MassSpring(MASS, STIFFNESS, NORMAL, ss.FrictionCurve(curve, MU_STATIC)))
    for system in systems:
        one = ss.simulate(system, BELT, t1=T1, y0=START, method=method)
        np.testing.assert_allclose(told(one), instants(), atol=3e-3)


@pytest.mark.slow
def test_in_an_ensemble_and_in_float32():
    """Samples are simulations; in single precision the same sticks, at the same instants but for round-off."""
    method = ss.Regularized(1e-3, step=2e-3)
    law = ss.PoissonSwitching(0.5, 0.3)
    options = {"t1": T1, "samples": 6, "key": jax.random.key(2), "y0": (0.1, 0.2), "keep": "sticks", "method": method}
    many = ss.simulate_ensemble(SYSTEM, law, **options)
    assert many.status_counts[ss.Status.FINISHED] == 6
    system, base, y0 = many.realization(3)
    exact, one = (
        ss.simulate(system, base, t1=T1, y0=y0, method=how) for how in (ss.Exact(), ss.Regularized(1e-3, step=2e-3))
    )
    number = int(one.sticks.count)
    of_sample = many.flat_sticks.sample == 3
    np.testing.assert_allclose(many.flat_sticks.start[of_sample], one.sticks.start[:number], atol=1e-9)
    assert exact.sticks.count == one.sticks.count
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        single = ss.simulate_ensemble(SYSTEM, law, **options)
    assert single.status_counts[ss.Status.FINISHED] == 6
    np.testing.assert_array_equal(single.flat_sticks.count, many.flat_sticks.count)
    assert float(single.moments.mean[0]) == pytest.approx(float(many.moments.mean[0]), rel=1e-3)
