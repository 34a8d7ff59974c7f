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
# # Limit cycles, stops, chaos and basins
#
# The questions of nonlinear dynamics, asked of masses with dry friction: which cycle does a mass on a belt settle on,
# and where does that cycle end; how often does a forced mass stop; how does a forced mass on a belt become chaotic; and
# which starts come to rest. Everything is exact: events to machine precision, derivatives through them, unstable
# orbits too.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import nonlinear

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1000"))
VALUES = min(SAMPLES, 400)  # of a parameter
SIDE = int(SAMPLES**0.5 * 3)  # of a grid of starts

# %% [markdown]
# ## The stick-slip cycle of a mass on a belt, and where it ends
#
# The cycle of Leine and others (1998): friction falls with the speed of the slip. Newton's method finds it with its
# period. Its multipliers are 1, along the cycle, and 0: a stick forgets everything.

# %%
leine = ss.MassSpring(
    mass=1.0,
    stiffness=1.0,
    normal_force=1.0,
    friction=ss.VelocityWeakening(mu_static=1.0, weakening=3.0),
)
orbit = nonlinear.periodic_orbit(leine, ss.Constant(0.2), y0=(1.0, 0.2))
print(f"period {orbit.period:.9f} s, multipliers {orbit.multipliers.real.round(9)}")
print("residuals:", " ".join(f"{size:.0e}" for size in orbit.residuals if size > 0))

# %% [markdown]
# With damping, and friction that falls to half, the cycle ends at a certain speed of the belt (the case of bSTAB and
# pyBasin). Followed with growing speed, its stick becomes ever shorter. Where it is gone, the cycle meets an unstable
# one, which never touches the velocity of the belt: the branch turns round in a corner.

# %%
oscillator = ss.MassSpring(
    mass=1.0,
    stiffness=1.0,
    normal_force=1.0,
    friction=ss.Stribeck(mu=0.5, mu_static=1.0, stribeck_speed=0.5),
    damping=0.1,
)
cycle = nonlinear.periodic_orbit(oscillator, ss.Constant(1.5), y0=(0.5, 1.5))
branch = nonlinear.continue_orbit(cycle, "speed", until=2.0)
for event in branch.events:
    print(f"{event.kind} at {event.parameter:.9f} m/s: {event.text}")
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
ss.plot.orbit_branch(branch, "period", ax=axes[0])
ss.plot.orbit_branch(branch, "stick_fraction", ax=axes[1])
plt.show()

# %% [markdown]
# ## Stops of a forced mass
#
# Den Hartog (1931) asked how often a mass stops under a harmonic force and Coulomb friction. At a high frequency it
# turns without a stop until friction is strong, and then rests for a while after each turn. At a low frequency the
# first stop comes on the way, in the midst of the half period, and the one at the turn later.

# %%
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for ax, frequency in zip(axes, (0.8, 0.4), strict=True):
    forced = ss.MassSpring(
        1.0, 1.0, 0.1, ss.Coulomb(1.0), force=ss.Harmonic(1.0, frequency)
    )  # the normal force is the friction force
    turning = nonlinear.periodic_orbit(forced, ss.Constant(0.0), y0=(1.0, 0.2))
    stops = nonlinear.continue_orbit(turning, "normal_force", until=0.95)
    for event in stops.events:
        print(f"frequency {frequency}: {event.kind} at {event.parameter:.6f}: {event.text}")
    ss.plot.orbit_branch(stops, "stick_fraction", ax=ax)
    ax.figure.suptitle("0.8 and 0.4 times the natural frequency")
plt.show()

# %% [markdown]
# At 0.8 his closed form gives the ratio of friction and force at which the first stop appears:

# %%
gain = 1 / (1 - 0.8**2)
lag = np.sin(np.pi / 0.8) / (0.8 * (1 + np.cos(np.pi / 0.8)))
print(f"closed form {gain * 0.8**2 / np.sqrt(1 + 0.8**4 * lag**2):.6f}")

# %% [markdown]
# ## A period-doubling route, and its largest Lyapunov exponent
#
# A force on the mass of a belt with falling friction. Below the diagram the largest Lyapunov exponent, positive where
# the motion is chaotic.

# %%
frequencies = np.linspace(1.505, 2.405, VALUES)
driven = ss.MassSpring(
    mass=1.0,
    stiffness=1.0,
    normal_force=1.0,
    friction=ss.VelocityWeakening(mu_static=1.0, weakening=3.0),
    damping=0.001,
    force=ss.Harmonic(amplitude=0.6, angular_frequency=1.9),
)
belt = ss.Constant(0.3)  # m/s
over = {"angular_frequency": frequencies}
diagram = nonlinear.bifurcation_diagram(driven, belt, over)
exponents = nonlinear.lyapunov_exponents(driven, belt, over=over, exponents=1, kept=300)
largest = exponents.lyapunov_exponent.isel(exponent=0)
figure, axes = plt.subplots(2, 1, figsize=(8, 7), sharex=True, layout="constrained")
ss.plot.bifurcation_diagram(diagram, ax=axes[0])
axes[1].plot(frequencies, largest, lw=0.8, color="black")
axes[1].axhline(0, lw=0.8, color="0.6")
axes[1].set(xlabel="angular frequency (rad/s)", ylabel="largest Lyapunov exponent (1/s)", ylim=(-0.5, 0.25))
axes[0].set_xlabel("")
plt.show()
repeating = diagram.recurrence.values > 0
print(f"all finished: {bool((diagram.status == 0).all())}")
print(f"chaotic {(largest > 0.02).mean().item():.0%}, periodic {repeating.mean():.0%} of the frequencies")
print("no chaotic motion repeats itself:", not np.any(repeating & (largest.values > 0.02)))

# %% [markdown]
# Over the amplitude too, it is a map of order and chaos.

# %%
grid = {
    "angular_frequency": np.linspace(1.505, 2.405, max(VALUES // 10, 2)),
    "amplitude": np.linspace(0.3, 0.9, max(VALUES // 12, 2)),  # N
}
chaos = nonlinear.lyapunov_exponents(driven, belt, over=grid, exponents=1, kept=200)
ss.plot.parameter_map(chaos.lyapunov_exponent.isel(exponent=0), contours=False, limits=(-0.3, 0.15))
plt.show()

# %% [markdown]
# ## Which starts come to rest
#
# On a belt of 1.5 m/s the damped mass has two attractors: an equilibrium, and the stick-slip cycle from above. The
# unstable cycle is the boundary of their basins.

# %%
starts = {"position": np.linspace(-2, 2, 2 * SIDE), "velocity": np.linspace(-2, 2, 2 * SIDE)}
basins = nonlinear.basins(oscillator, ss.Constant(1.5), y0=starts, transient=80, kept=20, period=5.0)
ax = ss.plot.basins(basins)
unstable = nonlinear.periodic_orbit(oscillator, ss.Constant(1.5), y0=(1.83, -0.1), period=6.3)
times = np.linspace(0, float(unstable.period), 400)
ax.plot(*unstable.simulation.evaluate(times), color="white", lw=1.2)
plt.show()
print(f"{basins.sizes['attractor']} attractors, shares {basins.share.values.round(2)}")
print(f"the unstable cycle: converged {bool(unstable.converged)}, stable {unstable.is_stable}")
