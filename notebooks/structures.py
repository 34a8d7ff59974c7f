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
# # Several contacts: clutches, a chain, a building
#
# Three structures with dry friction: inertias that clutches couple one after the other, a chain of blocks that a belt
# drags along, and a building on a sliding bearing under many earthquakes. In each, every stick of every contact is
# found, and where friction in one contact moves the others, all are solved together.

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1_000"))

# %% [markdown]
# ## Three clutches
#
# Four inertias of 1 kg m^2 in a row, with a clutch between each and the next: contacts 0, 1 and 2. The first inertia
# turns at 10 rad/s, and a torque of `10 sin(10 pi t)` N m acts on it; the others are at rest. Contact 0 is pressed by
# `20 cos(0.4 pi t)` N, so it is open from 1.25 s on; contact 1 closes at 0.4 s, contact 2 at 0.9 s. It is the example
# of the Modelica library (`Rotational.Examples.CoupledClutches`).

# %%
pressed = (
    ss.Harmonic(20.0, 0.4 * np.pi),
    ss.ForceSteps(times=[0.0, 0.4], values=[0.0, 20.0]),
    ss.ForceSteps(times=[0.0, 0.9], values=[0.0, 20.0]),
)
clutches = tuple(
    ss.Contact.between(i + 1, i, 4, force, ss.Coulomb(0.5, mu_static=0.55)) for i, force in enumerate(pressed)
)
torque = ss.Harmonic(10.0, 10 * np.pi, -np.pi / 2)
train = ss.LinearStructure(np.ones(4), np.zeros(4), contacts=clutches, force=(torque, None, None, None))
driven = ss.simulate(train, ss.Constant(0.0), t1=1.5, y0=(*np.zeros(4), 10.0, *np.zeros(3)))
print(driven)
for i in range(3):
    sticks = driven.of_contact(i).sticks
    spans = zip(sticks.start[sticks.mask], sticks.end[sticks.mask], strict=True)
    print(f"contact {i} sticks: " + ", ".join(f"{start:.10f} to {end:.10f} s" for start, end in spans))
print(f"first inertia at 1.5 s: {driven.final_state[0]:.6f} rad, {driven.final_state[4]:.6f} rad/s")

# %% [markdown]
# The speeds, and what presses the clutches: where two inertias stick together, their lines are one.

# %%
times = np.linspace(0.0, 1.5, 3001)
state = [np.asarray(values) for values in driven.evaluate(times)]
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5), layout="constrained", sharex=True)
for i, color in enumerate(("#0072B2", "#E69F00", "#009E73", "#CC79A7")):
    above.plot(times, state[4 + i], color=color, label=f"inertia {i + 1}")
above.set_ylabel("angular velocity (rad/s)")
above.legend(frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
for i, (force, style) in enumerate(zip(pressed, ("-", "--", ":"), strict=True)):
    values = np.maximum(np.asarray(force.value(times)), 0.0)
    below.plot(times, values, color="#000000", ls=style, label=f"contact {i}")
below.set_ylabel("normal force (N)")
below.set_xlabel("time $t$ (s)")
below.set_xlim(0.0, 1.5)
below.legend(frameon=False, loc="center right")
plt.show()

# %%
ax = ss.plot.stick_raster(driven)

# %% [markdown]
# ## A chain of ten blocks
#
# Blocks in a row on a belt, with springs from each to the next and to the ground (Burridge and Knopoff 1967). They
# begin with the velocity of the belt, each at its own place; one of them cannot be held there. Static friction exceeds
# kinetic friction: what breaks loose in one place loads its neighbours.

# %%
chain = ss.block_row(
    10, mass=1.0, between=10.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.4, mu_static=0.5)
)
belt, end = ss.Constant(0.05), 60.0
places = 0.02 * np.cos(np.arange(10) ** 2.0)
dragged = ss.simulate(chain, belt, t1=end, y0=(*places, *np.full(10, 0.05)))
together = dragged.of_all_contacts()
print(dragged)
first, last = float(together.sticks.start[0]), float(together.sticks.end[0])
print(f"all ten stick at once {int(together.sticks.count)} time, from {first:.4f} to {last:.4f} s")
print(f"instants at which round-off decided: {int(dragged.near_grazing_count)}")

# %%
axes = ss.plot.time_history(dragged)

# %% [markdown]
# The sticks of the first 20 s of it, a row for each contact, and below the times in which all stick.

# %%
axes = ss.plot.stick_raster(dragged, window=(0.0, 20.0))

# %% [markdown]
# How fast each block slips on the belt, over all of the time. What breaks loose runs through the chain.

# %%
times = np.linspace(0.0, end, 2401)
slip = np.abs(np.stack(dragged.evaluate(times)[10:20]) - 0.05)
figure, ax = plt.subplots(figsize=(8, 3.4), layout="constrained")
image = ax.pcolormesh(times, np.arange(10), slip, cmap="magma_r", shading="nearest")
ax.set_xlabel("time $t$ (s)")
ax.set_ylabel("contact")
ax.set_yticks(range(10))
ax.invert_yaxis()
figure.colorbar(image, label="slip velocity (m/s)")
plt.show()

# %% [markdown]
# ## A building on a sliding bearing
#
# A base mat and two storeys, each of 200 t, on a flat bearing: `storeys_on_bearing`. The ground motions are artificial:
# filtered white noise (Kanai and Tajimi) under an envelope, another one for each sample. Positions are relative to the
# ground; that of the base mat is what the bearing has slipped.

# %%
masses, springs, dampers = [2e5, 2e5, 2e5], [8e7, 8e7], [4e5, 4e5]  # kg, N/m, N s/m
quakes = ss.KanaiTajimi(rms=1.5, rise=2.0, plateau=8.0, decay=0.4, interval=0.02)
shaken = 25.0  # s


def building(mu):
    """The building on a bearing with this friction coefficient."""
    return ss.storeys_on_bearing(masses, springs, damping=dampers, friction=ss.Coulomb(mu))


ground = quakes.sample(jax.random.key(0), t1=shaken)
one = ss.simulate(building(0.05), ground, t1=shaken)
sliding = one.of_contact(0)
print(sliding)
farthest, last = float(one.peak("position 1")), float(one.final_state[0])
print(f"the bearing slips by {farthest:.4f} m at most, and stops at {last:+.4f} m")

# %%
axes = ss.plot.time_history(one)

# %% [markdown]
# Two checks that do not use the structure:
# 1. The same by the time-stepping of Moreau: steps of 0.2 ms, in each of which friction takes up the momentum of the
#    mat that it can.
# 2. One block instead of building and mat, without any spring (Newmark 1965): a `MassSpring` of stiffness 0. The
#    storeys that swing above the mat hardly change how far it slips.

# %%
system, step = building(0.05), 2e-4
pushes = -np.asarray(ground.acceleration((np.arange(round(shaken / step)) + 0.5) * step))
inertia, most = np.asarray(masses), 0.05 * 9.80665 * sum(masses)
x, v, reached = np.zeros(3), np.zeros(3), []
for push in pushes:
    reached.append(x[0])
    v = v + step * (push - (system.stiffness @ x + system.damping @ v) / inertia)
    v[0] -= np.clip(v[0], -step * most / inertia[0], step * most / inertia[0])
    x = x + step * v
grid = np.arange(len(reached)) * step
apart = np.max(np.abs(np.asarray(one.evaluate(grid)[0]) - reached))
print(f"1. never further than 1 mm from the steps: {apart < 1e-3}; {1000 * apart:.3f} mm")
block = ss.simulate(ss.MassSpring(sum(masses), 0.0, 20 * most, ss.Coulomb(0.05)), ground, t1=shaken)
print(f"2. the largest slip displacement of one block: {float(block.peak('position')):.4f} m")

# %% [markdown]
# ### The same building under many earthquakes
#
# The same ground motions for each of three friction coefficients.

# %%
outputs = {
    "peak": ss.Output(lambda one: one.peak("position 1"), unit="m"),
    "residual": ss.Output(lambda one: jnp.abs(one.final_state[0]), unit="m"),
}
frictions = (0.03, 0.05, 0.1)
many = [
    ss.simulate_ensemble(
        building(mu).of_contact(0), quakes, t1=shaken, samples=SAMPLES, key=jax.random.key(1), outputs=outputs
    )
    for mu in frictions
]
print(f"all finished: {all(each.finished == SAMPLES for each in many)}")
print("medians:  mu   peak slip displacement   residual displacement   sticks   time in sticks")
for mu, each in zip(frictions, many, strict=True):
    peak, residual = (np.median(each.output_values[name]) for name in outputs)
    count, share = np.median(each.totals.sticks), np.median(each.totals.stick_time) / shaken
    print(f"        {mu:.2f}   {peak:20.4f} m   {residual:19.4f} m   {count:6.0f}   {100 * share:12.1f} %")
for name in outputs:
    middles = [float(np.median(each.output_values[name])) for each in many]
    print(f"more friction, less {name} displacement (medians): {middles == sorted(middles, reverse=True)}")
farther = all(np.all(each.output_values["residual"] <= each.output_values["peak"] + 1e-9) for each in many)
print(f"no sample stops farther out than it has been: {farther}")

# %% [markdown]
# Without a spring nothing pulls the mat back: where it stops is where the last slips left it. The share of the
# earthquakes after which a displacement is not exceeded:

# %%
figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", sharey=True)
titles = {"peak": "peak slip displacement (cm)", "residual": "residual displacement (cm)"}
for panel, (name, title) in zip(panels, titles.items(), strict=True):
    for mu, each, color in zip(frictions, many, ("#0072B2", "#009E73", "#000000"), strict=True):
        values = np.sort(100 * each.output_values[name])
        panel.plot(values, 100 * (np.arange(SAMPLES) + 1) / SAMPLES, color=color, label=rf"$\mu$ = {mu:g}")
    panel.set_xlabel(title)
    panel.set_xlim(left=0.0)
panels[0].set_ylabel("share of the earthquakes (%)")
panels[0].set_ylim(0.0, 100.0)
figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
plt.show()

# %% [markdown]
# The sticks of the first 40 earthquakes at a friction coefficient of 0.05, and how many there are in a sample.

# %%
ax = ss.plot.stick_raster(many[1], samples=40)

# %%
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for mu, each, color in zip(frictions, many, ("#0072B2", "#009E73", "#000000"), strict=True):
    counts = np.asarray(each.totals.sticks)
    edges = np.arange(counts.min(), counts.max() + 2) - 0.5
    shares = 100 * np.histogram(counts, edges)[0] / SAMPLES
    ax.stairs(shares, edges, color=color, lw=1.5, label=rf"$\mu$ = {mu:g}")
ax.set_xlabel("number of sticks in a sample")
ax.set_ylabel("share of the samples (%)")
ax.legend(frameon=False)
plt.show()
