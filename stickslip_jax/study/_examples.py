"""Studies and sweeps to start from, by name: what differs from the defaults."""

import math
from collections.abc import Mapping

from .. import papers

_BUILDING, _PERIOD, _GRAVITY = 2.0e5, 2.5, 9.81  # kg; s, natural period on its isolators; m/s^2

EXAMPLES: dict[str, Mapping[str, Mapping[str, object]]] = {
    "harmonic-base": {
        "system": {"friction": {"law": "Stribeck", "mu": 0.3, "mu_static": 0.5, "stribeck_speed": 0.2}},
        "base": {"law": "Harmonic", "amplitude": 0.5, "angular_frequency": 0.8, "offset": 0.2},
        "run": {"t1": 100.0, "samples": 1000, "initial_velocity": 0.0},
        "output": {"directory": "results/harmonic-base"},
    },
    "base-isolation": {
        "system": {
            "mass": _BUILDING,
            "stiffness": float(f"{_BUILDING * (2 * math.pi / _PERIOD) ** 2:.4g}"),
            "normal_force": float(f"{_BUILDING * _GRAVITY:.4g}"),
            "damping": 2.0e4,
            "friction": {"law": "Coulomb", "mu": 0.05, "mu_static": 0.07},
        },
        "base": {"law": "KanaiTajimi", "rms": 1.5},
        "run": {"t1": 30.0, "samples": 1000, "initial_velocity": 0.0},
        "output": {"directory": "results/base-isolation"},
    },
    "motor-cart": {"system": {"model": "MotorCart"}, "output": {"directory": "results/motor-cart"}},
    "two-blocks": {
        "system": {
            "model": "LinearStructure",
            "mass": [1.0, 1.0],
            "stiffness": [[2.2, -1.2], [-1.2, 2.2]],
            "contact": 0,
            "contacts": [
                {"mass": mass, "normal_force": force, "friction": {"law": "Coulomb", "mu": 0.8, "mu_static": 1.0}}
                for mass, force in enumerate((1.0, 1.3))
            ],
        },
        "base": {"law": "PoissonSwitching", "speed": 0.3, "rate": 0.5},
        "run": {"t1": 60.0, "samples": 1000, "initial_state": [{"low": -0.5, "high": 0.5}, 0.0, 0.0, 0.0]},
        "output": {"directory": "results/two-blocks"},
    },
}
"""A mass on an oscillating base; a building sliding on its isolators in an earthquake; the motor and cart; two blocks
joined by a spring on a base that switches.
"""


def _share(
    law: Mapping[str, object], samples: int = 1, keep: str = "totals", *, swept: bool = True
) -> dict[str, Mapping[str, object]]:
    over = {"mu": {"linspace": list(papers.SHARE_FRICTIONS)}}
    if swept:
        over["r"] = {"linspace": list(papers.SHARE_RATIOS)}
    return {
        "base": law,
        "run": {"samples": samples},
        "sweep": {"keep": keep, "statistics": ["stick_fraction"], "over": over},
    }


PAPERS: dict[str, Mapping[str, Mapping[str, object]]] = {
    "parametric-analysis": {
        "sweep": {
            "over": {
                "mu": {"linspace": list(papers.ANALYSIS_FRICTIONS)},
                "rate": {"logspace": list(papers.ANALYSIS_RATES)},
            }
        }
    },
    "stick-share-constant": _share({"law": "Constant", "speed": 1.0}, swept=False),
    "stick-share-square": _share({"law": "SquareWave", "speed": 1.0, "period": math.pi}),
    "stick-share-harmonic": _share({"law": "Harmonic", "amplitude": 1.0, "angular_frequency": 2.0, "phase": 0.0}),
    "stick-share-random": _share(
        {"law": "RandomSteps", "speed": 1.0, "interval": math.pi}, papers.SHARE_SAMPLES, "statistics"
    ),
}
"""The sweeps of `papers.parametric_analysis` and `papers.stick_share_map` as files."""
