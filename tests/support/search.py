"""The random search: set-ups in batches through the package, one by one through the reference, and the comparison.

A result is *silently wrong* where it differs from the reference by more than its bound although its status is FINISHED
and its near-grazing count is 0. The bound is a least error, or some units in the last place where these are more, times
how far the reference itself moves when start, load and stiffness do (`amplification`). Where the reference is so near
another outcome that round-off decides (`Found.close`), the package must still be right, or tell.
"""

import math
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from reference import compiled
from reference.compiled import Found, Numbers

import stickslip_jax as ss
from support.switched import Case, Jumping, Line, Shaking, Tones

ROOM = 128  # sticks of one set-up


class Batch(NamedTuple):
    """What the package says of many set-ups, as NumPy arrays whose first axis is the set-up."""

    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    ending: np.ndarray
    count: np.ndarray
    state: np.ndarray
    status: np.ndarray
    near: np.ndarray

    def sticks(self, i: int) -> np.ndarray:
        """Rows (start, end, position, ending) of the sticks of set-up `i`."""
        used = slice(0, min(int(self.count[i]), ROOM))
        return np.stack([self.start[i, used], self.end[i, used], self.position[i, used], self.ending[i, used]], axis=1)

    def tells(self, i: int) -> bool:
        return int(self.status[i]) != ss.Status.FINISHED or int(self.near[i]) > 0


def stacked(trees: list[Any], dtype=np.float64) -> Any:
    """Many pytrees of the same structure as one, whose leaves have a first axis."""
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf, dtype) for leaf in leaves]), *trees)


@partial(jax.jit, static_argnames="method")
def _follow(systems, bases, t1s, starts, scales, method):
    def one(system, base, t1, y0, scale):
        used = method
        if isinstance(method, ss.Regularized):
            used = ss.Regularized(scale[0], method.shape, step=scale[1], max_steps=method.max_steps)
        found = ss.simulate(system, base, t1=t1, y0=y0, method=used)
        sticks = found.sticks
        first = [values[:ROOM] for values in (sticks.start, sticks.end, sticks.position, sticks.ending)]
        state = jnp.stack(found.final_state)
        return Batch(*first, jnp.sum(sticks.mask), state, found.status, found.near_grazing_count)

    return jax.vmap(one)(systems, bases, t1s, starts, scales)


def system_of(case: Case) -> ss.MassSpring:
    """With a damping of zero as an array, not none, so that it shares the program of the others."""
    return case.system if case.damping != 0 else case._replace(damping=np.zeros(())).system


def follow(cases: list[Case], method=None, dtype=np.float64, scales: np.ndarray | None = None) -> Batch:
    """All set-ups, which share their structure, through one compiled program.

    `scales`: rows (width, step) of a `Regularized` method, one for each set-up.
    """
    method = ss.Exact(max_steps=2**15) if method is None else method
    parts = [(system_of(case), case.base.package, case.t1, case.y0) for case in cases]
    scales = np.zeros((len(cases), 2)) if scales is None else scales
    return Batch(*map(np.asarray, _follow(*stacked(parts, dtype), scales.astype(dtype), method=method)))


def _rows(part: Any) -> list[tuple[float, float, float]]:
    if isinstance(part, Jumping):
        return _rows(part.motion)
    return list(part.each) if isinstance(part, Tones) else []


def _linear(part: Any, t: float, middle: float) -> tuple[float, float]:
    """Value and slope of what is no tone."""
    if part is None or isinstance(part, Shaking):
        return 0.0, 0.0
    if isinstance(part, Tones):
        return part.offset, 0.0
    if isinstance(part, Jumping):
        one, other = _linear(part.motion, t, middle), _linear(part.steps, t, middle)
        return one[0] + other[0], one[1] + other[1]
    return part.value(t, middle), part.rate(t, middle)


LAWS = {"Coulomb": compiled.CONSTANT, "VelocityWeakening": compiled.WEAKENING, "Stribeck": compiled.STRIBECK,
        "FrictionCurve": compiled.HUMP}  # fmt: skip


def _coefficients(law: Any) -> np.ndarray:
    names = {
        "Coulomb": ("mu",),
        "VelocityWeakening": ("mu_static", "weakening"),
        "Stribeck": ("mu", "mu_static", "stribeck_speed", "viscous"),
    }
    holder, fields = (
        (law, names.get(type(law).__name__))
        if type(law).__name__ in names
        else (law.curve, ("low", "fall", "scale", "rise"))
    )
    return np.array([float(getattr(holder, name)) for name in fields])


def numbers_of(case: Case, dtype=np.float64) -> Numbers:
    """The set-up as the compiled reference takes it; a start within round-off of the base velocity is put on it."""
    edges = [0.0, *case.breaks, case.t1]
    pieces = []
    for t, end in pairwise(edges):
        middle = (t + end) / 2
        value, slope = _linear(case.base, t, middle)
        force, rate = _linear(case.force, t, middle)
        if isinstance(case.base, Shaking):
            line = Line(*case.base)
            force, rate = force - case.mass * line.value(t, middle), rate - case.mass * line.rate(t, middle)
        pieces.append((t, value, slope, force, rate))
    law, (x, v) = case.rub.law, case.y0
    tones = _rows(case.base)
    base = pieces[0][1] + sum(size * math.cos(phase) for size, _, phase in tones)
    if abs(v - base) <= 32 * np.finfo(dtype).eps * (abs(v) + sum(abs(size) for size, *_ in tones) + abs(pieces[0][1])):
        v = base
    return Numbers(
        case.mass, case.stiffness, case.damping or 0.0, case.normal_force, float(law.static), LAWS[type(law).__name__],
        _coefficients(law), np.array(tones).reshape(-1, 3), np.array(_rows(case.force)).reshape(-1, 3),
        np.array(pieces), float(case.t1), float(x), float(v),
    )  # fmt: skip


class Verdict(NamedTuple):
    """One set-up compared: `error` over `bound`, and what the package said. `told`: by status or near-grazing count."""

    wrong: bool
    told: bool
    error: float
    bound: float
    close: float
    sticks: int


def deviation(case: Case, one: np.ndarray, state: np.ndarray | None, exact: Found) -> float:
    """The worst relative deviation of sticks and end state from the reference; infinite for another sequence of sticks.

    Times against ``max(t, 1 / omega)``, positions and velocities against the largest of the motion.
    """
    if len(one) != len(exact.sticks) or np.any(one[:, 3] != exact.sticks[:, 3]):
        return math.inf
    clock = np.maximum(exact.sticks[:, :2], 1 / case.omega)
    times = np.abs(one[:, :2] - exact.sticks[:, :2]) / clock
    size = motion_size(case, exact)
    places = np.abs(one[:, 2] - exact.sticks[:, 2]) / size
    ends = np.zeros(1) if state is None else np.abs(state - exact.state) * [1, 1 / case.omega] / size
    worst = float(max(np.max(values, initial=0.0) for values in (times, places, ends)))
    return worst if math.isfinite(worst) else math.inf


def motion_size(case: Case, exact: Found) -> float:
    """Of positions, and of velocities over omega."""
    ends = np.abs(exact.state) * [1, 1 / case.omega]
    starts = np.abs(case.y0) * [1, 1 / case.omega]
    return max(case.half_width, np.max(np.abs(exact.sticks[:, 2]), initial=0.0), np.max(ends), np.max(starts))


def amplification(case: Case, exact: Found, nudge: float, dtype=np.float64) -> float:
    """How far the reference moves, over `nudge`, when start, load and stiffness move by that much, relatively."""
    size, numbers, worst = motion_size(case, exact), numbers_of(case, dtype), 1.0
    for sign in (1, -1):
        factor = 1 + sign * nudge
        moved = numbers._replace(
            x=numbers.x + sign * nudge * size, v=numbers.v - sign * nudge * size * case.omega,
            stiffness=numbers.stiffness * factor, normal_force=numbers.normal_force / factor,
        )  # fmt: skip
        other = compiled.run(moved)
        change = deviation(case, other.sticks, other.state, exact) / nudge
        worst = max(worst, change) if math.isfinite(change) else worst
    return worst


def single(value: Any) -> Any:
    """A set-up, or a part of one, whose numbers float32 holds exactly."""
    if isinstance(value, Case):
        parts = {name: single(getattr(value, name)) for name in value._fields if name != "rub"}
        law = jax.tree.map(lambda number: float(np.float32(number)), value.rub.law)
        return value._replace(**parts, rub=value.rub._replace(law=law))
    if isinstance(value, float):
        return float(np.float32(value))
    if isinstance(value, tuple):
        made = [single(item) for item in value]
        return type(value)(*made) if hasattr(value, "_fields") else tuple(made)
    return value


def judged(case: Case, batch: Batch, i: int, least: float, dtype=np.float64) -> Verdict:
    """Set-up `i` of a batch against the reference; `least`: the bound where nothing amplifies errors."""
    return compared(case, batch.sticks(i), batch.state[i], batch.tells(i), least, dtype)


def compared(
    case: Case, sticks: np.ndarray, state: np.ndarray | None, told: bool, least: float, dtype=np.float64
) -> Verdict:
    """What the package found of one set-up against the reference."""
    exact = compiled.run(numbers_of(case, dtype))
    if not np.all(np.isfinite(exact.state)):
        raise ArithmeticError(f"the reference could not follow {case}")
    error = deviation(case, sticks, state, exact)
    bound = max(least, float(np.finfo(dtype).eps) * (64 + 2 * math.pi * case.t1 / case.shortest_time))
    if error > bound:
        bound *= amplification(case, exact, 1e-9 if dtype == np.float64 else 1e-6, dtype)
    return Verdict(error > bound and not told, told, error, bound, exact.close, len(exact.sticks))
