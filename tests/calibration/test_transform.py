"""Numbers with bounds as functions of coordinates: inverse, derivatives, and searches that stay inside."""

from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._calibration.parameters import Transform, transform_of
from stickslip_jax._uncertainty.numbers import Parameter

INF = np.inf
# Linear from 0, linear, above 0, above 1, below 3, between 0 and 1; at least 0, from 0 to 3.
START = np.array([0.0, -2.0, 0.5, 2.0, -4.0, 0.3, 0.5, 2.0])
LOW = np.array([-INF, -INF, 0.0, 1.0, -INF, 0.0, 0.0, 0.0])
HIGH = np.array([INF, INF, INF, INF, 3.0, 1.0, INF, 3.0])
CLOSED = np.array([0, 0, 0, 0, 0, 0, 1, 1])
OF = Transform(START, LOW, HIGH, CLOSED, np.array([1, 2, 1, 1, 1, 1, 1, 3]), np.zeros((8, 8)))


def test_first_guess_is_the_origin():
    np.testing.assert_allclose(OF.numbers(np.zeros(8)), START, rtol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("x", [-30.0, -3.0, -1.0, 0.5, 30.0])
def test_values_derivatives_and_bounds(x):
    """Against closed forms; the derivatives against those of JAX, which are finite."""
    ends = OF.box
    x = np.clip(np.full(8, x), *ends)
    found, e = OF.numbers(x), np.exp(x[0])
    least = 0.5 * e if x[0] > -np.log(10) else 0.05 * (1 + np.log(10) + x[6])
    expected = [x[0], -2 + 2 * x[0], 0.5 * e, 1 + e, 3 - 7 / e, 1 / (1 + 7 / 3 / e), least, 2 + 3 * x[7]]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
    assert np.all((found >= LOW) & (found <= HIGH))
    traced = jax.jacfwd(OF.numbers)(jax.numpy.asarray(x))
    np.testing.assert_allclose(traced, OF.slopes(found), rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(OF.numbers(jax.numpy.asarray(x)), found, rtol=1e-5, atol=1e-7)


def test_bounds_that_a_number_may_have_are_reached():
    ends = np.array(OF.box)
    assert np.all(np.isinf(ends[:, :6]))
    np.testing.assert_array_equal(OF.numbers(np.where(np.isinf(ends[0]), 0, ends[0]))[6:], 0)
    np.testing.assert_allclose(OF.numbers(np.where(np.isinf(ends[1]), 0, ends[1]))[7], 3, rtol=1e-15)


@pytest.mark.slow
def test_static_friction_is_counted_from_kinetic_friction():
    """Both searched: 0 and 0.5 above it at the guess; one alone: the other bounds it."""
    law = ss.Stribeck(0.4, 0.9, 0.1)
    both = tuple(Parameter(name, ("law", name), getattr(law, name)) for name in ("mu_static", "mu"))
    of = transform_of(One(law), both)
    np.testing.assert_array_equal(of.added, [[0, 1], [0, 0]])
    np.testing.assert_allclose(of.numbers(np.zeros(2)), [0.9, 0.4], rtol=1e-15)
    x = np.array([of.box[0][0], 0.3])
    static, kinetic = of.numbers(x)
    assert static == kinetic == 0.4 * np.exp(0.3)
    for at in (x, np.array([0.2, -4.0]).clip(*of.box)):
        traced = jax.jacfwd(of.numbers)(jax.numpy.asarray(at))
        np.testing.assert_allclose(traced, of.slopes(of.numbers(at)), rtol=1e-5, atol=1e-12)
    assert transform_of(One(law), both[:1]).low == [0.4]
    assert transform_of(One(law), both[1:]).high == [0.9]
    with pytest.raises(ValueError, match=r"inside their bounds, above 0\.4, but mu_static = 0\.4 was given"):
        transform_of(One(ss.Coulomb(0.4, 0.4)), (Parameter("mu_static", ("law", "mu_static"), 0.4),))
    curve = ss.FrictionCurve.from_table([0.0, 1.0], [0.3, 0.2], mu_static=0.5)
    assert transform_of(One(curve), (Parameter("mu_static", ("law", "mu_static"), 0.5),)).low == [0.3]


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
    assert any("exponent is at its bound, 1," in str(one.message) for one in told)
    assert held["exponent"].value == 1
    assert 1 < (held.bounds["exponent"].high or 0) < 1.01
