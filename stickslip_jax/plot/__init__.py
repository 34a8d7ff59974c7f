"""Figures of results. Each function takes what was simulated, draws it, and returns the matplotlib axes.

Nothing here simulates. A figure is made only where no `ax` is given; it shows or is saved by the caller:
``phase_portrait(one).figure.savefig("portrait.pdf")``. Legends stand above the axes; give titles to the figure.
"""

from .durations import stick_durations
from .histories import time_history
from .portraits import phase_portrait
from .saving import save
from .sensitivity import sensitivity_curve, tornado
from .shares import stick_share
from .stick_maps import stick_joint_histogram, stick_map

__all__ = [
    "phase_portrait",
    "save",
    "sensitivity_curve",
    "stick_durations",
    "stick_joint_histogram",
    "stick_map",
    "stick_share",
    "time_history",
    "tornado",
]
