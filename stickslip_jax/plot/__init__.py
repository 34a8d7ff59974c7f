"""Figures of results. Each function takes what was simulated, draws it, and returns the matplotlib axes.

Nothing here simulates. A figure is made only where no `ax` is given; it shows or is saved by the caller:
``phase_portrait(one).figure.savefig("portrait.pdf")``. Legends stand above the axes; give titles to the figure.
"""

from .convergences import convergence
from .distributions import histogram
from .durations import stick_durations
from .fraction_curves import stick_fraction_curve
from .histories import time_history
from .joint_distributions import joint_histogram
from .orders import means_by_order
from .parameter_maps import parameter_map
from .portraits import phase_portrait
from .rasters import stick_raster
from .saving import save
from .sensitivity import sensitivity_curve, tornado
from .shares import stick_share
from .stick_maps import stick_joint_histogram, stick_map

__all__ = [
    "convergence",
    "histogram",
    "joint_histogram",
    "means_by_order",
    "parameter_map",
    "phase_portrait",
    "save",
    "sensitivity_curve",
    "stick_durations",
    "stick_fraction_curve",
    "stick_joint_histogram",
    "stick_map",
    "stick_raster",
    "stick_share",
    "time_history",
    "tornado",
]
