"""Whether a pytree holds only the package's own modules, or user-defined functions too."""

from typing import Any

from .._excitation.smooth import UserMotion
from .._fields import PACKAGE, modules_in
from .friction import FrictionCurve

_THEIRS = (FrictionCurve, UserMotion)  # these hold a user-defined function


def is_own(tree: Any) -> bool:
    """Whether every module in `tree` is the package's own, or a solver of diffrax."""
    return all(
        type(module).__module__.startswith((f"{PACKAGE}.", "diffrax.")) and not isinstance(module, _THEIRS)
        for module in modules_in(tree)
    )
