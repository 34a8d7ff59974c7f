"""Distributions and copulas refuse unsuitable arguments with one sentence that names the argument and its value."""

import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

# Users run without annotation checks: here the package's own checks must answer.
pytestmark = pytest.mark.usefixtures("annotations_unchecked")

NORMAL = ss.Normal(0.0, 1.0)
CASES = {
    "std": (lambda: ss.Normal(0.5, 0.0), "Argument std must be positive, but 0.0 was given."),
    "mean": (lambda: ss.Normal(math.nan, 1.0), "Argument mean must be finite, but nan was given."),
    "mean of an exponential": (lambda: ss.Exponential(-1.0), "Argument mean must be positive, but -1.0 was given."),
    "median": (lambda: ss.LogNormal(0.0, 0.1), "Argument median must be positive, but 0.0 was given."),
    "log_std": (lambda: ss.LogNormal(1.0, -0.1), "Argument log_std must be positive, but -0.1 was given."),
    "moments": (lambda: ss.LogNormal.from_moments(-1.0, 1.0), "Argument mean must be positive, but -1.0 was given."),
    "a": (lambda: ss.Beta(0.0, 1.0), "Argument a must be positive, but 0.0 was given."),
    "b": (lambda: ss.Beta(1.0, math.inf), "Argument b must be finite, but inf was given."),
    "high of a beta": (
        lambda: ss.Beta(1.0, 1.0, 2.0, 2.0),
        "Argument high must be above low = 2.0, but 2.0 was given.",
    ),
    "scale": (lambda: ss.Weibull(-2.0, 1.0), "Argument scale must be positive, but -2.0 was given."),
    "shape": (lambda: ss.Weibull(2.0, 1e-200), "between 1e-100 and 1e+100, but 1e-200 was given; choose other units."),
    "low": (lambda: ss.Uniform("0", 1.0), "Argument low must be a single real number, but '0' was given."),
    "no nesting": (lambda: ss.Uniform(NORMAL, 1.0), "Argument low must be a single real number, but Normal("),
    "no arrays": (lambda: ss.Uniform(0.0, np.ones(2)), "single real number, but an array of shape (2,) was given."),
    "order": (lambda: ss.Uniform(1.0, 0.5), "Argument high must be above low = 1.0, but 0.5 was given."),
    "mode": (
        lambda: ss.Triangular(0.0, 2.0, 1.0),
        "Argument mode must lie between low = 0.0 and high = 1.0, but 2.0 was given.",
    ),
    "values": (
        lambda: ss.Discrete([1.0, 1.0]),
        "Argument values must hold increasing numbers, but array([1., 1.]) was",
    ),
    "no values": (lambda: ss.Discrete([]), "Argument values must hold increasing numbers, but array([], "),
    "words": (lambda: ss.Discrete(["a"]), "Argument values must be a one-dimensional sequence of real numbers, but"),
    "sum": (
        lambda: ss.Discrete([1.0, 2.0], [0.5, 0.4]),
        "Argument probabilities must hold one number for each of the 2 values, with sum 1, but array([0.5, 0.4]) was",
    ),
    "number": (
        lambda: ss.Discrete([1.0, 2.0], [1.0]),
        "one number for each of the 2 values, with sum 1, but array([1.])",
    ),
    "negative": (
        lambda: ss.Discrete([1.0, 2.0], [-0.5, 1.5]),
        "Argument probabilities must be zero or positive, but array([-0.5, 1.5]) was given.",
    ),
    "limits": (lambda: ss.Truncated(NORMAL, 1.0, 1.0), "Argument high must be above low = 1.0, but 1.0 was given."),
    "nothing left": (
        lambda: ss.Truncated(ss.Uniform(0.0, 1.0), 2.0, 3.0),
        "must leave some draws of Uniform(low=0.0, high=1.0), but none lies between 2.0 and 3.0.",
    ),
    "far tail": (
        lambda: ss.Truncated(NORMAL, 7.5),
        "but only 3.2e-14 of them lie between 7.5 and None, and float64 tells too few of their probabilities apart; "
        "take limits nearer to the median.",
    ),
    "discrete": (
        lambda: ss.Truncated(ss.Discrete([1.0, 2.0]), 1.0),
        "Argument distribution must be continuous, but Discrete(values=",
    ),
    "no distribution": (
        lambda: ss.Truncated(0.5, 0.0),
        "must be a distribution of stickslip_jax such as Normal(mean, std), but 0.5 was given; of other distributions",
    ),
    "one name": (lambda: ss.GaussianCopula(["mu"], [[1.0]]), "two or more different names of random numbers"),
    "a word": (lambda: ss.GaussianCopula("mu", np.eye(2)), "such as ('mu', 'stiffness'), but 'mu' was given."),
    "same names": (lambda: ss.GaussianCopula(["mu", "mu"], np.eye(2)), "but ['mu', 'mu'] was given."),
    "shape of the matrix": (
        lambda: ss.GaussianCopula(["a", "b", "c"], np.eye(2)),
        "Argument correlation must have shape (3, 3), a row and a column for each of the names, but an array of shape",
    ),
    "one number": (lambda: ss.GaussianCopula(["a", "b"], 0.5), "Argument correlation must be a 2-dimensional array of"),
    "asymmetric": (
        lambda: ss.GaussianCopula(["a", "b"], [[1.0, 0.5], [0.4, 1.0]]),
        "must be symmetric, but correlation[0, 1] = 0.5 and correlation[1, 0] = 0.4 were given.",
    ),
    "covariance": (
        lambda: ss.GaussianCopula(["a", "b"], [[1.0, 0.5], [0.5, 4.0]]),
        "must have 1 on its diagonal, but correlation[1, 1] = 4.0 was given; divide covariances by both standard",
    ),
    "indefinite": (
        lambda: ss.GaussianCopula(["a", "b"], [[1.0, 1.5], [1.5, 1.0]]),
        "must be positive definite, or no random numbers exist, but the smallest eigenvalue of it is -0.5; make",
    ),
    "missing": (
        lambda: ss.GaussianCopula(["a", "b"], [[1.0, math.nan], [math.nan, 1.0]]),
        "Argument correlation must be finite, but",
    ),
    "ranks": (
        lambda: ss.GaussianCopula.from_spearman(["a", "b"], [[1.0, 1.0], [1.0, 1.0]]),
        "Argument matrix must be positive definite, or no random numbers exist, but the smallest eigenvalue of it is",
    ),
    "numbers to correlate": (
        lambda: ss.GaussianCopula(["a", "b"], np.eye(2)).correlated(jnp.full((4, 3), 0.5)),
        "must have a last dimension of 2, one number for each of a, b, but an array of shape (4, 3) was given.",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_unsuitable_arguments_are_refused_in_a_sentence(case):
    make, part = CASES[case]
    with pytest.raises(ValueError, match=re.escape(part)) as caught:
        make()
    sentence = str(caught.value)
    assert re.match(r"Arguments? \w+", sentence)
    assert sentence.endswith(".")
    assert "\n" not in sentence


def test_rank_correlations_that_only_other_copulas_have():
    """Their matrix is positive definite, that of the normal scores is not."""
    ranks = [[1.0, 0.68, 0.68], [0.68, 1.0, -0.073], [0.68, -0.073, 1.0]]
    smallest = np.linalg.eigvalsh(2 * np.sin(np.pi / 6 * np.asarray(ranks)))[0]
    assert np.linalg.eigvalsh(ranks)[0] > 1e-3
    assert smallest < 0
    sentence = f"the smallest eigenvalue of 2 sin(pi rho / 6) is {smallest:.3g};"
    with pytest.raises(ValueError, match=re.escape(sentence)):
        ss.GaussianCopula.from_spearman(["a", "b", "c"], ranks)


def test_limits_that_float32_cannot_tell_apart():
    """What is fine in float64 is refused where JAX computes in float32."""
    assert ss.Truncated(NORMAL, 4.0).low == 4.0
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(
            ValueError, match=r"float32 tells too few of their probabilities apart; .* jax_enable_x64 on"
        ):
            ss.Truncated(NORMAL, 4.0)
        assert ss.Truncated(NORMAL, high=-4.0).high == -4.0  # probabilities near 0 are exact
    finally:
        jax.config.update("jax_enable_x64", True)


def test_traced_numbers_pass_unchecked():
    """Nobody knows them yet. What comes out of unsuitable ones is NaN, or outside."""
    made = jax.jit(lambda low, high: ss.Uniform(low, high).icdf(jnp.asarray([0.5])))
    assert float(made(1.0, 0.0)[0]) == 0.5
    root = jax.jit(
        lambda r: ss.GaussianCopula(["a", "b"], jnp.stack([jnp.stack([1.0, r]), jnp.stack([r, 1.0])])).correlated(
            jnp.full((1, 2), 0.3)
        )
    )
    assert np.isnan(root(2.0)[0, 1])
