"""The figure of the energies, and the regions of a phase portrait where friction feeds energy in."""

import jax
import numpy as np
import pytest
from support.plot import line

import stickslip_jax as ss
from stickslip_jax import plot

BELT = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3))
POISSON = ss.PoissonSwitching(0.3, 1.0).sample(jax.random.key(1), 12.0)


@pytest.fixture(scope="module")
def one():
    return ss.simulate(BELT, POISSON, t1=12.0, y0=(0.1, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("window", [None, (2.0, 9.0)])
def test_lines_are_the_energies(one, window):
    upper, lower = plot.energies(one, window=window)
    assert upper.get_xlim() == (window or (0.0, 12.0))
    times, total = line(upper, "sum").get_data()
    found = one.energies(times)
    for panel, label, values in (
        (upper, "kinetic", found.stored["kinetic"]),
        (upper, "elastic", found.stored["elastic"]),
        (upper, "sum", found.stored["kinetic"] + found.stored["elastic"]),
        (lower, "supplied by base", found.supplied["base"]),
        (lower, "dissipated by friction", found.dissipated["friction"]),
    ):
        np.testing.assert_allclose(line(panel, label).get_ydata(), values, rtol=0, atol=1e-13)
    assert total.min() >= 0
    labels = {drawn.get_label() for drawn in lower.get_lines()}
    assert labels == {"supplied by base", "dissipated by friction"}  # no load, no damper
    sticks = [patch for patch in upper.patches if patch.get_label() == "stick"]
    inside = np.asarray(one.sticks.mask)
    if window is None:
        assert len(sticks) == inside.sum() >= 3
        ends = sorted(patch.get_x() + patch.get_width() for patch in sticks)
        np.testing.assert_allclose(ends, np.asarray(one.sticks.end)[inside], rtol=1e-12)
    assert (upper.get_ylabel(), lower.get_xlabel()) == ("stored energy (J)", "time $t$ (s)")


@pytest.mark.slow
def test_regions_where_friction_feeds_energy_in(one):
    ax = plot.phase_portrait(one, energy_regions=True)
    bounds = sorted((patch.get_y(), patch.get_y() + patch.get_height()) for patch in ax.patches)
    np.testing.assert_allclose(np.sort(bounds), [[-0.3, 0], [0, 0.3]])
    assert "friction feeds energy in" in [text.get_text() for text in ax.get_legend().get_texts()]
    assert not plot.phase_portrait(one).patches
    swinging = ss.simulate(BELT, ss.Harmonic(1.0, 1.0), t1=5.0)
    with pytest.raises(ValueError, match=r"Argument energy_regions must be False .* MassSpring on Harmonic"):
        plot.phase_portrait(swinging, energy_regions=True)


@pytest.mark.slow
def test_friction_force_over_time_and_relative_velocity(one):
    """Coulomb's friction is +-0.3 N in a slip and what the spring needs in a stick."""
    ax = plot.friction_force(one)
    times, force = line(ax, "slip").get_data()
    _, stuck = line(ax, "stick").get_data()
    slipping = ~np.isin(np.arange(len(times)), np.flatnonzero(np.isin(force, stuck[np.isfinite(stuck)])))
    np.testing.assert_allclose(np.abs(force[slipping]), 0.3, rtol=1e-12)
    assert np.nanmax(np.abs(stuck)) <= 0.3
    assert ax.get_ylabel() == "friction force (N)"
    speed, force = line(plot.friction_force(one, over="relative velocity"), "slip").get_data()
    np.testing.assert_allclose(force[np.abs(speed) > 1e-9], -0.3 * np.sign(speed[np.abs(speed) > 1e-9]), rtol=1e-12)
    on_steps = ss.simulate(BELT, ss.SquareWave(1.0, 2.0), t1=8.0)
    speed, _ = line(plot.friction_force(on_steps, over="relative velocity"), "slip").get_data()
    assert np.nanmax(np.abs(np.diff(speed))) < 0.5  # the base jumps by 2 m/s: no line goes there
    with pytest.raises(ValueError, match="Argument over must be one of 'time', 'relative velocity', 'slip', but"):
        plot.friction_force(one, over="velocity")


@pytest.mark.slow
@pytest.mark.parametrize("base", [ss.Harmonic(1.0, np.pi), ss.SquareWave(1.0, 2.0)], ids=["harmonic", "square"])
def test_the_area_of_a_hysteresis_loop_is_what_friction_dissipates(base):
    """The slip is how far the mass has moved beyond the base, whose displacement is known."""
    period, t1 = 2.0, 16.0
    shaken = ss.simulate(BELT, base, t1=t1)
    begin, end = t1 - 1.3 * period, t1 - 0.1 * period
    ax = plot.friction_force(shaken, over="slip", window=(begin, end))
    slip, force = line(ax, "slip").get_data()
    dissipated = np.diff(shaken.energies(np.array([begin, end])).dissipated["friction"])[0]
    area = -np.sum(np.diff(slip) * (force[1:] + force[:-1]) / 2)
    assert area == pytest.approx(dissipated, rel=1e-5)
    (told,) = [text.get_text() for text in ax.get_legend().get_texts() if "energy" in text.get_text()]
    assert told == f"energy lost: {dissipated:.4g} J"
    moved = float(np.diff(shaken.evaluate(np.array([begin, end]))[0])[0])
    of_base = 0.4 if isinstance(base, ss.SquareWave) else np.diff(np.sin(np.pi * np.array([begin, end])))[0] / np.pi
    assert slip[-1] == pytest.approx(moved - of_base, abs=1e-6)
    assert ax.get_xlabel() == "slip (m)"
