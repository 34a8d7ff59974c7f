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
# # Derivatives of means over sticks
#
# How does the mean duration of a stick change with the friction coefficient? Every stick's start and end are exact
# functions of it, and JAX differentiates them. The derivative of the mean so computed is wrong all the same: sticks
# appear and vanish as the friction coefficient changes, and to automatic differentiation their number is a constant.
# `ss.sensitivity` adds what is missing. This notebook shows the error, its cause, and the correction, and checks the
# correction by differences and by dimensional analysis. The method: `docs/sensitivity.md`.

# %%
import os
import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = max(int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "20_000")), 1000)  # fewer have too few sticks to lose
MU, T1, Y0 = 0.9, 200.0, (0.0, 0.5)  # friction coefficient; s; m and m/s
KEY, OTHER_KEY = jax.random.key(0), jax.random.key(1)
RATE = 1.0  # 1/s
law = ss.PoissonSwitching(speed=1.0, rate=RATE)
BLUE, PINK, BLACK = "#0072B2", "#CC79A7", "#000000"


def oscillator(mu):
    """The oscillator with the friction coefficient `mu`."""
    return ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))


# %% [markdown]
# ## Automatic differentiation, and what it leaves out
# The pooled mean duration is the stick time of all samples divided by the number of their sticks. Here it is written
# down as it stands and given to `jax.value_and_grad`.


# %%
def totals(mu, number, rate=RATE):
    """Stick time and number of sticks of one sample."""
    base = ss.PoissonSwitching(1.0, rate).sample(jax.random.fold_in(KEY, number), t1=T1, capacity=300)
    one = ss.simulate(oscillator(mu), base, t1=T1, y0=Y0)
    return one.stick_time, one.sticks.count


def means(mu, rate=RATE):
    """Mean stick duration (s), stick fraction and mean number of sticks of all samples."""
    stick_time, count = jax.vmap(totals, (None, 0, None))(mu, jnp.arange(SAMPLES), rate)
    return stick_time.sum() / count.sum(), stick_time.mean() / T1, count.astype(float).mean()


mean, fraction, mean_count = jax.jit(means)(MU)
(naive, naive_by_rate), by_fraction, by_count = jax.jit(jax.jacfwd(means, (0, 1)))(MU, RATE)
print(f"mean stick duration {mean:.4f} s, its derivative by automatic differentiation {naive:.4f} s")

# %%
settings = {"t1": T1, "samples": SAMPLES, "key": KEY, "y0": Y0}
names = ("mu", "normal_force", "mass", "stiffness", "speed", "rate")
# They act only through their product, of which a warning tells. Here that is to be seen (below, in the elasticities).
warnings.filterwarnings("ignore", "mu and normal_force act", RuntimeWarning)
by_mu = ss.sensitivity(ss.mean_stick_duration, oscillator(MU), law, wrt=names, **settings)["mu"]
print(by_mu)
print(f"along the trajectories {by_mu.pathwise:.4f}, by sticks that appear and vanish {by_mu.event:+.4f}")
print("automatic differentiation gives the first of these two:", np.isclose(naive, by_mu.pathwise, rtol=1e-9))

# %% [markdown]
# The judge is a central difference: two ensembles with other random numbers than above, common to both. What sample
# `i` does at the one friction coefficient is paired with what it does at the other, and the error is that of the
# differences.


# %%
def stick_sums(key=OTHER_KEY, mu=MU, rate=RATE, t1=T1, y0=Y0):
    """Stick time and number of sticks of each sample, (2, samples)."""
    law = ss.PoissonSwitching(1.0, rate)
    many = ss.simulate_ensemble(
        oscillator(mu), law, t1=t1, samples=SAMPLES, key=key, y0=y0, keep="sticks", progress=False
    )
    return np.array([many.totals.stick_time, many.totals.sticks])


def logarithm(sums):
    """Logarithm of the mean stick duration, and for each sample by how much it moves it (delta method)."""
    time, count = sums
    return np.log(time.sum() / count.sum()), time / time.mean() - count / count.mean()


def elasticity(down, up, relative_step):
    """Central difference of two paired ensembles, d log mean / d log parameter, and its standard error."""
    (low, pulls_low), (high, pulls_high) = logarithm(down), logarithm(up)
    return (high - low) / (2 * relative_step), np.std(pulls_high - pulls_low) / np.sqrt(SAMPLES) / (2 * relative_step)


STEP = 0.01
slope, error = (
    float(mean) / MU * part for part in elasticity(stick_sums(mu=MU * (1 - STEP)), stick_sums(mu=MU * (1 + STEP)), STEP)
)
print(f"central difference: {slope:.4f} +- {error:.4f} s")
for name, value, own_error in (("corrected", by_mu.derivative, by_mu.standard_error), ("naive", naive, 0.0)):
    print(f"{name:9s} {value:.4f}: {abs(value - slope) / np.hypot(error, own_error):5.1f} standard errors from it, "
          f"{value / slope:.2f} times as large")  # fmt: skip

# %% [markdown]
# **Verdict.** Automatic differentiation alone is wrong by a large factor, and no number of samples makes it right. The
# corrected derivative agrees with the difference.

# %%
mus = np.linspace(0.6, 1.2, 13)
sums = [stick_sums(KEY, mu) for mu in mus]
durations = [np.exp(logarithm(one)[0]) for one in sums]
errors = [
    duration * np.std(logarithm(one)[1]) / np.sqrt(SAMPLES) for duration, one in zip(durations, sums, strict=True)
]
ax = ss.plot.curve(mus, durations, errors=errors, xlabel="friction coefficient", ylabel="mean stick duration in s",
                   label="ensembles")  # fmt: skip
near = np.array([MU - 0.2, MU + 0.2])
for name, color, derivative in (("corrected", BLACK, by_mu.derivative), ("naive", PINK, naive)):
    ax.plot(near, float(mean) + derivative * (near - MU), color=color, ls="--", lw=1.6, label=f"tangent, {name}")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# ## Why: the number of sticks is a staircase
# Of one realisation of the base, at 2001 friction coefficients, the number of sticks is constant between jumps, so its
# derivative is zero wherever there is one. The mean number over many realisations rises without steps. The mean
# duration in the one realisation follows its own derivative between the jumps, and falls where a short stick appears.

# %%
fine = np.linspace(mus[0], mus[-1], 2001)
stick_time, count = jax.jit(jax.vmap(totals, (0, None)))(fine, 0)
print(f"number of sticks of the realisation: {count[0]} to {count[-1]}, in {np.count_nonzero(np.diff(count))} jumps")
print(f"derivative of the mean number, {mean_count:.1f}, by automatic differentiation: {by_count[0]:.1f}")
print(ss.sensitivity(ss.mean_stick_count, oscillator(MU), law, wrt=names, **settings)["mu"])

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", sharex=True)
counts = np.array([one[1] for one in sums])
left.step(fine, count, where="mid", color=BLUE, lw=1.2, label="one realisation")
left.errorbar(mus, counts.mean(1), 1.96 * counts.std(1) / SAMPLES**0.5, color=BLACK, marker="o", ms=3.5, capsize=2.5,
              label="mean over samples, 95 % confidence")  # fmt: skip
left.set_ylabel("number of sticks in 200 s")
right.plot(fine, stick_time / count, color=BLUE, lw=1.2, label="one realisation")
right.plot(mus, durations, color=BLACK, marker="o", ms=3.5, label="pooled over samples")
right.set_ylabel("mean stick duration in s")
for panel in (left, right):
    panel.set_xlabel("friction coefficient")
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
plt.show()

# %% [markdown]
# ## What needs no correction
# A stick that appears has length zero, so it adds nothing to the stick time. The stick time of each trajectory is
# continuous in the friction coefficient, and the mean of its derivatives is right.

# %%
down, up = (stick_sums(mu=MU * (1 + sign * STEP))[0] / T1 for sign in (-1, 1))
ratios = (up - down) / (2 * STEP * MU)
print(f"stick fraction {fraction:.4f}, its derivative by automatic differentiation {by_fraction[0]:.4f}, "
      f"by differences of other samples {ratios.mean():.4f} +- {ratios.std() / SAMPLES**0.5:.4f}")  # fmt: skip

# %% [markdown]
# ## Which parameter matters most
# Elasticities: by how many percent the mean stick duration changes when a parameter grows by one percent. All come from
# one pass over the trajectories.

# %%
found = ss.sensitivity(ss.mean_stick_duration, oscillator(MU), law, wrt=names, elasticity=True, **settings)
print(found)
ax = ss.plot.tornado(found)

# %% [markdown]
# The longest possible stick lasts while the base drags the mass through the whole band in which friction can hold it,
# `2 mu normal_force / (stiffness speed)`. Its elasticities are 1, 1, -1 and -1, and 0 by mass and rate; those of the
# mean are near, but not the same.
#
# Dimensional analysis says what elasticities must add up to, without any simulation. Friction coefficient and normal
# force act through their product only. Mass, stiffness and normal force times one factor change nothing. Normal force,
# base speed and initial velocity times one factor change lengths but no duration. And in another unit of time every
# duration is another number: twice the elasticity by mass, minus those by speed, rate and initial velocity, plus that
# by `t1`, is 1. Those by initial velocity and by `t1`, which are small, come from central differences. How the errors
# are correlated is not known; the sum of their sizes is a bound.

# %%
e, s = ({name: getattr(one, part) for name, one in found.items()} for part in ("derivative", "standard_error"))
wide = 0.1
for name, change in (("velocity", lambda f: {"y0": (0.0, 0.5 * f)}), ("t1", lambda f: {"t1": T1 * f})):
    e[name], s[name] = elasticity(*(stick_sums(**change(1 + sign * wide)) for sign in (-1, 1)), wide)
    print(f"by {name}: {e[name]:.4f} +- {s[name]:.4f}")

print("mu and normal force have one elasticity:", np.isclose(e["mu"], e["normal_force"], rtol=1e-9))
for rule, weights, must in (
    ("forces", {"mass": 1, "stiffness": 1, "normal_force": 1}, 0),
    ("lengths", {"normal_force": 1, "speed": 1, "velocity": 1}, 0),
    ("time", {"mass": 2, "speed": -1, "rate": -1, "velocity": -1, "t1": 1}, 1),
):
    total = sum(weight * e[name] for name, weight in weights.items())
    bound = sum(abs(weight) * s[name] for name, weight in weights.items())
    print(f"scale of {rule}: sum {total:.3f}, must be {must}; error at most {bound:.3f}; "
          f"within three of these: {abs(total - must) < 3 * bound}")  # fmt: skip

# %% [markdown]
# ## The switching rate
# The rate stretches all intervals between reversals, so the later a stick, the more it is shifted. To the bias of
# automatic differentiation this adds noise. The corrected derivative follows no such shifts: it takes the part of the
# rate from the probability of the number of reversals. The difference needs a wide step, here 5 %.

# %%
slope, error = elasticity(stick_sums(rate=0.95 * RATE), stick_sums(rate=1.05 * RATE), 0.05)
print(f"elasticity by rate: corrected {e['rate']:.4f} +- {s['rate']:.4f}, "
      f"central difference {slope:.4f} +- {error:.4f}, naive {naive_by_rate * RATE / mean:+.4f}")  # fmt: skip

# %% [markdown]
# **Verdict.** Means over sticks need `ss.sensitivity`, or `ss.differentiable` within an objective of one's own;
# stick times and stick fractions can be differentiated as they stand.
