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
# # Base motions of your own
#
# Six ways to say how the base moves, all under the same mass and spring: a function of time, a sampler in NumPy,
# intervals between switches of any distribution, a law of random ramps, a Gaussian process with a spectrum, and a
# recorded velocity. What is random is checked against exact values.

# %%
import math
import os
import tempfile
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1_000"))
system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.5))
t1, key = 60.0, jax.random.key(0)  # s
start = (ss.Uniform(-0.2, 0.2), 0.0)  # m, m/s: every sample begins at a position of its own
runs = {}


def examine(name, law, method=None):
    """Simulate the samples under this base motion, and print the share of time spent sticking with its error."""
    runs[name] = ss.simulate_ensemble(
        system, law, t1=t1, y0=start, samples=SAMPLES, key=key, keep="sticks", method=method or ss.Exact(),
        progress=False,
    )  # fmt: skip
    print(f"{name}: {ss.stick_fraction(runs[name])}, {ss.mean_stick_count(runs[name]).value:.2f} sticks")


# %% [markdown]
# ## 1. A function of time
# Any object with `velocity(t)` and `acceleration(t)`, which JAX must be able to trace. The package does not know its
# shortest period, so the time step is given. Here a swing whose amplitude grows and settles. That one is the derivative
# of the other is best checked, by a finite difference.


# %%
class Swell:
    """A harmonic motion whose amplitude grows and settles."""

    def velocity(self, t):
        return (1 - jnp.exp(-t / 10)) * jnp.sin(1.5 * t)

    def acceleration(self, t):
        return jnp.exp(-t / 10) / 10 * jnp.sin(1.5 * t) + (1 - jnp.exp(-t / 10)) * 1.5 * jnp.cos(1.5 * t)


swell, instants = Swell(), np.linspace(0.1, t1, 601)
difference = (swell.velocity(instants + 1e-5) - swell.velocity(instants - 1e-5)) / 2e-5
wrong = np.max(np.abs(swell.acceleration(instants) - difference))
print(f"velocity and acceleration agree within 1e-8 m/s^2: {wrong < 1e-8}")
examine("function of time", swell, ss.Exact(step=0.05))

# %% [markdown]
# ## 2. A sampler in NumPy
# Any object with `sample(key, t1)` that returns what `simulate` takes. All samples are drawn before the simulation.


# %%
class Bursts:
    """The belt runs in bursts of random length and speed, with pauses between."""

    def sample(self, key, t1):
        numbers = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        durations, speeds = numbers.gamma(3.0, 0.5, 200), numbers.choice([0.5, 1.0, 2.0], 200)
        speeds[1::2] = 0.0
        return ss.PiecewiseConstant(np.concatenate([[0.0], np.cumsum(durations)[:-1]]), speeds)


examine("bursts", Bursts())

# %% [markdown]
# ## 3. Intervals between switches of any distribution
# `SemiMarkovSwitching` with Weibull gaps. The first 30 gaps of each realisation against the exact distribution: for
# scale `b` and shape `k` the mean is `b Gamma(1 + 1/k)`, the mean square `b^2 Gamma(1 + 2/k)`.

# %%
gap = ss.Weibull(scale=1.0, shape=2.0)
switching = ss.SemiMarkovSwitching(gap=gap, speed=ss.Uniform(0.5, 1.5))
examine("Weibull gaps", switching)
keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(jnp.arange(SAMPLES))
gaps = np.asarray(jax.vmap(lambda one_key: switching.sample(one_key, t1).durations[:30])(keys)).ravel()
for power, name, unit in ((1, "mean", "s"), (2, "mean square", "s^2")):
    exact = gap.scale**power * math.gamma(1 + power / gap.shape)
    error = (gaps**power).std() / math.sqrt(len(gaps))
    within = abs((gaps**power).mean() - exact) < 5 * error
    print(f"{name} of the gaps: {(gaps**power).mean():.4f} +- {error:.4f} {unit}, exactly {exact:.4f} {unit}; "
          f"within five standard errors: {within}")  # fmt: skip

# %%
figure, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
ax.hist(gaps, bins=60, density=True, color="#0072B2", alpha=0.5, label="first 30 gaps of each sample")
grid = np.linspace(0.0, gaps.max(), 400)
density = gap.shape / gap.scale * (grid / gap.scale) ** (gap.shape - 1) * np.exp(-((grid / gap.scale) ** gap.shape))
ax.plot(grid, density, color="#000000", label="Weibull density")
ax.set_xlabel("time between switches (s)")
ax.set_ylabel("probability density (1/s)")
figure.legend(loc="outside upper center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# ## 4. A law of your own that is drawn while it is simulated
# A `SegmentLaw` computes segment number `i` from the key, `i`, and a memory of those before. Here the base accelerates
# or brakes at a constant rate to a new random speed, for times of an exponential distribution. The memory is the
# velocity that was reached. Long after the start the velocity is `(1 - u) A + u B`, with independent speeds A and B,
# uniform on (-s, s), and a uniform place u within the ramp: its variance is `(s^2 / 3) (2 / 3) = 2 s^2 / 9`.


# %%
class Ramps(ss.SegmentLaw):
    """Linear changes of velocity between independent uniform speeds."""

    speed: Annotated[float, ss.Quantity("m/s", above=0)]
    rate: Annotated[float, ss.Quantity("1/s", above=0)]
    is_random = True
    jumps = False

    def segments(self, t1):
        mean = self.rate * t1
        return math.ceil(mean + 6 * math.sqrt(mean) + 12)

    def begin(self, key_data, dtype):
        return jnp.zeros((), dtype)  # the base starts at rest

    def draw(self, key_data, number, dtype):
        u, v = self.uniforms(key_data, number, dtype)
        return ss.Exponential(1 / self.rate).icdf(u), ss.Uniform(-self.speed, self.speed).icdf(v)

    def next_segment(self, memory, drawn, dtype):
        duration, velocity = drawn
        return duration, memory, (velocity - memory) / duration, velocity


ramps = Ramps(speed=1.5, rate=0.7)
examine("ramps", ramps)


def variance(law, exact):
    """Print the variance of the velocity at one instant over the samples, and the exact one."""
    values = np.asarray(jax.vmap(lambda one_key: law.sample(one_key, t1).value(0.9 * t1))(keys))
    error = (values**2).std() / math.sqrt(SAMPLES)
    within = abs((values**2).mean() - exact) < 5 * error
    print(f"variance of the velocity: {(values**2).mean():.4f} +- {error:.4f} m^2/s^2, exactly {exact:.4f} m^2/s^2; "
          f"within five standard errors: {within}")  # fmt: skip


variance(ramps, 2 * ramps.speed**2 / 9)

# %% [markdown]
# ## 5. A Gaussian process with a spectrum
# The spectrum is one-sided over angular frequency: the variance is its integral, here that of a broken line.

# %%
frequencies, densities = np.array([0.5, 1.0, 2.0, 3.0]), np.array([0.0, 0.4, 0.1, 0.0])  # rad/s, m^2/s
sea = ss.GaussianProcess(ss.TabulatedSpectrum(frequencies, densities), cutoff=3.0)
examine("Gaussian process", sea)
variance(sea, np.trapezoid(densities, frequencies))

# %% [markdown]
# ## 6. A recorded velocity
# A file with a time in s and a velocity in mm/s on each line. Here the file holds the motion of section 1, 50 times a
# second, so that the sticks can be compared with those under the function: between its points a record is linear in
# time, and misses the function by at most `h^2 / 8` times the largest curvature.

# %%
times = np.arange(0.0, t1 + 0.01, 0.02)
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "belt.csv"
    rows = np.column_stack([times, 1000 * np.asarray(swell.velocity(times))])
    np.savetxt(path, rows, delimiter=",", header="time in s,velocity in mm/s", comments="", fmt="%.12g")
    print("\n".join(path.read_text().splitlines()[:3]))
    record = ss.read_recorded_csv(path, scale=1e-3)
examine("record", record)
curvature = jnp.max(jnp.abs(jax.vmap(jax.grad(swell.acceleration))(instants)))
missed = np.max(np.abs(swell.velocity(instants) - record.value(instants)))
print(f"the record misses the function by {missed:.1e} m/s, at most {0.02**2 / 8 * curvature:.1e} m/s")
change = np.abs(runs["record"].totals.stick_time - runs["function of time"].totals.stick_time)
print(f"stick time of a sample: the two differ by {np.median(change):.1e} s in the median")
for name in ("function of time", "record"):
    sticks = runs[name].sticks
    short = np.nansum(sticks.start[:, 1:] - sticks.end[:, :-1] < 2 * 0.02) / SAMPLES
    print(f"{name}: {short:.2f} slips of a sample lie between two sticks and are shorter than 0.04 s")

# %% [markdown]
# Samples of one number have the same start under both, because sample `i` depends on the key and `i` only. Under the
# record there are more sticks, parted by very short slips: the acceleration of a record is constant between its points
# and jumps there, so that the force that a stick needs may pass the friction limit several times where that of the
# function does so once. The time spent sticking changes little. To count sticks under a recorded velocity, leave out
# slips as short as the sampling interval.

# %% [markdown]
# ## All of them
# The base velocity of the first sample of each, its sticks marked.


# %%
def velocity(base, times):
    """The base velocity at these times, m/s."""
    if isinstance(base, ss.PiecewiseConstant):
        base = base.sample(None, t1)
    return base.velocity(times) if hasattr(base, "velocity") else base.value(times)


figure, panels = plt.subplots(3, 2, figsize=(10, 6.6), layout="constrained", sharex=True)
for panel, (name, many) in zip(panels.ravel(), runs.items(), strict=True):
    _, base, _ = many.realization(0)
    grid = np.linspace(0.0, 30.0, 6001)
    shown = np.asarray(velocity(base, grid))
    sticks, stuck = many.sticks, np.full(len(grid), np.nan)
    for begin, end in zip(sticks.start[0], sticks.end[0], strict=True):
        inside = (grid >= begin) & (grid < end)
        stuck[inside] = shown[inside]
    (line,) = panel.plot(grid, shown, color="#0072B2", lw=1.0)
    (thick,) = panel.plot(grid, stuck, color="#D55E00", lw=3.2)
    panel.set_title(name, fontsize="medium")
    panel.set_ylabel("base velocity (m/s)")
for panel in panels[-1]:
    panel.set_xlabel("time (s)")
figure.legend([line, thick], ["base", "the mass sticks"], loc="outside upper center", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# The shares of time spent sticking: what 95 % of the samples have, and the means.

# %%
figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
for row, many in enumerate(runs.values()):
    share = many.statistics.stick_fraction
    low, high = (100 * share.quantile(level).value for level in (0.025, 0.975))
    (bar,) = ax.plot([low, high], [row, row], color="#0072B2", lw=6, alpha=0.4)
    (dot,) = ax.plot(100 * share.mean.value, row, "o", color="#000000")
ax.set_yticks(range(len(runs)), list(runs))
ax.invert_yaxis()
ax.set_xlabel("time spent sticking (%)")
figure.legend([bar, dot], ["95 % of the samples", "mean"], loc="outside upper center", ncols=2, frameon=False)
plt.show()
