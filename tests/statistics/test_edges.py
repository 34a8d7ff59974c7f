"""No sticks, one sample, more orders than sticks, all cut: defined results, and no warning (they are errors)."""

import math

import jax
import numpy as np
import pytest
from support.statistics import made_up_sticks, statistics_of, sticks_from

import stickslip_jax as ss

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
DISTRIBUTIONS = ("start", "duration", "position", "slip_duration", "stick_count", "slip_count", "stick_fraction",
                 "own_mean_duration")  # fmt: skip
CUT = int(ss.Ending.HORIZON)


def everything_of(statistics):
    """All estimates, by name."""
    asked = {}
    for name in DISTRIBUTIONS:
        of = getattr(statistics, name)
        moments = (of.mean, of.variance, of.standard_deviation, of.skewness, of.median, of.quantile(0.9))
        estimates = (*moments, of.entropy(), of.differential_entropy, of.repeated_share)
        asked[name] = estimates
        histogram = of.histogram()
        assert len(histogram.edges) == len(histogram.counts) + 1
        assert histogram.counts.sum() == of.number
        assert repr(of)
        assert all(str(one) for one in estimates)
    for number in range(1, statistics.orders + 1):
        one = statistics.order(number)
        asked[number] = (one.share, one.start.mean, one.duration.mean, one.duration.median, one.position.mean)
    for pair in (("duration", "position"), ("start", "position"), (("duration", 1), ("duration", 2))):
        joint = statistics.joint(*pair)
        asked[pair] = (joint.correlation, joint.rank_correlation, joint.mutual_information())
        assert joint.histogram().counts.sum() == joint.number
        assert joint.conditional_mean().counts.sum() == joint.retained
        assert repr(joint)
    asked["endings"] = tuple(statistics.endings.values())
    assert statistics.to_xarray().sizes["order"] == statistics.orders
    return asked


def all_nan(estimates):
    return all(math.isnan(one.value) and math.isnan(one.standard_error) for one in estimates)


@pytest.mark.parametrize("samples", [0, 1, 5])
def test_no_sticks_at_all(samples):
    statistics = statistics_of(sticks_from([[]] * samples))
    asked = everything_of(statistics)
    assert statistics.duration.number == 0
    for name in ("start", "duration", "position", "own_mean_duration", ("duration", "position"), "endings"):
        assert all_nan(asked[name])
    assert all(one.duration.number == 0 for one in map(statistics.order, (1, 2, 3)))
    if samples:
        assert asked["stick_count"][0].value == 0
        assert asked[1][0].value == 0
        assert statistics.slip_duration.mean.value == 100.0
        assert statistics.stick_fraction.mean.value == 0
    else:
        assert all_nan(asked["stick_count"])


def test_one_realization_has_values_and_no_errors():
    statistics = statistics_of(sticks_from([[(1.0, 2.0, 0.5, 0), (3.0, 6.0, -0.5, 1), (99.0, 100.0, 0.1, CUT)]]))
    asked = everything_of(statistics)
    assert statistics.duration.mean.value == pytest.approx(5 / 3)
    assert statistics.slip_duration.number == 3
    assert statistics.endings[ss.Ending.HORIZON].value == pytest.approx(1 / 3)
    assert all(math.isnan(one.standard_error) for estimates in asked.values() for one in estimates)
    assert statistics.duration.mean.interval() == pytest.approx((math.nan, math.nan), nan_ok=True)
    assert "(no error from one sample)" in str(statistics.duration.mean)


def test_orders_beyond_any_count():
    statistics = statistics_of(made_up_sticks(np.random.default_rng(0), 20), orders=60)
    everything_of(statistics)
    last = statistics.order(60)
    assert last.share.value == 0
    assert last.duration.number == 0
    assert all_nan((last.duration.mean, last.start.median))
    assert statistics.joint(("duration", 59), ("duration", 60)).number == 0


def test_all_sticks_cut_by_the_horizon():
    rng = np.random.default_rng(1)
    statistics = statistics_of(sticks_from([[(start, 100.0, 0.0, CUT)] for start in 100 - rng.random(30)]))
    everything_of(statistics)
    assert statistics.endings[ss.Ending.HORIZON].value == 1
    assert statistics.endings[ss.Ending.HORIZON].standard_error == 0
    assert 0 < statistics.duration.mean.value < 1
    assert statistics.slip_duration.number == 30


def test_sticks_from_the_start_to_the_end_leave_no_slip():
    statistics = statistics_of(sticks_from([[(0.0, 100.0, 0.0, CUT)]] * 4))
    everything_of(statistics)
    assert statistics.slip_duration.number == 0
    assert statistics.stick_fraction.mean.value == 1
    assert statistics.duration.repeated_share.value == 0  # four values are too few to decide


@pytest.mark.slow
@pytest.mark.parametrize(("law", "y0", "t1"), [
    (ss.Constant(1.0), (30.0, 0.0), 0.5),  # slides all the time
    (ss.Constant(0.0), (0.0, 0.0), 5.0),  # at rest all the time
    (ss.PoissonSwitching(1.0, 1.0), (0.0, 1.0), 20.0),
])  # fmt: skip
@pytest.mark.parametrize("samples", [1, 3])
def test_ensembles_without_much_to_tell(law, y0, t1, samples):
    many = ss.simulate_ensemble(SYSTEM, law, t1=t1, samples=samples, key=jax.random.key(0), y0=y0, chunk=64)
    everything_of(many.statistics)
    text = repr(many.summary())
    assert "<td>number of sticks</td>" in many.summary()._repr_html_()
    assert ("There is no stick" in text) == (many.statistics.duration.number == 0)
    assert "nan" not in text


def test_bad_arguments_are_named(annotations_unchecked):
    made = statistics_of(made_up_sticks(np.random.default_rng(0), 5))
    for ask, message in (
        (lambda: made.duration.quantile(1.5), "Argument share must lie between 0 and 1"),
        (lambda: made.duration.quantile("half"), "Argument share must be a single real number"),
        (lambda: made.duration.histogram(0), "Argument bins must be a whole number of at least 1"),
        (lambda: made.duration.entropy(2.5), "Argument bins must be a whole number"),
        (lambda: made.order(4), r"Argument number must be at most 3, but 4 was given; call .*orders=4"),
        (lambda: made.order(0), "Argument number must be a whole number of at least 1"),
        (
            lambda: made.joint("length", "start"),
            "Argument x must be one of 'start', .* 'slip_before'",
        ),
        (
            lambda: made.joint("start", "duration 1"),
            r"Argument y must be one of .*, as in \('duration', 1\), but 'duration 1'",
        ),
        (lambda: made.joint("start", ("length", 1)), r"Argument y must be one of .* but \('length', 1\) was given"),
        (lambda: made.joint("start", ("duration", 0)), r"Argument y\[1\] must be a whole number of at least 1, but 0"),
        (lambda: made.joint("start", ("duration", 1, 2)), r"Argument y must be one of .* but \('duration', 1, 2\) was"),
        (lambda: made.joint(("start", 1), "duration"), "must both have the number of a stick"),
        (lambda: made.joint("start", ("duration", 2)), r"or neither, but 'start' and \('duration', 2\) were given"),
        (lambda: made.joint("start", "duration").histogram(200), "Argument bins must be at most 128"),
        (lambda: made.duration.mean.interval(1.0), "Argument level must lie between 0 and 1"),
        (lambda: ss.convergence(ss.stick_fraction, SYSTEM), "Argument ensemble must be the result"),
    ):
        with pytest.raises(ValueError, match=message):
            ask()


def test_arguments_of_what_needs_an_ensemble(tmp_path, annotations_unchecked):
    run = {"t1": 20.0, "key": jax.random.key(0), "y0": (0.0, 1.0), "chunk": 64}
    many = ss.simulate_ensemble(SYSTEM, ss.PoissonSwitching(1.0, 1.0), samples=3, **run)
    one = ss.simulate_ensemble(SYSTEM, ss.PoissonSwitching(1.0, 1.0), samples=1, **run)
    for ask, message in (
        (lambda: ss.simulate_ensemble(SYSTEM, ss.Constant(1.0), t1=1.0, samples=1, orders=0), "Argument orders must"),
        (lambda: many.write_sticks(tmp_path / "sticks.csv"), 'did not keep its sticks; call .*keep="sticks"'),
        (lambda: ss.convergence(ss.stick_fraction, one), "must hold 2 finished samples or more, but it has 1"),
        (lambda: ss.convergence(ss.stick_fraction, many, points=1), "Argument points must be a whole number"),
        (lambda: ss.histogram_convergence(many), "must hold 4 finished samples or more, but it has 3"),
        (
            lambda: ss.bootstrap_interval(ss.stick_fraction, many, resamples=5),
            "Argument resamples must be a whole number",
        ),
        (
            lambda: ss.convergence("stick_fraction", many),
            "Argument statistic must be a function such as stick_fraction",
        ),
        (lambda: ss.bootstrap_interval(ss.stick_fraction, many, level=90), "Argument level must lie between 0 and 1"),
    ):
        with pytest.raises(ValueError, match=message):
            ask()
    assert ss.bootstrap_interval(ss.stick_fraction, one) == pytest.approx((math.nan, math.nan), nan_ok=True)


@pytest.mark.slow
def test_motion_without_chance():
    """All samples are the same: every value repeats, and there is no spread to resample."""
    many = ss.simulate_ensemble(SYSTEM, ss.SquareWave(1.0, 2.6), t1=40.0, samples=50, y0=(0.0, 1.0), chunk=64)
    duration = many.statistics.duration
    assert duration.repeated_share.value == 1
    assert math.isnan(duration.differential_entropy.value)
    assert ss.bootstrap_interval(ss.stick_fraction, many) == pytest.approx((math.nan, math.nan), nan_ok=True)
