"""Sobol' indices against SALib, scipy and closed forms (Ishigami, a model with noise); how often intervals hold."""

import math
import re

import numpy as np
import pandas as pd
import pytest
from SALib.analyze import sobol as salib_sobol
from scipy import stats

import stickslip_jax as ss

NAMES = ["x1", "x2", "x3"]
A, B = 7.0, 0.1


def ishigami(u):
    x = np.pi * (2 * u - 1)
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


# Ishigami and Homma 1990: variances of the parts of the function.
V1, V2 = (1 + B * np.pi**4 / 5) ** 2 / 2, A**2 / 8
V13 = B**2 * np.pi**8 * (1 / 18 - 1 / 50)
VARIANCE = V1 + V2 + V13
FIRST = np.array([V1, V2, 0]) / VARIANCE
TOTAL = np.array([V1 + V13, V2, V13]) / VARIANCE
PAIRS = [(0, 1), (0, 2), (1, 2)]
SECOND = np.array([0, V13, 0]) / VARIANCE


@pytest.mark.parametrize("second_order", [True, False])
def test_same_numbers_as_salib(second_order):
    design = ss.design.saltelli(64, NAMES, second_order=second_order, seed=2)
    y = ishigami(design.u) + 30.0
    ours = ss.sobol_indices(y, design, resamples=100)
    problem = {"num_vars": 3, "names": NAMES, "bounds": [[0, 1]] * 3}
    theirs = salib_sobol.analyze(problem, y, calc_second_order=second_order, num_resamples=100, seed=1)
    np.testing.assert_allclose(ours.first, theirs["S1"], rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(ours.total, theirs["ST"], rtol=1e-11)
    if second_order:
        np.testing.assert_allclose(
            ours.second[np.triu_indices(3, 1)], theirs["S2"][np.triu_indices(3, 1)], rtol=1e-10, atol=1e-13
        )
        np.testing.assert_array_equal(ours.second, ours.second.T)
        assert np.all(np.isnan(np.diag(ours.second)))
    else:
        assert ours.second is None


def test_errors_are_those_of_salib():
    """Standard errors from many resamples each differ by about 1 / sqrt(resamples) of themselves."""
    design = ss.design.saltelli(256, NAMES, seed=2)
    y = ishigami(design.u)
    ours = ss.sobol_indices(y, design, resamples=2000)
    problem = {"num_vars": 3, "names": NAMES, "bounds": [[0, 1]] * 3}
    theirs = salib_sobol.analyze(problem, y, num_resamples=2000, conf_level=0.9, seed=3)
    z = stats.norm.ppf(0.95)
    # Tails a little heavier than normal ones make the error of a standard deviation larger, by 1.5 here.
    allowed = 4 * 1.5 * math.sqrt(2 / 4000)
    pairs = np.triu_indices(3, 1)
    for mine, other in (
        (ours.first_error, theirs["S1_conf"]), (ours.total_error, theirs["ST_conf"]),
        (ours.second_error[pairs], theirs["S2_conf"][pairs]),
    ):  # fmt: skip
        np.testing.assert_allclose(mine, other / z, rtol=allowed)


def test_same_numbers_as_scipy():
    """But for the mean that is subtracted: scipy's is that of A and B alone, which first-order indices depend on."""
    design = ss.design.saltelli(128, NAMES, second_order=False, seed=4)
    y = ishigami(design.u)
    rows = y.reshape(128, 5)
    a, b, ab = rows[:, 0], rows[:, -1], rows[:, 1:-1].T
    func = {"f_A": a[None], "f_B": b[None], "f_AB": ab[:, None]}
    theirs = stats.sobol_indices(func=func, n=128)
    ours = ss.sobol_indices(y, design, resamples=100)
    np.testing.assert_allclose(ours.total, np.ravel(theirs.total_order), rtol=1e-11)
    moved = (np.concatenate([a, b]).mean() - y.mean()) * (ab - a).mean(axis=1) / np.concatenate([a, b]).var()
    np.testing.assert_allclose(ours.first - moved, np.ravel(theirs.first_order), rtol=1e-10, atol=1e-13)


def within(values, errors, exact, sigmas=4):
    return np.all(np.abs(np.asarray(values) - exact) <= sigmas * np.asarray(errors))


def test_ishigami():
    """On a Sobol' sequence bootstrap errors are too large: four of them hold the closed form with much room."""
    design = ss.design.saltelli(1024, NAMES, seed=6)
    found = ss.sobol_indices(ishigami(design.u), design)
    pairs = np.triu_indices(3, 1)
    assert within(found.first, found.first_error, FIRST)
    assert within(found.total, found.total_error, TOTAL)
    assert within(found.second[pairs], found.second_error[pairs], SECOND)
    assert found.total_error.max() < 0.06
    for value, interval in ((found.first, found.first_interval), (found.total, found.total_interval)):
        assert np.all((interval[0] < value) & (value < interval[1]))


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.9, 0.95])
def test_intervals_hold_the_exact_indices_as_often_as_they_say(level):
    """Of independent base rows, 300 times 9 indices. Percentile intervals of 256 rows are a little too narrow.

    The three indices of a factor depend on each other: as if only a third of the 2,700 were independent.
    """
    rng, rows, repeats = np.random.default_rng(8), 256, 300
    template = ss.design.saltelli(rows, NAMES, seed=0)
    rows_of = template.u.reshape(rows, 8, 3)
    from_b = rows_of == rows_of[:, -1:]
    hits = 0
    for _ in range(repeats):
        a, b = rng.uniform(size=(2, rows, 1, 3))
        y = ishigami(np.where(from_b, b, a).reshape(-1, 3))
        found = ss.sobol_indices(y, template, level=level, resamples=200, seed=int(rng.integers(2**31)))
        i, j = np.triu_indices(3, 1)
        for interval, exact in (
            (found.first_interval, FIRST), (found.total_interval, TOTAL), (found.second_interval[:, i, j], SECOND),
        ):  # fmt: skip
            hits += int(np.sum((interval[0] <= exact) & (exact <= interval[1])))
    share = hits / (9 * repeats)
    assert abs(share - level) < 4 * math.sqrt(level * (1 - level) / (3 * repeats))


# A model with noise: the output is x1 + x2 w + c e, all of the five numbers normal, w and e those of the realisation.
C = 0.8
NOISY = {"x1": 1.0, "x2 w": 1.0, "e": C**2}
NOISE_VARIANCE = sum(NOISY.values())


def noisy(design, seed=1):
    rng = np.random.default_rng(seed)
    w, e = rng.standard_normal((2, design.realization.max() + 1))[:, design.realization]
    x = stats.norm.ppf(design.u)
    return x[:, 0] + x[:, 1] * w + C * e


def test_noise_is_an_input_like_others_in_shared_realizations():
    design = ss.design.saltelli(4096, ["x1", "x2"])
    found = ss.sobol_indices(noisy(design), design)
    assert within(found.first, found.first_error, np.array([1, 0]) / NOISE_VARIANCE)
    assert within(found.total, found.total_error, np.array([1, 1]) / NOISE_VARIANCE)
    assert found.total_error.max() < 0.02


def test_indices_of_the_realization_itself():
    """Noise alone, and with x2 together, as one more factor."""
    design = ss.design.saltelli(4096, ["x1", "x2"], realization="factor")
    found = ss.sobol_indices(noisy(design), design)
    assert found.factors == ("x1", "x2", "realization")
    assert within(found.first, found.first_error, np.array([1, 0, C**2]) / NOISE_VARIANCE)
    assert within(found.total, found.total_error, np.array([1, 1, 1 + C**2]) / NOISE_VARIANCE)
    pairs = np.triu_indices(3, 1)
    assert within(found.second[pairs], found.second_error[pairs], np.array([0, 0, 1]) / NOISE_VARIANCE)


def test_own_realizations_put_the_noise_into_every_total_index():
    design = ss.design.saltelli(4096, ["x1", "x2"], realization="own")
    found = ss.sobol_indices(noisy(design), design)
    assert within(found.first, found.first_error, np.array([1, 0]) / NOISE_VARIANCE)
    assert within(found.total, found.total_error, np.array([2 + C**2, 1 + C**2]) / NOISE_VARIANCE)


def test_one_realization_for_all():
    """The indices of x1 + w x2, w that of the realisation."""
    design = ss.design.saltelli(1024, ["x1", "x2"], realization="common")
    w = np.random.default_rng(1).standard_normal((2, 1))[0, 0]
    found = ss.sobol_indices(noisy(design), design)
    exact = np.array([1, w**2]) / (1 + w**2)
    assert within(found.first, found.first_error, exact)
    assert within(found.total, found.total_error, exact)


def test_mean_over_realizations():
    """Of outputs averaged over r realisations of each sample, the noise is 1 / r of what it was (own realisations)."""
    design, repeats = ss.design.saltelli(2048, ["x1", "x2"], realization="own"), 16
    mean = np.mean([noisy(design, seed) for seed in range(repeats)], axis=0)
    found = ss.sobol_indices(mean, design)
    noise = (1 + C**2) / repeats
    assert within(found.first, found.first_error, np.array([1, 0]) / (1 + noise))
    assert within(found.total, found.total_error, np.array([1 + noise, noise]) / (1 + noise))


@pytest.fixture(scope="module")
def several():
    design = ss.design.saltelli(32, NAMES)
    y = ishigami(design.u)
    return design, y, {"mean": y, "square": y**2}


def test_several_outputs_at_once(several):
    """Each as if alone."""
    design, y, named = several
    alone = ss.sobol_indices(y, design, resamples=100)
    for outputs, names in (
        (np.stack([y, y**2], axis=1), ("output 0", "output 1")),
        (named, ("mean", "square")),
        (pd.DataFrame(named), ("mean", "square")),
    ):
        found = ss.sobol_indices(outputs, design, resamples=100)
        assert found.outputs == names
        for name in ("first", "first_error", "first_interval", "total", "second", "second_interval"):
            np.testing.assert_allclose(getattr(found, name)[..., 0], getattr(alone, name), rtol=1e-12)
        np.testing.assert_allclose(found.total[:, 1], ss.sobol_indices(y**2, design, resamples=100).total, rtol=1e-12)


def test_labelled_arrays(several):
    design, _, named = several
    found = ss.sobol_indices(named, design, resamples=100, level=0.8)
    dataset = found.to_xarray()
    assert dict(dataset.sizes) == {"factor": 3, "other_factor": 3, "interval_end": 2, "output": 2}
    one = dataset.second_interval.sel(factor="x1", other_factor="x3", output="square", interval_end="high")
    assert float(one) == found.second_interval[1, 0, 2, 1]
    assert dataset.attrs["level"] == 0.8
    assert dataset.attrs["samples"] == 32 * 8
    first_only = ss.design.saltelli(32, NAMES, second_order=False)
    small = ss.sobol_indices(ishigami(first_only.u), first_only, resamples=100).to_xarray()
    assert dict(small.sizes) == {"factor": 3, "interval_end": 2}
    np.testing.assert_array_equal(small["total"], ss.sobol_indices(ishigami(first_only.u), first_only).total)


def test_what_is_printed(several):
    design, y, _ = several
    lines = repr(ss.sobol_indices(y, design)).splitlines()
    assert lines[0] == "Sobol' indices from 32 base rows (256 samples), with 95 % bootstrap intervals"
    assert [line.split("  ")[0].strip() for line in lines[2:5]] == NAMES
    found = ss.sobol_indices(y, design)
    low, high = found.first_interval[:, 0]
    assert lines[2].startswith(f"x1  {found.first[0]:7.4f} [{low:7.4f}, {high:7.4f}]  {found.total[0]:7.4f} [")
    assert len(lines) == 5
    lines = found.table(second_order=True).splitlines()
    assert [line.split("  ")[0] for line in lines[6:]] == ["x1, x2", "x1, x3", "x2, x3"]
    assert lines[6].split()[2] == f"{found.second[0, 1]:.4f}"
    without = ss.sobol_indices(y[:160], ss.design.saltelli(32, NAMES, second_order=False))
    with pytest.raises(ValueError, match="Argument second_order must be False for a design without rows for it"):
        without.table(second_order=True)
    text = repr(ss.sobol_indices(np.stack([y] * 6, axis=1), design))
    assert "output 3:" in text
    assert text.endswith("and 2 more outputs")


def test_a_constant_output_has_no_indices(several):
    design, y, _ = several
    found = ss.sobol_indices(np.stack([np.full(len(y), 0.1), y], axis=1), design, resamples=100)
    assert np.all(np.isnan(found.first[:, 0]))
    assert np.all(np.isnan(found.total_interval[..., 0]))
    assert np.all(np.isfinite(found.total[:, 1]))


@pytest.mark.usefixtures("annotations_unchecked")
def test_unsuitable_arguments(several):
    design, y, _ = several
    missing = y.copy()
    missing[[6, 9]] = np.nan
    for make, part in (
        (
            lambda: ss.sobol_indices(y[:-1], design),
            "Argument outputs must hold a number for each of the 256 samples of the",
        ),
        (lambda: ss.sobol_indices({"a": y, "b": y[:3]}, design), "(samples,) or (samples, outputs), but {'a': array("),
        (
            lambda: ss.sobol_indices(["a"] * 256, design),
            "Argument outputs must hold a number for each of the 256 samples",
        ),
        (lambda: ss.sobol_indices({}, design), "(samples,) or (samples, outputs), but {} was given."),
        (
            lambda: ss.sobol_indices(missing, design),
            "but 2 of 256 samples are not, the first one outputs[6] = nan; take",
        ),
        (
            lambda: ss.sobol_indices(y, ss.design.sobol(256, NAMES)),
            "must be made by stickslip_jax.design.saltelli, but <sobol",
        ),
        (lambda: ss.sobol_indices(y, None), "must be made by stickslip_jax.design.saltelli, but None was given."),
        (
            lambda: ss.sobol_indices(y, design, level=90),
            "Argument level must lie between 0 and 1, such as 0.95, but 90 was",
        ),
        (
            lambda: ss.sobol_indices(y, design, resamples=10),
            "Argument resamples must be a whole number of at least 100, but",
        ),
        (
            lambda: ss.sobol_indices(y, design, seed=-1),
            "Argument seed must be a whole number of at least 0, but -1 was",
        ),
    ):
        with pytest.raises(ValueError, match=re.escape(part)) as caught:
            make()
        assert str(caught.value).startswith("Argument ")
        assert str(caught.value).endswith(".")
