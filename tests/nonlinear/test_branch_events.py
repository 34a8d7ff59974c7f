"""What branches of orbits name on their way, against simulations and closed forms; branches of other systems."""

import math

import numpy as np
import pytest

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
