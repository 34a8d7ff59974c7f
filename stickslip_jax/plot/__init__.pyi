"""The public names, and the modules that define them, as in `stickslip_jax/__init__.pyi`."""

from .._systems.system import (
    Belt as Belt,
    Body as Body,
    Disk as Disk,
    Look as Look,
    Mechanism as Mechanism,
    Rod as Rod,
    Spring as Spring,
)
from ._animations import Animation as Animation, animate as animate
from ._ensembles import (
    convergence as convergence,
    histogram as histogram,
    joint_histogram as joint_histogram,
    means_by_order as means_by_order,
    stick_bounds as stick_bounds,
    stick_map as stick_map,
    stick_raster as stick_raster,
)
from ._parameters import (
    curve as curve,
    histograms as histograms,
    parameter_map as parameter_map,
    parameter_sweep as parameter_sweep,
    stick_fraction_curve as stick_fraction_curve,
)
from ._sections import (
    basins as basins,
    bifurcation_diagram as bifurcation_diagram,
    orbit_branch as orbit_branch,
    section as section,
)
from ._sensitivities import (
    calibration as calibration,
    calibration_moments as calibration_moments,
    sensitivity_curve as sensitivity_curve,
    sobol_indices as sobol_indices,
    tornado as tornado,
)
from ._style import save as save
from ._systems import (
    friction_law as friction_law,
    mechanism as mechanism,
    newmark_displacements as newmark_displacements,
)
from ._trajectory import (
    energies as energies,
    friction_force as friction_force,
    phase_portrait as phase_portrait,
    time_history as time_history,
)
