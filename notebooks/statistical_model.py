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
# # The statistical model of the stick-slip process
#
# Lima and Sampaio, *Construction of a statistical model for the dynamics of a base-driven stick-slip oscillator*
# (Mech. Syst. Signal Process. 91, 2017): a base runs forward or backward and turns at the points of a Poisson process.
# The paper's model of the motion: how many sticks and slips there are in a time interval, when they begin, how long
# they last; moments, entropies and histograms of each; and whether durations are independent and identically
# distributed. The text that this notebook is made from ends before the paper's values: mass, spring and belt here are
# those of the authors' conference paper, and no number below is one of the paper's.

# %%
import os

import jax
import matplotlib.pyplot as plt

import stickslip_jax as ss
from stickslip_jax import papers

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))
T1 = 200.0  # s


def simulate(mu, rate, samples=SAMPLES):
    """Samples of the oscillator at this friction coefficient and switching rate (1/s), with all their sticks."""
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), ss.PoissonSwitching(papers.BELT_SPEED, rate)
    return ss.simulate_ensemble(
        system, law, t1=T1, samples=samples, key=jax.random.key(0), y0=(0.0, 1.0), keep="sticks", progress=False
    )


many = simulate(1.0, 1.0)
many.summary()

# %% [markdown]
# ## One realisation, and sixty

# %%
system, base, y0 = many.realization(0)
one = ss.simulate(system, base, t1=T1, y0=y0)
axes = ss.plot.time_history(one, window=(0.0, 40.0))

# %%
ax = ss.plot.stick_raster(many, samples=60, window=(0.0, 60.0))

# %% [markdown]
# ## How many sticks and slips
# Each with mean, variance and the entropy of its histogram. Slips are one more than sticks, or as many, or one fewer.

# %%
statistics = many.statistics
ax = ss.plot.histogram(statistics.stick_count, label="sticks")
ss.plot.histogram(statistics.slip_count, label="slips", ax=ax)
ax.set_xlabel("number of sticks, of slips, in 200 s")
for of in (statistics.stick_count, statistics.slip_count):
    print(of.mean, of.variance, of.entropy(bins=50), sep="\n")

# %% [markdown]
# ## When they begin, and how long they last
# The second, third, fifth and tenth stick, and slip; their histograms share their bins.

# %%
figure, panels = plt.subplots(2, 2, figsize=(11, 7), layout="constrained")
colors = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
for row, of, name in zip(panels, (statistics, statistics.slips), ("stick", "slip"), strict=True):
    orders = {number: of.order(number) for number in (2, 3, 5, 10)}
    for panel, quantity in zip(row, ("start", "duration"), strict=True):
        values = {number: getattr(order, quantity) for number, order in orders.items()}
        bins = ss.common_bins(list(values.values()))
        for color, (number, distribution) in zip(colors, values.items(), strict=True):
            histogram = distribution.histogram(bins)
            panel.stairs(histogram.density, histogram.edges, color=color, lw=1.5, label=f"{name} {number}")
        panel.set_xlabel(f"{name} {quantity} (s)")
        panel.set_ylabel("probability density (1/s)")
        panel.legend(frameon=False)
plt.show()

# %% [markdown]
# ## By order, and all together
# From the fourth stick on, the mean duration no longer changes.

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
ss.plot.means_by_order(many, "duration", ax=panels[0])
ss.plot.means_by_order(many, "slip_duration", ax=panels[1])
plt.show()
for of in (statistics.duration, statistics.slips.duration):
    print(of.mean, of.standard_deviation, of.entropy(bins=50), sep="\n")

# %% [markdown]
# ## Independent and identically distributed?
# The paper's question, asked at seven points instead of one. Identically distributed: the durations of the 4th to the
# 8th stick, each sample giving one of them. Independent: the serial rank correlation of durations that follow each
# other; it has mean 0 where they are independent.

# %%
points = ((1.0, 1.0), (2.0, 1.0), (2.0, 0.2), (1.0, 5.0), (0.5, 1.0), (0.5, 0.2), (1.0, 0.2))
print("   mu  rate   identical from the 4th: p   serial rank correlation   independent")
for mu, rate in points:
    found = many if (mu, rate) == (1.0, 1.0) else simulate(mu, rate)
    identical = ss.identically_distributed(found, orders=range(4, 9))
    independent = ss.independent(found, first=4)
    serial = independent.tests[2]
    answer = "rejected" if serial.p_value < 0.01 else "not rejected"
    correlation = f"{serial.effect:9.4f} +- {serial.effect_error:.4f}"
    print(f"{mu:5g} {rate:5g}   {identical.p_value:24.3f}   {correlation}      {answer}")

# %% [markdown]
# **Verdict.** A renewal process of independent, equal durations describes the sticks from the fourth on at the
# authors' own parameters; it does not where friction is large or the base turns often: there a long stick tends to
# follow a long one. Instants, which the paper asks about too, increase with their order, so they are neither
# independent nor identically distributed; their differences are what may be.

# %%
print(ss.independent(many, "slip_start").tests[0])

# %% [markdown]
# ## How many samples a histogram needs
# The distance in total variation between the joint histograms of two halves of the samples.

# %%
ax = ss.plot.convergence(ss.histogram_convergence(many, "start", "duration"))
