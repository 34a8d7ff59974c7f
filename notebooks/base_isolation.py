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
# # A building on a sliding bearing
#
# A building of 1000 kg stands on a flat sliding bearing; a spring pulls it back to the middle. The ground shakes. In
# coordinates relative to the ground the base is at rest, and the acceleration of the ground acts as a force
# `-mass * acceleration`. The bearing holds (stick) until that force and the spring's exceed static friction, then it
# slides (slip). How far it slides, how far from the middle it stops, and what acceleration the building feels depend on
# the friction coefficient.
#
# The ground motion is a record if the environment variable `STICKSLIP_RECORD` names a file in the AT2 format of the
# PEER database. Otherwise it is **artificial**: filtered white noise under an envelope, written to a file and read
# again in the way a record in CSV format would be. The samples of the later sections are artificial in any case.

# %%
import math
import os
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.legend_handler import HandlerTuple
from scipy.signal import lsim

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "200"))
mass, stiffness, gravity = 1000.0, 1e4, 9.81  # kg, N/m, m/s^2
STATIC = 1.2  # static over kinetic friction coefficient
law = ss.KanaiTajimi(rms=1.5, rise=2.0, plateau=8.0, decay=0.4, interval=0.02)


def isolated(mu):
    """The building on a bearing with this kinetic friction coefficient."""
    return ss.MassSpring(mass, stiffness, mass * gravity, ss.Coulomb(mu=mu, mu_static=STATIC * mu))


print(f"natural period of the building on its spring: {2 * math.pi * math.sqrt(mass / stiffness):.3f} s")

# %% [markdown]
# ## The ground motion

# %%
if given := os.environ.get("STICKSLIP_RECORD"):
    record = ss.read_at2(given)
else:
    quake = law.sample(jax.random.key(0), t1=25.0)
    instants = np.arange(0, 1251) * 0.02
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "artificial.csv"
        rows = np.column_stack([instants, quake.acceleration(instants) / 9.80665])
        np.savetxt(path, rows, delimiter=",", header="time in s,acceleration in g", comments="", fmt="%.15g")
        record = ss.read_acceleration_csv(path, scale=9.80665)
t1 = float(record.duration)
peak_ground = np.max(np.abs(record.accelerations))
print(f"{'record ' + given if given else 'artificial ground motion'}: {t1:g} s, "
      f"largest acceleration {peak_ground:.3f} m/s^2")  # fmt: skip

# %% [markdown]
# ## One run

# %%
one = ss.simulate(isolated(0.05), record, t1=t1)
print(one)
grid = np.linspace(0.0, t1, 5001)
position, velocity = (np.asarray(values) for values in one.evaluate(grid))
total = (np.asarray(one.friction_force(grid)) - stiffness * position) / mass  # acceleration of the mass in space
print(f"largest displacement {np.max(np.abs(position)):.4f} m, residual displacement {position[-1]:.4f} m")
print(f"largest total acceleration {np.max(np.abs(total)):.3f} m/s^2, of the ground {peak_ground:.3f} m/s^2")

# %%
axes = ss.plot.time_history(one)

# %% [markdown]
# Where the energy goes: the ground supplies it (as the work of the force `-mass * acceleration`, called load), friction
# turns it into heat, and the spring keeps what belongs to the residual displacement.

# %%
axes = ss.plot.energies(one)

# %%
energies = one.energies(t1)
supplied, dissipated = float(energies.supplied["load"]), float(energies.dissipated["friction"])
stored = sum(float(part) for part in energies.stored.values())
print(f"supplied {supplied:.4f} J, dissipated by friction {dissipated:.4f} J, stored at the end {stored:.4f} J")
print(f"balance within 1e-6 J: {abs(supplied - dissipated - stored) < 1e-6}")

# %% [markdown]
# ## Three checks that do not use the package
# 1. Hardly any friction: a linear oscillator, whose response to a motion that is linear between its points
#    `scipy.signal.lsim` computes exactly.
# 2. Much friction: the bearing does not slide at all, as long as static friction exceeds mass times the largest
#    acceleration.
# 3. The run above, by the time-stepping of Moreau: steps of 0.1 ms, in each of which friction takes up the momentum
#    that it can.

# %%
free = ss.simulate(isolated(1e-12), record, t1=t1)
times, accelerations = np.asarray(record.times), np.asarray(record.accelerations)
linear = ([[0.0, 1.0], [-stiffness / mass, 0.0]], [[0.0], [-1.0]], [[1.0, 0.0]], [[0.0]])
_, response, _ = lsim(linear, accelerations, times, interp=True)
wrong = np.max(np.abs(np.asarray(free.evaluate(times)[0]) - response))
print(f"1. without friction: up to {np.max(np.abs(response)):.4f} m, by lsim the same within 1e-8 m: {wrong < 1e-8}")

limit = peak_ground / gravity / STATIC  # the kinetic coefficient whose static one just holds
above, below = (ss.simulate(isolated(factor * limit), record, t1=t1) for factor in (1.001, 0.999))
print(f"2. mu_static just above {STATIC * limit:.4f}: {int(above.slips.count)} slips; "
      f"just below: it slides: {int(below.slips.count) > 0}")  # fmt: skip

step = 1e-4
x = v = 0.0
brute = []
ground = np.interp((np.arange(round(t1 / step)) + 0.5) * step, times, accelerations)
for pushed in ground:
    brute.append(x)
    moved = v + step * (-stiffness / mass * x - pushed)
    held = step * gravity * 0.05 * (STATIC if v == 0 else 1)
    v = 0.0 if abs(moved) <= held else moved - math.copysign(step * gravity * 0.05, moved)
    x += step * v
by_steps = np.interp(grid, np.arange(len(brute)) * step, brute)
print(f"3. by small steps: largest displacement {np.max(np.abs(by_steps)):.4f} m, residual {by_steps[-1]:.4f} m; "
      f"never further than 1 mm from the run: {np.max(np.abs(by_steps - position)) < 1e-3}")  # fmt: skip

# %% [markdown]
# ## How much friction?
# The same artificial ground motions for each of six friction coefficients. `jax.vmap` runs them side by side; peak
# values are taken over a grid of 0.01 s. The friction coefficient is an argument, so that all is compiled once.

# %%
end = 25.0  # s
fine = np.linspace(0.0, end, 2501)


@jax.jit
@jax.vmap
def ground_peak(key):
    return jnp.max(jnp.abs(law.sample(key, end).acceleration(fine)))


def respond(mu, key):
    run = ss.simulate(isolated(mu), law.sample(key, end), t1=end)
    x = run.evaluate(fine)[0]
    felt = (run.friction_force(fine) - stiffness * x) / mass
    resting = run.sticks.mask & (run.sticks.ending == ss.Ending.HORIZON)
    return {
        "peak displacement": jnp.max(jnp.abs(x)),
        "peak acceleration": jnp.max(jnp.abs(felt)),
        "residual displacement": jnp.abs(run.final_state[0]),
        "sticks": run.sticks.count,
        "at rest": jnp.any(resting),
        "finished": run.status == ss.Status.FINISHED,
    }


keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(1), i))(jnp.arange(SAMPLES))
every = jax.jit(jax.vmap(respond, in_axes=(None, 0)))
frictions = np.array([0.02, 0.04, 0.07, 0.10, 0.15, 0.20])
found = [{name: np.array(values) for name, values in every(mu, keys).items()} for mu in frictions]
shaken = np.asarray(ground_peak(keys))
print(f"all runs finished: {all(result['finished'].all() for result in found)}")
moving = sum(int(np.sum(~result["at rest"])) for result in found)
print(f"runs that are not at rest at the end: {moving} of {len(found) * SAMPLES}; they have no residual displacement")
for result in found:
    result["residual displacement"][~result["at rest"]] = np.nan
print("medians:  mu   peak displacement   peak total acceleration   residual displacement   sticks")
for mu, result in zip(frictions, found, strict=True):
    middle = {name: float(np.nanmedian(values)) for name, values in result.items()}
    print(f"        {mu:.2f}   {middle['peak displacement']:15.4f} m   {middle['peak acceleration']:17.3f} m/s^2   "
          f"{middle['residual displacement']:19.4f} m   {middle['sticks']:6.0f}")  # fmt: skip
print(f"median of the largest ground acceleration: {np.median(shaken):.3f} m/s^2")

# %% [markdown]
# Two bounds hold for every sample. In a stick at the end, under the ground acceleration a, spring and ground together
# pull with at most static friction: the residual displacement is at most `(mu_static n + mass |a|) / k`. And the total
# acceleration is what spring and friction exert: at most `(k * peak displacement + mu_static n) / mass`.

# %%
largest = STATIC * frictions * mass * gravity / stiffness
last = np.asarray(jax.vmap(lambda key: law.sample(key, end).acceleration(end))(keys))
kept = [
    result["residual displacement"][result["at rest"]]
    <= (bound + mass * np.abs(last) / stiffness)[result["at rest"]] + 1e-9
    for result, bound in zip(found, largest, strict=True)
]
felt = [
    result["peak acceleration"] <= (stiffness * (result["peak displacement"] + bound)) / mass + 1e-9
    for result, bound in zip(found, largest, strict=True)
]
within = all(map(np.all, kept)), all(map(np.all, felt))
print(f"residual displacement within its bound: {within[0]}; total acceleration within its bound: {within[1]}")

# %% [markdown]
# Peak and residual displacements: the share of the samples that do not exceed the value on the abscissa.

# %%
figure, panels = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained", sharey=True)
for panel, name in zip(panels, ("peak displacement", "residual displacement"), strict=True):
    lines = []
    for i, color in ((0, "#0072B2"), (2, "#009E73"), (5, "#000000")):
        values = np.sort(100 * found[i][name][np.isfinite(found[i][name])])
        shares = 100 * (np.arange(len(values)) + 1) / len(values)
        lines += panel.plot(values, shares, color=color, label=f"$\\mu$ = {frictions[i]:g}")
    panel.set_xlabel(f"{name} (cm)")
    panel.set_xlim(left=0.0)
panels[0].set_ylabel("share of the samples (%)")
figure.legend(handles=lines, loc="outside upper center", ncols=3, frameon=False)
plt.show()

# %% [markdown]
# ## The trade-off
# Medians, and bands that hold 95 % of the samples. More friction shortens the way that the bearing needs. What the
# building feels is least in between: with little friction the spring of a bearing far out pulls at it, with much
# friction the friction itself.


# %%
def band(panel, name, scale, ylabel, color):
    """Median and 95 % band of a quantity against the friction coefficient."""
    low, middle, high = (scale * np.array([np.nanquantile(r[name], q) for r in found]) for q in (0.025, 0.5, 0.975))
    area = panel.fill_between(frictions, low, high, color=color, alpha=0.25, lw=0)
    (line,) = panel.plot(frictions, middle, "o-", color=color)
    panel.set_xlabel(r"friction coefficient $\mu$ (1)")
    panel.set_ylabel(ylabel)
    panel.set_ylim(bottom=0.0)
    return line, area


figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.0), layout="constrained")
line, area = band(left, "peak displacement", 100, "peak displacement (cm)", "#0072B2")
band(right, "peak acceleration", 1, "peak total acceleration (m/s$^2$)", "#0072B2")
fixed = right.axhline(np.median(shaken), color="#000000", ls="--")
figure.legend([line, area, fixed], ["median", "95 % of the samples", "median, building fixed to the ground"],
              loc="outside upper center", ncols=3, frameon=False)  # fmt: skip
plt.show()
ways, feelings = (
    np.array([np.median(result[f"peak {name}"]) for result in found]) for name in ("displacement", "acceleration")
)
print(f"the median peak displacement falls from each friction coefficient to the next: {np.all(np.diff(ways) < 0)}")
least = int(np.argmin(feelings))
print(f"the least median of the peak total acceleration is at mu = {frictions[least]:g}; "
      f"neither the smallest nor the largest mu: {0 < least < len(frictions) - 1}")  # fmt: skip

# %% [markdown]
# Residual displacement and number of sticks.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.0), layout="constrained")
line, area = band(left, "residual displacement", 100, "residual displacement (cm)", "#0072B2")
sticks, stuck = band(right, "sticks", 1, "number of sticks", "#D55E00")
figure.legend([(line, sticks), (area, stuck)], ["median", "95 % of the samples"], loc="outside upper center", ncols=2,
              handler_map={tuple: HandlerTuple(None)}, frameon=False)  # fmt: skip
plt.show()
