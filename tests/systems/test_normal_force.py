"""A `MassSpring` whose normal force is a function of time: closed forms, one that is constant, a structure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

FRICTION = ss.Coulomb(0.4, 0.5)
SMOOTHED = ss.Regularized(1e-3, step=0.01, threshold=1e-3, minimum_duration=0.01)
BASE = ss.SquareWave(0.5, 6.0)


@pytest.mark.slow
def test_a_block_under_a_growing_and_falling_load():
    """Without a spring, on a base at rest: ``m v' = F - mu N(t)`` with N linear in time; integrals by hand.

    N falls from 4 N to 0 in 10 s. From v0 = 1 m/s, with F = 0.5 N, mu = 0.4, mu_static = 0.5, m = 2 kg:
    ``2 v = 2 + 0.5 t - 0.4 (4 t - 0.2 t^2)`` is zero at the smaller root of ``0.08 t^2 - 1.1 t + 2``; static friction
    holds F until ``0.5 (4 - 0.4 t) = 0.5``, at 7.5 s; then ``2 v' = 0.5 - 0.4 (4 - 0.4 t)``.
    """
    load = ss.Recorded([0.0, 10.0], [4.0, 0.0])
    pull = ss.SumOfHarmonics([0.0], [1.0], offset=0.5)
    block = ss.MassSpring(2.0, 0.0, load, FRICTION, force=pull)
    one = ss.simulate(block, ss.Constant(0.0), t1=10.0, y0=(0.0, 1.0))
    assert int(one.status) == ss.Status.FINISHED
    assert int(one.sticks.count) == 1
    stops = (1.1 - np.sqrt(1.1**2 - 4 * 0.08 * 2)) / 0.16
    assert float(one.sticks.start[0]) == pytest.approx(stops, abs=1e-12)
    assert float(one.sticks.end[0]) == pytest.approx(7.5, abs=1e-12)
    path = stops + 0.25 * stops**2 / 2 - 0.2 * (4 * stops**2 / 2 - 0.2 * stops**3 / 3)
    assert float(one.sticks.position[0]) == pytest.approx(path, abs=1e-12)

    def gained(t):
        return 0.5 * t - 0.4 * (4 * t - 0.2 * t**2)

    assert float(one.final_state[1]) == pytest.approx((gained(10.0) - gained(7.5)) / 2, abs=1e-12)


@pytest.mark.slow
def test_a_lifted_mass_swings_freely():
    """No normal force from 2 s on: from there the motion is that of the spring alone."""
    system = ss.MassSpring(1.0, 4.0, ss.ForceSteps([0.0, 2.0], [1.0, -3.0]), FRICTION)
    one = ss.simulate(system, BASE, t1=10.0, y0=(0.5, 0.0))
    (x, v), (end, rate) = (tuple(map(float, one.evaluate(t))) for t in (2.0, 10.0))
    assert end == pytest.approx(x * np.cos(16.0) + v / 2 * np.sin(16.0), abs=1e-10)
    assert rate == pytest.approx(-2 * x * np.sin(16.0) + v * np.cos(16.0), abs=1e-10)
    assert np.all(np.asarray(one.sticks.end)[np.asarray(one.sticks.mask)] <= 2.0)


class Touching(ss.Signal):
    """``1 + cos(t)``, of which no amplitude is known."""

    shortest_period = 2 * np.pi  # pyright: ignore[reportAssignmentType]

    def value(self, t):
        return 1 + jnp.cos(t)


class TwoBlocks(ss.SwitchedSystem):
    """Two masses on springs; the normal force of one touches zero, that of the other is what the first presses."""

    contacts, shortest_time = 2, 1.0  # pyright: ignore[reportAssignmentType]

    @property
    def state_names(self):
        return "position_a", "position_b", "velocity_a", "velocity_b"

    def rates(self, t, y, base, friction):
        return y[2], y[3], -4 * y[0] - friction[0], -4 * y[1] - friction[1]

    def relative_velocity(self, t, y, base):
        return y[2], y[3]

    def normal_forces(self, t, y, base):
        return 1 + jnp.cos(t), 1 - jnp.sin(t) - y[0]


def touching(system: str, omega: float):
    """A system at rest under the normal force ``0.3 + 0.3 cos(omega t)``, and the state in which it is."""
    load = ss.Harmonic(0.3, omega, offset=0.3)
    if system == "mass":
        return ss.MassSpring(1.0, 4.0, load, FRICTION, 0.1), (0.0, 0.0)
    if system == "directional":
        return ss.MassSpring(1.0, 0.0, load, ss.Directional(ss.Coulomb(0.3), ss.Coulomb(0.0))), (0.2, 0.0)
    if system == "blocks":
        contacts = [ss.Contact([1.0, 0.0], load, FRICTION), ss.Contact([1.0, -1.0], load, ss.Coulomb(0.3))]
        return ss.LinearStructure([1.0, 1.3], [[4.0, -1.0], [-1.0, 4.0]], None, contacts), (0.0,) * 4
    return ss.MassSpring(1.0, 0.0, load, ss.Dahl(0.5, 50.0), 0.1), (0.3, 0.0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize("x64", [True, False])
@pytest.mark.parametrize("omega", [1.0, 0.9, np.pi])
@pytest.mark.parametrize("system", ["mass", "directional", "blocks", "bristles"])
def test_one_that_only_touches_zero_does_not_end_a_stick(system, omega, x64):
    with jax.enable_x64(x64):
        still, y0 = touching(system, omega)
        method = ss.Regularized() if system == "bristles" else ss.Exact()
        one = ss.simulate(still, ss.Constant(0.0), t1=20.0, y0=y0, method=method)
    assert int(one.status) == ss.Status.FINISHED
    assert np.asarray(one.sticks.start)[np.asarray(one.sticks.mask)] == pytest.approx(0.0, abs=0)
    assert np.asarray(one.sticks.end)[np.asarray(one.sticks.mask)] == pytest.approx(20.0, abs=0)


@pytest.mark.slow
@pytest.mark.parametrize("knots", [[np.pi, 3 * np.pi], [1.0, 9.0]])
@pytest.mark.parametrize("load", [ss.Harmonic(1.0, 1.0, offset=1.0), Touching()])
def test_one_that_touches_zero_where_a_force_has_a_knot(load, knots):
    """The knots change no force on this contact, which sticks on."""
    force = [None, ss.Recorded([0.0, *knots, 30.0], [0.0, 0.1, 0.2, 0.2])]
    contacts = [ss.Contact([1.0, 0.0], load, FRICTION), ss.Contact([0.0, 1.0], 1.0, FRICTION)]
    one = ss.simulate(
        ss.LinearStructure([1.0, 1.0], [4.0, 4.0], None, contacts, force), ss.Constant(0.0), t1=20.0, y0=(0.0,) * 4
    )
    assert int(one.status) == ss.Status.FINISHED
    assert int(one.of_contact(0).sticks.count) == 1
    assert float(one.of_contact(0).sticks.end[0]) == 20.0


@pytest.mark.slow
def test_contacts_of_a_users_system_touch():
    """``1 - sin(t)`` and ``1 + cos(t)`` are zero at other instants; neither ends its stick."""
    one = ss.simulate(TwoBlocks(), ss.Constant(0.0), t1=20.0, y0=(0.0,) * 4)
    for contact in range(2):
        assert int(one.of_contact(contact).sticks.count) == 1
        assert float(one.of_contact(contact).sticks.duration[0]) == 20.0


@pytest.mark.slow
def test_one_that_reaches_zero_from_below_begins_no_stick():
    """The contact is closed at single instants, in which friction does nothing; with 1e-9 more it is for a while."""
    one, more = (
        ss.simulate(
            ss.MassSpring(1.0, 4.0, ss.Harmonic(size, 1.0, offset=-1.0), FRICTION), BASE, t1=20.0, y0=(0.5, 0.0)
        )
        for size in (1.0, 1 + 1e-9)
    )
    assert int(one.sticks.count) == 0
    assert int(one.near_grazing_count) >= 3  # each of them is told
    assert float(one.final_state[0]) == pytest.approx(0.5 * np.cos(40.0), abs=1e-10)
    assert float(more.final_state[0]) == pytest.approx(0.5 * np.cos(40.0), abs=1e-10)
    still = ss.MassSpring(1.0, 4.0, ss.Harmonic(1 + 1e-9, 1.0, offset=-1.0), FRICTION)
    rests = ss.simulate(still, ss.Constant(0.0), t1=10.0, y0=(0.0, 0.0))
    # cos(t) = 1 / (1 + 1e-9): a stick at the start, half as long as that around 2 pi.
    half = np.sqrt(2e-9)
    assert np.asarray(rests.sticks.duration)[:2] == pytest.approx([half, 2 * half], rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [None, 0.1])
def test_one_that_does_not_vary_is_the_number(damping):
    steady = ss.ForceSteps([0.0, 5.0], [1.3, 1.3])
    number, function = (
        ss.simulate(ss.MassSpring(1.0, 2.0, normal, FRICTION, damping), BASE, t1=30.0, y0=(0.5, 0.0))
        for normal in (1.3, steady)
    )
    count = int(number.sticks.count)
    assert count == int(function.sticks.count) >= 2
    for name in ("start", "end", "position", "slip_displacement"):
        expected, found = (getattr(one.sticks, name)[:count] for one in (number, function))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(function.sticks.ending[:count], number.sticks.ending[:count])


@pytest.mark.slow
def test_derivatives_ensembles_and_sensitivities():
    def system(offset):
        return ss.MassSpring(1.0, 2.0, ss.SumOfHarmonics([0.8], [1.1], offset=offset), FRICTION)

    def end(offset):
        return ss.simulate(system(offset), BASE, t1=20.0, method=ss.Exact(max_steps=4000)).final_state[0]

    slope = (end(0.9 + 1e-6) - end(0.9 - 1e-6)) / 2e-6
    assert float(jax.grad(end)(0.9)) == pytest.approx(float(slope), rel=1e-6)
    law, key = ss.PoissonSwitching(0.5, 1.0), jax.random.key(0)
    many = ss.simulate_ensemble(system(0.9), law, t1=20.0, samples=40, key=key, keep="sticks")
    for sample in range(6):
        mass, base, y0 = many.realization(sample)
        one = ss.simulate(mass, base, t1=20.0, y0=y0)
        count = int(one.sticks.count)
        assert count == int(many.flat_sticks.count[sample])
        np.testing.assert_allclose(many.sticks.start[sample, :count], one.sticks.start[:count], rtol=0, atol=1e-9)
    run = {"t1": 20.0, "samples": 40, "key": key}
    by_offset = ss.sensitivity("stick_fraction", system(0.9), law, wrt="normal_force.offset", step=0.1, **run)
    ends = [ss.stick_fraction(ss.simulate_ensemble(system(offset), law, **run)).value for offset in (0.81, 0.99)]
    assert by_offset.derivative == pytest.approx((ends[1] - ends[0]) / 0.18, rel=1e-9)


def test_bad_arguments():
    with pytest.raises(ValueError, match=r"normal_force must be positive .* has a function of time"):
        ss.MassSpring(1.0, 2.0, -1.0, FRICTION)
    short = ss.MassSpring(1.0, 2.0, ss.Recorded([0.0, 1.0], [1.0, 2.0]), FRICTION)
    with pytest.raises(ValueError, match="normal_force must last until t1 = 3 s"):
        ss.simulate(short, BASE, t1=3.0)
    varying = ss.MassSpring(1.0, 2.0, ss.Harmonic(1.0, 2.0), FRICTION)
    with pytest.raises(ValueError, match="stick_half_width"):
        _ = varying.stick_half_width


# External forces: a number, steps and a function are given as they are; the closed forms are those of any book.


BLOCK = {"mass": 1.0, "stiffness": 4.0, "normal_force": 1.0, "friction": ss.Coulomb(1.0)}


STEPS = ss.ForceSteps([0.0, 1.0], [0.5, 2.5])


def moved_by_a_step(times, begin):
    """From rest under 2.5 N: ``x = (F - mu n) / k (1 - cos(w t))``, until it turns, from where friction holds it."""
    since = np.clip(times - begin, 0.0, np.pi / 2)
    return 0.375 * (1 - np.cos(2 * since))


@pytest.mark.slow
@pytest.mark.parametrize(("force", "begin"), [(2.5, 0.0), (STEPS, 1.0)], ids=["constant", "in steps"])
def test_a_constant_force_moves_the_mass_as_a_step(force, begin):
    times = np.linspace(0.0, 3.0, 9)
    one = ss.simulate(ss.MassSpring(**BLOCK, force=force), 0.0, t1=3.0)
    np.testing.assert_allclose(one.evaluate(times)[0], moved_by_a_step(times, begin), rtol=0, atol=1e-12)
    assert float(one.stick_time) == pytest.approx(3.0 - np.pi / 2, abs=1e-12)


@pytest.mark.slow
def test_steps_of_force_on_a_structure_and_forces_that_differ_from_sample_to_sample():
    times = np.linspace(0.0, 3.0, 9)
    contact = ss.Contact.of_mass(0, 1, 1.0, BLOCK["friction"])
    masses = ss.LinearStructure([1.0], [[4.0]], None, (contact,), (STEPS,))
    found = ss.simulate(masses, 0.0, t1=3.0).evaluate(times)[0]
    np.testing.assert_allclose(found, moved_by_a_step(times, 1.0), rtol=0, atol=1e-9)
    varied = ss.MassSpring(**BLOCK, force=np.array([0.5, 2.5]))
    many = ss.simulate_ensemble(varied, 0.0, t1=3.0, samples=2, keep="totals")
    np.testing.assert_allclose(many.totals.stick_time, [3.0, 3.0 - np.pi / 2], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_function_of_time_is_a_signal(annotations_unchecked):
    harmonic = ss.Harmonic(3.0, 1.0, -np.pi / 2)
    signal = ss.Signal.of(lambda t: 3.0 * jnp.sin(t), shortest_period=2 * np.pi)
    one, other = (ss.simulate(ss.MassSpring(**BLOCK, force=force), 0.2, t1=10.0) for force in (harmonic, signal))
    begins = (run.sticks.start[run.sticks.mask] for run in (one, other))
    np.testing.assert_allclose(*begins, rtol=0, atol=1e-7)
    moved, by = (ss.simulate(ss.MassSpring(**BLOCK), base, t1=10.0) for base in (harmonic, signal))
    np.testing.assert_allclose(moved.final_state, by.final_state, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=r"Argument force must be a number .* make a signal, ss.Signal.of\(function, "):
        ss.MassSpring(**BLOCK, force=lambda t: t)
    with pytest.raises(ValueError, match="the shortest period of the force is not known"):
        ss.simulate(ss.MassSpring(**BLOCK, force=ss.Signal.of(jnp.sin)), 0.2, t1=10.0)
    with pytest.raises(ValueError, match="Argument function must be a function of the time"):
        ss.Signal.of(3.0)
    with pytest.raises(ValueError, match=r"Argument function of Signal\.of"):
        ss.Signal.of(lambda t: np.asarray(t) * 2)


@pytest.mark.slow
def test_a_number_is_a_constant_base_velocity_and_a_force_a_number_to_differentiate_by():
    system = ss.MassSpring(**BLOCK)
    one, other = (ss.simulate(system, base, t1=10.0) for base in (0.2, ss.Constant(0.2)))
    assert one.stick_time == other.stick_time > 0
    slope = jax.grad(lambda force: ss.simulate(ss.MassSpring(**BLOCK, force=force), 0.0, t1=1.0).final_state[0])(2.5)
    assert slope == pytest.approx((1 - np.cos(2.0)) / 4, abs=1e-12)
