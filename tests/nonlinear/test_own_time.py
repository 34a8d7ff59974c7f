"""A user's system whose equations change with time by themselves, and not by a motion that the package knows."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import nonlinear

PERIOD = 2 * math.pi / 0.7
STILL = ss.Constant(0.0)


class Still(ss.SwitchedSystem):
    mu: float = 0.3

    @property
    def state_names(self):
        return ("position in m", "velocity in m/s")

    def rates(self, t, y, base, friction):
        return y[1], -y[0] - self.mu * friction - 0.1 * y[1]

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 6.28


class Shaken(Still):
    def rates(self, t, y, base, friction):
        return y[1], -y[0] - self.mu * friction - 0.1 * y[1] + jnp.cos(0.7 * t)


class Stiffened(Still):
    """Where its spring is not stretched, nothing changes with time."""

    def rates(self, t, y, base, friction):
        return y[1], -y[0] * (1 + 0.1 * jnp.cos(0.7 * t)) - self.mu * friction - 0.1 * y[1]


class MovingContact(Still):
    def relative_velocity(self, t, y, base):
        return y[1] - jnp.cos(0.7 * t)


class Pressed(Still):
    @property
    def contacts(self):
        return 1

    def rates(self, t, y, base, friction):
        return y[1], -y[0] - friction[0] - 0.1 * y[1]

    def relative_velocity(self, t, y, base):
        return (y[1] - base.velocity,)

    def normal_forces(self, t, y, base):
        return (0.3 + 0.1 * jnp.cos(0.7 * t),)


SYSTEMS = [Shaken(), Stiffened(), MovingContact(), Pressed()]
NAMES = [type(system).__name__ for system in SYSTEMS]
CALLS = {
    "section": lambda system, base, **more: nonlinear.stroboscopic_section(
        system, base, y0=(0.0, 0.0), transient=0, kept=2, progress=False, **more
    ),
    "events": lambda system, base, **more: nonlinear.event_section(
        system, base, "stick_start", y0=(0.0, 0.0), transient=0, kept=1, progress=False, **more
    ),
    "orbit": lambda system, base, **more: nonlinear.periodic_orbit(system, base, y0=(0.0, 0.0), **more),
}


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS, ids=NAMES)
@pytest.mark.parametrize("call", CALLS)
def test_its_period_is_asked_for(system, call):
    for base in (STILL, ss.Harmonic(1.0, 0.8)):
        with pytest.raises(ValueError, match=rf"Argument period must be given .* {type(system).__name__}"):
            CALLS[call](system, base)


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS, ids=NAMES)
def test_a_wrong_period_is_told(system):
    with pytest.raises(ValueError, match=f"after which the rates of {type(system).__name__} begin anew"):
        CALLS["section"](system, STILL, period=1.0)


class Wave(ss.Signal):
    angular_frequency: float = 1.9
    shortest_period = 3.0

    def value(self, t):
        return 0.6 * jnp.cos(self.angular_frequency * t)


class Pulses(ss.Signal):
    """One in 45 s, which few instants would not see."""

    shortest_period = 0.05

    def value(self, t):
        return 0.5 * jnp.exp(-(((jnp.mod(t, 45.0) - 37.3) / 0.02) ** 2))


class Moved:
    """No pytree, with a period of its own that is wrong."""

    shortest_period, period = 3.0, 5.0

    def velocity(self, t):
        return 0.3 * jnp.sin(1.9 * t)

    def acceleration(self, t):
        return 0.57 * jnp.cos(1.9 * t)


def _pushed(force):
    return ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3), damping=0.1, force=force)


WRONG = {
    "a force": (_pushed(Wave()), STILL, {"period": 5.0}, "Wave"),
    "a base": (_pushed(None), Wave(), {"period": 2 * 2 * math.pi / 1.9 * (1 + 1e-6)}, "Wave"),
    "pulses": (_pushed(None), Pulses(), {"period": 30.0}, "Pulses"),
    "a declared period": (_pushed(None), Moved(), {}, "Moved"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("call", CALLS)
def test_a_wrong_period_of_a_signal_is_told(name, call):
    system, base, given, who = WRONG[name]
    with pytest.raises(ValueError, match=f"after which {who} repeats itself, but its value is .* s later"):
        CALLS[call](system, base, **given)


@pytest.mark.slow
def test_a_wrong_period_of_one_of_many_signals_is_told():
    with pytest.raises(ValueError, match="after which Wave repeats itself"):
        CALLS["section"](_pushed(Wave()), STILL, period=2 * math.pi / 1.9, over={"angular_frequency": [1.9, 2.0]})


@pytest.mark.slow
def test_the_period_of_a_signal_is_taken():
    period = 2 * math.pi / 1.9
    own = CALLS["orbit"](_pushed(Wave()), STILL, period=period)
    known = CALLS["orbit"](_pushed(ss.Harmonic(0.6, 1.9)), STILL)
    np.testing.assert_allclose(own.state, known.state, atol=1e-9)
    CALLS["section"](_pushed(None), Pulses(), period=45.0)


@pytest.mark.slow
def test_its_orbit_is_that_of_the_same_system_with_a_force():
    known = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3), damping=0.1, force=ss.Harmonic(1.0, 0.7))
    own = nonlinear.periodic_orbit(Shaken(), STILL, y0=(1.0, 0.0), period=PERIOD)
    expected = nonlinear.periodic_orbit(known, STILL, y0=(1.0, 0.0))
    assert bool(own.converged)
    assert own.is_driven
    np.testing.assert_allclose(own.state, expected.state, atol=1e-9)
    np.testing.assert_allclose(np.sort_complex(own.multipliers), np.sort_complex(expected.multipliers), atol=1e-8)


@pytest.mark.slow
def test_twice_the_period_of_both_drives():
    section = CALLS["section"](Shaken(), ss.Harmonic(1.0, 1.4), period=PERIOD)
    assert float(section.period) == PERIOD


def test_what_does_not_change_has_no_period():
    with pytest.raises(ValueError, match="nothing that changes with time"):
        CALLS["section"](Still(), STILL)


@pytest.mark.slow
def test_what_does_not_change_is_as_before():
    assert not nonlinear.periodic_orbit(Still(), ss.Constant(0.0), y0=(1.0, 0.0), period=6.3).is_driven
    jax.eval_shape(lambda mu: CALLS["orbit"](Still(mu), ss.Harmonic(1.0, 0.7)).state, 0.3)


@pytest.mark.slow
def test_branch_of_such_orbits_until_all_is_stuck():
    orbit = nonlinear.periodic_orbit(Shaken(), STILL, y0=(1.0, 0.0), period=PERIOD)
    branch = nonlinear.continue_orbit(orbit, "mu", until=1.1)
    known = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3), damping=0.1, force=ss.Harmonic(1.0, 0.7))
    same = nonlinear.continue_orbit(nonlinear.periodic_orbit(known, STILL, y0=(1.0, 0.0)), "mu", until=1.1)
    for one in (branch, same):
        assert [event.kind for event in one.events] == ["stick appears", "slip vanishes"]
        assert one.ending == one.events[1].text
        assert one.events[1].parameter == pytest.approx(1.0, abs=1e-7)  # the force is 1 N: from there on nothing moves
    assert branch.events[0].parameter == pytest.approx(same.events[0].parameter, abs=1e-9)
