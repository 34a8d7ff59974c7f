"""The algebra of fits to moments: against SciPy's normal distribution, closed forms, and drawn numbers."""

import re
from typing import Annotated

import numpy as np
import pytest
from scipy import optimize, stats

import stickslip_jax as ss
from stickslip_jax._calibration.parameters import Models
from stickslip_jax._calibration.stick_moments import (
    FitPart,
    Observed,
    Simulated,
    by_likelihood,
    by_moments,
    covariance_of_misfit,
    with_products,
)
from stickslip_jax._calibration.sticks import Overidentification, Precision, minimised, precision, remarks_of

NUMBERS = (ss.SumOfSquaredDurations(), ss.TimeToFirstStick())
ENOUGH = 10**12  # simulated realisations: no error


def normal(at):
    """Mean and covariance of two numbers as functions of three parameters."""
    a, b, c = at
    return np.array([1 + a, 2 - a * b]), np.array([[np.exp(c), 0.3 * b], [0.3 * b, 1 + a**2]])


def moments(at):
    """Means of the numbers and of their products."""
    mean, covariance = normal(at)
    return np.concatenate([mean, (covariance + np.outer(mean, mean))[np.triu_indices(2)]])


def simulated(at, number=ENOUGH):
    """What infinitely many simulations of normal numbers give: fourth moments are in closed form."""
    slope = np.stack([(moments(at + d) - moments(at - d)) / 2e-5 for d in 1e-5 * np.eye(3)], axis=-1)
    mean, covariance = normal(at)
    one, other = np.triu_indices(2)
    units = np.eye(2)
    of = np.vstack([units, units[one] * mean[other, None] + units[other] * mean[one, None]])
    products = covariance[np.ix_(one, one)] * covariance[np.ix_(other, other)]
    products += covariance[np.ix_(one, other)] * covariance[np.ix_(other, one)]
    whole = of @ covariance @ of.T
    whole[2:, 2:] += products
    error = np.zeros((5 + 15,) * 2)
    error[:5, :5] = whole / number
    return Simulated(moments(at), slope, error, number, 0)


def observed(recordings, seed=0):
    mean, covariance = normal(np.array([0.2, 0.5, -0.3]))
    values = np.random.default_rng(seed).multivariate_normal(mean, covariance, recordings)
    return Observed(NUMBERS, values.mean(axis=0), np.cov(values.T), values, 1.0, False)


def test_products_stand_behind_the_numbers():
    names = [one.name for one in with_products(NUMBERS)]
    a, b = (one.name for one in NUMBERS)
    assert names == [a, b, f"{a} * {a}", f"{a} * {b}", f"{b} * {b}"]


def test_likelihood_is_that_of_the_normal_distribution():
    """Value and gradient against SciPy's density."""
    data, at = observed(7), np.array([0.1, 0.4, -0.1])

    def minus_log(at):
        return -stats.multivariate_normal(*normal(at)).logpdf(data.values).sum()

    part = by_likelihood(data, simulated(at))
    other = np.array([0.3, 0.2, 0.2])
    gained = part.value - by_likelihood(data, simulated(other)).value
    assert gained == pytest.approx(minus_log(at) - minus_log(other), rel=1e-10)
    assert part.gradient == pytest.approx(optimize.approx_fprime(at, minus_log, 1e-6), rel=1e-4)


def test_information_is_the_curvature_of_the_likelihood():
    """Of so many drawn numbers the second derivative is its expectation; of normal numbers also that of the score."""
    data, at = observed(400_000), np.array([0.2, 0.5, -0.3])
    part = by_likelihood(data, simulated(at))
    steps = 1e-4 * np.eye(3)
    gradients = [(by_likelihood(data, simulated(at + d)).gradient - by_likelihood(data, simulated(at - d)).gradient)
                 / 2e-4 for d in steps]  # fmt: skip
    scale = np.sqrt(np.outer(np.diag(part.hessian), np.diag(part.hessian)))
    # Sample means of 400,000 differ from their expectations by 0.2 % (one standard error) of a standard deviation.
    assert np.stack(gradients) / scale == pytest.approx(part.hessian / scale, abs=0.01)
    assert part.scores / scale == pytest.approx(part.hessian / scale, abs=1e-6)


def test_scores_hold_the_errors_of_simulations():
    """As many simulated realisations as recordings: twice the variance."""
    data, at = observed(50), np.array([0.2, 0.5, -0.3])
    alone, both = (by_likelihood(data, simulated(at, number)).scores for number in (ENOUGH, 50))
    assert both == pytest.approx(2 * alone, rel=1e-6)


def test_weighted_squares():
    data, at = observed(50), np.array([0.1, 0.4, -0.1])
    one = simulated(at, 200)
    one = one._replace(mean=one.mean[:2], slope=one.slope[:2], error=np.zeros((8, 8)))
    covariance = covariance_of_misfit(data, one)
    assert covariance == pytest.approx(np.cov(data.values.T) * (1 / 50 + 1 / 200))
    misfit = data.mean - one.mean
    part = by_moments(data, one, covariance)
    assert part.value == pytest.approx(0.5 * misfit @ np.linalg.solve(covariance, misfit))
    assert part.gradient == pytest.approx(-one.slope.T @ np.linalg.solve(covariance, misfit))


def part_of(hessian, noise, gradient=(0.0, 0.0)):
    hessian = np.array(hessian, float)
    return FitPart(0.0, np.array(gradient), hessian, np.array(noise, float), hessian)


def test_noise_of_derivatives_is_no_information():
    """Drawn derivatives of 60 moments: estimates by them scatter as is said, more than by the inverse information."""
    random, draws = np.random.default_rng(0), 4000
    slope = np.full(60, 0.5)
    noisy = slope[None] + random.normal(scale=0.2, size=(draws, 60))  # the moments themselves have the error 1
    estimates = (noisy * random.normal(size=noisy.shape)).sum(axis=1) / (noisy @ slope)
    squares = (noisy**2).sum(axis=1)[:, None, None]
    noise = np.full((1, 1), 60 * 0.2**2)
    told = np.array([precision(FitPart(0, np.zeros(1), one, noise, one)).covariance[0, 0] for one in squares])
    assert np.all(np.isfinite(told))
    # The variance of 4000 normal numbers has a standard error of 2.2 %; that of the mean of `told` is less than 1 %.
    assert told.mean() == pytest.approx(estimates.var(), rel=0.1)
    assert (1 / squares).mean() < 0.8 * estimates.var()


def test_directions_without_information_are_told():
    fine = precision(part_of([[4.0, 1.0], [1.0, 2.0]], np.zeros((2, 2))))
    assert fine.covariance == pytest.approx(np.linalg.inv([[4.0, 1.0], [1.0, 2.0]]))
    assert fine.lost == ()
    assert fine.converged
    one = precision(part_of([[4.0, 0.0], [0.0, 2.0]], [[0.0, 0.0], [0.0, 1.9]], (0.0, 3.0)))
    assert [lost.tolist() for lost in one.lost] == [[False, True]]
    assert one.covariance[0, 0] == pytest.approx(0.25)
    assert one.covariance[1, 1] == np.inf
    assert one.converged
    both = precision(part_of([[4.0, 6.0], [6.0, 9.0]], np.zeros((2, 2)), (1.0, 1.0)))
    assert [lost.tolist() for lost in both.lost] == [[True, True]]
    assert np.diag(both.covariance).tolist() == [np.inf, np.inf]
    assert not precision(part_of(np.eye(2), np.zeros((2, 2)), (0.9, 0.0))).converged
    assert precision(part_of(np.eye(2), np.zeros((2, 2)), (0.9, 0.0)), stands=True).converged


def test_remarks():
    """What is told of the result, of which nothing else need be."""

    def told(lost=(), converged=True, noise=0.01, p_value=0.5, unfinished=0):
        known = Precision(np.eye(2), tuple(map(np.array, lost)), converged, noise)
        return remarks_of(("mu", "rate"), known, Overidentification(3.0, 1, p_value), unfinished, 900)

    assert told() == ()
    for options, sentence in (
        ({"lost": [[False, True]]}, "rate has no influence on these moments"),
        ({"lost": [[True, True]]}, "mu and rate cannot be told apart by these moments"),
        ({"converged": False}, "The search has not found the minimum"),
        ({"noise": 0.4}, "40% of what the derivatives seem to tell is their own error, .* take 7 times as many"),
        ({"p_value": 1e-4}, "The model cannot have all moments at once"),
        ({"unfinished": 2}, "2 of 900 simulated trajectories did not finish"),
    ):
        (remark,) = told(**options)
        assert re.match(sentence, remark), remark


def test_search_goes_back_where_there_is_nothing():
    """A quadratic whose first step, by a curvature that is too small, leads to where there is no model."""
    wanted, bend = np.array([0.3, -0.2]), np.array([[3.0, 1.0], [1.0, 2.0]]) * 1e6
    asked = []

    def at(x):
        asked.append(x)
        away = x - wanted
        if x[0] > 0.4:
            return FitPart.nothing(2)
        return FitPart(0.5 * away @ bend @ away, bend @ away, 0.6 * bend, 0 * bend, bend)

    assert minimised(at, np.zeros(2), 60).x == pytest.approx(wanted, abs=1e-4)
    assert any(x[0] > 0.4 for x in asked)


class Bounded(ss.FrictionLaw):
    """A friction law with numbers of all kinds of bounds."""

    free: Annotated[float, ss.Quantity("1")] = -3.0
    positive: Annotated[float, ss.Quantity("1", above=0)] = 0.5
    below: Annotated[float, ss.Quantity("1", below=2)] = -1.0
    between: Annotated[float, ss.Quantity("1", at_least=1, below=3)] = 1.2

    @property
    def static(self):
        return self.positive

    def kinetic(self, speed):
        return self.positive


def test_coordinates_keep_parameters_within_bounds():
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=Bounded())
    models = Models.of(system, ss.PoissonSwitching(1.0, 1.0), None, ("free", "positive", "below", "between"), 1)
    numbers = models.transform.numbers
    assert numbers(np.zeros(4)) == pytest.approx([-3.0, 0.5, -1.0, 1.2])
    far = numbers(np.full(4, 5.0))
    assert far[1] == pytest.approx(0.5 * np.exp(5))
    assert far[2] < 2
    assert 1 < numbers(np.full(4, -9.0))[3] < 1.001
    assert 2.8 < far[3] < 3
    for x in (np.zeros(4), np.full(4, 0.7)):
        ends = [numbers(x + sign * 1e-6) for sign in (1, -1)]
        expected = np.diag((ends[0] - ends[1]) / 2e-6)  # none is counted from another
        assert models.transform.slopes(numbers(x)) == pytest.approx(expected, rel=1e-6)
    assert models.at(far)[0].system.friction.between == far[3]
