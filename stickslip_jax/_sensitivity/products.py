"""A warning where parameters act only together, as a friction coefficient and a normal force do through their product.

Then the derivatives by their logarithms are proportional in every sample, up to round-off, and so are those of every
statistic: none can tell the parameters apart. Equality in the inequality of Cauchy and Schwarz is the test.
"""

import math
import warnings
from itertools import combinations

import numpy as np

from .chunks import JointAccumulator
from .problem import Problem

_PROPORTIONAL = 1e-9  # of the squares: what is not proportional, relative to the whole


def warn_of_products(problem: Problem, accumulated: JointAccumulator) -> None:
    """RuntimeWarning for each pair of parameters whose derivatives are proportional in every sample."""
    for sentence in products_among(problem, accumulated):
        warnings.warn(f"{sentence}; vary one of them only.", RuntimeWarning, 4)


def products_among(problem: Problem, accumulated: JointAccumulator) -> list[str]:
    """A sentence for each pair of parameters whose derivatives are proportional in every sample."""
    first, second = accumulated.halves
    moments, found = first.merge(second), []
    if moments.number < 2:
        return found
    squares = moments.scatter / moments.number + np.outer(moments.mean, moments.mean)  # means of products of columns
    places = [_columns(accumulated, index, squares) for index in range(len(problem.parameters))]
    for one, other in combinations(range(len(places)), 2):
        exponent = _exponent(squares, places[one], places[other])
        if exponent is None:
            continue
        names = [problem.parameters[index].name for index in (one, other)]
        values = [problem.parameters[index].value for index in (one, other)]
        found.append(_sentence(names, exponent * values[1] / values[0] if values[0] else math.nan))
    return found


def _columns(accumulated: JointAccumulator, parameter: int, squares: np.ndarray) -> np.ndarray:
    """The columns of the derivatives of all statistics by a parameter: pathwise ones, unless these are 0 or not known.

    Kernels, and differences, estimate event parts to first order only: they are less exactly proportional.
    """
    found: list[list[int]] = [[], []]
    for number, _ in enumerate(accumulated.sizes):
        offset, one = accumulated.slice_of(number).start, accumulated.single(number).columns[parameter]
        for columns, kind in zip(found, ((one.pathwise,), one.derivative), strict=True):
            columns += [offset + column + part for column in kind for part in (0, 1)]
    pathwise, whole = (np.array(columns) for columns in found)
    return pathwise if np.any(squares[pathwise, pathwise] > 0) else whole


def _exponent(squares: np.ndarray, one: np.ndarray, other: np.ndarray) -> float | None:
    """The factor c with which all columns `other` are c times the columns `one`; None if they are not proportional."""
    if len(one) != len(other):
        return None
    of_one, of_other, product = squares[one, one], squares[other, other], squares[one, other]
    if not (np.any(of_one > 0) and np.any(of_other > 0)):
        return None
    scale = of_one / of_one.sum() + of_other / of_other.sum()  # columns have different units
    weight = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1), 0)
    a, b, ab = (float(weight @ values) for values in (of_one, of_other, product))
    return ab / a if a * b - ab * ab <= _PROPORTIONAL * a * b else None


def _sentence(names: list[str], exponent: float) -> str:
    """`exponent`: that of the second parameter, if that of the first is 1, in the combination on which all depends."""
    one, other = names
    together = f"one combination of them, {one} * {other}^{exponent:.3g} near their values"
    if math.isclose(exponent, 1, rel_tol=1e-3):
        together = f"their product {one} * {other}"
    elif math.isclose(exponent, -1, rel_tol=1e-3):
        together = f"their ratio {one} / {other}"
    return (
        f"{one} and {other} act on this only through {together}: their derivatives are proportional in every sample, "
        "so that nothing found here can tell them apart (a fit to both has rank 1)"
    )
