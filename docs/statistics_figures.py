"""Draws the figures of statistics.md: ``python docs/statistics_figures.py``."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers, plot

HERE = Path(__file__).parent
jax.config.update("jax_enable_x64", True)


def belt(samples: int = 100_000, keep: str = "statistics") -> ss.Ensemble:
    """The default study: a base that flips its velocity once a second on average."""
    return ss.simulate_ensemble(
        papers.belt_oscillator(mu=0.8),
        ss.PoissonSwitching(speed=1.0, rate=1.0),
        t1=200.0,
        samples=samples,
        key=jax.random.key(0),
        y0=(0.0, 1.0),
        keep=keep,
    )


def draw_distributions(many: ss.Ensemble) -> None:
    """Durations of sticks and slips, stick counts, and mean durations by order."""
    statistics = many.statistics
    figure, axes = plt.subplots(2, 2, figsize=(10, 7.4), layout="constrained")
    plot.histogram(statistics.duration, ax=axes[0, 0])
    plot.histogram(statistics.slip_duration, ax=axes[0, 1])
    plot.histogram(statistics.stick_count, ax=axes[1, 0])
    plot.means_by_order(many, ax=axes[1, 1])
    figure.savefig(HERE / "statistics_distributions.png", dpi=110)


def draw_joint(many: ss.Ensemble) -> None:
    """Joint histogram of duration and position, and the sticks of 60 samples over time."""
    axes = plot.joint_histogram(many.statistics.joint("duration", "position"))
    axes[0].figure.savefig(HERE / "statistics_joint.png", dpi=110)
    raster = plot.stick_raster(many, samples=60, window=(0.0, 40.0))
    raster.figure.savefig(HERE / "statistics_raster.png", dpi=110)


def draw_convergence(many: ss.Ensemble) -> None:
    """An estimate, and the distance between joint histograms, against the number of samples."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    plot.convergence(ss.convergence(ss.mean_stick_duration, many), ax=axes[0])
    plot.convergence(ss.histogram_convergence(many), ax=axes[1])
    figure.savefig(HERE / "statistics_convergence.png", dpi=110)


def draw_parameters() -> None:
    """The stick fraction of the random belt against the frequency ratio, and a map over friction and rate."""
    figure, axes = plt.subplots(1, 2, figsize=(10.6, 4.2), layout="constrained")
    ratios, fractions = np.linspace(0.2, 3.0, 57), []
    for ratio in ratios:
        setup = papers.random_belt(float(ratio))
        many = ss.simulate_ensemble(
            setup.system, setup.law, t1=setup.t1, y0=setup.y0, samples=4096, key=jax.random.key(1)
        )
        fractions.append(many.statistics.stick_fraction)
    plot.stick_fraction_curve(ratios, fractions, ax=axes[0])

    frictions, rates = np.linspace(0.2, 3.0, 29), np.linspace(0.1, 3.0, 30)
    durations = np.array([[_mean_duration(float(mu), float(rate)) for rate in rates] for mu in frictions])
    labels = {"xlabel": r"friction coefficient $\mu$ (dimensionless)", "ylabel": r"switching rate $\lambda$ (1/s)"}
    plot.parameter_map(frictions, rates, durations, **labels, label="mean stick duration (s)", ax=axes[1])
    figure.savefig(HERE / "statistics_parameters.png", dpi=110)


def _mean_duration(mu: float, rate: float) -> float:
    many = ss.simulate_ensemble(
        ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=mu)),
        ss.PoissonSwitching(speed=1.0, rate=rate),
        t1=200.0,
        samples=1024,
        key=jax.random.key(2),
        y0=(0.0, 1.0),
        keep="totals",
    )
    return ss.mean_stick_duration(many).value


if __name__ == "__main__":
    ensemble = belt()
    draw_distributions(ensemble)
    draw_joint(ensemble)
    draw_convergence(ensemble)
    draw_parameters()
