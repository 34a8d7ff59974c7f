"""The search for the parameters of a fit, by SciPy's trust region, and how well they are determined."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .stick_weights import Part

_Vector = Float[np.ndarray, " parameters"]
_Square = Float[np.ndarray, "parameters parameters"]

_ENOUGH = 1e-3  # what the best step would still gain, in squared standard errors: it is a thirtieth of one
_CONVERGED = 0.1  # the same; where no step gains anything 1, as errors of derivatives make it look
_STANDS, _GAINED = 5, 0.005
"""A search ends after so many iterations in a row without gain: simulated means have small jumps."""
_INFLUENCE = 4.0  # times what noise alone would be
_EXACT = 1e-10  # relative, as round-off leaves it where derivatives are proportional
_INVOLVED = 0.1


class Found(NamedTuple):
    """Where a search ended: coordinates, what was found there, and whether it ended because no step gains anything."""

    x: _Vector
    part: Part
    stands: bool


def minimised(at: Callable[[_Vector], Part | None], x: _Vector, most: int) -> Found:
    """The minimum near `x` of what `at` returns, None where there is nothing.

    `most`: iterations. The trust region is in coordinates, that of logarithms for most parameters.
    """
    from scipy import optimize  # noqa: PLC0415 - takes long to load

    known: dict[bytes, Part | None] = {}
    stands, last = 0, np.inf

    def part(x: _Vector) -> Part | None:
        if x.tobytes() not in known:
            known[x.tobytes()] = at(x)
        return known[x.tobytes()]

    def value(x: _Vector) -> float:
        found = part(x)
        return np.inf if found is None else found.value

    def stop(intermediate_result: Any) -> None:
        nonlocal stands, last
        now = np.asarray(intermediate_result.x)
        stands = 0 if value(now) < last - _GAINED else stands + 1
        last = min(last, value(now))
        if stands >= _STANDS or gain(part(now)) < _ENOUGH:
            raise StopIteration

    def gradient(x: _Vector) -> _Vector:
        found = part(x)
        return np.zeros(len(x)) if found is None else found.gradient

    def hessian(x: _Vector) -> _Square:
        # SciPy asks for it where there is nothing too, before it goes back.
        found = part(x)
        return np.eye(len(x)) if found is None else found.hessian

    if gain(part(x)) >= _ENOUGH:
        found = optimize.minimize(
            value, x, method="trust-exact", jac=gradient, hess=hessian, callback=stop,
            options={"initial_trust_radius": 0.5, "max_trust_radius": 2.0, "maxiter": most, "gtol": 0.0},
        )  # fmt: skip
        x = np.asarray(found.x)
    end = part(x)
    assert end is not None
    return Found(x, end, stands >= _STANDS)


def gain(part: Part | None) -> float:
    """What the step of Gauss and Newton would gain, in squared standard errors."""
    if part is None:
        return np.inf
    step = np.linalg.lstsq(part.hessian, part.gradient, rcond=_EXACT)[0]
    return float(step @ part.gradient)


class Precision(NamedTuple):
    """How well a fit determines coordinates.

    - `covariance`: infinite for those that are not determined.
    - `lost`: for each combination of coordinates that is not determined, which of them it holds.
    - `converged`: whether the best step would gain nothing in the directions that are determined.
    - `noise_share`: how much of the information is noise of the derivatives, in the worst determined direction.
    """

    covariance: _Square
    lost: tuple[Bool[np.ndarray, " parameters"], ...]
    converged: bool
    noise_share: float


def precision(part: Part, stands: bool = False) -> Precision:
    """The covariance of the minimum, by the sandwich: the errors of derivatives add no information.

    `stands`: as in `Found`.
    """
    from scipy import linalg  # noqa: PLC0415 - takes long to load

    size = np.sqrt(np.maximum(np.diag(part.hessian), np.finfo(float).tiny))
    scale = np.outer(size, size)
    whole, noise, scores = part.hessian / scale, part.noise / scale, part.scores / scale
    floor = noise + _EXACT * np.eye(len(size))
    ratios, directions = linalg.eigh(whole, floor)
    directions = directions / np.linalg.norm(directions, axis=0)
    kept = directions[:, ratios > _INFLUENCE]
    lost = tuple(np.abs(one) > _INVOLVED for one in directions[:, ratios <= _INFLUENCE].T)
    inner = np.linalg.inv(kept.T @ (whole - noise) @ kept) if kept.size else np.zeros((0, 0))
    bread = kept @ inner @ kept.T
    left = kept.T @ (part.gradient / size)
    still = float(np.sum(left**2 / np.sum(kept * (whole @ kept), axis=0)))
    covariance = bread @ scores @ bread / scale
    for one in lost:
        covariance[one] = covariance[:, one] = np.nan
        covariance[one, one] = np.inf
    return Precision(covariance, lost, still < (1 if stands else _CONVERGED), float(1 / max(ratios[0], 1.0)))
