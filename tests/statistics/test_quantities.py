"""Names of quantities agree wherever they are written; statistics of totals have an estimate and a derivative."""

from typing import get_args

import jax
import numpy as np
import pytest
from support.statistics import made_up_sticks, statistics_of

import stickslip_jax as ss
from stickslip_jax._dynamics.sticks import QUANTITIES
from stickslip_jax._sensitivity.statistic import StickSequence, statistic_of
from stickslip_jax._statistics import quantities, totals

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
RUN = {"t1": 30.0, "samples": 40, "key": jax.random.key(3), "y0": (0.0, 1.0), "keep": "sticks", "chunk": 64}


def test_the_types_of_arguments_name_all_quantities():
    assert set(get_args(ss.StickQuantity)) == set(quantities.BY_NAME)
    assert set(get_args(ss.TestedQuantity)) == set(quantities.TESTED)
    first, others = quantities.STICK_QUANTITIES[:3], quantities.STICK_QUANTITIES[3:]
    assert first == (quantities.START, quantities.DURATION, quantities.POSITION)
    assert all(one.name in QUANTITIES for one in others)


def test_every_quantity_has_values_a_distribution_and_labels():
    statistics = statistics_of(made_up_sticks(np.random.default_rng(0), 20))
    for quantity in quantities.DISTRIBUTIONS:
        assert getattr(statistics, quantity.name).name == quantity.label
    for quantity in quantities.STICK_QUANTITIES:
        assert quantity.label.count("stick") == 1
        assert quantity.name in dir(statistics)
        assert getattr(statistics.order(2), quantity.name).name == quantity.label_of_order(2)
    assert [quantities.ordinal(number) for number in (1, 2, 3, 4, 11, 12, 13, 21, 102, 113)] == [
        "1st", "2nd", "3rd", "4th", "11th", "12th", "13th", "21st", "102nd", "113th"
    ]  # fmt: skip


def test_what_is_no_quantity_is_no_attribute():
    statistics = statistics_of(made_up_sticks(np.random.default_rng(0), 5))
    for of in (statistics, statistics.order(1)):
        with pytest.raises(AttributeError, match=f"'{type(of).__name__}' object has no attribute 'length'"):
            _ = of.length


@pytest.mark.parametrize("name", [*totals.STATISTICS, "mean_total_stick_time"])
def test_a_statistic_is_the_ratio_of_its_means(name):
    statistic, many = getattr(ss, name), ss.simulate_ensemble(SYSTEM, ss.PoissonSwitching(1.0, 1.0), **RUN)
    assert (statistic.__name__, repr(statistic)) == (name, name)
    assert statistic.__doc__.startswith("Mean ")
    terms = {**dict(zip(totals.TOTALS, many.moments.mean, strict=True)), "constant": 1.0, "t1": 30.0}
    above, below = (
        sum(weight * terms[term] for term, weight in zip(one._fields, one, strict=True))
        for one in (statistic.numerator, statistic.denominator)
    )
    assert statistic(many).value == pytest.approx(above / below, rel=1e-12)
    assert statistic(many).name == statistic.label


@pytest.mark.parametrize("statistic", totals.DIFFERENTIABLE, ids=repr)
def test_sensitivities_see_the_same_statistic(statistic):
    """The parts of one realisation are the weights times its totals."""
    duration, mask = np.array([0.5, 2.0, 0.0]), np.array([True, True, False])
    differentiated = statistic_of(statistic)
    assert (differentiated.name, differentiated.unit) == (statistic.label, statistic.unit)
    parts = differentiated.parts(StickSequence(np.array([1.0, 4.0, 0.0]), duration, mask), 30.0)
    np.testing.assert_allclose(parts, differentiated.weights(30.0) @ [2.5, 2.0, 1.0], rtol=1e-15)
