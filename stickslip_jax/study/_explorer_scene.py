"""What the explorer shows: a system, what drives it and the numbers in both, and the pictures of what it does."""

import dataclasses
import io
import math
import re
import sys
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from bokeh.models import BasicTicker, BasicTickFormatter, ColumnDataSource, Range1d
from bokeh.plotting import figure
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages

from .._dynamics.common.method import EXACT, Arguments, Exact, Regularized, slowest_time, step_for
from .._dynamics.engine_choice import engine_for
from .._dynamics.regularized.engine import ADAPTIVE_STEPS
from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation
from .._dynamics.switched.engine import steps_for
from .._ensemble.ensemble import Ensemble, simulate_ensemble
from .._excitation.excitation import excitation_of, is_random, law_of
from .._excitation.gaussian import GaussianProcess, KanaiTajimi, KanaiTajimiSpectrum
from .._excitation.motion import Harmonic, RandomPhase, SourceVoltage
from .._excitation.piecewise_constant import (
    Constant,
    PiecewiseConstantLaw,
    PoissonSwitching,
    RandomSteps,
    SemiMarkovSwitching,
    SquareWave,
)
from .._foundation import checks
from .._foundation.fields import Quantity, modules_in
from .._foundation.processes import available_memory
from .._foundation.types import Status
from .._sensitivity.call import sensitivity
from .._sensitivity.estimate import Sensitivity
from .._statistics.totals import mean_stick_count, mean_stick_duration, stick_fraction
from .._systems.friction import (
    Ageing,
    Coulomb,
    ExponentialGrowth,
    FrictionLaw,
    Stribeck,
    VelocityWeakening,
)
from .._systems.places import Directional
from .._systems.system import System, unit_at
from .._uncertainty.families import RandomNumber, Weibull
from .._uncertainty.inputs import Inputs, StochasticModel
from .._uncertainty.numbers import NumberPath, check_numbers, numbers_in, quantity_at, shown, with_numbers
from ..nonlinear import bifurcation_diagram
from ..plot import _style, histogram, phase_portrait, time_history
from ..plot._trajectory import joined, phases_of
from ._config import StudyConfig
from ._reading import EXAMPLES

# What the explorer shows: a system, what drives it, where it starts, and the numbers in all of them.


_STEPS = 400  # of a slider
_DURATION = Quantity("s", meaning="of each realisation", above=0)
_NAMES = {"mu": "friction coefficient", "mu_static": "static friction coefficient", "t1": "duration of a realisation"}
_NOT_SAID = ("friction", "signal", "jumps", "motion")  # of the way to a number


class Scene(NamedTuple):
    """What is simulated, as for `simulate_ensemble`: `t1` in s, so many `samples`, `seed` of the random numbers."""

    system: System
    law: Any
    y0: tuple[Any, ...]
    t1: float
    samples: int = 2000
    seed: int = 0
    method: Exact | Regularized = EXACT

    def with_number(self, path: NumberPath, value: float) -> "Scene":
        """The scene with another number at `path`. Raises ValueError for one that a constructor refuses."""
        quantity_of(self, path).check(without_unit(_label(self, path)), value)
        changed = with_numbers(self, [path], [value])
        check_numbers(changed)
        return changed


class MovableNumber(NamedTuple):
    """A number that can be moved.

    - `name`: as `sensitivity` takes it, "system.mass".
    - `label`: what it is, with its unit.
    - `low`, `high`, `step`: of its slider.
    """

    path: NumberPath
    name: str
    label: str
    value: float
    low: float
    high: float
    step: float

    def at(self, value: float) -> "MovableNumber":
        """The same at another value, which its slider reaches."""
        return self._replace(value=value, low=min(self.low, value), high=max(self.high, value))


def quantity_of(scene: Scene, path: NumberPath) -> Quantity:
    """Unit and bounds of the number at `path`."""
    return _DURATION if path == ("t1",) else quantity_at(scene, path)


def numbers_of(scene: Scene) -> list[MovableNumber]:
    """The numbers that can be moved: of the system, of what drives it, of the start, and the duration."""
    found: list[MovableNumber] = []
    for path, given in numbers_in({"system": scene.system, "law": scene.law, "y0": scene.y0, "t1": scene.t1}):
        # A damping that is not set counts as zero.
        is_set = given is not None or (path[-1] == "damping" and quantity_at(scene, path) != Quantity())
        is_drawn = isinstance(scene.law, RandomPhase) and path == ("law", "signal", "phase")
        if is_set and not is_drawn:
            value, ends_and_step = float(given or 0.0), _slider(quantity_of(scene, path), float(given or 0.0))
            found.append(MovableNumber(path, shown(path), _label(scene, path), value, *ends_and_step))
    return found


def read_number(text: str) -> float:
    """The number that someone wrote. Raises ValueError for anything but a finite one."""
    try:
        value = float(text.strip().replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{checks.show(text)} is not a number; write one such as 0.25 or 1e-3.")
    return value


def without_unit(label: str) -> str:
    """The name of a number, from its label."""
    return re.sub(r" \([^()]*(\([^()]*\)[^()]*)?\)$", "", label)


def in_words(said: str, numbers: Sequence[MovableNumber]) -> str:
    """What the package says of a scene, with the names that its numbers have in the page, and without those of code."""
    names = {one.name: without_unit(one.label) for one in numbers}
    names |= {
        str(one.path[-1]): label for one, label in zip(numbers, names.values(), strict=True) if one.path[0] != "y0"
    }
    known = sorted((name for name in names if name in _NAMES or "_" in name or "." in name), key=len, reverse=True)
    any_of = "|".join(map(re.escape, known))
    said = re.sub(rf"(?<![\w.])(?:{any_of})(?![\w\]])", lambda of: names[of[0]], said)
    said = re.sub(r"\bArguments? (?:law\.|system\.)?", "", said).replace("samples", "realisations")
    clauses = [one for one in re.split(r"(?<=[.;]) ", said) if not re.search(r"`|docs/|\w=|\by0\b", one)]
    said = " ".join(clauses).rstrip(" ;.") + "."
    return said[:1].upper() + said[1:]


def _label(scene: Scene, path: NumberPath) -> str:
    unit = "s" if path == ("t1",) else unit_at(scene, path)
    if path[0] == "y0":
        ends = {"low": "initial {}, lowest", "high": "initial {}, highest"}
        coordinate = scene.system.coordinates[int(path[1])]
        text = ends.get(str(path[-1]), "initial {}").format(coordinate.name)
    else:
        words: list[str] = []
        for part in path[1:] or path:
            if isinstance(part, int):
                words[-1] = f"{words[-1].removesuffix('s')} {part}"
            elif part not in _NOT_SAID or part == path[-1]:
                words.append(_NAMES.get(part, part.replace("_", " ")))
        text = ", ".join(words[::-1])
    return f"{text} ({unit})" if unit not in ("", "1") else text


def _slider(about: Quantity, value: float) -> tuple[float, float, float]:
    """Ends and step of a slider: the bounds where there are some, else a range about the value."""
    bounds = [float(one) for one in (about.above, about.at_least) if one is not None]
    low = max(bounds, default=-math.inf)
    high = math.inf if about.below is None else float(about.below)
    if math.isinf(low) and math.isinf(high):
        reach = _round_up(2 * abs(value) or 1.0)
        low, high = -reach, reach
    elif math.isinf(high):
        high = low + _round_up(2 * (value - low) or 1.0)
    elif math.isinf(low):
        low = high - _round_up(2 * (high - value) or 1.0)
    step = (high - low) / _STEPS
    if about.above is not None and low == about.above:
        low += step
    if about.below is not None and high == about.below:
        high -= step
    return min(low, value), max(high, value), step


def _round_up(value: float) -> float:
    """The next of 1, 2, 4 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(float(np.round(power * one, 12)) for one in (1, 2, 4, 5, 10) if one * power >= value * (1 - 1e-12))


# The systems, friction laws and base motions to choose from, with numbers to start with.


SYSTEMS: Mapping[str, Mapping[str, Any]] = {
    "mass on a spring": {},
    "building on isolators": EXAMPLES["base-isolation"],
    "two blocks": EXAMPLES["two-blocks"],
    "motor and cart": EXAMPLES["motor-cart"],
}
"""Studies by the name of their system."""

FRICTIONS = ("Coulomb", "Coulomb, static above kinetic", "Stribeck", "VelocityWeakening", "Directional", "Ageing")


def bases_for(scene: Scene) -> Mapping[str, Any]:
    """The motions that can drive the system of `scene`, by name."""
    if any(isinstance(part, SourceVoltage) for part in modules_in(scene.law)):
        return {"SourceVoltage": SourceVoltage(), "SourceVoltage, random phase": RandomPhase(SourceVoltage())}
    harmonic = Harmonic(amplitude=1.0, angular_frequency=1.0)
    return {
        "PoissonSwitching": PoissonSwitching(speed=1.0, rate=1.0),
        "SemiMarkovSwitching": SemiMarkovSwitching(gap=Weibull(scale=2.0, shape=1.5), speed=1.0),
        "RandomSteps": RandomSteps(speed=1.0, interval=math.pi),
        "SquareWave": SquareWave(speed=1.0, period=math.pi),
        "Constant": Constant(speed=0.5),
        "Harmonic": harmonic,
        "Harmonic, random phase": RandomPhase(harmonic),
        "GaussianProcess": GaussianProcess(KanaiTajimiSpectrum(intensity=0.1, ground_frequency=2.0), cutoff=12.0),
        "KanaiTajimi": KanaiTajimi(rms=1.5),
    }


def scene_of(config: StudyConfig) -> Scene:
    """What a study's file describes. Raises ValueError and OSError for records that do not fit or cannot be read."""
    run, system = config.run, config.system.build()
    y0 = run.y0() or tuple(0.0 for _ in system.coordinates)
    method = run.method(config.system.has_inner_states)
    return Scene(system, config.base.build(), y0, run.t1, run.samples, run.seed, method)


def scene_called(name: str) -> Scene:
    """The one of `SYSTEMS` with this name."""
    return scene_of(StudyConfig.model_validate(dict(SYSTEMS[name])))


def has_friction_to_choose(system: object) -> bool:
    """Whether the friction laws of a system can be replaced."""
    return any(isinstance(part, FrictionLaw) for part in modules_in(system)) or hasattr(system, "friction")


def friction_called(name: str, system: object) -> FrictionLaw:
    """A friction law by its name in `FRICTIONS`, with the coefficient that the system has now."""
    laws = [one for one in modules_in(system) if isinstance(one, FrictionLaw)]
    found = [getattr(one, key, None) for key in ("mu", "mu_static") for one in (*laws, system)]
    mu = next((float(one) for one in found if isinstance(one, (int, float))), 0.5)
    high, low, kinetic = round(1.3 * mu, 12), round(0.7 * mu, 12), Coulomb(mu)
    return {
        "Coulomb": kinetic,
        "Coulomb, static above kinetic": Coulomb(mu, high),
        "Stribeck": Stribeck(mu, high, stribeck_speed=0.2),
        "VelocityWeakening": VelocityWeakening(mu, weakening=0.2),
        "Directional": Directional(kinetic, Coulomb(low)),
        "Ageing": Ageing(kinetic, ExponentialGrowth(amount=round(0.3 * mu, 12), time=1.0)),
    }[name]


def with_friction(system: Any, law: FrictionLaw) -> Any:
    """The system with `law` in all its contacts."""
    new: dict[str, Any] = {}
    for field in dataclasses.fields(system):
        value = getattr(system, field.name)
        if field.name == "friction":
            new["friction"] = law
        elif isinstance(value, tuple) and any(hasattr(one, "friction") for one in value):
            new[field.name] = tuple(with_friction(one, law) if hasattr(one, "friction") else one for one in value)
        elif field.name == "mu" and hasattr(system, "friction"):
            new["mu"] = None
    return dataclasses.replace(system, **new)


# What the explorer shows as a Python program that runs as it is.


_PACKAGE = __name__.partition(".")[0]
_WIDTH = 88


class NotWritable(ValueError):
    """Raised for what has no expression in Python that a program could hold."""


def as_python(scene: Scene) -> str:
    """A program that simulates the same ensemble, prints its statistics and draws its first realisation.

    Raises NotWritable for a system or base made of something else than numbers and objects with fields.
    """
    imports: set[tuple[str, str]] = set()
    is_usual = scene.method == Scene._field_defaults["method"]
    names = ("system", "law", "y0", *(() if is_usual else ("method",)))
    parts = "".join(f"{name} = {_expression(getattr(scene, name), imports)}\n" for name in names)
    option = "" if is_usual else ", method=method"
    own = "".join(f"from {module} import {name}\n" for module, name in sorted(imports) if module != "__main__")
    x64 = "True" if jnp.result_type(float) == jnp.float64 else "False"
    return f"""\
import jax

jax.config.update("jax_enable_x64", {x64})

import stickslip_jax as ss
{own}
{parts}
many = ss.simulate_ensemble(
    system, law, t1={scene.t1!r}, samples={scene.samples},
    key=jax.random.key({scene.seed}), y0=y0{option},
)
print(ss.mean_stick_duration(many))
print(ss.mean_stick_count(many))
print(ss.stick_fraction(many))

first_system, base, start = many.realization(0)
one = ss.simulate(first_system, base, t1={scene.t1!r}, y0=start{option})
ss.plot.save(ss.plot.phase_portrait(one), "phase_portrait.png", overwrite=True)
"""


def _expression(value: Any, imports: set[tuple[str, str]], indent: int = 0) -> str:
    """The Python expression of a value; classes of others are added to `imports`."""
    if isinstance(value, (bool, int, float, str)) or value is None:
        return repr(value)
    if isinstance(value, (np.number, np.ndarray, jax.Array)):
        return repr(np.asarray(value).tolist())
    if isinstance(value, tuple):
        return _call("", [_expression(one, imports, indent + 4) for one in value], indent, comma=len(value) == 1)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        given = [
            f"{field.name}={_expression(getattr(value, field.name), imports, indent + 4)}"
            for field in dataclasses.fields(value)
            if field.init
            and (field.default is dataclasses.MISSING or not eqx.tree_equal(field.default, getattr(value, field.name)))
        ]
        kind = type(value)
        if kind.__module__.partition(".")[0] != _PACKAGE:
            if "." in kind.__qualname__:
                raise NotWritable(f"{kind.__qualname__} is defined in a function, where no program can import it.")
            imports.add((kind.__module__, kind.__qualname__))
            return _call(kind.__name__, given, indent)
        if getattr(sys.modules[_PACKAGE], kind.__name__, None) is not kind:
            raise NotWritable(f"{kind.__name__} has no public name; keep the program that made it.")
        return _call(f"ss.{kind.__name__}", given, indent)
    raise NotWritable(f"{type(value).__name__} cannot be written as Python; keep the program that made it.")


def _call(name: str, arguments: list[str], indent: int, comma: bool = False) -> str:
    line = f"{name}({', '.join(arguments)}{',' if comma else ''})"
    if "\n" not in line and len(line) + indent <= _WIDTH - 12:
        return line
    inside = "".join(f"{' ' * (indent + 4)}{one},\n" for one in arguments)
    return f"{name}(\n{inside}{' ' * indent})"


# The numbers of all pictures of a scene: one realisation, and the sticks of thousands.


LONGEST_HISTORY = 60.0  # s, that is drawn
_BINS = 40
_LEAST_CAPACITY = 1024  # intervals of the base: programs are compiled for few of them


Data: TypeAlias = dict[str, Any]
"""What a source of Bokeh holds: arrays by the names of its columns."""


class Motion(NamedTuple):
    """What is drawn of the first realisation.

    - `curves`: of "slip" and "stick", the time "t", a coordinate "x" and its rate "y", NaN where a line breaks; of
      "base" the time "t" and the velocity "y", where it is one that the body can have.
    - `problem`: why it is not drawn, or "".
    """

    curves: dict[str, Data]
    problem: str


class Statistics(NamedTuple):
    """What is drawn of all realisations.

    - `bars`: the histograms of sticks in those that reached the end, with their sides "left" and "right" and the height
      "top".
    - `rows`: of the table: a statistic, its mean with the standard error, and the 95 % interval.
    - `unfinished`: how many did not.
    """

    bars: dict[str, Data]
    rows: list[tuple[str, str, str]]
    unfinished: int


def motion_of(scene: Scene) -> Motion:
    """Simulate the first realisation of a scene. Raises ValueError for what `simulate` refuses, and for too much."""
    require_little(scene)
    one = realization(scene)
    is_whole = int(one.status) == Status.FINISHED
    phases = phases_of(one, (0.0, min(scene.t1, LONGEST_HISTORY))) if is_whole else []
    columns = dict(zip("txy", ("times", *coordinates_of(scene)), strict=True))
    curves = {}
    for name in _CURVES:
        parts = [one for one in phases if one.sticks == (name == "stick")]
        curves[name] = {column: joined(parts, values) for column, values in columns.items()}
    columns = {"t": "times", "y": "base_velocity"}
    shows_base = bool(phases) and scene.system.look.second_is_base_velocity
    curves["base"] = {name: joined(phases, of) if shows_base else np.zeros(0) for name, of in columns.items()}
    problem = "" if is_whole else f"This realisation has no end: {Status(int(one.status)).meaning}."
    return Motion(curves, problem)


def ensemble_of(scene: Scene) -> Ensemble:
    """Simulate all realisations. Raises ValueError for what `simulate_ensemble` refuses, and for too much."""
    steps, kind = require_little(scene)
    many = simulate_ensemble(
        scene.system, scene.law, t1=scene.t1, samples=scene.samples, key=jax.random.key(scene.seed), y0=scene.y0,
        method=scene.method, keep="sticks", progress=False,
    )  # fmt: skip
    if many.run_seconds > _MEASURABLE:
        _seconds_of_step[kind] = many.run_seconds / steps
    return many


def statistics_of(scene: Scene) -> Statistics:
    """What is drawn of `ensemble_of` the scene."""
    many = ensemble_of(scene)
    sticks = many.finished_sticks()
    # The share of realisations with each number of sticks; of neighbouring numbers together where they are many.
    counts = sticks.count
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    width = max(1, -(-(high - low + 1) // (2 * _BINS)))
    edges = np.arange(low, high + width + 1, width) - 0.5
    shares = np.histogram(counts, edges)[0] / max(1, len(counts))
    bars = {
        "durations": _bars_of_times(sticks.duration),
        "starts": _bars_of_times(sticks.start, scene.t1),
        "numbers": _bars(shares, edges),
    }
    rows = []
    for one in (of(many) for of in (mean_stick_duration, mean_stick_count, stick_fraction)):
        low, high = one.interval()
        between = f"{low:.4g} to {high:.4g}" if math.isfinite(low + high) else ""
        rows.append((one.name, one.without_name().replace("+-", "±"), between))
    return Statistics(bars, rows, scene.samples - int(many.status_counts.get(Status.FINISHED, 0)))


# What a simulation would cost, before it begins.


LONGEST_RUN = 60.0  # s
_BYTES_OF_STEP = 100  # of the sticks, at most
_MEASURABLE = 0.05  # s
_seconds_of_step: dict[str, float] = {}
"""Measured in this process, by what is simulated."""


def require_little(scene: Scene) -> tuple[float, str]:
    """The steps of all realisations together, at most, and what kind of simulation this is.

    Raises ValueError with the time and memory that it would take, where that is more than `LONGEST_RUN` or half of what
    is free.
    """
    model = StochasticModel(scene.system, law_of(scene.law), scene.y0)
    inputs = Inputs.of(model, scene.samples, jax.random.key(scene.seed))
    system, law, _ = inputs.of_sample(0, jnp.dtype(jnp.result_type(float)))
    law = inputs.realization_of(0, law, scene.t1) if inputs.has_sampled_law else law
    if engine_for(Arguments(system, law, scene.method, scene.t1)).by_intervals:
        each = float(law.capacity(scene.t1))
    else:
        excitation = excitation_of(law, "law")
        try:
            each = float(steps_for(system, excitation, scene.t1, step_for(system, excitation, scene.method)))
        except ValueError:  # of a time scale that is not known, which adaptive steps do not need
            if isinstance(scene.method, Exact) or scene.method.step is not None:
                raise
            each = float(ADAPTIVE_STEPS)
    steps, kind = scene.samples * each, str(jax.tree.structure((scene.system, scene.law, scene.method)))
    seconds, size = steps * _seconds_of_step.get(kind, 1e-6), steps * _BYTES_OF_STEP
    if seconds > LONGEST_RUN or size > available_memory() / 2:
        raise ValueError(
            f"This was not begun: it would take about {_time(seconds)} and up to {size / 1e9:,.1f} GB of memory. Begun "
            f"is what takes at most {LONGEST_RUN:g} s and half of the memory that is free: choose a shorter duration, "
            "a slower base, or fewer realisations."
        )
    return steps, kind


def _time(seconds: float) -> str:
    units = {"days": 86400, "hours": 3600, "minutes": 60, "s": 1}
    name, size = next(one for one in units.items() if seconds > 2 * one[1] or one[0] == "s")
    return f"{seconds / size:,.0f} {name}"


def slope_of(scene: Scene, name: str) -> tuple[Sensitivity, list[str]]:
    """The derivative of the mean stick duration by a number, and the sentences of its warnings.

    Raises ValueError for what `sensitivity` refuses.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RuntimeWarning)
        found = sensitivity(
            mean_stick_duration, scene.system, scene.law, wrt=name, t1=scene.t1, samples=scene.samples,
            key=jax.random.key(scene.seed), y0=scene.y0, method=scene.method,
        )  # fmt: skip
    assert isinstance(found, Sensitivity)
    return found, [str(one.message) for one in caught]


def realization(scene: Scene) -> Simulation:
    """The first realisation of the ensemble of a scene, with the sticks that are counted there."""
    model = StochasticModel(scene.system, law_of(scene.law), scene.y0)
    inputs = Inputs.of(model, scene.samples, jax.random.key(scene.seed))
    system, law, y0 = inputs.of_sample(0, jnp.dtype(jnp.result_type(float)))
    base: Any = law
    if isinstance(law, PiecewiseConstantLaw) and law.is_random:
        # A larger capacity only continues the motion, and one program serves for many rates.
        capacity = _LEAST_CAPACITY
        while capacity < law.capacity(scene.t1):
            capacity *= 4
        base = law.sample(jax.random.fold_in(jax.random.key(scene.seed), 0), scene.t1, capacity=capacity)
    elif is_random(law):
        base = inputs.realization_of(0, law, scene.t1)
    one = simulate(system, base, t1=scene.t1, y0=y0, method=scene.method)
    if one.sticks.contact is None:
        return one
    counted = scene.system.tracks.counted
    return one.of_contact(counted) if counted is not None and counted >= 0 else one.of_all_contacts()


def coordinates_of(scene: Scene) -> tuple[int, int]:
    """The numbers of the coordinates in a phase portrait: the first, and its rate."""
    known = scene.system.coordinates
    rates = [at for at, one in enumerate(known) if one.unit == f"{known[0].unit}/s"]
    return 0, (rates or [min(1, len(known) - 1)])[0]


def labels_of(scene: Scene) -> tuple[str, str]:
    """The coordinates of a phase portrait with their units."""
    first, rate = (scene.system.coordinates[at] for at in coordinates_of(scene))
    return _style.quantity_label(first.name, first.unit), _style.quantity_label(rate.name, rate.unit)


def _bars_of_times(values: np.ndarray, end: float | None = None) -> Data:
    """A histogram of times as a density, from 0 to their largest or to `end`."""
    if not len(values):
        return _bars(np.zeros(1), np.array([0.0, end or 1.0]))
    return _bars(*np.histogram(values, _BINS, (0.0, end or float(np.max(values)) or 1.0), density=True))


def _bars(heights: np.ndarray, edges: np.ndarray) -> Data:
    return {"left": edges[:-1], "right": edges[1:], "top": heights}


# The bifurcation diagram of a scene whose base is deterministic.


_VALUES, _TRANSIENT, _KEPT = 120, 100, 40


def is_deterministic(scene: Scene) -> bool:
    """Whether what drives the system is the same in all realisations."""
    return not is_random(scene.law)


def section_of(scene: Scene, number: MovableNumber) -> tuple[Data, str]:
    """The first coordinate once a period, "state", over the range of the slider of `number`, "value"; and a sentence.

    It starts as the scene does; a random start counts by its median. Values that the system does not allow are left
    out. Raises ValueError for a base without a period, and for numbers that `bifurcation_diagram` refuses.
    """
    every = np.linspace(number.low, number.high, _VALUES)
    values = np.array([one for one in every if _is_allowed(scene, number.path, one)])
    start = [float(one.icdf(jnp.asarray(0.5))) if isinstance(one, RandomNumber) else float(one) for one in scene.y0]
    period = slowest_time(scene.system, scene.law) if getattr(scene.law, "repeats_after", None) in (0, 0.0) else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of motions that do not reach the end, or have not settled
        found = bifurcation_diagram(
            scene.system, scene.law, {number.name: values}, y0=start, transient=_TRANSIENT, kept=_KEPT, period=period,
            longest_transient=_TRANSIENT, progress=False,
        )  # fmt: skip
    states = np.asarray(found[scene.system.coordinates[0].variable]).reshape(len(values), -1)
    note = f"From one start at each value, after {_TRANSIENT} periods."
    if len(values) < len(every):
        note += f" Only from {values[0]:.4g} to {values[-1]:.4g}, which the other numbers of the system allow."
    return {"value": np.repeat(values, states.shape[1]), "state": states.ravel()}, note


def _is_allowed(scene: Scene, path: NumberPath, value: float) -> bool:
    try:
        scene.with_number(path, float(value))
    except ValueError:
        return False
    return True


# The pictures of the explorer, by Bokeh: made once, then given new numbers.


_HEIGHT = 250
_PLAIN_LEGEND = """
:host { background: none !important; border: none !important; }
.bk-label { color: var(--design-background-text-color, inherit) !important; }
"""
_CURVES = {"slip": (_style.FORWARD, _style.SLIP_WIDTH), "stick": (_style.STICK, _style.STICK_WIDTH)}
_BARS = {
    "durations": ("Stick durations", "duration (s)", "density (1/s)"),
    "starts": ("Stick starts", "start (s)", "density (1/s)"),
    "numbers": ("Sticks in a realisation", "number of sticks", "probability"),
}


class Figures:
    """The phase portrait, the histories, and the histograms of durations, starts and numbers of sticks; `all`."""

    def __init__(self, scene: Scene):
        x, y = labels_of(scene)
        self.curves = {name: ColumnDataSource({"t": [], "x": [], "y": []}) for name in _CURVES}
        self.bars = {name: ColumnDataSource({"left": [], "right": [], "top": []}) for name in _BARS}
        self.portrait = _figure("Phase portrait", x, y, **_ranges())
        self.history = _figure("Position over time", "time (s)", x, **_ranges())
        self.velocities = _figure("Velocity over time", "time (s)", y, **_ranges())
        self.base = ColumnDataSource({"t": [], "y": []})
        self.velocities.line("t", "y", source=self.base, color=_style.BASE, line_width=1.5, legend_label="base")
        for plot, across, up in (
            (self.portrait, "x", "y"), (self.history, "t", "x"), (self.velocities, "t", "y"),
        ):  # fmt: skip
            for name, (color, width) in _CURVES.items():
                plot.line(across, up, source=self.curves[name], color=color, line_width=width, legend_label=name)
            plot.add_layout(plot.legend[0], "above")
            plot.legend[0].update(orientation="horizontal", padding=2, margin=2, stylesheets=[_PLAIN_LEGEND])
        self.histograms = {name: _figure(*labels, **_ranges()) for name, labels in _BARS.items()}
        for name, plot in self.histograms.items():
            plot.quad(
                left="left", right="right", top="top", bottom=0, source=self.bars[name], color=_style.STICK,
                line_color="white", line_width=0.5,
            )  # fmt: skip
        self.all = self.portrait, self.history, self.velocities, *self.histograms.values()

    def show_motion(self, scene: Scene, motion: Motion) -> None:
        """Draw another realisation."""
        self.history.x_range.end = self.velocities.x_range.end = min(scene.t1, LONGEST_HISTORY)
        for name, source in self.curves.items():
            source.data = motion.curves[name]
        self.base.data = motion.curves["base"]
        for axis, column, names in (
            (self.portrait.x_range, "x", _CURVES), (self.portrait.y_range, "y", _CURVES),
            (self.history.y_range, "x", _CURVES), (self.velocities.y_range, "y", motion.curves),
        ):  # fmt: skip
            values = np.concatenate([motion.curves[name][column] for name in names])
            known = values[np.isfinite(values)]
            if len(known):
                margin = 0.05 * float(np.ptp(known)) or 0.5
                axis.update(start=float(known.min()) - margin, end=float(known.max()) + margin)

    def show_statistics(self, statistics: Statistics) -> None:
        """Draw other histograms."""
        for name, bars in statistics.bars.items():
            self.bars[name].data = bars
            plot = self.histograms[name]
            plot.x_range.update(start=bars["left"][0], end=bars["right"][-1])
            plot.y_range.end = 1.05 * np.max(bars["top"]) or 1.0


class SectionFigure:
    """States once a period over the values of one number: the bifurcation diagram."""

    def __init__(self, scene: Scene) -> None:
        self.points = ColumnDataSource({"value": [], "state": []})
        self.plot = _figure("Bifurcation diagram", "", f"{labels_of(scene)[0]}, once a period", height=420)
        self.plot.scatter("value", "state", source=self.points, size=3, color=_style.MASS, line_alpha=0)

    def show(self, number: MovableNumber, points: Data) -> None:
        """Draw the diagram over another number."""
        self.plot.xaxis.axis_label, self.points.data = number.label, points


def _ranges() -> dict[str, Any]:
    """Of both axes, set with each picture: those that the page would find itself take it longer."""
    return {name: Range1d(start=0, end=1) for name in ("x_range", "y_range")}


def _figure(title: str, x_label: str, y_label: str, height: int = _HEIGHT, **options: Any) -> Any:
    plot = figure(
        title=title, x_axis_label=x_label, y_axis_label=y_label, height=height, sizing_mode="stretch_width",
        toolbar_location=None, tools="", output_backend="canvas", **options,
    )  # fmt: skip
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.formatter = BasicTickFormatter(power_limit_low=-4)
    plot.axis.minor_tick_line_color = None
    plot.xaxis.ticker = BasicTicker(desired_num_ticks=5)  # which a telephone has room for
    plot.grid.grid_line_alpha = 0.4
    return plot


# The pictures of a scene as a file.


def sheet_of(scene: Scene) -> bytes:
    """A PDF: phase portrait and time history of a realisation, histograms of the sticks of all, a page for each."""
    one, many = realization(scene), ensemble_of(scene)
    pages: list[Axes] = []
    if int(one.status) == Status.FINISHED:
        window = (0.0, min(scene.t1, LONGEST_HISTORY))
        if one.sticks.contact is None:
            pages.append(phase_portrait(one, window=window))
        pages.append(time_history(one, window=window)[0])
    of_all = many.statistics
    has_sticks = len(many.finished_sticks().duration) > 0
    pages += map(histogram, (of_all.stick_count, *((of_all.duration, of_all.start) if has_sticks else ())))
    stored = io.BytesIO()
    with PdfPages(stored) as file:
        for axes in pages:
            page = axes.get_figure(root=True)
            file.savefig(page)
            plt.close(page)
    return stored.getvalue()
