"""Orbits followed along a parameter: what happens on the way, against closed forms and other programs' results."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve, minimize_scalar
from support.turning import DRAG, FAR, Disc

import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax.nonlinear._continuation import OrbitPoint, _Branch, change_of_modes
from stickslip_jax.nonlinear._orbits import Equations, Evaluated, Mode, count, sequence

BELT = ss.MassSpring(1.0, 1.0, 1.0, ss.Stribeck(mu=0.5, mu_static=1.0, stribeck_speed=0.5), damping=0.1)
LAST_SPEED = 1.836600973
"""m/s: where the stick-slip cycle ends, to 1e-9 (test_where_the_cycle_ends_by_scipy)."""


def _released(speed: float) -> float:
    """How near a mass that the belt released comes to its velocity again, by scipy: negative if it reaches it."""
    from scipy.integrate import solve_ivp  # noqa: PLC0415

    def slip(_, y):
        return y[1], 0.5 + 0.5 * math.exp((y[1] - speed) / 0.5) - y[0] - 0.1 * y[1]

    def fastest(_, y):
        return slip(0, y)[1]

    fastest.direction = -1
    start = (1 - 0.1 * speed, speed)
    done = solve_ivp(slip, (0, 12), start, "DOP853", rtol=1e-12, atol=1e-13, events=fastest)
    (velocity,) = [y[1] for t, y in zip(done.t_events[0], done.y_events[0], strict=True) if t > 1][:1]
    return speed - velocity


def test_where_the_cycle_ends_by_scipy():
    assert brentq(_released, 1.8, 1.9, xtol=1e-12) == pytest.approx(LAST_SPEED, abs=2e-9)


@pytest.mark.slow
def test_stick_slip_cycle_ends_where_it_meets_the_unstable_one():
    orbit = nonlinear.periodic_orbit(BELT, ss.Constant(1.8), y0=(0.5, 1.8))
    branch = nonlinear.continue_orbit(orbit, "speed", until=1.9, step=0.1)
    (event,) = branch.events
    assert event.kind == "stick vanishes"
    assert "turns round" in event.text
    assert event.parameter == pytest.approx(LAST_SPEED, abs=2e-9)
    points = branch.points
    assert branch.ending == "speed reached 1.8"
    assert float(points.speed[-1]) == pytest.approx(1.8)
    before, after = points.isel(point=slice(0, event.point + 1)), points.isel(point=slice(event.point + 1, None))
    assert set(before.modes.values) == {"- 0"}
    assert set(after.modes.values) == {"-"}
    assert np.all(before.is_stable)
    assert not np.any(after.is_stable)
    np.testing.assert_allclose(before.multiplier_real, np.tile([1.0, 0.0], (before.sizes["point"], 1)), atol=1e-8)
    assert np.all(np.diff(before.stick_fraction) < 0)
    # The unstable cycle of the branch's end is that which Newton's method finds there alone.
    found = nonlinear.periodic_orbit(BELT, ss.Constant(1.8), y0=(points.position[-1], points.velocity[-1]), period=6.3)
    assert float(found.period) == pytest.approx(float(points.period[-1]), abs=1e-9)


def _stops_from(b: float) -> float:
    """The friction over force amplitude at which Den Hartog's motion without stops has its first stop.

    Source: Den Hartog, Trans. ASME 53, 1931: the motion is known in closed form; here where its velocity first touches
    zero within half a period.
    """
    gain = 1 / (1 - b * b)
    lag = math.sin(math.pi / b) / (b * (1 + math.cos(math.pi / b)))

    def fastest(ratio):
        amplitude = math.sqrt(gain**2 - (lag * ratio) ** 2)
        phase = math.atan2(-lag * ratio / gain, amplitude / gain)

        def velocity(t):
            own = ratio * math.sin(t) + gain * b * math.sin(phase) * math.cos(t)
            return own - gain * b * math.sin(b * t + phase)

        times = np.linspace(0, math.pi / b, 2001)[1:-1]
        best = times[int(np.argmax([velocity(t) for t in times]))]
        step = times[1] - times[0]
        found = minimize_scalar(
            lambda t: -velocity(t), bounds=(max(best - step, 0), best + step), options={"xatol": 1e-12}
        )
        # At the turn itself the velocity is zero; what counts there is whether it falls.
        slope = ratio - amplitude + amplitude / gain
        return max(-found.fun if found.x > 2 * step else -math.inf, slope)

    return brentq(fastest, 0.01, 0.99 * abs(gain / lag) if abs(gain / lag) < 1 else 0.99, xtol=1e-12)


def test_first_stop_of_den_hartog_in_closed_form():
    b = 0.8
    gain, lag = 1 / (1 - b * b), math.sin(math.pi / b) / (b * (1 + math.cos(math.pi / b)))
    assert _stops_from(b) == pytest.approx(gain * b * b / math.sqrt(1 + b**4 * lag * lag), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("b", [0.8, pytest.param(0.4, marks=pytest.mark.slow)])
def test_stops_of_den_hartog(b):
    system = ss.MassSpring(1.0, 1.0, 0.1, ss.Coulomb(1.0), force=ss.Harmonic(1.0, b))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.0, 0.2))
    branch = nonlinear.continue_orbit(orbit, "normal_force", until=0.95, step=0.05)
    first = branch.events[0]
    assert first.kind == "stick appears"
    assert first.parameter == pytest.approx(_stops_from(b), abs=1e-6)
    assert set(branch.points.modes.values[: first.point + 1]) == {"- +"}
    assert float(branch.points.normal_force[-1]) == pytest.approx(0.95)
    # One stop in each half period; at the low frequency first two, as there is a stop on the way too.
    assert int(branch.points.stick_count[-1]) == 2


def _second_stop(b: float) -> float:
    """The friction over force amplitude at which Den Hartog's motion with one stop in each half period gets another.

    It leaves ``x0`` where ``cos(theta) - x0 = -F`` and stops at ``-x0``, in closed form as he has it. Another slip the
    same way begins there if the force, at its largest, overcomes friction: ``-1 + x0 = -F``.
    """

    def ends(unknown):
        duration, friction = unknown
        gain, start = 1 / (1 - b * b), 1 - friction
        angle = math.acos(min(max(1 - 2 * friction, -1), 1))
        cosine, sine = start - friction - gain * math.cos(angle), gain * b * math.sin(angle)
        forced = gain * math.cos(angle + b * duration), -gain * b * math.sin(angle + b * duration)
        position = friction + forced[0] + cosine * math.cos(duration) + sine * math.sin(duration)
        return [position + start, forced[1] - cosine * math.sin(duration) + sine * math.cos(duration)]

    guesses = itertools.product((5.2, 5.5, 5.8, 6.1), (0.1, 0.2, 0.3, 0.4))
    found = [fsolve(ends, guess, xtol=1e-14, full_output=True) for guess in guesses]
    (friction,) = {
        round(friction, 10)
        for (duration, friction), about, _, _ in found
        if np.max(np.abs(about["fvec"])) < 1e-13 and 4 < duration < 7 and friction > 0.01
    }
    return friction


@pytest.mark.slow
@pytest.mark.parametrize("b", [0.2, 0.25, 0.3])
def test_second_stop_of_den_hartog(b):
    # At 0.2 the branch then has a corner where a stick comes to the instant at which the period begins, and goes on.
    system = ss.MassSpring(1.0, 1.0, 0.9, ss.Coulomb(1.0), force=ss.Harmonic(1.0, b))
    section = nonlinear.stroboscopic_section(system, ss.Constant(0.0), transient=50, kept=1, progress=False)
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(section.position[-1], section.velocity[-1]))
    branch = nonlinear.continue_orbit(orbit, "normal_force", until=0.05)
    first = branch.events[0]
    assert first.kind == "slip appears"  # in the stick
    assert first.parameter == pytest.approx(_second_stop(b), abs=1e-9)
    assert set(branch.points.stick_count.values[: first.point + 1]) == {2}
    assert int(branch.points.stick_count[first.point + 1]) == 4
    assert branch.ending == "normal_force reached 0.05"


def _stop_at_the_turn(b: float) -> float:
    """The friction over force amplitude at which Den Hartog's stop has moved from the midst of the half period to the
    turn: each slip, from stop to turn, then lasts 2 pi, and the force at the turn is that which friction just holds.
    """
    return b * b / (1 - b * b) * math.sin(math.pi * b)


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.2, 0.05, 0.02])
def test_events_do_not_depend_on_the_step(step):
    # At 0.18115 the slip between two stops vanishes in both half periods at once, where a multiplier is 1: the orbit is
    # known to 1e-8 only there, and with it the event to some 1e-6. A long step goes over the first two events at once.
    system = ss.MassSpring(1.0, 1.0, 0.1, ss.Coulomb(1.0), force=ss.Harmonic(1.0, 0.4))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.0, 0.2))
    branch = nonlinear.continue_orbit(orbit, "normal_force", until=0.5, step=step)
    first, *others = branch.events
    assert first.kind == "stick appears"
    assert first.parameter == pytest.approx(_stops_from(0.4), abs=1e-8)
    np.testing.assert_allclose([event.parameter for event in others], _stop_at_the_turn(0.4), atol=4e-6)
    assert others[-1].text.endswith("becomes - 0 + 0")


@pytest.mark.slow
def test_a_long_step_to_the_end_is_shortened():
    system = ss.MassSpring(1.0, 1.0, 0.5, ss.Coulomb(1.0), force=ss.Harmonic(1.0, 0.8))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.8, 1.2))
    branch = nonlinear.continue_orbit(orbit, "normal_force", until=0.82, step=0.4)
    assert branch.ending == "normal_force reached 0.82"
    (event,) = branch.events
    assert event.parameter == pytest.approx(_stops_from(0.8), abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("parameter", "until"), [pytest.param("mu", 1.5, marks=pytest.mark.slow), ("period", 4.5)])
def test_orbits_on_a_square_wave(parameter, until):
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9), damping=0.1), ss.SquareWave(1.0, 5.6)
    section = nonlinear.stroboscopic_section(system, law, transient=300, kept=2, progress=False)
    orbit = nonlinear.periodic_orbit(system, law, y0=(section.position[-1], section.velocity[-1]))
    branch = nonlinear.continue_orbit(orbit, parameter, until=until)
    assert branch.ending == f"{parameter} reached {until:g}"
    if parameter == "mu":
        end = system.__class__(1.0, 4.0, 1.0, ss.Coulomb(until), damping=0.1), law
    else:
        end = system, ss.SquareWave(1.0, until)
        np.testing.assert_allclose(branch.points.period_, branch.points.period, rtol=1e-12)
    last = branch.points.isel(point=-1)
    seen = nonlinear.stroboscopic_section(*end, y0=(last.position, last.velocity), transient=0, kept=1, progress=False)
    np.testing.assert_allclose([seen.position[0], seen.velocity[0]], [last.position, last.velocity], atol=1e-9)


@pytest.mark.slow
def test_flip_and_fold_of_a_spring_without_friction_are_none():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0), damping=0.2, force=ss.Harmonic(1.0, 0.7))
    orbit = nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.0, 0.2))
    branch = nonlinear.continue_orbit(orbit, "angular_frequency", until=1.5, step=0.1)
    assert branch.events == ()
    period = 2 * np.pi / branch.points.angular_frequency
    np.testing.assert_allclose(branch.points.period, period, rtol=1e-12)
    size = np.hypot(branch.points.multiplier_real[:, 0], branch.points.multiplier_imag[:, 0])
    np.testing.assert_allclose(size, np.exp(-0.1 * period), rtol=1e-9)


@pytest.mark.slow
def test_branch_of_a_disc_that_turns():
    """Its orbit closes after one turn, whatever the torque."""
    orbit = nonlinear.periodic_orbit(Disc(3.0), FAR, y0=(0.5, 1.4), period=4.0)
    branch = nonlinear.continue_orbit(orbit, "torque", until=3.1, step=0.5)
    assert branch.ending == "torque reached 3.1"
    np.testing.assert_allclose(branch.points.period, 2 * np.pi * DRAG / branch.points.torque, rtol=1e-12)


class Circle(Equations):
    """The unit circle of a number of the state and a parameter, in place of the equations of an orbit."""

    modes = (Mode((1,), 0.0, 0.5), Mode((0,), 0.5, 1.0))

    def __init__(self):
        self.coordinates, self.driven, self.itemsize = 1, True, 8

    def at(self, unknowns):
        return Evaluated(np.array([np.dot(unknowns, unknowns) - 1]), 2 * unknowns[None], 1.0, self.modes, True)

    def point(self, angle):
        """The point at an angle, its tangent toward larger ones."""
        unknowns = np.array([math.cos(angle), math.sin(angle)])
        return OrbitPoint(unknowns, self.at(unknowns), np.array([-math.sin(angle), math.cos(angle)]), 1)


def test_events_are_located_where_a_branch_turns_far_between_two_points():
    """An event at a right angle, between points at 0 and 120 degrees: straight on from the first, nothing is found."""
    circle = Circle()
    branch = _Branch(circle, np.ones(2), "speed", np.array([1.0, 0.0]), 2.0, 0.1)
    branch._moved(np.array([1.0, 0.0]))
    found, text = branch._located(circle.point(0), circle.point(2 * math.pi / 3), lambda point: point.unknowns[0] > 0)
    assert text == ""
    np.testing.assert_allclose(found.unknowns, [0, 1], atol=1e-9)


def test_a_mode_that_passes_the_begin_of_the_period_is_told():
    """The sequence of modes remains, but that the period begins with another one is a corner of the branch."""
    slips = Circle().point(0)
    sticks = OrbitPoint(slips.unknowns, dataclasses.replace(slips.found, modes=Circle.modes[::-1]), slips.tangent, 1)
    assert change_of_modes(slips, sticks) is None
    assert slips.found.order != sticks.found.order


def test_sequence_of_modes():
    modes = (Mode((1,), 0, 1), Mode((0,), 1, 2), Mode((-1,), 2, 3), Mode((1,), 3, 4))
    assert sequence(modes) == ((-1,), (1,), (0,))
    assert count(modes, 0) == 1
    assert count((Mode((0,), 0, 1),), 0) == 1
    assert count((Mode((0, 1), 0, 1), Mode((0, 0), 1, 2)), 0) == 2


BAD = {
    "orbit": ({"orbit": 3}, "Argument orbit must be a periodic_orbit that has converged, but 3"),
    "parameter": ({"parameter": "mo"}, "Argument over must name one of"),
    "the start": ({"parameter": "y0[0]"}, "Argument parameter must name a number of the system"),
    "a group": ({"parameter": "r"}, "Argument parameter must name a number of the system"),
    "until": ({"until": 1.0}, "Argument until must differ"),
    "until out of bounds": ({"until": -1.0}, "normal_force"),
    "step": ({"step": 0.0}, "Argument step must be positive"),
    "most": ({"most": 0}, "Argument most must be"),
}


@pytest.fixture(scope="module")
def orbit():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.1), damping=0.2, force=ss.Harmonic(1.0, 0.7))
    return nonlinear.periodic_orbit(system, ss.Constant(0.0), y0=(1.0, 0.2))


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input_is_told_in_a_sentence(orbit, name):
    given, said = BAD[name]
    with pytest.raises(ValueError, match=said):
        nonlinear.continue_orbit(**({"orbit": orbit, "parameter": "normal_force", "until": 2.0} | given))
