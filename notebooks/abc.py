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
# # Inference from sticks alone
#
# Somebody counted sticks and added up their durations: no motion was recorded, the base is random, and nobody can write
# down a likelihood. Approximate Bayesian computation (ABC) needs none: simulate with many parameters drawn from the
# prior, and keep those whose sticks are like the observed ones. `ss.stick_simulator` simulates them side by side, fast
# enough for plain rejection in NumPy with a million trajectories. At the end: the same simulator in `sbi`.

# %%
import os
import time

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

ROWS = max(int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "100_000")), 5_000)
RECORDINGS = 10  # of each row, as many as were made
KEPT = max(ROWS // 200, 100)
NAMES = ("mu", "rate")
UNITS = ("", " (1/s)")

# %% [markdown]
# ## What was observed
#
# A mass of 1 kg on a spring of 4 N/m, pressed on with 1 N; the belt runs at 1 m/s and turns at random, at a rate of
# 1.2/s. Ten times, for 100 s each, somebody counted sticks. Friction coefficient and rate are to be found.

# %%
TRUTH = np.array([0.8, 1.2])
LOW, HIGH = np.array([0.2, 0.2]), np.array([2.0, 3.0])  # of the uniform prior
system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(1.0))
law = ss.PoissonSwitching(speed=1.0, rate=1.0)


def summaries(many):
    """Of each sample: number of sticks, their total time, and the sums of squared durations of sticks and slips."""
    squares = [np.nansum(np.square(each.duration), axis=1) for each in (many.sticks, many.slips)]
    return np.column_stack([many.totals.sticks, many.totals.stick_time, *squares])


options = {"wrt": NAMES, "t1": 100.0, "realizations": RECORDINGS}
simulator = ss.stick_simulator(system, law, summaries=summaries, **options)
observed = simulator(TRUTH[None], jax.random.key(0))[0]
print("observed, means of ten recordings:", observed.round(2))

# %% [markdown]
# ## A million trajectories
#
# In batches, each with a key of its own: all sticks of a batch are in memory, for summaries of one's own. The default
# summaries, number and total time, keep none, and take a batch of any size.

# %%
rows = np.random.default_rng(0).uniform(LOW, HIGH, size=(ROWS, 2))
batches = np.array_split(rows, max(1, ROWS // 5000))
simulator(batches[0][:500], jax.random.key(1))  # compiles
started = time.perf_counter()
keys = jax.random.split(jax.random.key(2), len(batches))
simulated = np.concatenate([simulator(batch, key) for batch, key in zip(batches, keys, strict=True)])
seconds = time.perf_counter() - started
trajectories = ROWS * RECORDINGS
print(f"{trajectories} trajectories of 100 s in {seconds:.1f} s: {trajectories / seconds:.0f} per second")
totals = ss.stick_simulator(system, law, **options)
totals(batches[0][:500], jax.random.key(1))
started = time.perf_counter()
totals(rows, jax.random.key(2))
print(f"the default summaries: {trajectories / (time.perf_counter() - started):.0f} per second")

# %% [markdown]
# ## Rejection
#
# The distance: the differences of the summaries over their spread in the prior. The nearest are kept. Then a linear
# regression on the summaries moves each to where it would be with exactly the observed ones (Beaumont, Zhang and
# Balding, *Genetics* 162, 2002).

# %%
scale = stats.median_abs_deviation(simulated)


def accepted(observed, simulated, rows, kept=KEPT):
    """The rows whose summaries are nearest to the observed ones, and the same with the regression adjustment."""
    differences = (simulated - observed) / scale
    nearest = np.argpartition(np.sum(differences**2, axis=1), kept)[:kept]
    near, plain = differences[nearest], rows[nearest]
    # In the logit of the prior's interval, so that nothing is moved out of it.
    inside = np.log((plain - LOW) / (HIGH - plain))
    design = np.column_stack([np.ones(kept), near])
    inside = inside - near @ np.linalg.lstsq(design, inside)[0][1:]
    return plain, LOW + (HIGH - LOW) / (1 + np.exp(-inside))


plain, adjusted = accepted(observed, simulated, rows)
inside = True
for name, unit, truth, column in zip(NAMES, UNITS, TRUTH, adjusted.T, strict=True):
    low, high = np.quantile(column, [0.005, 0.995])
    inside &= low < truth < high
    print(f"{name}{unit}: {column.mean():.3f} +- {column.std():.3f}, truth {truth}")
print(f"correlation {np.corrcoef(adjusted.T)[0, 1]:.2f}; the truth is within 99 % of each: {inside}")

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
shown = slice(None, None, max(1, KEPT // 1000))
panels[0].plot(*plain[shown].T, ".", ms=3, color="#56B4E9", label="nearest")
panels[0].plot(*adjusted[shown].T, ".", ms=3, color="#0072B2", label="adjusted")
panels[0].plot(*TRUTH, "r*", ms=12, label="truth")
panels[0].set(xlabel="mu", ylabel="rate (1/s)", title="posterior")
panels[0].legend()
again = simulator(adjusted[: min(KEPT, 1000)], jax.random.key(3))
panels[1].plot(*simulated[:3000, :2].T, ".", ms=2, color="0.7", label="prior")
panels[1].plot(*again[:, :2].T, ".", ms=3, color="#0072B2", label="posterior, simulated again")
panels[1].plot(*observed[:2], "r*", ms=12, label="observed")
panels[1].set(xlabel="number of sticks", ylabel="total stick time (s)", title="summaries")
panels[1].legend()
plt.show()

# %% [markdown]
# ## Is it right?
#
# Rows that were simulated anyway play the part of the observation, each with its own truth. The share of accepted
# values below the truth is uniform over such trials if the posteriors are right for these summaries.

# %%
TRIALS = 300
ranks = {"nearest": np.empty((TRIALS, 2)), "adjusted": np.empty((TRIALS, 2))}
for trial in range(TRIALS):
    others = slice(TRIALS, None)
    both = accepted(simulated[trial], simulated[others], rows[others])
    for kind, values in zip(ranks, both, strict=True):
        ranks[kind][trial] = np.mean(values < rows[trial], axis=0)
figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for i, (ax, name) in enumerate(zip(panels, NAMES, strict=True)):
    for kind, values in ranks.items():
        p = stats.kstest(values[:, i], "uniform").pvalue
        print(f"{name}, {kind}: p = {p:.2f}; not rejected: {p > 1e-3}")
        ax.plot(np.sort(values[:, i]), (np.arange(TRIALS) + 0.5) / TRIALS, label=kind)
    ax.plot([0, 1], [0, 1], "k", lw=1)
    ax.set(xlabel=f"share of values below the truth, {name}", ylabel="share of trials")
panels[0].legend()
plt.show()

# %% [markdown]
# ## Neural posteriors by `sbi`
#
# With more summaries rejection keeps too few; then [sbi](https://sbi-dev.github.io/sbi/) learns the posterior from the
# same rows. It needs PyTorch, which is no part of this package's environment; so this is a recipe, not run here:
#
# ```python
# import torch
# from sbi.inference import NPE
# from sbi.utils import BoxUniform
#
# prior = BoxUniform(low=torch.tensor(LOW), high=torch.tensor(HIGH))
# theta = prior.sample((200_000,))
# x = torch.as_tensor(simulator(theta, jax.random.key(4)))
# inference = NPE(prior=prior)
# inference.append_simulations(theta.float(), x.float()).train()
# posterior = inference.build_posterior()
# draws = posterior.sample((1000,), x=torch.tensor(observed, dtype=torch.float32))
# ```
#
# `simulator` takes tensors as they are. A function of the parameters alone, as other tools ask for, counts its keys:
# `lambda theta: simulator(theta, jax.random.fold_in(key, next(counter)))`, with `counter = itertools.count()`.
# Rows that did not reach the end are NaN, which `sbi` leaves out and NumPy finds with `np.isnan`.
