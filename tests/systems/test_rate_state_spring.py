"""Rate-and-state friction behind a spring, as in a test machine: scipy, linear stability, known limits."""

import itertools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import stickslip_jax as ss

MU, A, B, LENGTH, SPEED, NORMAL = 0.6, 0.010, 0.015, 1e-5, 1e-6, 1e6
CRITICAL = NORMAL * (B - A) / LENGTH


def law(form="ageing", a=A, b=B, length=LENGTH):
    return ss.DieterichRuina(MU, a, b, length, SPEED, form=form)


def forces_by_scipy(form, times, velocity, stiffness, backlash):
    """From piece to piece of the prescribed velocity, which is linear in each."""

    def force(p):
        return stiffness * (p - min(max(p, -backlash / 2), backlash / 2))

    def rates(t, state):
        slip = 2 * SPEED * np.sinh(force(state[0]) / NORMAL / A) * np.exp(-(MU + B * state[1]) / A)
        ratio = abs(slip) * np.exp(state[1]) / SPEED  # |v| theta / length
        change = (1 - ratio) if form == "ageing" else -ratio * np.log(ratio) if ratio else 0.0
        return [np.interp(t, times, velocity) - slip, change * np.exp(-state[1]) * SPEED / LENGTH]

    state = np.array([NORMAL * MU / stiffness + backlash / 2, 0.0])  # a steady slip at the reference speed
    found = [force(state[0])]
    for start, end in itertools.pairwise(times):
        done = solve_ivp(
            rates, (start, end), state, "Radau", rtol=1e-11, atol=[1e-18, 1e-11], max_step=(end - start) / 8
        )
        state = done.y[:, -1]
        found.append(force(state[0]))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("backlash", [0.0, 4e-6])
@pytest.mark.parametrize("form", ["ageing", "slip"])
def test_steps_and_turns_against_scipy(form, backlash):
    """Ten times the speed, the way back, forward again."""
    times = np.array([0.0, 2.0, 2.5, 3.0, 5.0, 20.0, 20.5, 40.0, 60.0, 80.0, 80.5, 100.0])
    velocity = np.array([1.0, 1.0, 10.0, 10.0, 10.0, 10.0, -5.0, -5.0, -5.0, -5.0, 8.0, 8.0]) * 1e-6
    stiffness = 10 * CRITICAL
    found = law(form).force(
        times, velocity, NORMAL, series_stiffness=stiffness, backlash=backlash, rtol=1e-10, max_steps=10**6
    )
    expected = forces_by_scipy(form, times, velocity, stiffness, backlash)
    assert float(found[0]) == pytest.approx(NORMAL * MU, rel=1e-15)
    assert min(expected) < -0.5 * NORMAL
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * NORMAL)


def settled(velocities, stiffness, times_after):
    """The force at these times after the speed has passed from the first to the second, within a microsecond."""
    times = jnp.concatenate([jnp.array([0.0, 1e-6]), jnp.asarray(times_after)])
    velocity = jnp.full(times.shape, velocities[1]).at[0].set(velocities[0])
    return law().force(times, velocity, NORMAL, series_stiffness=stiffness, rtol=1e-11, max_steps=10**6)[2:]


@pytest.mark.slow
@pytest.mark.parametrize("share", [*(pytest.param(share, marks=pytest.mark.slow) for share in (0.9, 4.0)), 1.1])
def test_small_step_goes_as_linear_theory_says(share):
    """The force after the speed grows by 1e-5 of itself: eigenvalues of spring and state (Ruina 1983)."""
    stiffness, more = share * CRITICAL, 1e-5
    after = np.array([0.5, 2.0, 5.0, 10.0, 20.0, 40.0])
    found = settled((SPEED, SPEED * (1 + more)), stiffness, after)
    # Deviations x of coefficient and z from the new steady slip: log v = log SPEED + (x[0] - B x[1]) / A.
    per = SPEED / LENGTH
    rates = np.array([
        [-stiffness / NORMAL * SPEED / A, stiffness / NORMAL * SPEED * B / A],
        [-per / A, per * (B / A - 1)],
    ])  # fmt: skip
    start = np.array([(B - A) * more, more])
    expected = np.array([(expm(rates * t) @ start)[0] for t in after])
    steady = float(law().steady(jnp.asarray(SPEED * (1 + more))))
    np.testing.assert_allclose(found / NORMAL - steady, expected, rtol=0, atol=2e-4 * np.max(np.abs(expected)))
    assert np.max(np.abs(expected)) > 3e-8


@pytest.mark.slow
def test_critical_stiffness():
    """Where small disturbances neither grow nor decay, from the growth just below it and the decay just above."""
    after, growth = np.linspace(5.0, 400.0, 80), []
    for share in (0.98, 1.02):
        deviations = np.asarray(settled((SPEED, SPEED * 1.001), share * CRITICAL, after))
        growth.append(np.log(np.ptp(deviations[-20:]) / np.ptp(deviations[:20])))  # over more than a period each
    assert growth[0] > 0.1
    assert growth[1] < -0.1
    assert np.interp(0.0, growth[::-1], [1.02, 0.98]) == pytest.approx(1, abs=3e-3)


@pytest.mark.slow
def test_stiff_machine_measures_the_law():
    """Loops with a stiffer and stiffer machine: the error falls as its compliance."""
    after = jnp.linspace(0.5, 30.0, 60)
    times, velocity = [0.0, 1e-6, *after], [SPEED] + [3 * SPEED] * 61
    rigid = law().force(times, velocity, NORMAL, rtol=1e-10)[2:]
    errors = [
        float(jnp.max(jnp.abs(settled((SPEED, 3 * SPEED), k, after) - rigid))) / NORMAL for k in (3e13, 3e14)
    ]  # fmt: skip
    assert errors[0] < 1e-4
    assert errors[1] == pytest.approx(errors[0] / 10, rel=0.05)


def slopes_by_scipy(form, numbers, times, velocity, weights):
    """Of the weighted forces over the normal force, by the relative change of a, b, length and stiffness.

    By complex steps: scipy carries a change of 1e-30 of itself as an imaginary part, so that nothing is
    subtracted. Slips forward only, where ``|v| = v``.
    """

    def end(a, b, length, stiffness):
        def rates(t, state):
            slip = 2 * SPEED * np.sinh(stiffness * state[0] / NORMAL / a) * np.exp(-(MU + b * state[1]) / a)
            ratio = slip * np.exp(state[1]) / SPEED
            change = (1 - ratio) if form == "ageing" else -ratio * np.log(ratio)
            return np.array([np.interp(t, times, velocity) - slip, change * np.exp(-state[1]) * SPEED / length])

        state, total = np.array([NORMAL * MU / stiffness, 0.0], complex), 0.0
        for start, stop, weight in zip(times[:-1], times[1:], weights, strict=True):
            state = solve_ivp(rates, (start, stop), state, "DOP853", rtol=1e-12, atol=[1e-18, 1e-12]).y[:, -1]
            total += weight * stiffness * state[0] / NORMAL
        return total

    return [end(*(numbers * (1 + 1e-30j * row))).imag / 1e-30 for row in np.eye(4)]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["ageing", pytest.param("slip", marks=pytest.mark.slow)])
def test_derivatives(form):
    """Of forces about the peak by a, b, length and stiffness: both modes, against scipy's.

    A step is right to rtol. A force that is off by a share of it changes the speed by mu / a = 60 times as much, and so
    all slopes; some hundred steps add up: 100 x 60 x 1e-10 of the largest slope.
    """
    numbers = np.array([A, B, LENGTH, 1.8 * CRITICAL])
    times = np.array([0.0, 1.0, 1.5, 2.0, 3.0])
    velocity = np.array([1.0, 1.0, 10.0, 10.0, 10.0]) * 1e-6

    def force(factors, adjoint=None):
        a, b, length, stiffness = factors * numbers
        found = law(form, a, b, length).force(
            times, velocity, NORMAL, series_stiffness=stiffness, rtol=1e-10, max_steps=4096, adjoint=adjoint
        )
        return jnp.sum(found[2:] * jnp.array([1.0, 2.0, 3.0])) / NORMAL

    one = jnp.ones(4)
    backward = jax.grad(force)(one)
    expected = slopes_by_scipy(form, numbers, times, velocity, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(jax.jacfwd(lambda f: force(f, diffrax.ForwardMode()))(one), backward, rtol=1e-6)
    np.testing.assert_allclose(backward, expected, rtol=0, atol=6e-7 * np.max(np.abs(expected)))


def test_slip_velocity_is_the_inverse_of_the_coefficient():
    """Of either sign, and where the direct effect is so small that its exponential would overflow."""
    zero, z = jnp.zeros(()), jnp.asarray(-0.3)
    for a, velocity in itertools.product((0.01, 5e-4), (1e-9, -3e-6, 0.2)):
        coefficient = law(a=a).coefficient(z, jnp.asarray(velocity))
        np.testing.assert_allclose(law(a=a).slip_velocity(z, coefficient), velocity, rtol=1e-9)
    assert float(law().slip_velocity(zero, zero)) == 0
    slope = jax.grad(law().slip_velocity, argnums=1)(zero, zero)
    assert float(slope) == pytest.approx(2 * SPEED / A * np.exp(-MU / A), rel=1e-12)


@pytest.mark.slow
def test_under_jit_and_vmap():
    times = jnp.array([0.0, 5.0, 9.0, 9.5, 12.0])
    velocity = jnp.array([1.0, 1.0, 1.0, 10.0, 10.0]) * 1e-6
    stiffnesses = jnp.array([1.5, 2.0, 3.0]) * CRITICAL

    def force(stiffness):
        return law().force(times, velocity, NORMAL, series_stiffness=stiffness)

    together = jax.jit(jax.vmap(force))(stiffnesses)
    for stiffness, found in zip(stiffnesses, together, strict=True):
        np.testing.assert_allclose(found, force(stiffness), rtol=0, atol=1e-6 * NORMAL)


@pytest.mark.slow
def test_slip_that_accelerates_without_bound_is_told():
    times, velocity = [0.0, 0.1, 1e3], [SPEED, 3 * SPEED, 3 * SPEED]
    with pytest.raises(ValueError, match=r"may accelerate without bound .* give the slider a mass"):
        law().force(times, velocity, NORMAL, series_stiffness=0.3 * CRITICAL)
    traced = jax.jit(lambda k: law().force(times, velocity, NORMAL, series_stiffness=k))(0.3 * CRITICAL)
    assert np.isnan(traced[-1])


class Faster(ss.DieterichRuina):
    """With other friction than the inverse knows."""

    def coefficient(self, z, velocity):
        return super().coefficient(z, velocity) + 0.1 * velocity


@pytest.mark.slow
def test_a_subclass_of_other_friction_is_refused():
    with pytest.raises(ValueError, match="series_stiffness must be None for Faster"):
        Faster(MU, A, B, LENGTH, SPEED).force([0.0, 1.0], [SPEED] * 2, NORMAL, series_stiffness=1e9)


@pytest.mark.slow
@pytest.mark.parametrize("share", [*(pytest.param(share, marks=pytest.mark.slow) for share in (2.0, 10.0)), 200.0])
def test_single_precision(share):
    """To a thousandth of the normal force, at the default tolerance, from machines that are soft to stiff ones."""
    times = np.array([0.0, 10.0, 10.5, 11.0, 12.0, 15.0, 60.0])
    velocity = np.array([1.0, 1.0, 10.0, 10.0, 10.0, 10.0, 10.0]) * 1e-6
    expected = law().force(times, velocity, NORMAL, series_stiffness=share * CRITICAL)
    with jax.enable_x64(False):
        found = law().force(times, velocity, NORMAL, series_stiffness=share * CRITICAL)
        assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * NORMAL)
