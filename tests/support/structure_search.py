"""The random search over structures with several contacts: set-ups in batches, and the comparison with the reference.

A result is *silently wrong* where its sticks or its final state differ from the reference's by more than a bound
although its status is FINISHED and its near-grazing count is 0.
"""

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import stickslip_jax as ss
from support.search import stacked
from support.structures import random_structure, reference_motion, with_normal_forces

STATE, TIMES = 1e-9, 1e-8
NUDGE = 1e-9  # of the start, by which the reference shows how far it amplifies errors
AMPLIFIED = 1e-11  # error of both, where something amplifies it
ROOM = 256  # sticks of one set-up
BASES = ("constant", "harmonic", "poisson", "lines")
NORMAL_FORCES = (("constant",), ("harmonic",), ("stepped",), ("constant", "harmonic", "stepped"))


class Family(NamedTuple):
    """Set-ups that share one compiled program.

    `spare`: masses without a contact. `normal`: kinds of normal forces, which contacts take in turn.
    """

    contacts: int
    coupled: bool
    spare: int
    base: str
    normal: tuple[str, ...]

    def drawn(self, number: int) -> list[dict[str, Any]]:
        """So many set-ups, the same at every call."""
        kinds = [kind for kind, _ in zip(itertools.cycle(self.normal), range(self.contacts), strict=False)]
        code = [self.contacts, self.coupled, BASES.index(self.base), NORMAL_FORCES.index(self.normal)]
        setups = []
        for i in range(number):
            rng = np.random.default_rng([29, *code, i])
            setup = random_structure(
                rng,
                self.contacts,
                coupled=self.coupled,
                base=self.base,
                varying=False,
                spare=self.spare,
                longest=LONGEST,
            )
            setups.append(with_normal_forces(setup, rng, kinds) | {"kinds": kinds})
        return setups


LONGEST = 7.0
FAMILIES = [
    Family(2 + i, coupled, i % 2, BASES[(i + 2 * coupled) % 4], NORMAL_FORCES[(i + i // 4 + coupled) % 4])
    for i in range(9)
    for coupled in (False, True)
]


class Batch(NamedTuple):
    """What the package says of many set-ups, as NumPy arrays whose first axis is the set-up."""

    contact: np.ndarray
    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    count: np.ndarray
    state: np.ndarray
    status: np.ndarray
    near: np.ndarray

    def sticks(self, i: int) -> np.ndarray:
        """Rows (contact, start, end, position) of the sticks of set-up `i`."""
        columns = [self.contact, self.start, self.end, self.position]
        return np.stack([column[i, : int(self.count[i])] for column in columns], axis=1)

    def tells(self, i: int) -> bool:
        return int(self.status[i]) != ss.Status.FINISHED or int(self.near[i]) > 0


def _normal_force(setup: dict[str, Any], i: int) -> Any:
    if setup["kinds"][i] == "stepped":
        return ss.ForceSteps(*setup["normal_steps"][i])
    if setup["kinds"][i] == "constant":
        return setup["normal"][i]
    names = "normal_amplitude", "normal_frequency", "normal_phase", "normal"
    return ss.Harmonic(*(setup[name][i] for name in names))


def _base(base: dict[str, Any], intervals: int) -> Any:
    """With so many intervals at least, so that set-ups have arrays of one size."""
    if base["kind"] == "constant":
        return ss.Constant(base["velocity"])
    if base["kind"] == "harmonic":
        return ss.Harmonic(base["amplitude"], base["frequency"], base["phase"], base["offset"])
    times, velocities = base["times"], base["velocities"]
    more = intervals + 1 - len(times)
    if base["kind"] == "poisson":
        return ss.VelocitySteps(np.pad(np.diff(times), (0, more)), np.pad(velocities, (0, more)))
    later = times[-1] + 1.0 + np.arange(more)
    return ss.Recorded(np.concatenate([times, later]), np.pad(velocities, (0, more)))


def _system(setup: dict[str, Any], coupled: bool) -> ss.LinearStructure:
    contacts = tuple(
        ss.Contact(row, _normal_force(setup, i), ss.Coulomb(setup["kinetic"][i], setup["static"][i]), gain)
        for i, (row, gain) in enumerate(zip(setup["directions"], setup["base_gains"], strict=True))
    )
    waves = zip(setup["force_amplitude"], setup["force_frequency"], setup["force_phase"], strict=True)
    force = tuple(ss.Harmonic(*wave) for wave in waves)
    return ss.LinearStructure(
        setup["mass"], setup["stiffness"], setup["damping"], contacts, force, uncoupled=not coupled
    )


@jax.jit
def _follow(systems, bases, t1s, starts):
    def one(system, base, t1, y0):
        found = ss.simulate(system, base, t1=t1, y0=y0, method=ss.Exact(max_steps=2**13))
        sticks = found.sticks
        first = [values[:ROOM] for values in (sticks.contact, sticks.start, sticks.end, sticks.position)]
        state = jnp.concatenate([jnp.stack([jnp.asarray(x) for x in found.final_state])])
        return Batch(*first, jnp.sum(sticks.mask), state, found.status, found.near_grazing_count)

    return jax.vmap(one)(systems, bases, t1s, starts)


def follow(setups: list[dict[str, Any]], coupled: bool) -> Batch:
    """Set-ups of one family through one compiled program."""
    intervals = max((len(setup["base"]["times"]) - 1 for setup in setups if "times" in setup["base"]), default=0)
    parts = [
        (_system(setup, coupled), _base(setup["base"], intervals), setup["t1"], (*setup["x0"], *setup["v0"]))
        for setup in setups
    ]
    return Batch(*map(np.asarray, _follow(*stacked(parts))))


class Verdict(NamedTuple):
    """Of one set-up: whether it differs from the reference beyond the bounds, whether the package tells, by how much.

    Errors are infinite where the sticks are others.
    """

    differs: bool
    told: bool
    state: float
    times: float


def _expected(setup: dict[str, Any], nudge: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Rows (contact, start, end, position) of the sticks, and the final state."""
    motion = reference_motion(setup | {"x0": setup["x0"] + nudge})
    sticks = sorted((stick.contact, stick.start, stick.end, stick.position) for stick in motion.sticks)
    return np.array(sticks).reshape(-1, 4), np.concatenate([motion.position, motion.velocity])


def _errors(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Of states and positions of sticks (m, m/s), and of times (s)."""
    if one[0].shape != other[0].shape or np.any(one[0][:, 0] != other[0][:, 0]):
        return np.inf, np.inf
    apart, times = np.abs(one[0] - other[0]), slice(1, 3)
    return max(np.max(np.abs(one[1] - other[1])), np.max(apart[:, 3], initial=0)), np.max(apart[:, times], initial=0)


def judged(setup: dict[str, Any], batch: Batch, i: int) -> Verdict:
    """Set-up `i` of a batch beside the reference.

    Where the bounds are exceeded the reference, started a little to both sides, says by how much errors grow.
    """
    told, expected, found = batch.tells(i), _expected(setup), batch.sticks(i)
    state, times = _errors((found[np.lexsort((found[:, 1], found[:, 0]))], batch.state[i]), expected)
    if state <= STATE and times <= TIMES:
        return Verdict(False, told, state, times)
    if told or state == np.inf:
        return Verdict(True, told, state, times)
    moved = [_errors(_expected(setup, side * NUDGE), expected) for side in (-1, 1)]
    grown = [AMPLIFIED / NUDGE * max(errors) for errors in zip(*moved, strict=True)]
    return Verdict(state > STATE + grown[0] or times > TIMES + grown[1], told, state, times)
