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
# # Regularised friction beside exact friction
#
# Many programs replace the sign of the relative velocity in the friction force by a smooth switch
# `phi(v_rel / width)`, so that any solver of differential equations can be used. The mass then never sticks: it creeps.
# `ss.Regularized(width, shape)` does this, on the same realisations of the base motion as `ss.Exact()`. This notebook
# shows what happens inside a stick, what it does to the statistics of sticks, how the errors fall with the width, and
# what it costs. More systems, and where the orders come from: `docs/regularized.md`.

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "300"))
T1, Y0, STEP, KEY = 20.0, (0.0, 1.0), 0.0025, jax.random.key(0)  # s; m and m/s; s
FORCE_LIMIT, STIFFNESS = 1.0, 4.0  # N, N/m
system = ss.MassSpring(mass=1.0, stiffness=STIFFNESS, normal_force=FORCE_LIMIT, friction=ss.Coulomb(mu=1.0))
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
WIDTHS = np.array([0.03, 0.01, 0.003, 0.001])  # m/s
SHAPES = {"linear": "#0072B2", "tanh": "#009E73", "arctan": "#CC79A7"}


def legend_above(ax, columns):
    """Put the legend above the axes."""
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, fontsize=9)


# %% [markdown]
# ## The same base motions, exact and regularised
# Fixed steps, stable for any width. The width is an argument of the compiled function, the shape is not.

# %%
bases = jax.vmap(lambda number: law.sample(jax.random.fold_in(KEY, number), T1, capacity=80))(jnp.arange(SAMPLES))
instants = np.linspace(0.0, T1, 4001)


def followed(method):
    """Of every base motion: position, relative velocity, number of sticks, stick time, status."""

    def one(base):
        run = ss.simulate(system, base, t1=T1, y0=Y0, method=method)
        position, velocity = run.evaluate(instants)
        return position, velocity - run.base_velocity(instants), run.sticks.count, run.stick_time, run.status

    return jax.vmap(one)(bases)


def regularised(shape):
    """The same, for every width."""
    run = jax.jit(lambda width: followed(ss.Regularized(width, shape, step=STEP)))
    return [jax.device_get(run(width)) for width in WIDTHS]


exact_position, exact_velocity, *exact_totals, status = jax.device_get(jax.jit(lambda: followed(ss.Exact()))())
runs = {shape: regularised(shape) for shape in SHAPES}
unfinished = np.count_nonzero(status) + sum(np.count_nonzero(one[-1]) for several in runs.values() for one in several)
print(f"trajectories that did not reach t1: {unfinished}")

# %% [markdown]
# ## Inside one stick
# The longest stick of the first motion that ends by a release. Exact: the relative velocity is zero. Regularised: while
# the mass moves slowly, friction balances the spring, `mu normal_force phi(v_rel / width) = -stiffness x`, so that the
# mass creeps with `v_rel = width phi^-1(-stiffness x / (mu normal_force))`. With the position of the exact stick this
# predicts the creep; at both ends inertia counts, too.

# %%
first = ss.simulate(system, jax.tree.map(lambda leaf: leaf[0], bases), t1=T1, y0=Y0)
released = first.sticks.mask & (first.sticks.ending == ss.Ending.RELEASED)
longest = int(np.argmax(np.where(released, first.sticks.duration, 0.0)))
start, end = float(first.sticks.start[longest]), float(first.sticks.end[longest])
print(f"the stick lasts from {start:.4f} to {end:.4f} s")

inverse = {"linear": lambda share: share, "tanh": np.arctanh, "arctan": lambda share: np.tan(np.pi / 2 * share)}
share = -STIFFNESS * exact_position[0] / FORCE_LIMIT
middle = (instants > start + 0.3 * (end - start)) & (instants < end - 0.3 * (end - start))
for shape, several in runs.items():
    largest = [
        np.abs(velocity[0, middle] / width - inverse[shape](share[middle])).max()
        for width, (_, velocity, *_) in zip(WIDTHS, several, strict=True)
    ]
    print(f"{shape:7s} creep in widths, largest difference from the prediction: "
          + ", ".join(f"{one:.4f} at {width:g} m/s" for width, one in zip(WIDTHS, largest, strict=True)))  # fmt: skip

# %%
near = (instants > start - 0.15) & (instants < end + 0.15)
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
for style, width, (_, velocity, *_) in zip((":", "-.", "--", "-"), WIDTHS, runs["linear"], strict=True):
    left.plot(instants[near], velocity[0, near], color=SHAPES["linear"], ls=style, lw=1.3, label=f"width {width:g} m/s")
left.plot(instants[near], exact_velocity[0, near], color="black", lw=1.0, label="exact")
left.plot([start, end], [0, 0], color="#D55E00", lw=3.2, label="stick")
left.set(xlabel="t in s", ylabel="relative velocity in m/s, linear", ylim=(-0.01, 0.05))
legend_above(left, 3)
for shape, color in SHAPES.items():
    right.plot(instants[near], runs[shape][-1][1][0, near] / WIDTHS[-1], color=color, lw=1.3, label=shape)
    inner = (instants > start) & (instants < end)
    right.plot(instants[inner], inverse[shape](share[inner]), color=color, ls=":", lw=2.2, label="predicted")
right.plot([start, end], [0, 0], color="#D55E00", lw=3.2, label="stick")
right.set(xlabel="t in s", ylabel=f"relative velocity in widths of {WIDTHS[-1]:g} m/s", ylim=(-1.5, 4))
legend_above(right, 4)
plt.show()

# %% [markdown]
# ## How fast errors fall
# The largest distance from the exact motion in position, over the position at which a stick is released
# (`mu normal_force / stiffness`); the median of all samples. The slopes between neighbouring widths approach 1 for the
# linear shape, 1 with a logarithm for tanh and 2/3 for arctan, which reaches full friction slowly.

# %%
scale = FORCE_LIMIT / STIFFNESS
trajectory_error = {
    shape: np.array([np.median(np.abs(one[0] - exact_position).max(1)) / scale for one in several])
    for shape, several in runs.items()
}
for shape, errors in trajectory_error.items():
    slopes = np.diff(np.log(errors)) / np.diff(np.log(WIDTHS))
    print(f"{shape:7s} trajectory error " + ", ".join(f"{error:.1e}" for error in errors)
          + "; slopes " + ", ".join(f"{slope:.2f}" for slope in slopes))  # fmt: skip

# %% [markdown]
# ## What happens to the statistics of sticks
# A regularised stick is a time in which the relative velocity stays below a threshold (by default about a width) for a
# minimum duration. Short sticks are missed, so the mean duration comes out too long. All have the same base motions,
# sample by sample; the errors are those of the paired differences, and bars have 95 % confidence.


# %%
def compared(totals):
    """Relative errors in % of number of sticks and pooled mean duration, and the standard errors of both, (2, 2)."""
    (exact_count, exact_time), (count, time) = exact_totals, totals
    more = count / exact_count.mean() - exact_count / exact_count.mean()
    ratio = time.sum() / count.sum() * exact_count.sum() / exact_time.sum()
    pulls = (
        time / time.mean() - count / count.mean() - exact_time / exact_time.mean() + exact_count / exact_count.mean()
    )
    return 100 * np.array([[more.mean(), ratio - 1], [more.std(), ratio * pulls.std()] / np.sqrt(SAMPLES)])


exact_count, exact_time = exact_totals
print(f"exact: {exact_count.mean():.2f} sticks of {exact_time.sum() / exact_count.sum():.4f} s")
errors = {shape: np.array([compared(one[2:4]) for one in several]) for shape, several in runs.items()}
for shape, one in errors.items():
    for width, ((count, duration), (count_error, duration_error)) in zip(WIDTHS, one, strict=True):
        print(f"{shape:7s} width {width:5g} m/s: number of sticks {count:+6.1f} +- {count_error:.1f} %, "
              f"mean duration {duration:+6.1f} +- {duration_error:.1f} %")  # fmt: skip

# %%
figure, panels = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
for index, name in enumerate(("number of sticks", "mean duration")):
    panel = panels[index]
    for shape, color in SHAPES.items():
        value, error = errors[shape][:, :, index].T
        panel.errorbar(WIDTHS, value, 1.96 * error, color=color, marker="o", ms=3.5, capsize=2.5, label=shape)
    panel.axhline(0, color="black", lw=0.8)
    panel.set(xscale="log", xlabel="width in m/s", ylabel=f"error of the {name} in %")
    legend_above(panel, 3)
for shape, color in SHAPES.items():
    panels[2].loglog(WIDTHS, trajectory_error[shape], color=color, marker="o", ms=3.5, label=shape)
for power, style in ((1.0, ":"), (2 / 3, "--")):
    guide = (
        trajectory_error["arctan" if power < 1 else "linear"][1]
        * (1.6 if power < 1 else 0.6)
        * (WIDTHS / WIDTHS[1]) ** power
    )
    panels[2].loglog(WIDTHS, guide, color="0.4", ls=style, lw=1, label="slope 1" if power == 1 else "slope 2/3")
panels[2].set(xlabel="width in m/s", ylabel="trajectory error, relative")
legend_above(panels[2], 3)
plt.show()

# %% [markdown]
# ## What it costs
# The same ensemble, exact and in fixed steps, five times in turn, compilation not counted. Samples of an ensemble are
# those of above: sample `i` has the key `fold_in(key, i)`.


# %%
def ensemble(method):
    """All samples by `method`."""
    return ss.simulate_ensemble(
        system, law, t1=T1, samples=SAMPLES, key=KEY, y0=Y0, method=method, keep="sticks", progress=False
    )


ratios = []
for _ in range(5):
    exact, slow = ensemble(ss.Exact()), ensemble(ss.Regularized(WIDTHS[-1], "linear", step=STEP))
    ratios.append(slow.run_seconds / exact.run_seconds)
print("the same numbers of sticks:", np.array_equal(exact.totals.sticks, exact_count),
      np.array_equal(slow.totals.sticks, runs["linear"][-1][2]))  # fmt: skip
print(f"regularised, {T1 / STEP:.0f} steps: about {np.median(ratios):.0f} times the time of the exact engine")

# %% [markdown]
# **Verdict.** The regularised motion converges to the exact one, and inside a stick it creeps as the balance of forces
# says. Its sticks depend on the width, the shape, the threshold and the minimum duration; the exact method has none of
# these.
