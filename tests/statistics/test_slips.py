"""Statistics of slips: starts and durations, of all and by order, and tests on instants."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import FlatSticks, slips_among
from stickslip_jax._statistics.quantities import ordinal

KEY = jax.random.key(2)
SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)


@pytest.fixture(scope="module")
def many():
    return ss.simulate_ensemble(SYSTEM, LAW, t1=20.0, samples=150, key=KEY, y0=(0.0, 1.0), keep="sticks")


def test_by_hand():
    """Three sticks and a cut one; no stick; a stick from t = 0: slips before, between and after."""
    start, end = np.array([1.0, 3.0, 8.5, 0.0]), np.array([2.0, 5.0, 9.0, 4.0])
    ending = np.array([0, 1, 2, 0])
    sticks = FlatSticks.of(np.array([3, 0, 1]), start, end, ending)
    slips = slips_among(sticks, 9.0)
    np.testing.assert_array_equal(slips.sample, [0, 0, 0, 1, 2])
    np.testing.assert_array_equal(slips.start, [0, 2, 5, 0, 4])
    np.testing.assert_array_equal(slips.duration, [1, 1, 3.5, 9, 5])
    np.testing.assert_array_equal(slips.order, [1, 2, 3, 1, 1])
    np.testing.assert_array_equal(slips.censored, [False, False, False, True, True])
    only_second = slips_among(sticks, 9.0, finished=np.array([False, True, False])).sample
    np.testing.assert_array_equal(only_second, [0, 0, 0, 1, 2])  # those of samples with sticks are always there


def error_of_ratio(values, mask):
    """Standard error of the mean of all `values` in the `mask`, (samples, slots) (Cochran 1977, chapter 6)."""
    residuals = np.where(mask, values - values[mask].mean(), 0).sum(axis=1)
    return np.sqrt(residuals.var(ddof=1) * len(mask)) / mask.sum()


def test_distributions_are_those_of_the_slips(many):
    slips, statistics = many.slips, many.statistics.slips
    mask = np.asarray(slips.mask)
    for name, of in (("start", statistics.start), ("duration", statistics.duration)):
        values = np.asarray(getattr(slips, name))
        assert of.number == mask.sum()
        assert of.mean.value == pytest.approx(values[mask].mean(), rel=1e-13)
        assert of.variance.value == pytest.approx(values[mask].var(ddof=1), rel=1e-12)
        # The error of a ratio of sums over samples (Cochran 1977, chapter 6).
        residuals = np.where(mask, values - values[mask].mean(), 0).sum(axis=1)
        error = np.sqrt(residuals.var(ddof=1) * len(mask)) / mask.sum()
        assert of.mean.standard_error == pytest.approx(error, rel=1e-2)
        for number in (1, 2, 5, 9):
            column, has = values[:, number - 1], mask[:, number - 1]
            one = statistics.order(number)
            found = getattr(one, name)
            assert one.share.value == pytest.approx(has.mean())
            assert found.number == has.sum()
            assert found.mean.value == pytest.approx(column[has].mean(), rel=1e-13)
            assert found.mean.standard_error == pytest.approx(error_of_ratio(column[:, None], has[:, None]), rel=1e-9)
            assert f"{ordinal(number)} slip {name}" in found.mean.name
    assert many.statistics.slip_duration.mean.value == pytest.approx(statistics.duration.mean.value, rel=1e-13)


def test_shown_and_stored(many):
    text = str(many.summary())
    assert "Slips by order" in text
    assert "Sticks by order" in text
    assert "slip start" in repr(many.statistics.slips)
    assert "1st slip" in repr(many.statistics.slips.order(1))
    data = many.statistics.to_xarray()
    assert data.slip_start_by_order.attrs["units"] == "s"
    third = many.statistics.slips.order(3)
    assert float(data.slip_start_by_order.sel(order=3)) == third.start.mean.value
    assert float(data.slip_duration_by_order_error.sel(order=3)) == third.duration.mean.standard_error


def test_more_orders_than_there_are(many):
    none = many.statistics.slips.order(500)
    assert none.share.value == 0
    assert none.duration.number == 0
    with pytest.raises(ValueError, match="Argument number must be"):
        many.statistics.slips.order(0)


def test_instants_are_neither_independent_nor_identical():
    """Of a renewal process with gaps of one exponential law each instant is the sum of the gaps before it.

    So the Pearson correlation of the first two is ``1 / sqrt(2)``, and the rank correlation of ``E1`` and ``E1 + E2``
    lies near it; 4,000 samples give an error of 0.01.
    """
    rng = np.random.default_rng(4)
    slip, stick = rng.exponential(1.0, (4000, 6)), np.full((4000, 6), 1e-6)
    end = np.cumsum(slip + stick, axis=1)
    sticks = FlatSticks.of(np.full(4000, 6), (end - stick).ravel(), end.ravel(), np.zeros(24000, int))
    for quantity, body in (("start", "stick"), ("slip_start", "slip")):
        verdict = ss.independent(sticks, quantity, starts_before=float("inf"))
        assert verdict.rejected
        first = verdict.tests[0]
        assert first.effect == pytest.approx(2**-0.5, abs=0.05)
        assert ss.identically_distributed(sticks, quantity, starts_before=float("inf")).rejected
        assert verdict.question == f"Are the {body} starts, consecutive, independent?"
    assert not ss.independent(sticks, "slip_duration", starts_before=float("inf")).rejected


def test_sticks_that_touch_have_no_slip_between_them():
    """Measured: two sticks of one sample end to end; a slip before them, and one after."""
    table = {"sample": [0, 0, 1], "start": [1.0, 2.0, 0.5], "end": [2.0, 3.0, 1.0]}
    many = ss.Ensemble.from_sticks(table, t1=4.0)
    np.testing.assert_array_equal(many.totals.slips, [2, 2])
    assert many.statistics.slips.duration.number == 4
    assert many.statistics.slips.duration.smallest > 0
    np.testing.assert_allclose(np.asarray(many.slips.duration)[0][:2], [1.0, 1.0])
