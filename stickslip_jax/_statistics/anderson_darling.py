"""The Anderson-Darling test of k samples, with p-values of any size.

Scholz and Stephens 1987, Journal of the American Statistical Association 82, 918. Tables of critical values, as in
scipy, end at 0.25 and 0.001; here the p-value is computed from the limiting distribution itself.
"""

import math

import numpy as np
from scipy import optimize


def anderson_darling(groups: list[np.ndarray]) -> tuple[float, float]:
    """Normalised statistic and p-value for two or more groups of values, arrays (n_i,) of at least 5 each.

    Ties count by midranks. The statistic is standardised by its exact mean and variance for these group sizes, then
    compared with the limiting distribution, standardised likewise. If all values are equal the result is (0, 1).
    """
    pooled, ties = np.unique(np.concatenate(groups), return_counts=True)
    if len(pooled) < 2:
        return 0.0, 1.0
    number, degrees = int(ties.sum()), len(groups) - 1
    below = np.cumsum(ties) - ties / 2
    weight = ties / number / (below * (number - below) - number * ties / 4)
    squares = []
    for group in groups:
        values = np.sort(group)
        mid = (np.searchsorted(values, pooled, "left") + np.searchsorted(values, pooled, "right")) / 2
        squares.append(float(weight @ (number * mid - len(group) * below) ** 2) / len(group))
    total = (number - 1) / number * sum(squares)  # A^2_akN of eq. (7)
    normalized = (total - degrees) / math.sqrt(_variance(np.array([len(group) for group in groups])))
    # The limit is sum_j X_j / (j (j + 1)), X_j chi-square of k - 1 degrees: mean k - 1, variance below.
    limit_deviation = math.sqrt(2 * degrees * (math.pi**2 / 3 - 3))
    return normalized, limit_tail(degrees + normalized * limit_deviation, degrees)


def _variance(sizes: np.ndarray) -> float:
    """Variance of the statistic if all groups have the same continuous distribution, eq. (4)."""
    k, n = len(sizes), int(sizes.sum())
    big_h = (1 / sizes).sum()
    partial = np.cumsum(1 / np.arange(n - 1, 1, -1))
    h = partial[-1] + 1
    g = (partial / np.arange(2, n)).sum()
    a = (4 * g - 6) * (k - 1) + (10 - 6 * g) * big_h
    b = (2 * g - 4) * k**2 + 8 * h * k + (2 * g - 14 * h - 4) * big_h - 8 * h + 4 * g - 6
    c = (6 * h + 2 * g - 2) * k**2 + (4 * h - 4 * g + 6) * k + (2 * h - 6) * big_h + 4 * h
    d = (2 * h + 6) * k**2 - 4 * h * k
    return (((a * n + b) * n + c) * n + d) / ((n - 1) * (n - 2) * (n - 3))


def limit_tail(x: float, degrees: int) -> float:
    """P(Q > x) for ``Q = sum over j >= 1 of X_j / (j (j + 1))``, X_j independent chi-square variables of `degrees`.

    Q has the moment generating function ``M(s) = (-2 pi s / cos(pi q / 2))^(degrees / 2)``, ``q = sqrt(1 + 8 s)``
    (Anderson and Darling 1952, Annals of Mathematical Statistics 23, 193), with its singularities on s >= 1. So
    ``P(Q > x) = 1 / (2 pi i) int M(s) exp(-s x) / s ds`` along the parabola ``s = 1 - (a - i u)^2`` around them, on
    which the integrand falls off like exp(-x u^2): the trapezoidal rule then gives nearly all digits, in the tail too.
    """
    if x <= 0.05 * degrees:  # P(Q <= x) is below 1e-8 there, and the integrand falls off slowly
        return 1.0

    def slope(c):  # derivative of the logarithm of the integrand on the real axis
        q = math.sqrt(1 + 8 * c)
        return degrees / 2 * (1 / c + 2 * math.pi * math.tan(math.pi * q / 2) / q) - x - 1 / c

    # The parabola crosses the axis where the integrand is smallest there, so that little cancels.
    saddle = np.asarray(optimize.brentq(slope, 1e-6, 1 - 1e-12), float).item()
    root, step = math.sqrt(1 - saddle), math.sqrt((50 + 2 * degrees) / x) / 400
    one_step = root - 1j * step * np.arange(401)
    s = 1 - one_step**2
    ratio = -2 * math.pi * s / np.cos(math.pi / 2 * np.sqrt(1 + 8 * s))
    logarithm = degrees / 2 * (np.log(np.abs(ratio)) + 1j * np.unwrap(np.angle(ratio))) - s * x
    integrand = (np.exp(logarithm) / s * 2j * one_step).imag
    return float(np.clip((integrand.sum() - integrand[0] / 2) * step / math.pi, 0, 1))
