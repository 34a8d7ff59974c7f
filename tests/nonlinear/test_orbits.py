"""Periodic orbits: against published ones, closed forms, long simulations and differences."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.event_driven import den_hartog_amplitude
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from support.turning import DRAG, FAR, Disc

import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax._numerics.matrices import orthogonal_factors, solution
from stickslip_jax.nonlinear._cases import without_turns
from stickslip_jax.nonlinear._orbits import multipliers_of

LEINE = ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(mu_static=1.0, weakening=3.0))
BELT = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.5, mu_static=1.0, stribeck_speed=0.5), damping=0.1)
"""The case of bSTAB and pyBasin (docs/validation.md)."""


@pytest.fixture(scope="module")
def leine():
    return nonlinear.periodic_orbit(LEINE, ss.Constant(0.2), y0=(1.0, 0.2))


@pytest.mark.slow
def test_stick_slip_orbit_of_leine(leine):
    assert bool(leine.converged)
    assert float(leine.period) == pytest.approx(12.001031294829, abs=1e-11)
    np.testing.assert_allclose(leine.multipliers, [1, 0], atol=1e-8)
    assert leine.multipliers[1] == 0  # exactly: the stick forgets
    assert leine.is_stable
    slip, stick = leine.modes
    assert (slip.signs, stick.signs) == ((-1,), (0,))
    assert slip.end - slip.start == pytest.approx(4.295999525479, abs=1e-11)
    assert stick.end - stick.start == pytest.approx(7.705031769350, abs=1e-11)
    np.testing.assert_allclose(leine.simulation.final_state, leine.state, atol=1e-12)


@pytest.mark.slow
def test_motion_without_stops_of_den_hartog():
    b, ratio = 0.8, 0.5
    system = ss.MassSpring(1.0, 1.0, ratio, ss.Coulomb(1.0), force=ss.Harmonic(1.0, b))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.0, 0.2))
    assert bool(orbit.converged)
    assert orbit.is_driven
    assert float(orbit.simulation.maximum()) == pytest.approx(den_hartog_amplitude(b, ratio), abs=1e-9)
    assert float(orbit.period) == pytest.approx(2 * math.pi / b)


def test_convergence_is_quadratic():
    system = ss.MassSpring(1.0, 1.0, 0.5, ss.Coulomb(1.0), force=ss.Harmonic(1.0, 0.8))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.9, 1.2))
    residuals = np.asarray(orbit.residuals)
    residuals = residuals[(residuals > 1e-14) & (residuals < 0.1)]
    assert len(residuals) >= 3
    orders = np.log(residuals[1:]) / np.log(residuals[:-1])
    assert np.all(orders > 1.6), residuals


@pytest.mark.slow
def test_same_as_after_many_periods():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.4, mu_static=0.6, stribeck_speed=0.5), damping=0.05)
    base = ss.Harmonic(0.8, 0.6)
    section = nonlinear.stroboscopic_section(system, base, y0=(0.3, 0.1), transient=10_000, kept=2, progress=False)
    assert int(section.recurrence) == 1
    orbit = nonlinear.periodic_orbit(system, base, y0=(float(section.position[0]) + 0.02, float(section.velocity[0])))
    assert bool(orbit.converged)
    np.testing.assert_allclose(orbit.state, [section.position[-1], section.velocity[-1]], atol=1e-10)


def _unstable_cycle() -> tuple[float, float]:
    """The rightmost position of the slip cycle that divides the starts on a belt of 1.5 m/s, and its period (scipy)."""

    def slip(_, y):
        return y[1], 0.5 + 0.5 * math.exp((y[1] - 1.5) / 0.5) - y[0] - 0.1 * y[1]

    def once_round(x):
        def turns(_, y):
            return y[1]

        turns.direction, turns.terminal = -1, True
        start = solve_ivp(slip, (0, 1e-3), (x, 0.0), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        done = solve_ivp(slip, (0, 20), start, "DOP853", rtol=1e-12, atol=1e-13, events=turns)
        return done.y[0, -1] - x, done.t[-1] + 1e-3

    right = brentq(lambda x: once_round(x)[0], 1.2, 1.98, xtol=1e-13)
    return right, once_round(right)[1]


@pytest.mark.slow
def test_unstable_orbit_is_found():
    right, period = _unstable_cycle()
    orbit = nonlinear.periodic_orbit(BELT, ss.Constant(1.5), y0=(right + 0.02, -0.1), period=6.3)
    assert bool(orbit.converged)
    assert not orbit.is_stable
    assert float(orbit.period) == pytest.approx(period, abs=1e-9)
    assert float(orbit.simulation.maximum()) == pytest.approx(right, abs=1e-9)
    assert [mode.signs for mode in orbit.modes] == [(-1,)]
    # Where nothing sticks, the product of the multipliers is that of the change of areas (Liouville).
    times = np.linspace(0, float(orbit.period), 20_001)
    velocity = np.asarray(orbit.simulation.evaluate(times)[1])
    divergence = np.trapezoid(np.exp((velocity - 1.5) / 0.5) - 0.1, times)
    assert np.prod(orbit.multipliers).real == pytest.approx(math.exp(divergence), rel=1e-7)


@pytest.mark.slow
def test_multipliers_of_a_square_wave_against_differences():
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9)), ss.SquareWave(1.0, 5.6)
    section = nonlinear.stroboscopic_section(system, law, y0=(0.3, -0.2), transient=300, kept=2, progress=False)
    state = np.array([float(section.position[-1]), float(section.velocity[-1])])
    orbit = nonlinear.periodic_orbit(system, law, y0=state)
    assert bool(orbit.converged)
    base = law.sample(None, 5.6)
    simulate = jax.jit(lambda y: jnp.stack(ss.simulate(system, base, t1=5.6, y0=(y[0], y[1])).final_state))
    size = 1e-3
    columns = [
        (simulate(orbit.state + size * unit) - simulate(orbit.state - size * unit)) / (2 * size) for unit in np.eye(2)
    ]
    np.testing.assert_allclose(orbit.monodromy, np.stack(columns, axis=1), atol=1e-4)
    np.testing.assert_allclose(
        np.sort(np.abs(orbit.multipliers)), np.sort(np.abs(np.linalg.eigvals(np.stack(columns, axis=1)))), atol=1e-3
    )


@pytest.mark.slow
def test_orbit_of_several_contacts():
    system = ss.LinearStructure(
        np.ones(2), np.array([[2.2, -1.2], [-1.2, 2.2]]), np.array([[0.3, -0.1], [-0.1, 0.3]]),
        contacts=tuple(ss.Contact.of_mass(i, 2, force, ss.Coulomb(0.5)) for i, force in enumerate((1.0, 1.3))),
    )  # fmt: skip
    base = ss.Harmonic(1.0, 0.4)
    section = nonlinear.stroboscopic_section(system, base, transient=200, kept=4, progress=False)
    assert int(section.recurrence) == 1
    state = [float(section[coordinate.name.replace(" ", "_")][-1]) for coordinate in system.coordinates]
    orbit = nonlinear.periodic_orbit(system, base, y0=state)
    assert bool(orbit.converged)
    np.testing.assert_allclose(orbit.simulation.final_state, orbit.state, atol=1e-10)
    assert all(len(mode.signs) == 2 for mode in orbit.modes)
    assert np.sum(orbit.multipliers == 0) >= 1


def test_whole_turns_of_angles_do_not_count():
    change = without_turns(ss.MotorCart(), jnp.array([4 * jnp.pi + 0.01, 7.0, -9.0]))
    np.testing.assert_allclose(change, [0.01, 7.0, -9.0], atol=1e-14)
    back = jax.jacfwd(lambda change: without_turns(ss.MotorCart(), change))(jnp.array([6.0, 7.0, -9.0]))
    np.testing.assert_array_equal(back, np.eye(3))


@pytest.mark.slow
def test_orbit_of_a_disc_that_turns():
    """It closes after one turn, and a change of its rate decays as the drag has it."""
    orbit = nonlinear.periodic_orbit(Disc(3.0), FAR, y0=(0.5, 1.4), period=4.0)
    assert bool(orbit.converged)
    assert float(orbit.period) == pytest.approx(2 * math.pi / 1.5, rel=1e-12)
    np.testing.assert_allclose(orbit.multipliers, [1, math.exp(-DRAG * 2 * math.pi / 1.5)], atol=1e-11)


METHOD = ss.Exact(max_steps=1024)


@pytest.mark.slow
def test_derivative_of_a_period():
    @jax.jit
    def period(speed):
        return nonlinear.periodic_orbit(LEINE, ss.Constant(speed), y0=(1.0, 0.2), period=12.0, method=METHOD).period

    difference = (period(0.2001) - period(0.1999)) / 2e-4
    assert float(jax.jit(jax.jacfwd(period))(0.2)) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.slow
def test_derivatives_of_an_orbit():
    def period(speed):
        return nonlinear.periodic_orbit(LEINE, ss.Constant(speed), y0=(1.0, 0.2), period=12.0, method=METHOD).period

    difference = (period(0.2001) - period(0.1999)) / 2e-4
    assert float(jax.grad(period)(0.2)) == pytest.approx(float(difference), rel=1e-5)

    def trace(amplitude):
        system = ss.MassSpring(1.0, 1.0, 0.5, ss.Coulomb(1.0), force=ss.Harmonic(amplitude, 0.8))
        orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.8, 1.2), method=METHOD)
        return jnp.trace(orbit.monodromy)

    difference = (trace(1.001) - trace(0.999)) / 2e-3
    assert float(jax.jacfwd(trace)(1.0)) == pytest.approx(float(difference), rel=1e-4)
    many = jax.vmap(trace)(jnp.array([0.999, 1.001]))
    np.testing.assert_allclose(many, [trace(0.999), trace(1.001)], rtol=1e-9)


@pytest.mark.slow
def test_search_that_fails_is_told():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5), damping=0.1)
    orbit = nonlinear.periodic_orbit(system, ss.Harmonic(0.8, 1.3), y0=(40.0, 3.0), iterations=1)
    assert not bool(orbit.converged)
    with pytest.raises(ValueError, match="Argument period must be given: a guess of the orbit's period"):
        nonlinear.periodic_orbit(system, ss.Constant(1.0), y0=(0.1, 0.2))  # it comes to rest


@pytest.mark.slow
@pytest.mark.parametrize("period", [*(pytest.param(period, marks=pytest.mark.slow) for period in (3.0, 25.0)), 0.02])
def test_a_bad_guess_of_the_period_gives_the_orbit_or_none(period):
    found = nonlinear.periodic_orbit(LEINE, ss.Constant(0.2), y0=(1.0, 0.2), period=period)
    turns = float(found.period) / 12.001031294829
    assert not bool(found.converged) or (turns > 0.5 and abs(turns - round(turns)) < 1e-9)


@pytest.mark.slow
def test_a_step_to_a_negative_period_is_shortened():
    """After no time the motion is where it began, which is no orbit: Newton's method goes back to times that are."""
    found = nonlinear.periodic_orbit(LEINE, ss.Constant(0.2), y0=(1.3, -0.1), period=18.0)
    assert bool(found.converged)
    assert float(found.period) == pytest.approx(12.001031294829, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("period", [2.0, pytest.param(6.3, marks=pytest.mark.slow), None])
def test_an_equilibrium_is_no_orbit(period):
    # It comes back after any time, the unstable steady slip of the belt too.
    level = 1 / (1 + 3 * 0.2)
    given = {"y0": (level, 0.0)} | ({} if period is None else {"period": period})
    if period is None:
        with pytest.raises(ValueError, match="period"):
            nonlinear.periodic_orbit(LEINE, ss.Constant(0.2), **given)
        return
    found = nonlinear.periodic_orbit(LEINE, ss.Constant(0.2), **given)
    assert float(found.residuals[0]) < 1e-12  # it does come back
    assert not bool(found.converged)


@pytest.mark.slow
def test_an_orbit_that_takes_too_many_steps_is_not_taken_for_one():
    found = nonlinear.periodic_orbit(LEINE, ss.Constant(0.2), y0=(1.0, 0.2), period=12.0, method=ss.Exact(max_steps=20))
    assert not bool(found.converged)


@pytest.mark.slow
def test_a_part_of_the_period_of_the_drive_is_not_taken_for_all_of_it():
    """The motion until the steps run out has a fixed point too."""
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.2), damping=5.0, force=ss.Harmonic(1.0, 0.7))
    found = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(0.1, 0.05), method=ss.Exact(max_steps=2))
    assert not bool(found.converged)


@pytest.mark.slow
def test_mirrored_orbits():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.2, mu_static=0.4, stribeck_speed=0.5), damping=0.05)
    orbit = nonlinear.periodic_orbit(system, ss.Harmonic(0.8, 1.3), y0=(0.3, 0.1))
    mirrored = nonlinear.periodic_orbit(system, ss.Harmonic(-0.8, 1.3), y0=(-0.3, -0.1))
    assert bool(orbit.converged)
    np.testing.assert_allclose(mirrored.state, -orbit.state, atol=1e-12)
    np.testing.assert_allclose(mirrored.monodromy, orbit.monodromy, atol=1e-12)


@pytest.mark.slow
def test_overdamped_orbit_without_friction():
    # m x'' + c x' + k x = cos(w t): state and multipliers in closed form.
    m, c, k, w = 1.0, 5.0, 1.0, 0.7
    system = ss.MassSpring(m, k, 1.0, ss.Coulomb(0.0), damping=c, force=ss.Harmonic(1.0, w))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(0.0, 0.0))
    answer = 1 / (k - m * w * w + 1j * c * w)
    np.testing.assert_allclose(orbit.state, [answer.real, (1j * w * answer).real], rtol=1e-12)
    roots = np.roots([m, c, k])
    np.testing.assert_allclose(np.sort(orbit.multipliers.real), np.sort(np.exp(roots * 2 * np.pi / w)), atol=1e-13)


def test_subclass_of_a_base_must_tell_its_period():
    class Louder(ss.Harmonic):
        def value(self, t):
            return 2 * super().value(t)

    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.2))
    with pytest.raises(ValueError, match=r"Argument period must be given .* Louder"):
        nonlinear.periodic_orbit(system, Louder(1.0, 0.7), y0=(0.0, 0.0))


BAD = {
    "random": ({"base": ss.PoissonSwitching(1.0, 1.0)}, "Argument base must repeat itself"),
    "half a period": ({"period": 1.0}, "Argument period must be a whole number of periods"),
    "periods": ({"periods": 0}, "Argument periods must be"),
    "tolerance": ({"tolerance": -1.0}, "Argument tolerance must be positive"),
    "start": ({"y0": (0.0,)}, "Argument y0 must"),
    "method": ({"method": ss.Regularized(0.1)}, "Argument method must be Exact"),
    "system": ({"system": 3}, "Argument system must be"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input_is_told_in_a_sentence(name):
    given, said = BAD[name]
    with pytest.raises(ValueError, match=said):
        nonlinear.periodic_orbit(**({"system": LEINE, "base": ss.Harmonic(1.0, 1.0), "y0": (0.0, 0.0)} | given))


def test_zero_multipliers_are_exact():
    rng = np.random.default_rng(3)
    base = rng.normal(size=(5, 5))
    chain = np.diag([2.0, 0.5, 0, 0, 0]) + np.diag([0, 0, 1.0, 1.0], 1)  # zeros that are not simple
    found = multipliers_of(base @ chain @ np.linalg.inv(base))
    np.testing.assert_allclose(found[:2], [2.0, 0.5], rtol=1e-12)
    np.testing.assert_array_equal(found[2:], 0)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_orthogonal_factors(dtype):
    rng = np.random.default_rng(1)
    matrix = jnp.asarray(rng.normal(size=(6, 6)), dtype).at[:, 3].set(0)
    matrix = matrix.at[:, 4].set(2 * matrix[:, 1])  # rank 4
    q, r = orthogonal_factors(matrix)
    eps = float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(q @ r, matrix, atol=50 * eps)
    np.testing.assert_allclose(q.T @ q, np.eye(6), atol=50 * eps)
    assert np.all(np.abs(np.tril(r, -1)) == 0)
    regular = jnp.asarray(rng.normal(size=(6, 6)), dtype)
    target = jnp.asarray(rng.normal(size=6), dtype)
    np.testing.assert_allclose(regular @ solution(regular, target), target, atol=1e3 * eps)
