"""The public names, and the modules that define them, as in `stickslip_jax/__init__.pyi`."""

from ._basins import basins as basins
from ._continuation import BranchEvent as BranchEvent, OrbitBranch as OrbitBranch, continue_orbit as continue_orbit
from ._orbits import Mode as Mode, PeriodicOrbit as PeriodicOrbit, periodic_orbit as periodic_orbit
from ._sections import (
    Crossing as Crossing,
    bifurcation_diagram as bifurcation_diagram,
    event_section as event_section,
    stroboscopic_section as stroboscopic_section,
)
from ._stability import (
    Equilibrium as Equilibrium,
    equilibrium as equilibrium,
    lyapunov_exponents as lyapunov_exponents,
    stability_map as stability_map,
)
