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
# # Clutches, a chain of blocks, a building on its bearing
#
# Three structures with more than one mass, in which friction in one place moves what happens in the others: four
# inertias joined by three clutches; ten blocks in a row on a moving floor, the model of an earthquake fault by
# Burridge and Knopoff (1967); and a building of four storeys on a sliding bearing, under many artificial earthquakes.

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import lsim

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1000"))

# %% [markdown]
# ## Three clutches
#
# An oscillating torque turns the first of four inertias. The pressure of the first clutch is a cosine, so that the
# clutch opens after 1.25 s; the second closes at 0.4 s, the third at 0.9 s. (The numbers are those of the example
# with coupled clutches in the Modelica library.)

# %%
lining = ss.Coulomb(0.5, mu_static=0.55)
pressures = (
    ss.Harmonic(20.0, 0.4 * np.pi),  # N
    ss.ForceSteps(times=[0.0, 0.4], values=[0.0, 20.0]),
    ss.ForceSteps(times=[0.0, 0.9], values=[0.0, 20.0]),
)
train = ss.LinearStructure(
    mass=np.ones(4),  # kg m^2
    stiffness=np.zeros(4),
    contacts=tuple(ss.Contact.between(i + 1, i, 4, pressures[i], lining) for i in range(3)),
    force=(ss.Harmonic(10.0, 10 * np.pi, -np.pi / 2), None, None, None),  # N m
)
one = ss.simulate(train, ss.Constant(0.0), t1=1.5, y0=(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0))
for i in range(3):
    sticks = one.of_contact(i).sticks
    spans = zip(sticks.start[sticks.mask], sticks.end[sticks.mask], strict=True)
    print(f"clutch {i} sticks:", ", ".join(f"{start:.10f} to {end:.10f} s" for start, end in spans))

# %%
grid = np.linspace(0.0, 1.5, 3001)
speeds = np.asarray(one.evaluate(grid))[4:]
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5), layout="constrained", sharex=True, height_ratios=(2, 1))
for i, (speed, style) in enumerate(zip(speeds, ("-", "--", "-.", ":"), strict=True)):
    above.plot(grid, speed, style, label=f"inertia {i}")
above.set_ylabel("angular velocity (rad/s)")
above.legend(frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
ss.plot.stick_raster(one, ax=below)
plt.show()

# %% [markdown]
# Friction acts between the inertias only: whatever the clutches do, all together have the angular momentum that they
# began with and that the torque has given them.

# %%
momentum = 10.0 + (1 - np.cos(10 * np.pi * grid)) / np.pi
wrong = np.max(np.abs(np.sum(speeds, axis=0) - momentum))
print(f"the angular momentum is kept within 1e-9 kg m^2/s: {wrong < 1e-9}")

# %% [markdown]
# ## A chain of blocks
#
# Ten blocks on a floor that moves slowly, each held by a spring, and springs between neighbours. They are carried
# with the floor, until one of them breaks loose; that may pull its neighbours along. In the last row of the figure:
# the times in which all blocks rest on the floor.

# %%
BLOCKS, SPEED, T1 = 10, 0.01, 200.0
row = ss.block_row(
    BLOCKS, mass=1.0, between=10.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.4, mu_static=0.5)
)
start = 0.1 * np.random.default_rng(0).uniform(-1, 1, BLOCKS)
motion = ss.simulate(row, ss.Constant(SPEED), t1=T1, y0=(*start, *np.full(BLOCKS, SPEED)))
together = motion.of_all_contacts()
print(f"sticks of the blocks: {motion.totals.sticks}; all rest together {int(together.sticks.count)} times, "
      f"for {together.stick_time / T1:.0%} of the time")  # fmt: skip

# %%
grid = np.linspace(0.0, T1, 5001)
positions = np.asarray(motion.evaluate(grid))[:BLOCKS]
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 6), layout="constrained", sharex=True)
for i, position in enumerate(positions):
    above.plot(grid, position, color=plt.get_cmap("viridis")(i / BLOCKS), lw=1.2, label=f"block {i}")
above.set_ylabel("position (m)")
above.legend(frameon=False, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
ss.plot.stick_raster(motion, ax=below)
plt.show()

# %% [markdown]
# The same by small time steps, in each of which friction takes up the momentum that it can: 0.2 ms, with NumPy.


# %%
def by_small_steps(step, end):
    """Positions at the times of `grid` up to `end`."""
    x, v = start.copy(), np.full(BLOCKS, SPEED)
    held, found, wanted = np.ones(BLOCKS, bool), [], iter(grid[grid <= end])
    next_one = next(wanted)
    for i in range(round(end / step) + 1):
        if i * step >= next_one - step / 2:
            found.append(x.copy())
            next_one = next(wanted, np.inf)
        stretch = np.diff(x)
        pull = -x + 10 * (np.append(stretch, 0.0) - np.insert(stretch, 0, 0.0))
        relative = v + step * pull - SPEED
        limit = step * np.where(held, 0.5, 0.4)
        held = np.abs(relative) <= limit
        v = SPEED + np.where(held, 0.0, relative - np.sign(relative) * step * 0.4)
        x = x + step * v
    return np.array(found)


END = 60.0  # s
brute = by_small_steps(2e-4, END)
apart = np.max(np.abs(brute.T - positions[:, : len(brute)]))
print(f"up to {END:g} s never further apart than 2 mm: {apart < 2e-3}")

# %% [markdown]
# From many random starts: how long all blocks rest together, and how long a block slips until it sticks again.

# %%
many = ss.simulate_contacts(
    row, ss.Constant(SPEED), t1=T1, samples=SAMPLES, key=jax.random.key(1), keep="sticks",
    y0=(*[ss.Uniform(-0.1, 0.1)] * BLOCKS, *[SPEED] * BLOCKS),
)  # fmt: skip
arrest = many.of_all_contacts()
print(ss.mean_stick_duration(arrest))
print(ss.mean_stick_duration(many.of_contact(0)), "(first block)")
ax = ss.plot.histogram(arrest.statistics.duration, bins=60)
plt.show()

# %% [markdown]
# ## A building on its bearing
#
# A base mat and four storeys of 200 t each; fixed to the ground the building swings with a period of 0.5 s, damped by
# 3 %. The bearing lets it slide, and an elastic pendulum of 2.5 s pulls it back.

# %%
STOREYS, MASS, DAMPING = 4, 2e5, 0.03
shape = 2 * np.sin(np.pi / (2 * (2 * STOREYS + 1)))  # first natural frequency of the fixed building over sqrt(k / m)
first = 2 * np.pi / 0.5  # rad/s
k = MASS * (first / shape) ** 2  # N/m of each storey
c = 2 * DAMPING * k / first  # N s/m


def building(mu):
    """On a bearing with this kinetic friction coefficient; static friction is 1.2 times as large."""
    return ss.storeys_on_bearing(
        [MASS] * (STOREYS + 1), [k] * STOREYS, damping=[c] * STOREYS, friction=ss.Coulomb(mu, mu_static=1.2 * mu),
        bearing_stiffness=(STOREYS + 1) * MASS * (2 * np.pi / 2.5) ** 2,
    )  # fmt: skip


law = ss.KanaiTajimi(rms=1.5, rise=2.0, plateau=8.0, decay=0.4, interval=0.02)
end = 25.0  # s
quake = law.sample(jax.random.key(0), t1=end)
one = ss.simulate(building(0.06), quake, t1=end)
print(one)
axes = ss.plot.time_history(one)
plt.show()

# %% [markdown]
# Two checks that do not use the package: with a great deal of friction the building is fixed to the ground, with
# hardly any it floats on the pendulum. Both are linear, and `scipy.signal.lsim` computes their response to a ground
# motion that is linear between its points exactly.


# %%
def by_lsim(system, free):
    """Positions relative to the ground, at the points of the record that are `inside`; `free`: masses that can move."""
    mass, stiffness, damping = (np.asarray(part)[free] for part in (system.mass, system.stiffness, system.damping))
    stiffness, damping = stiffness[:, free], damping[:, free]
    size = len(mass)
    a = np.block([[np.zeros((size, size)), np.eye(size)], [-stiffness / mass[:, None], -damping / mass[:, None]]])
    b = np.concatenate([np.zeros(size), -np.ones(size)])[:, None]
    looked = np.eye(2 * size)[:size]
    _, found, _ = lsim((a, b, looked, np.zeros((size, 1))), quake.accelerations, quake.times, interp=True)
    return found.T[:, inside]


inside = np.asarray(quake.times) <= end
storeys, everything = slice(1, None), slice(None)
for words, mu, free in (("fixed", 10.0, storeys), ("floating", 1e-12, everything)):
    run = ss.simulate(building(mu), quake, t1=end)
    found = np.asarray(run.evaluate(np.asarray(quake.times)[inside]))[: STOREYS + 1][free]
    expected = by_lsim(building(mu), free)
    print(f"{words}: up to {np.max(np.abs(expected)):.4f} m, by lsim the same within 1e-8 m: "
          f"{np.max(np.abs(found - expected)) < 1e-8}")  # fmt: skip

# %% [markdown]
# The same artificial earthquakes for each of six friction coefficients, followed side by side: how far the bearing
# slides, and the largest drift of a storey, on a grid of 0.02 s.

# %%
QUANTITIES = "largest displacement of the bearing", "largest drift of a storey"
fine = np.linspace(0.0, end, 1251)


def respond(mu, key):
    run = ss.simulate(building(mu), law.sample(key, end), t1=end)
    positions = jnp.stack(run.evaluate(fine)[: STOREYS + 1])
    return {
        QUANTITIES[0]: jnp.max(jnp.abs(positions[0])),
        QUANTITIES[1]: jnp.max(jnp.abs(jnp.diff(positions, axis=0))),
        "sticks": run.totals.sticks,
        "finished": run.status == ss.Status.FINISHED,
    }


keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(2), i))(jnp.arange(SAMPLES))
every = jax.jit(jax.vmap(respond, in_axes=(None, 0)))
frictions = np.array([0.02, 0.04, 0.06, 0.10, 0.15, 0.20])
found = [{name: np.array(values) for name, values in every(mu, keys).items()} for mu in frictions]
print(f"all runs finished: {all(result['finished'].all() for result in found)}")
for mu, result in zip(frictions, found, strict=True):
    middle = {name: np.median(values) for name, values in result.items()}
    print(f"mu = {mu:.2f}, medians: bearing {middle[QUANTITIES[0]]:.4f} m, "
          f"drift {1000 * middle[QUANTITIES[1]]:5.2f} mm, {middle['sticks']:3.0f} sticks")  # fmt: skip

# %% [markdown]
# Medians, and bands that hold 95 % of the earthquakes. The more friction, the less the bearing slides. The storeys
# drift least in between: with little friction the pendulum swings far and shakes them, with much friction the ground
# does.

# %%
figure, panels = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for panel, name, scale, unit in zip(panels, QUANTITIES, (100, 1000), ("cm", "mm"), strict=True):
    low, middle, high = (scale * np.array([np.quantile(r[name], q) for r in found]) for q in (0.025, 0.5, 0.975))
    panel.fill_between(frictions, low, high, color="#0072B2", alpha=0.25, lw=0, label="95 % of the earthquakes")
    panel.plot(frictions, middle, "o-", color="#0072B2", label="median")
    panel.set_xlabel(r"friction coefficient $\mu$ (1)")
    panel.set_ylabel(f"{name} ({unit})")
    panel.set_ylim(bottom=0.0)
panels[0].legend(frameon=False)
plt.show()
slides, drifts = (np.array([np.median(result[name]) for result in found]) for name in QUANTITIES)
print(f"the median displacement falls from each friction coefficient to the next: {np.all(np.diff(slides) < 0)}")
least = int(np.argmin(drifts))
print(f"the least median drift is at mu = {frictions[least]:g}; "
      f"neither the smallest nor the largest mu: {0 < least < len(frictions) - 1}")  # fmt: skip
