"""Scalar yardstick for a chain of blocks on a belt, neighbours only, compiled by numba.

The chain of `scipy_chain`. All blocks advance together by the power series of their motion, in steps of a 16th of the
shortest period; what ends a mode is looked for as sign changes and as minima below zero of cubics through the ends of
the step, and then found by Newton's method on the block's own series. The step ends at the earliest of these.

- `given(x, *, t1, threads=1) -> Sticks`: blocks that begin at these positions (blocks, samples) without velocity.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

from .numba_two_blocks import FLAGS, Sticks, _narrowed, _suspect
from .scipy_chain import BELT, BETWEEN, FORCE, TO_GROUND

TERMS = 16
STEP = 2 * math.pi / math.sqrt(TO_GROUND + 4 * BETWEEN) / 16
ROUNDS, FINE = 60, 1e-14


@njit(**FLAGS)
def _pull(x, i, blocks):
    """What the springs do to block `i` at the positions `x`."""
    force = TO_GROUND * x[i]
    if i > 0:
        force += BETWEEN * (x[i] - x[i - 1])
    if i < blocks - 1:
        force += BETWEEN * (x[i] - x[i + 1])
    return force


@njit(**FLAGS)
def _series(x, v, signs, h, xs, vs):
    """The terms of the power series of all positions and velocities after `h`, (TERMS, blocks)."""
    blocks = x.size
    xs[0], vs[0] = x, v
    for k in range(TERMS - 1):
        share, own = h / (k + 1), 1.0 if k == 0 else 0.0
        for i in range(blocks):
            xs[k + 1, i] = share * vs[k, i]
            rate = -_pull(xs[k], i, blocks) - own * signs[i] * FORCE
            vs[k + 1, i] = share * rate if signs[i] != 0.0 else 0.0


@njit(**FLAGS)
def _at(terms, i, share):
    """The value of block `i` at this share of the step, and its slope."""
    value = slope = 0.0
    for k in range(TERMS - 1, -1, -1):
        slope = slope * share + value
        value = value * share + terms[k, i]
    return value, slope


@njit(**FLAGS)
def _root(terms, i, offset, factor, at):
    """Where ``offset + factor * terms`` of block `i` falls through zero, before the share `at` of the step."""
    low, high, tau = 0.0, at, at
    for _ in range(ROUNDS):
        value, slope = _at(terms, i, tau)
        low, high, trial = _narrowed(low, high, tau, offset + factor * value, factor * slope)
        if abs(trial - tau) <= FINE:
            return trial
        tau = trial
    return tau


@njit(**FLAGS)
def _trajectory(x, t1, count, time):
    blocks = x.size
    v, signs, begun = np.zeros(blocks), np.full(blocks, -1.0), np.zeros(blocks, np.bool_)  # slower than the belt
    xs, vs, needs = np.zeros((TERMS, blocks)), np.zeros((TERMS, blocks)), np.zeros((TERMS, blocks))
    now = 0.0
    while now < t1:
        h = min(STEP, t1 - now)
        _series(x, v, signs, h, xs, vs)
        first, which = math.inf, -1
        for i in range(blocks):
            # Of a slip the velocity towards the belt's; of a stick what is left of friction, on either side.
            of, sides = vs, 1
            if signs[i] == 0.0:
                of, sides = needs, 2
                for k in range(TERMS):
                    needs[k, i] = _pull(xs[k], i, blocks)
            (start, fall), (end, rise) = _at(of, i, 0.0), _at(of, i, 1.0)
            for side in range(sides):
                offset, factor = -signs[i] * BELT, signs[i]
                if signs[i] == 0.0:
                    offset, factor = FORCE, 2.0 * side - 1.0
                g, ng = offset + factor * start, offset + factor * end
                if begun[i] and g <= 1e-13 and ng > 0.0:
                    continue
                at = _suspect(1.0, g, factor * fall, ng, factor * rise)
                if at < math.inf:
                    at = _root(of, i, offset, factor, at)
                    if at < first:
                        first, which = at, i
        share = min(first, 1.0)
        for i in range(blocks):
            x[i], v[i] = _at(xs, i, share)[0], _at(vs, i, share)[0]
            time[i] += share * h if signs[i] == 0.0 else 0.0
            begun[i] = False
        now = t1 if which < 0 and h < STEP else now + share * h
        if which >= 0:
            need = _pull(x, which, blocks)
            holds = signs[which] != 0.0 and abs(need) <= FORCE
            count[which] += holds
            signs[which] = 0.0 if holds else (-1.0 if need > 0.0 else 1.0)
            v[which], begun[which] = BELT, True


@njit(**FLAGS)
def _ensemble(x, t1, count, time):
    for sample in range(x.shape[0]):
        _trajectory(x[sample].copy(), t1, count[sample], time[sample])


def given(x: np.ndarray, *, t1: float, threads: int = 1) -> Sticks:
    """The sticks of blocks that begin at these positions (m) without velocity."""
    starts = np.ascontiguousarray(x.T)
    count, time = np.zeros(starts.shape, np.int64), np.zeros(starts.shape)
    bounds = np.linspace(0, len(starts), threads + 1).astype(int)

    def run(begin, end):
        _ensemble(starts[begin:end], float(t1), count[begin:end], time[begin:end])

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, bounds[:-1], bounds[1:]))
    return Sticks(count, time)
