"""Several statistics from the same samples, arithmetic with errors, slips, outputs; parameters that act as one."""

import math
import warnings

import jax
import numpy as np
import pytest
from scipy.integrate import quad

import stickslip_jax as ss

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.9))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
RUN = {"t1": 20.0, "samples": 2048, "y0": (0.0, 0.5), "key": jax.random.key(1)}


@pytest.fixture(scope="module")
def both():
    return ss.sensitivity([ss.mean_stick_duration, "stick_fraction"], SYSTEM, POISSON, wrt=("mu", "speed"), **RUN)


@pytest.mark.slow
def test_the_same_as_alone(both):
    assert list(both) == [ss.mean_stick_duration, "stick_fraction"]
    for statistic in (ss.mean_stick_duration, ss.stick_fraction):
        alone = ss.sensitivity(statistic, SYSTEM, POISSON, wrt=("mu", "speed"), **RUN)
        for name, one in alone.items():
            assert both[statistic.name][name] == one
            assert one.estimator == "corrected"


@pytest.mark.slow
def test_kinds_are_mixed():
    """Those of totals, of single sticks and of slips at once, all by differences of the same trajectories."""
    asked = [ss.mean_slip_count, ss.StickDuration(1), ss.mean_stick_count]
    found = ss.sensitivity(asked, SYSTEM, POISSON, wrt="mu", step=0.01, **RUN)
    for statistic in asked:
        alone = ss.sensitivity(statistic, SYSTEM, POISSON, wrt="mu", step=0.01, **RUN)
        assert found[statistic].derivative == pytest.approx(alone.derivative, rel=1e-12)
        assert found[statistic].standard_error == pytest.approx(alone.standard_error, rel=1e-9)
    corrected = ss.sensitivity(
        [ss.StickDuration(1), ss.mean_stick_count], SYSTEM, POISSON, wrt="mu", estimator="corrected", **RUN
    )
    difference = corrected[ss.mean_stick_count] - found[ss.mean_stick_count].derivative
    assert abs(float(difference)) < 5 * math.hypot(difference.standard_error, found[ss.mean_stick_count].standard_error)


@pytest.mark.parametrize("statistic", [ss.mean_slip_count, ss.mean_slip_duration])
def test_slips_between_ensembles(statistic):
    """Against the difference between two ensembles with other keys."""
    found = ss.sensitivity(statistic, SYSTEM, POISSON, wrt="mu", step=0.05, **RUN)
    assert found.estimator == "finite-difference"
    low, high = (
        statistic(ss.simulate_ensemble(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu)), POISSON, keep="totals",
            **{**RUN, "samples": 40_000, "key": jax.random.key(seed)},
        ))
        for mu, seed in ((0.855, 2), (0.945, 3))
    )  # fmt: skip
    slope = (high - low) / 0.09
    assert abs(found.derivative - slope.value) < 4 * math.hypot(found.standard_error, slope.standard_error)
    with pytest.raises(ValueError, match="for outputs and statistics of slips"):
        ss.sensitivity(statistic, SYSTEM, POISSON, wrt="mu", estimator="corrected", **RUN)


@pytest.mark.slow
def test_errors_of_what_is_the_same():
    """The mean total stick time is ``t1`` times the stick fraction: nothing is left of the difference."""
    found = ss.sensitivity([ss.stick_fraction, ss.mean_total_stick_time], SYSTEM, POISSON, wrt="mu", **RUN)
    fraction, time = found[ss.stick_fraction], found[ss.mean_total_stick_time]
    left = time / 20.0 - fraction * ss.Estimate("1 s", 1.0, 0.0, "s", 2)
    assert abs(float(left)) < 1e-12
    assert left.standard_error < 1e-7 * fraction.standard_error
    ratio = time / fraction
    assert (ratio.value, ratio.unit) == (pytest.approx(20.0, rel=1e-12), "s")
    assert ratio.standard_error < 1e-6


@pytest.mark.slow
def test_arithmetic(both):
    a, b = both[ss.mean_stick_duration]["mu"], both["stick_fraction"]["mu"]
    assert (2 * a).standard_error == pytest.approx(2 * a.standard_error, rel=1e-12)
    assert ((a - a).value, (a - a).standard_error) == (0.0, 0.0)
    assert float(a) == a.derivative
    assert (-a).value == -a.derivative
    assert (a / b).name == "d(mean stick duration (pooled))/d(mu) / d(stick fraction)/d(mu)"
    assert both[ss.mean_stick_duration]["speed"].estimate.unit == "s^2/m"
    with pytest.raises(ValueError, match="Estimates must have one unit to be added"):
        _ = a + b
    other = ss.sensitivity(ss.stick_fraction, SYSTEM, POISSON, wrt="mu", **RUN)  # how they are correlated is not known
    assert math.isnan((a / other).standard_error)


@pytest.mark.slow
@pytest.mark.parametrize("elasticity", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_errors_of_combinations_are_honest(elasticity):
    """z-scores of independent repeats against their mean, and far from those that ignore the correlation.

    The standard deviation of 60 normal numbers has a relative error of 0.092: four of these on either side.
    """
    values, errors, naive = [], [], []
    for seed in range(60):
        run = {**RUN, "samples": 512, "key": jax.random.key(100 + seed)}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # few sticks in the windows
            found = ss.sensitivity(
                [ss.stick_fraction, ss.mean_total_stick_time, ss.mean_stick_duration], SYSTEM, POISSON,
                wrt=("mu", "speed"), elasticity=elasticity, **run,
            )  # fmt: skip
        a, b = found[ss.stick_fraction]["mu"], found[ss.stick_fraction]["speed"]
        c, d = found[ss.mean_stick_duration]["mu"], found[ss.mean_total_stick_time]["mu"]
        combined = (a / b, c / d)
        values.append([float(one) for one in combined])
        errors.append([one.standard_error for one in combined])
        naive.append([
            abs(float(one)) * math.hypot(above.standard_error / float(above), below.standard_error / float(below))
            for one, (above, below) in zip(combined, ((a, b), (c, d)), strict=True)
        ])  # fmt: skip
    z = (np.array(values) - np.mean(values, axis=0)) / np.array(errors)
    spread = z.std(axis=0, ddof=1)
    assert np.all((spread > 1 - 4 * 0.092) & (spread < 1 + 4 * 0.092)), spread
    ignored = ((np.array(values) - np.mean(values, axis=0)) / np.array(naive)).std(axis=0, ddof=1)
    assert ignored[0] < 1 - 4 * 0.092, ignored


def products(system, law, **run):
    """The warnings about parameters that act together."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ss.sensitivity(ss.mean_stick_duration, system, law, **{**RUN, **run})
    return [str(one.message) for one in caught if "act on this only through" in str(one.message)]


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["corrected", "finite-difference"])
def test_parameters_that_act_through_their_product_are_told(estimator):
    (told,) = products(SYSTEM, POISSON, wrt=("mu", "normal_force", "rate"), estimator=estimator)
    assert "through their product mu * normal_force" in told
    assert products(SYSTEM, POISSON, wrt=("mu", "speed"), estimator=estimator) == []


@pytest.mark.slow
def test_parameters_that_act_through_their_ratio_are_told():
    """From rest at the origin lengths have no scale of their own. (Differences only nearly show it.)"""
    (told,) = products(SYSTEM, POISSON, wrt=("mu", "speed"), y0=(0.0, 0.0))
    assert "through their ratio mu / speed" in told


@pytest.mark.slow
def test_the_mean_of_a_peak_in_closed_form():
    """The first maximum of a free vibration is ``-a + hypot(a, v / omega)`` with a = mu / 4, here v is uniform."""
    peak = ss.Output(lambda one: one.maximum("position"), name="peak displacement", unit="m")
    system, run = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), {**RUN, "t1": 3.0, "y0": (0.0, ss.Uniform(1.0, 2.0))}
    found = ss.sensitivity(peak, system, ss.Constant(0.0), wrt=("mu", "stiffness"), **run)
    by_mu = quad(lambda v: (-1 + 0.25 / math.hypot(0.25, v / 2)) / 4, 1.0, 2.0)[0]
    one = found["mu"]
    assert (one.statistic, one.unit, one.estimator) == ("mean peak displacement", "m", "finite-difference")
    assert abs(one.derivative - by_mu) < 4 * one.standard_error + 1e-4
    function = ss.differentiable(peak, system, ss.Constant(0.0), wrt="mu", **run)
    value, slope = jax.jit(jax.value_and_grad(function))(1.0)
    assert float(value) == pytest.approx(one.value, rel=1e-9)
    assert float(slope) == pytest.approx(one.derivative, rel=1e-4)


@pytest.mark.slow
def test_an_output_that_is_a_count():
    """As the statistic of totals, by the same differences; a pathwise derivative of it would be 0."""
    number = ss.Output(lambda one: one.sticks.count, name="number")
    found = ss.sensitivity([number, ss.mean_stick_count], SYSTEM, POISSON, wrt="rate", step=0.05, **RUN)
    assert found["number"].derivative == pytest.approx(found[ss.mean_stick_count].derivative, rel=1e-12)
    assert found["number"].standard_error == pytest.approx(found[ss.mean_stick_count].standard_error, rel=1e-9)
    function = ss.differentiable(number, SYSTEM, POISSON, wrt="rate", **RUN)
    assert float(function(1.0)) == pytest.approx(found["number"].value, rel=1e-12)
    with pytest.raises(ValueError, match="for outputs and statistics of slips"):
        ss.sensitivity(number, SYSTEM, POISSON, wrt="mu", estimator="corrected", **RUN)


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_lists():
    for wrong in ([], [ss.stick_fraction, ss.stick_fraction], [ss.stick_fraction, 3]):
        with pytest.raises(ValueError, match="Argument statistic must"):
            ss.sensitivity(wrong, SYSTEM, POISSON, wrt="mu", **RUN)
    with pytest.raises(ValueError, match="Argument statistic must be one statistic"):
        ss.differentiable([ss.stick_fraction], SYSTEM, POISSON, wrt="mu", **RUN)
