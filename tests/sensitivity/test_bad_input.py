"""What `sensitivity` refuses, and says."""

from functools import partial

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._sensitivity.problem import problem_of, require_correctable

OSCILLATOR = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.4))

BAD = {
    "statistic": ({"statistic": "mean"}, "Argument statistic must be"),
    "wrt": ({"wrt": "muu"}, "Argument wrt must name one of .*system.friction.mu"),
    "wrt, nothing": ({"wrt": ()}, "Argument wrt must be a parameter's name"),
    "wrt, not set": ({"wrt": "damping"}, "Argument wrt must name numbers that are set"),
    "wrt, ambiguous": (
        {"wrt": "amplitude", "law": ss.WithJumps(ss.Harmonic(1.0, 1.3), ss.PoissonSwitching(1.0, 1.0)),
         "system": ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.4), force=ss.Harmonic(0.1, 0.7))},
        "Argument wrt must be unambiguous",
    ),
    "estimator": ({"estimator": "naive"}, "Argument estimator must be one of"),
    "step": ({"step": 0.0}, "Argument step must be positive"),
    "relative_bandwidth": ({"relative_bandwidth": -1.0}, "Argument relative_bandwidth must be positive"),
    "step and bandwidth": (
        {"step": 0.01, "relative_bandwidth": 0.01},
        "Argument step must be left out with relative_bandwidth, but step=0.01 and",
    ),
    "step, not used": (
        {"step": 0.01, "estimator": "corrected"}, "Argument step must be left out with estimator='corrected'"
    ),
    "bandwidth, not used": (
        {"relative_bandwidth": 0.01, "estimator": "finite-difference"},
        "Argument relative_bandwidth must be left out with estimator='finite-diff",
    ),
    "elasticity": ({"elasticity": 1}, "Argument elasticity must be True or False"),
    "samples": ({"samples": 1}, "Argument samples must be a whole number of at least 2"),
    "method": ({"method": "exact"}, "Argument method must be Exact"),
    "system": ({"system": 3}, "Argument system must be"),
    "bandwidth, static friction": (
        {"system": ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9, mu_static=0.9)), "wrt": "mu_static"},
        "Argument step .or relative_bandwidth. must be smaller: mu_static = 0.9 .* must be at least mu",
    ),
    "bandwidth, static friction, corrected": (
        {"system": ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.9, mu_static=0.9)), "wrt": "mu_static",
         "estimator": "corrected"},
        "Argument step .or relative_bandwidth. must be smaller: mu_static = 0.9 .* must be at least mu",
    ),
    "step, a negative rate": (
        {"wrt": "rate", "estimator": "finite-difference", "step": 1.5},
        "must be smaller: rate = 1 .* Argument rate must",
    ),
    "nothing random": ({"law": ss.SquareWave(1.0, 2.0)}, "Argument law must be random"),
    "key": ({"key": None}, "Argument key must be"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input(name):
    wrong, message = BAD[name]
    given = {
        "statistic": ss.mean_stick_count, "system": OSCILLATOR, "law": ss.PoissonSwitching(1.0, 1.0), "wrt": "mu",
        "t1": 5.0, "samples": 64, "key": jax.random.key(0),
    } | wrong  # fmt: skip
    with pytest.raises(ValueError, match=message):
        ss.sensitivity(given.pop("statistic"), given.pop("system"), given.pop("law"), **given)


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("build", [lambda: ss.StickDuration(0), lambda: ss.StickStart(1.5)])
def test_bad_stick_number(build):
    with pytest.raises(ValueError, match="Argument number must be a whole number of at least 1"):
        build()


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_functional():
    with pytest.raises(ValueError, match="Argument function must be a function of a StickSequence"):
        ss.StickFunctional(3)


def test_motion_in_steps_needs_double_precision():
    """Asked of the problem itself: nothing is compiled for that."""
    key, law = jax.random.key(0), ss.PoissonSwitching(1.0, 1.0)
    problem, _ = problem_of(ss.mean_stick_count, OSCILLATOR, law, "mu", 5.0, 64, key, None)
    damped = problem._replace(system=ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.4), damping=0.1))
    single = np.dtype(np.float32)
    require_correctable(damped)
    require_correctable(problem._replace(dtype=single))
    with pytest.raises(ValueError, match=r"must be a MassSpring without damping .* single precision"):
        require_correctable(damped._replace(dtype=single))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
def test_single_precision_is_refused_where_it_hides_near_misses():
    options = {"wrt": "mu", "t1": 5.0, "samples": 64, "key": jax.random.key(0)}
    law, damped = ss.PoissonSwitching(1.0, 1.0), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.4), damping=0.1)
    with jax.enable_x64(False):
        for call in (partial(ss.sensitivity, estimator="corrected"), ss.differentiable):
            with pytest.raises(ValueError, match=r"must be a MassSpring without damping .* single precision"):
                call(ss.mean_stick_count, damped, law, **options)
        assert ss.sensitivity(ss.mean_stick_count, damped, law, **options).estimator == "finite-difference"
