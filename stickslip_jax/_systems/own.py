"""Whether a pytree holds only the package's own modules, or user-defined functions too."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx

_PACKAGE = __name__.partition(".")[0]


def is_own(tree: Any) -> bool:
    """Whether every module in `tree` is the package's own, or a solver of diffrax."""
    return all(
        type(module).__module__.startswith((f"{_PACKAGE}.", "diffrax."))
        and not getattr(module, "holds_users_code", False)
        for module in _modules(tree)
    )


def _modules(tree: Any) -> Iterator[eqx.Module]:
    if isinstance(tree, eqx.Module):
        yield tree
        for field in dataclasses.fields(tree):
            yield from _modules(getattr(tree, field.name, None))
    elif isinstance(tree, (tuple, list)):
        for entry in tree:
            yield from _modules(entry)
