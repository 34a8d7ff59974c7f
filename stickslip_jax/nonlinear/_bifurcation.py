"""Bifurcation diagrams: what motions settle on, over the values of parameters."""

from typing import TYPE_CHECKING, Any, Literal, get_args

from .. import _checks
from .._dynamics.common.method import EXACT, Exact
from .._excitation.excitation import BaseMotion
from .._systems.system import System
from .._types import Scalar
from ._cases import Over, cases_of
from ._following import follow, follow_along
from ._recurrence import RECURS
from ._settling import checked_periods, settled
from ._stored import Folder, kept_in
from ._stroboscopic import section_of
from ._warnings import warn_of_unfinished

if TYPE_CHECKING:
    import xarray

Follow = Literal["start", "up", "down", "both"]
DIRECTION = "direction"


def bifurcation_diagram(
    system: System,
    base: BaseMotion,
    over: Over,
    *,
    follow_attractor: Follow = "start",
    y0: Any = None,
    transient: int = 200,
    kept: int = 100,
    longest_transient: int | None = None,
    period: Scalar | None = None,
    tolerance: float = RECURS,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> "xarray.Dataset":
    """States once a period over the values of parameters, from the same starts or following the attractor.

    Args:
        system: As in `stroboscopic_section`.
        base: As in `stroboscopic_section`.
        over: As in `stroboscopic_section`.
        follow_attractor: "start": each value from `y0`. "up" or "down": each value of the first parameter, in the order
            in which they are given or backwards, from where the motion of the one before ended; "both", with a further
            dimension "direction": where two attractors are, a hysteresis shows.
        y0: As in `stroboscopic_section`.
        transient: As in `stroboscopic_section`.
        kept: As in `stroboscopic_section`.
        longest_transient: As in `stroboscopic_section`; where an attractor is followed, the next value begins from
            where a motion was before it went on.
        period: As in `stroboscopic_section`.
        tolerance: As in `stroboscopic_section`.
        method: `Exact`.
        progress: As in `simulate_ensemble`.
        folder: As in `stroboscopic_section`.

    Returns:
        As `stroboscopic_section`. Warns likewise; where an attractor is followed, a motion that was not followed to the
        end is begun anew from `y0` at the next value.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.
    """
    lasted = transient, kept, _ = checked_periods(transient, kept, longest_transient)
    _checks.positive("tolerance", tolerance)
    _checks.chosen("follow_attractor", follow_attractor, get_args(Follow))
    cases = cases_of(system, base, y0, over, period, method)
    what = {"function": "bifurcation_diagram", "transient": transient, "kept": kept}
    with kept_in(folder, cases, what) as stored:
        if follow_attractor == "start":
            seen = {"start": follow(cases, transient, kept, progress, stored)}
        else:
            directions = ("up", "down") if follow_attractor == "both" else (follow_attractor,)
            seen = {
                one: follow_along(cases, transient, kept, progress, stored, descending=one == "down")
                for one in directions
            }
        every = [settled(cases, one, lasted, float(tolerance), progress, stored, stacklevel=3) for one in seen.values()]
    for one in every:
        warn_of_unfinished(one[0].status, stacklevel=3)
    found = [section_of(cases, *one, transient) for one in every]
    if len(found) == 1:
        return found[0]
    import xarray as xr  # noqa: PLC0415 - an extra, which was there to make the parts

    directions = xr.DataArray(list(seen), dims=DIRECTION, name=DIRECTION, attrs={"long_name": "direction"})
    return xr.concat(found, directions, combine_attrs="override")
