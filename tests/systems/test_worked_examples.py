"""The valve spool and the robot arm of docs/howto/control.md, with other numbers, beside independent computations."""

import re
from itertools import product
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

PAGE = Path(__file__).parents[2] / "docs/howto/control.md"
GROUND = ss.Constant(0.0)


@pytest.fixture(scope="module")
def page():
    """The classes of the page."""
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict = {}
    for name in ("Servo", "Spool", "Arm"):
        (piece,) = (piece for piece in code if f"class {name}(" in piece)
        # What comes before the class, and the class: no simulation.
        exec(re.split(r"\n(?=[^\s\n#@]*(?:omega|arm|class StaticFriction)\b)", piece)[0], names)
    return names


# A system whose modes are known: each contact slips forward or backward, or sticks. SciPy goes from event to event.


def by_events(under, static, y, t1, positions):
    """Final state, and begins of sticks by contact.

    - `under(t, y, signs)`: rates of the velocities under these modes, and the friction that each contact needs.
    - `static`: friction that holds each. Where rates have kinks, steps become as small as they must.
    """
    contacts = len(static)
    t, begins = 0.0, [[] for _ in static]
    choices = [[0, 1, -1]] * contacts

    def holds(signs):
        rates, friction = under(t, y, signs)
        return all(
            (y[positions + i] or rates[i]) * sign > -1e-9 if sign else abs(friction[i]) <= static[i]
            for i, sign in enumerate(signs)
        )

    def guard(i, signs):
        def event(t, y):
            if signs[i]:
                return signs[i] * y[positions + i]
            return static[i] - abs(under(t, y, signs)[1][i])

        event.terminal, event.direction = True, -1
        return event

    before = [None] * contacts
    while t < t1:
        signs = next(one for one in product(*choices) if holds(one))
        for i, sign in enumerate(signs):
            if sign == 0 and before[i] != 0:
                begins[i].append(t)
        before = signs
        events = [guard(i, signs) for i in range(contacts)]
        path = solve_ivp(
            lambda t, y, signs=signs: [*y[positions:], *under(t, y, signs)[0]],
            (t, t1), y, "DOP853", events=events, rtol=1e-11, atol=1e-14, max_step=t1 / 200,
        )  # fmt: skip
        t, y = path.t[-1], path.y[:, -1]
        choices = [[sign] for sign in signs]
        for i in range(contacts):
            if len(path.t_events[i]):
                y[positions + i] = 0.0
                held = np.sign(under(t, y, signs)[1][i])
                choices[i] = [0, 1, -1] if signs[i] else [held]
            elif not signs[i]:
                choices[i] = [0, 1, -1]
    return y, begins


def check(one, contacts, final, begins, scale, atol=1e-8):
    np.testing.assert_allclose(np.array(one.final_state) / scale, final / scale, rtol=0, atol=atol)
    for i, expected in enumerate(begins):
        sticks = one.of_contact(i).sticks if contacts > 1 else one.sticks
        np.testing.assert_allclose(np.asarray(sticks.start)[np.asarray(sticks.mask)], expected, rtol=0, atol=1e-8)


OMEGA = 2 * np.pi * 40.0  # rad/s


@pytest.mark.slow
@pytest.mark.parametrize(("mean", "dither", "atol"), [(0.0, 60.0, 2e-5), (12.0, 15.0, 1e-8), (-25.0, 0.0, 1e-8)])
def test_a_spool_between_stops(page, mean, dither, atol):
    """From stop to stop, on the way, and on to one stop.

    Where a stop begins, the rates have a kink, which steps pass within their tolerance: 78 times from stop to stop.
    """
    m, k, coulomb, static, travel, stop = 0.08, 9e3, 3.0, 4.5, 1.5e-3, 1e6
    spool = page["Spool"](ss.Harmonic(dither, OMEGA, offset=mean), m, k, coulomb, static, travel, stop)
    one = ss.simulate(spool, GROUND, t1=0.1, y0=(0.0, 0.0), method=ss.Exact(max_steps=8000))

    def under(t, y, signs):
        force = mean + dither * np.cos(OMEGA * t) - k * y[0]
        force -= stop * (max(y[0] - travel, 0.0) + min(y[0] + travel, 0.0))
        return ([(force - signs[0] * coulomb) / m] if signs[0] else [0.0]), [force]

    final, begins = by_events(under, [static], np.zeros(2), 0.1, 1)
    check(one, 1, final, begins, np.array([1e-3, 1.0]), atol)
    furthest = np.max(np.abs(one.evaluate(np.linspace(0, 0.1, 501))[0]))
    assert furthest > travel


@pytest.mark.slow
@pytest.mark.parametrize(("hertz", "static"), [(35.0, 4.0), (90.0, 4.0), (90.0, 5.5), (300.0, 4.4)])
def test_the_least_dither_without_sticks(page, hertz, static):
    """Below and above the natural frequency of 50.3 Hz; at the lower end of what has two turns a period."""
    r = hertz * 2 * np.pi / (1e4 / 0.1) ** 0.5
    least = abs(1 - r**2) / r * np.hypot(static / r, 4.0 * np.tan(np.pi / (2 * r)))

    def late(amplitude):
        push = ss.Harmonic(amplitude, 2 * np.pi * hertz, offset=8.0)
        spool = page["Spool"](push, 0.1, 1e4, 4.0, static, 4e-3, 1e5)
        one = ss.simulate(spool, GROUND, t1=0.5, y0=(8e-4, 0.0), method=ss.Exact(max_steps=20000))
        return jnp.sum(one.sticks.mask & (one.sticks.start > 0.35))

    above, below = (int(late(share * least)) for share in (1.0003, 0.9997))
    assert above == 0
    assert below > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "kd", "y0"),
    [
        ((0.8, 0.6), (30.0, 2.0), (0.0, 0.0, 0.0, 0.0)),
        ((-0.5, 1.2), (10.0, 0.3), (0.4, -0.7, 2.0, -3.0)),
        ((0.1, 0.2), (15.0, 0.5), (0.1, 1.2, 0.0, 0.0)),
    ],
)
def test_an_arm_of_two_links(page, goal, kd, y0):
    """Final errors within friction / gain, sticks and states as from event to event."""
    arm = page["Arm"](goal=goal, kd=kd)
    kp, viscous, coulomb = (np.array(getattr(arm, name)) for name in ("kp", "viscous", "coulomb"))
    one = ss.simulate(arm, GROUND, t1=3.0, y0=y0, method=ss.Exact(max_steps=2000))

    def under(t, y, signs):
        q, w, slips = y[:2], y[2:], np.array(signs) != 0
        h = 0.084 * np.sin(q[1])
        off = 0.102 + 0.084 * np.cos(q[1])
        mass = np.array([[2.351 + 0.168 * np.cos(q[1]), off], [off, 0.102]])
        turning = np.array([[-2 * h * w[1], -h * w[1]], [h * w[0], 0.0]]) @ w
        torque = kp * (np.array(goal) - q) - (np.array(kd) + viscous) * w - turning
        rates = np.zeros(2)
        pull = (torque - np.array(signs) * coulomb)[slips]
        rates[slips] = np.linalg.solve(mass[np.ix_(slips, slips)], pull)
        return rates, torque - mass @ rates

    final, begins = by_events(under, coulomb, np.array(y0), 3.0, 2)
    check(one, 2, final, begins, 1.0)
    assert np.all(np.abs(np.array(goal) - final[:2]) <= coulomb / kp)


@pytest.mark.slow
def test_the_error_of_an_arm_by_friction(page):
    def error(friction):
        arm = page["Arm"](coulomb=(7.17, friction))
        method = ss.Exact(max_steps=2000)
        return ss.simulate(arm, GROUND, t1=3.0, y0=(0.0,) * 4, method=method).final_state[1]

    slope = jax.jvp(error, (1.734,), (1.0,))[1]
    np.testing.assert_allclose(slope, (error(1.7345) - error(1.7335)) / 1e-3, rtol=1e-6)
