"""Sensitivities while the base's first segment lasts: what has a density there counts, and nothing else.

All samples begin in the same state. Short motions, so that the first segment decides about most sticks.
"""

import math
from typing import Annotated

import jax
import jax.numpy as jnp
import pytest

import stickslip_jax as ss

AGREE = 4.0  # combined standard errors: passed by chance once in 16,000 independent comparisons
GAP = ss.Weibull(1.0, 1.5)
RECORDED = ss.StickFunctional(lambda sticks: jnp.sum(sticks.mask), "number")


class Ramps(ss.SegmentLaw):
    """A base that starts from rest with a random acceleration."""

    speed: Annotated[float, ss.Quantity("m/s", above=0)]
    rate: Annotated[float, ss.Quantity("1/s", above=0)]
    is_random = True
    jumps = False

    def segments(self, t1):
        mean = self.rate * t1
        return math.ceil(mean + 6 * math.sqrt(mean) + 12)

    def begin(self, key_data, dtype):
        return jnp.zeros((), dtype)

    def draw(self, key_data, number, dtype):
        u, v = self.uniforms(key_data, number, dtype)
        return ss.Exponential(1 / self.rate).icdf(u), ss.Uniform(-self.speed, self.speed).icdf(v)

    def next_segment(self, memory, drawn, dtype):
        duration, velocity = drawn
        return duration, memory, (velocity - memory) / duration, velocity


class OwnSwitching(ss.PoissonSwitching):
    """The same, but for all that the package knows about it."""

    def draw(self, key_data, number, dtype):
        return super().draw(key_data, number, dtype)


def system(damping=0.0):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(4 / 2.8), damping=damping)


def switching(speed=1.0):
    return ss.SemiMarkovSwitching(GAP, speed, first_sign="positive")


CASES = {
    "gap": (system(), switching(), (-0.3, -0.2)),
    "speed": (system(), switching(ss.Uniform(0.6, 1.4)), (-0.3, -0.2)),
    "gap, in steps": (system(0.02), switching(), (-0.3, -0.2)),
    "speed, in steps": (system(0.02), switching(ss.Uniform(0.6, 1.4)), (-0.3, -0.2)),
    "ramps": (system(0.02), Ramps(2.0, 0.5), (0.1, 0.9)),
    "harmonic and jumps": (system(), ss.WithJumps(ss.Harmonic(0.1, 1.0), switching()), (-0.3, -0.2)),
}
IN_STEPS = set(CASES) - {"gap", "speed"}


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.slow] * (one in IN_STEPS)) for one in CASES])
def test_count(name):
    """Counted and recorded sticks against differences of other samples."""
    oscillator, law, y0 = CASES[name]
    samples = 16_384 if name in IN_STEPS else 32_768
    options = {"wrt": "mu", "t1": 1.0, "y0": y0}
    differences = ss.sensitivity(
        ss.mean_stick_count, oscillator, law, samples=4 * samples, key=jax.random.key(2), step=0.01,
        estimator="finite-difference", **options,
    )  # fmt: skip
    for statistic in (ss.mean_stick_count, RECORDED):
        found = ss.sensitivity(
            statistic, oscillator, law, samples=samples, key=jax.random.key(1), estimator="corrected",
            **options,
        )  # fmt: skip
        error = math.hypot(found.standard_error, differences.standard_error)
        assert abs(found.derivative - differences.derivative) < AGREE * error, statistic
        # What the first segment decides is more than the bound.
        assert abs(found.derivative) > AGREE * error, statistic


def test_first_arc_without_density():
    """A first arc that misses the base velocity by 0.2 % does so in all samples, and changes no derivative.

    The law's first velocity is always the same, also where only its draws tell so.
    """
    options = {"wrt": "mu", "samples": 16_384, "t1": 2.0, "y0": (-0.142, 0.0), "estimator": "corrected"}
    found = [
        ss.sensitivity(ss.mean_stick_count, system(), law(1.0, 1.0, "positive"), key=jax.random.key(seed), **options)
        for law, seed in ((ss.PoissonSwitching, 1), (OwnSwitching, 2))
    ]
    differences = ss.sensitivity(
        ss.mean_stick_count, system(), ss.PoissonSwitching(1.0, 1.0, "positive"), key=jax.random.key(3), step=0.001,
        **options | {"estimator": "finite-difference", "samples": 262_144},
    )  # fmt: skip
    for one in found:
        error = math.hypot(one.standard_error, differences.standard_error)
        assert abs(one.derivative - differences.derivative) < AGREE * error
