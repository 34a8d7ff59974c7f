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
# # The stick-mode duration over friction and frequency
#
# Lima and Sampaio, *Stick-mode duration of a dry-friction oscillator with an uncertain model* (J. Sound Vib. 353,
# 2015): a mass on a spring rubs on a belt whose velocity is constant, harmonic, a square wave or random. The paper
# asks where friction feeds energy in, and which share of the time the mass sticks, by friction coefficient mu and by
# frequency ratio r. The text that this notebook is made from ends before the paper's numbers: the values of the
# parameters here are those of the authors' conference paper, the grids are chosen here, and no number below is one of
# the paper's.

# %%
import math
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))
POINTS = 25 if SAMPLES >= 10_000 else 7  # along each axis of the maps
oscillator = papers.belt_oscillator()
omega = float(oscillator.angular_frequency)  # rad/s


def belt(law, ratio):
    """The belt of a law, "square" or "harmonic", at the frequency ratio r."""
    frequency = ratio * omega / (2 * math.pi)  # Hz
    if law == "square":
        return ss.SquareWave(papers.BELT_SPEED, 1 / frequency)
    return ss.Harmonic(papers.BELT_SPEED, 2 * math.pi * frequency)


# %% [markdown]
# ## Where friction feeds energy in
# The paper divides the phase plane of a belt of constant speed into regions by whether friction introduces or
# dissipates energy. The power of the friction force on the mass is force times velocity. In a slip it is positive where
# the mass moves the way of the belt and is slower than it, and negative elsewhere. In a stick friction balances the
# spring, so that the power is `k x v`: positive where the belt loads the spring, negative where the spring, still
# loaded the other way, pulls the mass along.

# %%
one = ss.simulate(oscillator, ss.Constant(1.0), t1=12.0, y0=(-0.9, 0.0))
ax = ss.plot.phase_portrait(one, abscissa="position_times_omega", energy_regions=True)

# %%
times = np.linspace(0.0, 12.0, 2001)
for start in ((-0.9, 0.0), (-0.2, 1.0)):
    motion = ss.simulate(oscillator, ss.Constant(1.0), t1=12.0, y0=start)
    x, velocity = (np.asarray(values) for values in motion.evaluate(times))
    power = np.asarray(motion.friction_force(times)) * velocity
    begin, end = (
        np.asarray(values)[np.asarray(motion.sticks.mask)] for values in (motion.sticks.start, motion.sticks.end)
    )
    sticking = ((times[:, None] >= begin) & (times[:, None] < end)).any(axis=1)
    region = (velocity > 0) & (velocity <= 1.0)  # and the belt's line
    expected = np.where(sticking, x > 0, region)
    right = [((power > 0) == one).sum() for one in (expected, region)]
    print(f"start {start}: {sticking.sum()} of {len(times)} instants in a stick, {(sticking & (x < 0)).sum()} at x < 0;"
          f" the sign of the power is as said at {right[0]}, by regions with the line at {right[1]}")  # fmt: skip

# %% [markdown]
# In a stick the belt, or the spring, works without loss. In the circles that follow the belt goes on working, at the
# rate `mu n v`, and over a whole circle all of that work becomes heat: what friction feeds in on one part of it it
# takes away on the rest.

# %%
axes = ss.plot.energies(one)
found = one.energies(12.0)
print(f"after 12 s: the belt supplied {float(found.supplied['base']):.4f} J, friction turned "
      f"{float(found.dissipated['friction']):.4f} J into heat, imbalance {float(found.imbalance):.0e} J")  # fmt: skip
stick = [float(instants[0]) for instants in (one.sticks.start, one.sticks.end)]
for name, (begin, end) in (("the stick", stick), ("the last circle", (12.0 - 2 * math.pi / omega, 12.0))):
    before, after = one.energies(begin), one.energies(end)
    supplied = float(after.supplied["base"] - before.supplied["base"])
    heat = float(after.dissipated["friction"] - before.dissipated["friction"])
    print(f"{name}, {end - begin:.4f} s: the belt supplied {supplied:.4f} J, heat {abs(heat):.4f} J")

# %% [markdown]
# ## Steady motion on periodic belts
# The sticks of the last ten periods of 400, in the colour of sticks in all figures, for friction coefficients 0.5 and
# 2. On a harmonic belt slips have one colour, because its direction is not constant during them.

# %%
figure, panels = plt.subplots(2, 3, figsize=(12, 8.4), layout="constrained")
for row, law in zip(panels, ("square", "harmonic"), strict=True):
    for panel, (mu, ratio) in zip(row, ((0.5, 0.8), (2.0, 0.8), (2.0, 1.5)), strict=True):
        period = 2 * math.pi / (ratio * omega)
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        one = ss.simulate(system, belt(law, ratio), t1=400 * period, y0=(0.0, 1.0))
        ss.plot.phase_portrait(one, abscissa="position_times_omega", window=(390 * period, 400 * period), ax=panel)
        panel.get_legend().remove()
        panel.set_title(f"{law}, mu = {mu:g}, r = {ratio:g}", fontsize=10)
handles = {
    label: handle for panel in panels.flat for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
}
figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=5, frameon=False)
plt.show()

# %% [markdown]
# ## The share of time spent sticking
# Of 200 s from the start on the belt, over friction coefficient and frequency ratio: `papers.stick_share_map`, which
# `stickslip sweep --paper stick-share-square` (`-harmonic`, `-random`, `-constant`) runs from the command line.

# %%
frictions, ratios = np.linspace(0.1, 4.0, POINTS), np.linspace(0.1, 2.5, POINTS)
maps = {}
figure, panels = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
for panel, law in zip(panels, ("square", "harmonic"), strict=True):
    maps[law] = papers.stick_share_map(law, mu=frictions, ratios=ratios).run(progress=False)
    ss.plot.parameter_map(maps[law].stick_fraction, ax=panel, contours=False, limits=(0, 1))
    panel.set_title(f"{law} belt", fontsize=10)
plt.show()
constant = papers.stick_share_map("constant", mu=frictions).run(progress=False)
run = jax.vmap(lambda mu: ss.simulate(papers.belt_oscillator(mu), ss.Constant(1.0), t1=200.0, y0=(0.0, 1.0)).sticks)
sticks = run(jnp.asarray(frictions))
print(f"constant belt: at most {int(sticks.count.max())} stick, from {float(sticks.start[:, 0].max()):g} s on; "
      f"at most {100 * float(constant.stick_fraction.max()):.2f} % of 200 s")  # fmt: skip

# %% [markdown]
# **On a belt of constant speed** there is one stick at most, at the beginning. **On a harmonic belt** the mass sticks
# for ever once friction is large enough: while it sticks, `x' = v0 cos(r omega t)`, and the force that this needs has
# the amplitude `m v0 omega |r - 1 / r|`. Where `mu n` is at least that, and only there, the share is 100 %. Between
# two jumps **a square wave** asks for a stick that ends at the latest with the jump: its velocity jumps, which no
# finite friction can follow.

# %%
shares = maps["harmonic"].stick_fraction.transpose("mu", "r").values
needed = papers.BELT_SPEED * omega * np.abs(ratios - 1 / ratios)
for_ever = frictions[:, None] >= needed
agrees = (shares > 1 - 1e-9) == for_ever
print(f"harmonic belt: sticks for ever exactly where the formula says so at {agrees.sum()} of "
      f"{for_ever.size} points, for ever at {for_ever.sum()}")  # fmt: skip


steady_share = jax.jit(jax.vmap(jax.vmap(lambda mu, ratio: papers.steady_stick_share(ratio, mu))))
few, many = np.array([1.0, 4.0, 10.0]), np.linspace(0.1, 2.5, 97)
steady = np.asarray(steady_share(*np.meshgrid(few, many, indexing="ij")))
print(f"square wave, mu = {few[0]:g}: no stick in a steady period at {(steady[0] == 0).sum()} of {len(many)} ratios")
for mu, row in zip(few, steady, strict=True):
    print(
        f"square wave, mu = {mu:g}: at most {100 * row.max():.1f} % of a steady period, at r = {many[row.argmax()]:.3f}"
    )

# %% [markdown]
# ## A belt of random direction
# The belt's direction is drawn anew in each `1 / f_b`, with equal probability; mean and the band that holds 95 % of
# the samples, over the friction coefficient, at three frequency ratios.

# %%
ax = None
values = np.geomspace(0.2, 4.0, 9)
for ratio in (0.6, 1.2, 2.4):
    found = []
    for mu in values:
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        ensemble = ss.simulate_ensemble(
            system, papers.random_belt(ratio).law, t1=200.0, samples=max(100, SAMPLES // 10), key=jax.random.key(0),
            y0=(0.0, 1.0), progress=False,
        )  # fmt: skip
        found.append(ensemble.statistics.stick_fraction)
    ax = ss.plot.stick_fraction_curve(
        values, found, xlabel="friction coefficient (dimensionless)", label=f"r = {ratio:g}",
        band_label=f"95 % of samples, r = {ratio:g}", ax=ax,
    )  # fmt: skip
    shares = 100 * np.array([one.mean.value for one in found])
    print(f"r = {ratio:g}: {shares[0]:.1f} % at mu = {values[0]:.1f}, {shares[-1]:.1f} % at mu = {values[-1]:.1f}")

# %% [markdown]
# **Verdict.** As the paper's introduction says of it: by the belt, mu and r, sticks take up to 100 % of the time, or
# vanish. The 100 % are those of belts without jumps; on the square wave the share approaches 100 % as friction grows
# and does not reach it.
