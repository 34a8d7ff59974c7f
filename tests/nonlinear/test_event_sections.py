"""States at events: against the sticks of long simulations."""

import math

import jax
import numpy as np
import pytest
from support.turning import FAR, Disc

import stickslip_jax as ss
from stickslip_jax import nonlinear

SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9))
LAW = ss.SquareWave(1.0, 2.6)
LEINE = ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(mu_static=1.0, weakening=3.0))


@pytest.fixture(scope="module")
def one():
    return ss.simulate(SYSTEM, LAW.sample(None, 60 * 2.6), t1=60 * 2.6, y0=(0.3, -0.2))


@pytest.mark.slow
@pytest.mark.parametrize("event", ["stick_start", "stick_end"])
def test_sticks_on_a_square_wave(one, event):
    section = nonlinear.event_section(SYSTEM, LAW, event, y0=(0.3, -0.2), transient=3, kept=10, progress=False)
    mask = np.asarray(one.sticks.mask)
    times = np.asarray(one.sticks.start if event == "stick_start" else one.sticks.end)[mask][3:13]
    np.testing.assert_allclose(section.time, times, atol=1e-9)
    if event == "stick_start":
        np.testing.assert_allclose(section.position, np.asarray(one.sticks.position)[mask][3:13], atol=1e-9)
    np.testing.assert_allclose(np.abs(section.velocity), 1.0, atol=1e-12)
    np.testing.assert_array_equal(section.event, np.arange(4, 14))


@pytest.mark.slow
def test_of_a_system_that_nothing_drives():
    starts = np.array([[1.0, 0.2], [0.0, -1.0]])
    section = nonlinear.event_section(
        LEINE, ss.Constant(0.2), "stick_start", y0=starts, transient=2, kept=3, progress=False
    )
    np.testing.assert_allclose(np.diff(section.time, axis=1), 12.001031294829, atol=1e-10)
    np.testing.assert_allclose(section.position, -0.541006353870, atol=1e-11)
    assert section.time.dims == ("start", "event")


@pytest.mark.slow
@pytest.mark.parametrize("time", [7.3, 20.0])
def test_goes_on_from_any_state_and_time(time):
    """The drive's phase says at which time a motion goes on: in a slip, and in a stick of the mass."""
    drive = ss.Harmonic(1.0, 0.4)
    one = ss.simulate(SYSTEM, drive, t1=80.0, y0=(0.3, -0.2))
    state = tuple(float(number) for number in one.evaluate(time))
    later = ss.Harmonic(1.0, 0.4, phase=0.4 * time)
    section = nonlinear.event_section(SYSTEM, later, "stick_end", y0=state, transient=0, kept=4, progress=False)
    ends = np.asarray(one.sticks.end)[np.asarray(one.sticks.mask)]
    np.testing.assert_allclose(section.time + time, ends[ends > time][:4], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1, -1, 0])
def test_coordinate_through_a_value(direction):
    crossing = nonlinear.Crossing("position", 0.25, direction)
    section = nonlinear.event_section(
        LEINE, ss.Constant(0.2), crossing, y0=(1.0, 0.2), transient=2, kept=4, progress=False
    )
    np.testing.assert_allclose(section.position, 0.25, atol=1e-14)
    one = ss.simulate(LEINE, ss.Constant(0.2), t1=100.0, y0=(1.0, 0.2))
    velocity = np.asarray(one.evaluate(section.time.values)[1])
    np.testing.assert_allclose(section.velocity, velocity, atol=1e-8)
    if direction:
        assert np.all(np.sign(velocity) == direction)
        np.testing.assert_allclose(np.diff(section.time), 12.001031294829, atol=1e-9)
    else:
        np.testing.assert_array_equal(np.sign(velocity), np.sign(velocity[0]) * np.array([1, -1, 1, -1]))


@pytest.mark.slow
@pytest.mark.parametrize(("event", "sign"), [("slip_forward", 1), ("slip_backward", -1)])
def test_direction_of_slips(one, event, sign):
    section = nonlinear.event_section(SYSTEM, LAW, event, y0=(0.3, -0.2), transient=0, kept=20, progress=False)
    times, little = section.time.values, 1e-5
    before, after = (
        np.asarray(jax.jit(lambda t: one.evaluate(t)[1] - one.base_velocity(t))(times + shift))
        for shift in (-little, little)
    )
    assert np.all(sign * after > 0)
    assert np.all(sign * before <= 1e-12)


@pytest.mark.slow
def test_contacts_are_told_apart():
    system = ss.LinearStructure(
        np.ones(2), np.array([[2.2, -1.2], [-1.2, 2.2]]), None,
        contacts=(ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.8)), ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(1.0))),
    )  # fmt: skip
    base = ss.Harmonic(1.0, 0.4)
    one = ss.simulate(system, base, t1=60.0)
    for number in range(2):
        section = nonlinear.event_section(
            system, base, "stick_start", contact=number, transient=1, kept=3, progress=False
        )
        own = one.of_contact(number).sticks
        times = np.asarray(own.start)[np.asarray(own.mask)]
        np.testing.assert_allclose(section.time, times[times > 0][1:4], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1, 0])
def test_many_passages_in_one_period(direction):
    # A fast mass on a slow base passes a value more often in a period than there are slots at first.
    system = ss.MassSpring(1.0, 400.0, 1.0, ss.Coulomb(0.0))
    crossing = nonlinear.Crossing("position", 0.1, direction)
    section = nonlinear.event_section(
        system, ss.Harmonic(0.0, 0.5), crossing, y0=(1.0, 0.0), transient=0, kept=60, progress=False
    )
    turn = math.acos(0.1)
    down, up = turn + 2 * np.pi * np.arange(60), 2 * np.pi * np.arange(1, 61) - turn
    expected = up if direction else np.sort(np.concatenate([up, down]))[:60]
    np.testing.assert_allclose(section.time, expected / 20, atol=1e-10)


@pytest.mark.slow
def test_an_angle_passes_its_value_in_each_turn():
    section = nonlinear.event_section(
        ss.MotorCart(mu=0.5), ss.SourceVoltage(), nonlinear.Crossing("angle", 1.0), transient=1, kept=6, progress=False
    )
    period = ss.MotorCart(mu=0.5).coordinates[0].period
    np.testing.assert_allclose(np.mod(section.angle, period), 1.0, atol=1e-10)
    one = ss.simulate(ss.MotorCart(mu=0.5), ss.SourceVoltage(), t1=float(section.time[-1]) + 1)
    times = np.linspace(0, float(section.time[-1]) + 0.5, 200_001)
    turns = np.floor((np.asarray(one.evaluate(times)[0]) - 1.0) / period)
    passed = times[1:][np.diff(turns) > 0][1:7]
    np.testing.assert_allclose(section.time, passed, atol=2 * times[1])


@pytest.mark.slow
def test_an_angle_does_not_pass_its_value_half_a_turn_away():
    """In either direction, a disc that turns evenly passes it once in each turn."""
    section = nonlinear.event_section(
        Disc(3.0), FAR, nonlinear.Crossing("angle", 1.0, 0), y0=(0.0, 1.5), transient=1, kept=3, progress=False
    )
    np.testing.assert_allclose(section.time, (1 + 2 * np.pi * np.arange(1, 4)) / 1.5, rtol=1e-12)
    np.testing.assert_allclose(section.angle, 1.0, atol=1e-12)


@pytest.mark.slow
def test_events_that_have_not_settled_are_told():
    """A spring whose motion falls by exp(-0.048) in a period of the force: to 1e-6 of it in 290 of them."""
    slow = {"system": ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0), 0.02, force=ss.Harmonic(1.0, 1.3))}
    how = {"base": ss.Constant(0.0), "of": nonlinear.Crossing("velocity"), "kept": 50, "progress": False}
    with pytest.warns(RuntimeWarning, match="1 of 1 motions have not settled within 150 events.* A larger transient"):
        found = nonlinear.event_section(**slow, **how, transient=100)
    assert int(found.recurrence) == -1
    np.testing.assert_allclose(found.velocity, 0, atol=1e-13)
    nonlinear.event_section(**slow, **how, transient=0)  # as it begins: asked for, and no warning
    assert int(nonlinear.event_section(**slow, **how, transient=500).recurrence) == 1


@pytest.mark.slow
def test_events_that_are_missing_are_told():
    with pytest.warns(RuntimeWarning, match="In 1 of 2 cases fewer events were found in 60 periods"):
        section = nonlinear.event_section(
            SYSTEM, LAW, "stick_start", over={"mu": [0.9, 0.01]}, transient=0, kept=3, progress=False
        )
    assert int(section.event_count[1]) == 0
    assert np.all(np.isnan(section.time[1]))
    assert np.all(np.isfinite(section.time[0]))


BAD = {
    "event": ({"of": "stick"}, "Argument of must be 'stick_start', 'stick_end', 'slip_forward' or 'slip_backward'"),
    "coordinate": ({"of": nonlinear.Crossing("speed")}, "Argument of.coordinate must be"),
    "contact": ({"contact": 1}, "Argument contact must be"),
    "kept": ({"kept": 0}, "Argument kept must be"),
    "random": ({"base": ss.PoissonSwitching(1.0, 1.0)}, "Argument base must repeat itself"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input_is_told_in_a_sentence(name):
    given, said = BAD[name]
    with pytest.raises(ValueError, match=said):
        nonlinear.event_section(**({"system": SYSTEM, "base": LAW, "of": "stick_start"} | given), progress=False)


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_crossings_are_told():
    with pytest.raises(ValueError, match="Argument direction must be 1, -1 or 0"):
        nonlinear.Crossing("position", direction=2)
    with pytest.raises(ValueError, match="Argument value must be"):
        nonlinear.Crossing("position", float("nan"))
