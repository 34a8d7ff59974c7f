"""The log likelihood of a record, against simulations, central differences, `calibrate`, and Laplace's covariance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import stickslip_jax as ss

TIMES = np.linspace(0.0, 12.0, 121)
SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
BASE = ss.Harmonic(0.5, 0.7)
START = (0.3, 0.1)
NOISE = {"position": 0.01, "velocity": 0.02}


def motion(system, base=BASE, y0=START, **options):
    one = ss.simulate(system, base, t1=float(TIMES[-1]), y0=y0, **options)
    assert one.status == ss.Status.FINISHED
    return np.asarray(one.evaluate(TIMES))


@pytest.fixture(scope="module")
def record():
    noise = np.random.default_rng(0).normal(size=(2, len(TIMES))) * [[0.01], [0.02]]
    position, velocity = motion(SYSTEM) + noise
    velocity[[3, 50]] = np.nan
    return {"position": position, "velocity": velocity}


@pytest.fixture(scope="module")
def likelihood(record):
    return ss.log_likelihood(SYSTEM, BASE, TIMES, record, wrt=("mu", "y0[0]", "stiffness"), noise=NOISE, y0=START)


@pytest.fixture(scope="module")
def compiled(likelihood):
    return jax.jit(jax.value_and_grad(likelihood))


def directly(record, mu, y0, stiffness, noise=NOISE):
    seen = motion(ss.MassSpring(1.0, float(stiffness), 1.0, ss.Coulomb(float(mu))), y0=(float(y0), START[1]))
    parts = [stats.norm.logpdf(record[name], row, noise[name]) for name, row in zip(record, seen, strict=True)]
    return np.nansum(parts)


POINTS = np.array([[0.7, 0.3, 4.0], [0.62, 0.28, 4.2], [0.9, -0.2, 2.5]])


@pytest.mark.slow
@pytest.mark.parametrize("point", POINTS)
def test_values_are_those_of_simulations(record, compiled, point):
    assert_allclose(compiled(jnp.asarray(point))[0], directly(record, *point), rtol=1e-10)


@pytest.mark.slow
def test_a_motion_with_sticks_was_tried():
    sticks = ss.simulate(SYSTEM, BASE, t1=float(TIMES[-1]), y0=START).sticks
    assert np.count_nonzero(np.asarray(sticks.duration) > 0) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("point", POINTS)
def test_derivatives_are_those_of_differences(record, compiled, point):
    step = 1e-5
    for i, derivative in enumerate(compiled(jnp.asarray(point))[1]):
        up, down = (directly(record, *(point + sign * step * np.eye(3)[i])) for sign in (1, -1))
        assert_allclose(derivative, (up - down) / (2 * step), rtol=1e-5, atol=1e-3)


@pytest.mark.slow
def test_second_derivatives_are_those_of_differences(likelihood, compiled):
    step, point = 1e-5, POINTS[0]
    steps = step * np.eye(3)
    differences = [(compiled(jnp.asarray(point + h))[1] - compiled(jnp.asarray(point - h))[1]) / 2e-5 for h in steps]
    assert_allclose(jax.jit(jax.hessian(likelihood))(point), differences, rtol=1e-5, atol=1)


@pytest.mark.slow
def test_names_batches_and_transformations_give_the_same(likelihood, compiled):
    of_array = jax.vmap(jax.value_and_grad(likelihood))(POINTS)
    by_name = dict(zip(likelihood.names, POINTS.T, strict=True))
    of_names = jax.jit(jax.vmap(jax.value_and_grad(likelihood)))(by_name)
    for row, point in enumerate(POINTS):
        value, slope = compiled(jnp.asarray(point))
        assert_allclose(of_array[0][row], value, rtol=1e-12)
        assert_allclose(of_names[0][row], value, rtol=1e-12)
        assert_allclose(of_array[1][row], slope, rtol=1e-9, atol=1e-6)
        assert_allclose([of_names[1][name][row] for name in likelihood.names], slope, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_noise_of_the_call_takes_precedence(record, likelihood):
    @jax.jit
    def by_noise(sigma):
        return likelihood(POINTS[1], noise={"velocity": sigma})

    for sigma in (0.02, 0.05):
        expected = directly(record, *POINTS[1], noise={"position": 0.01, "velocity": sigma})
        assert_allclose(by_noise(sigma), expected, rtol=1e-10)
    slope = (by_noise(0.05 + 1e-6) - by_noise(0.05 - 1e-6)) / 2e-6
    assert_allclose(jax.grad(by_noise)(0.05), slope, rtol=1e-6)
    assert by_noise(-0.05) == -np.inf
    assert jax.grad(by_noise)(-0.05) == 0


@pytest.mark.slow
@pytest.mark.parametrize("point", [(-0.1, 0.3, 4.0), (0.7, 0.3, -4.0), (np.nan, 0.3, 4.0), (0.7, np.inf, 4.0)])
def test_impossible_numbers(compiled, point):
    value, slope = compiled(jnp.asarray(point))
    assert value == -np.inf
    assert_allclose(slope, 0)


@pytest.mark.slow
def test_a_motion_that_needs_more_steps_than_there_are(record):
    few = ss.log_likelihood(
        SYSTEM, BASE, TIMES, record, wrt="stiffness", noise=NOISE, y0=START, method=ss.Exact(max_steps=32)
    )
    value, slope = jax.value_and_grad(few)(jnp.asarray([4.0]))
    assert value == -np.inf
    assert_allclose(slope, 0)


@pytest.mark.slow
def test_a_channel_that_has_no_value():
    def root(one, times):
        return jnp.sqrt(one.evaluate(times)[0] - 10.0)

    of = ss.log_likelihood(
        SYSTEM, BASE, TIMES, {"root": 0 * TIMES}, wrt="mu", noise={"root": 1.0}, y0=START, observe={"root": root}
    )
    value, slope = jax.value_and_grad(of)(jnp.asarray([0.7]))
    assert value == -np.inf
    assert_allclose(slope, 0)


@pytest.mark.slow
def test_static_friction_below_kinetic_friction_is_impossible(record):
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7, mu_static=0.8))
    of = ss.log_likelihood(system, BASE, TIMES, record, wrt=("friction.mu", "mu_static"), noise=NOISE, y0=START)
    of = jax.jit(of)
    assert np.isfinite(of(jnp.asarray([0.7, 0.7])))
    assert of(jnp.asarray([0.7, 0.69])) == -np.inf


@pytest.mark.slow
def test_the_start_is_one_of_rest_by_default(record):
    of = ss.log_likelihood(SYSTEM, BASE, TIMES, record, wrt=("y0[0]", "y0[1]"), noise=NOISE)
    assert_allclose(of.first_guess, 0)
    assert_allclose(of(jnp.asarray(START)), directly(record, 0.7, START[0], 4.0), rtol=1e-10)


@pytest.mark.slow
def test_smoothed_friction(record):
    method = ss.Regularized(1e-2, step=1e-2, max_steps=2000)
    of = ss.log_likelihood(SYSTEM, BASE, TIMES, record, wrt="mu", noise=NOISE, y0=START, method=method)
    seen = motion(SYSTEM, method=method)
    parts = [stats.norm.logpdf(record[name], row, NOISE[name]) for name, row in zip(record, seen, strict=True)]
    assert_allclose(of({"mu": 0.7}), np.nansum(parts), rtol=1e-10)


@pytest.mark.slow
def test_single_precision(record):
    with jax.enable_x64(False):
        with pytest.warns(UserWarning, match="float32"):
            of = ss.log_likelihood(SYSTEM, BASE, TIMES, record, wrt=("mu", "y0[0]", "stiffness"), noise=NOISE, y0=START)
        value = of(jnp.asarray(POINTS[0], jnp.float32))
    assert value.dtype == np.float32
    assert_allclose(value, directly(record, *POINTS[0]), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_the_largest_value_is_where_calibrate_finds_it(record, compiled):
    found = ss.calibrate(SYSTEM, BASE, TIMES, record, wrt=("mu", "stiffness"), noise=NOISE, y0=START, windows=1)
    of = jax.jit(jax.value_and_grad(lambda x: compiled(jnp.stack([x[0], jnp.asarray(START[0]), x[1]]))[0]))
    best = np.array([found["mu"].value, found["stiffness"].value])
    errors = np.sqrt(np.diag(found.covariance))
    # The estimate is held loosely at the first guess; a step of Newton's from it is far below its standard error.
    newton = found.covariance @ np.asarray(of(jnp.asarray(best))[1])
    assert np.all(np.abs(newton) < 1e-3 * errors)


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_laplace_covariance_is_that_of_the_posterior(record, compiled):
    """Rejection-free check on a grid of importance weights: the posterior is nearly Gaussian here."""
    found = ss.calibrate(SYSTEM, BASE, TIMES, record, wrt=("mu", "stiffness"), noise=NOISE, y0=START, windows=1)
    best, samples = np.array([found["mu"].value, found["stiffness"].value]), 2000
    draws = np.random.default_rng(1).multivariate_normal(best, 1.5 * found.covariance, size=samples)
    points = np.insert(draws, 1, START[0], axis=1)
    log_weight = jax.lax.map(lambda point: compiled(point)[0], jnp.asarray(points), batch_size=250)
    log_weight = np.asarray(log_weight) - stats.multivariate_normal.logpdf(draws, best, 1.5 * found.covariance)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    effective = 1 / np.sum(weight**2)
    assert effective > samples / 4
    errors = np.sqrt(np.diag(found.covariance))
    mean = weight @ draws
    z = (mean - best) / errors * np.sqrt(effective)
    assert np.all(np.abs(z) < 4.5)
    spread = np.sqrt(weight @ (draws - mean) ** 2)
    assert_allclose(spread, errors, rtol=4.5 / np.sqrt(2 * effective))


BAD = [
    ({"wrt": "nu"}, "Argument wrt must name one of"),
    ({"wrt": ("mu", "mu")}, "Argument wrt must be a parameter's name or several different ones"),
    ({"wrt": "y0[2]"}, "Argument wrt must name one of"),
    ({"noise": {"angle": 1.0}}, "Argument noise must name channels of measured"),
    ({"noise": {"position": -1.0}}, r"Argument noise\['position'\] must be positive"),
    ({"y0": (1.0,)}, "Argument y0 must be two numbers"),
    ({"base": ss.PoissonSwitching(1.0, 1.0)}, "Argument base must be a realisation"),
    ({"times": TIMES[::-1]}, "Argument times must be at least two increasing times"),
    ({"measured": {"angle": TIMES}}, "Argument measured must have channels called"),
    ({"method": "exact"}, "Argument method must be"),
]


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_arguments(record, change, message):
    given = {"system": SYSTEM, "base": BASE, "times": TIMES, "measured": record, "wrt": "mu"} | change
    with pytest.raises(ValueError, match=message):
        ss.log_likelihood(**given)


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("values", "noise", "message"),
    [
        ({"mu": 0.7}, {}, "Argument values must hold a number for each of mu, y0"),
        ([0.7, 0.3], {}, r"Argument values must hold one number for each of mu, .* shape \(2,\)"),
        (POINTS, {}, "call it under jax.vmap"),
        ({"mu": [0.7], "y0[0]": 0.3, "stiffness": 4.0}, {}, "Argument values must hold single numbers"),
        (POINTS[0], {"angle": 0.1}, "Argument noise must name channels of measured"),
        (POINTS[0], 0.1, "Argument noise must be a dict"),
    ],
)
def test_bad_calls(likelihood, values, noise, message):
    with pytest.raises(ValueError, match=message):
        likelihood(values, noise=noise)


@pytest.mark.usefixtures("annotations_unchecked")
def test_noise_that_is_nowhere_given(record):
    of = ss.log_likelihood(SYSTEM, BASE, TIMES, record, wrt="mu", noise={"position": 0.01})
    with pytest.raises(ValueError, match="that of 'velocity' is missing"):
        of({"mu": 0.7})


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_samples_by_numpyro_are_those_of_laplace(record):
    import numpyro  # noqa: PLC0415 - takes seconds
    from numpyro import distributions  # noqa: PLC0415
    from numpyro.infer import MCMC, NUTS  # noqa: PLC0415

    found = ss.calibrate(SYSTEM, BASE, TIMES, record, wrt=("mu", "stiffness"), noise=NOISE, y0=START, windows=1)
    of = ss.log_likelihood(SYSTEM, BASE, TIMES, record, wrt=("mu", "stiffness"), noise=NOISE, y0=START)

    def model():
        mu = numpyro.sample("mu", distributions.Uniform(0.0, 2.0))
        stiffness = numpyro.sample("stiffness", distributions.Uniform(1.0, 8.0))
        numpyro.factor("record", of({"mu": mu, "stiffness": stiffness}))

    start = {"mu": found["mu"].value, "stiffness": found["stiffness"].value}
    kernel = NUTS(model, init_strategy=numpyro.infer.init_to_value(values=start))
    chain = MCMC(kernel, num_warmup=300, num_samples=1000, progress_bar=False)
    chain.run(jax.random.key(0), extra_fields=("diverging",))
    assert np.sum(chain.get_extra_fields()["diverging"]) == 0
    for name, samples in chain.get_samples().items():
        effective = numpyro.diagnostics.effective_sample_size(np.asarray(samples)[None])
        error = found[name].standard_error
        assert effective > 100
        assert abs(np.mean(samples) - found[name].value) < 4.5 * error / np.sqrt(effective)
        assert_allclose(np.std(samples), error, rtol=4.5 / np.sqrt(2 * effective))
