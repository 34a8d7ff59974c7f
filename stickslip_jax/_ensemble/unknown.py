"""Stand-ins for what an ensemble does not know: the system of measured sticks, an object of a user's own class."""

import dataclasses
from typing import NoReturn

import equinox as eqx

from .._systems.system import Coordinate, System


@dataclasses.dataclass(frozen=True)
class Unknown:
    """Stands for an object that is not there, because nobody gave it or because its class is a user's own.

    `name`: what it is, or its class. `text`: how it was printed, "" if it was not.
    """

    name: str
    text: str = ""

    def __str__(self) -> str:
        return f"{self.name}, stored as text only: {self.text}" if self.text else self.name


class UnknownSystem(System):
    """Stands for a system that is not there; knows only what the position of a stick is.

    `name`, `text`: as in `Unknown`. `position`: the name, unit and period of the position of a stick.

    Statistics and figures of the sticks work; whatever would simulate raises ValueError.
    """

    name: str = eqx.field(static=True)
    text: str = eqx.field(static=True)
    position: Coordinate = eqx.field(static=True)

    def __str__(self) -> str:
        return str(Unknown(self.name, self.text))

    @property
    def stick_position(self) -> Coordinate:
        return self.position

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        # As the abscissa of figures, the name goes without " when the stick starts".
        return (self.position._replace(name=self.position.name.removesuffix(" when the stick starts")),)

    @property
    def contact_scales(self) -> NoReturn:
        self._refuse()

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise ValueError(
            "Argument system must be a system that can be simulated, but this one is not known "
            f"({self}); give the system itself."
        )

    switched_model = time_scales = check_state = check_excitation = _refuse


def require_known(what: str, held: object) -> None:
    """Raise ValueError if `held`, the ensemble's `what`, is a stand-in."""
    if held is None or isinstance(held, (Unknown, UnknownSystem)):
        about = "it has none" if held is None else held
        raise ValueError(
            f"This ensemble does not know its {what} ({about}), so nothing can be simulated or drawn again; call "
            "simulate_ensemble with your own objects."
        )
