"""The mean stick duration of vmapped samples and its derivative by the friction coefficient, through every engine."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

import stickslip_jax as ss

from .setups import LAW, RANDOM_PHASE, START, record, system
from .sizes import Sizes

MODES = "value", "reverse", "forward"
_Simulate = Callable[[Any, Any], ss.Simulation]


class HardeningSpring(ss.SwitchedSystem):
    """A system as users write them: the oscillator of the study with a little damping and a spring that hardens."""

    friction_force: Any

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        x, v = y
        return v, -4.0 * x - 0.5 * x**3 - 0.1 * v - friction * self.friction_force

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return math.pi


def _harmonic(moved: Callable[[Any], Any], sizes: Sizes) -> _Simulate:
    return lambda mu, key: ss.simulate(
        moved(mu), RANDOM_PHASE.sample(key, sizes.stepped_t1), t1=sizes.stepped_t1, y0=START
    )


def _recorded(sizes: Sizes) -> _Simulate:
    base = record(sizes.stepped_t1)

    def simulate(mu: Any, key: Any) -> ss.Simulation:
        x, v = jax.random.uniform(key, (2,), minval=-1.0)
        return ss.simulate(system(mu), base, t1=sizes.stepped_t1, y0=(x, v))

    return simulate


def _cart(sizes: Sizes) -> _Simulate:
    law = ss.RandomPhase(ss.SourceVoltage())  # as in ss.papers.motor_cart

    def simulate(mu: Any, key: Any) -> ss.Simulation:
        phase, angle = jax.random.split(key)
        y0 = (jax.random.uniform(angle, maxval=2 * math.pi), 0.0, 0.0)
        return ss.simulate(ss.MotorCart(mu=mu), law.sample(phase), t1=sizes.cart_t1, y0=y0)

    return simulate


def _poisson(sizes: Sizes, method: Any) -> _Simulate:
    t1 = sizes.switched_t1
    return lambda mu, key: ss.simulate(system(mu), LAW.sample(key, t1=t1), t1=t1, y0=START, method=method)


EVERY_STICK = ", every stick"
ENGINES: dict[str, Callable[[Sizes], _Simulate]] = {
    "closed form: Poisson switching": lambda sizes: _poisson(sizes, ss.Exact()),
    "time steps: harmonic base": lambda sizes: _harmonic(system, sizes),
    "time steps: recorded base": _recorded,
    "time steps: motor and cart": _cart,
    "time steps: a user's system": lambda sizes: _harmonic(HardeningSpring, sizes),
    "regularised, step 0.03: Poisson switching": lambda sizes: _poisson(sizes, ss.Regularized(1e-3, step=0.03)),
    "regularised, step 0.01: Poisson switching": lambda sizes: _poisson(sizes, ss.Regularized(1e-3, step=0.01)),
    f"regularised, step 0.03: Poisson switching{EVERY_STICK}": lambda sizes: _poisson(
        sizes, ss.Regularized(1e-3, step=0.03)
    ),
}


SLOW = tuple(engine for engine in ENGINES if engine.startswith("regularised"))
FRICTION = {"time steps: motor and cart": 0.2}
"""The friction coefficient where it is not 1."""


def _of_totals(simulate: _Simulate, mu: Any, keys: Any) -> Any:
    """The mean stick duration by the sums that each simulation ends with."""
    totals = jax.vmap(lambda key: simulate(mu, key).totals)(keys)
    return totals.stick_time.sum() / totals.sticks.sum()


def _of_sticks(simulate: _Simulate, mu: Any, keys: Any) -> Any:
    """The same by every stick: each simulation has a slot for every stick that there can be."""
    sticks = jax.vmap(lambda key: simulate(mu, key).sticks)(keys)
    return jnp.where(sticks.mask, sticks.duration, 0.0).sum() / sticks.mask.sum()


def program(engine: str, mode: str, sizes: Sizes) -> Callable[[int], Any]:
    """A function of the round's number, compiled when first called: the value, or it and its derivative by mu.

    `mode`: "value", "reverse" (``value_and_grad``) or "forward" (``jvp``).
    """
    simulate, of = ENGINES[engine](sizes), _of_sticks if engine.endswith(EVERY_STICK) else _of_totals

    def value(mu, keys):
        return of(simulate, mu, keys)

    modes = {
        "value": value,
        "reverse": jax.value_and_grad(value),
        "forward": lambda mu, keys: jax.jvp(lambda mu: value(mu, keys), (mu,), (jnp.ones_like(mu),)),
    }
    compiled, mu = jax.jit(modes[mode]), jnp.asarray(FRICTION.get(engine, 1.0))
    return lambda number: compiled(mu, jax.random.split(jax.random.key(number), sizes.vmapped))
