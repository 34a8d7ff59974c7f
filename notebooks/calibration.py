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
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1024"))
SAMPLES = max(512, -(-SAMPLES // 256) * 256)  # of each simulation in the fit; ss.differentiable rounds up so too
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
# ## The model and its derivative
# The model gives the mean stick duration at each of the three speeds as a function of `mu` and rate.
# `ss.differentiable` corrects its derivative for sticks that appear and vanish. Beside it the naive derivative: what
# JAX makes of the mean over simulated sticks, when the number of sticks is a constant to it.

# %%
KEY = jax.random.key(1)
duration = ss.differentiable(
    ss.mean_stick_duration,
    ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)),
    ss.PoissonSwitching(speed=1.0, rate=1.0),
    wrt=("mu", "rate", "speed"), t1=T1, samples=SAMPLES, key=KEY, y0=START,
)  # fmt: skip


def corrected(parameters):
    """The mean duration at each speed, twice: to differentiate, and as it is."""
    values = jax.lax.map(lambda speed: duration(jnp.append(parameters, speed)), jnp.asarray(SPEEDS))
    return values, values


def naive(parameters):
    """The same, differentiated through the simulation of each sample."""
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(parameters[0]))

    def at(speed):
        def one(number):
            key = jax.random.fold_in(KEY, number)
            start = jax.random.uniform(jax.random.fold_in(key, 7), (2,), minval=-0.5, maxval=0.5)
            base = ss.PoissonSwitching(speed, parameters[1]).sample(key, T1, capacity=250)
            run = ss.simulate(system, base, t1=T1, y0=(start[0], start[1]))
            return run.stick_time, run.sticks.count

        time, number = jax.vmap(one)(jnp.arange(SAMPLES))
        return jnp.sum(time) / jnp.sum(number)

    values = jax.lax.map(at, jnp.asarray(SPEEDS))
    return values, values


# Forward mode: there are two parameters. Each returns the derivative (speeds, 2) and the value (speeds,).
models = {model.__name__: jax.jit(jax.jacfwd(model, has_aux=True)) for model in (corrected, naive)}
slopes = {name: np.asarray(model(jnp.asarray(TRUE))[0]) for name, model in models.items()}

# %% [markdown]
# Which one is right, a central difference over 10 % of `mu` tells. It needs no derivative at all.

# %%
ends = [
    np.array([ss.mean_stick_duration(simulated(TRUE * [factor, 1.0], speed, KEY, 4096)).value for speed in SPEEDS])
    for factor in (0.95, 1.05)
]
difference = (ends[1] - ends[0]) / (0.1 * TRUE[0])
for at, speed in enumerate(SPEEDS):
    print(f"base speed {speed} m/s: d(mean duration)/d(mu) = {slopes['corrected'][at, 0]:.3f} s corrected, "
          f"{slopes['naive'][at, 0]:.3f} s naive, {difference[at]:.3f} s by differences")  # fmt: skip

# %% [markdown]
# ## The fit
# Gauss-Newton in the logarithms of the two parameters, with the standard errors of the observed means as weights.


# %%
def fit(model, data, start, steps=15):
    """The path of the parameters (steps, 2), until a step changes them by less than 1e-3."""
    seen = np.array([ss.mean_stick_duration(one).value for one in data])
    weight = 1 / np.array([ss.mean_stick_duration(one).standard_error for one in data])
    path = [np.asarray(start, float)]
    for _ in range(steps):
        slope, value = (np.asarray(part) for part in model(jnp.asarray(path[-1])))
        move = np.linalg.lstsq(weight[:, None] * slope * path[-1], weight * (seen - value), rcond=None)[0]
        path.append(path[-1] * np.exp(np.clip(move, -0.5, 0.5)))
        if np.abs(move).max() < 1e-3:
            break
    return np.array(path)


paths = {}
for name, model in models.items():
    paths[name] = fit(model, observed, (0.7, 0.5))
    steps, (mu, rate) = len(paths[name]) - 1, paths[name][-1]
    last = np.abs(np.diff(np.log(paths[name][-2:]), axis=0)).max()
    print(f"{name}: mu = {mu:.4f}, rate = {rate:.4f} 1/s after {steps} steps, the last of {100 * last:.2g} %")

# %% [markdown]
# ## How certain is it
# To first order the estimate is the truth plus `A` times the errors of the means, with `A = (J' W J)^-1 J' W`,
# derivative `J` and weights `W`. The errors are those of the observations, independent of each other, and those of the
# simulations, which see the same realisations at all three speeds; so their covariance matrix is needed.


# %%
def errors(slope, fitted, data):
    """Standard errors of the two parameters from the observations alone, and with those of the simulations."""
    variance = np.array([ss.mean_stick_duration(one).standard_error ** 2 for one in data])
    a = np.linalg.solve(slope.T @ (slope / variance[:, None]), slope.T / variance)
    parts = []
    for speed in SPEEDS:
        totals = simulated(fitted, speed, KEY, SAMPLES).totals
        ratio = totals.stick_time.mean() / totals.sticks.mean()
        parts.append((totals.stick_time - ratio * totals.sticks) / totals.sticks.mean())
    both = np.diag(variance) + np.cov(parts) / SAMPLES
    return np.sqrt(np.diag(a @ np.diag(variance) @ a.T)), np.sqrt(np.diag(a @ both @ a.T))


estimate = paths["corrected"][-1]
slope = np.asarray(models["corrected"](jnp.asarray(estimate))[0])
alone, whole = errors(slope, estimate, observed)
for at, (name, unit) in enumerate((("mu", ""), ("rate", " 1/s"))):
    print(f"{name} = {estimate[at]:.3f} +- {whole[at]:.3f}{unit}, of which {alone[at]:.3f} from the observations; "
          f"the truth is {abs(estimate[at] - TRUE[at]) / whole[at]:.1f} standard errors away")  # fmt: skip
too_small = errors(np.asarray(models["naive"](jnp.asarray(estimate))[0]), estimate, observed)[1]
print(f"with the naive derivative the standard error of mu would be {too_small[0]:.3f}")

# %% [markdown]
# ## Twelve times again
# Other recordings, same truth. The simulations of the fit stay the same, so the scatter of the estimates is due to the
# observations alone, and must be what the delta method says.

# %%
REPEATS = 12  # of the three experiments
again = np.array([fit(models["corrected"], observe(1 + at), estimate, steps=4)[-1] for at in range(REPEATS)])
scatter = again.std(axis=0, ddof=1)
for at, name in enumerate(("mu", "rate")):
    print(f"{name}: scatter of {REPEATS} estimates {scatter[at]:.4f} +- {scatter[at] / np.sqrt(2 * REPEATS - 2):.4f}, "
          f"by the delta method {alone[at]:.4f}")  # fmt: skip
near = np.abs(again - TRUE) < 3 * whole
print(
    f"within 3 standard errors of the truth: mu {near[:, 0].sum()} of {REPEATS}, rate {near[:, 1].sum()} of {REPEATS}"
)

# %% [markdown]
# ## The misfit and the two paths
# The sum of squares of the misfits, each over its standard error, from a parameter sweep with the realisations of the
# fit, and the paths of both iterations.

# %%
sweep = ss.Sweep(
    ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)),
    ss.PoissonSwitching(speed=1.0, rate=1.0),
    over={"mu": np.linspace(0.6, 1.6, 9), "rate": np.linspace(0.3, 1.5, 7), "speed": SPEEDS},
    t1=T1, samples=SAMPLES, key=KEY, y0=START, keep="totals", statistics=["mean_stick_duration"],
)  # fmt: skip
grid = sweep.run(progress=False)
misfit = np.zeros((9, 7))
for at, one in enumerate(map(ss.mean_stick_duration, observed)):
    misfit += ((grid.mean_stick_duration.isel(speed=at).values - one.value) / one.standard_error) ** 2

# %%
figure, ax = plt.subplots(figsize=(7.5, 5), layout="constrained")
ss.plot.parameter_map(
    grid.mu.values, grid.rate.values, misfit, xlabel="friction coefficient mu", ylabel="switching rate in 1/s",
    label="sum of squares of misfits / standard errors", log=True, contours=False, ax=ax,
)  # fmt: skip
ax.plot(*TRUE, "D", ms=11, mew=2, mfc="none", mec="#0072B2", ls="none", label="truth")
for (name, path), color, marker in zip(paths.items(), ("#000000", "#CC79A7"), ("o", "s"), strict=True):
    ax.plot(*path.T, marker=marker, ms=4, lw=1.2, color=color, label=f"{name}, {len(path) - 1} steps")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
plt.show()

# %% [markdown]
# ## The whole distribution
# The fit has seen three means. Does the distribution of the durations come out too? Histograms in common bins, at
# 1 m/s: the distance in total variation is half the sum of the differences between shares. Recordings of the same
# truth differ as well; how much, says a second set of them.

# %%
fitted, first = (simulated(point, 1.0, KEY, SAMPLES) for point in (estimate, paths["corrected"][0]))
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
# as the delta method says. The naive derivative by `mu` is about one and a half times the right one. With it the
# iteration had not settled after 15 steps, and the standard error of `mu` would come out too small.
