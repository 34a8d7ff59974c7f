"""Laws of one's own: any object with ``sample(key, t1)``."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

KEY = jax.random.key(3)
SYSTEM = ss.MassSpring(mass=1.0, stiffness=100.0, normal_force=20.0, friction=ss.Coulomb(0.5))
T1 = 5.0


class Switching:
    """Poisson switching by another way in."""

    def sample(self, key, t1):
        return ss.PoissonSwitching(1.0, 2.0).sample(key, t1, capacity=60)


class Gusts:
    """Base velocities at equal times, joined by straight lines."""

    def sample(self, key, t1):
        return ss.Recorded(jnp.linspace(0.0, t1, 51), 0.3 * jnp.cumsum(jax.random.normal(key, (51,))))


class FromNumpy:
    """Steps drawn by NumPy."""

    def sample(self, key, t1):
        random = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        return ss.PiecewiseConstant(np.linspace(0, t1, 20, endpoint=False), random.normal(size=20))


def run(law, **changed):
    arguments = {"t1": T1, "samples": 40, "key": KEY, "keep": "sticks"} | changed
    return ss.simulate_ensemble(SYSTEM, law, **arguments)


def starts(sticks):
    return np.asarray(sticks.start)[np.asarray(sticks.mask)]


@pytest.mark.slow
def test_a_known_law_by_this_way_is_the_same():
    mine, theirs = run(Switching()), run(ss.PoissonSwitching(1.0, 2.0))
    np.testing.assert_array_equal(mine.flat_sticks.count, theirs.flat_sticks.count)
    np.testing.assert_allclose(starts(mine.sticks), starts(theirs.sticks), rtol=0, atol=1e-14 * T1)


@pytest.mark.slow
@pytest.mark.parametrize("law", [Gusts(), FromNumpy()], ids=lambda law: type(law).__name__)
def test_samples_are_the_simulations_of_their_realizations(law):
    many = run(law, samples=12)
    assert many.finished == 12
    assert int(many.flat_sticks.count.sum()) > 40
    for number in (0, 7, 11):
        realization = law.sample(jax.random.fold_in(KEY, number), T1)
        one = ss.simulate(SYSTEM, realization, t1=T1)
        mask = np.asarray(many.sticks.mask[number])
        np.testing.assert_allclose(np.asarray(many.sticks.start[number])[mask], starts(one.sticks), rtol=0, atol=1e-13)
        _, base, _ = many.realization(number)
        np.testing.assert_array_equal(base.times, realization.times)


@pytest.mark.slow
@pytest.mark.parametrize(
    "mu",
    [pytest.param(0.6, marks=pytest.mark.slow, id="one system"), pytest.param(ss.Uniform(0.3, 0.7), id="many systems")],
)
def test_differences_of_a_known_law_by_this_way_are_the_same(mu):
    """Only differences: what is about to change in a base motion of one's own is not known."""
    system = ss.MassSpring(mass=1.0, stiffness=100.0, normal_force=20.0, friction=ss.Coulomb(mu))
    options = {"wrt": "stiffness", "t1": T1, "samples": 512, "key": KEY}
    mine = ss.sensitivity(ss.stick_fraction, system, Switching(), **options)
    known = ss.PoissonSwitching(1.0, 2.0)
    theirs = ss.sensitivity(ss.stick_fraction, system, known, estimator="finite-difference", **options)
    assert mine.estimator == "finite-difference"
    assert mine.derivative == pytest.approx(theirs.derivative, rel=1e-9)
    assert mine.standard_error == pytest.approx(theirs.standard_error, rel=1e-9)
    with pytest.raises(ValueError, match=r"\AArgument estimator must be 'finite-difference'"):
        ss.sensitivity(ss.stick_fraction, system, Switching(), estimator="corrected", **options)


@pytest.mark.slow
def test_given_steps_may_be_the_base_of_an_ensemble():
    steps = ss.PoissonSwitching(1.0, 2.0).sample(KEY, T1)
    many = run(steps, samples=3, y0=(np.array([0.0, 0.05, 0.1]), 0.0))
    one = ss.simulate(SYSTEM, steps, t1=T1, y0=(0.05, 0.0))
    mask = np.asarray(many.sticks.mask[1])
    np.testing.assert_allclose(np.asarray(many.sticks.start[1])[mask], starts(one.sticks), rtol=0, atol=1e-14 * T1)


def test_realizations_of_different_lengths_are_refused():
    class Uneven:
        def sample(self, key, t1):
            number = int(np.asarray(jax.random.key_data(key))[1]) % 5 + 2
            return ss.PiecewiseConstant(np.linspace(0, t1, number), np.arange(number) + 1.0)

    with pytest.raises(ValueError, match=r"\AArgument law must give realisations of one class"):
        run(Uneven())


def test_without_a_key_there_is_no_realization():
    with pytest.raises(ValueError, match=r"\AArgument key must be a key"):
        run(Gusts(), key=None)
