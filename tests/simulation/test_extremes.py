"""Extremes of the state over time: exact, not on a grid, and differentiable."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))  # half-width 0.25 m
T1 = 20.0


def at_rest(mu=1.0, x0=0.0, v0=2.0):
    """A mass that slides on a base at rest until it stops, from ``(x0, v0)``."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
    return ss.simulate(system, ss.Constant(0.0), t1=T1, y0=(x0, v0))


@pytest.mark.slow
def test_free_vibration_in_closed_form():
    """From x = 0 at v the first circle has the centre -a; each half turn brings the mass 2 a closer (a = mu n / k)."""
    a, top = 0.25, -0.25 + math.hypot(0.25, 2.0 / 2)
    one = at_rest()
    assert float(one.maximum("position")) == pytest.approx(top, abs=1e-15)
    assert float(one.minimum("position")) == pytest.approx(-(top - 2 * a), abs=1e-14)
    assert float(one.maximum("velocity")) == 2.0
    assert float(one.minimum("velocity")) == pytest.approx(-2 * (top - a), abs=1e-14)
    assert float(one.peak()) == float(one.maximum("position"))
    assert float(one.peak("velocity")) == 2.0


@pytest.mark.slow
def test_belt_in_closed_form():
    """The slip after a release is a circle about +a with the radius speed / omega."""
    one = ss.simulate(SYSTEM, ss.Constant(1.0), t1=T1, y0=(0.0, 1.0))
    assert float(one.maximum()) == pytest.approx(0.25 + 0.5, abs=1e-14)
    assert float(one.minimum()) == pytest.approx(0.25 - 0.5, abs=1e-14)
    mirrored = ss.simulate(SYSTEM, ss.Constant(-1.0), t1=T1, y0=(0.0, -1.0))
    assert float(mirrored.minimum()) == -float(one.maximum())


@pytest.mark.slow
def test_derivatives_in_closed_form():
    """Of ``-a + hypot(a, v / omega)``: by mu through a = mu / 4, and by v."""
    by_mu, by_v = jax.grad(lambda mu, v: at_rest(mu, 0.0, v).maximum(), (0, 1))(1.0, 2.0)
    radius = math.hypot(0.25, 1.0)
    assert float(by_mu) == pytest.approx((-1 + 0.25 / radius) / 4, rel=1e-12)
    assert float(by_v) == pytest.approx(1.0 / radius / 2, rel=1e-12)
    second = jax.jvp(lambda mu: at_rest(mu).minimum(), (1.0,), (1.0,))[1]  # -(top - 2 a)
    assert float(second) == pytest.approx(-((-1 + 0.25 / radius) / 4 - 0.5), rel=1e-12)


CASES = {
    "closed form": (SYSTEM, ss.PoissonSwitching(speed=1.0, rate=1.0), ss.Exact()),
    "fast base": (SYSTEM, ss.PoissonSwitching(speed=0.2, rate=0.4), ss.Exact()),
    "in steps": (SYSTEM, ss.PoissonSwitching(speed=1.0, rate=1.0), ss.Exact(step=0.1)),
    "damped": (ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0), damping=0.2), ss.Harmonic(1.0, 1.3), ss.Exact()),
    "static friction": (
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5, mu_static=0.7)), ss.Harmonic(1.0, 1.3), ss.Exact()
    ),
    "regularised": (SYSTEM, ss.Harmonic(1.0, 1.3), ss.Regularized(width=1e-2)),
}  # fmt: skip


SLOWER = ("fast base", "in steps", "static friction")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOWER else name for name in CASES]
)
def test_nothing_on_a_fine_grid_exceeds_it(name):
    """A grid misses at most ``max |x''| dt^2 / 8`` of a smooth maximum, ``max |x'''| dt^2 / 8`` of one of the velocity;
    the corners of the velocity, at events and jumps of the load, it misses by ``max |x''| dt / 2``.
    """
    system, law, method = CASES[name]
    base = law.sample(jax.random.key(3), t1=T1) if hasattr(law, "sample") else law
    one = ss.simulate(system, base, t1=T1, y0=(0.4, 2.5), method=method)
    times, dt = np.linspace(0.0, T1, 20_001, retstep=True)
    for number, coordinate in enumerate(("position", "velocity")):
        values = np.asarray(one.evaluate(times)[number])
        acceleration = 4 * 3.0 + 1.0 + 0.2 * 4.0  # |x| < 3 m
        missed = acceleration * dt**2 / 8 if number == 0 else acceleration * dt / 2
        for found, sign in ((one.maximum(coordinate), 1), (-one.minimum(coordinate), -1)):
            on_grid = (sign * values).max()
            assert on_grid - 1e-12 <= float(found) <= on_grid + missed, (coordinate, sign)


@pytest.mark.slow
def test_against_an_independent_integration():
    """Slip only, forced and damped: scipy locates the zeros of the velocity."""
    system = ss.MassSpring(1.0, 4.0, 0.1, ss.Coulomb(0.1), damping=0.2, force=ss.Harmonic(3.0, 1.7))

    def rates(t, y):
        return [y[1], 3.0 * math.cos(1.7 * t) - 4.0 * y[0] - 0.2 * y[1] - 0.01 * np.sign(y[1])]

    def turns(t, y):
        return y[1]

    turns.terminal = True
    t, y, tops = 0.0, [0.0, 0.5], [0.0]
    while t < T1:
        found = solve_ivp(rates, (t, T1), y, events=turns, rtol=1e-12, atol=1e-13, method="DOP853")
        t, y = found.t[-1], [found.y[0, -1], 0.0]
        tops.append(y[0])
        if t < T1:  # a moment later, with the velocity that the force gives
            push = 3.0 * math.cos(1.7 * t) - 4.0 * y[0]
            acceleration = push - 0.01 * np.sign(push)
            t, y = t + 1e-7, [y[0] + 0.5e-14 * acceleration, 1e-7 * acceleration]
    one = ss.simulate(system, ss.Constant(0.0), t1=T1, y0=(0.0, 0.5))
    assert float(one.maximum()) == pytest.approx(max(tops), rel=1e-6)
    assert float(one.minimum()) == pytest.approx(min(tops), rel=1e-6)


OTHERS = [(coordinate, name) for coordinate in ("position", "velocity") for name in ("closed form", "static friction")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coordinate", "name"),
    [
        ("velocity", "damped"),
        *(pytest.param(*other, marks=pytest.mark.slow) for other in [("position", "damped"), *OTHERS]),
    ],
)
def test_derivatives_are_slopes(coordinate, name):
    system, law, method = CASES[name]
    base = law.sample(jax.random.key(3), t1=T1) if hasattr(law, "sample") else law

    @jax.jit
    def peak(v):
        return ss.simulate(system, base, t1=T1, y0=(0.4, v), method=method).minimum(coordinate)

    slope = float(peak(2.5 + 1e-5) - peak(2.5 - 1e-5)) / 2e-5
    assert float(jax.jvp(peak, (2.5,), (1.0,))[1]) == pytest.approx(slope, abs=1e-6)
    assert float(jax.grad(peak)(2.5)) == pytest.approx(slope, abs=1e-6)


@pytest.mark.slow
def test_batches():
    bases = jax.vmap(lambda key: CASES["closed form"][1].sample(key, t1=T1))(jax.random.split(jax.random.key(0), 4))
    many = jax.vmap(lambda base: ss.simulate(SYSTEM, base, t1=T1, y0=(0.4, 2.5)))(bases)
    together = jax.vmap(lambda one: one.peak())(many)
    first = ss.simulate(SYSTEM, jax.tree.map(lambda leaf: leaf[0], bases), t1=T1, y0=(0.4, 2.5))
    assert float(together[0]) == pytest.approx(float(first.peak()), rel=1e-12)
    with pytest.raises(ValueError, match=r"batch of \(4,\) simulations"):
        many.peak()


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_coordinates():
    for wrong in ("x", 0):
        with pytest.raises(ValueError, match="Argument coordinate must be one of 'position', 'velocity'"):
            at_rest().maximum(wrong)


@pytest.mark.slow
def test_motor_and_cart():
    cart = ss.simulate(ss.MotorCart(mu=0.5), ss.SourceVoltage(), t1=0.5)
    times = np.linspace(0.0, 0.5, 1001)
    for name, values in zip(("angle", "angular velocity", "current"), cart.evaluate(times), strict=True):
        on_grid = float(values.max())
        assert on_grid - 1e-9 <= float(cart.maximum(name)) <= on_grid + 1e-2 * abs(on_grid), name


def test_precision_is_that_of_the_motion():
    """In single precision beside double precision, as of a base whose numbers are of 32 bits."""
    base = ss.Harmonic(jnp.float32(1.0), jnp.float32(0.7))
    one = ss.simulate(SYSTEM, base, t1=5.0, y0=(0.0, 1.0))
    assert one.maximum().dtype == one.final_state[0].dtype == jnp.float32
    times = np.linspace(0, 5, 5001)
    assert float(one.maximum()) == pytest.approx(float(np.max(one.evaluate(times)[0])), abs=1e-5)
