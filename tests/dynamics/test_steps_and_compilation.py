"""How many steps there is room for; loops that stop early and compile small: time steps under transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

import stickslip_jax as ss
from stickslip_jax._compiler.native import sharing
from stickslip_jax._dynamics.common.path import CHECK_EVERY, padded_length, stopping_scan
from stickslip_jax._numerics.derivatives import NotKnown, bounds_of
from stickslip_jax._numerics.elementary import sincos

BASE, T1, START = ss.Harmonic(1.0, 0.8), 10.0, (0.3, 0.0)
SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
METHODS = {"exact": ss.Exact(), "regularised": ss.Regularized(0.05, step=0.02)}


def stick_time(mu, stiffness=4.0, frequency=0.8, t1=T1, method=METHODS["exact"]):
    system = ss.MassSpring(1.0, stiffness, 1.0, ss.Coulomb(mu))
    return ss.simulate(system, ss.Harmonic(1.0, frequency), t1=t1, y0=START, method=method).stick_time


def central(function, at, width=1e-5):
    return float((function(at + width) - function(at - width)) / (2 * width))


SLOPES = {
    "grad": lambda f: jax.grad(f)(1.0),
    "grad under jit": lambda f: jax.jit(jax.grad(f))(1.0),
    "forward": lambda f: jax.jacfwd(f)(1.0),
    "vmap of grad": lambda f: jax.vmap(jax.grad(f))(jnp.ones(2))[0],
    "grad of vmap": lambda f: jax.grad(lambda x: jax.vmap(f)(x).sum())(jnp.ones(2))[0],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "slope_of",
    [
        # Of these two the derivative is one compilation; of the others it is several.
        slope_of if name == "grad under jit" else pytest.param(slope_of, marks=pytest.mark.slow)
        for name, slope_of in SLOPES.items()
    ],
    ids=SLOPES,
)
def test_the_number_of_steps_need_not_be_given_for_what_no_time_scale_depends_on(slope_of):
    """The step depends on the natural period and the base's alone, and they are known."""
    assert float(slope_of(stick_time)) == pytest.approx(central(stick_time, 1.0), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["stiffness", *(pytest.param(name, marks=pytest.mark.slow) for name in ("frequency", "t1"))]
)
def test_nor_where_values_are_known_under_derivatives_and_vmap(name):
    def told(value):
        return stick_time(1.0, **{name: value})

    at = {"stiffness": 4.0, "frequency": 0.8, "t1": T1}[name]
    slope = central(told, at)
    assert float(jax.grad(told)(at)) == pytest.approx(slope, rel=1e-4)
    assert float(jax.jvp(told, (at,), (1.0,))[1]) == pytest.approx(slope, rel=1e-4)
    several = jax.vmap(told)(at * jnp.array([1.0, 1.1]))
    assert np.asarray(several) == pytest.approx([float(told(at)), float(told(1.1 * at))], abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_under_jit_an_error_says_what_number_to_give(method):
    how, kind = METHODS[method], type(METHODS[method]).__name__
    with pytest.raises(ValueError, match=rf"max_steps, {kind}\(.*max_steps=\d+ is room for 100 s in steps of 0\.\d+ s"):
        jax.jit(lambda t1: stick_time(1.0, t1=t1, method=how))(T1)
    if method == "exact":
        with pytest.raises(ValueError, match=r"max_steps=256 is room for 10 s in steps of 0\.123 s; too many cost"):
            jax.jit(lambda stiffness: stick_time(1.0, stiffness))(4.0)


def test_what_is_known_of_a_traced_number():
    seen = []

    def look(x):
        seen.append(bounds_of(x))
        return x * x

    jax.grad(lambda x: jax.vmap(jax.grad(look))(x).sum())(jnp.arange(3.0))
    jax.jvp(jax.vmap(jax.vmap(look)), (jnp.arange(6.0).reshape(2, 3),), (jnp.ones((2, 3)),))
    assert seen == [(0.0, 2.0), (0.0, 5.0)]
    with pytest.raises(NotKnown):
        jax.jit(look)(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", [ss.Exact(step=0.19), pytest.param(ss.Regularized(0.05, step=0.02), marks=pytest.mark.slow)]
)
def test_spare_steps_change_no_number(method):
    def told(mu, most):
        how = ss.Exact(step=method.step, max_steps=most) if isinstance(method, ss.Exact) else ss.Regularized(
            0.05, step=0.02, max_steps=most
        )  # fmt: skip
        return stick_time(mu, method=how)

    mus = jnp.array([0.8, 1.0, 1.2])
    with_slopes = [jax.value_and_grad(lambda mu, most=most: told(mu, most)) for most in (600, 20000)]
    few, many = (jax.jit(jax.vmap(function))(mus) for function in with_slopes)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12), few, many)


def test_steps_after_the_end_are_not_computed():
    """Counted by calls back at each check: the batch ends at the second of forty."""
    done = []

    def follow(x):
        def turn(carry, index):
            x, turns = carry
            jax.lax.cond(index % CHECK_EVERY == 0, lambda: jax.debug.callback(lambda: done.append(1)), lambda: None)
            return (jnp.sin(x), turns + 1), x

        (x, _), _ = stopping_scan(
            turn, (x, 0), 40 * CHECK_EVERY, lambda carry, _: carry[1] >= 2 * CHECK_EVERY - 1, lambda carry: carry[0]
        )
        return x

    points = jnp.linspace(0.1, 1.0, 4)
    jax.block_until_ready(jax.vmap(follow)(points))
    jax.effects_barrier()
    assert 2 <= len(done) <= 2 * len(points)


@pytest.mark.slow
def test_the_question_whether_all_have_ended_stays_one_question():
    """Asked of each lane, both branches would be computed always: the condition has no batch."""
    method = ss.Exact(step=0.19, max_steps=640)
    for transform in (lambda f: f, jax.grad):
        text = jax.make_jaxpr(jax.vmap(transform(lambda mu: stick_time(mu, method=method))))(jnp.ones(3))
        conditions = [equation for equation in equations_of(text.jaxpr) if equation.primitive.name == "cond"]
        assert conditions
        assert all(equation.invars[0].aval.shape == () for equation in conditions)


def equations_of(jaxpr):
    for equation in jaxpr.eqns:
        yield equation
        for inner in jaxprs_in_params(equation.params):
            yield from equations_of(getattr(inner, "jaxpr", inner))


def compiled_size(harmonics):
    tones = np.linspace(0.3, 3.0, harmonics)
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0), force=ss.SumOfHarmonics(tones, tones))
    method = ss.Exact(step=0.05, max_steps=64)

    def told(amplitudes):
        return ss.simulate(system, ss.SumOfHarmonics(amplitudes, tones), t1=1.0, method=method).stick_time

    return jax.jit(told).lower(tones).as_text().count("\n")


@pytest.mark.slow
def test_sums_of_harmonics_compile_to_the_same_size_whatever_their_number():
    assert compiled_size(3) == compiled_size(40)


def test_padded_lengths_are_few():
    sizes = [padded_length(number) for number in range(1, 5000)]
    assert len(set(sizes)) < 20
    assert all(number <= size <= max(CHECK_EVERY, 1.5 * number) for number, size in enumerate(sizes, 1))


@pytest.mark.slow
def test_what_is_shared_is_computed_once_and_right():
    def function(x, y):
        sine, cosine = sincos(x * y)
        dear = jnp.exp(x) / (1 + y * y) + sine
        return {"sum": dear + x, "product": (dear * cosine, sincos(x * y)[0] - dear)}

    shared = sharing(function)
    modes = (lambda f: jax.jacfwd(f, argnums=(0, 1)), lambda f: jax.jacrev(f, argnums=(0, 1)))
    for transform in (lambda f: f, jax.jit, *modes):
        got, expected = transform(shared)(0.7, 1.3), transform(function)(0.7, 1.3)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-14), got, expected)
    names = [equation.primitive.name for equation in equations_of(jax.make_jaxpr(shared)(0.7, 1.3).jaxpr)]
    assert names.count("exp") == 1
    assert names.count("custom_jvp_call") == 1


def test_what_is_shared_may_print():
    """As in a law of a user's own: printing has no results, which every other operation has."""
    seen = []

    def function(x):
        jax.debug.callback(lambda value: seen.append(float(value)), x)
        return jnp.exp(x) + 2 * jnp.exp(x)

    assert jax.jit(sharing(function))(0.0) == 3.0
    jax.effects_barrier()
    assert seen == [0.0]


@pytest.mark.slow_but_for("1")
@pytest.mark.parametrize("number", [0, 1, 17, 4096, 4097, 150_000])
def test_any_number_of_times_is_evaluated_in_parts_of_few_sizes(number):
    """Of the last part, what fills it up is not seen."""
    one = ss.simulate(SYSTEM, ss.Harmonic(1.0, 1.0), t1=20.0, y0=(0.0, 1.0))
    times = np.random.default_rng(0).uniform(-1.0, 21.0, number)
    position, velocity = one.evaluate(times)
    assert position.shape == velocity.shape == one.base_velocity(times).shape == (number,)
    assert position.dtype == velocity.dtype == jnp.result_type(float)
    within = (times >= 0) & (times <= 20)
    assert (np.isfinite(position) == within).all()
    traced = jax.jit(lambda t: (*one.evaluate(t), one.base_velocity(t)))(times)
    for found, whole in zip((position, velocity, one.base_velocity(times)), traced, strict=True):
        np.testing.assert_allclose(found, whole, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_short_simulations_share_a_program():
    """Of whatever length: room for 256 steps is room for all of them. A batch takes the room that it needs."""

    def slots(t1):
        return ss.simulate(SYSTEM, ss.Harmonic(1.0, 1.0), t1=t1, y0=(0.0, 1.0)).step_starts.shape

    assert slots(1.0) == slots(7.0) == slots(20.0)
    many = jax.vmap(lambda v: ss.simulate(SYSTEM, ss.Harmonic(1.0, 1.0), t1=1.0, y0=(0.0, v)).step_starts)(jnp.ones(2))
    assert many.shape[1:] < slots(1.0)
