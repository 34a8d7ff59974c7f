"""Systems with a list of contacts: which of their sticks are counted."""

from typing import Annotated, Literal, TypeAlias, TypeVar

import equinox as eqx

from .. import _checks
from .._fields import Option, with_fields
from .system import System

Counted: TypeAlias = int | Literal["all"] | None
"""A contact, by its number from 0; "all": the times in which all contacts that are closed stick; None: every one."""


class _OfCounted(Option):
    def check(self, name: str, value: object) -> None:
        if not (isinstance(value, str) and value == "all"):
            _checks.whole_number(name, value, minimum=0)


S = TypeVar("S", bound="WithContacts")


class WithContacts(System):
    """A system that may have a list of contacts, of any number."""

    counted_contact: Annotated[Counted, _OfCounted()] = eqx.field(static=True, default=None, kw_only=True)

    def of_contact(self: S, number: int) -> S:
        """The same system, of which the sticks of one contact are counted, as if it had no others.

        What takes systems with one contact takes it: ensembles, studies, sensitivities, statistics, figures.

        Args:
            number: Of the contact, from 0.

        Raises:
            ValueError: For a system with one contact, and for a number that is not one of its contacts.
        """
        return self._counting(_checks.whole_number("number", number, minimum=0, maximum=self._require_contacts() - 1))

    def of_all_contacts(self: S) -> S:
        """The same system, of which the times are counted in which every closed contact sticks.

        The position of such a stick is that of the first coordinate. A time in which no contact is closed is no stick.

        Raises:
            ValueError: For a system with one contact.
        """
        self._require_contacts()
        return self._counting("all")

    def _require_contacts(self) -> int:
        if self.contact_count is None:
            raise ValueError(
                f"Argument system must have a list of contacts, but a {type(self).__name__} with one contact was "
                "given: its sticks are counted already."
            )
        return self.contact_count

    def _counting(self: S, counted: Counted) -> S:
        return with_fields(self, type(self), counted_contact=counted)

    @property
    def counted_track(self) -> int | None:
        return -1 if self.counted_contact == "all" else self.counted_contact
