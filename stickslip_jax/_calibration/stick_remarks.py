"""Sentences about what a calibration does not tell."""

import math

from .stick_result import Overidentification
from .stick_search import Precision

_NOISY = 0.2  # share of the information
_WRONG = 1e-3  # p-value


def remarks_of(
    names: tuple[str, ...], certain: Precision, test: Overidentification | None,
    unfinished: int, simulated: int,
) -> tuple[str, ...]:  # fmt: skip
    """The remarks, those that matter most first."""
    said = []
    if not certain.converged:
        said.append(
            "The search has not found the minimum: the estimates are where it ended; start from other values, or with "
            "more samples."
        )
    for involved in certain.lost:
        lost = [name for name, is_in in zip(names, involved, strict=True) if is_in]
        if len(lost) == 1:
            said.append(
                f"{lost[0]} has no influence on these moments that these simulations could show, so that its error is "
                "infinite: take more samples, or give it a known value, or other moments or experiments that depend on "
                "it."
            )
        else:
            said.append(
                f"{' and '.join(lost)} cannot be told apart by these moments, as far as these simulations could show: "
                "other values of all of them fit as well, so that their errors are infinite; take more samples, or one "
                "of them must be known, or further moments or experiments tell."
            )
    if not certain.lost and certain.noise_share > _NOISY:
        more = math.ceil(certain.noise_share / (0.1 * (1 - certain.noise_share)))
        said.append(
            f"{certain.noise_share:.0%} of what the derivatives seem to tell is their own error, which makes the "
            f"estimates less certain; take {more} times as many samples."
        )
    if test is not None and test.p_value < _WRONG:
        said.append(
            f"The model cannot have all moments at once (Hansen's test: p = {test.p_value:.2g}): something "
            "in it is not as in the recordings, and standard errors are those of a right model."
        )
    if unfinished:
        said.append(
            f"{unfinished} of {simulated} simulated trajectories did not finish, and are left out of all means."
        )
    return tuple(said)
