"""Draws the figures of statistics.md: ``python docs/statistics_figures.py``."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt

import stickslip_jax as ss
from stickslip_jax import papers, plot

HERE = Path(__file__).parent
jax.config.update("jax_enable_x64", True)


def belt(samples: int = 100_000, keep: str = "statistics") -> ss.Ensemble:
    """The default study: a base that flips its velocity once a second on average."""
    return ss.simulate_ensemble(
        papers.belt_oscillator(),
        ss.PoissonSwitching(speed=1.0, rate=1.0),
        t1=200.0,
        samples=samples,
        key=jax.random.key(0),
        y0=(0.0, 1.0),
        keep=keep,
    )


def draw_distributions(many: ss.Ensemble) -> None:
    """Durations of sticks and slips, and their means by order."""
    told = many.statistics
    figure, axes = plt.subplots(2, 2, figsize=(10, 7.4), layout="constrained")
    plot.histogram(told.duration, axes[0, 0])
    plot.histogram(told.slip_duration, axes[0, 1])
    plot.histogram(told.stick_count, axes[1, 0])
    plot.means_by_order(told, ax=axes[1, 1])
    figure.savefig(HERE / "statistics_distributions.png", dpi=110)


def draw_joint(many: ss.Ensemble) -> None:
    """Duration and position of a stick, and sticks over time."""
    axes = plot.joint_histogram(many.statistics.joint("duration", "position"))
    axes[0].figure.savefig(HERE / "statistics_joint.png", dpi=110)
    raster = plot.stick_raster(many, samples=60, t1=40.0)
    raster.figure.savefig(HERE / "statistics_raster.png", dpi=110)


def draw_convergence(many: ss.Ensemble) -> None:
    """An estimate and a joint histogram, against the number of samples."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    plot.convergence(ss.convergence(many, ss.mean_stick_duration), axes[0])
    plot.convergence(ss.histogram_convergence(many), axes[1])
    figure.savefig(HERE / "statistics_convergence.png", dpi=110)


if __name__ == "__main__":
    ensemble = belt()
    draw_distributions(ensemble)
    draw_joint(ensemble)
    draw_convergence(ensemble)
