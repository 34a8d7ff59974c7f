"""The systems, friction laws and base motions to choose from, with numbers to start with."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from .._excitation.gaussian import GaussianProcess
from .._excitation.kanai_tajimi import KanaiTajimi
from .._excitation.piecewise_constant_laws import Constant, PoissonSwitching, RandomSteps, SquareWave
from .._excitation.random import RandomPhase
from .._excitation.semi_markov import SemiMarkovSwitching
from .._excitation.smooth import Harmonic
from .._excitation.spectra import KanaiTajimiSpectrum
from .._excitation.voltage import SourceVoltage
from .._fields import modules_in
from .._systems.composed_friction import Ageing, Directional, ExponentialGrowth
from .._systems.friction import Coulomb, FrictionLaw, Stribeck, VelocityWeakening
from .._uncertainty.families import Weibull
from ..study._config import StudyConfig
from ..study._examples import EXAMPLES
from .scene import Scene

SYSTEMS: Mapping[str, Mapping[str, Any]] = {
    "mass on a spring": {},
    "building on isolators": EXAMPLES["base-isolation"],
    "two blocks": EXAMPLES["two-blocks"],
    "motor and cart": EXAMPLES["motor-cart"],
}
"""Studies by the name of their system."""

FRICTIONS = ("Coulomb", "Coulomb, static above kinetic", "Stribeck", "VelocityWeakening", "Directional", "Ageing")


def _voltages() -> dict[str, Any]:
    return {"SourceVoltage": SourceVoltage(), "SourceVoltage, random phase": RandomPhase(SourceVoltage())}


def _motions() -> dict[str, Any]:
    spectrum = KanaiTajimiSpectrum(intensity=0.1, ground_frequency=2.0)
    harmonic = Harmonic(amplitude=1.0, angular_frequency=1.0)
    return {
        "PoissonSwitching": PoissonSwitching(speed=1.0, rate=1.0),
        "SemiMarkovSwitching": SemiMarkovSwitching(gap=Weibull(scale=2.0, shape=1.5), speed=1.0),
        "RandomSteps": RandomSteps(speed=1.0, interval=math.pi),
        "SquareWave": SquareWave(speed=1.0, period=math.pi),
        "Constant": Constant(speed=0.5),
        "Harmonic": harmonic,
        "Harmonic, random phase": RandomPhase(harmonic),
        "GaussianProcess": GaussianProcess(spectrum, cutoff=12.0),
        "KanaiTajimi": KanaiTajimi(rms=1.5),
    }


def bases_for(scene: Scene) -> Mapping[str, Any]:
    """The motions that can drive the system of `scene`, by name."""
    is_voltage = any(isinstance(part, SourceVoltage) for part in modules_in(scene.law))
    return _voltages() if is_voltage else _motions()


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
