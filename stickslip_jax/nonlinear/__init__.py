"""Nonlinear dynamics with sticks: sections, bifurcation diagrams, basins, periodic orbits, Lyapunov exponents."""

from ._basins import basins
from ._bifurcation import bifurcation_diagram
from ._branch_points import BranchEvent
from ._continuation import OrbitBranch, continue_orbit
from ._event_sections import Crossing, event_section
from ._lyapunov import lyapunov_exponents
from ._modes import Mode
from ._orbits import PeriodicOrbit, periodic_orbit
from ._stroboscopic import stroboscopic_section

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
