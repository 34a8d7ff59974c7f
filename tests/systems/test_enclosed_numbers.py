"""A function or class that encloses a number by which JAX differentiates: one sentence that says what to use."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

BASE = ss.Constant(0.3)
MESSAGE = r"\AArguments system and base must hold every number that JAX traces as a field, .* equinox\.Module "


class Falling(eqx.Module):
    high: float

    def __call__(self, speed):
        return self.high / (1 + speed)


def stick_time(system, base=BASE, **options):
    return ss.simulate(system, base, t1=5.0, method=ss.Exact(step=0.05, max_steps=512, **options)).stick_time


def by_lambda(high):
    return stick_time(ss.MassSpring(1.0, 4.0, 1.0, ss.FrictionCurve(lambda speed: high / (1 + speed))))


def by_module(high):
    return stick_time(ss.MassSpring(1.0, 4.0, 1.0, ss.FrictionCurve(Falling(high))))


def by_class(force):
    class Enclosing(ss.SwitchedSystem):
        @property
        def state_names(self):
            return "position in m", "velocity in m/s"

        def rates(self, t, y, base, friction):
            return y[1], -4.0 * y[0] - force * friction

        def relative_velocity(self, t, y, base):
            return y[1] - base.velocity

    return stick_time(Enclosing())


def by_regularised(high):
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.FrictionCurve(lambda speed: high / (1 + speed)))
    method = ss.Regularized(1e-2, step=0.05, threshold=1e-2, minimum_duration=0.1, max_steps=512)
    return ss.simulate(system, BASE, t1=5.0, method=method).stick_time


OTHERS = [(jax.jacfwd, by_lambda), (jax.grad, by_class), (jax.jacfwd, by_regularised)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("derivative", "function"),
    [
        *((jax.grad, by_lambda), (jax.jacfwd, by_class), (jax.grad, by_regularised)),
        *(pytest.param(*other, marks=pytest.mark.slow) for other in OTHERS),
    ],
)
def test_refused(derivative, function):
    with pytest.raises(ValueError, match=MESSAGE):
        derivative(function)(0.5)


@pytest.mark.slow
def test_what_is_recommended():
    """Of a module the derivative is that of differences; where nothing is differentiated, a function will do."""
    size = 1e-5
    slope = (by_lambda(0.5 + size) - by_lambda(0.5 - size)) / (2 * size)
    assert jax.grad(by_module)(0.5) == pytest.approx(float(slope), rel=1e-6)
    np.testing.assert_allclose(jax.vmap(by_lambda)(jnp.array([0.5, 0.6])), [by_module(0.5), by_module(0.6)], rtol=1e-12)


def test_other_errors_stay_as_they_are():
    class Wrong(ss.Signal):
        @property
        def shortest_period(self):
            return 1.0

        def value(self, t):
            raise TypeError("no value")

    with pytest.raises(TypeError, match="no value"):
        stick_time(ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3)), Wrong())
