"""The public names, and the modules that define them, as in `stickslip_jax/__init__.pyi`."""

from .._systems.system import (
    Belt as Belt,
)
from .._systems.system import (
    Body as Body,
)
from .._systems.system import (
    Disk as Disk,
)
from .._systems.system import (
    Look as Look,
)
from .._systems.system import (
    Mechanism as Mechanism,
)
from .._systems.system import (
    Rod as Rod,
)
from .._systems.system import (
    Spring as Spring,
)
from ._animations import Animation as Animation
from ._animations import animate as animate
from ._ensembles import (
    convergence as convergence,
)
from ._ensembles import (
    histogram as histogram,
)
from ._ensembles import (
    joint_histogram as joint_histogram,
)
from ._ensembles import (
    means_by_order as means_by_order,
)
from ._ensembles import (
    stick_bounds as stick_bounds,
)
from ._ensembles import (
    stick_map as stick_map,
)
from ._ensembles import (
    stick_raster as stick_raster,
)
from ._parameters import (
    curve as curve,
)
from ._parameters import (
    parameter_map as parameter_map,
)
from ._parameters import (
    parameter_sweep as parameter_sweep,
)
from ._parameters import (
    stick_fraction_curve as stick_fraction_curve,
)
from ._sections import (
    basins as basins,
)
from ._sections import (
    bifurcation_diagram as bifurcation_diagram,
)
from ._sections import (
    orbit_branch as orbit_branch,
)
from ._sections import (
    section as section,
)
from ._sensitivities import (
    calibration as calibration,
)
from ._sensitivities import (
    calibration_moments as calibration_moments,
)
from ._sensitivities import (
    sensitivity_curve as sensitivity_curve,
)
from ._sensitivities import (
    tornado as tornado,
)
from ._style import save as save
from ._trajectory import energies as energies
from ._trajectory import phase_portrait as phase_portrait
from ._trajectory import time_history as time_history
