"""Values that NumPy, JAX or Python would take for others, or fail on later, are refused where they are given."""

import math
import re
import sys
import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._foundation import checks
from stickslip_jax.study import StudyError
from stickslip_jax.study._reading import read_config, read_sweep_config

# Users run without annotation checks: here the package's own checks must answer. A warning is no answer.
pytestmark = [pytest.mark.usefixtures("annotations_unchecked"), pytest.mark.filterwarnings("error")]

KEY, LAW = jax.random.key(0), ss.PoissonSwitching(1.0, 1.0)
MASKED = np.ma.array([0.5, 1.0, 1.5], mask=[False, True, False])
NOT_NUMBERS = {
    "complex": 1 + 2j,
    "complex of numpy": np.complex128(1.0),
    "truth of numpy": np.True_,
    "text of numpy": np.str_("1.0"),
    "masked": np.ma.masked,
    "beyond 64 bits": 10**20,
    "beyond floats": 10**400,
    "class": float,
    "decimal object": np.asarray("1.0", object),
    "time": np.datetime64("2020-01-01"),
}
NOT_ARRAYS = {
    "complex": np.array([0.5, 1.0 + 0j]),
    "truths": np.array([True, False]),
    "list of truths": [True, 1.0],
    "masked": MASKED,
    "masked in a list": [0.5, np.ma.masked],
    "objects": np.array([0.5, 1.0], object),
    "text": np.array(["0.5", "1.0"]),
    "beyond floats": [0.5, 10**400],
    "uneven": [[0.5], [1.0, 2.0]],
    "times": np.array(["2020-01-01"], "datetime64[D]"),
}


def system(**changed):
    return ss.MassSpring(**{"mass": 1.0, "stiffness": 4.0, "normal_force": 1.0, "friction": ss.Coulomb(0.5), **changed})


def sweep(**changed):
    arguments = {"system": system(), "law": LAW, "over": {"mu": [0.5, 1.0]}, "t1": 5.0, "samples": 10, "key": KEY}
    return ss.Sweep(**{**arguments, **changed})


def sticks(**changed):
    table = {"sample": [0, 0], "start": [1.0, 3.0], "end": [2.0, 4.0]} | changed.pop("table", {})
    return ss.Ensemble.from_sticks(table, **{"t1": 5.0, **changed})


def sentence(make, name: str, error: type[Exception] = ValueError) -> str:
    """What `make` is refused with: one sentence that names the argument."""
    with pytest.raises(error) as caught:
        make()
    said = str(caught.value)
    assert type(caught.value) is error
    assert re.search(rf"(?<!\w){re.escape(name)}(?!\w)", said), said
    assert re.fullmatch(r"[^\n]*[^.\n]\.", said), said
    return said


SINGLE = {
    "mu": ss.Coulomb,
    "mass": lambda value: system(mass=value),
    "speed": ss.Constant,
    "low": lambda value: ss.Uniform(value, 100.0),
    "y0[0]": lambda value: ss.simulate(system(), ss.Constant(1.0), t1=1.0, y0=(value, 0.0)),
    "t1": lambda value: ss.simulate(system(), ss.Constant(1.0), t1=value),
    "width": ss.Regularized,
}


@pytest.mark.parametrize("kind", NOT_NUMBERS)
@pytest.mark.parametrize("name", SINGLE)
def test_what_is_no_number(name, kind):
    sentence(lambda: SINGLE[name](NOT_NUMBERS[kind]), name)


MANY = {
    "mass": lambda values: system(mass=values),
    "rate": lambda values: ss.PoissonSwitching(1.0, values),
    "times": lambda values: ss.PiecewiseConstant(values, [1.0, 2.0]),
    "values": lambda values: ss.Recorded([0.0, 1.0], values),
    "levels": lambda values: ss.RandomSteps(1.0, 1.0, levels=values),
    "y0": lambda values: ss.simulate(system(), ss.Constant(1.0), t1=1.0, y0=values),
    "velocities": lambda values: ss.VelocitySteps(np.array([1.0, 1.0]), values),
    "slopes": lambda values: ss.VelocitySegments([1.0, 1.0], [1.0, 2.0], values),
    "over['mu']": lambda values: sweep(over={"mu": values}),
    "values['mu']": lambda values: ss.design.grid({"mu": values}),
    "numbers": lambda values: ss.design.table(values, ["mu"]),
    "correlation": lambda values: ss.GaussianCopula(("a", "b"), values),
}


@pytest.mark.parametrize("kind", NOT_ARRAYS)
@pytest.mark.parametrize("name", MANY)
def test_what_is_no_array_of_numbers(name, kind):
    sentence(lambda: MANY[name](NOT_ARRAYS[kind]), name)


def test_arrays_of_numbers_of_every_kind_are_taken():
    for values in ([1, 2], (1.0, 2.0), np.array([1, 2], np.int8), np.ma.array([1.0, 2.0]), jnp.array([1.0, 2.0])):
        assert np.asarray(system(mass=values).mass).tolist() == [1.0, 2.0]
        assert ss.Recorded([0.0, 1.0], values).values.tolist() == [1.0, 2.0]


def test_what_to_do_is_said():
    assert sentence(lambda: system(mass=10**20), "mass").endswith("; write it as 1e+20.")
    assert "about 401 digits" in sentence(lambda: system(mass=10**400), "mass")
    assert "about 100001 digits" in sentence(lambda: system(mass=10**100_000), "mass")
    assert "leave the masked entries out" in sentence(lambda: system(mass=MASKED), "mass")
    said = sentence(lambda: system(friction=ss.Coulomb), "friction")
    assert "the class Coulomb was given" in said
    assert sentence(lambda: system(mass=ss.Uniform), "mass").endswith("; make an object of it: Uniform(...).")


CLASSES = {
    "friction": lambda: system(friction=ss.Coulomb),
    "mass": lambda: system(mass=ss.Normal),
    "force": lambda: system(force=ss.Harmonic),
    "system": lambda: ss.simulate(ss.MassSpring, ss.Constant(1.0), t1=1.0),
    "base": lambda: ss.simulate(system(), ss.Harmonic, t1=1.0),
    "base ": lambda: ss.simulate_ensemble(system(), ss.PoissonSwitching, t1=1.0, samples=2, key=KEY),
    "law": lambda: sweep(law=ss.PoissonSwitching),
    "system ": lambda: sweep(system=ss.MassSpring),
    "method": lambda: ss.simulate(system(), ss.Constant(1.0), t1=1.0, method=ss.Exact),
    "method ": lambda: sweep(method=ss.Regularized),
    "y0": lambda: ss.simulate_ensemble(system(), LAW, t1=1.0, samples=2, key=KEY, y0=ss.Uniform),
    "y0[0]": lambda: ss.simulate(system(), ss.Constant(1.0), t1=1.0, y0=(ss.Uniform, 0.0)),
    "over": lambda: sweep(over=ss.design.Design),
    "correlation": lambda: ss.simulate_ensemble(
        system(), LAW, t1=1.0, samples=2, key=KEY, correlation=ss.GaussianCopula
    ),
    "key": lambda: LAW.sample(np.float64, 1.0),
    "gap": lambda: ss.SemiMarkovSwitching(ss.Weibull, 1.0),
    "signal": lambda: ss.RandomPhase(ss.Harmonic),
    "spectrum": lambda: ss.GaussianProcess(ss.KanaiTajimiSpectrum, 10.0),
    "jumps": lambda: ss.WithJumps(ss.Harmonic(1.0, 1.0), ss.PoissonSwitching),
    "base   ": lambda: ss.WithJumps(ss.Harmonic, LAW),
    "distribution": lambda: ss.Truncated(ss.Normal, low=0.0),
    "curve": lambda: ss.FrictionCurve(float),
    "solver": lambda: ss.Exact(solver=dict),
    "table": lambda: sticks(table={"sample": float}),
}


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_in_place_of_an_object(name):
    sentence(CLASSES[name], name.strip())


def test_numbers_that_overflow():
    """The difference of both is no number any more, and all draws would be infinite."""
    said = sentence(lambda: ss.Uniform(-1e308, 1e308), "low")
    assert "between -1e+100 and 1e+100, but -1e+308 was given; choose other units." in said
    assert ss.Uniform(-1e100, 1e100).icdf(0.75) == pytest.approx(5e99)
    sentence(lambda: ss.Normal(1e308, 1.0), "mean")
    sentence(lambda: ss.Triangular(0.0, 1.0, 1e308), "high")
    sentence(lambda: ss.Discrete([-1e308, 1e308]), "values")
    sentence(lambda: ss.Constant(-1e308), "speed")
    sentence(lambda: ss.Constant(np.array([1.0, -1e308])), "speed[1]")
    sentence(lambda: ss.Recorded([0.0, 1.0], [0.0, 1e308]), "values")
    sentence(lambda: ss.LogNormal.from_moments(1e-100, 1e100), "std")


# --- measured sticks


def test_durations_that_contradict_the_ends():
    said = sentence(lambda: sticks(table={"duration": [1.0, 2.0]}), "table")
    assert "row 1 has a stick from 3 to 4 s with a duration of 2 s; leave out the column that is wrong." in said
    shuffled = {"sample": [1, 0], "start": [1.0, 3.0], "end": [2.0, 4.0], "duration": [1.5, 1.0]}
    assert "row 0 has" in sentence(lambda: ss.Ensemble.from_sticks(shuffled, t1=5.0), "table")
    rounded = sticks(table={"duration": [1.0, 1.00001]})  # written with six digits
    assert rounded.flat_sticks.end.tolist() == [2.0, 4.0]


@pytest.mark.parametrize("unit", [5, "", " ", "two words", True, ["m"], "m\n", b"m", str, "3"])
def test_units_that_are_none(unit):
    sentence(lambda: sticks(position_unit=unit), "position_unit")


def test_the_unit_of_a_column_is_the_unit():
    table = {"position_mm": [1.0, 2.0]}
    assert sticks(table=table).statistics.position.unit == "mm"
    assert sticks(table=table, position_unit="mm").statistics.position.unit == "mm"
    assert sticks(table={"position": [1.0, 2.0]}).statistics.position.unit == "m"
    assert sticks(table={"position": [1.0, 2.0]}, position_unit="µm").statistics.position.unit == "µm"
    said = sentence(lambda: sticks(table=table, position_unit="m"), "position_unit")
    assert "the table has the column 'position_mm', but 'm' was given" in said


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"table": {"start": np.ma.array([1.0, 3.0], mask=[True, False])}}, "numbers in the column start"),
        ({"table": {"start": np.array([1.0, 3.0], complex)}}, "numbers in the column start"),
        ({"table": {"start": [[1.0], [2.0, 3.0]]}}, "must be a pandas DataFrame"),
        ({"table": {"sample": [0.0, math.inf]}}, "whole numbers or names in the column sample"),
        ({"table": {"sample": np.array(["a", None], object)}}, "in every row of the column sample"),
        ({"table": {"sample": [-1, 0]}, "samples": "two"}, "samples must be a whole number"),
        ({"samples": 10**12}, "samples must be at most 100000000"),
    ],
)
def test_columns_that_are_none(changed, said):
    assert said in sentence(lambda: sticks(**changed), "Argument")


# --- sweeps


def test_names_of_folders_and_files():
    axes = plt.figure().subplots()
    for wrong in (5, None, "", "a\0b", b"bytes", ["list"], float):
        sentence(lambda wrong=wrong: ss.Sweep.load(wrong), "folder")
        sentence(lambda wrong=wrong: plot.save(axes, wrong), "path")
        if wrong is not None:  # no folder
            sentence(lambda wrong=wrong: sweep().run(wrong), "folder")
    plt.close(axes.figure)


@pytest.mark.parametrize(
    "wrong", [5, None, "mu", {"stick_fraction": "mu"}, [5], [("a", "b", "c")], [(np.ones(2), "mu")]]
)
def test_sensitivities_of_a_sweep(wrong):
    said = sentence(lambda: sweep(sensitivities=wrong), "sensitivities")
    assert said.startswith("Argument sensitivities must hold pairs of a statistic and the parameter")


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("statistics", np.ones(2)),
        ("keep", np.ones(2)),
        ("keep", ["totals"]),
        ("y0", ss.Uniform(0.0, 1.0)),
        ("y0", (0.0,)),
        ("y0", 5),
        ("y0", np.ma.array([0.0, 1.0], mask=[True, False])),
        ("system", 5),
        ("system", None),
        ("batch", 10**39),
        ("standard_error", [1.0]),
        ("orders", True),
    ],
)
def test_other_arguments_of_a_sweep(name, wrong):
    sentence(lambda: sweep(**{name: wrong}), name)


def test_one_distribution_is_no_start():
    many = {"t1": 1.0, "samples": 2, "key": KEY}
    for make in (
        lambda: ss.simulate_ensemble(system(), LAW, **many, y0=ss.Uniform(0.0, 1.0)),
        lambda: ss.simulate(system(), ss.Constant(1.0), t1=1.0, y0=ss.Uniform(0.0, 1.0)),
        lambda: ss.sensitivity(ss.stick_fraction, system(), LAW, wrt="mu", **many, y0=ss.Uniform(0.0, 1.0)),
    ):
        assert "Uniform" in sentence(make, "y0")


def test_words_that_are_arrays():
    """Comparing an array with a word gives an array, which is neither true nor false."""
    for wrong in (np.array(["sticks", "totals"]), ["sticks"], 1.0):
        sentence(
            lambda wrong=wrong: ss.simulate_ensemble(system(), LAW, t1=1.0, samples=2, key=KEY, keep=wrong), "keep"
        )
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A JAX array is being set as static", UserWarning)  # of equinox, before
            sentence(lambda wrong=wrong: ss.Regularized(0.1, wrong), "shape")
        sentence(lambda wrong=wrong: ss.papers.stick_share_map(wrong), "belt")
        sentence(
            lambda wrong=wrong: ss.sensitivity(
                ss.stick_fraction, system(), LAW, wrt="mu", t1=1.0, samples=2, key=KEY, estimator=wrong
            ),
            "estimator",
        )


# --- files


FILE = '[system]\nmass = 1.0\n[base]\nlaw = "PoissonSwitching"\nspeed = 1.0\nrate = 1.0\n'
FILES = {
    "model is a list": ("[system]\nmodel = [1, 2]\n", "model in [system] must be one of MassSpring, MotorCart"),
    "model is a table": ("[system]\nmodel = { a = 1 }\n", "model in [system] must be one of MassSpring, MotorCart"),
    "law is a list": ("[base]\nlaw = [1]\n", "law in [base] must be one of"),
    "many digits": (f"[system]\nmass = {'9' * 100_000}\n", f"more than {sys.get_int_max_str_digits()} digits"),
    "beyond floats": (f"[system]\nmass = {'9' * 400}\n", "mass in [system]"),
    "nested": (f"[system]\nmass = {'[' * 100_000}{']' * 100_000}\n", "within too many others"),
    "home of nobody": ('[base]\nlaw = "Recorded"\nfile = "~nobody-here/x.csv"\n', "file must be the name of a file"),
}


@pytest.mark.parametrize("case", FILES)
def test_files_of_strange_values(tmp_path, case):
    text, said = FILES[case]
    path = tmp_path / "study.toml"
    path.write_text(text)
    for read in (read_config, read_sweep_config):
        with pytest.raises(StudyError) as caught:
            read(path)
        found = str(caught.value)
        assert found.startswith(f"{path}: ")
        assert said in found
        assert "\n" not in found
        assert len(found) < 600


RANGES = {
    "mu = { linspace = [1, 2, 1000000000] }": "at most 10000000 combinations, but have 1000000000; give fewer values.",
    f"mu = {{ logspace = [1, 2, {10**30}] }}": "at most 10000000 combinations, but have about 1e30; give fewer values.",
    "mu = { linspace = [1, 2, 4000] }\nrate = { logspace = [1, 2, 4000] }": "combinations, but have 16000000; give",
    f"mu = {{ linspace = [1, {10**400}, 3] }}": "must be [from, to, number of values]",
    "mu = { linspace = [-1e308, 1e308, 3] }": "must be [from, to, number of values]",
    f"mu = [1.0, {10**400}]": "mu must hold finite numbers",
    "mu = { linspace = [1, 2, true] }": "must be [from, to, number of values]",
    "mu = {}": "mu must be a list, or a table with linspace or logspace",
}


@pytest.mark.parametrize("values", RANGES)
def test_ranges_that_are_too_long_or_none(tmp_path, values):
    path = tmp_path / "study.toml"
    path.write_text(f"{FILE}[sweep.over]\n{values}\n")
    with pytest.raises(StudyError) as caught:
        read_sweep_config(path)
    assert RANGES[values] in str(caught.value)
    assert "\n" not in str(caught.value)


# --- what is shown


class _Broken:
    def __repr__(self):
        raise RuntimeError("no")


def test_showing_never_fails_and_is_short():
    for value in (_Broken(), 10**100_000, [0] * 10**6, "x" * 10**6, {"a": [1] * 10**4}, np.zeros(10**6), b"x" * 10**4):
        assert len(checks.show(value)) <= 80
        assert "\n" not in checks.show(value)
    assert checks.show(_Broken()) == "an object of the class _Broken"
    assert checks.show([1, 2]) == "[1, 2]"
    assert checks.show(True) == "True"
