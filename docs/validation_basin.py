"""Basins of attraction of a belt oscillator, against published ones: ``python docs/validation_basin.py`` (two minutes).

Which starts come to rest on a steadily running belt, and which end in stick-slip, is a case of bSTAB and of pyBasin,
each with labelled starts. What this prints, and what it means, is in ``validation.md``;
``tests/validation/test_basin.py`` tests by the functions of this file.

With files of labelled starts of your own (CSV with the columns x1, x2, label), each after the speed of its belt, these
are compared instead: ``python docs/validation_basin.py 1.5 main_friction.csv 1.175 param_006.csv``.
"""

import csv
import hashlib
import sys
from functools import partial
from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)

BELT_SPEED, HORIZON, OBSERVED = 1.5, 500.0, 100.0  # m/s; s; the last part of the horizon, by which starts are labelled
BELT_SPEEDS = np.linspace(0.8, 2.225, 20)
REST_SPEED = 0.2  # m/s: pyBasin and bSTAB say "fixed point" where the mass is never faster in the observed part
LOWEST, SIZE = np.float32([-2, 0]), np.float32([4, 2])  # of the box of starts: m, m/s

# pyBasin (github.com/adrianwix/pyBasin) at commit 925877c9886642f818244ff52a558986b707cb27, in
# tests/integration/friction: main_friction_case1.json and main_friction_v_study.json (shares of starts at rest),
# ground_truths/main and ground_truths/vStudy (labelled starts).
# The labels are kept as digests of one bit a start, 1 at rest: a run that differs in one start has another digest.
PUBLISHED_SHARE = 0.3165
PUBLISHED_LABELS = "49981a31a6688ed79efdff864c7d40f1a4d2c2400d63498ed643d52a1a062f28"
PUBLISHED_SHARES = (0, 0, 0, 0, 0, 0.018, 0.08, 0.1535, 0.226, 0.298, 0.382, 0.45, 0.5085, 0.568, 1, 1, 1, 1, 1, 1)
PUBLISHED_SWEEP_LABELS = "5b5054bcfd0461abaa8fc8934435a5f457fbb902e5949e36172cfd4b228a025c"
# Starts labelled otherwise than here, by belt speed: those of the 4,000, and of 2,000 at each speed of the sweep.
OTHERS = (3117,)
OTHERS_IN_SWEEP = {5: (70, 81, 183, 430, 824, 930, 1122)}


def oscillator() -> ss.MassSpring:
    """The system of the case: all its numbers without dimension, which is the same as in SI units."""
    friction = ss.Stribeck(mu=0.5, mu_static=1.0, stribeck_speed=0.5)
    return ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=friction, damping=0.1)


def starts(number: int) -> np.ndarray:
    """The first of pyBasin's starts, (number, 2): position and velocity, uniform in the box.

    pyBasin draws them by ``torch.rand`` on a CPU after ``manual_seed(42)``: the lowest 24 bits of each word of MT19937.
    """
    words = np.random.RandomState(42).randint(0, 1 << 32, (number, 2), np.uint32)
    uniform = (words & np.uint32((1 << 24) - 1)).astype(np.float32) * np.float32(2.0**-24)
    return (uniform * SIZE + LOWEST).astype(float)


def come_to_rest(
    speeds: np.ndarray, y0: np.ndarray, method: ss.Exact | ss.Regularized | None = None, t1: float = HORIZON
) -> np.ndarray:
    """Which starts `y0`, (starts, 2), on belts of `speeds`, (starts,), have no stick in the last `OBSERVED` seconds."""
    many = ss.simulate_ensemble(
        oscillator(),
        ss.Constant(speeds),
        t1=t1,
        samples=len(y0),
        y0=y0,
        keep="sticks",
        method=ss.Exact() if method is None else method,
        progress=False,
    )
    if many.finished != len(y0):
        raise RuntimeError(f"Only {many.finished} of {len(y0)} starts were followed to the end.")
    sticks = many.require_sticks()
    late = sticks.end > t1 - OBSERVED
    return np.bincount(sticks.sample[late], minlength=len(y0)) == 0


@partial(jax.jit, static_argnames="instants")
def largest_late_speeds(speeds: jax.Array, y0: jax.Array, instants: int) -> jax.Array:
    """Largest speeds (m/s) of the mass at so many instants of the last `OBSERVED` seconds, (starts,).

    By it pyBasin (500 instants) and bSTAB (10,001) label their starts.
    """
    times, method = jnp.linspace(HORIZON - OBSERVED, HORIZON, instants), ss.Exact(max_steps=8192)

    def one(speed, y0):
        motion = ss.simulate(oscillator(), ss.Constant(speed), t1=HORIZON, y0=(y0[0], y0[1]), method=method)
        return jnp.max(jnp.abs(motion.evaluate(times)[1]))

    return jax.vmap(one)(speeds, y0)


class Boundary(NamedTuple):
    """The unstable slip cycle on one belt, from where its speed is zero on to where it is zero again, above zero."""

    position: np.ndarray
    velocity: np.ndarray

    def inside(self, y0: np.ndarray) -> np.ndarray:
        """Which starts (starts, 2) of the box lie inside."""
        x, v = y0.T
        return v < np.interp(x, self.position, self.velocity, left=-1, right=-1)

    def distance(self, y0: np.ndarray) -> np.ndarray:
        """How far the starts (starts, 2) are from it, in the plane of position and velocity."""
        return np.array([np.hypot(self.position - x, self.velocity - v).min() for x, v in y0])

    @property
    def share(self) -> float:
        """The part of the box that lies inside."""
        low, high = LOWEST[0], LOWEST[0] + SIZE[0]
        area = np.trapezoid(self.velocity, np.clip(self.position, low, high))
        return float(area / np.prod(SIZE, dtype=float))


def boundary(speed: float) -> Boundary | None:
    """What divides the starts on a belt of this speed (m/s), by scipy; None where no slip cycle does.

    The cycle lies below the belt, where slips are smooth and no two motions meet: starts inside spiral into the
    equilibrium, and starts outside can never come in.
    """

    def slip(_, y):
        return y[1], 0.5 + 0.5 * np.exp((y[1] - speed) / 0.5) - y[0] - 0.1 * y[1]

    def arc(x, ends, **options):
        events = [lambda _, y: y[1], lambda _, y: y[1] - speed]
        events[0].direction, events[0].terminal, events[1].terminal = ends, True, True
        return solve_ivp(slip, (0, 20), (x, 0.0), "DOP853", rtol=1e-12, atol=1e-13, events=events, **options)

    def gain(x):
        back = arc(arc(x, 1).y[0, -1], -1)
        return 1.0 if len(back.t_events[1]) else back.y[0, -1] - x

    equilibrium = 0.5 + 0.5 * np.exp(-speed / 0.5)
    nearest, farthest = equilibrium + 1e-3, equilibrium + 2 * speed
    if gain(nearest) > 0 or gain(farthest) < 0:
        return None
    right = brentq(gain, nearest, farthest, xtol=1e-13)
    if abs(gain(right)) > 1e-9:  # no cycle, but the motion that just touches the belt
        return None
    above = arc(arc(right, 1).y[0, -1], -1, dense_output=True)
    return Boundary(*above.sol(np.linspace(0, above.t[-1], 20_001)))


def digest(at_rest: np.ndarray) -> str:
    """What is published of labels, one bit a start."""
    return hashlib.sha256(np.packbits(at_rest).tobytes()).hexdigest()


def with_others(at_rest: np.ndarray, others: tuple[int, ...]) -> np.ndarray:
    """The labels, where those of `others` are exchanged."""
    exchanged = at_rest.copy()
    exchanged[list(others)] ^= True
    return exchanged


def smoothed(atol: float) -> ss.Regularized:
    """Friction, solver and tolerances as in pyBasin, where `atol` is 1e-6: tanh(200 v_rel) in place of the sign."""
    solver = diffrax.Dopri5()
    return ss.Regularized(width=1 / 200, shape="tanh", solver=solver, rtol=1e-8, atol=atol, max_steps=1 << 14)


def print_case(at_rest: np.ndarray, y0: np.ndarray) -> None:
    """The 4,000 labelled starts on one belt."""
    edge, speeds, other = boundary(BELT_SPEED), np.full(len(y0), BELT_SPEED), list(OTHERS)
    inside = edge.inside(y0)
    as_published = come_to_rest(speeds, y0, smoothed(1e-6))
    finer = come_to_rest(speeds[other], y0[other], smoothed(1e-8))
    known = digest(with_others(at_rest, OTHERS)) == PUBLISHED_LABELS
    print(f"{len(y0)} starts on a belt of {BELT_SPEED} m/s")
    print("                                           at rest   labelled as published")
    print(f"  published                                {PUBLISHED_SHARE:.5f}")
    print(f"  exact                                    {at_rest.mean():.5f}   {_agreement(known, len(y0), OTHERS)}")
    print(f"  inside the unstable cycle                {inside.mean():.5f}   as exact: {np.sum(inside == at_rest)}")
    known = digest(as_published) == PUBLISHED_LABELS
    print(f"  smoothed, with pyBasin's tolerances      {as_published.mean():.5f}   {_agreement(known, len(y0), ())}")
    print(f"  part of the box inside the cycle         {edge.share:.5f}")
    for i, there, rests in zip(other, edge.inside(y0[other]), finer, strict=True):
        side, result = "inside" if there else "outside", "at rest" if rests else "stick-slip"
        print(f"  start {i} lies {edge.distance(y0[[i]])[0]:.1e} {side}; smoothed, a hundredth of atol: {result}")


def print_sweep(at_rest: np.ndarray, y0: np.ndarray) -> None:
    """The 2,000 labelled starts at each of 20 belt speeds, `at_rest` (speeds, starts)."""
    exchanged = [with_others(row, OTHERS_IN_SWEEP.get(i, ())) for i, row in enumerate(at_rest)]
    known = digest(np.concatenate(exchanged)) == PUBLISHED_SWEEP_LABELS
    print(f"{len(y0)} starts at each of {len(BELT_SPEEDS)} belt speeds")
    print("  speed   published    exact   of the box   labelled as published")
    for i, (speed, share, row) in enumerate(zip(BELT_SPEEDS, PUBLISHED_SHARES, at_rest, strict=True)):
        edge = boundary(speed)
        exact = f"{edge.share:.4f}" if edge else "no cycle"
        agreement = _agreement(known, len(y0), OTHERS_IN_SWEEP.get(i, ()))
        print(f"  {speed:.3f}      {share:.4f}   {row.mean():.4f}     {exact:>8}   {agreement}")
    for i, places in OTHERS_IN_SWEEP.items():
        peaks = largest_late_speeds(jnp.full(len(places), BELT_SPEEDS[i]), jnp.asarray(y0[list(places)]), 500)
        print(f"  largest late speeds of the others: {', '.join(f'{peak:.3f}' for peak in peaks)}")


def _agreement(known: bool, number: int, others: tuple[int, ...]) -> str:
    """How many labels agree, if the digest says that these `others` are exactly those that do not."""
    if not known:
        return "other than was found before"
    return f"{number - len(others)}" + (f", not {', '.join(map(str, others))}" if others else "")


def print_files(arguments: list[str]) -> None:
    """The agreement with files of labelled starts, each after the speed of its belt."""
    for speed, path in zip(map(float, arguments[::2]), arguments[1::2], strict=True):
        with open(path, encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        y0 = np.array([(float(row["x1"]), float(row["x2"])) for row in rows])
        published = np.array([row["label"] == "FP" for row in rows])
        speeds = np.full(len(y0), speed)
        at_rest = come_to_rest(speeds, y0)
        other = np.flatnonzero(at_rest != published)
        peaks = largest_late_speeds(jnp.asarray(speeds[other]), jnp.asarray(y0[other]), 10_001) if len(other) else []
        by_speed = sum((peak <= REST_SPEED) == published[i] for i, peak in zip(other, peaks, strict=True))
        print(
            f"{path} at {speed} m/s: at rest {published.mean():.4f}, here {at_rest.mean():.4f}; labelled as here "
            f"{len(y0) - len(other)} of {len(y0)}, with the others by their largest late speed "
            f"{len(y0) - len(other) + by_speed}"
        )


def main() -> None:
    """Print all of this. One ensemble holds all starts on all belts."""
    y0, swept = starts(4000), starts(2000)
    speeds = np.concatenate([np.full(len(y0), BELT_SPEED), np.repeat(BELT_SPEEDS, len(swept))])
    at_rest = come_to_rest(speeds, np.concatenate([y0, np.tile(swept, (len(BELT_SPEEDS), 1))]))
    print_case(at_rest[: len(y0)], y0)
    print_sweep(at_rest[len(y0) :].reshape(len(BELT_SPEEDS), -1), swept)


if __name__ == "__main__":
    print_files(sys.argv[1:]) if len(sys.argv) > 1 else main()
