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
# # stickslip_jax in one page
#
# A mass on a spring rubs on a base that moves at random. At times it **sticks** to the base, at times it **slips**.
# `stickslip_jax` finds every stick exactly, for one realisation of the base motion or for millions.
# This file opens as a notebook with [jupytext](https://jupytext.readthedocs.io), and also runs as a plain script.

# %%
import os

import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))

# %% [markdown]
# ## What moves, and what drives it
# SI units throughout. The base runs forward or backward and turns at the points of a Poisson process; `SquareWave`,
# `RandomSteps`, `PiecewiseConstant` and `Constant` are the other laws.

# %%
system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.8))
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
t1, y0 = 200.0, (0.0, 1.0)  # s; m and m/s

# %% [markdown]
# ## One realisation
# Randomness ends at `sample`; `simulate` is a pure function of what it is given. It records every stick.

# %%
base = law.sample(jax.random.key(0), t1=t1)
one = ss.simulate(system, base, t1=t1, y0=y0)
print(one)

first = slice(0, 5)
for start, duration, code in zip(
    one.sticks.start[first], one.sticks.duration[first], one.sticks.ending[first], strict=True
):
    print(f"stick at {start:8.4f} s for {duration:.4f} s, ended: {ss.Ending(int(code)).name}")

# %%
axes = ss.plot.time_history(one, window=(20.0, 50.0))

# %%
ax = ss.plot.phase_portrait(one, window=(20.0, 50.0), abscissa="position_times_omega")

# %% [markdown]
# ## Derivatives
# Event times are exact functions of the parameters, and so are their derivatives: here that of the total stick time of
# this realisation with respect to the friction coefficient, beside a finite difference.


# %%
@jax.jit
def stick_time(mu):
    rubbing = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))
    return ss.simulate(rubbing, base, t1=t1, y0=y0).stick_time


slope = jax.grad(stick_time)(0.8)
difference = (stick_time(0.8 + 1e-7) - stick_time(0.8 - 1e-7)) / 2e-7
print(f"d(stick time)/d(mu) = {slope:.6f} s, by finite difference {difference:.6f} s")

# %% [markdown]
# ## Many realisations
# Sample `i` depends on the key and `i` only. Every estimate carries its standard error. `keep="statistics"` (the
# default) needs no memory for the samples; `keep="sticks"` keeps every stick of each.

# %%
many = ss.simulate_ensemble(
    system, law, t1=t1, samples=SAMPLES, key=jax.random.key(1), y0=y0, keep="sticks", progress=False
)
print(many, "\n")
for estimate in (
    ss.stick_fraction,
    ss.mean_stick_count,
    ss.mean_stick_duration,
    ss.mean_slip_count,
    ss.mean_slip_duration,
):
    print(estimate(many))

# %% [markdown]
# All statistics in a table, and one by one in `many.statistics`: quantiles, entropies, histograms, joint histograms.

# %%
many.summary()

# %%
ax = ss.plot.histogram(many.statistics.duration, bins=100)

# %%
axes = ss.plot.joint_histogram(many.statistics.joint("duration", "position"))

# %% [markdown]
# The same sticks as labelled arrays, ready for NetCDF:

# %%
many.to_xarray()

# %% [markdown]
# ## A published figure
# The share of time spent sticking against the frequency of the base, `r = f_b / (omega / 2 pi)` (Lima and Sampaio,
# conference paper): one steady period of a square wave (their figure 6), and random steps (the base of their figure 7)
# with the band that holds 95 % of the samples. A batch of exact simulations is one `jax.vmap`.

# %%
ratios = np.linspace(0.1, 2.5, 241)
shares = jax.jit(jax.vmap(papers.steady_stick_share))(jnp.asarray(ratios))
best = int(np.argmax(shares))
print(f"largest share: {100 * shares[best]:.2f} % at r = {ratios[best]:.2f}")

few_ratios = np.linspace(0.1, 2.5, 17)
fractions = []
for ratio in few_ratios:
    setup = papers.random_belt(ratio)
    runs = ss.simulate_ensemble(
        setup.system,
        setup.law,
        t1=setup.t1,
        samples=max(20, SAMPLES // 10),
        key=jax.random.key(2),
        y0=setup.y0,
        progress=False,
    )
    fractions.append(runs.statistics.stick_fraction)

# %%
ax = ss.plot.stick_fraction_curve(ratios, shares, label="square wave, one steady period")
ax = ss.plot.stick_fraction_curve(
    few_ratios, fractions, label="random steps, mean", band_label="random steps, 95 % of samples", ax=ax
)

# %% [markdown]
# ## Everything that has no closed form
# Damping, forces, other friction laws, smooth and recorded bases run in time steps, with every switch located inside
# its step. Here a damped, forced mass on a base that oscillates: the shaded band is where friction can hold it.

# %%
forced = ss.MassSpring(
    mass=1.0,
    stiffness=1.0,
    normal_force=1.0,
    friction=ss.Coulomb(0.4),
    damping=0.4,
    force=ss.Harmonic(amplitude=1.0, angular_frequency=0.7),
)
swinging = ss.Harmonic(amplitude=1.0, angular_frequency=1.0, offset=0.7)
two = ss.simulate(forced, swinging, t1=30.0, y0=(3.0, 0.0))
print(two)
print("sticks at", [f"{start:.8f}" for start in two.sticks.start[two.sticks.mask]])

# %%
axes = ss.plot.time_history(two)

# %% [markdown]
# ## The motor and the cart
# Lima and Sampaio (2022): random phase of the voltage, random initial angle. How long the first stick lasts depends on
# the angle at which the motor stops; the line is the closed-form bound (their figure 5).

# %%
setup = papers.motor_cart(mu=0.5)
motors = ss.simulate_ensemble(
    setup.system,
    setup.law,
    t1=setup.t1,
    y0=setup.y0,
    samples=SAMPLES,
    key=jax.random.key(3),
    keep="sticks",
    progress=False,
)
first_sticks = ss.first_stick(motors)
print(first_sticks)

# %%
ax = ss.plot.stick_map(first_sticks, system=motors.system, bound=setup.law)
