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
T1 = 200.0  # s

# %% [markdown]
# ## 64 points of friction coefficient and rate

# %%
sweep = papers.parametric_analysis(samples=SAMPLES, t1=T1)
began = time.perf_counter()
results = sweep.run(progress=False)
print(sweep)
print(
    f"{time.perf_counter() - began:.0f} s on this machine; the paper: 55.5 days on sixteen computers, for another grid"
)

# %% [markdown]
# Maps of the mean number of sticks, their mean duration and the share of time spent sticking. Dots would mark values
# with a standard error above a tenth.

# %%
names = ["mean_stick_count", "mean_stick_duration", "stick_fraction", "mean_slip_duration"]
axes = ss.plot.parameter_sweep(results, names)

# %% [markdown]
# The means along each parameter: the paper's two sections, on the rate and on friction. The 95 % confidence intervals
# are narrower than the points at full size; the widest is printed.

# %%
middle = {"mu": float(results.mu[4]), "rate": float(results.rate[4])}
units = {"mu": "", "rate": "/s"}
names = ["mean_stick_count", "mean_stick_duration", "mean_slip_duration", "stick_fraction"]
figure, panels = plt.subplots(2, 4, figsize=(15, 7), layout="constrained")
widest = 0.0
for row, other in zip(panels, ("mu", "rate"), strict=True):
    some = results.sel({other: middle[other]})
    ss.plot.parameter_sweep(some, names, axes=row)
    for panel in row:
        panel.get_legend().remove()
    row[0].set_title(f"at {other} = {middle[other]:.3g}{units[other]}", fontsize=10, loc="left")
    widest = max(widest, *(float((1.96 * some[f"{name}_error"] / some[name]).max()) for name in names))
plt.show()
print(f"95 % confidence intervals: at most {100 * widest:.2f} % of the value to each side")

# %% [markdown]
# ## Histograms, variances and entropies
# Of the number of sticks, of the durations of sticks and slips, and of the instants at which the fifth of each begins,
# along the rate (lambda) and along the friction coefficient. The entropy of the number of sticks is that of the numbers
# themselves, one bin for each. The others are differential entropies, which need no bins: they are lower by `log 2` nat
# where a distribution is half as wide, and may be negative.

# %%
QUANTITIES = {
    "number of sticks": lambda statistics: statistics.stick_count,
    "stick duration": lambda statistics: statistics.duration,
    "slip duration": lambda statistics: statistics.slip_duration,
    "start of the 5th stick": lambda statistics: statistics.order(5).start,
    "start of the 5th slip": lambda statistics: statistics.slips.order(5).start,
}
COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")


def ensemble_at(point, keep="statistics"):
    """The samples of the sweep at this point, again, with all their distributions."""
    return ss.simulate_ensemble(
        papers.belt_oscillator(point["mu"]), ss.PoissonSwitching(papers.BELT_SPEED, point["rate"]), t1=T1,
        samples=SAMPLES, key=jax.random.key(0), y0=(0.0, papers.BELT_SPEED), keep=keep, progress=False,
    )  # fmt: skip


def entropy_of(distribution):
    """Of whole numbers that of the numbers, of others the differential entropy, nat."""
    return distribution.entropy() if distribution.is_whole else distribution.differential_entropy


def draw_section(along, other):
    """Histograms at four values of a parameter, variances and entropies at all eight."""
    values = results[along].values
    points = [{along: float(value), other: middle[other]} for value in values]
    ensembles = [ensemble_at(point) for point in points]
    again = [np.isclose(float(results.mean_stick_count.sel(point)), ss.mean_stick_count(one).value)
             for point, one in zip(points, ensembles, strict=True)]  # fmt: skip
    print(f"along {along}: the sweep's mean number of sticks again at {sum(again)} of {len(again)} points")
    figure, panels = plt.subplots(3, 5, figsize=(17, 9.5), layout="constrained")
    where = f"{along} (1/s)" if along == "rate" else "friction coefficient mu"
    for column, (name, of) in zip(panels.T, QUANTITIES.items(), strict=True):
        found = [of(one.statistics) for one in ensembles]
        shown = [found[number] for number in (0, 2, 4, 7)]
        for color, value, distribution in zip(COLORS, values[[0, 2, 4, 7]], shown, strict=True):
            histogram = distribution.histogram(None if distribution.is_whole else 40)
            edges = histogram.edges - 0.5 * distribution.is_whole
            column[0].stairs(histogram.density, edges, color=color, lw=1.5, label=f"{value:.3g}{units[along]}")
        unit = found[0].unit
        column[0].set_xlabel(name if unit == "1" else f"{name} ({unit})")
        column[0].set_ylabel("probability" if unit == "1" else f"probability density (1/{unit})")
        column[0].set_xlim(left=0, right=max(one.quantile(0.995).value for one in shown if one.number))
        if "slip duration" in name:
            column[0].set_yscale("log")
        squared = "" if unit == "1" else f" ({unit}$^2$)"
        for panel, estimates, label in (
            (column[1], [one.variance for one in found], f"variance{squared}"),
            (column[2], [entropy_of(one) for one in found], "entropy (nat)" if unit == "1" else "diff. entropy (nat)"),
        ):
            ss.plot.curve(
                values, estimates, xlabel=where, ylabel=label, xlog=along == "rate", ylog=panel is column[1], ax=panel
            )
            panel.get_legend().remove()
        numbers = [f"{value:.3g}: {one.variance.value:.4g}, {entropy_of(one).value:.3f}"
                   for value, one in zip(values[[0, 4, 7]], shown[:1] + shown[2:], strict=True)]  # fmt: skip
        print(f"  {name}: variance{squared.replace('$', '')} and entropy (nat) at {along}", "; ".join(numbers))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    title = f"at {other} = {middle[other]:.3g}{units[other]}; bars: 95 % confidence intervals"
    labels = [f"{along} = {label}" for label in labels]
    figure.legend(handles, labels, title=title, loc="outside upper center", ncols=4, frameon=False)
    plt.show()


# %% [markdown]
# Along the rate, at the middle friction coefficient:

# %%
draw_section("rate", "mu")

# %% [markdown]
# Along the friction coefficient, at the middle rate:

# %%
draw_section("mu", "rate")

# %% [markdown]
# The sweep holds the entropies of all 64 points, of histograms in bins that all points share; of the number of sticks,
# one bin for each number. Slips last from a hundredth of a second to a hundred: in such bins most points would have all
# of them in the first few. So here their bins grow with the duration, ten in each decade, at nine of the points.

# %%
for name in ("stick_count", "duration"):
    entropies, bins = results[f"{name}_entropy"], results.sizes[f"{name}_bin"]
    low, high = (entropies.where(entropies == end, drop=True) for end in (entropies.min(), entropies.max()))
    print(f"{name}, {bins} bins: entropy from {float(low.max()):.3f} nat (mu {float(low.mu[0]):.3g}, rate "
          f"{float(low.rate[0]):.3g}/s) to {float(high.max()):.3f} nat (mu {float(high.mu[0]):.3g}, rate "
          f"{float(high.rate[0]):.3g}/s)")  # fmt: skip
edges = np.geomspace(1e-3, T1, 54)  # s
for mu in results.mu.values[[0, 4, 7]]:
    for rate in results.rate.values[[0, 4, 7]]:
        found = ensemble_at({"mu": float(mu), "rate": float(rate)}, keep="sticks").statistics
        counts = np.histogram(found.joint("duration", "slip_duration").y.values, edges)[0]
        shares = counts[counts > 0] / counts.sum()
        print(f"slip duration, mu {mu:.3g}, rate {rate:.3g}/s: entropy {-(shares * np.log(shares)).sum():.3f} nat, "
              f"{len(shares)} of {len(edges) - 1} bins in use")  # fmt: skip

# %% [markdown]
# ## How much each parameter matters
# Elasticities of the mean stick duration: by how many percent it changes when a parameter grows by one percent. Sticks
# appear and vanish as parameters change, so these are corrected derivatives, with standard errors. The start is not
# that of the sweep, in which the mass rests on the belt where this begins forward: at any other speed of the belt that
# rest, which no mean counts, would be gone, so that there is no derivative by the speed. How little the start matters:

# %%
point = {"mu": middle["mu"], "rate": middle["rate"]}
system, law = papers.belt_oscillator(point["mu"]), ss.PoissonSwitching(papers.BELT_SPEED, point["rate"])
means = []
for start, key in ((papers.BELT_SPEED, 0), (papers.BELT_SPEED / 2, 1)):
    one = ss.simulate_ensemble(
        system, law, t1=T1, samples=max(SAMPLES, 1000), key=jax.random.key(key), y0=(0.0, start), progress=False
    )
    means.append(ss.mean_stick_duration(one))
    print(f"start at {start:g} m/s: {means[-1]}")
difference = means[1] - means[0]
print(f"difference: {difference.without_name()}")

# %%
found = ss.sensitivity(
    ss.mean_stick_duration,
    system,
    law,
    wrt=("mu", "stiffness", "mass", "speed", "rate"),
    t1=T1,
    samples=max(SAMPLES, 1000),
    key=jax.random.key(0),
    y0=(0.0, papers.BELT_SPEED / 2),
    elasticity=True,
)
print(found)
ax = ss.plot.tornado(found)
ax.figure.suptitle("start at half the speed of the belt", fontsize=10)
plt.show()

# %% [markdown]
# ## What grows, and what falls
# The conclusions of the analysis: what each mean does along the two sections. It grows, or falls, where every step from
# one value to the next does, by more than three standard errors.

# %%
MEANS = ("mean_stick_count", "mean_stick_duration", "mean_slip_duration", "stick_fraction")
WORDS = {1: "grows", -1: "falls", 0: "stays"}
for along, other in (("rate", "mu"), ("mu", "rate")):
    section = results.sel({other: middle[other]})
    for name in MEANS:
        values, errors = section[name].values, section[f"{name}_error"].values
        z = np.diff(values) / np.hypot(errors[1:], errors[:-1])
        steps = [WORDS[int(np.sign(one)) if abs(one) > 3 else 0] for one in z]
        runs = [word for at, word in enumerate(steps) if at == 0 or word != steps[at - 1]]
        most = section[along].values[values.argmax()]
        print(f"along {along}: {name} {', then '.join(runs)}, from {values[0]:.4g} to {values[-1]:.4g}, "
              f"largest at {most:.3g}{units[along]}")  # fmt: skip

# %% [markdown]
# And by how much: elasticities of the other means at the point in the middle, by the two parameters of the paper. Those
# of slips are central differences.

# %%
settings = {"t1": T1, "samples": max(SAMPLES, 1000), "key": jax.random.key(0), "y0": (0.0, papers.BELT_SPEED / 2)}
for others in ([ss.mean_stick_count, ss.stick_fraction], ss.mean_slip_duration):
    print(ss.sensitivity(others, system, law, wrt=("mu", "rate"), elasticity=True, **settings))
