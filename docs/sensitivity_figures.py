"""Draws the figure of sensitivity.md: ``python docs/sensitivity_figures.py``."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import plot

LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)
STUDY = {"t1": 200.0, "samples": 20_000, "key": jax.random.key(0), "y0": (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))}


def system(mu: float) -> ss.MassSpring:
    """The oscillator of the papers, at another friction coefficient."""
    return ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=mu))


def main() -> None:
    """Derivatives of the mean stick duration by mu, and its elasticities at one point."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.6, 3.9), layout="constrained")
    curve = [
        ss.sensitivity(ss.mean_stick_duration, system(float(mu)), LAW, wrt="mu", **STUDY)
        for mu in np.linspace(0.42, 2.9, 18)
    ]
    plot.sensitivity_curve(curve, ax=left)
    names = ("mu", "normal_force", "mass", "stiffness", "speed", "rate")
    elasticities = ss.sensitivity(ss.mean_stick_duration, system(0.9), LAW, wrt=names, elasticity=True, **STUDY)
    plot.tornado(elasticities, ax=right)
    figure.savefig(Path(__file__).with_name("sensitivity.png"), dpi=110)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
