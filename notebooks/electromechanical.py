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
# # A motor, a cart, and the first stick
#
# Lima and Sampaio, *An electromechanical system with uncertain stick-slip oscillations* (Mec. Comput. XXXIX, 2022): a
# DC motor drives a cart with dry friction through a scotch yoke. The phase of the voltage and the initial angle are
# random, and the paper asks how the duration of the first stick depends on the angle at which it happens. Its 20,000
# runs took about 30 hours of CPU and made 20 GB of data. Parameters: the paper's table 1; initial angular velocity and
# current, the time interval and the acceleration of gravity, which it does not give, are 0, 0, 2 s and 9.81 m/s^2 here.
#
# Three of its equations cannot be meant as they are printed. In equation 2 the term with `m d^2 sin cos` has the factor
# `alpha'`; it is a centrifugal term, of the second degree, and with `alpha'^2` its unit is that of the others. Equation
# 3 has `sin(omega_v t)` where the voltage of equation 1 has `sin(omega_v t + theta)`. Equations 7 and 8 are looked at
# below.

# %%
import math
import os
import time

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import stickslip_jax as ss
from stickslip_jax import papers

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "10_000"))
voltage = ss.SourceVoltage(mean=1.0, amplitude=0.5, angular_frequency=10.0)

# %% [markdown]
# ## Figure 2b: sticks and slips follow each other
# In a stick the angle stands still; the current goes on, and ends the stick when its torque leaves the shaded band.

# %%
one = ss.simulate(ss.MotorCart(mu=0.5), voltage, t1=2.0, y0=(0.3, 0.0, 0.0))
axes = ss.plot.time_history(one, window=(0.0, 1.5))

# %% [markdown]
# ## Figure 3: the upper bound of a stick's duration
# The paper: no stick at mu = 0.1; at 0.2 some, the longest at `pi/2` and `3 pi/2`; from 0.6 on there are angles at
# which a stick lasts for ever. Curves end where the bound becomes infinite.

# %%
angles = np.linspace(0.0, 2 * math.pi, 4001)
figure, panels = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained", sharey=True)
for panel, frictions in zip(panels, ((0.1, 0.2, 0.3, 0.4, 0.5), (0.6, 0.7, 0.8, 0.9, 1.0)), strict=True):
    ss.plot.stick_bounds(ss.MotorCart(), voltage, mu=frictions, ax=panel)
    for mu in frictions:
        bound = np.asarray(ss.stick_duration_bound(ss.MotorCart(mu=mu), voltage, angles))
        highest = float(ss.stick_duration_bound(ss.MotorCart(mu=mu), voltage, math.pi / 2))
        print(f"mu = {mu:g}: at pi/2 {highest:.5g} s; no stick at {100 * (bound == 0).mean():.1f} % of the angles, "
              f"no limit at {100 * np.isinf(bound).mean():.1f} %")  # fmt: skip
plt.show()

# %% [markdown]
# The two thresholds of `mu |sin alpha|`: below the first there is no stick, above the second it lasts for ever. Gravity
# enters by its product with mu only.

# %%
cart = ss.MotorCart(mu=1.0)
least, most = (
    float(cart.motor_constant * current / cart.largest_friction_torque)
    for current in (
        voltage.mean / cart.resistance + sign * voltage.amplitude
        / math.hypot(cart.resistance, cart.inductance * voltage.angular_frequency)
        for sign in (-1, 1)
    )
)  # fmt: skip
print(f"a stick is possible where mu |sin alpha| > {least:.5f}, for ever where it is > {most:.5f}")
rounded, usual = (
    float(ss.stick_duration_bound(ss.MotorCart(mu=0.5, gravity=gravity), voltage, math.pi / 2))
    for gravity in (9.8, 9.81)
)
print(f"with 9.8 m/s^2 the longest stick at mu = 0.5 is {1e3 * (usual - rounded):.1f} ms shorter")

# %% [markdown]
# The paper's equations 7 and 8 lack the angular frequency in some places: with `sqrt(r^2 + l^2)` and `phi = -atan(l /
# r)` as printed, instead of `sqrt(r^2 + (l omega_v)^2)` and `-atan(l omega_v / r)`, the bound and the current hardly
# change.


# %%
def printed_bound(mu, angle):
    """The bound by the current of eq. 8 as printed, s; for angles at which a stick ends."""
    system = ss.MotorCart(mu=mu)
    r, inductance, frequency = system.resistance, system.inductance, voltage.angular_frequency
    amplitude = voltage.amplitude * math.hypot(r, inductance) / (inductance**2 * frequency**2 + r**2)
    held = system.largest_friction_torque * np.abs(np.sin(angle)) / system.motor_constant
    return (math.pi + 2 * np.arcsin((held - voltage.mean / r) / amplitude)) / frequency


exact = np.asarray(ss.stick_duration_bound(ss.MotorCart(mu=0.5), voltage, angles))
ends = (exact > 0) & np.isfinite(exact) & (exact < 0.99 * exact.max())
change = np.abs(printed_bound(0.5, angles[ends]) - exact[ends])
print(
    f"as printed, the bound at mu = 0.5 changes by {1e6 * np.median(change):.0f} microseconds (median), "
    f"at most {1e6 * change.max():.0f}"
)
r, inductance, frequency = cart.resistance, cart.inductance, voltage.angular_frequency
currents = voltage.amplitude * np.array(
    [
        math.hypot(r, inductance) / (inductance**2 * frequency**2 + r**2) * np.exp(-1j * math.atan(inductance / r)),
        1 / (r + 1j * inductance * frequency),
    ]
)
highest = voltage.mean / r + abs(currents[1])
print(f"and the current by at most {1e3 * abs(np.diff(currents)[0]):.0f} mA of {highest:.1f} A")

# %% [markdown]
# **Verdict.** As the paper says, mu by mu; the misprints of equations 7 and 8 hardly matter.

# %% [markdown]
# ## Figures 4 and 5: position and duration of the first stick
# The paper's scatter plots with the bound, and joint histograms, at mu = 0.2 and 0.5. By the paper's definition, that a
# stick is an interval in which nothing moves, the rest at the start is one: the current has to rise first. Both counts
# are given; what is drawn leaves that rest out, because it tells of the start only.

# %%
runs = {}
began = time.perf_counter()
for mu in (0.2, 0.5):
    setup = papers.motor_cart(mu=mu)
    runs[mu] = ss.simulate_ensemble(
        setup.system, setup.law, t1=setup.t1, y0=setup.y0, samples=SAMPLES, key=jax.random.key(0), keep="sticks",
        progress=False,
    )  # fmt: skip
took = time.perf_counter() - began
for mu, many in runs.items():
    for counted, name in ((True, "the paper's count, with the initial rest"), (False, "without the initial rest")):
        first = ss.first_stick(many, count_initial_rest=counted)
        durations = first.duration[first.mask]
        print(f"mu = {mu}, {name}: {first.count} of {SAMPLES} samples have a first stick, of "
              f"{1e3 * durations.mean():.0f} ms on average, at most {1e3 * durations.max():.0f} ms")  # fmt: skip
    share = many.statistics.order(1).share
    bound = ss.stick_duration_bound(many.system, voltage, first.position[first.mask])
    longer = np.sum(first.duration[first.mask] > bound + 1e-3)
    height = stats.spearmanr(np.abs(np.sin(first.position[first.mask])), durations)
    print(f"  rank correlation of duration and |sin alpha|: {height.statistic:.2f}, p = {height.pvalue:.1g}")
    print(f"mu = {mu}: {share.value:.4f} +- {share.standard_error:.4f} of the samples have a first stick, "
          f"{longer} of these are longer than the bound by over 1 ms")  # fmt: skip

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
for panel, (mu, many) in zip(panels, runs.items(), strict=True):
    ss.plot.stick_map(ss.first_stick(many), system=many.system, bound=voltage, period=math.pi, ax=panel)
    panel.set_xlabel(panel.get_xlabel() + rf", $\mu$ = {mu:g}")
plt.show()

# %% [markdown]
# With the initial rest counted, most first sticks are the wait for the current, at any angle.

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
for panel, (mu, many) in zip(panels, runs.items(), strict=True):
    first = ss.first_stick(many, count_initial_rest=True)
    ss.plot.stick_map(first, system=many.system, period=math.pi, ax=panel)
    panel.set_xlabel(panel.get_xlabel() + rf", $\mu$ = {mu:g}, the initial rest counted")
plt.show()

# %% [markdown]
# The angular velocity and the current at the start, which the paper does not give, decide how many samples have a first
# stick at mu = 0.2; and so does the equation, as printed or with the square.

# %%
few = min(SAMPLES, 1000)
print(f"first sticks of {few:,} samples at mu = 0.2, without the initial rest")
print("equation    angular velocity   current 0 A      2 A      5 A")
for equation in ("physical", "printed"):
    for velocity in (0.0, 2.0, 5.0, 10.0):
        counts = []
        for current in (0.0, 2.0, 5.0):
            others = ss.simulate_ensemble(
                ss.MotorCart(mu=0.2, equation=equation), runs[0.2].law, t1=2.0, samples=few,
                key=jax.random.key(2), y0=(ss.Uniform(0.0, 2 * math.pi), velocity, current), keep="sticks",
                progress=False,
            )  # fmt: skip
            counts.append(ss.first_stick(others).count)
        print(f"{equation:10s} {velocity:9.0f} rad/s   " + "".join(f"{count:9d}" for count in counts))

# %%
for mu, many in runs.items():
    first = ss.first_stick(many)
    number = int(np.clip(math.sqrt(first.count) / 2, 6, 40))  # some sticks to each cell that holds any
    edge = math.asin(least / mu) - 0.02  # rad, just beyond the angles at which a stick is possible
    bins = (np.linspace(edge, math.pi - edge, number + 1), number)
    main, *_ = ss.plot.joint_histogram(first, system=many.system, bound=voltage, period=math.pi, bins=bins, log=True)
    main.set_xlabel(main.get_xlabel() + rf", $\mu$ = {mu:g}")
    near = f"{math.degrees(edge):.1f} degrees of 0 and 180"
    print(f"mu = {mu}: angles within {near}, at which no stick is possible, are left out")
plt.show()

# %% [markdown]
# And with the initial rest counted: waits for the current, of a few milliseconds, fill the first row at every angle.

# %%
for mu, many in runs.items():
    first = ss.first_stick(many, count_initial_rest=True)
    main, *_ = ss.plot.joint_histogram(first, system=many.system, period=math.pi, bins=30, log=True)
    main.set_xlabel(main.get_xlabel() + rf", $\mu$ = {mu:g}")
    waits = np.mean(first.duration[first.mask] < 0.005)
    print(f"mu = {mu}, with the initial rest: {100 * waits:.0f} % of the first sticks are shorter than 5 ms")
plt.show()

# %% [markdown]
# ## Are 10,000 runs enough?
# The paper: a joint histogram needs far more runs than a marginal one. The distance in total variation between the
# joint histograms of two halves of the samples says how many.

# %%
for mu, many in runs.items():
    halves = ss.histogram_convergence(many, ("position", 1), ("duration", 1), bins=20)
    print(f"mu = {mu}: two halves of {int(halves.numbers[-1])} samples differ by {100 * halves.distances[-1]:.1f} %")

# %% [markdown]
# **Verdict.** The supports are those of the bound, as the paper says: no stick is longer by over 1 ms. At mu = 0.5
# every sample has a first stick after it has moved, and the duration depends on the angle as the bound does. At mu =
# 0.2 only few have one, as many as the lines above say, so that 10,000 runs give a joint histogram of a few hundred
# points, of which two halves differ greatly; how few depends on the start, which the paper does not give, as the table
# above shows. Counted with the initial rest nearly every sample has a first stick, but
# most of these are the wait for the current. The text does not give the paper's own shares.

# %%
print(f"{len(runs) * SAMPLES} runs took {took:.1f} s with compilation; the paper's 20,000, about 30 hours of CPU")
