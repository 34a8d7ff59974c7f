"""Sensitivities while the base's first segment lasts: what has a density there counts, and nothing else.

All samples begin in the same state. Short motions, so that the first segment decides about most sticks.
"""

import math

import jax
import jax.numpy as jnp
import pytest
from support.segments import documented_law

import stickslip_jax as ss

AGREE = 4.0  # combined standard errors: passed by chance once in 16,000 independent comparisons
GAP = ss.Weibull(1.0, 1.5)
Ramps, _, _ = documented_law()  # from rest, with a random acceleration
RECORDED = ss.StickFunctional(lambda sticks: jnp.sum(sticks.mask), "number")


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("statistic", [ss.mean_stick_count, RECORDED], ids=["counted", "recorded"])
def test_first_end_without_density(statistic):
    """All first segments end at multiples of one interval: one that ends just after the arrival has no part in the
    derivative, one that ends with it leaves none.
    """
    arrival = float(ss.simulate(system(), ss.Constant(1.0), t1=2.0, y0=(-0.3, -0.2)).sticks.start[0])
    options = {"wrt": "mu", "samples": 4_096, "key": jax.random.key(1), "t1": 0.9, "y0": (-0.3, -0.2)}
    with pytest.warns(RuntimeWarning, match="rests on 0 sticks only"):
        after = ss.sensitivity(
            statistic, system(), ss.RandomSteps(1.0, 1.002 * arrival), estimator="corrected", **options
        )
    assert (after.derivative, after.sticks_in_window) == (0, 0)
    assert after.value > 0.4  # half of the bases begin forwards
    with pytest.warns(RuntimeWarning, match="No two windows agree"):
        at_once = ss.sensitivity(statistic, system(), ss.RandomSteps(1.0, arrival), estimator="corrected", **options)
    assert math.isnan(at_once.standard_error)
