"""Arguments outside their bounds are refused with one sentence that names the argument and its value."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

# Users run without annotation checks: here the package's own checks must answer.
pytestmark = pytest.mark.usefixtures("annotations_unchecked")

NAN, INF = float("nan"), float("inf")
WRONG_KIND = ["1.0", "fast", None, True, b"1", [[1.0, 2.0]], {}, object(), 1j]
NOT_FINITE = [NAN, INF, -INF, np.float64(NAN), np.float32(INF)]


def show(value) -> str:
    # Without the address of a plain object: parallel workers must agree on the names of the cases.
    return re.sub(r" object at 0x[0-9a-f]+", "", f"{type(value).__name__} {value!r}")[:40]


def refuses(make, name: str, value) -> None:
    """`make` raises ValueError with a sentence about argument `name` that shows `value`."""
    with pytest.raises(ValueError, match=r"\AArguments? ") as caught:
        make()
    sentence = str(caught.value)
    assert re.search(rf"\b{re.escape(name)}(?!\w)", sentence), sentence
    assert sentence.endswith("."), sentence
    assert "\n" not in sentence.replace(repr(value), ""), sentence
    shown = [" ".join(repr(value).split()), str(value), f"shape {np.shape(value)}"]
    shown += [f"the class {value.__name__}"] if isinstance(value, type) else []
    assert any(text in sentence for text in shown), sentence


def system(**changed):
    numbers = {"mass": 1.0, "stiffness": 4.0, "normal_force": 1.0, "friction": ss.Coulomb(0.5)} | changed
    return ss.MassSpring(**numbers)


def piecewise(times=(0.0, 1.0), velocities=(0.5, -0.5)):
    return ss.PiecewiseConstant(times, velocities)


def run(**changed):
    arguments = {"system": system(), "base": ss.Constant(0.5), "t1": 5.0, "y0": (0.0, 0.0)} | changed
    return ss.simulate(arguments.pop("system"), arguments.pop("base"), **arguments)


KEY = jax.random.key(0)
POSITIVE = {
    "mass": lambda value: system(mass=value),
    "normal_force": lambda value: system(normal_force=value),
    "SquareWave speed": lambda value: ss.SquareWave(speed=value, period=1.0),
    "SquareWave period": lambda value: ss.SquareWave(speed=1.0, period=value),
    "PoissonSwitching speed": lambda value: ss.PoissonSwitching(speed=value, rate=1.0),
    "PoissonSwitching rate": lambda value: ss.PoissonSwitching(speed=1.0, rate=value),
    "RandomSteps speed": lambda value: ss.RandomSteps(speed=value, interval=1.0),
    "RandomSteps interval": lambda value: ss.RandomSteps(speed=1.0, interval=value),
    "simulate t1": lambda value: run(t1=value),
    "sample t1": lambda value: ss.PoissonSwitching(1.0, 1.0).sample(KEY, value),
}
NUMBERS = POSITIVE | {
    "stiffness": lambda value: system(stiffness=value),
    "mu": ss.Coulomb,
    "Constant speed": ss.Constant,
    "y0[0]": lambda value: run(y0=(value, 0.0)),
    "y0[1]": lambda value: run(y0=(0.0, value)),
}


def argument(label: str) -> str:
    return label.rsplit(maxsplit=1)[-1]


@pytest.mark.parametrize("value", [0.0, -1.0, 0, -3, np.float32(-2.0)], ids=show)
@pytest.mark.parametrize("label", POSITIVE)
def test_not_positive(label, value):
    refuses(lambda: POSITIVE[label](value), argument(label), value)


@pytest.mark.parametrize("value", [-1.0, -3, np.float32(-2.0)], ids=show)
def test_a_negative_stiffness(value):
    refuses(lambda: system(stiffness=value), "stiffness", value)


@pytest.mark.parametrize("value", NOT_FINITE, ids=show)
@pytest.mark.parametrize("label", NUMBERS)
def test_not_finite(label, value):
    refuses(lambda: NUMBERS[label](value), argument(label), value)


@pytest.mark.parametrize("value", WRONG_KIND, ids=show)
@pytest.mark.parametrize("label", NUMBERS)
def test_not_a_number(label, value):
    refuses(lambda: NUMBERS[label](value), argument(label), value)


SIZED = POSITIVE | {
    "stiffness": lambda value: system(stiffness=value),
    "mu": ss.Coulomb,
    "damping": lambda value: system(damping=value),
    "motor_constant": lambda value: ss.MotorCart(motor_constant=value),
    "motor_inertia": lambda value: ss.MotorCart(motor_inertia=value),
    "motor_damping": lambda value: ss.MotorCart(motor_damping=value),
    "resistance": lambda value: ss.MotorCart(resistance=value),
    "inductance": lambda value: ss.MotorCart(inductance=value),
    "interval": lambda value: ss.KanaiTajimi(rms=1.0, interval=value),
    "ground_frequency": lambda value: ss.KanaiTajimi(rms=1.0, ground_frequency=value),
    "ground_damping": lambda value: ss.KanaiTajimi(rms=1.0, ground_damping=value),
}


@pytest.mark.parametrize("value", [5e-324, 1e-200, 1e300], ids=show)
@pytest.mark.parametrize("label", SIZED)
def test_numbers_too_small_or_too_large_to_compute_with(label, value):
    refuses(lambda: SIZED[label](value), argument(label), value)


@pytest.mark.parametrize("label", NUMBERS)
def test_a_random_key_is_no_number(label):
    with pytest.raises(ValueError, match=rf"\AArgument {re.escape(argument(label))} must be .*a random key was given"):
        NUMBERS[label](KEY)


def ensemble(**changed):
    law = ss.PoissonSwitching(1.0, 1.0)
    return ss.simulate_ensemble(system(), law, **({"t1": 5.0, "samples": 20, "key": KEY} | changed))


@pytest.mark.parametrize("name", ["orders", "chunk", "samples"])
def test_whole_numbers_beyond_what_can_be_held(name):
    for value in (2**31 + 1, 10**39):
        refuses(lambda value=value: ensemble(**{name: value}), name, value)


@pytest.mark.slow
def test_as_many_orders_as_are_allowed():
    few, many = (ensemble(orders=orders, t1=30.0).statistics for orders in (3, 1000))
    assert many.orders == 1000
    for number in (1, 3):
        assert many.order(number).duration.mean.value == few.order(number).duration.mean.value
    assert many.order(1000).duration.number == 0


def test_where_a_table_is_to_be_written():
    many = ensemble(keep="sticks")
    for value in (None, 3):
        refuses(lambda value=value: many.write_sticks(value), "path", value)


def test_a_statistic_for_the_bootstrap_has_an_error():
    refuses(lambda: ss.bootstrap_interval(lambda one: 1.0, ensemble()), "statistic", 1.0)


@pytest.mark.parametrize("value", [-0.1, -1, -1e-300], ids=show)
def test_negative_friction(value):
    refuses(lambda: ss.Coulomb(mu=value), "mu", value)


def test_bounds_themselves_are_allowed():
    assert ss.Coulomb(0.0).mu == 0
    assert ss.Constant(0.0).speed == 0
    assert ss.Constant(-1.0).speed == -1


@pytest.mark.slow
@pytest.mark.parametrize("value", [1, np.float32(1.0), np.float64(1.0), np.int64(1), jnp.asarray(1.0), np.asarray(1.0)])
def test_every_kind_of_number_is_allowed(value):
    simulation = run(system=system(mass=value), t1=value, y0=(value, value), base=ss.Constant(value))
    assert int(simulation.status) == ss.Status.FINISHED
    law = ss.RandomSteps(speed=value, interval=value)
    assert law.sample(KEY, value).durations.shape == (2,)


@pytest.mark.parametrize("value", [3, "abc", None, 1.0, ss.Coulomb], ids=show)
def test_friction_must_be_a_law(value):
    refuses(lambda: system(friction=value), "friction", value)


@pytest.mark.parametrize("value", [3, "abc", None, (1.0, 1.0), ss.MassSpring], ids=show)
def test_system_must_be_a_system(value):
    refuses(lambda: run(system=value), "system", value)


@pytest.mark.parametrize("value", [NAN, "abc", None, ss.Constant, jnp.ones(3)], ids=show)
def test_base_must_be_a_base(value):
    refuses(lambda: run(base=value), "base", value)


@pytest.mark.parametrize("law", [ss.PoissonSwitching(1.0, 2.0), ss.RandomSteps(1.0, 2.0)])
def test_random_law_must_be_sampled_first(law):
    with pytest.raises(ValueError, match=r"\AArgument base must be a realisation, .*sample\(key, t1\)\.\Z"):
        run(base=law)


def test_one_realization_only():
    batch = jax.vmap(lambda key: ss.PoissonSwitching(1.0, 2.0).sample(key, 5.0))(jax.random.split(KEY, 3))
    with pytest.raises(ValueError, match=r"\AArgument base must be one realisation, .*shape \(3, \d+\).*\.\Z"):
        run(base=batch)


@pytest.mark.parametrize("value", [1.0, (), (1.0,), (1.0, 2.0, 3.0), "x", {}], ids=show)
def test_start_must_be_a_pair(value):
    refuses(lambda: run(y0=value), "y0", value)


@pytest.mark.parametrize(
    ("times", "velocities"),
    [
        ([0.0, 2.0, 1.0], [1.0, 2.0, 3.0]),
        ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0]),
        ([0.5, 1.0], [1.0, 2.0]),
        ([-1.0, 1.0], [1.0, 2.0]),
        ([0.0, 1.0], [1.0, 2.0, 3.0]),
        ([0.0], []),
        ([], []),
        ([[0.0, 1.0]], [[1.0, 2.0]]),
        (0.0, 1.0),
        ([0.0, NAN], [1.0, 2.0]),
        ([0.0, INF], [1.0, 2.0]),
        (["0", "1"], [1.0, 2.0]),
        ([0.0, None], [1.0, 2.0]),
        ([0.0, 1j], [1.0, 2.0]),
        ("01", [1.0, 2.0]),
        (None, [1.0, 2.0]),
    ],
)
@pytest.mark.parametrize("kind", [list, np.asarray])
def test_times(times, velocities, kind):
    """As a list and as an array."""
    if kind is np.asarray:
        times, velocities = np.asarray(times), np.asarray(velocities)
    with pytest.raises(ValueError, match=r"\AArguments? (times|velocities) .*\.\Z"):
        ss.PiecewiseConstant(times, velocities)


@pytest.mark.parametrize("velocities", [[1.0, NAN], [INF, 1.0], ["1", "2"], [None, 1.0], "12", None, 3.0, [[1.0, 2.0]]])
def test_velocities(velocities):
    with pytest.raises(ValueError, match=r"\AArguments? (times and )?velocities .*\.\Z"):
        piecewise(velocities=velocities)


def test_unsorted_times_are_pointed_at():
    with pytest.raises(ValueError, match=r"times\[2\] = 1\.0 follows .*2\.0"):
        piecewise(times=[0.0, 2.0, 1.0], velocities=[1.0, 2.0, 3.0])


@pytest.mark.parametrize("kind", [list, tuple, np.asarray, jnp.asarray])
def test_times_of_every_kind_are_allowed(kind):
    base = piecewise(times=kind([0, 1, 3]), velocities=kind([1, 2, 1])).sample(None, 5.0)
    assert base.durations.tolist() == [1.0, 2.0, INF]
    assert base.velocities.dtype == jnp.float64


@pytest.mark.parametrize("levels", [(), (1.0,), (1.0, 1.0), (1.0, NAN), (1.0, INF), ("a", "b"), "ab", None, 3.0])
def test_levels(levels):
    refuses(lambda: ss.RandomSteps(speed=1.0, interval=1.0, levels=levels), "levels", levels)


@pytest.mark.parametrize(
    "probabilities", [(), (1.0,), (0.5, 0.6), (0.0, 1.0), (-0.5, 1.5), (0.2, 0.3, 0.5), (NAN, 0.5), "ab", 0.5]
)
def test_probabilities(probabilities):
    """The empty tuple is not "no probabilities given"."""
    make = lambda: ss.RandomSteps(speed=1.0, interval=1.0, probabilities=probabilities)  # noqa: E731
    refuses(make, "probabilities", probabilities)


@pytest.mark.parametrize("value", ["up", "", None, 1, True], ids=show)
def test_first_sign(value):
    refuses(lambda: ss.PoissonSwitching(speed=1.0, rate=1.0, first_sign=value), "first_sign", value)


@pytest.mark.parametrize("value", [0, -1, 2.5, "3", True, NAN, 3.0], ids=show)
def test_capacity(value):
    refuses(lambda: ss.PoissonSwitching(1.0, 1.0).sample(KEY, 5.0, capacity=value), "capacity", value)


BAD_KEYS = [0, "key", 1.5, np.zeros(2), np.zeros(3, np.uint32), jnp.zeros((), jnp.uint32)]


@pytest.mark.parametrize("value", [*BAD_KEYS, jax.random.key(0, impl="rbg")], ids=show)
@pytest.mark.parametrize("law", [ss.PoissonSwitching(1.0, 1.0), ss.RandomSteps(1.0, 1.0)])
def test_key(law, value):
    refuses(lambda: law.sample(value, 5.0), "key", value)


@pytest.mark.parametrize("capacity", [2, 5])
@pytest.mark.parametrize("keys", [jax.random.split(KEY, 2), jax.random.split(jax.random.PRNGKey(0), 2)])
def test_many_keys_at_once(keys, capacity):
    """One key, one realisation; for many there is vmap."""
    with pytest.raises(ValueError, match=r"\AArgument key .*\.\Z"):
        ss.PoissonSwitching(1.0, 1.0).sample(keys, 5.0, capacity=capacity)


@pytest.mark.slow
@pytest.mark.parametrize("value", ["1", None, [NAN], ["a"], INF], ids=show)
def test_evaluation_times(value):
    simulation = run()
    with pytest.raises(ValueError, match=r"\AArgument times .*\.\Z"):
        simulation.evaluate(value)


@pytest.mark.parametrize(
    ("durations", "velocities"),
    [
        ([1.0, 2.0], [1.0, -1.0]),
        (np.ones(3), np.array([1.0, -1.0])),
        (np.array([5.0, -3.0, 30.0]), np.array([1.0, -1.0, 1.0])),
        (np.array([5.0, NAN]), np.array([1.0, -1.0])),
        (np.ones(2), np.array([1.0, INF])),
        (np.ones(3), np.array([1.0, 1.0, -1.0])),
        (np.array(1.0), np.array(1.0)),
    ],
)
def test_velocity_steps_that_are_none(durations, velocities):
    with pytest.raises(ValueError, match=r"\AArguments? (durations|velocities) .*\.\Z"):
        ss.VelocitySteps(durations, velocities)


@pytest.mark.parametrize("t1", [1e99, 1e12])
@pytest.mark.parametrize("law", [ss.PoissonSwitching(1.0, 1.0), ss.SquareWave(1.0, 1e-3), ss.RandomSteps(1.0, 1e-3)])
def test_more_intervals_than_can_be_numbered(law, t1):
    with pytest.raises(ValueError, match=r"\AArgument t1 must be shorter: .*\.\Z"):
        law.sample(KEY, t1)


def test_a_level_that_is_nearly_certain():
    with pytest.raises(ValueError, match=r"\AArgument probabilities must hold one number of at least 1e-6"):
        ss.RandomSteps(1.0, 1.0, levels=(-1.0, 1.0), probabilities=(1e-17, 1.0))
