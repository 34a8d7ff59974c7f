"""Made-up sticks for the tests of independence: samples of known laws and known dependence."""

import math

import numpy as np

from stickslip_jax import Ending
from stickslip_jax._dynamics.sticks import FlatSticks


def flat(count, durations, slips=None, horizon=math.inf):
    """Sticks of given durations after slips of given durations (1 s), cut at the horizon."""
    count = np.asarray(count)
    sample = np.repeat(np.arange(len(count)), count)
    time = np.cumsum((np.ones(len(durations)) if slips is None else slips) + durations)
    before = np.append(0.0, time)[np.cumsum(count) - count]
    end = time - before[sample]
    start = end - durations
    begun = start < horizon
    ending = np.where(end > horizon, Ending.HORIZON, Ending.RELEASED)[begun]
    count = np.bincount(sample[begun], minlength=len(count))
    return FlatSticks.of(count, start[begun], np.minimum(end, horizon)[begun], ending)


def rows(durations):
    """Durations (samples, sticks), the same number in each sample."""
    samples, sticks = durations.shape
    return flat(np.full(samples, sticks), durations.ravel())


def autoregressive(rng, samples, sticks, correlation):
    """Normal values with the autocorrelation ``correlation ** lag``; `correlation` may differ from sample to sample."""
    noise = rng.normal(size=(samples, sticks))
    values = noise.copy()
    for order in range(1, sticks):
        values[:, order] = correlation * values[:, order - 1] + np.sqrt(1 - correlation**2) * noise[:, order]
    return values


def spearman_of(correlation):
    """Spearman's correlation of normal variables, and by its invariance of any increasing functions of them."""
    return 6 / math.pi * math.asin(correlation / 2)


# Designs: each takes a random generator and returns sticks.


def iid(rng):
    count = rng.integers(0, 30, 300)
    return flat(count, rng.gamma(2, 1, count.sum()))


def cut(rng):
    """A renewal process on [0, 30] s: ten sticks of 2 s on average, then the end."""
    count = np.full(300, 60)
    return flat(count, rng.gamma(2, 1, count.sum()), rng.exponential(1, count.sum()), horizon=30.0)


def drift(rng):
    """Independent, but each order has its own law; fewer samples, so that bins must be joined."""
    order = np.arange(12)
    return rows(rng.gamma(2, 1, (80, 12)) * (1 + order) + 5 * order)


def shared(rng):
    """Identically distributed, but all sticks of a sample share a random factor."""
    return rows(np.exp(rng.normal(size=(300, 1)) + rng.normal(size=(300, 8))))
