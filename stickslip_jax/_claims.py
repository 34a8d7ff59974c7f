"""What a class states about its own methods, and what becomes of it in a subclass that overrides them.

`Coulomb` states that its friction coefficient does not depend on the speed, and slips then have closed forms. A
subclass with another `kinetic` would inherit the statement, and move as plain `Coulomb` does. So a statement holds for
the methods it was made of: where a subclass overrides one of them and does not repeat the statement, it is withdrawn.
"""

from collections.abc import Mapping
from typing import ClassVar


class WithClaims:
    """A class whose statements about its methods do not outlive them.

    `rests_on`: the methods that each statement is about, by the name of the attribute that states it. A withdrawn one
    is again what the first class says that has it, which must be true of any methods.
    `only_with`: methods that show what others do, and the others: a subclass may not override the first alone.
    """

    rests_on: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    only_with: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def __init_subclass__(cls, **kwargs: object):
        super().__init_subclass__(**kwargs)
        for claim, methods in cls.rests_on.items():
            above, holders = _above(cls, claim)
            if any(name in vars(kind) for kind in above for name in methods):
                setattr(cls, claim, vars(holders[-1])[claim])
        for name, others in cls.only_with.items():
            if all(name in {method for kind in _above(cls, other)[0] for method in vars(kind)} for other in others):
                needed = " or ".join(others)
                raise TypeError(
                    f"Class {cls.__name__} must override {needed} too where it overrides {name}: what is simulated "
                    f"follows from {needed}, and {name} alone would only show something else."
                )


def _above(cls: type, name: str) -> tuple[list[type], list[type]]:
    """The classes that `cls` looks in before it finds the attribute `name`, and all that have it, in that order."""
    holders = [kind for kind in cls.__mro__ if name in vars(kind)]
    return list(cls.__mro__[: cls.__mro__.index(holders[0])]), holders


def keeps(value: object, kind: type, *methods: str) -> bool:
    """Whether `value` is of this `kind`, or of a subclass that leaves these `methods` as they are."""
    return isinstance(value, kind) and all(getattr(type(value), name) is getattr(kind, name) for name in methods)
