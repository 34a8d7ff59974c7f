"""Numbers at and near the bounds that they may have: they are found there, and what the record allows holds the truth."""

import warnings

import numpy as np
import pytest
from scipy import optimize, stats

import stickslip_jax as ss

SETS = 200
TIMES = np.linspace(0, 20, 401)
SMOOTH, JUMPS = ss.Harmonic(0.5, 0.9, 0.3), ss.SquareWave(0.5, 5.0)
START = (0.3, 0.1)


def plain(mu):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu), damping=0.05)


def damped(damping):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3), damping=damping)


def holding(excess, mu=0.7):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu, mu + excess))


def bristles(stiffness):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Dahl(0.5, stiffness))


# What depends on it, the base, a first guess, what is searched, what the bounds are of, the noise (m), options.
CASES = {
    "mu": (plain, SMOOTH, plain(0.1), "mu", "mu", 0.002, {}),
    "damping": (damped, JUMPS, damped(0.05), ("mu", "damping"), "damping", 0.003, {}),
    "static above kinetic": (holding, JUMPS, holding(0.2, 0.6), ("mu", "mu_static"), "mu_static - mu", 0.003, {}),
    "series stiffness": (bristles, SMOOTH, bristles(60.0), "stiffness", "stiffness", 0.003, {
        "method": ss.Regularized(), "y0": START}),
}  # fmt: skip


def records(case, truth, sets):
    """Positions with noise, (sets, times)."""
    model, base, _, _, _, noise, options = CASES[case]
    one = ss.simulate(model(truth), base, t1=20.0, y0=START, method=options.get("method", ss.Exact()))
    rng = np.random.default_rng(5)
    return np.asarray(one.evaluate(TIMES)[0]) + noise * rng.normal(size=(sets, len(TIMES)))


def fit(case, seen, guess=None):
    _, base, start, wrt, _, _, options = CASES[case]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return ss.calibrate(guess or start, base, TIMES, {"position": seen}, wrt=wrt, **options)


def limits(case, found):
    """The smallest and largest value, each with 95 % confidence."""
    name = CASES[case][4]
    if name in found.bounds:
        low, high = found.bounds[name]
        return -np.inf if low is None else low, np.inf if high is None else high
    one = found["mu_static"] - found["mu"] if name == "mu_static - mu" else found[name]
    return one.interval(0.9)


def misses(case, truth, sets):
    """How often the truth is below and above what the record allows."""
    ends = np.array([limits(case, fit(case, seen)) for seen in records(case, truth, sets)])
    return np.count_nonzero(truth < ends[:, 0]), np.count_nonzero(truth > ends[:, 1])
