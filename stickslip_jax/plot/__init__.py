"""Figures of results. Each function takes what was simulated, draws it, and returns the matplotlib axes.

Nothing here simulates. A figure is made only where no `ax` is given; it shows or is saved by the caller:
``phase_portrait(one).figure.savefig("portrait.pdf")``. Legends stand above the axes; give titles to the figure.
"""

from ._convergences import convergence
from ._distributions import histogram
from ._durations import stick_durations
from ._fraction_curves import stick_fraction_curve
from ._histories import time_history
from ._joint_distributions import joint_histogram
from ._orders import means_by_order
from ._parameter_maps import parameter_map
from ._portraits import phase_portrait
from ._rasters import stick_raster
from ._saving import save
from ._sensitivity import sensitivity_curve, tornado
from ._shares import stick_share
from ._stick_maps import stick_joint_histogram, stick_map

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
