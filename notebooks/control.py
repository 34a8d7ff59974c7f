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
# # Steering by the prediction of the next stick
#
# A block on a spring rubs on a table that moves at 0.5 m/s and reverses at random, every 20 s on average; static
# friction is twice the kinetic friction. Sticks are unwanted. An actuator may take off up to 40 % of the normal force,
# but it is slow: its time constant is 2 s, longer than a stick lasts. If it reacts to a stick, it comes too late. If it
# is told when the next stick will begin, it can be there. That needs the distribution of the next stick given how the
# last one ended: the transition kernel of the sequence of sticks. What does prediction gain, and at what cost?

# %%
import os
from typing import Annotated

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

SAMPLES = max(int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "128")), 32)
SPEED, T1 = 0.5, 200.0  # m/s; s
BLUE, PINK, ORANGE, BLACK = "#0072B2", "#CC79A7", "#E69F00", "#000000"
law = ss.PoissonSwitching(speed=SPEED, rate=0.05)
block = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=0.4, mu_static=0.8))

# %% [markdown]
# ## The next stick, given the last one
# The kernel of the block that nobody steers, from its simulated sticks. After a stick the state is where the stick
# ended, which way the table went, and whether the block broke away (`RELEASED`) or the table reversed
# (`BASE_SWITCHED`).

# %%
plain = {"t1": 1000.0, "keep": "sticks", "progress": False}
many = ss.simulate_ensemble(block, law, samples=1024, key=jax.random.key(0), **plain)
kernel = ss.transition_kernel(many)
print(kernel)


def next_stick(place, ending):
    """What follows a stick that ended at `place` (m) on a table that moved forward."""
    return ss.forecast(kernel, {"end_position": place, "base_velocity": SPEED, "ending": ending})


released, reversed_at_rest = next_stick(0.8, ss.Ending.RELEASED), next_stick(0.0, ss.Ending.BASE_SWITCHED)
print(released)
print(reversed_at_rest)

# %%
fig, ax = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
cases = ((released, BLUE, "after the block broke away"), (reversed_at_rest, PINK, "after the table reversed, at 0 m"))
for forecast, color, label in cases:
    starts = np.sort(forecast.following["slip_before"])
    ax.plot(starts, np.arange(1, len(starts) + 1) / len(starts), color=color, lw=1.6, label=label)
ax.set(xlim=(0, 12), ylim=(0, 1), xlabel="time since the end of the last stick in s")
ax.set_ylabel("probability that the next stick\nhas begun")
ax.legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# A block that broke away sticks again after 4.92 s if the table does not reverse by then, which is what happens most
# often. After a reversal it depends on the place. Are such forecasts right? A record of other sticks is the judge:
# where each of them lies in its forecast must be spread evenly.

# %%
record = ss.simulate_ensemble(block, law, samples=32, key=jax.random.key(1), **plain)
scores = ss.score_forecasts(kernel, ss.transition_kernel(record))
print(scores)

# %% [markdown]
# ## The controller
# It sees the relative velocity, which tells it that the block sticks, the place and the direction of the table, and it
# has a clock since the last stick. Three numbers are held while the block slips: clock, place and direction. From these
# it knows the median of the next start: 4.92 s after the block broke away, and after a reversal a parabola in the
# place, fitted to forecasts. `lead` seconds before, it asks for less normal force. The actuator follows with its lag.


# %%
def median_start(place, ending):
    return float(next_stick(place, ending).distribution("slip_before").median.value)


AFTER_RELEASE = median_start(0.8, ss.Ending.RELEASED)  # s
places = np.linspace(0.0, 0.8, 9)
AFTER_REVERSAL = np.polyfit(places, [median_start(place, ss.Ending.BASE_SWITCHED) for place in places], 2)  # s
print(f"after a release {AFTER_RELEASE:.3f} s; after a reversal at 0, 0.4 and 0.8 m",
      np.round(np.polyval(AFTER_REVERSAL, [0.0, 0.4, 0.8]), 2), "s")  # fmt: skip


class Steered(ss.SwitchedSystem):
    """The block, an actuator of its normal force, and a controller. Part of the state are the controller's memory, and
    what the actuator has taken off so far.
    """

    gain: Annotated[float, ss.Quantity(meaning="largest share that may be taken off", at_least=0, below=1)] = 0.0
    lead: Annotated[float, ss.Quantity("s", "ahead of the predicted start", at_least=0)] = 0.0
    foresight: Annotated[float, ss.Quantity(meaning="1 with prediction, 0 without", at_least=0)] = 0.0
    constant: Annotated[float, ss.Quantity(meaning="share taken off all the time", at_least=0, below=1)] = 0.0
    lag: Annotated[float, ss.Quantity("s", "of the actuator", above=0)] = 2.0

    @property
    def state_names(self):
        return ("position in m", "velocity in m/s", "normal force in N", "time since the last stick in s",
                "place where it ended in m", "direction of the table in it", "taken off so far in N s")  # fmt: skip

    def rates(self, t, y, base, friction):
        position, velocity, normal, clock, place, direction, _ = y
        sticks = jnp.exp(-(((velocity - base.velocity) / 0.02) ** 2))  # 1 at rest on the table, 0 above some 0.05 m/s
        forward = base.velocity / SPEED
        goes_on = (1 + direction * forward) / 2  # 0 after a reversal
        predicted = goes_on * AFTER_RELEASE + (1 - goes_on) * jnp.polyval(AFTER_REVERSAL, place)
        soon = jnp.exp(-((clock + self.lead - predicted) ** 2))
        asked = self.gain * (sticks + (1 - sticks) * self.foresight * soon)
        wanted = (1 - self.constant) * (1 - asked)
        hold = sticks / 0.05  # 1/s: while the block sticks, memory follows what is seen
        return (velocity, -position - 0.4 * normal * friction, (wanted - normal) / self.lag, 1 - clock * hold,
                (position * forward - place) * hold, (forward - direction) * hold, 1 - normal)  # fmt: skip

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def static_ratio(self):
        return 2.0

    @property
    def shortest_time(self):
        return 0.4


Y0 = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)

# %% [markdown]
# One realisation of the table, three times: nobody steers, the actuator reacts to sticks, and it is told of them.

# %%
table = law.sample(jax.random.key(3), t1=60.0)
fig, axes = plt.subplots(3, 1, figsize=(7.0, 5.4), sharex=True, layout="constrained")
times = np.linspace(0.0, 60.0, 1201)
kinds = {
    "not steered": Steered(),
    "reacting": Steered(gain=0.4),
    "predicting": Steered(gain=0.4, lead=1.0, foresight=1.0),
}
for ax, (name, system) in zip(axes, kinds.items(), strict=True):
    one = ss.simulate(system, table, t1=60.0, y0=Y0)
    states = one.evaluate(times)
    ax.plot(times, states[1], color=BLACK, lw=0.8, label="velocity of the block in m/s")
    ax.plot(times, states[2], color=BLUE, lw=1.4, label="normal force in N")
    held = one.sticks.mask
    for start, end in zip(one.sticks.start[held], one.sticks.end[held], strict=True):
        ax.axvspan(start, end, color=ORANGE, alpha=0.5, lw=0)
    ax.set_title(f"{name}: sticks (shaded) for {float(one.stick_time):.1f} s", fontsize=9, loc="left")
axes[-1].set_xlabel("time in s")
axes[0].legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.4, 1.0))
plt.show()

# %% [markdown]
# ## Effect and cost
# All samples, the same tables for every way of steering. The effect is the share of the time that the block sticks; the
# cost is the mean share of the normal force that was taken off. Constant means less of it all the time.


# %%
def outcome(parameters, key):
    """Stick share, number of sticks, cost, and whether the sample reached `T1`."""
    one = ss.simulate(Steered(*parameters), law.sample(key, t1=T1, capacity=60), t1=T1, y0=Y0)
    finished = one.status == ss.Status.FINISHED
    return jnp.stack([one.stick_time / T1, one.sticks.count.astype(float), one.final_state[6] / T1, finished])


keys = jax.random.split(jax.random.key(2), SAMPLES)
outcomes = jax.jit(jax.vmap(outcome, (None, 0)))


def steered(gain=0.0, lead=0.0, foresight=0.0, constant=0.0):
    """The outcome of each sample, (samples, 3)."""
    found = np.asarray(outcomes(jnp.array([gain, lead, foresight, constant]), keys))
    assert found[:, 3].all()
    return found[:, :3]


def mean(values):
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))


GAINS = (0.2, 0.3, 0.4)
ways = {
    "constant": [steered(constant=share) for share in (0.05, 0.15)],
    "reacting": [steered(gain) for gain in GAINS],
    "predicting": [steered(gain, 1.0, 1.0) for gain in GAINS],
}
nothing = steered()
print("                       stick share in %     sticks in 200 s       taken off in %")
for name, values in (("not steered", nothing), *((name, found[-1]) for name, found in ways.items())):
    (share, number, cost), (share_error, number_error, cost_error) = mean(values)
    print(f"{name:20s} {100 * share:8.2f} +- {100 * share_error:.2f} {number:12.2f} +- {number_error:.2f}"
          f" {100 * cost:12.2f} +- {100 * cost_error:.2f}")  # fmt: skip

# %%
fig, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
for (name, found), color in zip(ways.items(), (BLACK, PINK, BLUE), strict=True):
    points = [mean(values) for values in (nothing, *found)]
    x, y = ([100 * value[0][at] for value in points] for at in (2, 0))
    x_errors, y_errors = ([200 * value[1][at] for value in points] for at in (2, 0))
    ax.errorbar(x, y, y_errors, x_errors, color=color, marker="o", ms=3, lw=1.2, label=name)
ax.set(xlabel="normal force taken off in %", ylabel="share of the time that it sticks in %", ylim=(0, None))
ax.legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# Bars are two standard errors. What can be said is about differences of the same samples:

# %%
reacting, predicting = ways["reacting"][-1], ways["predicting"][-1]
for what, at in (("stick share", 0), ("number of sticks", 1), ("normal force taken off", 2)):
    difference, error = mean(predicting - reacting)
    ratio = predicting[:, at].mean() / reacting[:, at].mean()
    print(f"{what}, predicting less reacting at a gain of 0.4: {difference[at]:+.4f} +- {error[at]:.4f}, "
          f"{ratio:.2f} times")  # fmt: skip
gained = mean(reacting[:, 0] - predicting[:, 0])
print("prediction lessens the stick share by more than ten standard errors:", bool(gained[0] > 10 * gained[1]))

# %% [markdown]
# **Verdict.** Less normal force all the time is the dearest way. For small gains reacting is the cheaper of the two
# others: all it takes off is taken off in sticks. But it ends where the actuator ends, at its 40 %, with sticks a
# quarter shorter and as many as before. Told of a stick in advance, the same actuator makes it so short that the next
# slip is too small to reach the velocity of the table again: sticks are less than half as many, and the share of the
# time halves, for a quarter more of normal force.

# %% [markdown]
# ## Derivatives by the gains
# Which way should one turn the gain and the lead? `ss.sensitivity` gives the derivatives of the mean stick share with
# their standard errors, right also where sticks appear and vanish; `ss.differentiable` is the mean stick share as a
# function to use in `jax.grad`. Differences of the same samples, two runs apart, are the judge, and give the
# derivatives of the cost.

# %%
at = np.array([0.3, 1.0])
system = Steered(gain=at[0], lead=at[1], foresight=1.0)
settings = {"t1": T1, "samples": SAMPLES, "key": jax.random.key(3), "y0": Y0}
found = ss.sensitivity(ss.stick_fraction, system, law, wrt=("gain", "lead"), **settings)
print(found)
share = ss.differentiable(ss.stick_fraction, system, law, wrt=("gain", "lead"), **settings)
slopes = jax.jit(jax.jacfwd(share))(at)
print(f"differentiable: by the gain {slopes[0]:.4f}, by the lead {slopes[1]:.4f} 1/s")

# %%
STEPS = (0.02, 0.1)


def sides(which):
    """Outcomes a step above and a step below."""
    step = np.eye(2)[which] * STEPS[which]
    return steered(*(at + step), 1.0), steered(*(at - step), 1.0)


differences = [mean((up - down) / (2 * step)) for (up, down), step in zip(map(sides, (0, 1)), STEPS, strict=True)]
for name, own, (difference, error) in zip(("gain", "lead"), found.values(), differences, strict=True):
    apart = abs(own.derivative - difference[0]) / np.hypot(own.standard_error, error[0])
    print(f"by the {name}: {own.derivative:+.4f} +- {own.standard_error:.4f}, by differences {difference[0]:+.4f} +- "
          f"{error[0]:.4f}: {apart:.1f} standard errors apart")  # fmt: skip
    print(f"  and the cost: {difference[2]:+.4f} +- {error[2]:.4f}")
