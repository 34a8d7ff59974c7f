"""Bounds of a motor's sticks as a figure, and excitations beside the state."""

import math

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax.plot import _style

VOLTAGE = ss.SourceVoltage()


@pytest.mark.slow
def test_curves_are_the_bounds_and_break_where_they_are_infinite():
    ax = plot.stick_bounds(ss.MotorCart(), VOLTAGE, mu=(0.2, 0.6))
    low, high = ax.lines
    angles, drawn = low.get_data()
    assert (angles[0], angles[-1]) == (0, 2 * math.pi)
    assert np.nanmax(drawn) == pytest.approx(0.10315, abs=1e-5)  # the paper's table, at pi/2
    held = 0.6 * np.abs(np.sin(angles))
    assert np.array_equal(np.isnan(high.get_ydata()), held > 0.530931)
    assert {low.get_color(), high.get_color()}.isdisjoint({_style.STICK})
    assert low.get_color() != high.get_color()
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == [r"$\mu$ = 0.2", rf"$\mu$ = 0.6, no limit at {100 * np.mean(held > 0.530931):.0f} % of the angles"]


@pytest.mark.slow
def test_one_curve_of_the_system_itself_into_given_axes():
    ax = plt.figure().subplots()
    assert plot.stick_bounds(ss.MotorCart(mu=0.3), ss.RandomPhase(VOLTAGE), ax=ax) is ax
    (line,) = ax.lines
    assert np.nanmax(line.get_ydata()) == pytest.approx(0.2522, abs=1e-4)


def test_bounds_of_others_are_refused(annotations_unchecked):
    belt = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
    with pytest.raises(ValueError, match="must be a MotorCart and a SourceVoltage"):
        plot.stick_bounds(belt, VOLTAGE)
    with pytest.raises(ValueError, match="Argument mu"):
        plot.stick_bounds(ss.MotorCart(), VOLTAGE, mu=[-0.1])


@pytest.mark.slow
def test_history_shows_the_voltage():
    one = ss.simulate(ss.MotorCart(mu=0.5), VOLTAGE, t1=1.0)
    *_, panel = plot.time_history(one)
    assert panel.get_ylabel() == "voltage (V)"
    times, drawn = panel.lines[0].get_data()
    assert drawn == pytest.approx(1.0 + 0.5 * np.sin(10 * times))
    axes = plt.figure().subplots(3)
    assert plot.time_history(one, axes=axes) == tuple(axes)


@pytest.mark.slow
def test_history_shows_the_acceleration_of_the_ground_and_its_band():
    system = ss.MassSpring(mass=1.0, stiffness=10.0, normal_force=9.81, friction=ss.Coulomb(mu=0.1))
    ground = ss.KanaiTajimi(rms=1.5).sample(jax.random.key(0), t1=5.0)
    upper, _, panel = plot.time_history(ss.simulate(system, ground, t1=5.0))
    assert "acceleration" in panel.get_ylabel()
    times, drawn = panel.lines[0].get_data()
    knots = np.asarray(ground.times)
    assert drawn == pytest.approx(np.interp(times, knots, np.asarray(ground.accelerations)), abs=1e-9)
    assert "stick possible" in upper.get_legend_handles_labels()[1]


@pytest.mark.slow
def test_history_shows_the_force():
    force = ss.Harmonic(amplitude=2.0, angular_frequency=1.5)
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.3), force=force)
    *_, panel = plot.time_history(ss.simulate(system, ss.Constant(0.0), t1=5.0))
    times, drawn = panel.lines[0].get_data()
    assert panel.get_ylabel() == "force (N)"
    assert drawn == pytest.approx(2.0 * np.cos(1.5 * times))


def test_a_curve_that_is_zero_throughout_is_seen():
    """It lies on the axis: wider, above the others, not cut in half; and the legend says that there is no stick."""
    ax = plot.stick_bounds(ss.MotorCart(), VOLTAGE, mu=(0.1, 0.2))
    none, some = ax.lines
    assert (none.get_label(), some.get_label()) == (r"$\mu$ = 0.1: no stick", r"$\mu$ = 0.2")
    assert not np.any(none.get_ydata())
    assert none.get_zorder() > some.get_zorder()
    assert not none.get_clip_on()
