"""Numbers with bounds as functions of coordinates: inverse, derivatives, and searches that stay inside."""

from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._calibration.transform import Transform, transform_of
from stickslip_jax._uncertainty.numbers import Parameter

INF = np.inf
# Linear from 0, linear, above 0, at least 1, below 3, between 0 and 1.
START = np.array([0.0, -2.0, 0.5, 2.0, -4.0, 0.3])
LOW = np.array([-INF, -INF, 0.0, 1.0, -INF, 0.0])
HIGH = np.array([INF, INF, INF, INF, 3.0, 1.0])
OF = Transform(START, LOW, HIGH)


def test_first_guess_is_the_origin():
    np.testing.assert_allclose(OF.numbers(np.zeros(6)), START, rtol=1e-15)


@pytest.mark.parametrize("x", [-30.0, -1.0, 0.5, 30.0])
def test_values_derivatives_and_bounds(x):
    """Against closed forms; the derivatives against those of JAX, which are finite."""
    x = np.full(6, x)
    found, e = OF.numbers(x), np.exp(x[0])
    expected = [x[0], -2 + 2 * x[0], 0.5 * e, 1 + e, 3 - 7 / e, 1 / (1 + 7 / 3 / e)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert np.all((found >= LOW) & (found <= HIGH))
    traced = jax.jacfwd(OF.numbers)(jax.numpy.asarray(x))
    np.testing.assert_allclose(jax.numpy.diag(traced), OF.slopes(found), rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(OF.numbers(jax.numpy.asarray(x)), found, rtol=1e-5)


class One(NamedTuple):
    """A tree with one law."""

    law: object


@pytest.mark.parametrize(("value", "is_inside"), [(1.0, False), (1.0 + 1e-9, True), (0.0, False)])
def test_first_guesses_at_a_bound_are_refused(value, is_inside):
    law = ss.BoucWen(0.5, 0.01, exponent=max(value, 1.0))
    law = eqx.tree_at(lambda law: law.exponent, law, value)
    parameters = (Parameter("exponent", ("law", "exponent"), value),)
    if is_inside:
        assert transform_of(One(law), parameters).low == [1.0]
    else:
        with pytest.raises(ValueError, match=rf"bounds, above 1, but exponent = {value:g} was given; .* cannot leave"):
            transform_of(One(law), parameters)


class Drag(ss.FrictionLaw):
    """Friction that grows with a power of the speed."""

    mu: Annotated[float, ss.Quantity(at_least=0)]
    exponent: Annotated[float, ss.Quantity(at_least=1)]

    @property
    def static(self):
        return self.mu

    @property
    def speed_scale(self):
        return 1.0

    def kinetic(self, speed):
        # Everywhere smooth, also in its exponent.
        return self.mu * (1 + speed) ** self.exponent


class FreeDrag(Drag):
    """The same with any exponent."""

    exponent: float  # pyright: ignore[reportGeneralTypeIssues]


def found(true, guess):
    times = np.linspace(0, 12, 121)
    system, base = ss.MassSpring(1.0, 4.0, 1.0, true), ss.Harmonic(0.8, 1.3)
    seen = np.asarray(ss.simulate(system, base, t1=12.0, y0=(0.3, 0.0)).evaluate(times)[0])
    seen = seen + 1e-4 * np.random.default_rng(2).normal(size=len(times))
    start = ss.MassSpring(1.0, 4.0, 1.0, guess)
    return ss.calibrate(start, base, times, {"position": seen}, wrt=("mu", "exponent"), y0=(0.3, 0.0), windows=1)


@pytest.mark.slow
def test_a_number_with_a_bound_is_recovered():
    one = found(Drag(0.5, 1.4), Drag(0.4, 2.0))
    assert one.converged
    assert abs(one["exponent"].value - 1.4) < 4 * one["exponent"].standard_error < 0.1


@pytest.mark.slow
def test_a_search_ends_inside_the_bounds_where_the_best_fit_is_outside():
    free = found(FreeDrag(0.5, 0.6), FreeDrag(0.4, 1.2))
    assert abs(free["exponent"].value - 0.6) < 4 * free["exponent"].standard_error < 0.1
    with pytest.warns(RuntimeWarning) as told:
        held = found(FreeDrag(0.5, 0.6), Drag(0.4, 1.2))
    assert any("exponent near 1" in str(one.message) and "it is at most 1.0" in str(one.message) for one in told)
    assert 1 <= held["exponent"].value < 1.01
