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
# # A pipeline of your own
#
# `law.sample` and `ss.simulate` are pure functions. They go under `jax.vmap`, `jax.jit`, `jax.grad` and `jax.jvp`
# together with whatever code stands around them. Here an oscillator is designed: its normal force, and then normal
# force and stiffness, are chosen so that the mass sticks for a wished share of the time.
#
# The share of time is a mean of stick times, which are continuous in the parameters, so automatic differentiation is
# right for it. Means over sticks and numbers of sticks need `ss.differentiable` instead (`notebooks/sensitivity.py`).

# %%
import os
import statistics
import time

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "5000"))
T1, Y0 = 200.0, (0.0, 0.5)  # s; m and m/s
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
key = jax.random.key(0)
BLUE, GREEN, BLACK = "#0072B2", "#009E73", "#000000"

# %% [markdown]
# ## From numbers to stick fractions
# The parameters are an array, as optimisers like them: normal force in N and stiffness in N/m. Sample `i` has the key
# `jax.random.fold_in(key, i)`.

# %%
keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(SAMPLES))
traces = []


def oscillator(parameters):
    """The oscillator with a normal force and a stiffness."""
    normal_force, stiffness = parameters
    return ss.MassSpring(mass=1.0, stiffness=stiffness, normal_force=normal_force, friction=ss.Coulomb(mu=0.9))


def simulated(parameters, key):
    """Stick fraction and status of one sample."""
    one = ss.simulate(oscillator(parameters), law.sample(key, T1), t1=T1, y0=Y0)
    return one.stick_fraction, one.status


@jax.jit
def stick_fractions(parameters, keys):
    """Stick fraction and status of each sample."""
    traces.append(keys.shape)  # Python code runs while JAX traces, and not again
    return jax.vmap(simulated, (None, 0))(parameters, keys)


start = jnp.array([1.0, 4.0])
fractions, status = stick_fractions(start, keys)
for normal_force in (0.8, 0.9, 1.1, 1.2):
    stick_fractions(start.at[0].set(normal_force), keys)
print(f"mean stick fraction {fractions.mean():.4f} +- {fractions.std() / SAMPLES**0.5:.4f}")
print("five calls, traced and compiled:", len(traces))

# %% [markdown]
# ## Statuses
# A trajectory that did not reach `t1` must enter no mean. `law.sample` draws as many intervals as `t1` needs, with a
# margin; told to draw too few, it returns a base that ends early, and the status says so.

# %%
for code in ss.Status:
    if count := int((status == code).sum()):
        print(f"{count} samples {code.name}: {code.meaning}")
short = jax.vmap(lambda one: ss.simulate(oscillator(start), law.sample(one, T1, capacity=150), t1=T1, y0=Y0).status)
print(f"with 150 intervals, one a second on average: {int((short(keys[:100]) == 0).sum())} of 100 samples reach 200 s")

# %% [markdown]
# ## The same numbers from an ensemble
# `ss.simulate_ensemble` simulates the same samples. It needs no slots for sticks that do not happen, uses all cores,
# counts statuses, and gives standard errors and the statistics of sticks. For large numbers it is the better
# choice where no derivative goes through it.

# %%
many = ss.simulate_ensemble(
    oscillator(start), law, t1=T1, samples=SAMPLES, key=key, y0=Y0, keep="sticks", progress=False
)
difference = np.abs(many.totals.stick_time / T1 - np.asarray(fractions)).max()
print("ensemble and pipeline agree sample by sample:", bool(difference < 1e-12))
print(ss.stick_fraction(many))

ratios = []
for _ in range(5):
    began = time.perf_counter()
    jax.block_until_ready(stick_fractions(start, keys))
    own = time.perf_counter() - began
    run = ss.simulate_ensemble(
        oscillator(start), law, t1=T1, samples=SAMPLES, key=key, y0=Y0, keep="totals", progress=False
    )
    ratios.append(own / run.run_seconds)
print(f"time of the pipeline: about {statistics.median(ratios):.1f} times that of the ensemble's totals")

# %% [markdown]
# ## A loss and its gradient
# How far the mean stick fraction is from the wish, squared, relative. The gradient is that of this very function with
# its random numbers fixed, so differences of the function must reproduce it, and so must `jax.jvp` in any direction.
# The step of the differences is tiny: a stick that appears where the mass grazes the base velocity grows like a square
# root, and a wide step reaches over such points.

# %%
WISH = 0.12


def mean_fraction(parameters):
    """Of the samples that reached t1."""
    fractions, status = stick_fractions(parameters, keys)
    finished = status == ss.Status.FINISHED
    return jnp.sum(jnp.where(finished, fractions, 0.0)) / jnp.sum(finished)


def loss(parameters):
    """Squared relative distance from the wish."""
    return (mean_fraction(parameters) / WISH - 1) ** 2


value, gradient = jax.jit(jax.value_and_grad(loss))(start)
step = 1e-9
by_differences = np.array([(loss(start + step * e) - loss(start - step * e)) / (2 * step) for e in np.eye(2)])
direction = jnp.array([0.6, -0.8])
_, along = jax.jit(lambda point, way: jax.jvp(loss, (point,), (way,)))(start, direction)
print(f"loss {value:.6f}, gradient {gradient}, by differences {by_differences}")
print("gradient and differences agree:", np.allclose(gradient, by_differences, rtol=1e-3))
print("gradient and jvp agree:", np.allclose(gradient @ direction, along, rtol=1e-9))

# %% [markdown]
# ## One unknown: Newton's method
# The normal force at which the mean stick fraction is the wish.

# %%
fraction_and_slope = jax.jit(jax.value_and_grad(mean_fraction))
point, path = start, []
for _ in range(8):
    fraction, slope = fraction_and_slope(point)
    path.append((float(point[0]), float(fraction)))
    print(f"normal force {point[0]:.10f} N: stick fraction {fraction:.10f}")
    if abs(fraction / WISH - 1) < 1e-9:
        break
    point = point.at[0].add((WISH - fraction) / slope[0])
by_newton = point
print("the wish is met:", bool(abs(path[-1][1] / WISH - 1) < 1e-9))

# %% [markdown]
# That is exact for these samples. Of others the mean is the wish within the sampling error; the error of the normal
# force is that of the stick fraction, divided by the slope.

# %%
others = ss.simulate_ensemble(
    oscillator(by_newton), law, t1=T1, samples=SAMPLES, key=jax.random.key(1), y0=Y0, progress=False
)
fresh = ss.stick_fraction(others)
uncertainty = fresh.standard_error / float(slope[0])
print(f"other samples: {fresh}; normal force {by_newton[0]:.4f} +- {uncertainty:.4f} N")
deviation = abs(fresh.value - WISH) / (2**0.5 * fresh.standard_error)
print(f"distance from the wish in standard errors of a difference: {deviation:.1f}; below 5: {deviation < 5}")

# %%
forces = np.linspace(0.9, 1.6, 15)
curve = np.array([mean_fraction(start.at[0].set(force)) for force in forces])
figure, ax = plt.subplots(figsize=(5.6, 3.8), layout="constrained")
ax.plot(forces, curve, color=BLUE, label="mean stick fraction")
ax.axhline(WISH, color=BLACK, lw=0.8, ls="--", label="wish")
ax.plot(*np.array(path).T, color=GREEN, marker="o", ls=":", label="Newton's steps")
ax.set(xlabel="normal force in N", ylabel="stick fraction")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=9)
plt.show()

# %% [markdown]
# ## Two unknowns: the smallest change
# Which change of normal force and stiffness, as small as possible in relative terms, fulfils the wish? `p` are the
# logarithms of the two factors, `g` is the gradient of the logarithm of the stick fraction. Each step goes half the way
# to that point of the linearised condition which is nearest to the start. At the solution the change is parallel to `g`
# (Lagrange's condition), and it is shorter than that of the normal force alone. The stick fraction of finitely many
# samples bends sharply wherever a stick appears, so the condition holds approximately.


# %%
def changed(p):
    """The parameters at the start times `exp(p)`."""
    return start * jnp.exp(p)


log_fraction = jax.jit(jax.value_and_grad(lambda p: jnp.log(mean_fraction(changed(p)))))
p = jnp.zeros(2)
for _ in range(20):
    log_value, g = log_fraction(p)
    p += 0.5 * (g * (g @ p + jnp.log(WISH) - log_value) / (g @ g) - p)
reached, g = jnp.exp(log_fraction(p)[0]), log_fraction(p)[1]
normal_force, stiffness = changed(p)
length, alone = float(jnp.hypot(*p)), float(jnp.log(by_newton[0] / start[0]))
cosine = float(g @ p / jnp.hypot(*g) / length)
print(f"normal force {normal_force:.4f} N, stiffness {stiffness:.4f} N/m: stick fraction {reached:.5f}")
print(f"length of the change {length:.4f}, of the normal force alone {alone:.4f}; cosine to the gradient {cosine:.5f}")
print("wish met within 1 %, cosine above 0.99, shorter:",
      bool(abs(reached / WISH - 1) < 0.01), cosine > 0.99, length < alone)  # fmt: skip

# %% [markdown]
# Brute force: changes of that length in all directions.

# %%
angles = np.linspace(-np.pi, np.pi, 73)
around = np.array([mean_fraction(changed(length * np.array([np.cos(a), np.sin(a)]))) for a in angles])
figure, ax = plt.subplots(figsize=(5.6, 3.8), layout="constrained")
ax.plot(np.degrees(angles), around, color=BLUE, label="changes of one length")
ax.axhline(WISH, color=BLACK, lw=0.8, ls="--", label="wish")
ax.plot(np.degrees(np.arctan2(*p[::-1])), reached, "o", color=GREEN, label="found")
ax.set(xlabel="direction in degrees: 0 normal force, 90 stiffness", ylabel="stick fraction")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=9)
plt.show()
print("no direction reaches more than the wish, within 1 %:", bool(around.max() < 1.01 * WISH))
