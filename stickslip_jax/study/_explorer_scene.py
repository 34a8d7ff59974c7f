"""What the explorer shows: a system, what drives it, where it starts, and the numbers in all of them."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._excitation.gaussian import GaussianProcess, KanaiTajimi, KanaiTajimiSpectrum
from .._excitation.motion import Harmonic, RandomPhase, SourceVoltage
from .._excitation.piecewise_constant import Constant, PoissonSwitching, RandomSteps, SemiMarkovSwitching, SquareWave
from .._foundation import checks
from .._foundation.fields import Quantity, modules_in
from .._systems.friction import (
    Ageing,
    Coulomb,
    Directional,
    ExponentialGrowth,
    FrictionLaw,
    Stribeck,
    VelocityWeakening,
)
from .._systems.system import System, unit_at
from .._uncertainty.families import Weibull
from .._uncertainty.numbers import NumberPath, check_numbers, number_at, numbers_in, quantity_at, shown, with_numbers
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
        quantity_of(self, path).check(shown(path), value)
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
    where = {"system": scene.system, "law": scene.law, "y0": scene.y0}
    paths: list[NumberPath] = []
    for path, value in numbers_in(where):
        # A damping that is not set counts as zero.
        is_set = value is not None or (path[-1] == "damping" and quantity_at(scene, path) != Quantity())
        is_drawn = isinstance(scene.law, RandomPhase) and path == ("law", "signal", "phase")
        paths += [path] if is_set and not is_drawn else []
    values = [(path, float(number_at(scene, path) or 0.0)) for path in [*paths, ("t1",)]]
    return [
        MovableNumber(path, shown(path), _label(scene, path), value, *_slider(quantity_of(scene, path), value))
        for path, value in values
    ]


def read_number(text: str) -> float:
    """The number that someone wrote. Raises ValueError for anything but a finite one."""
    try:
        value = float(text.strip().replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{checks.show(text)} is not a number; write one such as 0.25 or 1e-3.")
    return value


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


def scene_of(config: StudyConfig, samples: int | None = None) -> Scene:
    """What a study's file describes. Raises ValueError and OSError for records that do not fit or cannot be read."""
    run, system = config.run, config.system.build()
    y0 = run.y0() or tuple(0.0 for _ in system.coordinates)
    method = run.method(config.system.has_inner_states)
    return Scene(system, config.base.build(), y0, run.t1, samples or run.samples, run.seed, method)


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
