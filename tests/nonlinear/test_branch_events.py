"""What branches of orbits name on their way, against simulations and closed forms; branches of other systems."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import stickslip_jax as ss
from stickslip_jax import nonlinear

FALLING = ss.VelocityWeakening(mu_static=1.0, weakening=3.0)


def _same_when_simulated(branch, system, base, rtol=1e-8):
    """The last orbit of a branch is that of one simulated period from its state."""
    last = branch.points.isel(point=-1)
    names = [coordinate.name.replace(" ", "_") for coordinate in system.coordinates]
    section = nonlinear.stroboscopic_section(
        system, base, y0=[float(last[name]) for name in names], transient=0, kept=1, progress=False
    )
    for name, coordinate in zip(names, system.coordinates, strict=True):
        change = float(section[name][0] - last[name])
        if coordinate.period:
            change -= coordinate.period * round(change / coordinate.period)
        assert change == pytest.approx(0, abs=rtol)


@pytest.mark.slow
def test_flip_where_the_period_doubles():
    def forced(frequency):
        force = ss.Harmonic(amplitude=0.6, angular_frequency=frequency)
        return ss.MassSpring(1.0, 1.0, 1.0, FALLING, damping=0.001, force=force)

    belt = ss.Constant(0.3)
    section = nonlinear.stroboscopic_section(forced(1.54), belt, transient=400, kept=2, progress=False)
    orbit = nonlinear.periodic_orbit(
        forced(1.54), belt, y0=(section.position[-1], section.velocity[-1]), periods=2
    )  # fmt: skip
    branch = nonlinear.continue_orbit(orbit, "angular_frequency", until=1.6)
    flip = next(event for event in branch.events if event.kind == "flip")
    points = branch.points
    assert float(points.multiplier_real[flip.point].min()) > -1 > float(points.multiplier_real[flip.point + 1].min())
    assert bool(points.is_stable[flip.point])
    assert not bool(points.is_stable[flip.point + 1])
    near = flip.parameter + np.array([-1e-3, 1e-3])
    diagram = nonlinear.bifurcation_diagram(
        forced(1.54), belt, {"angular_frequency": near}, transient=4000, kept=64, progress=False
    )
    np.testing.assert_array_equal(diagram.recurrence, [2, 4])


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [0.02, 0.01])
def test_torus_where_the_damping_becomes_negative(amplitude):
    # Under a small force the mass slips on a fast belt; friction falls with the speed by 3 / (1 + 3 v)^2: where that is
    # the damping, a small oscillation grows.
    damping = 0.3
    system = ss.MassSpring(1.0, 1.0, 1.0, FALLING, damping=damping, force=ss.Harmonic(amplitude, 0.63))
    expected = (math.sqrt(3 / damping) - 1) / 3
    orbit = nonlinear.periodic_orbit(system, ss.Constant(1.2), y0=(0.2, 0.0))
    branch = nonlinear.continue_orbit(orbit, "speed", until=0.5)
    event = next(event for event in branch.events if event.kind == "Neimark-Sacker")
    assert event.parameter == pytest.approx(expected, abs=2 * amplitude**2)
    after = branch.points.isel(point=event.point + 1)
    assert np.hypot(after.multiplier_real, after.multiplier_imag).values == pytest.approx([1.0, 1.0], abs=0.1)
    assert not bool(after.is_stable)


class Hardening(ss.SwitchedSystem):
    """A mass on a spring that becomes stiffer, with friction on the ground; the base's velocity is a force."""

    mu: float = 0.02

    @property
    def state_names(self):
        return ("position in m", "velocity in m/s")

    def rates(self, t, y, base, friction):
        return y[1], -y[0] - y[0] ** 3 - 0.1 * y[1] - self.mu * friction + 0.3 * base.velocity

    def relative_velocity(self, t, y, base):
        return y[1]

    @property
    def shortest_time(self):
        return 3.0


@pytest.mark.slow
def test_fold_where_the_amplitude_jumps():
    system = Hardening()
    orbit = nonlinear.periodic_orbit(system, ss.Harmonic(1.0, 1.0), y0=(0.6, 0.0))
    assert bool(orbit.converged)
    branch = nonlinear.continue_orbit(orbit, "angular_frequency", until=2.0, step=0.05)
    folds = [event for event in branch.events if event.kind == "fold"]
    assert len(folds) == 2
    assert branch.ending == "angular_frequency reached 2"
    upper, lower = (fold.parameter for fold in folds)
    assert lower < upper
    points = branch.points
    between = slice(folds[0].point + 1, folds[1].point + 1)
    assert not np.any(points.is_stable[between])
    assert np.all(points.is_stable[: folds[0].point + 1])
    assert np.all(points.is_stable[folds[1].point + 1 :])
    # Followed up and down by simulation, the attractor jumps at these frequencies.
    for edge, direction in ((upper, "up"), (lower, "down")):
        start = points.isel(point=folds[0].point if direction == "up" else folds[1].point + 1)
        diagram = nonlinear.bifurcation_diagram(
            system, ss.Harmonic(1.0, 1.0),
            {"angular_frequency": edge + (-1 if direction == "up" else 1) * np.array([0.01, 1e-3, -1e-3])},
            follow_attractor="up", y0=(float(start.position), float(start.velocity)), transient=1500, kept=2,
            progress=False,
        )  # fmt: skip
        size = np.hypot(diagram.position[:, -1], diagram.velocity[:, -1])
        assert abs(float(size[1] - size[0])) < 0.1
        assert abs(float(size[2] - size[1])) > 0.3


@pytest.mark.slow
def test_branch_of_several_contacts():
    system = ss.LinearStructure(
        np.ones(2), np.array([[2.2, -1.2], [-1.2, 2.2]]), np.array([[0.3, -0.1], [-0.1, 0.3]]),
        contacts=tuple(ss.Contact.of_mass(i, 2, force, ss.Coulomb(0.5)) for i, force in enumerate((1.0, 1.3))),
    )  # fmt: skip
    section = nonlinear.stroboscopic_section(system, ss.Harmonic(1.0, 0.4), transient=200, kept=1, progress=False)
    state = [float(section[coordinate.name.replace(" ", "_")][-1]) for coordinate in system.coordinates]
    orbit = nonlinear.periodic_orbit(system, ss.Harmonic(1.0, 0.4), y0=state)
    branch = nonlinear.continue_orbit(orbit, "angular_frequency", until=0.6)
    assert branch.ending == "angular_frequency reached 0.6"
    _same_when_simulated(branch, system, ss.Harmonic(1.0, 0.6))


@pytest.mark.slow
def test_motor_and_cart_stop_going_round_at_a_fold():
    """Where the branch of the motor's running orbit turns round, simulated motors find no orbit any more."""
    voltage, state = ss.SourceVoltage(), (1.419904861957889, 4.1644170780506125, 2.530596050930892)
    orbit = nonlinear.periodic_orbit(ss.MotorCart(mu=0.2), voltage, y0=state)
    branch = nonlinear.continue_orbit(orbit, "mu", until=0.5, step=0.05)
    (fold,) = branch.events
    assert (fold.kind, branch.ending) == ("fold", "mu reached 0.2")
    points = branch.points
    np.testing.assert_array_equal(points.is_stable, np.arange(points.sizes["point"]) <= fold.point)
    _same_when_simulated(branch, ss.MotorCart(mu=0.2), voltage)
    section = nonlinear.stroboscopic_section(
        ss.MotorCart(), voltage, y0=state, over={"mu": fold.parameter + np.array([-1e-4, 1e-4])}, transient=400,
        kept=2, progress=False,
    )  # fmt: skip
    np.testing.assert_array_equal(section.recurrence, [1, 0])


CUBIC = ss.FrictionCurve(lambda speed: 0.4 - 0.225 * (speed / 0.5 - (speed / 0.5) ** 3 / 3))
EXPONENTIAL = ss.Stribeck(mu=0.5, mu_static=1.0, stribeck_speed=0.5)
HOPF = {
    # A small oscillation about the steady slip neither grows nor decays where friction falls with the speed as fast as
    # the damping rises: 0.45 - 1.8 v^2 = 0.1, and exp(-2 v) = 0.1.
    "supercritical": (CUBIC, 0.36, (0.5, 0.36), None, 0.45, math.sqrt(0.35 / 1.8), ["stick vanishes", "Hopf"]),
    "subcritical": (EXPONENTIAL, 1.3, (1.4, 0.0), 6.3, 1.0, math.log(10) / 2, ["Hopf"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOPF)
def test_a_branch_ends_at_the_hopf_point(name):
    law, speed, y0, period, until, expected, kinds = HOPF[name]
    system = ss.MassSpring(1.0, 1.0, 1.0, law, damping=0.1)
    orbit = nonlinear.periodic_orbit(system, ss.Constant(speed), y0=y0, period=period)
    branch = nonlinear.continue_orbit(orbit, "speed", until=until, step=0.1)
    assert [event.kind for event in branch.events] == kinds
    assert branch.events[-1].parameter == pytest.approx(expected, abs=1e-11)
    assert branch.ending == branch.events[-1].text
    points = branch.points
    assert np.all(np.diff(points.speed) * (until - speed) > 0)  # never back over the same orbits
    assert (name == "subcritical") == (not bool(points.is_stable[-1]))


def _held_by_static_friction(frequency, offset):
    """Where a mass stops again that a base ``A sin`` carries at this `offset` until static friction lets go of it, and
    half a period later: in closed form. None where the force that holds it does not reach the limit.

    A mass of 1 kg on 1 N/m and 0.1 N s/m, friction of 0.3 N, static 0.36 N, a base of 0.5 m/s.
    """
    amplitude, damped = 0.5 / frequency, math.sqrt(1 - 0.05**2)
    force = complex(amplitude * (1 - frequency**2), 0.05)
    if offset + abs(force) < 0.36:
        return None
    phase = math.asin((0.36 - offset) / abs(force))
    begin = (phase - math.atan2(force.imag, force.real)) / frequency
    position, velocity = offset + amplitude * math.sin(frequency * begin) - 0.3, 0.5 * math.cos(frequency * begin)
    sine = (velocity + 0.05 * position) / damped

    def moved(t):
        decay, c, s = math.exp(-0.05 * t), math.cos(damped * t), math.sin(damped * t)
        speed = decay * ((sine * damped - 0.05 * position) * c - (position * damped + 0.05 * sine) * s)
        return 0.3 + decay * (position * c + sine * s), speed - 0.5 * math.cos(frequency * (begin + t))

    times = np.linspace(1e-3, 12, 2401)
    relative = np.array([moved(t)[1] for t in times])
    first = np.flatnonzero((relative[:-1] < 0) & (relative[1:] >= 0))[0]
    end = brentq(lambda t: moved(t)[1], times[first], times[first + 1], xtol=1e-15)
    return -(moved(end)[0] - amplitude * math.sin(frequency * (begin + end)))


def _where_slips_vanish():
    """The fold of this orbit, where two offsets that come back are one, and where the release becomes tangent."""

    def least(frequency):
        return 0.36 - abs(complex(0.5 / frequency * (1 - frequency**2), 0.05))

    def change(frequency, more):
        return _held_by_static_friction(frequency, least(frequency) + more) - least(frequency) - more

    end = brentq(lambda frequency: change(frequency, 1e-15), 0.712, 0.714, xtol=1e-14)

    def largest(frequency):
        return -minimize_scalar(
            lambda more: -change(frequency, more), bounds=(0.005, 0.02), options={"xatol": 1e-10}
        ).fun

    return brentq(largest, 0.7155, 0.7162, xtol=1e-13), end


@pytest.mark.slow
def test_a_branch_ends_where_static_friction_holds_for_ever():
    """It turns round at a fold, and the unstable orbit ends where the force no longer reaches the static limit."""
    fold, end = _where_slips_vanish()
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3, 0.36), damping=0.1)
    base = ss.Harmonic(0.5, 0.5)
    orbit = nonlinear.periodic_orbit(system, base, y0=(0.45, 0.5))
    assert bool(orbit.converged)
    branch = nonlinear.continue_orbit(orbit, "angular_frequency", until=1.6, step=0.05)  # once to -2.58 rad/s
    assert [event.kind for event in branch.events] == ["fold", "slip vanishes"]
    assert branch.events[0].parameter == pytest.approx(fold, abs=1e-9)
    assert branch.events[1].parameter == pytest.approx(end, abs=1e-8)
    assert float(branch.points.angular_frequency[-1]) == pytest.approx(end, abs=1e-6)
    assert "no orbit continues the branch" in branch.ending
    assert set(branch.points.modes.values) == {"- 0 + 0"}


@pytest.mark.slow
def test_an_orbit_of_twice_the_period_ends_where_that_doubles():
    def forced(frequency):
        force = ss.Harmonic(amplitude=0.6, angular_frequency=frequency)
        return ss.MassSpring(1.0, 1.0, 1.0, FALLING, damping=0.001, force=force)

    belt = ss.Constant(0.3)
    section = nonlinear.stroboscopic_section(forced(1.57), belt, transient=400, kept=8, progress=False)
    start = (float(section.position[-1]), float(section.velocity[-1]))
    orbit = nonlinear.periodic_orbit(forced(1.57), belt, y0=start, periods=4)
    branch = nonlinear.continue_orbit(orbit, "angular_frequency", until=1.5, step=0.05)
    assert branch.events[-1].kind == "flip"
    assert "half its period" in branch.ending
    # There the orbit of half the period has a multiplier of -1.
    half = nonlinear.periodic_orbit(
        forced(branch.events[-1].parameter), belt,
        y0=(branch.points.position[-1], branch.points.velocity[-1]), periods=2,
    )  # fmt: skip
    assert np.min(np.abs(np.asarray(half.multipliers) + 1)) < 1e-6
