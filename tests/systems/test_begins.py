"""States that begin anew with a stick or a slip, in systems of a user's own."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.weakening_reference import ByModes, SetUp

import stickslip_jax as ss


class Weakening(ss.SwitchedSystem):
    """A mass on a spring; its friction falls with the slip since its last stick. It counts its sticks and slips."""

    static: float = 0.6
    slope: float = 0.15  # 1/m
    stiffness: float = 1.0
    kept: float = 0.0  # of the slip, by a stick

    @property
    def state_names(self):
        return "position in m", "velocity in m/s", "slip in m", "sticks", "slips"

    def rates(self, t, y, base, friction):
        strength = self.static - self.slope * y[2]
        return y[1], -self.stiffness * y[0] - friction * strength, friction * (y[1] - base.velocity), 0.0, 0.0

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    def at_stick(self, t, y, base, contact):
        x, v, s, sticks, slips = y
        return x, v, self.kept * s * (1 + 0.1 * jnp.sin(t)), sticks + 1, slips

    def at_slip(self, t, y, base, contact):
        return *y[:4], y[4] + 1

    @property
    def shortest_time(self):
        return 2 * math.pi / self.stiffness**0.5


def listed(one):
    sticks, mask = one.sticks, np.asarray(one.sticks.mask)
    return np.stack([np.asarray(sticks.start)[mask], np.asarray(sticks.end)[mask]], axis=1)


BASE, START, METHOD = ss.Harmonic(0.5, 1.2, 0.0, 0.05), (0.9, -0.1, 0.0, 0.0, 0.0), ss.Exact(max_steps=2048)


def test_a_distance_that_begins_anew():
    """Against exact modes: in this motion no slip is so long that it is weak. A stick is held by what it begins as."""
    system = Weakening()
    one = ss.simulate(system, BASE, t1=40.0, y0=START, method=METHOD)
    numbers = (np.array([value]) for value in (1.0, 0.6, 0.0, 4.0, 0.0))
    mass, static, dynamic, distance, healing = numbers
    of = SetUp(mass, np.eye(1), np.zeros((1, 1)), mass, static, dynamic, distance, healing, (0.05, 0.5), 1.2)
    expected = ByModes(of, np.array(START[:2])).run(40.0)
    assert len(expected.sticks) > 3
    np.testing.assert_allclose(listed(one), [(a, b) for _, a, b in expected.sticks], rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.final_state[:3], expected.z[:3], rtol=0, atol=1e-9)
    # It slips when it begins, which is not counted.
    assert int(one.final_state[3]) == len(expected.sticks)
    assert int(one.final_state[4]) >= len(expected.sticks) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["static", "slope", "kept", "phase"])
def test_derivatives(name):
    """What is left of a slip depends on it and on the time, so that derivatives pass through many begins."""

    def of(value):
        numbers = {"kept": 0.4} | ({} if name == "phase" else {name: value})
        base = ss.Harmonic(0.5, 1.2, value if name == "phase" else 0.0, 0.05)
        one = ss.simulate(Weakening(**numbers), base, t1=37.0, y0=START, method=METHOD)
        return jnp.stack([one.stick_time, *one.final_state[:3]])

    at, h = {"static": 0.6, "slope": 0.15, "kept": 0.4, "phase": 0.0}[name], 1e-6
    differences = (of(at + h) - of(at - h)) / (2 * h)
    assert np.all(np.abs(differences) > 1e-3)
    np.testing.assert_allclose(jax.jacfwd(of)(at), differences, rtol=1e-6, atol=1e-6)
    if name == "kept":
        np.testing.assert_allclose(jax.jacrev(of)(at), differences, rtol=1e-6, atol=1e-6)
        second = (jax.jacfwd(of)(at + h) - jax.jacfwd(of)(at - h)) / (2 * h)
        np.testing.assert_allclose(jax.jacfwd(jax.jacfwd(of))(at), second, rtol=1e-5, atol=1e-4)


@pytest.mark.slow
def test_motions_go_on():
    """A simulation that goes on from another begins nothing anew, in a stick either."""
    system = Weakening(kept=0.4)
    whole = ss.simulate(system, ss.Constant(0.2), t1=20.0, y0=START, method=METHOD)
    for time in (0.5, *np.mean(listed(whole)[:2], axis=1)):
        first = ss.simulate(system, ss.Constant(0.2), t1=time, y0=START, method=METHOD)
        rest = ss.simulate(system, ss.Constant(0.2), t1=20.0 - time, y0=tuple(first.final_state), method=METHOD)
        np.testing.assert_allclose(rest.final_state[3:], whole.final_state[3:])


class Counting(ss.SwitchedSystem):
    """Two masses in a row on the base, the second pressed on it by a force that opens its contact; sticks counted."""

    contacts = 2
    static_ratio = 1.2
    ages: float = 0.0

    @property
    def state_names(self):
        return "x1 in m", "v1 in m/s", "x2 in m", "v2 in m/s", "sticks 1", "sticks 2", "slips"

    def normal_forces(self, t, y, base):
        return 1.0, 0.4 + jnp.cos(1.7 * t)

    def rates(self, t, y, base, friction):
        x1, v1, x2, v2 = y[:4]
        return v1, x2 - 2 * x1 - 0.3 * friction[0], v2, x1 - x2 - 0.3 * friction[1], 0.0, 0.0, 0.0

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity, y[3] - base.velocity

    def at_stick(self, t, y, base, contact):
        return *y[:4], y[4] + (contact == 0), y[5] + (contact == 1), y[6]

    def at_slip(self, t, y, base, contact):
        return *y[:6], y[6] + 1

    @property
    def shortest_time(self):
        return 2 * math.pi / 1.7


class CountingByAge(Counting):
    def static_ratio_after(self, age):
        return 1.2 + 0.1 * (1 - jnp.exp(-age))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Counting, CountingByAge])
def test_counters_of_several_contacts(kind):
    start = (0.5, 0.0, -0.4, 0.3, 0.0, 0.0, 0.0)
    one = ss.simulate(kind(), ss.Harmonic(0.4, 0.8), t1=40.0, y0=start)
    for contact in (0, 1):
        assert int(one.final_state[4 + contact]) == len(listed(one.of_contact(contact))) > 2
    assert int(one.final_state[6]) >= 4


@pytest.mark.slow
def test_ensembles_are_single_runs():
    law, key, kept = ss.PoissonSwitching(0.4, rate=0.7), jax.random.key(3), np.linspace(0, 0.5, 5)
    settings = {"t1": 30.0, "y0": START}
    many = ss.simulate_ensemble(
        Weakening(kept=kept), law, samples=5, key=key, keep="totals", progress=False, **settings
    )  # fmt: skip

    @jax.jit
    @jax.vmap
    def single(sample, kept):
        base = law.sample(jax.random.fold_in(key, sample), 30.0)
        return ss.simulate(Weakening(kept=kept), base, method=METHOD, **settings).totals.stick_time

    np.testing.assert_allclose(many.totals.stick_time, single(np.arange(5), kept), rtol=0, atol=1e-9)


class Short(Weakening):
    def at_stick(self, t, y, base, contact):
        return y[:3]


class Kicked(Weakening):
    def at_slip(self, t, y, base, contact):
        return y[0], y[1] + 0.1, *y[2:]


@pytest.mark.parametrize(
    ("system", "method", "message"),
    [
        (Short(), ss.Exact(), "Argument at_stick of a Short must return a tuple of 5 numbers"),
        (Kicked(), ss.Exact(), "Argument at_slip of a Kicked must leave relative velocities as they are"),
        (Weakening(), ss.Regularized(1e-3), r"Argument method must be Exact\(...\) for a system with at_stick"),
    ],
)
def test_what_does_not_fit_is_told(system, method, message):
    with pytest.raises(ValueError, match=message):
        ss.simulate(system, BASE, t1=1.0, y0=START, method=method)
