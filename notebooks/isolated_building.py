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
# # Three storeys on sliding bearings
#
# A building of three storeys stands on friction pendulums: its base mat slides on curved surfaces, whose radius gives
# it a long period. What a report needs of it: how far the bearings move and where they come to rest, how much the
# storeys drift, what acceleration each floor feels (and what hangs on it, by floor spectra), and how likely the
# bearings reach their edge, by the intensity of the earthquake.
#
# The ground motions are the AT2 and CSV files of the folder that the environment variable `STICKSLIP_RECORDS` names.
# Otherwise they are **artificial**: filtered white noise under envelopes of different lengths, at two sampling rates.

# %%
import math
import os

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import eigh
from scipy.signal import lsim

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "200"))
STOREYS, FLOOR, GRAVITY = 3, 1e5, 9.80665  # number, kg each, m/s^2
RADIUS, MU = 2.2, 0.06  # of the pendulums, m, and their friction coefficient
shear = np.array([9e7, 7.5e7, 5e7])  # of the storeys, N/m
damping = 2e5 * np.ones(STOREYS)  # N s/m
weight = (STOREYS + 1) * FLOOR * GRAVITY


def building(mu):
    """The building on pendulums with this friction coefficient."""
    return ss.storeys_on_bearing(
        [FLOOR] * (STOREYS + 1), shear, friction=ss.Coulomb(mu), damping=damping, radius=RADIUS
    )


fixed = np.diag(np.append(shear[:-1] + shear[1:], shear[-1])) - np.diag(shear[1:], 1) - np.diag(shear[1:], -1)
periods = 2 * np.pi / np.sqrt(eigh(fixed, FLOOR * np.eye(STOREYS), eigvals_only=True))
pendulum = 2 * math.pi * math.sqrt(RADIUS / GRAVITY)
print(f"periods of the building fixed to the ground: {', '.join(f'{one:.3f}' for one in periods)} s; "
      f"of the pendulums {pendulum:.3f} s")  # fmt: skip

# %% [markdown]
# ## The ground motions

# %%
if given := os.environ.get("STICKSLIP_RECORDS"):
    suite = ss.RecordSuite(given)
else:
    records = []
    for number in range(max(10, min(20, SAMPLES // 10))):
        law = ss.KanaiTajimi(rms=1.0, rise=2.0, plateau=5.0 + number % 4, decay=0.5, interval=(0.01, 0.02)[number % 2])
        drawn = law.sample(jax.random.key(number), 20.0)
        records.append(ss.GroundAcceleration(drawn.times, drawn.accelerations))
    suite = ss.RecordSuite(records)
end = suite.duration + 10.0  # after it the building comes to rest
spectrum = ss.response_spectrum(suite, [pendulum], damping=0.05)
intensity = spectrum.pseudo_acceleration.values[:, 0]  # m/s^2
print(f"{len(suite)} ground motions of up to {suite.duration:g} s; spectral acceleration at the period of the "
      f"pendulums {np.min(intensity):.2f} to {np.max(intensity):.2f} m/s^2")  # fmt: skip

# %% [markdown]
# ## One earthquake
#
# The base shear, the force in the bearings, is the sum of masses times total accelerations: friction and the pendulums'
# restoring force together.

# %%
one = ss.simulate(building(MU), suite[0], t1=end)
print(one)
times = np.linspace(0.0, end, 3001)
figure, panels = plt.subplots(3, 1, figsize=(9, 7), layout="constrained", sharex=True)
panels[0].plot(times, 100 * one.response("position 0", times), color="#0072B2")
panels[0].set_ylabel("bearings (cm)")
panels[1].plot(times, 1000 * one.response("position 1 - position 0", times), color="#009E73")
panels[1].set_ylabel("drift, storey 1 (mm)")
panels[2].plot(times, one.response("base shear", times) / 1e3, color="#D55E00")
panels[2].set_ylabel("base shear (kN)")
panels[2].set_xlabel("time (s)")
panels[2].set_xlim(0.0, end)
plt.show()
masses_times = FLOOR * sum(one.response(f"total acceleration {i}", times) for i in range(STOREYS + 1))
print(f"base shear is the sum of masses times total accelerations within 1e-6 N: "
      f"{np.max(np.abs(masses_times - one.response('base shear', times))) < 1e-6}")  # fmt: skip
work = MU * weight * float(one.slip_path)
print(f"friction has dissipated {float(one.friction_energy) / 1e3:.3f} kJ, friction force times slip path "
      f"{work / 1e3:.3f} kJ; ground motion supplied {float(one.input_energy) / 1e3:.3f} kJ")  # fmt: skip

# %% [markdown]
# ## All of them
#
# Outputs by name, found as the samples are simulated: largest values inside the steps, not on a grid. Beside it the
# building fixed to the ground, whose bearings have so much friction that they never slide.

# %%
reported = ["residual position 0", "peak position 0", "slip path", "peak base shear"]
reported += [f"peak position {i + 1} - position {i}" for i in range(STOREYS)]
reported += [f"peak total acceleration {i}" for i in range(STOREYS + 1)]
settings = {"t1": end, "samples": len(suite), "keep": "totals", "outputs": reported}
isolated, held = (ss.simulate_ensemble(building(mu), suite, **settings) for mu in (MU, 10.0))
print(f"all finished: {isolated.samples == isolated.moments.number}; "
      f"sliding of the fixed building: {np.max(held.output_values['slip_path']):g} m")  # fmt: skip
print(f"{'median of':45} {'on bearings':>12} {'fixed':>12}")
for name, known in isolated.outputs.items():
    middle = [np.median(np.abs(many.output_values[name])) for many in (isolated, held)]
    print(f"{known.name:45} {middle[0]:12.4g} {middle[1]:12.4g} {known.unit}")

# %% [markdown]
# The fixed building is linear, and `scipy.signal.lsim` computes its response exactly: the drift of the first storey.

# %%
record = suite.motion(0)
ground_times, ground = np.asarray(record.times), np.asarray(record.accelerations)
viscous = np.diag(np.append(damping[:-1] + damping[1:], damping[-1]))
viscous = viscous - np.diag(damping[1:], 1) - np.diag(damping[1:], -1)
below, right = np.hstack([-fixed / FLOOR, -viscous / FLOOR]), np.hstack([np.zeros((STOREYS, STOREYS)), np.eye(STOREYS)])
linear = (np.vstack([right, below]), np.append(np.zeros(STOREYS), -np.ones(STOREYS))[:, None],
          np.eye(1, 2 * STOREYS), [[0.0]])  # fmt: skip
_, drift, _ = lsim(linear, ground, ground_times, interp=True)
ours = np.asarray(
    ss.simulate(building(10.0), suite[0], t1=end).response("position 1 - position 0", ground_times[ground_times <= end])
)
print(f"drift by lsim the same within 1e-9 m: {np.max(np.abs(drift[: len(ours)] - ours)) < 1e-9}")

# %% [markdown]
# ## Floor spectra
#
# What stands on the top floor feels the total acceleration there. Its response spectrum is that of this history, here
# every 5 ms; medians over the earthquakes.

# %%
fine = np.arange(0.0, end, 0.005)
oscillators = np.geomspace(0.05, 4.0, 40)  # periods, s


def floor_spectra(mu, earthquakes):
    """Spectral accelerations on the top floor, (earthquakes, periods), m/s^2."""
    floors = []
    for number in range(earthquakes):
        motion = ss.simulate(building(mu), suite[number], t1=end)
        floors.append(ss.GroundAcceleration(fine, motion.response(f"total acceleration {STOREYS}", fine)))
    return ss.response_spectrum(floors, oscillators, damping=0.05).pseudo_acceleration.values


some = min(6, len(suite))
spectra = {"fixed to the ground": floor_spectra(10.0, some), f"on bearings, $\\mu$ = {MU:g}": floor_spectra(MU, some)}
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for (label, values), color in zip(spectra.items(), ("#000000", "#0072B2"), strict=True):
    axes.loglog(oscillators, np.median(values, axis=0), color=color, label=label)
axes.set_xlabel("period of what stands on the top floor (s)")
axes.set_ylabel("spectral acceleration (m/s$^2$)")
axes.legend(frameon=False)
plt.show()
near = int(np.argmin(np.abs(oscillators - periods[0])))
ratio = np.median(spectra["fixed to the ground"], axis=0)[near] / np.median(list(spectra.values())[1], axis=0)[near]
print(f"at {oscillators[near]:.2f} s, near the period of the building, the bearings divide the spectrum by {ratio:.1f}")

# %% [markdown]
# ## How likely do the bearings reach their edge?
#
# Incremental dynamic analysis: every ground motion scaled to thirteen spectral accelerations at the period of the
# pendulums; then a lognormal fragility curve by maximum likelihood, whose errors are those of whole records.

# %%
EDGE = 0.25  # m
levels = np.arange(0.75, 4.0, 0.25)  # m/s^2
equal = ss.RecordSuite([suite.motion(i) for i in range(len(suite))], scale=1.0 / intensity)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
curves = {}
for mu, color in ((0.04, "#0072B2"), (0.08, "#D55E00")):
    table = ss.incremental_dynamic_analysis(
        building(mu), equal, scales=levels, t1=end, outputs={"peak": ss.Output("peak position 0")}
    )
    exceeds = ~(table.peak.values <= EDGE)
    curve = ss.fragility(levels[:, None], exceeds, records=table.record.values)
    curves[mu] = curve
    drawn = curve.to_pandas(np.linspace(0.5, 4.0, 100))
    axes.plot(drawn.intensity, drawn.probability, color=color, label=f"$\\mu$ = {mu:g}")
    axes.fill_between(drawn.intensity, drawn.low, drawn.high, color=color, alpha=0.2, lw=0)
    axes.plot(levels, exceeds.mean(axis=1), "o", color=color)
    print(f"mu = {mu:g}: {curve}")
axes.set_xlabel(f"spectral acceleration at {pendulum:.2f} s (m/s$^2$)")
axes.set_ylabel(f"probability of more than {100 * EDGE:g} cm")
axes.set_ylim(0.0, 1.0)
axes.legend(frameon=False)
plt.show()
print(f"more friction, a stronger earthquake to reach the edge: {curves[0.08].median > curves[0.04].median}")
