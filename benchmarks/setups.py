"""What is simulated: the conference paper's study, ensembles in time steps, settings of regularised dynamics."""

from collections.abc import Callable
from typing import Any

import numpy as np

import stickslip_jax as ss

from .sizes import Sizes

OMEGA, SPEED, T1, RATE = 2.0, 1.0, 200.0, 1.0  # w = 2, rate/omega = 0.5, omega t1 = 400
INTERVALS = RATE * T1 + 1
"""Base intervals of one sample, on average."""
LAW = ss.PoissonSwitching(speed=SPEED, rate=RATE)
START = (0.0, 1.0)
RANDOM_PHASE = ss.RandomPhase(ss.Harmonic(amplitude=SPEED, angular_frequency=1.0))
ANYWHERE = (ss.Uniform(-0.5, 0.5), ss.Uniform(-1.0, 1.0))


def system(mu: Any = 1.0, **more: Any) -> ss.MassSpring:
    """The oscillator of the study: omega = 2, stick half-width 0.5 m at mu = 1."""
    return ss.MassSpring(mass=1.0, stiffness=OMEGA**2, normal_force=SPEED * OMEGA / 2, friction=ss.Coulomb(mu), **more)


def record(t1: float) -> ss.Recorded:
    """A base velocity recorded at 10 Hz."""
    times = np.linspace(0.0, t1, round(10 * t1) + 1)
    return ss.Recorded(times, np.cos(times) + 0.5 * np.sin(2.3 * times))


def harmonics(number: int) -> ss.SumOfHarmonics:
    """So many components, none like another."""
    frequencies = 0.3 + np.arange(number) * 2.7 / number
    return ss.SumOfHarmonics(np.full(number, 1 / np.sqrt(number)), frequencies, np.arange(number) ** 2.0)


def isolated() -> ss.MassSpring:
    """A mass of one tonne that slides on its foundation."""
    return ss.MassSpring(mass=1000.0, stiffness=1e4, normal_force=9810.0, friction=ss.Coulomb(0.05, mu_static=0.06))


STRIBECK = ss.MassSpring(1.0, OMEGA**2, 1.0, ss.Stribeck(mu=0.8, mu_static=1.0, stribeck_speed=0.3))
ENSEMBLES: dict[str, Callable[[Sizes], tuple[Any, Any, Any]]] = {
    "damped, Poisson switching": lambda sizes: (system(damping=0.2), LAW, START),
    "harmonic base of random phase": lambda sizes: (system(), RANDOM_PHASE, START),
    "recorded base, random start": lambda sizes: (system(), record(sizes.stepped_t1), ANYWHERE),
    "Stribeck friction, Poisson switching": lambda sizes: (STRIBECK, LAW, START),
    "Kanai-Tajimi earthquake": lambda sizes: (isolated(), ss.KanaiTajimi(rms=1.5), (0.0, 0.0)),
    "sum of harmonics, random start": lambda sizes: (system(), harmonics(sizes.harmonics[0]), ANYWHERE),
}
"""System, law and initial state."""

ONE_TRAJECTORY = ("under jax.jit", "value and gradient, under jax.jit", "as it is called")
"""Ways to simulate one."""

OWN_ENGINES = ("Poisson switching", "harmonic base", "motor and cart", "two blocks", "a user's system")
STICK_TIME, WIDE = "stick time", "stick time, wide vectors"
EVERY_STICK, MEAN = "every stick, in order", "mean stick duration"
"""Programs of one's own: the engines that they use, and what they return."""

THREADS = ("1 thread", "2 threads")
BELT = ss.Constant(0.2)
TWO_BLOCKS = ss.LinearStructure(
    (1.0, 1.0), ((2.2, -1.2), (-1.2, 2.2)),
    contacts=(
        ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.8, 1.0)),
        ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(1.0, 1.3)),
    ),
)  # fmt: skip


SHAKEN = 29.99  # s
BUILDING = ss.storeys_on_bearing(
    [2e5] * 7, stiffness=[8e7] * 6, damping=[4e5] * 6, friction=ss.Coulomb(ss.Uniform(0.05, 0.08))
)  # fmt: skip


def quake() -> ss.GroundAcceleration:
    """A record of 3,000 points: tones of 0.3 to 8 Hz that come and go."""
    draw, times = np.random.default_rng(0), np.arange(3000) * 0.01
    size, tone, phase = draw.normal(0, 0.6, 40), draw.uniform(0.3, 8, 40), draw.uniform(0, 7, 40)
    waves = size * np.sin(2 * np.pi * tone * times[:, None] + phase)
    return ss.GroundAcceleration(times, waves.sum(axis=1) * np.exp(-(((times - 10) / 6) ** 2)))


def chain(blocks: int) -> ss.LinearStructure:
    """Blocks in a row on a belt, as those of the baseline `scipy_chain`."""
    return ss.block_row(blocks, mass=1.0, between=1.0, to_ground=0.2, normal_force=1.0, friction=ss.Coulomb(0.3))


def chain_time(blocks: int, sizes: Sizes) -> float:
    """The horizon of such a chain, s."""
    return sizes.blocks_t1 / (1 if blocks <= 64 else 10)


def chain_name(blocks: int) -> str:
    """What its case is called."""
    return f"chain of {blocks} block{'s' * (blocks > 1)}"


def diagram_name(values: int) -> str:
    """What the case of a bifurcation diagram is called."""
    return f"diagram of {values} values"


def basin_name(side: int) -> str:
    """What the case of a grid of starts is called."""
    return f"basins of {side} x {side} starts"


HARMONIC = ss.Harmonic(amplitude=0.8, angular_frequency=1.3)
ON_HARMONIC = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3), damping=0.05)
"""The mass and the base of the baseline `scipy_harmonic`."""


ON_BRISTLES = ss.MassSpring(
    1.0, 4.0, 1.0, ss.LuGre(0.3, 0.4, stribeck_speed=0.01, stiffness=1e4, damping=100.0)
)  # fmt: skip
INNER_TOLERANCES = (1e-3, 1e-5, 1e-6)
BESIDE_BRISTLES = ss.Constant(0.1)
"""The mass and the belt of the baseline `scipy_lugre`."""


def inner_name(rtol: float, threads: str) -> str:
    """What the case of an ensemble of such masses is called."""
    return f"stickslip_jax, rtol {rtol:g}, {threads}"


def starts(number: int, blocks: int, samples: int) -> np.ndarray:
    """Positions (blocks, samples) in m, other ones in every round."""
    return np.random.default_rng(number).uniform(-1, 1, (blocks, samples))


# How many trajectories to time, and the settings, from coarse to fine.
REGULARIZED: dict[str, list[tuple[str, int, dict[str, Any]]]] = {
    "fixed steps": [
        (f"{shape}, width {width:g}, step {step:g}", 2048, {"width": width, "shape": shape, "step": step})
        for shape, width, step in (
            ("linear", 1e-3, 3e-2), ("linear", 1e-3, 1e-2), ("linear", 1e-4, 3e-2), ("linear", 1e-4, 1e-2),
            ("tanh", 1e-3, 1e-2), ("tanh", 1e-4, 1e-2), ("tanh", 1e-5, 1e-2),
        )
    ],
    "adaptive steps": [
        (f"{shape}, width {width:g}, rtol {rtol:g}", 2048, {"width": width, "shape": shape, "rtol": rtol})
        for shape, width, rtol in (
            ("linear", 1e-3, 1e-4), ("linear", 1e-4, 1e-5), ("tanh", 1e-3, 1e-6), ("tanh", 1e-4, 1e-4),
        )
    ],
}  # fmt: skip
