"""Soft springs and no spring at all keep all digits, in both exact engines, with their derivatives."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf
from reference.soft_spring import DIGITS, simulate_soft

import stickslip_jax as ss

STIFFNESSES = (0.0, 1e-100, 1e-12, 1e-6, 1e-3)
NAMES = ("mu", "stiffness", "x", "v")
INTERVALS, SLOTS = 10, 12
NUDGE = "1e-60"  # of the reference's numbers, for its derivatives
STEPPED = ss.Exact(step=0.7, max_steps=400)
RNG = np.random.default_rng(8)
DURATIONS = np.round(RNG.uniform(0.3, 2.5, INTERVALS) * 2**20) / 2**20
SIGNS = np.array([1.0, -1.0, 0.5, 1.0, -0.5, -1.0, 1.0, 0.5, -1.0, 0.5])


class Case(NamedTuple):
    """Numbers of a block; with damping, the base is so slow that friction can hold the block on it."""

    mass: float
    stiffness: float
    damping: float
    normal_force: float
    mu: float
    speed: float
    x: float
    v: float

    @functools.cache  # noqa: B019
    def reference(self, nudged: str = "") -> tuple[int, list[mpf]]:
        """Number of sticks; what `outcome` gives, or its derivative by the number `nudged`."""
        with mp.workdps(DIGITS):
            numbers = {name: mpf(value) for name, value in self._asdict().items()}
            step = mpf(NUDGE) * (numbers["stiffness"] or 1) if nudged == "stiffness" else mpf(NUDGE)
            if nudged:
                numbers[nudged] += step
            run = simulate_soft(
                numbers["mass"], numbers["stiffness"], numbers["damping"], numbers["mu"] * numbers["normal_force"],
                DURATIONS, [self.speed * sign for sign in SIGNS], numbers["x"], numbers["v"],
            )  # fmt: skip
            columns = [[stick[i] for stick in run.sticks] + [mpf(0)] * (SLOTS - len(run.sticks)) for i in range(3)]
            values = [*columns[0], *columns[1], *columns[2], run.position, run.velocity]
            if nudged:
                values = [(b - a) / step for a, b in zip(self.reference()[1], values, strict=True)]
            return len(run.sticks), values


def cases(damping: float) -> list[Case]:
    speed = 1.0 if damping < 1 else 0.4 / damping
    return [
        Case(0.8, stiffness, damping, 1.3, 0.4, speed, x * speed, v * speed)
        for stiffness in STIFFNESSES
        for x, v in ((0.3, 0.2), (-0.4, 2.5))
    ]


def outcome(numbers, case, damped: bool, method):
    """Starts, ends and positions of sticks, and the final state, flat; the mask of sticks; the near-grazing count."""
    mu, stiffness, x, v = numbers
    damping = case.damping if damped else None
    system = ss.MassSpring(case.mass, stiffness, case.normal_force, ss.Coulomb(mu), damping)
    base = ss.VelocitySteps(jnp.asarray(DURATIONS, x.dtype), case.speed * jnp.asarray(SIGNS, x.dtype))
    one = ss.simulate(system, base, t1=float(DURATIONS.sum()), y0=(x, v), method=method)
    mask = jnp.pad(one.sticks.mask, (0, SLOTS))[:SLOTS]
    sticks = [
        jnp.where(mask, jnp.pad(part, (0, SLOTS))[:SLOTS], 0)
        for part in (one.sticks.start, one.sticks.end, one.sticks.position)
    ]
    return jnp.concatenate([*sticks, jnp.stack(one.final_state)]), (mask, one.near_grazing_count, one.status)


@functools.cache
def compiled(damped: bool, method, mode):
    def both(numbers, case):
        found, aux = outcome(numbers, case, damped, method)
        if mode is None:
            return found, None, aux
        return found, mode(lambda ns: outcome(ns, case, damped, method)[0])(numbers), aux

    return jax.jit(jax.vmap(both))


def found(chosen: list[Case], method, mode, dtype=np.float64):
    table = Case(*(np.array(column, dtype) for column in zip(*chosen, strict=True)))
    numbers = np.stack([getattr(table, name) for name in NAMES], axis=-1)
    return jax.tree.map(np.asarray, compiled(bool(chosen[0].damping), method, mode)(numbers, table))


def check(chosen: list[Case], method, mode, tolerance: float = 1e-11) -> None:
    values, slopes, (mask, grazing, status) = found(chosen, method, mode)
    assert np.all(status == ss.Status.FINISHED)
    assert not np.any(grazing)
    for i, case in enumerate(chosen):
        number, right = case.reference()
        assert np.sum(mask[i]) == number >= 3
        right = np.array(right, float)
        size = np.max(np.abs(right[2 * SLOTS :]))
        scales = np.array([DURATIONS.sum()] * 2 * SLOTS + [size] * (SLOTS + 1) + [case.speed])
        np.testing.assert_array_less(np.abs(values[i] - right) / scales, tolerance)
        for j, name in enumerate(NAMES):
            exact = np.array(case.reference(name)[1], float)
            np.testing.assert_allclose(slopes[i, :, j], exact, rtol=1e-6, atol=1e-7 * np.max(np.abs(exact)))
    if chosen[0].damping < 1:
        assert min(case.reference()[0] for case in chosen) < INTERVALS  # in some there is no stick


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", [pytest.param(ss.Exact(), marks=pytest.mark.slow), STEPPED], ids=["intervals", "steps"]
)
def test_soft_springs_against_many_digits(method):
    """Sticks, final states and their derivatives by friction, stiffness (at zero too) and start."""
    check(cases(0.0), method, jax.jacfwd)


@pytest.mark.slow
@pytest.mark.parametrize("method", [ss.Exact(), STEPPED], ids=["intervals", "steps"])
def test_soft_springs_in_reverse_mode(method):
    check(cases(0.0), method, jax.jacrev)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.1, 1e4])
def test_soft_springs_with_damping(damping):
    check(cases(damping), STEPPED, jax.jacfwd)


@pytest.mark.slow
def test_the_softest_spring_of_all():
    """Traced numbers are not checked; this is beyond what the square of anything can be."""
    values = found([case._replace(stiffness=1e-300) for case in cases(0.0)], ss.Exact(), jax.jacfwd)
    without = found([case._replace(stiffness=0.0) for case in cases(0.0)], ss.Exact(), jax.jacfwd)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-14), values, without)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", [ss.Exact(), pytest.param(STEPPED, marks=pytest.mark.slow)], ids=["intervals", "steps"]
)
def test_single_precision(method):
    chosen = [case for case in cases(0.0) if case.stiffness in (0.0, 1e-12, 1e-3)]
    values, _, (mask, _, status) = found(chosen, method, None, np.float32)
    assert values.dtype == np.float32
    assert np.all(status == ss.Status.FINISHED)
    for i, case in enumerate(chosen):
        number, right = case.reference()
        assert np.sum(mask[i]) == number
        np.testing.assert_allclose(values[i], np.array(right, float), rtol=0, atol=2e-5 * DURATIONS.sum())
