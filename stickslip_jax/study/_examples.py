"""Examples of studies to start from, by name: what differs from the default study."""

import math
from collections.abc import Mapping
from typing import Any

_BUILDING, _PERIOD, _GRAVITY = 2.0e5, 2.5, 9.81  # kg; s, natural period on its isolators; m/s^2

EXAMPLES: dict[str, Mapping[str, Any]] = {
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
}
"""A mass on an oscillating base; a building sliding on its isolators in an earthquake; the motor and cart."""
