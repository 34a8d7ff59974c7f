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
# # A sweep that grows
#
# A parameter sweep simulates the same ensemble at many values of its parameters and stores every finished batch. So
# it can start small, be looked at, get more samples and more points, and move from one machine to several; what is
# there is used again. Every claim below is checked on the numbers.

# %%
import os
import re
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))
SAMPLES = -(-SAMPLES // 100) * 100
BATCH = SAMPLES // 4  # samples that are done, and stored, together
kept = tempfile.TemporaryDirectory()
FOLDER = Path(kept.name) / "mu_and_rate"

# %% [markdown]
# ## Sixteen points
# Nothing is simulated until `run`. Names of the parameters are those of the numbers in system and law.

# %%
system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.8))
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
OVER = {"mu": [0.5, 0.8, 1.2, 1.6], "rate": [0.3, 0.6, 1.2, 2.4]}


def sweep(samples, over=OVER, **options):
    """The sweep, with a number of samples at each point."""
    common = {"t1": 100.0, "key": jax.random.key(0), "y0": (0.0, 0.5), "batch": BATCH}
    return ss.Sweep(system, law, over=over, samples=samples, **(common | options))


print(sweep(SAMPLES))

# %% [markdown]
# ## Half of it now, the rest later
# The first run takes half the samples. The second one asks for all of them in the same folder and does only what is
# missing. A third sweep was never stopped. The numbers are the same, bit for bit; only the time spent differs.


# %%
def same(one, other):
    """How many numbers of two results are the same to the last bit, and how many there are; NaN is like NaN."""
    names = [name for name in one.data_vars if name != "run_seconds"]
    equal = [np.asarray(one[name].values == other[name].values) for name in names]
    missing = [(one[name].isnull() & other[name].isnull()).values for name in names]
    return sum(int((a | b).sum()) for a, b in zip(equal, missing, strict=True)), sum(a.size for a in equal)


half = sweep(SAMPLES // 2).run(FOLDER, progress=False)
whole = sweep(SAMPLES).run(FOLDER, progress=False)
at_once = sweep(SAMPLES).run(progress=False)
print("numbers that are those of a sweep never stopped: {} of {}".format(*same(whole, at_once)))


# %% [markdown]
# The folder has a log of what was done when: the second run began at the sample at which the first one had ended.


# %%
def done(folder):
    """The first samples of the batches that each run did, after its log."""
    runs = (folder / "log.txt").read_text().split("begun")[1:]
    return [[int(first) for first in re.findall(r"samples (\d+) to", run)] for run in runs]


for number, firsts in enumerate(done(FOLDER), start=1):
    print(f"run {number}: {len(firsts)} batches, the lowest first sample {min(firsts)}")
assert min(done(FOLDER)[1]) == SAMPLES // 2

# %% [markdown]
# The same call once more finds nothing to do. Neither does one that knows nothing but the folder.

# %%
again = ss.Sweep.load(FOLDER).run(FOLDER, progress=False)
print(f"batches done by a third run: {len(done(FOLDER)[2])}")
print("numbers that a third run left as they were: {} of {}".format(*same(again, whole)))

# %% [markdown]
# ## More points
# A fifth friction coefficient costs its own four points only.

# %%
finer = sweep(SAMPLES, over=OVER | {"mu": [0.5, 0.8, 1.0, 1.2, 1.6]}).run(FOLDER, progress=False)
shared = finer.sel(mu=OVER["mu"])
pooled = ["stick_fraction", "mean_stick_count", "mean_stick_duration", "mean_slip_duration"]
print(f"batches done for it: {len(done(FOLDER)[3])}; the statistics of the first sixteen points are what they were: "
      f"{all((shared[name] == whole[name]).all() for name in pooled)}")  # fmt: skip
print(f"time for a point, on average: {float(finer.run_seconds.mean()):.3f} s")

# %% [markdown]
# ## What came out
# A map, and along one parameter curves with 95 % confidence intervals.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
ss.plot.parameter_map(finer, "mean_stick_duration", xlog=True, ylog=True, ax=left)
ss.plot.curve(finer.sel(mu=[0.5, 1.0, 1.6]), "stick_fraction", along="rate", xlog=True, ax=right)
plt.show()

# %% [markdown]
# A check on all points at once: total stick time is the number of sticks times their mean duration.

# %%
rebuilt = finer.mean_stick_count * finer.mean_stick_duration / 100.0
print(f"stick fraction = count x duration / t1 at all {finer.stick_fraction.size} points: "
      f"{np.allclose(rebuilt, finer.stick_fraction, rtol=1e-12)}")  # fmt: skip

# %% [markdown]
# ## Entropies that can be compared
# All points share the bins of their histograms. The entropy of a histogram is `-sum p log p` of the shares `p` of its
# bins, and (bins with values - 1) / (2 number), by which few values make it too small; it says how spread the durations
# are.

# %%
edges = np.append(finer.duration_bin_low.values, finer.duration_bin_high.values[-1])
share = finer.duration_count_in_bin / finer.duration_count_in_bin.sum("duration_bin")
by_hand = -(share * np.log(share.where(share > 0, 1.0))).sum("duration_bin")
by_hand += ((share > 0).sum("duration_bin") - 1) / (2 * finer.duration_count_in_bin.sum("duration_bin"))
print(f"entropies by hand differ by at most {float(np.abs(by_hand - finer.duration_entropy).max()):.1e} nat")
for mu in finer.mu.values:
    row = finer.sel(mu=mu, rate=0.6)
    print(f"mu = {mu}: entropy of the duration {float(row.duration_entropy):.3f} +- "
          f"{float(row.duration_entropy_error):.3f} nat")  # fmt: skip

# %% [markdown]
# A stick lasts longest if the mass rides through the whole stick band, of width `2 mu n / k`, at the speed of the base.
# The bins beyond that must be empty.

# %%
longest = 2 * finer.mu * 1.0 / (4.0 * 1.0)  # s
beyond = finer.duration_count_in_bin.where(finer.duration_bin_low > longest).sum()
print(f"sticks in bins beyond 2 mu n / (k v): {int(beyond)}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for mu, color in zip((0.5, 1.0, 1.6), ("#0072B2", "#E69F00", "#009E73"), strict=True):
    left.stairs(finer.duration_density.sel(mu=mu, rate=0.6), edges, color=color, lw=1.4, label=f"mu = {mu:g}")
left.set_xlabel("stick duration in s, rate 0.6 1/s")
left.set_ylabel("density in 1/s")
left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
ss.plot.curve(finer.sel(rate=0.6), "duration_entropy", ax=right)
right.set_ylabel("entropy of the duration in nat")
plt.show()

# %% [markdown]
# ## As many samples as are needed
# With `standard_error` each point ends when it has the error asked for, batch by batch. How many samples that takes,
# the errors found above foretell: a standard error falls with the square root of the number of samples.

# %%
WANTED = 0.001  # s
enough = sweep(40_000, standard_error={"mean_stick_duration": WANTED}, keep="totals", batch=100).run(progress=False)
foretold = SAMPLES * (whole.mean_stick_duration_error / WANTED) ** 2
for mu in OVER["mu"]:
    pairs = zip(enough.samples.sel(mu=mu).values, foretold.sel(mu=mu).values, strict=True)
    counts = ", ".join(f"{taken} ({guess:.0f})" for taken, guess in pairs)
    print(f"mu = {mu}: samples for rates {', '.join(map(str, OVER['rate']))} (foretold): {counts}")
print(f"the largest standard error is below {WANTED} s: {bool((enough.mean_stick_duration_error <= WANTED).all())}")

# %% [markdown]
# ## Threads or processes
# Where a batch is done makes no difference to its numbers. `workers=2` starts two processes, which compile for
# themselves; on a cluster `executor=` takes a dask client, with the same result.

# %%
small = {"over": {"mu": [0.5, 1.2], "rate": [0.6]}, "batch": 50, "keep": "totals"}
one_thread = sweep(200, **small).run(threads=1, progress=False)
two_processes = sweep(200, **small).run(workers=2, progress=False)
print("numbers of two processes that are those of one thread: {} of {}".format(*same(two_processes, one_thread)))
kept.cleanup()

# %% [markdown]
# **Verdict.** Stopped and resumed, extended by samples and by points, in threads or processes: the numbers are the same
# to the last bit, and nothing was simulated twice.
