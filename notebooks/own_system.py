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
# # A system of your own: a pendulum on a turning shaft
#
# A rigid pendulum hangs on a shaft, and rubs on it. Where the shaft carries the pendulum along, the pendulum sticks;
# where friction cannot hold it, it slips. With angle `phi` and shaft speed `Omega`, a slip obeys
#
# `m l^2 phi'' + m g l sin(phi) = -M sign(phi' - Omega)`.
#
# In a stick `phi' = Omega`, as long as `|m l^2 Omega' + m g l sin(phi)| <= M_s`; the static torque `M_s` is larger
# than the kinetic torque `M`. This system is not one of the package. It takes a class of some twenty lines; sticks,
# figures, ensembles and derivatives follow from it.

# %%
import itertools
import math
import os
from typing import Annotated

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "5_000"))
GRAVITY = 9.80665  # m/s^2

# %% [markdown]
# ## The class
# Three things are required: the names of the state, its rates under a given share of the kinetic friction, and the
# relative velocity in the contact. The other members are optional. `shortest_time` sets the time step;
# `coordinates` and `look` improve the figures.


# %%
class Pendulum(ss.SwitchedSystem):
    """A point mass on a rod that rubs on a turning shaft."""

    mass: Annotated[float, ss.Quantity("kg", above=0)]
    length: Annotated[float, ss.Quantity("m", above=0)]
    torque: Annotated[float, ss.Quantity("N m", "of kinetic friction", above=0)]
    ratio: Annotated[float, ss.Quantity(meaning="static over kinetic friction", at_least=1)]

    @property
    def state_names(self):
        return "angle in rad", "angular velocity in rad/s"

    def rates(self, t, y, base, friction):
        angle, velocity = y
        pull = self.mass * GRAVITY * self.length * jnp.sin(angle)
        return velocity, (-pull - friction * self.torque) / (self.mass * self.length**2)

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def static_ratio(self):
        return self.ratio

    @property
    def shortest_time(self):
        return 2 * math.pi * (self.length / GRAVITY) ** 0.5

    @property
    def coordinates(self):
        return ss.Coordinate("angle", "rad", r"\varphi"), ss.Coordinate("angular velocity", "rad/s", r"\dot\varphi")

    @property
    def look(self):
        return ss.plot.Look("pendulum", stick_band=self.stick_band)

    def stick_band(self, times, state, velocity, acceleration, ground):
        """The angles at which friction can hold the pendulum, while these are between -pi/2 and pi/2."""
        weight, inertia = self.mass * GRAVITY * self.length, self.mass * self.length**2 * acceleration
        return tuple(jnp.arcsin((side * self.ratio * self.torque - inertia) / weight) for side in (-1, 1))


pendulum = Pendulum(mass=1.0, length=1.0, torque=3.0, ratio=1.3)
print(pendulum)

# %% [markdown]
# ## A shaft that turns at a constant speed
# The pendulum is carried up until its weight overcomes the static torque, falls back, and is caught again. Two closed
# forms hold: a stick ends at `sin(phi) = M_s / (m g l)`; and since the kinetic torque is constant in the slip,
# `V(phi) = -m g l cos(phi) - M phi` is the same where the slip begins and where it ends, both with `phi' = Omega`.
# The base is written as a harmonic motion of amplitude 0, so that what JAX compiles for it serves the next one too;
# `ss.Constant(0.5)` is the same motion.

# %%
t1 = 40.0  # s
steady = ss.simulate(pendulum, ss.Harmonic(amplitude=0.0, angular_frequency=1.7, offset=0.5), t1=t1)
print(steady)
last = int(steady.sticks.count) - 2  # a stick of the limit cycle, complete
release = math.asin(pendulum.ratio * pendulum.torque / GRAVITY)


def potential(angle):
    return -GRAVITY * math.cos(angle) - pendulum.torque * angle


lowest = math.asin(pendulum.torque / GRAVITY)  # the least of the potential: the slip ends on its other side
catch = brentq(lambda angle: potential(angle) - potential(release), -1.0, lowest, xtol=1e-15)
found = float(steady.sticks.position[last]), float(steady.evaluate(steady.sticks.end[last])[0])
print(f"sticks begin at {found[0]:.10f} rad, by the closed form {catch:.10f} rad")
print(f"and end at      {found[1]:.10f} rad, by the closed form {release:.10f} rad")
steady_error = max(abs(found[0] - catch), abs(found[1] - release))
print(f"closed forms hold within 1e-9 rad: {steady_error < 1e-9}")

# %%
ax = ss.plot.phase_portrait(steady)

# %% [markdown]
# ## A shaft that swings
# `Harmonic` is the shaft's angular velocity here. The shaded band holds the angles at which friction can carry the
# pendulum along; it moves because the shaft's acceleration needs a torque too.

# %%
shaft = ss.Harmonic(amplitude=1.2, angular_frequency=1.7, offset=0.3)
one = ss.simulate(pendulum, shaft, t1=t1)
print(one)

# %%
axes = ss.plot.time_history(one, window=(0.0, 20.0))
times = np.linspace(0.0, 20.0, 1001)
(line,) = axes[1].plot(times, one.base_velocity(times), ls="--", lw=1.0, color="#0072B2", label="shaft")
legend = axes[1].legend(handles=[line], loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)

# %% [markdown]
# ## Against an independent integration
# The same motion by `scipy.integrate.solve_ivp` (DOP853), mode by mode: a slip ends where the relative velocity
# vanishes, a stick where the torque that it needs reaches the static torque. None of the package's code takes part.


# %%
def by_scipy(events):
    """Starts and ends of sticks, s, by integration from event to event, until so many were found."""

    def speed(t):
        return 0.3 + 1.2 * math.cos(1.7 * t)

    def acceleration(t):
        return -1.2 * 1.7 * math.sin(1.7 * t)

    def need(t, y):  # the friction torque of a stick, positive against a positive relative velocity
        return -(acceleration(t) + GRAVITY * math.sin(y[0]))

    def relative(t, y):
        return y[1] - speed(t)

    def reserve(t, y):
        return 1.3 * 3.0 - abs(need(t, y))

    relative.terminal = reserve.terminal = True
    t, y, starts, ends = 0.0, np.zeros(2), [], []
    mode = math.copysign(1.0, relative(t, y))  # 0: stick
    while len(starts) + len(ends) < events:
        if mode == 0:
            rates, event = lambda t, y: [speed(t), acceleration(t)], reserve
        else:
            rates, event = lambda t, y, side=mode: [y[1], -GRAVITY * math.sin(y[0]) - 3.0 * side], relative
            relative.direction = -mode  # back to zero, so that the zero at the beginning of the slip does not count
        motion = solve_ivp(rates, (t, t1), y, "DOP853", events=event, rtol=1e-13, atol=1e-13, max_step=0.01)
        t, y = motion.t_events[0][0], motion.y_events[0][0]
        released, held = mode == 0, reserve(t, y) > 0
        if released:
            ends.append(t)
        elif held:
            starts.append(t)
        mode = 0.0 if held and not released else math.copysign(1.0, need(t, y))
    return np.array(starts), np.array(ends)


starts, ends = by_scipy(10)
print("   start (s)        by scipy         end (s)          by scipy")
for row in zip(one.sticks.start, starts, one.sticks.end, ends, strict=False):
    print("  ".join(f"{number:15.10f}" for number in row))
largest = max(
    np.max(np.abs(np.asarray(one.sticks.start)[: len(starts)] - starts)),
    np.max(np.abs(np.asarray(one.sticks.end)[: len(ends)] - ends)),
)
print(f"largest difference of {len(starts) + len(ends)} events: {largest:.1e} s, below 1e-8 s: {largest < 1e-8}")

# %% [markdown]
# **Verdict.** The class describes the pendulum that was meant, and events are those of the integration.

# %% [markdown]
# ## Derivatives
# A system is a tree of numbers for JAX: the derivative of the total stick time by a whole system is a system that
# holds the derivatives by its numbers. `jax.grad` gives the same, but stores all time steps. Beside them, central
# differences.


# %%
def stick_time(system):
    return ss.simulate(system, shaft, t1=t1).stick_time


slopes = jax.jacfwd(stick_time)(pendulum)
numbers = {name: getattr(pendulum, name) for name in ("mass", "length", "torque", "ratio")}
worst = 0.0
for name, value in numbers.items():
    up, down = (stick_time(Pendulum(**numbers | {name: value + side * 1e-5})) for side in (1, -1))
    difference, slope = float(up - down) / 2e-5, float(getattr(slopes, name))
    worst = max(worst, abs(difference - slope) / abs(slope))
    print(f"d(stick time)/d({name}) = {slope:.6f}, by finite difference {difference:.6f}")
print(f"they agree within 1e-5: {worst < 1e-5}")

# %% [markdown]
# These are derivatives along one motion. Those of a mean over sticks of many motions are a matter of `ss.sensitivity`.

# %% [markdown]
# ## Many pendulums, each with its own friction, on shafts that turn at random
# The shaft turns forward or backward and reverses at the points of a Poisson process; the kinetic torque differs from
# sample to sample. `many.input_values` holds what was drawn.

# %%
uncertain = Pendulum(mass=1.0, length=1.0, torque=ss.Uniform(1.0, 5.0), ratio=1.3)
many = ss.simulate_ensemble(
    uncertain,
    ss.PoissonSwitching(speed=0.5, rate=0.1),
    t1=t1,
    samples=SAMPLES,
    key=jax.random.key(0),
    keep="sticks",
    progress=False,
)
print(many)
print(ss.stick_fraction(many))
print(ss.mean_stick_duration(many))

# %%
ax = ss.plot.histogram(many.statistics.duration, bins=60)

# %% [markdown]
# The share of time spent sticking against the torque: each sample, and means over eight intervals of the torque with
# their standard errors.

# %%
torques = np.asarray(many.input_values["torque"])
shares = 100 * np.asarray(many.totals.stick_time) / t1
figure, ax = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
ax.plot(torques, shares, ".", color="#0072B2", alpha=0.4, ms=3, label="samples")
edges = np.linspace(1.0, 5.0, 9)
groups = [shares[(torques >= low) & (torques < high)] for low, high in itertools.pairwise(edges)]
ax.errorbar(
    (edges[1:] + edges[:-1]) / 2,
    [group.mean() for group in groups],
    [group.std(ddof=1) / math.sqrt(len(group)) for group in groups],
    fmt="o-",
    color="#000000",
    capsize=3,
    label="means and standard errors",
)
ax.set_xlabel("kinetic friction torque (N m)")
ax.set_ylabel("time spent sticking (%)")
figure.legend(loc="outside upper center", ncols=2, frameon=False)
plt.show()
for group, low, high in zip(groups[::7], edges[::7], edges[1::7], strict=True):
    error = group.std(ddof=1) / math.sqrt(len(group))
    print(f"{low:g} to {high:g} N m: {group.mean():.1f} +- {error:.1f} % of the time in sticks")
