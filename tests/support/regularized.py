"""What the tests of regularised dynamics share: set-ups for the package and for scipy, and the compiled program."""

import math
from functools import cache
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import stickslip_jax as ss

from .interval import padded

SLOTS, STEPS, POINTS = 80, 2048, 41
PHI = {
    "tanh": np.tanh,
    "linear": lambda s: np.clip(s, -1, 1),
    "arctan": lambda s: 2 / np.pi * np.arctan(s),
    "rational": lambda s: s / np.sqrt(1 + s * s),
}
LAWS = {
    "coulomb": (ss.Coulomb(0.6), lambda r: 0.6 + 0 * r, None),
    "static": (ss.Coulomb(0.5, 0.7), lambda r: 0.5 + 0 * r, 0.7),
    "weakening": (ss.VelocityWeakening(0.6, 0.8), lambda r: 0.6 / (1 + 0.8 * r), None),
    "stribeck": (ss.Stribeck(0.5, 0.7, 0.4, 2.0, 0.05), lambda r: 0.5 + 0.2 * np.exp(-6.25 * r**2) + 0.05 * r, None),
}
TSIT = diffrax.Tsit5()
SOLVERS = {"tanh": None, "linear": None, "arctan": TSIT, "rational": None}


def coefficient(shape, law, r, width):
    """The friction coefficient as documented: ``kinetic phi``, or a rise to the static one at one width and a fall."""
    _, kinetic, static = LAWS[law]
    if static is None:
        return kinetic(np.abs(r)) * PHI[shape](r / width)
    s, beyond = np.clip(r / width, -1, 1), np.maximum(np.abs(r / width) - 1, 0)
    held = static * (s if shape == "linear" else s * (3 - s * s) / 2)
    left = np.exp(-beyond) if shape == "linear" else np.exp(-(beyond**2))
    return np.where(np.abs(r) < width, held, left * held + (1 - left) * kinetic(np.abs(r)) * np.sign(r))


class Case(NamedTuple):
    """One lane: `pace` is the step, or the relative tolerance of adaptive steps."""

    system: Any
    base: ss.VelocitySteps
    y0: tuple
    t1: float
    width: float
    pace: float


def case(
    law="coulomb", k=3.0, damping=0.2, push=1.0, mu=None, durations=(2.1, 1.7, 9.0), speeds=(0.5, -0.3, 0.4),
    y0=(1.0, 0.5), t1=5.0, width=0.1, pace=1e-8, m=1.2, n=1.5,
):  # fmt: skip
    friction = LAWS[law][0] if mu is None else ss.Coulomb(mu)
    system = ss.MassSpring(m, k, n, friction, jnp.asarray(damping), ss.Harmonic(push, 0.7, 0.2))
    return Case(system, padded(durations, speeds, SLOTS), y0, t1, width, pace)


def follow(item, shape="tanh", fixed=False, **options):
    pace = {"step": item.pace} if fixed else {"rtol": item.pace}
    method = ss.Regularized(item.width, shape, max_steps=STEPS, **pace, **options)
    return ss.simulate(item.system, item.base, t1=item.t1, y0=item.y0, method=method)


@cache
def program(shape, fixed):  # no defaults: the cache would keep two programs for what is one
    """`follow`, compiled once for each structure of what comes in."""
    compiled = jax.jit(lambda item: follow(item, shape, fixed, **({} if fixed else {"solver": SOLVERS[shape]})))
    return lambda item: compiled(as_floats(item))


def as_floats(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def sticks(one, number=...):
    mask = np.asarray(one.sticks.mask)[number]
    return [np.asarray(getattr(one.sticks, name))[number][mask] for name in ("start", "end", "position", "ending")]


def by_scipy(item, field, times, speed=None, threshold=None):
    """States at `times` and the end by LSODA from jump to jump; when ``|speed(y, v)|`` passes the threshold."""
    edges = np.cumsum([0.0, *item.base.durations])
    y, states, passages = np.array(item.y0, float), np.zeros((len(item.y0), len(times))), []
    for begin, end, v in zip(edges[:-1], edges[1:], np.asarray(item.base.velocities), strict=True):
        if begin < min(end, item.t1):
            events = None if speed is None else [lambda t, y, v: abs(speed(y, v)) - threshold]
            options = {"args": (v,), "events": events, "rtol": 1e-11, "atol": 1e-12, "dense_output": True}
            arc = solve_ivp(field, (begin, min(end, float(item.t1))), y, "LSODA", **options)
            y, inside = arc.y[:, -1], (times >= begin) & (times <= end)
            states[:, inside] = arc.sol(times[inside]) if np.any(inside) else 0
            passages += [] if speed is None else list(arc.t_events[0])
    return states, y, np.array(passages)


def field_of(item, shape, law, mu=None):
    s, damping, scale = item.system, float(item.system.damping), 1 if mu is None else mu / 0.6

    def field(t, y, v):
        load = math.cos(0.7 * t + 0.2) * s.force.amplitude - damping * y[1] - s.stiffness * y[0]
        return [y[1], (load - s.normal_force * coefficient(shape, law, y[1] - v, item.width) * scale) / s.mass]

    return field
