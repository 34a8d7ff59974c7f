"""Draw the picture of the README: ``python docs/phase_portrait.py``."""

from pathlib import Path

import jax
import matplotlib.pyplot as plt

import stickslip_jax as ss
from stickslip_jax import papers, plot

jax.config.update("jax_enable_x64", True)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.4), layout="constrained")
for ax, ratio in ((left, 1.0), (right, 1.2)):
    setup = papers.square_wave_belt(ratio)
    one = ss.simulate(setup.system, setup.law, t1=setup.t1, y0=setup.y0)
    plot.phase_portrait(one, window=(setup.t1 - 3 * setup.law.period, setup.t1), ax=ax)
    ax.text(0.5, 0.5, f"$r = {ratio}$", transform=ax.transAxes, ha="center", va="center")
plot.save((left, right), Path(__file__).with_name("phase_portrait.png"), dpi=110, overwrite=True)
