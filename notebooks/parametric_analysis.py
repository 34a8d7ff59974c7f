# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The parametric analysis of the statistical model
#
# Lima and Sampaio, *Parametric analysis of the statistical model of the stick-slip process* (J. Sound Vib. 397, 2017):
# how the statistics and histograms of sticks vary with the switching rate of the base (lambda in the paper) and with
# the friction coefficient. The paper's integrations took 55.5 days on a cluster of sixteen computers. The text that
# this notebook is made from ends before the paper's values: oscillator, start and grid are chosen here
# (`papers.parametric_analysis`, `stickslip sweep --paper parametric-analysis`), and no number below is one of the
# paper's.

# %%
import os
import time

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))

# %% [markdown]
# ## 64 points of friction coefficient and rate

# %%
study = papers.parametric_analysis(samples=SAMPLES)
began = time.perf_counter()
results = study.run(progress=False)
print(study)
print(
    f"{time.perf_counter() - began:.0f} s on this machine; the paper: 55.5 days on sixteen computers, for another grid"
)

# %% [markdown]
# Maps of the mean number of sticks, their mean duration and the share of time spent sticking. Dots would mark values
# with a standard error above a tenth.

# %%
names = ["mean_stick_count", "mean_stick_duration", "stick_fraction", "mean_slip_duration"]
axes = ss.plot.parameter_study(results, names)

# %% [markdown]
# The same along each parameter, with 90 % confidence intervals: the paper's two sections, on the rate and on friction.

# %%
middle = {"mu": float(results.mu[4]), "rate": float(results.rate[4])}
figure, panels = plt.subplots(2, 2, figsize=(11, 7.4), layout="constrained")
for row, other in zip(panels, ("mu", "rate"), strict=True):
    some = results.sel({other: middle[other]})
    ss.plot.parameter_study(some, ["mean_stick_count", "mean_stick_duration"], axes=row)
    row[0].set_title(f"{other} = {middle[other]:.3g}", fontsize=10, loc="left")
plt.show()

# %% [markdown]
# ## Histograms and entropies that can be compared
# All points share the bins of their histograms, so that entropies differ only where the distributions do.

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
colors = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
for panel, (along, other) in zip(panels, (("rate", "mu"), ("mu", "rate")), strict=True):
    for color, value in zip(colors, results[along].values[[0, 2, 4, 7]], strict=True):
        point = {along: float(value), other: middle[other]}
        ensemble = ss.simulate_ensemble(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(point["mu"])),
            ss.PoissonSwitching(papers.BELT_SPEED, point["rate"]),
            t1=200.0,
            samples=SAMPLES,
            key=jax.random.key(0),
            y0=(0.0, papers.BELT_SPEED),
            progress=False,
        )
        histogram = ensemble.statistics.stick_count.histogram(40)
        panel.stairs(histogram.density, histogram.edges, color=color, lw=1.5, label=f"{along} = {value:.3g}")
        same = np.isclose(float(results.mean_stick_count.sel(point)), ensemble.statistics.stick_count.mean.value)
        entropy = float(results.stick_count_entropy.sel(point))
        print(
            f"{along} = {value:5.3g}: entropy of the number of sticks {entropy:.3f} nat; the study's mean again: {same}"
        )
    panel.set_xlabel(f"number of sticks in 200 s, {other} = {middle[other]:.3g}")
    panel.set_ylabel("share per whole number")
    panel.legend(frameon=False)
plt.show()

# %% [markdown]
# ## How much each parameter matters
# Elasticities of the mean stick duration: by how many percent it changes when a parameter grows by one percent. Sticks
# appear and vanish as parameters change, so these are corrected derivatives, with standard errors.

# %%
point = {"mu": middle["mu"], "rate": middle["rate"]}
found = ss.sensitivity(
    ss.mean_stick_duration,
    ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(point["mu"])),
    ss.PoissonSwitching(papers.BELT_SPEED, point["rate"]),
    wrt=("mu", "stiffness", "mass", "speed", "rate"),
    t1=200.0,
    samples=max(SAMPLES, 1000),
    key=jax.random.key(0),
    y0=(0.0, 0.5),
    elasticity=True,
)
print(found)
axes = ss.plot.tornado(found)
