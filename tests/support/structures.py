"""Random structures with several dry-friction contacts, as plain numbers, for the package and for the reference.

A set-up is a dict: ``mass``, ``damping``, ``stiffness`` (d, d); ``directions`` (n, d), one row per contact;
``base_gains`` (n,), how much of the base velocity is subtracted; ``kinetic`` and ``static`` (n,), coefficients; the
normal forces ``normal + normal_amplitude cos(normal_frequency t + normal_phase)``, each (n,), or of contact ``i`` steps
where ``normal_steps[i]`` holds their times and values; the force
``force_amplitude cos(force_frequency t + force_phase)``, each (d,); ``base``, with its ``kind`` and numbers; ``x0``,
``v0`` (d,) and ``t1``. SI units.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from reference.contact_arcs import Motion, Structure
from reference.contacts import follow

BASES = ("constant", "harmonic", "square", "lines")
NORMAL_FORCES = ("constant", "harmonic", "stepped")
STEPS = 3  # of a normal force that is stepped


def random_base(rng: np.random.Generator, kind: str, t1: float) -> dict[str, Any]:
    """A base velocity in m/s.

    ``constant``: `velocity`. ``harmonic``: ``offset + amplitude cos(frequency t + phase)``. ``square``: `velocities`
    between `times`, one more than velocities; ``poisson`` likewise, at the events of a Poisson process. ``lines``:
    `velocities` at `times`, joined by straight lines.
    """
    if kind == "constant":
        return {"kind": kind, "velocity": float(rng.uniform(0.2, 1.0))}
    if kind == "harmonic":
        numbers = zip(
            ("amplitude", "frequency", "phase", "offset"), ((0.3, 1), (0.5, 3), (0, 6), (-0.5, 0.5)), strict=True
        )
        return {"kind": kind} | {name: float(rng.uniform(*limits)) for name, limits in numbers}
    if kind == "poisson":
        times = np.concatenate([[0.0], np.cumsum(rng.exponential(0.8, math.ceil(8 * t1)))])
        times = times[: np.searchsorted(times, t1) + 1]
        return {"kind": kind, "times": times, "velocities": rng.uniform(-0.6, 0.6, len(times) - 1)}
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 3.0, math.ceil(2 * t1)))])
    times = times[: np.searchsorted(times, t1) + 1]
    if kind == "square":
        signs = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(len(times) - 1)
        return {"kind": kind, "times": times, "velocities": signs * rng.uniform(0.1, 0.6)}
    return {"kind": kind, "times": times, "velocities": rng.uniform(-0.6, 0.6, len(times))}


def base_at_0(base: dict[str, Any]) -> float:
    """The base velocity at 0."""
    if base["kind"] == "constant":
        return base["velocity"]
    if base["kind"] == "harmonic":
        return base["offset"] + base["amplitude"] * math.cos(base["phase"])
    return float(base["velocities"][0])


def _chain(rng: np.random.Generator, contacts: int, springs: bool, spare: int | None):
    """Masses in a row, each at most with one contact, with the base or (gain 0) the floor; ``W M^-1 W^T`` diagonal."""
    d = contacts + (int(rng.integers(0, 3)) if spare is None else spare)
    between, ground = rng.uniform(1, 4, d - 1), rng.uniform(0.2, 2, d) * (rng.random(d) < 0.6)
    stiffness = np.diag(ground) if springs else np.zeros((d, d))
    for i, k in enumerate(between):
        stiffness[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    if not springs and rng.random() < 0.5:
        stiffness = np.zeros((d, d))
    directions = np.eye(d)[np.sort(rng.permutation(d)[:contacts])]
    gains = np.where(rng.random(contacts) < 0.8, 1.0, 0.0)
    return np.diag(rng.uniform(0.5, 2, d)), stiffness, directions, gains


def _stack(rng: np.random.Generator, contacts: int, springs: bool, spare: int | None):
    """Blocks that rub on the base and on each other, or any directions at all; independent, for defined forces."""
    d = contacts + (int(rng.integers(0, 2)) if spare is None else spare)
    mass, stiffness = np.diag(rng.uniform(0.5, 2, d)), np.zeros((d, d))
    if springs:
        stiffness += np.diag(rng.uniform(0.5, 3, d))
    for i, k in enumerate(rng.uniform(0.5, 3, d - 1) * (rng.random(d - 1) < 0.5)):
        stiffness[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    # Block i rubs on a block below it or (-1) on the base: a tree, whose rows are independent.
    below = np.array([rng.integers(-1, i) if rng.random() < 0.4 else i - 1 for i in range(d)])
    directions, gains = np.eye(d), np.where(below < 0, 1.0, 0.0)
    for i, j in enumerate(below):
        directions[i, j] -= 1.0 if j >= 0 else 0.0
    if rng.random() < 0.4:
        root = rng.normal(size=(d, d))
        mass += 0.2 * root @ root.T
    if rng.random() < 0.2:
        directions += 0.2 * rng.normal(size=(d, d))
    chosen = np.sort(rng.permutation(d)[:contacts])
    return mass, stiffness, directions[chosen], gains[chosen]


def random_structure(
    rng: np.random.Generator,
    contacts: int,
    *,
    coupled: bool | None = None,
    base: str | None = None,
    varying: bool | None = None,
    spare: int | None = None,
    longest: float = 20.0,
) -> dict[str, Any]:
    """A set-up with `contacts` contacts; what is not asked for is drawn.

    Static above kinetic friction in half of them, damping in half, no springs to the ground in a quarter, a harmonic
    force in half, some contacts at rest at first in half (at most four).

    Args:
        rng: what draws; the same state gives the same set-up.
        contacts: their number, 2 to 10.
        coupled: whether contacts feel each other's friction at once (``W M^-1 W^T`` not diagonal).
        base: one of `BASES`, or ``poisson``.
        varying: whether normal forces vary in time (in a third); some are then open for a while.
        spare: masses beyond one for each contact.
        longest: half of it to all of it is simulated, in s.
    """
    coupled = bool(rng.random() < 0.5) if coupled is None else coupled
    kind = str(rng.choice(BASES)) if base is None else base
    varying = bool(rng.random() < 1 / 3) if varying is None else varying
    springs, damped, sticky, forced, resting = rng.random(5) < [0.75, 0.5, 0.5, 0.5, 0.5]
    mass, stiffness, directions, gains = (_stack if coupled else _chain)(rng, contacts, springs, spare)
    d, t1 = len(mass), float(rng.uniform(longest / 2, longest))
    damping = (rng.uniform(0.02, 0.1) * stiffness + rng.uniform(0.0, 0.05) * np.diag(np.diag(mass))) * damped
    moving = random_base(rng, kind, t1)
    kinetic = rng.uniform(0.1, 0.5, contacts)
    normal = rng.uniform(0.5, 2.0, contacts)
    x0, v0 = rng.uniform(-1, 1, d), rng.uniform(-1, 1, d)
    if resting:
        rows = np.sort(rng.permutation(contacts)[: rng.integers(1, min(contacts, 4) + 1)])
        v0 += np.linalg.pinv(directions[rows]) @ (gains[rows] * base_at_0(moving) - directions[rows] @ v0)
    return {
        "mass": mass,
        "damping": damping,
        "stiffness": stiffness,
        "directions": directions,
        "base_gains": gains,
        "kinetic": kinetic,
        "static": kinetic * (rng.uniform(1.05, 1.5, contacts) if sticky else 1.0),
        "normal": normal,
        "normal_amplitude": normal * rng.uniform(0.2, 1.3, contacts) * varying,
        "normal_frequency": rng.uniform(0.3, 2, contacts),
        "normal_phase": rng.uniform(0, 2 * math.pi, contacts),
        "normal_steps": [None] * contacts,
        "force_amplitude": rng.uniform(0, 0.6, d) * forced,
        "force_frequency": rng.uniform(0.5, 2.5, d),
        "force_phase": rng.uniform(0, 2 * math.pi, d),
        "base": moving,
        "x0": x0,
        "v0": v0,
        "t1": t1,
    }


def with_normal_forces(setup: dict[str, Any], rng: np.random.Generator, kinds: Sequence[str]) -> dict[str, Any]:
    """The set-up, whose normal forces are of these `kinds`, of `NORMAL_FORCES`, one for each contact."""
    steps: list[Any] = []
    for kind, normal in zip(kinds, setup["normal"], strict=True):
        times = np.concatenate([[0.0], np.sort(rng.uniform(0.05, 0.95, STEPS - 1)) * setup["t1"]])
        steps.append((times, normal * rng.uniform(-0.4, 1.6, STEPS)) if kind == "stepped" else None)
    harmonic = np.array([kind == "harmonic" for kind in kinds])
    amplitude = np.where(harmonic, setup["normal"] * rng.uniform(0.2, 1.3, len(kinds)), 0.0)
    return setup | {"normal_amplitude": amplitude, "normal_steps": steps}


def _rows(factors: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return (factors * rows.T).T


def _waves(amplitude: np.ndarray, frequency: np.ndarray, phase: np.ndarray, t) -> np.ndarray:
    """``amplitude cos(frequency t + phase)``, a row for each, at one time or many."""
    return _rows(amplitude, np.cos((np.multiply.outer(frequency, t).T + phase).T))


def reference_structure(setup: dict[str, Any]) -> Structure:
    """The set-up for the reference."""
    base, fastest = setup["base"], [0.0]
    steps = [(i, *each) for i, each in enumerate(setup["normal_steps"]) if each is not None]
    jumps = [at[1:] for _, at, _ in steps]
    if base["kind"] not in ("constant", "harmonic"):
        jumps.append(base["times"][1:-1])
    edges = np.unique(np.concatenate([[0.0], *jumps]))  # where pieces begin
    if base["kind"] == "constant":
        velocity, acceleration = (lambda t, _: base["velocity"] + 0.0 * t), (lambda t, _: 0.0 * t)
    elif base["kind"] == "harmonic":
        a, w, phase = base["amplitude"], base["frequency"], base["phase"]
        velocity = lambda t, _: base["offset"] + a * np.cos(w * t + phase)  # noqa: E731
        acceleration = lambda t, _: -a * w * np.sin(w * t + phase)  # noqa: E731
        fastest.append(w)
    else:
        times, values = base["times"], base["velocities"]
        slopes = np.diff(values) / np.diff(times) if base["kind"] == "lines" else np.zeros(len(values))
        here = np.searchsorted(times, edges, side="right") - 1
        velocity = lambda t, p: values[here[p]] + slopes[here[p]] * (t - times[here[p]])  # noqa: E731
        acceleration = lambda t, p: slopes[here[p]] + 0.0 * t  # noqa: E731
    normal, force = (
        [setup[f"{name}_{part}"] for part in ("amplitude", "frequency", "phase")] for name in ("normal", "force")
    )
    steady = np.tile(setup["normal"], (len(edges), 1))
    for i, at, forces in steps:
        steady[:, i] = forces[np.searchsorted(at, edges, side="right") - 1]
    constant = not np.any(normal[0])
    pressed = lambda t, p: np.multiply.outer(steady[p], 1.0 + 0.0 * t)  # noqa: E731
    fastest += [] if constant else [np.max(normal[1])]
    fastest += [np.max(force[1])] if np.any(force[0]) else []
    return Structure(
        **{
            name: setup[name]
            for name in ("mass", "damping", "stiffness", "directions", "base_gains", "kinetic", "static")
        },
        normal_forces=pressed if constant else lambda t, p: pressed(t, p) + _waves(*normal, t),
        base_velocity=velocity,
        base_acceleration=acceleration,
        force=(lambda t, _: _waves(*force, t)) if np.any(force[0]) else None,
        breaks=tuple(edges[1:]),
        fastest=float(max(fastest)),
    )


def reference_motion(setup: dict[str, Any], **options) -> Motion:
    """The set-up followed by the reference."""
    return follow(reference_structure(setup), setup["t1"], setup["x0"], setup["v0"], **options)
