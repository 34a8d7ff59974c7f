"""Cases whose compilation is timed, each in a process of its own."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax

import stickslip_jax as ss

from .setups import ANYWHERE, LAW, RANDOM_PHASE, START, harmonics, isolated, system
from .sizes import Sizes

SAMPLES = 16
Call = Callable[[int], Any]


def _default_simulation(sizes: Sizes) -> Call:
    return lambda number: ss.simulate(system(), LAW.sample(jax.random.key(number), t1=200.0), t1=200.0).stick_time


def _ensemble(moved: Any, law: Any, t1: float, y0: Any, keep: ss.Keep = "totals") -> Call:
    def call(number: int) -> Any:
        key = jax.random.key(number)
        many = ss.simulate_ensemble(moved, law, t1=t1, samples=SAMPLES, key=key, y0=y0, keep=keep, progress=False)
        return ss.stick_fraction(many).value

    return call


def _many_harmonics(which: int) -> Callable[[Sizes], Call]:
    return lambda sizes: _ensemble(system(), harmonics(sizes.harmonics[which]), 20.0, ANYWHERE)


def _gradient(sizes: Sizes) -> Call:
    base = ss.Harmonic(amplitude=1.0, angular_frequency=1.0)

    def stick_time(mu: Any) -> Any:
        return ss.simulate(system(mu), base, t1=20.0, y0=START, method=ss.Exact(max_steps=1_000)).stick_time

    return lambda number: jax.grad(stick_time)(1.0)


def _sensitivity(statistic: Any, sizes: Sizes) -> Call:
    def call(number: int) -> Any:
        found = ss.sensitivity(
            statistic, system(0.9), LAW, wrt="mu", t1=50.0, samples=sizes.sensitivity_compiled,
            key=jax.random.key(number), y0=(0.0, 0.5),
        )  # fmt: skip
        assert isinstance(found, ss.Sensitivity)
        return found.derivative

    return call


def _motor_cart(keep: ss.Keep) -> Callable[[Sizes], Call]:
    cart = ss.papers.motor_cart(0.5)
    return lambda sizes: _ensemble(cart.system, cart.law, cart.t1, cart.y0, keep)


CASES: dict[str, Callable[[Sizes], Call]] = {
    "one simulation, Poisson switching": _default_simulation,
    "ensemble, Poisson switching": lambda sizes: _ensemble(system(), LAW, 200.0, START),
    "ensemble, harmonic base": lambda sizes: _ensemble(system(), RANDOM_PHASE, 20.0, START),
    "ensemble, sum of 16 harmonics": _many_harmonics(1),
    "ensemble, sum of 64 harmonics": _many_harmonics(2),
    "gradient by mu, harmonic base": _gradient,
    "ensemble, Kanai-Tajimi": lambda sizes: _ensemble(isolated(), ss.KanaiTajimi(rms=1.5), 20.0, (0.0, 0.0)),
    "sensitivity of the mean duration": partial(_sensitivity, ss.mean_stick_duration),
    "sensitivity of the first stick's duration": partial(_sensitivity, ss.StickDuration(1)),
    "ensemble, motor and cart": _motor_cart("totals"),
    "ensemble, motor and cart, every stick": _motor_cart("sticks"),
}
