"""The switched engine on systems whose answers are published or exact, and against the interval engine."""

import math
from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.event_driven import den_hartog_amplitude
from support.interval import filled, padded, random_set_up
from support.switched import Case, Steps, Tones, coulomb, crossings_of, errors_against, weakening

import stickslip_jax as ss

# Leine et al. 1998: m = k = F_s = 1, belt 0.2, friction F_s / (1 + 3 |v_rel|). The start that is often given,
# (1.133944669704, 0), is off by 7e-9; this point of the orbit is good to 1e-11.
LEINE = Case(1.0, 1.0, 1.0, weakening(1.0, 3.0), Steps((1000.0,), (0.2,)), 60.0, (1.13394467644, 0.0))
LEINE_SLIP, LEINE_STICK, LEINE_PERIOD = 4.29599952548, 7.70503176935, 12.00103129483
# DISODE45's example: x'' = -x - 0.4 x' + cos 0.7 t - 0.4 sgn(x' - v), v = cos t + 0.7.
FORCED = Case(
    1.0, 1.0, 1.0, coulomb(0.4), Tones((1.0,), (1.0,), (0.0,), 0.7), 30.0, (3.0, 0.0), 0.4,
    Tones((1.0,), (0.7,), (0.0,)),
)  # fmt: skip
FREE = Case(1.0, 1.0, 1.0, coulomb(0.4), Steps((1000.0,), (0.0,)), 20.0, (3.0, 0.0))


@pytest.mark.slow
def test_leine_orbit():
    """A solver flow (order 8): events and states to 1e-9."""
    sticks = filled(LEINE.follow(step=None).simulation)
    assert len(sticks.start) == 5
    np.testing.assert_allclose(sticks.duration[:4], LEINE_STICK, atol=1e-9)
    np.testing.assert_allclose(sticks.start[1:] - sticks.end[:-1], LEINE_SLIP, atol=1e-9)
    np.testing.assert_allclose(np.diff(sticks.start), LEINE_PERIOD, atol=1e-9)
    np.testing.assert_allclose(sticks.position, -0.54100635387, atol=1e-9)
    end, velocity = LEINE.follow(step=None).simulation.evaluate(sticks.end[:4])
    np.testing.assert_allclose(end, 1, atol=1e-9)
    np.testing.assert_allclose(velocity, 0.2, atol=1e-9)
    periods = LEINE_PERIOD * np.arange(5)
    np.testing.assert_allclose(LEINE.follow(step=None).simulation.evaluate(periods)[0], LEINE.y0[0], atol=1e-9)


@pytest.mark.slow
def test_forced_mass_on_a_moving_base():
    followed = FORCED.follow()
    sticks = filled(followed.simulation)
    np.testing.assert_allclose(sticks.start, [9.4833785788648, 26.1316818246495], rtol=1e-12)
    np.testing.assert_allclose(sticks.end, [9.7652587544591, 27.2911568934767], rtol=1e-12)
    crossings, _ = crossings_of(FORCED, followed)
    np.testing.assert_allclose(crossings, [7.6055699647458, 14.8051056890853, 17.4589396439145], rtol=1e-12)
    np.testing.assert_allclose(followed.simulation.final_state, [0.190596631593, -1.135390730860], atol=2e-12)
    assert int(followed.simulation.slips.count) == 3


@pytest.mark.slow
def test_free_oscillation_comes_to_rest():
    """Turns at n pi with x = -2.2, 1.4, -0.6 (exact), rests at -0.2 from 4 pi on."""
    followed = FREE.follow(step=0.3)
    crossings, places = crossings_of(FREE, followed)
    np.testing.assert_allclose(crossings, np.pi * np.arange(1, 4), rtol=1e-14)
    np.testing.assert_allclose(places, [-2.2, 1.4, -0.6], rtol=1e-14)
    sticks = filled(followed.simulation)
    np.testing.assert_allclose(sticks.start, [4 * np.pi], rtol=1e-14)
    np.testing.assert_allclose(sticks.position, [-0.2], rtol=1e-13)
    assert [ss.Ending(code) for code in sticks.ending] == [ss.Ending.HORIZON]


@pytest.mark.slow
@pytest.mark.parametrize(("b", "ratio"), [(0.8, 0.2), (0.8, 0.5), (1.5, 0.3), (2.0, 0.2)])
def test_den_hartog_amplitude(b, ratio):
    """Started on the steady no-stop motion, which is known: it stays there, and never sticks.

    At a turning point (x0, 0) the force is ``P cos(b t + phi)``; from Den Hartog 1931, where
    ``x0 k / P = sqrt(V^2 - (U F/P)^2)``, ``cos phi = x0 / (P V)`` and ``sin phi = -F U / (P V)``, with m = k = 1.
    """
    amplitude = den_hartog_amplitude(b, ratio)
    v = 1 / (1 - b * b)
    u = math.sin(math.pi / b) / (b * (1 + math.cos(math.pi / b)))
    phase = math.atan2(-ratio * u / v, amplitude / v)
    case = Case(
        1.0, 1.0, 1.0, coulomb(ratio), Steps((1000.0,), (0.0,)), 16 * math.pi / b, (amplitude, 0.0), None,
        Tones((1.0,), (b,), (phase,)),
    )  # fmt: skip
    followed = case.follow()
    turns, places = crossings_of(case, followed)
    assert int(followed.simulation.sticks.count) == 0
    np.testing.assert_allclose(turns, math.pi / b * np.arange(1, len(turns) + 1), rtol=1e-9)
    np.testing.assert_allclose(np.abs(places), amplitude, rtol=1e-9)
    assert len(turns) in (15, 16)


@pytest.mark.slow
@pytest.mark.parametrize("case", [LEINE, FORCED, FREE], ids=["Leine", "forced", "free"])
def test_the_reference_agrees(case):
    errors = errors_against(case.reference(), case, case.follow(step=0.1))
    assert max(errors) < (1e-9 if case is LEINE else 1e-11), errors


@pytest.mark.slow
@pytest.mark.parametrize("levels", [(-1.0, 1.0), (-1.0, 0.0, 0.5, 1.0)], ids=["two levels", "four levels"])
@pytest.mark.parametrize("w", [0.2, 1.0, 4.0])
def test_both_engines_agree(w, levels):
    """Bang-bang bases in time steps and in closed form: same sticks and endings, 1e-9 in everything."""
    compared = 0
    for seed in range(5):
        setup = random_set_up(w, 0.4, levels, 20, [seed, 31]).merged()
        base = padded(setup.durations, setup.velocities, 20)
        case = Case(setup.mass, setup.stiffness, setup.normal_force, coulomb(setup.mu), Steps((), ()), setup.t1, ())
        exact = ss.simulate(setup.system, base, t1=setup.t1, y0=(setup.position0, setup.velocity0))
        stepped = ss.simulate(
            setup.system, base, t1=setup.t1, y0=(setup.position0, setup.velocity0),
            method=ss.Exact(step=0.3 / case.omega, max_steps=1500),
        )  # fmt: skip
        assert int(stepped.status) == ss.Status.FINISHED
        a, b = filled(exact), filled(stepped)
        np.testing.assert_array_equal(a.ending, b.ending)
        clock = max(setup.t1, 1 / case.omega)
        np.testing.assert_allclose(b.start, a.start, rtol=0, atol=1e-9 * clock)
        np.testing.assert_allclose(b.end, a.end, rtol=0, atol=1e-9 * clock)
        np.testing.assert_allclose(b.position, a.position, rtol=0, atol=1e-9 * case.half_width)
        np.testing.assert_allclose(stepped.final_state, exact.final_state, rtol=1e-9, atol=1e-9 * case.half_width)
        assert float(stepped.stick_time) == pytest.approx(float(exact.stick_time), abs=1e-9 * clock)
        assert int(stepped.slips.count) == int(exact.slips.count)
        compared += len(a.start)
    assert compared > 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "order"),
    [
        (diffrax.Heun(), 2),
        pytest.param(diffrax.Bosh3(), 3, marks=pytest.mark.slow),
        pytest.param(diffrax.Dopri5(), 5, marks=pytest.mark.slow),
    ],
)
def test_convergence_in_the_step(solver, order):
    """Velocity-weakening friction: event times and end states converge with the solver's order (least squares)."""
    steps, starts = np.array([0.2, 0.14, 0.1, 0.07]), np.linspace(1.0, 1.2, 8)
    case = LEINE._replace(t1=14.0)

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    @partial(jax.vmap, in_axes=(None, 0))
    def run(step, x):
        method = ss.Exact(step=step, max_steps=640, solver=solver)
        one = ss.simulate(case.system, case.base.package, t1=case.t1, y0=(x, 0.0), method=method)
        return one.sticks.start[0], jnp.stack(one.final_state)

    times, states = (np.asarray(values) for values in run(steps, starts))
    runs = [case._replace(y0=(float(x), 0.0)).reference() for x in starts]
    # Of all starts together: the error of a single event may pass through zero as the step changes.
    for errors in (
        np.linalg.norm(times - [run.sticks[0].start for run in runs], axis=1),
        np.linalg.norm(states - [run.final_state for run in runs], axis=(1, 2)),
    ):
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert order - 0.5 < slope < order + 1, (slope, errors)
