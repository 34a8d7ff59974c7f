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
# # Calibration to observed sticks
#
# An experiment has recorded when a mass sticks to its base and when it slips, but not where. Which friction coefficient
# and which switching rate of the base explain the recordings, and how well do they determine them? Here the
# observations come from a simulation with known parameters, so that the answer can be checked.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "4096"))
SAMPLES = max(2048, SAMPLES)  # of each simulation in the fit: with fewer its derivatives are too noisy
T1, START = 60.0, (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))

# %% [markdown]
# ## What was observed
# Three experiments, each at a known speed of the base, 400 recordings of 60 s. A table of starts and durations is all
# that is kept; `Ensemble.from_sticks` makes an ensemble of it, with all statistics.

# %%
TRUE = np.array([1.2, 0.9])  # friction coefficient, and rate in 1/s
SPEEDS = (0.7, 1.0, 1.4)  # m/s
RECORDINGS = 400


def simulated(parameters, speed, key, samples):
    """The oscillator of the experiments at a friction coefficient and rate."""
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=parameters[0]))
    law = ss.PoissonSwitching(speed=speed, rate=parameters[1])
    return ss.simulate_ensemble(
        system, law, t1=T1, samples=samples, key=key, y0=START, keep="sticks", progress=False
    )  # fmt: skip


def observe(number):
    """The recordings of each experiment as measured sticks; `number`: which repetition."""
    found = []
    for at, speed in enumerate(SPEEDS):
        key = jax.random.fold_in(jax.random.key(7), 10 * number + at)
        sticks = simulated(TRUE, speed, key, RECORDINGS).finished_sticks()
        table = {"sample": sticks.sample, "start": sticks.start, "duration": sticks.duration}
        found.append(ss.Ensemble.from_sticks(table, t1=T1, samples=RECORDINGS))
    return found


observed = observe(0)
for speed, one in zip(SPEEDS, observed, strict=True):
    print(f"base speed {speed} m/s, {one.statistics.duration.number} sticks: {ss.mean_stick_duration(one)}")

# %% [markdown]
# ## What can be found out
# The oscillator has no length of its own but `mu n / k`. If friction coefficient, base speed and start are all doubled,
# so are all positions and velocities, and every stick begins and ends at the same instants. Times alone cannot tell
# `mu` from the base speed: one must be known. Here it is the speed.

# %%
single = simulated(TRUE, 1.0, jax.random.key(3), 100)
double = ss.simulate_ensemble(
    ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=2 * TRUE[0])),
    ss.PoissonSwitching(speed=2.0, rate=TRUE[1]),
    t1=T1, samples=100, key=jax.random.key(3), y0=(ss.Uniform(-1.0, 1.0), ss.Uniform(-1.0, 1.0)), keep="sticks",
    progress=False,
)  # fmt: skip
same = np.array_equal(single.finished_sticks().duration, double.finished_sticks().duration)
print(f"mu, speed and start doubled: the same durations to the last bit: {same}")

# %% [markdown]
# ## The fit
# `ss.calibrate_sticks` finds the parameters with which simulations have the mean durations that were observed at the
# three speeds. It weights them by their errors and adds those of the simulations. The derivatives it needs are
# corrected for sticks that appear and vanish.

# %%
KEY = jax.random.key(1)


def calibrated(data, key, moments):
    """The fit to the recordings of all experiments, from guesses that are far off."""
    guess = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.7))
    laws = [ss.PoissonSwitching(speed=speed, rate=0.5) for speed in SPEEDS]
    return ss.calibrate_sticks(
        guess, laws, data, wrt=("mu", "rate"), samples=SAMPLES, key=key, y0=START, moments=moments
    )


found = calibrated(observed, KEY, [ss.mean_stick_duration])
print(found)
for name, true in zip(found, TRUE, strict=True):
    print(f"{name}: the truth is {abs(found[name] - true) / found[name].standard_error:.1f} standard errors away")

# %% [markdown]
# Three mean durations determine two parameters, with one degree of freedom left for Hansen's test of the model. More is
# known of the recordings: by default the fit takes their total stick times, numbers of sticks, squared durations and
# first starts, and is more certain.

# %%
whole = calibrated(observed, KEY, None)
for name in found:
    print(f"{found[name]} from mean durations, {whole[name].without_name()} from {len(whole.moments)} moments")
    low, high = whole[name].interval(0.95)
    print(f"{name}: with 95 % confidence between {low:.3f} and {high:.3f}")

# %% [markdown]
# These intervals rest on Gaussian errors. Credible intervals by a sampler are in the notebooks `posterior` (of a record
# of motion, `np.quantile` of the draws of numpyro) and `abc` (of sticks).

# %% [markdown]
# ## The derivative
# Beside the corrected derivative the naive one: what JAX makes of the mean over simulated sticks, when the number of
# sticks is a constant to it. Which one is right, a central difference over 10 % of `mu` tells. It needs no derivative
# at all.

# %%
slopes = [
    ss.sensitivity(
        ss.mean_stick_duration, system, law, wrt=("mu", "rate"), t1=T1, samples=4 * SAMPLES, key=KEY, y0=START
    )
    for system, law in zip(found.systems, found.laws, strict=True)
]  # fmt: skip
ends = [
    np.array([ss.mean_stick_duration(simulated(TRUE * [factor, 1.0], speed, KEY, 4096)).value for speed in SPEEDS])
    for factor in (0.95, 1.05)
]
difference = (ends[1] - ends[0]) / (0.1 * TRUE[0])
for speed, slope, change in zip(SPEEDS, slopes, difference, strict=True):
    print(f"base speed {speed} m/s: d(mean duration)/d(mu) = {slope['mu'].derivative:.3f} s corrected, "
          f"{slope['mu'].pathwise:.3f} s naive, {change:.3f} s by differences")  # fmt: skip

# %% [markdown]
# To first order the estimate is the truth plus `A` times the errors of the means, with `A = (J' W J)^-1 J' W`,
# derivative `J` and weights `W`. So wrong derivatives make wrong errors.


# %%
def covariance(kind):
    """Of the two parameters, if this `kind` of derivative were the right one."""
    j = np.array([[getattr(slope[name], kind) for name in found] for slope in slopes])
    return np.linalg.inv(j.T @ (j / np.array([[one.error**2] for one in found.moments])))


naive = covariance("pathwise")
for at, name in enumerate(found):
    right, wrong = found[name].standard_error, np.sqrt(naive[at, at])
    print(f"standard error of {name}: {right:.4f}, by the naive derivative {wrong:.4f}")

# %% [markdown]
# ## Twelve times again
# Other recordings and other simulations, same truth. The estimates must scatter by their standard errors.

# %%
REPEATS = 12  # of the three experiments
again = [calibrated(observe(1 + at), jax.random.fold_in(KEY, at), [ss.mean_stick_duration]) for at in range(REPEATS)]
for name, true in zip(found, TRUE, strict=True):
    values = np.array([float(one[name]) for one in again])
    error, scatter = np.mean([one[name].standard_error for one in again]), values.std(ddof=1)
    near = np.sum(abs(values - true) < 3 * error)
    print(f"{name}: scatter of {REPEATS} estimates {scatter:.4f} +- {scatter / np.sqrt(2 * REPEATS - 2):.4f}, "
          f"standard error {error:.4f}; within 3 of it from the truth: {near} of {REPEATS}")  # fmt: skip

# %% [markdown]
# ## The misfit
# The sum of squares of the misfits, each over its standard error, from a parameter sweep with one set of realisations,
# and the regions that hold the truth with a probability of 95 %, by both derivatives.

# %%
sweep = ss.Sweep(
    ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)),
    ss.PoissonSwitching(speed=1.0, rate=1.0),
    over={"mu": np.linspace(1.1, 1.3, 9), "rate": np.linspace(0.4, 1.4, 9), "speed": SPEEDS},
    t1=T1, samples=SAMPLES, key=KEY, y0=START, keep="totals", statistics=["mean_stick_duration"],
)  # fmt: skip
grid = sweep.run(progress=False)
misfit = np.zeros((9, 9))
for speed, one in zip(SPEEDS, found.moments, strict=True):
    misfit += ((grid.mean_stick_duration.sel(speed=speed).values - one.observed.value) / one.error) ** 2

# %%
figure, ax = plt.subplots(figsize=(7.5, 5), layout="constrained")
ss.plot.parameter_map(
    grid.mu.values, grid.rate.values, misfit, xlabel="friction coefficient mu", ylabel="switching rate in 1/s",
    label="sum of squares of misfits / standard errors", log=True, contours=False, ax=ax,
)  # fmt: skip
around = np.stack([np.cos(turn := np.linspace(0, 2 * np.pi, 100)), np.sin(turn)])
center = np.array([[float(found[name])] for name in found])
for matrix, color, name in ((found.covariance, "#000000", "corrected"), (naive, "#CC79A7", "naive")):
    edge = center + np.sqrt(5.99) * np.linalg.cholesky(matrix) @ around  # 95 % of a chi-squared of 2
    ax.plot(*edge, lw=1.6, color=color, label=name)
ax.plot(*TRUE, "D", ms=9, mew=2, mfc="none", mec="#0072B2", ls="none", label="truth")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
plt.show()

# %% [markdown]
# ## The whole distribution
# The fit has seen three means. Does the distribution of the durations come out too? Histograms in common bins, at
# 1 m/s: the distance in total variation is half the sum of the differences between shares. Recordings of the same
# truth differ as well; how much, says a second set of them.

# %%
points = [float(one) for one in found.values()], (0.7, 0.5)
fitted, first = (simulated(point, 1.0, KEY, SAMPLES) for point in points)
sets = {"observed": observed[1], "observed again": observe(1)[1], "fitted": fitted, "at the start of the fit": first}
durations = {name: one.statistics.duration for name, one in sets.items()}
bins = ss.common_bins(list(durations.values()), bins=40)
shares = {name: one.histogram(bins).counts / one.number for name, one in durations.items()}
for name, one in durations.items():
    distance = np.abs(shares[name] - shares["observed"]).sum() / 2
    entropy = one.entropy(bins)
    print(f"{name}: entropy {entropy.value:.3f} +- {entropy.standard_error:.3f} nat, "
          f"distance from what was observed {distance:.3f}")  # fmt: skip

# %%
figure, ax = plt.subplots(figsize=(7.5, 4), layout="constrained")
colors = {"at the start of the fit": "#009E73", "fitted": "#E69F00", "observed": "#0072B2"}
for name, color in colors.items():
    width = 2.5 if name == "fitted" else 1.2
    ax.stairs(durations[name].histogram(bins).density, bins.edges, color=color, lw=width, label=name)
ax.set_xlabel("stick duration in s")
ax.set_ylabel("density in 1/s")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
plt.show()

# %% [markdown]
# **Verdict.** Three mean durations at known speeds determine friction coefficient and rate, and the estimates scatter
# by their standard errors. The naive derivative by `mu` is more than one and a half times the right one, and that by
# the rate is wrong too: the standard error of the rate would come out several times too large. More moments of the
# same recordings make both parameters more certain.
