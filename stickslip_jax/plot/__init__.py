"""Figures of simulations, of ensembles and of their statistics. Each function draws one and returns its axes.

All functions are called alike:

- The first argument is the result to draw: a `Simulation`, an `Ensemble`, or what was computed from one, such as a
  distribution. A curve or a map over parameters takes the values of the parameters first, then what was found there
  (`sensitivity_curve` only the latter, since a `Sensitivity` knows the value of its parameter).
- `ax` (one matplotlib Axes) or `axes` (several) says where to draw. It is the last argument, given by keyword. Without
  it, a new figure is made.
- The axes are returned: one, or a tuple of several. ``phase_portrait(one).figure.savefig("portrait.pdf")`` writes
  their figure to a file; so does `save`, which also closes it.
- Legends stand above the axes, so give titles to the figure (``figure.suptitle``), not to the axes.

`animate` makes a film, with a figure of its own, and returns an `Animation`. `Mechanism` and what it is made of say
how a system of your own moves in it.

Nothing is simulated here. Bad arguments raise ValueError with the name of the argument.
"""

from .._systems.mechanism import Belt, Body, Disk, Mechanism, Rod, Spring
from ._animations import Animation, animate
from ._basins import basins
from ._bounds import stick_bounds
from ._branches import orbit_branch
from ._calibration_moments import calibration_moments
from ._calibrations import calibration
from ._convergences import convergence
from ._curves import curve
from ._energies import energies
from ._histograms import histogram
from ._histories import time_history
from ._joint_histograms import joint_histogram
from ._orders import means_by_order
from ._parameter_maps import parameter_map
from ._parameter_sweeps import parameter_sweep
from ._portraits import phase_portrait
from ._rasters import stick_raster
from ._saving import save
from ._sections import bifurcation_diagram, section
from ._sensitivities import sensitivity_curve, tornado
from ._stick_fraction_curves import stick_fraction_curve
from ._stick_maps import stick_map

__all__ = [
    "Animation",
    "Belt",
    "Body",
    "Disk",
    "Mechanism",
    "Rod",
    "Spring",
    "animate",
    "basins",
    "bifurcation_diagram",
    "calibration",
    "calibration_moments",
    "convergence",
    "curve",
    "energies",
    "histogram",
    "joint_histogram",
    "means_by_order",
    "orbit_branch",
    "parameter_map",
    "parameter_sweep",
    "phase_portrait",
    "save",
    "section",
    "sensitivity_curve",
    "stick_bounds",
    "stick_fraction_curve",
    "stick_map",
    "stick_raster",
    "time_history",
    "tornado",
]
