"""Adaptive steps in lanes: instants of sticks and derivatives to the tolerance, samples as one by one, what fails."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss
from stickslip_jax._dynamics.regularized.field import InnerField

jax.config.update("jax_enable_x64", True)
T1, BELT, START = 15.0, 0.1, (0.1, 0.0)
BRISTLES = {"mu_static": 0.4, "stribeck_speed": 0.05, "stiffness": 1000.0, "damping": 30.0}


def on_bristles(mu=0.3, stiffness=4.0, speed=BELT, rtol=1e-5, **options):
    system = ss.MassSpring(1.0, stiffness, 1.0, ss.LuGre(mu, **BRISTLES))
    method = ss.Regularized(rtol=rtol, max_steps=2**14, **options)
    return ss.simulate(system, ss.Constant(speed), t1=T1, y0=START, method=method)


@jax.jit
def told(numbers, rtol):
    """Position and velocity at the end, and the stick time."""
    one = on_bristles(*numbers, rtol=rtol)
    return jnp.stack([*one.final_state[:2], one.stick_time])


AT = (0.3, 4.0, BELT)


def slopes(rtol=1e-10):
    """(3 results, 3 numbers), by differences of the fourth order."""
    columns = []
    for place, number in enumerate(AT):
        h = 1e-4 * number
        at = [told(tuple(number + k * h if i == place else AT[i] for i in range(3)), rtol) for k in (-2, -1, 1, 2)]
        columns.append((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h))
    return np.stack(columns, axis=1)


def test_derivatives():
    """At the default tolerance, of the stick time too: its beginnings and ends are events."""
    forward = np.stack(jax.jacfwd(told)(AT, 1e-5), axis=1)
    np.testing.assert_allclose(forward, slopes(), rtol=2e-3, atol=2e-4)


@pytest.mark.slow
def test_derivatives_going_back():
    back = np.stack(jax.jacrev(told)(AT, 1e-5), axis=1)
    np.testing.assert_allclose(back, np.stack(jax.jacfwd(told)(AT, 1e-5), axis=1), rtol=1e-9, atol=1e-10)


@pytest.mark.slow
def test_second_derivative_is_right_across_kinks(monkeypatch):
    """Where the relative velocity passes zero the rates have a kink, of which no sequence of smooth steps knows."""

    def second(rtol):
        slope = jax.grad(lambda mu: on_bristles(mu, rtol=rtol).final_state[0])
        return jax.jvp(slope, (0.3,), (1.0,))

    h = 2e-5
    slope = jax.jit(jax.grad(lambda mu: on_bristles(mu, rtol=1e-10).final_state[0]))
    expected = float(slope(0.3 + h) - slope(0.3 - h)) / (2 * h)
    assert float(second(1e-8)[1]) == pytest.approx(expected, rel=2e-3)
    monkeypatch.setattr(InnerField, "kinks", ())
    jax.clear_caches()
    assert abs(second(1.01e-8)[1] - expected) > 0.5 * abs(expected)


def instants(one):
    mask = np.asarray(one.sticks.mask)
    return np.stack([np.asarray(one.sticks.start)[mask], np.asarray(one.sticks.end)[mask]])


def test_sticks_are_as_exact_as_the_tolerance():
    """Beginnings and ends, where the relative velocity is a thousandth of that of slips."""
    right = instants(on_bristles(rtol=1e-10))
    assert right.shape[1] > 2
    for rtol in (1e-4, 1e-5, 1e-6):
        np.testing.assert_allclose(instants(on_bristles(rtol=rtol)), right, atol=3 * rtol)


def test_states_between_steps():
    """Steps are long in slips: the path is a quartic in each."""
    times = np.linspace(0, T1, 1201)
    right, found = (on_bristles(rtol=rtol).evaluate(times) for rtol in (1e-10, 1e-6))
    for one, other in zip(found[:2], right[:2], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.slow
def test_samples_as_one_by_one():
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.LuGre(0.3, **BRISTLES)), ss.PoissonSwitching(speed=0.1, rate=1.0)
    many = ss.simulate_ensemble(
        system, law, t1=T1, samples=20, key=jax.random.key(1), method=ss.Regularized(), keep="sticks", y0=(0.1, 0.0)
    )
    assert many.finished == 20
    assert many.totals.sticks.sum() > 20
    for number in range(3):
        one = ss.simulate(*many.realization(number)[:2], t1=T1, y0=START, method=ss.Regularized())
        flat = many.flat_sticks
        own = flat.sample == number
        np.testing.assert_allclose([flat.start[own], flat.end[own]], instants(one), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [ss.LuGre(0.3, **BRISTLES), ss.Coulomb(0.3)], ids=["LuGre", "Coulomb"])
def test_every_contact_of_samples(friction):
    """Sticks of each contact and of all at once, which adaptive steps of many samples could not count before."""
    stiffness = np.array([[2.0, -1.0], [-1.0, 1.0]])
    contacts = tuple(ss.Contact.of_mass(number, 2, 1.0, friction) for number in range(2))
    blocks = ss.LinearStructure([1.0, 1.0], stiffness, stiffness / 10, contacts)
    law = ss.PoissonSwitching(speed=0.2, rate=0.5)
    method = ss.Regularized() if isinstance(friction, ss.LuGre) else ss.Regularized(1e-3, rtol=1e-7)
    many = ss.simulate_contacts(blocks, law, t1=10.0, samples=6, key=jax.random.key(0), method=method, keep="sticks")
    for number in range(2):
        one = ss.simulate(blocks, many.of_contact(0).realization(number)[1], t1=10.0, method=method)
        for contact in range(2):
            flat, alone = many.of_contact(contact).flat_sticks, one.of_contact(contact)
            own = flat.sample == number
            np.testing.assert_allclose([flat.start[own], flat.end[own]], instants(alone), atol=1e-4)


@pytest.mark.slow
def test_normal_force_that_varies_on_bristles():
    """Against scipy's Radau, of which each part of the force is a run of its own."""
    times, newtons = [0.0, 2.0, 4.0], [1.0, 3.0, 0.5]
    law = ss.LuGre(0.3, **BRISTLES)
    system = ss.MassSpring(1.0, 4.0, ss.ForceSteps(times, newtons), law)
    one = ss.simulate(system, ss.Constant(BELT), t1=6.0, y0=START, method=ss.Regularized(rtol=1e-7, threshold=1e-4))
    state = np.array([*START, 0.0])
    for first, last, press in zip(times, [*times[1:], 6.0], newtons, strict=True):

        def rates(_, y, press=press):
            slip = y[1] - BELT
            limit = 0.3 + 0.1 * np.exp(-((slip / BRISTLES["stribeck_speed"]) ** 2))
            rate = slip - BRISTLES["stiffness"] * abs(slip) * y[2] / limit
            force = press * (BRISTLES["stiffness"] * y[2] + BRISTLES["damping"] * rate)
            return [y[1], -4.0 * y[0] - force, rate]

        state = solve_ivp(rates, (first, last), state, "Radau", rtol=1e-10, atol=1e-12).y[:, -1]
    assert int(one.status) == ss.Status.FINISHED
    assert one.sticks.count > 0
    np.testing.assert_allclose(one.final_state, state, atol=1e-6)


AT_REST = {
    "LuGre": (ss.LuGre(0.3, **BRISTLES), ()),
    "Dahl": (ss.Dahl(0.3, 1000.0), ()),
    "Bouc and Wen": (ss.BoucWen(0.3, 1000.0), ()),
    "linear": (ss.Coulomb(0.3), (1e-3,)),
    "static friction": (ss.Coulomb(0.3, 0.4), (1e-3,)),
    "tanh": (ss.Coulomb(0.3), (1e-3, "tanh")),
}


@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize(
    ("name", "x64", "blocks"),
    [
        (name, x64, blocks) if (name, x64, blocks) == ("LuGre", True, 1)
        else pytest.param(name, x64, blocks, marks=pytest.mark.slow)
        for name in AT_REST for x64 in (True, False) for blocks in (1, 2)
    ],
)  # fmt: skip
def test_start_at_the_velocity_of_the_belt(name, x64, blocks):
    """On the kink: relative velocities that are round-off pass zero in every step, and would shorten each."""
    friction, options = AT_REST[name]
    with jax.enable_x64(x64):
        system, y0 = ss.MassSpring(1.0, 4.0, 1.0, friction), (0.05, BELT)
        if blocks == 2:
            stiffness = np.array([[5.0, -1.0], [-1.0, 5.0]])
            contacts = (ss.Contact.of_mass(0, 2, 1.0, friction), ss.Contact.between(0, 1, 2, 1.0, friction))
            system, y0 = ss.LinearStructure(np.ones(2), stiffness, None, contacts), (0.05, 0.05, BELT, BELT)
        one = ss.simulate(system, ss.Constant(BELT), t1=3.0, y0=y0, method=ss.Regularized(*options, max_steps=2**11))
    assert int(one.status) == ss.Status.FINISHED


class RunsAway(ss.SwitchedSystem):
    """``y' = y^2``: infinite after a second."""

    state_names = ("position in m", "velocity in m/s")
    shortest_time, speed_scale = 1.0, 1.0

    def rates(self, t, y, base, friction):
        return y[1], y[1] ** 2 - 0 * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@pytest.mark.slow
def test_what_no_step_is_short_enough_for_is_told():
    one = ss.simulate(RunsAway(), ss.Constant(0.0), t1=3.0, y0=(0.0, 1.0), method=ss.Regularized(1e-2))
    assert int(one.status) in (ss.Status.SOLVER_FAILED, ss.Status.NOT_FINITE)
    assert one.time_reached == pytest.approx(1.0, abs=1e-3)
    few = ss.simulate(RunsAway(), ss.Constant(0.0), t1=3.0, y0=(0.0, 1.0), method=ss.Regularized(1e-2, max_steps=20))
    assert int(few.status) == ss.Status.OUT_OF_STEPS


def test_a_solver_is_for_one_sample():
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5)), ss.PoissonSwitching(1.0, 1.0)
    method = ss.Regularized(1e-2, solver=diffrax.Tsit5())
    with pytest.raises(ValueError, match=r"leave the steps of many samples to the package.*simulate follows one"):
        ss.simulate_ensemble(system, law, t1=5.0, samples=2, key=jax.random.key(0), method=method)
