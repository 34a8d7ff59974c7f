"""Integer codes in result arrays: how a stick ended, and whether a trajectory reached its horizon."""

from enum import IntEnum


class Ending(IntEnum):
    """Why a stick ended."""

    RELEASED = 0
    """The force needed to hold the mass reached the friction limit: the mass slips."""
    BASE_SWITCHED = 1
    """The base velocity jumped; the mass cannot follow a jump."""
    HORIZON = 2
    """The simulation ended first: the duration is censored, the true one is longer."""


class Status(IntEnum):
    """Whether one trajectory (one sample of a batch) reached ``t1``, or why not."""

    FINISHED = 0
    """The trajectory reached ``t1``."""
    BASE_TOO_SHORT = 1
    """The base motion ran out of intervals before ``t1``: nothing after that instant was simulated."""
    NOT_FINITE = 2
    """The state became NaN or infinite, or one base interval was longer than 2^30 rad of the free oscillation."""
    OUT_OF_STEPS = 3
    """All time steps allowed were used before ``t1``: nothing after that instant was simulated."""
    SOLVER_FAILED = 4
    """The adaptive solver of regularised dynamics gave up before ``t1``: nothing after that instant was simulated."""
    BASE_INVALID = 5
    """An interval of the base motion (or of a ground motion or force) had a negative duration or a number that is not
    finite: nothing after it was simulated."""
    REDUNDANT_CONTACTS = 6
    """The relative velocity of one contact of a structure is implied by those of others, so that no motion is the only
    one: where JAX traces the masses or directions, this is found when they are known. What was simulated means nothing.
    """

    @property
    def meaning(self) -> str:
        """One plain sentence, for tables and messages."""
        return _MEANINGS[self]


_MEANINGS = {
    Status.FINISHED: "reached t1",
    Status.BASE_TOO_SHORT: "the base motion had too few intervals to reach t1 (one of duration 0 is the last)",
    Status.NOT_FINITE: "the state became NaN or infinite, or a base interval spans more than 2^30 rad",
    Status.OUT_OF_STEPS: "all time steps allowed were used before t1 (see max_steps)",
    Status.SOLVER_FAILED: "the adaptive solver gave up (try another solver, or other tolerances)",
    Status.BASE_INVALID: (
        "an interval of the base motion had a negative duration or a number that is not finite (the law must give "
        "durations above 0, 0 after the last interval only, and finite velocities; times must increase from 0)"
    ),
    Status.REDUNDANT_CONTACTS: (
        "the relative velocity of one contact is implied by those of others (join contacts of the same direction)"
    ),
}
