"""Rate-and-state friction with two state variables: closed forms, scipy, and the linear theory of a slider."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

MU, A, B1, L1, B2, L2, V0 = 0.6, 0.012, 0.009, 1e-5, 0.007, 6e-5, 1e-6
NORMAL = 1e6
STEPS, TIMES = [1e-6, 1e-5, 1e-4, 2e-6], np.array([0.0, 5.0, 10.0, 11.0, 14.0, 14.2, 20.0, 21.0, 60.0])


def law_of(form="slip", b2=B2, l2=L2, a=A, b1=B1, l1=L1):
    return ss.DieterichRuina(MU, a, b1, l1, V0, form, second_evolution=b2, second_length=l2)


@pytest.mark.parametrize("form", ["slip", pytest.param("ageing", marks=pytest.mark.slow)])
@pytest.mark.parametrize("b2", [B2, pytest.param(-0.004, marks=pytest.mark.slow)])
def test_steps_of_the_speed(form, b2):
    """In the slip form each Theta_i relaxes with ``exp(-slip / L_i)``, in the ageing form each theta_i does."""
    at_once = ss.PiecewiseConstant([0.0, 10.0, 14.0, 20.0], STEPS)
    states, expected = np.zeros(2), []
    for i, t in enumerate(TIMES):
        v = STEPS[np.searchsorted([10.0, 14.0, 20.0], t, side="right")]
        expected.append(MU + A * np.log(v / V0) + B1 * states[0] + b2 * states[1])
        if i + 1 < len(TIMES):
            left, steady = np.exp(-v * (TIMES[i + 1] - t) / np.array([L1, L2])), -np.log(v / V0)
            if form == "slip":
                states = steady + (states - steady) * left
            else:
                states = np.log(np.exp(steady) + (np.exp(states) - np.exp(steady)) * left)
    found = law_of(form, b2).force(TIMES, at_once, 2.0)
    np.testing.assert_allclose(found, 2 * np.array(expected), rtol=1e-7)
    for second, length in ((False, L1), (True, L2)):
        theta = law_of(form).theta(jnp.array([0.0, 1.0]), second=second)
        np.testing.assert_allclose(theta, length / V0 * np.exp([0.0, 1.0]), rtol=1e-14)


@pytest.mark.slow
def test_begins_from_given_states():
    """Held at the reference speed, each state goes back to zero by itself."""
    start, times = np.array([0.7, -0.4]), np.array([0.0, 3.0, 40.0])
    found = law_of().force(times, ss.PiecewiseConstant([0.0], [V0]), initial_state=start)
    states = start[:, None] * np.exp(-V0 * times / np.array([[L1], [L2]]))
    np.testing.assert_allclose(found, MU + B1 * states[0] + B2 * states[1], rtol=1e-7)


def critical_stiffness(a=A, b1=B1, l1=L1, b2=B2, l2=L2):
    """Of a slider without mass (Gu et al. 1984), N/m, and its angular frequency there over the speed, 1/m.

    Small deviations that go as ``exp(s t)``, with s per slip: ``Theta_i = -x / (1 + s L_i)`` follow the logarithm x of
    the speed, and the coefficient of the spring's force is ``-(k / s) x``, so ``a + k / s = sum b_i / (1 + s L_i)``.
    With s imaginary its real part is a quadratic equation of the square of s, and its imaginary part gives k.
    """
    square = max(np.roots([a * l1**2 * l2**2, a * (l1**2 + l2**2) - b1 * l2**2 - b2 * l1**2, a - b1 - b2]).real)
    parts = ((b, length, 1 + square * length**2) for b, length in ((b1, l1), (b2, l2)))
    return NORMAL * sum(b * square * length / by for b, length, by in parts), np.sqrt(square)


def rates_of_slider(law, stiffness, states):
    """The time derivatives of the coefficient and both states, at the reference speed of the spring's end."""
    slip = law.slip_velocity(states[1:], states[0])
    return jnp.concatenate([(stiffness / NORMAL * (V0 - slip))[None], law.rate(states[1:], slip)])


@pytest.mark.parametrize("form", ["slip", "ageing"])
def test_critical_stiffness_by_eigenvalues(form):
    """Those of the rates at the steady slip cross the imaginary axis there, with the frequency of the closed form."""
    stiffness, frequency = critical_stiffness()
    jacobian = jax.jacfwd(rates_of_slider, argnums=2)
    most = []
    for share in (0.999, 1.0, 1.001):
        values = np.linalg.eigvals(jacobian(law_of(form), share * stiffness, jnp.array([MU, 0.0, 0.0])))
        most.append(values[np.argmax(values.real)])
    assert most[0].real > 0 > most[2].real
    assert abs(most[1].real) < 1e-9 * abs(most[1])
    assert abs(most[1].imag) == pytest.approx(V0 * frequency, rel=1e-9)


@pytest.mark.slow
def test_critical_stiffness_by_simulation():
    """Small disturbances grow just below it, and decay just above."""
    after, growth = np.linspace(20.0, 800.0, 400), []
    for share in (0.97, 1.03):
        times = np.append([0.0, 1e-6], after)
        velocity = V0 * np.append(1.0, np.full(len(times) - 1, 1.001))
        stiffness = share * critical_stiffness()[0]
        found = law_of().force(times, velocity, NORMAL, series_stiffness=stiffness, rtol=1e-11, max_steps=10**6)[2:]
        growth.append(np.log(np.ptp(found[-100:]) / np.ptp(found[:100])))
    assert growth[0] > 0.1
    assert growth[1] < -0.1


def forces_by_scipy(form, stiffness, pieces):
    """Behind a spring, from piece to piece of a prescribed velocity that is linear in each."""
    lengths = np.array([L1, L2])

    def rates(t, y, velocity):
        slip = V0 * np.exp((y[0] - MU - B1 * y[1] - B2 * y[2]) / A)
        ratio = slip * np.exp(y[1:]) / V0
        change = np.exp(-y[1:]) * (1 - ratio) if form == "ageing" else -np.exp(-y[1:]) * ratio * np.log(ratio)
        return [stiffness / NORMAL * (np.interp(t, *velocity) - slip), *(change * V0 / lengths)]

    y, found = np.array([MU, 0.0, 0.0]), [MU]
    for span in zip(pieces[0][:-1], pieces[0][1:], strict=True):
        y = solve_ivp(rates, span, y, "Radau", rtol=1e-11, atol=1e-12, args=(pieces,), max_step=1.0).y[:, -1]
        found.append(y[0])
    return NORMAL * np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["slip", "ageing"])
def test_a_test_machine_against_scipy(form):
    times = np.array([0.0, 2.0, 2.5, 3.0, 5.0, 20.0, 20.5, 40.0, 60.0])
    velocity = np.array([1.0, 1.0, 10.0, 10.0, 10.0, 10.0, 3.0, 3.0, 3.0]) * 1e-6
    stiffness = 5 * critical_stiffness()[0]
    found = law_of(form).force(times, velocity, NORMAL, series_stiffness=stiffness, rtol=1e-10, max_steps=10**6)
    expected = forces_by_scipy(form, stiffness, (times, velocity))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * NORMAL)


# Of a mass, at moderate speeds.

LAW = ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, "slip", second_evolution=0.02, second_length=0.3)
ACCURATE = ss.Regularized(rtol=1e-9, max_steps=20_000)


def rates_of_mass(law, base):
    def rates(t, y):
        slip, lengths = y[1] - base(t), np.array([law.length, law.second_length])
        force = law.mu + law.evolution * y[2] + law.second_evolution * y[3]
        force = law.direct * np.arcsinh(slip / (2 * law.reference_speed) * np.exp(force / law.direct))
        by_speed = np.abs(slip) / lengths
        if law.form == "ageing":
            change = law.reference_speed / lengths * np.exp(-y[2:]) - by_speed
        else:
            change = -by_speed * (np.log(np.abs(slip) / law.reference_speed) + y[2:])
        return [y[1], -y[0] - force, *change]

    return rates


@pytest.mark.parametrize("form", ["slip", pytest.param("ageing", marks=pytest.mark.slow)])
def test_a_block_on_a_belt_against_scipy(form):
    """A constant base velocity: followed by the logarithm of the speed. Both states are numbers of ``evaluate``."""
    law = ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, form, second_evolution=0.02, second_length=0.3)
    times = np.linspace(0, 12, 13)
    expected = solve_ivp(
        rates_of_mass(law, lambda t: 0.12), (0, 12), [0.55, 0, 0, 0], "Radau", times, rtol=1e-11, atol=1e-12
    )
    one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, law), 0.12, t1=12.0, y0=(0.55, 0.0), method=ACCURATE)
    np.testing.assert_allclose(one.evaluate(times), expected.y, rtol=0, atol=1e-6)
    np.testing.assert_allclose(one.final_state, expected.y[:, -1], rtol=0, atol=1e-6)
    assert [c.meaning for c in one.system.coordinates[2:]] == ["inner state", "second inner state"]
    acceleration = [rates_of_mass(law, lambda t: 0.12)(0, y)[1] for y in expected.y.T]
    np.testing.assert_allclose(one.friction_force(times), np.array(acceleration) + expected.y[0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_base_that_jumps_against_scipy():
    """Followed by the velocity itself; a step of the base ends the pieces of both."""
    base = ss.PiecewiseConstant([0.0, 3.0, 6.0], [0.12, 0.3, 0.05])
    y, states, jumps = np.array([0.55, 0.0, 0.0, 0.0]), [], [0.0, 3.0, 6.0, 9.0]
    for begin, end, speed in zip(jumps[:-1], jumps[1:], [0.12, 0.3, 0.05], strict=True):
        rates = rates_of_mass(LAW, lambda t, speed=speed: speed)
        y = solve_ivp(rates, (begin, end), y, "Radau", rtol=1e-11, atol=1e-12).y[:, -1]
        states.append(y)
    one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, LAW), base, t1=9.0, y0=(0.55, 0.0), method=ACCURATE)
    np.testing.assert_allclose(np.stack(one.evaluate(np.array(jumps[1:])), axis=1), states, rtol=0, atol=1e-6)


class Pair(ss.SwitchedSystem):
    """Two coupled blocks, with laws of one and of two states, as equations of one's own."""

    laws: tuple[ss.DynamicFriction, ...]
    contacts = 2

    @property
    def state_names(self):
        return "position 1 in m", "position 2 in m", "velocity 1 in m/s", "velocity 2 in m/s"

    @property
    def inner_laws(self):
        return self.laws

    def rates(self, t, y, base, friction):
        pull = 0.7 * (y[1] - y[0])
        return y[2], y[3], pull - y[0] - friction[0], -pull - y[1] - friction[1]

    def relative_velocity(self, t, y, base):
        return y[2] - base.velocity, y[3] - base.velocity

    @property
    def shortest_time(self):
        return 4.0

    @property
    def speed_scale(self):
        return 0.5


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True])
def test_several_contacts_against_scipy(own):
    """A contact with one state beside one with two: three numbers at the end of the state."""
    single = ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, "slip")
    laws, y0, times = (single, LAW), (0.55, 0.4, 0.0, 0.0), np.linspace(0, 8, 9)
    of_two, of_one = rates_of_mass(LAW, lambda t: 0.12), rates_of_mass(
        ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, "slip", second_evolution=0.0, second_length=1.0), lambda t: 0.12
    )  # fmt: skip

    def rates(t, y):
        pull = 0.7 * (y[1] - y[0])
        v1, a1, z, _ = of_one(t, np.array([y[0], y[2], y[4], 0.0]))
        v2, a2, *zs = of_two(t, np.array([y[1], y[3], *y[5:]]))
        return [v1, v2, a1 + pull, a2 - pull, z, *zs]

    expected = solve_ivp(rates, (0, 8), [*y0, 0, 0, 0], "Radau", times, rtol=1e-11, atol=1e-12).y
    if own:
        system = Pair(laws)
    else:
        contacts = [ss.Contact.of_mass(i, 2, 1.0, law) for i, law in enumerate(laws)]
        system = ss.LinearStructure([1.0, 1.0], [[1.7, -0.7], [-0.7, 1.7]], None, contacts)
    one = ss.simulate(system, 0.12, t1=8.0, y0=y0, method=ACCURATE)
    np.testing.assert_allclose(one.evaluate(times), expected, rtol=0, atol=1e-6)
    names = [c.meaning for c in system.coordinates[4:]]
    assert names == ["inner state 1", "inner state 2", "second inner state 2"]


class Own(ss.DynamicFriction):
    """Two Maxwell elements in parallel, as a law of one's own; units and scales differ."""

    stiffness: tuple[float, float] = (300.0, 50.0)
    limits: tuple[float, float] = (0.2, 0.1)

    @property
    def inner_states(self):
        return "deflection in m", "load"

    @property
    def initial_state(self):
        return 1e-4, 0.01

    @property
    def state_scale(self):
        return 1e-3, 0.1

    @property
    def static(self):
        return sum(self.limits)

    def rate(self, z, velocity):
        first = velocity - self.stiffness[0] * jnp.abs(velocity) * z[0] / self.limits[0]
        return jnp.stack([first, self.stiffness[1] * (velocity - jnp.abs(velocity) * z[1] / self.limits[1])])

    def coefficient(self, z, velocity):
        return self.stiffness[0] * z[0] + z[1] + 0.3 * velocity

    def steady(self, velocity):
        return sum(self.limits) * jnp.sign(velocity) + 0.3 * velocity


@pytest.mark.slow
def test_a_law_of_ones_own_with_several_states_against_scipy():
    one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, Own()), 0.1, t1=6.0, method=ACCURATE)

    def rates(t, y):
        slip = y[1] - 0.1
        force = 300 * y[2] + y[3] + 0.3 * slip
        bend = slip - 300 * abs(slip) * y[2] / 0.2
        return [y[1], -4 * y[0] - force, bend, 50 * (slip - abs(slip) * y[3] / 0.1)]

    end = solve_ivp(rates, (0, 6), [0, 0, 1e-4, 0.01], "Radau", rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(one.final_state, end, rtol=0, atol=1e-6)
    assert [c.meaning for c in one.system.coordinates[2:]] == ["deflection in m", "load"]
    held = Own().force([0.0, 1.0, 2.0], [0.0, 0.01, 0.02], initial_state=[1e-4, 0.0], rtol=1e-11)
    end = solve_ivp(
        lambda t, y: [0.01 * t * (1 - 300 * y[0] / 0.2), 0.5 * t * (1 - y[1] / 0.1)],
        (0, 2), [1e-4, 0.0], "Radau", rtol=1e-11, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    assert float(held[0]) == pytest.approx(0.03, rel=1e-12)
    assert float(held[-1]) == pytest.approx(300 * end[0] + end[1] + 0.3 * 0.02, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["slip", "ageing"])
def test_without_a_second_evolution_it_is_the_law_of_one_state(form):
    def motion(**second):
        law = ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, form, **second)
        one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, law), 0.12, t1=12.0, y0=(0.55, 0.0), method=ACCURATE)
        at_once = ss.PiecewiseConstant([0.0, 1.0], [0.1, 0.3])
        speeds = jnp.linspace(0.01, 1.0, 9)
        return one.final_state[:3], law.force([0.0, 1.0, 2.0], at_once, rtol=1e-10), law.kinetic(speeds)

    for one, two in zip(motion(), motion(second_evolution=0.0, second_length=0.3), strict=True):
        np.testing.assert_allclose(two, one, rtol=0, atol=2e-7)


def test_steady_friction_has_both_evolutions():
    speeds = jnp.array([0.02, 0.1, 0.7])
    expected = 0.5 + (0.05 - 0.03 - 0.02) * np.log(speeds / 0.1)
    np.testing.assert_allclose(LAW.kinetic(speeds), expected, rtol=1e-9)
    assert float(LAW.kinetic(jnp.asarray(0.7))) == pytest.approx(expected[2], rel=1e-9)


def of_force(numbers):
    law = law_of("slip", *numbers)
    return NORMAL * law.force(jnp.array([0.0, 10.0, 12.0]), ss.PiecewiseConstant([0.0, 10.0], [V0, 5e-6]), rtol=1e-10)


@pytest.mark.slow
def test_derivatives_of_a_force():
    """By b_2 and L_2, against those of the closed form: ``sum of b_i log(v / v_0) (exp(-s / L_i) - 1)``."""
    slip, log = 1e-5, np.log(5.0)
    left = np.exp(-slip / L2)
    found = jax.jit(jax.jacrev(of_force))(jnp.array([B2, L2]))[-1] / NORMAL
    np.testing.assert_allclose(found, [log * (left - 1), B2 * log * left * slip / L2**2], rtol=1e-5)


@pytest.mark.slow
def test_derivatives_of_a_motion():
    """Against central differences, in both modes."""

    def last(numbers):
        law = ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, second_evolution=numbers[0], second_length=numbers[1])
        one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, law), 0.12, t1=5.0, y0=(0.55, 0.0), method=ACCURATE)
        return jnp.stack(one.final_state)

    at, few = jnp.array([0.02, 0.3]), 1e-3
    by_mode = jax.jit(jax.jacrev(last))(at), jax.jit(jax.jacfwd(last))(at)
    for i in range(2):
        change = few * at[i] * jnp.eye(2)[i]
        differences = (np.asarray(last(at + change)) - np.asarray(last(at - change))) / (2 * few * at[i])
        for found in by_mode:
            np.testing.assert_allclose(found[:, i], differences, rtol=0, atol=2e-4 * np.max(np.abs(differences)))


@pytest.mark.slow
def test_an_ensemble_is_single_runs():
    base, key = ss.PoissonSwitching(0.3, rate=0.5), jax.random.key(3)
    method, settings = ss.Regularized(rtol=1e-6, max_steps=4000), {"t1": 10.0, "y0": (0.55, 0.0)}

    def of_law(evolution):
        law = ss.DieterichRuina(0.5, 0.05, 0.03, 0.05, 0.1, "slip", second_evolution=evolution, second_length=0.3)
        return ss.MassSpring(1.0, 1.0, 1.0, law)

    evolutions = np.array([0.0, 0.01, 0.02])
    many = ss.simulate_ensemble(
        of_law(evolutions), base, samples=3, key=key, keep="totals", method=method, progress=False, **settings
    )
    for sample in range(3):
        drawn = base.sample(jax.random.fold_in(key, sample), 10.0)
        one = ss.simulate(of_law(evolutions[sample]), drawn, method=method, **settings)
        assert float(many.totals.stick_time[sample]) == pytest.approx(float(one.stick_time), rel=1e-8)
        assert int(many.totals.sticks[sample]) == int(one.sticks.count)
    assert np.ptp(np.asarray(many.totals.stick_time)) > 0.01


def test_what_does_not_fit_is_told():
    one, two = ss.DieterichRuina(MU, A, B1, L1, V0), {"second_evolution": B2, "second_length": L2}
    times = [0.0, 1.0]
    for make, message in (
        (lambda: ss.DieterichRuina(MU, A, B1, L1, V0, second_evolution=B2), "Argument second_length must be given if"),
        (lambda: ss.DieterichRuina(MU, A, B1, L1, V0, second_length=L2), "Argument second_length must be given if"),
        (
            lambda: ss.DieterichRuina(MU, A, B1, L1, V0, "slip", 0.1, 1.0, **two),
            "Argument normal_stress must be None with second_evolution",
        ),
        (lambda: one.theta(jnp.zeros(2), second=True), "Argument second must be False for a law with one state"),
        (lambda: law_of().force(times, [V0, V0], initial_state=[0.0] * 3), "Argument initial_state must be one number"),
        (lambda: one.force(times, [V0, V0], initial_state=[0.0] * 2), "Argument initial_state"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
