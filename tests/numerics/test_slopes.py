"""Derivatives by a few numbers that are computed along with a loop: those of JAX, without a way back over the steps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import stickslip_jax as ss
from stickslip_jax._numerics.derivatives import with_slopes

POINT = (0.7, 1.3, 0.4)
STEPS = 5


def loop(a, b, c):
    """``x -> a x + b`` from c, so often: ``a^n c + b (a^n - 1) / (a - 1)``; and the number of steps."""
    (x, count), seen = lax.scan(lambda s, _: ((a * s[0] + b, s[1] + 1), s[0]), (c, 0), None, length=STEPS)
    return {"end": x, "count": count, "seen": seen}


def closed_form(a, b, c):
    return a**STEPS * c + b * (a**STEPS - 1) / (a - 1)


def end(*numbers):
    return with_slopes(loop, *numbers, most=2)["end"]


def loops_back(function, *args):
    """Whether the program goes back over a loop."""
    return "reverse=True" in str(jax.make_jaxpr(function)(*args))


@pytest.mark.slow_but_for("grad-by1")
@pytest.mark.parametrize("by", [(0,), (2,), (0, 1), (0, 1, 2)])
@pytest.mark.parametrize("mode", [jax.grad, jax.jacfwd])
def test_derivatives_are_those_of_the_closed_form(by, mode):
    found, right = mode(end, by)(*POINT), jax.grad(closed_form, by)(*POINT)
    np.testing.assert_allclose(found, right, rtol=1e-13)
    many = jax.vmap(lambda a: jnp.stack(mode(end, by)(a, *POINT[1:])))(jnp.linspace(0.2, 0.8, 3))
    each = [jax.grad(closed_form, by)(a, *POINT[1:]) for a in (0.2, 0.5, 0.8)]
    np.testing.assert_allclose(many, each, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev])
def test_second_derivatives(inner, outer):
    by = (0, 2)
    found = outer(inner(end, by), by)(*POINT)
    np.testing.assert_allclose(found, jax.hessian(closed_form, by)(*POINT), rtol=1e-12)


def test_only_derivatives_by_more_numbers_go_back_over_the_loop():
    assert not loops_back(jax.grad(end, (0, 1)), *POINT)
    assert loops_back(jax.grad(end, (0, 1, 2)), *POINT)
    assert loops_back(jax.grad(lambda many: with_slopes(lambda m: loop(*m), many, most=3)["end"]), jnp.array(POINT))


def test_numbers_that_the_function_encloses_count():
    def enclosing(a):
        return with_slopes(lambda b: loop(a * b, b, 0.4), 1.3, most=2)["end"]

    right = jax.grad(lambda a: closed_form(1.3 * a, 1.3, 0.4))(0.7)
    for derivative in (jax.grad(enclosing), jax.jit(jax.grad(enclosing)), jax.jacfwd(enclosing)):
        assert float(derivative(0.7)) == pytest.approx(float(right), rel=1e-13)


def test_other_results_stay_what_they_are():
    found = with_slopes(loop, *POINT, most=2)
    assert int(found["count"]) == STEPS
    assert jax.linearize(lambda a: with_slopes(loop, a, *POINT[1:], most=2)["seen"], 0.7)[1](1.0).shape == (STEPS,)


@pytest.mark.slow_but_for("time steps")
@pytest.mark.parametrize(
    ("base", "method"),
    [
        (ss.Harmonic(1.0, 1.3), ss.Exact(step=0.1)),
        (ss.Harmonic(1.0, 1.3), ss.Regularized(1e-2, step=0.05)),
    ],
    ids=["time steps", "regularised"],
)
def test_gradients_by_one_number_do_not_go_back_over_the_steps(base, method):
    """Nor do they keep anything of each step: what a gradient costs does not depend on the way back."""

    def stick_time(mu):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return ss.simulate(system, base, t1=5.0, method=method).stick_time

    assert not loops_back(jax.grad(stick_time), 0.5)
