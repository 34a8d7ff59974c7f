"""The public names, and the modules that define them, as in `stickslip_jax/__init__.pyi`."""

from ._basins import basins as basins
from ._continuation import BranchEvent as BranchEvent
from ._continuation import OrbitBranch as OrbitBranch
from ._continuation import continue_orbit as continue_orbit
from ._lyapunov import lyapunov_exponents as lyapunov_exponents
from ._orbits import Mode as Mode
from ._orbits import PeriodicOrbit as PeriodicOrbit
from ._orbits import periodic_orbit as periodic_orbit
from ._sections import (
    Crossing as Crossing,
)
from ._sections import (
    bifurcation_diagram as bifurcation_diagram,
)
from ._sections import (
    event_section as event_section,
)
from ._sections import (
    stroboscopic_section as stroboscopic_section,
)
