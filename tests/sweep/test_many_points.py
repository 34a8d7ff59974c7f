"""Many points of a sweep: they are checked in arrays, as one by one, and too many are refused before there are any."""

import math
import tracemalloc
from typing import Annotated

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._ensemble import points
from stickslip_jax._ensemble.points import MOST_POINTS, Setter

pytestmark = pytest.mark.usefixtures("annotations_unchecked")

KEY = jax.random.key(7)
SYSTEM = ss.MassSpring(mass=2.0, stiffness=8.0, normal_force=3.0, friction=ss.Coulomb(0.5))
HOLDING = ss.MassSpring(mass=2.0, stiffness=8.0, normal_force=3.0, friction=ss.Coulomb(0.5, 0.9))
LAW = ss.PoissonSwitching(1.0, 1.0)


class Drawn(ss.SwitchedSystem):
    """A system of a user's whose numbers must fit together, for single numbers only."""

    least: Annotated[float, ss.Quantity("m", above=0)]
    most: Annotated[float, ss.Quantity("m", above=0)]
    state_names = ("position in m", "velocity in m/s")

    def rates(self, t, y, base, friction):
        return y[1], -y[0] * self.most - friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    def check_relations(self):
        if self.least > self.most:
            raise ValueError(f"Argument most must be at least {self.least}, but {self.most} was given.")


class DrawnInOneWay(Drawn):
    """With a check of its own besides those of the classes that it is made of."""

    def __check_init__(self):
        if self.most == 3.0:
            raise ValueError("Argument most must not be 3.")


def sweep(**changed):
    arguments = {"over": {"mu": [0.5, 1.0]}, "t1": 10.0, "samples": 20, "key": KEY, "keep": "totals"} | changed
    return ss.Sweep(arguments.pop("system", SYSTEM), arguments.pop("law", LAW), **arguments)


UNFIT = {
    "bound": ({"over": {"mu": [0.5, 1.0, -0.1], "rate": [1.0, 2.0]}}, "mu must be zero or positive, but -0.1"),
    "size": ({"over": {"rate": [1.0, 1e-200]}}, "rate must be between 1e-100 and 1e+100"),
    "two numbers": ({"system": HOLDING, "over": {"mu": [0.5, 0.95], "mu_static": [1.0, 0.9]}}, "mu_static must be at"),
    "not set before": ({"over": {"mu_static": [0.6, 0.5, 0.4]}}, "mu_static must be at least mu = 0.5, but 0.4"),
    "optional": ({"over": {"damping": [0.0, 0.1, -1.0]}}, "damping must be zero or positive"),
    "distribution": (
        {
            "system": ss.MassSpring(2.0, 8.0, 3.0, ss.Coulomb(ss.Uniform(0.1, 1.0))),
            "over": {"mu.low": [0.1, 0.9], "mu.high": [1.0, 0.5]},
        },
        "high must be above low = 0.9, but 0.5",
    ),
    "truncated": (
        {
            "system": ss.MassSpring(2.0, 8.0, 3.0, ss.Coulomb(ss.Truncated(ss.Normal(0.5, 0.1), 0.1, 2.0))),
            "over": {"mu.low": [0.1, 0.4, 90.0]},
        },
        "must be above low = 90",
    ),
    "method": ({"method": ss.Regularized(0.1), "over": {"method.width": [0.1, 1e-3, 0.0]}}, "width must be positive"),
    "group": ({"law": ss.SquareWave(1.0, 3.0), "over": {"r": [0.5, 1.0, 0.0]}}, r"over['r'] must be positive"),
    "group with others": (
        {"law": ss.SquareWave(1.0, 3.0), "over": {"mass": [1.0, 1e90], "r": [0.5, 1e-60]}},
        "period must be between",
    ),
    "speed": ({"law": ss.Constant(1.0), "over": {"mass": [1.0, 1e90], "w": [1.0, 1e99, 1e-99]}}, None),
    "speed that is none": ({"over": {"w": [1.0, -1.0]}}, "speed must be positive"),
    "zipped": ({"over": {("mu", "mass"): [[0.5, 1.0], [0.2, 2.0], [0.3, -2.0]]}}, "mass must be positive"),
    "a user's": (
        {"system": Drawn(1.0, 2.0), "over": {"least": [1.0, 1.9, 2.5]}, "method": ss.Exact(step=0.01)},
        "most must be at least 2.5, but 2.0",
    ),
    "a user's, by its class": (
        {"system": DrawnInOneWay(1.0, 2.0), "over": {"least": [1.0, 1.9, 2.5]}, "method": ss.Exact(step=0.01)},
        "most must be at least 2.5, but 2.0",
    ),
    "a user's, by its own check": (
        {"system": DrawnInOneWay(1.0, 2.0), "over": {"most": [1.0, 1.9, 3.0]}, "method": ss.Exact(step=0.01)},
        "most must not be 3",
    ),
    "ranges": ({"law": ss.KanaiTajimi(1.0, interval=0.02), "over": {"interval": [0.02, 0.01, 1.0]}}, "interval must"),
    "start": ({"over": {"y0[1]": [0.0, 1.0]}}, None),
    "semi-markov": (
        {"law": ss.SemiMarkovSwitching(ss.Uniform(0.5, 1.0), 1.0), "over": {"low": [0.1, -0.1]}},
        "low",
    ),
}


@pytest.mark.parametrize("case", UNFIT)
def test_the_first_point_that_does_not_fit_is_told_as_one_by_one(case, monkeypatch):
    changed, said = UNFIT[case]

    def made():
        try:
            return sweep(**changed).points
        except ValueError as error:
            return str(error)

    at_once = made()
    monkeypatch.setattr(points, "_suspicious", lambda setter, values: np.ones(len(values), bool))
    assert made() == at_once
    if said is None:
        assert isinstance(at_once, int)
    else:
        assert said in at_once
        assert at_once.startswith("The point ")


@pytest.mark.parametrize(
    "changed",
    [
        {"over": {"mu": np.linspace(0.1, 2, 400), "rate": np.geomspace(0.1, 10, 250)}},
        {"over": ss.design.table({"mass": np.geomspace(0.1, 10, 100_000), "mu": np.linspace(0.1, 0.8, 100_000)})},
        {"system": HOLDING, "over": {("mu", "mu_static"): np.linspace([0.1, 0.2], [0.8, 0.9], 100_000)}},
        {"law": ss.SquareWave(1.0, 3.0), "over": {"r": np.linspace(0.1, 2, 400), "stiffness": np.linspace(1, 9, 250)}},
        {"over": {"w": np.linspace(0.1, 2, 400), "mu": np.linspace(0.1, 2, 250)}},
        {"over": {"y0[1]": np.linspace(-1, 1, 100_000)}},
    ],
)
def test_a_hundred_thousand_points_are_not_made_one_by_one(changed, monkeypatch):
    made = []
    one = Setter.__call__
    monkeypatch.setattr(Setter, "__call__", lambda self, values: made.append(values) or one(self, values))
    many = sweep(**changed)
    assert many.points == 100_000
    assert len(made) < 10


def test_one_of_many_is_found():
    """The last one but one of a hundred thousand, and no other is told."""
    masses = np.linspace(1.0, 2.0, 100_000)
    masses[-2] = -1.0
    with pytest.raises(ValueError, match=r"\AThe point mass = -1 of the sweep cannot be simulated: Argument mass must"):
        sweep(over={"mass": masses})


def test_entries_that_are_the_same_point():
    values = np.arange(100_000.0)
    values[[70_000, 90_000]] = 5.0, 3.0
    with pytest.raises(ValueError, match=r"every point once, but entries 5 and 70000 are both 5\.0\.\Z"):
        sweep(over={"mass": values + 0.0})
    rows = [[1.0, 2.0], [1.0, 3.0], [1.0, 2.0]]
    with pytest.raises(ValueError, match=r"entries 0 and 2 are both \(1\.0, 2\.0\)\.\Z"):
        sweep(over={("mu", "mass"): rows})
    with pytest.raises(ValueError, match=r"entries 0 and 1 are both -?0\.0\.\Z"):
        sweep(over={"mu": [0.0, -0.0]})


def test_a_point_of_many_by_its_values():
    many = sweep(over={"mu": np.linspace(0.1, 2, 400), ("rate", "mass"): np.linspace([1, 2], [3, 4], 250)}).plan.points
    for number in (0, 1, 249, 250, 99_999):
        values = dict(zip(many.parameters, many.values(number), strict=True))
        assert many.number_of(values) == number
        assert many.number_of({**values, "mu": values["mu"] * (1 + 1e-12)}) == number
        assert many.number_of({**values, "mu": values["mu"] * (1 + 1e-6)}) is None
    with pytest.raises(ValueError, match=r"\AArgument mu must be a single real number"):
        sweep().ensemble_at(mu="a")


def test_all_values_in_blocks():
    many = sweep(over={"mu": [0.1, 0.2, 0.3], ("rate", "mass"): [[1, 2], [3, 4]]}).plan.points
    found = [(first, values.tolist()) for first, values in many.blocks(4)]
    assert [first for first, _ in found] == [0, 4]
    assert [tuple(row) for _, rows in found for row in rows] == [many.values(number) for number in range(6)]


TOO_MANY = {
    "product": ({f"y0[{i}]": np.arange(10_000.0) for i in range(2)}, "but has 100000000; take fewer values"),
    "range": ({"mass": range(1, 10**12)}, "but has 999999999999; take fewer values"),
    "many axes": (
        {name: np.arange(1, 1001) for name in ("mass", "mu", "rate", "speed", "stiffness")},
        "1000000000000000",
    ),
}


@pytest.mark.parametrize("case", TOO_MANY)
def test_more_points_than_can_be_held(case):
    over, said = TOO_MANY[case]
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=rf"\AArgument over.* must have at most {MOST_POINTS} points") as caught:
            sweep(over=over)
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()
    assert said in str(caught.value)


MANY_NAMES = [f"name_{number}" for number in range(30_000)]
TOO_LARGE = {
    "random": lambda: ss.design.random(2**20, MANY_NAMES),
    "random, dimensions": lambda: ss.design.random(2**20, dimensions=20_000),
    "one name": lambda: ss.design.random(2**30, ["mu"]),
    "latin hypercube": lambda: ss.design.latin_hypercube(2**20, MANY_NAMES),
    "sobol": lambda: ss.design.sobol(2**20, MANY_NAMES[:20_000]),
    "saltelli": lambda: ss.design.saltelli(2**10, MANY_NAMES[:10_000]),
    "grid": lambda: ss.design.grid({name: np.arange(1000.0) for name in "abc"}),
    "grid of a range": lambda: ss.design.grid({"a": range(10**12)}),
    "table of a range": lambda: ss.design.table({"a": range(10**12)}),
}


@pytest.mark.parametrize("case", TOO_LARGE)
def test_designs_that_are_too_large(case):
    ss.design.latin_hypercube(2, ["mu"])  # what it imports is not what a design holds
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"\AArgument .* must .*; take fewer rows or columns\.\Z|at most \d+, but"):
            TOO_LARGE[case]()
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()


def test_many_names():
    design = ss.design.random(2, MANY_NAMES)
    assert design.dimensions == 30_000
    with pytest.raises(ValueError, match=r"every name once, but 'name_7' was given twice\.\Z"):
        ss.design.random(2, [*MANY_NAMES, "name_7"])
    assert math.prod(design.u.shape) == 60_000
