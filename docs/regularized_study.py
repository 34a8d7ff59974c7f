"""How fast regularised dynamics approach the exact ones: ``python docs/regularized_study.py`` (minutes on two cores).

For five systems, four shapes and seven widths, `stickslip_jax.Regularized` is compared with the exact method under the
same base motions and initial states. Written next to this file: ``regularized_convergence.png`` (errors over width) and
``regularized_table.md`` (errors, fitted orders and the orders in theory, with their reason). The tests in
``tests/dynamics/regularized/test_convergence.py`` measure by the functions of this file.

Widths are relative to `Regularized`'s own scale of velocity: what the spring makes of friction, ``mu n / sqrt(k m)``;
of the motor, what friction takes from its speed. The solver's own errors stay below those of the width by `RTOL`: of
smooth shapes a tenth of it moves the errors at the smallest width by one or two per cent. The corners of the linear
shape need finer steps, for the instants of its sticks are read off between two steps.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers, plot
from stickslip_jax._excitation.excitation import excitation_of
from stickslip_jax.plot._style import SERIES

jax.config.update("jax_enable_x64", True)

HERE = Path(__file__).parent
SHAPES = ("linear", "tanh", "rational", "arctan")
WIDTHS = tuple(10.0 ** (-1 - i / 2) for i in range(7))
SHOWN = (2, 4, 6)  # of the widths, in the table
FITTED = slice(3, None)  # of the widths, for the orders
KINDS = {
    "trajectory": "trajectory, over its scale",
    "entry": "begin of a stick in s",
    "exit": "end of a stick in s",
    "fraction": "stick fraction",
}
# The error falls with the width to this power; see `REASONS`.
ORDERS = {
    "linear": {"trajectory": 1.0, "entry": 1.0, "exit": 1.0},
    "tanh": {"trajectory": 0.89, "entry": 0.89, "exit": 1 / 2},
    "rational": {"trajectory": 4 / 5, "entry": 4 / 5, "exit": 2 / 5},
    "arctan": {"trajectory": 2 / 3, "entry": 2 / 3, "exit": 1 / 3},
}
RTOL, MAX_STEPS = {"linear": 1e-9, "tanh": 1e-6, "rational": 1e-6, "arctan": 1e-6}, 1 << 16
POINTS = 2000  # instants at which positions are compared


class SetUp(NamedTuple):
    """What is simulated: base motion and initial state by a key, and the scale of its positions (m; rad)."""

    system: Any
    base: Callable[[Any], Any]
    y0: Callable[[Any], tuple[Any, ...]]
    t1: float
    scale: float
    samples: int = 1


def _square_wave() -> SetUp:
    setup = papers.square_wave_belt(1.2)
    return SetUp(setup.system, lambda _: setup.law.sample(None, 40.0), lambda _: setup.y0, 40.0, 0.25)


def _poisson() -> SetUp:
    law = ss.PoissonSwitching(1.0, 1.0)
    system = papers.belt_oscillator()
    return SetUp(system, lambda key: law.sample(key, 50.0, capacity=128), lambda _: (0.0, 1.0), 50.0, 0.25, 100)


def _leine() -> SetUp:
    """Leine et al. 1998, started on the periodic orbit; three periods of 12.001 s."""
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(1.0, 3.0))
    return SetUp(system, lambda _: ss.Harmonic(0.0, 1.0, 0.0, 0.2), lambda _: (1.13394467644, 0.0), 36.0, 1.0)


def _moving_base() -> SetUp:
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.4), 0.4, ss.Harmonic(1.0, 0.7))
    return SetUp(system, lambda _: ss.Harmonic(1.0, 1.0, 0.0, 0.7), lambda _: (3.0, 0.0), 30.0, 0.4)


def _motor() -> SetUp:
    setup = papers.motor_cart(0.5)

    def start(key):
        return jax.random.uniform(jax.random.fold_in(key, 1), maxval=2 * math.pi), 0.0, 0.0

    return SetUp(setup.system, setup.law.sample, start, 1.0, 1.0, 200)


SYSTEMS = {
    "square wave": _square_wave,
    "Poisson switching": _poisson,
    "Leine": _leine,
    "moving base": _moving_base,
    "motor and cart": _motor,
}


class Motion(NamedTuple):
    """What is compared; arrays (samples, ...)."""

    position: Any
    start: Any
    end: Any
    ending: Any
    fraction: Any
    status: Any


class Errors(NamedTuple):
    """Of one width: errors (positions over their scale, s, s, share), and how many sticks are in both or one."""

    trajectory: float
    entry: float
    exit: float
    fraction: float
    paired: int
    missed: int
    invented: int


def follow(setup: SetUp, shape: str | None, **options) -> Callable[[float], Motion]:
    """A function of the width (m/s) that simulates all samples; without `shape` by the exact method."""
    times = jnp.linspace(0, setup.t1, POINTS)

    def one(key, width):
        how = {} if shape is None else {"method": ss.Regularized(width, shape, **options)}
        run = ss.simulate(setup.system, setup.base(key), t1=setup.t1, y0=setup.y0(key), **how)
        sticks = run.sticks
        # Spare slots overlap nothing.
        start, end = (jnp.where(sticks.mask, instant, jnp.inf) for instant in (sticks.start, sticks.end))
        return Motion(run.evaluate(times)[0], start, end, sticks.ending, run.stick_fraction, run.status)

    keys = jax.random.split(jax.random.key(2024), setup.samples)
    every = jax.jit(jax.vmap(one, in_axes=(0, None)))
    return lambda width: jax.tree.map(np.asarray, every(keys, width))


@lru_cache
def exact_motion(name: str) -> Motion:
    return follow(SYSTEMS[name](), None)(1.0)


def paired_sticks(start: Any, end: Any, other_start: Any, other_end: Any) -> list[tuple[int, int]]:
    """Sticks that are each other's longest overlap: their indices."""
    overlap = np.minimum.outer(end, other_end) - np.maximum.outer(start, other_start)
    if overlap.size == 0:
        return []
    partner, back = np.argmax(overlap, axis=1), np.argmax(overlap, axis=0)
    return [(i, j) for i, j in enumerate(partner) if back[j] == i and overlap[i, j] > 0]


def compare(exact: Motion, found: Motion, scale: float) -> Errors:
    """The errors of all samples together.

    Trajectories: the median of the samples' root mean squares, for a sample that misses a stick may go another way. A
    stick that begins at time 0 does so in both motions, and one that a jump of the base or the end of time cuts in
    both ends together: such instants are left out.
    """
    if np.any(exact.status) or np.any(found.status):
        raise RuntimeError(f"not finished: {np.unique(exact.status)}, {np.unique(found.status)}")
    entries, exits, pairs, missed, invented = [], [], 0, 0, 0
    for i in range(len(exact.status)):
        mine, theirs = (np.sum(np.isfinite(motion.start[i])) for motion in (exact, found))
        matched = paired_sticks(*(v[i, :mine] for v in exact[1:3]), *(v[i, :theirs] for v in found[1:3]))
        pairs, missed, invented = pairs + len(matched), missed + mine - len(matched), invented + theirs - len(matched)
        for a, b in matched:
            if exact.start[i, a] > 0 or found.start[i, b] > 0:
                entries.append(abs(exact.start[i, a] - found.start[i, b]))
            if ss.Ending.RELEASED in (exact.ending[i, a], found.ending[i, b]):
                exits.append(abs(exact.end[i, a] - found.end[i, b]))
    apart = np.sqrt(np.mean((exact.position - found.position) ** 2, axis=1)) / scale
    entry, exit_ = (float(np.mean(values)) if values else math.nan for values in (entries, exits))
    fraction = float(np.mean(np.abs(exact.fraction - found.fraction)))
    return Errors(float(np.median(apart)), entry, exit_, fraction, pairs, int(missed), int(invented))


def measure(name: str, shape: str, widths: tuple[float, ...] = WIDTHS, **options) -> list[Errors]:
    """The errors of a system at `widths`, relative to its velocity scale; `options` of `Regularized`."""
    setup, exact = SYSTEMS[name](), exact_motion(name)
    run = follow(setup, shape, **({"rtol": RTOL[shape], "max_steps": MAX_STEPS} | options))
    scale = float(setup.system.sizes(excitation_of(setup.base(jax.random.key(0)))).speed)
    return [compare(exact, run(width * scale), setup.scale) for width in widths]


class Fit(NamedTuple):
    """The slope of log error over log width, and its standard error."""

    order: float
    spread: float


def fitted_order(errors: list[Errors], kind: str) -> Fit:
    """By least squares over the `FITTED` widths; what is left over tells the standard error."""
    x, y = np.log(WIDTHS[FITTED]), np.log([getattr(one, kind) for one in errors[FITTED]])
    x = x - np.mean(x)
    order = float(x @ y / (x @ x))
    rest = y - np.mean(y) - order * x
    return Fit(order, float(np.sqrt(rest @ rest / (len(x) - 2) / (x @ x))))


REASONS = """

The order is the power of the width w with which an error falls; measured is the slope of a straight line through the
logarithms of the errors at the widths {first} to {last}, with its standard error. In theory:

- The friction that holds a mass at rest grows until the mass is released, by a fraction r of the largest friction per
  second. The mass leaves with an acceleration that starts from zero, so its velocity grows like r t^2, and it leaves a
  layer of width w in a time proportional to w^(1/2). The shapes differ in the fraction of the friction that is missing
  at a velocity of s widths: none for s >= 1 (linear), exp(-2s) (tanh), 1/s^2 (rational), 1/s (arctan). The mass is
  released where the missing fraction equals r times the time to the release: at a time proportional to w, w^(1/2),
  w^(2/5), w^(1/3), and a velocity proportional to w, w log(1/w), w^(4/5), w^(2/3). The time gives the order of the end
  of a stick, the velocity the order of the default threshold. Over these widths the logarithm looks like an order of
  0.89.
- A stick begins too early by threshold / deceleration, which has the order of the threshold.
- A released mass has too high a velocity by the velocity at the release, so the slip that follows, and with it the
  trajectory, has an error of that order.
- The error of an instant is the sum of two: its own, and that of a trajectory that comes there early or late. Where
  these have opposite signs, their sum passes through zero at some width, as under the square wave. A line fitted
  through such a zero has no meaning, as its large standard error shows. The default threshold makes the sum small for
  ends of sticks under Poisson switching.
- The stick fraction has the lower of the orders of begin and end, or a better one where early and late instants cancel.

Sticks are paired by their overlap in time. A stick is "missed" if the regularised motion stays below the threshold for
less than the default minimum duration, or never reaches it: this happens to short sticks. A stick is "invented" where
the exact motion only slows down, shortly before it comes back and sticks. In Leine's system errors of a tenth of the
orbit and more are limited by the size of the orbit, which makes the measured orders too small.
"""


def table(results: dict[tuple[str, str], list[Errors]]) -> str:
    """The account in Markdown."""
    shown = [f"{WIDTHS[i]:.0e}" for i in SHOWN]
    lines = [
        "# Errors of regularised dynamics",
        "",
        "Made by `python docs/regularized_study.py`, which says what is compared. Widths are relative to the scale of",
        "velocity, trajectories to that of positions, mu n / k (of the motor: 1 rad; the median of all samples).",
        "",
        *REASONS.format(first=f"{WIDTHS[FITTED][0]:.1e}", last=f"{WIDTHS[-1]:.0e}").strip().splitlines(),
    ]
    for name in SYSTEMS:
        lines += ["", f"## {name.capitalize()}", "", _row("error of", "shape", *shown, "order", "in theory")]
        lines += [_row(*["---"] * (4 + len(shown)))]
        for kind, title in KINDS.items():
            for shape in SHAPES:
                errors, theory = results[name, shape], ORDERS[shape].get(kind)
                fit = fitted_order(errors, kind)
                numbers = [f"{getattr(errors[i], kind):.2e}" for i in SHOWN]
                measured = f"{fit.order:.2f} ± {fit.spread:.2f}"
                lines.append(_row(title, shape, *numbers, measured, f"{theory:.2f}" if theory else ""))
        lines += ["", _row("sticks missed + invented, of", "shape", *shown), _row(*["---"] * (2 + len(shown)))]
        for shape in SHAPES:
            errors = results[name, shape]
            counts = [f"{errors[i].missed} + {errors[i].invented}" for i in SHOWN]
            lines.append(_row(errors[0].paired + errors[0].missed, shape, *counts))
    return "\n".join(lines) + "\n"


def _row(*cells: Any) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def draw(results: dict[tuple[str, str], list[Errors]], path: Path) -> None:
    """Errors over width: a row of axes for each kind of error, a column for each system."""
    figure, grid = plt.subplots(len(KINDS), len(SYSTEMS), figsize=(14, 10.5), sharex=True, layout="constrained")
    widths = np.array(WIDTHS)
    for row, kind in zip(grid, KINDS, strict=True):
        for axes, name in zip(row, SYSTEMS, strict=True):
            for shape, color, marker in zip(SHAPES, SERIES, "osD^", strict=False):
                errors = [getattr(one, kind) for one in results[name, shape]]
                axes.loglog(widths, errors, color=color, marker=marker, ms=4.5, lw=1.2, label=shape)
            low, high = axes.get_ylim()
            # What falls with the width itself, through the lower right corner.
            axes.loglog(widths, low * 1.5 * widths / widths[-1], color="0.6", ls="--", lw=1, zorder=0, label="order 1")
            axes.set_ylim(low, high)
            axes.grid(color="0.92")
            axes.set_axisbelow(True)
    for axes, name in zip(grid[0], SYSTEMS, strict=True):
        axes.set_title(name)
    for axes in grid[-1]:
        axes.set_xlabel("width / scale of velocity")
    for axes, title in zip(grid[:, 0], KINDS.values(), strict=True):
        axes.set_ylabel(f"error: {title}")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    plot.save(tuple(grid.flat), path, dpi=110, overwrite=True)


def main() -> None:
    """Measure everything in two processes, and write the figure and the table."""
    started, results = time.perf_counter(), {}
    # The longest first.
    order = sorted(SYSTEMS, key=lambda name: -SYSTEMS[name]().samples * SYSTEMS[name]().t1)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        tasks = {pool.submit(measure, name, shape): (name, shape) for name in order for shape in reversed(SHAPES)}
        for task in as_completed(tasks):
            results[tasks[task]] = task.result()
            seconds = time.perf_counter() - started
            print(f"{seconds:4.0f} s, {len(results)} of {len(tasks)}: {', '.join(tasks[task])}", flush=True)
    (HERE / "regularized_table.md").write_text(table(results))
    draw(results, HERE / "regularized_convergence.png")


if __name__ == "__main__":
    main()
