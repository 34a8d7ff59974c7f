"""`explore`: the explorer in a notebook."""

from typing import TYPE_CHECKING

from ._dynamics.common.method import EXACT, Exact, Regularized
from ._excitation.excitation import BaseMotion, law_of
from ._foundation import checks
from ._foundation.extras import require_explorer
from ._foundation.types import InitialState
from ._systems.system import System

if TYPE_CHECKING:
    from .study._explorer_page import Explorer


def explore(
    system: System,
    law: BaseMotion,
    *,
    t1: float = 200.0,
    y0: InitialState | None = None,
    samples: int = 2000,
    seed: int = 0,
    method: Exact | Regularized = EXACT,
) -> "Explorer":
    """Show a system with sliders for its numbers, in a notebook: what moves is simulated anew at once.

    Beside the sliders are the phase portrait and the time history of the first realisation, histograms and means over
    all realisations, the derivative of the mean stick duration by the number that was moved last, and on a base without
    randomness the bifurcation diagram over it. What is shown can be copied as Python, saved as a study's file, or saved
    as figures. ``stickslip explore`` in a terminal shows the same in a browser.

    Args:
        system: With the numbers to begin with; one of your own too.
        law: What drives it, with the numbers to begin with.
        t1: Duration of each realisation, s.
        y0: Initial state, such as ``(position, velocity)``; zeros by default.
        samples: Number of realisations.
        seed: Of the random numbers: their key is ``jax.random.key(seed)``.
        method: `Exact`, with a time step where one is needed, or `Regularized`.

    Returns:
        What a notebook shows. Its `scene` holds the system, the law and the numbers as they are now.

    Raises:
        ValueError: For arguments that do not fit.
        ImportError: Without the extra ``explore``.
    """
    require_explorer()
    if not isinstance(system, System):
        raise checks.refused("system", "be a system such as MassSpring", system)
    import panel as pn  # noqa: PLC0415 - an extra

    from .study._explorer_page import Explorer  # noqa: PLC0415
    from .study._explorer_scene import Scene  # noqa: PLC0415
    from .study._reading import MOST_SAMPLES  # noqa: PLC0415

    checks.positive("t1", t1, "s")
    number = checks.whole_number("samples", samples, minimum=2, maximum=MOST_SAMPLES)
    known = system.coordinates
    start = tuple(0.0 for _ in known) if y0 is None else tuple(y0)
    if len(start) != len(known):
        names = ", ".join(one.name for one in known)
        raise checks.refused("y0", f"hold {len(known)} values ({names})", y0)
    scene = Scene(system, law_of(law), start, float(t1), number, checks.whole_number("seed", seed, minimum=0), method)
    pn.extension(inline=True)  # its scripts come from here, not from the net
    return Explorer(scene)
