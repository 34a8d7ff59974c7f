"""Records whose vertices bring the force that a stick needs exactly to the limit: held there, and counted."""

from fractions import Fraction

import jax
import numpy as np
import pytest

import stickslip_jax as ss

SAMPLES, VERTICES = 300, 9
TIMES = np.arange(VERTICES) * 1.0


def lattice(seed):
    """Start, friction coefficient, and forces at the vertices, in eighths: sums and differences are exact."""
    source = np.random.default_rng(seed)
    starts, mu = source.integers(-4, 5, SAMPLES) / 8, source.integers(1, 9, SAMPLES) / 8
    forces = source.integers(-8, 9, (SAMPLES, VERTICES)) / 8
    forces[::3, 1::2] = forces[::3, :-1:2]  # flat pieces
    return starts, mu, forces


def first_release(start, mu, forces) -> tuple[float, bool] | None:
    """When the mass, at rest from the beginning, is released, and whether the force touches the limit before.

    Its force changes linearly between vertices; at the limit it holds. None if it does not stick at first.
    """
    needed, limit = [Fraction(start) - Fraction(force) for force in forces], Fraction(mu)
    if abs(needed[0]) > limit:
        return None
    touched = abs(needed[0]) == limit
    for number in range(VERTICES - 1):
        now, then = needed[number], needed[number + 1]
        if abs(then) > limit:
            reached = limit if then > 0 else -limit
            return float(number + (reached - now) / (then - now)), touched
        touched |= abs(then) == limit and number < VERTICES - 2
    return TIMES[-1], touched


@jax.jit
@jax.vmap
def followed(start, mu, forces):
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu), force=ss.Recorded(TIMES, forces))
    one = ss.simulate(
        system, ss.Constant(0.0), t1=TIMES[-1], y0=(start, 0.0), method=ss.Exact(step=0.25, max_steps=512)
    )
    return one.status, one.sticks.start[0], one.sticks.end[0], one.near_grazing_count


@pytest.mark.slow
def test_sticks_hold_at_the_limit_itself():
    numbers = lattice(0)
    status, start, end, near = (np.asarray(values) for values in followed(*numbers))
    assert np.all(status == ss.Status.FINISHED)
    touched = 0
    for lane, of_lane in enumerate(zip(*numbers, strict=True)):
        expected = first_release(*of_lane)
        if expected is None:
            continue
        release, touches = expected
        if release > 0:
            assert start[lane] == 0, of_lane
            assert abs(end[lane] - release) < 1e-13 * TIMES[-1], of_lane
        if touches:
            touched += 1
            assert near[lane] > 0, of_lane
    assert touched > 30  # the search must not be empty
