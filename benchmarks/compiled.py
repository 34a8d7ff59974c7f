"""Cases whose compilation is timed, each in a process of its own."""

from collections.abc import Callable
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss

from .setups import ANYWHERE, BELT, LAW, RANDOM_PHASE, START, STRIBECK, harmonics, isolated, system
from .sizes import Sizes

SAMPLES = 16
Call = Callable[[int], Any]


def _yardstick(sizes: Sizes) -> Call:
    """A smooth oscillator with three states by diffrax, until an event: what a user of JAX waits for elsewhere."""

    def rates(t: Any, y: Any, args: Any) -> Any:
        return jnp.stack([y[1], -4.0 * y[0] - jnp.tanh(y[1] - jnp.cos(t)) - 0.1 * y[2], y[0] - y[2]])

    event = diffrax.Event(lambda t, y, args, **kwargs: y[0] - 10.0)  # one function, so that it is compiled once

    def call(number: int) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates), diffrax.Tsit5(), 0.0, 20.0, 0.01, jnp.array([0.0, 1.0, 0.0]),
            saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, 20.0, 100)),
            stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8),
            event=event,
        )  # fmt: skip
        assert solution.ys is not None
        return solution.ys

    return call


def _default_simulation(sizes: Sizes) -> Call:
    return lambda number: ss.simulate(system(), LAW.sample(jax.random.key(number), t1=200.0), t1=200.0).stick_time


def _simulation(build: Callable[[], tuple[Any, Any, float]], **more: Any) -> Callable[[Sizes], Call]:
    def call(number: int) -> Any:
        moved, base, t1 = build()
        return ss.simulate(moved, base, t1=t1, **more).stick_time

    return lambda sizes: call


def _blocks() -> Any:
    return ss.block_row(3, mass=1.0, between=4.0, to_ground=4.0, normal_force=1.0, friction=ss.Coulomb(0.5))


def _bristles() -> Any:
    law = ss.LuGre(mu=0.5, mu_static=0.6, stribeck_speed=0.1, stiffness=100.0, damping=1.0)
    return ss.MassSpring(1.0, 4.0, 1.0, law)


def _cart() -> tuple[Any, Any, float]:
    found = ss.papers.motor_cart(0.5)
    return found.system, ss.SourceVoltage(mean=20.0), 1.0


def _ten_calls(sizes: Sizes) -> Call:
    """What one does in a notebook: two simulations, looked at."""

    def call(number: int) -> Any:
        base = ss.Harmonic(amplitude=1.0, angular_frequency=1.0)
        one = ss.simulate(system(), base, t1=20.0, y0=START)
        found = [str(one), one.evaluate(np.linspace(0, 20, 1000)), one.evaluate(np.linspace(0, 20, 700)), one.peak()]
        longer = ss.simulate(system(), base, t1=21.0, y0=START)
        for draw, which in ((ss.plot.time_history, one), (ss.plot.phase_portrait, one), (ss.plot.time_history, longer)):
            axes = draw(which)
            plt.close("all")
            found.append(axes is not None)
        return found[1]

    return call


def _sobol_indices(sizes: Sizes) -> Call:
    def call(number: int) -> Any:
        design = ss.design.saltelli(64, ["mu", "stiffness"])
        moved = ss.MassSpring(1.0, ss.Uniform(3.0, 5.0), 1.0, ss.Coulomb(ss.Uniform(0.4, 0.6)))
        many = ss.simulate_ensemble(
            moved, ss.Harmonic(1.0, 1.0), t1=20.0, samples=design, key=jax.random.key(number), progress=False,
            outputs={"peak": lambda one: one.peak()},
        )  # fmt: skip
        return ss.sobol_indices(many.output_values, design).first

    return call


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


YARDSTICK = "diffrax: three states, one event, 100 saved times"
CASES: dict[str, Callable[[Sizes], Call]] = {
    YARDSTICK: _yardstick,
    "one simulation, Poisson switching": _default_simulation,
    "one simulation, Stribeck friction": _simulation(lambda: (STRIBECK, BELT, 20.0)),
    "one simulation, motor and cart": _simulation(_cart),
    "one simulation, three blocks": _simulation(lambda: (_blocks(), BELT, 20.0)),
    "one simulation, LuGre": _simulation(lambda: (_bristles(), BELT, 20.0), method=ss.Regularized()),
    "ten calls: simulate, look, simulate again": _ten_calls,
    "Sobol' indices": _sobol_indices,
    "ensemble, Stribeck friction": lambda sizes: _ensemble(STRIBECK, LAW, 20.0, START),
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
