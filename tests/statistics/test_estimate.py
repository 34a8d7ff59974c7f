"""Estimates in arithmetic: values, errors, units, degrees of freedom, and what is not known to be independent."""

import copy
import math
import operator
import pickle
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from support.plot import simulate

import stickslip_jax as ss
from stickslip_jax._statistics.estimate import same_unit, unit_of_product

ARITHMETIC = (operator.add, operator.sub, operator.mul, operator.truediv)
A = ss.Estimate("a", 2.0, 0.1, "s", 10)
B = ss.Estimate("b", 3.0, 0.2, "m", 20)
C = ss.Estimate("c", 1.0, 0.3, "s", 15)


@pytest.fixture(scope="module")
def many():
    return simulate(200)


def numbers(estimate):
    return estimate.value, estimate.standard_error


def test_an_estimate_less_itself_is_nothing():
    for zero in (A - A, (A + C) - C - A, A * B - B * A, A / B - A / B, A - 2 * A + A):
        assert numbers(zero) == (0, 0)
    for one in (A / A, (A * B) / (B * A)):
        assert numbers(one) == (pytest.approx(1, rel=1e-15), 0)
        assert one.unit == "1"
    assert numbers(A + A) == numbers(2 * A) == pytest.approx((4, 0.2))
    assert numbers(A * A) == pytest.approx((4, 2 * 2 * 0.1))


@pytest.mark.parametrize("factor", [2, 2.0, np.float64(2), np.float32(2), np.int64(2), np.array(2.0), jnp.array(2.0)])
def test_numbers_of_all_kinds(factor):
    assert numbers(factor * A) == numbers(A * factor) == pytest.approx((4, 0.2))
    assert numbers(factor + A) == numbers(A + factor) == pytest.approx((4, 0.1))
    assert numbers(factor - A) == pytest.approx((0, 0.1))
    assert numbers(A - factor) == pytest.approx((0, 0.1))
    assert numbers(A / factor) == pytest.approx((1, 0.05))
    assert numbers(factor / A) == pytest.approx((1, 0.05))
    assert operator.le(A, factor)
    assert not operator.lt(A, factor)


def test_errors_go_along_as_by_differences():
    """The gradient by central differences in the three estimates, and independent errors."""

    def function(a, b, c):
        return 3 * (a + c) * b / (a - 0.5 * c) - 2 * abs(-c) * b / a + (1.5 - a / c) * b

    found = function(A, B, C)
    means, errors = np.array([numbers(one) for one in (A, B, C)]).T
    steps = np.eye(3) * 1e-6
    gradient = np.array([(function(*(means + h)) - function(*(means - h))) / 2e-6 for h in steps])
    assert found.value == pytest.approx(function(*means), rel=1e-14)
    assert found.standard_error == pytest.approx(np.linalg.norm(gradient * errors), rel=1e-8)
    assert found.unit == "m"


def _welch(x, y) -> Any:
    return stats.ttest_ind(x, y, equal_var=False)


def test_the_difference_of_two_means_has_the_interval_of_welch():
    """Against scipy.stats, whose degrees of freedom are not rounded down."""
    rng = np.random.default_rng(5)
    x, y = rng.normal(1.0, 1.0, 12), rng.normal(0.4, 3.0, 40)
    means = [ss.Estimate("", one.mean(), stats.sem(one), "s", len(one)) for one in (x, y)]
    difference, test = means[0] - means[1], _welch(x, y)
    assert difference.samples == math.floor(test.df) + 1
    half_width = stats.t.ppf(0.95, math.floor(test.df)) * difference.standard_error
    rounded = difference.value - half_width, difference.value + half_width
    assert difference.interval(0.9) == pytest.approx(rounded, rel=1e-12)
    theirs = test.confidence_interval(0.9)
    assert difference.interval(0.9) == pytest.approx((theirs.low, theirs.high), rel=1e-3)
    # One estimate, scaled, keeps its own degrees of freedom.
    assert (7.3 * means[0] + 1).samples == 12


def test_units():
    assert (A * B).unit == "s m"
    assert (B / A).unit == "m/s"
    assert (A / B).unit == "s/m"
    assert (1 / A).unit == "1/s"
    assert (B / A / A).unit == "m/s^2"
    assert (B / A / A * A * A).unit == "m"
    assert (A + C).unit == "s"
    assert unit_of_product("1/(kg s^2)", "kg") == "1/s^2"
    assert unit_of_product("m", "kg s^2", -1) == "m/(kg s^2)"
    assert unit_of_product("s-1", "s") == "1"
    assert unit_of_product("s per stick", "s") == "(s per stick) s"
    assert unit_of_product("m ^ s", "s") == "(m ^ s) s"
    assert same_unit("kg m/s", "m kg/s")
    for wrong in (lambda: A + B, lambda: A - B, lambda: A < B):
        with pytest.raises(ValueError, match=r"Estimates must have one unit to be .*'s' and 'm' were given; multiply"):
            wrong()


def test_comparisons_are_of_values():
    assert C < A
    assert A > C
    assert operator.le(A, A)
    assert operator.ge(A, A)
    assert C < 1.5 < A
    assert max(A, C) is A
    assert sorted([A, C]) == [C, A]
    assert float(A) == 2
    assert f"{A:.3f}" == "2.000"
    assert f"{A}" == str(A) == "a: 2.00 +- 0.10 s"
    assert ss.Estimate("a", 2.0, 0.1, "s", 10) == A


def test_what_cannot_be_computed_with():
    wrong: Any
    for wrong in ("2", None, True, np.ones(2), jnp.ones(2), [1.0]):
        for operation in (*ARITHMETIC, operator.lt, operator.ge):
            with pytest.raises(TypeError):
                operation(A, wrong)
            with pytest.raises(TypeError):
                operation(wrong, A)
    with pytest.raises(ZeroDivisionError, match="The estimate 'a' was divided by zero"):
        operator.truediv(A, 0)
    nothing = A / ss.Estimate("none", 0.0, 0.1, "s", 10)
    assert math.isnan(nothing.value)
    assert math.isnan(nothing.standard_error)


def test_names():
    assert (A + C).name == "a + c"
    assert ((A + C) / 2).name == "(a + c) / 2"
    total: Any = sum([A, C])
    assert total.name == "a + c"
    terms = [ss.Estimate("a name of some length", float(i), 0.1, "s", 10) for i in range(50)]
    total = sum(terms)
    assert total.name == "combination of 50 estimates"
    assert numbers(total) == pytest.approx((49 * 25, 0.1 * math.sqrt(50)))


def test_estimates_of_one_ensemble(many):
    """The same one twice is itself; two different ones are correlated, nobody knows how, and it is said."""
    duration, slip = many.statistics.duration, many.statistics.slip_duration
    assert numbers(duration.mean - duration.mean) == (0, 0)
    assert numbers(duration.quantile(0.3) - duration.quantile(0.3)) == (0, 0)
    assert numbers(many.statistics.order(2).share - many.statistics.order(2).share) == (0, 0)
    assert numbers(ss.stick_fraction(many) - ss.stick_fraction(many)) == (0, 0)
    for mixed in (
        duration.mean - slip.mean,
        duration.mean / duration.median,
        ss.stick_fraction(many) * ss.mean_stick_duration(many),
        many.statistics.joint("duration", "position").correlation * duration.mean,
        ss.mean_stick_duration(many) + ss.mean_stick_duration(simulate(200, speed=2.0)),  # the same key
    ):
        assert math.isfinite(mixed.value)
        assert math.isnan(mixed.standard_error)
        assert "error not known: of estimates from the same random numbers" in str(mixed)
    # A number without an error is correlated with nothing.
    sure = ss.Estimate("sure", 2.0, 0.0, "s", 200, duration.origin)
    assert (duration.mean - sure).standard_error == duration.mean.standard_error


def test_of_one_sample_there_is_no_error():
    lone = ss.Estimate("a", 2.0, math.nan, "s", 1)
    assert str(2 * lone) == "2 * a: 4 s (no error from one sample)"
    assert numbers(lone - lone) == (0, 0)


def test_copies_know_where_they_are_from():
    for copied in (copy.copy(A), pickle.loads(pickle.dumps((A, A)))[0]):
        assert copied == A
        assert hash(copied) == hash(A)
    again, both = pickle.loads(pickle.dumps((A, A + C)))
    assert numbers(both - again) == pytest.approx((1, 0.3))


def test_among_others_an_estimate_is_one_line():
    assert repr({"a": ss.Estimate("position", 0.30072, 0.0019, "m", 398)}) == "{'a': <position: 0.3007 +- 0.0019 m>}"


def test_html():
    assert A._repr_html_() == "<span>a: <b>2.00 ± 0.10 s</b></span>"
    assert "&lt;a&gt;" in ss.Estimate("<a>", 1.0, 0.1, "s", 10)._repr_html_()
