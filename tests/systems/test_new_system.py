"""A new system in one file: simulated, in ensembles, differentiated, drawn and stored like those of the package."""

import math
from typing import Annotated

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import plot

mpl.use("Agg")


class DuffingBelt(ss.SwitchedSystem):
    """A mass on a hardening spring, ``mass x'' + stiffness x + cubic x^3 = -friction``, dragged by a belt."""

    mass: Annotated[float, ss.Quantity("kg", above=0)] = 1.0
    stiffness: Annotated[float, ss.Quantity("N/m", above=0)] = 1.0
    cubic: float = 2.0  # N/m^3
    normal_force: float = 1.0  # N
    mu: float = 0.5
    mu_static: float = 0.9

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        pull = self.stiffness * y[0] + self.cubic * y[0] ** 3
        return y[1], (-pull - friction * self.mu * self.normal_force) / self.mass

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def static_ratio(self):
        return self.mu_static / self.mu

    @property
    def shortest_time(self):
        return 2 * math.pi * (self.mass / (self.stiffness + 6 * self.cubic)) ** 0.5

    @property
    def speed_scale(self):
        return self.mu * self.normal_force / self.mass * self.shortest_time

    @property
    def coordinates(self):
        return ss.Coordinate("position", "m", "x"), ss.Coordinate("velocity", "m/s", r"\dot x")

    @property
    def look(self):
        return ss.plot.Look("mass", stick_band=self.band)

    @property
    def edge(self):
        """Where friction can just hold it, m: ``cubic x^3 + stiffness x = mu_static normal_force`` (Cardano)."""
        size = (self.stiffness / (3 * self.cubic)) ** 0.5
        share = 1.5 * self.mu_static * self.normal_force / (self.stiffness * size)
        return 2 * size * jnp.sinh(jnp.arcsinh(share) / 3)

    def band(self, times, state, velocity, acceleration, ground):
        return jnp.full_like(times, -self.edge), jnp.full_like(times, self.edge)


SYSTEM, SPEED, TIMES = DuffingBelt(), 0.2, np.linspace(0, 3, 31)
RANDOM_STARTS = (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))


@pytest.fixture(scope="module")
def one():
    return ss.simulate(SYSTEM, ss.Constant(SPEED), t1=20.0)


@pytest.fixture(scope="module")
def many():
    law = ss.PoissonSwitching(SPEED, 0.3)
    return ss.simulate_ensemble(
        SYSTEM, law, t1=20.0, samples=200, key=jax.random.key(0), y0=RANDOM_STARTS, keep="sticks"
    )


def test_its_numbers_are_checked():
    with pytest.raises(ValueError, match=r"Argument mass must be positive \(in kg\), but -1.0 was given\."):
        DuffingBelt(mass=-1.0)
    with pytest.raises(ValueError, match=r"Argument cubic must be finite, but nan was given\."):
        DuffingBelt(cubic=math.nan)


@pytest.mark.slow
def test_sticks_of_the_limit_cycle(one):
    """A stick ends where the spring pulls with mu_static n; it began where the slip's energy has the same value:
    ``stiffness x^2 / 2 + cubic x^4 / 4 - mu n x`` (the mass is behind the belt).
    """
    s, edge = SYSTEM, float(SYSTEM.edge)
    energy = np.polynomial.Polynomial([0.0, -s.mu * s.normal_force, s.stiffness / 2, 0.0, s.cubic / 4])
    roots = (energy - energy(edge)).roots()
    begin = min(root.real for root in roots if abs(root.imag) < 1e-9)
    later = np.flatnonzero(np.asarray(one.sticks.mask))[1:-1]
    assert len(later) >= 2
    np.testing.assert_allclose(one.sticks.position[later], begin, atol=1e-9)
    np.testing.assert_allclose(one.sticks.duration[later], (edge - begin) / SPEED, atol=1e-8)
    np.testing.assert_allclose(one.evaluate(one.sticks.end[later])[0], edge, atol=1e-9)


@pytest.mark.slow
def test_regularized_agrees():
    """Regularised dynamics has no static friction of its own: with equal coefficients, up to the first release."""
    system, how = DuffingBelt(mu_static=0.5), {"t1": 3.0, "y0": (0.6, 0.0)}
    exact = ss.simulate(system, ss.Constant(SPEED), **how)
    smooth = ss.simulate(system, ss.Constant(SPEED), method=ss.Regularized(1e-5), **how)
    assert smooth.sticks.count == exact.sticks.count == 1
    np.testing.assert_allclose(smooth.evaluate(TIMES)[0], exact.evaluate(TIMES)[0], atol=1e-3)


@pytest.mark.slow
def test_ensemble_is_the_simulations(many):
    _, base, y0 = many.realization(7)
    alone = ss.simulate(SYSTEM, base, t1=20.0, y0=y0)
    kept = np.asarray(many.sticks.start[7])[np.asarray(many.sticks.mask[7])]
    np.testing.assert_array_equal(kept, np.asarray(alone.sticks.start)[np.asarray(alone.sticks.mask)])
    assert ss.mean_stick_count(many).value > 1


@pytest.mark.slow
def test_samples_with_numbers_of_their_own():
    """Also in fields of which only the type is known."""
    law, springs = ss.PoissonSwitching(SPEED, 0.3), np.linspace(1.0, 3.0, 8)
    system = DuffingBelt(stiffness=ss.Uniform(0.5, 1.5), cubic=springs)
    many = ss.simulate_ensemble(system, law, t1=20.0, samples=8, key=jax.random.key(0), keep="sticks")
    np.testing.assert_array_equal(many.input_values["cubic"], springs)
    own, base, y0 = many.realization(5)
    assert (own.cubic, own.stiffness) == (springs[5], many.input_values["stiffness"][5])
    alone = ss.simulate(own, base, t1=20.0, y0=y0)
    kept = np.asarray(many.sticks.start[5])[np.asarray(many.sticks.mask[5])]
    np.testing.assert_allclose(kept, np.asarray(alone.sticks.start)[np.asarray(alone.sticks.mask)], rtol=1e-12)
    with pytest.raises(ValueError, match=r"cubic must hold one number for each of the 9 samples, but an array of 8"):
        ss.simulate_ensemble(system, law, t1=20.0, samples=9, key=jax.random.key(0))


@pytest.mark.slow
def test_derivative_of_an_event():
    """The first stick begins at x = 0 and ends at the edge: d edge / d mu_static = n / (stiffness + 3 cubic edge^2)."""

    def release(mu_static):
        method = ss.Exact(max_steps=512)
        one = ss.simulate(DuffingBelt(mu_static=mu_static), ss.Constant(SPEED), t1=5.0, y0=(0.0, SPEED), method=method)
        return one.sticks.end[0]

    s = SYSTEM
    slope = s.normal_force / (s.stiffness + 3 * s.cubic * s.edge**2) / SPEED
    assert jax.jacfwd(release)(0.9) == pytest.approx(float(slope), rel=1e-8)


@pytest.mark.slow
def test_derivative_of_a_mean():
    """The stick fraction by mu, against differences with another key."""
    options = {"wrt": "mu", "t1": 20.0, "samples": 2_000, "y0": RANDOM_STARTS}
    system, law = DuffingBelt(mu_static=0.5), ss.PoissonSwitching(SPEED, 0.3)
    exact = ss.sensitivity(ss.stick_fraction, system, law, key=jax.random.key(1), **options)
    differences = ss.sensitivity(ss.stick_fraction, system, law, key=jax.random.key(2), step=0.005, **options)
    assert exact.estimator == "corrected"
    z = (exact.derivative - differences.derivative) / math.hypot(exact.standard_error, differences.standard_error)
    assert abs(z) < 4


@pytest.mark.slow
def test_figures(one, many):
    """Drawn and labelled like the package's own."""
    upper, lower = plot.time_history(one)
    assert [panel.get_ylabel() for panel in (upper, lower)] == ["position $x$ (m)", r"velocity $\dot x$ (m/s)"]
    assert {line.get_label() for line in upper.lines} == {"mass", "mass, stick"}
    base = next(line for line in lower.lines if line.get_label() == "base")
    assert np.all(base.get_ydata() == SPEED)
    (band,) = upper.collections
    assert np.abs(band.get_paths()[0].vertices[:, 1]).max() == pytest.approx(SYSTEM.edge)
    portrait = plot.phase_portrait(one)
    assert (portrait.get_xlabel(), portrait.get_ylabel()) == ("position $x$ (m)", r"velocity $\dot x$ (m/s)")
    (stick,) = [line for line in portrait.lines if line.get_label() == "stick"]
    drawn = stick.get_ydata()
    np.testing.assert_allclose(drawn[np.isfinite(drawn)], SPEED, atol=1e-9)
    shown = plot.stick_map(many)
    assert shown.get_xlabel() == "position $x$ where the stick begins (m)"
    with pytest.raises(ValueError, match=r"abscissa must be 'position' for a DuffingBelt"):
        plot.phase_portrait(one, abscissa="position_times_omega")
    with pytest.raises(ValueError, match=r"period must be pi or 2 pi .* for a DuffingBelt"):
        plot.stick_map(many, period=math.pi)


@pytest.mark.slow
def test_stored(many, tmp_path):
    stored = many.to_xarray()
    assert stored["stick_position"].attrs == {"long_name": "position when the stick starts", "units": "m"}
    many.write_sticks(tmp_path / "sticks.csv")
    header = (tmp_path / "sticks.csv").read_text().splitlines()[0]
    assert "position" in header


class Turntable(DuffingBelt):
    """The same, its position counted in turns of its own."""

    @property
    def coordinates(self):
        return ss.Coordinate("place", "m", "x", period=0.25), ss.Coordinate("velocity", "m/s")


@pytest.mark.slow
def test_any_period_is_drawn():
    turning = ss.simulate(Turntable(), ss.Constant(SPEED), t1=20.0)
    ax = plot.phase_portrait(turning)
    assert ax.get_xlim() == (0, 0.25)
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["0", "0.0625", "0.125", "0.1875", "0.25"]
    drawn = np.concatenate([line.get_xdata() for line in ax.lines])
    assert np.nanmin(drawn) >= 0
    assert np.nanmax(drawn) <= 0.25
