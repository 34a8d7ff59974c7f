"""The base class of all that drives a system: laws, signals and realisations."""

import math
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, cast

from .._methods import Module
from .._types import Number, Scalar

if TYPE_CHECKING:
    from .random import RandomSignal
    from .segments import SegmentLaw
    from .smooth import Signal

Path = tuple[str | int, ...]


class Parts(NamedTuple):
    """The parts of a motion; the fields are those of an `Excitation`."""

    smooth: "Signal | RandomSignal | None" = None
    base: "tuple[SegmentLaw, ...]" = ()
    ground: "tuple[SegmentLaw, ...]" = ()
    has_key_per_part: bool = False


class Motion(Module):
    """Base class of base motions, ground motions and voltages.

    Attributes:
        part_of_excitation: Smooth, or in segments a base velocity or an acceleration of the ground.
        is_random: Whether realisations differ, so that one must be drawn before `simulate`.
        is_piecewise_constant: Whether it is a base velocity that is constant between jumps.
        takes_jumps: Whether it is a continuous base velocity, to which `WithJumps` can add jumps.
    """

    part_of_excitation: ClassVar[Literal["smooth", "base", "ground"]] = "smooth"
    is_random: ClassVar[bool] = False
    is_piecewise_constant: ClassVar[bool] = False
    takes_jumps: ClassVar[bool] = True

    def parts(self) -> Parts:
        """Its smooth part and its parts in segments."""
        name, part = self.part_of_excitation, cast(Any, self)
        return Parts()._replace(**{name: part if name == "smooth" else (part,)})

    def path_in_excitation(self, path: Path) -> Path:
        """The path in the `Excitation` of its parts of the number that has the `path` in it."""
        name = self.part_of_excitation
        return (name, *path) if name == "smooth" else (name, 0, *path)

    @property
    def covered_time(self) -> float:
        """Duration of a recorded motion, s; infinity for one that is not recorded, or whose times are traced."""
        return math.inf

    @property
    def repeats_after(self) -> Number | tuple[Number, ...] | None:
        """After what time (s) it repeats itself, or each of its parts: 0 for what never changes, None for not known."""
        return None

    def realized_until(self, t1: Scalar) -> "Motion":
        """This motion, which is not random, as `simulate` follows it up to `t1` (s)."""
        return self
