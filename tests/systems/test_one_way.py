"""Contacts that slip in one direction alone: a freewheel in closed form, a train that may not slip backward."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

STILL = ss.Constant(0.0)
INERTIA, DRIVE, BRAKE, LOAD, STOPS, AGAIN, T1 = (0.3, 1.7), 5.0, -2.0, -0.8, 1.0, 2.5, 6.0


def freewheel(load, capacity=1000.0, method=ss.Exact(max_steps=512)):  # noqa: B008
    """When the hub frees and locks, and the state at T1: the motor drives until STOPS, brakes, drives from AGAIN on."""
    hub = ss.FrictionDisk(2.0, ss.OneWay(capacity=capacity), radius=0.5)
    motor = ss.ForceSteps([0.0, STOPS, AGAIN], [DRIVE, BRAKE, DRIVE])
    train = ss.drivetrain(INERTIA, clutches=[hub], torque=(motor, load))
    one = ss.simulate(train, STILL, t1=T1, method=method)
    return jnp.array([one.sticks.end[0], one.sticks.start[1], *one.final_state])


def freewheel_in_closed_form(load):
    """Locked, free, locked: speeds are linear in time, in each part; both turn equally far while locked."""
    both = sum(INERTIA)
    rate, slows, driven, coasts = (DRIVE + load) / both, BRAKE / INERTIA[0], DRIVE / INERTIA[0], load / INERTIA[1]
    speed, angle = rate * STOPS, rate * STOPS**2 / 2
    brakes = AGAIN - STOPS
    motor = speed + slows * brakes
    # From AGAIN on the motor gains what the wheel is faster.
    gap = speed + coasts * brakes - motor
    catches = gap / (driven - coasts)
    wheel = speed + coasts * (brakes + catches)
    turned = angle + speed * (brakes + catches) + coasts * (brakes + catches) ** 2 / 2
    turned_motor = angle + speed * brakes + slows * brakes**2 / 2 + motor * catches + driven * catches**2 / 2
    rest = T1 - AGAIN - catches
    further = wheel * rest + rate * rest**2 / 2
    last = wheel + rate * rest
    return jnp.array([STOPS, AGAIN + catches, turned_motor + further, turned + further, last, last])


@pytest.mark.parametrize("capacity", [40.0, 1000.0, 1e5])
def test_a_freewheel_in_closed_form(capacity):
    np.testing.assert_allclose(freewheel(LOAD, capacity), freewheel_in_closed_form(LOAD), rtol=1e-11, atol=1e-11)


@pytest.mark.slow
def test_derivatives_of_a_freewheel():
    """First ones in both modes, and second ones, of the instant at which it locks and of the motion after it."""
    expected = jax.jacfwd(freewheel_in_closed_form)(LOAD)
    np.testing.assert_allclose(jax.jacfwd(freewheel)(LOAD), expected, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(jax.jacrev(freewheel)(LOAD), expected, rtol=1e-9, atol=1e-10)
    loads = jnp.array([-0.2, -0.8, -1.5])
    found = jax.jit(jax.vmap(freewheel))(loads)
    np.testing.assert_allclose(found, jax.vmap(freewheel_in_closed_form)(loads), rtol=1e-11, atol=1e-11)
    second = jax.jacfwd(jax.jacfwd(freewheel_in_closed_form))(LOAD)
    np.testing.assert_allclose(jax.jacfwd(jax.jacfwd(freewheel))(LOAD), second, rtol=1e-7, atol=1e-8)


BETWEEN, TO_GROUND, SPEED, END = 3.0, 0.7, 0.06, 30.0


def train_by_scipy(starts, kinetic, static):
    """Events (block, time, whether it sticks from there on) and the end, with blocks that cannot slip backward at all:
    what sticks is held against any force that pushes it back.
    """
    blocks = len(starts)
    stiffness = TO_GROUND * np.eye(blocks)
    for i in range(blocks - 1):
        stiffness[i : i + 2, i : i + 2] += BETWEEN * np.array([[1, -1], [-1, 1]])
    t, y, sticks, events = 0.0, np.concatenate([starts, np.full(blocks, -SPEED)]), np.ones(blocks, bool), []

    def pull(y):
        return -(stiffness @ y[:blocks])

    sticks &= pull(y) <= static

    def rates(t, y, sticks):
        v = y[blocks:]
        return np.concatenate([v, np.where(sticks, 0.0, pull(y) - kinetic(v + SPEED))])

    def event(i):
        def margin(t, y, sticks):
            return static - pull(y)[i] if sticks[i] else y[blocks + i] + SPEED

        found: Any = margin
        found.terminal, found.direction = True, -1
        return found

    margins = [event(i) for i in range(blocks)]
    while t < END:
        options = {"events": margins, "args": (sticks.copy(),), "rtol": 1e-12, "atol": 1e-13}
        found = solve_ivp(rates, (t, END), y, "DOP853", **options)
        t, y = found.t[-1], found.y[:, -1].copy()
        if found.status == 0:
            break
        (which,) = [i for i, times in enumerate(found.t_events) if len(times)]
        sticks[which] = not sticks[which]
        y[blocks + which] = -SPEED
        events.append((which, t, bool(sticks[which])))
        if not sticks[which]:  # let go at rest, where its margin is zero: a moment later it moves
            moment = 1e-9
            y = y + moment * rates(t, y, sticks)
            t += moment
    return events, y


LAWS = {
    "static above kinetic": (ss.Coulomb(0.3, 0.45), lambda v: np.full_like(v, 0.3), 0.45),
    "velocity weakening": (ss.VelocityWeakening(0.45, 3.0), lambda v: 0.45 / (1 + 3.0 * v), 0.45),
}


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [4, 12])
@pytest.mark.parametrize("name", LAWS)
def test_a_train_that_may_not_slip_backward(name, blocks):
    """Few blocks, and as many as are followed as one law with many numbers."""
    law, kinetic, static = LAWS[name]
    starts = np.array([0.0, 0.35, -0.2, 0.1, 0.27, -0.12, 0.3, 0.0, 0.14, -0.3, 0.21, 0.05])[:blocks]
    events, state = train_by_scipy(starts, kinetic, static)
    row = ss.block_row(
        blocks, mass=1.0, between=BETWEEN, to_ground=TO_GROUND, normal_force=1.0, friction=ss.OneWay(law)
    )
    y0 = (*starts, *[-SPEED] * blocks)
    one = ss.simulate(row, ss.Constant(-SPEED), t1=END, y0=y0)
    assert int(one.status) == ss.Status.FINISHED
    for block in range(blocks):
        sticks = one.of_contact(block).sticks
        mask = np.asarray(sticks.mask)
        start, end = np.asarray(sticks.start)[mask], np.asarray(sticks.end)[mask]
        begins = [t for which, t, stuck in events if which == block and stuck]
        ends = [t for which, t, stuck in events if which == block and not stuck]
        np.testing.assert_allclose(start[start > 0], begins, atol=1e-9)
        np.testing.assert_allclose(end[end < END * (1 - 1e-9)], ends, atol=1e-9)
    assert len(events) > 12
    np.testing.assert_allclose(np.array(one.final_state), state, atol=1e-9)
    times = np.linspace(0.0, END, 1001)
    assert np.min(np.array(one.evaluate(times)[blocks:])) > -SPEED - 1e-9


@pytest.mark.slow
def test_ensembles_hold_what_single_motions_do():
    """And a derivative by a number of the law, against differences of the motion."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.OneWay(ss.Coulomb(ss.Uniform(0.1, 0.4), 0.5), ss.Uniform(50.0, 2000.0)))
    law, t1 = ss.RandomPhase(ss.Harmonic(0.5, 1.7)), 20.0
    many = ss.simulate_ensemble(system, law, t1=t1, samples=32, key=jax.random.key(0), y0=(0.0, 0.6), keep="sticks")
    totals = many.totals
    for number in range(0, 32, 5):
        own, base, y0 = many.realization(number)
        one = ss.simulate(own, base, t1=t1, y0=y0, method=ss.Exact(max_steps=1024))
        assert int(one.totals.sticks) == int(totals.sticks[number])
        np.testing.assert_allclose(float(one.stick_time), totals.stick_time[number], rtol=1e-9)

    def end(mu):
        one_way = ss.MassSpring(1.0, 4.0, 1.0, ss.OneWay(ss.Coulomb(mu, 0.5)))
        return ss.simulate(
            one_way, ss.Harmonic(0.5, 1.7), t1=10.0, y0=(0.0, 0.6), method=ss.Exact(max_steps=1024)
        ).final_state[0]

    step = 1e-5
    np.testing.assert_allclose(jax.grad(end)(0.2), (end(0.2 + step) - end(0.2 - step)) / (2 * step), rtol=1e-6)


def test_steps_are_those_of_slips_alone():
    """Their time scale is the speed scale over the largest friction: the one of slips, whatever it holds backward."""
    weakening = ss.VelocityWeakening(0.45, 3.0)
    law = ss.OneWay(weakening, capacity=5000.0)
    scales = [float(np.asarray(one.speed_scale)) / one.static for one in (law, weakening)]
    assert scales[0] == pytest.approx(scales[1])
    assert ss.OneWay(ss.Coulomb(0.3)).speed_scale == np.inf
    assert ss.OneWay().static == 1000.0
    assert float(ss.OneWay(weakening).stick_limit(jnp.array(1.0))) == 0.45
    assert float(ss.OneWay(weakening).stick_limit(jnp.array(-1.0))) == 1000.0


@pytest.mark.parametrize("capacity", [0.0, -1.0, np.nan, np.inf])
def test_capacities_that_are_none(capacity):
    with pytest.raises(ValueError, match="Argument capacity must be"):
        ss.OneWay(capacity=capacity)


@pytest.mark.usefixtures("annotations_unchecked")
def test_what_is_no_law():
    number: Any = 0.3
    with pytest.raises(ValueError, match="Argument forward must be a friction law"):
        ss.OneWay(number)
    with pytest.raises(ValueError, match="Argument forward must be a friction law without an inner state"):
        ss.OneWay(ss.Dahl(0.3, 1e3))
