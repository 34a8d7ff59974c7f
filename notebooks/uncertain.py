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
# # Uncertain parameters
#
# The friction coefficient of a real contact is known within some ten percent at best, and the base moves at random
# besides. How much of the scatter of the sticks comes from which of them? Distributions stand in the model where
# numbers would; Sobol' indices divide the variance among the inputs, and the realisation of the base is one of them.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "4096"))
ROWS = 2 ** int(np.log2(SAMPLES))  # base rows of the design for Sobol' indices: a power of two

# %% [markdown]
# ## The model
# Three numbers of the oscillator and its position at the start are random; the base turns at the points of a Poisson
# process.

# %%
system = ss.MassSpring(
    mass=1.0,
    stiffness=ss.LogNormal(median=4.0, log_std=0.10),
    normal_force=ss.LogNormal(median=1.0, log_std=0.10),
    friction=ss.Coulomb(mu=ss.LogNormal(median=1.0, log_std=0.20)),
)
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
names = ["mu", "normal_force", "stiffness", "y0[0]"]
run = {
    "t1": 100.0,
    "key": jax.random.key(0),
    "y0": (ss.Uniform(-0.5, 0.5), 0.0),
    "keep": "sticks",
    "progress": False,
}


def outputs(many):
    """Three numbers for each sample. One without a stick counts with a mean duration of zero."""
    time, number = many.totals.stick_time, many.totals.sticks
    duration = np.divide(time, number, out=np.zeros_like(time), where=number > 0)
    return {"stick fraction": time / many.t1, "number of sticks": number, "mean stick duration": duration}


# %% [markdown]
# ## Sobol' indices
# The *first-order* index of an input is the share of the variance that would vanish, on average, if it were known; the
# *total* index the share that would be left if everything else were known. With `realization="factor"` the random base
# is an input like the others.

# %%
design = ss.design.saltelli(ROWS, names, second_order=False, realization="factor")
many = ss.simulate_ensemble(system, law, samples=design, **run)
found = ss.sobol_indices(outputs(many), design)
print(found)
without = np.mean(many.totals.sticks == 0)
print(f"samples without a stick: {100 * without:.2f} %")

# %%
figure, panels = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained", sharey=True)
places = np.arange(len(found.factors))
for number, (panel, output) in enumerate(zip(panels, found.outputs, strict=True)):
    for shift, color, kind in ((-0.17, "#0072B2", "first"), (0.17, "#E69F00", "total")):
        index, ends = getattr(found, kind)[:, number], getattr(found, f"{kind}_interval")[:, :, number]
        label = {"first": "first order", "total": "total"}[kind] if number == 0 else None
        panel.bar(places + shift, index, width=0.34, color=color, label=label)
        panel.errorbar(
            places + shift, index, [index - ends[0], ends[1] - index], fmt="none", color="#000000", capsize=2
        )
    panel.axhline(0.0, color="#000000", lw=0.8)
    panel.set_xticks(places, ["mu", "normal\nforce", "stiffness", "start\n$x_0$", "realisation"], fontsize=8)
    panel.set_xlabel(output)
panels[0].set_ylabel("Sobol' index, share of variance")
figure.legend(loc="outside upper center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# The bars are 95 % bootstrap intervals. What the realisation has in total is the part of the scatter that no knowledge
# of the parameters removes.

# %%
for number, output in enumerate(found.outputs):
    print(f"{output}: {100 * found.total[-1, number]:.1f} % +- {100 * found.total_error[-1, number]:.1f} % of the "
          f"variance is left when all four numbers are known")  # fmt: skip

# %% [markdown]
# ## Two checks
# First an output whose indices are known: half the width of the stick band, `mu n / k`, is a product of independent
# log-normal numbers. With `c_i = exp(s_i^2) - 1`, where `s_i` is the standard deviation of the logarithm, the variance
# is in proportion to `V = prod(1 + c_i) - 1`, the first-order indices are `c_i / V`, and the total ones
# `c_i prod(1 + c_j) / V`, the product over all `j` but `i`.

# %%
values = many.input_values
half_width = values["mu"] * values["normal_force"] / values["stiffness"]
band = ss.sobol_indices(half_width, design)
c = np.expm1(np.array([0.20, 0.10, 0.10]) ** 2)
whole = np.prod(1 + c) - 1
for at, name in enumerate(names[:3]):
    exact = c[at] / whole, c[at] * np.prod(np.delete(1 + c, at)) / whole
    print(f"half-width, {name}: first order {band.first[at]:.3f} +- {band.first_error[at]:.3f} (exact {exact[0]:.4f}), "
          f"total {band.total[at]:.3f} +- {band.total_error[at]:.3f} (exact {exact[1]:.4f})")  # fmt: skip
print(f"start and realisation: {np.abs(band.total[3:]).max():.0f} in total")

# %% [markdown]
# Then brute force: each row of parameters with 16 realisations. The mean of the variances within rows, over the whole
# variance, is the total index of the realisation, without any formula of Sobol' indices.

# %%
rows = max(16, ROWS // 4)
u = np.random.default_rng(0).uniform(size=(rows, 4))
nested = ss.simulate_ensemble(
    system, law, samples=ss.design.table(np.repeat(u, 16, axis=0), names, uniform=True), **run
)  # fmt: skip


def left(table):
    """The mean variance within rows over the whole variance; a row's mean holds a 16th of the former."""
    within, between = table.var(axis=1, ddof=1).mean(), table.mean(axis=1).var(ddof=1)
    return within / (between + within * 15 / 16)


random = np.random.default_rng(1)
for number, (output, values) in enumerate(outputs(nested).items()):
    table = values.reshape(rows, 16)
    error = np.std([left(table[random.integers(rows, size=rows)]) for _ in range(200)])
    print(f"{output}: realisation in total {left(table):.3f} +- {error:.3f} by brute force, "
          f"{found.total[-1, number]:.3f} +- {found.total_error[-1, number]:.3f} by Sobol' indices")  # fmt: skip

# %% [markdown]
# ## What cannot be told apart
# Friction coefficient and normal force act by their product alone. So `mu` is larger and the normal force smaller here
# by the same factor, with the same realisations: the sticks are the same up to round-off. `mu` has the larger
# indices above because it is the less certain of the two.

# %%
normal = jax.scipy.stats.norm
scores = np.array(normal.ppf(u[:, :2]))
moved = np.column_stack([normal.cdf(scores + np.array([0.5, -1.0])), u[:, 2:]])  # mu times, force over exp(0.1)
pair = [
    ss.simulate_ensemble(system, law, samples=ss.design.table(numbers, names, uniform=True), **run)
    for numbers in (u, moved)
]
ratio = pair[1].input_values["mu"] / pair[0].input_values["mu"]
change = np.abs(pair[1].totals.stick_time - pair[0].totals.stick_time).max()
print(f"mu {ratio.min():.4f} to {ratio.max():.4f} times as large, the force smaller: the numbers of sticks are the "
      f"same in {100 * np.mean(pair[0].totals.sticks == pair[1].totals.sticks):.0f} % of the samples, "
      f"the stick times within {change:.1e} s")  # fmt: skip

# %% [markdown]
# ## Inputs that depend on each other
# A Gaussian copula correlates `mu` and the normal force and leaves the distribution of each as it is. Both are
# log-normal, so `mu n` is log-normal too, and its logarithm has the variance `s_1^2 + s_2^2 + 2 r s_1 s_2`.

# %%
correlated = {}
for r in (-0.8, 0.0, 0.8):
    copula = ss.GaussianCopula(["mu", "normal_force"], [[1.0, r], [r, 1.0]])
    one = correlated[r] = ss.simulate_ensemble(system, law, samples=SAMPLES, correlation=copula, **run)
    logs = np.log(one.input_values["mu"] * one.input_values["normal_force"])
    mean = ss.stick_fraction(one)
    print(f"r = {r:4.1f}: log(mu n) has the standard deviation {logs.std(ddof=1):.3f} (exact "
          f"{np.sqrt(0.05 + 0.04 * r):.4f}), the stick fraction {mean.standard_error * np.sqrt(one.samples):.4f} about "
          f"{mean.value:.4f}")  # fmt: skip

# %%
independent = correlated[0.0]
mu, fraction = independent.input_values["mu"], outputs(independent)["stick fraction"]
parts = np.array_split(np.argsort(mu), max(5, min(40, SAMPLES // 25)))
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
shown = slice(0, 2000)
left.plot(mu[shown], 100 * fraction[shown], ".", ms=2.5, color="#0072B2", alpha=0.5, label="samples")
means = np.array([[mu[part].mean(), fraction[part].mean()] for part in parts])
left.plot(means[:, 0], 100 * means[:, 1], "o-", ms=4, color="#000000", label="means of samples of similar mu")
left.set_xlabel("friction coefficient mu")
left.set_ylabel("stick fraction in %")
edges = np.linspace(0.0, 100 * max(outputs(one)["stick fraction"].max() for one in correlated.values()), 31)
for (r, one), color in zip(correlated.items(), ("#009E73", "#0072B2", "#E69F00"), strict=True):
    density, _ = np.histogram(100 * outputs(one)["stick fraction"], edges, density=True)
    right.stairs(density, edges, color=color, lw=1.5, label=f"r = {r:g}")
right.set_xlabel("stick fraction in %")
right.set_ylabel("density in 1/%")
for panel in (left, right):
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
plt.show()

# %% [markdown]
# The means of samples of similar `mu` say again what the first-order index of `mu` is: their variance over the whole
# one, less what the finite number of samples in each adds. A part spans a range of `mu`, which makes it a little less.

# %%
noise = np.mean([fraction[part].var(ddof=1) / len(part) for part in parts])
share = (means[:, 1].var(ddof=1) - noise) / fraction.var(ddof=1)
print(f"stick fraction, mu: first order {share:.3f} by {len(parts)} groups, {found.first[0, 0]:.3f} +- "
      f"{found.first_error[0, 0]:.3f} by Sobol' indices")  # fmt: skip

# %% [markdown]
# ## Derivatives by the parameters of a distribution
# How does the mean stick fraction change if the median of `mu` or its spread is another one? `sensitivity`
# differentiates every sample. The likelihood-ratio method needs no derivative of any sample: it is the covariance of
# the output with the derivative of the logarithm of the density of `mu`, from the ensemble above.

# %%
by = ss.sensitivity(
    ss.stick_fraction, system, law, wrt=("mu.median", "mu.log_std"), t1=run["t1"], samples=SAMPLES,
    key=jax.random.key(1), y0=run["y0"],
)  # fmt: skip
s, z = 0.20, np.log(mu) / 0.20  # the median is 1
for name, score in (("mu.median", z / s), ("mu.log_std", (z**2 - 1) / s)):
    terms = (fraction - fraction.mean()) * score
    slope, error = terms.mean(), terms.std(ddof=1) / np.sqrt(len(terms))
    one = by[name]
    distance = abs(one.derivative - slope) / np.hypot(one.standard_error, error)
    print(f"by {name}: {one.derivative:.4f} +- {one.standard_error:.4f}, by likelihood ratios {slope:.4f} +- "
          f"{error:.4f}, {distance:.1f} standard errors apart")  # fmt: skip

# %% [markdown]
# **Verdict.** Indices, brute force and closed forms agree within a few standard errors. The derivative through the
# samples has a smaller error than that by likelihood ratios from the same number of samples.
