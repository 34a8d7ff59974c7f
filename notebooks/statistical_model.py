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
# those of the authors' conference paper. No text gives the rate at which the base turns; 1/s is chosen here, and others
# are tried. No number below is one of the paper's.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))
T1 = 200.0  # s


def simulate(mu, rate, y0=(0.0, papers.BELT_SPEED), key=0):
    """Samples of the oscillator at this friction coefficient and switching rate (1/s), with all their sticks."""
    system, law = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), ss.PoissonSwitching(papers.BELT_SPEED, rate)
    return ss.simulate_ensemble(
        system, law, t1=T1, samples=SAMPLES, key=jax.random.key(key), y0=y0, keep="sticks", progress=False
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
# Each with mean, variance and entropy: every number has a bin of its own. Sticks and slips alternate, so that in one
# sample there are at most one more of the one than of the other.

# %%
statistics = many.statistics
ax = ss.plot.histogram(statistics.stick_count, label="sticks")
ss.plot.histogram(statistics.slip_count, label="slips", ax=ax)
ax.set_xlabel("number of sticks, of slips, in 200 s")
for of in (statistics.stick_count, statistics.slip_count):
    print(of.mean, of.variance, of.entropy(), sep="\n")
totals = many.totals
surplus = np.asarray(totals.slips) - np.asarray(totals.sticks)
print(f"slips less sticks of a sample: {surplus.min()} to {surplus.max()}")

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
# Do the means change with the order by more than chance? The first sticks remember the common start. The tests below
# ask it of whole distributions, not of means only.

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
ss.plot.means_by_order(many, "duration", ax=panels[0])
ss.plot.means_by_order(many, "slip_duration", ax=panels[1])
plt.show()
for of in (statistics.duration, statistics.slips.duration):
    print(of.mean, of.standard_deviation, of.entropy(bins=50), sep="\n")

# %%
for quantity in ("duration", "slip_duration"):
    print(ss.identically_distributed(many, quantity, orders=5), end="\n\n")

# %% [markdown]
# ## A duration that has a probability of its own
# The histogram of all durations has an atom at 0.25 s. It comes from the fixed start, at `x = 0` with the velocity of
# the belt: where the belt begins the other way, the mass slips half around, meets the belt at `x = 0` again after
# `2 atan(omega v / (mu g)) / omega`, and sticks until it leaves the band, unless the base has turned by then. Without a
# fixed start there is no atom.

# %%
omega, edge = 2.0, 0.25  # rad/s; half of the stick band, m
met = 2 * np.arctan(papers.BELT_SPEED / (omega * edge)) / omega
whole = met + edge / papers.BELT_SPEED  # s, in which the base must not turn
numbered = statistics.duration.number / many.samples
print(statistics.duration.repeated_share)
share = np.exp(-whole) / 2
print(f"foretold: exp(-{whole:.3f}) / 2 = {share:.4f} of the samples, {share / numbered:.5f} of all sticks")
anywhere = simulate(1.0, 1.0, y0=(ss.Uniform(-0.5, 0.5), ss.Uniform(-1.0, 1.0)))
print("with random starts:", anywhere.statistics.duration.repeated_share)

# %% [markdown]
# ## Independent and identically distributed?
# The paper's question, of sticks and of slips, at seven points instead of one, from the fourth stick on. Identically
# distributed: are the 4th to the 8th? Each sample gives one of them. The p-values are those of the test of Anderson and
# Darling, which takes all five orders at once, and the smallest of ten of Kolmogorov and Smirnov, one for each pair of
# orders: that is small by chance, and is therefore adjusted, together with the other one (Holm).

# %%
points = ((1.0, 1.0), (2.0, 1.0), (2.0, 0.2), (1.0, 5.0), (0.5, 1.0), (0.5, 0.2), (1.0, 0.2))
ensembles = {point: many if point == (1.0, 1.0) else simulate(*point) for point in points}
adjusted = []
print("                      p of Anderson-   smallest p of ten   p of all,")
print("   mu  rate           Darling          Kolmogorov-Smirnov  adjusted")
for (mu, rate), found in ensembles.items():
    for quantity, name in (("duration", "sticks"), ("slip_duration", "slips")):
        verdict = ss.identically_distributed(found, quantity, orders=range(4, 9))
        together, by_pairs = verdict.tests
        adjusted.append(verdict.p_value)
        told = f"{together.p_value:14.3f} {by_pairs.smallest_p_value:19.3f} {verdict.p_value:10.3f}"
        print(f"{mu:5g} {rate:5g}  {name:6s} {told if together.made else '  not decided: too few end in time'}")

# %% [markdown]
# From which stick, or slip, on? The same tests of five successive orders, from each of the first six on, at mu = 1 and
# rate 1/s; "rejected" is at 1 %, shared among the six.

# %%
for quantity, name in (("duration", "sticks"), ("slip_duration", "slips")):
    p_values = {first: ss.identically_distributed(many, quantity, orders=range(first, first + 5)).p_value
                for first in range(1, 7)}  # fmt: skip
    print(f"{name}: " + ", ".join(f"{first} to {first + 4}: p = {p:.3f}" for first, p in p_values.items()))
    unlike = [first for first, p in p_values.items() if p < 0.01 / len(p_values)]
    since = max(unlike, default=0) + 1
    print(f"{name} are identically distributed from number {since} on, as far as {SAMPLES} samples tell")

# %% [markdown]
# Independent: the rank correlation of values that follow each other, with its standard error: of sticks, of slips, of a
# stick and the slip after it, of a slip and the stick after it. It has mean 0 where they are independent. A star marks
# where independence is rejected, with a chance of 1 % to reject it wrongly; three tests are made for each, of which
# this is one.

# %%
asked = {
    "stick, stick": "duration",
    "slip, slip": "slip_duration",
    "stick, slip": ("duration", "slip_duration"),
    "slip, stick": ("slip_duration", "duration"),
}
print("   mu  rate   " + "".join(f"{name:>22s}  " for name in asked))
rejected = {}
for (mu, rate), found in ensembles.items():
    line = f"{mu:5g} {rate:5g}   "
    for name, quantity in asked.items():
        verdict = ss.independent(found, quantity, first=4, significance=0.01)
        serial = verdict.tests[2]
        rejected[mu, rate, name] = verdict.rejected
        told = f"{serial.effect:.4f} +- {serial.effect_error:.4f}" if serial.made else "not decided"
        line += f"{told:>22s}{' *' if verdict.rejected else '  '}"
    print(line)
for mu, rate in points:
    dependent, open_ = ([name for name in asked if rejected[mu, rate, name] is answer] for answer in (True, None))
    print(f"mu = {mu:g}, rate = {rate:g}/s: independence rejected of {'; '.join(dependent) or 'none'}"
          + (f"; not decided of {'; '.join(open_)}" if open_ else ""))  # fmt: skip

# %% [markdown]
# How they depend: the mean of what follows, given what went before.

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
of_pairs = (statistics.joint("duration", "slip_duration"), statistics.joint("slip_before", "duration"))
names = (
    ("stick duration (s)", "mean duration of the slip after it (s)"),
    ("slip duration (s)", "mean duration of the stick after it (s)"),
)
for panel, joint, (before, after), upto in zip(panels, of_pairs, names, (0.51, 12.0), strict=True):
    means = joint.conditional_mean(25 if upto < 1 else 60)
    centers = (means.edges[1:] + means.edges[:-1]) / 2
    shown = (means.counts > 1) & (centers < upto)
    panel.errorbar(centers[shown], means.mean[shown], means.error[shown], fmt="o", ms=3, lw=1, color="#0072B2",
                   label="mean, bars: standard error")  # fmt: skip
    panel.axhline(float(joint.y.values.mean()), color="black", ls="--", lw=1, label="mean of all")
    panel.set(xlabel=before, ylabel=after)
    panel.legend(frameon=False)
plt.show()

# %% [markdown]
# **Verdict.** The paper asks whether the durations of sticks, those of slips, and the instants at which they start are
# independent and identically distributed. What this run answers is printed below, and how many samples it takes is part
# of the answer: fewer find less, and "not rejected" then means that there are too few.
#
# - *Identically distributed*: the durations are, but for the first stick, which remembers the common start; 60,000
#   samples find no more than 10,000. Instants are not: they increase with their order.
# - *Independent*: durations are not, though nearly so at mu = 1 and rate 1/s, where dependence is weak and is found
#   only between sticks and slips, not among sticks alone nor among slips alone. With 10,000 samples all four kinds of
#   pairs depend at mu = 2 and rate 1/s, a slip on the stick before it most. A renewal process of independent phases is
#   therefore a good approximation at the one point, and a poor one at the other; the transition kernel
#   (`ss.transition_kernel`) needs no such assumption.

# %%
few = [name for name in asked if rejected[1.0, 1.0, name]]
print(f"at mu = 1, rate = 1/s: a renewal process of independent phases {'rejected' if few else 'not rejected'} "
      f"by {SAMPLES} samples; dependence found: {'; '.join(few) or 'none'}")  # fmt: skip
decided = [p for p in adjusted if not np.isnan(p)]
print(f"p-values for equal distributions from the 4th on that are below 0.01 when adjusted: "
      f"{sum(p < 0.01 for p in decided)} of {len(decided)}")  # fmt: skip
other = ss.identically_distributed(simulate(1.0, 1.0, key=1), "slip_duration", orders=range(4, 9))
print(f"slips at mu = 1, rate = 1/s once more, with other random numbers: adjusted p = {other.p_value:.3f}")
for quantity in ("start", "slip_start"):
    print(quantity, ss.independent(many, quantity).tests[0])

# %% [markdown]
# ## How many samples a histogram needs
# The distance in total variation between the joint histograms of two halves of the samples.

# %%
ax = ss.plot.convergence(ss.histogram_convergence(many, "start", "duration"))
