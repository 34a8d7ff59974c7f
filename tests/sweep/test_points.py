"""What is simulated at a point: parameters by name, groups, zipped values and designs."""

import math

import jax
import numpy as np
import pytest

import stickslip_jax as ss

KEY = jax.random.key(7)
SYSTEM = ss.MassSpring(mass=2.0, stiffness=8.0, normal_force=3.0, friction=ss.Coulomb(0.5))
LAW = ss.PoissonSwitching(1.0, 1.0)


def sweep(**changed):
    arguments = {"over": {"mu": [0.5, 1.0]}, "t1": 10.0, "samples": 20, "key": KEY, "keep": "totals"} | changed
    return ss.Sweep(arguments.pop("system", SYSTEM), arguments.pop("law", LAW), **arguments)


def setting(number=0, **changed):
    return sweep(**changed).plan.setting_at(number)


def test_numbers_by_name():
    assert setting(1, over={"mu": [0.1, 0.2]}).system.friction.mu == 0.2
    assert setting(1, over={"law.speed": [0.1, 0.2]}).law.speed == 0.2
    assert setting(0, over={"damping": [0.3]}).system.damping == 0.3  # not set before
    assert setting(1, over={"y0[1]": [0.1, 0.2]}).y0 == (0.0, 0.2)
    assert setting(1, over={"y0[1]": [0.1, 0.2]}, y0=[3.0, 0.0]).y0 == (3.0, 0.2)
    assert setting(1, over={"method.width": [1e-3, 1e-2]}, method=ss.Regularized(0.1)).method.width == 1e-2
    uncertain = ss.MassSpring(mass=2.0, stiffness=8.0, normal_force=3.0, friction=ss.Coulomb(ss.Uniform(0.1, 1.0)))
    assert setting(1, system=uncertain, over={"mu.low": [0.1, 0.2]}).system.friction.mu.low == 0.2


def test_all_combinations_the_last_fastest():
    points = sweep(over={"mu": [0.1, 0.2], "rate": [1.0, 2.0, 3.0]}).plan.points
    assert points.number == 6
    assert [points.values(number) for number in (0, 1, 3)] == [(0.1, 1.0), (0.1, 2.0), (0.2, 1.0)]


def test_zipped_values_change_together():
    zipped = sweep(over={("mu", "rate"): [[0.1, 1.0], [0.2, 2.0]], "mass": [1.0, 3.0]})
    assert zipped.plan.points.number == 4
    found = zipped.plan.setting_at(2)
    assert (found.system.friction.mu, found.law.rate, found.system.mass) == (0.2, 2.0, 1.0)
    result = zipped.run()
    assert result.stick_fraction.dims == ("mu_and_rate", "mass")
    np.testing.assert_array_equal(result.mu, [0.1, 0.2])
    assert result.mass.attrs["units"] == "kg"


def test_designs():
    design = ss.design.table({"mu": [0.1, 0.2, 0.4], "rate": [1.0, 3.0, 2.0]})
    result = sweep(over=design).run()
    assert result.stick_fraction.dims == ("point",)
    np.testing.assert_array_equal(result.rate, [1.0, 3.0, 2.0])
    alone = ss.simulate_ensemble(
        ss.MassSpring(mass=2.0, stiffness=8.0, normal_force=3.0, friction=ss.Coulomb(0.4)),
        ss.PoissonSwitching(1.0, 2.0), t1=10.0, samples=20, key=KEY, keep="totals",
    )  # fmt: skip
    assert float(result.stick_fraction[2]) == ss.stick_fraction(alone).value


@pytest.mark.parametrize(
    ("law", "field", "frequency"),
    [
        (ss.SquareWave(1.0, 3.0), "period", lambda value: 1 / value),
        (ss.RandomSteps(1.0, 3.0), "interval", lambda value: 1 / value),
        (ss.Harmonic(1.0, 3.0), "angular_frequency", lambda value: value / (2 * math.pi)),
    ],
)
def test_frequency_ratio(law, field, frequency):
    """``r = f_b / (omega / 2 pi)``, with the natural frequency of each point."""
    for number, (mass, ratio) in enumerate([(2.0, 0.5), (2.0, 1.2), (0.5, 0.5), (0.5, 1.2)]):
        found = setting(number, law=law, over={"mass": [2.0, 0.5], "r": [0.5, 1.2]})
        natural = math.sqrt(8.0 / mass) / (2 * math.pi)
        assert frequency(getattr(found.law, field)) / natural == pytest.approx(ratio, rel=1e-14)


def test_dimensionless_speed():
    """``w = v m omega / (mu n)``."""
    found = setting(1, over={"w": [0.5, 1.5], "mu": [0.25]})
    omega = math.sqrt(8.0 / 2.0)
    assert found.law.speed == pytest.approx(1.5 * 0.25 * 3.0 / (2.0 * omega), rel=1e-14)
    assert found.system.friction.mu == 0.25


BAD = [
    ({"over": {"muu": [1.0]}}, r"over must name one of .*, but 'muu' was given; did you mean 'mu'\?"),
    ({"over": {"mu": [1.0, 1.0]}}, r"over\['mu'\] must hold every point once, but entries 0 and 1 are both 1.0"),
    ({"over": {"mu": [1.0, -1.0]}}, r"point mu = -1 of the sweep cannot be simulated: Argument mu must be zero or"),
    ({"over": {"mu": [math.nan]}}, r"over\['mu'\] must hold finite numbers, but nan was given"),
    (
        {"over": {"mu": [[1.0]]}},
        r"over\['mu'\] must be a one-dimensional sequence of real numbers, but an array of shape",
    ),
    ({"over": {"mu": np.array([0.1 + 0j, 0.2])}}, r"over\['mu'\] must be a .*sequence of real numbers, but array"),
    (
        {"over": {"mu": np.ma.masked_array([0.1, 0.2], [0, 1])}},
        r"over\['mu'\] must be a .*real numbers, but masked_array",
    ),
    ({"over": {"mu": []}}, r"over\['mu'\] must hold at least one number, but \[\] was given"),
    ({"over": {("mu", "rate"): [[1.0, 2.0, 3.0]]}}, r"over\[\('mu', 'rate'\)\] must hold rows of 2 numbers"),
    ({"over": {"mu": [1.0], "friction.mu": [2.0]}}, r"name every parameter once, but 'mu' and 'friction.mu' are both"),
    ({"over": {"mu": [1.0], ("mu", "rate"): [[1.0, 2.0]]}}, r"name every parameter once, but 'mu' was given twice"),
    ({"over": {}}, r"over must be a dict from names of parameters to their values, .* but {} was given"),
    (
        {"over": {"r": [1.0]}},
        r"over must not name 'r' here: .* a law with a frequency .* has none",
    ),
    ({"over": ss.design.sobol(4, names=["mu"])}, r"over must be a design with the values .* which has uniform numbers"),
    (
        {"statistics": ["duration"]},
        r'statistics must be names out of .*, but \'duration\' was .*keep="statistics" offers',
    ),
    ({"sensitivities": ["mu"]}, r"sensitivities must hold pairs of a statistic and the parameter"),
    (
        {"sensitivities": [("mean_slip_number", "mu")]},
        r"must hold pairs .* but \('mean_slip_number', 'mu'\)",
    ),
    ({"sensitivities": [("stick_fraction", "nope")]}, r"wrt must name one of .*, but 'nope' was given"),
    ({"samples": 0}, r"samples must be a whole number of at least 1, but 0 was given"),
    ({"keep": "sticks"}, r"keep must be one of 'totals', 'statistics', but 'sticks' was given; .*ensemble_at"),
    ({"standard_error": {"mu": 1.0}}, r"standard_error must name statistics out of .*, but 'mu' was given"),
    ({"standard_error": {"stick_fraction": 0.0}}, r"standard_error\['stick_fraction'\] must be positive, but 0.0"),
    ({"t1": -1.0}, r"t1 must be positive \(in s\), but -1.0 was given"),
    ({"key": None}, r"key must be a key such as jax.random.key\(0\)"),
    ({"batch": 0}, r"batch must be a whole number of at least 1, but 0 was given"),
]


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(("changed", "message"), BAD)
def test_bad_input(changed, message):
    with pytest.raises(ValueError, match=message):
        sweep(**changed)


def test_every_point_is_checked_before_anything_is_simulated(monkeypatch):
    with pytest.raises(ValueError, match=r"The point speed = -2 of the sweep cannot be simulated"):
        sweep(over={"speed": [1.0, 2.0, -2.0]})


@pytest.mark.usefixtures("annotations_unchecked")
def test_where_to_run():
    with pytest.raises(ValueError, match=r"Arguments threads and workers must not both be given"):
        sweep().run(threads=1, workers=1)
    with pytest.raises(ValueError, match=r"executor must be a dask.distributed.Client, but 'there' was given"):
        sweep().run(executor="there")
    with pytest.raises(ValueError, match=r"Arguments must be the values of mu, but \{'rate': 1.0\} was given"):
        sweep().ensemble_at(rate=1.0)
    with pytest.raises(ValueError, match=r"must be the values at a point of the sweep, but \{'mu': 0.7\} is none"):
        sweep().ensemble_at(mu=0.7)
