"""States once a period of the drive: stroboscopic sections, and the bifurcation diagrams that they make."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _checks
from .._conventions import Entries
from .._dynamics.common.method import EXACT, Exact
from .._excitation.excitation import BaseMotion
from .._systems.system import System
from .._types import Scalar
from ._cases import Cases, Over, cases_of
from ._following import Seen, follow
from ._labeled import CYCLE, dataset_of, on_grid, outcome_of, states_of
from ._recurrence import RECURS
from ._settling import checked_periods, settled
from ._stored import Folder, kept_in
from ._warnings import warn_of_unfinished

if TYPE_CHECKING:
    import xarray

CONTACT = "contact"


def stroboscopic_section(
    system: System,
    base: BaseMotion,
    *,
    y0: Any = None,
    over: Over | None = None,
    transient: int = 200,
    kept: int = 100,
    longest_transient: int | None = None,
    period: Scalar | None = None,
    tolerance: float = RECURS,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> "xarray.Dataset":
    """States once a period of what drives the system, after a transient: for many starts and parameters at once.

    Args:
        system: As in `simulate`, with any number of contacts.
        base: As in `simulate`; a motion that repeats itself.
        y0: The initial state, as in `simulate`; or many of them, an array (starts, coordinates).
        over: Values of parameters by name, as for `Sweep`: every combination is followed from every start.
        transient: Number of periods before the first that is kept, at least; 0 for motions as they begin.
        kept: Number of periods kept.
        longest_transient: Number of periods before the first that is kept, at most; by default 16 times `transient`.
            Motions that have not settled go on, twice as long each time.
        period: s; by default that after which all motions that drive the system repeat themselves together. A multiple
            of it may be given, and must be where none is known (a record, which then begins anew after it; a system of
            your own whose rates depend on time). Where nothing changes with time, any time after which to look.
        tolerance: Relative, within which a state counts as the same for the variable ``recurrence``.
        method: `Exact`.
        progress: As in `simulate_ensemble`.
        folder: Where what is done is kept, block after block; the same call goes on from there after an interrupt, or
            takes all from there, quickly. Without it nothing is kept.

    Returns:
        The numbers of the state at the end of each period kept, with dimensions of the parameters, "start" if there are
        several, and "cycle", the number of the period; likewise ``stick_time`` (s) in each period, ``stick_count``, the
        sticks that began in it, and ``longest_stick``, that ended in it or goes on (s, from its beginning), of each
        contact of a list. Of each case ``recurrence``, the number of periods after which the motion repeats itself, at
        most half of those kept (0: none is found; -1: the motion has not settled, its differences still fall or grow,
        and no stable orbit is near), ``more_periods``, for which it went on beyond `transient` until it had settled
        (add them to "cycle"), ``status`` and ``near_grazing_count``. Angles are between 0 and
        their period. A variable that is called as a parameter is has an underscore after its name. Warns
        (RuntimeWarning) of cases that were not followed to the end, and hold NaN from there on, and of those that have
        not settled. Fewer than eight periods kept are compared, but whether they settle is not seen.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(mu=0.3)
    ... )
    >>> base = ss.Harmonic(amplitude=1.0, angular_frequency=0.4)
    >>> section = ss.nonlinear.stroboscopic_section(system, base, over={"mu": [0.1, 0.6]})
    >>> section.recurrence.values
    array([1, 1])
    """
    lasted = transient, kept, _ = checked_periods(transient, kept, longest_transient)
    _checks.positive("tolerance", tolerance)
    cases = cases_of(system, base, y0, over, period, method)
    what = {"function": "stroboscopic_section", "transient": transient, "kept": kept}
    with kept_in(folder, cases, what) as stored:
        seen = follow(cases, transient, kept, progress, stored)
        found = settled(cases, seen, lasted, float(tolerance), progress, stored, stacklevel=3)
    warn_of_unfinished(found[0].status, stacklevel=3)
    return section_of(cases, *found, transient)


def section_of(cases: Cases, seen: Seen, found: np.ndarray, more: np.ndarray, transient: int) -> "xarray.Dataset":
    """The data set of what was seen, of the recurrences `found` and the periods `more` of each case, (cases,)."""
    numbers = np.arange(transient + 1, transient + np.shape(seen.states)[1] + 1)
    coordinates: Entries = {CYCLE: (CYCLE, numbers, {"long_name": "number of the period"})}
    states = np.asarray(seen.states)
    return dataset_of(
        cases,
        {
            **states_of(cases, states, (CYCLE,), "at the end of the period"),
            **sticks_in(cases, seen),
            "recurrence": on_grid(cases, found, "number of periods after which the motion repeats itself"),
            "more_periods": on_grid(cases, more, "number of periods for which it went on until it had settled"),
            "period": on_grid(cases, cases.cycle.duration, "period", "s"),
            **outcome_of(cases, np.asarray(seen.status), np.asarray(seen.near_grazing_count)),
        },
        coordinates,
    )


def sticks_in(cases: Cases, seen: Seen) -> Entries:
    """Variables of the sticks in each period."""
    more = (CYCLE,) if np.ndim(seen.sticks.time) == 2 else (CYCLE, CONTACT)
    return {
        "stick_time": on_grid(cases, seen.sticks.time, "time in sticks in the period", "s", more),
        "stick_count": on_grid(cases, seen.sticks.begun, "number of sticks that begin in the period", "1", more),
        "longest_stick": on_grid(cases, seen.sticks.longest, "longest stick of the period", "s", more),
    }
