"""Parameters from recordings of sticks: they are recovered, and their errors are what repeats scatter by."""

import re
import warnings
from functools import cache

import jax
import matplotlib as mpl
import numpy as np
import pytest
from scipy import stats

import stickslip_jax as ss
from stickslip_jax import plot

mpl.use("Agg")

T1, START = 30.0, (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))
TRUE = {"mu": 1.2, "rate": 0.9}
RECORDINGS, SAMPLES = 64, 2048
SETS = 200
# With 2,048 the moments' derivatives by the rate are not always clearly more than their own error: "not determined".
FOR_COVERAGE = {"moments": 2 * SAMPLES, "likelihood": SAMPLES}


def system(mu=TRUE["mu"]):
    return ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=mu))


def law(rate=TRUE["rate"], speed=0.7):
    return ss.PoissonSwitching(speed=speed, rate=rate)


@cache
def recorded(number, mu=TRUE["mu"], seed=7):
    """Sticks of so many recordings, one after the other."""
    many = ss.simulate_ensemble(
        system(mu), law(), t1=T1, samples=number, key=jax.random.key(seed), y0=START, keep="sticks", progress=False
    )
    sticks = many.finished_sticks()
    return sticks.sample, sticks.start, sticks.duration


def observed(which=0, recordings=RECORDINGS, sets=SETS, **options):
    """The `which`-th set of recordings, as measured sticks."""
    sample, start, duration = recorded(recordings * sets, **options)
    own = sample // recordings == which
    table = {"sample": sample[own] - which * recordings, "start": start[own], "duration": duration[own]}
    return ss.Ensemble.from_sticks(table, t1=T1, samples=recordings)


def fitted(data, wrt=("mu", "rate"), key=1, samples=SAMPLES, **options):
    given = {"system": system(), "law": law(), "y0": START} | options
    return ss.calibrate_sticks(
        given.pop("system"), given.pop("law"), data, wrt=wrt, samples=samples, key=jax.random.key(key), **given
    )


@pytest.fixture(scope="module")
def found():
    return fitted(observed(), system=system(0.8), law=law(0.6))


@pytest.mark.slow
def test_parameters_are_recovered_from_far_guesses(found):
    """Within 4 standard errors: by chance outside once in 16,000 times."""
    for name, true in TRUE.items():
        assert abs(found[name].value - true) < 4 * found[name].standard_error
        assert found[name].standard_error < 0.15 * true
    assert (found["mu"].unit, found["rate"].unit) == ("1", "1/s")
    assert list(found) == ["mu", "rate"]
    assert found.converged
    assert found.remarks == ()
    assert found.system.friction.mu == found["mu"].value
    assert found.law.rate == found["rate"].value
    assert (found.recordings, found.samples, found.unfinished) == (RECORDINGS, SAMPLES, 0)


@pytest.mark.slow
def test_observed_moments_are_those_of_the_ensemble(found):
    data = observed()
    time, count, squares, first = (one.observed for one in found.moments)
    for one, own in ((time, ss.mean_total_stick_time(data)), (count, ss.mean_stick_count(data))):
        assert (one.value, one.standard_error) == pytest.approx((own.value, own.standard_error))
    sticks = data.finished_sticks()
    each = np.bincount(sticks.sample, sticks.duration**2, minlength=RECORDINGS)
    assert squares.value == pytest.approx(each.mean())
    assert squares.standard_error == pytest.approx(each.std(ddof=1) / np.sqrt(RECORDINGS))
    starts = np.where(sticks.count > 0, sticks.start[np.minimum(sticks.first, len(sticks.start) - 1)], T1)
    assert first.value == pytest.approx(starts.mean())


@pytest.mark.slow
def test_estimates_know_their_correlation(found):
    both = found["mu"] * found["rate"]
    mu, rate = (found[name].value for name in TRUE)
    slope = np.array([rate, mu])
    assert both.standard_error == pytest.approx(np.sqrt(slope @ found.covariance @ slope))
    assert np.diag(found.correlation) == pytest.approx([1, 1])
    assert found.overidentification.degrees_of_freedom == 2
    assert found.overidentification.p_value == pytest.approx(stats.chi2.sf(found.overidentification.statistic, 2))


@pytest.mark.slow
def test_result_tells_itself(found):
    said = repr(found)
    assert said.startswith(f"{found['mu']}\n{found['rate']}\nHansen's test: ")
    assert all(str(one) in said for one in found.moments)
    assert re.search(r"mean number of sticks: [0-9.]+ \+- [0-9.]+, fitted [0-9.]+ \+- [0-9.]+, z = [+-][0-9.]+", said)
    assert "Hansen" in found._repr_html_()
    ax = plot.calibration_moments(found)
    assert [label.get_text() for label in ax.get_yticklabels()] == [one.observed.name for one in found.moments[::-1]]
    (container,) = ax.containers
    worst = found.moments[-1]
    assert container[0].get_xdata()[0] == pytest.approx(
        100 * (worst.observed.value - worst.fitted.value) / worst.fitted.value
    )


@pytest.mark.usefixtures("annotations_unchecked")
def test_figure_of_something_else():
    with pytest.raises(ValueError, match=r"\AArgument result must be what calibrate_sticks returned, but 3 was given"):
        plot.calibration_moments(3)


@pytest.mark.slow
def test_both_derivatives_lead_to_the_same():
    """The corrected derivative and central differences, from the same recordings and random numbers."""
    moments = [ss.mean_total_stick_time, ss.mean_stick_count]
    one, other = (fitted(observed(), moments=moments, estimator=of) for of in ("corrected", "finite-difference"))
    for name in TRUE:
        # Two moments and two parameters: both are where all moments agree, but for jumps of the simulated means.
        assert abs(one[name].value - other[name].value) < 0.3 * one[name].standard_error
        assert one[name].standard_error == pytest.approx(other[name].standard_error, rel=0.3)
    assert one.overidentification.degrees_of_freedom == 0
    assert np.isnan(one.overidentification.p_value)
    assert one.overidentification.statistic < 0.1


@pytest.mark.slow
def test_several_experiments_share_parameters():
    """Two base speeds, one of them fitted: times tell mu from the speed where another speed is known."""
    options = {"t1": T1, "samples": RECORDINGS, "y0": START, "keep": "sticks", "progress": False}
    sample = [
        ss.simulate_ensemble(system(), law(speed=speed), key=jax.random.key(number), **options)
        for number, speed in enumerate((0.7, 1.0))
    ]
    both = fitted(sample, law=[law(0.8, 0.7), law(0.8, 1.0)])
    one = fitted(sample[0], law=law(0.8, 0.7))
    for name, true in TRUE.items():
        assert abs(both[name].value - true) < 4 * both[name].standard_error
        assert both[name].standard_error < one[name].standard_error
    assert [fit.experiment for fit in both.moments] == [0] * 4 + [1] * 4
    assert both.overidentification.degrees_of_freedom == 6
    assert both.recordings == 2 * RECORDINGS
    assert "experiment 1, mean number of sticks" in repr(both)


@pytest.mark.slow
def test_products_are_refused():
    with pytest.raises(ValueError, match=r"mu and normal_force act on this only through their product mu \* normal"):
        fitted(observed(), ("mu", "normal_force"))


@pytest.mark.slow
def test_wrong_model_is_told():
    """Recordings of a stiffer spring than the model's."""
    stiff = ss.MassSpring(mass=1.0, stiffness=4.5, normal_force=1.0, friction=ss.Coulomb(mu=1.2))
    wrong = ss.simulate_ensemble(
        stiff, law(), t1=T1, samples=1000, key=jax.random.key(3), y0=START, keep="sticks", progress=False
    )
    with pytest.warns(RuntimeWarning, match="The model cannot have all moments at once"):
        assert fitted(wrong).overidentification.p_value < 1e-3


def many_fits(objective):
    """Estimates, their errors, whether their intervals hold the truth, and p-values, of all data sets."""
    values, errors, covered, p_values = [], [], [], []
    for which in range(SETS):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = fitted(observed(which), key=100 + which, objective=objective, samples=FOR_COVERAGE[objective])
        values.append([found[name].value for name in TRUE])
        errors.append([found[name].standard_error for name in TRUE])
        covered.append([low < true < high for (low, high), true in
                        zip((found[name].interval() for name in TRUE), TRUE.values(), strict=True)])  # fmt: skip
        p_values.append(found.overidentification.p_value if found.overidentification else np.nan)
    return tuple(map(np.array, (values, errors, covered, p_values)))


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["moments", "likelihood"])
def test_intervals_cover_the_truth(objective):
    """Of 200 data sets 92 to 98 % of the 95 % intervals, of both parameters; errors are what estimates scatter by.

    Simulations have random numbers of their own for each data set.
    """
    values, errors, covered, p_values = many_fits(objective)
    shares = covered.mean(axis=0)
    assert np.all((shares >= 0.92) & (shares <= 0.98)), shares
    # A standard deviation from 200 numbers has an error of 5 %; four of them.
    assert values.std(axis=0, ddof=1) == pytest.approx(np.sqrt((errors**2).mean(axis=0)), rel=0.2)
    if objective == "moments":
        assert stats.kstest(p_values, "uniform").pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # remarks of a few of so many data sets
def test_naive_derivative_would_give_wrong_errors():
    """The mean stick duration as the only moment: 60 estimates scatter as is said, and not as by the pathwise part."""
    moments, number = [ss.mean_stick_duration], 60
    slope = ss.sensitivity(
        ss.mean_stick_duration, system(), law(), wrt="mu", t1=T1, samples=8192, key=jax.random.key(2), y0=START
    )
    estimates = [fitted(observed(which), "mu", key=500 + which, moments=moments)["mu"] for which in range(number)]
    squares = np.array([((one.value - TRUE["mu"]) / one.standard_error) ** 2 for one in estimates])
    low, high = stats.chi2(number).ppf([1e-4, 1 - 1e-4])
    assert low < squares.sum() < high
    assert squares.sum() * (slope.pathwise / slope.derivative) ** 2 > high


def scattered(median, log_std):
    """Specimens whose friction coefficients differ."""
    return system(ss.LogNormal(median, log_std))


@pytest.mark.slow
def test_likelihood_tells_what_means_do_not():
    """How much friction differs between specimens hardly changes means, but how recordings scatter."""
    data = ss.simulate_ensemble(
        scattered(1.2, 0.15), law(), t1=T1, samples=200, key=jax.random.key(5), y0=START, keep="sticks", progress=False
    )
    wrt, true = ("mu.median", "mu.log_std"), (1.2, 0.15)
    moments = [ss.mean_total_stick_time, ss.mean_stick_count]
    options = {"system": scattered(1.0, 0.05), "moments": moments, "samples": 4096}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        by_means = fitted(data, wrt, **options)
    assert not by_means["mu.log_std"].standard_error < 0.1
    found = fitted(data, wrt, objective="likelihood", **options)
    for name, value in zip(wrt, true, strict=True):
        assert abs(found[name].value - value) < 4 * found[name].standard_error
    assert found["mu.log_std"].standard_error < 0.04
    assert found.curvature_errors["mu.log_std"] == pytest.approx(found["mu.log_std"].standard_error, rel=0.5)
    assert found.overidentification is None


@pytest.mark.slow
def test_likelihood_of_few_recordings():
    """Two recordings, too few for a covariance of four moments: 30 pairs scatter as is said."""
    with pytest.raises(ValueError, match=r"at least 6 recordings for the covariance of 4 moments, but it holds 2; .*"):
        fitted(observed(recordings=2))
    found = [fitted(observed(which, recordings=2), "mu", key=700 + which, objective="likelihood")["mu"]
             for which in range(30)]  # fmt: skip
    squares = [((one.value - TRUE["mu"]) / one.standard_error) ** 2 for one in found]
    low, high = stats.chi2(30).ppf([1e-4, 1 - 1e-4])
    assert low < sum(squares) < high


@pytest.mark.slow
def test_threads_change_nothing(found):
    again = fitted(observed(), system=system(0.8), law=law(0.6), threads=1)
    assert again["mu"].value == found["mu"].value
    assert again["rate"].standard_error == found["rate"].standard_error
