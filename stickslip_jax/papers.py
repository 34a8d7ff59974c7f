"""The systems, base motions and initial states of published studies, ready to simulate, and two parameter sweeps.

All are by Lima and Sampaio: "An electromechanical system with uncertain stick-slip oscillations" (2022; `motor_cart`),
"Parametric analysis of the statistical model of the stick-slip process" (2017; `parametric_analysis`), "Stick-mode
duration of a dry-friction oscillator with an uncertain model" (2015; `stick_share_map`), and "Analysis of the
stick-mode duration of dry-friction oscillators with a stochastic approach" (the conference paper; all others). The
frequency ratio of the conference paper is ``r = f_b / (omega / 2 pi)``, the frequency of the base over the natural
frequency of the oscillator, both in Hz.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._dynamics.simulate import simulate
from ._dynamics.simulation import Simulation
from ._excitation.motion import Harmonic, RandomPhase, SourceVoltage
from ._excitation.piecewise_constant import (
    Constant,
    PiecewiseConstantLaw,
    PoissonSwitching,
    RandomSteps,
    SquareWave,
    VelocitySteps,
)
from ._foundation import checks
from ._foundation.types import Scalar
from ._sweep.sweep import Sweep
from ._systems.friction import Coulomb
from ._systems.mass_spring import MassSpring
from ._systems.motor_cart import MotorCart
from ._systems.system import System
from ._uncertainty.families import Uniform

BELT_SPEED = 1.0
"""Absolute value of the belt velocity, m/s (conference paper, section 3)."""

ANALYSIS_FRICTIONS, ANALYSIS_RATES = (0.25, 2.0, 8), (0.2, 5.0, 8)
"""Friction coefficients (first, last, number) and rates (1/s, spaced geometrically) of `parametric_analysis`."""
SHARE_FRICTIONS, SHARE_RATIOS, SHARE_SAMPLES = (0.1, 2.0, 20), (0.1, 2.5, 25), 1000
"""Friction coefficients and frequency ratios of `stick_share_map`, and how many samples a random belt has."""

Belt: TypeAlias = Literal["constant", "square", "harmonic", "random"]


class SetUp(NamedTuple):
    """The first arguments of `simulate` and `simulate_ensemble`.

    Attributes:
        system: The oscillator.
        law: The motion of the base or the voltage. A random law must be drawn for `simulate`: ``law.sample(key, t1)``.
        t1: The duration, s.
        y0: The initial state: position and velocity, m and m/s; of a `MotorCart` angle, angular velocity and current,
            rad, rad/s and A. A number, or a `Uniform` distribution of it.
    """

    system: System
    law: PiecewiseConstantLaw | RandomPhase | Harmonic
    t1: float
    y0: tuple[Scalar | Uniform, ...]


def belt_oscillator(mu: Scalar = 1.0) -> MassSpring:
    """The mass on the belt: 1 kg, stiffness 4 N/m, normal force 1 N, mu = 1 (conference paper, section 3).

    Args:
        mu: The friction coefficient, zero or positive; the 2015 paper varies it.

    Returns:
        The system.

    Raises:
        ValueError: For another coefficient.
    """
    return MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=Coulomb(mu=mu))


def constant_belt(mu: Scalar = 1.0) -> SetUp:
    """The belt that runs at constant speed (conference paper, figure 2).

    Args:
        mu: The friction coefficient, zero or positive.

    Returns:
        The set-up.

    Raises:
        ValueError: For another coefficient.
    """
    return SetUp(belt_oscillator(mu), Constant(BELT_SPEED), 200.0, (0.0, 1.0))


def square_wave_belt(ratio: Scalar, mu: Scalar = 1.0) -> SetUp:
    """The belt that runs backward and forward alternately (conference paper, equation 4, figures 3 to 6).

    Args:
        ratio: The frequency ratio r, positive.
        mu: The friction coefficient, zero or positive.

    Returns:
        The set-up.

    Raises:
        ValueError: For numbers outside these bounds.
    """
    return SetUp(belt_oscillator(mu), SquareWave(BELT_SPEED, _belt_period(ratio)), 200.0, (0.0, 1.0))


def harmonic_belt(ratio: Scalar, mu: Scalar = 1.0) -> SetUp:
    """The belt whose velocity is a cosine of the same amplitude and frequency ratio (2015 paper).

    In the end the mass sticks without end exactly where ``mu n >= m v0 omega |r - 1 / r|``, with the amplitude v0 of
    the velocity: the force that a stick needs then never exceeds the limit of friction.

    Args:
        ratio: The frequency ratio r, positive.
        mu: The friction coefficient, zero or positive.

    Returns:
        The set-up.

    Raises:
        ValueError: For numbers outside these bounds.
    """
    law = Harmonic(BELT_SPEED, 2 * math.pi / _belt_period(ratio))
    return SetUp(belt_oscillator(mu), law, 200.0, (0.0, 1.0))


def random_belt(ratio: Scalar, y0: tuple[float, float] = (0.0, 0.0), mu: Scalar = 1.0) -> SetUp:
    """The belt whose direction is random, forward or backward with equal probability in each interval of ``1 / f_b``.

    It is that of the conference paper, section 4 and figure 7.

    Args:
        ratio: The frequency ratio r, positive.
        y0: Initial position and velocity, m and m/s. The paper states zero initial conditions in its conclusions, and
            ``(0.0, 1.0)`` in section 3.
        mu: The friction coefficient, zero or positive.

    Returns:
        The set-up.

    Raises:
        ValueError: For numbers outside these bounds.
    """
    return SetUp(belt_oscillator(mu), RandomSteps(BELT_SPEED, _belt_period(ratio)), 200.0, y0)


def motor_cart(mu: Scalar = 0.2, t1: float = 2.0) -> SetUp:
    """The motor and cart with random phase of the voltage and random initial angle (Lima and Sampaio 2022, section 7).

    The paper does not give the initial angular velocity and current; both are 0 here.

    Args:
        mu: The friction coefficient, zero or positive; the paper runs 10,000 samples at 0.2 and at 0.5.
        t1: The duration, s, positive. The paper does not give it. After 2 s nearly all first sticks that end have
            ended.

    Returns:
        The set-up.

    Raises:
        ValueError: For numbers outside these bounds.
    """
    checks.positive("t1", t1, "s")
    if mu is None:  # which a cart with a friction law has
        raise checks.refused("mu", "be zero or positive", mu)
    return SetUp(MotorCart(mu=mu), RandomPhase(SourceVoltage()), t1, (Uniform(0.0, 2 * math.pi), 0.0, 0.0))


def steady_stick_share(
    ratio: Scalar, mu: Scalar = 1.0, y0: tuple[Scalar, Scalar] = (0.0, BELT_SPEED), *, periods: int = 400
) -> Float[Array, ""]:
    """The fraction of time spent sticking in a steady period of the square wave (conference paper, figure 6).

    It is that of the last of `periods` periods, exact for that period. After 400 periods it no longer changes from
    period to period for the ratios of the figure. Use ``jax.vmap`` for many ratios, `stick_share_map` for other belts.

    Args:
        ratio: The frequency ratio r, positive.
        mu: The friction coefficient, zero or positive.
        y0: Initial position and velocity, m and m/s.
        periods: How many to simulate, a whole number of at least 1.

    Returns:
        The fraction.

    Raises:
        ValueError: For arguments outside these bounds.

    >>> print(f"{100 * ss.papers.steady_stick_share(1.2):.2f} %")
    36.43 %
    """
    checks.require_threads_of_jax()
    periods = checks.whole_number("periods", periods)
    system, law, *_ = square_wave_belt(ratio, mu)
    period = jnp.asarray(_belt_period(ratio))
    t1 = periods * period
    assert isinstance(law, SquareWave)
    one = simulate(system, law.sample(None, t1, capacity=2 * periods + 1), t1, y0)
    return one.stick_time_between(t1 - period) / period


def _steady_share(one: Simulation) -> Array:
    """The stick share of the last period of a motion on a periodic belt."""
    base = cast("Harmonic | VelocitySteps", one.base)
    period = base.repeats_after if isinstance(base, Harmonic) else base.durations[:2].sum()
    return one.stick_time_between(one.t1 - period) / period


def parametric_analysis(*, samples: int = 10_000, t1: float = 200.0, seed: int = 0) -> Sweep:
    """Stick-slip statistics over the friction coefficient and the rate of a Poisson switching base (2017 paper).

    The paper varies the two one after the other; its values were not available. The grid of 64 points, the oscillator
    (that of the conference paper) and its start are this package's choice.

    Args:
        samples: Number of samples at each point.
        t1: The duration, s.
        seed: Of the random numbers.

    Returns:
        The sweep, which has not been run.

    Raises:
        ValueError: For arguments that `Sweep` refuses.
    """
    over = {"mu": np.linspace(*ANALYSIS_FRICTIONS), "rate": np.geomspace(*ANALYSIS_RATES)}
    law = PoissonSwitching(speed=BELT_SPEED, rate=1.0)
    return Sweep(belt_oscillator(), law, over=over, t1=t1, samples=samples, key=_key(seed), y0=(0.0, BELT_SPEED))


def stick_share_map(
    belt: Belt,
    *,
    mu: Sequence[float] | np.ndarray | None = None,
    ratios: Sequence[float] | np.ndarray | None = None,
    samples: int | None = None,
    t1: float = 200.0,
    seed: int = 0,
    y0: tuple[float, float] = (0.0, BELT_SPEED),
    steady: bool = False,
) -> Sweep:
    """The fraction of time spent sticking over friction coefficient and frequency ratio (2015 and conference papers).

    It is the fraction of all of ``[0, t1]``, the beginning included. The values of the 2015 paper were not available:
    the grid is this package's choice, all else is of the conference paper.

    Args:
        belt: "constant", which has no frequency, so that only `mu` varies; "square"; "harmonic", ``cos`` with the
            amplitude of the others; or "random", a new direction in each interval of ``1 / f_b``.
        mu: Friction coefficients; by default 20 from 0.1 to 2.
        ratios: Frequency ratios; by default 25 from 0.1 to 2.5.
        samples: Number of samples at each point; by default 1000 with the random belt, else 1.
        t1: The duration, s.
        seed: Of the random numbers.
        y0: Initial position and velocity, m and m/s.
        steady: Whether the result also has ``steady_share_mean``, the fraction of the last period before `t1`: that of
            the steady motion, where `t1` is long enough. For the belts "square" and "harmonic".

    Returns:
        The sweep, which has not been run.

    Raises:
        ValueError: For another belt, a steady period of a belt that has none, and for arguments that `Sweep` refuses.
    """
    checks.chosen("belt", belt, get_args(Belt))
    checks.truth("steady", steady)
    if steady and belt not in ("square", "harmonic"):
        raise checks.refused("steady", "be False for a belt without a period", steady)
    belts = {"square": square_wave_belt, "harmonic": harmonic_belt, "random": random_belt}
    over, law = {"mu": np.linspace(*SHARE_FRICTIONS) if mu is None else mu}, constant_belt().law
    if belt != "constant":
        over["r"], law = np.linspace(*SHARE_RATIOS) if ratios is None else ratios, belts[belt](1.0).law
    usual = SHARE_SAMPLES if belt == "random" else 1
    return Sweep(
        belt_oscillator(), law, over=over, t1=t1, samples=usual if samples is None else samples,
        key=_key(seed), y0=y0, keep="statistics" if belt == "random" else "totals",
        statistics=["stick_fraction"], outputs={"steady_share": _steady_share} if steady else None,
    )  # fmt: skip


def _key(seed: int) -> Array:
    return jax.random.key(checks.whole_number("seed", seed, minimum=0, maximum=2**63 - 1))


def _belt_period(ratio: Scalar) -> Scalar:
    """The period ``1 / f_b = 2 pi / (r omega)`` of the belt, s, with ``omega = sqrt(stiffness / mass)``."""
    checks.positive("ratio", ratio)
    system = belt_oscillator()
    return 2 * math.pi / (ratio * math.sqrt(system.stiffness / system.mass))
