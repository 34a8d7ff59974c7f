"""Whether a pytree holds only the package's own modules, or user-defined functions too."""

from jaxtyping import PyTree

from .._fields import PACKAGE, modules_in


def is_built_in(tree: PyTree) -> bool:
    """Whether every module in `tree` is the package's own, or a solver of diffrax."""
    return all(
        type(module).__module__.startswith((f"{PACKAGE}.", "diffrax."))
        and not getattr(module, "holds_users_code", False)
        for module in modules_in(tree)
    )
