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
# # Measured friction: a law fitted to a test rig's loops
#
# A friction damper is moved to and fro by a test rig, and its force is measured. Which law has that force, with which
# numbers, and how well are these known? `python notebooks/measured_friction.py FOLDER [FURTHER FILES]` fits one law to
# all files of a folder together and predicts the further ones with the fitted numbers. The files are tables (csv) with
# one line of names, and the columns time (s), displacement (m), velocity (m/s), force (N). Without a folder it makes
# records of its own by a law that is known, with noise, and recovers its numbers.

# %%
import os
import sys
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optimistix
from jax import lax
from scipy.interpolate import CubicSpline

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

GIVEN = [Path(name) for name in sys.argv[1:]] if Path(sys.argv[0]).name == "measured_friction.py" else []
SAMPLES = int(os.environ.get("STICKSLIP_NOTEBOOK_SAMPLES", "1000"))
SUBSTEPS = 4  # between two points of a record

# %% [markdown]
# ## The law
#
# Rotary dampers have a band around a drum. With little force the band is slack, and hardly resists (the backlash); it
# stiffens as it is pulled tight, and then it slips on the drum. So there is a spring in front of the contact whose
# force grows with the cube of its deflection u, and the contact slips at limits
#
# - that differ between the directions: the drum tightens the band in one and loosens it in the other;
# - that fall with the speed;
# - that grow while the slip goes on, with the distance slipped since the last reversal (q goes from -1 to 1).
#
# Moving parts of a mass M add ``M x''``. (In records of rigs that yield to the force this is more than a mass: it also
# carries the ringing of the rig.)


# %%
class Band(eqx.Module):
    """A contact behind a hardening spring; all numbers in SI units."""

    stiffness_forward: float  # N/m^3
    stiffness_backward: float
    limit_forward: float  # N, in the middle of a reversal, at rest
    limit_backward: float
    start: float  # deflection of the spring at the first point, m
    weakening: float  # s/m
    growth: float  # of the limits, as a share of them
    growth_length: float  # m
    mass: float  # kg

    def force(self, record):
        """The force along a record, (points,)."""

        def moved(state, motion):
            for step, speed in zip(*motion, strict=True):
                state = self._moved(*state, step, speed)
            return state, self._pull(state[0])

        start = (jnp.asarray(self.start), jnp.zeros(()))
        _, forces = lax.scan(moved, start, (record.steps, record.speeds))
        return jnp.append(self._pull(start[0]), forces) + self.mass * record.acceleration

    def _pull(self, u):
        """The force of the spring."""
        return jnp.where(u > 0, self.stiffness_forward, self.stiffness_backward) * u**3

    def _moved(self, u, q, step, speed):
        """Deflection and slip memory after a small step of the displacement."""
        weaker = jnp.maximum(0.2, 1 - self.weakening * speed)
        most = jnp.cbrt(self.limit_forward * weaker * (1 + self.growth * q) / self.stiffness_forward)
        least = -jnp.cbrt(self.limit_backward * weaker * (1 - self.growth * q) / self.stiffness_backward)
        u = u + step
        slipped = jnp.where(step > 0, jnp.maximum(u - most, 0), jnp.minimum(u - least, 0))
        towards = jnp.where(step > 0, 1, -1)
        return u - slipped, q + (towards - q) * -jnp.expm1(-jnp.abs(slipped) / self.growth_length)


class Record(NamedTuple):
    """A record, and its displacement in small steps between the points, by a cubic spline."""

    times: np.ndarray
    position: np.ndarray
    force: np.ndarray
    acceleration: np.ndarray
    steps: np.ndarray  # (points - 1, SUBSTEPS)
    speeds: np.ndarray

    @classmethod
    def of(cls, times, position, force):
        spline = CubicSpline(times, position)
        fine = np.linspace(times[:-1], times[1:], SUBSTEPS + 1, axis=1)
        acceleration = np.gradient(np.gradient(position, times), times)
        return cls(times, position, force, acceleration, np.diff(spline(fine), axis=1), np.abs(spline(fine[:, :-1], 1)))

    @classmethod
    def from_file(cls, path):
        times, position, _, force = np.loadtxt(path, delimiter=",", skiprows=1).T
        return cls.of(times, position, force)


# %% [markdown]
# ## The records


# %%
KNOWN = Band(4e11, 1.5e11, 1e4, 1.5e4, -1e-3, 0.8, 0.3, 3e-3, 500.0)


class Turning(Band):
    """The same law up to 0.08 m/s; at higher speeds the limits rise again, half as steeply as they fell."""

    def _moved(self, u, q, step, speed):
        return super()._moved(u, q, step, jnp.minimum(speed, 0.08 - 0.5 * (speed - 0.08)))


def made(frequency, amplitude, key, law=KNOWN):
    """A record of a law that is known, with noise of 2 % of the largest force."""
    duration = max(1.5, min(4.0, SAMPLES / 250)) / frequency
    times = np.arange(0, duration, 1 / 256)
    grows = np.minimum(1, frequency * times)
    record = Record.of(times, amplitude * grows * np.sin(2 * np.pi * frequency * times), np.zeros_like(times))
    force = np.asarray(law.force(record))
    return record._replace(
        force=force + 0.02 * np.max(np.abs(force)) * np.random.default_rng(key).normal(size=len(times))
    )


if GIVEN:
    paths = sorted(GIVEN[0].glob("*.csv"))
    records = {path.stem: Record.from_file(path) for path in paths}
    further = {path.stem: Record.from_file(path) for path in GIVEN[1:]}
else:
    records = {f"{f:g} Hz, {1e3 * a:g} mm": made(f, a, key) for key, (f, a) in enumerate([(0.5, 0.025), (1.0, 0.012)])}
    further = {
        "2 Hz, 12 mm": made(2.0, 0.012, 7),
        "2 Hz, 25 mm, turning": made(2.0, 0.025, 8, Turning(*vars(KNOWN).values())),
    }
print(f"{len(records)} records of {', '.join(str(len(one.times)) for one in records.values())} points")

# %% [markdown]
# ## The fit
#
# Least squares by the Levenberg-Marquardt method, each record's residuals in units of its root-mean-square force. The
# positive numbers are fitted by their logarithms.

# %%
FIRST = Band(1e12, 5e11, 1.2e4, 1.8e4, -1.5e-3, 0.5, 0.2, 5e-3, 1000.0)
SIGNED = ("start",)


def values_of(band):
    return jnp.array([value if name in SIGNED else np.log(value) for name, value in vars(band).items()])


def band_of(values):
    names = list(vars(FIRST))
    return Band(*(values[i] if name in SIGNED else jnp.exp(values[i]) for i, name in enumerate(names)))


def residuals(values, records):
    band = band_of(values)
    return jnp.concatenate([(band.force(one) - one.force) / jnp.sqrt(jnp.sum(one.force**2)) for one in records])


def fitted(records):
    solver = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
    options = {"jac": "fwd"}
    found = optimistix.least_squares(residuals, solver, values_of(FIRST), records, options=options, max_steps=300)
    return found.value


def errors(values, records):
    """The root-mean-square error of each record, over its root-mean-square force."""
    band = band_of(values)
    return [float(np.sqrt(np.mean((band.force(one) - one.force) ** 2) / np.mean(one.force**2))) for one in records]


values = fitted(list(records.values()))
plain = [
    float(np.sqrt(np.mean((one.force - level * np.sign(np.gradient(one.position))) ** 2) / np.mean(one.force**2)))
    for one in records.values()
    for level in [np.mean(one.force * np.sign(np.gradient(one.position)))]
]
for name, error, coulomb in zip(records, errors(values, list(records.values())), plain, strict=True):
    print(f"{name}: error {error:.3f} of the force (Coulomb friction with a level of its own: {coulomb:.2f})")

# %% [markdown]
# ## How well the numbers are known
#
# The residuals are no white noise: they last for half a cycle. So the standard errors come from sums over half cycles,
# which are taken as independent of each other (the "sandwich" of robust statistics); those for white residuals are
# several times smaller, and too small.


# %%
def half_cycles(record):
    """Which half cycle each point belongs to."""
    smooth = np.convolve(np.gradient(record.position), np.ones(17) / 17, mode="same")
    return np.cumsum(np.append(0, np.sign(smooth[1:]) != np.sign(smooth[:-1])))


@jax.jit
def slopes(values, records):
    return jax.jacfwd(residuals)(values, records)


listed = list(records.values())
matrix, left = np.asarray(slopes(values, listed)), np.asarray(residuals(values, listed))
parts = [half_cycles(one) for one in listed]
offsets = np.cumsum([0] + [part[-1] + 1 for part in parts[:-1]])
halves = np.concatenate([part + offset for part, offset in zip(parts, offsets, strict=True)])
scores = np.stack([matrix[halves == half].T @ left[halves == half] for half in np.unique(halves)])
inverse = np.linalg.inv(matrix.T @ matrix)
robust = np.sqrt(np.diag(inverse @ scores.T @ scores @ inverse))
white = np.sqrt(np.diag(inverse) * (left @ left) / (len(left) - len(values)))
band = band_of(values)
UNITS = ("N/m^3", "N/m^3", "N", "N", "m", "s/m", "", "m", "kg")
for (name, value), unit, error, naive in zip(vars(band).items(), UNITS, robust, white, strict=True):
    scale = 1.0 if name in SIGNED else abs(float(value))
    known = "" if GIVEN else f" (made with {getattr(KNOWN, name):.4g})"
    shown = f"{float(value):.4g} +- {scale * error:.2g} {unit}".rstrip()
    print(f"{name}: {shown} (white: {scale * naive:.1g}){known}")

# %% [markdown]
# ## Prediction
#
# Each record is predicted by a fit to the others, and further records by the fit to all. That is what to expect of a
# record that nobody has seen, as long as it is like those of the fit. A law says nothing of speeds and slip paths that
# the fit did not see: standard errors of its numbers are those of a right law. So each half cycle is asked how far its
# largest speed and its path are outside the range of those in the fit, as the logarithm of a factor, 0 inside.
#
# The band of 95 % around a prediction holds what the fit leaves; how much the numbers differ if one record is left out
# of the fit (the jackknife: with few records it says more than their standard errors); and, at speeds beyond those of
# the fit, how much the law changes from the fastest of these on, for it may change as it says, or not, or otherwise.
# A half cycle that is outside by a factor of e has twice the band. What is left is a factor for all: the largest that a
# left-out record needs for its own predicted force, since the next record may be like the worst of those known.

# %%
LEVEL, NORMAL = 0.95, 1.96


def sizes(record):
    """The logarithms of the largest speed and of the path of the half cycle of each point, (points, 2)."""
    which, speed = half_cycles(record), np.abs(np.gradient(record.position, record.times))
    whole = [which == half for half in range(which[-1] + 1)]
    largest = np.array([(speed[own].max(), np.ptp(record.position[own])) for own in whole])
    return np.log(np.maximum(largest, 1e-12))[which]


def outside(record, seen):
    """How far each point's half cycle is outside of the range of those in the records `seen`, (points, 2)."""
    known = np.concatenate([sizes(one) for one in seen])
    low, high = np.quantile(known, 0.02, axis=0), known.max(axis=0)  # the rig at rest is no half cycle
    return np.maximum(0, np.maximum(sizes(record) - high, low - sizes(record)))


force = jax.jit(lambda values, record: band_of(values).force(record))
without = [fitted([other for other in listed if other is not one]) for one in listed] if len(listed) > 1 else []


def prediction(values, seen, record):
    """The force along a record by a fit to the records `seen`, and its error in like records, and here, (points,)."""
    level = np.asarray(force(values, record))
    rest = np.mean(np.square(errors(values, seen))) * np.mean(level**2)
    others = np.stack([force(one, record) for one in without]) if without else level[None]
    fastest = max(np.max(one.speeds) for one in seen)
    change = level - np.asarray(force(values, record._replace(speeds=np.minimum(record.speeds, fastest))))
    wide = np.sqrt(rest + (len(others) - 1) * np.var(others, axis=0) + change**2)
    return level, np.sqrt(rest), wide * (1 + outside(record, seen).max(axis=1))


factor = NORMAL
for name, one, found in zip(records, listed, without, strict=False):  # none without a second record
    level, _, error = prediction(found, [other for other in listed if other is not one], one)
    needed = np.quantile(np.abs(one.force - level) / error, LEVEL)
    factor = max(factor, needed)
    print(f"{name}: error {errors(found, [one])[0]:.3f} when predicted from the others, band of {needed:.2f} errors")
print(f"the band has {factor:.2f} errors")


def about(name, one):
    """How far a record is outside, and how much of it the band holds, with and without what makes it wider there."""
    level, inner, error = prediction(values, listed, one)
    off, far = np.abs(one.force - level), outside(one, listed)
    share, (speed, path) = np.mean(far.max(axis=1) > 0), np.exp(far.max(axis=0))
    print(f"{name}: error {errors(values, [one])[0]:.3f} of the force, predicted with the fitted numbers")
    print(f"  {share:.0%} of it outside the range of the fit, by {speed:.1f} times in speed, {path:.1f} in slip path")
    held, plain = np.mean(off < factor * error), np.mean(off < NORMAL * inner)
    print(f"  the band of 95 % holds {held:.0%} of it ({plain:.0%} as wide as inside)")
    return factor * error


bands = {name: about(name, one) for name, one in further.items()}

# %% [markdown]
# ## Figures
#
# The loops, and what is left: where in time, and at which frequencies.

# %%
shown = records | further
figure, axes = plt.subplots(2, len(shown), figsize=(3.6 * len(shown), 6.4), layout="constrained", squeeze=False)
for column, (name, one) in zip(axes.T, shown.items(), strict=True):
    predicted = np.asarray(band.force(one))
    column[0].plot(1e3 * one.position, 1e-3 * one.force, lw=0.6, label="measured" if GIVEN else "made, with noise")
    column[0].plot(1e3 * one.position, 1e-3 * predicted, lw=0.9, label="law")
    column[0].set(xlabel="displacement (mm)", ylabel="force (kN)")
    column[0].set_title(name + (", predicted" if name in further else ""), fontsize=9)
    column[1].plot(one.times, 1e-3 * (one.force - predicted), lw=0.6)
    if name in bands:
        column[1].fill_between(one.times, -1e-3 * bands[name], 1e-3 * bands[name], color="0.85", label="band of 95 %")
        column[1].legend(fontsize=8, loc="upper left")
    column[1].set(xlabel="time (s)", ylabel="measured less law (kN)")
axes[0, 0].legend(fontsize=8, loc="upper left")
plt.show()

# %%
figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
for name, one in shown.items():
    rest = one.force - np.asarray(band.force(one))
    step = np.median(np.diff(one.times))
    frequencies = np.fft.rfftfreq(len(rest), step)
    power = np.abs(np.fft.rfft(rest)) ** 2 / np.sum(np.abs(np.fft.rfft(one.force)) ** 2)
    bands = [(0, 5), (5, 35), (35, 65), (65, np.inf)]
    shares = [np.sum(power[(frequencies >= low) & (frequencies < high)]) / np.sum(power) for low, high in bands]
    print(f"{name}: of the residual below 5 Hz {shares[0]:.0%}, to 35 Hz {shares[1]:.0%}, to 65 Hz {shares[2]:.0%}")
    smooth = np.convolve(power, np.ones(9) / 9, mode="same")
    ax.semilogy(frequencies, smooth, lw=0.9, label=name)
ax.set(xlabel="frequency (Hz)", ylabel="power of the residual,\nof that of the force", xlim=(0, 100))
ax.legend(fontsize=7)
plt.show()

# %% [markdown]
# ## A simpler law for comparison
#
# Coulomb friction that differs between the directions, behind a linear spring with a backlash, is exact and needs no
# integration: `Directional(...).force(..., series_stiffness=..., backlash=...)`. With the limits and stiffness of the
# law above it has the shape of the loops, without what grows, falls and rings.

# %%
one = listed[0]
load = float(band.limit_forward)
simple = ss.Directional(ss.Coulomb(1.0), ss.Coulomb(float(band.limit_backward) / load)).force(
    one.times,
    np.gradient(one.position, one.times),
    load,
    series_stiffness=3 * load / float(np.cbrt(load / band.stiffness_forward)),
    backlash=float(np.cbrt(load / band.stiffness_forward)),
)
error = float(np.sqrt(np.mean((simple - one.force) ** 2) / np.mean(one.force**2)))
print(f"{next(iter(records))}: error {error:.2f} by Coulomb friction behind a spring with backlash, not fitted")
