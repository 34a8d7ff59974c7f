"""Nonlinear dynamics with sticks: sections, bifurcation diagrams, basins, periodic orbits, Lyapunov exponents."""

from ._basins import basins
from ._continuation import BranchEvent, OrbitBranch, continue_orbit
from ._lyapunov import lyapunov_exponents
from ._orbits import Mode, PeriodicOrbit, periodic_orbit
from ._sections import Crossing, bifurcation_diagram, event_section, stroboscopic_section

__all__ = [
    "BranchEvent",
    "Crossing",
    "Mode",
    "OrbitBranch",
    "PeriodicOrbit",
    "basins",
    "bifurcation_diagram",
    "continue_orbit",
    "event_section",
    "lyapunov_exponents",
    "periodic_orbit",
    "stroboscopic_section",
]
